"""The switches of a design: which bowl each receptor gets and how long its stem is.

Everything that is made of switches (molds, tables, parts lists, assemblies) reads this one set.
A switch stands in its own frame: z along the outward normal, z = 0 on the shell's outer face, the
bowl above it and the stem below, down to the tip.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from phytac_design.geometry.triangles import TriangleMesh, sides_for, widening
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.switch.bowl import Bowl, walls
from phytac_design.mechanics.switch.soft_cup import SoftCup
from phytac_shapes.arrays import FloatArray, IntArray

LENGTH_STEP_mm = 0.1
"""Stems are made in steps of this, well below what printers and glue repeat."""


@dataclass(frozen=True, kw_only=True)
class CupOutline:
    """A membrane or plunger with its stem.

    Attributes
    ----------
    cup : SoftCup
        Side wall, roof and boss.
    stop_mm : float
        Height over the shell's face at which the stem's wide part, the stop, ends.
    stem_diameter_mm : float
        Diameter of the stem below.
    """

    cup: SoftCup
    stop_mm: float
    stem_diameter_mm: float

    @property
    def diameter_mm(self) -> float:
        """Outer diameter on the shell's face."""
        return self.cup.diameter_mm


@dataclass(frozen=True, kw_only=True)
class SwitchSet:
    """Switches of one sensor; of one without switches all arrays are empty.

    Attributes
    ----------
    bowls : tuple of Bowl or CupOutline
        One for each threshold.
    threshold_N : (b,) float
        Their thresholds.
    tip_diameter_mm : float
        Diameter of every stem's end; towards the bowl it grows to its ``stem_diameter_mm``.
    bowl : (n,) int
        Bowl of each marker.
    reach_mm : (n,) float
        From the shell's outer face down to the tip's end, exact.
    length : (n,) int
        Index into ``lengths_mm``.
    lengths_mm : (m,) float
        The reaches that are made, ascending, in steps of ``LENGTH_STEP_mm``.
    row : (n,) int or None
        Row of each marker, where every row has one length of its own.
    """

    bowls: tuple["Bowl | CupOutline", ...]
    threshold_N: FloatArray
    tip_diameter_mm: float
    bowl: IntArray
    reach_mm: FloatArray
    length: IntArray
    lengths_mm: FloatArray
    row: IntArray | None

    @property
    def body(self) -> str:
        """What stands on the outer face: the switches' family, or "switch" if they are of several.

        "bowl" if there are none.
        """
        families = {self.family(number) for number in range(len(self.bowls))} or {"bowl"}
        return families.pop() if len(families) == 1 else "switch"

    def family(self, number: int) -> str:
        """Family of one of ``bowls``."""
        shape = self.bowls[number]
        return shape.cup.family if isinstance(shape, CupOutline) else "bowl"

    @property
    def kinds(self) -> list[tuple[int, int]]:
        """Different switches as (bowl, length), in order."""
        return sorted(set(zip(self.bowl.tolist(), self.length.tolist(), strict=True)))

    def kind_of(self, marker: int) -> tuple[int, int]:
        """Kind of a marker's switch."""
        return int(self.bowl[marker]), int(self.length[marker])

    def markers_of(self, kind: tuple[int, int]) -> IntArray:
        """Ids of the markers that get a kind of switch."""
        return np.flatnonzero((self.bowl == kind[0]) & (self.length == kind[1]))

    def label(self, kind: tuple[int, int]) -> str:
        """Label of a kind of switch: a letter for its bowl and the number of its row.

        Where rows and lengths are not one to one the number counts lengths, shortest first.
        """
        number = kind[1] if self.row is None else int(self.row[self.markers_of(kind)[0]])
        return f"{chr(ord('A') + kind[0])}{number}"

    def profile(self, kind: tuple[int, int], tolerance_mm: float = 0.01) -> FloatArray:
        """Half section (k, 2) of a switch as (r, z), from the pad's middle around to the tip's."""
        shape, reach = self.bowls[kind[0]], float(self.lengths_mm[kind[1]])
        if isinstance(shape, CupOutline):
            return cup_profile(shape, reach, self.tip_diameter_mm)
        return switch_profile(shape, reach, self.tip_diameter_mm, tolerance_mm=tolerance_mm)


def reach_mm(sensor: Sensor) -> FloatArray:
    """From the shell's outer face along each receptor's axis to its resting red tip, (n,) mm."""
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    face_to_end = np.linalg.norm(markers.tip_mm - surface.point(markers.uv), axis=1)
    return np.asarray(face_to_end - design.switch.tip_recess_mm)


def make_switches(
    sensor: Sensor, made: Sequence[Mapping[str, Any]], threshold_N: FloatArray
) -> SwitchSet:
    """Set of switches from designed ones.

    Parameters
    ----------
    made : sequence of mappings
        ``threshold_N`` and ``bowl`` (its dimensions) of each, as the switch stage reports them; of
        a membrane or plunger ``cup``, ``stop_mm`` and ``stem_diameter_mm``, and what it is cast of.
    threshold_N : (n,) float
        Threshold of each marker's switch.
    """
    if not sensor.design.has_switches:
        none, ids = np.zeros(0), np.zeros(0, dtype=np.int64)
        return SwitchSet(
            bowls=(),
            threshold_N=none,
            tip_diameter_mm=sensor.design.switch.tip_diameter_mm,
            bowl=ids,
            reach_mm=none,
            length=ids,
            lengths_mm=none,
            row=None,
        )
    shapes = [_shape(item) for item in made]
    return arrange_switches(sensor, shapes, [item["threshold_N"] for item in made], threshold_N)


def _shape(made: Mapping[str, Any]) -> Bowl | CupOutline:
    """Bowl, or outline of a membrane or plunger, of a designed switch."""
    if "bowl" in made:
        return Bowl(**made["bowl"])
    return CupOutline(
        cup=SoftCup(**made["cup"]),
        stop_mm=made["stop_mm"],
        stem_diameter_mm=made["stem_diameter_mm"],
    )


def arrange_switches(
    sensor: Sensor,
    shapes: Sequence[Bowl | CupOutline],
    known_N: Sequence[float],
    threshold_N: FloatArray,
) -> SwitchSet:
    """Set of switches: each marker gets the shape whose threshold is nearest to its own."""
    design, markers = sensor.design, sensor.markers
    known = np.array(known_N)
    reach = reach_mm(sensor)
    steps = np.round(reach / LENGTH_STEP_mm).astype(np.int64)
    lengths, length = np.unique(steps, return_inverse=True)
    pairs = np.unique(np.stack([markers.row, length]), axis=1)
    one_to_one = markers.in_rows and pairs.shape[1] == len(lengths) == len(np.unique(pairs[0]))
    return SwitchSet(
        bowls=tuple(shapes),
        threshold_N=known,
        tip_diameter_mm=design.switch.tip_diameter_mm,
        bowl=np.abs(threshold_N[:, None] - known).argmin(axis=1),
        reach_mm=reach,
        length=length,
        lengths_mm=np.asarray(lengths * LENGTH_STEP_mm, dtype=np.float64),
        row=markers.row if one_to_one else None,
    )


@lru_cache(maxsize=256)
def switch_profile(
    bowl: Bowl, reach: float, tip_diameter_mm: float, *, tolerance_mm: float = 0.01
) -> FloatArray:
    """Half section (k, 2) of a switch, (r, z) mm, its ends on the axis.

    From the middle of the pad over the bowl's outer side to its rim, back along the underside and
    down the stem, which tapers evenly to the tip.
    """
    fine = 400  # points along each side of a bowl before those that a line needs are chosen
    under, over, stem = walls(bowl, fine, fine)
    side = stem[:, 0] <= 0.5 * bowl.stem_diameter_mm + 1e-9
    # The stem tapers from where its fillet begins.
    curl = stem[np.flatnonzero(side)[-1] :][::-1]
    bent = np.concatenate([over, under[::-1], curl[1:]])
    corner = len(over) - 1
    pieces = [_thinned(bent[: corner + 1], 0.3 * tolerance_mm)]
    pieces.append(_thinned(bent[corner + 1 :], 0.3 * tolerance_mm))
    pieces.insert(0, np.array([[0.0, over[0, 1]]]))
    tip = [[0.5 * tip_diameter_mm, -reach], [0.0, -reach]]
    profile = np.concatenate([*pieces, np.array(tip)])
    profile.flags.writeable = False
    return profile


def cup_profile(outline: CupOutline, reach: float, tip_diameter_mm: float) -> FloatArray:
    """Half section (k, 2) of a membrane or plunger, (r, z) mm, as :func:`switch_profile` has it.

    Boss and stop lean by the draft of the side wall, as they leave the mold.
    """
    cup = outline.cup
    slope = float(np.tan(np.radians(cup.draft_deg)))
    rho, high, roof = cup.fillet_mm, cup.height_mm, cup.height_mm + cup.roof_mm
    outer, hub = 0.5 * cup.diameter_mm, 0.5 * cup.hub_diameter_mm
    inner = outer - cup.side_mm
    over: list[Any] = [[[0.0, cup.top_mm]]]
    if cup.boss_mm:
        foot = np.array([hub + slope * (cup.boss_mm - rho) + rho, roof + rho])
        over += [[[hub, cup.top_mm]], _fillet(foot, rho, 180.0, 270.0)]
    over += [[[outer - slope * roof, roof], [outer, 0.0]]]
    turn = np.array([inner - slope * (high - rho) - rho, high - rho])
    under: list[Any] = [[[inner, 0.0]], _fillet(turn, rho, 0.0, 90.0)]
    if outline.stop_mm < high - rho:
        root = np.array([hub + slope * (high - rho - outline.stop_mm) + rho, high - rho])
        under += [_fillet(root, rho, 90.0, 180.0), [[hub, outline.stop_mm]]]
    tip = 0.5 * tip_diameter_mm
    stem = [[0.5 * outline.stem_diameter_mm, outline.stop_mm], [tip, -reach], [0.0, -reach]]
    return np.concatenate([*over, *under, stem])


def _fillet(centre: FloatArray, radius: float, start_deg: float, end_deg: float) -> FloatArray:
    angle = np.radians(np.linspace(start_deg, end_deg, 25))
    return np.asarray(centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def _thinned(line: FloatArray, tolerance_mm: float) -> FloatArray:
    """Fewest of the points (k, 2) of a line that stay within a distance of it; ends are kept."""
    keep = np.zeros(len(line), dtype=bool)
    keep[[0, -1]] = True
    parts = [(0, len(line) - 1)]
    while parts:
        start, end = parts.pop()
        way = line[end] - line[start]
        off = line[start + 1 : end] - line[start]
        aside = np.abs(off[:, 0] * way[1] - off[:, 1] * way[0]) / np.hypot(*way)
        if len(aside) and aside.max() > tolerance_mm:
            middle = start + 1 + int(aside.argmax())
            keep[middle] = True
            parts += [(start, middle), (middle, end)]
    return line[keep]


def revolve(
    profile: FloatArray, tolerance_mm: float = 0.01, *, sides: int | None = None
) -> TriangleMesh:
    """Solid of revolution of a half section (k, 2) whose ends lie on the axis; equal-area sides.

    Parameters
    ----------
    profile : (k, 2) float
        (r, z), clockwise seen with r to the right: the solid lies to the right of the way.
    tolerance_mm : float
        Largest distance to the true surface.
    sides : int, optional
        Corners of each ring, instead.
    """
    sides = sides or sides_for(float(profile[:, 0].max()), tolerance_mm)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    inner = profile[1:-1]
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate(
        [
            (widening(sides) * inner[:, None, :1]) * ring[None],
            np.broadcast_to(inner[:, None, 1:], (len(inner), sides, 1)),
        ],
        axis=2,
    ).reshape(-1, 3)
    ids = np.arange(len(inner) * sides).reshape(len(inner), sides)
    after = np.roll(ids, -1, axis=1)
    a, b, c, d = ids[:-1].ravel(), after[:-1].ravel(), after[1:].ravel(), ids[1:].ravel()
    first, last = len(points), len(points) + 1
    ends = [
        np.column_stack([np.full(sides, first), ids[0], after[0]]),
        np.column_stack([np.full(sides, last), after[-1], ids[-1]]),
    ]
    return TriangleMesh(
        vertices_mm=np.concatenate(
            [points, [[0.0, 0.0, profile[0, 1]], [0.0, 0.0, profile[-1, 1]]]]
        ),
        triangles=np.concatenate([np.column_stack([a, d, c]), np.column_stack([a, c, b]), *ends]),
    )


def revolved_volume_mm3(profile: FloatArray) -> float:
    """Volume of the solid of revolution of a half section, exact for its straight pieces."""
    (r0, z0), (r1, z1) = profile[:-1].T, profile[1:].T
    return float(-np.sum((z1 - z0) * (r0**2 + r0 * r1 + r1**2)) * np.pi / 3.0)
