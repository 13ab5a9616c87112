"""Samples of a motion sensor (IMU) from a file or a port, merged into frames by their times."""

import json
import math
import os
import stat
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from shapes.errors import InputError

LINE_MAX_BYTES = 4096
HELD = 4096
"""Samples of a port that wait for the frame they belong to."""
AXES = 3


class Imu:
    """Lines of JSON: ``{"t": seconds, "gyro": [x, y, z], "accel": [x, y, z]}``.

    A file is read as frames go on. A port (a serial device or a named pipe) is read without ever
    waiting for it; a sample without ``t`` gets the time at which it arrived.

    Parameters
    ----------
    path : Path
        File or port.
    clock : callable
        Seconds on the frames' clock, for samples that have no time.
    report : callable
        Told once about lines that are no samples.

    Raises
    ------
    InputError
        If it cannot be opened.
    """

    def __init__(
        self, path: Path, *, clock: Callable[[], float], report: Callable[[str], None]
    ) -> None:
        self._path, self._clock, self._report = path, clock, report
        self._waiting: deque[dict[str, Any]] = deque(maxlen=HELD)
        self._now: dict[str, Any] | None = None
        self._held = b""
        self._lines: Iterator[bytes] | None = None
        self._port = -1
        self.bad_lines = 0
        try:
            mode = path.stat().st_mode
            if stat.S_ISCHR(mode) or stat.S_ISFIFO(mode):
                self._port = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            else:
                self._file = path.open("rb")
                self._lines = iter(lambda: self._file.readline(LINE_MAX_BYTES), b"")
        except OSError as error:
            raise InputError(
                f"no motion samples at {path} ({error.strerror}); give a file or a port of JSON "
                'lines such as {"t": 0.01, "gyro": [0, 0, 0], "accel": [0, 0, 9.81]}'
            ) from None

    @property
    def is_port(self) -> bool:
        """Whether samples come as they are taken."""
        return self._lines is None

    def latest(self, time_s: float) -> dict[str, Any] | None:
        """Latest sample not newer than ``time_s``; None while there is none."""
        if self._lines is None:
            self._read_port()
        else:
            while not self._waiting or self._waiting[-1]["t"] <= time_s:
                line = next(self._lines, b"")
                if not line:
                    break
                self._take(line)
        while self._waiting and self._waiting[0]["t"] <= time_s:
            self._now = self._waiting.popleft()
        return self._now

    def close(self) -> None:
        """Close file or port."""
        if self._port >= 0:
            os.close(self._port)
            self._port = -1
        elif self._lines is not None:
            self._file.close()
            self._lines = iter(())

    def _read_port(self) -> None:
        while self._port >= 0:
            try:
                data = os.read(self._port, 65536)
            except BlockingIOError:
                return
            except OSError as error:
                self._report(f"{self._path} gives no more motion samples ({error.strerror})")
                self.close()
                return
            if not data:
                return
            *lines, self._held = (self._held + data).split(b"\n")
            self._held = self._held[-LINE_MAX_BYTES:]
            for line in lines:
                self._take(line)

    def _take(self, line: bytes) -> None:
        if not line.strip():
            return
        sample = _sample(line, None if self._lines is not None else self._clock())
        last = self._waiting[-1] if self._waiting else self._now
        if sample is None or (last is not None and sample["t"] < last["t"]):
            self.bad_lines += 1
            if self.bad_lines == 1:
                self._report(
                    f"{self._path}: {line[:60]!r} is no motion sample, or older than the one "
                    'before; expected {"t": seconds, "gyro": [x, y, z], "accel": [x, y, z]}; such '
                    "lines are skipped"
                )
            return
        self._waiting.append(sample)


def _sample(line: bytes, arrived_s: float | None) -> dict[str, Any] | None:
    """A sample with finite numbers alone, or None."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(data, dict):
        return None
    time_s = data.get("t", arrived_s)
    vectors = {name: data[name] for name in ("gyro", "accel") if name in data}
    good = (
        _finite(time_s)
        and vectors
        and all(
            isinstance(vector, list) and len(vector) == AXES and all(map(_finite, vector))
            for vector in vectors.values()
        )
    )
    return {"t": float(time_s), **vectors} if good and time_s is not None else None


def _finite(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False
