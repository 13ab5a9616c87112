"""What the camera sees: visibility of every marker, pictures, and the straight layout beside."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from phytac_design.layout import make_markers
from phytac_design.spec import Design
from phytac_design.stage import Context, Stage, export_path, write_arrays, write_facts
from shapes.arrays import FloatArray, ImageArray
from shapes.errors import MissingPartError

TABLES = ("shape", "wall", "layout", "receptor", "switch", "camera", "light")


def write_image(path: Path, image: ImageArray) -> None:
    """Write a PNG (BGR)."""
    cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 6])


def picture_or_frame(scene: Any, camera: Any) -> tuple[ImageArray, str]:
    """Picture by OpenGL where it works, else the project's own renderer; and which it was."""
    from phytac_design.optics.frame import render_frame
    from phytac_design.optics.picture import render_picture

    try:
        return render_picture(scene, camera), "pyrender"
    except MissingPartError:
        return render_frame(scene, camera), "rasteriser"


def id_picture(part: Any) -> ImageArray:
    """ID map as colours: neighbours in number get far hues, background black."""
    from phytac_design.optics.scene import paint_owner

    owner = paint_owner(part)
    hue = (np.maximum(owner, 0).astype(np.int64) * 67) % 180
    hsv = np.stack([hue, np.full_like(hue, 200), np.where(owner >= 0, 255, 0)], axis=-1)
    return np.asarray(cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2BGR))


def red_centroids(part: Any, count: int) -> FloatArray:
    """Centroid (n, 2) px of the visible red of each tip in an ID map, NaN where none."""
    from phytac_design.optics.scene import red_owner

    owner = red_owner(part)
    y, x = np.nonzero(owner >= 0)
    ids = owner[y, x]
    number = np.bincount(ids, minlength=count).astype(float)
    number[number == 0] = np.nan
    sums = [np.bincount(ids, weights=c, minlength=count) for c in (x, y)]
    return np.asarray(np.column_stack(sums) / number[:, None])


def run_views(context: Context, folder: Path) -> None:
    """Visibility, density, expectations of the decoder's eyes, and pictures."""
    from phytac_design.optics.density import density_of
    from phytac_design.optics.frame import render_frame
    from phytac_design.optics.raster import rasterise
    from phytac_design.optics.scene import build_scene
    from phytac_design.optics.view import camera_of, tolerance_mm
    from phytac_design.optics.visibility import see
    from phytac_design.twin.expected import expectations

    design, surface, markers = context.design, context.surface, context.markers
    camera = camera_of(design, surface)
    tolerance = tolerance_mm(camera, markers)
    all_on = np.ones(markers.count, dtype=np.bool_)
    rest = build_scene(design, surface, markers, tolerance_mm=tolerance)
    on = build_scene(design, surface, markers, tolerance_mm=tolerance, switch_on=all_on)
    rng = np.random.default_rng(context.seed)
    seen = see(rest, on, camera, noise_std=design.camera.noise_pixel, rng=rng)
    context.progress("views: pictures")
    part_rest, part_on = rasterise(rest, camera).part, rasterise(on, camera).part
    expected = expectations(
        design,
        markers,
        rest_frame=render_frame(rest, camera),
        on_frame=render_frame(on, camera),
        marker_px=seen.centroid_px,
        red_px=red_centroids(part_on, markers.count),
    )
    picture, renderer = picture_or_frame(rest, camera)
    write_image(export_path(folder, "views/camera.png"), picture)
    write_image(export_path(folder, "views/camera_all_on.png"), picture_or_frame(on, camera)[0])
    write_image(export_path(folder, "views/ids.png"), id_picture(part_rest))
    # A marker that shows nowhere has no visible centre; its tip stands in for it.
    lost = ~np.isfinite(seen.paint_point_mm[:, 0])
    arrays = asdict(seen) | {
        "paint_point_mm": np.where(lost[:, None], markers.tip_mm, seen.paint_point_mm),
        "rest_px": np.where(lost[:, None], camera.project(markers.tip_mm), expected.rest_px),
        "tip_bias_px": expected.tip_bias_px,
        "tip_on_px": expected.tips.on_px,
        "tip_red_rest_px": expected.tips.red_rest_px,
        "tip_red_on_px": expected.tips.red_on_px,
    }
    write_arrays(folder, arrays)
    error = np.linalg.norm(expected.rest_px - seen.centroid_px, axis=1)[~lost]
    write_facts(
        folder,
        {
            "visibility": seen.summary(),
            "density": asdict(density_of(surface, markers)),
            "stand_off_mm": float(-camera.position_mm[2]),
            "renderer": renderer,
            "centroid_bias_px": float(np.sqrt((error**2).mean())),
        },
    )


def told_apart(context: Context) -> str:
    """Say why nothing should be made of markers that hide or fuse at rest; "" if all are seen."""
    from phytac_design.optics.visibility import visibility_advice

    views = context.arrays("views")
    occluded, fused = np.flatnonzero(views["occluded"]), np.flatnonzero(views["fused"])
    return visibility_advice(context.design, context.markers, occluded, fused)


def straight_of(design: Design) -> Design:
    """The same design with its rows lined up: the paper's comparison case."""
    layout = design.layout.model_copy(update={"kind": "straight"})
    return design.model_copy(update={"layout": layout})


def run_compare(context: Context, folder: Path) -> None:
    """Visibility of the straight layout with the same counts, and its picture, for spirals."""
    from phytac_design.optics.scene import build_scene
    from phytac_design.optics.view import camera_of, tolerance_mm
    from phytac_design.optics.visibility import check_visibility

    if context.design.layout.kind != "spiral":
        write_facts(folder, {"straight": None})
        return
    design, surface = straight_of(context.design), context.surface
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    rng = np.random.default_rng(context.seed)
    seen = check_visibility(design, surface, markers, rng=rng, camera=camera)
    scene = build_scene(design, surface, markers, tolerance_mm=tolerance_mm(camera, markers))
    write_image(export_path(folder, "views/straight.png"), picture_or_frame(scene, camera)[0])
    write_facts(folder, {"straight": seen.summary()})


VIEWS = Stage(
    name="views", tables=TABLES, seeded=True, graphics=True, gate=told_apart, run=run_views
)
COMPARE = Stage(name="compare", tables=TABLES, seeded=True, graphics=True, run=run_compare)
