"""One change after which a design passes the check, in seconds: a start for ``advise``."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.loaded_visibility import FUSED_PX
from phytac_design.optics.render_scene import BAR
from phytac_design.optics.visibility import FRACTION_MIN, Visibility, best_of, check_visibility
from phytac_design.rules.check import check_design
from phytac_design.study.advice.design_variables import Fields, variables_of, with_fields
from phytac_design.study.search.fidelity_levels import outlined_gap_px, sampled_fractions
from phytac_shapes.errors import DesignError, PhytacError

REMEDIES: dict[str, tuple[int, ...]] = {
    "light.bar_radius_mm": (-4, -8),
    "layout.spiral_angle_deg": (10, -10, 20, -20, 40, -40, 80, -80),
    "layout.heights (all, times)": (-4, -8),
    "layout.height_exponent": (5, 10, 20),
    "camera.stand_off_mm": (6, 24),
    "layout.columns": (-1, -2, -3, -4, -6),
    "layout.rows": (-2, -4, -6, -8, -12, -16, -20, -24, -32),
    "layout.count": (-5, -15),
    "receptor.band_marker_mm": (-3,),
}
"""Variables that clear markers, the cheapest for the sensor first, and numbers of their steps."""
RULES: dict[str, tuple[int, ...]] = {
    "receptor.diameter_outer_mm": (1, 2, -2, -4),
    "wall.thickness_mm": (1, 2, 4, 8, -4),
}
"""Variables that are tried first where a rule is broken."""
DEEPER_TIPS_mm = (
    {"tip_recess_mm": 0.3},
    {"tip_recess_mm": 0.6},
    {"tip_recess_mm": 0.3, "stroke_mm": 0.3},
    {"tip_recess_mm": 0.5, "stroke_mm": 0.5},
)
"""Changes with which a resting tip is seen less."""
MORE_PIXELS = (1.5, 2.0, 3.0)
"""Cameras with this many times the pixels along each side are tried after the variables."""


@dataclass(frozen=True, kw_only=True)
class Repair:
    """A change after which a design passes the check.

    Attributes
    ----------
    words : str
        The change for a reader.
    fields : dict
        New values by TABLE.FIELD.
    design : Design
        The changed design.
    """

    words: str
    fields: dict[str, Any]
    design: Design


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
) -> Repair | None:
    """Change of one variable after which a design keeps every rule and shows every marker at rest.

    Changes are screened by some 64 rays a marker; the first that passes is confirmed exactly.
    Presses are not evaluated: `phytac advise` does that.

    Parameters
    ----------
    seconds : float
        No change is tried after this time.

    Returns
    -------
    Repair or None
        None if none that was tried does.

    Raises
    ------
    DesignError
        If its markers cannot be placed.
    """
    start = time.monotonic()
    try:
        sensor = check_design(design)
        by_bar = bool((seen_at_rest(sensor, seed=seed).hidden_by == BAR).any())
        changes = _changes(sensor, REMEDIES, by_bar=by_bar)
    except DesignError:
        sensor = Sensor(design)
        changes = chain(_fitted(design), _changes(sensor, RULES | REMEDIES, by_bar=True))
    for words, fields in changes:
        if time.monotonic() - start > seconds:
            return None
        progress(f"trying {words}")
        changed = _clear(design, fields, seed)
        if changed is not None:
            return Repair(words=words, fields=dict(fields), design=changed)
    return None


def readable_tips(
    design: Design,
    *,
    fits: Callable[[Design], None],
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Repair, int, int] | None:
    """Recess and stroke of the switches' tips with which the camera reads more of them.

    A camera that looks straight into a hole sees a resting tip too, unless it rests deeper.

    Parameters
    ----------
    fits : callable
        Raises an error for a design whose switches cannot be made.

    Returns
    -------
    repair, before, after : Repair, int and int
        The change, and how many switches cannot be read; None if none that was tried leaves at most
        two thirds of them.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    before = int(seen_at_rest(check_design(design), seed=seed).switch_unreadable.sum())
    tried: list[tuple[int, Repair]] = []
    for changes_mm in DEEPER_TIPS_mm:
        fields = {
            f"switch.{name}": round(getattr(design.switch, name) + change_mm, 3)
            for name, change_mm in changes_mm.items()
        }
        words = _words(design, fields)
        progress(f"trying {words}")
        with suppress(PhytacError):
            changed = with_fields(design, fields)
            seen = seen_at_rest(check_design(changed), seed=seed)
            if seen.clear.all():
                repair = Repair(words=words, fields=fields, design=changed)
                tried.append((int(seen.switch_unreadable.sum()), repair))
    for after, repair in sorted(tried, key=lambda item: item[0]):
        if after > 2 * before / 3:
            break
        with suppress(PhytacError):
            fits(repair.design)
            return repair, before, after
    return None


def _fitted(design: Design) -> Iterator[tuple[str, Fields]]:
    """The camera at the distance at which it sees its rim."""
    if design.camera.stand_off_mm != "fit":
        fields = {"camera.stand_off_mm": "fit"}
        yield _words(design, fields), fields


def _changes(
    sensor: Sensor, remedies: Mapping[str, Sequence[int]], *, by_bar: bool
) -> Iterator[tuple[str, Fields]]:
    """Changes of variables, then other cameras."""
    design = sensor.design
    variables = {one.name: one for one in variables_of(sensor)}
    for name, times in remedies.items():
        if name not in variables or (name == "light.bar_radius_mm" and not by_bar):
            continue
        variable = variables[name]
        for count in times:
            amount = count * variable.step
            yield variable.words(amount), variable.fields(amount)
    for fields in _other_cameras(design):
        yield _words(design, fields), fields


def _words(design: Design, fields: Fields) -> str:
    """Numbers and words that change, for a reader."""
    places = {name: name.split(".") for name in fields}
    now = {name: getattr(getattr(design, table), own) for name, (table, own) in places.items()}
    return ", ".join(
        f"{name} {now[name]:.5g} → {new:.5g}"
        if isinstance(new, int | float)
        else f"{name} {now[name]} → {new}"
        for name, new in fields.items()
        if isinstance(new, int | float | str)
    )


def _other_cameras(design: Design) -> Iterator[dict[str, Any]]:
    """Fields of cameras with more pixels on the same chip, then of a second camera."""
    camera = design.camera
    if camera.preset == "custom" and not camera.calibration:
        for times in MORE_PIXELS:
            yield {
                "camera.width_px": round(times * camera.width_px),
                "camera.height_px": round(times * camera.height_px),
                "camera.focal_px": times * camera.focal_px,
                "camera.pixel_um": camera.pixel_um / times,
                "camera.centre_offset_px": [times * offset for offset in camera.centre_offset_px],
            }
    if camera.ends != "both":
        yield {"camera.ends": "both"}


def _clear(design: Design, fields: Fields, seed: int) -> Design | None:
    """The changed design, if it keeps every rule and shows every marker."""
    try:
        changed = with_fields(design, fields)
        sensor = check_design(changed)
        fractions = sampled_fractions(sensor)
        if fractions.max(axis=0).min() < FRACTION_MIN:
            return None
        if outlined_gap_px(sensor, fractions.argmax(axis=0)) <= FUSED_PX:
            return None
        seen = seen_at_rest(sensor, seed=seed)
    except PhytacError:
        return None
    return changed if bool(seen.clear.all()) else None
