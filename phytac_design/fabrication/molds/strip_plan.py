"""Which switches go on which strip: as long as the mold has room and the shell allows."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from phytac_design.fabrication.molds.cavity import MoldSizes
from phytac_design.fabrication.molds.strip_layout import Room, footprint
from phytac_design.fabrication.switch_set import SwitchSet
from phytac_design.fabrication.switch_strips import (
    StripSet,
    SwitchStrip,
    congruent,
    make_strip,
    refusal,
)
from phytac_design.layout.sensor import Sensor
from phytac_shapes.arrays import IntArray

Bands = list[list[IntArray]]
"""Candidates for strips: each band is a list of rows (ids of markers in order)."""


def plan_strips(sensor: Sensor, switches: SwitchSet, sizes: MoldSizes, room: Room) -> StripSet:
    """Put the switches of a sensor on strips.

    Rows of a lattice are taken ``strip.rows`` at a time and cut into the fewest equal pieces that
    do; where none do, row by row; where none do again, the switches stay single. A phyllotaxis has
    no rows: its markers are taken along the spirals that need the fewest strips. Positions of one's
    own stay single.
    """
    section, layout = sensor.design.strip, sensor.design.layout
    why: dict[int, str] = {}
    if sensor.markers.in_rows:
        bands = _row_bands(sensor, section.rows)
        strips = _strips(sensor, switches, sizes, room, bands, why)
    elif layout.kind == "phyllotaxis":
        best: tuple[list[SwitchStrip], dict[int, str]] | None = None
        for step in _spiral_steps(sensor.markers.count):
            reasons: dict[int, str] = {}
            ids = np.arange(sensor.markers.count)
            found = _strips(
                sensor, switches, sizes, room, [[ids[k::step]] for k in range(step)], reasons
            )
            if best is None or len(found) < len(best[0]):
                best = found, reasons
        strips, why = best or ([], {})
    else:
        said = f"the layout {layout.kind!r} has neither rows nor spirals"
        why = dict.fromkeys(range(sensor.markers.count), said)
        strips = [_single(sensor, switches, marker) for marker in why]
    return StripSet(
        section=section,
        flank_deg=sizes.flank_deg,
        strips=tuple(_numbered(strips, switches)),
        why_single=why,
        switches=switches,
    )


def _row_bands(sensor: Sensor, rows: int) -> Bands:
    markers = sensor.markers
    each = [
        ids[np.argsort(markers.column[ids], kind="stable")]
        for ids in (np.flatnonzero(markers.row == row) for row in np.unique(markers.row))
    ]
    return [each[first : first + rows] for first in range(0, len(each), rows)]


def _spiral_steps(count: int) -> Iterator[int]:
    """Fibonacci numbers: markers of a phyllotaxis this far apart lie on one of its spirals."""
    first, second = 2, 3
    while second < max(count, 4):
        first, second = second, first + second
        yield first


def _strips(
    sensor: Sensor,
    switches: SwitchSet,
    sizes: MoldSizes,
    room: Room,
    bands: Iterable[list[IntArray]],
    why: dict[int, str],
) -> list[SwitchStrip]:
    """Strips of bands; single switches with their reasons in ``why``."""
    found: list[SwitchStrip] = []
    for band in bands:
        made, reason = _cut(sensor, switches, sizes, room, band)
        if made:
            found += made
            continue
        for row in band:
            made, alone = _cut(sensor, switches, sizes, room, [row]) if len(band) > 1 else ([], "")
            if not made:
                why |= dict.fromkeys(row.tolist(), alone or reason)
                made = [_single(sensor, switches, int(marker)) for marker in row]
            found += made
    return found


def _cut(
    sensor: Sensor, switches: SwitchSet, sizes: MoldSizes, room: Room, band: list[IntArray]
) -> tuple[list[SwitchStrip], str]:
    """Fewest equal pieces of a band that do, or none and the last reason."""
    most, reason = max(len(row) for row in band), ""
    longest = sensor.design.strip.columns or most
    # Down to pairs: one marker of each row, or two of a single one.
    shortest = most if len(band) > 1 else most // 2
    for pieces in range(-(-most // longest), shortest + 1):
        # The same cuts in every row: pieces of a lattice around a body are alike.
        parts = [
            np.concatenate(
                [row[k * len(row) // pieces : (k + 1) * len(row) // pieces] for row in band]
            )
            for k in range(pieces)
        ]
        made: list[SwitchStrip] = []
        for part in filter(len, parts):
            strip = make_strip(sensor, switches, part)
            reason = _refusal(strip, sensor, switches, sizes, room)
            if reason:
                break
            made.append(strip)
        if not reason:
            return made, ""
    return [], reason or f"a row of {most} cut to strip.columns = {longest} leaves no pairs"


def _refusal(
    strip: SwitchStrip, sensor: Sensor, switches: SwitchSet, sizes: MoldSizes, room: Room
) -> str:
    need = footprint(strip, sizes.pitch_mm, sizes.rubber_scale).size_mm
    if not room.holds(need):
        return (
            f"a strip of {need[0]:.0f} x {need[1]:.0f} mm is larger than its mold, "
            f"{room.width_mm:.0f} x {room.height_mm:.0f} mm on the printer's bed"
        )
    return refusal(strip, sensor, switches, land_mm=sizes.section.land_mm)


def _single(sensor: Sensor, switches: SwitchSet, marker: int) -> SwitchStrip:
    return make_strip(sensor, switches, np.array([marker]))


def _numbered(strips: list[SwitchStrip], switches: SwitchSet) -> Iterator[SwitchStrip]:
    """Give strips that are alike the same number, from 1."""
    known: list[SwitchStrip] = []
    for strip in strips:
        same = (k for k, other in enumerate(known) if congruent(other, strip, switches))
        at = next(same, len(known))
        if at == len(known):
            known.append(strip)
        yield replace(strip, number=at + 1)
