"""Shells larger than the bed: cuts between receptors, keys, pieces; the stage that writes them."""

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.print_rules_table import PrintSection
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.fabrication.printing.cuts import gaps, plan_cuts, receptor_spans
from phytac_design.fabrication.printing.overhang import suggest
from phytac_design.fabrication.printing.parting import key_sizes, part_shell
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import prisms
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import read_stl
from phytac_design.solids.mesh_facts import trimesh_facts
from phytac_design.solids.solid_mesh import shell_manifold, to_manifold, to_triangles
from phytac_design.stages.printing_stage import OTHERS, run
from phytac_design.stages.shell_stage import run_shell
from tests.fabrication.cases import built, design, family_design, shipped
from tests.refusals import refused


def on_bed(case: Design, *bed: float) -> Design:
    return case.model_copy(update={"print_rules": PrintSection(bed_mm=bed)})


def small() -> Design:
    return design(
        shape={"diameter_outer_mm": 40.0, "length_mm": 60.0}, layout={"rows": 6, "columns": 6}
    )


CASES = {
    "spiral": (on_bed(small(), 60.0, 60.0, 40.0), 2),
    "cone": (on_bed(family_design("cone"), 60.0, 60.0, 40.0), 2),
    "sheet": (on_bed(family_design("plane"), 45.0, 40.0, 60.0), 2),
    "both ways": (on_bed(family_design("plane"), 45.0, 35.0, 20.0), 4),
}


@pytest.mark.parametrize("name", list(CASES))
def test_pieces_fit_are_sound_and_add_up(name: str) -> None:
    case, count = CASES[name]
    case, surface, markers = built(case)
    solid = shell_manifold(Sensor.of(case, surface, markers), tolerance_mm=0.05)
    parting = part_shell(Sensor.of(case, surface, markers), solid, tolerance_mm=0.05)
    meshes = [to_triangles(piece) for piece in parting.pieces]
    assert len(meshes) == count
    for mesh in meshes:
        facts = trimesh_facts(mesh)
        assert facts.watertight
        assert facts.bodies == 1
        assert suggest(mesh, RayTree(mesh), case.print_rules)[0].fits
    whole = solid.volume() + parting.boss_volume_mm3 - parting.clearance_volume_mm3
    assert sum(mesh.volume_mm3 for mesh in meshes) == pytest.approx(whole, rel=1e-9)
    assert sum((a ^ b).volume() for a, b in combinations(parting.pieces, 2)) < 1e-6
    # Nothing but bosses was added, on the inside: the outer face is as it was.
    joined = sum(parting.pieces[1:], start=parting.pieces[0])
    assert (solid - joined).volume() < parting.clearance_volume_mm3 + 1e-6
    bosses = [part for part in (joined - solid).decompose() if part.volume() > 1.0]
    assert len(bosses) >= 2
    added = np.concatenate([to_triangles(part).vertices_mm for part in bosses])
    foot = surface.chart(added)
    height = np.einsum("ni,ni->n", added - surface.point(foot), surface.normal(foot))
    assert -parting.size.boss - 0.06 <= height.min()
    assert height.max() <= -case.wall.thickness_mm + 0.06
    for cut in parting.cuts:
        low, high = receptor_spans(case, markers, cut.normal)
        assert ((high <= cut.offset_mm - 0.399) | (low >= cut.offset_mm + 0.399)).all()


def test_pegs_stand_in_their_sockets_with_the_clearance() -> None:
    case, surface, markers = built(CASES["spiral"][0])
    parting = part_shell(
        Sensor.of(case, surface, markers), shell_manifold(Sensor.of(case, surface, markers))
    )
    size, (cut,) = parting.size, parting.cuts
    lower, upper = parting.pieces
    assert size.socket - size.peg == pytest.approx(2.0 * case.print_rules.clearance_mm)
    assert len(parting.keys_mm) >= 3
    up = cut.normal
    for key in parting.keys_mm:
        rod = prisms(key[None], (key + size.length * up)[None], size.peg / 2.0 - 0.02, 24)
        peg = to_manifold(rod)
        assert (peg - lower).volume() < 1e-6
        wide = to_manifold(
            prisms(key[None], (key + size.length * up)[None], size.socket / 2.0 - 0.02, 24)
        )
        assert (wide ^ upper).volume() < 1e-6
        ring = to_manifold(
            prisms(key[None], (key + size.length * up)[None], size.boss / 2.0 + 0.02, 24)
        )
        assert (ring ^ upper).volume() > 0.5 * (ring - wide).volume()
    # Turned by any other step of the keys, the pieces do not go together.
    angle = np.sort(np.arctan2(parting.keys_mm[:, 1], parting.keys_mm[:, 0]))
    steps = np.diff(np.append(angle, angle[0] + 2.0 * np.pi))
    assert np.ptp(steps) * 18.0 > 2.0 * size.socket


def test_cuts_lie_in_gaps_and_a_shell_that_fits_is_not_cut() -> None:
    case, surface, markers = built(small())
    corners = to_triangles(
        shell_manifold(Sensor.of(case, surface, markers), tolerance_mm=0.05)
    ).vertices_mm
    assert plan_cuts(Sensor.of(case, surface, markers), corners, 2.0) == []
    free = gaps(case, markers, np.array([0.0, 0.0, 1.0]))
    assert len(free) == 5
    rows = np.unique(np.round(markers.tip_mm[:, 2], 6))
    for (low, high), before, after in zip(free, rows, rows[1:], strict=False):
        assert before + 1.5 < low < high < after - 1.5


def test_what_cannot_be_parted_says_why() -> None:
    golden = on_bed(shipped("hemisphere"), 50.0, 50.0, 15.0)
    case, surface, markers = built(golden)
    solid = shell_manifold(Sensor.of(case, surface, markers), tolerance_mm=0.1)
    with refused("shell-exceeds-bed"):
        part_shell(Sensor.of(case, surface, markers), solid)
    tight = small().model_copy(
        update={"print_rules": PrintSection(bed_mm=(60.0, 60.0, 40.0), wall_free_min_mm=9.0)}
    )
    case, surface, markers = built(tight)
    solid = shell_manifold(Sensor.of(case, surface, markers), tolerance_mm=0.1)
    with refused("parting-keys-no-room"):
        part_shell(Sensor.of(case, surface, markers), solid)
    assert key_sizes(PrintSection(process="fdm"))[0].peg == 3.0


def stage_result(case: Design, tmp_path: Path, *, tools: bool = True) -> dict[str, Any]:
    accuracy = replace(PRESETS["draft"], tools=tools)
    folders = {name: tmp_path / name for name in ("shell", *OTHERS)}
    for folder in folders.values():
        folder.mkdir(exist_ok=True)
        (folder / "facts.json").write_text(json.dumps({"parts": []}))
    context = Context(
        design=case, accuracy=accuracy, seed=0, folders=folders, progress=lambda _: None
    )
    run_shell(context, folders["shell"])
    plate = {"part": "plate", "file": "mold/plate.stl", "count": 1, "material": "resin"}
    bought = {"part": "screw", "file": "", "count": 4, "material": "steel"}
    (tmp_path / "mold" / "facts.json").write_text(json.dumps({"parts": [plate, plate, bought]}))
    target = tmp_path / "mold" / "export" / "mold"
    target.mkdir(parents=True, exist_ok=True)
    (target / "plate.stl").write_bytes(
        (tmp_path / "shell" / "export" / "shell" / "shell.stl").read_bytes()
    )
    out = tmp_path / "printing"
    run(context, out)
    facts: dict[str, Any] = json.loads((out / "facts.json").read_text())
    report = json.loads((out / "export" / "shell" / "print_report.json").read_text())
    assert report == facts
    assert (out / "export" / "shell" / "print_report.svg").read_text().startswith("<svg")
    return facts


def test_the_stage_writes_report_picture_and_pieces(tmp_path: Path) -> None:
    (tmp_path / "printing").mkdir()
    facts = stage_result(CASES["spiral"][0], tmp_path)
    assert set(facts["files"]) == {"shell/shell.stl", "mold/plate.stl"}
    assert facts["unchecked"] == []
    assert [v["rule"] for v in facts["files"]["shell/shell.stl"]["violations"]] == ["bed"]
    assert [piece["file"] for piece in facts["pieces"]] == [
        "shell/shell_part_1.stl",
        "shell/shell_part_2.stl",
    ]
    for piece in facts["pieces"]:
        mesh = read_stl(tmp_path / "printing" / "export" / piece["file"])
        assert mesh.volume_mm3 == pytest.approx(piece["volume_mm3"], rel=1e-5)
        assert piece["orientation"]["fits"]
    first = (tmp_path / "printing" / "export" / "shell" / "print_report.svg").read_bytes()
    stage_result(CASES["spiral"][0], tmp_path)
    assert first == (tmp_path / "printing" / "export" / "shell" / "print_report.svg").read_bytes()


def test_the_stage_of_a_shell_that_fits_or_cannot_be_parted(tmp_path: Path) -> None:
    (tmp_path / "printing").mkdir()
    facts = stage_result(small(), tmp_path, tools=False)
    assert set(facts["files"]) == {"shell/shell.stl"}
    assert facts["unchecked"] == ["mold/plate.stl"]
    assert (facts["violations"], facts["pieces"], facts["not_parted"]) == (0, [], "")
    narrow = on_bed(small(), 30.0, 30.0, 30.0)
    (tmp_path / "again" / "printing").mkdir(parents=True)
    facts = stage_result(narrow, tmp_path / "again")
    assert "cannot be parted" in facts["not_parted"]
    assert facts["pieces"] == []
