"""Cramér-Rao bounds against closed forms and against an estimator that attains them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.camera.camera_motion import CameraMotion
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context, write_arrays
from phytac_design.layout.cameras import cameras_of
from phytac_design.simulation.cramer_rao import (
    CramerRaoBound,
    PositionPrior,
    cell_prior,
    contact_signals,
)
from phytac_design.simulation.linear_response import rigid_slope
from phytac_design.stages import resolution_stage
from phytac_design.stages.resolution_stage import camera_motions
from phytac_shapes import Cylinder, Hemisphere, Plane, Surface
from phytac_shapes.arrays import FloatArray, IntArray
from tests.designs import FINE_CAMERA, small
from tests.refusals import refused

PAD = Plane(width_mm=60.0, height_mm=60.0)
GRID = np.stack(np.meshgrid(*2 * [np.linspace(-24.0, 24.0, 7)]), axis=-1).reshape(-1, 2)
FREE = PositionPrior(place_mm=1e6, radius_mm=1e6)
TIGHT = PositionPrior(place_mm=1e-6, radius_mm=1e-6)


def dents(uv: FloatArray, radius: FloatArray) -> FloatArray:
    """Pixel shifts of a made-up sheet: Gaussian dents, wider for wider patches."""
    gap = uv[:, None] - GRID[None]
    width = 6.0 + 0.5 * radius
    depth = 3.0 * np.exp(-0.5 * (gap**2).sum(axis=2) / width[:, None] ** 2)
    return np.stack([depth, 0.3 * depth], axis=2)


def bound(
    prior: PositionPrior, *, noise: float = 0.05, force: float = 5.0, surface: Surface = PAD
) -> CramerRaoBound:
    signals = contact_signals(
        surface, dents, uv=np.array([[1.0, 2.0], [10.0, -7.0]]), radius_mm=np.array([5.0, 4.0])
    )
    return signals.bound(force, noise_px=noise, prior=prior)


def test_known_position_is_one_over_the_signal() -> None:
    c = dents(np.array([[1.0, 2.0], [10.0, -7.0]]), np.array([5.0, 4.0])).reshape(2, -1)
    want = 0.05 / np.linalg.norm(c, axis=1)
    found = bound(FREE)
    assert np.allclose(found.force_known_N, want, rtol=1e-12)
    # A prior that leaves nothing open gives the same.
    assert np.allclose(bound(TIGHT).force_N, want, rtol=1e-6)


def test_unknown_position_and_size_cost() -> None:
    found = bound(FREE)
    assert (found.force_N > 1.02 * found.force_known_N).all()
    between = bound(PositionPrior(place_mm=0.02, radius_mm=0.05))
    assert (between.force_N < found.force_N).all()
    assert (between.force_N > found.force_known_N).all()


def test_scaling_laws() -> None:
    one, double = bound(FREE), bound(FREE, noise=0.1)
    assert np.allclose(double.force_N, 2.0 * one.force_N, rtol=1e-6)
    strong = bound(FREE, force=50.0)
    # Force is read as well at any force; position ten times better at ten times the force.
    assert np.allclose(strong.force_N, one.force_N, rtol=1e-6)
    assert np.allclose(strong.along_mm, one.along_mm / 10.0, rtol=1e-5)
    assert np.allclose(strong.around_mm, one.around_mm / 10.0, rtol=1e-5)


def test_the_best_estimator_attains_it() -> None:
    rng = np.random.default_rng(3)
    at, radius, force, noise = np.array([[1.0, 2.0]]), 5.0, 5.0, 0.01
    prior = PositionPrior(place_mm=1.0, radius_mm=1.0)
    signals = contact_signals(PAD, dents, uv=at, radius_mm=radius)
    found = signals.bound(force, noise_px=noise, prior=prior)
    weight = np.array([0.0, 1.0, 1.0, 1.0])
    errors = []
    for _ in range(400):
        true = np.array([force, *(at[0] + rng.normal(0, 1.0, 2)), radius + rng.normal(0, 1.0)])
        signal = true[0] * dents(true[None, 1:3], true[3:]).ravel()
        data = signal + rng.normal(0.0, noise, signal.shape)
        theta = np.array([force, *at[0], radius])
        start = theta.copy()
        for _ in range(12):
            h = 1e-4
            base = theta[0] * dents(theta[None, 1:3], theta[3:]).ravel()
            G = np.column_stack(
                [
                    (t[0] * dents(t[None, 1:3], t[3:]).ravel() - base) / h
                    for t in (theta + h * np.eye(4)[k] for k in range(4))
                ]
            )
            left = G.T @ G / noise**2 + np.diag(weight)
            right = G.T @ (data - base) / noise**2 - weight * (theta - start)
            theta = theta + np.linalg.solve(left, right)
        errors.append(theta[0] - true[0])
    assert np.std(errors) == pytest.approx(found.force_N[0], rel=0.12)


def test_works_at_a_pole_on_a_seam_and_at_an_edge() -> None:
    dome, tube = (
        Hemisphere(diameter_outer_mm=40.0),
        Cylinder(diameter_outer_mm=40.0, length_mm=50.0),
    )
    for surface, uv in (
        (dome, [[dome.domain[0, 1], 0.0], [0.0, 1.0]]),
        (tube, [[20.0, 0.0], [50.0, 2.0]]),
    ):
        markers = surface.point(
            np.column_stack(
                [
                    np.linspace(*surface.domain[0].tolist(), 40),
                    np.linspace(0.0, 30.0, 40) % 6.28,
                ]
            )
        )

        def near(
            where: FloatArray,
            radius: FloatArray,
            s: Surface = surface,
            m: FloatArray = markers,
        ) -> FloatArray:
            gap = s.point(where)[:, None] - m[None]
            depth = np.exp(-0.5 * (gap**2).sum(axis=2) / (5.0 + radius[:, None]) ** 2)
            return np.stack([depth, 0.5 * depth + 0.1 * gap[..., 0] * depth], axis=2)

        signals = contact_signals(surface, near, uv=np.array(uv), radius_mm=4.0)
        prior = cell_prior(surface.area_mm2(), 40, 4.0, 7.0)
        found = signals.bound(5.0, noise_px=0.04, prior=prior)
        for values in vars(found).values():
            assert np.isfinite(values).all()
            assert (values > 0.0).all()


def test_cell_prior() -> None:
    prior = cell_prior(400.0 * np.pi, 4, 4.0, 7.0)
    assert prior.place_mm == pytest.approx(5.0)
    assert prior.radius_mm == pytest.approx(3.0 / np.sqrt(12.0))


@pytest.mark.parametrize("bad", [{"noise": 0.0}, {"noise": -1.0}, {"force": 0.0}])
def test_invalid_input_is_rejected(bad: dict[str, float]) -> None:
    with refused("bound-input-not-positive"):
        bound(FREE, **bad)


def test_motion_of_the_camera_costs_as_eliminating_its_unknowns_does() -> None:
    places, radius = np.array([[1.0, 2.0], [10.0, -7.0]]), np.array([5.0, 4.0])
    signals = contact_signals(PAD, dents, uv=places, radius_mm=radius)
    rng, q, noise, force = np.random.default_rng(0), 3, 0.05, 5.0
    first, sd = rng.normal(size=(q, signals.shift.shape[1])), np.array([0.01, 0.2, 5.0])
    motion = CameraMotion(
        first=first,
        second=np.zeros((0, first.shape[1]), dtype=np.float32),
        pair=np.zeros((2, 0), dtype=np.int64),
        sd=sd,
    )
    prior = PositionPrior(place_mm=2.0, radius_mm=1.0)
    found = signals.bound(force, noise_px=noise, prior=prior, motion=motion)
    still = signals.bound(force, noise_px=noise, prior=prior)
    assert (found.force_N > 1.01 * still.force_N).all()
    for k in range(2):
        slopes = np.column_stack([signals.shift[k], force * signals.slopes[k], first.T])
        known = np.diag([0.0, 0.25, 0.25, 1.0, *sd**-2.0])
        full = np.linalg.inv(slopes.T @ slopes / noise**2 + known)
        assert found.force_N[k] == pytest.approx(np.sqrt(full[0, 0]), rel=1e-9)
        assert found.along_mm[k] == pytest.approx(np.sqrt(full[1, 1]), rel=1e-9)
    # A camera that is known to stand still, as by marks, costs nothing.
    sure = signals.bound(
        force, noise_px=noise, prior=prior, motion=replace(motion, precision=1e12 * np.eye(q))
    )
    assert np.allclose(sure.force_N, still.force_N, rtol=1e-4)


def test_marks_tell_more_of_the_camera_than_any_mount() -> None:
    context = Context(
        design=small(reference_marks={"count": 12}), accuracy=PRESETS["draft"], seed=0
    )
    seen_by = np.ones((1, context.markers.count), dtype=np.bool_)
    seen_by[0, 5] = False
    found = camera_motions(context, {"seen_by": seen_by})
    assert set(found) == {"rigid", "bench", "handheld", "marks"}
    assert not found["bench"].first[:, 10:12].any()
    assert found["bench"].first[:, :10].any(axis=1).all()
    spread = {
        name: np.sqrt(np.diagonal(np.linalg.inv(motion.prior))) for name, motion in found.items()
    }
    # Across and about the axis: one rim shows little of distance and focal length.
    across = [0, 1, 3, 4, 5]
    assert (spread["marks"][across] < 0.5 * spread["rigid"][across]).all()
    assert (spread["rigid"] < spread["bench"]).all()
    assert (spread["bench"] < spread["handheld"]).all()
    plain = Context(design=small(), accuracy=PRESETS["draft"], seed=0)
    assert "marks" not in camera_motions(plain, {"seen_by": seen_by})


@pytest.mark.parametrize(
    ("case", "sectors"),
    [
        ("one camera", 14),
        ("cameras at both ends", 14),
        ("camera beside the axis", 1),
        ("a row that both cameras read", 1),
        ("a hidden marker", 1),
        ("reference marks", 1),
    ],
)
def test_receptors_of_one_sector_stand_for_all(
    case: str, sectors: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where all that cameras see turns onto itself; each is solved for itself otherwise."""
    both = "both" in case
    more: dict[str, Any] = {"camera": FINE_CAMERA | {"ends": "both"}} if both else {}
    if case == "reference marks":
        more = {"reference_marks": {"count": 6}}
    design = small(**more)
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    markers, cameras = context.markers, cameras_of(design, context.surface)
    if case == "camera beside the axis":
        aside = np.add(cameras[0].position_mm, [0.5, 0.0, 0.0])
        cameras = (replace(cameras[0], position_mm=aside),)
    tip, mid = markers.tip_mm, markers.mid_mm
    slopes = np.stack([rigid_slope(camera.jacobian(tip), tip - mid) for camera in cameras])
    seen_by = np.ones((len(cameras), markers.count), dtype=np.bool_)
    seen_by[0, 5] = case != "a hidden marker"
    reader = (np.arange(markers.count) >= markers.count // 2) * (len(cameras) - 1)
    if case == "a row that both cameras read":
        reader[markers.count // 2] = 0
    views = tmp_path / "views"
    views.mkdir()
    write_arrays(views, {"paint_slopes": slopes, "seen_by": seen_by, "camera": reader})
    context.folders["views"] = views
    solved, plain, made = [], resolution_stage._alike, []

    def noted(*args: Any) -> IntArray:
        found = plain(*args)
        solved.append(len(np.unique(found)))
        return found

    for alike in (noted, lambda *_: np.arange(markers.count)):
        monkeypatch.setattr(resolution_stage, "_alike", alike)
        folder = tmp_path / f"bound_{len(made)}"
        folder.mkdir()
        resolution_stage.run_resolution(context, folder)
        context.folders["resolution"] = folder
        made.append((context.arrays("resolution"), context.facts("resolution")))
    assert solved == [markers.count // sectors]
    (some, facts), (each, wanted) = made
    assert len(some) >= 16
    for name, value in each.items():
        np.testing.assert_allclose(some[name], value, rtol=1e-6)
    away = np.linalg.norm(tip - cameras[0].position_mm, axis=1)
    if case == "one camera":  # which sees more of what is near
        assert some["force_N_10"][away.argmin()] < 0.8 * some["force_N_10"][away.argmax()]
    for part in ("bound", "bound_as_read", "camera_motion"):
        assert _numbers(facts.get(part)) == pytest.approx(_numbers(wanted.get(part)), rel=1e-6)


def _numbers(facts: Any) -> list[float]:
    """All numbers in nested facts, in order."""
    if isinstance(facts, dict):
        return [value for each in facts.values() for value in _numbers(each)]
    return [facts] if isinstance(facts, int | float) else []
