"""Imported by the server from which workers are forked: does once what takes time in each of them.

It imports the module that :data:`.threads.PRELOAD` names, and loads Numba's registries, which the
first kernel needs. Looking for garbage among all that takes 0.1 s meanwhile, and 70 ms a collection
later, and would copy the memory that workers share.
"""

import gc
import os
import signal
from contextlib import suppress
from importlib import import_module

from phytac_design.core.threads import PRELOAD


def _first() -> int:
    return 0


def _preload(module: str) -> None:
    gc.disable()
    # Ctrl-C is for the command; once all is imported, the server ignores it by itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    # What cannot be imported here fails again, and is reported, in the process that needs it.
    with suppress(Exception):
        import_module(module)
        import_module("phytac_design.core.kernels").kernel(_first)()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    gc.freeze()
    gc.enable()


# A server that replaces one which died is started without it, and with other numbers of threads:
# its workers import for themselves.
if PRELOAD in os.environ:
    name, _, path = os.environ.pop(PRELOAD).partition(os.pathsep)
    os.environ["PYTHONPATH"] = path
    if not path:
        del os.environ["PYTHONPATH"]
    _preload(name)
