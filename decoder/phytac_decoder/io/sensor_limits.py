"""What a sensor cannot read whatever the frame, in sentences."""

from typing import TYPE_CHECKING

import numpy as np

from phytac_decoder.vision.switch_detection import RED_AREA_MIN_px
from phytac_shapes.arrays import BoolArray, IntArray

if TYPE_CHECKING:
    from phytac_decoder.io.bundle import Bundle

NOISE_SHARE_MAX = 0.2
"""Largest noise of a force that can be used, as a share of the greatest force."""


def limits_of(bundle: "Bundle") -> list[str]:
    """Each limit as a sentence; empty for none."""
    out = []
    hidden = ~bundle.tips.readable & (bundle.tips.red_on_px <= RED_AREA_MIN_px)
    if hidden.any():
        out.append(
            f"{int(hidden.sum())} of {len(bundle.colour)} switches cannot be seen even when on "
            f"({id_list(np.flatnonzero(hidden))}): something stands before their tips, such as "
            "the light bar"
        )
    unread = np.flatnonzero(~bundle.tips.readable & ~hidden)
    if len(unread):
        out.append(
            f"{len(unread)} of {len(bundle.colour)} switches cannot be read well "
            f"({id_list(unread)}): the camera sees nearly as much red at rest as when they are "
            "on; they count only where the markers' motion agrees"
        )
    played = markers_in_play(bundle)
    if not played.all():
        out.append(
            f"this decoder was made for {scene_words(bundle)}: it reads forces on "
            f"{int(played.sum())} of {len(played)} markers ({id_list(np.flatnonzero(played))}); "
            "frames in which others are pressed are doubtful"
        )
    faint = np.flatnonzero(played & ~bundle.force_readable)
    if len(faint):
        out.append(
            f"forces on {len(faint)} of {len(bundle.colour)} markers cannot be read by any "
            f"estimator ({id_list(faint)}): noise would exceed "
            f"{NOISE_SHARE_MAX * bundle.force_max_N:g} N"
        )
    weak = np.flatnonzero(played & ~bundle.stiffness_usable)
    if len(weak):
        noise = bundle.noise_centroid_px * bundle.model.stiffness_noise_N_px
        out.append(
            f"the estimators fem, fem_nn and fem_nn_identity cannot be used at {len(weak)} of "
            f"{len(bundle.colour)} markers ({id_list(weak)}): noise of their K·u exceeds "
            f"{NOISE_SHARE_MAX * bundle.force_max_N:g} N (median "
            f"{np.median(noise[played]):.3g} N); use koi_inverse or auto"
        )
    return out


def markers_in_play(bundle: "Bundle") -> BoolArray:
    """Markers (n,) on which forces are read: all, or in a scene's decoder those in play."""
    number = np.arange(len(bundle.colour))
    scene = bundle.notes.get("scene")
    return np.isin(number, number if scene is None else scene["in_play"])


def check_scene(bundle: "Bundle") -> None:
    """Raise ValueError, KeyError or TypeError if a scene's decoder lists no markers in play."""
    scene = bundle.notes.get("scene")
    if scene is None:
        return
    markers, count = scene["in_play"], len(bundle.colour)
    if not isinstance(markers, list) or not all(
        isinstance(marker, int) and 0 <= marker < count for marker in markers
    ):
        raise ValueError(f"notes.scene.in_play is no list of markers 0 to {count - 1}")
    if not isinstance(scene["name"], str):
        raise TypeError("notes.scene.name is no text")


def scene_words(bundle: "Bundle") -> str:
    """The scene that a decoder is limited to."""
    return f"the scene {bundle.notes['scene']['name']!r}"


def id_list(markers: IntArray) -> str:
    """Marker numbers as text, the first five of them."""
    more = f" and {len(markers) - 5} more" if len(markers) > 5 else ""
    return ", ".join(map(str, markers[:5])) + more
