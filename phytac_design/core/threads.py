"""Number of threads of a process, set by its environment; imports nothing heavy."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

THREADS = "PHYTAC_THREADS"
"""Environment variable that bounds the threads; processes that run side by side set it to 1."""

PRELOAD = "PHYTAC_PRELOAD"
"""Environment variable that names the module which worker processes have imported, see
:mod:`.preloaded`."""

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What the common BLAS libraries read when they are loaded. The last digits of their results depend
on the number of threads."""


def workers() -> int:
    """Threads to use: ``$PHYTAC_THREADS``, or the cores this process may run on, at most eight."""
    own = os.environ.get(THREADS, "")
    return max(1, min(8, int(own) if own.isdigit() else len(os.sched_getaffinity(0))))


@contextmanager
def one_thread_each(*others: str) -> Iterator[None]:
    """Processes started inside use one BLAS thread each; ``others`` are set to 1 as well."""
    names = (*BLAS_THREADS, *others)
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
