"""``phytac train``: train the decoder of a design from data sets."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import Bundle, load_bundle, save_bundle
from phytac_design.core.json_values import finite
from phytac_design.design.design_file import design_hash
from phytac_design.design.spec import Design
from phytac_design.layout.region_chart import design_regions
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.simulation.switch_law import switch_law
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.stages.decoder_stage import DECODER, assemble_bundle, untrained_model
from phytac_design.stages.places_stage import receptor_table_of, uneven_wall_of
from phytac_design.training.data_agreement import check_agreement, flagged_share
from phytac_design.training.evaluation.contact_scores import error_summary
from phytac_design.training.evaluation.decoded_contacts import decode_contacts
from phytac_design.training.fem_calibration import ReceptorSolver
from phytac_design.training.result_folder import reserve_folder, write_folder
from phytac_design.training.threshold_learning import learn_thresholds
from phytac_design.training.trainers import TRAINERS, TrainingTask
from phytac_design.training.training_data import (
    DataSet,
    SplitPart,
    bundle_hash,
    check_inputs,
    read_data_sets,
    split_data_sets,
)
from phytac_design.training.uneven_wall import WallSolver
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError

TABLE = "training.json"
FORMAT, SCHEMA = "phytac-training", "1.0"
MECHANICS = [name for name in DECODER.depends_on if name != "twin"]
"""Stages of a build that the decoder needs, without its simulated data."""


def train(
    design: Design,
    data: Sequence[Path],
    out: Path,
    *,
    samples: int | None = None,
    seed: int = 0,
    start: Path | None = None,
    accuracy: str = "standard",
    force: bool = False,
    progress: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train the decoder of a design and write it; equal inputs give equal bundles.

    Parameters
    ----------
    design : Design
        The sensor.
    data : list of Path
        Data sets of that sensor.
    out : Path
        The decoder's own folder.
    samples : int, optional
        Number of samples to use, the first ones.
    seed : int
        Seed of the split and of the networks' initial weights.
    start : Path, optional
        Another sensor's decoder, whose networks are the initial ones.
    accuracy : str
        Preset of the decoder's mechanics.
    force : bool
        Overwrite what the folder holds.
    progress : callable
        Called with a short message at each step.

    Returns
    -------
    dict
        Contents of ``training.json``.

    Raises
    ------
    DesignError
        If the design cannot be built.
    InputError
        If the data or the decoder to start from cannot be used.
    OutputError
        If ``out`` cannot be written or holds something else.
    """
    check_design(design)
    if not design.has_switches:
        raise InputError(
            "training-without-switches",
            f"{design.name} has no switches (receptor.diameter_hole_mm = 0), and a decoder is "
            "trained on contacts that switches show: use the decoder of its build, or give the "
            "design switches",
        )
    sets = read_data_sets(data, design_hash=design_hash(design))
    first = load_bundle(start) if start is not None else None
    with reserve_folder(out, TABLE, design.name, force=force):
        context = run_stages(
            design,
            select_stages(MECHANICS),
            accuracy=accuracy,
            seed=0,
            force=True,
            progress=progress,
        )[0]
        plain = replace(
            assemble_bundle(
                context, untrained_model(context), _notes(sets, seed, accuracy, start, first)
            ),
            design=design.name,
            design_hash=design_hash(design),
            regions=design_regions(design),
            learnt_rest_px=_learnt_rest(sets, context.markers.count),
        )
        for item in sets:
            check_inputs(item, plain.model, accuracy)
        noise_px = design.camera.noise_centroid_px
        parts = split_data_sets(sets, plain.model, noise_px=noise_px, seed=seed, limit=samples)
        for doubt in (flagged_share(sets), _doubt(plain, parts[0])):
            if doubt:
                progress(f"warning: {doubt}")
        plain, learnt = _with_thresholds(plain, context.sensor, parts[0])
        bundle, trained = run_trainers(
            plain,
            parts,
            seed,
            first,
            progress,
            receptors=partial(receptor_table_of, context),
            wall=partial(uneven_wall_of, context),
        )
        trained |= learnt
        held_out = held_out_scores(bundle, parts[2])
        notes = {
            "training_samples": parts[0].count,
            "test_relative_error": held_out
            and {name: finite(score["relative_error"]) for name, score in held_out.items()},
        }
        bundle = replace(bundle, notes=bundle.notes | notes)
        names = ("training", "validation", "test")
        facts: dict[str, Any] = {
            "format": FORMAT,
            "schema_version": SCHEMA,
            "design": design.name,
            "design_hash": bundle.design_hash,
            "accuracy": accuracy,
            "seed": seed,
            "start": bundle.notes.get("start"),
            "data": [item.facts() for item in sets],
            "samples": dict(zip(names, [part.count for part in parts], strict=True)),
            "key_nodes": dict(zip(names, [len(part.rows.force_N) for part in parts], strict=True)),
            "trainers": trained,
            "test": held_out,
        }
        if doubt:
            facts["doubt"] = doubt
        with write_folder(out, TABLE) as folder:
            save_bundle(bundle, folder)
            text = json.dumps(finite(facts), indent=1, sort_keys=True, ensure_ascii=False)
            (folder / TABLE).write_text(text + "\n", encoding="utf-8")
    return facts


def _doubt(bundle: Bundle, part: SplitPart) -> str:
    """Return a warning if forces and pictures of the data may not belong together, or ""."""
    locator = bundle.model.locator
    if locator is None or part.samples is None or not part.has_points:
        return ""
    return check_agreement(locator, part.samples)


def _with_thresholds(
    bundle: Bundle, sensor: Sensor, part: SplitPart
) -> tuple[Bundle, dict[str, Any]]:
    """Return the bundle with thresholds of gradual switches learnt, and facts; none for bowls."""
    law = switch_law(sensor.design, sensor.markers)
    if not law.gradual.any() or part.samples is None or not part.has_points:
        return bundle, {}
    bundle, facts = learn_thresholds(bundle, sensor, law, part.samples)
    return bundle, {"thresholds": facts}


def _notes(
    sets: Sequence[DataSet], seed: int, accuracy: str, start: Path | None, first: Bundle | None
) -> dict[str, Any]:
    """Return the provenance of a bundle that is known before training."""
    notes: dict[str, Any] = {
        "data": "; ".join(item.meta.what for item in sets),
        "data_sha256": [item.sha256 for item in sets],
        "seed": seed,
        "accuracy": accuracy,
    }
    if start is not None and first is not None:
        notes["start"] = {"design": first.design, "sha256": bundle_hash(start)}
    return notes


def _learnt_rest(sets: Sequence[DataSet], markers: int) -> FloatArray:
    """Return rest positions (k, n, 2) of the prints; none if one of them is not known."""
    each = [item.meta.rest_px for item in sets]
    known = [rest_px for rest_px in each if rest_px is not None]
    if len(known) < len(each):
        return np.zeros((0, markers, 2))
    return np.unique(np.stack(known), axis=0)


def run_trainers(
    bundle: Bundle,
    parts: tuple[SplitPart, SplitPart, SplitPart],
    seed: int,
    start: Bundle | None,
    progress: Callable[[str], None],
    *,
    receptors: ReceptorSolver | None = None,
    wall: WallSolver | None = None,
) -> tuple[Bundle, dict[str, Any]]:
    """Run all trainers; return the bundle with their results, and their facts."""
    facts = {}
    for name, trainer in TRAINERS:
        progress(f"train: {name}")
        begin = time.perf_counter()
        task = TrainingTask(
            bundle=bundle,
            training=parts[0],
            validation=parts[1],
            test=parts[2],
            seed=seed,
            start=start,
            receptors=receptors,
            wall=wall,
        )
        model, found = trainer(task)
        bundle = replace(bundle, model=model)
        facts[name] = found | {"seconds": round(time.perf_counter() - begin, 3)}
        progress(f"train: {name} {facts[name]['seconds']:.1f} s")
        if "warning" in found:
            progress(f"warning: {found['warning']}")
    return bundle, facts


def held_out_scores(bundle: Bundle, test: SplitPart) -> dict[str, Any] | None:
    """Return errors per contact on the test part, by estimator; None without points."""
    if test.samples is None:
        return None
    contacts = decode_contacts(bundle.model, test.samples)
    on = contacts.tripped
    return {
        name: error_summary(decoded[on], contacts.force_N[on])
        for name, decoded in contacts.decoded_N.items()
    }
