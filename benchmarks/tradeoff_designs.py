"""Random designs of every family, 60 to 400 markers, that can be printed and seen."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.spec import Design
from phytac_design.rules.check import check_design
from phytac_shapes.errors import PhytacError

FAMILIES = ("cylinder60", "cone", "cuboid", "grip", "hemisphere", "plane", "patch")
"""Shipped designs that the random ones grow from."""
LENGTHS = ("diameter_outer_mm", "length_mm", "diameter_near_mm", "diameter_far_mm", "width_mm",
           "depth_mm", "height_mm", "diameters_mm", "points_mm")  # fmt: skip
"""Sizes of a shape that are scaled together."""
MARKERS = (60, 400)
PIXELS = ((864, 648), (1296, 972), (2592, 1944))
TRIES = 30


def random_designs(count: int, seed: int) -> Iterator[Design]:
    """Designs drawn in turn from all families; what :func:`check_design` refuses is drawn again."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        for _ in range(TRIES):
            design = _drawn(FAMILIES[number % len(FAMILIES)], number, rng)
            if design is not None:
                yield design
                break
        else:
            raise AssertionError(f"no design {number} passes its check in {TRIES} tries")


def _drawn(base: str, number: int, rng: np.random.Generator) -> Design | None:
    """One candidate; None if it cannot be built."""
    data: dict[str, Any] = load_design(base).model_dump(mode="json")
    size = float(rng.uniform(0.75, 1.2))
    pitch = float(rng.uniform(0.95, 1.3)) / size
    shape, layout, camera = data["shape"], data["layout"], data["camera"]
    for name in LENGTHS:
        if name in shape:
            shape[name] = (np.array(shape[name]) * size).tolist()
    layout["rows"] = max(round(layout["rows"] / pitch), 2)
    layout["columns"] = max(2 * round(layout["columns"] / pitch / 2.0), 2)
    layout["count"] = max(round(layout["count"] / pitch**2), 4)
    for name in ("height_near_mm", "height_far_mm"):
        layout[name] *= size
    pixels = PIXELS[int(rng.integers(len(PIXELS)))]
    camera["focal_px"] *= pixels[0] / camera["width_px"]
    camera["width_px"], camera["height_px"] = pixels
    data["wall"]["thickness_mm"] = float(rng.uniform(0.7, 1.4))
    force = float(rng.uniform(8.0, 25.0))
    data["training"] |= {"force_max_N": force, "samples": 200, "samples_test": 200}
    data["name"] = f"random-{number}-{base}"
    try:
        design = parse_design(data, data["name"])
        markers = check_design(design).markers
    except PhytacError:
        return None
    return design if MARKERS[0] <= markers.count <= MARKERS[1] else None
