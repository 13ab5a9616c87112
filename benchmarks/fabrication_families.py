"""Switch families: one plunger for each shipped design, and decoders of plungers and bowls.

CalculiX has one switch of each family in :mod:`benchmarks.fabrication_switch`.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_decoder.io.bundle import load_bundle
from phytac_design.core.cache_folder import cache_root
from phytac_design.datasets.samples_file import read_samples
from phytac_design.design.design_file import load_design, shipped_designs, to_toml
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.switch_law import chosen_switches, switch_law
from phytac_design.training.threshold_learning import carried_forces, learn_thresholds
from phytac_shapes.errors import DesignError

RUBBERS = ("mold-star-20t", "dragon-skin-20", "dragon-skin-30")
"""In this order: softer ones do not reach 0.5 N, stiffer ones give way, at these footprints."""


def with_family(design: Design, family: str, material: str) -> Design:
    """Return a design whose switches are of another family and rubber."""
    own = design.switch.model_copy(update={"family": family, "material": material})
    return design.model_copy(update={"switch": own})


def plunger_rows(table: Table, name: str) -> None:
    """Add the spread of a design's plunger, of the first rubber that fits."""
    reasons = []
    for rubber in RUBBERS:
        try:
            (made,) = chosen_switches(with_family(load_design(name), "plunger", rubber))
        except DesignError as error:
            reasons.append(str(error))
            continue
        spread, cup = made["spread"], made["cup"]
        note = (
            f"plunger of {rubber}, {cup['diameter_mm']:.3g} mm wide, "
            f"{cup['height_mm'] + cup['roof_mm']:.2f} high, side wall {cup['side_mm']:.3f}; "
            f"receptors {min(made['receptors_N']):.3f} to {max(made['receptors_N']):.3f} N; "
            f"strain {made['strain']:.0%}; unstable from "
            f"{min(made['buckling_mm'].values(), default=float('nan')):.2f} mm of travel"
        )
        source = "95 % band, ± 0.05 mm of wall, diameter, height, modulus ± 10 %"
        row = f"{name}: spread of a plunger of {made['threshold_N']:g} N"
        table.add(row, 100.0 * spread["band"], "%", 20.0, source, "<= 20.0", note)
        row = f"{name}: threshold off the design's"
        table.add(row, 100.0 * abs(made["error"]), "%", made["threshold_N"], source, "<= 1.0")
        return
    row, source = f"{name}: rubbers whose plunger of the threshold fits", ", ".join(RUBBERS)
    why = "; ".join(reason.partition("(")[2].partition("; take another")[0] for reason in reasons)
    table.add(row, 0.0, "-", 1.0, source, ">= 1", why)


def add_rows(table: Table, *, quick: bool) -> None:
    """Add all rows; ``quick`` takes one design."""
    for name in ["cylinder60"] if quick else shipped_designs():
        plunger_rows(table, name)


SAMPLES, FRAMES = 200, 10
PRINT = 1
"""Virtual print whose data are read: its thresholds scatter by 10 %."""


def phytac(*words: object) -> None:
    """Run a command of the program; it resumes what an earlier run left."""
    start = "from phytac_design.cli.app import main; main()"
    command = [sys.executable, "-c", start, *map(str, words)]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)


def evaluated(folder: Path, design: Design, *, route: str, samples: int) -> dict[str, Any]:
    """Evaluation of a draft decoder, untrained, on samples of a virtual print."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "design.toml"
    path.write_text(to_toml(design))
    draft = ["--accuracy", "draft"]
    decoder = folder / "build" / "decoder"
    if not (decoder / "bundle.json").exists():
        phytac("build", path, "--only", "decoder", *draft, "--out", folder / "build")
    data, out = folder / route, folder / f"{route}-evaluated"
    how = ["--route", route, "--samples", samples, "--unit", PRINT, "--displacement", "linear"]
    phytac("simulate", path, "platform", *how, *draft, "--workers", 1, "--out", data)
    phytac("evaluate", decoder, data, "--design", path, "--out", out, "--force")
    found: dict[str, Any] = json.loads((out / "evaluation.json").read_text())
    return found


def _designs() -> dict[str, Design]:
    bowl = load_design("cylinder60")
    return {"bowl": bowl, "plunger": with_family(bowl, "plunger", RUBBERS[0])}


def _folder() -> Path:
    return cache_root() / "benchmark-families"


def decoder_rows(table: Table, *, quick: bool) -> None:
    """Decoders of a plunger and of a bowl on cylinder60: errors of forces, thresholds."""
    designs, error = _designs(), {}
    samples = 8 if quick else SAMPLES
    for name, design in designs.items():
        found = evaluated(_folder() / name, design, route="points", samples=samples)
        groups = found["estimators"]["auto"]["height"]
        middle = next(key for key in groups if key.startswith("middle"))
        error[name] = groups[middle]["relative_error"]["value"]
        row = f"cylinder60, {name}: relative error at middle height"
        source = f"auto, draft, untrained; {samples} samples of print {PRINT}, points, linear"
        table.add(row, 100.0 * error[name], "%", "-", source)
    row = "cylinder60: error at middle height, plunger over bowl"
    table.add(row, error["plunger"] / error["bowl"], "ratio", 1.0, "both above", "<= 1.1")
    threshold_rows(table, _folder() / "plunger", designs["plunger"], samples)


def frame_rows(table: Table, *, quick: bool) -> None:
    """Switches that the decoders of both read as on, in rendered frames."""
    frames = 2 if quick else FRAMES
    for name, design in _designs().items():
        found = evaluated(_folder() / name, design, route="frames", samples=frames)["switches"]
        source = f"{frames} rendered frames of print {PRINT}; {found['on']} on, {found['off']} off"
        row = f"cylinder60, {name}: switches that are on and read as on"
        value = 100.0 * (1.0 - found["missed"] / found["on"])
        table.add(row, value, "%", 100.0, source, ">= 95")
        row = f"cylinder60, {name}: switches that are off and read as on"
        table.add(row, 100.0 * found["false"] / found["off"], "%", 0.0, source, "<= 0.5")


def threshold_rows(table: Table, folder: Path, design: Design, samples: int) -> None:
    """Errors of thresholds by design, and learnt from the samples."""
    sensor = Sensor(design)
    law = switch_law(design, sensor.markers)
    section = SensorInstanceSection(number=PRINT)
    true = draw_sensor_instance(sensor, section, 0).on_N
    bundle = load_bundle(folder / "build" / "decoder")
    data, _ = read_samples(folder / "points")
    learnt, _ = learn_thresholds(bundle, sensor, law, data)
    carried, _ = carried_forces(sensor, data)
    # Switches that no sample pressed near their threshold tell nothing.
    asked = int((((carried > 0.6 * true) & (carried < 1.6 * true)).sum(axis=0) >= 3).sum())
    before, after = (
        100.0 * float(np.std(np.log(one.threshold_N / true))) for one in (bundle, learnt)
    )
    row = "cylinder60, plunger: scatter of thresholds less those learnt"
    source = f"{samples} samples of print {PRINT}; reference: before"
    note = f"{asked} of {len(true)} switches were pressed near their threshold three times or more"
    table.add(row, after, "%", before, source, "<= 9.5", note)
