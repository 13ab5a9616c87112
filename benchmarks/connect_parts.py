"""Exported parts of all shipped designs, loaded by the programs of each format.

Their collision pieces are compared with the solid's outer hull.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import manifold3d
import mujoco
import numpy as np
from pxr import Usd, UsdGeom, UsdPhysics

from benchmarks.connect_loaders import (
    Loaded,
    has_sdformat,
    in_bullet,
    in_sdformat,
    in_yourdfpy,
    written,
)
from benchmarks.harness import Table
from benchmarks.outer_hull import outer_hull_mm3
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.fabrication.simulators.model_files import mjcf, piece_file, visual_file
from phytac_design.fabrication.simulators.simulator_part import SimulatorPart, make_part
from phytac_design.fabrication.simulators.usd_stage import usd
from phytac_design.fabrication.simulators.xml_values import obj_text
from phytac_design.fabrication.switch_set import revolved_volume_mm3
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import hull, shell_manifold
from phytac_design.workflows.export_simulator import switches_for

RESIN_kg_mm3, RUBBER_kg_mm3 = 1150e-9, 1100e-9


def exported(table: Table, *, quick: bool) -> None:
    """Mass, inertia and frames of the parts as other programs have them."""
    for name in ["plane"] if quick else shipped_designs():
        sensor = Sensor(load_design(name))
        switches = switches_for(sensor.design, lambda _: None)
        weight_kg = RESIN_kg_mm3 * shell_manifold(sensor).volume()
        if switches:
            for kind in switches.kinds:
                each = revolved_volume_mm3(switches.profile(kind))
                weight_kg += RUBBER_kg_mm3 * len(switches.markers_of(kind)) * each
        part = make_part(sensor, switches)
        body, sites_m, said = in_mujoco(part)
        table.goal(f"{name}: warnings of MuJoCo", len(said), "", "== 0", note="; ".join(said))
        mass = body["mass"]
        table.goal(
            f"{name}: mass in MuJoCo less volume times density",
            100.0 * abs(mass / weight_kg - 1.0),
            "%",
            "<= 0.5",
            source="the shell's solid and the switches as bodies of revolution",
        )
        moments = np.linalg.eigvalsh(part.mass.inertia_kg_m2)
        table.goal(
            f"{name}: inertia less MuJoCo's own integral over the meshes",
            100.0 * float(np.abs(body["moments"] / moments - 1.0).max()),
            "%",
            "<= 1.0",
        )
        errors, usd_m, usd_kg = in_usd(part)
        table.goal(f"{name}: composition errors of OpenUSD", errors, "", "== 0")
        table.goal(
            f"{name}: mass in OpenUSD less volume times density",
            100.0 * abs(usd_kg / weight_kg - 1.0),
            "%",
            "<= 0.5",
        )
        off = max(float(np.abs(at - part.receptors_m).max()) for at in (sites_m, usd_m))
        table.goal(
            f"{name}: receptors in MuJoCo and OpenUSD less the markers, largest",
            1e3 * off,
            "mm",
            "<= 1e-06",
        )
        with TemporaryDirectory() as folder:
            for program, loaded in in_other_programs(part, Path(folder)).items():
                loaded_rows(
                    table, f"{name}, {program}: {{}}", loaded, part, weight_kg, body["moments"]
                )
        union = manifold3d.Manifold.batch_boolean(
            [hull(piece.vertices_mm) for piece in part.pieces], manifold3d.OpType.Add
        )
        table.goal(
            f"{name}: union of the collision pieces less the solid's outer hull",
            100.0 * abs(union.volume() / outer_hull_mm3(sensor) - 1.0),
            "%",
            "<= 5.0",
            source="sections of the wall's solid, or Steiner's formula for a sheet",
            note=f"{len(part.pieces)} convex pieces",
        )


def in_other_programs(part: SimulatorPart, folder: Path) -> dict[str, Loaded]:
    """URDF and SDF in the programs that are installed here."""
    urdf = written(part, folder / "yourdfpy", "urdf", receptors=True)
    found = {"yourdfpy (URDF)": in_yourdfpy(urdf, len(part.receptors_m))}
    # As exported by default: without receptors, each of which is a link.
    found["PyBullet (URDF)"] = in_bullet(written(part, folder / "bullet", "urdf", receptors=False))
    if has_sdformat():
        sdf = written(part, folder / "sdf", "sdf", receptors=True)
        found["libsdformat (SDF)"] = in_sdformat(sdf)
    return found


def loaded_rows(
    table: Table, case: str, loaded: Loaded, part: SimulatorPart, weight_kg: float, moments: Any
) -> None:
    """Rows of a part in a program: what it says, mass, inertia, receptors."""
    table.goal(
        case.format("warnings"), len(loaded.said), "", "== 0", note="; ".join(loaded.said[:3])
    )
    if loaded.pieces >= 0:
        missing = len(part.pieces) - loaded.pieces
        table.goal(case.format("collision pieces that are missing"), missing, "", "== 0")
    error = 100.0 * abs(loaded.mass_kg / weight_kg - 1.0)
    table.goal(case.format("mass less volume times density"), error, "%", "<= 0.5")
    error = 100.0 * float(np.abs(loaded.moments / moments - 1.0).max())
    table.goal(case.format("inertia less MuJoCo's integral"), error, "%", "<= 1.0")
    if loaded.receptors_m is not None:
        error = 1e3 * float(np.abs(loaded.receptors_m - part.receptors_m).max())
        table.goal(case.format("receptors less the markers"), error, "mm", "<= 1e-06")


def in_mujoco(part: SimulatorPart) -> tuple[dict[str, Any], Any, list[str]]:
    """The base's mass, and moments by MuJoCo's integral; places of sites; what it says."""
    files = {visual_file(name): mesh for name, (mesh, _) in part.visuals.items()}
    files |= {piece_file(number): mesh for number, mesh in enumerate(part.pieces)}
    assets = {name: obj_text(mesh).encode() for name, mesh in files.items()}
    text = mjcf(part, receptors=True, prefix="")[f"{part.name}.xml"]
    said: list[str] = []
    mujoco.set_mju_user_warning(said.append)
    model = mujoco.MjModel.from_xml_string(text, assets)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mujoco.set_mju_user_warning(None)
    sites = [model.site(f"receptor_{k}").id for k in range(len(part.receptors_m))]
    base = model.body("base").id
    spec = mujoco.MjSpec()
    spec.assets = assets
    whole = spec.worldbody.add_body()
    for name in part.visuals:
        file = visual_file(name)
        exact = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
        spec.add_mesh(name=name, file=file, inertia=exact)
        density = 1e9 * (RUBBER_kg_mm3 if name == "switches" else RESIN_kg_mm3)
        whole.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, density=density)
    own = spec.compile()
    moments = np.sort(own.body_inertia[1])
    return {"mass": float(model.body_mass[base]), "moments": moments}, data.site_xpos[sites], said


def in_usd(part: SimulatorPart) -> tuple[int, Any, float]:
    """Errors of OpenUSD, places of receptors (m), and the mass."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(usd(part, receptors=True, prefix="")[f"{part.name}.usda"])
    base, cache = stage.GetDefaultPrim().GetPath().AppendChild("base"), UsdGeom.XformCache()
    places = [
        cache.GetLocalToWorldTransform(stage.GetPrimAtPath(base.AppendChild(f"receptor_{k}")))
        for k in range(len(part.receptors_m))
    ]
    at = np.array([np.array(matrix)[3, :3] for matrix in places])
    mass = UsdPhysics.MassAPI(stage.GetPrimAtPath(base)).GetMassAttr().Get()
    return len(stage.GetCompositionErrors()), at, float(mass)
