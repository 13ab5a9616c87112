"""What the stages ``twin``, ``renders`` and ``frames`` hand on."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from phytac_design.engine.stage import Context
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.renders_stage import (
    draw_frame_contacts,
    rendered,
    rendered_example,
    write_frame,
)
from tests.designs import COARSE, tiny


def test_contacts_of_frames_are_solved_with_those_of_the_data() -> None:
    accuracy = replace(COARSE, frames=3)
    context, _, _ = run_stages(
        tiny(), select_stages(["twin"]), accuracy=accuracy, seed=5, progress=lambda _: None
    )
    alone = draw_frame_contacts(context).motion
    solved = context.arrays("twin")["frames.motion"]
    np.testing.assert_allclose(solved, alone, rtol=1e-6, atol=1e-9 * np.abs(alone).max())


def test_an_example_without_a_frame_of_its_own_is_its_sample(tmp_path: Path) -> None:
    context = Context(design=tiny(), accuracy=COARSE, seed=0, folders={"renders": tmp_path})
    sample, own = np.random.default_rng(0).integers(0, 256, (2, 40, 60, 3), dtype=np.uint8)
    write_frame(tmp_path, "3", 0, sample)
    (frame,) = rendered_example(context, 3)
    np.testing.assert_array_equal(frame, sample)
    write_frame(tmp_path, "example", 0, own)
    (frame,) = rendered_example(context, 3)
    np.testing.assert_array_equal(frame, own)
    write_frame(tmp_path, "3", 1, own)
    for frame, expected in zip(rendered(context, "3"), (sample, own), strict=True):
        np.testing.assert_array_equal(frame, expected)
