"""What a study can ask for or strive for: named measures, and the rung that finds each."""

from dataclasses import dataclass
from difflib import get_close_matches

from phytac_shapes.errors import DesignError

LEVELS = ("rules", "sampled", "exact", "switch", "mechanics", "load", "twin")
"""From cheap to dear; what each does stands in ``rungs``."""


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A figure of a candidate.

    Attributes
    ----------
    name : str
        As in a study file and in the columns of the results.
    rung : str
        Rung that finds it.
    unit : str
        Its unit; "" for counts and shares.
    low, high : float
        Range that it can lie in.
    doc : str
        What it is.
    proxy : str
        Measure of an earlier rung that predicts it; "" if none does.
    """

    name: str
    rung: str
    unit: str
    doc: str
    low: float = 0.0
    high: float = float("inf")
    proxy: str = ""


_ALL = (
    Measure(name="marker_count", rung="rules", unit="", doc="markers"),
    Measure(
        name="density_mean_per_cm2", rung="rules", unit="/cm²", doc="markers over the sensing area"
    ),
    Measure(name="pitch_least_mm", rung="rules", unit="mm", doc="least distance of two markers"),
    Measure(
        name="stack_mm",
        rung="rules",
        unit="mm",
        doc="from the nearest camera's centre to the far end of the outer face, along the axis",
    ),
    Measure(name="wall_mm", rung="rules", unit="mm", doc="thickness of the wall"),
    Measure(name="height_most_mm", rung="rules", unit="mm", doc="tallest receptor"),
    Measure(
        name="outside_markers",
        rung="rules",
        unit="",
        doc="markers whose end lies outside of every camera's image",
    ),
    Measure(name="mass_g", rung="rules", unit="g", doc="wall, rims and receptors, of resin"),
    Measure(
        name="cost", rung="rules", unit="", doc="resin, switches and camera at the study's prices"
    ),
    Measure(
        name="sampled_visible_least",
        rung="sampled",
        unit="",
        high=1.0,
        doc="least visible fraction of a marker, by about 64 rays each",
    ),
    Measure(
        name="sampled_hidden",
        rung="sampled",
        unit="",
        doc="markers of which less than half is visible, by those rays",
    ),
    Measure(
        name="sampled_gap_px",
        rung="sampled",
        unit="px",
        proxy="pitch_least_mm",
        doc="least distance of painted outlines of one colour in the picture",
    ),
    Measure(
        name="density_least_per_cm2",
        rung="sampled",
        unit="/cm²",
        proxy="density_mean_per_cm2",
        doc="least local density",
    ),
    Measure(
        name="surrogate_force_sd_N",
        rung="sampled",
        unit="N",
        doc="Cramér-Rao bound of force at 10 N, place and size unknown, shallow shell; median",
    ),
    Measure(
        name="surrogate_force_sd_worst_N",
        rung="sampled",
        unit="N",
        doc="the same at the worst receptor that was looked at",
    ),
    Measure(
        name="surrogate_place_sd_mm",
        rung="sampled",
        unit="mm",
        doc="bound of place at 10 N, the worse of along and around, shallow shell; median",
    ),
    Measure(
        name="surrogate_dent_mm",
        rung="sampled",
        unit="mm",
        doc="deepest dent under the design's greatest force, linear shallow shell",
    ),
    Measure(
        name="surrogate_strain",
        rung="sampled",
        unit="",
        doc="greatest bending strain under that force, linear shallow shell",
    ),
    Measure(
        name="visible_least",
        rung="exact",
        unit="",
        high=1.0,
        proxy="sampled_visible_least",
        doc="least visible fraction, every pixel",
    ),
    Measure(
        name="occluded",
        rung="exact",
        unit="",
        proxy="sampled_hidden",
        doc="markers with less than half or fewer than 12 pixels visible",
    ),
    Measure(
        name="fused", rung="exact", unit="", doc="markers that run into another of their colour"
    ),
    Measure(
        name="gap_px",
        rung="exact",
        unit="px",
        proxy="sampled_gap_px",
        doc="least distance of pixels of two markers of one colour; 1 is touching",
    ),
    Measure(
        name="switch_unreadable",
        rung="exact",
        unit="",
        doc="markers whose switch the camera cannot read",
    ),
    Measure(
        name="switch_force_error",
        rung="switch",
        unit="",
        doc="difference of the solved snap forces from their thresholds, the largest share",
    ),
    Measure(
        name="force_sd_N",
        rung="mechanics",
        unit="N",
        proxy="surrogate_force_sd_N",
        doc="Cramér-Rao bound of force at 10 N, finite elements; median",
    ),
    Measure(
        name="force_sd_worst_N",
        rung="mechanics",
        unit="N",
        proxy="surrogate_force_sd_worst_N",
        doc="the same at the worst receptor",
    ),
    Measure(
        name="place_sd_mm",
        rung="mechanics",
        unit="mm",
        proxy="surrogate_place_sd_mm",
        doc="bound of place at 10 N, the worse of along and around; median",
    ),
    Measure(
        name="load_hidden",
        rung="load",
        unit="",
        proxy="occluded",
        doc="markers hidden by the worst press at the design's greatest force",
    ),
    Measure(
        name="load_fused",
        rung="load",
        unit="",
        proxy="fused",
        doc="markers fused by the worst press",
    ),
    Measure(
        name="crosstalk_px",
        rung="load",
        unit="px",
        doc="largest shift of a centroid that is not its marker's own motion",
    ),
    Measure(
        name="load_gap_px",
        rung="load",
        unit="px",
        proxy="gap_px",
        doc="least gap of one colour under any press",
    ),
    Measure(
        name="dent_mm",
        rung="load",
        unit="mm",
        proxy="surrogate_dent_mm",
        doc="deepest dent of any press at the greatest force",
    ),
    Measure(
        name="force_error",
        rung="twin",
        unit="",
        proxy="force_sd_N",
        doc="mean error of the decoder over the force, contacts anywhere, in simulation",
    ),
    Measure(
        name="force_mae_N",
        rung="twin",
        unit="N",
        proxy="force_sd_N",
        doc="mean absolute error of the decoder, contacts anywhere, in simulation",
    ),
    Measure(
        name="build_seconds",
        rung="twin",
        unit="s",
        doc="processor time of the stages up to the decoder; differs from run to run",
    ),
)
MEASURES = {measure.name: measure for measure in _ALL}


def measure_of(name: str, what: str) -> Measure:
    """Measure of a name, in the words of ``what`` asked for it.

    Raises
    ------
    DesignError
        If no rung finds such a figure.
    """
    if name in MEASURES:
        return MEASURES[name]
    near = get_close_matches(name, MEASURES, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise DesignError(
        f"{what}: no rung measures {name!r}{hint} (`phytac sweep --measures` lists all)"
    )


def best_proxy(name: str, known: frozenset[str]) -> str:
    """Measure among ``known`` that is, or best predicts, another; "" if none does."""
    while name and name not in known:
        name = MEASURES[name].proxy
    return name


def measures_up_to(rungs: tuple[str, ...]) -> list[str]:
    """Names of all measures of these rungs, cheap ones first."""
    return [name for name, measure in MEASURES.items() if measure.rung in rungs]
