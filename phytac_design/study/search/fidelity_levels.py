"""The fidelity levels: each a pure function from a candidate to its measures.

``rules`` places markers and applies every check that a build makes before it computes anything;
``effort`` counts parts and hand work; ``sampled`` traces some 64 rays a marker and bends the wall
in closed form; ``exact`` renders; ``switch`` solves the threshold bowls; ``mechanics`` takes the
Cramér-Rao bound by finite elements; ``load`` presses the sensor all over and renders; ``twin``
builds and tests its decoder.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.camera.camera import Camera
from phytac_design.design.accuracy import settings_of
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, write_arrays
from phytac_design.fabrication.documents.bill_of_materials import mass_g
from phytac_design.fabrication.effort.effort import effort_of
from phytac_design.fabrication.effort.shell_estimate import shell_volume_mm3
from phytac_design.layout import Markers
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.optics.density import density_of
from phytac_design.optics.gaps import outline_gaps
from phytac_design.optics.render_scene import build_scene
from phytac_design.optics.sampled_visibility import sampled_fraction
from phytac_design.optics.visibility import FRACTION_MIN, Visibility, best_of, check_visibility
from phytac_design.rules.check import check_design
from phytac_design.simulation.imaging.nominal_view import paint_slopes
from phytac_design.simulation.switch_law import chosen_switches
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.surrogate import FORCE_N, predict
from phytac_shapes.arrays import FloatArray, IntArray

Measures = dict[str, float]


@dataclass
class Candidate:
    """A design with what several levels need of it, each computed once."""

    design: Design
    study: Study

    @cached_property
    def sensor(self) -> Sensor:
        """The design with its surface, markers and cameras.

        Raises
        ------
        DesignError
            If the design breaks a rule.
        """
        return check_design(self.design)

    @cached_property
    def visibility(self) -> tuple[list[Visibility], dict[str, Any]]:
        """Exact visibility at rest by camera, and the arrays that mechanics and load read."""
        return views_at_rest(self.sensor, self.sensor.cameras, self.study.seed)


def views_at_rest(
    sensor: Sensor, cameras: tuple[Camera, ...], seed: int
) -> tuple[list[Visibility], dict[str, Any]]:
    """Exact visibility at rest by camera, and arrays of the stage ``views`` that others read."""
    rng = np.random.default_rng(seed)
    each = [check_visibility(sensor, rng=rng, camera=camera) for camera in cameras]
    best, camera_of = best_of(each)
    return each, {
        "camera": camera_of,
        "paint_slopes": paint_slopes(sensor, each),
        "seen_by": np.stack([~one.occluded for one in each]),
        "gap_same_colour_px": best.gap_same_colour_px,
        "gap_other_colour_px": best.gap_other_colour_px,
    }


def rules(candidate: Candidate) -> Measures:
    """Layout, print rules, camera; sizes, mass and cost."""
    design, surface, markers = candidate.design, candidate.sensor.surface, candidate.sensor.markers
    outer = surface.point(markers.uv)
    pitch = np.inf
    if markers.count > 1:
        pitch = float(cKDTree(outer).query(outer, k=2)[0][:, 1].min())
    z = surface.bounds_mm()[:, 2]
    lenses = [float(camera.position_mm[2]) for camera in candidate.sensor.cameras]
    outside = ~np.any([camera.sees(markers.tip_mm) for camera in candidate.sensor.cameras], axis=0)
    mass = mass_g("resin", shell_volume_mm3(candidate.sensor)) or 0.0
    prices = candidate.study.prices
    return {
        "marker_count": markers.count,
        "density_mean_per_cm2": 100.0 * markers.count / surface.area_mm2(),
        "pitch_least_mm": pitch,
        "stack_mm": float(max([z[1], *lenses]) - min([z[0], *lenses])),
        "wall_mm": design.wall.thickness_mm,
        "height_most_mm": float(markers.height_mm.max()),
        "outside_markers": int(outside.sum()),
        "mass_g": mass,
        "cost": prices.resin_per_kg * mass / 1000.0
        + prices.switch_each * markers.count
        + prices.camera_each * len(candidate.sensor.cameras),
    }


def effort(candidate: Candidate) -> Measures:
    """Parts and hand work."""
    found = effort_of(candidate.sensor)
    return {
        "parts_handled": found.parts_handled,
        "stem_lengths": found.stem_lengths,
        "hand_hours": found.hours_total,
    }


def sampled_fractions(sensor: Sensor, *, coarse: float = 2.5) -> FloatArray:
    """Share of each marker's paint that each camera sees at rest, (cameras, n), by few rays.

    Polygons are 0.1 px times ``coarse`` off their circles.
    """
    fractions = []
    for camera in sensor.cameras:
        tolerance = coarse * tolerance_mm(camera, sensor.markers)
        scene = build_scene(sensor, tolerance_mm=tolerance, hollow=False)
        fractions.append(sampled_fraction(scene, camera).fraction)
    return np.stack(fractions)


DENSITY_MAP = {"cells": 2000, "per_marker": 12}
"""Cells of the search's map of densities.

On 90 cylinders, cones and domes the least density was within 2 % of that by 400 cells a marker.
"""


def sampled(candidate: Candidate) -> Measures:
    """Sampled visibility at rest, density, and resolution by the closed form."""
    # On 66 cylinders, cones and domes fractions were at most 0.0046 RMS off those by all rays and
    # fine polygons, and 0.0032 with a third of this tolerance.
    coarse = 8.0
    surface, markers = candidate.sensor.surface, candidate.sensor.markers
    fractions = sampled_fractions(candidate.sensor, coarse=coarse)
    fraction = fractions.max(axis=0)
    predicted = predict(candidate.sensor, candidate.sensor.cameras, fraction >= FRACTION_MIN)
    bound = predicted.bound
    return {
        "sampled_visible_least": float(fraction.min()),
        "sampled_hidden": int((fraction < FRACTION_MIN).sum()),
        "sampled_gap_px": outlined_gap_px(candidate.sensor, fractions.argmax(axis=0)),
        "density_least_per_cm2": density_of(surface, markers, **DENSITY_MAP).local_min_per_cm2,
        "surrogate_force_sd_N": float(np.median(bound.force_N)),
        "surrogate_force_sd_worst_N": float(bound.force_N.max()),
        "surrogate_place_sd_mm": float(np.median(np.maximum(bound.along_mm, bound.around_mm))),
        "surrogate_dent_mm": float(predicted.dent_mm.max()),
        "surrogate_strain": float(predicted.strain.max()),
    }


def band_rings(design: Design, markers: Markers, count: int = 16) -> FloatArray:
    """Points (n, 2 count, 3) mm of the two circles that bound each marker's paint."""
    receptor, axis = design.receptor, markers.direction
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis, first)
    turn = 2.0 * np.pi * np.arange(count) / count
    ring = np.cos(turn)[:, None] * first[:, None] + np.sin(turn)[:, None] * second[:, None]
    ring *= receptor.diameter_outer_mm / 2.0
    band = np.minimum(receptor.band_marker_mm, markers.height_mm)
    back = markers.tip_mm - band[:, None] * axis
    return np.concatenate([markers.tip_mm[:, None] + ring, back[:, None] + ring], axis=1)


def outlined_gap_px(sensor: Sensor, camera_of: IntArray) -> float:
    """Least distance of painted outlines of one colour, px; occlusion is ignored."""
    markers = sensor.markers
    points = band_rings(sensor.design, markers)
    least = np.inf
    for number, camera in enumerate(sensor.cameras):
        own = np.flatnonzero(camera_of == number)
        pixels = camera.project(points[own].reshape(-1, 3)).reshape(len(own), -1, 2)
        own = own[known := np.isfinite(pixels).all(axis=(1, 2))]
        rounded = np.rint(pixels[known].reshape(-1, 2)).astype(np.int64)
        starts = np.arange(len(own) + 1) * points.shape[1]
        gaps = outline_gaps(rounded, starts, markers.colour[own])[0]
        least = min(least, float(gaps.min(initial=np.inf)))
    return least


def exact(candidate: Candidate) -> Measures:
    """Visibility, gaps and fusion from rendered images."""
    summary = best_of(candidate.visibility[0])[0].summary()
    return {
        "visible_least": summary["min_visible_fraction"],
        "occluded": summary["occluded"],
        "fused": summary["fused"],
        "gap_px": summary["min_gap_px"],
        "switch_unreadable": summary["switch_unreadable"] * candidate.design.has_switches,
    }


def switch(candidate: Candidate) -> Measures:
    """Switches for the design's thresholds, solved; equal bowls once in a process."""
    from phytac_design.mechanics.switch.switch_inputs import rubber_of, space_of
    from phytac_design.mechanics.switch.switch_space import Tolerance

    design = candidate.design
    if not design.has_switches:
        return {"switch_force_error": 0.0}
    if design.switch.family != "bowl":
        made = chosen_switches(design)
        return {"switch_force_error": max(abs(one["error"]) for one in made)}
    tolerance = Tolerance(
        thickness_mm=design.switch.wall_tolerance_mm, modulus=design.switch.modulus_tolerance
    )
    rubber, space = rubber_of(design), space_of(design)
    worst = 0.0
    for force in np.unique(thresholds_N(design, candidate.sensor.markers)).tolist():
        worst = max(worst, abs(_snap_force_N(force, rubber, space, tolerance) / force - 1.0))
    return {"switch_force_error": worst}


@cache
def _snap_force_N(force_N: float, rubber: Any, space: Any, tolerance: Any) -> float:
    """Solved snap force of a bowl; few differ in a study."""
    from phytac_design.mechanics.switch.design import design_switch

    return design_switch(force_N, rubber, space, tolerance).snap.limit_N


def _context(candidate: Candidate, folder: Path) -> Context:
    """Context of a stage that reads the views from a folder."""
    write_arrays(folder, candidate.visibility[1])
    return Context(
        design=candidate.design,
        accuracy=settings_of(candidate.study.ladder.accuracy),
        seed=candidate.study.seed,
        folders={"views": folder},
        progress=lambda _: None,
        scene=None,
    )


def mechanics(candidate: Candidate) -> Measures:
    """Cramér-Rao bound at every receptor, as the stage ``resolution`` of a build takes it."""
    from phytac_design.stages.resolution_stage import RESOLUTION

    with tempfile.TemporaryDirectory() as name:
        views, out = Path(name) / "views", Path(name) / "resolution"
        views.mkdir()
        out.mkdir()
        RESOLUTION.run(_context(candidate, views), out)
        with np.load(out / "arrays.npz") as data:
            force = data[f"force_N_{FORCE_N:g}"]
            place = np.maximum(data[f"along_mm_{FORCE_N:g}"], data[f"around_mm_{FORCE_N:g}"])
    return {
        "force_sd_N": float(np.median(force)),
        "force_sd_worst_N": float(force.max()),
        "place_sd_mm": float(np.median(place)),
    }


def load(candidate: Candidate) -> Measures:
    """Presses at the greatest force, rendered, as in the stage ``underload`` of a build."""
    from phytac_design.stages.loaded_views_stage import see_pressed

    with tempfile.TemporaryDirectory() as name:
        context = _context(candidate, Path(name))
        views = candidate.visibility[1]
        gap = np.minimum(views["gap_same_colour_px"], views["gap_other_colour_px"])
        _, found, facts = see_pressed(context, gap, views["camera"])
    return {
        "load_hidden": int(found.hidden.max(initial=0)),
        "load_fused": int(found.fused.max(initial=0)),
        "crosstalk_px": float(found.crosstalk_px.max()),
        "load_gap_px": float(found.least_gap_same_px.min()),
        "dent_mm": float(facts["dent_mm"]),
    }


def twin(candidate: Candidate) -> Measures:
    """A simulated sensor and its decoder, as a build makes them."""
    from phytac_design.stages.build import run_stages, select_stages

    start = time.process_time()
    context, _, _ = run_stages(
        candidate.design,
        select_stages(["decoder"]),
        accuracy=candidate.study.ladder.accuracy,
        seed=candidate.study.seed,
        progress=lambda _: None,
    )
    tested = context.facts("decoder")["anywhere"]["auto"]
    return {
        "force_error": float(tested["relative_error"]),
        "force_mae_N": float(tested["mae_N"]),
        "build_seconds": time.process_time() - start,
    }


LEVEL_FUNCTIONS: dict[str, Callable[[Candidate], Measures]] = {
    function.__name__: function
    for function in (rules, effort, sampled, exact, switch, mechanics, load, twin)
}
