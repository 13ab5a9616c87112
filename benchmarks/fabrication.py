"""Shell: facts, closed forms, mesh against CAD, time to STL by both routes, STEP, outside programs.

Run ``python -m benchmarks.fabrication`` (``--quick`` for a smoke run, not written).
"""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import (
    fabrication_effort,
    fabrication_families,
    fabrication_inserts,
    fabrication_inspect,
    fabrication_parts,
    fabrication_strips,
    fabrication_switch,
)
from benchmarks.fabrication_parts import repair_row, slice_row
from benchmarks.harness import Table, median_of, run_parts
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import WallSection
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.solids.cad import cad_facts, shell_cad, write_step
from phytac_design.solids.mesh_export import write_3mf, write_stl
from phytac_design.solids.mesh_facts import expected_genus, manifold_facts, trimesh_facts
from phytac_design.solids.solid_mesh import (
    TOLERANCE_mm,
    painted_manifolds,
    shell_manifold,
    to_triangles,
)
from phytac_design.solids.wall_mesh import wall_mesh
from tests.fabrication.cad_files import read_step, write_stl_by_cad

ANGLE_rad = 0.5
"""Angular tolerance of OpenCASCADE's mesher: loose, so that the chord alone decides."""


def load(name: str, *, rows: int | None = None) -> Sensor:
    """Read a shipped design, checked; ``rows`` shortens the lattice for a smoke run."""
    design = load_design(name)
    if rows is not None:
        layout = design.layout.model_copy(update={"rows": rows})
        design = design.model_copy(update={"layout": layout})
    return check_design(design)


def facts(table: Table, case: Sensor) -> None:
    """Facts of the mesh, by manifold3d and by trimesh, against what the holes make them."""
    design, surface, markers = case.design, case.surface, case.markers
    solid = shell_manifold(case)
    genus = expected_genus(surface, markers)
    for program, found in (
        ("manifold3d", manifold_facts(solid)),
        ("trimesh", trimesh_facts(to_triangles(solid))),
    ):
        label = f"{design.name}, {program}"
        row = f"{label}: watertight"
        table.add(row, float(found.watertight), "-", 1, "every edge has two triangles", "== 1")
        table.add(f"{label}: bodies", found.bodies, "-", 1, "one printed part", "== 1")
        row = f"{label}: genus"
        source = "tube 1, dome and sheet 0, + one for each through-hole (derived here)"
        table.add(row, found.genus, "-", genus, source, f"== {genus}")
    row = f"{design.name}: triangles"
    source = "within this distance (mm) of the true faces"
    table.add(row, int(solid.num_tri()), "-", TOLERANCE_mm, source)
    tiles = sum(body.volume() for body in painted_manifolds(case).values())
    row = f"{design.name}: resin and paints against shell, volume"
    value = abs(tiles / solid.volume() - 1.0)
    table.add(row, value, "relative", float(solid.volume()), "shell, mm3", "<= 1e-9")


def wall(table: Table) -> None:
    """Wall of cylinder60 against the closed form, without and with rims."""
    surface = load("cylinder60").surface
    bare = np.pi * (30.0**2 - 29.2**2) * 120.0
    rims = 2.0 * np.pi * (31.6**2 - 29.2**2) * 4.0
    for label, section, closed in (
        ("wall", WallSection(rim_length_mm=0.0), bare),
        ("wall and rims", WallSection(), bare + rims),
    ):
        volume = wall_mesh(surface, section, tolerance_mm=TOLERANCE_mm).volume_mm3
        row = f"cylinder60: {label} against closed form"
        source = "π(R² − r²)·L, mm3"
        table.add(row, abs(volume / closed - 1.0), "relative", closed, source, "<= 1e-5")


def routes(table: Table, case: Sensor, folder: Path) -> None:
    """Time design → STL by manifold3d and by CadQuery/OCC in the same run, and STEP."""
    design = case.design
    check = median_of(lambda: check_design(design))
    table.add(f"{design.name}: rules", 1e3 * check, "ms", reference="-", source="median of 5")
    mesh_time = median_of(
        lambda: write_stl(to_triangles(shell_manifold(case)), folder / "shell.stl")
    )
    cad_facts(shell_cad(load("cylinder60", rows=1)))  # imports are not timed
    start = time.perf_counter()
    solid = shell_cad(case)
    solid_time = time.perf_counter() - start
    write_stl_by_cad(solid, folder / "occ.stl", tolerance_mm=TOLERANCE_mm, angle_rad=ANGLE_rad)
    cad_time = time.perf_counter() - start
    start = time.perf_counter()
    write_step(solid, folder / "shell.step", name=design.name)
    step_time = time.perf_counter() - start
    source = f"chord {TOLERANCE_mm} mm both, same run; OCC once, mesh median of 5"
    table.add(f"{design.name}: STL by manifold3d", mesh_time, "s", reference="-", source=source)
    table.add(f"{design.name}: STL by CadQuery/OCC", cad_time, "s", reference="-", source=source)
    row = f"{design.name}: STL, CadQuery/OCC over manifold3d"
    table.add(row, cad_time / mesh_time, "ratio", cad_time, source, ">= 8")
    row = f"{design.name}: STEP, solid and file"
    table.add(row, solid_time + step_time, "s", "-", "one fuse, one cut, no pcurves", "<= 15")
    agreement(table, case, solid, folder)
    sizes(table, design.name, folder)


def agreement(table: Table, case: Sensor, solid: Any, folder: Path) -> None:
    """Volumes of mesh, CAD solid, and STEP file opened again; validity."""
    name, mine, again = (
        case.design.name,
        cad_facts(solid),
        cad_facts(read_step(folder / "shell.step")),
    )
    mesh = shell_manifold(case).volume()
    row = f"{name}: volume, manifold3d against OCC"
    source = "OpenCASCADE GProp, mm3"
    value = abs(mesh / mine.volume_mm3 - 1.0)
    table.add(row, value, "relative", mine.volume_mm3, source, "<= 0.001")
    row = f"{name}: volume, STEP opened again"
    source = "before writing, mm3"
    value = abs(again.volume_mm3 / mine.volume_mm3 - 1.0)
    table.add(row, value, "relative", mine.volume_mm3, source, "<= 0.0001")
    for label, found in (("CAD", mine), ("STEP opened again", again)):
        row = f"{name}: {label} valid, one solid"
        table.add(row, float(found.valid and found.solids == 1), "-", 1, "BRepCheck", "== 1")


def sizes(table: Table, name: str, folder: Path) -> None:
    """Size of our STL against OCC's at the same chord."""
    ours, theirs = ((folder / file).stat().st_size for file in ("shell.stl", "occ.stl"))
    row = f"{name}: STL size against OCC's"
    table.add(row, ours / theirs, "ratio", theirs, f"bytes of OCC's STL, angle {ANGLE_rad} rad")


def outside(table: Table, case: Sensor, folder: Path) -> None:
    """Run admesh and prusa-slicer on the files as they are."""
    label, stl = f"{case.design.name}: ", folder / "shell.stl"
    write_stl(to_triangles(shell_manifold(case)), stl)
    bodies = {name: to_triangles(body) for name, body in painted_manifolds(case).items()}
    write_3mf(bodies, folder / "shell.3mf", name=case.design.name)
    repair_row(table, label, [stl])
    slice_row(table, label, [stl, folder / "shell.3mf"])


def shapes_rows(table: Table, names: list[str], folder: Path, *, rows: int | None = None) -> None:
    """Every other shape: facts, wall against closed form, both kernels, STEP, outside programs."""
    for name in names:
        case = load(name, rows=rows)
        facts(table, case)
        bare_wall(table, case)
        start = time.perf_counter()
        solid = shell_cad(case)
        write_step(solid, folder / "shell.step", name=name)
        seconds = time.perf_counter() - start
        row = f"{name}: STEP, solid and file"
        table.add(row, seconds, "s", case.markers.count, "receptors; one fuse, one cut, no pcurves")
        agreement(table, case, solid, folder)
        outside(table, case, folder)


def bare_wall(table: Table, case: Sensor) -> None:
    """Wall without rims against offset areas integrated through it (Steiner)."""
    design, surface = case.design, case.surface
    thickness = design.wall.thickness_mm
    x, w = np.polynomial.legendre.leggauss(3)
    areas = [surface.area_mm2(-thickness * (node + 1.0) / 2.0) for node in x]
    closed = thickness / 2.0 * float(w @ np.array(areas))
    section = design.wall.model_copy(update={"rim_length_mm": 0.0})
    volume = wall_mesh(surface, section, tolerance_mm=TOLERANCE_mm).volume_mm3
    row = f"{design.name}: wall against closed form"
    source = "offset areas integrated through the wall, mm3"
    table.add(row, abs(volume / closed - 1.0), "relative", closed, source, "<= 0.001")


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` shortens the lattices and takes fewer shapes."""
    main_case = load("cylinder60", rows=4 if quick else None)
    wall(table)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        facts(table, main_case)
        routes(table, main_case, folder)
        outside(table, main_case, folder)
        if quick:
            shapes_rows(table, ["plane"], folder, rows=3)
            return
        dense = load("cylinder60-dense")
        routes(table, dense, folder)
        other = load("cylinder40")
        facts(table, other)
        outside(table, other, folder)
        rest = [item for item in shipped_designs() if not item.startswith("cylinder")]
        shapes_rows(table, rest, folder)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""
    return {
        "shells": partial(add_rows, quick=quick),
        "effort": partial(fabrication_effort.add_rows, quick=quick),
        "printing": partial(fabrication_parts.printing_rows, quick=quick),
        "switch": partial(fabrication_switch.add_rows, quick=quick),
        "families": partial(fabrication_families.add_rows, quick=quick),
        "family decoders": partial(fabrication_families.decoder_rows, quick=quick),
        "family frames": partial(fabrication_families.frame_rows, quick=quick),
        "molds": partial(fabrication_parts.mold_rows, quick=quick),
        "strips": partial(fabrication_strips.add_rows, quick=quick),
        "strip-coupling": partial(fabrication_strips.coupling_rows, quick=quick),
        "strip files": partial(fabrication_strips.file_rows, quick=quick),
        "hardware": partial(fabrication_parts.hardware_rows, quick=quick),
        "inserts": partial(fabrication_inserts.add_rows, quick=quick),
        "insert trials": partial(fabrication_inserts.add_trials, quick=quick),
        "inspect": partial(fabrication_inspect.add_rows, quick=quick),
    }


if __name__ == "__main__":
    run_parts("fabrication", parts, (__doc__ or "").split("\n", 1)[0])
