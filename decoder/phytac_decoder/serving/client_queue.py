"""One receiver of a stream: what waits for it, and what it lost by not reading."""

import time
from collections import deque
from typing import Protocol

from phytac_decoder.serving.wire_protocol import framed, with_dropped


class Handle(Protocol):
    """What bytes go out through, without ever waiting."""

    def fileno(self) -> int:
        """Number of the open file."""

    def send(self, data: memoryview, /) -> int:
        """Send some; the number of bytes that went, or BlockingIOError."""

    def recv(self, size: int, /) -> bytes:
        """What came in, or BlockingIOError; empty at the end."""

    def close(self) -> None:
        """Close it."""


class Outlet:
    """A bounded queue before a receiver; where it is full, the oldest message goes.

    A message of which a part is sent is always finished: the stream stays readable.

    Parameters
    ----------
    handle : Handle
        Of the receiver.
    name : str
        Of the receiver, for people.
    framing : str
        One of :data:`phytac_decoder.serving.wire_protocol.FRAMINGS`.
    first : bytes
        JSON of the first message, the hello.
    queue : int
        Messages that may wait.
    patience_s : float or None
        Closed if it takes nothing for this long while something waits; never if None.
    """

    def __init__(
        self,
        handle: Handle,
        name: str,
        *,
        framing: str,
        first: bytes,
        queue: int,
        patience_s: float | None,
    ) -> None:
        self.handle, self.name = handle, name
        self.received_bytes = 0
        self.sent = 0
        self.dropped = 0
        self.ended = False
        self._framing, self._size, self._patience_s = framing, queue, patience_s
        self._waiting: deque[bytes] = deque()
        self._due: bytes | None = None
        self._going = memoryview(framed(with_dropped(first, 0), framing))
        self._moved_s = time.monotonic()

    @property
    def idle(self) -> bool:
        """Whether everything is sent."""
        return not self._going and not self._waiting and self._due is None

    @property
    def stalled(self) -> bool:
        """Whether it has taken nothing for too long."""
        if self._patience_s is None or self.idle:
            return False
        return time.monotonic() - self._moved_s > self._patience_s

    def offer(self, text: bytes) -> int:
        """Queue a message's JSON; the number of older ones that had to go."""
        if self.idle:
            self._moved_s = time.monotonic()
        lost = max(len(self._waiting) + 1 - self._size, 0)
        for _ in range(lost):
            self._waiting.popleft()
        self.dropped += lost
        self._waiting.append(text)
        return lost

    def next(self, text: bytes) -> None:
        """Send a message's JSON before all that waits; it takes no place, and none drives it out.

        One that is still due is replaced.
        """
        if self.idle:
            self._moved_s = time.monotonic()
        self._due = text

    def flush(self) -> None:
        """Send what goes without waiting.

        Raises
        ------
        OSError
            If the receiver is gone.
        """
        while True:
            if not self._going:
                if self.idle:
                    return
                text = self._due or self._waiting.popleft()
                self._due = None
                self._going = memoryview(framed(with_dropped(text, self.dropped), self._framing))
                self.sent += 1
            try:
                went = self.handle.send(self._going)
            except (BlockingIOError, InterruptedError):
                return
            self._going = self._going[went:]
            self._moved_s = time.monotonic()
