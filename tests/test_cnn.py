"""The convolutional baseline on tiny pictures: its size and what it learns."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from benchmarks.cnn_baseline import (
    FRAME_PX,
    TrainedCnn,
    TrainingSettings,
    marker_forces,
    parameter_count,
    places_in_frame,
    read_frames,
    reduced,
    train_cnn,
)
from phytac_design.datasets.samples import FAILED
from phytac_shapes.arrays import BoolArray, FloatArray
from tests.decoder.drawn_samples import drawn

WIDTH, HEIGHT = 32, 24
REST_PX = np.array([[x, y] for y in (5.5, 11.5, 17.5) for x in (5.5, 15.5, 25.5)])
PLACES = places_in_frame(REST_PX, (WIDTH, HEIGHT))
COUNT, TRAIN = 100, 60
QUICK = TrainingSettings(epochs=30, patience=30, batch=10, rate=1e-3)


def pictures(seed: int) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Markers that move down by half a pixel a newton; one or two switches are on."""
    rng = np.random.default_rng(seed)
    on = np.zeros((COUNT, len(REST_PX)), dtype=np.bool_)
    for row in on:
        row[rng.choice(len(row), rng.integers(1, 3), replace=False)] = True
    force = np.where(on, rng.uniform(0.5, 5.0, on.shape), 0.0)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    centre = REST_PX + np.stack([np.zeros_like(force), 0.5 * force], axis=-1)
    gap = (x - centre[..., 0, None, None]) ** 2 + (y - centre[..., 1, None, None]) ** 2
    paint = np.exp(-gap / (2.0 * 1.5**2)).sum(axis=1)
    grey = 120.0 - 80.0 * paint + rng.normal(0.0, 0.5, paint.shape)
    return np.repeat(grey[..., None], 3, axis=3).astype(np.float32), on, force


def learn(seed: int = 0, **changes: Any) -> TrainedCnn:
    images, on, force = pictures(1)
    given: dict[str, Any] = {
        "images": images,
        "on": on,
        "force_N": force,
        "places": PLACES,
        "training": np.arange(TRAIN),
        "validation": np.arange(TRAIN, 75),
        "settings": QUICK,
    } | changes
    return train_cnn(given.pop("images"), given.pop("on"), given.pop("force_N"), seed=seed, **given)


@pytest.fixture(scope="module")
def trained() -> TrainedCnn:
    return learn()


def test_the_number_of_parameters_is_the_papers() -> None:
    convolutions = 448 + 3480 + 13888 + 36928 + 73856
    hidden = (301 + 1) * 656 + (656 + 1) * 656 + 657
    assert parameter_count() == convolutions + hidden == 758_361
    assert round(parameter_count() / 1e3, 1) == 758.4


@pytest.mark.long
def test_it_learns_forces_it_has_not_seen(trained: TrainedCnn) -> None:
    assert trained.parameters == parameter_count()
    images, on, force = pictures(2)
    found = trained.forces(images, on)
    guess = np.abs(force[on] - force[on].mean()).mean()
    assert np.abs(found - force)[on].mean() < 0.4 * guess
    assert not found[~on].any()
    assert found.min() >= 0.0
    assert trained.rmse_validation_N < 0.6 * force[on].std()
    # The same markers in a picture without load.
    assert trained.forces(np.repeat(trained.rest[None], COUNT, axis=0), on)[on].max() < 1.5


@pytest.mark.long
def test_the_rest_frame_is_found_among_pressed_ones(trained: TrainedCnn) -> None:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    gap = (x - REST_PX[:, 0, None, None]) ** 2 + (y - REST_PX[:, 1, None, None]) ** 2
    still = 120.0 - 80.0 * np.exp(-gap / 4.5).sum(axis=0)
    np.testing.assert_allclose(trained.rest[..., 0], still, atol=1.0)


@pytest.mark.long
def test_the_seed_decides(trained: TrainedCnn) -> None:
    few = {"settings": replace(QUICK, epochs=2)}
    state = torch.random.get_rng_state()
    first, again, other = learn(3, **few), learn(3, **few), learn(4, **few)
    assert torch.equal(torch.random.get_rng_state(), state)
    images, on, _ = pictures(2)
    np.testing.assert_array_equal(first.forces(images, on), again.forces(images, on))
    assert np.abs(first.forces(images, on) - other.forces(images, on)).max() > 1e-3


@pytest.mark.long
def test_it_stops_when_nothing_is_gained(monkeypatch: pytest.MonkeyPatch) -> None:
    _, on, force = pictures(1)
    # Forces that have nothing to do with the frames they come with.
    shuffled = np.where(on, np.random.default_rng(0).permuted(force + 1.0, axis=0), 0.0)
    rounds, shuffle = [], torch.randperm

    def counted(count: int) -> Any:
        rounds.append(count)
        return shuffle(count)

    monkeypatch.setattr(torch, "randperm", counted)
    stopped = learn(force_N=shuffled, settings=replace(QUICK, patience=3, epochs=60))
    assert len(rounds) == stopped.rounds + 3 < 60


@pytest.mark.long
def test_it_sees_around_a_marker(trained: TrainedCnn) -> None:
    at = 4
    on = np.zeros((2, 9), dtype=np.bool_)
    on[:, at] = True
    images = np.repeat(trained.rest[None], 2, axis=0)
    x, y = np.floor(REST_PX[at]).astype(int)
    # Not where the picture itself is read off.
    images[1, y + 3 : y + 5, x - 1 : x + 3] -= 60.0
    still, changed = trained.forces(images, on)[:, at]
    assert abs(changed - still) > 0.1


@pytest.mark.long
def test_no_force_pulls(trained: TrainedCnn) -> None:
    images, on, _ = pictures(2)
    bias = {"head.bias": trained.weights["head.bias"] - 100.0}
    pulling = replace(trained, weights=trained.weights | bias)
    np.testing.assert_array_equal(pulling.forces(images, on), 0.0)


@pytest.mark.long
def test_a_batch_of_any_size_gives_the_same(trained: TrainedCnn) -> None:
    images, on, _ = pictures(2)
    whole = trained.forces(images, on)
    np.testing.assert_allclose(trained.forces(images[:1], on[:1]), whole[:1], atol=1e-5)
    assert trained.forces(images[:2], np.zeros_like(on[:2])).tolist() == np.zeros((2, 9)).tolist()
    assert trained.forces(images[:0], on[:0]).shape == (0, 9)


def test_frames_are_read_and_reduced(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    (tmp_path / "frames").mkdir()
    frame = rng.integers(0, 256, (4 * FRAME_PX[1], 4 * FRAME_PX[0], 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "frames" / "000003.png"), frame)
    found = read_frames(tmp_path, np.array([3]))
    blocks = frame.reshape(FRAME_PX[1], 4, FRAME_PX[0], 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(found[0], blocks, atol=1e-3)
    np.testing.assert_array_equal(found[0], reduced(frame))


def test_places_are_pixels_centres() -> None:
    corners = places_in_frame(np.array([[-0.5, -0.5], [639.5, 479.5], [319.5, 239.5]]), (640, 480))
    assert corners.tolist() == [[-1.0, -1.0], [1.0, 1.0], [0.0, 0.0]]


def test_truth_is_spread_over_the_switches_that_are_on() -> None:
    samples = drawn(0)
    assert samples.truth is not None
    force = marker_forces(samples)
    assert force.shape == (samples.count, samples.markers)
    for sample, marker, own in zip(
        samples.truth.sample, samples.truth.marker, samples.truth.force_N, strict=True
    ):
        wanted = 0.0 if samples.status[sample] == FAILED else own
        assert force[sample, marker] == wanted
    assert np.count_nonzero(force) <= len(samples.truth.sample)
