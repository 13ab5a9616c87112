"""Motion program: every region is reached along its normal; the rig's log comes back as data."""

import csv
import io
import json
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phytac_design.design.design_file import to_toml
from phytac_design.fabrication.calibration_rig.log_template import NOTE, log_head
from phytac_design.fabrication.calibration_rig.program import (
    Program,
    gcode,
    make_program,
    program_csv,
    steps_of,
    turned,
)
from phytac_design.fabrication.calibration_rig.regions import frames_at, make_regions
from phytac_design.fabrication.calibration_rig.symmetry import find_symmetry
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.calibration.calibration import MAX_DISPLACEMENT_OVER_WALL
from phytac_design.mechanics.calibration.measurements import Measurements, read_measurements
from phytac_design.mechanics.calibration.probe_response import ProbeResponse
from phytac_design.mechanics.shell.receptor_stiffness import receptor_stiffness
from phytac_design.stages.build import copy_of
from tests.designs import small
from tests.fabrication.cases import built, shipped
from tests.fabrication.document_measurements import Move, in_sensor, read_gcode, tool_axis, tool_x
from tests.test_cli import phytac

SHAPES = ("cylinder60", "cone", "cuboid", "grip", "hemisphere", "plane", "patch")
PLACE_mm, ANGLE = 2e-4, 2e-6
"""Of places and unit vectors that went through five decimals."""


@cache
def program_of(name: str) -> Program:
    case = built(shipped(name))
    return make_program(Sensor.of(*case), make_regions(Sensor.of(*case)))


@cache
def moves_of(name: str, run: str) -> list[Move]:
    return read_gcode(gcode(program_of(name), "shell" if run == "shell" else "decoder", name=name))


def test_machine_turns_as_it_says() -> None:
    rng = np.random.default_rng(0)
    points, tip, turn = rng.normal(size=(9, 3)), rng.uniform(-1, 1, 9), rng.uniform(0, 6, 9)
    due = Rotation.from_euler("z", turn[:, None]).apply(points)
    due = Rotation.from_euler("y", tip[:, None]).apply(due)
    assert turned(points, tip, turn) == pytest.approx(due)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("run", ["shell", "decoder"])
def test_every_region_is_pressed_along_its_normal(name: str, run: str) -> None:
    """Read back from the G-code alone, by rotations of another library."""
    design, surface, markers = built(shipped(name))
    moves = [move for move in moves_of(name, run) if move.logs]
    region = np.array([move.region for move in moves])
    needed = find_symmetry(surface, markers).needed
    assert set(region.tolist()) == set(needed.tolist())
    at = np.array([move.at for move in moves])
    there, up, notch = in_sensor(at), tool_axis(at), tool_x(at)
    foot, normal = surface.point(markers.uv[region]), markers.normal[region]
    assert up == pytest.approx(normal, abs=ANGLE)
    assert notch == pytest.approx(frames_at(surface, markers.uv[region])[:, :, 0], abs=ANGLE)
    depth = np.sum((foot - there) * normal, axis=1)
    assert np.linalg.norm(foot - there - depth[:, None] * normal, axis=1) == pytest.approx(
        0.0, abs=PLACE_mm
    )
    targets = np.array([[log[1] for log in move.logs] for move in moves])
    steps = [log[2] for move in moves for log in move.logs]
    assert steps == sorted(set(steps))
    if run == "decoder":
        assert depth == pytest.approx(0.0, abs=PLACE_mm)
        due = np.geomspace(design.training.force_min_N, design.training.force_max_N, 8)
        assert targets == pytest.approx(np.tile(due, (len(moves), 1)), rel=1e-4)
    else:
        assert depth == pytest.approx(targets[:, 0], abs=PLACE_mm)
        assert targets.max() < MAX_DISPLACEMENT_OVER_WALL * design.wall.thickness_mm
        assert len(moves) == 4 * len(needed)


@pytest.mark.parametrize("name", SHAPES)
def test_the_way_stays_out_of_the_sensor(name: str) -> None:
    """Between presses the tool's face keeps off wall, rims and bowls; it turns far outside."""
    design, surface, _ = built(shipped(name))
    program = program_of(name)
    moves = moves_of(name, "decoder")
    at = np.array([move.at for move in moves[1:] if np.isfinite(move.at).all()])
    turning = np.any(np.abs(np.diff(at[:, 3:], axis=0)) > 1e-9, axis=1)
    assert np.all(at[:-1][turning][:, 0] == program.safe_mm)
    reach = np.linalg.norm(np.abs(surface.bounds_mm()).max(axis=0))
    assert program.safe_mm >= reach + design.wall.rim_flange_mm + program.hover_mm
    start, end = at[:-1][~turning], at[1:][~turning]
    share = np.linspace(0.0, 1.0, 7)[:, None, None]
    path = (start + share * (end - start)).reshape(-1, 6)
    there = in_sensor(path)
    foot = surface.chart(there)
    height = np.sum((there - surface.point(foot)) * surface.normal(foot), axis=1)
    assert height.min() >= -PLACE_mm
    hover = there[np.abs(height - program.hover_mm) < 1e-3]
    assert len(hover) > 0


def test_steps_and_targets_of_the_table() -> None:
    design, _, markers = built(shipped("cylinder60"))
    program = program_of("cylinder60")
    rows = list(csv.DictReader(io.StringIO(program_csv(program, markers))))
    assert [int(row["step"]) for row in rows] == list(range(46 * 12))
    shell = [row for row in rows if row["run"] == "shell"]
    decoder = [row for row in rows if row["run"] == "decoder"]
    assert {row["target_force_N"] for row in shell} == {""}
    forces = [float(row["target_force_N"]) for row in decoder[:8]]
    assert forces[0] == pytest.approx(design.training.force_min_N)
    assert forces[-1] == pytest.approx(design.training.force_max_N)
    assert [int(r["region"]) for r in decoder] == [
        int(program.marker[k]) for _, run, k, _ in steps_of(program) if run == "decoder"
    ]
    assert {int(row["tool"]) for row in rows} == {1, 2}
    assert {row["column"] for row in rows} == {"0", "1"}
    for row in decoder[::40]:
        assert int(row["region"]) == int(row["row"]) * 16 + int(row["column"])
    hemisphere = built(shipped("hemisphere"))
    made = program_csv(program_of("hemisphere"), hemisphere[2])
    assert {row["row"] for row in csv.DictReader(io.StringIO(made))} == {""}


def test_one_force_step_is_the_greatest() -> None:
    case = copy_of(shipped("plane"), kit={"force_steps": 1, "shell_steps": 1})
    made = built(case)
    program = make_program(Sensor.of(*made), make_regions(Sensor.of(*made)))
    assert program.force_N == pytest.approx([case.training.force_max_N])
    assert len(program.displacement_mm) == 1


def test_the_decoders_run_stops_before_the_bowls() -> None:
    made = built(shipped("plane"))
    program = make_program(Sensor.of(*made), make_regions(Sensor.of(*made)), bowl_mm=1.8)
    face = float(program.machine_mm[0, 0])
    for run, stop in (("shell", face), ("decoder", face + 1.8)):
        text = gcode(program, run, name="x")  # type: ignore[arg-type]  # both are runs
        (first, *_) = [line for line in text.splitlines() if line.startswith("G1 X")]
        assert float(first.split()[1][1:]) == pytest.approx(stop, abs=1e-4)


E_MPa, NOISE = 2050.0, 0.01


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Log of the shell's run on a softer unit: made up with the shell model, and says so."""
    folder = tmp_path_factory.mktemp("rig")
    design = small(
        layout={"rows": 8, "columns": 8, "height_far_mm": 6.0},
        kit={"shell_steps": 2},
    )
    (folder / "small.toml").write_text(to_toml(design), encoding="utf-8")
    surface, markers = built(design)[1:]
    program = make_program(
        Sensor.of(design, surface, markers), make_regions(Sensor.of(design, surface, markers))
    )
    steps = [(n, k, target) for n, run, k, target in steps_of(program) if run == "shell"]
    number, region, travel = (np.array(values) for values in zip(*steps, strict=True))
    uv, radius = markers.uv[program.marker[region]], program.radius_mm[region]
    rows = Measurements(
        contact_uv=uv,
        probe_uv=uv,
        radius_mm=radius,
        force_N=np.ones(len(uv)),
        displacement_mm=np.zeros(len(uv)),
    )
    factors = partial(receptor_stiffness, design, markers)
    # On the mesh that the fit takes at draft: this tests the way of the data, not the physics.
    part = ProbeResponse(surface=surface, rows=rows, around=24, factors=factors)
    wall = design.wall.thickness_mm
    per_N = part(wall, design.material.poisson, False).value / E_MPa
    rng = np.random.default_rng(0)
    force = travel / per_N * (1.0 + NOISE * rng.standard_normal(len(travel)))
    text = "# made up for a test; no rig wrote this\n" + log_head(design.name)
    columns = (number, program.marker[region], radius, force, travel)
    for step, marker, r, f, d in zip(*(values.tolist() for values in columns), strict=True):
        text += f"# step {step}, frame {100 + step}, {2.5 * step:.3f} s\n"
        text += f"{marker},{r:.9g},{f:.9g},{d:.9g}\n"
    (folder / "log.csv").write_text(text, encoding="utf-8")
    return folder


def test_calibrate_reads_a_log_as_it_is(rig: Path) -> None:
    words = ("calibrate", "small.toml", "log.csv", "--accuracy", "draft", "--json")
    out = phytac(*words, "--fix", "thickness", "--fix", "poisson", cwd=rig)
    assert out.returncode == 0, out.stderr
    fit = json.loads(out.stdout)
    assert fit["value"]["modulus"] == pytest.approx(E_MPa, rel=0.02)
    assert fit["low"]["modulus"] < E_MPa < fit["high"]["modulus"]
    assert fit["rows"] == (rig / "log.csv").read_text().count("\n# step ")


def test_the_steps_of_a_log_are_those_of_the_program(rig: Path) -> None:
    lines = (rig / "log.csv").read_text().splitlines()
    notes = [NOTE.match(line) for line in lines]
    step = [int(note[1]) for note in notes if note]
    frame = [int(note[2]) for note in notes if note]
    assert frame == list(range(100, 100 + len(step)))
    design = small(layout={"rows": 8, "columns": 8, "height_far_mm": 6.0}, kit={"shell_steps": 2})
    made = built(design)
    program = make_program(Sensor.of(*made), make_regions(Sensor.of(*made)))
    marker = {n: int(program.marker[k]) for n, _, k, _ in steps_of(program)}
    rows = read_measurements(rig / "log.csv", made[1], made[2], wall_mm=design.wall.thickness_mm)
    assert rows.contact_uv == pytest.approx(made[2].uv[[marker[n] for n in step]])
