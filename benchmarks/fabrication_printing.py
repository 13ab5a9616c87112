"""Print rules: shipped designs, build directions, shells larger than the bed."""

import time
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.fabrication.printing.overhang import stand, suggest
from phytac_design.fabrication.printing.parting import part_shell
from phytac_design.fabrication.printing.print_checks import PrintReport, check_shell
from phytac_design.geometry.ray_tree import RayTree
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.solids.mesh_export import read_stl, write_stl
from phytac_design.solids.mesh_facts import trimesh_facts
from phytac_design.solids.solid_mesh import shell_manifold, to_triangles


def load(name: str, **changes: Any) -> Sensor:
    """Read a shipped design with changes of its tables, checked."""
    data = load_design(name).model_dump()
    for table, values in changes.items():
        data[table] = {**data[table], **values}
    design = Design.model_validate(data)
    return check_design(design)


def checked(case: Sensor, mesh: TriangleMesh) -> tuple[PrintReport, float]:
    """Report of a shell as its STL file holds it, and the seconds that the check took."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shell.stl"
        write_stl(mesh, path)
        again = read_stl(path)
    start = time.perf_counter()
    report = check_shell(case, again)
    return report, time.perf_counter() - start


def shipped_rows(table: Table, names: list[str]) -> None:
    """No violations on shipped designs, and how they are best turned."""
    for name in names:
        case = load(name)
        mesh = to_triangles(shell_manifold(case))
        report, seconds = checked(case, mesh)
        row = f"{name}: violations of the SLA rules"
        source = f"chord 0.01 mm, {len(mesh.triangles)} triangles, {seconds:.1f} s"
        table.add(row, len(report.violations), "-", 0, source, "== 0")
        rules, tree = case.design.print_rules, RayTree(mesh)
        upright = stand(mesh, tree, np.array([0.0, 0.0, 1.0]), rules)
        best = report.standing
        row = f"{name}: overhang as suggested over axis upright"
        source = (
            f"mm2 upright; suggested: {best.height_mm:.0f} mm high (upright "
            f"{upright.height_mm:.0f}), supports {best.support_volume_mm3:.0f} mm3 (upright "
            f"{upright.support_volume_mm3:.0f}), cups {best.cup_count} (upright "
            f"{upright.cup_count})"
        )
        value = best.overhang_area_mm2 / max(upright.overhang_area_mm2, 1e-9)
        table.add(row, value, "ratio", upright.overhang_area_mm2, source)


def parting_rows(table: Table, label: str, case: Sensor) -> None:
    """A shell larger than the bed: pieces fit, volumes add up, pieces do not collide."""
    solid = shell_manifold(case)
    start = time.perf_counter()
    parting = part_shell(case, solid)
    seconds = time.perf_counter() - start
    rules = case.design.print_rules
    meshes = [to_triangles(piece) for piece in parting.pieces]
    fitting = sum(suggest(mesh, RayTree(mesh), rules)[0].fits for mesh in meshes)
    sound = sum(f.watertight and f.bodies == 1 for f in map(trimesh_facts, meshes))
    count, bed = len(meshes), " x ".join(f"{side:g}" for side in rules.bed_mm)
    row = f"{label}: pieces that fit the bed"
    source = f"pieces; bed {bed} mm, parted in {seconds:.1f} s, {len(parting.keys_mm)} keys"
    table.add(row, fitting, "-", count, source, f"== {count}")
    table.add(f"{label}: pieces", count, "-", reference=1, source="more than one", target=">= 2")
    table.add(
        f"{label}: watertight pieces of one body", sound, "-", count, "trimesh", f"== {count}"
    )
    whole = solid.volume() + parting.boss_volume_mm3 - parting.clearance_volume_mm3
    row = f"{label}: volume of the pieces"
    source = "shell and bosses less the keys' clearance, mm3"
    value = abs(sum(mesh.volume_mm3 for mesh in meshes) / whole - 1.0)
    table.add(row, value, "relative", whole, source, "<= 1e-9")
    shared = sum((a ^ b).volume() for a, b in combinations(parting.pieces, 2))
    row = f"{label}: pieces collide"
    table.add(row, float(shared), "mm3", 0, "volume that two pieces share", "<= 1e-6")
    tips = case.markers.tip_mm
    gap = min(float(np.abs(tips @ cut.normal - cut.offset_mm).min()) for cut in parting.cuts)
    radius = case.design.receptor.diameter_outer_mm / 2.0
    row = f"{label}: cuts pass receptors at"
    source = "from the tubes' sides, across which the cut runs"
    table.add(
        row, gap - radius, "mm", rules.wall_min_mm, source, f">= {rules.wall_min_mm - 1e-6:g}"
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes fewer designs."""
    shipped_rows(table, ["plane"] if quick else shipped_designs())
    small = {"bed_mm": (80.0, 80.0, 60.0)}
    parting_rows(table, "cylinder60 on a small bed", load("cylinder60", print_rules=small))
    if quick:
        return
    long = {"length_mm": 240.0}, {"rows": 44}
    parting_rows(table, "a cylinder of 240 mm", load("cylinder60", shape=long[0], layout=long[1]))
    pad = {"bed_mm": (50.0, 45.0, 60.0)}
    parting_rows(table, "plane on a small bed", load("plane", print_rules=pad))
