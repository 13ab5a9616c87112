"""Whose decoder it is, written on a finished bundle: training asks for no name."""

import json
from collections.abc import Sequence
from pathlib import Path

from phytac_decoder.estimation.force_regions import Region, regions_to_table


def stamp_bundle(
    folder: Path, *, design: str, design_hash: str, regions: Sequence[Region] = ()
) -> None:
    """Write the design's name, its hash and its named regions into a bundle's ``bundle.json``."""
    path = folder / "bundle.json"
    meta = json.loads(path.read_text(encoding="utf-8"))
    meta |= {"design": design, "design_hash": design_hash}
    meta.pop("regions", None)
    if regions:
        meta["regions"] = regions_to_table(regions)
    text = json.dumps(meta, indent=1, sort_keys=True, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
