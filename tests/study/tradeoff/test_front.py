"""Fronts, settings and the journal of measured points."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from phytac_design.cli.tradeoff_command import tradeoff as tradeoff_command
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import to_toml
from phytac_design.design.spec import Design
from phytac_design.stages import STAGES
from phytac_design.study.tradeoff import points as points_module
from phytac_design.study.tradeoff import run_tradeoff
from phytac_design.study.tradeoff.front import (
    MeasuredSetting,
    beaten_by,
    knee,
    pareto,
    setting_fronts,
)
from phytac_design.study.tradeoff.joint import CAD, FIXED, LOAD, MECHANICS, SCORE, JointGrid
from phytac_design.study.tradeoff.points import Point, Points, accuracy_of
from phytac_design.study.tradeoff.run_tradeoff import tradeoff
from phytac_design.study.tradeoff.settings import QUANTITIES, SETTINGS, Setting, setting_named
from tests.designs import drawn
from tests.refusals import refused


def at(seconds: float, force: float, volume: float = 0.0) -> MeasuredSetting:
    errors = {"force": force, "volume": volume}
    return MeasuredSetting(settings={}, seconds=seconds, cpu_s=seconds, peak_MB=1.0, errors=errors)


def test_front_holds_what_nothing_beats() -> None:
    cloud = [at(3, 0.1), at(1, 0.5), at(2, 0.6), at(2, 0.2), at(4, 0.1), at(9, 0.01)]
    assert [(p.seconds, p.errors["force"]) for p in pareto(cloud, "force")] == [
        (1, 0.5),
        (2, 0.2),
        (3, 0.1),
        (9, 0.01),
    ]


def test_beaten_only_by_what_is_worse_in_nothing() -> None:
    cloud = [at(10, 0.1, 0.1), at(8, 0.1, 0.2), at(9, 0.05, 0.1)]
    assert beaten_by(cloud[0], cloud) == pytest.approx(0.1)
    assert beaten_by(cloud[1], cloud) == 0.0
    assert beaten_by(cloud[2], cloud) == 0.0


def test_knee_is_where_more_time_gains_little() -> None:
    cloud = [at(1, 1.0), at(2, 0.1), at(20, 0.09), at(200, 0.08)]
    assert knee(cloud, "force").seconds == 2


def test_every_setting_of_a_build_is_read_by_a_stage() -> None:
    settings = set(PRESETS["draft"].as_dict())
    of_build = {setting.name for setting in SETTINGS if setting.of_build}
    assert of_build == settings - {"tools", "step"}
    for setting in SETTINGS:
        assert setting.quantity in QUANTITIES
        assert bool(setting.stages) == setting.of_build
        assert len(set(setting.values)) == len(setting.values) >= 2
    with refused("setting-unknown") as caught:
        setting_named("refin")
    caught.match("did you mean 'refine'")


def test_seconds_of_a_build_are_those_of_every_stage_once() -> None:
    groups = {"cad": CAD, "mechanics": MECHANICS, "load": LOAD, "score": SCORE}
    named = [name for stages in (FIXED, *groups.values()) for name in stages.split(",")]
    assert sorted(named) == sorted(stage.name for stage in STAGES)
    # A stage is measured with the settings that it reads. Presses are, on each mesh too; of frames
    # the powers of the force change the example alone.
    grid, known = JointGrid(), {("mechanics", "underload"), ("mechanics", "renders")}
    for group, stages in groups.items():
        varied = {name for each in getattr(grid, group) for name in each}
        for stage in STAGES:
            if varied & {*stage.settings, stage.only_with}:
                assert stage.name in stages.split(",") or (group, stage.name) in known


def test_presets_are_joint_settings() -> None:
    grid = JointGrid()
    joint = [
        accuracy_of({**a, **b, **c, **d, "receptors": True})
        for a in grid.cad
        for b in grid.mechanics
        for c, least in zip(grid.load, grid.load_refine, strict=True)
        for d in grid.score
        if b["refine"] >= least
    ]
    for name, preset in PRESETS.items():
        assert preset in joint, name


def test_measured_points_survive_a_restart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    design, measured = drawn("hemisphere", 1), []

    def answer(_: Design, point: Point, cache: Path) -> dict[str, float]:
        measured.append(point)
        return {"seconds": 1.0, "cpu_s": 1.0, "peak_MB": 1.0, "error": 0.5}

    monkeypatch.setattr(points_module, "measure_apart", answer)
    point = Point(kind="force", name="force", settings={"each": [{"refine": 3}]})
    first = Points(design, tmp_path).get(point)
    assert Points(design, tmp_path).get(point) == first
    assert measured == [point]
    # Another setting, another design, or a torn file is measured again.
    Points(design, tmp_path).get(Point(kind="force", name="force", settings={"each": []}))
    Points(drawn("plane", 1), tmp_path).get(point)
    assert len(measured) == 3
    for path in (tmp_path / "points").rglob("*.bin"):
        path.write_bytes(path.read_bytes()[:20])
    Points(design, tmp_path).get(point)
    assert len(measured) == 4


@pytest.mark.long
def test_stages_are_measured_apart_from_what_they_need(tmp_path: Path) -> None:
    points = Points(drawn("hemisphere", 1), tmp_path)
    point = Point(kind="stages", name="mesh", settings={"refine": 2})
    found = points.get(point)
    assert found["stages"] == {"mesh": pytest.approx(found["seconds"])}
    assert 50.0 < found["peak_MB"] < 4000.0
    assert found["cpu_s"] > 0.0
    with refused("point-not-measured"):
        points.get(Point(kind="use", name="none", settings={"none": 1}))


def test_command_measures_one_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(design: Design, point: Point, cache: Path) -> dict[str, object]:
        return {"seconds": 1.0, "cpu_s": 1.0, "peak_MB": 9.0, "error": 0.25}

    monkeypatch.setattr(points_module, "measure_apart", answer)
    app = typer.Typer()
    app.command()(tradeoff_command)
    path = tmp_path / "dome.toml"
    path.write_text(to_toml(drawn("hemisphere", 1)), encoding="utf-8")
    arguments = [str(path), "--only", "image_size", "--out", str(tmp_path / "out"), "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert set(data["knobs"]) == {"image_size"}
    assert data["joint"] == []
    assert not (tmp_path / "out" / "front.png").exists()


def test_tradeoff_writes_json_tables_and_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def answer(design: Design, point: Point, cache: Path) -> dict[str, object]:
        if "each" in point.settings:
            own = [sum(map(float, one.values())) for one in point.settings["each"]]
            return {"errors": [1.0 / (1.0 + size) for size in own]}
        size = float(sum(float(v) for v in point.settings.values() if not isinstance(v, str)))
        return {
            "seconds": 1.0 + size,
            "cpu_s": 1.0,
            "peak_MB": 9.0,
            "error": 1.0 / (1.0 + size),
            "volume_mm3": 1000.0 + size,
            "clearance": [1.0, 0.5 + 0.001 * size],
        }

    def some(name: str, rows: Sequence[tuple[Setting, Sequence[MeasuredSetting]]]) -> bytes:
        return setting_fronts(name, rows[::6])  # every panel takes a fifth of a second

    monkeypatch.setattr(points_module, "measure_apart", answer)
    monkeypatch.setattr(run_tradeoff, "setting_fronts", some)
    design = drawn("hemisphere", 1)
    done = tradeoff(design, tmp_path, progress=lambda _: None)
    assert set(done.presets) == set(PRESETS)
    data = json.loads((tmp_path / "tradeoff.json").read_text())
    grid = JointGrid()
    pairs = sum(m["refine"] >= least for m in grid.mechanics for least in grid.load_refine)
    assert len(data["joint"]) == len(grid.cad) * pairs * len(grid.score)
    assert [v["errors"]["force"] for v in data["knobs"]["refine"]["values"]] == sorted(
        (1.0 / (1.0 + r) for r in (2, 3, 4, 5, 6, 8)), reverse=True
    )
    for picture in ("front.png", "knobs.png"):
        assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    assert "preset standard" in (tmp_path / "tradeoff.txt").read_text()
