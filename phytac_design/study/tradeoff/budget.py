"""The best setting in a given time: planned by the cost model, and again after every few stages.

Settings rise on a ladder. A build goes through groups of stages; before each the rung is chosen
anew as the highest whose stages, with all that are still to come at that rung, fit what is left of
the time. What has run corrects the model, so that only the last stages are a guess.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.engine import cache
from phytac_design.engine.stage import Context
from phytac_design.stages import STAGES
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.study.tradeoff.cost import Work, machine_factor, predict
from phytac_shapes.errors import DesignError

Progress = Callable[[str], None]
GROUPS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    (("views", "switch", "compare"), ()),
    (
        ("mesh", "response", "resolution", "places"),
        ("refine", "receptors", "place_share", "place_orders"),
    ),
    (("underload",), ("press_places", "press_tolerance")),
    (
        ("shell", "step", "hardware", "mold", "kit", "printing", "bench"),
        ("cad_tolerance_mm", "print_tools"),
    ),
    (("twin", "decoder"), ("truth_refine", "sample_share")),
    (("frames", "report"), ("frames",)),
)
"""Stages that run together, and the knobs that are settled before them."""


def _rung(
    base: Accuracy, mechanics: tuple[int, int, float], load: tuple[int, float], **more: Any
) -> Accuracy:
    refine, orders, share = mechanics
    return replace(
        base,
        refine=refine,
        place_orders=orders,
        place_share=share,
        press_places=load[0],
        press_tolerance=load[1],
        **more,
    )


DRAFT, STANDARD, FINE = (PRESETS[name] for name in ("draft", "standard", "fine"))
LADDER: tuple[Accuracy, ...] = (
    _rung(DRAFT, (2, 1, 1.2), (4, 1.0), cad_tolerance_mm=0.1, sample_share=0.1, frames=2),
    DRAFT,
    _rung(DRAFT, (3, 3, 0.8), (8, 1.0)),
    _rung(DRAFT, (4, 3, 0.8), (8, 1.0), cad_tolerance_mm=0.02, frames=10),
    _rung(DRAFT, (4, 3, 0.8), (20, 1.0), cad_tolerance_mm=0.02, truth_refine=7, frames=20),
    _rung(STANDARD, (4, 4, 0.55), (20, 0.05), truth_refine=7, frames=30),
    STANDARD,
    _rung(STANDARD, (5, 4, 0.55), (60, 0.05), truth_refine=11, frames=75),
    FINE,
)
"""Settings from the cheapest to the finest."""
MARGIN = 1.08
"""Factor on what is still to come."""
PRIOR_s = 4.0
"""Seconds that the machine's probe counts like when it is held against what has run."""


@dataclass(kw_only=True)
class Plan:
    """A build in a given time, as far as it has come.

    Attributes
    ----------
    design : Design
        The sensor.
    budget_s : float
        Wall seconds from ``begin`` on.
    seed : int
        Of the build.
    begin : float
        ``time.perf_counter()`` at its start.
    factor : float
        Seconds of this machine over the model's.
    setting : Accuracy
        What has been settled; the rest is of the first plan.
    """

    design: Design
    budget_s: float
    seed: int
    begin: float
    work: Work
    factor: float
    setting: Accuracy

    @property
    def left_s(self) -> float:
        """What is left of the budget."""
        return self.budget_s - (time.perf_counter() - self.begin)


def cached_stages(design: Design, setting: Accuracy, seed: int) -> frozenset[str]:
    """Stages whose results are in the cache."""
    context = Context(design=design, accuracy=setting, seed=seed, progress=lambda _: None)
    keys: dict[str, str] = {}
    for stage in STAGES:
        key = keys[stage.name] = cache.stage_key(stage.name, stage.inputs(context, keys))
        folder = cache.lookup(stage.name, key)
        if folder is not None:
            context.folders[stage.name] = folder
    return frozenset(context.folders)


def choose_budget(
    design: Design, budget_s: float, *, seed: int = 0
) -> tuple[Plan, dict[str, float]]:
    """Find the finest rung that is predicted to be built in a time, and seconds of its stages.

    Raises
    ------
    DesignError
        If even the cheapest is predicted to take longer.
    """
    if not 0.0 < budget_s < float("inf"):
        raise DesignError(f"the budget must be above 0 s (got {budget_s:g} s)")
    begin = time.perf_counter()
    work, factor = Work(design), machine_factor()
    plan = Plan(
        design=design,
        budget_s=budget_s,
        seed=seed,
        begin=begin,
        work=work,
        factor=factor,
        setting=LADDER[0],
    )
    # What is in the cache may make a finer rung cheaper than the first.
    each = [_predicted(plan, rung) for rung in LADDER]
    for rung, seconds in zip(reversed(LADDER), reversed(each), strict=True):
        if MARGIN * sum(seconds.values()) <= budget_s:
            plan.setting = rung
            return plan, seconds
    least = min(each, key=lambda seconds: sum(seconds.values()))
    if sum(least.values()) <= budget_s:
        plan.setting = LADDER[each.index(least)]
        return plan, least
    costly = sorted(least, key=least.__getitem__)[-3:][::-1]
    parts = ", ".join(f"{name} {least[name]:.1f} s" for name in costly)
    raise DesignError(
        f"no setting of this design is built in {budget_s:g} s: the cheapest is predicted to "
        f"take {sum(least.values()):.0f} s here ({parts}); allow that, or build some stages "
        "with --only"
    )


def _predicted(plan: Plan, setting: Accuracy) -> dict[str, float]:
    known = cached_stages(plan.design, setting, plan.seed)
    return predict(plan.work, setting, factor=plan.factor, cached=known)


def run_plan(
    plan: Plan, *, force: bool, progress: Progress, ran: dict[str, float] | None = None
) -> Accuracy:
    """Run all stages into the cache, group by group; return the setting they were run with.

    Parameters
    ----------
    plan : Plan
        Of :func:`choose_budget`.
    force : bool
        Go on where a stage objects.
    ran : dict, optional
        Filled with the seconds of stages that ran.
    """
    ran = {} if ran is None else ran
    raw = 0.0
    prior = plan.factor
    for number, (names, _) in enumerate(GROUPS):
        plan.setting = _replanned(plan, number)
        foretold = predict(plan.work, plan.setting)
        stages = select_stages(names)
        _, done, timing = run_stages(
            plan.design,
            stages,
            accuracy=plan.setting,
            seed=plan.seed,
            force=force,
            progress=progress,
        )
        ran |= {name: timing[name] for name in done}
        raw += sum(foretold[name] for name in done)
        plan.factor = (PRIOR_s * prior + sum(ran.values())) / (PRIOR_s + raw)
    return plan.setting


def _replanned(plan: Plan, number: int) -> Accuracy:
    """Setting with the knobs of group ``number`` and later of the highest rung that fits."""
    later = {knob for _, knobs in GROUPS[number:] for knob in knobs}
    ahead = {name for names, _ in GROUPS[number:] for name in names}
    least: tuple[float, Accuracy] | None = None
    for rung in reversed(LADDER):
        setting = _with(plan.setting, rung, later)
        seconds = _predicted(plan, setting)
        spent = MARGIN * sum(seconds[name] for name in ahead)
        if spent <= max(plan.left_s, 0.0):
            return setting
        if least is None or spent <= least[0]:
            least = spent, setting
    return least[1] if least else plan.setting


def _with(settled: Accuracy, rung: Accuracy, knobs: set[str]) -> Accuracy:
    values: Mapping[str, Any] = rung.as_dict()
    return replace(settled, **{knob: values[knob] for knob in knobs})
