"""Scenario files: what is done to a sensor, in TOML; read, checked, named and hashed."""

import json
import types
from difflib import get_close_matches
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any, Literal, Self, Union, get_args, get_origin

from pydantic import BaseModel, Field, ValidationError, model_validator

from phytac_design.design.base_table import Section
from phytac_design.simulation.scenario.scenario_sections import (
    ContactsSection,
    CycleSection,
    GripSection,
    ImagingSection,
    LightDriftSection,
    SensorInstanceSection,
    SolveSection,
    TimeSection,
)
from phytac_shapes.bounded_reader import joined, read_text, toml_table
from phytac_shapes.errors import DesignError


class Scenario(Section):
    """One scenario. Lengths in mm, forces in N, times in s, angles in degrees (here only)."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    """Name of the scenario; letters, digits, '_', '-', '.'."""
    description: str = Field("", max_length=2000)
    """What it is, for the dataset."""
    kind: Literal["presses", "grips", "cycles"] = "presses"
    """`presses`: samples independent of each other; `grips`: a hand of several pads; `cycles`:
    one press, again and again."""
    touch: ContactsSection = ContactsSection()
    grip: GripSection | None = None
    """For kind `grips` only."""
    cycle: CycleSection | None = None
    """For kind `cycles` only."""
    time: TimeSection = TimeSection()
    light: LightDriftSection = LightDriftSection()
    unit: SensorInstanceSection = SensorInstanceSection()
    eyes: ImagingSection = ImagingSection()
    solve: SolveSection = SolveSection()

    @model_validator(mode="before")
    @classmethod
    def _own_table(cls, data: Any) -> Any:
        """Give grips and cycles their table, and only them."""
        if not isinstance(data, dict):
            return data
        data, kind = dict(data), data.get("kind", "presses")
        for owner, table in (("grips", "grip"), ("cycles", "cycle")):
            if kind == owner and data.get(table) is None:
                data[table] = {}
            if kind != owner and data.get(table) is not None:
                raise ValueError(
                    f"[{table}] goes with kind = {owner!r} (got kind = {kind!r}); set kind, or "
                    "leave the table out"
                )
        return data

    @model_validator(mode="after")
    def _touches_of_kind(self) -> Self:
        at = self.touch.at
        if self.kind == "grips" and at is not None:
            raise ValueError("[[touch.at]] does not go with kind = 'grips'; give [[grip.pads]]")
        if self.kind == "cycles":
            if self.touch.samples is not None:
                raise ValueError(
                    "touch.samples does not go with kind = 'cycles'; set cycle.count, cycle.every "
                    "and cycle.phases"
                )
            late = [item.sample for item in at or () if item.sample > 0]
            if late:
                raise ValueError(
                    f"contacts of cycles are pressed together, as sample 0 (got {late[0]}); leave "
                    "sample out"
                )
        if self.kind == "presses" and at and self.touch.samples is not None:
            last = max(item.sample for item in at)
            if last >= self.touch.samples:
                raise ValueError(
                    f"[[touch.at]] names sample {last}, touch.samples = {self.touch.samples} ends "
                    f"before; raise it to {last + 1} or leave it out"
                )
        return self


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    folder = resources.files("phytac_design") / "data" / "scenarios"
    return sorted(
        item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml")
    )


def load_scenario(name_or_path: str) -> Scenario:
    """Read a shipped scenario by name, or any scenario file by path.

    Raises
    ------
    DesignError
        If there is no such scenario, it is not TOML, or a key or value is not acceptable.
    """
    text, where = _read(name_or_path)
    try:
        data = toml_table(text)
    except ValueError as error:
        raise DesignError(
            f"{where} is not TOML: {error}; start from a shipped scenario "
            f"({', '.join(shipped_scenarios())})"
        ) from None
    return parse_scenario(data, where)


def parse_scenario(data: dict[str, Any], where: str) -> Scenario:
    """Validate a parsed scenario file; every problem is in the one error.

    Raises
    ------
    DesignError
        With every key that is not known and every value that will not do.
    """
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        problems = error.errors()
        above = {item["loc"][:n] for item in problems for n in range(len(item["loc"]))}
        lines = [
            _explain(item)
            for item in problems
            # A rejected item makes its list too short as well: once is enough.
            if item["loc"] not in above
        ]
        raise DesignError(f"scenario {where}: {joined(lines)}") from None


def scenario_hash(scenario: Scenario) -> str:
    """Hash of the resolved scenario, the same for the same fields in any order."""
    text = json.dumps(scenario.model_dump(mode="json"), sort_keys=True)
    return sha256(text.encode()).hexdigest()


def _read(name_or_path: str) -> tuple[str, str]:
    path, shipped = Path(name_or_path), shipped_scenarios()
    if name_or_path in shipped and not path.is_file():
        source = resources.files("phytac_design") / "data" / "scenarios" / f"{name_or_path}.toml"
        return source.read_text(encoding="utf-8"), name_or_path
    try:
        return read_text(path), str(path)
    except UnicodeDecodeError:
        raise DesignError(
            f"{path} is not TOML: it is not even text; give a scenario file"
        ) from None
    except OSError as error:
        near = get_close_matches(name_or_path, shipped, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise DesignError(
            f"no scenario {name_or_path!r} ({error.strerror}){hint} "
            f"(shipped: {', '.join(shipped)}; or give the path of a scenario file)"
        ) from None


def _explain(item: Any) -> str:
    """One problem as a sentence: where, what, got, and what would do."""
    parts = item["loc"]
    where = ".".join(str(part) for part in parts)
    if item["type"] == "extra_forbidden":
        known = list(_model_at(parts[:-1]).model_fields)
        near = get_close_matches(str(parts[-1]), known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f" (known: {', '.join(known)})"
        return f"unknown key {where!r}{hint}"
    if item["type"] == "missing":
        return f"{where} is missing; see docs/scenarios.md for what it means"
    message = item["msg"][0].lower() + item["msg"][1:]
    got = "" if isinstance(item["input"], dict | Section) else f" (got {item['input']!r})"
    return f"{where or 'file'}: {message.removeprefix('value error, ')}{got}"


def _model_at(parts: tuple[Any, ...]) -> type[BaseModel]:
    """Model of the table at a place in the file."""
    model: type[BaseModel] = Scenario
    for part in parts:
        if isinstance(part, str):
            model = _inner(model.model_fields[part].annotation) or model
    return model


def _inner(annotation: Any) -> type[BaseModel] | None:
    """Find the model in ``Model``, ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if get_origin(annotation) in {Union, types.UnionType, tuple}:
        for part in get_args(annotation):
            found = _inner(part)
            if found:
                return found
    return None
