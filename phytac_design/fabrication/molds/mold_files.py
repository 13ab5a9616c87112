"""STL files and the table of cavities of a set of molds, each mold checked before."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from phytac_design.fabrication.bill import csv_text
from phytac_design.fabrication.molds.audit import (
    audit_facts,
    audit_set,
    check_mold,
    fine_sections,
    volumes_mm3,
)
from phytac_design.fabrication.molds.make import MoldSet
from phytac_design.fabrication.molds.plate_grid import Run
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.solids.mesh_export import check_solid, stl_bytes


@dataclass(kw_only=True)
class MoldFiles:
    """Files of molds that passed their checks.

    Attributes
    ----------
    contents : dict of str to bytes
        Path within a build to content.
    sets : list of dict
        Measurements of each set.
    poured_mm3 : list of dict
        Rubber and silicone of one casting of each.
    """

    contents: dict[str, bytes] = field(default_factory=dict)
    sets: list[dict[str, Any]] = field(default_factory=list)
    poured_mm3: list[dict[str, float]] = field(default_factory=list)


def mold_files(
    made: list[MoldSet], switches: SwitchSet, *, progress: Callable[[str], None]
) -> MoldFiles:
    """Check molds and make their files: ``mold/*.stl`` and ``mold/cavities.csv``.

    Raises
    ------
    NumericalError
        If a mold does not release or close, or holds the wrong shape.
    """
    fine, out = fine_sections(switches), MoldFiles()
    for each in made:
        progress(f"mold: set {each.plan.number} of {each.plan.total}")
        audit = audit_set(each, fine)
        check_mold(each, audit)
        out.sets.append(audit_facts(each, audit))
        out.poured_mm3.append(volumes_mm3(each, audit, fine))
        for name, mesh in each.printed.items():
            file = f"mold/{name}_{each.plan.number}.stl"
            check_solid(mesh, file)
            out.contents[file] = stl_bytes(mesh)
    out.contents["mold/cavities.csv"] = _table(made, switches).encode()
    return out


def _table(made: list[MoldSet], switches: SwitchSet) -> str:
    """CSV of the cavities of each kind of switch."""
    rows = [
        [
            each.plan.number,
            f"{line + 1:.6g}",
            f"{first + 1:.6g}",
            count,
            each.sizes.labels[item.kind],
            f"{switches.lengths_mm[item.kind[1]]:.1f}",
            f"{switches.threshold_N[item.kind[0]]:g}",
        ]
        for each in made
        for item in each.plan.runs
        for first, line, count in _runs(item)
    ]
    columns = ("set", "line", "first", "count", "label", "length_mm", "threshold_N")
    return csv_text(columns, rows)


def _runs(run: Run) -> list[tuple[float, float, int]]:
    """First cell, line and cells of a run; each place of a strip for itself."""
    if run.places:
        return [(column, line, 1) for column, line in run.places]
    return [(run.start, run.line, run.count)]
