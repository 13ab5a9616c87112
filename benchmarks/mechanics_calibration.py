"""Calibration rows of ``mechanics``: E, t and ν recovered from noisy data of a finer mesh.

The sensor: cylinder60, made of another resin and wall than its design says. Synthetic camera
data: the inward motion of every marker under presses of two patch sizes along the sensor, from a
mesh that is finer than, and not aligned with, those of the calibration. Noise: 5 % of
each displacement, 0.5 µm, and 1 % of the force of each press.
"""

import time
from dataclasses import astuple, replace
from typing import Any

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.mechanics.calibration.calibration import calibrate
from phytac_design.mechanics.calibration.calibration_result import (
    Calibration,
    Name,
    ShellParameters,
)
from phytac_design.mechanics.calibration.measurements import Measurements
from phytac_design.mechanics.calibration.probe_response import (
    ProbeMotion,
    ProbeResponse,
    ResponseModel,
    probe_weights,
)
from phytac_design.mechanics.meshing.mesh import chart_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

TRUTH = ShellParameters(modulus=2050.0, thickness=0.86, poisson=0.36)
TRUTH_VALUES = np.array(astuple(TRUTH))
PEAK_MM = 0.06
RADII_MM = (3.0, 8.0)
SOURCE = "synthetic data of a finer mesh, 5 % noise"


class InterpolatedResponse:
    """A response as a polynomial in thickness and ν through exact solutions, for fast repeats."""

    def __init__(self, exact: ProbeResponse, thickness: FloatArray, poisson: FloatArray) -> None:
        self.thickness, self.poisson = thickness, poisson
        found = [[exact(float(t), float(v), False) for v in poisson] for t in thickness]
        self.values = np.array([[r.value for r in row] for row in found])
        self.errors = np.array([[r.mesh_error for r in row] for row in found])

    def __call__(self, thickness_mm: float, poisson: float, with_poisson: bool, /) -> ProbeMotion:
        """Interpolate; the derivatives are those of the polynomial."""

        def in_poisson(values: FloatArray) -> Any:
            return BarycentricInterpolator(self.poisson, values, axis=-2)

        along = BarycentricInterpolator(self.thickness, in_poisson(self.values)(poisson))
        across = in_poisson(BarycentricInterpolator(self.thickness, self.values)(thickness_mm))
        errors = BarycentricInterpolator(self.thickness, in_poisson(self.errors)(poisson))
        return ProbeMotion(
            value=along(thickness_mm),
            thickness_rate=along.derivative(thickness_mm),
            poisson_rate=across.derivative(poisson) if with_poisson else None,
            mesh_error=errors(thickness_mm),
        )


def presses(quick: bool) -> tuple[Surface, Measurements]:
    """Places and patches of the experiment; forces and displacements still 1."""
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    rows = (0, 4, 11, 20) if quick else (0, 1, 2, 4, 7, 11, 15, 18, 20, 21, 22)
    chosen = np.array([design.layout.columns * row for row in rows])
    contact = np.repeat(markers.uv[chosen], len(RADII_MM), axis=0)
    radius = np.tile(RADII_MM, len(rows))
    count = len(contact) * markers.count
    return surface, Measurements(
        contact_uv=np.repeat(contact, markers.count, axis=0),
        probe_uv=np.tile(markers.uv, (len(contact), 1)),
        radius_mm=np.repeat(radius, markers.count),
        force_N=np.ones(count),
        displacement_mm=np.ones(count),
    )


def truth(surface: Surface, rows: Measurements, counts: tuple[int, int]) -> FloatArray:
    """Displacement of each row per newton, (n,), of the true sensor on one fine mesh."""
    mesh = chart_mesh(surface, thickness_mm=TRUTH.thickness, n_along=counts[0], n_around=counts[1])
    model = clamped_model(mesh, modulus_MPa=TRUTH.modulus, poisson=TRUTH.poisson)
    key = np.column_stack([rows.contact_uv, rows.radius_mm])
    distinct, load = np.unique(key, axis=0, return_inverse=True)
    motion = model.solve(patch_loads(mesh, surface, distinct[:, :2], distinct[:, 2])).motion
    nodes, weight = probe_weights(mesh, surface, rows.probe_uv)
    return np.asarray(np.einsum("ncd,ncd->n", weight, motion[nodes, :, load[:, None]]))


def measured(rows: Measurements, per_newton: FloatArray, seed: int) -> Measurements:
    """Noisy data: each press as hard as it takes to move its most moved marker by PEAK_MM."""
    rng = np.random.default_rng(seed)
    press = rows.press
    peak = np.zeros(press.max() + 1)
    np.maximum.at(peak, press, per_newton)
    force = (PEAK_MM / peak)[press]
    n = len(press)
    moved = force * per_newton * (1.0 + 0.05 * rng.standard_normal(n))
    read = force * (1.0 + 0.01 * rng.standard_normal(len(peak)))[press]
    moved += 0.0005 * rng.standard_normal(n)
    return replace(rows, force_N=read, displacement_mm=moved)


def errors(fit: Calibration) -> FloatArray:
    """Relative errors of E and t, absolute of ν, (3,)."""
    scale = np.array([TRUTH.modulus, TRUTH.thickness, 1.0])
    return np.asarray((np.array(astuple(fit.value)) - TRUTH_VALUES) / scale)


def inside(fit: Calibration) -> BoolArray:
    """Whether the truth lies in the interval, by parameter, (3,)."""
    low, high = np.array(astuple(fit.low)), np.array(astuple(fit.high))
    return (low <= TRUTH_VALUES) & (high >= TRUTH_VALUES)


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows of calibration to ``table``."""
    surface, rows = presses(quick)
    per_newton = truth(surface, rows, (64, 100) if quick else (124, 196))
    around = 48 if quick else 64
    exact = ProbeResponse(surface=surface, rows=rows, around=around)
    design = ShellParameters(modulus=2200.0, thickness=0.8, poisson=0.38)
    known = replace(design, poisson=TRUTH.poisson)
    start = time.perf_counter()
    # A force that keeps every displacement in the linear range.
    force = np.full(len(per_newton), PEAK_MM / np.abs(per_newton).max())
    noiseless = replace(rows, displacement_mm=per_newton * force, force_N=force)
    clean = _fit(exact, noiseless, known, ("poisson",))
    seconds = time.perf_counter() - start
    bias = errors(clean)
    for k, name in enumerate(("E", "t")):
        row = f"calibration, bias of {name} from the mesh alone (no noise)"
        source = "synthetic data of a finer mesh, no noise"
        note = (
            "without extrapolation over two meshes "
            f"{100 * abs(bias[k] - list(clean.mesh_pull.values())[k]):.2g} %"
        )
        table.add(row, 100.0 * abs(float(bias[k])), "%", 0.0, source, "<= 1", note)
    row = "calibration, time of one fit"
    source = f"{len(per_newton)} rows, meshes of {around} and {around * 3 // 2} around"
    table.add(row, seconds, "s", "none", source)
    grid = InterpolatedResponse(
        exact, np.linspace(0.76, 0.94, 3 if quick else 4), np.array([0.33, 0.38, 0.43])
    )
    repeats = 10 if quick else 100
    cases: tuple[tuple[str, ShellParameters, tuple[Name, ...]], ...] = (
        ("ν known", known, ("poisson",)),
        ("ν fitted too", design, ()),
    )
    for label, begin, fixed in cases:
        fits = [
            _fit(grid, measured(rows, per_newton, seed), begin, fixed) for seed in range(repeats)
        ]
        _repeat_rows(table, label, fits)


def _fit(
    response: ResponseModel, data: Measurements, start: ShellParameters, fixed: tuple[Name, ...]
) -> Calibration:
    return calibrate(
        response,
        force_N=data.force_N,
        displacement_mm=data.displacement_mm,
        press=data.press,
        start=start,
        fixed=fixed,
    )


def _repeat_rows(table: Table, label: str, fits: list[Calibration]) -> None:
    off = np.array([errors(fit) for fit in fits])
    held = np.array([inside(fit) for fit in fits])
    first = fits[0]
    names = [
        ("E", "modulus", 100.0, "%"),
        ("t", "thickness", 100.0, "%"),
        ("ν", "poisson", 1.0, "1"),
    ]
    for k, (symbol, name, scale, unit) in enumerate(names):
        if name not in first.fitted:
            continue
        target = "<= 1" if unit == "%" else "<= 0.01"
        row = f"calibration, {label}: error of {symbol}, root mean square of {len(fits)} repeats"
        note = (
            f"first repeat {scale * abs(off[0, k]):.2g}, largest "
            f"{scale * np.abs(off[:, k]).max():.2g}, within 0.01 in "
            f"{int(np.sum(np.abs(off[:, k]) <= 0.01))} of {len(fits)}"
        )
        value = scale * float(np.sqrt(np.mean(off[:, k] ** 2)))
        table.add(row, value, unit, float(getattr(TRUTH, name)), SOURCE, target, note)
        row = f"calibration, {label}: 95 % intervals that hold {symbol}"
        table.add(row, float(100.0 * held[:, k].mean()), "of 100 repeats", 95.0, SOURCE, ">= 90")
