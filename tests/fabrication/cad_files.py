"""Reading CAD files again, and OpenCASCADE's own mesher: what tests and benchmarks compare with."""

from pathlib import Path
from typing import Any

from phytac_design.solids.cad import CadBody
from phytac_design.solids.cad_kernel import cadquery


def read_step(path: Path) -> Any:
    """Open a STEP file again, as a CadQuery shape."""
    cq = cadquery()
    return cq.importers.importStep(str(path)).val()


def write_stl_by_cad(solid: Any, path: Path, *, tolerance_mm: float, angle_rad: float) -> None:
    """STL by OpenCASCADE's own mesher: the peer that benchmarks compare with."""
    solid.exportStl(str(path), tolerance_mm, angle_rad)


def read_assembly(path: Path) -> dict[str, CadBody]:
    """Bodies of a STEP assembly by name, their shapes where they stand in the assembly."""
    cq = cadquery()
    bodies = {}
    for shape, path_name, place, colour in cq.Assembly.importStep(str(path)):
        name = path_name.rsplit("/", 1)[-1]
        rgb = colour.toTuple()[:3] if colour is not None else (0.0, 0.0, 0.0)
        bodies[name] = CadBody(name=name, shape=shape.moved(place), colour=rgb)
    return bodies
