"""Recordings for Rerun, FTP-1 and LeRobot: what a frame costs, what readers and kills leave."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet
import zarr

from benchmarks.connect_kills import lost_frames
from benchmarks.decoder_data import small_design
from benchmarks.harness import Table
from phytac_decoder.io.bundle import Bundle
from phytac_decoder.serving.wire_protocol import Message
from phytac_design.core.lerobot_writer import LeRobotWriter, message_features, message_frame
from phytac_design.core.rerun_recording import RerunRecorder
from phytac_design.core.zarr_recording import ZarrRecorder
from phytac_design.design.accuracy import Preset
from phytac_design.stages.virtual_sensor_stage import virtual_sensor

UNIT = 1
CURVE = "/force/total_N"
"""Entity of which each frame has one value."""


def recorded(table: Table, *, quick: bool) -> None:
    """Write the messages of a grasp many times over, and read them by Rerun's library."""
    import gymnasium
    from rerun.chunk import RrdReader
    from rerun.experimental import LeRobotReader

    from phytac_design.environments.grasp_environment import designed_decoder
    from phytac_design.environments.grip_controller import GripController

    design, frames = small_design(), 300 if quick else 3000
    accuracy: Preset = "draft" if quick else "standard"
    bundle = designed_decoder(design, accuracy, print)
    sensor = virtual_sensor(design, unit=UNIT, accuracy=accuracy, progress=print)
    environment = gymnasium.make("phytac/Ball-v0", design=design, bundle=bundle, sensor=sensor)
    own, sent = environment.unwrapped, list[Message]()
    controller, done = GripController(thing=own.thing), False
    seen, _ = environment.reset(seed=0)
    while not done:
        seen, _, terminated, truncated, _ = environment.step(controller.act(seen))
        sent.append(own.sensor.message())
        done = terminated or truncated
    stream = [
        {**sent[k % len(sent)], "sequence": k, "timestamp_s": k / 30.0} for k in range(frames)
    ]
    total = np.array([message["total_N"] for message in stream])
    markers = len(bundle.position_mm)
    kills(table, bundle, stream)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        with RerunRecorder(out / "out.rrd", bundle, 0.0) as recorder:
            cost_ms = per_frame_ms(stream, recorder.add)
        found = [
            value[0]
            for chunk in RrdReader(out / "out.rrd").stream()
            if chunk.entity_path == CURVE
            for value in chunk.to_record_batch().column("Scalars:scalars").to_pylist()
        ]
        rows(table, "Rerun", cost_ms, (out / "out.rrd").stat().st_size / frames)
        same(table, "Rerun", np.array(found), total)
        expected = np.array([message["net_force_N"] for message in stream])
        in_zarr(table, stream, out / "out.zarr", markers, expected)
        begin = time.process_time()
        features = message_features(markers)
        with LeRobotWriter(out / "grasps", fps=30, features=features) as writer:
            for start in range(0, frames, len(sent)):
                for message in stream[start : start + len(sent)]:
                    writer.add(message_frame(message, markers))
                writer.end_episode("squeeze the ball")
        cost_ms = 1e3 * (time.process_time() - begin) / frames
        files = sorted((out / "grasps").rglob("*.parquet"))
        size = sum(path.stat().st_size for path in files) / frames
        rows(table, "LeRobot", cost_ms, size)
        data = [path for path in files if "data" in path.parts]
        net = np.concatenate(
            [
                np.array(pyarrow.parquet.read_table(path)["observation.force"].to_pylist())
                for path in data
            ]
        )
        same(table, "LeRobot", net, expected)
        episodes = len(LeRobotReader(out / "grasps").episodes())
        table.goal(
            "LeRobot: episodes that Rerun's reader of LeRobot data sets finds",
            100.0 * episodes / writer.episodes,
            "%",
            "== 100",
            note=f"of {writer.episodes}",
        )


def kills(table: Table, bundle: Bundle, stream: list[Message]) -> None:
    """Rows: frames that a killed program loses."""
    with tempfile.TemporaryDirectory() as folder:
        lost = lost_frames(bundle, stream, Path(folder), seconds=4.5)
    for kind, count in lost.items():
        table.goal(
            f"{kind}: frames that a program loses when it is killed, at 30 Hz",
            count,
            "frames",
            "<= 30",
            note="SIGKILL 4.5 s after the first frame, all formats in one program",
        )


def in_zarr(
    table: Table, stream: list[Message], path: Path, markers: int, expected: np.ndarray
) -> None:
    """Rows of the layout of FTP-1."""
    with ZarrRecorder(path, markers) as recorder:

        def add(message: Message) -> None:
            recorder.add(message)
            if message["sequence"] % 15 == 0:
                recorder.flush()  # as often as in real time

        cost_ms = per_frame_ms(stream, add)
    size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    rows(table, "Zarr", cost_ms, size / len(stream))
    store = zarr.open_group(path, mode="r")
    same(table, "Zarr", store["data/right_tactile_data_wrench"][:, 0, :3], expected)


def per_frame_ms(stream: list[Message], add: Callable[[Message], None]) -> float:
    """Processor time of a frame, with that of threads in the background."""
    begin = time.process_time()
    for message in stream:
        add(message)
    return 1e3 * (time.process_time() - begin) / len(stream)


def rows(table: Table, name: str, cost_ms: float, size: float) -> None:
    """What a frame costs."""
    table.goal(f"{name}: processor time of a frame", cost_ms, "ms", "<= 2", note="112 markers")
    table.add(f"{name}: size of a frame", size, "bytes", "none", "112 markers, grasp of a ball")


def same(table: Table, name: str, found: np.ndarray, expected: np.ndarray) -> None:
    """Whether what was read is what was written, to the digits of a 32-bit number."""
    whole = found.shape == expected.shape
    equal = whole and np.allclose(found, expected, rtol=1e-6, atol=1e-6)
    table.goal(
        f"{name}: frames read back with the forces that were written",
        100.0 * float(equal),
        "%",
        "== 100",
        note=f"{len(found)} of {len(expected)} frames",
    )
