"""Molds: places of cavities, labels, refusals, and the files of a build."""

import csv
import json
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import pytest
from pydantic import ValidationError

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.spec import Design
from phytac_design.design.switch_table import MoldSection
from phytac_design.engine.stage import Context
from phytac_design.fabrication.molds.audit import check_release
from phytac_design.fabrication.molds.labels import GLYPHS, label, strokes
from phytac_design.fabrication.molds.make import MoldSet
from phytac_design.fabrication.molds.plate_grid import PlateLayout, plan_sets
from phytac_design.fabrication.molds.rules import rule_rows
from phytac_design.fabrication.switch_set import reach_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import to_manifold, to_triangles
from phytac_design.stages.build import copy_of
from phytac_design.stages.mold_stage import MOLD
from phytac_shapes.arrays import FloatArray
from tests.fabrication.cases import design
from tests.fabrication.molds import BOWL, WAYS, molds, switch_set
from tests.refusals import refused

Cells = list[tuple[int, int]]


def cells_of(plan: PlateLayout) -> Cells:
    taken: Cells = [*plan.keys, plan.title]
    for run in plan.runs:
        taken += [(run.start - 1, run.line), *run.cells]
    return taken


@pytest.mark.parametrize("counts", [(5,), (3, 1, 1, 40), (16,) * 23, (1,) * 60, (700,)])
@pytest.mark.parametrize("limit", [(5, 7), (16, 16)])
def test_every_switch_has_one_cell(counts: tuple[int, ...], limit: tuple[int, int]) -> None:
    kinds = [((0, k), count) for k, count in enumerate(counts)]
    plans = plan_sets(kinds, *limit)
    made = dict.fromkeys((kind for kind, _ in kinds), 0)
    for plan in plans:
        cells = cells_of(plan)
        assert len(cells) == len(set(cells))
        everywhere = {(x, y) for x in range(plan.columns) for y in range(plan.lines)}
        assert set(cells) | set(plan.blank) == everywhere
        assert not set(cells) & set(plan.blank)
        assert plan.columns <= limit[0]
        assert plan.lines <= limit[1]
        for run in plan.runs:
            made[run.kind] += run.count
    assert made == dict(kinds)
    room = limit[0] * limit[1] - 5
    assert len(plans) >= sum(counts) / room
    assert [plan.number for plan in plans] == list(range(1, plans[0].total + 1))


@pytest.mark.parametrize(("columns", "lines"), [(3, 3), (4, 4), (7, 5), (16, 16)])
def test_keys_fit_only_one_way_round(columns: int, lines: int) -> None:
    plan = PlateLayout(columns=columns, lines=lines, runs=())
    places = {tuple(place) for place in plan.centre_mm(plan.keys, 2.0).tolist()}
    assert len(places) == 4
    for x, y in ((-1, -1), (-1, 1), (1, -1)):
        assert {(x * a, y * b) for a, b in places} != places


@pytest.mark.long
def test_a_larger_bed_takes_fewer_sets() -> None:
    switches = switch_set((2.0,) * 100)
    small = molds(switches, rules={"bed_mm": [70.0, 70.0, 100.0]}, tolerance_mm=0.1)
    large = molds(switches, rules={"bed_mm": [140.0, 140.0, 100.0]}, tolerance_mm=0.1)
    # Five by five cells: keys, title and a label for each line leave 15.
    assert (len(small), len(large)) == (7, 1)
    for sets, bed in ((small, 70.0), (large, 140.0)):
        assert sum(made.plan.cavities for made in sets) == 100
        for made in sets:
            for name in made.parts:
                size = np.ptp(made.printed[name].vertices_mm, axis=0)
                assert size[:2].max() <= bed
                assert made.printed[name].vertices_mm[:, 2].min() == 0.0


def height_at(made: MoldSet, name: str, cell: tuple[int, int], places: FloatArray) -> FloatArray:
    """Height of a face over places of a cell, by thin rods that are cut off by the part."""
    centre = made.plan.centre_mm([cell], made.sizes.pitch_mm)[0]
    solid = to_manifold(made.parts[name])
    half = 0.5 * made.sizes.pitch_mm
    near = manifold3d.Manifold.cube((2 * half, 2 * half, 200.0), center=True)
    tops = to_triangles(solid ^ near.translate((*centre, 0.0)))
    found = []
    for x, y in places + centre:
        rod = manifold3d.Manifold.cube((0.02, 0.02, 200.0), center=True).translate((x, y, 0.0))
        found.append(to_triangles(to_manifold(tops) ^ rod).vertices_mm[:, 2].max())
    return np.array(found)


def test_labels_can_be_read_off_the_core_plate() -> None:
    """Middles of the label's strokes are raised by its height, those of other labels are not."""
    switches = switch_set((1.0, 4.0, 4.0), (0, 0, 1), {}, {"depth_mm": 1.6})
    (made,) = molds(switches, way="rigid")
    texts = {run.kind: made.sizes.labels[run.kind] for run in made.plan.runs}
    assert sorted(texts.values()) == ["A0", "A1", "B1"]
    for run in made.plan.runs:
        cell = (run.start - 1, run.line)
        side, stroke = made.sizes.pitch_mm, 0.4
        tall = min((0.84 * side - stroke) / 1.32, 0.5 * (0.84 * side - stroke))
        for text in texts.values():
            middles = tall * strokes(text).mean(axis=1)
            z = height_at(made, "core_plate", cell, middles)
            if text == texts[run.kind]:
                assert z == pytest.approx(0.4, abs=1e-6)
            else:
                assert z.min() == pytest.approx(0.0, abs=1e-6)


def test_every_letter_is_a_sound_solid_of_its_own() -> None:
    areas = set()
    for letter in GLYPHS:
        solid = label(letter, 8.0, 0.4, 0.4)
        release = check_release(to_triangles(solid))
        assert release.undercut_mm2 < 1e-6
        assert release.draft_deg == pytest.approx(5.0)
        assert solid.bounding_box()[5] == pytest.approx(0.4)
        assert np.abs(solid.bounding_box()[:2]).max() < 4.0
        areas.add(round(solid.slice(0.39).area(), 6))
    assert len(areas) > 20


@pytest.mark.parametrize("text", ["a1", "", "A-1"])
def test_unknown_letters_are_refused(text: str) -> None:
    with refused("label-character-unknown"):
        label(text, 8.0, 0.4, 0.4)


@pytest.mark.parametrize(
    ("way", "rules", "section", "code"),
    [
        ("rigid", {"bed_mm": [35.0, 200.0, 100.0]}, {}, "mold-exceeds-bed"),
        ("silicone-master", {"bed_mm": [48.0, 48.0, 100.0]}, {}, "mold-exceeds-bed"),
        ("rigid", {"bed_mm": [145.0, 145.0, 10.0]}, {}, "mold-exceeds-height"),
        ("rigid", {}, {"key_mm": 6.0}, "mold-keys-too-wide"),
        ("silicone-master", {}, {"vent_step_mm": 0.55}, "mold-vent-too-thin"),
        ("rigid", {}, {"draft_deg": 10.0, "channel_mm": 0.1}, "mold-trough-wall-thin"),
        ("rigid", {"engrave_min_mm": 2.0}, {}, "label-does-not-fit"),
    ],
)
def test_what_cannot_be_made_is_refused(
    way: str, rules: dict[str, Any], section: dict[str, Any], code: str
) -> None:
    with refused(code):
        molds(rules=rules, way=way, **section)


@pytest.mark.parametrize(
    "bad",
    [
        {"shrink_rubber": 0.5},
        {"shrink_rubber": -0.1},
        {"shrink_silicone": 1.0},
        {"shrink_print": -0.5},
        {"shrink_print": float("nan")},
        {"way": "wax"},
        {"draft_deg": 45.0},
    ],
)
def test_nonsense_in_the_table_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(bad))):
        MoldSection(**bad)


def test_details_are_held_against_the_printer() -> None:
    for way in WAYS:
        (made,) = molds(way=way)
        assert all(row["holds"] for row in rule_rows(made.sizes))
        (coarse,) = molds(way=way, rules={"process": "fdm"})
        wrong = {row["detail"] for row in rule_rows(coarse.sizes) if not row["holds"]}
        fine = "stem hole" if way == "rigid" else "stem and vent, mean diameter"
        assert {fine, "pinching ring", "ridge of a core"} <= wrong


def context_of(case: Design, folder: Path) -> Context:
    switch = folder / "switch"
    switch.mkdir(parents=True, exist_ok=True)
    facts = {"switches": [{"threshold_N": 0.5, "bowl": BOWL}]}
    (switch / "facts.json").write_text(json.dumps(facts))
    return Context(
        design=case,
        accuracy=PRESETS["draft"],
        seed=0,
        folders={"switch": switch},
        progress=lambda _: None,
    )


def built(case: Design, folder: Path) -> tuple[dict[str, bytes], dict[str, Any]]:
    folder.mkdir()
    MOLD.run(context_of(case, folder), folder)
    files = sorted((folder / "export" / "mold").iterdir())
    return {path.name: path.read_bytes() for path in files}, json.loads(
        (folder / "facts.json").read_text()
    )


@pytest.mark.parametrize("way", WAYS)
def test_a_build_writes_every_part_and_the_same_again(way: str, tmp_path: Path) -> None:
    case = design(mold={"way": way})
    files, facts = built(case, tmp_path / "one")
    again, _ = built(case, tmp_path / "two")
    assert files == again
    listed = {Path(part["file"]).name for part in facts["parts"] if part["file"]}
    assert listed == {name for name in files if name.endswith(".stl")}
    assert facts["cavities"] == 12
    assert facts["undercut_mm2"] == 0
    rows = list(csv.DictReader(files["cavities.csv"].decode().splitlines()))
    assert sum(int(row["count"]) for row in rows) == 12
    context = context_of(case, tmp_path)
    wanted = reach_mm(Sensor.of(case, context.surface, context.markers))
    made = [float(row["length_mm"]) for row in rows for _ in range(int(row["count"]))]
    assert np.sort(made) == pytest.approx(np.sort(wanted), abs=0.051)
    over = sum(p["volume_mm3"] for p in facts["parts"] if p["material"] == "tpu")
    poured = facts["poured_mm3"]
    assert over == pytest.approx(poured["rubber"] - poured["switches"])
    assert {row["label"] for row in rows} == set(facts["sets"][0]["labels"])
    silicone = [part for part in facts["parts"] if part["material"] == "silicone"]
    assert len(silicone) == (2 if way == "silicone-master" else 0)
    assert all(part["volume_mm3"] > 0.0 for part in facts["parts"])


def test_files_follow_the_design(tmp_path: Path) -> None:
    base = design(mold={"way": "rigid"})
    files, _ = built(base, tmp_path / "base")
    shorter = copy_of(base, layout={"height_far_mm": base.layout.height_far_mm - 1.0})
    other, _ = built(shorter, tmp_path / "shorter")
    # Shorter stems: the domes stay as they are.
    assert files["dome_plate_1.stl"] == other["dome_plate_1.stl"]
    assert files["core_plate_1.stl"] != other["core_plate_1.stl"]
    assert files["cap_plate_1.stl"] != other["cap_plate_1.stl"]
    shrunk = copy_of(base, mold={"shrink_rubber": 0.02})
    third, _ = built(shrunk, tmp_path / "shrunk")
    assert all(files[name] != third[name] for name in files if name.endswith(".stl"))
    fewer = copy_of(base, layout={"columns": 3})
    rows = built(fewer, tmp_path / "fewer")[0]["cavities.csv"].decode().splitlines()[1:]
    assert sum(int(row.split(",")[3]) for row in rows) == 9


def test_a_refused_mold_leaves_no_file(tmp_path: Path) -> None:
    case = design(print_rules={"bed_mm": [30.0, 30.0, 100.0]})
    with refused("mold-exceeds-bed"):
        built(case, tmp_path / "small")
    assert not (tmp_path / "small" / "export").exists()
    assert not (tmp_path / "small" / "facts.json").exists()
