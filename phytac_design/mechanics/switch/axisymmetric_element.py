"""Nine-node quadrilaterals of a solid of revolution under large displacements, mixed u–p.

Displacements are biquadratic, the pressure κ Π(J − 1) is linear in each element and discontinuous
(Q2/P₋₁, inf-sup stable): the projection Π is worked out in the element, so that only displacements
remain, and the tangent is exact and symmetric. Tangents of motions cos nθ, sin nθ about the
axisymmetric state share geometry and material with those of n = 0.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Shape functions at the 3 × 3 Gauss points of all elements, in the undeformed body.

    Attributes
    ----------
    slope : (E, 9, 2, 9) float
        ∂N/∂r and ∂N/∂z of the nine nodes, per element and Gauss point, 1/mm.
    hoop : (E, 9, 9) float
        N / r, 1/mm.
    weight_mm3 : (E, 9) float
        2 π r times the area of each Gauss point.
    linear : (9, 3) float
        Pressure functions 1, ξ, η.
    mass_inverse : (E, 3, 3) float
        Inverse of ∫ of their products.
    """

    slope: FloatArray
    hoop: FloatArray
    weight_mm3: FloatArray
    linear: FloatArray
    mass_inverse: FloatArray


def _lagrange(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Quadratic functions of nodes −1, 0, 1 and their slopes at points x, (m, 3) each."""
    value = np.stack([0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0)], axis=1)
    slope = np.stack([x - 0.5, -2.0 * x, x + 0.5], axis=1)
    return value, slope


def geometry(nodes_mm: FloatArray, quads: IntArray) -> Geometry:
    """Geometry of elements; local node 3 i + j is the i-th along ξ and the j-th along η.

    Parameters
    ----------
    nodes_mm : (N, 2) float
        r and z.
    quads : (E, 9) int
        Nodes of the elements.

    Raises
    ------
    NumericalError
        If an element is folded or reaches beyond the axis.
    """
    gauss, part = np.polynomial.legendre.leggauss(3)
    value, slope = _lagrange(gauss)
    # Gauss point 3 a + b, node 3 i + j
    shape = np.einsum("ai,bj->abij", value, value).reshape(9, 9)
    along = np.einsum("ai,bj->abij", slope, value).reshape(9, 9)
    across = np.einsum("ai,bj->abij", value, slope).reshape(9, 9)
    local = np.stack([along, across])
    corner = nodes_mm[quads]
    jacobian = np.einsum("dgk,ekc->egdc", local, corner)
    area = np.linalg.det(jacobian)
    radius = np.einsum("gk,ek->eg", shape, corner[..., 0])
    if not (area > 0.0).all() or not (radius > 0.0).all():
        worst = int(np.argmin(np.minimum(area, radius).min(axis=1)))
        raise NumericalError(
            "switch-element-folded",
            f"element {worst} of the switch's mesh is folded or reaches beyond the axis (got "
            f"Jacobian {area[worst].min():.3g}); ask for a less extreme shape",
        )
    gradient = np.einsum("egcd,dgk->egck", np.linalg.inv(jacobian), local)
    weight = 2.0 * np.pi * radius * area * np.outer(part, part).ravel()
    xi, eta = (a.ravel() for a in np.meshgrid(gauss, gauss, indexing="ij"))
    linear = np.stack([np.ones(9), xi, eta], axis=1)
    mass = np.einsum("eg,ga,gb->eab", weight, linear, linear)
    return Geometry(
        slope=gradient,
        hoop=shape / radius[..., None],
        weight_mm3=weight,
        linear=linear,
        mass_inverse=np.linalg.inv(mass),
    )


def strain_operator(shape: Geometry, mode: int = 0) -> FloatArray:
    """Displacement gradients rr, rz, zr, zz, θθ by the element's DOFs, (E, 9, 5, 18 or 27).

    DOFs are u_r of the nine nodes, then u_z, and for ``mode`` > 0 u_θ: motions (u_r cos nθ,
    u_z cos nθ, u_θ sin nθ).
    """
    count = len(shape.hoop)
    B = np.zeros((count, 9, 5, 27 if mode else 18))
    B[:, :, 0:2, :9] = shape.slope
    B[:, :, 2:4, 9:18] = shape.slope
    B[:, :, 4, :9] = shape.hoop
    if mode:
        B[:, :, 4, 18:] = mode * shape.hoop
    return B


def shear_operator(shape: Geometry, mode: int) -> FloatArray:
    """Displacement gradients rθ, θr, zθ, θz (times sin nθ) by the element's DOFs, (E, 9, 4, 27)."""
    B = np.zeros((len(shape.hoop), 9, 4, 27))
    B[:, :, 0, :9] = -mode * shape.hoop
    B[:, :, 0, 18:] = -shape.hoop
    B[:, :, 1, 18:] = shape.slope[:, :, 0]
    B[:, :, 2, 9:18] = -mode * shape.hoop
    B[:, :, 3, 18:] = shape.slope[:, :, 1]
    return B


@dataclass(frozen=True, kw_only=True)
class ElementResponse:
    """Stress and stiffness at the Gauss points of all elements.

    Attributes
    ----------
    stretch : (E, 9, 3) float
        Principal stretches: two in the meridian plane, then the hoop.
    energy_Nmm : float
        Stored energy of the whole body.
    stress : (E, 9, 5) float
        First Piola–Kirchhoff stress rr, rz, zr, zz, θθ, MPa.
    stiffness : (E, 9, 5, 5) float
        Its slope by those displacement gradients at constant pressure.
    cofactor : (E, 9, 5) float
        ∂J/∂F.
    slopes : tuple
        ∂W/∂λᵢ (E, 9, 3) and ∂²W/∂λᵢ∂λⱼ (E, 9, 3, 3), MPa, pressure included.
    directions : tuple
        Principal directions in the meridian plane after and before, (E, 9, 2, 2) by rows.
    """

    stretch: FloatArray
    energy_Nmm: float
    stress: FloatArray
    stiffness: FloatArray
    cofactor: FloatArray
    slopes: tuple[FloatArray, FloatArray]
    directions: tuple[FloatArray, FloatArray]

    @cached_property
    def stiffness_shear(self) -> FloatArray:
        """Stiffness (E, 9, 4, 4) of rθ, θr, zθ, θz: only waves around the axis need it."""
        return _out_of_plane(self.stretch, *self.slopes, *self.directions)


def _principal(gradient: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stretches (…, 3), and the principal directions after and before, (…, 2, 2) by rows."""
    rr, rz, zr, zz = (gradient[..., k] for k in range(4))
    rr, zz = rr + 1.0, zz + 1.0
    mean, half = 0.5 * (rr + zz), 0.5 * (rr - zz)
    same, skew = 0.5 * (zr + rz), 0.5 * (zr - rz)
    big, small = np.hypot(mean, skew), np.hypot(half, same)
    turn, split = np.arctan2(skew, mean), np.arctan2(same, half)
    after, before = 0.5 * (turn + split), 0.5 * (turn - split)
    stretch = np.stack([big + small, big - small, 1.0 + gradient[..., 4]], axis=-1)
    c, s = np.cos(after), np.sin(after)
    n = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
    c, s = np.cos(before), np.sin(before)
    N = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return stretch, n, N


def respond(shape: Geometry, material: Material, gradient: FloatArray) -> ElementResponse | None:
    """Stress and stiffness at displacement gradients (E, 9, 5); None where one turns inside out."""
    stretch, n, N = _principal(gradient)
    if not (np.isfinite(stretch).all() and (stretch > 0.0).all()):
        return None
    energy, first, second = material.derivatives(stretch)
    volume = stretch.prod(axis=-1)
    cofactor = volume[..., None] / stretch
    stored = float(np.sum(shape.weight_mm3 * energy))
    if material.bulk_MPa:
        swell = np.einsum("eg,ga,eg->ea", shape.weight_mm3, shape.linear, volume - 1.0)
        spread = np.einsum("eab,eb->ea", shape.mass_inverse, swell)
        pressure = material.bulk_MPa * spread @ shape.linear.T
        stored += 0.5 * material.bulk_MPa * float(np.sum(spread * swell))
        first = first + pressure[..., None] * cofactor
        mixed = (pressure * volume)[..., None, None] / (
            stretch[..., :, None] * stretch[..., None, :]
        )
        np.einsum("...ii->...i", mixed)[...] = 0.0
        second = second + mixed
    dyad = np.einsum("...ia,...jb->...ijab", n, N).reshape(*n.shape[:-2], 4, 4)
    stress, stiffness = _in_plane(first, second, _pair(stretch, first, second, 0, 1), dyad, stretch)
    cof = np.empty_like(gradient)
    cof[..., :4] = np.einsum("...i,...ik->...k", cofactor[..., :2], dyad[..., [0, 3], :])
    cof[..., 4] = cofactor[..., 2]
    return ElementResponse(
        stretch=stretch,
        energy_Nmm=stored,
        stress=stress,
        stiffness=stiffness,
        cofactor=cof,
        slopes=(first, second),
        directions=(n, N),
    )


def _pair(
    stretch: FloatArray, first: FloatArray, second: FloatArray, i: int, j: int
) -> tuple[FloatArray, FloatArray]:
    """A_ijij and A_ijji of principal directions i ≠ j (Ogden 1997), also where they coincide."""
    gap = stretch[..., i] - stretch[..., j]
    # Closer stretches take the limit of divided differences: both errors are then near 1e-10.
    near = np.abs(gap) < 1e-5
    limit = 0.5 * (second[..., i, i] + second[..., j, j]) - second[..., i, j]
    apart = np.where(near, limit, (first[..., i] - first[..., j]) / np.where(near, 1.0, gap))
    joint = (first[..., i] + first[..., j]) / (stretch[..., i] + stretch[..., j])
    return 0.5 * (apart + joint), 0.5 * (apart - joint)


def _in_plane(
    first: FloatArray,
    second: FloatArray,
    pair: tuple[FloatArray, FloatArray],
    dyad: FloatArray,
    stretch: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    stress = np.empty((*stretch.shape[:-1], 5))
    stress[..., :4] = np.einsum("...i,...ik->...k", first[..., :2], dyad[..., [0, 3], :])
    stress[..., 4] = first[..., 2]
    # Principal components 11, 12, 21, 22, 33
    local = np.zeros((*stretch.shape[:-1], 5, 5))
    normal = np.array([0, 3, 4])
    local[..., normal[:, None], normal] = second
    local[..., 1, 1] = local[..., 2, 2] = pair[0]
    local[..., 1, 2] = local[..., 2, 1] = pair[1]
    turn = np.zeros_like(local)
    turn[..., :4, :4] = dyad
    turn[..., 4, 4] = 1.0
    return stress, np.swapaxes(turn, -1, -2) @ local @ turn


def _out_of_plane(
    stretch: FloatArray, first: FloatArray, second: FloatArray, n: FloatArray, N: FloatArray
) -> FloatArray:
    out = np.zeros((*stretch.shape[:-1], 4, 4))
    for i in range(2):
        same, cross = _pair(stretch, first, second, i, 2)
        # Row of H_iθ and of H_θi in rθ, θr, zθ, θz
        turn = np.zeros((*stretch.shape[:-1], 2, 4))
        turn[..., 0, 0], turn[..., 0, 2] = n[..., i, 0], n[..., i, 1]
        turn[..., 1, 1], turn[..., 1, 3] = N[..., i, 0], N[..., i, 1]
        local = np.stack([np.stack([same, cross], -1), np.stack([cross, same], -1)], -2)
        out += np.swapaxes(turn, -1, -2) @ local @ turn
    return out


def force_and_stiffness(
    shape: Geometry, material: Material, B: FloatArray, moved: FloatArray
) -> tuple[FloatArray, FloatArray, ElementResponse] | None:
    """Inner forces (E, 18), tangents (E, 18, 18) and response at DOFs (E, 18).

    None where an element turns inside out.
    """
    response = respond(shape, material, np.einsum("egck,ek->egc", B, moved))
    if response is None:
        return None
    weighted = shape.weight_mm3[..., None] * response.stress
    force = np.einsum("egck,egc->ek", B, weighted)
    return force, tangent(shape, material, B, response), response


def tangent(
    shape: Geometry, material: Material, B: FloatArray, response: ElementResponse
) -> FloatArray:
    """Tangents (E, k, k) of the in-plane gradients that ``B`` (E, 9, 5, k) gives."""
    count, _, _, size = B.shape
    weighted = shape.weight_mm3[..., None, None] * (response.stiffness @ B)
    flat = B.reshape(count, 45, size)
    K = np.swapaxes(flat, 1, 2) @ weighted.reshape(count, 45, size)
    if material.bulk_MPa:
        volume = shape.weight_mm3[..., None] * np.einsum("egc,egck->egk", response.cofactor, B)
        spread = np.einsum("ga,egk->eak", shape.linear, volume)
        K += material.bulk_MPa * np.swapaxes(spread, 1, 2) @ (shape.mass_inverse @ spread)
    return np.asarray(K)


def shear_tangent(shape: Geometry, B: FloatArray, response: ElementResponse) -> FloatArray:
    """Tangents (E, 27, 27) of the gradients that ``shear_operator`` gives."""
    count, _, _, size = B.shape
    weighted = shape.weight_mm3[..., None, None] * (response.stiffness_shear @ B)
    flat = B.reshape(count, 36, size)
    return np.asarray(np.swapaxes(flat, 1, 2) @ weighted.reshape(count, 36, size))
