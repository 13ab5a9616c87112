"""Scene files: the outputs, contacts and regions that a build is limited to, in TOML."""

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import Field, model_validator

from phytac_design.design.base_table import Section
from phytac_design.design.toml_files import TomlFileKind

if TYPE_CHECKING:
    from collections.abc import Sequence

Output = Literal[
    "views",
    "visibility",
    "underload",
    "resolution",
    "fabrication",
    "shell",
    "mesh",
    "decoder",
    "frames",
    "report",
]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
ALL_AT_ONCE = 5
"""Maximum number of simultaneous contacts of a build without a scene."""


class SceneRegionSection(Section):
    """A part of the surface that contains contact centres, as shares of the chart."""

    name: str = Field("", max_length=40)
    """What it is, for reports."""
    along: tuple[Share, Share] = (0.0, 1.0)
    """From and to along the sensor (u), 0 at the near end."""
    around: tuple[Share, Share] = (0.0, 1.0)
    """From and to around the sensor (v); the first may exceed the second where it closes around."""

    @model_validator(mode="after")
    def _has_a_size(self) -> Self:
        if not self.along[0] < self.along[1]:
            raise ValueError(f"along must grow (got {list(self.along)})")
        if self.around[0] == self.around[1]:
            raise ValueError(f"around must have a size (got {list(self.around)})")
        return self


class ContactSection(Section):
    """Contacts of the scene; absent values are the design's (its table `training`)."""

    force_min_N: float | None = Field(None, gt=0.0, le=1e4)
    """Smallest force of a contact."""
    force_max_N: float | None = Field(None, gt=0.0, le=1e4)
    """Largest force of a contact."""
    radius_min_mm: float | None = Field(None, gt=0.0, le=1e3)
    """Smallest radius of a patch."""
    radius_max_mm: float | None = Field(None, gt=0.0, le=1e3)
    """Largest radius of a patch."""
    at_once: int = Field(ALL_AT_ONCE, ge=1, le=50)
    """Maximum number of simultaneous contacts."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for low, high in (("force_min_N", "force_max_N"), ("radius_min_mm", "radius_max_mm")):
            first, last = getattr(self, low), getattr(self, high)
            if first is not None and last is not None and first > last:
                raise ValueError(f"{low} must not exceed {high} (got {first:g} and {last:g})")
        return self


class Scene(Section):
    """One scene. Lengths in mm, forces in N, frame rates in Hz."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    """Name of the scene; letters, digits, '_', '-', '.'."""
    description: str = Field("", max_length=2000)
    """What it is, for reports."""
    outputs: tuple[Output, ...] = Field(min_length=1)
    """Outputs of the build: `views` (pictures), `visibility` (at rest), `underload` (pressed),
    `resolution`, `fabrication`, `shell`, `mesh`, `decoder`, `frames`, `report` (everything)."""
    camera: Literal["near", "far"] | None = None
    """The camera to use, of a sensor with two; absent: the design's."""
    estimator: Literal["any", "auto", "koi_inverse", "fem_nn"] = "any"
    """Estimator of the decoder; `any`: `auto` if it keeps up with the frames."""
    frame_rate_Hz: float | None = Field(None, gt=0.0, le=1e6)
    """Frames that have to be decoded per second; absent: latency does not matter."""
    error_allowed: float = Field(0.02, gt=0.0, le=1.0)
    """Accepted relative error of a force."""
    contacts: ContactSection = ContactSection()
    regions: tuple[SceneRegionSection, ...] = Field((), max_length=64)
    """Parts of the surface that are touched; none: the whole surface."""

    @property
    def wants(self) -> frozenset[str]:
        """Names of the outputs; all of them for a report."""
        return frozenset(get_args(Output) if "report" in self.outputs else self.outputs)

    @property
    def pictures(self) -> bool:
        """Whether pictures of the sensor are rendered."""
        return "views" in self.wants

    @property
    def networks(self) -> bool:
        """Whether the networks of the paper are trained, on the design's number of samples.

        Without, a few samples are simulated for evaluation.
        """
        return self.estimator == "fem_nn" or "report" in self.outputs

    @property
    def at_once(self) -> int:
        """Maximum number of simultaneous contacts."""
        return self.contacts.at_once

    @property
    def reach_mm(self) -> float | None:
        """Largest radius of a patch; None without regions."""
        return self.contacts.radius_max_mm if self.regions else None

    def inputs(self, parts: "Sequence[str]") -> dict[str, Any]:
        """Plain values of some properties that differ from a build without a scene."""
        data = self.model_dump(mode="json")
        values = {name: data.get(name, getattr(self, name)) for name in parts}
        return {name: value for name, value in values.items() if value != SCENE_DEFAULTS[name]}


SCENE_DEFAULTS: dict[str, Any] = {
    "name": None,
    "pictures": True,
    "networks": True,
    "at_once": ALL_AT_ONCE,
    "regions": [],
    "reach_mm": None,
}
"""Properties that stages read of a scene, and their values without one."""


SCENE_FILES = TomlFileKind(
    noun="scene", folder="scenes", missing="see docs/plan.md for what it means"
)


def load_scene(name_or_path: str) -> Scene:
    """Read a shipped scene by name, or any scene file by path.

    Raises
    ------
    DesignError
        If there is no such scene, it is not TOML, or a key or value is not acceptable.
    """
    return parse_scene(*SCENE_FILES.read(name_or_path))


def parse_scene(data: dict[str, Any], where: str) -> Scene:
    """Validate a parsed scene file; the error lists every problem.

    Raises
    ------
    DesignError
        With every unknown key and every invalid value.
    """
    return SCENE_FILES.validate(Scene, data, f"scene {where}")
