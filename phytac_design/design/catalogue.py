"""What shapes there are, and what each asks of a design file: the text of `phytac shapes`."""

import inspect
from dataclasses import MISSING, Field, fields
from typing import Any

import phytac_shapes
from phytac_shapes import Surface


def shape_list() -> str:
    """One line for each family: name and what it is."""
    width = max(map(len, phytac_shapes.REGISTRY))
    lines = [
        f"{name:<{width}}  {_title(family)}" for name, family in phytac_shapes.REGISTRY.items()
    ]
    return "\n".join([*lines, "", "`phytac shapes NAME` shows a drawing and the variables."])


def shape_page(name: str) -> str:
    """Drawing and variables of one family, with ranges, ready for a design file.

    Raises
    ------
    DesignError
        If there is no such family.
    """
    family = phytac_shapes.family(name)
    rows = [f"[shape]\nkind = {name!r}".replace("'", '"')]
    for item in _variables(family):
        rows.append(f"# {item.metadata['doc']}{_range(item.metadata)}")
        rows.append(f"{item.name} = {_value(item.default)}")
    return f"{_drawing(family)}\n\n" + "\n".join(rows)


def shape_facts() -> list[dict[str, Any]]:
    """Return the same as plain data, for `phytac shapes --json`."""
    return [
        {
            "kind": name,
            "title": _title(family),
            "variables": [
                {
                    "name": item.name,
                    "doc": item.metadata["doc"],
                    "minimum": item.metadata.get("minimum"),
                    "maximum": item.metadata.get("maximum"),
                    "required": item.default is MISSING,
                }
                for item in _variables(family)
            ],
        }
        for name, family in phytac_shapes.REGISTRY.items()
    ]


def _variables(family: type[Surface]) -> tuple[Field[Any], ...]:
    return fields(family)  # type: ignore[arg-type]  # every family is a dataclass


def _drawing(family: type[Surface]) -> str:
    return inspect.cleandoc(inspect.getmodule(family).__doc__ or "")


def _title(family: type[Surface]) -> str:
    return _drawing(family).split("\n", 1)[0]


def _range(metadata: Any) -> str:
    if "minimum" not in metadata:
        return ""
    return f" [{metadata['minimum']:g} … {metadata['maximum']:g}]"


def _value(default: Any) -> str:
    if default is MISSING:
        return "…  # required"
    if isinstance(default, str):
        return f'"{default}"'
    if isinstance(default, tuple):
        return "[" + ", ".join(_value(item) for item in default) + "]"
    return f"{default:g}"
