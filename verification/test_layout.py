"""Layout and heights: where receptors stand and how tall they are, on every shape, at the ends."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_shapes import Surface
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import AROUND, SHAPES, base, design_of, numbers_of, sized
from verification.faces import face_of

EXACT = 1e-9
"""Relative to the size of the sensor."""
ALONG = 2e-6
"""The same where lengths along the surface are inverted by tables."""


def check_markers(values: Mapping[str, Any], found: Evidence) -> None:
    """Places on the face's own equation, tips down the normal, heights by formula, symmetry."""
    design = design_of(values)
    surface = design.surface()
    markers = make_markers(design, surface)
    low, high = surface.bounds_mm()
    size = float(np.linalg.norm(high - low))
    table = numbers_of(surface)
    known = face_of(surface.name, table)
    outer = surface.point(markers.uv)
    if known.gap is not None:
        found.add("receptors stand on the face's equation", known.gap(outer) / size, EXACT)
    thick = design.wall.thickness_mm
    inward = -surface.normal(markers.uv)
    if design.receptor.direction == "normal":
        reach = thick + markers.height_mm
        found.add(
            "tips lie down the normal",
            (markers.tip_mm - outer - reach[:, None] * inward) / size,
            EXACT,
        )
    axis = markers.tip_mm - markers.base_mm
    found.close(
        "tubes are as long as their heights", np.linalg.norm(axis, axis=1), markers.height_mm, 1e-9
    )
    found.true("every number is finite", np.isfinite(markers.tip_mm))
    ids = markers.neighbours
    found.true(
        "neighbours are markers, and never itself",
        (ids >= -1) & (ids < markers.count) & (ids != np.arange(markers.count)[:, None]),
    )
    _count(design, surface, markers, found)
    _heights(design, markers, found)
    _even(design, surface, markers, found)
    _turned(design, surface, markers, found)
    _units(values, markers, found)


def _count(design: Design, surface: Surface, markers: Markers, found: Evidence) -> None:
    layout = design.layout
    if layout.kind in ("spiral", "straight") and surface.name in ("cylinder", "cone", "grip"):
        found.true("rows times columns", markers.count == layout.rows * layout.columns)
    if layout.kind == "phyllotaxis" and surface.name != "cuboid":
        found.true("as many as in the design file", markers.count == layout.count)


def _heights(design: Design, markers: Markers, found: Evidence) -> None:
    """Profiles by their formula where the length along is known by z alone."""
    layout = design.layout
    if layout.position_heights_mm or design.shape.kind not in ("cylinder", "cuboid", "cone"):
        return
    if layout.heights not in ("constant", "linear", "power") or not markers.in_rows:
        return
    z = markers.mid_mm[:, 2]
    share = (z - z.min()) / np.ptp(z) if np.ptp(z) > 0.0 else np.zeros(len(z))
    power = {"constant": 1.0, "linear": 1.0, "power": layout.height_exponent}[layout.heights]
    far = layout.height_near_mm if layout.heights == "constant" else layout.height_far_mm
    exact = layout.height_near_mm + (far - layout.height_near_mm) * share**power
    # A root that is steep at the near end lifts an error of the table.
    loose = ALONG ** min(power, 1.0) * max(far, layout.height_near_mm)
    found.add("heights by formula, mm", markers.height_mm - exact, 10.0 * loose)


def _even(design: Design, surface: Surface, markers: Markers, found: Evidence) -> None:
    """Phyllotaxis: equal areas are equal steps of height on cylinder and dome (Archimedes)."""
    if design.layout.kind != "phyllotaxis" or surface.name not in ("cylinder", "hemisphere"):
        return
    z = np.sort(surface.point(markers.uv)[:, 2])
    if len(z) < 2:
        return
    wanted = z[0] + np.ptp(z) * np.arange(len(z)) / (len(z) - 1)
    found.add(
        "equal areas are equal steps of z (Archimedes), of a step",
        (z - wanted) / np.ptp(z) * (len(z) - 1),
        0.25,
    )


def _turned(design: Design, surface: Surface, markers: Markers, found: Evidence) -> None:
    """A straight grid falls onto itself when turned by a column."""
    layout = design.layout
    if layout.kind not in ("straight", "spiral") or surface.name not in (
        "cylinder",
        "cone",
        "grip",
    ):
        return
    from scipy.spatial import cKDTree

    angle = 2.0 * np.pi / layout.columns
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    gap = cKDTree(markers.tip_mm).query(markers.tip_mm @ turn.T)[0]
    found.add(
        "turned by a column it is the same",
        gap / np.abs(markers.mid_mm).max(),
        EXACT,
        kind="symmetry",
    )


def _units(values: Mapping[str, Any], markers: Markers, found: Evidence) -> None:
    """The same sensor seven times as large, or as small."""
    if design_of(values).layout.kind == "explicit":
        return  # places in the chart have no unit of their own
    for factor in (7.0, 1.0 / 7.0):
        other = sized(design_of(values), factor)
        if other is None:
            continue
        there = make_markers(other, other.surface()).tip_mm / factor
        found.close(f"{factor:.3g} times as large", there, markers.tip_mm, 1e-8, kind="units")


def cases() -> Cases:
    """Layouts of every kind on every shape, their numbers at the ends."""
    out = Cases()

    def add(shape: str, name: str, layout: Any, expect: Expect = "right", /, **table: Any) -> None:
        if layout:
            table |= {"layout": {"kind": "straight", **layout}}
        out.add_design(shape, name, check_markers, table, expect)

    far = {"heights": "power", "height_far_mm": 4.0}
    for shape in SHAPES:
        sight = base(shape)["layout"] | {"heights": "line-of-sight"}
        add(shape, "one marker", {"rows": 1, "columns": 1})
        add(shape, "2000 rows of one", {"rows": 2000, "columns": 1})
        add(shape, "one row of 2000", {"rows": 1, "columns": 2000})
        for end, exponent in (("near", 5.0), ("far", 0.2)):
            name = f"rows bunched at the {end} end"
            add(shape, name, far | {"rows": 9, "row_pitch_exponent": exponent})
        for power in (0.2, 10.0):
            add(shape, f"heights as the power {power:g}", far | {"height_exponent": power})
        shrinking = {"heights": "linear", "height_near_mm": 9.0, "height_far_mm": 0.1}
        add(shape, "heights that decrease", shrinking)
        for count in (1, 2, 3, 5000):
            add(shape, f"{count} by the golden angle", {"kind": "phyllotaxis", "count": count})
        spiral = {"kind": "spiral", "rows": 5, "columns": 9}
        for angle in (-88.9, -1e-6, 0.0, 50.5, 88.9):
            expect: Expect = "right" if shape in AROUND else "refused"
            add(shape, f"a spiral of {angle:g}°", spiral | {"spiral_angle_deg": angle}, expect)
        flat = spiral | {"spiral_angle_deg": 0.5, "spiral_from": "circumference"}
        add(shape, "a spiral of 0.5° from the circumference", flat, "refused")
        tilted = {"direction": "tilted", "tilt_deg": 59.0}
        add(shape, "receptors leaning 59°", {}, receptor=tilted)
        add(shape, "receptors towards the axis", {}, "either", receptor={"direction": "axis"})
        add(shape, "line of sight", sight | {"height_far_mm": 12.0}, "either")
        close = {"height_near_mm": 5.0, "height_far_mm": 5.0}
        add(shape, "line of sight without a margin", sight | close, "either")
        off = {"kind": "explicit", "positions": [[1e4, 1e4]], "rows": 1, "columns": 1}
        add(shape, "one marker off the face", off, "refused")
        same = {"kind": "explicit", "positions": [[1.0, 1.0], [1.0, 1.0]]}
        add(shape, "two coincident markers", same, "either")
    # Twelve around: none on the middle of an edge, which two faces share.
    straight = base("cuboid")["layout"]
    add("cuboid", "only one face senses", straight | {"columns": 12}, shape={"faces": ["+y"]})
    add("cuboid", "a face that is none", {}, "refused", shape={"faces": ["+z"]})
    add("cuboid", "no face", {}, "refused", shape={"faces": []})
    return out


CASES = cases()


@CASES.parametrize
def test_layout(case: Case, record_property: Recorder) -> None:
    """Places, heights and neighbours of every layout on every shape."""
    verify(case, record_property)
