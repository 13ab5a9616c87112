"""The page on the API: public names and their docstrings, read from the source.

``python -m benchmarks.tables --out FOLDER`` writes it beside the page on verification.
"""

import ast
from pathlib import Path
from types import ModuleType

import phytac_decoder.camera.camera
import phytac_decoder.camera.lens
import phytac_decoder.estimation.estimators
import phytac_decoder.io.bundle
import phytac_decoder.io.frame_sources
import phytac_decoder.pipeline.decode
import phytac_decoder.serving.sensor_loop
import phytac_decoder.serving.wire_protocol
import phytac_design.datasets.samples
import phytac_design.datasets.samples_reader
import phytac_design.design.accuracy
import phytac_design.design.design_file
import phytac_design.engine.stage
import phytac_design.layout.cameras
import phytac_design.layout.marker_layout
import phytac_design.layout.markers
import phytac_design.layout.sensor
import phytac_design.mechanics.large.load_path
import phytac_design.mechanics.meshing.mesh
import phytac_design.mechanics.pressing.press
import phytac_design.mechanics.shell.solve
import phytac_design.optics.visibility
import phytac_design.rules.design_review
import phytac_design.simulation.cramer_rao
import phytac_design.stages.build
import phytac_design.study.planning.plan
import phytac_design.study.search.driver
import phytac_design.study.search.study_file
import phytac_design.workflows.import_rig
import phytac_design.workflows.simulate
import phytac_shapes.errors
import phytac_shapes.surface
import phytac_shapes.variables

MODULES: dict[str, tuple[ModuleType, ...]] = {
    "Surfaces": (phytac_shapes, phytac_shapes.surface, phytac_shapes.variables),
    "Errors": (phytac_shapes.errors,),
    "Designs": (phytac_design.design.design_file, phytac_design.rules.design_review),
    "Sensor and markers": (
        phytac_design.layout.sensor,
        phytac_design.layout.markers,
        phytac_design.layout.marker_layout,
    ),
    "Builds": (
        phytac_design.stages.build,
        phytac_design.design.accuracy,
        phytac_design.engine.stage,
    ),
    "Cameras": (
        phytac_decoder.camera.lens,
        phytac_decoder.camera.camera,
        phytac_design.layout.cameras,
        phytac_design.optics.visibility,
    ),
    "Mechanics": (
        phytac_design.mechanics.meshing.mesh,
        phytac_design.mechanics.shell.solve,
        phytac_design.mechanics.large.load_path,
        phytac_design.mechanics.pressing.press,
        phytac_design.simulation.cramer_rao,
    ),
    "Data": (
        phytac_design.workflows.simulate,
        phytac_design.workflows.import_rig,
        phytac_design.datasets.samples,
        phytac_design.datasets.samples_reader,
    ),
    "Decoding": (
        phytac_decoder.io.bundle,
        phytac_decoder.pipeline.decode,
        phytac_decoder.estimation.estimators,
        phytac_decoder.io.frame_sources,
        phytac_decoder.serving.sensor_loop,
        phytac_decoder.serving.wire_protocol,
    ),
    "Searching": (
        phytac_design.study.planning.plan,
        phytac_design.study.search.study_file,
        phytac_design.study.search.driver,
    ),
}
HEAD = """# API

Made by `python -m benchmarks.tables --out FOLDER` from the docstrings of the modules that other
programs are meant to use; what is not listed may change. Shapes and units of arrays stand with
each name; (n, 3) is n things in rows.
"""

Named = ast.ClassDef | ast.FunctionDef


def page() -> str:
    """The whole page."""
    out = [HEAD]
    for title, modules in MODULES.items():
        out.append(f"## {title}\n")
        for one in modules:
            out += module(one)
    return "\n".join(out)


def module(one: ModuleType) -> list[str]:
    """Heading, what the module is, and its public names."""
    tree = ast.parse(Path(str(one.__file__)).read_text("utf-8"))
    out = [f"### `{one.__name__}`\n", f"{first(tree)}\n"]
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
