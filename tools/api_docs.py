"""Write ``docs/api.md``: public names and their docstrings, read from the source.

``python tools/api_docs.py`` writes it; with ``--check`` it only says whether it is up to date.
"""

import ast
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATH = ROOT / "docs" / "api.md"
MODULES: dict[str, tuple[str, ...]] = {
    "Surfaces": (
        "shapes/phytac_shapes/__init__.py",
        "shapes/phytac_shapes/surface.py",
        "shapes/phytac_shapes/variables.py",
    ),
    "Errors": ("shapes/phytac_shapes/errors.py",),
    "Designs": ("phytac_design/design/design_file.py", "phytac_design/rules/design_review.py"),
    "Markers": ("phytac_design/layout/markers.py", "phytac_design/layout/marker_layout.py"),
    "Builds": (
        "phytac_design/stages/build.py",
        "phytac_design/design/accuracy.py",
        "phytac_design/engine/stage.py",
    ),
    "Cameras": (
        "decoder/phytac_decoder/camera/lens.py",
        "decoder/phytac_decoder/camera/camera.py",
        "phytac_design/layout/cameras.py",
        "phytac_design/optics/visibility.py",
    ),
    "Mechanics": (
        "phytac_design/mechanics/meshing/mesh.py",
        "phytac_design/mechanics/shell/solve.py",
        "phytac_design/mechanics/large/load_path.py",
        "phytac_design/mechanics/pressing/press.py",
        "phytac_design/simulation/cramer_rao.py",
    ),
    "Data": (
        "phytac_design/workflows/simulate.py",
        "phytac_design/workflows/import_rig.py",
        "phytac_design/datasets/samples.py",
        "phytac_design/datasets/samples_reader.py",
    ),
    "Decoding": (
        "decoder/phytac_decoder/io/bundle.py",
        "decoder/phytac_decoder/pipeline/decode.py",
        "decoder/phytac_decoder/estimation/estimators.py",
        "decoder/phytac_decoder/io/frame_sources.py",
        "decoder/phytac_decoder/serving/sensor_loop.py",
        "decoder/phytac_decoder/serving/wire_protocol.py",
    ),
    "Searching": (
        "phytac_design/study/planning/plan.py",
        "phytac_design/study/search/study_file.py",
        "phytac_design/study/search/driver.py",
    ),
}
HEAD = """# API

Made by `python tools/api_docs.py` from the docstrings of the modules that other programs are meant
to use; what is not listed may change. Shapes and units of arrays stand with each name; (n, 3) is n
things in rows.
"""

Named = ast.ClassDef | ast.FunctionDef


def page() -> str:
    """The whole page."""
    out = [HEAD]
    for title, files in MODULES.items():
        out.append(f"## {title}\n")
        for name in files:
            out += module(ROOT / name)
    return "\n".join(out)


def module(path: Path) -> list[str]:
    """Heading, what the module is, and its public names."""
    name = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    tree = ast.parse(path.read_text("utf-8"))
    out = [f"### `{name.removesuffix('.__init__')}`\n", f"{first(tree)}\n"]
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
            out += entry(node)
    return out


def entry(node: Named) -> list[str]:
    """A class with its public methods, or a function, with the docstring as it is."""
    out = [f"#### `{signature(node)}`\n"]
    text = ast.get_docstring(node) or ""
    # Numpy's underlined sections would be headings; as text they keep their columns.
    out.append(f"```text\n{text}\n```\n" if "\n" in text else f"{text}\n")
    if isinstance(node, ast.ClassDef):
        methods = [
            f"- `{signature(item)}`: {first(item)}"
            for item in node.body
            if isinstance(item, ast.FunctionDef) and not item.name.startswith("_")
        ]
        out += ["\n".join(methods) + "\n"] if methods else []
    return out


def signature(node: Named) -> str:
    """``name(arguments) -> result``, or ``class Name(Base)``; a property without brackets."""
    if isinstance(node, ast.ClassDef):
        bases = ", ".join(ast.unparse(base) for base in node.bases)
        return f"class {node.name}({bases})" if bases else f"class {node.name}"
    result = f" -> {ast.unparse(node.returns)}" if node.returns else ""
    if any("property" in ast.unparse(item) for item in node.decorator_list):
        return f"{node.name}{result}"
    node.args.args = [item for item in node.args.args if item.arg not in {"self", "cls"}]
    return f"{node.name}({ast.unparse(node.args)}){result}"


def first(node: ast.Module | Named) -> str:
    """First paragraph of a docstring, on one line."""
    return " ".join((ast.get_docstring(node) or "").split("\n\n", 1)[0].split())


def main() -> None:
    """Write the page, or compare."""
    text = page()
    if "--check" in sys.argv[1:]:
        if not PATH.is_file() or PATH.read_text("utf-8") != text:
            sys.exit("docs/api.md is not what the docstrings say; run python tools/api_docs.py")
        return
    PATH.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
