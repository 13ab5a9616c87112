"""Large displacements by forces on receptors themselves, by the decoder's own mesh."""

from collections.abc import Callable

import numpy as np

from phytac_decoder.mechanics.receptor_table import ReceptorTable
from phytac_design.simulation.interaction_tables import InteractionSolver
from phytac_design.simulation.pressed_series import DiscResponse, ImageResponse
from phytac_shapes.arrays import FloatArray, IntArray

BATCH = 16
"""Receptors solved together."""


def tabulate_receptors(
    shell: DiscResponse,
    see: ImageResponse,
    uv: FloatArray,
    marker: IntArray,
    pair: IntArray,
    radius_mm: float,
    progress: Callable[[str], None] = lambda _: None,
) -> ReceptorTable | None:
    """Return the table of discs on receptors; None if none is known to more than linear theory.

    Parameters
    ----------
    shell, see : DiscResponse, ImageResponse
        The decoder's shell, with two powers of the force at least, and what its cameras see.
    uv : (n, 2) float
        Places of all receptors.
    marker : (m,) int
        Receptors that are pressed.
    pair : (2, q) int
        Pairs of them, the larger number first.
    radius_mm : float
        Of the discs.

    Raises
    ------
    NumericalError
        If linear theory fails.
    """
    motions: list[list[FloatArray]] = []
    for first in range(0, len(marker), BATCH):
        motions += shell.motions(uv[marker[first : first + BATCH]], radius_mm)
        progress(f"receptors: {len(motions)} of {len(marker)}, large displacements")
    known = np.array([len(each) == shell.orders for each in motions], dtype=np.bool_)
    if not known.any():
        return None
    marker = marker[known]
    rows = [see.powers(each, shell.forces)[1:] for each in motions if len(each) == shell.orders]
    pair = pair[:, np.isin(pair, marker).all(axis=0)]
    images = np.zeros((0, 2 * len(uv)))
    if pair.shape[1]:
        progress(f"receptors: {pair.shape[1]} pairs")
        solver = InteractionSolver(shell, see, uv[marker], radius_mm)
        images = solver.images(np.searchsorted(marker, pair.T))
    return ReceptorTable(
        marker=marker,
        shift_px=np.array(rows, dtype=np.float32),
        pair=pair,
        pair_px=images.astype(np.float32),
        top_N=float(shell.forces[-1]),
    )
