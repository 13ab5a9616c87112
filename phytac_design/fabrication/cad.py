"""The shell as exact CAD (OpenCASCADE through CadQuery, imported here only) and its STEP file."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.fabrication.profile import profile_points, wall_profile
from phytac_design.fabrication.receptors import receptor_axes
from phytac_design.layout import Markers
from phytac_design.spec import Design, WallSection
from shapes import Cylinder, Surface
from shapes.arrays import FloatArray
from shapes.errors import DesignError, MissingPartError, NumericalError, OutputError

STEP_DATE = "2000-01-01T00:00:00"
"""Time stamp of every STEP file: the same inputs give the same file."""


@dataclass(frozen=True, kw_only=True)
class CadFacts:
    """Facts of a CAD solid: volume and area exact, ``valid`` by OpenCASCADE's own check."""

    volume_mm3: float
    area_mm2: float
    valid: bool
    solids: int


def _cadquery() -> Any:
    """Import CadQuery, whose viewer links OpenGL and X11 even where nothing is drawn."""
    try:
        import cadquery
    except ImportError as error:
        raise MissingPartError(
            f"no CAD: cadquery cannot be imported ({error}); on Debian/Ubuntu: "
            "sudo apt-get install libgl1 libxrender1"
        ) from error
    return cadquery


def revolved_wall(surface: Surface, wall: WallSection) -> Any:
    """Wall and rims of a surface of revolution with straight generators, as a CadQuery solid."""
    cq = _cadquery()

    v = surface.domain[1, :1]
    points = profile_points(surface, wall_profile(surface, wall), v)[0]
    radius, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    loop = _without_straight_corners(np.column_stack([radius, z]))
    wire = cq.Wire.makePolygon([cq.Vector(r, 0.0, height) for r, height in loop], close=True)
    return cq.Solid.revolve(wire, [], 360.0, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))


WALLS: dict[type[Surface], Callable[[Surface, WallSection], Any]] = {Cylinder: revolved_wall}
"""CAD of the wall for each surface family; a new family adds its builder."""


def _without_straight_corners(loop: FloatArray) -> FloatArray:
    """Drop points of a closed polygon (n, 2) that lie on the line through their neighbours."""
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    scale = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.asarray(loop[np.abs(turn) > 1e-9 * scale])


def shell_cad(design: Design, surface: Surface, markers: Markers) -> Any:
    """Wall, rims, tubes and holes as one ``cadquery`` solid, mm.

    Raises
    ------
    DesignError
        If no CAD builder is registered for the surface family.
    NumericalError
        If OpenCASCADE does not return exactly one solid.
    """
    cq = _cadquery()

    if type(surface) not in WALLS:
        known = ", ".join(sorted(kind.name for kind in WALLS))
        raise DesignError(
            f"shape {surface.name!r} has no CAD wall (known: {known}); register one in "
            "phytac_design.fabrication.cad.WALLS, or build without STEP"
        )
    wall = WALLS[type(surface)](surface, design.wall)
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
    """Volume, area, validity (BRepCheck) and number of solids of a CadQuery shape."""
    return CadFacts(
        volume_mm3=float(shape.Volume()),
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
    cq = _cadquery()

    return cq.importers.importStep(str(path)).val()


def write_stl_by_cad(solid: Any, path: Path, *, tolerance_mm: float, angle_rad: float) -> None:
    """STL by OpenCASCADE's own mesher: the peer that benchmarks compare with."""
    solid.exportStl(str(path), tolerance_mm, angle_rad)
