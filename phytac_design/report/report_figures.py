"""Figures of the report: maps of one sensor, charts, and the pictures that the stages wrote."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from textwrap import wrap
from typing import Any

import numpy as np

from phytac_design.core import html as page
from phytac_design.core.figures import new_figure, png
from phytac_design.engine.stage import Context, thumbnail_path
from phytac_design.geometry import flat_map
from phytac_design.layout.markers import Markers
from phytac_shapes.arrays import BoolArray, FloatArray

INK = {
    "blue": "#1c48d6",
    "green": "#18a83e",
    "yellow": "#c9a400",
    "magenta": "#c2189b",
    "cyan": "#0fa3b1",
}


@dataclass(frozen=True)
class MapLayout:
    """Margins of a map, and width and distance of its colour bar, inches."""

    left_in: float = 0.85
    right_in: float = 1.0
    below_in: float = 0.65
    above_in: float = 0.15
    bar_in: float = 0.16
    gap_in: float = 0.1


MAP = MapLayout()


def paint_of_each(colours: Sequence[str], markers: Markers) -> list[str]:
    """Paint of each marker, of a layout's ``colours``."""
    return [colours[index % len(colours)] for index in markers.colour]


def map_size_in(flat: flat_map.FlatMap) -> tuple[float, float]:
    """Width and height of a map, inches: the longer one 3.9, so that two fit side by side."""
    wide, tall = (flat.limits[1] - flat.limits[0]).tolist()
    scale = 3.9 / max(wide, tall)
    return max(wide * scale, 0.5), max(tall * scale, 0.5)


def draw_map(axes: Any, flat: flat_map.FlatMap) -> None:
    """Set up axes for a map: limits, sense, true aspect, labels and the outline."""
    for edge in flat.outline:
        axes.plot(*edge.T, color="#b5b5b5", linewidth=0.9, zorder=1)
    (x0, y0), (x1, y1) = flat.limits
    axes.set(xlim=(x0, x1), ylim=(y1, y0) if flat.y_down else (y0, y1), aspect="equal")
    axes.set(xlabel=flat.x_label, ylabel=flat.y_label)


class ValueMap:
    """Markers on a map, filled by a value, edged by their paint; the bar is as tall as the map.

    It is drawn again and again with other values: most of the time of a picture goes into its
    axes.

    Parameters
    ----------
    flat : flat_map.FlatMap
        Places of the n markers.
    colours : list of str
        Paint of each marker.
    """

    def __init__(self, flat: flat_map.FlatMap, colours: Sequence[str]) -> None:
        self.flat = flat
        self.edge = np.array([INK.get(name, "black") for name in colours])
        wide, tall = map_size_in(flat)
        size = MAP.left_in + wide + MAP.right_in, MAP.below_in + tall + MAP.above_in
        self.figure = new_figure(size, constrained=False)

        def box(left: float, width: float) -> Any:
            rectangle = (left / size[0], MAP.below_in / size[1], width / size[0], tall / size[1])
            return self.figure.add_axes(rectangle)

        self.axes, self.side = (
            box(MAP.left_in, wide),
            box(MAP.left_in + wide + MAP.gap_in, MAP.bar_in),
        )
        self.bar: Any = None
        draw_map(self.axes, flat)
        _break_labels(self.axes, wide, tall)
        area = float(np.prod(np.ptp(flat.points[np.isfinite(flat.points[:, 0])], axis=0)))
        per_unit = 72.0 * wide / float(flat.limits[1, 0] - flat.limits[0, 0])
        # Dots are half as wide as the markers' spacing on the map.
        spacing_pt = np.sqrt(area / max(len(flat.points), 1)) * per_unit
        self.width_pt = float(np.clip(0.5 * spacing_pt, 2.5, 8.0))

    def png(
        self,
        values: FloatArray,
        *,
        label: str,
        marked: BoolArray | None = None,
        cross: FloatArray | None = None,
    ) -> bytes:
        """PNG of the map.

        Parameters
        ----------
        values : (n,) float
            What the fill shows; markers without a finite value are left hollow.
        label : str
            Of the colour bar.
        marked : (n,) bool, optional
            Markers to put a red ring around.
        cross : (2,) float, optional
            Place to mark with a cross.
        """
        known = np.isfinite(values)
        low, high = (
            (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
        )
        if high - low <= 1e-9 * max(abs(high), 1e-300):  # a constant: a range from zero
            low, high = (0.0, high) if high > 0.0 else (0.0, 1.0)
        places, width_pt = self.flat.points, self.width_pt
        style = {"s": width_pt**2, "linewidths": 0.16 * width_pt, "zorder": 3}
        colour = {"c": values[known], "vmin": low, "vmax": high, "cmap": "viridis"}
        scatter, edge = self.axes.scatter, self.edge
        dots = scatter(*places[known].T, edgecolors=edge[known], **style, **colour)
        drawn = [dots]
        drawn += [scatter(*places[~known].T, facecolors="none", edgecolors=edge[~known], **style)]
        if marked is not None and marked.any():
            ring = {"facecolors": "none", "edgecolors": "#d00000", "linewidths": 1.2, "zorder": 4}
            drawn += [scatter(*places[marked].T, s=(1.7 * width_pt) ** 2, **ring)]
        if cross is not None:
            thick = {"markersize": 11, "markeredgewidth": 2, "zorder": 5}
            drawn += self.axes.plot(*cross, marker="x", color="#d00000", **thick)
        if self.bar is None:
            self.bar = self.figure.colorbar(dots, cax=self.side)
        self.bar.update_normal(dots)
        self.bar.set_label(label)
        data = png(self.figure)
        for each in drawn:
            each.remove()
        return data


def _break_labels(axes: Any, wide: float, tall: float) -> None:
    """Break axis labels that are longer than their side."""
    for axis, side in ((axes.xaxis, wide), (axes.yaxis, tall)):
        # About 13 letters of 10 pt to the inch.
        lines = wrap(axis.get_label_text(), max(int(13.0 * side), 8))
        axis.set_label_text("\n".join(lines), fontsize=10.0)


def error_bars(table: Mapping[str, Mapping[str, Any]], marks: Mapping[str, str]) -> bytes:
    """Relative error of each estimator below and from 5 N, in per cent.

    ``marks`` holds the footnote signs of estimators.
    """
    figure = new_figure((6.4, 3.2), constrained=False)
    axes = figure.add_axes((0.12, 0.1, 0.86, 0.78))
    names = list(table)
    place = np.arange(len(names))
    shown: list[float] = []
    for shift, (group, label) in enumerate(
        (("below_5N", "contacts below 5 N"), ("from_5N", "contacts from 5 N"))
    ):
        errors = [table[name][group]["relative_error"] for name in names]
        values = 100.0 * np.array(errors, dtype=np.float64)
        shown += values[np.isfinite(values) & (values > 0.0)].tolist()
        axes.bar(place + 0.4 * shift - 0.2, np.nan_to_num(values), 0.38, label=label)
    if shown and max(shown) > 30.0 * min(shown):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")  # 10, not a power
        axes.yaxis.set_minor_formatter("")
        axes.set_ylim(min(shown) / 2.0, 2.0 * max(shown))
    axes.set_xticks(place, [name.replace("_", " ") + marks.get(name, "") for name in names])
    axes.set_ylabel("mean relative error (%)")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False)
    axes.grid(axis="y", alpha=0.3)
    return png(figure)


@dataclass(frozen=True)
class Drawing:
    """Draws the markers of one sensor on its maps."""

    context: Context

    @cached_property
    def colours(self) -> list[str]:
        """Paint of each marker."""
        return paint_of_each(self.context.design.layout.colours, self.context.markers)

    @cached_property
    def flat(self) -> flat_map.FlatMap:
        """Map of the surface."""
        return flat_map.flat_map(self.context.surface, self.context.markers.uv)

    @cached_property
    def picture(self) -> flat_map.FlatMap | None:
        """Map of the camera's picture, for shapes that face their one camera."""
        if flat_map.surface_topology(self.context.surface) == "tube":
            return None
        camera = self.context.design.camera
        pixels = self.context.arrays("views")["rest_px"]
        return flat_map.picture_map(pixels, (camera.width_px, camera.height_px))

    @cached_property
    def _on_flat(self) -> ValueMap:
        return ValueMap(self.flat, self.colours)

    @cached_property
    def _in_picture(self) -> ValueMap | None:
        return ValueMap(self.picture, self.colours) if self.picture else None

    def layout_png(self) -> bytes:
        """PNG of the receptors' heights on the surface's map."""
        height = self.context.markers.height_mm
        return self._on_flat.png(height, label="receptor height (mm)")

    def maps(
        self,
        values: FloatArray,
        caption: str,
        label: str,
        *,
        name: str,
        cross: FloatArray | None = None,
        marked: BoolArray | None = None,
        in_picture: bool = False,
    ) -> str:
        """Figure of values (n,) on the surface's map.

        Parameters
        ----------
        name : str
            Of its file, without an ending.
        cross : (2,) float, optional
            Chart position to mark with a cross.
        marked : (n,) bool, optional
            Markers to put a red ring around.
        in_picture : bool
            For shapes that face the camera, show them in its picture as well.
        """
        flat, out = self.flat, ""
        at = (
            None
            if cross is None
            else flat_map.flat_map(self.context.surface, cross[None]).points[0]
        )
        data = self._on_flat.png(values, label=label, marked=marked, cross=at)
        out += page.figure(data, f"{caption}; {flat.note}", name=f"{name}.png")
        if in_picture and self._in_picture and self.picture:
            data = self._in_picture.png(values, label=label, marked=marked)
            note = f"{caption}; {self.picture.note}"
            out += page.figure(data, note, name=f"{name}_picture.png")
        return out


def photo(context: Context, stage: str, name: str, caption: str) -> str:
    """Figure of a picture that a stage wrote; "" if it wrote none."""
    path = thumbnail_path(context.folders[stage], name)
    if not path.is_file():
        return ""
    return page.figure(path.read_bytes(), caption, "jpeg", name=path.name)


def of_camera(report: Mapping[str, Any], number: int) -> str:
    """Text that names one of two cameras; "" if there is one."""
    cameras = report["cameras"]
    return f", {cameras[number]['end']} camera" if len(cameras) > 1 else ""
