"""Estimators: exact data give exact forces; ill-conditioned, lost, single-precision data."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from phytac_decoder.estimation.contact_fit import ContactPrior, ShiftNoise
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.estimation.nonnegative import nonnegative_least_squares
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_shapes.arrays import FloatArray, IntArray
from verification.case import Case, Cases, Evidence, Recorder, verify

SIDE_MM, PITCH_MM, SMEAR_MM, RADIUS_MM = 60.0, 6.0, 7.0, 5.0
"""A flat sensor whose motion is known in closed form: a dent is a Gaussian."""


def _grid(step_mm: float, margin_mm: float) -> FloatArray:
    count = round((SIDE_MM - 2.0 * margin_mm) / step_mm) + 1
    line = np.linspace(margin_mm, SIDE_MM - margin_mm, count)
    x, y = np.meshgrid(line, line, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


MARKERS = _grid(PITCH_MM, 3.0)


def dent_px(point_mm: FloatArray) -> FloatArray:
    """Shifts (2n,) px by a newton at a point (3,): slope and depth of the dent there."""
    spread = SMEAR_MM**2 + RADIUS_MM**2 / 4.0
    arm = MARKERS[:, :2] - point_mm[:2]
    depth = SMEAR_MM**2 / spread * np.exp(-0.5 * np.sum(arm**2, axis=1) / spread)
    shift = np.array([0.4, 0.3]) * depth[:, None] - 5.0 * depth[:, None] * arm / spread
    return np.asarray(shift.ravel())


def flat_model(scale: float = 1.0) -> ForceModel:
    """The sensor as estimators see it; pixels ``scale`` times as large."""
    compliance = scale * np.stack([dent_px(point) for point in MARKERS], axis=1)
    to_mm = np.tile(np.array([0.4, 0.3]) / (scale * 20.0), (len(MARKERS), 1))
    apparent = np.einsum("ni,nim->nm", to_mm, compliance.reshape(-1, 2, len(MARKERS)))
    return ForceModel(
        shift_to_mm=to_mm,
        stiffness=np.linalg.inv(apparent),
        compliance_px=compliance,
        height_z_mm=np.zeros(len(MARKERS)),
        neighbours=_neighbours(),
        networks={},
    )


def _neighbours() -> IntArray:
    gap = np.linalg.norm(MARKERS[:, None] - MARKERS[None], axis=2)
    order = np.argsort(gap, axis=1)[:, 1:9]
    near = np.take_along_axis(gap, order, axis=1) < 1.5 * PITCH_MM
    return np.where(near, order, -1)


def flat_locator() -> ContactLocator:
    """The estimator ``auto`` of that sensor."""
    points = _grid(2.5, 0.0)
    first = np.stack([dent_px(point) for point in points])
    ones = np.ones(len(points))
    return ContactLocator(
        places=ResponseTable(
            point_mm=points,
            along=np.outer(ones, [1.0, 0.0, 0.0]),
            around=np.outer(ones, [0.0, 1.0, 0.0]),
            shift_px=first[:, None].astype(np.float32),
            radius_mm=RADIUS_MM,
        ),
        position_mm=MARKERS,
        neighbours=_neighbours(),
        footprint_mm=2.3,
        threshold_N=np.full(len(MARKERS), 0.5),
        prior=ContactPrior(place_mm=1.5),
        noise=ShiftNoise(centroid_px=0.02, share=0.005, switched_px=0.0),
    )


def check_exact(values: Mapping[str, Any], found: Evidence) -> None:
    """Noise-free data of the estimator's own model give the forces back; SciPy's nnls agrees."""
    from scipy.optimize import nnls

    model = flat_model(values["scale"])
    rng = np.random.default_rng(values["seed"])
    koi = np.sort(rng.permutation(len(MARKERS))[: values["koi"]])
    force = np.zeros(len(MARKERS))
    force[koi] = values["force"] * rng.uniform(0.1, 1.0, len(koi))
    shift = (model.compliance_px @ force).reshape(-1, 2)
    lost = rng.permutation(len(MARKERS))[: values["lost"]]
    if values["estimator"] == "koi_inverse":
        shift[lost] = np.nan
    got = model.forces(values["estimator"], shift, koi)
    columns = model.compliance_px[:, koi]
    if values["estimator"] == "fem":
        condition = float(np.linalg.cond(model.stiffness))
        slack = 64.0 * 2.0**-52 * condition
    else:
        # The normal equations square the condition number of the columns.
        seen = np.isfinite(shift.ravel())
        condition = float(np.linalg.cond(columns[seen]) ** 2)
        slack = 64.0 * 2.0**-52 * condition
        theirs = nnls(columns[seen], shift.ravel()[seen])[0]
        found.close("SciPy's nnls", got[koi], theirs, max(1e-9, slack))
    found.facts["condition"] = condition
    found.close("the forces that made the data", got, force, max(1e-9, slack))
    found.true("no force off the key nodes", np.delete(got, koi) == 0.0)
    narrow = replace(model, compliance_px=model.compliance_px.astype(np.float32).astype(float))
    there = narrow.forces(values["estimator"], shift.astype(np.float32).astype(float), koi)
    share = 8.0 * float(np.finfo(np.float32).eps) * np.sqrt(condition) + 1e-6
    if values["estimator"] == "fem":
        share = 8.0 * float(np.finfo(np.float32).eps) * condition
    found.close("data in single precision", there, force, share, kind="float32")


def check_alike(values: Mapping[str, Any], found: Evidence) -> None:
    """Two receptors that move all markers nearly alike: their sum is known, their share is not."""
    from scipy.optimize import nnls

    rng = np.random.default_rng(3)
    first, other = rng.normal(size=(2, 80))
    columns = np.stack([first, first + values["apart"] * other], axis=1)
    wanted = np.array([3.0, 5.0])
    right = columns @ wanted
    got = nonnegative_least_squares(columns.T @ columns, columns.T @ right)
    theirs = nnls(columns, right)[0]
    found.add(
        "residual norm: SciPy's nnls",
        (np.linalg.norm(columns @ got - right) - np.linalg.norm(columns @ theirs - right))
        / np.linalg.norm(right),
        1e-7,
    )
    found.add(
        "sum of both forces",
        got.sum() / wanted.sum() - 1.0,
        1e-6 + 4.0 * values["apart"] if values["apart"] < 1e-4 else 1e-6,
    )
    found.true("no force is negative", got >= 0.0)
    found.true("every force is finite", np.isfinite(got))
    found.facts["condition"] = float(np.linalg.cond(columns))


def check_random(values: Mapping[str, Any], found: Evidence) -> None:
    """Noisy data of any shape, against SciPy's nnls."""
    from scipy.optimize import nnls

    rng = np.random.default_rng(values["seed"])
    rows, size = values["rows"], values["size"]
    a = rng.normal(size=(rows, size)) + values["alike"] * rng.normal(size=(rows, 1))
    b = rng.normal(size=rows) + a @ rng.normal(size=size)
    a, b = a * values["scale"], b * values["scale"]
    got = nonnegative_least_squares(a.T @ a, a.T @ b)
    theirs = nnls(a, b, maxiter=100 * size)[0]
    condition = float(np.linalg.cond(a) ** 2)
    found.facts["condition"] = condition
    found.close("SciPy's nnls", got, theirs, 64.0 * 2.0**-52 * condition + 1e-10)


def check_auto(values: Mapping[str, Any], found: Evidence) -> None:
    """Contacts of the closed form, found again: within three of their own standard deviations."""
    locator = flat_locator()
    points = np.array(values["points"], dtype=np.float64)
    forces = np.array(values["forces"], dtype=np.float64)
    shift = sum(f * dent_px(np.append(p, 0.0)) for f, p in zip(forces, points, strict=True))
    pressed = np.zeros(len(MARKERS), dtype=bool)
    for force, point in zip(forces, points, strict=True):
        near = np.linalg.norm(MARKERS[:, :2] - point, axis=1)
        pressed |= (near < RADIUS_MM) & (force * 0.2 > 0.5)
        pressed[near.argmin()] |= force > 0.0
    shift = np.asarray(shift).reshape(-1, 2)
    rng = np.random.default_rng(0)
    shift[rng.permutation(len(MARKERS))[: values["lost"]]] = np.nan
    found_all = locator.find(shift, np.flatnonzero(pressed))
    got = [c for c in found_all.contacts if len(c.markers)]
    found.true("as many contacts as were made", len(got) == len(forces))
    if len(got) != len(forces):
        return
    gap = np.linalg.norm(np.stack([c.point_mm[:2] for c in got])[:, None] - points, axis=2)
    mine = gap.argmin(axis=0)
    spread = np.array([got[k].sd_N for k in mine])
    found.add(
        "closed form: forces, of three standard deviations",
        (np.array([got[k].force_N for k in mine]) - forces) / (3.0 * spread),
        1.0,
    )
    found.add("closed form: places, mm", gap.min(axis=0), 0.6)
    found.true("deviations are positive", spread > 0.0)
    found.facts["sd_N_largest"] = float(spread.max())


def check_void(values: Mapping[str, Any], found: Evidence) -> None:
    """No marker seen, no switch on, or no motion: no force, and every figure finite."""
    model = flat_model()
    model = replace(model, locator=flat_locator())
    shift = np.full((len(MARKERS), 2), values["shift"])
    koi = np.arange(values["koi"])
    got = model.forces(values["estimator"], shift, koi)
    found.true("every force is finite", np.isfinite(got))
    found.true("no force is negative", (got >= 0.0) | (values["estimator"] == "fem"))
    if values["koi"] == 0 or values["shift"] == 0.0:
        # A prior of the contact's place leaves no force where nothing moves.
        found.add("no force, N", np.abs(got).max(), 0.05)


def cases() -> Cases:
    """One key node to all of them; lost markers; columns ever more alike; no data."""
    out = Cases()
    for estimator in ("fem", "koi_inverse"):
        losses = (0, 30) if estimator == "koi_inverse" else (0,)
        for koi, scale, lost in product((1, 2, 10, 40, 100), (1e-6, 1.0, 1e6), losses):
            name = f"{estimator}: {koi} key nodes, pixels {scale:g} as large, {lost} lost"
            numbers = {"koi": koi, "scale": scale, "lost": lost, "force": 25.0, "seed": koi}
            out.add(name, check_exact, estimator=estimator, **numbers)
        for force in (1e-9, 1e6):
            numbers = {"koi": 5, "scale": 1.0, "lost": 0, "force": force, "seed": 1}
            name = f"{estimator}: forces of {force:g} N"
            out.add(name, check_exact, estimator=estimator, **numbers)
    for apart in (1.0, 1e-2, 1e-4, 1e-6, 1e-8, 1e-12, 0.0):
        out.add(f"two columns {apart:g} apart", check_alike, apart=apart)
    noisy = (
        (30, 12, 2.0, 1.0),
        (200, 60, 5.0, 1e-9),
        (61, 60, 0.0, 1e9),
        (400, 120, 1.0, 1.0),
        (12, 1, 0.0, 1e-150),
        (50, 40, 20.0, 1.0),
    )
    for seed, (rows, size, alike, scale) in enumerate(noisy):
        name = f"noise, {rows} x {size}, alike by {alike:g}, times {scale:g}"
        numbers = {"seed": seed, "rows": rows, "size": size, "alike": alike, "scale": scale}
        out.add(name, check_random, **numbers)
    contacts: dict[str, Any] = {
        "in the middle": ([[30.0, 30.0]], [10.0]),
        "between receptors": ([[28.6, 31.4]], [5.0]),
        "as strong as it may be": ([[30.0, 30.0]], [1000.0]),
        "faint": ([[33.0, 33.0]], [0.6]),
        "at the edge": ([[4.0, 30.0]], [10.0]),
        "in a corner": ([[4.0, 4.0]], [10.0]),
        "two, far apart": ([[12.0, 12.0], [48.0, 46.0]], [20.0, 3.0]),
        "two, strong and faint": ([[12.0, 30.0], [48.0, 30.0]], [200.0, 2.0]),
        "four": ([[10.0, 10.0], [10.0, 50.0], [50.0, 10.0], [50.0, 50.0]], [5.0, 9.0, 3.0, 20.0]),
    }
    for name, (points, forces) in contacts.items():
        for lost in (0, 30):
            numbers = {"points": points, "forces": forces, "lost": lost}
            out.add(f"auto: {name}, {lost} lost", check_auto, **numbers)
    void = (
        ("no motion", 0.0, 3),
        ("no switch on", 1.0, 0),
        ("all markers lost", float("nan"), 3),
        ("all markers lost, all switches on", float("nan"), 100),
        ("all moved alike by 1 Mpx", 1e6, 5),
    )
    for estimator in ("fem", "koi_inverse", "auto"):
        for name, shift, koi in void:
            title = f"{estimator}: {name}"
            out.add(title, check_void, estimator=estimator, shift=shift, koi=koi)
    return out


CASES = cases()


@CASES.parametrize
def test_estimators(case: Case, record_property: Recorder) -> None:
    """fem, koi_inverse, auto on data whose forces are known."""
    verify(case, record_property)
