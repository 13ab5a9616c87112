"""The referee's frozen contacts and data: read back, complete, of this sensor."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import twin
from benchmarks.referee.contacts import (
    COUNTS,
    KINDS,
    RADII_MM,
    Contact,
    contacts_file,
    draw,
    load_contacts,
    write_contacts,
)
from benchmarks.referee.read import (
    MOTION_MIN_SHARE,
    STEPS,
    Solved,
    data_file,
    read_solved,
    write_solved,
)
from benchmarks.referee.solve import Sensor, input_key, sensor, sizes_for
from phytac_design.simulation.sensor_instance import designed_shell
from phytac_design.simulation.solver import Solver
from tests.refusals import refused

SIDE_N = 0.02
"""Resultant beside the normal, of the force: of holes and rims that a disc meets off its middle."""
WORST_RESIDUAL, WORST_CORRECTION = 1e-3, 1e-2


@pytest.fixture(scope="module")
def grip() -> Sensor:
    return sensor("grip")


def made_up(this: Sensor, index: int = 3) -> Solved:
    rng = np.random.default_rng(index)
    motion = rng.normal(size=(this.markers.count, 3))
    motion[5] = 1e-5
    peak = float(np.linalg.norm(motion, axis=1).max())
    return Solved(
        index=index,
        contact=load_contacts("grip")[index],
        motion_mm=motion,
        kept=np.arange(4, 9),
        turn_rad=0.1 * rng.normal(size=(5, 3)),
        facts={"peak_mm": peak, "key": "made up"},
    )


@pytest.mark.parametrize("name", COUNTS)
def test_contacts_lie_on_the_sensor_and_cover_what_is_asked(name: str) -> None:
    contacts = load_contacts(name)
    surface = sensor(name).surface
    assert tuple(sum(c.kind == kind for c in contacts) for kind in KINDS) == COUNTS[name]
    assert sum(COUNTS[name]) >= (50 if name == "cylinder60" else 20)
    force = np.concatenate([c.force_N for c in contacts])
    assert (force.min(), force.max()) == (0.5, 25.0)
    (u0, u1), _ = surface.domain
    for contact in contacts:
        assert (len(contact.uv) > 1) == (contact.kind == "multi")
        assert all(u0 < u < u1 for u, _ in contact.uv)
        assert all(RADII_MM[0] <= r <= RADII_MM[1] for r in contact.radius_mm)
        points, radius = surface.point(contact.centres), np.array(contact.radius_mm)
        apart = np.linalg.norm(points[:, None] - points, axis=2) + 1e9 * np.eye(len(points))
        assert (apart > radius[:, None] + radius).all()
    near = [min(u - u0, u1 - u) for c in contacts if c.kind == "rim" for u, _ in c.uv]
    assert max(near) < 12.0


def test_draw_is_seeded_and_files_say_all_of_it(tmp_path: Path) -> None:
    first = draw("grip")
    assert first == draw("grip")
    write_contacts(tmp_path / "a.json", first)
    rows = json.loads((tmp_path / "a.json").read_text())
    assert [row["force_N"] for row in rows] == [list(c.force_N) for c in first]
    assert rows[0].keys() == {"kind", "uv", "radius_mm", "force_N"}


def test_no_contacts_for_an_unknown_design() -> None:
    with refused("referee-contacts-missing"):
        load_contacts("plane")


def test_solved_contacts_read_back(grip: Sensor, tmp_path: Path) -> None:
    path, item = tmp_path / "grip.npz", made_up(grip)
    write_solved(path, grip.design, grip.markers, [item, made_up(grip, 1)])
    found = read_solved(path, grip.design, grip.markers)
    assert [one.index for one in found] == [1, 3]
    back = found[1]
    assert back.contact == item.contact
    assert dict(back.facts) == item.facts
    np.testing.assert_array_equal(back.kept, item.kept)
    half = 0.5001 / STEPS
    small = np.linalg.norm(item.motion_mm, axis=1) < MOTION_MIN_SHARE * item.peak_mm
    assert small.sum() == 1
    assert (back.motion_mm[small] == 0.0).all()
    error = np.abs(back.motion_mm - item.motion_mm)[~small]
    assert error.max() <= half * np.abs(item.motion_mm).max()
    assert np.abs(back.turn_rad - item.turn_rad).max() <= half * np.abs(item.turn_rad).max()


def test_same_contacts_same_bytes(grip: Sensor, tmp_path: Path) -> None:
    items = [made_up(grip, k) for k in (1, 3)]
    for name, order in (("a.npz", items), ("b.npz", items[::-1])):
        write_solved(tmp_path / name, grip.design, grip.markers, order)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_cut_and_foreign_files_are_refused(grip: Sensor, tmp_path: Path) -> None:
    path = tmp_path / "grip.npz"
    write_solved(path, grip.design, grip.markers, [made_up(grip)])
    wall = grip.design.wall.model_copy(update={"thickness_mm": 0.9})
    thicker = grip.design.model_copy(update={"wall": wall})
    with refused("referee-sensor-differs"):
        read_solved(path, thicker, grip.markers)
    moved = replace(grip.markers, tip_mm=grip.markers.tip_mm + 1e-3)
    with refused("referee-sensor-differs"):
        read_solved(path, grip.design, moved)
    path.write_bytes(path.read_bytes()[:-30])
    with refused("referee-file-invalid"):
        read_solved(path, grip.design, grip.markers)
    with refused("referee-file-invalid"):
        read_solved(tmp_path / "none.npz", grip.design, grip.markers)


def test_key_knows_contact_and_mesh(grip: Sensor) -> None:
    contact = load_contacts("grip")[0]
    sizes = sizes_for(grip.design, contact)
    key = input_key(grip, contact, sizes)
    assert key == input_key(grip, contact, sizes)
    assert key != input_key(grip, replace(contact, force_N=(24.0,)), sizes)
    assert key != input_key(grip, contact, sizes.scaled(0.75))


@pytest.mark.parametrize("name", COUNTS)
def test_frozen_data_belong_to_the_contacts_and_converged(name: str) -> None:
    this = sensor(name)
    contacts = load_contacts(name)
    if not data_file(name).is_file():
        pytest.skip(f"not solved yet: python -m benchmarks.referee.solve --design {name}")
    solved = read_solved(data_file(name), this.design, this.markers)
    assert len(solved) > 0
    for item in solved:
        contact: Contact = contacts[item.index]
        assert item.contact == contact
        assert item.facts["key"] == input_key(this, contact, sizes_for(this.design, contact))
        assert item.facts["factor"] == pytest.approx(1.0)
        assert item.facts["residual"] < WORST_RESIDUAL
        assert item.facts["correction"] < WORST_CORRECTION
        normal = this.surface.normal(contact.centres)
        wanted = -np.array(contact.force_N) @ normal
        side = np.abs(np.array(item.facts["resultant_N"]) - wanted).max()
        assert side < SIDE_N * sum(contact.force_N)
        # The tip that moves most stands under one of the patches.
        most = int(np.argmax(np.linalg.norm(item.motion_mm, axis=1)))
        gap = this.markers.mid_mm[most] - this.surface.point(contact.centres)
        assert np.linalg.norm(gap, axis=1).min() < max(contact.radius_mm) + 12.0
        assert item.motion_mm[most] @ this.markers.normal[most] < 0.0


def test_data_are_small_enough_to_commit() -> None:
    files = [data_file(name) for name in COUNTS] + [contacts_file(name) for name in COUNTS]
    assert sum(path.stat().st_size for path in files if path.exists()) < 300_000


def test_tips_beside_rims_are_known(grip: Sensor) -> None:
    row, rows = grip.markers.row, grip.design.layout.rows
    np.testing.assert_array_equal(twin.at_rim(grip), (row == 0) | (row == rows - 1))
    item = made_up(grip)
    off = item.motion_mm.copy()
    off[7] += [0.0, 0.3, 0.4]
    assert twin.worst_tip(twin.TipComparison(item=item, large_mm=off)) == 7


def test_gap_and_scale_are_of_the_peak(grip: Sensor) -> None:
    item = made_up(grip)
    assert twin.gap(1.02 * item.motion_mm, item) == pytest.approx(2.0)
    assert twin.bias(1.02 * item.motion_mm, item) == pytest.approx(2.0)
    one = item.motion_mm.copy()
    one[7] += [0.0, 0.03, 0.04]
    assert twin.gap(one, item) == pytest.approx(5.0 / item.peak_mm)
    assert twin.gap(one, item, np.array([3, 4])) == 0.0


def test_the_referees_own_error_is_extrapolated_with_the_rate_that_is_measured() -> None:
    for rate in (1.0, 2.0, 3.5):
        off = [0.6 * (1.0 - size**rate) for size in (twin.COARSER, twin.FINER)]
        assert twin.own_error(*off) == pytest.approx((0.6, rate), rel=1e-6)


def test_shell_presses_as_hard_as_the_solid(grip: Sensor) -> None:
    solved = [replace(made_up(grip), contact=c) for c in load_contacts("grip")[:3]]
    solver = Solver(grip.design, grip.surface, designed_shell(grip.surface, grip.markers), refine=3)
    for item in solved:
        touches = twin.touches_of(item)
        inward = -grip.surface.normal(item.contact.centres)
        wanted = np.array(item.contact.force_N) @ inward
        found = solver.load(touches, touches.force_N).reshape(-1, 6)[:, :3].sum(axis=0)
        assert np.abs(found - wanted).max() < SIDE_N * sum(item.contact.force_N)
