"""Print rules: planted faults, shipped designs, build directions, shells larger than the bed."""

import time
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.fabrication.printing.check import PrintReport, check_shell
from phytac_design.fabrication.printing.overhang import stand, suggest
from phytac_design.fabrication.printing.parting import part_shell
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import TriangleMesh, prisms
from phytac_design.layout import Markers
from phytac_design.rules.check import check_design
from phytac_design.solids.mesh_export import read_stl, write_stl
from phytac_design.solids.mesh_facts import trimesh_facts
from phytac_design.solids.solid_mesh import shell_manifold, to_manifold, to_triangles
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray

CheckedDesign = tuple[Design, Surface, Markers]
BOX = (
    (0, 3, 2), (0, 2, 1), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4),
    (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7),
)  # fmt: skip
LOCATED_mm = 0.5


def load(name: str, **changes: Any) -> CheckedDesign:
    """Read a shipped design with changes of its tables, checked."""
    data = load_design(name).model_dump()
    for table, values in changes.items():
        data[table] = {**data[table], **values}
    design = Design.model_validate(data)
    return design, *check_design(design)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Any:
    """Block between two corners."""
    x0, y0, z0, x1, y1, z1 = (*low, *high)
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    vertices = np.array([(*c, z0) for c in corners] + [(*c, z1) for c in corners])
    return to_manifold(TriangleMesh(vertices_mm=vertices, triangles=np.array(BOX)))


def rod(start: FloatArray, end: FloatArray, diameter_mm: float) -> Any:
    """Round rod of 16 sides."""
    return to_manifold(prisms(start[None], end[None], diameter_mm / 2.0, 16))


def planted(case: CheckedDesign) -> tuple[TriangleMesh, dict[str, FloatArray]]:
    """Shell of cylinder60 with four faults on its near rim, and their middles (mm) by rule."""
    solid = shell_manifold(*case)
    x, y, z = np.eye(3)
    level = -2.0 * z
    outer = 31.6
    solid += box((outer - 0.2, -0.1, -4.0), (outer + 4.0, 0.1, 0.0))
    solid += rod((outer - 0.1) * y + level, (outer + 20.0) * y + level, 0.3)
    solid -= rod(-25.0 * x + level, -35.0 * x + level, 0.2)
    solid -= rod(-30.0 * y + level, -30.8 * y + level, 1.0)
    return to_triangles(solid), {
        "wall": (outer + 2.0) * x + level,
        "post": (outer + 10.0) * y + level,
        "hole": -30.4 * x + level,
        "sealed": -30.4 * y + level,
    }


def checked(case: CheckedDesign, mesh: TriangleMesh) -> tuple[PrintReport, float]:
    """Report of a shell as its STL file holds it, and the seconds that the check took."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shell.stl"
        write_stl(mesh, path)
        again = read_stl(path)
    start = time.perf_counter()
    report = check_shell(*case, again)
    return report, time.perf_counter() - start


def planted_rows(table: Table) -> None:
    """Planted faults are found, each once and where they are; nothing else is."""
    case = load("cylinder60")
    mesh, places = planted(case)
    checked(case, mesh)  # compiled loops are not timed
    report, _ = checked(case, mesh)
    names = {"wall": "wall 0.2 mm", "post": "post 0.3 x 20 mm", "hole": "hole 0.2 mm"}
    for rule, middle in places.items():
        found = [item for item in report.violations if item.rule == rule]
        label = names.get(rule, "sealed cavity")
        source = "planted on cylinder60's near rim"
        table.add(
            f"planted {label}: found", len(found), "-", reference=1, source=source, target="== 1"
        )
        off = min((np.linalg.norm(np.array(v.point_mm) - middle) for v in found), default=np.inf)
        table.add(
            f"planted {label}: located",
            float(off),
            "mm",
            reference=found[0].measured if found else "-",
            source="from the fault's middle; reference: what was measured there",
            target=f"<= {LOCATED_mm}",
        )
    table.add(
        "planted: violations in all",
        len(report.violations),
        "-",
        reference=len(places),
        source="no others",
        target=f"== {len(places)}",
    )


def shipped_rows(table: Table, names: list[str]) -> None:
    """No violations on shipped designs, and how they are best turned."""
    for name in names:
        case = load(name)
        mesh = to_triangles(shell_manifold(*case))
        report, seconds = checked(case, mesh)
        table.add(
            f"{name}: violations of the SLA rules",
            len(report.violations),
            "-",
            reference=0,
            source=f"chord 0.01 mm, {len(mesh.triangles)} triangles, {seconds:.1f} s",
            target="== 0",
        )
        rules, tree = case[0].print_rules, RayTree(mesh)
        upright = stand(mesh, tree, np.array([0.0, 0.0, 1.0]), rules)
        best = report.standing
        table.add(
            f"{name}: overhang as suggested over axis upright",
            best.overhang_area_mm2 / max(upright.overhang_area_mm2, 1e-9),
            "ratio",
            reference=upright.overhang_area_mm2,
            source=f"mm2 upright; suggested: {best.height_mm:.0f} mm high (upright "
            f"{upright.height_mm:.0f}), supports {best.support_volume_mm3:.0f} mm3 (upright "
            f"{upright.support_volume_mm3:.0f}), cups {best.cup_count} (upright "
            f"{upright.cup_count})",
        )


def parting_rows(table: Table, label: str, case: CheckedDesign) -> None:
    """A shell larger than the bed: pieces fit, volumes add up, pieces do not collide."""
    solid = shell_manifold(*case)
    start = time.perf_counter()
    parting = part_shell(*case, solid)
    seconds = time.perf_counter() - start
    rules = case[0].print_rules
    meshes = [to_triangles(piece) for piece in parting.pieces]
    fitting = sum(suggest(mesh, RayTree(mesh), rules)[0].fits for mesh in meshes)
    sound = sum(f.watertight and f.bodies == 1 for f in map(trimesh_facts, meshes))
    count, bed = len(meshes), " x ".join(f"{side:g}" for side in rules.bed_mm)
    table.add(
        f"{label}: pieces that fit the bed",
        fitting,
        "-",
        reference=count,
        source=f"pieces; bed {bed} mm, parted in {seconds:.1f} s, {len(parting.keys_mm)} keys",
        target=f"== {count}",
    )
    table.add(f"{label}: pieces", count, "-", reference=1, source="more than one", target=">= 2")
    table.add(
        f"{label}: watertight pieces of one body",
        sound,
        "-",
        reference=count,
        source="trimesh",
        target=f"== {count}",
    )
    whole = solid.volume() + parting.boss_volume_mm3 - parting.clearance_volume_mm3
    table.add(
        f"{label}: volume of the pieces",
        abs(sum(mesh.volume_mm3 for mesh in meshes) / whole - 1.0),
        "relative",
        reference=whole,
        source="shell and bosses less the keys' clearance, mm3",
        target="<= 1e-9",
    )
    shared = sum((a ^ b).volume() for a, b in combinations(parting.pieces, 2))
    table.add(
        f"{label}: pieces collide",
        float(shared),
        "mm3",
        reference=0,
        source="volume that two pieces share",
        target="<= 1e-6",
    )
    gap = min(
        float(np.abs(case[2].tip_mm @ cut.normal - cut.offset_mm).min()) for cut in parting.cuts
    )
    radius = case[0].receptor.diameter_outer_mm / 2.0
    table.add(
        f"{label}: cuts pass receptors at",
        gap - radius,
        "mm",
        reference=rules.wall_min_mm,
        source="from the tubes' sides, across which the cut runs",
        target=f">= {rules.wall_min_mm - 1e-6:g}",
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes fewer designs."""
    planted_rows(table)
    shipped_rows(table, ["plane"] if quick else shipped_designs())
    small = {"bed_mm": (80.0, 80.0, 60.0)}
    parting_rows(table, "cylinder60 on a small bed", load("cylinder60", print_rules=small))
    if quick:
        return
    long = {"length_mm": 240.0}, {"rows": 44}
    parting_rows(table, "a cylinder of 240 mm", load("cylinder60", shape=long[0], layout=long[1]))
    pad = {"bed_mm": (50.0, 45.0, 60.0)}
    parting_rows(table, "plane on a small bed", load("plane", print_rules=pad))
