"""The tables ``[layout]`` and ``[receptor]`` of a design file."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, model_validator

from phytac_design.design.base_table import Section, assumed, with_file
from phytac_design.design.positions import read_positions

ColourName = Literal["blue", "green", "yellow", "magenta", "cyan", "white", "black"]


class ReferenceMarksSection(Section):
    """Dots painted on the clamped rims, which show motion of the camera and turn of the shell."""

    count: int = Field(0, ge=0, le=64)
    """Dots around each rim, in the layout's first colour, evenly spaced but for dot 0, which
    stands half a step aside; 0 for none, else at least 6."""
    ends: Literal["near", "far", "both"] = "near"
    """Rims that carry them; those of a sheet or dome have one end, the near one."""
    diameter_mm: float = assumed(1.2, gt=0.0, le=100.0)
    """Diameter of a dot. Dots stand in two rows beside the wall, alternately."""
    gap_mm: float = assumed(0.25, ge=0.0, le=100.0)
    """From the end of the sensing surface to the nearer row; keeps brush strokes off the wall."""

    @model_validator(mode="after")
    def _enough(self) -> Self:
        if 0 < self.count < 6:
            raise ValueError(
                f"count must be 0 or at least 6 (got {self.count}): fewer dots do not determine "
                "the motion of a camera"
            )
        return self

    @property
    def end_numbers(self) -> tuple[int, ...]:
        """Rims that carry dots: 0 near, 1 far; none without dots."""
        return {"near": (0,), "far": (1,), "both": (0, 1)}[self.ends] if self.count else ()

    @property
    def rows_mm(self) -> tuple[float, float]:
        """Distances of the two rows of dots from the end of the sensing surface."""
        first = self.gap_mm + self.diameter_mm / 2.0
        return first, first + self.diameter_mm

    @property
    def reach_mm(self) -> float:
        """Length of rim that the dots need."""
        return self.rows_mm[1] + self.diameter_mm / 2.0


class LayoutSection(Section):
    """Markers on the surface, and how tall their receptors are."""

    kind: Literal["spiral", "straight", "phyllotaxis", "explicit"] = "spiral"
    """`spiral` turns each row against the one before; `straight` lines rows up; `phyllotaxis`
    spreads `count` markers by the golden angle over equal areas; `explicit` takes `positions`."""
    rows: int = Field(23, ge=1, le=2000)
    """Markers along the sensor; row 0 is nearest the camera (`spiral`, `straight`)."""
    columns: int = Field(16, ge=1, le=2000)
    """Markers around the sensor; towards a pole rows hold fewer (`spiral`, `straight`)."""
    count: int = Field(200, ge=1, le=50000)
    """Markers in all (`phyllotaxis`)."""
    spiral_angle_deg: float = Field(50.5, gt=-89.0, lt=89.0)
    """Angle α of a spiral; from the axis each row shifts by row pitch · tan α."""
    spiral_from: Literal["axis", "circumference"] = assumed("axis")
    """What α is measured from; from the circumference each row shifts by row pitch / tan α."""
    row_pitch_exponent: float = Field(1.0, ge=0.2, le=5.0)
    """Distance along the surface grows as (row number)^exponent; above 1 rows widen away."""
    colours: tuple[ColourName, ...] = Field(("blue", "green"), min_length=1, max_length=16)
    """Paints of the columns, repeated around; without columns, neighbours differ where they can.
    `white` alone: dots on black resin, `black` alone: dots on light resin, both separated from the
    wall by brightness, without switches (`receptor.diameter_hole_mm = 0`)."""
    colour_pattern: Literal["columns", "checkerboard"] = "columns"
    """`columns` paints a column in one colour; `checkerboard` moves on by one colour a row."""
    heights: Literal["linear", "constant", "power", "line-of-sight"] = "linear"
    """Profile from near to far: `linear`; `constant` (the near height); `power`, with
    `height_exponent`; `line-of-sight`, the least at which none hides another from the camera."""
    height_near_mm: float = Field(0.5, gt=0.0, le=1000.0)
    """Receptor height in the row nearest the camera, from the inner face of the wall."""
    height_far_mm: float = Field(11.5, gt=0.0, le=1000.0)
    """Receptor height in the farthest row; for `line-of-sight` the most that is allowed."""
    height_exponent: float = Field(3.0, ge=0.2, le=10.0)
    """Exponent of the `power` profile; above 1 near rows stay short."""
    sight_margin_mm: float = assumed(0.15, ge=0.0, le=100.0)
    """For `line-of-sight`: clear space that the camera sees beside each painted band."""
    sight_dent_mm: float = assumed(0.0, ge=0.0, le=100.0)
    """For `line-of-sight`: keep that space also while the wall is pressed in by this much anywhere
    (the report says how far a force presses it); 0 for at rest only."""
    sight_dent_radius_mm: float = assumed(10.0, gt=0.0, le=1000.0)
    """Radius of those dents: at this distance a seventh of their depth is left."""
    positions_csv: str = ""
    """CSV file of positions for `explicit`, relative to the design file; read in its place."""
    positions: tuple[tuple[float, ...], ...] = Field((), max_length=50000)
    """Positions for `explicit`: all (u, v) in the chart, or all (x, y, z) in mm."""
    position_colours: tuple[ColourName, ...] = ()
    """Paint of each position; empty for `colours` in turn."""
    position_heights_mm: tuple[Annotated[float, Field(gt=0.0, le=1000.0)], ...] = ()
    """Receptor height of each position; empty for the profile of `heights`."""

    @model_validator(mode="before")
    @classmethod
    def _read_positions(cls, data: Any, info: ValidationInfo) -> Any:
        return with_file(data, info, "positions_csv", "positions", read_positions)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.kind == "explicit") != bool(self.positions):
            raise ValueError(
                "kind 'explicit' needs positions (or positions_csv)"
                if self.kind == "explicit"
                else f"positions are for kind 'explicit' only (kind is {self.kind!r}); set it or "
                "remove them"
            )
        sizes = {len(row) for row in self.positions}
        if len(sizes) > 1 or not sizes <= {2, 3}:
            raise ValueError(
                f"positions must be all (u, v) or all (x, y, z) (got {sorted(sizes)} numbers)"
            )
        for name in ("position_colours", "position_heights_mm"):
            if len(getattr(self, name)) not in {0, len(self.positions)}:
                raise ValueError(
                    f"{name} must have one entry for each of {len(self.positions)} positions "
                    f"(got {len(getattr(self, name))})"
                )
        dots = sorted({"white", "black"} & set(self.colours))
        if dots and set(self.colours) != {dots[0]}:
            raise ValueError(
                f"{dots[0]} dots are separated from the wall by brightness and cannot be mixed "
                f"with other colours (got {', '.join(self.colours)}); use {dots[0]} alone"
            )
        unknown = sorted(set(self.position_colours) - set(self.colours))
        if unknown:
            raise ValueError(f"position_colours {', '.join(unknown)} must be among colours")
        return self

    @property
    def wanted(self) -> int:
        """Number of markers before any are left out."""
        if self.kind == "phyllotaxis":
            return self.count
        return len(self.positions) if self.kind == "explicit" else self.rows * self.columns


class ReceptorSection(Section):
    """The printed tube that carries a marker."""

    colouring: Literal["paint", "insert", "multi-material"] = "paint"
    """How markers get their colour: `paint`: by pen, inside the shell; `insert`: coloured sleeves,
    printed apart and pushed in from outside; `multi-material`: the shell is printed in colours."""
    diameter_outer_mm: float = assumed(3.0, gt=0.0, le=200.0)
    """Outer diameter of the marker: of the tube, or of the insert, whose tube is wider."""
    diameter_hole_mm: float = assumed(1.6, ge=0.0, le=200.0)
    """Through-hole for the stem of the switch, from the outer face to the end face; 0 for solid
    posts without switches: contacts are then found by the markers' motion alone."""
    band_marker_mm: float = assumed(1.0, ge=0.0, le=200.0)
    """Coloured length of the side below the end face; the end face is always coloured."""
    gap_insert_mm: float = assumed(0.15, gt=0.0, le=10.0)
    """For `insert`: free gap on each side between insert and tube; a printer's accuracy or more."""
    ledge_insert_mm: float = assumed(0.25, gt=0.0, le=10.0)
    """For `insert`: how far its head is wider than the tube's bore, on each side."""
    thickness_tube_mm: float = assumed(0.4, gt=0.0, le=100.0)
    """For `insert`: wall of the printed tube around it."""
    direction: Literal["normal", "axis", "tilted"] = assumed("normal")
    """Where tubes point: square to the wall, straight to the sensor's axis, or `tilted`."""
    tilt_deg: float = Field(0.0, gt=-60.0, lt=60.0)
    """For `tilted`: lean from the wall's normal towards the near end, where the camera is."""

    @property
    def has_inserts(self) -> bool:
        """Whether markers are inserts in wider tubes."""
        return self.colouring == "insert"

    @property
    def diameter_bore_mm(self) -> float:
        """Diameter of the hole that is printed in the shell."""
        if not self.has_inserts:
            return self.diameter_hole_mm
        return self.diameter_outer_mm + 2.0 * self.gap_insert_mm

    @property
    def diameter_tube_mm(self) -> float:
        """Outer diameter of the tube that is printed with the shell."""
        if not self.has_inserts:
            return self.diameter_outer_mm
        return self.diameter_bore_mm + 2.0 * self.thickness_tube_mm

    @property
    def diameter_head_mm(self) -> float:
        """Diameter of an insert's head."""
        return self.diameter_bore_mm + 2.0 * self.ledge_insert_mm

    @property
    def diameter_cover_mm(self) -> float:
        """Diameter of what is open or glued in the outer face, which a switch's bowl covers."""
        return self.diameter_seat_mm if self.has_inserts else self.diameter_hole_mm

    @property
    def diameter_seat_mm(self) -> float:
        """Diameter of the seat's cone of 45 degrees on the outer face."""
        return self.diameter_head_mm + 2.0 * self.gap_insert_mm

    @property
    def depth_seat_mm(self) -> float:
        """From the outer face to where the seat's cone ends in the bore."""
        return self.ledge_insert_mm + self.gap_insert_mm
