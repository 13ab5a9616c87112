"""Array aliases used in signatures; shapes and units stand in the docstrings."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ImageArray = NDArray[np.uint8]

__all__ = ["BoolArray", "FloatArray", "ImageArray", "IntArray"]
