"""Laws of rubbers from tensile tests: neo-Hookean, Yeoh or Ogden."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from phytac_design.mechanics.switch.hyperelastic import Material, Ogden, Yeoh, bulk_of
from phytac_shapes.arrays import FloatArray
from phytac_shapes.bounded_reader import read_text
from phytac_shapes.errors import InputError, cause_of

Law = Literal["neo-hookean", "yeoh", "ogden"]
TERMS = {"neo-hookean": 1, "yeoh": 3, "ogden": 3}


@dataclass(frozen=True, kw_only=True)
class MaterialFit:
    """A law fitted to a tensile test.

    Attributes
    ----------
    material : Material
        The law.
    error : float
        Root mean square error of the stress over its root mean square.
    """

    material: Material
    error: float


def uniaxial_stress(material: Yeoh | Ogden, stretch: FloatArray) -> FloatArray:
    """Nominal stress, MPa, of a volume-preserving bar at stretches (n,)."""
    side = stretch**-0.5
    _, first, _ = material.derivatives(np.stack([stretch, side, side], axis=-1))
    return np.asarray(first[:, 0] - first[:, 1] * side / stretch)


def fit_uniaxial(
    stretch: FloatArray,
    stress_MPa: FloatArray,
    *,
    law: Law = "yeoh",
    poisson: float = 0.49,
    seed: int = 0,
) -> MaterialFit:
    """Fit a law to nominal stress against stretch of a tensile (or compressive) test.

    Parameters
    ----------
    stretch, stress_MPa : (n,) float
        Stretch (1 at rest) and force over the area at rest.
    law : {"neo-hookean", "yeoh", "ogden"}
        One, three or two times three constants.
    poisson : float
        Poisson's ratio at rest, for the bulk modulus.
    seed : int
        Of the random starts of an Ogden fit.

    Raises
    ------
    InputError
        If the data is not usable, or the fitted law is unstable within its range.
    """
    stretch, stress = np.asarray(stretch, float), np.asarray(stress_MPa, float)
    _check(stretch, stress, law)
    material = (
        _fit_ogden(stretch, stress, poisson, seed)
        if law == "ogden"
        else _fit_yeoh(stretch, stress, TERMS[law], poisson)
    )
    _check_stable(material, stretch, law)
    misfit = uniaxial_stress(material, stretch) - stress
    error = float(np.sqrt(np.mean(misfit**2) / np.mean(stress**2)))
    return MaterialFit(material=material, error=error)


def read_test(path: Path) -> tuple[FloatArray, FloatArray]:
    """Stretch and nominal stress of a CSV with a header ``stretch,stress_MPa``.

    Raises
    ------
    InputError
        If it cannot be read as that.
    """
    try:
        head, *rows = read_text(path, encoding="utf-8-sig").strip().splitlines()
        names = [name.strip() for name in head.split(",")]
        data = np.array([[float(x) for x in row.split(",")] for row in rows if row.strip()])
        return data[:, names.index("stretch")], data[:, names.index("stress_MPa")]
    except (OSError, ValueError, IndexError) as error:
        raise InputError(
            "tensile-file-invalid",
            f"{path} is not a tensile test ({cause_of(error)}); write a CSV with the header "
            "'stretch,stress_MPa' and one line per reading",
        ) from None


def _check(stretch: FloatArray, stress: FloatArray, law: str) -> None:
    if law not in TERMS:
        raise InputError(
            "rubber-law-unknown", f"no law {law!r} of rubbers; known: {', '.join(TERMS)}"
        )
    need = 2 * TERMS[law]
    if stretch.shape != stress.shape or stretch.ndim != 1 or len(stretch) < need:
        raise InputError(
            "tensile-too-few-readings",
            f"a fit of {law} needs {need} pairs of stretch and stress (got shapes "
            f"{stretch.shape} and {stress.shape}); give more readings or take neo-hookean",
        )
    if not (np.isfinite(stretch).all() and np.isfinite(stress).all() and (stretch > 0).all()):
        raise InputError(
            "tensile-value-invalid",
            "stretches must be positive and stresses finite; check the test's file",
        )
    if not np.any(np.abs(stretch - 1.0) > 1e-3):
        raise InputError(
            "tensile-stretch-too-small",
            "the test never stretches the rubber by 0.1 %; is it strain, not stretch?",
        )


def _fit_yeoh(stretch: FloatArray, stress: FloatArray, terms: int, poisson: float) -> Yeoh:
    excess = stretch**2 + 2.0 / stretch - 3.0
    base = 2.0 * (stretch - stretch**-2)
    columns = np.stack([base * (k + 1) * excess**k for k in range(terms)], axis=1)
    found = np.linalg.lstsq(columns, stress, rcond=None)[0]
    if found[0] <= 0.0:
        raise InputError(
            "rubber-fit-negative-stiffness",
            f"the fit gives a negative stiffness at rest (C₁ = {found[0]:.3g} MPa); give readings "
            "at small stretch, or take neo-hookean",
        )
    return Yeoh(
        coefficients_MPa=tuple(found.tolist()), bulk_MPa=bulk_of(2.0 * float(found[0]), poisson)
    )


def _fit_ogden(stretch: FloatArray, stress: FloatArray, poisson: float, seed: int) -> Ogden:
    """Exponents by least squares; the constants that go with them are linear."""
    from scipy.optimize import least_squares

    scale = float(np.sqrt(np.mean(stress**2)))
    rng = np.random.default_rng(seed)

    def columns(exponents: FloatArray) -> FloatArray:
        return np.stack([stretch ** (a - 1.0) - stretch ** (-0.5 * a - 1.0) for a in exponents], 1)

    def shares(exponents: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.lstsq(columns(exponents), stress, rcond=1e-10)[0])

    def misfit(exponents: FloatArray) -> FloatArray:
        return np.asarray((columns(exponents) @ shares(exponents) - stress) / scale)

    bounds = ([0.5, 2.5, -8.0], [2.5, 12.0, -0.5])
    # Random starts, since it has many local minima.
    starts = [np.array([1.3, 5.0, -2.0]), *rng.uniform(*bounds, size=(12, 3))]
    best = min(
        (least_squares(misfit, start, bounds=bounds, xtol=1e-12) for start in starts),
        key=lambda found: float(found.cost),
    ).x
    terms = shares(best)
    shear = 0.5 * float(terms @ best)
    if shear <= 0.0:
        raise InputError(
            "rubber-fit-negative-stiffness",
            f"the fit gives a negative stiffness at rest ({shear:.3g} MPa); give readings at small "
            "stretch, or take neo-hookean",
        )
    return Ogden(
        shear_terms_MPa=tuple(terms.tolist()),
        exponents=tuple(best.tolist()),
        bulk_MPa=bulk_of(shear, poisson),
    )


def _check_stable(material: Yeoh | Ogden, stretch: FloatArray, law: str) -> None:
    """Drucker: stress rises with stretch in tension, equal biaxial tension and plane strain."""
    largest = max(float(stretch.max()), 1.0 / float(stretch.min()))
    line = np.linspace(1.0, largest, 60)
    ways: dict[str, Callable[[FloatArray], tuple[FloatArray, ...]]] = {
        "tension": lambda s: (s, s**-0.5, s**-0.5),
        "biaxial tension": lambda s: (s, s, s**-2.0),
        "plane strain": lambda s: (s, np.ones_like(s), 1.0 / s),
    }
    for name, way in ways.items():
        at = np.stack(way(line), axis=-1)
        _, first, _ = material.derivatives(at)
        rise = first[:, 0] - first[:, 2] * at[:, 2] / at[:, 0]
        if np.any(np.diff(rise) <= 0.0):
            worst = line[int(np.argmin(np.diff(rise)))]
            raise InputError(
                "rubber-fit-unstable",
                f"the fitted {law} law is unstable in {name} at a stretch of {worst:.2f} (its "
                "stress falls); take neo-hookean, or give readings of a wider range",
            )
