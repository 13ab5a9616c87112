"""Builds side by side: key figures, what differs in their designs, maps and shells."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, get_args

from phytac_design.core import html as page
from phytac_design.report import verdict
from phytac_design.report.built_sensors import FIGURES, PICTURES, Build, keyed
from phytac_design.report.viewer.assets import data_tag, script_tags, style
from phytac_design.report.viewer.data import LOG_RANGE


def differences(builds: Sequence[Build]) -> dict[str, list[Any]]:
    """Fields of the design files that are not the same in all builds, by dotted name."""
    fields = dict.fromkeys(name for build in builds for name in build.design)
    values = {name: [build.design.get(name) for build in builds] for name in fields}
    return {
        name: each for name, each in values.items() if any(item != each[0] for item in each[1:])
    }


def answers(build: Build) -> dict[str, str]:
    """The four answers of a build's verdict, in words."""
    found = verdict.findings(build.report)
    return {
        matter: verdict.WORDS[verdict.worst([item for item in found if item.matter == matter])]
        for matter in get_args(verdict.Matter)
    }


def comparison(builds: Sequence[Build]) -> dict[str, Any]:
    """Everything in the comparison but its pictures, as plain values."""
    return {
        "builds": [
            {
                "name": build.label,
                "folder": str(build.folder),
                "verdict": answers(build),
                "accuracy": build.report["accuracy"],
                "figures": {figure.key: figure.of(build.report) for figure in FIGURES},
            }
            for build in builds
        ],
        "differences": differences(builds),
    }


def best(values: Sequence[Any], better: str) -> list[bool]:
    """Which of some values are the best; none if all are alike or one is missing."""
    numbers = [value for value in values if not page.missing(value)]
    if not better or len(numbers) < len(values) or len(set(numbers)) == 1:
        return [False] * len(values)
    top = max(numbers) if better == "more" else min(numbers)
    return [value == top for value in values]


def figures_table(builds: Sequence[Build]) -> str:
    """HTML table of the answers and the key figures, the best of each in bold."""
    each = [answers(build) for build in builds]
    rows = [[f"{matter}?", *(own[matter] for own in each)] for matter in get_args(verdict.Matter)]
    # Without molds and fixtures, as in a draft, print rules are checked on the shell alone.
    parts = {build.report["accuracy"].get("tools", True) for build in builds}
    for figure in FIGURES:
        values = [figure.of(build.report) for build in builds]
        alike = figure.key != "print_violations" or len(parts) == 1
        marked = zip(values, best(values, figure.better if alike else ""), strict=True)
        rows.append(
            [
                figure.label,
                *(
                    page.Html(f"<strong>{page.number(value)}</strong>") if mark else value
                    for value, mark in marked
                ),
            ]
        )
    table = page.table(("figure", *(build.label for build in builds)), rows)
    return table + '<p class="foot">Bold: the best, where more or less is better.</p>'


def same_scales(viewers: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Data of several viewers with their common colourings on common scales."""
    tables = [keyed(viewer) for viewer in viewers]
    shared = [key for key in tables[0] if all(key in table for table in tables)]
    scales = {}
    for key in shared:
        low = min(float(table[key]["low"]) for table in tables)
        high = max(float(table[key]["high"]) for table in tables)
        scales[key] = {"low": low, "high": high, "log": low > 0.0 and high > LOG_RANGE * low}
    return [
        {**viewer, "colourings": [{**table[key], **scales[key]} for key in shared]}
        for viewer, table in zip(viewers, tables, strict=True)
    ]


def differences_section(builds: Sequence[Build]) -> str:
    """HTML of the design fields that differ."""
    found = differences(builds)
    if not found:
        return "<p>The design files are the same.</p>"
    rows = [[name, *(_short(value) for value in values)] for name, values in sorted(found.items())]
    return page.table(("field", *(build.label for build in builds)), rows)


def _short(value: Any) -> Any:
    if isinstance(value, list):
        text = json.dumps(value, ensure_ascii=False)
        return text if len(text) <= 80 else f"{text[:80]} …"
    return value


def shells_section(builds: Sequence[Build]) -> str:
    """HTML in which the scripts draw shells and maps side by side, with fallback pictures."""

    def still(build: Build, name: str, text: str) -> str:
        data = build.images.get(name)
        return "" if data is None else page.image(data, text, extra=' class="still"')

    parts = [
        f'<div><h3>{escape(build.label)}</h3><div class="explorer" data-from="data-{number}">'
        f'<div class="shell">{still(build, "shell.png", f"Shell of {build.label}")}</div>'
        f'<div class="map">{still(build, "layout.png", f"Layout of {build.label}")}</div>'
        "</div></div>"
        for number, build in enumerate(builds)
    ]
    return "<p>On common colour scales; they rotate together.</p>" + page.side_by_side(*parts)


def pictures_section(builds: Sequence[Build]) -> str:
    """HTML of the camera's pictures side by side."""
    out = []
    for name, caption in PICTURES:
        shown = [
            page.figure(build.images[name], f"{caption}: {build.label}", "jpeg")
            for build in builds
            if name in build.images
        ]
        out.append(page.side_by_side(*shown))
    return "".join(out)


def compare_page(builds: Sequence[Build]) -> str:
    """Whole HTML page, self-contained."""
    names = " and ".join(build.label for build in builds)
    data = same_scales([build.viewer for build in builds])
    tags = "".join(data_tag(f"data-{number}", item) for number, item in enumerate(data))
    accuracy = {json.dumps(build.report["accuracy"], sort_keys=True) for build in builds}
    note = (
        ""
        if len(accuracy) == 1
        else '<p class="note">These builds ran at different accuracies: what they found under load '
        "and in the decoder's tests differs for that reason too.</p>"
    )
    return page.page(
        f"Comparison of {names}",
        [
            ("Key figures", figures_table(builds)),
            ("What differs in the designs", differences_section(builds)),
            ("Shells and maps", shells_section(builds)),
            ("Pictures", pictures_section(builds)),
        ],
        f'{note}<p class="note">{escape(verdict.SIMULATED)}</p>',
        style=style(),
        tail=tags + script_tags(),
    )
