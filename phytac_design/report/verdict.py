"""Verdict of a build: is it seen, can it be printed, cast and decoded; what to change."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, Literal, get_args

import numpy as np

from phytac_design.core.html import DASH, missing, number
from phytac_design.engine.stage import Context
from phytac_design.layout.heights_along import along_mm, middle_mm
from phytac_design.mechanics.shell.receptor_stiffness import unknown_receptors

Level = Literal["good", "odd", "bad"]
Matter = Literal["seen", "printed", "cast", "decoded"]
ANSWERS: dict[Matter, dict[Level, str]] = {
    "seen": {
        "good": "Every marker can be seen",
        "odd": "It can be seen, with limits",
        "bad": "It cannot be seen as it is",
    },
    "printed": {
        "good": "It can be printed",
        "odd": "It can be printed, with care",
        "bad": "It cannot be printed as it is",
    },
    "cast": {
        "good": "Its switches can be cast",
        "odd": "Its switches: not all is made",
        "bad": "Its switches cannot be cast",
    },
    "decoded": {
        "good": "Its forces can be decoded",
        "odd": "Its forces are decoded, with limits",
        "bad": "Its forces are not read well enough",
    },
}
WORDS: dict[Level, str] = {"good": "yes", "odd": "with limits", "bad": "no"}
ERROR_MAX = 0.1
"""A force is read well within this share of it (assumed; the paper's mean error is 2.3 %)."""
SHARE_MIN = 0.9
"""Share of the contacts anywhere that must be read well for a yes (assumed)."""
SHARE_BAD = 0.5
"""Below this share the answer is no (assumed)."""
SIMULATED = (
    "All decoder figures are in simulation: contacts are solved with a linear shell model (on "
    "other meshes than the decoder's own), projected through the camera, and given pixel noise. "
    "Large displacement, printed scatter and real frames are not in them."
)


@dataclass(frozen=True)
class Finding:
    """One line of the verdict.

    Attributes
    ----------
    matter : str
        The question that it answers.
    level : str
        ``good``; ``odd``, of which the user should know; or ``bad``, which makes the sensor fail.
    text : str
        Without a full stop at its end.
    """

    matter: Matter
    level: Level
    text: str


def findings(report: Mapping[str, Any]) -> list[Finding]:
    """Findings of a report, by matter."""
    refused = report["switch"].get("refused")
    return [
        *(
            Finding(
                "cast" if text == refused else "seen", "bad", f"built with --force though {text}"
            )
            for text in report["forced"]
        ),
        _at_rest(report),
        *_under_load(report["under_load"]),
        *_printed(report["shell"], report["fabrication"]),
        *_cast(report["switch"], report["fabrication"]),
        *_decoded(report),
    ]


def _printed(shell: Mapping[str, Any], facts: Mapping[str, Any]) -> list[Finding]:
    printer, broken = facts["print_process"], facts["print_violations"]
    out = [
        Finding("printed", "good", "the shell is one watertight body")
        if shell["watertight"]
        else Finding("printed", "bad", "the shell is NOT watertight"),
        Finding(
            "printed",
            "odd",
            f"{broken} places break the rules of the printer ({printer}): see "
            "shell/print_report.json",
        )
        if broken
        else Finding("printed", "good", f"no rule of the printer ({printer}) is broken"),
    ]
    if facts["print_unchecked"]:
        count = len(facts["print_unchecked"])
        text = f"a draft checks the shell alone against the printer: {count} other parts are not"
        out.append(Finding("printed", "odd", text))
    if facts["interference_mm3"]:
        text = f"parts of the assembly overlap by {facts['interference_mm3']:.3g} mm³"
        out.append(Finding("printed", "bad", text))
    if not missing(shell.get("step_left_out")):
        out.append(Finding("printed", "odd", f"no STEP file: {shell['step_left_out']}"))
    if not missing(shell.get("3mf_left_out")):
        out.append(Finding("printed", "odd", f"no 3MF file: {shell['3mf_left_out']}"))
    return out


def _cast(switch: Mapping[str, Any], facts: Mapping[str, Any]) -> list[Finding]:
    """Switches and their molds."""
    if not missing(switch.get("refused")):
        return []  # among the forced findings
    if not missing(switch.get("absent")):
        return [Finding("cast", "good", f"nothing to cast: {switch['absent']}")]
    out = []
    made = switch.get("switches", ())
    if made:
        each = ", ".join(
            f"{item['threshold_N']:.3g} N ({item['spread']['low_N']:.2g} to "
            f"{item['spread']['high_N']:.2g} N in a batch)"
            for item in made
        )
        families = [item["family"] for item in made if not missing(item.get("family"))]
        words = f"{' and '.join(dict.fromkeys(families))} on at" if families else "bowls snap at"
        out.append(Finding("cast", "good", f"{words} {each}"))
    mold = facts["mold"]
    if not missing(facts["mold_left_out"]):
        out.append(Finding("cast", "odd", f"no molds: {facts['mold_left_out']}"))
    elif mold.get("undercut_mm2"):
        text = f"the molds catch the switches ({mold['undercut_mm2']} mm² of undercut)"
        out.append(Finding("cast", "bad", text))
    elif not missing(mold.get("cavities")):
        text = f"the molds ({mold['cavities']} cavities) open without undercut"
        out.append(Finding("cast", "good", text))
    return out


def _decoded(report: Mapping[str, Any]) -> list[Finding]:
    out = [Finding("decoded", "odd", text) for text in report["limits"]]
    if not out:
        text = "every switch can be read, and the force on every marker"
        out = [Finding("decoded", "good", text)]
    well = report["read_well"]
    if well["contacts"]:
        where = (
            f"{100.0 * well[key]:.0f} % {words}"
            for key, words in (("middle", "at middle heights"), ("near_rims", "towards the rims"))
            if not missing(well[key])
        )
        text = (
            f"{100.0 * well['share']:.0f} % of {well['contacts']} simulated contacts anywhere on "
            f"the surface are read within {100.0 * ERROR_MAX:g} % of their force "
            f"({', '.join(where)})"
        )
        out.append(Finding("decoded", _level(well["share"]), text))
    frames = report["frames"]
    if frames["refused"]:
        text = (
            f"{frames['refused']} of {frames['frames']} rendered frames could not be decoded, the "
            f"first because {frames['first_refusal']}"
        )
        out.append(Finding("decoded", "odd", text))
    return out


def _level(share: float) -> Level:
    """Level of a share of contacts that are read well."""
    if share >= SHARE_MIN:
        return "good"
    return "odd" if share >= SHARE_BAD else "bad"


def read_well(context: Context, estimator: str) -> dict[str, Any]:
    """Share of the held-out contacts anywhere whose force an estimator reads within ``ERROR_MAX``.

    Of contacts that tripped a switch; also apart for middle heights and the rest, where None means
    that there are none.
    """
    twin, surface = context.arrays("twin"), context.surface
    tripped, force_N = twin["anywhere.tripped"], twin["anywhere.force_N"]
    decoded_N = context.arrays("decoder")[f"anywhere.{estimator}"]
    height = along_mm(surface, twin["anywhere.uv"])[tripped]
    well = (np.abs(decoded_N - force_N) <= ERROR_MAX * force_N)[tripped]
    low, high = middle_mm(surface)
    middle = (height >= low) & (height <= high)
    groups = {"share": np.ones_like(middle), "middle": middle, "near_rims": ~middle}
    shares = {key: float(well[own].mean()) if own.any() else None for key, own in groups.items()}
    return {"error_max": ERROR_MAX, "contacts": len(well), **shares}


def _at_rest(report: Mapping[str, Any]) -> Finding:
    seen, cameras = report["visibility"], len(report["cameras"])
    if seen["occluded"] or seen["fused"]:
        text = (
            f"at rest {seen['occluded']} markers are hidden and {seen['fused']} fuse with another "
            "of their colour: see Camera"
        )
        return Finding("seen", "bad", text)
    by = f", each by one of {cameras} cameras" if cameras > 1 else ""
    return Finding("seen", "good", f"at rest every marker is seen and distinguished{by}")


def _under_load(load: Mapping[str, Any]) -> list[Finding]:
    if missing(load["first_force_N"]):
        text = (
            f"pressed with up to {load['force_N']:g} N at {load['presses']} places, one at a time, "
            "no marker hides or fuses"
        )
        out = [Finding("seen", "good" if load["presses"] else "odd", text)]
    else:
        text = (
            f"under load a marker hides or fuses from {number(float(load['first_force_N']))} N on: "
            f"marker {load['first_marker']}, pressed {load['first_place']} (tried up to "
            f"{load['force_N']:g} N)"
        )
        out = [Finding("seen", "odd", text)]
    if load.get("not_solved"):
        text = f"{load['not_solved']} presses could not be solved"
        why = load.get("why")
        out.append(Finding("seen", "odd", text if missing(why) else f"{text}: {why}"))
    return out


def sentence(text: str) -> str:
    """Text with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def worst(found: list[Finding]) -> Level:
    """Level of the whole."""
    return max((item.level for item in found), key=get_args(Level).index, default="good")


def percent(score: Mapping[str, Any]) -> str:
    """Relative error of a score as text; a dash without evaluated contacts."""
    error = score["relative_error"]
    return DASH if missing(error) else f"{100.0 * error:.1f} %"


def decoded(report: Mapping[str, Any]) -> str:
    """How well the build's own test contacts were decoded, without a full stop."""
    best = best_of(report)
    frames, points = report["decoder_frames"][best], report["decoder"][best]
    if not points["samples"]:
        return "No simulated contact tripped a switch, so none could be decoded"
    bent = any(text.startswith("linear-tables") for text in report["limits"])
    return (
        f"Simulated contacts are decoded with a relative error of {percent(points)} and an "
        f"absolute error of {points['mae_N']:.2f} N (means of {points['samples']} held-out ones "
        f"in linear theory), in rendered frames of {percent(frames)} ({frames['samples']}), by the "
        f"estimator {best}"
        + bent
        * "; this wall is not linear, and a real one is decoded worse (linear-tables)"
    )


def lead(report: Mapping[str, Any]) -> str:
    """Verdict at the top of the page, as HTML: four answers, and what to change."""
    found = findings(report)
    markers = report["markers"]
    answers = "".join(
        answer(matter, [item for item in found if item.matter == matter])
        for matter in get_args(Matter)
    )
    return (
        f"<p>{escape(report['description'])}</p>"
        f'<div class="verdict {worst(found)}"><p>{markers["count"]} markers, '
        f"{markers['density_per_cm2']:.2f} per cm² of a surface {escape(markers['surface_class'])} "
        f"to the optical axis. {decoded(report)}.</p></div>"
        f'<div class="answers">{answers}</div>{change_list(report.get("changes", []))}'
        f'<p class="note">{SIMULATED}</p>'
    )


def best_of(report: Mapping[str, Any]) -> str:
    """Name of the report's main estimator."""
    return "auto" if "auto" in report["decoder"] else "koi_inverse"


def answer(matter: Matter, found: list[Finding]) -> str:
    """One of the four answers, as HTML."""
    level = worst(found)
    lines = "".join(
        f'<li class="{item.level}">{escape(sentence(item.text))}</li>' for item in found
    )
    return (
        f'<div class="verdict {level}"><h2>{matter.capitalize()}? {WORDS[level]}</h2>'
        f"<p>{ANSWERS[matter][level]}.</p><ul>{lines}</ul></div>"
    )


def change_list(texts: Sequence[str]) -> str:
    """What to change, as HTML."""
    if not texts:
        return "<p><strong>To change:</strong> nothing that these checks find.</p>"
    lines = "".join(f"<li>{escape(sentence(text))}</li>" for text in texts)
    return f'<div class="change"><strong>To change or to mind:</strong><ul>{lines}</ul></div>'


def changes_of(context: Context, reasons: Sequence[str], well: Mapping[str, Any]) -> list[str]:
    """Sentences without a full stop, each a problem and its remedy.

    Parameters
    ----------
    reasons : list of str
        Why stages would stop a build that is not forced.
    well : dict
        Of :func:`read_well`.
    """
    return [
        *reasons,
        *_load_remedy(context.facts("underload"), reasons),
        *_stiff_remedy(context.facts("underload"), well),
        *_print_remedies(context.facts("printing")),
        *_switch_warnings(context.facts("switch")),
        *_unreadable(context),
        *_left_out(context),
    ]


def _left_out(context: Context) -> list[str]:
    """What a build leaves out: STEP, hardware that does not fit, the stiffness of receptors."""
    out = []
    design = context.design
    tools = ["documents for the workshop"]
    if not context.facts("switch").get("absent") and not context.facts("switch")["refused"]:
        tools = ["molds", "calibration kit", *tools]
    if design.receptor.has_inserts:
        tools = ["inserts", *tools]
    if design.layout.kind == "spiral":
        tools = [*tools, "comparison with straight rows"]
    absent = {"step": "STEP files", "tools": ", ".join(tools)}
    without = {name: what for name, what in absent.items() if not getattr(context.accuracy, name)}
    if without:
        sets = " ".join(f"--set {name}=true" for name in without)
        out.append(
            f"these are quick settings, without {', '.join(without.values())}: build with "
            f"--accuracy standard, or {sets}"
        )
    why = context.facts("hardware").get("hardware_left_out", "")
    if why and design.hardware.parts == "all" and not context.facts("switch")["refused"]:
        out.append(f"the build has no mount, light ring and other hardware: {why}")
    if context.accuracy.receptors and (why := unknown_receptors(design)):
        out.append(
            f"the wall is computed without its receptors: {why.partition(';')[0]}; change "
            "receptor.diameter_outer_mm or wall.thickness_mm"
        )
    return out


def _load_remedy(load: Mapping[str, Any], reasons: Sequence[str]) -> list[str]:
    """Remedy for a marker that is lost under load, unless the design's demand names it already."""
    first = load["first_force_N"]
    if first is None or any("under load" in reason for reason in reasons):
        return []
    text = (
        f"from {first:.3g} N on a marker hides or fuses: space the markers wider, use more pixels "
        "or a thicker wall, or keep below that force (demands.clear_force_N makes a build insist)"
    )
    return [text]


def _stiff_remedy(load: Mapping[str, Any], well: Mapping[str, Any]) -> list[str]:
    """Remedy for a wall that moves too little for its camera."""
    share = well["share"]
    if share is None or share >= SHARE_BAD:
        return []
    text = (
        f"only {100.0 * share:.0f} % of the contacts are read within {100.0 * ERROR_MAX:g} % of "
        f"their force: {load['force_N']:g} N moves no marker's image by more than "
        f"{load['greatest_shift_px']:.2g} px. Take a thinner wall (wall.thickness_mm), a softer "
        "material (material.modulus_MPa), or a camera with more pixels across it; phytac advise "
        "evaluates such changes"
    )
    return [text]


def _print_remedies(facts: Mapping[str, Any]) -> list[str]:
    """Print rules that are broken, those with the same remedy together."""
    found: Counter[tuple[str, str, str]] = Counter()
    first: dict[tuple[str, str, str], Mapping[str, Any]] = {}
    for file, part in facts["files"].items():
        for item in part["violations"]:
            # Figures differ from place to place, words do not.
            key = (file, item["rule"], re.sub(r"[-+.\d]*\d", "", item["fix"]))
            found[key] += 1
            first.setdefault(key, item)
    out, shown = [], 6
    for key, count in found.most_common(shown):
        file, rule, _ = key
        item = first[key]
        where = f"1 place of {file} breaks" if count == 1 else f"{count} places of {file} break"
        out.append(
            f"{where} the print rule {rule} (such as {item['measured']:.3g} {item['unit']}, "
            f"required {item['asked']:.3g} {item['unit']}): {item['fix']}"
        )
    if len(found) > shown:
        out.append(f"{len(found) - shown} more kinds are in shell/print_report.json")
    return out


def _unreadable(context: Context) -> list[str]:
    """Switches that the camera cannot read."""
    seen = context.facts("views")["visibility"]
    count = int(seen.get("switch_unreadable", 0))
    if not count or not context.design.has_switches:
        return []
    text = (
        f"the camera cannot read {count} of {context.markers.count} switches: their tips show too "
        "little more red when they are out than at rest; let tips rest deeper and move farther "
        "(switch.tip_recess_mm, switch.stroke_mm), or move the camera nearer "
        "(camera.stand_off_mm); phytac check refuses such a design if they are many"
    )
    return [text]


def _switch_warnings(facts: Mapping[str, Any]) -> list[str]:
    """Warnings before casting, each once; the page lists assumptions separately."""
    warnings = dict.fromkeys(
        text
        for item in facts.get("switches", ())
        for text in item.get("warnings", ())
        if not text.startswith("assumed")
    )
    return list(warnings)
