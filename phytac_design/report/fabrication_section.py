"""Section on fabrication: parts, molds, fixtures, print rules, and links to the documents."""

from collections.abc import Mapping
from html import escape
from typing import Any

from phytac_design.core import html as page
from phytac_design.engine.stage import EXPORT, Context
from phytac_design.fabrication.effort.effort import OPERATIONS, PARTS, on_strips
from phytac_design.report import figure_names
from phytac_design.report.verdict import sentence


def fabrication_facts(facts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Entry of ``report.json`` on fabrication, from the facts of its stages."""
    mold, hardware, printing = facts["mold"], facts["hardware"], facts["printing"]
    bench, kit = facts["bench"], facts["kit"]
    return {
        "mass_g": bench.get("mass_g", {}),
        "poured_mm3": mold.get("poured_mm3", {}),
        "mold": {
            key: mold.get(key)
            for key in (
                "way",
                "cavities",
                "volume_error",
                "hausdorff_mm",
                "least_draft_deg",
                "undercut_mm2",
                "shared_mm3",
            )
        },
        **({"strips": mold["strips"]} if "strips" in mold else {}),
        "interference_mm3": (hardware.get("interference") or {}).get("shared_mm3"),
        "light_leaks": (hardware.get("light") or {}).get("leaks"),
        "screws": hardware.get("joints", []),
        "insert_fits_mm": facts["inserts"].get("fits_mm", {}),
        "hardware_left_out": _left_out(hardware),
        "mold_left_out": mold.get("left_out", ""),
        "print_process": printing["process"],
        "print_violations": printing["violations"],
        "print_unchecked": printing.get("unchecked", []),
        "pieces": len(printing["pieces"]),
        "regions_to_calibrate": kit.get("regions"),
    }


def _left_out(hardware: Mapping[str, Any]) -> str:
    reasons = [str(hardware.get("hardware_left_out") or "")]
    reasons += [f"{name}: {why}" for name, why in (hardware.get("left_out") or {}).items()]
    return "; ".join(reason for reason in reasons if reason)


def print_rules(context: Context) -> str:
    """The shell as it would be printed, how to stand it, and every broken rule, as HTML."""
    printed = context.facts("printing")
    shell = printed["files"]["shell/shell.stl"]
    drawn = context.folders["printing"] / EXPORT / "shell" / "print_report.svg"
    standing = shell["orientation"]
    keys = ("rule", "measured", "asked", "unit", "point_mm", "fix")
    broken = [
        (file, *(item[key] for key in keys))
        for file, part in printed["files"].items()
        for item in part["violations"]
    ]
    head = ("file", "rule", "measured", "asked", "unit", "place (mm)", "what to change")
    rows_max = 40
    listed = page.table(head, broken[:rows_max]) if broken else "<p>No print rule is broken.</p>"
    if len(broken) > rows_max:
        listed += (
            f'<p class="foot">{rows_max} of {len(broken)}; shell/print_report.json has all.</p>'
        )
    text = (
        f"<p>Rules of {escape(str(printed['process']))}; this way up (a direction in the sensor's "
        f"frame): {page.number(standing['up'])}, {page.number(standing['height_mm'])} mm high, "
        f"{page.number(standing['support_volume_mm3'])} mm³ of supports.</p>"
    )
    picture = drawn.read_text(encoding="utf-8") if drawn.is_file() else ""
    shown = page.svg_figure(picture, "The shell as printed, with broken rules") if picture else ""
    rules = figure_names.facts(page.flatten(printed["rules"], "rules."))
    return f"<h3>Print rules</h3>{text}{shown}{listed}" + page.details("All rules", rules)


def effort_tables(effort: Mapping[str, Any]) -> str:
    """Parts, hand work and material side by side, as HTML."""
    materials = {
        "shell": "shell, resin",
        "inserts": "inserts and their sprues, resin",
        "molds": "molds, resin",
        "silicone": "silicone",
        "rubber": "rubber, with what runs over",
    }
    parts = [(PARTS[name], count) for name, count in effort["parts"].items() if count]
    hours = [(OPERATIONS[name], hour) for name, hour in effort["hours"].items() if hour]
    masses = [
        (name, effort["mass_g"][key]) for key, name in materials.items() if effort["mass_g"][key]
    ]
    words = [f"{effort['receptor_ends']} receptor ends are painted by hand"]
    if effort["inserts"]:
        sprues = effort["parts"]["sprues"]
        words = [f"{effort['inserts']} coloured inserts on {sprues} sprues are pushed in"]
    if effort["switches"]:
        words.append(
            f"{effort['switches']} switches are cast, trimmed, painted and glued"
            f"{on_strips(effort)} (stem lengths: {effort['stem_lengths']}, castings: "
            f"{effort['castings']})"
        )
    if effort["price"] is not None:
        words.append(f"price at the design's prices: {effort['price']:.2f}")
    return (
        f"<h3>Parts and hand work</h3><p>{escape(sentence('; '.join(words)))}</p>"
        + page.side_by_side(
            page.table(("parts", "count"), [*parts, ("all", effort["parts_handled"])]),
            page.table(("hand work", "h"), [*hours, ("all", effort["hours_total"])]),
            page.table(("material", "g"), masses),
        )
        + f"<p>Tools: {escape(', '.join(effort['tools']))}.</p>"
        '<p class="foot">Estimated from the design alone, with the times of its table [effort]; '
        "printing and curing take no hands and are not counted. The calibration kit is not among "
        "the parts, and the printed hardware not in the material.</p>"
    )


def fabrication_section(context: Context, report: Mapping[str, Any]) -> str:
    """HTML of the section."""
    facts = report["fabrication"]
    files = {
        "bench/assembly.html": "assembly sheet",
        "bench/paint_map.pdf": "paint map, 1:1",
        "bench/switch_placement.csv": "which switch goes where",
        "inserts/placement.csv": "which insert goes where",
        "bench/bill_of_materials.csv": "bill of materials",
        "bench/casting.md": "casting recipe",
        "shell/print_report.svg": "print report",
        "kit/README.md": "calibration kit",
    }
    stages = {"bench": "bench", "shell": "printing", "kit": "kit", "inserts": "inserts"}
    documents = ", ".join(
        f'<a href="../{path}">{name}</a>'
        for path, name in files.items()
        if (context.folders[stages[path.partition("/")[0]]] / EXPORT / path).is_file()
    )
    joints = [
        (item["joint"], item["screw"], item["count"], item["head_part"], item["thread_part"])
        for item in facts["screws"]
    ]
    out = effort_tables(facts["effort"]) + f"<p>Documents for the workshop: {documents}.</p>"
    for key in ("hardware_left_out", "mold_left_out"):
        if facts[key]:
            out += f'<p class="foot">{escape(sentence("left out: " + facts[key]))}</p>'
    if facts["print_unchecked"]:
        names = ", ".join(facts["print_unchecked"])
        out += f'<p class="foot">{escape("Not held against the print rules: " + names)}.</p>'
    if joints:
        out += page.table(("joint", "screw", "count", "head in", "thread in"), joints)
    plain = {
        key: value
        for key, value in facts.items()
        if key not in ("screws", "print_unchecked", "effort")
    }
    return out + figure_names.facts(plain, "fabrication") + print_rules(context)
