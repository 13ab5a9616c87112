"""The densest cylinder that the tool finds, built whole beside the published one."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.decoder_data import data_folder
from benchmarks.harness import Table
from phytac_design.core.figures import new_figure, png
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash
from phytac_design.optics.density import density_of
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.study.search.design_space import make_space
from phytac_design.study.search.driver import run_study
from phytac_design.study.search.process_pool import ProcessPool
from phytac_design.study.search.search_report import Results, read_results
from phytac_design.study.search.study_file import Budget, load_study
from phytac_design.study.search.study_folder import rebuild

STUDIES = {"dense-cylinder": (96, 1200), "dense-cone": (16, None), "dense-hemisphere": (16, None)}
"""Candidates of each study, and the required count."""
WHOLE = ("dense-cylinder", "cylinder60")
"""Built at standard accuracy; the others as drafts."""
WORKERS = 2
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "dense-front-cylinder.png"


def dense(table: Table, *, name: str, quick: bool) -> None:
    """Search, then build the one with the most markers; what a build says of it counts."""
    candidates, asked = STUDIES[name]
    study, folder = load_study(name)
    number = 6 if quick else candidates
    study = study.model_copy(update={"budget": Budget(candidates=number)})
    out = data_folder() / "study" / f"{name}-{code_hash()[:16]}"
    with closing(ProcessPool(WORKERS)) as pool:
        space = make_space(study, folder)
        run_study(study, space, out, kind="optimise", pool=pool, progress=print)
    results = read_results(out)
    if not results.ok.any():
        row = f"{name}: markers of the densest that meets all"
        source = f"{number} candidates"
        note = "none of the candidates met all constraints"
        table.add(row, 0, "markers", "", source, f">= {asked or 1}", note)
        return
    counts = np.where(results.ok, results.columns["marker_count"], 0.0)
    best = int(results.columns["trial"][int(counts.argmax())])
    _front(table, results, name)
    _built(table, rebuild(out, best), f"{name} trial {best}", asked, number, quick=quick)
    if name == WHOLE[0]:
        published = _built(table, load_design(WHOLE[1]), WHOLE[1], None, 0, quick=quick)
        if not quick:
            PICTURE.write_bytes(front_picture(results, published))


def _front(table: Table, results: Results, name: str) -> None:
    """Markers against resolution: designs that no other beats in both."""
    rows = np.flatnonzero(results.front())
    counts, spread = (results.columns[each] for each in ("marker_count", "force_sd_N"))
    source = f"{int(results.ok.sum())} candidates that meet all constraints, finite elements"
    for row in rows[np.argsort(counts[rows])]:
        case = f"{name}: front, bound of force at 10 N with {counts[row]:.0f} markers"
        table.add(case, float(spread[row]), "N", "", source)


def front_picture(results: Results, published: tuple[float, float]) -> bytes:
    """PNG of count against resolution: all candidates, the front, and the published counts."""
    figure = new_figure((6.4, 3.6))
    axes = figure.add_subplot()
    counts, spread = (results.columns[each] for each in ("marker_count", "force_sd_N"))
    dots = {"linestyle": "none", "marker": "o"}
    axes.plot(counts[results.ok], spread[results.ok], color="#9fb4c8", label="candidates", **dots)
    best = results.front()
    axes.plot(counts[best], spread[best], color="#c23b22", label="on the front", **dots)
    axes.plot(*published, color="black", linestyle="none", marker="D", label="cylinder60")
    axes.set_xlabel("markers")
    axes.set_ylabel("bound of force at 10 N, median (N)")
    axes.set_ylim(0.0, 1.1 * published[1])
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return png(figure)


def _built(
    table: Table, design: Design, label: str, asked: int | None, searched: int, *, quick: bool
) -> tuple[float, float]:
    """What a build finds: everything that the search assumed, at standard accuracy.

    Returns markers, and their bound of force at 10 N.
    """
    accuracy = "draft" if quick or not label.startswith(WHOLE) else "standard"
    surface = design.surface()
    context, _, _ = run_stages(
        design,
        select_stages(["underload", "resolution", "switch", "decoder"]),
        accuracy=accuracy,
        seed=0,
        force=True,
        progress=lambda text: print(f"  {label}: {text}", flush=True),
    )
    views, load = context.facts("views"), context.facts("underload")
    density = density_of(surface, context.markers)
    source = f"build at {accuracy} accuracy"
    found = f"of {searched} candidates of `phytac optimise`" if searched else "published counts"

    def add(what: str, value: float, unit: str, **rest: Any) -> None:
        table.add(f"{label}: {what}", value, unit, reference="", source=source, **rest)

    target = f">= {asked}" if asked else None
    add("markers", density.count, "markers", target=target, note=found)
    add("density", density.per_cm2, "/cm²")
    seen = views["visibility"]
    add("hidden or fused at rest", seen["occluded"] + seen["fused"], "markers", target="<= 0")
    add("hidden or fused at 25 N", load["hidden_most"] + load["fused_most"], "markers",
        target="<= 0", note=f"{load['presses']} presses, {load['theory']}")  # fmt: skip
    add("crosstalk at 25 N", load["crosstalk_px"], "px", target="<= 0.1")
    add("least visible fraction at 25 N", load["least_visible_fraction"], "")
    add("least gap of one colour at 25 N", load["least_gap_same_colour_px"], "px")
    refused = context.facts("switch")["refused"]
    add("switches that cannot be made", float(bool(refused)), "", target="<= 0", note=refused)
    bound = context.facts("resolution")["bound"]["10 N"]
    add("bound of force at 10 N, median", bound["force_N_median"], "N")
    judged = context.facts("decoder")["anywhere"]["auto"]
    add(
        "decoder: mean absolute error of force",
        judged["mae_N"],
        "N",
        note="contacts anywhere, in simulation",
    )
    return float(density.count), float(bound["force_N_median"])
