"""A design judged by the rungs of the search, marker by marker; what was judged once is kept."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.field_groups import values_of
from phytac_design.design.spec import Design
from phytac_design.engine.cache import lookup, publish, stage_key
from phytac_design.engine.stage import Context, Stage, write_arrays
from phytac_design.layout import Markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.optics.visibility import FRACTION_MIN, best_of, check_visibility
from phytac_design.rules.check import check_design
from phytac_design.simulation.imaging.nominal_view import paint_slopes
from phytac_design.stages.loaded_views import UNDERLOAD, see_pressed
from phytac_design.stages.resolution import RESOLUTION, RIM_SHARE
from phytac_design.stages.views import PICTURES
from phytac_design.study.search.surrogate import FORCE_N, predict
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError

CROSSTALK_PX = 0.1
"""Most that a centroid may be disturbed."""
GAP_PX = 3.0
"""Least gap that is safe: markers this near are one free pixel from being fused."""
STRAIN = 0.02
"""Most that a wall may be bent; assumed for tough printed resins."""
COUNTS = ("occluded", "fused", "load_hidden", "load_fused")
"""Figures that must be 0."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure of a judged design: unit, whether less is better, what it is."""

    unit: str
    less: bool
    doc: str


FIGURES: dict[str, Figure] = {
    "force_middle_N": Figure(unit="N", less=True, doc="bound of force, middle heights, mean"),
    "force_middle_p90_N": Figure(
        unit="N", less=True, doc="bound of force, middle heights, nine in ten are better"
    ),
    "force_middle_worst_N": Figure(
        unit="N", less=True, doc="bound of force, middle heights, worst"
    ),
    "force_mean_N": Figure(unit="N", less=True, doc="bound of force, full height, mean"),
    "force_median_N": Figure(unit="N", less=True, doc="bound of force, full height, median"),
    "force_p90_N": Figure(
        unit="N", less=True, doc="bound of force, full height, nine in ten are better"
    ),
    "force_worst_N": Figure(unit="N", less=True, doc="bound of force, full height, worst"),
    "visible_least": Figure(unit="", less=False, doc="least visible fraction at rest"),
    "gap_px": Figure(unit="px", less=False, doc="least gap of one colour at rest"),
    "load_visible_least": Figure(unit="", less=False, doc="least visible fraction pressed"),
    "load_gap_px": Figure(unit="px", less=False, doc="least gap of one colour pressed"),
    "crosstalk_px": Figure(unit="px", less=True, doc="greatest disturbance of a centroid"),
    "strain": Figure(unit="", less=True, doc="bending strain at the greatest force, closed form"),
    "occluded": Figure(unit="", less=True, doc="hidden markers at rest"),
    "fused": Figure(unit="", less=True, doc="fused markers at rest"),
    "load_hidden": Figure(unit="", less=True, doc="hidden markers in the worst press"),
    "load_fused": Figure(unit="", less=True, doc="fused markers in the worst press"),
    "switch_unreadable": Figure(unit="", less=True, doc="switches that cannot be read"),
    "marker_count": Figure(unit="", less=False, doc="markers"),
}
FORCES = tuple(name for name in FIGURES if name.startswith("force_"))
MARGINS = ("visible_least", "gap_px", "load_visible_least", "load_gap_px", "crosstalk_px")


@dataclass(frozen=True, kw_only=True)
class EvaluatedDesign:
    """A design and what was found of it.

    Attributes
    ----------
    figures : dict
        See ``FIGURES``.
    views, bound, load : dict of arrays
        What the camera sees at rest, the bound at every receptor, what it sees under presses;
        (n, …) over markers unless said otherwise in the stages that make them.
    """

    design: Design
    surface: Surface
    markers: Markers
    figures: dict[str, float]
    views: Mapping[str, Any]
    bound: Mapping[str, Any]
    load: Mapping[str, Any]

    @property
    def faults(self) -> int:
        """Markers that hide or fuse, at rest or pressed, and one for too much crosstalk."""
        return faults_of(self.figures)

    def bad(self) -> BoolArray:
        """Markers (n,) that are part of a fault."""
        from phytac_design.optics.loaded_visibility import FUSED_PX

        load = self.load
        return np.asarray(
            self.views["occluded"]
            | self.views["fused"]
            | (load["least_fraction"] < FRACTION_MIN)
            | (load["least_gap_same_px"] <= FUSED_PX)
            | (load["crosstalk_px"] > CROSSTALK_PX)
        )


def faults_of(figures: Mapping[str, float]) -> int:
    """Sum of what must be 0, and 1 for too much crosstalk."""
    wrong = sum(int(figures[name]) for name in COUNTS)
    return wrong + int(figures["crosstalk_px"] > CROSSTALK_PX)


def middle_of(surface: Surface, markers: Markers) -> BoolArray:
    """Receptors (n,) in the middle of the sensor, as the stage ``resolution`` counts them."""
    along = surface.unwrap(markers.uv)[:, 1]
    share = (along - along.min()) / max(float(np.ptp(along)), 1e-9)
    middle = (share > RIM_SHARE) & (share < 1.0 - RIM_SHARE)
    return np.asarray(middle if middle.any() else np.ones_like(middle))


def force_figures(force_N: FloatArray, middle: BoolArray) -> dict[str, float]:
    """Mean, percentiles and worst of the bound (n,), over all and over the middle heights."""
    inner = force_N[middle]
    return {
        "force_middle_N": float(inner.mean()),
        "force_middle_p90_N": float(np.percentile(inner, 90.0)),
        "force_middle_worst_N": float(inner.max()),
        "force_mean_N": float(force_N.mean()),
        "force_median_N": float(np.median(force_N)),
        "force_p90_N": float(np.percentile(force_N, 90.0)),
        "force_worst_N": float(force_N.max()),
    }


def evaluate_design(design: Design, accuracy: Accuracy, *, seed: int = 0) -> EvaluatedDesign:
    """Apply every rule, then look, take the bound, press and look again.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    surface, markers = check_design(design)
    context = Context(
        design=design, accuracy=accuracy, seed=seed, progress=lambda _: None, scene=None
    )
    reads = values_of(design, PICTURES)
    views = _kept("advice-views", [reads, seed], lambda folder: _look(context, folder))
    bound = _kept("advice-bound", _inputs(RESOLUTION, context), lambda f: _bound(context, views, f))
    load = _kept("advice-load", _inputs(UNDERLOAD, context), lambda f: _press(context, views, f))
    found = {"views": _arrays(views), "bound": _arrays(bound), "load": _arrays(load)}
    figures = _figures(surface, markers, found) | {"strain": strain_of(design, surface, markers)}
    return EvaluatedDesign(
        design=design, surface=surface, markers=markers, figures=figures, **found
    )


def _inputs(stage: Stage, context: Context) -> Any:
    """What a stage's result depends on; of what is seen, all that makes it."""
    settings = context.accuracy.as_dict()
    reads = values_of(context.design, {*stage.reads, *PICTURES})
    return [reads, {knob: settings[knob] for knob in stage.knobs}, context.seed]


def _kept(name: str, inputs: Any, work: Any) -> Path:
    """Folder of a result, from the cache or made now."""
    key = stage_key(name, inputs)

    def made(folder: Path) -> dict[str, Any]:
        work(folder)
        return {"stage": name, "seconds": 0.0}

    return lookup(name, key) or publish(name, key, made)


def _arrays(folder: Path) -> dict[str, Any]:
    with np.load(folder / "arrays.npz") as data:
        return {name: data[name] for name in data.files}


def _look(context: Context, folder: Path) -> None:
    """Exact visibility at rest, as the rung ``exact``."""
    design, surface, markers = context.design, context.surface, context.markers
    rng = np.random.default_rng(context.seed)
    each = [
        check_visibility(design, surface, markers, rng=rng, camera=camera)
        for camera in cameras_of(design, surface)
    ]
    best, camera = best_of(each)
    points = [np.where(one.lost[:, None], markers.tip_mm, one.paint_point_mm) for one in each]
    write_arrays(
        folder,
        asdict(best)
        | {
            "camera": camera,
            "paint_points_mm": np.stack(points),
            "paint_slopes": paint_slopes(design, surface, markers, each),
            "seen_by": np.stack([~one.occluded for one in each]),
            "unreadable": best.switch_unreadable,
        },
    )


def _bound(context: Context, views: Path, folder: Path) -> None:
    """Cramér-Rao bound, as the rung ``mechanics``."""
    context.folders["views"] = views
    try:
        RESOLUTION.run(context, folder)
    except np.linalg.LinAlgError:
        raise NumericalError(
            f"{context.design.name}: some contact moves no marker that a camera sees, so that "
            "nothing bounds its force; see `phytac check` for what hides them"
        ) from None


def _press(context: Context, views: Path, folder: Path) -> None:
    """Presses at the greatest force, as the rung ``load``."""
    seen = _arrays(views)
    gap = np.minimum(seen["gap_same_colour_px"], seen["gap_other_colour_px"])
    uv, found, _ = see_pressed(context, gap, seen["camera"])
    write_arrays(folder, {"uv": uv, **asdict(found)})


def strain_of(design: Design, surface: Surface, markers: Markers) -> float:
    """Greatest bending strain at the greatest force, closed form, as the rung ``sampled``."""
    seen = np.ones(markers.count, dtype=np.bool_)
    found = predict(design, surface, markers, cameras_of(design, surface), seen)
    return float(found.strain.max())


def _figures(
    surface: Surface, markers: Markers, found: Mapping[str, Mapping[str, Any]]
) -> dict[str, float]:
    views, load = found["views"], found["load"]
    force = found["bound"][f"force_N_{FORCE_N:g}"]
    return force_figures(force, middle_of(surface, markers)) | {
        "visible_least": float(views["visible_fraction"].min()),
        "gap_px": float(views["gap_same_colour_px"].min()),
        "load_visible_least": float(load["least_fraction"].min()),
        "load_gap_px": float(load["least_gap_same_px"].min()),
        "crosstalk_px": float(load["crosstalk_px"].max()),
        "occluded": int(views["occluded"].sum()),
        "fused": int(views["fused"].sum()),
        "load_hidden": int(load["hidden"].max(initial=0)),
        "load_fused": int(load["fused"].max(initial=0)),
        "switch_unreadable": int(views["unreadable"].sum()),
        "marker_count": markers.count,
    }
