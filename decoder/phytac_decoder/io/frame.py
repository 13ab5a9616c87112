"""Frames, and the interface of their sources."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

from phytac_shapes.arrays import ImageArray


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One frame of each camera, of one instant.

    Attributes
    ----------
    number : int
        In its source, from 0; frames that were lost count.
    timestamp_s : float
        When it was taken, on the source's clock.
    images : tuple of (h, w, 3) uint8
        BGR, the near end's camera first; empty while a camera is lost.
    ready_s : float
        ``time.monotonic()`` at which it was available.
    gap_s : float
        Time without pictures before it, where the camera was lost; else 0.
    """

    number: int
    timestamp_s: float
    images: tuple[ImageArray, ...]
    ready_s: float
    gap_s: float = 0.0


class Source(ABC):
    """Frames in order, as an iterator.

    Attributes
    ----------
    description : str
        Description of where they come from.
    clock : str
        Description of what timestamps count.
    live : bool
        Whether they are being taken now.
    skipped : int
        Frames so far that could not be read.
    missed : int
        Frames so far that passed while an earlier one was decoded.
    """

    description: str
    clock: str
    live: bool = False
    skipped: int = 0
    missed: int = 0

    @abstractmethod
    def __iter__(self) -> Iterator[Frame]: ...

    def restart(self) -> None:
        """Count lost frames from now on, and of a camera all frames and time."""
        self.missed = self.skipped = 0

    @abstractmethod
    def close(self) -> None:
        """Close files and cameras."""
