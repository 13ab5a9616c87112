"""Tricks with files: pipes, devices, links, names, bombs, numbers that ask for memory."""

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phytac_decoder.estimation.force_regions import load_regions
from phytac_decoder.io.bundle import load_bundle, save_bundle
from phytac_design.datasets.samples_file import read_samples
from phytac_design.design.camera_files import read_lens
from phytac_design.design.design_file import load_design
from phytac_design.design.fixture_table import read_stl
from phytac_design.design.positions import read_positions
from phytac_design.design.scene import load_scene
from phytac_design.mechanics.switch.material_fit import read_test
from phytac_design.report.built_sensors import read_builds
from phytac_design.simulation.rig_import.rig_log import RowProblems, read_rig_log
from phytac_design.simulation.scenario.scenario_file import load_scenario
from phytac_design.studio.files import ProjectFolder
from phytac_design.study.search.study_file import load_study
from phytac_design.workflows.design_from_step import patch_changes
from phytac_shapes.bounded_reader import LETTERS_MAX, joined, read_bytes, read_text, toml_table
from phytac_shapes.errors import InputError, PhytacError
from tests.designs import small
from tests.fuzz.judge import fault_of, little_memory, little_time
from verification.test_readers import bundle

READ: dict[str, Callable[[Path], Any]] = {
    "design": lambda path: load_design(str(path)),
    "study": lambda path: load_study(str(path)),
    "scene": lambda path: load_scene(str(path)),
    "scenario": lambda path: load_scenario(str(path)),
    "positions": read_positions,
    "body": read_stl,
    "lens": read_lens,
    "rig log": lambda path: read_rig_log(path, RowProblems(where="x")),
    "tensile test": read_test,
    "regions": lambda path: load_regions(path, np.zeros((3, 3))),
    "step": patch_changes,
    "studio": lambda path: ProjectFolder(path.parent).open(str(path)),
}


def refused(work: Callable[[], Any]) -> str:
    """Message of a reader that must refuse, soon and in little memory."""
    with little_memory(), little_time(5.0), pytest.raises(PhytacError) as caught:
        work()
    return str(caught.value)


def pipe(folder: Path) -> Path:
    path = folder / "pipe"
    os.mkfifo(path)
    return path


def loop(folder: Path) -> Path:
    path = folder / "loop"
    path.symlink_to(path)
    return path


def huge(folder: Path) -> Path:
    path = folder / "huge"
    with path.open("wb") as file:
        # A sparse file: it occupies no disk space.
        file.truncate(1 << 40)
    return path


TRICKS: dict[str, Callable[[Path], Path]] = {
    "a pipe nobody writes to": pipe,
    "a link to itself": loop,
    "a terabyte of zeros": huge,
    "a device without end": lambda _: Path("/dev/zero"),
    "a folder": lambda folder: folder,
    "a name too long": lambda folder: folder / ("x" * 300),
    "a name with NUL": lambda folder: folder / "a\0b",
}


@pytest.mark.parametrize("reader", READ)
@pytest.mark.parametrize("trick", TRICKS)
def test_what_is_no_file_is_refused(reader: str, trick: str, tmp_path: Path) -> None:
    path = TRICKS[trick](tmp_path)
    assert len(refused(lambda: READ[reader](path))) < 2000


@pytest.mark.parametrize("name", ["bundle.json", "bundle.safetensors"])
@pytest.mark.parametrize("trick", ["a pipe nobody writes to", "a link to itself", "a folder"])
def test_parts_of_a_bundle_that_are_no_files(name: str, trick: str, tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    (tmp_path / name).unlink()
    TRICKS[trick](tmp_path / "..").rename(tmp_path / name) if trick != "a folder" else (
        tmp_path / name
    ).mkdir()
    refused(lambda: load_bundle(tmp_path))


@pytest.mark.parametrize("name", ["dataset.json", "samples.npz"])
def test_pipes_in_a_data_set(name: str, tmp_path: Path) -> None:
    from phytac_design.datasets.samples_file import table_hash, write_samples
    from tests.decoder.drawn_samples import META, drawn

    write_samples(tmp_path, drawn(1), META)
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    if name == "samples.npz":
        # A pipe says that it has no bytes.
        table = json.loads((tmp_path / "dataset.json").read_text())
        table["file"]["bytes"] = 0
        table["checksum"] = table_hash(table)
        (tmp_path / "dataset.json").write_text(json.dumps(table))
    refused(lambda: read_samples(tmp_path))


@pytest.mark.parametrize("field", ["camera.calibration", "layout.positions_csv", "fixtures.file"])
@pytest.mark.parametrize("name", ["/dev/zero", "a\0b", "../../../../etc/passwd", "x" * 300])
def test_files_that_a_design_names(field: str, name: str, tmp_path: Path) -> None:
    table, key = field.split(".")
    data = small().model_dump(mode="json")
    if table == "fixtures":
        data["fixtures"] = [{"name": "a", "kind": "mesh", "file": name}]
    else:
        data[table] |= {"kind": "explicit", key: name} if table == "layout" else {key: name}
    from phytac_design.design.design_file import parse_design

    refused(lambda: parse_design(data, "x", folder=tmp_path))


@pytest.mark.parametrize("markers", [10**9, 10**15, 0, -1, 11])
def test_a_bundle_that_says_how_many_markers(markers: int, tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"markers": markers}))
    refused(lambda: load_bundle(tmp_path))


HEADS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "a type that NumPy lacks": lambda h: h["stiffness"].update(dtype="BF16"),
    "an unknown type": lambda h: h["stiffness"].update(dtype="X9"),
    "sizes beyond all memory": lambda h: h["stiffness"].update(shape=[2**40, 2**40]),
    "offsets beyond the file": lambda h: h["stiffness"].update(data_offsets=[0, 2**50]),
    "offsets that overlap": lambda h: h["stiffness"].update(
        data_offsets=h["compliance_px"]["data_offsets"]
    ),
    "offsets backwards": lambda h: h["stiffness"].update(data_offsets=[800, 0]),
    "no markers' places": lambda h: h.pop("rest_px"),
}


@pytest.mark.parametrize("case", HEADS)
def test_headers_of_safetensors(case: str, tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.safetensors"
    data = path.read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    head = json.loads(data[8 : 8 + size])
    HEADS[case](head)
    text = json.dumps(head).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + size :])
    refused(lambda: load_bundle(tmp_path))


@pytest.mark.parametrize("size", [2**62, 2**64 - 1, 10**9])
def test_a_header_of_any_length(size: int, tmp_path: Path) -> None:
    save_bundle(bundle(), tmp_path)
    path = tmp_path / "bundle.safetensors"
    path.write_bytes(struct.pack("<Q", size) + path.read_bytes()[8:])
    refused(lambda: load_bundle(tmp_path))


TOML = {
    "lists nested 10 000 deep": "a = " + "[" * 10_000,
    "tables nested 10 000 deep": "a = " + "{a = " * 10_000,
    "a key of 100 000 names": "a." * 100_000 + "a = 1",
    "a header of 100 000 names": "[" + "a." * 100_000 + "a]",
    "such a key in an inline table": "a = {" + "a." * 100_000 + "a = 1}",
    "a number of 10 000 digits": "a = " + "9" * 10_000,
    "a date that is none": "a = 2024-13-45",
    "a million letters": "x" * 10**6,
}


@pytest.mark.parametrize("case", TOML)
@pytest.mark.parametrize("reader", ["design", "study", "scene", "scenario", "regions", "studio"])
def test_toml_that_breaks_parsers(case: str, reader: str, tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text(TOML[case])
    with little_memory():
        fault, read, _ = fault_of(lambda: READ[reader](path))
    assert (fault, read) == (None, False)


@pytest.mark.parametrize("case", TOML)
def test_toml_of_a_build(case: str, tmp_path: Path) -> None:
    (tmp_path / "report").mkdir()
    for name in ("report", "viewer"):
        (tmp_path / "report" / f"{name}.json").write_text("{}")
    (tmp_path / "design.toml").write_text(TOML[case])
    with little_memory():
        fault, read, _ = fault_of(lambda: read_builds([tmp_path]))
    assert (fault, read) == (None, False)


@pytest.mark.parametrize("name", ["report/report.json", "report/viewer.json", "design.toml"])
@pytest.mark.parametrize("trick", ["a pipe nobody writes to", "a terabyte of zeros"])
def test_files_of_a_build_that_are_none(name: str, trick: str, tmp_path: Path) -> None:
    folder = tmp_path / "x"
    (folder / "report").mkdir(parents=True)
    for other in ("report/report.json", "report/viewer.json", "design.toml"):
        (folder / other).write_text("{}" if other.endswith("json") else "a = 1")
    (folder / name).unlink()
    TRICKS[trick](tmp_path).rename(folder / name)
    assert str(folder / name) in refused(lambda: read_builds([folder]))


def test_toml_with_points_is_read() -> None:
    text = f"a.b.c = 1\nd = [{', '.join(['0.5'] * 200)}]\ne = '{'x. ' * 200}'\n[f.g]\nh = 1.5\n"
    table = toml_table(text)
    assert table["a"] == {"b": {"c": 1}}
    assert (len(table["d"]), len(table["e"]), table["f"]) == (200, 600, {"g": {"h": 1.5}})


def test_json_with_a_hundred_thousand_levels(tmp_path: Path) -> None:
    deep = "[" * 100_000 + "]" * 100_000
    for name, read in (
        ("x.json", lambda: load_regions(tmp_path / "x.json", np.zeros((3, 3)))),
        ("bundle.json", lambda: load_bundle(tmp_path)),
        ("dataset.json", lambda: read_samples(tmp_path)),
    ):
        (tmp_path / name).write_text(deep)
        refused(read)


def test_many_problems_make_a_short_message(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    keys = "".join(f"{'k' * 900}{number} = 1\n" for number in range(60))
    path.write_text(keys)
    for read in (load_design, load_study, load_scene, load_scenario):
        message = refused(lambda read=read: read(str(path)))  # type: ignore[misc]
        assert 200 < len(message) < 20_000
    assert joined(["a", "a", "b"]) == "a; b"
    assert len(joined(["x" * 10**6])) == LETTERS_MAX + 1


@pytest.mark.parametrize(
    "text",
    [
        "".join(f"diametr_{number} = 1\n" for number in range(5000)),
        f'[shape]\nkind = "patch"\npoints_mm = [{"0.0," * 5000}]\n',
        '[[fixtures]]\nkind = "box"\nnam = 1\n' * 2000,
    ],
    ids=["keys", "points", "fixtures"],
)
@pytest.mark.parametrize("reader", ["design", "study", "scene", "scenario"])
def test_thousands_of_problems_take_no_time(reader: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text)
    fault, read, _ = fault_of(lambda: READ[reader](path))
    assert (fault, read) == (None, False)


def test_a_study_that_is_wrong_as_a_whole(tmp_path: Path) -> None:
    """A problem of the file itself has no place in it."""
    from phytac_design.study.search.study_file import shipped_studies

    path = tmp_path / "x.toml"
    path.write_text("true_value = true\n" + "a = 1\n")
    refused(lambda: load_study(str(path)))
    assert shipped_studies()


def test_files_are_read_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"a\r\nb\rc\n\xc3\xa9")
    assert read_text(path) == "a\nb\nc\né"
    assert read_bytes(path) == path.read_bytes()
    with pytest.raises(OSError, match="9 bytes, more than the 8"):
        read_bytes(path, bytes_max=8)
    for other in (pipe(tmp_path), Path("/dev/zero")):
        with pytest.raises(OSError, match="no regular file"):
            read_bytes(other)
    link = tmp_path / "link"
    link.symlink_to(path)
    assert read_bytes(link) == path.read_bytes()
    with pytest.raises(InputError):
        read_test(path)


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_positions, "u,v\n1,{}\n"),
        (read_test, "stretch,stress_MPa\n1,{}\n"),
    ],
)
def test_a_message_quotes_little_of_a_cell(
    read: Callable[[Path], Any], text: str, tmp_path: Path
) -> None:
    path = tmp_path / "x.csv"
    path.write_text(text.format("9" * 40_000 + "x"))
    with pytest.raises(PhytacError) as caught:
        read(path)
    assert len(str(caught.value)) < 3_000
