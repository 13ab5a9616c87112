"""Tracking of contacts: an id that stays while a contact moves, merges, splits or is missed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import dist, hypot

import cv2
import numpy as np

from phytac_decoder.estimation.contact_grouping import Contact, Place
from phytac_shapes.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Settings of the tracking, chosen on simulated hands."""

    gate_spacings: float = 2.5
    """Largest distance of a contact from its prediction, in marker spacings, plus its radius."""
    hold_frames: int = 3
    hold_s: float = 0.5
    """A contact that is missing for more frames, or for longer, has ended."""
    velocity_kept: float = 0.5
    """Share of the former velocity in the exponential average."""
    unpaired_cost: float = 1e4
    """Cost of a pair that must not be matched: above all distances in mm, far from the limits of
    float32."""
    merged_max: int = 8
    """Largest number of contacts merged into one."""


SETTINGS = TrackingSettings()


@dataclass(kw_only=True)
class _Track:
    """One contact so far.

    ``inside`` are the contacts, itself among them, that have merged into it, each as it was when
    last separate; ``merged_at`` is the place of the merged contact at that time.
    """

    id: int
    since_s: float
    seen_s: float
    place: Place
    size_mm: float
    markers: frozenset[int]
    velocity_mm_s: Place = (0.0, 0.0, 0.0)
    absent: int = 0
    inside: "list[_Track]" = field(default_factory=list)
    merged_at: Place = (0.0, 0.0, 0.0)

    def predicted(self, time_s: float, distance_max_mm: float) -> Place:
        """Return the place at constant velocity, at most so far from the last one."""
        step = max(time_s - self.seen_s, 0.0)
        far = step * hypot(*self.velocity_mm_s)
        step *= min(1.0, distance_max_mm / far) if far else 1.0
        x, y, z = (p + step * v for p, v in zip(self.place, self.velocity_mm_s, strict=True))
        return x, y, z

    def update(self, contact: Contact, time_s: float) -> None:
        """Take over the contact of a frame."""
        step = time_s - self.seen_s
        if 0.0 < step <= SETTINGS.hold_s and not self.inside:
            x, y, z = (
                SETTINGS.velocity_kept * v + (1.0 - SETTINGS.velocity_kept) * (now - p) / step
                for v, now, p in zip(
                    self.velocity_mm_s, contact.position_mm, self.place, strict=True
                )
            )
            self.velocity_mm_s = (x, y, z)
        elif step:
            self.velocity_mm_s = (0.0, 0.0, 0.0)
        self.seen_s, self.absent = time_s, 0
        self.place, self.size_mm = contact.position_mm, contact.size_mm
        self.markers = frozenset(contact.markers)


def match_pairs(cost: FloatArray) -> list[tuple[int, int]]:
    """Return pairs of rows and columns of costs (r, c): as many as possible, at the least total.

    The earth mover's distance of unit weights is an assignment, and the decoder does without SciPy.
    """
    if not cost.size:
        return []
    rows, columns = (np.ones((count, 1), dtype=np.float32) for count in cost.shape)
    _, _, flow = cv2.EMD(rows, columns, cv2.DIST_USER, cost=cost.astype(np.float32))
    return [(int(row), int(column)) for row, column in np.argwhere(flow > 0.5)]


@dataclass(kw_only=True)
class ContactTracker:
    """Gives the contacts of successive frames their ids, counted from 0.

    Attributes
    ----------
    spacing_mm : float
        Median distance of neighbouring markers.
    """

    spacing_mm: float
    _tracks: dict[int, _Track] = field(default_factory=dict)
    _next: int = 0

    def update(self, contacts: Sequence[Contact], time_s: float) -> list[Contact]:
        """Return the contacts of the next frame, in their order, with id and age.

        Parameters
        ----------
        contacts : sequence of Contact
            Contacts of a frame that could be decoded.
        time_s : float
            Time of the frame.
        """
        self._tracks = {
            number: track
            for number, track in self._tracks.items()
            if not track.absent or time_s - track.seen_s <= SETTINGS.hold_s
        }
        tracks = list(self._tracks.values())
        found = self._by_distance(tracks, contacts, time_s)
        for row, track in list(found.items()):
            if track.inside:
                self._split(found, row, track, contacts)
        self._merge_or_drop(found, contacts, time_s)
        out = []
        for row, contact in enumerate(contacts):
            track = found.get(row) or self._new(contact, time_s)
            track.update(contact, time_s)
            out.append(replace(contact, id=track.id, since_s=track.since_s))
        return out

    def _by_distance(
        self, tracks: Sequence[_Track], contacts: Sequence[Contact], time_s: float
    ) -> dict[int, _Track]:
        """Match contacts and tracks by the distance from the predictions."""
        reach_mm = SETTINGS.gate_spacings * self.spacing_mm
        predicted = [track.predicted(time_s, reach_mm) for track in tracks]
        cost = np.array(
            [
                [self._cost(track, place, contact) for contact in contacts]
                for track, place in zip(tracks, predicted, strict=True)
            ]
        )
        pairs = match_pairs(cost)
        return {
            column: tracks[row]
            for row, column in pairs
            if cost[row, column] < SETTINGS.unpaired_cost
        }

    def _cost(self, track: _Track, predicted: Place, contact: Contact) -> float:
        """Return the distance of a contact from a prediction, less a bonus for shared markers."""
        distance = dist(predicted, contact.position_mm)
        shared = len(track.markers.intersection(contact.markers))
        gate = SETTINGS.gate_spacings * self.spacing_mm + 0.5 * max(track.size_mm, contact.size_mm)
        if not shared and distance > gate:
            return SETTINGS.unpaired_cost
        # An unswitched contact has no markers.
        return distance - self.spacing_mm * shared / max(len(track.markers), 1)

    def _split(
        self, found: dict[int, _Track], row: int, track: _Track, contacts: Sequence[Contact]
    ) -> None:
        """Give merged contacts that have separated their own ids back."""
        pieces = [row] + [
            other
            for other, contact in enumerate(contacts)
            if other not in found and self._was_in(track, contact)
        ]
        if len(pieces) == 1:
            self._restore_last(found, row, track, contacts[row])
            return
        now = np.array([contacts[piece].position_mm for piece in pieces])
        weights = np.maximum([contacts[piece].force_N for piece in pieces], 1e-9)
        moved = weights @ now / weights.sum() - track.merged_at
        before = np.array([member.place for member in track.inside]) + moved
        cost = np.sum((before[:, None] - now) ** 2, axis=2)
        members, track.inside = track.inside, []
        # More pieces than members leave one without: it is a new contact.
        del self._tracks[track.id], found[row]
        pairs = match_pairs(cost)
        for member, piece in pairs:
            found[pieces[piece]] = self._tracks[members[member].id] = members[member]
        for member in sorted(set(range(len(members))) - {member for member, _ in pairs}):
            nearest = min(pairs, key=lambda pair: cost[member, pair[1]])
            self._merge(members[nearest[0]], members[member], contacts[pieces[nearest[1]]])

    def _was_in(self, track: _Track, contact: Contact) -> bool:
        """Return whether a contact was a part of a track in the frame before."""
        if contact.markers:
            return not track.markers.isdisjoint(contact.markers)
        return self._cost(track, track.place, contact) < SETTINGS.unpaired_cost

    def _restore_last(
        self, found: dict[int, _Track], row: int, track: _Track, contact: Contact
    ) -> None:
        """Restore the id of the only merged contact that has not been lifted, if there is one."""
        now = set(contact.markers)
        present = [member for member in track.inside if now & member.markers]
        if len(present) == 1 and len(now) <= len(present[0].markers) + 1:
            del self._tracks[track.id]
            found[row] = self._tracks[present[0].id] = present[0]

    def _merge(self, host: _Track, guest: _Track, contact: Contact) -> None:
        """Note that two contacts are now one."""
        if not host.inside:
            host.inside = [replace(host, inside=[], velocity_mm_s=(0.0, 0.0, 0.0))]
        host.inside += guest.inside or [replace(guest, velocity_mm_s=(0.0, 0.0, 0.0))]
        # Repeated taps next to a resting hand merge each time: the oldest are dropped.
        del host.inside[1 : len(host.inside) - SETTINGS.merged_max + 1]
        host.merged_at = contact.position_mm
        self._tracks.pop(guest.id, None)

    def _merge_or_drop(
        self, found: dict[int, _Track], contacts: Sequence[Contact], time_s: float
    ) -> None:
        """Merge tracks without a contact into another one, or drop them."""
        matched = {track.id for track in found.values()}
        for track in [track for track in self._tracks.values() if track.id not in matched]:
            over = [row for row in found if track.markers.intersection(contacts[row].markers)]
            if over:
                self._merge(found[over[0]], track, contacts[over[0]])
                continue
            track.absent += 1
            if track.absent > SETTINGS.hold_frames or time_s - track.seen_s > SETTINGS.hold_s:
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
