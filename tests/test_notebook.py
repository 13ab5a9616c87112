"""What things show of themselves in a notebook, and the tutorial run by a real kernel."""

import json
import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import phytac_shapes
from phytac_design.core.notebook_html import MARGIN, map_svg
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.layout import make_markers
from phytac_design.report.notebook import (
    build_html,
    chart_mm,
    design_html,
    markers_html,
    surface_html,
)
from phytac_design.stages.build import BuildResult
from tests.designs import changed, drawn, small

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "docs" / "tutorial.ipynb"
VOID = {"circle", "polyline"}


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


@pytest.mark.parametrize("name", shipped_designs())
def test_designs_show_every_marker_in_its_paint(name: str) -> None:
    design = load_design(name)
    markers = make_markers(design, design.surface())
    page = Page(design_html(design))
    discs = page.all("circle")
    assert len(discs) == markers.count
    paints = {item["fill"] for item in discs}
    assert len(paints) == len(set(markers.colour.tolist()))
    # One paint for one colour, all through.
    pairs = {(item["fill"], k) for item, k in zip(discs, markers.colour.tolist(), strict=True)}
    assert len(pairs) == len(paints)
    assert f"{markers.count} markers" in page.text
    (box,) = (item["viewbox"] for item in page.all("svg"))
    x, y, width, height = map(float, str(box).split())
    for item in discs:
        assert x <= float(str(item["cx"])) <= x + width
        assert y <= float(str(item["cy"])) <= y + height


def test_a_design_shows_its_figures() -> None:
    text = Page(design_html(load_design("cylinder60"))).text
    for figure in ("226.2 cm²", "368 markers in 23 rows", "0.5 to 11.5 mm", "1.63 /cm²", "0.5 N"):
        assert figure in text


def test_a_design_without_a_layout_says_why() -> None:
    design = changed("plane", layout={"kind": "spiral"})
    page = Page(design_html(design))
    assert "a spiral needs a surface that closes around" in page.text
    assert page.all("svg") == []


def test_text_of_the_reader_is_escaped() -> None:
    design = small(name="a-b", description="<b>&")
    assert "<b>&" not in design_html(design)
    marker = map_svg([np.eye(2)], "<i>", points=np.eye(2), names=["<script>", "a & b"])
    assert "<script>" not in marker
    assert 'aria-label="&lt;i&gt;"' in marker


@pytest.mark.parametrize("kind", sorted(phytac_shapes.REGISTRY))
def test_surfaces_show_their_facts_and_chart(kind: str) -> None:
    surface = drawn(kind, 3).surface()
    page = Page(surface_html(surface))
    assert "area_outer_mm2" in page.text
    lines = page.all("polyline")
    assert len(lines) == 4 + 2 * 7
    # Longer side on the screen, with its margins: the whole unrolled chart is in view.
    (box,) = (item["viewbox"] for item in page.all("svg"))
    size = max(map(float, str(box).split()[2:]))
    (u0, u1), (v0, v1) = surface.domain
    u, v = np.meshgrid(np.linspace(u0, u1, 65), np.linspace(v0, v1, 65))
    flat = surface.unwrap(np.column_stack([u.ravel(), v.ravel()]))
    side = float(np.ptp(flat, axis=0).max())
    assert size == pytest.approx((1.0 + 2.0 * MARGIN) * side, rel=0.02)


def test_markers_alone_are_drawn_to_scale() -> None:
    design = load_design("cylinder60")
    surface = design.surface()
    markers = make_markers(design, surface)
    flat = chart_mm(markers)
    # A cylinder unrolls: around by the middle face's radius, along as it is. Distances in space
    # are chords, which the fit takes for lengths.
    assert np.allclose(flat[:, 1], markers.uv[:, 0], rtol=0.01)
    assert np.allclose(flat[:, 0], 29.6 * markers.uv[:, 1], rtol=0.02)
    assert len(Page(markers_html(markers)).all("circle")) == 368


def test_builds_show_their_files(built: BuildResult) -> None:
    page = Page(build_html(built))
    assert "report/report.html, shell/shell.stl" in page.text
    assert "112 markers" in str([item["aria-label"] for item in page.all("svg")])
    assert "hidden, fused0, 0" in page.text


def test_nothing_heavy_is_imported_for_it() -> None:
    code = (
        "import sys\nfrom phytac_design.design.design_file import load_design\n"
        "from phytac_design.report.notebook import design_html\n"
        "design_html(load_design('cylinder40'))\n"
        "heavy = {'matplotlib', 'cadquery', 'torch', 'pyrender', 'IPython'}\n"
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
    assert all("<svg" in "".join(html) for html in shown)
    said = "".join(item.get("text", "") for item in outputs if item["output_type"] == "stream")
    assert "0 hidden, 0 fused" in said
    assert "a contact of 10 N: ± 0.19 N" in said
    fused = {line.split("°")[0]: line for line in said.splitlines() if line.startswith("α")}
    assert "  0 fused" not in fused["α =  0.0"]
    assert "  0 fused" in fused["α = 50.5"]
    assert "lower layout.columns" in said
