"""Unit costs of stages; by ``python -m benchmarks.tradeoff_scenes --units``."""

PROBE_s = 0.02999
"""What :func:`cost.probe_s` took on the machine that they were measured on."""
SECONDS: dict[str, dict[str, float]] = {
    "bench": {"fine": 2.65, "markers": 0.0, "one": 1.46},
    "compare": {"one": 0.0, "pixels": 1.23},
    "decoder": {"judged": 0.00172, "one": 0.149, "trained": 8.64},
    "frames": {"markers": 0.0, "nodes": 1.16, "one": 0.0, "pixels": 0.106},
    "hardware": {"fine": 39.4, "markers": 0.0, "one": 2.32},
    "kit": {"fine": 0.695, "markers": 0.0, "one": 0.181},
    "mesh": {"nodes": 0.184, "one": 0.0997},
    "mold": {"fine": 20.5, "markers": 0.0, "one": 0.745},
    "places": {"copies": 0.0, "nodes": 0.154, "one": 0.531, "solves": 5.16},
    "printing": {"fine": 0.0, "markers": 0.0, "one": 1.49, "tools": 38.5},
    "report": {"markers": 0.0, "one": 1.5},
    "resolution": {"loads": 0.635, "nodes": 0.913, "one": 0.0},
    "response": {"loads": 0.0, "nodes": 0.306, "one": 0.2},
    "shell": {"fine": 8.69, "markers": 0.0, "one": 0.525},
    "step": {"markers": 36.4, "one": 1.16},
    "switch": {"one": 9.01, "thresholds": 0.0},
    "twin": {"loads": 5.17, "nodes": 0.213, "one": 0.0, "seen": 0.0},
    "underload": {"large": 0.666, "looks": 0.442, "nodes": 0.0, "one": 0.0},
    "views": {"markers": 0.0, "one": 1.38, "pictures": 1.62, "pixels": 0.561},
}
"""Processor time, s, of each feature of :func:`cost.features`."""
MEMORY_MB: dict[str, dict[str, float]] = {
    "bench": {"fine": 190.0, "markers": 0.0, "one": 405.0},
    "compare": {"one": 0.0, "pixels": 132.0},
    "decoder": {"judged": 0.0741, "one": 94.3, "trained": 0.0},
    "frames": {"markers": 0.0, "nodes": 21.9, "one": 811.0, "pixels": 0.0},
    "hardware": {"fine": 460.0, "markers": 0.0, "one": 639.0},
    "kit": {"fine": 45.0, "markers": 0.0, "one": 79.4},
    "mesh": {"nodes": 58.5, "one": 77.1},
    "mold": {"fine": 885.0, "markers": 0.0, "one": 214.0},
    "places": {"copies": 0.00923, "nodes": 103.0, "one": 129.0, "solves": 1.86},
    "printing": {"fine": 0.0, "markers": 0.0, "one": 279.0, "tools": 293.0},
    "report": {"markers": 0.0, "one": 250.0},
    "resolution": {"loads": 0.0, "nodes": 97.7, "one": 120.0},
    "response": {"loads": 0.0, "nodes": 59.1, "one": 92.1},
    "shell": {"fine": 282.0, "markers": 0.0, "one": 132.0},
    "step": {"markers": 191.0, "one": 521.0},
    "switch": {"one": 170.0, "thresholds": 0.0},
    "twin": {"loads": 395.0, "nodes": 50.6, "one": 79.4, "seen": 0.0},
    "underload": {"large": 0.0, "looks": 0.0, "nodes": 103.0, "one": 149.0},
    "views": {"markers": 0.0, "one": 330.0, "pictures": 100.0, "pixels": 25.0},
}
"""Peak memory, MB, likewise; the program itself included."""
