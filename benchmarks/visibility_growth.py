"""How the ID map and the sampled path grow with the number of markers; rows of ``visibility``."""

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.harness import Table
from benchmarks.visibility_lenses import make, scene_at
from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import RenderScene
from phytac_design.optics.sampled_visibility import sampled_fraction

LATTICES = {368: (23, 16), 1000: (40, 25), 3000: (75, 40), 10_000: (125, 80)}
"""Rows and columns by number of markers."""
PATHS: dict[str, Callable[[RenderScene, Camera], object]] = {
    "exact ID map": rasterise,
    "sampled path": sampled_fraction,
}


def dense(markers: int, *, factor: int) -> Design:
    """The cylinder with a given number of markers, of a size that fits."""
    rows, columns = LATTICES[markers]
    small = min(1.0, 16.0 / columns, 23.0 / rows)
    receptor = {"diameter_outer_mm": 3.0 * small, "diameter_hole_mm": 1.6 * small}
    receptor["band_marker_mm"] = 1.0 * small
    switch = {"tip_diameter_mm": 1.2 * small}
    layout = {"rows": rows, "columns": columns}
    return make({}, factor=factor, layout=layout, receptor=receptor, switch=switch)


def costs(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Median processor seconds (all threads) and wall seconds after one warm-up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time(), time.perf_counter()
        work()
        times.append((time.process_time() - start[0], time.perf_counter() - start[1]))
    busy, wall = np.median(times, axis=0)
    return float(busy), float(wall)


def growth(table: Table, *, factor: int, repeats: int, most: int) -> None:
    """Seconds of both paths by number of markers, and their exponents."""
    counts = [n for n in LATTICES if n <= most]
    found: dict[str, list[float]] = {name: [] for name in PATHS}
    for count in counts:
        scene, camera = scene_at(dense(count, factor=factor))
        for name, path in PATHS.items():
            busy, wall = costs(partial(path, scene, camera), repeats)
            found[name].append(busy)
            row = f"{count} markers: {name}"
            source = "own; processor seconds of all threads"
            note = (
                f"{len(scene.triangles)} triangles, {camera.width_px}x{camera.height_px}; "
                f"{wall:.3f} s on the clock"
            )
            table.add(row, busy, "s", "none", source, note=note)
    for name, values in found.items():
        row = f"{name}: exponent over {counts[0]} to {counts[-1]} markers"
        source = "linear growth"
        note = (
            "seconds as a power of the number of markers; smaller markers get fewer triangles each"
        )
        exponent = float(np.polyfit(np.log(counts), np.log(values), 1)[0])
        table.add(row, exponent, "-", 1.0, source, "<= 1", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Growth to 10 000 markers."""
    growth(table, factor=4 if quick else 1, repeats=1 if quick else 3,
           most=1000 if quick else max(LATTICES))  # fmt: skip
