"""Fixtures before the camera: their bodies, the file format, and that the gate names them."""

import inspect
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import load_design, parse_design, to_toml
from phytac_design.design.field_groups import fields_of
from phytac_design.design.fixture_table import TRIANGLES_MAX, read_stl
from phytac_design.design.spec import Design
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.cameras import camera_of
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.paint import FIXTURE
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import FIRST_FIXTURE, fixture_mesh, paint_owner
from phytac_design.rules.design_review import checkup
from phytac_design.stages import STAGES
from phytac_shapes.arrays import FloatArray
from tests.optics.cases import Bench, make_design
from tests.optics.lenses import LENSES
from tests.refusals import refused

FEW = {"rows": 3, "columns": 4, "height_near_mm": 3.0, "height_far_mm": 6.0}
ROD = {"name": "cable", "kind": "cylinder", "radius_mm": 3.0}
BOX = {"name": "box", "kind": "box", "centre_mm": [1.0, 2.0, 3.0], "size_mm": [2.0, 4.0, 6.0]}


def with_fixtures(*fixtures: dict[str, Any], **camera: Any) -> Design:
    size = {"width_px": 648, "height_px": 486, "focal_px": 242.5}
    design = make_design(layout=FEW, camera=size | camera)
    return Design.model_validate(design.model_dump(mode="json") | {"fixtures": fixtures})


def volume(mesh: TriangleMesh) -> float:
    """Volume inside a closed mesh, whichever way its triangles turn; from solid angles of cones."""
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.triangles] - mesh.vertices_mm.mean(axis=0), 1, 0)
    return float(np.abs(np.einsum("ij,ij->i", a, np.cross(b, c))).sum() / 6.0)


def before(design: Design, marker: int, share: float) -> FloatArray:
    """Point on the line from the camera to a marker's tip."""
    bench = Bench(design)
    camera = bench.camera.position_mm
    return np.asarray(camera + share * (bench.markers.tip_mm[marker] - camera))


def test_bodies_have_their_volumes() -> None:
    design = with_fixtures(
        ROD | {"from_mm": [1.0, 2.0, 3.0], "to_mm": [1.0, -4.0, 11.0]},
        BOX | {"turn_deg": 30.0},
    )
    rod, box = (fixture_mesh(fixture, tolerance_mm=1e-4) for fixture in design.fixtures)
    assert volume(rod) == pytest.approx(np.pi * 9.0 * 10.0, rel=1e-3)
    assert volume(box) == pytest.approx(48.0)
    near = np.linalg.norm(box.vertices_mm - [1.0, 2.0, 3.0], axis=1)
    np.testing.assert_allclose(near, np.sqrt(1.0 + 4.0 + 9.0))
    corner = [np.cos(np.pi / 6) - 2 * np.sin(np.pi / 6), np.sin(np.pi / 6) + 2 * np.cos(np.pi / 6)]
    away = np.linalg.norm(box.vertices_mm - [1.0 + corner[0], 2.0 + corner[1], 6.0], axis=1)
    assert away.min() < 1e-12


@pytest.mark.parametrize("camera", [{}, LENSES["fisheye"]], ids=["pinhole", "fisheye"])
def test_a_rod_before_a_marker_hides_it_and_is_named(camera: dict[str, Any]) -> None:
    plain = with_fixtures(**camera)
    already = checkup(plain)
    assert 5 not in already["occluded_markers"]
    assert "fixture" not in already["advice"]
    centre = before(plain, 5, 0.7)
    along = np.array([0.0, 0.0, 4.0])
    ends = {"from_mm": (centre - along).tolist(), "to_mm": (centre + along).tolist()}
    report = checkup(with_fixtures(ROD | ends, BOX, **camera))
    assert 5 in report["occluded_markers"]
    count = len(set(report["occluded_markers"]) - set(already["occluded_markers"]))
    assert count < 4
    assert f"{count} by the fixture 'cable'" in report["advice"]
    assert "move the fixture 'cable' out of the camera's way" in report["advice"]


def test_a_fixture_is_in_pictures_and_id_maps() -> None:
    design = with_fixtures(BOX | {"centre_mm": [12.0, 0.0, 40.0], "size_mm": [8.0, 8.0, 8.0]})
    bench = Bench(design)
    part = rasterise(bench.scene(), bench.camera).part
    x, y = bench.camera.project(np.array([[12.0, 0.0, 36.0]]))[0].round().astype(int)
    assert part[y, x] == FIRST_FIXTURE
    assert (part == FIRST_FIXTURE).sum() > 100
    assert paint_owner(part)[part == FIRST_FIXTURE].max() == -1
    b, g, r = render_frame(bench.scene(), bench.camera)[y, x].astype(int)
    assert max(abs(b - r), abs(g - r)) < 12
    assert r < max(FIXTURE)


def test_occluders_are_distinguished() -> None:
    bar = make_design(layout=FEW, light={"bar_radius_mm": 20.0, "bar_start_mm": -10.0})
    assert "by the light bar" in checkup(bar)["advice"]
    tall = FEW | {"kind": "straight", "height_near_mm": 24.0, "height_far_mm": 1.0}
    advice = checkup(make_design(layout=tall))["advice"]
    assert "by other receptors" in advice
    assert "height_far_mm > height_near_mm" in advice
    far = checkup(make_design(layout=FEW, camera={"width_px": 64, "height_px": 48, "focal_px": 24}))
    assert "too small in the picture" in far["advice"]


def stl_text(triangles: FloatArray) -> str:
    rows = ["solid box"]
    for corners in triangles:
        rows += ["facet normal 0 0 0", "outer loop"]
        rows += [f"vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in corners]
        rows += ["endloop", "endfacet"]
    return "\n".join([*rows, "endsolid box"])


def stl_bytes(triangles: FloatArray) -> bytes:
    record = np.zeros(
        len(triangles), dtype=[("n", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]
    )
    record["corners"] = triangles
    return b"solid but binary".ljust(80) + len(triangles).to_bytes(4, "little") + record.tobytes()


def test_an_stl_file_becomes_part_of_the_design(tmp_path: Path) -> None:
    box = fixture_mesh(with_fixtures(BOX).fixtures[0], tolerance_mm=0.1)
    corners = box.vertices_mm[box.triangles]
    (tmp_path / "text.stl").write_text(stl_text(corners))
    (tmp_path / "binary.stl").write_bytes(stl_bytes(corners))
    text = to_toml(with_fixtures())
    listed = "".join(
        f'\n[[fixtures]]\nname = "{kind}"\nkind = "mesh"\nfile = "{kind}.stl"\n'
        for kind in ("text", "binary")
    )
    (tmp_path / "mine.toml").write_text(text + listed)
    design = load_design(str(tmp_path / "mine.toml"))
    for fixture in design.fixtures:
        mesh = fixture_mesh(fixture, tolerance_mm=0.1)
        assert mesh.vertices_mm.shape == (8, 3)
        np.testing.assert_allclose(mesh.vertices_mm[mesh.triangles], corners, atol=1e-6)
    again = parse_design(tomllib.loads(to_toml(design)), "resolved")
    assert again == design


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"", "fixture-file-invalid"),
        (b"\x00\x01\xff" * 99, "fixture-file-invalid"),
        (b"solid\nvertex 1 2 x\n", "fixture-file-invalid"),
        (b"solid\nvertex 1 2 nan\nvertex 1 1 1\nvertex 0 0 0", "fixture-file-invalid"),
        (stl_bytes(np.zeros((TRIANGLES_MAX + 1, 3, 3))), "fixture-too-many-triangles"),
    ],
)
def test_files_that_are_not_fixtures(content: bytes, code: str, tmp_path: Path) -> None:
    (tmp_path / "x.stl").write_bytes(content)
    with refused(code):
        read_stl(tmp_path / "x.stl")
    with refused("fixture-file-unreadable"):
        read_stl(tmp_path / "nowhere.stl")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            BOX | {"kind": "sphere"},
            "fixtures.0.kind must be one of cylinder, box, mesh .got 'sphere'",
        ),
        (BOX | {"centre": 1}, "unknown key 'fixtures.0.centre'; did you mean 'centre_mm'"),
        (
            BOX | {"size_mm": [0.0, 1.0, 1.0]},
            "fixtures.0.size_mm.0: input should be greater",
        ),
        (ROD, "fixtures.0.from_mm is missing; kind 'cylinder' needs it"),
        (
            {"name": "x", "kind": "mesh", "vertices_mm": [[0, 0, 0]], "triangles": [[0, 0, 1]]},
            "name corners 0 to 1; it has 0 to 0",
        ),
    ],
)
def test_bad_fixtures_are_explained(change: dict[str, Any], message: str) -> None:
    data = with_fixtures().model_dump(mode="json")
    with refused("field-invalid") as caught:
        parse_design({**data, "fixtures": [change]}, "bad.toml")
    caught.match(message)


def test_every_stage_that_draws_the_light_bar_draws_fixtures() -> None:
    design = load_design("cylinder60")
    reads = {stage.name: set(fields_of(design, stage.design_fields)) for stage in STAGES}
    fixtures = {name for name, fields in reads.items() if "fixtures" in fields}
    assert {"views", "compare", "underload", "renders"} <= fixtures
    for stage in STAGES:
        # The others that read the light ask where the camera stands, or where the bar is held.
        if "build_scene" in inspect.getsource(sys.modules[stage.run.__module__]):
            assert {"light", "fixtures"} <= reads[stage.name], stage.name


def test_a_camera_may_look_past_a_fixture_beyond_the_far_end() -> None:
    design = with_fixtures(BOX | {"centre_mm": [0.0, 0.0, 500.0]})
    camera = camera_of(design, design.surface())
    assert checkup(design)["clear"]
    assert camera.position_mm[2] < 0.0
