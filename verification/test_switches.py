"""Switches: closed forms of the solid of revolution, a published snap, scaling laws, refusals."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.curve import press_bowl, snap_of
from phytac_design.mechanics.switch.hyperelastic import Yeoh, bulk_of, neo_hookean
from phytac_shapes.errors import NumericalError
from verification import switch_cases as published
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify

PEAK, PEAK_AT, VALLEY, VALLEY_AT = 74.5, 0.0146, 37.4, 0.069
"""Clamped cap under a ring load (Mescall 1966): lb and in."""


def check_closed(values: Mapping[str, Any], found: Evidence) -> None:
    """A closed form of :mod:`switch.cases`."""
    result = values["make"]()
    found.add(values["reference"], result.value / result.exact - 1.0, values["tolerance"])


def check_pulled(values: Mapping[str, Any], found: Evidence) -> None:
    """Nominal stress of a pulled neo-Hookean bar: μ(λ − 1/λ²) where it keeps its volume."""
    stretch, poisson = values["stretch"], values["poisson"]
    material = Yeoh(coefficients_MPa=(0.5,), bulk_MPa=bulk_of(1.0, poisson))
    stress = published.pulled_bar(material, stretch)
    exact = stretch - 1.0 / stretch**2
    found.add("μ(λ − 1/λ²), relative", stress / exact - 1.0, 0.005)


def check_cap(values: Mapping[str, Any], found: Evidence) -> None:
    """Peak and valley of the published clamped cap."""
    path = published.clamped_cap(cells=tuple(values["cells"]))
    (at_peak, peak), (at_valley, valley) = path.extremes()
    found.add("Mescall: peak load", peak / PEAK - 1.0, 0.02)
    # A maximum is flat: a load within 1 % of it is reached 10 % of the stroke off.
    found.add("Mescall: stroke at the peak", at_peak / PEAK_AT - 1.0, 0.12)
    found.add("Mescall: valley load", valley / VALLEY - 1.0, 0.03)
    found.add("Mescall: stroke at the valley", at_valley / VALLEY_AT - 1.0, 0.05)


def check_bowl(values: Mapping[str, Any], found: Evidence) -> None:
    """Forces arrive at the rim; curves go with E and with the square of the size."""
    bowl = Bowl(**values["bowl"])
    rubber = neo_hookean(modulus_MPa=values["modulus"], poisson=values.get("poisson", 0.49))
    curve = press_bowl(bowl, rubber, steps=18, end_mm=values.get("end_mm"))
    snap = snap_of(curve)
    found.true("every force is finite", np.isfinite(curve.force_N))
    found.true("pressed from rest", abs(curve.force_N[0]) < 1e-12 * np.abs(curve.force_N).max())
    _balance(curve, found)
    for name, size, stiff in (
        ("a thousandth as large", 1e-3, 1.0),
        ("as large as a house", 1e4, 1.0),
        ("a million times as stiff", 1.0, 1e6 / values["modulus"]),
    ):
        other = press_bowl(
            bowl.scaled(size),
            rubber.scaled(stiff),
            steps=18,
            hole_diameter_mm=1.6 * size,
            end_mm=size * (values.get("end_mm") or bowl.depth_mm),
        )
        same = np.interp(curve.stroke_mm, other.stroke_mm / size, other.force_N / (stiff * size**2))
        found.close(f"{name}: force by E·s²", same, curve.force_N, 1e-5, kind="units")
    if snap is not None:
        found.facts["limit_N"] = snap.limit_N
        found.true("the valley lies below the limit", snap.valley_N < snap.limit_N)


def _balance(curve: Any, found: Evidence) -> None:
    """The force on the pad arrives at the clamped rim; the body is in equilibrium."""
    model = curve.body.model
    top = float(np.abs(curve.force_N).max())
    for point, force in zip(curve.points, curve.force_N, strict=True):
        inner = point.state.reaction_N[:, 1]
        rim = float(inner[model.held[:, 1]].sum())
        slack = 1e-12 * point.state.gross_N / top + 1e-6
        found.add(
            "force on the rim = force on the pad, of the largest",
            (rim - force) / top,
            slack,
            kind="balance",
        )
        found.add("inner forces sum to zero", float(inner.sum()) / top, slack, kind="balance")


def check_rejected(values: Mapping[str, Any], found: Evidence) -> None:
    """A bowl that is none, or a rubber that is none."""
    bowl = Bowl(**values["bowl"])
    rubber = neo_hookean(
        modulus_MPa=values.get("modulus", 10.0), poisson=values.get("poisson", 0.49)
    )
    curve = press_bowl(bowl, rubber, steps=6, end_mm=values.get("end_mm"))
    if not np.isfinite(curve.force_N).all():
        raise NumericalError("forces-not-finite", "forces are not finite")
    found.true("it is rejected", False)


def cases() -> Cases:
    """Closed forms to their ends; bowls thin, thick, shallow, deep; what is no bowl."""
    out = Cases()

    def closed(name: str, make: Any, reference: str, tolerance: float, **numbers: Any) -> None:
        # A rubber is taken to be compressible by at least a part in 50 000.
        expect: Expect = "either" if numbers.get("poisson", 0.0) > 0.49999 else "right"
        numbers = {"make": partial(make, **numbers), "reference": reference}
        out.add(name, check_closed, expect, tolerance=tolerance, **numbers)

    for v in (0.0, 0.3, 0.49, 0.4999, 0.499999):
        closed(f"thick sphere, ν {v:g}", published.thick_sphere, "Lamé", 0.01, poisson=v)
    green = "Green and Zerna, incompressible"
    for stretch in (1.001, 1.5, 3.0, 5.0):
        name = f"sphere blown up {stretch:g} times"
        closed(name, published.inflated_sphere, green, 0.01, stretch=stretch)
    plate = "Kirchhoff and Timoshenko"
    for cells, v in ((8, 0.3), (20, 0.0), (20, 0.3), (20, 0.49)):
        name = f"clamped disc, {cells} elements, ν {v:g}"
        closed(name, published.clamped_plate, plate, 0.02, cells=cells, poisson=v)
    for mode in (2, 3, 5):
        name = f"ring squeezed into {mode} waves"
        closed(name, published.squeezed_ring, "Singer and Babcock (1970)", 0.03, mode=mode)
    for stretch in (0.3, 0.9, 1.0001, 2.0, 6.0):
        name = f"bar of ν 0.49999 stretched {stretch:g} times"
        out.add(name, check_pulled, stretch=stretch, poisson=0.49999)
    out.add("clamped cap, snapping", check_cap, cells=[50, 1])
    base = {"diameter_mm": 4.6, "depth_mm": 1.3, "thickness_mm": 0.25}
    bowls: dict[str, dict[str, Any]] = {
        "the usual": base,
        "a thin wall": base | {"thickness_mm": 0.12},
        "a thick wall": base | {"thickness_mm": 0.5},
        "shallow": base | {"depth_mm": 0.6, "thickness_mm": 0.15},
        "deep": base | {"depth_mm": 1.9, "thickness_mm": 0.2},
        "wide": base | {"diameter_mm": 9.0, "depth_mm": 2.0},
    }
    for name, bowl in bowls.items():
        for modulus in (10.0, 0.05):
            numbers = {"bowl": bowl, "modulus": modulus, "end_mm": 0.5 * bowl["depth_mm"]}
            out.add(f"bowl: {name}, E {modulus:g} MPa", check_bowl, "either", **numbers)
    numbers = {"bowl": base, "modulus": 10.0, "poisson": 0.4999, "end_mm": 0.6}
    out.add("bowl: nearly incompressible", check_bowl, **numbers)
    bad: dict[str, dict[str, Any]] = {
        "no wall": {"bowl": base | {"thickness_mm": 0.0}},
        "a wall not a number": {"bowl": base | {"thickness_mm": float("nan")}},
        "a wall as thick as it is deep": {"bowl": base | {"thickness_mm": 1.3}},
        "taller than half a sphere": {"bowl": base | {"depth_mm": 2.2}},
        "a pad as wide as itself": {"bowl": base | {"pad_diameter_mm": 4.5}},
        "a stem wider than its pad": {"bowl": base | {"stem_diameter_mm": 2.0}},
        "fillets larger than itself": {"bowl": base | {"fillet_mm": 5.0}},
        "rubber of no modulus": {"bowl": base, "modulus": 0.0},
        "rubber of ν 0.5": {"bowl": base, "poisson": 0.5},
        "rubber of ν not a number": {"bowl": base, "poisson": float("nan")},
        "rubber of a modulus not a number": {"bowl": base, "modulus": float("nan")},
    }
    for name, values in bad.items():
        out.add(f"bowl: {name}", check_rejected, "refused", **values)
    return out


CASES = cases()


@CASES.parametrize
def test_switches(case: Case, record_property: Recorder) -> None:
    """Hyperelastic solids of revolution, snaps, scaling laws."""
    verify(case, record_property)
