"""The interactive shell and map of one build: colourings of the markers, and the HTML."""

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.core import html as page
from phytac_design.engine.stage import Context
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_map
from phytac_design.report.viewer.data import Colouring, base_colourings, viewer_data
from phytac_design.report.viewer.still import still_picture
from phytac_shapes.arrays import FloatArray

GAP_PX = 60.0
"""Gaps are shown up to this."""
DATA_ID = "phytac-data"


def colourings_of(context: Context, estimator: str) -> list[Colouring]:
    """Results of a build for each marker, in the order of the page's list.

    Parameters
    ----------
    estimator : str
        Estimator whose errors on held-out contacts are shown.
    """
    views, load = context.arrays("views"), context.arrays("underload")
    bound = context.arrays("resolution")
    force = f"{context.design.training.force_max_N:g}"  # N, of the contact whose bounds are shown
    clipped = f"{GAP_PX:g} px and more alike"
    number, paint, height = base_colourings(context.markers)
    press = f"any press with {force} N"
    gap, load_gap = (
        np.minimum(values, GAP_PX)
        for values in (views["gap_same_colour_px"], load["least_gap_same_px"])
    )
    density = density_map(context.surface, context.markers).per_cm2
    error, contacts = errors_N(context, estimator)
    return [
        paint,
        number,
        Colouring("visible_fraction", "visible fraction", views["visible_fraction"]),
        Colouring("gap_px", "gap to its own colour", gap, "px", clipped),
        Colouring(
            "load_gap_px", "smallest gap under load", load_gap, "px", f"under {press}; {clipped}"
        ),
        Colouring(
            "crosstalk_px",
            "crosstalk under load",
            load["crosstalk_px"],
            "px",
            f"largest under {press}",
        ),
        Colouring("density", "density", density, "per cm²"),
        height,
        Colouring(
            "bound_N",
            f"resolution of {force} N",
            bound[f"force_N_{force}"],
            "N",
            f"smallest standard deviation of {force} N, the design's largest force (Cramér-Rao "
            "bound)",
        ),
        Colouring(
            "bound_along_mm",
            "resolution of place, along",
            bound[f"along_mm_{force}"],
            "mm",
            f"the same for the place of a contact of {force} N",
        ),
        Colouring(
            "softness",
            "softness",
            softness_um_N(context),
            "µm/N",
            "inward motion under a force of 1 N on the marker's own cell",
        ),
        Colouring(
            "error_N",
            "force error",
            error,
            "N",
            f"mean over the held-out contacts nearest to it, by {estimator}, simulated",
        ),
        Colouring("contacts", "held-out contacts", contacts),
    ]


def softness_um_N(context: Context) -> FloatArray:
    """Inward motion (n,) of each marker under a force on its own cell, µm/N; NaN out of play."""
    response = context.arrays("response")
    n = context.markers.count
    seen = response["compliance_px"].reshape(n, 2, n)[np.arange(n), :, np.arange(n)]
    motion = 1e3 * np.einsum("ni,ni->n", response["shift_to_mm"], seen)
    return np.where(motion != 0.0, motion, np.nan)


def errors_N(context: Context, estimator: str) -> tuple[FloatArray, FloatArray]:
    """Mean absolute error (n,) of the held-out contacts nearest to each marker, N; their number.

    Of contacts that tripped a switch; NaN where there is none.
    """
    surface, markers = context.surface, context.markers
    twin, decoded = context.arrays("twin"), context.arrays("decoder")
    total, count = np.zeros(markers.count), np.zeros(markers.count)
    tree = cKDTree(surface.point(markers.uv))
    for name in ("test", "anywhere"):
        tripped = twin[f"{name}.tripped"]
        error = np.abs(decoded[f"{name}.{estimator}"] - twin[f"{name}.force_N"])[tripped]
        nearest = tree.query(surface.point(twin[f"{name}.uv"])[tripped])[1]
        np.add.at(total, nearest, error)
        np.add.at(count, nearest, 1.0)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan), count


def explorer_data(context: Context, estimator: str) -> dict[str, Any]:
    """Data of the shell and the map, as ``report/viewer.json`` holds them."""
    design, surface = context.design, context.surface
    return viewer_data(
        Sensor.of(design, surface, context.markers),
        colourings_of(context, estimator),
        cameras=cameras_of(design, surface),
    )


def explorer_section(context: Context, layout_map: bytes) -> str:
    """HTML in which the scripts draw; without scripts and in print it shows pictures.

    Parameters
    ----------
    layout_map : bytes
        PNG of the map.
    """
    shell = still_picture(context.sensor)
    still = ' class="still"'
    return (
        f'<div class="explorer" data-from="{DATA_ID}"><div class="pair"><figure><div class="shell">'
        + page.image(
            shell, "The shell, cut open, markers in their paint", name="shell.png", extra=still
        )
        + "</div><figcaption>The shell. Drag to turn it, or use the arrow keys.</figcaption>"
        '</figure><figure><div class="map">'
        + page.image(layout_map, "The layout of the markers", name="layout.png", extra=still)
        + "</div><figcaption>The markers laid flat. Point at one, or go with the arrow keys, for "
        "its numbers.</figcaption></figure></div></div>"
    )
