"""What the decoder expects to see of a sensor as designed, without forces."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle, CameraView
from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.layout.cameras import cameras_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import RenderScene, build_scene, red_owner
from phytac_design.optics.visibility import Visibility, best_of, measure_visibility
from phytac_design.simulation.expected_image import ExpectedView, colour_model, measure_expected
from phytac_design.simulation.imaging.paint_centroids import PaintPoints
from phytac_design.simulation.imaging.virtual_camera import bar_strip
from phytac_design.simulation.linear_response import rigid_slope
from phytac_shapes.arrays import FloatArray


def expected_views(sensor: Sensor) -> dict[str, Any]:
    """What the design's cameras show: the arrays of the stage ``views`` that detection needs."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    cameras = cameras_of(design, surface)
    each = [_look(sensor, camera, alone=len(cameras) == 1) for camera in cameras]
    best, number = best_of([seen for seen, _ in each])
    lost = best.lost
    rest = [
        np.where((lost & (number == k))[:, None], camera.project(markers.tip_mm), found.rest_px)
        for k, (camera, (_, found)) in enumerate(zip(cameras, each, strict=True))
    ]
    bias = np.stack([found.tip_bias_px for _, found in each])
    return {
        "camera": number,
        "tip_bias_px": bias[number, np.arange(markers.count)],
        "shown_rest_px": np.stack(rest),
        "shown_tip_on_px": np.stack([found.tips.on_px for _, found in each]),
        "shown_tip_red_rest_px": np.stack([found.tips.red_rest_px for _, found in each]),
        "shown_tip_red_on_px": np.stack([found.tips.red_on_px for _, found in each]),
    }


def _look(sensor: Sensor, camera: Camera, *, alone: bool) -> tuple[Visibility, ExpectedView]:
    """Look through one camera at rest and with all switches on."""
    design, markers = sensor.design, sensor.markers
    tolerance = tolerance_mm(camera, markers)
    rest, on = (
        build_scene(sensor, tolerance_mm=tolerance, switch_on=np.full(markers.count, state))
        for state in (False, True)
    )
    seen = measure_visibility(rest, on, camera, noise_std=0.0, rng=np.random.default_rng(0))
    away = camera.project(markers.tip_mm) if alone else np.nan
    red = red_owner(rasterise(on, camera).part)
    found = measure_expected(
        design,
        markers,
        rest_frame=render_frame(rest, camera),
        on_frame=render_frame(on, camera),
        marker_px=np.where(seen.lost[:, None], away, seen.centroid_px),
        red_px=owner_centroids(red, markers.count),
    )
    return seen, found


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
    y, x = np.nonzero(owner >= 0)
    ids = owner[y, x]
    number = np.bincount(ids, minlength=count).astype(np.float64)
    sums = [np.bincount(ids, weights=c, minlength=count) for c in (x, y)]
    return np.asarray(
        np.column_stack(sums) / np.where(number > 0.0, number, np.nan)[:, None], dtype=np.float64
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
    n = markers.count
    colours, classes = colour_model(design)
    read_by = np.asarray(views["camera"])
    shown = tuple(
        CameraView(rest_px=rest, tips=TipModel(on_px=on, red_rest_px=off, red_on_px=out))
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
        rest_px=own([item.rest_px for item in shown]),
        tip_bias_px=views["tip_bias_px"],
        tips=TipModel(
            on_px=own([item.tips.on_px for item in shown]),
            red_rest_px=own([item.tips.red_rest_px for item in shown]),
            red_on_px=own([item.tips.red_on_px for item in shown]),
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
        threshold_N=thresholds_N(design, markers),
        noise_centroid_px=design.camera.noise_centroid_px,
        force_max_N=design.training.force_max_N,
        shown=shown,
    )
