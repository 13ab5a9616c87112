"""Visibility: the exact map against rays, fractions and sums, sizes and lenses at the ends."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_decoder.camera.camera import Camera
from phytac_design.design.spec import Design
from phytac_design.layout.cameras import camera_of, tolerance_mm
from phytac_design.optics.raster import rasterise
from phytac_design.optics.render_scene import FIRST_MARKER, RenderScene, build_scene, paint_owner
from phytac_design.optics.visibility import check_visibility
from phytac_design.rules.check import check_design
from phytac_shapes.arrays import FloatArray, IntArray
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import SHAPES, design_of, sized

PIXELS = 240
"""Pixels whose rays are cast, half of them on paint."""
EDGE = 1e-7
"""Barycentric distance from an edge within which either side may be seen."""
CHUNK = 20
SPILL_px = 3
"""Pixels of a marker whose centre lies on an edge so nearly that rounding decides."""


def first_hits(
    scene: RenderScene, camera: Camera, rays: FloatArray
) -> tuple[IntArray, list[set[int]]]:
    """First part (m,) hit by rays (m, 3) of the camera frame, and all candidates for it.

    Möller and Trumbore (1997) against every triangle; no tree, no raster.
    """
    corners = camera.to_camera(scene.vertices)[scene.triangles]
    a, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    part = np.zeros(len(rays), dtype=np.int64)
    maybe: list[set[int]] = []
    for first in range(0, len(rays), CHUNK):
        d = rays[first : first + CHUNK, None]
        h = np.cross(d, e2)
        det = np.sum(e1 * h, axis=2)
        size = np.linalg.norm(e1, axis=1) * np.linalg.norm(e2, axis=1)
        flat = np.abs(det) <= 1e-14 * size
        inverse = 1.0 / np.where(flat, 1.0, det)
        u = -inverse * np.sum(a * h, axis=2)
        q = -np.cross(a, e1)
        v = inverse * np.sum(d * q, axis=2)
        t = inverse * np.sum(e2 * q, axis=1)
        near = ~flat & (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1.0 + EDGE) & (t > 0.0)
        inside = near & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
        depth = np.where(inside, t, np.inf)
        best = depth.argmin(axis=1)
        rows = np.arange(len(best))
        least = depth[rows, best]
        hit = np.isfinite(least)
        part[first : first + CHUNK] = np.where(hit, scene.part[best], 0)
        for k in rows:
            among = near[k] & (t[k] <= least[k] * (1.0 + 1e-9))
            # An edge in front of it may or may not count.
            also = {int(code) for code in scene.part[among]}
            maybe.append(also | {int(part[first + k])})
    return part, maybe


def check_seen(values: Mapping[str, Any], found: Evidence) -> None:
    """Map against rays; each marker's figures against the map; the same at another size."""
    design = design_of(values)
    sensor = check_design(design)
    markers = sensor.markers
    camera = camera_of(design, sensor.surface)
    scene = build_scene(sensor, tolerance_mm=tolerance_mm(camera, markers))
    part = rasterise(scene, camera).part
    _rays(scene, camera, part, found)
    seen = check_visibility(sensor, rng=np.random.default_rng(0))
    owner = paint_owner(part)
    counted = np.bincount(owner[owner >= 0], minlength=markers.count)
    found.true("visible pixels are those of the map", seen.visible_px == counted)
    fraction = seen.visible_fraction
    found.true("fractions lie in 0 … 1", (fraction >= 0.0) & (fraction <= 1.0))
    found.true("no marker shows more than alone", seen.visible_px <= seen.alone_px)
    found.true("parts of the map are those of the scene", (part == 0) | np.isin(part, scene.part))
    shown = seen.visible_px > 0
    inside = (seen.centroid_px >= -0.5) & (
        seen.centroid_px <= np.array([camera.width_px, camera.height_px]) - 0.5
    )
    found.true("centroids lie in the image", inside[shown])
    found.true("hidden markers have none", np.isnan(seen.centroid_px[~shown]))
    found.facts["visible_fraction_min"] = float(fraction.min())
    if values.get("scaled", True):
        _sizes(design, seen.visible_px, found)


def _rays(scene: RenderScene, camera: Camera, part: Any, found: Evidence) -> None:
    rng = np.random.default_rng(1)
    height, width = part.shape
    painted = np.argwhere(part >= FIRST_MARKER)
    some = painted[rng.integers(len(painted), size=PIXELS // 2)] if len(painted) else painted
    anywhere = np.column_stack(
        [rng.integers(height, size=PIXELS // 2), rng.integers(width, size=PIXELS // 2)]
    )
    y, x = np.concatenate([some, anywhere]).T
    rays = camera.lens.unproject(np.column_stack([x, y]).astype(np.float64))
    known = np.isfinite(rays).all(axis=1)
    maybe = first_hits(scene, camera, rays[known])[1]
    codes = part[y[known], x[known]]
    good = [int(code) in also for code, also in zip(codes, maybe, strict=True)]
    found.add("rays against every triangle: share of pixels that differ", 1.0 - np.mean(good), 0.0)
    found.true("pixels beyond the lens's field show nothing", part[y[~known], x[~known]] == 0)


def _sizes(design: Design, visible_px: IntArray, found: Evidence) -> None:
    """The same sensor 16 times as large and 8 times as small before the same camera."""
    for factor in (0.125, 16.0):
        other = sized(design, factor)
        if other is None:
            continue
        sensor = check_design(other)
        again = check_visibility(sensor, rng=np.random.default_rng(0))
        found.add(
            f"{factor:g} times as large: pixels of a marker that differ",
            np.abs(again.visible_px - visible_px).max(),
            SPILL_px,
            kind="units",
        )


def cases() -> Cases:
    """Every shape before near, far, tiny, large, long and wide cameras; bands; one marker."""
    out = Cases()

    def add(
        shape: str, name: str, changes: dict[str, Any], expect: Expect = "right", /, **more: Any
    ) -> None:
        out.add_design(shape, name, check_seen, changes, expect, **more)

    barrel = {"model": "brown_conrady", "distortion": [-0.2, 0.03, 1e-3, 0.0]}
    omni = {"model": "omnidirectional", "focal_px": 300.0, "distortion": [1.2]}
    fisheye = {"model": "kannala_brandt", "focal_px": 150.0}
    shrinking = {"heights": "linear", "height_near_mm": 6.0, "height_far_mm": 0.6}
    far, tiny = {"stand_off_mm": 2e4}, {"width_px": 32, "height_px": 24, "focal_px": 12.0}
    for shape in SHAPES:
        scaled = shape == "cylinder"
        add(shape, "as it is", {})
        add(shape, "one marker", {"layout": {"kind": "straight", "rows": 1, "columns": 1}})
        add(shape, "20 m away", {"camera": far})
        tele = {"camera": far | {"focal_px": 1e5}}
        add(shape, "20 m away, 100 000 px focal length", tele, "either")
        add(shape, "an image of 32 x 24 px", {"camera": tiny}, "either")
        add(shape, "a fisheye", {"camera": fisheye}, scaled=scaled)
        add(shape, "an omnidirectional lens", {"camera": omni}, scaled=scaled)
        add(shape, "a barrel lens", {"camera": barrel}, "either", scaled=False)
        add(shape, "no painted band", {"receptor": {"band_marker_mm": 0.0}})
        add(shape, "painted to the wall", {"receptor": {"band_marker_mm": 200.0}})
        add(shape, "heights that decrease", {"layout": shrinking}, "either")
        add(shape, "a camera that touches the rim", {"camera": {"stand_off_mm": 1e-9}}, "refused")
        add(shape, "a camera inside", {"camera": {"stand_off_mm": -5.0}}, "refused")
        add(shape, "a camera 1e300 mm away", {"camera": {"stand_off_mm": 1e300}}, "either")
    add("cylinder", "from the far end", {"camera": {"ends": "far"}})
    add("cylinder", "a bar that fills the bore", {"light": {"bar_radius_mm": 15.9}})
    add("cylinder", "a bar too thick", {"light": {"bar_radius_mm": 17.5}}, "refused")
    plate = {"kind": "box", "name": "plate", "centre_mm": [0.0, 0.0, -5.0]}
    for name, size in (
        ("a plate before everything", [200.0, 200.0, 1.0]),
        ("a plate that is a wire", [200.0, 1e-6, 1e-6]),
    ):
        fixtures = {"fixtures": [plate | {"size_mm": size}]}
        add("cylinder", name, fixtures, "either", scaled=False)
    add("hemisphere", "from its closed end", {"camera": {"ends": "far"}}, "refused")
    return out


CASES = cases()


@CASES.parametrize
def test_visibility(case: Case, record_property: Recorder) -> None:
    """The exact map against rays at every shape, lens and size."""
    verify(case, record_property)
