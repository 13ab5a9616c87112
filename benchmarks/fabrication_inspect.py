"""Mistakes planted in rendered assemblies, and what ``phytac inspect`` finds of them.

Mistakes are planted in the scene, as triangles of other parts or in other places; pictures have
the noise of the design's camera, and those of one condition also blur and a shorter exposure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import cv2
import numpy as np

from benchmarks.camera import moved
from benchmarks.harness import Table
from phytac_decoder.camera.camera import Camera
from phytac_decoder.io.sensor_limits import axial_rotation
from phytac_design.design.design_file import load_design
from phytac_design.design.layout_table import ReferenceMarksSection
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.frame_renderer import add_noise, render_frame
from phytac_design.optics.render_scene import (
    FIRST_MARKER,
    RESIN,
    SHELL,
    build_scene,
    paint_owner,
    red_owner,
)
from phytac_design.workflows.inspect_assembly import Inspection, Step, inspect, spot_names
from phytac_shapes.arrays import BoolArray, FloatArray, ImageArray
from phytac_shapes.errors import InputError

THIN = {"blue": "cyan", "green": "yellow"}
"""Unused entry of the table of paints that holds a thin coat of each paint."""
DESIGNS = ("cylinder60", "hemisphere", "examples/uses/handle.toml")
STEPS: tuple[Step, ...] = ("painted", "assembled")
TIP = "tip shows at rest"


class Assembly:
    """A design and the scene of its assembly, in which mistakes are planted.

    Parameters
    ----------
    sensor : Sensor
        The design.
    step : {"painted", "assembled"}
        Without or with switches.
    """

    def __init__(self, sensor: Sensor, step: Step) -> None:
        self.sensor, self.step, self.camera = sensor, step, sensor.cameras[0]
        self.scene = build_scene(sensor, tolerance_mm=tolerance_mm(self.camera, sensor.markers))
        if step == "painted":
            self.scene = self.scene.part_of(np.flatnonzero(red_owner(self.scene.part) < 0))

    def recode(self, own: BoolArray, part: int) -> None:
        """Turn triangles into another part."""
        self.scene = replace(self.scene, part=np.where(own, part, self.scene.part).astype(np.int32))

    def missing(self, marker: int) -> None:
        """Leave the paint of a marker out."""
        self.recode(paint_owner(self.scene.part) == marker, RESIN)

    def without_insert(self, marker: int) -> None:
        """Leave an insert out: its tube is open, and the camera looks through to the wall."""
        scene, radius = self.scene, self.sensor.design.receptor.diameter_outer_mm / 2.0
        _, off = self._along(marker)
        inner = (off < radius + 1e-6)[scene.triangles].all(axis=1)
        self.scene = scene.part_of(np.flatnonzero(~(inner & (scene.triangle_owner == marker))))

    def pushed(self, marker: int, further_mm: float) -> None:
        """Move the end face of an insert along its axis: too long a one, or not pushed home."""
        scene, markers = self.scene, self.sensor.markers
        along, _ = self._along(marker)
        end = (scene.vertex_owner == marker) & (along > markers.height_mm[marker] - 1e-6)
        vertices = scene.vertices.copy()
        vertices[end] += further_mm * markers.direction[marker]
        self.scene = replace(scene, vertices=vertices)

    def _along(self, marker: int) -> tuple[FloatArray, FloatArray]:
        """Distance of all vertices along a receptor's axis from its base, and from the axis."""
        axis = self.sensor.markers.direction[marker]
        arm = self.scene.vertices - self.sensor.markers.base_mm[marker]
        along = arm @ axis
        return along, np.linalg.norm(arm - along[:, None] * axis, axis=1)

    def swapped(self, marker: int) -> None:
        """Paint a marker with the other colour."""
        colour = self.scene.colour.copy()
        colour[marker] = (colour[marker] + 1) % len(self.scene.paints)
        self.scene = replace(self.scene, colour=colour)

    def half(self, marker: int, part: int = RESIN) -> None:
        """Paint only one half of a marker, left of its axis as the camera sees it.

        The other half is resin, or the paint of another marker.
        """
        tip = self.sensor.markers.tip_mm[marker]
        ray, axis = tip - self.camera.position_mm, self.sensor.markers.direction[marker]
        aside = (self.scene.vertices[self.scene.triangles].mean(axis=1) - tip) @ np.cross(ray, axis)
        self.recode((paint_owner(self.scene.part) == marker) & (aside > 0.0), part)

    def weak(self, marker: int) -> None:
        """Paint a marker with a coat through which half of the resin shows."""
        scene, paint = self.scene, self.scene.paints[self.scene.colour[marker]]
        name, mixed = THIN[paint], (getattr(scene.table, each) for each in (paint, "resin"))
        rgb = tuple(round(sum(pair) / 2.0) for pair in zip(*mixed, strict=True))
        paints = scene.paints if name in scene.paints else (*scene.paints, name)
        colour = scene.colour.copy()
        colour[marker] = paints.index(name)
        table = scene.table.model_copy(update={name: rgb})
        self.scene = replace(scene, paints=paints, colour=colour, table=table)

    def blot(self, marker: int) -> None:
        """Cover a marker's end face and hole with a square of paint, wider than the tube."""
        tip, axis = self.sensor.markers.tip_mm[marker], self.sensor.markers.direction[marker]
        first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        first *= 0.65 * self.sensor.design.receptor.diameter_outer_mm / np.linalg.norm(first)
        second, middle = np.cross(axis, first), tip + 0.02 * axis
        corners = [middle + i * first + j * second for i in (-1, 1) for j in (-1, 1)]
        self.add(np.array(corners), marker)

    def beside(self, marker: int, avoid: Sequence[int], *, alike: bool) -> int:
        """Nearest other marker of the same colour, or of another one."""
        markers = self.sensor.markers
        gap = np.linalg.norm(markers.tip_mm - markers.tip_mm[marker], axis=1)
        gap[(markers.colour == markers.colour[marker]) != alike] = np.inf
        gap[[marker, *avoid]] = np.inf
        return int(gap.argmin())

    def dab(self, marker: int, avoid: Sequence[int]) -> None:
        """Paint half of a marker in the colour of another one."""
        self.half(marker, FIRST_MARKER + 2 * self.beside(marker, avoid, alike=False))

    def bridge(self, first: int, avoid: Sequence[int]) -> int:
        """Paint a strip from a marker's end face to the next one of its colour; its number."""
        second = self.beside(first, avoid, alike=True)
        tip, axis = self.sensor.markers.tip_mm, self.sensor.markers.direction
        along = tip[second] - tip[first]
        across = np.cross(axis[first], along / np.linalg.norm(along))
        half = 0.3 * self.sensor.design.receptor.diameter_outer_mm * across
        lift = 0.02 * (axis[first] + axis[second])
        ends = [tip[first] + lift, tip[second] + lift]
        self.add(np.array([ends[0] - half, ends[0] + half, ends[1] - half, ends[1] + half]), first)
        return second

    def add(self, corners: FloatArray, marker: int) -> None:
        """Add a rectangle of a marker's paint, corners (4, 3)."""
        scene, start = self.scene, len(self.scene.vertices)
        faces = start + np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int32)
        self.scene = replace(
            scene,
            vertices=np.concatenate([scene.vertices, corners]),
            triangles=np.concatenate([scene.triangles, faces]).astype(np.int32),
            closed=False,
            part=np.append(scene.part, np.full(2, FIRST_MARKER + 2 * marker)).astype(np.int32),
            vertex_owner=np.append(scene.vertex_owner, np.full(4, marker)).astype(np.int32),
        )

    def tip(self, marker: int, out_mm: float) -> None:
        """Move a red tip out of its hole: a stem that is too long, or a switch pushed in."""
        own = np.unique(self.scene.triangles[red_owner(self.scene.part) == marker])
        vertices = self.scene.vertices.copy()
        vertices[own] += out_mm * self.sensor.markers.direction[marker]
        self.scene = replace(self.scene, vertices=vertices)

    def no_mark(self, mark: int) -> None:
        """Leave a reference mark out."""
        self.recode(self.scene.part == -1 - mark, SHELL)

    def photo(self, *, disturb: bool, seed: int, camera: Camera | None = None) -> ImageArray:
        """Photo with noise; disturbed: blurred by 1 px, 0.85 of the exposure, twice the noise."""
        noise = self.sensor.design.camera.noise_pixel
        rng = np.random.default_rng([11, seed])
        frame = render_frame(self.scene, camera or self.camera)
        if not disturb:
            return add_noise(frame, noise, rng)
        soft = 0.85 * cv2.GaussianBlur(frame, (0, 0), 1.0).astype(np.float64)
        return add_noise(np.clip(np.rint(soft), 0, 255).astype(np.uint8), 2.0 * noise, rng)


@dataclass(frozen=True, kw_only=True)
class Planted:
    """One planted mistake.

    Attributes
    ----------
    name : str
        What was done.
    spots : tuple of int
        Spots of which at least one must be reported.
    fault : str
        Kind of mistake that it is.
    """

    name: str
    spots: tuple[int, ...]
    fault: str


def plant(assembly: Assembly) -> list[Planted]:
    """Plant all mistakes of a step, far from each other: 12 of paint, 8 more of tips.

    A design with reference marks lacks one of them as well.
    """
    markers = assembly.sensor.markers
    # Towards the pole of a dome a camera sees tips alike whether they are in or out.
    ids = np.linspace(0, 0.85 * markers.count, 22).astype(int)[1:-1].tolist()
    kinds: list[tuple[Callable[[int], int | None], int, str, str]] = [
        (assembly.missing, 3, "no paint", "missing"),
        (assembly.swapped, 2, "other colour", "wrong colour"),
        (assembly.half, 2, "half painted", "too small"),
        (assembly.weak, 2, "thin coat", "weak colour"),
        (assembly.blot, 1, "blot over hole and rim", "too large"),
        (partial(assembly.bridge, avoid=ids), 1, "strip to a neighbour", "runs into a neighbour"),
        (partial(assembly.dab, avoid=ids), 1, "half in another colour", "other paint on it"),
    ]
    if assembly.step == "assembled":
        stroke = assembly.sensor.design.switch.stroke_mm
        for share, name in ((1.0, "switch pushed in"), (0.7, "stem too long by 0.7 strokes")):
            kinds.append((partial(assembly.tip, out_mm=share * stroke), 4, name, TIP))
    spots, out = iter(ids), []
    for act, count, name, fault in kinds:
        for spot in islice(spots, count):
            second = act(spot)
            places = (spot,) if second is None else (spot, second)
            out.append(Planted(name=name, spots=places, fault=fault))
    if assembly.sensor.reference_marks.count:
        assembly.no_mark(3)
        out.append(Planted(name="no mark", spots=(markers.count + 3,), fault="missing"))
    return out


def judge(
    sensor: Sensor, planted: Sequence[Planted], result: Inspection
) -> tuple[list[str], list[str]]:
    """Planted mistakes that were not found, or not as what they are, and those invented."""
    names = spot_names(sensor)
    reported = {(one.place, one.fault) for one in result.mistakes}
    missed = [
        f"{one.name} at {names[one.spots[0]]}"
        for one in planted
        if not any((names[spot], one.fault) in reported for spot in one.spots)
    ]
    places = {names[spot] for one in planted for spot in one.spots}
    return missed, [
        f"{fault} at {place}" for place, fault in sorted(reported) if place not in places
    ]


def add_planted(table: Table, sensor: Sensor, step: Step) -> None:
    """Rows of a clean assembly and one with all mistakes of a step, both also disturbed."""
    label = f"inspect {sensor.design.name}, {step}"
    clean, faulty = Assembly(sensor, step), Assembly(sensor, step)
    planted = plant(faulty)
    for disturbed in (False, True):
        how = "mild picture fault" if disturbed else "noise of the camera"
        nothing = inspect(sensor, [clean.photo(disturb=disturbed, seed=1)], step)
        result = inspect(sensor, [faulty.photo(disturb=disturbed, seed=2)], step)
        missed, invented = judge(sensor, planted, result)
        note = "; ".join(missed) or f"{len(planted)} planted in one photo, each named as planted"
        table.goal(f"{label}, {how}: planted mistakes missed", len(missed), "", "== 0", note=note)
        invented += [f"clean: {one.fault} at {one.place}" for one in nothing.mistakes]
        note = "; ".join(invented) or "in that photo and in one of a clean assembly"
        table.goal(f"{label}, {how}: mistakes invented", len(invented), "", "== 0", note=note)


def add_whole(table: Table, sensor: Sensor) -> None:
    """Rows of faults of the whole picture: one report each, or one refusal."""
    assembly, camera = Assembly(sensor, "assembled"), sensor.cameras[0]
    turn = axial_rotation(1.0 / sensor.design.layout.columns)
    turned = replace(camera, position_mm=camera.position_mm @ turn, rotation=camera.rotation @ turn)
    shifted = moved(camera, np.array([0.8, 0.0, 0.0]), np.array([0.0, 0.8, 0.0]), 0.0)
    near = moved(camera, np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.1, 0.0]), 0.0)
    for what, through, expected in (
        ("shell turned by one column", turned, ["shell turned"]),
        ("camera shifted by 0.8 mm and tilted by 0.8 degrees", shifted, ["camera moved"]),
        ("camera shifted by 0.1 mm and tilted by 0.1 degrees", near, []),
    ):
        photo = assembly.photo(disturb=False, seed=3, camera=through)
        faults = [one.fault for one in inspect(sensor, [photo], "assembled").mistakes]
        table.goal(
            f"inspect {sensor.design.name}, {what}: other reports than {expected}",
            float(faults != expected),
            "",
            "== 0",
            note=", ".join(faults[:5]) or "nothing reported",
        )
    size = (camera.width_px, camera.height_px)
    other = Assembly(Sensor(load_design("hemisphere")), "assembled").photo(disturb=False, seed=4)
    for what, photo in (
        ("photo of hemisphere", cv2.resize(other, size, interpolation=cv2.INTER_AREA)),
        ("black picture", np.zeros((size[1], size[0], 3), dtype=np.uint8)),
    ):
        try:
            inspect(sensor, [photo], "assembled")
            code = ""
        except InputError as error:
            code = error.code
        case = f"inspect {sensor.design.name}, {what}: not refused"
        table.goal(case, float(not code), "", "== 0", note=code)


def add_rows(table: Table, *, quick: bool) -> None:
    """Add the rows of all designs; ``quick`` takes the smallest picture alone."""
    for name in DESIGNS[-1:] if quick else DESIGNS:
        design = load_design(name)
        if name == "cylinder60":
            marks = ReferenceMarksSection(count=12)
            design = design.model_copy(update={"reference_marks": marks})
        sensor = Sensor(design)
        for step in STEPS:
            add_planted(table, sensor, step)
        if design.layout.columns and name != "hemisphere":
            add_whole(table, sensor)
