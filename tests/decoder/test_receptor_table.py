"""Large displacements by forces on receptors themselves, on a sensor in closed form."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.large_displacements import LargeDisplacements
from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_decoder.mechanics.interaction_table import interaction_likeness
from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_design.datasets.samples import Samples, truth_rows
from phytac_design.training.fem_calibration import _receptors, fit_mechanics
from phytac_shapes.arrays import FloatArray, IntArray
from tests.decoder import flat_samples
from tests.decoder.flat_sensor import MARKERS
from tests.decoder.test_bundle_locator import bundle
from tests.decoder.test_large_displacements import LINEAR, N, model
from tests.decoder.test_pairs import softer
from tests.refusals import refused

IDS = np.array([33, 45, 57])
ORDERS = 2
"""Of the tables in the bundle."""
MORE = 1.4
"""Shifts beyond linear ones on the receptors, over those of the tables."""


def tables(softening: float = 0.012) -> LargeDisplacements:
    return LargeDisplacements(places=softer(softening), position_mm=MARKERS)


def receptors(softening: float = 0.012, marker: IntArray = IDS[:2]) -> ReceptorTable:
    """Rows of the tables' receptors times ``MORE``, and the first two pushed against each other."""
    plain = tables(softening)
    rows = [plain._rows(each)[1:] for each in marker.tolist()]
    return ReceptorTable(
        marker=marker,
        shift_px=(MORE * np.array(rows)).astype(np.float32),
        pair=np.array([[45], [33]]),
        pair_px=0.004 * LINEAR[:, [33]].T.astype(np.float32),
        top_N=25.0,
    )


def test_they_stand_in_place_of_the_tables() -> None:
    plain = tables()
    own = replace(plain, receptors=receptors())
    force = np.array([20.0])
    for k, factor in ((0, MORE), (1, MORE), (2, 1.0)):
        found, slope = own.shifts(IDS[[k]], force)
        wanted, steeper = plain.shifts(IDS[[k]], force)
        np.testing.assert_allclose(found, factor * wanted, atol=1e-4)
        np.testing.assert_allclose(slope, factor * steeper, atol=1e-5)
    pair = np.array([[45, 57], [33, 33]])
    known, other = own.interaction_px(pair)
    np.testing.assert_allclose(known, 0.004 * LINEAR[:, 33], rtol=1e-5)
    np.testing.assert_array_equal(other, plain.interaction_px(pair)[1])


def test_how_alike_they_are_is_by_their_own_rows() -> None:
    own, table = replace(tables(), receptors=receptors()), receptors()
    assert own.places.pairs is not None
    _, found, _ = own._interactions(own.places.pairs, IDS[:2])
    np.testing.assert_allclose(found, interaction_likeness(table.pair_px, table.shift_px[:, 0]))
    assert 0.1 < found[1, 0] < 0.9


def test_the_wall_softens_as_they_say() -> None:
    plain = replace(tables(), receptors=receptors())
    weaker = replace(plain, receptors=receptors(0.02))
    force = np.zeros((1, N))
    force[0, IDS[:2]] = 18.0
    grown = [of.second_order(np.array([[45], [33]]), force)[1][0, 0] for of in (plain, weaker)]
    assert grown[1] > 1.1 * grown[0] > 1.1 * 18.0**2


def test_slopes_are_those_of_the_shifts() -> None:
    own, force = replace(tables(), receptors=receptors()), np.array([21.0, 9.0, 17.0])
    _, slope = own.shifts(IDS, force)
    for k, step in enumerate(0.01 * np.eye(3)):
        up, down = (own.shifts(IDS, force + sign * step)[0] for sign in (1, -1))
        np.testing.assert_allclose(slope[k], (up - down) / 0.02, atol=1e-3)


def test_they_are_scaled_with_the_tables() -> None:
    stiffness, force = 1.25, np.array([13.0, 9.0, 25.0])
    plain = replace(tables(), receptors=receptors())
    scaled = LargeDisplacements(
        places=plain.places.scaled(stiffness),
        position_mm=MARKERS,
        softness=stiffness,
        receptors=receptors().scaled(stiffness),
    )
    for found, wanted in zip(scaled.shifts(IDS, force), plain.shifts(IDS, force), strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-4 * np.abs(wanted).max())


def test_a_model_scales_them_as_its_tables() -> None:
    """Those of a print, whose stiffness ``auto`` has learnt."""
    plain, force = (
        replace(sensor(), receptors=receptors(), modulus=1.1),
        np.array([13.0, 9.0, 25.0]),
    )
    assert plain.locator is not None
    correction = ForceCorrection.plain(low_mm=np.zeros(3), size_mm=1.0, force_max_N=25.0)
    locator = replace(
        plain.locator,
        places=plain.locator.places.scaled(1.25),
        correction=replace(correction, stiffness=1.25),
    )
    wanted = plain.beyond_linear_px(force, IDS)
    found = replace(plain, locator=locator).beyond_linear_px(force, IDS)
    np.testing.assert_allclose(found, wanted, atol=2e-4 * np.abs(wanted).max())


def pressed(of: ForceModel, count: int, seed: int, ids: IntArray) -> Samples:
    """Samples of one or two presses on receptors of a sensor that is a tenth stiffer."""
    rng = np.random.default_rng(seed)
    force, shift = np.zeros((count, N)), np.zeros((count, N, 2))
    for k in range(count):
        own = rng.choice(ids, 1 + k % 2, replace=False)
        force[k, own] = rng.uniform(2.0, 25.0, len(own))
        given = force[k, own] / 1.1
        moved = LINEAR[:, own] @ given + of.beyond_linear_px(given, own)
        shift[k] = moved.reshape(N, 2)
    bits = force > 0.0
    return replace(
        flat_samples.pressed(count, seed=0),
        bits=bits,
        bits_read=bits,
        shift_px=shift + rng.normal(0.0, 0.01, shift.shape),
        truth=truth_rows(bits, np.full(bits.shape, -1), force),
    )


def sensor() -> ForceModel:
    plain = model()
    assert plain.locator is not None
    return replace(plain, locator=replace(plain.locator, places=softer(0.012)))


def test_training_solves_them_where_forces_act_on_few_footprints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain, asked = sensor(), []
    real = replace(plain, receptors=receptors(marker=IDS))

    def solver(marker: IntArray, pair: IntArray, spread: float) -> ReceptorTable:
        asked.append((marker.tolist(), sorted(pair.T.tolist()), spread))
        return receptors(marker=marker)

    samples, validation = pressed(real, 24, 1, IDS), pressed(real, 6, 2, IDS)
    found = fit_mechanics(plain, LINEAR, samples, validation, solver)
    ((marker, pair, spread),) = asked
    assert marker == IDS.tolist()
    assert pair == [[45, 33], [57, 33], [57, 45]]
    assert spread <= 0.5
    assert found.receptors == 3
    assert found.modulus == pytest.approx(1.1, rel=0.003)
    assert found.error_N < 0.02
    without = fit_mechanics(plain, LINEAR, samples, validation)
    assert without.receptors == 0
    assert without.error_N > 10.0 * found.error_N
    # Forces that spread over cells, or act on many receptors, are those of the tables.
    assert _receptors(solver, plain, samples, 0.6) is None
    assert _receptors(solver, plain.linear, samples, 0.0) is None
    monkeypatch.setattr("phytac_design.training.fem_calibration.RECEPTORS_MAX", 2)
    assert _receptors(solver, plain, samples, 0.0) is None
    assert len(asked) == 1


def with_receptors() -> tuple[ReceptorTable, ForceModel]:
    rng, plain = np.random.default_rng(4), bundle()
    count = len(plain.colour)
    table = ReceptorTable(
        marker=np.array([3, 7, 11]),
        shift_px=rng.normal(size=(3, ORDERS - 1, 2 * count)).astype(np.float32),
        pair=np.array([[7, 11], [3, 7]]),
        pair_px=rng.normal(size=(2, 2 * count)).astype(np.float32),
        top_N=30.0,
    )
    return table, replace(plain.model, receptors=table)


def test_a_bundle_keeps_them(tmp_path: Path) -> None:
    table, of = with_receptors()
    plain = bundle()
    save_bundle(replace(plain, model=of), tmp_path)
    kept = load_bundle(tmp_path).model.receptors
    assert kept is not None
    for name in ("marker", "shift_px", "pair", "pair_px", "top_N"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(table, name))
    save_bundle(plain, tmp_path)
    assert load_bundle(tmp_path).model.receptors is None


def changed(name: str, value: FloatArray | IntArray) -> dict[str, FloatArray | IntArray]:
    return {f"receptor_{name}": value}


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (changed("top_N", np.array([0.0])), "bundle-invalid"),
        (changed("pair", np.array([[7, 12], [3, 7]])), "bundle-invalid"),
        (changed("pair", np.array([[7, 99], [3, 7]])), "bundle-id-invalid"),
        (changed("px", np.zeros((3, ORDERS, 60), dtype=np.float32)), "bundle-invalid"),
        (changed("px", np.zeros((2, ORDERS - 1, 60), dtype=np.float32)), "bundle-array-shape"),
        (changed("pair_px", np.full((2, 60), np.nan, dtype=np.float32)), "bundle-not-finite"),
    ],
)
def test_a_bundle_with_others_is_refused(
    change: dict[str, FloatArray | IntArray], code: str, tmp_path: Path
) -> None:
    _, of = with_receptors()
    save_bundle(replace(bundle(), model=of), tmp_path)
    path = tmp_path / "bundle.safetensors"
    save_file({name: value.copy() for name, value in load_file(path).items()} | change, path)
    with refused(code):
        load_bundle(tmp_path)
