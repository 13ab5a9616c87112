"""Whole designs drawn at random, from likely to absurd: right or rejected."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_design.layout.cameras import camera_of
from phytac_design.rules.check import check_design
from verification.case import Case, Cases, Evidence, Recorder, verify
from verification.designs import AROUND, SHAPES, base, changed, design_of
from verification.faces import face_of
from verification.test_lenses import _plane

LENSES: tuple[dict[str, Any], ...] = (
    {},
    {"model": "kannala_brandt", "focal_px": 160.0},
    {"model": "omnidirectional", "focal_px": 300.0, "distortion": [1.2]},
    {"focal_px": 800.0},
)


def random_changes(shape: str, rng: np.random.Generator) -> dict[str, Any]:
    """Changes of a family's base: sizes over two decades, layouts, heights, walls, lenses."""
    size = float(10.0 ** rng.uniform(-0.5, 1.0))
    table = {key: _times(value, size, rng) for key, value in SHAPES[shape].items()}
    kinds = ["straight", "phyllotaxis", *(["spiral"] if shape in AROUND else [])]
    near = float(10.0 ** rng.uniform(-1.0, 0.8))
    layout = {
        "kind": str(rng.choice(kinds)),
        "rows": int(rng.integers(1, 8)),
        "columns": int(rng.integers(1, 14)),
        "count": int(rng.integers(1, 60)),
        "spiral_angle_deg": float(rng.uniform(-85.0, 85.0)),
        "row_pitch_exponent": float(10.0 ** rng.uniform(-0.6, 0.6)),
        "heights": str(rng.choice(["constant", "linear", "power"])),
        "height_near_mm": near,
        "height_far_mm": float(near * 10.0 ** rng.uniform(-0.5, 0.7)),
        "height_exponent": float(10.0 ** rng.uniform(-0.6, 0.9)),
    }
    return {
        "shape": table,
        "layout": layout,
        "wall": {"thickness_mm": float(10.0 ** rng.uniform(-0.35, 0.4))},
        "camera": dict(LENSES[int(rng.integers(len(LENSES)))]),
    }


def _times(value: Any, size: float, rng: np.random.Generator) -> Any:
    """Numbers of a shape times ``size``, each by up to a third more or less; grids as a whole."""
    if isinstance(value, list):
        one = float(size)
        return [_grown(item, one) for item in value]
    return float(value * size * rng.uniform(0.75, 1.3))


def _grown(value: Any, size: float) -> Any:
    return [_grown(item, size) for item in value] if isinstance(value, list) else value * size


def check_drawn(values: Mapping[str, Any], found: Evidence) -> None:
    """Rules, layout, camera and a mesh under load of a design, against formulae and balances."""
    from verification.test_shell import balances

    design = design_of(values)
    sensor = check_design(design)
    surface, markers = sensor.surface, sensor.markers
    table = {**changed(base(values["shape"]), values["changes"])["shape"]}
    known = face_of(surface.name, {"skirt_mm": 0.0, "end": "open", "tilt_deg": 0.0, **table})
    low, high = surface.bounds_mm()
    size = float(np.linalg.norm(high - low))
    outer = surface.point(markers.uv)
    if known.gap is not None:
        found.add("receptors stand on the face's equation", known.gap(outer) / size, 1e-9)
    found.add("area: closed form or quadrature", surface.area_mm2() / known.area_mm2 - 1.0, 1e-8)
    camera = camera_of(design, surface)
    p = camera.to_camera(markers.tip_mm)
    p = p[camera.lens.in_field(p)]
    exact = _plane(camera.lens, p) * camera.lens.focal_px + camera.lens.centre_px
    pixels = camera.lens.project(p)
    found.add("tips' pixels by the lens's formula", (pixels - exact) / camera.width_px, 1e-8)
    if not values.get("mesh", True):
        return
    from phytac_design.mechanics.meshing.mesh import plain_mesh
    from phytac_design.mechanics.shell.loads import patch_loads
    from phytac_design.mechanics.shell.solve import clamped_model

    step = float(np.sqrt(known.area_mm2 / 300.0))
    mesh = plain_mesh(surface, thickness_mm=design.wall.thickness_mm, size_mm=step)
    model = clamped_model(
        mesh, modulus_MPa=design.material.modulus_MPa, poisson=design.material.poisson
    )
    load = patch_loads(mesh, surface, markers.uv[:1], 1.2 * step)
    solution = model.solve(load)
    forces = np.asarray(load.toarray()).reshape(-1, 6)
    push = forces[:, :3].sum(axis=0) @ -surface.normal(markers.uv[:1])[0]
    found.add("a newton is a newton", push - 1.0, 1e-9, kind="balance")
    balances(model, forces, solution.motion[:, :, 0], solution.reactions[:, :, 0], found)


def random_cases(count: int, *, seed: int, shape: str = "") -> Cases:
    """Designs drawn with a seed, families in turn."""
    kinds = [shape] if shape else list(SHAPES)
    out = Cases()
    for number in range(count):
        kind = kinds[number % len(kinds)]
        changes = random_changes(kind, np.random.default_rng([seed, number, 8]))
        out.add_design(kind, f"seed {seed}, number {number}", check_drawn, changes, "either")
    return out


def cases() -> Cases:
    """The same 60 in every run."""
    return random_cases(60, seed=20_000)


CASES = cases()


@CASES.parametrize
def test_random_designs(case: Case, record_property: Recorder) -> None:
    """Rules, layout, camera, mesh and load of designs drawn at random."""
    verify(case, record_property)
