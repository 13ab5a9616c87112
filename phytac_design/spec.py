"""The design file as typed models: units, range and effect of each field; no unknown keys."""

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, Union

from pydantic import BaseModel, ConfigDict, Field, create_model, model_validator

import shapes
from shapes import Surface
from shapes.errors import DesignError

PIXELS_MAX = 64_000_000
"""Largest image that is rendered and segmented (about 3 GB of working memory)."""
ColourName = Literal["blue", "green"]


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


class ShapeSection(Section):
    """The surface family and its own variables."""

    kind: str
    """Surface family; `phytac shapes` lists them."""

    def surface(self) -> Surface:
        """Build the surface that this table describes."""
        return shapes.family(self.kind)(**self.model_dump(exclude={"kind"}))


def _shape_model(kind: str, surface: type[Surface]) -> type[ShapeSection]:
    """Model of one surface family, made from the variables that its dataclass declares."""
    variables: dict[str, Any] = {}
    for item in fields(surface):  # type: ignore[arg-type]  # every registered family is a dataclass
        default = ... if item.default is MISSING else item.default
        # Numbers in lists keep their range too: the surface itself checks it when it is made.
        limits = (
            {"ge": item.metadata["minimum"], "le": item.metadata["maximum"]}
            if item.type is float
            else {}
        )
        variables[item.name] = (
            item.type,
            Field(default, description=item.metadata["doc"], **limits),
        )
    tag: Any = (Literal[kind], Field(kind, description="Surface family."))
    return create_model(
        f"{surface.__name__}Section",
        __base__=ShapeSection,
        __doc__=f"A {kind} and its variables.",
        kind=tag,
        **variables,
    )


SHAPE_MODELS = {kind: _shape_model(kind, surface) for kind, surface in shapes.REGISTRY.items()}

if TYPE_CHECKING:
    AnyShape = ShapeSection
elif len(SHAPE_MODELS) == 1:
    AnyShape = next(iter(SHAPE_MODELS.values()))
else:
    AnyShape = Annotated[Union[tuple(SHAPE_MODELS.values())], Field(discriminator="kind")]  # noqa: UP007 - built at run time


class WallSection(Section):
    """The shell between the two rims."""

    thickness_mm: float = Field(0.8, gt=0.0, le=100.0)
    """Wall thickness, inward from the outer face."""
    rim_length_mm: float = assumed(4.0, ge=0.0, le=200.0)
    """Length of the clamped rim added beyond each end of the sensing surface; 0 for none."""
    rim_flange_mm: float = assumed(1.6, ge=0.0, le=200.0)
    """How far a rim stands out beyond the outer face, for the connectors."""


class LayoutSection(Section):
    """Markers on the surface, and how tall their receptors are."""

    kind: Literal["spiral", "straight"] = "spiral"
    """`spiral` turns each row against the one before; `straight` lines rows up."""
    rows: int = Field(23, ge=1, le=2000)
    """Markers along the sensor; row 0 is nearest the camera."""
    columns: int = Field(16, ge=1, le=2000)
    """Markers around the sensor."""
    spiral_angle_deg: float = Field(50.5, gt=-89.0, lt=89.0)
    """Angle α between a spiral and the sensor axis; each row shifts by row pitch · tan α."""
    colours: tuple[ColourName, ...] = Field(("blue", "green"), min_length=1, max_length=16)
    """Paints of the columns, repeated around."""
    height_near_mm: float = Field(0.5, gt=0.0, le=1000.0)
    """Receptor height in the row nearest the camera, from the inner face of the wall."""
    height_far_mm: float = Field(11.5, gt=0.0, le=1000.0)
    """Receptor height in the farthest row; rows between grow linearly."""


class ReceptorSection(Section):
    """The printed tube that carries a marker."""

    diameter_outer_mm: float = assumed(3.0, gt=0.0, le=200.0)
    """Outer diameter of the tube."""
    diameter_hole_mm: float = assumed(1.6, gt=0.0, le=200.0)
    """Through-hole for the stem of the switch, from the outer face to the end face."""
    band_marker_mm: float = assumed(1.0, ge=0.0, le=200.0)
    """Painted length of the tube's side below the end face; the end face is always painted."""


class SwitchSection(Section):
    """The threshold switch: a soft bowl on the outer face, its stem, its red tip."""

    threshold_N: float = Field(0.5, gt=0.0, le=1000.0)
    """The switch turns on when the force on its bowl's footprint exceeds this."""
    release_N: float = assumed(0.4, ge=0.0, le=1000.0)
    """The switch turns off again below this force; lower than the threshold."""
    footprint_diameter_mm: float = assumed(4.6, gt=0.0, le=500.0)
    """Diameter of the bowl: contact pressure is summed over this disc."""
    tip_diameter_mm: float = assumed(1.2, gt=0.0, le=200.0)
    """Diameter of the red tip; it must pass the hole."""
    tip_recess_mm: float = assumed(0.3, ge=0.0, le=100.0)
    """How far the resting tip stays behind the end face."""
    stroke_mm: float = assumed(1.5, gt=0.0, le=100.0)
    """How far a switch that is on pushes its tip."""


class CameraSection(Section):
    """An on-axis pinhole camera in front of the near rim, looking along +z."""

    width_px: int = Field(2592, ge=16, le=20000)
    """Image width."""
    height_px: int = Field(1944, ge=16, le=20000)
    """Image height."""
    focal_px: float = assumed(970.0, gt=0.0, le=1e6)
    """Focal length in pixels."""
    stand_off_mm: float | Literal["fit"] = assumed("fit")
    """Distance from the camera's centre to the near rim's plane; `fit` fills the image with it."""
    fill: float = assumed(0.975, gt=0.05, le=1.0)
    """For `fit`: inner radius of the near rim as a fraction of half the smaller image side."""
    noise_pixel: float = assumed(2.0, ge=0.0, le=128.0)
    """Standard deviation of the sensor noise in grey levels (of 255), for rendered frames."""
    noise_centroid_px: float = assumed(0.04, ge=0.0, le=10.0)
    """Standard deviation of a marker's measured centroid, for simulated measurements."""

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Self:
        pixels = self.width_px * self.height_px
        if pixels > PIXELS_MAX:
            raise ValueError(
                f"{self.width_px} x {self.height_px} px are {pixels / 1e6:.0f} megapixels, more "
                f"than {PIXELS_MAX / 1e6:.0f}; lower width_px and height_px, or bin the image"
            )
        return self


class LightSection(Section):
    """The light bar on the axis; it can hide markers."""

    bar_radius_mm: float = assumed(3.0, ge=0.0, le=1000.0)
    """Radius of the bar; 0 for none."""
    bar_start_mm: float = assumed(5.0, ge=-1000.0, le=5000.0)
    """Where the bar begins, as z; it ends at the far rim."""


class MaterialSection(Section):
    """The printed resin, to be calibrated on the real sensor (paper, eq. 4)."""

    modulus_MPa: float = assumed(2200.0, ge=1e-3, le=1e6)
    """Young's modulus."""
    poisson: float = assumed(0.38, ge=0.0, lt=0.5)
    """Poisson's ratio."""


class PrintSection(Section):
    """Rules of the printer (SLA resin by default)."""

    wall_min_mm: float = assumed(0.4, ge=0.0, le=100.0)
    """Thinnest supported wall."""
    hole_min_mm: float = assumed(0.5, ge=0.0, le=100.0)
    """Smallest hole that stays open."""
    gap_min_mm: float = assumed(0.3, ge=0.0, le=100.0)
    """Smallest gap between two receptors."""


class TrainingSection(Section):
    """Simulated contacts that train and judge the decoder."""

    samples: int = Field(598, ge=20, le=100000)
    """Contacts to learn from; split 8.5 : 0.5 : 1 as in the paper."""
    samples_test: int = Field(1000, ge=10, le=100000)
    """Further contacts, never trained on, to judge with."""
    multi_contact: float = Field(0.48, ge=0.0, le=1.0)
    """Share of samples with more than one contact."""
    force_min_N: float = Field(0.5, gt=0.0, le=1e4)
    """Smallest force of a contact."""
    force_max_N: float = Field(25.0, gt=0.0, le=1e4)
    """Largest force of a contact."""
    patch_radius_min_mm: float = assumed(4.0, gt=0.0, le=1e3)
    """Smallest radius of a contact patch."""
    patch_radius_max_mm: float = assumed(7.0, gt=0.0, le=1e3)
    """Largest radius of a contact patch (a fingertip)."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.force_max_N <= self.force_min_N:
            raise ValueError("force_max_N must exceed force_min_N")
        if self.patch_radius_max_mm < self.patch_radius_min_mm:
            raise ValueError("patch_radius_max_mm must not be below patch_radius_min_mm")
        return self


class Design(Section):
    """One sensor. Lengths in mm, forces in N, moduli in MPa, angles in degrees (here only)."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    """Name of the sensor; letters, digits, '_', '-', '.'."""
    description: str = Field("", max_length=2000)
    """What it is, for the report."""
    shape: AnyShape
    """The surface family and its variables; `phytac shapes` lists them."""
    wall: WallSection = WallSection()
    layout: LayoutSection = LayoutSection()
    receptor: ReceptorSection = ReceptorSection()
    switch: SwitchSection = SwitchSection()
    camera: CameraSection = CameraSection()
    light: LightSection = LightSection()
    material: MaterialSection = MaterialSection()
    print_rules: PrintSection = PrintSection()
    training: TrainingSection = TrainingSection()

    def surface(self) -> Surface:
        """Build the sensing surface."""
        return self.shape.surface()


__all__ = ["Design", "DesignError", "Section"]
