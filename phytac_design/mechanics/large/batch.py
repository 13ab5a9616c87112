"""Many load cases of one shell with large displacements, over worker processes.

Every sample is solved in a spawned process with one BLAS thread, also with one worker, and nothing
is handed from sample to sample: results do not depend on the number of workers, bit for bit.
Scripts that call this must guard their own start with ``if __name__ == "__main__":``.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any, Literal

import numpy as np

from phytac_design.core.threads import one_thread_each
from phytac_design.mechanics.large.linear_error import solve_auto
from phytac_design.mechanics.large.load_path import solve_large
from phytac_design.mechanics.large.newton import Loading
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

_model: ShellModel | None = None
"""The model of this worker process, built once."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One load case.

    Attributes
    ----------
    status : str
        ``ok``; ``flagged``: an equilibrium that is unstable, not known to be stable, or reached
        by a jump; ``failed``: no motion.
    reason : str
        Why it is not ``ok``; else empty.
    motion : (N, 6) float or None
        Translations (mm) and rotation vectors (rad).
    large : bool
        Whether large displacements were used.
    """

    status: Literal["ok", "flagged", "failed"]
    reason: str
    motion: FloatArray | None
    large: bool


Column = tuple[Any, FloatArray]
"""A load without its zeros: DOFs and values."""


def solve_batch(
    model: ShellModel,
    loads: Any,
    *,
    workers: int = 2,
    tolerance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Sample]:
    """Solve many load cases of one model.

    Parameters
    ----------
    model : ShellModel
        The shell; each worker builds its own from the same numbers.
    loads : (6N, m) float, dense or scipy.sparse
        Dead nodal forces (N) and moments (N mm), one case per column.
    workers : int
        Processes, at least 1.
    tolerance : float, optional
        As in :func:`estimate.solve_auto`: linear where that is good enough. None: always large.
    progress : callable, optional
        Called with the samples done and their total after each.

    Returns
    -------
    list of Sample
        In the order of the loads. A sample that fails is one with its reason.

    Raises
    ------
    NumericalError
        If the loads do not fit the model or ``workers`` is below 1.
    """
    from scipy.sparse import csc_matrix

    if workers < 1:
        raise NumericalError(f"a batch needs at least one worker (got {workers})")
    sparse = csc_matrix(loads)
    if sparse.shape[0] != model.fixed.size:
        raise NumericalError(
            f"the loads need one row per DOF, {model.fixed.size} (got {sparse.shape[0]})"
        )
    ends = sparse.indptr
    columns = [
        (sparse.indices[a:b], sparse.data[a:b])
        for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
    ]
    done: dict[int, Sample] = {}
    with one_thread_each():
        everything = list(range(len(columns)))
        for k, sample in _run(model, columns, everything, workers, tolerance):
            done[k] = sample
            if progress is not None:
                progress(len(done), len(columns))
        # A process that dies takes the samples waiting in its pool with it: each gets its own.
        for k in [k for k in everything if k not in done]:
            alone = dict(_run(model, columns, [k], 1, tolerance))
            died = Sample(
                status="failed", reason="its process died (memory?)", motion=None, large=True
            )
            done[k] = alone.get(k, died)
            if progress is not None:
                progress(len(done), len(columns))
    return [done[k] for k in everything]


def _run(
    model: ShellModel,
    columns: list[Column],
    chosen: list[int],
    workers: int,
    tolerance: float | None,
) -> Iterator[tuple[int, Sample]]:
    """Samples as they come; those of a pool that broke are left out."""
    parts = {
        "nodes_mm": model.nodes_mm,
        "quads": model.quads,
        "directors": model.directors,
        "thickness_mm": model.thickness_mm,
        "modulus_MPa": model.modulus_MPa,
        "poisson": model.poisson,
        "fixed": model.fixed,
        "drilling": model.drilling,
        "solver": model.solver,
    }
    count = min(workers, max(len(chosen), 1))
    context = get_context("spawn")
    with ProcessPoolExecutor(count, context, _build, (parts,)) as pool:
        futures: dict[Future[Sample], int] = {
            pool.submit(_solve, columns[k], tolerance): k for k in chosen
        }
        for future in as_completed(futures):
            try:
                yield futures[future], future.result()
            except BrokenProcessPool:
                continue


def _build(parts: dict[str, Any]) -> None:
    global _model  # noqa: PLW0603  the initialiser of a pool has nowhere else to leave its model
    _model = ShellModel(**parts)


def _solve(column: Column, tolerance: float | None) -> Sample:
    if _model is None:
        raise NumericalError("this process has no model; start batches with solve_batch")
    return solve_sample(_model, column, tolerance)


def solve_sample(model: ShellModel, column: Column, tolerance: float | None) -> Sample:
    """One load case in this process, whatever becomes of it."""
    force = np.zeros(model.fixed.size)
    try:
        force[column[0]] = column[1]
        if tolerance is not None:
            auto = solve_auto(model, force, tolerance=tolerance)
            motion, large, stable, jumped = auto.motion, auto.large, auto.stable, auto.jumped
        else:
            end = solve_large(model, Loading(force=force))[0]
            motion, large, stable, jumped = end.state.motion, True, end.stable, end.jumped
    except (NumericalError, ArithmeticError, MemoryError, np.linalg.LinAlgError) as error:
        reason = str(error) or type(error).__name__
        return Sample(status="failed", reason=reason, motion=None, large=True)
    reasons = [
        text
        for given, text in (
            (jumped, "the path to this state was left: the shell may have snapped"),
            (stable is None, "its stability cannot be told"),
            (stable is False, "unstable: the shell does not stay here under this load"),
        )
        if given
    ]
    status: Literal["ok", "flagged"] = "flagged" if reasons else "ok"
    return Sample(status=status, reason="; ".join(reasons), motion=motion, large=large)
