"""The plan of a build: what runs, how finely, why and at what cost; what is left out."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from phytac_design.design.accuracy import Accuracy, preset_name
from phytac_design.design.scene import Scene
from phytac_design.design.spec import Design
from phytac_design.engine import cache
from phytac_design.engine.stage import Context, Stage
from phytac_design.layout import make_markers
from phytac_design.mechanics.large.linear_error import LINEAR_ERROR_SAFETY
from phytac_design.stages import STAGES
from phytac_design.study.planning.cost import Cost, predict, probe
from phytac_design.study.planning.counts import Counts, count, counts_of
from phytac_design.study.planning.resolve import Resolved, resolve
from phytac_design.study.planning.words import how_of, lost_by, why_of

MESH_ERROR = 0.2
"""Error of a force by a mesh of one element per marker pitch, as a share of it; it falls with the
square of their number. Set so that predictions cover the worst of 8 presses of `fingertip` on
cylinder60 (0.46 %) and on grip (1.3 %), and of 10 of `grip5` on cylinder60 (1.0 %)."""
TABLE_ERROR = 0.002
"""Error of `auto` between the places of its tables, at 0.55 of the patches' radius."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One stage of a plan.

    Attributes
    ----------
    stage : str
        Name.
    action : str
        ``run``, ``cached`` or ``left out``.
    how : str
        How finely, and of how much.
    why : str
        What asks for it, or for it no more.
    seconds, memory_MB : float
        Predicted cost; 0 from the cache. Of a stage that is left out, what it would have cost in
        the whole build.
    loses : str
        What leaving out, or limiting, costs.
    """

    stage: str
    action: str
    how: str
    why: str
    seconds: float
    memory_MB: float
    loses: str


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a build of a scene will do.

    Attributes
    ----------
    resolved : Resolved
        The scene on the design.
    rows : tuple of Row
        Of all stages, in their order.
    counts, whole_counts : Counts
        Sizes of this build and of a whole one.
    whole_seconds, whole_memory_MB : float
        Predicted cost of a whole build.
    error : dict
        Predicted error of a force in the regions, as a share of it: its parts, and ``force``; empty
        where no decoder is made.
    """

    resolved: Resolved
    rows: tuple[Row, ...]
    counts: Counts
    whole_counts: Counts
    whole_seconds: float
    whole_memory_MB: float
    error: dict[str, float]

    @property
    def seconds(self) -> float:
        """Predicted processor time of what runs, s."""
        return sum(row.seconds for row in self.rows if row.action == "run")

    @property
    def memory_MB(self) -> float:
        """Predicted peak memory of what runs, MB."""
        return max((row.memory_MB for row in self.rows if row.action == "run"), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        resolved = self.resolved
        return {
            "design": resolved.design.name,
            "scene": resolved.scene.model_dump(mode="json"),
            "accuracy": preset_name(resolved.accuracy),
            "settings": resolved.accuracy.as_dict(),
            "decisions": resolved.why,
            "linear_error": resolved.linear_error,
            "stages": [asdict(row) for row in self.rows],
            "counts": asdict(self.counts),
            "whole": asdict(self.whole_counts)
            | {"seconds": self.whole_seconds, "memory_MB": self.whole_memory_MB},
            "predicted": {
                "seconds": self.seconds,
                "memory_MB": self.memory_MB,
                "error": self.error,
            },
        }


def plan_scene(
    design: Design, scene: Scene, *, accuracy: Accuracy, seed: int = 0, speed: float | None = None
) -> Plan:
    """Plan the build of a scene; nothing runs but a pilot of less than a second.

    Parameters
    ----------
    speed : float, optional
        As of :func:`cost.probe`; probed if not given.

    Raises
    ------
    DesignError
        If the scene does not go with the design.
    """
    resolved = resolve(design, scene, accuracy)
    slow = probe() if speed is None else speed
    counts = counts_of(resolved)
    surface = design.surface()
    whole = count(design, accuracy, surface, make_markers(design, surface))
    names = [stage.name for stage in STAGES]
    full = predict(names, whole, accuracy, design, speed=slow)
    mine = predict(names, counts, resolved.accuracy, resolved.design, resolved.scene, speed=slow)
    cached = cached_stages(resolved, seed)
    chosen = {stage.name for stage in resolved.stages}
    rows = tuple(
        _row(name, resolved, counts, chosen, cached, mine[name] if name in chosen else full[name])
        for name in names
    )
    return Plan(
        resolved=resolved,
        rows=rows,
        counts=counts,
        whole_counts=whole,
        whole_seconds=sum(cost.seconds for cost in full.values()),
        whole_memory_MB=max(cost.memory_MB for cost in full.values()),
        error=predicted_error(resolved) if "decoder" in chosen else {},
    )


def context_of(resolved: Resolved, seed: int = 0) -> Context:
    """Context of a scene's stages."""
    return Context(
        design=resolved.design,
        accuracy=resolved.accuracy,
        seed=seed,
        scene=resolved.scene,
        progress=lambda _: None,
    )


def cached_stages(resolved: Resolved, seed: int) -> set[str]:
    """Stages whose results lie in the cache."""
    context = context_of(resolved, seed)
    keys: dict[str, str] = {}
    found = set()
    stages: Sequence[Stage] = resolved.stages
    for stage in stages:
        keys[stage.name] = cache.stage_key(stage.name, stage.inputs(context, keys))
        folder = cache.lookup(stage.name, keys[stage.name])
        if folder is not None:
            context.folders[stage.name] = folder
            found.add(stage.name)
    return found


def _row(
    name: str,
    resolved: Resolved,
    counts: Counts,
    chosen: set[str],
    cached: set[str],
    cost: Cost,
) -> Row:
    action = "left out"
    if name in chosen:
        action = "cached" if name in cached else "run"
    free = action == "cached"
    return Row(
        stage=name,
        action=action,
        how=how_of(name, resolved, counts) if name in chosen else "",
        why=why_of(name, resolved),
        seconds=0.0 if free else cost.seconds,
        memory_MB=0.0 if free else cost.memory_MB,
        loses=lost_by(name, resolved, counts),
    )


def predicted_error(resolved: Resolved) -> dict[str, float]:
    """Parts of the error of a force in the regions, by `auto`, without noise, as shares of it.

    Linear theory errs by what the pilot found, with its safety; the powers of the force up to k by
    about the k-th power of what it found, as the terms of a geometric series do.
    """
    off, accuracy = min(resolved.linear_error, 1.0), resolved.accuracy
    orders = accuracy.place_orders
    if "places" not in {stage.name for stage in resolved.stages}:
        return {}
    parts = {
        "theory": off if orders == 1 else (off / LINEAR_ERROR_SAFETY) ** orders,
        "mesh": MESH_ERROR / accuracy.refine**2,
        "table": TABLE_ERROR * (accuracy.place_share / 0.55) ** 3,
    }
    return parts | {"force": sum(value**2 for value in parts.values()) ** 0.5}
