"""Work of which only the newest counts: each tab's earlier requests stop when a later one comes."""

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import TypeVar

Result = TypeVar("Result")
TABS_MAX = 64
"""Tabs whose newest request is remembered."""


class StaleError(Exception):
    """A later request of the same tab has taken this one's place."""


class Turn:
    """One request's place; work asks between its steps whether it still counts."""

    def __init__(self) -> None:
        self._stale = Event()

    def cancel(self) -> None:
        """Let the work stop at its next step."""
        self._stale.set()

    def check(self) -> None:
        """Go on only if no later request has come.

        Raises
        ------
        StaleError
            If one has.
        """
        if self._stale.is_set():
            raise StaleError


class Turns:
    """A thread that takes requests one by one and skips those that a later one has replaced."""

    def __init__(self, name: str) -> None:
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
        self._newest: OrderedDict[str, Turn] = OrderedDict()

    async def run(self, tab: str, work: Callable[[Turn], Result]) -> Result:
        """Result of ``work`` for a tab.

        Raises
        ------
        StaleError
            If a later request of the tab came first.
        """
        self.cancel(tab)
        turn = self._newest[tab] = Turn()
        while len(self._newest) > TABS_MAX:
            self._newest.popitem(last=False)[1].cancel()

        def started() -> Result:
            turn.check()
            return work(turn)

        try:
            return await asyncio.get_running_loop().run_in_executor(self._pool, started)
        finally:
            if self._newest.get(tab) is turn:
                del self._newest[tab]

    def cancel(self, tab: str) -> None:
        """Let a tab's request stop, if there is one."""
        old = self._newest.pop(tab, None)
        if old is not None:
            old.cancel()

    def close(self) -> None:
        """Let all work stop at its next step; nothing new is taken."""
        for turn in self._newest.values():
            turn.cancel()
        self._pool.shutdown(wait=False, cancel_futures=True)
