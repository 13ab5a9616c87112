"""Where results and compiled kernels are kept between runs."""

import os
import tempfile
from pathlib import Path


def cache_root() -> Path:
    """Folder of the cache.

    ``$PHYTAC_CACHE``, or ``phytac`` in the user's cache folder; of a user without a home folder
    (containers, system services), a folder of their own among the temporary files.
    """
    own = os.environ.get("PHYTAC_CACHE")
    if own:
        return Path(own)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "phytac"
    except RuntimeError:
        return Path(tempfile.gettempdir()) / f"phytac-{os.getuid()}"
