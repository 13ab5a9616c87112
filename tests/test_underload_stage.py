"""The stage that presses: where it presses, what it says, when it stops a build."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.layout.worst_places import press_places
from phytac_design.stages.loaded_views_stage import (
    PressedShell,
    load_sentence,
    load_verdict,
    place_in_words,
    run_underload,
    see_pressed,
)
from phytac_shapes.arrays import FloatArray
from tests.designs import FINE_CAMERA, small


def context_of(design: Design, accuracy: Accuracy = PRESETS["draft"], **more: Any) -> Context:
    return Context(design=design, accuracy=accuracy, seed=0, progress=lambda _: None, **more)


@pytest.fixture(scope="module")
def plain() -> Context:
    return context_of(small(layout={"rows": 4, "columns": 10}))


def turns_apart_mm(context: Context, uv: FloatArray) -> FloatArray:
    """Least distance (p, p) between places, turned by any number of columns."""
    lattice = context.markers.lattice
    assert lattice is not None
    at = context.surface.point(uv)
    least = np.full((len(uv), len(uv)), np.inf)
    for k in range(lattice.columns):
        turned = context.surface.point(uv + np.array([0.0, k * lattice.pitch_v]))
        least = np.minimum(least, np.linalg.norm(at[:, None] - turned[None], axis=2))
    return least


def test_a_sector_is_enough_where_the_sensor_repeats(plain: Context) -> None:
    surface, markers = plain.surface, plain.markers
    shell = PressedShell(plain)
    assert shell.repeats
    gap = np.ones(markers.count)
    gap[13] = 0.5
    few = press_places(surface, markers, gap, 6, repeats=True)
    apart = turns_apart_mm(plain, few)
    np.fill_diagonal(apart, np.inf)
    assert len(few) == 6
    assert apart.min() > 1.0
    assert np.linalg.norm(few - markers.uv[13], axis=1).min() == 0.0
    # All there is: four rows, in each a marker and a middle, and middles between the rows.
    every = press_places(surface, markers, gap, 1000, repeats=True)
    assert len(every) == 4 + 4 + 3
    plainly = press_places(surface, markers, gap, 1000)
    assert len(plainly) == 10 * len(every)
    # Turned, they are the same places.
    assert (
        turns_apart_mm(plain, np.concatenate([every, plainly]))[: len(every)].min(axis=0).max()
        < 1e-6
    )


def test_presses_of_one_sector_stand_for_all(plain: Context) -> None:
    """A press turned by a column moves the markers by the same motion, turned."""
    lattice = plain.markers.lattice
    assert lattice is not None
    shell = PressedShell(plain)
    uv = press_places(plain.surface, plain.markers, np.ones(plain.markers.count), 3, repeats=True)
    motion = shell.motions(uv, (1.0,))[0][:, 0, :, :3]
    turned = shell.motions(uv + np.array([0.0, lattice.pitch_v]), (1.0,))[0][:, 0, :, :3]
    size = np.linalg.norm(motion, axis=2).reshape(3, 4, 10)
    again = np.linalg.norm(turned, axis=2).reshape(3, 4, 10)
    assert np.roll(size, 1, axis=2) == pytest.approx(again, rel=1e-6, abs=1e-9)


def test_first_places_are_the_tightest_and_the_others_far_apart(plain: Context) -> None:
    surface, markers = plain.surface, plain.markers
    gap = np.arange(markers.count, 0.0, -1.0)
    uv = press_places(surface, markers, gap, 8)
    tight = {tuple(place) for place in markers.uv[-4:]}
    assert tight <= {tuple(place) for place in uv}
    assert np.ptp(surface.point(uv)[:, 2]) > 0.7 * 60.0
    assert len(press_places(surface, markers, gap, 1)) == 1


def soft() -> Design:
    """A wall so soft, and rows so near, that markers fuse when pressed."""
    layout = {"kind": "straight", "rows": 12, "columns": 8, "height_far_mm": 8.0}
    return small(layout=layout, material={"modulus_MPa": 400.0}, camera=FINE_CAMERA)


def test_large_displacement_only_where_something_happens() -> None:
    accuracy = replace(PRESETS["draft"], press_places=2, press_tolerance=0.05, receptors=False)
    context = context_of(soft(), accuracy)
    uv, found, facts = see_pressed(context, np.ones(context.markers.count))
    assert len(uv) == 2
    assert facts["not_solved"] == 0
    assert 0.5 < facts["dent_mm"] < 10.0
    events = np.isfinite(found.first_force_N)
    assert events.any()
    assert (found.first_force_N[events] < 25.0).all()
    assert (found.first_marker[events] >= 0).all()
    assert facts["theory"].endswith(f"of {2 + events.sum()} solves")


def test_the_stage_says_from_when_and_where(tmp_path: Path) -> None:
    accuracy = replace(PRESETS["draft"], press_places=3, receptors=False)
    context = context_of(soft(), accuracy)
    gap = np.ones(context.markers.count)
    uv, found, _ = see_pressed(context, gap)
    views, folder = tmp_path / "views", tmp_path / "underload"
    views.mkdir()
    folder.mkdir()
    camera = np.zeros(len(gap), dtype=np.int64)
    gaps = {"gap_same_colour_px": gap, "gap_other_colour_px": gap}
    np.savez(views / "arrays.npz", camera=camera, allow_pickle=False, **gaps)
    run_underload(context_of(soft(), accuracy, folders={"views": views}), folder)
    facts = json.loads((folder / "facts.json").read_text())
    worst = int(found.first_force_N.argmin())
    assert facts["first_force_N"] == found.first_force_N[worst] < 25.0
    assert facts["first_place_uv"] == uv[worst].tolist()
    assert facts["crosstalk_px"] == found.crosstalk_px.max()
    assert (
        f"from {facts['first_force_N']:.2g} N on, pressed {facts['first_place']}"
        in facts["sentence"]
    )
    with np.load(folder / "arrays.npz") as arrays:
        assert np.array_equal(arrays["first_force_N"], found.first_force_N)


def test_two_cameras_judge_what_is_read_through_each(plain: Context) -> None:
    """Near rows through the near camera, far rows through the far one: as each does alone."""
    markers, gap = plain.markers, np.ones(plain.markers.count)
    far = (markers.row >= 2).astype(np.int64)
    accuracy = replace(PRESETS["draft"], press_places=4)
    found, facts = {}, {}
    for ends, number in (("both", far), ("near", 0 * far), ("far", 0 * far)):
        design = small(layout={"rows": 4, "columns": 10}, camera={"ends": ends})
        _, found[ends], facts[ends] = see_pressed(context_of(design, accuracy), gap, number)
    for name in ("least_gap_same_px", "least_gap_other_px", "least_fraction", "crosstalk_px"):
        alone = np.where(far, getattr(found["far"], name), getattr(found["near"], name))
        assert np.array_equal(getattr(found["both"], name), alone)
        assert not np.array_equal(alone, getattr(found["near"], name)) or "gap" not in name
    assert found["both"].press_gap_same_px.min() == found["both"].least_gap_same_px.min()
    # What each camera loses is said apart, of the markers that are read through it.
    assert "cameras" not in facts["near"]
    for end, own, each in zip(
        ("near", "far"), (far == 0, far == 1), facts["both"]["cameras"], strict=True
    ):
        assert (each["end"], each["read"]) == (end, 20)
        alone = found[end]
        assert each["least_gap_same_colour_px"] == alone.least_gap_same_px[own].min()
        assert each["least_visible_fraction"] == alone.least_fraction[own].min()
        assert each["crosstalk_px"] == alone.crosstalk_px[own].max()


def test_a_camera_that_reads_nothing_loses_nothing(plain: Context) -> None:
    design = small(layout={"rows": 4, "columns": 10}, camera={"ends": "both"})
    accuracy = replace(PRESETS["draft"], press_places=1)
    gap, near = np.ones(plain.markers.count), np.zeros(plain.markers.count, dtype=np.int64)
    facts = see_pressed(context_of(design, accuracy), gap, near)[2]
    assert facts["cameras"][1] == {"end": "far", "read": 0}
    assert facts["cameras"][0]["read"] == 40


def test_place_in_words(plain: Context) -> None:
    markers = plain.markers
    assert place_in_words(plain, markers.uv[13]) == "on marker (row 1, column 3)"
    beside = place_in_words(plain, markers.uv[13] + [1.2, 0.0])
    assert beside == "1.2 mm beside marker (row 1, column 3)"


FACTS: dict[str, Any] = {
    "force_N": 25.0,
    "patch_radius_mm": 7.0,
    "presses": 12,
    "crosstalk_px": 0.03,
    "crosstalk_marker": "(row 2, column 1)",
    "crosstalk_still_px": 0.01,
    "hidden_most": 0,
    "fused_most": 4,
    "first_force_N": None,
    "first_place": "on marker (row 3, column 4)",
    "first_marker": "(row 4, column 4)",
}


def test_sentence_and_gate(tmp_path: Path) -> None:
    assert "no marker hides or fuses; the centroid" in load_sentence(FACTS)
    facts = FACTS | {"first_force_N": 12.34}
    assert (
        "from 12 N on, pressed on marker (row 3, column 4), marker (row 4, column 4) hides or fuses"
        in load_sentence(facts)
    )
    (tmp_path / "facts.json").write_text(json.dumps(facts))
    for demand, stops in ((12.0, False), (12.5, True)):
        design = small(demands={"clear_force_N": demand})
        verdict = load_verdict(context_of(design, folders={"underload": tmp_path}))
        assert bool(verdict) == stops
        assert not stops or "(pressed on marker (row 3, column 4))" in verdict
