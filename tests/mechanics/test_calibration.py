"""Calibration: intervals that hold, refusals with reasons, and the finite-element response."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.layout import make_markers
from phytac_design.mechanics.calibration.calibration import calibrate
from phytac_design.mechanics.calibration.calibration_noise import (
    MeasurementNoise,
    estimate_noise,
    whiten,
)
from phytac_design.mechanics.calibration.calibration_result import Calibration, ShellParameters
from phytac_design.mechanics.calibration.measurements import Measurements, read_measurements
from phytac_design.mechanics.calibration.probe_response import (
    ProbeMotion,
    ProbeResponse,
    probe_weights,
)
from phytac_design.mechanics.meshing.mesh import ShellMesh, chart_mesh
from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.receptor_stiffness import ReceptorStiffness
from phytac_design.mechanics.shell.solve import clamped_model
from phytac_shapes import Cylinder
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError, NumericalError, PhytacError
from tests.designs import small
from tests.refusals import refused

TRUTH = ShellParameters(modulus=2050.0, thickness=0.86, poisson=0.36)
DESIGN = ShellParameters(modulus=2200.0, thickness=0.8, poisson=0.38)
REPEATS = 100
HOLD = 90  # of 100, at 95 %: the figure; 2.3 standard deviations of the count below 95


class Mixture:
    """Rows whose displacement mixes stretching (1/t) and bending ((1-ν²)/t³), in closed form."""

    def __init__(self, share: FloatArray) -> None:
        self.share = share

    def __call__(self, t: float, v: float, with_poisson: bool, /) -> ProbeMotion:
        stretch, bend = self.share / t, (1.0 - self.share) * (1.0 - v * v) / t**3
        return ProbeMotion(
            value=10.0 * (stretch + bend),
            thickness_rate=-10.0 * (stretch + 3.0 * bend) / t,
            poisson_rate=-20.0 * v * (1.0 - self.share) / t**3 if with_poisson else None,
            mesh_error=np.zeros_like(self.share),
        )


def data(
    share: FloatArray, press: IntArray, noise: MeasurementNoise, seed: int = 0, force_N: float = 1.0
) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    clean = force_N * Mixture(share)(TRUTH.thickness, TRUTH.poisson, False).value / TRUTH.modulus
    row = 1.0 + noise.relative * rng.standard_normal(len(clean))
    read = 1.0 + noise.force_relative * rng.standard_normal(press.max() + 1)
    return {
        "force_N": force_N * read[press],
        "displacement_mm": clean * row + noise.floor_mm * rng.standard_normal(len(clean)),
        "press": press,
    }


def spread(rows: int, presses: int) -> tuple[Mixture, FloatArray, IntArray]:
    share = np.random.default_rng(7).uniform(0.0, 1.0, rows)
    return Mixture(share), share, np.arange(rows) % presses


@pytest.mark.parametrize(
    ("presses", "force_noise"),
    [
        pytest.param(400, 0.0, id="single", marks=pytest.mark.long),
        pytest.param(20, 0.02, id="shared"),
    ],
)
def test_intervals_hold_and_are_not_idle(presses: int, force_noise: float) -> None:
    model, share, press = spread(400, presses)
    noise = MeasurementNoise(relative=0.05, floor_mm=1e-4, force_relative=force_noise)
    start = replace(DESIGN, poisson=TRUTH.poisson)
    held, error, claimed = [], [], []
    for seed in range(REPEATS):
        fit = calibrate(model, **data(share, press, noise, seed), start=start, fixed=("poisson",))
        held.append(inside(fit))
        error.append(np.log(fit.value.modulus / TRUTH.modulus))
        claimed.append(np.log(fit.high.modulus / fit.low.modulus) / 2.0)
    assert np.min(np.sum(held, axis=0)) >= HOLD
    # As wide as the scatter asks for: neither luck nor idle width makes them hold.
    assert 1.6 < np.mean(claimed) / np.std(error) < 2.7


def inside(fit: Calibration) -> list[bool]:
    names = ("modulus", "thickness")
    return [getattr(fit.low, n) < getattr(TRUTH, n) < getattr(fit.high, n) for n in names]


def test_noise_is_found_again() -> None:
    rng = np.random.default_rng(3)
    expected, press = rng.uniform(0.0, 0.05, 6000), np.arange(6000) % 200
    true = MeasurementNoise(relative=0.05, floor_mm=5e-4, force_relative=0.03)
    residual = expected * (
        0.05 * rng.standard_normal(6000) + 0.03 * rng.standard_normal(200)[press]
    )
    residual += 5e-4 * rng.standard_normal(6000)
    found = estimate_noise(expected, residual, press, fitted=2)
    for name in ("relative", "floor_mm", "force_relative"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=0.15)


def test_whitening_is_the_inverse_root_of_the_covariance() -> None:
    rng = np.random.default_rng(4)
    expected, press = rng.uniform(0.1, 1.0, 7), np.array([0, 0, 1, 1, 1, 2, 0])
    noise = MeasurementNoise(relative=0.1, floor_mm=0.05, force_relative=0.2)
    V = np.diag((0.1 * expected) ** 2 + 0.05**2)
    V += 0.04 * np.outer(expected, expected) * (press[:, None] == press)
    W = whiten(noise, expected, press, np.eye(7))
    np.testing.assert_allclose(W.T @ W, np.linalg.inv(V), rtol=1e-9, atol=1e-9)


def test_poisson_is_fitted_where_it_can_be_and_held_where_not() -> None:
    model, share, press = spread(400, 400)
    share[:] = np.tile([0.0, 0.3, 0.7, 1.0], 100)
    quiet = MeasurementNoise(relative=1e-4, floor_mm=0.0, force_relative=0.0)

    class Apart(Mixture):
        """Also rows that depend on ν alone in a way of their own."""

        def __call__(self, t: float, v: float, with_poisson: bool, /) -> ProbeMotion:
            base = super().__call__(t, v, with_poisson)
            gain, turn = np.ones(400), np.zeros(400)
            gain[::8], turn[::8] = 1.0 - v, -1.0
            rate = None
            if base.poisson_rate is not None:
                rate = base.poisson_rate * gain + base.value * turn
            return replace(
                base,
                value=base.value * gain,
                thickness_rate=base.thickness_rate * gain,
                poisson_rate=rate,
            )

    rows = data(share, press, quiet)
    held = calibrate(model, **rows, start=replace(DESIGN, poisson=TRUTH.poisson), fixed=["poisson"])
    assert held.fitted == ("modulus", "thickness")
    assert set(held.poisson_pull) == {"modulus", "thickness"}
    rows["displacement_mm"] = rows["displacement_mm"] * np.where(
        np.arange(400) % 8 == 0, 1.0 - TRUTH.poisson, 1.0
    )
    fit = calibrate(Apart(share), **rows, start=DESIGN)
    assert fit.fitted == ("modulus", "thickness", "poisson")
    assert fit.value.poisson == pytest.approx(TRUTH.poisson, abs=1e-3)
    assert fit.value.thickness == pytest.approx(TRUTH.thickness, rel=1e-3)


def test_one_exponent_cannot_part_modulus_and_wall() -> None:
    share = np.full(60, 0.4) + np.linspace(-0.01, 0.01, 60)
    rows = data(
        share, np.arange(60), MeasurementNoise(relative=0.05, floor_mm=0.0, force_relative=0.0)
    )
    with refused("calibration-undetermined"):
        calibrate(Mixture(share), **rows, start=DESIGN)
    known = replace(DESIGN, thickness=TRUTH.thickness, poisson=TRUTH.poisson)
    fit = calibrate(Mixture(share), **rows, start=known, fixed=["thickness", "poisson"])
    assert fit.fitted == ("modulus",)
    assert fit.value.modulus == pytest.approx(TRUTH.modulus, rel=0.02)
    assert fit.value.thickness == fit.low.thickness == fit.high.thickness == TRUTH.thickness


def test_refusal_names_what_is_determined() -> None:
    share = np.linspace(0.3, 0.5, 60)
    rows = data(
        share, np.arange(60), MeasurementNoise(relative=0.03, floor_mm=0.0, force_relative=0.0)
    )
    start = replace(DESIGN, poisson=TRUTH.poisson)
    with refused("calibration-undetermined"):
        calibrate(Mixture(share), **rows, start=start, fixed=["poisson"])


ALTERNATING = np.tile([1.0, -0.5], 50)
BAD: dict[str, tuple[dict[str, Any], type[PhytacError], str]] = {
    "few presses": ({"press": np.zeros(100, dtype=int)}, InputError, "1 presses are too few"),
    "outward": ({"displacement_mm": -1.0}, InputError, "other way"),
    "micrometres": ({"displacement_mm": 1e3}, InputError, "check units"),
    "metres": ({"displacement_mm": 1e-3}, InputError, "check units"),
    "too hard": ({"force_N": 12.0, "displacement_mm": 12.0}, InputError, "linear theory"),
    "not a number": (
        {"displacement_mm": np.where(np.arange(100) == 7, np.nan, 1.0)},
        InputError,
        "row 7 is not finite",
    ),
    "another sensor": ({"displacement_mm": ALTERNATING}, NumericalError, "unexplained"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_data_are_refused(case: str) -> None:
    change, error, message = BAD[case]
    _, share, press = spread(100, 100)
    rows = data(share, press, MeasurementNoise(relative=0.02, floor_mm=0.0, force_relative=0.0))
    for name, value in change.items():
        rows[name] = value if name == "press" else rows[name] * value
    with pytest.raises(error, match=message):
        calibrate(Mixture(share), **rows, start=DESIGN)


def test_too_few_rows_are_refused() -> None:
    _, share, press = spread(8, 8)
    rows = data(share, press, MeasurementNoise(relative=0.02, floor_mm=0.0, force_relative=0.0))
    with refused("calibration-too-few-rows"):
        calibrate(Mixture(share), **rows, start=DESIGN)


def test_everything_fixed_is_refused() -> None:
    _, share, press = spread(100, 100)
    rows = data(share, press, MeasurementNoise(relative=0.02, floor_mm=0.0, force_relative=0.0))
    with refused("calibration-nothing-free"):
        calibrate(Mixture(share), **rows, start=DESIGN, fixed=["modulus", "thickness"])


SURFACE = Cylinder(diameter_outer_mm=60.0, length_mm=60.0)


def places() -> Measurements:
    """Four presses, each seen at thirty places."""
    probes = np.stack(
        np.meshgrid(np.linspace(6.0, 54.0, 6), np.linspace(-0.8, 0.8, 5)), axis=-1
    ).reshape(-1, 2)
    contact = np.array([[8.0, 0.02], [14.0, 0.1], [30.0, 0.0], [45.0, 0.0]])
    count = len(contact) * len(probes)
    return Measurements(
        contact_uv=np.repeat(contact, len(probes), axis=0),
        probe_uv=np.tile(probes, (len(contact), 1)),
        radius_mm=np.repeat([6.0, 10.0, 6.0, 10.0], len(probes)),
        force_N=np.ones(count),
        displacement_mm=np.zeros(count),
    )


def on_another_mesh(rows: Measurements) -> FloatArray:
    """Displacements per newton of the true sensor on a finer mesh, not extrapolated."""
    mesh = chart_mesh(SURFACE, thickness_mm=TRUTH.thickness, n_along=36, n_around=100)
    model = clamped_model(mesh, modulus_MPa=TRUTH.modulus, poisson=TRUTH.poisson)
    loads = patch_loads(mesh, SURFACE, rows.contact_uv, rows.radius_mm)
    first = np.unique(rows.contact_uv[:, 0], return_index=True)[1]
    motion = model.solve(loads[:, first]).motion
    load = np.searchsorted(rows.contact_uv[first, 0], rows.contact_uv[:, 0])
    nodes, weight = probe_weights(mesh, SURFACE, rows.probe_uv)
    found: FloatArray = np.einsum("ncd,ncd->n", weight, motion[nodes, :, load[:, None]])
    return found


def test_parameters_come_back_from_another_mesh() -> None:
    rows = places()
    clean = 0.5 * on_another_mesh(rows)
    rng = np.random.default_rng(5)
    noisy = clean * (1.0 + 0.01 * rng.standard_normal(len(clean)))
    fit = calibrate(
        ProbeResponse(surface=SURFACE, rows=rows, around=28),
        force_N=0.5 * rows.force_N,
        displacement_mm=noisy + 2e-5 * rng.standard_normal(len(clean)),
        press=rows.press,
        start=replace(DESIGN, poisson=TRUTH.poisson),
        fixed=["poisson"],
    )
    # Coarse, to be quick (1 % is for the benchmark); without extrapolation the wall is 6 % off.
    assert fit.value.modulus == pytest.approx(TRUTH.modulus, rel=0.03)
    assert fit.value.thickness == pytest.approx(TRUTH.thickness, rel=0.02)
    assert all(inside(fit))
    assert fit.presses == 4
    assert "E·t^" in fit.text()


def striped(mesh: ShellMesh) -> ReceptorStiffness:
    """Made-up factors that differ from element to element."""
    wave = np.sin(np.arange(len(mesh.quads)))
    return ReceptorStiffness(membrane=1.1 + 0.2 * wave, bending=1.6 - 0.4 * wave)


@pytest.mark.parametrize("factors", [None, striped])
def test_response_rates_are_its_derivatives(
    factors: Callable[[ShellMesh], ReceptorStiffness] | None,
) -> None:
    rows = places()
    response = ProbeResponse(surface=SURFACE, rows=rows, around=24, factors=factors)
    at = response(0.8, 0.38, True)
    assert at.poisson_rate is not None
    turned = (response(0.8, 0.381, False).value - response(0.8, 0.379, False).value) / 2e-3
    scale = np.abs(at.poisson_rate).max()
    np.testing.assert_allclose(at.poisson_rate, turned, atol=1e-5 * scale)
    # The wall grows inward: its middle face moves, which the rate leaves out (1 % of it here).
    grown = (response(0.801, 0.38, False).value - response(0.799, 0.38, False).value) / 2e-3
    scale = np.abs(at.thickness_rate).max()
    np.testing.assert_allclose(at.thickness_rate, grown, atol=0.015 * scale)


def test_interpolation_is_exact_for_rigid_turns_and_better_than_bilinear() -> None:
    mesh = chart_mesh(SURFACE, thickness_mm=0.8, n_along=12, n_around=24)
    uv = np.array([[17.3, 0.2], [31.0, 3.05]])
    nodes, weight = probe_weights(mesh, SURFACE, uv)
    # Inward bulge (z - 30)² with its rotation about the tangent: quadratic along the wall.
    z = mesh.nodes_mm[:, 2]
    inward, along = -mesh.normals, np.array([0.0, 0.0, 1.0])
    motion = np.zeros((len(z), 6))
    motion[:, :3] = inward * ((z - 30.0) ** 2)[:, None]
    motion[:, 3:] = np.cross(along, inward) * (2.0 * (z - 30.0))[:, None]
    found = np.einsum("ncd,ncd->n", weight, motion[nodes])
    true = (uv[:, 0] - 30.0) ** 2
    bilinear = np.einsum("ncd,ncd->n", weight[:, :, :3], motion[nodes][:, :, :3])
    assert np.all(np.abs(found - true) < 0.1 * np.abs(bilinear - true) + 0.02 * true)


GOOD = "contact_marker,patch_radius_mm,force_N,displacement_mm\n3,4,1,0.01\n4,4,1.5,0.02\n"


def read(tmp_path: Path, text: str) -> Measurements:
    design = small()
    surface = design.surface()
    path = tmp_path / "m.csv"
    path.write_text(text, encoding="utf-8")
    return read_measurements(path, surface, make_markers(design, surface), wall_mm=0.8)


def test_positions_are_given_in_three_ways(tmp_path: Path) -> None:
    design = small()
    surface = design.surface()
    markers = make_markers(design, surface)
    by_marker = read(tmp_path, "# rig 2\n" + GOOD)
    np.testing.assert_array_equal(by_marker.contact_uv, markers.uv[[3, 4]])
    np.testing.assert_array_equal(by_marker.probe_uv, markers.uv[[3, 4]])
    np.testing.assert_array_equal(by_marker.force_N, [1.0, 1.5])
    assert by_marker.press.tolist() == [0, 1]
    twice = read(tmp_path, GOOD.replace("4,4,1.5", "3,4,1.5") + "3,4,1.5,0.03\n")
    assert twice.press.tolist() == [0, 1, 1]  # the same place and patch, another force
    u, v = markers.uv[3].tolist()
    x, y, z = markers.mid_mm[3].tolist()
    for columns, values in (
        ("contact_u,contact_v", f"{u!r},{v!r}"),
        ("contact_x_mm,contact_y_mm,contact_z_mm", f"{x!r},{y!r},{z!r}"),
    ):
        text = (
            f"displacement_mm,probe_marker,{columns},force_N,patch_radius_mm\n0.01,7,{values},1,4"
        )
        found = read(tmp_path, text)
        np.testing.assert_allclose(found.contact_uv, markers.uv[[3]], atol=1e-12)
        np.testing.assert_array_equal(found.probe_uv, markers.uv[[7]])


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("", "csv-empty"),
        (GOOD.splitlines()[0], "csv-empty"),
        (GOOD.replace("0.02", "nan"), "csv-value-invalid"),
        (GOOD.replace("0.02", "0_02"), "csv-value-invalid"),
        (GOOD.replace("0.02", ""), "csv-value-invalid"),
        (GOOD.replace("0.02", "0,02"), "csv-row-length"),
        (GOOD + GOOD.splitlines()[1] + "\n", "csv-row-duplicate"),
        (GOOD.replace("force_N", "force"), "csv-column-unknown"),
        (
            GOOD.replace(",force_N", "").replace(",1,", ",").replace(",1.5,", ","),
            "csv-column-missing",
        ),
        (GOOD.replace("displacement_mm", "force_N"), "csv-column-duplicate"),
        (GOOD.replace("1.5", "-1.5"), "csv-value-range"),
        (GOOD.replace("4,4,", "4,-4,"), "csv-value-range"),
        (GOOD.replace("4,4,", "4,0.004,"), "csv-value-range"),
        (GOOD.replace("\n4,", "\n112,"), "csv-value-range"),
        (GOOD.replace("\n4,", "\n4.5,"), "csv-value-range"),
        (
            GOOD.replace("contact_marker", "probe_marker"),
            "csv-columns-ambiguous",
        ),
        (
            "contact_u,contact_v,patch_radius_mm,force_N,displacement_mm\n61,0,4,1,0.01",
            "csv-value-range",
        ),
        (
            GOOD.replace("contact_marker", "contact_x_mm,contact_y_mm,contact_z_mm")
            .replace("3,4,1", "0.03,0,0.02,4,1")
            .replace("4,4,1.5", "30,0,20,4,1"),
            "csv-value-range",
        ),
    ],
)
def test_bad_files_are_refused(text: str, code: str, tmp_path: Path) -> None:
    with refused(code):
        read(tmp_path, text)


def test_files_that_are_not_text_or_not_there_are_refused(tmp_path: Path) -> None:
    design = small()
    surface = design.surface()
    markers = make_markers(design, surface)
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x81")
    for name, code in (("b.csv", "file-not-csv"), ("none.csv", "file-unreadable")):
        with refused(code):
            read_measurements(tmp_path / name, surface, markers, wall_mm=0.8)
