"""A build from the studio: followed to its report, stopped, ended with the studio; and studies."""

import contextlib
import json
import signal
import subprocess
import sys
import time
import tomllib
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from phytac_design.studio.build_process import BuildRunner
from phytac_design.studio.studies import studies, study_table
from phytac_design.study.search.design_space import make_space
from phytac_design.study.search.driver import run_study
from phytac_design.study.search.study_file import Study
from tests.refusals import refused
from tests.studio.place import DESIGN, Client, stand_in

Json = dict[str, Any]
PATIENCE_S = 60.0
"""Longest wait for anything on a machine under load."""


@pytest.fixture
def program(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The stand-in in the place of Python; its mode is a file's text."""
    path = stand_in(place, "short")
    monkeypatch.setattr("phytac_design.studio.build_process.sys.executable", str(path))
    monkeypatch.setattr(
        "phytac_design.studio.build_process.BuildRunner.stop_timeouts_s", (0.6, 0.6)
    )
    for name in ("pid", "child", "ready"):
        (place / name).unlink(missing_ok=True)
    return place


def events(client: Client) -> list[Json]:
    _, heads, body = client.ask("GET", "api/build/events")
    assert {key.lower(): value for key, value in heads.items()}["content-type"].startswith(
        "text/event-stream"
    )
    return [json.loads(part.removeprefix("data: ")) for part in body.decode().split("\n\n") if part]


def gone(pid: int, within_s: float = 20.0) -> bool:
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        state = Path(f"/proc/{pid}/stat")
        with contextlib.suppress(OSError):
            if state.read_text().split(")")[1].split()[0] == "Z":
                return True
        if not state.exists():
            return True
        time.sleep(0.05)
    return False


def wait_for(path: Path) -> str:
    until = time.monotonic() + PATIENCE_S
    while not (path.exists() and path.read_text()) and time.monotonic() < until:
        time.sleep(0.02)
    return path.read_text()


def test_a_build_is_followed_to_its_report(client: Client, program: Path, data: Json) -> None:
    (program / "mode").write_text("short")
    data["layout"]["rows"] = 7
    status, state = client.post("api/build", {"data": data, "source": "", "accuracy": "draft"})
    assert (status, state["state"], state["out"]) == (200, "running", "exports/short")
    states = events(client)
    assert states[-1]["state"] == "done"
    assert states[-1]["done"] == 1.0
    lines = [line for state in states for line in state["lines"]]
    assert lines == ["[0/2] views …", "[1/2] views 0.1 s", "[1/2] report …"]
    given = (program / "given.toml").read_text()
    assert "rows = 7" in given
    status, heads, page = client.ask("GET", f"files/{states[-1]['report']}")
    assert (status, page) == (200, b"<h1>Report of it</h1>")
    assert "sandbox" in {k.lower(): v for k, v in heads.items()}["content-security-policy"]


def test_stages_side_by_side_are_shown_together_and_the_bar_never_goes_back(tmp_path: Path) -> None:
    runner = BuildRunner(tmp_path)
    runner._state, runner._start_s = {"done": 0.0}, time.monotonic() - 30.0
    shown = []
    for line in (
        "[0/5] frames … (about 90 s left)",
        "[0/5] shell … (about 90 s left)",
        "frames: 3 of 80",
        "[1/5] shell 2.0 s (about 120 s left)",
        "[1/5] step …",
        "[2/5] frames 9.1 s (about 10 s left)",
        "[3/5] step 0.4 s",
    ):
        runner._add_line(line)
        shown.append((runner.state()["done"], runner.state()["stage"]))
    quarter = pytest.approx(0.25, abs=0.01)
    assert shown == [
        (quarter, "frames"),
        (quarter, "frames, shell"),
        (quarter, "frames, shell"),
        (quarter, "frames"),
        (quarter, "frames, step"),
        (pytest.approx(0.75, abs=0.01), "step"),
        (pytest.approx(0.75, abs=0.01), "step"),
    ]


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        ("bad", "error[wall-too-thin]: the wall is too thin; thicken it"),
        ("crash", "ValueError: deep inside"),
    ],
)
def test_a_build_that_fails_says_why(
    client: Client, program: Path, data: Json, mode: str, why: str
) -> None:
    (program / "mode").write_text(mode)
    assert client.post("api/build", {"data": data, "source": ""})[0] == 200
    last = events(client)[-1]
    assert (last["state"], last["error"]) == ("failed", why)


def test_one_build_at_a_time_and_it_can_be_stopped(
    client: Client, program: Path, data: Json
) -> None:
    (program / "mode").write_text("long")
    body = {"data": data, "source": ""}
    assert client.post("api/build", body)[0] == 200
    child = int(wait_for(program / "child"))
    status, answer = client.post("api/build", body)
    assert status == 400
    assert "is being built" in answer["error"]
    state = client.get("api/build")[1]
    assert (state["state"], state["stage"], state["done"]) == ("running", "report", 0.5)
    assert client.post("api/build/stop", {})[1]["state"] == "stopped"
    assert gone(child)
    assert client.post("api/build/stop", {})[1]["state"] == "stopped"
    (program / "mode").write_text("short")
    assert client.post("api/build", body)[0] == 200
    assert events(client)[-1]["state"] == "done"


def test_a_build_that_takes_no_word_is_killed(client: Client, program: Path, data: Json) -> None:
    (program / "mode").write_text("stubborn")
    assert client.post("api/build", {"data": data, "source": ""})[0] == 200
    (program / "ready").touch()
    pid = int(wait_for(program / "pid"))
    time.sleep(0.3)
    start = time.monotonic()
    assert client.post("api/build/stop", {})[1]["state"] == "stopped"
    assert time.monotonic() - start >= 1.0
    assert gone(pid)


def test_a_design_that_is_none_is_not_built(client: Client, program: Path, data: Json) -> None:
    data["layout"]["rows"] = 0
    status, answer = client.post("api/build", {"data": data, "source": ""})
    assert status == 422
    assert "layout.rows" in answer["fields"]
    assert client.post("api/build", {"data": data, "source": "", "accuracy": "best"})[0] == 400


def test_the_studio_ends_with_its_build(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(DESIGN)
    path = stand_in(tmp_path, "long")
    code = (
        "import sys, typer; real = sys.executable\n"
        "from phytac_design.cli.studio_command import studio\n"
        "import phytac_design.studio.build_process as builds\n"
        f"sys.executable = {str(path)!r}; builds.BuildRunner.stop_timeouts_s = (1.0, 1.0)\n"
        "typer.run(studio)"
    )
    words = [sys.executable, "-c", code, "short.toml", "--no-browser"]
    own = subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert own.stderr is not None
    try:
        url = next(word for word in own.stderr.readline().split() if word.startswith("http"))
        body = json.dumps({"data": tomllib.loads(DESIGN), "source": ""}).encode()
        heads = {"content-type": "application/json"}
        ask = urllib.request.Request(f"{url}api/build", body, heads)  # noqa: S310 - our own
        with urllib.request.urlopen(ask, timeout=PATIENCE_S) as answer:  # noqa: S310 - our own
            assert answer.status == 200
        child = int(wait_for(tmp_path / "child"))
        own.send_signal(signal.SIGTERM)
        assert own.wait(PATIENCE_S) == -signal.SIGTERM
        assert gone(child)
        assert "Traceback" not in own.stderr.read()
    finally:
        own.kill()
        own.wait()
        own.stderr.close()


@pytest.fixture(scope="module")
def studied(place: Path) -> Path:
    """A small study of the short sensor, on the cheapest level."""
    study = Study.model_validate(
        {
            "name": "heights",
            "design": "short.toml",
            "variable": [
                {"field": "layout.height_far_mm", "low": 2.0, "high": 40.0},
                {"field": "layout.kind", "choices": ["spiral", "straight"]},
            ],
            "objective": [
                {"measure": "mass_g", "goal": "min"},
                {"measure": "height_most_mm", "goal": "max"},
            ],
            "budget": {"candidates": 16},
            "sampling": {"batch": 16},
        }
    )
    (place / "short.toml").write_text(DESIGN)
    folder = place / "studies" / "heights"
    run_study(study, make_space(study, place), folder, kind="sweep", progress=lambda _: None)
    return folder


def test_studies_are_found_and_shown(client: Client, studied: Path) -> None:
    status, found = client.get("api/studies")
    assert status == 200
    (one,) = [item for item in found["studies"] if item["folder"] == "studies/heights"]
    assert (one["name"], one["kind"], one["design"]) == ("heights", "sweep", "short")
    status, table = client.post("api/study", {"folder": "studies/heights"})
    assert status == 200
    assert table["candidates"] == len(table["rows"]) == 16
    assert table["goals"] == {"mass_g": "min", "height_most_mm": "max"}
    fronts = [row["front"] for row in table["rows"]]
    assert fronts == sorted(fronts, reverse=True)
    assert any(fronts)
    refused = [row for row in table["rows"] if row["status"] == "refused"]
    assert refused
    assert refused[0]["reason"]


def test_a_trial_opens_as_the_design_it_was(client: Client, studied: Path) -> None:
    table = client.post("api/study", {"folder": "studies/heights"})[1]
    row = table["rows"][0]
    body = {"folder": "studies/heights", "trial": row["trial"]}
    status, opened = client.post("api/trial", body)
    assert status == 200
    assert opened["data"]["layout"]["height_far_mm"] == pytest.approx(row["values"][0], rel=1e-5)
    assert opened["data"]["layout"]["kind"] == row["values"][1]
    drawn = client.post("api/draft", {"data": opened["data"], "source": "", "tab": "t"})[1]
    measured = {item["name"]: item["value"] for item in drawn["measures"]}
    assert measured["mass_g"] == pytest.approx(row["values"][2], rel=1e-5)


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ({"folder": "../x"}, "is not in the folder"),
        ({"folder": "nothing"}, "holds no study"),
        ({"folder": "studies/heights", "trial": 99}, "has no trial 99"),
        ({"folder": "studies/heights", "trial": -1}, "trial"),
        ({"folder": "studies/heights", "trial": 1.5}, "trial"),
    ],
)
def test_what_is_no_study_is_said_so(client: Client, studied: Path, body: Json, said: str) -> None:
    status, answer = client.post("api/trial" if "trial" in body else "api/study", body)
    assert status == 400
    assert said in answer["error"]


def test_damaged_studies_are_states(tmp_path: Path, studied: Path) -> None:
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "study.json").write_text((studied / "study.json").read_text())
    (folder / "results.parquet").write_bytes(b"PAR1 not really PAR1")
    with refused("study-results-unreadable"):
        study_table(folder)
    assert [item["folder"] for item in studies(tmp_path)] == ["broken"]
    (folder / "study.json").write_text("{")
    assert studies(tmp_path) == []
