"""Recordings of one camera or two, gone through in step."""

from collections.abc import Callable, Sequence

from decoder.tracks import Track


class InStep:
    """Goes from picture to picture, of two cameras to those that belong together.

    Parameters
    ----------
    tracks : sequence of Track
        One for each camera.
    report : callable
        Told about pictures that are not there.
    """

    def __init__(self, tracks: Sequence[Track], report: Callable[[str], None]) -> None:
        self._tracks, self._report = tracks, report
        self._told: set[str] = set()

    def grab(self, number: int) -> int:
        """Go on; how many frames on that is, lost ones included, and 0 after the last.

        Parameters
        ----------
        number : int
            Of the frame that would be next.
        """
        before = [track.at for track in self._tracks]
        more = [track.grab() for track in self._tracks]
        damaged = self._ahead()
        while all(more) and (behind := self._behind()) is not None:
            more[behind] = self._tracks[behind].grab()
        if not all(more):
            self._tell_end(more, number)
            return 0
        steps = max(track.at - at for track, at in zip(self._tracks, before, strict=True))
        if steps > 1:
            which = f"frame {number}" if steps == 2 else f"frames {number} to {number + steps - 2}"
            self._report(f"{which} skipped: {self._tracks[damaged].said} is damaged there")
        return steps

    def rewind(self) -> None:
        """Before the first picture."""
        for track in self._tracks:
            track.rewind()

    def _ahead(self) -> int:
        places = [track.at for track in self._tracks]
        return places.index(max(places))

    def _behind(self) -> int | None:
        """The camera that has to go on alone; None if all are where they should be."""
        places = [track.at for track in self._tracks]
        return places.index(min(places)) if min(places) < max(places) else None

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
