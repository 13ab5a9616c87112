"""Where candidates are climbed: in this process, or (``dask_pool``) in others, here or far away."""

from collections.abc import Iterable, Iterator
from typing import Protocol

from phytac_design.study.search.ladder import Outcome, Task


class Pool(Protocol):
    """Runs tasks, several at once or one after the other."""

    @property
    def workers(self) -> int:
        """How many run at once."""
        ...

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Results as they come, in any order; every task once."""
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

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
        """Results in the order of the tasks."""
        for task in tasks:
            yield task, Outcome(**task.run())

    def close(self) -> None:
        """Nothing is held."""
