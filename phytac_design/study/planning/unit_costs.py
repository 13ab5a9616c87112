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
    "pressed": {"markers": 0.175, "one": 0.3},
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
    "bench": {"markers": 0.5665, "one": 1.301},
    "compare": {"markers": 0.001164, "pixels": 0.339},
    "decoder": {"one": 0.1342, "samples": 0.07952, "trained": 0.3687},
    "frames": {"markers": 0.1307, "one": 0.6661, "pixels": 0.02913},
    "hardware": {"fine": 2.414, "one": 0.5119},
    "inserts": {"one": 0.000445},
    "kit": {"one": 0.3373},
    "mesh": {"nodes": 0.1385},
    "mold": {"markers": 2.149, "one": 0.6075},
    "places": {"copies": 0.009261, "nodes": 1.758, "orders": 3.411, "solves": 0.7768},
    "pressed": {"markers": 0.175, "one": 0.3},
    "printing": {"fine_tools": 3.138, "markers": 0.3214, "one": 0.7384, "tools": 0.4596},
    "renders": {"markers": 0.7004, "nodes": 0.2288, "pixels": 0.04274},
    "report": {"markers": 0.15, "one": 0.55},
    "resolution": {"loads": 0.08928, "one": 0.2894},
    "response": {"loads": 0.1953, "markers": 0.00607, "nodes": 0.09822},
    "shell": {"fine": 0.2189, "markers": 0.2898, "one": 0.5096},
    "step": {"one": 12.38},
    "switch": {"one": 2.607},
    "twin": {"loads": 0.08364, "nodes": 0.1448, "seen": 0.02674},
    "underload": {"large": 0.6089, "looks": 0.0398, "pixels": 0.3198},
    "views": {"markers": 0.8361, "pictures": 0.1611, "pixels": 0.4346},
}
"""Processor seconds of a stage in its own process; from builds of shipped designs and scenes.

``renders`` and ``frames`` are from builds of four shipped designs, 5 to 20 frames of 5 megapixels,
on one thread; then ``renders`` solved contacts that ``twin`` solves now. ``pressed`` and
``report``, of which it was a part, are from drafts of ``cylinder60`` and ``cylinder60-dense``;
its memory is the report's."""
MEMORY_MB: dict[str, dict[str, float]] = {
    "bench": {"markers": 15.0, "one": 514.0},
    "compare": {"one": 227.3, "pixels": 73.01},
    "decoder": {"one": 292.6, "samples": 0.33},
    "frames": {"markers": 0.5564, "one": 347.0},
    "hardware": {"fine": 318.0, "one": 229.4},
    "inserts": {"one": 206.3},
    "kit": {"markers": 0.1392, "one": 208.8},
    "mesh": {"nodes": 49.13, "one": 194.0},
    "mold": {"markers": 58.21, "one": 460.8},
    "places": {"copies": 3.213, "large": 357.2, "nodes": 166.0, "one": 321.2},
    "pressed": {"markers": 7.254, "one": 370.0},
    "printing": {"markers": 5.195, "one": 331.6, "tools": 91.79},
    "renders": {"nodes": 31.11, "one": 302.8},
    "report": {"markers": 7.254, "one": 370.0},
    "resolution": {"loads": 3.589, "nodes": 46.38, "one": 264.4},
    "response": {"nodes": 58.61, "one": 207.7},
    "shell": {"fine": 10.28, "markers": 14.62, "one": 248.1},
    "step": {"one": 788.5},
    "switch": {"one": 288.7},
    "twin": {"loads": 2.308, "nodes": 73.6, "one": 190.6},
    "underload": {"large": 7.091, "looks": 1.023, "nodes": 50.02, "pixels": 63.8},
    "views": {"markers": 23.45, "pictures": 0.9203, "pixels": 116.1},
}
"""Peak memory of that process, the program itself included."""
