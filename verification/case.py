"""A case at an extreme: what is checked, what must come of it, and the evaluation."""

import re
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import pytest

from phytac_shapes.errors import PhytacError

Expect = Literal["right", "refused", "either"]
"""Required outcome: an answer, an error message, or one of the two."""
Verdict = Literal["right", "refused", "wrong"]
Kind = Literal["reference", "units", "balance", "symmetry", "float32", "range"]
"""Reference: an independent answer (closed form, another program's, published). The others are
invariants of any answer: other units, sums of forces, symmetry, single precision, its range."""
SLOW = ("fine facets", "1600", "5 m", "ø2 m", "20 m away", "patch", "thin", "as it is", "pole")
"""Words in the names of cases that take seconds."""
MESSAGE_MAX = 700
"""Characters of an error message that a person still reads."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """An error against a reference, and its tolerance.

    Attributes
    ----------
    kind : str
        See ``Kind``.
    reference : str
        What the answer is compared with.
    error, tolerance : float
        In the unit that the reference names; relative if it names none.
    """

    kind: Kind
    reference: str
    error: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the error is a number within its tolerance."""
        return bool(np.isfinite(self.error) and self.error <= self.tolerance)


@dataclass
class Evidence:
    """Findings of a check, and figures recorded beside them, e.g. condition numbers."""

    findings: list[Finding] = field(default_factory=list)
    facts: dict[str, float] = field(default_factory=dict)

    def add(
        self, reference: str, error: Any, tolerance: float, *, kind: Kind = "reference"
    ) -> None:
        """Add the largest absolute value of some errors."""
        size = np.abs(np.asarray(error, dtype=np.float64))
        # max() must not hide a NaN among the numbers.
        worst = float(size.max(initial=0.0)) if np.isfinite(size).all() else float("nan")
        self.findings.append(
            Finding(kind=kind, reference=reference, error=worst, tolerance=float(tolerance))
        )

    def close(
        self, reference: str, value: Any, exact: Any, tolerance: float, *, kind: Kind = "reference"
    ) -> None:
        """Add the largest difference of two arrays over the largest entry of the exact one."""
        a, b = np.asarray(value, dtype=np.float64), np.asarray(exact, dtype=np.float64)
        if a.shape != b.shape:
            reference += f": shape {a.shape}, not {b.shape}"
            self.add(reference, float("nan"), tolerance, kind=kind)
            return
        size = float(np.abs(b).max(initial=0.0))
        self.add(reference, (a - b) / (size or 1.0), tolerance, kind=kind)

    def true(self, reference: str, statement: Any, *, kind: Kind = "range") -> None:
        """Add the number of statements that do not hold; none may."""
        false = int(np.size(statement) - np.count_nonzero(statement))
        self.add(reference, float(false), 0.0, kind=kind)


Check = Callable[[Mapping[str, Any], Evidence], None]
"""Runs one case: adds findings, or raises a ``PhytacError`` where the input is rejected."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case.

    Attributes
    ----------
    name : str
        What is extreme, in words; unique in its module.
    check : callable
        The check that evaluates it.
    shape : str
        Surface family; "" where there is none.
    expect : {"right", "refused", "either"}
        Required outcome.
    values : dict
        Arguments of the check: numbers, texts, changes to a base design.
    """

    name: str
    check: Check
    shape: str = ""
    expect: Expect = "right"
    values: dict[str, Any] = field(default_factory=dict)


class Cases(list[Case]):
    """The cases of a module."""

    def add(self, name: str, check: Check, expect: Expect = "right", /, **values: Any) -> None:
        """Add a case without a surface family."""
        self.append(Case(name=name, check=check, expect=expect, values=values))

    def add_design(
        self,
        shape: str,
        name: str,
        check: Check,
        changes: Mapping[str, Any],
        expect: Expect = "right",
        /,
        **values: Any,
    ) -> None:
        """Add a case on the base design of a family with some changes."""
        values |= {"shape": shape, "changes": dict(changes)}
        name = f"{shape}: {name}"
        self.append(Case(name=name, check=check, shape=shape, expect=expect, values=values))

    @property
    def parametrize(self) -> pytest.MarkDecorator:
        """Parametrise a test over the cases."""
        return pytest.mark.parametrize("case", self, ids=[case.name for case in self])

    def fast(self) -> list[Case]:
        """Three of the quick cases: the first, one in the middle, the last."""
        quick = [case for case in self if not any(word in case.name for word in SLOW)]
        return [quick[k * (len(quick) - 1) // 2] for k in range(3)]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a case.

    Attributes
    ----------
    name : str
        Of the case.
    verdict : {"right", "refused", "wrong"}
        Right: all findings hold. Refused: with a ``PhytacError`` that a user understands, where the
        case permits it.
    findings : tuple of Finding
        Findings before the check ended.
    message : str
        Text of the error that was raised.
    why : str
        What is wrong; "" otherwise.
    facts : dict
        Figures beside the findings, e.g. condition numbers.
    seconds : float
        Processor time.
    """

    name: str
    verdict: Verdict
    findings: tuple[Finding, ...] = ()
    message: str = ""
    why: str = ""
    facts: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0


Recorder = Callable[[str, object], None]
"""The fixture ``record_property``."""


def verify(case: Case, record_property: Recorder) -> None:
    """Evaluate a case; fail the test if it is wrong. The outcome is recorded as a property."""
    outcome = evaluate(case)
    record_property("outcome", asdict(outcome))
    if outcome.why:
        pytest.fail(f"{case.name}: {outcome.why}", pytrace=False)


def evaluate(case: Case) -> Outcome:
    """Outcome of one case, whatever its check does (short of ending the process)."""
    evidence, message, why, refused = Evidence(), "", "", False
    start = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            case.check(case.values, evidence)
        except PhytacError as error:
            refused, message = True, str(error)
        except Exception as error:  # noqa: BLE001 - a crash of any kind is a verdict here
            why = f"crashed: {type(error).__name__}: {error}"[:MESSAGE_MAX]
    seconds = time.process_time() - start
    if not why and caught:
        first = caught[0]
        why = f"warned: {first.category.__name__}: {first.message}"[:MESSAGE_MAX]
    if not why:
        why = _fault(case, evidence, message, refused=refused)
    return Outcome(
        name=case.name,
        verdict="wrong" if why else "refused" if refused else "right",
        findings=tuple(evidence.findings),
        message=message,
        why=why,
        facts=dict(evidence.facts),
        seconds=seconds,
    )


def _fault(case: Case, evidence: Evidence, message: str, *, refused: bool) -> str:
    """What is wrong with a case that ended in an answer or an error; "" if nothing is."""
    for finding in evidence.findings:
        if not finding.holds:
            return (
                f"off by {finding.error:.3g} (at most {finding.tolerance:.3g}) against "
                f"{finding.reference}"
            )
    if refused and case.expect == "right":
        return f"refused, though it is possible: {message}"
    if refused:
        poor = unreadable(message)
        return f"refused, but {poor}: {message}" if poor else ""
    if case.expect == "refused":
        return "not refused"
    if not evidence.findings:
        return "nothing was compared with anything"
    return ""


INTERNALS = re.compile(
    r"Traceback|\b\w+Exception\b|\b(?:Type|Value|Key|Index|Attribute|Runtime|ZeroDivision|"
    r"Overflow|LinAlg|Memory|Validation|Assertion)Error\b|NoneType|<class|object at 0x|np\.float|"
    r"array\(|errors\.pydantic"
)
"""Words of the program that mean nothing to its user."""
NAN = re.compile(r"(?<!got )(?<!has )(?<!value )\bnan\b")
"""A NaN among the figures, unless it is the user's own input."""
NAMED = re.compile(r"\d|'[^']+'|\"[^\"]+\"|\b[a-z]+\.[a-z_]+|\b[a-z]+_[a-z_A-Z]+\b|: [a-z]+ must ")
"""A number, something quoted, or the name of a field: the subject of the message."""
FIX = re.compile(
    r"\b(lower|raise|set|use|give|take|move|correct|check|make|choose|remove|delete|write|order|"
    r"rebuild|update|leave out|keep|reverse|space|shorten|let|add|ask for|install|build|see|save|"
    r"convert|export|start|turn|split|record|hold|fix|try|put|read|name|run|must|should|may|"
    r"needs?|known|expected|did you mean|is missing|wants|takes|cannot be negative|pass|provide|"
    r"reduce|increase|replace|request|specify|select|change)\b",
    re.IGNORECASE,
)
"""The fix: something to do, or what would have been accepted."""


def unreadable(message: str) -> str:
    """What keeps a user from understanding an error message; "" if nothing does.

    It must be of reasonable length, without the program's internals, and name a number or a field,
    and the fix or what would have been accepted.
    """
    text = message.strip()
    if not text:
        return "it is empty"
    found = INTERNALS.search(text)
    faults = (
        (bool(found), f"it names the program's own {(found.group(0) if found else '')!r}"),
        (len(text) > MESSAGE_MAX, f"it is {len(text)} characters long"),
        (bool(NAN.search(text)), "it shows a figure that is not a number"),
        (not NAMED.search(text), "it names neither a number nor a field"),
        (not FIX.search(text), "it does not name the fix"),
    )
    return next((why for fault, why in faults if fault), "")
