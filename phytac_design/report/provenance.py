"""Where a page comes from: time and settings of each stage, versions, hashes, the design file."""

import platform
from collections.abc import Mapping
from contextlib import suppress
from html import escape
from importlib import metadata
from typing import Any

from phytac_design.core import html as page
from phytac_design.design.design_file import design_hash, to_toml
from phytac_design.engine import cache
from phytac_design.engine.stage import Context
from phytac_design.report import figure_names


def provenance_of(context: Context) -> dict[str, Any]:
    """Versions and hashes, as ``report.json`` holds them."""
    return {
        "design_sha256": design_hash(context.design),
        "program_sha256": cache.code_hash(),
        "python": platform.python_version(),
        "versions": package_versions(),
    }


def package_versions() -> dict[str, str]:
    """Versions of this package and of the libraries that results depend on, where installed."""
    found = {}
    for name in (
        "phytac-design",
        "numpy",
        "scipy",
        "numba",
        "opencv-contrib-python-headless",
        "manifold3d",
        "cadquery",
        "pyrender",
        "matplotlib",
    ):
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def time_section(context: Context, report: Mapping[str, Any]) -> str:
    """Seconds of each stage and its share of the total, and the settings of the build."""
    times = {name: value for name, value in report["timing_s"].items() if name != "total"}
    longest, total = max(times.values()), report["timing_s"]["total"]
    bar = '<span class="bar" style="width:{:.0f}px"></span>'
    rows = [
        (name, s, 100.0 * s / max(total, 1e-9), page.Html(bar.format(160.0 * s / longest)))
        for name, s in times.items()
    ]
    table = page.table(
        ("stage", "time (s)", "share (%)", "drawn"),
        [*rows, ("all stages", total, 100, page.Html(""))],
    )
    scene = context.scene
    limited = (
        (
            "everything of this sensor was built"
            if context.accuracy.tools and context.accuracy.step
            else "what the quick settings have of this sensor was built"
        )
        if scene is None
        else f"only what the scene {scene.name} requires was built: {scene.description}"
    )
    return (
        f"<p>The plan: {escape(limited)}. Times are of when each stage ran; a stage whose inputs "
        "have not changed is taken from the cache. <code>phytac plan</code> says beforehand what a "
        "build costs, <code>phytac tradeoff</code> what each setting's speed costs in newtons.</p>"
        f"{table}" + figure_names.facts({key: report[key] for key in ("accuracy", "seed")})
    )


def provenance_section(context: Context, report: Mapping[str, Any]) -> str:
    """Versions, hashes and the design file, with which this build can be reproduced."""
    made = report["provenance"]
    versions = page.table(
        ("part", "version"), [("python", made["python"]), *made["versions"].items()]
    )
    hashes = page.table(
        ("of", "SHA-256"),
        [("the design", made["design_sha256"]), ("the program", made["program_sha256"])],
    )
    return (
        f"{hashes}{versions}<p>The same design, program and seed give the same files; "
        "manifest.json lists them with their SHA-256.</p>"
        + page.details(
            "The design file, every field",
            f'<pre tabindex="0">{escape(to_toml(context.design))}</pre>',
        )
    )
