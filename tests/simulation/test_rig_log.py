"""A rig's log and its pictures' names and times, without any picture."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from phytac_design.design.design_file import load_design
from phytac_design.fabrication.calibration_rig.log_template import log_head
from phytac_design.layout import make_markers
from phytac_design.layout.sensor import Sensor
from phytac_design.mechanics.indenter import INDENTERS
from phytac_design.simulation.contacts import Contacts
from phytac_design.simulation.rig_import.rig_contacts import contacts_of, sequences_of
from phytac_design.simulation.rig_import.rig_frames import (
    FrameFolder,
    FrameSource,
    match_frames,
    open_source,
)
from phytac_design.simulation.rig_import.rig_log import RigLog, RowProblems, read_rig_log
from phytac_design.simulation.rig_import.rig_samples import _remarks
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.designs import changed, drawn
from tests.refusals import refused

DESIGN = load_design(str(Path(__file__).parents[2] / "examples" / "rig" / "rig.toml"))
SURFACE = DESIGN.surface()
MARKERS = make_markers(DESIGN, SURFACE)


def read(folder: Path, *lines: str) -> tuple[RigLog, RowProblems]:
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    problems = RowProblems(where="log")
    return read_rig_log(path, problems), problems


def touched(folder: Path, *lines: str, off_mm: float = 2.0) -> tuple[Contacts, RowProblems]:
    log, problems = read(folder, *lines)
    touches = contacts_of(log, Sensor.of(DESIGN, SURFACE, MARKERS), off_mm=off_mm, radius_mm=4.0)
    return touches, problems


FILES = {
    "text": (["frame,marker,force_n,radius"], "csv-column-unknown"),
    "unit": (["frame,marker,force_mN"], "csv-column-unknown"),
    "metres": (["frame,x_m,y_m,z_m,force_N"], "csv-column-unknown"),
    "ms": (["timestamp_ms,marker,force_N"], "csv-column-unknown"),
    "twice": (["frame,marker,marker,force_N"], "csv-column-duplicate"),
    "no place": (["frame,force_N"], "csv-columns-ambiguous"),
    "two places": (["frame,marker,u,v,force_N"], "csv-columns-ambiguous"),
    "half place": (["frame,x_mm,y_mm,force_N"], "csv-columns-ambiguous"),
    "no force": (["frame,marker"], "csv-columns-ambiguous"),
    "no frame": (["marker,force_N"], "rig-frame-column-missing"),
    "fields": (["frame,marker,force_N", "1,2"], "csv-row-length"),
    "semicolons": (["frame;marker;force_N"], "csv-separator"),
    "empty": (["frame,marker,force_N"], "csv-empty"),
}


@pytest.mark.parametrize("case", FILES)
def test_files_that_are_no_log(tmp_path: Path, case: str) -> None:
    lines, code = FILES[case]
    rows = lines if case in ("fields", "empty") else [*lines, "1" + ",1" * lines[0].count(",")]
    with refused(code):
        read(tmp_path, *rows)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with refused("file-unreadable"):
        read_rig_log(tmp_path / "none.csv", RowProblems(where=""))
    (tmp_path / "log.csv").write_bytes(b"\xff\xfe\x00")
    with refused("file-not-csv"):
        read_rig_log(tmp_path / "log.csv", RowProblems(where=""))


BAD_ROWS = {
    "nan": ("1,3,nan,4", "line 3: force_N is not a finite number (got 'nan')"),
    "text": ("1,3,2 N,4", "force_N is not a finite number (got '2 N')"),
    "infinite": ("1,3,inf,4", "force_N is not a finite number"),
    "half marker": ("1,3.5,2,4", "marker is not a whole number (got '3.5')"),
    "beyond": ("1,60,2,4", "marker must be 0 to 59 (got 60)"),
    "negative": ("1,3,-2,4", "the force pulls outward (-2 N); force_N counts pushes"),
    "radius": ("1,3,2,-4", "radius_mm is negative (-4)"),
}


@pytest.mark.parametrize("case", BAD_ROWS)
def test_bad_rows_are_noted_with_their_line(tmp_path: Path, case: str) -> None:
    row, message = BAD_ROWS[case]
    good = ["2,7,3,4", "3,8,3,4"]
    touches, problems = touched(tmp_path, "frame,marker,force_N,radius_mm", "# a note", row, *good)
    assert message in problems.text()
    np.testing.assert_array_equal(problems.samples, [0])
    np.testing.assert_allclose(touches.uv[-2:], MARKERS.uv[[7, 8]])
    assert touches.samples == 3
    with refused("rig-rows-invalid"):
        problems.raise_all()


def test_contacts_of_one_sample(tmp_path: Path) -> None:
    head = "sample,frame,sequence,marker,force_N"
    log, problems = read(tmp_path, head, "a,1,5,3,2", "b,2,5,4,3", "a,1,5,9,4", "c,4,6,1,1")
    assert problems.found == []
    np.testing.assert_array_equal(log.sample, [0, 1, 0, 2])
    assert log.frame == ("1", "2", "4")
    touches = contacts_of(log, Sensor.of(DESIGN, SURFACE, MARKERS), off_mm=2.0, radius_mm=4.0)
    np.testing.assert_array_equal(touches.sample, [0, 0, 1, 2])
    np.testing.assert_array_equal(touches.force_N, [2.0, 4.0, 3.0, 1.0])
    given = log.numbers["sequence"][[0, 1, 3]]
    sequence = sequences_of(given, touches, SURFACE.point(touches.uv), 1.0)
    np.testing.assert_array_equal(sequence, [0, 0, 1])
    _, problems = read(tmp_path, head, "a,1,0,3,2", "a,2,0,4,3", "b,1,0,4,3")
    assert "line 3: frame is '2', but '1' on line 2 of the same sample" in problems.text()
    assert "line 4: frame '1' is that of line 2" in problems.text()


@pytest.mark.parametrize("kind", ["cylinder", "patch", "hemisphere"])
def test_every_way_to_state_a_place_is_the_same(tmp_path: Path, kind: str) -> None:
    design = drawn(kind, 3)
    surface = design.surface()
    markers = make_markers(design, surface)
    ids = np.array([0, 5, markers.count - 1])
    points, uv = surface.point(markers.uv[ids]), markers.uv[ids]
    ways = {
        "marker": [f"{i}" for i in ids],
        "u,v": [f"{u:.9f},{v:.9f}" for u, v in uv],
        "x_mm,y_mm,z_mm": [f"{x:.9f},{y:.9f},{z:.9f}" for x, y, z in points],
    }
    if markers.in_rows:
        ways["row,column"] = [f"{markers.row[i]},{markers.column[i]}" for i in ids]
    for head, places in ways.items():
        rows = [f"{k},{place},2" for k, place in enumerate(places)]
        log, problems = read(tmp_path, f"frame,{head},force_N", *rows)
        touches = contacts_of(log, Sensor.of(design, surface, markers), off_mm=0.1, radius_mm=4.0)
        assert problems.found == [], head
        np.testing.assert_allclose(surface.point(touches.uv), points, atol=1e-5, err_msg=head)


def point_rows(points: FloatArray) -> list[str]:
    return [f"{k},{x:.6f},{y:.6f},{z:.6f},3" for k, (x, y, z) in enumerate(points)]


def test_points_off_the_surface(tmp_path: Path) -> None:
    """Above, below and beyond the rim by more than allowed; a dent of that depth is fine."""
    uv = np.array([[10.0, 1.0]] * 5)
    points = SURFACE.point(uv, np.array([2.1, 1.9, -2.7, -2.9, 0.0]))
    points[4, 2] = -2.5
    head = "frame,x_mm,y_mm,z_mm,force_N"
    touches, problems = touched(tmp_path, head, *point_rows(points))
    np.testing.assert_array_equal(problems.samples, [0, 3, 4])
    assert "mm is 2.1 mm off the surface (at most 2)" in problems.text()
    assert "mm is 2.5 mm off the surface (at most 2)" in problems.text()
    np.testing.assert_allclose(touches.uv, uv[:2], atol=1e-6)
    _, problems = touched(tmp_path, head, *point_rows(points), off_mm=3.0)
    assert problems.found == []


@pytest.mark.parametrize(
    ("unit", "times"), [("m", 1e-3), ("cm", 0.1), ("inches", 1 / 25.4), ("µm", 1e3)]
)
def test_positions_in_another_unit(tmp_path: Path, unit: str, times: float) -> None:
    points = times * SURFACE.point(MARKERS.uv[:20])
    with refused("rig-position-unit") as caught:
        touched(tmp_path, "frame,x_mm,y_mm,z_mm,force_N", *point_rows(points))
    caught.match(f"but as {unit} most lie on it; .* multiply them by")


def test_a_chart_position_off_the_chart(tmp_path: Path) -> None:
    touches, problems = touched(tmp_path, "frame,u,v,force_N", "1,40,0,2", "2,20,-0.5,2")
    assert "line 2: (40, 0) is off the surface, whose chart runs from (0, 0)" in problems.text()
    np.testing.assert_allclose(touches.uv, [[20.0, 2 * np.pi - 0.5]])
    _, problems = touched(tmp_path, "frame,row,column,force_N", "1,4,11,2", "2,5,0,2")
    assert problems.text() == "log (1 samples): line 3: no marker stands in row 5, column 0"


def test_forces_in_another_unit(tmp_path: Path) -> None:
    rows = [f"{k},{k},{800 + k}" for k in range(9)]
    with refused("rig-force-unit") as caught:
        touched(tmp_path, "frame,marker,force_N", *rows)
    caught.match("mN or g")
    rows = [f"{k},{k},{-3 - k}" for k in range(9)]
    with refused("rig-force-sign"):
        touched(tmp_path, "frame,marker,force_N", *rows)
    rows = [f"{k},{k},{3 + k if k != 4 else 1876.54}" for k in range(9)]
    _, problems = touched(tmp_path, "frame,marker,force_N", *rows)
    assert "line 6: a force of 1876.54 N, and the sensor is made for up to 25 N" in problems.text()


def test_force_vectors_are_taken_apart(tmp_path: Path) -> None:
    """5 N inward, 1 N along growing u and 2 N square to it, right-handed about the normal."""
    uv = np.array([[12.0, 0.7], [20.0, 3.0]])
    normal, along = SURFACE.normal(uv), SURFACE.tangents(uv)[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    force = -5.0 * normal + 1.0 * along + 2.0 * np.cross(normal, along)
    rows = [
        f"{k},{u},{v},{x:.9f},{y:.9f},{z:.9f}"
        for k, ((u, v), (x, y, z)) in enumerate(zip(uv, force, strict=True))
    ]
    head = "frame,u,v,fx_N,fy_N,fz_N"
    touches, problems = touched(tmp_path, head, *rows)
    assert problems.found == []
    np.testing.assert_allclose(touches.force_N, 5.0)
    np.testing.assert_allclose(touches.friction, [[0.2, 0.4]] * 2, atol=1e-8)
    slide = -0.1 * normal[0] + along[0]
    slides = f"9,{uv[0, 0]},{uv[0, 1]},{slide[0]},{slide[1]},{slide[2]}"
    touches, problems = touched(tmp_path, head, *rows, slides)
    assert "line 4: the force is mostly along the surface (10 times" in problems.text()
    assert len(touches.force_N) == 2


def test_indenters(tmp_path: Path) -> None:
    head = "frame,marker,force_N,indenter,radius_mm,length_mm,turn_deg"
    rows = [
        "1,3,2,flat,4,9,0",
        "2,4,2,cylinder,1,12,90",
        "3,4,2,cylinder,1,0,0",
        "4,4,2,cone,1,0,0",
    ]
    touches, problems = touched(tmp_path, head, *rows)
    assert [INDENTERS[i] for i in touches.indenter[:2]] == ["flat", "cylinder"]
    np.testing.assert_allclose(touches.length_mm[:2], [0.0, 12.0])
    np.testing.assert_allclose(touches.turn_rad[:2], [0.0, np.pi / 2])
    assert "line 4: a cylinder needs its length_mm" in problems.text()
    assert "indenter must be one of flat, sphere, cylinder (got 'cone')" in problems.text()


def test_presses_in_a_row_belong_together(tmp_path: Path) -> None:
    head = "sample,frame,marker,force_N"
    rows = ["1,1,3,2", "2,2,3,4", "3,3,4,2", "4,4,3,2", "5,5,3,0", "6,6,3,1", "7,7,3,1", "7,7,9,1"]
    touches, _ = touched(tmp_path, head, *rows)
    sequence = sequences_of(None, touches, SURFACE.point(touches.uv), 1.0)
    np.testing.assert_array_equal(sequence, [0, 0, 1, 2, 3, 4, 5])


def test_the_log_of_the_bench(tmp_path: Path) -> None:
    text = (
        log_head("rig")
        + "# step 0, frame 10, 1.500 s\n3,4,1,0\n"
        + "# step 1, frame 11, 2.500 s\n4,4,2,0\n20,4,3,0\n"
    )
    (tmp_path / "bench.csv").write_text(text)
    problems = RowProblems(where="log")
    got = read_rig_log(tmp_path / "bench.csv", problems)
    assert problems.found == []
    assert got.frame == ("10", "11")
    np.testing.assert_array_equal(got.sample, [0, 1, 1])
    np.testing.assert_array_equal(got.time_s, [1.5, 2.5])
    np.testing.assert_array_equal(got.numbers["marker"], [3, 4, 20])
    np.testing.assert_array_equal(got.numbers["radius_mm"], 4.0)


# Which picture is whose.


def folder_of(path: Path, names: list[str]) -> FrameFolder:
    for name in names:
        (path / name).write_bytes(b"")
    return FrameFolder(path, None)


def test_pictures_are_found_by_name_or_number(tmp_path: Path) -> None:
    folder = folder_of(
        tmp_path, ["b_0010.png", "b_0009.png", "b_0100.JPG", "b_0011.png", "note.txt", "x.bmp"]
    )
    assert folder.names == ("x.bmp", "b_0009.png", "b_0010.png", "b_0011.png", "b_0100.JPG")
    for text, number in (
        ("b_0010.png", 2), ("b_0010", 2), ("10", 2), ("0010", 2), ("100", 4), ("x", 0)
    ):  # fmt: skip
        assert folder.find(text) == number, text
    for text in ("b_001", "1", "", "b_0010.jpg", "-1"):
        assert folder.find(text) is None, text
    (tmp_path / "c_0010.png").write_bytes(b"")
    assert FrameFolder(tmp_path, None).find("10") is None
    assert FrameFolder(tmp_path, None).find("c_0010") is not None


class Named(FrameSource):
    """Pictures with times alone."""

    def __init__(self, times: list[float] | None) -> None:
        self.where = Path("pictures")
        self.names = tuple(f"p{k}" for k in range(len(times or [0, 1])))
        self.time_s = None if times is None else np.array(times)

    def read(self, number: int) -> ImageArray:
        raise NotImplementedError

    def find(self, text: str) -> int | None:
        return self.names.index(text) if text in self.names else None


def matched(
    folder: Path,
    stamps: list[str],
    times: list[float] | None,
    *,
    offset_s: float = 0.0,
    tolerance_s: float | None = None,
) -> tuple[list[int], str]:
    log, problems = read(folder, "timestamp_s,marker,force_N", *(f"{t},3,1" for t in stamps))
    out = match_frames(log, Named(times), offset_s=offset_s, tolerance_s=tolerance_s)
    return out.tolist(), problems.text() if problems.found else ""


def test_pictures_are_found_by_time(tmp_path: Path) -> None:
    times = [0.0, 0.1, 0.2, 0.3, 1.0]
    assert matched(tmp_path, ["0.04", "0.26", "1.0"], times) == ([0, 3, 4], "")
    assert matched(tmp_path, ["10.04", "10.26"], times, offset_s=-10.0) == ([0, 3], "")
    # Pictures in any order.
    assert matched(tmp_path, ["0.04", "0.26"], [0.3, 0.1, 0.0])[0] == [2, 0]
    found, said = matched(tmp_path, ["0.1", "0.5", "0.97"], times, tolerance_s=0.02)
    assert found == [1, -1, -1]
    assert "line 3: the nearest frame is 0.2 s away (tolerance 0.02 s)" in said
    assert "line 4: the nearest frame is 0.03 s away" in said
    found, said = matched(tmp_path, ["0.10", "0.12"], times)
    assert "line 3: its frame 'p1' is also that of line 2" in said
    with refused("rig-clocks-differ"):
        matched(tmp_path, ["7"], times, tolerance_s=0.1)
    with refused("rig-frame-times-missing"):
        matched(tmp_path, ["7"], None)


def test_times_in_file_names(tmp_path: Path) -> None:
    seconds = tmp_path / "s"
    seconds.mkdir()
    times = folder_of(seconds, ["9.5.png", "12.250.png"]).time_s
    assert times is not None
    np.testing.assert_allclose(np.sort(times), [9.5, 12.25])
    # A rate is for names that say nothing.
    np.testing.assert_array_equal(FrameFolder(seconds, 20.0).time_s, times)
    ns = tmp_path / "ns"
    ns.mkdir()
    made = folder_of(ns, ["1700000000250000000.png", "1700000000500000000.png"])
    np.testing.assert_array_equal(made.time_s, [1700000000.25, 1700000000.5])
    counted = tmp_path / "n"
    counted.mkdir()
    assert folder_of(counted, ["a1.png", "a2.png"]).time_s is None
    np.testing.assert_allclose(FrameFolder(counted, 20.0).time_s, [0.0, 0.05])


def test_a_contact_that_stands_twice_counts_once(tmp_path: Path) -> None:
    head, one, other = "sample,frame,marker,force_N", "a,1,5,7.0", "a,1,9,7.0"
    _, problems = read(tmp_path, head, one, other, "b,2,5,7.0")
    assert not problems.found
    _, problems = read(tmp_path, head, one, other, one)
    assert problems.samples.tolist() == [0]
    assert "line 4: the same as line 2, in one sample; remove one" in problems.text()


def test_digits_are_not_grouped(tmp_path: Path) -> None:
    _, problems = read(tmp_path, "frame,marker,force_N", "1,5,1_2")
    assert "force_N is not a" in problems.text()


def test_no_pictures(tmp_path: Path) -> None:
    with refused("folder-without-images"):
        open_source(tmp_path, fps=None)
    with refused("file-unreadable"):
        open_source(tmp_path / "none", fps=None)
    (tmp_path / "x.mp4").write_bytes(b"no video")
    with refused("file-not-video"):
        open_source(tmp_path / "x.mp4", fps=None)


@pytest.mark.parametrize(("hole_mm", "remarked"), [(1.6, True), (0.0, False)])
def test_a_sensor_without_switches_has_no_remarks_about_them(
    hole_mm: float, remarked: bool
) -> None:
    design = changed(receptor={"diameter_hole_mm": hole_mm})
    markers = make_markers(design, design.surface())
    rig = SimpleNamespace(design=design, markers=markers, bundle=None)
    seen = SimpleNamespace(found=np.ones(markers.count), moved_cameras=lambda *_: [])
    touches = SimpleNamespace(sample=np.array([0]), force_N=np.array([20.0]))
    share = np.zeros((1, markers.count))
    share[0, 7] = 1.0
    owner = np.full((1, markers.count), -1)
    found = _remarks(rig, touches, share, [seen], share > 9.0, SimpleNamespace(owner=owner))
    assert found.tolist() == [[False, False, remarked, False]]
