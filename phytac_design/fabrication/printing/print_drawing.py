"""A body as it stands on the bed, with its overhangs and violations, as one SVG file."""

import numpy as np

from phytac_design.core.figures import new_figure, svg
from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.overhang import overhanging
from phytac_design.fabrication.printing.print_checks import PrintReport
from phytac_design.fabrication.printing.voids import upright
from phytac_design.geometry.ray_tree import RayTree
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray

SIDE_px = 420
"""Side of each view."""


def draw_report(tree: RayTree, report: PrintReport, rules: PrintSection, title: str) -> str:
    """SVG with two views of the body and the list of its violations.

    Parameters
    ----------
    tree : RayTree
        The body.
    report : PrintReport
        Of that body.
    """
    up = np.array(report.standing.up)
    stand = upright(up)
    hanging = np.zeros(len(tree.normal), dtype=np.bool_)
    hanging[overhanging(tree, up, rules)] = True
    lines = _lines(report, rules)
    height = 9.0 + 0.25 * len(lines)
    figure = new_figure((16.0, height), constrained=False)
    figure.text(0.5, 1.0 - 0.4 / height, title, horizontalalignment="center", fontsize=14)
    points = tree.corners.reshape(-1, 3) @ stand.T
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    # Half the side of a view in millimetres, a little wider than the body's diagonal.
    half = 0.53 * float(np.linalg.norm(np.ptp(points, axis=0)))
    for k, (name, elevation, azimuth) in enumerate(
        (("from above", 25.0, 30.0), ("from below", -35.0, 30.0))
    ):
        view = _view(elevation, azimuth)
        axes = figure.add_axes((0.5 * k, 1.0 - 8.5 / height, 0.5, 8.0 / height))
        axes.set_axis_off()
        picture = _picture(tree, stand, view, hanging, centre, half)
        axes.imshow(picture, extent=(-half, half, -half, half), interpolation="nearest")
        axes.text(-0.95 * half, -0.95 * half, name, color="#555555")
        for number, item in enumerate(report.violations, start=1):
            x, y, _ = view @ (stand @ np.array(item.point_mm) - centre)
            axes.plot(x, y, "o", markersize=11, markerfacecolor="none", markeredgecolor="#d2122c")
            axes.annotate(str(number), (x, y), (7, 4), textcoords="offset points", color="#d2122c")
    for row, text in enumerate(lines):
        figure.text(0.02, (height - 8.8 - 0.25 * row) / height, text, parse_math=False)
    return svg(figure)


def _lines(report: PrintReport, rules: PrintSection) -> list[str]:
    listed = 14  # violations that are written out below the views
    standing = report.standing
    bed = " x ".join(f"{side:g}" for side in rules.bed_mm)
    lines = [
        (
            f"{rules.process.upper()}, up ({', '.join(f'{x:.2f}' for x in standing.up)}): "
            f"{standing.height_mm:.0f} mm high, {standing.footprint_mm[0]:.0f} x "
            f"{standing.footprint_mm[1]:.0f} mm on a bed of {bed}; orange: "
            f"{standing.overhang_area_mm2:.0f} mm² on supports"
        ),
    ]
    shown = report.violations[:listed]
    lines += [f"{k}  {item.text()}" for k, item in enumerate(shown, start=1)]
    more = len(report.violations) - len(shown)
    lines += [f"and {more} more (print_report.json)"] if more else []
    return lines if shown else [*lines, "no violations"]


def _view(elevation_deg: float, azimuth_deg: float) -> FloatArray:
    """Rows (3, 3): right, up and toward the viewer, in the frame of the bed."""
    e, a = np.radians([elevation_deg, azimuth_deg])
    toward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.stack([right, np.cross(toward, right), toward])


def _picture(
    tree: RayTree,
    stand: FloatArray,
    view: FloatArray,
    hanging: BoolArray,
    centre: FloatArray,
    half: float,
) -> ImageArray:
    """Shaded parallel view (SIDE_px, SIDE_px, 3), faces that need supports in orange."""
    light = np.array([0.3, 0.5, 0.8])
    place = half * (2.0 * (np.arange(SIDE_px) + 0.5) / SIDE_px - 1.0)
    x, y = np.meshgrid(place, -place)
    local = np.stack([x.ravel(), y.ravel(), np.full(x.size, 4.0 * half)], axis=1) @ view + centre
    start = local @ stand
    hit = tree.cast(start, np.tile(-view[2] @ stand, (len(start), 1))).triangle
    met = hit >= 0
    normal = tree.normal[hit[met]] @ stand.T @ view.T
    shade = 0.4 + 0.6 * np.clip(normal @ (light / np.linalg.norm(light)), 0.0, 1.0)
    base = np.where(hanging[hit[met]][:, None], (245, 140, 60), (198, 204, 208))
    picture = np.full((x.size, 3), 255, dtype=np.uint8)
    picture[met] = np.round(base * shade[:, None]).astype(np.uint8)
    return picture.reshape(SIDE_px, SIDE_px, 3)
