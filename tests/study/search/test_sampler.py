"""Where candidates come from: space-filling designs, and a search that finds what is best."""

import numpy as np
import pytest

from phytac_design.study.search.sampler import Search, Sweep, sobol
from phytac_design.study.search.successive_halving import OK, UNFIT, front, ranks
from tests.refusals import refused
from tests.study.search.studies import space_of, tiny


def test_a_sequence_in_pieces_is_the_whole_one() -> None:
    whole = sobol(3, 5, 0, 24)
    parts = np.concatenate([sobol(3, 5, 0, 10), sobol(3, 5, 10, 3), sobol(3, 5, 13, 11)])
    assert np.array_equal(whole, parts)
    assert not np.array_equal(whole, sobol(3, 6, 0, 24))


@pytest.mark.parametrize("kind", ["sobol", "latin-hypercube"])
def test_covers_are_even(kind: str) -> None:
    study = tiny(sampling={"sweep": kind}, budget={"candidates": 64})
    cover = Sweep(study, space_of(study))
    drawn = cover.ask(0, 40) + cover.ask(40, 40)
    assert len(drawn) == 64
    assert cover.ask(64, 40) == []
    walls = np.array([one["wall.thickness_mm"] for one in drawn], dtype=float)
    counts = np.histogram(walls, bins=8, range=(0.5, 1.5))[0]
    assert np.abs(counts - 8).max() <= 1


def test_a_grid_has_every_point_once_and_no_more_than_the_budget() -> None:
    study = tiny(
        variable=[
            {"field": "layout.rows", "low": 4, "high": 6},
            {"field": "wall.thickness_mm", "low": 0.5, "high": 1.0, "points": 3},
        ],
        sampling={"sweep": "grid"},
        budget={"candidates": 9},
    )
    cover = Sweep(study, space_of(study))
    points = cover.ask(0, 5) + cover.ask(5, 99)
    assert len({tuple(point.values()) for point in points}) == cover.total == 9
    with refused("grid-exceeds-budget"):
        Sweep(study.model_copy(update={"budget": tiny(budget={"candidates": 8}).budget}),
              space_of(study))  # fmt: skip


def test_fronts_and_ranks() -> None:
    values = np.array([[0.0, 3.0], [1.0, 1.0], [3.0, 0.0], [2.0, 2.0], [3.0, 3.0], [1.0, 1.0]])
    assert front(values).tolist() == [True, True, True, False, False, True]
    assert ranks(values).tolist() == [0, 0, 0, 1, 2, 0]


def test_a_front_agrees_with_all_pairs() -> None:
    values = np.round(np.random.default_rng(0).normal(size=(300, 3)), 1)
    better = np.all(values[:, None] <= values, axis=2) & np.any(values[:, None] < values, axis=2)
    assert np.array_equal(front(values), ~better.any(axis=0))


def quadratic(
    optimise: str, seed: int, tmp_path: str, total: int, *, smart: bool
) -> tuple[float, float]:
    """Least of (t - 0.77)² over walls t below 1, and how many of the last candidates are fit."""
    study = tiny(
        seed=seed,
        objective=[{"measure": "mass_g", "goal": "min"}],
        sampling={"batch": 8, "start": 16, "optimise": optimise},
        budget={"candidates": total},
    )
    space = space_of(study)
    source = Search(study, space, f"{tmp_path}/{seed}.journal") if smart else Sweep(study, space)
    best, fit = np.inf, []
    for first in range(0, total, 8):
        batch = source.ask(first, 8)
        evaluated = []
        for one in batch:
            wall, rows = float(one["wall.thickness_mm"]), float(one["layout.rows"])
            value = (wall - 0.77) ** 2 + (rows - 7.0) ** 2
            able = wall < 1.0
            best = min(best, value) if able else best
            fit.append(able)
            evaluated.append(
                {"violation": 0.0 if able else wall - 1.0, "status": OK if able else UNFIT,
                 "mass_g": value}
            )  # fmt: skip
        source.tell(batch, evaluated)
    return best, float(np.mean(fit[total // 2 :]))


@pytest.mark.parametrize("optimise", ["tpe", "nsga2"])
def test_the_search_closes_in_on_a_known_optimum(optimise: str, tmp_path: str) -> None:
    found, fit = quadratic(optimise, 1, str(tmp_path), 64, smart=True)
    even, _ = quadratic(optimise, 1, str(tmp_path), 64, smart=False)
    assert found < even
    assert found < 0.01
    assert fit > 0.7
