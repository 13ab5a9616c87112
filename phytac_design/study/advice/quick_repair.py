"""One change after which a design passes the check, in seconds: a start for ``advise``."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from phytac_decoder.vision.switch_detection import RED_RATIO_MIN
from phytac_design.design.field_of_view import fields_of_view_deg
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import stand_off_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.loaded_visibility import FUSED_PX
from phytac_design.optics.render_scene import BAR
from phytac_design.optics.visibility import (
    FRACTION_MIN,
    Visibility,
    best_of,
    check_visibility,
)
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
DEEPER_mm, NEARER, WIDER = 0.5, 0.7, 0.5
"""Tips rest and move this much farther; cameras stand at this multiple of their distance, or have
a lens of this multiple of their focal length, which stands nearer too."""
READABLE_SHARE = 0.9
"""With this share of readable switches no further change is tried."""
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


@dataclass(frozen=True, kw_only=True)
class ReadableRepair(Repair):
    """A change with which the camera may read more switches.

    Attributes
    ----------
    before, after : int
        Switches that the camera cannot read, without and with the change.
    reason : str
        Why it is no repair; "" if it is one.
    """

    before: int
    after: int
    reason: str


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


def readable_switches(
    design: Design,
    *,
    fits: Callable[[Design], None],
    seed: int = 0,
    seconds: float = 25.0,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ReadableRepair]:
    """Changes of tips and camera with which the camera reads more switches.

    A camera that looks straight into a hole sees a resting tip too, unless it rests deeper, or the
    camera stands nearer and so looks at most holes aslant. A coarse one sees too few pixels of red.

    Parameters
    ----------
    fits : callable
        Raises an error for a design whose switches cannot be made.
    seconds : float
        No change is tried after this time.

    Returns
    -------
    list of ReadableRepair
        All that were tried; those that help come first, with the fewest unreadable switches.

    Raises
    ------
    DesignError
        If the design breaks a rule.
    """
    start = time.monotonic()
    sensor = check_design(design)
    seen = seen_at_rest(sensor, seed=seed)
    blind = seen.switch_unreadable
    before = int(blind.sum())
    # Where red would be enough relative to that at rest, only pixels are missing.
    enough = seen.red_on_px > RED_RATIO_MIN * seen.red_rest_px
    coarse = int((enough & blind).sum()) > before / 2
    tried: list[ReadableRepair] = []
    for fields in _readable_fields(sensor, coarse=coarse):
        if time.monotonic() - start > seconds:
            break
        words = _words(design, fields)
        progress(f"trying {words}")
        after, reason, changed = before, "", design
        try:
            changed = with_fields(design, fields)
            if "camera.focal_px" in fields:
                words += f" ({fields_of_view_deg(changed.camera.lens())[0]:.0f}° across)"
            seen = seen_at_rest(check_design(changed), seed=seed)
            after = int(seen.switch_unreadable.sum())
            if not seen.clear.all():
                reason = f"{int((~seen.clear).sum())} markers are hidden or fused then"
            elif after > 2 * before / 3:
                reason = f"{after} of {before} unreadable switches remain so"
            else:
                fits(changed)
        except PhytacError as error:
            reason = str(error)
        tried.append(
            ReadableRepair(
                words=words,
                fields=fields,
                design=changed,
                before=before,
                after=after,
                reason=reason,
            )
        )
        if not reason and after <= (1.0 - READABLE_SHARE) * sensor.markers.count:
            break
    return sorted(tried, key=lambda one: (bool(one.reason), one.after))


def _readable_fields(sensor: Sensor, *, coarse: bool) -> Iterator[dict[str, Any]]:
    """Fields of deeper tips, a nearer camera, both, other lenses, cameras (finer if ``coarse``)."""
    design = sensor.design
    stand_off = stand_off_mm(design, sensor.surface, sensor.cameras[0])
    tips = {
        times: {
            f"switch.{name}": round(getattr(design.switch, name) + times * DEEPER_mm, 3)
            for name in ("tip_recess_mm", "stroke_mm")
        }
        for times in (0.6, 1.0)
    }
    nearer = {"camera.stand_off_mm": round(NEARER * stand_off, 1)}
    yield tips[1.0]
    yield nearer
    yield tips[1.0] | nearer
    camera, narrow_deg = design.camera, 80.0  # straight lenses of twice its width are sold
    custom = camera.preset == "custom" and not camera.calibration
    if custom and fields_of_view_deg(camera.lens())[0] <= narrow_deg:
        yield {"camera.focal_px": round(WIDER * camera.focal_px, 1)} | (
            {} if camera.stand_off_mm == "fit" else {"camera.stand_off_mm": "fit"}
        )
    for fields in _other_cameras(design):
        if coarse or "camera.ends" in fields:
            yield fields
    yield tips[0.6]
    yield {"switch.tip_recess_mm": tips[0.6]["switch.tip_recess_mm"]}


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
        if isinstance(new, int | float) and not isinstance(now[name], str)
        else f"{name} {_typed(now[name])} → {_typed(new)}"
        for name, new in fields.items()
        if isinstance(new, int | float | str)
    )


def _typed(value: Any) -> str:
    """Value as a user types it into a design file."""
    return f'"{value}"' if isinstance(value, str) else f"{value}"


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
