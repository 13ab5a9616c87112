"""Samples of a motion sensor (IMU) from a file or a port, merged into frames by their times."""

import json
import math
import os
import select
import stat
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from phytac_shapes.errors import InputError

Sample = dict[str, Any]


class Imu:
    """Lines of JSON: ``{"t": seconds, "gyro": [x, y, z], "accel": [x, y, z]}``.

    A file is read as frames come, also one that is still being written. A port (a serial device or
    a named pipe) is read by a thread and never waited for; a sample without ``t`` gets the time at
    which it arrived.

    Parameters
    ----------
    path : Path
        File or port.
    clock : callable
        Seconds on the frames' clock, for samples that have no time.
    report : callable
        Called once for lines that are no samples, or are out of order.

    Raises
    ------
    InputError
        If it cannot be opened.
    """

    line_max_bytes = 4096
    ahead_s = 60.0
    """A sample this far after the frame is an error in its time, if one behind it is earlier."""

    def __init__(
        self, path: Path, *, clock: Callable[[], float], report: Callable[[str], None]
    ) -> None:
        self._path, self._clock, self._report = path, clock, report
        self._waiting: deque[Sample] = deque(maxlen=4096)
        self._now: Sample | None = None
        self._held = b""
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._frame_s = math.inf
        self.bad_lines = 0
        try:
            self._handle = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            os.read(self._handle, 0)  # fails for a folder
        except OSError as error:
            raise InputError(
                "file-unreadable",
                f"no motion samples at {path} ({error.strerror}); give a file or a port of JSON "
                'lines such as {"t": 0.01, "gyro": [0, 0, 0], "accel": [0, 0, 9.81]}',
            ) from None
        mode = os.fstat(self._handle).st_mode
        self.is_port = stat.S_ISCHR(mode) or stat.S_ISFIFO(mode)
        """Whether samples arrive as they are taken."""
        if self.is_port:
            self._thread = threading.Thread(target=self._listen, name="imu", daemon=True)
            self._thread.start()

    def latest(self, time_s: float) -> Sample | None:
        """Latest sample not newer than ``time_s``; None while there is none."""
        self._frame_s = time_s
        if not self.is_port and not self._closed.is_set():
            while self._needs_more() and self._read():
                pass
        with self._lock:
            while self._waiting and self._waiting[0]["t"] <= time_s:
                self._now = self._waiting.popleft()
            return self._now

    def close(self) -> None:
        """Close file or port."""
        if self._closed.is_set():
            return
        self._closed.set()
        if self.is_port:
            self._thread.join()
        os.close(self._handle)

    def _needs_more(self) -> bool:
        """Whether the frame's sample may not have been read from the file yet."""
        ahead = self._waiting[-1]["t"] - self._frame_s if self._waiting else 0.0
        return not 0.0 < ahead <= self.ahead_s and len(self._waiting) < 1000

    def _read(self) -> bool:
        """Take the lines that can be read now; False at the end, which may be of today."""
        data = os.read(self._handle, 65536)
        *lines, self._held = (self._held + data).split(b"\n")
        if not data and _sample(self._held, None):
            lines, self._held = [self._held], b""
        self._held = self._held[-self.line_max_bytes :]
        for line in lines:
            if line.strip():
                self._take(line)
        return bool(data)

    def _listen(self) -> None:
        """Take samples from the port as they arrive."""
        while not self._closed.is_set():
            try:
                if select.select([self._handle], [], [], 0.1)[0] and not self._read():
                    # The end, such as of a pipe that nobody writes to.
                    self._closed.wait(0.005)
            except BlockingIOError:
                continue
            except OSError as error:
                self._report(f"{self._path} gives no more motion samples ({error.strerror})")
                return

    def _take(self, line: bytes) -> None:
        sample = _sample(line, self._clock() if self.is_port else None)
        bad, waiting = 0, self._waiting
        with self._lock:
            # Samples far ahead are wrong if one that follows them is not.
            latest_s = self._frame_s + self.ahead_s
            while sample and waiting and waiting[-1]["t"] > max(latest_s, sample["t"]):
                waiting.pop()
                bad += 1
            last = waiting[-1] if waiting else self._now
            if sample and (last is None or sample["t"] >= last["t"]):
                waiting.append(sample)
            else:
                bad += 1
        if bad and not self.bad_lines:
            self._report(
                f"{self._path}: {line[:60]!r} is no motion sample, or out of order; expected "
                '{"t": seconds, "gyro": [x, y, z], "accel": [x, y, z]}; such lines are skipped'
            )
        self.bad_lines += bad


def _sample(line: bytes, arrived_s: float | None) -> Sample | None:
    """A sample with finite numbers only, or None."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(data, dict):
        return None
    time_s = data.get("t", arrived_s)
    vectors = {name: data[name] for name in ("gyro", "accel") if name in data}
    good = all(
        isinstance(vector, list) and len(vector) == 3 and all(map(_finite, vector))
        for vector in vectors.values()
    )
    if time_s is None or not (good and vectors and _finite(time_s)):
        return None
    return {"t": float(time_s), **vectors}


def _finite(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False
