"""``phytac check``: rules, visibility and density of a design."""

from dataclasses import asdict
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, SeedOption, say
from phytac_design.cli.output import (
    TimeLimitError,
    next_step,
    print_json,
    resumable,
    seldom,
    time_limit,
)
from phytac_shapes.errors import DesignError, PhytacError

if TYPE_CHECKING:
    from phytac_design.design.spec import Design
    from phytac_design.study.advice.quick_repair import ReadableRepair

BLIND_SHARE = 0.1
"""Above this share of switches that cannot be read, a cure is looked for."""
LOOK_S = 30.0
"""A reader of the faults waits no longer for a repair."""


OpenGLOption = Annotated[
    bool,
    typer.Option("--opengl", help="Also compare the camera's view with one that OpenGL draws."),
]


def check(
    design: DesignArgument,
    seed: SeedOption = 0,
    opengl: OpenGLOption = False,
    as_json: JsonOption = False,
) -> None:
    """Check rules, visibility, density and thresholds alone: no solid, no mesh.

    All faults are listed, and a change that repairs them if one is found within seconds.
    """
    began_s = perf_counter()
    from phytac_design.design.design_file import load_design
    from phytac_design.design.unit_hints import unit_hints
    from phytac_design.workflows.design_check import full_check

    loaded = load_design(design)
    try:
        report = full_check(loaded, seed=seed, progress=say)
    except DesignError as error:
        _print_faults(loaded, error, as_json=as_json)
        if not as_json and not unit_hints(loaded.model_dump()):
            _suggest_repair(design, refused=True, seed=seed)
        raise typer.Exit(error.exit_code) from None
    if opengl:
        _compare_with_opengl(loaded, report)
    if as_json:
        print_json(report)
        _warn(report)
    else:
        _print_check(report)
        _print_turns(loaded)
        _warn(report)
        if report["visible"] and _blind_share(report) > BLIND_SHARE:
            _suggest_tips(loaded, report, seed=seed)
        typer.echo(f"{_verdict(report)} ({perf_counter() - began_s:.1f} s)")
        if report["clear"]:
            next_step(f"phytac build {design}")
        elif not report["visible"]:
            _suggest_repair(design, refused=False, seed=seed)
    if not report["clear"]:
        raise typer.Exit(DesignError.exit_code)


def _warn(report: dict[str, Any]) -> None:
    for warning in report["warnings"]:
        say(f"warning: {warning}")
    for fault in report.get("faults", ()):
        say(f"error[{fault['code']}]: {fault['text']}")


def _fault_facts(fault: PhytacError) -> dict[str, str]:
    """An error for JSON."""
    return {"code": fault.code, "text": str(fault)}


def _print_faults(design: "Design", first: DesignError, *, as_json: bool) -> None:
    """All rules that a design breaks, of which ``first`` is one, and lengths in other units."""
    from phytac_design.design.unit_hints import unit_hints
    from phytac_design.rules.check import broken_rules
    from phytac_design.workflows.switch_feasibility import check_thresholds

    # Bowls are as wide as the markers' distances and the footprints leave them.
    thresholds = (
        lambda sensor: check_thresholds(sensor.design, progress=say),
        "switches gaps ends footprints rubber",
    )
    faults = broken_rules(design, {"thresholds": thresholds}) or [first]
    hints = unit_hints(design.model_dump())
    if as_json:
        each = [_fault_facts(fault) for fault in faults]
        print_json({"design": design.name, "clear": False, "faults": each, "warnings": hints})
    # Another unit is the likely cause of the faults.
    for hint in hints:
        say(f"warning: {hint}")
    for fault in faults:
        say(f"error[{fault.code}]: {fault}")


def _print_check(report: dict[str, Any]) -> None:
    from phytac_decoder.vision.switch_detection import RED_RATIO_MIN
    from phytac_design.optics.loaded_visibility import FUSED_PX
    from phytac_design.optics.visibility import FRACTION_MIN, PIXELS_MIN
    from phytac_design.report.figure_names import name_of

    density, seen = report["markers"], report["visibility"]
    typer.echo(
        f"{report['design']}: {density['count']} markers on {density['sensing_area_cm2']:.1f} cm² "
        f"({density['density_per_cm2']:.2f} /cm², {density['surface_class']} to the optical axis)"
    )
    for camera in report["cameras"]:
        lens = camera["lens"]
        across, down = camera["field_of_view_deg"]
        nearest, farthest = camera["working_distance_mm"]
        typer.echo(
            f"camera {camera['stand_off_mm']:.2f} mm before the {camera['end']} rim, field of view "
            f"{across:.0f}° x {down:.0f}°; a px is {lens['median_mm_per_px_axial']:.3g} mm along "
            f"the sensor, {lens['median_mm_per_px_circumferential']:.3g} mm around it; "
            f"{camera['distances']}, markers are {nearest:.1f} to {farthest:.1f} mm away, and the "
            f"image is sharp from {lens['depth_near_mm']:.1f} to {lens['depth_far_mm']:.1f} mm "
            f"(blur up to {lens['max_blur_px']:.2g} px; a warning says where that is too much)"
        )
        if own := camera.get("opengl"):
            typer.echo(
                f"  by OpenGL, another renderer: {own['found']} of {own['markers']} markers found, "
                f"{own['median_px']:.2f} px (median) and up to {own['max_px']:.2f} px from there"
            )
    needs = {
        "occluded": "must be 0",
        "fused": "must be 0",
        "min_visible_fraction": f"needs {FRACTION_MIN:g}",
        "min_visible_px": f"needs {PIXELS_MIN}",
        "min_gap_px": f"needs more than {FUSED_PX:g}",
        "switch_unreadable": "should be 0; by exact pixels, a build counts them in frames",
    }
    # Of two different tips, so that a reader cannot compare them.
    for key in [key for key in seen if key not in {"min_red_on_px", "max_red_rest_px"}]:
        need = f"  ({needs[key]})" if key in needs else ""
        typer.echo(f"  {name_of(f'visibility.{key}'):48s} {seen[key]:.4g}{need}")
    if tip := report.get("weakest_tip"):
        label = f"tip hardest to read, {tip['name'].strip('()')}: red (px)"
        typer.echo(
            f"  {label:48s} {tip['on_px']} when out  (needs {tip['needed_px']:g}: "
            f"{RED_RATIO_MIN:g} times its {tip['rest_px']} at rest, and {PIXELS_MIN} more)"
        )
    for made in report.get("switches", ()):
        typer.echo(
            f"switches of {made['threshold_N']:g} N: {made['family']} of {made['rubber']}, "
            f"{made['choice'] or 'its threshold spreads by ± {:.0%}'.format(made['band'])}"
        )
    _print_effort(report["effort"])


def _compare_with_opengl(design: "Design", report: dict[str, Any]) -> None:
    """Add what the detector finds in OpenGL's pictures to the cameras of a report."""
    from phytac_design.layout.sensor import Sensor
    from phytac_design.workflows.opengl_check import CENTROID_MAX_px, compare_with_opengl

    say("drawing what the camera sees by OpenGL")
    found = compare_with_opengl(Sensor(design))
    for camera, own in zip(report["cameras"], found, strict=True):
        camera["opengl"] = asdict(own) | {"same": own.same}
        if not own.same:
            report["warnings"].append(
                f"the picture by OpenGL shows {own.found} of the {own.markers} markers of the "
                f"{camera['end']} camera's frame, up to {own.max_px:.2f} px from there (at most "
                f"{CENTROID_MAX_px:g} px are expected): do not trust the visibility of this design"
            )


def _print_turns(design: "Design") -> None:
    """Say that the shell looks the same from several sides, if it does."""
    from phytac_design.layout.sensor import Sensor
    from phytac_design.workflows.inspect_assembly import alike_turns

    sensor, markers_max = Sensor(design), 2000  # all pairs of markers are compared
    if design.reference_marks.count or sensor.markers.count > markers_max:
        return
    if (turns := len(alike_turns(sensor))) > 1:
        typer.echo(
            f"note: turned by {360.0 / turns:g}° or a multiple, the shell looks the same: align it "
            "with the camera, or set reference_marks.count = 6, so that turns differ"
        )


def _print_effort(effort: dict[str, Any]) -> None:
    """Parts, hand work and material, before anything is made."""
    from phytac_design.fabrication.effort.effort import on_strips

    grams = {name: f"{mass:.0f} g" for name, mass in effort["mass_g"].items()}
    typer.echo(
        f"to make: {effort['parts_handled']} parts, {effort['hours_total']:.1f} h of hand work, "
        f"{effort['hours_paint_and_glue']:.1f} h of it painting and gluing"
    )
    if effort["inserts"]:
        typer.echo(
            f"  {effort['inserts']} coloured inserts on {effort['parts']['sprues']} sprues to push "
            f"in from outside, {grams['inserts']}"
        )
    else:
        typer.echo(f"  {effort['receptor_ends']} receptor ends to paint inside the shell")
    if effort["switches"]:
        typer.echo(
            f"  {effort['switches']} switches to cast, trim, paint and glue"
            f"{on_strips(effort)}; stem lengths: {effort['stem_lengths']}, castings: "
            f"{effort['castings']}"
        )
    typer.echo(f"  {effort['parts_printed']} printed parts; resin of the shell {grams['shell']}")
    if effort["castings"]:
        typer.echo(
            f"  molds: resin {grams['molds']}, silicone {grams['silicone']}, rubber "
            f"{grams['rubber']}"
        )
    if effort["left_out"]:
        typer.echo(f"  no molds: {effort['left_out']}")
    if effort["price"] is not None:
        typer.echo(f"  price, hand work included where it has one: {effort['price']:.2f}")
    typer.echo("  (times are assumed: set your own in the table [effort])")
    if effort["left_out"]:
        say(f"warning: no molds can be planned: {effort['left_out']}")


def _verdict(report: dict[str, Any]) -> str:
    visible = report["visible"]
    verdict = "every marker is visible and can be distinguished" if visible else report["advice"]
    codes = {fault["code"] for fault in report.get("faults", ())}
    if codes - {"switch-unreadable"}:
        verdict += "; its switches cannot be made (see the error)"
    blind = report["visibility"].get("switch_unreadable", 0)
    if not blind:
        return verdict
    unread = f"about {blind} of {report['markers']['count']} switches cannot be read"
    if "switch-unreadable" in codes:
        return f"{unread}, too many (see the error); {verdict}"
    return f"{verdict}; {unread}"


def _blind_share(report: dict[str, Any]) -> float:
    """Share of the switches that the camera cannot read."""
    blind: float = report["visibility"].get("switch_unreadable", 0)
    markers: int = report["markers"]["count"]
    return blind / markers


def _suggest_tips(design: "Design", report: dict[str, Any], *, seed: int) -> None:
    """Say why many switches cannot be read, what that costs, and what helps."""
    from phytac_design.study.advice.quick_repair import readable_switches
    from phytac_design.workflows.design_check import unreadable_fault
    from phytac_design.workflows.switch_feasibility import check_thresholds

    blind, count = report["visibility"]["switch_unreadable"], report["markers"]["count"]
    typer.echo(
        f"the tips of {blind} of {count} switches show too little more red when they are out than "
        "at rest: contacts on them are found by the markers' motion alone, from larger forces on"
    )
    say(f"looking for switches that it can read, for about {LOOK_S:g} s (Ctrl-C to stop)")
    found: list[ReadableRepair] = []
    with resumable("stopped looking"):
        try:
            with time_limit(2.0 * LOOK_S):
                found = readable_switches(
                    design, fits=check_thresholds, seed=seed, seconds=LOOK_S, progress=seldom()
                )
        except TimeLimitError:
            pass
    best = found[0] if found else None
    if best is None or best.reason:
        typer.echo(
            "  no deeper tips, and no nearer, finer or second camera that were tried help: leave "
            "the switches out (receptor.diameter_hole_mm = 0)"
        )
        return
    start = "this helps" if unreadable_fault(best.after, count) else "this repairs it"
    typer.echo(f"  {start}: {best.words} ({best.after} of {count} cannot be read then)")


def _suggest_repair(name: str, *, refused: bool, seed: int) -> None:
    """Name a change that repairs the design, if one is found soon; else point to ``advise``."""
    markers_max = 1000  # more take longer than a reader of the faults waits
    from phytac_design.design.design_file import load_design
    from phytac_design.study.advice.quick_repair import quick_repair

    design = load_design(name)
    if design.layout.wanted > markers_max:
        next_step(f"phytac advise {name} looks for changes that repair this (minutes)")
        return
    say(f"looking for a change that repairs this, for {LOOK_S:g} s at most (Ctrl-C to stop)")
    late = False
    with resumable("stopped looking"):
        try:
            with time_limit(LOOK_S):
                found = quick_repair(design, seed=seed, progress=seldom())
                words = found.words if found else ""
        except PhytacError:
            # Such as markers that cannot even be placed.
            words = ""
        except TimeLimitError:
            words, late = "", True
    if words:
        typer.echo(f"this repairs it: {words}")
    elif refused and not late:
        typer.echo("no change of one field by a few steps repairs this: correct the fields above")
    else:
        next_step(f"phytac advise {name} evaluates more changes (minutes)")
