"""Files and figures of strips: each different strip as STL, and which marker is on which."""

from typing import Any

from phytac_design.fabrication.bill import csv_text
from phytac_design.fabrication.switch_strips import StripSet, strip_label, strip_mesh
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_export import check_solid, stl_bytes


def strip_files(sensor: Sensor, strips: StripSet) -> dict[str, bytes]:
    """``mold/strip_S*.stl``, as cast and not shrunk, and ``mold/strips.csv``."""
    out = {}
    for number in strips.numbers:
        if strips.alike(number)[0].count > 1:
            file, mesh = f"mold/strip_{strip_label(number)}.stl", strip_mesh(strips, number)
            check_solid(mesh, file)
            out[file] = stl_bytes(mesh)
    markers, rows = sensor.markers, []
    for piece, strip in enumerate(strips.strips, start=1):
        for marker, (x, y) in zip(strip.markers.tolist(), strip.flat_mm, strict=True):
            place = [int(markers.row[marker]), int(markers.column[marker])]
            length = float(strips.switches.lengths_mm[strips.switches.length[marker]])
            rows.append(
                [piece, strip_label(strip.number), marker]
                + (place if markers.in_rows else ["", ""])
                + [f"{length:.1f}", f"{x + 0.0:.3f}", f"{y + 0.0:.3f}"]
            )
    columns = (
        "strip",
        "label",
        "marker",
        "row",
        "column",
        "length_mm",
        "flat_x_mm",
        "flat_y_mm",
    )
    return out | {"mold/strips.csv": csv_text(columns, rows).encode()}


def strip_facts(strips: StripSet) -> dict[str, Any]:
    """Plain figures of all strips."""
    webs = strips.webs
    return {
        "strips": len(webs),
        "different": len({strip.number for strip in webs}),
        "single": strips.singles,
        "why_single": sorted(set(strips.why_single.values())),
        "stretch": max(strip.stretch_max for strip in webs),
        "bending": max(strip.bending_max for strip in webs),
        "strain": max(strip.strain_max for strip in webs),
        "clearance_mm": min(strip.clearance_mm for strip in webs),
    }
