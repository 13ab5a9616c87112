"""Sections of the page."""

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

import numpy as np

from phytac_design.core import html as page
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.geometry import flat_map
from phytac_design.optics.density import density_map
from phytac_design.optics.separability import check_paints, separability_svg
from phytac_design.optics.sharpness import DIRECTIONS
from phytac_design.report import figure_names, report_figures, score_tables
from phytac_design.report.explorer import GAP_PX, explorer_section, softness_um_N
from phytac_design.report.fabrication_section import fabrication_section
from phytac_design.report.press_pictures import PressPictures, press_slider
from phytac_design.report.provenance import provenance_section, time_section
from phytac_design.report.report_figures import Drawing, of_camera, photo
from phytac_design.report.verdict import sentence
from phytac_design.simulation.frame_files import CAMERA_SUFFIXES

PAPER = "paper, on a real sensor: FEM 18 % (49 % below 5 N), FEM-NN 2.3 % and 0.11 N"


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
    arrays, several = context.arrays("views"), len(report["cameras"]) > 1
    parts = []
    for number in range(len(report["cameras"])):
        mark, whose = CAMERA_SUFFIXES[number], of_camera(report, number)
        photos = [
            ("views", f"camera{mark}.png", "The camera's view at rest"),
            ("views", f"ids{mark}.png", "Exact ID map: one colour per marker"),
        ]
        if context.design.has_switches:
            photos.insert(1, ("views", f"camera{mark}_all_on.png", "All switches on: red tips out"))
        if number == 0 and report["straight"]:
            photos.insert(1, ("compare", "straight.png", "The same counts in straight rows"))
        shown = [photo(context, stage, name, text + whose) for stage, name, text in photos]
        parts.append(page.side_by_side(*shown))
    why = context.facts("compare").get("why")
    if not page.missing(why):
        parts.append(
            f"<p>Straight rows of the same counts are not compared: {escape(str(why))}.</p>"
        )
    parts += [
        visibility_table(report),
        page.side_by_side(
            draw.maps(
                arrays["visible_fraction"],
                "Visible fraction of each marker (hidden ones ringed)",
                "fraction",
                name="visible_fraction",
                in_picture=True,
                marked=arrays["occluded"],
            ),
            draw.maps(
                np.minimum(arrays["gap_same_colour_px"], GAP_PX),
                f"Gap to the nearest marker of the same colour ({GAP_PX:g} px and more alike; "
                "fused ones ringed)",
                "px",
                name="gap",
                in_picture=True,
                marked=arrays["fused"],
            ),
        ),
    ]
    if several:
        rows = [
            (
                item["end"],
                item["stand_off_mm"],
                item["best_for"],
                *(item["visibility"][key] for key in ("occluded", "fused")),
            )
            for item in report["cameras"]
        ]
        head = ("camera", "stand-off (mm)", "reads markers", "hidden", "fused")
        parts.append(page.table(head, rows))
    # With several cameras the table above has these for each of them.
    omitted = {"end", "stand_off_mm"} if several else set()
    rest = {key: value for key, value in report["camera"].items() if key not in omitted}
    return "".join(parts) + figure_names.facts(rest, "camera")


def lens_section(context: Context, report: Mapping[str, Any]) -> str:
    """Scale, noise and blur of each row, and the depth of field, for every camera."""
    in_rows, words = context.markers.in_rows, flat_map.direction_names(context.surface)
    short = (words.along_short, words.around_short, "inward")
    columns = {
        "row": "row" if in_rows else "group",
        "markers": "markers",
        **{
            f"mm_per_px_{name}": f"mm per px, {which}"
            for name, which in zip(DIRECTIONS, short, strict=True)
        },
        **{
            f"noise_{name}_mm": f"noise, {which} (mm)"
            for name, which in zip(DIRECTIONS, short, strict=True)
        },
        "blur_px": "blur (px)",
    }
    parts = []
    for item in report["cameras"]:
        lens = item["lens"]
        far = lens["depth_far_mm"]
        reach = "on" if page.missing(far) else f"to {far:.1f} mm"
        rows = [[row[key] for key in columns] for row in lens["rows"]]
        if len(report["cameras"]) > 1:
            parts.append(f"<h3>{item['end'].capitalize()} camera</h3>")
        parts.append(
            f"<p>In focus at {lens['focus_mm']:.1f} mm from the camera; images of points are no "
            f"wider than a pixel from {lens['depth_near_mm']:.1f} mm {reach}, and at most "
            f"{lens['max_blur_px']:.2g} px at the markers (thin lens, camera.f_number and "
            "camera.pixel_um).</p>"
            + page.details("Each row", page.table([*columns.values()], rows))
        )
        if any(page.missing(value) for row in rows for value in row):
            parts.append(
                f'<p class="foot">{page.DASH}: such a motion is towards the camera and does not '
                "show.</p>"
            )
    groups = "row" if in_rows else "eighth of the markers, by their place along the sensor"
    return "".join(parts) + (
        f'<p class="foot">Medians of each {groups}; the largest blur. Directions: {words.along}, '
        f"{words.around}, along the normal.</p>"
    )


def under_load_section(
    context: Context,
    report: Mapping[str, Any],
    draw: Drawing,
) -> str:
    """Visibility under load, with the pictures of a press."""
    columns = {
        "end": "camera",
        "read": "reads markers",
        "hidden_most": "most hidden",
        "fused_most": "most fused",
        "crosstalk_px": "crosstalk (px)",
        "greatest_shift_px": "largest shift (px)",
    }
    load, arrays = report["under_load"], context.arrays("underload")
    slider, pressed = "", PressPictures.from_arrays(context.arrays("pressed"))
    if pressed is not None:
        name = context.markers.name(pressed.marker)
        slider = press_slider(pressed, name, of_camera(report, pressed.camera))
    first = load["first_place_uv"]
    cross = None if first is None else np.asarray(first, dtype=np.float64)
    where = "" if cross is None else "; the cross is where that happens first"
    shown = {key: load[key] for key in load if key not in {"sentence", "cameras"}}
    each = load.get("cameras", [])
    keys = [key for key in columns if all(key in item for item in each)]
    by_camera = page.table(
        [columns[key] for key in keys], [[item[key] for key in keys] for item in each]
    )
    return (
        f"<p>{escape(load['sentence'])}</p>"
        + slider
        + page.side_by_side(
            draw.maps(
                arrays["crosstalk_px"],
                "Crosstalk: largest shift of a centroid that is not its marker's own motion",
                "px",
                name="crosstalk",
                in_picture=True,
                cross=cross,
            ),
            draw.maps(
                np.minimum(arrays["least_gap_same_px"], GAP_PX),
                f"Smallest gap to a marker of the same colour under any press ({GAP_PX:g} px and "
                f"more alike{where})",
                "px",
                name="gap_under_load",
                in_picture=True,
                cross=cross,
            ),
        )
        + (by_camera if each else "")
        + figure_names.facts(shown, "under_load")
    )


def forces_up_to(texts: Iterable[str], most_N: float) -> list[str]:
    """Forces such as "5 N" in order, without those above the design's largest."""
    of_force = {float(text.split()[0]): text for text in texts}
    return [of_force[force_N] for force_N in sorted(of_force) if force_N <= most_N]


def resolution_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Cramér-Rao bounds."""
    names = {
        "force_N_median_middle": "force, median in the middle (N)",
        "force_N_median": "force, median (N)",
        "force_N_worst": "force, worst (N)",
        "force_known_place_N_median": "force at a known place, median (N)",
        "along_mm_median": "place {along}, median (mm)",
        "around_mm_median": "place {around}, median (mm)",
    }
    found, arrays = report["resolution"], context.arrays("resolution")
    words = flat_map.direction_names(context.surface)
    keys = [key for key in names if all(key in row for row in found["bound"].values())]
    head = [names[key].format(along=words.along_short, around=words.around_short) for key in keys]
    most_N = context.design.training.force_max_N
    order = forces_up_to(found["bound"], most_N)
    largest = f"{most_N:g}"
    rows = [(force, *(found["bound"][force][key] for key in keys)) for force in order]
    return (
        "<p>Cramér-Rao bound of a single contact, its position and size unknown but for the "
        "stated prior: no unbiased estimator is better on average. Smallest standard "
        "deviations:</p>"
        + page.table(("contact of", *head), rows)
        + page.side_by_side(
            draw.maps(
                arrays[f"force_N_{largest}"],
                f"Smallest standard deviation of a force of {largest} N, the design's largest",
                "N",
                name="resolution_force",
            ),
            draw.maps(
                arrays[f"along_mm_{largest}"],
                f"Smallest standard deviation of its position {words.along}",
                "mm",
                name="resolution_along",
            ),
        )
        + _camera_motion(found["camera_motion"], found["bound"])
        + figure_names.facts(
            {key: found[key] for key in found if key not in {"bound", "camera_motion"}},
            "resolution",
        )
    )


def _camera_motion(found: Mapping[str, Any], still: Mapping[str, Any]) -> str:
    """What motion of the camera costs, and how far it may go."""
    force = f"{found['force_N']:g} N"
    keys = ("force_N_median_middle", "force_N_median", "force_N_worst")
    names = {
        "rigid": "mount rigid",
        "bench": "mount bench",
        "handheld": "mount handheld",
        "marks": "any mount, with reference marks",
    }
    rows = [("camera that cannot move", *(still[force][key] for key in keys))]
    rows += [(names[name], *(row[key] for key in keys)) for name, row in found["bound"].items()]
    limit = found["tolerance"]
    return (
        f"<p>A camera that may have moved against the shell since the rest frame adds seven "
        f"unknowns. Smallest standard deviation of {force} then:</p>"
        + page.table(
            ("", "median in the middle (N)", "median (N)", "worst (N)"),
            rows,
        )
        + f"<p>The mount must hold the camera within {limit['shift_mm']:.2g} mm, "
        f"{limit['turn_deg']:.2g}° and {limit['zoom_percent']:.2g} % of focal length: frames of "
        "one that has moved farther are refused"
        + ("" if "marks" in found["bound"] else "; with reference marks it may move farther")
        + ".</p>"
    )


def markers_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Density and paints."""
    return page.side_by_side(
        draw.maps(
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
    ) + figure_names.facts(report["markers"], "markers")


def mechanics_section(context: Context, report: Mapping[str, Any], draw: Drawing) -> str:
    """Softness at each receptor, the wall's motion under the shown press, figures."""
    load = report["under_load"]
    kept = context.arrays("underload")
    maps = [
        draw.maps(
            softness_um_N(context),
            "Softness: inward motion of each marker under 1 N on its own cell",
            "µm/N",
            name="softness",
        )
    ]
    if len(kept["shown_uv"]):
        inward = -np.einsum("ni,ni->n", kept["shown_motion"][0][:, :3], context.markers.normal)
        maps.append(
            draw.maps(
                inward,
                f"Inward motion of the wall, pressed with {load['force_N']:g} N where the cross is",
                "mm",
                name="motion",
                cross=kept["shown_uv"][0],
            )
        )
    figures = {
        "how the wall's motion was found": load["theory"],
        "deepest dent (mm)": load["dent_mm"],
        "receptors stiffen the wall": report["response"]["receptors"],
        "nodes of the decoder's mesh": report["response"]["nodes"],
        "bound on the mesh's error in the tables of auto, median of places (%)": _percent(
            report["places"].get("mesh_error")
        ),
        "the same, worst place (%)": _percent(report["places"].get("mesh_error_largest")),
        "condition number of its compliance": report["condition_compliance"],
        "smallest image shift of a marker for inward motion (px/mm)": report["response"][
            "sensitivity_px_mm_least"
        ],
        "its median (px/mm)": report["response"]["sensitivity_px_mm_median"],
    }
    unknown = report["response"]["receptors_unknown"]
    notes = [f"The wall is taken as plain: {unknown}."] if unknown else []
    notes += unbounded_words(report["places"])
    return (
        page.side_by_side(*maps)
        + page.table(("figure", "value"), list(figures.items()))
        + "".join(f'<p class="foot">{text}</p>' for text in notes)
        + "<h3>Mesh for other solvers, and the printed shell</h3>"
        + page.side_by_side(
            figure_names.facts(report["mesh"], "mesh"), figure_names.facts(report["shell"], "shell")
        )
    )


def unbounded_words(places: Mapping[str, Any]) -> list[str]:
    """What to say of tables of one mesh, which have no bound on its error; nothing of others."""
    if "mesh_error" in places:
        return []
    text = (
        "The tables of auto are of one mesh and have no bound on its error: forces read too large, "
        "by about 3 % with 4 elements a marker pitch, 8 % with 3, and more with fewer."
    )
    return [text]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def switch_section(context: Context, report: Mapping[str, Any]) -> str:
    """Switches side by side, their force curves, warnings, and the visibility of the tips."""
    # report.json and the files of the folder ``switch`` hold the rest.
    names = {
        "family": "family",
        "choice": "why this one",
        "threshold_N": "nominal threshold (N)",
        "limit_N": "threshold of the switch (N)",
        "receptors_least_N": "smallest threshold as the camera sees the receptors (N)",
        "receptors_most_N": "largest of these (N)",
        "spread.low_N": "smallest of a batch (N)",
        "spread.high_N": "largest of a batch (N)",
        "valley_N": "it turns off below (N)",
        "travel_mm": "travel of the snap (mm)",
        "on_mm": "travel at which it is on (mm)",
        "stop_mm": "travel at its stop (mm)",
        "stop_N": "force at its stop (N)",
        "visible_mm": "tip shows, when out (mm)",
        "strain": "largest strain",
        "bowl.diameter_mm": "bowl: diameter (mm)",
        "bowl.depth_mm": "bowl: depth (mm)",
        "bowl.thickness_mm": "bowl: wall (mm)",
        "bowl.stem_diameter_mm": "bowl: stem diameter (mm)",
        "cup.diameter_mm": "diameter (mm)",
        "cup.height_mm": "inner height (mm)",
        "cup.side_mm": "side wall (mm)",
        "cup.roof_mm": "roof (mm)",
        "cup.boss_mm": "boss (mm)",
        "stem_diameter_mm": "stem diameter (mm)",
        "rubber.name": "rubber",
        "rubber.modulus_MPa": "its Young's modulus (MPa)",
    }
    made = [page.flatten(item) for item in report["switch"]["switches"]]
    keys = [key for key in names if any(key in item for item in made)]
    head = ("switch", *(f"{page.number(item['threshold_N'])} N" for item in made))
    rows = [(names[key], *(item.get(key) for item in made)) for key in keys]
    warnings = dict.fromkeys(text for item in made for text in item.get("warnings", ()))
    curves = sorted((context.folders["switch"] / EXPORT / "switch").glob("*.svg"))
    left_out = {"switches", "refused"}  # shown above, and in the verdict
    red = {key: value for key, value in report["switch"].items() if key not in left_out}
    return (
        page.table(head, rows)
        + "".join(f'<p class="foot">{escape(sentence(text))}</p>' for text in warnings)
        + page.side_by_side(
            *(
                page.svg_figure(path.read_text(encoding="utf-8"), _curve_caption(path.stem))
                for path in curves
            )
        )
        + figure_names.facts(red, "switch")
    )


def _curve_caption(stem: str) -> str:
    """Caption of a plot of the switch stage."""
    switch = stem.removesuffix("_red")
    return f"{'Force over stroke' if switch == stem else 'Visible red over force'}: {switch}"


def frames_section(context: Context, report: Mapping[str, Any], table: str) -> str:
    """Decoding of rendered frames."""
    captions = {"rest": "Frame of the unloaded sensor", "pressed": "A decoded frame under load"}
    shown = [
        photo(
            context,
            "frames",
            f"frame_{what}{CAMERA_SUFFIXES[number]}.png",
            caption + of_camera(report, number),
        )
        for number in range(len(report["cameras"]))
        for what, caption in captions.items()
    ]
    return (
        f"{table}<p>({page.number(PAPER)}.)</p>"
        + page.side_by_side(*shown)
        + figure_names.facts(report["frames"], "frames")
    )


def sections_of(context: Context, report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Headings and HTML, in order."""
    draw = Drawing(context)
    limits, count = report["limit_figures"], report["markers"]["count"]

    def table(key: str) -> str:
        return score_tables.score_table(report[key], limits, count)

    marks = score_tables.marks_of(limits, list(report["decoder"]))
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
                report_figures.error_bars(report["decoder"], marks),
                "Relative error of the estimators, contacts on receptors",
                name="estimators.png",
            )
            + "<p>Contacts anywhere on the surface, between receptors too:</p>"
            + table("decoder_anywhere")
            + "<p>Contacts that trip no switch are counted apart: the motion of the markers "
            "alone shows them.</p>" + figure_names.facts(learnt),
        ),
        (
            "Assumptions",
            "<p>Not stated by the paper; set these to your own parts. Names as in the design "
            "file.</p>"
            + page.details("All of them", figure_names.facts(report["assumptions"], "assumptions")),
        ),
        ("Time and plan", time_section(context, report)),
        ("Provenance", provenance_section(context, report)),
    ]
