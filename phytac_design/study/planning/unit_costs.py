"""Unit costs of stages: cost per amount of work in :func:`cost.features`.

Written by ``python -m benchmarks.tradeoff --parts costs,units``.
"""

PROBE_s = 0.05522
"""Time of :func:`cost.probe_s` on the machine that they were measured on."""
WALL_s: dict[str, dict[str, float]] = {
    "bench": {"markers": 0.1771, "one": 0.9591},
    "compare": {"markers": 0.2171},
    "decoder": {"one": 0.5894, "samples": 0.1143},
    "frames": {"markers": 0.1546, "one": 1.225, "pixels": 0.05392},
    "hardware": {"one": 2.064},
    "inserts": {"markers": 1.5, "one": 0.01},
    "kit": {"one": 0.3114},
    "mesh": {"nodes": 0.1602, "one": 0.0009649},
    "mold": {"fine": 0.626, "markers": 0.9335},
    "places": {"copies": 0.00534, "large": 2.008, "nodes": 1.59, "orders": 0.4775},
    "printing": {"fine": 0.2161, "one": 0.5155, "tools": 5.953},
    "renders": {"markers": 1.92, "one": 2.706, "pixels": 0.07001},
    "report": {"one": 1.107},
    "resolution": {"loads": 0.102, "nodes": 0.7607},
    "response": {"loads": 0.146, "markers": 0.05698, "nodes": 0.1819, "one": 0.009992},
    "shell": {"markers": 0.2856, "one": 0.3957},
    "step": {"markers": 1.285},
    "switch": {"markers": 0.5228, "one": 6.326},
    "twin": {"loads": 0.1406, "nodes": 0.4353},
    "underload": {"large": 2.829, "looks": 0.03557, "nodes": 0.2342, "pixels": 0.3019},
    "views": {"markers": 0.8747, "one": 0.1446, "pixels": 1.471},
}
"""Wall seconds of a stage within a whole build, on two cores; from builds of random designs.

``renders`` and ``frames`` are processor seconds, as below."""
CPU_s: dict[str, dict[str, float]] = {
    "bench": {"fine": 0.3595, "markers": 0.1137, "one": 1.26},
    "compare": {"one": 0.284, "pixels": 1.21},
    "decoder": {"one": 0.1209, "samples": 0.05077, "trained": 0.627},
    "frames": {"markers": 0.1546, "one": 1.225, "pixels": 0.05392},
    "hardware": {"fine": 3.075, "markers": 0.9725, "one": 2.61},
    "inserts": {"markers": 1.5, "one": 0.01},
    "kit": {"one": 0.404},
    "mesh": {"nodes": 0.1422, "one": 0.1233},
    "mold": {"fine": 1.395, "markers": 1.178},
    "places": {"copies": 0.02358, "orders": 1.619, "solves": 0.5427},
    "printing": {"fine_tools": 5.784, "markers": 0.532, "one": 0.722},
    "renders": {"markers": 1.92, "one": 2.706, "pixels": 0.07001},
    "report": {"markers": 0.0076, "one": 2.33},
    "resolution": {"loads": 0.06768, "nodes": 0.582, "one": 0.2861},
    "response": {"loads": 0.456, "markers": 0.04926, "nodes": 0.1638, "one": 0.01432},
    "shell": {"fine": 0.5761, "markers": 0.3332, "one": 0.616},
    "step": {"markers": 2.92, "one": 5.46},
    "switch": {"one": 7.39},
    "twin": {"loads": 0.1463, "nodes": 0.1991, "one": 0.3284, "seen": 0.04725},
    "underload": {"large": 5.734, "nodes": 1.231, "pixels": 0.1939},
    "views": {"markers": 0.513, "pictures": 1.78, "pixels": 0.6},
}
"""Processor seconds of a stage in its own process; from builds of shipped designs and scenes.

``renders`` and ``frames`` are from builds of four shipped designs, 5 to 20 frames of 5 megapixels,
on one thread."""
MEMORY_MB: dict[str, dict[str, float]] = {
    "bench": {"fine": 9.876, "markers": 11.23, "one": 404.0},
    "compare": {"one": 124.0, "pixels": 107.0},
    "decoder": {"one": 96.16, "samples": 1.172, "trained": 0.03132},
    "frames": {"markers": 4.303, "one": 361.4},
    "hardware": {"fine": 60.21, "markers": 19.04, "one": 650.0},
    "inserts": {"markers": 20.0, "one": 100.0},
    "kit": {"markers": 3.0, "one": 83.6},
    "mesh": {"nodes": 42.7, "one": 79.46},
    "mold": {"fine": 98.76, "markers": 38.81, "one": 183.0},
    "places": {"copies": 0.3457, "large": 42.9, "nodes": 32.5, "one": 153.9, "solves": 8.229},
    "printing": {"fine_tools": 54.31, "markers": 18.2, "one": 221.0},
    "renders": {"nodes": 28.4, "one": 255.7, "pixels": 1.232, "solves": 3.44},
    "report": {"one": 213.0},
    "resolution": {"loads": 5.154, "nodes": 45.94, "one": 156.5},
    "response": {"loads": 33.72, "markers": 7.424, "nodes": 30.0, "one": 91.08},
    "shell": {"fine": 19.49, "markers": 11.22, "one": 134.0},
    "step": {"one": 630.0},
    "switch": {"one": 163.0},
    "twin": {"loads": 7.31, "nodes": 57.26, "one": 86.26, "seen": 1.274},
    "underload": {"nodes": 50.7, "pixels": 61.33},
    "views": {"markers": 2.43, "pictures": 94.4, "pixels": 91.7},
}
"""Peak memory of that process, the program itself included."""
