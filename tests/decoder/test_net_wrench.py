"""Normals of contacts, and net force and moment of a frame, on a plane and a cylinder."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.contact_estimates import LocatedContact
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.csv_recording import Recorder
from phytac_decoder.serving.wire_protocol import MessageBuilder, json_bytes
from phytac_shapes.arrays import FloatArray
from tests.decoder.flat_sensor import flat_locator, flat_places
from tests.decoder.toy_sensor import toy_bundle
from tests.made_up import at, found_of
from tests.refusals import refused

COUNT, RADIUS_mm = 30, 30.0


def on_cylinder(angle_deg: FloatArray, z_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (m, 3) of a cylinder about the z axis, and its outward normals (m, 3)."""
    angle = np.radians(angle_deg)
    normal = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    return RADIUS_mm * normal + np.outer(z_mm, [0.0, 0.0, 1.0]), normal


def cylinder_places() -> ResponseTable:
    """Places 3 mm apart; their tangents along the axis and around it."""
    angle, z = (one.ravel() for one in np.meshgrid(np.arange(0, 360, 6.0), np.arange(0, 61, 3.0)))
    point, normal = on_cylinder(angle, z)
    along = np.tile([0.0, 0.0, 1.0], (len(point), 1))
    return ResponseTable(
        point_mm=point,
        along=along,
        around=np.cross(normal, along),
        shift_px=np.zeros((len(point), 1, 2 * COUNT), dtype=np.float32),
        radius_mm=5.0,
    )


def with_places(places: ResponseTable) -> Bundle:
    """The toy sensor with a surface of its own for ``auto``."""
    plain = toy_bundle()
    locator = replace(flat_locator(), places=places)
    return replace(plain, model=replace(plain.model, locator=locator))


def stream(places: ResponseTable, about_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    """A message of contacts on these places, with moments about a point."""
    make = MessageBuilder(bundle=with_places(places), estimator="auto", moment_about_mm=about_mm)

    def message(*contacts: LocatedContact) -> dict[str, Any]:
        found = found_of(*contacts, shift_px=np.zeros(2 * COUNT))
        nothing = Reading(koi=np.zeros(0, dtype=np.int64), forces_N=np.zeros(COUNT), found=found)
        return make.frame(nothing, sequence=0, timestamp_s=0.0)

    return message


def press(
    point_mm: Any,
    force_N: float,
    *,
    sd_mm: tuple[float, float] = (0.0, 0.0),
    sd_N: float = 0.0,
    shear_N: Any = None,
    covariance_N2: Any = 0.0,
) -> LocatedContact:
    """A contact without a switch; its force along the surface is observed where it is given."""
    one = replace(at(np.array(point_mm), [], force_N, sd_N), sd_mm=np.array(sd_mm))
    if shear_N is None:
        return one
    covariance = np.zeros((3, 3)) + covariance_N2
    return replace(one, shear_N=np.array(shear_N), shear_covariance_N2=covariance, shear_share=0.1)


def bent_toy() -> Bundle:
    """The toy sensor's markers on the cylinder, without tables: 12 degrees and 6 mm apart."""
    row, column = np.divmod(np.arange(COUNT), 6)
    point, _ = on_cylinder(12.0 * column, 6.0 * row)
    return replace(toy_bundle(), position_mm=point)


def test_normals_of_contacts_are_the_surfaces() -> None:
    angles, z = np.array([31.0, 200.0]), np.array([22.0, 40.5])
    points, wanted = on_cylinder(angles, z)
    contacts = stream(cylinder_places())(press(points[0], 3.0), press(points[1], 2.0))["contacts"]
    np.testing.assert_allclose([each["normal"] for each in contacts], wanted, atol=1e-4)
    flat = stream(flat_places())(press([20.0, 30.0, 0.0], 3.0))["contacts"]
    assert flat[0]["normal"] == [0.0, 0.0, 1.0]


def test_without_tables_normals_are_those_of_quadrics_away_from_the_camera() -> None:
    bundle = bent_toy()
    make = MessageBuilder(bundle=bundle, estimator="koi_inverse")
    point, wanted = on_cylinder(np.array([0.0, 28.0, 60.0]), np.array([0.0, 11.0, 24.0]))
    # Between markers, and at two corners.
    np.testing.assert_allclose(make.normals(point), wanted, atol=0.02)
    (camera,) = bundle.cameras
    outside = replace(camera, position_mm=np.array([100.0, 60.0, 10.0]))
    turned = MessageBuilder(bundle=replace(bundle, cameras=(outside,)), estimator="koi_inverse")
    np.testing.assert_allclose(turned.normals(point), -wanted, atol=0.02)


def test_forces_on_receptors_have_a_net_force_and_moment() -> None:
    bundle, forces = bent_toy(), np.zeros(COUNT)
    # At 24 degrees and 12 mm, and 48 degrees and 18 mm.
    forces[[14, 22]] = (3.0, 2.0)
    make = MessageBuilder(bundle=bundle, estimator="koi_inverse")
    sent = make.frame(Reading(koi=np.array([14, 22]), forces_N=forces), sequence=0, timestamp_s=0.0)
    a, b = np.radians(24.0), np.radians(48.0)
    x, y = -3.0 * np.cos(a) - 2.0 * np.cos(b), -3.0 * np.sin(a) - 2.0 * np.sin(b)
    np.testing.assert_allclose(sent["net_force_N"], [x, y, 0.0], atol=0.05)
    # About the axis there is none; about x and y the lever is the height.
    tilt = [36.0 * np.sin(a) + 36.0 * np.sin(b), -36.0 * np.cos(a) - 36.0 * np.cos(b), 0.0]
    np.testing.assert_allclose(sent["net_moment_Nmm"], tilt, atol=1.5)
    assert "net_force_sd_N" not in sent
    assert "net_moment_sd_Nmm" not in sent


def test_a_contact_on_a_cylinder_turns_it_by_its_force_along_the_surface() -> None:
    (point,), (normal,) = on_cylinder(np.array([30.0]), np.array([40.0]))
    around = np.array([-0.5, np.sqrt(0.75), 0.0])
    message = stream(cylinder_places())
    plain = message(press(point, 2.0))
    np.testing.assert_allclose(plain["net_force_N"], -2.0 * normal, atol=1e-3)
    # 2 N at 40 mm above the origin.
    np.testing.assert_allclose(plain["net_moment_Nmm"], [40.0, -69.282, 0.0], atol=0.02)
    dragged = message(press(point, 2.0, shear_N=1.5 * around))
    np.testing.assert_allclose(dragged["net_force_N"], 1.5 * around - 2.0 * normal, atol=1e-3)
    # And 1.5 N at 30 mm from the axis and 40 mm above the origin.
    wanted = [40.0 - 51.962, -69.282 - 30.0, 45.0]
    np.testing.assert_allclose(dragged["net_moment_Nmm"], wanted, atol=0.02)


def test_two_opposite_presses_are_a_couple() -> None:
    points, _ = on_cylinder(np.array([0.0, 180.0]), np.array([20.0, 40.0]))
    for about in ((0.0, 0.0, 0.0), (7.0, -50.0, 31.0)):
        sent = stream(cylinder_places(), about)(*(press(point, 5.0) for point in points))
        np.testing.assert_allclose(sent["net_force_N"], 0.0, atol=1e-3)
        # 5 N at 20 mm from one another.
        np.testing.assert_allclose(sent["net_moment_Nmm"], [0.0, 100.0, 0.0], atol=0.05)
        assert sent["total_N"] == 10.0


def test_moments_about_another_point_follow_from_the_force() -> None:
    about = np.array([12.0, -7.0, 33.0])
    points, _ = on_cylinder(np.array([10.0, 100.0, 230.0]), np.array([12.0, 30.0, 51.0]))
    contacts = [
        press(point, 3.0 + k, shear_N=[0.0, 0.0, 1.0 - 2.0 * k]) for k, point in enumerate(points)
    ]
    first = stream(cylinder_places())(*contacts)
    second = stream(cylinder_places(), (12.0, -7.0, 33.0))(*contacts)
    assert first["moment_about_mm"] == [0.0, 0.0, 0.0]
    assert second["moment_about_mm"] == [12.0, -7.0, 33.0]
    assert first["net_force_N"] == second["net_force_N"]
    moved = first["net_moment_Nmm"] - np.cross(about, first["net_force_N"])
    np.testing.assert_allclose(second["net_moment_Nmm"], moved, atol=0.01)
    assert np.linalg.norm(np.cross(about, first["net_force_N"])) > 50.0


def test_standard_deviations_on_a_plane() -> None:
    message = stream(flat_places(), (10.0, 20.0, 5.0))
    # From the reference point: (20, 0, -5) mm.
    sent = message(press([30.0, 20.0, 0.0], 4.0, sd_N=0.2, sd_mm=(0.5, 0.25)))
    # A force along the surface that is not observed is 0 within 0.4 of the normal force.
    np.testing.assert_allclose(sent["net_force_sd_N"], [1.6, 1.6, 0.2], atol=1e-4)
    wanted = np.sqrt([8.0**2 + 1.0**2, 8.0**2 + 4.0**2 + 2.0**2, 32.0**2])
    np.testing.assert_allclose(sent["net_moment_sd_Nmm"], wanted, atol=1e-3)
    # From the reference point: (20, 10, -5) mm; errors along x and y are correlated.
    known = press(
        [30.0, 30.0, 0.0],
        4.0,
        shear_N=[1.0, 0.0, 0.0],
        covariance_N2=np.array([[0.04, 0.03, 0.0], [0.03, 0.0625, 0.0], [0.0, 0.0, 0.0]]),
    )
    sent = message(known)
    np.testing.assert_allclose(sent["net_force_sd_N"], [0.2, 0.25, 0.0], atol=1e-4)
    about_z = np.sqrt(400.0 * 0.0625 + 100.0 * 0.04 - 2.0 * 200.0 * 0.03)
    np.testing.assert_allclose(sent["net_moment_sd_Nmm"], [1.25, 1.0, about_z], atol=1e-3)
    # Two independent contacts add in squares.
    both = message(known, replace(known, point_mm=np.array([30.0, 30.0, 0.0])))
    np.testing.assert_allclose(
        both["net_moment_sd_Nmm"], np.sqrt(2.0) * np.array(sent["net_moment_sd_Nmm"]), atol=2e-3
    )
    idle = message()
    assert idle["net_force_sd_N"] == idle["net_moment_sd_Nmm"] == [0.0, 0.0, 0.0]


def test_on_a_cylinder_the_normal_turns_with_the_place() -> None:
    (point,), _ = on_cylinder(np.array([0.0]), np.array([30.0]))
    one = press(point, 4.0, sd_mm=(0.0, 0.3), shear_N=[0.0, 0.0, 0.0])
    sent = stream(cylinder_places())(one)
    # By 0.3 mm of 30; it always points at the axis.
    np.testing.assert_allclose(sent["net_force_sd_N"], [0.0, 0.04, 0.0], atol=1e-3)
    np.testing.assert_allclose(sent["net_moment_sd_Nmm"], [30.0 * 0.04, 0.0, 0.0], atol=0.02)


def test_standard_deviations_are_those_of_draws() -> None:
    rng, count, about = np.random.default_rng(5), 20000, np.array([5.0, -3.0, 12.0])
    angle, z = np.array([40.0, 250.0]), np.array([15.0, 48.0])
    points, normals = on_cylinder(angle, z)
    force, sd_N, sd_mm = np.array([6.0, 4.0]), np.array([0.3, 0.5]), (0.4, 0.6)
    shear_sd_N, contacts = 0.2, []
    drawn = np.zeros((count, 6))
    for k in range(2):
        axes = np.stack([np.cross([0.0, 0.0, 1.0], normals[k]), [0.0, 0.0, 1.0]])
        shear = 0.5 * axes[0] - axes[1]
        covariance = shear_sd_N**2 * axes.T @ axes
        contacts.append(
            press(points[k], force[k], sd_N=sd_N[k], sd_mm=sd_mm, shear_N=shear,
                  covariance_N2=covariance)
        )  # fmt: skip
        turned = np.degrees(rng.normal(0.0, sd_mm[1], count) / RADIUS_mm)
        place, normal = on_cylinder(angle[k] + turned, z[k] + rng.normal(0.0, sd_mm[0], count))
        drag = shear + shear_sd_N * rng.normal(size=(count, 2)) @ axes
        each = drag - (force[k] + sd_N[k] * rng.normal(size=count))[:, None] * normal
        drawn += np.hstack([each, np.cross(place - about, each)])
    sent = stream(cylinder_places(), (5.0, -3.0, 12.0))(*contacts)
    sds = [*sent["net_force_sd_N"], *sent["net_moment_sd_Nmm"]]
    np.testing.assert_allclose(sds, drawn.std(axis=0), rtol=0.03)
    means = [*sent["net_force_N"], *sent["net_moment_Nmm"]]
    np.testing.assert_allclose(means, drawn.mean(axis=0), atol=0.3)


def test_a_recording_holds_what_the_stream_sends(tmp_path: Path) -> None:
    points, _ = on_cylinder(np.array([10.0, 100.0]), np.array([12.0, 30.0]))
    seen = press(points[0], 3.0, sd_N=0.1, sd_mm=(0.2, 0.3), shear_N=[0.0, 0.0, 1.0])
    message = stream(cylinder_places(), (1.0, 2.0, 3.0))
    sent = [message(seen, press(points[1], 4.0, sd_N=0.2)), message()]
    with Recorder(tmp_path / "out.csv") as rows:
        for each in sent:
            rows.add(each)
    first, second, idle = csv.DictReader((tmp_path / "out.csv").read_text().splitlines())
    for row, one in zip((first, second), sent[0]["contacts"], strict=True):
        assert [float(row[f"normal_{axis}"]) for axis in "xyz"] == one["normal"]
        assert float(row["force_N"]) == one["force_N"]
    assert [idle["contact"], idle["normal_x"]] == ["", ""]
    for row, each in ((first, sent[0]), (second, sent[0]), (idle, sent[1])):
        for name, unit in (
            ("net_force", "N"),
            ("net_force_sd", "N"),
            ("net_moment", "Nmm"),
            ("net_moment_sd", "Nmm"),
            ("moment_about", "mm"),
        ):
            got = [float(row[f"{name}_{axis}_{unit}"]) for axis in "xyz"]
            assert got == each[f"{name}_{unit}"], name
    assert len(set(map(str, sent[0]["net_moment_sd_Nmm"] + sent[0]["net_moment_Nmm"]))) == 6


def test_a_standard_deviation_that_is_not_finite_is_left_out() -> None:
    sent = stream(flat_places())(press([30.0, 20.0, 0.0], 4.0, sd_mm=(np.inf, 0.1)))
    assert sent["net_force_N"] == [0.0, 0.0, -4.0]
    assert "net_moment_sd_Nmm" not in sent
    assert b"NaN" not in json_bytes(sent)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e7])
def test_a_reference_point_that_is_none_is_rejected(bad: float) -> None:
    with refused("moment-reference-invalid"):
        MessageBuilder(bundle=toy_bundle(), estimator="fem", moment_about_mm=(0.0, bad, 0.0))
