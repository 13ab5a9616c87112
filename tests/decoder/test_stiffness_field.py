"""Stiffness field of a print that responds to contacts otherwise from place to place."""

from dataclasses import replace

import numpy as np
import pytest

from phytac_decoder.estimation import locator
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.datasets.samples import Samples
from phytac_design.training import locator_calibration, stiffness_field
from phytac_design.training.locator_calibration import calibrate_locator, match_contacts
from phytac_design.training.marker_gain import (
    CrossValidationFold,
    KnownContacts,
    PredictionResiduals,
    predict_residuals,
)
from phytac_design.training.stiffness_field import SETTINGS, StiffnessField
from phytac_shapes.arrays import BoolArray, FloatArray
from tests.decoder.flat_samples import NOISE_PX, PLACE_MM, STIFFNESS, pressed
from tests.decoder.flat_sensor import MARKERS, flat_locator

LOCATOR = flat_locator(place_mm=PLACE_MM, noise_px=NOISE_PX)
PLAIN = replace(LOCATOR, places=LOCATOR.places.scaled(STIFFNESS))
N = len(MARKERS)


@pytest.fixture(autouse=True)
def _no_rim(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing cuts off the discs of this sensor: its shifts are those of whole ones."""
    settings = replace(locator.SETTINGS, rim_power_factor=0.0)
    monkeypatch.setattr(locator, "SETTINGS", settings)


def hilly(point_mm: FloatArray) -> FloatArray:
    """Markers move up to 10 % more or less, those on one side here and on the other there."""
    phase = (MARKERS[:, 0] - MARKERS[:, 1]) / 15.0
    return np.asarray(0.1 * np.cos(point_mm[0] / 12.0 + phase) * np.cos(point_mm[1] / 12.0))


def seen_of(samples: Samples) -> tuple[PredictionResiduals, KnownContacts]:
    touches = samples.touches
    assert touches is not None
    moments = np.zeros((len(touches.force_N), 3))
    moments[:, [0, 2]] = (touches.radius_mm**2 - LOCATOR.places.radius_mm**2)[:, None] / 4.0
    return predict_residuals(PLAIN, samples, np.arange(samples.count), moments)


def test_contacts_are_those_of_the_chosen_samples() -> None:
    samples = pressed(6, seed=2)
    touches = samples.touches
    assert touches is not None
    chosen = np.array([5, 2])
    moments = np.zeros((len(touches.force_N), 3))
    _, known = predict_residuals(PLAIN, samples, chosen, moments)
    np.testing.assert_array_equal(touches.sample[known.touch], chosen[known.row])


def parts_of(count: int, parts: int = 5) -> list[CrossValidationFold]:
    gain = np.zeros((N, 2, 2))
    return [
        CrossValidationFold(rows=np.arange(count) % parts == k, gain=gain) for k in range(parts)
    ]


def field_of(samples: Samples) -> StiffnessField:
    return StiffnessField(*compared(samples), PLAIN.places, PLAIN.noise)


def compared(
    samples: Samples,
) -> tuple[PredictionResiduals, list[CrossValidationFold], KnownContacts]:
    seen, contacts = seen_of(samples)
    return seen, parts_of(samples.count), contacts


def field_of_some(
    seen: PredictionResiduals,
    parts: list[CrossValidationFold],
    contacts: KnownContacts,
    keep: BoolArray,
) -> ResponseTable:
    """Tables by some samples (s,) alone."""
    mine = keep[contacts.row]
    pressed = KnownContacts(
        row=(np.cumsum(keep) - 1)[contacts.row[mine]],
        touch=contacts.touch[mine],
        point_mm=contacts.point_mm[mine],
        linear_N=contacts.linear_N[mine],
    )
    rest = [CrossValidationFold(rows=part.rows[keep], gain=part.gain) for part in parts]
    return StiffnessField(seen.pick(keep), rest, pressed, PLAIN.places, PLAIN.noise).table()


def residual_px(samples: Samples, places: ResponseTable) -> float:
    """RMS of what tables leave of known contacts, less the noise."""
    touches = samples.touches
    assert touches is not None
    moments = np.zeros((len(touches.force_N), 3))
    moments[:, [0, 2]] = (touches.radius_mm**2 - places.radius_mm**2)[:, None] / 4.0
    own = replace(PLAIN, places=places)
    seen, _ = predict_residuals(own, samples, np.arange(samples.count), moments)
    return float(np.sqrt(max(float(np.mean(seen.residual_px**2)) - NOISE_PX**2, 0.0)))


def scaled_by(samples: int, patch: pytest.MonkeyPatch) -> None:
    """Stiffness and noise are fitted to so many samples; up to so many are few."""
    settings = replace(locator_calibration.SETTINGS, scale_samples=samples)
    patch.setattr(locator_calibration, "SETTINGS", settings)


def test_an_uneven_print_is_fitted_and_read_better(monkeypatch: pytest.MonkeyPatch) -> None:
    scaled_by(60, monkeypatch)
    own, fresh = (pressed(k, seed=s, uneven=hilly, noise=0.01) for k, s in ((100, 11), (60, 12)))
    places = field_of(own).table()
    assert residual_px(fresh, places) < 0.5 * residual_px(fresh, PLAIN.places)
    errors = []
    for share in (SETTINGS.share, 0.0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(stiffness_field, "SETTINGS", replace(SETTINGS, share=share))
            learnt, _ = calibrate_locator(LOCATOR, own, np.arange(100), force_max_N=25.0)
        found = match_contacts(replace(learnt, correction=None), fresh, np.arange(60))
        assert learnt.correction is not None
        factor = learnt.correction.factor(found.point_mm, found.force_N, found.signal_px)
        errors.append(float(np.mean(np.abs(found.force_N * factor / found.truth_N - 1.0))))
    assert errors[0] < 0.95 * errors[1]


def test_an_even_print_stays_as_designed() -> None:
    places = field_of(pressed(60, seed=13)).table()
    change = np.linalg.norm(places.shift_px[:, 0] - PLAIN.places.shift_px[:, 0])
    assert change < 0.01 * np.linalg.norm(PLAIN.places.shift_px[:, 0])


def test_a_part_left_out_is_as_if_it_were_never_seen() -> None:
    samples = pressed(40, seed=14, uneven=hilly)
    seen, parts, contacts = compared(samples)
    whole = StiffnessField(seen, parts, contacts, PLAIN.places, PLAIN.noise)
    expected = field_of_some(seen, parts, contacts, ~parts[2].rows).shift_px
    change = np.abs(expected - PLAIN.places.shift_px).max()
    off = np.abs(whole.table(without_fold=2).shift_px - expected).max()
    assert off < 1e-3 * change
    assert np.abs(whole.table().shift_px - expected).max() > 0.05 * change


def test_where_the_wall_stiffens_less_is_in_the_field() -> None:
    """All powers of the force change by the same share of theirs along the first."""
    places = field_of(pressed(60, seed=15, uneven=hilly)).table()
    change = places.shift_px - PLAIN.places.shift_px
    first = PLAIN.places.shift_px[:, 0]
    softer = np.einsum("pn,pn->p", PLAIN.places.shift_px[:, 1], first) / np.sum(first**2, axis=1)
    assert np.abs(softer).max() > 1e-3
    np.testing.assert_allclose(change[:, 1], softer[:, None] * change[:, 0], atol=1e-6)


def test_the_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = pressed(30, seed=16, uneven=hilly)
    seen, parts, contacts = compared(samples)
    none = np.zeros(0, dtype=np.int64)
    nobody = KnownContacts(row=none, touch=none, point_mm=np.zeros((0, 3)), linear_N=np.zeros(0))
    nothing = StiffnessField(seen, parts, nobody, PLAIN.places, PLAIN.noise)
    assert (nothing.table().shift_px == PLAIN.places.shift_px).all()
    dark = replace(seen, residual_px=np.full_like(seen.residual_px, np.nan))
    lost = StiffnessField(dark, parts, contacts, PLAIN.places, PLAIN.noise).table()
    np.testing.assert_allclose(lost.shift_px, PLAIN.places.shift_px, atol=1e-7)
    # A marker that was lost in some frames is estimated from the rest; others do not change.
    gone = seen.residual_px.copy()
    gone[:15, 3] = np.nan
    some = replace(seen, residual_px=gone)
    rows = StiffnessField(some, parts, contacts, PLAIN.places, PLAIN.noise).table().shift_px
    full = StiffnessField(seen, parts, contacts, PLAIN.places, PLAIN.noise).table().shift_px
    by_rest = field_of_some(seen, parts, contacts, np.arange(30) >= 15).shift_px
    change = np.abs(by_rest - PLAIN.places.shift_px)[:, :, 6:8].max()
    assert np.abs(rows - by_rest)[:, :, 6:8].max() < 1e-3 * change
    others = np.setdiff1d(np.arange(2 * N), [6, 7])
    np.testing.assert_allclose(rows[:, :, others], full[:, :, others], atol=1e-6)
    monkeypatch.setattr(stiffness_field, "SETTINGS", replace(SETTINGS, samples_max=10))
    few = [
        StiffnessField(seen, parts, contacts, PLAIN.places, PLAIN.noise).table() for _ in range(2)
    ]
    assert (few[0].shift_px == few[1].shift_px).all()
    assert not np.allclose(few[0].shift_px, full)


@pytest.mark.parametrize(
    ("count", "kept"), [(32, False), pytest.param(60, True, marks=pytest.mark.long)]
)
def test_with_few_samples_a_wrong_field_is_dropped(
    count: int, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scaled_by(40, monkeypatch)
    samples = pressed(count, seed=3, uneven=hilly)
    _, facts = calibrate_locator(LOCATOR, samples, np.arange(count), force_max_N=25.0)
    assert facts["uneven"]
    plain = StiffnessField.table

    def wrong(self: StiffnessField, *, without_fold: int | None = None) -> ResponseTable:
        table = plain(self, without_fold=without_fold)
        if not self.enabled:
            return table
        # Each left-out part is read a tenth too strong or too weak.
        factor = 1.0 if without_fold is None else 1.0 + 0.1 * (-1.0) ** without_fold
        return table.with_rows(np.float32(factor) * table.shift_px, pairs=None)

    monkeypatch.setattr(StiffnessField, "table", wrong)
    facts = calibrate_locator(LOCATOR, samples, np.arange(count), force_max_N=25.0)[1]
    assert facts["uneven"] == kept
    assert (facts["spread"] > 3.0) == kept
