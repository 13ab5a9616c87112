"""HTML of surfaces, designs, markers and builds in a notebook: key figures and a map.

IPython calls these functions; :mod:`phytac_design` registers them when it is imported in a
notebook.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from phytac_design.core.notebook_html import card, figure, map_svg
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.geometry.flat_map import flat_map
from phytac_design.layout.marker_layout import make_markers
from phytac_design.layout.markers import Markers
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, IntArray
from phytac_shapes.errors import PhytacError

PAINTS = {
    "blue": "#1c52dc",
    "green": "#18a848",
    "yellow": "#d8b400",
    "magenta": "#c2189b",
    "cyan": "#0fa3b1",
}
PALETTE = tuple(PAINTS.values())
LARGEST = ("report/report.html", "shell/shell.stl", "shell/shell.step", "decoder/bundle.json")
"""Files of a build that are named, where it has them."""
CHART_POINTS = 73
"""Points along each edge of a drawn chart."""
CHART_LINES = 9
"""Lines of the chart drawn each way."""


class Built(Protocol):
    """A finished build, see :class:`phytac_design.stages.build.BuildResult`."""

    out: Path
    ran: tuple[str, ...]
    cached: tuple[str, ...]
    seconds: float


def surface_html(surface: Surface) -> str:
    """Family, facts, and the unrolled chart of a surface."""
    rows = {name: figure(value) for name, value in surface.facts().items()}
    low, high = surface.bounds_mm()
    rows["box_mm"] = " × ".join(figure(side) for side in high - low)
    edges, lines = chart_lines(surface)
    drawing = map_svg(edges, f"unrolled {surface.name}", faint=lines)
    return card(f"{surface.name} (surface)", rows, drawing)


def chart_lines(surface: Surface) -> tuple[list[FloatArray], list[FloatArray]]:
    """Edges, and lines of the chart between them, on the unrolled map: (n, 2) mm each."""
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.linspace(u0, u1, CHART_POINTS), np.linspace(v0, v1, CHART_POINTS)

    def along(at: float) -> FloatArray:
        return surface.unwrap(np.column_stack([u, np.full_like(u, at)]))

    def around(at: float) -> FloatArray:
        return surface.unwrap(np.column_stack([np.full_like(v, at), v]))

    edges = [along(v0), along(v1), around(u0), around(u1)]
    inner_u, inner_v = (
        np.linspace(u0, u1, CHART_LINES)[1:-1],
        np.linspace(v0, v1, CHART_LINES)[1:-1],
    )
    return edges, [*map(around, inner_u.tolist()), *map(along, inner_v.tolist())]


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
    """Inline SVG of the markers in their paints on the flat map of the surface."""
    surface = design.surface()
    flat = flat_map(surface, markers.uv)
    names = design.layout.colours
    return map_svg(
        flat.outline,
        f"{markers.count} markers of {design.name}, {flat.note}",
        points=flat.points,
        colours=[PAINTS[names[k % len(names)]] for k in markers.colour],
        names=_labels(markers),
        radius_mm=design.receptor.diameter_outer_mm / 2.0,
        y_down=flat.y_down,
    )


def markers_html(markers: Markers) -> str:
    """Figures and map of markers that do not know their surface: the chart, stretched to mm."""
    low, high = markers.mid_mm.min(axis=0), markers.mid_mm.max(axis=0)
    rows = {
        "markers": _counted(markers),
        "heights": _heights(markers),
        "box_mm": " × ".join(figure(side) for side in high - low),
    }
    points = chart_mm(markers)
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    drawing = map_svg(
        [box],
        f"{markers.count} markers on their chart: around to the right, along upwards",
        points=points,
        colours=[PALETTE[k % len(PALETTE)] for k in markers.colour],
        names=_labels(markers),
        radius_mm=0.25 * _spacing_mm(markers),
    )
    return card("markers", rows, drawing)


def chart_mm(markers: Markers) -> FloatArray:
    """Chart places as (around, along), (n, 2), each axis stretched by one factor to mm.

    The factors fit the distances between neighbours in space by least squares:
    d² ≈ E·Δu² + G·Δv².
    """
    a, b = _pairs(markers)
    if len(a) == 0:
        return np.asarray(markers.uv[:, ::-1])
    steps = (markers.uv[a] - markers.uv[b]) ** 2
    square = np.sum((markers.mid_mm[a] - markers.mid_mm[b]) ** 2, axis=1)
    # Over a seam the chart jumps; such pairs are the few with the longest steps around.
    near = steps[:, 1] <= 4.0 * np.median(steps[:, 1]) + 1e-12
    metric, *_ = np.linalg.lstsq(steps[near], square[near], rcond=None)
    return np.asarray((markers.uv * np.sqrt(np.maximum(metric, 0.0)))[:, ::-1])


def build_html(result: Built) -> str:
    """Folder, figures and files of a build, with the map of its design."""
    rows = {
        "folder": str(result.out),
        "ran": ", ".join(result.ran) or "nothing: all was there",
        "taken from the cache": ", ".join(result.cached) or "nothing",
        "seconds": figure(result.seconds),
        **_report_rows(result.out / "report" / "report.json"),
        "files": ", ".join(name for name in LARGEST if (result.out / name).is_file()),
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
    return f"{figure(markers.height_mm.min())} to {figure(markers.height_mm.max())} mm"


def _labels(markers: Markers) -> Sequence[str]:
    heights = markers.height_mm.tolist()
    return [f"{k}: {markers.name(k)}, {height:.2f} mm tall" for k, height in enumerate(heights)]


def _pairs(markers: Markers) -> tuple[IntArray, IntArray]:
    first = np.repeat(np.arange(markers.count, dtype=np.int64), markers.neighbours.shape[1])
    second = markers.neighbours.ravel()
    known = second >= 0
    return first[known], second[known]


def _spacing_mm(markers: Markers) -> float:
    a, b = _pairs(markers)
    if len(a) == 0:
        return 1.0
    return float(np.median(np.linalg.norm(markers.mid_mm[a] - markers.mid_mm[b], axis=1)))
