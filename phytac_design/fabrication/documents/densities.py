"""Assumed densities of a sensor's materials, from makers' usual figures; weigh your own."""

from phytac_shapes.errors import DesignError

DENSITY_g_cm3 = {
    "resin": 1.15,
    "tpu": 1.10,
    "silicone": 1.10,
    "steel": 7.85,
    "brass": 8.4,
    "pla": 1.24,
}
"""Assumed densities. Printed paint bodies are resin too."""


def density_g_cm3(material: str) -> float | None:
    """Density of a material; None for bought parts that are no single material.

    Raises
    ------
    DesignError
        If the material is not known.
    """
    unknown = ("electronics", "consumable")  # materials of bought parts whose mass is left open
    if material in unknown:
        return None
    key = "resin" if material.startswith("paint-") else material
    if key not in DENSITY_g_cm3:
        known = ", ".join([*DENSITY_g_cm3, "paint-COLOUR", *unknown])
        raise DesignError(
            "density-unknown", f"no density for the material {material!r}; known: {known}"
        )
    return DENSITY_g_cm3[key]


def mass_g(material: str, volume_mm3: float) -> float | None:
    """Mass of a volume; None where the material has no density."""
    density = density_g_cm3(material)
    return None if density is None else density * volume_mm3 / 1000.0
