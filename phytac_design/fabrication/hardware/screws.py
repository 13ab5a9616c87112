"""Screws by the standard, and joints: one object makes the holes of both parts and the screw."""

from dataclasses import dataclass

import numpy as np

from phytac_design.fabrication.hardware.solid_nodes import Node, Point3, Rod
from phytac_shapes.errors import DesignError

END_mm = 0.3
"""A blind hole is at least this much deeper than the screw."""
TOUCH_mm = 0.05
"""Gap between faces that touch: parts are drawn just clear of each other."""


@dataclass(frozen=True, kw_only=True)
class Screw:
    """A metric screw: ISO 4762 (cap head) and ISO 4026 (set screw, flat point), mm.

    Attributes
    ----------
    name : str
        Such as ``"M2.5"``.
    nominal_mm, minor_mm : float
        Diameter over the thread and at its root (d3, ISO 724).
    clearance_mm : float
        Hole that it passes (ISO 273, medium).
    tap_mm : float
        Hole that is tapped (coarse thread).
    insert_mm, insert_length_mm : float
        Hole and length of a common heat-set insert; makers differ.
    head_mm, head_height_mm : float
        Cap head (ISO 4762).
    lengths_mm, set_lengths_mm : tuple of float
        Standard lengths of cap and of set screws.
    """

    name: str
    nominal_mm: float
    minor_mm: float
    clearance_mm: float
    tap_mm: float
    insert_mm: float
    insert_length_mm: float
    head_mm: float
    head_height_mm: float
    lengths_mm: tuple[float, ...]
    set_lengths_mm: tuple[float, ...]

    def hole_mm(self, thread: str) -> float:
        """Diameter of the hole on the thread's side."""
        return self.tap_mm if thread == "tapped" else self.insert_mm

    def engaged_mm(self, thread: str) -> float:
        """Least length of thread that holds."""
        engaged = 1.5  # least thread in a tapped plastic part, in nominal diameters
        return engaged * self.nominal_mm if thread == "tapped" else self.insert_length_mm

    def length_mm(self, least: float, what: str) -> float:
        """Shortest standard length from ``least`` on.

        Raises
        ------
        DesignError
            If the standard has none.
        """
        for length in self.lengths_mm:
            if length >= least - 1e-9:
                return length
        raise DesignError(
            "screw-too-short",
            f"no {self.name} screw is long enough for {what}: it needs {least:.1f} mm, the longest "
            f"has {self.lengths_mm[-1]:g} mm; choose a thicker screw or lower "
            "hardware.back_room_mm",
        )


def _screw(name: str, *sizes: float, lengths: str, sets: str) -> Screw:
    nominal, minor, clearance, tap, insert, insert_length, head = sizes
    return Screw(
        name=name,
        nominal_mm=nominal,
        minor_mm=minor,
        clearance_mm=clearance,
        tap_mm=tap,
        insert_mm=insert,
        insert_length_mm=insert_length,
        head_mm=head,
        head_height_mm=nominal,
        lengths_mm=tuple(float(word) for word in lengths.split()),
        set_lengths_mm=tuple(float(word) for word in sets.split()),
    )


SCREWS: dict[str, Screw] = {
    screw.name: screw
    for screw in (
        _screw("M2", 2.0, 1.509, 2.4, 1.6, 3.2, 4.0, 3.8,
               lengths="3 4 5 6 8 10 12 16 20", sets="2 2.5 3 4 5 6 8 10"),
        _screw("M2.5", 2.5, 1.948, 2.9, 2.05, 4.0, 5.7, 4.5,
               lengths="4 5 6 8 10 12 16 20 25", sets="2.5 3 4 5 6 8 10 12"),
        _screw("M3", 3.0, 2.387, 3.4, 2.5, 4.0, 5.7, 5.5,
               lengths="5 6 8 10 12 16 20 25 30", sets="3 4 5 6 8 10 12 16"),
        _screw("M4", 4.0, 3.141, 4.5, 3.3, 5.6, 8.1, 7.0,
               lengths="6 8 10 12 16 20 25 30 35 40", sets="4 5 6 8 10 12 16 20"),
        _screw("M5", 5.0, 4.019, 5.5, 4.2, 6.4, 9.5, 8.5,
               lengths="8 10 12 16 20 25 30 35 40 45 50", sets="5 6 8 10 12 16 20 25"),
        _screw("M6", 6.0, 4.773, 6.6, 5.0, 8.0, 12.7, 10.0,
               lengths="10 12 16 20 25 30 35 40 45 50 55 60", sets="6 8 10 12 16 20 25 30"),
    )
}  # fmt: skip
"""By name."""


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Equal screws that hold one part on another.

    Attributes
    ----------
    name : str
        What it joins.
    screw : Screw
        Its size.
    thread : str
        ``tapped``, ``heat-set``, or ``set`` for a set screw that presses on a face.
    head_part, thread_part : str
        Part that the screw passes, and part that holds its thread; parts' names.
    seats_mm : tuple of points
        Under each head (``set``: the screw's point).
    direction : point
        From the head to the screw's end, unit; of each screw in turn for ``set``.
    grip_mm : float
        From under the head to where the thread begins; for ``set`` from the point to the thread.
    length_mm : float
        Standard length.
    depth_mm : float
        Of the threaded hole.
    """

    name: str
    screw: Screw
    thread: str
    head_part: str
    thread_part: str
    seats_mm: tuple[Point3, ...]
    directions: tuple[Point3, ...]
    grip_mm: float
    length_mm: float
    depth_mm: float

    def _on(self, index: int, way_mm: float) -> Point3:
        seat, way = np.array(self.seats_mm[index]), np.array(self.directions[index])
        x, y, z = seat + way_mm * way
        return (float(x), float(y), float(z))

    def _rods(self, start_mm: float, end_mm: float, diameter_mm: float) -> tuple[Node, ...]:
        return tuple(
            Rod(self._on(i, start_mm), self._on(i, end_mm), diameter_mm / 2.0)
            for i in range(len(self.seats_mm))
        )

    def passing(self) -> tuple[Node, ...]:
        """Holes in the parts that the screws pass, right through them."""
        return self._rods(-1.0, self.grip_mm, self.screw.clearance_mm)

    def holding(self) -> tuple[Node, ...]:
        """Holes in the part that holds the thread."""
        if self.thread == "set":
            return self._rods(-self.grip_mm - self.depth_mm - 1.0, 0.0, self.screw.tap_mm)
        diameter = self.screw.hole_mm(self.thread)
        # Cutters begin before the face: faces never coincide.
        return self._rods(self.grip_mm - 0.2, self.grip_mm + self.depth_mm, diameter)

    def screws(self) -> tuple[tuple[Node, ...], ...]:
        """Solids of each screw: head, shank, and the thread at its root's diameter."""
        screw = self.screw
        if self.thread == "set":
            return tuple((rod,) for rod in self._rods(-self.length_mm, 0.0, screw.minor_mm))
        heads = self._rods(-screw.head_height_mm - TOUCH_mm, -TOUCH_mm, screw.head_mm)
        shanks = self._rods(-TOUCH_mm - 0.1, self.grip_mm - 0.1, screw.nominal_mm)
        ends = self._rods(self.grip_mm - 0.2, self.length_mm - TOUCH_mm, screw.minor_mm)
        return tuple(zip(heads, shanks, ends, strict=True))

    def probes(self) -> tuple[tuple[Point3, ...], tuple[Point3, ...]]:
        """Points on the axes inside the passing holes and inside the holding ones."""
        count = range(len(self.seats_mm))
        if self.thread == "set":
            return (), tuple(self._on(i, -self.grip_mm - 0.5 * self.depth_mm) for i in count)
        # Near the head: whatever lies between (a board) is not this part.
        passing = tuple(self._on(i, 0.4) for i in count)
        return passing, tuple(self._on(i, self.grip_mm + 0.5 * self.depth_mm) for i in count)


def through(
    screw: Screw, thread: str, *, grip_mm: float, depth_mm: float, what: str
) -> tuple[float, float]:
    """Standard length of a screw, and how much thicker the head's side must be for it.

    ``depth_mm`` is the most the threaded hole can be deep.

    Raises
    ------
    DesignError
        If the thread's side has no room, or no screw is long enough.
    """
    engaged = screw.engaged_mm(thread)
    if depth_mm - END_mm < engaged - 1e-9:
        raise DesignError(
            "screw-thread-too-short",
            f"the {screw.name} screws of {what} do not fit: their thread needs {engaged:.1f} mm, "
            f"the part has {depth_mm - END_mm:.1f} mm; choose a smaller screw or raise "
            "hardware.wall_mm",
        )
    length = screw.length_mm(grip_mm + engaged, what)
    return length, max(0.0, length - (grip_mm + depth_mm - END_mm))
