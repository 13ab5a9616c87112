"""Tasks for tests of pools; light to import, as every worker process does."""

import os
from dataclasses import asdict
from typing import Any

from phytac_design.study.search.successive_halving import Outcome, Task


class Bad(Task):
    """A task whose program is broken."""

    def run(self) -> dict[str, Any]:
        raise RuntimeError("broken")


def made(kind: type[Task], order: int) -> Task:
    return kind(key=str(order), spec="", params={}, levels=("rules",))


class Fine(Task):
    """A task that comes to nothing, at once."""

    def run(self) -> dict[str, Any]:
        return asdict(Outcome())


class Deadly(Task):
    """A task that ends its process."""

    def run(self) -> dict[str, Any]:
        os._exit(9)


class Listening(Task):
    """A task that reports the sockets of its process that others could connect to."""

    def run(self) -> dict[str, Any]:
        import psutil

        kinds = [link.status for link in psutil.Process().net_connections(kind="all")]
        return asdict(Outcome(reason=f"{os.getpid()} {kinds}"))
