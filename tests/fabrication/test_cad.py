import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phytac_design.fabrication.cad import (
    STEP_DATE,
    CadFacts,
    cad_facts,
    read_step,
    revolved_wall,
    shell_cad,
    write_step,
)
from phytac_design.fabrication.solid_mesh import shell_manifold
from phytac_design.layout import make_markers
from shapes.errors import DesignError, OutputError
from tests.fabrication.cases import Barrel, built, design

AGREE = 1e-4
"""Mesh against CAD: equal-area sections; the design asks for 1e-3."""


def test_wall_with_rims_is_exact() -> None:
    case = design()
    facts = cad_facts(revolved_wall(case.surface(), case.wall))
    closed = np.pi * ((30.0**2 - 29.2**2) * 120.0 + 2.0 * (31.6**2 - 29.2**2) * 4.0)
    assert facts.volume_mm3 == pytest.approx(closed, rel=1e-9)
    assert facts.valid


@pytest.mark.parametrize(
    "layout",
    [
        {"rows": 3, "columns": 4},
        {"rows": 1, "columns": 1},
        {"rows": 3, "columns": 2, "kind": "straight", "height_near_mm": 9.0},
    ],
)
def test_cad_and_mesh_agree(layout: dict[str, object]) -> None:
    case = built(design(layout=layout))
    facts = cad_facts(shell_cad(*case))
    assert facts.valid
    assert facts.solids == 1
    assert shell_manifold(*case).volume() == pytest.approx(facts.volume_mm3, rel=AGREE)


def test_step_opens_again_and_repeats_byte_for_byte(tmp_path: Path) -> None:
    solid = shell_cad(*built(design(layout={"rows": 2, "columns": 3})))
    first, second = tmp_path / "a.step", tmp_path / "b.step"
    write_step(solid, first, name="case")
    write_step(solid, second, name="case")
    assert first.read_bytes() == second.read_bytes()
    text = first.read_text()
    assert STEP_DATE in text
    assert re.search(r"PRODUCT\('case','case'", text)
    assert "PCURVE" not in text
    again, facts = cad_facts(read_step(first)), cad_facts(solid)
    assert (again.valid, again.solids) == (True, 1)
    assert again.volume_mm3 == pytest.approx(facts.volume_mm3, rel=1e-4)
    assert isinstance(again, CadFacts)


def test_another_process_writes_the_same_step(tmp_path: Path) -> None:
    code = (
        "import sys;from pathlib import Path;from tests.fabrication.cases import *;"
        "from phytac_design.fabrication.cad import *;"
        "write_step(shell_cad(*built(design(layout={'rows':1,'columns':3}))),Path(sys.argv[1]))"
    )
    root = Path(__file__).parents[2]
    target = tmp_path / "other.step"
    subprocess.run([sys.executable, "-c", code, str(target)], cwd=root, check=True)
    write_step(shell_cad(*built(design(layout={"rows": 1, "columns": 3}))), tmp_path / "own.step")
    assert target.read_bytes() == (tmp_path / "own.step").read_bytes()


def test_surface_without_a_builder_is_refused() -> None:
    case, surface = design(layout={"height_far_mm": 4.0}), Barrel()
    with pytest.raises(DesignError, match=r"'barrel' has no CAD wall \(known: cylinder\)"):
        shell_cad(case, surface, make_markers(case, surface))


def test_a_folder_that_is_missing_is_reported(tmp_path: Path) -> None:
    solid = revolved_wall(design().surface(), design().wall)
    with pytest.raises(OutputError, match="cannot write STEP file"):
        write_step(solid, tmp_path / "none" / "a.step")
