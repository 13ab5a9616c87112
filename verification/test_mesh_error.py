"""What the estimate of the mesh's error claims, against resolved meshes."""

from collections.abc import Mapping
from typing import Any

from verification.case import Case, Cases, Evidence, Recorder, verify
from verification.mesh_error import FACTOR_MAX, error_cases, judge
from verification.press_error import DESIGNS, PressedDesign


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


def check_presses(values: Mapping[str, Any], found: Evidence) -> None:
    """Extrapolated motion is within three times the claimed error, and nearly always within it."""
    design = PressedDesign(values["design"])
    for what, errors in (("presses", design.linear()), ("tables", design.tables())):
        factor = errors.extrapolated / errors.claimed
        found.add(f"{what}: true over claimed error, largest", float(factor.max()), FACTOR_MAX)
        found.add(f"{what}: presses beyond the claimed error", float((factor > 1.0).sum()), 1.0)


def cases() -> Cases:
    """Hyperbolic paraboloids, published shells, plates, sensors."""
    out = Cases()
    for case in error_cases():
        out.add(case.name, check_claims, case=case)
    for name in DESIGNS:
        out.add(f"presses on {name}", check_presses, design=name)
    return out


CASES = cases()


@CASES.parametrize
def test_mesh_error(case: Case, record_property: Recorder) -> None:
    """Claims of :func:`estimate_error`."""
    verify(case, record_property)
