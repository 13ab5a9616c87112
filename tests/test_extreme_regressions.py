"""Regressions: faults that the verification cases once found."""

import json
from pathlib import Path

import numpy as np
import pytest

from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_decoder.serving.wire_protocol import MessageSplitter
from phytac_design.design.camera_files import read_lens
from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.positions import read_positions
from phytac_design.mechanics.calibration.measurements import read_measurements
from phytac_shapes import Grip
from phytac_shapes.errors import DesignError
from tests.refusals import refused
from verification.designs import base, changed, design_of
from verification.shells import ring_case
from verification.switch_cases import inflated_sphere
from verification.test_readers import bundle


def test_the_flat_map_of_a_jagged_grip_keeps_areas() -> None:
    saw = Grip(diameters_mm=tuple(40.0 + 0.2 * (-1.0) ** k for k in range(64)), length_mm=120.0)
    u, step = np.linspace(1.0, 119.0, 397), 1e-4
    slope = (saw.arc_length_mm(u + step) - saw.arc_length_mm(u - step)) / (2.0 * step)
    speed = np.linalg.norm(saw.curve(u)[1], axis=1)
    # At knots, where the third derivative jumps, a difference is a little off by itself.
    assert np.quantile(np.abs(slope / speed - 1.0), 0.9) < 1e-7


@pytest.mark.parametrize(
    ("table", "field", "value", "says"),
    [
        ("print_rules", "wall_min_mm", 10**400, "wall_min_mm: input should be"),
        ("camera", "stand_off_mm", 1e300, "at most 1e6, or 'fit'"),
        ("camera", "focal_px", "x" * 10_000, "…"),
    ],
    ids=["digits", "distance", "letters"],
)
def test_absurd_values_are_rejected_in_few_words(
    table: str, field: str, value: object, says: str
) -> None:
    with pytest.raises(DesignError) as caught:
        parse_design(changed(base("cylinder"), {table: {field: value}}), "extreme")
    assert says in str(caught.value)
    assert len(str(caught.value)) < 400


def test_lists_nested_too_deeply_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "deep.toml"
    path.write_text("[layout]\npositions = " + 2000 * "[" + 2000 * "]")
    with refused("toml-syntax"):
        load_design(str(path))
    lens = tmp_path / "deep.yaml"
    lens.write_text("a: " + 5000 * "[" + 5000 * "]")
    with refused("lens-file-invalid"):
        read_lens(lens)


@pytest.mark.parametrize("load", [1e-200, 1e200])
def test_loads_of_any_size_are_pure_scales(load: float) -> None:
    one, other = ring_case(8), ring_case(8, load=load)
    size = float(np.abs(one.motion()).max())
    np.testing.assert_allclose(other.motion() / load, one.motion(), atol=1e-11 * size)


def test_what_is_not_finite_is_named() -> None:
    case = ring_case(8)
    loads = case.loads.reshape(-1, 1).copy()
    loads[13] = np.inf
    with refused("load-not-finite") as caught:
        case.model().solve(loads)
    caught.match("node 2")


def test_a_solid_can_be_moved_by_next_to_nothing() -> None:
    found = inflated_sphere(1.0001)
    assert found.value == pytest.approx(found.exact, rel=0.01)


@pytest.mark.parametrize(
    ("field", "value", "code"),
    [
        ("networks", [], "bundle-invalid"),
        ("cameras", None, "bundle-invalid"),
        ("threshold_N", 10**400, "bundle-invalid"),
        ("noise_centroid_px", -1.0, "bundle-invalid"),
        ("force_max_N", float("nan"), "bundle-unreadable"),
    ],
    ids=["list", "null", "digits", "negative", "nan"],
)
def test_bundles_with_values_of_another_kind_are_refused(
    tmp_path: Path, field: str, value: object, code: str
) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), field: value}))
    with refused(code) as caught:
        load_bundle(tmp_path)
    assert "rebuild the decoder" in str(caught.value)


def test_a_quote_that_is_not_closed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text('u,v\n1.0,"2.0\n3.0,4.0\n')
    with refused("positions-file-invalid"):
        read_positions(path)
    design = design_of({"shape": "cylinder"})
    surface = design.surface()
    from phytac_design.layout import make_markers

    with refused("file-not-csv"):
        read_measurements(path, surface, make_markers(design, surface), wall_mm=0.8)


def test_garbled_streams_say_what_to_do() -> None:
    with refused("message-invalid"):
        MessageSplitter("lines").feed(b"\xff\xfe\n")
