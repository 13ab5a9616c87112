"""Lenses at the ends of their numbers: against OpenCV, against their formulae, there and back."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from phytac_decoder.camera.lens import Lens
from phytac_shapes.arrays import FloatArray
from verification.case import Case, Cases, Evidence, Expect, Recorder, verify
from verification.designs import SHAPES, design_of

IMAGE_PX = 1e-9
"""Error of a projection, relative to the image's size: arithmetic's own."""
BACK_RAD = 1e-7
"""Error of a direction there and back; more where the lens hardly moves an image at all."""


def _lens(values: Mapping[str, Any]) -> Lens:
    return design_of(
        {"shape": "plane", "changes": {"camera": dict(values["camera"])}}
    ).camera.lens()


def _points(lens: Lens, share: float) -> FloatArray:
    """Directions (m, 3) over the field, at distances from 1 µm to 1 km."""
    rng = np.random.default_rng(0)
    theta = np.concatenate([[0.0, 1e-9], share * lens.field_rad * np.sqrt(rng.random(398))])
    turn = rng.uniform(0.0, 2.0 * np.pi, 400)
    unit = np.column_stack(
        [np.sin(theta) * np.cos(turn), np.sin(theta) * np.sin(turn), np.cos(theta)]
    )
    return np.asarray(unit * np.geomspace(1e-3, 1e6, 400)[rng.permutation(400), None])


def _plane(lens: Lens, p: FloatArray) -> FloatArray:
    """Undistorted, then distorted plane (m, 2) by the models' published formulae."""
    k = lens.distortion
    x, y, z = p.astype(np.longdouble).T
    if lens.model == "kannala_brandt":
        off = np.hypot(x, y)
        theta = np.arctan2(off, z)
        c = (*k, 0.0, 0.0, 0.0, 0.0)[:4]
        radius = theta * (1 + c[0] * theta**2 + c[1] * theta**4 + c[2] * theta**6 + c[3] * theta**8)
        unit = np.where(off > 0, radius / np.where(off > 0, off, 1), 1 / np.where(z != 0, z, 1))
        return np.column_stack([unit * x, unit * y]).astype(np.float64)
    if lens.model == "omnidirectional":
        depth = z + k[0] * np.sqrt(x**2 + y**2 + z**2)
        x, y, k = x / depth, y / depth, (*k[1:], 0.0, 0.0, 0.0, 0.0)
    else:
        x, y, k = x / z, y / z, (*k, *[0.0] * 8)
    k1, k2, p1, p2, k3, k4, k5, k6 = (*k, *[0.0] * 8)[:8]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([bent_x, bent_y]).astype(np.float64)


def _opencv(lens: Lens, p: FloatArray) -> FloatArray:
    """Pixels by OpenCV."""
    import cv2

    K = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1.0]])
    zero = np.zeros(3)
    if lens.model == "kannala_brandt":
        d = np.array([*lens.distortion, *[0.0] * 4])[:4]
        return np.asarray(cv2.fisheye.projectPoints(p[:, None], zero, zero, K, d)[0][:, 0])
    if lens.model == "omnidirectional":
        d = np.array([*lens.distortion[1:], *[0.0] * 4])[:4][None]
        xi = float(lens.distortion[0])
        return np.asarray(cv2.omnidir.projectPoints(p[:, None], zero, zero, K, xi, d)[0][:, 0])
    return np.asarray(cv2.projectPoints(p, zero, zero, K, np.array(lens.distortion))[0][:, 0])


def check_lens(values: Mapping[str, Any], found: Evidence) -> None:
    """There by formula and OpenCV; back; derivative; what lies beyond the field."""
    lens = _lens(values)
    found.facts["field_deg"] = float(np.degrees(lens.field_rad))
    p = _points(lens, 0.999 if lens.model != "pinhole" else 0.9999)
    pixels = lens.project(p)
    exact = _plane(lens, p) * lens.focal_px + lens.centre_px
    size = np.abs(exact - lens.centre_px).max(axis=1, keepdims=True) + lens.width_px
    found.add("the model's formula, in longer arithmetic", (pixels - exact) / size, IMAGE_PX)
    front = p[:, 2] > 1e-3 * np.linalg.norm(p, axis=1)
    if lens.model == "omnidirectional" or front.all():
        own = np.ones(len(p), dtype=bool) if lens.model == "omnidirectional" else front
        found.add("OpenCV", ((pixels - _opencv(lens, p)) / size)[own], 1e-7)
    else:
        found.add("OpenCV", ((pixels - _opencv(lens, p)) / size)[front], 1e-7)
    unit = p / np.linalg.norm(p, axis=1, keepdims=True)
    back = lens.unproject(pixels)
    found.add("there and back", back - unit, BACK_RAD)
    _slope(lens, unit, found)
    narrow = pixels.astype(np.float32).astype(np.float64)
    known = np.isfinite(lens.unproject(narrow)).all(axis=1)
    loss = np.abs(lens.project(lens.unproject(narrow)[known]) - narrow[known]) / size[known]
    found.add("pixels in single precision keep their place", loss, 1e-7, kind="float32")
    if lens.field_rad < np.pi - 0.01 and lens.model != "pinhole":
        t = min(lens.field_rad * 1.001 + 1e-3, np.pi)
        out = np.array([[np.sin(t), 0.0, np.cos(t)], [0.0, -np.sin(t), np.cos(t)]])
        found.true("nothing beyond the field", np.isnan(lens.project(out)))


def _slope(lens: Lens, unit: FloatArray, found: Evidence) -> None:
    """Derivative against differences, in a frame of a metre."""
    own = unit[np.arccos(np.clip(unit[:, 2], -1.0, 1.0)) < 0.98 * lens.field_rad]
    step = 1e-6
    each = [
        (lens.project(own + step * axis) - lens.project(own - step * axis)) / (2.0 * step)
        for axis in np.eye(3)
    ]
    exact = np.stack(each, axis=2)
    size = np.abs(exact).max(axis=(1, 2), keepdims=True)
    # A pinhole's third derivative grows as 1/cos³ aside; differences lose with it.
    found.add(
        "derivative: differences",
        np.quantile(np.abs(lens.jacobian(own) - exact) / size, 0.95),
        1e-5,
    )


def check_fit(values: Mapping[str, Any], found: Evidence) -> None:
    """A camera that `fit` places: the rim reaches just as far into the image as it should."""
    from phytac_design.geometry.envelope import edge_mm
    from phytac_design.layout.cameras import camera_of

    design = design_of(values)
    surface = design.surface()
    camera = camera_of(design, surface)
    rim = edge_mm(surface, 0, -design.wall.thickness_mm)
    p = rim - camera.position_mm
    exact = _plane(camera.lens, p) * camera.lens.focal_px + camera.lens.centre_px
    found.close("pixels of the rim by formula", camera.project(rim), exact, IMAGE_PX)
    half = min(camera.width_px, camera.height_px) / 2.0
    reach = np.linalg.norm(exact - camera.lens.centre_px, axis=1).max() / half
    found.add("the rim fills the image as wanted", reach - design.camera.fill, 0.02)


def cases() -> Cases:  # noqa: C901 - a table
    """Every model over its numbers; fields of 179°; distortions that fold; far-off centres."""
    out = Cases()

    def add(name: str, expect: Expect = "right", /, **camera: Any) -> None:
        out.add(name, check_lens, expect, camera={"width_px": 648, "height_px": 486} | camera)

    for focal in (1e-3, 1.0, 242.5, 1e6):
        add(f"pinhole, focal length {focal:g} px", focal_px=focal)
    for ratio in (0.1001, 9.999):
        add(f"pinhole, pixels {ratio:g} as high", focal_px=200, focal_ratio=ratio)
    add("pinhole, centre 1e6 px off", focal_px=200, centre_offset_px=[1e6, -1e6])
    add("pinhole, 16 x 16 px", focal_px=5, width_px=16, height_px=16)
    bent = {
        "barrel": [-0.3, 0.12, 0.0, 0.0],
        "strong barrel": [-0.45, 0.2, 0.0, 0.0, -0.04],
        "pincushion": [0.4, 0.1, 0.0, 0.0],
        "rational": [0.1, -0.2, 1e-3, -1e-3, 0.05, 0.2, -0.1, 0.02],
        "tangential": [0.0, 0.0, 0.02, -0.02],
        "hardly any": [1e-12, 0.0, 0.0, 0.0],
        "narrow field": [-5.0, 0.0, 0.0, 0.0],
        "field of under a degree": [-5e3, 0.0, 0.0, 0.0],
    }
    for name, k in bent.items():
        add(f"brown_conrady, {name}", model="brown_conrady", focal_px=240, distortion=k)
    fish = {
        "none": [],
        "a real one": [-0.01, 0.004, -0.003, 5e-4],
        "wide": [0.05, 0.01, 0.0, 0.0],
        "folds before 179°": [-0.05, 0.0, 0.0, 0.0],
        "folds at a few degrees": [-30.0, 0.0, 0.0, 0.0],
        "stretches": [10.0, 10.0, 10.0, 10.0],
    }
    fisheye, omni = {"model": "kannala_brandt"}, {"model": "omnidirectional", "focal_px": 200}
    for focal in (1e-2, 100.0, 1e5):
        for name, k in fish.items():
            title = f"kannala_brandt, {name}, focal length {focal:g} px"
            add(title, focal_px=focal, distortion=k, **fisheye)
    for xi in (0.0, 1e-6, 0.5, 1.0, 1.5, 3.0, 1e3):
        add(f"omnidirectional, ξ {xi:g}", distortion=[xi], **omni)
    add("omnidirectional, distorted", distortion=[1.2, -0.1, 0.02, 1e-3, 1e-3], **omni)
    barrel = {"model": "brown_conrady"}
    bad: dict[str, dict[str, Any]] = {
        "focal length 0": {"focal_px": 0.0},
        "focal length infinite": {"focal_px": float("inf")},
        "no model of that name": {"model": "mirror"},
        "five coefficients for a fisheye": fisheye | {"distortion": [0.1] * 5},
        "two coefficients for barrel": barrel | {"distortion": [0.1] * 2},
        "coefficients for a pinhole": {"distortion": [0.1] * 4},
        "ξ below 0": {"model": "omnidirectional", "distortion": [-0.1]},
        "coefficient of 1e300": barrel | {"distortion": [-1e300, 0, 0, 0]},
        "coefficient not a number": barrel | {"distortion": [float("nan"), 0, 0, 0]},
        "65 megapixels": {"width_px": 8126, "height_px": 8000},
        "0 px wide": {"width_px": 0},
        "centre not a number": {"centre_offset_px": [float("nan"), 0.0]},
    }
    for name, camera in bad.items():
        add(name, "refused", **camera)
    add("folds over at its centre", "either", distortion=[0, 0, 60.0, 60.0], **barrel)
    lenses: dict[str, dict[str, Any]] = {
        "a tele lens of 5000 px": {"focal_px": 5000.0},
        "a wide lens of 20 px": {"focal_px": 20.0},
        "a fisheye": fisheye | {"focal_px": 160.0},
        "an omnidirectional lens": omni | {"focal_px": 300.0, "distortion": [1.0]},
    }
    for shape in SHAPES:
        for name, camera in lenses.items():
            expect: Expect = "either" if "20 px" in name else "right"
            out.add_design(shape, f"fit of {name}", check_fit, {"camera": camera}, expect)
    return out


CASES = cases()


@CASES.parametrize
def test_lenses(case: Case, record_property: Recorder) -> None:
    """Projection and back for four lens models, fields to 179°, `fit`."""
    verify(case, record_property)
