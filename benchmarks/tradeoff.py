"""The trade of time for truth: fronts, presets, and settings chosen by tolerance or budget.

``python -m benchmarks.tradeoff [--quick] [--parts costs,fronts,presets,tolerance,budget,…]``

Measured points lie in ``$PHYTAC_DATA/tradeoff``: a killed run resumes.
"""

from collections.abc import Callable
from functools import partial

from benchmarks import (
    tradeoff_budget,
    tradeoff_costs,
    tradeoff_fronts,
    tradeoff_scenes,
    tradeoff_tolerance,
)
from benchmarks.harness import Table, run_parts


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """All parts by name, in order."""
    return {
        "costs": partial(tradeoff_costs.add_rows, quick=quick),
        "fronts": partial(tradeoff_fronts.add_rows, quick=quick),
        "presets": partial(tradeoff_fronts.add_presets, quick=quick),
        "tolerance": partial(tradeoff_tolerance.add_rows, quick=quick),
        "budget": partial(tradeoff_budget.add_rows, quick=quick),
        "scenes": partial(tradeoff_scenes.add_rows, quick=quick),
        "units": tradeoff_scenes.measure_units,
    }


if __name__ == "__main__":
    run_parts("tradeoff", parts, __doc__ or "")
