"""The force error: exact on its own truth, falling with the mesh, predicted by the pilot."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.simulation.instance_shell import truth_levels
from phytac_design.study.tradeoff.force import ForceError, extrapolated, fit_forces, rms
from phytac_design.study.tradeoff.pilot import ForcePilot
from phytac_shapes.errors import DesignError
from tests.designs import drawn

DRAFT = PRESETS["draft"]


@pytest.fixture(scope="module")
def error() -> ForceError:
    return ForceError(drawn("hemisphere", 1), count=6)


def test_forces_are_read_from_their_own_shifts() -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(5, 3, 40)) * np.array([1.0, 1e-2, 1e-4])[:, None]
    force = rng.uniform(3.0, 25.0, 5)
    shift = np.einsum("ckn,ck->cn", rows, force[:, None] ** np.arange(1, 4))
    assert np.allclose(fit_forces(rows, shift), force, rtol=1e-9)
    # A sensor twice as soft is read as twice the force, by linear theory.
    assert np.allclose(fit_forces(rows[:, :1], 2.0 * force[:, None] * rows[:, 0]), 2.0 * force)


def test_a_mesh_read_by_itself_has_no_error(error: ForceError) -> None:
    rows = error.rows(3, receptors=True, orders=1)
    own = error.contacts.force_N[:, None] * rows[:, 0]
    assert np.allclose(fit_forces(rows, own), error.contacts.force_N)


def test_finer_meshes_and_series_err_less(error: ForceError) -> None:
    base = replace(DRAFT, place_share=0.4)
    settings = [
        replace(base, refine=refine, place_orders=orders)
        for refine, orders in ((2, 1), (2, 3), (4, 3), (8, 3))
    ]
    errors = [rms(error.errors(setting)) for setting in settings]
    assert errors[:3] == sorted(errors[:3], reverse=True)
    # From 3 elements on the linear part is extrapolated, and only the interpolation errs.
    assert errors[3] == pytest.approx(errors[2], rel=0.1)
    assert errors[-1] < 0.5 * errors[1]


def test_the_reference_is_met_by_a_third_mesh(error: ForceError) -> None:
    """Extrapolated from 8 and 12 it predicts the result of 15: d(15) = d(∞) − C/15²."""
    linear, fine = error.linear_reference, error.linear_truth(15)
    other = error.linear_truth(12)
    residual = rms(fit_forces(fine[:, None], linear) - 1.0)
    assert residual < 0.75 * rms(fit_forces(other[:, None], linear) - 1.0)
    assert residual < 0.006
    # Errors of 1/64 and 1/144 of the first mesh extrapolate to none.
    limit = extrapolated(np.array([1.0 + 1.0 / 64.0]), np.array([1.0 + 1.0 / 144.0]))
    assert limit == pytest.approx(1.0)
    coarse, large = error.truth(8), error.truth(12)
    for name in ("shift_px", "motion"):
        step = getattr(large, name) - getattr(coarse, name)
        limit = getattr(large, name) + step * 64.0 / (144.0 - 64.0)
        assert np.allclose(getattr(error.reference, name), limit)


def test_simulated_sensors_of_all_but_the_coarsest_meshes_are_extrapolated(
    error: ForceError,
) -> None:
    limit = error.linear_reference
    plain = {n: rms(fit_forces(error.linear_truth(n)[:, None], limit) - 1.0) for n in (5, 6, 9)}
    assert error.truth_error(5) == plain[5]
    assert error.truth_error(6) < 0.4 * plain[6]
    assert error.truth_error(9) < 0.4 * plain[9]


def test_no_simulated_sensor_is_judged_by_itself(error: ForceError) -> None:
    assert error.reference_refines[::-1] not in {truth_levels(n) for n in range(33)}


def test_the_pilot_predicts_the_error(error: ForceError) -> None:
    pilot = ForcePilot(error)
    tried = ((2, 1, 1.2), (3, 1, 0.55), (3, 3, 0.8), (6, 1, 0.55), (6, 3, 0.55))
    for refine, orders, share in tried:
        setting = replace(DRAFT, refine=refine, place_orders=orders, place_share=share)
        got = rms(error.errors(setting))
        assert got <= pilot.predict(setting) <= 2.0 * pilot.safety * got


def test_tables_are_extrapolated_as_builds_do(error: ForceError) -> None:
    pilot = ForcePilot(error)
    off = {refine: rms(pilot.mesh(refine, True) - 1.0) for refine in (2, 3, 4)}
    assert off[3] == off[4] < 0.15 * off[2]
    # The powers above the first are scaled with it: as exact as those of a finer mesh.
    series = (replace(DRAFT, refine=n, place_orders=3, place_share=0.4) for n in (2, 3, 4))
    two, three, four = (rms(error.errors(setting)) for setting in series)
    assert max(three, four) < 0.3 * two
    # Where no such mesh holds the markers, a build takes the plain one.
    crowded = ForceError(error.design, count=2)
    plain = crowded.rows(3, receptors=True, orders=1)[:, 0]
    crowded.shell = partial(_without_mesh, crowded.shell, 6)
    assert np.array_equal(crowded.linear_rows(3, receptors=True), plain)


def _without_mesh(shell: Any, missing: int, refine: int, *, receptors: bool) -> Any:
    if refine == missing:
        raise DesignError("mesh-markers-too-close", "no mesh holds the markers")
    return shell(refine, receptors=receptors)


def test_one_setting_alone(error: ForceError) -> None:
    pilot = ForcePilot(error)
    mesh = [pilot.alone("refine", replace(DRAFT, refine=refine)) for refine in (1, 2, 4)]
    assert mesh == sorted(mesh, reverse=True)
    theory = [pilot.alone("place_orders", replace(DRAFT, place_orders=k)) for k in (1, 3)]
    assert theory[1] < theory[0]
    places = [pilot.alone("place_share", replace(DRAFT, place_share=s)) for s in (1.2, 0.4)]
    assert places[1] < places[0]
    bare = pilot.alone("receptors", replace(DRAFT, receptors=False))
    assert bare != pytest.approx(pilot.alone("receptors", DRAFT), rel=1e-3)
