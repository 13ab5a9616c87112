"""Lines of the bill of materials, and CSV tables, of all stages."""

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any


def bill_part(
    part: str,
    *,
    file: str = "",
    count: int = 1,
    material: str = "resin",
    volume_mm3: float = 0.0,
    note: str = "",
) -> dict[str, Any]:
    """Line of a parts list; the volume is that of one piece, 0 for bought parts."""
    return {
        "part": part,
        "file": file,
        "count": count,
        "material": material,
        "volume_mm3": volume_mm3,
        "note": note,
    }


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """CSV with a header."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return out.getvalue()
