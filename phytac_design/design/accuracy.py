"""The accuracy presets: every setting that trades time for accuracy, in one place.

``draft`` and ``standard`` are the cheapest measured settings within fixed errors on three sensors,
``fine`` the most accurate one that is built in ten minutes; ``python -m benchmarks.tradeoff --parts
fronts,presets`` measures and checks that.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from difflib import get_close_matches
from typing import Any, Literal

from phytac_shapes.errors import DesignError

Preset = Literal["draft", "standard", "fine"]


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Settings of one preset.

    Attributes
    ----------
    cad_tolerance_mm : float
        Chordal tolerance of printed meshes.
    refine : int
        Elements of the decoder's mesh per marker pitch around the sensor.
    receptors : bool
        Whether the decoder's shell has the stiffness of receptor tubes and their holes.
    truth_refine : int
        The same for the finer of the simulated sensor's meshes, which are not those of the
        decoder. From 6 on its motion is extrapolated from two.
    sample_share : float
        Fraction of the design's training and test samples that is simulated; see ``frames``.
    frames : int
        Rendered frames that are decoded for the report, and a fifth of the largest number of
        held-out samples that are decoded from their points.
    place_share : float
        Spacing of the tabulated places of the estimator ``auto``, over the patches' mean radius.
    place_orders : int
        Powers of the force in its tables: 1 is linear theory, 2 and 3 Koiter's expansion, 4 and 5
        large displacements where that does not hold (:data:`.pressed_series.LARGE_SOLVED_ABOVE`).
    press_places : int
        Places at which the sensor is pressed to find markers that hide or fuse under load.
    press_tolerance : float
        Error of linear theory that is accepted there; 1 always accepts it.
    tools : bool
        Whether a build has all that a sensor is made with: molds, calibration kit, inserts and
        documents for the workshop, and print rules checked of every printed part; and the
        comparison with straight rows. Without, only the shell is checked, and these are made where
        a build names them.
    step : bool
        Whether STEP files are written, of the shell, the hardware and their assembly; STL and 3MF
        files always are.
    """

    cad_tolerance_mm: float
    refine: int
    receptors: bool
    truth_refine: int
    sample_share: float
    frames: int
    place_share: float
    place_orders: int
    press_places: int
    press_tolerance: float
    tools: bool
    step: bool

    def as_dict(self) -> dict[str, float]:
        """Plain values, for hashing and reports."""
        return asdict(self)


PRESETS: dict[str, Accuracy] = {
    "draft": Accuracy(
        cad_tolerance_mm=0.05,
        refine=3,
        receptors=True,
        truth_refine=5,
        sample_share=0.3,
        frames=5,
        place_share=0.8,
        place_orders=1,
        press_places=8,
        press_tolerance=1.0,
        tools=False,
        step=False,
    ),
    "standard": Accuracy(
        cad_tolerance_mm=0.02,
        refine=4,
        receptors=True,
        truth_refine=9,
        sample_share=1.0,
        frames=50,
        place_share=0.8,
        place_orders=4,
        press_places=40,
        press_tolerance=0.05,
        tools=True,
        step=True,
    ),
    "fine": Accuracy(
        cad_tolerance_mm=0.005,
        refine=6,
        receptors=True,
        truth_refine=13,
        sample_share=1.0,
        frames=100,
        place_share=0.4,
        place_orders=5,
        press_places=120,
        press_tolerance=0.02,
        tools=True,
        step=True,
    ),
}


RANGES: dict[str, tuple[float, float]] = {
    "cad_tolerance_mm": (1e-4, 1.0),
    "refine": (1, 24),
    "truth_refine": (1, 32),
    "sample_share": (0.0, 100.0),
    "frames": (1, 10_000),
    "place_share": (0.1, 2.0),
    "place_orders": (1, 5),
    "press_places": (0, 10_000),
    "press_tolerance": (1e-4, 1.0),
}
"""Minimum and maximum of each number that the stages can work with."""


def settings_of(accuracy: str | Accuracy) -> Accuracy:
    """Settings of a preset by its name; settings are returned unchanged.

    Raises
    ------
    DesignError
        If there is no such preset.
    """
    if isinstance(accuracy, Accuracy):
        return accuracy
    if accuracy not in PRESETS:
        known = ", ".join(PRESETS)
        raise DesignError(
            "accuracy-unknown", f"unknown accuracy {accuracy!r}; choose one of {known}"
        )
    return PRESETS[accuracy]


def preset_name(accuracy: Accuracy) -> str:
    """Name of the preset with these settings, or ``custom``."""
    return next((name for name, preset in PRESETS.items() if preset == accuracy), "custom")


def with_settings(accuracy: Accuracy, assignments: Sequence[str]) -> Accuracy:
    """Settings with some changed: ``with_settings(PRESETS["draft"], ["refine=5"])``.

    Raises
    ------
    DesignError
        If an assignment is not ``NAME=VALUE``, or its name or value is not valid.
    """
    for text in assignments:
        name, equals, value = (part.strip() for part in text.partition("="))
        kinds = {field.name: type(getattr(accuracy, field.name)) for field in fields(accuracy)}
        if name not in kinds or not equals:
            near = get_close_matches(name, kinds, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            known = ", ".join(kinds)
            raise DesignError(
                "setting-unknown",
                f"no setting {text!r}{hint}; write NAME=VALUE with one of {known}",
            )
        change: dict[str, Any] = {name: _value(name, value, kinds[name])}
        accuracy = replace(accuracy, **change)
    return accuracy


def _value(name: str, text: str, kind: type) -> float:
    """Parse a value and check its range."""
    truth = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
    try:
        value = truth[text.lower()] if kind is bool else kind(text)
    except (KeyError, ValueError):
        raise DesignError(
            "setting-invalid", f"{name} cannot be {text!r}; it is {kind.__name__}"
        ) from None
    low, high = RANGES.get(name, (0.0, 1.0))
    if not low <= value <= high:
        raise DesignError(
            "setting-invalid", f"{name} cannot be {text}; it lies from {low:g} to {high:g}"
        )
    return value
