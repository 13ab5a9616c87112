"""Photos by the sensor's own cameras after an assembly step, compared with the design.

The design is rendered as it should look after that step. Pixels of paint in the photo belong to the
marker or reference mark whose rendered paint is nearest, after the motion of the camera has been
fitted; area, colour, strength and centroid of that paint are compared with the rendered ones.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.camera_motion import MOUNTS, MOVED_SDS, tabulate_camera_motion
from phytac_decoder.io.sensor_limits import axial_rotation, symmetric_turns
from phytac_decoder.pipeline.colour_calibration import fit_colours
from phytac_decoder.vision.matching import match_markers, nearest_same_colour_px
from phytac_decoder.vision.reference_marks import with_marks
from phytac_decoder.vision.segmentation import Blobs, ColourModel, check_image, segment
from phytac_decoder.vision.switch_detection import (
    RED_SEEN_RANGE,
    TIPS_FOR_LIGHT,
    TipModel,
)
from phytac_design.fabrication.documents.paint_map import marker_numbers
from phytac_design.fabrication.inserts.sprues import plan_sprues
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import build_scene, red_owner, spot_owner
from phytac_design.simulation.imaging.nominal_view import colour_model, owner_centroids
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

Step = Literal["painted", "assembled"]
Fault = tuple[str, str, str]
"""Kind, what is measured, what is allowed."""


@dataclass(frozen=True, kw_only=True)
class InspectionSettings:
    """Limits of an inspection; areas are over the rendered ones, all over their median.

    Attributes
    ----------
    area_min, area_max : float
        Smallest and largest area of paint.
    missing_max : float
        A smaller area counts as no paint.
    foreign_max : float
        Largest area of other paint in a marker's place, over the marker's own rendered area.
    strength_min : float
        Smallest colour strength: mean coverage of the painted pixels.
    off_share, off_px : float
        Largest distance of a centroid from its place: a share of the radius of a disc of the same
        area, and pixels that are added.
    pixels_min : float
        Paint of a smaller rendered area cannot be judged.
    found_min : float
        Smaller share of markers that are found: not a photo of this sensor.
    residual_max : float
        Largest median distance of markers from their places, over that of nearest neighbours of
        one colour, once the camera's motion is taken away.
    red_share : float
        Red of a tip above that at rest: share of what a switch adds,
    red_px, red_scatter : float
        and pixels and share of the red at rest by which it may be larger anyway.
    tip_min_px, tip_missing_max : float
        A tip that shows so much red at rest is missing below this share of it.
    marks_margin : int
        So many more spots than as designed must agree with a turned shell.
    noise_px : float
        Scatter of markers of a printed and painted shell, for the fit of the camera's motion.
    """

    area_min: float = 0.7
    area_max: float = 1.3
    missing_max: float = 0.1
    foreign_max: float = 0.3
    strength_min: float = 0.75
    off_share: float = 0.3
    off_px: float = 0.7
    pixels_min: float = 8.0
    found_min: float = 0.5
    residual_max: float = 0.1
    red_share: float = 0.3
    red_px: float = 3.0
    red_scatter: float = 0.1
    tip_min_px: float = 20.0
    tip_missing_max: float = 0.3
    marks_margin: int = 2
    noise_px: float = 0.1


SETTINGS = InspectionSettings()

ACTIONS = {
    "missing": "paint it {paint}",
    "wrong colour": "clean it and paint it {paint}",
    "other paint on it": "clean it and paint it {paint} again",
    "weak colour": "give it a second coat of {paint}",
    "too small": "paint the whole end face and band {paint}",
    "too large": "wipe paint off the wall and the tube's side",
    "runs into a neighbour": "wipe the paint between them off",
    "off centre": "clean it and paint it {paint} again",
    "tip shows at rest": "pull the switch back, or put in the one that the paint map shows here",
    "tip missing": "paint the tip red, or put in the switch that the paint map shows here",
    "shell turned": "turn the shell back, tighten it and take a new photo",
    "all too small": "paint whole end faces and bands; see whether the photo is in focus and lit",
    "all too large": "wipe paint off the wall and the tubes' sides; see whether the photo is sharp",
    "camera moved": "set the camera as designed and tighten its mount",
}
"""What to do about each mistake."""
INSERT_ACTIONS = {
    "missing": "push the {paint} insert in: {sprue}",
    "wrong colour": "take it out and push the {paint} one in: {sprue}",
    "other paint on it": "clean its end; else take it out and push the right one in: {sprue}",
    "weak colour": "clean its end, and see that nothing covers it",
    "too small": "push it in until its head lies in its seat; else it is too short: {sprue}",
    "too large": "it is too long: put in the right one: {sprue}",
    "runs into a neighbour": "clean the tubes' ends; see that it is the right one: {sprue}",
    "off centre": "push it in until its head lies in its seat; else it is another one: {sprue}",
    "all too small": "push the inserts in until their heads lie in their seats; see whether the "
    "photo is in focus and lit",
    "all too large": "see whether the photo is sharp, and whether the inserts are of this design",
}
"""What to do about each mistake of markers that are inserts; other mistakes are as above."""


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """One mistake of an assembly.

    Attributes
    ----------
    place : str
        Receptor by its number on the paint map (``row.column``), ``mark near.3``, or the whole.
    row, column : int or None
        Of the receptor, where the layout has rows.
    fault : str
        A key of ``ACTIONS``.
    measured, allowed, action : str
        What the photo shows, what it may show, and what to do.
    at_px : (float, float) or None
        Where, in the photo.
    camera : int
        Number of the photo.
    """

    place: str
    row: int | None = None
    column: int | None = None
    fault: str
    measured: str
    allowed: str
    action: str
    at_px: tuple[float, float] | None = None
    camera: int = 0


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """Result of an inspection.

    Attributes
    ----------
    step : str
        Assembly step that was inspected.
    mistakes : list of Mistake
        None in a good assembly.
    judged, spots : int
        Markers and reference marks that were judged, and those of the design.
    notes : list of str
        What the photos cannot show.
    """

    step: Step
    mistakes: list[Mistake]
    judged: int
    spots: int
    notes: list[str]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"ready": not self.mistakes, **asdict(self)}


@dataclass(frozen=True, kw_only=True)
class PaintAreas:
    """Paint of one image by spots (s markers and marks) and paints (k).

    Attributes
    ----------
    weight : (s, k) float
        Area, px, by coverage.
    strength : (s,) float
        Mean coverage of the spot's own paint.
    centroid_px : (s, 2) float
        Of the spot's own paint; NaN without.
    """

    weight: FloatArray
    strength: FloatArray
    centroid_px: FloatArray


class ExpectedPhoto:
    """What one camera should see after an assembly step.

    Parameters
    ----------
    sensor : Sensor
        The design.
    camera : Camera
        One of its cameras.
    step : {"painted", "assembled"}
        Before or after the switches are glued in.
    """

    def __init__(self, sensor: Sensor, camera: Camera, step: Step) -> None:
        markers, marks = sensor.markers, sensor.reference_marks
        self.sensor, self.camera, self.count = sensor, camera, markers.count
        self.model, classes = colour_model(sensor.design)
        self.colour = np.append(classes[markers.colour], np.full(marks.count, classes[0]))
        self.neighbours = with_marks(markers.neighbours, marks.neighbours)
        self.point_mm = np.concatenate([markers.tip_mm, marks.point_mm])
        fine = tolerance_mm(camera, markers)
        rest = build_scene(sensor, tolerance_mm=fine)
        if step == "painted":
            rest = rest.part_of(np.flatnonzero(red_owner(rest.part) < 0))
        owner = spot_owner(rasterise(rest, camera).part, markers.count)
        self.rest_px = owner_centroids(owner, len(self.colour))
        self.cell = _nearest_owner(owner)
        frame = self.model.prepared(render_frame(rest, camera))
        model = self.fitted(frame, self.colour)
        still = np.zeros((len(self.colour), 2))
        self.areas = paint_areas(frame, model, self, still)
        self.joined = joined_spots(segment(frame, model, with_labels=True), self, still)
        self.red_out_px = np.zeros(markers.count)
        self.red_cell: NDArray[np.int32] | None = None
        if step == "assembled" and sensor.design.has_switches:
            on = build_scene(
                sensor, tolerance_mm=fine, switch_on=np.ones(markers.count, dtype=np.bool_)
            )
            self.red_cell = _nearest_owner(red_owner(rasterise(on, camera).part))
            out = self.model.prepared(render_frame(on, camera))
            self.red_out_px = self.red(out, model, still)
        self.red_rest_px = self.red(frame, model, still)
        tips = TipModel(
            on_px=self.rest_px[: self.count],
            red_rest_px=self.red_rest_px,
            red_on_px=self.red_out_px,
        )
        self.readable = tips.readable

    @cached_property
    def judged(self) -> BoolArray:
        """Spots (s,) that show enough paint to be judged."""
        own = self.areas.weight[np.arange(len(self.colour)), self.colour]
        return np.asarray(own >= SETTINGS.pixels_min)

    def fitted(self, frame: ImageArray, colour: IntArray) -> ColourModel:
        """Colours as a photo shows them around spots of known paints (s,); see `fit_colours`."""
        seen = np.flatnonzero(np.isfinite(self.rest_px[:, 0]))
        place = self.rest_px[seen]
        gap = np.linalg.norm(place[:, None] - place[None], axis=2)
        np.fill_diagonal(gap, np.inf)
        half = np.clip(0.6 * gap.min(axis=1, initial=np.inf), 3.0, 60.0)
        step = np.linspace(-1.0, 1.0, 21)
        x, y = (
            np.clip(np.rint(place[:, k, None] + half[:, None] * step), 0, size - 1).astype(np.int64)
            for k, size in enumerate((frame.shape[1], frame.shape[0]))
        )
        pixels = frame[y[:, :, None], x[:, None, :]].reshape(len(seen), -1, 3)
        ycc = cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_BGR2YCrCb)
        chroma = ycc[:, :, 1:].astype(np.float64) - 128.0
        return fit_colours(self.model, chroma, colour[seen])

    def owner_at(
        self, cell: NDArray[np.int32], x: IntArray, y: IntArray, shift_px: FloatArray
    ) -> NDArray[np.int32]:
        """Spot (p,) of pixels in a photo whose spots are shifted by (s, 2)."""
        first = cell[y, x]
        step = np.rint(shift_px[first]).astype(np.int64)
        back = [
            np.clip(value - step[:, k], 0, size - 1)
            for k, (value, size) in enumerate(((x, cell.shape[1]), (y, cell.shape[0])))
        ]
        return np.asarray(cell[back[1], back[0]])

    def red(self, frame: ImageArray, model: ColourModel, shift_px: FloatArray) -> FloatArray:
        """Red area (n,) px by the tip that it belongs to; 0 where no tip is looked for."""
        if self.red_cell is None:
            return np.zeros(self.count)
        x, y, weight = _covered(frame, model, model.names.index("red"))
        owner = self.owner_at(self.red_cell, x, y, shift_px)
        return np.asarray(np.bincount(owner, weights=weight, minlength=self.count), np.float64)


def _nearest_owner(owner: NDArray[np.int32]) -> NDArray[np.int32]:
    """Owner of the nearest owned pixel of an owner image; one without owners is all 0."""
    free = (owner < 0).astype(np.uint8)
    if free.all():
        return np.zeros_like(owner)
    _, label = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    own = np.zeros(int(label.max()) + 1, dtype=np.int32)
    own[label[free == 0]] = owner[free == 0]
    return np.asarray(own[label])


def _covered(
    frame: ImageArray, model: ColourModel, paint: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Column, row and coverage of the pixels of a paint and of the edges around them."""
    classes, flat = model.classify(frame)
    mask = cv2.compare(classes, paint + 1, cv2.CMP_EQ)
    wide = cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5)))
    y, x = np.nonzero(wide)
    return x, y, model.coverage(flat[y, x], paint)


def paint_areas(
    frame: ImageArray, model: ColourModel, expected: ExpectedPhoto, shift_px: FloatArray
) -> PaintAreas:
    """Measure the paint of every spot, which are shifted by (s, 2) px in the frame."""
    size, paints = len(expected.colour), len(model.names)
    weight = np.zeros((size, paints))
    square, moment = np.zeros(size), np.zeros((size, 2))
    for paint in range(paints):
        x, y, part = _covered(frame, model, paint)
        owner = expected.owner_at(expected.cell, x, y, shift_px)
        weight[:, paint] = np.bincount(owner, weights=part, minlength=size)
        own = expected.colour == paint
        sums = (np.bincount(owner, weights=part * v, minlength=size) for v in (part, x, y))
        squared, *xy = (np.where(own, each, 0.0) for each in sums)
        square += squared
        moment += np.column_stack(xy)
    total = weight[np.arange(size), expected.colour]
    known = np.where(total > 0.0, total, np.nan)
    return PaintAreas(weight=weight, strength=square / known, centroid_px=moment / known[:, None])


def common_area(found: PaintAreas, expected: ExpectedPhoto) -> float:
    """Median area of the paint of all judged spots over the rendered one."""
    spots = np.flatnonzero(expected.judged)
    own = expected.colour[spots]
    return float(np.median(found.weight[spots, own] / expected.areas.weight[spots, own]))


def joined_spots(
    blobs: Blobs, expected: ExpectedPhoto, shift_px: FloatArray
) -> set[tuple[int, int]]:
    """Pairs of spots whose paint one blob holds, a quarter of each or more."""
    labels = np.asarray(blobs.labels, dtype=np.int64)
    y, x = np.nonzero(labels)
    blob = labels[y, x] - 1
    owner = expected.owner_at(expected.cell, x, y, shift_px)
    own = expected.colour[owner] == blobs.colour[blob]
    key = blob[own].astype(np.int64) * len(expected.colour) + owner[own]
    pair, pixels = np.unique(key, return_counts=True)
    whose, spot = np.divmod(pair, len(expected.colour))
    total = np.bincount(spot, weights=pixels, minlength=len(expected.colour))
    large = pixels >= 0.25 * total[spot]
    out = set()
    for number in np.flatnonzero(np.bincount(whose[large]) > 1):
        members = spot[large & (whose == number)].tolist()
        out |= {(a, b) for a in members for b in members if a < b}
    return out


def inspect(sensor: Sensor, photos: Sequence[ImageArray], step: Step) -> Inspection:
    """Compare photos of an assembly with its design.

    Parameters
    ----------
    sensor : Sensor
        The design.
    photos : sequence of (h, w, 3) uint8
        One of each camera, BGR, near end first; nothing presses the sensor.
    step : {"painted", "assembled"}
        Before or after the switches are glued in.

    Raises
    ------
    InputError
        If there are more or fewer photos than cameras, or one is none of this sensor.
    """
    if len(photos) != len(sensor.cameras):
        raise InputError(
            "photo-count",
            f"{sensor.design.name} has {len(sensor.cameras)} cameras (got {len(photos)} photos); "
            "give one photo of each, near end first",
        )
    names = spot_names(sensor)
    mistakes: list[Mistake] = []
    judged = np.zeros(len(names), dtype=np.bool_)
    blind = np.ones(sensor.markers.count, dtype=np.bool_)
    for number, (camera, photo) in enumerate(zip(sensor.cameras, photos, strict=True)):
        check_image(photo, width_px=camera.width_px, height_px=camera.height_px)
        expected = ExpectedPhoto(sensor, camera, step)
        frame = expected.model.prepared(photo)
        found = _turn(expected, frame) or _compare(expected, frame, names)
        mistakes += [replace(one, camera=number) for one in found]
        judged |= expected.judged
        blind &= ~expected.readable
    hidden = int(np.count_nonzero(~judged))
    notes = [f"{hidden} markers show too little paint in the photo to be judged"] if hidden else []
    if blind.any() and step == "assembled" and sensor.design.has_switches:
        notes.append(f"{int(blind.sum())} red tips look alike in and out, and are not judged")
    notes += whole_sprues(sensor, mistakes)
    turns = len(alike_turns(sensor))
    if turns > 1 and not sensor.reference_marks.count:
        notes.append(
            f"a shell turned by {360.0 / turns:g} degrees looks the same; align column 0 with the "
            "mount, or set reference_marks.count = 6"
        )
    return Inspection(
        step=step, mistakes=mistakes, judged=int(judged.sum()), spots=len(names), notes=notes
    )


def action_for(fault: str, *, inserts: bool) -> str:
    """What to do about a mistake of a marker that is painted, or an insert."""
    return (ACTIONS | INSERT_ACTIONS if inserts else ACTIONS)[fault]


def sprue_places(sensor: Sensor) -> dict[int, str]:
    """Sprue of each marker's insert and its number on it; empty for painted markers."""
    if not sensor.design.receptor.has_inserts:
        return {}
    return {
        marker: f"number {place} of sprue {sprue.label}"
        for sprue in plan_sprues(sensor)
        for place, marker in enumerate(sprue.markers, start=1)
    }


def whole_sprues(sensor: Sensor, mistakes: Sequence[Mistake]) -> list[str]:
    """Notes on sprues all of whose inserts show one fault: they were left out or mixed up."""
    if not sensor.design.receptor.has_inserts:
        return []
    names, seen = spot_names(sensor), {(one.place, one.fault) for one in mistakes}
    return [
        f"sprue {sprue.label}: {fault} at all of its {len(sprue.markers)} receptors"
        for sprue in plan_sprues(sensor)
        for fault in ("missing", "wrong colour")
        if len(sprue.markers) > 1 and all((names[k], fault) in seen for k in sprue.markers)
    ]


def spot_names(sensor: Sensor) -> list[str]:
    """Names of markers, then of reference marks, as the paint map prints them."""
    marks = sensor.reference_marks
    return [
        *marker_numbers(sensor.markers),
        *(
            f"mark {('near', 'far')[end]}.{number}"
            for end, number in zip(marks.end, marks.number, strict=True)
        ),
    ]


def alike_turns(sensor: Sensor, *, colours: bool = True) -> list[IntArray]:
    """Turns of the shell that map markers onto one another, of the same colour or of any."""
    markers = sensor.markers
    paint = markers.colour if colours else np.zeros_like(markers.colour)
    return symmetric_turns(sensor.surface.point(markers.uv), markers.tip_mm, paint)


def _turn(expected: ExpectedPhoto, frame: ImageArray) -> list[Mistake]:
    """Report a shell that sits turned by a step of its lattice, once; empty if it does not.

    Raises
    ------
    InputError
        If the paints of no turn stand out of the photo.
    """
    sensor, count = expected.sensor, expected.count
    turns = alike_turns(sensor, colours=False)
    paints = [np.append(expected.colour[order], expected.colour[count:]) for order in turns]
    scores, refusal = np.full(len(turns), -1), None
    known: dict[bytes, tuple[ColourModel, IntArray] | None] = {}
    for step, paint in enumerate(paints):
        key = paint.tobytes()
        if key not in known:
            try:
                model = expected.fitted(frame, paint)
                areas = paint_areas(frame, model, expected, np.zeros((len(paint), 2)))
                known[key] = (model, areas.weight[:count].argmax(axis=1))
            except InputError as error:
                refusal, known[key] = refusal or error, None
        fit = known[key]
        if fit is not None:
            model, shown = fit
            agree = expected.judged[:count] & (shown == paint[:count])
            scores[step] = np.count_nonzero(agree) + _marks_seen(
                expected, frame, model, step / len(turns)
            )
    best = int(scores.argmax())
    if scores[best] < 0 and refusal is not None:
        raise refusal
    if best == 0 or scores[best] < scores[0] + SETTINGS.marks_margin:
        return []
    angle = 360.0 * best / len(turns)
    angle = angle if angle <= 180.0 else angle - 360.0
    return [
        Mistake(
            place="shell",
            fault="shell turned",
            measured=f"{angle:g}° about +z",
            allowed="0°",
            action=ACTIONS["shell turned"],
        )
    ]


def _marks_seen(expected: ExpectedPhoto, frame: ImageArray, model: ColourModel, turn: float) -> int:
    """Number of reference marks that show paint after a turn, as a share of a whole one."""
    marks = expected.point_mm[expected.count :]
    if not len(marks):
        return 0
    blobs = segment(frame, model)
    place = expected.camera.project(marks @ axial_rotation(turn).T)
    still = expected.camera.project(marks)
    gap = np.linalg.norm(still[:, None] - still[None], axis=2)
    np.fill_diagonal(gap, np.inf)
    paint = blobs.centroid_px[blobs.colour == expected.colour[-1]]
    off = np.linalg.norm(place[:, None] - paint[None], axis=2).min(axis=1, initial=np.inf)
    return int(np.count_nonzero(off < 0.35 * gap.min()))


def _motion(expected: ExpectedPhoto, blobs: Blobs) -> tuple[FloatArray, list[Mistake]]:
    """Shifts (s, 2) px of all spots by the motion of the camera; a mistake if it is too large.

    Raises
    ------
    InputError
        If too few markers are found, or no motion explains where they are.
    """
    design, own = expected.sensor.design.name, expected.judged
    shown = np.where(own[:, None], expected.areas.centroid_px, np.nan)
    matched = match_markers(
        blobs, rest_px=shown, colour=expected.colour, neighbours=expected.neighbours
    )
    found = matched.found & ~matched.merged
    share = found.sum() / max(int(own.sum()), 1)
    away, moved = np.inf, np.zeros_like(shown)
    table = tabulate_camera_motion(
        (expected.camera,), np.zeros(len(own), dtype=np.int64), expected.point_mm, MOUNTS["bench"]
    )
    if share >= SETTINGS.found_min:
        step = np.where(found[:, None], matched.position_px - shown, 0.0)
        b = table.masked(np.repeat(found, 2)).estimate(step.reshape(-1), SETTINGS.noise_px)
        moved = table.shift_px(b).reshape(-1, 2)
        spacing = nearest_same_colour_px(shown[found], expected.colour[found])
        off = np.linalg.norm(step - moved, axis=1)[found]
        away = float(np.median(off / spacing))
    if away > SETTINGS.residual_max:
        raise InputError(
            "photo-of-another-sensor",
            f"found {int(found.sum())} of {int(own.sum())} markers where {design} has them"
            + (f", {100.0 * away:.0f} % of their spacing off" if np.isfinite(away) else "")
            + "; is this a photo of that sensor by its own camera, at rest, lit and in focus?",
        )
    allowed = np.linalg.norm(
        (table.sd[:, None] * table.first).reshape(-1, len(own), 2), axis=(0, 2)
    )
    far_px = float(np.median(np.linalg.norm(moved, axis=1)[own]))
    far_max_px = MOVED_SDS * float(np.median(allowed[own]))
    if far_px <= far_max_px:
        return moved, []
    moves = Mistake(
        place="camera",
        fault="camera moved",
        measured=f"markers are shifted by {far_px:.1f} px",
        allowed=f"at most {far_max_px:.1f} px",
        action=ACTIONS["camera moved"],
    )
    return moved, [moves]


def _compare(expected: ExpectedPhoto, frame: ImageArray, names: Sequence[str]) -> list[Mistake]:
    """Mistakes of one photo whose shell sits as designed."""
    model = expected.fitted(frame, expected.colour)
    blobs = segment(frame, model, with_labels=True)
    shift, mistakes = _motion(expected, blobs)
    tips = _tip_faults(expected, expected.red(frame, model, shift))
    found_areas = paint_areas(frame, model, expected, shift)
    common = common_area(found_areas, expected)
    if not SETTINGS.area_min <= common <= SETTINGS.area_max:
        kind = "all too small" if common < 1.0 else "all too large"
        mistakes.append(
            Mistake(
                place="paint",
                fault=kind,
                measured=f"{_percent(common)} in the median",
                allowed=f"{_percent(SETTINGS.area_min)} to {_percent(SETTINGS.area_max)}",
                action=action_for(kind, inserts=expected.sensor.design.receptor.has_inserts),
            )
        )
    paint = _paint_faults(expected, found_areas, model, blobs, shift, names)
    sprues = sprue_places(expected.sensor)
    for spot in range(len(names)):
        found = paint.get(spot)
        # A tip that is out covers paint.
        if found and spot in tips and found[0] in {"too small", "off centre"}:
            found = None
        mistakes += [
            _mistake(expected, names, spot, one, shift[spot], sprues.get(spot, ""))
            for one in (found, tips.get(spot))
            if one
        ]
    return mistakes


def _tip_faults(expected: ExpectedPhoto, red_px: FloatArray) -> dict[int, Fault]:
    """Faults of red tips by receptor, from the red (n,) px of each."""
    if expected.red_cell is None:
        return {}
    rest, seen = expected.red_rest_px, expected.red_rest_px >= SETTINGS.tip_min_px
    if seen.sum() >= TIPS_FOR_LIGHT:
        red_px = red_px / np.clip(np.median(red_px[seen] / rest[seen]), *RED_SEEN_RANGE)
    limit = rest + np.maximum(
        SETTINGS.red_share * (expected.red_out_px - rest),
        SETTINGS.red_px + SETTINGS.red_scatter * rest,
    )
    shows = np.flatnonzero((red_px > limit) & expected.readable)
    gone = np.flatnonzero(seen & (red_px < SETTINGS.tip_missing_max * rest))
    return {
        k: ("tip shows at rest", f"{red_px[k]:.0f} px red", f"at most {limit[k]:.0f} px")
        for k in shows.tolist()
    } | {
        k: (
            "tip missing",
            f"{red_px[k]:.0f} px red",
            f"at least {SETTINGS.tip_missing_max * rest[k]:.0f} px",
        )
        for k in gone.tolist()
    }


def _paint_faults(
    expected: ExpectedPhoto,
    found: PaintAreas,
    model: ColourModel,
    blobs: Blobs,
    shift_px: FloatArray,
    names: Sequence[str],
) -> dict[int, Fault]:
    """Faults of the paint of markers and marks by spot, at most one each."""
    limits = SETTINGS
    every, own, names_of = np.arange(len(expected.colour)), expected.colour, model.names
    wanted = np.maximum(expected.areas.weight[every, own], 1e-9)
    area = found.weight[every, own] / wanted
    area /= common_area(found, expected)
    strength = found.strength / expected.areas.strength
    strength /= np.nanmedian(strength[expected.judged])
    other = found.weight - expected.areas.weight
    other[every, own] = 0.0
    if expected.red_cell is not None:
        other[:, model.names.index("red")] = 0.0
    foreign, whose = other.max(axis=1) / wanted, other.argmax(axis=1)
    off = np.linalg.norm(found.centroid_px - expected.areas.centroid_px - shift_px, axis=1)
    off_max = limits.off_share * np.sqrt(wanted / np.pi) + limits.off_px
    beside = {
        (a if area[a] >= area[b] else b): (b if area[a] >= area[b] else a)
        for a, b in joined_spots(blobs, expected, shift_px) - expected.joined
    }

    least, most = (f"at least {_percent(limits.area_min)}", f"at most {_percent(limits.area_max)}")
    faults: dict[int, Fault] = {}
    for k in np.flatnonzero(expected.judged).tolist():
        shown, strange, name = (
            _percent(area[k]),
            foreign[k] > limits.foreign_max,
            names_of[whose[k]],
        )
        none = area[k] < limits.missing_max
        # The first that holds is reported.
        checks = (
            (strange and none, "wrong colour", name, names_of[own[k]]),
            (
                strange,
                "other paint on it",
                f"{_percent(foreign[k])} {name}",
                f"at most {_percent(limits.foreign_max)}",
            ),
            (none, "missing", shown, least),
            (
                k in beside and area[k] > 1.0,
                "runs into a neighbour",
                f"one blob with {names[beside.get(k, 0)]}",
                "apart",
            ),
            (
                strength[k] < limits.strength_min,
                "weak colour",
                _percent(strength[k]),
                f"at least {_percent(limits.strength_min)}",
            ),
            (area[k] < limits.area_min, "too small", shown, least),
            (area[k] > limits.area_max, "too large", shown, most),
            (off[k] > off_max[k], "off centre", f"{off[k]:.1f} px", f"at most {off_max[k]:.1f} px"),
        )
        first = next((check for check in checks if check[0]), None)
        if first is not None:
            faults[k] = first[1:]
    return faults


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def _mistake(
    expected: ExpectedPhoto,
    names: Sequence[str],
    spot: int,
    fault: Fault,
    shift_px: FloatArray,
    sprue: str = "",
) -> Mistake:
    """Mistake of one spot: kind, measured, allowed; ``sprue`` is where its insert is, if any."""
    markers = expected.sensor.markers
    rows = spot < markers.count and markers.in_rows
    at = expected.rest_px[spot] + shift_px
    kind, measured, allowed = fault
    return Mistake(
        place=names[spot],
        row=int(markers.row[spot]) if rows else None,
        column=int(markers.column[spot]) if rows else None,
        fault=kind,
        measured=measured,
        allowed=allowed,
        action=action_for(kind, inserts=bool(sprue)).format(
            paint=expected.model.names[expected.colour[spot]], sprue=sprue
        ),
        at_px=(float(at[0]), float(at[1])) if np.isfinite(at).all() else None,
    )


def annotated(photo: ImageArray, mistakes: Sequence[Mistake]) -> ImageArray:
    """Photo with a ring around each mistake, and its place and kind beside it."""
    out = photo.copy()
    size = max(out.shape[0] / 1000.0, 0.5)
    radius, width = round(22.0 * size), max(1, round(2.0 * size))
    for one in mistakes:
        text, at = f"{one.place} {one.fault}", (10, round(30.0 * size))
        if one.at_px is not None:
            x, y = (round(value) for value in one.at_px)
            cv2.circle(out, (x, y), radius, (0, 255, 255), width, cv2.LINE_AA)
            long = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6 * size, width)[0][0]
            left = x + radius + long > out.shape[1]
            at = (x - radius - long if left else x + radius, y)
        cv2.putText(
            out, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.6 * size, (0, 255, 255), width, cv2.LINE_AA
        )
    return out
