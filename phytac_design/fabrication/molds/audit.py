"""Checks of every mold that is written, and the volumes of its materials.

Independent of how the plates were built: a half of silicone is a block minus its tray, a cavity is
a column minus both halves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from phytac_design.fabrication.molds.cavity import Cavity, MoldSizes
from phytac_design.fabrication.molds.make import MoldSet
from phytac_design.fabrication.molds.plate_grid import PlateLayout, SwitchKind
from phytac_design.fabrication.molds.plates import Cells
from phytac_design.fabrication.switch_set import SwitchSet, revolved_volume_mm3
from phytac_design.fabrication.switch_strips import strip_label
from phytac_design.geometry.triangles import TriangleMesh, prisms
from phytac_design.solids.solid_mesh import box, to_manifold, to_triangles, united
from phytac_shapes.arrays import BoolArray, FloatArray
from phytac_shapes.errors import NumericalError


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A cavity against the switch that it is made for, the rubber's shrinkage undone.

    Attributes
    ----------
    volume_mm3 : float
        Volume of the shrunk rubber.
    volume_error : float
        Relative to the switch's.
    hausdorff_mm : float
        Largest distance between both sections, either way.
    """

    volume_mm3: float
    volume_error: float
    hausdorff_mm: float


@dataclass(frozen=True, kw_only=True)
class StripFit:
    """A strip's cavity against the strip, the rubber's shrinkage undone.

    Attributes
    ----------
    bodies : int
        Separate pieces that come out of it: one.
    volume_error : float
        Of them all, relative to the strip's volume in closed form.
    """

    bodies: int
    volume_error: float


@dataclass(frozen=True, kw_only=True)
class Release:
    """Whether a part leaves along the pull.

    Attributes
    ----------
    undercut_mm2 : float
        Projected area of faces that lie behind others along the pull.
    draft_deg : float
        Least slope of any face against the pull.
    """

    undercut_mm2: float
    draft_deg: float


@dataclass(frozen=True, kw_only=True)
class Audit:
    """Measurements of a mold set.

    Attributes
    ----------
    halves : tuple of manifold3d.Manifold
        The two solids that close around the rubber: dome side and core side.
    releases : dict
        Undercuts and slopes of each part.
    shared_mm3 : float
        Largest volume that two closed parts share.
    key_gap_mm, cap_gap_mm : float or None
        Least gap of keys in sockets, of the cap's bosses in their troughs (rigid).
    fits : dict
        Cavity of each kind against its switch.
    strips : dict
        Cavity of each different strip against the strip.
    """

    halves: tuple[Any, Any]
    releases: dict[str, Release]
    shared_mm3: float
    key_gap_mm: float
    cap_gap_mm: float | None
    fits: dict[SwitchKind, Fit]
    strips: dict[int, StripFit]

    @property
    def draft_deg(self) -> float:
        """Least slope of any face of any part."""
        return min(release.draft_deg for release in self.releases.values())

    @property
    def undercut_mm2(self) -> float:
        """Undercut of all parts."""
        return sum(release.undercut_mm2 for release in self.releases.values())

    @property
    def volume_error(self) -> float:
        """Worst relative error of a cavity's volume."""
        errors = [fit.volume_error for fit in self.fits.values()]
        errors += [fit.volume_error for fit in self.strips.values()]
        return max(map(abs, errors))

    @property
    def hausdorff_mm(self) -> float:
        """Worst distance between a cavity and its switch."""
        return max(fit.hausdorff_mm for fit in self.fits.values())


def fine_sections(switches: SwitchSet) -> dict[SwitchKind, FloatArray]:
    """Sections of all kinds of switches, as accurate as the comparison with cavities needs."""
    fine_mm = 3e-4
    return {kind: switches.profile(kind, fine_mm) for kind in switches.kinds}


def audit_set(made: MoldSet, fine: Mapping[SwitchKind, FloatArray]) -> Audit:
    """Measure one set; ``fine`` are the switches' sections.

    Raises
    ------
    NumericalError
        If a part is not closed.
    """
    plan, sizes = made.plan, made.sizes
    halves = halves_of(made)
    shared, gap = [shared_mm3(*halves)], None
    if "cap_plate" in made.parts:
        cap = made.solids["cap_plate"]
        shared.append(shared_mm3(halves[1], cap))
        cells = [run.cells[0] for run in plan.runs]
        gap = least_gap_mm(made, cells, (-sizes.depth_mm, 0.0), (halves[1], cap))
    low, high = 0.1 * sizes.key_height_mm, sizes.key_height_mm + sizes.section.key_clearance_mm
    return Audit(
        halves=halves,
        releases=releases_of(made),
        shared_mm3=float(np.abs(shared).max()),
        key_gap_mm=least_gap_mm(made, plan.keys, (low, high), halves),
        cap_gap_mm=gap,
        fits={
            kind: fit_of(cavity, fine[kind], sizes.section.shrink_rubber)
            for kind, cavity in cavities_of(plan, sizes, halves).items()
        },
        strips=strip_fits(plan, sizes, halves, fine),
    )


def halves_of(made: MoldSet) -> tuple[Any, Any]:
    """The two solids that close around the rubber: plates, or silicone cast up to the lips."""
    sizes, section = made.sizes, made.sizes.section
    if section.way == "rigid":
        return made.solids["dome_plate"], made.solids["core_plate"]

    def cast(name: str, low_mm: float, high_mm: float) -> Any:
        # Half the frame's wall: the block's sides lie inside it at every height.
        x, y = np.abs(made.parts[name].vertices_mm[:, :2]).max(axis=0) - 0.5 * section.wall_mm
        return box(np.array([-x, -y, low_mm]), np.array([x, y, high_mm])) - made.solids[name]

    half = 0.5 * section.backing_mm
    return (
        cast("dome_tray", -section.fence_mm - half, sizes.top_mm),
        cast("core_tray", -sizes.depth_mm, sizes.core_mm + half),
    )


def shared_mm3(first: Any, second: Any) -> float:
    """Volume that two solids share."""
    return float((first ^ second).volume())


def releases_of(made: MoldSet) -> dict[str, Release]:
    """Undercuts and slopes of each part; stem holes of a core plate end at their troughs."""
    out = {name: check_release(mesh, made.solids[name]) for name, mesh in made.parts.items()}
    if "core_plate" in made.parts:
        # A hole that widens downwards lets every ray pass, but not what was cast in it.
        sizes = made.sizes
        half = 0.5 * (sizes.spacing_mm or sizes.pitch_mm)
        corners = made.parts["core_plate"].corners_mm
        area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
        middle, top = corners[:, :, :2].mean(axis=1), corners[:, :, 2].max(axis=1)
        caught: BoolArray = np.zeros(len(corners), dtype=np.bool_)
        for run in made.plan.runs:
            centre = made.plan.centre_mm(run.cells, sizes.pitch_mm)
            deep = top > -sizes.cavities[run.kind].reach_mm + 1e-6
            for low, high in zip(centre, centre, strict=True) if run.places else [centre[[0, -1]]]:
                inside = (middle >= low - half).all(axis=1) & (middle <= high + half).all(axis=1)
                caught |= inside & deep
        more = float(-area[caught & (area < 0.0)].sum())
        plain = out["core_plate"]
        out["core_plate"] = Release(
            undercut_mm2=plain.undercut_mm2 + more, draft_deg=plain.draft_deg
        )
    return out


def check_release(mesh: TriangleMesh, solid: Any = None) -> Release:
    """Undercut of a closed part against a pull along z, and its steepest face.

    A part that releases both ways is met once from above: its faces that look up cover its outline
    once. What they cover more is undercut. ``solid`` is the part, where it is known already.
    """
    from manifold3d import CrossSection, FillRule

    area_mm2 = 1e-8  # smaller triangles have no direction to speak of
    corners = mesh.corners_mm
    normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size, level = np.linalg.norm(normal, axis=1), normal[:, 2]
    outline = (solid or to_manifold(mesh)).project().to_polygons()
    covered = float(CrossSection(outline, FillRule.Positive).area())
    real = size > area_mm2
    return Release(
        undercut_mm2=max(0.0, float(level[level > 0.0].sum()) - covered),
        draft_deg=float(np.degrees(np.arcsin((np.abs(level[real]) / size[real]).min()))),
    )


def cavities_of(
    plan: PlateLayout, sizes: MoldSizes, halves: tuple[Any, Any]
) -> dict[SwitchKind, TriangleMesh]:
    """Cavity of the first switch of each kind, its axis at the origin."""
    # Plates are pressed together by this, so that no film is left where they touch but for
    # rounding: files are in single precision.
    pressed_mm = 1e-5
    cells = {run.kind: run.cells[0] for run in reversed(plan.runs)}
    centre = plan.centre_mm(list(cells.values()), sizes.pitch_mm)
    low = [2.0 * pressed_mm - sizes.cavities[kind].reach_mm for kind in cells]
    start = np.column_stack([centre, low])
    end = np.column_stack([centre, np.full(len(centre), sizes.dome_mm + 0.1)])
    columns = prisms(start, end, sizes.rim_mm + 0.5 * sizes.section.land_mm, 48)
    rest = _left_of(to_manifold(columns), halves, pressed_mm)
    if plan.strips:
        rest -= _web_around(plan, sizes)
    bodies = [to_triangles(body) for body in rest.decompose()]
    middle = np.array(
        [
            0.5 * (b.vertices_mm[:, :2].min(axis=0) + b.vertices_mm[:, :2].max(axis=0))
            for b in bodies
        ]
    )
    found = {}
    for kind, at in zip(cells, centre, strict=True):
        near = np.flatnonzero(np.linalg.norm(middle - at, axis=1) < 0.5 * sizes.pitch_mm)
        body = max((bodies[k] for k in near), key=lambda mesh: mesh.volume_mm3)
        found[kind] = body.moved(-np.array([*at, 0.0]))
    return found


def _left_of(region: Any, halves: tuple[Any, Any], pressed_mm: float) -> Any:
    """What two halves leave of a region, the core's raised by ``pressed_mm``."""
    rest = region - halves[0]
    # Evaluated here: in one expression manifold3d first unites the halves, at six times the cost.
    rest.status()
    return rest - halves[1].translate((0.0, 0.0, pressed_mm))


def _web_around(plan: PlateLayout, sizes: MoldSizes) -> Any:
    """Webs of all strips outside their bowls, a little large: what they add to the switches."""
    more_mm = 0.02
    (thick, half), cells = sizes.web_mm, Cells(plan, sizes)
    bars = united(cells.webs((-more_mm, thick + more_mm), (half + more_mm, half + more_mm)))
    for run in plan.runs:
        over = sizes.cavities[run.kind].over
        ends = [(over[0, 0], -2.0 * more_mm), (0, -2.0 * more_mm)]
        bars -= cells.turned(run.cells, [(0, over[-1, 1]), *over[::-1], *ends], sizes.sides)
    return bars


def strip_fits(
    plan: PlateLayout,
    sizes: MoldSizes,
    halves: tuple[Any, Any],
    fine: Mapping[SwitchKind, FloatArray],
) -> dict[int, StripFit]:
    """Cavity of the first strip of each number, against volumes of its switches and its web."""
    if sizes.strips is None:
        return {}
    pressed_mm, speck_mm3 = 1e-5, 1e-3
    kinds = {cell: run.kind for run in plan.runs for cell in run.cells}
    first = {strip.number: strip for strip in reversed(plan.strips)}
    own = replace(plan, strips=tuple(first.values()))
    cells = [cell for strip in own.strips for cell in strip.cells]
    number = np.array([strip.number for strip in own.strips for _ in strip.cells])
    at = plan.centre_mm(cells, sizes.pitch_mm)
    low = [2.0 * pressed_mm - sizes.cavities[kinds[cell]].reach_mm for cell in cells]
    start = np.column_stack([at, low])
    end = np.column_stack([at, np.full(len(at), sizes.dome_mm + 0.1)])
    land, (_, half) = 0.5 * sizes.section.land_mm, sizes.web_mm
    # Columns and bars overlap along a strip: each is a solid of its own.
    region = Cells(own, sizes).webs((-0.1, sizes.dome_mm + 0.1), (half + land, half + land))
    region += [
        to_manifold(prisms(start[k : k + 1], end[k : k + 1], sizes.rim_mm + land, 48))
        for k in range(len(at))
    ]
    rest = _left_of(united(region), halves, pressed_mm)
    volumes: dict[int, list[float]] = {each: [] for each in first}
    for body in rest.decompose():
        if body.volume() > speck_mm3:
            place = to_triangles(body).vertices_mm[0, :2]
            nearest = int(np.linalg.norm(at - place, axis=1).argmin())
            volumes[int(number[nearest])].append(float(body.volume()))
    out = {}
    for each, strip in first.items():
        wanted = sum(revolved_volume_mm3(fine[kinds[cell]]) for cell in strip.cells)
        wanted += sizes.strips.web_of_mm3(each)
        found = sum(volumes[each]) / sizes.rubber_scale**3
        out[each] = StripFit(bodies=len(volumes[each]), volume_error=found / wanted - 1.0)
    return out


def fit_of(cavity: TriangleMesh, profile: FloatArray, shrink: float) -> Fit:
    """Compare the shrunk content of a cavity with a switch's fine section (k, 2)."""
    scale = 1.0 - shrink
    volume = scale**3 * cavity.volume_mm3
    turned = cavity.vertices_mm[:, [0, 2, 1]] * [scale, scale, -scale]
    solid = to_manifold(TriangleMesh(vertices_mm=turned, triangles=cavity.triangles))
    start, end = [], []
    for polygon in solid.slice(0.0).to_polygons():
        line = np.column_stack([np.abs(polygon[:, 0]), polygon[:, 1]])
        start.append(line)
        end.append(np.roll(line, -1, axis=0))
    first, last = np.concatenate(start), np.concatenate(end)
    away = max(
        _distance(first, profile[:-1], profile[1:]).max(),
        _distance(0.5 * (first + last), profile[:-1], profile[1:]).max(),
        _distance(profile[1:-1], first, last).max(),
    )
    return Fit(
        volume_mm3=volume,
        volume_error=volume / revolved_volume_mm3(profile) - 1.0,
        hausdorff_mm=float(away),
    )


def least_gap_mm(
    made: MoldSet,
    cells: Sequence[tuple[float, float]],
    span_mm: tuple[float, float],
    pair: tuple[Any, Any],
) -> float:
    """Least distance of two solids in columns over cells, between two heights."""
    centres = made.plan.centre_mm(cells, made.sizes.pitch_mm)
    low, high = (np.column_stack([centres, np.full(len(centres), z)]) for z in span_mm)
    columns = to_manifold(prisms(low, high, 0.48 * made.sizes.pitch_mm, 48))
    first, second = (columns ^ solid for solid in pair)
    return float(first.min_gap(second, 2.0 * made.sizes.section.key_mm))


def _distance(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance of each point (n, 2) from the nearest of the segments (m, 2)."""
    way = end - start
    long = np.maximum(np.einsum("mi,mi->m", way, way), 1e-300)
    best = np.full(len(points), np.inf)
    for first in range(0, len(points), 1000):
        off = points[first : first + 1000, None] - start
        share = np.clip(np.einsum("nmi,mi->nm", off, way) / long, 0.0, 1.0)
        gap = np.linalg.norm(off - share[..., None] * way, axis=2)
        best[first : first + 1000] = gap.min(axis=1)
    return best


def check_mold(
    made: MoldSet,
    audit: Audit,
    *,
    undercut_mm2: float = 1e-2,
    shared_mm3: float = 1e-6,
    volume_tol: float = 0.005,
) -> None:
    """Reject a mold that would not work.

    Undercut and shared volume above rounding, or a larger relative error of a cavity's volume.

    Raises
    ------
    NumericalError
        If parts do not release, do not close, or hold the wrong shape.
    """
    required = made.sizes.section.draft_deg
    for name, release in audit.releases.items():
        if release.undercut_mm2 > undercut_mm2:
            raise NumericalError(
                "mold-does-not-release",
                f"mold: {name} does not release: {release.undercut_mm2:.2g} mm² of it lie behind "
                "other faces along the pull; please report this design",
            )
        if release.draft_deg < required - 1e-3:
            raise NumericalError(
                "mold-draft-too-small",
                f"mold: {name} has a face of {release.draft_deg:.3f} degrees against the pull, "
                f"below the required {required:g}; lower [mold] draft_deg",
            )
    for number, fit in audit.strips.items():
        if fit.bodies != 1:
            raise NumericalError(
                "mold-strip-in-pieces",
                f"mold: the cavity of strip {strip_label(number)} holds {fit.bodies} separate "
                "pieces; please report this design",
            )
    if audit.shared_mm3 > shared_mm3 or audit.volume_error > volume_tol:
        raise NumericalError(
            "mold-volume-mismatch",
            f"mold: its parts share {audit.shared_mm3:.3g} mm³ and its cavities are "
            f"{audit.volume_error:.2%} off their switches; please report this design",
        )


def volumes_mm3(
    made: MoldSet, audit: Audit, fine: Mapping[SwitchKind, FloatArray]
) -> dict[str, float]:
    """Rubber and silicone of one casting, as they are poured.

    ``switches`` is what stays in the cavities, ``rubber`` all that is poured: the dome half filled
    to the parting plane, and what stems and vents hold beyond what the cores displace.
    """
    sizes, section = made.sizes, made.sizes.section
    scale = 1.0 / (1.0 - section.shrink_rubber)
    cavities = stems = 0.0
    for run in made.plan.runs:
        cavity = sizes.cavities[run.kind]
        whole = scale**3 * revolved_volume_mm3(fine[run.kind])
        over = np.array([[0.0, cavity.over[-1, 1]], *cavity.over[::-1], [0.0, 0.0]])
        cavities += run.count * whole
        stems += run.count * (whole - revolved_volume_mm3(over) + vent_mm3(sizes, cavity))
    dome, core = audit.halves
    above = dome.trim_by_plane((0.0, 0.0, 1.0), 0.0)
    filled = float(above.hull().volume() - above.volume())
    if sizes.strips is not None:
        cavities += scale**3 * sum(sizes.strips.web_of_mm3(one.number) for one in made.plan.strips)
    found = {"switches": cavities, "rubber": filled + max(0.0, stems)}
    if section.way == "silicone-master":
        grown = 1.0 / (1.0 - section.shrink_silicone) ** 3
        found["silicone_dome"] = grown * float(dome.volume())
        found["silicone_core"] = grown * float(core.volume())
    return found


def vent_mm3(sizes: MoldSizes, cavity: Cavity) -> float:
    """Rubber in a stem's vent, or its share of the film under the cap."""
    if sizes.section.way == "rigid":
        wide = 2.0 * sizes.trough_mm(cavity, -cavity.reach_mm)
        return wide * sizes.section.vent_gap_mm * sizes.pitch_mm
    (r0, z0), (r1, z1) = sizes.vent(cavity, sizes.depth_mm)
    return float(np.pi / 3.0 * (z0 - z1) * (r0**2 + r0 * r1 + r1**2))


def audit_facts(made: MoldSet, audit: Audit) -> dict[str, Any]:
    """Plain figures of one set's audit."""
    plan, sizes = made.plan, made.sizes
    cavities: dict[str, int] = {}
    for run in plan.runs:
        label = sizes.labels[run.kind]
        cavities[label] = cavities.get(label, 0) + run.count
    strips: dict[str, int] = {}
    for strip in plan.strips:
        label = strip_label(strip.number)
        strips[label] = strips.get(label, 0) + 1
    plates = {}
    for name, mesh in made.printed.items():
        plates[name] = {
            "triangles": len(mesh.triangles),
            "size_mm": np.ptp(mesh.vertices_mm, axis=0).round(3).tolist(),
            "volume_mm3": mesh.volume_mm3,
            "undercut_mm2": round(audit.releases[name].undercut_mm2, 2),
            "least_draft_deg": audit.releases[name].draft_deg,
        }
    return {
        "set": plan.number,
        "columns": plan.columns,
        "lines": plan.lines,
        "cavities": plan.cavities,
        "castings": plan.castings,
        "labels": cavities,
        "strips": strips,
        "plates": plates,
        "shared_mm3": audit.shared_mm3,
        "key_gap_mm": audit.key_gap_mm,
        "cap_gap_mm": audit.cap_gap_mm,
        "strip_fits": {strip_label(number): asdict(fit) for number, fit in audit.strips.items()},
        "fits": {sizes.labels[kind]: asdict(fit) for kind, fit in audit.fits.items()},
        "volume_error": audit.volume_error,
        "hausdorff_mm": audit.hausdorff_mm,
    }
