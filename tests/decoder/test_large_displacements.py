"""Forces on receptors under large displacements, on a sensor in closed form."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.camera.camera_motion import CameraMotion
from phytac_decoder.estimation.contact_shifts import predicted_shifts
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.large_displacements import LargeDisplacements
from phytac_decoder.estimation.measured_columns import MeasuredColumns
from phytac_decoder.pipeline.fault_detection import FaultDetector
from phytac_design.datasets.samples import THEORIES, Samples, key_nodes, truth_rows
from phytac_design.stages import decoder_stage
from phytac_design.training.fem_calibration import measure
from phytac_design.training.trainers import TRAINERS, TrainingTask
from phytac_design.training.training_data import SplitPart, data_of
from phytac_shapes.arrays import FloatArray, IntArray
from tests.decoder import flat_samples
from tests.decoder.flat_sensor import MARKERS, flat_locator, neighbours, per_newton
from tests.decoder.test_pairs import aware, pressed, softer, states
from tests.decoder.toy_sensor import toy_bundle

N = len(MARKERS)
LINEAR = np.stack([per_newton(at) for at in MARKERS], axis=1)
PRESSES = [([44], [18.0]), ([23, 66], [6.0, 21.0]), ([33, 45, 57, 76], [3.0, 9.0, 25.0, 0.7])]


def model(modulus: float = 1.0) -> ForceModel:
    return ForceModel(
        shift_to_mm=np.ones((N, 2)),
        stiffness=np.eye(N),
        compliance_px=LINEAR / modulus,
        height_z_mm=np.zeros(N),
        neighbours=neighbours(),
        networks={},
        locator=aware(flat_locator()),
        modulus=modulus,
    )


def seen(ids: list[int], force_N: list[float]) -> FloatArray:
    return pressed([MARKERS[k] for k in ids], force_N)


def beyond(ids: list[int], force_N: list[float]) -> FloatArray:
    return np.asarray(seen(ids, force_N) - LINEAR[:, ids] @ force_N)


def large(of: ForceModel | None = None) -> LargeDisplacements:
    found = (of or model()).large_displacements
    assert found is not None
    return found


@pytest.mark.parametrize(("ids", "force_N"), PRESSES)
def test_shifts_beyond_linear_ones_are_those_of_the_sensor(
    ids: list[int], force_N: list[float]
) -> None:
    more, _ = large().shifts(np.array(ids), np.array(force_N))
    wanted = beyond(ids, force_N)
    assert np.linalg.norm(more - wanted) < 0.02 * np.linalg.norm(wanted)


@pytest.mark.parametrize(("ids", "force_N"), PRESSES)
def test_slopes_are_those_of_the_shifts(ids: list[int], force_N: list[float]) -> None:
    own, force = large(model(1.2)), np.array(force_N)
    _, slope = own.shifts(np.array(ids), force)
    for k, step in enumerate(0.01 * np.eye(len(ids))):
        up, down = (own.shifts(np.array(ids), force + sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose(slope[k], (up - down) / 0.02, atol=2e-4)


@pytest.mark.parametrize("modulus", [1.0, 1.3])
@pytest.mark.parametrize(("ids", "force_N"), PRESSES)
def test_forces_are_found_again(ids: list[int], force_N: list[float], modulus: float) -> None:
    # A stiffer wall is where the other is under less force.
    shift, koi = seen(ids, [f / modulus for f in force_N]).reshape(-1, 2), np.array(ids)
    forces = model(modulus).forces("koi_inverse", shift, koi)
    np.testing.assert_allclose(forces[koi], force_N, rtol=0.004, atol=0.02)
    # The largest force was 14 to 30 % off without.
    without = model(modulus).linear.forces("koi_inverse", shift, koi)
    off = np.abs(without[koi] / force_N - 1.0)
    assert 0.1 < off[np.argmax(force_N)] < 0.4


def test_tables_that_were_scaled_to_a_print_are_those_of_the_design() -> None:
    locator, stiffness = aware(flat_locator()), 1.25
    scaled = replace(locator, places=locator.places.scaled(stiffness))
    own = LargeDisplacements(places=scaled.places, position_mm=MARKERS, softness=stiffness)
    ids, force = np.array([33, 45, 57]), np.array([3.0, 9.0, 25.0])
    for found, wanted in zip(own.shifts(ids, force), large().shifts(ids, force), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(wanted).max())


def test_a_model_takes_what_its_tables_were_scaled_by() -> None:
    plain = model(1.1)
    correction = ForceCorrection(
        stiffness=1.25,
        centre=np.zeros((0, 3)),
        weight=np.zeros(0),
        low_mm=np.zeros(3),
        size_mm=np.ones(3),
        force_max_N=25.0,
        spread=np.zeros(0),
    )
    assert plain.locator is not None
    fitted = replace(plain.locator, correction=correction)
    assert large(replace(plain, locator=fitted)).softness == pytest.approx(1.25 / 1.1)
    assert large(plain).softness == pytest.approx(1.0 / 1.1)


def test_they_are_those_of_auto_where_the_wall_softens() -> None:
    """Contacts on receptors, by the tables of ``auto``: two ways to one shift."""
    places = softer(0.012)
    own = LargeDisplacements(places=places, position_mm=MARKERS)
    ids, force = np.array([33, 45, 57]), np.array([21.0, 9.0, 25.0])
    found = states(places, [MARKERS[k] for k in ids], force.tolist())
    wanted = np.sum([one for one, _ in predicted_shifts(places, found)], axis=0)
    wanted -= LINEAR[:, ids] @ force
    np.testing.assert_allclose(own.shifts(ids, force)[0], wanted, atol=4e-3 * np.abs(wanted).max())


def test_second_order_is_what_measured_terms_add() -> None:
    ids, pair = np.array([33, 45, 57]), np.array([[45, 57], [33, 45]])
    square_px, pair_px = 0.004 * LINEAR[:, ids], 0.03 * LINEAR[:, [33, 44]]
    plain = LargeDisplacements(places=softer(0.012), position_mm=MARKERS, softness=1.2)
    measured = replace(
        plain,
        measured=MeasuredColumns(
            marker=ids, shift_px=LINEAR[:, ids], square_px=square_px, pair=pair, pair_px=pair_px
        ),
    )
    force = np.zeros((2, N))
    force[:, ids] = [[17.0, 12.0, 5.0], [0.0, 9.0, 0.0]]
    squares, products = plain.second_order(pair, force)
    for each, square, product in zip(force, squares, products, strict=True):
        own = np.flatnonzero(each)
        more = measured.shifts(own, each[own])[0] - plain.shifts(own, each[own])[0]
        wanted = square_px @ square[ids] + pair_px @ product
        np.testing.assert_allclose(more, wanted, atol=1e-4 * np.abs(wanted).max())
    # The wall is softer where others press.
    assert squares[0, 57] > 1.1 * 5.0**2
    assert squares[1, 45] == pytest.approx(9.0**2)
    images = plain.interaction_px(pair)
    np.testing.assert_allclose(
        images[0], 1.44 * plain.places.pairs.between(MARKERS[[45, 33]])[0], rtol=1e-5
    )


def test_forces_beyond_the_tables_are_finite_and_grow() -> None:
    places = replace(aware(flat_locator()).places, top_N=10.0)
    own = LargeDisplacements(places=places, position_mm=MARKERS)

    def least_squares(rows: FloatArray, shift: FloatArray) -> FloatArray:
        return np.maximum(np.linalg.lstsq(rows.T, shift, rcond=None)[0], 0.0)

    def found(ids: IntArray, shift: FloatArray) -> FloatArray:
        return own.solve(least_squares, np.ascontiguousarray(LINEAR[:, ids].T), shift, ids)

    ids = np.array([44, 45])
    forces = [found(ids, scale * LINEAR[:, ids].sum(axis=1)) for scale in (5, 10, 20, 50, 500)]
    assert np.isfinite(forces).all()
    assert (np.diff(forces, axis=0) > 0.0).all()
    # Beyond twice the largest tabulated force all is linear.
    one, two, three = (found(ids, k * LINEAR[:, ids].sum(axis=1)) for k in (100, 200, 300))
    np.testing.assert_allclose(three - two, two - one, rtol=1e-4)


def test_forces_that_would_alternate_settle() -> None:
    class Alternating(LargeDisplacements):
        def shifts(self, receptors: IntArray, force_N: FloatArray) -> tuple[FloatArray, FloatArray]:
            return force_N, np.zeros((len(receptors), 1))

    def least_squares(rows: FloatArray, shift_px: FloatArray) -> FloatArray:
        return shift_px

    own = Alternating(places=large().places, position_mm=MARKERS)
    forces = own.solve(least_squares, np.ones((1, 1)), np.array([8.0]), np.array([44]))
    np.testing.assert_allclose(forces, 4.0, rtol=0.01)


def test_receptors_without_a_force_change_nothing() -> None:
    ids, force_N = PRESSES[1]
    shift = seen(ids, force_N).reshape(-1, 2)
    more = np.array([*ids, 2, 90])
    forces = model().forces("koi_inverse", shift, more)
    np.testing.assert_allclose(forces[ids], force_N, rtol=0.004)
    assert forces[[2, 90]].max() < 0.05
    assert not model().forces("koi_inverse", shift, more[:0]).any()
    assert not model().beyond_linear_px(np.zeros(0), more[:0]).any()


def drawn(count: int, seed: int, *, softer: float, linear: bool) -> Samples:
    """Samples of one to three presses on receptors."""
    rng = np.random.default_rng(seed)
    bits, force = np.zeros((count, N), dtype=np.bool_), np.zeros((count, N))
    shift = np.zeros((count, N, 2))
    for k in range(count):
        ids = rng.choice([22, 27, 44, 47, 71, 76], 1 + k % 3, replace=False).tolist()
        bits[k, ids] = True
        force[k, ids] = rng.uniform(1.0, 25.0, len(ids))
        own = softer * force[k, ids]
        moved = LINEAR[:, ids] @ own if linear else seen(ids, own.tolist())
        shift[k] = moved.reshape(N, 2)
    return replace(
        flat_samples.pressed(count, seed=0),
        bits=bits,
        bits_read=bits,
        shift_px=shift + rng.normal(0.0, 0.01, shift.shape),
        theory=np.full(count, THEORIES.index("linear" if linear else "large")),
        truth=truth_rows(bits, np.full(bits.shape, -1), force),
    )


@pytest.mark.parametrize("linear", [True, False])
def test_trainers_use_the_theory_of_the_data(linear: bool) -> None:
    plain = replace(model(), footprint_px=LINEAR)
    parts = []
    for seed, count in enumerate((60, 12, 12)):
        samples = drawn(count, seed, softer=0.8, linear=linear)
        rows = data_of(key_nodes(plain, samples, noise_px=0.01))
        parts.append(SplitPart(count=count, rows=rows, samples=samples))
    training, validation, test = parts
    task = TrainingTask(
        bundle=replace(toy_bundle(), model=plain),
        training=training,
        validation=validation,
        test=test,
        seed=0,
    )
    trainers = dict(TRAINERS)
    fitted, facts = trainers["mechanics"](task)
    assert facts["modulus"] == fitted.modulus == pytest.approx(1.25, rel=0.01)
    assert facts["error_N"] < 0.15
    assert fitted.locator is plain.locator
    with_network = replace(task, bundle=replace(task.bundle, model=fitted))
    assert trainers["fem_nn"](with_network)[1]["rmse_test_N"] < 0.2


def test_networks_of_a_build_learn_a_linear_shell(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[ForceModel] = []

    def key_node_data(of: ForceModel, _: Any) -> None:
        given.append(of)
        raise InterruptedError

    monkeypatch.setattr(decoder_stage, "key_node_data", key_node_data)
    nothing: Any = None
    with pytest.raises(InterruptedError):
        decoder_stage.train_networks(nothing, model(), nothing)
    assert given[0].large_displacements is None


def test_columns_are_measured_beside_large_displacements() -> None:
    """A receptor whose column is otherwise than by design, under presses of its own and pairs."""
    off, rng, count = 44, np.random.default_rng(0), 60
    bits, force = np.zeros((count, N), dtype=np.bool_), np.zeros((count, N))
    shift = np.zeros((count, N, 2))
    change = 0.2 * LINEAR[:, off].reshape(N, 2) * rng.normal(1.0, 0.2, (N, 1))
    for k in range(count):
        ids = [off] if k % 3 else [off, int(rng.choice([22, 47, 66]))]
        bits[k, ids] = True
        force[k, ids] = rng.uniform(1.0, 25.0, len(ids))
        shift[k] = seen(ids, force[k, ids].tolist()).reshape(N, 2) + change * force[k, off]
    samples = replace(
        flat_samples.pressed(count, seed=0),
        shift_px=shift + rng.normal(0.0, 0.02, shift.shape),
        truth=truth_rows(bits, np.full(bits.shape, -1), force),
    )
    wanted = LINEAR[:, off] + change.reshape(-1)
    errors = []
    for of in (model(), model().linear):
        found = measure(of, samples, 0.3)
        assert found is not None
        column = found.shift_px[:, found.marker.tolist().index(off)]
        errors.append(np.linalg.norm(column - wanted) / np.linalg.norm(wanted))
    assert errors[0] < 0.02
    assert errors[1] > 0.1


def test_markers_that_were_misread_measure_nothing() -> None:
    rng, count, ids = np.random.default_rng(0), 40, np.array([44, 66])
    force, shift = np.zeros((count, N)), np.zeros((count, N, 2))
    for k in range(count):
        force[k, ids[k % 2]] = rng.uniform(2.0, 20.0)
        own = np.flatnonzero(force[k])
        shift[k] = seen(own.tolist(), force[k, own].tolist()).reshape(N, 2)
    samples = replace(
        flat_samples.pressed(count, seed=0),
        shift_px=shift + rng.normal(0.0, 0.01, shift.shape),
        truth=truth_rows(force > 0.0, np.full(force.shape, -1), force),
    )
    sound = measure(model(), samples, 0.3)
    assert samples.shift_px is not None
    # Near the first receptor, one in five times.
    samples.shift_px[::10, 45] += [8.0, -5.0]
    found = measure(model(), samples, 0.3)
    assert sound is not None
    assert found is not None
    np.testing.assert_allclose(found.shift_px, sound.shift_px, atol=0.005)


def test_squares_and_pairs_are_measured() -> None:
    """Receptors that soften more than by design, and two that soften each other more."""
    of, rng, count = model(), np.random.default_rng(0), 120
    ids = np.array([44, 45, 66])
    square = {44: 0.008 * LINEAR[:, 44], 66: -0.006 * LINEAR[:, 66]}
    pair = 0.006 * (LINEAR[:, 44] + LINEAR[:, 45])
    force, shift = np.zeros((count, N)), np.zeros((count, N, 2))
    for k in range(count):
        own = (ids, ids[:2], ids[:1], ids[2:])[k % 4]
        force[k, own] = rng.uniform(1.0, 12.0, len(own))
        shown = seen(own.tolist(), force[k, own].tolist()) + force[k, 44] * force[k, 45] * pair
        shown += sum(force[k, one] ** 2 * row for one, row in square.items())
        shift[k] = shown.reshape(N, 2)
    bits = force > 0.0
    samples = replace(
        flat_samples.pressed(count, seed=0),
        shift_px=shift + rng.normal(0.0, 0.01, shift.shape),
        truth=truth_rows(bits, np.full(bits.shape, -1), force),
    )
    found = measure(of, samples, 0.3)
    assert found is not None
    assert found.pair.T.tolist() == [[45, 44], [66, 44], [66, 45]]
    for one, row in square.items():
        assert np.linalg.norm(found.squares[one] - row) < 0.3 * np.linalg.norm(row)
    assert np.linalg.norm(found.pairs[45, 44] - pair) < 0.25 * np.linalg.norm(pair)
    assert np.linalg.norm(found.pairs[66, 44]) < 0.3 * np.linalg.norm(pair)
    errors = []
    for each in (of, replace(of, measured=found)):
        read = [each.forces("koi_inverse", shift[k], np.flatnonzero(bits[k])) for k in range(12)]
        errors.append(np.abs(np.array(read) - force[:12])[bits[:12]])
    assert errors[1].mean() < 0.15 * errors[0].mean()
    # In any order of the key nodes.
    measured, koi = replace(of, measured=found), np.flatnonzero(bits[0])
    np.testing.assert_allclose(
        measured.forces("koi_inverse", shift[0], koi[::-1]),
        measured.forces("koi_inverse", shift[0], koi),
        atol=0.01,
    )
    # On a print whose wall is stiffer the same is measured.
    stiff = replace(of, modulus=1.5)
    stiff = replace(stiff, measured=measure(stiff, samples, 0.3))
    read = [stiff.forces("koi_inverse", shift[k], np.flatnonzero(bits[k])) for k in range(12)]
    assert np.abs(np.array(read) - force[:12]).max() < 0.3


def test_squares_by_weak_presses_are_small_for_strong_ones() -> None:
    """Noise alone makes them; at the largest force of the tables they stay within the prior."""
    rng, count = np.random.default_rng(0), 12
    force, shift = np.zeros((count, N)), np.zeros((count, N, 2))
    force[:, 44] = rng.uniform(0.5, 1.5, count)
    locator = aware(flat_locator())
    places = locator.places.with_rows(locator.places.shift_px, top_N=25.0)
    of = replace(model(), locator=replace(locator, places=places), noise_px=0.02)
    for k in range(count):
        shift[k] = seen([44], [force[k, 44]]).reshape(N, 2)
    samples = replace(
        flat_samples.pressed(count, seed=0),
        shift_px=shift + rng.normal(0.0, 0.02, shift.shape),
        truth=truth_rows(force > 0.0, np.full(force.shape, -1), force),
    )
    found = measure(of, samples, 0.3)
    assert found is not None
    assert found.marker.tolist() == [44]
    added = 25.0**2 * found.squares[44]
    assert np.linalg.norm(added) < 0.3 * 25.0 * np.linalg.norm(LINEAR[:, 44])


def test_a_linear_shell_has_neither_squares_nor_pairs() -> None:
    samples = flat_samples.pressed(60, seed=0)
    found = measure(model().linear, samples, 0.3)
    assert found is not None
    assert not found.square_px.size
    assert found.squares == found.pairs == {}


def test_they_are_not_taken_for_motion_of_the_camera() -> None:
    # The second looks like presses in the middle.
    ways = np.stack([np.tile([1.0, 0.0], N), LINEAR[:, 40:50].sum(axis=1)])
    motion = CameraMotion(
        first=ways,
        second=np.zeros((0, 2 * N), dtype=np.float32),
        pair=np.zeros((2, 0), dtype=np.int64),
        sd=np.array([1.0, 1.0]),
    )
    koi, moved = np.arange(4, N, 12), np.array([0.3, 0.1])
    force_N = np.full(len(koi), 12.0)
    shift = (seen(koi.tolist(), force_N.tolist()) + moved @ ways).reshape(-1, 2)
    moving = model().with_camera_motion(motion, 0.02)
    np.testing.assert_allclose(moving.motion(shift, koi), moved, atol=0.005)
    np.testing.assert_allclose(moving.forces("koi_inverse", shift, koi)[koi], force_N, rtol=0.01)
    wanted = beyond(koi.tolist(), force_N.tolist())
    found = moving.beyond_linear_px(force_N, koi)
    assert np.linalg.norm(found - wanted) < 0.02 * np.linalg.norm(wanted)
    assert not moving.linear.beyond_linear_px(force_N, koi).any()


def test_strong_presses_have_no_outliers() -> None:
    """A frame of a nonlinear wall is no fault."""
    toy = toy_bundle()
    strong = replace(toy, model=model(), threshold_N=np.full(N, 0.5), noise_centroid_px=0.01)
    ids, force_N = PRESSES[2]
    koi, shift = np.array(ids), seen(ids, force_N).reshape(-1, 2)
    found = FaultDetector(strong, shift, koi)
    np.testing.assert_allclose(found.forces_on(koi), force_N, rtol=0.02, atol=0.05)
