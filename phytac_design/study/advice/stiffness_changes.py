"""Changes of a shell that is too stiff for its forces: a thinner wall, softer known materials."""

from collections.abc import Iterator
from dataclasses import replace

from phytac_design.design.shell_materials import SHELL_MATERIALS, ShellMaterial, material_of
from phytac_design.design.spec import Design
from phytac_design.study.advice.design_changes import STIFFNESS, Change, limits_of
from phytac_design.study.advice.design_variables import together
from phytac_design.study.advice.first_design import (
    ERROR_MAX,
    PredictedShell,
    WALLS_mm,
    with_thinnest_wall,
)
from phytac_design.study.advice.force_precision import force_sd_N
from phytac_shapes.errors import DesignError

THIN_mm = (0.5, 0.6)
"""Walls that are tried below those of a first design, where the printer makes them."""
TRIED_MAX = 4
"""Changes that are evaluated at most."""


def stiffness_fault(design: Design) -> str:
    """Say that the largest force is read worse than ``phytac new`` allows; "" if it is not."""
    most_N, sd_N = design.training.force_max_N, force_sd_N(design)
    if sd_N <= ERROR_MAX * most_N:
        return ""
    return (
        f"its shell is too stiff for its forces: {most_N:g} N is read to about ± {sd_N:.2g} N at "
        f"best, {sd_N / most_N:.1%} of it (predicted; `phytac new` takes a shell with at most "
        f"{ERROR_MAX:.0%})"
    )


def stiffness_changes(design: Design) -> list[Change]:
    """Shells that bear the largest force and show it better, as predicted; to be evaluated.

    Those that are soft enough come first, the stiffest of them at their head, then the softer ones
    of the others. Materials of which no wall bears the force have a reason.
    """
    before = force_sd_N(design) / design.training.force_max_N
    useful, rejected = [], []
    for shell in [*_thinner(design), *_softer(design)]:
        gain = 1.0 - shell.error / before
        change = Change(
            together(_fields(shell.design), _words(design, shell.design)),
            1.0,
            STIFFNESS,
            {"force_max_sd_share": shell.error},
            gain,
        )
        if gain > 0.0 and shell.bears:
            useful.append(change)
        elif not shell.bears:
            reason = f"no wall that was tried bears {design.training.force_max_N:g} N"
            rejected.append(replace(change, reason=reason))
    useful.sort(key=lambda one: max(one.predicted["force_max_sd_share"], ERROR_MAX))
    return [*useful[:TRIED_MAX], *rejected]


def _walls_mm(design: Design) -> list[float]:
    """Walls that the printer makes, the thinnest first."""
    own = {*THIN_mm, *WALLS_mm, design.wall.thickness_mm}
    return sorted(one for one in own if one >= design.print_rules.wall_min_mm)


def _thinner(design: Design) -> Iterator[PredictedShell]:
    """The thickest thinner wall of the same material that is soft enough, or the thinnest."""
    material = ShellMaterial(
        label="",
        modulus_MPa=design.material.modulus_MPa,
        poisson=design.material.poisson,
        strain_max=limits_of(design)["strain"],
    )
    best = None
    for thickness_mm in reversed(_walls_mm(design)):
        if thickness_mm >= design.wall.thickness_mm:
            continue
        try:
            shell = with_thinnest_wall(design, material, [thickness_mm])
        except DesignError:
            break
        if not shell.bears:
            break
        best = shell
        if shell.error <= ERROR_MAX:
            break
    if best:
        yield best


def _softer(design: Design) -> Iterator[PredictedShell]:
    """Each softer material, with the thinnest wall that bears the largest force."""
    for material in SHELL_MATERIALS:
        if material.modulus_MPa < design.material.modulus_MPa:
            try:
                yield with_thinnest_wall(design, material, _walls_mm(design))
            except DesignError:
                continue


def _fields(design: Design) -> dict[str, float]:
    return {
        "material.modulus_MPa": design.material.modulus_MPa,
        "material.poisson": design.material.poisson,
        "wall.thickness_mm": design.wall.thickness_mm,
    }


def _words(before: Design, after: Design) -> str:
    """What changes, for a reader."""
    old, new = _fields(before), _fields(after)
    words = ", ".join(
        f"{name} {old[name]:g} → {value:g}" for name, value in new.items() if value != old[name]
    )
    material = material_of(after.material.modulus_MPa)
    changed = after.material.modulus_MPa != before.material.modulus_MPa
    return f"{words} ({material.label})" if changed and material else words
