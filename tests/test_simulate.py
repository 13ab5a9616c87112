"""The simulation as a whole: the same data however it is made, resumed, rejected, and reported."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from phytac_decoder.io.bundle import save_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_design.cli.app import app
from phytac_design.cli.simulate_commands import _say_frames
from phytac_design.core.journal import Journal
from phytac_design.datasets.samples import STATUSES, Samples
from phytac_design.datasets.samples_file import FILE, TABLE, read_samples
from phytac_design.design.design_file import design_hash, load_design, to_toml
from phytac_design.simulation.run.job import Job
from phytac_design.simulation.scenario.scenario_file import Scenario, load_scenario, parse_scenario
from phytac_design.stages.build import copy_of
from phytac_design.workflows.simulate import (
    JOURNAL_FOLDER,
    ImagingReference,
    SimulationResult,
    imaging_model,
    observe_rest,
    simulate,
    write_rest,
)
from phytac_shapes.errors import DesignError
from tests.decoder.toy_sensor import toy_bundle
from tests.designs import CAMERA, small
from tests.refusals import refused

SMALL = small(
    shape={"length_mm": 40.0},
    layout={"rows": 5, "columns": 10, "height_far_mm": 4.0},
    training={"samples": 20},
    camera=CAMERA,
)


def scenario(**tables: Any) -> Scenario:
    """The smoke scenario with some fields changed."""
    data = load_scenario("smoke").model_dump(mode="json", exclude_unset=True)
    # A third of the points a pixel: nothing here depends on how well frames are rendered.
    data["solve"] = {**data.get("solve", {}), "samples_per_pixel": 8}
    for table, fields in tables.items():
        data[table] = {**data.get(table, {}), **fields}
    return parse_scenario(data, "smoke")


def job_of(**changes: Any) -> Job:
    """A job of few samples on a coarse mesh."""
    tables = {"touch": {"samples": 6}, **changes.pop("tables", {})}
    base = Job(design=SMALL, scenario=scenario(**tables), seed=3, accuracy="draft")
    return replace(base, **changes)


def run(job: Job, out: Path, **settings: Any) -> SimulationResult:
    """Simulate quietly."""
    return simulate(job, out, progress=lambda _: None, **settings)


def files(out: Path) -> dict[str, bytes]:
    """All files of a data set."""
    return {
        path.relative_to(out).as_posix(): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module", autouse=True)
def _rest_once() -> Iterator[None]:
    """What an instance shows at rest is found once; processes of their own find it again."""
    known: dict[tuple[object, ...], ImagingReference] = {}

    def observed(job: Job, progress: Callable[[str], None]) -> ImagingReference:
        touched = job.scenario.model_dump_json(exclude={"touch"})
        key = (design_hash(job.design), touched, job.seed, job.accuracy)
        if key not in known:
            known[key] = observe_rest(job, progress)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phytac_design.workflows.simulate.observe_rest", observed)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set made by one process without a break."""
    out = tmp_path_factory.mktemp("whole") / "data"
    assert run(job_of(), out, workers=0).solved == 6
    return out


def read(out: Path) -> Samples:
    """Samples of a data set."""
    return read_samples(out, check_frames=True)[0]


def test_samples_hold_what_was_pressed_and_what_was_seen(whole: Path) -> None:
    samples, meta = read_samples(whole)
    plan = job_of().plan
    assert meta.simulated
    assert "simulated" in meta.what
    assert set(samples.status.tolist()) == {0}
    assert samples.touches is not None
    np.testing.assert_allclose(samples.touches.force_N, plan.touches.force_N)
    assert samples.shift_px is not None
    moved = np.linalg.norm(samples.shift_px, axis=2)
    # A marker beside a press moves more than most of its own frame do.
    most, usual = np.nanmax(moved, axis=1), np.nanmedian(moved, axis=1)
    assert (most[samples.contacts > 0] > 4.0 * usual[samples.contacts > 0]).all()
    assert samples.truth is not None
    total = np.zeros(samples.count)
    np.add.at(total, samples.truth.sample, samples.truth.force_N)
    tripped = np.zeros(samples.count)
    np.add.at(tripped, plan.touches.sample, plan.touches.force_N * plan.switching.tripped)
    np.testing.assert_allclose(total, tripped, rtol=1e-6, atol=1e-6)


def test_another_seed_and_another_print_give_other_data(whole: Path, tmp_path: Path) -> None:
    run(job_of(seed=4, tables={"touch": {"samples": 2}}), tmp_path / "seed", workers=0)
    run(job_of(tables={"unit": {"number": 2}}), tmp_path / "print", workers=0)
    first, print_two = read(whole), read(tmp_path / "print")
    assert first.shift_px is not None
    assert print_two.shift_px is not None
    assert read(tmp_path / "seed").total_N[0] != first.total_N[0]
    np.testing.assert_array_equal(first.total_N, print_two.total_N)
    apart = np.abs(first.shift_px - print_two.shift_px)
    assert 0.05 < np.nanmax(apart) < np.nanmax(np.abs(first.shift_px))


def test_a_journal_half_done_is_finished_and_damage_is_repaired(
    whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "data"
    job = job_of()
    with pytest.raises(_StopError):
        simulate(job, out, workers=0, progress=_stop_after(3))
    done = sorted((out / JOURNAL_FOLDER).glob("*/*.bin"))
    assert 3 <= len(done) < 6
    done[0].write_bytes(done[0].read_bytes()[:-7])
    said: list[str] = []
    result = simulate(job, out, workers=0, progress=said.append)
    assert result.solved == 6 - len(done) + 1
    assert any(f"{len(done) - 1} of 6 samples were done before" in line for line in said)
    assert files(out) == files(whole)


class _StopError(Exception):
    pass


def _stop_after(count: int) -> Any:
    def progress(text: str) -> None:
        done = int(text.split()[1]) if " of 6 samples" in text else 0
        if done >= count:
            raise _StopError

    return progress


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Progress after every sample."""
    monkeypatch.setattr("phytac_design.workflows.simulate.PROGRESS_INTERVAL_s", 0.0)


def test_a_killed_command_is_resumed_by_more_processes_and_gives_the_same_files(
    whole: Path, tmp_path: Path
) -> None:
    """Neither what was killed nor the number of processes shows in the data."""
    design = tmp_path / "small.toml"
    design.write_text(to_toml(SMALL))
    coarse = tmp_path / "smoke.toml"
    smoke = resources.files("phytac_design") / "data" / "scenarios" / "smoke.toml"
    coarse.write_text(smoke.read_text() + "\n[solve]\nsamples_per_pixel = 8\n")
    out = tmp_path / "data"
    command = [
        sys.executable, "-m", "phytac_design", "simulate", str(design), str(coarse),
        "--samples", "6", "--seed", "3", "--accuracy", "draft", "--workers", "1",
        "--out", str(out),
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end = time.monotonic() + 120.0
    while not list((out / JOURNAL_FOLDER).glob("*/*.bin")) and time.monotonic() < end:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (out / TABLE).exists()
    done = CliRunner().invoke(app, [*command[3:], "--workers", "2", "--json"])
    assert done.exit_code == 0, done.output
    assert 0 < json.loads(done.stdout)["solved"] < 6
    assert "were done before" in done.stderr
    assert files(out) == files(whole)
    assert set(files(whole)) == {TABLE, FILE}


def test_a_data_set_that_exists_is_kept_or_rejected(whole: Path) -> None:
    before = files(whole)
    assert run(job_of(), whole, workers=0).solved == 0
    with refused("output-foreign"):
        run(job_of(seed=9), whole)
    with refused("workers-negative"):
        run(job_of(), whole, workers=-1)
    assert files(whole) == before


def test_force_replaces_a_data_set(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "data")
    (tmp_path / "data" / FILE).write_bytes(b"")
    with refused("output-foreign"):
        run(job_of(), tmp_path / "data", workers=0)
    job = job_of(tables={"touch": {"samples": 1}})
    run(job, tmp_path / "data", workers=0, force=True)
    assert read(tmp_path / "data").count == 1


@pytest.mark.parametrize(
    "name", [FILE, "frames/000000.png", "rest.png", "truth.csv", "design.toml"]
)
def test_files_of_somebody_else_are_kept(tmp_path: Path, name: str) -> None:
    path = tmp_path / "own" / name
    path.parent.mkdir(parents=True)
    path.write_bytes(b"mine")
    with refused("output-foreign") as caught:
        run(job_of(), tmp_path / "own")
    caught.match("own is not empty and holds no data set")
    assert path.read_bytes() == b"mine"


def test_frames_are_kept_and_read_alike(tmp_path: Path) -> None:
    solve = {"route": "frames", "displacement": "linear"}
    job = job_of(tables={"solve": solve, "touch": {"samples": 2}}, keep="frames")
    out = tmp_path / "data"
    run(job, out, workers=0)
    samples, meta = read_samples(out, check_frames=True)
    assert sorted(meta.frames) == ["000000.png", "000001.png"]
    frame = read_image(out / "frames" / "000001.png")
    assert frame.shape == (SMALL.camera.height_px, SMALL.camera.width_px, 3)
    points = job_of(tables={"solve": {"displacement": "linear"}, "touch": {"samples": 2}})
    run(points, tmp_path / "points", workers=0)
    other = read(tmp_path / "points")
    assert samples.shift_px is not None
    assert other.shift_px is not None
    noise = SMALL.camera.noise_centroid_px
    assert np.nanmedian(np.abs(samples.shift_px - other.shift_px)) < 3.0 * noise
    np.testing.assert_array_equal(samples.bits_read, other.bits_read)
    # And what they were rendered with, for people.
    assert samples.touches is not None
    rows = [line.split(",") for line in (out / "truth.csv").read_text().splitlines()[1:]]
    pressed = [row for row in rows if row[2]]
    assert [float(row[1]) for row in pressed] == pytest.approx(samples.touches.force_N, abs=1e-4)
    assert [row[0] for row in pressed] == [f"{k:06d}" for k in samples.touches.sample]
    assert {f"{row[0]}.png" for row in rows} == set(meta.frames)
    # And the frame of the unloaded sensor, which no sample needs to be.
    rest, seen = (
        read_image(out / name).astype(float) for name in ("rest.png", "frames/000001.png")
    )
    again = tmp_path / "again"
    again.mkdir()
    write_rest(again, job, observe_rest(job, lambda _: None))
    assert (again / "rest.png").read_bytes() == (out / "rest.png").read_bytes()
    sharp = 6.0 * SMALL.camera.noise_pixel
    assert 0.0 < np.mean(np.abs(rest - seen).max(axis=2) > sharp) < 0.2


def test_inputs_alone_are_the_networks(tmp_path: Path) -> None:
    job = job_of(keep="inputs")
    run(job, tmp_path / "data", workers=0)
    samples = read(tmp_path / "data")
    assert samples.shift_px is None
    assert samples.key_nodes is not None
    assert samples.key_nodes.inputs_mm.shape == (len(samples.key_nodes.sample), 10)
    assert len(samples.key_nodes.sample) == int(job.plan.switching.bits.sum())


def test_a_sample_that_fails_is_reported(tmp_path: Path) -> None:
    at = {"along": 0.5, "around": 0.5, "force_N": 1e4, "radius_mm": 4.0}
    job = job_of(tables={"touch": {"samples": 1, "at": [at], "multi_share": 0.0}})
    run(job, tmp_path / "data", workers=0)
    samples = read(tmp_path / "data")
    assert STATUSES[samples.status[0]] != "ok"
    assert samples.why(0)


def test_the_command_lists_scenarios_and_refuses_nonsense() -> None:
    runner = CliRunner()
    listed = runner.invoke(app, ["scenarios", "--json"])
    assert listed.exit_code == 0
    assert {"platform", "grips", "cycles", "rims"} <= set(json.loads(listed.output))
    refused = runner.invoke(app, ["simulate", "cylinder40", "smoke", "--keep", "frames"])
    assert isinstance(refused.exception, DesignError)


def test_contacts_that_overlap_share_what_they_press(tmp_path: Path) -> None:
    at = {"marker": 25, "force_N": 5.0, "radius_mm": 3.0}
    job = job_of(tables={"touch": {"samples": 1, "at": [at, at], "multi_share": 0.0}})
    assert job.plan.switching.receptor_force_N.sum() == pytest.approx(10.0)


def test_markers_too_blurred_to_identify_are_missing_and_reported(tmp_path: Path) -> None:
    half = {"width_px": 1296, "height_px": 972, "focal_px": 485.0}
    design = copy_of(load_design("cylinder40"), camera={**half, "f_number": 1.6})
    job = job_of(design=design, tables={"touch": {"samples": 1}})
    said: list[str] = []
    simulate(job, tmp_path / "data", workers=0, progress=said.append)
    samples = read(tmp_path / "data")
    (warning,) = [line for line in said if line.startswith("warning: ")]
    assert samples.shift_px is not None
    lost = np.isnan(samples.shift_px[0, :, 0])
    said_of = re.match(r"warning: (\d+) of 216 markers \((.*) and \d+ more\) cannot be", warning)
    assert said_of
    # Some that are just identified at rest are lost in a sample.
    assert 10 < int(said_of[1]) <= lost.sum() <= int(said_of[1]) + 6
    assert lost[[int(number) for number in said_of[2].split(", ")]].all()
    assert STATUSES[samples.status[0]] == "flagged"
    # Nor is more than one that is just identified at rest mistaken for another.
    assert (np.linalg.norm(samples.shift_px[0], axis=1) > 10.0).sum() <= 1


def test_settings_reach_the_imaging_model() -> None:
    tables = {"solve": {"centroids": "pixels", "samples_per_pixel": 3}}
    imaging = imaging_model(job_of(tables=tables))
    assert (imaging.centroids, imaging.cameras[0].samples) == ("pixels", 3)
    plain = imaging_model(replace(job_of(), scenario=load_scenario("smoke")))
    assert (plain.centroids, plain.cameras[0].samples) == ("paint", 89)


def test_a_full_disk_is_an_error_with_a_fix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Journal, "put", full)
    with refused("output-not-writable"):
        run(job_of(tables={"touch": {"samples": 1}}), tmp_path / "data", workers=0)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"accuracy": "drat"}, "accuracy-unknown"),
        ({"seed": -1}, "seed-invalid"),
        ({"keep": "all"}, "keep-unknown"),
        ({"keep": "frames"}, "frames-not-rendered"),
        ({"design": "cylinder60"}, "job-not-loaded"),
    ],
)
def test_invalid_jobs_are_rejected_at_once(change: dict[str, Any], code: str) -> None:
    with refused(code):
        replace(job_of(), **change)


def test_the_journal_is_gone_at_the_end(whole: Path) -> None:
    assert not (whole / JOURNAL_FOLDER).exists()


def test_frames_are_decoded_by_the_decoder_of_their_design(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of an older state of the design would read them wrongly."""
    monkeypatch.chdir(tmp_path)
    _say_frames(SMALL, Path("data"))
    (*_, without) = capsys.readouterr().out.splitlines()
    assert without.startswith("next: phytac decode DECODER data/frames --rest data/rest.png")
    decoder = tmp_path / "exports" / SMALL.name / "decoder"
    for state, named in (("0" * 64, "DECODER"), (design_hash(SMALL), f"exports/{SMALL.name}")):
        shutil.rmtree(decoder, ignore_errors=True)
        save_bundle(replace(toy_bundle(), design_hash=state), decoder)
        _say_frames(SMALL, Path("data"))
        (*_, line) = capsys.readouterr().out.splitlines()
        assert line.startswith(f"next: phytac decode {named}")
