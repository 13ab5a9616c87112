"""What the page says first: is the sensor seen, readable and printable, and how well it decodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from typing import Any, Literal

from phytac_design.report.page import DASH, missing, number

Level = Literal["good", "odd", "bad"]
LEVELS: tuple[Level, ...] = ("good", "odd", "bad")
SIMULATED = (
    "All decoder figures are in simulation: contacts are solved with a linear shell model (on a "
    "finer mesh than the decoder's own), projected through the camera, and given pixel noise. "
    "Large displacement, printed scatter and real frames are not in them."
)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One line of the verdict.

    Attributes
    ----------
    level : str
        ``good``; ``odd``, of which the user should know; or ``bad``, which makes the sensor fail.
    text : str
        Without a full stop at its end.
    """

    level: Level
    text: str


def findings(report: Mapping[str, Any]) -> list[Finding]:
    """What holds and what does not, most serious things first within each matter."""
    out = [
        Finding(level="bad", text=f"built with --force though {text}") for text in report["forced"]
    ]
    out.append(_at_rest(report))
    out.extend(_under_load(report["under_load"]))
    out.extend(_readable(report))
    shell = report["shell"]
    if shell["watertight"]:
        out.append(Finding(level="good", text="the shell is one watertight body"))
    else:
        out.append(Finding(level="bad", text="the shell is NOT watertight"))
    if not missing(shell.get("step_left_out")):
        out.append(Finding(level="odd", text=f"no STEP file: {shell['step_left_out']}"))
    out.extend(_made(report["fabrication"]))
    frames = report["frames"]
    if frames["refused"]:
        said = (
            f"{frames['refused']} of {frames['frames']} rendered frames could not be decoded, the "
            f"first because {frames['first_refusal']}"
        )
        out.append(Finding(level="odd", text=said))
    return out


def _at_rest(report: Mapping[str, Any]) -> Finding:
    seen, eyes = report["visibility"], len(report["cameras"])
    if seen["occluded"] or seen["fused"]:
        text = (
            f"at rest {seen['occluded']} markers are hidden and {seen['fused']} fuse with another "
            "of their colour: see Camera"
        )
        return Finding(level="bad", text=text)
    by = f", each by one of {eyes} cameras" if eyes > 1 else ""
    return Finding(level="good", text=f"at rest every marker is seen and told apart{by}")


def _under_load(load: Mapping[str, Any]) -> list[Finding]:
    out = []
    tried = (
        f"pressed with up to {load['force_N']:g} N at {load['presses']} places, one at a time, "
        "no marker hides or fuses"
    )
    if missing(load["first_force_N"]):
        level: Level = "good" if load["presses"] else "odd"
        out.append(Finding(level=level, text=tried))
    else:
        text = (
            f"under load a marker hides or fuses from {number(float(load['first_force_N']))} N on: "
            f"marker {load['first_marker']}, pressed {load['first_place']} (tried up to "
            f"{load['force_N']:g} N)"
        )
        out.append(Finding(level="odd", text=text))
    if load.get("not_solved"):
        text = f"{load['not_solved']} presses could not be solved"
        why = load.get("why")
        out.append(Finding(level="odd", text=text if missing(why) else f"{text}: {why}"))
    return out


def _readable(report: Mapping[str, Any]) -> list[Finding]:
    limits = report["limits"]
    if limits:
        return [Finding(level="odd", text=text) for text in limits]
    text = "every switch can be read, and the force on every marker"
    return [Finding(level="good", text=text)]


def _made(facts: Mapping[str, Any]) -> list[Finding]:
    """What the printer and the bench would find."""
    out = []
    if facts["print_violations"]:
        text = (
            f"{facts['print_violations']} places break the rules of the printer "
            f"({facts['print_process']}): see shell/print_report.json"
        )
        out.append(Finding(level="odd", text=text))
    if facts["interference_mm3"]:
        text = f"parts of the assembly overlap by {facts['interference_mm3']:.3g} mm³"
        out.append(Finding(level="bad", text=text))
    return out


def sentence(text: str) -> str:
    """Text with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def worst(found: list[Finding]) -> Level:
    """Level of the whole."""
    return LEVELS[max((LEVELS.index(item.level) for item in found), default=0)]


def percent(score: Mapping[str, Any]) -> str:
    """Relative error of a score as text; a dash if no contact was judged."""
    error = score["relative_error"]
    return DASH if missing(error) else f"{100.0 * error:.1f} %"


def lead(report: Mapping[str, Any]) -> str:
    """Verdict at the top of the page, as HTML."""
    found = findings(report)
    markers = report["markers"]
    best = "auto" if "auto" in report["decoder"] else "koi_inverse"
    frames, points = report["decoder_frames"][best], report["decoder"][best]
    lines = "".join(
        f'<li class="{item.level}">{escape(sentence(item.text))}</li>' for item in found
    )
    decoded = (
        f"Simulated contacts decode to {percent(points)} and {points['mae_N']:.2f} N (mean "
        f"errors of {points['samples']} held-out ones), through rendered frames to "
        f"{percent(frames)} ({frames['samples']}), by the estimator {best}"
        if points["samples"]
        else "No simulated contact tripped a switch, so none could be decoded"
    )
    return (
        f"<p>{escape(report['description'])}</p>"
        f'<div class="verdict {worst(found)}"><p>{markers["count"]} markers, '
        f"{markers['density_per_cm2']:.2f} per cm² of a surface {escape(markers['surface_class'])} "
        f"to the optical axis. {decoded}.</p><ul>{lines}</ul></div>"
        f'<p class="note">{SIMULATED}</p>'
    )
