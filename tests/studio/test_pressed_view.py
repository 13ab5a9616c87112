"""A press that is dragged over the camera view: what the server draws, and the page's ring."""

import os
import shutil
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from phytac_design.design.design_file import parse_design
from phytac_design.studio.draft import draft
from phytac_design.studio.pressed_view import PressView
from phytac_shapes.arrays import FloatArray, ImageArray
from tests.designs import changed
from tests.studio.place import Client, studio

Json = dict[str, Any]
SIDE = 400


def never() -> None:
    pass


@pytest.fixture(scope="module")
def view() -> PressView:
    return PressView(design=changed(**SHORT), side_px=SIDE)


SHORT: Json = {
    "base": "cylinder60",
    "shape": {"length_mm": 60.0},
    "layout": {"rows": 8, "columns": 14, "height_far_mm": 6.0},
    "camera": {"width_px": 648, "height_px": 486, "focal_px": 242.5},
}


def picture(camera: Json) -> ImageArray:
    return np.asarray(cv2.imdecode(np.frombuffer(b64decode(camera["jpeg"]), np.uint8), 1))


def red(image: ImageArray) -> int:
    level = image.astype(int)
    return int(((level[:, :, 2] > 150) & (level[:, :, :2].max(axis=2) < 100)).sum())


def place_of(view: PressView, uv: FloatArray) -> FloatArray:
    """Where camera 0 sees the wall at a chart position (2,), as shares of the image."""
    surface, camera = view.sensor.surface, view.cameras[0]
    wall = surface.point(uv[None]) - view.design.wall.thickness_mm * surface.normal(uv[None])
    size = np.array([camera.width_px, camera.height_px])
    return np.asarray((camera.project(wall)[0] + 0.5) / size)


@pytest.mark.parametrize("shares", [(0.3, 0.2), (0.5, 0.63), (0.8, 0.999)])
def test_the_wall_under_the_pointer_is_pressed(view: PressView, shares: Any) -> None:
    low, high = view.sensor.surface.domain.T
    wanted = low + np.array(shares) * (high - low)
    camera = view.cameras[0]
    at_px = place_of(view, wanted) * [camera.width_px, camera.height_px] - 0.5
    assert view.chart_position(0, at_px) == pytest.approx(wanted, abs=1e-6)


def test_beside_the_wall_its_nearest_edge_is_pressed(view: PressView) -> None:
    uv = view.chart_position(0, np.array([-60.0, 150.0]))
    low, high = view.sensor.surface.domain.T
    assert (uv >= low).all()
    assert (uv <= high).all()
    assert uv[0] < low[0] + 0.2 * (high[0] - low[0])


def test_no_force_shows_the_draft_and_force_moves_markers_in_proportion(view: PressView) -> None:
    rest = draft(view.design, never, SIDE)
    place = place_of(view, view.sensor.markers.uv[30])
    none, some, twice = (view.draw(0, place, force, never) for force in (0.0, 5.0, 10.0))
    assert (none["on"], none["marker"], none["dent_mm"]) == (0, 30, 0.0)
    tips = [np.array(one["cameras"][0]["tip_px"]) for one in (rest, none, some, twice)]
    assert tips[1] == pytest.approx(tips[0], abs=1e-3)
    moved = np.linalg.norm(tips[2] - tips[0], axis=1)
    assert moved.argmax() in {16, 29, 30, 31, 43, 44, 45}
    assert twice["dent_mm"] == pytest.approx(2.0 * some["dent_mm"], rel=1e-6)
    assert twice["dent_mm"] > 0.05
    # Tips come out, and the picture shows them and the dent.
    assert twice["on"] >= 1
    assert red(picture(twice["cameras"][0])) > red(picture(none["cameras"][0])) + 3
    assert twice["cameras"][0]["press"] == pytest.approx(place.tolist(), abs=1e-6)


def test_the_studio_draws_a_press(client: Client, data: Json) -> None:
    body = {"data": data, "source": "", "tab": "p", "side_px": SIDE, "camera": 0, "x": 0.5,
            "y": 0.3, "force_N": 8.0}  # fmt: skip
    status, drawn = client.post("api/press", body)
    assert status == 200
    own = PressView(design=parse_design(data, ""), side_px=SIDE)
    expected = own.draw(0, np.array([0.5, 0.3]), 8.0, never)
    assert drawn == expected
    assert client.post("api/press", {**body, "x": 1.5})[0] == 400
    status, refused = client.post("api/press", {**body, "data": {**data, "wall": {"rows": 3}}})
    assert status == 422
    assert "it belongs to [layout]" in refused["error"]


CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    driver = pytest.importorskip("playwright.sync_api")
    if not CHROMIUM and not os.environ.get("CI"):
        pytest.skip("no chromium: apt-get install chromium")
    plain = ["--no-sandbox", "--disable-gpu", "--disable-3d-apis"]
    with driver.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=plain)
        yield browser
        browser.close()


class Pressed:
    """A page of the studio with its press."""

    def __init__(self, page: Any, url: str) -> None:
        self.page, self.asked, self.wrong = page, list[Json](), list[str]()
        page.set_default_timeout(60_000.0)
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("request", self._note)
        page.goto(url)
        page.locator("body[data-drafts]").wait_for()

    def _note(self, request: Any) -> None:
        if request.url.endswith("api/press"):
            self.asked.append(request.post_data_json)

    def shown(self) -> str:
        """The picture, once all that was asked for is drawn."""
        self.page.locator("body[data-press='shown'][data-presses]").wait_for()
        return str(self.page.evaluate("document.querySelector('#cameras canvas').toDataURL()"))

    def after(self, count: int) -> str:
        """The same after more presses than a number."""
        self.page.locator(f"body[data-press='shown']:not([data-presses='{count}'])").wait_for()
        return self.shown()

    def count(self) -> int:
        return int(self.page.evaluate("Number(document.body.dataset.presses || 0)"))

    def ring(self) -> tuple[float, float]:
        box = self.page.locator(".press-handle").bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_the_ring_is_dragged_by_mouse_and_moved_by_keys(browser: Any, tmp_path: Path) -> None:
    with studio(tmp_path) as running:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        own = Pressed(page, running.url)
        rest = page.evaluate("document.querySelector('#cameras canvas').toDataURL()")
        assert page.locator("#press-force").is_disabled()
        page.get_by_label("Press it").check()
        first = own.shown()
        assert first != rest
        assert "switches on" in page.locator("#press-text").inner_text()
        x, y = own.ring()
        before, count = len(own.asked), own.count()
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60.0, y + 30.0, steps=25)
        own.after(count)
        # The ring is under the pointer, whatever the server has answered until then.
        assert own.ring() == pytest.approx((x + 60.0, y + 30.0), abs=1.5)
        page.mouse.up()
        dragged = own.shown()
        assert dragged != first
        # One request at a time, the last of the newest place.
        asked = own.asked[before:]
        assert 1 <= len(asked) < 25
        box = page.locator("#cameras canvas").bounding_box()
        assert asked[-1]["x"] == pytest.approx((x + 60.0 - box["x"]) / box["width"], abs=0.01)
        assert asked[-1]["y"] == pytest.approx((y + 30.0 - box["y"]) / box["height"], abs=0.01)
        count = own.count()
        page.locator(".press-handle").press("Shift+ArrowLeft")
        moved = own.after(count)
        assert moved != dragged
        assert own.asked[-1]["x"] == pytest.approx(asked[-1]["x"] - 0.1, abs=0.02)
        count = own.count()
        page.locator("#press-force").press("End")
        assert own.after(count) != moved
        assert own.asked[-1]["force_N"] == 25.0
        # Another design is pressed at the same place.
        count = own.count()
        page.get_by_label("spiral angle (°)", exact=True).fill("20")
        own.after(count)
        assert own.asked[-1]["data"]["layout"]["spiral_angle_deg"] == 20
        count = own.count()
        page.get_by_role("button", name="Undo").click()
        own.after(count)
        page.get_by_label("Press it").uncheck()
        assert page.evaluate("document.querySelector('#cameras canvas').toDataURL()") == rest
        assert page.locator(".press-handle").count() == 0
        assert own.wrong == []
        page.close()


def test_nothing_moves_under_the_pointer_when_the_verdict_comes(
    browser: Any, tmp_path: Path
) -> None:
    top = "document.querySelector('#cameras canvas').getBoundingClientRect().top"
    with studio(tmp_path) as running:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        held: list[Any] = []

        def hold(route: Any) -> None:
            held.append(route)

        page.route("**/api/check", hold)
        Pressed(page, running.url)
        page.wait_for_function("document.querySelector('#verdict.wait .foot')")
        before = page.evaluate(top)
        while not held:
            page.wait_for_timeout(20)
        held[0].continue_()
        page.locator("#verdict:not(.wait)").wait_for()
        assert "Every marker is visible" in page.locator("#verdict").inner_text()
        assert page.evaluate(top) == before


def test_the_ring_is_dragged_by_a_finger(browser: Any, tmp_path: Path) -> None:
    with studio(tmp_path) as running:
        phone = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
        page = phone.new_page()
        own = Pressed(page, running.url)
        page.get_by_label("Press it").check()
        # At this width the verdict may be a line shorter than the text before it.
        page.locator("#verdict:not(.wait)").wait_for()
        first, count = own.shown(), own.count()
        x, y = own.ring()
        # Else the browser takes a finger's motion for scrolling.
        style = "e => getComputedStyle(e).touchAction"
        assert page.locator(".press-handle").evaluate(style) == "none"
        finger = phone.new_cdp_session(page)
        scrolled = page.evaluate("window.scrollY")
        for kind, at in (("touchStart", 0.0), ("touchMove", 8.0), ("touchMove", 40.0)):
            finger.send("Input.dispatchTouchEvent",
                        {"type": kind, "touchPoints": [{"x": x, "y": y + at}]})  # fmt: skip
        finger.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        assert own.after(count) != first
        assert page.evaluate("window.scrollY") == scrolled
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        box = page.locator("#cameras canvas").bounding_box()
        assert own.asked[-1]["y"] == pytest.approx((y + 40.0 - box["y"]) / box["height"], abs=0.01)
        assert own.wrong == []
        phone.close()
