"""Receptors on the shell: cell models, and whole sensors as solids of the true CAD.

Part ``receptors`` of ``mechanics``; ``python -m benchmarks.mechanics_receptors`` makes the tables
of ``receptor_stiffness``.
"""

import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.mechanics.pressing.contact_patch import ContactPatch
from phytac_design.mechanics.pressing.press import press
from phytac_design.mechanics.shell import receptor_stiffness as rc
from phytac_design.mechanics.shell.compliance import point_motion
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_design.mechanics.solid.load import solid_patch_load
from phytac_design.mechanics.solid.solid_mesh_tets import SolidSizes, coarsened, solid_mesh
from phytac_design.mechanics.solid.solid_writers import write_solid_inp
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import MissingPartError
from verification.calculix import run_ccx
from verification.receptor_cell import Cell, cell_stiffness, ratio
from verification.tip_motion import tip_means

SIZES = SolidSizes(wall_mm=1.6, foot_mm=0.9, tube_mm=1.4, contact_mm=1.2)
"""Mesh of the whole small sensor: about 80 000 nodes."""
FINER = 0.75
CCX = "CalculiX, quadratic tetrahedra of the true CAD (gmsh)"
NU = 0.38
DENSE = "tables are for ν = 0.38 and one area fraction; here ν = 0.3, tubes over 27 % of the wall"
STIFF = "a coarse solid moves too little: at this factor the ø30 sensor 1.6 % of the peak"
CELLS = (  # receptors of cylinder60 (short, middle) and cylinder40, and one off the tables' grid
    ("cylinder60, h 0.5 mm", 5.217, 11.78, 0.8, 0.5, 3.0, 1.6, 0.38),
    ("cylinder60, h 6 mm", 5.217, 11.78, 0.8, 6.0, 3.0, 1.6, 0.38),
    ("cylinder40, h 4 mm", 4.444, 10.47, 0.8, 4.0, 2.4, 1.4, 0.38),
    ("dense, thin wall, nu 0.3", 5.5, 5.5, 0.5, 2.0, 3.2, 2.2, 0.3),
)


def small_sensor() -> Design:
    """ø30 × 30, 4 rows × 10 columns of the receptors of cylinder60: tubes over 10 % of the wall."""
    data = load_design("cylinder60").model_dump(mode="json")
    data["shape"] |= {"diameter_outer_mm": 30.0, "length_mm": 30.0}
    data["layout"] |= {"rows": 4, "columns": 10, "height_near_mm": 1.0, "height_far_mm": 5.5}
    return parse_design(data, "small solid sensor")


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows that Gmsh and CalculiX allow."""
    try:
        cells(table, quick=quick)
        whole_sensor(table, quick=quick)
        if not quick:
            whole_prototype(table)
    except MissingPartError as error:
        print(f"receptor rows left out: {error}", flush=True)


def cells(table: Table, *, quick: bool) -> None:
    """Stiffness of cells over the plain wall, and the option's prediction of it."""
    for name, px, py, t, h, outer, hole, nu in CELLS[: 2 if quick else None]:
        found = cell_stiffness(
            Cell(
                pitch_x_mm=px,
                pitch_y_mm=py,
                thickness_mm=t,
                height_mm=h,
                diameter_outer_mm=outer,
                diameter_hole_mm=hole,
                poisson=nu,
            ),
            size_mm=(0.5 if quick else 0.3) * t,
        )
        share = np.array(np.pi / 4.0 * outer**2 / (px * py))
        effect = rc.receptor_effect(outer / t, hole / outer, h / t)
        for kind, matrix, e, mixing in (
            ("membrane", found.membrane, effect[0], rc.MIXING_MEMBRANE),
            ("bending", found.bending, effect[1], rc.MIXING_BENDING),
        ):
            truth = ratio(matrix, nu)
            row = f"receptor cell ({name}): {kind} stiffness over the plain wall"
            table.add(row, truth, "1", 1.0, CCX)
            row = f"receptor cell ({name}): {kind} stiffness predicted by the shell's option, error"
            note = DENSE if name.startswith("dense") else ""
            value = 100.0 * abs(float(rc.mixture(share, e, mixing)) / truth - 1.0)
            table.add(row, value, "%", truth, CCX, "<= 2", note)


def whole_sensor(table: Table, *, quick: bool) -> None:
    """Tips of a whole sensor under two contacts: shell without and with the option."""
    design = small_sensor()
    surface = design.surface()
    markers = make_markers(design, surface)
    contacts = [("on a receptor, radius 5 mm", markers.uv[15], 5.0)]
    if not quick:
        middle = (markers.uv[15] + markers.uv[16]) / 2.0
        contacts.append(("between receptors, radius 3 mm", middle, 3.0))
    scales = (1.2,) if quick else (1.0, FINER)
    start = time.perf_counter()
    solid = [solid_tips(design, surface, markers, contacts, SIZES.scaled(k)) for k in scales]
    seconds = time.perf_counter() - start
    for refine in (4,) if quick else (4, 16):
        mesh = marker_mesh(surface, markers, thickness_mm=design.wall.thickness_mm, refine=refine)
        wall, modulus = design.wall.thickness_mm, design.material.modulus_MPa
        factors = rc.receptor_stiffness(design, markers, mesh)
        section = factors.section(thickness_mm=wall, modulus_MPa=modulus)
        plain = np.full(len(mesh.quads), wall), np.full(len(mesh.quads), modulus)
        for label, (t, E), target in (
            ("plain shell", plain, None),
            ("shell with receptors", section, "<= 5"),
        ):
            model = clamped_model(
                mesh, modulus_MPa=E, poisson=design.material.poisson, thickness_mm=t
            )
            for k, (name, uv, radius) in enumerate(contacts):
                motion = model.solve(patch_loads(mesh, surface, uv[None], radius)).motion
                tips = point_motion(motion[mesh.marker_nodes], markers.tip_mm - markers.mid_mm)
                row = f"ø30 solid sensor, contact {name}: {label}, refine {refine}, tip error"
                value = error_of_peak(tips[:, :, 0], solid[-1][k])
                table.add(row, value, "% of peak", 0.0, CCX, target)
    if len(solid) > 1:
        for k, (name, _, _) in enumerate(contacts):
            row = f"ø30 solid sensor, contact {name}: change of the solid with {FINER} the size"
            source = "the same on the coarser mesh"
            table.add(row, error_of_peak(solid[0][k], solid[1][k]), "% of peak", 0.0, source)
    table.add("ø30 solid sensor: all meshes and solves", seconds, "s", reference="-", source=CCX)


def whole_prototype(table: Table) -> None:
    """All of cylinder60 as a solid, as ``phytac mesh cylinder60 --solid`` writes it."""
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    uv, radius = markers.uv[184], 6.0
    factor, sizes, _ = coarsened(Sensor.of(design, surface, markers), 2.0)
    start = time.perf_counter()
    truth = solid_tips(design, surface, markers, [("", uv, radius)], sizes)[0]
    seconds = time.perf_counter() - start
    name = f"cylinder60 whole solid, sizes × {factor:.2g}"
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    table.add(f"{name}: CAD, mesh and CalculiX", seconds, "s", reference="-", source=CCX)
    table.add(f"{name}: memory of CalculiX", memory, "GB", reference="-", source=CCX)
    place = ContactPatch(uv=uv, radius_mm=radius, force_N=1.0)
    for refine in (4, 6):
        for receptors, how, target in (
            (False, "plain shell", None),
            (True, "shell with receptors", "<= 5"),
        ):
            result = press(
                Sensor.of(design, surface, markers),
                place,
                theory="linear",
                refine=refine,
                receptors=receptors,
            )
            row = f"{name}, fingertip of 6 mm: {how}, refine {refine}, tip error"
            value = error_of_peak(result.tip_mm, truth)
            table.add(row, value, "% of peak", 0.0, CCX, target, STIFF)


def error_of_peak(ours: FloatArray, truth: FloatArray) -> float:
    """Largest distance of tips (n, 3) in percent of the largest true motion."""
    gap = np.linalg.norm(ours - truth, axis=1).max()
    return float(100.0 * gap / np.linalg.norm(truth, axis=1).max())


def solid_tips(
    design: Design,
    surface: Surface,
    markers: Markers,
    contacts: list[tuple[str, FloatArray, float]],
    sizes: SolidSizes,
) -> list[FloatArray]:
    """Motion (n, 3) of all tips per newton, mm, one for each contact."""
    mesh = solid_mesh(
        Sensor.of(design, surface, markers),
        sizes=sizes,
        contacts_uv=np.array([uv for _, uv, _ in contacts]),
        contact_radius_mm=max(radius for _, _, radius in contacts),
    )
    mean: Any = tip_means(mesh)
    out = []
    for _, uv, radius in contacts:
        with tempfile.TemporaryDirectory() as folder:
            path = write_solid_inp(
                Path(folder) / "sensor.inp",
                mesh,
                modulus_MPa=design.material.modulus_MPa,
                poisson=design.material.poisson,
                load=solid_patch_load(mesh, surface, uv, radius),
                name=design.name,
            )
            nodes, found = run_ccx(path)[0]["displacements", "TIPS"]
        motion = np.zeros_like(mesh.nodes_mm)
        motion[nodes] = found
        out.append(np.asarray(mean @ motion))
    return out


def effect_tables() -> None:
    """Print the tables of ``receptor_stiffness`` (about ten minutes)."""
    shape = (len(rc.DIAMETER_OVER_T), len(rc.HOLE_OVER_DIAMETER), len(rc.HEIGHT_OVER_T))
    membrane, bending = np.zeros(shape), np.zeros(shape)
    share = np.pi / 4.0 / 2.56**2
    for at in np.ndindex(*shape):
        d, q, h = (
            float(axis[i])
            for axis, i in zip(
                (rc.DIAMETER_OVER_T, rc.HOLE_OVER_DIAMETER, rc.HEIGHT_OVER_T), at, strict=True
            )
        )
        if q == 0.0 and h == 0.0:
            continue
        found = cell_stiffness(
            Cell(
                pitch_x_mm=2.56 * d,
                pitch_y_mm=2.56 * d,
                thickness_mm=1.0,
                height_mm=h,
                diameter_outer_mm=d if h else 0.0,
                diameter_hole_mm=q * d,
                poisson=NU,
            ),
            size_mm=0.3 * float(np.sqrt(max(d / 3.0, 1.0))),
        )
        for out, matrix, mixing in (
            (membrane, found.membrane, rc.MIXING_MEMBRANE),
            (bending, found.bending, rc.MIXING_BENDING),
        ):
            gain = ratio(matrix, NU) - 1.0
            out[at] = gain / (share * (1.0 + mixing * gain))
    for name, values in (("EFFECT_MEMBRANE", membrane), ("EFFECT_BENDING", bending)):
        print(f"{name} = np.array({np.array2string(values, precision=3, separator=', ')})")


if __name__ == "__main__":
    effect_tables()
