"""Cost of a build: amounts of work, times unit costs that were measured.

The amounts (markers, mesh nodes, right-hand sides, pixels) follow from the design, the settings and
the scene. The unit costs are a non-negative least-squares fit to measured builds on one machine
(``python -m benchmarks.tradeoff --parts costs,units``); :func:`machine_factor` scales them to the
machine that is running.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import diags_array
from scipy.sparse.linalg import splu

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.scene import ALL_AT_ONCE, Scene
from phytac_design.design.spec import Design
from phytac_design.engine.runner import StageCosts
from phytac_design.layout import Markers, make_markers
from phytac_design.mechanics.meshing.mesh import ShellMesh, marker_mesh
from phytac_design.simulation.instance_shell import MARGIN, truth_levels, truth_mesh
from phytac_design.simulation.pressed_series import LARGE_SOLVED_ABOVE
from phytac_design.simulation.response_tables import HIGHER_ORDER_SPACING, place_spacing_mm
from phytac_design.simulation.scenario.scene_scope import PRESSES_LEAST, Scope
from phytac_design.simulation.turned_places import rings
from phytac_design.stages.response_stage import SCENE_SAMPLES, samples_of
from phytac_design.study.planning.unit_costs import MEMORY_MB, CPU_s, PROBE_s
from phytac_shapes import Surface

Amounts = dict[str, float]
UnitCosts = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, kw_only=True)
class Counts:
    """Amounts of work of a build.

    Attributes
    ----------
    markers, in_play : int
        Receptors, and those that contacts can trip.
    megapixels, picture_megapixels : float
        Of all cameras, and of the pictures that are written.
    repeats : int
        Identical sectors around the sensor; 1 without symmetry.
    nodes, truth_nodes : int
        Of the decoder's mesh and of the simulated sensor's meshes together.
    response_loads, twin_loads : int
        Right-hand sides.
    places, place_solves, large_solves : int
        Places tabulated, those solved by linear theory, and those solved for higher powers of the
        force.
    contacts : int
        Drawn by the simulation.
    samples, samples_all : int
        Samples that train networks, and all samples.
    presses : int
        Places pressed to find hidden markers.
    frames : int
        Rendered and decoded.
    """

    markers: int
    in_play: int
    megapixels: float
    picture_megapixels: float
    repeats: int
    nodes: int
    truth_nodes: int
    response_loads: int
    twin_loads: int
    places: int
    place_solves: int
    large_solves: int
    contacts: int
    samples: int
    samples_all: int
    presses: int
    frames: int


class Workload:
    """Amounts of work of builds of one design; meshes are counted once for each refinement."""

    def __init__(self, design: Design) -> None:
        self.design = design
        self.surface = design.surface()
        self.markers = make_markers(design, self.surface)
        self.repeats = repeats(self.surface, self.markers)
        self.nodes = cache(lambda refine: len(self._mesh(refine).nodes_mm))
        self.truth_nodes = cache(
            lambda refine: sum(
                len(truth_mesh(design, self.surface, level, self.markers).nodes_mm)
                for level in truth_levels(refine) or (refine,)
            )
        )
        self.table_sectors = cache(self._table_sectors)
        self.place_rings = cache(self._place_rings)

    def _mesh(self, refine: int) -> ShellMesh:
        thickness = self.design.wall.thickness_mm
        return marker_mesh(self.surface, self.markers, thickness_mm=thickness, refine=refine)

    def _table_sectors(self) -> int:
        """Identical sectors of the tables of ``auto``: as ``repeats``, also on cuboids."""
        lattice = self.markers.lattice
        if self.design.shape.kind != "cuboid" or lattice is None:
            return self.repeats
        if self._mesh(1).around is None:
            return 1
        width, depth, _ = np.ptp(self.surface.bounds_mm(), axis=0)
        square = abs(width - depth) < 1e-6 * width
        return 4 if square and lattice.columns % 4 == 0 else 2 if lattice.columns % 2 == 0 else 1

    def _place_rings(self, share: float, scope: Scope | None) -> tuple[int, int]:
        """Places of a table, and those that are solved."""
        training = self.design.training
        radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
        spacing = place_spacing_mm(self.surface, share, radius)
        ring = rings(self.surface, spacing, self.table_sectors())
        base = ring.base if scope is None else ring.base[scope.near(spacing, ring.uv)]
        return len(base), len(np.unique(base))

    def counts(
        self,
        accuracy: Accuracy,
        *,
        scene: Scene | None = None,
        scope: Scope | None = None,
        in_play: int | None = None,
    ) -> Counts:
        """Amounts of a build; of the whole sensor without a scene."""
        design, camera, n = self.design, self.design.camera, self.markers.count
        pixels = len(camera.end_numbers) * camera.width_px * camera.height_px / 1e6
        in_play = n if in_play is None else in_play
        samples = samples_of(design, accuracy.sample_share, accuracy.frames)
        if scene is not None and not scene.networks:
            samples = {"train": 0, **SCENE_SAMPLES}
        at_once = scene.at_once if scene else ALL_AT_ONCE
        mean = 1.0 + design.training.multi_contact * at_once / 2.0 if at_once > 1 else 1.0
        contacts = round(sum(samples.values()) * mean)
        rows = n // self.repeats
        truth, adjoints, presses = self.truth_nodes(accuracy.truth_refine), 6 * rows, None
        if scope is not None:
            truth = round(truth * local_mesh_share(design, self.surface, scope))
            adjoints = 6 * n
            share = scope.sector_share(self.repeats)
            presses = max(int(np.ceil(accuracy.press_places * share)), PRESSES_LEAST)
        places, solves = self.place_rings(accuracy.place_share, scope)
        return Counts(
            markers=n,
            in_play=in_play,
            megapixels=pixels,
            picture_megapixels=pixels if scene is None or scene.pictures else 0.0,
            repeats=self.repeats,
            nodes=self.nodes(accuracy.refine),
            truth_nodes=truth,
            response_loads=rows if self.repeats > 1 else in_play,
            twin_loads=min(contacts + round(accuracy.frames * mean), adjoints),
            places=places,
            place_solves=solves,
            large_solves=self.place_rings(HIGHER_ORDER_SPACING * accuracy.place_share, scope)[1],
            contacts=contacts,
            samples=samples["train"],
            samples_all=sum(samples.values()),
            presses=accuracy.press_places if presses is None else presses,
            frames=accuracy.frames,
        )


def features(
    counts: Counts, accuracy: Accuracy, design: Design, scene: Scene | None = None
) -> dict[str, Amounts]:
    """Amounts of work of each stage that its cost is linear in; ``one`` is the constant."""
    n, pixels = counts.markers / 100.0, counts.megapixels
    nodes, truth = counts.nodes / 1e3, counts.truth_nodes / 1e3
    fine = 0.01 / accuracy.cad_tolerance_mm
    tools = float(accuracy.tools)
    solid = {"one": 1.0, "markers": n, "fine": n * fine}
    tool = {name: tools * amount for name, amount in solid.items()}
    higher_orders = float(accuracy.place_orders > 1)
    solved = float(accuracy.place_orders in LARGE_SOLVED_ABOVE)
    large = float(accuracy.press_tolerance < 1.0)
    trained = float(scene is None or scene.networks)
    return {
        "views": {
            "one": 1.0,
            "pixels": pixels,
            "markers": n,
            "pictures": counts.picture_megapixels,
        },
        "switch": {"one": 1.0, "markers": n},
        "compare": {
            "one": 1.0,
            "pixels": pixels * (design.layout.kind == "spiral") * tools,
            "markers": n * tools,
        },
        "underload": {
            "one": 1.0,
            "pixels": pixels,
            "looks": counts.presses * (1.0 + n) / 10.0,
            "large": large * counts.presses * nodes / 10.0,
            "nodes": nodes,
        },
        "pressed": {"one": 1.0, "markers": n},
        "resolution": {"one": 1.0, "nodes": nodes, "loads": nodes * counts.in_play / 100.0},
        "shell": solid,
        "step": {"one": float(accuracy.step), "markers": accuracy.step * n},
        "hardware": solid,
        "mold": tool,
        "kit": tool,
        "inserts": {"one": tools, "markers": tools * n * design.receptor.has_inserts},
        "printing": solid | {"tools": tools, "fine_tools": tools * n * fine},
        "bench": tool,
        "mesh": {"one": 1.0, "nodes": nodes},
        "response": {
            "one": 1.0,
            "nodes": nodes,
            "loads": nodes * counts.response_loads / 100.0,
            "markers": n,
        },
        "places": {
            "one": 1.0,
            "nodes": nodes,
            "solves": nodes * counts.place_solves / 100.0,
            "orders": higher_orders * nodes * counts.large_solves / 100.0,
            "large": solved * nodes * counts.large_solves / 100.0,
            "copies": counts.places * n / 100.0,
        },
        "twin": {
            "one": 1.0,
            "nodes": truth,
            "loads": truth * counts.twin_loads / 100.0,
            "seen": counts.contacts * n / 100.0,
        },
        "decoder": {
            "one": 1.0,
            "samples": counts.samples_all * n / 100.0,
            "trained": trained * counts.samples / 100.0,
        },
        "renders": {
            "one": 1.0,
            "frames": counts.frames,
            "pixels": counts.frames * pixels,
            "markers": counts.frames * n / 10.0,
            "nodes": higher_orders * truth,
        },
        "frames": {
            "one": 1.0,
            "frames": counts.frames,
            "pixels": counts.frames * pixels,
            "markers": counts.frames * n / 10.0,
        },
        "report": {"one": 1.0, "markers": n},
    }


def predict(unit_costs: UnitCosts, amounts: Mapping[str, Amounts]) -> dict[str, float]:
    """Cost of each stage: seconds or MB, as the unit costs are."""
    return {
        stage: sum(unit_costs[stage].get(name, 0.0) * value for name, value in own.items())
        for stage, own in amounts.items()
    }


def stage_costs(design: Design, accuracy: Accuracy) -> StageCosts:
    """Predicted costs of each stage of a whole build, on this machine."""
    amounts = features(Workload(design).counts(accuracy), accuracy, design)
    return StageCosts(
        seconds=predict(CPU_s, amounts),
        memory_MB=predict(MEMORY_MB, amounts),
        machine=partial(machine_factor, time.process_time),
    )


def fit(rows: Mapping[str, Sequence[tuple[Amounts, float]]]) -> dict[str, dict[str, float]]:
    """Unit costs of each stage, none below zero, from (amounts, cost); relative errors count."""
    out = {}
    for stage, measured in rows.items():
        names = list(measured[0][0])
        cost = np.array([value for _, value in measured])
        matrix = np.array([[amounts[name] for name in names] for amounts, _ in measured])
        scale = 1.0 / (0.3 + cost)
        found, _ = nnls(matrix * scale[:, None], cost * scale)
        pairs = zip(names, found.tolist(), strict=True)
        out[stage] = {name: float(f"{value:.4g}") for name, value in pairs if value > 1e-9}
    return out


def machine_factor(clock: Callable[[], float] = time.perf_counter) -> float:
    """Seconds of this machine over those of the machine that the unit costs were measured on."""
    return probe_s(clock) / PROBE_s


@cache
def probe_s(clock: Callable[[], float]) -> float:
    """Seconds of a sparse factorisation by a clock, the fastest of three; measured once."""
    size, line = 25_200, 60
    matrix = diags_array(
        [4.2, -1.0, -1.0, -1.0, -1.0], offsets=[0, 1, -1, line, -line], shape=(size, size)
    ).tocsc()
    loads = np.ones((size, 8))
    spent = []
    for _ in range(3):
        begin = clock()
        splu(matrix).solve(loads)
        spent.append(clock() - begin)
    return min(spent)


def repeats(surface: Surface, markers: Markers) -> int:
    """Identical sectors around the sensor by the positions of its markers; 1 without symmetry."""
    lattice = markers.lattice
    if lattice is None or lattice.columns < 2 or not surface.periodic[1] or any(surface.poles):
        return 1
    if len(lattice.rows_u) * lattice.columns != markers.count:
        return 1
    angle = 2.0 * np.pi / lattice.columns
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    here = markers.mid_mm.reshape(-1, lattice.columns, 3)
    gap = np.abs(here @ turn.T - np.roll(here, -1, axis=1)).max()
    return lattice.columns if gap < 1e-6 * np.abs(here).max() else 1


def local_mesh_share(
    design: Design, surface: Surface, scope: Scope, *, coarsening: float = 2.5
) -> float:
    """Nodes of a mesh that is fine in the touched part only, over those of one fine everywhere.

    ``coarsening`` is the element size far from the touched part, over that in it.
    """
    if any(surface.poles):
        return 1.0
    region, span = scope.touched, np.ptp(surface.domain, axis=1)
    size = np.sort(np.ptp(surface.bounds_mm(), axis=0))[1] / 2.0
    margin = MARGIN * float(np.sqrt(size * design.wall.thickness_mm))
    metric = surface.metric(surface.domain.mean(axis=1)[None])[0]
    share = 1.0
    for axis in (0, 1):
        if region.whole[axis]:
            continue
        part = float(region.high[axis] - region.low[axis]) % float(span[axis])
        fine = part / float(span[axis])
        fine += 2.0 * margin / (float(np.sqrt(metric[axis, axis])) * float(span[axis]))
        share *= min(fine + (1.0 - fine) / coarsening, 1.0)
    return share
