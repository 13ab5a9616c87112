"""A scene on a design: which stages, with which settings, of which variant of the design; why."""

from dataclasses import dataclass, field, replace

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.accuracy import Accuracy
from phytac_design.design.scene import ContactSection, Scene
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Stage
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.optics.fixture_bodies import fixture_mesh
from phytac_design.simulation.scene_scope import Scope, windows_of
from phytac_design.stages import STAGES
from phytac_design.study.planning.pilot import linear_error
from phytac_shapes import Surface
from phytac_shapes.arrays import BoolArray
from phytac_shapes.errors import DesignError

FABRICATION = ("shell", "step", "switch", "hardware", "mold", "kit", "printing", "bench")
STAGES_OF: dict[str, tuple[str, ...]] = {
    "views": ("views",),
    "visibility": ("views",),
    "underload": ("underload",),
    "resolution": ("resolution",),
    "fabrication": FABRICATION,
    "shell": ("shell", "step"),
    "mesh": ("mesh",),
    "decoder": ("decoder",),
    "frames": ("frames",),
    "report": ("report",),
}
"""Stages that make each output; those that they read from come with them."""
AUTO_ms, INVERSE_ms = 1.6, 0.8
"""Time of one core per contact by `auto`, and per frame by `koi_inverse` (measured, p50)."""
POWERS = 4
"""Of the force, in the tables of `auto`, where linear theory is not enough."""
EYES_ms, EYES_ms_Mpx = 0.8, 0.45
"""Time of one core to find markers in a frame: for any, and more per megapixel (measured, p50)."""


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """What a build of a scene is made of.

    Attributes
    ----------
    design : Design
        With the scene's contacts and camera in it, and without fixtures that hide nothing.
    scene : Scene
        Its contacts filled in from the design, its estimator chosen.
    accuracy : Accuracy
        Settings.
    stages : tuple of Stage
        In order, with what they read from.
    scope : Scope or None
        Part of the surface.
    surface, markers : Surface, Markers
        Of the design.
    in_play : (n,) bool
        Receptors that contacts can trip.
    linear_error : float
        Of linear theory at the greatest force, over the greatest motion (pilot); NaN if nobody
        asks.
    why : dict
        Reasons, by stage or by what was decided.
    """

    design: Design
    scene: Scene
    accuracy: Accuracy
    stages: tuple[Stage, ...]
    scope: Scope | None
    surface: Surface
    markers: Markers
    in_play: BoolArray
    linear_error: float
    why: dict[str, str] = field(default_factory=dict)


def resolve(design: Design, scene: Scene, accuracy: Accuracy) -> Resolved:
    """Work out what a scene needs of a design.

    Raises
    ------
    DesignError
        If the scene does not go with the design.
    """
    why: dict[str, str] = {}
    design = _with_contacts(_with_camera(design, scene, why), scene)
    training = design.training
    contacts = ContactSection(
        force_min_N=training.force_min_N,
        force_max_N=training.force_max_N,
        radius_min_mm=training.patch_radius_min_mm,
        radius_max_mm=training.patch_radius_max_mm,
        at_once=scene.contacts.at_once,
    )
    estimator = _estimator(design, scene, why)
    scene = scene.model_copy(update={"contacts": contacts, "estimator": estimator})
    surface = design.surface()
    markers = make_markers(design, surface)
    scope = None
    in_play = np.ones(markers.count, dtype=np.bool_)
    if scene.regions:
        scope = Scope(
            surface=surface,
            windows=windows_of(surface, scene.regions),
            reach_mm=training.patch_radius_max_mm,
            footprint_mm=design.switch.footprint_diameter_mm / 2.0,
        )
        in_play = scope.in_play(markers)
        if not in_play.any():
            raise DesignError(
                f"the regions of the scene {scene.name!r} hold no receptor; widen along and around"
            )
    stages = _stages(scene)
    names = {stage.name for stage in stages}
    if not names & {"hardware", "report", "printing"} and not scene.pictures:
        design = _without_idle_fixtures(design, surface, markers, why)
    off = float("nan")
    if names & {"places", "underload"}:
        off = linear_error(design, surface, markers, scope)
        accuracy = _theory(accuracy, scene, off, why)
    return Resolved(
        design=design,
        scene=scene,
        accuracy=accuracy,
        stages=stages,
        scope=scope,
        surface=surface,
        markers=markers,
        in_play=in_play,
        linear_error=off,
        why=why,
    )


def _with_camera(design: Design, scene: Scene, why: dict[str, str]) -> Design:
    ends = design.camera.ends
    if scene.camera is None or scene.camera == ends:
        return design
    if ends != "both":
        raise DesignError(
            f"the scene {scene.name!r} looks through the {scene.camera} camera, and the design "
            f'{design.name!r} has one at the {ends} end only; set camera = "{ends}" in the scene'
        )
    why["camera"] = f"only the {scene.camera} camera of two"
    camera = design.camera.model_copy(update={"ends": scene.camera})
    return design.model_copy(update={"camera": camera})


def _with_contacts(design: Design, scene: Scene) -> Design:
    """Training of the scene's contacts: the design's where the scene does not say."""
    given, old = scene.contacts, design.training
    data = old.model_dump()
    names = {
        "force_min_N": "force_min_N",
        "force_max_N": "force_max_N",
        "radius_min_mm": "patch_radius_min_mm",
        "radius_max_mm": "patch_radius_max_mm",
    }
    data |= {
        own: getattr(given, name) for name, own in names.items() if getattr(given, name) is not None
    }
    if given.at_once == 1:
        data["multi_contact"] = 0.0
    if not data["force_min_N"] < data["force_max_N"]:
        raise DesignError(
            f"the scene {scene.name!r} leaves forces from {data['force_min_N']:g} to "
            f"{data['force_max_N']:g} N (the design has {old.force_min_N:g} to "
            f"{old.force_max_N:g} N); give contacts.force_min_N and contacts.force_max_N together"
        )
    if data["patch_radius_min_mm"] > data["patch_radius_max_mm"]:
        raise DesignError(
            f"the scene {scene.name!r} leaves patches from {data['patch_radius_min_mm']:g} to "
            f"{data['patch_radius_max_mm']:g} mm; give contacts.radius_min_mm and "
            "contacts.radius_max_mm together"
        )
    return design.model_copy(update={"training": type(old).model_validate(data)})


def latency_ms(design: Design, scene: Scene, estimator: str) -> float:
    """Time of one core from a frame to forces, predicted, ms."""
    camera = design.camera
    pixels = len(camera.end_numbers) * camera.width_px * camera.height_px / 1e6
    eyes = EYES_ms * len(camera.end_numbers) + EYES_ms_Mpx * pixels
    return eyes + (AUTO_ms * scene.contacts.at_once if estimator == "auto" else INVERSE_ms)


def _estimator(design: Design, scene: Scene, why: dict[str, str]) -> str:
    """Estimator of the decoder; `auto` unless it is too slow for the frames."""
    rate = scene.frame_rate_Hz
    budget = float("inf") if rate is None else 1e3 / rate
    chosen = scene.estimator
    if chosen == "any":
        chosen = "auto" if latency_ms(design, scene, "auto") <= budget else "koi_inverse"
    takes = latency_ms(design, scene, chosen)
    if rate is None:
        why["estimator"] = f"{chosen}: latency does not matter here ({takes:.1f} ms a frame)"
    else:
        how = "within" if takes <= budget else "longer than"
        why["estimator"] = f"{chosen}: {takes:.1f} ms a frame, {how} the {budget:.1f} ms there are"
    return chosen


def _stages(scene: Scene) -> tuple[Stage, ...]:
    """Stages that the scene's outputs need, each without what it can do without."""
    wanted = {name for output in scene.outputs for name in STAGES_OF[output]}
    chosen: list[Stage] = []
    for stage in reversed(STAGES):
        if stage.name not in wanted:
            continue
        own = stage
        if stage.name == "decoder" and scene.estimator != "auto" and "report" not in scene.outputs:
            own = replace(stage, needs=tuple(n for n in stage.needs if n != "places"))
        wanted |= set(own.needs)
        chosen.append(own)
    return tuple(reversed(chosen))


def _theory(accuracy: Accuracy, scene: Scene, off: float, why: dict[str, str]) -> Accuracy:
    """Linear theory where the pilot says that it is within half of the error allowed."""
    linear = off <= scene.error_allowed / 2.0
    force = scene.contacts.force_max_N
    what = f"linear theory is off by up to {100.0 * off:.2g} % at {force:g} N"
    if linear:
        why["theory"] = f"linear: {what}, the scene allows {100.0 * scene.error_allowed:g} %"
        return replace(accuracy, place_orders=1, press_tolerance=1.0)
    why["theory"] = f"{what}: {POWERS} powers of the force, presses by large displacement"
    allowed = scene.error_allowed
    press = max(min(accuracy.press_tolerance, allowed), allowed / 2.0)
    return replace(accuracy, place_orders=POWERS, press_tolerance=press)


def _without_idle_fixtures(
    design: Design, surface: Surface, markers: Markers, why: dict[str, str]
) -> Design:
    """Drop fixtures whose picture overlaps no receptor's: they can hide none."""
    if not design.fixtures:
        return design
    cameras = cameras_of(design, surface)
    kept = tuple(
        fixture
        for fixture in design.fixtures
        if any(
            _overlaps(camera, fixture_mesh(fixture, tolerance_mm=0.1).vertices, design, markers)
            for camera in cameras
        )
    )
    if len(kept) < len(design.fixtures):
        names = ", ".join(f.name for f in design.fixtures if f not in kept)
        why["fixtures"] = f"left out, they hide no receptor: {names}"
    return design.model_copy(update={"fixtures": kept})


def _overlaps(
    camera: Camera,
    vertices_mm: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]",
    design: Design,
    markers: Markers,
) -> bool:
    """Whether the box around a body's picture meets that around any receptor's; True if unsure."""
    if not camera.sees(vertices_mm).all():
        return True
    body = camera.project(vertices_mm)
    radius = design.receptor.diameter_outer_mm / 2.0
    corners = np.stack([s * radius * axis for s in (-1.0, 1.0) for axis in np.eye(3)])
    ends = np.stack([markers.tip_mm, markers.foot_mm])
    cloud = (ends[:, :, None] + corners).swapaxes(0, 1).reshape(markers.count, -1, 3)
    pixels = camera.project(cloud.reshape(-1, 3)).reshape(markers.count, -1, 2)
    if not np.isfinite(pixels).all():
        return True
    apart = (pixels.max(axis=1) < body.min(axis=0)) | (pixels.min(axis=1) > body.max(axis=0))
    return bool((~apart.any(axis=1)).any())
