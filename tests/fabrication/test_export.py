import contextlib
import io
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.solids.mesh_export import (
    STL_HEADER,
    stl_bytes,
    threemf_bytes,
    write_3mf,
    write_stl,
)
from phytac_design.solids.solid_mesh import painted_manifolds, shell_manifold, to_triangles
from tests.fabrication.cases import FAMILIES, built, design, family_design, shipped
from tests.refusals import refused

SINGLE = 3e-6
"""Relative rounding of 32-bit coordinates, summed over a thin shell."""


@pytest.fixture(scope="module")
def small() -> TriangleMesh:
    return to_triangles(shell_manifold(Sensor.of(*built(design()))))


@pytest.fixture(scope="module")
def bodies() -> dict[str, TriangleMesh]:
    painted = painted_manifolds(Sensor.of(*built(design())))
    return {name: to_triangles(body) for name, body in painted.items()}


def test_stl_opens_in_trimesh_as_it_was(small: TriangleMesh, tmp_path: Path) -> None:
    import trimesh

    write_stl(small, tmp_path / "shell.stl")
    body = trimesh.load_mesh(tmp_path / "shell.stl")
    assert body.is_watertight
    assert body.is_winding_consistent
    assert len(body.faces) == len(small.triangles)
    assert body.volume == pytest.approx(small.volume_mm3, rel=SINGLE)
    assert 1 - body.euler_number // 2 == 13


@pytest.mark.parametrize("kept", [slice(0), slice(1, None), slice(None, None, -1)])
def test_what_is_no_solid_is_refused_by_its_name(
    kept: slice, small: TriangleMesh, tmp_path: Path
) -> None:
    """Empty, open, inside out."""
    inward = small.flipped() if kept.step else small
    broken = TriangleMesh(vertices_mm=small.vertices_mm, triangles=inward.triangles[kept])
    with refused("body-without-volume") as found:
        write_stl(broken, tmp_path / "palm.stl")
    assert str(found.value).startswith(f"palm.stl is no closed solid (got {len(broken.triangles)}")
    assert not (tmp_path / "palm.stl").exists()


def test_stl_layout(small: TriangleMesh) -> None:
    data = stl_bytes(small)
    assert data[:80] == STL_HEADER
    assert not data.startswith(b"solid")
    assert struct.unpack("<I", data[80:84]) == (len(small.triangles),)
    assert len(data) == 84 + 50 * len(small.triangles)
    normal = np.array(struct.unpack("<3f", data[84:96]))
    assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-6)


def test_3mf_opens_with_names_units_and_volumes(
    bodies: dict[str, TriangleMesh], small: TriangleMesh, tmp_path: Path
) -> None:
    import lib3mf

    write_3mf(bodies, tmp_path / "shell.3mf", name="case")
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tmp_path / "shell.3mf"))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    found, volume = [], 0.0
    objects = model.GetMeshObjects()
    while objects.MoveNext():
        body = objects.GetCurrentMeshObject()
        found.append(body.GetName())
        assert body.IsManifoldAndOriented()
        mesh = TriangleMesh(
            vertices_mm=np.array([tuple(v.Coordinates) for v in body.GetVertices()]),
            triangles=np.array([tuple(t.Indices) for t in body.GetTriangleIndices()]),
        )
        assert mesh.volume_mm3 == pytest.approx(bodies[found[-1]].volume_mm3, rel=10 * SINGLE)
        volume += mesh.volume_mm3
    assert found == ["resin", "blue", "green"]
    assert volume == pytest.approx(small.volume_mm3, rel=SINGLE)
    items = model.GetBuildItems()
    assert items.Count() == 1


def test_files_do_not_change_from_run_to_run(
    bodies: dict[str, TriangleMesh], small: TriangleMesh
) -> None:
    again = to_triangles(shell_manifold(Sensor.of(*built(design()))))
    assert stl_bytes(again) == stl_bytes(small)
    assert threemf_bytes(bodies, name="case") == threemf_bytes(bodies, name="case")
    assert threemf_bytes(bodies, name="other") != threemf_bytes(bodies, name="case")


def test_another_process_writes_the_same_bytes() -> None:
    code = (
        "import hashlib;from tests.fabrication.cases import *;"
        "from phytac_design.solids.solid_mesh import *;"
        "from phytac_design.solids.mesh_export import *;"
        "from phytac_design.layout.sensor import Sensor;"
        "c=Sensor.of(*built(design()));h=hashlib.sha256();"
        "h.update(stl_bytes(to_triangles(shell_manifold(c))));"
        "h.update(threemf_bytes({k:to_triangles(b) for k,b in painted_manifolds(c).items()},"
        "name='x'));print(h.hexdigest())"
    )
    own = io.StringIO()
    with contextlib.redirect_stdout(own):
        exec(code, {})  # noqa: S102 - the same lines, in this process
    other = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert other == own.getvalue()
    assert len(other) == 65


def test_3mf_holds_no_dates(bodies: dict[str, TriangleMesh]) -> None:
    with zipfile.ZipFile(io.BytesIO(threemf_bytes(bodies, name="case"))) as archive:
        assert archive.testzip() is None
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


ADMESH_FAULTS = (
    "Degenerate facets",
    "Edges fixed",
    "Facets removed",
    "Facets added",
    "Facets reversed",
    "Backwards edges",
    "Normals fixed",
    "Total disconnected facets",
)


def assert_admesh_finds_nothing(stl: Path) -> None:
    # It prints bytes after the file's header as text.
    run = subprocess.run(
        ["admesh", str(stl)], capture_output=True, text=True, errors="replace", check=True
    )
    report = run.stdout
    fields = {}
    for line in report.splitlines():
        label, _, rest = line.partition(":")
        fields[label.strip()] = rest.split()
    assert fields["Number of parts"][0] == "1"
    for label in ADMESH_FAULTS:
        assert fields[label][0] == "0", label


needs_admesh = pytest.mark.skipif(shutil.which("admesh") is None, reason="admesh is not on PATH")


@needs_admesh
@pytest.mark.parametrize(
    "name", ["cylinder60", pytest.param("cylinder40", marks=pytest.mark.long), "patch"]
)
def test_admesh_finds_nothing_to_repair(name: str, tmp_path: Path) -> None:
    case = shipped(name)
    sensor = check_design(case)
    write_stl(to_triangles(shell_manifold(sensor)), tmp_path / "shell.stl")
    assert_admesh_finds_nothing(tmp_path / "shell.stl")


@needs_admesh
@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_admesh_finds_nothing_to_repair_on_any_shape(name: str, tmp_path: Path) -> None:
    solid = shell_manifold(Sensor.of(*built(family_design(name))))
    write_stl(to_triangles(solid), tmp_path / "shell.stl")
    assert_admesh_finds_nothing(tmp_path / "shell.stl")


@pytest.mark.skipif(shutil.which("prusa-slicer") is None, reason="prusa-slicer is not on PATH")
@pytest.mark.parametrize(("name", "suffix"), [("hemisphere", "stl"), ("patch", "3mf")])
def test_prusa_slicer_makes_layers_of_domes_and_sheets(
    name: str, suffix: str, tmp_path: Path
) -> None:
    case = built(family_design(name, rows=1, columns=2))
    file, target = tmp_path / f"shell.{suffix}", tmp_path / "shell.gcode"
    if suffix == "stl":
        write_stl(to_triangles(shell_manifold(Sensor.of(*case), tolerance_mm=0.05)), file)
    else:
        painted = painted_manifolds(Sensor.of(*case), tolerance_mm=0.05)
        bodies = {label: to_triangles(body) for label, body in painted.items()}
        write_3mf(bodies, file, name="case")
    command = ["prusa-slicer", "--layer-height", "0.3", "--fill-density", "0%"]
    command += ["--export-gcode", str(file), "-o", str(target)]
    subprocess.run(command, capture_output=True, text=True, check=True)
    assert target.read_text().count("LAYER_CHANGE") > 10
