"""README of the calibration rig: purpose of each piece, machine frame, log format."""

from phytac_design.design.spec import Design
from phytac_design.fabrication.calibration_rig.program import Program
from phytac_design.fabrication.calibration_rig.regions import Regions
from phytac_design.fabrication.calibration_rig.tool_bodies import CalibrationKit
from phytac_design.layout import Markers


def _named(markers: Markers, ids: tuple[int, ...]) -> str:
    shown = 12
    names = [markers.name(k) for k in ids[:shown]]
    more = f" … {len(ids)} in all" if len(ids) > shown else ""
    return ", ".join(names) + more


def guide_text(
    design: Design, markers: Markers, regions: Regions, program: Program, kit: CalibrationKit
) -> str:
    """Markdown page."""
    symmetry = regions.symmetry
    rows = [
        f"| {piece.name}.stl | {piece.count} | {piece.note} | {_named(markers, piece.markers)} |"
        for piece in kit.pieces
    ]
    forces = ", ".join(f"{force:.3g}" for force in program.force_N)
    travels = ", ".join(f"{travel:.3g}" for travel in program.displacement_mm)
    near = (
        f" {len(regions.too_near)} stand too near a rim, or on too sharp an edge, for any indenter "
        "and are left out."
        if len(regions.too_near)
        else ""
    )
    first = list(zip(program.marker.tolist(), program.radius_mm.tolist(), strict=True))[:1]
    lines = [
        f"# {design.name}: calibration kit",
        "",
        (
            f"{len(regions.marker)} of {markers.count} regions are pressed: {symmetry.turns} "
            f"turns and {symmetry.mirrors} mirrors map the markers (place, height, paint) and "
            f"the surface onto themselves, so that the others are like them.{near}"
        ),
        "",
        "| piece | count | for | regions |",
        "|---|---|---|---|",
        *rows,
        *(f"| {name} | 0 | left out: {why} | |" for name, why in kit.left_out.items()),
        "",
        (
            "The notch of an indenter's flange points along u (away from the camera; on a sheet "
            "along its u side). Indenters fit the bare wall; above a switch they press its bowl "
            "flat first."
        ),
        "",
        "## Machine",
        "",
        (
            "The sensor turns by C about its own axis and tips by B about y; the tool comes "
            "along -X: machine = Ry(B) Rz(C) sensor, origin in the middle of the near rim. X Y Z "
            "is the middle of the tool's face; A turns the tool until its notch points along u, "
            "(0, sin A, cos A): by hand where the rig has no such axis. At X = "
            f"{program.safe_mm:g} mm the sensor may turn."
        ),
        "",
        (
            f"- `shell.gcode`, without switches: travels of {travels} mm past the touch, in the "
            "linear range; M101 logs. Read it with `phytac calibrate`, with --fix thickness "
            "unless the camera's displacements are added."
        ),
        (
            f"- `decoder.gcode`, with switches: stops {program.bowl_mm:.2f} mm above the wall, "
            f"before the bowls; forces of {forces} N: M100 presses on to P newtons, holds, and "
            "logs. Mount and connector are on then, so that a collar or plate on a rim serves the "
            "shell's run only: hold the sensor by its mount."
        ),
        "- `program.csv`: every step of both, with the place and normal in the sensor's frame.",
        "",
        "## Log",
        "",
        (
            "Append to `calibration_log.csv`. For every step a comment line with the step (Q), "
            "the camera's frame and the time, then a line with the region, the face's radius, "
            "the load cell's force and the travel since the touch; with gripper_three three lines:"
        ),
        "",
        "```",
        "# step 17, frame 203, 41.250 s",
        *(f"{marker},{radius:g},0.52,0.0171" for marker, radius in first),
        "```",
    ]
    return "\n".join(lines) + "\n"
