import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_design.design.accuracy import PRESETS
from phytac_design.fabrication.hardware import assembly_checks
from phytac_design.fabrication.hardware.by_cad import CadKernel
from phytac_design.fabrication.hardware.sensor_solids import exploded_bodies
from phytac_design.layout.sensor import Sensor
from phytac_design.solids.mesh_facts import trimesh_facts
from phytac_design.solids.solid_mesh import to_manifold
from phytac_design.stages.hardware_stage import HARDWARE
from phytac_shapes.errors import MissingPartError
from tests.fabrication.hardware_cases import case, changed, context
from tests.refusals import refused


def run(folder: Path, name: str = "hemisphere", /, **tables: Any) -> dict[str, Any]:
    """Facts of the stage, files in ``folder / "out"``; STL only."""
    out = folder / "out"
    out.mkdir()
    HARDWARE.run(context(changed(name, **tables), folder), out)
    facts: dict[str, Any] = json.loads((out / "facts.json").read_text())
    return facts


def files(folder: Path) -> dict[str, str]:
    """Hash of every exported file."""
    top = folder / "out" / "export"
    return {
        path.relative_to(top).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(top.rglob("*.*"))
    }


@pytest.fixture
def no_cad(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine without the libraries that CadQuery links."""

    def missing() -> None:
        raise MissingPartError("missing-library", "no CAD: libGL.so.1 is missing")

    monkeypatch.setattr("phytac_design.fabrication.hardware.by_cad.cadquery", missing)


@pytest.mark.usefixtures("no_cad")
def test_without_cad_the_printable_files_are_all_there(tmp_path: Path) -> None:
    facts = run(tmp_path)
    assert "libGL" in facts["step_left_out"]
    assert set(files(tmp_path)) == {"fixtures/cover.stl", "fixtures/mount.stl"}
    assert {part["file"] for part in facts["parts"] if part["material"] == "resin"} == set(
        files(tmp_path)
    )


@pytest.mark.usefixtures("no_cad")
def test_facts_name_parts_screws_gaps_and_checks(tmp_path: Path) -> None:
    facts = run(tmp_path)
    parts = {part["part"]: part for part in facts["parts"]}
    assert parts["screw ISO 4762 M2 x 16"]["count"] == 4
    assert parts["screw ISO 4026 M2.5 x 3"]["count"] == 4
    assert parts["camera"]["file"] == ""
    for part in facts["parts"]:
        assert {"part", "file", "count", "material", "volume_mm3", "note"} == set(part)
        if part["file"]:
            path = tmp_path / "out" / "export" / part["file"]
            data = np.frombuffer(
                path.read_bytes()[84:],
                dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")],
            )
            a, b, c = np.moveaxis(data["v"].astype(np.float64), 1, 0)
            volume = float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)
            assert volume == pytest.approx(part["volume_mm3"], rel=1e-5)
    joints = {joint["joint"]: joint for joint in facts["joints"]}
    assert joints["camera"]["measured_head_side"] == joints["camera"]["measured_thread_side"]
    assert all(joint["agree"] for joint in joints.values())
    assert facts["interference"] == {"bodies": 14, "pairs": 91, "shared_mm3": 0}
    assert facts["light"]["leaks"] == facts["view"]["lines_cut"] == 0
    clearance = case("hemisphere")[0].print_rules.clearance_mm
    assert set(facts["clearances_mm"].values()) == {clearance}


@pytest.mark.usefixtures("no_cad")
def test_every_file_follows_the_design(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Half of the time of the checks, which do not change files.
    monkeypatch.setattr(assembly_checks, "meets", lambda _: {})
    base = tmp_path / "base"
    base.mkdir()
    run(base)
    changes: tuple[dict[str, dict[str, float]], ...] = (
        {"wall": {"rim_flange_mm": 2.0}},
        {"print_rules": {"clearance_mm": 0.3}},
        {"camera": {"stand_off_mm": 21.0}},
    )
    for number, tables in enumerate(changes):
        folder = tmp_path / str(number)
        folder.mkdir()
        run(folder, "hemisphere", **tables)
        before, after = files(base), files(folder)
        assert before.keys() == after.keys()
        assert before["fixtures/mount.stl"] != after["fixtures/mount.stl"], tables


@pytest.mark.usefixtures("no_cad")
def test_defaults_never_stop_a_build(tmp_path: Path) -> None:
    facts = run(tmp_path, wall={"rim_length_mm": 0.0})
    assert "without rims" in facts["hardware_left_out"]
    assert (facts["parts"], files(tmp_path)) == ([], {})


def test_without_switches_there_is_no_hardware(tmp_path: Path) -> None:
    made = context(changed("hemisphere"), tmp_path)
    facts = {"refused": "no bowl fits", "switches": [], "parts": []}
    (made.folders["switch"] / "facts.json").write_text(json.dumps(facts))
    out = tmp_path / "out"
    out.mkdir()
    HARDWARE.run(made, out)
    facts = json.loads((out / "facts.json").read_text())
    assert "no bowl fits" in facts["hardware_left_out"]
    assert (facts["parts"], files(tmp_path)) == ([], {})


@pytest.mark.usefixtures("no_cad")
def test_a_sensor_without_switches_is_assembled_all_the_same(tmp_path: Path) -> None:
    made = context(changed("hemisphere", receptor={"diameter_hole_mm": 0.0}), tmp_path)
    absent = {"refused": "", "absent": "the design has no switches", "switches": [], "parts": []}
    (made.folders["switch"] / "facts.json").write_text(json.dumps(absent))
    out = tmp_path / "out"
    out.mkdir()
    HARDWARE.run(made, out)
    facts = json.loads((out / "facts.json").read_text())
    assert set(files(tmp_path)) == {"fixtures/cover.stl", "fixtures/mount.stl"}
    # The same parts, with the switches' body missing.
    assert facts["interference"]["bodies"] == 13
    assert facts["light"]["holes_uncovered"] == facts["light"]["leaks"] == 0


@pytest.mark.usefixtures("no_cad")
def test_hardware_can_be_left_out(tmp_path: Path) -> None:
    assert "parts" in run(tmp_path, hardware={"parts": "none"})["hardware_left_out"]
    assert files(tmp_path) == {}


@pytest.mark.parametrize(
    ("hardware", "code"),
    [
        ({"screw_clamp": "M6"}, "set-screw-edge-distance"),
        # Holes that the lens covers: found by the collision of the solids.
        ({"board_holes_mm": ((8.0, 0.0), (-8.0, 0.0))}, "hardware-collides"),
    ],
)
def test_refusals_leave_nothing_behind(tmp_path: Path, hardware: dict[str, Any], code: str) -> None:
    with refused(code):
        run(tmp_path, hardware=hardware)
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.usefixtures("no_cad")
def test_exploded_bodies_come_apart(tmp_path: Path) -> None:
    made = context(changed("hemisphere"), tmp_path)
    bodies = exploded_bodies(Sensor.of(made.design, made.surface, made.markers), tolerance_mm=0.05)
    assert {"shell", "mount", "cover", "camera", "ring_light"} <= set(bodies)
    assert not bodies["shell"][1].any()
    moved = {
        name: to_manifold(mesh).translate(tuple(way)).bounding_box()
        for name, (mesh, way) in bodies.items()
        if not name.startswith("screw")
    }
    # Away from the sensor: the cover last.
    assert moved["cover"][5] < moved["camera"][2] + 10.0
    assert moved["cover"][2] < moved["camera"][2] < moved["mount"][2]
    assert moved["ring_light"][2] > to_manifold(bodies["ring_light"][0]).bounding_box()[2] + 5.0
    for mesh, _ in bodies.values():
        assert trimesh_facts(mesh).watertight


def test_kernels_that_disagree_stop_the_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("cadquery", exc_type=ImportError)
    right = CadKernel.solid

    def wrong(self: CadKernel, node: Any) -> Any:
        return right(self, node).scale(1.001)

    monkeypatch.setattr(CadKernel, "solid", wrong)
    with refused("hardware-solid-unsound"):
        run(tmp_path)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_draft_has_no_step_files(tmp_path: Path) -> None:
    made = context(changed("hemisphere"), tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    HARDWARE.run(replace(made, accuracy=PRESETS["draft"]), out)
    assert set(files(tmp_path)) == {"fixtures/cover.stl", "fixtures/mount.stl"}
