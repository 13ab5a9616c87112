"""Bounded reading of untrusted files: no pipes, no devices, no more bytes than allowed.

A bad path raises ``OSError`` with the reason in ``strerror``; a bad text raises ``ValueError``.
"""

import errno
import os
import re
import stat
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

PROBLEMS_MAX, LETTERS_MAX = 20, 600
"""Problems of one file listed in a message, and characters of each."""


def joined(problems: Iterable[str]) -> str:
    """Problems of a file as one line, without duplicates, truncated."""
    lines = list(dict.fromkeys(problems))
    out = [line if len(line) <= LETTERS_MAX else f"{line[:LETTERS_MAX]}…" for line in lines]
    more = len(out) - PROBLEMS_MAX
    return "; ".join(out[:PROBLEMS_MAX]) + (f"; and {more} more" if more > 0 else "")


def read_bytes(path: Path, *, bytes_max: int = 1 << 24) -> bytes:
    """Bytes of a regular file; at most some hundred times the largest shipped one.

    Raises
    ------
    OSError
        If it cannot be read, is no regular file, or is larger than ``bytes_max``.
    """
    with _opened(path, bytes_max) as file:
        # Reading bytes_max would allocate that much at once.
        return file.read(os.fstat(file.fileno()).st_size)


def check_file(path: Path, *, bytes_max: int) -> None:
    """Check a file that a library will open by name.

    Raises
    ------
    OSError
        See :func:`read_bytes`.
    """
    _opened(path, bytes_max).close()


def _opened(path: Path, bytes_max: int) -> BinaryIO:
    try:
        # Without O_NONBLOCK a pipe without a writer would block for ever.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except ValueError:
        raise OSError(
            errno.EINVAL, "its name holds a character that is not allowed in names"
        ) from None
    status = os.fstat(handle)
    if stat.S_ISREG(status.st_mode) and status.st_size <= bytes_max:
        return os.fdopen(handle, "rb")
    os.close(handle)
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "it is no regular file")
    sizes = f"it has {status.st_size} bytes, more than the {bytes_max} allowed"
    raise OSError(errno.EFBIG, sizes)


def read_text(path: Path, *, encoding: str = "utf-8", bytes_max: int = 1 << 24) -> str:
    """Text of a regular file, its line ends made plain line feeds.

    Raises
    ------
    OSError
        See :func:`read_bytes`.
    UnicodeDecodeError
        If it is not text in that encoding.
    """
    text = read_bytes(path, bytes_max=bytes_max).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def doubt_about_end(path: Path) -> str:
    """Return why the last row of a table that can be read may not be whole, or ""."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(max(size - 1, 0))
        end = file.read(1)
    if end in {b"\n", b"\r", b""}:
        return ""
    return (
        f"{path} does not end with a line break: its last number may have been cut off; check the "
        "last row, and end it with a line break"
    )


def toml_table(text: str) -> dict[str, Any]:
    """Table of a TOML text.

    Raises
    ------
    ValueError
        If it is not TOML, or nested too deeply, or a number in it has thousands of digits.
    """
    # A parser's work grows with the square of the number of names in one dotted key.
    name = r"""(?:"[^"\n]*+"|'[^'\n]*+'|[^\s.,="'\[\]{}]++)"""
    if re.search(rf"(?:^|[\[{{,])[ \t]*(?:{name}[ \t]*\.[ \t]*){{64}}", text, re.MULTILINE):
        raise ValueError("a key has more than 64 names joined by dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None
