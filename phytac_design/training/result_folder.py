"""A result's own folder: reserved before long work, written completely or not at all."""

import errno
import fcntl
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phytac_shapes.errors import OutputError


@contextmanager
def reserve_folder(out: Path, table: str, design: str, *, force: bool) -> Iterator[None]:
    """Create a folder for the work inside, or reject one that holds something else.

    If the work fails and has written nothing, the folder is removed.

    Parameters
    ----------
    out : Path
        The folder.
    table : str
        JSON file that marks it as such a result; its ``design`` is the design's name.
    design : str
        Name of the design.
    force : bool
        Accept any folder.

    Raises
    ------
    OutputError
        If it holds something else and ``force`` is not set, cannot be written, or is in use.
    """
    try:
        if not force and out.is_dir() and any(out.iterdir()):
            if not (out / table).is_file():
                raise OutputError(
                    "output-foreign",
                    f"{out} is not empty and holds no {table}; choose another --out, or use "
                    "--force",
                )
            other = _design_of(out / table)
            if other != design:
                raise OutputError(
                    "output-foreign",
                    f"{out} belongs to the design {other!r}, not {design!r}; choose another --out, "
                    "or overwrite it with --force",
                )
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise OutputError(
            "output-not-writable", f"cannot write {out}: {error.strerror}; choose another --out"
        ) from None
    with _locked(out):
        try:
            yield
        finally:
            if not any(out.iterdir()):
                out.rmdir()


@contextmanager
def _locked(out: Path) -> Iterator[None]:
    """Keep other runs out of a folder; of two, the last to end would replace the other's result."""
    handle = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Some network disks have no locks.
        if error.errno in {errno.EAGAIN, errno.EACCES}:
            os.close(handle)
            raise OutputError(
                "output-locked",
                f"another run is writing to {out}; wait for it, or choose another --out",
            ) from None
    try:
        yield
    finally:
        os.close(handle)


def _design_of(table: Path) -> str:
    """Return the name of a result's design; "" if its table cannot be read."""
    try:
        return str(json.loads(table.read_text(encoding="utf-8"))["design"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


@contextmanager
def write_folder(out: Path, table: str) -> Iterator[Path]:
    """Yield a folder to write files into; they are then moved to ``out``, the table last.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    try:
        with tempfile.TemporaryDirectory(
            prefix=".part-", dir=out, ignore_cleanup_errors=True
        ) as name:
            yield Path(name)
            paths = sorted(Path(name).iterdir(), key=lambda item: (item.name == table, item.name))
            # Copies have the user's default permissions; some writers set stricter ones. All are
            # made before the first is moved: a full disk leaves the old files.
            copies = [shutil.copyfile(path, f"{path}.copy") for path in paths]
            (out / table).unlink(missing_ok=True)
            for path, copy in zip(paths, copies, strict=True):
                Path(copy).replace(out / path.name)
    except OSError as error:
        raise OutputError(
            "output-not-writable",
            f"cannot write {out}: {error.strerror}; make room, or choose another --out",
        ) from None
