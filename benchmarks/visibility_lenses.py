"""Lenses: ID maps of all designs against Embree, and the sampled path; rows of ``visibility``."""

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from benchmarks.harness import Table
from phytac_decoder.camera.camera import Camera
from phytac_design.design.design_file import load_design, parse_design, shipped_designs
from phytac_design.design.spec import CameraSection, Design
from phytac_design.layout.cameras import tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.raster import pixels_alone, rasterise
from phytac_design.optics.rays import pixel_rays
from phytac_design.optics.render_scene import RenderScene, build_scene, paint_owner
from phytac_design.optics.sampled_visibility import sampled_fraction
from phytac_design.stages.build import copy_of
from phytac_shapes.arrays import FloatArray

CHUNK = 500_000
EMBREE = "Embree 4 (embreex), one float32 ray per pixel centre"
CAMERAS: dict[str, dict[str, Any]] = {
    "pinhole": {},
    "brown_conrady": {
        "model": "brown_conrady",
        "distortion": [-0.28, 0.09, 1e-3, -5e-4, -0.012],
        "stand_off_mm": 30.0,
    },
    "kannala_brandt": {
        "model": "kannala_brandt",
        "distortion": [-0.01, 0.003, -0.002, 0.0003],
        "focal_px": 620.0,
        "stand_off_mm": 15.0,
    },
    "omnidirectional": {
        "model": "omnidirectional",
        "distortion": [1.2, -0.2, 0.05, 1e-3, -2e-3],
        "focal_px": 1500.0,
        "stand_off_mm": 12.0,
    },
}
"""One lens of each model before the ø60 x 120 cylinder, 2592x1944."""


def make(camera: dict[str, Any], *, factor: int = 1, **tables: Any) -> Design:
    """Published cylinder before a camera with ``factor`` times fewer pixels each way."""
    focal = float(camera.get("focal_px", 970.0)) / factor
    size = {"width_px": 2592 // factor, "height_px": 1944 // factor, "focal_px": focal}
    shape = {"kind": "cylinder", "diameter_outer_mm": 60.0, "length_mm": 120.0}
    data: dict[str, Any] = {"name": "lens", "shape": shape, "camera": camera | size}
    return parse_design(data | tables, "benchmark")


def scene_at(design: Design) -> tuple[RenderScene, Camera]:
    """Scene at rest before the design's first camera."""
    sensor = Sensor(design)
    camera = sensor.cameras[0]
    return build_scene(sensor, tolerance_mm=tolerance_mm(camera, sensor.markers)), camera


class Rays:
    """Embree on a scene: its tree, and the rays of all pixels that the lens can image."""

    def __init__(self, scene: RenderScene, camera: Camera) -> None:
        self.tree = rtcore_scene.EmbreeScene()
        TriangleMesh(self.tree, scene.vertices[scene.triangles].astype(np.float32))
        self.scene, self.camera = scene, camera
        # Directions of all pixels from the project's table: fast, and the same for both.
        table = pixel_rays(camera.lens).reshape(-1, 3)
        self.seen = np.isfinite(table[:, 0])
        self.rays = (table[self.seen] @ camera.rotation).astype(np.float32)

    def trace(self) -> NDArray[np.int32]:
        """Triangle that each of those rays meets first; -1 for none."""
        start = np.tile(self.camera.position_mm.astype(np.float32), (CHUNK, 1))
        parts = [self.rays[i : i + CHUNK] for i in range(0, len(self.rays), CHUNK)]
        hits = [np.asarray(self.tree.run(start[: len(part)], part)) for part in parts]
        return np.concatenate(hits).astype(np.int32)

    def parts(self) -> NDArray[np.int32]:
        """ID map from ready rays."""
        hit = self.trace()
        out = np.zeros(len(self.seen), dtype=np.int32)
        out[self.seen] = np.where(hit >= 0, self.scene.part[np.maximum(hit, 0)], 0)
        return out.reshape(self.camera.height_px, self.camera.width_px)


def busy() -> str:
    """Say how busy the machine is: with more work than cores all seconds are too long."""
    return f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"


def seconds(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def in_turn(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Median seconds of each work, run in turn after one warm-up each."""
    for work in works:
        work()
    times = np.array([[seconds(work) for work in works] for _ in range(repeats)])
    return [float(t) for t in np.median(times, axis=0)]


def maps(table: Table, name: str, design: Design, repeats: int) -> None:
    """ID map of one lens against Embree: same IDs, and how much faster."""
    scene, camera = scene_at(design)
    embree = Rays(scene, camera)
    ours = rasterise(scene, camera).part
    differs = int((embree.parts() != ours).sum())
    label = f"{name} {camera.width_px}x{camera.height_px}"
    row = f"{label}: pixels with the same ID"
    note = f"{differs} of {ours.size} pixels differ"
    table.add(row, 100.0 * (1.0 - differs / ours.size), "%", 100.0, EMBREE, ">= 99.99", note)

    own, ready = in_turn([lambda: rasterise(scene, camera), embree.parts], repeats)
    row = f"{label}: ID map, times faster than Embree with rays ready for both"
    note = (
        f"ours {own:.3f} s on all threads, Embree {ready:.3f} s (embreex runs on one); 0.1 to "
        "0.2 us a ray leave little to win where it is given its rays and its tree; " + busy()
    )
    table.add(row, ready / own, "ratio", 1.0, EMBREE, ">= 10", note)


def exact_fraction(scene: RenderScene, camera: Camera) -> FloatArray:
    """Visible fraction of every marker from the whole ID map."""
    owner = paint_owner(rasterise(scene, camera).part)
    visible = np.bincount(owner[owner >= 0], minlength=scene.count)
    alone = pixels_alone(scene, camera)
    return np.divide(visible, alone, out=np.zeros(scene.count), where=alone > 0)


def sampled(table: Table, name: str, kind: str, design: Design, repeats: int) -> None:
    """Sampled fraction against the exact one, and against a ray for each pixel."""
    scene, camera = scene_at(design)
    near_exact(table, f"{name} {kind}", scene, camera)
    embree = Rays(scene, camera)

    own, ready = in_turn([lambda: sampled_fraction(scene, camera), embree.parts], repeats)
    row = (
        f"{name} {kind}: sampled path, times faster than Embree on every pixel, with rays ready "
        "for both"
    )
    note = (
        f"ours {own:.3f} s on all threads, Embree {ready:.3f} s (embreex runs on one) with its "
        "tree built before; every triangle is projected once, however few its rays; " + busy()
    )
    table.add(row, ready / own, "ratio", 1.0, EMBREE, ">= 20", note)


def shipped(table: Table, name: str) -> None:
    """ID maps of a shipped design against Embree: its own lens, and one of every model there."""
    design = load_design(name)
    scene, own = scene_at(design)
    lenses = {"its own lens": own.lens}
    for model, wanted in CAMERAS.items():
        focal = float(wanted.get("focal_px", 970.0)) * own.width_px / 2592.0
        size = {"width_px": own.width_px, "height_px": own.height_px, "focal_px": focal}
        lenses[model] = CameraSection.model_validate(wanted | size).lens()
    for model, lens in lenses.items():
        camera = replace(own, lens=lens)
        ours = rasterise(scene, camera).part
        differs = int((Rays(scene, camera).parts() != ours).sum())
        row = f"{name}, {model}, {own.width_px}x{own.height_px}: pixels with the same ID"
        note = (
            f"{differs} of {ours.size} pixels differ; {100.0 * np.mean(ours > 0):.0f} % of "
            "them show the sensor"
        )
        table.add(row, 100.0 * (1.0 - differs / ours.size), "%", 100.0, EMBREE, ">= 99.99", note)


def near_exact(table: Table, label: str, scene: RenderScene, camera: Camera) -> None:
    """Share of the markers whose sampled fraction is near the exact one."""
    exact, few = exact_fraction(scene, camera), sampled_fraction(scene, camera)
    row = f"{label}: markers whose sampled visible fraction is within 0.02 of the exact"
    source = "own exact ID map"
    note = (
        f"64 rays a marker requested, {few.alone.mean():.0f} cast on average; "
        f"{int((exact < 0.99).sum())} of {scene.count} markers partly hidden"
    )
    value = 100.0 * float(np.mean(np.abs(few.fraction - exact) <= 0.02))
    table.add(row, value, "%", 100.0, source, ">= 99", note)


def add_rows(table: Table, *, quick: bool) -> None:
    """Rows of lenses for the table of ``benchmarks.visibility``."""
    factor, repeats = (4, 1) if quick else (1, 3)
    for name, camera in CAMERAS.items():
        design = make(camera, factor=factor)
        maps(table, name, design, repeats)
        for kind in ("spiral", "straight"):
            if name in ("pinhole", "kannala_brandt"):
                varied = make(camera, factor=factor, layout={"kind": kind})
                sampled(table, name, kind, varied, repeats)
    straight = {"kind": "straight", "heights": "linear"}
    dense = copy_of(load_design("cylinder60-dense"), layout=straight)
    near_exact(table, "cylinder60-dense, but straight", *scene_at(dense))
    names = ["hemisphere"] if quick else sorted(shipped_designs())
    for name in names:
        near_exact(table, name, *scene_at(load_design(name)))
        shipped(table, name)
