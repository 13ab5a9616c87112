"""The table ``[hardware]`` of a design file: camera board, screws and fits of the printed parts."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from phytac_design.design.base_table import Section, assumed, with_preset

Coordinate = Annotated[float, Field(ge=-500.0, le=500.0)]
Size = Annotated[float, Field(gt=0.0, le=500.0)]
ScrewName = Literal["M2", "M2.5", "M3", "M4", "M5", "M6"]

BOARDS: dict[str, dict[str, Any]] = {
    "38x38": {
        "board_size_mm": (38.0, 38.0),
        "board_holes_mm": ((17.0, 17.0), (-17.0, 17.0), (-17.0, -17.0), (17.0, -17.0)),
    },
    "32x32": {
        "board_size_mm": (32.0, 32.0),
        "board_holes_mm": ((14.0, 14.0), (-14.0, 14.0), (-14.0, -14.0), (14.0, -14.0)),
    },
    "raspberry-pi-v2": {
        "board_size_mm": (25.0, 23.862),
        "board_offset_mm": (0.0, 2.431),
        "board_thickness_mm": 1.0,
        "board_holes_mm": ((10.5, 0.0), (-10.5, 0.0), (-10.5, 12.5), (10.5, 12.5)),
        "lens_diameter_mm": 7.5,
        "lens_length_mm": 8.0,
        "lens_pupil_mm": 0.5,
        "front_room_mm": 2.0,
    },
}
"""Boards of USB camera modules with an M12 lens, and of the Raspberry Pi camera 2. Sizes and holes
of the two square ones are what most sellers state; depths and lenses are assumed: measure yours."""


class HardwareSection(Section):
    """Camera mount and cover, light bar, connector or frame, and their screws."""

    parts: Literal["all", "none"] = "all"
    """`none` leaves all hardware out."""
    board: Literal["38x38", "32x32", "raspberry-pi-v2", "custom"] = assumed("38x38")
    """Camera board: sets the board's fields that are not given."""
    board_size_mm: tuple[Size, Size] = assumed((38.0, 38.0))
    """Width and height of the camera board."""
    board_offset_mm: tuple[Coordinate, Coordinate] = assumed((0.0, 0.0))
    """Middle of the board from the lens's axis."""
    board_thickness_mm: float = assumed(1.6, gt=0.0, le=20.0)
    """Thickness of the board."""
    board_holes_mm: tuple[tuple[Coordinate, Coordinate], ...] = Field(
        BOARDS["38x38"]["board_holes_mm"],
        min_length=2,
        max_length=12,
        json_schema_extra={"assumption": True},
    )
    """Middles of the board's holes from the lens's axis."""
    lens_diameter_mm: float = assumed(16.0, gt=0.0, le=200.0)
    """Diameter of the lens with its holder."""
    lens_length_mm: float = assumed(20.0, gt=0.0, le=300.0)
    """From the board's front to the lens's front."""
    lens_pupil_mm: float = assumed(3.0, ge=0.0, le=300.0)
    """How far the camera's centre lies behind the lens's front."""
    front_room_mm: float = assumed(3.0, ge=0.5, le=50.0)
    """Room for parts on the board's front."""
    back_room_mm: float = assumed(6.0, ge=0.0, le=100.0)
    """Room for parts and plug on the board's back."""
    cable_mm: tuple[Size, Size] = assumed((9.0, 4.0))
    """Width and height of the cable's opening in the cover; the height is along the axis."""
    wall_mm: float = assumed(3.0, ge=0.5, le=50.0)
    """Wall of mounts, covers, connectors and frames."""
    screw_camera: ScrewName = assumed("M2")
    """Screws through cover and board into the mount."""
    screw_clamp: ScrewName = assumed("M2.5")
    """Set screws that hold a rim in its socket, and the screws of a sheet's frame."""
    screw_bar: ScrewName = assumed("M2")
    """Screws of the light bar's foot."""
    clamps: int = Field(4, ge=3, le=12, json_schema_extra={"assumption": True})
    """Set screws around each rim; screws of a frame lie in its corners and half-way."""
    thread: Literal["tapped", "heat-set"] = assumed("tapped")
    """How screws hold in printed parts: a tapped hole (resin), or a heat-set insert (filament)."""
    strip_thickness_mm: float = assumed(1.2, gt=0.0, le=20.0)
    """Thickness of the light strips on the bar or of the light ring in the mount."""
    ring_width_mm: float = assumed(5.0, gt=0.0, le=50.0)
    """Width of the light ring around the lens, where there is no bar."""
    imu: Literal["none", "seat"] = "none"
    """`seat` adds a tray for an inertial sensor on the camera's cover."""
    imu_size_mm: tuple[Size, Size, Size] = assumed((20.0, 15.0, 4.0))
    """Width, height and depth of the inertial sensor's board."""
    adapter: Literal["none", "handle"] = "none"
    """`handle` adds a socket on the connector, for a racket's or a robot's shaft."""
    adapter_diameter_mm: float = assumed(30.0, gt=0.0, le=300.0)
    """Diameter of that shaft."""
    adapter_depth_mm: float = assumed(25.0, gt=0.0, le=300.0)
    """How far it goes in."""

    @model_validator(mode="before")
    @classmethod
    def _known_board(cls, data: Any) -> Any:
        """Put a preset's numbers in the place of fields that are not given."""
        return with_preset(data, BOARDS, "board", "38x38")

    @model_validator(mode="after")
    def _holes_on_board(self) -> Self:
        for x, y in self.board_holes_mm:
            inside = all(
                abs(place - middle) < size / 2.0
                for place, middle, size in zip(
                    (x, y), self.board_offset_mm, self.board_size_mm, strict=True
                )
            )
            if not inside:
                raise ValueError(
                    f"the hole of board_holes_mm at ({x:g}, {y:g}) does not lie on the board of "
                    f"{self.board_size_mm[0]:g} x {self.board_size_mm[1]:g} mm; correct "
                    "board_size_mm, board_offset_mm or the hole"
                )
        if self.lens_pupil_mm >= self.lens_length_mm:
            raise ValueError(
                f"lens_pupil_mm must be less than lens_length_mm (got {self.lens_pupil_mm:g} and "
                f"{self.lens_length_mm:g}): the camera's centre lies inside the lens"
            )
        return self
