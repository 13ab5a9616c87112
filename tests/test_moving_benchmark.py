"""The benchmark of a hand at 480 fps: its forces, and its rows."""

import json

import numpy as np
import pytest

from benchmarks.decoder_moving import FPS, FRAMES, HIT_S, add_film, forces, job
from benchmarks.harness import Table
from phytac_decoder.io.bundle import load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import measure_frame
from phytac_design.stages.build import BuildResult
from tests.designs import small


def test_the_hand_grips_and_is_hit() -> None:
    force = forces()
    assert force.shape == (FRAMES, 5)
    assert force.min() > 0.0
    assert force.max() < 25.0
    hit = round(HIT_S * FPS)
    assert force[:hit].sum(axis=1).argmax() >= hit - 25
    assert hit <= force.sum(axis=1).argmax() <= hit + 3
    assert job(small(), quick=True).scenario.touch.samples == 8


@pytest.mark.long
def test_rows_of_a_film(built: BuildResult) -> None:
    bundle = load_bundle(built.out / "decoder")
    views = built.out / "views"
    rest, pressed = (
        measure_frame(bundle, read_image(views / f"frame_{name}.png"))
        for name in ("rest", "pressed")
    )
    total = sum(json.loads((views / "frame_pressed.json").read_text()).values())
    table = Table("x")
    add_film(table, "small", bundle, [rest, *[pressed] * 5], np.array([0.0, *[total] * 5]))
    rows = {row["case"]: row for row in table.rows}
    assert len(rows) == 11
    apart = rows["small: auto, warm-started against by itself: force difference, p99"]
    # The same frame again: as far as a fit goes.
    assert 0.0 <= apart["value"] < 0.3
    assert "; 4 frames were warm-started" in apart["note"]
    assert rows["small: koi_inverse: a frame, p50"]["value"] > 0.0
    error = rows["small: auto, each frame by itself: error of the sum of forces"]
    assert error["value"] == pytest.approx(
        rows["small: auto, warm-started from the frame before: error of the sum of forces"][
            "value"
        ],
        rel=0.1,  # a tenth of its standard deviation
    )
    assert error["value"] < 0.3 * total
