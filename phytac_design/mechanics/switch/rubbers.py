"""Rubbers of switches, each with what is assumed about it.

Ten castable rubbers are fitted to tensile tests of the Soft Robotics Materials Database (L.
Marechal et al., Soft Robotics 2020, doi 10.1089/soro.2019.0115; Open Database License 1.0): Yeoh's
law by least squares without negative constants, which keeps it stable, on nominal stress up to
100 % strain.
"""

from dataclasses import dataclass, replace

from phytac_design.mechanics.switch.hyperelastic import Material, Yeoh, bulk_of, neo_hookean
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


def _measured(name: str, constants_MPa: tuple[float, ...], error: float) -> Rubber:
    """Rubber of the database; ``error`` is the fit's, relative, root mean square."""
    return Rubber(
        name=name,
        material=Yeoh(
            coefficients_MPa=constants_MPa, bulk_MPa=bulk_of(2.0 * constants_MPa[0], 0.49)
        ),
        strain_max=1.0,
        assumption=(
            f"{name}: Yeoh fitted up to 100 % strain to one published tensile test, {error:.1%} "
            "off (first pull at 450 mm/min, strain from the crosshead; creep is not in it); "
            "Poisson's ratio 0.49 and 100 % strain are assumed"
        ),
    )


_MEASURED = [
    _measured("ecoflex-00-30", (0.007504, 0.000238, 0.0), 0.022),
    _measured("ecoflex-00-50", (0.01029, 0.0003825, 0.0), 0.027),
    _measured("dragon-skin-10", (0.02185, 0.002753, 0.0), 0.018),
    _measured("mold-star-16", (0.04121, 0.002988, 0.0), 0.008),
    _measured("rebound-25", (0.04869, 0.004435, 0.0), 0.008),
    _measured("mold-star-20t", (0.05445, 0.003478, 0.0), 0.024),
    _measured("dragon-skin-20", (0.06117, 0.007956, 0.0), 0.023),
    _measured("dragon-skin-30", (0.09041, 0.009082, 0.0), 0.011),
    _measured("sortaclear-40", (0.1391, 0.005253, 8.736e-5), 0.003),
    _measured("rtv615", (0.1658, 0.01284, 9.442e-4), 0.004),
]

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
} | {item.name: item for item in _MEASURED}


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
