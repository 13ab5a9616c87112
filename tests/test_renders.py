"""What the stages ``twin``, ``renders`` and ``frames`` hand on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phytac_design.engine.stage import Context
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import motion_responses
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.renders_stage import (
    draw_frame_contacts,
    press_frames,
    rendered,
    rendered_example,
    write_frame,
)
from phytac_design.stages.response_stage import truth_responses, truth_solver
from tests.designs import COARSE, tiny


def test_contacts_of_frames_are_solved_with_those_of_the_data() -> None:
    accuracy = replace(COARSE, frames=3)
    context, _, _ = run_stages(
        tiny(), select_stages(["twin"]), accuracy=accuracy, seed=5, progress=lambda _: None
    )
    alone = draw_frame_contacts(context).motion
    solved = context.arrays("twin")["frames.motion"]
    np.testing.assert_allclose(solved, alone, rtol=1e-6, atol=1e-9 * np.abs(alone).max())


def test_data_are_extrapolated_from_two_meshes() -> None:
    design = tiny()

    def of(refine: int) -> tuple[int, np.ndarray]:
        accuracy = replace(COARSE, truth_refine=refine)
        context = Context(design=design, accuracy=accuracy, seed=0, progress=lambda _: None)
        uv = context.surface.domain.mean(axis=1)[None]
        return truth_responses(context, uv, np.array([4.0]))

    def plain(refine: int) -> tuple[int, np.ndarray]:
        context = Context(design=design, accuracy=COARSE, seed=0, progress=lambda _: None)
        mesh, model = truth_shell(design, context.surface, refine)
        uv = context.surface.domain.mean(axis=1)[None]
        motion = motion_responses(
            model, mesh, context.surface, context.markers, uv=uv, radius_mm=np.array([4.0])
        )
        return len(mesh.nodes_mm), motion

    (many, fine), (few, coarse) = plain(6), plain(4)
    nodes, found = of(6)
    assert nodes == many + few
    # Beyond the finer mesh, by what theory has: the error falls with the elements' squared size.
    step = fine - coarse
    share = float(np.vdot(found - fine, step) / np.vdot(step, step))
    np.testing.assert_allclose(found, fine + share * step, atol=1e-9 * np.abs(found).max())
    assert share == pytest.approx(1.0 / ((6 / 4) ** 2 - 1.0), rel=0.1)
    # Too coarse to be extrapolated from.
    assert of(4)[0] == few
    np.testing.assert_array_equal(of(4)[1], coarse)


def test_the_example_is_pressed_by_large_displacements() -> None:
    accuracy = replace(COARSE, frames=3, place_orders=2)
    context, _, _ = run_stages(
        tiny(), select_stages(["twin"]), accuracy=accuracy, seed=5, progress=lambda _: None
    )
    pressed = press_frames(context, context.arrays("twin")["frames.motion"])
    example = pressed.contacts.of(pressed.switching.example)
    found = truth_solver(context).solve(example, example.force_N)
    assert found.theory == "large"
    assert pressed.shown is not None
    np.testing.assert_array_equal(pressed.shown, found.motion)


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
