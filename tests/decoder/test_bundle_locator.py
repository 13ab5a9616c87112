"""The estimator ``auto`` in a bundle: kept whole, and refused where it is damaged."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from phytac_decoder.estimation.contact_fit import ContactPrior, MarkerNoise, ShiftNoise
from phytac_decoder.estimation.force_correction import ForceCorrection
from phytac_decoder.estimation.locator import ContactLocator
from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_decoder.mechanics.interaction_table import InteractionTable
from phytac_decoder.mechanics.membrane_stretching import BergerWall
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_decoder.vision.segmentation import ColourModel
from tests.decoder.toy_sensor import toy_bundle
from tests.refusals import refused


def bundle() -> Bundle:
    plain = toy_bundle()
    count = len(plain.colour)
    rng = np.random.default_rng(0)
    points = plain.position_mm
    ones = np.ones((len(points), 1))
    both_ways = rng.normal(size=(9, 9, 4))
    locator = ContactLocator(
        places=ResponseTable(
            point_mm=points,
            along=ones * [1.0, 0.0, 0.0],
            around=ones * [0.0, 1.0, 0.0],
            shift_px=rng.normal(size=(len(points), 3, 2 * count)).astype(np.float32),
            radius_mm=4.0,
            pairs=InteractionTable(
                grid=ResponseTable(
                    point_mm=points[:9],
                    along=ones[:9] * [0.0, 1.0, 0.0],
                    around=ones[:9] * [-1.0, 0.0, 0.0],
                    shift_px=1e-3 * (both_ways + both_ways.swapaxes(0, 1)).astype(np.float32),
                    radius_mm=4.0,
                ),
                axes_px=rng.normal(size=(4, 2 * count)).astype(np.float32),
            ),
            walls=BergerWall(
                wall=np.arange(len(points)) % 3 - 1,
                slopes=0.01 * rng.normal(size=(len(points), 2, 5)).astype(np.float32),
                most=0.8,
            ),
        ),
        position_mm=points,
        neighbours=plain.model.neighbours,
        footprint_mm=2.0,
        threshold_N=plain.threshold_N,
        prior=ContactPrior(
            place_mm=1.0, moments_mm2=(0.1, 0.2, 0.3), moments_sd_mm2=(1.0, 2.0, 3.0)
        ),
        noise=ShiftNoise(
            centroid_px=0.05,
            share=0.01,
            switched_px=0.4,
            markers=MarkerNoise(
                still_px=rng.uniform(0.02, 0.1, 2 * count),
                moved_px=rng.uniform(0.0, 0.1, 2 * count),
            ),
            fitted=True,
        ),
        correction=ForceCorrection(
            centre=rng.normal(size=(7, 5)),
            weight=rng.normal(size=7),
            low_mm=points.min(axis=0),
            size_mm=50.0,
            force_max_N=25.0,
            spread=1.5,
            spread_share=0.02,
            lengths=(0.5, 1.2, 0.33),
        ),
    )
    return replace(plain, model=replace(plain.model, locator=locator))


def test_bundle_keeps_how_switches_turn_on(tmp_path: Path) -> None:
    plain = bundle()
    assert plain.model.locator is not None
    count = len(plain.threshold_N)
    locator = replace(plain.model.locator, threshold_sd=np.linspace(0.1, 0.3, count))
    gradual = np.arange(count) % 2 == 0
    tips = replace(plain.tips, gradual=gradual)
    save_bundle(replace(plain, tips=tips, model=replace(plain.model, locator=locator)), tmp_path)
    loaded = load_bundle(tmp_path)
    assert loaded.tips.gradual is not None
    assert loaded.tips.gradual.tolist() == gradual.tolist()
    assert loaded.model.locator is not None
    np.testing.assert_array_equal(loaded.model.locator.threshold_sd, locator.threshold_sd)
    save_bundle(plain, tmp_path / "snapping")
    old = load_bundle(tmp_path / "snapping")
    assert old.tips.gradual is None
    assert old.model.locator is not None
    assert old.model.locator.threshold_sd is None
    path = tmp_path / "bundle.safetensors"
    save_file(load_file(path) | {"threshold_sd": np.zeros(count)}, path)
    with refused("bundle-threshold-sd-invalid"):
        load_bundle(tmp_path)


def test_bundle_keeps_it_whole(tmp_path: Path) -> None:
    saved = bundle()
    save_bundle(saved, tmp_path)
    loaded = load_bundle(tmp_path).model
    assert loaded.estimators[-1] == "auto"
    assert loaded.best == "auto"
    assert loaded.locator is not None
    assert saved.model.locator is not None
    one, two = saved.model.locator, loaded.locator
    assert (one.prior, one.footprint_mm) == (two.prior, two.footprint_mm)
    assert replace(one.noise, markers=None) == replace(two.noise, markers=None)
    assert one.noise.markers is not None
    assert two.noise.markers is not None
    np.testing.assert_array_equal(one.noise.markers.still_px, two.noise.markers.still_px)
    np.testing.assert_array_equal(one.noise.markers.moved_px, two.noise.markers.moved_px)
    assert one.correction is not None
    assert two.correction is not None
    for name in ("centre", "weight", "low_mm", "size_mm", "force_max_N", "spread", "spread_share"):
        np.testing.assert_array_equal(getattr(one.correction, name), getattr(two.correction, name))
    for name in ("point_mm", "along", "around", "shift_px", "radius_mm"):
        np.testing.assert_array_equal(getattr(one.places, name), getattr(two.places, name))
        assert one.places.pairs is not None
        assert two.places.pairs is not None
        own, kept = one.places.pairs.grid, two.places.pairs.grid
        np.testing.assert_array_equal(getattr(own, name), getattr(kept, name))
        np.testing.assert_array_equal(one.places.pairs.axes_px, two.places.pairs.axes_px)
    assert one.places.walls is not None
    assert two.places.walls is not None
    np.testing.assert_array_equal(one.places.walls.wall, two.places.walls.wall)
    np.testing.assert_array_equal(one.places.walls.slopes, two.places.walls.slopes)
    assert (two.places.walls.most, two.places.orders) == (0.8, 2)
    shift = np.random.default_rng(1).normal(size=(30, 2))
    koi = np.array([7, 8, 20])
    np.testing.assert_array_equal(
        saved.with_mount().model.forces("auto", shift, koi), loaded.forces("auto", shift, koi)
    )


def test_a_fitted_modulus_is_kept(tmp_path: Path) -> None:
    plain = bundle()
    for folder in (tmp_path, tmp_path / "kept"):
        save_bundle(replace(plain, model=replace(plain.model, modulus=1.3)), folder)
    assert load_bundle(tmp_path).model.modulus == 1.3
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    path.write_text(json.dumps(meta | {"modulus": 0.0}))
    with refused("bundle-invalid"):
        load_bundle(tmp_path)
    del meta["modulus"]
    path.write_text(json.dumps(meta))
    # Up to schema 1.20 networks and columns were learnt without large displacements.
    old = load_bundle(tmp_path)
    assert load_bundle(tmp_path / "kept").model.large_displacements is not None
    assert old.model.large_displacements is None
    save_bundle(old, tmp_path / "again")
    assert load_bundle(tmp_path / "again").model.modulus is None


def test_linear_tables_are_a_limit(tmp_path: Path) -> None:
    saved = bundle()
    locator = saved.model.locator
    assert locator is not None
    known = locator.correction
    assert known is not None
    for error, fitted, words in (
        (0.844, None, "up to 84 % off at 25 N and less at smaller forces; the intervals"),
        (0.844, None, "build with --accuracy standard"),
        (1.5, None, "more than 100 % off at 25 N"),
        (0.04, None, ""),
        (0.844, False, ""),
        (0.844, True, "simulated with --displacement auto"),
    ):
        own = replace(
            locator,
            linear_error=error,
            correction=None if fitted is None else replace(known, linear=fitted),
            prior=replace(locator.prior, force_N=25.0),
        )
        save_bundle(replace(saved, model=replace(saved.model, locator=own)), tmp_path)
        loaded = load_bundle(tmp_path)
        assert loaded.model.locator is not None
        assert loaded.model.locator.linear_error == error
        found = [text for text in loaded.limits() if text.startswith("linear-tables: ")]
        assert len(found) == bool(words)
        assert all(words in text for text in found)


def test_edges_of_markers_count_as_they_were_saved(tmp_path: Path) -> None:
    bundle = toy_bundle()
    save_bundle(replace(bundle, colours=replace(bundle.colours, edge=0.2)), tmp_path)
    assert load_bundle(tmp_path).colours.edge == 0.2
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    del meta["colours"]["edge"]
    path.write_text(json.dumps(meta))
    assert load_bundle(tmp_path).colours.edge == ColourModel.edge


def test_corrections_reach_as_far_as_they_did_in_older_bundles(tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    assert meta["auto"]["learnt"].pop("lengths") == [0.5, 1.2, 0.33]
    path.write_text(json.dumps(meta))
    locator = load_bundle(tmp_path).model.locator
    assert locator is not None
    assert locator.correction is not None
    assert locator.correction.lengths == (0.33, 0.33, 0.33)


def test_tables_of_pairs_of_older_bundles_are_passed_over(tmp_path: Path) -> None:
    """Up to schema 1.9 they held what a fit without them takes for force."""
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.safetensors"
    arrays = {name: value.copy() for name, value in load_file(path).items()}
    del arrays["places.pair_axes_px"], arrays["places.pair_triangle"]
    arrays["places.pair_rows"] = np.zeros((9, 4, 9), dtype=np.float32)
    save_file(arrays, path)
    meta = json.loads((tmp_path / "bundle.json").read_text())
    del meta["arrays_sha256"]
    (tmp_path / "bundle.json").write_text(json.dumps(meta))
    locator = load_bundle(tmp_path).model.locator
    assert locator is not None
    assert locator.places.pairs is None
    assert locator.places.walls is not None


def test_pairs_of_older_bundles_were_stored_both_ways(tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    wanted = load_bundle(tmp_path).model.locator
    path = tmp_path / "bundle.safetensors"
    arrays = {name: value.copy() for name, value in load_file(path).items()}
    assert wanted is not None
    assert wanted.places.pairs is not None
    rows = wanted.places.pairs.grid.shift_px
    assert arrays.pop("places.pair_triangle").shape == (45, 4)
    save_file(arrays | {"places.pair_coordinates": rows}, path)
    meta = json.loads((tmp_path / "bundle.json").read_text())
    del meta["arrays_sha256"]
    (tmp_path / "bundle.json").write_text(json.dumps(meta | {"schema_version": "1.22"}))
    old = load_bundle(tmp_path).model.locator
    assert old is not None
    assert old.places.pairs is not None
    np.testing.assert_array_equal(old.places.pairs.grid.shift_px, rows)


def test_bundle_without_it_raises(tmp_path: Path) -> None:
    save_bundle(toy_bundle(), tmp_path)
    model = load_bundle(tmp_path).model
    assert "auto" not in model.estimators
    assert model.best == "koi_inverse"
    with refused("response-tables-missing"):
        model.forces("auto", np.zeros((30, 2)), np.array([3]))


def _nan(arrays: dict[str, Any]) -> None:
    arrays["places.shift_px"][3, 1, 4] = np.nan


def _cut(arrays: dict[str, Any]) -> None:
    arrays["places.shift_px"] = np.ascontiguousarray(arrays["places.shift_px"][:, :, :-2])


def _double(arrays: dict[str, Any]) -> None:
    arrays["places.shift_px"] = arrays["places.shift_px"].astype(np.float64)


def _gone(arrays: dict[str, Any]) -> None:
    del arrays["places.along"]


def _unlearnt(arrays: dict[str, Any]) -> None:
    del arrays["places.weight"]


def _pairs_cut(arrays: dict[str, Any]) -> None:
    rows = arrays["places.pair_triangle"]
    arrays["places.pair_triangle"] = np.ascontiguousarray(rows[:, :-1])


def _pairs_fewer(arrays: dict[str, Any]) -> None:
    rows = arrays["places.pair_triangle"]
    arrays["places.pair_triangle"] = np.ascontiguousarray(rows[:-1])


def _pairs_nan(arrays: dict[str, Any]) -> None:
    arrays["places.pair_triangle"][3, 2] = np.nan


def _pairs_gone(arrays: dict[str, Any]) -> None:
    del arrays["places.pair_triangle"]


def _axes_gone(arrays: dict[str, Any]) -> None:
    del arrays["places.pair_axes_px"]


def _axes_cut(arrays: dict[str, Any]) -> None:
    axes = arrays["places.pair_axes_px"]
    arrays["places.pair_axes_px"] = np.ascontiguousarray(axes[:, :-2])


def _axes_one(arrays: dict[str, Any]) -> None:
    arrays["places.pair_axes_px"] = np.array(1.0, dtype=np.float32)


def _slopes_cut(arrays: dict[str, Any]) -> None:
    arrays["places.wall_slopes"] = np.ascontiguousarray(arrays["places.wall_slopes"][:-1])


def _slopes_of_more_powers(arrays: dict[str, Any]) -> None:
    arrays["places.wall_slopes"] = np.zeros((len(arrays["places.point_mm"]), 5, 2), np.float32)


def _slopes_flat(arrays: dict[str, Any]) -> None:
    arrays["places.wall_slopes"] = np.zeros(4, np.float32)


def test_noise_of_earlier_bundles(tmp_path: Path) -> None:
    """Up to schema 1.23 fitted noise was a ratio to the usual one, and predicted noise had its own
    names."""
    saved = bundle()
    save_bundle(saved, tmp_path)
    arrays = load_file(tmp_path / "bundle.safetensors")
    still = arrays.pop("places.noise_still_px")
    moved = arrays.pop("places.noise_moved_px")
    for old, wanted, fitted in (
        ({"ratio": still / 0.05}, (still, 0.0), True),
        ({"predicted_still_px": still, "predicted_moved_px": moved}, (still, moved), False),
        ({}, None, False),
    ):
        path = tmp_path / "bundle.json"
        facts = json.loads(path.read_text())
        facts["schema_version"] = "1.23"
        facts.pop("arrays_sha256", None)
        facts["auto"]["noise"].pop("fitted", None)
        path.write_text(json.dumps(facts))
        named = {f"places.noise_{name}": values for name, values in old.items()}
        save_file(arrays | named, tmp_path / "bundle.safetensors")
        locator = load_bundle(tmp_path).model.locator
        assert locator is not None
        assert locator.noise.fitted == fitted
        if wanted is None:
            assert locator.noise.markers is None
            continue
        assert locator.noise.markers is not None
        assert locator.noise.markers.still_px == pytest.approx(wanted[0])
        assert locator.noise.markers.moved_px == pytest.approx(wanted[1])


def _walls_gone(arrays: dict[str, Any]) -> None:
    del arrays["places.wall_number"]


def _walls_halved(arrays: dict[str, Any]) -> None:
    arrays["places.wall_number"] = arrays["places.wall_number"].astype(np.float64)


def _all_lost(arrays: dict[str, Any]) -> None:
    arrays["places.wall_most"][0] = 1.0


def _noise_cut(arrays: dict[str, Any]) -> None:
    arrays["places.noise_still_px"] = arrays["places.noise_still_px"][1:]


def _noise_none(arrays: dict[str, Any]) -> None:
    arrays["places.noise_still_px"][5] = 0.0


def _few(arrays: dict[str, Any]) -> None:
    for name in ("point_mm", "along", "around", "shift_px", "wall_number", "wall_slopes"):
        arrays[f"places.{name}"] = np.ascontiguousarray(arrays[f"places.{name}"][:2])


@pytest.mark.parametrize(
    ("damage", "code"),
    [
        (_nan, "bundle-not-finite"),
        (_cut, "bundle-array-shape"),
        (_double, "bundle-array-type"),
        (_gone, "bundle-array-missing"),
        (_unlearnt, "bundle-array-missing"),
        (_few, "bundle-array-shape"),
        (_noise_cut, "bundle-array-shape"),
        (_noise_none, "bundle-value-invalid"),
        (_pairs_cut, "bundle-array-shape"),
        (_pairs_fewer, "bundle-array-shape"),
        (_pairs_nan, "bundle-not-finite"),
        (_pairs_gone, "bundle-array-missing"),
        (_axes_gone, "bundle-array-missing"),
        (_axes_cut, "bundle-array-shape"),
        (_axes_one, "bundle-array-shape"),
        (_slopes_cut, "bundle-array-shape"),
        (_slopes_of_more_powers, "bundle-array-shape"),
        (_slopes_flat, "bundle-array-shape"),
        (_walls_gone, "bundle-array-missing"),
        (_walls_halved, "bundle-array-type"),
        (_all_lost, "bundle-value-invalid"),
    ],
)
def test_damaged_tables_are_rejected(
    damage: Callable[[dict[str, Any]], None], code: str, tmp_path: Path
) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.safetensors"
    arrays = {name: value.copy() for name, value in load_file(path).items()}
    damage(arrays)
    save_file(arrays, path)
    with refused(code):
        load_bundle(tmp_path)


@pytest.mark.parametrize(
    ("keys", "value", "code"),
    [
        (("prior", "place_mm"), 0.0, "bundle-invalid"),
        (("prior", "moments_sd_mm2"), [1.0, 2.0], "bundle-invalid"),
        (("noise", "centroid_px"), -1.0, "bundle-invalid"),
        (("learnt", "spread"), float("nan"), "bundle-unreadable"),
        (("learnt", "lengths"), [0.5, 1.0], "bundle-invalid"),
        (("learnt", "lengths"), [0.5, 0.0, 1.0], "bundle-invalid"),
        (("learnt", "lengths"), 0.5, "bundle-invalid"),
        (("radius_mm",), "wide", "bundle-invalid"),
        (("prior",), None, "bundle-invalid"),
    ],
)
def test_damaged_settings_are_rejected(
    keys: tuple[str, ...], value: object, code: str, tmp_path: Path
) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.json"
    meta = json.loads(path.read_text())
    table = meta["auto"]
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value
    path.write_text(json.dumps(meta))
    with refused(code):
        load_bundle(tmp_path)


def test_forces_in_another_unit_are_a_limit(tmp_path: Path) -> None:
    saved = bundle()
    locator = saved.model.locator
    assert locator is not None
    assert locator.correction is not None
    usual = ((1.0, False), (2.5, False), (0.4, False))
    for stiffness, named in (*usual, (1.0 / 9.81, True), (102.0, True)):
        own = replace(locator, correction=replace(locator.correction, stiffness=stiffness))
        save_bundle(replace(saved, model=replace(saved.model, locator=own)), tmp_path)
        words = [text for text in load_bundle(tmp_path).limits() if "stiffness-unlikely" in text]
        assert len(words) == named
        assert all(f"{stiffness:.2g} times as stiff" in text for text in words)
