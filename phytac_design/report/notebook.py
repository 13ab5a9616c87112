"""HTML of surfaces, designs, markers and builds in a notebook: key figures and a map.

IPython calls these functions; :mod:`phytac_design` registers them when it is imported in a
notebook.
"""

import json
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Protocol

import numpy as np

from phytac_design.core.figures import new_figure, png
from phytac_design.core.html import figure, number, table
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.geometry.flat_map import flat_map
from phytac_design.layout.marker_layout import make_markers
from phytac_design.layout.markers import Markers
from phytac_design.report.report_figures import ValueMap, draw_map, map_size_in, paint_of_each
from phytac_shapes import Surface
from phytac_shapes.errors import PhytacError


class Built(Protocol):
    """A finished build, see :class:`phytac_design.stages.build.BuildResult`."""

    out: Path
    ran: tuple[str, ...]
    cached: tuple[str, ...]
    seconds: float


def card(title: str, rows: Mapping[str, object], picture: str = "") -> str:
    """Title, a table of names and values, and a picture as HTML."""
    figures = table(("figure", "value"), list(rows.items()))
    return f"<div><p><b>{escape(title)}</b></p>{figures}{picture}</div>"


def surface_html(surface: Surface) -> str:
    """Family, facts, and the unrolled chart of a surface."""
    low, high = surface.bounds_mm()
    rows = {**surface.facts(), "box_mm": _box(high - low)}
    return card(f"{surface.name} (surface)", rows, chart_map(surface))


def chart_map(surface: Surface) -> str:
    """Figure of the chart's lines on the flat map."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, 9), np.linspace(v0, v1, 9)
    fine_u, fine_v = np.linspace(u0, u1, 73), np.linspace(v0, v1, 73)
    lines = [np.column_stack([np.full(73, at), fine_v]) for at in u]
    lines += [np.column_stack([fine_u, np.full(73, at)]) for at in v]
    flat = flat_map(surface, np.concatenate(lines))
    wide, tall = map_size_in(flat)
    drawing = new_figure((wide + 0.8, tall + 0.6))
    axes = drawing.add_subplot()
    draw_map(axes, flat)
    for line in flat.points.reshape(len(lines), -1, 2):
        axes.plot(*line.T, color="#b5b5b5", linewidth=0.4)
    return figure(png(drawing), f"unrolled {surface.name}, {flat.note}")


def design_html(design: Design) -> str:
    """Name, key figures and marker map of a design; of one that has no layout, the reason."""
    surface = design.surface()
    area_cm2 = surface.area_mm2() / 100.0
    lens = design.camera
    rows = {
        "shape": f"{design.shape.kind}, {area_cm2:.1f} cm², wall {design.wall.thickness_mm:g} mm",
        "camera": f"{lens.model}, {lens.width_px} × {lens.height_px} px, {lens.ends} end",
    }
    try:
        markers = make_markers(design, surface)
    except PhytacError as error:
        return card(design.name, rows | {"layout": str(error)})
    rows |= {
        "layout": f"{design.layout.kind}, {_counted(markers)}",
        "heights": _heights(markers),
        "density": f"{markers.count / area_cm2:.2f} /cm² of the outer face",
        "switches": f"{design.switch.threshold_N:g} N",
    }
    return card(design.name, rows, design_map(design, markers))


def design_map(design: Design, markers: Markers) -> str:
    """Figure of the markers in their paints on the flat map of the surface, filled by height."""
    flat = flat_map(design.surface(), markers.uv)
    each = paint_of_each(design.layout.colours, markers)
    picture = ValueMap(flat, each).png(markers.height_mm, label="receptor height (mm)")
    return figure(picture, f"{markers.count} markers of {design.name}, {flat.note}")


def markers_html(markers: Markers) -> str:
    """Figures of markers; without their surface they have no map."""
    size = markers.mid_mm.max(axis=0) - markers.mid_mm.min(axis=0)
    rows = {"markers": _counted(markers), "heights": _heights(markers), "box_mm": _box(size)}
    return card("markers", rows)


def build_html(result: Built) -> str:
    """Folder, figures and files of a build, with the map of its design."""
    largest = ("report/report.html", "shell/shell.stl", "shell/shell.step", "decoder/bundle.json")
    rows = {
        "folder": str(result.out),
        "ran": ", ".join(result.ran) or "nothing: all was there",
        "taken from the cache": ", ".join(result.cached) or "nothing",
        "seconds": result.seconds,
        **_report_rows(result.out / "report" / "report.json"),
        "files": ", ".join(name for name in largest if (result.out / name).is_file()),
    }
    return card(f"build of {result.out.name}", rows, _built_map(result.out / "design.toml"))


def _built_map(path: Path) -> str:
    try:
        design = load_design(str(path))
        return design_map(design, make_markers(design, design.surface()))
    except PhytacError:
        return ""


def _report_rows(path: Path) -> dict[str, str]:
    """Key figures of a report, where there is one."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        markers, seen = report["markers"], report["visibility"]
        return {
            "markers": f"{markers['count']}, {markers['density_per_cm2']:.2f} /cm²",
            "hidden, fused": f"{seen['occluded']:g}, {seen['fused']:g}",
        }
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _counted(markers: Markers) -> str:
    rows = len(np.unique(markers.row))
    return f"{markers.count} markers" + (f" in {rows} rows" if markers.in_rows else "")


def _heights(markers: Markers) -> str:
    low, high = float(markers.height_mm.min()), float(markers.height_mm.max())
    return f"{number(low)} to {number(high)} mm"


def _box(size_mm: np.ndarray) -> str:
    return " × ".join(number(float(side)) for side in size_mm)
