"""Pages that people read: the report, comparisons, the studio, hardening of the readers, the wheel.

``python -m benchmarks.page [--quick] [--parts report,compare,help,studio,fuzz,faults,wheel]``
"""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from importlib.util import find_spec

from benchmarks import page_report
from benchmarks.harness import Table, run_parts

OTHERS = ("studio", "fuzz", "faults", "wheel")
"""Parts that are in modules of their own, ``page_NAME.NAME(table, quick)``."""


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts by name, in order."""
    works: dict[str, Callable[..., None]] = {
        "report": page_report.report,
        "compare": page_report.compare,
        "help": page_report.help_time,
    }
    for name in OTHERS:
        module = f"benchmarks.page_{name}"
        if find_spec(module) is not None:
            works[name] = getattr(import_module(module), name)
    return {name: partial(work, quick=quick) for name, work in works.items()}


if __name__ == "__main__":
    run_parts("page", parts, __doc__ or "")
