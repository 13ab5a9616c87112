"""Accuracy and speed of the shell against published cases, closed forms and CalculiX."""

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import (
    mechanics_calibration,
    mechanics_large,
    mechanics_mesh_error,
    mechanics_receptors,
    mechanics_speed,
)
from benchmarks.harness import Table, holds, median_of, run_parts
from phytac_design.design.design_file import load_design
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.compliance import marker_compliance
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.mesh_writers import write_inp
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError
from verification import shells as cases

MARKER = 184  # row 11 of 23
FINGERTIP_MM = 6.0
FORCE_N = 10.0
COARSE = "; discretisation error of second order: a quarter of it with twice the elements"
ProblemBuilder = Callable[[int], cases.ShellProblem]


def published(table: Table, *, quick: bool) -> None:
    """Published linear cases: error in percent of the reference."""
    usual, known = {16: "<= 3", 32: "<= 1.5"}, "published reference"
    pinched, beam = {16: "<= 7", 32: "<= 2"}, {8: "<= 1.5", 16: "<= 1.5", 32: "<= 1.5"}
    named: list[tuple[str, ProblemBuilder, str, dict[int, str]]] = [
        ("Scordelis-Lo roof", cases.scordelis_lo_case, known, usual),
        ("pinched cylinder", cases.pinched_cylinder_case, known, pinched),
        ("hemisphere, 18° hole", cases.hemisphere_with_hole_case, known, usual),
        ("Raasch hook, n × n/2", cases.raasch_hook_case, known, usual),
    ]
    for t, source in ((0.32, known), (0.0032, "Belytschko, Wong, Stolarski 1989")):
        for along in (True, False):
            name = f"twisted beam t = {t}, force {'along' if along else 'across'} the width"
            shell = partial(cases.twisted_beam_case, thickness=t, in_plane=along)
            named.append((f"{name}, n × n/4", shell, source, beam))
    for t in cases.HYPERBOLOID:
        shell = partial(cases.hyperboloid_case, thickness=t)
        named.append((f"free hyperboloid t = {t}", shell, known, usual))
    for name, build, source, targets in named:
        for n, target in targets.items():
            if quick and n > 16:
                continue
            case = build(n)
            ratio = case.ratio()
            error = abs(ratio - 1.0) * 100.0
            row = f"{name}, {n} elements a side"
            note = f"computed / reference = {ratio:.5f}{'' if holds(error, target) else COARSE}"
            table.add(row, error, "%", case.reference, source, target, note)


def thin(table: Table, *, quick: bool) -> None:
    """Pure bending of a thin hyperboloid, the hardest case, on regular and on jittered meshes."""
    for n in (32,) if quick else (32, 64):
        for t in (0.1, 0.01, 0.001, 1e-4):
            for jitter, nodes in ((0.0, "regular"), (0.25, "jittered ±25 %")):
                row = f"free hyperboloid, t/L = {t:g}, {n} a side, nodes {nodes}"
                source = "published reference; below t = 0.001 its limit of pure bending"
                try:
                    ratio = cases.hyperboloid_case(n, thickness=t, jitter=jitter).ratio()
                except NumericalError as error:
                    row += ": more than 5 % wrong and not refused"
                    table.add(row, 0, "", 0.0, source, "== 0", f"refused: {error}")
                    continue
                note = f"computed / reference = {ratio:.5f}"
                table.add(row, abs(ratio - 1.0) * 100.0, "%", 0.0, source, "<= 5", note)


def jittered(table: Table) -> None:
    """Change of published cases on meshes whose inner nodes are moved at random."""
    for name, build in (
        ("Scordelis-Lo roof", cases.scordelis_lo_case),
        ("free hyperboloid t = 0.1", partial(cases.hyperboloid_case, thickness=0.1)),
    ):
        change = abs(build(32, jitter=0.25).ratio() / build(32).ratio() - 1.0) * 100.0
        row = f"{name}, 32 a side, nodes jittered ±25 %: change"
        table.add(row, change, "%", reference=0, source="the regular mesh", target="<= 5")


class Prototype:
    """The shipped cylinder60 on a marker-aligned mesh."""

    def __init__(self, refine: int) -> None:
        self.design = load_design("cylinder60")
        self.surface = self.design.surface()
        self.markers: Markers = make_markers(self.design, self.surface)
        self.refine = refine

    def mesh(self) -> ShellMesh:
        """Mesh it."""
        thickness = self.design.wall.thickness_mm
        return marker_mesh(self.surface, self.markers, thickness_mm=thickness, refine=self.refine)

    def model(self, mesh: ShellMesh) -> ShellModel:
        """Elements and assembly."""
        material = self.design.material
        return clamped_model(mesh, modulus_MPa=material.modulus_MPa, poisson=material.poisson)

    def fingertip(self, mesh: ShellMesh) -> Any:
        """10 N on a fingertip in the middle of the sensor."""
        return FORCE_N * patch_loads(mesh, self.surface, self.markers.uv[[MARKER]], FINGERTIP_MM)


def against_ccx(table: Table, refine: int) -> None:
    """Run the exported job in CalculiX: greatest difference over all markers, and time."""
    part = Prototype(refine)
    mesh = part.mesh()
    load = part.fingertip(mesh)
    motion = part.model(mesh).solve(load).motion[mesh.marker_nodes, :3, 0]
    if shutil.which("ccx") is None:
        print("ccx is not on PATH: comparison left out")
        return
    with tempfile.TemporaryDirectory() as folder:
        material = part.design.material
        write_inp(
            Path(folder) / "shell.inp",
            mesh,
            modulus_MPa=material.modulus_MPa,
            poisson=material.poisson,
            load=load,
            name="cylinder60",
        )
        subprocess.run(["ccx", "shell"], cwd=folder, capture_output=True, check=True)
        theirs = _read_dat(Path(folder) / "shell.dat", mesh)
    peak = float(np.linalg.norm(theirs, axis=1).max())
    label = f"cylinder60, {FORCE_N:g} N on a {FINGERTIP_MM:g} mm fingertip patch, refine {refine}"
    row = f"{label}: greatest difference of a marker from ccx, of the peak"
    source = "CalculiX S4, the exported .inp, linear; reference is the peak in mm"
    table.add(row, float(np.abs(motion - theirs).max()) / peak * 100.0, "%", peak, source, "<= 3")


def _read_dat(path: Path, mesh: ShellMesh) -> FloatArray:
    rows = [line.split() for line in path.read_text().splitlines()]
    found = {int(r[0]): [float(x) for x in r[1:]] for r in rows if len(r) == 4 and r[0].isdigit()}
    return np.array([found[int(node) + 1] for node in mesh.marker_nodes])


def compliance(table: Table, refine: int) -> None:
    """Seconds for the compliance of all 368 markers, from the design on."""
    part = Prototype(refine)

    def all_of_it(*, symmetry: bool) -> float:
        mesh = part.mesh()
        result = marker_compliance(
            part.model(mesh),
            mesh,
            part.surface,
            part.markers,
            load_radius_mm=FINGERTIP_MM,
            use_symmetry=symmetry,
        )
        return result.error

    for symmetry, how in ((True, "one column, turned"), (False, "all 368 solved")):
        row = f"marker compliance of cylinder60, refine {refine}, {how}"
        source = "published reference"
        value = median_of(partial(all_of_it, symmetry=symmetry), 3)
        table.add(row, value, "s", 3.0, source, "<= 3" if symmetry else None)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""

    def linear(table: Table) -> None:
        published(table, quick=quick)
        if not quick:
            jittered(table)
        for refine in (4,) if quick else (4, 6):
            against_ccx(table, refine)
        compliance(table, 2 if quick else 4)

    def large(table: Table) -> None:
        mechanics_large.published(table, quick=quick)
        mechanics_large.fingertip(table, quick=quick)
        mechanics_large.bricks(table, quick=quick)

    return {
        "linear": linear,
        "extremes": partial(thin, quick=quick),
        "large": large,
        "calibration": partial(mechanics_calibration.add_rows, quick=quick),
        "receptors": partial(mechanics_receptors.add_rows, quick=quick),
        "mesh-error": partial(mechanics_mesh_error.add_rows, quick=quick),
        "speed": partial(mechanics_speed.add_rows, quick=quick),
    }


if __name__ == "__main__":
    run_parts("mechanics", parts, __doc__ or "")
