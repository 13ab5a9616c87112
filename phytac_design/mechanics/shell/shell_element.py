r"""A four-node shell element for thin, curved and warped quadrilaterals, linear, six DOF a node.

Geometry and motion (bilinear h_i, nodal directors d_i, ζ through the thickness)::

    x = Σ h_i (x_i + ζ d_i)          u = Σ h_i (u_i + ζ θ_i × d_i)

Strains are stress-resultant (constant and linear in ζ), in covariant components on the *true*
bilinear middle face, so that every rigid motion of a warped element is exactly free of strain:

- membrane: MITC4+ assumed strains (Ko, Lee, Bathe 2017: edge strains are kept; the term through
  which the warp of a thin quad locks is not), enhanced by the four modes of Simo and Rifai
  (1990) in displacement-gradient form;
- bending: κ_ab = x_a·(θ×d)_b + d_a·u_b, symmetrised;
- transverse shear: MITC4 (Dvorkin, Bathe 1984), factor 5/6;
- drilling: the rotation about the director is tied (Hughes, Brezzi 1989) to the rotation of the
  middle face, with the rotation of the enhanced modes included, so that in-plane bending leaves
  the tie unstretched.

The thickness integral is taken with the metric of the middle face: terms of order (t/R)² are
left out, which makes K = E·(t·K_m + t³·K_b + t·K_s) exact for the element.
"""

from dataclasses import dataclass

import numpy as np

from phytac_design.mechanics.meshing.mesh import R, S
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError

GAUSS = 1.0 / np.sqrt(3.0)
SHEAR_FACTOR = 5.0 / 6.0
DRILLING = 1.0
"""Default stiffness of the drilling tie, in shear moduli."""
CHUNK = 512
"""Elements at a time: few enough that their matrices stay in cache, enough to hide the calls."""
POINTS = GAUSS * np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
"""The four integration points (r, s)."""
TYING = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]])
"""Mid-sides A, B, where strains along r are tied, and C, D, along s."""


@dataclass(frozen=True, kw_only=True)
class ElementStiffness:
    """Element matrices for E = 1 and t = 1: K = E·(t·membrane + t³·bending + t·shear).

    Attributes
    ----------
    membrane, bending, shear : (E, 24, 24) float
        Symmetric, global axes, DOF order per node u_x, u_y, u_z, θ_x, θ_y, θ_z; the drilling tie
        is part of ``membrane``. Units: 1, 1/mm², 1 (translations in mm, rotations in rad).
    """

    membrane: FloatArray
    bending: FloatArray
    shear: FloatArray

    def pick(self, elements: slice | IntArray) -> "ElementStiffness":
        """Those of some of the elements."""
        return ElementStiffness(
            membrane=self.membrane[elements],
            bending=self.bending[elements],
            shear=self.shear[elements],
        )

    def combine(
        self, *, modulus_MPa: float | FloatArray, thickness_mm: float | FloatArray
    ) -> FloatArray:
        """Stiffness (E, 24, 24) for modulus and thickness, scalar or one per element (E,)."""
        E = np.asarray(modulus_MPa, dtype=np.float64)[..., None, None]
        t = np.asarray(thickness_mm, dtype=np.float64)[..., None, None]
        out = self.membrane + self.shear
        out *= E * t
        bend = np.broadcast_to(E * t**3, (len(out), 1, 1))
        for first in range(0, len(out), CHUNK):
            part = slice(first, first + CHUNK)
            out[part] += bend[part] * self.bending[part]
        return np.asarray(out)


def element_stiffness(
    nodes_mm: FloatArray,
    quads: IntArray,
    directors: FloatArray,
    *,
    poisson: complex,
    drilling: float = DRILLING,
) -> ElementStiffness:
    """Stiffness of all elements at once.

    Parameters
    ----------
    nodes_mm : (N, 3) float
        Node positions, mm.
    quads : (E, 4) int
        Corners.
    directors : (N, 3) or (E, 4, 3) float
        Unit normals of the middle face per node, or per element and corner (at creases).
    poisson : float or complex
        Poisson's ratio, 0 <= ν < 0.5 (plane stress); matrices are analytic in it.
    drilling : float
        Stiffness of the drilling tie in shear moduli; 1e-4 … 1 makes no difference.

    Raises
    ------
    NumericalError
        If an element is degenerate (a corner of 180° or more, coincident nodes, not finite).
    """
    X = np.ascontiguousarray(nodes_mm[quads].transpose(1, 2, 0))  # (4, 3, E): elements last
    D = np.ascontiguousarray(
        (directors[quads] if directors.ndim == 2 else directors).transpose(1, 2, 0)
    )
    _refuse_degenerate(X)
    G = 0.5 / (1.0 + poisson)
    root = _root_plane_stress(poisson)
    shape_of_all = (len(quads), 24, 24)
    out = {name: np.zeros(shape_of_all, root.dtype) for name in ("membrane", "bending", "shear")}
    for first in range(0, len(quads), CHUNK):
        part = slice(first, first + CHUNK)
        here = _Points(X[:, :, part], D[:, :, part], root)
        _fill(out["membrane"][part], *_membrane(here, np.sqrt(drilling * G)))
        _fill(out["bending"][part], *_bending(here))
        _fill(out["shear"][part], *_shear(here, np.sqrt(SHEAR_FACTOR * G)))
    return ElementStiffness(**out)


def _fill(out: FloatArray, rows: FloatArray, middle: FloatArray) -> None:
    """Write ZᵀMZ (E, 24, 24) for strain rows Z (k, 24, E) and symmetric M (E, k, k)."""
    Z = np.ascontiguousarray(rows.transpose(2, 0, 1))
    half = np.swapaxes(Z, 1, 2) @ (0.5 * (middle @ Z))
    np.add(half, np.swapaxes(half, 1, 2), out=out)


def _gram(a: FloatArray) -> FloatArray:
    """AᵀA (E, k, k) of A (m, k, E)."""
    first = np.ascontiguousarray(a.transpose(2, 0, 1))
    return np.asarray(np.swapaxes(first, 1, 2) @ first)


def _root_plane_stress(poisson: complex) -> FloatArray:
    """Upper triangular factor L with LᵀL = the plane-stress matrix for E = 1, (3, 3)."""
    a, g = np.sqrt(1.0 - poisson * poisson), np.sqrt(0.5 / (1.0 + poisson))
    return np.array([[1.0 / a, poisson / a, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, g]])


def shape(r: float, s: float) -> tuple[FloatArray, FloatArray]:
    """Bilinear shape functions (4,) and their derivatives (2, 4) at (r, s)."""
    h = 0.25 * (1.0 + r * R) * (1.0 + s * S)
    return h, 0.25 * np.stack([R * (1.0 + s * S), S * (1.0 + r * R)])


def _shapes(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shape functions (p, 4) and their derivatives (2, p, 4) at points (p, 2)."""
    r, s = points.T[:, :, None]
    dh = np.stack([R * (1.0 + s * S), S * (1.0 + r * R)])
    return 0.25 * (1.0 + r * R) * (1.0 + s * S), 0.25 * dh


def _at(weights: FloatArray, corners: FloatArray) -> FloatArray:
    """Sums (…, 3, E) of corner vectors (4, 3, E) with weights (…, 4)."""
    flat = weights.reshape(-1, 4) @ corners.reshape(4, -1)
    return np.asarray(flat.reshape(*weights.shape[:-1], *corners.shape[1:]))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector product along the axis before the last."""
    ax, ay, az = a[..., 0, :], a[..., 1, :], a[..., 2, :]
    bx, by, bz = b[..., 0, :], b[..., 1, :], b[..., 2, :]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-2)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar product along the axis before the last, which stays with length 1."""
    return np.asarray(np.sum(a * b, axis=-2, keepdims=True))


class _Points:
    """Geometry of a chunk of elements at their integration points; elements on the last axis.

    The local axes are those of the centre (e1 along g_r) turned by the least rotation that carries
    its normal to the point's, so that nothing depends on the corner that a numbering starts from.
    """

    def __init__(self, X: FloatArray, D: FloatArray, root: FloatArray) -> None:
        self.X, self.D, self.root = np.ascontiguousarray(X), np.ascontiguousarray(D), root
        self.h, self.dh = _shapes(POINTS)
        centre = _at(shape(0.0, 0.0)[1], self.X)  # (2, 3, E)
        normal = _cross(centre[0], centre[1])
        j0 = np.sqrt(_dot(normal, normal))  # (1, E)
        n0 = normal / j0
        e1 = centre[0] / np.sqrt(_dot(centre[0], centre[0]))
        self.A0 = _inverse_jacobian(centre, e1, _cross(n0, e1))
        self.g = _at(self.dh, self.X)  # (2, p, 3, E)
        normal = _cross(self.g[0], self.g[1])
        self.j = np.sqrt(_dot(normal, normal))  # (p, 1, E)
        self.n = normal / self.j
        self.e1 = e1 - _dot(e1, self.n) / (1.0 + _dot(n0, self.n)) * (n0 + self.n)
        self.e2 = _cross(self.n, self.e1)
        self.A = _inverse_jacobian(self.g, self.e1, self.e2)
        self.weight = np.sqrt(self.j[:, 0])  # (p, E)
        self.ratio = j0 / self.j[:, 0]
        h, dh = _shapes(TYING)
        along = np.stack([dh[0, 0], dh[0, 1], dh[1, 2], dh[1, 3]])
        self.tying = h, along, _at(along, self.X)

    def strain_weights(self) -> FloatArray:
        """From covariant (e_rr, e_ss, 2e_rs) to √(j D)·(ε_11, ε_22, 2ε_12), (3, 3, p, E)."""
        (a, b), (c, d) = self.A
        T = np.stack(
            [a * a, b * b, a * b, c * c, d * d, c * d, 2 * a * c, 2 * b * d, a * d + b * c]
        )
        T *= self.weight
        return np.asarray((self.root @ T.reshape(3, -1)).reshape(3, 3, *a.shape))


def _inverse_jacobian(g: FloatArray, e1: FloatArray, e2: FloatArray) -> FloatArray:
    """A (2, 2, …, E) with ∂/∂x_i = A[i, a] ∂/∂ξ_a in the local axes, from g (2, …, 3, E)."""
    r1, r2, s1, s2 = (_dot(part, e)[..., 0, :] for part in g for e in (e1, e2))
    scale = 1.0 / (r1 * s2 - r2 * s1)
    return np.stack([np.stack([s2, -r2]), np.stack([-s1, r1])]) * scale


def _refuse_degenerate(X: FloatArray) -> None:
    _, dh = _shapes(np.column_stack([R, S]))
    with np.errstate(invalid="ignore"):
        n0 = _cross(*_at(shape(0.0, 0.0)[1], X))
        minimum = _dot(_cross(*_at(dh, X)), n0)[:, 0].min(axis=0)
        bad = ~(minimum > 1e-12 * _dot(n0, n0)[0])
    if np.any(bad):
        where = int(np.argmax(bad))
        raise NumericalError(
            "element-degenerate",
            f"shell element {where} is degenerate ({int(bad.sum())} in all): check the mesh for "
            "coincident nodes, a corner of 180° or more, or a coordinate that is not finite; "
            "corners (mm): "
            f"{np.round(X[:, :, where], 6).tolist()}",
        )


def _rows(u: FloatArray, theta: FloatArray | None = None) -> FloatArray:
    """Rows (k, 24, E) from coefficients of u_i and θ_i, each (k, 4, 3, E)."""
    both = np.stack([u, np.zeros_like(u) if theta is None else theta], axis=2)
    return both.reshape(len(u), 24, -1)


def _membrane(at: _Points, tie: float) -> tuple[FloatArray, FloatArray]:
    """Tying rows A … E and four drilling rows, (9, 24, E); their matrix, modes condensed out.

    ``tie`` is the root of the drilling stiffness.
    """
    _, along, g = at.tying
    count = at.X.shape[2]
    x_r, x_s, x_d = _at(0.25 * np.stack([R, S, R * S]), at.X)
    inner = 0.125 * (R[:, None, None] * x_s + S[:, None, None] * x_r)
    strain = _rows(np.concatenate([along[:, :, None, None] * g[:, None], inner[None]]))
    weights = at.strain_weights()
    modes, turn = _enhanced(at)
    drill, lean = _drilling(at)
    tied = _tie_weights(at) * tie  # (5, p, E)
    part = np.zeros((17, 13, count), np.result_type(weights, tied))
    covariant = _tied_strains(x_r, x_s, x_d)  # (3, p, 5, E)
    part[:12, :5] = np.sum(weights[:, :, :, None] * covariant, axis=1).reshape(12, 5, count)
    part[:12, 9:] = (at.root @ (modes * at.weight[:, None]).reshape(3, -1)).reshape(12, 4, count)
    part[12:, 5:9] = tied
    part[12:, 9:] = np.sum(tied[:, :, None] * (lean[:, None] * turn), axis=1)
    gram = _gram(part)
    coupling = gram[:, 9:, :9]
    middle = gram[:, :9, :9] - np.swapaxes(coupling, 1, 2) @ np.linalg.solve(
        gram[:, 9:, 9:], coupling
    )
    return np.concatenate([strain, drill]), middle


def _tied_strains(x_r: FloatArray, x_s: FloatArray, x_d: FloatArray) -> FloatArray:
    """MITC4+ membrane strains (e_rr, e_ss, 2e_rs) at the points from rows A … E, (3, p, 5, E)."""
    n = _cross(x_r, x_s)
    nn = _dot(n, n)[0]
    c_r = _dot(_cross(x_s, n), x_d)[0] / nn
    c_s = _dot(_cross(n, x_r), x_d)[0] / nn
    d = 2.0 * (c_r**2 + c_s**2 - 1.0)  # negative for every convex quad
    # The coefficient of the bilinear term, x_d·u_d, of a flat quad.
    parts = (c_r * (c_r - 1.0), c_r * (c_r + 1.0), c_s * (c_s - 1.0), c_s * (c_s + 1.0))
    bilinear = np.stack([*parts, 4.0 * c_r * c_s]) / d  # (5, E)
    r, s = POINTS.T
    none, one = np.zeros(4), np.ones(4)
    plain = np.array(
        [
            [0.5 * (1.0 + s), 0.5 * (1.0 - s), none, none, none],
            [none, none, 0.5 * (1.0 + r), 0.5 * (1.0 - r), none],
            [0.5 * r, -0.5 * r, 0.5 * s, -0.5 * s, 2.0 * one],
        ]
    ).transpose(0, 2, 1)
    share = np.stack([s * s - 1.0, r * r - 1.0, 2.0 * r * s])
    return np.asarray(plain[..., None] + share[:, :, None, None] * bilinear)


def _enhanced(at: _Points) -> tuple[FloatArray, FloatArray]:
    """Enhanced strain (3, p, 4, E), rotation (p, 4, E) of modes û_1(r²), û_1(s²), û_2, û_2."""
    r, s = POINTS.T[:, :, None]
    a_r, a_s = (c * at.ratio * at.A0[:, k, None] for k, c in enumerate((r, s)))  # (2, p, E)
    none = np.zeros_like(a_r[0])
    strain = [
        np.stack([a_r[0], a_s[0], none, none], axis=1),
        np.stack([none, none, a_r[1], a_s[1]], axis=1),
        np.stack([a_r[1], a_s[1], a_r[0], a_s[0]], axis=1),
    ]
    return np.stack(strain), np.stack([-a_r[1], -a_s[1], a_r[0], a_s[0]], axis=1) / 2.0


def _drilling(at: _Points) -> tuple[FloatArray, FloatArray]:
    """Rows (p, 24, E), rotation of the face about the director minus Σ h_i d_i·θ_i; d·n (p, E)."""
    d = _at(at.h, at.D)  # (p, 3, E)
    d1, d2, dn = (_dot(d, e)[:, None] for e in (at.e1, at.e2, at.n))  # (p, 1, 1, E)
    slope = at.dh[..., None]  # (2, p, 4, 1)
    h_1, h_2 = (
        (a[:, None] * slope[0] + b[:, None] * slope[1])[:, :, None] for a, b in at.A
    )  # local Cartesian derivatives, (p, 4, 1, E)
    row = dn * (0.5 * h_1) * at.e2[:, None] - dn * (0.5 * h_2) * at.e1[:, None]
    row += (d1 * h_2 - d2 * h_1) * at.n[:, None]
    return _rows(row, -at.h[:, :, None, None] * at.D), dn[:, 0, 0]


def _tie_weights(at: _Points) -> FloatArray:
    """Mean of the tie over each element at full strength, its variation at a small one (5, p, E).

    One tie for each element meets one drilling rotation for each node, so the nodes can satisfy
    them all and the tie stores no energy, however stiff. The variation only keeps the pattern of
    alternating drilling rotations from being free.
    """
    j = at.weight**2
    mean = j / np.sqrt(np.sum(j, axis=0))
    each = np.sqrt(1e-3) * np.eye(4)[:, :, None] * at.weight
    return np.concatenate([mean[None], each])


def _bending(at: _Points) -> tuple[FloatArray, FloatArray]:
    """Rows (8, 24, E), κ_rr at two s, κ_ss at two r and 2κ_rs at the points; their matrix."""
    d = _at(at.dh, at.D)  # (2, p, 3, E)

    def kappa(a: int, b: int, points: list[int]) -> tuple[FloatArray, FloatArray]:
        slope = at.dh[b, points][:, :, None, None]
        return slope * d[a, points][:, None], slope * _cross(at.D, at.g[a, points][:, None])

    every = [0, 1, 2, 3]
    twice = [p + q for p, q in zip(kappa(0, 1, every), kappa(1, 0, every), strict=True)]
    rr, ss = kappa(0, 0, [0, 1]), kappa(1, 1, [0, 2])
    rows = [_rows(*pair) for pair in (rr, ss, twice)]
    weights = at.strain_weights() / np.sqrt(12.0)  # (3, 3, p, E)
    part = np.zeros((3, 4, 8, weights.shape[-1]), weights.dtype)
    part[:, [0, 2], 0] = weights[:, 0, [0, 2]]
    part[:, [1, 3], 1] = weights[:, 0, [1, 3]]
    part[:, [0, 1], 2] = weights[:, 1, [0, 1]]
    part[:, [2, 3], 3] = weights[:, 1, [2, 3]]
    part[:, every, [4, 5, 6, 7]] = weights[:, 2]
    return np.concatenate(rows), _gram(part.reshape(12, 8, -1))


def _shear(at: _Points, root: float) -> tuple[FloatArray, FloatArray]:
    """MITC4 rows (4, 24, E) at the tying points and their matrix; ``root`` of the shear modulus."""
    h, along, g = at.tying
    d = _at(h, at.D)
    rows = _rows(
        along[:, :, None, None] * d[:, None],
        h[:, :, None, None] * _cross(at.D, g[:, None]),
    )
    r, s = POINTS.T[:, :, None]
    half = 0.5 * root * at.weight
    (a, b), (c, e) = at.A
    part = np.stack(
        [
            np.stack(
                [
                    x * half * (1.0 + s),
                    x * half * (1.0 - s),
                    y * half * (1.0 + r),
                    y * half * (1.0 - r),
                ],
                axis=1,
            )
            for x, y in ((a, b), (c, e))
        ]
    )  # (2, p, 4, E)
    return rows, _gram(part.reshape(8, 4, -1))
