"""Frames that a recording loses when its program is killed.

As a program of its own it records messages in real time, in all formats at once, and prints the
number of each frame when it has been handed over: ``python -m benchmarks.connect_kills INPUT``.
"""

import contextlib
import csv
import pickle
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from phytac_decoder.io.bundle import Bundle
from phytac_decoder.serving.csv_recording import Recorder
from phytac_decoder.serving.wire_protocol import Message
from phytac_design.core.lerobot_writer import LeRobotWriter, message_features, message_frame
from phytac_design.core.mcap_recording import McapRecorder
from phytac_design.core.parquet_recording import to_parquet
from phytac_design.core.rerun_recording import RerunRecorder
from phytac_design.core.zarr_recording import ZarrRecorder

RATE_Hz = 30.0


def record(source: Path) -> None:
    """Record the messages of a pickled file in its folder, until they end."""
    bundle, stream = pickle.loads(source.read_bytes())  # noqa: S301 - our own file
    folder, markers = source.parent, len(bundle.position_mm)
    with contextlib.ExitStack() as stack:
        each: list[Callable[[Message], None]] = [
            stack.enter_context(Recorder(folder / "out.csv")).add,
            stack.enter_context(McapRecorder(folder / "out.mcap", bundle, 1.7e9)).add,
            stack.enter_context(RerunRecorder(folder / "out.rrd", bundle, 1.7e9)).add,
            stack.enter_context(ZarrRecorder(folder / "out.zarr", markers)).add,
        ]
        features = message_features(markers)
        writer = stack.enter_context(
            LeRobotWriter(folder / "lerobot", fps=round(RATE_Hz), features=features)
        )
        each.append(lambda message: writer.add(message_frame(message, markers)))
        begin_s = time.monotonic()
        for number, message in enumerate(stream):
            time.sleep(max(begin_s + number / RATE_Hz - time.monotonic(), 0.0))
            for add in each:
                add(message)
            print(number, flush=True)


def lost_frames(
    bundle: Bundle, stream: list[Message], folder: Path, *, seconds: float
) -> dict[str, int]:
    """Kill a program that records, and count the frames that each format's library does not find.

    Parameters
    ----------
    bundle : Bundle
        Of the sensor.
    stream : list of Message
        Frames, all valid and numbered from 0; more than are recorded until the kill.
    folder : Path
        Folder of its own.
    seconds : float
        Time from the first frame to the kill.

    Returns
    -------
    dict
        Number of lost frames by format.
    """
    source = folder / "input.pickle"
    source.write_bytes(pickle.dumps((bundle, stream)))
    words = [sys.executable, "-m", "benchmarks.connect_kills", str(source)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        process.stdout.readline()
        time.sleep(seconds)
        process.send_signal(signal.SIGKILL)
        sent = 2 + process.stdout.read().count("\n") - 1
    markers = len(bundle.position_mm)
    # The last frame may be written and not yet reported.
    return {name: max(sent - count(folder, markers), 0) for name, count in FOUND.items()}


def in_csv(folder: Path, _markers: int) -> int:
    """Frames of a CSV."""
    with (folder / "out.csv").open(newline="", encoding="utf-8") as file:
        return len({row["sequence"] for row in csv.DictReader(file)})


def in_parquet(folder: Path, _markers: int) -> int:
    """Frames of the Parquet file that ``phytac convert`` makes of the CSV of a killed program."""
    import pyarrow.parquet

    to_parquet(folder / "out.csv", folder / "out.parquet", force=True)
    return len(set(pyarrow.parquet.read_table(folder / "out.parquet")["sequence"].to_pylist()))


def in_mcap(folder: Path, _markers: int) -> int:
    """Net wrenches of an MCAP file."""
    from mcap.exceptions import EndOfFile
    from mcap.reader import NonSeekingReader

    count = 0
    with (folder / "out.mcap").open("rb") as file, contextlib.suppress(EndOfFile):
        reader = NonSeekingReader(file)
        for _ in reader.iter_messages(topics=["/phytac/wrench"], log_time_order=False):
            count += 1
    return count


def in_rerun(folder: Path, _markers: int) -> int:
    """Total forces of a Rerun recording."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer")
        chunks = list(RrdReader(folder / "out.rrd").stream())
    return sum(chunk.num_rows for chunk in chunks if chunk.entity_path == "/force/total_N")


def in_zarr(folder: Path, _markers: int) -> int:
    """Frames that ``meta/episode_ends`` counts, all of which have their rows."""
    import zarr

    store = zarr.open_group(folder / "out.zarr", mode="r")
    ends = int(store["meta/episode_ends"][-1])
    assert all(array.shape[0] >= ends for array in store["data"].array_values())
    return ends


def in_lerobot(folder: Path, markers: int) -> int:
    """Frames of the episode that LeRobot's data set has after it was resumed."""
    import pyarrow.parquet

    shutil.copytree(folder / "lerobot", folder / "resumed")
    with LeRobotWriter(
        folder / "resumed", fps=round(RATE_Hz), features=message_features(markers), resume=True
    ) as writer:
        writer.end_episode("touch")
    path = folder / "resumed" / "data" / "chunk-000" / "file-000.parquet"
    return int(pyarrow.parquet.read_table(path).num_rows)


FOUND: dict[str, Callable[[Path, int], int]] = {
    "CSV": in_csv,
    "Parquet (phytac convert)": in_parquet,
    "MCAP": in_mcap,
    "Rerun": in_rerun,
    "Zarr": in_zarr,
    "LeRobot (resumed)": in_lerobot,
}

if __name__ == "__main__":
    record(Path(sys.argv[1]))
