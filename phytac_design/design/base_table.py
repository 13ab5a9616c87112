"""What every table of a design file has in common."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator


def assumed(default: Any, **limits: Any) -> Any:
    """Field that the paper does not state: a default, marked as an assumption everywhere."""
    return Field(default, json_schema_extra={"assumption": True}, **limits)


def refuse_stale(
    data: Mapping[str, Any], presets: Mapping[str, Mapping[str, Any]], field: str, chosen: str
) -> None:
    """Refuse a preset whose numbers are all written out as another preset's: it would do nothing.

    Raises
    ------
    ValueError
        With the fields to leave out.
    """
    own = presets.get(chosen, {})
    for name, other in presets.items():
        differ = [key for key in other if key in own and _plain(other[key]) != _plain(own[key])]
        stale = [key for key in differ if key in data and _plain(data[key]) == _plain(other[key])]
        if name != chosen and len(stale) > 1 and 2 * len(stale) > len(differ):
            raise ValueError(
                f"{field} = {chosen!r}, but {', '.join(stale)} are written out as those of "
                f"{name!r}; delete these lines, or give {chosen!r} numbers of your own"
            )


def _plain(value: Any) -> Any:
    """Lists and tuples alike, whole numbers as floats."""
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    # Larger whole numbers than a float holds stay what they are.
    return float(value) if isinstance(value, int) and abs(value) < 2**1000 else value


class Section(BaseModel):
    """A table of the design file."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        use_attribute_docstrings=True,
        allow_inf_nan=False,
        validate_default=True,
    )

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
