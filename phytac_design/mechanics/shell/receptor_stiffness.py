r"""Effect of tubes and holes on the stiffness of the wall, as two factors for each element.

A tube and its hole change the wall as a round patch of other stiffness would. Per area fraction f
of tubes, the membrane (E t) and bending (E t³) stiffness of the wall change by the factor

    r(f) = 1 + f e / (1 - s f e),

Mori and Tanaka's (1973) mixture for round inclusions in a plate, where e depends on the receptor
alone and s on the plate. e is tabulated from solid cell models (:mod:`solid.cell`, quadratic
tetrahedra in CalculiX). An element takes f as the share of its own area that tubes cover, so that
coarse meshes smear what fine ones resolve.

Two numbers for each element match both factors exactly: with t' = t √(r_b / r_m) and
E' = E r_m t / t' the element has E' t' = r_m E t and E' t'³ = r_b E t³.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.mechanics.meshing.mesh import R, S, ShellMesh
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import DesignError

MIXING_MEMBRANE, MIXING_BENDING = 0.7, 0.5
"""s of the mixture. In the membrane theory has (1 + ν)/2 for equal and (3 - ν)/4 for unequal
stretching, nearly the same; in bending (1 + ν)/2 and (1 - ν)/4, here one number between them. With
these, cells of area fraction 0.05 … 0.35 give the same e within 6 %."""
DIAMETER_OVER_T = np.array([1.5, 3.0, 6.0, 12.0])
HOLE_OVER_DIAMETER = np.array([0.0, 0.4, 0.6, 0.8])
HEIGHT_OVER_T = np.array([0.0, 0.4, 1.0, 3.0])
"""Axes of the tables: tube diameter and height over the wall's thickness, hole over tube."""
EFFECTS = np.fromstring(
    """
     0.000  0.090  0.094  0.096    0.000  0.421  0.443  0.444
    -0.404 -0.345 -0.345 -0.335   -0.402  0.095  0.136  0.147
    -1.091 -0.982 -0.961 -0.955   -0.972 -0.457 -0.395 -0.382
    -1.986 -1.903 -1.891 -1.887   -1.708 -1.355 -1.319 -1.303

     0.000  0.130  0.141  0.153    0.000  0.686  0.943  0.985
    -0.491 -0.327 -0.302 -0.278   -0.430  0.365  0.713  0.808
    -1.126 -0.942 -0.912 -0.881   -0.964 -0.111  0.240  0.390
    -2.014 -1.860 -1.840 -1.822   -1.672 -0.979 -0.801 -0.644

     0.000  0.156  0.174  0.236    0.000  0.854  1.395  1.717
    -0.499 -0.305 -0.271 -0.168   -0.424  0.537  1.186  1.640
    -1.130 -0.914 -0.875 -0.762   -0.941  0.081  0.835  1.414
    -2.018 -1.823 -1.788 -1.725   -1.640 -0.761  0.013  0.451

     0.000  0.171  0.193  0.310    0.000  0.955  1.653  2.203
    -0.501 -0.290 -0.252 -0.090   -0.419  0.643  1.464  2.150
    -1.131 -0.899 -0.855 -0.676   -0.931  0.189  1.149  1.999
    -2.019 -1.810 -1.760 -1.640   -1.624 -0.665  0.413  1.351
    """,
    sep=" ",
).reshape(4, 4, 2, 4)
"""Rows by diameter, and in each group by hole; columns by height: membrane, then bending."""
EFFECT_MEMBRANE, EFFECT_BENDING = EFFECTS[:, :, 0], EFFECTS[:, :, 1]
"""e by (diameter, hole, height) at ν = 0.38, area fraction 0.12; converged with the mesh to 0.3 %
of a cell's stiffness. ``python -m benchmarks.mechanics_receptors`` makes them. From ν = 0.3
to 0.45 e changes by up to 12 %: a cell's stiffness by 1 %, by 5 % where tubes are very dense."""


@dataclass(frozen=True, kw_only=True)
class ReceptorStiffness:
    """Factors on the wall's stiffness, one for each shell element.

    Attributes
    ----------
    membrane, bending : (E,) float
        On E t and on E t³; 1 where there is no receptor.
    """

    membrane: FloatArray
    bending: FloatArray

    def section(
        self, *, thickness_mm: float | FloatArray, modulus_MPa: float | FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Thickness (mm) and modulus (MPa), (E,) each, that give an element both factors.

        For ``thickness_mm`` and ``modulus_MPa`` of :func:`solve.clamped_model`; the arguments are
        those of the wall without receptors, scalar or (E,).
        """
        wider = np.sqrt(self.bending / self.membrane)
        return np.asarray(thickness_mm * wider), np.asarray(modulus_MPa * self.membrane / wider)


def receptor_effect(
    diameter_over_t: FloatArray | float,
    hole_over_diameter: FloatArray | float,
    height_over_t: FloatArray | float,
) -> tuple[FloatArray, FloatArray]:
    """Effect e of a receptor per area fraction on membrane and bending stiffness.

    Arguments broadcast; monotone cubic interpolation of the tables. Receptors taller than three
    thicknesses count as that: the rest of the tube carries nothing.

    Raises
    ------
    DesignError
        If the tube is thinner or wider, or its hole wider, than the tables go.
    """
    if unknown := _out_of_range(diameter_over_t, hole_over_diameter):
        raise DesignError("receptor-stiffness-range", unknown)
    d, q, h = np.broadcast_arrays(diameter_over_t, hole_over_diameter, height_over_t)
    low, high = DIAMETER_OVER_T[[0, -1]]
    at = _axes(
        np.clip(d, low, high),
        np.clip(q, 0.0, HOLE_OVER_DIAMETER[-1]),
        np.clip(h, 0.0, HEIGHT_OVER_T[-1]),
    )
    # Receptors of a row are alike, and the interpolation takes each point by itself.
    points, alike = np.unique(np.stack(at, axis=-1).reshape(-1, 3), axis=0, return_inverse=True)
    membrane, bending = _tables()(points)[alike].T
    return membrane.reshape(d.shape), bending.reshape(d.shape)


def _out_of_range(
    diameter_over_t: FloatArray | float, hole_over_diameter: FloatArray | float
) -> str:
    """Say which argument of :func:`receptor_effect` lies beyond the tables; "" if none does."""
    for label, value, axis in (
        ("tube diameter over wall thickness", np.asarray(diameter_over_t), DIAMETER_OVER_T),
        ("hole over tube diameter", np.asarray(hole_over_diameter), HOLE_OVER_DIAMETER),
    ):
        if not np.all((value >= axis[0] - 1e-9) & (value <= axis[-1] + 1e-9)):
            got = " … ".join(dict.fromkeys(f"{x:.4g}" for x in (value.min(), value.max())))
            return (
                f"receptor stiffness: {label} is known from {axis[0]:g} to {axis[-1]:g} (got {got})"
                "; change receptor diameters or wall thickness, or leave receptors out: press "
                "--no-receptors, build --set receptors=false"
            )
    return ""


def _axes(d: FloatArray, q: FloatArray, h: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coordinates in which the tables are close to linear."""
    return np.log(d), q * q, 1.0 - np.exp(-2.0 * h)


@cache
def _tables() -> Callable[[FloatArray], FloatArray]:
    """Interpolated effects (n, 2) on membrane and bending stiffness, of :func:`_axes` (n, 3)."""
    from scipy.interpolate import RegularGridInterpolator

    grid = _axes(DIAMETER_OVER_T, HOLE_OVER_DIAMETER, HEIGHT_OVER_T)
    both = np.stack([EFFECT_MEMBRANE, EFFECT_BENDING], axis=-1)
    table: Callable[[FloatArray], FloatArray] = RegularGridInterpolator(grid, both, method="pchip")
    return table


def mixture(share: FloatArray, effect: FloatArray, mixing: float) -> FloatArray:
    """Factor r(f) of a wall with the share f of its area under receptors of effect e."""
    # A wide hole leaves some stiffness, a stout tube stays finite.
    low, high = 0.05, 10.0
    denominator = 1.0 - mixing * share * effect
    with np.errstate(divide="ignore"):
        factor = 1.0 + share * effect / denominator
    return np.where(denominator > 0.0, np.clip(factor, low, high), high)


def tube_cover(
    mesh: ShellMesh, markers: Markers, radius_mm: FloatArray | float
) -> tuple[FloatArray, IntArray]:
    """How far each cell of each element is under a tube, 0 … 1, and its nearest marker, (E, q).

    ``radius_mm`` is that of all tubes, or (n,) of each.
    """
    from scipy.spatial import cKDTree

    cells = 8  # along each side of an element
    side = (np.arange(cells) + 0.5) * 2.0 / cells - 1.0
    r, s = (grid.ravel() for grid in np.meshgrid(side, side))
    h = 0.25 * (1.0 + np.multiply.outer(r, R)) * (1.0 + np.multiply.outer(s, S))
    corner = mesh.nodes_mm[mesh.quads]
    distance, owner = cKDTree(markers.mid_mm).query((h @ corner).reshape(-1, 3))
    shape = (len(corner), len(h))
    area = np.linalg.norm(
        np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1]), axis=1
    )
    # The edge of a tube is smoothed over one cell.
    cell = np.sqrt(area / 2.0)[:, None] / cells
    radius = np.broadcast_to(radius_mm, markers.count)[owner].reshape(shape)
    inside = np.clip((radius - distance.reshape(shape)) / cell + 0.5, 0.0, 1.0)
    return np.asarray(inside), np.asarray(owner.reshape(shape), dtype=np.int64)


def tube_sizes_mm(design: Design, markers: Markers) -> tuple[FloatArray, FloatArray]:
    """Outer diameter and height (n,) of the tubes that stiffen the wall.

    An insert is glued in: its tube, which ends before the coloured band, counts as one piece with
    it. Inserts no longer than the band have no tube and count by themselves.
    """
    receptor, height = design.receptor, markers.height_mm
    outer = np.full(markers.count, receptor.diameter_outer_mm)
    if not receptor.has_inserts:
        return outer, height
    tall = height > receptor.band_marker_mm
    return (
        np.where(tall, receptor.diameter_tube_mm, outer),
        np.where(tall, height - receptor.band_marker_mm, height),
    )


def receptor_stiffness(design: Design, markers: Markers, mesh: ShellMesh) -> ReceptorStiffness:
    """Factors of every element of a shell mesh for the design's tubes and holes.

    Parameters
    ----------
    design : Design
        For the receptor's diameters and the wall.
    markers : Markers
        The receptors: positions and heights.
    mesh : ShellMesh
        Any mesh of the middle face, aligned with the markers or not.

    Raises
    ------
    DesignError
        If the receptors lie beyond the tables (:func:`receptor_effect`).
    """
    thickness, receptor = design.wall.thickness_mm, design.receptor
    diameter, height = tube_sizes_mm(design, markers)
    membrane, bending = receptor_effect(
        diameter / thickness, receptor.diameter_hole_mm / diameter, height / thickness
    )
    inside, owner = tube_cover(mesh, markers, diameter / 2.0)
    total = inside.sum(axis=1)

    def mean(effect: FloatArray) -> FloatArray:
        # By cells, so that an element between two tubes does not hang on which is nearer.
        return np.asarray((inside * effect[owner]).sum(axis=1) / np.maximum(total, 1e-300))

    share = inside.mean(axis=1)
    return ReceptorStiffness(
        membrane=mixture(share, mean(membrane), MIXING_MEMBRANE),
        bending=mixture(share, mean(bending), MIXING_BENDING),
    )


def mean_factors(design: Design, markers: Markers, area_mm2: float) -> tuple[float, float]:
    """Factors on E t and E t³ of a wall that has the mean receptor smeared over its area.

    1 and 1 where the stiffness of the receptors is not known (:func:`unknown_receptors`).
    """
    if unknown_receptors(design):
        return 1.0, 1.0
    thickness = design.wall.thickness_mm
    diameter, height = (float(each.mean()) for each in tube_sizes_mm(design, markers))
    membrane, bending = receptor_effect(
        diameter / thickness, design.receptor.diameter_hole_mm / diameter, height / thickness
    )
    share = np.array(markers.count * np.pi / 4.0 * diameter**2 / area_mm2)
    return (
        float(mixture(share, membrane, MIXING_MEMBRANE)),
        float(mixture(share, bending, MIXING_BENDING)),
    )


def unknown_receptors(design: Design) -> str:
    """Why the stiffness of a design's receptors is not known; "" where it is."""
    thickness, receptor = design.wall.thickness_mm, design.receptor
    diameter = np.array([receptor.diameter_outer_mm, receptor.diameter_tube_mm])
    return _out_of_range(diameter / thickness, receptor.diameter_hole_mm / diameter)


def sensor_model(
    design: Design, markers: Markers, mesh: ShellMesh, *, receptors: bool
) -> ShellModel:
    """Linear model of a design's shell, rims clamped, with or without its tubes and holes.

    Parameters
    ----------
    design, markers : Design, Markers
        Wall, material and receptors.
    mesh : ShellMesh
        Any mesh of the middle face.
    receptors : bool
        Whether the elements have the stiffness of tubes and holes.

    Raises
    ------
    DesignError
        If ``receptors`` is set and they lie beyond the tables (:func:`unknown_receptors`).
    """
    thickness: float | FloatArray = design.wall.thickness_mm
    modulus: float | FloatArray = design.material.modulus_MPa
    if receptors:
        factors = receptor_stiffness(design, markers, mesh)
        thickness, modulus = factors.section(thickness_mm=thickness, modulus_MPa=modulus)
    return clamped_model(
        mesh, thickness_mm=thickness, modulus_MPa=modulus, poisson=design.material.poisson
    )
