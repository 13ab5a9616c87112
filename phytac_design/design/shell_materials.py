"""Printable materials of shells, for a first design: stiffness and how far they may be strained.

Moduli of rigid resins are typical of makers' data sheets; those of rubbers follow from the hardness
(A. N. Gent, Rubber Chemistry and Technology 31, 1958). All are assumed: calibrate the print.
"""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class ShellMaterial:
    """A material of the table ``material``.

    Attributes
    ----------
    label : str
        Kind of resin or filament.
    modulus_MPa, poisson : float
        Of the table ``material``.
    strain_max : float
        Bending strain that it bears again and again (assumed).
    """

    label: str
    modulus_MPa: float
    poisson: float
    strain_max: float

    def words(self) -> str:
        """One line for a list."""
        return f"{self.label}: {self.modulus_MPa:g} MPa"


SHELL_MATERIALS = (
    ShellMaterial(label="tough resin", modulus_MPa=2200.0, poisson=0.38, strain_max=0.02),
    ShellMaterial(
        label="durable resin, like polypropylene", modulus_MPa=1000.0, poisson=0.4, strain_max=0.03
    ),
    ShellMaterial(
        label="flexible, Shore 95A (TPU filament)", modulus_MPa=43.8, poisson=0.48, strain_max=0.1
    ),
    ShellMaterial(label="flexible resin, Shore 80A", modulus_MPa=9.4, poisson=0.48, strain_max=0.1),
    ShellMaterial(label="elastic resin, Shore 50A", modulus_MPa=2.5, poisson=0.48, strain_max=0.2),
)
"""The stiffest first."""


def material_of(modulus_MPa: float) -> ShellMaterial | None:
    """The material of this list with a modulus; None if none has it."""
    return next((one for one in SHELL_MATERIALS if one.modulus_MPa == modulus_MPa), None)


def shell_words(modulus_MPa: float) -> str:
    """What a shell of a modulus is made of."""
    material = material_of(modulus_MPa)
    return material.label if material else f"a material of {modulus_MPa:g} MPa"
