"""The shell as exact CAD (OpenCASCADE through CadQuery) and its STEP file."""

import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.layout.sensor import Sensor
from phytac_design.solids.cad_kernel import cadquery
from phytac_design.solids.cad_wall import wall_cad
from phytac_design.solids.receptor_tubes import ReceptorAxes, receptor_axes
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import CadKernelError, NumericalError, OutputError


@dataclass(frozen=True, kw_only=True)
class CadFacts:
    """Facts of a CAD solid: volume and area exact, ``valid`` by OpenCASCADE's own check."""

    volume_mm3: float
    area_mm2: float
    valid: bool
    solids: int


def shell_cad(sensor: Sensor, *, glued: bool = False) -> Any:
    """Wall, rims, tubes and holes as one ``cadquery`` solid, mm.

    ``glued`` adds the inserts, one piece with the shell; without inserts it changes nothing.

    Raises
    ------
    DesignError
        If no CAD builder is registered for the surface family.
    CadKernelError
        If OpenCASCADE does not return exactly one sound solid.
    """
    design, surface = sensor.design, sensor.surface
    cq = cadquery()
    wall = wall_cad(surface, design.wall)
    axes = receptor_axes(sensor)
    receptor = design.receptor
    radius, hole = receptor.diameter_outer_mm / 2.0, receptor.diameter_hole_mm / 2.0
    if not receptor.has_inserts:
        tubes, cutters = _rods(cq, axes.root_mm, axes.tip_mm, radius), []
    else:
        tall = ~axes.painted
        wide = receptor.diameter_tube_mm / 2.0
        tubes = _rods(cq, axes.root_mm[tall], axes.band_mm[tall], wide)
        tubes += _rods(cq, axes.root_mm, axes.tip_mm, radius) if glued else []
        cutters = [] if glued else _bores(cq, sensor, axes)
    shell = wall.fuse(*tubes) if tubes else wall
    if design.has_switches and not cutters:
        cutters = _rods(cq, axes.hole_start_mm, axes.hole_end_mm, hole)
    shell = shell.cut(*cutters) if cutters else shell
    solids = shell.Solids()
    if len(solids) != 1:
        raise CadKernelError(
            "cad-fuse-failed",
            f"OpenCASCADE cannot fuse receptors and wall: {len(solids)} solids instead of 1; the "
            "printed meshes are made without it",
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


def _bores(cq: Any, sensor: Sensor, axes: ReceptorAxes) -> list[Any]:
    """Bores with the seats of inserts: cones of 45 degrees, straight beyond the outer face."""
    receptor, outside = sensor.design.receptor, sensor.design.receptor.diameter_outer_mm / 2.0
    wide, low = receptor.diameter_seat_mm / 2.0, receptor.diameter_bore_mm / 2.0
    length = np.linalg.norm(axes.hole_end_mm - axes.outer_mm, axis=1).round(6)
    shapes = {}
    for end in np.unique(length).tolist():
        profile = [
            (0.0, -outside),
            (wide, -outside),
            (wide, 0.0),
            (low, receptor.depth_seat_mm),
            (low, end),
            (0.0, end),
        ]
        shapes[end] = revolved_cad(np.array(profile))
    places = [
        cq.Location(cq.Plane(origin=tuple(point), normal=tuple(axis)))
        for point, axis in zip(
            axes.outer_mm.tolist(), sensor.markers.direction.tolist(), strict=True
        )
    ]
    return [shapes[end].moved(place) for end, place in zip(length.tolist(), places, strict=True)]


def cad_facts(shape: Any) -> CadFacts:
    """Volume, area, validity (BRepCheck) and number of solids of a CadQuery shape.

    The volume is integrated to ``volume_rel``: OpenCASCADE's default is off by a few parts in ten
    thousand on spline faces.
    """
    volume_rel = 1e-6  # requested relative error of OpenCASCADE's volume
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape.wrapped, properties, volume_rel, False, False)
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
        raise OutputError(
            "output-not-writable",
            f"cannot write STEP file {path}; check that the folder is writable",
        )
    head, data = _undated(path)
    data = re.sub(r"PRODUCT\('[^']*',\s*'[^']*'", f"PRODUCT('{name}','{name}'", data, count=1)
    path.write_text(f"{head}DATA;{data}", encoding="latin-1")


def write_solid(solid: Any, path: Path) -> None:
    """Write a solid to its last bit, for another process; see :func:`read_solid`."""
    from OCP.BinTools import BinTools

    BinTools.Write_s(solid.wrapped, str(path))


def read_solid(path: Path) -> Any:
    """Solid of :func:`write_solid` as a ``cadquery`` one."""
    cq = cadquery()
    from OCP.BinTools import BinTools
    from OCP.TopoDS import TopoDS_Shape

    shape = TopoDS_Shape()
    BinTools.Read_s(shape, str(path))
    return cq.Shape.cast(shape)


def _undated(path: Path) -> tuple[str, str]:
    """Head, with a fixed time stamp, and data of a STEP file."""
    head, data = path.read_text(encoding="latin-1").split("DATA;", 1)
    stamp = "'2000-01-01T00:00:00'"
    return re.sub(r"'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d'", stamp, head), data


@dataclass(frozen=True, kw_only=True)
class CadBody:
    """A body of an assembly: its shape, colour (red, green, blue, 0 to 1), and place.

    ``frame`` is an origin (3,) and a rotation (3, 3) whose columns are its axes; none for the
    assembly's own frame. Bodies of one shape share it in the file.
    """

    name: str
    shape: Any
    colour: tuple[float, float, float]
    frame: tuple[FloatArray, FloatArray] | None = None


def write_assembly(bodies: Sequence[CadBody], path: Path, *, name: str) -> None:
    """Write a STEP assembly (AP214, mm) with names and colours, without time stamp or counters.

    Raises
    ------
    OutputError
        If OpenCASCADE cannot write the file.
    """
    cq = cadquery()
    whole = cq.Assembly(name=name)
    for body in bodies:
        place = None
        if body.frame is not None:
            origin, turn = body.frame
            plane = cq.Plane(
                origin=tuple(origin.tolist()),
                xDir=tuple(turn[:, 0].tolist()),
                normal=tuple(turn[:, 2].tolist()),
            )
            place = cq.Location(plane)
        whole.add(body.shape, name=body.name, loc=place)
    try:
        whole.export(str(path), "STEP", write_pcurves=False)
    except (ValueError, RuntimeError, OSError) as error:
        raise OutputError(
            "output-not-writable", f"cannot write STEP file {path}: {error}"
        ) from None
    if not path.is_file():
        raise OutputError(
            "output-not-writable",
            f"cannot write STEP file {path}; check that the folder is writable",
        )
    head, data = _undated(path)
    # OpenCASCADE's numbers of the places of bodies grow from file to file, and with their digits
    # the place where it breaks the line.
    count = itertools.count(1)
    data = re.sub(
        r"(NEXT_ASSEMBLY_USAGE_OCCURRENCE\()'\d+'([^;]*;)",
        lambda found: f"{found[1]}'{next(count)}'{''.join(map(str.strip, found[2].splitlines()))}",
        data,
    )
    colours = list({id(body.shape): body.colour for body in bodies}.values())
    path.write_text(f"{head}DATA;{_coloured(data, colours)}", encoding="latin-1")


def _coloured(data: str, colours: Sequence[tuple[float, float, float]]) -> str:
    """Data section of a STEP file with a colour for each of its shapes, in their order.

    OpenCASCADE's own colours come in another order each time.
    """
    # STEP's name for the entity that gives items their looks.
    colour_of = "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION"
    numbers = [int(found) for found in re.findall(r"^#(\d+)\s*=", data, flags=re.MULTILINE)]
    shapes = re.findall(
        r"=\s*ADVANCED_BREP_SHAPE_REPRESENTATION\('[^']*',\s*\(([^)]*)\),\s*#(\d+)\)", data
    )
    if len(shapes) != len(colours):
        raise NumericalError(
            "step-assembly-incomplete",
            f"the STEP assembly holds {len(shapes)} shapes instead of {len(colours)}; please "
            "report this design",
        )
    solid = set(re.findall(r"#(\d+)\s*=\s*(?:MANIFOLD_SOLID_BREP|BREP_WITH_VOIDS)", data))
    lines, used = [], max(numbers)
    for (items, context), (red, green, blue) in zip(shapes, colours, strict=True):
        n = used
        for item in (found for found in re.findall(r"#(\d+)", items) if found in solid):
            lines += [
                f"#{n + 1} = COLOUR_RGB('',{red:.4f},{green:.4f},{blue:.4f});",
                f"#{n + 2} = FILL_AREA_STYLE_COLOUR('',#{n + 1});",
                f"#{n + 3} = FILL_AREA_STYLE('',(#{n + 2}));",
                f"#{n + 4} = SURFACE_STYLE_FILL_AREA(#{n + 3});",
                f"#{n + 5} = SURFACE_SIDE_STYLE('',(#{n + 4}));",
                f"#{n + 6} = SURFACE_STYLE_USAGE(.BOTH.,#{n + 5});",
                f"#{n + 7} = PRESENTATION_STYLE_ASSIGNMENT((#{n + 6}));",
                f"#{n + 8} = STYLED_ITEM('color',(#{n + 7}),#{item});",
                f"#{n + 9} = {colour_of}('',(#{n + 8}),#{context});",
            ]
            n += 9
        used = n
    body, end = data.rsplit("ENDSEC;", 1)
    return body + "\n".join(lines) + "\nENDSEC;" + end


def revolved_cad(profile_mm: FloatArray) -> Any:
    """Solid of revolution of a half section (k, 2) as (r, z) whose ends lie on the axis."""
    cq = cadquery()
    points = [cq.Vector(float(r), 0.0, float(z)) for r, z in profile_mm]
    wire = cq.Wire.makePolygon(points, close=True)
    return cq.Solid.revolve(wire, [], 360.0, cq.Vector(0, 0, 0), cq.Vector(0, 0, 1))
