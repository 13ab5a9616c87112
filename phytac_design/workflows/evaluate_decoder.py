"""``phytac evaluate``: every estimator of a decoder against the truth of data sets."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phytac_decoder.io.bundle import Bundle, load_bundle
from phytac_decoder.pipeline.print_identity import for_this_print
from phytac_design.core.json_values import finite
from phytac_design.datasets.samples import STATUSES, THEORIES, Samples
from phytac_design.design.design_file import design_hash, load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.training.data_agreement import flagged_share
from phytac_design.training.evaluation.contact_scores import LEVEL, RESAMPLES, Bootstrap
from phytac_design.training.evaluation.decoded_contacts import DecodedContacts, decode_contacts
from phytac_design.training.evaluation.evaluation_plots import draw
from phytac_design.training.evaluation.groups import (
    KINDS,
    Groups,
    contact_positions,
    groups_of,
    kinds,
)
from phytac_design.training.evaluation.interval_scores import interval_scores
from phytac_design.training.evaluation.tables import contacts_csv, tables_md
from phytac_design.training.join_datasets import join_samples
from phytac_design.training.result_folder import reserve_folder, write_folder
from phytac_design.training.training_data import DataSet, bundle_hash, read_data_sets
from phytac_shapes.errors import InputError, PhytacError

TABLE = "evaluation.json"
FORMAT, SCHEMA = "phytac-evaluation", "1.1"


def evaluate(
    bundle: Path,
    data: Sequence[Path],
    out: Path,
    *,
    design: str | None = None,
    seed: int = 0,
    force: bool = False,
    progress: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Evaluate every estimator of a decoder; write ``evaluation.json``, tables and figures.

    Parameters
    ----------
    bundle : Path
        The decoder's folder.
    data : list of Path
        Data sets of the same design, with points.
    out : Path
        Folder for the result.
    design : str, optional
        Shipped design or file, for heights and sides; searched for by default.
    seed : int
        Seed of the bootstrap.
    force : bool
        Overwrite what the folder holds.
    progress : callable
        Called with a short message at each step.

    Returns
    -------
    dict
        Contents of ``evaluation.json``.

    Raises
    ------
    InputError
        If the decoder or the data cannot be used.
    DesignError
        If the design cannot be read.
    OutputError
        If ``out`` cannot be written or holds something else.
    """
    decoder = load_bundle(bundle)
    sets = read_data_sets(data, design_hash=decoder.design_hash)
    for item in sets:
        if not item.has_points:
            raise InputError(
                "samples-without-points",
                f"{item.folder} holds no points, so nothing can be decoded; make it again with "
                "--keep points",
            )
        if item.sha256 in decoder.notes.get("data_sha256", ()):
            progress(
                f"warning: {item.folder} is what this decoder was trained on: these are not "
                "errors on unseen samples"
            )
    doubt = flagged_share(sets)
    if doubt:
        progress(f"warning: {doubt}")
    if decoder.model.without_switches and not all(item.meta.simulated for item in sets):
        raise InputError(
            "evaluation-without-switches",
            "this sensor has no switches, and measured contacts are compared with forces on the "
            "switches that they turn on; evaluate simulated data, or compare single frames with "
            "phytac decode",
        )
    decoder = _for_prints(decoder, sets, progress)
    known = find_design(decoder, bundle, design)
    if known is None:
        progress(
            f"warning: no design file of {decoder.design} with this decoder's hash was found: "
            "heights and sides are left out; add --design FILE"
        )
    samples = join_samples([item.samples for item in sets])
    if samples.markers != len(decoder.colour):
        raise InputError(
            "data-sets-marker-count",
            f"the data are of a sensor with {samples.markers} markers, the decoder of one with "
            f"{len(decoder.colour)}; use data of the decoder's own design",
        )
    with reserve_folder(out, TABLE, decoder.design, force=force):
        decoded = decode_contacts(
            decoder.model, samples, progress=lambda name: progress(f"evaluate: {name}")
        )
        where = None
        if known is not None and samples.touches is not None:
            where = contact_positions(known, samples.touches.uv[decoded.touch])
        groups = groups_of(sets, samples, decoded, where)
        progress("evaluate: intervals and pictures")
        facts: dict[str, Any] = finite(
            {
                "format": FORMAT,
                "schema_version": SCHEMA,
                "design": decoder.design,
                "design_hash": decoder.design_hash,
                "bundle_sha256": bundle_hash(bundle),
                "data": [item.facts() for item in sets],
                "bootstrap": {
                    "resamples": RESAMPLES,
                    "level": LEVEL,
                    "seed": seed,
                    "over": "samples",
                },
                **counts(sets, samples, decoded),
                "estimators": scores(decoded, groups, seed),
                "intervals": interval_scores(decoded, seed),
            }
        )
        kind = kinds(sets, samples, decoded)
        with write_folder(out, TABLE) as folder:
            text = json.dumps(facts, indent=1, sort_keys=True, ensure_ascii=False)
            (folder / TABLE).write_text(text + "\n", encoding="utf-8")
            rows = contacts_csv(samples, decoded, where, [KINDS[k] for k in kind])
            (folder / "contacts.csv").write_text(rows, encoding="utf-8")
            (folder / "tables.md").write_text(tables_md(facts), encoding="utf-8")
            for name, picture in draw(facts, decoded).items():
                (folder / name).write_bytes(picture)
    return facts


def _for_prints(
    decoder: Bundle, sets: Sequence[DataSet], progress: Callable[[str], None]
) -> Bundle:
    """Return the decoder as it reads the prints of the data, with a warning for another one."""
    for item in sets:
        rest_px = item.meta.rest_px
        if rest_px is not None:
            decoder = for_this_print(replace(decoder, rest_px=rest_px))
    if decoder.other_print_mm:
        progress(
            "warning: the data are of another print than this decoder was trained on: it reads all "
            "of them as one of a print that it does not know"
        )
    return decoder


def find_design(decoder: Bundle, folder: Path, wanted: str | None) -> Design | None:
    """Return the decoder's design: the given one, that of the build around it, or a shipped one.

    Raises
    ------
    InputError
        If the given one is not the decoder's.
    """
    if wanted is not None:
        design = load_design(wanted)
        if design_hash(design) != decoder.design_hash:
            raise InputError(
                "decoder-of-other-design",
                f"{wanted} is not the design that the decoder in {folder} was made from "
                f"({decoder.design}, {decoder.design_hash[:12]}…); give that one, or leave "
                "--design out",
            )
        return design
    build = folder.resolve().parent / "design.toml"
    names = [str(build)] if build.is_file() else []
    names += [decoder.design] if decoder.design in shipped_designs() else []
    for name in names:
        try:
            design = load_design(name)
        except PhytacError:
            continue
        if design_hash(design) == decoder.design_hash:
            return design
    return None


def counts(sets: Sequence[DataSet], samples: Samples, decoded: DecodedContacts) -> dict[str, Any]:
    """Return how many samples and contacts there are, by outcome."""
    status = np.bincount(samples.status, minlength=len(STATUSES))
    theory = np.bincount(samples.theory[decoded.evaluated], minlength=len(THEORIES))
    unseen = decoded.force_N[~decoded.tripped]
    return {
        "samples": dict(zip(STATUSES, status.tolist(), strict=True))
        | {"judged": len(decoded.evaluated)},
        "theories": dict(zip(THEORIES, theory.tolist(), strict=True)),
        "contacts": {
            "judged": int(decoded.tripped.sum()),
            "all_switches_missed": int((decoded.tripped & ~decoded.read).sum()),
            "tripped_none": len(unseen),
            "tripped_none_force_N_median": float(np.median(unseen)) if len(unseen) else None,
            "tripped_none_force_N_largest": float(unseen.max()) if len(unseen) else None,
        },
        # The true switches of a real sensor are unknown: they are set to those that were read.
        "switches": decoded.switches() if all(item.meta.simulated for item in sets) else None,
    }


def scores(decoded: DecodedContacts, groups: Groups, seed: int) -> dict[str, Any]:
    """Return errors of every estimator in every group."""
    bootstrap = Bootstrap(sample=decoded.sample, seed=seed)
    out: dict[str, Any] = {}
    for name, estimate in decoded.decoded_N.items():
        elsewhere = np.abs(decoded.elsewhere_N[name])
        out[name] = {
            section: {
                group: bootstrap.score(estimate, decoded.force_N, mask)
                for group, mask in members.items()
            }
            for section, members in groups.items()
        } | {"elsewhere_N": {"mean": float(elsewhere.mean()), "largest": float(elsewhere.max())}}
    return out
