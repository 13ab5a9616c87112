"""Parts, hand work and material of a sensor, from its design alone: no solid, no mesh.

Counts are those of the bill of materials without the calibration kit and without consumables.
Switches are not solved: the molds are planned, and the rubber is estimated, with nominal ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.fabrication.documents.bill_of_materials import mass_g, optics_parts
from phytac_design.fabrication.effort.shell_estimate import shell_pieces, shell_volume_mm3
from phytac_design.fabrication.hardware.hardware_assembly import make_hardware
from phytac_design.fabrication.hardware.parts import HardwareAssembly
from phytac_design.fabrication.inserts.insert_solids import sprue_volume_mm3
from phytac_design.fabrication.inserts.sprues import Sprue, plan_sprues, plates
from phytac_design.fabrication.molds.estimate import MoldVolumes, mold_volumes
from phytac_design.fabrication.molds.make import MAKERS, plan_molds, strips_of
from phytac_design.fabrication.switch_set import SwitchSet, make_switches
from phytac_design.fabrication.switch_strips import StripSet
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.cup_design import nominal_cup
from phytac_design.mechanics.switch.switch_inputs import space_of
from phytac_design.mechanics.switch.switch_space import SwitchSpace
from phytac_shapes.errors import DesignError

PARTS = {
    "shell": "printed, shell",
    "molds": "printed, molds",
    "hardware": "printed, hardware",
    "silicone": "silicone halves, cast",
    "sprues": "sprues of inserts",
    "switches": "switches",
    "strips": "strips of switches",
    "screws": "screws and inserts",
    "bought": "cameras and lights",
}
"""Groups of parts that are handled, in words."""
OPERATIONS = {
    "print": "printing, washing, curing",
    "paint_ends": "painting receptor ends",
    "insert": "pushing inserts in",
    "silicone": "silicone molds",
    "cast": "casting switches",
    "trim": "trimming switches",
    "paint_tips": "painting tips red",
    "glue": "gluing switches",
    "assemble": "assembling hardware",
}
"""Operations, in words."""
PAINT_AND_GLUE = ("paint_ends", "insert", "paint_tips", "glue")


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What it takes to make one sensor.

    Attributes
    ----------
    parts : dict
        Parts that are handled, by group (see ``PARTS``).
    switches, stem_lengths, switch_kinds : int
        Switches to cast, trim, paint and glue; their lengths; pairs of bowl and length.
    on_strips : int
        Switches that are on strips: they are handled together.
    castings : int
        Castings of all sets of plates or trays.
    receptor_ends : int
        Ends that are painted by hand.
    inserts : int
        Coloured inserts that are pushed in from outside.
    hours : dict
        Hand work by operation (see ``OPERATIONS``).
    volume_mm3, mass_g : dict
        Of ``shell``, ``inserts`` with their sprues, ``molds`` (plates or trays), ``rubber`` (with
        what runs over) and ``silicone``. Other printed parts are not estimated.
    tools : tuple of str
        What is needed besides parts and materials.
    price : float or None
        At the design's prices; None if it gives none.
    left_out : str
        Why no molds can be made; "" if they can, or none are needed.
    """

    parts: dict[str, int]
    switches: int
    stem_lengths: int
    switch_kinds: int
    on_strips: int
    castings: int
    receptor_ends: int
    inserts: int
    hours: dict[str, float]
    volume_mm3: dict[str, float]
    mass_g: dict[str, float]
    tools: tuple[str, ...]
    price: float | None
    left_out: str

    @property
    def parts_handled(self) -> int:
        """All parts."""
        return sum(self.parts.values())

    @property
    def parts_printed(self) -> int:
        """Those that are printed."""
        return sum(self.parts[name] for name in ("shell", "sprues", "molds", "hardware"))

    @property
    def hours_total(self) -> float:
        """All hand work."""
        return sum(self.hours.values())

    @property
    def hours_paint_and_glue(self) -> float:
        """Hand work on single receptors and switches that no tray shortens."""
        return sum(self.hours[name] for name in PAINT_AND_GLUE)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for the report."""
        return asdict(self) | {
            name: getattr(self, name)
            for name in ("parts_handled", "parts_printed", "hours_total", "hours_paint_and_glue")
        }


def effort_of(sensor: Sensor) -> Effort:
    """What it takes to make the sensor of a design that keeps all rules."""
    design, count, left_out = sensor.design, sensor.markers.count, ""
    switches = kinds = lengths = 0
    molds: list[MoldVolumes] = []
    castings: list[int] = []
    strips: StripSet | None = None
    if design.has_switches:
        switches = count
        try:
            made = nominal_switches(sensor)
            kinds, lengths = len(made.kinds), len(made.lengths_mm)
            strips = strips_of(sensor, made)
            sizes, plans = plan_molds(design.mold, design.print_rules, made, strips=strips)
            castings = [plan.castings for plan in plans]
            molds = [mold_volumes(plan, sizes) for plan in plans]
        except DesignError as error:
            left_out = str(error)
    kit = _hardware(sensor)
    bought = optics_parts(design, listed=bool(kit.parts))
    silicone = design.mold.way == "silicone-master"
    on_strips = sum(strip.count for strip in strips.webs) if strips else 0
    inserts = sum(len(joint.seats_mm) for joint in kit.joints if joint.thread == "heat-set")
    sprues = plan_sprues(sensor) if design.receptor.has_inserts else []
    parts = {
        "shell": shell_pieces(sensor),
        "sprues": len(sprues),
        "molds": len(molds) * len(MAKERS[design.mold.way]),
        "hardware": sum(part.printed for part in kit.parts),
        "silicone": 2 * len(molds) * silicone,
        "switches": switches - on_strips,
        "strips": len(strips.webs) if strips else 0,
        "screws": sum(part.material == "steel" for part in kit.parts) + inserts,
        "bought": sum(part.material in ("electronics", "light") for part in kit.parts)
        + sum(part["count"] for part in bought if part["material"] == "electronics"),
    }
    ends = count if design.receptor.colouring == "paint" else 0
    volumes = {
        "shell": shell_volume_mm3(sensor),
        "inserts": sum(sprue_volume_mm3(design, sprue) for sprue in sprues),
        "molds": sum(one.printed_mm3 for one in molds),
        "rubber": sum(count * one.rubber_mm3 for count, one in zip(castings, molds, strict=True)),
        "silicone": sum(one.silicone_mm3 for one in molds),
    }
    beds = sum(map(len, plates(sprues, design).values()))
    hours = _hours(design, parts, ends=ends, castings=sum(castings), stems=on_strips, beds=beds)
    hours["insert"] = _insert_s(design, sprues) / 3600.0
    poured = {"rubber": "tpu", "silicone": "silicone"}
    masses = {
        name: mass_g(poured.get(name, "resin"), volume) or 0.0 for name, volume in volumes.items()
    }
    return Effort(
        parts=parts,
        switches=switches,
        stem_lengths=lengths,
        switch_kinds=kinds,
        on_strips=on_strips,
        castings=sum(castings),
        receptor_ends=ends,
        inserts=count if sprues else 0,
        hours={name: hours[name] for name in OPERATIONS},
        volume_mm3=volumes,
        mass_g=masses,
        tools=_tools(design, parts, ends),
        price=_price(design, sum(hours.values()), masses),
        left_out=left_out,
    )


def on_strips(effort: Mapping[str, Any]) -> str:
    """How many switches are on how many strips, in words after them; "" without strips.

    ``effort`` is as ``Effort.as_dict`` makes it.
    """
    count = effort["parts"]["strips"]
    return f", {effort['on_strips']} of them on {count} strips" if count else ""


def nominal_switches(sensor: Sensor) -> SwitchSet:
    """Switches of a design of a shape that is typical of its space, in place of a solved one.

    Raises
    ------
    DesignError
        If none fits.
    """
    design, space = sensor.design, space_of(sensor.design)
    family = design.switch.family
    if family == "bowl":
        shape: dict[str, Any] = {"bowl": vars(_nominal_bowl(space))}
    else:
        # The smallest spread mostly is a plunger's.
        cup = nominal_cup("membrane" if family == "membrane" else "plunger", space)
        shape = {"cup": vars(cup), "stem_diameter_mm": space.stem_diameter_mm}
        shape["stop_mm"] = min(cup.height_mm, space.stroke_mm)
    force = thresholds_N(design, sensor.markers)
    made = [{"threshold_N": float(each)} | shape for each in np.unique(force)]
    return make_switches(sensor, made, force)


def _nominal_bowl(space: SwitchSpace) -> Bowl:
    # Of the solved bowls of the shipped designs: depth 1.11 to 1.18 strokes, wall 1.08 to 1.11
    # times the least.
    depth, wall, fillet = 1.15, 1.1, 1.0 / 6.0
    thickness = wall * space.wall_min_mm
    return Bowl(
        diameter_mm=space.diameter_mm,
        depth_mm=min(depth * space.stroke_mm, space.depth_max_mm - thickness),
        thickness_mm=thickness,
        stem_diameter_mm=space.stem_diameter_mm,
        pad_diameter_mm=space.stem_diameter_mm,
        fillet_mm=fillet * space.stem_diameter_mm,
    )


def _hardware(sensor: Sensor) -> HardwareAssembly:
    """Hardware of a design; empty if a default one cannot be made, which the build leaves out."""
    try:
        return make_hardware(sensor.design, sensor.surface)
    except DesignError:
        return HardwareAssembly()


def _insert_s(design: Design, sprues: Sequence[Sprue]) -> float:
    """Seconds in which the inserts of sprues are pushed in."""
    each = design.effort
    return sum(
        each.sprue_s
        + len(one.markers) * (each.insert_single_s if one.way == "single" else each.insert_s)
        for one in sprues
    )


def _hours(
    design: Design,
    parts: dict[str, int],
    *,
    ends: int,
    castings: int,
    stems: int,
    beds: int,
) -> dict[str, float]:
    """Hand work by operation, h; ``stems`` are those on strips, sprues are printed by ``beds``."""
    each = design.effort
    strips = parts["strips"]
    seconds = {
        "print": (parts["shell"] + parts["molds"] + parts["hardware"] + beds) * each.print_s,
        "paint_ends": ends * each.paint_s,
        "silicone": 0.5 * parts["silicone"] * each.silicone_s,
        "cast": castings * each.cast_s,
        "trim": parts["switches"] * each.trim_s
        + strips * each.strip_trim_s
        + stems * each.strip_stem_trim_s,
        "paint_tips": parts["switches"] * each.tip_s + strips * each.strip_tip_s,
        "glue": parts["switches"] * each.glue_s
        + strips * each.strip_glue_s
        + stems * each.strip_stem_s,
        "assemble": (parts["hardware"] + parts["bought"]) * each.fit_s
        + parts["screws"] * each.screw_s,
    }
    return {name: value / 3600.0 for name, value in seconds.items()}


def _price(design: Design, hours: float, masses: dict[str, float]) -> float | None:
    """Sum of all that the design gives a price of; None without any."""
    each = design.effort
    items = (
        (each.price_hour, hours),
        (each.price_resin_kg, (masses["shell"] + masses["inserts"] + masses["molds"]) / 1000.0),
        (each.price_rubber_kg, masses["rubber"] / 1000.0),
        (each.price_silicone_kg, masses["silicone"] / 1000.0),
        (each.price_camera, len(design.camera.end_numbers)),
    )
    if not any(price for price, _ in items):
        return None
    return float(sum(price * amount for price, amount in items))


def _tools(design: Design, parts: dict[str, int], ends: int) -> tuple[str, ...]:
    """Tools, in the order in which they are used."""
    out = [f"printer ({design.print_rules.process})"]
    if parts["switches"] + parts["strips"]:
        out += ["scale (0.01 g)", "vacuum chamber", "oven (65 °C)", "knife"]
    pens: list[str] = [*dict.fromkeys(design.layout.colours)] if ends else []
    pens += ["red"] if parts["switches"] + parts["strips"] else []
    if pens:
        out.append(f"marker pens ({', '.join(pens)})")
    if parts["sprues"]:
        out.append("flush cutter")
    if parts["screws"]:
        out.append("hexagon keys")
    return tuple(out)
