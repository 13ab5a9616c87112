"""The threshold of each marker's switch: the design's, or that of the region it lies in."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.markers import Markers
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


def thresholds_N(design: Design, markers: Markers) -> FloatArray:
    """Threshold of each marker's switch, (n,) N; where regions overlap, the last one counts.

    Raises
    ------
    DesignError
        If a region names rows or markers that the layout does not have.
    """
    out = np.full(markers.count, design.switch.threshold_N)
    for number, region in enumerate(design.switch.regions):
        where = f"switch.regions[{number}]"
        if region.rows:
            if not markers.in_rows:
                raise DesignError(
                    "layout-without-rows",
                    f"{where}.rows: this layout has no rows (kind {design.layout.kind!r}); name "
                    "the region's markers instead",
                )
            last = int(markers.row.max())
            if region.rows[1] > last:
                raise DesignError(
                    "row-out-of-range",
                    f"{where}.rows: the layout has rows 0 to {last} (got {list(region.rows)}); "
                    f"end at {last} or before",
                )
            inside = (markers.row >= region.rows[0]) & (markers.row <= region.rows[1])
            out[inside] = region.threshold_N
        else:
            most = max(region.markers)
            if most >= markers.count:
                raise DesignError(
                    "marker-out-of-range",
                    f"{where}.markers: the layout has markers 0 to {markers.count - 1} (got "
                    f"{most}); leave out those beyond",
                )
            out[list(region.markers)] = region.threshold_N
    return out
