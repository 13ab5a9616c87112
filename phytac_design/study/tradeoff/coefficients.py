"""Coefficients of the cost model; made by ``python -m benchmarks.tradeoff --parts costs``."""

PROBE_S = 0.05522
"""Seconds of the probe on the machine that they are of."""
COEFFICIENTS: dict[str, list[float]] = {
    "views": [0.1446, 1.471, 0.8747],
    "switch": [6.326, 0.5228],
    "compare": [0.0, 0.0, 0.2171],
    "underload": [0.0, 0.3019, 0.03557, 2.829, 0.2342],
    "resolution": [0.0, 0.7607, 0.0, 0.102],
    "shell": [0.3957, 0.2856, 0.0],
    "step": [0.0, 1.285],
    "hardware": [2.064, 0.0, 0.0],
    "mold": [0.0, 0.9335, 0.626],
    "kit": [0.3114, 0.0, 0.0],
    "printing": [0.5155, 0.2161, 5.953, 0.0],
    "bench": [0.9591, 0.1771, 0.0],
    "mesh": [0.0009649, 0.1602],
    "response": [0.009992, 0.1819, 0.146, 0.05698],
    "places": [0.0, 1.59, 0.0, 0.4775, 2.008, 0.00534],
    "twin": [0.0, 0.4353, 0.1406, 0.0],
    "decoder": [0.5894, 0.1143, 0.0],
    "frames": [0.4634, 0.0, 0.1973, 0.3871, 0.297],
    "report": [1.107, 0.0],
}
"""Seconds of each term of a stage; see :func:`cost.terms`."""
