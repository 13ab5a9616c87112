"""Benchmarks: accuracy and speed against independent references; one module a subject."""

import os

# One BLAS thread, set before numpy loads: SuperLU's many small products run slower on several.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
