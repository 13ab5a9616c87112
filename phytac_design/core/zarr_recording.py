"""A force stream as Zarr in the layout of FTP-1 and Open-X-Tactile.

The layout is that of ``data_processing`` of FTP-1 (arXiv:2606.13102): Zarr version 2, arrays below
``data`` with one row for each frame, and ``meta/episode_ends``. A tactile group has four arrays,
``SIDE_tactile_{data,area,sensor,type}_GROUP``. Policies of FTP-1 also want a camera's picture and
the robot's state; add arrays of as many rows.

Version 2 is JSON and compressed bytes, and is written here: the library takes 0.1 s to append some
rows to all arrays, and longer the more there are.
"""

import json
import math
import shutil
import time
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from phytac_decoder.serving.wire_protocol import Message
from phytac_design.core.lerobot_writer import CONTACTS, message_frame
from phytac_design.core.ros2_messages import moment_at_origin
from phytac_shapes.errors import InputError, OutputError, cause_of

SENSOR = "PhyTac"
CHUNK_s = 0.5
"""Seconds between writes: what a killed program may lose, and less than the second promised."""
CHUNK_ROWS = 256
WORDS = 64
"""Length of instructions."""


class ZarrArray:
    """An array of version 2 that grows by rows.

    Parameters
    ----------
    folder : Path
        Of the array; its parent is there.
    like : array
        Of the type and the shape of rows that it has.
    """

    def __init__(self, folder: Path, like: Any) -> None:
        self._folder, self._dtype, self._row = folder, like.dtype, like.shape[1:]
        self.count, self._tail = 0, like[:0]

    def read(self, count: int | None = None) -> Any:
        """Read what is on the disk, and continue after ``count`` rows; returns these.

        Raises
        ------
        ValueError
            If it is another array, or shorter.
        """
        about = json.loads((self._folder / ".zarray").read_text(encoding="utf-8"))
        own = self._about(about["shape"][0])
        if any(about.get(name) != value for name, value in own.items()):
            raise ValueError(f"{self._folder.name} is {about}, not {own}")
        if count is None:
            count = about["shape"][0]
        if count > about["shape"][0]:
            raise ValueError(f"{self._folder.name} has fewer than {count} rows")
        chunks = [self._chunk(number) for number in range(math.ceil(count / CHUNK_ROWS))]
        rows = np.concatenate([self._tail[:0], *chunks])[:count]
        self.count, self._tail = count, rows[count // CHUNK_ROWS * CHUNK_ROWS :]
        return rows

    def _chunk(self, number: int) -> Any:
        data = zlib.decompress(self._place(number).read_bytes())
        return np.frombuffer(data, self._dtype).reshape(CHUNK_ROWS, *self._row)

    def append(self, rows: Any) -> None:
        """Write rows: those of the last chunk again with them, then the array's length."""
        number = self.count // CHUNK_ROWS
        waiting = np.concatenate([self._tail, rows.astype(self._dtype, copy=False)])
        for begin in range(0, len(waiting), CHUNK_ROWS):
            block = waiting[begin : begin + CHUNK_ROWS]
            whole = np.zeros((CHUNK_ROWS, *self._row), self._dtype)
            whole[: len(block)] = block
            _write(self._place(number + begin // CHUNK_ROWS), zlib.compress(whole.tobytes(), 1))
        self.count += len(rows)
        self._tail = waiting[len(waiting) // CHUNK_ROWS * CHUNK_ROWS :]
        about = json.dumps(self._about(self.count))
        _write(self._folder / ".zarray", about.encode())

    def rewrite(self, rows: Any) -> None:
        """Write rows in place of all that it has."""
        self.count, self._tail = 0, self._tail[:0]
        self.append(rows)

    def _place(self, number: int) -> Path:
        return self._folder / ".".join([str(number), *("0" for _ in self._row)])

    def _about(self, count: int) -> dict[str, Any]:
        return {
            "zarr_format": 2,
            "shape": [count, *self._row],
            "chunks": [CHUNK_ROWS, *self._row],
            "dtype": self._dtype.str,
            "compressor": {"id": "zlib", "level": 1},
            "fill_value": {"U": "", "b": False}.get(self._dtype.kind, 0),
            "order": "C",
            "filters": None,
        }


def _write(path: Path, data: bytes) -> None:
    """Write a file that is whole at every moment."""
    half = path.with_name(path.name + ".part")
    half.write_bytes(data)
    half.replace(path)


class ZarrRecorder:
    """Writes frames twice a second; ``meta/episode_ends`` counts those that are written.

    Parameters
    ----------
    path : Path
        Folder to make, ``TASK.zarr`` by custom.
    markers : int
        Of the sensor.
    task : str
        What is done, in words: ``sub_task_instruction``.
    side : str
        Hand that the sensor is on.
    area : int
        FTP-1's number of its functional area; 0 and 1 are the two pads of a gripper.
    resume : bool
        Continue a folder, by a new episode; rows of no episode are cut off.

    Raises
    ------
    InputError
        If a folder to continue is of another sensor.
    OutputError
        If the folder exists, or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        markers: int,
        *,
        task: str = "touch",
        side: Literal["left", "right"] = "right",
        area: int = 0,
        resume: bool = False,
    ) -> None:
        self._path, self._markers, self._task = path, markers, task[:WORDS]
        self._side, self._area = side, area
        self._waiting: list[Mapping[str, Any]] = []
        self._broken = False
        self._written_s, self.rows = time.monotonic(), 0
        if path.exists() and not resume:
            raise OutputError(
                "output-exists", f"{path} is there already; choose another name, or remove it"
            )
        like = self._columns([_nothing(markers)])
        self._arrays = {key: ZarrArray(path / "data" / key, one) for key, one in like.items()}
        self._end_array = ZarrArray(path / "meta" / "episode_ends", np.zeros(1, dtype=np.int64))
        self._ends: list[int] = []
        try:
            if path.exists():
                self._continue()
            else:
                self._make()
        except OSError as error:
            raise self._unwritable(error) from None
        self._begin = self._count = self._ends[-1] if self._ends else 0

    def _make(self) -> None:
        """Make the arrays, without rows."""
        half = self._path.with_name(self._path.name + ".part")
        shutil.rmtree(half, ignore_errors=True)
        for group in (".", "data", "meta"):
            (half / group).mkdir(parents=True, exist_ok=True)
            (half / group / ".zgroup").write_text('{"zarr_format": 2}', encoding="utf-8")
        for key in self._arrays:
            (half / "data" / key).mkdir()
        (half / "meta" / "episode_ends").mkdir()
        half.replace(self._path)
        for key, one in self._columns([_nothing(self._markers)]).items():
            self._arrays[key].append(one[:0])
        self._end_array.append(np.zeros(0, dtype=np.int64))

    def _continue(self) -> None:
        """Continue arrays that are there, after the last episode's end."""
        try:
            self._ends = self._end_array.read().tolist()
            for array in self._arrays.values():
                array.read(self._ends[-1] if self._ends else 0)
        except (FileNotFoundError, KeyError, TypeError, ValueError, zlib.error) as error:
            raise InputError(
                "zarr-recording-invalid",
                f"{self._path} is not a recording of a sensor with {self._markers} markers on the "
                f"{self._side} hand ({cause_of(error)}); choose another name",
            ) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.flush()

    def add(self, message: Message) -> None:
        """Keep a frame; raises OutputError if the disk is full."""
        frame = message_frame(message, self._markers)
        moment = moment_at_origin(message) if "net_moment_Nmm" in message else np.zeros(3)
        self._waiting.append({**frame, "time": message["timestamp_s"], "moment": moment})
        self.rows += 1
        if time.monotonic() - self._written_s >= CHUNK_s:
            self.flush()

    def end_episode(self) -> None:
        """End the episode; what comes next is another one."""
        self.flush()
        self._begin = self._count

    def flush(self) -> None:
        """Write what waits; the episode's end comes last, so that it never counts too much."""
        self._written_s = time.monotonic()
        if not self._waiting or self._broken:
            return
        count = self._count + len(self._waiting)
        try:
            for key, values in self._columns(self._waiting).items():
                self._arrays[key].append(values)
            if self._begin == self._count:
                self._ends.append(count)
            self._ends[-1] = count
            self._end_array.rewrite(np.array(self._ends, dtype=np.int64))
        except OSError as error:
            # Some arrays have these rows, and others not: nothing more may follow.
            self._broken = True
            raise self._unwritable(error) from None
        self._count = count
        self._waiting.clear()

    def _columns(self, frames: list[Mapping[str, Any]]) -> dict[str, Any]:
        """Rows of all arrays below ``data``."""
        count = len(frames)

        def stacked(*names: str) -> Any:
            rows = [np.concatenate([np.ravel(frame[name]) for name in names]) for frame in frames]
            return np.array(rows, dtype=np.float32)[:, None]

        groups = {
            # Net force (N) and moment (N·mm), standard deviations of the force.
            "wrench": (stacked("observation.force", "moment", "observation.force_sd"), "state"),
            # Force, standard deviation (N) and place (mm) of the strongest contacts.
            "contacts": (
                stacked("observation.contacts").reshape(count, 1, CONTACTS, 5),
                "state",
            ),
            "switches": (stacked("observation.switches"), "binary"),
        }
        out = {
            "timestamps": np.array([frame["time"] for frame in frames], dtype=np.float64),
            "sub_task_instruction": np.full(count, self._task, dtype=f"<U{WORDS}"),
            "phytac_valid": np.array([frame["observation.valid"] for frame in frames]) > 0.0,
        }
        for group, (values, kind) in groups.items():
            own = {
                "data": values,
                "area": np.full((count, 1), self._area, dtype=np.int64),
                "sensor": np.full(count, SENSOR, dtype="<U16"),
                "type": np.full(count, kind, dtype="<U8"),
            }
            out |= {f"{self._side}_tactile_{part}_{group}": array for part, array in own.items()}
        return out

    def _unwritable(self, error: OSError) -> OutputError:
        reason = error.strerror or error
        return OutputError("output-not-writable", f"{self._path} cannot be written ({reason})")


def _nothing(markers: int) -> dict[str, Any]:
    """A frame without contacts, whose columns have the right shapes."""
    message = {"contacts": [], "koi": [], "net_force_N": np.zeros(3), "valid": False}
    return {**message_frame(message, markers), "time": 0.0, "moment": np.zeros(3)}
