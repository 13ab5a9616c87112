"""The hinged roof against an independent solid model, also in the limit of a thin shallow shell."""

import shutil
from pathlib import Path

import pytest

from tests.refusals import refused
from verification.large_shells import hinged_roof
from verification.path_tracing import trace_displacement
from verification.solid_roof import solid_roof

SAGS_MM = (6.0, 11.293, 19.5)
NO_CCX = pytest.mark.skipif(
    shutil.which("ccx") is None,
    reason="CalculiX (ccx) is not on PATH; apt install calculix-ccx",
)


@NO_CCX
def test_roof_against_bricks_of_calculix(tmp_path: Path) -> None:
    # The laws of the two differ by the order of the strain: 0.5 % of the limit load (benchmark).
    theirs = solid_roof(tmp_path, 6, thickness_mm=12.7, sags_mm=SAGS_MM)
    model, load, middle = hinged_roof(12, thickness=12.7)
    stops = [-sag for sag in SAGS_MM]
    states = trace_displacement(model, load, dof=6 * middle + 2, stops_mm=stops)
    assert [s.load_factor for s in states] == pytest.approx(theirs, abs=0.01 * 0.7421)
    assert theirs[2] < 0.3 * theirs[1]


@NO_CCX
def test_a_job_that_does_not_finish_is_an_error(tmp_path: Path) -> None:
    with refused("calculix-failed"):
        solid_roof(tmp_path, 2, thickness_mm=12.7, sags_mm=[float("nan")])
