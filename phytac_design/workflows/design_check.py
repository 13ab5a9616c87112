"""Verdict on a design, the same for ``phytac check``, ``phytac advise`` and the studio."""

from collections.abc import Callable
from typing import Any

from phytac_design.design.spec import Design
from phytac_design.mechanics.pressing.contact_patch import parse_contact_patch
from phytac_design.mechanics.pressing.press import press
from phytac_design.mechanics.shell.receptor_stiffness import unknown_receptors
from phytac_design.rules.check import check_design
from phytac_design.rules.design_review import checkup
from phytac_design.simulation.scenario.linear_error import NEARLY_LINEAR, linear_error
from phytac_design.simulation.switch_law import chosen_switches
from phytac_design.workflows.switch_feasibility import check_thresholds
from phytac_shapes.errors import DesignError, NumericalError

UNREADABLE_SHARE_MAX = 0.25
"""A design passes with up to this share of switches that the camera cannot read: shipped designs
have up to 10 % of them (``patch``), on which contacts are found by the markers' motion alone."""


def full_check(
    design: Design, *, seed: int = 0, progress: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Report of the check, with the faults of the switches.

    Returns
    -------
    dict
        As :func:`~phytac_design.rules.design_review.checkup`; ``visible`` says whether every marker
        is, ``faults`` lists code and text of each fault of the switches, if there are some, and
        ``clear`` is false then. ``switches`` has the family, rubber and spread of each threshold,
        and why, where the design's family is not the bowl.

    Raises
    ------
    DesignError
        If the design cannot be printed or seen at all.
    """
    report = checkup(design, seed=seed, progress=progress)
    report["visible"] = report["clear"]
    report["warnings"] += snapping_words(design, progress=progress)
    blind = report["visibility"].get("switch_unreadable", 0)
    faults = [
        {"code": fault.code, "text": str(fault)}
        for fault in (
            unreadable_fault(blind, report["markers"]["count"]),
            threshold_fault(design, progress=progress),
        )
        if fault
    ]
    if faults:
        return report | {"clear": False, "faults": faults}
    if design.has_switches and design.switch.family != "bowl":
        report["switches"] = [
            {
                "threshold_N": made["threshold_N"],
                "family": made["family"],
                "rubber": made["rubber"]["name"],
                "band": made["spread"]["band"],
                "choice": made["choice"],
            }
            for made in chosen_switches(design, progress)
        ]
    return report


def snapping_words(
    design: Design, *, progress: Callable[[str], None] = lambda _: None
) -> list[str]:
    """Warning of a shell that snaps under a press of its largest force in the middle; none else.

    Pressed with large displacements on a coarse mesh, where linear theory is far off.
    """
    sensor, force_N = check_design(design), design.training.force_max_N
    try:
        if linear_error(sensor, None) <= NEARLY_LINEAR:
            return []
        progress("pressing the shell with its largest force")
        place = parse_contact_patch(
            sensor, force_N=force_N, radius_mm=design.training.patch_radius_min_mm
        )
        result = press(sensor, place, refine=2, receptors=not unknown_receptors(design))
    except NumericalError as error:
        # Without details in brackets, and what to do.
        why = str(error).partition(" (")[0].partition(";")[0]
    else:
        if not result.jumped and result.stable is not False:
            return []
        why = "it snaps, or may snap, before that"
    text = (
        f"the shell does not bear its largest force of {force_N:g} N in the middle: {why}; take a "
        "thicker wall (wall.thickness_mm), a stiffer material (material.modulus_MPa), or a smaller "
        "training.force_max_N"
    )
    return [text]


def unreadable_fault(unreadable: int, switches: int) -> DesignError | None:
    """Error of a design with too many switches that the camera cannot read, if it is one."""
    if unreadable <= UNREADABLE_SHARE_MAX * switches:
        return None
    return DesignError(
        "switch-unreadable",
        f"the camera cannot read {unreadable} of {switches} switches, and at most "
        f"{UNREADABLE_SHARE_MAX:.0%} may be unreadable: their tips show too little more red when "
        "they are out than at rest; let tips rest deeper and move farther (switch.tip_recess_mm, "
        "switch.stroke_mm), move the camera nearer (camera.stand_off_mm), take one with more "
        "pixels, or leave the switches out (receptor.diameter_hole_mm = 0)",
    )


def threshold_fault(
    design: Design, *, progress: Callable[[str], None] = lambda _: None
) -> DesignError | None:
    """Error of thresholds that no bowl has, if there are some."""
    try:
        check_thresholds(design, progress=progress)
    except DesignError as error:
        return error
    return None
