"""Bill of materials: the parts lists of all stages in one table."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from phytac_design.design.shell_materials import shell_words
from phytac_design.design.spec import Design
from phytac_design.fabrication.bill import bill_part, csv_text
from phytac_design.fabrication.switch_set import SwitchSet, revolved_volume_mm3
from phytac_design.fabrication.switch_strips import StripSet, strip_label
from phytac_shapes.errors import DesignError

Part: TypeAlias = Mapping[str, Any]
COLUMNS = ("part", "file", "count", "material", "volume_mm3", "mass_g", "note")
"""``volume_mm3`` and ``mass_g`` are of one piece."""


def bought(name: str, count: int, note: str, material: str = "consumable") -> dict[str, Any]:
    """A part that is bought."""
    return bill_part(name, count=count, material=material, note=note)


def shell_file(design: Design) -> str:
    """File that the shell is printed from."""
    several = design.receptor.colouring == "multi-material"
    return f"shell/shell.{'3mf' if several else 'stl'}"


def shell_parts(
    design: Design, volume_mm3: float, pieces: Sequence[Mapping[str, Any]] = ()
) -> list[dict[str, Any]]:
    """The printed shell, or its ``pieces`` (file, volume_mm3), and the pens for its markers."""
    material = shell_words(design.material.modulus_MPa)
    colouring = design.receptor.colouring
    note = {
        "paint": f"{material}; or shell/shell.3mf in several materials, then nothing is painted",
        "insert": f"{material}; its markers are the inserts",
        "multi-material": f"{material} and resins of the markers' colours",
    }[colouring]
    printed = [
        bill_part(
            f"shell, piece {number}",
            file=piece["file"],
            volume_mm3=piece["volume_mm3"],
            note=f"{material}; glued on its keys",
        )
        for number, piece in enumerate(pieces, start=1)
    ] or [bill_part("shell", file=shell_file(design), volume_mm3=volume_mm3, note=note)]
    more = []
    if colouring == "paint":
        colours = dict.fromkeys(design.layout.colours)
        more = [bought(f"marker pen, {name}", 1, "end faces and bands") for name in colours]
    elif design.reference_marks.count:
        more = [bought(f"marker pen, {design.layout.colours[0]}", 1, "reference marks")]
    if design.receptor.has_inserts:
        more.append(bought("clear UV resin", 1, "a drop on each insert; cured by a lamp"))
    return [*printed, *more]


def switch_parts(switches: SwitchSet, strips: StripSet | None = None) -> list[dict[str, Any]]:
    """Every kind of switch or strip, and what tips and seats need; nothing without switches."""
    if not switches.kinds:
        return []
    out = _single_parts(switches) if strips is None else _strip_parts(strips)
    return [
        *out,
        bought("marker pen, red", 1, "tips of the switches"),
        bought("cyanoacrylate (Loctite 406), 20 g", 1, "seats of the switches"),
    ]


def _single_parts(switches: SwitchSet) -> list[dict[str, Any]]:
    profile_mm = 1e-3  # accuracy of the sections that volumes are taken from
    return [
        bill_part(
            f"switch {switches.label(kind)}",
            count=len(switches.markers_of(kind)),
            material="tpu",
            volume_mm3=revolved_volume_mm3(switches.profile(kind, profile_mm)),
            note=f"{family_words(switches, kind[0])}{switches.threshold_N[kind[0]]:g} N, "
            f"{switches.lengths_mm[kind[1]]:.1f} mm from outer face to tip; cast",
        )
        for kind in switches.kinds
    ]


def _strip_parts(strips: StripSet) -> list[dict[str, Any]]:
    out = []
    for number in strips.numbers:
        alike = strips.alike(number)
        length = strips.switches.lengths_mm[strips.switches.length[alike[0].markers]]
        reach = " to ".join(f"{each:.1f}" for each in np.unique([length.min(), length.max()]))
        several = f"{alike[0].count} switches, " if alike[0].count > 1 else ""
        out.append(
            bill_part(
                f"{'strip' if several else 'switch'} {strip_label(number)}",
                count=len(alike),
                material="tpu",
                volume_mm3=strips.rubber_of_mm3(number),
                note=f"{several}{reach} mm from outer face to tip; cast",
            )
        )
    return out


def family_words(switches: SwitchSet, number: int) -> str:
    """Family of a switch and a comma, where not all are bowls."""
    return "" if switches.body == "bowl" else f"{switches.family(number)}, "


def optics_parts(design: Design, *, listed: bool) -> list[dict[str, Any]]:
    """Films, and camera and light too unless the hardware has ``listed`` them."""
    lens = design.camera
    cameras = len(lens.end_numbers)
    out = [bought("polarising film", 1, "over the light, and one crossed before the lens")]
    if listed:
        return out
    size = f"{lens.width_px} × {lens.height_px} at {lens.frame_rate_Hz:g} fps"
    out.append(bought("camera", cameras, size, "electronics"))
    if design.light.bar_radius_mm > 0.0:
        strip = "on the light bar, with double-sided tape"
        return [*out, bought("COB LED strip", 1, strip, "electronics")]
    return [*out, bought("ring of LEDs", cameras, "beside the camera", "electronics")]


def bill_rows(parts: Sequence[Part]) -> list[dict[str, Any]]:
    """Rows of the bill: the parts with the mass of one piece.

    Raises
    ------
    DesignError
        If a material is not known.
    """
    masses = [mass_g(str(part["material"]), float(part["volume_mm3"])) for part in parts]
    return [
        {name: {**part, "mass_g": mass}[name] for name in COLUMNS}
        for part, mass in zip(parts, masses, strict=True)
    ]


def total_mass_g(rows: Sequence[Part], material: str) -> float:
    """Mass of all pieces of a material."""
    return float(sum(r["count"] * (r["mass_g"] or 0.0) for r in rows if r["material"] == material))


def bill_csv(rows: Sequence[Part]) -> str:
    """CSV of the bill; volume and mass of one piece, empty where there are none."""
    shown = []
    for row in rows:
        volume = f"{row['volume_mm3']:.3f}" if row["volume_mm3"] else ""
        mass = f"{row['mass_g']:.4f}" if row["volume_mm3"] and row["mass_g"] is not None else ""
        shown.append({**row, "volume_mm3": volume, "mass_g": mass})
    return csv_text(COLUMNS, [[row[name] for name in COLUMNS] for row in shown])


DENSITY_g_cm3 = {
    "resin": 1.15,
    "tpu": 1.10,
    "silicone": 1.10,
    "steel": 7.85,
    "brass": 8.4,
    "pla": 1.24,
}
"""Assumed densities. Printed paint bodies are resin too."""


def density_g_cm3(material: str) -> float | None:
    """Density of a material; None for bought parts that are no single material.

    Raises
    ------
    DesignError
        If the material is not known.
    """
    unknown = ("electronics", "consumable")  # materials of bought parts whose mass is left open
    if material in unknown:
        return None
    key = "resin" if material.startswith("paint-") else material
    if key not in DENSITY_g_cm3:
        known = ", ".join([*DENSITY_g_cm3, "paint-COLOUR", *unknown])
        raise DesignError(
            "density-unknown", f"no density for the material {material!r}; known: {known}"
        )
    return DENSITY_g_cm3[key]


def mass_g(material: str, volume_mm3: float) -> float | None:
    """Mass of a volume; None where the material has no density."""
    density = density_g_cm3(material)
    return None if density is None else density * volume_mm3 / 1000.0
