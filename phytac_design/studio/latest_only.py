"""Latest-only executor: a later request of a browser tab supersedes the earlier ones."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import TypeVar

Result = TypeVar("Result")
Check = Callable[[], None]
"""Raises ``SupersededError`` if a later request of the same tab has come."""


class SupersededError(Exception):
    """A later request of the same tab has replaced this one."""


class LatestOnlyExecutor:
    """A thread that runs requests one by one and skips superseded ones.

    It remembers the latest request of up to ``tabs_max`` tabs.
    """

    def __init__(self, name: str, tabs_max: int = 64) -> None:
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._latest: OrderedDict[str, Event] = OrderedDict()
        self._tabs_max = tabs_max

    async def run(self, tab: str, work: Callable[[Check], Result]) -> Result:
        """Result of ``work`` for a tab; ``work`` calls its argument between steps.

        Raises
        ------
        SupersededError
            If a later request of the tab came first.
        """
        self.cancel(tab)
        superseded = self._latest[tab] = Event()
        while len(self._latest) > self._tabs_max:
            self._latest.popitem(last=False)[1].set()

        def check() -> None:
            if superseded.is_set():
                raise SupersededError

        def started() -> Result:
            check()
            return work(check)

        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, started)
        finally:
            if self._latest.get(tab) is superseded:
                del self._latest[tab]

    def cancel(self, tab: str) -> None:
        """Stop a tab's request at its next step, if there is one."""
        superseded = self._latest.pop(tab, None)
        if superseded is not None:
            superseded.set()

    def close(self) -> None:
        """Stop all requests at their next step, and accept no more."""
        for superseded in self._latest.values():
            superseded.set()
        self._pool.shutdown(wait=False, cancel_futures=True)
