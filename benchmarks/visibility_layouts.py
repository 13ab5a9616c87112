"""Layouts of the published sensor side by side: same count, camera and load; then ever denser."""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.worst_places import press_places
from phytac_design.optics.gaps import marker_gaps, outline_gaps
from phytac_design.optics.incremental_renderer import IncrementalRenderer
from phytac_design.optics.loaded_visibility import (
    LoadedVisibility,
    marker_state,
    visibility_under_load,
)
from phytac_design.optics.raster import pixels_alone, rasterise
from phytac_design.optics.render_scene import build_scene, paint_owner
from phytac_design.optics.visibility import Visibility, check_visibility
from phytac_design.rules.check import check_design
from phytac_design.stages.build import copy_of
from phytac_design.stages.loaded_views_stage import PressedShell, see_pressed
from phytac_shapes.errors import DesignError

STUDY = "design study of this sensor"
PLACES, PLACES_DENSE, PLACES_SCAN = 8, 40, 24
LINEAR_TIMES = 1.3
"""Linear motions are enlarged by this where presses are only scanned: what large displacement
adds at 25 N over a patch of 7 mm radius on this shell, with some to spare."""
LAYOUTS: dict[str, dict[str, Any]] = {
    "spiral, angle from the axis": {},
    "spiral, angle from the circumference": {"spiral_from": "circumference"},
    "straight": {"kind": "straight"},
    "straight, checkerboard colours": {"kind": "straight", "colour_pattern": "checkerboard"},
    "phyllotaxis": {"kind": "phyllotaxis", "count": 368},
    "spiral, line-of-sight heights": {"heights": "line-of-sight", "sight_margin_mm": 1.2},
}
FUSED_STUDY = {
    "spiral, angle from the axis": ("0", "== 0"),
    "spiral, angle from the circumference": ("36-164", None),
    "straight": ("116-316", None),
    "straight, checkerboard colours": ("0", None),
}
GAP_STUDY = {"spiral, angle from the axis": "4-5"}
CROSSTALK_STUDY = {
    "spiral, angle from the axis": "about 0",
    "straight, checkerboard colours": "1-2.6",
}
DENSE_TARGETS = {
    "markers": ">= 736",
    "least gap, same colour": ">= 8",
    "least gap, other colour": ">= 4",
    "least visible fraction": ">= 0.97",
    "occluded": "== 0",
    "fused": "== 0",
    "fused at most": "== 0",
    "hidden at most": "== 0",
    "crosstalk": "<= 0.1",
}


@dataclass(frozen=True, kw_only=True)
class LayoutCase:
    """A layout, what is seen of it at rest, and under load."""

    name: str
    context: Context
    rest: Visibility
    load: LoadedVisibility

    @property
    def label(self) -> str:
        """Beginning of its rows."""
        return f"{self.context.design.name} {self.context.markers.count}, {self.name}"


def context_of(design: Design, *, linear: bool, places: int = PLACES) -> Context:
    """Context of a stage, at standard accuracy."""
    accuracy = replace(PRESETS["standard"], press_places=places)
    if linear:
        accuracy = replace(accuracy, press_tolerance=1.0)
    return Context(design=design, accuracy=accuracy, seed=0, progress=lambda _: None)


def seen_at_rest(context: Context) -> tuple[Visibility, np.ndarray]:
    """Visibility, and the least gap of each marker."""
    rng = np.random.default_rng(0)
    seen = check_visibility(context.sensor, rng=rng)
    return seen, np.minimum(seen.gap_same_colour_px, seen.gap_other_colour_px)


def case_of(name: str, design: Design, *, places: int, linear: bool = False) -> LayoutCase:
    """Look at a design at rest and pressed."""
    context = context_of(design, linear=linear, places=places)
    rest, gap = seen_at_rest(context)
    return LayoutCase(name=name, context=context, rest=rest, load=see_pressed(context, gap)[1])


def add_case(table: Table, case: LayoutCase) -> None:
    """Rows of one layout."""
    rest, load, training = case.rest, case.load, case.context.design.training
    dense = case.context.design.name == "cylinder60-dense"
    force = f"{training.force_max_N:g} N"
    at_rest = [
        ("markers", case.context.markers.count, "markers", None),
        ("occluded", rest.occluded.sum(), "markers", None),
        ("fused", rest.fused.sum(), "markers", FUSED_STUDY.get(case.name)),
        ("least gap, same colour", rest.gap_same_colour_px.min(), "px", GAP_STUDY.get(case.name)),
        ("least gap, other colour", rest.gap_other_colour_px.min(), "px", None),
        ("least visible fraction", rest.visible_fraction.min(), "-", None),
    ]
    under = [
        ("fused at most", load.fused.max(), "markers", None),
        ("hidden at most", load.hidden.max(), "markers", None),
        ("least gap, same colour", load.least_gap_same_px.min(), "px", None),
        ("least gap, other colour", load.least_gap_other_px.min(), "px", None),
        ("least visible fraction", load.least_fraction.min(), "-", None),
        ("crosstalk", load.crosstalk_px.max(), "px", CROSSTALK_STUDY.get(case.name)),
        ("crosstalk where markers stand still", load.crosstalk_still_px.max(), "px", None),
        ("greatest image shift", load.shift_px.max(), "px", None),
    ]
    note = f"worst of {len(load.fused)} presses, radius {training.patch_radius_max_mm:g} mm"
    for when, rows in (("at rest", at_rest), (force, under)):
        for what, value, unit, study in rows:
            reference, target = study if isinstance(study, tuple) else (study, None)
            if dense:
                target = DENSE_TARGETS.get(what)
                if when == force and what.startswith("least"):
                    target = None
            row = f"{case.label}: {when}: {what}"
            source = STUDY if reference else "not published"
            table.add(
                row,
                float(value),
                unit,
                reference or "none",
                source,
                target,
                note if when == force else "",
            )


def add_heights(table: Table, linear: LayoutCase, sight: LayoutCase) -> None:
    """How much line-of-sight heights gain over linear ones, same places on the wall."""
    name = "368, line-of-sight heights over linear"
    before, after = linear.load, sight.load
    rows: list[tuple[str, float, float, float, str]] = [
        ("crosstalk, less by", before.crosstalk_px.max(), after.crosstalk_px.max(), -1.0, "px"),
        (
            "least visible fraction, more by",
            before.least_fraction.min(),
            after.least_fraction.min(),
            1.0,
            "-",
        ),
        (
            "least gap, same colour, more by",
            before.least_gap_same_px.min(),
            after.least_gap_same_px.min(),
            1.0,
            "px",
        ),
    ]
    tallest = [case.context.markers.height_mm.max() for case in (sight, linear)]
    for what, old, new, sign, unit in rows:
        row = f"{name}: {what}"
        source = "linear heights, same run"
        note = (
            f"under load; now {new:.3g} {unit}; tallest receptor {tallest[0]:.1f} instead of "
            f"{tallest[1]:.1f} mm"
        )
        value = float(sign * (new - old))
        target = "> 0" if what.startswith("least gap") else ">= 0"
        table.add(row, value, unit, float(old), source, target, note)


def add_places(table: Table, design: Design, counts: tuple[int, ...]) -> None:
    """How the worst case depends on the number of places, by linear theory."""
    context = context_of(design, linear=True)
    surface, markers = context.surface, context.markers
    camera = camera_of(design, surface)
    scene = build_scene(
        Sensor.of(design, surface, markers), tolerance_mm=tolerance_mm(camera, markers)
    )
    gap = seen_at_rest(context)[1]
    shell = PressedShell(context)
    found: dict[int, LoadedVisibility] = {}
    for count in counts:
        uv = press_places(surface, markers, gap, count, repeats=shell.repeats)
        motions = LINEAR_TIMES * shell.motions(uv, (1.0,))[0]
        found[count] = visibility_under_load(
            scene,
            camera,
            pivots_mm=markers.mid_mm,
            motions=motions,
            forces_N=np.array([design.training.force_max_N]),
        )
    last = found[counts[-1]]
    for count, load in found.items():
        row = f"{design.name}: crosstalk found at {count} places"
        source = f"{len(last.fused)} places, same run"
        note = (
            f"linear theory times {LINEAR_TIMES:g}; least gaps "
            f"{load.least_gap_same_px.min():.2f} and {load.least_gap_other_px.min():.2f} px"
        )
        value = float(load.crosstalk_px.max())
        table.add(row, value, "px", float(last.crosstalk_px.max()), source, note=note)


def add_speed(table: Table, design: Design, repeats: int) -> None:
    """One pose seen by windows, and on the whole image, in turn; and that both agree."""
    surface = design.surface()
    markers = context_of(design, linear=True).markers
    camera = camera_of(design, surface)
    scene = build_scene(
        Sensor.of(design, surface, markers), tolerance_mm=tolerance_mm(camera, markers)
    )
    motion = np.random.default_rng(0).normal(scale=0.2, size=(markers.count, 3))
    moved = scene.moved(motion, 0.1 * motion, markers.mid_mm)
    renderer = IncrementalRenderer(scene, camera)
    marker_state(renderer.render(moved), moved)
    times = np.zeros((repeats, 2))
    for k in range(repeats):
        begin = time.perf_counter()
        sample = renderer.render(moved)
        gaps = outline_gaps(sample.pixels, sample.starts, scene.colour)
        middle = time.perf_counter()
        owner = paint_owner(rasterise(moved, camera).part)
        plain = marker_gaps(owner, scene.colour)
        alone = pixels_alone(moved, camera)[0]
        times[k] = middle - begin, time.perf_counter() - middle
    own, whole = np.median(times, axis=0)
    label = f"{design.name} {camera.width_px}x{camera.height_px}, one press seen"
    differs = int((np.bincount(owner[owner >= 0]) != sample.visible[:, 0]).sum())
    differs += int((sample.alone[:, 0] != alone).sum())
    differs += sum(int((a != b).sum()) for a, b in zip(gaps, plain, strict=True))
    source = "whole ID map, gaps and pixels alone, same run"
    table.add(f"{label}: figures of markers that differ", differs, "figures", 0, source, "== 0")
    table.add(f"{label}: time", own, "s", reference=whole, source=source, target="<= 0.1")
    table.add(
        f"{label}: times faster", whole / own, "ratio", reference=1.0, source=source, target="> 1"
    )


FOUR = ("blue", "green", "magenta", "yellow")
DENSER: tuple[tuple[int, int, float, float, float, tuple[str, ...]], ...] = (
    (33, 26, 47.64, 0.8, 3.6, FOUR[:2]),
    (33, 28, 45.26, 0.7, 3.6, FOUR[:2]),
    (33, 30, 43.54, 0.7, 3.6, FOUR[:3]),
    (33, 28, -39.8, 0.6, 3.6, FOUR),
    (36, 28, -42.27, 0.7, 3.2, FOUR),
    (33, 32, -36.09, 0.6, 3.6, FOUR),
    (38, 32, -40.0, 0.6, 3.0, FOUR),
)
"""Rows, columns, spiral angle (deg), margin (mm), switch footprint (mm), paints. The angles shift
rows by 0.55 or -0.45 of a column pitch: the latter, with four paints moved on by one a row, keeps
all near neighbours apart in colour."""


def add_denser(table: Table, base: Design) -> None:
    """What binds where, as counts grow: rules, space in the image, crosstalk."""
    for rows, columns, angle, margin, footprint, colours in DENSER:
        layout = {
            "rows": rows,
            "columns": columns,
            "spiral_angle_deg": angle,
            "sight_margin_mm": margin,
            "colours": colours,
            "colour_pattern": "checkerboard" if len(colours) == len(FOUR) else "columns",
        }
        add_bound(table, copy_of(base, layout=layout, switch={"footprint_diameter_mm": footprint}))


def add_bound(table: Table, design: Design) -> None:
    """One denser design: its count, and what it misses."""
    layout = design.layout
    label = (
        f"{design.name} with {layout.rows} x {layout.columns}, {len(layout.colours)} paints, "
        f"α {layout.spiral_angle_deg:g}°, margin {layout.sight_margin_mm:g} mm"
    )
    try:
        check_design(design)
        case = case_of(label, design, places=PLACES_SCAN, linear=True)
    except DesignError as error:
        note = f"not possible: {error}"
        table.add(f"{label}: markers", layout.wanted, "markers", "none", "own scan", note=note)
        return
    rest, load, row = case.rest, case.load, case.context.markers.row
    figures = {
        "same-colour gap": (rest.gap_same_colour_px.min(), 8.0, rest.gap_same_colour_px.argmin()),
        "other-colour gap": (
            rest.gap_other_colour_px.min(),
            4.0,
            rest.gap_other_colour_px.argmin(),
        ),
        "visible fraction": (rest.visible_fraction.min(), 0.97, rest.visible_fraction.argmin()),
        "crosstalk (sign turned)": (-load.crosstalk_px.max(), -0.1, load.crosstalk_px.argmax()),
        "fused at rest (sign turned)": (-rest.fused.sum(), 0, rest.fused.argmax()),
        "fused under load (sign turned)": (-load.fused.max(), 0, load.least_gap_same_px.argmin()),
    }
    missed = {name: f for name, f in figures.items() if f[0] < f[1]}
    listed = ", ".join(
        f"{name} {float(value):.3g} (asked {asked:g}, row {row[at]})"
        for name, (value, asked, at) in (missed or figures).items()
    )
    note = (
        ("misses " if missed else "holds: ")
        + listed
        + f"; tallest receptor {case.context.markers.height_mm.max():.1f} mm; pressed by linear "
        "theory"
    )
    reference = case.context.markers.count
    table.add(f"{label}: demands missed", len(missed), "demands", reference, "markers", note=note)


def add_rows(table: Table, *, quick: bool) -> None:
    """All layouts of ``cylinder60``, the dense design, and beyond it."""
    base, dense = load_design("cylinder60"), load_design("cylinder60-dense")
    if quick:
        add_case(table, case_of("spiral, angle from the axis", base, places=2, linear=True))
        return
    cases = {}
    for name, change in LAYOUTS.items():
        cases[name] = case_of(name, copy_of(base, layout=change), places=PLACES)
        add_case(table, cases[name])
    add_heights(table, cases["spiral, angle from the axis"], cases["spiral, line-of-sight heights"])
    name = "spiral, line-of-sight heights"
    add_case(table, case_of(name, dense, places=PLACES_DENSE))
    add_speed(table, dense, 7)
    add_places(table, base, (4, 8, 16, 24, 40, 80))
    add_denser(table, dense)
