"""How much of everything each stage handles: nodes, loads, places, contacts, presses, pixels."""

from dataclasses import dataclass

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.scene import ALL_AT_ONCE, Scene
from phytac_design.design.spec import Design
from phytac_design.layout import Markers
from phytac_design.simulation.instance_shell import MARGIN
from phytac_design.simulation.response_tables import place_spacing_mm, rings
from phytac_design.simulation.scene_scope import PRESSES_LEAST, Scope
from phytac_design.stages.response import SCENE_SAMPLES, samples_of
from phytac_design.study.planning.resolve import Resolved
from phytac_shapes import Surface

COARSE = 2.5
"""Element size of a local mesh far from the touched part, over that in it."""


@dataclass(frozen=True, kw_only=True)
class Counts:
    """Sizes of a build, predicted; exact where that is cheap.

    Attributes
    ----------
    markers, in_play : int
        Receptors, and those that contacts can trip.
    megapixels : float
        Of all cameras.
    picture_megapixels : float
        Of pictures that are made.
    repeats : int
        Sectors that the sensor repeats itself in; 1 for none.
    nodes, truth_nodes : int
        Of the decoder's mesh and the simulated sensor's.
    response_loads, twin_loads : int
        Right-hand sides.
    places, place_solves : int
        Places tabulated, and those solved.
    contacts : int
        Drawn by the twin.
    samples : int
        Samples that train networks.
    presses : int
        Places pressed to see what hides.
    frames : int
        Rendered and decoded.
    """

    markers: int
    in_play: int
    megapixels: float
    picture_megapixels: float
    repeats: int
    nodes: int
    truth_nodes: int
    response_loads: int
    twin_loads: int
    places: int
    place_solves: int
    contacts: int
    samples: int
    presses: int
    frames: int


def counts_of(resolved: Resolved) -> Counts:
    """Sizes of the build of a scene."""
    return count(
        resolved.design,
        resolved.accuracy,
        resolved.surface,
        resolved.markers,
        scene=resolved.scene,
        scope=resolved.scope,
        in_play=int(resolved.in_play.sum()),
    )


def count(
    design: Design,
    accuracy: Accuracy,
    surface: Surface,
    markers: Markers,
    *,
    scene: Scene | None = None,
    scope: Scope | None = None,
    in_play: int | None = None,
) -> Counts:
    """Sizes of a build; without a scene of a whole one."""
    camera, n = design.camera, markers.count
    pixels = len(camera.end_numbers) * camera.width_px * camera.height_px / 1e6
    played = n if in_play is None else in_play
    turns = repeats(surface, markers)
    samples = samples_of(design, accuracy.sample_share)
    if scene is not None and not scene.samples:
        samples = {"train": 0, **SCENE_SAMPLES}
    most = scene.at_once if scene else ALL_AT_ONCE
    mean = 1.0 + design.training.multi_contact * max((2 + most) / 2.0 - 1.0, 0.0)
    contacts = round(sum(samples.values()) * (mean if most > 1 else 1.0))
    nodes = _nodes(surface, markers, accuracy.refine)
    truth = _nodes(surface, markers, accuracy.truth_refine)
    rows = n // turns if turns > 1 else n
    loads = rows if turns > 1 else played
    adjoints = 6 * rows
    if scope is not None:
        truth = round(truth * _local_share(design, surface, scope))
        adjoints = 6 * n
    radius = (design.training.patch_radius_min_mm + design.training.patch_radius_max_mm) / 2.0
    spacing = place_spacing_mm(surface, accuracy.place_share, radius)
    ring = rings(surface, spacing, turns)
    near = np.ones(len(ring.uv), dtype=np.bool_) if scope is None else scope.near(spacing, ring.uv)
    presses = accuracy.press_places
    if scope is not None:
        presses = max(int(np.ceil(presses * scope.sector_share(turns))), PRESSES_LEAST)
    pictured = scene is None or scene.pictures
    return Counts(
        markers=n,
        in_play=played,
        megapixels=pixels,
        picture_megapixels=pixels if pictured else 0.0,
        repeats=turns,
        nodes=nodes,
        truth_nodes=truth,
        response_loads=loads,
        twin_loads=min(contacts, adjoints),
        places=int(near.sum()),
        place_solves=len(np.unique(ring.base[near])),
        contacts=contacts,
        samples=samples["train"],
        presses=presses,
        frames=accuracy.frames,
    )


def repeats(surface: Surface, markers: Markers) -> int:
    """Sectors that the sensor repeats itself in, judged by its markers; 1 for none."""
    lattice = markers.lattice
    if lattice is None or lattice.columns < 2 or not surface.periodic[1] or any(surface.poles):
        return 1
    if len(lattice.rows_u) * lattice.columns != markers.count:
        return 1
    angle = 2.0 * np.pi / lattice.columns
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]]
    )
    here = markers.mid_mm.reshape(-1, lattice.columns, 3)
    gap = np.abs(here @ turn.T - np.roll(here, -1, axis=1)).max()
    return lattice.columns if gap < 1e-6 * np.abs(here).max() else 1


def _nodes(surface: Surface, markers: Markers, refine: int) -> int:
    """Nodes of a mesh with so many elements per marker pitch."""
    area = surface.area_mm2()
    pitch = float(np.sqrt(area / markers.count))
    lattice = markers.lattice
    if lattice is not None and surface.periodic[1] and not any(surface.poles):
        (u0, _), (v0, v1) = surface.domain
        edge = surface.unwrap(np.array([[u0, v0], [u0, v1]]))
        pitch = float(abs(edge[1, 0] - edge[0, 0])) / lattice.columns
    return round(area * (refine / pitch) ** 2)


def _local_share(design: Design, surface: Surface, scope: Scope) -> float:
    """Nodes of a mesh that is fine in the touched part alone, over those of one fine all over."""
    if any(surface.poles):
        return 1.0
    region, span = scope.touched, np.ptp(surface.domain, axis=1)
    size = np.sort(np.ptp(surface.bounds_mm(), axis=0))[1] / 2.0
    margin = MARGIN * float(np.sqrt(size * design.wall.thickness_mm))
    metric = surface.metric(surface.domain.mean(axis=1)[None])[0]
    share = 1.0
    for axis in (0, 1):
        if region.whole[axis]:
            continue
        part = float(region.high[axis] - region.low[axis]) % float(span[axis])
        fine = part / float(span[axis])
        fine += 2.0 * margin / (float(np.sqrt(metric[axis, axis])) * float(span[axis]))
        share *= min(fine + (1.0 - fine) / COARSE, 1.0)
    return share
