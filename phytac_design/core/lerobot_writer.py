"""Episodes as a LeRobot data set, version 3.0 of its layout, written episode by episode.

LeRobot itself is not needed: the layout is JSON and Parquet. It is that of ``lerobot.datasets`` of
LeRobot 0.4, without videos. Each episode is a Parquet file of its own, which the layout allows:
files are complete when an episode ends. Frames of the running one are in a file of plain numbers
until then, of which a killed program loses none: open the folder with ``resume=True``.
"""

import json
import os
from collections.abc import Mapping, Sequence
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from phytac_decoder.serving.wire_protocol import Message
from phytac_design.core.parquet_recording import parquet_library
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError, OutputError, cause_of

VERSION = "v3.0"
FILES_PER_CHUNK = 1000
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
CONTACTS = 4
"""Contacts of a frame of a stream, the strongest first; zeros where there are fewer."""


class Feature(NamedTuple):
    """A column of a data set: numpy's name of its type, its length, and names of its parts."""

    dtype: str
    length: int
    names: Sequence[str] | None = None


OWN = {
    "timestamp": Feature("float32", 1),
    "frame_index": Feature("int64", 1),
    "episode_index": Feature("int64", 1),
    "index": Feature("int64", 1),
    "task_index": Feature("int64", 1),
}
"""Columns that every data set has."""

Statistics = dict[str, FloatArray]


class LeRobotWriter:
    """Writes frames of episodes; an episode is on the disk when it has ended.

    Parameters
    ----------
    folder : Path
        Folder to make.
    fps : int
        Frames per second; a frame's timestamp is its number in the episode over that.
    features : dict
        Columns by name, such as ``observation.force``, ``action``.
    robot_type : str
        As LeRobot names robots.
    resume : bool
        Continue a folder that is there, in the episode that had not ended.

    Attributes
    ----------
    episodes, rows : int
        What the data set has.
    waiting : int
        Frames of the episode that has not ended.

    Raises
    ------
    InputError
        If a feature has a name of LeRobot's own columns, or one with a slash, or a folder to
        continue has other features or another rate.
    MissingPartError
        If pyarrow is not installed.
    OutputError
        If the folder exists, or cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        *,
        fps: int,
        features: Mapping[str, Feature],
        robot_type: str = "phytac",
        resume: bool = False,
    ) -> None:
        self._arrow = parquet_library()
        bad = sorted(name for name in features if name in OWN or "/" in name)
        if bad:
            raise InputError(
                "lerobot-feature-name",
                f"a feature cannot be named {bad[0]!r}: slashes are not allowed, and "
                f"{', '.join(OWN)} are LeRobot's own; choose another name",
            )
        self._folder, self._features = folder, dict(features)
        self._tasks: list[str] = []
        self._frames: list[Mapping[str, Any]] = []
        self._running: FileIO | None = None
        self._statistics: dict[str, Statistics] = {}
        self.episodes, self.rows = 0, 0
        self._info: dict[str, Any] = {
            "codebase_version": VERSION,
            "robot_type": robot_type,
            "total_episodes": 0,
            "total_frames": 0,
            "total_tasks": 0,
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": fps,
            "splits": {},
            "data_path": DATA,
            "video_path": None,
            "features": {
                name: {
                    "dtype": feature.dtype,
                    "shape": [feature.length],
                    "names": list(feature.names) if feature.names else None,
                }
                for name, feature in {**features, **OWN}.items()
            },
        }
        try:
            if resume and folder.is_dir():
                self._continue()
            else:
                folder.mkdir(parents=True)
        except FileExistsError:
            raise OutputError(
                "output-exists", f"{folder} is there already; choose another name, or remove it"
            ) from None
        except (ValueError, KeyError) as error:
            raise InputError(
                "lerobot-resume-invalid",
                f"{folder} is no data set to continue ({cause_of(error)}); choose another name",
            ) from None
        except OSError as error:
            raise self._unwritable(error) from None

    @property
    def waiting(self) -> int:
        """Frames of the episode that has not ended."""
        return len(self._frames)

    @property
    def _journal(self) -> Path:
        """The running episode's frames, one after the other: numbers of 64 bits."""
        return self._folder / f"running-{self.episodes}.f64"

    def _continue(self) -> None:
        """Take up a data set as it is: its episodes, and frames of the one that had not ended."""
        info, parquet = self._folder / "meta" / "info.json", self._arrow.parquet
        if info.is_file():
            found = json.loads(info.read_text(encoding="utf-8"))
            own = json.loads(json.dumps(self._info))
            if any(found[name] != own[name] for name in ("features", "fps")):
                raise InputError(
                    "lerobot-resume-invalid",
                    f"{self._folder} has other features or another rate; choose another name",
                )
            self._info = found
            self.episodes, self.rows = found["total_episodes"], found["total_frames"]
            tasks = parquet.read_table(self._folder / "meta" / "tasks.parquet")
            self._tasks = tasks["__index_level_0__"].to_pylist()
            totals = json.loads((self._folder / "meta" / "stats.json").read_text(encoding="utf-8"))
            self._statistics = {
                name: {kind: np.asarray(value) for kind, value in each.items()}
                for name, each in totals.items()
            }
        if self._journal.is_file():
            ends = np.cumsum([feature.length for feature in self._features.values()])
            values = np.fromfile(self._journal)
            rows = values[: len(values) // ends[-1] * ends[-1]].reshape(-1, ends[-1])
            # Half a frame would shift those after it.
            os.truncate(self._journal, rows.nbytes)
            parts = np.split(rows, ends[:-1], axis=1)
            self._frames = [
                dict(zip(self._features, row, strict=True)) for row in zip(*parts, strict=True)
            ]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        """Leave out an episode that has not ended."""
        self._frames.clear()
        if self._running:
            self._running.close()
        self._journal.unlink(missing_ok=True)

    def add(self, frame: Mapping[str, ArrayLike]) -> None:
        """Add a frame to the episode: a value or an array for each feature.

        Raises
        ------
        InputError
            If a feature is missing, unknown, or of another length.
        """
        wanted = {name: (feature.length,) for name, feature in self._features.items()}
        own = {name: np.atleast_1d(value) for name, value in frame.items()}
        got = {name: value.shape for name, value in own.items()}
        wrong = [name for name in sorted(wanted | got) if wanted.get(name) != got.get(name)]
        if wrong:
            name = wrong[0]
            raise InputError(
                "lerobot-frame-invalid",
                f"feature {name!r} is {got.get(name, 'missing')} in this frame and "
                f"{wanted.get(name, 'missing')} in the data set; give each feature in its shape",
            )
        self._frames.append(own)
        numbers = [np.asarray(own[name], dtype=np.float64) for name in self._features]
        try:
            if self._running is None:
                self._running = self._journal.open("ab", buffering=0)
            self._running.write(np.concatenate(numbers).tobytes())
        except OSError as error:
            raise self._unwritable(error) from None

    def end_episode(self, task: str) -> None:
        """Write the episode; ``task`` says in words what was to be done.

        Raises
        ------
        InputError
            If it has no frame.
        OutputError
            If it cannot be written.
        """
        count, number = len(self._frames), self.episodes
        if not count:
            raise InputError("lerobot-episode-empty", "the episode has no frame; add one first")
        if task not in self._tasks:
            self._tasks.append(task)
        index = np.arange(count)
        columns = {
            name: np.stack([frame[name] for frame in self._frames]).astype(feature.dtype)
            for name, feature in self._features.items()
        }
        columns["timestamp"] = (index / self._info["fps"]).astype(np.float32)[:, None]
        columns["frame_index"] = index[:, None]
        columns["episode_index"] = np.full((count, 1), number)
        columns["index"] = self.rows + index[:, None]
        columns["task_index"] = np.full((count, 1), self._tasks.index(task))
        statistics = {name: statistics_of(values) for name, values in columns.items()}
        chunk, file = divmod(number, FILES_PER_CHUNK)
        place = {"chunk_index": chunk, "file_index": file}
        facts: dict[str, Any] = {
            "episode_index": number,
            "tasks": [task],
            "length": count,
            "data/chunk_index": chunk,
            "data/file_index": file,
            "dataset_from_index": self.rows,
            "dataset_to_index": self.rows + count,
            "meta/episodes/chunk_index": chunk,
            "meta/episodes/file_index": file,
        }
        facts |= {
            f"stats/{name}/{kind}": value.tolist()
            for name, own in statistics.items()
            for kind, value in own.items()
        }
        for name, own in statistics.items():
            before = self._statistics.get(name)
            self._statistics[name] = merged(before, own) if before else own
        ended = self._journal
        self.episodes, self.rows = number + 1, self.rows + count
        self._frames.clear()
        self._info |= {
            "total_episodes": self.episodes,
            "total_frames": self.rows,
            "total_tasks": len(self._tasks),
            "splits": {"train": f"0:{self.episodes}"},
        }
        try:
            self._write_table(DATA.format(**place), self._table(columns))
            self._write_table(
                EPISODES.format(**place),
                self._arrow.table({name: [value] for name, value in facts.items()}),
            )
            self._write_table("meta/tasks.parquet", self._task_table())
            totals = {
                name: {kind: value.tolist() for kind, value in own.items()}
                for name, own in self._statistics.items()
            }
            self._write_json("meta/stats.json", totals)
            # Last: it says how many episodes there are.
            self._write_json("meta/info.json", self._info)
            if self._running:
                self._running.close()
                self._running = None
            ended.unlink(missing_ok=True)
        except OSError as error:
            raise self._unwritable(error) from None

    def _table(self, columns: Mapping[str, Any]) -> Any:
        """Parquet's table of an episode: numbers, and lists of fixed length."""
        arrow, made = self._arrow, {}
        for name, values in columns.items():
            flat = arrow.array(values.ravel())
            length = values.shape[1]
            made[name] = flat if length == 1 else arrow.FixedSizeListArray.from_arrays(flat, length)
        return arrow.table(made)

    def _task_table(self) -> Any:
        """Tasks as pandas stores them: the words are the index."""
        name = "__index_level_0__"
        table = self._arrow.table({"task_index": range(len(self._tasks)), name: self._tasks})
        kinds = (("task_index", "int64", "int64"), (name, "unicode", "object"))
        columns = [
            {
                "name": None if field == name else field,
                "field_name": field,
                "pandas_type": kind,
                "numpy_type": own,
                "metadata": None,
            }
            for field, kind, own in kinds
        ]
        note = {"index_columns": [name], "column_indexes": [], "columns": columns}
        return table.replace_schema_metadata({"pandas": json.dumps(note)})

    def _write_table(self, name: str, table: Any) -> None:
        path = self._folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        half = path.with_name(path.name + ".part")
        self._arrow.parquet.write_table(table, half)
        half.replace(path)

    def _write_json(self, name: str, data: Any) -> None:
        path = self._folder / name
        half = path.with_name(path.name + ".part")
        half.write_text(json.dumps(data, indent=4) + "\n", encoding="utf-8")
        half.replace(path)

    def _unwritable(self, error: OSError) -> OutputError:
        return OutputError(
            "output-not-writable",
            f"{self._folder} cannot be written ({error.strerror or error})",
        )


def statistics_of(values: Any) -> Statistics:
    """Return LeRobot's statistics of a column (n, k): extremes, mean, spread, count, quantiles."""
    each = np.asarray(values, dtype=np.float64)
    out = {
        "min": each.min(axis=0),
        "max": each.max(axis=0),
        "mean": each.mean(axis=0),
        "std": each.std(axis=0),
        "count": np.array([len(each)]),
    }
    return out | {name: np.quantile(each, share, axis=0) for name, share in QUANTILES.items()}


def merged(one: Statistics, two: Statistics) -> Statistics:
    """Return the statistics of two parts together; quantiles are weighted means, as LeRobot's."""
    count = one["count"] + two["count"]
    share = two["count"] / count
    out = {name: one[name] + share * (two[name] - one[name]) for name in ("mean", *QUANTILES)}
    gap = two["mean"] - one["mean"]
    square = one["std"] ** 2 + share * (two["std"] ** 2 - one["std"] ** 2)
    return out | {
        "min": np.minimum(one["min"], two["min"]),
        "max": np.maximum(one["max"], two["max"]),
        "std": np.sqrt(square + share * (1.0 - share) * gap**2),
        "count": count,
    }


def message_features(markers: int) -> dict[str, Feature]:
    """Columns of a stream's frames, of a sensor with so many markers."""
    names = [
        f"{part}_{k}" for k in range(CONTACTS) for part in ("N", "sd_N", "x_mm", "y_mm", "z_mm")
    ]
    axes = ("x", "y", "z")
    return {
        "observation.force": Feature("float32", 3, [f"net_{axis}_N" for axis in axes]),
        "observation.force_sd": Feature("float32", 3, [f"net_sd_{axis}_N" for axis in axes]),
        "observation.contacts": Feature("float32", len(names), names),
        "observation.switches": Feature("float32", markers),
        "observation.valid": Feature("float32", 1),
    }


def message_frame(message: Message, markers: int) -> dict[str, ArrayLike]:
    """Return a stream's frame as a row of :func:`message_features`; zeros where it has nothing."""
    contacts = np.zeros((CONTACTS, 5))
    for row, one in zip(contacts, message["contacts"], strict=False):
        row[:] = one["force_N"], one.get("sd_N", 0.0), *one["position_mm"]
    switches = np.zeros(markers)
    switches[message["koi"]] = 1.0
    return {
        "observation.force": message["net_force_N"],
        "observation.force_sd": message.get("net_force_sd_N", np.zeros(3)),
        "observation.contacts": contacts.ravel(),
        "observation.switches": switches,
        "observation.valid": float(message["valid"]),
    }
