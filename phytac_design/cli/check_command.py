"""``phytac check``: rules, visibility and density of a design."""

from typing import Any

import typer

from phytac_design.cli.options import DesignArgument, JsonOption, SeedOption, say
from phytac_design.cli.output import print_json
from phytac_shapes.errors import DesignError


def check(design: DesignArgument, seed: SeedOption = 0, as_json: JsonOption = False) -> None:
    """Check rules, visibility and density alone: no solid, no mesh."""
    from phytac_design.design.design_file import load_design
    from phytac_design.rules.design_review import checkup

    report = checkup(load_design(design), seed=seed)
    if as_json:
        print_json(report)
    else:
        _print_check(report)
    for warning in report["warnings"]:
        say(f"warning: {warning}")
    if not report["clear"]:
        raise typer.Exit(DesignError.exit_code)


def _print_check(report: dict[str, Any]) -> None:
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
            f"field of view {across:.0f}° x {down:.0f}°; markers {nearest:.0f} to {farthest:.0f} "
            "mm from the camera"
        )
        typer.echo(
            f"camera {camera['stand_off_mm']:.2f} mm before the {camera['end']} rim; a px is "
            f"{lens['median_mm_per_px_axial']:.3g} mm along the sensor, "
            f"{lens['median_mm_per_px_circumferential']:.3g} mm around it; sharp from "
            f"{lens['depth_near_mm']:.1f} to {lens['depth_far_mm']:.1f} mm, blur up to "
            f"{lens['max_blur_px']:.2g} px"
        )
    for key, value in seen.items():
        typer.echo(f"  {key:26s} {value:g}")
    verdict = (
        "every marker is visible and can be distinguished" if report["clear"] else report["advice"]
    )
    blind = report["visibility"].get("switch_unreadable", 0)
    if blind:
        verdict += f"; {blind} switches cannot be read"
    typer.echo(f"{verdict} ({report['seconds']:.1f} s)")
