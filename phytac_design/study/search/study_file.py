"""Study files: what may vary, what must hold, what is striven for, and how much that may cost."""

import json
from collections.abc import Iterator
from difflib import get_close_matches
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from phytac_design.design.base_table import Section
from phytac_design.study.search.measures import LEVELS, MEASURES, measure_of, measures_up_to
from phytac_shapes.bounded_reader import joined, read_text, toml_table
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
                raise ValueError("choices exclude low, high, step and scale; keep one of them")
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
    """A measure that is to be small or large."""

    measure: Text
    """Which."""
    goal: Literal["min", "max"]
    """Whether less or more is better."""


class Budget(Section):
    """When to stop."""

    candidates: int = Field(256, ge=1, le=10_000_000)
    """Designs to look at."""
    seconds: float = Field(0.0, ge=0.0, le=1e8)
    """Time after which no further batch begins; 0 for no limit."""


class Sampling(Section):
    """Where candidates come from."""

    sweep: Literal["grid", "sobol", "latin-hypercube"] = "sobol"
    """How `phytac sweep` covers the space."""
    optimise: Literal["tpe", "nsga2"] = "tpe"
    """How `phytac optimise` goes on from what it has seen."""
    batch: int = Field(32, ge=1, le=4096)
    """Candidates that are drawn together; results do not depend on the number of workers."""
    start: int = Field(32, ge=1, le=100_000)
    """Candidates that `phytac optimise` first spreads by Sobol."""


class LadderSection(Section):
    """Which rungs candidates climb, and who goes on."""

    rungs: tuple[str, ...] = ()
    """Rungs in order; empty for all that are needed to measure what is asked."""
    share: dict[str, float] = Field({})
    """Share of a batch that goes on after a rung, the best by what is known; 1 where absent."""
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
    ladder: LadderSection = LadderSection()
    prices: Prices = Prices()

    @property
    def rungs(self) -> tuple[str, ...]:
        """Rungs that candidates climb, cheap ones first."""
        if self.ladder.rungs:
            return self.ladder.rungs
        asked = [item.measure for item in self.constraint]
        asked += [item.measure for item in self.objective]
        needed = {MEASURES[name].rung for name in asked} | {"rules"}
        # Seeing comes before pressing: what hides at rest need not be pressed.
        if needed & {"exact", "mechanics", "load", "twin"}:
            needed |= {"sampled", "exact"}
        return tuple(rung for rung in LEVELS if rung in needed)

    def groups(self) -> list[tuple[str, ...]]:
        """Rungs that a candidate climbs without waiting for others."""
        out: list[tuple[str, ...]] = [()]
        for rung in self.rungs:
            out[-1] += (rung,)
            if self.ladder.share.get(rung, 1.0) < 1.0 and rung != self.rungs[-1]:
                out.append(())
        return out

    def identity(self) -> str:
        """Hash of what makes candidates and their results; a larger budget is the same study."""
        data = self.model_dump(mode="json", exclude={"budget", "description", "name"})
        # Samplings that draw all at once, or lay a grid, are others with another number.
        if self.sampling.sweep != "sobol":
            data["candidates"] = self.budget.candidates
        return sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def shipped_studies() -> list[str]:
    """Names of the studies that come with the package."""
    folder = resources.files("phytac_design") / "data" / "studies"
    names = (item.name for item in folder.iterdir() if item.name.endswith(".toml"))
    return sorted(name.removesuffix(".toml") for name in names)


def load_study(name_or_path: str) -> tuple[Study, Path]:
    """Read a shipped study by name, or any study file by path; and the folder that it lies in.

    Raises
    ------
    DesignError
        If there is no such study, it is not TOML, or it cannot be carried out.
    """
    path = Path(name_or_path)
    if name_or_path in shipped_studies() and not path.is_file():
        source = resources.files("phytac_design") / "data" / "studies" / f"{name_or_path}.toml"
        return parse_study(source.read_text(encoding="utf-8"), name_or_path), Path()
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        near = get_close_matches(name_or_path, shipped_studies(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        why = getattr(error, "strerror", None) or "it is not text"
        raise DesignError(
            f"no study {name_or_path!r} ({why}){hint} (shipped: {', '.join(shipped_studies())}; "
            "or give the path of a study file)"
        ) from None
    return parse_study(text, str(path)), path.parent


def parse_study(text: str, where: str) -> Study:
    """Validate the text of a study file; every problem of its form is in the one error."""
    try:
        data = toml_table(text)
    except ValueError as error:
        raise DesignError(f"{where} is not TOML: {error}; docs/study.md shows one") from None
    try:
        study = Study.model_validate(data)
    except ValidationError as error:
        lines = joined(_explain(item, data) for item in error.errors())
        raise DesignError(f"{where}: {lines}") from None
    _check_measures(study, where)
    _check_ladder(study, where)
    return study


def _check_measures(study: Study, where: str) -> None:
    """Refuse constraints that no value meets, and measures that no rung finds."""
    fields = [variable.field for variable in study.variable]
    for field in fields:
        if fields.count(field) > 1:
            raise DesignError(f"{where}: the variable {field} is there twice; keep one")
        if field in study.fixed:
            raise DesignError(f"{where}: {field} is both fixed and variable; keep one of them")
    ranges = {name: (measure.low, measure.high) for name, measure in MEASURES.items()}
    for constraint in study.constraint:
        name = measure_of(constraint.measure, f"{where}: constraint").name
        low, high = ranges[name]
        low = max(low, -float("inf") if constraint.min is None else constraint.min)
        high = min(high, float("inf") if constraint.max is None else constraint.max)
        if low > high:
            raise DesignError(
                f"{where}: no design can meet the constraints on {name}: at least {low:g} and at "
                f"most {high:g} contradict each other; loosen one"
            )
        ranges[name] = (low, high)
    seen = [objective.measure for objective in study.objective]
    for name in seen:
        measure_of(name, f"{where}: objective")
        if seen.count(name) > 1:
            raise DesignError(f"{where}: the objective {name} is there twice; keep one")


def _check_ladder(study: Study, where: str) -> None:
    """Refuse unknown rungs, shares of none, and measures above the last rung."""
    for rung in (*study.ladder.rungs, *study.ladder.share):
        if rung not in LEVELS:
            near = get_close_matches(rung, LEVELS, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise DesignError(f"{where}: no rung {rung!r}{hint} (rungs: {', '.join(LEVELS)})")
    order = [LEVELS.index(rung) for rung in study.rungs]
    if order != sorted(set(order)) or study.rungs[0] != "rules":
        raise DesignError(
            f"{where}: ladder.rungs must begin with 'rules' and go up (got "
            f"{', '.join(study.rungs)}; the order is {', '.join(LEVELS)})"
        )
    if "exact" not in study.rungs and {"mechanics", "load"} & set(study.rungs):
        raise DesignError(f"{where}: mechanics and load need what 'exact' sees; add that rung")
    for rung, share in study.ladder.share.items():
        if not 0.0 < share <= 1.0:
            raise DesignError(f"{where}: ladder.share.{rung} must lie in (0, 1] (got {share:g})")
        if rung not in study.rungs:
            raise DesignError(f"{where}: ladder.share.{rung}: the study does not climb that rung")
    reached = set(measures_up_to(study.rungs))
    asked = [item.measure for item in study.constraint]
    for name in asked + [item.measure for item in study.objective]:
        if name not in reached:
            raise DesignError(
                f"{where}: no rung of the ladder measures {name} ({', '.join(study.rungs)}); add "
                f"{MEASURES[name].rung!r} to ladder.rungs, or leave ladder.rungs out"
            )


def _explain(item: Any, data: dict[str, Any]) -> str:
    """One problem as a sentence."""
    place = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        near = get_close_matches(str(item["loc"][-1]), list(_known(item["loc"][:-1])), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        return f"unknown key {place!r}{hint}"
    if item["type"] == "missing":
        return f"{place} is missing; docs/study.md shows a whole study"
    message = item["msg"][0].lower() + item["msg"][1:]
    got = item["input"]
    shown = "" if isinstance(got, dict | list) else f" (got {got!r})"
    number = item["loc"][1] if len(item["loc"]) > 1 and isinstance(item["loc"][1], int) else None
    if item["loc"][:1] == ("variable",) and number is not None:
        named = data["variable"][number]
        if isinstance(named, dict):
            place += f" ({named.get('field', '?')})"
    return f"{place or 'study'}: {message.removeprefix('value error, ')}{shown}"


def _known(place: tuple[Any, ...]) -> Iterator[str]:
    models: dict[str, type[Section]] = {
        "variable": Variable, "constraint": Constraint, "objective": Objective, "budget": Budget,
        "sampling": Sampling, "ladder": LadderSection, "prices": Prices,
    }  # fmt: skip
    yield from (models[str(place[0])] if place else Study).model_fields
