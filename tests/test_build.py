"""A whole build: the folder's contract, the cache, refusals, determinism, decoding its frames."""

import json
import shutil
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.estimators import ESTIMATORS
from phytac_decoder.io.bundle import load_bundle
from phytac_decoder.io.recorded_frames import read_image
from phytac_decoder.pipeline.decode import measure_frame, rest_positions
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import load_design, parse_design, to_toml
from phytac_design.engine import cache
from phytac_design.engine.stage import Context
from phytac_design.layout import make_markers
from phytac_design.stages import STAGES
from phytac_design.stages.build import BuildResult, build, run_stages
from phytac_design.stages.shell_stage import run_shell
from phytac_shapes.errors import (
    CadKernelError,
    MissingPartError,
    PhytacError,
)
from tests.designs import COARSE, QUICK, changed, fused, small, tiny
from tests.refusals import refused

CONTRACT = {
    "design.toml",
    "shell/shell.step",
    "shell/shell.stl",
    "shell/shell.3mf",
    "views/camera.png",
    "views/camera_all_on.png",
    "views/ids.png",
    "views/straight.png",
    "views/frame_rest.png",
    "views/frame_pressed.png",
    "views/frame_pressed.json",
    "mesh/shell.inp",
    "mesh/shell.msh",
    "mesh/shell.vtu",
    "decoder/bundle.json",
    "decoder/bundle.safetensors",
    "bench/assembly.html",
    "bench/bill_of_materials.csv",
    "bench/casting.md",
    "bench/paint_map.pdf",
    "bench/paint_map.svg",
    "bench/paint_map_inside.svg",
    "bench/switch_placement.csv",
    "fixtures/assembly.step",
    "fixtures/bar.step",
    "fixtures/bar.stl",
    "fixtures/connector.step",
    "fixtures/connector.stl",
    "fixtures/cover.step",
    "fixtures/cover.stl",
    "fixtures/mount.step",
    "fixtures/mount.stl",
    "kit/README.md",
    "kit/calibration_log.csv",
    "kit/cell_seat.stl",
    "kit/collar.stl",
    "kit/decoder.gcode",
    "kit/gripper_palm.stl",
    "kit/indenter_1.stl",
    "kit/indenter_2.stl",
    "kit/indenter_ball.stl",
    "kit/indenter_flat.stl",
    "kit/program.csv",
    "kit/shell.gcode",
    "mold/cavities.csv",
    "mold/core_tray_1.stl",
    "mold/dome_tray_1.stl",
    "shell/print_report.json",
    "shell/print_report.svg",
    "switch/switch_0.5N.json",
    "switch/switch_0.5N.svg",
    "switch/switches.json",
    "report/report.json",
    "report/report.html",
    "report/viewer.json",
}
DRAWN = "camera camera_all_on frame_pressed frame_rest ids straight"
PLOTTED = (
    "crosstalk density estimators gap gap_under_load layout motion resolution_along "
    "resolution_force shell softness visible_fraction"
)
CONTRACT |= {f"report/images/{name}.jpg" for name in DRAWN.split()}
CONTRACT |= {f"report/images/{name}.png" for name in PLOTTED.split()}
CONTRACT |= {f"report/images/pressed_{of}_{k}.jpg" for of in ("all", "close") for k in range(6)}


def quiet(_: str) -> None:
    """No progress."""


def manifest_of(out: Path) -> dict:
    return json.loads((out / "manifest.json").read_text())


def test_folder_is_the_contract(built: BuildResult) -> None:
    files = {p.relative_to(built.out).as_posix() for p in built.out.rglob("*") if p.is_file()}
    draft = {name for name in CONTRACT if not name.endswith(".step")}
    assert files == draft | {"manifest.json"}
    entries = {item["path"]: item for item in manifest_of(built.out)["files"]}
    assert set(entries) == draft
    for path, item in entries.items():
        assert item["sha256"] == cache.file_hash(built.out / path)
        assert item["bytes"] == (built.out / path).stat().st_size
    # What other tests have made of the same design is taken from the cache.
    assert {*built.ran, *built.cached} == {stage.name for stage in STAGES}


def test_report_holds_the_figures(built: BuildResult) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    assert report["markers"]["count"] == 112
    assert report["markers"]["density_per_cm2"] == pytest.approx(112 / (0.6 * np.pi * 60), rel=1e-9)
    seen = report["visibility"]
    for key in ("occluded", "fused", "min_visible_fraction", "min_visible_px", "min_gap_px"):
        assert key in seen
    assert seen["occluded"] == 0
    assert report["shell"]["watertight"] is True
    assert report["shell"]["bodies"] == 1
    assert report["shell"]["genus"] == 113
    assert "volume_difference" not in report["shell"]  # of a STEP file, which a draft has not
    for table in ("decoder", "decoder_frames"):
        for name in ESTIMATORS:
            row = report[table][name]
            assert {"mae_N", "relative_error", "samples"} <= row.keys()
    assert report["decoder"]["koi_inverse"]["relative_error"] < 0.25
    assert report["frames"]["koi_missed"] == 0
    assert report["frames"]["koi_false"] == 0
    assert set(report["timing_s"]) == {s.name for s in STAGES if s.name != "report"} | {"total"}


def test_page_opens_alone(built: BuildResult) -> None:
    page = (built.out / "report" / "report.html").read_text()
    for marker in ('src="http', "src='http", "<link", "<script src"):
        assert marker not in page
    assert "In simulation" in page or "in simulation" in page
    assert "camera.focal_px" in page


def test_second_build_is_all_cache(built: BuildResult, tmp_path: Path) -> None:
    again = build(small(), tmp_path / "again", accuracy=QUICK, progress=quiet)
    assert again.ran == ()
    first, second = manifest_of(built.out), manifest_of(again.out)
    assert first == second


def test_resolved_design_rebuilds_the_same(built: BuildResult, tmp_path: Path) -> None:
    design = parse_design(tomllib.loads((built.out / "design.toml").read_text()), "resolved")
    again = build(design, tmp_path / "again", accuracy=QUICK, progress=quiet)
    assert again.ran == ()
    assert manifest_of(again.out) == manifest_of(built.out)


def test_a_draft_has_no_molds_unless_they_are_named(built: BuildResult, tmp_path: Path) -> None:
    draft = build(small(), tmp_path / "draft", accuracy="draft", progress=quiet)
    for folder in ("mold", "kit", "bench", "inserts"):
        assert not (draft.out / folder).exists()
    assert (draft.out / "shell" / "shell.stl").is_file()
    report = json.loads((draft.out / "report" / "report.json").read_text())
    assert "quick settings" in report["fabrication"]["mold_left_out"]
    assert any("--set step=true --set tools=true" in text for text in report["changes"])
    plain = replace(COARSE, step=False)
    step = build(tiny(), tmp_path / "step", accuracy=plain, only=["step"], progress=quiet)
    assert (step.out / "shell" / "shell.step").is_file()
    before = {path for path in draft.out.rglob("*") if path.is_file()}
    build(small(), draft.out, accuracy="draft", only=["mold"], progress=quiet)
    names = {path.name for path in (draft.out / "mold").iterdir()}
    assert names == {path.name for path in (built.out / "mold").iterdir()}
    assert all(path.is_file() for path in before), "a named part is added to a draft"
    assert manifest_of(draft.out)["accuracy"] == "draft"


def test_same_inputs_give_the_same_files(
    built: BuildResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From an empty cache: all files but those that hold times, and STEP (``test_cad``)."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    only = ["shell", "mesh", "decoder"]
    again = build(small(), tmp_path / "again", accuracy=QUICK, only=only, progress=quiet)
    first = {item["path"]: item["sha256"] for item in manifest_of(built.out)["files"]}
    second = {item["path"]: item["sha256"] for item in manifest_of(again.out)["files"]}
    assert len(second) > 8
    for path, digest in second.items():
        assert first[path] == digest, path


def test_a_spiral_whose_straight_rows_cannot_be_made_is_not_compared(tmp_path: Path) -> None:
    from phytac_design.design.accuracy import PRESETS
    from phytac_design.design.design_file import load_design
    from phytac_design.engine.stage import Context
    from phytac_design.stages.views_stage import run_compare

    context = Context(design=load_design("cylinder60-dense"), accuracy=PRESETS["draft"], seed=0)
    run_compare(context, tmp_path)
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["straight"] is None
    assert "hidden by nearer ones at every height" in facts["why"]


def test_only_runs_what_is_needed(tmp_path: Path, built: BuildResult) -> None:
    result = build(small(), tmp_path / "x", accuracy="draft", only=["mesh"], progress=quiet)
    assert result.cached == ("mesh",)
    assert {p.name for p in (tmp_path / "x" / "mesh").iterdir()} == {
        "shell.inp",
        "shell.msh",
        "shell.vtu",
    }
    with refused("stage-unknown") as caught:
        build(small(), tmp_path / "y", only=["mseh"], progress=quiet)
    caught.match("did you mean 'mesh'")
    assert not (tmp_path / "y").exists()


def test_partial_build_of_a_changed_design_leaves_nothing_stale(
    tmp_path: Path, built: BuildResult
) -> None:
    out = tmp_path / "x"
    shutil.copytree(built.out, out)
    softer = small(material={"modulus_MPa": 1900.0})
    build(softer, out, accuracy="draft", only=["mesh"], progress=quiet)
    files = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert files == {
        "design.toml",
        "manifest.json",
        "mesh/shell.inp",
        "mesh/shell.msh",
        "mesh/shell.vtu",
    }


def test_another_designs_folder_is_safe(tmp_path: Path, built: BuildResult) -> None:
    out = tmp_path / "x"
    shutil.copytree(built.out, out)
    before = manifest_of(out)
    with refused("output-foreign") as caught:
        build(small(name="other"), out, accuracy="draft", only=["mesh"], progress=quiet)
    caught.match("'small', not 'other'")
    assert manifest_of(out) == before
    foreign = tmp_path / "mine"
    foreign.mkdir()
    (foreign / "thesis.tex").write_text("precious")
    with refused("output-foreign"):
        build(small(), foreign, accuracy="draft", only=["mesh"], progress=quiet)
    forced = build(
        small(name="other"), out, accuracy="draft", only=["mesh"], force=True, progress=quiet
    )
    assert manifest_of(forced.out)["design"]["name"] == "other"


def test_another_designs_build_that_ends_first_is_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both find the folder empty when they begin."""
    out, other, run = tmp_path / "x", small(name="other"), run_stages

    def run_after_another(*words: Any, **options: Any) -> Any:
        done = run(*words, **options)
        monkeypatch.undo()
        build(other, out, accuracy="draft", only=["mesh"], progress=quiet)
        return done

    monkeypatch.setattr("phytac_design.stages.build.run_stages", run_after_another)
    with refused("output-foreign") as caught:
        build(small(), out, accuracy="draft", only=["mesh"], progress=quiet)
    caught.match("'other', not 'small'")
    assert manifest_of(out)["design"]["name"] == "other"


def test_interrupted_build_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C in the second stage: the first is kept, nothing half-made is, a re-run finishes."""
    monkeypatch.setenv("PHYTAC_CACHE", str(tmp_path / "cache"))
    design = small(description="interrupted")

    def stop_inside_the_shell(text: str) -> None:
        if "painted bodies" in text:
            raise KeyboardInterrupt

    def stop_at_step(text: str) -> None:
        if "step …" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(
            design, tmp_path / "x", accuracy="draft", only=["shell"], progress=stop_inside_the_shell
        )
    assert list((tmp_path / "cache" / "shell").iterdir()) == []
    with pytest.raises(KeyboardInterrupt):
        build(design, tmp_path / "x", accuracy="draft", only=["step"], progress=stop_at_step)
    result = build(design, tmp_path / "x", accuracy="draft", only=["step"], progress=quiet)
    assert result.cached == ("shell",)
    assert result.ran == ("step",)
    assert not [p for p in (tmp_path / "cache").rglob(".*") if p.is_dir()]


def test_without_lib3mf_only_the_3mf_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Linux on ARM, which lib3mf has no wheel for."""
    monkeypatch.setitem(sys.modules, "lib3mf", None)
    reports: list[str] = []
    context = Context(design=small(), accuracy=PRESETS["draft"], seed=0, progress=reports.append)
    run_shell(context, tmp_path)
    files = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert files == {"shell.stl", "facts.json"}
    assert any("3MF left out (lib3mf is not installed" in report for report in reports)
    assert "lib3mf" in json.loads((tmp_path / "facts.json").read_text())["3mf_left_out"]


@pytest.mark.usefixtures("coarse_switches")
@pytest.mark.long
def test_without_graphics_libraries_only_the_step_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A machine without libGL: cadquery cannot be imported."""
    from phytac_design.engine import stage
    from phytac_design.stages import shell_stage

    def absent(*_: object, **__: object) -> None:
        raise MissingPartError("missing-library", "no CAD: libGL.so.1 is missing")

    none = {"libEGL.so.1": False, "libGL.so.1": False, "libX11.so.6": False}
    monkeypatch.setattr(stage, "graphics_libraries", lambda: none)
    monkeypatch.setattr("phytac_design.stages.shell_stage.shell_cad", absent)
    monkeypatch.setattr("phytac_design.fabrication.hardware.by_cad.cadquery", absent)
    assert shell_stage.STEP.graphics
    result = build(fused(), tmp_path / "x", accuracy=COARSE, force=True, progress=quiet)
    files = {p.relative_to(result.out).as_posix() for p in result.out.rglob("*") if p.is_file()}
    left_out = {name for name in CONTRACT if name.endswith(".step") or "straight" in name}
    assert files == (CONTRACT | {"manifest.json"}) - left_out
    report = json.loads((result.out / "report" / "report.json").read_text())
    assert "libGL" in report["shell"]["step_left_out"]
    # Markers that fuse do not stop a build that is forced.
    assert report["visibility"]["fused"] > 0
    assert "verdict bad" in (result.out / "report" / "report.html").read_text()


@pytest.mark.usefixtures("coarse_switches")
@pytest.mark.long
def test_a_shell_that_the_cad_kernel_cannot_fuse_is_printed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise CadKernelError(
            "cad-fuse-failed", "OpenCASCADE cannot fuse receptors and wall: 4 solids instead of 1"
        )

    monkeypatch.setattr("phytac_design.stages.shell_stage.shell_cad", broken)
    only = ["step", "hardware"]
    said: list[str] = []
    design = tiny()
    result = build(design, tmp_path / "x", accuracy=COARSE, only=only, progress=said.append)
    assert any("the assembly holds the wall without receptors" in line for line in said)
    assert any("step: left out (OpenCASCADE cannot fuse" in line for line in said)
    assert (result.out / "shell" / "shell.stl").exists()
    assert not (result.out / "shell" / "shell.step").exists()
    assert (result.out / "fixtures" / "assembly.step").exists()


def test_unwritable_folder(tmp_path: Path) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("")
    with refused("output-not-writable"):
        build(small(), blocker / "x", accuracy="draft", only=["mesh"], progress=quiet)


def test_built_frames_decode(built: BuildResult) -> None:
    bundle = load_bundle(built.out / "decoder")
    rest = read_image(built.out / "views" / "frame_rest.png")
    frame = read_image(built.out / "views" / "frame_pressed.png")
    truth = json.loads((built.out / "views" / "frame_pressed.json").read_text())
    measured = measure_frame(bundle, frame, rest_px=rest_positions(bundle, rest))
    forces = measured.forces_N(bundle, "koi_inverse")
    assert set(measured.koi) == {int(key) for key in truth}
    assert forces.sum() == pytest.approx(sum(truth.values()), rel=0.3)
    assert measured.warnings(bundle, forces) == []
    moved = np.roll(frame, (3, 4), axis=(0, 1))
    shaken = measure_frame(bundle, moved, rest_px=rest_positions(bundle, rest))
    (first, *_) = shaken.warnings(bundle, shaken.forces_N(bundle, "koi_inverse"))
    assert "since the rest frame, more than is corrected" in first
    half = frame.copy()
    half[:, : frame.shape[1] * 2 // 5] = 0
    covered = measure_frame(bundle, half, rest_px=rest_positions(bundle, rest))
    assert "markers were found" in covered.warnings(bundle, np.zeros(112))[0]
    noise = np.random.default_rng(0).integers(0, 256, frame.shape, dtype=np.uint8)
    with refused("blobs-too-many"):
        measure_frame(bundle, noise)
    unloaded = measure_frame(bundle, rest, rest_px=rest_positions(bundle, rest))
    assert len(unloaded.koi) == 0
    assert np.abs(unloaded.shift_px).max() == 0.0
    black = np.zeros_like(frame)
    with refused("markers-not-found"):
        measure_frame(bundle, black)


def test_rest_positions_are_close_in_mm(built: BuildResult) -> None:
    """Rest coordinates of one noisy frame, on the surface: the paper reports 0.18 mm RMSE."""
    bundle = load_bundle(built.out / "decoder")
    rest = rest_positions(bundle, read_image(built.out / "views" / "frame_rest.png"))
    error = np.linalg.norm(rest - bundle.rest_px, axis=1)
    assert np.sqrt((error**2).mean()) < 0.1


@pytest.mark.parametrize("name", ["cylinder60", "cylinder40"])
def test_shipped_designs_pass_their_checks(name: str) -> None:
    from phytac_design.rules.check import check_design

    sensor = check_design(load_design(name))
    assert sensor.markers.count == make_markers(load_design(name), sensor.surface).count


def test_resolved_file_is_stable() -> None:
    design = changed(name="again")
    assert to_toml(parse_design(tomllib.loads(to_toml(design)), "x")) == to_toml(design)


def test_every_error_is_a_phytac_error() -> None:
    codes = {kind.__name__: kind.exit_code for kind in PhytacError.__subclasses__()}
    assert len(set(codes.values())) == len(codes)
