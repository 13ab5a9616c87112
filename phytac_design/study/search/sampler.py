"""Sources of candidates: space-filling designs for sweeps, Optuna (ask and tell) for optimisation.

The same study gives the same candidates, for any number of workers and however often the driver was
killed: every draw has a seed of its own, and Optuna gets complete batches only. Optuna searches on
trials in memory; completed trials are copied to its storage (a journal file, or a database).
"""

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.study.search.design_space import Axis, DesignSpace, Params
from phytac_design.study.search.measures import best_proxy
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.successive_halving import OK
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, MissingPartError, OutputError

Row = Mapping[str, Any]
"""A candidate's row of the results."""


def sobol(dimensions: int, seed: int, first: int, count: int) -> FloatArray:
    """Points (count, d) of a scrambled Sobol sequence, from number ``first`` on."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    if first:
        sequence.fast_forward(first)
    # Draws of a power of two keep the sequence balanced.
    return np.asarray(sequence.random(1 << max(count - 1, 0).bit_length())[:count])


class Sweep:
    """Candidates of a sweep: a grid, a Sobol sequence or a Latin hypercube."""

    def __init__(self, study: Study, space: DesignSpace) -> None:
        self.study, self.space = study, space
        self.total = study.budget.candidates
        if study.sampling.sweep == "grid":
            size = int(np.prod([len(axis.grid()) for axis in space.axes], dtype=object))
            if size > self.total:
                raise DesignError(
                    "grid-exceeds-budget",
                    f"{study.name}: the grid has {size} points, the budget is {self.total} "
                    "candidates; raise budget.candidates, lower points, or use sobol",
                )
            self.total = size

    def ask(self, first: int, count: int) -> list[Params]:
        """Values of the candidates from number ``first`` on, ``count`` at most."""
        count = max(0, min(count, self.total - first))
        if count == 0:
            return []
        study, axes = self.study, self.space.axes
        if study.sampling.sweep == "grid":
            fields = [axis.field for axis in axes]
            points = itertools.product(*(axis.grid() for axis in axes))
            chosen = itertools.islice(points, first, first + count)
            return [dict(zip(fields, point, strict=True)) for point in chosen]
        if study.sampling.sweep == "sobol":
            shares = sobol(len(axes), study.seed, first, count)
        else:
            from scipy.stats import qmc

            cube = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(study.seed))
            shares = cube.random(self.total)[first : first + count]
        return [self.space.params(share) for share in shares]

    def tell(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """Does nothing: a sweep does not depend on results."""


def optuna_library() -> Any:
    """Optuna without log messages.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise MissingPartError.of_library("`phytac optimise`", "optuna", "study") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


class Search:
    """Candidates of `phytac optimise`: a Sobol start, then those of an Optuna sampler."""

    def __init__(self, study: Study, space: DesignSpace, storage: str) -> None:
        if not study.objective:
            raise DesignError(
                "objective-missing",
                f"{study.name}: no objective to optimise; add [[objective]], or use `phytac sweep`",
            )
        self.optuna = optuna_library()
        self.study, self.space = study, space
        self.total = study.budget.candidates
        directions = [f"{one.goal}imize" for one in study.objective]
        self.stored = self._open(storage, directions)
        self.search = self.optuna.create_study(directions=directions)
        self.search.add_trials(self.stored.trials)
        self.trials: list[Any] = []
        self.distributions = {axis.field: self._distribution(axis) for axis in space.axes}

    def _open(self, storage: str, directions: list[str]) -> Any:
        """Optuna's study in a journal file or a database."""
        storages = self.optuna.storages
        try:
            if "://" in storage:
                backend = storages.RDBStorage(storage)
            else:
                journal = storages.journal
                lock = journal.JournalFileOpenLock(storage)
                Path(f"{storage}.lock").unlink(missing_ok=True)  # of a driver that was killed
                backend = journal.JournalStorage(journal.JournalFileBackend(storage, lock_obj=lock))
            return self.optuna.create_study(
                study_name=f"{self.study.name}-{self.study.identity()[:12]}",
                storage=backend,
                directions=directions,
                load_if_exists=True,
            )
        except Exception as error:  # noqa: BLE001 - whatever a database's own driver raises
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise OutputError(
                "optuna-storage-failed",
                f"Optuna's storage {storage} cannot be opened ({reason}); give --storage another "
                "database URL, or leave it out for a file in the study's folder",
            ) from None

    def _distribution(self, axis: Axis) -> Any:
        """Optuna's distribution of a variable."""
        kinds, own = self.optuna.distributions, axis.variable
        if own.choices:
            return kinds.CategoricalDistribution(list(own.choices))
        if not axis.integer:
            return kinds.FloatDistribution(own.low, own.high, log=own.scale == "log", step=own.step)
        step, low, high = int(own.step or 1), int(own.low or 0), int(own.high or 0)
        if own.scale == "log":
            return kinds.IntDistribution(low, high, log=True)
        return kinds.IntDistribution(low, low + (high - low) // step * step, step=step)

    def _sampler(self, number: int) -> Any:
        """Sampler for one candidate, with a seed of its own."""
        seed = int(np.random.SeedSequence([self.study.seed, number]).generate_state(1)[0])
        samplers = self.optuna.samplers
        if self.study.sampling.optimise == "nsga2":
            return samplers.NSGAIISampler(seed=seed, population_size=self.study.sampling.start)
        return samplers.TPESampler(
            seed=seed, n_startup_trials=1, multivariate=True, constant_liar=True
        )

    def ask(self, first: int, count: int) -> list[Params]:
        """Values of the candidates from number ``first`` on, ``count`` at most."""
        self.trials = []
        count = max(0, min(count, self.total - first))
        start = self.study.sampling.start
        # A batch is all start or all search, so that its size does not change what is drawn.
        if first < start:
            count = min(count, start - first)
            shares = sobol(len(self.distributions), self.study.seed, first, count)
            return [self.space.params(share) for share in shares]
        for number in range(first, first + count):
            self.search.sampler = self._sampler(number)
            self.trials.append(self.search.ask(self.distributions))
        return [dict(trial.params) for trial in self.trials]

    def tell(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """Give Optuna the results of the last :meth:`ask`, and copy the trials to its storage.

        Raises
        ------
        OutputError
            If the storage cannot be written.
        """
        values = self._objectives(rows)
        for number, (own, row) in enumerate(zip(params, rows, strict=True)):
            violation = float(row["violation"])
            if self.trials:
                trial = self.trials[number]
                trial.set_constraint("study", violation)
                trial.set_user_attr("status", row["status"])
                self.search.tell(trial, values[number])
                done = self.search.trials[trial.number]
            else:
                done = self.optuna.trial.create_trial(
                    params=own,
                    distributions=self.distributions,
                    values=values[number],
                    constraints={"study": violation},
                    user_attrs={"status": row["status"]},
                    system_attrs={"NSGAIISampler:generation": 0},
                )
                self.search.add_trial(done)
            try:
                self.stored.add_trial(done)
            except Exception as error:  # noqa: BLE001 - as above
                raise OutputError(
                    "optuna-storage-failed",
                    f"Optuna's storage cannot be written ({error}); free disk space, and run the "
                    "same command again: all results are kept",
                ) from None
        self.trials = []

    def replay(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """Tell candidates that are in the results but not in Optuna's storage."""
        first = self.known
        if first >= self.study.sampling.start:
            self.ask(first, len(rows))
        self.tell(params, rows)

    @property
    def known(self) -> int:
        """Number of candidates in Optuna's storage."""
        return len(self.stored.get_trials(deepcopy=False))

    def _objectives(self, rows: Sequence[Row]) -> list[list[float]]:
        """Objectives of each row, or their best predictors.

        Infeasible candidates without a value get the worst one of the batch.
        """
        columns = []
        for objective in self.study.objective:
            column: list[float | None] = []
            for row in rows:
                known = frozenset(name for name, value in row.items() if value is not None)
                name = best_proxy(objective.measure, known)
                column.append(float(row[name]) if name else None)
            feasible = [
                value
                for value, row in zip(column, rows, strict=True)
                if row["status"] == OK and value is not None
            ] or [0.0]
            worst = max(feasible) if objective.goal == "min" else min(feasible)
            columns.append([worst if value is None else value for value in column])
        return [list(values) for values in zip(*columns, strict=True)]
