r"""Triangles of everything the camera can see, each with a part code.

A receptor is one solid of revolution about the line from its base to its tip; depth is measured
from the end face back towards the wall::

      wall  |  resin side    | painted band |
     -------+----------------+==============+  R
            |                               ‖  painted end face
            |      hole      ·---------·    +  r
     - - - -|- - - - - - - - |red tip  | - - - - axis, towards the camera's axis
                             ·---------·
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phytac_design.core.kernels import kernel
from phytac_design.design.fixture_table import AnyFixture, BoxFixture, CylinderFixture
from phytac_design.design.paints_table import NOMINAL_PAINTS, PaintsSection
from phytac_design.design.spec import Design
from phytac_design.geometry.envelope import bar_mesh, shell_mesh
from phytac_design.geometry.triangles import TriangleMesh, cylinder_mesh, merged
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray

NONE, SHELL, BAR, RESIN = 0, 1, 2, 3
"""Part codes: nothing, shell and rims, light bar, unpainted receptor (side, hole, hole's end)."""
FIRST_FIXTURE = 4
"""Codes from here up to ``FIRST_MARKER``: the design's fixtures."""
FIRST_MARKER = 16
"""Codes from here: ``16 + 2 i`` is the paint of marker i, ``17 + 2 i`` its switch's red tip.
Negative codes are reference marks: ``-1 - k`` is mark k."""


@dataclass(frozen=True, kw_only=True)
class RenderScene:
    """A triangle soup in the sensor frame; shapes: V vertices, T triangles, n markers.

    Attributes
    ----------
    vertices : (V, 3) float64
        Positions, mm.
    triangles : (T, 3) int32
        Vertex indices; both sides are visible.
    part : (T,) int32
        Part code (see ``SHELL``, ``BAR``, ``RESIN``, ``FIRST_MARKER``).
    vertex_owner : (V,) int32
        Marker that the vertex moves with; -1 for fixed parts.
    colour : (n,) int64
        Index of each marker's paint in ``paints``.
    paints : tuple of str
        Names of the markers' paints, keys of ``paint.PAINTS``.
    marks : int
        Number of reference marks, which have the first paint.
    table : PaintsSection
        What paints and resin look like.
    closed : bool
        Whether receptors and their tips are closed, their triangles turned the same way: faces that
        look away from the camera are then hidden.
    """

    vertices: FloatArray
    triangles: NDArray[np.int32]
    part: NDArray[np.int32]
    vertex_owner: NDArray[np.int32]
    colour: IntArray
    paints: tuple[str, ...]
    marks: int = 0
    table: PaintsSection = NOMINAL_PAINTS
    closed: bool = False

    @property
    def count(self) -> int:
        """Number of markers."""
        return len(self.colour)

    @property
    def spot_colour(self) -> IntArray:
        """Index of the paint of each marker, then of each reference mark, (n + r,)."""
        return np.append(self.colour, np.zeros(self.marks, dtype=np.int64))

    @property
    def triangle_owner(self) -> NDArray[np.int32]:
        """Marker that each triangle belongs to, (T,); -1 for fixed parts."""
        owner: NDArray[np.int32] = self.vertex_owner[self.triangles[:, 0]]
        return owner

    def part_of(self, chosen: IntArray) -> "RenderScene":
        """Scene of the ``chosen`` triangles and their vertices; markers keep their numbers."""
        vertices, index = np.unique(self.triangles[chosen], return_inverse=True)
        return replace(
            self,
            vertices=self.vertices[vertices],
            triangles=index.reshape(-1, 3).astype(np.int32),
            part=self.part[chosen],
            vertex_owner=self.vertex_owner[vertices],
            closed=False,
        )

    def moved(
        self, translation: FloatArray, rotation: FloatArray, pivots: FloatArray
    ) -> "RenderScene":
        """Scene with each receptor moved as a rigid body; shell and bar stay.

        ``p' = pivot + R(rotation) (p - pivot) + translation``, with the exact rotation.

        Parameters
        ----------
        translation : (n, 3) float
            Displacement of each pivot, mm.
        rotation : (n, 3) float
            Rotation vector, rad.
        pivots : (n, 3) float
            Usually ``markers.mid_mm``, the mesh nodes.
        """
        turns = Rotation.from_rotvec(rotation).as_matrix() - np.eye(3)
        translation, pivots = (np.asarray(each, dtype=np.float64) for each in (translation, pivots))
        vertices = self.vertices.copy()
        _move(vertices, self.vertex_owner, turns, translation, pivots)
        return replace(self, vertices=vertices)


@kernel
def _move(
    vertices: FloatArray,
    owner: NDArray[np.int32],
    turns: FloatArray,
    translation: FloatArray,
    pivots: FloatArray,
) -> None:
    """Move the vertices of receptors; ``turns`` (n, 3, 3) are their rotations less 1."""
    for v in range(len(vertices)):
        k = owner[v]
        if k < 0:
            continue
        x, y, z = vertices[v] - pivots[k]
        for i in range(3):
            # Adding the change, not the sum of all parts, keeps a zero motion exact; x and z first
            # gives the very bits that numpy.einsum gave.
            change = turns[k, i, 0] * x + turns[k, i, 2] * z + turns[k, i, 1] * y
            vertices[v, i] += change + translation[k, i]


def paint_owner(part: NDArray[np.int32]) -> NDArray[np.int32]:
    """Marker whose *paint* each part code is, same shape; -1 for anything else."""
    return _owner(part, 0)


def red_owner(part: NDArray[np.int32]) -> NDArray[np.int32]:
    """Marker whose *red tip* each part code is, same shape; -1 for anything else."""
    return _owner(part, 1)


def spot_owner(part: NDArray[np.int32], count: int) -> NDArray[np.int32]:
    """Marker whose paint each part code is, or ``count`` + k for reference mark k; else -1."""
    return np.where(part < 0, count - 1 - part, paint_owner(part)).astype(np.int32)


def _owner(part: NDArray[np.int32], kind: int) -> NDArray[np.int32]:
    owner = np.empty(part.shape, dtype=np.int32)
    _write_owner(part.ravel(), kind, owner.ravel())
    return owner


@kernel
def _write_owner(part: NDArray[np.int32], kind: int, owner: NDArray[np.int32]) -> None:
    """Write the markers of part codes (m,) that are paint (0) or red (1)."""
    for k in range(len(part)):
        mine = part[k] >= FIRST_MARKER and part[k] & 1 == kind
        owner[k] = (part[k] - FIRST_MARKER) >> 1 if mine else -1


def sides_of(radius_mm: float, tolerance_mm: FloatArray) -> IntArray:
    """Sides (n,) of polygons on a circle that stay within tolerances (n,) of it; multiples of 4."""
    sides_min = 12
    ratio = np.clip(tolerance_mm / radius_mm, 1e-7, 0.5)
    quarter = np.ceil(np.pi / np.arccos(1.0 - ratio) / 4.0).astype(np.int64)
    return np.maximum(sides_min, 4 * quarter)


def build_scene(
    sensor: Sensor,
    *,
    tolerance_mm: FloatArray | float,
    switch_on: BoolArray | None = None,
    marks: bool = True,
    wall_cell_mm: float = np.inf,
    hollow: bool = True,
) -> RenderScene:
    """Shell, rims, light bar, fixtures, reference marks and all receptors as triangles.

    Parameters
    ----------
    tolerance_mm : float or (n,) float
        Largest distance between a receptor's polygons and the circles that they approximate; the
        minimum applies to shell, bar and fixtures. See ``cameras.tolerance_mm``.
    switch_on : (n,) bool, optional
        Switches whose red tip is out; none by default.
    marks : bool
        Whether reference marks are painted.
    wall_cell_mm : float
        Longest side of the inner face's cells, where it is to move (:mod:`.pressed_scene`).
    hollow : bool
        Whether receptors have the inside of their holes, and their tips. Without it they end flat,
        which hides as much behind them while the tips are in.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    on = np.zeros(markers.count, dtype=bool) if switch_on is None else np.asarray(switch_on)
    tolerance = np.broadcast_to(np.asarray(tolerance_mm, dtype=np.float64), markers.count)
    least = float(tolerance.min())
    shell_tolerance = min(least, 0.1 * float(markers.height_mm.min()))
    fixed = [
        (
            shell_mesh(design, surface, tolerance_mm=shell_tolerance, longest_mm=wall_cell_mm),
            SHELL,
        ),
        (bar_mesh(design, surface, tolerance_mm=least), BAR),
        *(
            (fixture_mesh(fixture, tolerance_mm=least), FIRST_FIXTURE + number)
            for number, fixture in enumerate(design.fixtures)
        ),
    ]
    sides = sides_of(design.receptor.diameter_tube_mm / 2.0, tolerance)
    groups = [
        _receptors(design, markers, on, np.flatnonzero(sides == value), int(value), hollow)
        for value in np.unique(sides)
    ]
    codes = [np.full(len(mesh.triangles), code, dtype=np.int32) for mesh, code in fixed]
    painted = sensor.reference_marks.count if marks else 0
    if painted:
        # A layer of paint, clear of the chords of the wall's facets.
        dots = sensor.reference_marks.mesh(0.02 + 2.0 * shell_tolerance, surface, design)
        fixed.append((dots, NONE))
        code = -1 - np.arange(painted, dtype=np.int32)
        codes.append(np.repeat(code, len(dots.triangles) // painted))
    whole = merged([mesh for mesh, _ in fixed] + [mesh for mesh, _, _ in groups])
    owners = [np.full(len(mesh.vertices_mm), -1, dtype=np.int32) for mesh, _ in fixed]
    return RenderScene(
        vertices=whole.vertices_mm,
        triangles=whole.triangles.astype(np.int32),
        part=np.concatenate([*codes, *(part for _, part, _ in groups)]),
        vertex_owner=np.concatenate([*owners, *(owner for _, _, owner in groups)]),
        colour=markers.colour,
        paints=tuple(design.layout.colours),
        table=design.paints,
        marks=painted,
        closed=True,
    )


def _receptors(
    design: Design, markers: Markers, on: BoolArray, chosen: IntArray, sides: int, hollow: bool
) -> tuple[TriangleMesh, NDArray[np.int32], NDArray[np.int32]]:
    """Chosen receptors: mesh, part of each triangle, owner of each vertex; marker after marker."""
    tip, normal = markers.tip_mm[chosen], markers.normal[chosen]
    axis = tip - markers.base_mm[chosen]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(axis, normal), axis=1)
    slope = sine / np.maximum(np.abs(np.sum(axis * normal, axis=1)), 1e-12)
    radius, depth = _profile(design, markers.height_mm[chosen], on[chosen], slope)
    foot = depth.shape[1] - 9  # 1 more ring where the tube is wider than the marker
    if design.has_switches and not hollow:
        radius, depth = radius[:, : foot + 5], depth[:, : foot + 5]
        radius[:, -1], depth[:, -1] = 0.0, depth[:, -2]
    n, rings = depth.shape
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    third = np.cross(axis, across)
    turn = 2.0 * np.pi * np.arange(sides) / sides
    around = np.cos(turn)[:, None] * across[:, None] + np.sin(turn)[:, None] * third[:, None]
    centre = tip[:, None] - depth[:, :, None] * axis[:, None]
    vertices = centre[:, :, None] + radius[:, :, None, None] * around[:, None]  # (n, ring, side)
    # Strips between two rings; the code is added to twice the marker id where it is a marker's.
    paint, red = FIRST_MARKER, FIRST_MARKER + 1
    strips = [(k, k + 1, RESIN) for k in range(foot + 1)]
    strips += [(foot + 1, foot + 2, paint), (foot + 2, foot + 3, paint)]
    if design.has_switches and not hollow:
        strips.append((foot + 3, foot + 4, RESIN))
    elif design.has_switches:
        inside = ((3, 4, RESIN), (4, 5, RESIN), (6, 7, red), (7, 8, red))
        strips += [(foot + low, foot + high, value) for low, high, value in inside]
    here, step = np.arange(sides), (np.arange(sides) + 1) % sides
    faces, codes = [], []
    for low, high, value in strips:
        a, b = low * sides + here, low * sides + step
        c, d = high * sides + here, high * sides + step
        strip = [np.column_stack([a, b, c])]
        if radius[:, high].any():
            strip.append(np.column_stack([b, d, c]))
        faces.extend(strip)
        codes.append(np.full(sides * len(strip), value, dtype=np.int32))
    template, code = np.concatenate(faces), np.concatenate(codes)
    base = (np.arange(n) * rings * sides)[:, None, None]
    marker = chosen.astype(np.int32)
    part = code[None] + np.where(code >= FIRST_MARKER, 2, 0)[None] * marker[:, None]
    mesh = TriangleMesh(
        vertices_mm=vertices.reshape(-1, 3),
        triangles=(template[None] + base).reshape(-1, 3),
    )
    return mesh, part.reshape(-1).astype(np.int32), np.repeat(marker, rings * sides)


def _profile(
    design: Design, height: FloatArray, on: BoolArray, slope: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Radius and depth behind the end face of the rings of receptors, (n, 9) mm each.

    The base is sunk by half the wall, and by the lift of one side of a receptor that leans from
    the normal (``slope``: tangent of the angle), so that no light passes under it. The red
    side is one stroke and one recess long; the hole is closed behind it. Of an insert a tube holds
    all but the coloured band: there are 10 rings, and glue fills the gap between the two.
    """
    outer, hole = design.receptor.diameter_outer_mm / 2.0, design.receptor.diameter_hole_mm / 2.0
    tip = design.switch.tip_diameter_mm / 2.0
    switch = design.switch
    base = height + design.wall.thickness_mm / 2.0 + outer * slope
    band = np.minimum(design.receptor.band_marker_mm, height)
    front = switch.tip_recess_mm - np.where(on, switch.stroke_mm, 0.0)
    back = front + switch.stroke_mm + switch.tip_recess_mm
    face = np.zeros_like(height)
    radii = [outer, outer, outer, hole, hole, 0.0, tip, tip, 0.0]
    depths = [base, band, face, face, back, back, back, front, front]
    if not design.receptor.has_inserts:
        return np.tile(radii, (len(height), 1)), np.stack(depths, axis=1)
    tube = np.where(height > band, design.receptor.diameter_tube_mm / 2.0, outer)
    wide = base + (tube - outer) * slope
    radius = np.column_stack([tube, tube, np.tile(radii[1:], (len(height), 1))])
    return radius, np.stack([wide, band, *depths[1:]], axis=1)


def fixture_mesh(fixture: AnyFixture, *, tolerance_mm: float) -> TriangleMesh:
    """Triangles of one fixture; polygons stay within ``tolerance_mm`` of their circles."""
    # Corners of a box's faces; corner 4 i + 2 j + k lies at its low (0) or high (1) x, y, z.
    corners = np.array(
        [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    )
    if isinstance(fixture, CylinderFixture):
        return cylinder_mesh(
            np.array(fixture.from_mm),
            np.array(fixture.to_mm),
            fixture.radius_mm,
            tolerance_mm=tolerance_mm,
        )
    if isinstance(fixture, BoxFixture):
        triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
        return TriangleMesh(vertices_mm=_corners(fixture), triangles=triangles)
    return TriangleMesh(
        vertices_mm=np.array(fixture.vertices_mm, dtype=np.float64),
        triangles=np.array(fixture.triangles, dtype=np.int64),
    )


def _corners(box: BoxFixture) -> FloatArray:
    """Corners (8, 3) of a box."""
    sign = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    half = sign * np.array(box.size_mm) / 2.0
    c, s = np.cos(np.radians(box.turn_deg)), np.sin(np.radians(box.turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(np.array(box.centre_mm) + half @ turn.T)
