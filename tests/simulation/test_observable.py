"""Motions that a camera along the wall's normal cannot observe, and their warning."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.cascade_network import CascadeNetwork, parameter_count
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.pipeline import decode
from phytac_decoder.pipeline.decode import FrameMeasurement, confirmed_switches
from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.simulation.condense import Condensed, condense
from phytac_design.stages.decoder_stage import limit_facts
from tests.decoder.test_forces import N, force_model, make_bundle
from tests.refusals import refused

CAMERA = Camera.on_axis(width_px=2000, height_px=2000, focal_px=900.0, stand_off_mm=30.0)


def dome(ring: int = 6) -> Condensed:
    """A marker on the axis, which the camera looks straight at, and a ring around it."""
    angle = 2.0 * np.pi * np.arange(ring) / ring
    lean = 0.6
    around = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(ring)])
    axis = np.array([0.0, 0.0, 1.0])
    normal = np.vstack([axis, np.sin(lean) * around + np.cos(lean) * axis])
    watched = 12.0 * normal
    gap = np.linalg.norm(watched[:, None] - watched[None], axis=2)
    # A dent that falls off around the load, and tips that lean towards it.
    dent = 0.02 * np.exp(-((gap / 8.0) ** 2))
    towards = watched[None] - watched[:, None]
    motion = -dent[:, None] * normal[:, :, None] + 0.05 * dent[:, None] * np.moveaxis(towards, 2, 1)
    return condense(CAMERA.jacobian(watched), normal=normal, motion=motion)


def model_of(parts: Condensed) -> ForceModel:
    count = len(parts.stiffness)
    return ForceModel(
        shift_to_mm=parts.shift_to_mm,
        stiffness=parts.stiffness,
        compliance_px=parts.compliance_px,
        height_z_mm=np.zeros(count),
        neighbours=np.full((count, 8), -1),
        networks={},
    )


def test_a_marker_on_the_pole_leaves_the_others_their_stiffness() -> None:
    parts = dome()
    assert parts.sensitivity_px_mm[0] < 1e-9
    assert (parts.sensitivity_px_mm[1:] > 5.0).all()
    assert (parts.shift_to_mm[0] == 0.0).all()
    assert (parts.stiffness[0] == 0.0).all()
    assert (parts.stiffness[:, 0] == 0.0).all()
    model = model_of(parts)
    force = np.array([0.0, 3.0, 0.0, 0.0, 5.0, 0.0, 0.0])
    shift = (model.compliance_px @ force).reshape(-1, 2)
    assert np.allclose(model.forces("fem", shift, np.array([1, 4])), force)
    # What u cannot show, the neighbours do: the inverse reads the pole itself.
    force = np.array([7.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    shift = (model.compliance_px @ force).reshape(-1, 2)
    assert np.allclose(model.forces("koi_inverse", shift, np.array([0, 2])), force)
    assert model.forces("fem", shift, np.array([0, 2]))[0] == 0.0
    assert np.isinf(model.stiffness_noise_N_px[0])
    assert np.isfinite(model.stiffness_noise_N_px[1:]).all()


def test_a_lone_marker_on_the_axis_is_rejected() -> None:
    camera = Camera.on_axis(width_px=100, height_px=100, focal_px=50, stand_off_mm=10)
    slope = camera.jacobian(np.array([[0.0, 0.0, 5.0]]))
    normal = np.array([[0.0, 0.0, 1.0]])
    motion = np.array([[[0.0], [0.0], [-0.01]]])
    with refused("marker-force-unobservable"):
        condense(slope, normal=normal, motion=motion)
    # And one that the lens does not see, by name.
    with refused("marker-not-seen"):
        condense(slope, normal=normal, motion=np.full((1, 3, 1), np.nan))


def test_noise_of_the_stiffness_is_what_a_thousand_frames_give() -> None:
    model = force_model()
    rng = np.random.default_rng(1)
    noise = 0.05
    frames = rng.normal(0.0, noise, (4000, N, 2))
    found = np.array([model.forces("fem", frame, np.arange(N)) for frame in frames])
    # The spread of 4000 draws is known to 1 %; four times that.
    assert np.allclose(found.std(axis=0), noise * model.stiffness_noise_N_px, rtol=0.045)
    # Of one force that is on: far enough above zero for the inverse to be linear, and weak enough
    # for all markers to count alike.
    push = 0.4 * model.compliance_px[:, 4].reshape(N, 2)
    inverse = [model.forces("koi_inverse", push + frame, np.array([4]))[4] for frame in frames]
    assert np.std(inverse) == pytest.approx(noise * model.inverse_noise_N_px[4], rel=0.045)


def weakened(bundle: Bundle, marker: int) -> Bundle:
    """The same sensor, but one marker's image hardly moves when it is pressed."""
    faint = bundle.model.shift_to_mm.copy()
    faint[marker] *= 1e3
    return replace(bundle, model=replace(bundle.model, shift_to_mm=faint))


def sound() -> Bundle:
    tips = TipModel(
        on_px=40.0 * np.arange(2 * N, dtype=float).reshape(N, 2),
        red_rest_px=np.full(N, 10.0),
        red_on_px=np.full(N, 60.0),
    )
    return replace(make_bundle(), tips=tips, noise_centroid_px=0.02)


def blind(bundle: Bundle, marker: int) -> Bundle:
    red = bundle.tips.red_rest_px.copy()
    red[marker] = 55.0
    return replace(bundle, tips=replace(bundle.tips, red_rest_px=red))


def test_a_sound_sensor_has_no_limits() -> None:
    bundle = sound()
    assert bundle.limits() == []
    assert limit_facts(bundle)["fem_unusable_count"] == 0


def test_hidden_tips_differ_from_tips_that_look_alike() -> None:
    bundle = sound()
    on, rest = bundle.tips.red_on_px.copy(), bundle.tips.red_rest_px.copy()
    on[2] = 0.0
    on[5] = rest[5] = 50.0
    tips = replace(bundle.tips, red_on_px=on, red_rest_px=rest)
    hidden, alike = replace(bundle, tips=tips).limits()
    assert "1 of 12 switches cannot be seen even when on (2)" in hidden
    assert "1 of 12 switches cannot be read well (5)" in alike


def test_limits_name_markers_and_switches() -> None:
    # Noise of one marker's u is in every force that its stiffness reaches.
    bundle = blind(weakened(sound(), 3), 8)
    noise = bundle.noise_centroid_px * bundle.model.stiffness_noise_N_px
    useless = np.flatnonzero(noise > 5.0)
    assert 3 in useless
    assert np.flatnonzero(~bundle.stiffness_usable).tolist() == useless.tolist()
    switches, markers = bundle.limits()
    assert "1 of 12 switches cannot be read well (8)" in switches
    assert f"cannot be used at {len(useless)} of 12 markers" in markers
    # `auto` does not need K·u.
    assert bundle.limits("fem") == bundle.limits()
    assert bundle.limits("auto") == [switches]
    facts = limit_facts(bundle)
    assert facts["switches_unreadable"] == [8]
    assert facts["fem_unusable"] == useless.tolist()
    assert facts["not_observable"] == []
    json.dumps(facts)


def test_limits_name_forces_that_nothing_can_read() -> None:
    bundle = sound()
    faint = bundle.model.compliance_px.copy()
    faint[:, 7] *= 1e-3
    weak = replace(bundle, model=replace(bundle.model, compliance_px=faint))
    assert np.flatnonzero(~weak.force_readable).tolist() == [7]
    (text,) = weak.limits()
    assert "1 of 12 markers cannot be read by any estimator (7)" in text
    assert limit_facts(weak)["force_unreadable"] == [7]


def test_limits_survive_the_bundle_and_old_bundles_have_defaults(tmp_path: Path) -> None:
    bundle = replace(sound(), noise_centroid_px=0.3, force_max_N=7.0)
    save_bundle(bundle, tmp_path)
    back = load_bundle(tmp_path)
    assert (back.noise_centroid_px, back.force_max_N) == (0.3, 7.0)
    path = tmp_path / "bundle.json"
    old = json.loads(path.read_text())
    del old["noise_centroid_px"], old["force_max_N"]
    path.write_text(json.dumps(old | {"schema_version": "1.1"}))
    assert load_bundle(tmp_path).force_max_N == 25.0


def test_an_uncertain_switch_is_on_only_where_markers_moved() -> None:
    bundle = blind(blind(sound(), 5), 9)
    assert np.flatnonzero(~bundle.tips.readable).tolist() == [5, 9]
    seems_on = np.isin(np.arange(N), [2, 5, 9])
    shift = pressed(bundle, {2: 4.0, 5: 3.0}, []).shift_px
    assert np.flatnonzero(confirmed_switches(bundle, seems_on, shift)).tolist() == [2, 5]
    # A switch that can be read is believed, whatever moved.
    still = np.zeros((N, 2))
    assert np.flatnonzero(confirmed_switches(bundle, seems_on, still)).tolist() == [2]


def pressed(bundle: Bundle, forces: dict[int, float], koi: list[int]) -> FrameMeasurement:
    force = np.zeros(N)
    force[list(forces)] = list(forces.values())
    shift = (bundle.model.compliance_px @ force).reshape(N, 2)
    return FrameMeasurement(
        koi=np.array(koi, dtype=np.int64), shift_px=shift, found=np.ones(N, dtype=bool)
    )


def test_frames_warn_of_what_is_missing() -> None:
    bundle = blind(sound(), 8)

    def warned(measured: FrameMeasurement, **more: str) -> list[str]:
        forces = measured.forces_N(bundle, "koi_inverse")
        texts = measured.warnings(bundle, forces, **more)
        return [text for text in texts if "camera has moved" not in text]

    assert warned(pressed(bundle, {}, [])) == []
    assert warned(pressed(bundle, {4: 9.0}, [4])) == []
    (text,) = warned(pressed(bundle, {4: 9.0, 8: 6.0}, [4]))
    assert "1 markers (8) moved as if pressed" in text
    # A light touch stays below what model error explains.
    assert warned(pressed(bundle, {4: 9.0, 8: 0.2}, [4])) == []


def test_frames_warn_of_red_that_no_switch_shows() -> None:
    bundle = sound()
    # One that reads as on, the same and one more, and one that reads as off.
    for tips, warned in (([4], False), ([4, 5], True), ([5], True)):
        measured = replace(pressed(bundle, {4: 9.0}, [4]), half_out=np.array(tips))
        texts = measured.warnings(bundle, measured.forces_N(bundle, "koi_inverse"))
        assert any("more red than at rest" in text for text in texts) == warned


def test_frames_warn_where_contacts_without_switches_may_be_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bundle = sound()
    measured = pressed(bundle, {}, [])
    for owner, name in (
        (decode, "_contact_warnings"),
        (FrameMeasurement, "moved_cameras"),
        (FrameMeasurement, "_motion_faults"),
        (FrameMeasurement, "_too_many_switches"),
    ):
        monkeypatch.setattr(owner, name, lambda *_: [])
    for without, count, warned in ((True, 3, 0), (True, 4, 1), (False, 4, 0)):
        monkeypatch.setattr(type(bundle.model), "without_switches", without)
        found: Any = SimpleNamespace(contacts=[None] * count)
        texts = measured.warnings(bundle, np.zeros(len(measured.found)), found=found)
        assert sum("there may be more" in text for text in texts) == warned


def test_frames_warn_of_estimators_that_cannot_be_used() -> None:
    bundle = weakened(sound(), 3)
    measured = pressed(bundle, {3: 9.0}, [3])
    forces = measured.forces_N(bundle, "koi_inverse")
    assert any("cannot be used on 1 switched" in text for text in measured.warnings(bundle, forces))
    for estimator in ("koi_inverse", "auto"):
        quiet = measured.warnings(bundle, forces, estimator=estimator)
        assert not any("cannot be used" in text for text in quiet)
    # Networks that add to the forces on key nodes take no K·u.
    for base in ("stiffness", "key_nodes"):
        net = CascadeNetwork(
            parameters=np.zeros(parameter_count()),
            activation="rectified",
            scale_in=np.ones(10),
            scale_out=1.0,
            base=base,
        )
        learnt = replace(bundle, model=replace(bundle.model, networks={"fem_nn": net}))
        texts = measured.warnings(learnt, forces, estimator="fem_nn")
        assert any("cannot be used" in text for text in texts) == (base == "stiffness")
        (limit,) = [text for text in learnt.limits() if "cannot be used" in text]
        assert limit.startswith("fem, fem_nn cannot" if base == "stiffness" else "fem cannot")


def test_frames_warn_of_motion_that_a_network_has_not_learnt() -> None:
    bundle = sound()
    measured = pressed(bundle, {3: 9.0}, [3])
    forces = measured.forces_N(bundle, "koi_inverse")
    for reach, warned in ((1e3, False), (1e-6, True)):
        net = CascadeNetwork(
            parameters=np.zeros(parameter_count()),
            activation="rectified",
            scale_in=np.ones(10),
            scale_out=1.0,
            base="key_nodes",
            low=np.full(10, -reach),
            high=np.full(10, reach),
        )
        learnt = replace(bundle, model=replace(bundle.model, networks={"fem_nn": net}))
        for estimator in ("fem_nn", "auto"):
            texts = measured.warnings(learnt, forces, estimator=estimator)
            beyond = any("has learnt no such motion" in text for text in texts)
            assert beyond == (warned and estimator == "fem_nn")
