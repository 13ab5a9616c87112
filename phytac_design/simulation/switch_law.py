"""How the switches of a design turn on: by a snap at their threshold, or gradually.

A bowl snaps: its tip is in below the threshold and out above it. Tips of other families come out as
the force grows, and the camera counts each as out at a force of its own. Their switches are solved
once and then come from the cache.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from phytac_design.design.field_groups import values_of
from phytac_design.design.spec import Design
from phytac_design.engine.cache import solved_once
from phytac_design.layout.markers import Markers
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.mechanics.switch.cup_design import CupDesign
from phytac_design.mechanics.switch.family_choice import ChosenSwitch, choose_families
from phytac_design.mechanics.switch.family_report import chosen_dict
from phytac_design.mechanics.switch.family_spread import FamilyTolerance
from phytac_design.mechanics.switch.switch_inputs import families_of, rubbers_of, space_of
from phytac_design.optics.tip_travel import TipRed, tip_red
from phytac_shapes.arrays import BoolArray, FloatArray, IntArray
from phytac_shapes.errors import DesignError

Progress = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class SwitchLaw:
    """At which force each switch is on, and how far its tip is out; arrays run over n markers.

    Attributes
    ----------
    on_N : (n,) float
        Force on a footprint at which the camera counts the tip as out.
    curve : (n,) int
        Which of ``force_N`` each gradual switch follows; -1 for one that snaps.
    force_N, travel_mm : tuple of (k,) float
        Forces, and ways of the tip at them, from rest to the stop.
    stroke_mm : float
        Way of a tip that is fully out; NaN where all snap.
    spread : (n,) float
        Standard deviation of the logarithm of thresholds from switch to switch; NaN where bowls
        are not compared with other families.
    refused : str
        Why the chosen switches cannot be made, so that bowls are assumed; "" where they can.
    """

    on_N: FloatArray
    curve: IntArray
    force_N: tuple[FloatArray, ...]
    travel_mm: tuple[FloatArray, ...]
    stroke_mm: float
    spread: FloatArray
    refused: str = ""

    @property
    def threshold_sd(self) -> FloatArray | None:
        """What the decoder takes as the spread of each threshold, (n,); None for its default.

        It sees the force on a switch no better than ``seen_sd``.
        """
        # The decoder's 0.35, chosen on simulated contacts, less the 0.27 of a bowl's thresholds.
        seen_sd = 0.22
        if np.isnan(self.spread).any():
            return None
        return np.hypot(self.spread, seen_sd)

    @property
    def gradual(self) -> BoolArray:
        """Switches (n,) whose tips come out as the force grows."""
        return self.curve >= 0

    def out_share(self, carried_N: FloatArray, bits: BoolArray, on_N: FloatArray) -> FloatArray:
        """How far tips (..., n) are out, as shares of the stroke.

        Parameters
        ----------
        carried_N : (..., n) float
            Force on each footprint.
        bits : (..., n) bool
            Switches that are on: tips of those that snap are fully out.
        on_N : (n,) float
            Thresholds of these switches, whose curves are stiffer or softer in proportion.
        """
        out = np.asarray(bits, dtype=np.float64)
        nominal_N = carried_N * (self.on_N / on_N)
        for row, (force, travel) in enumerate(zip(self.force_N, self.travel_mm, strict=True)):
            own = self.curve == row
            out[..., own] = np.interp(nominal_N[..., own], force, travel) / self.stroke_mm
        return out


def switch_law(design: Design, markers: Markers, progress: Progress = lambda _: None) -> SwitchLaw:
    """Activation law of a design's switches.

    Where the chosen switches cannot be made, it is that of bowls, which a build with ``--force``
    assumes, and says why (``refused``).

    Parameters
    ----------
    markers : Markers
        The design's.
    """
    threshold, switch = thresholds_N(design, markers), design.switch
    on, curve = threshold.copy(), np.full(markers.count, -1)
    spread = np.full(markers.count, np.nan)
    forces: list[FloatArray] = []
    travels: list[FloatArray] = []
    compared = switch.family != "bowl" and design.has_switches
    found: dict[str, Any] = {"refused": "", "switches": []}
    if compared:
        found = _solved(design, progress)
    for made in found["switches"]:
        own = np.flatnonzero(threshold == made["threshold_N"])
        band = made["spread"]
        spread[own] = np.log(band["high_N"] / band["low_N"]) / (2.0 * 1.96)
        if made["family"] == "bowl":
            continue
        on[own], curve[own] = made["receptors_N"], len(forces)
        forces.append(np.array(made["curve"]["force_N"]))
        travels.append(np.array(made["curve"]["stroke_mm"]))
    return SwitchLaw(
        on_N=on,
        curve=curve,
        force_N=tuple(forces),
        travel_mm=tuple(travels),
        stroke_mm=switch.stroke_mm if forces else np.nan,
        spread=spread,
        refused=found["refused"],
    )


def chosen_switches(design: Design, progress: Progress = lambda _: None) -> list[dict[str, Any]]:
    """The switch of each threshold of a design that does not take bowls alone, as plain values.

    Besides what :func:`~phytac_design.mechanics.switch.family_report.chosen_dict` holds, each has
    ``receptors_N``, the force at which the camera counts each of its tips as out, and ``red``, the
    red that it shows over the force.

    Raises
    ------
    DesignError
        If none fits, with the reasons.
    """
    found = _solved(design, progress)
    if found["refused"]:
        raise DesignError("switch-infeasible", found["refused"])
    switches: list[dict[str, Any]] = found["switches"]
    return switches


def _solved(design: Design, progress: Progress) -> dict[str, Any]:
    """Switches of a design, or why there are none, from the cache if they are there."""

    def solve() -> dict[str, Any]:
        try:
            return {"refused": "", "switches": _choose(Sensor(design), progress)}
        except DesignError as error:
            return {"refused": str(error), "switches": []}

    return solved_once("switch_families", values_of(design, ("trips",)), solve)


def _choose(sensor: Sensor, progress: Progress) -> list[dict[str, Any]]:
    design, threshold = sensor.design, thresholds_N(sensor.design, sensor.markers)
    switch, red = design.switch, tip_red(sensor)
    known = np.unique(threshold)
    chosen = choose_families(
        known.tolist(),
        [red.travel_on_mm[threshold == force] for force in known],
        rubbers_of(design),
        families_of(design),
        space_of(design),
        FamilyTolerance(thickness_mm=switch.wall_tolerance_mm, modulus=switch.modulus_tolerance),
        progress=lambda text: progress(f"switch: {text}"),
    )
    return [
        chosen_dict(one) | _seen(one, red, np.flatnonzero(threshold == one.threshold_N))
        for one in chosen
    ]


def _seen(one: ChosenSwitch, red: TipRed, own: IntArray) -> dict[str, Any]:
    """Thresholds of the receptors ``own`` (m,), and the red of the median one over the force."""
    made, on = one.candidate.design, red.travel_on_mm[own]
    middle = int(own[np.argsort(np.nan_to_num(on, nan=np.inf))[np.isfinite(on).sum() // 2]])
    seen: dict[str, Any] = {
        "marker": middle,
        "threshold_px": float(red.threshold_px[middle]),
    }
    if not isinstance(made, CupDesign):
        snap = np.array([0.0, 1.0, 1.0, 1.5]) * one.threshold_N
        way = np.array([0.0, 0.0, 1.0, 1.0]) * red.travel_mm[-1]
        seen |= {"force_N": snap.tolist(), "red_px": red.red_at(middle, way).tolist()}
        return {"receptors_N": [one.threshold_N] * len(own), "red": seen}
    # Of a switch that cannot be read, nobody sees when it is on.
    travel = np.where(np.isfinite(on), on, made.travel_mm)
    way = np.linspace(0.0, made.stop_mm, 41)
    seen |= {
        "force_N": made.curve.force_at(way).round(6).tolist(),
        "red_px": red.red_at(middle, way).round(3).tolist(),
    }
    return {"receptors_N": made.curve.force_at(travel).tolist(), "red": seen}
