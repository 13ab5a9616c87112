"""Marker displacements with wrenches from ROS 2 messages in MCAP files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phytac_design.core.mcap_recording import TOPICS, mcap_messages, mcap_topics
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import InputError

GAP_ns = 1_000_000_000
"""A longer time between two pairs begins a new episode, and clocks differ by less."""
NUMBERS_MAX = 30_000
"""Of a message; pictures have more."""
PARTS = (
    ("markers",),
    ("force", "torque"),
    ("x", "y", "z"),
    ("x", "y"),
    ("wrench",),
    ("vector",),
    ("position",),
    ("pose",),
    ("poses",),
    ("points",),
)
"""Fields that hold a message's numbers: the first of these that it has."""
ADD = 0
"""``Marker.ADD``."""
CLOUD_NUMBERS = {7: "f4", 8: "f8"}
"""``PointField.FLOAT32`` and ``FLOAT64``."""


class Recorded(NamedTuple):
    """Messages of a topic.

    Attributes
    ----------
    recorded_ns, stamp_ns : (n,) int
        Unix times when they were recorded, and of their headers; 0 without one.
    values : (n, k) float
        Their numbers.
    """

    recorded_ns: IntArray
    stamp_ns: IntArray
    values: FloatArray


def mcap_recordings(source: Path) -> list[list[Path]]:
    """MCAP files of each recording: a file, or the parts of a bag (beside a ``metadata.yaml``).

    There are none if the path is neither such a file nor a folder with some.
    """
    if source.suffix.lower() == ".mcap" and not source.is_dir():
        return [[source]]
    found: dict[Path, list[Path]] = {}
    for path in sorted([*source.glob("*.mcap"), *source.glob("*/*.mcap")]):
        bag = (path.parent / "metadata.yaml").is_file()
        found.setdefault(path.parent if bag else path, []).append(path)
    return list(found.values())


def read_marker_messages(
    recordings: Sequence[Sequence[Path]], markers: str, wrench: str
) -> tuple[FloatArray, FloatArray, IntArray, list[str]]:
    """Pairs of marker and wrench messages.

    A wrench belongs to the marker message that is nearest in time, within half the median period of
    the markers. Of several wrenches of one marker message the nearest is taken.

    Parameters
    ----------
    recordings : list of list of Path
        Files of each recording.
    markers, wrench : str
        Topics, or ``TOPIC.FIELD``.

    Returns
    -------
    seen : (n, k) float
        Numbers of the marker messages, in their unit.
    felt : (n, c) float
        Those of the wrenches: N and N m, if they are ROS's.
    ends : (m,) int
        Ends of episodes.
    notes : list of str
        What was left out or assumed.

    Raises
    ------
    InputError
        If a file has no such topic, or messages do not fit.
    MissingPartError
        If mcap-ros2-support is not installed.
    """
    notes = [
        f"{name} is what a decoder reported, and not measured"
        for name in (markers, wrench)
        if name.startswith(TOPICS) and not name.startswith(f"{TOPICS}switches")
    ]
    seen, felt, begins, count = list[FloatArray](), list[FloatArray](), list[IntArray](), 0
    for files in recordings:
        marks, forces = _read(files, (markers, wrench))
        times, clock = _times_ns(marks, forces)
        frame, sample = _paired(*times)
        where = ", ".join(str(file) for file in files)
        if not len(frame):
            raise InputError(
                "marker-data-array",
                f"{where}: no message of {wrench} is within half a period of one of {markers}: "
                f"{_span(times[0])} and {_span(times[1])} by {clock}",
            )
        if clock != "their headers":
            notes.append(f"{where}: messages are paired by {clock}: headers have no common clock")
        if len(frame) < min(len(marks.values), len(forces.values)):
            notes.append(
                f"{where}: {len(frame)} pairs of {len(marks.values)} and {len(forces.values)} "
                "messages; the others have no partner in time"
            )
        gaps = np.flatnonzero(np.diff(times[0][frame]) > GAP_ns) + 1
        begins.append(count + np.concatenate([[0], gaps]))
        seen.append(marks.values[frame])
        felt.append(forces.values[sample])
        count += len(frame)
    ends = np.append(np.concatenate(begins)[1:], count)
    return _joined(seen, markers), _joined(felt, wrench), ends, notes


def _asked(files: Sequence[Path], names: tuple[str, str]) -> list[tuple[str, str]]:
    """Topic and field of each name."""
    has: dict[str, str] = {}
    for file in files:
        has |= mcap_topics(file)
    asked = []
    for name in names:
        topic, _, field = (name, "", "") if name in has else name.partition(".")
        if topic not in has:
            text = ", ".join(f"{each} ({kind})" for each, kind in sorted(has.items())) or "none"
            raise InputError(
                "marker-data-array", f"{files[0]} has no topic {name} (it has: {text})"
            )
        asked.append((topic, field))
    return asked


def _read(files: Sequence[Path], names: tuple[str, str]) -> list[Recorded]:
    """Messages of two topics of a recording."""
    asked = _asked(files, names)
    rows: list[list[tuple[int, int, FloatArray]]] = [[], []]
    for file in files:
        for message in mcap_messages(file, {topic for topic, _ in asked}):
            for own, (topic, field) in zip(rows, asked, strict=True):
                if topic == message.topic:
                    values = _numbers_of(message.fields, topic, field)
                    if len(values):  # a message may only delete
                        own.append((message.recorded_ns, _stamp_ns(message.fields), values))
    out = []
    for name, own in zip(names, rows, strict=True):
        if not own:
            raise InputError("marker-data-array", f"{files[0]} has no message of {name}")
        recorded, stamps, numbers = zip(*own, strict=True)
        out.append(Recorded(np.array(recorded), np.array(stamps), _joined(numbers, name)))
    return out


def _joined(values: Sequence[FloatArray], name: str) -> FloatArray:
    """Rows below each other, which must have the same number of columns."""
    sizes = sorted({each.shape[-1] for each in values})
    if len(sizes) > 1:
        raise InputError(
            "marker-data-array",
            f"messages of {name} have {sizes[0]} to {sizes[-1]} numbers; each must have all "
            "markers, in the same order",
        )
    return np.vstack(values)


def _times_ns(marks: Recorded, forces: Recorded) -> tuple[tuple[IntArray, IntArray], str]:
    """Times of both topics by one clock, and its name.

    Headers tell when something was measured, but perhaps by clocks of their own.
    """
    pair = marks, forces
    late = [float(np.median(each.recorded_ns - each.stamp_ns)) for each in pair]
    if all(each.stamp_ns.all() for each in pair) and abs(late[0] - late[1]) < GAP_ns:
        return (marks.stamp_ns, forces.stamp_ns), "their headers"
    return (marks.recorded_ns, forces.recorded_ns), "the time of recording"


def _paired(marks_ns: IntArray, forces_ns: IntArray) -> tuple[IntArray, IntArray]:
    """Indices of messages that belong together, in order of time."""
    order = np.argsort(marks_ns, kind="stable")
    times = marks_ns[order]
    period = np.diff(times)
    near = np.searchsorted(times[:-1] + period // 2, forces_ns)
    apart = np.abs(forces_ns - times[near])
    ranked = np.lexsort((apart, near))
    _, first = np.unique(near[ranked], return_index=True)
    sample = ranked[first]
    sample = sample[2 * apart[sample] <= (np.median(period) if len(period) else 0)]
    return order[near[sample]], sample


def _span(times_ns: IntArray) -> str:
    return f"{1e-9 * times_ns.min():.3f} to {1e-9 * times_ns.max():.3f} s"


def _stamp_ns(message: Any) -> int:
    """Time of a message's header, or of the first marker's; 0 if it has none."""
    inside = getattr(message, "markers", None) or [message]
    stamp = getattr(getattr(inside[0], "header", None), "stamp", None)
    return 10**9 * stamp.sec + stamp.nanosec if stamp else 0


def _numbers_of(message: Any, topic: str, field: str) -> FloatArray:
    """Numbers of a message, or of a field of it such as ``pose.position``."""
    try:
        value = message
        for name in field.split(".") if field else ():
            value = getattr(value, name)
        numbers = _numbers(value)
    except (AttributeError, TypeError, ValueError) as error:
        has = ", ".join(getattr(message, "__slots__", ()))
        raise InputError(
            "marker-data-array",
            f"{topic} has no numbers at {field or 'its top'} ({error}); give {topic}.FIELD, whose "
            f"fields are {has}",
        ) from None
    if len(numbers) > NUMBERS_MAX:
        raise InputError(
            "marker-data-array",
            f"a message of {topic} has {len(numbers)} numbers, more than {NUMBERS_MAX}: markers "
            "are needed, not pictures",
        )
    return numbers


def _numbers(value: Any) -> FloatArray:
    """Numbers in a part of a message."""
    if isinstance(value, bytes):
        return np.frombuffer(value, dtype=np.uint8).astype(np.float64)
    if isinstance(value, int | float):
        return np.array([value], dtype=np.float64)
    if not isinstance(value, list):
        return _cloud(value) if hasattr(value, "point_step") else _parts(value)
    if value and hasattr(value[0], "action"):  # visualization_msgs/Marker
        value = [each for each in value if each.action == ADD]
        value.sort(key=lambda each: (each.ns, each.id))
    if not value or isinstance(value[0], int | float):
        return np.array(value, dtype=np.float64)
    return np.concatenate([_numbers(each) for each in value])


def _parts(value: Any) -> FloatArray:
    """Numbers of a message that has others in it, see :data:`PARTS`."""
    if hasattr(value, "action"):
        return _numbers(value.points or value.pose)
    if hasattr(value, "layout"):  # std_msgs/Float64MultiArray and its like
        return _numbers(value.data)
    for names in PARTS:
        if all(hasattr(value, name) for name in names):
            return np.concatenate([_numbers(getattr(value, name)) for name in names])
    raise TypeError(f"a value of type {getattr(value, '_type', type(value).__name__)}")


def _cloud(value: Any) -> FloatArray:
    """Coordinates of a ``sensor_msgs/PointCloud2``, point by point."""
    order = ">" if value.is_bigendian else "<"
    found = {each.name: each for each in value.fields if each.name in {"x", "y", "z"}}
    kind = np.dtype(
        {
            "names": list(found),
            "formats": [order + CLOUD_NUMBERS[each.datatype] for each in found.values()],
            "offsets": [each.offset for each in found.values()],
            "itemsize": value.point_step,
        }
    )
    points = np.ndarray(
        (value.height, value.width),
        dtype=kind,
        buffer=value.data,
        strides=(value.row_step, value.point_step),
    )
    return np.stack([points[name] for name in sorted(found)], axis=-1).astype(np.float64).ravel()
