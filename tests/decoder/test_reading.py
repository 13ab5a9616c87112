"""What an estimator that finds contacts itself finds in a frame, and what is sent."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import ContactDetection, LocatedContact
from phytac_decoder.estimation.estimators import ForceModel
from phytac_decoder.estimation.force_regions import Region
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline import frame_reading as reading_module
from phytac_decoder.pipeline.decode import FrameMeasurement, measure_frame
from phytac_decoder.pipeline.fault_detection import FaultSettings
from phytac_decoder.pipeline.frame_reading import Reading, read
from phytac_decoder.serving.csv_recording import Recorder
from phytac_decoder.serving.wire_protocol import MessageBuilder, json_bytes
from phytac_design.layout.marker_layout import make_markers
from phytac_design.stages.build import BuildResult
from tests.decoder.toy_sensor import toy_bundle
from tests.designs import small

COUNT = 30


def located(force_N: float, point_mm: tuple[float, float, float], *markers: int) -> LocatedContact:
    """A contact that shares its force evenly among its switches."""
    on = np.array(markers, dtype=np.int64)
    return LocatedContact(
        markers=on,
        share=np.full(len(on), 1.0 / max(len(on), 1)),
        force_N=force_N,
        sd_N=0.05 * force_N,
        raw_N=force_N,
        raw_sd_N=0.0,
        point_mm=np.array(point_mm),
        radius_mm=4.0,
        sd_mm=np.full(2, 0.1),
        moments_mm2=np.zeros(3),
        signal_px=1.0,
    )


def reading(*contacts: LocatedContact) -> Reading:
    """Of these contacts."""
    found = ContactDetection(
        contacts=list(contacts), reduced_chi2=1.0, shift_px=np.zeros(2 * COUNT)
    )
    forces = found.receptor_forces_N(COUNT)
    return Reading(koi=np.flatnonzero(forces), forces_N=forces, found=found)


def messages() -> MessageBuilder:
    """A stream of a plane with two regions."""
    bundle = toy_bundle()
    left = Region(name="left", markers=(7, 8))
    right = Region(name="right", markers=(28, 29))
    return MessageBuilder(
        bundle=bundle,
        estimator="auto",
        regions=(left, right),
    )


def test_contacts_are_sent_as_they_were_found() -> None:
    """Between switches, with their own size and standard deviation; not as groups of switches."""
    # Neighbouring switches of two contacts, and one that tripped none beside marker 29.
    one, other = located(4.0, (11.0, 9.5, 0.1), 7), located(6.0, (21.0, 10.0, 0.0), 8)
    silent = located(1.0, (49.0, 40.5, 0.0))
    message = messages().frame(reading(one, other, silent), sequence=0, timestamp_s=0.0)
    assert [contact["force_N"] for contact in message["contacts"]] == [6.0, 4.0, 1.0]
    assert [contact["sd_N"] for contact in message["contacts"]] == [0.3, 0.2, 0.05]
    assert [contact["markers"] for contact in message["contacts"]] == [[8], [7], []]
    assert message["contacts"][1]["position_mm"] == [11.0, 9.5, 0.1]
    assert message["contacts"][1]["size_mm"] == 8.0
    assert [contact["region"] for contact in message["contacts"]] == ["left", "left", "right"]
    # What presses is summed whole; on switches there is but what presses on them.
    assert (message["koi"], message["forces_N"]) == ([7, 8], [4.0, 6.0])
    assert message["total_N"] == 11.0
    assert message["net_force_N"] == [0.0, 0.0, -11.0]
    assert [region["force_N"] for region in message["regions"]] == [10.0, 1.0]


def test_a_contact_without_a_switch_keeps_its_id() -> None:
    make, ids = messages(), []
    for k in range(5):
        silent = located(1.0 + 0.1 * k, (45.0 + 0.5 * k, 40.0, 0.0))
        message = make.frame(
            reading(located(3.0, (10.0, 10.0, 0.0), 7), silent), sequence=k, timestamp_s=0.01 * k
        )
        ids.append([contact["id"] for contact in message["contacts"]])
    assert ids == [[0, 1]] * 5


@pytest.mark.parametrize(
    "changes",
    [
        {"force_N": 1e9},
        {"force_N": np.nan},
        {"sd_N": np.nan},
        {"radius_mm": np.inf},
        {"point_mm": np.array([np.nan, 0.0, 0.0])},
    ],
)
def test_contacts_that_are_not_finite_are_left_out(changes: dict[str, Any]) -> None:
    wild = replace(located(1.0, (49.0, 40.5, 0.0)), **changes)
    message = messages().frame(
        reading(located(3.0, (10.0, 10.0, 0.0), 7), wild), sequence=0, timestamp_s=0.0
    )
    assert len(message["contacts"]) == 1
    assert message["total_N"] == 3.0
    assert b"NaN" not in json_bytes(message)


def test_recordings_hold_standard_deviations_where_there_are_any(tmp_path: Path) -> None:
    make = messages()
    grouped = replace(reading(located(2.0, (10.0, 10.0, 0.0), 7)), found=None)
    with Recorder(tmp_path / "r.csv") as rows:
        for k, each in enumerate((reading(located(2.0, (10.0, 10.0, 0.0), 7)), grouped)):
            rows.add(make.frame(each, sequence=k, timestamp_s=float(k)))
    table = list(csv.DictReader((tmp_path / "r.csv").read_text().splitlines()))
    assert [row["sd_N"] for row in table] == ["0.1", ""]


@pytest.fixture
def pressed(built: BuildResult) -> tuple[Bundle, FrameMeasurement]:
    """A sensor's decoder and one of its frames."""
    bundle = load_bundle(built.out / "decoder")
    return bundle, measure_frame(bundle, read_image(built.out / "views" / "frame_pressed.png"))


def test_a_frame_is_fitted_once(
    pressed: tuple[Bundle, FrameMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle, measured = pressed
    # A switch that is not read: fault detection uses what contacts explain.
    measured = replace(measured, koi=measured.koi[1:])
    whole, calls = ForceModel.contacts, []

    def counted(model: ForceModel, *words: Any, **more: Any) -> ContactDetection:
        calls.append(words)
        return whole(model, *words, **more)

    monkeypatch.setattr(ForceModel, "contacts", counted)
    monkeypatch.setattr(
        "phytac_decoder.pipeline.fault_detection.SETTINGS", FaultSettings(excused_max=1000)
    )
    got = read(bundle, measured, "auto")
    assert len(calls) == 1
    assert got.found
    assert got.forces_N.sum() == pytest.approx(
        sum(contact.force_N for contact in got.found.contacts if len(contact.markers))
    )
    assert measured.forces_N(bundle, "auto") == pytest.approx(got.forces_N)
    assert got.warnings == measured.warnings(
        bundle, got.forces_N, estimator="auto", found=got.found
    )


def test_a_result_that_cannot_be_is_not_delivered(
    pressed: tuple[Bundle, FrameMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle, measured = pressed
    assert read(bundle, measured, "auto").valid
    monkeypatch.setattr(reading_module, "implausible", lambda *_: ["a contact of 300 N"])
    got = read(bundle, measured, "auto")
    assert (got.valid, got.code, got.forces_N.size) == (False, "result-implausible", 0)
    assert "a contact of 300 N" in got.warnings[0]
    sent = MessageBuilder(bundle=bundle, estimator="auto").frame(got, sequence=0, timestamp_s=0.0)
    assert (sent["valid"], sent["total_N"], sent["contacts"]) == (False, 0.0, [])


@pytest.mark.parametrize("estimator", ["auto", "koi_inverse"])
def test_a_camera_that_moved_too_far_is_not_read(
    pressed: tuple[Bundle, FrameMeasurement], estimator: str
) -> None:
    bundle, measured = pressed
    far = replace(measured, shift_px=measured.shift_px + np.array([12.0, 5.0]))
    got = read(bundle, far, estimator)
    assert (got.valid, got.code) == (False, "rest-frame-outdated")


def test_forces_on_unreadable_switches_are_sent(
    pressed: tuple[Bundle, FrameMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle, measured = pressed
    unread = int(np.setdiff1d(np.arange(len(measured.found)), measured.koi)[0])
    contact = located(5.0, tuple(bundle.position_mm[unread]), unread)
    found = ContactDetection(
        contacts=[contact], reduced_chi2=1.0, shift_px=np.zeros(2 * len(measured.found))
    )
    monkeypatch.setattr(ForceModel, "contacts", lambda *_, **__: found)
    # The contact is made up, so that the frame's own motion contradicts it.
    monkeypatch.setattr(reading_module, "implausible", lambda *_: [])
    got = reading_module.read(bundle, measured, "auto")
    assert unread in got.koi
    sent = MessageBuilder(bundle=bundle, estimator="auto").frame(got, sequence=0, timestamp_s=0.0)
    assert dict(zip(sent["koi"], sent["forces_N"], strict=True))[unread] == 5.0
    assert sent["total_N"] == 5.0


def test_a_contact_that_unreadable_switches_may_hide_is_named(
    pressed: tuple[Bundle, FrameMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle, measured = pressed
    found = ContactDetection(
        contacts=[], reduced_chi2=1.0, shift_px=np.zeros(2 * len(measured.found)), hidden_N=3.14
    )
    for each, named in ((found, True), (replace(found, hidden_N=0.0), False)):
        monkeypatch.setattr(ForceModel, "contacts", lambda *_, each=each, **__: each)
        warnings = reading_module.read(bundle, measured, "auto").warnings
        assert any("contact of 3.1 N may be missing" in text for text in warnings) == named


def test_an_unreadable_switch_without_force_is_not_on(
    pressed: tuple[Bundle, FrameMeasurement], monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle, measured = pressed
    # The marker that is farthest from all that is pressed, away from the rims.
    place = bundle.position_mm
    apart = np.linalg.norm(place[:, None] - place[measured.koi], axis=2).min(axis=1)
    inner = np.abs(place[:, 2] - 30.0) < 15.0
    seems_on = int(np.argmax(apart * inner))
    measured = replace(measured, koi=np.union1d(measured.koi, [seems_on]))
    readable = read(bundle, measured, "auto")
    assert seems_on in readable.koi
    assert any("show no force" in text for text in readable.warnings)
    red = bundle.tips.red_rest_px.copy()
    red[seems_on] = bundle.tips.red_on_px[seems_on]
    bundle = replace(bundle, tips=replace(bundle.tips, red_rest_px=red))
    locator = replace(bundle.model.locator, blind=np.array([seems_on]))
    bundle = replace(bundle, model=replace(bundle.model, locator=locator))
    got = read(bundle, measured, "auto")
    assert seems_on not in got.koi
    assert not any("show no force" in text for text in got.warnings)
    assert any("a weak press there may be missing" in text for text in got.warnings)


def test_the_net_force_acts_along_the_surfaces_normals(
    pressed: tuple[Bundle, FrameMeasurement], built: BuildResult
) -> None:
    """With the bundle alone: a stream has no design beside it."""
    bundle, measured = pressed
    surface = small().surface()
    normal = make_markers(small(), surface).normal
    make = MessageBuilder(bundle=bundle, estimator="koi_inverse")
    got = read(bundle, measured, "koi_inverse")
    sent = make.frame(got, sequence=0, timestamp_s=0.0)
    net = -(got.forces_N @ normal)
    assert np.linalg.norm(net) > 1.0
    assert sent["net_force_N"] == pytest.approx(net, abs=1e-3)
    moment = np.cross(bundle.position_mm, -got.forces_N[:, None] * normal).sum(axis=0)
    assert sent["net_moment_Nmm"] == pytest.approx(moment, abs=0.1)
    # Without tables normals are fitted through the markers.
    plain = replace(bundle, model=replace(bundle.model, locator=None))
    fitted = MessageBuilder(bundle=plain, estimator="koi_inverse").outward
    assert np.sum(fitted * normal, axis=1).min() > np.cos(np.radians(3.0))


def test_other_estimators_leave_grouping_to_the_stream(
    pressed: tuple[Bundle, FrameMeasurement],
) -> None:
    bundle, measured = pressed
    got = read(bundle, measured, "koi_inverse")
    assert got.found is None
    assert got.koi.tolist() == measured.koi.tolist()
    sent = MessageBuilder(bundle=bundle, estimator="koi_inverse").frame(
        got, sequence=0, timestamp_s=0.0
    )
    assert sent["contacts"]
    assert all("sd_N" not in contact for contact in sent["contacts"])
