"""The shell as exact CAD (OpenCASCADE through CadQuery) and its STEP file."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.fabrication.cad_kernel import cadquery
from phytac_design.fabrication.cad_wall import WALLS, wall_cad
from phytac_design.fabrication.receptors import receptor_axes
from phytac_design.layout import Markers
from phytac_design.spec import Design
from shapes import Surface
from shapes.arrays import FloatArray
from shapes.errors import NumericalError, OutputError

__all__ = [
    "WALLS",
    "CadFacts",
    "cad_facts",
    "read_step",
    "shell_cad",
    "wall_cad",
    "write_step",
    "write_stl_by_cad",
]
STEP_DATE = "2000-01-01T00:00:00"
"""Time stamp of every STEP file: the same inputs give the same file."""
VOLUME_REL = 1e-6
"""Relative error asked of OpenCASCADE's volume."""


@dataclass(frozen=True, kw_only=True)
class CadFacts:
    """Facts of a CAD solid: volume and area exact, ``valid`` by OpenCASCADE's own check."""

    volume_mm3: float
    area_mm2: float
    valid: bool
    solids: int


def shell_cad(design: Design, surface: Surface, markers: Markers) -> Any:
    """Wall, rims, tubes and holes as one ``cadquery`` solid, mm.

    Raises
    ------
    DesignError
        If no CAD builder is registered for the surface family.
    NumericalError
        If OpenCASCADE does not return exactly one solid.
    """
    cq = cadquery()
    wall = wall_cad(surface, design.wall)
    axes = receptor_axes(design, surface, markers)
    receptor = design.receptor
    tubes = _rods(cq, axes.root_mm, axes.tip_mm, receptor.diameter_outer_mm / 2.0)
    holes = _rods(cq, axes.hole_start_mm, axes.hole_end_mm, receptor.diameter_hole_mm / 2.0)
    solids = wall.fuse(*tubes).cut(*holes).Solids()
    if len(solids) != 1:
        raise NumericalError(
            f"the CAD shell falls into {len(solids)} solids instead of 1; "
            "run `phytac check` on the design"
        )
    return solids[0]


def _rods(cq: Any, start_mm: FloatArray, end_mm: FloatArray, radius_mm: float) -> list[Any]:
    """Round rods between points (n, 3)."""
    axis = end_mm - start_mm
    length = np.linalg.norm(axis, axis=1)
    return [
        cq.Solid.makeCylinder(radius_mm, h, cq.Vector(*p), cq.Vector(*d))
        for p, d, h in zip(start_mm.tolist(), axis.tolist(), length.tolist(), strict=True)
    ]


def cad_facts(shape: Any) -> CadFacts:
    """Volume, area, validity (BRepCheck) and number of solids of a CadQuery shape.

    The volume is integrated to ``VOLUME_REL``: OpenCASCADE's default is off by a few parts in ten
    thousand on spline faces.
    """
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape.wrapped, properties, VOLUME_REL, False, False)
    return CadFacts(
        volume_mm3=float(properties.Mass()),
        area_mm2=float(shape.Area()),
        valid=bool(shape.isValid()),
        solids=len(shape.Solids()),
    )


def write_step(solid: Any, path: Path, *, name: str = "shell") -> None:
    """Write a STEP file (AP214, mm, no pcurves) without time stamp or session counters.

    Raises
    ------
    OutputError
        If OpenCASCADE cannot write the file.
    """
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

    writer = STEPControl_Writer()
    Interface_Static.SetIVal_s("write.surfacecurve.mode", 0)
    Interface_Static.SetCVal_s("write.step.product.name", name)
    writer.Transfer(solid.wrapped, STEPControl_AsIs)
    if writer.Write(str(path)) != IFSelect_RetDone:
        raise OutputError(f"cannot write STEP file {path}; check that the folder is writable")
    text = path.read_text(encoding="latin-1")
    head, data = text.split("DATA;", 1)
    head = re.sub(r"'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d'", f"'{STEP_DATE}'", head)
    data = re.sub(r"PRODUCT\('[^']*',\s*'[^']*'", f"PRODUCT('{name}','{name}'", data, count=1)
    path.write_text(f"{head}DATA;{data}", encoding="latin-1")


def read_step(path: Path) -> Any:
    """Open a STEP file again, as a CadQuery shape."""
    cq = cadquery()
    return cq.importers.importStep(str(path)).val()


def write_stl_by_cad(solid: Any, path: Path, *, tolerance_mm: float, angle_rad: float) -> None:
    """STL by OpenCASCADE's own mesher: the peer that benchmarks compare with."""
    solid.exportStl(str(path), tolerance_mm, angle_rad)
