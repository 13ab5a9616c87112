"""From the values of variables to a design, and the check that they can be one."""

import math
from collections.abc import Mapping
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
    """A variable whose field is known.

    Attributes
    ----------
    variable : Variable
        As in the study file.
    whole : bool
        Whether its field holds whole numbers.
    """

    variable: Variable
    whole: bool

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
        step = own.step or (1.0 if self.whole and own.scale != "log" else None)
        if step is None or own.low is None or own.high is None:
            return ()
        count = math.floor((own.high - own.low) / step + 1e-9) + 1
        return tuple(self.typed(own.low + step * number) for number in range(count))

    def grid(self) -> tuple[Value, ...]:
        """Values that a grid takes."""
        shares = np.linspace(0.0, 1.0, self.variable.points)
        return self.values or tuple(dict.fromkeys(self.at(float(share)) for share in shares))

    def at(self, share: float) -> Value:
        """Value at a share in [0, 1] of the range; all values are equally wide."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        low, high = float(self.variable.low or 0.0), float(self.variable.high or 0.0)
        if self.variable.scale == "log":
            return self.typed(low * (high / low) ** share)
        return self.typed(low + (high - low) * share)

    def typed(self, value: float) -> Value:
        """Value of the field's own kind."""
        return round(value) if self.whole else float(value)


@dataclass(frozen=True, kw_only=True)
class Space:
    """The designs of a study.

    Attributes
    ----------
    base : dict
        The design that varies, with what the study fixes, as plain values.
    axes : tuple of Axis
        Its variables.
    name : str
        Of the study.
    """

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
            If they do not go together.
        """
        data = _copied(self.base)
        for field, value in params.items():
            _put(data, field, value)
        if name:
            data["name"] = name
        return parse_design(data, f"candidate of {self.name}")


def make_space(study: Study, folder: Path, base: Design | None = None) -> Space:
    """Space of a study whose file lies in ``folder``.

    Raises
    ------
    DesignError
        If the design does not exist, or has no field of a variable's name that takes its values.
    """
    beside = folder / study.design
    found = base or load_design(str(beside) if beside.is_file() else study.design)
    data = found.model_dump(mode="json")
    for field, value in study.fixed.items():
        _model_of(found, field, f"{study.name}: fixed")
        _put(data, field, value)
    if study.fixed:
        found = parse_design(data, f"{study.name}: design {study.design} with what is fixed")
        data = found.model_dump(mode="json")
    axes = []
    for variable in study.variable:
        axis = Axis(variable, _whole(found, variable.field, f"{study.name}: variable"))
        _check_ends(found, axis, study.name)
        axes.append(axis)
    return Space(base=data, axes=tuple(axes), name=study.name)


def _parts(field: str) -> list[str | int]:
    return [int(part) if part.isdigit() else part for part in field.split(".")]


def _copied(value: Any) -> Any:
    """Deep copy of plain values; several times quicker than ``copy.deepcopy``."""
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def _put(data: Any, field: str, value: Any) -> None:
    *path, last = _parts(field)
    for part in path:
        data = data[part]
    data[last] = value


def _model_of(design: Design, field: str, what: str) -> tuple[Any, str | int]:
    """Table (or list) that a field is in, and its name there."""
    at: Any = design
    walked: list[str] = []
    for part in (parts := _parts(field)):
        if isinstance(at, BaseModel):
            known = list(type(at).model_fields)
        elif isinstance(at, tuple | list):
            known = [str(number) for number in range(len(at))]
        else:
            raise DesignError(f"{what} {field!r}: {'.'.join(walked)} has no parts; stop there")
        if str(part) not in known:
            near = get_close_matches(str(part), known, n=1)
            said = ".".join([*walked, near[0]]) if near else ""
            hint = f"; did you mean {said!r}?" if near else f" (known: {', '.join(known)})"
            raise DesignError(
                f"{what}: the design has no field {'.'.join([*walked, str(part)])!r}{hint}"
            )
        if len(walked) == len(parts) - 1:
            break
        at = at[part] if isinstance(part, int) else getattr(at, part)
        walked.append(str(part))
    return at, parts[-1]


def _whole(design: Design, field: str, what: str) -> bool:
    """Whether a field holds whole numbers."""
    table, name = _model_of(design, field, what)
    if isinstance(table, BaseModel):
        return type(table).model_fields[str(name)].annotation is int
    return isinstance(table[int(name)], int)


def _check_ends(design: Design, axis: Axis, study: str) -> None:
    """Refuse values that the field itself does not take, whatever the others are."""
    table, name = _model_of(design, axis.field, study)
    own = axis.variable
    ends: tuple[Value, ...] = own.choices or (float(own.low or 0.0), float(own.high or 0.0))
    if axis.whole and not own.choices:
        numbers = (float(own.low or 0.0), float(own.high or 0.0), own.step or 1.0)
        broken = [number for number in numbers if not number.is_integer()]
        if broken:
            raise DesignError(
                f"{study}: variable {axis.field} is a whole number (got {broken[0]:g}); let low, "
                "high and step be whole"
            )
    if not isinstance(table, BaseModel):
        return
    for end in ends:
        value = end if own.choices else axis.typed(float(end))
        try:
            type(table).model_validate({**table.model_dump(mode="json"), name: value})
        except ValidationError as error:
            mine = [item for item in error.errors() if item["loc"][:1] == (name,)]
            if mine:
                raise DesignError(
                    f"{study}: variable {axis.field} cannot be {value!r}: "
                    f"{mine[0]['msg'][0].lower()}{mine[0]['msg'][1:]}"
                ) from None
