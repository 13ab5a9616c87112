"""Checks of every mold that is written, and the volumes of its materials."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phytac_design.fabrication.molds.closed_mold import (
    Fit,
    cap_gap_mm,
    cavities_of,
    fit_of,
    halves_of,
    key_gap_mm,
    shared_mm3,
)
from phytac_design.fabrication.molds.make import MoldSet
from phytac_design.fabrication.molds.plate_grid import SwitchKind
from phytac_design.fabrication.molds.plates import dome_away_mm, dome_edge_mm
from phytac_design.fabrication.molds.release import Bottom, Release, check_release
from phytac_design.fabrication.switch_set import SwitchSet, revolved_volume_mm3
from phytac_design.solids.solid_mesh import to_manifold
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import NumericalError

SHARED_mm3 = 1e-6
"""Largest volume that two plates may share: rounding."""
FINE_mm = 3e-4
"""Tolerance of the section that cavities are compared with."""


@dataclass(frozen=True, kw_only=True)
class Audit:
    """Measurements of a mold set.

    Attributes
    ----------
    releases : dict
        Rays and slopes of each part.
    shared_mm3 : float
        Largest volume that two closed parts share.
    key_gap_mm, cap_gap_mm : float or None
        Least gap of keys in sockets, of the cap's bosses in their troughs (rigid).
    fits : dict
        Cavity of each kind against its switch.
    dome_half_mm3, core_half_mm3 : float
        Volumes of the two solids around the rubber.
    """

    releases: dict[str, Release]
    shared_mm3: float
    key_gap_mm: float
    cap_gap_mm: float | None
    fits: dict[SwitchKind, Fit]
    dome_half_mm3: float
    core_half_mm3: float

    @property
    def draft_deg(self) -> float:
        """Least slope of any face of any part."""
        return min(release.draft_deg for release in self.releases.values())

    @property
    def caught(self) -> int:
        """Rays along the pull that met a part more than twice."""
        return sum(release.caught for release in self.releases.values())

    @property
    def volume_error(self) -> float:
        """Worst relative error of a cavity's volume."""
        return max(abs(fit.volume_error) for fit in self.fits.values())

    @property
    def hausdorff_mm(self) -> float:
        """Worst distance between a cavity and its switch."""
        return max(fit.hausdorff_mm for fit in self.fits.values())


def fine_sections(switches: SwitchSet) -> dict[SwitchKind, FloatArray]:
    """Sections of all kinds of switches, as accurate as the comparison with cavities needs."""
    return {kind: switches.profile(kind, FINE_mm) for kind in switches.kinds}


def releases_of(made: MoldSet) -> dict[str, Release]:
    """Rays and slopes of each part; stem holes of a core plate end at their troughs."""
    sizes, half = made.sizes, 0.5 * made.sizes.pitch_mm
    bottoms = []
    for run in made.plan.runs:
        centre = made.plan.centre_mm(run.cells, sizes.pitch_mm)
        ends = {"low_mm": centre[0] - half, "high_mm": centre[-1] + half}
        bottoms.append(Bottom(**ends, z_mm=-sizes.cavities[run.kind].reach_mm))
    return {
        name: check_release(mesh, bottoms=bottoms if name == "core_plate" else ())
        for name, mesh in made.parts.items()
    }


def audit_set(made: MoldSet, fine: Mapping[SwitchKind, FloatArray]) -> Audit:
    """Measure one set; ``fine`` are the switches' sections.

    Raises
    ------
    NumericalError
        If a part is not closed.
    """
    plan, sizes = made.plan, made.sizes
    halves = halves_of(made.parts, sizes)
    shared = [shared_mm3(*halves)]
    gap = None
    if "cap_plate" in made.parts:
        cap = to_manifold(made.parts["cap_plate"])
        shared += [shared_mm3(halves[1], cap)]
        gap = cap_gap_mm(plan, sizes, halves[1], cap)
    cavities = cavities_of(plan, sizes, halves)
    return Audit(
        releases=releases_of(made),
        shared_mm3=float(np.abs(shared).max()),
        key_gap_mm=key_gap_mm(plan, sizes, halves),
        cap_gap_mm=gap,
        fits={
            kind: fit_of(
                cavity,
                fine[kind],
                sizes.section.shrink_rubber,
                sizes.sides,
            )
            for kind, cavity in cavities.items()
        },
        dome_half_mm3=float(halves[0].volume()),
        core_half_mm3=float(halves[1].volume()),
    )


def check_mold(made: MoldSet, audit: Audit) -> None:
    """Reject a mold that would not work.

    Raises
    ------
    NumericalError
        If parts do not release, do not close, or hold the wrong shape.
    """
    volume_tol = 0.005  # largest relative error of a cavity's volume
    required = made.sizes.section.draft_deg
    for name, release in audit.releases.items():
        if release.caught:
            x, y = release.places_mm[0]
            raise NumericalError(
                f"mold: {name} does not release: {release.caught} rays along the pull are caught, "
                f"the first at x {x:.2f}, y {y:.2f} mm; please report this design"
            )
        if release.draft_deg < required - 1e-3:
            raise NumericalError(
                f"mold: {name} has a face of {release.draft_deg:.3f} degrees against the pull, "
                f"below the required {required:g}; lower [mold] draft_deg"
            )
    if audit.shared_mm3 > SHARED_mm3 or audit.volume_error > volume_tol:
        raise NumericalError(
            f"mold: its parts share {audit.shared_mm3:.3g} mm³ and its cavities are "
            f"{audit.volume_error:.2%} off their switches; please report this design"
        )


def volumes_mm3(
    made: MoldSet, audit: Audit, fine: Mapping[SwitchKind, FloatArray]
) -> dict[str, float]:
    """Rubber and silicone of one casting, as they are poured.

    ``switches`` is what stays in the cavities, ``rubber`` all that is poured: the dome half filled
    to the parting plane, and what stems and vents hold beyond what the cores displace.
    """
    plan, sizes = made.plan, made.sizes
    section, scale = sizes.section, 1.0 / (1.0 - sizes.section.shrink_rubber)
    cavities = stems = cores = 0.0
    for run in plan.runs:
        cavity = sizes.cavities[run.kind]
        whole = scale**3 * revolved_volume_mm3(fine[run.kind])
        over = np.array([[0.0, cavity.over[-1, 1]], *cavity.over[::-1], [0.0, 0.0]])
        stem = _stem_mm3(made, run.kind)
        cavities += run.count * whole
        stems += run.count * (stem + _vent_mm3(made, run.kind))
        cores += run.count * (revolved_volume_mm3(over) + stem - whole)
    edge, moat = dome_away_mm(sizes), section.wall_mm + section.moat_mm
    flank = float(np.tan(np.radians(sizes.flank_deg)))
    foot = moat + (section.overflow_mm + section.fence_mm) * flank
    outside = _prism_mm3(made, (edge, dome_edge_mm(sizes)), sizes.top_mm + section.fence_mm)
    opening = _prism_mm3(made, (foot, moat + section.overflow_mm * flank), section.fence_mm)
    filled = outside - opening - audit.dome_half_mm3
    found = {"switches": cavities, "rubber": filled + max(0.0, stems - cores)}
    if section.way == "silicone-master":
        grown = 1.0 / (1.0 - section.shrink_silicone) ** 3
        found["silicone_dome"] = grown * audit.dome_half_mm3
        found["silicone_core"] = grown * audit.core_half_mm3
    return found


def _stem_mm3(made: MoldSet, kind: SwitchKind) -> float:
    """Stem below the parting plane."""
    under = made.sizes.cavities[kind].under
    (r1, z1), (r2, z2) = under[-2], under[-1]
    r0 = r2 + (r1 - r2) * (0.0 - z2) / (z1 - z2)
    return float(np.pi / 3.0 * -z2 * (r0**2 + r0 * r2 + r2**2))


def _vent_mm3(made: MoldSet, kind: SwitchKind) -> float:
    """Rubber in a stem's vent, or its share of the film under the cap."""
    sizes = made.sizes
    cavity = sizes.cavities[kind]
    if sizes.section.way == "rigid":
        wide = 2.0 * sizes.trough_mm(cavity, -cavity.reach_mm)
        return wide * sizes.section.vent_gap_mm * sizes.pitch_mm
    (r0, z0), (r1, z1) = sizes.vent(cavity, sizes.depth_mm)
    return float(np.pi / 3.0 * (z0 - z1) * (r0**2 + r0 * r1 + r1**2))


def _prism_mm3(made: MoldSet, away_mm: tuple[float, float], height_mm: float) -> float:
    """Volume between two rectangles around the grid, by Simpson's rule, exact here."""
    plan, pitch = made.plan, made.sizes.pitch_mm
    ends = (away_mm[0], 0.5 * sum(away_mm), away_mm[1])
    areas = [(plan.columns * pitch + 2 * a) * (plan.lines * pitch + 2 * a) for a in ends]
    return height_mm * (areas[0] + 4.0 * areas[1] + areas[2]) / 6.0


def audit_facts(made: MoldSet, audit: Audit) -> dict[str, Any]:
    """Plain figures of one set's audit."""
    plan, sizes = made.plan, made.sizes
    cavities: dict[str, int] = {}
    for run in plan.runs:
        label = sizes.labels[run.kind]
        cavities[label] = cavities.get(label, 0) + run.count
    plates = {}
    for name in made.parts:
        mesh = made.printed(name)
        plates[name] = {
            "triangles": len(mesh.triangles),
            "size_mm": np.ptp(mesh.vertices_mm, axis=0).round(3).tolist(),
            "volume_mm3": mesh.volume_mm3,
            "rays": audit.releases[name].rays,
            "undercut_rays": audit.releases[name].caught,
            "least_draft_deg": audit.releases[name].draft_deg,
        }
    return {
        "set": plan.number,
        "columns": plan.columns,
        "lines": plan.lines,
        "cavities": plan.cavities,
        "labels": cavities,
        "plates": plates,
        "shared_mm3": audit.shared_mm3,
        "key_gap_mm": audit.key_gap_mm,
        "cap_gap_mm": audit.cap_gap_mm,
        "fits": {sizes.labels[kind]: asdict(fit) for kind, fit in audit.fits.items()},
        "volume_error": audit.volume_error,
        "hausdorff_mm": audit.hausdorff_mm,
    }
