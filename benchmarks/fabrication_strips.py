"""Strips of switches on every shipped design: parts, hours, fit, molds, and what neighbours feel.

Hours before and after are those of the same time model, `[effort]`. Bowls are nominal ones, as
`phytac check` has them. Coupling is a solid of two bowls by CalculiX.
"""

import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.fabrication_parts import ran, repair_row, slice_row
from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, parse_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.fabrication.effort.effort import Effort, effort_of, nominal_switches
from phytac_design.fabrication.molds.audit import audit_set, fine_sections
from phytac_design.fabrication.molds.make import make_molds, strips_of
from phytac_design.fabrication.switch_strips import StripSet, web_gap_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.hyperelastic import Material
from phytac_design.mechanics.switch.switch_inputs import rubber_of
from phytac_design.stages.mold_stage import MOLD
from verification.strip_coupling import BowlPair, PairForces, Web, pair_forces

MAIN = "cylinder60"
EASY = "examples/uses/cylinder60_strips.toml"
"""The same sensor with strips, plungers, one printer of several materials, and rigid molds."""
PARTS_MAX, HOURS_SHARE = 60, 1.0 / 3.0
"""What strips are to reach on the main design: parts handled, hours after over before."""
COUPLING_MAX = 5.0
"""Most force on a neighbour's pad, percent of that on the pressed one."""


def in_strips(design: Design, **mold: str) -> Design:
    """The design with its switches on strips, all else as shipped."""
    data = design.model_dump(mode="json")
    return parse_design(
        data | {"strip": {"form": "strip"}, "mold": data["mold"] | mold}, design.name
    )


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of all designs; ``quick`` takes one, and a coarse solid."""
    for name in ["plane"] if quick else shipped_designs():
        design = load_design(name)
        handled(table, design)
        sensor = Sensor(in_strips(design))
        strips = strips_of(sensor, nominal_switches(sensor))
        assert strips is not None
        fit(table, sensor, strips)
        molds(table, in_strips(design))
    if not quick:
        molds(table, in_strips(load_design(MAIN), way="rigid"))
        easy = load_design(EASY)
        compare(table, effort_of(Sensor(load_design(MAIN))), easy, easy.name, main=True)
        strips = strips_of(Sensor(easy), nominal_switches(Sensor(easy)))
        assert strips is not None
        fit(table, Sensor(easy), strips)
        molds(table, easy)


def handled(table: Table, design: Design) -> None:
    """Parts and hours, single and on strips."""
    before = effort_of(Sensor(design))
    for way in ("silicone-master", "rigid"):
        label = f"{design.name}, strips, {way}"
        compare(table, before, in_strips(design, way=way), label, main=design.name == MAIN)


def compare(table: Table, before: Effort, design: Design, label: str, *, main: bool) -> None:
    """Parts and hours of a design on strips against those ``before``."""
    after = effort_of(Sensor(design))
    words = ", ".join(f"{count} {group}" for group, count in after.parts.items() if count)
    table.add(
        f"{label}: parts handled",
        after.parts_handled,
        "",
        before.parts_handled,
        "single switches",
        f"<= {PARTS_MAX}" if main else None,
        words,
    )
    pens = after.hours["paint_ends"]
    rest = (after.hours_total - pens) / before.hours_total
    table.add(
        f"{label}: hand work over that of single switches",
        after.hours_total / before.hours_total,
        "ratio",
        before.hours_total,
        "h, single switches",
        f"<= {HOURS_SHARE:.3f}" if main else None,
        f"{after.hours_total:.2f} h, {after.castings} castings; {rest:.2f} without the "
        f"{pens:.2f} h of painting receptor ends",
    )


def fit(table: Table, sensor: Sensor, strips: StripSet) -> None:
    """Stretch, strain and clearance of all strips on the shell."""
    name, section = sensor.design.name, strips.section
    note = f"{len(strips.webs)} strips of {min(s.count for s in strips.webs)} to "
    note += f"{max(s.count for s in strips.webs)} switches, {len(strips.numbers)} different"
    table.goal(f"{name}: switches on no strip", strips.singles, "", "== 0", note=note)
    stretch = max(strip.stretch_max for strip in strips.webs)
    row = f"{name}: stretch of a web from mold to shell"
    table.add(row, 100.0 * stretch, "%", 0, "geodesic lengths against flat ones", "<= 1")
    row = f"{name}: strain of a web on the shell, bending and stretch"
    value = 100.0 * max(strip.strain_max for strip in strips.webs)
    limit = 100.0 * section.strain_max
    table.add(row, value, "%", limit, "strip.strain_max, %", f"<= {limit:g}")
    row = f"{name}: clearance of a stem in its hole, pitch error taken off"
    value = min(strip.clearance_mm for strip in strips.strips)
    table.add(row, value, "mm", section.pitch_error_mm, "pitch error, mm", ">= 0")
    rim = 0.5 * max(shape.diameter_mm for shape in strips.switches.bowls)
    row = f"{name}: gap between a web and the nearest bowl of another strip"
    value = min(web_gap_mm(strip, sensor) for strip in strips.webs) - rim
    gap = sensor.design.print_rules.gap_min_mm
    table.add(row, value, "mm", gap, "print_rules.gap_min_mm", f">= {gap:g}")


def molds(table: Table, design: Design) -> None:
    """Molds of a design's strips, audited as those of single switches are."""
    sensor = Sensor(design)
    switches = nominal_switches(sensor)
    strips, start = strips_of(sensor, switches), time.process_time()
    made = make_molds(design.mold, design.print_rules, switches, strips=strips, tolerance_mm=0.02)
    fine = fine_sections(switches)
    audits = [audit_set(each, fine) for each in made]
    seconds = time.process_time() - start
    label = f"{design.name}, strips, {design.mold.way}"
    note = f"{len(made)} sets, {sum(e.plan.castings for e in made)} castings, {seconds:.0f} s"
    row = f"{label}: area that is caught when parts are pulled"
    undercut = sum(audit.undercut_mm2 for audit in audits)
    table.add(row, undercut, "mm2", 0, "projected area, all parts", "<= 0.01", note)
    row = f"{label}: least draft of any face"
    draft, least = design.mold.draft_deg, min(audit.draft_deg for audit in audits)
    table.add(row, least, "deg", draft, "mold.draft_deg", f">= {draft - 2e-3:g}")
    row = f"{label}: volume that closed parts share"
    shared = max(audit.shared_mm3 for audit in audits)
    table.add(row, shared, "mm3", 0, "boolean intersection", "<= 0.05")
    fits = [fit for audit in audits for fit in audit.strips.values()]
    row = f"{label}: volume of the cavities, worst error"
    worst = 100.0 * max(audit.volume_error for audit in audits)
    source = "switches revolved and webs in closed form; cavities shrunk"
    table.add(row, worst, "%", 0, source, "<= 0.5", f"{len(fits)} different strips")
    pieces = sum(one.bodies != 1 for one in fits)
    table.goal(f"{label}: strips that come out in pieces", pieces, "", "== 0")


def file_rows(table: Table, *, quick: bool) -> None:
    """Mold files of strips: faults by admesh; of the small sensor they are sliced, too."""
    for name in ["hemisphere"] if quick else ["hemisphere", EASY]:
        design = load_design(name)
        if name != EASY:
            design = in_strips(design)
        with tempfile.TemporaryDirectory() as folder:
            _, files, _ = ran(MOLD, design, "draft" if quick else "standard", Path(folder))
            label = f"{design.name}, strips: "
            repair_row(table, label, files)
            if name != EASY:  # Plates of 368 cavities take ten minutes.
                plates = [path for path in files if "plate" in path.name or "tray" in path.name]
                slice_row(table, label, plates, "--layer-height", "0.3", "--fill-density", "5%")


def coupling_rows(table: Table, *, quick: bool) -> None:
    """Force on a neighbour's pad, and what the web does to the pressed switch."""
    if shutil.which("ccx") is None:
        return
    sensor = Sensor(in_strips(load_design(MAIN)))
    switches = nominal_switches(sensor)
    strips = strips_of(sensor, switches)
    assert strips is not None
    pitch = min(
        float(np.hypot(*(strip.flat_mm[a] - strip.flat_mm[b])))
        for strip in strips.webs
        for a, b in strip.bridges
    )
    section, bowl = strips.section, switches.bowls[0]
    pair = BowlPair(
        profile=switches.profile(switches.kinds[0], 0.05),
        pitch_mm=pitch,
        web_mm=section.web_mm,
        web_width_mm=section.web_width_mm,
        pad_radius_mm=0.5 * float(getattr(bowl, "pad_diameter_mm", 0.0)),
    )
    pressed(table, pair, rubber_of(sensor.design).material, "at rest", 0.05, 0, 0.16)
    if not quick:
        # The nominal bowl's peak is at 0.45 mm.
        pressed(table, pair, rubber_of(sensor.design).material, "at its peak", 0.5, 10, 0.22)


def pressed(
    table: Table,
    pair: BowlPair,
    material: Material,
    when: str,
    stroke_mm: float,
    steps: int,
    size_mm: float,
) -> None:
    """Rows of one stroke: share of the neighbour, force on the pressed bowl against none."""

    def forces(web: Web) -> PairForces:
        return pair_forces(
            pair, material, web=web, stroke_mm=stroke_mm, steps=steps, size_mm=size_mm
        )

    alone = float(forces("none").pressed_N.max())
    webs: tuple[Web, ...] = ("glued", "loose")
    for web in webs:
        found = forces(web)
        label = f"{MAIN}: strip at its closest pitch, web {web}, bowl pressed {when}"
        law = "large strain" if steps else "linear"
        source = f"CalculiX, {law}, C3D10, {found.nodes} nodes, pitch {pair.pitch_mm:.2f} mm"
        table.add(
            f"{label}: force on the held neighbour",
            100.0 * float(found.share.max()),
            "%",
            0,
            source,
            f"<= {COUPLING_MAX:g}",
        )
        change = 100.0 * (float(found.pressed_N.max()) / alone - 1.0)
        table.add(f"{label}: force more than without a web", change, "%", alone, "N, no web")
