"""Lens figures of the check and the report: of all markers, and row by row."""

from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.sharpness import DIRECTIONS, sharpness
from phytac_shapes.arrays import IntArray

BANDS = 8
"""Groups by number, of markers that are not in rows."""


def lens_facts(sensor: Sensor, camera: Camera) -> dict[str, Any]:
    """Scale, centroid noise, blur and depth of field; ``rows`` holds the medians of each row.

    Raises
    ------
    DesignError
        If nothing is sharp.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    found = sharpness(design.camera, camera, surface, markers)
    group = row_groups(markers)
    rows = []
    for number in np.unique(group):
        own = group == number
        rows.append(
            {
                "row": int(number),
                "markers": int(own.sum()),
                **{
                    f"mm_per_px_{name}": float(np.median(found.mm_per_px[own, i]))
                    for i, name in enumerate(DIRECTIONS)
                },
                **{
                    f"noise_{name}_mm": float(np.median(found.noise_mm[own, i]))
                    for i, name in enumerate(DIRECTIONS)
                },
                "blur_px": float(found.blur_px[own].max()),
            }
        )
    return found.summary() | {"rows": rows}


def row_groups(markers: Markers) -> IntArray:
    """Row of each marker (n,), or one of ``BANDS`` equal groups along u where there are no rows."""
    if markers.in_rows:
        return markers.row
    order = np.argsort(np.argsort(markers.uv[:, 0], kind="stable"), kind="stable")
    return np.asarray(order * BANDS // markers.count)
