"""Rows of ``mechanics`` for shapes whose mesh must close: domes, sheets, boxes, any markers."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness import Table
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import (
    R,
    S,
    ShellMesh,
    marker_size_mm,
    node_mesh,
    plain_mesh,
)
from phytac_design.mechanics.shell.loads import (
    _cell_area,
    curved_points,
    outer_elements,
    patch_loads,
)
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes import Cone, Cuboid, Hemisphere, Patch, Plane, Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.plane_curves import Line
from phytac_shapes.plane_curves import Path as Profile
from phytac_shapes.revolved import PathRevolved
from verification.pressure_load import pressure_forces
from verification.quadratic_shell import QuadraticMesh, _serendipity, run_ccx

FINGERTIP_MM = 6.0
MODULUS_MPa, POISSON, WALL_MM = 2200.0, 0.38, 0.8
FORCE_N = 1e-3
"""So little that large and small displacements are the same."""
CELLS = 16
MACNEAL = "MacNeal and Harder 1985"


@dataclass(frozen=True, kw_only=True)
class Disc(PathRevolved):
    """A flat disc; chart u = distance from the rim."""

    radius_mm: float

    @property
    def profile(self) -> Profile:
        """From the rim to the centre."""
        return Profile(parts=(Line(start=(self.radius_mm, 0.0), end=(0.0, 0.0)),))

    @property
    def poles(self) -> tuple[bool, bool]:
        """The centre."""
        return (False, True)

    def facts(self) -> dict[str, float]:
        """Area."""
        return {"area_outer_mm2": self.area_mm2()}


Disc.name = "disc"


def bowl() -> Patch:
    """A face curved both ways, twisted, not square."""
    u, v = np.linspace(-20.0, 20.0, 5), np.linspace(-30.0, 30.0, 6)
    return Patch(
        points_mm=tuple(
            tuple((x, y, 40.0 - 0.008 * x * x - 0.006 * y * y + 0.004 * x * y) for x in v.tolist())
            for y in u.tolist()
        )
    )


def clamped(
    mesh: ShellMesh, *, modulus: float = MODULUS_MPa, poisson: float = POISSON
) -> ShellModel:
    """All open edges held."""
    fixed = np.zeros((len(mesh.nodes_mm), 6), dtype=np.bool_)
    fixed[mesh.clamped] = True
    return solid(mesh, fixed, modulus=modulus, poisson=poisson)


def solid(mesh: ShellMesh, fixed: BoolArray, *, modulus: float, poisson: float) -> ShellModel:
    """Model with these DOFs held."""
    return ShellModel(
        mesh.nodes_mm,
        mesh.quads,
        mesh.normals,
        thickness_mm=mesh.thickness_mm,
        modulus_MPa=modulus,
        poisson=poisson,
        fixed=fixed,
    )


def sag(
    surface: Surface, uv: FloatArray, radius: float, *, wall_mm: float, side_mm: float
) -> tuple[float, ShellMesh]:
    """Inward motion (mm) at a node under 1 N on a patch there, open edges held; and the mesh."""
    mesh = node_mesh(surface, uv[None], thickness_mm=wall_mm, size_mm=side_mm)
    motion = clamped(mesh).solve(patch_loads(mesh, surface, uv[None], radius)).motion
    at = mesh.marker_nodes[0]
    return float(-motion[at, :3, 0] @ mesh.normals[at]), mesh


def pinched_hemisphere(side_mm: float) -> float:
    """Ratio to 0.0924 (MacNeal and Harder 1985) of the full hemisphere, pole meshed."""
    radius, wall = 10.0, 0.04
    surface = Hemisphere(diameter_outer_mm=2.0 * radius + wall)
    mesh = plain_mesh(surface, thickness_mm=wall, size_mm=side_mm)
    fixed = np.zeros((len(mesh.nodes_mm), 6), dtype=np.bool_)
    fixed[np.argmax(mesh.nodes_mm[:, 2])] = True
    load = np.zeros((len(mesh.nodes_mm), 6))
    at = [int(np.argmax(mesh.nodes_mm @ axis)) for axis in np.array([[1, 0, 0], [0, 1, 0]])]
    for node, axis, sign in ((at[0], 0, 1.0), (at[1], 1, -1.0)):
        other = int(np.argmin(mesh.nodes_mm[:, axis]))
        load[node, axis], load[other, axis] = 2.0 * sign, -2.0 * sign
    model = solid(mesh, fixed, modulus=6.825e7, poisson=0.3)
    return float(model.solve(load.reshape(-1, 1)).motion[at[0], 0, 0] / 0.0924)


def breathing_dome(side_mm: float) -> tuple[float, float]:
    """Misfit of a hemisphere that breathes, its rim moved alike: w = p R² (1 - ν) / 2 E t.

    Root mean square over the nodes, and the largest.
    """
    radius, pressure = 30.0, 0.01
    surface = Hemisphere(diameter_outer_mm=2.0 * radius + WALL_MM)
    mesh = plain_mesh(surface, thickness_mm=WALL_MM, size_mm=side_mm)
    model = clamped(mesh)
    exact = pressure * radius**2 * (1.0 - POISSON) / (2.0 * MODULUS_MPa * WALL_MM)
    rim = np.zeros((len(mesh.nodes_mm), 6))
    rim[mesh.clamped, :3] = exact * mesh.normals[mesh.clamped]
    load = pressure * pressure_forces(mesh.nodes_mm, mesh.quads) - model.stiffness @ rim.ravel()
    motion = model.solve(load).motion[..., 0] + rim
    miss = np.linalg.norm(motion[:, :3] - exact * mesh.normals, axis=1) / exact
    return float(np.sqrt(np.mean(miss**2))), float(miss.max())


def disc_sag(side_mm: float) -> float:
    """Ratio to the clamped disc under a patch at its centre (Timoshenko 1959, art. 19)."""
    a, c, wall = 50.0, 10.0, 0.5
    surface = Disc(radius_mm=a)
    stiffness = MODULUS_MPa * wall**3 / (12.0 * (1.0 - POISSON**2))
    exact = (4.0 * a * a - 4.0 * c * c * np.log(a / c) - 3.0 * c * c) / (64.0 * np.pi * stiffness)
    pole = np.array([surface.domain[0, 1], 0.0])
    return sag(surface, pole, c, wall_mm=wall, side_mm=side_mm)[0] / float(exact)


def square_sag(side_mm: float) -> float:
    """Ratio to 0.00126532 q L⁴ / D, the clamped square plate (Taylor and Govindjee 2004)."""
    side, wall = 80.0, 0.5
    surface = Plane(width_mm=side, height_mm=side, tilt_deg=20.0)
    stiffness = MODULUS_MPa * wall**3 / (12.0 * (1.0 - POISSON**2))
    middle = sag(surface, np.zeros(2), side, wall_mm=wall, side_mm=side_mm)[0]
    return middle / (0.00126532 * side**2 / stiffness)


def quadratic(mesh: ShellMesh, surface: Surface) -> QuadraticMesh:
    """Eight-node quads on any mesh: mid-sides lie on the middle face."""
    ends = np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], -1), axis=2)
    edges, slot = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    count = len(mesh.nodes_mm)
    foot = surface.chart(mesh.nodes_mm[edges].mean(axis=1))
    foot[:, 0] = np.clip(foot[:, 0], *surface.domain[0])
    if not surface.periodic[1]:
        foot[:, 1] = np.clip(foot[:, 1], *surface.domain[1])
    uv = np.concatenate([mesh.uv, foot])
    once = np.bincount(slot.ravel(), minlength=len(edges)) == 1
    return QuadraticMesh(
        nodes_mm=surface.point(uv, -mesh.thickness_mm / 2.0),
        uv=uv,
        octets=np.concatenate([mesh.quads, count + slot.reshape(-1, 4)], axis=1),
        held=np.concatenate([mesh.clamped, count + np.flatnonzero(once)]),
        linear=mesh,
    )


def quadratic_force(
    mesh: QuadraticMesh, surface: Surface, uv: FloatArray, radius: float
) -> FloatArray:
    """Nodal forces (N, 3) of 1 N on a disc, consistent with the quadratic shape functions."""
    outer, middle, _ = outer_elements(mesh.linear)
    at = surface.point(uv[None])[0]
    reach = np.linalg.norm(outer - middle[:, None], axis=2).max(axis=1)
    near = np.linalg.norm(middle - at, axis=1) <= 1.1 * (radius + reach)
    side = (np.arange(CELLS) + 0.5) * 2.0 / CELLS - 1.0
    r, s = (grid.ravel() for grid in np.meshgrid(side, side))
    h = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))
    points, normals = curved_points(outer[near], mesh.linear.normals[mesh.linear.quads[near]], h)
    soft = 2.0 * reach[near][:, None] / CELLS
    share = np.clip((radius - np.linalg.norm(points - at, axis=2)) / soft + 0.5, 0.0, 1.0)
    push = -normals * (share * _cell_area(outer[near], r, s))[:, :, None]
    forces = np.zeros_like(mesh.nodes_mm)
    np.add.at(forces, mesh.octets[near], np.einsum("qi,eqx->eix", _serendipity(r, s), push))
    return forces / float(np.sum(forces @ -surface.normal(uv[None])[0]))


def ccx_sag(surface: Surface, uv: FloatArray, radius: float, side_mm: float) -> float:
    """Inward motion (mm) under 1 N by CalculiX, quadratic shells."""
    mesh = quadratic(plain_mesh(surface, thickness_mm=WALL_MM, size_mm=side_mm), surface)
    force = FORCE_N * quadratic_force(mesh, surface, uv, radius)
    with tempfile.TemporaryDirectory() as folder:
        motion = run_ccx(Path(folder), mesh, force, modulus_MPa=MODULUS_MPa, poisson=POISSON)
    nodes, weights = locate(mesh.linear, uv[None])
    octet = mesh.octets[np.all(mesh.linear.quads == nodes[0], axis=1)][0]
    h = _serendipity(weights[:1] @ R, weights[:1] @ S)[0]
    return float(h @ motion[octet] @ -surface.normal(uv[None])[0] / FORCE_N)


def extrapolated(value: list[float], side: tuple[float, ...]) -> float:
    """Limit at size 0 of values that approach it in proportion to the element size."""
    if len(value) == 1:
        return value[0]
    return value[1] + (value[1] - value[0]) * side[1] / (side[0] - side[1])


def places() -> list[tuple[str, Surface, FloatArray, tuple[float, ...]]]:
    """Surfaces, a place each to press (poles, seams, edges), element sizes for CalculiX."""
    dome = Hemisphere(diameter_outer_mm=60.0)
    cone = Cone(diameter_near_mm=60.0, diameter_far_mm=24.0, length_mm=60.0, end="cap")
    box = Cuboid(width_mm=50.0, depth_mm=40.0, length_mm=80.0, edge_radius_mm=6.0)
    pad = Plane(width_mm=80.0, height_mm=60.0, tilt_deg=20.0)
    pole, cap = dome.domain[0, 1], cone.domain[0, 1]
    return [
        ("hemisphere, on the pole", dome, np.array([pole, 0.0]), (2.5,)),
        ("hemisphere, on the seam", dome, np.array([0.6 * pole, 0.0]), (2.5,)),
        ("capped cone, on the pole", cone, np.array([cap, 0.0]), (3.5,)),
        ("capped cone, on the seam", cone, np.array([0.5 * cap, 0.0]), (3.0,)),
        ("cuboid, middle of a face, on the seam", box, np.array([40.0, 0.0]), (2.5,)),
        ("cuboid, on a rounded edge", box, np.array([40.0, 14.0 + 1.5 * np.pi]), (2.5,)),
        ("plane, 12 mm from two edges", pad, np.array([18.0, 28.0]), (2.5, 1.7)),
        ("patch, middle", bowl(), np.array([2.0, 2.5]), (2.5,)),
    ]


def against_ccx(table: Table, *, quick: bool) -> None:
    """Sag under a fingertip by both programs."""
    if shutil.which("ccx") is None:
        return
    for name, surface, uv, fine in places()[:: 7 if quick else 1]:
        sides = (3.5,) if quick else fine
        mine, mesh = sag(surface, uv, FINGERTIP_MM, wall_mm=WALL_MM, side_mm=1.5)
        theirs = [ccx_sag(surface, uv, FINGERTIP_MM, side) for side in sides]
        other = extrapolated(theirs, sides)
        note = f"ours {mine:.5g} mm/N with {len(mesh.nodes_mm)} nodes"
        if len(sides) > 1:
            note += (
                f"; S8R gives {theirs[0]:.5g} and {theirs[1]:.5g} at {sides[0]} and {sides[1]} mm: "
                "on clamped flat plates it errs in proportion to the size (row above), so its "
                "limit is the reference"
            )
        row = f"shapes: sag under a fingertip, {name}"
        source = "CalculiX S8R" + (", extrapolated" if len(sides) > 1 else "")
        table.add(row, abs(mine / other - 1.0) * 100.0, "%", other, source, "<= 1", note)


def peer_on_a_plate(table: Table, *, quick: bool) -> None:
    """What CalculiX's S8R makes of the clamped square plate whose answer is known."""
    if shutil.which("ccx") is None:
        return
    pad = Plane(width_mm=80.0, height_mm=80.0)
    stiffness = MODULUS_MPa * WALL_MM**3 / (12.0 * (1.0 - POISSON**2))
    side = 5.0 if quick else 3.0
    ratio = ccx_sag(pad, np.zeros(2), 80.0, side) / (0.00126532 * 80.0**2 / stiffness)
    row = f"shapes: CalculiX S8R on the clamped square plate, {side} mm elements"
    source = "Taylor and Govindjee 2004"
    note = "reported only: too stiff, by an amount in proportion to the element size"
    table.add(row, ratio, "1", 1.0, source, note=note)


def markers_anywhere(table: Table, *, quick: bool) -> None:
    """Markers of no lattice on a dome, one of them on the pole: nodes on all, sound elements."""
    dome = Hemisphere(diameter_outer_mm=60.0)
    for count in (1, 100) if quick else (1, 100, 2000, 10_000):
        turn = np.arange(count)
        angle = np.mod(turn * np.pi * (3.0 - np.sqrt(5.0)), 2.0 * np.pi)
        away = np.arccos(1.0 - turn / (count + 4.0))
        uv = np.column_stack([dome.domain[0, 1] - 30.0 * away, angle])
        mesh = node_mesh(
            dome, uv, thickness_mm=WALL_MM, size_mm=marker_size_mm(dome, count, refine=2)
        )
        at = mesh.nodes_mm[mesh.marker_nodes]
        gap = float(np.abs(at - dome.point(uv, -WALL_MM / 2.0)).max())
        row = f"shapes: least scaled Jacobian with {count} markers by golden angle on a hemisphere"
        note = f"{len(mesh.quads)} elements; markers at most {gap:.1g} mm off their nodes"
        value = float(mesh.scaled_jacobian().min())
        table.add(row, value, "1", 1.0, "a rectangle", ">= 0.35", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Closed forms and published values, markers anywhere, then CalculiX."""
    n = 2.0 if quick else 1.0
    taylor = "Taylor and Govindjee 2004"
    for name, value, source, target in (
        ("full hemisphere pinched, pole meshed", pinched_hemisphere(0.3 * n), MACNEAL, 1.5),
        ("clamped disc, patch at the pole", disc_sag(2.0 * n), "Timoshenko 1959, art. 19", 0.5),
        ("clamped square plate, uniform load", square_sag(2.0 * n), taylor, 0.5),
    ):
        row = f"shapes: {name}"
        note = f"ratio {value:.5f}"
        table.add(row, abs(value - 1.0) * 100.0, "%", 1.0, source, f"<= {target}", note)
    typical, worst = breathing_dome(1.5 * n)
    row = "shapes: breathing hemisphere, root mean square misfit"
    note = (
        f"largest {worst * 100.0:.2g} %, at the four nodes with three elements, where flat "
        "facets carry pressure unevenly; it falls with refinement"
    )
    table.add(row, typical * 100.0, "%", 0.0, "membrane closed form", "<= 1", note)
    markers_anywhere(table, quick=quick)
    peer_on_a_plate(table, quick=quick)
    against_ccx(table, quick=quick)
