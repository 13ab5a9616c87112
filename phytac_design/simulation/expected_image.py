"""What the decoder's marker detector finds on the rendered sensor, before the first real frame."""

from dataclasses import dataclass

import numpy as np

from phytac_decoder.vision.matching import match_markers
from phytac_decoder.vision.segmentation import Blobs, ColourModel, segment
from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.optics.paint import paints_of
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray


@dataclass(frozen=True, kw_only=True)
class ExpectedView:
    """Expectations over n markers, measured in frames by the decoder's segmentation.

    Attributes
    ----------
    rest_px : (n, 2) float
        Marker positions with all switches off.
    tip_bias_px : (n, 2) float
        Shift of a marker's centroid by its red tip alone: the tip covers some of its paint.
    tips : TipModel
        Red of each tip.
    """

    rest_px: FloatArray
    tip_bias_px: FloatArray
    tips: TipModel


def colour_model(design: Design) -> tuple[ColourModel, IntArray]:
    """Colour model of the paints in use, and the class of each of the design's colours."""
    names = (*dict.fromkeys(design.layout.colours), "red")
    model = ColourModel.from_rgb(paints_of(names))
    return model, np.array([names.index(name) for name in design.layout.colours])


def measure_expected(
    design: Design,
    markers: Markers,
    *,
    rest_frame: ImageArray,
    on_frame: ImageArray,
    marker_px: FloatArray,
    red_px: FloatArray,
) -> ExpectedView:
    """Measure rest positions, tip bias and red areas in two noise-free frames.

    Parameters
    ----------
    rest_frame, on_frame : (h, w, 3) uint8
        All switches off, all on.
    marker_px, red_px : (n, 2) float
        Exact centroids of the visible paint at rest, and of the visible red with switches on
        (NaN where none), from the ID map.
    """
    model, classes = colour_model(design)
    colour = classes[markers.colour]
    seen = [
        match_markers(
            segment(frame, model), rest_px=marker_px, colour=colour, neighbours=markers.neighbours
        )
        for frame in (rest_frame, on_frame)
    ]
    rest = np.where(seen[0].found[:, None], seen[0].position_px, marker_px)
    bias = np.nan_to_num(seen[1].position_px - rest)
    red = model.names.index("red")
    rest_area = _red_area(segment(rest_frame, model, area_min_px=1), red, red_px)
    on_area = _red_area(segment(on_frame, model, area_min_px=1), red, red_px)
    return ExpectedView(
        rest_px=rest,
        tip_bias_px=bias,
        tips=TipModel(on_px=red_px, red_rest_px=rest_area, red_on_px=on_area),
    )


def _red_area(blobs: Blobs, red: int, red_px: FloatArray) -> FloatArray:
    """Red area (n,) near each expected tip: every red blob counts for the nearest."""
    area = np.zeros(len(red_px))
    pick = np.flatnonzero(blobs.colour == red)
    known = np.flatnonzero(np.isfinite(red_px[:, 0]))
    if len(pick) == 0 or len(known) == 0:
        return area
    gap = blobs.centroid_px[pick, None] - red_px[known][None]
    nearest = known[np.argmin(np.linalg.norm(gap, axis=2), axis=1)]
    np.add.at(area, nearest, blobs.weight[pick])
    return area
