"""Whether quads make a shell that can be computed: edges, orientation, distortion of thin walls."""

import numpy as np

from phytac_design.mechanics.meshing.mesh import R, S
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError


def check_quads(quads: IntArray, node_count: int) -> None:
    """Refuse connectivity that is no shell.

    Creases and holes are shells; so is a T of three walls, but one set of directors cannot
    describe it, so three elements at an edge are refused.

    Parameters
    ----------
    quads : (E, 4) int
        Corners.
    node_count : int
        Number of nodes.

    Raises
    ------
    NumericalError
        If there is no element, a corner is no node, an edge belongs to more than two elements, or
        neighbours face opposite ways.
    """
    if quads.ndim != 2 or quads.shape[1:] != (4,) or not len(quads):
        raise NumericalError(
            "mesh-shape-invalid",
            f"mesh: quads must be (E, 4) with at least one element (got {quads.shape}); "
            "give four corner nodes for each element",
        )
    if quads.min() < 0 or quads.max() >= node_count:
        raise NumericalError(
            "mesh-node-unknown",
            f"mesh: an element refers to node {quads.max() if quads.min() >= 0 else quads.min()}, "
            f"but nodes run from 0 to {node_count - 1}; correct the numbering",
        )
    start, end = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    ends = np.sort(np.stack([start, end], axis=1), axis=1)
    edges, slot, uses = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    _refuse(
        uses > 2,
        "mesh-edge-overused",
        "edge {where} belongs to more than two elements ({count} such edges in all): remove inner "
        "walls and elements that are there twice",
        edges,
    )
    # Neighbours that face the same way run along their common edge in opposite directions.
    runs = np.bincount(slot.ravel(), weights=np.where(start < end, 1.0, -1.0))
    _refuse(
        (uses == 2) & (np.abs(runs) > 1.0),
        "mesh-orientation-mixed",
        "two elements face opposite ways across edge {where}, or lie on one another ({count} such "
        "edges in all); reverse the corners of one side, or remove it",
        edges,
    )


def check_directors(nodes_mm: FloatArray, quads: IntArray, directors: FloatArray) -> None:
    """Refuse directors that are no unit normals of the elements.

    Parameters
    ----------
    nodes_mm : (N, 3) float
        Node positions, mm.
    quads : (E, 4) int
        Corners.
    directors : (N, 3) or (E, 4, 3) float
        Normals per node, or per element and corner.

    Raises
    ------
    NumericalError
        If a director is not of unit length, or leans 90° or more away from its element's normal.
    """
    corner = nodes_mm[quads]
    normal = np.cross(corner[:, 2] - corner[:, 0], corner[:, 3] - corner[:, 1])
    own = directors[quads] if directors.ndim == 2 else directors
    length = np.linalg.norm(own, axis=2)
    if not np.all(np.abs(length - 1.0) < 1e-6):
        worst = float(length.ravel()[np.argmax(np.abs(length - 1.0))])
        raise NumericalError(
            "mesh-director-not-unit",
            f"mesh: directors must be unit normals (got one of length {worst:.6g}); divide them "
            "by their length",
        )
    _refuse(
        np.any(np.einsum("eck,ek->ec", own, normal) <= 0.0, axis=1),
        "mesh-orientation-reversed",
        "element {where} faces away from its directors ({count} in all); reverse its corners or "
        "the directors",
    )


def check_distortion(
    nodes_mm: FloatArray, quads: IntArray, directors: FloatArray, thickness_mm: float | FloatArray
) -> None:
    """Refuse irregular elements on a curved wall that is too thin for them.

    On an element that is no parallelogram a bent curved wall stretches although it should not. With
    δ the distance of its corners from a parallelogram over its size h, and κ the curvature, this
    costs 12 (δ h² κ / t)² of the bending energy. Where neighbours are distorted alike it cancels,
    and what remains shrinks so fast that the estimate from a coarser mesh shows it; so δ is that of
    the difference to each neighbour. Free hyperboloids (the worst case: pure bending), with nodes
    moved at random by 10 and 25 % of an element, are too stiff by 0.06 to 0.12 times the mean over
    the area, as long as that is below 1.

    Parameters
    ----------
    nodes_mm : (N, 3) float
        Node positions, mm.
    quads : (E, 4) int
        Corners.
    directors : (N, 3) or (E, 4, 3) float
        Normals per node, or per element and corner.
    thickness_mm : float or (E,) float
        Wall thickness, mm.

    Raises
    ------
    NumericalError
        If a shell that is free to bend would be too stiff by more than 5 to 10 %.
    """
    stiffer, stiffer_max, few = 0.12, 0.1, 16
    if len(quads) < few:  # Neighbours differ on so coarse a regular mesh, too.
        return
    corner = nodes_mm[quads]
    own = directors[quads] if directors.ndim == 2 else directors
    x_r, x_s, x_d = 0.25 * np.tensordot(np.stack([R, S, R * S]), corner, axes=(1, 1))
    normal = np.cross(x_r, x_s)
    area = np.linalg.norm(normal, axis=1)
    turn = 0.25 * np.tensordot(np.stack([R, S]), own, axes=(1, 1))
    bend = np.sum(turn**2, axis=(0, 2)) / np.square(thickness_mm)
    first, second, alike = _neighbours(quads)
    with np.errstate(invalid="ignore", divide="ignore"):
        normal /= area[:, None]
        flat = x_d - np.sum(x_d * normal, axis=1)[:, None] * normal
        # Neighbours have two corners in common: the variance of the difference is three times δ's.
        irregular = np.sum((flat[first] - alike[:, None] * flat[second]) ** 2, axis=1) / 3.0
        each = 12.0 * irregular * (bend[first] + bend[second]) / 2.0
        weight = area[first] + area[second]
        predicted = stiffer * float(np.sum(each * weight) / np.sum(weight))
    # Not a number: an element is degenerate, which its stiffness reports.
    if predicted > stiffer_max:
        raise NumericalError(
            "mesh-distorted",
            f"mesh: its elements are too irregular for so thin a wall: where it is free to bend it "
            f"would be too stiff by up to {100.0 * predicted:.2g} % (at most "
            f"{100.0 * stiffer_max:g} %); use smaller elements, or ones that are closer to "
            "parallelograms",
        )


def _neighbours(quads: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs of elements (k,) with a common edge; ±1 (k,) by which their distortions compare.

    The distortion x_1 - x_2 + x_3 - x_4 changes its sign with the corner that a numbering starts
    from. On a regular mesh that is numbered alike everywhere the factor is 1.
    """
    start, end = quads.ravel().astype(np.int64), np.roll(quads, -1, axis=1).ravel()
    key = np.minimum(start, end) * (int(quads.max()) + 1) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, other = order[twice], order[twice + 1]
    # They run along the edge in opposite directions: the end of one is the start of the other.
    parity = (R * S).astype(np.int64)
    return one // 4, other // 4, -parity[one % 4] * parity[(other + 1) % 4]


def _refuse(bad: BoolArray, code: str, message: str, edges: IntArray | None = None) -> None:
    """Raise for the first bad element, or edge (k, 2), if there is one."""
    if np.any(bad):
        at = int(np.argmax(bad))
        where = at if edges is None else "-".join(map(str, edges[at]))
        raise NumericalError(code, f"mesh: {message.format(where=where, count=int(np.sum(bad)))}")
