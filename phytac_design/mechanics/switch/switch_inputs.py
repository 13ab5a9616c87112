"""The space and the rubber of a design's switches."""

from pathlib import Path

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.design.switch_table import BEST
from phytac_design.layout import make_markers
from phytac_design.mechanics.switch.material_fit import TERMS, fit_uniaxial, read_test
from phytac_design.mechanics.switch.rubbers import RUBBERS, Rubber, rubber
from phytac_design.mechanics.switch.switch_families import FAMILIES, Family
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_shapes.errors import DesignError, InputError


def space_of(design: Design, *, wall_min_mm: float | None = None) -> SwitchSpace:
    """Space of a design's switches: footprint, hole, tip, stroke, and its closest neighbours.

    All bowls have the stem of the longest switch, which leaves its tip by the mold's draft.

    Raises
    ------
    DesignError
        If no bowl fits.
    """
    from scipy.spatial import cKDTree

    surface = design.surface()
    markers = make_markers(design, surface)
    places = surface.point(markers.uv)
    if len(places) > 1:
        near, _ = cKDTree(places).query(places, k=2)
        pitch = float(np.min(near[:, 1]))
    else:
        pitch = 1e9
    switch = design.switch
    reach = float(np.linalg.norm(markers.tip_mm - places, axis=1).max()) - switch.tip_recess_mm
    taper = 2.0 * float(np.tan(np.radians(design.mold.draft_deg)))
    # No bowl is taller than half a sphere.
    tallest = 0.5 * min(switch.footprint_diameter_mm, pitch - design.print_rules.gap_min_mm)
    stem = switch.tip_diameter_mm + taper * (reach + max(tallest, 0.0))
    return SwitchSpace(
        footprint_diameter_mm=switch.footprint_diameter_mm,
        hole_diameter_mm=design.receptor.diameter_hole_mm,
        stem_diameter_mm=stem,
        pitch_mm=pitch,
        gap_mm=design.print_rules.gap_min_mm,
        recess_mm=switch.tip_recess_mm,
        visible_mm=switch.stroke_mm - switch.tip_recess_mm,
        wall_min_mm=switch.wall_min_mm if wall_min_mm is None else wall_min_mm,
        core_min_mm=design.print_rules.wall_min_mm,
        draft_deg=design.mold.draft_deg,
    )


def families_of(design: Design) -> tuple[Family, ...]:
    """Families that a design's switches may be of."""
    family = design.switch.family
    return FAMILIES if family == "best" else (family,)


def rubbers_of(design: Design) -> list[Rubber]:
    """Rubbers that a design's switches may be cast of.

    Raises
    ------
    DesignError
        If there is no data for the design's, or a modulus is given of none in particular.
    """
    if design.switch.material != BEST:
        return [rubber_of(design)]
    modulus = design.switch.modulus_MPa
    if modulus:
        raise DesignError(
            "modulus-of-best",
            f"the best of all rubbers has a modulus of its own (got switch.modulus_MPa = "
            f"{modulus:g}); set it to 0, or name the rubber in switch.material",
        )
    return list(RUBBERS.values())


def known_rubbers(design: Design) -> list[Rubber]:
    """Rubbers that a design's switches may be cast of, then all others with data."""
    own = rubbers_of(design)
    named = {item.name for item in own}
    return [*own, *(item for item in RUBBERS.values() if item.name not in named)]


def rubber_of(design: Design) -> Rubber:
    """Rubber that a design names for its switches.

    Raises
    ------
    DesignError
        If there is no data for it.
    """
    modulus = design.switch.modulus_MPa
    return chosen_rubber(design.switch.material, modulus_MPa=modulus or None)


def chosen_rubber(
    name: str, *, modulus_MPa: float | None = None, test: Path | None = None, law: str = "yeoh"
) -> Rubber:
    """Rubber of a preset, at another modulus, or fitted to a tensile test.

    Raises
    ------
    DesignError, InputError
        If there is no data for it.
    """
    if test is None:
        preset = rubber(name)
        return preset if modulus_MPa is None else preset.of_modulus(modulus_MPa)
    if modulus_MPa is not None:
        raise DesignError(
            "modulus-given-twice",
            f"a tensile test sets the modulus itself (got {test} and {modulus_MPa:g} MPa); leave "
            "out one",
        )
    if law not in TERMS:
        raise InputError(
            "rubber-law-unknown", f"no law {law!r} of rubbers; known: {', '.join(TERMS)}"
        )
    stretch, stress = read_test(test)
    share = 0.6  # of the test's largest strain may be reached again and again
    fit = fit_uniaxial(
        stretch,
        stress,
        law="neo-hookean" if law == "neo-hookean" else "ogden" if law == "ogden" else "yeoh",
    )
    return Rubber(
        name=test.stem,
        material=fit.material,
        strain_max=share * (float(stretch.max()) - 1.0),
        assumption=(
            f"{law} fitted to {test.name}, {fit.error:.1%} off; Poisson's ratio 0.49 and "
            f"{share:.0%} of the test's strain are assumed"
        ),
    )
