"""The report in a browser: turns, colours, slides, needs nothing else, is usable by everyone."""

import json
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe

from phytac_design.stages.build import BuildResult
from tests.report.conftest import Tab

Open = Callable[..., Tab]
CHANGED = 0.01
"""Least share of pixels that another view or colouring changes."""
NO_WEBGL = "HTMLCanvasElement.prototype.getContext = () => null"


@pytest.fixture(scope="module")
def tab(opened: Open, built: BuildResult) -> Tab:
    return opened(built.out / "report" / "report.html")


@pytest.fixture(scope="module")
def data(built: BuildResult) -> dict[str, Any]:
    text = (built.out / "report" / "viewer.json").read_text()
    return dict(json.loads(text))


def pixels(tab: Tab, selector: str = ".shell canvas") -> Any:
    """What is seen of an element, once the frames that are due are drawn."""
    tab.page.evaluate(
        "() => new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))"
    )
    shot = tab.page.locator(selector).first.screenshot()
    return cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)


def changed(before: Any, after: Any) -> float:
    """Share of pixels that differ clearly."""
    assert before.shape == after.shape
    return float((np.abs(before.astype(int) - after).max(axis=2) > 24).mean())


def numbers(data: dict[str, Any], key: str) -> Any:
    """Values of a colouring, decoded here."""
    import base64

    (item,) = (item for item in data["colourings"] if item["key"] == key)
    return np.frombuffer(base64.b64decode(item["values"]), "<f4")


def test_the_shell_turns(tab: Tab) -> None:
    canvas = tab.page.locator(".shell canvas")
    first = pixels(tab)
    assert len(np.unique(first.reshape(-1, 3), axis=0)) > 100  # a picture, not a blank
    canvas.focus()
    for _ in range(4):
        tab.page.keyboard.press("ArrowRight")
    turned = pixels(tab)
    assert changed(first, turned) > CHANGED
    tab.page.keyboard.press("ArrowUp")
    assert changed(turned, pixels(tab)) > CHANGED
    tab.page.keyboard.press("Home")
    # The mark of the focused element is not part of the picture.
    assert changed(first, pixels(tab)) < CHANGED
    tab.page.keyboard.press("+")
    assert changed(first, pixels(tab)) > CHANGED
    tab.page.keyboard.press("Home")
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.page.mouse.move(x, y)
    tab.page.mouse.down()
    tab.page.mouse.move(x + 80, y + 10, steps=4)
    tab.page.mouse.up()
    assert changed(first, pixels(tab)) > CHANGED
    tab.page.get_by_role("button", name="Turn back").click()


def test_the_view_can_be_saved(tab: Tab) -> None:
    with tab.page.expect_download() as started:
        tab.page.get_by_role("button", name="Save picture").click()
    saved = cv2.imdecode(np.fromfile(started.value.path(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert saved is not None
    assert len(np.unique(saved.reshape(-1, saved.shape[2]), axis=0)) > 100


def test_the_wall_can_be_cut_seen_through_or_left_out(tab: Tab) -> None:
    wall = tab.page.get_by_label("Wall")
    seen = {}
    for mode in ("none", "clear", "cut"):
        wall.select_option(mode)
        seen[mode] = pixels(tab)
    assert changed(seen["cut"], seen["clear"]) > CHANGED
    assert changed(seen["cut"], seen["none"]) > CHANGED


def test_colourings_switch(tab: Tab, data: dict[str, Any]) -> None:
    by = tab.page.get_by_label("Colour by")
    circles = "[...document.querySelectorAll('.map circle')].slice(0, -1)"
    fills = f"{circles}.map(circle => circle.getAttribute('fill'))"
    seen: dict[str, list[str]] = {}
    keys = [item["key"] for item in data["colourings"]]
    assert {"paint", "id", "visible_fraction", "density", "bound_N", "error_N"} <= set(keys)
    for key in keys:
        by.select_option(key)
        seen[key] = tab.page.evaluate(fills)
        assert len(seen[key]) == len(data["markers"]["names"])
        assert not any("NaN" in fill for fill in seen[key]), key
        values = numbers(data, key)
        if key in {"height_mm", "softness"}:  # as many colours as there are values, and where
            order = {fill: k for k, fill in enumerate(dict.fromkeys(seen[key]))}
            same = [values[np.array([order[f] for f in seen[key]]) == k] for k in range(len(order))]
            assert max(float(np.ptp(group)) for group in same) < 0.02 * np.ptp(values)
    assert len(set(seen["paint"])) == 2
    assert len(set(seen["id"])) > 20
    assert seen["height_mm"] != seen["bound_N"] != seen["density"]
    by.select_option("height_mm")
    legend = tab.page.locator(".legend").inner_text()
    assert "mm" in legend
    assert f"{numbers(data, 'height_mm').max():g}" in legend
    high = pixels(tab)
    by.select_option("paint")
    assert changed(high, pixels(tab)) > CHANGED / 4  # tips are small


def test_markers_tell_their_numbers(tab: Tab, data: dict[str, Any]) -> None:
    page = tab.page
    page.locator(".map circle").nth(20).hover()
    said = page.locator(".readout").inner_text()
    assert said.startswith("Marker 20 (" + data["markers"]["names"][20])
    # JavaScript's toPrecision(4) of the same float32.
    height = float(f"{numbers(data, 'height_mm')[20]:.4g}")
    assert f"receptor height {height:g} mm" in said
    page.locator(".map svg").focus()
    page.keyboard.press("ArrowUp")  # along the sensor: the next row, 14 markers on
    moved = page.evaluate("document.querySelector('.explorer').explorer.marker")
    assert 20 + 10 <= moved <= 20 + 18
    page.get_by_label("Marker", exact=True).fill("3")
    assert page.locator(".readout").inner_text().startswith("Marker 3 (")
    page.get_by_text("All markers as a table").click()
    page.locator(".all tbody tr").last.wait_for()
    assert page.locator(".all tbody tr").count() == len(data["markers"]["names"])
    page.get_by_text("All markers as a table").click()


def test_the_slider_presses(tab: Tab) -> None:
    page = tab.page
    slider = page.get_by_label("Force of the press")
    shown = page.locator(".press img:visible")
    slider.focus()
    page.keyboard.press("Home")
    assert shown.count() == 2
    assert "at rest" in str(shown.first.get_attribute("alt"))
    assert page.locator(".press output").inner_text().startswith("0 N, 0 switches")
    rest = pixels(tab, ".press figure:nth-child(2) img.on")
    page.keyboard.press("ArrowRight")
    assert "5 N" in page.locator(".press output").inner_text()
    page.keyboard.press("End")
    assert "25 N" in str(shown.last.get_attribute("alt"))
    assert changed(rest, pixels(tab, ".press figure:nth-child(2) img.on")) > CHANGED / 4


def test_nothing_is_fetched_and_nothing_fails(tab: Tab) -> None:
    """Comes after the tests that use the page."""
    assert tab.errors == []
    assert tab.foreign == []
    assert len(tab.fetched) >= 1  # the page itself: requests are seen
    with pytest.raises(Exception, match=r"Failed to fetch|Refused|Content Security"):
        tab.page.evaluate("fetch('https://example.org/')")


def test_no_serious_finding_of_axe(tab: Tab) -> None:
    for fold in tab.page.locator("section > details > summary").all():
        fold.click()
    tab.page.get_by_text("All markers as a table").click()
    tab.page.locator(".all tbody tr").last.wait_for()
    found = Axe().run(tab.page).response["violations"]
    serious = [
        (item["id"], [node["html"][:120] for node in item["nodes"]][:3])
        for item in found
        if item["impact"] in {"serious", "critical"}
    ]
    assert serious == []


def test_it_prints_with_pictures(tab: Tab) -> None:
    page = tab.page
    page.get_by_label("Force of the press").fill("2")
    page.emulate_media(media="print")
    try:
        assert page.locator(".shell .still").is_visible()
        assert not page.locator(".shell canvas").is_visible()
        alts = [
            str(image.get_attribute("alt")) for image in page.locator(".press img:visible").all()
        ]
        assert ["rest" in alt for alt in alts] == [True, False, True, False]
        assert not page.get_by_label("Colour by").is_visible()
    finally:
        page.emulate_media(media="screen")


def test_it_fits_a_phone(opened: Open, built: BuildResult) -> None:
    small = opened(built.out / "report" / "report.html", (390, 844))
    assert small.page.evaluate("document.documentElement.scrollWidth") <= 390
    small.page.get_by_text("All markers as a table").click()
    for fold in small.page.locator("section > details > summary").all():
        fold.click()
    small.page.locator(".all tbody tr").last.wait_for()
    stuck = """[...document.querySelectorAll('table, pre')].filter(
        part => part.scrollWidth > part.clientWidth && part.tabIndex < 0).length"""
    assert small.page.evaluate(stuck) == 0
    assert small.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert small.errors == []


def test_without_webgl_a_picture_stands_for_the_shell(opened: Open, built: BuildResult) -> None:
    flat = opened(built.out / "report" / "report.html", before=NO_WEBGL)
    assert flat.page.locator(".shell .still").is_visible()
    assert flat.page.locator(".shell canvas").count() == 0
    flat.page.get_by_label("Colour by").select_option("height_mm")
    flat.page.locator(".map circle").nth(5).hover()
    assert flat.page.locator(".readout").inner_text().startswith("Marker 5 (")
    assert flat.errors == []


def test_without_scripts_everything_is_there(opened: Open, built: BuildResult) -> None:
    plain = opened(built.out / "report" / "report.html", scripts=False)
    for part in (".shell .still", ".map .still"):
        assert plain.page.locator(part).is_visible()
    assert plain.page.locator(".press img:visible").count() == 4
    assert not plain.page.get_by_label("Force of the press").is_visible()
