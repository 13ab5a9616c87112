"""The same switch in CalculiX: axisymmetric eight-node elements, large strain, pad pushed in."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from phytac_design.mechanics.switch.bowl import BowlModel
from phytac_design.mechanics.switch.hyperelastic import Material, Ogden, Yeoh
from phytac_design.mechanics.switch.soft_cup import CupModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError
from verification.calculix import run_ccx

CAX8 = (0, 6, 8, 2, 3, 7, 5, 1)
"""Our local nodes in CalculiX's order: corners, then the middles of the sides."""
SECTORS = 180.0
"""CalculiX prints the forces on a sector of 2 degrees."""


def write_ccx(
    path: Path, body: BowlModel | CupModel, *, stroke_mm: float, steps: int, element: str = "CAX8R"
) -> Path:
    """Write a job that pushes the pad in by ``stroke_mm`` in equal steps.

    Raises
    ------
    InputError
        If CalculiX has no such material.
    """
    path.write_text("\n".join(_job(body, stroke_mm, steps, element)) + "\n", encoding="ascii")
    return path


def _job(body: BowlModel | CupModel, stroke_mm: float, steps: int, element: str) -> Iterator[str]:
    mesh = body.model.mesh
    octets = mesh.quads[:, CAX8]
    used = np.unique(octets)
    yield "*NODE, NSET=ALL"
    yield from (
        f"{k + 1}, {mesh.nodes_mm[k, 0]:.12e}, {mesh.nodes_mm[k, 1]:.12e}, 0." for k in used
    )
    yield f"*ELEMENT, TYPE={element}, ELSET=BODY"
    yield from (
        f"{e}, {', '.join(map(str, row))}" for e, row in enumerate((octets + 1).tolist(), 1)
    )
    yield "*NSET, NSET=PAD"
    pad = np.intersect1d(body.model.tied, used)
    yield from (f"{k + 1}," for k in pad)
    yield from hyperelastic_lines(body.model.material)
    yield "*SOLID SECTION, ELSET=BODY, MATERIAL=RUBBER"
    yield "*BOUNDARY"
    held = np.all(body.model.held, axis=1)
    yield from (f"{k + 1}, 1, 2" for k in used if held[k])
    axis = np.intersect1d(mesh.where(mesh.nodes_mm[:, 0]), used)
    yield from (f"{k + 1}, 1, 1" for k in axis)
    share = 1.0 / steps
    yield from ("*STEP, NLGEOM, INC=500", "*STATIC, DIRECT", f"{share:.9g}, 1.", "*BOUNDARY")
    yield f"PAD, 2, 2, {-stroke_mm:.12e}"
    yield from ("*NODE PRINT, NSET=PAD", "RF", "*END STEP")


def hyperelastic_lines(material: Material) -> Iterator[str]:
    """Lines of a material RUBBER.

    Raises
    ------
    InputError
        If CalculiX has no such law.
    """
    yield "*MATERIAL, NAME=RUBBER"
    # CalculiX writes the volumetric part as (J − 1)² / D₁.
    if isinstance(material, Yeoh) and len(material.coefficients_MPa) in {1, 3}:
        terms = material.coefficients_MPa
        kind = "NEO HOOKE" if len(terms) == 1 else "YEOH"
        spread = [2.0 / material.bulk_MPa, *(0.0 for _ in terms[1:])]
    elif isinstance(material, Ogden):
        pairs = zip(material.shear_terms_MPa, material.exponents, strict=True)
        terms = tuple(x for shear, alpha in pairs for x in (0.5 * shear * alpha, alpha))
        count = len(material.exponents)
        kind = f"OGDEN, N={count}"
        spread = [2.0 / material.bulk_MPa, *(0.0 for _ in range(count - 1))]
    else:
        raise InputError(
            "calculix-law-unknown",
            f"CalculiX has no law like {type(material).__name__} with its terms; take neo-Hookean, "
            "Yeoh of three terms, or Ogden",
        )
    yield f"*HYPERELASTIC, {kind}"
    numbers = [f"{x:.12e}" for x in (*terms, *spread)]
    yield from (", ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8))


def ccx_curve(
    folder: Path,
    body: BowlModel | CupModel,
    *,
    stroke_mm: float,
    steps: int,
    element: str = "CAX8R",
) -> tuple[FloatArray, FloatArray]:
    """Stroke, mm, and force on the pad, N, by CalculiX, (steps,) each.

    Raises
    ------
    MissingPartError
        If ``ccx`` is not installed.
    NumericalError
        If it fails.
    """
    path = write_ccx(folder / "bowl.inp", body, stroke_mm=stroke_mm, steps=steps, element=element)
    times = run_ccx(path)
    force = np.array([-SECTORS * float(time["forces", "PAD"][1][:, 1].sum()) for time in times])
    return stroke_mm * np.arange(1, len(force) + 1) / steps, force
