"""The turnable shell and the map of one build: what colours the markers, and the HTML."""

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from phytac_design.engine.stage import Context
from phytac_design.layout.cameras import cameras_of
from phytac_design.optics.density import density_map
from phytac_design.report import page
from phytac_design.report.viewer.data import Colouring, base_colourings, viewer_data
from phytac_design.report.viewer.still import still_picture
from phytac_shapes.arrays import FloatArray

GAP_PX = 60.0
"""Gaps are shown up to this."""
FORCE_N = 10.0
"""Force of the contact whose bounds are shown."""
DATA_ID = "phytac-data"


def colourings_of(context: Context, estimator: str) -> list[Colouring]:
    """Everything that a build knows of each marker, in the order in which it is offered.

    Parameters
    ----------
    estimator : str
        Whose errors on held-out contacts are shown.
    """
    markers = context.markers
    views, load = context.arrays("views"), context.arrays("underload")
    bound = context.arrays("resolution")
    alike = f"{GAP_PX:g} px and more alike"
    number, paint, height = base_colourings(markers)
    force = context.design.training.force_max_N
    error, contacts = errors_N(context, estimator)
    return [
        paint,
        number,
        Colouring(
            key="visible_fraction", label="visible fraction", values=views["visible_fraction"]
        ),
        Colouring(
            key="gap_px",
            label="gap to its own colour",
            unit="px",
            values=np.minimum(views["gap_same_colour_px"], GAP_PX),
            note=alike,
        ),
        Colouring(
            key="load_gap_px",
            label="least gap under load",
            unit="px",
            values=np.minimum(load["least_gap_same_px"], GAP_PX),
            note=f"under any press with {force:g} N; {alike}",
        ),
        Colouring(
            key="crosstalk_px",
            label="crosstalk under load",
            unit="px",
            values=load["crosstalk_px"],
            note=f"greatest under any press with {force:g} N",
        ),
        Colouring(
            key="density",
            label="density",
            unit="per cm²",
            values=density_map(context.surface, markers).per_cm2,
        ),
        height,
        Colouring(
            key="bound_N",
            label=f"resolution of {FORCE_N:g} N",
            unit="N",
            values=bound[f"force_N_{FORCE_N:g}"],
            note="least standard deviation (Cramér-Rao bound)",
        ),
        Colouring(
            key="bound_along_mm",
            label="resolution of place, along",
            unit="mm",
            values=bound[f"along_mm_{FORCE_N:g}"],
            note=f"the same of where a contact of {FORCE_N:g} N is",
        ),
        Colouring(
            key="softness",
            label="softness",
            unit="µm/N",
            values=softness_um_N(context),
            note="inward motion under a force of 1 N on the marker's own cell",
        ),
        Colouring(
            key="error_N",
            label="force error",
            unit="N",
            values=error,
            note=f"mean over the held-out contacts nearest to it, by {estimator}, simulated",
        ),
        Colouring(key="contacts", label="held-out contacts", values=contacts),
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
        judged = twin[f"{name}.tripped"]
        error = np.abs(decoded[f"{name}.{estimator}"] - twin[f"{name}.force_N"])[judged]
        nearest = tree.query(surface.point(twin[f"{name}.uv"])[judged])[1]
        np.add.at(total, nearest, error)
        np.add.at(count, nearest, 1.0)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan), count


def explorer_data(context: Context, estimator: str) -> dict[str, Any]:
    """Data of the shell and the map, as ``report/viewer.json`` holds them."""
    design, surface = context.design, context.surface
    return viewer_data(
        design,
        surface,
        context.markers,
        colourings_of(context, estimator),
        cameras=cameras_of(design, surface),
    )


def explorer_section(context: Context, layout_map: bytes) -> str:
    """HTML in which the scripts draw; pictures show where they cannot, and in print.

    Parameters
    ----------
    layout_map : bytes
        PNG of the map, for want of scripts.
    """
    shell = still_picture(context.design, context.surface, context.markers)
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
