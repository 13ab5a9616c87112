"""``phytac calibrate`` as a person uses it: a CSV in, values with intervals and a design out."""

import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from phytac_design.design.design_file import load_design, to_toml
from phytac_design.design.spec import Design
from phytac_design.layout import make_markers
from phytac_design.mechanics.calibration.measurements import Measurements
from phytac_design.mechanics.calibration.probe_response import ProbeResponse
from phytac_design.mechanics.shell.receptor_stiffness import receptor_stiffness
from tests.designs import small
from tests.test_cli import phytac

E, T = 2050.0, 0.85


def sensor() -> Design:
    """A small one with few columns, for a coarse mesh."""
    return small(layout={"rows": 8, "columns": 8, "height_far_mm": 6.0})


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A design file and the camera's view of six presses on a softer, thicker unit of it."""
    folder = tmp_path_factory.mktemp("rig")
    design = sensor()
    (folder / "small.toml").write_text(to_toml(design), encoding="utf-8")
    surface = design.surface()
    markers = make_markers(design, surface)
    contact, probe = np.repeat([0, 11, 28, 44, 51, 60], 64), np.tile(np.arange(64), 6)
    radius = np.repeat([4.0, 8.0, 4.0, 8.0, 4.0, 8.0], 64)
    rows = Measurements(
        contact_uv=markers.uv[contact],
        probe_uv=markers.uv[probe],
        radius_mm=radius,
        force_N=np.ones(384),
        displacement_mm=np.zeros(384),
    )
    unit = design.model_copy(update={"wall": design.wall.model_copy(update={"thickness_mm": T})})
    part = ProbeResponse(
        surface=surface,
        rows=rows,
        around=20,
        factors=partial(receptor_stiffness, unit, markers),
    )
    moved = 0.6 * part(T, 0.38, False).value / E
    rng = np.random.default_rng(0)
    moved = moved * (1.0 + 0.02 * rng.standard_normal(384)) + 2e-5 * rng.standard_normal(384)
    table = np.column_stack([contact, radius, np.full(384, 0.6), probe, moved])
    names = "contact_marker,patch_radius_mm,force_N,probe_marker,displacement_mm"
    np.savetxt(folder / "all.csv", table, delimiter=",", header=names, comments="", fmt="%.9g")
    own = table[(contact == probe) & (radius == 8.0)][:2]
    scaled = [own * [1, 1, k, 1, k * (1.0 + s)] for k, s in ((1, 0.05), (0.9, 0), (0.8, -0.05))]
    some = np.concatenate([own, *scaled, own * [1, 1, 0.7, 1, 0.71]])
    np.savetxt(folder / "own.csv", some, delimiter=",", header=names, comments="", fmt="%.9g")
    return folder


def test_fitted_values_and_the_design_file(rig: Path) -> None:
    words = ("calibrate", "small.toml", "all.csv", "--accuracy", "draft", "--fix", "poisson")
    out = phytac(*words, "--out", "mine.toml", "--json", cwd=rig)
    assert out.returncode == 0, out.stderr
    fit = json.loads(out.stdout)
    assert fit["value"]["modulus"] == pytest.approx(E, rel=0.02)
    assert fit["value"]["thickness"] == pytest.approx(T, rel=0.02)
    assert fit["low"]["modulus"] < fit["value"]["modulus"] < fit["high"]["modulus"]
    assert fit["fitted"] == ["modulus", "thickness"]
    assert (fit["rows"], fit["presses"]) == (384, 6)
    made = load_design(str(rig / "mine.toml"))
    assert made.material.modulus_MPa == fit["value"]["modulus"]
    assert made.wall.thickness_mm == fit["value"]["thickness"]
    old = sensor()
    assert made.model_copy(update={"wall": old.wall, "material": old.material}) == old
    again = phytac(*words, "--out", "mine.toml", cwd=rig)
    assert again.returncode == 3
    assert "exists already" in again.stderr
    ends = [fit[end][name] for name in ("modulus", "thickness") for end in ("low", "high")]
    width = 50.0 * np.log(max(ends[1] / ends[0], ends[3] / ends[2]))
    plain = phytac(*words, "--out", "other.toml", cwd=rig).stdout.splitlines()
    assert plain[-2:] == [
        f"known to ± {width:.2g} % at worst (needs 10 %)",
        "next: phytac build other.toml",
    ]


def test_forces_in_another_unit_are_warned_of(rig: Path) -> None:
    """Kilograms of force are within what a search may find."""
    head, *rows = (rig / "all.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    kgf = [",".join([*c[:2], f"{float(c[2]) / 9.81:.9g}", *c[3:]]) for c in cells]
    (rig / "kgf.csv").write_text("\n".join([head, *kgf]))  # its last line has no end
    words = ("calibrate", "small.toml", "kgf.csv", "--accuracy", "draft", "--fix", "poisson")
    out = phytac(*words, cwd=rig)
    assert out.returncode == 0, out.stderr
    assert "warning: the fitted modulus is 0.0" in out.stderr
    assert "are forces in N" in out.stderr
    assert "may have been cut off" in out.stderr


def test_data_that_do_not_determine_are_refused_and_a_known_wall_helps(rig: Path) -> None:
    words = ("calibrate", "small.toml", "own.csv", "--accuracy", "draft")
    out = phytac(*words, cwd=rig)
    assert out.returncode == 5
    assert "do not determine" in out.stderr
    assert "--fix thickness" in out.stderr
    assert "Traceback" not in out.stderr
    fixed = phytac(*words, "--fix", "thickness", "--fix", "poisson", cwd=rig)
    assert fixed.returncode == 0, fixed.stderr
    assert "Young's modulus" in fixed.stdout
    assert re.search(r"wall thickness +0\.8 mm +held", fixed.stdout)


def test_a_bad_file_is_one_line(rig: Path) -> None:
    (rig / "bad.csv").write_text("force_N\nnan\n", encoding="utf-8")
    out = phytac("calibrate", "small.toml", "bad.csv", cwd=rig)
    assert out.returncode == 4
    assert len(out.stderr.strip().splitlines()) == 1
    assert "'patch_radius_mm' is missing" in out.stderr


def test_an_existing_design_file_is_refused_before_the_fit(rig: Path) -> None:
    words = ("calibrate", "small.toml", "absent.csv", "--accuracy", "draft")
    out = phytac(*words, "--out", "small.toml", cwd=rig)
    assert "output-exists" in out.stderr
