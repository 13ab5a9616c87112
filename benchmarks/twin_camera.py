"""How the simulated sensor sees: points against frames, noise, faults of a camera, who is read.

Rows of ``twin``.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.harness import Table
from phytac_decoder.pipeline.decode import locate_markers
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.sensor import Sensor
from phytac_design.layout.thresholds import thresholds_N
from phytac_design.optics.exposure import CLEAN, Exposure
from phytac_design.simulation.contacts import draw_contacts, switch_states
from phytac_design.simulation.imaging.imaging_model import ImagingModel
from phytac_design.simulation.imaging.nominal_view import expected_views
from phytac_design.simulation.instance_shell import truth_shell
from phytac_design.simulation.linear_response import motion_responses, superpose
from phytac_design.simulation.scenario.instance_scatter import draw_sensor_instance
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection, SolveSection
from phytac_design.simulation.sensor_instance import SensorInstance, ThicknessField
from phytac_design.stages.build import copy_of
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray
from phytac_shapes.errors import InputError

FORCE_N = 25.0
DRAWS = 16
"""Draws of noise that are averaged, to leave that which hangs on the place on the pixels."""
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
            wall=ThicknessField.even(surface),
            modulus=1.0,
            on_N=threshold,
            off_N=0.7 * threshold,
            cameras=cameras_of(design, surface),
            paint=np.ones((len(design.layout.colours) + 1, 3)),
        )
        views = expected_views(Sensor.of(design, surface, markers))
        return cls(design=design, surface=surface, markers=markers, unit=unit, views=views)

    def imaging_model(self, exposure: Exposure | None = None, **options: Any) -> ImagingModel:
        """Its model, with the default exposure and the design's noise."""
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


def faults(table: Table, case: CameraCase) -> None:
    """What each fault of a camera does to centroids at rest and to displacements."""
    (motion,), (bits,) = case.pressed(1)
    still, off = np.zeros_like(motion), np.zeros_like(bits)

    def look(model: ImagingModel, brightness: float) -> list[FloatArray]:
        places = []
        for pose, on in ((still, off), (motion, bits)):
            frames = model.frame(pose, on, brightness)
            places.append(locate_markers(model.nominal, frames)[0].position_px)
        return places

    clean = look(case.imaging_model(CLEAN), 1.0)
    for name, change in FAULTS.items():
        try:
            seen = look(case.imaging_model(replace(CLEAN, **change)), 1.0 if change else 0.8)
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


def readable(table: Table, case: CameraCase) -> None:
    """Whether a design is read with the default exposure: markers and bits."""
    model = case.imaging_model()
    rng = np.random.default_rng(0)
    still = np.zeros((case.markers.count, 6))
    lost, wrong, why = 0, 0, ""
    for state in (False, True):
        bits = np.full(case.markers.count, state)
        try:
            matched, on, _ = locate_markers(model.nominal, model.frame(still, bits, 1.0, rng))
        except InputError as error:
            lost, why = lost + case.markers.count, str(error)
            continue
        lost += int((~matched.found).sum())
        wrong += int(((on != bits) & model.nominal.tips.readable).sum())
    blur = [eye.blur for eye in model.cameras]
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


def points_and_frames(table: Table, case: CameraCase, count: int) -> None:
    """Displacements of both kinds of points against noise-free frames; noise."""
    name, model = case.design.name, case.imaging_model(samples=SAMPLES)
    if model.status:
        table.add(f"{name}: can be read", 0.0, "-", reference=1.0, source="rest frame",
                  target=">= 1", note=model.status)  # fmt: skip
        return
    both = {
        "paint": model,
        "pixels": case.imaging_model(centroids="pixels", at_rest=model.rest, samples=SAMPLES),
    }
    still, off = np.zeros((case.markers.count, 6)), np.zeros(case.markers.count, dtype=np.bool_)
    zero = model.read(model.frame(still, off)).shift_px
    motions, every = case.pressed(count)
    found: dict[str, list[FloatArray]] = {"paint": [], "pixels": []}
    frames, put_in, wrong, lost = [], [], 0, 0
    for motion, bits in zip(motions, every, strict=True):
        seen = model.read(model.frame(motion, bits))
        frames.append(seen.shift_px - zero)
        wrong += int((seen.bits != bits).sum())
        lost += int((~seen.found).sum())
        exact = model.points(motion, bits).shift_px
        noisy = [
            model.points(motion, bits, rng=np.random.default_rng(k)).shift_px for k in range(DRAWS)
        ]
        put_in.append(np.mean(noisy, axis=0) - exact)  # the noise of a frame is nearly gone
        for kind, own in both.items():
            found[kind].append(own.points(motion, bits).shift_px)
    shift = np.linalg.norm(np.array(frames), axis=2)
    moving = shift > 0.1 * np.nanmax(shift, axis=1, keepdims=True)
    loads = (
        f"{count} samples of one to three contacts of {FORCE_N:g} N, linear shell; greatest shift "
        f"{np.nanmax(shift):.1f} px; frames with lens blur, fall-off, vignetting, without noise; "
        f"{wrong} bits read wrong, {lost} markers not found"
    )
    for kind in both:
        error = np.array(found[kind]) - np.array(frames)
        for which, pick in (("all markers", np.ones_like(moving)), ("that move", moving)):
            whole, noise = rms(error[pick]), rms(np.array(put_in)[pick])
            row = f"{name}: points ({kind}) against frames, {which}: beyond the noise put in"
            source = "frames through the decoder's marker detector"
            note = (
                f"{whole:.3f} px RMS in all, {noise:.3f} of it the marker's place on the "
                f"pixels, which points have as noise; {loads}"
            )
            value = float(np.sqrt(max(whole**2 - noise**2, 0.0)))
            table.add(row, value, "px RMS", 0.0, source, "<= 0.05", note)
    rest = model.at_rest
    given = case.design.camera.noise_centroid_px
    for what, values in (("noise of a frame", rest.noise_px), ("place on pixels", rest.grid_px)):
        row = f"{name}: centroid error, {what}, median of all markers"
        source = "the design's camera.noise_centroid_px"
        note = f"{np.nanmin(values):.2g} to {np.nanmax(values):.2g} px, RMS {rms(values):.2g} px"
        table.add(row, float(np.nanmedian(values)), "px", given, source, note=note)


def own_tips(table: Table, case: CameraCase, prints: tuple[int, ...] = (0, 1, 2)) -> None:
    """Rows of what a red tip does to its own marker beyond what the design foresees."""
    sensor = Sensor.of(case.design, case.surface, case.markers)
    lenses = {"sharp lens": CLEAN, "lens blur": replace(CLEAN, lens_blur=True)}
    for lens, exposure in lenses.items():
        of_design = np.zeros(2)
        for number in prints:
            unit = draw_sensor_instance(sensor, SensorInstanceSection(number=number), seed=0)
            rest = replace(case, unit=unit).imaging_model(exposure).at_rest
            left = rest.tip_bias_px
            of_design = of_design if number else left
            who = f"{case.design.name}, print {number}, {lens}"
            row = f"{who}: shift by a marker's own tip, left over"
            source = "the shift, RMS; a build foresees it with the lens of the design file"
            note = (
                f"{rms(left - of_design):.3f} px RMS if a build foresaw it with this lens; largest "
                f"{np.linalg.norm(left, axis=1).max():.2f} px; unloaded, all tips in and out"
            )
            whole = rms(rest.bundle.tip_bias_px + left)
            table.add(row, rms(left), "px RMS", whole, source, "<= 0.06", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of how the simulated sensor sees."""
    if quick:
        case = CameraCase.of(quarter(load_design("hemisphere")))
        points_and_frames(table, case, 1)
        faults(table, case)
        readable(table, case)
        return
    for name in sorted(shipped_designs()):
        case = CameraCase.of(load_design(name))
        readable(table, case)
        if name in {"cylinder60", "plane", "hemisphere"}:
            points_and_frames(table, case, 3)
        if name == "cylinder60":
            faults(table, case)
            own_tips(table, case)
    two = copy_of(load_design("cylinder60"), camera={"ends": "both"})
    two = two.model_copy(update={"name": "cylinder60 with a camera at both ends"})
    points_and_frames(table, CameraCase.of(two), 2)
