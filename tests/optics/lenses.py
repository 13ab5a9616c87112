"""Lenses of every model before the small sensor, as camera tables of a design."""

from typing import Any

SIZE = {"width_px": 648, "height_px": 486}
LENSES: dict[str, dict[str, Any]] = {
    "barrel": SIZE
    | {
        "model": "brown_conrady",
        "focal_px": 242.5,
        "focal_ratio": 1.02,
        "centre_offset_px": (3.3, -2.1),
        "distortion": (-0.28, 0.09, 1e-3, -5e-4, -0.012),
        "stand_off_mm": 31.0,
    },
    "pincushion": SIZE
    | {
        "model": "brown_conrady",
        "focal_px": 180.0,
        "distortion": (0.2, 0.02, 0.0, 0.0),
    },
    "fisheye": SIZE
    | {
        "model": "kannala_brandt",
        "focal_px": 155.0,
        "distortion": (-0.01, 0.003, -0.002, 0.0003),
        "stand_off_mm": 15.0,
    },
    "omni": SIZE
    | {
        "model": "omnidirectional",
        "focal_px": 380.0,
        "distortion": (1.2, -0.2, 0.05, 1e-3, -2e-3),
        "stand_off_mm": 12.0,
    },
}
