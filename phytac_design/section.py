"""What every table of a design file has in common."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field, model_validator


def assumed(default: Any, **limits: Any) -> Any:
    """Field that the paper does not state: a default, marked as an assumption everywhere."""
    return Field(default, json_schema_extra={"assumption": True}, **limits)


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
        """Refuse true and false, which would otherwise pass for 1 and 0."""
        if isinstance(data, dict):
            wrong = [str(key) for key, value in data.items() if isinstance(value, bool)]
            if wrong:
                raise ValueError(
                    f"{', '.join(wrong)} must be a number or a text, not true or false"
                )
        return data
