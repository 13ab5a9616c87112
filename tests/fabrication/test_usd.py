"""A part as USD, read by OpenUSD itself."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.fabrication.simulators.simulator_part import MassProperties, make_part
from phytac_design.fabrication.simulators.usd_stage import usd
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.workflows.export_simulator import export_simulator
from tests.designs import tiny
from tests.refusals import refused

pytest.importorskip("pxr", reason="usd-core is not installed (extra usd)")


def design() -> Any:
    lens = {"model": "brown_conrady", "distortion": (-0.1, 0.02, 1e-3, -2e-3)}
    return tiny(
        name="grip-1",
        receptor={"diameter_hole_mm": 0.0},
        camera=lens | {"centre_offset_px": (3.0, -2.0), "fill": 0.9},
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("usd") / "part"
    export_simulator(design(), out, to="usd", progress=lambda _: None)
    return out


@pytest.fixture
def stage(folder: Path) -> Any:
    from pxr import Usd

    return Usd.Stage.Open(str(folder / "grip-1.usda"))


def test_the_stage_is_one_file_in_metres(folder: Path, stage: Any) -> None:
    from pxr import UsdGeom, UsdPhysics

    assert sorted(path.name for path in folder.iterdir()) == ["export.json", "grip-1.usda"]
    assert stage.GetDefaultPrim().GetPath() == "/grip_1"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert not stage.GetCompositionErrors()


def test_mass_and_inertia(folder: Path, stage: Any) -> None:
    from pxr import UsdPhysics

    facts = json.loads((folder / "export.json").read_text())
    body = stage.GetPrimAtPath("/grip_1/base")
    assert body.HasAPI(UsdPhysics.RigidBodyAPI)
    mass = UsdPhysics.MassAPI(body)
    assert mass.GetMassAttr().Get() == pytest.approx(facts["mass_kg"], rel=1e-6)
    assert facts["mass_kg"] == pytest.approx(
        1150e-9 * shell_manifold(Sensor(design())).volume(), rel=5e-3
    )
    assert mass.GetCenterOfMassAttr().Get() == pytest.approx(facts["centre_m"], abs=1e-8)
    size = np.abs(facts["inertia_kg_m2"]).max()
    assert inertia_of(mass) == pytest.approx(np.array(facts["inertia_kg_m2"]), abs=1e-5 * size)


def test_inertia_along_no_axis_of_the_base() -> None:
    from pxr import Usd, UsdPhysics

    tilted = rotation(np.array([0.8, 0.36, 0.48, 0.0])) @ np.diag([1.0, 2.0, 2.5])
    tilted = tilted @ rotation(np.array([0.8, 0.36, 0.48, 0.0])).T
    mass = MassProperties(mass_kg=1.0, centre_m=np.zeros(3), inertia_kg_m2=tilted)
    part = replace(make_part(Sensor(design()), None), mass=mass)
    text = usd(part, receptors=False, prefix="")["grip-1.usda"]
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(text)
    found = inertia_of(UsdPhysics.MassAPI(stage.GetPrimAtPath("/grip_1/base")))
    assert found == pytest.approx(tilted, abs=1e-5)
    assert not stage.GetPrimAtPath("/grip_1/base/receptor_0")


def inertia_of(mass: Any) -> Any:
    """Inertia (3, 3) along the axes of the body."""
    turn = mass.GetPrincipalAxesAttr().Get()
    x, y, z = turn.GetImaginary()
    axes = rotation(np.array([turn.GetReal(), x, y, z]))
    return axes @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ axes.T


def rotation(wxyz: Any) -> Any:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()


def test_frames_are_where_the_design_has_them(stage: Any) -> None:
    from pxr import UsdGeom

    sensor, cache = Sensor(design()), UsdGeom.XformCache()
    shift = np.array([0.0, 0.0, 4.0])  # the near rim ends so much before the sensing surface

    def frame(name: str) -> tuple[Any, Any]:
        prim = stage.GetPrimAtPath(f"/grip_1/base/{name}")
        # USD multiplies rows with matrices.
        matrix = np.array(cache.GetLocalToWorldTransform(prim))
        return 1e3 * matrix[3, :3], matrix[:3, :3].T

    points = sensor.surface.point(sensor.markers.uv) + shift
    for number, point in enumerate(points):
        at, axes = frame(f"receptor_{number}")
        assert np.abs(at - point).max() < 1e-6
        assert axes[:, 2] == pytest.approx(sensor.markers.normal[number], abs=1e-9)
    at, axes = frame("camera_optical")
    assert at == pytest.approx(sensor.cameras[0].position_mm + shift, abs=1e-6)
    assert axes == pytest.approx(sensor.cameras[0].rotation.T, abs=1e-9)
    _, looking = frame("camera")
    assert looking[:, 2] == pytest.approx(-axes[:, 2], abs=1e-9)


def test_the_camera_sees_what_the_lens_does(stage: Any) -> None:
    from pxr import Gf, UsdGeom

    lens = Sensor(design()).cameras[0].lens
    prim = UsdGeom.Camera(stage.GetPrimAtPath("/grip_1/base/camera"))
    window = prim.GetCamera().frustum.GetWindow()  # at a distance of 1
    assert isinstance(window, Gf.Range2d)
    scale = lens.fx_px
    left, low = scale * window.GetMin()[0], scale * window.GetMin()[1]
    right, high = scale * window.GetMax()[0], scale * window.GetMax()[1]
    assert left == pytest.approx(-(lens.cx_px + 0.5), abs=1e-2)
    assert right == pytest.approx(lens.width_px - lens.cx_px - 0.5, abs=1e-2)
    assert high == pytest.approx(lens.cy_px + 0.5, abs=1e-2)
    assert low == pytest.approx(-(lens.height_px - lens.cy_px - 0.5), abs=1e-2)


def test_meshes_and_collisions(folder: Path, stage: Any) -> None:
    from pxr import UsdGeom, UsdPhysics

    facts = json.loads((folder / "export.json").read_text())

    def volume_mm3(name: str) -> float:
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/grip_1/base/{name}"))
        points = 1e3 * np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
        corners = points[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)]
        assert set(mesh.GetFaceVertexCountsAttr().Get()) == {3}
        assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
        return float(np.linalg.det(corners).sum() / 6.0)

    names = [prim.GetName() for prim in stage.GetPrimAtPath("/grip_1/base").GetChildren()]
    shown = [name for name in names if name.startswith("visual_")]
    assert shown == ["visual_resin", "visual_blue", "visual_green"]
    resin = sum(volume_mm3(name) for name in shown)
    assert resin == pytest.approx(shell_manifold(Sensor(design())).volume(), rel=5e-3)
    pieces = [name for name in names if name.startswith("collision_")]
    assert len(pieces) == facts["collision_pieces"]
    total = sum(volume_mm3(name) for name in pieces)
    assert total == pytest.approx(facts["collision_volume_mm3"], rel=1e-5)
    for name in names:
        prim = stage.GetPrimAtPath(f"/grip_1/base/{name}")
        assert prim.HasAPI(UsdPhysics.CollisionAPI) == (name in pieces)
    hull = UsdPhysics.MeshCollisionAPI(stage.GetPrimAtPath("/grip_1/base/collision_0"))
    assert hull.GetApproximationAttr().Get() == "convexHull"


def test_the_same_design_gives_the_same_file(folder: Path, tmp_path: Path) -> None:
    export_simulator(design(), tmp_path / "part", to="usd", progress=lambda _: None)
    assert (tmp_path / "part" / "grip-1.usda").read_bytes() == (folder / "grip-1.usda").read_bytes()


def test_without_usd_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with refused("missing-library") as found:
        export_simulator(design(), tmp_path / "part", to="usd", progress=lambda _: None)
    assert "phytac-design[usd]" in str(found.value)
    assert not (tmp_path / "part").exists()
