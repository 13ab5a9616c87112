"""Sections of the page."""

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np

from phytac_design.engine.stage import Context
from phytac_design.optics.density import density_map
from phytac_design.optics.separability import check_paints, separability_svg
from phytac_design.optics.sharpness import DIRECTIONS
from phytac_design.report import figure_names, figures, maps, page, scores
from phytac_design.report.drawing import MARKS, Drawing, of_camera, photo
from phytac_design.report.explorer import GAP_PX, explorer_section
from phytac_design.report.fabrication_section import fabrication_section
from phytac_design.report.mechanics import mechanics_section
from phytac_design.report.press_pictures import press_pictures, press_slider
from phytac_design.report.provenance import provenance_section, time_section
from phytac_design.report.switches import switch_section

PAPER = "paper, on a real sensor: FEM 18 % (49 % below 5 N), FEM-NN 2.3 % and 0.11 N"
EACH_CAMERA = {
    "end": "camera",
    "read": "reads markers",
    "hidden_most": "most hidden",
    "fused_most": "most fused",
    "crosstalk_px": "crosstalk (px)",
    "greatest_shift_px": "greatest shift (px)",
}
BOUND = {
    "force_N_median_middle": "force, median in the middle (N)",
    "force_N_median": "force, median (N)",
    "force_N_worst": "force, worst (N)",
    "force_known_place_N_median": "force at a known place, median (N)",
    "along_mm_median": "place {along}, median (mm)",
    "around_mm_median": "place {around}, median (mm)",
}


def visibility_table(report: Mapping[str, Any]) -> str:
    """Visibility at rest: in all, of each of several cameras, and of the straight layout."""
    columns = {"this layout": report["visibility"]}
    if len(report["cameras"]) > 1:
        columns = {"by the better camera": report["visibility"]} | {
            f"{item['end']} camera alone": item["visibility"] for item in report["cameras"]
        }
    if report["straight"]:
        columns["straight rows, same counts"] = report["straight"]
    keys = [key for key in report["visibility"] if f"visibility.{key}" not in figure_names.NAMES]
    known = [path.split(".")[1] for path in figure_names.NAMES if path.startswith("visibility.")]
    rows = [
        (
            figure_names.name_of(f"visibility.{key}"),
            *(_or_why(f"visibility.{key}", column.get(key)) for column in columns.values()),
        )
        for key in [*(key for key in known if key in report["visibility"]), *keys]
    ]
    return page.table(("figure", *columns), rows)


def _or_why(path: str, value: Any) -> Any:
    why = figure_names.absent_why(path) if page.missing(value) else ""
    return f"{page.DASH} ({why})" if why else value


def camera_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Pictures and visibility at rest."""
    arrays = context.arrays("views")
    parts = []
    for number in range(len(report["cameras"])):
        mark, whose = MARKS[number], of_camera(report, number)
        shown = photo(context, "views", f"camera{mark}.png", f"The camera's view at rest{whose}")
        if number == 0 and report["straight"]:
            caption = f"The same counts in straight rows{whose}"
            shown += photo(context, "compare", "straight.png", caption)
        shown += photo(
            context, "views", f"camera{mark}_all_on.png", f"All switches on: red tips out{whose}"
        )
        shown += photo(
            context, "views", f"ids{mark}.png", f"Exact ID map: one colour per marker{whose}"
        )
        parts.append(page.side_by_side(shown))
    why = context.facts("compare").get("why")
    if not page.missing(why):
        parts.append(
            f"<p>Straight rows of the same counts are not compared: {escape(str(why))}.</p>"
        )
    parts.append(visibility_table(report))
    gap = np.minimum(arrays["gap_same_colour_px"], GAP_PX)
    parts.append(
        page.side_by_side(
            draw.both(
                arrays["visible_fraction"],
                "Visible fraction of each marker (hidden ones ringed)",
                "fraction",
                name="visible_fraction",
                marked=arrays["occluded"],
            ),
            draw.both(
                gap,
                f"Gap to the nearest marker of the same colour ({GAP_PX:g} px and more alike; "
                "fused ones ringed)",
                "px",
                name="gap",
                marked=arrays["fused"],
            ),
        )
    )
    if len(report["cameras"]) > 1:
        head = ("camera", "stand-off (mm)", "reads markers", "hidden", "fused")
        rows = [
            (
                item["end"],
                item["stand_off_mm"],
                item["best_for"],
                item["visibility"]["occluded"],
                item["visibility"]["fused"],
            )
            for item in report["cameras"]
        ]
        parts.append(page.table(head, rows))
    # With several cameras the table above has these, of each.
    left_out = {"end", "stand_off_mm"} if len(report["cameras"]) > 1 else set()
    rest = {key: value for key, value in report["camera"].items() if key not in left_out}
    return "".join(parts) + page.facts(rest, "camera")


def lens_section(context: Context, report: Mapping[str, Any]) -> str:
    """Scale, noise and blur of each row, and the depth of field, for every camera."""
    in_rows, said = context.markers.in_rows, maps.words(context.surface)
    short = (said.along_short, said.around_short, "inward")
    which = dict(zip(DIRECTIONS, short, strict=True))
    head = [
        "row" if in_rows else "group",
        "markers",
        *(f"mm per px, {which[name]}" for name in DIRECTIONS),
        *(f"noise, {which[name]} (mm)" for name in DIRECTIONS),
        "blur (px)",
    ]
    keys = [
        "row",
        "markers",
        *(f"mm_per_px_{name}" for name in DIRECTIONS),
        *(f"noise_{name}_mm" for name in DIRECTIONS),
        "blur_px",
    ]
    parts = []
    for item in report["cameras"]:
        lens = item["lens"]
        far = lens["depth_far_mm"]
        reach = "on" if page.missing(far) else f"to {far:.1f} mm"
        rows = [[row[key] for key in keys] for row in lens["rows"]]
        if len(report["cameras"]) > 1:
            parts.append(f"<h3>{item['end'].capitalize()} camera</h3>")
        parts.append(
            f"<p>In focus at {lens['focus_mm']:.1f} mm from the camera; images of points are no "
            f"wider than a pixel from {lens['depth_near_mm']:.1f} mm {reach}, and at most "
            f"{lens['max_blur_px']:.2g} px at the markers (thin lens, camera.f_number and "
            "camera.pixel_um).</p>" + page.details("Each row", page.table(head, rows))
        )
        if any(page.missing(value) for row in rows for value in row):
            parts.append(
                f'<p class="foot">{page.DASH}: such a motion is towards the camera and does not '
                "show.</p>"
            )
    groups = "row" if in_rows else "eighth of the markers, by their place along the sensor"
    feet = f"Medians of each {groups}; the greatest blur. Directions: {said.along}, {said.around}, "
    return "".join(parts) + f'<p class="foot">{feet}along the normal.</p>'


def under_load_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """What pressing does to the picture."""
    load, arrays = report["under_load"], context.arrays("underload")
    first = load["first_place_uv"]
    cross = None if first is None else np.asarray(first, dtype=np.float64)
    where = "" if cross is None else "; the cross is where that happens first"
    shown = {key: load[key] for key in load if key not in {"sentence", "cameras"}}
    each = load.get("cameras", [])
    keys = [key for key in EACH_CAMERA if all(key in item for item in each)]
    by_camera = page.table(
        [EACH_CAMERA[key] for key in keys], [[item[key] for key in keys] for item in each]
    )
    return (
        f"<p>{escape(load['sentence'])}</p>"
        + slider_of(context, report)
        + page.side_by_side(
            draw.both(
                arrays["crosstalk_px"],
                "Crosstalk: greatest shift of a centroid that is not its marker's own motion",
                "px",
                name="crosstalk",
                cross=cross,
            ),
            draw.both(
                np.minimum(arrays["least_gap_same_px"], GAP_PX),
                f"Least gap to a marker of the same colour under any press ({GAP_PX:g} px and more "
                f"alike{where})",
                "px",
                name="gap_under_load",
                cross=cross,
            ),
        )
        + (by_camera if each else "")
        + page.facts(shown, "under_load")
    )


def slider_of(context: Context, report: Mapping[str, Any]) -> str:
    """Pictures of the press that tells most, with a slider; "" if none could be solved."""
    pressed = press_pictures(context)
    if pressed is None:
        return ""
    name = context.markers.name(pressed.marker)
    return press_slider(pressed, name, of_camera(report, pressed.camera))


def resolution_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Cramér-Rao bounds."""
    found, arrays = report["resolution"], context.arrays("resolution")
    said = maps.words(context.surface)
    keys = [key for key in BOUND if all(key in row for row in found["bound"].values())]
    head = [BOUND[key].format(along=said.along_short, around=said.around_short) for key in keys]
    order = sorted(found["bound"], key=lambda text: float(text.split()[0]))
    rows = [(force, *(found["bound"][force][key] for key in keys)) for force in order]
    return (
        "<p>Cramér-Rao bound of a single contact, its position and size unknown but for the "
        "stated prior: no estimator without bias is better on average. Least standard "
        "deviations:</p>"
        + page.table(("contact of", *head), rows)
        + page.side_by_side(
            draw.on_surface(
                arrays["force_N_10"],
                "Least standard deviation of a force of 10 N",
                "N",
                name="resolution_force",
            ),
            draw.on_surface(
                arrays["along_mm_10"],
                f"Least standard deviation of its position {said.along}",
                "mm",
                name="resolution_along",
            ),
        )
        + page.facts({key: found[key] for key in found if key != "bound"}, "resolution")
    )


def markers_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Density and paints."""
    return page.side_by_side(
        draw.on_surface(
            density_map(context.surface, context.markers).per_cm2,
            "Local density: markers around each one over their area",
            "per cm²",
            name="density",
        ),
        page.svg_figure(
            separability_svg(check_paints(context.design)),
            "The paints under the light: three standard deviations of one pixel, and the "
            "decoder's borders",
        ),
    ) + page.facts(report["markers"], "markers")


def frames_section(context: Context, report: Mapping[str, Any], table: str) -> str:
    """Decoding of rendered frames."""
    shown = "".join(
        photo(
            context,
            "frames",
            f"frame_{what}{MARKS[number]}.png",
            f"{caption}{of_camera(report, number)}",
        )
        for number in range(len(report["cameras"]))
        for what, caption in (
            ("rest", "Frame of the unloaded sensor"),
            ("pressed", "A pressed frame that was decoded"),
        )
    )
    return (
        f"{table}<p>({page.number(PAPER)}.)</p>"
        + page.side_by_side(shown)
        + page.facts(report["frames"], "frames")
    )


def sections_of(context: Context, report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Headings and HTML, in order."""
    draw = Drawing(context)
    limits, count = report["limit_figures"], report["markers"]["count"]

    def table(key: str) -> str:
        return scores.score_table(report[key], limits, count)

    marks = scores.marks_of(limits, list(report["decoder"]))
    learnt = page.flatten({"training": report["training"], "twin": report["twin"]})
    return [
        ("Shell and markers", explorer_section(context, draw.layout_png())),
        ("Camera", camera_section(context, report, draw)),
        ("Under load", under_load_section(context, report, draw)),
        ("Lens", lens_section(context, report)),
        ("Predicted resolution", resolution_section(context, report, draw)),
        ("Markers and paints", markers_section(context, report, draw)),
        ("Mechanics", mechanics_section(context, report, draw)),
        ("Switches", switch_section(context, report)),
        ("Molds, fixtures and print rules", fabrication_section(context, report)),
        ("Decoder: rendered frames", frames_section(context, report, table("decoder_frames"))),
        (
            "Decoder: held-out contacts",
            table("decoder")
            + f"<p>({page.number(PAPER)}.)</p>"
            + page.figure(
                figures.error_bars(report["decoder"], marks),
                "Relative error of the estimators, contacts on receptors",
                name="estimators.png",
            )
            + "<p>Contacts anywhere on the surface, between receptors too:</p>"
            + table("decoder_anywhere")
            + "<p>Contacts that trip no switch cannot be decoded and are counted apart.</p>"
            + page.facts(learnt),
        ),
        (
            "Assumptions",
            "<p>Not stated by the paper; set these to your own parts. Names as in the design "
            "file.</p>"
            + page.details("All of them", page.facts(report["assumptions"], "assumptions")),
        ),
        ("Time and plan", time_section(context, report)),
        ("Provenance", provenance_section(context, report)),
    ]
