"""What the decoder expects to see of a sensor as designed, without forces."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.vision.marker_edges import MarkerEdges
from phytac_decoder.vision.matching import Matched, match_markers
from phytac_decoder.vision.reference_marks import ReferenceMarks, with_marks
from phytac_decoder.vision.segmentation import Blobs, ColourModel, segment
from phytac_decoder.vision.switch_detection import TipCovers, TipModel
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import cameras_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.exposure import CLEAN, expose, lens_blur, light_on_chip
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.light import triangle_light
from phytac_design.optics.paint import paints_of, resin_of
from phytac_design.optics.raster import owner_sums, rasterise
from phytac_design.optics.render_scene import RenderScene, build_scene, red_owner
from phytac_design.optics.visibility import (
    MarkVisibility,
    Visibility,
    best_of,
    mark_visibility,
    measure_visibility,
)
from phytac_design.simulation.imaging.paint_centroids import PaintPoints
from phytac_design.simulation.imaging.tip_covers import as_detected, exact_covers
from phytac_design.simulation.imaging.virtual_camera import bar_strip
from phytac_design.simulation.linear_response import rigid_slope
from phytac_design.simulation.switch_law import switch_law
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray, IntArray
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class ExpectedView:
    """Expectations over n markers, measured in frames by the decoder's segmentation.

    The frames are sharp, but for the shift by a tip (see :func:`look`).

    Attributes
    ----------
    rest_px : (n, 2) float
        Marker positions with all switches off.
    tip_bias_px : (n, 2) float
        Shift of a marker's centroid by its red tip alone: the tip covers some of its paint.
    tips : TipModel
        Red of each tip.
    marks_px : (r, 2) float
        Positions of reference marks; NaN where not found.
    """

    rest_px: FloatArray
    tip_bias_px: FloatArray
    tips: TipModel
    marks_px: FloatArray


def colour_model(design: Design) -> tuple[ColourModel, IntArray]:
    """Colour model of the paints in use, and the class of each of the design's colours."""
    names = (*dict.fromkeys(design.layout.colours), "red")
    wall = resin_of(names, design.paints)
    model = ColourModel.from_rgb(paints_of(names, design.paints), wall=wall)
    return model, np.array([names.index(name) for name in design.layout.colours])


def measure_expected(
    sensor: Sensor,
    *,
    rest_frame: ImageArray,
    on_frame: ImageArray,
    marker_px: FloatArray,
    red_px: FloatArray,
    mark_px: FloatArray,
) -> ExpectedView:
    """Measure rest positions, tip bias and red areas in two noise-free frames.

    Parameters
    ----------
    rest_frame, on_frame : (h, w, 3) uint8
        All switches off, all on.
    marker_px, red_px : (n, 2) float
        Exact centroids of the visible paint at rest, and of the visible red with switches on
        (NaN where none), from the ID map.
    mark_px : (r, 2) float
        The same of the reference marks.
    """
    n = sensor.markers.count
    model = colour_model(sensor.design)[0]
    rest_frame, on_frame = model.prepared(rest_frame), model.prepared(on_frame)
    expected_px = np.concatenate([marker_px, mark_px])
    seen = [matched(sensor, frame, expected_px) for frame in (rest_frame, on_frame)]
    rest = np.where(seen[0].found[:n, None], seen[0].position_px[:n], marker_px)
    bias = np.nan_to_num(seen[1].position_px[:n] - rest)
    red = model.names.index("red")
    rest_area = _red_area(segment(rest_frame, model, area_min_px=1), red, red_px)
    on_area = _red_area(segment(on_frame, model, area_min_px=1), red, red_px)
    return ExpectedView(
        rest_px=rest,
        tip_bias_px=bias,
        tips=TipModel(on_px=red_px, red_rest_px=rest_area, red_on_px=on_area),
        marks_px=seen[0].position_px[n:],
    )


def matched(sensor: Sensor, prepared: ImageArray, expected_px: FloatArray) -> Matched:
    """Markers and marks, expected at (n + r, 2), in a frame prepared for the decoder's detector."""
    markers, marks = sensor.markers, sensor.reference_marks
    model, classes = colour_model(sensor.design)
    return match_markers(
        segment(prepared, model),
        rest_px=expected_px,
        colour=classes[np.append(markers.colour, np.zeros(marks.count, dtype=np.int64))],
        neighbours=with_marks(markers.neighbours, marks.neighbours),
    )


def _red_area(blobs: Blobs, red: int, red_px: FloatArray) -> FloatArray:
    """Red area (n,) near each expected tip: every red blob counts for the nearest."""
    area = np.zeros(len(red_px))
    pick = np.flatnonzero(blobs.colour == red)
    known = np.flatnonzero(np.isfinite(red_px[:, 0]))
    if len(pick) == 0 or len(known) == 0:
        return area
    gap = blobs.centroid_px[pick, None] - red_px[known][None]
    nearest = known[np.argmin(np.linalg.norm(gap, axis=2), axis=1)]
    np.add.at(area, nearest, blobs.weight[pick])
    return area


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What one camera sees at rest and with all switches on.

    Attributes
    ----------
    camera : Camera
        The camera.
    rest, on : RenderScene
        The sensor with all switches off, and on.
    frames : (at rest, all on)
        Noise-free frames.
    part : (h, w) int32
        Part code at each pixel centre, at rest.
    seen : Visibility
        Of the markers.
    marks : MarkVisibility
        Of the reference marks.
    expected : ExpectedView
        What the decoder's marker detector finds in the frames.
    covers : TipCovers
        Tips that cover the paint of other markers, in frames through the lens.
    found_px : (n, 2) float
        Positions of the markers that the detector finds in the frame at rest.
    """

    camera: Camera
    rest: RenderScene
    on: RenderScene
    frames: tuple[ImageArray, ImageArray]
    part: NDArray[np.int32]
    seen: Visibility
    marks: MarkVisibility
    expected: ExpectedView
    covers: TipCovers
    found_px: FloatArray

    def positions(self, sensor: Sensor, frame: ImageArray) -> FloatArray:
        """Positions (n, 2) px of the markers that the detector finds in a frame."""
        expected_px = np.concatenate([self.expected.rest_px, self.expected.marks_px])
        prepared = colour_model(sensor.design)[0].prepared(frame)
        return matched(sensor, prepared, expected_px).position_px[: sensor.markers.count]

    def read(self, sensor: Sensor) -> Callable[[ImageArray], FloatArray]:
        """Positions (n, 2) px of the markers in a frame with all switches off, as they are decoded.

        Those of small markers by their edges too, against the frame at rest.
        """
        rest_px = self.found_px
        model, off = colour_model(sensor.design)[0], np.zeros(sensor.markers.count, dtype=np.bool_)
        area_px = self.seen.visible_px.astype(np.float64)
        edges = MarkerEdges.at_rest(self.frames[0], model, rest_px, area_px)

        def positions(frame: ImageArray) -> FloatArray:
            found = self.positions(sensor, frame)
            return rest_px + edges.combined(frame, found - rest_px, off, off) if edges else found

        return positions


def look(
    sensor: Sensor, camera: Camera, *, noise_std: float = 0.0, rng: np.random.Generator
) -> Shot:
    """Look through one camera of a sensor as designed.

    A marker that shows nowhere is expected where its tip would be, as long as no other camera may
    see it, else nowhere (NaN). ``noise_std`` is that of the frame that decides on fusion. What tips
    do to centroids is measured in frames through the lens of the design, all else in sharp ones.
    """
    markers = sensor.markers
    tolerance = tolerance_mm(camera, markers)
    rest, on = (
        build_scene(sensor, tolerance_mm=tolerance, switch_on=np.full(markers.count, state))
        for state in (False, True)
    )
    both = at_rest, all_on = rasterise(rest, camera), rasterise(on, camera)
    frames = (render_frame(rest, camera), render_frame(on, camera))
    seen = measure_visibility(
        rest, on, camera, noise_std=noise_std, rng=rng, both=both, frame=frames[0]
    )
    away = camera.project(markers.tip_mm) if len(sensor.cameras) == 1 else np.nan
    place = np.where(seen.lost[:, None], away, seen.centroid_px)
    marks = mark_visibility(sensor, rest, camera, frames[0], buffers=at_rest)
    expected = measure_expected(
        sensor,
        rest_frame=frames[0],
        on_frame=frames[1],
        marker_px=place,
        red_px=owner_centroids(red_owner(all_on.part), markers.count),
        mark_px=np.where(marks.clear[:, None], marks.centroid_px, np.nan),
    )
    expected = replace(expected, rest_px=np.where(seen.lost[:, None], place, expected.rest_px))
    shot = Shot(
        camera=camera,
        rest=rest,
        on=on,
        frames=frames,
        part=at_rest.part,
        seen=seen,
        marks=marks,
        expected=expected,
        covers=exact_covers(at_rest.part, all_on.part, markers.count),
        found_px=np.empty((0, 2)),
    )
    shot = replace(shot, found_px=shot.positions(sensor, frames[0]))
    if not sensor.design.has_switches:
        return shot
    return _with_tips(sensor, shot, _lens_of(sensor, camera))


def _lens_of(sensor: Sensor, camera: Camera) -> Callable[[RenderScene], ImageArray]:
    """Noise-free frames of a scene through the design's lens; without blur if it has no focus."""
    samples = 24  # per pixel, each through its own point of the lens
    strip = bar_strip(sensor)
    try:
        blur = lens_blur(sensor, camera)
    except DesignError:
        blur = None

    def frame(scene: RenderScene) -> ImageArray:
        sent = triangle_light(scene, camera, strip=strip)
        light = light_on_chip(scene, camera, light=sent, blur=blur, samples=samples)
        return expose(light, camera, CLEAN)

    return frame


def _with_tips(sensor: Sensor, shot: Shot, lens: Callable[[RenderScene], ImageArray]) -> Shot:
    """The same with what tips do to centroids in frames through the lens.

    Blur mixes a tip's colour with that of the paint beside it, so that in a sharp frame its bias
    would be 0.1 px off, and beside a rim 0.35 px (``cylinder60``).
    """
    tolerance, count = tolerance_mm(shot.camera, sensor.markers), sensor.markers.count
    all_on = np.ones(count, dtype=np.bool_)
    rest_px = shot.positions(sensor, lens(shot.rest))

    def detect(out: BoolArray) -> FloatArray:
        if not out.any():
            return rest_px
        scene = build_scene(sensor, tolerance_mm=tolerance, switch_on=out)
        return shot.positions(sensor, lens(scene))

    covers = as_detected(shot.covers, count, detect)
    bias = shot.positions(sensor, lens(shot.on)) - rest_px
    bias = np.where(np.isfinite(bias), bias, shot.expected.tip_bias_px)
    own = bias - covers.shift(all_on)
    return replace(shot, covers=covers, expected=replace(shot.expected, tip_bias_px=own))


def view_arrays(sensor: Sensor, shots: Sequence[Shot]) -> tuple[Visibility, dict[str, Any]]:
    """Each marker's best view, and the arrays of the stage ``views`` that detection needs."""
    markers = sensor.markers
    best, number = best_of([shot.seen for shot in shots])
    rest = [
        # What no camera sees is expected where its tip would be.
        np.where(
            (best.lost & (number == k))[:, None],
            shot.camera.project(markers.tip_mm),
            shot.expected.rest_px,
        )
        for k, shot in enumerate(shots)
    ]
    tips = [shot.expected.tips for shot in shots]
    bias = np.stack([shot.expected.tip_bias_px for shot in shots])
    visible = np.stack([shot.marks.clear * shot.marks.visible_px for shot in shots])
    read = [number[shot.covers.marker] == k for k, shot in enumerate(shots)]
    covers = {
        f"cover_{name}": [
            getattr(shot.covers, name)[mine] for shot, mine in zip(shots, read, strict=True)
        ]
        for name in ("marker", "tip", "shift_px")
    }
    mark_camera, own = visible.argmax(axis=0), np.arange(visible.shape[1])
    return best, {
        "mark_camera": mark_camera,
        "mark_visible_px": np.stack([shot.marks.visible_px for shot in shots]).max(axis=0),
        "mark_clear": visible.max(axis=0) > 0,
        "mark_rest_px": np.stack([shot.expected.marks_px for shot in shots])[mark_camera, own],
        "camera": number,
        "tip_bias_px": bias[number, np.arange(markers.count)],
        **{name: np.concatenate(rows) for name, rows in covers.items()},
        "shown_rest_px": np.stack(rest),
        "shown_tip_on_px": np.stack([tip.on_px for tip in tips]),
        "shown_tip_red_rest_px": np.stack([tip.red_rest_px for tip in tips]),
        "shown_tip_red_on_px": np.stack([tip.red_on_px for tip in tips]),
    }


def expected_views(sensor: Sensor) -> dict[str, Any]:
    """What the design's cameras show: the arrays of the stage ``views`` that detection needs."""
    rng = np.random.default_rng(0)
    shots = [look(sensor, camera, rng=rng) for camera in sensor.cameras]
    return view_arrays(sensor, shots)[1]


def paint_slope(
    sensor: Sensor, camera: Camera, *, rest: RenderScene, seen: Visibility
) -> FloatArray:
    """How each marker's image moves with the wall under it, (n, 2, 6): px per mm, px per rad.

    Of the paint that faces the camera; where none does, of the point that is watched.

    Parameters
    ----------
    rest, seen : Scene, Visibility
        Of this camera, at rest.
    """
    design, markers = sensor.design, sensor.markers
    colours, classes = colour_model(design)
    paint = PaintPoints(
        rest,
        camera,
        markers,
        chosen=~seen.lost,
        colours=colours,
        colour=classes[markers.colour],
        strip=bar_strip(sensor),
    ).slope()
    watched = np.where(seen.lost[:, None], markers.tip_mm, seen.paint_point_mm)
    point = rigid_slope(camera.jacobian(watched), watched - markers.mid_mm)
    known = np.isfinite(paint).all(axis=(1, 2), keepdims=True)
    return np.asarray(np.where(known, paint, point))


def paint_slopes(sensor: Sensor, each: Sequence[Visibility]) -> FloatArray:
    """:func:`paint_slope` through every camera (c, n, 2, 6), of what ``each`` sees at rest."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    slopes = []
    for camera, seen in zip(cameras_of(design, surface), each, strict=True):
        tolerance = tolerance_mm(camera, markers)
        rest = build_scene(sensor, tolerance_mm=tolerance)
        slopes.append(paint_slope(sensor, camera, rest=rest, seen=seen))
    return np.stack(slopes)


def owner_centroids(owner: NDArray[np.int32], count: int) -> FloatArray:
    """Centroid (n, 2) px of each marker's pixels in an owner image, NaN where none."""
    sums = owner_sums(owner, count)
    return np.asarray(sums[:, 1:] / np.where(sums[:, :1] > 0.0, sums[:, :1], np.nan))


def bundle_marks(sensor: Sensor, views: Mapping[str, Any]) -> ReferenceMarks:
    """Reference marks as a bundle holds them."""
    marks, (_, classes) = sensor.reference_marks, colour_model(sensor.design)
    return ReferenceMarks(
        point_mm=marks.point_mm,
        colour=np.full(marks.count, classes[0]),
        rest_px=views["mark_rest_px"],
        read_by=views["mark_camera"],
        neighbours=marks.neighbours,
    )


def bundle_covers(views: Mapping[str, Any]) -> TipCovers:
    """Tips that cover other markers, as a bundle holds them."""
    return TipCovers(
        marker=views["cover_marker"], tip=views["cover_tip"], shift_px=views["cover_shift_px"]
    )


def vision_bundle(
    sensor: Sensor, views: Mapping[str, Any], *, compliance_px: FloatArray | None = None
) -> Bundle:
    """Bundle of a design that sees; without ``compliance_px`` (2n, n) no force comes of it.

    Parameters
    ----------
    views : mapping
        Arrays of the stage ``views``, or of :func:`expected_views`.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    n, law = markers.count, switch_law(design, markers)
    colours, classes = colour_model(design)
    read_by = np.asarray(views["camera"])
    shown = tuple(
        CameraView(
            rest_px=rest,
            tips=TipModel(on_px=on, red_rest_px=off, red_on_px=out, gradual=law.gradual),
        )
        for rest, on, off, out in zip(
            views["shown_rest_px"],
            views["shown_tip_on_px"],
            views["shown_tip_red_rest_px"],
            views["shown_tip_red_on_px"],
            strict=True,
        )
    )

    def own(each: list[FloatArray]) -> FloatArray:
        return np.asarray(np.stack(each)[read_by, np.arange(n)])

    nothing = np.zeros(1)
    return Bundle(
        design=design.name,
        design_hash="",
        cameras=cameras_of(design, surface),
        read_by=read_by,
        colours=colours,
        colour=classes[markers.colour],
        position_mm=surface.point(markers.uv),
        head_mm=markers.tip_mm,
        rest_px=own([item.rest_px for item in shown]),
        tip_bias_px=views["tip_bias_px"],
        covers=bundle_covers(views),
        tips=TipModel(
            on_px=own([item.tips.on_px for item in shown]),
            red_rest_px=own([item.tips.red_rest_px for item in shown]),
            red_on_px=own([item.tips.red_on_px for item in shown]),
            gradual=law.gradual,
        ),
        model=ForceModel(
            shift_to_mm=np.zeros((n, 2)),
            stiffness=np.broadcast_to(nothing, (n, n)),
            compliance_px=(
                np.broadcast_to(nothing, (2 * n, n)) if compliance_px is None else compliance_px
            ),
            height_z_mm=markers.mid_mm[:, 2].copy(),
            neighbours=markers.neighbours,
            networks={},
        ),
        threshold_N=law.on_N,
        noise_centroid_px=design.camera.noise_centroid_px,
        force_max_N=design.training.force_max_N,
        shown=shown,
    )
