"""Contacts: their place on the surface, their size, and an id that stays with each."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phytac_decoder.estimation.contact_grouping import (
    Contact,
    ContactGrouper,
    group_key_nodes,
)
from phytac_decoder.estimation.contact_tracker import (
    SETTINGS,
    ContactTracker,
    match_pairs,
)
from phytac_shapes.arrays import FloatArray

COUNT = 30
ROWS, COLUMNS, RADIUS_MM, PITCH_MM = 14, 20, 30.0, 8.0
FPS = 480.0


def spiral() -> FloatArray:
    """Markers (280, 3) on a cylinder, each row turned against the one before."""
    row, column = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    angle = 2.0 * np.pi * (column / COLUMNS + 0.031 * row)
    return np.column_stack(
        [RADIUS_MM * np.cos(angle), RADIUS_MM * np.sin(angle), PITCH_MM * (row + 0.5)]
    )


def grid(side: int = 40) -> FloatArray:
    """Markers (side², 3), 5 mm apart on a plane."""
    row, column = np.divmod(np.arange(side * side), side)
    return np.column_stack([5.0 * column, 5.0 * row, np.zeros(side * side)])


def around(position_mm: FloatArray) -> FloatArray:
    """The eight nearest markers (n, 8)."""
    gap = np.linalg.norm(position_mm[:, None] - position_mm[None], axis=2)
    return np.argsort(gap, axis=1)[:, 1:9]


def on_plane() -> ContactGrouper:
    position = grid()
    return ContactGrouper(position_mm=position, neighbours=around(position))


PLANE = on_plane()


def press(*presses: tuple[float, float, float, float]) -> list[Contact]:
    """Contacts of discs (x, y, radius, force), each evenly over the markers that it covers."""
    forces = np.zeros(len(PLANE.position_mm))
    for x, y, radius, force in presses:
        away = np.linalg.norm(PLANE.position_mm[:, :2] - (x, y), axis=1)
        # Softly at its edge, as the bowl's footprint makes it.
        share = np.clip((radius + 2.5 - away) / 5.0, 0.0, 1.0)
        forces += force * share / share.sum()
    return PLANE.find(forces, np.flatnonzero(forces > 0.05))


def ids_of(tracker: ContactTracker, frames: list[list[Contact]]) -> list[list[int]]:
    """Ids of each frame, from left to right."""
    out = []
    for number, contacts in enumerate(frames):
        found = tracker.update(contacts, number / FPS)
        out.append([contact.id for contact in sorted(found, key=lambda c: c.position_mm[0])])
    return out


def tracker() -> ContactTracker:
    return ContactTracker(spacing_mm=PLANE.spacing_mm)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_groups_are_the_classes_of_being_linked(seed: int) -> None:
    rng = np.random.default_rng(seed)
    near = np.where(rng.uniform(size=(COUNT, 8)) < 0.15, rng.integers(0, COUNT, (COUNT, 8)), -1)
    koi = np.flatnonzero(rng.uniform(size=COUNT) < rng.uniform())
    groups = [koi[rows].tolist() for rows in group_key_nodes(koi, near)]
    assert sorted(marker for group in groups for marker in group) == koi.tolist()
    # Warshall's closure, by itself.
    linked = np.eye(COUNT, dtype=bool)
    for marker in koi:
        for other in near[marker]:
            if other in koi:
                linked[marker, other] = linked[other, marker] = True
    for middle in koi:
        linked |= linked[:, [middle]] & linked[[middle], :]
    for group in groups:
        assert np.flatnonzero(linked[group[0]]).tolist() == group


def test_a_rim_links_nothing() -> None:
    """-1 stands for no neighbour, not for the last marker."""
    assert group_key_nodes(np.array([0, 29]), np.full((COUNT, 8), -1)) == [[0], [1]]


def test_places_lie_on_the_surface_between_markers() -> None:
    position = spiral()
    face = ContactGrouper(position_mm=position, neighbours=around(position))
    rng = np.random.default_rng(3)
    inside, off = [], []
    for _ in range(300):
        first = int(rng.integers(len(position)))
        near = np.argsort(np.linalg.norm(position - position[first], axis=1))
        markers = near[: rng.integers(2, 7)]
        middle = rng.dirichlet(np.ones(len(markers))) @ position[markers]
        inside.append(RADIUS_MM - np.hypot(*middle[:2]))
        off.append(abs(RADIUS_MM - np.hypot(*face.onto_surface(middle, markers.tolist())[:2])))
    assert max(inside) > 1.0
    assert max(off) < 0.05


def test_one_marker_is_its_own_place_and_a_ring_stays_on_the_surface() -> None:
    position = spiral()
    finder = ContactGrouper(position_mm=position, neighbours=around(position))
    forces = np.zeros(len(position))
    forces[47] = 2.0
    (alone,) = finder.find(forces, np.array([47]))
    assert alone.position_mm == tuple(position[47])
    ring = np.arange(5 * COLUMNS, 6 * COLUMNS)
    forces[ring] = 1.0
    found = finder.find(forces, ring)[0]
    assert np.hypot(*found.position_mm[:2]) == pytest.approx(RADIUS_MM, abs=1.5)


def test_size_is_that_of_an_even_disc() -> None:
    sub = (np.arange(8) - 3.5) / 8.0 * 5.0
    points = PLANE.position_mm[:, None, None, :2] + np.stack(np.meshgrid(sub, sub), axis=-1)
    for radius in (8.0, 13.0, 30.0):
        inside = np.linalg.norm(points - (97.0, 101.0), axis=3) <= radius
        forces = inside.mean(axis=(1, 2))
        (contact,) = PLANE.find(forces, np.flatnonzero(forces))
        assert contact.size_mm == pytest.approx(2.0 * radius, abs=2.5)
        assert contact.position_mm == pytest.approx((97.0, 101.0, 0.0), abs=0.2)
    # The size from one marker is that of its cell.
    (alone,) = PLANE.find(np.eye(len(PLANE.position_mm))[820], np.array([820]))
    assert alone.size_mm == pytest.approx(5.0 * 2.0 / np.sqrt(3.0))


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_pairs_cost_least(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = int(rng.integers(1, 5))
    columns = int(rng.integers(rows, 6))
    cost = rng.normal(0.0, 10.0, (rows, columns))
    least = min(
        sum(cost[row, column] for row, column in enumerate(chosen))
        for chosen in permutations(range(columns), rows)
    )
    pairs = match_pairs(cost)
    assert [row for row, _ in pairs] == list(range(rows))
    assert len({column for _, column in pairs}) == rows
    assert sum(cost[pair] for pair in pairs) == pytest.approx(least, abs=1e-3)
    assert sorted((row, column) for column, row in match_pairs(cost.T)) == pairs


def test_ids_stay_while_contacts_slide() -> None:
    """Two fingers, one behind the other, at 2.4 m/s: each comes to where the other was."""
    frames = [
        press((40.0 + 5.0 * k, 60.0, 4.0, 5.0), (65.0 + 5.0 * k, 60.0, 4.0, 9.0)) for k in range(20)
    ]
    found = ids_of(tracker(), frames)
    assert found == [found[0]] * 20
    assert sorted(found[0]) == [0, 1]


def test_a_lost_frame_does_not_hand_ids_down_a_row_of_sliding_fingers() -> None:
    """At 4.8 m/s, one frame lost: each is nearer to where the one before it was than to its own."""
    watch, names = tracker(), []
    for number in (0, 1, 2, 4):
        here = [(30.0 + 25.0 * k + 10.0 * number, 60.0, 4.0, 5.0 + k) for k in range(3)]
        found = watch.update(press(*here), number / FPS)
        names.append([contact.id for contact in sorted(found, key=lambda c: c.position_mm[0])])
    assert names == [names[0]] * 4


def test_fingers_that_pass_each_other_keep_their_names() -> None:
    frames = [
        press((40.0 + 4.0 * k, 60.0, 4.0, 5.0), (120.0 - 4.0 * k, 100.0, 4.0, 9.0))
        for k in range(20)
    ]
    found = ids_of(tracker(), frames)
    first, last = found[0], found[-1]
    assert len(set(first)) == 2
    assert last == first[::-1]


def test_contacts_that_meet_get_their_own_ids_back() -> None:
    gap = [*range(40, 4, -2), *range(4, 42, 2)]
    frames = [press((80.0 - d / 2, 70.0, 5.0, 6.0), (80.0 + d / 2, 70.0, 5.0, 8.0)) for d in gap]
    assert {len(frame) for frame in frames} == {1, 2}
    found = ids_of(tracker(), frames)
    assert found[0] == found[-1]
    assert len(set(found[0])) == 2
    assert {name for frame in found for name in frame} == set(found[0])


def test_three_that_meet_and_part_one_by_one() -> None:
    def frame(left: float, right: float) -> list[Contact]:
        return press(
            (100.0 - left, 70.0, 5.0, 6.0), (100.0, 70.0, 5.0, 8.0), (100.0 + right, 70.0, 5.0, 7.0)
        )

    lefts = [*range(30, 8, -1), *[9] * 20, *range(9, 31)]
    rights = [*[30] * 5, *range(30, 8, -1), *[9] * 15, *range(9, 31)]
    frames = [frame(a, b) for a, b in zip(lefts, rights, strict=True)]
    found = ids_of(tracker(), frames)
    assert {len(ids) for ids in found} == {1, 2, 3}
    assert found[0] == found[-1]
    assert {name for ids in found for name in ids} == set(found[0])


def test_of_merged_contacts_the_one_that_stays_keeps_its_id() -> None:
    def frame(gap: float, strong: float) -> list[Contact]:
        weak = (80.0 + gap / 2, 70.0, 5.0, 4.0)
        return press((80.0 - gap / 2, 70.0, 5.0, strong), weak) if strong else press(weak)

    frames = [frame(gap, 8.0) for gap in (30, 26, 22, 18, 14, 13, 13)]
    frames += [frame(13, force) for force in (4.0, 2.0, 1.0, 0.0, 0.0)]
    watch = tracker()
    found = ids_of(watch, frames)
    assert len(found[0]) == 2
    assert found[6] == [found[0][0]]
    assert found[-1] == [found[0][1]]


def test_a_split_gives_one_new_id() -> None:
    frames = [
        press((80.0 - d / 2, 70.0, 5.0, 6.0), (80.0 + d / 2, 70.0, 5.0, 7.0))
        for d in range(4, 40, 2)
    ]
    found = ids_of(tracker(), frames)
    assert found[0] == [0]
    assert sorted(found[-1]) == [0, 1]
    assert {tuple(sorted(ids)) for ids in found} == {(0,), (0, 1)}


@pytest.mark.parametrize(
    ("gone", "same"), [(1, True), (SETTINGS.hold_frames, True), (SETTINGS.hold_frames + 1, False)]
)
def test_a_contact_may_be_missed_but_not_lifted(gone: int, same: bool) -> None:
    here = (80.0, 70.0, 5.0, 6.0)
    frames = [press(here)] * 3 + [[]] * gone + [press(here)]
    found = ids_of(tracker(), frames)
    assert (found[-1] == found[0]) is same


def test_a_contact_is_as_old_as_its_first_frame() -> None:
    watch = tracker()
    for number in range(5):
        found = watch.update(press((50.0 + number, 50.0, 4.0, 5.0)), 2.0 + 0.1 * number)
    assert found[0].since_s == 2.0
    # Long after, it is another touch, though no frame was seen in between.
    assert watch.update([], 9.0) == []
    (late,) = watch.update(press((54.0, 50.0, 4.0, 5.0)), 9.1)
    assert (late.id, late.since_s) == (1, 9.1)


def test_far_away_is_another_contact() -> None:
    watch = tracker()
    watch.update(press((30.0, 30.0, 4.0, 5.0)), 0.0)
    (other,) = watch.update(press((150.0, 150.0, 4.0, 5.0)), 1.0 / FPS)
    assert other.id == 1


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_hand_at_480_fps_keeps_five_ids(seed: int) -> None:
    """Five fingers drift, tremble and change force for half a second, one frame in ten lost."""
    rng = np.random.default_rng(seed)
    place = np.array([[40, 40], [80, 40], [120, 40], [60, 100], [110, 100]], dtype=float)
    speed = rng.uniform(-40.0, 40.0, (5, 2)) / FPS
    watch, names, apart = tracker(), [], 0
    for number in range(240):
        if rng.uniform() < 0.1:
            continue
        centre = place + speed * number + rng.normal(0.0, 0.3, (5, 2))
        gap = np.linalg.norm(centre[:, None] - centre, axis=2) + 1e3 * np.eye(5)
        apart += bool(gap.min() > 30.0)
        force = 6.0 + 3.0 * np.sin(number / 40.0 + np.arange(5))
        contacts = press(
            *[(x, y, 4.0, f) for (x, y), f in zip(centre.tolist(), force, strict=True)]
        )
        found = watch.update(contacts, number / FPS)
        if len(found) == 5:
            near = [
                int(np.argmin(np.linalg.norm(centre - contact.position_mm[:2], axis=1)))
                for contact in found
            ]
            names.append(tuple(found[near.index(finger)].id for finger in range(5)))
    # Fingers that come near share key nodes and are one for a while; others never are.
    assert len(names) >= apart > 50
    assert len(set(names)) == 1


def hand_that_is_tapped(tracker: ContactTracker, taps: int) -> tuple[float, list[Contact]]:
    """A finger slides into a resting hand, which grips harder, and is lifted there; how it ends."""
    time_s, out = 0.0, tracker.update(press((60.0, 60.0, 8.0, 3.0)), 0.0)
    for tap in range(taps):
        hand = (60.0, 60.0, 8.0 if tap == 0 else 14.0, 6.0)
        for x in (96.0, 90.0, 84.0, 78.0, 74.0):
            time_s += 1.0 / 60.0
            out = tracker.update(press(hand, (x, 60.0, 6.0, 3.0)), time_s)
        for _ in range(6):
            time_s += 1.0 / 60.0
            out = tracker.update(press((60.0, 60.0, 16.0, 8.0)), time_s)
    return time_s, out


def test_what_lands_beside_a_hand_that_has_swallowed_a_finger_is_new() -> None:
    tracker = ContactTracker(spacing_mm=PLANE.spacing_mm)
    time_s, (hand,) = hand_that_is_tapped(tracker, 1)
    time_s += 60.0
    tracker.update(press((60.0, 60.0, 16.0, 8.0)), time_s)
    both = tracker.update(press((60.0, 60.0, 16.0, 8.0), (87.0, 60.0, 3.0, 2.0)), time_s + 0.02)
    old, new = sorted(both, key=lambda contact: contact.position_mm[0])
    assert old.id == hand.id
    assert new.id not in {0, 1}
    assert new.since_s == time_s + 0.02


def test_a_hand_that_is_tapped_all_day_is_no_slower() -> None:
    tracker = ContactTracker(spacing_mm=PLANE.spacing_mm)
    _, (hand,) = hand_that_is_tapped(tracker, 40)
    (track,) = tracker._tracks.values()
    assert 1 < len(track.inside) <= SETTINGS.merged_max
    assert track.inside[0].id == hand.id
