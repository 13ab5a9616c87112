"""The part of a sensor that a scene is about: places, receptors in play, where to press."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from phytac_design.layout import Markers
from phytac_design.layout.worst_places import SAME_mm, press_places
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.scenario.contact_box import contact_box, window_grid
from phytac_design.simulation.scenario.placement import ChartWindow
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError

if TYPE_CHECKING:
    from phytac_design.design.scene import RegionSection
    from phytac_design.engine.stage import Context

MARGIN_SPACINGS = 3.0
"""Places beyond a region, in their spacings: the cubics of those inside it are then the whole
table's, whose twenty places reach 2.8 spacings."""
PRESSES_LEAST = 4
"""Places to press in a region, at least."""
EVERYWHERE = 10**9
SHARE_CELLS = 200


@dataclass(frozen=True, kw_only=True)
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
        """Chart positions (k, 2) all over the regions."""
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
        return np.asarray(self.distance_mm(uv) <= MARGIN_SPACINGS * spacing_mm)

    @cached_property
    def touched(self) -> ChartBox:
        """Box of the chart around all patches."""
        return contact_box(self.surface, self.places, np.full(len(self.places), self.reach_mm))

    @cached_property
    def share(self) -> float:
        """Share of the surface's area that contacts are centred in."""
        (u0, u1), (v0, v1) = self.surface.domain
        middle = (np.arange(SHARE_CELLS) + 0.5) / SHARE_CELLS
        shares = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
        uv = np.array([u0, v0]) + shares * np.array([u1 - u0, v1 - v0])
        metric = self.surface.metric(uv)
        area = np.sqrt(np.maximum(metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2, 0.0))
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
        """Chart positions (k, 2) to press at in the regions, as dense as ``count`` are all over.

        See :func:`phytac_design.layout.worst_places.press_places`, which this chooses from.

        Raises
        ------
        DesignError
            If the regions hold none of its candidates.
        """
        every = press_places(surface, markers, gap_px, EVERYWHERE)
        inside = every[self.holds(every)]
        if len(inside) == 0:
            raise DesignError(
                "the scene's regions hold no receptor and no middle between two; widen along and "
                "around"
            )
        turns = markers.lattice.columns if repeats and markers.lattice else 1
        wanted = max(int(np.ceil(count * self.sector_share(turns))), PRESSES_LEAST)
        at = surface.point(inside)
        nearest = np.argmin(
            np.linalg.norm(at[:, None] - surface.point(markers.uv)[None], axis=2), axis=1
        )
        away = np.full(len(inside), np.inf)
        chosen: list[int] = []
        for rank in range(min(wanted, len(inside))):
            if not away.max() > SAME_mm:
                break
            free = away > SAME_mm
            tight = np.where(free, gap_px[nearest], np.inf)
            k = int(np.argmin(tight)) if 2 * rank < wanted else int(np.argmax(away))
            chosen.append(k)
            images = np.tile(inside[k], (turns, 1))
            if markers.lattice:
                images[:, 1] += np.arange(turns) * markers.lattice.pitch_v
            for image in surface.point(images):
                away = np.minimum(away, np.linalg.norm(at - image, axis=1))
        return np.asarray(inside[np.sort(chosen)])

    def sector_share(self, turns: int) -> float:
        """Share of one sector, of so many alike, that the regions' images cover."""
        if turns == 1:
            return self.share
        around = sum(float(w.size[1]) for w in self.windows)
        whole = float(np.ptp(self.surface.domain[1]))
        return min(self.share * whole / max(min(around, whole), 1e-12), 1.0)


def windows_of(surface: Surface, regions: "tuple[RegionSection, ...]") -> tuple[ChartWindow, ...]:
    """Parts of the chart that regions stand for.

    Raises
    ------
    DesignError
        If one runs over a seam that the surface does not have.
    """
    start, end = surface.domain.T
    span = end - start
    out = []
    for number, region in enumerate(regions):
        size = np.array([region.along[1] - region.along[0], region.around[1] - region.around[0]])
        if size[1] < 0.0:
            if not surface.periodic[1]:
                raise DesignError(
                    f"regions.{number}.around runs over a seam, but the {surface.name} is open "
                    f"there (got {list(region.around)}); let it grow"
                )
            size[1] += 1.0
        low = start + np.array([region.along[0], region.around[0]]) * span
        out.append(ChartWindow(low=low, size=size * span, surface=surface))
    return tuple(out)


def scope_of(context: "Context") -> Scope | None:
    """Scope of the scene that is built; None where all of the surface is touched."""
    scene, design = context.scene, context.design
    if scene is None or not scene.regions:
        return None
    return Scope(
        surface=context.surface,
        windows=windows_of(context.surface, scene.regions),
        reach_mm=scene.reach_mm or design.training.patch_radius_max_mm,
        footprint_mm=design.switch.footprint_diameter_mm / 2.0,
    )
