"""Rubbers of switches, each with what is assumed about it."""

from dataclasses import dataclass, replace

from phytac_design.mechanics.switch.hyperelastic import Material, neo_hookean
from phytac_shapes.errors import DesignError


@dataclass(frozen=True, kw_only=True)
class Rubber:
    """A rubber and how far it may be strained.

    Attributes
    ----------
    name : str
        Of the preset, or what the data was called.
    material : Material
        Its law.
    strain_max : float
        Largest principal stretch less 1 that it bears again and again.
    assumption : str
        What is known, and what is not.
    """

    name: str
    material: Material
    strain_max: float
    assumption: str

    def of_modulus(self, modulus_MPa: float) -> "Rubber":
        """Return the rubber with another modulus, all stresses in proportion.

        Raises
        ------
        DesignError
            If the modulus is out of range.
        """
        neo_hookean(modulus_MPa=modulus_MPa, poisson=0.0)
        factor = modulus_MPa / self.material.modulus_MPa
        return replace(
            self,
            material=self.material.scaled(factor),
            assumption=f"modulus {modulus_MPa:g} MPa as given; {self.assumption}",
        )


RUBBERS = {
    "tpu-8400n": Rubber(
        name="tpu-8400n",
        material=neo_hookean(modulus_MPa=10.0, poisson=0.49),
        strain_max=1.0,
        assumption=(
            "Hei-Cast 8400N: no data sheet was found; neo-Hookean, 10 MPa, Poisson's ratio 0.49 "
            "and 100 % strain are assumed; its mix sets the modulus: measure yours"
        ),
    ),
    "silicone-a30": Rubber(
        name="silicone-a30",
        material=neo_hookean(modulus_MPa=1.1, poisson=0.49),
        strain_max=1.5,
        assumption=(
            "silicone of Shore A 30: 1.1 MPa from hardness (Gent 1958), neo-Hookean, Poisson's "
            "ratio 0.49 and 150 % strain are assumed"
        ),
    ),
}


def rubber(name: str) -> Rubber:
    """Return a preset.

    Raises
    ------
    DesignError
        If there is none of that name: a material without data.
    """
    if name not in RUBBERS:
        raise DesignError(
            "rubber-unknown",
            f"no data for the rubber {name!r}; known: {', '.join(sorted(RUBBERS))}, or fit a law "
            "to a tensile test (CSV of stretch, stress_MPa)",
        )
    return RUBBERS[name]
