"""How the ID map and the sampled path grow with the number of markers; what tessellation costs."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Table
from benchmarks.mechanics_cost import exponent
from benchmarks.visibility_lenses import CAMERAS, make, scene_at
from phytac_decoder.camera.camera import Camera
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import TOLERANCE_PX
from phytac_design.optics.raster import pixels_alone, rasterise
from phytac_design.optics.render_scene import RenderScene, paint_owner
from phytac_design.optics.sampled_visibility import sampled_fraction
from phytac_shapes.arrays import FloatArray

LATTICES = {368: (23, 16), 1000: (40, 25), 3000: (75, 40), 10_000: (125, 80)}
"""Rows and columns by number of markers."""
FINER = 5.0
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
    sizes = [float(count) for count in counts]
    for name, values in found.items():
        row = f"{name}: exponent over {counts[0]} to {counts[-1]} markers"
        source = "linear growth"
        note = (
            "seconds as a power of the number of markers; smaller markers get fewer triangles each"
        )
        table.add(row, exponent(sizes, values), "-", 1.0, source, "<= 1", note)


def seen(scene: RenderScene, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Visible fraction (n,), centroid (n, 2) and number (n,) of each marker's visible pixels."""
    owner = paint_owner(rasterise(scene, camera).part)
    y, x = np.nonzero(owner >= 0)
    marker = owner[y, x]
    count = np.bincount(marker, minlength=scene.count).astype(np.float64)
    alone = pixels_alone(scene, camera)[0]
    fraction = np.divide(count, alone, out=np.zeros(scene.count), where=alone > 0)
    sums = np.stack([np.bincount(marker, weights=c, minlength=scene.count) for c in (x, y)], axis=1)
    centroid = np.full((scene.count, 2), np.nan)
    np.divide(sums, count[:, None], out=centroid, where=count[:, None] > 0)
    return fraction, centroid, count


def tessellation(table: Table, label: str, design: Design, repeats: int) -> None:
    """Error of the shipped tolerance against a finer one, and the triangles and time it saves."""
    scene, camera = scene_at(design)
    fine, _ = scene_at(design, finer=FINER)
    own, better = seen(scene, camera), seen(fine, camera)
    fraction = np.abs(own[0] - better[0])
    moved = np.linalg.norm(own[1] - better[1], axis=1)
    least = float(own[2][own[2] > 0].min())
    source = f"own exact ID map with a tolerance of {TOLERANCE_PX / FINER:g} px"
    rows: list[tuple[str, float, str, str | None]] = [
        ("largest error of a visible fraction", float(fraction.max()), "-", "<= 0.02"),
        ("largest error of a centroid", float(np.nanmax(moved)), "px", f"<= {TOLERANCE_PX:g}"),
        ("mean error of a centroid", float(np.nanmean(moved)), "px", None),
    ]
    for what, value, unit, target in rows:
        row = f"{label}: polygons within {TOLERANCE_PX:g} px of their circles: {what}"
        note = (
            f"{scene.count} markers, the smallest of {least:.0f} px: there one pixel more on "
            f"the outline moves the centroid by {0.56 / np.sqrt(least):.2f} px"
        )
        table.add(row, value, unit, 0.0, source, target, note)
    slow = costs(partial(rasterise, fine, camera), repeats)[0]
    fast = costs(partial(rasterise, scene, camera), repeats)[0]
    for what, saved, was in (
        ("triangles", len(scene.triangles) / len(fine.triangles), len(fine.triangles)),
        ("processor seconds of an ID map", fast / slow, slow),
    ):
        row = f"{label}: {what}, share of those with {FINER:g}x finer polygons"
        table.add(row, saved, "ratio", was, source, "<= 1")


def add_rows(table: Table, *, quick: bool) -> None:
    """Growth to 10 000 markers, and tessellation."""
    factor, repeats = (4, 1) if quick else (1, 3)
    most = 1000 if quick else max(LATTICES)
    growth(table, factor=factor, repeats=repeats, most=most)
    designs: dict[str, Any] = {
        "cylinder, pinhole": make({}, factor=factor),
        "cylinder, kannala_brandt": make(CAMERAS["kannala_brandt"], factor=factor),
        "hemisphere": load_design("hemisphere"),
    }
    for label, design in designs.items():
        tessellation(table, label, design, repeats)
