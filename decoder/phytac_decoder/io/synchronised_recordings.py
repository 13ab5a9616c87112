"""Recordings of one camera or two, gone through in step."""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from phytac_decoder.io.recorded_frames import ImageSequence

AGREE = 0.55
"""Pictures of one instant are at most so much of an interval apart. Any two are half of it apart or
less; a little more, so that jitter does not part what it just joined."""
RATES_AGREE = 0.05
"""Times of cameras whose intervals differ by a greater share are not of one kind."""
OVERLAP = 0.5
"""Times that share less of the shorter recording than this are of two clocks."""
REMEMBERED = 31
"""Steps that tell a camera's interval; an odd number, so that a gap does not count."""


class InStep:
    """Goes from picture to picture, of two cameras to those that belong together.

    Those are of one instant where both recordings tell times that can be compared, and otherwise
    of one place in the order.

    Parameters
    ----------
    tracks : sequence of Track
        One for each camera.
    report : callable
        Told about pictures that are not there.

    Attributes
    ----------
    by_time : bool
        Whether times tell what belongs together.
    """

    def __init__(self, tracks: Sequence[ImageSequence], report: Callable[[str], None]) -> None:
        self._tracks, self._report = tracks, report
        self._told: set[str] = set()
        self.by_time = len(tracks) > 1 and comparable(*tracks)
        # What a header says of the rate is a first guess.
        self._steps_s = [deque([track.interval_s], REMEMBERED) for track in tracks]
        self._last = [(0, 0.0) for _ in tracks]
        timed = all(track.stamped and track.interval_s > 0.0 for track in tracks)
        if len(tracks) > 1 and timed and not self.by_time:
            said = " and ".join(track.said for track in tracks)
            report(f"the times of {said} cannot be compared; their frames are paired in order")

    def grab(self, number: int) -> int:
        """Go on; how many frames on that is, lost ones included, and 0 after the last.

        Parameters
        ----------
        number : int
            Of the frame that would be next.
        """
        before = [track.at for track in self._tracks]
        more = [self._go_on(camera) for camera in range(len(self._tracks))]
        first = self._counted(before)
        while all(more) and (behind := self._behind()) is not None:
            more[behind] = self._go_on(behind)
        if not all(more):
            self._tell_end(more, number)
            return 0
        each = self._counted(before)
        steps = max(each)
        if steps > 1:
            which = f"frame {number}" if steps == 2 else f"frames {number} to {number + steps - 2}"
            if max(first) > 1:
                why = f"{self._tracks[first.index(max(first))].said} is damaged there"
            else:
                why = f"{self._tracks[each.index(min(each))].said} has none of that time"
            self._report(f"{which} skipped: {why}")
        return steps

    def rewind(self) -> None:
        """Before the first picture."""
        for track in self._tracks:
            track.rewind()
        self._last = [(0, 0.0) for _ in self._tracks]

    def _go_on(self, camera: int) -> bool:
        """To a camera's next picture, and what that tells of its interval."""
        track = self._tracks[camera]
        if not track.grab():
            return False
        if self.by_time:
            now_s = track.time_s()
            at, last_s = self._last[camera]
            if at and now_s > last_s:
                self._steps_s[camera].append((now_s - last_s) / (track.at - at))
            self._last[camera] = track.at, now_s
        return True

    def _counted(self, before: Sequence[int]) -> list[int]:
        return [track.at - at for track, at in zip(self._tracks, before, strict=True)]

    def _behind(self) -> int | None:
        """The camera that has to go on alone; None if they belong together."""
        if self.by_time:
            places: list[float] = [last_s for _, last_s in self._last]
            behind = places.index(min(places))
            apart = AGREE * float(np.median(self._steps_s[behind]))
        else:
            places = [track.at for track in self._tracks]
            behind, apart = places.index(min(places)), 0.0
        return behind if max(places) - min(places) > apart else None

    def _tell_end(self, more: Sequence[bool], number: int) -> None:
        """Say what ends too early."""
        for track, goes_on in zip(self._tracks, more, strict=True):
            expected = track.announced or 0
            if goes_on or track.at >= expected or track.said in self._told:
                continue
            self._told.add(track.said)
            self._report(
                f"{track.said} ends after {track.at} frames, and its header speaks of {expected}: "
                "it may be cut off or damaged (some formats only estimate that number)"
            )
        if any(more):
            short = self._tracks[list(more).index(False)].said
            self._report(f"{short} ends after {number} frames, before the other camera's")


def comparable(near: ImageSequence, far: ImageSequence) -> bool:
    """Whether the times of two recordings are of one clock, as far as can be told."""
    rates = near.interval_s, far.interval_s
    if not (near.stamped and far.stamped and min(rates) > 0.0):
        return False
    if max(rates) - min(rates) > RATES_AGREE * max(rates):
        return False
    firsts, lasts = zip(near.span_s, far.span_s, strict=True)
    shorter = min(last - first for first, last in (near.span_s, far.span_s))
    return min(lasts) - max(firsts) >= OVERLAP * shorter
