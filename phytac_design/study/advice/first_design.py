"""A first design from a shape, a camera and forces: the densest of a few layouts that is visible.

The layout is that of a shipped design of the family, stretched to the size, and thinned out until
every rule is kept and the camera sees every marker.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from phytac_design.design.design_file import load_design, parse_design
from phytac_design.design.shell_materials import SHELL_MATERIALS, ShellMaterial
from phytac_design.design.spec import Design
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.shell.receptor_stiffness import DIAMETER_OVER_T
from phytac_design.rules.check import check_design
from phytac_design.simulation.scenario.linear_error import NEARLY_LINEAR, linear_error
from phytac_design.study.advice.design_variables import with_fields
from phytac_design.study.advice.force_precision import force_sd_N
from phytac_design.study.advice.quick_repair import seen_at_rest
from phytac_design.study.search.surrogate import strain_of
from phytac_shapes.arrays import BoolArray
from phytac_shapes.errors import DesignError, NumericalError, PhytacError


@dataclass(frozen=True)
class Family:
    """A shape that a first design can have: its template, and fields along and across it."""

    template: str
    along: tuple[str, ...]
    across: tuple[str, ...]


FAMILIES: dict[str, Family] = {
    "cylinder": Family("cylinder40", ("length_mm",), ("diameter_outer_mm",)),
    "cone": Family("cone", ("length_mm",), ("diameter_near_mm", "diameter_far_mm")),
    "cuboid": Family("cuboid", ("length_mm",), ("width_mm", "depth_mm", "edge_radius_mm")),
    "hemisphere": Family("hemisphere", (), ("diameter_outer_mm",)),
    "plane": Family("plane", ("height_mm",), ("width_mm",)),
}
"""Shapes with few sizes; a grip or a patch starts from a file."""
SPACINGS = (1.0, 1.3, 1.7, 2.2)
"""Distances of markers, as multiples of the template's; those are near what a printer can make."""
HEIGHTS = (1.0, 0.7, 0.45)
"""Heights of the far receptors, as shares of the template's in proportion."""
MARKERS_MIN = 8
"""Fewer determine no contact's force, place and size."""
HIDDEN_MAX = 0.5
"""Share of hidden markers above which a layout is left out before a shell is sought for it."""
WALLS_mm = (0.8, 1.0, 1.2, 1.6, 2.0, 2.5, 3.0)
ERROR_MAX = 0.02
"""Predicted standard deviation of a force, over the largest one, that the shell must allow."""
LINEAR_ERROR_MAX = 1.0
"""Error of linear theory at the largest force, beyond which walls are far from linear."""


def first_design(
    name: str,
    kind: str,
    sizes_mm: dict[str, float],
    camera: dict[str, Any],
    *,
    force_min_N: float,
    force_max_N: float,
    material: ShellMaterial | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Propose a design that passes ``phytac check``.

    Parameters
    ----------
    kind : str
        One of ``FAMILIES``.
    sizes_mm : dict
        Fields of the table ``shape``.
    camera : dict
        Table ``camera``.
    force_min_N, force_max_N : float
        Expected forces of a contact. The wall is the thinnest that bears the largest one
        and is nearly linear.
    material : ShellMaterial, optional
        Of the shell; the stiffest with which forces are read to ``ERROR_MAX`` if not given.

    Raises
    ------
    DesignError
        If a value is not acceptable, or no layout that is tried passes.
    """
    least = "no layout was tried"
    materials = (material,) if material else SHELL_MATERIALS
    layouts = _candidates(name, kind, sizes_mm, camera, (force_min_N, force_max_N))
    tried: Iterable[Design] = (parse_design(data, f"new design {name!r}") for data in layouts)
    # Layouts that leave no room for a good shell come last.
    for any_shell in (False, True):
        without_shell = []
        for design in tried:
            if design.layout.wanted < MARKERS_MIN:
                least = f"{design.layout.wanted} markers, fewer than {MARKERS_MIN}"
                continue
            progress(f"trying {design.layout.wanted} markers")
            try:
                own = design
                hidden = None if any_shell else _known_hidden(design)
                if hidden is None or hidden.mean() <= HIDDEN_MAX:
                    own = _with_shell(design, materials, any_shell=any_shell)
                    # Of a shell a camera sees the wall, whatever that is made of.
                    if hidden is None or own.wall != design.wall:
                        hidden = _hidden(own)
            except PhytacError as error:
                least = str(error)
                without_shell.append(design)
                continue
            if not hidden.any():
                return own
            least = f"{int(hidden.sum())} of {len(hidden)} markers are hidden or fused"
        tried = without_shell
    raise DesignError(
        "first-design-not-found",
        f"no layout that was tried shows every marker of this {kind} to this camera (the last one: "
        f"{least}); choose a wider or finer camera, or a larger or shorter body, or start from a "
        f"shipped design: phytac new {name} --from {FAMILIES[kind].template}",
    )


def _hidden(design: Design) -> BoolArray:
    """Markers (n,) that the camera does not see apart from others."""
    return ~seen_at_rest(check_design(design)).clear


def _known_hidden(design: Design) -> BoolArray | None:
    """Hidden markers (n,), or None where a rule is broken that another wall may keep.

    Where most are hidden, no other wall is worth the seconds of its search.
    """
    try:
        return _hidden(design)
    except PhytacError:
        return None


def trip_force_N(design: Design) -> float:
    """Smallest force of the smallest contact patch that turns on a switch under its middle."""
    return design.switch.threshold_N / _footprint_share(design.model_dump())


def _footprint_share(data: dict[str, Any]) -> float:
    """Share of the smallest contact patch that lies on a switch's footprint."""
    patch_mm = 2.0 * data["training"]["patch_radius_min_mm"]
    return float(min(1.0, data["switch"]["footprint_diameter_mm"] / patch_mm) ** 2)


def _candidates(
    name: str,
    kind: str,
    sizes_mm: dict[str, float],
    camera: dict[str, Any],
    forces_N: tuple[float, float],
) -> Iterator[dict[str, Any]]:
    """Tables of designs, the densest first."""
    family = FAMILIES[kind]
    base = load_design(family.template).model_dump(mode="json")
    along = _ratio(sizes_mm, base["shape"], family.along)
    across = _ratio(sizes_mm, base["shape"], family.across)
    base |= {"name": name, "description": f"A {kind}, laid out by `phytac new`."}
    base["shape"] = {"kind": kind, **sizes_mm}
    base["camera"] = camera
    training = base["training"]
    radius_mm = min(training["patch_radius_max_mm"], 0.25 * min(sizes_mm.values()))
    base["training"] = {
        **training,
        "force_min_N": forces_N[0],
        "force_max_N": forces_N[1],
        "patch_radius_max_mm": round(radius_mm, 2),
        "patch_radius_min_mm": round(min(training["patch_radius_min_mm"], radius_mm), 2),
    }
    # The largest force must trip switches: at most half of what it puts on a footprint.
    share = _footprint_share(base)
    threshold_N = min(base["switch"]["threshold_N"], 0.5 * share * forces_N[1])
    release = base["switch"]["release_N"] / base["switch"]["threshold_N"]
    base["switch"] = {
        **base["switch"],
        "threshold_N": float(f"{threshold_N:.2g}"),
        "release_N": float(f"{release * threshold_N:.2g}"),
    }
    layout, light = base["layout"], base["light"]
    bar_mm = light["bar_radius_mm"]
    tall = HEIGHTS if layout["heights"] != "constant" else HEIGHTS[:1]
    for spacing, height, bar in product(SPACINGS, tall, (1.0, 0.0) if bar_mm else (1.0,)):
        own: dict[str, Any]
        if layout["kind"] == "phyllotaxis":
            own = {"count": max(round(layout["count"] * (across / spacing) ** 2), 1)}
        else:
            # Colours alternate around: their number divides that of the columns.
            step = 1 if layout["kind"] == "straight" else len(layout["colours"])
            columns = step * max(round(layout["columns"] * across / spacing / step), 1)
            own = {"rows": max(round(layout["rows"] * along / spacing), 1), "columns": columns}
        if layout["heights"] != "constant":
            far_mm = layout["height_far_mm"] * height * across
            own["height_far_mm"] = round(max(far_mm, layout["height_near_mm"]), 1)
        bars = {**light, "bar_radius_mm": round(bar * bar_mm * min(across, 1.5), 1)}
        yield {**base, "layout": {**layout, **own}, "light": bars}


def _ratio(sizes_mm: dict[str, float], base: dict[str, Any], fields: tuple[str, ...]) -> float:
    """Size of a body over that of the template, along or across."""
    own = [field for field in fields if field in sizes_mm]
    if not own:
        return 1.0
    return float(sum(sizes_mm[field] for field in own) / sum(base[field] for field in own))


def _with_shell(design: Design, materials: Sequence[ShellMaterial], *, any_shell: bool) -> Design:
    """The design with a shell that bears its largest force, and moves enough to show it.

    Taken is the first material of which a nearly linear wall reads forces to ``ERROR_MAX``; walls
    whose receptors' stiffness is known come first. If there is none, it is the wall nearest to
    linear of those that bear the force and read it so well, or the one that reads it best of those
    that bear it; where none bears it, the stiffest.

    Parameters
    ----------
    any_shell : bool
        Whether walls that a rule rejects are left out also where no other reads forces so well.

    Raises
    ------
    DesignError
        If a rule rejects a wall, and no other reads forces to ``ERROR_MAX``.
    """
    most_N = design.training.force_max_N
    stiff: set[ShellMaterial] = set()
    rejected: list[DesignError] = []
    bent: list[tuple[float, Design]] = []
    read: list[tuple[float, Design]] = []
    for material, own, error in _bearing_walls(design, materials, stiff, rejected):
        if error > NEARLY_LINEAR:
            bent.append((error, own))
            continue
        sd_N = force_sd_N(own)
        if sd_N <= ERROR_MAX * most_N:
            return own
        read.append((sd_N, own))
        stiff.add(material)  # thicker walls show less
    for _, own in sorted(bent, key=lambda each: each[0]):
        sd_N = force_sd_N(own)
        if sd_N <= ERROR_MAX * most_N:
            return own
        read.append((sd_N, own))
    if rejected and not any_shell:
        raise rejected[0]
    if not read:
        return _with_wall(design, materials[0], WALLS_mm[-1])[0]
    return min(read, key=lambda each: each[0])[1]


def _bearing_walls(
    design: Design,
    materials: Sequence[ShellMaterial],
    left_out: set[ShellMaterial],
    rejected: list[DesignError],
) -> Iterator[tuple[ShellMaterial, Design, float]]:
    """Yield walls that bear the largest force, and the error of linear theory there.

    The thinnest of a material come first, and those whose receptors' stiffness is known before all
    others. Materials that the caller puts into ``left_out`` are not tried; the errors of walls that
    a rule rejects are put into ``rejected``.
    """
    thickest_mm = design.receptor.diameter_outer_mm / DIAMETER_OVER_T[0]
    walls = [(material, one) for material in materials for one in WALLS_mm]
    for material, thickness_mm in sorted(walls, key=lambda each: each[1] > thickest_mm):
        if material in left_out:
            continue
        try:
            own, bears, linear = _with_wall(design, material, thickness_mm)
        except DesignError as error:
            rejected.append(error)
            continue
        if bears:
            yield material, own, linear


def _linear_error(sensor: Sensor) -> float:
    """Error of linear theory at the largest force; infinite where that has no solution."""
    try:
        return linear_error(sensor, None)
    except NumericalError:
        return float("inf")


class PredictedShell(NamedTuple):
    """A design with another shell, whether that bears the largest force, and the force's error.

    ``error`` is the predicted standard deviation of the largest force, over that force.
    """

    design: Design
    bears: bool
    error: float


def with_thinnest_wall(
    design: Design, material: ShellMaterial, walls_mm: Sequence[float]
) -> PredictedShell:
    """The design with the first of some walls that bears its largest force, or the last of them.

    Parameters
    ----------
    walls_mm : sequence of float
        Thicknesses, the thinnest first; at least one.

    Raises
    ------
    DesignError
        If a rule rejects a wall that is tried.
    """
    for thickness_mm in walls_mm:
        own, bears, _ = _with_wall(design, material, thickness_mm)
        if bears:
            break
    return PredictedShell(own, bears, force_sd_N(own) / design.training.force_max_N)


def _with_wall(
    design: Design, material: ShellMaterial, thickness_mm: float
) -> tuple[Design, bool, float]:
    """The design with a wall, whether that bears the largest force, and linear theory's error.

    The error is infinite where the strain is too large already.
    """
    own = with_fields(
        design,
        {
            "material.modulus_MPa": material.modulus_MPa,
            "material.poisson": material.poisson,
            "wall.thickness_mm": thickness_mm,
        },
    )
    sensor = check_design(own)
    error = _linear_error(sensor) if strain_of(sensor) <= material.strain_max else float("inf")
    return own, error <= LINEAR_ERROR_MAX, error
