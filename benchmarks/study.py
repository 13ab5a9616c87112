"""Search: rate, ladder, optimiser, large studies, Dask, the densest sensor; advice for one.

``python -m benchmarks.study [--quick] [--parts rate,ladder,optimiser,rows,dask,…]``
"""

from collections.abc import Callable
from functools import partial

from benchmarks import (
    study_advice,
    study_dask,
    study_dense,
    study_optimiser,
    study_rate,
    study_rows,
)
from benchmarks.harness import Table, run_parts


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts by name, in order."""
    works: dict[str, Callable[..., None]] = {
        "rate": study_rate.rate,
        "ladder": study_rate.ladder,
        "optimiser": study_optimiser.optimiser,
        "rows": study_rows.rows,
        "dask": study_dask.dask,
        **{name: partial(study_dense.dense, name=name) for name in study_dense.STUDIES},
        "advice": study_advice.advice,
    }
    return {name: partial(work, quick=quick) for name, work in works.items()}


if __name__ == "__main__":
    run_parts("study", parts, __doc__ or "")
