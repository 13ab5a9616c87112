"""Links and fetched addresses of the built documentation site."""

import os
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

FETCHED = {"link": "href", "script": "src", "img": "src", "use": "href", "iframe": "src"}
"""Attributes that make a browser fetch what they name."""


@dataclass
class Page(HTMLParser):
    """Anchors, links and fetched addresses of a page."""

    ids: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {name: value or "" for name, value in attrs}
        self.ids.add(named.get("id", ""))
        if tag == "a" and "href" in named:
            self.links.append(named["href"])
        if FETCHED.get(tag, "") in named:
            self.fetched.append(named[FETCHED[tag]])


def read_pages(site: Path) -> dict[Path, Page]:
    """Every page of a site but that of errors."""
    found = {}
    for path in sorted(site.rglob("*.html")):
        if path.name != "404.html":
            found[path] = Page()
            found[path].feed(path.read_text("utf-8"))
    return found


def broken_links(pages: dict[Path, Page]) -> list[tuple[str, str]]:
    """Pages with links to files or anchors of the site that do not exist."""
    broken = []
    for path, page in pages.items():
        for link in sorted({*page.links, *page.fetched}):
            parts = urlsplit(link)
            if parts.scheme:
                continue
            target = Path(os.path.normpath(path.parent / unquote(parts.path)))
            target = path if not parts.path else target
            target = target / "index.html" if target.is_dir() else target
            anchors = pages[target].ids if target in pages else set()
            if not target.is_file() or (parts.fragment and unquote(parts.fragment) not in anchors):
                broken.append((path.name, link))
    return broken
