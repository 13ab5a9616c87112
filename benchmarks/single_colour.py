"""What it costs to do without colours and switches: the same presses, decoded for each kind.

One design is built with paints and switches, with paints alone, and as white dots on black and
black dots on light resin, both without switches. All frames are rendered with sensor noise, and
decoded after a rest frame by decoders that were made from the designs alone. The part
``cylinder60`` takes the shipped design with switches and without. ::

    python -m benchmarks.single_colour [--quick]
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from benchmarks.camera import Bench, Outcome, decode
from benchmarks.harness import Table, run_parts
from phytac_decoder.pipeline.colour_calibration import calibrate_rest
from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.spec import Design

KINDS: dict[str, dict[str, dict[str, Any]]] = {
    "paints and switches": {"layout": {}, "receptor": {}},
    "paints, no switches": {"layout": {}, "receptor": {"diameter_hole_mm": 0.0}},
    "white dots": {"layout": {"colours": ["white"]}, "receptor": {"diameter_hole_mm": 0.0}},
    # A dark opening behind black dots: those of the far rows are one blob with it.
    "black dots, far end open": {
        "layout": {"colours": ["black"]},
        "receptor": {"diameter_hole_mm": 0.0},
    },
}


def design_of(kind: str) -> Design:
    """ø60 × 60 mm, 8 rows of 14 markers, a 1296 × 972 camera, no light bar."""
    data = load_design("cylinder60").model_dump(mode="json")
    tables = {
        "shape": {"length_mm": 60.0},
        "layout": {"rows": 8, "columns": 14, "height_far_mm": 6.0} | KINDS[kind]["layout"],
        "receptor": KINDS[kind]["receptor"],
        "light": {"bar_radius_mm": 0.0},
        "camera": {"width_px": 1296, "height_px": 972, "focal_px": 485.0},
    }
    data |= {name: data[name] | change for name, change in tables.items()}
    return parse_design(data | {"name": kind.partition(",")[0].replace(" ", "-")}, kind)


def judged(bench: Bench, presses: int) -> Outcome:
    """All presses of a design, rendered, decoded and compared."""
    camera = bench.context.sensor.cameras[0]
    bundle = calibrate_rest(bench.bundle, [bench.frame(None, camera)])
    out = Outcome()
    for k in range(presses):
        bench.judge(out, k, decode(bundle, bench.frame(k, camera)))
    return out


def add_rows(table: Table, kind: str, out: Outcome, with_switches: Outcome) -> None:
    """Rows of one kind, against the one with switches."""

    def mean(errors: list[float]) -> float:
        return 100.0 * float(np.mean(errors)) if errors else float("nan")

    note = (
        f"{out.frames} frames, {out.refused} refused, {out.warned} with warnings; {out.inside} of "
        f"{out.contacts} forces within their 95 % interval"
    )
    source = "the same presses with paints and switches"
    for part in ("middle_errors", "errors"):
        where = "middle heights" if part == "middle_errors" else "whole surface"
        table.add(
            f"{kind}: force error of found contacts, {where}",
            mean(getattr(out, part)),
            "%",
            mean(getattr(with_switches, part)),
            source,
            note=note,
        )
    found = out.contacts + out.missed
    table.add(
        f"{kind}: contacts above 0.5 N that are not found",
        100.0 * out.missed / max(found, 1),
        "%",
        100.0 * with_switches.missed / max(with_switches.contacts + with_switches.missed, 1),
        source,
        note=f"{out.missed} of {found}",
    )
    table.goal(f"{kind}: silently wrong contacts", out.silent, "", "== 0")


def add_kinds(table: Table, *, quick: bool) -> None:
    """Rows of all kinds."""
    presses = 4 if quick else 24
    results = {kind: judged(Bench(design_of(kind), presses), presses) for kind in KINDS}
    for kind, out in results.items():
        add_rows(table, kind, out, results["paints and switches"])


def add_shipped(table: Table, *, quick: bool) -> None:
    """Rows of cylinder60 itself, with switches and without."""
    presses = 2 if quick else 24
    data = load_design("cylinder60").model_dump(mode="json")
    results = {
        kind: judged(Bench(parse_design(data | {"receptor": receptor}, kind), presses), presses)
        for kind, receptor in (
            ("cylinder60", data["receptor"]),
            ("cylinder60 without switches", data["receptor"] | {"diameter_hole_mm": 0.0}),
        )
    }
    for kind, out in results.items():
        add_rows(table, kind, out, results["cylinder60"])


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Both parts by name."""
    return {
        "kinds": partial(add_kinds, quick=quick),
        "cylinder60": partial(add_shipped, quick=quick),
    }


if __name__ == "__main__":
    run_parts("single_colour", parts, __doc__ or "")
