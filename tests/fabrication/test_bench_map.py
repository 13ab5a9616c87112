"""Paint map: unrolled true to scale, every marker in its place, on paper as it should be."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.core.figures import pdf, svg
from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.paint_map import (
    OVERLAP_mm,
    PaintMap,
    make_map,
    marks_csv,
    paper_pages,
    whole_page,
)
from phytac_design.fabrication.documents.unroll import unroll
from phytac_design.layout.sensor import Sensor
from phytac_shapes.arrays import FloatArray
from tests.designs import small
from tests.fabrication.bench_cases import switches
from tests.fabrication.cases import FAMILIES, built, family_design, shipped
from tests.fabrication.document_measurements import (
    fit_shift_mm,
    rasterise_pdf,
    red_centres_mm,
    tick_places_mm,
)

FLAT = ("cylinder", "cone", "plane", "cuboid")
ROUND = ("hemisphere", "grip", "capped cone")


def drawn(design: Design, folder: Path) -> PaintMap:
    return make_map(Sensor.of(*built(design)), switches(design, folder))


def area(polygon: FloatArray) -> float:
    x, y = polygon.T
    return abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))) / 2.0


@pytest.mark.parametrize("name", FLAT)
def test_developable_shapes_keep_every_length(name: str) -> None:
    """Short steps in any direction are as long on paper as on the surface."""
    surface = family_design(name).surface()
    flat = unroll(surface)
    assert (flat.kind, flat.pieces) == ("exact", 1)
    rng = np.random.default_rng(0)
    low, high = surface.domain.T
    uv = low + (high - low) * rng.uniform(0.01, 0.99, (200, 2))
    step = 1e-5 * (high - low) * rng.standard_normal((200, 2))
    there = np.linalg.norm(surface.point(uv + step) - surface.point(uv - step), axis=1)
    paper = np.linalg.norm(flat.at(uv + step) - flat.at(uv - step), axis=1)
    assert paper == pytest.approx(there, rel=1e-6)
    assert area(flat.outline[0]) == pytest.approx(surface.area_mm2(), rel=1e-4)


def test_cone_unrolls_to_its_sector() -> None:
    """The chord across the sector is the shortest way over the cone, by closed form."""
    surface = family_design("cone").surface()
    shape = FAMILIES["cone"]
    near, far, length = (shape[f"{k}_mm"] for k in ("diameter_near", "diameter_far", "length"))
    slope = np.arctan2((near - far) / 2.0, length)
    apart = near / 2.0 / np.sin(slope)
    a, b = unroll(surface).at(np.array([[0.0, 0.4], [0.0, 1.6]]))
    assert np.linalg.norm(a - b) == pytest.approx(2.0 * apart * np.sin(0.6 * np.sin(slope)))


@pytest.mark.parametrize("name", ROUND)
def test_gores_keep_the_area_and_say_how_they_stretch(name: str) -> None:
    surface = family_design(name).surface()
    flat = unroll(surface)
    assert flat.kind == "gores"
    assert sum(map(area, flat.outline)) == pytest.approx(surface.area_mm2(), rel=1e-3)
    (u0, u1), (v0, v1) = surface.domain
    middle = v0 + (v1 - v0) / flat.pieces / 2.0
    along = np.column_stack([np.linspace(u0, 0.97 * u1, 9), np.full(9, middle)])
    assert flat.stretch_at(along) == pytest.approx(1.0, abs=1e-6)
    # A shear, by closed form: its singular values.
    rng = np.random.default_rng(1)
    uv = np.column_stack([rng.uniform(u0, 0.98 * u1, 50), rng.uniform(v0, v1, 50)])
    u = uv[:, 0]
    radius = [
        np.hypot(*surface.point(np.column_stack([u + h, uv[:, 1]])).T[:2]) for h in (-1e-4, 1e-4)
    ]
    way = np.linalg.norm(
        surface.point(np.column_stack([u + 1e-4, uv[:, 1]]))
        - surface.point(np.column_stack([u - 1e-4, uv[:, 1]])),
        axis=1,
    )
    width = (v1 - v0) / flat.pieces
    shear = (radius[1] - radius[0]) / way * (uv[:, 1] - v0 - (flat.piece(uv) + 0.5) * width)
    most = np.sqrt(1.0 + shear**2 / 4.0) + np.abs(shear) / 2.0
    assert flat.stretch_at(uv)[:, 1] == pytest.approx(most, abs=2e-3)
    assert flat.stretch_at(uv).prod(axis=1) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_maps_show_the_surface_from_outside(name: str) -> None:
    """Around to the right and along upwards, seen against the outward normal."""
    surface = family_design(name).surface()
    flat = unroll(surface)
    low, high = surface.domain.T
    uv = low + (high - low) * np.random.default_rng(2).uniform(0.05, 0.9, (40, 2))
    frame = np.stack([surface.tangents(uv)[:, 1], surface.tangents(uv)[:, 0]], axis=1)
    outward = np.sum(np.cross(frame[:, 0], frame[:, 1]) * surface.normal(uv), axis=1)
    steps = 1e-6 * (high - low)
    piece = flat.piece(uv)
    right, up = (
        flat.flat(uv + way * steps, piece) - flat.flat(uv - way * steps, piece)
        for way in np.array([[0.0, 1.0], [1.0, 0.0]])
    )
    turned = right[:, 0] * up[:, 1] - right[:, 1] * up[:, 0]
    assert np.all(outward > 0.0)
    assert np.all(turned > 0.0)


def test_markers_cut_by_the_seam_are_shown_on_both_sides(tmp_path: Path) -> None:
    design = shipped("cylinder60")
    paint = drawn(design, tmp_path)
    _, _, markers = built(design)
    around = 60.0 * np.pi
    cut = np.minimum(markers.uv[:, 1], 2.0 * np.pi - markers.uv[:, 1]) * 30.0 < 1.5
    assert sorted(k for k, _ in paint.ghosts) == np.flatnonzero(cut).tolist()
    for marker, at in paint.ghosts:
        apart = at - paint.place_mm[marker]
        assert abs(apart[0]) == pytest.approx(around)
        assert apart[1] == pytest.approx(0.0, abs=1e-9)


def test_ghosts_of_gores_touch_their_own_edge(tmp_path: Path) -> None:
    """Seen from either gore a marker is as far from the seam between them."""
    paint = drawn(shipped("hemisphere"), tmp_path)
    assert paint.ghosts
    seams = np.concatenate(paint.unrolled.seams)
    for marker, at in paint.ghosts:
        own = np.linalg.norm(seams - paint.place_mm[marker], axis=1).min()
        other = np.linalg.norm(seams - at, axis=1).min()
        assert max(own, other) < 1.5
        assert np.linalg.norm(at - paint.place_mm[marker]) > 1e-6


def test_every_marker_has_its_paint_its_tip_and_its_names(tmp_path: Path) -> None:
    design = shipped("plane")
    paint = drawn(design, tmp_path)
    _, _, markers = built(design)
    outside, inside = (whole_page(paint, inside=way) for way in (False, True))
    for radius, count in ((1.5, 130), (0.8, 130), (0.6, 130)):
        (found,) = discs_of(outside, radius)
        assert found.get_offsets() == pytest.approx(paint.place_mm)
        assert len(found.get_offsets()) == count
    (paints,) = discs_of(outside, 1.5)
    inks = map(tuple, paints.get_facecolor().tolist())
    names = design.layout.colours
    assert len({(ink, names[k]) for ink, k in zip(inks, markers.colour, strict=True)}) == 2
    around = [figure.axes[1].get_xlim() for figure in (outside, inside)]
    assert around[0] == around[1][::-1] == tuple(paint.box_mm[:, 0])
    text = svg(outside)
    assert text.count(">9.12<") == 1
    width = re.search(r'width="([\d.]+)pt".*viewBox="0 0 \1 ', text)
    assert width is not None
    assert float(width[1]) == pytest.approx(outside.get_figwidth() * 72.0, abs=1e-3)


def discs_of(figure: Any, radius_mm: float) -> list[Any]:
    """Collections of discs of a radius on the map of a page."""
    return [item for item in figure.axes[1].collections if item.get_widths()[0] == 2.0 * radius_mm]


def big(tmp_path: Path) -> PaintMap:
    data = shipped("cylinder60").model_dump(mode="json")
    data["shape"] |= {"diameter_outer_mm": 110.0, "length_mm": 320.0}
    return drawn(Design.model_validate(data), tmp_path)


def test_a_large_map_is_split_over_sheets_that_overlap(tmp_path: Path) -> None:
    paint = big(tmp_path)
    pages = paper_pages(paint)
    sheets = pages[: len(pages) // 2]
    assert len(sheets) >= 4
    markers = paint.place_mm.shape[0]
    whole = np.zeros(markers, dtype=int)
    for page in sheets:
        low, high = np.sort([page.axes[1].get_xlim(), page.axes[1].get_ylim()], axis=1).T
        place = paint.place_mm
        whole += np.all((place >= low + 1.5) & (place <= high - 1.5), axis=1)
        edges = page.axes[1].get_position()
        paper = 25.4 * page.get_size_inches()
        assert np.ptp(edges.get_points(), axis=0) * paper == pytest.approx(high - low)
        assert edges.get_points().min() > 0.0
        assert edges.get_points().max() < 1.0
    assert whole.min() >= 1
    assert whole.max() >= 2
    first, second = (page.axes[1].get_xlim() for page in sheets[:2])
    assert first[1] - second[0] == pytest.approx(OVERLAP_mm)


def test_the_pdf_is_sound_and_the_same_every_time(tmp_path: Path) -> None:
    paint = drawn(shipped("plane"), tmp_path)
    pages = paper_pages(paint)
    data = pdf(pages, title="plane (test)")
    assert data == pdf(paper_pages(paint), title="plane (test)")
    assert b"CreationDate" not in data
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", data)
    millimetres = np.array(boxes, dtype=float) * 25.4 / 72.0
    assert millimetres == pytest.approx(np.tile([210.0, 297.0], (2, 1)), abs=1e-4)


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="pdftoppm is not on PATH")
def test_the_printed_page_is_true_to_scale(tmp_path: Path) -> None:
    design = shipped("hemisphere")
    paint = drawn(design, tmp_path)
    path = tmp_path / "map.pdf"
    path.write_bytes(pdf(paper_pages(paint), title="map"))
    (page,) = rasterise_pdf(path, tmp_path, last=1)
    ticks = tick_places_mm(page)
    assert len(ticks) == 11
    assert np.diff(ticks) == pytest.approx(10.0, abs=0.05)
    seen = red_centres_mm(page, design.switch.tip_diameter_mm)
    assert len(seen) == 84
    due = paint.place_mm * [1.0, -1.0]
    assert fit_shift_mm(seen, due).max() <= 0.05


def test_reference_marks_stand_beside_the_rim_at_their_angle(tmp_path: Path) -> None:
    design = small(reference_marks={"count": 12, "ends": "both"})
    sensor = Sensor(design)
    drawing = make_map(sensor, switches(design, tmp_path))
    marks = sensor.reference_marks
    outline = np.concatenate(drawing.unrolled.outline)
    low, high = outline[:, 1].min(), outline[:, 1].max()
    beyond = np.where(marks.end == 0, low - drawing.marks_mm[:, 1], drawing.marks_mm[:, 1] - high)
    np.testing.assert_allclose(beyond, marks.distance_mm, atol=1e-6)
    angle = np.arctan2(marks.point_mm[:, 1], marks.point_mm[:, 0]) % (2.0 * np.pi)
    around = drawing.marks_mm[:, 0] - outline[:, 0].min()
    np.testing.assert_allclose(np.sort(around), np.sort(30.0 * angle), atol=0.05)
    assert (drawing.box_mm[0] < drawing.marks_mm).all()
    assert (drawing.box_mm[1] > drawing.marks_mm).all()
    lines = marks_csv(sensor, drawing).splitlines()
    assert len(lines) == 25
    assert lines[0].startswith("mark,rim,paint,from_wall_mm,angle_deg")
    assert lines[1].split(",")[:4] == ["M0", "near", "blue", "0.8500"]
    picture = svg(whole_page(drawing))
    assert "M23" in picture
    plain = make_map(Sensor(small()), switches(small(), tmp_path / "plain"))
    assert len(plain.marks_mm) == 0
    assert "M0" not in svg(whole_page(plain))
