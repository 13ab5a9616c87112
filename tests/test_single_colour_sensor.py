"""A sensor of white dots without switches, from its design file to forces from rendered frames."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_decoder.pipeline.decode import measure_frame
from phytac_decoder.pipeline.frame_reading import read
from phytac_decoder.serving.sensor_loop import check_estimator
from phytac_design.design.spec import Design
from phytac_design.optics.separability import check_paints
from phytac_design.rules.check import check_design
from phytac_design.simulation.dataset import decode_points
from phytac_design.stages.build import build
from phytac_shapes.arrays import FloatArray, IntArray
from tests.designs import COARSE, of_shape
from tests.places_alone import places_alone
from tests.refusals import refused

SHAPE = {"diameter_outer_mm": 50.0, "length_mm": 50.0}
ACCURACY = replace(COARSE, refine=3, place_share=1.0, step=False)
"""One contact is decoded in one frame."""
LAYOUT = {"kind": "straight", "rows": 4, "columns": 10, "height_far_mm": 5.0}


def dots(paint: str = "white", **tables: Any) -> Design:
    layout = LAYOUT | {"colours": [paint]}
    solid = {"diameter_outer_mm": 2.4, "diameter_hole_mm": 0.0}
    training = {"samples": 30, "samples_test": 10, "multi_contact": 0.0, "force_min_N": 4.0}
    given: dict[str, Any] = {"receptor": solid, "training": training} | tables
    return of_shape("cylinder", SHAPE, layout, **given)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dots") / "x"
    with places_alone():
        build(dots(), out, accuracy=ACCURACY, only=["report"], progress=lambda _: None)
    return out


def test_a_build_leaves_switches_and_molds_out_and_says_what_that_costs(built: Path) -> None:
    report = json.loads((built / "report" / "report.json").read_text())
    assert report["switch"]["switches"] == []
    assert "no switches" in report["switch"]["absent"]
    assert not report["forced"]
    assert "switch_unreadable" not in report["visibility"]
    assert any("markers' motion alone" in text for text in report["limits"])
    # No hole goes through the wall: the shell is a tube.
    assert report["shell"]["genus"] == 1
    assert not (built / "mold").exists()


def test_contacts_are_found_without_switches(built: Path) -> None:
    bundle = load_bundle(built / "decoder")
    assert bundle.model.estimators == ("auto",)
    with refused("estimator-unknown"):
        check_estimator(bundle, "koi_inverse")
    views = built / "views"
    rest, pressed = (read_image(views / f"frame_{name}.png") for name in ("rest", "pressed"))
    lit = calibrate_rest(bundle, rest)
    still = read(lit, measure_frame(lit, rest), "auto")
    assert still.valid
    assert not still.forces_N.any()
    truth = sum(json.loads((views / "frame_pressed.json").read_text()).values())
    reading = read(lit, measure_frame(lit, pressed), "auto")
    assert reading.valid, reading.warnings
    assert not reading.warnings
    assert reading.found is not None
    (contact,) = reading.found.contacts
    assert contact.force_N == pytest.approx(truth, rel=0.25)
    assert reading.forces_N.sum() == pytest.approx(contact.force_N)


@pytest.mark.parametrize("paint", ["white", "black"])
def test_dots_pass_every_rule(paint: str) -> None:
    assert check_design(dots(paint)).markers.count == 40
    assert check_paints(dots(paint)).summary()["min_floor_sigmas"] > 5.0


def test_dots_that_brightness_cannot_show_are_refused() -> None:
    with refused("field-invalid"):
        dots(receptor={"diameter_hole_mm": 1.4})
    mixed = LAYOUT | {"colours": ["white", "blue"]}
    with refused("field-invalid"):
        of_shape("cylinder", SHAPE, mixed, receptor={"diameter_hole_mm": 0.0})
    with refused("paint-like-resin"):
        check_paints(dots(camera={"noise_pixel": 40.0}))


def test_as_many_contacts_as_can_be_found_are_doubtful(built: Path) -> None:
    """Without switches there may be more, which the found ones stand for."""
    bundle = load_bundle(built / "decoder")
    measured = measure_frame(bundle, read_image(built / "views" / "frame_pressed.png"))
    reading = read(bundle, measured, "auto")
    assert reading.found is not None
    four = replace(reading.found, contacts=reading.found.contacts * 4)
    (text,) = measured.warnings(bundle, reading.forces_N, found=four)
    assert "4 contacts are the most" in text


def test_forces_are_compared_with_the_inverse_on_the_same_receptors(
    built: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With no switch on, the inverse that a result is checked by would be nothing."""
    sums: list[float] = []

    def recorded(bundle: Bundle, found: object, inverse_N: FloatArray) -> list[str]:
        sums.append(float(inverse_N.sum()))
        return []

    monkeypatch.setattr("phytac_decoder.pipeline.frame_reading.implausible", recorded)
    bundle = load_bundle(built / "decoder")
    pressed = measure_frame(bundle, read_image(built / "views" / "frame_pressed.png"))
    reading = read(bundle, pressed, "auto")
    assert sums == [pytest.approx(reading.forces_N.sum(), rel=0.5)]


def test_simulated_switches_are_not_read_where_there_are_none() -> None:
    def forces(_estimator: str, _shift: FloatArray, koi: IntArray) -> FloatArray:
        return np.full(3, float(len(koi)))

    model: Any = SimpleNamespace(without_switches=True, forces=forces)
    on = SimpleNamespace(bits=np.ones((2, 3), dtype=bool))
    data: Any = SimpleNamespace(shift_px=np.zeros((2, 3, 2)), switching=on)
    assert not decode_points(model, data, "auto").any()
    model.without_switches = False
    assert decode_points(model, data, "auto").all()
