"""Calibration of a design file on a file of measurements, and the calibrated design file."""

from collections.abc import Callable, Collection
from functools import partial
from pathlib import Path
from typing import cast

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import parse_design, to_toml
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.mechanics.calibration.calibration import LIMIT, calibrate
from phytac_design.mechanics.calibration.calibration_result import (
    Calibration,
    Name,
    ShellParameters,
)
from phytac_design.mechanics.calibration.measurements import read_measurements
from phytac_design.mechanics.calibration.probe_response import ProbeResponse
from phytac_design.mechanics.shell.receptor_stiffness import receptor_stiffness, unknown_receptors
from phytac_shapes.bounded_reader import doubt_about_end
from phytac_shapes.errors import OutputError

MODULI = (0.5, 2.0)
"""Moduli over the design's; beyond these the data are probably in other units."""


def calibrate_design(
    design: Design,
    path: Path,
    *,
    fixed: Collection[str] = (),
    limit: float = LIMIT,
    accuracy: str = "standard",
    progress: Callable[[str], None] = print,
) -> Calibration:
    """Fit a design's wall and material to the measurements in a CSV file.

    Parameters
    ----------
    design : Design
        The sensor; its wall and material are where the search begins.
    path : Path
        Measurements (``docs/formats.md``).
    fixed : collection of str
        Parameters that stay as designed: ``modulus``, ``thickness``, ``poisson``.
    limit : float
        Widest half-interval of modulus and thickness, as a fraction, that is returned.
    accuracy : str
        Preset: its ``refine`` sets the coarser of the two meshes.
    progress : callable
        Called with a line about each iteration.

    Raises
    ------
    InputError
        If the file is not usable.
    NumericalError
        If the data do not determine the parameters.
    """
    surface = design.surface()
    markers = make_markers(design, surface)
    rows = read_measurements(path, surface, markers, wall_mm=design.wall.thickness_mm)
    doubt = doubt_about_end(path)
    if doubt:
        progress(f"warning: {doubt}")
    unknown = unknown_receptors(design)
    if unknown:
        progress(f"calibrate: the wall is taken as plain: {unknown}")
    factors = None if unknown else partial(receptor_stiffness, design, markers)
    around = PRESETS[accuracy].refine * design.layout.columns
    fit = calibrate(
        ProbeResponse(surface=surface, rows=rows, around=around, factors=factors),
        force_N=rows.force_N,
        displacement_mm=rows.displacement_mm,
        press=rows.press,
        start=ShellParameters(
            modulus=design.material.modulus_MPa,
            thickness=design.wall.thickness_mm,
            poisson=design.material.poisson,
        ),
        fixed=cast(Collection[Name], fixed),
        limit=limit,
        progress=progress,
    )
    change = fit.value.modulus / design.material.modulus_MPa
    if not MODULI[0] < change < MODULI[1]:
        progress(
            f"warning: the fitted modulus is {change:.3g} times the design's "
            f"{design.material.modulus_MPa:g} MPa: are forces in N and displacements in mm, and is "
            "the material the design's?"
        )
    return fit


def refuse_existing(path: Path) -> None:
    """Refuse to overwrite a design file.

    Raises
    ------
    OutputError
        If the file exists.
    """
    if path.exists():
        raise OutputError(
            "output-exists", f"{path} exists already; choose another name or remove it"
        )


def write_calibrated(design: Design, fit: Calibration, path: Path) -> Path:
    """Write the design with the fitted modulus, wall and Poisson's ratio.

    It describes the unit that was measured, to decode it; to print another one, keep the design.

    Raises
    ------
    OutputError
        If the file exists already or cannot be written.
    """
    refuse_existing(path)
    data = design.model_dump(mode="json")
    data["wall"]["thickness_mm"] = fit.value.thickness
    data["material"] |= {"modulus_MPa": fit.value.modulus, "poisson": fit.value.poisson}
    made = parse_design(data, f"calibrated design {design.name!r}")
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(to_toml(made))
    except OSError as error:
        raise OutputError("output-not-writable", f"cannot write {path}: {error.strerror}") from None
    return path
