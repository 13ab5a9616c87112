"""Parts of the page: pictures of a press, numbers of markers, advice, provenance, files."""

import base64
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_decoder.camera.lens import BrownConrady
from phytac_design.core import html as page
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context, write_arrays, write_facts
from phytac_design.layout.cameras import cameras_of, tolerance_mm
from phytac_design.optics.frame_renderer import render_frame
from phytac_design.optics.loaded_visibility import LoadedVisibility
from phytac_design.optics.render_scene import build_scene
from phytac_design.report import explorer, press_pictures, verdict
from phytac_design.report.report_sections import unbounded_words
from phytac_design.stages.build import BuildResult, copy_of
from phytac_design.stages.loaded_views_stage import Presses
from tests.designs import small


def context_of(folder: Path, arrays: dict[str, dict[str, Any]], **tables: Any) -> Context:
    """Context of a small sensor with a small camera, with arrays as stages would have left them."""
    camera = {"width_px": 324, "height_px": 243, "focal_px": 121.0}
    design = small(camera=camera, layout={"rows": 4, "columns": 8}, **tables)
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    for name, values in arrays.items():
        (folder / name).mkdir()
        context.folders[name] = folder / name
        write_arrays(folder / name, values)
    return context


@pytest.mark.parametrize("bent", [False, True])
def test_a_window_is_a_part_of_the_picture(bent: bool) -> None:
    context = Context(design=small(), accuracy=PRESETS["draft"], seed=0)
    camera = cameras_of(context.design, context.surface)[0]
    if bent:
        lens = camera.lens
        flat = {name: getattr(lens, name) for name in ("width_px", "height_px", "fx_px", "fy_px")}
        centre = {"cx_px": lens.cx_px + 3.0, "cy_px": lens.cy_px - 2.0}
        bends = BrownConrady(**flat, **centre, distortion=(-0.1, 0.02, 0.001, -0.002))
        camera = replace(camera, lens=bends)
    low, width, out = np.array([300.0, 200.0]), 324.0, 648
    part = press_pictures.window(camera, low, width, out)
    assert (part.width_px, part.height_px) == (648, 486)
    tips = context.markers.tip_mm
    # Edges of pictures lie half a pixel before the first pixel's centre.
    expected = (camera.project(tips) + 0.5 - low) * (out / width) - 0.5
    assert part.project(tips) == pytest.approx(expected, abs=1e-9)
    near = press_pictures.close_to(camera, tips[20], 640)
    middle = near.project(tips[20][None])[0]
    assert (middle > 0.0).all()
    assert (middle < [near.width_px, near.height_px]).all()


def test_pictures_go_from_rest_to_the_full_force(tmp_path: Path) -> None:
    n = 32
    motion = np.zeros((n, 6))
    motion[9, :3] = [0.0, 0.0, 3.0]
    context = context_of(tmp_path, {})
    assert press_pictures.PressPictures.from_arrays({}) is None
    camera_number = np.zeros(n, dtype=int)
    made = press_pictures.press_pictures(context, context.markers.uv[9], motion, camera_number)
    write_arrays(tmp_path, made.arrays())
    with np.load(tmp_path / "arrays.npz") as kept:
        made = press_pictures.PressPictures.from_arrays(kept)
    assert made is not None
    assert (made.marker, made.camera) == (9, 0)
    top = context.design.training.force_max_N
    assert made.force_N == pytest.approx(np.linspace(0.0, top, 6))
    assert made.on[0] == 0
    assert (np.diff(made.on) >= 0).all()
    assert made.on[-1] > 0
    assert len(made.whole) == len(made.close) == 6
    frames = [cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) for data in made.whole]
    camera = cameras_of(context.design, context.surface)[0]
    camera = press_pictures.window(camera, np.zeros(2), camera.width_px, 640)
    tolerance = tolerance_mm(camera, context.markers)
    scene = build_scene(context.sensor, tolerance_mm=tolerance)
    rest = render_frame(scene, camera, samples=4)
    assert np.abs(np.asarray(frames[0]).astype(int) - rest).mean() < 3.0  # but for JPEG
    # The pressed receptor moves: its surroundings change, step by step.
    changed = [
        float(np.abs(np.asarray(frame).astype(int) - np.asarray(frames[0])).mean())
        for frame in frames
    ]
    assert changed[0] == 0.0
    assert changed[-1] > changed[1]

    def red(data: bytes) -> int:
        image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)).astype(
            int
        )
        return int(((image[..., 2] > 130) & (image[..., :2].max(axis=2) < 90)).sum())

    tips = [red(data) for data in made.close]
    assert tips[-1] > 1.2 * tips[0] > 0  # switches that are on show their red sides too
    html = press_pictures.press_slider(made, "(row 1, column 1)", "")
    assert html.count("<img ") == 2 * 6
    assert html.count(" class=&quot;ends&quot;") == 0
    assert html.count('class="ends"') == 4


def test_errors_are_of_the_contacts_nearest_to_a_marker(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    context = context_of(tmp_path, {})
    (u0, u1), (v0, v1) = context.surface.domain
    twin, decoded = {}, {}
    for name, count in (("test", 40), ("anywhere", 25)):
        twin[f"{name}.uv"] = np.column_stack(
            [rng.uniform(u0, u1, count), rng.uniform(v0, v1, count)]
        )
        twin[f"{name}.force_N"] = rng.uniform(1.0, 20.0, count)
        twin[f"{name}.tripped"] = rng.random(count) < 0.8
        decoded[f"{name}.auto"] = twin[f"{name}.force_N"] + rng.normal(0.0, 1.0, count)
    for name, values in (("twin", twin), ("decoder", decoded)):
        (tmp_path / name).mkdir()
        context.folders[name] = tmp_path / name
        write_arrays(tmp_path / name, values)
    found, count = explorer.errors_N(context, "auto")
    own: dict[int, list[float]] = {}
    points = context.surface.point(context.markers.uv)
    for name in ("test", "anywhere"):
        for k, uv in enumerate(twin[f"{name}.uv"]):
            if twin[f"{name}.tripped"][k]:
                away = np.linalg.norm(points - context.surface.point(uv[None]), axis=1)
                error = abs(decoded[f"{name}.auto"][k] - twin[f"{name}.force_N"][k])
                own.setdefault(int(away.argmin()), []).append(float(error))
    assert set(np.flatnonzero(np.isfinite(found))) == set(own)
    for marker, errors in own.items():
        assert found[marker] == pytest.approx(np.mean(errors))
        assert count[marker] == len(errors)


def test_errors_of_a_build_are_those_of_its_tables(built: BuildResult) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    viewer = json.loads((built.out / "report" / "viewer.json").read_text())
    error, count = (
        np.frombuffer(base64.b64decode(item["values"]), "<f4").astype(float)
        for key in ("error_N", "contacts")
        for item in viewer["colourings"]
        if item["key"] == key
    )
    tables = [report[name]["auto"] for name in ("decoder", "decoder_anywhere")]
    assert count.sum() == sum(table["samples"] for table in tables)
    assert (np.isfinite(error) == (count > 0)).all()
    stated = sum(table["mae_N"] * table["samples"] for table in tables)
    assert np.nansum(error * count) == pytest.approx(stated, rel=1e-5)


def test_the_shown_press_is_the_first_to_lose_a_marker_or_moves_most() -> None:
    p = 3
    found = LoadedVisibility(
        hidden=np.zeros(p, int),
        fused=np.zeros(p, int),
        press_gap_same_px=np.array([9.0, 5.0, 7.0]),
        press_gap_other_px=np.ones(p),
        press_crosstalk_px=np.zeros(p),
        shift_px=np.array([2.0, 3.0, 8.0]),
        first_force_N=np.full(p, np.inf),
        first_marker=np.full(p, -1),
        least_fraction=np.ones(4),
        least_gap_same_px=np.ones(4),
        least_gap_other_px=np.ones(4),
        crosstalk_px=np.zeros(4),
        crosstalk_still_px=np.zeros(4),
    )
    done = Presses(uv=np.zeros((p, 2)), motion=np.zeros((p, 4, 6)), found=found, facts={})
    assert done.shown() == 2
    found.first_force_N[:] = [np.inf, 12.0, 20.0]
    assert done.shown() == 1


def test_softness_is_the_inverse_of_what_stiffness_holds(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    n = 32
    shift_to_mm = rng.normal(size=(n, 2))
    compliance = rng.normal(size=(n, 2, n))
    shift_to_mm[5] = 0.0  # a marker out of play
    arrays = {"shift_to_mm": shift_to_mm, "compliance_px": compliance.reshape(2 * n, n)}
    found = explorer.softness_um_N(context_of(tmp_path, {"response": arrays}))
    assert np.isnan(found[5])
    for k in (0, 7, 31):
        assert found[k] == pytest.approx(1e3 * shift_to_mm[k] @ compliance[k, :, k])


def violation(rule: str, fix: str, measured: float) -> dict[str, Any]:
    return {
        "rule": rule,
        "fix": fix,
        "measured": measured,
        "asked": 0.6,
        "unit": "mm",
        "point_mm": [0, 0, 0],
    }


def test_what_to_change_is_gathered(tmp_path: Path) -> None:
    context = context_of(tmp_path, {})
    context = replace(context, accuracy=replace(context.accuracy, step=True, tools=True))
    broken = [violation("wall", f"{k} mm² are thin; make the wall thicker", 0.3) for k in range(3)]
    facts: dict[str, dict[str, Any]] = {
        "underload": {"first_force_N": None},
        "printing": {"files": {"shell/shell.stl": {"violations": []}}},
        "switch": {"switches": [{"warnings": ["assumed: a rubber"]}], "refused": ""},
        "hardware": {"parts": []},
        "views": {"visibility": {"switch_unreadable": 0}},
    }
    for name, values in facts.items():
        (tmp_path / name).mkdir(exist_ok=True)
        context.folders[name] = tmp_path / name
        write_facts(tmp_path / name, values)
    assert verdict.changes_of(context, [], {"share": None}) == []
    write_facts(tmp_path / "views", {"visibility": {"switch_unreadable": 8}})
    unread = verdict.changes_of(context, [], {"share": None})
    assert [text.partition(":")[0] for text in unread] == [
        f"the camera cannot read 8 of {context.markers.count} switches"
    ]
    write_facts(tmp_path / "views", {"visibility": {"switch_unreadable": 0}})
    assert verdict.changes_of(context, [], {"share": 0.5}) == []
    draft = replace(context, accuracy=PRESETS["draft"])
    (left_out,) = verdict.changes_of(draft, [], {"share": 0.5})
    assert "without STEP files" in left_out
    load = {"first_force_N": None, "force_N": 8.0, "greatest_shift_px": 0.293}
    write_facts(tmp_path / "underload", load)
    (stiff,) = verdict.changes_of(context, [], {"share": 0.15})
    assert stiff.startswith(
        "only 15 % of the contacts are read within 10 % of their force: 8 N moves no marker's "
        "image by more than 0.29 px. Take a thinner wall"
    )
    write_facts(tmp_path / "underload", {"first_force_N": 12.5})
    hole = violation("hole", "widen the hole", 0.2)
    files = {"shell/shell.stl": {"violations": [*broken, hole]}, "a.stl": {"violations": []}}
    write_facts(tmp_path / "printing", {"files": files})
    spread = {"warnings": ["assumed: x", "the threshold spreads"]}
    write_facts(tmp_path / "switch", {"switches": [spread, spread], "refused": ""})
    found = verdict.changes_of(context, ["2 markers hidden; move the camera back"], {"share": 0.9})
    assert found[0] == "2 markers hidden; move the camera back"
    assert found[1].startswith("from 12.5 N on a marker hides or fuses: ")
    assert found[2].startswith("3 places of shell/shell.stl break the print rule wall")
    assert found[2].endswith("required 0.6 mm): 0 mm² are thin; make the wall thicker")
    assert found[3].startswith("1 place of shell/shell.stl breaks the print rule hole")
    assert found[3].endswith(": widen the hole")
    assert found[4:] == ["the threshold spreads"]
    # What the design's own demand says already is not said twice.
    again = verdict.changes_of(
        context, ["under load markers hide or fuse from 12.5 N on"], {"share": 0.9}
    )
    assert sum("from 12.5 N" in text for text in again) == 1
    # What the build leaves out.
    write_facts(tmp_path / "hardware", {"hardware_left_out": "the ring does not fit"})
    wide = replace(context.accuracy, receptors=True)
    thick = copy_of(context.design, wall={"thickness_mm": 3.0})
    bare = verdict.changes_of(replace(context, design=thick, accuracy=wide), [], {"share": 0.9})
    assert "the build has no mount, light ring and other hardware: the ring does not fit" in bare
    (plain,) = (text for text in bare if text.startswith("the wall is computed without its"))
    tube = thick.receptor.diameter_outer_mm / 3.0
    assert f"(got {tube:.4g})" in plain
    none = copy_of(context.design, hardware={"parts": "none"})
    wanted = verdict.changes_of(replace(context, design=none), [], {"share": 0.9})
    assert not any("no mount" in text for text in wanted)


def test_named_images_become_files() -> None:
    html = page.figure(b"\x89PNG 1", "A & <b>", name="a.png") + page.figure(b"2", "unnamed")
    html += page.image(b"\xff\xd8 3", "pressed", "jpeg", name="b.jpg", extra=' class="ends"')
    assert page.images_of(html) == {"a.png": b"\x89PNG 1", "b.jpg": b"\xff\xd8 3"}
    assert "A &amp; &lt;b&gt;" in html


def test_pages_fetch_nothing_and_run_nothing_without_need() -> None:
    plain = page.page("t", [("A head", "x")], "lead")
    assert "default-src 'none'" in plain
    assert "script-src 'none'" in plain
    assert "<nav" not in plain
    live = page.page("t", [("A & head", "x")], "lead", tail="<script>1</script>")
    assert '<a href="#a-head">A &amp; head</a>' in live
    assert '<section id="a-head">' in live


def test_the_bound_on_the_error_of_the_mesh_is_shown_or_said_to_be_missing(
    built: BuildResult,
) -> None:
    places = json.loads((built.out / "report" / "report.json").read_text())["places"]
    assert 0.0 < places["mesh_error"] <= places["mesh_error_largest"] < 0.3
    html = (built.out / "report" / "report.html").read_text()
    assert "bound on the mesh&#x27;s error in the tables of auto" in html
    assert "no bound" not in html
    assert unbounded_words(places) == []
    (text,) = unbounded_words({key: places[key] for key in places if "mesh" not in key})
    assert "forces read too large" in text


def test_a_build_says_where_it_comes_from(built: BuildResult) -> None:
    html = (built.out / "report" / "report.html").read_text()
    report = json.loads((built.out / "report" / "report.json").read_text())
    manifest = json.loads((built.out / "manifest.json").read_text())
    made = report["provenance"]
    assert made["design_sha256"] == manifest["design"]["hash"]
    assert made["versions"]["numpy"] == manifest["versions"]["numpy"]
    for text in (made["design_sha256"], made["program_sha256"], "height_far_mm = 6.0"):
        assert text in html
    images = page.images_of(html)
    assert {"shell.png", "layout.png", "pressed_all_0.jpg", "softness.png"} <= set(images)
    written = {path.name: path.read_bytes() for path in (built.out / "report" / "images").iterdir()}
    assert written == images
    for name in report["timing_s"]:
        if name != "total":
            assert f">{name}</th>" in html
    assert len(html.encode()) < 15e6
