"""What things show of themselves in a notebook, and the tutorial run by a real kernel."""

import json
import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

import phytac_shapes
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.layout import make_markers
from phytac_design.report.notebook import (
    build_html,
    design_html,
    markers_html,
    surface_html,
)
from phytac_design.stages.build import BuildResult
from tests.designs import changed, drawn, small
from tests.long_cases import TUBES, with_long

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "docs" / "tutorial.ipynb"


class Page(HTMLParser):
    """Tags, attributes and text; refuses tags that do not close."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag != "img":
            self.open.append(tag)
        self.tags.append((tag, dict(attrs)))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.tags if name == tag]


@pytest.mark.parametrize("name", with_long(shipped_designs(), TUBES))
def test_designs_show_a_map_of_their_markers(name: str) -> None:
    design = load_design(name)
    markers = make_markers(design, design.surface())
    page = Page(design_html(design))
    (picture,) = page.all("img")
    assert str(picture["alt"]).startswith(f"{markers.count} markers of {name}, ")
    assert str(picture["src"]).startswith("data:image/png;base64,")
    assert f"{markers.count} markers" in page.text


def test_a_design_shows_its_figures() -> None:
    text = Page(design_html(load_design("cylinder60"))).text
    for figure in ("226.2 cm²", "368 markers in 23 rows", "0.5 to 11.5 mm", "1.63 /cm²", "0.5 N"):
        assert figure in text


def test_a_design_without_a_layout_says_why() -> None:
    design = changed("plane", layout={"kind": "spiral"})
    page = Page(design_html(design))
    assert "a spiral needs a surface that closes around" in page.text
    assert page.all("img") == []


def test_text_of_the_reader_is_escaped() -> None:
    design = small(name="a-b", description="<b>&")
    assert "<b>&" not in design_html(design)


@pytest.mark.parametrize("kind", sorted(phytac_shapes.REGISTRY))
def test_surfaces_show_their_facts_and_chart(kind: str) -> None:
    surface = drawn(kind, 3).surface()
    page = Page(surface_html(surface))
    assert "area_outer_mm2" in page.text
    assert str(page.all("img")[0]["alt"]).startswith(f"unrolled {surface.name}, ")


def test_markers_show_their_figures() -> None:
    design = load_design("cylinder60")
    text = Page(markers_html(make_markers(design, design.surface()))).text
    assert "368 markers in 23 rows" in text
    assert "0.5 to 11.5 mm" in text


def test_builds_show_their_files(built: BuildResult) -> None:
    page = Page(build_html(built))
    assert "report/report.html, shell/shell.stl" in page.text
    assert "112 markers" in str([item["alt"] for item in page.all("img")])
    assert "hidden, fused0, 0" in page.text


def test_nothing_heavy_is_imported_for_it() -> None:
    code = (
        "import sys\nfrom phytac_design.design.design_file import load_design\n"
        "from phytac_design.report.notebook import design_html\n"
        "design_html(load_design('cylinder40'))\n"
        "heavy = {'matplotlib.pyplot', 'cadquery', 'torch', 'pyrender', 'IPython'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    code = (
        "import sys, phytac_shapes, phytac_design.design.spec\n"
        "print('phytac_design.report.notebook' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_the_tutorial_is_kept_without_outputs() -> None:
    cells = json.loads(TUTORIAL.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) == 8
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"]] == []


RUNNER = """
import json, sys, warnings
warnings.simplefilter("ignore")  # of the kernel's own libraries
import nbformat
from nbclient import NotebookClient
book = nbformat.read(sys.argv[1], as_version=4)
nbformat.validate(book)
place = {"metadata": {"path": sys.argv[2]}}
NotebookClient(book, timeout=300, kernel_name="python3", resources=place).execute()
print(json.dumps([cell.get("outputs", []) for cell in book.cells]))
"""


@pytest.mark.long
def test_the_tutorial_runs(tmp_path: Path) -> None:
    # The kernel leaves nothing in the user's folders.
    own = {name: str(tmp_path / name) for name in ("JUPYTER_RUNTIME_DIR", "IPYTHONDIR")}
    done = subprocess.run(
        [sys.executable, "-c", RUNNER, str(TUTORIAL), str(tmp_path)],
        env={**os.environ, **own},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    outputs = [item for cell in json.loads(done.stdout) for item in cell]
    shown = [item["data"]["text/html"] for item in outputs if "text/html" in item.get("data", {})]
    assert len(shown) == 5  # design, surface, markers, changed design, build
    assert sum("<img" in "".join(html) for html in shown) == 4  # of all but the markers
    said = "".join(item.get("text", "") for item in outputs if item["output_type"] == "stream")
    assert "0 hidden, 0 fused" in said
    assert "a contact of 10 N: ± 0.19 N" in said
    fused = {line.split("°")[0]: line for line in said.splitlines() if line.startswith("α")}
    assert "  0 fused" not in fused["α =  0.0"]
    assert "  0 fused" in fused["α = 50.5"]
    assert "lower layout.columns" in said
