"""Load cases in threads, whose solves are done together."""

import threading
import time
from functools import partial

import numpy as np
import pytest

from phytac_design.mechanics.large.shared_solves import shared, side_by_side
from phytac_shapes.arrays import FloatArray


class CountedSolve:
    """Doubles loads, and notes the first entry of each that was solved together."""

    def __init__(self) -> None:
        self.rounds: list[list[float]] = []

    def __call__(self, load: FloatArray) -> FloatArray:
        self.rounds.append(np.atleast_2d(load.T)[:, 0].tolist())
        return 2.0 * load


def steps(solve: CountedSolve, number: int, count: int, wait_s: float = 0.0) -> float:
    """Solve as often as ``count``, each time for the last result plus one."""
    found = np.array([float(number), 0.0])
    for _ in range(count):
        time.sleep(wait_s)
        found = shared(solve, found + 1.0)
    return float(found[0])


@pytest.mark.parametrize("waits", [(0.0, 0.0, 0.0), (0.02, 0.0, 0.01), (0.0, 0.03, 0.0)])
def test_what_is_solved_together_does_not_depend_on_timing(waits: tuple[float, ...]) -> None:
    solve, alone = CountedSolve(), CountedSolve()
    counts = (3, 1, 2)
    jobs = list(enumerate(zip(counts, waits, strict=True)))
    tasks = [partial(steps, solve, number, count, wait) for number, (count, wait) in jobs]
    found = side_by_side(solve, tasks)
    assert found == [steps(alone, number, count) for number, count in enumerate(counts)]
    assert solve.rounds == [[1.0, 2.0, 3.0], [3.0, 7.0], [7.0]]


def test_an_error_of_one_does_not_stop_the_others() -> None:
    solve = CountedSolve()
    ended: list[float] = []

    def fails() -> float:
        shared(solve, np.ones(2))
        raise ArithmeticError("this one")

    def ends() -> float:
        ended.append(steps(solve, 0, 4))
        return ended[0]

    with pytest.raises(ArithmeticError, match="this one"):
        side_by_side(solve, [fails, ends])
    assert ended == [steps(CountedSolve(), 0, 4)]


def test_an_error_of_the_solve_reaches_all() -> None:
    seen: list[str] = []

    def singular(_: FloatArray) -> FloatArray:
        raise ValueError("singular")

    def task() -> None:
        try:
            shared(singular, np.ones(2))
        except ValueError as error:
            seen.append(str(error))

    side_by_side(singular, [task] * 3)
    assert seen == ["singular"] * 3


def test_solves_of_others_are_not_waited_for() -> None:
    """A task may solve with another factor, which is none of the others' business."""
    solve, other = CountedSolve(), CountedSolve()

    def both() -> float:
        return float(shared(solve, shared(other, np.ones(2)))[0])

    assert side_by_side(solve, [both, both]) == [4.0, 4.0]
    assert solve.rounds == [[2.0, 2.0]]
    assert other.rounds == [[1.0], [1.0]]


def test_an_interrupt_does_not_wait_for_load_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    solve, ended = CountedSolve(), threading.Event()

    def long() -> None:
        try:
            while True:
                shared(solve, np.ones(2))
        finally:
            ended.set()

    def interrupted(self: threading.Thread, timeout: float | None = None) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "join", interrupted)
        with pytest.raises(KeyboardInterrupt):
            side_by_side(solve, [long, long])
    assert ended.wait(5.0)
