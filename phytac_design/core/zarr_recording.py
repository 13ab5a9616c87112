"""A force stream as Zarr in the layout of FTP-1 and Open-X-Tactile.

The layout is that of ``data_processing`` of FTP-1 (arXiv:2606.13102): Zarr version 2, arrays below
``data`` with one row for each frame, and ``meta/episode_ends``. A tactile group has four arrays,
``SIDE_tactile_{data,area,sensor,type}_GROUP``. Policies of FTP-1 also want a camera's picture and
the robot's state; add arrays of as many rows.
"""

import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from phytac_decoder.serving.wire_protocol import Message
from phytac_design.core.lerobot_writer import CONTACTS, message_frame
from phytac_shapes.errors import InputError, MissingPartError, OutputError

SENSOR = "PhyTac"
CHUNK_s = 0.5
"""Seconds between writes: what a killed program may lose, and less than the second promised."""
CHUNK_ROWS = 256
WORDS = 128
"""Length of instructions."""


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
        Go on with a folder, by a new episode; rows of no episode are cut off.

    Raises
    ------
    InputError
        If a folder to go on with is of another sensor.
    MissingPartError
        If zarr is not installed.
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
        library = zarr_library()
        self._path, self._markers, self._task = path, markers, task[:WORDS]
        self._side, self._area = side, area
        self._waiting: list[Mapping[str, Any]] = []
        self._written_s, self.rows = time.monotonic(), 0
        if path.exists() and not resume:
            raise OutputError(
                "output-exists", f"{path} is there already; choose another name, or remove it"
            )
        first = self._columns([_nothing(markers)])
        try:
            if path.exists():
                self._open(library, first)
            else:
                self._make(library, first)
        except OSError as error:
            raise self._unwritable(error) from None

    def _make(self, library: Any, first: Mapping[str, Any]) -> None:
        """Make the arrays, without rows."""
        half = self._path.with_name(self._path.name + ".part")
        shutil.rmtree(half, ignore_errors=True)
        for name, group in (("data", first), ("meta", {"episode_ends": np.zeros(1, np.int64)})):
            for key, values in group.items():
                library.create_array(
                    half,
                    name=f"{name}/{key}",
                    shape=(0, *values.shape[1:]),
                    chunks=(CHUNK_ROWS, *values.shape[1:]),
                    dtype=values.dtype,
                    zarr_format=2,
                )
        half.replace(self._path)
        self._open(library, first)

    def _open(self, library: Any, first: Mapping[str, Any]) -> None:
        """Open the arrays, and leave out rows that belong to no episode."""
        store = library.open_group(self._path, mode="r+", zarr_format=2)
        self._arrays = {key: store[f"data/{key}"] for key in first if f"data/{key}" in store}
        self._ends = store.get("meta/episode_ends")
        found = {key: array.shape[1:] for key, array in self._arrays.items()}
        if self._ends is None or found != {key: one.shape[1:] for key, one in first.items()}:
            raise InputError(
                "zarr-recording-invalid",
                f"{self._path} is not a recording of a sensor with {self._markers} markers on the "
                f"{self._side} hand; choose another name",
            )
        self._begin = int(self._ends[-1]) if self._ends.shape[0] else 0
        self._count = self._begin

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._write()

    def add(self, message: Message) -> None:
        """Keep a frame; raises OutputError if the disk is full."""
        frame = message_frame(message, self._markers)
        moment = message.get("net_moment_Nmm", np.zeros(3))
        self._waiting.append({**frame, "time": message["timestamp_s"], "moment": moment})
        self.rows += 1
        if time.monotonic() - self._written_s >= CHUNK_s:
            self._write()

    def end_episode(self) -> None:
        """End the episode; what comes next is another one."""
        self._write()
        self._begin = self._count

    def _write(self) -> None:
        """Write what waits; the episode's end comes last, so that it never counts too much."""
        self._written_s = time.monotonic()
        if not self._waiting:
            return
        count = self._count + len(self._waiting)
        assert self._ends is not None  # noqa: S101 - checked when it was opened
        try:
            for key, values in self._columns(self._waiting).items():
                array = self._arrays[key]
                array.resize((count, *values.shape[1:]))
                array[self._count :] = values
            episodes = self._ends.shape[0]
            if self._begin == self._count:
                self._ends.resize((episodes + 1,))
                episodes += 1
            self._ends[episodes - 1] = count
        except OSError as error:
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


def zarr_library() -> Any:
    """Zarr.

    Raises
    ------
    MissingPartError
        If it is not installed.
    """
    try:
        import zarr
    except ImportError:
        raise MissingPartError.of_library("Zarr", "zarr", "zarr") from None
    return zarr


def _nothing(markers: int) -> dict[str, Any]:
    """A frame without contacts, whose columns have the right shapes."""
    message = {"contacts": [], "koi": [], "net_force_N": np.zeros(3), "valid": False}
    return {**message_frame(message, markers), "time": 0.0, "moment": np.zeros(3)}
