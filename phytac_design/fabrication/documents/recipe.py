"""Casting recipe: grams of each component, from the volumes of switches and molds.

Ratios, times and temperatures are the paper's, for its rubber: A to C 1 : 5 by weight, (A + C) to
B 6 : 1. Another rubber is mixed as its maker says.
"""

from dataclasses import dataclass

from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.bill_of_materials import DENSITY_g_cm3
from phytac_design.fabrication.switch_strips import StripSet
from phytac_design.mechanics.switch.switch_inputs import rubber_of

PAPER_RUBBER = "tpu-8400n"
A_TO_C = 5.0
AC_TO_B = 6.0


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Amounts to weigh, g.

    Attributes
    ----------
    switch_mm3, silicone_mm3 : float
        Volume of all switches with what the molds' channels hold, and of the silicone molds.
    rubber_g, a_g, b_g, c_g : float
        Rubber in all with the waste, and its parts.
    silicone_g : float
        Silicone with the waste; 0 where molds are printed.
    castings : int
        Fillings of all sets of molds that the rubber is for.
    """

    switch_mm3: float
    silicone_mm3: float
    waste_rubber: float
    waste_silicone: float
    rubber_g: float
    a_g: float
    b_g: float
    c_g: float
    silicone_g: float
    castings: int = 1


def make_recipe(
    design: Design, switch_mm3: float, silicone_mm3: float, castings: int = 1
) -> Recipe:
    """Amounts for volumes of switches (with channels) and of silicone molds, mm³."""
    bench = design.bench
    rubber = switch_mm3 / 1000.0 * DENSITY_g_cm3["tpu"] * (1.0 + bench.waste_rubber)
    ac = rubber * AC_TO_B / (AC_TO_B + 1.0)
    return Recipe(
        switch_mm3=switch_mm3,
        silicone_mm3=silicone_mm3,
        waste_rubber=bench.waste_rubber,
        waste_silicone=bench.waste_silicone,
        rubber_g=rubber,
        a_g=ac / (1.0 + A_TO_C),
        c_g=ac * A_TO_C / (1.0 + A_TO_C),
        b_g=rubber / (AC_TO_B + 1.0),
        silicone_g=silicone_mm3 / 1000.0 * DENSITY_g_cm3["silicone"] * (1.0 + bench.waste_silicone),
        castings=castings,
    )


def recipe_steps(
    design: Design, recipe: Recipe, strips: StripSet | None = None, *, body: str = "bowl"
) -> list[str]:
    """Steps in order, with the amounts."""
    shrink = 100.0 * design.mold.shrink_rubber
    steps = []
    if design.mold.way == "silicone-master":
        steps += [
            (
                f"Mix {recipe.silicone_g:.1f} g of silicone by its maker's ratio, degas it, pour "
                "it over both printed trays (domes, stems) up to their rims, let it cure as its "
                "maker specifies. Coat the prints with release agent first: many resins keep "
                "silicone from curing."
            ),
            (
                "Lift both silicone halves off; look for torn pegs. Try how they close on their "
                "four keys. The hole above each stem is a vent and stays open."
            ),
        ]
        fill = (
            "Lay the dome half down, cavities up, and fill its cavities and the ways around them "
            "{volume}. Close the stem half on its keys, pressing from the middle outward, until "
            "rubber stands in every vent; lay a flat plate and about 1 kg on it."
        )
        trim = (
            " Cut what has set in the vents off each stem at the step where it grows thinner "
            "({step:g} mm in radius): the tip ends there."
        )
    else:
        steps.append("Clean the printed plates and spray release agent on them.")
        fill = (
            "Lay the dome plate down, cavities up, and fill its cavities and the ways around them "
            "{volume}. Press the core plate on its keys until rubber stands in every stem's hole, "
            "scrape that side, then screw or weight the cap on."
        )
        trim = " Open at the channel all around; pull off the thin sheet between the {body}s."
    last = [
        "Paint the end of each stem red; let it dry.",
        (
            f"Glue each switch by the rim of its {body} with cyanoacrylate, the stem through its "
            "receptor, where switch_placement.csv and the paint map show."
        ),
    ]
    sort = "Sort the switches by the label beside each cavity."
    if strips is not None:
        sort = "Mark each strip with the label beside its cavity; cut along its web's edges."
        last = [
            "Dip the ends of all stems of a strip into a film of red paint at once; let it dry.",
            (
                f"Glue each strip along its web and the rims of its {body}s with cyanoacrylate, "
                "where mold/strips.csv and the paint map show: begin at one end, thread stem after "
                "stem, press it down as you go."
            ),
        ]
    if recipe.castings > 1:
        steps.append(
            f"The molds are filled {recipe.castings} times in all: do the next steps for each, "
            "with that share of the amounts."
        )
    return [
        *steps,
        *_mixing(design, recipe),
        fill.format(volume=f"({recipe.switch_mm3 / 1000.0:.2f} cm³ in all)"),
        "Cure at 65 °C for 1 h." if of_paper(design) else "Let it cure as its maker specifies.",
        (
            f"Demould; the rubber has shrunk by {shrink:.2g} %, which the mold allows for. {sort}"
            + trim.format(step=design.mold.vent_step_mm, body=body)
        ),
        *last,
    ]


def of_paper(design: Design) -> bool:
    """Whether the switches are of the paper's rubber, of which the recipe is known."""
    return design.switch.material == PAPER_RUBBER


def parts_g(design: Design, recipe: Recipe) -> dict[str, float]:
    """Grams of the rubber's components by name; none for a rubber that is not the paper's."""
    if not of_paper(design):
        return {}
    return {"A": recipe.a_g, "B": recipe.b_g, "C": recipe.c_g}


def _mixing(design: Design, recipe: Recipe) -> list[str]:
    """Steps up to a cup of rubber."""
    if not of_paper(design):
        text = (
            f"Mix {recipe.rubber_g:.2f} g of {design.switch.material} by its maker's ratio; stir "
            "and degas it as its maker specifies."
        )
        return [text]
    return [
        (
            f"Work at 25 to 35 °C. Weigh {recipe.a_g:.2f} g of A and {recipe.c_g:.2f} g of C "
            f"(1 : {A_TO_C:g} by weight) into one cup; stir for 2 min."
        ),
        "Degas A + C under vacuum for 5 min.",
        (
            f"Pour {recipe.a_g + recipe.c_g:.2f} g of A + C into {recipe.b_g:.2f} g of B "
            f"({AC_TO_B:g} : 1 by weight); stir for 30 s; degas for 1 min. It sets soon: continue "
            "at once."
        ),
    ]


def recipe_text(
    design: Design, recipe: Recipe, strips: StripSet | None = None, *, body: str = "bowl"
) -> str:
    """Markdown page of the recipe for switches of a family, see ``SwitchSet.body``."""
    fine_g = 2.0  # below this a part must be weighed to 0.01 g: a tenth of a gram would be 5 %
    modulus_MPa = rubber_of(design).material.modulus_MPa
    parts = parts_g(design, recipe)
    fine = " Weigh A and B to 0.01 g." if min(parts.values(), default=fine_g) < fine_g else ""
    rows = [*parts.items(), ("rubber in all", recipe.rubber_g)]
    if recipe.silicone_g > 0.0:
        rows.append(("silicone", recipe.silicone_g))
    steps = recipe_steps(design, recipe, strips, body=body)
    lines = [
        f"# {design.name}: casting the switches",
        "",
        f"{recipe.switch_mm3 / 1000.0:.2f} cm³ of rubber in the molds, "
        f"{100.0 * recipe.waste_rubber:g} % more for cups and flash; densities are assumed "
        f"(rubber {DENSITY_g_cm3['tpu']:g} g/cm³, silicone {DENSITY_g_cm3['silicone']:g} g/cm³)."
        + fine,
        "",
        "| part | g |",
        "|---|---|",
        *(f"| {name} | {grams:.2f} |" for name, grams in rows),
        "",
        *(f"{number}. {step}" for number, step in enumerate(steps, start=1)),
        "",
        (
            "A multi-material print of shell/shell.3mf needs no paint on the receptors; the tips "
            "of the switches are painted all the same."
        ),
        "",
        "Rubber: Hei-Cast 8400N as in the paper."
        if parts
        else f"Rubber: {design.switch.material}; its ratios and times are its maker's.",
    ]
    lines.append(
        f"The {body}s are designed for a modulus of {modulus_MPa:.3g} MPa. This mix is not known "
        "to give it: thresholds go in proportion. Cast a strip, pull it, and set "
        "switch.modulus_MPa."
    )
    return "\n".join(lines) + "\n"
