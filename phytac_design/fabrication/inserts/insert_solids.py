r"""Inserts and their sprues as solids for the printer.

Section through an insert and its bar, printed with the bar on the bed::

      bar ______________________
         |______________________|
              |necks|   |
        ______|     |___|______     outer face, z = 0
        \_head_|   hole |______/
            |   |        |   |      barrel
            |   |        |   |
            |___|        |___|      end face: the marker
"""

from itertools import pairwise
from typing import Any

import numpy as np

from phytac_design.design.layout_table import ReceptorSection
from phytac_design.design.spec import Design
from phytac_design.fabrication.inserts.sprue_sizes import (
    NECK_LENGTH_mm,
    SprueSizes,
    sprue_sizes,
)
from phytac_design.fabrication.inserts.sprues import Sprue
from phytac_design.fabrication.molds.labels import label
from phytac_design.geometry.triangles import sides_for, widening
from phytac_design.solids.solid_mesh import extruded_manifold, hull, united
from phytac_shapes.arrays import FloatArray


def insert_profile(receptor: ReceptorSection, length_mm: float) -> FloatArray:
    """Half section (k, 2) of an insert as (r, z), z from the outer face inwards; anticlockwise."""
    outer, hole = receptor.diameter_outer_mm / 2.0, receptor.diameter_hole_mm / 2.0
    head, land = receptor.diameter_head_mm / 2.0, receptor.gap_insert_mm
    return np.array(
        [
            (hole, 0.0),
            (head, 0.0),
            (head, land),
            (outer, land + head - outer),
            (outer, length_mm),
            (hole, length_mm),
        ]
    )


def insert_manifold(
    receptor: ReceptorSection, length_mm: float, *, tolerance_mm: float = 0.01
) -> Any:
    """An insert as a ``manifold3d.Manifold``, its axis along z, its head's top at z = 0."""
    import manifold3d

    profile = insert_profile(receptor, length_mm)
    sides = sides_for(float(profile[:, 0].max()), tolerance_mm)
    section = manifold3d.CrossSection([profile * [widening(sides), 1.0]])
    return manifold3d.Manifold.revolve(section, sides)


def insert_volume_mm3(receptor: ReceptorSection, length_mm: FloatArray) -> FloatArray:
    """Volume of inserts of lengths (n,), exact."""
    outer, hole = receptor.diameter_outer_mm / 2.0, receptor.diameter_hole_mm / 2.0
    head = receptor.diameter_head_mm / 2.0
    brim = (head**2 - outer**2) * receptor.gap_insert_mm
    brim += (head - outer) * (head**2 + head * outer + outer**2) / 3.0
    brim -= outer**2 * (head - outer)
    return np.asarray(np.pi * ((outer**2 - hole**2) * length_mm + brim))


def sprue_volume_mm3(design: Design, sprue: Sprue) -> float:
    """Volume of a sprue without its label, from its sizes alone."""
    receptor, sizes = design.receptor, sprue_sizes(design.receptor, design.print_rules)
    necks = (2 if sizes.arm else 1) * np.pi * sizes.neck**2 / 4.0 * NECK_LENGTH_mm
    bar = float(np.linalg.norm(np.diff(sprue.place_mm, axis=0), axis=1).sum())
    bar += sizes.width / 2.0 + sizes.letter * len(sprue.label)
    section = sizes.thickness * sizes.width
    ends = sizes.thickness * np.pi * sizes.width**2 / 8.0
    inserts = insert_volume_mm3(receptor, sprue.length_mm)
    return float(inserts.sum() + len(inserts) * necks + bar * section + ends)


def sprue_manifold(design: Design, sprue: Sprue, *, tolerance_mm: float = 0.01) -> Any:
    """A sprue with its bar from z = 0 up, its inserts upright above it, its label on the tab."""
    receptor, rules = design.receptor, design.print_rules
    sizes = sprue_sizes(receptor, rules)
    top = sizes.thickness + NECK_LENGTH_mm
    bodies = []
    for place, length, across in zip(
        sprue.place_mm, sprue.length_mm, _across(sprue.place_mm), strict=True
    ):
        body = insert_manifold(receptor, float(length), tolerance_mm=tolerance_mm)
        bodies.append(body.translate((*place, top)))
        # Necks reach a little into both: faces that only touch are no union.
        into = 0.25 * receptor.gap_insert_mm
        for side in (-1.0, 1.0) if sizes.arm else (0.0,):
            foot = place + side * sizes.arm * across
            ring = foot + _circle(sizes.neck / 2.0)
            bodies.append(extruded_manifold(ring, sizes.thickness - into, top + into))
    tab, stroke = sizes.letter * len(sprue.label), max(rules.emboss_min_mm, 0.4)
    bodies += _bar(sprue.place_mm, sizes, tab)
    text = label(sprue.label, tab, stroke, stroke)
    middle = sprue.place_mm[0] - [0.5 * (sizes.width + tab), 0.0]
    bodies.append(text.translate((*middle, sizes.thickness)))
    return united(bodies)


def _circle(radius_mm: float, sides: int = 24) -> FloatArray:
    """Corners (sides, 2) of an equal-area polygon around the origin."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    return radius_mm * widening(sides) * np.column_stack([np.cos(turn), np.sin(turn)])


def _across(place_mm: FloatArray) -> FloatArray:
    """Unit vectors (k, 2) square to the bar at each insert."""
    if len(place_mm) == 1:
        return np.array([[0.0, 1.0]])
    way = np.gradient(place_mm, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return np.column_stack([-way[:, 1], way[:, 0]])


def _bar(place_mm: FloatArray, sizes: SprueSizes, tab_mm: float) -> list[Any]:
    """Bar through the places with a tab of a length before the first, from z = 0 up."""
    levels = np.array([0.0, sizes.thickness])

    def slab(corners: FloatArray) -> Any:
        return hull(
            np.concatenate([np.column_stack([corners, np.full(len(corners), z)]) for z in levels])
        )

    disc = _circle(sizes.width / 2.0, 32)
    bodies = [slab(np.concatenate([a + disc, b + disc])) for a, b in pairwise(place_mm)]
    half, end = sizes.width / 2.0, -sizes.width / 2.0 - tab_mm
    tab = np.array([[end, -half], [0.0, -half], [0.0, half], [end, half]])
    return [*bodies, slab(place_mm[0] + disc), slab(place_mm[0] + tab)]


def plate_manifold(
    design: Design,
    placed: list[tuple[Sprue, FloatArray]],
    *,
    tolerance_mm: float = 0.01,
) -> Any:
    """Sprues of one bed side by side, each at its place (2,) mm."""
    import manifold3d

    bodies = [
        sprue_manifold(design, sprue, tolerance_mm=tolerance_mm).translate((*place, 0.0))
        for sprue, place in placed
    ]
    return manifold3d.Manifold.compose(bodies)
