r"""Solid meshes of the true CAD, made of quadratic tetrahedra.

The wall, its tubes and its holes between the two rims. A rim sits in its connector and moves as
little as that does: it is left out, and the end faces that joined it (node sets TOP and BOTTOM)
are held instead, which is the same and spares its elements::

    BOTTOM |=====o=====o=====o=====o=====| TOP      outer face: contacts press here
           |----| |---| |---| |---| |----|          (o: holes of the switches' stems)
                |_|   |_|   |_|   |_|               end faces: TIP_0, TIP_1, ...
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.solid.tetrahedra import Tetrahedra, tetrahedra
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError, NumericalError


@dataclass(frozen=True, kw_only=True)
class SolidMeshSettings:
    """Reach of fine elements, and how many nodes a mesh has."""

    on_face_share: float = 1e-5
    """Largest distance of a node to a face it belongs to, as a fraction of the wall's thickness."""
    base_reach_radii: float = 0.5
    """The fine mesh reaches this many tube radii from the foot, then grows over two more."""
    aimed_nodes: int = 400_000
    max_nodes: int = 1_000_000
    """Nodes aimed at and allowed: CalculiX took 4.8 GB and under 3 minutes for 366 000."""
    max_factor: float = 2.0
    """Largest factor on :func:`default_sizes`: a fingertip's tips then move 1.6 % less than on a
    fine mesh (ø30 sensor). At 3 it was 3.2 %, and gmsh did not mesh the 368 tubes of cylinder60."""
    volume_nodes: float = 3.6
    face_nodes: float = 5.8
    hole_nodes: float = 56.0
    tube_nodes: float = 2.8
    receptor_nodes: float = 473.0
    """Nodes per cubed size of the wall's volume, per size and thickness of its area, per squared
    size of the holes' faces in it, per squared size of the tubes' faces, and per receptor: within
    27 % of 36 meshes of 11 000 to 817 000 nodes. The wall's size is that at receptors: Gmsh extends
    it over the whole wall."""


SETTINGS = SolidMeshSettings()


@dataclass(frozen=True, kw_only=True)
class SolidSizes:
    """Lengths of the elements' edges, mm.

    Attributes
    ----------
    wall_mm : float
        On the wall away from everything; at most twice the thickness keeps quadratic tetrahedra
        within aspect ratios that bend well.
    foot_mm : float
        Where tubes meet the wall, and around the holes.
    tube_mm : float
        On the rest of the tubes.
    contact_mm : float
        Under a contact.
    """

    wall_mm: float
    foot_mm: float
    tube_mm: float
    contact_mm: float

    def scaled(self, factor: float) -> "SolidSizes":
        """All sizes times ``factor``, for convergence studies."""
        return SolidSizes(
            wall_mm=self.wall_mm * factor,
            foot_mm=self.foot_mm * factor,
            tube_mm=self.tube_mm * factor,
            contact_mm=self.contact_mm * factor,
        )


def default_sizes(design: Design) -> SolidSizes:
    """Wall 2 t, contact t, foot and tube by the smaller of t and the tube's own wall.

    One layer of quadratic tetrahedra through the wall. Measured under a fingertip: a plain wall at
    1.5 t moves 1.5 % less than at 0.65 t; a sensor with receptors, meshed finely at their bases,
    0.4 % less than at three quarters of its sizes. Scale them down for a reference.
    """
    thickness, receptor = design.wall.thickness_mm, design.receptor
    tube_wall = (receptor.diameter_outer_mm - receptor.diameter_hole_mm) / 2.0
    minimum = min(thickness, tube_wall)
    return SolidSizes(
        wall_mm=2.0 * thickness,
        foot_mm=minimum,
        tube_mm=1.5 * tube_wall,
        contact_mm=thickness,
    )


def expected_nodes(sensor: Sensor, sizes: SolidSizes) -> int:
    """About how many nodes :func:`solid_mesh` will make."""
    design, surface, count = sensor.design, sensor.surface, sensor.markers.count
    thickness = design.wall.thickness_mm
    size = min(sizes.foot_mm, sizes.wall_mm)
    area = 0.5 * (surface.area_mm2() + surface.area_mm2(-thickness))
    receptor = design.receptor
    holes = count * np.pi * receptor.diameter_hole_mm * thickness
    around = np.pi * (receptor.diameter_outer_mm + receptor.diameter_hole_mm)
    tubes = around * float(np.sum(sensor.markers.height_mm))
    nodes = SETTINGS.volume_nodes * area * thickness / size**3
    nodes += SETTINGS.face_nodes * area / (size * thickness)
    nodes += SETTINGS.hole_nodes * holes / size**2
    nodes += SETTINGS.tube_nodes * tubes / sizes.tube_mm**2
    return round(nodes + SETTINGS.receptor_nodes * count)


def coarsened(sensor: Sensor, factor: float | None) -> tuple[float, SolidSizes, int]:
    """Factor on the default sizes, the sizes, and the nodes to expect.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    factor : float or None
        The factor; None for the least of 1 or more that is expected to keep to
        ``SETTINGS.aimed_nodes``, up to ``SETTINGS.max_factor``.

    Raises
    ------
    DesignError
        If the factor is out of range, or the mesh would have more than ``SETTINGS.max_nodes``.
    """
    design = sensor.design
    base = default_sizes(design)
    if factor is None:
        factor = 1.0
        while expected_nodes(sensor, base.scaled(factor)) > SETTINGS.aimed_nodes:
            factor += 0.1
            if factor > SETTINGS.max_factor:
                factor = SETTINGS.max_factor
                break
    elif not 0.1 <= factor <= SETTINGS.max_factor:
        raise DesignError(
            "solid-size-factor",
            f"the factor on solid mesh sizes is 0.1 to {SETTINGS.max_factor:g} (got {factor}); "
            "coarser "
            "meshes are several percent too stiff",
        )
    sizes = base.scaled(factor)
    nodes = expected_nodes(sensor, sizes)
    check_nodes(nodes, factor, about=True)
    return factor, sizes, nodes


def check_nodes(nodes: int, factor: float, *, about: bool = False) -> None:
    """Refuse a mesh of too many nodes.

    Parameters
    ----------
    factor : float
        On the default sizes.
    about : bool
        Whether the nodes are those to expect.

    Raises
    ------
    DesignError
        If they are more than ``SETTINGS.max_nodes``.
    """
    if nodes <= SETTINGS.max_nodes:
        return
    count = f"about {round(nodes, -4)}" if about else str(nodes)
    raise DesignError(
        "solid-too-many-nodes",
        f"a solid of this sensor has {count} nodes at sizes × {factor:.2g}, more than "
        f"{SETTINGS.max_nodes}, and needs {nodes * 13e-6:.0f} GB or more: raise --size (up to "
        f"{SETTINGS.max_factor:g}), or cut out a part of the sensor as a smaller design",
    )


@dataclass(frozen=True, kw_only=True)
class SolidMesh(Tetrahedra):
    """Solid mesh of a sensor's shell, with what loads and results need.

    Attributes
    ----------
    sets : mapping of str to (k,) int
        Node sets ``TOP`` (end face at the far rim), ``BOTTOM`` (near rim), and ``TIP_i``, the
        nodes of the end face of receptor i (marker order).
    outer : (k,) int
        Boundary triangles on the outer face.
    tips : (n,) of (k,) int
        Boundary triangles of each receptor's end face; empty without receptors.
    """

    sets: Mapping[str, IntArray]
    outer: IntArray
    tips: tuple[IntArray, ...] = field(default=())


def solid_mesh(
    sensor: Sensor,
    *,
    sizes: SolidSizes | None = None,
    contacts_uv: FloatArray | None = None,
    contact_radius_mm: float = 0.0,
    receptors: bool = True,
) -> SolidMesh:
    """Quadratic tetrahedra of the wall with its tubes and holes, from the CAD of the STEP file.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    sizes : SolidSizes, optional
        Mesh sizes; :func:`default_sizes` if left out.
    contacts_uv : (m, 2) float, optional
        Chart positions of contacts, under which ``sizes.contact_mm`` rules.
    contact_radius_mm : float
        Their radius.
    receptors : bool
        False for the plain wall without tubes and holes.

    Raises
    ------
    MissingPartError
        If Gmsh or CadQuery is not installed.
    DesignError, NumericalError
        If the CAD or the mesh cannot be made.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    from phytac_design.solids.cad import shell_cad, write_step
    from phytac_design.solids.cad_wall import wall_cad

    sizes = default_sizes(design) if sizes is None else sizes
    bare = design.model_copy(update={"wall": design.wall.model_copy(update={"rim_length_mm": 0.0})})
    wall = (
        shell_cad(Sensor.of(bare, surface, markers), glued=True)
        if receptors
        else wall_cad(surface, bare.wall)
    )
    centres = np.zeros((0, 3)) if contacts_uv is None else surface.point(contacts_uv)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shell.step"
        write_step(wall, path)
        raw = tetrahedra(
            lambda gmsh: gmsh.model.occ.importShapes(str(path)),
            lambda gmsh: _size_fields(
                gmsh, surface, sizes, design, centres, contact_radius_mm, receptors=receptors
            ),
        )
    return with_sets(raw, sensor, receptors=receptors)


def _size_fields(
    gmsh: Any,
    surface: Surface,
    sizes: SolidSizes,
    design: Design,
    centres: FloatArray,
    radius_mm: float,
    *,
    receptors: bool,
) -> int:
    """Least of: the wall's size, balls under contacts, tubes, and growth away from their bases."""
    field = gmsh.model.mesh.field
    tags = [field.add("MathEval")]
    field.setString(tags[0], "F", repr(sizes.wall_mm))
    thickness = design.wall.thickness_mm
    for x, y, z in centres.tolist():
        tags.append(field.add("Ball"))
        numbers = (x, y, z, radius_mm + thickness, 2.0 * thickness, sizes.contact_mm, sizes.wall_mm)
        names = ("XCenter", "YCenter", "ZCenter", "Radius", "Thickness", "VIn", "VOut")
        for name, number in zip(names, numbers, strict=True):
            field.setNumber(tags[-1], name, number)
    if receptors:
        bases, tubes = tube_parts(gmsh, surface, design)
        near = field.add("Distance")
        field.setNumbers(near, "CurvesList", bases)
        field.setNumber(near, "Sampling", 24)
        reach = SETTINGS.base_reach_radii * design.receptor.diameter_tube_mm / 2.0
        tags.append(field.add("Threshold"))
        for name, number in (
            ("InField", near),
            ("SizeMin", sizes.foot_mm),
            ("SizeMax", sizes.wall_mm),
            ("DistMin", reach),
            ("DistMax", 5.0 * reach),
        ):
            field.setNumber(tags[-1], name, number)
        tags.append(field.add("Constant"))
        field.setNumbers(tags[-1], "SurfacesList", tubes)
        field.setNumber(tags[-1], "VIn", sizes.tube_mm)
        field.setNumber(tags[-1], "VOut", sizes.wall_mm)
    minimum = field.add("Min")
    field.setNumbers(minimum, "FieldsList", tags)
    return int(minimum)


def tube_parts(gmsh: Any, surface: Surface, design: Design) -> tuple[list[int], list[int]]:
    """Curves on the two faces of the wall that close on a tube or hole; faces below the wall."""
    boxes = {
        dim: [
            (tag, np.array(gmsh.model.getBoundingBox(dim, tag)))
            for _, tag in gmsh.model.getEntities(dim)
        ]
        for dim in (1, 2)
    }
    widest = 1.5 * design.receptor.diameter_tube_mm
    bases = [tag for tag, box in boxes[1] if np.ptp(box.reshape(2, 3), axis=0).max() < widest]
    depth = []
    for tag, _ in boxes[2]:
        low, high = gmsh.model.getParametrizationBounds(2, tag)
        middle = [(a + b) / 2.0 for a, b in zip(low, high, strict=True)]
        point = np.array(gmsh.model.getValue(2, tag, middle))[None]
        foot = surface.chart(point)
        depth.append(-np.sum((point - surface.point(foot)) * surface.normal(foot)))
    limit = (1.0 + 1e-3) * design.wall.thickness_mm
    return bases, [tag for (tag, _), d in zip(boxes[2], depth, strict=True) if d > limit]


def with_sets(raw: Tetrahedra, sensor: Sensor, *, receptors: bool) -> SolidMesh:
    """Find the end faces, the outer face and the receptors' tips by where the nodes lie."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    thickness = design.wall.thickness_mm
    near = SETTINGS.on_face_share * thickness
    skin, back = np.unique(raw.triangles, return_inverse=True)
    points = raw.nodes_mm[skin]
    uv = surface.chart(points)
    foot, normal = surface.point(uv), surface.normal(uv)
    height = np.einsum("ni,ni->n", points - foot, normal)
    (u0, u1), _ = surface.domain
    stretch = np.sqrt(surface.metric(uv)[:, 0, 0])
    corners = back.reshape(raw.triangles.shape)

    def faces(nodes: Any) -> IntArray:
        # Middle nodes of edges that were made straight lie a little beside their face.
        return np.flatnonzero(np.asarray(nodes)[corners[:, :3]].all(axis=1))

    inside = height > -thickness - near
    ends = {
        name: faces(inside & (np.abs(uv[:, 0] - u) * stretch < near))
        for name, u in (("TOP", u1), ("BOTTOM", u0))
    }
    sets = {name: np.unique(raw.triangles[part]) for name, part in ends.items()}
    if not all(len(part) for part in ends.values()):
        raise NumericalError(
            "solid-end-face-missing",
            "the solid mesh has no end face at a rim; please report this design",
        )
    tips: tuple[IntArray, ...] = ()
    if receptors:
        tips = _tip_faces(points[corners[:, :3]], design, markers, near)
        sets |= {f"TIP_{i}": np.unique(raw.triangles[part]) for i, part in enumerate(tips)}
    return SolidMesh(
        nodes_mm=raw.nodes_mm,
        tets=raw.tets,
        triangles=raw.triangles,
        sets=sets,
        outer=faces(np.abs(height) < near),
        tips=tips,
    )


def _tip_faces(
    corner: FloatArray, design: Design, markers: Markers, near_mm: float
) -> tuple[IntArray, ...]:
    """Boundary triangles, by corners (F, 3, 3), in the plane of each end face and its tube."""
    from scipy.spatial import cKDTree

    radius = design.receptor.diameter_outer_mm / 2.0
    owner = cKDTree(markers.tip_mm).query(corner.mean(axis=1))[1]
    arm = corner - markers.tip_mm[owner][:, None]
    above = np.abs(np.einsum("fki,fi->fk", arm, markers.direction[owner])).max(axis=1)
    away = np.linalg.norm(arm, axis=2).max(axis=1)
    on_tip = np.flatnonzero((above < near_mm) & (away < (1.0 + 1e-6) * radius))
    tips = tuple(on_tip[owner[on_tip] == i] for i in range(markers.count))
    bare = [i for i, part in enumerate(tips) if not len(part)]
    if bare:
        raise NumericalError(
            "solid-end-face-missing",
            f"the solid mesh has no end face for receptor {bare[0]} ({len(bare)} in all); "
            "please report this design",
        )
    return tips
