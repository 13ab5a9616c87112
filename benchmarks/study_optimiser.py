"""Optuna's search against as long a Sobol sequence."""

import shutil
from pathlib import Path

import numpy as np

from benchmarks.decoder_data import data_folder
from benchmarks.harness import Table
from benchmarks.study_cases import one_thread, study_of
from phytac_design.engine.cache import code_hash
from phytac_design.study.search.design_space import DesignSpace
from phytac_design.study.search.driver import Kind, run_study
from phytac_design.study.search.search_report import Results, read_results
from phytac_design.study.search.study_file import Study

SEEDS = (1, 2, 3)
GOALS = [
    {"measure": "marker_count", "goal": "max"},
    {"measure": "surrogate_force_sd_N", "goal": "min"},
]
LIMITS = [
    {"measure": "sampled_visible_least", "min": 0.9},
    {"measure": "sampled_gap_px", "min": 5.0},
]
REFERENCE = np.array([0.0, 0.3])
"""No markers at all, and 0.3 N: what nobody would build."""


def ran(study: Study, space: DesignSpace, kind: Kind, name: str) -> Results:
    """Results of a study, from where an earlier run left it."""
    folder = data_folder() / "study" / f"{name}-{code_hash()[:16]}"
    for old in folder.parent.glob(f"{name}-*"):
        if old != folder:
            shutil.rmtree(old, ignore_errors=True)
    run_study(study, space, folder, kind=kind, progress=lambda text: print(f"  {name}: {text}"))
    return read_results(Path(folder))


def optimiser(table: Table, *, quick: bool) -> None:
    """Hypervolume of fronts, three seeds each."""
    one_thread()
    budget = 48 if quick else 192
    for sampler in ("tpe", "nsga2"):
        ratios, notes = [], []
        for seed in SEEDS[:1] if quick else SEEDS:
            cases = [
                study_of(
                    "cylinder",
                    seed=seed,
                    objective=GOALS,
                    constraint=LIMITS,
                    budget={"candidates": budget},
                    sampling={"batch": 16, "start": 16 if quick else 32, "optimise": name},
                )
                for name in ("tpe", sampler)
            ]
            even = _covered(ran(*cases[0], "sweep", f"sobol-{seed}"))
            found = _covered(ran(*cases[1], "optimise", f"{sampler}-{seed}"))
            ratios.append(found / even)
            notes.append(f"seed {seed}: {found:.1f} against {even:.1f}")
        row = f"{sampler}: hypervolume over that of Sobol, the worst of {len(ratios)} seeds"
        source = (
            f"markers against bound of force on the cylinder, {budget} candidates each; "
            "reference point 0 markers, 0.3 N"
        )
        table.add(row, min(ratios), "ratio", 1.0, source, "> 1", "; ".join(notes))


def _covered(results: Results) -> float:
    """Hypervolume of a front."""
    values = results.objectives()[results.front()]
    from optuna._hypervolume import compute_hypervolume

    inside = values[np.all(values < REFERENCE, axis=1)]
    return float(compute_hypervolume(inside, REFERENCE)) if len(inside) else 0.0
