"""The tables of a scenario file as typed models: units, range and effect of each field."""

import json
from hashlib import sha256
from typing import Annotated, Any, Literal, Self

from pydantic import Field, StrictBool, model_validator

from phytac_design.design.base_table import Section, assumed
from phytac_design.design.toml_files import TomlFileKind

IndenterKind = Literal["flat", "sphere", "cylinder"]
UnitInterval = Annotated[float, Field(ge=0.0, le=1.0)]
SAMPLES_MAX = 100_000
"""Most samples of one scenario."""
FRICTION_MAX = 5.0
"""Most tangential over normal force: rubber on glass reaches 3."""
LENGTH_RADII = 4.0
"""Length of a cylinder's strip over its half-width, where none is given."""


def _check_order(table: Any, *pairs: tuple[str, str]) -> None:
    """Raise ``ValueError`` where a range (names of its ends) has its ends swapped."""
    for low, high in pairs:
        first, last = getattr(table, low), getattr(table, high)
        if first is not None and last is not None and first > last:
            raise ValueError(f"{low} must not exceed {high} (got {first:g} and {last:g})")


class IndenterSection(Section):
    """One kind of indenter, and how often it is taken."""

    kind: IndenterKind = "flat"
    """Pressure: `flat` even over a disc, `sphere` Hertz's over a disc, `cylinder` Hertz's across
    a strip and even along it."""
    share: float = Field(1.0, gt=0.0, le=100.0)
    """Share of contacts with this kind, relative to those of the others."""
    radius_share: float = assumed(1.0, gt=0.0, le=100.0)
    """Factor on the drawn radius; of a cylinder that makes the strip's half-width."""
    length_mm: float | None = Field(None, gt=0.0, le=1e3)
    """Length of a cylinder's strip; absent: four times its half-width."""
    turn_deg: float | None = Field(None, ge=-360.0, le=360.0)
    """A cylinder's axis, from the direction of growing u; absent: any direction."""

    @model_validator(mode="after")
    def _only_strips_are_long(self) -> Self:
        if self.kind != "cylinder" and (self.length_mm is not None or self.turn_deg is not None):
            raise ValueError(
                f"only a cylinder has length_mm and turn_deg (got kind = {self.kind!r}); leave "
                "them out"
            )
        return self


class GivenContact(Section):
    """One contact given by hand.

    Its place is one of: a marker, its row and column, shares of the chart, the point of the
    surface nearest to a point in space.
    """

    sample: int = Field(0, ge=0, lt=SAMPLES_MAX)
    """Sample that it belongs to."""
    marker: int | None = Field(None, ge=0)
    """Id of the receptor in whose middle it presses."""
    row: int | None = Field(None, ge=0)
    """Row of that receptor."""
    column: int | None = Field(None, ge=0)
    """Column of that receptor."""
    along: float | None = Field(None, ge=0.0, le=1.0)
    """Share of the chart along the sensor (u), 0 at the near end."""
    around: float | None = Field(None, ge=0.0, le=1.0)
    """Share of the chart around the sensor (v)."""
    point_mm: tuple[float, float, float] | None = None
    """Point in space; the contact's centre is the nearest point of the outer face."""
    force_N: float = Field(ge=0.0, le=1e4)
    """Inward normal force."""
    radius_mm: float = Field(gt=0.0, le=1e3)
    """Radius of the patch; of a cylinder the half-width of its strip."""
    indenter: IndenterKind = "flat"
    """Kind of indenter, see `[[touch.indenters]]`."""
    length_mm: float | None = Field(None, gt=0.0, le=1e3)
    """Length of a cylinder's strip; absent: four times its half-width."""
    turn_deg: float = Field(0.0, ge=-360.0, le=360.0)
    """A cylinder's axis, from the direction of growing u, right-handed about the outward normal."""
    friction: tuple[float, float] = (0.0, 0.0)
    """Tangential over normal force, in the direction of growing u and square to it."""

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        ways = {
            "marker": (self.marker,),
            "row and column": (self.row, self.column),
            "along and around": (self.along, self.around),
            "point_mm": (self.point_mm,),
        }
        used = [name for name, parts in ways.items() if any(p is not None for p in parts)]
        if len(used) != 1 or any(part is None for part in ways[used[0]]):
            raise ValueError(
                "a contact needs one place: marker, or row and column, or along and around, or "
                f"point_mm (got {', '.join(used) or 'none'}"
                f"{', of which one is missing' if len(used) == 1 else ''})"
            )
        if self.friction[0] ** 2 + self.friction[1] ** 2 > FRICTION_MAX**2:
            raise ValueError(
                f"friction must not exceed {FRICTION_MAX:g} in all (got {list(self.friction)})"
            )
        if self.length_mm is not None and self.indenter != "cylinder":
            raise ValueError(
                f"only a cylinder has length_mm (got indenter = {self.indenter!r}); leave it out"
            )
        return self


class GripperSection(Section):
    """A gripper: fingers in a fixed arrangement, each with a force of its own."""

    fingers: tuple[tuple[int, int], ...] = Field(min_length=2, max_length=50)
    """Rows and columns of each finger's receptor from those of the first finger's."""

    @model_validator(mode="after")
    def _fingers_differ(self) -> Self:
        if len(set(self.fingers)) < len(self.fingers):
            raise ValueError(
                f"two fingers press on one receptor (got {[list(each) for each in self.fingers]})"
            )
        return self


class ContactsSection(Section):
    """Contacts: how many, how strong, how large, where, with which indenters."""

    samples: int | None = Field(None, ge=1, le=SAMPLES_MAX)
    """Samples; absent: the design's training.samples, or as many as `[[touch.at]]` names. Cycles
    count their own."""
    multi_share: float | None = Field(None, ge=0.0, le=1.0)
    """Share of presses with several contacts at once; absent: the design's."""
    most: int = assumed(5, ge=2, le=50)
    """Most contacts of such a press; as many as there is room for, two at least."""
    empty_share: float = Field(0.0, ge=0.0, le=1.0)
    """Share of presses without any contact."""
    force_min_N: float | None = Field(None, gt=0.0, le=1e4)
    """Smallest force of a contact; absent: the design's."""
    force_max_N: float | None = Field(None, gt=0.0, le=1e4)
    """Largest force of a contact (also of a grip's pad); absent: the design's."""
    radius_min_mm: float | None = Field(None, gt=0.0, le=1e3)
    """Smallest radius of a patch; absent: the design's."""
    radius_max_mm: float | None = Field(None, gt=0.0, le=1e3)
    """Largest radius of a patch; absent: the design's."""
    placement: Literal["receptor", "columns", "anywhere", "rims"] = "receptor"
    """`receptor`: on receptors at random; `columns`: column after column and row after row, as
    the rig traverses them; `anywhere`: evenly over the area that senses; `rims`: near open edges.
    """
    columns: tuple[Annotated[int, Field(ge=0)], ...] | None = Field(None, min_length=1)
    """Columns whose receptors are pressed, of `receptor` and `columns`; absent: all. Off a lattice,
    strips along the sensor count as columns."""
    grippers: tuple[GripperSection, ...] = Field((), max_length=20)
    """Grippers that press several receptors at once; absent: contacts are drawn one by one."""
    patch: Literal["range", "switch"] = "range"
    """Sizes of patches: in the `range` of radii, or all as the footprint of a `switch`."""
    jitter_mm: float | None = Field(None, ge=0.0, le=1e3)
    """A receptor is hit within this distance, along and around; absent: 1 mm, a third of the
    smallest radius at most."""
    rim_mm: float = assumed(5.0, gt=0.0, le=1e3)
    """How far from an open edge `rims` presses, at most."""
    along: tuple[UnitInterval, UnitInterval] = (0.0, 1.0)
    """Part of the chart along the sensor (u, shares from the near end) that is touched."""
    around: tuple[UnitInterval, UnitInterval] = (0.0, 1.0)
    """Part around it (v); [0.9, 0.1] runs over the seam of a shape that closes around."""
    indenters: tuple[IndenterSection, ...] = Field(
        (IndenterSection(),), min_length=1, max_length=20
    )
    """Kinds of indenters."""
    friction_min: float = Field(0.0, ge=0.0, le=FRICTION_MAX)
    """Smallest tangential over normal force."""
    friction_max: float = Field(0.0, ge=0.0, le=FRICTION_MAX)
    """Largest tangential over normal force."""
    friction_deg: float | None = Field(None, ge=-360.0, le=360.0)
    """Direction of friction, from that of growing u; absent: any direction."""
    at: tuple[GivenContact, ...] | None = Field(None, max_length=SAMPLES_MAX)
    """Contacts given by hand instead of drawn; [] for none at all."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        _check_order(
            self,
            ("force_min_N", "force_max_N"),
            ("radius_min_mm", "radius_max_mm"),
            ("friction_min", "friction_max"),
        )
        if self.along[0] >= self.along[1]:
            raise ValueError(f"along must grow (got {list(self.along)})")
        if self.around[0] == self.around[1]:
            raise ValueError(f"around must not be empty (got {list(self.around)})")
        if self.placement in {"anywhere", "rims"} and (self.columns or self.grippers):
            raise ValueError(
                "columns and grippers go with placement = 'receptor' or 'columns' (got "
                f"{self.placement!r})"
            )
        return self


class PadSection(Section):
    """One pad of a hand."""

    along: float = Field(ge=0.0, le=1.0)
    """Place along the sensor (share of u) when the hand is in the middle."""
    around: float = Field(ge=0.0, le=1.0)
    """Place around it (share of v)."""
    share: float = Field(1.0, gt=0.0, le=100.0)
    """Its part of the grip's force, relative to those of the other pads."""


DEFAULT_PADS: tuple[PadSection, ...] = (
    PadSection(along=0.42, around=0.06, share=1.5),  # thumb
    PadSection(along=0.20, around=0.62, share=1.3),  # tips of the four fingers
    PadSection(along=0.40, around=0.60, share=1.3),
    PadSection(along=0.60, around=0.61, share=1.1),
    PadSection(along=0.80, around=0.64, share=0.8),
    PadSection(along=0.20, around=0.40, share=0.7),  # their middle phalanges
    PadSection(along=0.40, around=0.38, share=0.7),
    PadSection(along=0.60, around=0.39, share=0.6),
    PadSection(along=0.80, around=0.42, share=0.5),
)
"""Nine pads as on the paper's glove (nine sensors over five fingers); places are assumed."""


class GripSection(Section):
    """A hand of fixed pads, closed around the sensor again and again."""

    pads: tuple[PadSection, ...] = Field(DEFAULT_PADS, min_length=1, max_length=50)
    """The pads; absent: a thumb, four fingertips and four middle phalanges."""
    total_min_N: float | None = Field(None, gt=0.0, le=1e5)
    """Smallest sum of the pads' forces; absent: the smallest force of a contact for every pad."""
    total_max_N: float | None = Field(None, gt=0.0, le=1e5)
    """Largest sum of the pads' forces; absent: 98 % of the largest force of a contact for every
    pad."""
    scatter: float = assumed(0.3, ge=0.0, le=1.0)
    """Standard deviation of the logarithm of a pad's part from one grip to the next."""
    levels: int = assumed(5, ge=1, le=1000)
    """Samples of one grip: forces change, places do not."""
    turn: Literal["any", "none"] = "any"
    """Whether the hand comes from any direction around, or always from the same."""
    flip: Literal["any", "none"] = "any"
    """Whether the hand also comes with near and far end swapped."""
    shift: float = assumed(0.1, ge=0.0, le=0.5)
    """Largest move of the hand along the sensor, share of u."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        _check_order(self, ("total_min_N", "total_max_N"))
        return self


class CycleSection(Section):
    """One press, again and again."""

    count: int = Field(1000, ge=1, le=100_000)
    """How often it is pressed."""
    every: int = Field(37, ge=1, le=100_000)
    """Cycles 0, every, 2·every … are sampled."""
    phases: tuple[Annotated[float, Field(ge=0.0, le=4.0)], ...] = Field(
        (0.5, 1.0, 2.0, 2.5, 4.0), min_length=1, max_length=1000
    )
    """When: 0 to 1 on the way up, 1 to 2 while held, 2 to 3 on the way down, 3 to 4 at rest."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if any(b <= a for a, b in zip(self.phases, self.phases[1:], strict=False)):
            raise ValueError(f"phases must grow (got {list(self.phases)})")
        sampled = -(-self.count // self.every) * len(self.phases)
        if sampled > SAMPLES_MAX:
            raise ValueError(
                f"{sampled} samples are more than {SAMPLES_MAX}; raise every (got {self.every})"
            )
        return self


class TimeSection(Section):
    """Timing of a press, and how the wall creeps."""

    ramp_s: float = assumed(0.5, gt=0.0, le=1e6)
    """From no force to the full one, or from one level of a grip to the next."""
    hold_s: float = assumed(1.0, ge=0.0, le=1e6)
    """Held so long; presses and grips are sampled at its end."""
    release_s: float = assumed(0.5, gt=0.0, le=1e6)
    """Back to no force."""
    rest_s: float = assumed(1.0, ge=0.0, le=1e6)
    """Rest before the next press. Cycles remember what was before it, presses elsewhere do not."""
    control: Literal["force", "displacement"] = "force"
    """What is held: the force (the wall creeps) or the depth (the force relaxes)."""
    relax_share: tuple[Annotated[float, Field(gt=0.0, lt=1.0)], ...] = Field(
        (), max_length=20, json_schema_extra={"assumption": True}
    )
    """Prony series of the wall's relaxation: shares gᵢ of the modulus that fade, less than 1
    together; empty for an elastic wall. No data of the resin is known: any value is assumed."""
    relax_s: tuple[Annotated[float, Field(gt=0.0, le=1e9)], ...] = Field((), max_length=20)
    """Their times τᵢ."""

    @model_validator(mode="after")
    def _series(self) -> Self:
        if len(self.relax_share) != len(self.relax_s):
            raise ValueError(
                "relax_share and relax_s must be equally long (got "
                f"{len(self.relax_share)} and {len(self.relax_s)})"
            )
        if sum(self.relax_share) >= 1.0:
            raise ValueError(
                f"relax_share must sum to less than 1 (got {sum(self.relax_share):g}): nothing "
                "would hold the wall in the long run"
            )
        if len(set(self.relax_s)) < len(self.relax_s):
            raise ValueError(f"relax_s must differ from each other (got {list(self.relax_s)})")
        return self


class LightDriftSection(Section):
    """How the light drifts."""

    drift_share: float = Field(0.0, gt=-1.0, lt=1.0)
    """Part of the brightness that is lost in the end (gained, if negative)."""
    drift_time_s: float = assumed(600.0, gt=0.0, le=1e9)
    """Time constant of the exponential drift."""


class SensorInstanceSection(Section):
    """Which printed sensor, and how prints scatter. Standard deviations, cut at three of them."""

    number: int = Field(0, ge=0, le=1_000_000)
    """0: the design itself, without scatter; k: the k-th virtual print."""
    thickness_share: float = assumed(0.03, ge=0.0, le=0.15)
    """Thickness of the whole wall, relative."""
    thickness_wave_share: float = assumed(0.03, ge=0.0, le=0.15)
    """Thickness from place to place, relative, as long waves."""
    modulus_share: float = assumed(0.05, ge=0.0, le=0.3)
    """Young's modulus of the wall, relative."""
    marker_mm: float = assumed(0.05, ge=0.0, le=10.0)
    """Place of each receptor along and around the wall."""
    height_mm: float = assumed(0.05, ge=0.0, le=10.0)
    """Height of each receptor."""
    threshold_share: float = assumed(0.1, ge=0.0, le=0.3)
    """Threshold of each switch, relative."""
    release_share: float | None = Field(None, ge=0.0, lt=1.0)
    """Release force over threshold; absent: the design's release_N over its threshold_N."""
    release_scatter: float = assumed(0.05, ge=0.0, le=0.3)
    """Scatter of that ratio from switch to switch, relative."""
    camera_mm: float = assumed(0.1, ge=0.0, le=10.0)
    """Place of the camera, along each axis."""
    camera_deg: float = assumed(0.2, ge=0.0, le=10.0)
    """Direction of the camera, about each axis."""
    focal_share: float = assumed(0.003, ge=0.0, le=0.1)
    """Focal length, relative."""
    paint_share: float = assumed(0.05, ge=0.0, le=0.3)
    """Red, green and blue that each paint reflects, relative."""


class ImagingSection(Section):
    """How frames are exposed."""

    lens_blur: StrictBool = True
    """Blur of the true lens (focus and aperture of the design)."""
    fall_off: StrictBool = True
    """Light falls off along the bar and with the distance from it."""
    vignetting: float = assumed(0.1, ge=0.0, le=1.0)
    """Share of the light that is missing in the image's corner."""
    full_well_e: float = assumed(10000.0, ge=10.0, le=1e7)
    """Electrons of a white pixel; sets the shot noise."""
    read_noise_e: float = assumed(3.0, ge=0.0, le=1e5)
    """Standard deviation of the read noise, electrons."""
    noise_pixel: float | None = Field(None, ge=0.0, le=100.0)
    """Noise of a mid-grey pixel, grey levels, to which shot noise is scaled; absent: the design's
    camera.noise_pixel."""
    jpeg_quality: int = Field(0, ge=0, le=100)
    """Quality of JPEG compression; 0 for none."""


class SolveSection(Section):
    """How the shell is solved, and what is seen of it."""

    displacement: Literal["auto", "linear", "large"] = "auto"
    """`linear` superposition, `large` displacement, or whichever `tolerance` asks for, sample by
    sample."""
    tolerance: float = Field(0.01, gt=0.0, le=1.0)
    """Error that `auto` may leave, share of the largest displacement."""
    route: Literal["points", "frames"] = "points"
    """`points`: projected paint with the centroid's noise; `frames`: rendered images, tracked."""
    centroids: Literal["paint", "pixels"] = "paint"
    """Of `points`: of the `paint` that faces the camera, or of the `pixels` that show it, less what
    neighbours hide when pressed (3 times slower)."""
    samples_per_pixel: int = Field(89, ge=1, le=216)
    """Of `frames`: samples of a pixel on or near an edge, each through its own point of the
    aperture. Other pixels take one, or four from 64 on."""
    local: StrictBool = True
    """Whether only the touched part of the wall is modelled finely."""


class Scenario(Section):
    """One scenario. Lengths in mm, forces in N, times in s, angles in degrees (here only)."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")
    """Name of the scenario; letters, digits, '_', '-', '.'."""
    description: str = Field("", max_length=2000)
    """What it is, for the dataset."""
    kind: Literal["presses", "grips", "cycles"] = "presses"
    """`presses`: samples independent of each other; `grips`: a hand of several pads; `cycles`:
    one press, again and again."""
    touch: ContactsSection = ContactsSection()
    grip: GripSection | None = None
    """For kind `grips` only."""
    cycle: CycleSection | None = None
    """For kind `cycles` only."""
    time: TimeSection = TimeSection()
    light: LightDriftSection = LightDriftSection()
    unit: SensorInstanceSection = SensorInstanceSection()
    imaging: ImagingSection = ImagingSection()
    solve: SolveSection = SolveSection()

    @model_validator(mode="before")
    @classmethod
    def _own_table(cls, data: Any) -> Any:
        """Give grips and cycles their table, and only them; know a table by its former name."""
        if not isinstance(data, dict):
            return data
        data, kind = dict(data), data.get("kind", "presses")
        if "eyes" in data and "imaging" not in data:
            data["imaging"] = data.pop("eyes")  # its former name
        for owner, table in (("grips", "grip"), ("cycles", "cycle")):
            if kind == owner and data.get(table) is None:
                data[table] = {}
            if kind != owner and data.get(table) is not None:
                raise ValueError(
                    f"[{table}] goes with kind = {owner!r} (got kind = {kind!r}); set kind, or "
                    "leave the table out"
                )
        return data

    @model_validator(mode="after")
    def _touches_of_kind(self) -> Self:
        at = self.touch.at
        if self.kind == "grips" and at is not None:
            raise ValueError("[[touch.at]] does not go with kind = 'grips'; give [[grip.pads]]")
        if self.kind == "cycles":
            if self.touch.samples is not None:
                raise ValueError(
                    "touch.samples does not go with kind = 'cycles'; set cycle.count, cycle.every "
                    "and cycle.phases"
                )
            late = [item.sample for item in at or () if item.sample > 0]
            if late:
                raise ValueError(
                    f"contacts of cycles are pressed together, as sample 0 (got {late[0]}); leave "
                    "sample out"
                )
        if self.kind == "presses" and at and self.touch.samples is not None:
            last = max(item.sample for item in at)
            if last >= self.touch.samples:
                raise ValueError(
                    f"[[touch.at]] names sample {last}, touch.samples = {self.touch.samples} ends "
                    f"before; raise it to {last + 1} or leave it out"
                )
        return self


SCENARIO_FILES = TomlFileKind(
    noun="scenario", folder="scenarios", missing="see docs/scenarios.md for what it means"
)


def shipped_scenarios() -> list[str]:
    """Names of the scenarios that come with the package."""
    return SCENARIO_FILES.shipped()


def load_scenario(name_or_path: str) -> Scenario:
    """Read a shipped scenario by name, or any scenario file by path.

    Raises
    ------
    DesignError
        If there is no such scenario, it is not TOML, or a key or value is not acceptable.
    """
    return parse_scenario(*SCENARIO_FILES.read(name_or_path))


def parse_scenario(data: dict[str, Any], where: str) -> Scenario:
    """Validate a parsed scenario file; the error lists every problem.

    Raises
    ------
    DesignError
        With every unknown key and every invalid value.
    """
    return SCENARIO_FILES.validate(Scenario, data, f"scenario {where}")


def scenario_hash(scenario: Scenario) -> str:
    """Hash of the resolved scenario, the same for the same fields in any order."""
    text = json.dumps(scenario.model_dump(mode="json"), sort_keys=True)
    return sha256(text.encode()).hexdigest()
