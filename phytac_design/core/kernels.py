"""Compiled loops and threads, shared by the rasteriser and its users."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar, cast

import numba

from phytac_design.core.cache_folder import cache_root
from phytac_design.core.threads import workers

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def kernel(function: Kernel) -> Kernel:
    """Compile with numba, cached on disk, without the interpreter lock; 1 / 0 is inf.

    Machine code is kept beside the source or in the user's cache folder. Where neither can be
    written (read-only containers, services without a home folder) it goes to
    :func:`cache_root`, and if that fails too it is compiled again by each process.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except RuntimeError:
        numba.config.CACHE_DIR = str(cache_root() / "kernels")
        try:
            compiled = numba.njit(cache=True, **options)(function)
        except (RuntimeError, OSError):
            compiled = numba.njit(**options)(function)
    return cast("Kernel", compiled)


def in_bands(work: Callable[[int, int], None], rows: int, *, band_rows: int = 0) -> None:
    """Call ``work(first, last)`` on bands of rows, on as many threads as there are cores.

    ``band_rows`` bounds the height of a band (and so its memory); 0 gives each thread one band.
    """
    threads = workers()
    size = band_rows or max(1, -(-rows // threads))
    starts = list(range(0, rows, size))
    stops = [min(start + size, rows) for start in starts]
    if min(threads, len(starts)) <= 1:
        for start, stop in zip(starts, stops, strict=True):
            work(start, stop)
        return
    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(work, starts, stops))
