"""How pages are measured: their sentences, the reading grade, and links that lead nowhere."""

from pathlib import Path

import pytest

from benchmarks.docs import reading_grade, sentences_of
from tests.docs.site_links import broken_links, read_pages

PAGE = """# A heading is not read

Press *gently*. The file
`frame.png` holds 3 forces; see [the guide](guide.md).

| a | table |
|---|---|
| is | not read |

- One item.
- Another item, with $F = K u$.

```sh
phytac build
```
"""


def test_only_running_text_counts() -> None:
    assert sentences_of(PAGE) == [
        "Press gently.",
        "The file code holds 3 forces; see the guide.",
        "One item.",
        "Another item, with x.",
    ]


def test_the_grade_is_the_published_formula() -> None:
    # Six words and 23 letters in two sentences.
    sentences = ["Sensors feel forces.", "We see it."]
    assert reading_grade(sentences) == pytest.approx(4.71 * 24 / 6 + 0.5 * 6 / 2 - 21.43)
    long = ["Sensors feel forces and we see it in the pictures of the camera that looks inside."]
    assert reading_grade(long) > reading_grade(sentences) + 4.0


def test_links_and_anchors_that_lead_nowhere_are_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<h1 id="top"></h1><a href="b.html#here"></a><a href="b.html#gone"></a>'
        '<a href="#top"></a><a href="c.html"></a><a href="https://example.org/x"></a>'
    )
    (tmp_path / "b.html").write_text('<p id="here"></p><img src="none.png">')
    found = broken_links(read_pages(tmp_path))
    assert found == [("a.html", "b.html#gone"), ("a.html", "c.html"), ("b.html", "none.png")]
