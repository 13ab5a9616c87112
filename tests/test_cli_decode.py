"""``phytac decode`` as a person runs it: an image, and recordings to rows, CSV and Parquet."""

import csv
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from phytac_decoder.estimation.force_regions import Region
from phytac_decoder.io import bundle as bundle_module
from phytac_decoder.io.bundle import save_bundle
from phytac_decoder.pipeline.decode import FrameMeasurement
from phytac_decoder.pipeline.frame_reading import Reading
from phytac_decoder.serving.sensor_loop import Progress
from phytac_design.cli import decode_command
from phytac_design.cli.decode_command import FramePrinter, _no_forces, _true_interval, decode
from phytac_shapes.arrays import ImageArray
from phytac_shapes.errors import PhytacError
from tests.decoder.toy_sensor import toy_bundle, toy_frame
from tests.decoder.virtual_camera import VirtualWorld, install
from tests.refusals import refused

PRESSES: list[Mapping[int, float]] = [{}, {14: 3.0}, {14: 3.0, 15: 1.5, 29: 2.0}, {7: 2.0}]
PATIENCE_S = 60.0
COMMAND = "import typer\nfrom phytac_design.cli.decode_command import decode\ntyper.run(decode)"
ALONE = [sys.executable, "-c", COMMAND]

app = typer.Typer()
app.command()(decode)


def folder_of(where: Path, presses: list[Mapping[int, float]]) -> Path:
    where.mkdir()
    for number, pressed in enumerate(presses):
        cv2.imwrite(str(where / f"frame_{number}.png"), toy_frame(pressed))
    return where


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Decoder and frames of the toy sensor."""
    folder = tmp_path_factory.mktemp("toy")
    save_bundle(toy_bundle(), folder / "decoder")
    folder_of(folder / "frames", PRESSES)
    return folder


def run(*words: object) -> tuple[str, str]:
    """What it prints, and what it says besides; its error, if there is one, is raised."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    if isinstance(done.exception, PhytacError):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.stdout, done.stderr


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.parametrize("csv_file", [False, True])
def test_a_changed_stiffness_reaches_the_decoder(
    toy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, csv_file: bool
) -> None:
    given, load = [], bundle_module.load_bundle
    monkeypatch.setattr(
        bundle_module, "load_bundle", lambda *a, **k: given.append(k) or load(*a, **k)
    )
    words = [toy / "decoder", toy / "frames" / "frame_2.png", "--stiffness-change", "7"]
    run(*words, *(["--csv", tmp_path / "out.csv"] if csv_file else []))
    assert given[0]["stiffness_change"] == pytest.approx(0.07)


def test_a_doubtful_frame_ends_with_its_reason(toy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FrameMeasurement, "warnings", lambda *_, **__: ["20 of 41 switches"])
    out, _ = run(toy / "decoder", toy / "frames" / "frame_2.png", "--estimator", "koi_inverse")
    assert "the frame is doubtful: 20 of 41 switches" in out


def test_one_image_is_printed_in_full(toy: Path) -> None:
    words = (toy / "decoder", toy / "frames" / "frame_2.png", "--estimator", "koi_inverse")
    reported, _ = run(*words)
    lines = reported.splitlines()
    assert lines[0] == "toy: 30 of 30 markers found"
    assert [int(line.split()[1]) for line in lines[1:4]] == [14, 15, 29]
    assert re.fullmatch(r"total 6\.\d\d N on 3 switched receptors", lines[4])
    result = json.loads(run(*words, "--json")[0])
    assert list(result) == [
        "design", "estimator", "found", "forces_N", "total_N", "contacts", "net_force_N",
        "net_moment_Nmm", "moment_about_mm", "warnings", "limits",
    ]  # fmt: skip
    assert result["forces_N"]["14"] == pytest.approx(3.0, abs=0.15)


def test_moments_are_about_the_point_that_is_given(toy: Path, tmp_path: Path) -> None:
    """One image and a recording; 2 N on marker 7, at (10, 10, 0) mm."""
    about, image = ("--moment-about", "10", "-20", "-5"), toy / "frames" / "frame_3.png"
    reported, _ = run(toy / "decoder", image)
    (line,) = [line for line in reported.splitlines() if line.startswith("net force")]
    assert re.fullmatch(
        r"net force \(0\.00, 0\.00, -(\S+)\) N, moment \(-\S+, \S+, 0\.0\) N·mm about "
        r"\(0, 0, 0\) mm",
        line,
    )
    one = json.loads(run(toy / "decoder", image, "--json", *about)[0])
    (row,) = run(toy / "decoder", image, "--fps", "10", "--json", *about)[0].splitlines()
    run(toy / "decoder", image, "--csv", tmp_path / "out.csv", *about)
    (written,) = rows_of(tmp_path / "out.csv")
    for name in ("net_force_N", "net_moment_Nmm", "moment_about_mm"):
        assert one[name] == json.loads(row)[name]
        head, unit = name.rsplit("_", 1)
        assert [float(written[f"{head}_{axis}_{unit}"]) for axis in "xyz"] == one[name]
    assert one["moment_about_mm"] == [10.0, -20.0, -5.0]
    assert one["net_force_N"] == pytest.approx([0.0, 0.0, -2.0], abs=0.15)
    # From the point: (0, 30, 5) mm.
    assert one["net_moment_Nmm"] == pytest.approx([-60.0, 0.0, 0.0], abs=5.0)
    for command in ((image,), (image, "--fps", "10")):
        with refused("moment-reference-invalid"):
            run(toy / "decoder", *command, "--moment-about", "nan", "0", "0")


def test_a_folder_gives_one_row_per_frame(toy: Path) -> None:
    reported, besides = run(toy / "decoder", toy / "frames", "--fps", "10")
    lines = reported.splitlines()
    assert [line.split()[:2] for line in lines] == [[str(k), f"0.{k}00"] for k in range(4)]
    assert [float(line.split()[3]) for line in lines] == pytest.approx([0, 3, 6.5, 2], abs=0.3)
    assert lines[2].count("#") == 2
    # The contact continues: its number stays.
    assert "#0 " in lines[1]
    assert re.search(r"#0 4\.\d\d N at", lines[2])
    assert "#1 " in lines[2]
    assert re.search(r"^4 frames in \d+\.\d s, 0 unread, 0 skipped, 0 missed, \d with", besides)
    assert besides.splitlines()[-1].startswith("next: give --rest FRAME")
    assert "timestamps: number of the frame / 10 fps\n" in besides
    # Names without times: what looks like a time is that of reading.
    _, besides = run(toy / "decoder", toy / "frames", "--rest-first", "1")
    assert "timestamps: when it was read, from the first" in besides
    assert "--fps gives a recording the rate" in besides
    _, besides = run(toy / "decoder", toy / "frames", "--fps", "10", "--rest-first", "1")
    assert "next: " not in besides


def test_a_shell_that_looks_the_same_when_turned_is_reported_once(
    toy: Path, tmp_path: Path
) -> None:
    plain = toy_bundle()
    row, column = np.divmod(np.arange(30), 6)
    # Half a turn maps the columns of each colour onto one another.
    place = np.array([[-20, 0], [-30, 0], [0, 0], [0, 5], [20, 0], [30, 0]])[column]
    position = np.column_stack([place[:, 0], 10.0 * (row - 2), place[:, 1]]).astype(float)
    even = replace(plain, position_mm=position, head_mm=0.5 * position)
    assert (plain.symmetry_order, even.symmetry_order) == (1, 2)
    save_bundle(even, tmp_path)
    assert json.loads((tmp_path / "bundle.json").read_text())["symmetry_order"] == 2
    _, besides = run(tmp_path, toy / "frames", "--fps", "10")
    assert besides.count("orientation-ambiguous") == 1
    assert "180 degrees" in besides
    assert "orientation-ambiguous" not in run(toy / "decoder", toy / "frames", "--fps", "10")[1]


def test_json_lines_are_the_streams_messages(toy: Path) -> None:
    reported, _ = run(toy / "decoder", toy / "frames", "--fps", "10", "--json")
    messages = [json.loads(line) for line in reported.splitlines()]
    assert [message["sequence"] for message in messages] == [0, 1, 2, 3]
    assert [message["koi"] for message in messages] == [[], [14], [14, 15, 29], [7]]
    assert messages[2]["contacts"][0]["markers"] == [14, 15]
    # A rate does not slow it down, nor leave frames out.
    start = time.monotonic()
    reported, _ = run(toy / "decoder", toy / "frames", "--fps", "0.05", "--json")
    assert time.monotonic() - start < 15.0
    assert [json.loads(line)["timestamp_s"] for line in reported.splitlines()] == [
        0.0,
        20.0,
        40.0,
        60.0,
    ]


def test_files_are_written_and_agree(toy: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    (tmp_path / "regions.toml").write_text('[[regions]]\nname = "thumb"\nmarkers = [14, 15]\n')
    out, table, sums = (tmp_path / name for name in ("out.csv", "out.parquet", "sums.csv"))
    reported, besides = run(
        toy / "decoder", toy / "frames", "--fps", "10", "--csv", out, "--parquet", table,
        "--regions", tmp_path / "regions.toml", "--record-regions", sums,
    )  # fmt: skip
    assert reported == ""
    assert f"5 rows in {out}, 4 rows in {sums}, 5 rows in {table}" in besides
    rows = rows_of(out)
    assert [row["markers"] for row in rows] == ["", "14", "14 15", "29", "7"]
    assert [row["region"] for row in rows] == ["", "thumb", "thumb", "", ""]
    same = parquet.read_table(table)
    assert same["force_N"].to_pylist()[1:] == [float(row["force_N"]) for row in rows[1:]]
    sent = [float(row["region_thumb_N"]) for row in rows_of(sums)]
    assert sent == pytest.approx([0.0, 3.0, 4.5, 0.0], abs=0.3)
    alone = tmp_path / "alone.parquet"
    run(toy / "decoder", toy / "frames", "--fps", "10", "--parquet", alone)
    assert parquet.read_table(alone)["id"].to_pylist() == same["id"].to_pylist()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "alone.parquet", "out.csv", "out.parquet", "regions.toml", "sums.csv"
    ]  # fmt: skip


def test_tables_say_why_a_frame_is_doubtful(toy: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    frames = shutil.copytree(toy / "frames", tmp_path / "frames")
    lost = cv2.imread(str(frames / "frame_1.png"))
    lost[:, : lost.shape[1] // 3] = 0
    cv2.imwrite(str(frames / "frame_4.png"), lost)
    cv2.imwrite(str(frames / "frame_5.png"), np.zeros_like(lost))
    (tmp_path / "regions.toml").write_text('[[regions]]\nname = "thumb"\nmarkers = [14, 15]\n')
    out, table, sums = (tmp_path / name for name in ("out.csv", "out.parquet", "sums.csv"))
    words = (toy / "decoder", frames, "--fps", "10")
    run(
        *words, "--csv", out, "--parquet", table,
        "--regions", tmp_path / "regions.toml", "--record-regions", sums,
    )  # fmt: skip
    messages = [json.loads(line) for line in run(*words, "--json")[0].splitlines()]
    texts = ["; ".join(message["warnings"]) for message in messages]
    assert [bool(text) for text in texts] == [False] * 4 + [True, True]
    assert not messages[5]["valid"]
    for row in rows_of(out):
        assert row["warnings"] == texts[int(row["sequence"])]
    assert [row["warnings"] for row in rows_of(sums)] == texts
    assert parquet.read_table(table)["warnings"].to_pylist()[-2:] == texts[-2:]


def test_one_image_can_be_a_recording_as_well(toy: Path, tmp_path: Path) -> None:
    out, image = tmp_path / "out.csv", toy / "frames" / "frame_2.png"
    run(toy / "decoder", image, "--csv", out)
    assert [row["markers"] for row in rows_of(out)] == ["14 15", "29"]
    assert run(toy / "decoder", image, "--fps", "30")[0].startswith("     0      0.000 s     6.")


def test_a_file_that_is_there_is_kept(toy: Path, tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("mine")
    for option in ("--csv", "--parquet", "--record-regions"):
        with refused("output-exists") as caught:
            run(toy / "decoder", toy / "frames", option, taken)
        caught.match(f"is there already; give {option} another name")
    assert taken.read_text() == "mine"
    with refused("regions-missing") as caught:
        run(toy / "decoder", toy / "frames", "--record-regions", tmp_path / "sums.csv")
    caught.match("--regions")
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_rows_of_a_run_that_was_cut_off_are_kept(toy: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow.parquet")
    table, rows = tmp_path / "out.parquet", tmp_path / "out.parquet.csv"
    rows.write_text("mine")
    with refused("output-partial-exists") as caught:
        run(toy / "decoder", toy / "frames", "--parquet", table)
    caught.match(f"phytac convert {rows} {table}")
    assert rows.read_text() == "mine"
    assert not table.exists()
    with refused("output-name-twice"):
        run(toy / "decoder", toy / "frames", "--csv", table, "--parquet", table)


def test_parquet_without_its_library_is_rejected_first(
    toy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "pyarrow"] or ["pyarrow"]:
        monkeypatch.setitem(sys.modules, name, None)
    with refused("missing-library"):
        run(toy / "decoder", toy / "frames", "--parquet", tmp_path / "out.parquet")
    assert list(tmp_path.iterdir()) == []


def test_a_broken_frame_is_reported_and_skipped(toy: Path, tmp_path: Path) -> None:
    frames = folder_of(tmp_path / "frames", PRESSES)
    torn, black = frames / "frame_1.png", np.zeros((120, 160, 3), dtype=np.uint8)
    torn.write_bytes(torn.read_bytes()[:-20])
    cv2.imwrite(str(frames / "frame_2.png"), black)
    reported, besides = run(toy / "decoder", frames, "--csv", tmp_path / "out.csv", "--json")
    messages = [json.loads(line) for line in reported.splitlines()]
    assert [(m["sequence"], m["valid"]) for m in messages] == [(0, True), (2, False), (3, True)]
    assert "frame 1 skipped" in besides
    assert "frame 2: the frame cannot be decoded: found 0 of 30 markers" in besides
    assert "3 frames in" in besides
    assert "1 unread, 1 skipped" in besides
    assert [row["valid"] for row in rows_of(tmp_path / "out.csv")] == ["1", "0", "1"]
    reported, _ = run(toy / "decoder", frames)
    assert "could not be decoded" in reported.splitlines()[1]


def test_nothing_but_broken_frames_is_an_error(toy: Path, tmp_path: Path) -> None:
    frames = folder_of(tmp_path / "frames", [{}, {}])
    for path in frames.iterdir():
        cv2.imwrite(str(path), np.zeros((120, 160, 3), dtype=np.uint8))
    with refused("no-frames-decoded"):
        run(toy / "decoder", frames)


def test_torn_frames_give_a_warning(toy: Path, tmp_path: Path) -> None:
    frames, rng = tmp_path / "frames", np.random.default_rng(0)
    frames.mkdir()
    still = toy_frame({14: 3.0}).astype(np.float64)
    shots = [np.rint(still + rng.normal(0.0, 2.0, still.shape)) for _ in range(8)]
    shots[6][60:] = shots[5][60:]
    for number, shot in enumerate(shots):
        image = np.clip(shot, 0, 255).astype(np.uint8)
        cv2.imwrite(str(frames / f"{number}.png"), image)
    for more in ((), ("--follow", "--rest", toy / "frames" / "frame_0.png")):
        reported, _ = run(toy / "decoder", frames, "--json", *more)
        warned = [json.loads(line)["warnings"] for line in reported.splitlines()]
        assert ["torn" in " ".join(texts) for texts in warned] == [False] * 6 + [True, False]


def test_a_video_is_read(toy: Path, tmp_path: Path) -> None:
    video = tmp_path / "press.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (160, 120))
    assert writer.isOpened()
    writer.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
    for pressed in PRESSES:
        writer.write(toy_frame(pressed))
    writer.release()
    reported, _ = run(toy / "decoder", video, "--json")
    messages = [json.loads(line) for line in reported.splitlines()]
    assert [m["timestamp_s"] for m in messages] == pytest.approx([0.0, 0.05, 0.1, 0.15], abs=1e-3)
    assert [m["koi"] for m in messages] == [[], [14], [14, 15, 29], [7]]
    assert [m["total_N"] for m in messages] == pytest.approx([0, 3, 6.5, 2], abs=0.6)


def test_the_recordings_own_beginning_is_its_rest(toy: Path, tmp_path: Path) -> None:
    """A camera that sits 3 px off: only its own frame shows the rest state."""
    frames = tmp_path / "frames"
    frames.mkdir()
    presses: list[Mapping[int, float]] = [{}, {}, {14: 3.0}]
    for number, pressed in enumerate(presses):
        cv2.imwrite(str(frames / f"{number}.png"), np.roll(toy_frame(pressed), 3, axis=1))
    with refused("no-frames-decoded"):
        run(toy / "decoder", frames)
    reported, besides = run(toy / "decoder", frames, "--rest-first", "2", "--json")
    assert "new rest frame" not in besides
    totals = [json.loads(line)["total_N"] for line in reported.splitlines()]
    assert totals == pytest.approx([0.0, 0.0, 3.0], abs=0.15)
    same, _ = run(toy / "decoder", frames, "--rest", frames / "0.png", "--json")
    assert json.loads(same.splitlines()[2])["total_N"] == pytest.approx(totals[2], abs=0.05)
    with refused("rest-options-exclusive"):
        run(toy / "decoder", frames, "--rest", frames / "0.png", "--rest-first", "1")
    for source in (frames, frames / "2.png"):
        _, pressed = run(toy / "decoder", source, "--rest", frames / "2.png")
        assert "warning: switches are on in the rest frame, those of receptors 14" in pressed
    assert "switches are on in the rest" not in besides
    with refused("rest-frames-too-few"):
        run(toy / "decoder", frames, "--rest-first", "4")


def test_markers_can_be_followed(toy: Path, tmp_path: Path) -> None:
    step: list[Mapping[int, float]] = [{}, {}, {14: 0.8}, {14: 1.6}]
    frames = folder_of(tmp_path / "frames", step)
    with refused("rest-frame-missing"):
        run(toy / "decoder", frames, "--follow")
    reported, _ = run(toy / "decoder", frames, "--follow", "--rest-first", "1", "--json")
    assert json.loads(reported.splitlines()[3])["total_N"] == pytest.approx(1.6, abs=0.2)


def test_the_bundles_regions_are_printed_and_can_be_replaced(toy: Path, tmp_path: Path) -> None:
    named = replace(toy_bundle(), regions=(Region(name="thumb", markers=(14, 15)),))
    save_bundle(named, tmp_path / "decoder")
    reported, _ = run(tmp_path / "decoder", toy / "frames")
    assert "mm thumb" in reported.splitlines()[1]
    assert re.search(r"  thumb 4\.\d\d N", reported.splitlines()[2])
    image = toy / "frames" / "frame_2.png"
    words = (tmp_path / "decoder", image, "--estimator", "koi_inverse")
    assert re.search(r"^  region thumb  4\.\d\d N$", run(*words)[0], re.MULTILINE)
    assert json.loads(run(*words, "--json")[0])["regions"]["thumb"] == pytest.approx(4.5, abs=0.3)
    other = tmp_path / "other.toml"
    other.write_text('[[regions]]\nname = "palm"\nmarkers = [29]\n')
    result = json.loads(run(*words, "--json", "--regions", other)[0])
    assert list(result["regions"]) == ["palm"]


def test_each_kind_of_warning_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    printer = FramePrinter(as_json=False, rows=False)
    for number, warnings in enumerate(
        (["1 switches (3) are stuck", "dark"], ["2 switches (3, 41) are stuck"], [])
    ):
        printer.publish({"sequence": number, "valid": True, "warnings": warnings})
    assert capsys.readouterr().err.splitlines() == [
        "warning: frame 0: 1 switches (3) are stuck",
        "warning: frame 0: dark",
    ]
    assert (printer.valid, printer.flagged) == (3, 2)


def test_what_a_camera_gave_is_kept_when_it_goes(
    toy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    warm_up = 20

    def picture(number: int) -> ImageArray:
        return toy_frame(PRESSES[max(number - warm_up, 0)])

    world = VirtualWorld(picture=picture, frames=warm_up + 3, period_s=0.1)
    install(monkeypatch, world, lost_s=0.5, give_up_s=0.5, warm_up_s=5.0)
    out = tmp_path / "out.parquet"
    with refused("camera-silent"):
        run(toy / "decoder", "7", "--parquet", out)
    table = parquet.read_table(out)
    assert table["sequence"].to_pylist() == [0, 1, 2, 2]
    assert table["force_N"].to_pylist()[1] == pytest.approx(3.0, abs=0.15)
    assert [path.name for path in tmp_path.iterdir()] == ["out.parquet"]


def test_rest_frames_come_from_the_camera_that_runs(
    toy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def picture(number: int) -> ImageArray:
        world.plugged = number < 80
        return toy_frame({14: 3.0} if number > 50 else {})

    world = VirtualWorld(picture=picture, period_s=0.02)
    install(monkeypatch, world, lost_s=0.3, give_up_s=0.3)
    out = tmp_path / "out.csv"
    words = (toy / "decoder", "7", "--rest-first", "20", "--control", "gain=9", "--csv", out)
    with refused("camera-silent"):
        run(*words)
    assert sum(camera.number >= 0 for camera in world.opened) == 1
    assert world.opened[0].held[cv2.CAP_PROP_GAIN] == 9.0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert {row["valid"] for row in rows} == {"1"}
    assert float(rows[-1]["force_N"]) == pytest.approx(3.0, abs=0.15)
    # The stream's time begins after the rest frames.
    assert float(rows[0]["timestamp_s"]) < 0.35


def test_progress_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    for count, words in ((40, "12 of 40 frames, 6.0 a second"), (None, "12 frames, 6.0 a second")):
        decode_command._progress(count, rows=False)(Progress(seconds=2.0, frames=12, fps=6.0))
        assert words in capsys.readouterr().err


def test_errors(toy: Path, tmp_path: Path) -> None:
    for words, code in (
        ((tmp_path, toy / "frames"), "bundle-not-found"),
        ((toy / "decoder", tmp_path / "none"), "file-unreadable"),
        ((toy / "decoder", tmp_path / "none.png"), "file-unreadable"),
        ((toy / "decoder", toy / "frames", toy / "frames"), "camera-count"),
        ((toy / "decoder", toy / "frames", "--estimator", "auto"), "estimator-unknown"),
        ((toy / "decoder", toy / "frames", "--fps", "-1"), "frame-rate-invalid"),
        ((toy / "decoder", toy / "frames" / "frame_1.png", "--rest", "no.png"), "file-unreadable"),
    ):
        with refused(code):
            run(*words)


def test_what_was_decoded_is_kept_when_it_is_stopped(toy: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    frames, count = tmp_path / "frames", 3000
    frames.mkdir()
    for number in range(count):
        (frames / f"{number}.png").symlink_to(toy / "frames" / f"frame_{number % 4}.png")
    out, table = tmp_path / "out.csv", tmp_path / "out.parquet"
    words = [str(toy / "decoder"), str(frames), "--json"]
    done = subprocess.Popen(
        ["env", "--default-signal=INT", *ALONE, *words, "--csv", str(out), "--parquet", str(table)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )
    with done:
        try:
            assert done.stdout is not None
            assert select.select([done.stdout], [], [], PATIENCE_S)[0]
            for _ in range(5):
                last = json.loads(done.stdout.readline())["sequence"]
            done.send_signal(signal.SIGINT)
            _, errors = done.communicate(timeout=PATIENCE_S)
        finally:
            done.kill()
    assert done.returncode == 130
    assert "Traceback" not in errors
    numbers = {int(row["sequence"]) for row in rows_of(out)}
    assert set(range(last)) <= numbers
    assert len(numbers) < count
    assert parquet.read_table(table).num_rows == len(rows_of(out))


def test_intervals_hold_the_true_force_on_a_contacts_switches() -> None:
    contact: Any = SimpleNamespace(markers=np.array([3, 5]), force_N=10.0, sd_N=1.0)
    inside = _true_interval(contact, {3: 6.0, 5: 5.6, 9: 2.0})
    assert inside == {
        "true_force_N": 11.6,
        "interval_90_N": [8.3551, 11.6449],
        "true_force_inside": True,
    }
    assert not _true_interval(contact, {3: 6.0, 5: 5.7})["true_force_inside"]
    assert _true_interval(contact, {9: 2.0})["true_force_N"] == 0.0
    assert _true_interval(contact, {}) == {}
    contact.markers = np.array([], dtype=int)
    assert _true_interval(contact, {3: 6.0}) == {}


def test_a_moved_camera_without_a_rest_frame_names_it() -> None:
    reading = Reading.none("the camera has turned", "rest-frame-outdated")
    assert "give --rest FRAME" in str(_no_forces(reading, "toy", with_rest=False))
    assert str(_no_forces(reading, "toy", with_rest=True)).endswith("the camera has turned")
