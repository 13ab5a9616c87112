"""A scene applied to a design: the stages, their settings, the variant of the design, and why."""

from dataclasses import dataclass, field, replace

import numpy as np

from phytac_design.design.accuracy import Accuracy
from phytac_design.design.scene import ContactSection, Scene
from phytac_design.design.spec import Design
from phytac_design.engine.stage import Context, Stage
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.scenario.linear_error import linear_error
from phytac_design.simulation.scenario.scene_scope import Scope, windows_of
from phytac_design.stages import STAGES
from phytac_design.stages.build import with_named
from phytac_shapes.arrays import BoolArray
from phytac_shapes.errors import DesignError

SERIES_REFINE_MIN = 4
"""Elements per marker pitch of tables of more than one power of the force: with 3 the worst of
`fingertip`'s presses on `cuboid` is 7.3 % off in place of 6.2; elsewhere it is the same."""
STAGES_OF: dict[str, tuple[str, ...]] = {
    "views": ("views",),
    "visibility": ("views",),
    "underload": ("underload",),
    "resolution": ("resolution",),
    "fabrication": (
        "shell",
        "step",
        "switch",
        "hardware",
        "mold",
        "kit",
        "inserts",
        "printing",
        "bench",
    ),
    "shell": ("shell", "step"),
    "mesh": ("mesh",),
    "decoder": ("decoder",),
    "frames": ("frames",),
    "report": ("report",),
}
"""Stages that make each output; those that they read from come with them."""


@dataclass(frozen=True, kw_only=True)
class Resolved:
    """What a build of a scene is made of.

    Attributes
    ----------
    design : Design
        With the scene's contacts and camera.
    scene : Scene
        Its contacts filled in from the design, its estimator chosen.
    accuracy : Accuracy
        Settings.
    stages : tuple of Stage
        In order, with what they read from.
    scope : Scope or None
        Part of the surface.
    in_play : (n,) bool
        Receptors that contacts can trip.
    linear_error : float
        Of linear theory at the largest force, over the largest motion (pilot); NaN if no stage
        needs it.
    why : dict
        Reasons, by decision.
    """

    design: Design
    scene: Scene
    accuracy: Accuracy
    stages: tuple[Stage, ...]
    scope: Scope | None
    in_play: BoolArray
    linear_error: float
    why: dict[str, str] = field(default_factory=dict)

    def context(self, seed: int = 0) -> Context:
        """Context of the stages, without results."""
        return Context(
            design=self.design,
            accuracy=self.accuracy,
            seed=seed,
            scene=self.scene,
            progress=lambda _: None,
        )


def resolve(design: Design, scene: Scene, accuracy: Accuracy) -> Resolved:
    """Stages and settings that a scene needs of a design.

    Raises
    ------
    DesignError
        If the scene does not fit the design.
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
    sensor = Sensor(design)
    scope = None
    in_play = np.ones(sensor.markers.count, dtype=np.bool_)
    if scene.regions:
        scope = Scope(
            surface=sensor.surface,
            windows=windows_of(sensor.surface, scene.regions),
            reach_mm=training.patch_radius_max_mm,
            footprint_mm=design.switch.footprint_diameter_mm / 2.0,
        )
        in_play = scope.in_play(sensor.markers)
        if not in_play.any():
            raise DesignError(
                "scene-without-receptors",
                f"the regions of the scene {scene.name!r} hold no receptor; widen along and around",
            )
    stages = _stages(scene)
    if "fabrication" in scene.outputs:
        accuracy = with_named(accuracy, STAGES_OF["fabrication"])
    names = {stage.name for stage in stages}
    off = float("nan")
    if names & {"places", "underload"}:
        off = linear_error(sensor, scope)
        accuracy = _theory(accuracy, scene, off, why)
    return Resolved(
        design=design,
        scene=scene,
        accuracy=accuracy,
        stages=stages,
        scope=scope,
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
            "scene-camera-missing",
            f"the scene {scene.name!r} looks through the {scene.camera} camera, and the design "
            f'{design.name!r} has one at the {ends} end only; set camera = "{ends}" in the scene',
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
            "scene-range-empty",
            f"the scene {scene.name!r} leaves forces from {data['force_min_N']:g} to "
            f"{data['force_max_N']:g} N (the design has {old.force_min_N:g} to "
            f"{old.force_max_N:g} N); give contacts.force_min_N and contacts.force_max_N together",
        )
    if data["patch_radius_min_mm"] > data["patch_radius_max_mm"]:
        raise DesignError(
            "scene-range-empty",
            f"the scene {scene.name!r} leaves patches from {data['patch_radius_min_mm']:g} to "
            f"{data['patch_radius_max_mm']:g} mm; give contacts.radius_min_mm and "
            "contacts.radius_max_mm together",
        )
    return design.model_copy(update={"training": type(old).model_validate(data)})


def latency_ms(design: Design, scene: Scene, estimator: str) -> float:
    """Predicted time of one core from a frame to forces, ms, where markers are followed.

    From medians of the decoder benchmark: markers are found in 0.8 ms an image and 0.45 ms a
    megapixel; `auto` takes 1.6 ms a contact, the other estimators 0.8 ms a frame.
    """
    camera = design.camera
    count = len(camera.end_numbers)
    detection = count * (0.8 + 0.45 * camera.width_px * camera.height_px / 1e6)
    return detection + (1.6 * scene.contacts.at_once if estimator == "auto" else 0.8)


def _estimator(design: Design, scene: Scene, why: dict[str, str]) -> str:
    """Estimator of the decoder; `auto` unless it is too slow for the frame rate."""
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
        why["estimator"] = (
            f"{chosen}: {takes:.1f} ms a frame with --follow, {how} the {budget:.1f} ms available"
        )
    return chosen


def _stages(scene: Scene) -> tuple[Stage, ...]:
    """Stages that the scene's outputs need, each with the dependencies that it needs."""
    wanted = {name for output in scene.outputs for name in STAGES_OF[output]}
    chosen: list[Stage] = []
    for stage in reversed(STAGES):
        if stage.name not in wanted:
            continue
        own = stage
        if stage.name == "decoder" and scene.estimator != "auto" and "report" not in scene.outputs:
            own = replace(stage, depends_on=tuple(n for n in stage.depends_on if n != "places"))
        wanted |= set(own.depends_on)
        chosen.append(own)
    return tuple(reversed(chosen))


def _theory(accuracy: Accuracy, scene: Scene, off: float, why: dict[str, str]) -> Accuracy:
    """Linear theory where the pilot's error is within half of the error allowed, else a series."""
    orders = 4
    linear = off <= scene.error_allowed / 2.0
    force = scene.contacts.force_max_N
    what = f"linear theory is off by up to {100.0 * off:.2g} % at {force:g} N"
    if linear:
        why["theory"] = f"linear: {what}, the scene allows {100.0 * scene.error_allowed:g} %"
        return replace(accuracy, place_orders=1, press_tolerance=1.0)
    why["theory"] = f"{what}: {orders} powers of the force, presses by large displacement"
    refine = accuracy.refine
    if refine < SERIES_REFINE_MIN:
        refine = SERIES_REFINE_MIN
        why["mesh"] = f"{refine} elements a marker pitch, for powers of the force on flat walls"
    allowed = scene.error_allowed
    press = max(min(accuracy.press_tolerance, allowed), allowed / 2.0)
    return replace(accuracy, refine=refine, place_orders=orders, press_tolerance=press)
