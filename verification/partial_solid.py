r"""The whole wall as a solid, with true tubes and holes only around the contacts.

A contact bends a closed wall all the way around: a sector cut out and held at its sides moves half
as much as it should. So the wall stays whole, and away from the contacts, where the mesh is
coarse, tubes and holes are smeared: the wall gets the mean membrane and bending stiffness that
:mod:`mechanics.receptors` has for them, by its thickness t' = t √(r_b / r_m) and its modulus
E' = E r_m t / t', which change over a cell's width, without steps::

    BOTTOM |==========o=====o==v==o=====o===========| TOP      v: contact
             t', E'  |_|   |_|   |_|   |_|   t', E'
                       true, within reach_mm
"""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell import receptor_stiffness as rc
from phytac_design.mechanics.solid.solid_mesh_tets import (
    SolidMesh,
    SolidSizes,
    tube_parts,
    with_sets,
)
from phytac_design.mechanics.solid.tetrahedra import tetrahedra
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

GROWTH = 0.7
"""Growth of sizes per length away from the feet of tubes."""
FOOT_SAMPLES = 60
ON_INNER = 1e-3
"""Largest distance of a foot from the inner face, as a fraction of the wall's thickness."""
AS_TABLES = (1.0, 1.0)
NODES_AT_ONCE = 20_000
"""Nodes whose distances to all markers are worked on at once."""


@dataclass(frozen=True, kw_only=True)
class PartSizes:
    """Lengths of the elements' edges, mm, by distance from the nearest contact.

    Attributes
    ----------
    near, middle : SolidSizes
        Within ``near_mm`` of a patch's edge, and from there to ``reach_mm`` from its centre; the
        wall's size grows from the one to the other, and from the corners where tubes meet the
        inner face, ``foot_mm``: their stresses are singular, and coarse tubes stiffen the wall.
        ``middle.contact_mm`` is not used.
    far_mm : float
        On the smeared wall.
    near_mm : float
        Width of the fine ring around a patch.
    reach_mm : float
        Receptors within this chord of a contact's centre are modelled as they are.
    """

    near: SolidSizes
    middle: SolidSizes
    far_mm: float
    near_mm: float
    reach_mm: float

    def scaled(self, factor: float) -> "PartSizes":
        """All sizes of elements times ``factor``; the regions stay."""
        return replace(
            self,
            near=self.near.scaled(factor),
            middle=self.middle.scaled(factor),
            far_mm=self.far_mm * factor,
        )


@dataclass(frozen=True, kw_only=True)
class PartMesh(SolidMesh):
    """Solid mesh of a whole wall with some true receptors.

    Attributes
    ----------
    kept : (k,) int
        Markers that are modelled as they are; ``TIP_j`` and ``tips[j]`` are those of ``kept[j]``.
    modulus_ratio : (E,) float
        Modulus of each element over the material's.
    """

    kept: IntArray
    modulus_ratio: FloatArray


def part_mesh(
    design: Design,
    surface: Surface,
    markers: Markers,
    *,
    contacts_uv: FloatArray,
    radii_mm: FloatArray,
    sizes: PartSizes,
    smear: tuple[float, float] | None = AS_TABLES,
) -> PartMesh:
    """Quadratic tetrahedra of the whole wall, true around contacts and smeared elsewhere.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    contacts_uv : (m, 2) float
        Centres of contacts, chart coordinates.
    radii_mm : (m,) float
        Their radii.
    sizes : PartSizes
        Mesh sizes and regions.
    smear : (float, float) or None
        Factors on the smeared wall's membrane and bending stiffness; None leaves the wall plain
        where receptors are left out.

    Raises
    ------
    DesignError
        If no receptor is within reach.
    MissingPartError, DesignError, NumericalError
        As :func:`mesh.solid_mesh`.
    """
    from phytac_design.solids.cad import shell_cad, write_step

    centres = surface.point(np.asarray(contacts_uv, dtype=np.float64).reshape(-1, 2))
    gap = np.linalg.norm(surface.point(markers.uv)[:, None] - centres, axis=2).min(axis=1)
    kept = np.flatnonzero(gap <= sizes.reach_mm)
    if not len(kept):
        raise DesignError(
            "partial-solid-without-receptor",
            f"no receptor lies within {sizes.reach_mm:g} mm of a contact (nearest: "
            f"{gap.min():.3g} mm); raise reach_mm",
        )
    bare = design.model_copy(update={"wall": design.wall.model_copy(update={"rim_length_mm": 0.0})})
    chosen = subset(markers, kept)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shell.step"
        write_step(shell_cad(Sensor.of(bare, surface, chosen)), path)
        raw = tetrahedra(
            lambda gmsh: gmsh.model.occ.importShapes(str(path)),
            lambda gmsh: _size_fields(gmsh, surface, sizes, design, centres, radii_mm),
            extend=False,
        )
    mesh = with_sets(raw, Sensor.of(design, surface, chosen), receptors=True)
    nodes, modulus = mesh.nodes_mm, np.ones(len(mesh.tets))
    if smear is not None and len(kept) < markers.count:
        wider, softer = smeared(design, surface, markers, kept, nodes, smear)
        foot = surface.point(surface.chart(nodes), -design.wall.thickness_mm / 2.0)
        nodes = foot + wider[:, None] * (nodes - foot)
        modulus = softer[mesh.tets[:, :4]].mean(axis=1)
    return PartMesh(
        nodes_mm=nodes,
        tets=mesh.tets,
        triangles=mesh.triangles,
        sets=mesh.sets,
        outer=mesh.outer,
        tips=mesh.tips,
        kept=kept,
        modulus_ratio=modulus,
    )


def subset(markers: Markers, ids: IntArray) -> Markers:
    """Some markers of a layout, off their lattice and without neighbours."""
    return Markers(
        uv=markers.uv[ids],
        row=markers.row[ids],
        column=markers.column[ids],
        colour=markers.colour[ids],
        height_mm=markers.height_mm[ids],
        base_mm=markers.base_mm[ids],
        tip_mm=markers.tip_mm[ids],
        mid_mm=markers.mid_mm[ids],
        normal=markers.normal[ids],
        direction=markers.direction[ids],
        neighbours=np.full((len(ids), 8), -1),
        lattice=None,
    )


def smeared(
    design: Design,
    surface: Surface,
    markers: Markers,
    kept: IntArray,
    points_mm: FloatArray,
    factors: tuple[float, float] = AS_TABLES,
) -> tuple[FloatArray, FloatArray]:
    """Thickness and modulus over those of the plain wall that stand for left-out receptors.

    Receptors are spread by a normal distribution one cell wide; the factors fade to 1 over half
    a cell between kept and left-out ones.

    Parameters
    ----------
    kept : (k,) int
        Markers that are modelled as they are.
    points_mm : (N, 3) float
        Points of the wall or of a kept tube.
    factors : (float, float)
        On membrane and bending stiffness, beside the tables of :mod:`mechanics.receptors`.

    Returns
    -------
    thickness, modulus : (N,) float
        Ratios.
    """
    thickness, receptor = design.wall.thickness_mm, design.receptor
    membrane, bending = rc.receptor_effect(
        receptor.diameter_outer_mm / thickness,
        receptor.diameter_hole_mm / receptor.diameter_outer_mm,
        markers.height_mm / thickness,
    )
    cell = float(np.sqrt(surface.area_mm2() / markers.count))
    tube = np.pi / 4.0 * receptor.diameter_outer_mm**2
    left = np.setdiff1d(np.arange(markers.count), kept)
    wider, softer = np.ones(len(points_mm)), np.ones(len(points_mm))
    for first in range(0, len(points_mm), NODES_AT_ONCE):
        part = slice(first, first + NODES_AT_ONCE)
        square = np.sum((points_mm[part, None] - markers.mid_mm) ** 2, axis=2)
        near = np.exp(-0.5 * square / cell**2)
        total = near.sum(axis=1)
        share = tube * total / (2.0 * np.pi * cell**2)
        nearest = [np.sqrt(square[:, ids].min(axis=1)) for ids in (kept, left)]
        weight = np.clip((nearest[0] - nearest[1]) / (0.5 * cell) + 0.5, 0.0, 1.0)
        on_m, on_b = (
            (factor * rc.mixture(share, near @ effect / np.maximum(total, 1e-300), mixing))
            ** weight
            for factor, effect, mixing in (
                (factors[0], membrane, rc.MIXING_MEMBRANE),
                (factors[1], bending, rc.MIXING_BENDING),
            )
        )
        wider[part] = np.sqrt(on_b / on_m)
        softer[part] = on_m / wider[part]
    return wider, softer


def _size_fields(
    gmsh: Any,
    surface: Surface,
    sizes: PartSizes,
    design: Design,
    centres: FloatArray,
    radii: FloatArray,
) -> int:
    """Least of: the far size, balls around contacts, and feet and tubes, finer near contacts."""
    field = gmsh.model.mesh.field
    far = sizes.far_mm
    tags = [field.add("MathEval")]
    field.setString(tags[0], "F", repr(far))

    def ball(centre: FloatArray, radius: float, width: float, inside: float) -> None:
        tags.append(field.add("Ball"))
        numbers = (*centre.tolist(), radius, width, inside, far)
        names = ("XCenter", "YCenter", "ZCenter", "Radius", "Thickness", "VIn", "VOut")
        for name, number in zip(names, numbers, strict=True):
            field.setNumber(tags[-1], name, number)

    thickness = design.wall.thickness_mm
    for centre, radius in zip(centres, radii.tolist(), strict=True):
        ball(centre, radius + thickness, 4.0 * thickness, sizes.near.contact_mm)
        ball(centre, radius + sizes.near_mm, sizes.near_mm, sizes.near.wall_mm)
        ball(centre, sizes.reach_mm, sizes.near_mm, sizes.middle.wall_mm)
    tubes = tube_parts(gmsh, surface, design)[1]
    feet = _feet(gmsh, surface, design)
    for rule, close in ((sizes.near, True), (sizes.middle, False)):
        chosen = [
            [tag for tag in part if _close(gmsh, dim, tag, centres, radii, sizes.near_mm) == close]
            for dim, part in ((1, feet), (2, tubes))
        ]
        if chosen[0]:
            distance = field.add("Distance")
            field.setNumbers(distance, "CurvesList", chosen[0])
            field.setNumber(distance, "Sampling", FOOT_SAMPLES)
            tags.append(field.add("Threshold"))
            for name, number in (
                ("InField", distance),
                ("SizeMin", rule.foot_mm),
                ("SizeMax", far),
                ("DistMin", 0.0),
                ("DistMax", (far - rule.foot_mm) / GROWTH),
            ):
                field.setNumber(tags[-1], name, number)
        if chosen[1]:
            tags.append(field.add("Constant"))
            field.setNumbers(tags[-1], "SurfacesList", chosen[1])
            field.setNumber(tags[-1], "VIn", rule.tube_mm)
            field.setNumber(tags[-1], "VOut", far)
    minimum = field.add("Min")
    field.setNumbers(minimum, "FieldsList", tags)
    return int(minimum)


def _feet(gmsh: Any, surface: Surface, design: Design) -> list[int]:
    """Curves where a tube meets the inner face: corners, with their stresses."""
    widest = 1.5 * design.receptor.diameter_outer_mm
    thickness = design.wall.thickness_mm
    curves, points = [], []
    for _, tag in gmsh.model.getEntities(1):
        box = np.array(gmsh.model.getBoundingBox(1, tag)).reshape(2, 3)
        if np.ptp(box, axis=0).max() < widest:
            low, high = gmsh.model.getParametrizationBounds(1, tag)
            at = [low[0] + share * (high[0] - low[0]) for share in (0.25, 0.5, 0.75)]
            curves.append(tag)
            points.append(np.array(gmsh.model.getValue(1, tag, at)).reshape(3, 3))
    flat = np.concatenate(points)
    foot = surface.chart(flat)
    depth = -np.einsum("ni,ni->n", flat - surface.point(foot), surface.normal(foot))
    on_inner = (np.abs(depth - thickness) < ON_INNER * thickness).reshape(-1, 3).all(axis=1)
    return [tag for tag, found in zip(curves, on_inner, strict=True) if found]


def _close(
    gmsh: Any, dim: int, tag: int, centres: FloatArray, radii: FloatArray, near_mm: float
) -> bool:
    """Whether the middle of a curve or face is in the fine ring of a contact."""
    low_high = np.array(gmsh.model.getBoundingBox(dim, tag)).reshape(2, 3)
    gap = np.linalg.norm(centres - low_high.mean(axis=0), axis=1)
    return bool(np.any(gap < radii + near_mm))
