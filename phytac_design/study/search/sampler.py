"""Where candidates come from: even covers for sweeps; Optuna, asked and told by one driver.

The same study gives the same candidates, whatever the workers and however often the driver was
killed: every draw has a seed of its own, and only whole batches are told. Optuna searches on trials
in memory; what is done goes into its storage (a journal file, or a database) trial by trial.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.stats import qmc

from phytac_design.study.search.measures import best_proxy
from phytac_design.study.search.space import Axis, Params, Space
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.successive_halving import OK
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, MissingPartError, OutputError

Row = Mapping[str, Any]
"""A candidate's row of the results."""


class Source(Protocol):
    """Gives candidates and hears what became of them."""

    steady: bool
    """Whether what it gives does not depend on what it hears."""

    def ask(self, first: int, count: int) -> list[Params]:
        """Values of the candidates from number ``first`` on, ``count`` at most."""
        ...

    def tell(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """Hear of all candidates that the last :meth:`ask` gave."""
        ...


def sobol(dimensions: int, seed: int, first: int, count: int) -> FloatArray:
    """Points (count, d) of a scrambled Sobol sequence, from number ``first`` on."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed))
    if first:
        sequence.fast_forward(first)
    # A first draw of a power of two is what keeps the sequence even.
    return np.asarray(sequence.random(1 << max(count - 1, 0).bit_length())[:count])


class Sweep:
    """Candidates of a sweep: a grid, a Sobol sequence or a Latin hypercube."""

    steady = True

    def __init__(self, study: Study, space: Space) -> None:
        self.study, self.space = study, space
        self.total = study.budget.candidates
        if study.sampling.sweep == "grid":
            sides = [axis.grid() for axis in space.axes]
            size = int(np.prod([len(side) for side in sides], dtype=object))
            if size > self.total:
                raise DesignError(
                    f"{study.name}: the grid has {size} points, the budget is {self.total} "
                    "candidates; raise budget.candidates, lower points, or take sobol"
                )
            self.total = size

    def ask(self, first: int, count: int) -> list[Params]:
        """Values of candidates from a number on."""
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
            cube = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(study.seed))
            shares = cube.random(self.total)[first : first + count]
        return [self.space.params(share) for share in shares]

    def tell(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """A sweep goes its way whatever comes of it."""


def optuna_library() -> Any:
    """Optuna, quiet.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import optuna
    except ImportError:
        raise MissingPartError(
            "`phytac optimise` needs optuna; install it with: pip install 'phytac-design[study]'"
        ) from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


class Search:
    """Candidates of `phytac optimise`: Optuna's, after a start that is spread evenly."""

    steady = False

    def __init__(self, study: Study, space: Space, storage: str) -> None:
        if not study.objective:
            raise DesignError(
                f"{study.name}: nothing to strive for; add [[objective]], or use `phytac sweep`"
            )
        self.optuna = optuna_library()
        self.study, self.space = study, space
        self.total = study.budget.candidates
        goals = {"min": "minimize", "max": "maximize"}
        directions = [goals[objective.goal] for objective in study.objective]
        self.kept = self._open(storage, directions)
        self.search = self.optuna.create_study(directions=directions)
        self.search.add_trials(self.kept.trials)
        self.asked: list[Any] = []
        self.spread = {axis.field: self._distribution(axis) for axis in space.axes}

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
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise OutputError(
                f"Optuna's storage {storage} cannot be opened ({said}); give --storage another "
                "database URL, or leave it out for a file in the study's folder"
            ) from None

    def _distribution(self, axis: Axis) -> Any:
        """Optuna's view of a variable."""
        kinds, own = self.optuna.distributions, axis.variable
        if own.choices:
            return kinds.CategoricalDistribution(list(own.choices))
        if axis.whole:
            step = int(own.step or 1)
            low, high = int(own.low or 0), int(own.high or 0)
            if own.scale == "log":
                return kinds.IntDistribution(low, high, log=True)
            return kinds.IntDistribution(low, low + (high - low) // step * step, step=step)
        return kinds.FloatDistribution(own.low, own.high, log=own.scale == "log", step=own.step)

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
        """Values of candidates from a number on."""
        self.asked = []
        count = max(0, min(count, self.total - first))
        start = self.study.sampling.start
        # A batch is all start or all search, so that its size does not change what is drawn.
        if first < start:
            count = min(count, start - first)
            shares = sobol(len(self.spread), self.study.seed, first, count)
            return [self.space.params(share) for share in shares]
        out: list[Params] = []
        for number in range(first, first + count):
            self.search.sampler = self._sampler(number)
            trial = self.search.ask(self.spread)
            self.asked.append(trial)
            out.append(dict(trial.params))
        return out

    def tell(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """Tell Optuna, and keep the trials in its storage.

        Raises
        ------
        OutputError
            If the storage cannot be written.
        """
        worst = self._worst(rows)
        for number, (own, row) in enumerate(zip(params, rows, strict=True)):
            violation = float(row["violation"])
            values = [
                worst[objective.measure] if value is None else value
                for objective, value in zip(self.study.objective, self._values(row), strict=True)
            ]
            if self.asked:
                trial = self.asked[number]
                trial.set_constraint("study", violation)
                trial.set_user_attr("status", row["status"])
                self.search.tell(trial, values)
                done = self.search.trials[trial.number]
            else:
                done = self.optuna.trial.create_trial(
                    params=own,
                    distributions=self.spread,
                    values=values,
                    constraints={"study": violation},
                    user_attrs={"status": row["status"]},
                    system_attrs={"NSGAIISampler:generation": 0},
                )
                self.search.add_trial(done)
            try:
                self.kept.add_trial(done)
            except Exception as error:  # noqa: BLE001 - as above
                raise OutputError(
                    f"Optuna's storage cannot be written ({error}); make room, and run the same "
                    "command again: nothing is lost"
                ) from None
        self.asked = []

    def replay(self, params: Sequence[Params], rows: Sequence[Row]) -> None:
        """Hear of candidates that are in the results but not in Optuna's storage."""
        first = len(self.kept.trials)
        if first >= self.study.sampling.start:
            self.ask(first, len(rows))
        self.tell(params, rows)

    @property
    def told(self) -> int:
        """Candidates that Optuna knows of."""
        return len(self.kept.get_trials(deepcopy=False))

    def _values(self, row: Row) -> Iterator[float | None]:
        """Objectives of a row, or what best predicts them; None where nothing does."""
        known = frozenset(name for name, value in row.items() if value is not None)
        for objective in self.study.objective:
            name = best_proxy(objective.measure, known)
            yield float(row[name]) if name else None

    def _worst(self, rows: Sequence[Row]) -> dict[str, float]:
        """For candidates without a value: the worst of the batch; they are not feasible anyway."""
        out: dict[str, float] = {}
        for number, objective in enumerate(self.study.objective):
            column = [list(self._values(row))[number] for row in rows if row["status"] == OK]
            known = [value for value in column if value is not None] or [0.0]
            out[objective.measure] = max(known) if objective.goal == "min" else min(known)
        return out
