"""Frames between the stages ``renders`` and ``frames``."""

from pathlib import Path

import numpy as np

from phytac_design.engine.stage import Context
from phytac_design.stages.renders_stage import rendered_example
from phytac_design.stages.views_stage import write_image
from tests.designs import COARSE, tiny


def test_an_example_without_a_frame_of_its_own_is_its_sample(tmp_path: Path) -> None:
    context = Context(design=tiny(), accuracy=COARSE, seed=0, folders={"renders": tmp_path})
    sample, own = np.full((4, 6, 3), 10, np.uint8), np.full((4, 6, 3), 20, np.uint8)
    write_image(tmp_path / "3_0.png", sample)
    (frame,) = rendered_example(context, 3)
    np.testing.assert_array_equal(frame, sample)
    write_image(tmp_path / "example_0.png", own)
    (frame,) = rendered_example(context, 3)
    np.testing.assert_array_equal(frame, own)
