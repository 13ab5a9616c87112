"""A case at an extreme, what is found about it, and the verdict."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

Expect = Literal["right", "refused", "either"]
"""What must come of a case: an answer, a refusal, or one of the two."""
Verdict = Literal["right", "refused", "wrong"]
Kind = Literal["reference", "units", "balance", "symmetry", "float32", "range"]
"""Reference: an answer from elsewhere (closed form, another program's, published). The others are
what any answer must keep: other units, sums of forces, symmetry, single precision, its range."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case, plain data.

    Attributes
    ----------
    room : str
        Part of the project that it tries.
    name : str
        What is extreme, in words; unique in its room.
    check : str
        Name of the room's check that it goes through.
    shape : str
        Surface family; "" where there is none.
    expect : {"right", "refused", "either"}
        What must come of it.
    values : dict
        What the check needs: numbers, texts, changes to a base design.
    limit_s : float
        Seconds after which it has no answer.
    """

    room: str
    name: str
    check: str
    shape: str = ""
    expect: Expect = "right"
    values: dict[str, Any] = field(default_factory=dict)
    limit_s: float = 120.0

    @property
    def key(self) -> str:
        """Room and name: what a journal knows it by."""
        return f"{self.room}: {self.name}"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """An error against something, and how large it may be.

    Attributes
    ----------
    kind : str
        See ``Kind``.
    reference : str
        What it is held against.
    error, tolerance : float
        In the unit that the reference says; relative where it says none.
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
    """What a check finds, and figures to be recorded beside it."""

    findings: list[Finding] = field(default_factory=list)
    facts: dict[str, float] = field(default_factory=dict)

    def add(
        self, reference: str, error: Any, tolerance: float, *, kind: Kind = "reference"
    ) -> None:
        """Add the largest of some errors."""
        size = np.abs(np.asarray(error, dtype=np.float64))
        # The maximum of numbers among which one is none must not hide that one.
        worst = float(size.max(initial=0.0)) if np.isfinite(size).all() else float("nan")
        self.findings.append(
            Finding(kind=kind, reference=reference, error=worst, tolerance=float(tolerance))
        )

    def close(
        self,
        reference: str,
        value: Any,
        exact: Any,
        tolerance: float,
        *,
        kind: Kind = "reference",
    ) -> None:
        """Add the largest difference of two arrays over the largest entry of the exact one."""
        a, b = np.asarray(value, dtype=np.float64), np.asarray(exact, dtype=np.float64)
        if a.shape != b.shape:
            self.findings.append(
                Finding(
                    kind=kind,
                    reference=f"{reference}: shape {a.shape}, not {b.shape}",
                    error=float("nan"),
                    tolerance=tolerance,
                )
            )
            return
        size = float(np.abs(b).max(initial=0.0))
        self.add(reference, (a - b) / (size or 1.0), tolerance, kind=kind)

    def true(self, reference: str, statement: Any, *, kind: Kind = "range") -> None:
        """Add how many of some statements do not hold; none may."""
        false = int(np.size(statement) - np.count_nonzero(statement))
        self.add(reference, float(false), 0.0, kind=kind)


Check = Callable[[Mapping[str, Any], Evidence], None]
"""Tries one case: adds findings, or raises the project's own error where it is refused."""


@dataclass(frozen=True, kw_only=True)
class Room:
    """A part of the project with its checks and its cases.

    Attributes
    ----------
    name, about : str
        What it is called, and what is tried in it.
    checks : dict
        By name.
    cases : callable
        All systematic cases, in order.
    """

    name: str
    about: str
    checks: Mapping[str, Check]
    cases: Callable[[], list[Case]]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a case.

    Attributes
    ----------
    room, name, shape : str
        Of the case.
    verdict : {"right", "refused", "wrong"}
        Right: all findings hold. Refused: with the project's own error, readable, where it may be.
    findings : tuple of Finding
        What was found before it ended.
    message : str
        Words of the refusal.
    why : str
        What is wrong; "" otherwise.
    facts : dict
        Figures beside the findings, e.g. condition numbers.
    seconds : float
        Processor time.
    """

    room: str
    name: str
    shape: str
    verdict: Verdict
    findings: tuple[Finding, ...] = ()
    message: str = ""
    why: str = ""
    facts: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def worst(self) -> Finding | None:
        """The finding nearest to its tolerance, or farthest beyond it."""
        if not self.findings:
            return None
        return max(self.findings, key=_strain)

    def plain(self) -> dict[str, Any]:
        """As data that JSON holds."""
        return asdict(self)

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> "Outcome":
        """From that data."""
        findings = tuple(Finding(**item) for item in data["findings"])
        return cls(**{**data, "findings": findings})


def _strain(finding: Finding) -> float:
    """Error over tolerance."""
    if not np.isfinite(finding.error):
        return float("inf")
    if finding.tolerance == 0.0:
        return 0.0 if finding.error == 0.0 else float("inf")
    return finding.error / finding.tolerance
