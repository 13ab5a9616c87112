"""The presets from measured fronts: a rule, not a guess.

``draft`` and ``standard`` are the cheapest joint settings, by the seconds of all designs together,
none of whose errors is beyond :data:`WANTED` on any design. ``fine`` errs least in force among
those that every design is built with in :data:`FINE_s`, then least in the rest.
"""

from collections.abc import Mapping, Sequence

from phytac_design.design.accuracy import Accuracy
from phytac_design.study.tradeoff.front import Measured, beaten_by
from phytac_design.study.tradeoff.joint import accuracy_of
from phytac_shapes.errors import NumericalError

WANTED: dict[str, dict[str, float]] = {
    "draft": {"force": 0.20, "visibility": 0.25, "volume": 0.01, "score": 0.50},
    "standard": {"force": 0.05, "visibility": 0.10, "volume": 0.001, "score": 0.15},
}
"""Errors that a preset may have. 20 % of force and a quarter of a gap (linear presses on thin
walls) show whether a sensor works; 5 % and a tenth of a gap are beside what prints scatter by; a
score of 50 contacts is sure to a seventh."""
CHECKED = ("standard", "fine")
"""Presets with every part held against the print rules."""
FINE_s = 600.0
"""Time of the finest preset."""
ORDER = ("force", "visibility", "score", "volume")
"""What ``fine`` errs least in first."""

Fronts = Mapping[str, Sequence[Measured]]


def derive(fronts: Fronts) -> dict[str, Accuracy]:
    """Presets by name, of the joint settings of some designs, each with the same settings.

    Raises
    ------
    NumericalError
        If no setting will do for a preset.
    """
    joint = _together(fronts)
    out = {}
    for name, wanted in WANTED.items():
        good = [
            each
            for each in joint
            if all(p.errors[q] <= most for p in each for q, most in wanted.items())
            and (name not in CHECKED or each[0].settings["print_tools"])
        ]
        if not good:
            raise NumericalError(f"no measured setting is good enough for {name}: {wanted}")
        out[name] = min(good, key=lambda each: sum(p.seconds for p in each))
    timely = [
        each
        for each in joint
        if each[0].settings["print_tools"] and max(p.seconds for p in each) <= FINE_s
    ]
    if not timely:
        raise NumericalError(f"no measured setting is built in {FINE_s:g} s")
    out["fine"] = min(
        timely,
        key=lambda each: (
            *(max(p.errors[q] for p in each) for q in ORDER),
            sum(p.seconds for p in each),
        ),
    )
    return {name: accuracy_of(each[0].settings) for name, each in out.items()}


def most_beaten(presets: Mapping[str, Accuracy], fronts: Fronts) -> dict[tuple[str, str], float]:
    """Share of its seconds that each preset is beaten by, by (preset, design)."""
    return {
        (name, design): beaten_by(point, points)
        for design, points in fronts.items()
        for name, preset in presets.items()
        for point in points
        if accuracy_of(point.settings) == preset
    }


def _together(fronts: Fronts) -> list[tuple[Measured, ...]]:
    """The same setting on every design."""
    lists = list(fronts.values())
    keyed = [{accuracy_of(p.settings): p for p in points} for points in lists]
    return [
        tuple(points[setting] for points in keyed)
        for setting in keyed[0]
        if all(setting in points for points in keyed)
    ]
