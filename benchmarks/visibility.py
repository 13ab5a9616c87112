"""What cameras see: lenses against Embree rays, layouts, density, a frame.

``python -m benchmarks.visibility [--quick] [--parts maps,lenses,layouts]``
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks import visibility_layouts, visibility_lenses
from benchmarks.harness import Table, run_parts
from benchmarks.visibility_lenses import busy, scene_at, seconds
from phytac_design.design.design_file import load_design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_of
from phytac_design.optics.frame_renderer import render_frame


def maps(table: Table) -> None:
    """The published cylinder: density, and a frame."""
    design = load_design("cylinder60")
    sensor = Sensor(design)
    density = density_of(sensor.surface, sensor.markers)
    row = f"{design.name}: density on a surface {density.surface_class} to the optical axis"
    note = f"{density.count} markers on {density.area_cm2:.1f} cm2, outer face"
    table.add(row, density.per_cm2, "1/cm2", 1.63, "paper", "<= 1.64", note)
    scene, camera = scene_at(design)
    render_frame(scene, camera)
    noise = np.random.default_rng(0)
    row = f"{design.name}: noisy anti-aliased frame"
    note = f"8 samples per pixel; {busy()}"
    value = seconds(lambda: render_frame(scene, camera, noise_std=2.0, rng=noise))
    table.add(row, value, "s", "none", "own target", "<= 1.5", note)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""
    return {
        "maps": maps,
        "lenses": partial(visibility_lenses.add_rows, quick=quick),
        "layouts": partial(visibility_layouts.add_rows, quick=quick),
    }


if __name__ == "__main__":
    run_parts("visibility", parts, __doc__ or "")
