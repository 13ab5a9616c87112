"""What the camera sees: visibility of every marker, pictures, and the straight layout beside."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from phytac_decoder.vision.switch_detection import RED_RATIO_MIN, RED_AREA_MIN_px, TipModel
from phytac_design.design.spec import Design
from phytac_design.engine.stage import (
    Context,
    Stage,
    export_path,
    thumbnail_path,
    write_arrays,
    write_facts,
)
from phytac_design.layout.cameras import stand_off_mm, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_of
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.render_scene import build_scene, paint_owner
from phytac_design.optics.sharpness import lens_facts
from phytac_design.optics.visibility import (
    Visibility,
    best_of,
    check_visibility,
    marks_advice,
    visibility_advice,
)
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES
from phytac_design.simulation.imaging.nominal_view import Shot, look, paint_slope, view_arrays
from phytac_design.simulation.imaging.predicted_noise import predict_noise
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import DesignError


def write_image(path: Path, image: ImageArray) -> None:
    """Write a PNG (BGR)."""
    # Runs of equal bytes alone are found: six times as fast for a frame with noise, 10 % smaller.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 3, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    # One filter for all rows, twice as fast as the best for each, up to 5 % larger.
    if hasattr(cv2, "IMWRITE_PNG_FILTER"):
        how += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_UP]
    # OpenCV's own writing says nothing of a full disk and leaves half a picture.
    path.write_bytes(bytes(cv2.imencode(".png", image, how)[1]))


def write_view(folder: Path, name: str, image: ImageArray) -> None:
    """Export a picture (BGR) as ``views/NAME``, a PNG; a small one is kept for the report."""
    write_image(export_path(folder, f"views/{name}"), image)
    wide = 900
    size = (wide, round(image.shape[0] * wide / image.shape[1]))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    path = thumbnail_path(folder, name)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]))


def id_picture(part: Any) -> ImageArray:
    """ID map as colours: neighbours in number get far hues, background black."""
    owner = paint_owner(part)
    number = np.arange(-1, int(owner.max(initial=-1)) + 1)
    hsv = np.stack([number * 67 % 180, np.full_like(number, 200), np.where(number < 0, 0, 255)], 1)
    table = cv2.cvtColor(hsv[None].astype(np.uint8), cv2.COLOR_HSV2BGR)[0]
    return np.asarray(table[owner + 1])


def _noise(sensor: Sensor, shot: Shot, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Noise (n, 2) px of shifts of markers in one camera, see :func:`predict_noise`."""
    return predict_noise(
        shot.rest,
        shot.camera,
        shot.read(sensor),
        clean=shot.frames[0],
        point_mm=np.where(shot.seen.lost[:, None], sensor.markers.tip_mm, shot.seen.paint_point_mm),
        neighbours=sensor.markers.neighbours,
        noise_std=sensor.design.camera.noise_pixel,
        rng=rng,
    )


def summary_of(
    seen: Visibility, red_rest_px: FloatArray, red_on_px: FloatArray, *, switches: bool
) -> dict[str, float]:
    """Summary of what is seen; its unreadable switches are those of the decoder.

    Red areas (n,) are those that the decoder's segmentation finds in rendered frames; counts of
    exact pixels (``phytac check``) differ by a few switches.
    """
    summary = seen.summary(switches=switches)
    if switches:
        tips = TipModel(on_px=seen.centroid_px, red_rest_px=red_rest_px, red_on_px=red_on_px)
        summary["switch_unreadable"] = int((~tips.readable).sum())
    return summary


def red_of(context: Context, arrays: dict[str, Any]) -> dict[str, Any]:
    """Red pixels of the tips in the camera against the decoder's minimum, at the weakest switch.

    The image uses the design's stroke. A bowl's own stroke is at least that; other families come
    out as the force grows, and their thresholds are taken where their red is enough.
    """
    rest, out = arrays["tip_red_rest_px"], arrays["tip_red_on_px"]
    needed = RED_RATIO_MIN * rest + RED_AREA_MIN_px
    worst = int(np.argmin(out - needed))
    from_camera = context.markers.tip_mm - context.sensor.cameras[0].position_mm
    far = int(np.argmax(np.linalg.norm(from_camera, axis=1)))
    return {
        "worst_marker": context.markers.name(worst),
        "worst_on_px": float(out[worst]),
        "worst_needed_px": float(needed[worst]),
        "farthest_marker": context.markers.name(far),
        "farthest_on_px": float(out[far]),
        "farthest_needed_px": float(needed[far]),
        "unreadable": int((out <= needed).sum()),
    }


def run_views(context: Context, folder: Path) -> None:
    """Visibility, density, expectations of the marker detector, and pictures."""
    design, surface, markers = context.design, context.surface, context.markers
    rng = np.random.default_rng(context.seed)
    sensor = context.sensor
    noise = design.camera.noise_pixel
    shots = [look(sensor, camera, noise_std=noise, rng=rng) for camera in sensor.cameras]
    best, arrays = view_arrays(sensor, shots)
    camera = arrays["camera"]

    def picked(values: Any) -> FloatArray:
        return np.asarray(np.stack(values)[camera, np.arange(markers.count)])

    points = [
        np.where(shot.seen.lost[:, None], markers.tip_mm, shot.seen.paint_point_mm)
        for shot in shots
    ]
    slopes = [paint_slope(sensor, shot.camera, rest=shot.rest, seen=shot.seen) for shot in shots]
    rest_px = picked(arrays["shown_rest_px"])
    arrays |= asdict(best) | {
        "paint_point_mm": picked(points),
        "paint_slope": picked(slopes),
        "paint_slopes": np.stack(slopes),
        "seen_by": np.stack([~shot.seen.occluded for shot in shots]),
        "rest_px": rest_px,
        "tip_on_px": picked(arrays["shown_tip_on_px"]),
        "tip_red_rest_px": picked(arrays["shown_tip_red_rest_px"]),
        "tip_red_on_px": picked(arrays["shown_tip_red_on_px"]),
    }
    noise_px = [_noise(sensor, shot, rng) for shot in shots]
    arrays["noise_still_px"], arrays["noise_moved_px"] = (
        np.where(np.isfinite(each), each, design.camera.noise_centroid_px)
        for each in map(picked, zip(*noise_px, strict=True))
    )
    write_arrays(folder, arrays)
    switches = design.has_switches
    if context.scene is None or context.scene.pictures:
        context.progress("views: pictures")
        for shot, mark in zip(shots, CAMERA_SUFFIXES, strict=False):
            off, on = shot.frames
            pictures = {"camera{}": off, "camera{}_all_on": on, "ids{}": id_picture(shot.part)}
            for name, picture in pictures.items():
                write_view(folder, f"{name.format(mark)}.png", picture)
    error = np.linalg.norm(rest_px - best.centroid_px, axis=1)[~best.lost]
    write_facts(
        folder,
        {
            "visibility": summary_of(
                best, arrays["tip_red_rest_px"], arrays["tip_red_on_px"], switches=switches
            ),
            "red": red_of(context, arrays) if switches else {},
            "density": asdict(density_of(surface, markers)),
            "stand_off_mm": stand_off_mm(design, surface, shots[0].camera),
            "cameras": [
                {
                    "end": "far" if end else "near",
                    "stand_off_mm": stand_off_mm(design, surface, shot.camera),
                    "best_for": int((camera == number).sum()),
                    "visibility": summary_of(
                        shot.seen,
                        shot.expected.tips.red_rest_px,
                        shot.expected.tips.red_on_px,
                        switches=switches,
                    ),
                    "lens": lens_facts(context.sensor, shot.camera),
                }
                for number, (end, shot) in enumerate(
                    zip(design.camera.end_numbers, shots, strict=True)
                )
            ],
            "centroid_bias_px": float(np.sqrt((error**2).mean())),
        },
    )


def told_apart(context: Context) -> str:
    """Reason to stop if markers are hidden or fuse at rest; "" if all are seen.

    In a scene, of those in play.
    """
    views, scope = context.arrays("views"), scope_of(context)
    counted = np.ones(context.markers.count, dtype=np.bool_)
    if scope is not None:
        counted = scope.in_play(context.markers)
    occluded = np.flatnonzero(views["occluded"] & counted)
    fused = np.flatnonzero(views["fused"] & counted)
    reasons = [
        visibility_advice(context.design, context.markers, occluded, fused, views["hidden_by"]),
        marks_advice(context.sensor, views["mark_clear"], views["mark_visible_px"]),
    ]
    return "; ".join(filter(None, reasons))


def straight_of(design: Design) -> Design:
    """The same design with its rows lined up: the paper's comparison case."""
    layout = design.layout.model_copy(update={"kind": "straight"})
    return design.model_copy(update={"layout": layout})


def run_compare(context: Context, folder: Path) -> None:
    """Visibility of the straight layout with the same counts, and its picture, for spirals."""
    if context.design.layout.kind != "spiral":
        write_facts(folder, {"straight": None})
        return
    sensor = Sensor(straight_of(context.design))
    try:
        markers = sensor.markers
    except DesignError as error:  # straight rows of so many have no line of sight at any height
        write_facts(folder, {"straight": None, "why": str(error)})
        return
    rng = np.random.default_rng(context.seed)
    each: list[Visibility] = []
    for camera in sensor.cameras:
        scene = build_scene(sensor, tolerance_mm=tolerance_mm(camera, markers))
        picture = render_frame(scene, camera)
        if not each:
            write_view(folder, "straight.png", picture)
        each.append(check_visibility(sensor, rng=rng, camera=camera, frame=picture))
    straight = best_of(each)[0].summary()
    del straight["switch_unreadable"]  # counted by exact pixels, see :func:`summary_of`
    write_facts(folder, {"straight": straight})


VIEWS = Stage(
    name="views",
    design_fields=(
        "pictures",
        "camera.f_number",
        "camera.pixel_um",
        "camera.focus_mm",
        "camera.noise_centroid_px",
    ),
    seeded=True,
    scene=("pictures",),
    gate=told_apart,
    run=run_views,
)
COMPARE = Stage(
    name="compare",
    design_fields=("pictures",),
    seeded=True,
    only_with="tools",
    run=run_compare,
)
