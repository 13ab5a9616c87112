"""What a sensor cannot read whatever the frame, in sentences."""

from typing import TYPE_CHECKING

import numpy as np

from phytac_decoder.estimation.locator import SETTINGS, ContactLocator
from phytac_decoder.vision.switch_detection import RED_AREA_MIN_px
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from phytac_decoder.io.bundle import Bundle

NOISE_SHARE_MAX = 0.2
"""Largest noise of a force that can be used, as a share of the greatest force."""
STIFFNESS_MAX = 3.0
"""Largest ratio of a print's stiffness to its design's, either way, that is not mentioned: moduli
of printed resins are known to a factor of two."""
LINEAR_ERROR_MAX = 0.05
"""Linear tables that are less far off at the greatest force are not mentioned."""


def axial_rotation(turns: float) -> FloatArray:
    """Rotation (3, 3) about +z by a number of full turns."""
    c, s = np.cos(2.0 * np.pi * turns), np.sin(2.0 * np.pi * turns)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def symmetric_turns(
    position_mm: FloatArray, head_mm: FloatArray, colour: IntArray
) -> list[IntArray]:
    """Turns about the z axis that map markers (n, 3), (n, 3), (n,) onto one another.

    The k-th of s entries is the turn by k / s: the number (n,) of the marker in whose place each
    marker comes. The first is none.
    """
    same_mm = 0.1
    radius = np.hypot(position_mm[:, 0], position_mm[:, 1])
    own, count = int(np.argmax(radius)), len(colour)
    ring = (np.abs(radius - radius[own]) < same_mm) & (colour == colour[own])
    ring &= np.abs(position_mm[:, 2] - position_mm[own, 2]) < same_mm
    both = np.column_stack([position_mm, head_mm])
    for steps in range(int(ring.sum()), 1, -1):
        if ring.sum() % steps:
            continue
        turn = axial_rotation(1.0 / steps)
        after = np.column_stack([position_mm @ turn.T, head_mm @ turn.T])
        gap = np.abs(after[:, None] - both[None]).max(axis=2)
        gap[colour[:, None] != colour[None]] = np.inf
        place = gap.argmin(axis=1)
        if (gap.min(axis=1) < same_mm).all() and len(np.unique(place)) == count:
            out = [np.arange(count)]
            while len(out) < steps:
                out.append(place[out[-1]])
            return out
    return [np.arange(count)]


def orientation_notes(bundle: "Bundle") -> list[str]:
    """What the turn of the shell about its axis means for its readings; empty for nothing."""
    steps = bundle.symmetry_order
    text = (
        f"orientation-ambiguous: a shell that sits turned by {360.0 / steps:g} degrees or a "
        f"multiple looks the same ({steps} ways), and then every place is wrong; align shell and "
        "camera, or set reference_marks.count = 6 in the design"
    )
    if bundle.turned_deg:
        text = (
            f"shell-turned: the shell sits turned by {bundle.turned_deg:g} degrees; numbers and "
            "places are those of the shell, not of the holder"
        )
    elif steps == 1 or bundle.marks.count:
        return []
    return [text]


def _table_limits(locator: ContactLocator | None) -> list[str]:
    """Limits of the tables of the estimator ``auto``."""
    if locator is None:
        return []
    out = []
    if locator.places.shear is None:
        out.append(
            "this decoder was built before force along the surface was estimated: friction is read "
            "as normal force, or as contacts that do not exist; build and train it again"
        )
    fitted = locator.correction
    if fitted and not 1.0 / STIFFNESS_MAX <= fitted.stiffness <= STIFFNESS_MAX:
        out.append(
            f"stiffness-unlikely: the data of this decoder are of a wall {fitted.stiffness:.2g} "
            "times as stiff as the design's: if its material and thickness are those of the print, "
            "the forces of the data are in another unit, and all forces are wrong by that"
        )
    error = locator.linear_error
    if locator.as_if_linear and error > LINEAR_ERROR_MAX:
        share = "more than 100" if error > 1.0 else f"up to {100.0 * error:.0f}"
        cause, cure = "accuracy draft", "build with --accuracy standard"
        if fitted and len(fitted.weight):  # from ten contacts on
            cause = "its data were simulated by linear theory"
            cure = "train on data that were simulated with --displacement auto, or measured"
        out.append(
            f"linear-tables: this decoder takes the wall as linear ({cause}), {share} % off "
            f"at {locator.prior.force_N:g} N and less at smaller forces; the intervals of auto "
            f"allow for it, figures of linear simulations do not; {cure}"
        )
    return out


def limits_of(bundle: "Bundle", estimator: str | None = None) -> list[str]:
    """Each limit as a sentence; empty for none."""
    out = []
    hidden = ~bundle.tips.readable & (bundle.tips.red_on_px <= RED_AREA_MIN_px)
    if hidden.all():
        out.append(
            "no switch can be seen: contacts are found by the markers' motion alone, with the "
            f"estimator auto, at most {SETTINGS.unswitched_max} at a time; one that moves the "
            "markers little is missed"
        )
    elif hidden.any():
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
    out += _table_limits(bundle.model.locator)
    if bundle.other_print_mm:
        out.append(
            f"another-print: markers at rest are {bundle.other_print_mm:.2f} mm (median) from "
            "those of any print that this decoder was trained on. Prints differ in stiffness: "
            f"intervals allow for {100.0 * SETTINGS.stiffness_sd:.0f} %; train with data of this "
            "print"
        )
    if bundle.model.measured is not None and not len(bundle.learnt_rest_px):
        out.append(
            "this decoder measured the response of its print, and its data do not say where that "
            "print's markers are at rest: another print is not noticed; use it on that print alone"
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
    if len(weak) and (estimator is None or estimator in bundle.model.by_stiffness):
        noise = bundle.noise_centroid_px * bundle.model.stiffness_noise_N_px
        out.append(
            f"{', '.join(bundle.model.by_stiffness)} cannot be used at {len(weak)} of "
            f"{len(bundle.colour)} markers ({id_list(weak)}): noise of K·u exceeds "
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
