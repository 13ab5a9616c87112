"""Strips of switches: bowls of neighbouring receptors on one web, cast flat, wrapped on the shell.

The web's foot lies on the shell's outer face. It is laid flat on the face half its thickness
above: the middle of a web that is wrapped without tension keeps its length.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.switch_table import StripSection
from phytac_design.fabrication.switch_set import SwitchSet, revolve, revolved_volume_mm3
from phytac_design.geometry.development import laid_flat, relative_neighbours
from phytac_design.geometry.triangles import TriangleMesh
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import hull, to_manifold, to_triangles, united
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class SwitchStrip:
    """Switches on one web; a single switch is a strip of one.

    Attributes
    ----------
    markers : (m,) int
        Ids of the markers, near rows first.
    flat_mm : (m, 2) float
        Places of the axes in the plane, seen from outside.
    bridges : (b, 2) int
        Pairs of switches, by their place in ``markers``, that the web joins.
    stretch : (b,) float
        Strain of each bridge from its length on the shell against that in the mold.
    bending : (b,) float
        Most strain of each bridge's faces from the shell's curvature along it.
    clearance_mm : float
        Least gap all around a stem in its hole, where the next one is in the middle of its own:
        error of the pitch taken off.
    number : int
        Strips of one number are alike and come out of one cavity.
    """

    markers: IntArray
    flat_mm: FloatArray
    bridges: IntArray
    stretch: FloatArray
    bending: FloatArray
    clearance_mm: float
    number: int = 0

    @property
    def count(self) -> int:
        """Switches on the strip."""
        return len(self.markers)

    @property
    def stretch_max(self) -> float:
        """Largest stretch, without sign; 0 for a single switch."""
        return float(np.abs(self.stretch).max(initial=0.0))

    @property
    def bending_max(self) -> float:
        """Largest strain from bending."""
        return float(self.bending.max(initial=0.0))

    @property
    def strain_max(self) -> float:
        """Largest strain on the shell, of both."""
        return float((np.abs(self.stretch) + self.bending).max(initial=0.0))


@dataclass(frozen=True, kw_only=True)
class StripSet:
    """All strips of a sensor, single switches among them.

    Attributes
    ----------
    section : StripSection
        The design's settings.
    flank_deg : float
        How far the web's sides lean.
    strips : tuple of Strip
        In the order of their first markers.
    why_single : dict of int to str
        Markers whose switch is single, with the reason.
    switches : SwitchSet
        The switches on them.
    """

    section: StripSection
    flank_deg: float
    strips: tuple[SwitchStrip, ...]
    why_single: dict[int, str]
    switches: SwitchSet

    @property
    def numbers(self) -> list[int]:
        """Different strips, ascending from 1."""
        return sorted({strip.number for strip in self.strips})

    def alike(self, number: int) -> list[SwitchStrip]:
        """Strips of a number; the first stands for all."""
        return [strip for strip in self.strips if strip.number == number]

    def rubber_of_mm3(self, number: int) -> float:
        """Volume of a strip of a number: its switches and its web."""
        kinds = kinds_of(self.alike(number)[0], self.switches)
        volume = {
            kind: revolved_volume_mm3(self.switches.profile(kind, 1e-3)) for kind in set(kinds)
        }
        return sum(volume[kind] for kind in kinds) + self.web_of_mm3(number)

    def web_of_mm3(self, number: int) -> float:
        """Volume of its web outside its bowls, by quadrature over the web's section."""
        strip, switches = self.alike(number)[0], self.switches
        node, weight = np.polynomial.legendre.leggauss(24)
        kinds = kinds_of(strip, switches)
        z = 0.5 * self.section.web_mm * (node + 1.0)
        half = 0.5 * self.section.web_width_mm - z * np.tan(np.radians(self.flank_deg))
        y = half[:, None] * node
        # How far each kind's bowl reaches into the web, (24, 24) over height and width.
        reach = {}
        for kind in set(kinds):
            profile = switches.profile(kind, 1e-3)
            over = profile[int(profile[:, 0].argmax()) : 0 : -1]
            radius = np.interp(z, over[:, 1], over[:, 0])
            reach[kind] = np.sqrt(np.maximum(radius[:, None] ** 2 - y**2, 0.0))
        area = 0.5 * self.section.web_mm * weight * half
        total = 0.0
        for first, last in strip.bridges:
            length = np.hypot(*(strip.flat_mm[first] - strip.flat_mm[last]))
            free = length - reach[kinds[first]] - reach[kinds[last]]
            total += float(area @ (free @ weight))
        return total

    @property
    def webs(self) -> list[SwitchStrip]:
        """Strips of more than one switch."""
        return [strip for strip in self.strips if strip.count > 1]

    @property
    def singles(self) -> int:
        """Switches that are on no strip."""
        return len(self.strips) - len(self.webs)


def kinds_of(strip: SwitchStrip, switches: SwitchSet) -> list[tuple[int, int]]:
    """Kind of each switch of a strip."""
    return [switches.kind_of(marker) for marker in strip.markers]


def strip_label(number: int) -> str:
    """Label of the strips of a number."""
    return f"S{number}"


def make_strip(sensor: Sensor, switches: SwitchSet, markers: IntArray) -> SwitchStrip:
    """Lay the switches of some markers flat, joined to their relative neighbours."""
    section, uv = sensor.design.strip, sensor.markers.uv[markers]
    bridges = relative_neighbours(sensor.surface.point(uv))
    half = 0.5 * section.web_mm
    flat, way = laid_flat(sensor.surface, uv, bridges, offset_mm=half)
    off = flat[bridges[:, 0]] - flat[bridges[:, 1]]
    length = np.linalg.norm(off, axis=1)
    miss = np.zeros(len(markers))
    for side in bridges.T:
        np.maximum.at(miss, side, np.abs(way.length_mm - length))
    if len(bridges):
        miss += section.pitch_error_mm
    kinds = [switches.kind_of(marker) for marker in markers]
    roots = {kind: root_radius_mm(switches, kind) for kind in set(kinds)}
    hole = 0.5 * sensor.design.receptor.diameter_hole_mm
    room = hole - np.array([roots[kind] for kind in kinds])
    return SwitchStrip(
        markers=markers,
        flat_mm=flat,
        bridges=bridges,
        stretch=way.length_mm / length - 1.0 if len(length) else length,
        bending=half * way.curvature_per_mm,
        clearance_mm=float((room - miss).min()),
    )


def root_radius_mm(switches: SwitchSet, kind: tuple[int, int]) -> float:
    """Radius of a stem where it enters its hole, on the shell's outer face."""
    # The stem's last piece, straight from below the bowl down to the tip.
    (r0, z0), (r1, z1) = switches.profile(kind)[-3:-1]
    return float(r0 + (r1 - r0) * np.clip(z0 / (z0 - z1), 0.0, 1.0))


def web_refusal(section: StripSection, switches: SwitchSet) -> str:
    """Why a web does not go with the bowls that it joins; "" if it does."""
    narrow = 0.5 * min(shape.diameter_mm for shape in switches.bowls)
    # Webs meet at 60 degrees or more: as wide as a bowl's radius they overlap inside bowls alone.
    if section.web_width_mm > narrow:
        return (
            f"a web of {section.web_width_mm:g} mm is too wide for bowls of {2.0 * narrow:.2f} mm; "
            f"set strip.web_width_mm to at most {narrow:.2f}"
        )
    low = min(float(switches.profile(kind)[0, 1]) for kind in switches.kinds)
    if section.web_mm > 0.5 * low:
        return (
            f"a web of {section.web_mm:g} mm is thicker than half a bowl's height; set "
            f"strip.web_mm to at most {0.5 * low:.2f}"
        )
    return ""


def refusal(strip: SwitchStrip, sensor: Sensor, switches: SwitchSet, *, land_mm: float) -> str:
    """Why a strip does not do; "" if it does.

    ``land_mm`` is what the mold needs around each bowl.
    """
    section, rules = sensor.design.strip, sensor.design.print_rules
    if strip.count == 1:
        return ""
    if strip.strain_max > section.strain_max:
        return (
            f"the web would be strained by {strip.strain_max:.1%} (stretch "
            f"{strip.stretch_max:.1%}, bending {strip.bending_max:.1%}), more than "
            f"strip.strain_max = {section.strain_max:.1%}"
        )
    if strip.clearance_mm < 0.0:
        return (
            f"stems would miss their holes by {-strip.clearance_mm:.2f} mm at a pitch that is "
            f"true to ± {section.pitch_error_mm:g} mm (strip.pitch_error_mm)"
        )
    rim = 0.5 * max(shape.diameter_mm for shape in switches.bowls)
    first, second = np.triu_indices(strip.count, 1)
    apart = np.linalg.norm(strip.flat_mm[first] - strip.flat_mm[second], axis=1).min()
    if apart < 2.0 * rim + land_mm:
        return (
            f"bowls would lie {apart - 2.0 * rim:.2f} mm apart in the mold, less than {land_mm:g}"
        )
    free = web_gap_mm(strip, sensor) - rim
    if free < rules.gap_min_mm:
        return (
            f"the web would pass a bowl at {free:.2f} mm, less than print_rules.gap_min_mm = "
            f"{rules.gap_min_mm:g}"
        )
    return ""


def web_gap_mm(strip: SwitchStrip, sensor: Sensor) -> float:
    """Least distance of the web's edge from the axis of a marker that it does not join, mm."""
    points = sensor.surface.point(sensor.markers.uv)
    start, end = (points[strip.markers[side]] for side in strip.bridges.T)
    way = end - start
    size = np.einsum("bx,bx->b", way, way)
    share = np.clip(np.einsum("mbx,bx->mb", points[:, None] - start, way) / size, 0.0, 1.0)
    away = np.linalg.norm(points[:, None] - start - share[..., None] * way, axis=2)
    own = strip.markers[strip.bridges]
    away[own[:, 0], np.arange(len(own))] = away[own[:, 1], np.arange(len(own))] = np.inf
    return float(away.min(initial=np.inf)) - 0.5 * sensor.design.strip.web_width_mm


def congruent(first: SwitchStrip, second: SwitchStrip, switches: SwitchSet) -> bool:
    """Whether two strips are alike: the same switches at the same places, turned and moved."""
    same_mm = 0.02  # well below what molds and holes repeat
    if first.count != second.count or not np.array_equal(first.bridges, second.bridges):
        return False
    for part in (switches.bowl, switches.length):
        if not np.array_equal(part[first.markers], part[second.markers]):
            return False
    a, b = (strip.flat_mm - strip.flat_mm.mean(axis=0) for strip in (first, second))
    za, zb = (each[:, 0] + 1j * each[:, 1] for each in (a, b))
    product = np.vdot(zb, za)
    turn = product / abs(product) if abs(product) > 0.0 else 1.0
    return bool(np.abs(za - turn * zb).max() < same_mm)


def strip_mesh(strips: StripSet, number: int, tolerance_mm: float = 0.02) -> TriangleMesh:
    """A strip of a number as it comes out of a mold without shrinkage: web's foot at z = 0."""
    strip, switches = strips.alike(number)[0], strips.switches
    kinds = kinds_of(strip, switches)
    web, half = strips.section.web_mm, 0.5 * strips.section.web_width_mm
    lean = web * float(np.tan(np.radians(strips.flank_deg)))
    bodies: list[Any] = []
    filled: list[Any] = []
    bars: list[Any] = []
    for (x, y), kind in zip(strip.flat_mm, kinds, strict=True):
        profile = switches.profile(kind, tolerance_mm)
        rim = int(profile[:, 0].argmax())
        # Bars reach a little into the bowls: faces that only touch might not join. They are cut
        # from below their foot: between faces at one height, films would stay.
        outer = np.array([*profile[: rim + 1], [profile[rim, 0], -1.0], [0.0, -1.0]])
        outer[1:-1, 0] -= 0.02
        for own, section in ((bodies, profile), (filled, outer)):
            own.append(to_manifold(revolve(section, tolerance_mm)).translate((x, y, 0.0)))
    for first, last in strip.bridges:
        ends = strip.flat_mm[[first, last]]
        way = ends[1] - ends[0]
        aside = np.array([-way[1], way[0]]) / np.hypot(*way)
        corners = [
            [*(end + side * wide * aside), z]
            for wide, z in ((half, 0.0), (half - lean, web))
            for end in ends
            for side in (-1.0, 1.0)
        ]
        bars.append(hull(np.array(corners)))
    body = united(bodies)
    if bars:
        body += united(bars) - united(filled)
    return to_triangles(body)
