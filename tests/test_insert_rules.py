"""Rules on markers that are inserts."""

from typing import Any

import numpy as np
import pytest

from phytac_design.design.design_file import shipped_designs
from phytac_design.design.spec import Design
from phytac_design.layout.receptor_distances import pair_gaps_mm, smallest_receptor_gap_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from tests.designs import changed
from tests.refusals import refused


def inserts(base: str = "cylinder60", **tables: dict[str, Any]) -> Design:
    """A shipped design with inserts in place of paint."""
    receptor = {"colouring": "insert"} | tables.pop("receptor", {})
    return changed(base, receptor=receptor, **tables)


@pytest.mark.parametrize("name", shipped_designs())
def test_shipped_designs_can_have_inserts(name: str) -> None:
    check_design(inserts(name))


@pytest.mark.parametrize(
    ("code", "tables"),
    [
        ("insert-gap-too-small", {"receptor": {"gap_insert_mm": 0.14}}),
        ("insert-ledge-too-small", {"receptor": {"ledge_insert_mm": 0.15}}),
        ("insert-tube-too-thin", {"receptor": {"thickness_tube_mm": 0.39}}),
        ("insert-seat-too-deep", {"wall": {"thickness_mm": 0.79}}),
        ("footprint-below-seat", {"switch": {"footprint_diameter_mm": 4.0}}),
        ("insert-too-slender", {"print_rules": {"post_tall_mm": (9.0, 20.0)}}),
        ("sprue-exceeds-bed", {"print_rules": {"bed_mm": (12.0, 12.0, 175.0)}}),
        ("insert-leans", {"receptor": {"direction": "tilted", "tilt_deg": 2.0}}),
        (
            "insert-neck-too-thick",
            {"print_rules": {"post_short_mm": (1.2, 7.0)}},
        ),
        ("tube-wall-too-thin", {"receptor": {"diameter_hole_mm": 2.3}}),
    ],
)
def test_inserts_that_cannot_be_made_are_refused(
    code: str, tables: dict[str, dict[str, Any]]
) -> None:
    with refused(code):
        check_design(inserts(**tables))


def test_seats_without_switches_keep_a_wall_between_them() -> None:
    bare = {"diameter_hole_mm": 0.0}
    check_design(inserts("cylinder60-dense", receptor=bare))
    with refused("insert-seats-meet"):
        wide = bare | {"ledge_insert_mm": 1.5}
        check_design(inserts("cylinder60-dense", receptor=wide, wall={"thickness_mm": 2.1}))


def test_gap_between_tubes_is_that_of_the_wider_ones_up_to_the_band() -> None:
    painted, own = Sensor(changed("cuboid")), Sensor(inserts("cuboid"))
    plain, _ = smallest_receptor_gap_mm(painted.design, painted.markers)
    gap, pair = smallest_receptor_gap_mm(own.design, own.markers)
    # The tubes are 1.1 mm wider, and end 1 mm before the tips, where they are nearest.
    assert plain - 1.1 < gap < plain
    assert pair is not None
    first, second = pair
    markers, points = own.markers, np.linspace(0.0, 1.0, 400)[:, None]

    def axis(k: int, length: float) -> Any:
        return markers.base_mm[k] + points * length * markers.direction[k]

    tubes = [axis(k, float(markers.height_mm[k]) - 1.0) for k in pair]
    apart = np.linalg.norm(tubes[0][:, None] - tubes[1], axis=2).min()
    assert gap <= apart - own.design.receptor.diameter_tube_mm + 0.01
    assert gap == pytest.approx(
        float(pair_gaps_mm(own.design, own.markers, np.array([[first, second]]))[0])
    )
