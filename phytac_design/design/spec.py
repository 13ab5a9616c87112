"""The design file as typed models: units, range and effect of each field; no unknown keys."""

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, Union

from pydantic import Field, ValidationInfo, create_model, model_validator

import phytac_shapes
from phytac_decoder.camera.lens import LENSES, Lens
from phytac_decoder.vision.brightness import DOTS
from phytac_design.design.base_table import Section, assumed
from phytac_design.design.documents_table import BenchSection, KitSection
from phytac_design.design.effort_table import EffortSection
from phytac_design.design.field_of_view import focal_of_view_px
from phytac_design.design.fixture_table import AnyFixture
from phytac_design.design.hardware_table import HardwareSection
from phytac_design.design.layout_table import LayoutSection, ReceptorSection, ReferenceMarksSection
from phytac_design.design.paints_table import NOMINAL_PAINTS, PaintsSection
from phytac_design.design.print_rules_table import PrintSection
from phytac_design.design.regions_table import RegionSection
from phytac_design.design.switch_table import MoldSection, StripSection, SwitchSection
from phytac_shapes import Surface
from phytac_shapes.errors import DesignError


class ShapeSection(Section):
    """The surface family and its own variables."""

    kind: str
    """Surface family; `phytac shapes` lists them."""

    def surface(self) -> Surface:
        """Build the surface that this table describes."""
        return phytac_shapes.family(self.kind)(**self.model_dump(exclude={"kind"}))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by kind and variables: the class is made at run time, see :func:`_shape_model`."""
        return _shape_of, (self.model_dump(),)


def _shape_of(values: dict[str, Any]) -> ShapeSection:
    return SHAPE_MODELS[values["kind"]](**values)


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


SHAPE_MODELS = {
    kind: _shape_model(kind, surface) for kind, surface in phytac_shapes.REGISTRY.items()
}

if TYPE_CHECKING:
    AnyShape = ShapeSection
elif len(SHAPE_MODELS) == 1:
    AnyShape = next(iter(SHAPE_MODELS.values()))
else:
    AnyShape = Annotated[Union[tuple(SHAPE_MODELS.values())], Field(discriminator="kind")]  # noqa: UP007 - built at run time


if TYPE_CHECKING:
    LensModel = str
else:
    LensModel = Literal[tuple(LENSES)]


class WallSection(Section):
    """The shell between the two rims."""

    thickness_mm: float = Field(0.8, gt=0.0, le=100.0)
    """Wall thickness, inward from the outer face."""
    rim_length_mm: float = assumed(4.0, ge=0.0, le=200.0)
    """Length of the clamped rim added beyond each end of the sensing surface; 0 for none."""
    rim_flange_mm: float = assumed(1.6, ge=0.0, le=200.0)
    """How far a rim stands out beyond the outer face, for the connectors."""


CAMERA_PRESETS: dict[str, dict[str, float]] = {
    "paper_30fps": {"width_px": 2592, "height_px": 1944, "frame_rate_Hz": 30.0, "focal_px": 970.0},
    "paper_480fps": {"width_px": 640, "height_px": 480, "frame_rate_Hz": 480.0, "focal_px": 239.5},
}
"""Both cameras of the paper; it states no focal lengths: the same field of view is assumed."""


class CameraSection(Section):
    """A camera on the axis: its lens, where it stands, its noise."""

    preset: Literal["custom", "paper_30fps", "paper_480fps"] = "custom"
    """Sets image size, frame rate and, unless given, focal length to those of a known camera."""
    model: LensModel = assumed("pinhole")
    """Lens: none but perspective, barrel or pincushion distortion, fisheye, unified (Mei)."""
    width_px: int = Field(2592, ge=16, le=20000)
    """Image width."""
    height_px: int = Field(1944, ge=16, le=20000)
    """Image height."""
    frame_rate_Hz: float = Field(30.0, gt=0.0, le=1e6)
    """Frames per second."""
    focal_px: float = assumed(970.0, gt=0.0, le=1e6)
    """Focal length in pixels, along x. If neither it nor `field_of_view_deg` is given, it follows
    the image's width: the field of view stays that of the default."""
    field_of_view_deg: float = Field(
        0.0, ge=0.0, exclude=True, json_schema_extra={"input_only": True}
    )
    """Horizontal field of view in place of `focal_px`, for a lens of this model and distortion,
    such as a fisheye: `model = "kannala_brandt"`; 0 if not given."""
    focal_ratio: float = assumed(1.0, gt=0.1, lt=10.0)
    """Focal length along y over that along x; not 1 where pixels are not square."""
    centre_offset_px: tuple[float, float] = assumed((0.0, 0.0))
    """Principal point, right and down from the middle of the image."""
    distortion: tuple[float, ...] = Field((), max_length=8)
    """Coefficients in OpenCV's order. brown_conrady: k1 k2 p1 p2 [k3 [k4 k5 k6]]; kannala_brandt:
    k1 k2 k3 k4; omnidirectional: ξ [k1 k2 p1 p2]."""
    calibration: str = ""
    """File to read the lens from (OpenCV, ROS camera_info or Kalibr YAML), beside this file; its
    numbers take the place of model, size, focal length, centre and distortion."""
    ends: Literal["near", "far", "both"] = "near"
    """Where cameras stand: before the near end, beyond the far one (looking back), or both."""
    stand_off_mm: Annotated[float, Field(ge=-1e6, le=1e6)] | Literal["fit"] = assumed("fit")
    """Distance from the camera's centre to its own rim's plane; `fit` fills the image with it."""
    fill: float = assumed(0.975, gt=0.05, le=1.0)
    """For `fit`: reach of its own rim's inner edge, as a fraction of half the smaller side."""
    f_number: float = assumed(2.8, ge=0.5, le=64.0)
    """Focal length over aperture, for depth of field and blur."""
    pixel_um: float = assumed(1.4, gt=0.0, le=100.0)
    """Width of a pixel on the sensor chip, for depth of field and blur. If neither it nor
    `focal_px` is given, it follows the image's width: the chip keeps its size."""
    focus_mm: float = assumed(0.0, ge=0.0, le=1e6)
    """Distance of sharp focus from the camera; 0 for where near and far markers blur alike."""
    noise_pixel: float = assumed(2.0, ge=0.0, le=128.0)
    """Standard deviation of the sensor noise in grey levels (of 255), for rendered frames."""
    noise_centroid_px: float = assumed(0.04, ge=0.0, le=10.0)
    """Standard deviation of a marker's measured centroid, for simulated measurements."""

    @model_validator(mode="before")
    @classmethod
    def _known_camera(cls, data: Any, info: ValidationInfo) -> Any:
        """Put a preset's and a calibration file's numbers in the place of fields."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        if data.get("model") == "fisheye":
            data["model"] = "kannala_brandt"  # OpenCV's fisheye, by its name in the literature
        known = CAMERA_PRESETS.get(str(data.get("preset")), {})
        if data.get("field_of_view_deg"):
            known = {key: value for key, value in known.items() if key != "focal_px"}
        for key, value in known.items():
            if data.setdefault(key, value) != value and key != "focal_px":
                raise ValueError(
                    f"preset {data['preset']!r} has {key} = {value:g} (got {data[key]!r}); leave "
                    f'{key} out or set preset = "custom"'
                )
        if data.get("calibration"):
            from phytac_design.design.camera_files import calibrated_fields

            folder = (info.context or {}).get("folder", ".")
            lens = "model width_px height_px focal_px focal_ratio centre_offset_px distortion"
            twice = [key for key in (*lens.split(), "field_of_view_deg") if key in data]
            if twice:
                raise ValueError(
                    f"calibration sets {', '.join(twice)} as well (got both); leave out one"
                )
            data |= calibrated_fields(str(data.pop("calibration")), folder)
        return data

    @model_validator(mode="after")
    def _lens_is_possible(self) -> Self:
        try:
            self._resolve_focal_length()
            self.lens()
        except DesignError as error:
            raise ValueError(str(error).removeprefix("camera: ")) from None
        return self

    @model_validator(mode="after")
    def _fits_in_memory(self) -> Self:
        # Larger images need more than 3 GB to be rendered and segmented.
        pixels, pixels_max = self.width_px * self.height_px, 64_000_000
        if pixels > pixels_max:
            raise ValueError(
                f"{self.width_px} x {self.height_px} px are {pixels / 1e6:.0f} megapixels, more "
                f"than {pixels_max / 1e6:.0f}; lower width_px and height_px, or bin the image"
            )
        return self

    def _resolve_focal_length(self) -> None:
        """Replace a field of view, or an image width alone, by focal length and pixel size."""
        given = self.model_fields_set
        if self.field_of_view_deg and "focal_px" in given:
            raise ValueError(
                "field_of_view_deg and focal_px both set the focal length (got "
                f"{self.field_of_view_deg:g}° and {self.focal_px:g} px); leave out one"
            )
        if "focal_px" in given:
            return
        wider = self.width_px / type(self).model_fields["width_px"].default
        focal_px = round(self.focal_px * wider, 3)
        if self.field_of_view_deg:
            focal_px = focal_of_view_px(self._lens(1.0), self.field_of_view_deg)
        pixel_um = self.pixel_um if "pixel_um" in given else round(self.pixel_um / wider, 4)
        # The model is frozen for its users; it is being made here.
        self.__dict__.update(focal_px=focal_px, pixel_um=pixel_um, field_of_view_deg=0.0)

    @property
    def end_numbers(self) -> tuple[int, ...]:
        """Ends with a camera: 0 near, 1 far."""
        return {"near": (0,), "far": (1,), "both": (0, 1)}[self.ends]

    def lens(self) -> Lens:
        """Build the lens that this table describes.

        Raises
        ------
        DesignError
            If its distortion does not suit its model, or folds the image over.
        """
        return self._lens(self.focal_px)

    def _lens(self, focal_px: float) -> Lens:
        return LENSES[self.model](
            width_px=self.width_px,
            height_px=self.height_px,
            fx_px=focal_px,
            fy_px=focal_px * self.focal_ratio,
            cx_px=(self.width_px - 1) / 2.0 + self.centre_offset_px[0],
            cy_px=(self.height_px - 1) / 2.0 + self.centre_offset_px[1],
            distortion=self.distortion,
        )


class LightSection(Section):
    """The light bar on the axis; it can hide markers."""

    bar_radius_mm: float = assumed(3.0, ge=0.0, le=1000.0)
    """Radius of the bar; 0 for none."""
    bar_start_mm: float = assumed(5.0, ge=-1000.0, le=5000.0)
    """Where the bar begins, from the camera's rim inward; it ends at a rim without camera."""


class MaterialSection(Section):
    """The printed resin, to be calibrated on the real sensor (paper, eq. 4)."""

    modulus_MPa: float = assumed(2200.0, ge=1e-3, le=1e6)
    """Young's modulus."""
    poisson: float = assumed(0.38, ge=0.0, lt=0.5)
    """Poisson's ratio."""


class TrainingSection(Section):
    """Simulated contacts that train and judge the decoder."""

    samples: int = Field(598, ge=20, le=100000)
    """Contacts to learn from; split 8.5 : 0.5 : 1 as in the paper."""
    samples_test: int = Field(1000, ge=10, le=100000)
    """Further samples, never trained on, to judge with. A build decodes at most five for each
    of its rendered frames (`--set frames=N`)."""
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


class DemandsSection(Section):
    """What the sensor must do beyond being buildable; a build stops where it does not."""

    clear_force_N: float = Field(0.0, ge=0.0, le=1e4)
    """No marker may hide or fuse under any press up to this force; 0 to report it only."""


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
    paints: PaintsSection = NOMINAL_PAINTS
    reference_marks: ReferenceMarksSection = ReferenceMarksSection()
    switch: SwitchSection = SwitchSection()
    mold: MoldSection = MoldSection()
    strip: StripSection = StripSection()
    bench: BenchSection = BenchSection()
    kit: KitSection = KitSection()
    effort: EffortSection = EffortSection()
    camera: CameraSection = CameraSection()
    light: LightSection = LightSection()
    material: MaterialSection = MaterialSection()
    print_rules: PrintSection = PrintSection()
    hardware: HardwareSection = HardwareSection()
    training: TrainingSection = TrainingSection()
    demands: DemandsSection = DemandsSection()
    regions: tuple[RegionSection, ...] = Field((), max_length=256)
    """Named parts of the surface, such as fingers and a palm, whose forces the decoder reports."""
    fixtures: tuple[AnyFixture, ...] = Field((), max_length=12)
    """Bodies that the camera sees and that can hide markers: `cylinder`, `box` or `mesh` (STL)."""

    @model_validator(mode="before")
    @classmethod
    def _colouring_of_old_files(cls, data: Any) -> Any:
        """Read `effort.colouring` of files from before `receptor.colouring`."""
        effort = data.get("effort") if isinstance(data, dict) else None
        if not isinstance(effort, dict) or "colouring" not in effort:
            return data
        names = {"pens": "paint", "printed": "multi-material"}
        old = effort["colouring"]
        if not isinstance(old, str) or old not in names:
            return data  # refused as an unknown field
        receptor = data.get("receptor", {})
        if isinstance(receptor, dict):
            new = receptor.get("colouring", names[old])
            # Whole files of then, changed now, hold both: the old default says nothing.
            if new != names[old] and old != "pens":
                raise ValueError(
                    f"effort.colouring = {old!r} is the old name of receptor.colouring = "
                    f"{names[old]!r} (got {new!r} there); remove effort.colouring"
                )
            receptor = receptor | {"colouring": new}
        rest = {key: value for key, value in effort.items() if key != "colouring"}
        return data | {"effort": rest, "receptor": receptor}

    @model_validator(mode="after")
    def _switches_have_colour(self) -> Self:
        if self.dots and self.has_switches:
            raise ValueError(
                f"{self.dots} dots are read by brightness, which does not show the "
                "red tips of switches (got receptor.diameter_hole_mm = "
                f"{self.receptor.diameter_hole_mm:g}); set it to 0 for solid posts"
            )
        return self

    @property
    def has_switches(self) -> bool:
        """Whether receptors are tubes with switches, not solid posts."""
        return self.receptor.diameter_hole_mm > 0.0

    @property
    def dots(self) -> str:
        """Colour of dots that are separated from the wall by brightness; "" for coloured paint."""
        return next((name for name in self.layout.colours if name in DOTS), "")

    @property
    def tip_travel_mm(self) -> float:
        """How far red tips of switches that are on stand out of the end faces."""
        out = self.switch.stroke_mm - self.switch.tip_recess_mm
        return max(out, 0.0) if self.has_switches else 0.0

    def surface(self) -> Surface:
        """Build the sensing surface."""
        return self.shape.surface()


__all__ = ["Design", "DesignError", "Section"]
