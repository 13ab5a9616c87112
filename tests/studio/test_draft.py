"""Drafts and checks over the wire, and that of several requests only the newest counts."""

import asyncio
import threading
import time
from base64 import b64decode
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_design.design.design_file import parse_design
from phytac_design.layout.cameras import camera_of
from phytac_design.rules.design_review import checkup
from phytac_design.studio.draft import draft, exact, id_image, small_camera
from phytac_design.studio.form import WHEN, error_body, field_paths, form
from phytac_design.studio.latest_only import Check, LatestOnlyExecutor, SupersededError
from phytac_design.workflows import design_check
from phytac_shapes.errors import DesignError
from tests.studio.place import Client

Json = dict[str, Any]


def never() -> None:
    pass


def measured(drawn: Json) -> dict[str, float]:
    return {item["name"]: item["value"] for item in drawn["measures"]}


def test_a_draft_has_what_the_check_finds(client: Client, data: Json) -> None:
    status, drawn = client.post("api/draft", {"data": data, "source": "short.toml", "tab": "a"})
    assert status == 200
    assert drawn["refused"] == ""
    found, facts = measured(drawn), checkup(parse_design(data, ""))
    assert found["marker_count"] == facts["markers"]["count"] == 112
    assert found["density_mean_per_cm2"] == pytest.approx(facts["markers"]["density_per_cm2"])
    assert found["sampled_hidden"] == facts["visibility"]["occluded"] == 0
    assert found["sampled_visible_least"] == pytest.approx(
        facts["visibility"]["min_visible_fraction"], abs=0.05
    )
    assert drawn["cameras"][0]["stand_off_mm"] == pytest.approx(facts["stand_off_mm"])
    assert drawn["resolved"]["layout"]["rows"] == 8
    status, checked = client.post("api/check", {"data": data, "source": "", "tab": "a"})
    assert status == 200
    for key in ("warnings", "advice", "clear"):
        assert checked[key] == facts[key]
    assert checked["occluded"] == facts["occluded_markers"]
    assert (checked["visible"], checked["faults"]) == (facts["clear"], [])


def test_the_studio_rejects_the_switches_that_the_check_rejects(
    data: Json, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cannot(*_: object, **__: object) -> None:
        raise DesignError("switch-infeasible", "no bowl has 9 N; raise the footprint")

    monkeypatch.setattr(design_check, "check_thresholds", cannot)
    found = exact(parse_design(data, ""))
    assert (found["visible"], found["clear"]) == (True, False)
    assert found["faults"][0]["text"].startswith("no bowl has 9 N")


def test_the_picture_shows_each_marker_at_its_place(data: Json) -> None:
    drawn = draft(parse_design(data, ""), never, 400)
    camera = drawn["cameras"][0]
    assert (camera["width"], camera["height"]) == (400, 300)
    picture = cv2.imdecode(np.frombuffer(b64decode(camera["jpeg"]), np.uint8), 1)
    code = cv2.imdecode(np.frombuffer(b64decode(camera["ids"]), np.uint8), 1).astype(int)
    owner = 256 * code[:, :, 1] + code[:, :, 2] - 1
    assert picture.shape[:2] == owner.shape == (300, 400)
    assert set(np.unique(owner)) == set(range(-1, 112))
    tip = np.array(camera["tip_px"])
    for marker in (0, 50, 111):
        seen = np.argwhere(owner == marker)[:, ::-1].mean(axis=0)
        assert np.linalg.norm(seen - tip[marker]) < 4.0
    # Blue and green paint, where the numbers say that there is a marker.
    painted = picture[owner >= 0].astype(int)
    assert np.mean(painted[:, :2].max(axis=1) > painted[:, 2] + 20) > 0.9


def test_numbers_of_many_markers_pass_through_the_picture() -> None:
    owner = np.arange(-1, 4999, dtype=np.int32).reshape(50, 100)
    code = cv2.imdecode(cv2.imencode(".png", id_image(owner))[1], 1).astype(int)
    assert np.array_equal(256 * code[:, :, 1] + code[:, :, 2] - 1, owner)


def test_a_small_view_is_the_same_view(data: Json) -> None:
    design = parse_design(data, "")
    camera = camera_of(design, design.surface())
    points = np.array([[10.0, 5.0, 20.0], [-20.0, 8.0, 55.0]])
    share = 400 / 648
    expected = (camera.project(points) + 0.5) * share - 0.5
    assert np.allclose(small_camera(camera, 400).project(points), expected, atol=1e-9)
    assert small_camera(camera, 5000).width_px == 648


def test_alpha_turns_the_rows(data: Json) -> None:
    before = draft(parse_design(data, ""), never)
    data["layout"]["spiral_angle_deg"] = 20.0
    after = draft(parse_design(data, ""), never)
    assert before["view"]["map"]["points"] != after["view"]["map"]["points"]
    assert before["cameras"][0]["jpeg"] != after["cameras"][0]["jpeg"]


def test_a_broken_rule_is_reported_and_drawn(client: Client, data: Json) -> None:
    data["layout"]["columns"] = 60
    status, drawn = client.post("api/draft", {"data": data, "source": "", "tab": "b"})
    with pytest.raises(DesignError) as refused:
        checkup(parse_design(data, ""))
    assert status == 200
    assert drawn["refused"] == str(refused.value)
    assert measured(drawn)["marker_count"] == 480
    assert "layout.columns" in drawn["fields"]
    status, body = client.post("api/check", {"data": data, "source": "", "tab": "b"})
    assert (status, body["error"]) == (422, drawn["refused"])


@pytest.mark.parametrize(
    ("table", "key", "value", "said"),
    [
        ("layout", "rows", "many", "layout.rows: input should be a valid integer"),
        ("layout", "rows", 2001, "less than or equal to 2000"),
        ("layout", "spiral_angle_deg", None, "valid number"),
        ("layout", "spiral_angel_deg", 10.0, "did you mean 'spiral_angle_deg'?"),
        ("layout", "rows", 10**300, "layout.rows"),
        ("camera", "stand_off_mm", "far", "or 'fit'"),
        ("camera", "calibration", "nothing.yaml", "camera"),
        ("layout", "columns", 2000, "the studio draws up to 5000"),
    ],
)
def test_an_error_is_reported_beside_its_control(
    client: Client, data: Json, table: str, key: str, value: Any, said: str
) -> None:
    data[table][key] = value
    status, body = client.post("api/draft", {"data": data, "source": "", "tab": "c"})
    assert status == 422
    assert said in body["error"]
    if f"{table}.{key}" in field_paths():
        assert f"{table}.{key}" in body["fields"] or key == "calibration"


@pytest.mark.parametrize(
    "data", [{}, {"name": 1}, {"shape": []}, {"name": "a", "shape": {"kind": "ball"}}]
)
def test_tables_that_are_no_design_are_rejected(client: Client, data: Json) -> None:
    status, body = client.post("api/draft", {"data": data, "source": "", "tab": "d"})
    assert status == 422
    assert "name" in body["error"] or "shape" in body["error"]


def test_errors_go_to_the_controls_they_name() -> None:
    paths = ["layout.rows", "layout.height_far_mm", "camera.rows_px", "name", "wall.thickness_mm"]
    two = "the design: layout.rows: too many (got 9); wall.thickness_mm: too thin; or thicker"
    fields = error_body(two, paths)["fields"]
    assert fields == {
        "layout.rows": "layout.rows: too many (got 9)",
        "wall.thickness_mm": "wall.thickness_mm: too thin; or thicker",
    }
    assert list(error_body("tips collide; lower height_far_mm below 24", paths)["fields"]) == [
        "layout.height_far_mm"
    ]
    assert error_body("the name of it all is wrong", paths)["fields"] == {}


def test_the_form_has_every_field_of_the_model() -> None:
    made, paths = form(), set(field_paths())
    for kind, example in made["examples"].items():
        design = parse_design({"name": "x", **example}, "")
        for table, values in design.model_dump().items():
            own = {f"{table}.{key}" for key in values} if isinstance(values, dict) else {table}
            assert own <= paths
        assert {f["path"] for f in made["shapes"][kind]} == {
            f"shape.{k}" for k in example["shape"]
        } - {"shape.kind"}
    alpha = next(
        f for t in made["tables"] for f in t["fields"] if f["path"] == "layout.spiral_angle_deg"
    )
    assert (alpha["unit"], alpha["low"], alpha["high"], alpha["low_open"]) == (
        "°",
        -89.0,
        89.0,
        True,
    )
    assert alpha["doc"].startswith("Angle α")
    known = {f["path"]: f for t in made["tables"] for f in t["fields"]}
    for path, (on, of) in WHEN.items():
        assert path in known
        assert set(of) <= set(known[on]["words"])
    for path, names in made["sets"].items():
        assert {f"{path.split('.')[0]}.{name}" for name in names} <= set(known)


def test_only_the_newest_counts() -> None:
    done: list[int] = []
    entered, leave = threading.Event(), threading.Event()

    def slow(check: Check) -> int:
        entered.set()
        assert leave.wait(5.0)
        check()
        done.append(1)
        return 1

    def quick(number: int) -> Any:
        return lambda _: done.append(number) or number

    async def work() -> list[Any]:
        executor = LatestOnlyExecutor("test")
        first = asyncio.create_task(executor.run("tab", slow))
        assert await asyncio.to_thread(entered.wait, 5.0)
        second = asyncio.create_task(executor.run("tab", quick(2)))
        await asyncio.sleep(0)
        third = asyncio.create_task(executor.run("tab", quick(3)))
        other = asyncio.create_task(executor.run("other", quick(4)))
        await asyncio.sleep(0.05)
        leave.set()
        out = await asyncio.gather(first, second, third, other, return_exceptions=True)
        executor.close()
        return out

    out = asyncio.run(work())
    assert [isinstance(item, SupersededError) for item in out] == [True, True, False, False]
    assert done == [3, 4]


def test_a_superseded_request_is_answered_as_such(client: Client, data: Json) -> None:
    answers: list[tuple[int, bool]] = []

    def ask() -> None:
        status, body = client.post("api/draft", {"data": data, "source": "", "tab": "e"})
        answers.append((status, "stale" in body))

    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
        time.sleep(0.005)
    for thread in threads:
        thread.join(30.0)
    assert set(answers) == {(200, False), (200, True)}
