"""Hostile STEP files: OpenCASCADE may crash or hang, the program may not."""

import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from phytac_design.solids import step_surface
from phytac_design.workflows.design_from_step import patch_changes
from phytac_shapes.errors import MissingPartError
from tests.refusals import refused

HEAD = b"ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n"


def test_damaged_files_are_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "x.step"
    path.write_bytes(HEAD + b"#1=CARTESIAN_POINT('',(1E999,NAN,#1));\n" * 1000 + b"\xff\0")
    with refused("step-without-face") as caught:
        patch_changes(path)
    caught.match(r"x\.step")


def stand_in(monkeypatch: pytest.MonkeyPatch, work: Callable[[], object]) -> None:
    """Something else in the place of OpenCASCADE."""
    monkeypatch.setattr(step_surface, "read_surface", lambda *_: work())


def test_a_crash_is_an_error_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, lambda: os.kill(os.getpid(), signal.SIGSEGV))
    with refused("step-unreadable"):
        step_surface.surface_from_step(tmp_path / "x.step")


def test_a_hang_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, lambda: time.sleep(60.0))
    with refused("step-unreadable"):
        step_surface.surface_from_step(tmp_path / "x.step", seconds_max=0.3)
    assert multiprocessing.active_children() == []


def test_memory_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, lambda: bytearray(1 << 33))
    with refused("step-unreadable") as caught:
        step_surface.surface_from_step(tmp_path / "x.step")
    caught.match(r"x\.step")


def test_other_errors_stay_what_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise MissingPartError("missing-library", "no CadQuery")

    stand_in(monkeypatch, missing)
    with refused("missing-library"):
        step_surface.surface_from_step(tmp_path / "x.step")
