"""``phytac check``: rules, visibility and density of a design, with no solid and no mesh."""

import time
from typing import Any

import numpy as np

from phytac_design.check import check_design
from phytac_design.optics.density import density_of
from phytac_design.optics.separability import check_paints
from phytac_design.optics.view import camera_of
from phytac_design.optics.visibility import check_visibility, visibility_advice
from phytac_design.spec import Design


def checkup(design: Design, *, seed: int = 0) -> dict[str, Any]:
    """Figures of the report that need only layout and camera.

    Raises
    ------
    DesignError
        If the design cannot be printed or seen at all.
    """
    start = time.perf_counter()
    surface, markers = check_design(design)
    camera = camera_of(design, surface)
    rng = np.random.default_rng(seed)
    seen = check_visibility(design, surface, markers, rng=rng, camera=camera)
    density = density_of(surface, markers)
    summary = seen.summary()
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
        "occluded_markers": np.flatnonzero(seen.occluded).tolist(),
        "fused_markers": np.flatnonzero(seen.fused).tolist(),
        "clear": summary["occluded"] == 0 and summary["fused"] == 0,
        "advice": visibility_advice(
            design, markers, np.flatnonzero(seen.occluded), np.flatnonzero(seen.fused)
        ),
        "stand_off_mm": float(-camera.position_mm[2]),
        "seconds": time.perf_counter() - start,
    }
