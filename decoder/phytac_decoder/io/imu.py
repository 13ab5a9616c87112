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
from typing import Any, BinaryIO

from phytac_shapes.errors import InputError

LINE_MAX_BYTES = 4096
AHEAD_S = 60.0
"""A sample this far after the frame is an error in its time, unless those behind it are as late."""
CONFIRMED_BY = 8
"""So many samples of a file are read to see that."""

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
        Called once for lines that are no samples, and once for a time far ahead of the others.

    Raises
    ------
    InputError
        If it cannot be opened.
    """

    def __init__(
        self, path: Path, *, clock: Callable[[], float], report: Callable[[str], None]
    ) -> None:
        self._path, self._clock, self._report = path, clock, report
        self._waiting: deque[Sample] = deque(maxlen=4096)
        self._now: Sample | None = None
        self._held = b""
        self._file: BinaryIO | None = None
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._frame_s = math.inf
        self._reported: set[str] = set()
        self.bad_lines = 0
        try:
            mode = path.stat().st_mode
            if stat.S_ISCHR(mode) or stat.S_ISFIFO(mode):
                self._port = os.open(path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            else:
                self._file = path.open("rb")
        except OSError as error:
            raise InputError(
                f"no motion samples at {path} ({error.strerror}); give a file or a port of JSON "
                'lines such as {"t": 0.01, "gyro": [0, 0, 0], "accel": [0, 0, 9.81]}'
            ) from None
        if self.is_port:
            self._thread = threading.Thread(target=self._listen, name="imu", daemon=True)
            self._thread.start()

    @property
    def is_port(self) -> bool:
        """Whether samples arrive as they are taken."""
        return self._file is None

    def latest(self, time_s: float) -> Sample | None:
        """Latest sample not newer than ``time_s``; None while there is none."""
        self._frame_s = time_s
        if self._file is not None and not self._closed.is_set():
            self._read_file(self._file)
        with self._lock:
            while self._waiting and self._waiting[0]["t"] <= time_s:
                self._now = self._waiting.popleft()
            return self._now

    def close(self) -> None:
        """Close file or port."""
        if self._closed.is_set():
            return
        self._closed.set()
        if self._file is not None:
            self._file.close()
        else:
            self._thread.join()
            os.close(self._port)

    def _read_file(self, file: BinaryIO) -> None:
        """Read up to the first sample newer than the frame, or to the end."""
        while self._incomplete():
            more = file.readline(LINE_MAX_BYTES)
            if not more:
                return
            line, self._held = self._held + more, b""
            ends = line.endswith(b"\n") or len(line) >= LINE_MAX_BYTES
            if not ends and _sample(line, None) is None:
                # The rest of it has not been written yet.
                self._held = line
                return
            self._take(line)

    def _incomplete(self) -> bool:
        """Whether the frame's sample may not have been read yet."""
        if not self._waiting or self._waiting[-1]["t"] <= self._frame_s:
            return True
        return self._far(self._waiting[-1]) and len(self._waiting) < CONFIRMED_BY

    def _far(self, sample: Sample) -> bool:
        return bool(sample["t"] > self._frame_s + AHEAD_S)

    def _listen(self) -> None:
        """Take samples from the port as they arrive."""
        held = b""
        while not self._closed.is_set():
            try:
                if not select.select([self._port], [], [], 0.1)[0]:
                    continue
                data = os.read(self._port, 65536)
            except BlockingIOError:
                continue
            except OSError as error:
                self._report(f"{self._path} gives no more motion samples ({error.strerror})")
                return
            if not data:
                # The end, such as of a pipe that nobody writes to.
                self._closed.wait(0.005)
                continue
            *lines, held = (held + data).split(b"\n")
            held = held[-LINE_MAX_BYTES:]
            for line in lines:
                self._take(line)

    def _take(self, line: bytes) -> None:
        if not line.strip():
            return
        sample = _sample(line, self._clock() if self.is_port else None)
        far = None
        with self._lock:
            waiting = self._waiting
            # Samples far ahead are wrong if one that follows them is not.
            while sample and waiting and self._far(waiting[-1]) and sample["t"] < waiting[-1]["t"]:
                far = waiting.pop()
                self.bad_lines += 1
            last = waiting[-1] if waiting else self._now
            good = sample is not None and (last is None or sample["t"] >= last["t"])
            if sample is not None and good:
                waiting.append(sample)
            self.bad_lines += not good
        if far:
            self._report_once(
                "far",
                f"a sample of {far['t']:g} s, far after the frames and those behind it; such are "
                "skipped",
            )
        if not good:
            self._report_once(
                "bad",
                f"{line[:60]!r} is no motion sample, or older than the one before; expected "
                '{"t": seconds, "gyro": [x, y, z], "accel": [x, y, z]}; such lines are skipped',
            )

    def _report_once(self, kind: str, text: str) -> None:
        if kind not in self._reported:
            self._reported.add(kind)
            self._report(f"{self._path}: {text}")


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
