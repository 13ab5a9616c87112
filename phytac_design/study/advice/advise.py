"""Advice for one design: changes that sensitivities suggest, each applied and evaluated."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_changes import (
    Change,
    broken_margin,
    change_by,
    changes_of,
    costs_of,
    gain_of,
    gain_words,
    least_gain,
    limits_of,
    rank_of,
    repairs,
    rule_repairs,
)
from phytac_design.study.advice.design_evaluation import FIGURES, LIMITS, evaluate_design
from phytac_design.study.advice.design_variables import (
    ROW,
    as_explicit,
    choose,
    named_rows,
    row_variables,
    rows_of,
    suspects,
    variables_of,
)
from phytac_design.study.advice.local_model import (
    LocalModel,
    RowSensitivity,
    Sensitivity,
    row_sensitivities,
    sensitivities,
)
from phytac_design.study.advice.stiffness_changes import stiffness_changes, stiffness_fault
from phytac_design.study.advice.switch_changes import readable_changes, threshold_changes
from phytac_design.workflows.design_check import threshold_fault, unreadable_fault
from phytac_design.workflows.switch_feasibility import check_thresholds
from phytac_shapes.errors import DesignError, PhytacError

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Advice:
    """What to change about a design.

    Attributes
    ----------
    figures : dict
        Of the design as it is; empty if a rule rejects it.
    refused : str
        The rule that rejects the design; "" if none does.
    pieces, tried : list of Change
        What helps, the most first; and what does not.
    switch_faults : list of str
        Why ``phytac check`` rejects its switches, if it does.
    stiff : str
        That the shell is too stiff for the largest force, if it is.
    """

    design: Design
    figures: dict[str, float] = field(default_factory=dict)
    refused: str = ""
    slopes: list[Sensitivity] = field(default_factory=list)
    rows: list[RowSensitivity] = field(default_factory=list)
    pieces: list[Change]
    tried: list[Change]
    switch_faults: list[str] = field(default_factory=list)
    stiff: str = ""


def advise(
    design: Design,
    accuracy: Accuracy,
    *,
    only: Sequence[str] = (),
    checks: int = 5,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Advice:
    """Find what to change about a design.

    Parameters
    ----------
    only : sequence of str
        Names of variables or of tables; ``rows`` for rows that are faulty or outliers, ``rows.3``
        for one row; if empty all but rows without a fault.
    checks : int
        Changes that are evaluated at most, the most promising first.

    Raises
    ------
    DesignError
        If a name is of no variable, or the markers of a rejected design cannot even be placed.
    """
    try:
        check_design(design)
    except DesignError as error:
        # All margins count.
        faultless = {name: 0.0 if FIGURES[name].less else float("inf") for name in LIMITS}
        tester = ChangeTester(Sensor(design), faultless, accuracy, seed, progress)
        tester.castable = threshold_fault(design, progress=progress) is None
        return _repair_rejected(error, only, tester, checks)
    progress("evaluating the design as it is")
    base = evaluate_design(design, accuracy, seed=seed)
    variables = choose(variables_of(base.sensor), only)
    row = rows_of(base.sensor)
    wanted = named_rows(only, row)
    if not only or "rows" in only:
        wanted |= set(suspects(base, row))
    single = row_variables(base.sensor, row, sorted(wanted))
    model = LocalModel(base, accuracy)
    slopes = sensitivities(model, variables, progress)
    tester = ChangeTester(base.sensor, base.figures, accuracy, seed, progress)
    blind, count = int(base.figures["switch_unreadable"]), base.sensor.markers.count
    unreadable, unfit = unreadable_fault(blind, count), threshold_fault(design, progress=progress)
    tester.castable = unfit is None
    tested: list[Change] = []
    if unfit and not only:
        tested += threshold_changes(design, base.figures, progress=progress)
    if not only:
        castable = tester.castable
        for one in readable_changes(
            design, blind, count, seed=seed, castable=castable, progress=progress
        ):
            tested.append(one if one.reason else tester.test(one))
    stiff = stiffness_fault(design)
    if stiff and not only:
        tested += [one if one.reason else tester.test(one) for one in stiffness_changes(design)]
    if base.faults:
        tested += tester.test_all(repairs(model, [*single, *variables], progress), checks)
    else:
        slopes += sensitivities(model, single, progress)
        changes, rejected = changes_of(base, slopes)
        tested += [*tester.test_all(changes, checks), *rejected]
    pieces = [one for one in tested if not one.reason]
    return Advice(
        design=design,
        figures=base.figures,
        slopes=slopes,
        rows=row_sensitivities(model, row),
        pieces=sorted(pieces, key=lambda one: -rank_of(one.goal, one.gain)),
        tried=[one for one in tested if one.reason],
        switch_faults=[str(fault) for fault in (unreadable, unfit) if fault],
        stiff=stiff,
    )


@dataclass
class ChangeTester:
    """Applies changes to a design and evaluates the results against its figures ``before``.

    ``castable`` says whether bowls have the design's thresholds, and so must have those of changed
    ones.
    """

    sensor: Sensor
    before: dict[str, float]
    accuracy: Accuracy
    seed: int = 0
    progress: Progress = lambda _: None
    listed: dict[str, float] = field(default_factory=dict)
    castable: bool = False

    def test_all(self, changes: Sequence[Change], checks: int) -> list[Change]:
        """Evaluate the first changes; one that broke something is tried again, smaller."""
        out: list[Change] = []
        for change in changes:
            if len(out) >= checks:
                break
            out.append(self.test(change))
            less = [
                a for a in change.variable.amounts(change.amount) if abs(a) < abs(change.amount)
            ]
            again = out[-1].reason.startswith("breaks") and len(out) < checks
            if again and less and change.slope is not None:
                smaller = change_by(self.before, change.slope, change.goal, less[0])
                if smaller.predicted_gain >= least_gain(change.goal):
                    out.append(self.test(smaller))
        return out

    def test(self, change: Change) -> Change:
        """The change with what it achieves."""
        self.progress(f"trying {change.words}")
        try:
            design = change.variable.moved(self.sensor.design, change.amount)
            if self.castable:
                check_thresholds(design, progress=self.progress)
            after = evaluate_design(design, self.accuracy, seed=self.seed).figures
        except PhytacError as error:
            return replace(change, reason=f"breaks a rule: {error}")
        before = self.before
        if change.variable.kind == ROW:
            # Compare with the same layout as an explicit list.
            if not self.listed:
                same = as_explicit(self.sensor)
                self.listed = evaluate_design(same, self.accuracy, seed=self.seed).figures
            before = self.listed
        reason = broken_margin(before, after, limits_of(design))
        gain, costs = float(not reason), tuple[str, ...]()
        if change.goal != "rules":
            gain, costs = gain_of(change.goal, before, after), costs_of(before, after)
        if not reason and gain < least_gain(change.goal) / 2.0:
            reason = f"does not help ({gain_words(change.goal, gain)})"
        return replace(change, gain=gain, achieved=after, costs=costs, reason=reason, design=design)


def _repair_rejected(
    rule: DesignError, only: Sequence[str], tester: ChangeTester, checks: int
) -> Advice:
    """Advice for a design that a rule rejects: the smallest changes that satisfy it, evaluated."""
    try:
        variables = variables_of(tester.sensor)
    except DesignError:
        raise rule from None
    design = tester.sensor.design
    tested = tester.test_all(rule_repairs(design, choose(variables, only)), checks)
    return Advice(
        design=design,
        refused=str(rule),
        pieces=[one for one in tested if not one.reason],
        tried=[one for one in tested if one.reason],
    )
