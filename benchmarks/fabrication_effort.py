"""Parts, hand work and material as `phytac check` states them, against what is built.

Every shipped design, and cylinder60 as a sensor without switches.
"""

import time

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, parse_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.bill_of_materials import switch_parts
from phytac_design.fabrication.effort.effort import Effort, effort_of
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.switch_stage import switches_of

BUILT = "cylinder60"
"""Its molds and hardware are built."""
ESTIMATE = "estimated from the design alone; times are those of [effort]"


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of all designs; ``quick`` takes one."""
    for name in ["plane"] if quick else shipped_designs():
        stated(table, name, load_design(name))
    bare = parse_design(
        load_design(BUILT).model_dump(mode="json") | {"receptor": {"diameter_hole_mm": 0.0}}, BUILT
    )
    stated(table, f"{BUILT} without switches", bare)
    if not quick:
        built(table, load_design(BUILT))


def stated(table: Table, name: str, design: Design) -> None:
    """What is stated of a design, and its shell against the solid."""
    sensor = Sensor(design)
    count = sensor.markers.count  # made before the clock starts
    start = time.perf_counter()
    found = effort_of(sensor)
    seconds = time.perf_counter() - start
    parts = ", ".join(f"{count} {group}" for group, count in found.parts.items() if count)
    table.add(
        f"{name}: parts handled",
        found.parts_handled,
        "",
        "-",
        ESTIMATE,
        note=f"{count} markers; {parts}",
    )
    table.add(
        f"{name}: hand work",
        found.hours_total,
        "h",
        found.hours_paint_and_glue,
        "painting and gluing, h",
        note=", ".join(f"{group} {hours:.2f}" for group, hours in found.hours.items() if hours),
    )
    grams = ", ".join(f"{group} {mass:.1f}" for group, mass in found.mass_g.items() if mass)
    table.add(f"{name}: material", sum(found.mass_g.values()), "g", "-", ESTIMATE, note=grams)
    exact = float(shell_manifold(sensor).volume())
    off = 100.0 * abs(found.volume_mm3["shell"] / exact - 1.0)
    row = f"{name}: volume of the shell, estimate against solid"
    table.add(row, off, "%", exact, "manifold3d, mm3", "<= 0.5")
    table.goal(f"{name}: time of the estimate", seconds, "s", "<= 2")


def built(table: Table, design: Design) -> None:
    """Parts and volumes of molds, switches and hardware, against those of a build."""
    found: Effort = effort_of(Sensor(design))
    context, _, _ = run_stages(
        design,
        select_stages(["mold", "hardware"]),
        accuracy="draft",
        seed=0,
        progress=lambda _: None,
    )
    molds, hardware = (context.facts(name)["parts"] for name in ("mold", "hardware"))
    switches = [part for part in switch_parts(switches_of(context)) if part["volume_mm3"]]

    def off(group: str, exact: float) -> float:
        return 100.0 * abs(found.volume_mm3[group] / exact - 1.0)

    def volume(material: str) -> float:
        rows = [*molds, *switches]
        return float(sum(r["count"] * r["volume_mm3"] for r in rows if r["material"] == material))

    for group, material, target in (
        ("molds", "resin", "<= 1"),
        ("silicone", "silicone", "<= 1"),
        ("rubber", "tpu", "<= 5"),
    ):
        exact = volume(material)
        row = f"{design.name}: volume of {group}, estimate against build"
        table.add(row, off(group, exact), "%", exact, "bill of materials, mm3", target)
    counted = {
        "molds": sum(part["material"] == "resin" for part in molds),
        "silicone": sum(part["material"] == "silicone" for part in molds),
        "switches": sum(part["count"] for part in switches),
        "hardware": sum(part["count"] for part in hardware if part["material"] == "resin"),
        "screws": sum(part["count"] for part in hardware if part["material"] in ("steel", "brass")),
        "bought": sum(part["count"] for part in hardware if part["material"] == "electronics"),
    }
    wrong = {group: count for group, count in counted.items() if count != found.parts[group]}
    table.goal(
        f"{design.name}: groups of parts with another count than the bill of materials",
        len(wrong),
        "",
        "== 0",
        note=", ".join(f"{count} {group}" for group, count in counted.items()),
    )
    kinds = len(switches)
    row = f"{design.name}: kinds of switches, less those of the bill of materials"
    table.goal(row, found.switch_kinds - kinds, "", "== 0", note=f"{kinds} kinds")
