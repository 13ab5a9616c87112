"""Marker displacements with wrenches of any vision-based sensor, from Zarr, NPZ or MCAP."""

import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.training.marker_regression import FOLDS, MarkerData
from phytac_design.workflows.marker_messages import mcap_recordings, read_marker_messages
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import InputError, MissingPartError, OutputError

MOST_FRAMES = 1500
"""More are thinned out evenly: a regression with kernels costs the cube of their number."""
BLOCKS = 20
"""Parts of a recording without episodes."""
REST_SHARE = 0.05
"""Largest wrench of a frame at rest, as a share of its range."""
LARGEST = 1e30
"""No measurement in any unit is larger; squares and their sums stay finite."""


def read_marker_data(
    source: Path, markers: str, wrench: str, *, pad: int = 0, rest_first: bool = False
) -> tuple[MarkerData, list[str]]:
    """Read a data set.

    Parameters
    ----------
    source : Path
        Zarr (a folder, or zipped) with arrays below ``data`` and ``meta/episode_ends`` as of
        FTP-1, Open-X-Tactile and UMI, an NPZ file with arrays and ``episode_ends``, or MCAP with
        ROS 2 messages (a file, or a folder of them).
    markers, wrench : str
        Names of the arrays: (frames, …), of markers perhaps after an axis of pads. Of MCAP, topics;
        see :func:`phytac_design.workflows.marker_messages.read_marker_messages`.
    pad : int
        Pad of a Zarr array ``…_tactile_data_…``, whose second axis counts pads.
    rest_first : bool
        Subtract the first frame of each episode, or of a recording without episodes.

    Returns
    -------
    data : MarkerData
        Frames.
    notes : list of str
        What was left out or assumed.

    Raises
    ------
    InputError
        If there is no such array or topic, or it does not fit.
    MissingPartError
        If a library is needed and not installed.
    """
    if markers == wrench:
        raise InputError(
            "marker-data-array",
            f"markers and wrench are both {markers}: a force would be read from itself; name two "
            "of them",
        )
    recordings = mcap_recordings(source)
    if recordings:
        seen, felt, ends, notes = read_marker_messages(recordings, markers, wrench)
    else:
        seen, felt, ends, notes = _arrays(source, markers, wrench, pad)
    frames = len(seen)
    if len(felt) != frames:
        raise InputError(
            "marker-data-array",
            f"{markers} has {frames} frames and {wrench} {len(felt)}; they must be the same ones",
        )
    first = np.zeros(1, dtype=np.int64)
    if ends is not None:
        ends = _episode_ends(ends, frames)
        first = np.concatenate([[0], ends])
    own = np.searchsorted(first, np.arange(frames), side="right") - 1
    if ends is None or (recordings and len(ends) < 2 * FOLDS):
        found = "no episodes" if ends is None or len(ends) == 1 else f"{len(ends)} episodes alone"
        ends = np.linspace(0, frames, BLOCKS + 1).round().astype(np.int64)[1:]
        notes.append(
            f"{found}: {BLOCKS} blocks of consecutive frames are held out in their place; a "
            "press may lie in two"
        )
    episode = np.searchsorted(ends, np.arange(frames), side="right")
    whole = np.isfinite(seen).all(axis=1) & np.isfinite(felt).all(axis=1) & (episode < len(ends))
    if rest_first:
        begin = np.minimum(first[own], frames - 1)
        whole &= np.isfinite(seen[begin]).all(axis=1)
        notes += _pressed_first(felt, np.unique(begin[whole]), whole, wrench)
        with np.errstate(invalid="ignore"):
            seen = seen - seen[begin]
    if not whole.any():
        gaps = [int((~np.isfinite(values).all(axis=1)).sum()) for values in (seen, felt)]
        raise InputError(
            "marker-data-array",
            f"none of {frames} frames is complete: {gaps[0]} have NaN or infinite {markers}, "
            f"{gaps[1]} such {wrench}; leave out columns that are never there",
        )
    if not whole.all():
        notes.append(f"{int((~whole).sum())} of {frames} frames left out: of no episode, or gaps")
    kept = np.flatnonzero(whole)
    if len(kept) > MOST_FRAMES:
        kept = kept[np.linspace(0, len(kept) - 1, MOST_FRAMES).round().astype(np.int64)]
        notes.append(f"{MOST_FRAMES} frames are used, evenly")
    data = MarkerData(displacement=seen[kept], wrench=felt[kept], episode=episode[kept])
    notes += _judgeable(data, markers, wrench)
    return data, notes


def _arrays(
    source: Path, markers: str, wrench: str, pad: int
) -> tuple[FloatArray, FloatArray, Any, list[str]]:
    """Markers, wrenches and ends of episodes of a Zarr or an NPZ, and notes."""
    notes: list[str] = []
    if _is_zarr(source):
        arrays, ends, notes = _zarr(source, (markers, wrench))
    else:
        arrays, ends = _npz(source)
    return *(_numbers(source, arrays, name, pad) for name in (markers, wrench)), ends, notes


def _pressed_first(felt: FloatArray, rest: IntArray, whole: BoolArray, wrench: str) -> list[str]:
    """Note on first frames (r,) that are not at rest, by the wrenches (n, c) of whole frames."""
    if not len(rest):
        return []
    loaded = np.any(np.abs(felt[rest]) > REST_SHARE * np.ptp(felt[whole], axis=0), axis=1)
    if not loaded.any():
        return []
    text = (
        f"{int(loaded.sum())} of {len(rest)} first frames are not at rest: their {wrench} is more "
        f"than {REST_SHARE:.0%} of its range; without --rest-first nothing is subtracted"
    )
    return [text]


def _judgeable(data: MarkerData, markers: str, wrench: str) -> list[str]:
    """Notes on components that do not change.

    Raises
    ------
    InputError
        If all are constant, or numbers are beyond those of measurements.
    """
    for name, values in ((markers, data.displacement), (wrench, data.wrench)):
        largest = float(np.abs(values).max(initial=0.0))
        if largest > LARGEST:
            raise InputError(
                "marker-data-array",
                f"{name} has values of up to {largest:.3g}; no measurement has: was the array read "
                "in another type than it was written in?",
            )
        if not np.ptp(values, axis=0).max(initial=0.0) > 1.0 / LARGEST:
            raise InputError("marker-data-array", f"{name} does not change: nothing can be judged")
    constant = np.flatnonzero(np.ptp(data.wrench, axis=0) == 0.0)
    if len(constant):
        named = ", ".join(map(str, constant))
        return [f"component {named} of {wrench} does not change: its figures mean nothing"]
    return []


def _episode_ends(ends: Any, frames: int) -> IntArray:
    """Ends of episodes, as integers.

    Raises
    ------
    InputError
        If they are none, or do not fit.
    """
    values = np.asarray(ends)
    if (
        values.ndim != 1
        or not values.size
        or values.dtype.kind not in "fiu"
        or not np.all(np.isfinite(values))
        or np.any(values != np.floor(values))
        or values[0] < 1
        or np.any(np.diff(values.astype(np.float64)) < 0)
        or values[-1] > frames
    ):
        raise InputError(
            "marker-data-array",
            f"episode_ends does not fit {frames} frames (got {np.array2string(values, threshold=6)}"
            "): it must be one row of whole numbers that grow, each the number of frames up to "
            "the end of an episode",
        )
    return values.astype(np.int64)


def _numbers(source: Path, arrays: Mapping[str, Any], name: str, pad: int) -> FloatArray:
    """An array's numbers (frames, k)."""
    if name not in arrays:
        has = ", ".join(sorted(arrays)) or "none"
        below = " below data" if _is_zarr(source) else ""
        raise InputError(
            "marker-data-array", f"{source} has no array {name}{below} (it has: {has})"
        )
    values = np.asarray(arrays[name])
    if "_tactile_data_" in name:
        if values.ndim < 3 or pad >= values.shape[1]:
            raise InputError("marker-data-array", f"{name} is {values.shape}: it has no pad {pad}")
        values = values[:, pad]
    if values.dtype.kind not in "fiu" or not values.ndim or not values.size:
        raise InputError(
            "marker-data-array",
            f"{name} must hold numbers, one row per frame (got shape {values.shape}, "
            f"{values.dtype})",
        )
    return values.reshape(len(values), -1).astype(np.float64)


def write_marker_data(path: Path, data: MarkerData) -> None:
    """Write frames as NPZ, which :func:`read_marker_data` reads.

    Raises
    ------
    OutputError
        If the file is there, or cannot be written.
    """
    ends = np.flatnonzero(np.diff(data.episode, append=data.episode[-1] + 1)) + 1
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            np.savez_compressed(
                file, displacement=data.displacement, wrench=data.wrench, episode_ends=ends
            )
    except FileExistsError:
        raise OutputError(
            "output-exists", f"{path} is there already; choose another name, or remove it"
        ) from None
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"{path} cannot be written ({error.strerror})"
        ) from None


def _is_zarr(source: Path) -> bool:
    return source.is_dir() or source.name.lower().endswith((".zarr", ".zarr.zip"))


def _zarr(source: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Any], Any, list[str]]:
    """Arrays by name, those that are wanted as numbers, ends of episodes, and missing parts."""
    library = _zarr_library()
    found: dict[str, Any] = {}
    notes: list[str] = []

    def numbers(name: str) -> Any:
        array = root.get(name)
        if not isinstance(array, library.Array):
            return None
        missing = array.nchunks - array.nchunks_initialized
        if missing:
            notes.append(
                f"{missing} of {array.nchunks} chunks of {name} are not there and read as "
                f"{array.fill_value}: an interrupted download or recording?"
            )
        return array[...]

    try:
        store, inside = source, ""
        if source.is_file():
            store, inside = library.storage.ZipStore(source, mode="r"), _root_in_zip(source)
        root = library.open_group(store, mode="r", path=inside)
        for name in wanted:
            values = numbers(f"data/{name}")
            if values is None:
                # The group below `data` may have no file of its own.
                names = root["data"].array_keys() if "data" in root else ()
                found = dict.fromkeys(names) | found
                found.pop(name, None)
                break
            found[name] = values
        ends = numbers("meta/episode_ends")
    except (OSError, ValueError, TypeError, RuntimeError, zipfile.BadZipFile) as error:
        raise InputError("file-unreadable", f"no whole Zarr at {source} ({error})") from None
    return found, ends, notes


def _root_in_zip(source: Path) -> str:
    """Folder of the group in a zipped Zarr: its root, or its only folder by custom."""
    tail = "meta/episode_ends/.zarray"
    with zipfile.ZipFile(source) as file:
        return next((n[: -len(tail)].strip("/") for n in file.namelist() if n.endswith(tail)), "")


def _npz(source: Path) -> tuple[dict[str, Any], Any]:
    """Arrays of an NPZ file, without pickles, and ends of episodes."""
    try:
        with zipfile.ZipFile(source), np.load(source) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zlib.error, zipfile.BadZipFile) as error:
        raise InputError(
            "file-unreadable", f"no whole NPZ file of numbers at {source} ({error})"
        ) from None
    return arrays, arrays.pop("episode_ends", None)


def _zarr_library() -> Any:
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
