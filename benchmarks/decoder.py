"""The decoder on held-out contacts and rendered frames, beside the paper; its speed; its stream.

All data are simulated; the paper's figures are of a real sensor.
``python -m benchmarks.decoder [--quick] [--parts a,b]``
"""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import (
    decoder_accuracy,
    decoder_cnn,
    decoder_faults,
    decoder_moving,
    decoder_referee,
    decoder_shapes,
    decoder_speed,
    decoder_stream,
    decoder_tracking,
)
from benchmarks.harness import Table, run_parts
from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import rest_positions
from phytac_design.design.design_file import load_design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.visibility import check_visibility
from phytac_design.stages.build import build
from phytac_shapes.arrays import FloatArray, ImageArray


def add_rest(table: Table, bundle: Bundle, rest: ImageArray, paint_mm: FloatArray) -> None:
    """Rest coordinates from one noisy frame through the geometry's own map, printing exact."""
    seen = rest_positions(bundle, rest)
    # The renderer knows the offset of the marker in the image from the centre of its paint.
    offset = bundle.rest_px - bundle.camera.project(paint_mm)
    rays = bundle.camera.rays(seen - offset)
    radius = np.linalg.norm(paint_mm[:, :2], axis=1)
    reach = radius / np.linalg.norm(rays[:, :2], axis=1)
    places = bundle.camera.position_mm + reach[:, None] * rays
    error = places - paint_mm
    for case, part, target in (
        ("all", error, "<= 0.18"),
        ("along the axis", error[:, 2:], None),
        ("across", error[:, :2], None),
    ):
        row = f"rest coordinates from one frame, RMSE, {case}"
        source = (
            "paper, real sensor; here rendered with noise, print scatter off, and the "
            "expected positions come from the same renderer"
        )
        table.add(row, float(np.sqrt(np.sum(part**2, axis=1).mean())), "mm", 0.18, source, target)


def rest_rows(table: Table, *, quick: bool) -> None:
    """Rest coordinates that the decoder of a build measures in the build's own frame."""
    design = load_design("cylinder60")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "cylinder60"
        build(design, out, accuracy="draft" if quick else "standard", only=["frames"])
        bundle = load_bundle(out / "decoder")
        rest = read_image(out / "views" / "frame_rest.png")
    seen = check_visibility(Sensor(design), rng=np.random.default_rng(0))
    add_rest(table, bundle, rest, seen.paint_point_mm)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts of this benchmark."""
    rows: dict[str, Callable[..., None]] = {
        "linear": rest_rows,
        "speed": decoder_speed.add_rows,
        "speed_large": partial(decoder_speed.add_rows, size=decoder_speed.LARGE),
        "tracking": decoder_tracking.add_rows,
        "moving": decoder_moving.add_rows,
        "stream": decoder_stream.add_rows,
        "faults": decoder_faults.add_rows,
        "accuracy": decoder_accuracy.add_rows_accuracy,
        "few": decoder_accuracy.add_rows_few,
        "other_unit": decoder_accuracy.add_rows_other_unit,
        "referee": decoder_referee.add_rows_referee,
        "shapes": decoder_shapes.add_rows_shapes,
        "cycles": decoder_shapes.add_rows_cycles,
        "cnn": decoder_cnn.add_rows,
    }
    return {name: partial(add, quick=quick) for name, add in rows.items()}


if __name__ == "__main__":
    run_parts("decoder", parts, __doc__ or "")
