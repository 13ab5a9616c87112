"""A design as the studio draws it while controls move: the cheap fidelity levels of a study.

Layout and rules are those of every build; visibility is sampled with some 64 rays a marker on the
camera's own pixels; the image is a small one of the same view. ``exact`` is `phytac check`.
"""

from base64 import b64encode
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.core.json_values import finite
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import stand_off_mm, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_map, surface_class
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import RenderScene, build_scene, paint_owner
from phytac_design.optics.sampled_visibility import sampled_fraction
from phytac_design.optics.visibility import FRACTION_MIN, heights_face
from phytac_design.report.press_pictures import window
from phytac_design.report.viewer.data import Colouring, base_colourings, viewer_data
from phytac_design.studio.latest_only import Check, SupersededError
from phytac_design.study.search.fidelity_levels import Candidate, outlined_gap_px, rules
from phytac_design.study.search.measures import MEASURES
from phytac_design.study.search.study_file import Study, Variable
from phytac_design.study.search.surrogate import predict
from phytac_design.workflows.design_check import full_check
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import DesignError, PhytacError

SIDE_px, SIDE_MIN_px = 864, 160
"""Longer side of a draft's image."""

Json = dict[str, Any]


def draft(design: Design, check: Check, side_px: int = SIDE_px) -> Json:
    """Layout, camera views, visibility and density of a design, drawn even if a rule is broken.

    Parameters
    ----------
    design : Design
        The design.
    check : callable
        Called between steps; may raise to stop.
    side_px : int
        Longer side of the images at most.

    Returns
    -------
    dict
        Plain JSON: ``refused`` and ``code`` (text and code of the broken rule, or empty),
        ``warnings``, ``measures``, ``view`` (see ``report.viewer.data``), ``cameras`` (images as
        base64), ``resolved``.

    Raises
    ------
    DesignError
        If nothing can be drawn, or there are too many markers.
    """
    markers_max = 5000
    if design.layout.wanted > markers_max:
        raise DesignError(
            "draft-too-many-markers",
            f"layout.rows, layout.columns or layout.count give {design.layout.wanted} markers; "
            f"the studio draws up to {markers_max}, `phytac check` takes more",
        )
    # Prices and a seed are all that the levels used here need of a study.
    variable = Variable(field="wall.thickness_mm", low=0.5, high=1.0)
    study = Study(name="studio", design="cylinder60", variable=(variable,))
    candidate = Candidate(design=design, study=study)
    refused = _broken_rule(candidate)
    try:
        return _drawn(candidate, refused, side_px, check)
    except SupersededError:
        raise
    except Exception:
        # A design that breaks a rule need not be drawable.
        if refused:
            raise refused from None
        raise


def _drawn(candidate: Candidate, refused: DesignError | None, side_px: int, check: Check) -> Json:
    """What ``draft`` returns."""
    design = candidate.design
    surface, markers = candidate.sensor.surface, candidate.sensor.markers
    check()
    pictures = []
    for camera in candidate.sensor.cameras:
        pictures.append(_picture(candidate, camera, side_px))
        check()
    fractions = np.stack(
        [
            sampled_fraction(_scene(candidate, camera, 2.5), camera).fraction
            for camera in candidate.sensor.cameras
        ]
    )
    check()
    fraction, best = fractions.max(axis=0), fractions.argmax(axis=0)
    density = density_map(surface, markers)
    check()
    seen = fraction >= FRACTION_MIN
    predicted = predict(candidate.sensor, candidate.sensor.cameras, seen)
    found = rules(candidate) | {
        "density_least_per_cm2": float(density.per_cm2.min()),
        "sampled_visible_least": float(fraction.min()),
        "sampled_hidden": int((~seen).sum()),
        "sampled_gap_px": outlined_gap_px(candidate.sensor, best),
        "surrogate_force_sd_N": float(np.median(predicted.bound.force_N)),
    }
    shown = (
        "marker_count",
        "density_mean_per_cm2",
        "density_least_per_cm2",
        "sampled_visible_least",
        "sampled_hidden",
        "sampled_gap_px",
        "surrogate_force_sd_N",
        "pitch_least_mm",
        "height_most_mm",
        "stack_mm",
        "mass_g",
    )
    drawn: Json = finite(
        {
            "refused": str(refused) if refused else "",
            "code": refused.code if refused else "",
            "warnings": _warnings(candidate, found),
            "measures": [
                {
                    "name": name,
                    "value": found[name],
                    "unit": MEASURES[name].unit,
                    "doc": MEASURES[name].doc,
                }
                for name in shown
            ],
            "surface_class": surface_class(markers),
            "view": _view(candidate, fraction, density.per_cm2),
            "cameras": pictures,
            "resolved": design.model_dump(mode="json"),
        }
    )
    return drawn


def exact(design: Design) -> Json:
    """`phytac check` of a design, with its texts.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    report = full_check(design)
    return {
        "clear": report["clear"],
        "visible": report["visible"],
        "faults": report.get("faults", []),
        "advice": report["advice"],
        "warnings": report["warnings"],
        "visibility": finite(report["visibility"]),
        "occluded": report["occluded_markers"],
        "fused": report["fused_markers"],
        "seconds": report["seconds"],
    }


def exact_in_worker(_: None, design: Design) -> Json:
    """:func:`exact`, as a task of a worker process."""
    return exact(design)


def _broken_rule(candidate: Candidate) -> DesignError | None:
    """Error of the rule that a design breaks, if one; its markers are placed in any case.

    Raises
    ------
    DesignError
        If no marker can be placed.
    """
    try:
        candidate.sensor  # noqa: B018 - computed here, so that its error is caught here
    except DesignError as error:
        surface = candidate.design.surface()
        try:
            markers = make_markers(candidate.design, surface)
            candidate.sensor = Sensor.of(candidate.design, surface, markers)
        except PhytacError:
            raise error from None
        return error
    return None


def _warnings(candidate: Candidate, found: Json) -> list[str]:
    """Warnings of a draft; the check takes them from exact images."""
    out = []
    face = heights_face(candidate.design)
    if face:
        out.append(
            "receptors are not taller the farther they are from the camera, so near ones can hide "
            f"far ones; {face}"
        )
    if found["outside_markers"]:
        out.append(f"{found['outside_markers']} markers end outside of every camera's image")
    return out


def _view(candidate: Candidate, fraction: FloatArray, per_cm2: FloatArray) -> Json:
    """Shell and map, coloured by visibility and density."""
    markers = candidate.sensor.markers
    own = [
        Colouring(
            key="visible",
            label="visible fraction",
            values=fraction,
            note="sampled with about 64 rays a marker",
        ),
        Colouring(key="density", label="local density", values=per_cm2, unit="/cm²"),
    ]
    view = viewer_data(
        candidate.sensor,
        [*own, *base_colourings(markers)],
        cameras=candidate.sensor.cameras,
    )
    # A scale fitted to the values would show differences where all are wholly visible.
    view["colourings"][0] |= {"low": 0.0, "high": 1.0}
    return view


def small_camera(camera: Camera, side_px: int) -> Camera:
    """The same view with fewer pixels: the longer side at most ``side_px``."""
    share = min(1.0, side_px / max(camera.width_px, camera.height_px))
    width = max(round(share * camera.width_px), 1)
    return window(camera, np.zeros(2), camera.width_px, width)


def _scene(candidate: Candidate, camera: Camera, coarse: float) -> RenderScene:
    """Scene of a camera, ``coarse`` times coarser than for a check.

    Polygons are never finer than 0.5 % of a receptor's radius, however near the camera.
    """
    markers = candidate.sensor.markers
    least = 0.005 * candidate.design.receptor.diameter_outer_mm / 2.0
    tolerance = np.maximum(coarse * tolerance_mm(camera, markers), least)
    return build_scene(candidate.sensor, tolerance_mm=tolerance)


def _picture(candidate: Candidate, camera: Camera, side_px: int) -> Json:
    """Image and marker numbers of one camera, and the image position of each marker's end, px."""
    surface, markers = candidate.sensor.surface, candidate.sensor.markers
    small = small_camera(camera, side_px)
    return {
        "end": "far" if camera.rotation[2, 2] < 0.0 else "near",
        "stand_off_mm": stand_off_mm(candidate.design, surface, camera),
        "of_width": camera.width_px,
        "of_height": camera.height_px,
        **rendered(_scene(candidate, small, 2.0), small, markers.tip_mm),
    }


def rendered(scene: RenderScene, camera: Camera, tip_mm: FloatArray) -> Json:
    """Image of a scene, marker numbers of its pixels, and image positions of markers' ends, px.

    Parameters
    ----------
    scene : RenderScene
        The scene.
    camera : Camera
        Camera with the image's pixels.
    tip_mm : (n, 3) float
        Ends of the markers.
    """
    frame = render_frame(scene, camera, samples=2)
    owner = paint_owner(rasterise(scene, camera).part)
    return {
        "width": camera.width_px,
        "height": camera.height_px,
        "jpeg": _base64(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 88])[1]),
        "ids": _base64(cv2.imencode(".png", id_image(owner), [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]),
        "tip_px": np.round(camera.project(tip_mm), 3).tolist(),
    }


def id_image(owner: NDArray[np.int32]) -> ImageArray:
    """Marker numbers (h, w), -1 for none, as BGR: one more in red and green, low byte in red."""
    code = np.asarray(owner, dtype=np.int64) + 1
    return np.stack([np.zeros_like(code), code >> 8, code & 255], axis=-1).astype(np.uint8)


def _base64(data: Any) -> str:
    return b64encode(bytes(data)).decode()
