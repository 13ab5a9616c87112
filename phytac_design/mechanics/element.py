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

from shapes.arrays import FloatArray, IntArray
from shapes.errors import NumericalError

R = np.array([-1.0, 1.0, 1.0, -1.0])
S = np.array([-1.0, -1.0, 1.0, 1.0])
GAUSS = 1.0 / np.sqrt(3.0)
SHEAR_FACTOR = 5.0 / 6.0
DRILLING = 1.0
"""Default stiffness of the drilling tie, in shear moduli."""
DRILLING_VARIATION = 1e-3
"""Share of that stiffness against variations of the tie within an element (see ``_tie_rows``)."""
FLAT_TOL = 1e-12
"""Smallest Jacobian at a corner, as a fraction of the element's mean, that still counts."""


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

    def combine(
        self, *, modulus_MPa: float | FloatArray, thickness_mm: float | FloatArray
    ) -> FloatArray:
        """Stiffness (E, 24, 24) for modulus and thickness, scalar or one per element (E,)."""
        E = np.asarray(modulus_MPa, dtype=np.float64)[..., None, None]
        t = np.asarray(thickness_mm, dtype=np.float64)[..., None, None]
        return np.asarray(E * (t * (self.membrane + self.shear) + t**3 * self.bending))


def element_stiffness(
    nodes_mm: FloatArray,
    quads: IntArray,
    directors: FloatArray,
    *,
    poisson: float,
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
    poisson : float
        Poisson's ratio, 0 <= ν < 0.5 (plane stress).
    drilling : float
        Stiffness of the drilling tie in shear moduli; 1e-4 … 1 makes no difference.

    Raises
    ------
    NumericalError
        If an element is degenerate (a corner of 180° or more, coincident nodes, not finite).
    """
    X = nodes_mm[quads]
    D = directors[quads] if directors.ndim == 2 else directors
    frame0, j0 = _frame(X, 0.0, 0.0, None)
    _refuse_degenerate(X, frame0[:, 2], j0)
    A0 = _inverse_jacobian(X, frame0, 0.0, 0.0)
    tying = _tying(X, D)
    rows: dict[str, list[FloatArray]] = {"m": [], "b": [], "s": [], "d": [], "em": [], "ed": []}
    weights: list[FloatArray] = []
    for r in (-GAUSS, GAUSS):
        for s in (-GAUSS, GAUSS):
            frame, j = _frame(X, r, s, frame0)
            A = _inverse_jacobian(X, frame, r, s)
            T = _plane_transform(A)
            w = np.sqrt(j)[:, None, None]
            rows["m"].append(w * (T @ _membrane(tying, r, s)))
            rows["b"].append(w * (T @ _bending(X, D, r, s)))
            rows["s"].append(w * (A @ _shear(tying, r, s)))
            enhanced_m, enhanced_d = _enhanced(A0, (j0 / j)[:, None], r, s)
            drill, lean = _drilling(D, frame, A, r, s)
            rows["em"].append(w * enhanced_m)
            rows["d"].append(w * drill)
            rows["ed"].append(w * (lean[:, None, None] * enhanced_d))
            weights.append(w[:, :, 0])
    G = 0.5 / (1.0 + poisson)
    root = _root_plane_stress(poisson)
    stacked = {key: np.stack(part, axis=1) for key, part in rows.items()}  # (E, 4, k, 24 or 4)
    tie_u, tie_a = (np.sqrt(drilling * G) * _tie_rows(stacked[k], weights) for k in ("d", "ed"))
    u_part = np.concatenate([_flat(root @ stacked["m"]), tie_u], axis=1)
    a_part = np.concatenate([_flat(root @ stacked["em"]), tie_a], axis=1)
    coupling = _gram(a_part, u_part)
    enhanced = np.linalg.solve(_gram(a_part, a_part), coupling)
    membrane = _gram(u_part, u_part) - np.swapaxes(coupling, 1, 2) @ enhanced
    bend = _flat(root @ stacked["b"]) / np.sqrt(12.0)
    shear = _flat(stacked["s"]) * np.sqrt(SHEAR_FACTOR * G)
    return ElementStiffness(
        membrane=(membrane + np.swapaxes(membrane, 1, 2)) / 2.0,
        bending=_gram(bend, bend),
        shear=_gram(shear, shear),
    )


def _flat(rows: FloatArray) -> FloatArray:
    return rows.reshape(len(rows), -1, rows.shape[-1])


def _gram(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(a, 1, 2) @ b)


def _tie_rows(rows: FloatArray, weights: list[FloatArray]) -> FloatArray:
    """Mean of the tie over each element at full strength, its variation at a small one.

    One tie for each element meets one drilling rotation for each node, so the nodes can satisfy
    them all and the tie stores no energy, however stiff. The variation only keeps the pattern of
    alternating drilling rotations from being free. ``rows`` (E, 4, 1, k) carry √j already.
    """
    w = np.stack(weights, axis=1)[:, :, :, None]  # (E, 4, 1, 1), √j
    mean = np.sum(w * rows, axis=1) / np.sqrt(np.sum(w * w, axis=1))  # (E, 1, k)
    return np.concatenate([mean, np.sqrt(DRILLING_VARIATION) * _flat(rows)], axis=1)


def _root_plane_stress(poisson: float) -> FloatArray:
    """Upper triangular factor L with LᵀL = the plane-stress matrix for E = 1, (3, 3)."""
    v = poisson
    D = np.array([[1.0, v, 0.0], [v, 1.0, 0.0], [0.0, 0.0, (1.0 - v) / 2.0]]) / (1.0 - v * v)
    return np.asarray(np.linalg.cholesky(D).T)


def shape(r: float, s: float) -> tuple[FloatArray, FloatArray]:
    """Bilinear shape functions (4,) and their derivatives (2, 4) at (r, s)."""
    h = 0.25 * (1.0 + r * R) * (1.0 + s * S)
    return h, 0.25 * np.stack([R * (1.0 + s * S), S * (1.0 + r * R)])


def _frame(
    X: FloatArray, r: float, s: float, start: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Local axes (E, 3, 3), rows e1, e2, n, and Jacobian (E,).

    The axes are those of ``start`` turned by the least rotation that carries its normal here, so
    that nothing depends on the corner that an element's numbering starts from; without ``start``
    e1 follows g_r.
    """
    g = np.einsum("ai,eik->eak", shape(r, s)[1], X)
    normal = np.cross(g[:, 0], g[:, 1])
    j = np.linalg.norm(normal, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        n = normal / j[:, None]
        if start is None:
            e1 = g[:, 0] / np.linalg.norm(g[:, 0], axis=1)[:, None]
        else:
            e1, n0 = start[:, 0], start[:, 2]
            lean = np.sum(e1 * n, axis=1) / (1.0 + np.sum(n0 * n, axis=1))
            e1 = e1 - lean[:, None] * (n0 + n)
    return np.stack([e1, np.cross(n, e1), n], axis=1), j


def _inverse_jacobian(X: FloatArray, frame: FloatArray, r: float, s: float) -> FloatArray:
    """A (E, 2, 2) with ∂/∂x_i = A[i, a] ∂/∂ξ_a in the local axes."""
    g = np.einsum("ai,eik->eak", shape(r, s)[1], X)
    J = np.einsum("eak,eik->eai", g, frame[:, :2])
    return np.asarray(np.linalg.inv(J))


def _refuse_degenerate(X: FloatArray, n0: FloatArray, j0: FloatArray) -> None:
    corner = np.stack(
        [np.cross(*np.einsum("ai,eik->aek", shape(r, s)[1], X)) for r, s in zip(R, S, strict=True)],
        axis=1,
    )
    least = np.einsum("eck,ek->ec", corner, n0).min(axis=1)
    bad = ~(least > FLAT_TOL * j0)
    if np.any(bad):
        where = int(np.argmax(bad))
        raise NumericalError(
            f"shell element {where} is degenerate ({int(bad.sum())} in all): coincident nodes, a "
            f"corner of 180° or more, or a coordinate that is not finite; corners (mm): "
            f"{np.round(X[where], 6).tolist()}"
        )


def _plane_transform(A: FloatArray) -> FloatArray:
    """Covariant (e_rr, e_ss, 2e_rs) to local (ε_11, ε_22, 2ε_12), (E, 3, 3)."""
    a, b, c, d = A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1]
    rows = [[a * a, b * b, a * b], [c * c, d * d, c * d], [2 * a * c, 2 * b * d, a * d + b * c]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def _both(u: FloatArray, theta: FloatArray) -> FloatArray:
    """One row (E, 24) from coefficients of u_i and θ_i, each (E, 4, 3)."""
    return np.concatenate([u, theta], axis=2).reshape(len(u), 24)


def _tying(X: FloatArray, D: FloatArray) -> dict[str, FloatArray]:
    """Strain rows (E, 24) at the tying points, and the in-plane distortion (c_r, c_s)."""
    out: dict[str, FloatArray] = {}
    none = np.zeros_like(X)
    for name, r, s in (("A", 0.0, 1.0), ("B", 0.0, -1.0), ("C", 1.0, 0.0), ("D", -1.0, 0.0)):
        h, dh = shape(r, s)
        k = 0 if name in "AB" else 1
        g = np.einsum("i,eik->ek", dh[k], X)[:, None]
        d = np.einsum("i,eik->ek", h, D)[:, None]
        out["m" + name] = _both(dh[k][:, None] * g, none)
        out["s" + name] = _both(dh[k][:, None] * d, h[:, None] * np.cross(D, g))
    x_r, x_s, x_d = (0.25 * np.einsum("i,eik->ek", c, X) for c in (R, S, R * S))
    both = 0.125 * (R[:, None] * x_s[:, None] + S[:, None] * x_r[:, None])
    out["mE"] = _both(both, none)
    n = np.cross(x_r, x_s)
    nn = np.sum(n * n, axis=1)
    out["c_r"] = np.sum(np.cross(x_s, n) * x_d, axis=1) / nn
    out["c_s"] = np.sum(np.cross(n, x_r) * x_d, axis=1) / nn
    return out


def _membrane(tying: dict[str, FloatArray], r: float, s: float) -> FloatArray:
    """MITC4+ membrane rows (e_rr, e_ss, 2e_rs), (E, 3, 24)."""
    c_r, c_s = tying["c_r"][:, None], tying["c_s"][:, None]
    A, B, C, D, E = (tying["m" + name] for name in "ABCDE")
    d = c_r**2 + c_s**2 - 1.0  # negative for every convex quad
    a_A, a_B = c_r * (c_r - 1.0) / (2.0 * d), c_r * (c_r + 1.0) / (2.0 * d)
    a_C, a_D = c_s * (c_s - 1.0) / (2.0 * d), c_s * (c_s + 1.0) / (2.0 * d)
    # The coefficient of the bilinear term, x_d·u_d, of a flat quad.
    bilinear = a_A * A + a_B * B + a_C * C + a_D * D + 2.0 * c_r * c_s / d * E
    e_rr = 0.5 * (1.0 + s) * A + 0.5 * (1.0 - s) * B + (s * s - 1.0) * bilinear
    e_ss = 0.5 * (1.0 + r) * C + 0.5 * (1.0 - r) * D + (r * r - 1.0) * bilinear
    e_rs = E + 0.25 * r * (A - B) + 0.25 * s * (C - D) + r * s * bilinear
    return np.stack([e_rr, e_ss, 2.0 * e_rs], axis=1)


def _shear(tying: dict[str, FloatArray], r: float, s: float) -> FloatArray:
    """MITC4 shear rows (γ_r, γ_s), (E, 2, 24)."""
    g_r = 0.5 * (1.0 + s) * tying["sA"] + 0.5 * (1.0 - s) * tying["sB"]
    g_s = 0.5 * (1.0 + r) * tying["sC"] + 0.5 * (1.0 - r) * tying["sD"]
    return np.stack([g_r, g_s], axis=1)


def _bending(X: FloatArray, D: FloatArray, r: float, s: float) -> FloatArray:
    """Curvature rows (κ_rr, κ_ss, 2κ_rs), (E, 3, 24)."""
    dh = shape(r, s)[1]
    g = np.einsum("ai,eik->aek", dh, X)[:, :, None]
    d = np.einsum("ai,eik->aek", dh, D)[:, :, None]

    def part(a: int, b: int) -> FloatArray:
        return _both(dh[b][:, None] * d[a], dh[b][:, None] * np.cross(D, g[a]))

    return np.stack([part(0, 0), part(1, 1), part(0, 1) + part(1, 0)], axis=1)


def _enhanced(
    A0: FloatArray, ratio: FloatArray, r: float, s: float
) -> tuple[FloatArray, FloatArray]:
    """Enhanced strain (E, 3, 4) and rotation (E, 1, 4) of the modes û_1(r²), û_1(s²), û_2, û_2."""
    a_r, a_s = ratio * r * A0[:, :, 0], ratio * s * A0[:, :, 1]
    none = np.zeros(len(A0))
    first = [np.stack([a[:, 0], none, a[:, 1]], axis=1) for a in (a_r, a_s)]
    second = [np.stack([none, a[:, 1], a[:, 0]], axis=1) for a in (a_r, a_s)]
    turn = np.stack([-a_r[:, 1], -a_s[:, 1], a_r[:, 0], a_s[:, 0]], axis=1) / 2.0
    return np.stack(first + second, axis=2), turn[:, None]


def _drilling(
    D: FloatArray, frame: FloatArray, A: FloatArray, r: float, s: float
) -> tuple[FloatArray, FloatArray]:
    """Tie row (E, 1, 24), rotation of the face about the director minus Σ h_i d_i·θ_i; and d·n."""
    h, dh = shape(r, s)
    e1, e2, n = frame[:, 0], frame[:, 1], frame[:, 2]
    d = np.einsum("i,eik->ek", h, D)
    h_1, h_2 = np.einsum("eja,ai->jei", A, dh)  # local Cartesian derivatives, (E, 4)
    d1, d2, dn = (np.sum(d * e, axis=1)[:, None, None] for e in (e1, e2, n))
    about_n = 0.5 * (h_1[:, :, None] * e2[:, None] - h_2[:, :, None] * e1[:, None])
    tilt = (d1 * h_2[:, :, None] - d2 * h_1[:, :, None]) * n[:, None]
    row = _both(dn * about_n + tilt, -h[:, None] * D)
    return row[:, None], dn[:, 0, 0]
