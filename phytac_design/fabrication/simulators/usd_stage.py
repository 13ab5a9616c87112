"""A sensor as a stage of USD with physics, for Isaac Sim and other readers of OpenUSD."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from phytac_design.fabrication.simulators.model_files import BASE, CLIP_m
from phytac_design.fabrication.simulators.simulator_part import (
    CameraFrame,
    MassProperties,
    SimulatorPart,
)
from phytac_design.fabrication.simulators.xml_values import quaternion
from phytac_design.geometry.triangles import TriangleMesh
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import MissingPartError

PIXEL_mm = 1e-3
"""Side of a camera's pixel: only the ratio of its image to the focal length matters."""


def usd(part: SimulatorPart, *, receptors: bool, prefix: str) -> dict[str, str]:
    """``NAME.usda``: the rigid body ``base`` with its meshes, collisions, cameras and frames.

    Meshes are part of the file, so that ``prefix`` has no use. Lengths are metres, masses
    kilograms, and z is up.

    Raises
    ------
    MissingPartError
        If usd-core is not installed.
    """
    del prefix
    pxr = usd_library()
    stage = pxr.Usd.Stage.CreateInMemory(f"{part.name}.usda")
    pxr.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    pxr.UsdGeom.SetStageUpAxis(stage, pxr.UsdGeom.Tokens.z)
    pxr.UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = pxr.UsdGeom.Xform.Define(stage, f"/{_identifier(pxr, part.name)}")
    stage.SetDefaultPrim(root.GetPrim())
    pxr.Usd.ModelAPI(root).SetKind(pxr.Kind.Tokens.component)
    base = root.GetPath().AppendChild(BASE)
    body = pxr.UsdGeom.Xform.Define(stage, base).GetPrim()
    pxr.UsdPhysics.RigidBodyAPI.Apply(body)
    _put_mass(pxr, body, part.mass)
    for name, (mesh, colour) in part.visuals.items():
        shown = _put_mesh(pxr, stage, base.AppendChild(f"visual_{_identifier(pxr, name)}"), mesh)
        red, green, blue, opacity = (round(share / 255.0, 4) for share in colour)
        shown.CreateDisplayColorAttr([pxr.Gf.Vec3f(red, green, blue)])
        shown.CreateDisplayOpacityAttr([opacity])
    for number, mesh in enumerate(part.pieces):
        piece = _put_mesh(pxr, stage, base.AppendChild(f"collision_{number}"), mesh)
        piece.CreatePurposeAttr(pxr.UsdGeom.Tokens.guide)
        pxr.UsdPhysics.CollisionAPI.Apply(piece.GetPrim())
        hull = pxr.UsdPhysics.MeshCollisionAPI.Apply(piece.GetPrim())
        hull.CreateApproximationAttr(pxr.UsdPhysics.Tokens.convexHull)
    for camera in part.cameras:
        frame = base.AppendChild(f"{camera.name}_optical")
        _put_frame(pxr, pxr.UsdGeom.Xform.Define(stage, frame), camera.position_m, camera.rotation)
        _put_camera(pxr, pxr.UsdGeom.Camera.Define(stage, base.AppendChild(camera.name)), camera)
    if receptors:
        for number, at in enumerate(part.receptors_m):
            frame = pxr.UsdGeom.Xform.Define(stage, base.AppendChild(f"receptor_{number}"))
            _put_frame(pxr, frame, at, part.receptor_rotation[number])
    return {f"{part.name}.usda": stage.GetRootLayer().ExportToString()}


def usd_library() -> Any:
    """The parts of pxr that are used here.

    Raises
    ------
    MissingPartError
        If usd-core is not installed.
    """
    try:
        from pxr import Gf, Kind, Tf, Usd, UsdGeom, UsdPhysics, Vt
    except ImportError:
        raise MissingPartError.of_library("USD", "usd-core", "usd") from None
    return SimpleNamespace(
        Gf=Gf, Kind=Kind, Tf=Tf, Usd=Usd, UsdGeom=UsdGeom, UsdPhysics=UsdPhysics, Vt=Vt
    )


def _identifier(pxr: Any, name: str) -> str:
    """A name as USD allows it: letters, digits and underscores."""
    return str(pxr.Tf.MakeValidIdentifier(name))


def _put_mass(pxr: Any, body: Any, mass: MassProperties) -> None:
    """Mass, its centre, and inertia along its principal axes."""
    moments, axes = np.linalg.eigh(mass.inertia_kg_m2)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    api = pxr.UsdPhysics.MassAPI.Apply(body)
    api.CreateMassAttr(mass.mass_kg)
    api.CreateCenterOfMassAttr(pxr.Gf.Vec3f(*mass.centre_m.tolist()))
    api.CreateDiagonalInertiaAttr(pxr.Gf.Vec3f(*moments.tolist()))
    api.CreatePrincipalAxesAttr(pxr.Gf.Quatf(*quaternion(axes).tolist()))


def _put_mesh(pxr: Any, stage: Any, path: Any, mesh: TriangleMesh) -> Any:
    """Triangles in metres, flat as they are."""
    points = (1e-3 * mesh.vertices_mm).astype(np.float32)
    out = pxr.UsdGeom.Mesh.Define(stage, path)
    out.CreatePointsAttr(pxr.Vt.Vec3fArray.FromNumpy(points))
    out.CreateFaceVertexCountsAttr(pxr.Vt.IntArray(len(mesh.triangles), 3))
    corners = np.ascontiguousarray(mesh.triangles.ravel(), dtype=np.int32)
    out.CreateFaceVertexIndicesAttr(pxr.Vt.IntArray.FromNumpy(corners))
    out.CreateSubdivisionSchemeAttr(pxr.UsdGeom.Tokens.none)
    ends = np.stack([points.min(axis=0), points.max(axis=0)])
    out.CreateExtentAttr(pxr.Vt.Vec3fArray.FromNumpy(ends))
    return out


def _put_frame(pxr: Any, frame: Any, position_m: FloatArray, rotation: FloatArray) -> None:
    """Place something in the base."""
    frame.AddTranslateOp(pxr.UsdGeom.XformOp.PrecisionDouble).Set(
        pxr.Gf.Vec3d(*position_m.tolist())
    )
    frame.AddOrientOp(pxr.UsdGeom.XformOp.PrecisionDouble).Set(
        pxr.Gf.Quatd(*quaternion(rotation).tolist())
    )


def _put_camera(pxr: Any, prim: Any, camera: CameraFrame) -> None:
    """USD's camera looks along -z with y up, and has no distortion."""
    _put_frame(pxr, prim, camera.position_m, camera.rotation @ np.diag([1.0, -1.0, -1.0]))
    lens = camera.lens
    # Pixels are square there: the picture is as high as the angles say.
    squeeze = lens.fx_px / lens.fy_px
    # From the axis to the middle of the picture, right and up.
    right = lens.width_px / 2.0 - lens.cx_px - 0.5
    up = (lens.cy_px + 0.5 - lens.height_px / 2.0) * squeeze
    prim.CreateFocalLengthAttr(PIXEL_mm * lens.fx_px)
    prim.CreateHorizontalApertureAttr(PIXEL_mm * lens.width_px)
    prim.CreateVerticalApertureAttr(PIXEL_mm * lens.height_px * squeeze)
    prim.CreateHorizontalApertureOffsetAttr(PIXEL_mm * right)
    prim.CreateVerticalApertureOffsetAttr(PIXEL_mm * up)
    prim.CreateClippingRangeAttr(pxr.Gf.Vec2f(*CLIP_m))
