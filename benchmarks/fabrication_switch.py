"""Threshold switches: the solver against references, and five switches designed to a threshold."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.bowl import bowl_model
from phytac_design.mechanics.switch.cup_design import CupDesign
from phytac_design.mechanics.switch.cup_press import press_cup
from phytac_design.mechanics.switch.curve import press_bowl, snap_of
from phytac_design.mechanics.switch.design import SwitchDesign, design_switch
from phytac_design.mechanics.switch.feasible_range import FeasibleRange, feasible_range
from phytac_design.mechanics.switch.line_plot import line_plot, write_svg
from phytac_design.mechanics.switch.rubbers import RUBBERS, rubber
from phytac_design.mechanics.switch.switch_families import FAMILIES, compare_families
from phytac_design.mechanics.switch.switch_inputs import space_of
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_design.optics.tip_travel import tip_travel_on_mm
from phytac_shapes.errors import DesignError
from verification import switch_cases
from verification.bowl_calculix import ccx_curve

IMAGES = Path(__file__).parents[1] / "docs" / "images"
MESCALL = "Mescall 1966, clamped cap R 4.758 in, t 0.01576, a 0.9, ring load at 0.42 a"
SOFTER_MPa = 3.5
"""A mix soft enough for 0.1 N: one rubber then covers 0.1 N to the largest that fits."""


def cap(table: Table, *, quick: bool) -> None:
    """Peak and valley of the published cap under a ring load."""
    cells, steps = ((30, 1), 20) if quick else ((100, 2), 40)
    found = switch_cases.clamped_cap(cells=cells, steps=steps)
    (_, peak), (_, valley) = found.extremes()
    for name, value, lb, other in (("peak", peak, 74.5, 74.85), ("valley", valley, 37.4, 37.65)):
        row = f"cap, ring load, {name}: error"
        source = f"{MESCALL}; another author {other} lb"
        note = f"{value:.2f} lb, {100.0 * (value / other - 1.0):+.2f} % off the other author"
        table.add(row, 100.0 * abs(value / lb - 1.0), "%", lb, source, "<= 2.0", note)


def _switch_rows(table: Table, made: SwitchDesign, seconds: float) -> None:
    modulus = made.rubber.material.modulus_MPa
    name = f"switch {made.threshold_N:.3g} N at {modulus:g} MPa"
    fine = snap_of(press_bowl(made.bowl, made.rubber.material, refine=3, steps=8, end_mm=0.9))
    limit = fine.limit_N if fine else float("nan")
    bowl, snap, spread = made.bowl, made.snap, made.spread
    row = f"{name}: limit load off the request"
    source = "the bowl solved again on a finer mesh (1.5 times as many elements each way)"
    note = (
        f"wall {bowl.thickness_mm:.3f}, depth {bowl.depth_mm:.2f}, diameter "
        f"{bowl.diameter_mm:g} mm, fillets {bowl.fillet_mm:.2g}; limit at "
        f"{snap.limit_stroke_mm:.2f} mm"
    )
    value = 100.0 * abs(limit / made.threshold_N - 1.0)
    table.add(row, value, "%", made.threshold_N, source, "<= 1.0", note)
    row = f"{name}: valley over limit"
    table.add(row, snap.valley_N / snap.limit_N, "-", "monostable: > 0.1", "derived here", "> 0.1")
    row = f"{name}: red out of the end face"
    source = "stroke and recess of the design"
    value = made.visible_mm
    table.add(row, value, "mm", made.space.visible_mm, source, f">= {made.space.visible_mm}")
    row = f"{name}: peak strain"
    source = made.rubber.assumption
    table.add(row, snap.strain, "-", made.rubber.strain_max, source, f"<= {made.rubber.strain_max}")
    row = f"{name}: half of the 95 % band of the threshold, sampled"
    source = (
        f"wall ± {made.tolerance.thickness_mm} mm, modulus ± {made.tolerance.modulus:.0%}; "
        "reference by slopes alone"
    )
    note = f"threshold grows as wall^{spread.exponent_thickness:.2f}"
    value = 50.0 * (spread.high_N - spread.low_N) / made.threshold_N
    table.add(row, value, "%", 100.0 * spread.sensitivity_N / made.threshold_N, source, note=note)
    row = f"{name}: waves n = 1 to 6 that are unstable before the limit"
    source = "tangent by wave number"
    note = f"beyond it: {made.buckling}" if made.buckling else "none beyond it either"
    value = float(sum(way <= snap.limit_stroke_mm for way in made.buckling.values()))
    table.add(row, value, "-", 0.0, source, "== 0", note)
    table.add(
        f"{name}: design", seconds, "s", reference=20.0, source="processor time", target="<= 20"
    )


def switches(table: Table, *, quick: bool) -> None:
    """Five switches of one rubber, the published threshold at the assumed modulus, a rejection."""
    space, hard = SwitchSpace(), rubber("tpu-8400n")
    soft = hard.of_modulus(SOFTER_MPa)
    found = feasible_range(soft, space)
    if found is None:
        raise DesignError(
            "switch-infeasible", "no switch fits the default space; check the space's defaults"
        )
    largest = 0.99 * found.max_N
    asks = [(0.5, hard)] if quick else [(0.5, hard), *((f, soft) for f in (0.1, 0.2, 0.35))]
    if not quick:
        asks += [(0.5, soft)] if largest > 0.5 else []
        asks += [(round(largest, 3), soft)]
    curves = {}
    for threshold, chosen in asks:
        start = time.process_time()
        made = design_switch(threshold, chosen, space)
        _switch_rows(table, made, time.process_time() - start)
        stroke, force, _ = made.curve.dense()
        curves[f"{threshold:g} N, {chosen.material.modulus_MPa:g} MPa"] = (stroke, force)
        if chosen is hard:
            calculix(table, made, quick=quick)
    _range_rows(table, found)
    refusal(table, space)
    if not quick:
        write_svg(
            IMAGES / "switch_curves.svg",
            line_plot(curves, title="Threshold switches", labels=("stroke (mm)", "force (N)")),
        )


def _range_rows(table: Table, found: FeasibleRange) -> None:
    for modulus in (1.0, SOFTER_MPa, 10.0):
        share = modulus / found.modulus_MPa
        low, high = share * found.min_N, share * found.max_N
        for word, value in (("smallest", low), ("largest", high)):
            row = f"{word} threshold that fits at {modulus:g} MPa"
            source = (
                f"footprint 4.6 mm, hole 1.6, red 1.2, walls {found.min_wall_mm:.2f} to "
                f"{found.max_wall_mm:.2f} mm"
            )
            table.add(row, float(value), "N", "-", source)


def refusal(table: Table, space: SwitchSpace) -> None:
    """A rejected threshold names moduli that allow it: the middle one is tried."""
    hard = rubber("tpu-8400n")
    try:
        design_switch(0.1, hard, space)
    except DesignError as error:
        low, high = (float(x) for x in str(error).split("rubber of ")[1].split()[:3:2])
    middle = float(np.sqrt(low * high))
    made = design_switch(0.1, hard.of_modulus(middle), space)
    row = "0.1 N at 10 MPa is refused; at the middle of the moduli it names: limit load off"
    table.add(row, 100.0 * abs(made.error), "%", 0.1, f"{low:g} to {high:g} MPa named", "<= 1.0")


def calculix(table: Table, made: SwitchDesign, *, quick: bool) -> None:
    """Limit load of the same bowl in CalculiX."""
    if shutil.which("ccx") is None:
        return
    body = bowl_model(made.bowl, made.rubber.material, refine=1 if quick else 2)
    with tempfile.TemporaryDirectory() as name:
        _, force = ccx_curve(Path(name), body, stroke_mm=1.25 * made.snap.limit_stroke_mm, steps=20)
    row = f"switch {made.threshold_N:g} N: limit load off CalculiX's"
    source = "CalculiX, CAX8R, *HYPERELASTIC, NLGEOM, the same nodes"
    value = 100.0 * abs(made.snap.limit_N / float(force.max()) - 1.0)
    table.add(row, value, "%", float(force.max()), source, "<= 3.0")


def families(table: Table, *, quick: bool) -> None:
    """Families that do not snap: one of each in CalculiX; the spread of all rubbers that fit."""
    design = load_design("cylinder60")
    space, travel = space_of(design), tip_travel_on_mm(Sensor(design))
    ends = [float(np.nanmin(travel)), float(np.nanmax(travel))]
    source = "travel at which a tip's red is half way between off and on, of cylinder60"
    table.add(
        "tips of cylinder60: longest travel less shortest", ends[1] - ends[0], "mm", 0, source
    )
    one = "mold-star-20t"
    rubbers = [rubber(one)] if quick else list(RUBBERS.values())
    found = compare_families(
        design.switch.threshold_N,
        [*rubbers, rubber("tpu-8400n").of_modulus(SOFTER_MPa)],
        space,
        travel,
        families=("membrane", "plunger") if quick else FAMILIES,
    )
    for candidate in found:
        if candidate.spread is None:
            continue
        name = f"{candidate.family} of {candidate.rubber.name}"
        modulus = candidate.rubber.material.modulus_MPa
        spread = candidate.spread
        note = (
            f"wall {spread.thickness:.1%}, diameter {spread.diameter:.1%}, height "
            f"{spread.height:.1%}, modulus {spread.modulus:.1%}; {candidate.height_mm:.2f} mm high"
        )
        source = f"95 % band at {modulus:.3g} MPa, ± 0.05 mm, modulus ± 10 %"
        row = f"0.5 N on cylinder60, {name}, {modulus:.3g} MPa: spread"
        table.add(row, 100.0 * spread.band, "%", 20.0, source, note=note)
    best = found[0].spread
    value = 100.0 * best.band if best else float("nan")
    name = f"{found[0].family} of {found[0].rubber.name}"
    source = "the family that is recommended"
    table.add("0.5 N on cylinder60: smallest spread", value, "%", 20.0, source, "<= 20.0", name)
    for family in ("membrane", "plunger"):
        made = next((item.design for item in found if item.family == family), None)
        if isinstance(made, CupDesign):
            _cup_in_calculix(table, made, quick=quick)


def _cup_in_calculix(table: Table, made: CupDesign, *, quick: bool) -> None:
    """Threshold of the same membrane or plunger in CalculiX."""
    if shutil.which("ccx") is None:
        return
    refine = 1 if quick else 2
    curve = press_cup(made.cup, made.rubber.material, travel_mm=made.travel_mm, refine=refine)
    end = curve.at("pad_mm", made.travel_mm)
    with tempfile.TemporaryDirectory() as name:
        _, force = ccx_curve(Path(name), curve.body, stroke_mm=end, steps=10)
    row = f"{made.cup.family} 0.5 N: threshold off CalculiX's"
    source = "CalculiX, CAX8R, *HYPERELASTIC, NLGEOM, the same nodes"
    value = 100.0 * abs(float(curve.force_at(made.travel_mm)) / float(force[-1]) - 1.0)
    table.add(row, value, "%", float(force[-1]), source, "<= 3.0", made.rubber.name)


def shipped(table: Table, *, quick: bool) -> None:
    """Switches of the shipped designs: limit load, spread of lengths, red that the camera sees."""
    for name in ["cylinder60"] if quick else shipped_designs():
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / "out"
            words = ["build", name, "--only", "views,switch", "--out", str(out)]
            subprocess.run(
                [sys.executable, "-c", "from phytac_design.cli.app import main; main()", *words],
                env={**os.environ, "PHYTAC_CACHE": str(Path(scratch) / "cache")},
                stdout=subprocess.DEVNULL,
                check=True,
            )
            facts = json.loads((out / "switch" / "switches.json").read_text())
            (views,) = (Path(scratch) / "cache" / "views").glob("*/facts.json")
            red = json.loads(views.read_text())["red"]
        error = max(abs(item["error"]) for item in facts["switches"])
        row = f"{name}: limit load off the design's threshold"
        source = "the bowl's own curve"
        note = f"{len(facts['parts'])} lengths of stem"
        table.add(
            row, 100.0 * error, "%", facts["switches"][0]["threshold_N"], source, "<= 1.0", note
        )
        wanted = red["farthest_needed_px"]
        row = f"{name}: red of the farthest switch when on"
        source = f"rendered; the decoder needs {wanted:.3g} px there"
        note = (
            f"{red['unreadable']} switches of this design show too little"
            if red["unreadable"]
            else "every switch shows enough"
        )
        table.add(row, red["farthest_on_px"], "px", wanted, source, f"> {wanted:.3g}", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes coarse meshes and one switch."""
    shipped(table, quick=quick)
    cap(table, quick=quick)
    switches(table, quick=quick)
    families(table, quick=quick)
