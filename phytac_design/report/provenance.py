"""Where a page comes from: time and settings of each stage, versions, hashes, the design file."""

import platform
from collections.abc import Mapping
from html import escape
from importlib import metadata
from typing import Any

from phytac_design.core import html as page
from phytac_design.design.design_file import design_hash, to_toml
from phytac_design.engine import cache
from phytac_design.engine.stage import Context
from phytac_design.report import figure_names

PACKAGES = (
    "phytac-design",
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "manifold3d",
    "cadquery",
    "torch",
    "matplotlib",
)
"""Whose versions are listed, where they are installed."""


def provenance_of(context: Context) -> dict[str, Any]:
    """Versions and hashes, as ``report.json`` holds them."""
    return {
        "design_sha256": design_hash(context.design),
        "program_sha256": cache.code_hash(),
        "python": platform.python_version(),
        "versions": {name: version for name in PACKAGES if (version := _version(name))},
    }


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def files_of(context: Context) -> list[tuple[str, int, str]]:
    """Name, bytes and SHA-256 of every file that the stages wrote for the user, sorted."""
    prefix = "export/"
    return sorted(
        (path.removeprefix(prefix), int(size), str(digest))
        for folder in context.folders.values()
        for path, (size, digest) in cache.record(folder)["files"].items()
        if path.startswith(prefix)
    )


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
        "everything of this sensor was built"
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
    files = files_of(context)
    versions = page.table(
        ("part", "version"), [("python", made["python"]), *made["versions"].items()]
    )
    hashes = page.table(
        ("of", "SHA-256"),
        [("the design", made["design_sha256"]), ("the program", made["program_sha256"])],
    )
    listed = page.table(("file", "bytes", "SHA-256"), files)
    return (
        f"{hashes}{versions}<p>The same design, program and seed give the same files. Those beside "
        "this page, as the stages wrote them (design name and regions are stamped into the "
        "decoder's afterwards):</p>"
        + page.details(f"{len(files)} files", listed)
        + page.details(
            "The design file, every field",
            f'<pre tabindex="0">{escape(to_toml(context.design))}</pre>',
        )
    )
