"""What the camera sees: visibility of every marker, pictures, and the straight layout beside."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, Stage, export_path, write_arrays, write_facts
from phytac_design.layout.cameras import stand_off_mm, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_of
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.lens_facts import lens_facts
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import build_scene, paint_owner, red_owner
from phytac_design.optics.visibility import (
    Visibility,
    best_of,
    check_visibility,
    measure_visibility,
    visibility_advice,
)
from phytac_design.simulation.expected_image import ExpectedView, measure_expected
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES
from phytac_design.simulation.imaging.nominal_view import owner_centroids, paint_slope
from phytac_design.simulation.scenario.scene_scope import scope_of
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import DesignError


def write_image(path: Path, image: ImageArray) -> None:
    """Write a PNG (BGR)."""
    # OpenCV's own writing says nothing of a full disk and leaves half a picture.
    path.write_bytes(bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 6])[1]))


def id_picture(part: Any) -> ImageArray:
    """ID map as colours: neighbours in number get far hues, background black."""
    owner = paint_owner(part)
    hue = (np.maximum(owner, 0).astype(np.int64) * 67) % 180
    hsv = np.stack([hue, np.full_like(hue, 200), np.where(owner >= 0, 255, 0)], axis=-1)
    return np.asarray(cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2BGR))


def red_centroids(part: Any, count: int) -> FloatArray:
    """Centroid (n, 2) px of the visible red of each tip in an ID map, NaN where none."""
    return owner_centroids(red_owner(part), count)


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What one camera sees, and what the decoder's marker detector expects in its image."""

    camera: Camera
    seen: Visibility
    expected: ExpectedView
    paint_slope: FloatArray


def shoot(
    context: Context, folder: Path, camera: Camera, mark: str, rng: Any, *, alone: bool = True
) -> Shot:
    """Look through one camera at rest and with all switches on; write its pictures.

    In a scene without pictures none are written. ``mark`` goes into the names of its files. A
    marker that shows nowhere is expected where its tip would be, as long as no other camera may
    see it (``alone``), else nowhere (NaN).
    """
    sensor = context.sensor
    design, markers = context.design, context.markers
    tolerance = tolerance_mm(camera, markers)
    all_on = np.ones(markers.count, dtype=np.bool_)
    rest = build_scene(sensor, tolerance_mm=tolerance)
    on = build_scene(sensor, tolerance_mm=tolerance, switch_on=all_on)
    seen = measure_visibility(rest, on, camera, noise_std=design.camera.noise_pixel, rng=rng)
    part_on = rasterise(on, camera).part
    away = camera.project(markers.tip_mm) if alone else np.nan
    place = np.where(seen.lost[:, None], away, seen.centroid_px)
    rest_frame, on_frame = render_frame(rest, camera), render_frame(on, camera)
    expected = measure_expected(
        design,
        markers,
        rest_frame=rest_frame,
        on_frame=on_frame,
        marker_px=place,
        red_px=red_centroids(part_on, markers.count),
    )
    rest_px = np.where(seen.lost[:, None], place, expected.rest_px)
    if context.scene is None or context.scene.pictures:
        context.progress("views: pictures")
        ids = id_picture(rasterise(rest, camera).part)
        pictures = {"camera{}": rest_frame, "camera{}_all_on": on_frame, "ids{}": ids}
        for name, picture in pictures.items():
            write_image(export_path(folder, f"views/{name.format(mark)}.png"), picture)
    return Shot(
        camera=camera,
        seen=seen,
        expected=replace(expected, rest_px=rest_px),
        paint_slope=paint_slope(sensor, camera, rest=rest, seen=seen),
    )


def run_views(context: Context, folder: Path) -> None:
    """Visibility, density, expectations of the marker detector, and pictures."""
    design, surface, markers = context.design, context.surface, context.markers
    rng = np.random.default_rng(context.seed)
    cameras = context.sensor.cameras
    shots = [
        shoot(context, folder, camera, mark, rng, alone=len(cameras) == 1)
        for camera, mark in zip(cameras, CAMERA_SUFFIXES, strict=False)
    ]
    best, camera = best_of([shot.seen for shot in shots])
    shown_px = [
        # What no camera sees is expected where its tip would be.
        np.where(
            (best.lost & (camera == number))[:, None],
            shot.camera.project(markers.tip_mm),
            shot.expected.rest_px,
        )
        for number, shot in enumerate(shots)
    ]

    def picked(values: list[FloatArray]) -> FloatArray:
        return np.asarray(np.stack(values)[camera, np.arange(markers.count)])

    points = [
        np.where(shot.seen.lost[:, None], markers.tip_mm, shot.seen.paint_point_mm)
        for shot in shots
    ]
    slopes = [shot.paint_slope for shot in shots]
    rest_px = picked(shown_px)
    tips = [shot.expected.tips for shot in shots]
    arrays = asdict(best) | {
        "camera": camera,
        "paint_point_mm": picked(points),
        "paint_slope": picked(slopes),
        "paint_slopes": np.stack(slopes),
        "seen_by": np.stack([~shot.seen.occluded for shot in shots]),
        "rest_px": rest_px,
        "tip_bias_px": picked([shot.expected.tip_bias_px for shot in shots]),
        "tip_on_px": picked([tip.on_px for tip in tips]),
        "tip_red_rest_px": picked([tip.red_rest_px for tip in tips]),
        "tip_red_on_px": picked([tip.red_on_px for tip in tips]),
        "shown_rest_px": np.stack(shown_px),
        "shown_tip_on_px": np.stack([tip.on_px for tip in tips]),
        "shown_tip_red_rest_px": np.stack([tip.red_rest_px for tip in tips]),
        "shown_tip_red_on_px": np.stack([tip.red_on_px for tip in tips]),
    }
    write_arrays(folder, arrays)
    error = np.linalg.norm(rest_px - best.centroid_px, axis=1)[~best.lost]
    write_facts(
        folder,
        {
            "visibility": best.summary(),
            "density": asdict(density_of(surface, markers)),
            "stand_off_mm": stand_off_mm(design, surface, shots[0].camera),
            "cameras": [
                {
                    "end": "far" if end else "near",
                    "stand_off_mm": stand_off_mm(design, surface, shot.camera),
                    "best_for": int((camera == number).sum()),
                    "visibility": shot.seen.summary(),
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
    return visibility_advice(context.design, context.markers, occluded, fused, views["hidden_by"])


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
    each = [check_visibility(sensor, rng=rng, camera=camera) for camera in sensor.cameras]
    near = sensor.cameras[0]
    scene = build_scene(sensor, tolerance_mm=tolerance_mm(near, markers))
    write_image(export_path(folder, "views/straight.png"), render_frame(scene, near))
    write_facts(folder, {"straight": best_of(each)[0].summary()})


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
COMPARE = Stage(name="compare", design_fields=("pictures",), seeded=True, run=run_compare)
