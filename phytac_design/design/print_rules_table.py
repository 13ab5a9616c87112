"""The table ``[print_rules]`` of a design file: what the printer can make."""

from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from pydantic import model_validator

from phytac_design.design.base_table import Section, assumed, with_preset

PROCESSES: dict[str, dict[str, Any]] = {
    "sla": {
        "wall_min_mm": 0.4,
        "wall_free_min_mm": 0.6,
        "hole_min_mm": 0.5,
        "gap_min_mm": 0.3,
        "drain_min_mm": 3.5,
        "clearance_mm": 0.4,
        "emboss_min_mm": 0.1,
        "engrave_min_mm": 0.4,
        "post_short_mm": (0.3, 7.0),
        "post_tall_mm": (1.5, 30.0),
        "overhang_deg": 19.0,
        "accuracy_mm": 0.15,
        "bed_mm": (145.0, 145.0, 175.0),
    },
    "polyjet": {
        "wall_min_mm": 0.6,
        "wall_free_min_mm": 1.0,
        "hole_min_mm": 1.0,
        "gap_min_mm": 0.4,
        "drain_min_mm": 5.0,
        "clearance_mm": 0.4,
        "emboss_min_mm": 0.5,
        "engrave_min_mm": 0.5,
        "post_short_mm": (1.0, 7.0),
        "post_tall_mm": (2.0, 30.0),
        "overhang_deg": 0.0,
        "accuracy_mm": 0.13,
        "bed_mm": (294.0, 192.0, 148.0),
    },
    "fdm": {
        "wall_min_mm": 0.8,
        "wall_free_min_mm": 0.8,
        "hole_min_mm": 2.0,
        "gap_min_mm": 0.5,
        "drain_min_mm": 0.0,
        "clearance_mm": 0.5,
        "emboss_min_mm": 0.6,
        "engrave_min_mm": 0.6,
        "post_short_mm": (3.0, 15.0),
        "post_tall_mm": (5.0, 50.0),
        "overhang_deg": 45.0,
        "accuracy_mm": 0.5,
        "bed_mm": (220.0, 220.0, 250.0),
    },
}
"""Numbers of each process, from makers' design guides; all may be set apart in the design."""

if TYPE_CHECKING:
    Process = str
else:
    Process = Literal[tuple(PROCESSES)]


class PrintSection(Section):
    """Rules of the printer: a process sets all numbers that are not given."""

    process: Process = assumed("sla")
    """How the part is printed: vat of resin, jetted resin, or molten filament."""
    wall_min_mm: float = assumed(0.4, ge=0.0, le=100.0)
    """Thinnest supported wall: held at two edges or more."""
    wall_free_min_mm: float = assumed(0.6, ge=0.0, le=100.0)
    """Thinnest unsupported wall: held at fewer than two edges."""
    hole_min_mm: float = assumed(0.5, ge=0.0, le=100.0)
    """Smallest hole that stays open."""
    gap_min_mm: float = assumed(0.3, ge=0.0, le=100.0)
    """Smallest gap between two receptors or other features."""
    drain_min_mm: float = assumed(3.5, ge=0.0, le=100.0)
    """Smallest opening through which a hollow drains; 0 where nothing needs to drain."""
    clearance_mm: float = assumed(0.4, ge=0.0, le=10.0)
    """Gap, on each side, between printed parts that go together by hand."""
    emboss_min_mm: float = assumed(0.1, ge=0.0, le=10.0)
    """Least width and height of raised details."""
    engrave_min_mm: float = assumed(0.4, ge=0.0, le=10.0)
    """Least width and depth of sunken details."""
    post_short_mm: tuple[float, float] = assumed((0.3, 7.0))
    """Thinnest post, and the height up to which it may be that thin."""
    post_tall_mm: tuple[float, float] = assumed((1.5, 30.0))
    """Diameter that a taller post needs, and its height; straight in between, level beyond."""
    overhang_deg: float = assumed(19.0, ge=0.0, lt=90.0)
    """Slope from level below which a face that looks down needs supports."""
    supports: Literal["allowed", "none"] = assumed("allowed")
    """`allowed`: faces that need supports are listed; `none`: they are violations."""
    accuracy_mm: float = assumed(0.15, ge=0.0, le=10.0)
    """± of a printed length."""
    bed_mm: tuple[float, float, float] = assumed((145.0, 145.0, 175.0))
    """Largest part: along x and y of the bed, and its height."""
    build_direction: Literal["suggested"] | tuple[float, float, float] = assumed("suggested")
    """Direction in the sensor's frame that points up off the bed; `suggested` looks for one."""

    @model_validator(mode="before")
    @classmethod
    def _known_process(cls, data: Any) -> Any:
        """Put the process's numbers in the place of fields that are not given."""
        return with_preset(data, PROCESSES, "process", "sla")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        for name in ("post_short_mm", "post_tall_mm", "bed_mm"):
            if min(getattr(self, name)) <= 0.0:
                raise ValueError(f"{name} must be positive (got {list(getattr(self, name))})")
        short, tall = self.post_short_mm, self.post_tall_mm
        if tall[1] <= short[1] or tall[0] < short[0]:
            raise ValueError(
                "post_tall_mm must be higher than post_short_mm and not thinner "
                f"(got {list(tall)} and {list(short)})"
            )
        up = self.build_direction
        if up != "suggested" and not np.linalg.norm(np.asarray(up)) > 0.0:
            raise ValueError("build_direction must not be zero; give a direction or `suggested`")
        return self

    def post_diameter_mm(self, height_mm: float) -> float:
        """Thinnest post of a height; a post as thick as the tall one may be of any height."""
        (thin, low), (thick, high) = self.post_short_mm, self.post_tall_mm
        share = min(1.0, max(0.0, (height_mm - low) / (high - low)))
        return thin + share * (thick - thin)
