"""What this process may use of the machine it runs on."""

import ctypes
import gc
from contextlib import suppress
from pathlib import Path


def available_memory_MB() -> float:
    """Memory that can be taken without swapping, within the limit of a container (cgroup v2)."""
    fields = dict(
        line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines() if ":" in line
    )
    available = float(fields["MemAvailable"].split()[0]) / 1024.0
    group = Path("/sys/fs/cgroup")
    # "max" where there is no limit, and no such files without cgroups.
    with suppress(OSError, ValueError):
        limit = int((group / "memory.max").read_text())
        used = int((group / "memory.current").read_text())
        available = min(available, max(limit - used, 0) / 2**20)
    return available


def release_memory() -> None:
    """Give freed memory back to the system (GNU C library)."""
    gc.collect()
    with suppress(OSError, AttributeError):  # another C library
        ctypes.CDLL(None).malloc_trim(0)
