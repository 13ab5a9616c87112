"""Mutants: what is drawn, how a score is stated, and that every survivor has a reason."""

import json
import sys
from pathlib import Path

import pytest

from benchmarks import mutants, mutation
from benchmarks.mutant_runs import Outcome
from benchmarks.mutants import PACKAGES, Mutant

TEXT = '''"""Text 1 + 2."""

from phytac_design.core.kernels import kernel

LIMIT: "tuple[int, 3]" = 4


@kernel
def inner(x: float, y: "4 * 3") -> "7 - 2":
    return x * 5.0


def outer(x, *, y=None, **z):
    """Return 1 + 1."""
    if x < 6:
        raise ValueError(f"{x + 7} of 8", 9)
    return f"{x * 10:.3f}"
'''


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Mutant]:
    """Mutants of a made-up package."""
    folder = tmp_path / "made_up"
    folder.mkdir()
    (folder / "one.py").write_text(TEXT)
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    monkeypatch.setitem(PACKAGES, "made-up", "made_up")
    return mutants.draw("made-up")


def test_texts_and_types_are_left_out_and_the_rest_is_drawn_once(drawn: list[Mutant]) -> None:
    changes = {mutant.change()[0] for mutant in drawn}
    assert changes == {'LIMIT: "tuple[int, 3]" = 4', "return x * 5.0", "if x < 6:"}
    # The number 4; x * 5.0 and its number; the comparison, the whole condition and its number.
    places = [(mutant.first_line, mutant.operator) for mutant in drawn]
    assert len(places) == len(set(places)) == 6
    assert {m.first_line: m.compiled for m in drawn} == {5: True, 10: True, 15: False}
    assert drawn == mutants.draw("made-up")
    for mutant in drawn:
        compile(mutant.text(), "one.py", "exec")
        assert mutant.text() != TEXT


def test_a_key_outlives_comments_and_no_change_of_code(drawn: list[Mutant], tmp_path: Path) -> None:
    file = tmp_path / "made_up" / "one.py"
    keys = [mutant.key for mutant in drawn]
    file.write_text(
        TEXT.replace("Return 1 + 1.", "Other words.").replace("    if", "    # 1\n    if")
    )
    assert [mutant.key for mutant in mutants.draw("made-up")] == keys
    file.write_text(TEXT.replace("5.0", "5.5"))
    assert not set(keys) & {mutant.key for mutant in mutants.draw("made-up")}


def test_the_interval_is_wilson_s() -> None:
    # Newcombe (1998), table I: 81 of 263 and 0 of 20.
    assert mutation.wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert mutation.wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_outcomes_of_mutants_that_are_not_drawn_are_dropped(
    drawn: list[Mutant], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutation, "OUTCOMES", tmp_path / "mutants.jsonl")
    entries = [{"key": mutant.key, "package": "made-up"} for mutant in reversed(drawn)]
    entries += [{"key": "old", "package": "made-up"}, {"key": "other", "package": "optics"}]
    mutation.OUTCOMES.write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    mutation.keep_drawn("made-up", drawn)
    assert list(mutation.read_outcomes()) == ["other", *(mutant.key for mutant in drawn)]


def test_survivors_are_tried_again_until_they_have_a_reason(
    drawn: list[Mutant], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    met: list[tuple[str, bool]] = []

    class Weak:
        """Tests that notice nothing at first, and everything when tried again."""

        def meet(self, mutant: Mutant, *, again: bool) -> Outcome:
            met.append((mutant.key, again))
            return Outcome(outcome="killed" if again else "survived", tests=1, of=2)

    monkeypatch.setattr(mutation, "Runner", Weak)
    monkeypatch.setattr(mutation, "OUTCOMES", tmp_path / "mutants.jsonl")
    was, now = drawn[0].change()
    explained = [{"file": drawn[0].file, "was": was, "now": now, "reason": "none"}]
    monkeypatch.setattr(mutation, "reasons", lambda: explained)

    def outcomes(*, again: bool, minutes: float = 1.0) -> list[tuple[str, str]]:
        known = mutation.try_mutants("made-up", drawn, minutes=minutes, again=again)
        return [(entry["outcome"], entry["first"]) for entry in known.values()]

    assert outcomes(again=False, minutes=0.0) == []
    assert outcomes(again=False) == [("survived", "survived")] * 6
    assert outcomes(again=False) == [("survived", "survived")] * 6
    assert len(met) == 6
    alike = sum(mutant.change() == (was, now) for mutant in drawn)
    assert outcomes(again=True).count(("killed", "survived")) == 6 - alike
    assert len(met) == 12 - alike


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="hashes of code are of Python 3.11")
def test_every_survivor_has_a_reason_and_every_reason_a_survivor() -> None:
    known = mutation.read_outcomes().values()
    survivors = {
        (entry["key"].partition(":")[0], entry["was"], entry["now"])
        for entry in known
        if entry["outcome"] == "survived"
    }
    # Each is stated once, however often its line occurs.
    given = {(each["file"], each["was"], each["now"]) for each in mutation.reasons()}
    assert given == survivors
    assert all(len(each["reason"]) > 20 for each in mutation.reasons())
