"""Accuracy and speed of the shell against published cases, closed forms and CalculiX."""

import os

# One BLAS thread: SuperLU's many small products run slower on several, most of all when shared.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

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
    mechanics_jitter,
    mechanics_large,
    mechanics_receptors,
    mechanics_rounding,
    mechanics_shapes,
    mechanics_speed,
)
from benchmarks.harness import Table, holds, median_of, run_parts
from phytac_design.design.design_file import load_design
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.mechanics.shell.compliance import marker_compliance
from phytac_design.mechanics.shell.element import element_stiffness
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.mesh_writers import write_inp
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model, rigid_modes
from phytac_design.mechanics.verification import cases
from phytac_shapes.arrays import FloatArray

MARKER = 184  # row 11 of 23
FINGERTIP_MM = 6.0
FORCE_N = 10.0
COARSE = "discretisation error of second order: a quarter of it with twice the elements"
ProblemBuilder = Callable[[int], float]


def published(table: Table, *, quick: bool) -> None:
    """Published linear cases: error in percent of the reference."""
    coarse_fine = {16: "<= 3", 32: "<= 1.5"}
    pinched = {16: "<= 7", 32: "<= 2"}
    named: list[tuple[str, ProblemBuilder, str, str, dict[int, str]]] = [
        ("Scordelis-Lo roof", cases.scordelis_lo, "0.3024", "published reference", coarse_fine),
        ("pinched cylinder", cases.pinched_cylinder, "1.82488e-5", "published reference", pinched),
        (
            "hemisphere, 18° hole",
            cases.hemisphere_with_hole,
            "0.093",
            "published reference",
            coarse_fine,
        ),
        ("Raasch hook, n × n/2", cases.raasch_hook, "5.022", "published reference", coarse_fine),
    ]
    beams = (
        (0.32, True, "5.424535e-3", "published reference"),
        (0.32, False, "1.753248e-3", "published reference"),
        (0.0032, True, "5.256e3", "Belytschko, Wong, Stolarski 1989"),
        (0.0032, False, "1.294e3", "Belytschko, Wong, Stolarski 1989"),
    )
    for t, along, reference, source in beams:
        name = f"twisted beam t = {t}, force {'along' if along else 'across'} the width, n × n/4"
        beam = partial(cases.twisted_beam, thickness=t, in_plane=along)
        named.append((name, beam, reference, source, {8: "<= 1.5", 16: "<= 1.5", 32: "<= 1.5"}))
    for t, value in cases.HYPERBOLOID.items():
        shell = partial(cases.hyperboloid, thickness=t)
        named.append(
            (f"free hyperboloid t = {t}", shell, str(value), "published reference", coarse_fine)
        )
    for name, case, reference, source, targets in named:
        for n, target in targets.items():
            if quick and n > 16:
                continue
            ratio = case(n)
            error = abs(ratio - 1.0) * 100.0
            why = "" if holds(error, target) else f"; {COARSE}"
            table.add(
                f"{name}, {n} elements a side",
                error,
                "%",
                reference=reference,
                source=source,
                target=target,
                note=f"computed / reference = {ratio:.5f}{why}",
            )


def soundness(table: Table) -> None:
    """Zero-energy modes of a warped element; the drilling factor; jittered meshes."""
    nodes = np.array([[0.0, 0, 0], [1.3, 0.1, 0.2], [1.1, 1.2, -0.3], [-0.1, 0.9, 0.4]])
    directors = np.array([[0.1, -0.2, 1], [0.2, 0, 1], [-0.1, 0.1, 1], [0, 0.2, 1]])
    directors /= np.linalg.norm(directors, axis=1)[:, None]
    element = element_stiffness(nodes, np.array([[0, 1, 2, 3]]), directors, poisson=0.3)
    K = element.combine(modulus_MPa=1.0, thickness_mm=0.1)[0]
    values = np.linalg.eigvalsh(K)
    zero = int(np.sum(np.abs(values) < 1e-11 * values[-1]))
    theory = "rigid motions of a body"
    table.add(
        "zero-energy modes, warped element",
        zero,
        "modes",
        reference=6,
        source=theory,
        target="== 6",
    )
    force = float(np.abs(K @ rigid_modes(nodes).reshape(24, 6)).max() / np.abs(K).max())
    table.add(
        "force under rigid motion / stiffness",
        force,
        "-",
        reference=0,
        source=theory,
        target="<= 1e-10",
    )
    effect = max(
        abs(case(16, drilling=1.0) / case(16, drilling=1e-4) - 1.0)
        for case in (cases.scordelis_lo, cases.pinched_cylinder, cases.hemisphere_with_hole)
    )
    table.add(
        "drilling factor 1 against 1e-4, worst of three shells",
        effect * 100.0,
        "%",
        reference=0,
        source="derived",
        target="<= 0.1",
    )
    for name, case in (
        ("Scordelis-Lo roof", cases.scordelis_lo),
        ("pinched cylinder", cases.pinched_cylinder),
        ("hemisphere, 18° hole", cases.hemisphere_with_hole),
    ):
        change = abs(case(32, jitter=0.25) / case(32) - 1.0) * 100.0
        table.add(
            f"{name}, 32 a side, nodes jittered ±25 %: change",
            change,
            "%",
            reference=0,
            source="the regular mesh",
            target="<= 5",
        )


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
    table.add(
        f"{label}: greatest difference of a marker from ccx, of the peak",
        float(np.abs(motion - theirs).max()) / peak * 100.0,
        "%",
        reference=peak,
        source="CalculiX S4, the exported .inp, linear; reference is the peak in mm",
        target="<= 3",
    )


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
        table.add(
            f"marker compliance of cylinder60, refine {refine}, {how}",
            median_of(partial(all_of_it, symmetry=symmetry), 3),
            "s",
            reference=3.0,
            source="published reference",
            target="<= 3" if symmetry else None,
        )


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""

    def linear(table: Table) -> None:
        published(table, quick=quick)
        if not quick:
            soundness(table)
        for refine in (4,) if quick else (4, 6):
            against_ccx(table, refine)
        compliance(table, 2 if quick else 4)

    def large(table: Table) -> None:
        mechanics_large.published(table, quick=quick)
        mechanics_large.fingertip(table, quick=quick)
        mechanics_large.add_rows(table, quick=quick)

    return {
        "linear": linear,
        "rounding": mechanics_rounding.add_rows,
        "extremes": partial(mechanics_jitter.add_rows, quick=quick),
        "large": large,
        "shapes": partial(mechanics_shapes.add_rows, quick=quick),
        "calibration": partial(mechanics_calibration.add_rows, quick=quick),
        "receptors": partial(mechanics_receptors.add_rows, quick=quick),
        "speed": partial(mechanics_speed.add_rows, quick=quick),
    }


def main() -> None:
    """Run all parts, or those named."""
    run_parts("mechanics", parts, __doc__ or "")


if __name__ == "__main__":
    main()
