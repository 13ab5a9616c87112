"""What cameras see: ID maps against Embree rays, lenses, growth, layouts, extreme designs.

``python -m benchmarks.visibility [--quick] [--parts maps,lenses,growth,layouts,extremes]``
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from benchmarks import visibility_growth, visibility_layouts, visibility_lenses
from benchmarks.harness import Table, run_parts
from benchmarks.visibility_lenses import busy
from phytac_decoder.camera.camera import Camera
from phytac_design.design.design_file import load_design
from phytac_design.design.spec import Design
from phytac_design.layout import Markers, make_markers
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.layout.sensor import Sensor
from phytac_design.optics.density import density_of
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import RenderScene, build_scene
from phytac_design.optics.visibility import Visibility, check_visibility

CHUNK = 500_000
STUDY = "design study of this sensor"


def with_layout(design: Design, kind: str) -> Design:
    """Copy of a design with another layout."""
    layout = design.layout.model_copy(update={"kind": kind})
    return design.model_copy(update={"layout": layout})


def smaller(design: Design, factor: int) -> Design:
    """Copy of a design with ``factor`` times fewer pixels each way."""
    camera = design.camera
    update = {
        "width_px": camera.width_px // factor,
        "height_px": camera.height_px // factor,
        "focal_px": camera.focal_px / factor,
    }
    return design.model_copy(update={"camera": camera.model_copy(update=update)})


def scene_of(design: Design) -> tuple[RenderScene, Camera, Markers]:
    """Scene (every fifth switch on), camera and markers of a design."""
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    on = np.arange(markers.count) % 5 == 0
    tolerance = tolerance_mm(camera, markers)
    scene = build_scene(Sensor.of(design, surface, markers), tolerance_mm=tolerance, switch_on=on)
    return scene, camera, markers


def embree_tree(scene: RenderScene) -> rtcore_scene.EmbreeScene:
    """Embree's tree of a scene."""
    tree = rtcore_scene.EmbreeScene()
    TriangleMesh(tree, scene.vertices[scene.triangles].astype(np.float32))
    return tree


def pixel_rays(camera: Camera) -> NDArray[np.float32]:
    """One ray direction per pixel centre, row by row, (h w, 3)."""
    y, x = np.indices((camera.height_px, camera.width_px))
    return camera.rays(np.column_stack([x.ravel(), y.ravel()])).astype(np.float32)


def traced(
    tree: rtcore_scene.EmbreeScene, rays: NDArray[np.float32], camera: Camera
) -> NDArray[np.int32]:
    """Triangle that each ray from the camera hits first, (h, w); -1 for none."""
    start = np.tile(camera.position_mm.astype(np.float32), (CHUNK, 1))
    parts = [rays[i : i + CHUNK] for i in range(0, len(rays), CHUNK)]
    hits = [np.asarray(tree.run(start[: len(part)], part), dtype=np.int32) for part in parts]
    return np.concatenate(hits).reshape(camera.height_px, camera.width_px)


def id_map(scene: RenderScene, triangle: NDArray[np.int32]) -> NDArray[np.int32]:
    """Part code of each pixel from its triangle."""
    return np.where(triangle >= 0, scene.part[np.maximum(triangle, 0)], 0)


def compare_with_embree(table: Table, design: Design, repeats: int) -> None:
    """Same IDs on every pixel, and how much faster; timed in turn, medians."""
    scene, camera, _ = scene_of(design)
    tree, rays = embree_tree(scene), pixel_rays(camera)
    ours = rasterise(scene, camera).part
    differs = int((id_map(scene, traced(tree, rays, camera)) != ours).sum())
    label = f"{design.name} {camera.width_px}x{camera.height_px}"
    row = f"{label}: pixels with the same ID"
    note = f"{differs} of {ours.size} pixels differ"
    value = 100.0 * (1.0 - differs / ours.size)
    table.add(
        row,
        value,
        "%",
        100.0,
        "Embree 4 (embreex), one float32 ray per pixel centre",
        ">= 99.99",
        note,
    )
    works: list[Callable[[], object]] = [
        lambda: rasterise(scene, camera),
        lambda: id_map(scene, traced(tree, pixel_rays(camera), camera)),
        lambda: traced(tree, rays, camera),
    ]
    times = np.array([[timed(work) for work in works] for _ in range(repeats)])
    own, whole, bare = (float(t) for t in np.median(times, axis=0))
    source = "Embree (embreex), tree built before; the z-buffer on all threads"
    table.add(f"{label}: ID map", own, "s", whole, source, "<= 0.3", busy())
    row = f"{label}: times faster than Embree"
    note = (
        "both from scene and camera to an ID map; of Embree's time "
        f"{whole - bare:.2f} s make the rays (numpy) and look the hits up, {bare:.2f} s trace"
    )
    table.add(row, whole / own, "ratio", 1.0, source, ">= 10", note)
    row = f"{label}: times faster than Embree's tracing alone"
    note = (
        "Embree is given ready-made rays and its hits are not looked up; it spends about "
        f"0.1 us a ray, the z-buffer is bound by 150 000 triangles and 80 MB of buffers; {busy()}"
    )
    table.add(row, bare / own, "ratio", 1.0, source, ">= 10", note)


def timed(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def at_rest(table: Table, design: Design) -> None:
    """Spiral and straight with the same counts: hidden, fused, gaps."""
    targets: dict[str, dict[str, str]] = {
        "spiral": {"occluded": "== 0", "fused": "== 0"},
        "straight": {},
    }
    references: dict[tuple[str, str], float | str] = {
        ("spiral", "occluded"): 0,
        ("spiral", "fused"): 0,
        ("spiral", "min_gap_px"): "4-5",
        ("straight", "fused"): "116-316",
    }
    units = {"min_visible_fraction": "ratio", "occluded": "markers", "fused": "markers"}
    for kind, wanted in targets.items():
        varied = with_layout(design, kind)
        surface = varied.surface()
        markers = make_markers(varied, surface)
        seen = check_visibility(Sensor.of(varied, surface, markers), rng=np.random.default_rng(0))
        for name, value in seen.summary().items():
            row = f"{varied.name} {kind}: {name}"
            source = STUDY if (kind, name) in references else "not published"
            target = wanted.get(name)
            reference = references.get((kind, name), "none")
            table.add(row, value, units.get(name, "px"), reference, source, target)
        hidden_rows(table, f"{varied.name} {kind}", seen, markers)


def hidden_rows(table: Table, label: str, seen: Visibility, markers: Markers) -> None:
    """Where a layout is worst."""
    worst = int(seen.visible_fraction.argmin())
    row = f"{label}: row of the least visible fraction"
    source = "not published"
    note = "row 0 is nearest the camera"
    table.add(row, int(markers.row[worst]), "row", "none", source, note=note)


def maps(table: Table, *, quick: bool) -> None:
    """The published cylinder: ID map, what is hidden and fused at rest, density, frame."""
    full = load_design("cylinder60")
    design = smaller(full, 4) if quick else full
    compare_with_embree(table, design, repeats=1 if quick else 5)
    at_rest(table, design)
    surface = design.surface()
    density = density_of(surface, make_markers(design, surface))
    row = f"{design.name}: density on a surface {density.surface_class} to the optical axis"
    note = f"{density.count} markers on {density.area_cm2:.1f} cm2, outer face"
    table.add(row, density.per_cm2, "1/cm2", 1.63, "paper", "<= 1.64", note)
    scene, camera, _ = scene_of(design)
    render_frame(scene, camera)
    noise = np.random.default_rng(0)
    row = f"{design.name}: noisy anti-aliased frame"
    note = f"8 samples per pixel; {busy()}"
    value = timed(lambda: render_frame(scene, camera, noise_std=2.0, rng=noise))
    table.add(row, value, "s", "none", "own target", "<= 1.5", note)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""
    return {
        "maps": partial(maps, quick=quick),
        "lenses": partial(visibility_lenses.add_rows, quick=quick),
        "growth": partial(visibility_growth.add_rows, quick=quick),
        "layouts": partial(visibility_layouts.add_rows, quick=quick),
    }


if __name__ == "__main__":
    run_parts("visibility", parts, __doc__ or "")
