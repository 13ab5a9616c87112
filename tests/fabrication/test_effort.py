"""Parts, hand work and material before anything is made, against what is made."""

from pathlib import Path
from typing import Any

import pytest

from phytac_design.design.design_file import design_hash
from phytac_design.fabrication.documents import bill_of_materials as bill
from phytac_design.fabrication.effort.effort import Effort, effort_of
from phytac_design.fabrication.molds.estimate import mold_volumes
from phytac_design.fabrication.molds.make import make_molds, plan_molds
from phytac_design.fabrication.printing.parting import part_shell
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.stages.documents_stage import rubber_mm3
from phytac_design.stages.mold_stage import MOLD
from tests.fabrication.bench_cases import context_of, put, switches
from tests.fabrication.cases import design, family_design


def effort(**sections: dict[str, Any]) -> Effort:
    return effort_of(Sensor(design(**sections)))


def test_counts_and_material_are_those_of_the_molds_and_switches(tmp_path: Path) -> None:
    # A bed so small that the molds are split into two sets.
    case = design(layout={"columns": 6}, print_rules={"bed_mm": (70.0, 70.0, 175.0)})
    context = context_of(case, tmp_path)
    put(context, tmp_path, "mold", {})
    MOLD.run(context, context.folders["mold"])
    facts = context.facts("mold")
    rows = bill.bill_rows([*bill.switch_parts(switches(case, tmp_path / "again")), *facts["parts"]])
    made = effort_of(Sensor(case))
    assert made.castings == len(facts["sets"]) == 2

    def count(material: str, word: str) -> int:
        return sum(r["count"] for r in rows if r["material"] == material and word in r["part"])

    assert made.parts["molds"] == count("resin", "mold") == 4
    assert made.parts["silicone"] == count("silicone", "half") == 4
    assert made.parts["switches"] == made.switches == count("tpu", "switch") == 18
    assert made.switch_kinds == sum(
        row["material"] == "tpu" and "switch" in row["part"] for row in rows
    )
    assert made.volume_mm3["molds"] == pytest.approx(
        sum(r["volume_mm3"] for r in rows if r["material"] == "resin"), rel=0.01
    )
    assert made.volume_mm3["silicone"] == pytest.approx(
        sum(r["volume_mm3"] for r in rows if r["material"] == "silicone"), rel=0.01
    )
    assert made.volume_mm3["rubber"] == pytest.approx(rubber_mm3(rows), rel=0.05)


def test_a_plunger_is_estimated_as_it_is_made(tmp_path: Path) -> None:
    case = design(layout={"columns": 3}, switch={"family": "plunger"})
    made, plain = effort_of(Sensor(case)), effort(layout={"columns": 3})
    switch = switches(case, tmp_path)
    (mold,) = make_molds(case.mold, case.print_rules, switch)
    rubber = mold_volumes(mold.plan, mold.sizes).rubber_mm3
    assert made.volume_mm3["rubber"] == pytest.approx(rubber, rel=0.1)
    assert made.volume_mm3["rubber"] > 1.1 * plain.volume_mm3["rubber"]
    assert (made.switches, made.castings) == (plain.switches, plain.castings)


def test_rigid_plates_are_estimated_too(tmp_path: Path) -> None:
    case = design(layout={"columns": 3}, mold={"way": "rigid"})
    made = switches(case, tmp_path)
    (mold,) = make_molds(case.mold, case.print_rules, made)
    sizes, (plan,) = plan_molds(case.mold, case.print_rules, made)
    found = mold_volumes(plan, sizes)
    printed = sum(mold.printed[name].volume_mm3 for name in mold.parts)
    assert found.printed_mm3 == pytest.approx(printed, rel=0.004)
    assert found.silicone_mm3 == 0.0
    assert effort_of(Sensor(case)).parts["molds"] == len(mold.parts) == 3


@pytest.mark.parametrize(
    "family", ["cone", "capped cone", "plane", "cuboid", "hemisphere", "patch"]
)
def test_volume_of_the_shell_is_near_that_of_its_solid(family: str) -> None:
    sensor = Sensor(family_design(family))
    exact = shell_manifold(sensor, tolerance_mm=0.05).volume()
    assert effort_of(sensor).volume_mm3["shell"] == pytest.approx(exact, rel=0.01)


def test_hours_are_seconds_times_parts() -> None:
    none = dict.fromkeys(
        ("print_s", "silicone_s", "cast_s", "trim_s", "tip_s", "fit_s", "screw_s"), 0.0
    )
    made = effort(effort={**none, "paint_s": 30.0, "glue_s": 90.0})
    assert made.hours_total == made.hours_paint_and_glue == pytest.approx(12 * 120.0 / 3600.0)
    screws = effort(effort={**none, "paint_s": 0.0, "glue_s": 0.0, "screw_s": 3600.0})
    assert screws.hours_total == screws.parts["screws"] > 0


def test_what_is_printed_in_colour_is_not_painted() -> None:
    painted, printed = effort(), effort(receptor={"colouring": "multi-material"})
    assert (painted.receptor_ends, printed.receptor_ends) == (12, 0)
    assert painted.hours_total - printed.hours_total == pytest.approx(12 * 20.0 / 3600.0)
    assert "blue" in " ".join(painted.tools)
    assert "blue" not in " ".join(printed.tools)


def test_without_switches_nothing_is_cast() -> None:
    made = effort(receptor={"diameter_hole_mm": 0.0})
    assert made.switches == made.stem_lengths == made.castings == made.parts["molds"] == 0
    assert made.mass_g["rubber"] == made.mass_g["silicone"] == 0.0
    assert {name for name, hours in made.hours.items() if hours} == {
        "print",
        "paint_ends",
        "assemble",
    }


def test_price_is_known_only_where_prices_are() -> None:
    assert effort().price is None
    made = effort(effort={"price_camera": 40.0, "price_resin_kg": 100.0})
    assert made.price == pytest.approx(40.0 + 0.1 * (made.mass_g["shell"] + made.mass_g["molds"]))


def test_a_shell_larger_than_the_bed_is_printed_in_pieces() -> None:
    assert effort().parts["shell"] == 1
    sensor = Sensor(design(print_rules={"bed_mm": (80.0, 80.0, 80.0)}))
    parting = part_shell(sensor, shell_manifold(sensor, tolerance_mm=0.1), tolerance_mm=0.1)
    assert effort_of(sensor).parts["shell"] == len(parting.pieces) == 3


def test_molds_that_fit_no_bed_are_left_out_with_the_reason() -> None:
    made = effort(print_rules={"bed_mm": (30.0, 30.0, 300.0)})
    assert "bed" in made.left_out
    assert made.parts["molds"] == made.castings == 0
    assert made.switches == 12


def test_effort_does_not_make_it_another_sensor() -> None:
    assert design_hash(design()) == design_hash(design(effort={"glue_s": 1.0, "price_hour": 50.0}))
