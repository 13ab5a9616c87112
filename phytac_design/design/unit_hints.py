"""Lengths of a design that look as if they were given in another unit than millimetres."""

from collections.abc import Iterator, Mapping
from typing import Any

SIZE_mm = (8.0, 3000.0), (10.0, 1000.0)
USUAL_mm: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "shape.length_mm": SIZE_mm,
    "shape.width_mm": SIZE_mm,
    "shape.height_mm": SIZE_mm,
    "shape.depth_mm": SIZE_mm,
    "shape.diameter_outer_mm": SIZE_mm,
    "shape.diameter_near_mm": SIZE_mm,
    "shape.diameter_far_mm": SIZE_mm,
    "shape.diameters_mm": SIZE_mm,
    "wall.thickness_mm": ((0.15, 20.0), (0.3, 6.0)),
    "layout.height_far_mm": ((0.3, 200.0), (1.0, 40.0)),
    "receptor.diameter_outer_mm": ((0.5, 50.0), (1.0, 12.0)),
    "receptor.diameter_hole_mm": ((0.3, 40.0), (0.5, 10.0)),
    "camera.stand_off_mm": ((0.5, 3000.0), (5.0, 500.0)),
}
"""Main lengths: the range outside of which a value is odd, and the range of usual sensors. Chosen
by hand: receptors of 2 to 3 mm fit no body of less than 8 mm."""
UNITS_mm = {"cm": 10.0, "m": 1000.0, "µm": 0.001}


def unit_hints(data: Any) -> list[str]:
    """One sentence for each main length that would be usual in another unit.

    Parameters
    ----------
    data : dict
        Tables of a design file, valid or not.
    """
    hints = []
    for field, ((low, high), (least, most)) in USUAL_mm.items():
        for value in _numbers(data, field):
            if low <= value <= high:
                continue
            for unit, factor in UNITS_mm.items():
                if least <= value * factor <= most:
                    hints.append(
                        f"{field} = {value:g} looks like {unit}: lengths are in mm, and "
                        f"{value:g} {unit} are {value * factor:g} mm"
                    )
                    break
    return list(dict.fromkeys(hints))


def _numbers(data: Any, field: str) -> Iterator[float]:
    """Numbers in a field: one, those of a list, or none; 0 means "none" in design files."""
    table, _, name = field.partition(".")
    tables = data.get(table) if isinstance(data, Mapping) else None
    found = tables.get(name) if isinstance(tables, Mapping) else None
    for value in found if isinstance(found, list | tuple) else [found]:
        # Nothing larger is a length; whole numbers of any size come from damaged files.
        if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e9:
            yield value
