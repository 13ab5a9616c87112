"""The journal of a run: complete results or none, one process at a time, one run."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from phytac_design.core.journal import Journal
from tests.refusals import refused

ARRAYS = {"shift_px": np.array([[0.5, np.nan], [1e-300, -0.0]]), "bits": np.array([True, False])}
FACTS = {"status": 1, "reason": "unstable: …"}


def test_a_result_is_read_as_it_was_stored(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    with journal.opened("a"):
        journal.put("1234", FACTS, ARRAYS)
        assert journal.get("1233") is None
        found = journal.get("1234")
    assert found is not None
    facts, arrays = found
    assert facts == FACTS
    assert set(arrays) == set(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(arrays[name], array)


def test_a_truncated_or_changed_result_counts_as_missing(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    with journal.opened("a"):
        journal.put("0", FACTS, ARRAYS)
        path = journal.path("0")
        whole = path.read_bytes()
        for at in range(0, len(whole), 37):
            path.write_bytes(whole[:at])
            assert journal.get("0") is None
            path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
            assert journal.get("0") is None
        path.write_bytes(whole)
        assert journal.get("0") is not None


def test_results_are_kept_for_the_same_run_and_rejected_for_another(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    with journal.opened("a"):
        journal.put("0", FACTS, ARRAYS)
    with journal.opened("a"):
        assert journal.get("0") is not None
    with refused("output-foreign"), journal.opened("b"):
        pass
    with journal.opened("a"):
        assert journal.get("0") is not None
    with journal.opened("b", force=True):
        assert journal.get("0") is None
    with refused("output-foreign"), journal.opened("a"):
        pass


def test_a_damaged_run_key_is_of_another_run(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    with journal.opened("a"):
        pass
    for text in ("", "[]", '{"kee": 1}', "{"):
        (tmp_path / "run.json").write_text(text)
        with refused("output-foreign"), journal.opened("a"):
            pass


def test_two_processes_do_not_write_at_once_but_a_killed_one_holds_nothing(tmp_path: Path) -> None:
    text = (
        "import sys, time\nfrom pathlib import Path\n"
        "from phytac_design.core.journal import Journal\n"
        "with Journal(Path(sys.argv[1])).opened('a'):\n    print('open', flush=True)\n"
        "    time.sleep(60)\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", text, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    try:
        assert other.stdout.readline() == "open\n"
        journal = Journal(tmp_path)
        with refused("output-locked"), journal.opened("a"):
            pass
    finally:
        other.kill()
        other.wait()
        other.stdout.close()
    with journal.opened("a"):
        journal.put("0", FACTS, ARRAYS)


def test_a_folder_that_cannot_be_written_is_rejected(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    with refused("output-not-writable") as caught, Journal(file / "work").opened("a"):
        pass
    caught.match("--out")


def test_nothing_is_left_behind(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "work")
    with journal.opened("a"):
        journal.put("0", FACTS, ARRAYS)
        journal.drop()
    assert list(tmp_path.iterdir()) == []
