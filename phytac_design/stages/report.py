"""Gather every stage's figures into report.json, and show them on one page."""

import json
from html import escape as html_escape
from pathlib import Path
from typing import Any

import numpy as np

from decoder.run import read_image
from phytac_design import cache
from phytac_design.design_file import assumptions
from phytac_design.finite import finite
from phytac_design.optics.density import density_map
from phytac_design.optics.separability import check_paints, separability_svg
from phytac_design.optics.sharpness import DIRECTIONS
from phytac_design.report import figures, page
from phytac_design.spec import Design
from phytac_design.stage import EXPORT, Context, Stage, export_path, write_facts

NEEDS = (
    "views",
    "compare",
    "underload",
    "resolution",
    "shell",
    "step",
    "mesh",
    "response",
    "twin",
    "decoder",
    "frames",
)
SIMULATED = (
    "All decoder figures are in simulation: contacts are solved with a linear shell model (on a "
    "finer mesh than the decoder's own), projected through the camera, and given pixel noise. "
    "Large displacement, printed scatter and real frames are not in them."
)
PAPER = "paper, on a real sensor: FEM 18 % (49 % below 5 N), FEM-NN 2.3 % and 0.11 N"


def gather(context: Context) -> dict[str, Any]:
    """Every figure of the build, as report.json holds it."""
    design, markers = context.design, context.markers
    views, shell, step = (context.facts(name) for name in ("views", "shell", "step"))
    decoder, frames, twin = (context.facts(name) for name in ("decoder", "frames", "twin"))
    density = views["density"]
    timing = {name: cache.record(context.folders[name])["seconds"] for name in NEEDS}
    return {
        "schema_version": "1.0",
        "design": design.name,
        "description": design.description,
        "simulated": SIMULATED,
        "markers": {
            "count": density["count"],
            "layout": design.layout.kind,
            "rows": len(np.unique(markers.row)) if markers.in_rows else None,
            "columns": int(markers.column.max()) + 1 if markers.in_rows else None,
            "density_per_cm2": density["per_cm2"],
            "density_local_min_per_cm2": density["local_min_per_cm2"],
            "density_local_max_per_cm2": density["local_max_per_cm2"],
            "density_times_paper": density["times_paper"],
            "sensing_area_cm2": density["area_cm2"],
            "surface_class": density["surface_class"],
            "height_least_mm": float(markers.height_mm.min()),
            "height_greatest_mm": float(markers.height_mm.max()),
            "colours": check_paints(design).summary(),
        },
        "visibility": views["visibility"],
        "straight": context.facts("compare")["straight"],
        "under_load": context.facts("underload"),
        "resolution": context.facts("resolution"),
        "camera": {
            "stand_off_mm": views["stand_off_mm"],
            "picture": views["renderer"],
            "rest_centroid_bias_px": views["centroid_bias_px"],
            "end": views["cameras"][0]["end"],
        },
        "lens": views["cameras"][0]["lens"],
        "shell": shell | step,
        "mesh": context.facts("mesh"),
        "decoder": {name: decoder["test"][name] for name in decoder["test"]},
        "decoder_anywhere": decoder["anywhere"],
        "training": decoder["training"],
        "limits": decoder["limits"]["sentences"],
        "twin": twin,
        "condition_compliance": context.facts("response")["condition"],
        "frames": {key: value for key, value in frames.items() if key != "estimators"},
        "decoder_frames": frames["estimators"],
        "assumptions": assumptions(design),
        "accuracy": context.accuracy.as_dict(),
        "seed": context.seed,
        "timing_s": timing | {"total": round(sum(timing.values()), 3)},
    }


def lead_of(report: dict[str, Any]) -> str:
    """Verdict at the top of the page."""
    seen, shell = report["visibility"], report["shell"]
    clear = seen["occluded"] == 0 and seen["fused"] == 0
    told = (
        "every marker is seen and told apart"
        if clear
        else f"{seen['occluded']} markers are hidden and {seen['fused']} fuse: see Camera"
    )
    solid = "one watertight body" if shell["watertight"] else "NOT watertight"
    frames = report["decoder_frames"]["koi_inverse"]
    points = report["decoder"]["koi_inverse"]
    about = html_escape(report["description"])
    return (
        f"<p>{about}</p>"
        f'<p class="verdict{"" if clear else " bad"}">{report["markers"]["count"]} markers, '
        f"{report['markers']['density_per_cm2']:.2f} per cm² of a surface "
        f"{report['markers']['surface_class']} to the optical axis; {told}; the shell is {solid}; "
        f"simulated contacts decode to {100.0 * points['relative_error']:.1f} % and "
        f"{points['mae_N']:.2f} N ({points['samples']} held-out ones), through rendered frames to "
        f"{100.0 * frames['relative_error']:.1f} % ({frames['samples']}), by the KOI-restricted "
        "inverse.</p>"
        + "".join(f'<p class="note">{html_escape(limit)}.</p>' for limit in report["limits"])
        + f'<p class="note">{SIMULATED}</p>'
    )


def lens_section(lens: dict[str, Any], *, in_rows: bool) -> str:
    """Scale, noise and blur of each row, and the depth of field."""
    names = {"mm_per_px": "{} mm per px", "noise": "{} noise mm"}
    head = [
        "row" if in_rows else "group",
        "markers",
        *(names["mm_per_px"].format(name) for name in DIRECTIONS),
        *(names["noise"].format(name) for name in DIRECTIONS),
        "blur px",
    ]
    rows = [list(item.values()) for item in lens["rows"]]
    far = lens["depth_far_mm"]
    reach = f"to {far:.1f} mm" if np.isfinite(far) else "on"
    return (
        f"<p>In focus at {lens['focus_mm']:.1f} mm from the camera; images of points are no wider "
        f"than a pixel from {lens['depth_near_mm']:.1f} mm {reach}, and at most "
        f"{lens['max_blur_px']:.2g} px at the markers (thin lens, camera.f_number and "
        "camera.pixel_um). Medians of each "
        + ("row" if in_rows else "eighth of the markers, by their place along the sensor")
        + "; the greatest blur. Axial: along the sensor; radial: along the wall's normal.</p>"
        + page.table(head, rows)
    )


def sections_of(context: Context, report: dict[str, Any]) -> list[tuple[str, str]]:
    """Sections of the page."""
    arrays = context.arrays("views")
    colours = [
        context.design.layout.colours[index % len(context.design.layout.colours)]
        for index in context.markers.colour
    ]
    flat = context.surface.unwrap(context.markers.uv)
    paper = f"<p>({page.number(PAPER)}.)</p>"
    straight = report["straight"]
    layouts = page.table(
        ("", "this layout", *(("straight, same counts",) if straight else ())),
        [
            (key, value, *((straight[key],) if straight else ()))
            for key, value in report["visibility"].items()
        ],
    )

    def view(stage: str, name: str, caption: str) -> str:
        image = read_image(context.folders[stage] / EXPORT / "views" / name)
        return page.figure(figures.thumbnail(image, 900), caption, "jpeg")

    def unrolled(values: Any, title: str, label: str) -> str:
        data = figures.unrolled_map(flat, values, title=title, label=label, colours=colours)
        return page.figure(data, title)

    gap = np.minimum(arrays["gap_same_colour_px"], 60.0)
    return [
        (
            "Camera",
            '<div class="pair">'
            + view("views", "camera.png", "What the camera sees, at rest")
            + (
                view("compare", "straight.png", "The same counts in straight rows")
                if straight
                else ""
            )
            + view("views", "camera_all_on.png", "All switches on: red tips out")
            + view("views", "ids.png", "Exact ID map: one colour per marker")
            + "</div>"
            + layouts
            + unrolled(arrays["visible_fraction"], "Visible fraction of each marker", "fraction")
            + unrolled(
                gap, "Gap to the nearest marker of the same colour (60 px and more alike)", "px"
            )
            + page.facts(report["camera"]),
        ),
        ("Lens", lens_section(report["lens"], in_rows=context.markers.in_rows)),
        (
            "Under load",
            f"<p>{html_escape(report['under_load']['sentence'])}</p>"
            + unrolled(
                context.arrays("underload")["crosstalk_px"],
                "Crosstalk: greatest shift of a centroid that is not its marker's own motion",
                "px",
            )
            + unrolled(
                np.minimum(context.arrays("underload")["least_gap_same_px"], 60.0),
                "Least gap to a marker of the same colour under any press (60 px and more alike)",
                "px",
            )
            + page.facts(report["under_load"]),
        ),
        (
            "Predicted resolution",
            "<p>Cramér-Rao bound of a single contact, its position and size unknown but for the "
            "stated prior: no estimator without bias is better on average.</p>"
            + unrolled(
                context.arrays("resolution")["force_N_10"],
                "Least standard deviation of a force of 10 N",
                "N",
            )
            + unrolled(
                context.arrays("resolution")["along_mm_10"],
                "Least standard deviation of its position along the sensor",
                "mm",
            )
            + page.facts(report["resolution"]),
        ),
        (
            "Markers",
            unrolled(
                density_map(context.surface, context.markers).per_cm2,
                "Local density: markers around each one over their area",
                "per cm²",
            )
            + f"<figure>{separability_svg(check_paints(context.design))}<figcaption>The paints "
            "under the light: three standard deviations of one pixel, and the decoder's borders"
            "</figcaption></figure>" + page.facts(report["markers"]),
        ),
        ("Shell", page.facts(report["shell"])),
        ("Mesh", page.facts(report["mesh"])),
        (
            "Decoder: rendered frames",
            page.score_table(report["decoder_frames"])
            + paper
            + '<div class="pair">'
            + view("frames", "frame_rest.png", "Frame of the unloaded sensor")
            + view("frames", "frame_pressed.png", "A pressed frame that was decoded")
            + "</div>"
            + page.facts(report["frames"]),
        ),
        (
            "Decoder: held-out contacts, points",
            page.score_table(report["decoder"])
            + paper
            + page.figure(
                figures.error_bars(report["decoder"], title="Contacts on receptors"),
                "Relative error of the estimators",
            )
            + "<p>Contacts anywhere on the surface, between receptors too:</p>"
            + page.score_table(report["decoder_anywhere"])
            + "<p>Contacts that trip no switch cannot be decoded and are counted apart.</p>"
            + page.facts({"training": report["training"], "twin": report["twin"]}),
        ),
        (
            "Assumptions",
            "<p>Not stated by the paper; set these to your own parts.</p>"
            + page.facts(report["assumptions"]),
        ),
        ("Settings and time", page.facts({k: report[k] for k in ("accuracy", "seed", "timing_s")})),
    ]


def run(context: Context, folder: Path) -> None:
    """Write ``report/report.json`` and ``report/report.html``."""
    report = gather(context)
    text = json.dumps(finite(report), indent=1, ensure_ascii=False)
    export_path(folder, "report/report.json").write_text(text + "\n", encoding="utf-8")
    title = f"{report['design']}: camera-based force sensor"
    html = page.page(title, sections_of(context, report), lead_of(report))
    export_path(folder, "report/report.html").write_text(html, encoding="utf-8")
    write_facts(folder, {"page_bytes": len(html)})


REPORT = Stage(
    name="report",
    tables=tuple(Design.model_fields),
    needs=NEEDS,
    run=run,
)
