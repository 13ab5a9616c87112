"""Meshes for other programs: read back by a library, and run by an independent solver."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from phytac_design.mechanics.shell.loads import patch_loads
from phytac_design.mechanics.shell.mesh_writers import write_inp, write_msh, write_vtu
from tests.mechanics.conftest import Prototype
from tests.refusals import refused

FORCE_N = 10.0
MARKER = 184  # row 11 of 23: the middle of the sensor


@pytest.fixture
def fingertip(cylinder60: Prototype) -> Any:
    return FORCE_N * patch_loads(
        cylinder60.mesh, cylinder60.surface, cylinder60.markers.uv[[MARKER]], 6.0
    )


def write_job(path: Path, part: Prototype, load: Any) -> Path:
    return write_inp(
        path,
        part.mesh,
        modulus_MPa=part.design.material.modulus_MPa,
        poisson=part.design.material.poisson,
        load=load,
        name="cylinder60",
    )


def test_ccx_runs_the_file_and_agrees_within_3_percent(
    cylinder60: Prototype, fingertip: Any, tmp_path: Path
) -> None:
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX (ccx) is not on PATH; apt install calculix-ccx")
    write_job(tmp_path / "shell.inp", cylinder60, fingertip)
    run = subprocess.run(
        ["ccx", "shell"], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120
    )
    assert not re.search(r"\*(ERROR|WARNING)", run.stdout)
    rows = [line.split() for line in (tmp_path / "shell.dat").read_text().splitlines()]
    table = {int(r[0]): [float(x) for x in r[1:]] for r in rows if len(r) == 4 and r[0].isdigit()}
    motion = cylinder60.model.solve(fingertip).motion[cylinder60.mesh.marker_nodes, :3, 0]
    theirs = np.array([table[node + 1] for node in cylinder60.mesh.marker_nodes])
    peak = np.linalg.norm(theirs, axis=1).max()
    assert np.argmax(np.linalg.norm(theirs, axis=1)) == MARKER
    assert np.abs(motion - theirs).max() < 0.03 * peak


def test_inp_has_sets_section_and_step(
    cylinder60: Prototype, fingertip: Any, tmp_path: Path
) -> None:
    text = write_job(tmp_path / "a.inp", cylinder60, fingertip).read_text()
    for card in ("*ELEMENT, TYPE=S4, ELSET=SHELL", "*NSET, NSET=TOP", "*NSET, NSET=BOTTOM"):
        assert card in text
    for card in ("*NSET, NSET=MARKERS", "*SHELL SECTION, ELSET=SHELL, MATERIAL=RESIN", "*STATIC"):
        assert card in text
    marked = re.search(r"NSET=MARKERS\n((?:[\d, ]+\n)+)", text).group(1)
    assert len(re.findall(r"\d+", marked)) == 368
    assert max(len(line) for line in text.splitlines()) <= 80
    cload = re.search(r"\*CLOAD\n((?:.+\n)+?)\*", text).group(1)
    total = np.zeros(3)
    for line in cload.splitlines():
        _, dof, value = line.split(",")
        total[int(dof) - 1] += float(value)
    assert -total @ cylinder60.markers.normal[MARKER] == pytest.approx(FORCE_N, rel=1e-9)


def test_files_are_deterministic_and_never_half_loaded(
    cylinder60: Prototype, fingertip: Any, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        write_job(tmp_path / f"{name}.inp", cylinder60, fingertip)
        write_msh(tmp_path / f"{name}.msh", cylinder60.mesh)
        write_vtu(tmp_path / f"{name}.vtu", cylinder60.mesh)
    for kind in ("inp", "msh", "vtu"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    with refused("load-vector-invalid"):
        write_job(tmp_path / "c.inp", cylinder60, np.zeros(7))


def test_msh_reads_back_with_its_groups(cylinder60: Prototype, tmp_path: Path) -> None:
    mesh = cylinder60.mesh
    back = meshio.read(write_msh(tmp_path / "a.msh", mesh))
    np.testing.assert_allclose(back.points, mesh.nodes_mm, atol=1e-12)
    np.testing.assert_array_equal(back.cells_dict["quad"], mesh.quads)
    assert set(back.field_data) == {"SHELL", "TOP", "BOTTOM", "MARKERS"}
    # Programs that ignore dimensions tell groups apart by number alone.
    assert len({number for number, _ in back.field_data.values()}) == 4
    tags = back.cell_data_dict["gmsh:physical"]
    for name in ("TOP", "BOTTOM"):
        lines = back.cells_dict["line"][tags["line"] == back.field_data[name][0]]
        assert len(lines) == 64
        np.testing.assert_array_equal(np.unique(lines), np.sort(mesh.sets[name]))
    np.testing.assert_array_equal(back.cells_dict["vertex"].ravel(), mesh.sets["MARKERS"])


def test_vtu_reads_back_with_its_data(cylinder60: Prototype, tmp_path: Path) -> None:
    mesh = cylinder60.mesh
    motion = np.random.default_rng(0).normal(size=(len(mesh.nodes_mm), 6))
    back = meshio.read(write_vtu(tmp_path / "a.vtu", mesh, motion=motion))
    np.testing.assert_array_equal(back.points, mesh.nodes_mm)
    np.testing.assert_array_equal(back.cells_dict["quad"], mesh.quads)
    np.testing.assert_array_equal(back.point_data["displacement_mm"], motion[:, :3])
    marker = back.point_data["marker"]
    np.testing.assert_array_equal(np.argsort(marker)[-368:], mesh.marker_nodes)
    np.testing.assert_array_equal(np.flatnonzero(back.point_data["TOP"]), mesh.sets["TOP"])
