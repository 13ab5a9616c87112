"""The assembly sheet: one page that opens from disk, steps in order, with counts and pictures."""

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from phytac_design.core.html import figure, page, svg_figure, table
from phytac_design.design.shell_materials import shell_words
from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.bill_of_materials import shell_file
from phytac_design.fabrication.documents.recipe import Recipe, parts_g
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.fabrication.switch_strips import StripSet, strip_label


def switch_table(switches: SwitchSet) -> str:
    """HTML table of the kinds of switches: label, family, threshold, length, count.

    Bowls alone need no column that says so.
    """
    named = switches.body != "bowl"
    rows = [
        (
            switches.label(kind),
            *([switches.family(kind[0])] if named else []),
            float(switches.threshold_N[kind[0]]),
            float(switches.lengths_mm[kind[1]]),
            len(switches.markers_of(kind)),
        )
        for kind in switches.kinds
    ]
    family = ["family"] if named else []
    return table(["switch", *family, "threshold (N)", "length (mm)", "count"], rows)


def strip_table(strips: StripSet) -> str:
    """HTML table of the different strips: label, switches, lengths, how many."""
    rows = []
    for number in strips.numbers:
        alike = strips.alike(number)
        length = strips.switches.lengths_mm[strips.switches.length[alike[0].markers]]
        rows.append(
            (
                strip_label(number),
                alike[0].count,
                float(length.min()),
                float(length.max()),
                len(alike),
            )
        )
    head = ["strip", "switches", "shortest (mm)", "longest (mm)", "count"]
    return table(head, rows)


def bill_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """HTML table of the bill of materials."""
    head = ["part", "count", "material", "volume (mm³)", "mass (g)", "file or note"]
    body = [
        (
            row["part"],
            row["count"],
            row["material"],
            row["volume_mm3"] or None,
            row["mass_g"] if row["volume_mm3"] else None,
            row["file"] or row["note"],
        )
        for row in rows
    ]
    return table(head, body)


def colouring_steps(design: Design, count: int) -> list[str]:
    """Steps in which ``count`` receptors get their colours."""
    receptor = design.receptor
    colours = " and ".join(dict.fromkeys(design.layout.colours))
    if receptor.colouring == "multi-material":
        return [f"End faces and bands come out of the printer {colours}; nothing is painted."]
    if receptor.has_inserts:
        return [
            (
                f"Print inserts/*.stl in {colours} resin, bars on the bed; wash, look through "
                "every insert, and cure."
            ),
            (
                "Sort the sprues by their labels. bench/paint_map.pdf, seen from outside and "
                "wrapped around the shell, has each label beside the receptor that its first "
                "insert goes into; inserts/placement.csv lists all."
            ),
            (
                "Push the inserts in from outside until every head lies in its seat: those of "
                'sprues marked "together" in the list at once, those marked "wrapped" one after '
                "another from the label on while the bar bends around the shell, those marked "
                '"single" one by one, each broken off the bar first.'
            ),
            (
                "Cut the necks flush with a flush cutter, take the bar off, put a drop of clear "
                "resin on each head, wipe the outer face and cure it. Neither resin nor leftover "
                "necks may stay in the holes or under the bowls."
            ),
            "Take a photo and run `phytac inspect --step painted`: it names missing inserts.",
        ]
    return [
        (
            f"Paint {count} receptors {colours} as bench/paint_map.pdf shows: end face and last "
            f"{receptor.band_marker_mm:g} mm of the side. The pages seen from inside are "
            "for the pen; the pages seen from outside are wrapped around the shell to check."
        ),
        "Or print shell/shell.3mf in several materials: then nothing is painted.",
    ]


def _listed(items: Sequence[str]) -> str:
    # Steps quote commands as messages do, between backticks.
    texts = [re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(item)) for item in items]
    return "<ol>" + "".join(f"<li>{text}</li>" for text in texts) + "</ol>"


def assembly_html(
    design: Design,
    switches: SwitchSet,
    recipe: Recipe | None,
    *,
    count: int,
    bill: Sequence[Mapping[str, Any]],
    steps: Sequence[str],
    fixture_steps: Sequence[str],
    pictures: Mapping[str, bytes],
    section: str,
    strips: StripSet | None = None,
    flat: str = "",
) -> str:
    """HTML of the sheet.

    Parameters
    ----------
    recipe : Recipe or None
        None for a sensor without switches: it has neither their sections nor a calibration kit.
    count : int
        Receptors.
    bill : sequence of mappings
        Rows of the bill of materials.
    steps : sequence of str
        Steps of casting.
    fixture_steps : sequence of str
        Steps of mounting the sensor's fixtures.
    pictures : mapping
        Caption to PNG.
    section : str
        SVG of a section through a receptor.
    strips : StripSet, optional
        The strips, where switches are cast on some.
    flat : str
        SVG of the different strips, as cast.
    """
    shell = [
        (
            f"Print {shell_file(design)} in {shell_words(design.material.modulus_MPa)} as "
            "shell/print_report.svg shows, or its pieces and glue them on their keys; wash and "
            "cure resin"
            f"{'; look through every hole' if recipe else ''}."
        ),
        *colouring_steps(design, count),
    ]
    lead = f'<p class="foot">{escape(design.description)}</p>'
    shown = "".join(figure(data, caption) for caption, data in pictures.items())
    title, pulled = f"{design.name}: assembly", [("Pulled apart", shown)] if shown else []
    if recipe is None:
        sections = [
            *pulled,
            ("1 Shell", _listed(shell)),
            ("2 Camera, light, connectors", _listed(fixture_steps)),
            ("Bill of materials", bill_table(bill)),
        ]
        return page(title, sections, lead)
    shell.append(
        "Before the switches are glued: run kit/shell.gcode and fit the wall with "
        "`phytac calibrate` (kit/README.md)."
    )
    place = [
        (
            f"Put {count} switches in, sorted by label: bench/switch_placement.csv, or the label "
            "below each marker on the paint map."
        ),
        (
            f"Push the stem through from outside until the {switches.body}'s rim lies on the outer "
            "face; glue "
            "the rim with a thin ring of cyanoacrylate, none in the hole."
        ),
        (
            f"The red tip ends {design.switch.tip_recess_mm:g} mm behind the receptor's end face: "
            "look from the camera's end; a tip that shows now would show always."
        ),
    ]
    shown_switches = switch_table(switches)
    if strips is not None:
        shown_switches = strip_table(strips) + svg_figure(
            flat,
            "The different strips as cast, from outside: each switch with its marker "
            "(1:1 in bench/strips.svg).",
        )
        place[:2] = [
            (
                f"Put {len(strips.strips)} strips on, sorted by label: mold/strips.csv, or the "
                "label below each marker on the paint map. Strips of one label are alike; the "
                "drawing shows the markers of the first."
            ),
            (
                "Lay a thin film of cyanoacrylate on the web and the rims, none in the holes. "
                "Begin at one end: thread stem after stem from outside and press the web down."
            ),
        ]
    calibrate = [
        "After assembly: run kit/decoder.gcode for data with the switches in.",
    ]
    parts = ", ".join(f"{name} {g:.2f} g" for name, g in parts_g(design, recipe).items())
    grams = (
        f"<p>{recipe.rubber_g:.1f} g of {escape(design.switch.material)} in all"
        f"{f': {parts}' if parts else ''}.</p>"
    )
    sections = [
        *pulled,
        ("1 Shell", _listed(shell)),
        ("2 Switches: casting", grams + _listed(steps)),
        (
            "3 Switches: placing",
            shown_switches
            + svg_figure(section, "Section through one receptor with its switch.")
            + _listed(place),
        ),
        ("4 Camera, light, connectors", _listed(fixture_steps)),
        ("5 Calibration", _listed(calibrate)),
        ("Bill of materials", bill_table(bill)),
    ]
    return page(title, sections, lead)


def fixture_steps(design: Design, hardware: Mapping[str, Any]) -> list[str]:
    """Steps in order; without built-in hardware, the requirements on the user's own.

    Parameters
    ----------
    hardware : mapping
        Facts of the hardware stage: ``parts``, ``joints``.
    """
    ends = " and ".join(("near", "far")[end] for end in design.camera.end_numbers)
    camera = (
        f"Put the camera before the {ends} end, its lens on the axis; a polarising film before "
        "it, crossed to the one on the light, takes glints away."
    )
    bar = design.light.bar_radius_mm
    light = (
        f"Stick the LED strip around the light bar (radius {bar:g} mm in all) with double-sided "
        "tape, polarising film over it; it lies on the axis."
        if bar > 0.0
        else "Put the ring of LEDs around the camera's lens, polarising film over it."
    )
    parts = [part for part in hardware.get("parts", []) if part["file"]]
    if not parts:
        why = hardware.get("hardware_left_out", "")
        own = f"No holders of ours ({why}): use your own." if why else "Use holders of your own."
        return [own, light, camera, "Close both ends: no light from outside."]
    printed = ", ".join(part["file"] for part in parts)
    joints = [
        f"{joint['joint']}: {joint['count']} × {joint['size']} × {joint['length_mm']:g} mm "
        f"({joint['thread']})."
        for joint in hardware.get("joints", [])
    ]
    return [
        f"Print {printed}; tap the holes or set the inserts before assembly.",
        light,
        camera,
        (
            "Rim and socket are round: turn the shell until `phytac decode` finds every marker in "
            "a frame at rest, then tighten. Where the markers repeat around, mark column 0 "
            "(paint map) on shell and mount first: a frame cannot distinguish those turns."
        ),
        *(f"Screw {joint}" for joint in joints),
        "Look into the dark sensor beside a lamp: no light from outside may show.",
    ]
