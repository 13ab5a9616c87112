"""The search space of a study: from values of its variables to a design."""

import math
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.spec import Design
from phytac_design.study.search.study_file import Study, Value, Variable
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError

Params = dict[str, Value]
"""Value of each variable, by its field."""


@dataclass(frozen=True)
class Axis:
    """A variable of the study file, and whether its field is an integer."""

    variable: Variable
    integer: bool

    @property
    def field(self) -> str:
        """Field of the design file."""
        return self.variable.field

    @cached_property
    def values(self) -> tuple[Value, ...]:
        """All values of choices, or of a range with steps; empty for a range without."""
        own = self.variable
        if own.choices:
            return own.choices
        step = own.step or (1.0 if self.integer and own.scale != "log" else None)
        if step is None or own.low is None or own.high is None:
            return ()
        count = math.floor((own.high - own.low) / step + 1e-9) + 1
        return tuple(self.typed(own.low + step * number) for number in range(count))

    def grid(self) -> tuple[Value, ...]:
        """Values that a grid takes."""
        shares = np.linspace(0.0, 1.0, self.variable.points)
        return self.values or tuple(dict.fromkeys(self.at(float(share)) for share in shares))

    def at(self, share: float) -> Value:
        """Value at a fraction in [0, 1] of the range; discrete values are equally probable."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        low, high = float(self.variable.low or 0.0), float(self.variable.high or 0.0)
        if self.variable.scale == "log":
            return self.typed(low * (high / low) ** share)
        return self.typed(low + (high - low) * share)

    def typed(self, value: float) -> Value:
        """Value as the field's type."""
        return round(value) if self.integer else float(value)


@dataclass(frozen=True, kw_only=True)
class DesignSpace:
    """The designs of a study: base design with fixed fields, variables, name."""

    base: dict[str, Any]
    axes: tuple[Axis, ...]
    name: str

    def params(self, shares: FloatArray) -> Params:
        """Values of all variables at shares (d,) of their ranges."""
        return {a.field: a.at(float(s)) for a, s in zip(self.axes, shares, strict=True)}

    def design(self, params: Mapping[str, Value], name: str = "") -> Design:
        """Design with these values.

        Raises
        ------
        DesignError
            If they make no valid design.
        """
        data = deepcopy(self.base)
        for field, value in params.items():
            _put(data, field, value)
        if name:
            data["name"] = name
        return parse_design(data, f"candidate of {self.name}")


def make_space(study: Study, folder: Path, base: Design | None = None) -> DesignSpace:
    """Space of a study whose file lies in ``folder``.

    Raises
    ------
    DesignError
        If the design does not exist, or has no field of a variable's name that takes its values.
    """
    beside = folder / study.design
    design = base or load_design(str(beside) if beside.is_file() else study.design)
    data = design.model_dump(mode="json")
    for field, value in study.fixed.items():
        _parent(design, field, f"{study.name}: fixed")
        _put(data, field, value)
    if study.fixed:
        design = parse_design(data, f"{study.name}: design {study.design} with [fixed]")
        data = design.model_dump(mode="json")
    axes = tuple(_axis(design, variable, study.name) for variable in study.variable)
    return DesignSpace(base=data, axes=axes, name=study.name)


def _parts(field: str) -> list[str | int]:
    return [int(part) if part.isdigit() else part for part in field.split(".")]


def _put(data: Any, field: str, value: Any) -> None:
    *path, last = _parts(field)
    for part in path:
        data = data[part]
    data[last] = value


def _parent(design: Design, field: str, what: str) -> tuple[Any, str | int]:
    """Table (or list) that holds a field, and the field's name in it."""
    at: Any = design
    *path, last = _parts(field)
    walked: list[str] = []
    for part in (*path, last):
        if isinstance(at, BaseModel):
            known = list(type(at).model_fields)
        elif isinstance(at, tuple | list):
            known = [str(number) for number in range(len(at))]
        else:
            raise DesignError(
                "field-unknown", f"{what} {field!r}: {'.'.join(walked)} has no parts; stop there"
            )
        if str(part) not in known:
            near = get_close_matches(str(part), known, n=1)
            nearest = ".".join([*walked, *near])
            hint = f"; did you mean {nearest!r}?" if near else f" (known: {', '.join(known)})"
            raise DesignError(
                "field-unknown",
                f"{what}: the design has no field {'.'.join([*walked, str(part)])!r}{hint}",
            )
        if len(walked) < len(path):
            at = at[part] if isinstance(part, int) else getattr(at, part)
            walked.append(str(part))
    return at, last


def _axis(design: Design, variable: Variable, study: str) -> Axis:
    """Axis of a variable; raises if its field does not take the ends of the range or a choice."""
    table, name = _parent(design, variable.field, f"{study}: variable")
    if not isinstance(table, BaseModel):
        axis = Axis(variable, isinstance(table[int(name)], int))
    else:
        axis = Axis(variable, type(table).model_fields[str(name)].annotation is int)
    ends: tuple[Value, ...] = variable.choices
    if not ends:
        ends = float(variable.low or 0.0), float(variable.high or 0.0)
        fractions = [n for n in (*ends, variable.step or 1.0) if not float(n).is_integer()]
        if axis.integer and fractions:
            raise DesignError(
                "variable-not-whole",
                f"{study}: variable {axis.field} is a whole number (got {fractions[0]:g}); use "
                "whole numbers for low, high and step",
            )
        ends = tuple(axis.typed(end) for end in ends)
    for value in ends if isinstance(table, BaseModel) else ():
        try:
            type(table).model_validate({**table.model_dump(mode="json"), name: value})
        except ValidationError as error:
            own = [item["msg"] for item in error.errors() if item["loc"][:1] == (name,)]
            if own:
                raise DesignError(
                    "variable-value-invalid",
                    f"{study}: variable {axis.field} cannot be {value!r}: "
                    f"{own[0][0].lower()}{own[0][1:]}",
                ) from None
    return axis
