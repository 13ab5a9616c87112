"""Places to press a sensor for its worst case."""

from collections.abc import Callable

import numpy as np

from phytac_design.layout.markers import Markers
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray

SAME_mm = 1e-6
"""Places this near to each other are one."""


def press_places(
    surface: Surface,
    markers: Markers,
    gap_px: FloatArray,
    count: int,
    *,
    repeats: bool = False,
    inside: Callable[[FloatArray], BoolArray] | None = None,
) -> FloatArray:
    """Chart positions (count, 2) to press at: at the smallest gaps, and spread over the surface.

    Candidates are all markers and the middles between neighbours, within a row and across rows.
    The first half of the places are those of the markers with the smallest gaps at rest; the others
    are added one by one, each the farthest from all so far (in space). Fewer where there are fewer
    candidates. Where sensor and view repeat themselves around (``repeats``) places that a turn by
    whole columns brings onto another one count as that one: all places lie in one sector's worth.
    ``inside`` maps chart positions (m, 2) to the candidates that are allowed, (m,).
    """
    uv = _candidates(surface, markers)
    at = surface.point(uv)
    turns = markers.lattice.columns if repeats and markers.lattice else 1
    allowed = True if inside is None else inside(uv)
    distance = np.where(np.broadcast_to(allowed, len(uv)), np.inf, 0.0)
    chosen: list[int] = []

    def add(k: int) -> None:
        nonlocal distance
        chosen.append(k)
        images = np.tile(uv[k], (turns, 1))
        if markers.lattice:
            images[:, 1] += np.arange(turns) * markers.lattice.pitch_v
        for image in surface.point(images):
            distance = np.minimum(distance, np.linalg.norm(at - image, axis=1))

    for k in np.argsort(gap_px, kind="stable"):
        if len(chosen) >= (count + 1) // 2:
            break
        if distance[k] > SAME_mm:
            add(int(k))
    while len(chosen) < count and float(distance.max()) > SAME_mm:
        add(int(np.argmax(distance)))
    return np.asarray(uv[np.sort(np.array(chosen, dtype=np.int64))])


def _candidates(surface: Surface, markers: Markers) -> FloatArray:
    """Markers first, then the middles to the next one of the row and of the next row."""
    low, high = surface.domain.T
    point = surface.point(markers.uv)
    parts = [markers.uv]
    for slot in (4, 6):
        other = markers.neighbours[:, slot]
        paired = np.flatnonzero(other >= 0)
        middle = (point[paired] + point[other[paired]]) / 2.0
        parts.append(np.clip(surface.chart(middle), low, high))
    return np.concatenate(parts)
