"""One sensor: a design with everything that follows from it alone, computed once."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import shell_mesh
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.mark_placement import PlacedMarks, place_reference_marks
from phytac_design.layout.marker_layout import make_markers
from phytac_design.layout.markers import Markers
from phytac_shapes import Surface


@dataclass(frozen=True)
class Sensor:
    """A design, its surface, markers and cameras.

    Everything but the design is made at its first use and kept; none of it may be changed.

    Attributes
    ----------
    design : Design
        The resolved design.
    """

    design: Design

    @classmethod
    def of(cls, design: Design, surface: Surface, markers: Markers) -> Self:
        """Sensor whose surface and markers are at hand, or differ from the design's."""
        sensor = cls(design)
        sensor.__dict__.update(surface=surface, markers=markers)
        return sensor

    @cached_property
    def surface(self) -> Surface:
        """The sensing surface."""
        return self.design.surface()

    @cached_property
    def markers(self) -> Markers:
        """The markers on it."""
        return make_markers(self.design, self.surface)

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """Cameras on the axis, the near one first; see :func:`cameras_of` for what it raises."""
        return cameras_of(self.design, self.surface)

    @cached_property
    def reference_marks(self) -> PlacedMarks:
        """Dots on the clamped rims; see :func:`place_reference_marks` for what it raises."""
        return place_reference_marks(self.design, self.surface)

    def envelope(self, tolerance_mm: float) -> TriangleMesh:
        """Inner face of the wall and rims, facets within a tolerance of the true faces."""
        return shell_mesh(self.design, self.surface, tolerance_mm=tolerance_mm)
