"""From a design and its surface to all of its markers."""

from dataclasses import replace

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.dents import dent_motions
from phytac_design.layout.heights import directions, profile_heights_mm
from phytac_design.layout.lattice import lattice_neighbours, make_lattice, row_counts
from phytac_design.layout.line_of_sight import sight_heights_mm
from phytac_design.layout.markers import Lattice, Markers
from phytac_design.layout.scattered import (
    explicit,
    phyllotaxis,
    sector_neighbours,
    spread_colours,
)
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError


def make_markers(
    design: Design, surface: Surface, *, camera_mm: FloatArray | None = None
) -> Markers:
    """Place every receptor of a design on its surface.

    Markers on parts that do not sense are dropped. ``camera_mm`` is the camera's centre
    (3,), or those of several (c, 3), for ``line-of-sight`` heights; by default those of the design.

    Raises
    ------
    DesignError
        If the layout does not fit the surface, or no marker lies on it.
    """
    in_rows = design.layout.kind in {"spiral", "straight"}
    found = _lattice_markers(design, surface) if in_rows else _scattered(design, surface)
    if design.layout.heights != "line-of-sight" or design.layout.position_heights_mm:
        return found
    centres = _camera_centres_mm(design, surface) if camera_mm is None else camera_mm
    dents = dent_motions(design, surface, found)
    heights = sight_heights_mm(design, found, centres, motions=dents)
    return with_heights(design, surface, found, heights)


def with_heights(
    design: Design, surface: Surface, markers: Markers, height_mm: FloatArray
) -> Markers:
    """Return the same markers with other heights (n,)."""
    if design.receptor.direction == "normal":
        tip = surface.point(markers.uv, -design.wall.thickness_mm - height_mm)
    else:
        tip = markers.base_mm + height_mm[:, None] * markers.direction
    return replace(markers, height_mm=height_mm, tip_mm=tip)


def _camera_centres_mm(design: Design, surface: Surface) -> FloatArray:
    """Centres (c, 3) of the design's cameras."""
    # Imported here: only line-of-sight heights need the cameras.
    from phytac_design.layout.cameras import cameras_of

    return np.stack([camera.position_mm for camera in cameras_of(design, surface)])


def _lattice_markers(design: Design, surface: Surface) -> Markers:
    layout = design.layout
    lattice = make_lattice(design, surface)
    counts = row_counts(design, surface, lattice)
    row = np.repeat(np.arange(layout.rows), counts)
    column = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    (v0, v1) = surface.domain[1]
    v = lattice.phase_v[row] + column * lattice.pitch_v * (layout.columns / counts[row])
    if surface.periodic[1]:
        v = v0 + np.mod(v - v0, v1 - v0)
    uv = np.column_stack([lattice.rows_u[row], v])
    turn = column if layout.colour_pattern == "columns" else column + row
    whole = bool(np.all(counts == layout.columns))
    return _assemble(
        design,
        surface,
        uv=uv,
        row=row,
        column=column,
        colour=turn % len(layout.colours),
        height_mm=profile_heights_mm(design, surface, uv, in_rows=True),
        lattice=lattice if whole else None,
    )


def _inset_mm(design: Design) -> float:
    """How far markers keep from open edges: no tube and no switch reaches into a rim."""
    bowl = design.switch.footprint_diameter_mm if design.has_switches else 0.0
    return max(design.receptor.diameter_tube_mm, bowl) / 2.0


def _scattered(design: Design, surface: Surface) -> Markers:
    layout = design.layout
    if layout.kind == "phyllotaxis":
        uv, order = (
            phyllotaxis(surface, layout.count, inset_mm=_inset_mm(design)),
            np.arange(layout.count),
        )
    else:
        uv, order = explicit(design, surface)
    keep = surface.sensing(uv)
    uv, order = uv[keep], order[keep]
    if layout.position_colours:
        known = list(layout.colours)
        colour = np.array([known.index(layout.position_colours[i]) for i in order], dtype=np.int64)
    else:
        colour = spread_colours(surface.point(uv), len(layout.colours))
    if layout.position_heights_mm:
        heights = np.array(layout.position_heights_mm)[order]
    else:
        heights = profile_heights_mm(design, surface, uv, in_rows=False)
    return _assemble(
        design,
        surface,
        uv=uv,
        row=np.arange(len(uv)),
        column=np.zeros(len(uv), dtype=np.int64),
        colour=colour,
        height_mm=heights,
        lattice=None,
    )


def _assemble(
    design: Design,
    surface: Surface,
    *,
    uv: FloatArray,
    row: IntArray,
    column: IntArray,
    colour: IntArray,
    height_mm: FloatArray,
    lattice: Lattice | None,
) -> Markers:
    """Markers where the surface senses, with their points in space and their neighbours."""
    keep = surface.sensing(uv)
    if not keep.all():
        uv, row, column, colour = uv[keep], row[keep], column[keep], colour[keep]
        height_mm, lattice = height_mm[keep], None
    if len(uv) == 0:
        raise DesignError(
            "no-markers",
            f"no marker lies on a sensing part of the {surface.name}; raise layout.columns (or "
            "layout.count), or let more of its faces sense",
        )
    normal = surface.normal(uv)
    direction = directions(design, surface, uv, normal)
    thickness = design.wall.thickness_mm
    mid = surface.point(uv, -thickness / 2.0)
    if design.receptor.direction == "normal":
        base = surface.point(uv, -thickness)
        tip = surface.point(uv, -thickness - height_mm)
    else:
        # A leaning axis goes through the mesh node and meets the inner face on the way.
        cosine = -np.sum(direction * normal, axis=1)
        base = mid + (thickness / 2.0 / cosine)[:, None] * direction
        tip = base + height_mm[:, None] * direction
    return Markers(
        uv=uv,
        row=row,
        column=column,
        colour=colour,
        height_mm=height_mm,
        base_mm=base,
        tip_mm=tip,
        mid_mm=mid,
        normal=normal,
        direction=direction,
        neighbours=(
            sector_neighbours(surface, uv, normal)
            if lattice is None
            else lattice_neighbours(lattice, periodic=surface.periodic[1])
        ),
        lattice=lattice,
    )
