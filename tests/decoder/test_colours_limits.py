"""Paints of a rest frame from samples alone: specks, hues that are far off, and where to start."""

import numpy as np
import pytest

from phytac_decoder.pipeline.colour_calibration import SETTINGS, fit_colours
from phytac_shapes.arrays import FloatArray, IntArray
from tests.decoder.test_follow import MODEL
from tests.refusals import refused

MARKERS, SAMPLES = 20, 400
PAINT = np.arange(MARKERS) % 2


def turned(chroma: FloatArray, angle_deg: float) -> FloatArray:
    angle = np.radians(angle_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray(chroma @ turn)


def samples(painted: IntArray, *, turn_deg: float = 0.0, seed: int = 0) -> FloatArray:
    """Chroma (n, p, 2) around markers, each with so many samples of its paint, in noise."""
    rng = np.random.default_rng(seed)
    out = rng.normal(0.0, 1.0, (MARKERS, SAMPLES, 2))
    for marker, count in enumerate(painted.tolist()):
        paint = turned(MODEL.chroma[PAINT[marker]], turn_deg)
        out[marker, :count] += paint * rng.uniform(0.9, 1.0, count)[:, None]
    return out


def test_specks_are_no_markers() -> None:
    """A sample or two of the right hue, on most of the markers, is noise or dirt."""
    enough = np.full(MARKERS, 90)
    found = fit_colours(MODEL, samples(enough), PAINT)
    np.testing.assert_allclose(found.chroma[:2], 0.95 * MODEL.chroma[:2], rtol=0.06)
    specks = np.where(np.arange(MARKERS) < 12, 3, 90)
    with refused("markers-without-colour") as caught:
        fit_colours(MODEL, samples(specks), PAINT)
    caught.match("4 of 10")


@pytest.mark.parametrize("turn_deg", [-40.0, 40.0])
def test_hues_that_are_far_off_are_found(turn_deg: float) -> None:
    """One look about the expected hue sees part of the paint: the next looks from there."""
    spread = np.random.default_rng(3).normal(turn_deg, 18.0, MARKERS * 90).reshape(MARKERS, 90)
    chroma = samples(np.zeros(MARKERS, dtype=np.int64))
    for marker in range(MARKERS):
        for k in range(90):
            chroma[marker, k] = turned(MODEL.chroma[PAINT[marker]], spread[marker, k])
    found = fit_colours(MODEL, chroma, PAINT)
    for k in range(2):
        true = turned(MODEL.chroma[k], turn_deg)
        cosine = found.chroma[k] @ true / np.linalg.norm(found.chroma[k]) / np.linalg.norm(true)
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 3.0


def test_the_floor_starts_at_a_share_of_what_paint_shows() -> None:
    found = fit_colours(MODEL, samples(np.full(MARKERS, 90)), PAINT)
    assert found.floor == pytest.approx(MODEL.floor / SETTINGS.lit)
