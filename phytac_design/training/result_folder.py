"""A result's own folder: claimed before long work, written whole or not at all."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from phytac_shapes.errors import OutputError


@contextmanager
def reserve_folder(out: Path, table: str, design: str, *, force: bool) -> Iterator[None]:
    """Make a folder for the work inside, or refuse one that holds something else.

    If the work fails and has written nothing, the folder goes again.

    Parameters
    ----------
    out : Path
        The folder.
    table : str
        JSON file that marks it as such a result; its ``design`` names whose.
    design : str
        Name of the design.
    force : bool
        Take it all the same.

    Raises
    ------
    OutputError
        If it holds something else and ``force`` is not set, or cannot be written.
    """
    try:
        if not force and out.is_dir() and any(out.iterdir()):
            other = _design_in(out / table)
            if other is None:
                raise OutputError(
                    f"{out} is not empty and holds no {table}; choose another --out, or use --force"
                )
            if other != design:
                raise OutputError(
                    f"{out} belongs to the design {other!r}, not {design!r}; choose another --out, "
                    "or overwrite it with --force"
                )
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error.strerror}; choose another --out") from None
    try:
        yield
    finally:
        if not any(out.iterdir()):
            out.rmdir()


def _design_in(table: Path) -> str | None:
    """Name of the design of a result, "" if its table cannot be read, None if it has none."""
    if not table.is_file():
        return None
    try:
        return str(json.loads(table.read_text(encoding="utf-8"))["design"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""


@contextmanager
def write_folder(out: Path, table: str) -> Iterator[Path]:
    """A folder to write files into, which then move to ``out``, the table last.

    Raises
    ------
    OutputError
        If they cannot be written.
    """
    scratch = Path()
    try:
        scratch = Path(tempfile.mkdtemp(prefix=".part-", dir=out))
        yield scratch
        paths = sorted(scratch.iterdir(), key=lambda item: (item.name == table, item.name))
        # A copy has the user's own permissions; some writers let only the owner read. All are made
        # before the first takes its place: a full disk leaves what was there.
        copies = [shutil.copyfile(path, scratch / f"{path.name}.copy") for path in paths]
        (out / table).unlink(missing_ok=True)
        for path, copy in zip(paths, copies, strict=True):
            copy.replace(out / path.name)
    except OSError as error:
        raise OutputError(
            f"cannot write {out}: {error.strerror}; make room, or choose another --out"
        ) from None
    finally:
        if scratch != Path():
            shutil.rmtree(scratch, ignore_errors=True)
