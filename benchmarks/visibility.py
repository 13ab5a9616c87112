"""The exact ID map against Embree rays, and spiral against straight on the published cylinder.

``python -m benchmarks.visibility [--quick]``
"""

import time
from collections.abc import Callable

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from numpy.typing import NDArray

from benchmarks.harness import Table, arguments
from decoder.camera import PinholeCamera
from phytac_design.design_file import load_design
from phytac_design.layout import Markers, make_markers
from phytac_design.optics.density import density_of
from phytac_design.optics.frame import render_frame
from phytac_design.optics.raster import rasterise
from phytac_design.optics.scene import Scene, build_scene
from phytac_design.optics.view import camera_of, tolerance_mm
from phytac_design.optics.visibility import Visibility, check_visibility
from phytac_design.spec import Design

CHUNK = 500_000
STUDY = "DESIGN.md §2 study"


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


def scene_of(design: Design) -> tuple[Scene, PinholeCamera, Markers]:
    """Scene (every fifth switch on), camera and markers of a design."""
    surface = design.surface()
    markers = make_markers(design, surface)
    camera = camera_of(design, surface)
    on = np.arange(markers.count) % 5 == 0
    tolerance = tolerance_mm(camera, markers)
    scene = build_scene(design, surface, markers, tolerance_mm=tolerance, switch_on=on)
    return scene, camera, markers


def embree_rays(scene: Scene, camera: PinholeCamera) -> Callable[[], NDArray[np.int32]]:
    """Build Embree's tree and all rays; the call traces them, one per pixel centre.

    Returns the triangle of each pixel, -1 for none. Building and making rays are left out of the
    time, to Embree's favour.
    """
    tree = rtcore_scene.EmbreeScene()
    TriangleMesh(tree, scene.vertices[scene.triangles].astype(np.float32))
    shape = (camera.height_px, camera.width_px)
    y, x = np.indices(shape)
    rays = camera.rays(np.column_stack([x.ravel(), y.ravel()])).astype(np.float32)
    start = np.broadcast_to(camera.position_mm.astype(np.float32), rays.shape)

    def trace() -> NDArray[np.int32]:
        parts = [
            np.asarray(
                tree.run(np.ascontiguousarray(start[i : i + CHUNK]), rays[i : i + CHUNK]),
                dtype=np.int32,
            )
            for i in range(0, len(rays), CHUNK)
        ]
        return np.concatenate(parts).reshape(shape)

    return trace


def compare_with_embree(table: Table, design: Design, repeats: int) -> None:
    """Same IDs on every pixel, and how much faster; both timed in turn, medians."""
    scene, camera, _ = scene_of(design)
    trace = embree_rays(scene, camera)
    hit = trace()
    ours = rasterise(scene, camera)
    theirs = np.where(hit >= 0, scene.part[np.maximum(hit, 0)], 0)
    differs = int((theirs != ours.part).sum())
    pixels = ours.part.size
    label = f"{design.name} {camera.width_px}x{camera.height_px}"
    table.add(
        f"{label}: pixels with the same ID",
        100.0 * (1.0 - differs / pixels),
        "%",
        reference=100.0,
        source="Embree 4 (embreex), one float32 ray per pixel centre",
        target=">= 99.99",
        note=f"{differs} of {pixels} pixels differ",
    )
    times = np.zeros((repeats, 2))
    for run in range(repeats):
        for slot, work in enumerate((lambda: rasterise(scene, camera), trace)):
            begin = time.perf_counter()
            work()
            times[run, slot] = time.perf_counter() - begin
    own, peer = np.median(times, axis=0)
    source = "Embree (embreex) on one thread, rays ready made; z-buffer on all threads"
    table.add(
        f"{label}: ID map", float(own), "s", reference=float(peer), source=source, target="<= 0.3"
    )
    table.add(
        f"{label}: times faster than Embree",
        float(peer / own),
        "ratio",
        reference=1.0,
        source=source,
        target=">= 10",
    )


def layouts(table: Table, design: Design) -> None:
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
        seen = check_visibility(varied, surface, markers, rng=np.random.default_rng(0))
        for name, value in seen.summary().items():
            table.add(
                f"{varied.name} {kind}: {name}",
                value,
                units.get(name, "px"),
                reference=references.get((kind, name), "none"),
                source=STUDY if (kind, name) in references else "not published",
                target=wanted.get(name),
            )
        hidden_rows(table, f"{varied.name} {kind}", seen, markers)


def hidden_rows(table: Table, label: str, seen: Visibility, markers: Markers) -> None:
    """Where a layout is worst."""
    worst = int(seen.visible_fraction.argmin())
    table.add(
        f"{label}: row of the least visible fraction",
        int(markers.row[worst]),
        "row",
        reference="none",
        source="not published",
        note="row 0 is nearest the camera",
    )


def main() -> None:
    """Run the benchmark."""
    quick = arguments(__doc__ or "").quick
    table = Table("visibility")
    full = load_design("cylinder60")
    design = smaller(full, 4) if quick else full
    compare_with_embree(table, design, repeats=1 if quick else 5)
    layouts(table, design)
    surface = design.surface()
    density = density_of(surface, make_markers(design, surface))
    table.add(
        f"{design.name}: density on a surface {density.surface_class} to the optical axis",
        density.per_cm2,
        "1/cm2",
        reference=1.63,
        source="paper",
        target="<= 1.64",
        note=f"{density.count} markers on {density.area_cm2:.1f} cm2, outer face",
    )
    scene, camera, _ = scene_of(design)
    render_frame(scene, camera)
    begin = time.perf_counter()
    render_frame(scene, camera, noise_std=2.0, rng=np.random.default_rng(0))
    table.add(
        f"{design.name}: noisy anti-aliased frame",
        time.perf_counter() - begin,
        "s",
        reference="none",
        source="own target",
        target="<= 1.5",
    )
    if not quick:
        print(table.write())


if __name__ == "__main__":
    main()
