"""The report: maps of every shape, names, unusable estimators, the verdict, two cameras."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_design.core import html as page
from phytac_design.design.accuracy import PRESETS
from phytac_design.engine.stage import Context, write_arrays, write_facts
from phytac_design.geometry import flat_map
from phytac_design.layout import make_markers
from phytac_design.layout.cameras import cameras_of
from phytac_design.report import (
    figure_names,
    report_figures,
    report_sections,
    score_tables,
    verdict,
)
from phytac_design.report.report_figures import MAP, Drawing
from phytac_design.stages.build import BuildResult
from phytac_design.stages.report_stage import forced_past
from phytac_design.stages.views_stage import run_views, summary_of
from tests.designs import DRAWN, drawn, small

FAMILIES = {
    "cylinder": "tube",
    "cone": "tube",
    "cuboid": "tube",
    "grip": "tube",
    "hemisphere": "dome",
    "plane": "sheet",
    "patch": "sheet",
}
NO_LIMITS: dict[str, Any] = {
    "fem_unusable_count": 0,
    "fem_noise_N_median": 0.1,
    "force_unreadable": [],
    "switches_unreadable": [],
}


def a_score(error: float = 0.1) -> dict[str, Any]:
    one = {"mae_N": 0.2, "sd_N": 0.3, "relative_error": error, "samples": 9}
    return one | {group: dict(one) for group in score_tables.GROUPS}


def a_report(**changes: Any) -> dict[str, Any]:
    """What the verdict reads, of a sensor without fault."""
    table = {name: a_score() for name in ("fem", "fem_nn", "fem_nn_identity", "koi_inverse")}
    good: dict[str, Any] = {
        "description": "a <b>",
        "forced": [],
        "cameras": [{"end": "near"}],
        "visibility": {"occluded": 0, "fused": 0},
        "under_load": {
            "force_N": 25.0,
            "presses": 8,
            "first_force_N": None,
            "not_solved": 0,
        },
        "limits": [],
        "read_well": {"contacts": 60, "share": 0.95, "middle": 1.0, "near_rims": None},
        "shell": {"watertight": True},
        "switch": {
            "refused": "",
            "switches": [{"threshold_N": 0.5, "spread": {"low_N": 0.4, "high_N": 0.6}}],
        },
        "fabrication": {
            "print_violations": 0,
            "print_unchecked": [],
            "print_process": "sla",
            "interference_mm3": 0.0,
            "mold": {"cavities": 40, "undercut_mm2": 0},
            "mold_left_out": "",
        },
        "frames": {"refused": 0, "frames": 5, "first_refusal": ""},
        "markers": {"count": 40, "density_per_cm2": 1.6, "surface_class": "parallel"},
        "decoder": table,
        "decoder_frames": table,
    }
    return good | changes


@pytest.mark.parametrize("kind", sorted(DRAWN))
def test_maps_have_the_sense_that_they_state(kind: str) -> None:
    design = drawn(kind, 0)
    surface = design.surface()
    markers = make_markers(design, surface)
    flat = flat_map.flat_map(surface, markers.uv)
    assert flat_map.surface_topology(surface) == FAMILIES[kind]
    assert len(np.unique(flat.points.round(6), axis=0)) == markers.count
    (low, high), places = flat.limits, flat.points
    assert ((places > low) & (places < high)).all()
    pixels = cameras_of(design, surface)[0].project(markers.tip_mm)
    if FAMILIES[kind] == "tube":
        assert "as seen from outside" in flat.note
        assert not flat.y_down
        return
    assert flat.y_down
    # Same place, same sense: right is right and down is down in the picture.
    for axis in (0, 1):
        assert np.corrcoef(places[:, axis], pixels[:, axis])[0, 1] > 0.95
    assert "around" not in flat.x_label


def test_a_dome_is_spread_from_its_pole() -> None:
    surface = drawn("hemisphere", 1).surface()
    (u0, u1), _ = surface.domain
    uv = np.array([[u1, 1.0], [u0, 0.0], [u0, np.pi / 2.0], [(u0 + u1) / 2.0, np.pi]])
    places = flat_map.flat_map(surface, uv).points
    length = u1 - u0  # the chart of a dome is the length of its meridian
    expected = [[0.0, 0.0], [length, 0.0], [0.0, length], [-length / 2.0, 0.0]]
    assert places == pytest.approx(np.array(expected), abs=1e-9)


def test_a_plane_is_drawn_from_its_centre_and_a_patch_from_its_corner() -> None:
    plane, patch = (drawn(kind, 2).surface() for kind in ("plane", "patch"))
    middle = plane.domain.mean(axis=1)[None]
    assert flat_map.flat_map(plane, middle).points == pytest.approx(np.zeros((1, 2)))
    assert "from its centre" in flat_map.flat_map(plane, middle).x_label
    corner = patch.domain[:, 0][None]
    assert flat_map.flat_map(patch, corner).points == pytest.approx(np.zeros((1, 2)))
    assert "from its corner" in flat_map.flat_map(patch, corner).x_label


def test_a_map_does_not_keep_what_it_showed_before() -> None:
    places = np.random.default_rng(0).random((50, 2)) * 60.0
    flat = flat_map.FlatMap(
        points=places, outline=(), x_label="x", y_label="y", y_down=False, note="flat"
    )
    other = {"label": "other", "marked": places[:, 0] > 30.0, "cross": np.array([9.0, 9.0])}
    again = report_figures.ValueMap(flat, ["blue"] * 50)
    first = again.png(places[:, 0], label="mm")
    assert again.png(1e4 * places[:, 1], **other) != first
    assert again.png(places[:, 0], label="mm") == first
    fresh = report_figures.ValueMap(flat, ["blue"] * 50)
    assert fresh.png(places[:, 0], label="mm") == first


@pytest.mark.parametrize("sides", [(200.0, 40.0), (60.0, 60.0), (30.0, 120.0)])
def test_the_colour_bar_is_as_tall_as_the_map(sides: tuple[float, float]) -> None:
    places = np.random.default_rng(0).random((50, 2)) * sides
    flat = flat_map.FlatMap(
        points=places, outline=(), x_label="x", y_label="y", y_down=False, note="flat"
    )
    wide, tall = report_figures.map_size_in(flat)
    extent = flat.limits[1] - flat.limits[0]
    assert wide / tall == pytest.approx(extent[0] / extent[1], rel=1e-6)
    data = report_figures.ValueMap(flat, ["blue"] * 50).png(places[:, 0], label="mm")
    image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    top = MAP.above_in * 130
    bottom = top + tall * 130
    at = round((MAP.left_in + wide + MAP.gap_in + MAP.bar_in / 2.0) * 130)
    bar = np.flatnonzero(np.ptp(image[:, at].astype(int), axis=1) > 40)
    assert (bar[0], bar[-1]) == (pytest.approx(top, abs=3), pytest.approx(bottom, abs=3))
    edge = round(MAP.left_in * 130)
    frame = np.flatnonzero((image[:, edge - 2 : edge + 3] < 90).all(axis=2).any(axis=1))
    assert frame[0] == pytest.approx(top, abs=3)
    assert bottom - 3 <= frame[-1]


def test_figures_that_do_not_exist_are_dashes_with_their_reason() -> None:
    for value in (None, float("nan"), float("inf"), ""):
        assert page.number(value) == "–"
    html = figure_names.facts({"first_force_N": None, "odd": None, "presses": 3}, "under_load")
    assert "– (nothing hides or fuses)" in html
    assert ">smallest force at which a marker hides or fuses (N)<" in html
    assert 'title="under_load.odd">odd</th><td>–</td>' in html
    assert "None" not in html
    assert page.number([[0.0, 1.0], [2.0, 3.5]]) == "0, 1; 2, 3.5"
    assert page.number(list(range(40))).endswith("11 … (40)")
    assert page.number([]) == "none"
    assert page.number(23456.7) == "23457"
    assert page.number(1.23456e-5) == "1.2e-05"


def test_estimators_that_cannot_be_used_are_marked() -> None:
    table = {name: a_score() for name in ("fem", "koi_inverse")}
    clean = score_tables.score_table(table, NO_LIMITS, 40)
    assert "†" not in clean
    assert "weak" not in clean
    some = NO_LIMITS | {"fem_unusable_count": 3, "fem_noise_N_median": 7.25}
    html = score_tables.score_table(table, some, 40)
    assert ">fem†<" in html
    assert ">koi_inverse<" in html
    assert "At 3 of 40 markers" in html
    assert "7.25 N" in html
    assert "class=weak" not in html  # 3 of 40 are less than a tenth
    half = score_tables.score_table(table, some | {"fem_unusable_count": 20}, 40)
    assert '<tr class=weak><th scope="row">fem†<' in half
    assert half.count("class=weak") == 1
    blind = score_tables.score_table(table, some | {"force_unreadable": [1, 2, 3, 4]}, 40)
    assert ">fem†‡<" in blind
    assert ">koi_inverse‡<" in blind
    assert blind.count("class=weak") == 2
    table["fem"]["below_5N"]["relative_error"] = float("nan")
    empty = score_tables.score_table(table, NO_LIMITS, 40)
    assert "<td>–</td>" in empty
    assert "no such contacts" in empty


def test_verdict_of_a_sensor_without_fault() -> None:
    found = verdict.findings(a_report())
    assert {item.level for item in found} == {"good"}
    html = verdict.lead(a_report())
    assert html.count('class="verdict good"') == 5  # the whole, and each of four answers
    for answer in ("Seen? yes", "Printed? yes", "Cast? yes", "Decoded? yes"):
        assert f"<h2>{answer}</h2>" in html
    assert "To change:</strong> nothing" in html
    assert "a &lt;b&gt;" in html


def test_each_answer_is_to_its_own_question() -> None:
    forced = {"forced": ["no bowl fits"], "switch": {"refused": "no bowl fits", "switches": []}}
    html = verdict.lead(a_report(**forced, limits=["a limit"], changes=["make <it> wider"]))
    for answer in ("Seen? yes", "Printed? yes", "Cast? no", "Decoded? with limits"):
        assert f"<h2>{answer}</h2>" in html
    assert html.count("no bowl fits") == 1  # said once: by what the build was forced past
    assert "<li>Make &lt;it&gt; wider.</li>" in html
    hidden = verdict.lead(a_report(forced=["2 markers hidden"]))
    assert "<h2>Seen? no</h2>" in hidden
    assert "<h2>Cast? yes</h2>" in hidden


@pytest.mark.parametrize(
    ("change", "level", "text"),
    [
        ({"forced": ["2 markers hidden (rows 0 to 1)"]}, "bad", "--force though 2 markers hidden"),
        ({"visibility": {"occluded": 4, "fused": 2}}, "bad", "4 markers are hidden and 2 fuse"),
        (
            {
                "under_load": {
                    "force_N": 25.0,
                    "presses": 8,
                    "first_force_N": 6.254,
                    "first_place": "on marker (row 3, column 4)",
                    "first_marker": "(row 2, column 4)",
                    "not_solved": 0,
                }
            },
            "odd",
            "from 6.254 N on: marker (row 2, column 4), pressed on marker (row 3, column 4)",
        ),
        ({"limits": ["3 of 40 switches cannot be read well"]}, "odd", "3 of 40 switches cannot"),
        (
            {"read_well": {"contacts": 60, "share": 0.7, "middle": 0.9, "near_rims": 0.35}},
            "odd",
            (
                "70 % of 60 simulated contacts anywhere on the surface are read within 10 % of "
                "their force (90 % at middle heights, 35 % towards the rims)"
            ),
        ),
        (
            {"read_well": {"contacts": 60, "share": 0.49, "middle": None, "near_rims": None}},
            "bad",
            "49 % of 60 simulated contacts",
        ),
        ({"shell": {"watertight": False}}, "bad", "NOT watertight"),
        (
            {"fabrication": a_report()["fabrication"] | {"print_violations": 3}},
            "odd",
            "3 places break the rules of the printer (sla)",
        ),
        (
            {"fabrication": a_report()["fabrication"] | {"print_unchecked": ["mount.stl"]}},
            "odd",
            "a draft checks the shell alone against the printer: 1 other parts are not",
        ),
        (
            {"fabrication": a_report()["fabrication"] | {"interference_mm3": 2.0}},
            "bad",
            "overlap by 2 mm",
        ),
        (
            {
                "fabrication": a_report()["fabrication"]
                | {"mold": {"cavities": 40, "undercut_mm2": 3}}
            },
            "bad",
            "the molds catch the switches (3 mm²",
        ),
        (
            {
                "fabrication": a_report()["fabrication"]
                | {"mold_left_out": "no bed is large enough"}
            },
            "odd",
            "no molds: no bed is large enough",
        ),
        (
            {"frames": {"refused": 2, "frames": 5, "first_refusal": "too few blobs"}},
            "odd",
            "2 of 5 rendered frames could not be decoded, the first because too few blobs",
        ),
    ],
)
def test_verdict_says_what_fails(change: dict[str, Any], level: str, text: str) -> None:
    found = verdict.findings(a_report(**change))
    assert any(text in item.text and item.level == level for item in found)
    assert f'class="verdict {level}"' in verdict.lead(a_report(**change))


def test_contacts_that_are_read_well_are_counted_by_height() -> None:
    surface = drawn("cylinder", 0).surface()
    low, high = surface.domain[0]
    span = high - low
    u = low + span * np.array([0.02, 0.04, 0.5, 0.5, 0.5, 0.5, 0.02])
    arrays = {
        "twin": {
            "anywhere.tripped": np.array([True] * 6 + [False]),
            "anywhere.force_N": np.full(7, 10.0),
            "anywhere.uv": np.column_stack([u, np.zeros(7)]),
        },
        "decoder": {"anywhere.auto": np.array([13.0, 9.5, 10.5, 9.1, 11.0, 12.0, 0.0])},
    }
    context: Any = SimpleNamespace(arrays=arrays.__getitem__, surface=surface)
    found = verdict.read_well(context, "auto")
    assert found["contacts"] == 6
    assert [found[key] for key in ("share", "middle", "near_rims")] == pytest.approx(
        [4 / 6, 3 / 4, 1 / 2]
    )
    arrays["twin"]["anywhere.tripped"] = np.zeros(7, dtype=bool)
    assert verdict.read_well(context, "auto")["share"] is None
    none = a_report(read_well=verdict.read_well(context, "auto"))
    assert {item.level for item in verdict.findings(none)} == {"good"}


def test_unreadable_switches_of_a_build_are_the_decoders() -> None:
    seen: Any = SimpleNamespace(
        summary=lambda *, switches: (
            {"occluded": 0} | ({"switch_unreadable": 7} if switches else {})
        ),
        centroid_px=np.zeros((4, 2)),
    )
    rest, out = np.array([0.0, 0.0, 100.0, 100.0]), np.array([3.9, 4.1, 133.9, 134.1])
    found = summary_of(seen, rest, out, switches=True)
    assert found == {"occluded": 0, "switch_unreadable": 2}
    assert summary_of(seen, rest, out, switches=False) == {"occluded": 0}


def test_verdict_without_a_decoded_contact() -> None:
    none = {"koi_inverse": a_score(float("nan")) | {"samples": 0}}
    html = verdict.lead(a_report(decoder=none))
    assert "No simulated contact tripped a switch" in html
    assert "nan" not in html


@pytest.mark.parametrize(
    ("fused", "first_N", "refused", "reasons"),
    [(0, 19.0, "", 0), (2, 19.0, "", 1), (2, 3.0, "", 2), (0, 19.0, "no bowl fits", 1)],
)
def test_a_build_past_a_gate_is_told_from_its_results(
    fused: int, first_N: float, refused: str, reasons: int, tmp_path: Path
) -> None:
    context = Context(
        design=small(demands={"clear_force_N": 10.0}), accuracy=PRESETS["draft"], seed=0
    )
    for name in ("views", "underload", "switch"):
        (tmp_path / name).mkdir()
        context.folders[name] = tmp_path / name
    lost = np.zeros(context.markers.count, dtype=bool)
    views = {"occluded": lost, "fused": lost.copy(), "hidden_by": lost.astype(int)}
    views["fused"][:fused] = True
    views |= {"mark_clear": np.ones(0, dtype=bool), "mark_visible_px": np.zeros(0, dtype=int)}
    write_arrays(tmp_path / "views", views)
    facts = {"first_force_N": first_N, "first_place": "on marker (row 1, column 2)"}
    write_facts(tmp_path / "underload", facts)
    write_facts(tmp_path / "switch", {"refused": refused})
    found = forced_past(context)
    assert len(found) == reasons
    assert ("2 markers fused" in "".join(found)) == (fused > 0)
    assert ("no bowl fits" in found) == bool(refused)
    assert ("from 3 N on" in "".join(found)) == (first_N < 10.0)


@pytest.mark.parametrize(("kind", "maps_drawn"), [("plane", 2), ("hemisphere", 2), ("cone", 1)])
def test_shapes_that_face_the_camera_are_drawn_in_its_picture_too(
    kind: str, maps_drawn: int, tmp_path: Path
) -> None:
    context = Context(design=drawn(kind, 3), accuracy=PRESETS["draft"], seed=0)
    camera = cameras_of(context.design, context.surface)[0]
    write_arrays(tmp_path, {"rest_px": camera.project(context.markers.tip_mm)})
    context.folders["views"] = tmp_path
    values = np.arange(context.markers.count, dtype=float)
    place = context.markers.uv[0]
    html = Drawing(context).maps(
        values, "Gap", "px", name="gap", marked=values < 2.0, cross=place, in_picture=True
    )
    assert html.count("data:image/png") == maps_drawn
    assert ("Gap; in the camera&#x27;s picture" in html) == (maps_drawn == 2)
    picture = flat_map.picture_map(camera.project(context.markers.tip_mm), (864, 648))
    wide, tall = report_figures.map_size_in(picture)
    assert wide / tall == pytest.approx(864 / 648, rel=0.03)


def test_bars_of_very_unlike_errors_and_of_none_are_drawn() -> None:
    table = {"fem": a_score(900.0), "koi_inverse": a_score(0.05)}
    table["fem"]["below_5N"]["relative_error"] = None
    assert report_figures.error_bars(table, {"fem": "†"}).startswith(b"\x89PNG")
    nothing = {"fem": a_score(float("nan"))}
    assert report_figures.error_bars(nothing, {}).startswith(b"\x89PNG")


def test_records_are_tables_of_their_own() -> None:
    parts = [{"note": "a", "part": "switch A0"}, {"part": "switch A1", "note": None}]
    html = figure_names.facts({"parts": parts, "red": {"unreadable": 2}}, "switch")
    assert html.count("<table") == 2
    assert html.index(">part<") < html.index(">note<")
    assert ">switch A1</th><td>–</td>" in html


def test_two_cameras_show_both_pictures_and_lenses(tmp_path: Path) -> None:
    design = small(
        camera={"ends": "both", "width_px": 648, "height_px": 486, "focal_px": 242.0},
        layout={"rows": 4, "columns": 8, "height_far_mm": 3.0},
    )
    context = Context(design=design, accuracy=PRESETS["draft"], seed=0, progress=lambda _: None)
    for name in ("views", "compare"):
        (tmp_path / name).mkdir()
        context.folders[name] = tmp_path / name
    run_views(context, tmp_path / "views")
    write_facts(tmp_path / "compare", {"straight": None, "why": "no <rows>"})
    views = context.facts("views")
    report = {
        "cameras": views["cameras"],
        "visibility": views["visibility"],
        "straight": None,
        "camera": {"stand_off_mm": views["stand_off_mm"], "end": "near"},
    }
    html = report_sections.camera_section(context, report, Drawing(context))
    for end in ("near", "far"):
        for what in ("The camera&#x27;s view at rest", "All switches on", "Exact ID map"):
            assert any(
                what in part and f", {end} camera" in part for part in html.split("<figcaption>")
            )
    assert html.count("data:image/jpeg") == 6
    assert "no &lt;rows&gt;" in html
    lens = report_sections.lens_section(context, report)
    assert "<h3>Near camera</h3>" in lens
    assert "<h3>Far camera</h3>" in lens
    # Each figure under its own heading: facts on disk are sorted by key.
    row = views["cameras"][0]["lens"]["rows"][0]
    first = lens.split("<tbody>")[1].split("</tr>")[0]
    cells = [part.split("<")[0] for part in first.split(">") if part.split("<")[0]]
    assert cells[:3] == ["0", str(row["markers"]), page.number(row["mm_per_px_axial"])]
    assert cells[-1] == page.number(row["blur_px"])


def test_page_of_a_build_is_whole(built: BuildResult) -> None:
    report = json.loads((built.out / "report" / "report.json").read_text())
    html = (built.out / "report" / "report.html").read_text()
    assert report["forced"] == []
    assert len(report["cameras"]) == 1
    assert ">None<" not in html
    assert ">nan" not in html
    for key in ("under_load", "markers", "shell", "mesh", "frames", "training", "twin"):
        for path in page.flatten(report[key], f"{key}."):
            assert figure_names.name_of(path) != path or path == "under_load.sentence", path
    for key in report["visibility"]:
        assert figure_names.name_of(f"visibility.{key}") != f"visibility.{key}"
