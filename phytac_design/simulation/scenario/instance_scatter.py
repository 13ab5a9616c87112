"""Drawing one sensor instance: how it differs from its design."""

from dataclasses import replace

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.layout import Markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.layout.heights import directions
from phytac_design.layout.marker_layout import with_heights
from phytac_design.layout.sensor import Sensor
from phytac_design.simulation.contacts import tangent_step
from phytac_design.simulation.scenario.random_streams import RandomStream, random_stream
from phytac_design.simulation.scenario.scenario_file import SensorInstanceSection
from phytac_design.simulation.sensor_instance import SensorInstance, ThicknessField
from phytac_design.simulation.switch_law import switch_law
from phytac_shapes import Surface
from phytac_shapes.arrays import FloatArray


def draw_sensor_instance(
    sensor: Sensor, section: SensorInstanceSection, seed: int
) -> SensorInstance:
    """Draw one virtual print; the same for the same seed and number.

    Each property has a stream of random numbers of its own, so that changing one standard
    deviation changes nothing else.

    Parameters
    ----------
    sensor : Sensor
        The sensor.
    section : SensorInstanceSection
        Number of the print and standard deviations; number 0 is the design itself.
    seed : int
        Seed of the scenario.
    """
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    scatter = 0.0 if section.number == 0 else 1.0

    def normal(which: RandomStream, *shape: int) -> FloatArray:
        return cut_normal(random_stream(seed, which, section.number), *shape)

    def factor(which: RandomStream, sd: float, *shape: int) -> FloatArray:
        return np.asarray(1.0 + scatter * sd * normal(which, *shape))

    count, cameras = markers.count, cameras_of(design, surface)
    law = switch_law(design, markers)
    on = law.on_N * factor(RandomStream.THRESHOLD, section.threshold_share, count)
    ratio = (
        design.switch.release_N / design.switch.threshold_N
        if section.release_share is None
        else section.release_share
    )
    off = ratio * on * factor(RandomStream.RELEASE, section.release_scatter, count)
    # Switches that do not snap have no hysteresis.
    off = np.where(law.gradual, on, off)
    return SensorInstance(
        number=section.number,
        markers=_moved(
            sensor,
            step_mm=scatter * section.marker_mm * normal(RandomStream.MARKER, count, 2),
            taller_mm=scatter * section.height_mm * normal(RandomStream.HEIGHT, count),
        ),
        wall=_wall(surface, section, seed),
        modulus=float(factor(RandomStream.MODULUS, section.modulus_share, 1)[0]),
        on_N=on,
        off_N=np.minimum(off, on),
        cameras=tuple(
            _mounted(
                camera,
                step_mm=scatter * section.camera_mm * z[:3],
                turn_rad=scatter * np.radians(section.camera_deg) * z[3:6],
                focal=1.0 + scatter * section.focal_share * float(z[6]),
            )
            for camera, z in (
                (camera, normal(place, 7))
                for camera, place in zip(
                    cameras, (RandomStream.NEAR_CAMERA, RandomStream.FAR_CAMERA), strict=False
                )
            )
        ),
        law=law if law.gradual.any() else None,
        paint=factor(RandomStream.PAINT, section.paint_share, len(design.layout.colours) + 1, 3),
    )


def cut_normal(rng: np.random.Generator, *shape: int) -> FloatArray:
    """Draw standard normal variates, none beyond three standard deviations."""
    # Normal variates are cut at so many standard deviations: no print is beyond reason.
    cut_sd = 3.0
    from scipy.special import ndtr, ndtri

    low = ndtr(-cut_sd)
    return np.asarray(ndtri(low + (1.0 - 2.0 * low) * rng.random(shape)))


def _wall(surface: Surface, section: SensorInstanceSection, seed: int) -> ThicknessField:
    """Thickness of one print: a factor of the whole, and long waves of random phase.

    Waves are whole around closed axes. Towards a pole, where all v meet, they do not depend on v
    and end with slope zero, so that the wall is smooth there.
    """
    if section.number == 0:
        return ThicknessField.even(surface)
    # Waves, and most cycles of one along an axis; part of what a seed stands for.
    waves, cycles_max = 6, 3
    rng = random_stream(seed, RandomStream.WAVE, section.number)
    steps = np.where(surface.periodic, 1.0, 0.5)
    most = np.array([cycles_max, 0 if any(surface.poles) else cycles_max])
    grid = np.stack(
        np.meshgrid(*(np.arange(0.0, m + 0.25, s) for m, s in zip(most, steps, strict=True))), -1
    ).reshape(-1, 2)
    known = grid[np.any(grid > 0.0, axis=1)]
    cycles = known[rng.permutation(len(known))[:waves]]
    phase = rng.uniform(0.0, 2.0 * np.pi, len(cycles))
    if any(surface.poles):
        pole = 1.0 if surface.poles[1] else 0.0
        phase = np.pi * np.round(phase / np.pi) - 2.0 * np.pi * pole * cycles[:, 0]
    size = section.thickness_wave_share * np.sqrt(2.0 / len(cycles))
    mean = float(cut_normal(random_stream(seed, RandomStream.THICKNESS, section.number), 1)[0])
    return ThicknessField(
        mean=1.0 + section.thickness_share * mean,
        waves=np.column_stack([np.full(len(cycles), size), cycles, phase]),
        domain=surface.domain,
    )


def _moved(sensor: Sensor, *, step_mm: FloatArray, taller_mm: FloatArray) -> Markers:
    """Markers moved along and around the wall by (n, 2) mm, within open edges, and taller by (n,).

    Rows, columns, colours and neighbours stay; a lattice that is no longer exact goes.
    """
    height_share_min = 0.2  # a receptor keeps at least this share of its height
    design, surface, markers = sensor.design, sensor.surface, sensor.markers
    out = markers
    if step_mm.any():
        uv = tangent_step(surface, markers.uv, step_mm)
        # A receptor of a face that senses stays on it.
        uv = np.where(surface.sensing(uv)[:, None], uv, markers.uv)
        normal = surface.normal(uv)
        direction = directions(design, surface, uv, normal)
        wall = design.wall.thickness_mm
        mid = surface.point(uv, -wall / 2.0)
        if design.receptor.direction == "normal":
            foot = surface.point(uv, -wall)
        else:
            cosine = -np.sum(direction * normal, axis=1)
            foot = mid + (wall / 2.0 / cosine)[:, None] * direction
        out = replace(
            markers,
            uv=uv,
            normal=normal,
            direction=direction,
            mid_mm=mid,
            base_mm=foot,
            lattice=None,
        )
    if out is markers and not taller_mm.any():
        return markers
    height = np.maximum(markers.height_mm + taller_mm, height_share_min * markers.height_mm)
    return with_heights(design, surface, out, height)


def _mounted(camera: Camera, *, step_mm: FloatArray, turn_rad: FloatArray, focal: float) -> Camera:
    """Camera moved by (3,) mm, turned by a rotation vector (3,) in its own axes, refocused."""
    from scipy.spatial.transform import Rotation

    lens = camera.lens
    if focal != 1.0:
        lens = replace(lens, fx_px=focal * lens.fx_px, fy_px=focal * lens.fy_px)
    turn = Rotation.from_rotvec(turn_rad).as_matrix() if turn_rad.any() else np.eye(3)
    return replace(
        camera,
        lens=lens,
        position_mm=camera.position_mm + step_mm,
        rotation=turn @ camera.rotation,
    )
