"""Segmentation: paint masks in YCbCr and sub-pixel blob centroids."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from phytac_decoder.vision.brightness import DOTS, dots_as_paint
from phytac_shapes.arrays import FloatArray, ImageArray, IntArray
from phytac_shapes.errors import InputError

HUE_COSINE_MIN = 0.80
"""Chroma within about 37 degrees of a paint's own hue belongs to that paint."""

COUNTS_EXPONENT = 0.8
"""Weights of pixels are their share of full chroma to this power: in proportion to the covered part
of a pixel in sRGB (measured: half covered by paint on a grey wall is a share of 0.41)."""

EDGE_REACH_px = 2
"""Width of the edge around a blob whose pixels count in part."""

LIGHT_STEP, LIGHT_MIN, LIGHT_MAX = 0.05, 0.7, 1.4
"""Changes of light since the rest frame are followed in these steps between these factors of chroma
(half and twice the exposure in sRGB); farther changes count as the last step."""


@dataclass(frozen=True, kw_only=True)
class ColourModel:
    """Hue directions of the paints in the (Cr, Cb) plane.

    A paint in shade keeps its hue and loses chroma, so a pixel's class depends on the direction,
    and its coverage on its share of the paint's full chroma.

    Attributes
    ----------
    names : (k,) str
        Paints; ``red`` is the switches' tip.
    chroma : (k, 2) float
        (Cr - 128, Cb - 128) of each paint under full light.
    floor : float
        Least chroma of a painted pixel, as a fraction of its paint's full chroma.
    edge : float
        Pixels of this share of full chroma and more count where they touch painted ones: the edge
        of a marker counts in part, as far as paint covers its pixels.
    bare : (k,) float, optional
        Share of each paint's full chroma that the bare wall shows; none if not given.
    usual_weight : (c, k) float, optional
        Median weight of each paint's blobs in the rest frame of each camera, NaN of paint without
        blobs; the light is not followed if not given.
    """

    names: tuple[str, ...]
    chroma: FloatArray
    floor: float = 0.3
    edge: float = 0.08
    bare: FloatArray | None = None
    usual_weight: FloatArray | None = None

    def counts(self, share: FloatArray) -> FloatArray:
        """Weights of pixels by their share of their paint's full chroma; 0 below the edge.

        Weights are in proportion to light, without an upper limit, so that a change of exposure
        multiplies all weights of a marker and leaves its centroid where it is.
        """
        return np.where(share >= self.edge, np.maximum(share, 0.0) ** COUNTS_EXPONENT, 0.0)

    @classmethod
    def from_rgb(
        cls,
        paints: Mapping[str, tuple[int, int, int]],
        *,
        wall: tuple[int, int, int] = (0, 0, 0),
    ) -> "ColourModel":
        """Model of paints given as 8-bit RGB; their order is the class order.

        Of dots that differ from the wall by brightness (``DOTS``) it holds the contrast to the
        ``wall``; a rest frame shows from which share on their edges count.
        """
        return _model_of_rgb(tuple((name, tuple(rgb)) for name, rgb in paints.items()), tuple(wall))

    def light(self, blobs: "Blobs", camera: int = 0) -> float:
        """Chroma of the markers' paints in an image over that in the rest frame; 1 if unknown.

        The tips' red, which shows with the switches, does not count.
        """
        if self.usual_weight is None:
            return 1.0
        change = blobs.usual_weight(len(self.names)) / self.usual_weight[camera]
        change = change[[name != "red" for name in self.names]]
        change = change[np.isfinite(change)]
        return float(np.exp(np.log(change).mean() / COUNTS_EXPONENT)) if len(change) else 1.0

    def in_light(self, light: float) -> "ColourModel":
        """Model of the same paints where all chroma is ``light`` times that of the rest frame."""
        step = round(float(np.clip(light, LIGHT_MIN, LIGHT_MAX)) / LIGHT_STEP)
        if step not in self._lights:
            scale = step * LIGHT_STEP
            # Noise does not fade with the light.
            edge = min(max(self.edge, self.edge / scale), self.floor)
            self._lights[step] = replace(self, chroma=self.chroma * scale, edge=edge)
        return self._lights[step]

    @cached_property
    def _lights(self) -> dict[int, "ColourModel"]:
        return {round(1.0 / LIGHT_STEP): self}

    @property
    def dots(self) -> str:
        """Paint of dots that are separated by brightness, see ``DOTS``; "" for coloured paint."""
        return next((name for name in self.names if name in DOTS), "")

    def prepared(self, image_bgr: ImageArray) -> ImageArray:
        """Frame as :func:`segment` reads it: dots separated by brightness become coloured paint.

        Frames of coloured paints, and what is no 8-bit colour image, are returned as they are.
        """
        colour_image = image_bgr.ndim == 3 and image_bgr.shape[2] == 3
        if not self.dots or not colour_image or image_bgr.dtype != np.uint8:
            return image_bgr
        return dots_as_paint(image_bgr, self.dots)

    @cached_property
    def _tables(self) -> tuple[ImageArray, FloatArray]:
        """Class (0 none, 1 + k), and weight by each paint, for every 8-bit (Cr, Cb)."""
        cr, cb = np.meshgrid(np.arange(256.0), np.arange(256.0), indexing="ij")
        plane = np.stack([cr, cb], axis=-1).reshape(-1, 2) - 128.0
        full = np.linalg.norm(self.chroma, axis=1)
        along = plane @ (self.chroma / full[:, None]).T
        size = np.linalg.norm(plane, axis=1)
        best = np.argmax(along / np.maximum(size, 1e-9)[:, None], axis=1)
        picked = along[np.arange(len(best)), best]
        ok = (picked >= HUE_COSINE_MIN * size) & (picked >= self.floor * full[best])
        table = np.where(ok, best + 1, 0).astype(np.uint8)
        bare = np.zeros(len(full)) if self.bare is None else self.bare
        weight = self.counts((along / full - bare) / (1.0 - bare))
        # Red is an area to compare with a threshold, whatever the exposure.
        red = np.array([name == "red" for name in self.names])
        weight = np.where(red, np.minimum(weight, 1.0), weight)
        number = 1 + np.arange(len(full))
        other = (table[:, None] > 0) & (table[:, None] != number)
        # No blob is without weight.
        least = np.where(table[:, None] == number, 1e-6, 0.0)
        return table, np.where(other, 0.0, np.maximum(weight, least))

    @cached_property
    def coverage_tables(self) -> NDArray[np.float32]:
        """Weight (k, 65536) by each paint over Cr · 256 + Cb; 0 where the class is another."""
        return np.ascontiguousarray(self._tables[1].T, dtype=np.float32)

    def classify(self, image_bgr: ImageArray) -> tuple[ImageArray, NDArray[np.uint16]]:
        """Class of each pixel (h, w) uint8 and its flat index into the (Cr, Cb) tables."""
        ycc = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YCrCb)
        flat = ycc[:, :, 1].astype(np.uint16)
        flat <<= 8
        flat |= ycc[:, :, 2]
        return self._tables[0][flat], flat

    def coverage(self, flat: NDArray[np.uint16], colour: int) -> FloatArray:
        """Weight of pixels by a paint."""
        return np.asarray(self._tables[1][flat, colour])


# A model's tables take longer than to segment a small frame by them.
@lru_cache(maxsize=4)
def _model_of_rgb(
    paints: tuple[tuple[str, tuple[int, ...]], ...], wall: tuple[int, ...]
) -> ColourModel:
    """The same model for the same paints, see ``ColourModel.from_rgb``."""
    dots = [rgb for name, rgb in paints if name in DOTS]
    dot = (0, 0, int(np.abs(np.subtract(dots, wall)).mean())) if dots else (0, 0, 0)
    rgb = np.array([[dot if name in DOTS else rgb for name, rgb in paints]], dtype=np.uint8)
    ycc = cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb)[0].astype(np.float64)
    chroma = ycc[:, 1:] - 128.0
    chroma.flags.writeable = False
    return ColourModel(
        names=tuple(name for name, _ in paints),
        chroma=chroma,
        edge=ColourModel.floor if dots else ColourModel.edge,
    )


@dataclass(frozen=True, kw_only=True)
class Blobs:
    """Connected same-colour regions of one image.

    Attributes
    ----------
    colour : (m,) int
        Index into the colour model's names.
    centroid_px : (m, 2) float
        Chroma-weighted centroid (x, y).
    area_px : (m,) int
        Pixels.
    weight : (m,) float
        Sum of weights: the blob's area with partial pixels counted in part.
    box_px : (m, 4) int
        Left, top, right and bottom pixel of each.
    labels : (h, w) int32 or None
        1 + blob index of each painted pixel, 0 outside blobs; if requested.
    """

    colour: IntArray
    centroid_px: FloatArray
    area_px: IntArray
    weight: FloatArray
    box_px: IntArray
    labels: NDArray[np.int32] | None = None

    def usual_weight(self, paints: int) -> FloatArray:
        """Median weight (k,) of each paint's blobs; NaN of paint without blobs."""
        each = [self.weight[self.colour == paint] for paint in range(paints)]
        return np.array([np.median(weight) if len(weight) else np.nan for weight in each])


def check_image(image: ImageArray, *, width_px: int, height_px: int) -> ImageArray:
    """Return an 8-bit colour image of the expected size.

    Raises
    ------
    InputError
        If it is not (height, width, 3) uint8.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "frame-type",
            f"image must be 8-bit colour (h, w, 3); got shape {image.shape}, {image.dtype}",
        )
    if image.shape[:2] != (height_px, width_px):
        raise InputError(
            "frame-size",
            f"image is {image.shape[1]}x{image.shape[0]} px, the decoder was made for "
            f"{width_px}x{height_px}; use frames of that camera mode or rebuild the design with it",
        )
    return image


def segment(
    image_bgr: ImageArray, model: ColourModel, *, area_min_px: int = 3, with_labels: bool = False
) -> Blobs:
    """Find every painted blob of at least ``area_min_px`` pixels (8-connected, per colour).

    Pixels around a blob count for it in part: cut off at the paint's floor, edges would move
    centroids with the sub-pixel position of a marker (0.05 px RMS instead of 0.025).
    """
    classes, flat = model.classify(image_bgr)
    labels = np.zeros(classes.shape, dtype=np.int32) if with_labels else None
    parts: list[tuple[IntArray, FloatArray, IntArray, FloatArray, IntArray]] = []
    found = 0
    for colour in range(len(model.names)):
        mask = cv2.compare(classes, colour + 1, cv2.CMP_EQ)
        # Nothing but the box around the paint, and what its edges reach.
        corner, part = _around(mask)
        mask = mask[part]
        own, renumber, boxes, area = _components(mask, area_min_px)
        x, y = _pixels(mask)
        small = renumber[own[y, x]] == 0
        own[y[small], x[small]] = 0
        wide = _with_edges(own)
        x, y = _pixels(cv2.compare(wide, 0, cv2.CMP_GT))
        blob = renumber[wide[y, x].astype(np.int64)]
        size = len(boxes) + 1
        weight = model.coverage(flat[part][y, x], colour)
        total = np.bincount(blob, weights=weight, minlength=size)[1:]
        sums = [
            np.bincount(blob, weights=weight * (c + first), minlength=size)[1:]
            for c, first in zip((x, y), corner, strict=True)
        ]
        if labels is not None:
            inside = renumber[own[y, x]] == blob
            labels[part][y[inside], x[inside]] = blob[inside] + found
        boxes = boxes + np.tile(corner, 2)
        found += size - 1
        parts.append(
            (
                np.full(size - 1, colour, dtype=np.int64),
                np.column_stack(sums) / total[:, None],
                area,
                np.asarray(total, dtype=np.float64),
                boxes,
            )
        )
    colours, centroids, areas, weights, corners = (
        list(column) for column in zip(*parts, strict=True)
    )
    return Blobs(
        colour=np.concatenate(colours),
        centroid_px=np.concatenate(centroids),
        area_px=np.concatenate(areas),
        weight=np.concatenate(weights),
        box_px=np.concatenate(corners),
        labels=labels,
    )


def segment_in_its_light(image_bgr: ImageArray, model: ColourModel, *, camera: int = 0) -> Blobs:
    """Blobs of an image whose exposure may differ from that of the rest frame.

    Paint in less light would fall below the floor, and tips would show less red than their share.
    """
    blobs = segment(image_bgr, model)
    lit = model.in_light(model.light(blobs, camera))
    return blobs if lit is model else segment(image_bgr, lit)


def _around(mask: ImageArray) -> tuple[IntArray, tuple[slice, slice]]:
    """Box around the pixels that are not 0, and their edges: its corner (x, y), and its slices."""
    left, top, width, height = cv2.boundingRect(mask)
    x, y = max(left - EDGE_REACH_px, 0), max(top - EDGE_REACH_px, 0)
    part = slice(y, top + height + EDGE_REACH_px), slice(x, left + width + EDGE_REACH_px)
    return np.array([x, y]), part


def _pixels(mask: ImageArray) -> IntArray:
    """Column and row (2, m) of the pixels that are not 0."""
    found = cv2.findNonZero(mask)
    # OpenCV 4 returns (m, 1, 2), OpenCV 5 (m, 2).
    return np.zeros((2, 0), dtype=np.int64) if found is None else found.reshape(-1, 2).T


def _with_edges(labels: NDArray[Any]) -> NDArray[Any]:
    """Label image with the edges of labelled regions, which do not grow into each other."""
    # OpenCV dilates 16-bit and floating-point images, not 32-bit integers.
    exact = labels if labels.dtype == np.uint16 else labels.astype(np.float32)
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * EDGE_REACH_px + 1,) * 2)
    wide = cv2.dilate(exact, around)
    cv2.copyTo(exact, cv2.compare(exact, 0, cv2.CMP_GT), wide)
    return np.asarray(wide)


def _components(
    mask: ImageArray, area_min_px: int
) -> tuple[NDArray[Any], IntArray, IntArray, IntArray]:
    """Label image of a mask; blob number (0: too small) of each label; boxes, areas of blobs."""
    # 16-bit labels are three times faster; a label starts at the beginning of a run of pixels, so
    # an image with fewer runs than 16-bit numbers cannot overflow them.
    runs = cv2.countNonZero(cv2.compare(mask[:, 1:], mask[:, :-1], cv2.CMP_GT)) + len(mask)
    kind = cv2.CV_16U if runs < 65000 else cv2.CV_32S
    count, own, stats, _ = cv2.connectedComponentsWithStats(mask, ltype=kind)
    keep = stats[:, cv2.CC_STAT_AREA] >= area_min_px
    keep[0] = False
    renumber = np.zeros(count, dtype=np.int64)
    renumber[keep] = np.arange(1, int(keep.sum()) + 1)
    left, top, width, height, area = stats[keep, :5].astype(np.int64).T
    boxes = np.column_stack([left, top, left + width - 1, top + height - 1])
    return own, renumber, boxes, area
