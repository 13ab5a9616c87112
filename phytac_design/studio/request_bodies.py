"""Typed request bodies of the studio's page; anything else is rejected with the field's name."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from phytac_design.studio.draft import SIDE_MIN_px, SIDE_px
from phytac_shapes.errors import InputError

Name = Annotated[str, Field(max_length=1000)]
Tab = Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,64}$")]


class RequestBody(BaseModel):
    """A request's body; this one is empty."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class OpenRequest(RequestBody):
    """Open a design."""

    name: Name


class DesignRequest(RequestBody):
    """A request about a design: its tables, and the file that it was opened from."""

    data: dict[str, Any]
    source: Name = ""


class CheckRequest(DesignRequest):
    """Check a design; a later request of the same tab supersedes this one."""

    tab: Tab


class DraftRequest(CheckRequest):
    """Draw a design; a later request of the same tab supersedes this one."""

    side_px: Annotated[int, Field(ge=SIDE_MIN_px, le=SIDE_px)] = SIDE_px


Share = Annotated[float, Field(ge=0.0, le=1.0)]


class PressRequest(DraftRequest):
    """Draw a design under a press; a later request of the same tab supersedes this one.

    The press is placed in the view of ``camera``, at shares of its width and height.
    """

    camera: Annotated[int, Field(ge=0, le=1)]
    x: Share
    y: Share
    force_N: Annotated[float, Field(ge=0.0, le=1e4)]


class SaveRequest(DesignRequest):
    """Save a design; ``replace`` is the digest of the text that may be overwritten unasked."""

    name: Name
    replace: Name = ""
    force: bool = False


class BuildRequest(DesignRequest):
    """Build a design."""

    accuracy: Literal["draft", "standard", "fine"] = "draft"
    force: bool = False


class StudyRequest(RequestBody):
    """Show a study."""

    folder: Name


class TrialRequest(StudyRequest):
    """Open a study's candidate."""

    trial: Annotated[int, Field(ge=0, le=10**12)]


Body = TypeVar("Body", bound=RequestBody)


def parse(kind: type[Body], body: bytes) -> Body:
    """Typed request of a body.

    Raises
    ------
    InputError
        If it is not JSON, or not of that kind; the text lists the problems.
    """
    try:
        return kind.model_validate_json(body)
    except ValidationError as error:
        problems = (
            f"{'.'.join(map(str, item['loc']))[:80] or 'the request'}: {item['msg'][:200]}"
            for item in error.errors(include_input=False)[:10]
        )
        raise InputError("request-invalid", "; ".join(problems)) from None
