"""The worker's side: takes cases from a pipe, sends their outcomes back."""

import os
from multiprocessing.connection import Connection

# Before numpy loads: workers share the machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

MEMORY_MAX_BYTES = 8 << 30
"""A case that asks for more has failed; the machine must not."""


def serve(pipe: Connection) -> None:
    """Judge cases until the pipe closes."""
    _limit_memory()
    from phytac_design.study.stability.judge import judge
    from phytac_design.study.stability.rooms import ROOMS

    while True:
        try:
            case = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(judge(case, ROOMS[case.room].checks).plain())


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:
        return  # not on this system: cases then share its memory unguarded
    hard = resource.getrlimit(resource.RLIMIT_AS)[1]
    most = MEMORY_MAX_BYTES if hard == resource.RLIM_INFINITY else min(MEMORY_MAX_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
