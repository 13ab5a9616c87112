"""The camera of the twin: what its faults do, its cost, which renderer, and who can be read."""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_decoder.pipeline.decode import locate_markers
from phytac_design.core.threads import THREADS, one_thread_each
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.optics.exposure import CLEAN, Exposure, expose, lens_blur, light_on_chip
from phytac_design.optics.frame_renderer import render_frame, sample_views
from phytac_design.optics.light import triangle_light
from phytac_design.optics.picture import render_picture
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import build_scene
from phytac_design.simulation.contacts import draw_contacts, switch_states
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import motion_responses, superpose
from phytac_design.simulation.scenario.scenario_sections import SolveSection
from phytac_design.simulation.sensor_instance import SensorInstance, ThicknessField
from phytac_design.stages.build import copy_of
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray, ImageArray
from phytac_shapes.errors import InputError

FORCE_N = 25.0
EDGE_LEVELS, EDGE_PX = 8.0, 1
"""Pixels differ if by more grey levels than this; they lie away from edges beyond this distance."""
SAMPLES = SolveSection().samples_per_pixel
"""Of a pixel in frames of ``phytac simulate``."""
FAULTS: dict[str, dict[str, Any]] = {
    "lens blur (f/2.8, 8 lens points) and diffraction": {"lens_blur": True},
    "fall-off of the bar's light": {"fall_off": True},
    "vignetting, 30 % in the corner": {"vignetting": 0.3},
    "light 20 % down": {},
    "JPEG 90": {"jpeg_quality": 90},
    "JPEG 75": {"jpeg_quality": 75},
    "JPEG 50": {"jpeg_quality": 50},
}


@dataclass(frozen=True, kw_only=True)
class CameraCase:
    """A design as its own unit, pressed."""

    design: Design
    surface: Surface
    markers: Markers
    unit: SensorInstance
    views: dict[str, Any]

    @classmethod
    def of(cls, design: Design) -> "CameraCase":
        """The unit that is the design itself."""
        surface = design.surface()
        markers = make_markers(design, surface)
        threshold = thresholds_N(design, markers) * np.ones(markers.count)
        unit = SensorInstance(
            number=0,
            markers=markers,
            wall=ThicknessField(mean=1.0, waves=np.zeros((0, 4)), domain=surface.domain),
            modulus=1.0,
            on_N=threshold,
            off_N=0.7 * threshold,
            cameras=cameras_of(design, surface),
            paint=np.ones((len(design.layout.colours) + 1, 3)),
        )
        views = expected_views(Sensor.of(design, surface, markers))
        return cls(design=design, surface=surface, markers=markers, unit=unit, views=views)

    def eyes(self, exposure: Exposure | None = None, **options: Any) -> ImagingModel:
        """Its eyes, with the default exposure and the design's noise."""
        used = exposure or Exposure(noise_pixel=self.design.camera.noise_pixel)
        return ImagingModel(
            self.design, self.surface, self.unit, exposure=used, views=self.views, **options
        )

    def pressed(self, count: int) -> tuple[FloatArray, Any]:
        """Linear motions (count, n, 6) under one to three contacts of 25 N, and their bits."""
        rng = np.random.default_rng(3)
        drawn = draw_contacts(
            Sensor.of(self.design, self.surface, self.markers), samples=count, rng=rng, most=3
        )
        contacts = replace(drawn, force_N=np.full(len(drawn.force_N), FORCE_N))
        mesh, model = truth_shell(self.design, self.surface, 2)
        response = motion_responses(
            model, mesh, self.surface, self.markers, uv=contacts.uv, radius_mm=contacts.radius_mm
        )
        bits = switch_states(Sensor.of(self.design, self.surface, self.markers), contacts).bits
        return superpose(response, contacts), bits


def rms(values: FloatArray) -> float:
    """Root mean square of what is known."""
    return float(np.sqrt(np.nanmean(values**2)))


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and its processor seconds over all threads."""
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def faults(table: Table, case: CameraCase) -> None:
    """What each fault of a camera does to centroids at rest and to displacements."""
    (motion,), (bits,) = case.pressed(1)
    still, off = np.zeros_like(motion), np.zeros_like(bits)

    def look(eyes: ImagingModel, brightness: float) -> list[FloatArray]:
        places = []
        for pose, on in ((still, off), (motion, bits)):
            frames = eyes.frame(pose, on, brightness)
            places.append(locate_markers(eyes.nominal, frames)[0].position_px)
        return places

    clean = look(case.eyes(CLEAN), 1.0)
    for name, change in FAULTS.items():
        try:
            seen = look(case.eyes(replace(CLEAN, **change)), 1.0 if change else 0.8)
        except InputError as error:
            table.add(f"{case.design.name}: {name}", 0.0, "-", reference=1.0,
                      source="a clean camera", target=">= 1", note=str(error))  # fmt: skip
            continue
        moved = (seen[1] - seen[0]) - (clean[1] - clean[0])
        row = f"{case.design.name}: {name}: change of displacements"
        source = "a camera without faults or noise"
        note = (
            f"of centroids at rest {rms(seen[0] - clean[0]):.3f} px RMS; "
            f"{int(np.isnan(seen[1][:, 0]).sum())} markers lost; {FORCE_N:g} N"
        )
        table.add(row, rms(moved), "px RMS", 0.0, source, note=note)


def camera_chain(table: Table, case: CameraCase, *, quick: bool) -> None:
    """Seconds of everything behind the renderer, on one thread; how good eight lens points are."""
    design, camera = case.design, case.unit.cameras[0]
    scene = build_scene(
        Sensor.of(design, case.surface, case.markers),
        tolerance_mm=tolerance_mm(camera, case.markers),
    )
    light, blur = (
        triangle_light(scene, camera),
        lens_blur(Sensor.of(design, case.surface, case.markers), camera),
    )
    with one_thread_each(THREADS):
        sharp, blurred, spent = [], [], []
        chip = light_on_chip(scene, camera, light=light, blur=blur)
        exposure = Exposure(noise_pixel=2.0, jpeg_quality=90)
        for k in range(1 if quick else 3):
            sharp.append(timed(lambda: light_on_chip(scene, camera, light=light, blur=None))[1])
            blurred.append(timed(lambda: light_on_chip(scene, camera, light=light, blur=blur))[1])
            rng = np.random.default_rng(k)
            spent.append(timed(partial(expose, chip, camera, exposure, rng=rng))[1])
    extra = float(np.median(spent)) + max(float(np.median(blurred)) - float(np.median(sharp)), 0.0)
    row = f"{design.name} {camera.width_px}x{camera.height_px}: blur, vignetting, noise and JPEG 90"
    source = "rendering the sharp frame, 8 samples a pixel"
    note = (
        f"vignetting, noise, sRGB and JPEG {np.median(spent):.2f} s; blur "
        f"{np.median(blurred) - np.median(sharp):.2f} s more than a sharp frame: its samples look "
        "through points of the lens"
    )
    table.add(row, extra, "s of one core", float(np.median(sharp)), source, "<= 0.7", note)
    many = 32 if quick else 64
    (motion,), (bits,) = case.pressed(1)
    moves, places, images = [], [], []
    for samples in (8, many):
        eyes = case.eyes(replace(CLEAN, lens_blur=True), samples=samples)
        frames = [
            eyes.frame(pose, on)
            for pose, on in ((np.zeros_like(motion), np.zeros_like(bits)), (motion, bits))
        ]
        rest, pressed = (locate_markers(eyes.nominal, each)[0].position_px for each in frames)
        moves.append(pressed - rest)
        places.append(rest)
        images.append(frames[0][0].astype(np.float64))
    difference = np.abs(images[0] - images[1])
    edge = difference.max(axis=2) > 0.0
    row = f"{design.name}: eight lens points, displacements"
    source = f"{many} lens points a pixel: the disc, occlusion and all"
    note = (
        f"centroids at rest {rms(places[0] - places[1]):.3f} px RMS (most of it stays when "
        f"pressed); {100.0 * np.mean(edge):.1f} % of the pixels differ at all, "
        f"{rms(difference[edge]):.1f} grey levels RMS there, "
        f"{np.percentile(difference, 99.9):.0f} at the worst of 1000; {FORCE_N:g} N"
    )
    table.add(row, rms(moves[0] - moves[1]), "px RMS", 0.0, source, "<= 0.05", note)


def samples_of_a_pixel(table: Table, case: CameraCase, *, quick: bool) -> None:
    """What samples of a pixel cost, and how far markers seem to move as they cross the pixels."""
    camera, label = case.unit.cameras[0], case.design.name
    with one_thread_each(THREADS):
        for samples in (8, 24) if quick else (8, 23, 24, 54, 96):
            eyes = case.eyes(replace(CLEAN, lens_blur=True), samples=samples)
            scene = eyes.cameras[0].rest
            eyes.cameras[0].light(scene)
            light, seconds = timed(partial(eyes.cameras[0].light, scene))
            scatter = rms(eyes.at_rest.grid_px)
            views, side = sample_views(samples)
            row = (
                f"{label} {camera.width_px}x{camera.height_px}: {samples} samples a pixel, scatter "
                "of markers over places on the pixels"
            )
            source = "a frame moved by parts of a pixel, moved back"
            note = (
                f"{seconds:.2f} s of one core to render {light.shape[1]}x{light.shape[0]}; "
                f"lattices of {side}x{side} through {views} points of the aperture"
            )
            table.add(
                row, scatter, "px RMS", 0.0, source, "<= 0.02" if samples == SAMPLES else None, note
            )


def _positions(case: CameraCase, image: ImageArray) -> FloatArray:
    """Marker positions (n, 2) in one frame, by the design's eyes."""
    return locate_markers(case.eyes(CLEAN).nominal, (image,))[0].position_px


def renderers(table: Table, case: CameraCase) -> None:
    """The project's renderer against pyrender: seconds, pixels, centroids."""
    design, camera = case.design, case.unit.cameras[0]
    scene = build_scene(
        Sensor.of(design, case.surface, case.markers),
        tolerance_mm=tolerance_mm(camera, case.markers),
    )
    works: list[Callable[[], ImageArray]] = [
        lambda: render_frame(scene, camera),
        lambda: render_picture(scene, camera),
        lambda: render_frame(scene, camera, samples=64),
    ]
    frames = [work() for work in works]
    seconds = []
    for work in works[:2]:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        seconds.append(float(np.median(times)))
    part = rasterise(scene, camera).triangle
    near = np.zeros(part.shape, dtype=np.bool_)
    marks = np.where(part >= 0, scene.part[part], 0)
    for axis in (0, 1):
        for step in range(-EDGE_PX, EDGE_PX + 1):
            near |= np.roll(marks, step, axis=axis) != marks
    far = np.abs(frames[0].astype(float) - frames[1]).max(axis=2) > EDGE_LEVELS
    label = f"{design.name} {camera.width_px}x{camera.height_px}"
    row = f"{label}: pixels away from edges where own renderer and pyrender differ by > 8 levels"
    source = "pyrender (OpenGL, EGL), same light"
    note = (
        f"{100.0 * float(near.mean()):.1f} % of the pixels lie on an edge between parts; of "
        f"those {100.0 * float(far[near].mean()):.0f} % differ: OpenGL averages its four samples "
        "after the gamma"
    )
    table.add(row, 100.0 * float(far[~near].mean()), "%", 0.0, source, "<= 0.1", note)
    rest = [_positions(case, frame) for frame in frames]
    row = f"{label}: marker centroids, own renderer"
    source = "pyrender; both against 64 samples a pixel"
    note = (
        "the own renderer is taken for frames: it averages linear light as a sensor does, "
        "bends for any lens, blurs with true occlusion, needs no OpenGL, and gives the same bits "
        "on every machine"
    )
    value = rms(rest[0] - rest[2])
    table.add(row, value, "px RMS", rms(rest[1] - rest[2]), source, "<= 0.05", note)
    row = f"{label}: seconds a frame, own renderer (8 samples a pixel)"
    source = "pyrender (4 samples a pixel, a context per frame), same run"
    note = f"own renderer on {len(os.sched_getaffinity(0))} threads"
    table.add(row, seconds[0], "s", seconds[1], source, note=note)


def readable(table: Table, case: CameraCase) -> None:
    """Whether a design is read with the default exposure: markers and bits."""
    eyes = case.eyes()
    rng = np.random.default_rng(0)
    still = np.zeros((case.markers.count, 6))
    lost, wrong, why = 0, 0, ""
    for state in (False, True):
        bits = np.full(case.markers.count, state)
        try:
            matched, on = locate_markers(eyes.nominal, eyes.frame(still, bits, 1.0, rng))
        except InputError as error:
            lost, why = lost + case.markers.count, str(error)
            continue
        lost += int((~matched.found).sum())
        wrong += int(((on != bits) & eyes.nominal.tips.readable).sum())
    blur = [eye.blur for eye in eyes.cameras]
    row = f"{case.design.name}: markers lost with the default exposure, switches off and on"
    source = "twice the markers"
    note = (
        why or f"{wrong} readable switches misread; aperture {blur[0].aperture_mm:.2f} mm"
        if blur[0]
        else why
    )
    table.add(row, lost, "markers", 2 * case.markers.count, source, "<= 0", note)


def quarter(design: Design) -> Design:
    """The same design before a camera with a sixteenth of the pixels, as large as they are."""
    camera = design.camera
    return copy_of(
        design,
        camera={
            "width_px": camera.width_px // 4,
            "height_px": camera.height_px // 4,
            "focal_px": camera.focal_px / 4.0,
            "pixel_um": camera.pixel_um * 4.0,
        },
    )
