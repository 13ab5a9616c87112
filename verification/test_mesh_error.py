"""What the estimate of the mesh's error claims, against resolved meshes."""

from collections.abc import Mapping
from typing import Any

from verification.case import Case, Cases, Evidence, Recorder, verify
from verification.mesh_error import FACTOR_MAX, error_cases, judge


def check_claims(values: Mapping[str, Any], found: Evidence) -> None:
    """Asymptotic claims are within the factor of the true error."""
    for one in judge(values["case"]):
        if one.known and one.asymptotic:
            ratio = max(one.factor, 1.0 / one.factor)
            found.add(f"true over claimed error, {one.elements} a side", ratio, FACTOR_MAX)
        found.facts[f"true_{one.elements}"] = one.true
        found.facts[f"claimed_{one.elements}"] = one.claimed
        found.facts[f"rate_{one.elements}"] = one.rate
    found.true("every claim is positive", [value > 0.0 for value in found.facts.values()])


def cases() -> Cases:
    """Hyperbolic paraboloids, published shells, plates, sensors."""
    out = Cases()
    for case in error_cases():
        out.add(case.name, check_claims, case=case)
    return out


CASES = cases()


@CASES.parametrize
def test_mesh_error(case: Case, record_property: Recorder) -> None:
    """Claims of :func:`estimate_error`."""
    verify(case, record_property)
