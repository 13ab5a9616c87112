"""One design of a study, with what several rungs need of it, each made once."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.cameras import cameras_of, tolerance_mm
from phytac_design.optics.scene import Scene, build_scene
from phytac_design.optics.visibility import Visibility, best_of, check_visibility
from phytac_design.rules.check import check_design
from phytac_design.simulation.imaging.nominal_view import paint_slopes
from phytac_design.study.search.study_file import Study
from phytac_shapes import Surface
from phytac_shapes.arrays import IntArray

COARSE = 2.5
"""Coarser polygons than those of a check, 0.25 px off their circles: rays are few anyway."""


@dataclass
class Candidate:
    """A design on its way up the ladder; ``found`` holds all measures so far."""

    design: Design
    study: Study
    found: dict[str, float] = field(default_factory=dict)

    @cached_property
    def checked(self) -> tuple[Surface, Markers]:
        """Surface and markers of a design that can be made at all."""
        return check_design(self.design)

    @property
    def surface(self) -> Surface:
        """The sensing surface."""
        return self.checked[0]

    @property
    def markers(self) -> Markers:
        """The markers on it."""
        return self.checked[1]

    @cached_property
    def cameras(self) -> tuple[Camera, ...]:
        """Its cameras."""
        return cameras_of(self.design, self.surface)

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """What each camera looks at, at rest; for rays, not for pictures."""
        return tuple(
            build_scene(
                self.design,
                self.surface,
                self.markers,
                tolerance_mm=COARSE * tolerance_mm(camera, self.markers),
            )
            for camera in self.cameras
        )

    @cached_property
    def each(self) -> list[Visibility]:
        """Exact visibility, camera by camera, with the study's seed."""
        rng = np.random.default_rng(self.study.seed)
        return [
            check_visibility(self.design, self.surface, self.markers, rng=rng, camera=camera)
            for camera in self.cameras
        ]

    @cached_property
    def seen(self) -> tuple[Visibility, IntArray]:
        """Every marker through the camera that sees it best, and which that is."""
        return best_of(self.each)

    @cached_property
    def views(self) -> dict[str, Any]:
        """Arrays that the stages of mechanics and of load read of what is seen."""
        best, camera = self.seen
        return {
            "camera": camera,
            "paint_slopes": paint_slopes(self.design, self.surface, self.markers, self.each),
            "seen_by": np.stack([~seen.occluded for seen in self.each]),
            "gap_same_colour_px": best.gap_same_colour_px,
            "gap_other_colour_px": best.gap_other_colour_px,
        }
