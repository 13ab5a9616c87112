"""Contacts followed over time: an id that stays while one moves, merges, splits or is missed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import dist

import numpy as np

from phytac_decoder.estimation.contact_grouping import Contact, Place
from phytac_shapes.arrays import FloatArray

GATE_SPACINGS = 2.5
"""A contact is looked for within so many marker spacings of where it is expected, and its size."""
HOLD_FRAMES = 3
"""A contact that is gone for more frames than this has been lifted."""
HOLD_S = 0.5
"""Or for longer than this."""
SPEED_KEPT = 0.5
"""Share of its former speed in a contact's speed."""
STILL: Place = (0.0, 0.0, 0.0)
INSIDE_MAX = 8
"""Contacts that one may be made of."""
UNPAIRED_COST = 1e9
"""Cost of a pair that does not go together: more than any that does."""


@dataclass(kw_only=True)
class _Track:
    """One contact so far.

    ``inside`` are contacts, itself among them, that have merged into it, each as it was when last
    alone, and ``merged_at`` the place of the merged contact then.
    """

    id: int
    since_s: float
    seen_s: float
    place: Place
    size_mm: float
    markers: frozenset[int]
    speed_mm_s: Place = STILL
    absent: int = 0
    inside: "list[_Track]" = field(default_factory=list)
    merged_at: Place = STILL

    def expected(self, time_s: float, most_mm: float) -> Place:
        """Where it is if it has gone on as before, by ``most_mm`` at most."""
        step = max(time_s - self.seen_s, 0.0)
        far = step * dist(self.speed_mm_s, STILL)
        step *= min(1.0, most_mm / far) if far else 1.0
        x, y, z = (p + step * v for p, v in zip(self.place, self.speed_mm_s, strict=True))
        return x, y, z


def linear_assignment(cost: FloatArray) -> list[int]:
    """Columns of the rows of a cost matrix (r, c), r <= c, so that their sum is least.

    Shortest augmenting paths (Jonker and Volgenant 1987).
    """
    rows, columns = cost.shape
    # Entry 0 stands for no row, and for no column.
    owner, before = np.zeros(columns + 1, dtype=np.int64), np.zeros(columns + 1, dtype=np.int64)
    by_row, by_column = np.zeros(rows + 1), np.zeros(columns + 1)
    padded = np.pad(cost, ((1, 0), (1, 0)))
    for row in range(1, rows + 1):
        owner[0], column = row, 0
        least, used = np.full(columns + 1, np.inf), np.zeros(columns + 1, dtype=np.bool_)
        while owner[column]:
            used[column] = True
            left = padded[owner[column]] - by_row[owner[column]] - by_column
            better = ~used & (left < least)
            least[better], before[better] = left[better], column
            column = int(np.where(used, np.inf, least).argmin())
            step = least[column]
            by_row[owner[used]] += step
            by_column[used] -= step
            least[~used] -= step
        while column:
            owner[column] = owner[before[column]]
            column = int(before[column])
    taken = {int(row) - 1: column for column, row in enumerate(owner[1:]) if row}
    return [taken[row] for row in range(rows)]


def match_pairs(cost: Sequence[Sequence[float]]) -> list[tuple[int, int]]:
    """Rows and columns that go together: as many as can be, at the least cost, none at ``UNPAIRED_COST``."""
    if not cost or not cost[0]:
        return []
    table = np.array(cost)
    if len(cost) <= len(cost[0]):
        pairs = list(enumerate(linear_assignment(table)))
    else:
        pairs = [(row, column) for column, row in enumerate(linear_assignment(table.T))]
    return [(row, column) for row, column in pairs if cost[row][column] < UNPAIRED_COST]


@dataclass(kw_only=True)
class ContactTracker:
    """Gives the contacts of successive frames their ids, counted from 0.

    Attributes
    ----------
    spacing_mm : float
        Usual distance of neighbouring markers.
    """

    spacing_mm: float
    _tracks: dict[int, _Track] = field(default_factory=dict)
    _next: int = 0

    def update(self, contacts: Sequence[Contact], time_s: float) -> list[Contact]:
        """Return the contacts of the next frame, in their order, with id and age.

        Parameters
        ----------
        contacts : sequence of Contact
            Of a frame that could be read; one that could not says nothing about contacts.
        time_s : float
            When it was taken.
        """
        self._tracks = {
            number: track
            for number, track in self._tracks.items()
            if not track.absent or time_s - track.seen_s <= HOLD_S
        }
        tracks = list(self._tracks.values())
        found = self._same_markers(tracks, contacts)
        if found is None:
            found = self._nearest(tracks, contacts, time_s)
            for row, track in list(found.items()):
                self._part(found, row, track, contacts)
            self._merge_or_miss(found, contacts, time_s)
        out = []
        for row, contact in enumerate(contacts):
            track = found.get(row) or self._new(contact, time_s)
            self._follow(track, contact, time_s)
            out.append(replace(contact, id=track.id, since_s=track.since_s))
        return out

    def _same_markers(
        self, tracks: Sequence[_Track], contacts: Sequence[Contact]
    ) -> dict[int, _Track] | None:
        """The usual case: each contact shares markers with one track, and each track with one."""
        if len(tracks) != len(contacts) or any(track.absent or track.inside for track in tracks):
            return None
        of = {marker: track.id for track in tracks for marker in track.markers}
        found: dict[int, _Track] = {}
        for row, contact in enumerate(contacts):
            owners = {of[marker] for marker in contact.markers if marker in of}
            if len(owners) != 1:
                return None
            found[row] = self._tracks[owners.pop()]
        return found if len({track.id for track in found.values()}) == len(contacts) else None

    def _nearest(
        self, tracks: Sequence[_Track], contacts: Sequence[Contact], time_s: float
    ) -> dict[int, _Track]:
        """Contacts and tracks in pairs, each as near as can be to where it is expected."""
        cost = []
        for track in tracks:
            expected = track.expected(time_s, GATE_SPACINGS * self.spacing_mm)
            cost.append([self._cost(track, expected, contact) for contact in contacts])
        return {column: tracks[row] for row, column in match_pairs(cost)}

    def _cost(self, track: _Track, expected: Place, contact: Contact) -> float:
        """Distance of a contact from where a track is expected, less for markers in common."""
        away = dist(expected, contact.position_mm)
        shared = len(track.markers.intersection(contact.markers))
        reach = GATE_SPACINGS * self.spacing_mm + 0.5 * max(track.size_mm, contact.size_mm)
        if not shared and away > reach:
            return UNPAIRED_COST
        # One that tripped no switch has none.
        return away - self.spacing_mm * shared / max(len(track.markers), 1)

    def _part(
        self, found: dict[int, _Track], row: int, track: _Track, contacts: Sequence[Contact]
    ) -> None:
        """Give contacts that were one for a while their own ids back, where they have parted."""
        if not track.inside:
            return
        pieces = [row] + [
            other
            for other, contact in enumerate(contacts)
            if other not in found and self._was_in(track, contact)
        ]
        if len(pieces) == 1:
            self._hand_over(found, row, track, contacts[row])
            return
        weights = [max(contacts[piece].force_N, 1e-9) for piece in pieces]
        moved = [
            sum(
                w * contacts[piece].position_mm[k] for w, piece in zip(weights, pieces, strict=True)
            )
            / sum(weights)
            - track.merged_at[k]
            for k in range(3)
        ]
        cost = [
            [
                dist(
                    [p + m for p, m in zip(alone.place, moved, strict=True)],
                    contacts[piece].position_mm,
                )
                ** 2
                for piece in pieces
            ]
            for alone in track.inside
        ]
        members, track.inside = track.inside, []
        # More pieces than members leave one without: it is a new contact.
        del self._tracks[track.id], found[row]
        pairs = match_pairs(cost)
        for member, piece in pairs:
            alone = members[member]
            found[pieces[piece]] = self._tracks[alone.id] = alone
        for member, alone in enumerate(members):
            if all(member != known for known, _ in pairs):
                nearest = min(pairs, key=lambda known: cost[member][known[1]])
                self._join(members[nearest[0]], alone, contacts[pieces[nearest[1]]])

    def _was_in(self, track: _Track, contact: Contact) -> bool:
        """Whether a contact lay in another's switches a frame ago, and has not come beside it."""
        if contact.markers:
            return not track.markers.isdisjoint(contact.markers)
        return self._cost(track, track.place, contact) < UNPAIRED_COST

    def _hand_over(
        self, found: dict[int, _Track], row: int, track: _Track, contact: Contact
    ) -> None:
        """Where all but one of merged contacts were lifted, go on with that one's id."""
        now = set(contact.markers)
        left = [alone for alone in track.inside if now & alone.markers]
        if len(left) == 1 and len(now) <= len(left[0].markers) + 1:
            del self._tracks[track.id]
            found[row] = self._tracks[left[0].id] = left[0]

    def _join(self, host: _Track, guest: _Track, contact: Contact) -> None:
        """Note that two contacts are now one."""
        if not host.inside:
            host.inside = [replace(host, inside=[], speed_mm_s=STILL)]
        host.inside += guest.inside or [replace(guest, speed_mm_s=STILL)]
        # Who taps beside a resting hand is in it with each tap: those of long ago are forgotten.
        del host.inside[1 : len(host.inside) - INSIDE_MAX + 1]
        host.merged_at = contact.position_mm
        self._tracks.pop(guest.id, None)

    def _merge_or_miss(
        self, found: dict[int, _Track], contacts: Sequence[Contact], time_s: float
    ) -> None:
        """See where tracks without a contact have gone: into another one, or away."""
        matched = {track.id for track in found.values()}
        for track in [track for track in self._tracks.values() if track.id not in matched]:
            over = [row for row in found if track.markers.intersection(contacts[row].markers)]
            if over:
                self._join(found[over[0]], track, contacts[over[0]])
                continue
            track.absent += 1
            if track.absent > HOLD_FRAMES or time_s - track.seen_s > HOLD_S:
                del self._tracks[track.id]

    def _new(self, contact: Contact, time_s: float) -> _Track:
        track = _Track(
            id=self._next,
            since_s=time_s,
            seen_s=time_s,
            place=contact.position_mm,
            size_mm=contact.size_mm,
            markers=frozenset(contact.markers),
        )
        self._tracks[track.id] = track
        self._next += 1
        return track

    @staticmethod
    def _follow(track: _Track, contact: Contact, time_s: float) -> None:
        """Take over what is seen of it."""
        step = time_s - track.seen_s
        if 0.0 < step <= HOLD_S and not track.inside:
            x, y, z = (
                SPEED_KEPT * v + (1.0 - SPEED_KEPT) * (now - p) / step
                for v, now, p in zip(
                    track.speed_mm_s, contact.position_mm, track.place, strict=True
                )
            )
            track.speed_mm_s = (x, y, z)
        elif step:
            track.speed_mm_s = STILL
        track.seen_s, track.absent = time_s, 0
        track.place, track.size_mm = contact.position_mm, contact.size_mm
        track.markers = frozenset(contact.markers)
