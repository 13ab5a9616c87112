"""Eyes: paint masks in YCbCr and sub-pixel blob centroids."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from shapes.arrays import FloatArray, ImageArray, IntArray
from shapes.errors import InputError

COSINE_MIN = 0.80
"""Chroma within about 37 degrees of a paint's own hue belongs to that paint."""


@dataclass(frozen=True, kw_only=True)
class ColourModel:
    """Hue directions of the paints in the (Cr, Cb) plane.

    A paint in shade keeps its hue and loses chroma, so a pixel's class is decided by direction,
    and its coverage by how much of the paint's full chroma it has.

    Attributes
    ----------
    names : (k,) str
        Paints; ``red`` is the switches' tip.
    chroma : (k, 2) float
        (Cr - 128, Cb - 128) of each paint under full light.
    floor : float
        Least chroma of a painted pixel, as a fraction of its paint's full chroma.
    """

    names: tuple[str, ...]
    chroma: FloatArray
    floor: float = 0.3

    @classmethod
    def from_rgb(cls, paints: Mapping[str, tuple[int, int, int]]) -> "ColourModel":
        """Model of paints given as 8-bit RGB; their order is the class order."""
        rgb = np.array([list(paints.values())], dtype=np.uint8)
        ycc = cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb)[0].astype(np.float64)
        return cls(names=tuple(paints), chroma=ycc[:, 1:] - 128.0)

    @cached_property
    def _tables(self) -> tuple[ImageArray, FloatArray]:
        """Class (0 none, 1 + k) and coverage in [0, 1] for every 8-bit (Cr, Cb)."""
        cr, cb = np.meshgrid(np.arange(256.0), np.arange(256.0), indexing="ij")
        plane = np.stack([cr, cb], axis=-1).reshape(-1, 2) - 128.0
        full = np.linalg.norm(self.chroma, axis=1)
        along = plane @ (self.chroma / full[:, None]).T
        size = np.linalg.norm(plane, axis=1)
        best = np.argmax(along / np.maximum(size, 1e-9)[:, None], axis=1)
        picked = along[np.arange(len(best)), best]
        ok = (picked >= COSINE_MIN * size) & (picked >= self.floor * full[best])
        table = np.where(ok, best + 1, 0).astype(np.uint8)
        coverage = np.clip(along / full, 0.0, 1.0)
        return table, coverage

    def classify(self, image_bgr: ImageArray) -> tuple[ImageArray, IntArray]:
        """Class of each pixel (h, w) uint8 and its flat index into the (Cr, Cb) tables."""
        ycc = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YCrCb)
        flat = ycc[:, :, 1].astype(np.int64) * 256 + ycc[:, :, 2]
        return self._tables[0][flat], flat

    def coverage(self, flat: IntArray, colour: IntArray | int) -> FloatArray:
        """How much of a paint's full chroma pixels have, in [0, 1]."""
        return np.asarray(self._tables[1][flat, colour])


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
        Sum of coverage: the blob's area with partial pixels counted in part.
    labels : (h, w) int32
        1 + blob index of each pixel, 0 outside blobs.
    """

    colour: IntArray
    centroid_px: FloatArray
    area_px: IntArray
    weight: FloatArray
    labels: IntArray


def check_image(image: ImageArray, *, width_px: int, height_px: int) -> ImageArray:
    """Return an 8-bit colour image of the expected size.

    Raises
    ------
    InputError
        If it is not (height, width, 3) uint8.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"image must be 8-bit colour (h, w, 3); got shape {image.shape}, {image.dtype}"
        )
    if image.shape[:2] != (height_px, width_px):
        raise InputError(
            f"image is {image.shape[1]}x{image.shape[0]} px, the decoder was made for "
            f"{width_px}x{height_px}; use frames of that camera mode or rebuild the design with it"
        )
    return image


def segment(image_bgr: ImageArray, model: ColourModel, *, area_min_px: int = 3) -> Blobs:
    """Find every painted blob of at least ``area_min_px`` pixels (8-connected, per colour)."""
    classes, flat = model.classify(image_bgr)
    labels = np.zeros(classes.shape, dtype=np.int64)
    parts: list[tuple[IntArray, FloatArray, IntArray, FloatArray]] = []
    found = 0
    for colour in range(len(model.names)):
        mask = (classes == colour + 1).astype(np.uint8)
        count, own, stats, _ = cv2.connectedComponentsWithStats(mask, ltype=cv2.CV_32S)
        keep = stats[:, cv2.CC_STAT_AREA] >= area_min_px
        keep[0] = False
        renumber = np.zeros(count, dtype=np.int64)
        renumber[keep] = np.arange(1, int(keep.sum()) + 1)
        y, x = np.nonzero(mask)
        blob = renumber[own[y, x]]
        inside = blob > 0
        y, x, blob = y[inside], x[inside], blob[inside]
        size = int(keep.sum()) + 1
        weight = model.coverage(flat[y, x], colour).astype(np.float64)
        total = np.bincount(blob, weights=weight, minlength=size)[1:]
        cx = np.bincount(blob, weights=weight * x, minlength=size)[1:] / total
        cy = np.bincount(blob, weights=weight * y, minlength=size)[1:] / total
        labels[y, x] = blob + found
        found += size - 1
        parts.append(
            (
                np.full(size - 1, colour, dtype=np.int64),
                np.column_stack([cx, cy]),
                np.bincount(blob, minlength=size)[1:].astype(np.int64),
                np.asarray(total, dtype=np.float64),
            )
        )
    colours, centroids, areas, weights = (list(column) for column in zip(*parts, strict=True))
    return Blobs(
        colour=np.concatenate(colours),
        centroid_px=np.concatenate(centroids),
        area_px=np.concatenate(areas),
        weight=np.concatenate(weights),
        labels=labels,
    )
