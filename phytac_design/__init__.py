"""The design tool: from one design file to shell, proof of visibility, mesh and decoder."""

import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

__version__ = "0.1.0"


def _html(function: str, value: Any) -> str:
    """Call a function of :mod:`phytac_design.report.notebook`, imported at its first use."""
    formatter: Callable[[Any], str] = getattr(
        import_module("phytac_design.report.notebook"), function
    )
    return formatter(value)


def _register_notebook_formatters() -> None:
    """Show surfaces, designs, markers and builds as HTML where this runs in a notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    if shell is None:
        return
    formatter = shell.display_formatter.formatters["text/html"]
    for module, name, function in (
        ("phytac_shapes.surface", "Surface", "surface_html"),
        ("phytac_design.design.spec", "Design", "design_html"),
        ("phytac_design.layout.markers", "Markers", "markers_html"),
        ("phytac_design.stages.build", "BuildResult", "build_html"),
    ):
        formatter.for_type_by_name(module, name, partial(_html, function))


_register_notebook_formatters()
