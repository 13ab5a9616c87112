"""What the studio's page may ask for, as typed requests; anything else is refused with its name."""

import json
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from phytac_design.studio.draft import SIDE_LEAST_PX, SIDE_PX
from phytac_shapes.errors import InputError

Name = Annotated[str, Field(max_length=1000)]
Tab = Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,64}$")]
SHOWN = 80


class Request(BaseModel):
    """A request's body."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class OpenRequest(Request):
    """Open a design."""

    name: Name


class DesignRequest(Request):
    """Something about a design: its tables, and what it was opened as."""

    data: dict[str, Any]
    source: Name = ""


class DraftRequest(DesignRequest):
    """Draw a design; a later request of the same tab takes this one's place."""

    tab: Tab
    side_px: Annotated[int, Field(ge=SIDE_LEAST_PX, le=SIDE_PX)] = SIDE_PX


class ExactRequest(DesignRequest):
    """Check a design."""

    tab: Tab


class SaveRequest(DesignRequest):
    """Save a design; ``replace`` is the text's digest that may be written over unasked."""

    name: Name
    replace: Name = ""
    force: bool = False


class BuildRequest(DesignRequest):
    """Build a design."""

    accuracy: Literal["draft", "standard", "fine"] = "draft"
    force: bool = False


class StudyRequest(Request):
    """Show a study."""

    folder: Name


class TrialRequest(StudyRequest):
    """Open a study's candidate."""

    trial: Annotated[int, Field(ge=0, le=10**12)]


class NoRequest(Request):
    """Nothing to say."""


Kind = TypeVar("Kind", bound=Request)


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number")


def parse(kind: type[Kind], body: bytes) -> Kind:
    """Typed request of a body.

    Raises
    ------
    InputError
        If it is not JSON, or not what is asked for; all that is wrong is in the text.
    """
    try:
        data = json.loads(body, parse_constant=_no_constant)
    except RecursionError:
        raise InputError("the request is nested too deeply; send a design's tables") from None
    except ValueError as error:
        raise InputError(f"the request is not JSON: {str(error)[:200]}") from None
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise InputError("; ".join(_said(item) for item in error.errors()[:10])) from None


def _said(item: Any) -> str:
    where = ".".join(map(str, item["loc"]))[:SHOWN] or "the request"
    if item["type"] == "extra_forbidden":
        return f"unknown field {where!r}"
    message = item["msg"][0].lower() + item["msg"][1:]
    got = "" if item["type"] == "missing" else f" (got {repr(item['input'])[:SHOWN]})"
    return f"{where}: {message}{got}"
