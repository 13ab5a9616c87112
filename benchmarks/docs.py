"""Pages that explain: how hard they are to read, the site's links, its use on desktop and phone.

``python -m benchmarks.docs [--quick] [--parts text,site]``
"""

import functools
import http.server
import re
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from markdown_it import MarkdownIt

from benchmarks.harness import Table, run_parts
from benchmarks.page_browser import DESKTOP, PHONE, chromium, opened, serious_findings
from tests.docs.pages import PAGES, ROOT
from tests.docs.site_links import broken_links, read_pages
from tools.build_site import build_site

README = ROOT / "README.md"
WORDS_MAX = 900
"""Read by a native reader in three minutes."""
GRADE_MAX = 12.0
"""School years: the end of secondary school."""
LONG = 40
"""Words of a sentence that few understand at the first reading."""
QUICK = 3


def sentences_of(text: str) -> list[str]:
    """Sentences of the running text of a page: no code blocks, tables, headings or formulas.

    Parameters
    ----------
    text : str
        Markdown.
    """
    found: list[str] = []
    skipped = 0
    for token in MarkdownIt("commonmark").enable("table").parse(text):
        if token.type.startswith(("heading_", "table_")):
            skipped += token.nesting
        if token.type != "inline" or skipped:
            continue
        words = "".join(_spoken(child) for child in token.children or [])
        words = re.sub(r"\$[^$]*\$", "x", words)
        found += re.split(r"(?<=[.!?])\s+(?=[A-Z`\d(])", " ".join(words.split()))
    return [one for one in found if len(one.split()) > 1]


def _spoken(token: object) -> str:
    """What a reader reads of an inline token; code counts as one word."""
    kind = getattr(token, "type", "")
    if kind == "code_inline":
        return "code"
    if kind in {"softbreak", "hardbreak"}:
        return " "
    return str(getattr(token, "content", "")) if kind == "text" else ""


def reading_grade(sentences: list[str]) -> float:
    """Automated Readability Index, school years (Senter and Smith 1967)."""
    words = [word for one in sentences for word in re.findall(r"[^\W_][\w'’-]*", one)]
    letters = sum(len(re.findall(r"\w", word)) for word in words)
    return 4.71 * letters / len(words) + 0.5 * len(words) / len(sentences) - 21.43


def text(table: Table, *, quick: bool) -> None:
    """Length and reading grade of README and all pages."""
    words = len(README.read_text("utf-8").split())
    table.add("README: words", words, "words", WORDS_MAX, "three minutes", f"< {WORDS_MAX}")
    pages = {path: sentences_of(path.read_text("utf-8")) for path in PAGES}
    every = [one for sentences in pages.values() for one in sentences]
    for name, sentences in (("README", pages[README]), (f"all {len(pages)} pages", every)):
        grade = reading_grade(sentences)
        source = "Automated Readability Index; 12 is the end of secondary school"
        target = f"<= {GRADE_MAX:g}"
        note = f"{len(sentences)} sentences, without tables, code and headings"
        table.add(f"{name}: reading grade", grade, "years", GRADE_MAX, source, target, note)
    long = [one for one in every if len(one.split()) > LONG]
    share = 100.0 * len(long) / len(every)
    case = f"all pages: sentences of more than {LONG} words"
    table.add(case, share, "%", len(every), "sentences in all", "<= 1")
    if not quick:
        hardest = sorted(pages, key=lambda path: -reading_grade(pages[path] or ["none at all."]))
        print("hardest pages:", *(path.relative_to(ROOT) for path in hardest[:QUICK]))


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve a folder on this machine; yields its address."""
    handler = functools.partial(QuietHandler, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


class QuietHandler(http.server.SimpleHTTPRequestHandler):
    """Files of a folder, without a line for each request."""

    def log_message(self, *_: object) -> None:
        """Print nothing."""


def site(table: Table, *, quick: bool) -> None:
    """Build the site strictly; check its links; open every page on desktop and phone."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "site"
        start = time.monotonic()
        build_site(out)
        table.add("site: strict build", time.monotonic() - start, "s", "", "wall time")
        pages = read_pages(out)
        links = sum(len(page.links) for page in pages.values())
        source = f"{links} links of {len(pages)} pages, anchors too"
        broken = broken_links(pages)
        note = "; ".join(f"{page}: {link}" for page, link in broken[:QUICK])
        table.add("site: broken links", len(broken), "links", 0, source, "== 0", note)
        names = [path.relative_to(out).as_posix() for path in pages]
        serious, wide, errors, foreign = [], [], [], []
        with served(out) as address, chromium() as browser:
            for name in names[: QUICK if quick else None]:
                for size in (DESKTOP, PHONE):
                    with opened(browser, address + name, size) as (page, seen):
                        excess = page.evaluate("document.documentElement.scrollWidth") - size[0]
                        wide += [name] * (excess > 0)
                        serious += [f"{name}: {rule}" for rule in serious_findings(page)]
                        errors += seen.errors
                        foreign += [url for url in seen.foreign if not url.startswith(address)]
        shown = QUICK if quick else len(names)
        source = f"{shown} pages, each {DESKTOP[0]} and {PHONE[0]} px wide"
        for case, items in (
            ("serious findings of axe-core", serious),
            ("pages wider than the window", wide),
            ("errors on the console", errors),
            ("requests to other servers", foreign),
        ):
            note = "; ".join(items[:QUICK])
            table.add(f"site: {case}", len(items), "count", 0, source, "== 0", note)


def parts(*, quick: bool) -> dict[str, Callable[[Table], None]]:
    """Parts by name, in order."""
    works: dict[str, Callable[..., None]] = {"text": text, "site": site}
    return {name: partial(work, quick=quick) for name, work in works.items()}


if __name__ == "__main__":
    run_parts("docs", parts, __doc__ or "")
