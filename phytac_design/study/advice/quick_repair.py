"""One change after which every marker is visible at rest, in seconds: a start for ``advise``."""

import time
from collections.abc import Callable

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.render_scene import BAR
from phytac_design.optics.visibility import Visibility, best_of, check_visibility
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_variables import DesignVariable, variables_of
from phytac_shapes.errors import PhytacError

REMEDIES: dict[str, tuple[int, ...]] = {
    "light.bar_radius_mm": (-4, -8),
    "layout.heights (all, times)": (-4, -8),
    "layout.height_exponent": (5, 10, 20),
    "camera.stand_off_mm": (6, 24),
    "layout.columns": (-1, -2),
    "layout.rows": (-2, -4),
    "layout.count": (-5, -15),
    "receptor.band_marker_mm": (-3,),
}
"""Variables that clear markers, the cheapest for the sensor first, and numbers of their steps."""


def seen_at_rest(sensor: Sensor, *, seed: int = 0) -> Visibility:
    """Visibility of every marker in its best camera, as in `phytac check`."""
    rng = np.random.default_rng(seed)
    return best_of([check_visibility(sensor, rng=rng, camera=one) for one in sensor.cameras])[0]


def quick_repair(
    design: Design,
    *,
    seed: int = 0,
    seconds: float = 20.0,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[str, Design] | None:
    """Change of one variable that makes every marker of a design visible and separable at rest.

    Presses are not evaluated: `phytac advise` does that.

    Parameters
    ----------
    seconds : float
        No change is tried after this time.

    Returns
    -------
    words, changed : str and Design
        The change for a reader and the changed design; None if none that was tried does.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    start = time.monotonic()
    sensor = check_design(design)
    by_bar = bool((seen_at_rest(sensor, seed=seed).hidden_by == BAR).any())
    variables = {one.name: one for one in variables_of(sensor)}
    for name, times in REMEDIES.items():
        if name not in variables or (name == "light.bar_radius_mm" and not by_bar):
            continue
        for count in times:
            if time.monotonic() - start > seconds:
                return None
            amount = count * variables[name].step
            changed = _clear(variables[name], design, amount, seed, progress)
            if changed is not None:
                return variables[name].words(amount), changed
    return None


def _clear(
    variable: DesignVariable,
    design: Design,
    amount: float,
    seed: int,
    progress: Callable[[str], None],
) -> Design | None:
    """The changed design, if it keeps every rule and shows every marker."""
    progress(f"trying {variable.words(amount)}")
    try:
        changed = variable.moved(design, amount)
        seen = seen_at_rest(check_design(changed), seed=seed)
    except PhytacError:
        return None
    return changed if bool(seen.clear.all()) else None
