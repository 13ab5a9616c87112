"""Malformed files of every kind: only ``PhytacError`` is raised, soon and in little memory."""

import json
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phytac_decoder.estimation.force_regions import load_regions
from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_decoder.serving.wire_protocol import MessageSplitter
from phytac_design.design.design_file import load_design
from phytac_design.design.scene import load_scene
from phytac_design.simulation.scenario.scenario_file import load_scenario
from phytac_design.study.search.study_file import load_study
from phytac_shapes.errors import InputError
from tests.fuzz.corruption import json_text, toml_text
from tests.fuzz.judge import InputFolder, fault_of, little_memory, read_inputs
from tests.fuzz.readers import READERS, shipped
from verification.test_readers import bundle

TABLES = {
    "designs": load_design,
    "studies": load_study,
    "scenes": load_scene,
    "scenarios": load_scenario,
}
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=20)
    | st.sampled_from([10**400, "../x", "/dev/zero", "a\0b", "x" * 400]),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=6,
)
ONCE = {"dataset": (166, 230), "calibration": (2427,), "regions": (1404,), "logs": (60,)}
"""Inputs of the long run that were faults once; a new one is repeated by adding its number."""
QUIET = settings(
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.mark.parametrize("name", READERS)
def test_malformed_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    """The first inputs of the long run (``python -m benchmarks.page --parts fuzz``)."""
    place = InputFolder(tmp_path)
    counts = read_inputs(name, range(70), place)
    assert read_inputs(name, ONCE.get(name, ()), place).faults == []
    assert counts.faults == []
    assert min(counts.read, counts.refused) >= 5


@pytest.mark.parametrize("kind", TABLES)
def test_any_value_at_any_key(kind: str, tmp_path: Path) -> None:
    import tomllib

    tables = [tomllib.loads(seed.decode()) for seed in shipped(kind) if len(seed) < 20_000]
    path = tmp_path / "x.toml"

    @settings(QUIET, max_examples=15)
    @given(data=st.data())
    def check(data: st.DataObject) -> None:
        table = json.loads(json.dumps(data.draw(st.sampled_from(tables))))
        at: Any = table
        while isinstance(at, dict | list) and at:
            key = data.draw(st.sampled_from(list(at) if isinstance(at, dict) else range(len(at))))
            if not isinstance(at[key], dict | list) or not at[key] or data.draw(st.booleans()):
                at[key] = data.draw(VALUES)
                break
            at = at[key]
        path.write_bytes(toml_text(table))
        with little_memory():
            fault, _, _ = fault_of(lambda: TABLES[kind](str(path)))
        assert fault is None

    check()


def test_any_value_in_a_bundle(tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    whole = json.loads((tmp_path / "bundle.json").read_text())

    @settings(QUIET, max_examples=100)
    @given(key=st.sampled_from(sorted(whole)), value=VALUES)
    def check(key: str, value: Any) -> None:
        (tmp_path / "bundle.json").write_bytes(json_text(whole | {key: value}))
        with little_memory():
            fault, _, _ = fault_of(lambda: load_bundle(tmp_path))
        assert fault is None

    check()


@settings(QUIET, max_examples=100)
@given(data=st.binary(max_size=200), framing=st.sampled_from(["lines", "length"]))
def test_any_bytes_on_the_wire(data: bytes, framing: str) -> None:
    fault, _, _ = fault_of(lambda: MessageSplitter(framing).feed(data))
    assert fault is None


@settings(QUIET, max_examples=60)
@given(tables=VALUES)
def test_any_table_of_regions(tables: Any, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(json_text({"regions": tables}))
    fault, _, _ = fault_of(lambda: load_regions(path, bundle().position_mm))
    assert fault is None


def test_what_a_reader_must_not_do_is_found(tmp_path: Path) -> None:
    """The judge itself: a traceback, a blow-up, a hang, and a message without end are faults."""
    hoard: list[bytes] = []

    def blow_up() -> None:
        # Ten times the limit, since memory that this process frees meanwhile does not count.
        hoard.extend(bytes(100 << 20) for _ in range(50))

    def spin() -> None:
        while True:
            pass

    def talk() -> None:
        raise InputError("long-text", "x" * 30_000)

    with little_memory():
        assert str(fault_of(blow_up)[0]).startswith("MemoryError")
    hoard.clear()
    assert "KeyError" in str(fault_of(lambda: {"a": 1}["x"])[0])
    assert fault_of(talk)[0] == "a message of 30000 letters"
    assert fault_of(lambda: None)[:2] == (None, True)
    assert str(fault_of(spin, seconds=0.05)[0]).startswith("no end")


def test_what_was_slow_once_is_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.fuzz.judge.SECONDS_MAX", 0.1)
    turns: list[int] = []

    def slow() -> None:
        turns.append(1)
        until = time.process_time() + 0.15
        while time.process_time() < until:
            pass

    def slow_once() -> None:
        if not turns:
            slow()

    fault, read, _ = fault_of(slow_once)
    assert (fault, read, len(turns)) == (None, True, 1)
    assert "of processor time" in str(fault_of(slow)[0])
    assert len(turns) == 4
