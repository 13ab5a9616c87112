"""Batches over processes: the same bits with any number, and failures that stay alone."""

import os

import numpy as np
import pytest

from phytac_design.mechanics.large import batch
from phytac_design.mechanics.large.batch import Sample, solve_batch, solve_sample
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Loading
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.verification import large_cases
from phytac_shapes.errors import NumericalError

FACTORS = (0.1, -0.3, 1.05 * 0.7408, np.nan, 0.5, 1e-9)


@pytest.fixture(scope="module")
def roof() -> tuple[ShellModel, np.ndarray]:
    return large_cases.hinged_roof(6, thickness=12.7)[:2]


@pytest.fixture(scope="module")
def two(roof: tuple[ShellModel, np.ndarray]) -> tuple[list[Sample], list[tuple[int, int]]]:
    model, load = roof
    seen: list[tuple[int, int]] = []
    samples = solve_batch(
        model,
        np.stack([f * load for f in FACTORS], axis=1),
        workers=2,
        progress=lambda done, total: seen.append((done, total)),
    )
    return samples, seen


def test_results_are_in_order_and_failures_stay_alone(
    roof: tuple[ShellModel, np.ndarray], two: tuple[list[Sample], list[tuple[int, int]]]
) -> None:
    model, load = roof
    samples, seen = two
    assert [s.status for s in samples] == ["ok", "ok", "flagged", "failed", "ok", "ok"]
    assert "not finite" in samples[3].reason
    assert samples[3].motion is None
    assert "snapped" in samples[2].reason
    assert sorted(seen) == [(k + 1, len(FACTORS)) for k in range(len(FACTORS))]
    for k in (0, 1, 4, 5):
        here = solve_large(model, Loading(force=FACTORS[k] * load))[0].state.motion
        motion = samples[k].motion
        assert motion is not None
        np.testing.assert_allclose(motion, here, atol=1e-9 * np.abs(here).max())


def test_one_worker_gives_the_same_bits(
    roof: tuple[ShellModel, np.ndarray], two: tuple[list[Sample], list[tuple[int, int]]]
) -> None:
    model, load = roof
    order = [4, 1, 0, 5]  # another order, too
    one = solve_batch(model, np.stack([FACTORS[k] * load for k in order], axis=1), workers=1)
    for k, sample in zip(order, one, strict=True):
        np.testing.assert_array_equal(sample.motion, two[0][k].motion)


def test_auto_is_linear_where_that_suffices(roof: tuple[ShellModel, np.ndarray]) -> None:
    model, load = roof
    dofs = np.flatnonzero(load)
    small, big = (solve_sample(model, (dofs, f * load[dofs]), 0.05) for f in (0.01, 0.3))
    assert (small.large, big.large) == (False, True)
    np.testing.assert_array_equal(small.motion, model.solve(0.01 * load).motion[:, :, 0])


class Bomb:
    """Ends the process that reads it from its queue."""

    def __reduce__(self) -> tuple[object, tuple[int]]:
        return os._exit, (3,)


def test_a_process_that_dies_is_a_failed_sample_not_the_end(
    roof: tuple[ShellModel, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, load = roof
    plain = batch._run

    def mined(model: ShellModel, columns: list, *rest: object) -> object:
        columns = [*columns]
        columns[1] = Bomb()
        return plain(model, columns, *rest)

    monkeypatch.setattr(batch, "_run", mined)
    loads = np.stack([0.1 * load, 0.2 * load, 0.3 * load], axis=1)
    samples = solve_batch(model, loads, workers=1)
    assert [s.status for s in samples] == ["ok", "failed", "ok"]
    assert "process died" in samples[1].reason


def test_bad_batches_are_refused(roof: tuple[ShellModel, np.ndarray]) -> None:
    model, load = roof
    with pytest.raises(NumericalError, match="at least one worker"):
        solve_batch(model, load[:, None], workers=0)
    with pytest.raises(NumericalError, match="one row per DOF"):
        solve_batch(model, load[:-1, None])
    assert os.environ.get("OPENBLAS_NUM_THREADS") is not None
