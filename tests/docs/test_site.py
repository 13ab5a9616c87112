"""The documentation site: built strictly, whole, without foreign addresses, usable by everyone."""

import html
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from phytac_design.cli.app import PANELS
from phytac_design.design.spec import Design
from tests.docs.pages import ROOT
from tests.docs.site_links import Page, broken_links, read_pages
from tests.report import conftest as report

pytest.importorskip("zensical", reason="no zensical: pip install -e .[docs]")

from benchmarks import tables
from benchmarks.docs import served
from tools import build_site

browser = report.browser
PHONE, DESKTOP = (390, 844), (1280, 900)
LOOKED_AT = {
    "index.html": DESKTOP,
    "docs/start/first-sensor.html": DESKTOP,
    "docs/reference/designs.html": PHONE,
}
"""Pages opened on a phone, and the size at which axe runs; ``benchmarks.docs`` opens all pages."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("docs") / "site"
    with pytest.MonkeyPatch.context() as patch:
        # Which figures are current takes seconds to tell; test_provenance.py, test_docs.py.
        patch.setattr(tables, "is_current", lambda _: True)
        build_site.build_site(out)
    return out


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return read_pages(site)


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """Serve the site on this machine."""
    with served(site) as address:
        yield address


def test_every_page_is_in_the_navigation(site: Path, pages: dict[Path, Page]) -> None:
    settings = tomllib.loads(build_site.CONFIG.read_text("utf-8"))
    listed = list(build_site.navigation(settings["project"]["nav"]))
    assert len(listed) == len(set(listed))
    written = {path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert written <= set(listed)
    built = {path.relative_to(site).with_suffix(".md").as_posix() for path in pages}
    assert built == {re.sub(r"README\.md$", "index.md", name) for name in listed}


def test_no_link_or_anchor_is_broken(pages: dict[Path, Page]) -> None:
    assert broken_links(pages) == []
    assert sum(len(page.links) for page in pages.values()) > 1000


def test_nothing_is_fetched_from_elsewhere(site: Path, pages: dict[Path, Page]) -> None:
    assert [link for page in pages.values() for link in page.fetched if urlsplit(link).netloc] == []
    for style in site.rglob("*.css"):
        assert re.findall(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//", style.read_text()) == []


def test_only_a_site_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("…")
    with pytest.raises(SystemExit, match="other files than a site"):
        build_site.build_site(tmp_path)
    assert (tmp_path / "thesis.tex").is_file()


def test_the_reference_is_complete(site: Path) -> None:
    commands = (site / "docs/reference/commands.html").read_text("utf-8")
    names = {f.__name__.strip("_").replace("_", "-") for panel in PANELS.values() for f in panel}
    assert len(names) > 25
    assert [name for name in names if f'id="phytac-{name}"' not in commands] == []
    fields = html.unescape((site / "docs/reference/design-file.html").read_text("utf-8"))
    schema = Design.model_json_schema()
    sections = [schema, *schema["$defs"].values()]
    wanted = {name for section in sections for name in section["properties"]}
    tables = {table for table in schema["properties"] if f"[{table}]" in fields}
    assert [name for name in wanted - tables if f"<code>{name}</code>" not in fields] == []
    formulas = (site / "docs/theory.html").read_text("utf-8")
    assert "arithmatex" not in formulas
    assert formulas.count("<math") > 50


@pytest.mark.parametrize("size", [PHONE, DESKTOP], ids=["phone", "desktop"])
def test_pages_are_usable(browser: Browser, address: str, size: tuple[int, int]) -> None:
    context = browser.new_context(viewport={"width": size[0], "height": size[1]})
    tab = report.Tab(context.new_page())
    for name, axe_size in LOOKED_AT.items():
        if size not in {axe_size, PHONE}:
            continue
        tab.page.goto(address + name)
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0], name
        found = Axe().run(tab.page).response["violations"] if size == axe_size else []
        serious = [item["id"] for item in found if item["impact"] in {"serious", "critical"}]
        assert (name, serious) == (name, [])
    assert [url for url in tab.fetched if not url.startswith((address, "data:", "blob:"))] == []
    assert tab.errors == []
    context.close()


def test_search_works_without_other_servers(browser: Browser, address: str) -> None:
    tab = report.Tab(browser.new_page(viewport={"width": DESKTOP[0], "height": DESKTOP[1]}))
    with tab.page.expect_request("**/workers/search.*.js"):
        tab.page.goto(address)
    tab.page.keyboard.press("Control+k")
    tab.page.keyboard.type("golden angle")
    tab.page.get_by_text(re.compile(r"^[1-9]\d* results$")).wait_for()
    assert [url for url in tab.fetched if not url.startswith((address, "data:", "blob:"))] == []
    tab.page.close()
