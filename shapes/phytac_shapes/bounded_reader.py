"""Files from elsewhere, read without harm: no pipe, no device, no more bytes than they may have.

Whatever a path is, only ``OSError`` comes out, with a ``strerror`` that says why; whatever a text
is, only ``ValueError``.
"""

import errno
import os
import stat
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

TEXT_BYTES_MAX = 1 << 24
"""Largest text file that is read: some hundred times the largest shipped one."""
KEY_PARTS_MAX = 64
"""Most names in one dotted key; a parser's work grows with the square of their number."""
PROBLEMS_MAX, LETTERS_MAX = 20, 600
"""Problems of one file that a message tells, and letters of each."""


def joined(problems: Iterable[str]) -> str:
    """Problems of a file as one line, each of them once, cut where nobody would read on."""
    lines = list(dict.fromkeys(problems))
    out = [line if len(line) <= LETTERS_MAX else f"{line[:LETTERS_MAX]}…" for line in lines]
    more = len(out) - PROBLEMS_MAX
    return "; ".join(out[:PROBLEMS_MAX]) + (f"; and {more} more" if more > 0 else "")


def read_bytes(path: Path, *, bytes_max: int = TEXT_BYTES_MAX) -> bytes:
    """Bytes of a regular file.

    Raises
    ------
    OSError
        If it cannot be read, is no regular file, or is larger than ``bytes_max``.
    """
    with _opened(path, bytes_max) as file:
        # Not bytes_max: that much would be set aside at once.
        return file.read(os.fstat(file.fileno()).st_size)


def check_file(path: Path, *, bytes_max: int) -> None:
    """Check a file that a library is to open by its name.

    Raises
    ------
    OSError
        See :func:`read_bytes`.
    """
    _opened(path, bytes_max).close()


def _opened(path: Path, bytes_max: int) -> BinaryIO:
    try:
        # A pipe that nobody writes to would otherwise wait here for ever.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except ValueError:
        raise OSError(errno.EINVAL, "its name holds a character that no name has") from None
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


def read_text(path: Path, *, encoding: str = "utf-8", bytes_max: int = TEXT_BYTES_MAX) -> str:
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


def toml_table(text: str) -> dict[str, Any]:
    """Table of a TOML text.

    Raises
    ------
    ValueError
        If it is not TOML, or nested too deeply, or a number in it has thousands of digits.
    """
    for line in text.splitlines():
        if line.count(".") > KEY_PARTS_MAX and _parts(line) > KEY_PARTS_MAX:
            raise ValueError(f"a key has more than {KEY_PARTS_MAX} names joined by dots")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None


def _parts(line: str) -> int:
    """Most names that a key in this line may have."""
    keys = line.split("=")
    if not line.lstrip().startswith("["):
        # Behind the last sign stands a value.
        keys.pop()
    starts = [max(key.rfind(","), key.rfind("{")) + 1 for key in keys]
    return max((key.count(".", at) for key, at in zip(keys, starts, strict=True)), default=0)
