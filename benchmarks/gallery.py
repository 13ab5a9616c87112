"""Pictures of every shipped design, for the README: python -m benchmarks.gallery [NAME ...].

One image each from the stages ``views`` and ``resolution`` of a draft build: the camera's view, and
on the report's flat map of the surface the layout, the local density and the force resolution.
"""

import sys
import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.engine import cache
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.geometry import flat_map
from phytac_design.optics.density import density_map
from phytac_design.report import report_figures
from phytac_design.stages.build import build, select_stages
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import NumericalError

mpl.use("Agg")
import matplotlib.pyplot as plt

FOLDER = Path(__file__).parents[1] / "docs" / "images"
DOT, MARKER = 11.0, 22.0
"""Areas of a piece of the surface and of a marker on the maps, points²."""
FORCE_N = 10
STAGES = ("resolution",)


def results_of(name: str) -> Context:
    """A design with the results of the stages that its picture shows, from the cache if there."""
    design = load_design(name)
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0)
    with tempfile.TemporaryDirectory() as out:
        build(design, Path(out) / name, accuracy="draft", only=STAGES, force=True)
    keys: dict[str, str] = {}
    for stage in select_stages(STAGES):
        keys[stage.name] = cache.stage_key(stage.name, stage.inputs(context, keys))
        folder = cache.lookup(stage.name, keys[stage.name])
        if folder is None:
            raise NumericalError(
                "stage-without-result",
                f"{name}: the stage {stage.name} left no result in the cache",
            )
        context.folders[stage.name] = folder
    return context


def gallery_image(context: Context) -> ImageArray:
    """Four pictures of a design in one, (h, w, 3) BGR."""
    design, markers, surface = context.design, context.markers, context.surface
    figure, axes = plt.subplots(2, 2, figsize=(12.0, 9.0), layout="constrained")
    picture = cv2.imread(str(context.folders["views"] / EXPORT / "views" / "camera.png"))
    axes[0, 0].imshow(np.asarray(picture)[:, :, ::-1])
    axes[0, 0].set_axis_off()
    axes[0, 0].set_title(f"{design.name}: the camera's view")
    local = density_map(surface, markers)
    pieces, dots = (flat_map.flat_map(surface, uv) for uv in (local.uv, markers.uv))
    colours = [design.layout.colours[k % len(design.layout.colours)] for k in markers.colour]
    low, high = markers.height_mm.min(), markers.height_mm.max()
    heights = f"{low:.3g} mm" if high - low < 1e-6 else f"{low:.3g} to {high:.3g} mm"

    def draw(axis: Any, title: str, values: FloatArray | None, label: str = "") -> None:
        if values is None:
            axis.scatter(*pieces.points.T, color="#e4e1da", s=DOT, marker="s", linewidths=0)
        else:
            shown = values[local.owner]
            fill = axis.scatter(
                *pieces.points.T, c=shown, s=DOT, marker="s", linewidths=0, vmin=0.0, cmap="viridis"
            )
            # Beside the map and as tall, in shares of it.
            figure.colorbar(fill, cax=axis.inset_axes((1.03, 0.0, 0.045, 1.0)), label=label)
        size = MARKER if values is None else MARKER / 5.0
        axis.scatter(*dots.points.T, color=[report_figures.INK[name] for name in colours], s=size)
        report_figures.draw_map(axis, dots)
        axis.set_title(title)

    draw(axes[0, 1], f"{markers.count} markers, {heights} tall", None)
    draw(axes[1, 0], "local density", local.per_cm2, "markers per cm²")
    force = context.arrays("resolution")[f"force_N_{FORCE_N}"]
    draw(axes[1, 1], f"least standard deviation of a force of {FORCE_N} N", force, "N")
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    plt.close(figure)
    data = np.frombuffer(buffer.getvalue(), np.uint8)
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)


def write_gallery(name: str, folder: Path = FOLDER) -> Path:
    """Write ``gallery_NAME.jpg``, as sharp as 150 kB allow."""
    image = gallery_image(results_of(name))
    path = folder / f"gallery_{name}.jpg"
    for quality in range(88, 30, -6):
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        if len(data) < 150_000:
            break
    path.write_bytes(bytes(data))
    return path


if __name__ == "__main__":
    for wanted in sys.argv[1:] or shipped_designs():
        made = write_gallery(wanted)
        print(made, made.stat().st_size, "bytes")
