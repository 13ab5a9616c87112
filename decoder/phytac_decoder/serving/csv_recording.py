"""A stream's contacts, and the forces of its regions, as CSV."""

import contextlib
import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from phytac_decoder.serving.wire_protocol import Message
from phytac_shapes.errors import OutputError

COLUMNS = (
    "sequence", "timestamp_s", "valid", "contacts", "contact", "force_N", "x_mm", "y_mm", "z_mm",
    "markers", "id", "size_mm", "since_s", "region", "sd_N", "shear_x_N", "shear_y_N", "shear_z_N",
    "shear_sd_x_N", "shear_sd_y_N", "shear_sd_z_N", "normal_x", "normal_y", "normal_z",
    "net_force_x_N", "net_force_y_N", "net_force_z_N",
    "net_force_sd_x_N", "net_force_sd_y_N", "net_force_sd_z_N",
    "net_moment_x_Nmm", "net_moment_y_Nmm", "net_moment_z_Nmm",
    "net_moment_sd_x_Nmm", "net_moment_sd_y_Nmm", "net_moment_sd_z_Nmm",
    "moment_about_x_mm", "moment_about_y_mm", "moment_about_z_mm", "warnings",
)  # fmt: skip
FRAME_FIELDS = (
    "net_force_N", "net_force_sd_N", "net_moment_Nmm", "net_moment_sd_Nmm", "moment_about_mm"
)  # fmt: skip
"""Vectors of a frame, which end each of its rows but for the warnings."""


class _CsvWriter:
    """Writes rows of a new CSV file straight to the system: a killed program loses none.

    Parameters
    ----------
    path : Path
        File to make.
    columns : sequence of str
        Its first line.

    Raises
    ------
    OutputError
        If it exists, or cannot be written.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._path = path
        self.rows, self._whole_bytes = 0, 0
        try:
            self._file = path.open("xb", buffering=0)
        except FileExistsError:
            raise OutputError(
                "output-exists",
                f"{path} is there already; choose another name, or remove it",
            ) from None
        except OSError as error:
            raise OutputError(
                "output-not-writable",
                f"{path} cannot be written ({error.strerror}); choose a file in a folder that is "
                "there and may be written to",
            ) from None
        try:
            self._put([columns])
        except OutputError:
            self._file.close()
            path.unlink()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.close()

    def _put(self, rows: Sequence[Sequence[object]]) -> None:
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerows(rows)
        data = text.getvalue().encode()
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            # Half a row would damage those before it.
            with contextlib.suppress(OSError):
                self._file.truncate(self._whole_bytes)
            raise OutputError(
                "output-not-writable", f"{self._path} cannot be written ({error.strerror})"
            ) from None
        self._whole_bytes += len(data)


def _one_line(message: Message) -> str:
    """Warnings of a frame, or why it is not valid."""
    return " ".join("; ".join(message["warnings"]).split())


class Recorder(_CsvWriter):
    """One row for each contact of each frame; a frame without any has one, with ``contacts`` 0."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, COLUMNS)

    def add(self, message: Message) -> None:
        """Write a frame's rows; raises OutputError if the disk is full."""
        contacts = message["contacts"]
        head = (message["sequence"], message["timestamp_s"], int(message["valid"]), len(contacts))
        net = [part for name in FRAME_FIELDS for part in message.get(name, [""] * 3)]
        net.append(_one_line(message))
        rows = [
            (
                *head,
                number,
                contact["force_N"],
                *contact["position_mm"],
                " ".join(map(str, contact["markers"])),
                contact["id"],
                contact["size_mm"],
                contact["since_s"],
                contact.get("region", ""),
                contact.get("sd_N", ""),
                *contact.get("shear_N", [""] * 3),
                *contact.get("shear_sd_N", [""] * 3),
                *contact["normal"],
                *net,
            )
            for number, contact in enumerate(contacts)
        ]
        self._put(rows or [(*head, *[""] * (len(COLUMNS) - len(head) - len(net)), *net)])
        self.rows += len(rows) or 1


class RegionRecorder(_CsvWriter):
    """One row for each frame: the force of every region, by the regions' names."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        columns = [*COLUMNS[:3], "total_N", *(f"region_{name}_N" for name in names), "warnings"]
        super().__init__(path, columns)

    def add(self, message: Message) -> None:
        """Write a frame's row; raises OutputError if the disk is full."""
        forces = [region["force_N"] for region in message["regions"]]
        head = (message["sequence"], message["timestamp_s"], int(message["valid"]))
        self._put([(*head, message["total_N"], *forces, _one_line(message))])
        self.rows += 1
