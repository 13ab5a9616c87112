"""Bill, recipe, placement, assembly sheet; and one geometry behind all files of the bench."""

import csv
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.spec import Design
from phytac_design.engine.stage import EXPORT
from phytac_design.fabrication.documents.assembly_page import fixture_steps
from phytac_design.fabrication.documents.bill_of_materials import (
    DENSITY_g_cm3,
    bill_csv,
    bill_rows,
    mass_g,
    shell_parts,
)
from phytac_design.fabrication.documents.paint_map import INKS
from phytac_design.fabrication.documents.recipe import make_recipe, recipe_steps, recipe_text
from phytac_design.fabrication.switch_set import revolved_volume_mm3
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout import make_markers
from phytac_design.solids.mesh_export import read_stl
from phytac_design.stages.build import copy_of
from tests.fabrication.bench_cases import ran, switches
from tests.fabrication.cases import design, shipped
from tests.refusals import refused

SMALL: dict[str, dict[str, Any]] = {
    "shape": {"length_mm": 40.0},
    "layout": {"rows": 4, "columns": 8, "height_far_mm": 4.0},
    "kit": {"force_steps": 3, "shell_steps": 2},
}
CHANGES: dict[str, dict[str, Any]] = {
    "shape": {"diameter_outer_mm": 56.0},
    "layout": {"height_far_mm": 5.0},
}
EVERY = {
    "paint_map.svg", "paint_map_inside.svg", "paint_map.pdf", "switch_placement.csv",
    "bill_of_materials.csv", "casting.md", "assembly.html",
}  # fmt: skip


def rows_of(path: Path) -> list[dict[str, str]]:
    lines = [k for k in path.read_text().splitlines(keepends=True) if not k.startswith("#")]
    return list(csv.DictReader(io.StringIO("".join(lines))))


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Design, Path]]:
    """A small sensor and a changed one, through shell, mold, kit and bench."""
    folder = tmp_path_factory.mktemp("two")
    first = design(**SMALL)
    second = copy_of(first, **CHANGES)
    return [(each, ran(each, folder / str(k))) for k, each in enumerate((first, second))]


def exported(folder: Path) -> dict[str, Path]:
    return {
        path.relative_to(stage / EXPORT).as_posix(): path
        for stage in sorted(folder.iterdir())
        for path in sorted((stage / EXPORT).rglob("*"))
        if path.is_file()
    }


def test_every_file_follows_the_design(two: list[tuple[Design, Path]]) -> None:
    """Nothing of a changed design is as it was, but what has no business with the change."""
    before, after = (exported(folder) for _, folder in two)
    assert {name.split("/")[1] for name in before if name.startswith("bench/")} == EVERY
    assert {"kit/program.csv", "kit/collar.stl", "kit/indenter_1.stl"} <= set(after)
    same = {n for n in before if n in after and before[n].read_bytes() == after[n].read_bytes()}
    unchanged = {"cell_seat.stl", "indenter_flat.stl", "indenter_ball.stl", "calibration_log.csv"}
    # Domes are those of the bowls, which did not change.
    assert same == {f"kit/{name}" for name in unchanged} | {"mold/dome_tray_1.stl"}


def test_without_switches_the_documents_are_of_shell_and_paint_alone(tmp_path: Path) -> None:
    few = SMALL | {"layout": {"rows": 2, "columns": 4}, "receptor": {"diameter_hole_mm": 0.0}}
    made = ran(design(**few), tmp_path)
    files = exported(made)
    casting = {"switch_placement.csv", "casting.md"}
    assert {name for name in files if "/" in name and name.startswith(("bench/", "mold/"))} == {
        f"bench/{name}" for name in EVERY - casting
    }
    bill = rows_of(files["bench/bill_of_materials.csv"])
    assert {row["part"] for row in bill} >= {"shell", "marker pen, blue", "marker pen, green"}
    assert not any(row["material"] in ("tpu", "silicone") for row in bill)
    assert "red" not in " ".join(row["part"] for row in bill)
    pictured = files["bench/paint_map.svg"].read_text()
    assert INKS["red"] not in pictured
    assert INKS["blue"] in pictured
    assert "witch" not in files["bench/assembly.html"].read_text()


def test_all_files_speak_of_the_same_markers(two: list[tuple[Design, Path]]) -> None:
    for case, folder in two:
        surface = case.surface()
        markers = make_markers(case, surface)
        files = exported(folder)
        table = rows_of(files["bench/switch_placement.csv"])
        places = np.array([[float(row[f"{k}_mm"]) for k in "xyz"] for row in table])
        outer = surface.point(markers.uv)
        assert places == pytest.approx(outer, abs=1e-4)
        lengths = np.array([float(row["length_mm"]) for row in table])
        due = markers.height_mm + case.wall.thickness_mm - case.switch.tip_recess_mm
        assert lengths == pytest.approx(due, abs=0.051)
        svg = files["bench/paint_map.svg"].read_text()
        discs = re.findall(rf'<use [^>]*x="([\d.]+)" y="([\d.]+)" style="fill: {INKS["red"]}', svg)
        drawn = np.array(discs[: markers.count], dtype=float) * 25.4 / 72.0
        flat = surface.unwrap(markers.uv) * [1.0, -1.0]
        assert drawn - drawn[0] == pytest.approx(flat - flat[0], abs=2e-3)
        program = rows_of(files["kit/program.csv"])
        pressed = np.array([int(row["region"]) for row in program])
        touched = np.array([[float(row[f"{k}_mm"]) for k in "xyz"] for row in program])
        assert touched == pytest.approx(outer[pressed], abs=1e-5)
        coded = (files["kit/decoder.gcode"]).read_text()
        assert {int(k) for k in re.findall(r"region (\d+)", coded)} == set(pressed.tolist())
        labels = {row["switch"] for row in table}
        bill = rows_of(files["bench/bill_of_materials.csv"])
        kinds = {r["part"][7:]: int(r["count"]) for r in bill if r["part"].startswith("switch ")}
        counts = [row["switch"] for row in table]
        assert sum(row["part"].startswith("switch ") for row in bill) == len(kinds)
        assert kinds == {label: counts.count(label) for label in labels}
        page = files["bench/assembly.html"].read_text()
        assert all(f">{label}<" in page for label in labels)
        assert "`" not in page  # commands are code


def test_the_bill_is_the_files(two: list[tuple[Design, Path]]) -> None:
    """Volumes by the triangles of each file; masses by volume and density."""
    for case, folder in two:
        files = exported(folder)
        bill = rows_of(files["bench/bill_of_materials.csv"])
        listed = {row["file"]: row for row in bill if row["file"]}
        assert set(listed) == {name for name in files if name.endswith(".stl")}
        for name, row in listed.items():
            mesh: TriangleMesh = read_stl(files[name])
            assert float(row["volume_mm3"]) == pytest.approx(mesh.volume_mm3, rel=1e-4)
            due = DENSITY_g_cm3["resin"] * float(row["volume_mm3"]) / 1000.0
            assert float(row["mass_g"]) == pytest.approx(due, abs=6e-5)
        made = switches(case, folder / "again")
        for kind in made.kinds:
            row = next(r for r in bill if r["part"] == f"switch {made.label(kind)}")
            volume = revolved_volume_mm3(made.profile(kind, 1e-4))
            assert float(row["volume_mm3"]) == pytest.approx(volume, rel=1e-3)
        rubber = sum(
            int(r["count"]) * float(r["volume_mm3"]) for r in bill if r["material"] == "tpu"
        )
        grams = rubber / 1000.0 * DENSITY_g_cm3["tpu"] * (1.0 + case.bench.waste_rubber)
        text = files["bench/casting.md"].read_text()
        assert f"| rubber in all | {grams:.2f} |" in text


def test_the_assembly_sheet_stands_alone(two: list[tuple[Design, Path]]) -> None:
    page = exported(two[0][1])["bench/assembly.html"].read_text()
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "data:image/png;base64," in page
    assert "32 switches" in page
    assert "shell/shell.3mf" in page


def test_the_same_inputs_give_the_same_bytes(
    two: list[tuple[Design, Path]], tmp_path: Path
) -> None:
    case, folder = two[0]
    first, again = exported(folder), exported(ran(case, tmp_path / "again"))
    assert {n: p.read_bytes() for n, p in first.items()} == {
        n: p.read_bytes() for n, p in again.items()
    }


def test_recipe_has_the_paper_s_ratios() -> None:
    case = copy_of(shipped("cylinder60"), bench={"waste_rubber": 0.25, "waste_silicone": 0.1})
    recipe = make_recipe(case, 8000.0, 100000.0)
    assert recipe.rubber_g == pytest.approx(8.0 * DENSITY_g_cm3["tpu"] * 1.25)
    assert recipe.a_g + recipe.b_g + recipe.c_g == pytest.approx(recipe.rubber_g)
    assert recipe.c_g / recipe.a_g == pytest.approx(5.0)
    assert (recipe.a_g + recipe.c_g) / recipe.b_g == pytest.approx(6.0)
    assert recipe.silicone_g == pytest.approx(110.0 * DENSITY_g_cm3["silicone"])
    steps = " ".join(recipe_steps(case, recipe))
    for words in ("stir for 2 min", "vacuum for 5 min", "stir for 30 s", "degas for 1 min"):
        assert words in steps
    for words in ("25 to 35 °C", "65 °C for 1 h", "red", "cyanoacrylate"):
        assert words in steps
    assert "0.01 g" in recipe_text(case, recipe)
    large = make_recipe(case, 80000.0, 0.0)
    assert "0.01 g" not in recipe_text(case, large)


def test_the_recipe_follows_the_way_of_casting_and_the_rubber() -> None:
    case = copy_of(shipped("cylinder60"), mold={"way": "rigid"})
    text = recipe_text(case, make_recipe(case, 8000.0, 0.0))
    assert "silicone by" not in text
    assert "printed plates" in text
    other = copy_of(case, switch={"material": "silicone-a30"})
    recipe = make_recipe(other, 8000.0, 0.0)
    text = recipe_text(other, recipe)
    assert f"Mix {recipe.rubber_g:.2f} g of silicone-a30 by its maker's ratio" in text
    for foreign in ("| A |", "Hei-Cast", "65 °C", "A + C", "0.01 g"):
        assert foreign not in text


def test_plungers_go_through_mold_and_papers(tmp_path: Path) -> None:
    case = design(**SMALL, switch={"family": "best", "material": "best"})
    found = exported(ran(case, tmp_path))
    made = switches(case, tmp_path / "again")
    assert made.body == "plunger"
    sheet, text = (found[f"bench/{name}"].read_text() for name in ("assembly.html", "casting.md"))
    assert re.search("<th[^>]*>family</th>.*plunger", sheet)
    assert "until the plunger&#x27;s rim lies" in sheet
    assert "g of dragon-skin-20 in all" in sheet
    assert "The plungers are designed for a modulus of 0.365 MPa" in text
    rows = rows_of(found["bench/bill_of_materials.csv"])
    notes = [row["note"] for row in rows if row["part"].startswith("switch ")]
    assert notes
    assert all(note.startswith("plunger, 0.5 N, ") for note in notes)
    assert "bowl" not in sheet + text
    assert found["mold/dome_tray_1.stl"].stat().st_size > 0


def test_the_shell_is_of_the_design_s_material() -> None:
    case = shipped("cylinder60")
    for modulus_MPa, words in ((2200.0, "tough resin"), (43.8, "TPU"), (77.0, "of 77 MPa")):
        own = copy_of(case, material={"modulus_MPa": modulus_MPa})
        (shell, *_) = shell_parts(own, 1000.0)
        assert words in shell["note"]


def test_a_shell_in_pieces_is_listed_by_its_pieces() -> None:
    case = shipped("cylinder60")
    pieces = [{"file": f"shell/shell_part_{k}.stl", "volume_mm3": 10.0 * k} for k in (1, 2)]
    listed = [part for part in shell_parts(case, 99.0, pieces) if part["file"]]
    assert [part["volume_mm3"] for part in listed] == [10.0, 20.0]
    assert [part["file"] for part in listed] == [piece["file"] for piece in pieces]
    (whole,) = [part for part in shell_parts(case, 99.0) if part["file"]]
    assert (whole["file"], whole["volume_mm3"]) == ("shell/shell.stl", 99.0)


def test_materials_without_a_density_are_refused() -> None:
    assert mass_g("paint-blue", 1000.0) == pytest.approx(DENSITY_g_cm3["resin"])
    assert mass_g("electronics", 1000.0) is None
    part = {"part": "x", "file": "", "count": 1, "material": "unobtainium", "volume_mm3": 1.0}
    with refused("density-unknown"):
        bill_rows([part])


def test_bought_parts_have_no_volume_and_commas_survive() -> None:
    rows = bill_rows(
        [
            {
                "part": "screws, M3",
                "file": "",
                "count": 4,
                "material": "steel",
                "volume_mm3": 0.0,
                "note": 'a "fine" thread',
            }
        ]
    )
    (row,) = csv.DictReader(io.StringIO(bill_csv(rows)))
    assert (row["part"], row["volume_mm3"], row["mass_g"]) == ("screws, M3", "", "")
    assert row["note"] == 'a "fine" thread'


def test_steps_name_what_the_hardware_has() -> None:
    case = shipped("cylinder60")
    part = {"part": "mount", "file": "fixtures/mount.stl"}
    joint = {"joint": "cover", "count": 4, "size": "M2", "length_mm": 16.0, "thread": "tapped"}
    steps = fixture_steps(case, {"parts": [part], "joints": [joint]})
    assert "fixtures/mount.stl" in steps[0]
    assert "Screw cover: 4 × M2 × 16 mm (tapped)." in steps
    assert "light bar" in steps[1]
    without = fixture_steps(shipped("plane"), {"hardware_left_out": "no room", "parts": []})
    assert "no room" in without[0]
    assert "ring of LEDs" in without[1]
