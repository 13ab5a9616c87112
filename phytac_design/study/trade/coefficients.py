"""Coefficients of the cost model; made by ``python -m benchmarks.tradeoff --parts costs``."""

PROBE_S = 0.07
"""Seconds of the probe on the machine that they are of."""
COEFFICIENTS: dict[str, list[float]] = {
    "views": [0.9937, 1.486, 0.0],
    "switch": [5.445, 0.0],
    "compare": [0.4412, 0.5331, 0.0],
    "underload": [0.0, 0.1293, 0.03587, 2.289, 0.4036],
    "resolution": [0.503, 0.2234, 0.0, 0.0946],
    "shell": [0.0, 0.1635, 0.4207],
    "step": [0.0, 1.726],
    "hardware": [1.096, 2.349, 0.0],
    "mold": [0.0, 0.5252, 0.4762],
    "kit": [0.2127, 0.0, 0.01232],
    "printing": [0.8398, 0.3148, 6.381, 0.0],
    "bench": [0.4523, 0.1385, 0.1274],
    "mesh": [0.2425, 0.02307],
    "response": [0.1337, 0.09765, 0.28, 0.01719],
    "places": [0.0, 0.0, 0.2538, 4.816, 10.0, 0.03076],
    "twin": [0.0, 0.5592, 0.04067, 0.03953],
    "decoder": [0.1643, 0.008337, 0.3174],
    "frames": [0.2539, 0.0, 0.1347, 0.5418, 0.0],
    "report": [0.1075, 0.3913],
}
"""Seconds of each term of a stage; see :func:`cost.terms`."""
