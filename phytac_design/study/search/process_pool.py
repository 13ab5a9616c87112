"""Candidates evaluated by processes on this machine, which no one else can reach."""

from collections.abc import Iterable, Iterator

from phytac_design.core.workers import WorkerPool
from phytac_design.study.search.successive_halving import (
    Outcome,
    SerialPool,
    Task,
    chunked,
    failed,
    keep_memory,
)


def _evaluated(_: None, chunk: list[Task]) -> list[Outcome]:
    """Results of a chunk, on a worker; an error of the program is one candidate's."""
    out = []
    for task in chunk:
        try:
            out.append(Outcome(**task.run()))
        except Exception as error:  # noqa: BLE001  recorded with the candidate
            out.append(failed(f"{type(error).__name__}: {error}"))
    return out


class ProcessPool(SerialPool):
    """Processes of one thread each. They talk to this one by pipes, and listen to nobody.

    Parameters
    ----------
    workers : int
        Number of processes. A task whose process dies runs again, alone.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool = WorkerPool(_evaluated, workers=workers, start=keep_memory)

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come; every task once, however often a process dies."""
        chunks, lost = chunked(tasks, self.workers), []
        for result in self._pool.run(chunks):
            if result.lost:
                lost += chunks[result.index]
            else:
                yield from zip(chunks[result.index], result.value, strict=True)
        for result in self._pool.run([task] for task in lost):
            yield lost[result.index], failed(result.lost) if result.lost else result.value[0]

    def close(self) -> None:
        """End all processes."""
        self._pool.close()
