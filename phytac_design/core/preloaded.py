"""Imported by the server from which workers are forked: does once what takes time in each of them.

It imports the module that :data:`.threads.PRELOAD` names, and loads Numba's registries, which the
first kernel needs. Looking for garbage among all that takes 0.1 s meanwhile, and 70 ms a collection
later, and would copy the memory that workers share.
"""

import gc
import os
from importlib import import_module

from phytac_design.core.threads import PRELOAD


def _first() -> int:
    return 0


gc.disable()
try:
    import_module(os.environ[PRELOAD])
    import_module("phytac_design.core.kernels").kernel(_first)()
    gc.freeze()
finally:
    gc.enable()
