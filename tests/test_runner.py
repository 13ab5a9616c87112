"""Stages side by side: the files and errors of one after the other, and nothing left behind."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from phytac_design.cli.app import app
from phytac_design.design.design_file import to_toml
from phytac_design.engine import cache, runner
from phytac_design.engine.runner import StageCosts, StageRun
from phytac_design.engine.stage import Context, Stage
from phytac_design.stages import STAGES
from phytac_design.stages.build import run_stages
from tests.designs import COARSE, tiny
from tests.refusals import refused
from tests.stage_works import add, die, fail, fail_at_once, graph, leave_out, meet, refusal, wait


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def run(
    stages: list[Stage], workers: int, **options: Any
) -> tuple[Context, list[str], dict[str, float]]:
    """Run stages quietly."""
    given = {"progress": lambda _: None} | options
    return run_stages(tiny(), stages, accuracy=COARSE, seed=0, workers=workers, **given)


def stage_run(stages: list[Stage], keep: ExitStack, costs: StageCosts, said: list[str]) -> StageRun:
    """A run with costs that are known."""
    context = Context(design=tiny(), accuracy=COARSE, seed=0, progress=said.append)
    return StageRun(context, stages, keep=keep, costs=lambda: costs)


def left_over(root: Path) -> list[Path]:
    """Scratch folders and locks."""
    return list(root.glob("*/.*"))


DIAMOND = graph(a=(add, ""), b=(add, "a"), c=(add, "a"), d=(add, "bc"))


@pytest.mark.parametrize("workers", [1, 2])
def test_results_do_not_depend_on_the_workers(workers: int, root: Path) -> None:
    said: list[str] = []
    context, ran, timing = run(DIAMOND, workers, progress=said.append)
    assert context.facts("d")["number"] == 5
    assert ran == list(timing) == ["a", "b", "c", "d"]
    assert "adding 2 numbers" in said
    assert said[0] == "[0/4] a …"
    lines = [line.split(" 0.")[0] for line in said if line.startswith("[")]
    # The numbers count stages that have ended, in whatever order.
    ended = [line.split("]")[0] for line in lines if not line.endswith("…")]
    assert ended == [f"[{k + 1}/4" for k in range(4)]
    assert [line.split("]")[0] for line in lines] == sorted(line.split("]")[0] for line in lines)
    assert sorted(line.split()[1] for line in lines) == sorted("abcd" * 2)
    assert run(DIAMOND, workers)[1] == []
    assert not left_over(root)


def test_what_is_left_out_is_said_again_from_the_cache() -> None:
    first: list[str] = []
    again: list[str] = []
    stages = graph(a=(leave_out, ""), b=(add, ""))
    assert run(stages, 1, progress=first.append)[1] == ["a", "b"]
    assert run(stages, 1, progress=again.append)[1] == []
    assert "a: left out (no room)" in first
    assert again == ["a: left out (no room)"]


def test_ready_stages_run_at_the_same_time_in_other_processes() -> None:
    context, _, _ = run(graph(a=(meet, ""), b=(meet, ""), c=(meet, "a")), 2)
    a, b, c = (context.facts(name)["process"] for name in "abc")
    assert a != b
    assert os.getpid() not in {a, b}
    assert c in {a, b}


@pytest.mark.parametrize("workers", [1, 2])
def test_the_error_is_that_of_the_first_stage_in_order_that_fails(workers: int, root: Path) -> None:
    stages = graph(a=(add, ""), b=(fail, ""), c=(fail_at_once, ""), d=(wait, "a"))
    with refused("thing-bad"):
        run(stages, workers)
    assert not left_over(root)
    assert [path.name for path in root.glob("*/*")] == [path.name for path in root.glob("a/*")]
    assert run(stages[:1], workers)[1] == []


def test_an_error_of_the_program_keeps_its_type_and_names_its_line() -> None:
    with pytest.raises(ValueError, match="a fault of the program") as caught:
        run(graph(b=(add, ""), c=(fail_at_once, "")), 2)
    assert any("in fail_at_once" in note for note in caught.value.__notes__)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_gate_stops_stages_that_run(workers: int, root: Path) -> None:
    gate = Stage(name="gate", design_fields=(), run=add, gate=refusal)
    stages = [gate, *graph(a=(wait, ""))]
    begin = time.monotonic()
    with refused("build-gate"):
        run(stages, workers)
    assert time.monotonic() - begin < 30.0
    assert not left_over(root)
    # From the cache it stops the build as well.
    with refused("build-gate"):
        run(stages, workers)
    assert run([gate, *DIAMOND], workers, force=True)[1] == ["a", "b", "c", "d"]


def test_a_stage_whose_process_dies_twice_is_an_error(root: Path) -> None:
    with refused("stage-process-died") as caught:
        run(graph(a=(add, ""), b=(die, "a"), c=(add, "a")), 2)
    caught.match(r"b was started twice .*exit code -9")
    assert not left_over(root)
    assert run(graph(a=(add, "")), 2)[1] == []


def test_ctrl_c_leaves_no_process_and_nothing_half_made(root: Path) -> None:
    processes: list[int] = []

    def stop(text: str) -> None:
        if text.startswith("process"):
            processes.append(int(text.split()[1]))
            if len(processes) == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(graph(a=(wait, ""), b=(wait, ""), c=(add, "")), 2, progress=stop)
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)
    assert not left_over(root)


SCRIPT = """
def say(text):
    print(text, flush=True)
if __name__ == "__main__":  # workers read this file as well, and need none of these
    from phytac_design.stages.build import run_stages
    from tests.designs import COARSE, tiny
    from tests.stage_works import graph, wait
    stages = graph(a=(wait, ""), b=(wait, ""))
    run_stages(tiny(), stages, accuracy=COARSE, seed=0, workers=2, progress=say)
"""


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_workers_end_with_the_build(how: signal.Signals, tmp_path: Path, root: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    path = os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)])
    parent = subprocess.Popen(
        [sys.executable, str(script)],
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert parent.stdout is not None
    processes: list[int] = []
    while len(processes) < 2:
        line = parent.stdout.readline()
        assert line
        if line.startswith("process"):
            processes.append(int(line.split()[1]))
    parent.send_signal(how)
    parent.communicate(timeout=20.0)
    assert parent.returncode == -how
    deadline = time.monotonic() + 10.0
    while any(Path(f"/proc/{process}").exists() for process in processes):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    # What a killed build has left is swept as soon as another one asks for it.
    cache.prune(limit_bytes=float("inf"))
    assert not left_over(root)
    assert not list(root.glob("*/*"))


def test_stages_that_do_not_fit_the_memory_together_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "available_memory_MB", lambda: 2000.0)
    stages = graph(a=(add, ""), b=(add, ""), c=(add, ""))
    costs = StageCosts(seconds={}, memory_MB={"a": 9000.0, "b": 900.0, "c": 600.0})
    with ExitStack() as keep:
        some = stage_run(stages, keep, costs, [])
        # Alone, a stage runs whatever it needs.
        assert some._next(stages, [0]) == (0, stages[0])
        some._begun["a"] = 0.0
        assert some._next(stages, [0]) is None
        some._begun = {"b": 0.0}
        assert some._next(stages[1:], [0]) == (0, stages[2])
        some._begun["c"] = 0.0
        assert some._next(stages, [0]) is None


def test_the_longest_way_to_the_end_starts_first() -> None:
    stages = graph(a=(add, ""), b=(add, ""), c=(add, "b"))
    costs = StageCosts(seconds={"a": 3.0, "b": 1.0, "c": 9.0}, memory_MB={})
    with ExitStack() as keep:
        assert stage_run(stages, keep, costs, [])._next(stages, [0]) == (0, stages[1])


def test_packages_that_stages_import_are_known() -> None:
    assert {name for stage in STAGES for name in stage.imports} == runner.IMPORT_s.keys()


def test_packages_are_imported_by_one_worker_while_others_have_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(runner, "IMPORT_s", {"slow": 1.5})
    a, b, c = graph(a=(add, ""), b=(add, ""), c=(add, ""))
    a, b = (replace(stage, imports=("slow",)) for stage in (a, b))
    costs = StageCosts(seconds={"a": 3.0, "b": 2.0, "c": 1.0}, memory_MB={})
    with ExitStack() as keep:
        some = stage_run([a, b, c], keep, costs, [])
        assert some._next([a, b, c], [0, 1]) == (0, a)
        some._begun["a"], some._imported[0] = 0.0, {"slow"}
        # Worker 1 would import the package again: it does something else if that is as urgent.
        assert some._next([a, b, c], [1]) == (1, c)
        assert some._next([a, b], [1]) == (1, b)
        some._ranks["b"] = 3.0
        assert some._next([a, b, c], [1]) == (1, b)
        del some._begun["a"]
        some.context.folders["a"] = Path()
        assert some._next([a, b, c], [1, 0]) == (0, b)


def test_the_time_left_is_that_of_a_schedule_on_the_workers() -> None:
    stages = graph(a=(add, ""), b=(add, ""), c=(add, "b"), d=(add, "ac"))
    costs = StageCosts(seconds={"a": 30.0, "b": 10.0, "c": 40.0, "d": 5.0}, memory_MB={})
    said: list[str] = []
    with ExitStack() as keep:
        one, two = (stage_run(stages, keep, costs, said) for _ in range(2))
        assert one.left_s() == pytest.approx(85.0)
        two._workers = 2
        assert two.left_s() == pytest.approx(55.0)
        # b took 5 s in place of 10, and a fifth of all 85 s counts as predicted rightly.
        two.timing_s["b"] = 5.0
        two.context.folders["b"] = Path()
        scale = 22.0 / 27.0
        assert two.left_s() == pytest.approx(45.0 * scale)
        two._begun["c"] = time.monotonic() - 8.0
        assert two.left_s() == pytest.approx(45.0 * scale - 8.0, abs=0.1)
        one.run(1)
    assert said[0].startswith("[0/4] a … (about 85 s left)")
    assert said[-1].startswith("[4/4] d ")
    assert not said[-1].endswith("left)")


def test_a_stage_that_takes_longer_than_predicted_is_not_about_to_end() -> None:
    costs = StageCosts(seconds={"a": 10.0}, memory_MB={})
    with ExitStack() as keep:
        late = stage_run(graph(a=(add, "")), keep, costs, [])
        late._begun["a"] = time.monotonic() - 60.0
        assert late.left_s() == pytest.approx(6.0, abs=0.1)


def test_builds_by_one_and_two_workers_are_equal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All files, each build from an empty cache; ``benchmarks.build`` has whole builds, by four."""
    design = tmp_path / "tiny.toml"
    design.write_text(to_toml(tiny()))
    found = []
    for workers in (1, 2):
        out = tmp_path / f"out{workers}"
        words = f"build {design} --accuracy draft --only shell,mesh --workers {workers} --json"
        monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / f"cache{workers}"))
        done = CliRunner().invoke(app, [*words.split(), "--out", str(out)])
        assert done.exit_code == 0, done.output
        ran = json.loads(done.stdout)["ran"]
        assert len(ran) == 2
        lines = [line for line in done.stderr.splitlines() if "s left)" in line]
        assert len(lines) == 2 * len(ran) - 1  # none after the last one has ended
        manifest = json.loads((out / "manifest.json").read_text())
        found.append({item["path"]: item["sha256"] for item in manifest["files"]})
    assert len(found[0]) > 4
    assert found[0] == found[1]
