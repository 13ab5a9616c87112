"""Isotropic hyperelastic materials by their principal stretches.

A material gives energy, slopes and curvatures of its energy density W(λ₁, λ₂, λ₃); the volumetric
part ½ κ (J − 1)² is left to the element, which projects J − 1 so that κ ≫ μ does not lock.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError


class Material(ABC):
    """What the element needs of a material."""

    bulk_MPa: float
    """Bulk modulus κ of the projected part; 0 where ``derivatives`` holds all of W."""

    @property
    @abstractmethod
    def shear_MPa(self) -> float:
        """Shear modulus at rest."""

    @abstractmethod
    def derivatives(self, stretch: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """W (…), ∂W/∂λᵢ (…, 3) and ∂²W/∂λᵢ∂λⱼ (…, 3, 3) at stretches (…, 3), MPa."""

    @abstractmethod
    def scaled(self, factor: float) -> "Material":
        """Return the material with all stresses multiplied."""

    @property
    def modulus_MPa(self) -> float:
        """Young's modulus at rest."""
        return 9.0 * self.bulk_MPa * self.shear_MPa / (3.0 * self.bulk_MPa + self.shear_MPa)

    @property
    def poisson(self) -> float:
        """Poisson's ratio at rest."""
        return (3.0 * self.bulk_MPa - 2.0 * self.shear_MPa) / (
            6.0 * self.bulk_MPa + 2.0 * self.shear_MPa
        )


def _from_logarithms(
    stretch: FloatArray, slope: FloatArray, curve: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Slopes by stretch from those by the logarithms of volume-preserving stretches."""
    slope = slope - slope.mean(axis=-1, keepdims=True)
    curve = curve - curve.mean(axis=-1, keepdims=True)
    curve = curve - curve.mean(axis=-2, keepdims=True)
    np.einsum("...ii->...i", curve)[...] -= slope
    first = slope / stretch
    return first, curve / (stretch[..., :, None] * stretch[..., None, :])


@dataclass(frozen=True, kw_only=True)
class Yeoh(Material):
    """W = Σ Cᵢ (Ī₁ − 3)ⁱ, i = 1 … n; one term is the neo-Hookean material (Yeoh 1993).

    Attributes
    ----------
    coefficients_MPa : tuple of float
        C₁, C₂, … .
    bulk_MPa : float
        Bulk modulus κ of ½ κ (J − 1)².
    """

    coefficients_MPa: tuple[float, ...]
    bulk_MPa: float

    @property
    def shear_MPa(self) -> float:
        """Shear modulus at rest."""
        return 2.0 * self.coefficients_MPa[0]

    def derivatives(self, stretch: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :class:`Material`."""
        square = np.exp(2.0 * _isochoric_log(stretch))
        excess = (square - 1.0).sum(axis=-1)
        power = np.polynomial.Polynomial([0.0, *self.coefficients_MPa])
        first, second = power.deriv(1)(excess), power.deriv(2)(excess)
        slope = 2.0 * first[..., None] * square
        curve = 4.0 * second[..., None, None] * square[..., :, None] * square[..., None, :]
        np.einsum("...ii->...i", curve)[...] += 2.0 * slope
        return power(excess), *_from_logarithms(stretch, slope, curve)

    def scaled(self, factor: float) -> "Yeoh":
        """Return the material with all stresses multiplied."""
        terms = tuple(factor * c for c in self.coefficients_MPa)
        return replace(self, coefficients_MPa=terms, bulk_MPa=factor * self.bulk_MPa)


@dataclass(frozen=True, kw_only=True)
class Ogden(Material):
    """W = Σ μᵢ/αᵢ (λ̄₁^αᵢ + λ̄₂^αᵢ + λ̄₃^αᵢ − 3) (Ogden 1972); μ at rest is ½ Σ μᵢ αᵢ.

    Attributes
    ----------
    shear_terms_MPa, exponents : tuple of float
        μᵢ and αᵢ.
    bulk_MPa : float
        Bulk modulus κ of ½ κ (J − 1)².
    """

    shear_terms_MPa: tuple[float, ...]
    exponents: tuple[float, ...]
    bulk_MPa: float

    @property
    def shear_MPa(self) -> float:
        """Shear modulus at rest."""
        return 0.5 * float(np.dot(self.shear_terms_MPa, self.exponents))

    def derivatives(self, stretch: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """See :class:`Material`."""
        log = _isochoric_log(stretch)
        energy = np.zeros(stretch.shape[:-1])
        slope, curve = np.zeros_like(stretch), np.zeros((*stretch.shape, 3))
        for shear, exponent in zip(self.shear_terms_MPa, self.exponents, strict=True):
            power = np.exp(exponent * log)
            energy += shear / exponent * (power - 1.0).sum(axis=-1)
            slope += shear * power
            np.einsum("...ii->...i", curve)[...] += shear * exponent * power
        return energy, *_from_logarithms(stretch, slope, curve)

    def scaled(self, factor: float) -> "Ogden":
        """Return the material with all stresses multiplied."""
        terms = tuple(factor * m for m in self.shear_terms_MPa)
        return replace(self, shear_terms_MPa=terms, bulk_MPa=factor * self.bulk_MPa)


def _isochoric_log(stretch: FloatArray) -> FloatArray:
    log = np.log(stretch)
    return np.asarray(log - log.mean(axis=-1, keepdims=True))


def bulk_of(shear_MPa: float, poisson: float) -> float:
    """Bulk modulus, MPa, from shear modulus and Poisson's ratio.

    Raises
    ------
    DesignError
        If the ratio is not within [0, 0.49999].
    """
    # Beyond it κ/μ exceeds 5·10⁴, and rounding errors dominate the mixed element.
    largest = 0.49999
    if not 0.0 <= poisson <= largest:
        raise DesignError(
            "rubber-poisson-invalid",
            f"Poisson's ratio of the switch must lie within 0 and {largest} (got "
            f"{poisson:g}); for a rubber that keeps its volume take 0.499",
        )
    return 2.0 * shear_MPa * (1.0 + poisson) / (3.0 * (1.0 - 2.0 * poisson))


def neo_hookean(*, modulus_MPa: float, poisson: float) -> Yeoh:
    """Neo-Hookean material of a Young's modulus and Poisson's ratio at rest.

    Raises
    ------
    DesignError
        If one of the two is out of range.
    """
    if not (np.isfinite(modulus_MPa) and 1e-3 <= modulus_MPa <= 1e6):
        raise DesignError(
            "rubber-modulus-invalid",
            f"the switch's modulus must lie within 0.001 and 1e6 MPa (got {modulus_MPa:g}); soft "
            "rubbers have 0.3 to 30 MPa",
        )
    bulk_of(1.0, poisson)
    shear = modulus_MPa / (2.0 * (1.0 + poisson))
    return Yeoh(coefficients_MPa=(0.5 * shear,), bulk_MPa=bulk_of(shear, poisson))
