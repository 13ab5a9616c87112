"""Estimators, network, training and bundle."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file
from scipy.optimize import nnls

from phytac_decoder.camera.camera import Camera
from phytac_decoder.estimation.cascade_network import (
    CascadeNetwork,
    network_features,
    parameter_count,
)
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.nonnegative import nonnegative_least_squares
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.vision.segmentation import ColourModel
from phytac_decoder.vision.switch_detection import TipModel
from phytac_design.training.levenberg_marquardt import KeyNodeData, split_samples, train_network
from tests.refusals import refused

N = 12


def random_network(seed: int = 0, activation: str = "rectified") -> CascadeNetwork:
    rng = np.random.default_rng(seed)
    return CascadeNetwork(
        parameters=rng.normal(size=351),
        activation=activation,
        scale_in=rng.uniform(0.5, 2.0, 10),
        scale_out=3.0,
    )


def force_model(seed: int = 0) -> ForceModel:
    """A made-up sensor whose u depends on forces through a well-conditioned compliance."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(N, 2))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    apparent = 0.03 * (np.eye(N) + 0.3 * rng.uniform(size=(N, N)))
    return ForceModel(
        shift_to_mm=direction / 20.0,
        stiffness=np.linalg.inv(apparent),
        compliance_px=(20.0 * direction[:, :, None] * apparent[:, None, :]).reshape(2 * N, N),
        height_z_mm=np.linspace(0, 100, N),
        neighbours=rng.integers(-1, N, (N, 8)),
        networks={"fem_nn": random_network(), "fem_nn_identity": random_network(1, "identity")},
    )


def test_the_network_has_the_papers_351_parameters() -> None:
    assert parameter_count() == 351


def test_identity_network_is_affine_and_rectified_is_not() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 50, 10))
    for activation, affine in (("identity", True), ("rectified", False)):
        net = random_network(2, activation)
        middle = net((a + b) / 2) - (net(a) + net(b)) / 2
        assert (np.abs(middle).max() < 1e-9) == affine


def test_features_pad_clamped_rims_with_zero() -> None:
    u = np.arange(1.0, 4.0)
    near = np.array([[1, -1, -1, 2, -1, -1, -1, -1]] * 3)
    out = network_features(u, near, np.array([5.0, 6.0, 7.0]), np.array([0]))
    assert out.tolist() == [[1, 2, 0, 0, 3, 0, 0, 0, 0, 5]]


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 12))
def test_nonnegative_least_squares_agrees_with_scipy(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    # Columns that resemble each other, as those of neighbouring receptors do: a force that was
    # positive turns negative when its neighbour joins, and has to leave again.
    a = rng.normal(size=(30, size)) + 2.0 * rng.normal(size=(30, 1)) + np.linspace(0, 1, size)
    b = rng.normal(size=30) + a @ rng.normal(size=size)
    ours = nonnegative_least_squares(a.T @ a, a.T @ b)
    assert np.allclose(ours, nnls(a, b)[0], atol=1e-8)


def test_a_force_that_left_may_come_back() -> None:
    """Receptors in a row, few of them pressed, in noise: one block too many leaves at first."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        size = int(rng.integers(2, 9))
        places = np.linspace(-2.0, size + 1.0, 4 * size)
        a = np.exp(-(((places[:, None] - np.arange(size)) / 1.2) ** 2))
        pressed = np.where(rng.uniform(size=size) < 0.4, rng.uniform(0.5, 9.0, size), 0.0)
        b = a @ pressed + rng.normal(0.0, 0.3, 4 * size)
        ours = nonnegative_least_squares(a.T @ a, a.T @ b)
        assert np.allclose(ours, nnls(a, b)[0], atol=1e-6)


@pytest.mark.parametrize("estimator", ["fem", "koi_inverse"])
def test_exact_data_give_exact_forces(estimator: str) -> None:
    model = force_model()
    force = np.zeros(N)
    force[[2, 7]] = 3.0, 11.0
    shift = (model.compliance_px @ force).reshape(N, 2)
    assert np.allclose(model.forces(estimator, shift, np.array([2, 7])), force, atol=1e-9)


def test_a_lost_marker_does_not_hurt_the_inverse() -> None:
    model = force_model()
    force = np.zeros(N)
    force[4] = 6.0
    shift = (model.compliance_px @ force).reshape(N, 2)
    shift[4] = np.nan
    assert model.forces("koi_inverse", shift, np.array([4]))[4] == pytest.approx(6.0)


def test_no_switch_no_force() -> None:
    model = force_model()
    shift = np.ones((N, 2))
    for name in ("fem", "fem_nn", "koi_inverse"):
        assert (model.forces(name, shift, np.array([], dtype=np.int64)) == 0).all()


def key_nodes(count: int, seed: int) -> KeyNodeData:
    """Nodes whose true stiffness depends on the sign of a neighbour's motion."""
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(count, 10)) * 0.1
    u = features[:, 0]
    k = 40.0 + 200.0 * np.maximum(features[:, 3], 0.0)
    return KeyNodeData(
        features=features,
        apparent_mm=u,
        stiffness_force_N=15.0 * u,
        force_N=(15.0 + k) * u,
        sample=np.arange(count),
    )


def test_training_finds_a_stiffness_the_affine_net_cannot() -> None:
    train, validation, test = key_nodes(600, 0), key_nodes(60, 1), key_nodes(200, 2)
    error = {}
    for activation in ("rectified", "identity"):
        net = train_network(train, validation, activation=activation, seed=0).network
        guess = test.stiffness_force_N + net(test.features) * test.apparent_mm
        learnt = net.learnt(test.features) == 1.0
        assert learnt.sum() > 100
        error[activation] = float(np.sqrt(((guess - test.force_N)[learnt] ** 2).mean()))
    assert error["rectified"] < 0.1 * error["identity"]
    assert error["identity"] < 0.3 * test.force_N.std()


def test_beyond_its_training_a_network_adds_nothing() -> None:
    train, validation = key_nodes(200, 0), key_nodes(20, 1)
    net = train_network(train, validation, activation="rectified", seed=0).network
    edge = train.features.max(axis=0)
    inside = np.tile(train.features.mean(axis=0), (2, 1))
    outside = inside.copy()
    span = np.ptp(train.features[:, 4])
    inside[1, 4], outside[1, 4] = edge[4], edge[4] + 1.1 * span
    assert (net(inside) != 0.0).all()
    assert net(outside).tolist() == [net(inside)[0], 0.0]
    # It fades, and does not jump.
    places = np.tile(inside[1], (200, 1))
    places[:, 4] += np.linspace(0.0, 1.1 * span, 200)
    assert np.abs(np.diff(net(places))).max() < 0.05 * np.abs(net(places)).max()
    model = replace(force_model(), networks={"fem_nn": net})
    koi, far = np.array([4]), np.full((N, 2), 9.0)
    assert (model.forces("fem_nn", far, koi) == model.forces("fem", far, koi)).all()
    assert model.beyond_range("fem_nn", far, koi).tolist() == [4]
    assert model.beyond_range("fem", far, koi).tolist() == []


def test_forces_on_key_nodes_as_base_leave_the_tip_out() -> None:
    """Markers around a contact determine it; its own is off by what its tip covers."""
    plain = force_model()
    flat = replace(random_network(), base="key_nodes", parameters=np.zeros(351))
    model = replace(plain, networks={"fem_nn": flat})
    force = np.zeros(N)
    force[[2, 7]] = 0.3, 1.1
    shift = (model.compliance_px @ force).reshape(N, 2)
    koi = np.array([2, 7])
    assert np.allclose(model.forces("fem_nn", shift, koi), force, atol=1e-9)
    shift[7] += 0.2
    off = [abs(model.forces(name, shift, koi)[7] - 1.1) for name in ("fem_nn", "koi_inverse")]
    assert off[0] < 0.6 * off[1]


def test_training_is_deterministic_and_refuses_too_little() -> None:
    train, validation = key_nodes(100, 0), key_nodes(20, 1)
    a = train_network(train, validation, activation="rectified", seed=3).network.parameters
    b = train_network(train, validation, activation="rectified", seed=3).network.parameters
    assert (a == b).all()
    with refused("training-data-too-few"):
        train_network(key_nodes(5, 0), validation, activation="rectified", seed=0)


def test_split_is_the_papers() -> None:
    parts = split_samples(598, seed=1)
    assert [len(part) for part in parts] == [508, 30, 60]
    assert sorted(np.concatenate(parts).tolist()) == list(range(598))


def make_bundle() -> Bundle:
    rng = np.random.default_rng(0)
    return Bundle(
        design="toy",
        design_hash="0" * 64,
        cameras=(Camera.on_axis(width_px=640, height_px=480, focal_px=240, stand_off_mm=30),),
        read_by=np.zeros(N, dtype=np.int64),
        colours=ColourModel.from_rgb({"blue": (28, 72, 214), "red": (214, 30, 34)}),
        colour=np.zeros(N, dtype=np.int64),
        position_mm=rng.normal(size=(N, 3)),
        head_mm=rng.normal(size=(N, 3)),
        rest_px=rng.normal(size=(N, 2)),
        tip_bias_px=np.zeros((N, 2)),
        tips=TipModel(on_px=rng.normal(size=(N, 2)), red_rest_px=np.zeros(N), red_on_px=np.ones(N)),
        model=force_model(),
        threshold_N=np.linspace(0.4, 0.8, N),
        notes={"why": "test"},
    )


def test_bundle_comes_back_as_it_was(tmp_path: Path) -> None:
    bundle = make_bundle()
    save_bundle(bundle, tmp_path)
    back = load_bundle(tmp_path)
    assert (back.model.stiffness == bundle.model.stiffness).all()
    assert (back.camera.position_mm == bundle.camera.position_mm).all()
    assert (back.threshold_N == bundle.threshold_N).all()
    assert back.model.networks.keys() == bundle.model.networks.keys()
    x = np.random.default_rng(3).normal(size=(4, 10))
    assert (back.model.networks["fem_nn"](x) == bundle.model.networks["fem_nn"](x)).all()
    save_bundle(back, tmp_path / "again")
    for name in ("bundle.json", "bundle.safetensors"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_damaged_bundles_are_rejected(tmp_path: Path) -> None:
    save_bundle(make_bundle(), tmp_path)
    meta_path, arrays_path = tmp_path / "bundle.json", tmp_path / "bundle.safetensors"
    meta, raw = meta_path.read_text(), arrays_path.read_bytes()
    arrays = load_file(arrays_path)

    def rejected(code: str) -> None:
        with refused(code):
            load_bundle(tmp_path)
        meta_path.write_text(meta)
        arrays_path.write_bytes(raw)

    arrays_path.write_bytes(raw[: len(raw) // 2])
    rejected("bundle-unreadable")
    meta_path.write_text(json.dumps({**json.loads(meta), "schema_version": "2.0"}))
    rejected("bundle-schema-version")
    meta_path.write_text(json.dumps({**json.loads(meta), "markers": 13}))
    rejected("bundle-array-shape")
    meta_path.write_text("{")
    rejected("bundle-unreadable")
    meta_path.write_text(json.dumps({"format": "other"}))
    rejected("bundle-unknown-format")
    meta_path.write_text(json.dumps({k: v for k, v in json.loads(meta).items() if k != "camera"}))
    rejected("bundle-invalid")
    damaged = {**arrays, "stiffness": np.full_like(arrays["stiffness"], np.nan)}
    save_file(damaged, arrays_path)
    rejected("bundle-not-finite")
    save_file({k: v for k, v in arrays.items() if k != "rest_px"}, arrays_path)
    rejected("bundle-array-missing")
    save_file({**arrays, "stiffness": arrays["stiffness"].astype(np.float32)}, arrays_path)
    rejected("bundle-array-type")
    far = np.where(arrays["neighbours"] < 0, 99999, arrays["neighbours"])
    save_file({**arrays, "neighbours": far}, arrays_path)
    rejected("bundle-id-invalid")
    camera = {**json.loads(meta)["camera"], "width_px": -5}
    meta_path.write_text(json.dumps({**json.loads(meta), "cameras": [camera]}))
    rejected("lens-not-finite")
    save_file({**arrays, "stiffness": 1.01 * arrays["stiffness"]}, arrays_path)
    rejected("bundle-files-differ")
    with refused("bundle-not-found"):
        load_bundle(tmp_path / "nowhere")


def test_an_unknown_activation_is_rejected(tmp_path: Path) -> None:
    bundle = make_bundle()
    odd = replace(bundle.model.networks["fem_nn"], activation="cubic")
    save_bundle(replace(bundle, model=replace(bundle.model, networks={"fem_nn": odd})), tmp_path)
    with refused("bundle-invalid"):
        load_bundle(tmp_path)


def test_a_linear_shell_is_read_by_linear_tables() -> None:
    model = force_model()
    assert model.linear is model
    locator: Any = SimpleNamespace(linear="linear tables")
    assert replace(model, locator=locator).linear.locator == "linear tables"
