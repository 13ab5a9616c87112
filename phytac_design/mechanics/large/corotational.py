r"""Large displacements and rotations of the linear element: element-independent corotation.

Each element carries a frame R that fits its four corners best (Procrustes: Σ P_a × Rᵀp_a = 0, P
and p the corners about their mean, before and after). Seen from that frame the element hardly
deforms, and the linear stiffness K of its initial (warped, curved) geometry holds::

    ū_a = Rᵀ p_a − P_a      θ̄_a = log(Rᵀ R_a)      f̄ = K (ū, θ̄)
    ω_R = G Rᵀδx            δū_a = Rᵀδx_a − ω_R × (P_a + ū_a)      δθ̄_a = H_a (Rᵀω_a − ω_R)

so K must annihilate rigid motions, which it does. Forces and tangent are the exact first and
second variation (with respect to spins) of the stored energy Σ ½ f̄·(ū, θ̄): the tangent holds the
projected material part, the moment correction of H, and the geometric part including the change of
G, in the notation of Rankin and Nour-Omid (1988) and Felippa and Haugen (2005). Strains must be
small; displacements and rotations of the shell need not be.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.large.element_forces import element_forces
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.shell.sparse_assembly import Pattern, assemble, make_pattern
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class Configuration:
    """A deformed state.

    Attributes
    ----------
    displacement_mm : (N, 3) float
        Translation of every node, global axes.
    quaternion : (N, 4) float
        Finite rotation of every node (w, x, y, z).
    """

    displacement_mm: FloatArray
    quaternion: FloatArray

    @property
    def motion(self) -> FloatArray:
        """Displacement (mm) and rotation vector (rad, length <= π), (N, 6)."""
        return np.concatenate([self.displacement_mm, rot.logarithm(self.quaternion)], axis=1)

    def moved(self, step: FloatArray) -> "Configuration":
        """Return the state after translations (mm) and spins (rad), ``step`` (6N,)."""
        step = step.reshape(-1, 6)
        return Configuration(
            displacement_mm=self.displacement_mm + step[:, :3],
            quaternion=rot.product(rot.exponential(step[:, 3:]), self.quaternion),
        )


@dataclass(frozen=True, kw_only=True)
class LocalElements:
    """Elements seen from their frames: E elements of four corners.

    Attributes
    ----------
    frame : (E, 4) float
        Quaternion of the frame R.
    corners : (E, 4, 3) float
        P + ū: corners about their mean, in the frame, mm.
    motion : (E, 4, 6) float
        ū (mm) and θ̄ (rad).
    forces : (E, 4, 6) float
        f̄ (N, N mm).
    nodal : (6N,) float
        Nodal forces (N) and moments (N mm, on spins) that balance the elements, global axes.
    """

    frame: FloatArray
    corners: FloatArray
    motion: FloatArray
    forces: FloatArray
    nodal: FloatArray


class Corotational:
    """Internal forces and tangent of a shell under large displacements.

    Parameters
    ----------
    model : ShellModel
        The shell: its mesh, section and supports.
    apart : (e,) int, optional
        Of these elements alone, each with four nodes of its own: 4e nodes in their order.

    Attributes
    ----------
    arms : (e, 4, 3) float
        Corners of the elements about their middle, mm.
    stiffness : (e, 24, 24) float
        Linear stiffness, N, mm and rad.
    extent_mm : (e,) float
        Mean distance of the elements' corners from their middle.
    """

    def __init__(self, model: ShellModel, *, apart: IntArray | None = None) -> None:
        self.model = model
        some: slice | IntArray = slice(None) if apart is None else apart
        self.quads, self.size = model.quads[some], 6 * len(model.nodes_mm)
        corner = model.nodes_mm[self.quads]
        modulus, thickness = (
            value if np.ndim(value) == 0 else value[some]
            for value in (np.asarray(model.modulus_MPa), np.asarray(model.thickness_mm))
        )
        if apart is not None:
            self.quads, self.size = np.arange(corner.size // 3).reshape(-1, 4), 2 * corner.size
        self.arms = np.ascontiguousarray(corner - corner.mean(axis=1, keepdims=True))
        self.stiffness = np.ascontiguousarray(
            model.elements.pick(some).combine(modulus_MPa=modulus, thickness_mm=thickness)
        )
        self.extent_mm = np.linalg.norm(self.arms, axis=2).mean(axis=1)

    @cached_property
    def _pattern(self) -> Pattern:
        return make_pattern(self.quads, self.size // 6)

    def rest(self) -> Configuration:
        """Return the undeformed state."""
        count = self.size // 6
        return Configuration(displacement_mm=np.zeros((count, 3)), quaternion=rot.identity(count))

    def local(self, state: Configuration) -> LocalElements:
        """Elements in their best-fitting frames, and the forces they exert there.

        Raises
        ------
        NumericalError
            If an element is so distorted that no best fit is found.
        """
        count = len(self.quads)
        nodal = np.zeros((self.size // 6, 6))
        frame, ubar = np.empty((count, 4)), np.empty((count, 4, 3))
        motion, forces = np.empty((count, 24)), np.empty((count, 24))
        loose = element_forces(
            np.ascontiguousarray(self.quads, dtype=np.int64),
            self.arms,
            self.stiffness,
            np.ascontiguousarray(state.displacement_mm),
            np.ascontiguousarray(state.quaternion),
            (nodal, frame, ubar, motion, forces),
        )
        if loose >= 0:
            raise NumericalError(
                "element-distorted",
                f"element {loose} is distorted so that no rigid rotation fits its corners; take "
                "smaller load steps or refine the mesh",
            )
        return LocalElements(
            frame=frame,
            corners=self.arms + ubar,
            motion=motion.reshape(-1, 4, 6),
            forces=forces.reshape(-1, 4, 6),
            nodal=nodal.ravel(),
        )

    def internal(self, state: Configuration) -> FloatArray:
        """Nodal forces (N) and moments (N mm, on spins) that balance the elements, (6N,)."""
        return self.local(state).nodal

    def _inertia(self, corners: FloatArray) -> FloatArray:
        """A (E, 3, 3) with A ω = Σ P_a × (ω × p_a)."""
        product = np.swapaxes(self.arms, 1, 2) @ corners  # Σ P pᵀ
        trace = np.trace(product, axis1=1, axis2=2)[:, None, None]
        # P × (ω × p) = ω (P·p) − p (P·ω)
        return np.asarray(trace * np.eye(3) - np.swapaxes(product, 1, 2))

    def _projected(
        self, local: LocalElements, forces: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Forces in the frame with moment balance (E, 4, 6); G (E, 3, 4, 3); A⁻ᵀτ (E, 3)."""
        H = rot.spin_to_vector(local.motion[:, :, 3:])
        n = forces[:, :, :3]
        m = (np.swapaxes(H, 2, 3) @ forces[:, :, 3:, None])[..., 0]
        turn = np.linalg.inv(self._inertia(local.corners))
        G = (turn[:, None] @ rot.spin(self.arms)).transpose(0, 2, 1, 3)
        torque = (rot.cross(local.corners, n) + m).sum(axis=1)
        balanced = n - np.einsum("eiak,ei->eak", G, torque)
        y = np.einsum("eji,ej->ei", turn, torque)
        return np.concatenate([balanced, m], axis=2), G, y

    def tangent(self, local: LocalElements, forces: FloatArray | None = None) -> Any:
        """Tangent stiffness, (6N, 6N) ``scipy.sparse.csc_matrix``.

        Parameters
        ----------
        local : LocalElements
            Elements at the state.
        forces : (E, 4, 6) float, optional
            Local forces for the geometric part in place of ``local.forces``: with those
            predicted by the last Newton step the iteration takes far larger steps (Magisano,
            Leonetti and Garcea 2017); equal at convergence.
        """
        return self.assembled(
            self.element_tangents(local, local.forces if forces is None else forces)
        )

    def assembled(self, matrices: FloatArray) -> Any:
        """Sum of element matrices (E, 24, 24), symmetric or not, as :meth:`tangent`."""
        # ``assemble`` hands compressed rows over as columns, so it takes the transpose.
        return assemble(self._pattern, np.swapaxes(matrices, 1, 2))

    def element_tangents(self, local: LocalElements, forces: FloatArray) -> FloatArray:
        """Tangents of all elements, global axes, (E, 24, 24)."""
        count = len(local.frame)
        theta, moment = local.motion[:, :, 3:], forces[:, :, 3:]
        balanced, G, y = self._projected(local, forces)
        follow = self.projector(local, G)  # (ū, ψ) per (Rᵀδx, Rᵀω), Q
        H = rot.spin_to_vector(theta)
        bend = follow.copy().reshape(count, 4, 2, 3, 24)
        bend[:, :, 1] = H @ bend[:, :, 1]
        bend = bend.reshape(count, 24, 24)
        K = np.swapaxes(bend, 1, 2) @ (self.stiffness @ bend)
        # Moment correction Qᵀ L Q, L = ∂(Hᵀm)/∂θ H.
        L = rot.moment_change(theta, moment) @ H
        psi = follow.reshape(count, 4, 2, 3, 24)[:, :, 1]
        K += np.swapaxes(psi.reshape(count, 12, 24), 1, 2) @ (L @ psi).reshape(count, 12, 24)
        # Gᵀ Σ (f̄_a + P_a × y) × δū_a: the arms and G change.
        lever = rot.spin(forces[:, :, :3] + rot.cross(self.arms, y[:, None]))
        ubar = follow.reshape(count, 4, 2, 3, 24)[:, :, 0]
        swing = (lever @ ubar).sum(axis=1)
        blocks = K.reshape(count, 4, 2, 3, 24)
        blocks[:, :, 0] += G.transpose(0, 2, 3, 1) @ swing[:, None]
        # The frame turns the forces: ω_R × f = −f̂ G.
        turned = rot.spin(balanced.reshape(count, 8, 3)).reshape(count, 24, 3)
        geometric = turned @ G.reshape(count, 3, 12)
        columns = K.reshape(count, 24, 4, 2, 3)
        columns[:, :, :, 0] -= geometric.reshape(count, 24, 4, 3)
        R = rot.matrix(local.frame)[:, None]
        K = (R @ K.reshape(count, 8, 3, 24)).reshape(count, 24, 24)
        K = (R @ np.swapaxes(K, 1, 2).reshape(count, 8, 3, 24)).reshape(count, 24, 24)
        return np.swapaxes(K, 1, 2)

    def projector(self, local: LocalElements, G: FloatArray) -> FloatArray:
        """Q (E, 24, 24): (δū, δψ) of (Rᵀδx, Rᵀω), up to a translation of the element."""
        count = len(G)
        out = np.zeros((count, 4, 2, 3, 4, 2, 3))
        lift = rot.spin(local.corners) @ G.reshape(count, 1, 3, 12)
        out[:, :, 0, :, :, 0] = lift.reshape(count, 4, 3, 4, 3)
        out[:, :, 1, :, :, 0] = -G[:, None]
        for corner in range(4):
            for kind in range(2):
                for axis in range(3):
                    out[:, corner, kind, axis, corner, kind, axis] += 1.0
        return out.reshape(count, 24, 24)

    def predicted_forces(self, local: LocalElements, step: FloatArray) -> FloatArray:
        """Local forces (E, 4, 6) after the motion ``step`` (6N,), to first order."""
        turn = np.linalg.inv(self._inertia(local.corners))
        R = rot.matrix(local.frame)
        moves = step.reshape(-1, 2, 3)[self.quads].reshape(len(R), 8, 3) @ R
        moves = moves.reshape(len(R), 4, 6)
        moment = rot.cross(self.arms, moves[:, :, :3]).sum(axis=1)
        spin = (turn @ moment[:, :, None])[:, None, :, 0]
        change = moves.copy()
        change[:, :, :3] -= rot.cross(np.broadcast_to(spin, local.corners.shape), local.corners)
        change[:, :, 3:] -= spin
        H = rot.spin_to_vector(local.motion[:, :, 3:])
        change[:, :, 3:] = (H @ change[:, :, 3:, None])[..., 0]
        return local.forces + (self.stiffness @ change.reshape(-1, 24, 1)).reshape(change.shape)
