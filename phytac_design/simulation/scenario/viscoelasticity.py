r"""What a sensor remembers: creep and relaxation of its wall, its switches' state, its light.

The wall is linearly viscoelastic with a constant Poisson's ratio, so that every modulus fades
alike and the shape of a deflection does not change (Christensen 1982, section 2.1)::

    G(t)/G0 = 1 - Σ gᵢ (1 - exp(-t/τᵢ))           J(t)·G0 = 1 + Σ jᵢ (1 - exp(-t/λᵢ))

``F`` is the force on the wall and ``e`` the *felt* force: that of an elastic wall which moves as
this one does. Then e = J * dF and F = G * de. The interconversion is exact: retardation times are
the zeros of the relaxation's transform (Park and Schapery 1999), found as eigenvalues.

With large displacements this is the quasi-linear approximation (Fung 1972): the elastic wall's
own law at the felt force.
"""

from dataclasses import dataclass

import numpy as np

from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """Prony series of a wall's modulus.

    Attributes
    ----------
    share : (k,) float
        Parts gᵢ > 0 of the instantaneous modulus that fade, less than 1 together.
    time_s : (k,) float
        Times τᵢ, all different.
    """

    share: FloatArray
    time_s: FloatArray

    def creep(self) -> "Creep":
        """Return the creep compliance that belongs to it.

        With y the low-passed e, τᵢ yᵢ' + yᵢ = e, the force is F = e - g·y. At given force that
        reads y' = -A y + F/τ with A = diag(1/τ) (1 - 1 gᵀ), which is similar to a symmetric
        matrix, diag(1/τ) less one of rank one.
        """
        rate = 1.0 / self.time_s
        root = np.sqrt(self.share * rate)
        values, vectors = np.linalg.eigh(np.diag(rate) - np.outer(root, root))
        weight = (root @ vectors) ** 2
        return Creep(share=weight / values, time_s=1.0 / values)


@dataclass(frozen=True, kw_only=True)
class Creep:
    """Prony series of a wall's compliance, over its instantaneous one.

    Attributes
    ----------
    share : (k,) float
        Parts jᵢ > 0 that are added in time.
    time_s : (k,) float
        Retardation times λᵢ.
    """

    share: FloatArray
    time_s: FloatArray


def felt_force(creep: Creep, times_s: FloatArray, force_N: FloatArray) -> FloatArray:
    """Felt force at the corners of piecewise linear forces.

    The hereditary integral e(t) = F(t) + Σ jᵢ ∫ (1 - exp(-(t-s)/λᵢ)) F'(s) ds, by a recursion
    over the pieces that is exact for each term.

    Parameters
    ----------
    creep : Creep
        The wall's.
    times_s : (t,) float
        Growing; nothing was pressed before the first. Two equal times are a step.
    force_N : (t,) or (t, c) float
        Forces then.

    Returns
    -------
    (t,) or (t, c) float
        Felt forces, N.

    Raises
    ------
    NumericalError
        If times do not grow.
    """
    force = np.asarray(force_N, dtype=np.float64)
    behind = _filtered(np.asarray(times_s, dtype=np.float64), force, creep.time_s)
    return np.asarray(force + np.einsum("i,it...->t...", creep.share, behind))


def _pieces(times_s: FloatArray, tau_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Decay exp(-h/τ) over each piece, and its mean over the piece, (k, t-1) each."""
    step = np.diff(times_s)
    if (step < 0.0).any():
        worst = int(np.argmin(step))
        raise NumericalError(
            "force-history-order",
            f"times of a force history must grow (got {times_s[worst]:g} s before "
            f"{times_s[worst + 1]:g} s); sort them",
        )
    x = step / tau_s[:, None]
    mean = np.where(x > 0.0, -np.expm1(-x) / np.where(x > 0.0, x, 1.0), 1.0)
    return np.exp(-x), mean


def _filtered(times_s: FloatArray, force: FloatArray, tau_s: FloatArray) -> FloatArray:
    """Low-passed forces y (k, t, ...): τ y' + y = F, from rest, F linear between the times."""
    keep, mean = _pieces(times_s, tau_s)
    out = np.zeros((len(tau_s), *force.shape))
    tail = (slice(None),) + (None,) * (force.ndim - 1)
    for n in range(len(times_s) - 1):
        a, m = keep[:, n][tail], mean[:, n][tail]
        out[:, n + 1] = a * out[:, n] + (m - a) * force[n] + (1.0 - m) * force[n + 1]
    return out


def felt_cycles(
    creep: Creep, times_s: FloatArray, force_N: FloatArray, cycles: IntArray
) -> FloatArray:
    """Felt force within chosen cycles of a force that repeats itself, (m, t).

    The memory of n cycles is a geometric sum, so that cycles in between cost nothing.

    Parameters
    ----------
    creep : Creep
        The wall's.
    times_s : (t,) float
        Times in one cycle; the last is the first of the next.
    force_N : (t,) float
        Forces then, linear between; the last is the first again.
    cycles : (m,) int
        Numbers of the cycles, from 0.
    """
    times, force = np.asarray(times_s, dtype=np.float64), np.asarray(force_N, dtype=np.float64)
    behind = _filtered(times, force, creep.time_s)
    rate = times[-1] / creep.time_s
    sum_of_n = np.expm1(-np.multiply.outer(cycles, rate)) / np.expm1(-rate)
    start = behind[:, -1] * sum_of_n  # (m, k)
    fading = np.exp(-times / creep.time_s[:, None])
    return np.asarray(force + creep.share @ behind + (start * creep.share) @ fading)


@dataclass(frozen=True, kw_only=True)
class DepthResponse:
    """Outcome of a depth history.

    Attributes
    ----------
    force_N : (t,) or (t, c) float
        Force on the wall; 0 where it has left the indenter.
    felt_N : (t,) or (t, c) float
        Felt force: as prescribed, or more where the wall is slower than the indenter.
    memory_N : (k,) or (k, c) float
        State at the end: the low-passed felt force of each term.
    """

    force_N: FloatArray
    felt_N: FloatArray
    memory_N: FloatArray


def force_under_depth(
    relaxation: Relaxation,
    times_s: FloatArray,
    depth_N: FloatArray,
    memory_N: FloatArray | None = None,
) -> DepthResponse:
    """Force on a wall under an indenter whose depth is prescribed.

    The depth is given as the force of an elastic wall there. An indenter only pushes: where it is
    drawn back faster than the wall recovers, the wall is free (force 0) until they meet again.
    Exact while in contact; leaving and meeting are found at the given times only.

    Parameters
    ----------
    relaxation : Relaxation
        The wall's.
    times_s : (t,) float
        Growing.
    depth_N : (t,) or (t, c) float
        Depths, linear between the times.
    memory_N : (k,) or (k, c) float, optional
        ``DepthResponse.memory_N`` of what came before; nothing was pressed, if left out.
    """
    times, depth = np.asarray(times_s, dtype=np.float64), np.asarray(depth_N, dtype=np.float64)
    keep, mean = _pieces(times, relaxation.time_s)
    tail = (slice(None),) + (None,) * (depth.ndim - 1)
    g = relaxation.share
    # F = e - Σ gᵢ yᵢ with y the low-passed e; over a piece y = past + (1 - m) e at its end.
    y = np.zeros((len(g), *depth.shape[1:])) if memory_N is None else memory_N
    late = np.column_stack([np.zeros(len(g)), 1.0 - mean])
    early = np.column_stack([np.zeros(len(g)), mean - keep])
    decay = np.column_stack([np.ones(len(g)), keep])
    stiffness = 1.0 - g @ late
    felt, force = np.zeros_like(depth), np.zeros_like(depth)
    for n in range(len(times)):
        past = decay[:, n][tail] * y + early[:, n][tail] * felt[n - 1]
        free = g @ past / stiffness[n]
        felt[n] = np.maximum(depth[n], free)
        y = past + late[:, n][tail] * felt[n]
        force[n] = np.where(felt[n] > depth[n], 0.0, felt[n] - g @ y)
    return DepthResponse(force_N=np.maximum(force, 0.0), felt_N=felt, memory_N=y)


def force_under_cycles(
    relaxation: Relaxation, times_s: FloatArray, depth_N: FloatArray, cycles: IntArray
) -> DepthResponse:
    """:func:`force_under_depth` within chosen cycles (m,) of a periodic depth, (m, t) each."""
    force, felt, chosen = [], [], set(np.asarray(cycles).tolist())
    memory: FloatArray | None = None
    for number in range(max(chosen, default=-1) + 1):
        held = force_under_depth(relaxation, times_s, depth_N, memory)
        memory = held.memory_N
        if number in chosen:
            force.append(held.force_N)
            felt.append(held.felt_N)
    return DepthResponse(
        force_N=np.array(force), felt_N=np.array(felt), memory_N=np.asarray(memory)
    )


def switch_step(
    state: BoolArray, carried_N: FloatArray, on_N: FloatArray, off_N: FloatArray
) -> BoolArray:
    """Switches (..., n) after a force has come: on above ``on_N``, off below ``off_N``, else kept.

    A bowl without any load springs back, whatever its release force.

    Parameters
    ----------
    state : (..., n) bool
        Before.
    carried_N : (..., n) float
        Force on each footprint; monotone from the one before.
    on_N, off_N : (n,) float
        Thresholds.
    """
    return (carried_N > on_N) | (state & (carried_N >= off_N) & (carried_N > 0.0))


def light_at(time_s: FloatArray, drift_share: float, drift_time_s: float) -> FloatArray:
    """Brightness over that at time 0, fading to ``1 - drift_share``."""
    return np.asarray(1.0 + drift_share * np.expm1(-np.asarray(time_s) / drift_time_s))
