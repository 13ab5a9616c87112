"""A design as the studio draws it while controls move: the cheap rungs of a study's ladder.

Layout and rules are those of every build; visibility is sampled with some 64 rays a marker on the
camera's own pixels; the picture is a small one of the same view. ``exact`` is `phytac check`.
"""

from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.camera.camera import Camera
from phytac_design.core.json_values import finite
from phytac_design.design.design_file import parse_design
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import stand_off_mm, tolerance_mm
from phytac_design.optics.density import density_map, surface_class
from phytac_design.optics.frame import render_frame
from phytac_design.optics.raster import rasterise
from phytac_design.optics.sampled_visibility import sampled_fraction
from phytac_design.optics.scene import Scene, build_scene, paint_owner
from phytac_design.optics.visibility import FRACTION_MIN, heights_face
from phytac_design.report.viewer.data import Colouring, base_colourings, viewer_data
from phytac_design.rules.design_review import checkup
from phytac_design.studio.latest_only import StaleError
from phytac_design.study.search.candidate import COARSE, Candidate
from phytac_design.study.search.fidelity_levels import outlined_gap_px, rules
from phytac_design.study.search.measures import MEASURES
from phytac_design.study.search.study_file import Study, Variable
from phytac_design.study.search.surrogate import predict
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import DesignError, PhytacError

MARKERS_MAX = 5000
"""Markers beyond which a draft is not one any more."""
SIDE_PX = 864
"""Longer side of a draft's picture, at most."""
SIDE_LEAST_PX = 160
SAMPLES = 2
"""Samples per pixel of a draft's picture."""
ROUND_SHARE = 0.005
"""Polygons need not be closer to a receptor's circles than this share of its radius."""
SHOWN = (
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
"""Measures of a study that the studio shows."""

Check = Callable[[], None]
Json = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A design to look at: its tables, and the folder that its files are relative to."""

    data: Json
    folder: Path
    side_px: int = SIDE_PX

    def design(self) -> Design:
        """Typed design of the tables.

        Raises
        ------
        DesignError
            If they are none, or too large to be drawn while controls move.
        """
        design = parse_design(self.data, "the design", folder=self.folder)
        if design.layout.wanted > MARKERS_MAX:
            raise DesignError(
                f"layout.rows, layout.columns or layout.count ask for {design.layout.wanted} "
                f"markers; the studio draws up to {MARKERS_MAX}, `phytac check` takes more"
            )
        return design


def draft(asked: Asked, check: Check) -> Json:
    """Layout, camera views, visibility and density of a design, drawn even if a rule is broken.

    Parameters
    ----------
    asked : Asked
        The design.
    check : callable
        Called between steps; may raise to stop.

    Returns
    -------
    dict
        Plain JSON: ``refused`` (text of the broken rule, or empty), ``warnings``, ``measures``,
        ``view`` (see ``report.viewer.data``), ``cameras`` (pictures as base64), ``resolved``.

    Raises
    ------
    DesignError
        If nothing can be drawn.
    """
    design = asked.design()
    candidate = Candidate(design=design, study=_study())
    refused = _check_rules(candidate)
    try:
        return _drawn(candidate, refused, asked.side_px, check)
    except StaleError:
        raise
    except Exception:
        # Nothing promises that a design which breaks a rule can be drawn.
        if refused:
            raise DesignError(refused) from None
        raise


def _drawn(candidate: Candidate, refused: str, side_px: int, check: Check) -> Json:
    """What ``draft`` returns."""
    design = candidate.design
    surface, markers = candidate.checked
    check()
    pictures = []
    for camera in candidate.cameras:
        pictures.append(_picture(candidate, camera, side_px))
        check()
    fractions = np.stack(
        [
            sampled_fraction(_scene(candidate, camera, COARSE), camera).fraction
            for camera in candidate.cameras
        ]
    )
    check()
    fraction, best = fractions.max(axis=0), fractions.argmax(axis=0)
    density = density_map(surface, markers)
    check()
    found = rules(candidate) | {
        "density_least_per_cm2": float(density.per_cm2.min()),
        "sampled_visible_least": float(fraction.min()),
        "sampled_hidden": int((fraction < FRACTION_MIN).sum()),
        "sampled_gap_px": outlined_gap_px(candidate, best),
        **_resolution(candidate, fraction),
    }
    drawn: Json = finite(
        {
            "refused": refused,
            "warnings": _warnings(candidate, found),
            "measures": [_measure(name, found[name]) for name in SHOWN if name in found],
            "surface_class": surface_class(markers),
            "view": _view(candidate, fraction, density.per_cm2),
            "cameras": pictures,
            "resolved": design.model_dump(mode="json"),
        }
    )
    return drawn


def exact(asked: Asked) -> Json:
    """`phytac check` of a design, with its texts.

    Raises
    ------
    DesignError
        If the design cannot be printed or seen at all.
    """
    report = checkup(asked.design())
    return {
        "clear": report["clear"],
        "advice": report["advice"],
        "warnings": report["warnings"],
        "visibility": finite(report["visibility"]),
        "occluded": report["occluded_markers"],
        "fused": report["fused_markers"],
        "seconds": report["seconds"],
    }


def _study() -> Study:
    """Prices and a seed; the rungs that are used here ask nothing else of a study."""
    some = Variable(field="wall.thickness_mm", low=0.5, high=1.0)
    return Study(name="studio", design="cylinder60", variable=(some,))


def _check_rules(candidate: Candidate) -> str:
    """Text of the rule that a design breaks, or ""; what can be drawn of it is drawn all the same.

    Raises
    ------
    DesignError
        If no marker can be placed.
    """
    try:
        candidate.checked  # noqa: B018 - made here, so that its refusal is caught here
    except DesignError as error:
        surface = candidate.design.surface()
        try:
            candidate.checked = surface, make_markers(candidate.design, surface)
        except PhytacError:
            raise error from None
        return str(error)
    return ""


def _resolution(candidate: Candidate, fraction: FloatArray) -> Json:
    """Closed-form bound of a force, where the shape has one."""
    surface, markers = candidate.checked
    seen = fraction >= FRACTION_MIN
    predicted = predict(candidate.design, surface, markers, candidate.cameras, seen)
    return {"surrogate_force_sd_N": float(np.median(predicted.bound.force_N))}


def _warnings(candidate: Candidate, found: Json) -> list[str]:
    """What a draft can already say; the check says it by the exact pictures."""
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


def _measure(name: str, value: float) -> Json:
    known = MEASURES[name]
    return {"name": name, "value": value, "unit": known.unit, "doc": known.doc}


def _view(candidate: Candidate, fraction: FloatArray, per_cm2: FloatArray) -> Json:
    """Shell and map, coloured by what a draft knows."""
    surface, markers = candidate.checked
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
        candidate.design,
        surface,
        markers,
        [*own, *base_colourings(markers)],
        cameras=candidate.cameras,
    )
    # A scale of its own would show differences where all are seen whole.
    view["colourings"][0] |= {"low": 0.0, "high": 1.0}
    return view


def small_camera(camera: Camera, side_px: int) -> Camera:
    """The same view on fewer pixels: the longer side at most ``side_px``."""
    share = min(1.0, side_px / max(camera.width_px, camera.height_px))
    width, height = (max(round(share * n), 1) for n in (camera.width_px, camera.height_px))
    lens, own = camera.lens, (width / camera.width_px, height / camera.height_px)
    return replace(
        camera,
        lens=replace(
            lens,
            width_px=width,
            height_px=height,
            fx_px=lens.fx_px * own[0],
            fy_px=lens.fy_px * own[1],
            # Pixel centres are whole numbers: edges scale, centres do not.
            cx_px=(lens.cx_px + 0.5) * own[0] - 0.5,
            cy_px=(lens.cy_px + 0.5) * own[1] - 0.5,
        ),
    )


def _scene(candidate: Candidate, camera: Camera, coarse: float) -> Scene:
    """What a camera looks at, ``coarse`` times coarser than for a check.

    A receptor that reaches the camera would ask for circles of any fineness: there is an end.
    """
    surface, markers = candidate.checked
    least = ROUND_SHARE * candidate.design.receptor.diameter_outer_mm / 2.0
    tolerance = np.maximum(coarse * tolerance_mm(camera, markers), least)
    return build_scene(candidate.design, surface, markers, tolerance_mm=tolerance)


def _picture(candidate: Candidate, camera: Camera, side_px: int) -> Json:
    """Picture and marker numbers of one camera, and where each marker's end shows, px."""
    surface, markers = candidate.checked
    small = small_camera(camera, side_px)
    scene = _scene(candidate, small, 2.0)
    frame = render_frame(scene, small, samples=SAMPLES)
    owner = paint_owner(rasterise(scene, small).part)
    return {
        "end": "far" if camera.rotation[2, 2] < 0.0 else "near",
        "stand_off_mm": stand_off_mm(candidate.design, surface, camera),
        "width": small.width_px,
        "height": small.height_px,
        "of_width": camera.width_px,
        "of_height": camera.height_px,
        "jpeg": _base64(cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 88])[1]),
        "ids": _base64(cv2.imencode(".png", id_image(owner), [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]),
        "tip_px": _rounded(small.project(markers.tip_mm)),
    }


def id_image(owner: NDArray[np.int32]) -> ImageArray:
    """Marker numbers (h, w), -1 for none, as BGR: one more in red and green, low byte in red."""
    code = np.asarray(owner, dtype=np.int64) + 1
    return np.stack([np.zeros_like(code), code >> 8, code & 255], axis=-1).astype(np.uint8)


def _base64(data: Any) -> str:
    return b64encode(bytes(data)).decode()


def _rounded(values: FloatArray) -> Any:
    return np.round(values, 3).tolist()
