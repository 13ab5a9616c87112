"""Separable paints: chromaticity against the standard, margins against drawn noise."""

import re

import cv2
import numpy as np
import pytest

from phytac_decoder.vision.brightness import DOTS
from phytac_decoder.vision.segmentation import ColourModel
from phytac_design.optics.paint import PAINTS, paints_of, to_linear, to_srgb
from phytac_design.optics.separability import (
    check_paints,
    chromaticity,
    separability,
    separability_svg,
)
from phytac_design.rules.check import check_design
from tests.designs import changed
from tests.refusals import refused

SHADE = 0.4


def test_chromaticity_of_the_srgb_primaries_and_white() -> None:
    """u'v' of IEC 61966-2-1's primaries: xy (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), D65."""
    xy = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.3127, 0.3290]])
    whole = -2.0 * xy[:, 0] + 12.0 * xy[:, 1] + 3.0
    expected = np.column_stack([4.0 * xy[:, 0], 9.0 * xy[:, 1]]) / whole[:, None]
    rgb = np.vstack([255.0 * np.eye(3), [255.0] * 3])
    assert chromaticity(rgb) == pytest.approx(expected, abs=3e-4)
    # Shade changes nothing.
    grey = to_srgb(SHADE * to_linear(rgb))
    assert chromaticity(grey) == pytest.approx(chromaticity(rgb), abs=1e-9)


def test_margins_predict_how_often_a_pixel_is_called_wrong() -> None:
    """Noise so strong that paints are confused: the share beyond the border is the normal tail."""
    names = ("green", "cyan")
    noise = 22.0
    found = separability(names, noise_pixel=noise)
    pair = [found.names[i] for i in found.pairs[0]]
    assert pair == ["green", "cyan"]
    rng = np.random.default_rng(1)
    shaded = to_srgb(SHADE * to_linear(np.array([PAINTS["green"]], dtype=float)))
    pixels = shaded + noise * rng.normal(size=(200_000, 3))
    ycc = cv2.cvtColor(pixels[None].astype(np.float32) / 255.0, cv2.COLOR_RGB2YCrCb)[0]
    chroma = (ycc[:, 1:] - 0.5) * 255.0
    model = ColourModel.from_rgb(paints_of(names))
    unit = model.chroma / np.linalg.norm(model.chroma, axis=1, keepdims=True)
    wrong = float((chroma @ unit[1] > chroma @ unit[0]).mean())
    # 22 levels put green's border at 1.4 to 1.6 standard deviations.
    green = np.linalg.norm(found.chroma[0]) * np.sin(np.radians(found.hue_deg[0] / 2.0))
    sigmas = green / found.chroma_noise
    tail = 0.5 * (1.0 - _erf(sigmas / np.sqrt(2.0)))
    # The margin is cautious: it takes the larger axis of the noise's ellipse.
    assert 0.4 * tail < wrong < 1.15 * tail
    assert found.hue_sigmas[0] <= sigmas + 1e-9


def _erf(x: float) -> float:
    t = np.linspace(0.0, x, 4001)
    return float(2.0 / np.sqrt(np.pi) * np.trapezoid(np.exp(-(t**2)), t))


def test_the_paints_in_the_table_are_far_apart() -> None:
    every = tuple(name for name in PAINTS if name not in {"red", *DOTS})
    found = separability(every, noise_pixel=2.0)
    assert found.names == (*every, "red")
    assert found.hue_sigmas.min() > 10.0
    assert found.uv_distance.min() > 0.09
    assert found.summary()["nearest_paints"] == "green and cyan"


@pytest.mark.parametrize("colours", [("blue", "green", "yellow"), ("yellow", "cyan")])
def test_paints_that_the_decoder_distinguishes_are_accepted(colours: tuple[str, ...]) -> None:
    check_paints(changed(layout={"colours": list(colours)}))


@pytest.mark.parametrize(
    ("colours", "pair"),
    [
        (("green", "cyan"), "green and cyan are 49.3 degrees"),
        (("blue", "cyan"), "blue and cyan are 42.0 degrees"),
        (("green", "magenta"), "magenta and red are 44.3 degrees"),
    ],
)
def test_hues_that_the_decoder_refuses_are_refused_by_the_design(
    colours: tuple[str, ...], pair: str
) -> None:
    """Or a printed sensor would fail at its first rest frame."""
    design = changed(layout={"colours": list(colours)})
    with refused("paints-not-separable") as caught:
        check_paints(design)
    caught.match(pair)


def test_noise_that_drowns_a_paint_is_refused() -> None:
    with refused("paints-not-separable") as caught:
        check_design(changed(camera={"noise_pixel": 9.0}))
    caught.match("camera.noise_pixel")
    with refused("paints-not-separable") as caught:
        check_paints(changed(layout={"colours": ["green", "cyan"]}, camera={"noise_pixel": 7.0}))
    caught.match("green and cyan")


def test_light_without_blue_brings_paints_together() -> None:
    """Under amber light blue and green reflect almost the same: the check must see it."""
    white = separability(("blue", "green"), noise_pixel=2.0)
    amber = separability(("blue", "green"), noise_pixel=2.0, light_rgb=np.array([1.0, 0.6, 0.02]))
    assert amber.hue_sigmas.min() < 0.6 * white.hue_sigmas.min()
    assert amber.uv_distance.min() < 0.5 * white.uv_distance.min()


def test_the_plot_names_and_colours_every_paint() -> None:
    svg = separability_svg(separability(("blue", "yellow"), noise_pixel=2.0))
    for name in ("blue", "yellow", "red"):
        assert svg.count(f">{name}<") == 2
        assert svg.count("#{:02x}{:02x}{:02x}".format(*PAINTS[name])) == 2
    assert svg.count("<line") == 3


def test_the_plot_has_paints_at_their_chromaticities() -> None:
    found = separability(("blue", "yellow"), noise_pixel=2.0)
    svg = separability_svg(found)
    left, top, size = 36.0, 36.0, 300.0
    circles = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)[: len(found.uv)]
    x, y = np.array(circles, dtype=np.float64).T
    uv = 0.63 / size * np.column_stack([x - left, top + size - y])
    np.testing.assert_allclose(uv, found.uv, atol=0.63 / size * 0.06)
