"""Occluders: the part that covers most of a marker's missing pixels."""

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.optics.raster import Buffers, marker_windows, pieces_by_marker, project_scene
from phytac_design.optics.render_scene import (
    BAR,
    FIRST_FIXTURE,
    FIRST_MARKER,
    NONE,
    RESIN,
    SHELL,
    RenderScene,
)
from phytac_design.optics.zbuffer import fill
from phytac_shapes.arrays import IntArray

SELF = -1


def occluding_parts(
    scene: RenderScene, camera: Camera, buffers: Buffers, ids: IntArray, alone_px: IntArray
) -> IntArray:
    """Part code (k,) that covers most hidden pixels of each of the markers ``ids`` (k,).

    ``RESIN`` stands for other receptors, ``NONE`` for the border of the image, ``SELF`` for a
    marker that only its own tube hides.

    Parameters
    ----------
    buffers : Buffers
        Of the scene, see ``rasterise``.
    ids : (k,) int
        Marker numbers.
    alone_px : (n,) int
        Pixels of every marker when its receptor is rendered alone.
    """
    out = np.full(len(ids), SELF, dtype=np.int64)
    if len(ids) == 0:
        return out
    view = project_scene(scene, camera)
    chosen, starts = pieces_by_marker(scene, view)
    windows = marker_windows(view, chosen, starts, camera)
    size = np.array([camera.width_px, camera.height_px])
    for k, marker in enumerate(ids):
        left, top = np.maximum(windows[marker, :2], 0)
        right, low = np.minimum(windows[marker, :2] + windows[marker, 2:], size)
        votes = np.zeros(FIRST_MARKER, dtype=np.int64)
        code = FIRST_MARKER + 2 * int(marker)
        if right > left and low > top:
            owner = np.full((low - top, right - left), -1, dtype=np.int32)
            own = chosen[starts[marker] : starts[marker + 1]]
            fill(view, own, (int(left), int(top), 1, 0.0, 0.0), owner, np.zeros(owner.shape))
            paint = (owner >= 0) & (scene.part[owner] == code)
            seen = buffers.part[top:low, left:right][paint]
            lost = seen[seen != code]
            votes += np.bincount(np.where(lost >= FIRST_MARKER, RESIN, lost), minlength=len(votes))
            votes[NONE] += alone_px[marker] - int(paint.sum())
        if votes.any():
            out[k] = int(votes.argmax())
    return out


def occluder_name(design: Design, code: int) -> str:
    """Name of a part of :func:`occluding_parts`, for messages."""
    if code >= FIRST_FIXTURE:
        return f"by the fixture {design.fixtures[code - FIRST_FIXTURE].name!r}"
    return {
        SELF: "too small in the picture or facing away",
        NONE: "by the end of the image",
        SHELL: "by the shell",
        BAR: "by the light bar",
        RESIN: "by other receptors",
    }[code]
