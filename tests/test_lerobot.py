"""LeRobot data sets: the published layout, and what the libraries of others read in them."""

import json
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.serving.wire_protocol import end_message
from phytac_design.core.lerobot_writer import (
    Feature,
    LeRobotWriter,
    message_features,
    message_frame,
)
from tests.refusals import refused
from tests.test_mcap import frames, messages

parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed (extra design)")
ROOT = Path(__file__).parents[1]
FPS, LENGTHS = 4, (3, 5, 2)
INFO = {
    "chunks_size", "codebase_version", "data_files_size_in_mb", "data_path", "features", "fps",
    "robot_type", "splits", "total_episodes", "total_frames", "total_tasks",
    "video_files_size_in_mb", "video_path",
}  # fmt: skip
"""Keys of ``create_empty_dataset_info`` in ``lerobot.datasets.utils`` of LeRobot 0.4.4."""
DEFAULT = {
    "timestamp": "float", "frame_index": "int64", "episode_index": "int64", "index": "int64",
    "task_index": "int64",
}  # fmt: skip
"""``DEFAULT_FEATURES`` there, in Parquet's types."""
EPISODE = {
    "episode_index", "tasks", "length", "data/chunk_index", "data/file_index",
    "dataset_from_index", "dataset_to_index", "meta/episodes/chunk_index",
    "meta/episodes/file_index",
}  # fmt: skip
"""Columns of ``_save_episode_metadata`` and ``_save_episode_data``, besides statistics."""
STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
"""Those of ``get_feature_stats``."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three episodes of a stream, two tasks."""
    out, stream = tmp_path / "grasps", frames(messages(), 10)
    with LeRobotWriter(out, fps=FPS, features=message_features(30)) as writer:
        for length, task in zip(LENGTHS, ("hold", "squeeze", "hold"), strict=True):
            for message in stream[:length]:
                writer.add(message_frame(message, 30))
            writer.end_episode(task)
        writer.add(message_frame(stream[0], 30))
    assert (writer.episodes, writer.rows) == (3, sum(LENGTHS))
    return out


def test_a_killed_program_s_data_set_is_resumed(folder: Path, tmp_path: Path) -> None:
    out, stream = tmp_path / "resumed", frames(messages(), 10)
    killed = []
    for length, task in zip(LENGTHS, ("hold", "squeeze", "hold"), strict=True):
        features = message_features(30)
        writer = LeRobotWriter(out, fps=FPS, features=features, resume=True)
        # In the middle of the episode; half a frame is on the disk.
        for message in stream[: length - 1]:
            writer.add(message_frame(message, 30))
        with (out / f"running-{writer.episodes}.f64").open("ab") as journal:
            journal.write(b"half")
        killed.append(writer)
        with LeRobotWriter(out, fps=FPS, features=features, resume=True) as again:
            assert again.waiting == length - 1
            again.add(message_frame(stream[length - 1], 30))
            again.end_episode(task)
    whole = {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}
    assert {path.relative_to(out) for path in out.rglob("*") if path.is_file()} == whole
    for name in whole:
        if name.suffix == ".parquet":
            assert parquet.read_table(out / name).equals(parquet.read_table(folder / name)), name
        else:
            assert json.loads((out / name).read_text()) == json.loads((folder / name).read_text())
    with refused("lerobot-resume-invalid"):
        LeRobotWriter(out, fps=FPS + 1, features=message_features(30), resume=True)
    (out / "meta" / "info.json").write_text("{")
    with refused("lerobot-resume-invalid"):
        LeRobotWriter(out, fps=FPS, features=message_features(30), resume=True)
    for one in killed:
        one._running.close()


def test_the_layout_is_the_published_one(folder: Path) -> None:
    info = json.loads((folder / "meta" / "info.json").read_text())
    assert set(info) == INFO
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 10, 2)
    assert info["splits"] == {"train": "0:3"}
    assert set(info["features"]) == set(message_features(30)) | set(DEFAULT)
    rows = 0
    for number, length in enumerate(LENGTHS):
        place = {"chunk_index": 0, "file_index": number}
        table = parquet.read_table(folder / info["data_path"].format(**place))
        assert set(table.column_names) == set(info["features"])
        assert {name: str(table.schema.field(name).type) for name in DEFAULT} == DEFAULT
        for name, feature in info["features"].items():
            kind = table.schema.field(name).type
            assert getattr(kind, "list_size", 1) == feature["shape"][0], name
        assert table["timestamp"].to_pylist() == [k / FPS for k in range(length)]
        assert table["index"].to_pylist() == list(range(rows, rows + length))
        assert set(table["episode_index"].to_pylist()) == {number}
        assert set(table["task_index"].to_pylist()) == {number % 2}
        episode = folder / "meta" / "episodes" / "chunk-000" / f"file-{number:03d}.parquet"
        facts = parquet.read_table(episode).to_pylist()[0]
        names = {name for name in facts if not name.startswith("stats/")}
        assert names == EPISODE
        assert (facts["dataset_from_index"], facts["dataset_to_index"]) == (rows, rows + length)
        measured = {name.split("/")[1] for name in facts if name.startswith("stats/")}
        assert measured == set(info["features"])
        rows += length
    tasks = parquet.read_table(folder / "meta" / "tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0, 1], "__index_level_0__": ["hold", "squeeze"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]


def test_values_and_statistics_are_the_streams(folder: Path) -> None:
    table = parquet.read_table(folder / "data" / "chunk-000" / "file-001.parquet")
    force = np.array(table["observation.force"].to_pylist())
    # The second frame is black.
    assert force[:, 2].tolist() == [-4.5, 0.0, -4.5, -4.5, -4.5]
    assert table["observation.valid"].to_pylist() == [1.0, 0.0, 1.0, 1.0, 1.0]
    assert np.flatnonzero(table["observation.switches"].to_pylist()[0]).tolist() == [7, 14, 28]
    strongest = table["observation.contacts"].to_pylist()[0][:5]
    assert strongest == pytest.approx([4.0, 0.0, 12.5, 12.5, 0.0])
    whole = np.concatenate([force[:length] for length in LENGTHS])
    totals = json.loads((folder / "meta" / "stats.json").read_text())
    own = totals["observation.force"]
    assert set(own) == STATISTICS
    assert own["mean"] == pytest.approx(whole.mean(axis=0))
    assert own["std"] == pytest.approx(whole.std(axis=0))
    assert (own["min"][2], own["max"][2], own["count"]) == (-4.5, 0.0, [10])


def test_rerun_reads_it(folder: Path) -> None:
    experimental = pytest.importorskip("rerun.experimental", reason="rerun-sdk is not installed")
    reader = experimental.LeRobotReader(folder)
    assert reader.version == "v3"
    assert reader.episodes() == [0, 1, 2]
    found = [
        value
        for chunk in reader.stream(1)
        if chunk.entity_path == "/observation.force" and chunk.num_rows == 5
        for value in chunk.to_record_batch().column("Scalars:scalars").to_pylist()
    ]
    assert [net[2] for net in found] == [-4.5, 0.0, -4.5, -4.5, -4.5]


def test_lerobot_reads_it(folder: Path) -> None:
    library = pytest.importorskip(
        "lerobot.datasets.lerobot_dataset", reason="LeRobot is not installed", exc_type=ImportError
    )
    dataset = library.LeRobotDataset("phytac/grasps", root=folder)
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (3, 10, FPS)
    row = dataset[4]
    assert row["observation.force"].tolist() == [0.0, 0.0, 0.0]
    assert row["task"] == "squeeze"
    assert (int(row["episode_index"]), int(row["frame_index"])) == (1, 1)
    assert dataset.meta.stats["observation.force"]["min"][2] == -4.5


def test_the_guide_writes_a_stream(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    guide = (ROOT / "docs" / "guides" / "lerobot.md").read_text(encoding="utf-8")
    code = guide.split("```python\n")[2].partition("```")[0]
    make, sent = messages(), frames(messages(), 3)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            link, _ = server.accept()
            with link:
                for message in (make.hello(), *sent, end_message("done")):
                    link.sendall(json.dumps(message).encode() + b"\n")

        sender = threading.Thread(target=serve)
        sender.start()
        monkeypatch.chdir(tmp_path)
        exec(code.replace("5757", str(server.getsockname()[1])), {})  # noqa: S102 - our own guide
        sender.join()
    info = json.loads(Path("held/meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (1, 3)
    table = parquet.read_table("held/data/chunk-000/file-000.parquet")
    assert table["observation.force"].to_pylist()[2] == [0.0, 0.0, -4.5]


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    features = {"observation.force": Feature("float32", 3)}
    with refused("lerobot-feature-name") as found:
        LeRobotWriter(tmp_path / "one", fps=4, features=features | {"index": Feature("int64", 1)})
    assert "'index'" in str(found.value)
    writer = LeRobotWriter(tmp_path / "one", fps=4, features=features)
    with refused("output-exists"):
        LeRobotWriter(tmp_path / "one", fps=4, features=features)
    bad: list[dict[str, Any]] = [{}, {"observation.force": [1.0, 2.0]}]
    bad.append({"observation.force": np.zeros(3), "more": 1.0})
    for frame in bad:
        with refused("lerobot-frame-invalid"):
            writer.add(frame)
    with refused("lerobot-episode-empty"):
        writer.end_episode("hold")
    (tmp_path / "file").write_bytes(b"")
    with refused("output-not-writable"):
        LeRobotWriter(tmp_path / "file" / "one", fps=4, features=features)
