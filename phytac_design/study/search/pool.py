"""Where candidates are climbed: in this process, or (``dask_pool``) in others, here or far away."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from ctypes import CDLL
from functools import cache
from typing import Protocol

from phytac_design.study.search.successive_halving import Outcome, Task

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt`` (GNU C library)."""
KEPT_BYTES, MAPPED_BYTES = 256 << 20, 32 << 20


@cache
def keep_memory() -> None:
    """Keep freed memory in this process for what comes next; once.

    Otherwise an array of megabytes may be memory new from the system each time: candidates then
    take 1.1 times their processor time, and 1.6 times where Dask's nanny sets
    ``MALLOC_TRIM_THRESHOLD_`` to 64 KiB.
    """
    with suppress(OSError, AttributeError):  # another C library than GNU's
        library = CDLL(None)
        library.mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
        library.mallopt(M_MMAP_THRESHOLD, MAPPED_BYTES)


class Pool(Protocol):
    """Runs tasks, several at once or one after the other."""

    @property
    def workers(self) -> int:
        """How many run at once."""
        ...

    def run(
        self, tasks: Iterable[Task], following: Iterable[Task] = ()
    ) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come, in any order; every task once.

        Parameters
        ----------
        tasks : iterable of Task
            Those whose results are given.
        following : iterable of Task
            Those that will be asked for next: begun where there is room.
        """
        ...

    def close(self) -> None:
        """Let go of processes and connections."""
        ...


class OwnProcess:
    """The driver's own process, one task after the other."""

    @property
    def workers(self) -> int:
        """One."""
        return 1

    def run(
        self, tasks: Iterable[Task], following: Iterable[Task] = ()
    ) -> Iterator[tuple[Task, Outcome]]:
        """Results in the order of the tasks; nothing has room beside the one that runs."""
        del following
        keep_memory()
        for task in tasks:
            yield task, Outcome(**task.run())

    def close(self) -> None:
        """Nothing is held."""
