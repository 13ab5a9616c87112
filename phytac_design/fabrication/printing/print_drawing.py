"""A body as it stands on the bed, with its overhangs and violations, as one SVG file."""

from base64 import b64encode
from html import escape

import cv2
import numpy as np

from phytac_design.design.print_rules_table import PrintSection
from phytac_design.fabrication.printing.overhang import overhanging
from phytac_design.fabrication.printing.print_checks import PrintReport
from phytac_design.fabrication.printing.voids import upright
from phytac_design.geometry.ray_tree import RayTree
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray

SIDE_px = 420
"""Side of each view."""
PAPER, BODY, HANGING = (255, 255, 255), (208, 204, 198), (60, 140, 245)
"""BGR of the paper, of the body, and of faces that need supports."""


def draw_report(tree: RayTree, report: PrintReport, rules: PrintSection, title: str) -> str:
    """SVG with two views of the body and the list of its violations.

    Parameters
    ----------
    tree : RayTree
        The body.
    report : PrintReport
        Of that body.
    """
    # Name, elevation and azimuth (degrees).
    views = (("from above", 25.0, 30.0), ("from below", -35.0, 30.0))
    margin = 1.06
    up = np.array(report.standing.up)
    stand = upright(up)
    hanging = np.zeros(len(tree.normal), dtype=np.bool_)
    hanging[overhanging(tree, up, rules)] = True
    lines = _lines(report, rules)
    height = 40 + SIDE_px + 20 * len(lines) + 24
    out = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * SIDE_px}" height="{height}" '
            'font-family="sans-serif" font-size="13">'
        ),
        '<rect width="100%" height="100%" fill="white"/>',
        f'<text x="{SIDE_px}" y="22" text-anchor="middle" font-size="15">{escape(title)}</text>',
    ]
    points = tree.corners.reshape(-1, 3) @ stand.T
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    scale = SIDE_px / (margin * float(np.linalg.norm(np.ptp(points, axis=0))))
    for k, (name, elevation, azimuth) in enumerate(views):
        view = _view(elevation, azimuth)
        picture = _picture(tree, stand, view, hanging, centre, scale)
        data = b64encode(cv2.imencode(".png", picture)[1].tobytes()).decode()
        left = SIDE_px * k
        out.append(
            f'<image x="{left}" y="30" width="{SIDE_px}" height="{SIDE_px}" '
            f'href="data:image/png;base64,{data}"/>'
            f'<text x="{left + 10}" y="{44 + SIDE_px - 20}" fill="#555">{name}</text>'
        )
        for number, item in enumerate(report.violations, start=1):
            local = view @ (stand @ np.array(item.point_mm) - centre) * scale
            x, y = left + SIDE_px / 2 + local[0], 30 + SIDE_px / 2 - local[1]
            out.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="none" stroke="#d2122c" '
                f'stroke-width="2"/><text x="{x + 8:.1f}" y="{y - 4:.1f}" fill="#d2122c" '
                f'font-weight="bold">{number}</text>'
            )
    for row, line in enumerate(lines):
        out.append(f'<text x="10" y="{60 + SIDE_px + 20 * row}">{escape(line)}</text>')
    return "\n".join([*out, "</svg>"]) + "\n"


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
    scale: float,
) -> ImageArray:
    """Shaded parallel view (SIDE_px, SIDE_px, 3)."""
    light = np.array([0.3, 0.5, 0.8])
    place = (np.arange(SIDE_px) + 0.5 - SIDE_px / 2) / scale
    x, y = np.meshgrid(place, -place)
    far = 2.0 * SIDE_px / scale
    local = np.stack([x.ravel(), y.ravel(), np.full(x.size, far)], axis=1) @ view + centre
    start = local @ stand
    way = np.tile(-view[2] @ stand, (len(start), 1))
    hit = tree.cast(start, way).triangle
    met = hit >= 0
    normal = tree.normal[hit[met]] @ stand.T @ view.T
    shade = 0.4 + 0.6 * np.clip(normal @ (light / np.linalg.norm(light)), 0.0, 1.0)
    base = np.where(hanging[hit[met]][:, None], HANGING, BODY)
    picture = np.full((x.size, 3), PAPER, dtype=np.uint8)
    picture[met] = np.round(base * shade[:, None]).astype(np.uint8)
    return picture.reshape(SIDE_px, SIDE_px, 3)
