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
from typing import Any

import numpy as np

from phytac_design.mechanics.large import rotations as rot
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.mechanics.shell.sparse_assembly import assemble, make_pattern
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError

FIT_STEPS = 12
"""Newton steps of the best fit; three are common."""
FIT_TOL = 1e-11
"""Last step of the fit, rad; the one after it would be of the order of its square."""


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
    """

    frame: FloatArray
    corners: FloatArray
    motion: FloatArray
    forces: FloatArray


class Corotational:
    """Internal forces and tangent of a shell under large displacements.

    Parameters
    ----------
    model : ShellModel
        The shell: its mesh, section and supports.
    """

    def __init__(self, model: ShellModel) -> None:
        self.model = model
        corner = model.nodes_mm[model.quads]
        self._arms = corner - corner.mean(axis=1, keepdims=True)
        self._stiffness = model.elements.combine(
            modulus_MPa=model.modulus_MPa, thickness_mm=model.thickness_mm
        )
        self._pattern = make_pattern(model.quads, len(model.nodes_mm))
        self._moment_arms = rot.spin(self._arms)

    def rest(self) -> Configuration:
        """Return the undeformed state."""
        count = len(self.model.nodes_mm)
        return Configuration(displacement_mm=np.zeros((count, 3)), quaternion=rot.identity(count))

    def local(self, state: Configuration) -> LocalElements:
        """Elements in their best-fitting frames, and the forces they exert there.

        Raises
        ------
        NumericalError
            If an element is so distorted that no best fit is found.
        """
        moved = state.displacement_mm[self.model.quads]
        moved = moved - moved.mean(axis=1, keepdims=True)
        nodal = state.quaternion[self.model.quads]
        frame = self._fit(moved, nodal)
        ubar = self._deformation(frame, moved)
        theta = rot.logarithm(rot.product(rot.inverse(frame)[:, None], nodal))
        motion = np.concatenate([ubar, theta], axis=2)
        return LocalElements(
            frame=frame,
            corners=self._arms + ubar,
            motion=motion,
            forces=self.local_forces(motion),
        )

    def local_forces(self, motion: FloatArray) -> FloatArray:
        """f̄ = K (ū, θ̄), (E, 4, 6)."""
        return (self._stiffness @ motion.reshape(-1, 24, 1)).reshape(motion.shape)

    def _deformation(self, frame: FloatArray, moved: FloatArray) -> FloatArray:
        """ū = Rᵀ(P + d) − P, with relative precision also when tiny."""
        back = rot.deviation(rot.inverse(frame))
        return np.asarray(moved + (self._arms + moved) @ np.swapaxes(back, 1, 2))

    def _fit(self, moved: FloatArray, nodal: FloatArray) -> FloatArray:
        """Frames (E, 4) with Σ P_a × ū_a = 0.

        Newton from the mean of the corners' rotations; elements that it does not settle start
        again from the global optimum (Horn 1987: an eigenvector), and are polished.
        """
        aligned = np.where(np.sum(nodal * nodal[:, :1], axis=2, keepdims=True) < 0.0, -nodal, nodal)
        frame = aligned.sum(axis=1)
        frame /= np.linalg.norm(frame, axis=1, keepdims=True)
        frame, loose = self._newton_fit(frame, moved)
        if np.any(loose):
            start = frame.copy()
            start[loose] = rot.best_fit(self._arms[loose], (self._arms + moved)[loose])
            frame, loose = self._newton_fit(start, moved)
        if np.any(loose):
            raise NumericalError(
                "element-distorted",
                f"{int(loose.sum())} elements are distorted so that no rigid rotation fits their "
                "corners; take smaller load steps or refine the mesh",
            )
        return frame

    def _newton_fit(self, frame: FloatArray, moved: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Frames after Newton's method on Σ P_a × ū_a = 0, and those that it does not settle."""
        loose = np.ones(len(frame), dtype=np.bool_)
        for _ in range(FIT_STEPS):
            inertia, gap = self._misfit(frame, moved)
            finite = np.isfinite(inertia).all(axis=(1, 2))
            inertia[~finite] = np.eye(3)
            sound = finite & (np.linalg.det(inertia) > 0.0)
            inertia[~sound] = np.eye(3)
            gap[~sound] = 0.0
            step = np.linalg.solve(inertia, gap[:, :, None])[:, :, 0]
            size = np.linalg.norm(step, axis=1)
            short = np.minimum(1.0, 1.0 / np.maximum(size, 1e-300))[:, None]
            frame = rot.product(frame, rot.exponential(np.asarray(short * step)))
            loose = ~(sound & (size * size < FIT_TOL))
            if not np.any(loose):
                break
        return frame, loose

    def _misfit(self, frame: FloatArray, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
        ubar = self._deformation(frame, moved)
        return self._inertia(self._arms + ubar), rot.cross(self._arms, ubar).sum(axis=1)

    def _inertia(self, corners: FloatArray) -> FloatArray:
        """A (E, 3, 3) with A ω = Σ P_a × (ω × p_a)."""
        product = np.swapaxes(self._arms, 1, 2) @ corners  # Σ P pᵀ
        trace = np.trace(product, axis1=1, axis2=2)[:, None, None]
        # P × (ω × p) = ω (P·p) − p (P·ω)
        return np.asarray(trace * np.eye(3) - np.swapaxes(product, 1, 2))

    def internal(self, local: LocalElements) -> FloatArray:
        """Nodal forces (N) and moments (N mm, on spins) that balance the elements, (6N,)."""
        forces = self._projected(local, local.forces)[0]
        R = rot.matrix(local.frame)
        turned = forces.reshape(len(R), 8, 3) @ np.swapaxes(R, 1, 2)
        node = np.repeat(self.model.quads, 6, axis=1) * 6 + np.tile(np.arange(6), 4)
        return np.bincount(
            node.ravel(), turned.ravel(), minlength=6 * len(self.model.nodes_mm)
        ).astype(np.float64)

    def _projected(
        self, local: LocalElements, forces: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Forces in the frame with moment balance (E, 4, 6); G (E, 3, 4, 3); A⁻ᵀτ (E, 3)."""
        H = rot.spin_to_vector(local.motion[:, :, 3:])
        n = forces[:, :, :3]
        m = (np.swapaxes(H, 2, 3) @ forces[:, :, 3:, None])[..., 0]
        turn = np.linalg.inv(self._inertia(local.corners))
        G = (turn[:, None] @ self._moment_arms).transpose(0, 2, 1, 3)
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
        K = np.swapaxes(bend, 1, 2) @ (self._stiffness @ bend)
        # Moment correction Qᵀ L Q, L = ∂(Hᵀm)/∂θ H.
        L = rot.moment_change(theta, moment) @ H
        psi = follow.reshape(count, 4, 2, 3, 24)[:, :, 1]
        K += np.swapaxes(psi.reshape(count, 12, 24), 1, 2) @ (L @ psi).reshape(count, 12, 24)
        # Gᵀ Σ (f̄_a + P_a × y) × δū_a: the arms and G change.
        lever = rot.spin(forces[:, :, :3] + rot.cross(self._arms, y[:, None]))
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
        moves = step.reshape(-1, 2, 3)[self.model.quads].reshape(len(R), 8, 3) @ R
        moves = moves.reshape(len(R), 4, 6)
        moment = rot.cross(self._arms, moves[:, :, :3]).sum(axis=1)
        spin = (turn @ moment[:, :, None])[:, None, :, 0]
        change = moves.copy()
        change[:, :, :3] -= rot.cross(np.broadcast_to(spin, local.corners.shape), local.corners)
        change[:, :, 3:] -= spin
        H = rot.spin_to_vector(local.motion[:, :, 3:])
        change[:, :, 3:] = (H @ change[:, :, 3:, None])[..., 0]
        return local.forces + self.local_forces(change)
