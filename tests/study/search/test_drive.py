"""The driver: the same rows whatever is killed, and nothing lost."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phytac_design.study.search import fidelity_levels
from phytac_design.study.search import study_folder as stores
from phytac_design.study.search.driver import Kind, StudyRun, run_study
from phytac_design.study.search.fidelity_levels import Candidate
from phytac_design.study.search.sampler import Search
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.study_folder import RESULTS, Store, rebuild
from phytac_design.study.search.successive_halving import (
    DROPPED,
    FAILED,
    OK,
    Outcome,
    SerialPool,
    Task,
)
from phytac_shapes.errors import DesignError
from tests.refusals import refused
from tests.study.search.studies import space_of, tiny

KINDS: list[Kind] = ["sweep", "optimise"]


@pytest.fixture(autouse=True)
def quick_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests are about the driver: its one level counts and weighs, without optics."""

    def rules(candidate: Candidate) -> dict[str, float]:
        layout, wall = candidate.design.layout, candidate.design.wall.thickness_mm
        if wall < 0.6:
            raise DesignError("wall-too-thin", "too thin")
        found = {"marker_count": layout.rows * layout.columns, "mass_g": 20.0 * wall}
        return found | {"density_mean_per_cm2": found["marker_count"] / 113.1}

    def sampled(candidate: Candidate) -> dict[str, float]:
        return {"surrogate_force_sd_N": 1.0 / candidate.design.layout.rows}

    monkeypatch.setitem(fidelity_levels.LEVEL_FUNCTIONS, "rules", rules)
    monkeypatch.setitem(fidelity_levels.LEVEL_FUNCTIONS, "sampled", sampled)


class KilledError(Exception):
    """Stands for a process that ends without notice."""


class Killed(SerialPool):
    """A pool whose driver ends after so many results."""

    def __init__(self, after: int) -> None:
        self.left = after

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        for result in super().run(tasks):
            if self.left == 0:
                raise KilledError
            self.left -= 1
            yield result


class Backwards(SerialPool):
    """A pool whose results come in another order."""

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        yield from super().run(reversed(list(tasks)))


def run(
    study: Study, folder: Path, kind: Kind = "sweep", pool: SerialPool | None = None
) -> StudyRun:
    return run_study(study, space_of(study), folder, kind=kind, pool=pool)


def rows(folder: Path) -> list[dict[str, Any]]:
    """Rows without what differs from run to run."""
    table = stores.parquet_library().parquet.read_table(folder / RESULTS)
    return [
        {key: value for key, value in row.items() if not key.startswith("seconds.")}
        for row in table.to_pylist()
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_driver_resumes_to_the_same_rows(kind: Kind, tmp_path: Path) -> None:
    study = tiny(objective=tiny_goals())
    whole = run(study, tmp_path / "whole", kind)
    assert whole.new == whole.rows == 24
    for after in (3, 7, 9):
        with pytest.raises(KilledError):
            run(study, tmp_path / "cut", kind, Killed(after))
    done = run(study, tmp_path / "cut", kind, Backwards())
    assert 0 < done.new < 24
    assert rows(tmp_path / "cut") == rows(tmp_path / "whole")
    assert [row["trial"] for row in rows(tmp_path / "cut")] == list(range(24))


def tiny_goals() -> list[dict[str, str]]:
    return [{"measure": "marker_count", "goal": "max"}, {"measure": "mass_g", "goal": "min"}]


def test_results_of_the_open_batch_are_not_evaluated_again(tmp_path: Path) -> None:
    study = tiny()
    with pytest.raises(KilledError):
        run(study, tmp_path, pool=Killed(5))
    with (tmp_path / "open.jsonl").open("a") as file:
        file.write('{"key": "cut o')
    counted = Counted()
    run(study, tmp_path, pool=counted)
    assert counted.evaluated == 24 - 5


class Counted(SerialPool):
    """A pool that counts."""

    evaluated = 0

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        for result in super().run(tasks):
            self.evaluated += 1
            yield result


def test_equal_values_are_evaluated_once(tmp_path: Path) -> None:
    axis = {"field": "layout.rows", "low": 4, "high": 5}
    study = tiny(variable=[axis], sampling={"batch": 8, "start": 8}, budget={"candidates": 8})
    counted = Counted()
    assert run(study, tmp_path, pool=counted).rows == 8
    assert counted.evaluated == 2


def test_a_kill_between_the_rows_and_optuna_is_repaired(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = tiny()
    run(study, tmp_path / "whole", "optimise")

    def killed(*_: object) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(Search, "tell", killed)
        with pytest.raises(KilledError):
            run(study, tmp_path / "cut", "optimise")
    done = run(study, tmp_path / "cut", "optimise")
    assert done.new == 16
    assert rows(tmp_path / "cut") == rows(tmp_path / "whole")


def test_a_kill_while_parts_join_leaves_each_row_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = tiny()

    unlink = Path.unlink

    def killed(path: Path, **how: bool) -> None:
        if path.suffix == ".parquet":
            raise KilledError
        unlink(path, **how)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", killed)
        with pytest.raises(KilledError):
            run(tiny(budget={"candidates": 8}), tmp_path)
    assert len(rows(tmp_path)) == 8
    assert list((tmp_path / "parts").iterdir())
    run(study, tmp_path)
    assert [row["trial"] for row in rows(tmp_path)] == list(range(24))


def test_a_larger_budget_resumes(tmp_path: Path) -> None:
    run(tiny(budget={"candidates": 8}), tmp_path / "grown")
    assert run(tiny(), tmp_path / "grown").new == 16
    run(tiny(), tmp_path / "whole")
    assert rows(tmp_path / "grown") == rows(tmp_path / "whole")


def test_another_study_is_refused_and_nothing_touched(tmp_path: Path) -> None:
    run(tiny(), tmp_path)
    before = (tmp_path / "study.json").read_text()
    with refused("output-foreign"):
        run(tiny(seed=8), tmp_path)
    with refused("output-foreign"):
        run(tiny(), tmp_path, "optimise")
    assert (tmp_path / "study.json").read_text() == before


def test_one_driver_works_in_a_folder(tmp_path: Path) -> None:
    study = tiny()
    held = Store(tmp_path, study, space_of(study), "sweep")
    with refused("output-locked"):
        run(study, tmp_path)
    held.close()
    assert run(study, tmp_path).rows == 24


def test_a_full_disk_says_so_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = tiny()

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(stores.parquet_library().parquet, "write_table", full)
        with refused("output-not-writable"):
            run(study, tmp_path)
    counted = Counted()
    assert run(study, tmp_path, pool=counted).rows == 24
    assert counted.evaluated == 16


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with refused("output-not-writable"):
        run(tiny(), tmp_path / "file" / "study")


def test_the_share_of_each_batch_is_promoted(tmp_path: Path) -> None:
    study = tiny(
        constraint=[],
        objective=[{"measure": "surrogate_force_sd_N", "goal": "min"}, *tiny_goals()],
        ladder={"share": {"rules": 0.5}},
        budget={"candidates": 8},
    )
    run(study, tmp_path)
    found = rows(tmp_path)
    able = [row for row in found if row["status"] in {OK, DROPPED}]
    on = [row for row in able if row["status"] == OK]
    assert len(on) == -(-len(able) // 2)
    assert all(row["surrogate_force_sd_N"] for row in on)
    off = [row for row in able if row["status"] == DROPPED]
    assert off
    assert not any(row["surrogate_force_sd_N"] for row in off)
    assert "not among the best 50%" in off[0]["reason"]


def test_a_candidate_that_breaks_down_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object) -> dict[str, float]:
        raise ZeroDivisionError("by nothing")

    monkeypatch.setitem(fidelity_levels.LEVEL_FUNCTIONS, "rules", broken)
    done = run(tiny(budget={"candidates": 4}), tmp_path)
    assert done.statuses == {FAILED: 4}
    assert rows(tmp_path)[0]["reason"] == "ZeroDivisionError: by nothing"


def test_seconds_end_a_study_between_batches(tmp_path: Path) -> None:
    done = run(tiny(budget={"candidates": 24, "seconds": 1e-9}), tmp_path)
    assert done.rows == 0
    assert run(tiny(), tmp_path).rows == 24


def test_any_row_is_rebuilt_exactly(tmp_path: Path) -> None:
    study = tiny()
    run(study, tmp_path)
    row = rows(tmp_path)[5]
    design = rebuild(tmp_path, 5)
    assert design.name == "tiny-5"
    assert design.layout.rows == row["layout.rows"]
    assert design.wall.thickness_mm == row["wall.thickness_mm"]
    own = space_of(study).design({key: row[key] for key in row if "." in key})
    assert design.model_dump() == {**own.model_dump(), "name": "tiny-5"}
    with refused("trial-unknown"):
        rebuild(tmp_path, 24)
    with refused("study-not-found"):
        rebuild(tmp_path / "elsewhere", 0)


def test_a_design_that_would_differ_is_not_rebuilt(tmp_path: Path) -> None:
    run(tiny(), tmp_path)
    path = tmp_path / "study.json"
    data = json.loads(path.read_text())
    data["base"]["material"]["modulus_MPa"] = 999.0
    path.write_text(json.dumps(data))
    with refused("trial-of-other-version"):
        rebuild(tmp_path, 0)


def test_no_objective_cannot_be_optimised(tmp_path: Path) -> None:
    with refused("objective-missing"):
        run(tiny(objective=[]), tmp_path, "optimise")


def test_storage_that_cannot_be_opened_is_refused(tmp_path: Path) -> None:
    study = tiny()
    with refused("optuna-storage-failed"):
        run_study(
            study,
            space_of(study),
            tmp_path / "out",
            kind="optimise",
            storage=f"sqlite:///{tmp_path}/nowhere/trials.db",
        )


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_optuna_keeps_trials_with_their_status(sampler: str, tmp_path: Path) -> None:
    optuna = pytest.importorskip("optuna")
    study = tiny(sampling={"batch": 6, "start": 6, "optimise": sampler})
    url = f"sqlite:///{tmp_path}/trials.db"
    run_study(study, space_of(study), tmp_path / "out", kind="optimise", storage=url)
    (name,) = optuna.study.get_all_study_names(url)
    kept = optuna.load_study(study_name=name, storage=url).trials
    found = rows(tmp_path / "out")
    assert [trial.user_attrs["status"] for trial in kept] == [row["status"] for row in found]
    for trial, row in zip(kept, found, strict=True):
        assert trial.params == {key: row[key] for key in trial.params}
        assert (trial.constraints["study"] <= 0.0) == (row["status"] == OK)
        if row["status"] == OK:
            assert trial.values == [row["marker_count"], row["mass_g"]]
