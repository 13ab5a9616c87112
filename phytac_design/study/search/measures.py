"""The measures that a study can constrain or optimise, and the fidelity level that gives each."""

from dataclasses import dataclass
from difflib import get_close_matches

from phytac_shapes.errors import DesignError

LEVELS = ("rules", "effort", "sampled", "exact", "switch", "mechanics", "load", "twin")
"""Fidelity levels from cheap to expensive; :mod:`.fidelity_levels` computes them."""


@dataclass(frozen=True)
class Measure:
    """A figure of a candidate.

    Attributes
    ----------
    name : str
        As in a study file and in the columns of the results.
    rung : str
        Fidelity level that computes it.
    unit : str
        Its unit; "" for counts and shares.
    doc : str
        What it is.
    proxy : str
        Measure of a lower level that predicts it; "" if none does.
    low, high : float
        Range of its values.
    """

    name: str
    rung: str
    unit: str
    doc: str
    proxy: str = ""
    low: float = 0.0
    high: float = float("inf")


_TABLE = {
    "rules": (
        ("marker_count", "", "markers"),
        ("density_mean_per_cm2", "/cm²", "markers over the sensing area"),
        ("pitch_least_mm", "mm", "least distance of two markers"),
        ("stack_mm", "mm", "nearest camera's centre to the far end of the outer face, axially"),
        ("wall_mm", "mm", "thickness of the wall"),
        ("height_most_mm", "mm", "tallest receptor"),
        ("outside_markers", "", "markers whose end lies outside of every camera's image"),
        ("mass_g", "g", "wall, rims and receptors, of resin"),
        ("cost", "", "resin, switches and camera at the study's prices"),
    ),
    "effort": (
        ("parts_handled", "", "parts that are printed, cast or bought; no calibration kit"),
        ("stem_lengths", "", "different lengths of the switches' stems"),
        ("hand_hours", "h", "hand work, at the times of the design's table effort"),
    ),
    "sampled": (
        ("sampled_visible_least", "", "least visible fraction of a marker, by about 64 rays each"),
        ("sampled_hidden", "", "markers of which less than half is visible, by those rays"),
        ("sampled_gap_px", "px", "least distance of painted outlines of one colour in the image"),
        ("density_least_per_cm2", "/cm²", "least local density"),
        ("surrogate_force_sd_N", "N", "{bound}, shallow shell; median"),
        ("surrogate_force_sd_worst_N", "N", "{bound}, shallow shell; worst of the receptors"),
        ("surrogate_place_sd_mm", "mm", "{place}, shallow shell; median"),
        ("surrogate_dent_mm", "mm", "deepest dent under the greatest force, linear shallow shell"),
        ("surrogate_strain", "", "greatest bending strain under that force, shallow shell"),
    ),
    "exact": (
        ("visible_least", "", "least visible fraction, every pixel"),
        ("occluded", "", "markers with less than half or fewer than 12 pixels visible"),
        ("fused", "", "markers that run into another of their colour"),
        ("gap_px", "px", "least distance of pixels of two markers of one colour; 1 is touching"),
        ("switch_unreadable", "", "markers whose switch the camera cannot read"),
    ),
    "switch": (("switch_force_error", "", "largest relative error of the solved snap forces"),),
    "mechanics": (
        ("force_sd_N", "N", "{bound}, finite elements; median"),
        ("force_sd_worst_N", "N", "{bound}, finite elements; worst receptor"),
        ("place_sd_mm", "mm", "{place}, finite elements; median"),
    ),
    "load": (
        ("load_hidden", "", "markers hidden by the worst press at the design's greatest force"),
        ("load_fused", "", "markers fused by the worst press"),
        ("crosstalk_px", "px", "largest shift of a centroid that is not its marker's own motion"),
        ("load_gap_px", "px", "least gap of one colour under any press"),
        ("dent_mm", "mm", "deepest dent of any press at the greatest force"),
    ),
    "twin": (
        ("force_error", "", "mean relative force error of the decoder, contacts anywhere"),
        ("force_mae_N", "N", "mean absolute force error of the decoder, contacts anywhere"),
        ("build_seconds", "s", "processor time of the stages up to the decoder; varies"),
    ),
}
_PROXIES = {
    "sampled_gap_px": "pitch_least_mm",
    "density_least_per_cm2": "density_mean_per_cm2",
    "visible_least": "sampled_visible_least",
    "occluded": "sampled_hidden",
    "gap_px": "sampled_gap_px",
    "force_sd_N": "surrogate_force_sd_N",
    "force_sd_worst_N": "surrogate_force_sd_worst_N",
    "place_sd_mm": "surrogate_place_sd_mm",
    "load_hidden": "occluded",
    "load_fused": "fused",
    "load_gap_px": "gap_px",
    "dent_mm": "surrogate_dent_mm",
    "force_error": "force_sd_N",
    "force_mae_N": "force_sd_N",
}
MEASURES = {
    name: Measure(
        name=name,
        rung=level,
        unit=unit,
        doc=doc.format(
            bound="Cramér-Rao bound of force at 10 N",
            place="bound of place at 10 N, the worse axis",
        ),
        proxy=_PROXIES.get(name, ""),
        high=1.0 if name.endswith("visible_least") else float("inf"),
    )
    for level, measures in _TABLE.items()
    for name, unit, doc in measures
}


def measure_of(name: str, what: str) -> Measure:
    """Measure of a name; ``what`` begins the message if there is none.

    Raises
    ------
    DesignError
        If no fidelity level computes it.
    """
    if name in MEASURES:
        return MEASURES[name]
    near = get_close_matches(name, MEASURES, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    raise DesignError(
        "measure-unknown",
        f"{what}: no fidelity level measures {name!r}{hint} (`phytac sweep --measures` lists all)",
    )


def best_proxy(name: str, known: frozenset[str]) -> str:
    """The measure itself, or the best predictor of it, among ``known``; "" if there is none."""
    while name and name not in known:
        name = MEASURES[name].proxy
    return name


def measures_up_to(levels: tuple[str, ...]) -> list[str]:
    """Names of all measures of these levels, cheap ones first."""
    return [name for name, measure in MEASURES.items() if measure.rung in levels]
