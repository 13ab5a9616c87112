"""Rows about a decoder's judgement, the same for every part of the benchmark."""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.decoder_evaluation import Claims, Evaluation
from benchmarks.harness import Table, holds
from phytac_shapes.arrays import BoolArray

BESIDE_MM = 15.0
"""A contact found so near to another one may be a part of it."""
PAPER = "paper, its real sensor"
TWIN = "truth of the simulated sensor"


Group = tuple[str, str]
"""Section and group of the evaluation; the latter may be only begun."""
Targets = Mapping[tuple[Group, str], Mapping[str, str]]

ALL, MIDDLE, RIMS = ("all", "all"), ("height", "middle"), ("height", "towards")
SINGLE, SEVERAL, SMALL = ("contact", "single"), ("contact", "several"), ("small", "below")
WORDS = {
    ALL: "all heights",
    MIDDLE: "middle heights",
    RIMS: "towards the rims",
    SINGLE: "single contacts",
    SEVERAL: "several at once",
    SMALL: "below 5 N",
}
"""Middle heights: 12.5 to 79.2 % of the way from rim to rim, the paper's 15 to 95 mm of 120."""
RELATIVE, MAE, SD = "relative_error", "absolute_error_mean_N", "absolute_error_sd_N"
NAMES = {
    RELATIVE: "mean relative error",
    MAE: "mean absolute error",
    SD: "SD of the absolute error",
}
PAPER_FIGURES: Mapping[tuple[Group, str], Mapping[str, float]] = {
    (ALL, RELATIVE): {"fem": 18.0, "fem_nn": 2.3, "fem_nn_identity": 2.3},
    (ALL, MAE): {"fem_nn": 0.11, "fem_nn_identity": 0.11},
    (ALL, SD): {"fem_nn": 0.16, "fem_nn_identity": 0.16},
    (SMALL, RELATIVE): {"fem": 49.0},
}
TARGETS: Targets = {(MIDDLE, RELATIVE): {"auto": "<= 1"}, (MIDDLE, MAE): {"auto": "<= 0.05"}}
NO_TARGETS: Targets = {}


FULL = (
    *((group, key) for group in (ALL, MIDDLE) for key in (RELATIVE, MAE, SD)),
    *((group, RELATIVE) for group in (RIMS, SINGLE, SEVERAL, SMALL)),
)
SHORT = tuple((group, key) for group in (ALL, MIDDLE) for key in (RELATIVE, MAE))
"""Figures of an estimator: group and measure."""


def add_scores(
    table: Table,
    head: str,
    judged: Evaluation,
    figures: Sequence[tuple[Group, str]],
    *,
    targets: Targets = NO_TARGETS,
    source: str = TWIN,
) -> None:
    """Rows of estimators, each with its interval; what misses says what the bound allows.

    Parameters
    ----------
    head : str
        What was judged on what.
    figures : list
        Group and measure of each row.
    targets : dict
        By group and measure, by estimator.
    source : str
        Of the truth.
    """
    for estimator in judged.decoded.decoded_N:
        for group, key in figures:
            mask = judged.group(*group)
            if not mask.any():
                continue
            score = judged.score(estimator, mask)
            figure = score[key]
            factor, unit = (100.0, "%") if key == RELATIVE else (1.0, "N")
            value = factor * figure["value"]
            paper = PAPER_FIGURES.get((group, key), {}).get(estimator)
            target = targets.get((group, key), {}).get(estimator)
            note = [f"95 %: {factor * figure['low']:.3g} to {factor * figure['high']:.3g} {unit}"]
            if target is not None and not holds(value, target):
                note.append(allowed(judged, mask))
            row = (
                f"{head}: {estimator}, {WORDS[group]} ({score['contacts']} contacts): {NAMES[key]}"
            )
            reference = "none" if paper is None else paper
            table.add(
                row,
                value,
                unit,
                reference,
                source if paper is None else f"{PAPER}; here {source}",
                target,
                "; ".join(note),
            )


def add_tenths(table: Table, head: str, judged: Evaluation) -> None:
    """Where along the sensor ``auto`` is worst, tenth by tenth."""
    tenths = judged.groups.get("along", {})
    error = judged.decoded.decoded_N["auto"] - judged.decoded.force_N
    share = 100.0 * error / np.maximum(judged.decoded.force_N, 1e-12)
    worst = {name: float(np.abs(share[mask]).mean()) for name, mask in tenths.items()}
    listed = [
        f"{name} {worst[name]:.2g} (sign {share[mask].mean():+.2g}, bound "
        f"{100.0 * judged.least_relative(mask)[0]:.2g})"
        for name, mask in tenths.items()
    ]
    row = f"{head}: auto, worst tenth of the way from rim to rim: mean relative error"
    note = f"mean |error|, mean with its sign, least that the bound allows, %: {'; '.join(listed)}"
    table.add(row, max(worst.values()), "%", "none", TWIN, note=note)


def allowed(judged: Evaluation, mask: BoolArray) -> str:
    """What the bound allows, in words."""
    least, _ = judged.least_relative(mask)
    return (
        f"the bound allows {100.0 * least:.2g} % at these contacts with this noise "
        f"({1e3 * float(np.median(judged.noise_px)):.0f}/1000 px)"
    )


def add_bounds(table: Table, head: str, judged: Evaluation, *, target: str | None) -> None:
    """How far ``auto`` is from the Cramér-Rao bound, and what that allows.

    ``target`` is for the ratio towards the rims; elsewhere the ratio is only reported.
    """
    for group in (ALL, MIDDLE, RIMS):
        mask = judged.group(*group)
        if not mask.any():
            continue
        ratio, least_N, alone = judged.over_bound(mask)
        least, median = judged.least_relative(mask)
        noise = judged.noise_px
        row = (
            f"{head}: auto, {WORDS[group]}: RMSE over the RMS of the Cramér-Rao bound, place, "
            "size and number unknown"
        )
        source = "linear shell of the design; noise of the data (markers that contacts leave alone)"
        note = (
            f"RMS of the bound {least_N:.3g} N; {alone:.3g} over the bound that knows all "
            f"about a sample's other contacts; {judged.typical(mask):.3g} from median |error| over "
            f"0.67 of the bound's median; noise {np.min(noise):.3f} to {np.max(noise):.3f}, "
            f"median {np.median(noise):.3f} px"
        )
        table.add(row, ratio, "ratio", 1.0, source, target if group == RIMS else None, note)
        row = f"{head}: {WORDS[group]}: least mean relative error that the bound allows"
        source = "0.8 of bound over force, mean; the paper's error beside it"
        note = f"median of bound over force {100.0 * median:.2g} %"
        table.add(row, 100.0 * least, "%", 2.3, source, note=note)


def add_claims(table: Table, head: str, claims: Claims, *, target: bool) -> None:
    """Whether 90 % intervals hold 90 % of the truths, and contacts found by motion alone."""
    count = len(claims.truth_N)
    if count:
        share = claims.covered
        row = f"{head}: auto, share of truths inside 90 % intervals: distance from 90 %"
        note = (
            f"{100.0 * share:.1f} % of {count} contacts inside; "
            f"{claims.unmatched} others were found as two or with another and count in neither"
        )
        table.add(row, abs(100.0 * share - 90.0), "%", 0.0, TWIN, "<= 2" if target else None, note)
    row = f"{head}: auto, contacts that tripped no switch, found within 5 mm by motion alone"
    source = "those pressed in frames in which another contact tripped a switch"
    table.add(row, claims.found_silent, "contacts", claims.pressed_silent, source)
    row = (
        f"{head}: auto, contacts found by motion alone where none was pressed within 5 mm that "
        "tripped no switch"
    )
    source = "all that were found by motion alone"
    note = _nothing(claims)
    table.add(row, len(claims.nothing_N), "contacts", claims.claimed_silent, source, note=note)


def _nothing(claims: Claims) -> str:
    if not len(claims.nothing_N):
        return ""
    near = int((claims.nothing_mm <= BESIDE_MM).sum())
    return (
        f"forces {claims.nothing_N.min():.2g} to {claims.nothing_N.max():.2g} N, median "
        f"{np.median(claims.nothing_N):.2g} N; {near} of them within {BESIDE_MM:g} mm of a "
        "contact that tripped a switch: its force split in two"
    )


def add_switches(table: Table, head: str, judged: Evaluation) -> None:
    """Key nodes of interest: recall and false ones."""
    found = judged.decoded
    if found.on:
        row = f"{head}: KOI recall ({found.on} switches on)"
        source = "activation law"
        table.add(row, 100.0 * (1.0 - found.missed / found.on), "%", 100.0, source, ">= 99.9")
    if found.off:
        row = f"{head}: false KOI ({found.off} switches off)"
        table.add(row, 100.0 * found.false / found.off, "%", 0.0, "activation law", "<= 0.1")
