"""Cameras to and from ``bundle.json``."""

from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_decoder.camera.lens import LENSES, Lens
from phytac_shapes.errors import DesignError, InputError

SIDE_MAX_px, REACH_MAX = 100_000, 1e9
"""Largest side of a camera's image, and magnitude of its other numbers (px, mm): designs allow a
fifth and a hundredth of these; 1e308 overflows in the decoder."""


def camera_table(camera: Camera) -> dict[str, Any]:
    """Camera as in ``bundle.json``: its lens and its pose."""
    return {
        **lens_table(camera.lens),
        "position_mm": camera.position_mm.tolist(),
        "rotation": camera.rotation.tolist(),
    }


def lens_table(lens: Lens) -> dict[str, Any]:
    """Lens as in ``bundle.json``; focal length and centre are (x, y)."""
    return {
        "model": lens.model,
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "focal_px": lens.focal_px.tolist(),
        "centre_px": lens.centre_px.tolist(),
        "distortion": list(lens.distortion),
    }


def camera_from(table: dict[str, Any], folder: Path) -> Camera:
    """Camera of ``bundle.json``; a bundle of schema 1.0 has one focal length and no distortion.

    Raises
    ------
    InputError, ValueError
        If it is no camera.
    """
    if table["model"] not in LENSES:
        raise ValueError(
            f"camera model {table['model']!r} is not known (known: {', '.join(LENSES)})"
        )
    focal = np.broadcast_to(np.asarray(table["focal_px"], dtype=np.float64), 2)
    pose = [*table["position_mm"], *np.ravel(table["rotation"])]
    rotation = np.asarray(table["rotation"], dtype=np.float64)
    if rotation.shape != (3, 3) or len(pose) != 12 or not np.isfinite(pose).all():
        raise InputError(
            "bundle-camera-pose",
            f"{folder}/bundle.json: the camera's pose must be 3 + 9 finite numbers; rebuild the "
            "decoder",
        )
    sides = table["width_px"], table["height_px"]
    rest = (*focal, *table["centre_px"], *table.get("distortion", ()), *table["position_mm"])
    side, reach = max(map(float, sides)), max(abs(float(value)) for value in rest)
    if side > SIDE_MAX_px or reach > REACH_MAX:
        raise InputError(
            "bundle-camera-range",
            f"{folder}/bundle.json: a camera's sides must be at most {SIDE_MAX_px} px and its "
            f"other numbers at most {REACH_MAX:g} (got {side:g} px and {reach:g}); rebuild the "
            "decoder",
        )
    try:
        lens = LENSES[table["model"]](
            width_px=int(table["width_px"]),
            height_px=int(table["height_px"]),
            fx_px=float(focal[0]),
            fy_px=float(focal[1]),
            cx_px=float(table["centre_px"][0]),
            cy_px=float(table["centre_px"][1]),
            distortion=tuple(float(value) for value in table.get("distortion", ())),
        )
    except DesignError as error:
        raise InputError(
            error.code, f"{folder}/bundle.json: {error}; rebuild the decoder"
        ) from error
    return Camera(
        lens=lens,
        position_mm=np.asarray(table["position_mm"], dtype=np.float64),
        rotation=rotation,
    )
