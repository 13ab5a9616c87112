"""The STEP's volume against the printed mesh's, whose facets may be coarse."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.solid_mesh import shell_manifold
from phytac_design.stages import shell_stage
from phytac_design.stages.shell_stage import VOLUME_TOL, FINE_mm, run_step
from tests.designs import drawn
from tests.refusals import refused

DESIGN = drawn("hemisphere", 1)
SURFACE = DESIGN.surface()
MARKERS = make_markers(DESIGN, SURFACE)
COARSE_mm = 0.3


def volume(tolerance_mm: float) -> float:
    return float(
        shell_manifold(Sensor.of(DESIGN, SURFACE, MARKERS), tolerance_mm=tolerance_mm).volume()
    )


@pytest.mark.parametrize(("share", "same"), [(1.0, True), (1.01, False)])
def test_coarse_facets_are_no_other_shell(
    share: float, same: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true, printed = volume(FINE_mm), volume(COARSE_mm)
    assert abs(printed / true - 1.0) > VOLUME_TOL
    facts = SimpleNamespace(valid=True, solids=1, volume_mm3=share * true)
    monkeypatch.setattr(shell_stage, "shell_cad", lambda *_: None)
    monkeypatch.setattr(shell_stage, "cad_facts", lambda _: facts)
    monkeypatch.setattr(shell_stage, "write_step", lambda _, path, **__: path.write_text("STEP"))
    monkeypatch.setattr(shell_stage, "write_solid", lambda _, path: path.write_text("solid"))
    context: Any = SimpleNamespace(
        design=DESIGN,
        accuracy=PRESETS["standard"],
        sensor=Sensor.of(DESIGN, SURFACE, MARKERS),
        facts=lambda _: {"volume_mm3": printed},
        progress=lambda _: None,
    )
    if same:
        run_step(cast("Context", context), tmp_path)
        assert list(tmp_path.rglob("*.step"))
    else:
        with refused("kernels-disagree"):
            run_step(cast("Context", context), tmp_path)
