"""Designs that a build refuses or stops at: nothing half-written, one clear reason."""

from pathlib import Path

import pytest

from phytac_design.mechanics.switch import bowl_check
from phytac_design.stages.build import build
from tests.designs import COARSE, fused, small, tiny
from tests.refusals import refused


def quiet(_: str) -> None:
    """No progress."""


REFUSALS = [
    ({"wall": {"thickness_mm": 31.0}}, "wall-too-thick"),
    ({"layout": {"height_far_mm": 31.0}}, "tips-collide"),
    ({"layout": {"columns": 80}}, "receptors-too-close"),
    (
        {"receptor": {"diameter_hole_mm": 2.6}, "switch": {"tip_diameter_mm": 1.0}},
        "tube-wall-too-thin",
    ),
    ({"camera": {"stand_off_mm": -5.0}}, "camera-inside-sensor"),
    ({"camera": {"stand_off_mm": 5.0}}, "rim-outside-view"),
    ({"light": {"bar_radius_mm": 25.0}}, "light-bar-hits-tips"),
    ({"switch": {"release_N": 0.6}}, "release-above-threshold"),
    ({"switch": {"threshold_N": 1000.0}}, "threshold-unreachable"),
    ({"training": {"patch_radius_max_mm": 1000.0}}, "patch-exceeds-sensor"),
    ({"switch": {"material": "unobtainium"}}, "rubber-unknown"),
    ({"hardware": {"screw_clamp": "M5"}}, "set-screw-edge-distance"),
    ({"layout": {"rows": 2000, "columns": 2000}}, "too-many-markers"),
]


@pytest.mark.parametrize(("change", "code"), REFUSALS, ids=lambda v: str(v)[:40])
def test_impossible_designs_write_nothing(change: dict, code: str, tmp_path: Path) -> None:
    seen: list[str] = []
    with refused(code):
        build(small(**change), tmp_path / "x", accuracy="draft", progress=seen.append)
    assert seen == []  # refused before any stage
    assert not (tmp_path / "x").exists()


def test_markers_that_fuse_stop_the_build(tmp_path: Path) -> None:
    """Unless it is forced: ``test_build.test_without_graphics_libraries…``."""
    seen: list[str] = []
    with refused("build-gate") as caught:
        build(fused(), tmp_path / "x", accuracy=COARSE, progress=seen.append)
    caught.match("layout.kind")
    assert not any("shell" in text for text in seen)
    assert not (tmp_path / "x" / "manifest.json").exists()


def test_markers_too_small_to_see_are_refused_not_decoded(tmp_path: Path) -> None:
    design = small(name="far", camera={"stand_off_mm": 2000.0})
    with refused("build-gate") as caught:
        build(design, tmp_path / "x", accuracy="draft", progress=quiet)
    caught.match("rows 0 to 7")


@pytest.mark.usefixtures("coarse_switches")
def test_switches_that_cannot_be_made_stop_the_build_unless_forced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bowl_check, "FILLETS", bowl_check.FILLETS[:1])
    design = tiny(name="unmade", switch={"modulus_MPa": 0.1})
    with refused("build-gate") as caught:
        build(design, tmp_path / "x", accuracy=COARSE, progress=quiet)
    caught.match("--force")
    assert not (tmp_path / "x").exists()
    only = ["printing", "bench"]
    build(design, tmp_path / "x", accuracy=COARSE, only=only, force=True, progress=quiet)
    made = {path.name for path in (tmp_path / "x").iterdir()}
    assert made == {"design.toml", "manifest.json", "shell"}
