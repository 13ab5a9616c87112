"""Number of threads of a process, set by its environment; imports nothing heavy."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

THREADS = "PHYTAC_THREADS"
"""Environment variable that bounds the threads; processes that run side by side set it to 1."""

PRELOAD = "PHYTAC_PRELOAD"
"""Environment variable by which a server of workers knows what to import, see
:mod:`.preloaded`: the name of a module, and the PYTHONPATH to go back to."""

BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What the common BLAS libraries read when they are loaded. The last digits of their results depend
on the number of threads."""


def workers() -> int:
    """Threads to use: ``$PHYTAC_THREADS``, or the cores this process may run on, at most eight."""
    own = os.environ.get(THREADS, "")
    return max(1, min(8, int(own) if own.isdigit() else len(os.sched_getaffinity(0))))


@contextmanager
def one_thread_each(**variables: str) -> Iterator[None]:
    """Processes started inside use one BLAS thread each, and have these variables as well."""
    inside = dict.fromkeys(BLAS_THREADS, "1") | variables
    before = {name: os.environ.get(name) for name in inside}
    os.environ.update(inside)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
