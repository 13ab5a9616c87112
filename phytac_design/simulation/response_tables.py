"""Tables of what contacts at any place do to the markers' images, by the decoder's own mesh.

Linear theory gives the first power of the force, Koiter's expansion or large displacements
the others; the camera is the true lens, and receptors turn with the wall's inner
face.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import factorial
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from phytac_decoder.io.bundle_locator import PLACES_MIN
from phytac_decoder.mechanics.interaction_table import InteractionTable
from phytac_decoder.mechanics.response_table import (
    FLATNESS_NEIGHBOURS,
    TERMS,
    ResponseTable,
)
from phytac_design.layout import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.meshing.mesh import ShellMesh
from phytac_design.mechanics.shell.compliance import column_turn
from phytac_design.mechanics.shell.discretisation import force_ratio
from phytac_design.mechanics.shell.pressure import tangent_frame
from phytac_design.mechanics.shell.solve import ShellModel
from phytac_design.simulation.flat_walls import add_membrane_walls
from phytac_design.simulation.interaction_tables import (
    SETTINGS,
    InteractionSolver,
    pair_spacing_mm,
)
from phytac_design.simulation.mesh_pair import MeshPair
from phytac_design.simulation.pressed_series import (
    DiscResponse,
    ExtrapolatedResponse,
    ImageResponse,
    scaled_powers,
)
from phytac_design.simulation.turned_places import (
    SectorSymmetry,
    rings,
    sectors_of,
    symmetry_of,
    turned_motion,
)
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import DesignError

NearScene = Callable[[float, FloatArray], BoolArray]
"""(spacing mm, places (p, 2) so far apart) -> which of them are wanted, (p,)."""
HIGHER_ORDER_SPACING = 2.0
"""Distance of places at which the higher powers of the force, and force along the surface, are
solved, over that of places: they are a small part of the shifts, and are interpolated."""

CORRECTION_SPACING_MAX = 0.85
"""Distance of those places over the patches' radius up to which the correction of linear motion, by
extrapolation over meshes, is interpolated between them. At 1.6, shifts would be 0.5 % off because
of that, and 2 to 3 % beside rims."""


NONE = np.zeros(0)
"""Forces of motions that are linear."""


def everywhere(_: float, uv: FloatArray) -> BoolArray:
    """All places (p, 2) are wanted, (p,)."""
    return np.ones(len(uv), dtype=np.bool_)


@dataclass(frozen=True, kw_only=True)
class TabulatedResponse:
    """Tables, and how they came about.

    Attributes
    ----------
    places : Places
        The tables.
    solves : int
        Places solved; the others are turned copies.
    bent : int
        Places at which the higher powers of the force were found.
    large : int
        Of these, those solved with large displacements.
    spacing_mm : float
        What places are at most apart.
    unsure : int
        Of these, those whose series says nothing at the greatest force, and that were not solved:
        linear ones stand there.
    give : list of float
        How far the edges of each flat wall hold it, see :mod:`walls`; 1 where they hold still.
    claimed : list of float
        Claimed error of the linear motion because of the meshes, at each place solved
        (:class:`.pressed_series.ExtrapolatedResponse`); none where it is not extrapolated.
    """

    places: ResponseTable
    solves: int
    bent: int
    large: int
    unsure: int
    spacing_mm: float
    give: list[float]
    claimed: list[float]


def place_spacing_mm(surface: Surface, share: float, radius_mm: float) -> float:
    """What places are at most apart, by their distance over the patches' radius (mm)."""
    # Median angle between the walls at neighbouring places from which on they are close enough. On
    # flatter walls markers show the wall's slope rather than its motion, which changes sooner.
    flat_angle_rad = 0.1
    flat_refinement = 2.0  # how much closer places stand there
    spacing = share * radius_mm
    uv = rings(surface, spacing, 1).uv
    normal = np.cross(*tangent_frame(surface, uv))
    # The nearest is each place itself.
    _, near = cKDTree(surface.point(uv)).query(
        surface.point(uv), k=min(FLATNESS_NEIGHBOURS, len(uv))
    )
    cosine = np.einsum("pqi,pi->pq", normal[near], normal).min(axis=1)
    flatter = float(np.median(cosine)) > np.cos(flat_angle_rad)
    return spacing / flat_refinement if flatter else spacing


@dataclass(frozen=True, kw_only=True)
class _Grid:
    """Tables over places of a surface, of which the turned copies of solved ones are not solved.

    Attributes
    ----------
    surface, markers : Surface, Markers
        The sensor.
    radius_mm : float
        Of the discs.
    sectors, turn : int, (3, 3) float or None
        Sectors by which the shell repeats itself around, and the rotation by one.
    near : NearScene
        Which places are wanted.
    """

    loads: ClassVar[int] = 32
    """Places solved together."""

    surface: Surface
    markers: Markers
    radius_mm: float
    sectors: int
    turn: FloatArray | None
    near: NearScene
    progress: Callable[[str], None]

    def table(
        self,
        apart_mm: float,
        count: int,
        solve: Callable[[FloatArray], list[list[FloatArray]]],
        image: Callable[[list[FloatArray]], FloatArray],
        what: str = "",
    ) -> tuple[ResponseTable, FloatArray, int]:
        """Table of ``count`` rows a place, its places (p, 2), and how many were solved.

        Parameters
        ----------
        apart_mm : float
            What places are at most apart.
        solve : callable
            Motions (n, 6) of markers, of each of places (c, 2).
        image : callable
            Rows (k, 2n) of shifts by the motions of one place, k up to ``count``.
        what : str
            What is solved, for the progress.
        """
        ring = rings(self.surface, apart_mm, self.sectors)
        wanted = np.flatnonzero(self.near(apart_mm, ring.uv))
        if len(wanted) < PLACES_MIN:
            raise DesignError(
                "response-places-too-few",
                f"the given part of the surface holds {len(wanted)} places of the tables, "
                f"{apart_mm:.2g} mm apart; it takes {PLACES_MIN}: widen it",
            )
        solved = np.unique(ring.base[wanted])
        copies = [np.flatnonzero(ring.base[wanted] == base) for base in solved]
        out = np.zeros((len(wanted), count, 2 * self.markers.count), dtype=np.float32)
        for first in range(0, len(solved), self.loads):
            batch = solved[first : first + self.loads]
            for rows, motions in zip(
                copies[first : first + self.loads], solve(ring.uv[batch]), strict=True
            ):
                for row in rows:
                    shifts = image(self._turned(motions, int(ring.turns[wanted[row]])))
                    out[row, : len(shifts)] = shifts
            self.progress(f"places: {min(first + self.loads, len(solved))} of {len(solved)}{what}")
        uv = ring.uv[wanted]
        along, around = tangent_frame(self.surface, uv)
        places = ResponseTable(
            point_mm=self.surface.point(uv),
            along=along,
            around=around,
            shift_px=out,
            radius_mm=self.radius_mm,
        )
        return places, uv, len(solved)

    def _turned(self, motions: list[FloatArray], times: int) -> list[FloatArray]:
        """Motions (n, 6) of loads that are turned by some sectors."""
        if self.turn is None or self.markers.lattice is None or times == 0:
            return motions
        turn = np.linalg.matrix_power(self.turn, times)
        columns = self.markers.lattice.columns
        step = times * (columns // self.sectors)
        return [turned_motion(each, turn, columns, step) for each in motions]


def tabulate_responses(
    sensor: Sensor,
    *,
    mesh: ShellMesh,
    model: ShellModel,
    see: ImageResponse,
    spacing_mm: float,
    orders: int,
    near: NearScene = everywhere,
    pair: MeshPair | None = None,
    bytes_max: float = 400e6,
    progress: Callable[[str], None] = lambda _: None,
) -> TabulatedResponse:
    """Tables over the whole surface, or a part of it.

    Where the shell repeats itself around (checked), the places of one column are solved and turned.

    Parameters
    ----------
    design, surface, markers : Design, Surface, Markers
        The sensor.
    mesh, model : ShellMesh, ShellModel
        The decoder's own shell.
    see : ImageResponse
        What the cameras see of the markers.
    spacing_mm : float
        Between places, at most.
    orders : int
        Powers of the force: 1 (linear theory) to 5; see :data:`.pressed_series.LARGE_SOLVED_ABOVE`.
    near : NearScene, optional
        Which places are wanted; all without it.
    pair : MeshPair, optional
        Two meshes that the first power of the force is extrapolated from; that of ``mesh`` without.
        The higher powers are those of ``mesh``, scaled (:func:`.pressed_series.scaled_powers`), and
        so are pairs, by the median of all places; force along the surface is extrapolated as well.
    bytes_max : float
        Largest tables; places stand wider apart where they would be larger.

    Raises
    ------
    NumericalError
        If the shell cannot be solved.
    DesignError
        If fewer than ``PLACES_MIN`` are wanted.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    training = design.training
    radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
    sectors, turn = sectors_of(model, mesh, markers)
    if pair and any(column_turn(each, on, sectors) is None for on, each in pair.each):
        sectors, turn = 1, None
    least = np.sqrt(surface.area_mm2() * orders * 8.0 * markers.count / bytes_max)
    spacing = max(spacing_mm, float(least))
    grid = _Grid(
        surface=surface,
        markers=markers,
        radius_mm=radius,
        sectors=sectors,
        turn=turn,
        near=near,
        progress=progress,
    )
    first = DiscResponse(design, surface, markers, mesh=mesh, model=model, orders=1)
    # A small part of the surface holds too few places so far apart.
    apart = HIGHER_ORDER_SPACING * spacing
    if near(apart, rings(surface, apart, sectors).uv).sum() < PLACES_MIN:
        apart = spacing
    extrapolated = ExtrapolatedResponse(design, surface, markers, pair) if pair else None
    corrected = extrapolated is not None and apart <= CORRECTION_SPACING_MAX * radius
    pressed = extrapolated if extrapolated and not corrected else first
    places, uv, solves = grid.table(
        spacing, 1, lambda at: pressed.motions(at, radius), lambda each: see.powers(each, NONE)
    )

    def shear(apart_mm: float) -> ResponseTable:
        """Linear shifts by a newton along and around."""
        return grid.table(
            apart_mm,
            2,
            lambda at: (extrapolated or first).sheared(at, radius),
            lambda motions: np.concatenate([see.powers([one], NONE) for one in motions]),
            what=", force along the surface",
        )[0]

    shell = first
    if orders > 1:
        shell = DiscResponse(design, surface, markers, mesh=mesh, model=model, orders=orders)
    if orders > 1 or corrected:
        beyond = _beyond_linear(grid, apart, shell, see, extrapolated)
        rows = interpolate_responses(beyond.table, places.point_mm)
        rows[:, 0] = places.shift_px[:, 0] + (rows[:, 0] if corrected else 0.0)
        places = places.with_rows(rows.astype(np.float32))
    places = replace(places, shear=shear(apart))
    claimed = list(extrapolated.claimed) if extrapolated else []
    if orders == 1:
        return TabulatedResponse(
            places=places,
            solves=solves,
            bent=0,
            large=0,
            unsure=0,
            spacing_mm=spacing,
            give=[],
            claimed=claimed,
        )
    places = replace(places, top_N=float(shell.forces[-1]))
    progress("places: flat walls")
    places, give = add_membrane_walls(shell, see, places, uv)
    progress("places: pairs of contacts")
    # Of contacts on flat walls tension decides; beyond the expansion pairs on other flat parts
    # would double the errors, while on curved walls they still help (patch).
    holds = beyond.unsure == 0 and not give and (shell.beyond == 0 or not places.flat.any())
    pairs = _pairs(grid, shell, see) if holds else None
    if pairs:
        pairs = pairs.scaled(1.0 / beyond.ratio)
    return TabulatedResponse(
        places=replace(places, pairs=pairs),
        solves=solves,
        bent=beyond.solves,
        large=shell.solved,
        unsure=beyond.unsure,
        spacing_mm=spacing,
        give=give,
        claimed=claimed,
    )


class _BeyondLinear(NamedTuple):
    """What tables hold besides linear motion on the mesh itself.

    Attributes
    ----------
    table : ResponseTable
        Correction of the first power of the force by extrapolation (0 without), then the others.
    solves, unsure : int
        Places solved, and those of them without higher powers.
    ratio : float
        Median of the ratios of extrapolated linear motion to the mesh's own; 1 without.
    """

    table: ResponseTable
    solves: int
    unsure: int
    ratio: float


def _beyond_linear(
    grid: _Grid,
    apart_mm: float,
    shell: DiscResponse,
    see: ImageResponse,
    extrapolated: ExtrapolatedResponse | None,
) -> _BeyondLinear:
    radius = grid.radius_mm
    ratios, unsure = [], 0

    def motions_at(uv: FloatArray) -> list[list[FloatArray]]:
        """Linear motion, extrapolated where tables are, then all that ``shell`` gives."""
        own = shell.motions(uv, radius)
        if not extrapolated:
            return [[each[0], *each] for each in own]
        linear = extrapolated.beside(shell, own, uv, radius)
        return [[one, *two] for one, two in zip(linear, own, strict=True)]

    def powers(motions: list[FloatArray]) -> FloatArray:
        nonlocal unsure
        linear, *own = motions
        unsure += len(own) < shell.orders
        rows, first = see.powers(own, shell.forces), see.powers([linear], NONE)[0]
        ratios.append(force_ratio(first, rows[0]))
        out = scaled_powers(rows, first)
        out[0] -= rows[0]
        return out

    what = ", beyond linear motion"
    table, _, solves = grid.table(apart_mm, shell.orders, motions_at, powers, what=what)
    return _BeyondLinear(table=table, solves=solves, unsure=unsure, ratio=float(np.median(ratios)))


def _pairs(grid: _Grid, shell: DiscResponse, see: ImageResponse) -> InteractionTable | None:
    """Tables of pairs of places; None where too few are wanted, or the shell is too large."""
    if len(shell.model.quads) > SETTINGS.elements_max:
        return None
    apart = pair_spacing_mm(shell.surface.area_mm2(), grid.radius_mm)
    uv = rings(shell.surface, apart, 1).uv
    wanted = grid.near(apart, uv)
    if wanted.sum() < PLACES_MIN:
        return None
    most = round(SETTINGS.more_places * len(uv))
    symmetry = _pair_symmetry(grid, shell, see, apart, most) if wanted.all() else None
    uv = symmetry.ring.uv if symmetry else uv[wanted]
    return InteractionSolver(shell, see, uv, grid.radius_mm, symmetry).pairs(grid.progress)


def _pair_symmetry(
    grid: _Grid, shell: DiscResponse, see: ImageResponse, apart_mm: float, places_max: int
) -> SectorSymmetry | None:
    """Symmetry with the most sectors whose rings have ``places_max`` places at most, if any."""
    if grid.turn is None:
        return None
    for sectors in range(grid.sectors, 1, -1):
        ring = rings(shell.surface, apart_mm, sectors)
        if grid.sectors % sectors or len(ring.uv) > places_max:
            continue
        turn = np.linalg.matrix_power(grid.turn, grid.sectors // sectors)
        found = symmetry_of(shell.mesh, grid.markers, see, ring, sectors, turn)
        if found is not None:
            return found
    return None


def interpolate_responses(places: ResponseTable, points_mm: FloatArray) -> FloatArray:
    """Rows (m, k, 2n) at points (m, 3) of the surface: cubics about the nearest places."""
    nearest = places.nearest(points_mm)
    out = np.zeros((len(points_mm), *places.shift_px.shape[1:]))
    for place in np.unique(nearest).tolist():
        own = np.flatnonzero(nearest == place)
        x, y = places.tangent_coordinates(place, points_mm[own]).T
        powers = np.stack([x**a * y**b / (factorial(a) * factorial(b)) for a, b in TERMS])
        out[own] = np.einsum("tm,tkr->mkr", powers, places.cubic(place))
    return out
