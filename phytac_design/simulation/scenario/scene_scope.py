"""The part of a sensor that a scene is about: places, receptors in play, places to press."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from phytac_design.layout import Markers
from phytac_design.layout.arc import area_elements
from phytac_design.layout.worst_places import press_places
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.scenario.contact_placement import (
    ChartWindow,
    chart_window,
    contact_box,
    window_grid,
)
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError

if TYPE_CHECKING:
    from phytac_design.design.scene import SceneRegionSection
    from phytac_design.engine.stage import Context

PRESSES_LEAST = 4
"""Minimum number of places to press in a region."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scope:
    """Where contacts of a scene are centred, and what they can reach.

    Attributes
    ----------
    surface : Surface
        The outer face.
    windows : tuple of Window
        Parts of the chart.
    reach_mm : float
        Largest radius of a patch.
    footprint_mm : float
        Radius of a switch's footprint.
    """

    surface: Surface
    windows: tuple[ChartWindow, ...]
    reach_mm: float
    footprint_mm: float

    def holds(self, uv: FloatArray) -> BoolArray:
        """Whether chart positions (m, 2) lie in a region, (m,)."""
        return np.asarray(np.any([window.holds(uv) for window in self.windows], axis=0))

    @cached_property
    def places(self) -> FloatArray:
        """Chart positions (k, 2) spread over the regions."""
        return np.concatenate([window_grid(window) for window in self.windows])

    def distance_mm(self, uv: FloatArray) -> FloatArray:
        """Chord (m,) from chart positions (m, 2) to the nearest region; 0 inside."""
        from scipy.spatial import cKDTree

        away, _ = cKDTree(self.surface.point(self.places)).query(self.surface.point(uv))
        return np.where(self.holds(uv), 0.0, away)

    def in_play(self, markers: Markers) -> BoolArray:
        """Receptors (n,) whose switches a contact of the scene can press."""
        return np.asarray(self.distance_mm(markers.uv) <= self.reach_mm + self.footprint_mm)

    def near(self, spacing_mm: float, uv: FloatArray) -> BoolArray:
        """Places (m,) of a table that contacts of the scene need."""
        # Places beyond a region, in their spacings: the cubics of those inside it are then the
        # whole table's, whose twenty places reach 2.8 spacings.
        margin_spacings = 3.0
        return np.asarray(self.distance_mm(uv) <= margin_spacings * spacing_mm)

    @cached_property
    def touched(self) -> ChartBox:
        """Box of the chart around all patches."""
        return contact_box(self.surface, self.places, np.full(len(self.places), self.reach_mm))

    @cached_property
    def share(self) -> float:
        """Share of the surface's area that contacts are centred in."""
        (u0, u1), (v0, v1) = self.surface.domain
        middle = (np.arange(200) + 0.5) / 200
        u, v = u0 + middle * (u1 - u0), v0 + middle * (v1 - v0)
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        area = area_elements(self.surface, u, v).ravel()
        return float(area[self.holds(uv)].sum() / area.sum())

    def presses(
        self,
        surface: Surface,
        markers: Markers,
        gap_px: FloatArray,
        count: int,
        *,
        repeats: bool = False,
    ) -> FloatArray:
        """Chart positions (k, 2) to press at in the regions, as dense as ``count`` everywhere.

        See :func:`phytac_design.layout.worst_places.press_places`.

        Raises
        ------
        DesignError
            If the regions hold no candidate.
        """
        turns = markers.lattice.columns if repeats and markers.lattice else 1
        wanted = max(int(np.ceil(count * self.sector_share(turns))), PRESSES_LEAST)
        uv = press_places(surface, markers, gap_px, wanted, repeats=repeats, inside=self.holds)
        if len(uv) == 0:
            raise DesignError(
                "scene-without-receptors",
                "the scene's regions hold no receptor and no middle between two; widen along and "
                "around",
            )
        return uv

    def sector_share(self, turns: int) -> float:
        """Share of one of ``turns`` identical sectors that the regions' images cover."""
        if turns == 1:
            return self.share
        around = sum(float(w.size[1]) for w in self.windows)
        whole = float(np.ptp(self.surface.domain[1]))
        return min(self.share * whole / max(min(around, whole), 1e-12), 1.0)


def windows_of(
    surface: Surface, regions: "tuple[SceneRegionSection, ...]"
) -> tuple[ChartWindow, ...]:
    """Parts of the chart that regions cover.

    Raises
    ------
    DesignError
        If a region crosses a seam that the surface does not have.
    """
    return tuple(
        chart_window(surface, region.along, region.around, f"regions.{number}")
        for number, region in enumerate(regions)
    )


def scope_of(context: "Context") -> Scope | None:
    """Scope of a context's scene; None if the whole surface is touched."""
    scene, design = context.scene, context.design
    if scene is None or not scene.regions:
        return None
    return Scope(
        surface=context.surface,
        windows=windows_of(context.surface, scene.regions),
        reach_mm=scene.reach_mm or design.training.patch_radius_max_mm,
        footprint_mm=design.switch.footprint_diameter_mm / 2.0,
    )
