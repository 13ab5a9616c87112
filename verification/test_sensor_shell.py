"""Shells of every family pressed by a patch: CalculiX, balances, reciprocity, symmetry, units."""

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.layout import make_markers
from phytac_design.mechanics.meshing.locate import locate
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh, plain_mesh
from phytac_design.mechanics.shell.compliance import marker_compliance
from phytac_design.mechanics.shell.discretisation import ProbedShell, estimate_error
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import SHAPES, design_of
from verification.quadratic_shell import QuadraticMesh, quadratic_mesh, quadratic_patch, run_ccx
from verification.test_shell import balances

RECIPROCAL = 1e-9
"""Betti's theorem, relative, beside the solution's own rounding."""
NEWTON = 1e-4
"""Load at which CalculiX's large displacements are small ones."""
NEAR = 0.02
"""What a linear element of this size, and the quadratic one, leave of discretisation error."""
SOLID_EDGE = 0.5
"""CalculiX expands shells into solids. Their clamped edge cannot thin, and they take shear without
the factor 5/6: a solid's answer differs by about this much of wall over half the span."""


def check_pressed(values: Mapping[str, Any], found: Evidence) -> None:
    """Unit forces on all markers: energy, Betti, symmetry, units, single precision."""
    design = design_of(values)
    surface = design.surface()
    markers = make_markers(design, surface)
    thickness, section = design.wall.thickness_mm, design.material
    material: dict[str, Any] = {"modulus_MPa": section.modulus_MPa, "poisson": section.poisson}
    mesh = marker_mesh(surface, markers, thickness_mm=thickness, refine=2)
    model = clamped_model(mesh, **material)
    radius = float(values.get("radius_mm", 2.0))
    load = patch_loads(mesh, surface, markers.uv, radius)
    solution = model.solve(load)
    forces = np.asarray(load.toarray())
    push = np.einsum(
        "ndm,md->m", forces.reshape(-1, 6, forces.shape[1])[:, :3], -surface.normal(markers.uv)
    )
    found.add("a newton is a newton", push - 1.0, 1e-9, kind="balance")
    one = forces[:, :1].reshape(-1, 6)
    balances(model, one, solution.motion[:, :, 0], solution.reactions[:, :, 0], found)
    flat = solution.motion.reshape(-1, forces.shape[1])
    compliance = forces.T @ flat
    size = float(np.abs(compliance).max())
    slack = RECIPROCAL + solution.error
    found.add(
        "Betti: work of one load on the other's displacement",
        (compliance - compliance.T) / size,
        slack,
        kind="balance",
    )
    least = float(np.linalg.eigvalsh(0.5 * (compliance + compliance.T))[0])
    found.true("no set of forces gains energy", least > -slack * size)
    _column(model, mesh, surface, markers, radius, found)
    _units(mesh, model, forces, flat, max(1e-9, 3.0 * solution.error), found)
    narrow = compliance.astype(np.float32)
    force = np.linspace(0.5, 25.0, len(narrow))
    loss = narrow.astype(np.float32) @ force.astype(np.float32) - compliance @ force
    spread = np.abs(compliance) @ force
    found.add(
        "motion in single precision, of its terms",
        loss / spread,
        len(force) * float(np.finfo(np.float32).eps),
        kind="float32",
    )


def _column(
    model: ShellModel,
    mesh: ShellMesh,
    surface: Surface,
    markers: Any,
    radius: float,
    found: Evidence,
) -> None:
    """One column turned around is the solution of every load."""
    if markers.lattice is None:
        return
    turned = marker_compliance(model, mesh, surface, markers, load_radius_mm=radius)
    if turned.solves == markers.count:
        return
    plain = marker_compliance(
        model, mesh, surface, markers, load_radius_mm=radius, use_symmetry=False
    )
    found.facts["solves_saved"] = float(markers.count - turned.solves)
    found.close(
        "every load solved by itself",
        turned.motion,
        plain.motion,
        max(1e-8, 10.0 * plain.error),
        kind="symmetry",
    )


def _units(
    mesh: ShellMesh,
    model: ShellModel,
    forces: FloatArray,
    flat: FloatArray,
    slack: float,
    found: Evidence,
) -> None:
    """The same shell in metres and in micrometres, forces in newtons."""
    for name, factor in (("metres", 1e-3), ("micrometres", 1e3)):
        other = ShellModel(
            factor * mesh.nodes_mm,
            mesh.quads,
            mesh.normals,
            thickness_mm=factor * mesh.thickness_mm,
            modulus_MPa=model.modulus_MPa / factor**2,
            poisson=model.poisson,
            fixed=model.fixed,
        )
        moved = other.solve(forces[:, :1]).motion[:, :3, 0] / factor
        found.close(f"in {name}", moved, flat[:, 0].reshape(-1, 6)[:, :3], slack, kind="units")


def check_ccx(values: Mapping[str, Any], found: Evidence) -> None:
    """A patch in the middle of the face, against quadratic shells of CalculiX."""
    design = design_of(values)
    surface = design.surface()
    thickness, section = design.wall.thickness_mm, design.material
    material: dict[str, Any] = {"modulus_MPa": section.modulus_MPa, "poisson": section.poisson}
    area = surface.area_mm2()
    centre = surface.domain.mean(axis=1)
    radius = 0.12 * float(np.sqrt(area / np.pi))
    span = 0.5 * float(np.sort(np.ptp(surface.bounds_mm(), axis=0))[-2])
    coarse = plain_mesh(surface, thickness_mm=thickness, size_mm=float(np.sqrt(area / 500.0)))

    def make(level: int) -> ProbedShell:
        size = float(np.sqrt(area / 1500.0)) / level
        mesh = plain_mesh(surface, thickness_mm=thickness, size_mm=size)
        nodes, weights = locate(mesh, coarse.uv)
        load = NEWTON * patch_loads(mesh, surface, centre[None], radius)
        return ProbedShell(
            model=clamped_model(mesh, **material), loads=load, nodes=nodes, weights=weights
        )

    estimate = estimate_error(make, (2, 1))
    ours = estimate.extrapolated[:, :, 0]
    found.facts["mesh_error"] = float(estimate.relative[0])
    part = make(1)
    solution = part.model.solve(part.loads)
    forces = np.asarray(part.loads.toarray()).reshape(-1, 6)
    balances(part.model, forces, solution.motion[:, :, 0], solution.reactions[:, :, 0], found)
    if shutil.which("ccx") is None:
        return
    theirs = quadratic_mesh(coarse, surface)
    theirs = replace(theirs, held=_rims(theirs.uv, surface), nodes_mm=_on_face(theirs, surface))
    push = NEWTON * quadratic_patch(theirs, surface, centre, radius)
    with tempfile.TemporaryDirectory() as folder:
        moved = run_ccx(Path(folder), theirs, push, **material)[: len(coarse.nodes_mm)]
    found.add(
        "CalculiX S8R, of the peak",
        np.linalg.norm(ours - moved, axis=1) / np.linalg.norm(moved, axis=1).max(),
        NEAR + SOLID_EDGE * thickness / span,
    )
    found.facts["peak_mm_per_N"] = float(np.linalg.norm(ours, axis=1).max() / NEWTON)


def _on_face(mesh: QuadraticMesh, surface: Surface) -> FloatArray:
    """Nodes with mid-sides from the chords' middles: a chart is singular at a pole."""
    nodes = mesh.nodes_mm.copy()
    ends, middle = mesh.octets[:, :4], mesh.octets[:, 4:]
    chord = 0.5 * (nodes[ends] + nodes[np.roll(ends, -1, axis=1)])
    depth = -mesh.linear.thickness_mm / 2.0
    nodes[middle.ravel()] = surface.point(surface.chart(chord.reshape(-1, 3)), depth)
    return nodes


def _rims(uv: FloatArray, surface: Surface) -> Any:
    """Nodes on open edges."""
    held = np.zeros(len(uv), dtype=bool)
    for axis, end in surface.edges():
        span = float(np.ptp(surface.domain[axis]))
        held |= np.abs(uv[:, axis] - surface.domain[axis, end]) < 1e-9 * span
    return np.flatnonzero(held)


def cases() -> Cases:
    """Every family thin, thick, nearly incompressible, soft, stiff; against CalculiX."""
    out = Cases()
    for shape in SHAPES:
        out.add_design(shape, "as it is", check_pressed, {})
        for t in (1e-3, 0.05, 4.0):
            expect: Expect = "either" if t == 1e-3 else "right"
            wall = {"wall": {"thickness_mm": t}}
            out.add_design(shape, f"a wall of {t:g} mm", check_pressed, wall, expect)
        for v in (0.0, 0.4999):
            out.add_design(shape, f"ν {v:g}", check_pressed, {"material": {"poisson": v}})
        for E in (1e-3, 1e6):
            out.add_design(shape, f"E {E:g} MPa", check_pressed, {"material": {"modulus_MPa": E}})
        out.add_design(shape, "point forces", check_pressed, {}, radius_mm=0.0)
        out.add_design(shape, "a patch", check_ccx, {})
        for t in (2.0, 0.2):
            wall = {"wall": {"thickness_mm": t}}
            out.add_design(shape, f"a patch, a wall of {t:g} mm", check_ccx, wall)
    return out


CASES = cases()


@CASES.parametrize
def test_sensor_shell(case: Case, record_property: Recorder) -> None:
    """Shells of every family under patches."""
    verify(case, record_property)
