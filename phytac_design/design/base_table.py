"""What every table of a design file has in common."""

import ast
import inspect
from collections.abc import Callable, Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Any, cast

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    ValidationInfo,
    model_validator,
)


def assumed(default: Any, **limits: Any) -> Any:
    """Field that the paper does not state: a default, marked as an assumption everywhere."""
    return Field(default, json_schema_extra={"assumption": True}, **limits)


def with_preset(
    data: Any, presets: Mapping[str, Mapping[str, Any]], field: str, default: str
) -> Any:
    """Table with the numbers of its preset in the place of fields that are not given.

    A preset whose numbers are all written out as another preset's would do nothing.

    Raises
    ------
    ValueError
        For such a preset, with the fields to leave out.
    """
    if not isinstance(data, dict):
        return data
    chosen = str(data.get(field, default))
    own = presets.get(chosen, {})
    for name, other in presets.items():
        differ = [key for key in other if key in own and _plain(other[key]) != _plain(own[key])]
        stale = [key for key in differ if key in data and _plain(data[key]) == _plain(other[key])]
        if name != chosen and len(stale) > 1 and 2 * len(stale) > len(differ):
            raise ValueError(
                f"{field} = {chosen!r}, but {', '.join(stale)} are written out as those of "
                f"{name!r}; delete these lines, or give {chosen!r} numbers of your own"
            )
    return {**own, **data}


def with_file(
    data: Any,
    info: ValidationInfo,
    field: str,
    content: str,
    read: Callable[[Path], Mapping[str, Any]],
) -> Any:
    """Table with what the file named in a field holds in its place: the design holds all it needs.

    Raises
    ------
    ValueError
        If the table has a ``content`` of its own.
    """
    named = data.get(field) if isinstance(data, dict) else None
    if not isinstance(named, str) or not named:
        return data
    if data.get(content):
        raise ValueError(f"{content} and {field} exclude each other; keep one of them")
    folder = (info.context or {}).get("folder", ".")
    return {**data, field: "", **read(Path(folder) / named)}


def _plain(value: Any) -> Any:
    """Lists and tuples alike, whole numbers as floats."""
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    # Larger whole numbers than a float holds stay what they are.
    return float(value) if isinstance(value, int) and abs(value) < 2**1000 else value


@cache
def descriptions(table: type[BaseModel]) -> dict[str, str]:
    """Meaning of each field: as stated with it, else the docstring below it.

    Read from the source when it is asked for; pydantic's ``use_attribute_docstrings`` reads all
    sources at every start of a process, which takes longer than making the classes. Without sources
    (an installation of compiled files alone) only what is stated with the fields is known.
    """
    stated = {name: info.description for name, info in table.model_fields.items()}
    found = {name: text for name, text in stated.items() if text}
    for owner in reversed(table.__mro__):
        if inspect.get_annotations(owner).keys() <= {*found, "model_config"}:
            continue
        try:
            source = inspect.getsource(owner)
        except OSError:
            continue
        tree = cast(ast.ClassDef, ast.parse(dedent(source)).body[0])
        for field, text in pairwise(tree.body):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(text, ast.Expr)
                and isinstance(text.value, ast.Constant)
            ):
                found[field.target.id] = inspect.cleandoc(str(text.value.value))
    return found


class Section(BaseModel):
    """A table of the design file."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        validate_default=True,
    )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: Any, handler: GetJsonSchemaHandler, /
    ) -> dict[str, Any]:
        """Return the schema with the meaning of each field."""
        schema = handler(core_schema)
        fields = handler.resolve_ref_schema(schema).get("properties", {})
        for name, text in descriptions(cls).items():
            if name in fields:
                fields[name]["description"] = text
        return schema

    @model_validator(mode="before")
    @classmethod
    def _no_truth_values(cls, data: Any) -> Any:
        """Reject true and false where no switch is meant; they would pass for 1 and 0."""
        if isinstance(data, dict):
            switches = {k for k, info in cls.model_fields.items() if info.annotation is bool}
            wrong = [str(k) for k, v in data.items() if isinstance(v, bool) and k not in switches]
            if wrong:
                raise ValueError(
                    f"{', '.join(wrong)} must be a number or a text, not true or false"
                )
        return data
