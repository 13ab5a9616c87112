"""Density: shares of the surface, local values, and what may be compared with the paper."""

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.layout import make_markers
from phytac_design.optics.density import density_map, density_of
from phytac_design.study.search.fidelity_levels import DENSITY_MAP
from tests.designs import changed
from tests.test_layout_shapes import designed


@pytest.mark.parametrize("name", ["cone", "cuboid", "grip", "hemisphere", "patch", "plane"])
def test_cells_share_the_whole_area(name: str) -> None:
    design = load_design(name)
    surface = design.surface()
    markers = make_markers(design, surface)
    local = density_map(surface, markers)
    assert local.cell_cm2.sum() == pytest.approx(surface.area_mm2() / 100.0)
    # The area-weighted mean of 1 / density is the area per marker.
    found = density_of(surface, markers)
    assert found.per_cm2 == pytest.approx(100.0 * markers.count / surface.area_mm2())
    assert found.local_min_per_cm2 <= found.per_cm2 <= found.local_max_per_cm2
    expected = {"cuboid": "parallel", "plane": "perpendicular"}.get(name, "oblique")
    assert found.surface_class == expected
    # No claim against the paper's record outside its class.
    assert (found.times_paper is not None) == (expected == "parallel")


def test_cells_of_a_square_grid_are_its_bands() -> None:
    design = designed("plane", "straight", rows=6, columns=8)
    surface = design.surface()
    for cells, near in ((20_000, 0.002), (2000, 0.02)):
        local = density_map(surface, make_markers(design, surface), cells=cells)
        assert local.cell_cm2 == pytest.approx(1.0, rel=near)
        assert local.per_cm2 == pytest.approx(1.0, rel=near / 3.0)


@pytest.mark.parametrize("length", [20.0, 200.0])
def test_few_cells_of_a_strip_share_its_area(length: float) -> None:
    design = designed(
        "plane", "straight", rows=round(length / 5.0), columns=round(4000.0 / length / 5.0),
        shape_more={"height_mm": length, "width_mm": 4000.0 / length},
    )  # fmt: skip
    surface = design.surface()
    local = density_map(surface, make_markers(design, surface), **DENSITY_MAP)
    assert len(local.area_mm2) < 2500
    assert local.cell_cm2 == pytest.approx(0.25, rel=0.03)
    assert local.per_cm2 == pytest.approx(4.0, rel=0.02)


def test_few_cells_a_marker_give_the_least_density_of_many() -> None:
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    few, many = (
        density_of(surface, markers, cells=cells).local_min_per_cm2
        for cells in (0, 400 * markers.count)
    )
    assert few == pytest.approx(many, rel=0.01)


def test_local_density_follows_the_row_pitch() -> None:
    design = changed(layout={"row_pitch_exponent": 1.3})
    surface = design.surface()
    markers = make_markers(design, surface)
    local = density_map(surface, markers).per_cm2
    row = [local[markers.row == k].mean() for k in (4, 18)]
    pitch = np.diff(np.unique(markers.uv[:, 0].round(9)))
    wanted = (pitch[17:19].mean()) / (pitch[3:5].mean())
    assert row[0] / row[1] == pytest.approx(wanted, rel=0.05)
    assert density_of(surface, markers).times_paper == pytest.approx(1.0, abs=0.01)


def test_only_the_sensing_faces_count() -> None:
    design = designed("cuboid", "straight", shape_more={"faces": ["+x", "-x"]})
    surface = design.surface()
    found = density_of(surface, make_markers(design, surface))
    # Two faces of depth 40 with half of each rounded edge, of a perimeter of 180 - 16·(1 - π/4).
    face = 40.0 - 2 * 8.0 + 8.0 * np.pi / 2.0
    assert found.area_cm2 == pytest.approx(2 * face * 90.0 / 100.0, rel=0.01)
