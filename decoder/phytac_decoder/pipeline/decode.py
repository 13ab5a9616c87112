"""Markers and switches in one frame of each camera."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from phytac_decoder.camera.camera_motion import MarkedMotion
from phytac_decoder.estimation.contact_estimates import ContactDetection
from phytac_decoder.estimation.locator import SETTINGS as LOCATOR_SETTINGS
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.io.sensor_limits import id_list, markers_in_play, scene_words
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_decoder.pipeline.fault_detection import SETTINGS as FAULT_SETTINGS
from phytac_decoder.pipeline.fault_detection import FaultDetector, unreached_switches
from phytac_decoder.vision.matching import Matched, fill_from_neighbours, match_markers
from phytac_decoder.vision.picture_quality import LightChange, LightCheck
from phytac_decoder.vision.segmentation import Blobs, check_image, segment_in_its_light
from phytac_decoder.vision.switch_detection import HALF_OUT_REPORTED, read_switches
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

FOUND_MIN, FOUND_WELL = 0.5, 0.95
"""A frame that shows fewer than the first of these fractions of the markers is rejected; below the
second, forces are returned with a warning."""

FOUND_WITHIN = 0.05
"""Markers farther from their places at rest than this share of the extent of all markers do not
count as found when a frame is accepted or rejected."""

Frames = ImageArray | Sequence[ImageArray]
"""A frame of each camera, in the bundle's order; one camera's may stand alone."""
OVER_END = "over the end of the sensing surface"
"""Part of the warning of such contacts; the others of their frame are sound."""


@dataclass(frozen=True, kw_only=True)
class FrameMeasurement:
    """What one frame (of each camera) shows.

    Attributes
    ----------
    koi : (m,) int
        Key nodes of interest: markers whose switch is on.
    shift_px : (n, 2) float
        Shift of each marker against the rest frame; NaN where not found.
    found : (n,) bool
        Markers that were seen.
    merged : (k,) int
        Markers that were left out because their paint is one with another's.
    marked : MarkedMotion, optional
        Motion of the cameras by reference marks, which is taken off the shifts.
    half_out : (h,) int
        Markers whose tip shows more red than at rest, and less than when its switch is on.
    blur_px : (c,) float
        Blur of edges in the frame of each camera, see :class:`.picture_quality.PictureQuality`; NaN
        if not measured, empty without a rest frame.
    light : (c,) LightChange or None
        Red light and overexposure in the frame of each camera, see
        :class:`.picture_quality.LightCheck`; None if not measured, empty as above.
    """

    koi: IntArray
    shift_px: FloatArray
    found: BoolArray
    merged: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    marked: MarkedMotion | None = None
    half_out: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    blur_px: tuple[float, ...] = ()
    light: tuple[LightChange | None, ...] = ()

    def forces_N(self, bundle: Bundle, estimator: str) -> FloatArray:
        """Inward force (n,) N on each marker; zero off the key nodes of interest."""
        return bundle.model.forces(estimator, self.shift_px, self.koi)

    def warnings(
        self,
        bundle: Bundle,
        forces_N: FloatArray,
        *,
        estimator: str | None = None,
        found: ContactDetection | None = None,
    ) -> list[str]:
        """Reasons to distrust these forces, one sentence each; empty for a sound frame.

        What the sensor can never read is in :meth:`phytac_decoder.io.bundle.Bundle.limits`.

        Parameters
        ----------
        bundle : Bundle
            The sensor's decoder.
        forces_N : (n,) float
            From :meth:`forces_N`.
        estimator : str, optional
            The one that gave them; all of them if not given.
        found : ContactDetection, optional
            Contacts that ``auto`` has found in this frame.
        """
        out = []
        if float(self.found.mean()) < FOUND_WELL:
            out.append(
                f"only {int(self.found.sum())} of {len(self.found)} markers were found; check "
                "light, focus and what stands before the camera"
            )
        out += self._out_of_focus(bundle) + self._light_warnings(bundle)
        if bundle.marks.count and self.marked is None:
            out.append(
                "the reference marks do not show the camera's motion: too few were found, or not "
                "where any motion puts them; clean them, and take a new rest frame"
            )
        moved = self.moved_cameras(bundle, found)
        out += moved
        elsewhere = self.koi[~markers_in_play(bundle)[self.koi]]
        if len(elsewhere):
            out.append(
                f"forces on {len(elsewhere)} switched receptors ({id_list(elsewhere)}) cannot be "
                f"read: this decoder was made for {scene_words(bundle)}"
            )
        if not moved:
            out += self._motion_faults(bundle, forces_N, found)
        useless = self.koi[~bundle.stiffness_usable[self.koi]]
        noisy = bundle.model.by_stiffness
        if len(useless) and (estimator is None or estimator in noisy):
            out.append(
                f"{', '.join(noisy)} cannot be used on {len(useless)} switched receptors "
                f"({id_list(useless)}): noise of K·u exceeds any force there; use koi_inverse"
            )
        beyond = bundle.model.beyond_range(estimator or "", self.shift_px, self.koi)
        if len(beyond):
            out.append(
                f"{estimator} has learnt no such motion as that of {len(beyond)} switched "
                f"receptors ({id_list(beyond)}): forces there are those of the finite-element "
                "model; train with such contacts, or use auto"
            )
        most = LOCATOR_SETTINGS.unswitched_max
        if bundle.model.without_switches and found and len(found.contacts) >= most:
            out.append(
                f"{most} contacts are the most that are found without switches: there may be more, "
                "and a force may be the sum of several"
            )
        out += _contact_warnings(bundle, found)
        off = np.setdiff1d(self.half_out, self.koi)
        if len(off) or len(self.half_out) >= HALF_OUT_REPORTED:
            out.append(
                f"{len(self.half_out)} tips ({id_list(self.half_out)}) show more red than at rest "
                "and less than when their switches are on: switches may be read wrongly; check for "
                "red light, focus and compression, or take a new rest frame if the light has "
                "changed"
            )
        if not moved:
            out += self._too_many_switches(bundle, found)
        return out

    def _out_of_focus(self, bundle: Bundle) -> list[str]:
        """Cameras in whose frames edges are blurred too much, or do not show."""
        out = []
        for number, (blur_px, focus) in enumerate(zip(self.blur_px, bundle.focus, strict=False)):
            which = bundle.of_camera(number)
            if focus and np.isnan(blur_px):
                out.append(
                    f"no marker's edge shows how sharp the frame{which} is, as in the rest frame: "
                    "forces are doubtful; check light, focus and what stands before the camera"
                )
            elif focus and blur_px > focus.limit_px:
                out.append(
                    f"edges are blurred by {blur_px:.1f} px{which}, and at most "
                    f"{focus.limit_px:.1f} px suit these markers: forces are doubtful; turn the "
                    "lens, or shorten the exposure if the sensor moves fast"
                )
        return out

    def _light_warnings(self, bundle: Bundle) -> list[str]:
        """Cameras in whose frames red light falls on some markers, or markers are overexposed."""
        out = []
        for number, light in enumerate(self.light):
            which = bundle.of_camera(number)
            if light and light.red_share > LightCheck.share_max:
                out.append(
                    f"{100.0 * light.red_share:.0f} % of the markers{which} have more red than at "
                    "rest, and the others do not: forces there are doubtful; keep red light off "
                    "the wall, or take a new rest frame"
                )
            if light and light.beyond_range > LightCheck.beyond_range_max:
                out.append(
                    f"overexposed: most markers{which} are clipped, and would be "
                    f"{light.beyond_range:.1f} times as bright as the picture can show: forces are "
                    "doubtful; shorten the exposure or lower the gain"
                )
        return out

    def _too_many_switches(self, bundle: Bundle, found: ContactDetection | None) -> list[str]:
        """More switches that are on than contacts can turn on."""
        count, model = len(self.koi), bundle.model
        if count <= FAULT_SETTINGS.many_share * len(self.found):
            return []
        text = f"{count} of {len(self.found)} switches read as on"
        cause = "check for red light and for something red"
        every = count >= FAULT_SETTINGS.all_share * bundle.tips.readable.sum()
        if every or model.locator is None:
            return [f"{text}, more than contacts turn on together: {cause}"]
        contacts = found or model.contacts(self.shift_px, self.koi, marked=self.marked)
        unreached = unreached_switches(bundle, self.koi, contacts)
        if len(unreached) <= FAULT_SETTINGS.unreached_share * count:
            return []
        beyond = f"no contact reaches {len(unreached)} of them ({id_list(unreached)})"
        return [f"{text}, and {beyond}: {cause}"]

    def moved_cameras(self, bundle: Bundle, found: ContactDetection | None) -> list[str]:
        """Return which cameras have moved, or light has changed, too much: one sentence each."""
        camera, motion = bundle.model.camera_motion, self._motion(bundle, found)
        if camera is None or not len(motion):
            return []
        return [
            f"{text} since the rest frame, more than is corrected; take a new rest frame, fasten "
            "the camera and lock its settings (--mount handheld allows for more motion)"
            for text in camera.excess(motion, self.marked)
        ]

    def _motion(self, bundle: Bundle, found: ContactDetection | None) -> FloatArray:
        return found.motion if found else bundle.model.motion(self.shift_px, self.koi)

    def _motion_faults(
        self, bundle: Bundle, forces_N: FloatArray, found: ContactDetection | None
    ) -> list[str]:
        """Contradictions between the markers' motion and the switches."""
        out = []
        if len(self.merged):
            out.append(
                f"the paint of {len(self.merged)} markers ({id_list(self.merged)}) is one with "
                "another's: they are left out; clean or repaint them"
            )
        shift_px = bundle.model.without_motion(self.shift_px, self._motion(bundle, found))
        koi = self.koi
        if bundle.model.without_switches:
            # What contacts explain is no contradiction where no switch could show them.
            koi = np.flatnonzero(forces_N)
        motion = FaultDetector(bundle, shift_px, koi, found)
        weak = motion.switches_without_force(forces_N)
        doubtful = self.koi[~bundle.tips.readable[self.koi] & (forces_N[self.koi] == 0.0)]
        if len(doubtful) and found:
            out.append(
                f"{len(doubtful)} switches that cannot be read ({id_list(doubtful)}) seem on, and "
                "the markers do not show it clearly: a weak press there may be missing"
            )
            weak = np.setdiff1d(weak, doubtful)
        if len(weak):
            least = bundle.threshold_N[weak].min()
            out.append(
                f"{len(weak)} switched receptors ({id_list(weak)}) show no force, and {least:g} N "
                "or more switch them on: stuck switches, or something red"
            )
        pressed, unexplained = motion.unexplained()
        if len(pressed):
            contradiction = "their switches do not read as on"
            if bundle.model.without_switches:
                contradiction = "no contact explains it"
            out.append(
                f"{len(pressed)} markers ({id_list(pressed)}) moved as if pressed, and "
                f"{contradiction}: forces there are missing"
            )
        elif len(unexplained):
            out.append(
                f"{len(unexplained)} markers ({id_list(unexplained)}) are where no force on the "
                "switches that are on puts them: something hides their paint, or has moved it; "
                "forces near them are doubtful"
            )
        return out


def _contact_warnings(bundle: Bundle, found: ContactDetection | None) -> list[str]:
    locator = bundle.model.locator
    if locator is None or found is None:
        return []
    out = noisy_rims(found, chi2_allowed=locator.noise.chi2_allowed)
    if found.hidden_N:
        cause = "it may press between receptors, or a switch may be dead"
        if locator.as_if_linear and locator.linear_error:
            cause += ", or linear tables are that far off"
        out.append(
            f"a contact of {found.hidden_N:.1f} N may be missing: markers moved as under it, and "
            f"no switch shows it; {cause}"
        )
    return out + over_rims(found, locator.places)


def noisy_rims(
    found: ContactDetection,
    chi2_max: float = 2.0,
    spread_max: float = 0.05,
    *,
    chi2_allowed: float = 1.0,
    chi2_systematic: float = 3.0,
) -> list[str]:
    """Warning of forces that noise above the expected one makes doubtful; none for others.

    Where no contact was found, such noise may hide one. Beside a rim, force and place of a contact
    are nearly degenerate, so that systematic errors of the picture (compression, say), which
    intervals cannot contain, are large there.

    Parameters
    ----------
    chi2_max : float
        Reduced χ² up to which markers are as noisy as expected.
    spread_max : float
        Relative standard deviation of a force that is well determined.
    chi2_allowed : float
        Reduced χ² of the largest noise that the camera may have, where its usual one is predicted.
    chi2_systematic : float
        Reduced χ² by this frame's own noise, above which errors are not noise.
    """
    usual = found.chi2_of_usual <= chi2_max * chi2_allowed
    if usual and found.reduced_chi2 <= chi2_systematic:
        return []
    doubtful = f"forces with a standard deviation above {100.0 * spread_max:g} % are doubtful"
    if not found.contacts:
        doubtful = "a contact whose switch is not seen may be missing"
    elif all(one.sd_N <= spread_max * one.force_N for one in found.contacts):
        return []
    words = (
        f"markers are {np.sqrt(found.chi2_of_usual):.1f} times their noise from where contacts put "
        f"them: {doubtful}; check focus, light and compression"
    )
    return [words]


def over_rims(found: ContactDetection, places: ResponseTable, *, inside: float = 0.8) -> list[str]:
    """Warning of contacts that reach over the end of the surface; none for others.

    The sensor feels what presses on its wall, and not what presses beside it.

    Parameters
    ----------
    inside : float
        Least distance of a contact from the end in its 95 % interval, over the contact's radius,
        from which on it counts as inside: 5 % of a disc lie beyond.
    """
    if not found.contacts:
        return []
    points = np.stack([one.point_mm for one in found.contacts])
    distance = places.end_distance_mm(points) - [1.96 * max(one.sd_mm) for one in found.contacts]
    over = [
        one
        for one, gap in zip(found.contacts, distance, strict=True)
        if gap < inside * one.radius_mm
    ]
    if not over:
        return []
    forces = ", ".join(f"{one.force_N:.1f}" for one in over)
    reach = f"contacts of {forces} N reach" if len(over) > 1 else f"a contact of {forces} N reaches"
    words = (
        "what presses beyond it is not measured, and force and place are hard to tell apart there"
    )
    return [f"{reach} {OVER_END}: {words}"]


def one_frame_per_camera(bundle: Bundle, frames: Frames) -> tuple[ImageArray, ...]:
    """One frame for each of the bundle's cameras.

    Raises
    ------
    InputError
        If there are more or fewer.
    """
    alone = isinstance(frames, np.ndarray) and frames.ndim <= 3
    given = (frames,) if alone else tuple(frames)
    wanted = len(bundle.cameras)
    if len(given) != wanted:
        each, fix = "one camera", "give one frame of it"
        if wanted > 1:
            each = f"{wanted} cameras"
            fix = "give one frame of each, taken at the same time, the near end's first"
        number = "1 frame" if len(given) == 1 else f"{len(given)} frames"
        raise InputError(
            "camera-count", f"the sensor {bundle.design!r} has {each} (got {number}); {fix}"
        )
    return given


def prepared_frames(bundle: Bundle, frames: Frames) -> tuple[ImageArray, ...]:
    """One frame for each of the bundle's cameras, as :func:`locate_in` reads it.

    Raises
    ------
    InputError
        If there are more or fewer.
    """
    return tuple(bundle.colours.prepared(each) for each in one_frame_per_camera(bundle, frames))


def in_rest_light(bundle: Bundle, images: Sequence[ImageArray]) -> tuple[ImageArray, ...]:
    """Images of :func:`prepared_frames` in the exposure and white balance of the rest frames.

    Raises
    ------
    InputError
        If an image is no picture, or has another size than its camera.
    """
    out = list(images)
    for number, balance in enumerate(bundle.white_balance):
        camera = bundle.cameras[number]
        check_image(images[number], width_px=camera.width_px, height_px=camera.height_px)
        if balance:
            out[number] = balance.as_at_rest(images[number])
    return tuple(out)


class Located(NamedTuple):
    """Markers and reference marks (n + r), switches (n,) and tips that are half out (n,)."""

    matched: Matched
    switch_on: BoolArray
    half_out: BoolArray


def locate_markers(bundle: Bundle, frames: Frames) -> Located:
    """Positions of markers and reference marks, and switches.

    Each is seen through the camera that reads it.

    Raises
    ------
    InputError
        If there is not one image for each camera, or one has another size than its camera, or
        shows too few markers.
    """
    return _locate(bundle, in_rest_light(bundle, prepared_frames(bundle, frames)))


def _locate(bundle: Bundle, images: Sequence[ImageArray]) -> Located:
    """Find them in images of :func:`in_rest_light`."""
    each = [locate_in(bundle, number, image) for number, image in enumerate(images)]
    position, merged = (
        np.stack(part)[bundle.spot_read_by, np.arange(len(bundle.spot_colour))]
        for part in zip(*((found.position_px, found.merged) for found, _ in each), strict=True)
    )
    tips = np.stack([_switches_in(bundle, number, *seen) for number, seen in enumerate(each)])
    switch_on, half_out = tips[bundle.read_by, :, np.arange(len(bundle.colour))].T
    found = np.isfinite(position[:, 0])
    return Located(
        matched=Matched(position_px=position, found=found, merged=merged),
        switch_on=switch_on,
        half_out=half_out,
    )


def locate_in(
    bundle: Bundle, number: int, image_bgr: ImageArray, expected_px: FloatArray | None = None
) -> tuple[Matched, Blobs]:
    """Positions (n + r, 2) px of markers and marks that one camera shows, and all blobs.

    Those that another camera reads are included, so that their paint is not assigned to a marker
    beside them. ``expected_px`` (n + r, 2) is where they are looked for, if not at rest.
    The image is one of :func:`in_rest_light`.
    """
    camera = bundle.cameras[number]
    check_image(image_bgr, width_px=camera.width_px, height_px=camera.height_px)
    blobs = segment_in_its_light(image_bgr, bundle.colours, camera=number)
    blobs_max = 8.0  # per marker, of a frame of the sensor
    if len(blobs.colour) > blobs_max * len(bundle.colour):
        raise InputError(
            "blobs-too-many",
            f"the image{bundle.of_camera(number)} shows {len(blobs.colour)} coloured blobs for "
            f"{len(bundle.colour)} markers; is this a frame of the sensor {bundle.design!r}, in "
            "focus?",
        )
    shown_px = bundle.spots_shown_by(number)
    matched = match_markers(
        blobs,
        rest_px=shown_px,
        colour=bundle.spot_colour,
        neighbours=bundle.spot_neighbours,
        expected_px=expected_px,
    )
    # A turned picture, or another camera's, may also be a smooth assignment, of large shifts.
    moved_max = FOUND_WITHIN * float(np.nanmax(shown_px) - np.nanmin(shown_px))
    near = np.hypot(*(matched.position_px - shown_px).T) <= moved_max
    found = near[: len(bundle.colour)][bundle.read_by == number]
    if len(found) and found.mean() < FOUND_MIN:
        order = ", in the right order" if len(bundle.cameras) > 1 else ""
        raise InputError(
            "markers-not-found",
            f"found {int(found.sum())} of {len(found)} markers{bundle.of_camera(number)} within "
            f"{moved_max:.0f} px of their places at rest; is this a frame of the sensor "
            f"{bundle.design!r}, lit and in focus{order}?",
        )
    return matched, blobs


def _switches_in(
    bundle: Bundle, number: int, matched: Matched, blobs: Blobs
) -> tuple[BoolArray, BoolArray]:
    """Switches (n,), and tips that are half out, by one camera's blobs."""
    shown = bundle.shown_by(number)
    own = np.where(matched.merged[:, None], np.nan, matched.position_px)[: len(bundle.colour)]
    return read_switches(
        blobs,
        shown.tips,
        red_index=bundle.colours.names.index("red"),
        shift_px=fill_from_neighbours(own - shown.rest_px, bundle.model.neighbours),
    )


def rest_positions(bundle: Bundle, rest_bgr: Frames | None) -> FloatArray:
    """Rest positions (n + r, 2) px of markers and reference marks.

    They are measured in the unloaded frames if there are any.
    """
    if rest_bgr is None:
        return bundle.spot_rest_px
    matched = locate_markers(bundle, rest_bgr).matched
    return np.where(matched.found[:, None], matched.position_px, bundle.spot_rest_px)


def measure_frame(
    bundle: Bundle, image_bgr: Frames, *, rest_px: FloatArray | None = None
) -> FrameMeasurement:
    """Find markers and switches in one frame, or one of each camera.

    Parameters
    ----------
    bundle : Bundle
        The sensor's decoder.
    image_bgr : (h, w, 3) uint8, or a sequence of them
        Camera frame; of several cameras one of each, in the bundle's order (near end first).
    rest_px : (n + r, 2) float, optional
        From :func:`rest_positions`; the bundle's prediction if not given. Each marker in the
        frame of the camera that reads it. Of (n, 2) for the markers alone, reference marks do not
        count.

    Raises
    ------
    InputError
        See :func:`locate_markers`.
    """
    given = prepared_frames(bundle, image_bgr)
    images = in_rest_light(bundle, given)
    matched, switch_on, half_out = _locate(bundle, images)
    rest = bundle.spot_rest_px if rest_px is None else rest_px
    position = np.where(matched.merged[:, None], np.nan, matched.position_px)
    moved = with_edges(bundle, images, position[: len(rest)] - rest, switch_on, half_out)
    koi, shift, marked = corrected_shift(bundle, switch_on, moved)
    count = len(bundle.colour)
    return FrameMeasurement(
        koi=koi,
        shift_px=shift,
        found=np.isfinite(position[:count, 0]),
        merged=np.flatnonzero(matched.merged[:count]),
        marked=marked,
        half_out=np.flatnonzero(half_out),
        blur_px=blurs_px(bundle, images, position[:count]),
        light=light_changes(bundle, given, position[:count], switch_on | half_out),
    )


def with_edges(
    bundle: Bundle,
    images: Sequence[ImageArray],
    moved_px: FloatArray,
    switch_on: BoolArray,
    half_out: BoolArray,
) -> FloatArray:
    """Shifts (n + r, 2) px since the rest frame: those of small markers by their edges too.

    Parameters
    ----------
    images : sequence of (h, w, 3) uint8
        One of each camera, of :func:`in_rest_light`.
    moved_px : (n + r, 2) float
        Shifts of the centroids of markers and reference marks.
    switch_on, half_out : (n,) bool
        Switches, and tips that are half out.
    """
    if not any(bundle.edges):
        return moved_px
    count = len(switch_on)
    cover = bundle.tip_shift_px(switch_on)
    # A doubtful switch may be off after all, and its tip then covers nothing.
    sure = bundle.tips.readable | ~switch_on
    out = moved_px.copy()
    for number, (edges, image) in enumerate(zip(bundle.edges, images, strict=False)):
        if edges:
            own = sure & (bundle.read_by == number)
            shift = np.where(own[:, None], moved_px[:count] - cover, np.nan)
            better = edges.combined(image, shift, switch_on | half_out, switch_on)
            out[:count][own] = (better + cover)[own]
    return out


def blurs_px(
    bundle: Bundle, images: Sequence[ImageArray], position_px: FloatArray
) -> tuple[float, ...]:
    """Blur of each camera's image, of :func:`in_rest_light`, with markers (n, 2) found there."""
    return tuple(
        focus.blur_px(image, position_px) if focus else np.nan
        for focus, image in zip(bundle.focus, images, strict=False)
    )


def light_changes(
    bundle: Bundle, images: Sequence[ImageArray], position_px: FloatArray, red: BoolArray
) -> tuple[LightChange | None, ...]:
    """Changes of light in each camera's image, by markers other than those (n,) with red tips.

    Images are those of :func:`prepared_frames`, positions as in :func:`blurs_px`.
    """
    return tuple(
        check.change(image, position_px, red) if check else None
        for check, image in zip(bundle.light, images, strict=False)
    )


def corrected_shift(
    bundle: Bundle, switch_on: BoolArray, moved_px: FloatArray
) -> tuple[IntArray, FloatArray, MarkedMotion | None]:
    """Key nodes (m,), shifts (n, 2) px, and the motion of the cameras by reference marks.

    Shifts are those ``moved_px`` (n + r, 2) of markers and marks less the bias of the tips that are
    out and that motion.
    """
    marked, count = None, len(bundle.colour)
    if bundle.mark_motion and len(moved_px) > count:
        marked = bundle.mark_motion.estimate_by_marks(moved_px[count:], bundle.model.noise_px)
    moved_px = moved_px[:count]
    if marked:
        moved_px = bundle.model.without_motion(moved_px, marked.mean)
    shift = moved_px - bundle.tip_shift_px(switch_on)
    confirmed = confirmed_switches(bundle, switch_on, shift)
    if (confirmed != switch_on).any():
        shift = moved_px - bundle.tip_shift_px(confirmed)
    return np.flatnonzero(confirmed), shift, marked


def confirmed_switches(bundle: Bundle, switch_on: BoolArray, shift_px: FloatArray) -> BoolArray:
    """Switches (n,) without the doubtful ones that contradict the markers' motion.

    A switch with little red contrast is on only if the inverse over all switches that seem to be on
    finds its threshold force there.
    """
    doubtful = switch_on & ~bundle.tips.readable
    if not doubtful.any():
        return switch_on
    forces = bundle.model.forces("koi_inverse", shift_px, np.flatnonzero(switch_on))
    return np.asarray(switch_on & ~(doubtful & (forces < bundle.threshold_N)))
