"""``phytac check``: rules, visibility and density of a design, with no solid and no mesh."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import Perspective
from phytac_design.design.field_of_view import fields_of_view_deg
from phytac_design.design.spec import Design
from phytac_design.design.unit_hints import unit_hints
from phytac_design.fabrication.effort.effort import effort_of
from phytac_design.geometry.envelope import edge_mm
from phytac_design.layout.cameras import stand_off_mm
from phytac_design.layout.markers import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_of
from phytac_design.optics.render_scene import BAR, RESIN
from phytac_design.optics.separability import check_paints
from phytac_design.optics.sharpness import lens_facts, sharpness
from phytac_design.optics.visibility import (
    Visibility,
    best_of,
    check_marks,
    check_visibility,
    heights_face,
    visibility_advice,
)
from phytac_design.rules.check import check_design
from phytac_shapes.arrays import BoolArray, IntArray


def checkup(
    design: Design, *, seed: int = 0, progress: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Figures of the report that need only layout and camera.

    ``weakest_tip`` (of a sensor with switches) has the red of one tip, at rest and out, and what it
    needs; the minimum and the maximum in ``visibility`` are of different tips.

    Raises
    ------
    DesignError
        If the design cannot be printed or seen at all.
    """
    start = time.perf_counter()
    sensor = check_design(design)
    surface, markers = sensor.surface, sensor.markers
    cameras = sensor.cameras
    rng = np.random.default_rng(seed)
    progress(f"rendering what the camera sees of {markers.count} markers")
    each = [check_visibility(sensor, rng=rng, camera=camera) for camera in cameras]
    seen, best = best_of(each)
    density = density_of(surface, markers)
    summary, marks = seen.summary(switches=design.has_switches), check_marks(sensor)
    advice = visibility_advice(
        design,
        markers,
        np.flatnonzero(seen.occluded),
        np.flatnonzero(seen.fused),
        seen.hidden_by,
    )
    return {
        "design": design.name,
        "markers": {
            "count": density.count,
            "rows": len(np.unique(markers.row)) if markers.in_rows else None,
            "columns": int(markers.column.max()) + 1 if markers.in_rows else None,
            "layout": design.layout.kind,
            "density_per_cm2": density.per_cm2,
            "density_local_min_per_cm2": density.local_min_per_cm2,
            "density_local_max_per_cm2": density.local_max_per_cm2,
            "density_times_paper": density.times_paper,
            "sensing_area_cm2": density.area_cm2,
            "surface_class": density.surface_class,
        },
        "colours": check_paints(design).summary(),
        "visibility": summary,
        **({"weakest_tip": _weakest_tip(markers, seen)} if design.has_switches else {}),
        "occluded_markers": np.flatnonzero(seen.occluded).tolist(),
        "fused_markers": np.flatnonzero(seen.fused).tolist(),
        "clear": summary["occluded"] == 0 and summary["fused"] == 0 and not marks,
        "advice": "; ".join(filter(None, (advice, marks))),
        "warnings": [
            *unit_hints(design.model_dump()),
            *warnings_of(sensor, cameras, each, best),
        ],
        "stand_off_mm": stand_off_mm(design, surface, cameras[0]),
        "cameras": [
            {
                "end": "far" if end else "near",
                "stand_off_mm": stand_off_mm(design, surface, camera),
                "field_of_view_deg": fields_of_view_deg(camera.lens),
                "working_distance_mm": working_distance_mm(camera, markers),
                "distances": "along the axis"
                if isinstance(camera.lens, Perspective)
                else "from the camera's centre",
                "best_for": int((best == number).sum()),
                "visibility": own.summary(switches=design.has_switches),
                "lens": lens_facts(sensor, camera),
            }
            for number, (end, camera, own) in enumerate(
                zip(design.camera.end_numbers, cameras, each, strict=True)
            )
        ],
        "effort": effort_of(sensor).as_dict(),
        "seconds": time.perf_counter() - start,
    }


def _weakest_tip(markers: Markers, seen: Visibility) -> dict[str, Any]:
    """Red pixels of the switch that is hardest to read."""
    tip = seen.weakest_tip()
    return {
        "marker": tip,
        "name": markers.name(tip),
        "rest_px": int(seen.red_rest_px[tip]),
        "on_px": int(seen.red_on_px[tip]),
        "needed_px": float(seen.red_needed_px[tip]),
    }


def working_distance_mm(camera: Camera, markers: Markers) -> tuple[float, float]:
    """Distances of a camera's nearest and farthest marker, as its focus is counted.

    Along the axis for lenses that image planes sharply, else from the camera's centre.
    """
    points = camera.to_camera(markers.tip_mm)
    flat = isinstance(camera.lens, Perspective)
    away = points[:, 2] if flat else np.linalg.norm(points, axis=1)
    return float(away.min()), float(away.max())


def warnings_of(
    sensor: Sensor, cameras: tuple[Camera, ...], each: list[Visibility], best: IntArray
) -> list[str]:
    """What is odd about a design and its cameras, though it may work; each as a sentence.

    ``best`` (n,) is the number of the camera that sees each marker best.
    """
    design = sensor.design
    out = []
    if heights_face(design):
        out.append(
            "receptors are not taller the farther they are from the camera, so near ones can hide "
            f"far ones; {heights_face(design)}"
        )
    for number, (camera, seen) in enumerate(zip(cameras, each, strict=True)):
        out.extend(blurred(sensor, camera, seen, best == number))
    if len(cameras) == 1:
        out.extend(too_close(sensor, cameras[0], each[0]))
    return out


def blurred(sensor: Sensor, camera: Camera, seen: Visibility, own: BoolArray) -> list[str]:
    """Say so if ``own`` markers (n,) blur into the gap to the next one of their colour."""
    # Width of a point's image, as a share of the gap to the next marker of its colour.
    blur_max = 0.5
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    blur = np.nan_to_num(sharpness(design.camera, camera, surface, markers).blur_px)
    share = np.where(own, blur / np.maximum(seen.gap_same_colour_px, 1.0), 0.0)
    worst = int(share.argmax())
    if share[worst] < blur_max:
        return []
    stop = design.camera.f_number
    fix = np.ceil(10.0 * stop * share[worst] / blur_max) / 10.0
    said = (
        f"the image of a point at marker {worst} is {blur[worst]:.2g} px wide (camera.f_number = "
        f"{stop:g}), {seen.gap_same_colour_px[worst]:.2g} px from the next marker of its colour; "
        "`phytac simulate` shows it in its frames, a build does not"
    )
    return [f"{said}: raise camera.f_number to {fix:g}, or set camera.focus_mm"]


def too_close(sensor: Sensor, camera: Camera, seen: Visibility) -> list[str]:
    """Say so if `fit` puts a wide lens where receptors or the bar hide some, and what would do."""
    # Stand-offs that are tried, as multiples of one that does not do.
    steps = (1.5, 2.0, 3.0, 4.0, 6.0, 9.0)
    # A camera that sees its rim this far off the axis sees the wall aslant, row behind row.
    wide_deg = 60.0
    design, surface = sensor.design, sensor.surface
    hidden = int(np.isin(seen.hidden_by, (RESIN, BAR)).sum())
    end = design.camera.end_numbers[0]
    rim = camera.to_camera(edge_mm(surface, end, -design.wall.thickness_mm))
    aside = np.arctan2(np.hypot(rim[:, 0], rim[:, 1]), rim[:, 2])
    slant = float(np.degrees(aside).max())
    if design.camera.stand_off_mm != "fit" or hidden == 0 or slant < wide_deg:
        return []
    stand_off = stand_off_mm(design, surface, camera)
    said = (
        f'the lens is so wide that camera.stand_off_mm = "fit" puts it {stand_off:.2f} mm before '
        f"the rim, where {hidden} markers hide behind receptors or the light bar"
    )
    for step in steps:
        away = float(camera.rotation[2, 2]) * (stand_off - step * stand_off)
        back = replace(camera, position_mm=camera.position_mm + np.array([0.0, 0.0, away]))
        rng = np.random.default_rng(0)
        other = check_visibility(sensor, rng=rng, camera=back)
        if other.clear.all():
            return [
                f"{said}; set camera.stand_off_mm = {step * stand_off:.1f}: every marker is seen"
            ]
    fix = "use a longer camera.focal_px, taller far receptors or fewer markers"
    return [f"{said}; {steps[0]:g} to {steps[-1]:g} times that distance do not help: {fix}"]
