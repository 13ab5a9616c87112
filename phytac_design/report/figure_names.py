"""Figures of ``report.json`` as tables: what they are called, and why some of them do not exist.

A figure is called by its key, with its unit in brackets, unless that would not be understood.
"""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from phytac_design.core.html import DASH, cell, flatten, missing, table

UNITS = {
    "mm": "mm",
    "mm2": "mm²",
    "mm3": "mm³",
    "deg": "°",
    "px": "px",
    "N": "N",
    "g": "g",
    "MPa": "MPa",
    "Hz": "Hz",
    "um": "µm",
}
"""Units by the last word of a key."""
NAMES: dict[str, str] = {
    "visibility.occluded": "hidden markers",
    "visibility.fused": "markers fused with another of their colour",
    "visibility.min_visible_px": "smallest visible area of a marker (px)",
    "visibility.min_gap_px": "smallest gap to a marker of the same colour (px)",
    "visibility.min_gap_other_colour_px": "smallest gap to a marker of another colour (px)",
    "visibility.min_red_on_px": "red of the tip that shows least when out (px)",
    "visibility.max_red_rest_px": "red of the tip that shows most at rest (px)",
    "visibility.switch_unreadable": "switches whose tip looks alike at rest and out",
    "camera.stand_off_mm": "stand-off: camera to its rim (mm)",
    "camera.rest_centroid_bias_px": "error of predicted rest positions, root mean square (px)",
    "under_load.hidden_most": "most markers hidden at once",
    "under_load.fused_most": "most markers fused at once",
    "under_load.first_force_N": "smallest force at which a marker hides or fuses (N)",
    "under_load.first_place_uv": "chart position of that press (u, v)",
    "under_load.first_place": "place of that press",
    "under_load.first_marker": "marker that hides or fuses there",
    "under_load.crosstalk_still_px": "largest crosstalk of a marker that stands still (px)",
    "under_load.theory": "how the wall's motion was found",
    "under_load.not_solved": "presses that could not be solved",
    "under_load.why": "why some could not be solved",
    "under_load.sector_only": "pressed in one sector only, the others repeat it",
    "resolution.prior_place_mm": "known of the place beforehand, standard deviation (mm)",
    "resolution.prior_radius_mm": "known of the radius beforehand, standard deviation (mm)",
    "markers.density_per_cm2": "density (per cm²)",
    "markers.density_local_min_per_cm2": "smallest local density (per cm²)",
    "markers.density_local_max_per_cm2": "largest local density (per cm²)",
    "markers.density_times_paper": "density over the paper's 1.63 per cm²",
    "markers.sensing_area_cm2": "sensing area (cm²)",
    "markers.surface_class": "surface to the optical axis",
    "markers.colours.min_uv_distance": "distance of the nearest paints in CIE 1976 u'v'",
    "markers.colours.min_hue_deg": "smallest angle of hue between paints (°)",
    "markers.colours.min_hue_sigmas": "smallest angle of hue over the noise of a pixel",
    "markers.colours.min_floor_sigmas": "smallest colour above the decoder's floor, over the noise",
    "shell.genus": "handles (genus)",
    "shell.volume_difference": "volume of the STL over the STEP's, less 1",
    "switch.red.worst_marker": "marker with the worst readable tip",
    "switch.red.worst_on_px": "its red when out (px)",
    "switch.red.worst_needed_px": "red that the decoder needs there (px)",
    "switch.red.farthest_marker": "marker farthest from the camera",
    "switch.red.farthest_on_px": "its red when out (px)",
    "switch.red.farthest_needed_px": "red that the decoder needs there (px)",
    "switch.red.unreadable": "switches whose tip looks alike at rest and out",
    "fabrication.mold.hausdorff_mm": "mold: farthest from the switch's shape (mm)",
    "fabrication.mold.shared_mm3": "mold: volume that closed halves share (mm³)",
    "fabrication.interference_mm3": "assembly: volume that parts share (mm³)",
    "fabrication.light_leaks": "assembly: lines of sight from outside",
    "mesh.load_N": "force of the ready load step (N)",
    "mesh.inward_mm_at_load": "inward motion there, linear (mm)",
    "frames.koi": "switches that were on",
    "frames.koi_missed": "of these, missed",
    "frames.koi_false": "switches taken as on that were off",
    "frames.refused": "frames that could not be decoded",
    "frames.first_refusal": "why the first of them could not",
    "training.key_nodes": "switched receptors to learn from",
    "timing_s.total": "all stages (s)",
}
ABSENT: dict[str, str] = {
    "markers.rows": "this layout has no rows",
    "markers.columns": "this layout has no columns",
    "markers.density_times_paper": "compares only with surfaces parallel to the optical axis",
    "visibility.min_gap_px": "no two markers of one colour",
    "visibility.min_gap_other_colour_px": "one colour only",
    "under_load.first_force_N": "nothing hides or fuses",
    "under_load.first_place_uv": "nothing hides or fuses",
    "under_load.first_marker": "nothing hides or fuses",
    "under_load.least_gap_same_colour_px": "no two markers of one colour",
    "under_load.least_gap_other_colour_px": "one colour only",
    "under_load.why": "all were solved",
    "frames.first_refusal": "all were decoded",
    "training.fem_nn.rmse_test_split_N": "too few samples to keep some apart",
    "training.fem_nn_identity.rmse_test_split_N": "too few samples to keep some apart",
}
"""Why a figure may be missing."""


def words_of(key: str) -> tuple[str, str]:
    """Words of a key, and its unit: ``("stand off", "mm")`` of ``stand_off_mm``."""
    words, _, last = key.rpartition("_")
    unit = UNITS.get(last, "") if words else ""
    return (words if unit else key).replace("_", " "), unit


def name_of(path: str) -> str:
    """Name of a figure by its path in ``report.json``, units included.

    Assumptions keep the names of the design file, where they are set.
    """
    section, _, keys = path.partition(".")
    if section == "assumptions":
        return keys
    parts = [words_of(key) for key in (keys or section).split(".")]
    plain = ": ".join(f"{words} ({unit})" if unit else words for words, unit in parts)
    return NAMES.get(path, plain)


def absent_why(path: str) -> str:
    """Why a figure does not exist; "" if not known."""
    return ABSENT.get(path, "")


def facts(values: Mapping[str, Any], section: str = "") -> str:
    """Two-column table of names and figures of one section of ``report.json``.

    Missing figures are a dash, with the reason if it is known. The path in ``report.json`` is the
    name's tooltip. Lists of records follow as separate tables.
    """
    rows, records = [], []
    flat = flatten(values, f"{section}." if section else "")
    for path, value in flat.items():
        if isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
            records.append(_records(path, value))
            continue
        why = absent_why(path) if missing(value) else ""
        shown = f'<td class="text">{DASH} ({escape(why)})</td>' if why else cell(value)
        name = f'<th scope="row" title="{escape(path)}">{escape(name_of(path))}</th>'
        rows.append(f"<tr>{name}{shown}</tr>")
    head = '<tr><th scope="col">figure</th><th scope="col">value</th></tr>'
    return (
        f'<table class="facts"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'
        + "".join(records)
    )


def _records(path: str, items: Sequence[Mapping[str, Any]]) -> str:
    """Table of records, a column for each of their keys."""
    flat = [flatten(item) for item in items]
    found = dict.fromkeys(key for item in flat for key in item)
    keys = sorted(found, key="part".__ne__)  # its name is a row's heading
    head = [name_of(key) for key in keys]
    body = table(head, [[item.get(key) for key in keys] for item in flat])
    return f"<p>{escape(name_of(path).capitalize())}:</p>{body}"
