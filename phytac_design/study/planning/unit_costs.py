"""Unit costs of stages; by ``python -m benchmarks.tradeoff_scenes --units``."""

PROBE_s = 0.0243
"""What :func:`cost.probe_s` took on the machine that they were measured on."""
SECONDS: dict[str, dict[str, float]] = {
    "bench": {"fine": 4.15, "markers": 0.0, "one": 1.26},
    "compare": {"one": 0.284, "pixels": 1.21},
    "decoder": {"judged": 0.00272, "one": 0.127, "trained": 6.17},
    "frames": {"markers": 1.96, "nodes": 0.0, "one": 5.61, "pixels": 0.14},
    "hardware": {"fine": 35.5, "markers": 0.0, "one": 2.61},
    "kit": {"fine": 0.0, "markers": 0.0, "one": 0.404},
    "mesh": {"nodes": 0.188, "one": 0.0906},
    "mold": {"fine": 16.1, "markers": 7.37, "one": 0.0},
    "places": {"copies": 0.00186, "nodes": 0.0, "one": 0.0, "solves": 4.81},
    "printing": {"fine": 0.0, "markers": 5.32, "one": 0.722, "tools": 40.9},
    "report": {"markers": 0.076, "one": 2.33},
    "resolution": {"loads": 0.132, "nodes": 1.06, "one": 0.0191},
    "response": {"loads": 1.96, "nodes": 0.361, "one": 0.00885},
    "shell": {"fine": 6.65, "markers": 1.51, "one": 0.616},
    "step": {"markers": 29.2, "one": 5.46},
    "switch": {"one": 7.39, "thresholds": 0.0},
    "twin": {"loads": 1.15, "nodes": 0.202, "one": 0.353, "seen": 0.00511},
    "underload": {"large": 0.69, "looks": 0.325, "nodes": 0.19, "one": 1.27},
    "views": {"markers": 5.13, "one": 0.0, "pictures": 1.78, "pixels": 0.6},
}
"""Processor time, s, of each feature of :func:`cost.features`."""
MEMORY_MB: dict[str, dict[str, float]] = {
    "bench": {"fine": 114.0, "markers": 81.1, "one": 404.0},
    "compare": {"one": 124.0, "pixels": 107.0},
    "decoder": {"judged": 0.0612, "one": 96.3, "trained": 0.0},
    "frames": {"markers": 0.0, "nodes": 54.8, "one": 267.0, "pixels": 0.0},
    "hardware": {"fine": 695.0, "markers": 0.0, "one": 650.0},
    "kit": {"fine": 0.0, "markers": 30.0, "one": 83.6},
    "mesh": {"nodes": 56.8, "one": 69.8},
    "mold": {"fine": 1140.0, "markers": 75.8, "one": 183.0},
    "places": {"copies": 0.0, "nodes": 57.2, "one": 144.0, "solves": 71.1},
    "printing": {"fine": 0.0, "markers": 182.0, "one": 221.0, "tools": 384.0},
    "report": {"markers": 0.0, "one": 213.0},
    "resolution": {"loads": 0.0, "nodes": 87.5, "one": 131.0},
    "response": {"loads": 0.0, "nodes": 57.3, "one": 90.7},
    "shell": {"fine": 225.0, "markers": 50.6, "one": 134.0},
    "step": {"markers": 0.0, "one": 630.0},
    "switch": {"one": 163.0, "thresholds": 0.0},
    "twin": {"loads": 34.8, "nodes": 56.2, "one": 93.1, "seen": 0.189},
    "underload": {"large": 0.0, "looks": 0.0, "nodes": 66.7, "one": 297.0},
    "views": {"markers": 24.3, "one": 0.0, "pictures": 94.4, "pixels": 91.7},
}
"""Peak memory, MB, likewise; the program itself included."""
