"""Designs are saved where they may be, whole, with comments, and never over another unasked."""

import os
import stat
import tomllib
from pathlib import Path
from typing import Any

import pytest

from phytac_design.design.design_file import load_design, parse_design, shipped_designs
from phytac_design.studio.files import ConfirmationError, ProjectFolder, edited
from phytac_shapes.errors import InputError, OutputError
from tests.fuzz.judge import little_time
from tests.refusals import refused
from tests.studio.place import DESIGN, Client

Json = dict[str, Any]


@pytest.fixture
def project(tmp_path: Path) -> ProjectFolder:
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "short.toml").write_text(DESIGN)
    return ProjectFolder(folder)


def test_comments_stay_where_fields_stay(project: ProjectFolder, data: Json) -> None:
    data["layout"]["spiral_angle_deg"] = 44.5
    data["layout"]["rows"] = 9
    data["shape"]["diameter_outer_mm"] = 58.0
    data["wall"] = {"thickness_mm": 1.0}
    del data["camera"]["focal_px"]
    project.save("short.toml", data, source="short.toml", force=True)
    text = (project.root / "short.toml").read_text()
    for line in (
        "# A short sensor.",
        'name = "short"        # in exports',
        "diameter_outer_mm = 58.0   # as published",
        "# Far ones are taller.",
        "spiral_angle_deg = 44.5",
        "rows = 9",
    ):
        assert line in text.splitlines()
    assert "focal_px" not in text
    assert tomllib.loads(text) == data


@pytest.mark.parametrize("name", shipped_designs())
def test_every_shipped_design_can_be_changed_and_saved(project: ProjectFolder, name: str) -> None:
    opened = project.open(name)
    data = {**opened.data, "name": "mine", "wall": {"thickness_mm": 0.9}}
    saved = project.save("mine.toml", data, source=name)
    assert parse_design(saved.data, "") == parse_design(data, "")
    assert load_design(str(project.root / "mine.toml")).wall.thickness_mm == 0.9
    assert saved.text.count("#") >= opened.text.count("#")


def test_another_family_takes_the_whole_table(project: ProjectFolder, data: Json) -> None:
    data["shape"] = load_design("plane").shape.model_dump(mode="json")
    text = edited(DESIGN, data)
    assert tomllib.loads(text) == data
    assert "length_mm" not in text


def test_text_that_cannot_be_kept_is_replaced(project: ProjectFolder, data: Json) -> None:
    (project.root / "dotted.toml").write_text(
        'name = "a"\nshape.kind = "cylinder"\nshape.diameter_outer_mm = 60\nshape.length_mm = 60\n'
    )
    opened = project.open("dotted.toml")
    changed = {**opened.data, "regions": [{"name": "tip", "rows": [0, 3]}]}
    saved = project.save("new.toml", changed, source="dotted.toml")
    assert parse_design(saved.data, "") == parse_design(changed, "")


@pytest.mark.parametrize(
    "text",
    [
        f"a = {'[' * 200}{']' * 200}\n{DESIGN}",
        f"[layout.x]\n[z]\n[layout.y]\n{DESIGN.replace('[layout]', '[layout.z]')}",
    ],
)
def test_text_that_cannot_be_edited_is_replaced(
    project: ProjectFolder, data: Json, text: str
) -> None:
    """Read as TOML, but more than its editor holds."""
    (project.root / "odd.toml").write_text(text)
    assert project.open("odd.toml").data != data
    saved = project.save("new.toml", data, source="odd.toml")
    assert parse_design(saved.data, "") == parse_design(data, "")


def test_a_pipe_among_the_designs_stops_nobody(project: ProjectFolder, data: Json) -> None:
    os.mkfifo(project.root / "pipe.toml")
    with little_time(5.0):
        assert project.designs() == ["short.toml"]
        with pytest.raises(ConfirmationError):
            project.save("pipe.toml", data, source="short.toml", replace="0" * 64)


def test_a_design_from_nowhere_gets_the_comments_of_the_model(
    project: ProjectFolder, data: Json
) -> None:
    saved = project.save("new.toml", data, source="")
    assert parse_design(saved.data, "") == parse_design(data, "")
    assert "# Angle α of a spiral" in saved.text


def test_what_is_there_is_not_written_over_unasked(project: ProjectFolder, data: Json) -> None:
    path = project.root / "short.toml"
    with refused("overwrite-unconfirmed"):
        project.save("short.toml", data, source="short.toml")
    with pytest.raises(ConfirmationError):
        project.save("short.toml", data, source="short.toml", replace="0" * 64)
    assert path.read_text() == DESIGN
    digest = project.open("short.toml").digest
    data["layout"]["rows"] = 9
    project.save("short.toml", data, source="short.toml", replace=digest)
    assert "rows = 9" in path.read_text()
    with pytest.raises(ConfirmationError):  # it is another text by now
        project.save("short.toml", data, source="short.toml", replace=digest)
    project.save("short.toml", data, source="short.toml", force=True)


@pytest.mark.parametrize(
    "name",
    ["../out.toml", "/etc/out.toml", "link/out.toml", "a/../../out.toml", "a\x00.toml", "x.txt",
     "", ".toml", "folder.toml", "a\n.toml", "x" * 5000 + ".toml"],
)  # fmt: skip
def test_nothing_is_written_elsewhere(project: ProjectFolder, data: Json, name: str) -> None:
    (project.root / "folder.toml").mkdir()
    outside = project.root.parent / "outside"
    outside.mkdir()
    (project.root / "link").symlink_to(outside)
    with pytest.raises((InputError, OutputError)):
        project.save(name, data, source="short.toml", force=True)
    assert not list(outside.iterdir())
    assert not (project.root.parent / "out.toml").exists()


def test_a_link_that_leads_out_is_not_followed(project: ProjectFolder, data: Json) -> None:
    target = project.root.parent / "target.toml"
    target.write_text(DESIGN)
    (project.root / "way.toml").symlink_to(target)
    with pytest.raises(InputError):
        project.save("way.toml", data, source="short.toml", force=True)
    with pytest.raises(InputError):
        project.open("way.toml")
    assert target.read_text() == DESIGN


def test_a_design_that_is_none_is_not_saved(project: ProjectFolder, data: Json) -> None:
    data["layout"]["rows"] = -1
    with refused("field-invalid") as caught:
        project.save("short.toml", data, source="short.toml", force=True)
    caught.match(r"layout\.rows")
    assert (project.root / "short.toml").read_text() == DESIGN


def test_files_that_it_names_must_be_found_at_the_new_place(
    project: ProjectFolder, data: Json
) -> None:
    (project.root / "points.csv").write_text(
        "u,v\n" + "\n".join(f"{k}.0,0.5" for k in range(5, 50))
    )
    data["layout"] = {"kind": "explicit", "positions_csv": "points.csv", "height_far_mm": 0.6}
    project.save("beside.toml", data, source="short.toml")
    assert 'positions_csv = "points.csv"' in (project.root / "beside.toml").read_text()
    with refused("positions-file-unreadable"):
        project.save("below/it.toml", data, source="beside.toml")
    assert not (project.root / "below").exists()


def test_a_folder_that_cannot_be_written_is_reported(
    project: ProjectFolder, data: Json, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with refused("output-not-writable"):
        project.save("short.toml", data, source="short.toml", force=True)
    assert (project.root / "short.toml").read_text() == DESIGN
    assert [path.name for path in project.root.iterdir()] == ["short.toml"]


def test_a_file_keeps_its_rights(project: ProjectFolder, data: Json) -> None:
    path = project.root / "short.toml"
    path.chmod(0o640)
    project.save("short.toml", data, source="short.toml", force=True)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    project.save("other.toml", data, source="short.toml")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((project.root / "other.toml").stat().st_mode) == 0o666 & ~mask


def test_designs_of_the_folder_are_found(project: ProjectFolder, data: Json) -> None:
    root = project.root
    for name in ("b/c.toml", ".hidden/d.toml", "exports/x/design.toml", "1/2/3/4/5/deep.toml"):
        (root / name).parent.mkdir(parents=True)
        (root / name).write_text(DESIGN)
    (root / "exports" / "x" / "manifest.json").write_text("{}")
    (root / "other.toml").write_text("[study]\n")
    assert project.designs() == ["b/c.toml", "short.toml"]


def test_saving_over_the_wire(client: Client, place: Path, data: Json) -> None:
    body = {"data": data, "source": "short.toml", "name": "wire.toml"}
    status, opened = client.post("api/save", body)
    assert status == 200
    assert load_design(str(place / "wire.toml")).name == "short"
    status, answer = client.post("api/save", body)
    assert (status, answer) == (
        409,
        {"ask": "wire.toml exists already; overwrite it?", "code": "overwrite-unconfirmed"},
    )
    assert client.post("api/save", {**body, "replace": opened["digest"]})[0] == 200
    assert client.post("api/save", {**body, "force": True})[0] == 200
    assert client.post("api/save", {**body, "force": 1})[0] == 400
    status, answer = client.post("api/open", {"name": "wire.toml"})
    assert (status, answer["data"]) == (200, data)
    assert "wire.toml" in client.get("api/start")[1]["files"]
    text = client.post("api/text", {"data": data, "source": "short.toml"})[1]["text"]
    assert text == DESIGN
