"""The tables of docs/scenarios.md, written from the models themselves.

``python -m phytac_design.simulation.scenario.docs docs/scenarios.md`` renews them in place.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from phytac_design.simulation.scenario.scenario_file import Scenario
from phytac_design.simulation.scenario.sections import (
    ContactsSection,
    CycleSection,
    GivenContact,
    GripSection,
    ImagingSection,
    IndenterSection,
    LightSection,
    PadSection,
    SensorInstanceSection,
    SolveSection,
    TimeSection,
)

TABLES: dict[str, type[BaseModel]] = {
    "": Scenario,
    "[touch]": ContactsSection,
    "[[touch.indenters]]": IndenterSection,
    "[[touch.at]]": GivenContact,
    "[grip]": GripSection,
    "[[grip.pads]]": PadSection,
    "[cycle]": CycleSection,
    "[time]": TimeSection,
    "[light]": LightSection,
    "[unit]": SensorInstanceSection,
    "[eyes]": ImagingSection,
    "[solve]": SolveSection,
}
BEGIN, END = "<!-- fields: begin -->", "<!-- fields: end -->"


def field_tables() -> str:
    """Markdown of all tables: field, default, range, meaning."""
    return "\n".join(line for name, model in TABLES.items() for line in _table(name, model))


def _table(name: str, model: type[BaseModel]) -> Iterator[str]:
    yield f"### {f'`{name}`' if name else 'Top of the file'}\n"
    yield " ".join((model.__doc__ or "").split()) + "\n"
    yield "| field | default | range | meaning |"
    yield "|---|---|---|---|"
    for key, info in model.model_fields.items():
        if isinstance(info.default, BaseModel) or (not name and key in {"grip", "cycle"}):
            continue
        extra = info.json_schema_extra
        assumed = isinstance(extra, dict) and bool(extra.get("assumption"))
        text = " ".join((info.description or "").split()).replace("|", "\\|")
        shown = _default(info) + (" (assumed)" if assumed else "")
        yield f"| `{key}` | {shown} | {_range(info)} | {text} |"
    yield ""


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    value: Any = info.default
    if value is None:
        return "absent"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        plain = all(isinstance(item, int | float) for item in value)
        return f"[{', '.join(f'{item:g}' for item in value)}]" if plain else "see below"
    return f"`{value}`" if isinstance(value, str) else f"{value:g}"


def _range(info: FieldInfo) -> str:
    rules = (("gt", "> "), ("ge", "≥ "), ("lt", "< "), ("le", "≤ "))
    limits = [
        f"{sign}{getattr(rule, name):g}"
        for rule in info.metadata
        for name, sign in rules
        if isinstance(getattr(rule, name, None), int | float)
    ]
    return ", ".join(limits)


def renewed(page: str) -> str:
    """Page with its tables written anew."""
    head, rest = page.split(BEGIN)
    return f"{head}{BEGIN}\n{field_tables()}\n{END}{rest.split(END)[1]}"


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.write_text(renewed(target.read_text(encoding="utf-8")), encoding="utf-8")
