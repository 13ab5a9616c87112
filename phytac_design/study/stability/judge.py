"""From a case to its verdict: run its check, read its refusal."""

import re
import time
import warnings
from collections.abc import Mapping

from phytac_design.study.stability.case import Case, Check, Evidence, Outcome
from phytac_shapes.errors import PhytacError

LONGEST = 700
"""Characters of a message that a person still reads."""
INNARDS = re.compile(
    r"Traceback|\b\w+Exception\b|\b(?:Type|Value|Key|Index|Attribute|Runtime|ZeroDivision|"
    r"Overflow|LinAlg|Memory|Validation|Assertion)Error\b|NoneType|<class|object at 0x|np\.float|"
    r"array\(|errors\.pydantic"
)
"""What belongs to the program, not to its user."""
NO_NUMBER = re.compile(r"(?<!got )(?<!has )(?<!value )\bnan\b")
"""A figure that is none, unless it is what was handed in."""
NAMED = re.compile(r"\d|'[^']+'|\"[^\"]+\"|\b[a-z]+\.[a-z_]+|\b[a-z]+_[a-z_A-Z]+\b|: [a-z]+ must ")
"""A number, something quoted, or the name of a field: what it is about."""
MENDS = re.compile(
    r"\b(lower|raise|set|use|give|take|move|correct|check|make|choose|remove|delete|write|order|"
    r"rebuild|update|leave out|keep|reverse|space|shorten|let|add|ask for|install|build|see|save|"
    r"convert|export|start|turn|split|record|hold|fix|try|put|read|name|run|must|should|may|"
    r"needs?|known|expected|did you mean|is missing|wants|takes|cannot be negative)\b",
    re.IGNORECASE,
)
"""What mends it: something to do, or what would have done."""


def unreadable(message: str) -> str:
    """What keeps a user from making sense of a refusal; "" if nothing does.

    It must be a sentence of reasonable length, without words from inside the program, that names a
    number or a field, and what to do or what would have done.
    """
    text = message.strip()
    if not text:
        return "it says nothing"
    found = INNARDS.search(text)
    faults = (
        (bool(found), f"it speaks of the program's own {(found.group(0) if found else '')!r}"),
        (len(text) > LONGEST, f"it is {len(text)} characters long"),
        (bool(NO_NUMBER.search(text)), "it shows a figure that is not a number"),
        (not NAMED.search(text), "it names neither a number nor a field"),
        (not MENDS.search(text), "it does not say what would mend it"),
    )
    return next((why for fault, why in faults if fault), "")


def judge(case: Case, checks: Mapping[str, Check]) -> Outcome:
    """Verdict of one case, whatever its check does (short of ending the process)."""
    evidence, message, why, refused = Evidence(), "", "", False
    start = time.process_time()
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            checks[case.check](case.values, evidence)
        except PhytacError as error:
            refused, message = True, str(error)
        except Exception as error:  # noqa: BLE001 - a crash of any kind is a verdict here
            why = f"crashed: {type(error).__name__}: {error}"[:LONGEST]
    seconds = time.process_time() - start
    if not why and heard:
        first = heard[0]
        why = f"warned: {first.category.__name__}: {first.message}"[:LONGEST]
    if not why:
        why = _fault(case, evidence, message, refused=refused)
    return Outcome(
        room=case.room,
        name=case.name,
        shape=case.shape,
        verdict="wrong" if why else "refused" if refused else "right",
        findings=tuple(evidence.findings),
        message=message,
        why=why,
        facts=dict(evidence.facts),
        seconds=seconds,
    )


def _fault(case: Case, evidence: Evidence, message: str, *, refused: bool) -> str:
    """What is wrong with a case that ended in an answer or a refusal; "" if nothing is."""
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
        return "nothing was held against anything"
    return ""
