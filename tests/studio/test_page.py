"""The studio in a browser: controls move the view, errors stand beside them, saving asks."""

import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from phytac_design.design.design_file import load_design
from tests.studio.place import DESIGN, stand_in, studio

playwright = pytest.importorskip(
    "playwright.sync_api", reason="no playwright: pip install -e .[dev]"
)
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
if not CHROMIUM and not os.environ.get("CI"):
    pytest.skip("no chromium: apt-get install chromium", allow_module_level=True)
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PLAIN = ["--no-sandbox", "--disable-gpu", "--disable-3d-apis"]
"""Without OpenGL, which software draws slowly; the turnable view has a test of its own."""
PATIENCE_MS = 30_000.0


COLOURED = """() => {
  const camera = studio.views.cameras[0], pen = camera.canvas.getContext("2d");
  studio.views.explorer.select(-1);
  studio.views.paint();
  const { data } = pen.getImageData(0, 0, camera.width, camera.height);
  const colours = PhytacColours.of(studio.views.draft.view,
    PhytacColours.find(studio.views.draft.view, "visible"));
  let painted = 0, wrong = 0;
  camera.ids.forEach((id, i) => {
    if (!id) return;
    painted += 1;
    wrong += colours[id - 1].some((value, k) => data[4 * i + k] !== value);
  });
  return [painted, wrong];
}"""
"""Pixels of markers in the camera view, and those that are not in its colour on the map."""


class Seen:
    """A page, and what went wrong in it."""

    def __init__(self, page: "playwright.Page", origin: str) -> None:
        self.page, self.wrong, self.foreign = page, [], []
        page.set_default_timeout(PATIENCE_MS)
        page.on("console", lambda m: self.wrong.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: self.wrong.append(str(e)))
        page.on("request", self.look)
        self.origin = origin

    def look(self, request: "playwright.Request") -> None:
        if not request.url.startswith((self.origin, "data:", "blob:")):
            self.foreign.append(request.url)

    def drafts(self) -> int:
        return int(self.page.evaluate("studio.live.times.length"))

    def drawn(self, after: int) -> None:
        """Wait for one more draft."""
        selector = f"body:not([data-drafts='{after}'])[data-drafts]"
        self.page.locator(selector).wait_for()

    def reached(self, state: str) -> None:
        """Wait until all requested is there."""
        self.page.locator(f"body[data-state='{state}']").wait_for()

    def text_of(self, selector: str) -> str:
        """Text of an element, once it has some."""
        self.page.locator(f"{selector}:not(:empty)").wait_for()
        return self.page.locator(selector).inner_text()

    def picture(self) -> str:
        return str(self.page.evaluate("document.querySelector('#cameras canvas').toDataURL()"))


@pytest.fixture(scope="module")
def browser() -> "Iterator[playwright.Browser]":
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=PLAIN)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("folder")


@pytest.fixture(scope="module")
def seen(browser: "playwright.Browser", folder: Path) -> Iterator[Seen]:
    with studio(folder) as running:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        seen = Seen(page, running.url)
        page.goto(running.url)
        seen.drawn(0)
        yield seen
        page.close()


def test_controls_move_the_views(seen: Seen) -> None:
    page, before, count = seen.page, seen.picture(), seen.drafts()
    dots = page.locator(".map circle").first.get_attribute("cx")
    alpha = page.get_by_label("spiral angle (°)", exact=True)
    assert alpha.input_value() == "50.5"
    alpha.fill("20")
    seen.drawn(count)
    assert seen.picture() != before
    assert page.locator(".map circle").nth(40).get_attribute("cx") != dots
    assert "not saved" in page.locator("#where").inner_text()
    seen.reached("checked")
    assert page.evaluate("studio.model.resolved.layout.spiral_angle_deg") == 20
    count = seen.drafts()
    page.keyboard.press("Control+z")
    seen.drawn(count)
    assert alpha.input_value() == "50.5"
    assert seen.picture() == before
    count = seen.drafts()
    page.get_by_role("button", name="Redo").click()
    seen.drawn(count)
    assert alpha.input_value() == "20"
    page.get_by_role("button", name="Undo").click()


def test_a_broken_rule_stands_beside_its_control(seen: Seen) -> None:
    page = seen.page
    columns = page.locator("#table-layout").get_by_label("columns", exact=True)
    columns.fill("60")
    error = page.locator("[data-path='layout.columns'] .err")
    error.filter(has_text="layout.columns").wait_for()
    assert columns.get_attribute("aria-invalid") == "true"
    assert str(columns.get_attribute("aria-describedby")).endswith("-err")
    assert "cannot be built" in page.locator("#verdict").inner_text()
    columns.fill("")
    error.filter(has_text="enter a number").wait_for()
    columns.fill("14")
    seen.reached("checked")
    assert error.inner_text() == ""
    assert columns.get_attribute("aria-invalid") is None


def test_a_repair_is_found_and_applied(seen: Seen) -> None:
    page = seen.page
    page.evaluate("studio.model.set('camera.stand_off_mm', 3)")
    seen.reached("refused")
    page.get_by_role("button", name="Find a repair").click()
    page.locator("#verdict", has_text='camera.stand_off_mm 3.0 → "fit" repairs it.').wait_for()
    page.get_by_role("button", name="Apply").click()
    seen.reached("checked")
    assert page.locator("#repair").count() == 0
    assert page.evaluate("studio.model.value('camera.stand_off_mm')") == "fit"
    # One step to undo.
    page.get_by_role("button", name="Undo").click()
    assert page.evaluate("studio.model.value('camera.stand_off_mm')") == 3
    seen.reached("refused")
    page.get_by_role("button", name="Undo").click()
    seen.reached("checked")


def test_of_many_moves_the_last_one_counts(seen: Seen) -> None:
    page = seen.page
    slider = page.get_by_label("height far, slider")
    before = page.evaluate("studio.model.past.length")
    for value in (3, 3.5, 4, 4.5, 5, 5.5):
        slider.evaluate(
            "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }", float(value)
        )
    seen.reached("checked")
    tallest = page.locator("#figures tr", has_text="tallest receptor").locator("td")
    assert tallest.inner_text() == "5.5 mm"
    # One step to undo, or more where the machine was slow between moves.
    steps = page.evaluate("studio.model.past.length") - before
    assert 1 <= steps <= 6
    for _ in range(steps):
        page.get_by_role("button", name="Undo").click()
    tallest.filter(has_text="6 mm").wait_for()


def test_another_family_brings_its_own_controls(seen: Seen) -> None:
    page, count = seen.page, seen.drafts()
    page.locator("[data-path='shape.kind'] select").select_option("cone")
    seen.drawn(count)
    assert page.get_by_label("diameter far (mm)", exact=True).is_visible()
    assert page.locator("[data-path='shape.diameter_outer_mm']").count() == 0
    assert page.locator("[data-path='layout.count']").is_hidden()
    # Its layout comes with it, and works.
    seen.reached("checked")
    # Every marker is seen; this camera has too few pixels for the smaller tips.
    verdict = page.locator("#verdict", has_text="Its switches cannot be used as they are.")
    assert "the camera cannot read" in verdict.inner_text()
    assert page.evaluate("studio.model.value('layout.rows')") == load_design("cone").layout.rows
    page.get_by_role("button", name="Undo").click()
    page.get_by_label("diameter outer (mm)", exact=True).first.wait_for()


def test_markers_are_chosen_in_all_views(seen: Seen) -> None:
    page = seen.page
    seen.reached("checked")
    before = seen.picture()
    page.locator("#explorer input[type=number]").fill("17")
    page.locator("#explorer .readout", has_text="Marker 17").wait_for()
    assert seen.picture() != before
    page.locator("#cameras canvas").scroll_into_view_if_needed()
    box = page.locator("#cameras canvas").bounding_box()
    place = page.evaluate("studio.views.cameras[0].tip_px[30]")
    width = page.evaluate("studio.views.cameras[0].width")
    assert box is not None
    share = box["width"] / width
    page.mouse.move(box["x"] + place[0] * share, box["y"] + place[1] * share)
    page.locator("#explorer .readout", has_text="Marker 30").wait_for()
    # Paint changes, to the map's colours.
    page.get_by_label("Colour it like the map").check()
    painted, wrong = page.evaluate(COLOURED)
    assert painted > 1000
    assert wrong == 0
    page.get_by_label("Colour it like the map").uncheck()
    assert page.evaluate(COLOURED)[1] > 0.9 * painted


def test_saving_asks_before_it_writes_over(seen: Seen, folder: Path) -> None:
    page = seen.page
    page.locator("#table-layout").get_by_label("rows", exact=True).fill("7")
    page.get_by_label("name", exact=True).fill("mine")
    page.get_by_label("name", exact=True).press("Tab")
    page.keyboard.press("Control+s")
    dialog = page.locator("#save-dialog")
    dialog.locator("#save-name").fill("mine.toml")
    dialog.get_by_role("button", name="Save", exact=True).click()
    dialog.wait_for(state="hidden")
    assert load_design(str(folder / "mine.toml")).layout.rows == 7
    assert "# Far ones are taller." in (folder / "mine.toml").read_text()
    assert "not saved" not in page.locator("#where").inner_text()
    page.keyboard.press("Control+s")
    dialog.locator("#save-name").fill("short.toml")
    dialog.get_by_role("button", name="Save", exact=True).click()
    page.locator("#save-ask-text", has_text="exists already").wait_for()
    assert (folder / "short.toml").read_text() == DESIGN
    page.keyboard.press("Escape")
    dialog.wait_for(state="hidden")
    assert (folder / "short.toml").read_text() == DESIGN


def test_a_build_shows_its_report_shut_off(
    seen: Seen, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = stand_in(folder, "short")
    script = "try { parent.studio.model } catch (e) { document.title = e.name }"
    page_text = f"<h1>Report of it</h1><script>{script}</script>"
    program.write_text(program.read_text().replace("<h1>Report of it</h1>", page_text))
    monkeypatch.setattr("phytac_design.studio.build_process.sys.executable", str(program))
    page = seen.page
    # The verdict, when it comes, moves the button: a click can miss it, the keyboard cannot.
    seen.reached("checked")
    page.get_by_role("button", name="Build", exact=True).press("Enter")
    assert "is built (draft" in seen.text_of("#build-state")
    frame = page.frame_locator("#report iframe")
    assert frame.locator("h1").inner_text() == "Report of it"
    assert frame.locator("html").evaluate("document.title") == "SecurityError"
    assert "[1/2] views" in page.locator("#build-log pre").text_content()
    (folder / "mode").write_text("bad")
    page.get_by_role("button", name="Build", exact=True).press("Enter")
    assert "thicken it" in seen.text_of("#build-state")
    assert page.locator("#report iframe").count() == 0


def test_a_design_is_shared_by_its_address(
    browser: "playwright.Browser", seen: Seen, folder: Path
) -> None:
    page, count = seen.page, seen.drafts()
    page.get_by_label("description", exact=True).fill("für alle")
    page.get_by_label("spiral angle (°)", exact=True).fill("21")
    seen.drawn(count)
    page.get_by_role("button", name="Share…").click()
    text = page.get_by_label("This text is the design").input_value()
    page.get_by_role("button", name="Close").click()
    assert text.startswith("#design=")
    with studio(folder) as other:
        visit = browser.new_page()
        visited = Seen(visit, other.url)
        visit.goto(other.url + text)
        visited.drawn(0)
        assert visit.get_by_label("spiral angle (°)", exact=True).input_value() == "21"
        assert visit.get_by_label("description", exact=True).input_value() == "für alle"
        assert "not saved" in visit.locator("#where").inner_text()
        assert "#design" not in visit.url
        # Pasted under Open, whole or damaged.
        visit.get_by_role("button", name="Open…").click()
        visit.get_by_label("or the text of a shared one").fill(text[:60])
        visit.get_by_role("button", name="Open", exact=True).click()
        assert "holds no whole design" in visited.text_of("#open-error")
        visit.get_by_label("or the text of a shared one").fill(text)
        visit.get_by_role("button", name="Open", exact=True).click()
        visit.locator("#open-dialog").wait_for(state="hidden")
        visit.close()
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Undo").click()


def test_a_designs_text_is_no_markup(seen: Seen) -> None:
    page = seen.page
    text = "<img src=x onerror=window.hit=1>`<b>`"
    page.get_by_label("description", exact=True).fill(text)
    page.get_by_label("description", exact=True).press("Tab")
    # A draft of an undo before would write its values over what is typed.
    page.locator("body:not([data-state='drawing'])").wait_for()
    page.locator("[data-path='layout.colours'] input").fill('["<img src=x onerror=window.hit=1>"]')
    page.locator("[data-path='layout.colours'] input").press("Tab")
    page.locator("[data-path='layout.colours'] .err").filter(has_text="<img").wait_for()
    assert page.evaluate("window.hit") is None
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Undo").click()


def test_phones_need_no_sideways_scroll(seen: Seen) -> None:
    page = seen.page
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_timeout(300)  # for observers of sizes
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    camera = page.locator("#cameras canvas")
    page.get_by_label("thickness (mm)", exact=True).first.scroll_into_view_if_needed()
    box = camera.bounding_box()
    assert box is not None
    assert 0 <= box["y"] < 200  # the view stays while controls are moved
    page.set_viewport_size({"width": 1280, "height": 900})


def test_axe_finds_nothing_serious(seen: Seen) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    for details in seen.page.locator("#controls details").all()[:8]:
        details.evaluate("e => { e.open = true; }")
    found = axe.Axe().run(seen.page).response["violations"]
    assert [item["id"] for item in found if item["impact"] in {"serious", "critical"}] == []


def test_nothing_went_wrong_and_nothing_left(seen: Seen) -> None:
    # A refused design is an answer with a status of its own, which browsers write down.
    plain = re.compile(r"status of 4(22|09)")
    assert [text for text in seen.wrong if not plain.search(text)] == []
    assert seen.foreign == []


def test_the_shell_turns_where_there_is_opengl(browser: "playwright.Browser", folder: Path) -> None:
    with studio(folder) as running:
        drawing = browser.browser_type.launch(executable_path=CHROMIUM, args=FLAGS)
        page = drawing.new_page(viewport={"width": 700, "height": 500})
        seen = Seen(page, running.url)
        page.goto(running.url)
        seen.drawn(0)
        before = page.evaluate("studio.views.explorer.shell.picture()")
        page.locator("#explorer .shell canvas").press("ArrowLeft")
        assert page.evaluate("studio.views.explorer.shell.picture()") != before
        drawing.close()
        assert (seen.wrong, seen.foreign) == ([], [])
