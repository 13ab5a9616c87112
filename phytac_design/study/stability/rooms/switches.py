"""Switches: closed forms of the solid of revolution, a published snap, scaling laws, refusals."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from phytac_design.mechanics.switch import cases as published
from phytac_design.mechanics.switch.bowl import Bowl
from phytac_design.mechanics.switch.curve import press_bowl, snap_of
from phytac_design.mechanics.switch.materials import Yeoh, bulk_of, neo_hookean
from phytac_design.study.stability.case import Case, Evidence, Expect, Room
from phytac_shapes.errors import NumericalError

PEAK, PEAK_AT, VALLEY, VALLEY_AT = 74.5, 0.0146, 37.4, 0.069
"""Clamped cap under a ring load (Mescall 1966): lb and in."""


def check_closed(values: Mapping[str, Any], found: Evidence) -> None:
    """A closed form of :mod:`switch.cases`."""
    make: dict[str, Callable[..., published.Found]] = {
        "thick sphere": published.thick_sphere,
        "inflated sphere": published.inflated_sphere,
        "clamped plate": published.clamped_plate,
        "squeezed ring": published.squeezed_ring,
    }
    result = make[values["make"]](**values["numbers"])
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
    # A maximum is flat: a load within 1 % of it is reached 10 % of the way off.
    found.add("Mescall: way at the peak", at_peak / PEAK_AT - 1.0, 0.12)
    found.add("Mescall: valley load", valley / VALLEY - 1.0, 0.03)
    found.add("Mescall: way at the valley", at_valley / VALLEY_AT - 1.0, 0.05)


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
    """What presses the pad arrives at the clamped rim; on the way nothing is left."""
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
        found.add("inner forces sum to none", float(inner.sum()) / top, slack, kind="balance")


def check_refused(values: Mapping[str, Any], found: Evidence) -> None:
    """A bowl that is none, or a rubber that is none."""
    bowl = Bowl(**values["bowl"])
    rubber = neo_hookean(
        modulus_MPa=values.get("modulus", 10.0), poisson=values.get("poisson", 0.49)
    )
    curve = press_bowl(bowl, rubber, steps=6, end_mm=values.get("end_mm"))
    if not np.isfinite(curve.force_N).all():
        raise NumericalError("forces are not finite")
    found.true("it is refused", False)


def cases() -> list[Case]:
    """Closed forms to their ends; bowls thin, thick, shallow, deep; what is no bowl."""
    out = []

    def add(name: str, check: str, expect: Expect = "right", **values: Any) -> None:
        out.append(Case(room="switches", name=name, check=check, expect=expect, values=values))

    for v in (0.0, 0.3, 0.49, 0.4999, 0.499999):
        # A rubber is taken to be compressible by a part in 50 000 at least.
        add(
            f"thick sphere, ν {v:g}",
            "closed",
            "either" if v > 0.49999 else "right",
            make="thick sphere",
            numbers={"poisson": v},
            reference="Lamé",
            tolerance=0.01,
        )
    for stretch in (1.001, 1.5, 3.0, 5.0):
        add(
            f"sphere blown up {stretch:g} times",
            "closed",
            make="inflated sphere",
            numbers={"stretch": stretch},
            reference="Green and Zerna, incompressible",
            tolerance=0.01,
        )
    for cells, v in ((8, 0.3), (20, 0.0), (20, 0.3), (20, 0.49)):
        add(
            f"clamped disc, {cells} elements, ν {v:g}",
            "closed",
            make="clamped plate",
            numbers={"cells": cells, "poisson": v},
            reference="Kirchhoff and Timoshenko",
            tolerance=0.02,
        )
    for mode in (2, 3, 5):
        add(
            f"ring squeezed into {mode} waves",
            "closed",
            make="squeezed ring",
            numbers={"mode": mode},
            reference="Singer and Babcock (1970)",
            tolerance=0.03,
        )
    for stretch in (0.3, 0.9, 1.0001, 2.0, 6.0):
        add(
            f"bar of ν 0.49999 stretched {stretch:g} times",
            "pulled",
            stretch=stretch,
            poisson=0.49999,
        )
    add("clamped cap, snapping", "cap", cells=[50, 1])
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
            add(
                f"bowl: {name}, E {modulus:g} MPa",
                "bowl",
                "either",
                bowl=bowl,
                modulus=modulus,
                end_mm=0.5 * bowl["depth_mm"],
            )
    add("bowl: nearly incompressible", "bowl", bowl=base, modulus=10.0, poisson=0.4999, end_mm=0.6)
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
        add(f"bowl: {name}", "refused", "refused", **values)
    return out


ROOM = Room(
    name="switches",
    about="hyperelastic solids of revolution, snaps, scaling laws",
    checks={
        "closed": check_closed,
        "pulled": check_pulled,
        "cap": check_cap,
        "bowl": check_bowl,
        "refused": check_refused,
    },
    cases=cases,
)
