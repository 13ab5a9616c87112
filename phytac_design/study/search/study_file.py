"""Study files: variables, constraints, objectives and budget of a search."""

import json
from difflib import get_close_matches
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from phytac_design.design.base_table import Section
from phytac_design.design.toml_files import TomlFileKind
from phytac_design.study.search.measures import LEVELS, MEASURES, measure_of, measures_up_to
from phytac_shapes.errors import DesignError

Value = int | float | str
Text = Annotated[str, Field(min_length=1, max_length=200)]


class Variable(Section):
    """A field of the design file that varies: over a range, or among choices."""

    field: Text
    """Which, as TABLE.FIELD (`layout.rows`); items of lists by number (`shape.diameters_mm.0`)."""
    low: float | None = None
    """Least value."""
    high: float | None = None
    """Greatest value."""
    scale: Literal["linear", "log"] = "linear"
    """`log` spreads values evenly by ratio, not by difference."""
    step: float | None = Field(None, gt=0.0)
    """Only multiples of this above `low`; 1 for fields of whole numbers."""
    points: int = Field(5, ge=2, le=10_000)
    """Values that a grid takes of a range without steps."""
    choices: tuple[Value, ...] = ()
    """Values to choose from, in place of a range."""

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.choices:
            if (self.low, self.high, self.step, self.scale) != (None, None, None, "linear"):
                raise ValueError("choices exclude low, high, step and scale; use one or the other")
            if len(set(self.choices)) < len(self.choices):
                raise ValueError(f"choices repeat themselves (got {list(self.choices)})")
            return self
        if self.low is None or self.high is None:
            raise ValueError("give low and high, or choices")
        if not self.low < self.high:
            raise ValueError(
                f"the range is empty (low {self.low:g}, high {self.high:g}); let low be below high"
            )
        if self.scale == "log" and (self.low <= 0.0 or self.step is not None):
            raise ValueError('scale = "log" needs low above 0 and no step')
        return self


class Constraint(Section):
    """A measure that must lie between bounds."""

    measure: Text
    """Which; `phytac sweep --measures` lists all."""
    min: float | None = None
    """Least value that will do."""
    max: float | None = None
    """Greatest value that will do."""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.min is None and self.max is None:
            raise ValueError("give min, max or both")
        return self


class Objective(Section):
    """A measure to minimise or maximise."""

    measure: Text
    """Which."""
    goal: Literal["min", "max"]
    """Whether less or more is better."""


class Budget(Section):
    """When to stop."""

    candidates: int = Field(256, ge=1, le=10_000_000)
    """Designs to evaluate."""
    seconds: float = Field(0.0, ge=0.0, le=1e8)
    """Time after which no further batch starts; 0 for no limit."""


class Sampling(Section):
    """Where candidates come from."""

    sweep: Literal["grid", "sobol", "latin-hypercube"] = "sobol"
    """How `phytac sweep` covers the space."""
    optimise: Literal["tpe", "nsga2"] = "tpe"
    """Optuna's sampler of `phytac optimise`."""
    batch: int = Field(32, ge=1, le=4096)
    """Candidates that are drawn together; results do not depend on the number of workers."""
    start: int = Field(32, ge=1, le=100_000)
    """Candidates that `phytac optimise` first spreads by Sobol."""


class FidelitySection(Section):
    """Fidelity levels of the study, and the share of candidates promoted after each."""

    rungs: tuple[str, ...] = ()
    """Levels in order; empty for those that the constraints and objectives need."""
    share: dict[str, float] = Field({})
    """Share of a batch that is promoted after a level, the best predicted; 1 where absent."""
    accuracy: Literal["draft", "standard", "fine"] = "draft"
    """Fineness of mechanics, load and twin."""


class Prices(Section):
    """What parts cost, for the measure `cost`; assumed, in any currency."""

    resin_per_kg: float = Field(150.0, ge=0.0)
    """Printed resin."""
    switch_each: float = Field(0.2, ge=0.0)
    """A switch with its work."""
    camera_each: float = Field(40.0, ge=0.0)
    """A camera."""


class Study(Section):
    """One study. Units are those of the design file and of the measures' names."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    """Name of the study; letters, digits, '_', '-', '.'."""
    description: str = Field("", max_length=2000)
    """What it looks for."""
    design: Text
    """The design that varies: a shipped one, or a file beside the study's."""
    seed: int = Field(0, ge=0, le=2**31 - 1)
    """Seed of everything random."""
    fixed: dict[str, Any] = Field({})
    """Fields of that design with another value in all candidates: `"layout.heights" = "power"`."""
    variable: tuple[Variable, ...] = Field(min_length=1, max_length=100)
    constraint: tuple[Constraint, ...] = ()
    objective: tuple[Objective, ...] = ()
    budget: Budget = Budget()
    sampling: Sampling = Sampling()
    ladder: FidelitySection = FidelitySection()
    prices: Prices = Prices()

    @property
    def levels(self) -> tuple[str, ...]:
        """Fidelity levels that candidates go through, cheap ones first."""
        if self.ladder.rungs:
            return self.ladder.rungs
        needed = {MEASURES[name].rung for name in self.measures()} | {"rules"}
        # Visibility comes before loads: what is hidden at rest need not be pressed.
        if needed & {"exact", "mechanics", "load", "twin"}:
            needed |= {"sampled", "exact"}
        return tuple(level for level in LEVELS if level in needed)

    def measures(self) -> list[str]:
        """Measures of all constraints and objectives."""
        asked = [item.measure for item in self.constraint]
        return asked + [item.measure for item in self.objective]

    def level_groups(self) -> list[tuple[str, ...]]:
        """Levels that a candidate goes through without waiting for the rest of its batch."""
        out: list[tuple[str, ...]] = [()]
        for level in self.levels:
            out[-1] += (level,)
            if self.ladder.share.get(level, 1.0) < 1.0 and level != self.levels[-1]:
                out.append(())
        return out

    def identity(self) -> str:
        """Hash of everything that results depend on; a larger budget is the same study."""
        data = self.model_dump(mode="json", exclude={"budget", "description", "name"})
        # Grids and Latin hypercubes depend on the number of candidates.
        if self.sampling.sweep != "sobol":
            data["candidates"] = self.budget.candidates
        return sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


STUDY_FILES = TomlFileKind(
    noun="study", folder="studies", missing="docs/study.md shows a complete study", label="field"
)


def shipped_studies() -> list[str]:
    """Names of the studies that come with the package."""
    return STUDY_FILES.shipped()


def load_study(name_or_path: str) -> tuple[Study, Path]:
    """Read a shipped study by name, or any study file by path; and the folder that it lies in.

    Raises
    ------
    DesignError
        If there is no such study, or its file is not valid.
    """
    data, where = STUDY_FILES.read(name_or_path)
    return parse_study(data, where), Path(where).parent


def parse_study(data: dict[str, Any], where: str) -> Study:
    """Validate a parsed study file; the error lists every problem of its form."""
    study = STUDY_FILES.validate(Study, data, where)
    _check_measures(study, where)
    _check_levels(study, where)
    return study


def _check_measures(study: Study, where: str) -> None:
    """Reject constraints that no value meets, and unknown measures."""
    fields = [variable.field for variable in study.variable]
    for field in fields:
        if fields.count(field) > 1:
            raise DesignError(
                "variable-duplicate", f"{where}: the variable {field} is there twice; keep one"
            )
        if field in study.fixed:
            raise DesignError(
                "variable-also-fixed",
                f"{where}: {field} is both fixed and variable; keep one of them",
            )
    ranges = {name: (measure.low, measure.high) for name, measure in MEASURES.items()}
    for constraint in study.constraint:
        name = measure_of(constraint.measure, f"{where}: constraint").name
        low, high = ranges[name]
        low = max(low, -float("inf") if constraint.min is None else constraint.min)
        high = min(high, float("inf") if constraint.max is None else constraint.max)
        if low > high:
            raise DesignError(
                "constraints-contradict",
                f"{where}: no design can meet the constraints on {name}: at least {low:g} and at "
                f"most {high:g} contradict each other; loosen one",
            )
        ranges[name] = (low, high)
    seen = [objective.measure for objective in study.objective]
    for name in seen:
        measure_of(name, f"{where}: objective")
        if seen.count(name) > 1:
            raise DesignError(
                "objective-duplicate", f"{where}: the objective {name} is there twice; keep one"
            )


def _check_levels(study: Study, where: str) -> None:
    """Reject unknown levels, impossible shares, and measures above the last level."""
    for level in (*study.ladder.rungs, *study.ladder.share):
        if level not in LEVELS:
            near = get_close_matches(level, LEVELS, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise DesignError(
                "fidelity-level-unknown",
                f"{where}: no fidelity level {level!r}{hint} (levels: {', '.join(LEVELS)})",
            )
    order = [LEVELS.index(level) for level in study.levels]
    if order != sorted(set(order)) or study.levels[0] != "rules":
        raise DesignError(
            "fidelity-levels-order",
            f"{where}: ladder.rungs must begin with 'rules' and ascend (got "
            f"{', '.join(study.levels)}; the order is {', '.join(LEVELS)})",
        )
    if "exact" not in study.levels and {"mechanics", "load"} & set(study.levels):
        raise DesignError(
            "fidelity-level-missing",
            f"{where}: mechanics and load need the results of 'exact'; add it",
        )
    for level, share in study.ladder.share.items():
        if not 0.0 < share <= 1.0:
            raise DesignError(
                "fidelity-share-invalid",
                f"{where}: ladder.share.{level} must lie in (0, 1] (got {share:g})",
            )
        if level not in study.levels:
            raise DesignError(
                "fidelity-share-unused",
                f"{where}: ladder.share.{level}: the study does not use that level",
            )
    for name in study.measures():
        if name not in measures_up_to(study.levels):
            raise DesignError(
                "measure-above-levels",
                f"{where}: no level of ladder.rungs measures {name} ({', '.join(study.levels)}); "
                f"add {MEASURES[name].rung!r}, or leave ladder.rungs out",
            )
