"""Visibility under load: hidden, fused and disturbed markers of a pressed sensor.

Crosstalk is the part of a marker's image shift that is not its own motion: a neighbour that covers
or uncovers it moves the centroid of its visible pixels. With ``alone`` the pixels of the marker
when its receptor is rendered alone in the same pose::

    offset = centroid(visible) - centroid(alone)      crosstalk = |offset(pressed) - offset(rest)|

Both centroids use the same pixel samples, so the crosstalk of an uncovered marker is exactly zero.

Receptors move as rigid bodies. The wall of a real sensor moves with them, the rendered one is
fixed: it hides only what lies clearly behind it, so that a receptor that is
pushed outward beside a dent stays visible.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.optics.gaps import marker_gaps
from phytac_design.optics.raster import owner_sums, paint_alone, project_scene, rasterise
from phytac_design.optics.render_scene import SHELL, RenderScene, paint_owner
from phytac_design.optics.visibility import FRACTION_MIN, PIXELS_MIN
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

FUSED_PX = 2.0
"""Markers of one colour this near (one free pixel or none) count as fused under load."""


@dataclass(frozen=True, kw_only=True)
class MarkerState:
    """Markers of one pose of the sensor as the camera sees them; arrays over n markers.

    Attributes
    ----------
    fraction : (n,) float
        Visible fraction.
    visible_px : (n,) int
        Visible pixels.
    gap_same_px, gap_other_px : (n,) float
        Distance to the nearest pixel of another marker of its own, and of another, colour.
    alone_px : (n, 2) float
        Centroid of the marker's pixels with its receptor alone; NaN if that shows none.
    offset_px : (n, 2) float
        Centroid of the visible pixels less ``alone_px``; NaN if not visible.
    """

    fraction: FloatArray
    visible_px: IntArray
    gap_same_px: FloatArray
    gap_other_px: FloatArray
    alone_px: FloatArray
    offset_px: FloatArray

    @property
    def hidden(self) -> BoolArray:
        """Markers that count as occluded."""
        return np.asarray((self.fraction < FRACTION_MIN) | (self.visible_px < PIXELS_MIN))

    @property
    def fused(self) -> BoolArray:
        """Markers that nearly touch another one of their colour."""
        return np.asarray(self.gap_same_px <= FUSED_PX)

    def of(self, counted: BoolArray) -> "MarkerState":
        """Copy whose markers outside ``counted`` (n,) are visible, isolated and stationary."""
        return MarkerState(
            fraction=np.where(counted, self.fraction, 1.0),
            visible_px=np.where(counted, self.visible_px, np.iinfo(np.int64).max),
            gap_same_px=np.where(counted, self.gap_same_px, np.inf),
            gap_other_px=np.where(counted, self.gap_other_px, np.inf),
            alone_px=np.where(counted[:, None], self.alone_px, 0.0),
            offset_px=np.where(counted[:, None], self.offset_px, 0.0),
        )

    def shift_px(self, rest: "MarkerState") -> FloatArray:
        """Own image motion of each marker, (n,) px; 0 if its receptor alone shows no paint."""
        return np.asarray(np.nan_to_num(np.linalg.norm(self.alone_px - rest.alone_px, axis=1)))

    def crosstalk_px(self, rest: "MarkerState") -> FloatArray:
        """Centroid shift of each marker beyond its own motion, (n,) px; 0 if not visible."""
        return np.asarray(np.nan_to_num(np.linalg.norm(self.offset_px - rest.offset_px, axis=1)))


def scene_state(scene: RenderScene, camera: Camera, *, wall_follows: bool = False) -> MarkerState:
    """Visibility, gaps and centroid offsets of a scene, at rest or moved.

    Parameters
    ----------
    wall_follows : bool
        The wall of the scene is fixed, but a real one moves with its receptors: one that is
        slightly behind it is not hidden.
    """
    setback = 0.05  # relative increase of the distance between camera and wall
    if wall_follows:
        wall = np.unique(scene.triangles[scene.part == SHELL])
        vertices = scene.vertices.copy()
        vertices[wall] += setback * (vertices[wall] - camera.position_mm)
        scene = replace(scene, vertices=vertices)
    view = project_scene(scene, camera)
    marker = paint_owner(rasterise(scene, camera, view=view).part)
    visible = owner_sums(marker, scene.count)
    alone = paint_alone(scene, camera, view=view, beyond=False)
    own, other = marker_gaps(marker, scene.colour)
    with np.errstate(divide="ignore", invalid="ignore"):
        own_px = alone[:, 1:] / alone[:, :1]
        offset = visible[:, 1:] / visible[:, :1] - own_px
        fraction = np.where(alone[:, 0] > 0.0, visible[:, 0] / alone[:, 0], 0.0)
    return MarkerState(
        fraction=fraction,
        visible_px=visible[:, 0].astype(np.int64),
        gap_same_px=own,
        gap_other_px=other,
        alone_px=own_px,
        offset_px=offset,
    )


@dataclass(frozen=True, kw_only=True)
class LoadedVisibility:
    """Worst case over many single presses; arrays over p presses or n markers.

    Attributes
    ----------
    hidden, fused : (p,) int
        Markers hidden, and fused, at the full force.
    press_gap_same_px, press_gap_other_px, press_crosstalk_px : (p,) float
        Smallest gaps and largest crosstalk of each press.
    shift_px : (p,) float
        Largest image shift of a marker, for comparison.
    first_force_N : (p,) float
        Least force at which a marker hides or fuses; inf if none does up to the full force.
    first_marker : (p,) int
        The first marker to do so; -1 if none.
    least_fraction, least_gap_same_px, least_gap_other_px : (n,) float
        Minimum over all presses.
    crosstalk_px, crosstalk_still_px : (n,) float
        Maximum over all presses; and over those that move the marker's own image by less than
        a tenth of the largest shift.
    """

    hidden: IntArray
    fused: IntArray
    press_gap_same_px: FloatArray
    press_gap_other_px: FloatArray
    press_crosstalk_px: FloatArray
    shift_px: FloatArray
    first_force_N: FloatArray
    first_marker: IntArray
    least_fraction: FloatArray
    least_gap_same_px: FloatArray
    least_gap_other_px: FloatArray
    crosstalk_px: FloatArray
    crosstalk_still_px: FloatArray

    def with_other(self, other: "LoadedVisibility") -> "LoadedVisibility":
        """Combine the same presses seen by two cameras that read different markers."""
        sooner = self.first_force_N <= other.first_force_N
        least = ("press_gap_same_px", "press_gap_other_px", "first_force_N", "least_fraction",
                 "least_gap_same_px", "least_gap_other_px")  # fmt: skip
        most = ("press_crosstalk_px", "shift_px", "crosstalk_px", "crosstalk_still_px")
        values = {name: np.minimum(getattr(self, name), getattr(other, name)) for name in least}
        values |= {name: np.maximum(getattr(self, name), getattr(other, name)) for name in most}
        return LoadedVisibility(
            hidden=self.hidden + other.hidden,
            fused=self.fused + other.fused,
            first_marker=np.where(sooner, self.first_marker, other.first_marker),
            **values,
        )

    @property
    def worst(self) -> int:
        """Press that hides or fuses a marker at the least force; of equals the tightest."""
        order = np.lexsort((self.press_gap_same_px, self.first_force_N))
        return int(order[0])


class _PressedSensor:
    """Renders one sensor under its presses."""

    def __init__(
        self,
        scene: RenderScene,
        camera: Camera,
        counted: BoolArray,
        pivots_mm: FloatArray,
        forces_N: FloatArray,
    ) -> None:
        self.scene, self.camera, self.counted, self.pivots_mm = scene, camera, counted, pivots_mm
        self.forces_N = np.concatenate([[0.0], forces_N])
        self.rest = scene_state(scene, camera, wall_follows=True).of(counted)

    def at(self, path: FloatArray, force_N: float) -> MarkerState:
        """State at a force; motion is linear between the forces of the path (k, n, 6)."""
        forces = self.forces_N
        k = int(np.clip(np.searchsorted(forces, force_N) - 1, 0, len(forces) - 2))
        share = (force_N - forces[k]) / (forces[k + 1] - forces[k])
        before = path[k - 1] if k > 0 else np.zeros_like(path[0])
        motion = (1.0 - share) * before + share * path[k]
        moved = self.scene.moved(motion[:, :3], motion[:, 3:], self.pivots_mm)
        return scene_state(moved, self.camera, wall_follows=True).of(self.counted)

    def lost(self, seen: MarkerState) -> BoolArray:
        """Markers that are hidden or fused, and are not at rest."""
        rest = self.rest
        return np.asarray((seen.hidden & ~rest.hidden) | (seen.fused & ~rest.fused))

    def first(self, path: FloatArray, seen: MarkerState) -> tuple[float, int]:
        """Least force that loses a marker, and that marker, by bisection from the full force."""
        bisections = 6  # bisections of the force interval in which the first marker is lost
        low, high = 0.0, float(self.forces_N[-1])
        for _ in range(bisections):
            middle = (low + high) / 2.0
            here = self.at(path, middle)
            if self.lost(here).any():
                high, seen = middle, here
            else:
                low = middle
        return high, int(self.lost(seen).argmax())


def visibility_under_load(
    scene: RenderScene,
    camera: Camera,
    *,
    pivots_mm: FloatArray,
    motions: FloatArray,
    forces_N: FloatArray,
    counted: BoolArray | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> LoadedVisibility:
    """Render the sensor under every press, and find the least force that hides or fuses a marker.

    Motion is interpolated linearly between the given forces.

    Parameters
    ----------
    scene, camera : Scene, Camera
        The sensor at rest.
    pivots_mm : (n, 3) float
        Points that ``motions`` refer to: the middle face under each marker.
    motions : (p, k, n, 6) float
        Translation (mm) and rotation (rad) for p presses at k rising forces.
    forces_N : (k,) float
        Forces of ``motions``; the last is the full force.
    counted : (n,) bool, optional
        Markers that are read through this camera; all by default.
    """
    stationary_share = 0.1  # of the largest image shift, below which a marker counts as stationary
    own = np.ones(scene.count, dtype=bool) if counted is None else counted
    sensor = _PressedSensor(scene, camera, own, pivots_mm, forces_N)
    rest, count = sensor.rest, len(motions)
    states = []
    first, marker = np.full(count, np.inf), np.full(count, -1)
    for press, path in enumerate(motions):
        state = sensor.at(path, float(sensor.forces_N[-1]))
        states.append(state)
        if sensor.lost(state).any():
            first[press], marker[press] = sensor.first(path, state)
        progress(f"under load: {press + 1} of {count} presses")
    shape = (count, scene.count)
    shift = np.array([state.shift_px(rest) for state in states]).reshape(shape)
    crosstalk = np.array([state.crosstalk_px(rest) for state in states]).reshape(shape)
    still = shift <= stationary_share * shift.max(axis=1, keepdims=True)
    every = [rest, *states]
    return LoadedVisibility(
        hidden=np.array([int(state.hidden.sum()) for state in states]),
        fused=np.array([int(state.fused.sum()) for state in states]),
        press_gap_same_px=np.array([float(state.gap_same_px.min()) for state in states]),
        press_gap_other_px=np.array([float(state.gap_other_px.min()) for state in states]),
        press_crosstalk_px=crosstalk.max(axis=1),
        shift_px=shift.max(axis=1),
        first_force_N=first,
        first_marker=marker,
        least_fraction=np.min([state.fraction for state in every], axis=0),
        least_gap_same_px=np.min([state.gap_same_px for state in every], axis=0),
        least_gap_other_px=np.min([state.gap_other_px for state in every], axis=0),
        crosstalk_px=crosstalk.max(axis=0, initial=0.0),
        crosstalk_still_px=np.where(still, crosstalk, 0.0).max(axis=0, initial=0.0),
    )
