"""The simulated sensor's own shell; its meshes are not those of the decoder, nor nested in them."""

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.meshing.local_refinement import thinned_lines
from phytac_design.mechanics.meshing.mesh import ShellMesh, _shell, chart_mesh, plain_mesh
from phytac_design.mechanics.meshing.quad_grid import product_grid
from phytac_design.mechanics.shell.receptor_stiffness import (
    receptor_stiffness,
    unknown_receptors,
)
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_design.simulation.mesh_pair import MeshPair, paired
from phytac_design.simulation.sample_plan import ChartBox
from phytac_design.simulation.sensor_instance import PrintedShell, designed_shell, thickness_factor
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import DesignError, NumericalError

MARGIN = 1.0
"""How far beyond the touched part the mesh stays fine, in √(R t), the length in which bending
decays; twice that gains nothing."""
COARSER_REFINE_MIN = 4
"""Fewest elements a pitch of the coarser of two meshes that motion is extrapolated from. With 3,
the layer beside a clamped rim is not resolved: tips there are further off than without."""


def truth_levels(refine: int) -> tuple[int, int] | None:
    """Elements a pitch of two meshes that linear motion is extrapolated from, the finer first.

    The coarser one has about half as many; None where that is too coarse.
    """
    coarser = max((refine + 1) // 2, COARSER_REFINE_MIN)
    return (refine, coarser) if 2 * refine >= 3 * coarser else None


def truth_shell(
    design: Design, surface: Surface, refine: int, markers: Markers | None = None
) -> tuple[ShellMesh, ShellModel]:
    """Mesh and linear model of the sensor as designed; ``markers`` are its own, if known."""
    markers = markers or make_markers(design, surface)
    mesh = truth_mesh(design, surface, refine, markers)
    return mesh, instance_model(design, surface, designed_shell(surface, markers), mesh)


def truth_mesh(
    design: Design, surface: Surface, refine: int, markers: Markers | None = None
) -> ShellMesh:
    """Mesh of the simulated sensor, blind to the markers.

    On shapes that close around, ``refine`` elements per column around, and along the count that
    makes them about square; on others ``refine`` elements for each side of a marker's cell.
    ``markers`` are the design's, if they are known.
    """
    markers = markers or make_markers(design, surface)
    wall = design.wall.thickness_mm
    if markers.lattice and surface.periodic[1] and not any(surface.poles):
        (u0, u1), (v0, v1) = surface.domain
        around = refine * markers.lattice.columns
        corner = surface.unwrap(np.array([[u0, v0], [u1, v0], [u0, v1]]))
        width = np.abs(corner[2, 0] - corner[0, 0]) / around
        along = max(round(float(np.abs(corner[1, 1] - corner[0, 1]) / width)), 2)
        return chart_mesh(surface, thickness_mm=wall, n_along=along, n_around=around)
    cell = float(np.sqrt(surface.area_mm2() / markers.count))
    return plain_mesh(surface, thickness_mm=wall, size_mm=cell / refine)


def instance_shells(
    design: Design,
    surface: Surface,
    unit: PrintedShell,
    refine: int,
    region: ChartBox | None = None,
    *,
    local: bool = True,
    markers: Markers | None = None,
) -> tuple[tuple[ShellMesh, ShellModel], MeshPair | None]:
    """Mesh and linear model of a sensor instance, and the pair that motion is extrapolated from.

    The wall, the material and the receptors' positions are the instance's own. The wall has its
    receptors' stiffness, as the real one does, wherever that is known.

    Parameters
    ----------
    design, surface : Design, Surface
        The sensor as designed.
    unit : PrintedShell
        How this instance differs.
    refine : int
        As in :func:`truth_mesh`.
    region : ChartBox, optional
        The touched part of the chart. None: all of it.
    local : bool
        Whether meshes are fine in that part alone.
    markers : Markers, optional
        The design's, if they are known.

    Returns
    -------
    (ShellMesh, ShellModel)
        The finer of the pair's.
    MeshPair or None
        None where the coarser mesh would be too coarse (:func:`truth_levels`), too irregular, or
        too much like the finer one.
    """
    markers = markers or make_markers(design, surface)
    whole = truth_mesh(design, surface, refine, markers)
    mesh = local_mesh(design, surface, whole, region) if local and region else whole
    finer = mesh, instance_model(design, surface, unit, mesh)
    levels = truth_levels(refine)
    if levels is None:
        return finer, None
    try:
        coarse_whole = coarse = truth_mesh(design, surface, levels[1], markers)
        if region and mesh is not whole:
            coarse = _thinned(design, surface, coarse, region)
        coarser = coarse, instance_model(design, surface, unit, coarse)
    except (DesignError, NumericalError):
        return finer, None
    # Local meshes have the element sizes of the whole ones in the touched part.
    return finer, paired(finer, coarser, len(whole.quads) / len(coarse_whole.quads))


def instance_model(
    design: Design, surface: Surface, unit: PrintedShell, mesh: ShellMesh
) -> ShellModel:
    """Linear model of a virtual sensor on any mesh of its middle face."""
    thickness: float | FloatArray = design.wall.thickness_mm
    modulus: float | FloatArray = design.material.modulus_MPa * unit.modulus
    if len(unit.wall.waves):
        # Chart coordinates of corners have no mean next to a pole or over a seam; places do.
        centre = surface.chart(mesh.nodes_mm[mesh.quads].mean(axis=1))
        thickness = thickness * thickness_factor(unit.wall, centre)
    else:
        thickness = thickness * unit.wall.mean
    if not unknown_receptors(design):
        factors = receptor_stiffness(design, unit.markers, mesh)
        thickness, modulus = factors.section(thickness_mm=thickness, modulus_MPa=modulus)
    return clamped_model(
        mesh, thickness_mm=thickness, modulus_MPa=modulus, poisson=design.material.poisson
    )


def local_mesh(design: Design, surface: Surface, whole: ShellMesh, region: ChartBox) -> ShellMesh:
    """Mesh as fine as ``whole`` in and around a region and coarser elsewhere.

    ``whole`` itself where that saves little, and around a pole, where no line can be thinned out.
    """
    # A local mesh is taken if it has at most this share of the whole fine one's nodes.
    share_max = 0.85
    if any(surface.poles) or region.whole.all():
        return whole
    mesh = _thinned(design, surface, whole, region)
    worth = len(mesh.nodes_mm) <= share_max * len(whole.nodes_mm)
    return mesh if worth else whole


def _thinned(design: Design, surface: Surface, whole: ShellMesh, region: ChartBox) -> ShellMesh:
    """Mesh with fewer lines away from a region."""
    size = np.sort(np.ptp(surface.bounds_mm(), axis=0))[1] / 2.0
    margin = MARGIN * float(np.sqrt(size * design.wall.thickness_mm))
    lines = []
    for axis in (0, 1):
        fine = np.unique(whole.uv[:, axis])
        if surface.periodic[axis]:
            fine = np.append(fine, surface.domain[axis, 1])
        if not region.whole[axis]:
            part = float(region.low[axis]), float(region.high[axis])
            fine = thinned_lines(surface, axis, fine, part=part, margin_mm=margin)
        lines.append(fine)
    return _shell(surface, product_grid(surface, lines[0], lines[1]), whole.thickness_mm)
