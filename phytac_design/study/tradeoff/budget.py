"""The finest setting that is built within a time: planned, and planned again between stages.

Settings are ordered in levels from the cheapest to the finest. A build runs in groups of stages;
before each group the level is chosen again as the finest whose remaining stages fit the remaining
time. Measured times correct the cost model.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from phytac_design.design.accuracy import PRESETS, Accuracy
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context
from phytac_design.stages import STAGES
from phytac_design.stages.build import run_stages, select_stages
from phytac_design.study.planning.cost import Workload, machine_factor
from phytac_design.study.planning.plan import cached_stages
from phytac_design.study.tradeoff.choose import wall_seconds
from phytac_shapes.errors import DesignError

Progress = Callable[[str], None]
GROUPS = (
    ("views", "switch"),
    ("mesh", "response", "resolution", "places"),
    ("underload", "pressed"),
    ("shell", "step", "hardware", "mold", "kit", "inserts", "printing", "bench", "compare"),
    ("twin", "decoder"),
    ("renders", "frames", "report"),
)
"""Stages that run together; their settings are fixed before each group."""


DRAFT, STANDARD, FINE = (PRESETS[name] for name in ("draft", "standard", "fine"))
LEVELS: tuple[Accuracy, ...] = (
    replace(
        DRAFT,
        refine=2,
        place_share=1.2,
        press_places=4,
        cad_tolerance_mm=0.1,
        sample_share=0.1,
        frames=2,
    ),
    DRAFT,
    replace(DRAFT, place_orders=3),
    replace(DRAFT, refine=4, place_orders=3, cad_tolerance_mm=0.02, frames=10, step=True),
    replace(
        DRAFT,
        refine=4,
        step=True,
        place_orders=3,
        cad_tolerance_mm=0.02,
        press_places=20,
        truth_refine=7,
        frames=20,
    ),
    replace(STANDARD, place_share=0.55, press_places=20, truth_refine=7, frames=30),
    STANDARD,
    replace(STANDARD, refine=5, place_share=0.55, press_places=60, truth_refine=11, frames=75),
    FINE,
)
"""Settings from the cheapest to the finest."""


@dataclass(kw_only=True)
class BudgetPlan:
    """A build within a time, and its progress.

    Attributes
    ----------
    budget_s : float
        Wall seconds from ``begin`` on.
    begin : float
        ``time.perf_counter()`` at its start.
    factor : float
        Seconds of this machine over the cost model's.
    setting : Accuracy
        Settings that are fixed; the others are of the first plan.
    margin : float
        Factor on the time of stages that are still to run.
    probe_weight_s : float
        Seconds of measured stages that the machine's probe counts as.
    """

    work: Workload
    budget_s: float
    seed: int
    begin: float
    factor: float
    setting: Accuracy = LEVELS[0]
    margin: float = 1.08
    probe_weight_s: float = 4.0

    def seconds(self, setting: Accuracy) -> dict[str, float]:
        """Predicted wall seconds of each stage; 0 for those in the cache."""
        context = Context(
            design=self.work.design, accuracy=setting, seed=self.seed, progress=lambda _: None
        )
        cached = cached_stages(context, STAGES)
        return {
            name: 0.0 if name in cached else self.factor * seconds
            for name, seconds in wall_seconds(self.work, setting).items()
        }


def choose_budget(
    design: Design, budget_s: float, *, seed: int = 0
) -> tuple[BudgetPlan, dict[str, float]]:
    """Find the finest level that is predicted to be built in a time, and seconds of its stages.

    Raises
    ------
    DesignError
        If even the cheapest is predicted to take longer.
    """
    if not 0.0 < budget_s < float("inf"):
        raise DesignError("budget-invalid", f"the budget must be above 0 s (got {budget_s:g} s)")
    begin = time.perf_counter()
    plan = BudgetPlan(
        work=Workload(design), budget_s=budget_s, seed=seed, begin=begin, factor=machine_factor()
    )
    # Cached results may make a finer level cheaper than the first.
    each = [plan.seconds(level) for level in LEVELS]
    total = [sum(seconds.values()) for seconds in each]
    cheapest = total.index(min(total))
    if total[cheapest] > budget_s:
        parts = each[cheapest]
        costly = sorted(parts, key=parts.__getitem__)[-3:][::-1]
        listed = ", ".join(f"{name} {parts[name]:.1f} s" for name in costly)
        raise DesignError(
            "budget-not-reachable",
            f"no setting of this design is built in {budget_s:g} s: the cheapest is predicted to "
            f"take {total[cheapest]:.0f} s here ({listed}); allow that, or build some stages "
            "with --only",
        )
    fitting = [k for k, seconds in enumerate(total) if plan.margin * seconds <= budget_s]
    chosen = fitting[-1] if fitting else cheapest
    plan.setting = LEVELS[chosen]
    return plan, each[chosen]


def run_budget(plan: BudgetPlan, *, force: bool, progress: Progress) -> dict[str, float]:
    """Run all stages into the cache, group by group; ``plan.setting`` is what they ran with.

    Returns
    -------
    ran : dict
        Wall seconds of the stages that ran.
    """
    ran: dict[str, float] = {}
    modelled, prior = 0.0, plan.factor
    for number, names in enumerate(GROUPS):
        plan.setting = _replanned(plan, number)
        model = wall_seconds(plan.work, plan.setting)
        _, done, timing = run_stages(
            plan.work.design,
            select_stages(names),
            accuracy=plan.setting,
            seed=plan.seed,
            force=force,
            progress=progress,
        )
        ran |= {name: timing[name] for name in done}
        modelled += sum(model[name] for name in done)
        weight = plan.probe_weight_s
        plan.factor = (weight * prior + sum(ran.values())) / (weight + modelled)
    return ran


def _replanned(plan: BudgetPlan, number: int) -> Accuracy:
    """Setting with the fields of group ``number`` and later from the finest level that fits."""
    done, ahead = (
        [name for names in part for name in names] for part in (GROUPS[:number], GROUPS[number:])
    )
    open_fields = fields_used_by(ahead) - fields_used_by(done)
    left_s = max(plan.budget_s - (time.perf_counter() - plan.begin), 0.0)
    tried = []
    for level in reversed(LEVELS):
        setting = replace(plan.setting, **{name: getattr(level, name) for name in open_fields})
        seconds = plan.seconds(setting)
        spent = plan.margin * sum(seconds[name] for name in ahead)
        if spent <= left_s:
            return setting
        tried.append((spent, setting))
    return min(reversed(tried), key=lambda pair: pair[0])[1]


def fields_used_by(names: Sequence[str]) -> set[str]:
    """Fields of the settings that some stages depend on."""
    return {field for stage in STAGES if stage.name in names for field in stage.settings}
