"""Exact evaluation of a design, marker by marker; results are kept in the cache."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, Stage, write_arrays
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.loaded_visibility import FUSED_PX
from phytac_design.optics.visibility import FRACTION_MIN, best_of
from phytac_design.rules.check import check_design
from phytac_design.stages.build import run_stages
from phytac_design.stages.loaded_views_stage import UNDERLOAD
from phytac_design.stages.resolution_stage import RESOLUTION, RIM_SHARE
from phytac_design.study.search.fidelity_levels import views_at_rest
from phytac_design.study.search.surrogate import FORCE_N, strain_of
from phytac_design.workflows.design_check import UNREADABLE_SHARE_MAX
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError


class EvaluatedFigure(NamedTuple):
    """A figure: unit, whether smaller is better, description, margin, and reported change.

    A change must not pass the margin ``limit``; a deterioration by more than ``reported`` (a share
    of force, gaps and strain, else absolute) is a cost.
    """

    unit: str
    less: bool
    doc: str
    limit: float | None = None
    reported: float | None = None


# At a gap of 3 px, one free pixel separates a marker from a fused one; a strain of 0.02 is assumed
# for tough printed resins.
FIGURES: dict[str, EvaluatedFigure] = {
    "force_middle_N": EvaluatedFigure(
        "N", True, "bound of force, middle heights, mean", None, 0.01
    ),
    "force_middle_p90_N": EvaluatedFigure(
        "N", True, "bound of force, middle heights, 90th percentile"
    ),
    "force_middle_worst_N": EvaluatedFigure("N", True, "bound of force, middle heights, worst"),
    "force_mean_N": EvaluatedFigure("N", True, "bound of force, full height, mean"),
    "force_median_N": EvaluatedFigure("N", True, "bound of force, full height, median"),
    "force_p90_N": EvaluatedFigure("N", True, "bound of force, full height, 90th percentile"),
    "force_worst_N": EvaluatedFigure("N", True, "bound of force, full height, worst", None, 0.01),
    "visible_least": EvaluatedFigure("", False, "least visible fraction at rest", None, 0.02),
    "gap_px": EvaluatedFigure("px", False, "least gap of one colour at rest", 3.0, 0.1),
    "load_visible_least": EvaluatedFigure("", False, "least visible fraction pressed", None, 0.02),
    "load_gap_px": EvaluatedFigure("px", False, "least gap of one colour pressed", 3.0, 0.1),
    "crosstalk_px": EvaluatedFigure("px", True, "largest disturbance of a centroid", 0.1, 0.02),
    "strain": EvaluatedFigure(
        "", True, "bending strain at the greatest force, closed form", 0.02, 0.05
    ),
    "occluded": EvaluatedFigure("", True, "hidden markers at rest", 0.0),
    "fused": EvaluatedFigure("", True, "fused markers at rest", 0.0),
    "load_hidden": EvaluatedFigure("", True, "hidden markers in the worst press", 0.0),
    "load_fused": EvaluatedFigure("", True, "fused markers in the worst press", 0.0),
    "switch_unreadable": EvaluatedFigure("", True, "switches that cannot be read", None, 0.0),
    "switch_unreadable_share": EvaluatedFigure(
        "", True, "share of switches that cannot be read", UNREADABLE_SHARE_MAX
    ),
    "marker_count": EvaluatedFigure("", False, "markers", None, 0.0),
}
LIMITS = {name: one.limit for name, one in FIGURES.items() if one.limit is not None}
FORCES = tuple(name for name in FIGURES if name.startswith("force_"))


@dataclass(frozen=True)
class EvaluatedDesign:
    """A design with its exact figures.

    Attributes
    ----------
    figures : dict
        See ``FIGURES``.
    views, bound, load : dict of arrays
        Views at rest, bound at every receptor, views under presses; (n, …) over markers unless
        stated otherwise in the stages that make them.
    """

    sensor: Sensor
    figures: dict[str, float]
    views: Mapping[str, Any]
    bound: Mapping[str, Any]
    load: Mapping[str, Any]

    @property
    def design(self) -> Design:
        """The design itself."""
        return self.sensor.design

    @property
    def surface(self) -> Surface:
        """Its surface."""
        return self.sensor.surface

    @property
    def markers(self) -> Markers:
        """Its markers."""
        return self.sensor.markers

    @property
    def faults(self) -> int:
        """Markers that are hidden or fused, at rest or pressed, and one for too much crosstalk."""
        return faults_of(self.figures)

    def faulty(self) -> BoolArray:
        """Markers (n,) that are part of a fault."""
        load = self.load
        return np.asarray(
            self.views["occluded"]
            | self.views["fused"]
            | (load["least_fraction"] < FRACTION_MIN)
            | (load["least_gap_same_px"] <= FUSED_PX)
            | (load["crosstalk_px"] > LIMITS["crosstalk_px"])
        )


def faults_of(figures: Mapping[str, float]) -> int:
    """Sum of what must be 0, and 1 for too much crosstalk."""
    wrong = sum(int(figures[name]) for name, limit in LIMITS.items() if limit == 0.0)
    return wrong + int(figures["crosstalk_px"] > LIMITS["crosstalk_px"])


def middle_of(sensor: Sensor) -> BoolArray:
    """Receptors (n,) at middle heights, as in the stage ``resolution``."""
    along = sensor.surface.unwrap(sensor.markers.uv)[:, 1]
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
    """Check the rules, render at rest, take the bound, and render under presses.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    NumericalError
        If a contact moves nothing that a camera sees.
    """
    sensor = check_design(design)
    try:
        context, _, _ = run_stages(
            design,
            (AT_REST, RESOLUTION, UNDERLOAD),
            accuracy=accuracy,
            seed=seed,
            force=True,
            progress=lambda _: None,
        )
    except np.linalg.LinAlgError:
        raise NumericalError(
            "contact-unobservable",
            f"{design.name}: some contact moves no marker that a camera sees, so that its force "
            "has no bound; see `phytac check` for what hides the markers",
        ) from None
    views, bound, load = (context.arrays(name) for name in ("views", "resolution", "underload"))
    figures = force_figures(bound[f"force_N_{FORCE_N:g}"], middle_of(sensor)) | {
        "visible_least": float(views["visible_fraction"].min()),
        "gap_px": float(views["gap_same_colour_px"].min()),
        "load_visible_least": float(load["least_fraction"].min()),
        "load_gap_px": float(load["least_gap_same_px"].min()),
        "crosstalk_px": float(load["crosstalk_px"].max()),
        "strain": strain_of(sensor),
        "occluded": int(views["occluded"].sum()),
        "fused": int(views["fused"].sum()),
        "load_hidden": int(load["hidden"].max(initial=0)),
        "load_fused": int(load["fused"].max(initial=0)),
        "switch_unreadable": int(views["unreadable"].sum()),
        "switch_unreadable_share": float(views["unreadable"].mean()),
        "marker_count": sensor.markers.count,
    }
    return EvaluatedDesign(sensor, figures, views, bound, load)


def _view_at_rest(context: Context, folder: Path) -> None:
    tip_mm = context.markers.tip_mm
    each, views = views_at_rest(context.sensor, context.sensor.cameras, context.seed)
    best = best_of(each)[0]
    points = [np.where(one.lost[:, None], tip_mm, one.paint_point_mm) for one in each]
    more = {
        "paint_points_mm": np.stack(points),
        "unreadable": best.switch_unreadable & context.design.has_switches,
    }
    write_arrays(folder, asdict(best) | views | more)


AT_REST = Stage(name="views", design_fields=("pictures",), seeded=True, run=_view_at_rest)
"""Visibility at rest alone, in place of the stage of that name."""
