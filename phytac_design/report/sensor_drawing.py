"""Drawing one sensor: its maps, and the pictures that the stages wrote."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from phytac_decoder.io.recorded_frames import read_image
from phytac_design.core import html as page
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.geometry import flat_map
from phytac_design.report import report_figures
from phytac_shapes.arrays import BoolArray, FloatArray

MARKS = ("", "_far")
"""Suffixes of the picture files of the first and the second camera."""


@dataclass(frozen=True)
class Drawing:
    """Draws the markers of one sensor on its maps."""

    context: Context

    @cached_property
    def colours(self) -> list[str]:
        """Paint of each marker."""
        return report_figures.paint_of_each(
            self.context.design.layout.colours, self.context.markers
        )

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

    def layout_png(self) -> bytes:
        """PNG of the receptors' heights on the surface's map."""
        height = self.context.markers.height_mm
        return report_figures.value_map(
            self.flat, height, label="receptor height (mm)", colours=self.colours
        )

    def on_surface(
        self,
        values: FloatArray,
        caption: str,
        label: str,
        *,
        name: str,
        cross: FloatArray | None = None,
        marked: BoolArray | None = None,
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
        """
        at = (
            None
            if cross is None
            else flat_map.flat_map(self.context.surface, cross[None]).points[0]
        )
        data = report_figures.value_map(
            self.flat, values, label=label, colours=self.colours, marked=marked, cross=at
        )
        return page.figure(data, f"{caption}; {self.flat.note}", name=f"{name}.png")

    def both(
        self,
        values: FloatArray,
        caption: str,
        label: str,
        *,
        name: str,
        cross: FloatArray | None = None,
        marked: BoolArray | None = None,
    ) -> str:
        """Figures on the surface's map and, for shapes that face the camera, in its picture."""
        out = self.on_surface(values, caption, label, name=name, cross=cross, marked=marked)
        if self.picture is None:
            return out
        data = report_figures.value_map(
            self.picture, values, label=label, colours=self.colours, marked=marked
        )
        caption = f"{caption}; {self.picture.note}"
        return out + page.figure(data, caption, name=f"{name}_picture.png")


def photo(context: Context, stage: str, name: str, caption: str) -> str:
    """Figure of a picture that a stage wrote; "" if it wrote none."""
    path = context.folders[stage] / EXPORT / "views" / name
    if not path.is_file():
        return ""
    data = report_figures.thumbnail(read_image(path), 900)
    return page.figure(data, caption, "jpeg", name=f"{path.stem}.jpg")


def of_camera(report: Mapping[str, Any], number: int) -> str:
    """Text that names one of two cameras; "" if there is one."""
    cameras = report["cameras"]
    return f", {cameras[number]['end']} camera" if len(cameras) > 1 else ""
