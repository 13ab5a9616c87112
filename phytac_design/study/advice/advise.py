"""Advice for one design: what slopes say to change, each piece applied and judged again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of, stand_off_mm
from phytac_design.rules.check import check_design
from phytac_design.study.advice.changes import (
    FAULTS,
    NOTHING,
    RULES,
    Change,
    Trial,
    broken_margin,
    costs_of,
    gain_of,
    gain_words,
    least_of,
    move_by,
    moves_of,
    rank_of,
    stand_off_of,
)
from phytac_design.study.advice.design_evaluation import EvaluatedDesign, evaluate_design
from phytac_design.study.advice.design_variables import ROW, choose, variables_of
from phytac_design.study.advice.local_model import LocalModel
from phytac_design.study.advice.repair import mends_of, passes_of
from phytac_design.study.advice.rows import (
    RowSlope,
    as_explicit,
    named_rows,
    row_sensitivities,
    row_variables,
    rows_of,
    suspects,
)
from phytac_design.study.advice.sensitivity import Sensitivity, sensitivities
from phytac_shapes.errors import DesignError, PhytacError

CHECKS = 5
"""Moves that are applied and judged."""


@dataclass(frozen=True, kw_only=True)
class Advice:
    """What to change about a design.

    Attributes
    ----------
    refused : str
        The rule that refuses the design as it is; then there are no figures.
    pieces, tried : list of Trial
        What helps, the most first; and what does not.
    """

    design: Design
    figures: dict[str, float]
    refused: str
    slopes: list[Sensitivity]
    rows: list[RowSlope]
    pieces: list[Trial]
    tried: list[Trial]


def advise(
    design: Design,
    accuracy: Accuracy,
    *,
    only: Sequence[str] = (),
    checks: int = CHECKS,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Advice:
    """Say what to change about a design.

    Parameters
    ----------
    only : sequence of str
        Names of knobs or of tables; ``rows`` for single rows that are at fault or stand out,
        ``rows.3`` for one of them; if empty all but rows that nothing is wrong with.
    checks : int
        Moves that are judged at most, the most promising first.

    Raises
    ------
    DesignError
        If a name is of no knob, or a design that a rule refuses cannot even place its markers.
    """
    try:
        check_design(design)
    except DesignError as error:
        return _mend_refused(design, str(error), accuracy, only, checks, seed, progress)
    progress("judging the design as it is")
    base = evaluate_design(design, accuracy, seed=seed)
    knobs = choose(variables_of(design, base.markers, stand_off_of(base)), list(only))
    row = rows_of(base.markers, float(base.surface.domain[0, 1] - base.surface.domain[0, 0]))
    wanted = named_rows(only, row)
    if not only or "rows" in only:
        wanted |= set(suspects(base, row))
    single = row_variables(base, row, sorted(wanted))
    probe = LocalModel(base, accuracy)
    slopes = sensitivities(probe, base, knobs, progress)
    judged = ChangeTester(base=base, accuracy=accuracy, seed=seed, progress=progress)
    if base.faults:
        moves = [
            Change(knob=knob, amount=amount, goal=FAULTS, predicted=found, gain=gain)
            for knob, amount, found, gain in mends_of(probe, [*single, *knobs], progress)
        ]
        trials = judged.all(moves, checks)
    else:
        slopes += sensitivities(probe, base, single, progress)
        moves, refused = moves_of(base, slopes)
        trials = [*judged.all(moves, checks), *refused]
    pieces = [trial for trial in trials if not trial.reason]
    return Advice(
        design=design,
        figures=base.figures,
        refused="",
        slopes=slopes,
        rows=row_sensitivities(probe, base, row),
        pieces=sorted(pieces, key=lambda trial: -rank_of(trial.move.goal, trial.gain)),
        tried=[trial for trial in trials if trial.reason],
    )


@dataclass(kw_only=True)
class ChangeTester:
    """Applies moves to a design and judges what comes of them."""

    base: EvaluatedDesign
    accuracy: Accuracy
    seed: int = 0
    progress: Callable[[str], None] = lambda _: None
    listed: dict[str, float] = field(default_factory=dict)

    def all(self, moves: Sequence[Change], checks: int) -> list[Trial]:
        """Trials of the first moves; one that broke something is tried once more, by less."""
        out: list[Trial] = []
        for move in moves:
            if len(out) >= checks:
                break
            out.append(self.one(move))
            less = [a for a in move.knob.amounts(move.amount) if abs(a) < abs(move.amount)]
            again = out[-1].reason.startswith("breaks") and len(out) < checks
            if again and less and move.slope is not None:
                nearer = move_by(self.base.figures, move.slope, move.goal, less[0])
                if nearer.gain >= least_of(move.goal):
                    out.append(self.one(nearer))
        return out

    def one(self, move: Change) -> Trial:
        """One move, applied and judged."""
        self.progress(f"trying {move.knob.words(move.amount)}")
        try:
            design = move.knob.moved(self.base.design, move.amount)
            after = evaluate_design(design, self.accuracy, seed=self.seed).figures
        except PhytacError as error:
            return Trial(move=move, reason=f"breaks a rule: {error}")
        before = self._before(move)
        gain = gain_of(move.goal, before, after)
        reason = broken_margin(before, after)
        if not reason and gain < least_of(move.goal) / 2.0:
            reason = f"does not help ({gain_words(move.goal, gain)})"
        return Trial(
            move=move, gain=gain, achieved=after, costs=costs_of(before, after), reason=reason,
            design=design,
        )  # fmt: skip

    def _before(self, move: Change) -> dict[str, float]:
        """Figures to compare with: of the same layout, listed, for moves of a row."""
        if move.knob.kind != ROW:
            return self.base.figures
        if not self.listed:
            same = as_explicit(self.base.design, self.base.markers)
            self.listed = evaluate_design(same, self.accuracy, seed=self.seed).figures
        return self.listed


def _mend_refused(
    design: Design,
    rule: str,
    accuracy: Accuracy,
    only: Sequence[str],
    checks: int,
    seed: int,
    progress: Callable[[str], None],
) -> Advice:
    """Advice for a design that a rule refuses: the least moves that it lets pass, judged."""
    surface = design.surface()
    try:
        markers = make_markers(design, surface)
    except DesignError:
        raise DesignError(rule) from None
    stand_off: float | None
    try:
        stand_off = stand_off_mm(design, surface, cameras_of(design, surface)[0])
    except DesignError:
        given = design.camera.stand_off_mm
        stand_off = None if given == "fit" else float(given)
    knobs = choose(variables_of(design, markers, stand_off), list(only))
    pieces: list[Trial] = []
    tried: list[Trial] = []
    for knob, amount in passes_of(design, knobs)[:checks]:
        progress(f"trying {knob.words(amount)}")
        move = Change(knob=knob, amount=amount, goal=RULES, predicted={}, gain=1.0)
        moved = knob.moved(design, amount)
        try:
            after = evaluate_design(moved, accuracy, seed=seed).figures
        except PhytacError as error:
            tried.append(Trial(move=move, reason=f"breaks a rule: {error}"))
            continue
        reason = broken_margin(NOTHING, after)
        trial = Trial(
            move=move, gain=0.0 if reason else 1.0, achieved=after, reason=reason, design=moved
        )
        (tried if reason else pieces).append(trial)
    return Advice(
        design=design, figures={}, refused=rule, slopes=[], rows=[], pieces=pieces, tried=tried
    )
