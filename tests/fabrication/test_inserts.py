"""Coloured inserts: their solids, sprues, fits, files, documents and effort."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.fabrication.effort.effort import effort_of
from phytac_design.fabrication.effort.shell_estimate import shell_volume_mm3
from phytac_design.fabrication.inserts.fits import fits_of
from phytac_design.fabrication.inserts.insert_solids import (
    insert_manifold,
    insert_volume_mm3,
    sprue_manifold,
    sprue_volume_mm3,
)
from phytac_design.fabrication.inserts.sprue_sizes import sprue_sizes
from phytac_design.fabrication.inserts.sprues import (
    STRAIN_MAX,
    developed,
    insert_lengths_mm,
    plan_sprues,
    plates,
)
from phytac_design.fabrication.printing.print_checks import check_body
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import read_stl
from phytac_design.solids.solid_mesh import shell_manifold, to_triangles
from phytac_design.stages.documents_stage import BENCH
from phytac_design.stages.inserts_stage import INSERTS
from phytac_design.stages.printing_stage import printed_files
from phytac_design.stages.shell_stage import run_shell
from tests.designs import changed
from tests.fabrication.bench_cases import context_of, put
from tests.fabrication.cases import design

UP = np.array([0.0, 0.0, 1.0])


def small(**sections: dict[str, Any]) -> Design:
    sections["receptor"] = {"colouring": "insert"} | sections.get("receptor", {})
    return design(**sections)


def shipped(name: str, **sections: Any) -> Sensor:
    return Sensor(changed(name, receptor={"colouring": "insert"}, **sections))


@pytest.mark.parametrize("hole", [1.6, 0.0])
def test_volumes_of_an_insert_and_of_its_sprue(hole: float) -> None:
    one = Sensor(small(receptor={"diameter_hole_mm": hole}))
    receptor = one.design.receptor
    body = insert_manifold(receptor, 7.0, tolerance_mm=0.002)
    closed = np.pi / 4.0 * (3.0**2 - hole**2) * 7.0
    # Head: a land of 0.15 mm and a cone of 0.4 mm from ø3.8 to ø3.
    closed += np.pi * ((1.9**2 - 1.5**2) * 0.15)
    closed += np.pi * 0.4 * ((1.9**2 + 1.9 * 1.5 + 1.5**2) / 3.0 - 1.5**2)
    assert float(insert_volume_mm3(receptor, np.array([7.0]))[0]) == pytest.approx(closed)
    assert body.volume() == pytest.approx(closed, rel=1e-6)
    assert body.genus() == (1 if hole else 0)
    (sprue, *_) = plan_sprues(one)
    solid = sprue_manifold(one.design, sprue, tolerance_mm=0.005)
    assert len(solid.decompose()) == 1
    # The estimate leaves the label out.
    assert solid.volume() == pytest.approx(sprue_volume_mm3(one.design, sprue), rel=0.01)


@pytest.mark.parametrize("name", shipped_designs())
def test_each_marker_has_one_insert_of_its_colour_and_length(name: str) -> None:
    one = shipped(name)
    sprues = plan_sprues(one)
    assert sorted(k for sprue in sprues for k in sprue.markers) == list(range(one.markers.count))
    assert len({sprue.label for sprue in sprues}) == len(sprues)
    lengths = insert_lengths_mm(one.design, one.markers)
    sizes = sprue_sizes(one.design.receptor, one.design.print_rules)
    for sprue in sprues:
        ids = np.array(sprue.markers)
        names = {one.design.layout.colours[k] for k in one.markers.colour[ids]}
        assert names == {sprue.colour}
        assert (sprue.length_mm == lengths[ids]).all()
        size = np.ptp(sprue.size_mm(sizes, one.design.receptor.diameter_head_mm), axis=0)
        assert size[0] <= max(one.design.print_rules.bed_mm[:2])
        assert sprue.strain <= STRAIN_MAX
    # From outer face to end face, for axes square to the wall.
    outer = one.surface.point(one.markers.uv)
    assert lengths == pytest.approx(np.linalg.norm(one.markers.tip_mm - outer, axis=1), abs=1e-3)


def test_a_bar_keeps_the_length_of_its_line_on_the_wall() -> None:
    one = shipped("cylinder60")
    sizes = sprue_sizes(one.design.receptor, one.design.print_rules)
    column = one.markers.uv[one.markers.column == 3]
    place, strain = developed(one.surface, column, sizes, "column")
    # A helix at 50.5 degrees over the wall is straight when the cylinder is unrolled.
    radius = 30.0 + 1.0 + 0.3
    rows = 120.0 / 23.0
    around = rows * np.tan(np.radians(50.5)) / 30.0 * radius
    steps = np.diff(place, axis=0)
    gaps = np.linalg.norm(steps, axis=1)
    assert gaps == pytest.approx(np.full(22, np.hypot(rows, around)), rel=1e-4)
    assert steps == pytest.approx(np.tile(steps[0], (22, 1)), abs=1e-6)
    # Bending by sin^2 and twisting by sin cos of the angle, over the radius.
    slope = np.arctan2(around, rows)
    bend = 0.3 * np.sin(slope) ** 2 / radius
    twist = 0.6 * np.sin(slope) * np.cos(slope) / radius
    assert strain == pytest.approx(np.hypot(bend, twist / np.sqrt(3.0)), rel=2e-3)


def test_how_inserts_go_in_follows_from_bores_and_lengths() -> None:
    def ways(layout: dict[str, Any]) -> set[str]:
        return {sprue.way for sprue in plan_sprues(shipped("cylinder60", layout=layout))}

    # Bores along the axis are parallel; along a helix they are not, and the next insert would have
    # to come out of the wall by 12 mm on 8 mm of bar.
    assert ways({"kind": "straight"}) == {"together"}
    assert ways({}) == {"single"}
    short = {"heights": "constant", "columns": 6, "rows": 8}
    assert ways(short) == {"wrapped"}


def test_a_bar_on_a_cone_is_an_arc() -> None:
    one = Sensor(
        small(
            shape={
                "kind": "cone",
                "diameter_near_mm": 60.0,
                "diameter_far_mm": 36.0,
                "length_mm": 90.0,
            },
            layout={"rows": 1, "columns": 12, "colours": ["blue"]},
            print_rules={"bed_mm": (400.0, 400.0, 100.0)},
        )
    )
    (sprue,) = plan_sprues(one)
    assert sprue.way == "wrapped"
    x, y = sprue.place_mm.T
    lift = 3.0 * 0.6 * 1.3 / (np.diff(x[:2]) ** 2 + np.diff(y[:2]) ** 2)
    rim = 0.3 / np.hypot(*one.surface.point(one.markers.uv, 1.3)[0, :2])
    assert sprue.strain == pytest.approx(float(lift[0]) + rim, rel=0.02)
    # Circle through the places: its radius is the slant distance of the row from the apex.
    matrix = np.column_stack([x, y, np.ones_like(x)])
    a, b, c = np.linalg.lstsq(matrix, x**2 + y**2, rcond=None)[0]
    radius = np.sqrt(c + (a**2 + b**2) / 4.0)
    half = np.arctan(12.0 / 90.0)
    place = one.surface.point(one.markers.uv, 1.3)[0]
    assert radius == pytest.approx(np.hypot(*place[:2]) / np.sin(half), rel=2e-3)
    # On the bed the inserts point up, as they point inwards on the wall: the bar bends to the same
    # side.
    ids = np.array(sprue.markers)
    first, second = np.diff(one.surface.point(one.markers.uv[ids[:3]]), axis=0)
    bed = np.diff(sprue.place_mm[:3], axis=0)
    side = bed[0, 0] * bed[1, 1] - bed[0, 1] * bed[1, 0]
    inwards = one.markers.direction[ids[1]] @ np.cross(first, second)
    assert side * inwards > 0.0


def test_sprues_follow_rows_where_these_are_fewer() -> None:
    bed = {"bed_mm": (400.0, 400.0, 100.0)}
    columns = plan_sprues(Sensor(small(layout={"rows": 6, "columns": 4}, print_rules=bed)))
    assert [len(one.markers) for one in columns] == [6] * 4
    rows = plan_sprues(Sensor(small(layout={"rows": 2, "columns": 8, "colours": ["blue"]})))
    assert {len({k // 8 for k in one.markers}) for one in rows} == {1}


def test_bars_that_would_break_carry_inserts_side_by_side() -> None:
    shape = {"kind": "cylinder", "diameter_outer_mm": 36.0, "length_mm": 80.0}
    thin, tight = (
        Sensor(
            small(
                shape=shape,
                layout={"height_far_mm": 4.0},
                print_rules={"wall_free_min_mm": thickness},
            )
        )
        for thickness in (0.6, 2.5)
    )
    assert {sprue.way for sprue in plan_sprues(thin)} == {"wrapped"}
    sprues = plan_sprues(tight)
    assert {sprue.way for sprue in sprues} == {"single"}
    assert effort_of(tight).hours["insert"] == pytest.approx(
        (30.0 * len(sprues) + 12.0 * 12) / 3600.0
    )


@pytest.mark.parametrize("name", ["cylinder60", "hemisphere", "plane"])
def test_sprues_keep_the_print_rules(name: str) -> None:
    one = shipped(name)
    sprue = plan_sprues(one)[-1]
    solid = sprue_manifold(one.design, sprue)
    assert len(solid.decompose()) == 1
    assert solid.genus() >= len(sprue.markers)
    report = check_body(to_triangles(solid), one.design.print_rules, up=UP, spacing_mm=1.0)
    assert [item.text() for item in report.violations] == []


def test_beds_hold_all_sprues_apart() -> None:
    one = shipped("cylinder60")
    sprues, bed = plan_sprues(one), one.design.print_rules.bed_mm
    sizes = sprue_sizes(one.design.receptor, one.design.print_rules)
    found = plates(sprues, one.design)
    assert {colour: len(beds) for colour, beds in found.items()} == {"blue": 1, "green": 1}
    for beds in found.values():
        for placed in beds:
            boxes = np.array([sprue.size_mm(sizes, 3.8) + place for sprue, place in placed])
            assert (boxes >= -1e-9).all()
            assert (boxes <= np.array(bed[:2]) + 1e-9).all()
            low, high = boxes[:, 0], boxes[:, 1]
            apart = (low[:, None] - high[None]).max(axis=2)
            apart = np.maximum(apart, apart.T)
            np.fill_diagonal(apart, 1.0)
            assert apart.min() >= 1.0 - 1e-9


def test_fits_are_those_of_the_sizes() -> None:
    fits = fits_of(Sensor(small()))
    assert fits.push_in == pytest.approx(0.15)
    assert fits.push_in_worst == pytest.approx(0.0)
    assert fits.hold_in_worst == pytest.approx(0.1)
    assert fits.cover == pytest.approx((4.6 - 4.1) / 2.0)
    assert fits.stem is not None
    assert 0.0 < fits.stem < 0.2
    # The head's flat top of ø3.8 on a cylinder of ø60.
    assert fits.proud_worst == pytest.approx(0.15 + 30.0 - np.sqrt(900.0 - 1.9**2), rel=1e-3)
    pins = fits_of(Sensor(small(receptor={"diameter_hole_mm": 0.0})))
    assert pins.cover is None
    assert pins.stem is None


def test_effort_counts_inserts_in_place_of_paint() -> None:
    painted, made = effort_of(Sensor(load_design("cylinder60"))), effort_of(shipped("cylinder60"))
    assert (painted.receptor_ends, made.receptor_ends) == (368, 0)
    assert (painted.inserts, made.inserts) == (0, 368)
    assert made.parts_handled - painted.parts_handled == made.parts["sprues"] == 16
    assert made.hours["paint_ends"] == 0.0
    assert made.hours["insert"] == pytest.approx((16 * 30.0 + 368 * 12.0) / 3600.0)
    # Two beds of sprues more.
    assert made.hours["print"] - painted.hours["print"] == pytest.approx(2 * 900.0 / 3600.0)
    assert made.hours_total < painted.hours_total
    assert "flush cutter" in made.tools
    assert "blue" not in " ".join(made.tools)


@pytest.mark.parametrize("name", ["hemisphere", "cylinder40"])
def test_volume_of_the_shell_is_near_that_of_its_solid(name: str) -> None:
    one = shipped(name)
    exact = shell_manifold(one, tolerance_mm=0.02).volume()
    assert shell_volume_mm3(one) == pytest.approx(exact, rel=0.01)


def test_build_writes_sprues_bill_map_and_steps(tmp_path: Path) -> None:
    context = context_of(small(), tmp_path)
    for stage, facts in (
        ("hardware", {"hardware_left_out": "for the test", "parts": []}),
        ("printing", {"pieces": []}),
        ("mold", {"parts": []}),
        ("kit", {"parts": []}),
    ):
        put(context, tmp_path, stage, facts)
    for name, run in (("shell", run_shell), ("inserts", INSERTS.run), ("bench", BENCH.run)):
        context.folders[name] = tmp_path / name
        (tmp_path / name).mkdir()
        run(context, tmp_path / name)
    markers = context.markers
    facts = context.facts("inserts")
    files = {part["file"]: part for part in facts["parts"]}
    assert set(files) == {"inserts/blue_1.stl", "inserts/green_1.stl"}
    assert set(printed_files(context)) == set(files)
    for file, part in files.items():
        mesh = read_stl(tmp_path / "inserts" / "export" / file)
        assert mesh.volume_mm3 == pytest.approx(part["volume_mm3"], rel=1e-4)
    text = (tmp_path / "inserts" / "export" / "inserts" / "placement.csv").read_text()
    rows = list(csv.DictReader(io.StringIO(text)))
    assert sorted(int(row["marker"]) for row in rows) == list(range(markers.count))
    for row in rows:
        marker = int(row["marker"])
        assert row["colour"] == context.design.layout.colours[markers.colour[marker]]
        assert float(row["length_mm"]) == pytest.approx(0.8 + markers.height_mm[marker], abs=1e-3)
    bench = tmp_path / "bench" / "export" / "bench"
    bill = (bench / "bill_of_materials.csv").read_text()
    assert "inserts/blue_1.stl" in bill
    assert "marker pen, blue" not in bill
    sheet = (bench / "assembly.html").read_text()
    assert "inserts/placement.csv" in sheet
    assert "Paint 12 receptors" not in sheet
    assert context.facts("bench")["mass_g"]["inserts"] > 0.0
    drawn = (bench / "paint_map.svg").read_text()
    assert "map of inserts" in drawn or "B0" in drawn


def test_painted_sensors_have_no_inserts(tmp_path: Path) -> None:
    context = context_of(design(), tmp_path)
    (tmp_path / "inserts").mkdir()
    context.folders["inserts"] = tmp_path / "inserts"
    INSERTS.run(context, tmp_path / "inserts")
    assert context.facts("inserts") == {"parts": []}
