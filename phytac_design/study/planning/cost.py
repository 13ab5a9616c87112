"""What stages cost: counts times unit costs that were measured, scaled to this machine."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.sparse import csc_matrix, diags_array, eye_array, kron
from scipy.sparse.linalg import splu

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.scene import Scene
from phytac_design.design.spec import Design
from phytac_design.simulation.response_tables import HIGHER_ORDER_SPACING
from phytac_design.study.planning.counts import Counts
from phytac_design.study.planning.unit_costs import MEMORY_MB, SECONDS, PROBE_s
from phytac_shapes.arrays import FloatArray

WITHIN = 2.0
"""Factor within which predicted and actual cost of a build lie; measured, see docs/plan.md."""
PROBES = 3
KOITER = 6.0
"""Cost of all powers of a press, in linear solves."""
PROBE_SIZE = 96

Features = dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Predicted cost of a stage.

    Attributes
    ----------
    seconds : float
        Processor time, s.
    memory_MB : float
        Greatest memory of the process, libraries included.
    """

    seconds: float
    memory_MB: float


def features(
    counts: Counts, accuracy: Accuracy, design: Design, scene: Scene | None = None
) -> dict[str, Features]:
    """What the cost of each stage grows with, in units of thousands and millions."""
    n, pixels = counts.markers / 1e3, counts.megapixels
    nodes, truth = counts.nodes / 1e3, counts.truth_nodes / 1e3
    fine = n * float(np.sqrt(0.01 / accuracy.cad_tolerance_mm))
    solid = {"one": 1.0, "markers": n, "fine": fine}
    orders = 1.0 if accuracy.place_orders == 1 else 1.0 + (KOITER - 1.0) / HIGHER_ORDER_SPACING**2
    large = 0.0 if accuracy.press_tolerance >= 1.0 else 1.0
    trained = 1.0 if scene is None or scene.networks else 0.0
    judged = max(counts.contacts - counts.samples, 0)
    return {
        "views": {
            "one": 1.0,
            "pixels": pixels,
            "markers": n,
            "pictures": counts.picture_megapixels,
        },
        "switch": {"one": 1.0, "thresholds": float(len(set(_thresholds(design))))},
        "compare": {"one": 1.0, "pixels": pixels * (design.layout.kind == "spiral")},
        "underload": {
            "one": 1.0,
            "nodes": nodes,
            "large": large * counts.presses * nodes,
            "looks": counts.presses * n,
        },
        "resolution": {"one": 1.0, "nodes": nodes, "loads": nodes * counts.in_play / 1e3},
        "shell": solid,
        "step": {"one": 1.0, "markers": n},
        "hardware": solid,
        "mold": solid,
        "kit": solid,
        "printing": solid | {"tools": fine * accuracy.print_tools},
        "bench": solid,
        "mesh": {"one": 1.0, "nodes": nodes},
        "response": {"one": 1.0, "nodes": nodes, "loads": nodes * counts.response_loads / 1e3},
        "places": {
            "one": 1.0,
            "nodes": nodes,
            "solves": nodes * counts.place_solves * orders / 1e3,
            "copies": counts.places * n * accuracy.place_orders,
        },
        "twin": {
            "one": 1.0,
            "nodes": truth,
            "loads": truth * counts.twin_loads / 1e3,
            "seen": counts.contacts * n,
        },
        "decoder": {
            "one": 1.0,
            "trained": trained * counts.samples / 1e3,
            "judged": judged * n,
        },
        "frames": {
            "one": 1.0,
            "pixels": counts.frames * pixels,
            "markers": counts.frames * n,
            "nodes": truth,
        },
        "report": {"one": 1.0, "markers": n},
    }


def predict(
    stages: Sequence[str],
    counts: Counts,
    accuracy: Accuracy,
    design: Design,
    scene: Scene | None = None,
    *,
    speed: float = 1.0,
) -> dict[str, Cost]:
    """Cost of each stage if it runs; ``speed`` is that of :func:`probe`."""
    grown = features(counts, accuracy, design, scene)
    return {
        name: Cost(
            seconds=_dot(SECONDS[name], grown[name]) * speed,
            memory_MB=_dot(MEMORY_MB[name], grown[name]),
        )
        for name in stages
    }


def probe() -> float:
    """How much longer this machine takes than the one of the unit costs, by a small solve."""
    return probe_s() / PROBE_s


def probe_s() -> float:
    """Least of a few times, s, of a sparse factorisation and a dense product."""
    line = diags_array([-1.0, 2.1, -1.0], offsets=[-1, 0, 1], shape=(PROBE_SIZE, PROBE_SIZE))
    plate = csc_matrix(kron(line, eye_array(PROBE_SIZE)) + kron(eye_array(PROBE_SIZE), line))
    dense = np.sin(np.arange(400.0 * 400.0)).reshape(400, 400)
    taken = []
    for _ in range(PROBES):
        start = time.process_time()
        splu(plate).solve(np.ones(PROBE_SIZE**2))
        dense @ dense
        taken.append(time.process_time() - start)
    return min(taken)


def fit_units(rows: Sequence[tuple[Mapping[str, float], float]]) -> dict[str, float]:
    """Unit costs, none below zero, that explain measured costs best, relative to each.

    Parameters
    ----------
    rows : sequence of (features, cost)
        What was measured.
    """
    names = sorted({name for grown, _ in rows for name in grown})
    matrix: FloatArray = np.array([[grown.get(n, 0.0) for n in names] for grown, _ in rows])
    cost = np.maximum(np.array([value for _, value in rows]), 1e-2)
    units, _ = nnls(matrix / cost[:, None], np.ones(len(cost)))
    return {name: float(f"{unit:.3g}") for name, unit in zip(names, units, strict=True)}


def _dot(units: Mapping[str, float], grown: Features) -> float:
    return float(sum(unit * grown.get(name, 0.0) for name, unit in units.items()))


def _thresholds(design: Design) -> list[float]:
    switch = design.switch.model_dump()
    own = [float(switch["threshold_N"])]
    return own + [float(item["threshold_N"]) for item in switch.get("regions", ())]
