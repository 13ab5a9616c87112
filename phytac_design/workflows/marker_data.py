"""Marker displacements with wrenches of any vision-based sensor, from Zarr, NPZ or MCAP."""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.training.marker_regression import FOLDS, MarkerData
from phytac_design.workflows.marker_messages import mcap_recordings, read_marker_messages
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError, MissingPartError, OutputError

MOST_FRAMES = 1500
"""More are thinned out evenly: a regression with kernels costs the cube of their number."""
BLOCKS = 20
"""Parts of a recording without episodes."""


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
    recordings = mcap_recordings(source)
    notes: list[str] = []
    if recordings:
        seen, felt, ends, notes = read_marker_messages(recordings, markers, wrench)
    else:
        arrays, ends = _zarr(source, (markers, wrench)) if _is_zarr(source) else _npz(source)
        seen, felt = (_numbers(source, arrays, name, pad) for name in (markers, wrench))
    frames = len(seen)
    if len(felt) != frames or not frames:
        raise InputError(
            "marker-data-array",
            f"{markers} has {frames} frames and {wrench} {len(felt)}; they must be the same ones",
        )
    if ends is not None and (not len(ends) or np.any(np.diff(ends) < 0) or ends[-1] > frames):
        raise InputError("marker-data-array", f"episode_ends does not fit {frames} frames")
    if rest_first:
        first = np.zeros(1, dtype=np.int64) if ends is None else np.concatenate([[0], ends])
        begin = first[np.searchsorted(first, np.arange(frames), side="right") - 1]
        seen = seen - seen[begin]
    if ends is None or (recordings and len(ends) < 2 * FOLDS):
        found = "no episodes" if ends is None or len(ends) == 1 else f"{len(ends)} episodes alone"
        ends = np.linspace(0, frames, BLOCKS + 1).round().astype(np.int64)[1:]
        notes.append(
            f"{found}: {BLOCKS} blocks of consecutive frames are held out in their place; a "
            "press may lie in two"
        )
    episode = np.searchsorted(ends, np.arange(frames), side="right")
    whole = np.isfinite(seen).all(axis=1) & np.isfinite(felt).all(axis=1) & (episode < len(ends))
    if not whole.all():
        notes.append(f"{int((~whole).sum())} of {frames} frames left out: of no episode, or gaps")
    kept = np.flatnonzero(whole)
    if len(kept) > MOST_FRAMES:
        kept = kept[np.linspace(0, len(kept) - 1, MOST_FRAMES).round().astype(np.int64)]
        notes.append(f"{MOST_FRAMES} frames are used, evenly")
    if not len(kept) or not np.any(felt[kept].std(axis=0) > 0.0):
        raise InputError("marker-data-array", f"{wrench} does not change: nothing can be judged")
    data = MarkerData(displacement=seen[kept], wrench=felt[kept], episode=episode[kept])
    return data, notes


def _numbers(source: Path, arrays: Mapping[str, Any], name: str, pad: int) -> FloatArray:
    """An array's numbers (frames, k)."""
    if name not in arrays:
        has = ", ".join(sorted(arrays)) or "none"
        raise InputError("marker-data-array", f"{source} has no array {name} (it has: {has})")
    values = np.asarray(arrays[name])
    if "_tactile_data_" in name:
        if values.ndim < 3 or pad >= values.shape[1]:
            raise InputError("marker-data-array", f"{name} is {values.shape}: it has no pad {pad}")
        values = values[:, pad]
    if values.dtype.kind not in "fiu" or not values.ndim:
        raise InputError("marker-data-array", f"{name} holds no numbers ({values.dtype})")
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


def _zarr(source: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Any], Any]:
    """Arrays by name, those that are wanted as numbers, and ends of episodes."""
    library = _zarr_library()
    try:
        store, inside = source, ""
        if source.is_file():
            store, inside = library.storage.ZipStore(source, mode="r"), _root_in_zip(source)
        root = library.open_group(store, mode="r", path=inside)
        # The group below `data` may have no file of its own.
        found: dict[str, Any] = {}
        for name in wanted:
            try:
                found[name] = root[f"data/{name}"][...]
            except KeyError:
                if "data" in root:
                    found |= dict.fromkeys(root["data"].array_keys())
                found.pop(name, None)
                break
        ends = root["meta/episode_ends"][...] if "meta/episode_ends" in root else None
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError("file-unreadable", f"no Zarr at {source} ({error})") from None
    return found, ends


def _root_in_zip(source: Path) -> str:
    """Folder of the group in a zipped Zarr: its root, or its only folder by custom."""
    tail = "meta/episode_ends/.zarray"
    with zipfile.ZipFile(source) as file:
        return next((n[: -len(tail)].strip("/") for n in file.namelist() if n.endswith(tail)), "")


def _npz(source: Path) -> tuple[dict[str, Any], Any]:
    """Arrays of an NPZ file, without pickles, and ends of episodes."""
    try:
        with np.load(source) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, AttributeError, zipfile.BadZipFile) as error:
        raise InputError("file-unreadable", f"no NPZ file at {source} ({error})") from None
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
