"""A stream's contacts as CSV."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from decoder.wire import Message
from shapes.errors import OutputError

COLUMNS = (
    "sequence",
    "timestamp_s",
    "valid",
    "contacts",
    "contact",
    "force_N",
    "x_mm",
    "y_mm",
    "z_mm",
    "markers",
)


class Recorder:
    """One row for each contact of each frame; a frame without any has one, with ``contacts`` 0.

    Every frame is handed to the system at once: a kill loses none before it.

    Parameters
    ----------
    path : Path
        File to make.

    Raises
    ------
    OutputError
        If it is there already, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows = 0
        try:
            self._file = path.open("x", encoding="utf-8", newline="")
        except FileExistsError:
            raise OutputError(
                f"{path} is there already; give --record another name, or remove it"
            ) from None
        except OSError as error:
            raise OutputError(f"{path} cannot be written ({error.strerror})") from None
        self._put([COLUMNS])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def add(self, message: Message) -> None:
        """Write a frame's rows.

        Raises
        ------
        OutputError
            If the disk takes no more.
        """
        contacts = message["contacts"]
        head = (
            message["sequence"],
            message["timestamp_s"],
            int(message["valid"]),
            len(contacts),
        )
        rows = [
            (
                *head,
                number,
                contact["force_N"],
                *contact["position_mm"],
                " ".join(map(str, contact["markers"])),
            )
            for number, contact in enumerate(contacts)
        ]
        self._put(rows or [(*head, "", "", "", "", "", "")])
        self.rows += len(rows) or 1

    def _put(self, rows: Sequence[tuple[object, ...]]) -> None:
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerows(rows)
        try:
            self._file.write(text.getvalue())
            self._file.flush()
        except OSError as error:
            raise OutputError(f"{self._path} cannot be written ({error.strerror})") from None
