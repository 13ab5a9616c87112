"""How long the stages of a build will take: work counted, times seconds measured.

Each stage's wall seconds are a constant and a sum of terms, each a coefficient times a count of
work that follows from design and settings alone (markers, pixels, nodes, right-hand sides). The
coefficients are fitted (non-negative least squares on relative errors) to measured builds by
``python -m benchmarks.tradeoff --parts costs`` on one machine; what this one is faster or slower by
is measured in a moment (:func:`machine_factor`), and corrected by every stage that has run.
"""

import time
from collections.abc import Callable, Mapping
from functools import cache, cached_property

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.mechanics.meshing.mesh import marker_mesh
from phytac_design.simulation.instance_shell import truth_mesh
from phytac_design.simulation.pressed_series import LARGE_SOLVED_ABOVE
from phytac_design.simulation.response_tables import HIGHER_ORDER_SPACING, place_spacing_mm, rings
from phytac_design.stages import STAGES
from phytac_design.stages.response import samples_of
from phytac_design.study.tradeoff.coefficients import COEFFICIENTS, PROBE_S
from phytac_shapes.arrays import FloatArray

PROBES = 3
"""Repetitions of the machine's probe; the quickest counts."""
PROBE_SIZE = 420
"""Side of the grid whose matrix the probe factors."""


class Work:
    """Counts of work of one design.

    Parameters
    ----------
    design : Design
        The sensor.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self.surface = design.surface()
        self.markers = make_markers(design, self.surface)
        self._nodes: dict[int, int] = {}
        self._true: dict[int, int] = {}
        self._solves: dict[float, tuple[int, int]] = {}

    @cached_property
    def megapixels(self) -> float:
        """Of all cameras together."""
        camera = self.design.camera
        return camera.width_px * camera.height_px * len(camera.end_numbers) / 1e6

    @property
    def hundreds(self) -> float:
        """Markers, hundreds."""
        return self.markers.count / 100.0

    @cached_property
    def sectors(self) -> int:
        """Sectors of the tables' places that repeat themselves around; 1 where none do."""
        if self.design.shape.kind != "cuboid" or self.markers.lattice is None:
            return self.columns
        columns = self.markers.lattice.columns
        width, depth, _ = np.ptp(self.surface.bounds_mm(), axis=0)
        square = abs(width - depth) < 1e-6 * width
        wall = self.design.wall.thickness_mm
        mesh = marker_mesh(self.surface, self.markers, thickness_mm=wall, refine=1)
        if mesh.around is None:
            return 1
        return 4 if square and columns % 4 == 0 else 2 if columns % 2 == 0 else 1

    @property
    def columns(self) -> int:
        """Columns that repeat themselves around; 1 where none do."""
        lattice, surface = self.markers.lattice, self.surface
        if lattice is None or not surface.periodic[1] or self.design.shape.kind == "cuboid":
            return 1
        return lattice.columns

    def nodes(self, refine: int) -> float:
        """Thousands of nodes of the decoder's mesh."""
        if refine not in self._nodes:
            wall = self.design.wall.thickness_mm
            mesh = marker_mesh(self.surface, self.markers, thickness_mm=wall, refine=refine)
            self._nodes[refine] = len(mesh.nodes_mm)
        return self._nodes[refine] / 1e3

    def true_nodes(self, refine: int) -> float:
        """Thousands of nodes of the simulated sensor's mesh."""
        if refine not in self._true:
            self._true[refine] = len(truth_mesh(self.design, self.surface, refine).nodes_mm)
        return self._true[refine] / 1e3

    def places(self, share: float) -> tuple[int, int]:
        """Places of the tables that are solved, and all of them."""
        if share not in self._solves:
            training = self.design.training
            radius = (training.patch_radius_min_mm + training.patch_radius_max_mm) / 2.0
            ring = rings(self.surface, place_spacing_mm(self.surface, share, radius), self.sectors)
            self._solves[share] = (len(np.unique(ring.base)), len(ring.base))
        return self._solves[share]


def terms(work: Work, setting: Accuracy) -> dict[str, list[float]]:
    """Counts of work (k,) of every stage; the first is always 1."""
    n, pixels = work.hundreds, work.megapixels
    nodes, truth = work.nodes(setting.refine), work.true_nodes(setting.truth_refine)
    solved, placed = work.places(setting.place_share)
    bent, _ = work.places(HIGHER_ORDER_SPACING * setting.place_share)
    large = setting.press_tolerance < 1.0
    presses = setting.press_places
    count = samples_of(work.design, setting.sample_share)
    adjoints = 6.0 * n * 100.0 / work.columns
    contacts = 1.7 * sum(count.values())
    right = min(adjoints, contacts) / 100.0
    fine = 0.01 / setting.cad_tolerance_mm
    tools = 1.0 if setting.print_tools else 0.0
    cad = [1.0, n, n * fine]
    return {
        "views": [1.0, pixels, n],
        "switch": [1.0, n],
        "compare": [1.0, pixels, n],
        "underload": [
            1.0,
            pixels,
            presses * (1.0 + n) / 10.0,
            presses * nodes / 10.0 if large else 0.0,
            nodes,
        ],
        "resolution": [1.0, nodes, n, nodes * n],
        "shell": cad,
        "step": [1.0, n],
        "hardware": [1.0, fine, tools],
        "mold": cad,
        "kit": cad,
        "printing": [1.0, n * fine, tools, tools * fine],
        "bench": cad,
        "mesh": [1.0, nodes],
        "response": [1.0, nodes, nodes * n * 100.0 / work.columns / 100.0, n],
        "places": [
            1.0,
            nodes,
            nodes * solved / 100.0,
            nodes * bent / 100.0 if setting.place_orders > 1 else 0.0,
            nodes * bent / 100.0 if setting.place_orders in LARGE_SOLVED_ABOVE else 0.0,
            placed * n / 100.0,
        ],
        "twin": [1.0, truth, truth * right, n * sum(count.values()) / 100.0],
        "decoder": [1.0, n * sum(count.values()) / 100.0, n],
        "frames": [
            1.0,
            setting.frames,
            pixels * setting.frames,
            truth,
            truth * setting.frames / 10.0,
        ],
        "report": [1.0, n],
    }


def predict(
    work: Work, setting: Accuracy, *, factor: float = 1.0, cached: frozenset[str] = frozenset()
) -> dict[str, float]:
    """Wall seconds of each stage; nothing for those in the cache."""
    counts = terms(work, setting)
    return {
        stage.name: 0.0
        if stage.name in cached
        else factor * float(np.dot(COEFFICIENTS[stage.name], counts[stage.name]))
        for stage in STAGES
    }


def fit(rows: Mapping[str, list[tuple[list[float], float]]]) -> dict[str, list[float]]:
    """Coefficients of each stage from (counts, seconds); relative errors weigh alike."""
    from scipy.optimize import nnls

    out = {}
    for stage, measured in rows.items():
        counts = np.array([row for row, _ in measured])
        seconds = np.array([max(value, 0.05) for _, value in measured])
        scale: FloatArray = 1.0 / (0.3 + seconds)
        found, _ = nnls(counts * scale[:, None], seconds * scale)
        out[stage] = [float(f"{value:.4g}") for value in found]
    return out


@cache
def machine_factor() -> float:
    """Seconds of this machine over those of the one that the coefficients are of, found once."""
    return probe_s() / PROBE_S


def probe_s(work: Callable[[], object] | None = None) -> float:
    """Seconds of a small sparse factorisation and a dense product, the quickest of a few."""
    work = work or _probe
    spent = []
    for _ in range(PROBES):
        begin = time.perf_counter()
        work()
        spent.append(time.perf_counter() - begin)
    return min(spent)


def _probe() -> object:
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    size = PROBE_SIZE * 60
    bands = [np.full(size, 4.2), np.full(size - 1, -1.0), np.full(size - 60, -1.0)]
    matrix = diags_array(
        [bands[0], bands[1], bands[1], bands[2], bands[2]], offsets=[0, 1, -1, 60, -60]
    )
    factor = splu(matrix.tocsc())
    return factor.solve(np.ones((size, 8)))
