"""Scenario files: what is done to a sensor, in TOML; read, checked, named and hashed."""

import json
from hashlib import sha256
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from phytac_design.design.base_table import Section
from phytac_design.design.toml_files import TomlFileKind
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


SCENARIO_FILES = TomlFileKind(
    noun="scenario", folder="scenarios", missing="see docs/scenarios.md for what it means"
)


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    return SCENARIO_FILES.shipped()


def load_scenario(name_or_path: str) -> Scenario:
    """Read a shipped scenario by name, or any scenario file by path.

    Raises
    ------
    DesignError
        If there is no such scenario, it is not TOML, or a key or value is not acceptable.
    """
    return parse_scenario(*SCENARIO_FILES.read(name_or_path))


def parse_scenario(data: dict[str, Any], where: str) -> Scenario:
    """Validate a parsed scenario file; the error lists every problem.

    Raises
    ------
    DesignError
        With every unknown key and every invalid value.
    """
    return SCENARIO_FILES.validate(Scenario, data, f"scenario {where}")


def scenario_hash(scenario: Scenario) -> str:
    """Hash of the resolved scenario, the same for the same fields in any order."""
    text = json.dumps(scenario.model_dump(mode="json"), sort_keys=True)
    return sha256(text.encode()).hexdigest()
