"""The tables of README and ``docs/evidence.md`` from the committed results; all rows on demand.

``python -m benchmarks.tables`` writes these tables; ``--check`` only reports whether they are up to
date; ``--out FOLDER`` also writes all rows as ``verification.md`` there. Rows of code that has
changed since are marked ``EARLIER``.
"""

import argparse
import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from benchmarks.harness import RESULTS
from benchmarks.provenance import ROOT, is_current

EARLIER = "†"
BEGIN, END = "<!-- figures: made by python -m benchmarks.tables -->", "<!-- end of figures -->"
SURVIVED = "<!-- survivors: made by python -m benchmarks.tables -->"
SURVIVORS = Path(__file__).with_name("survivors.toml")
INTRODUCTION = """# Verification

Made by `python -m benchmarks.tables` from `benchmarks/results/`. Speed is a ratio to a peer in the
same run, accuracy an error against an independent reference; what missed its target stays in.
† The code behind this row has changed since; its command is named above the table.
"""
HEADLINES: tuple[tuple[str, str], ...] = (
    ("visibility", "cylinder60 368, straight: at rest: fused"),
    ("visibility", "cylinder60-dense 744, spiral, line-of-sight heights: at rest: least gap, same"),
    ("mechanics", "cylinder60, 10 N on a 6 mm fingertip patch, refine 4: greatest"),
    ("hands", "cylinder60 unit 1, points: learnt with friction 0 to 0.8, read with friction"),
    ("decoder", "cylinder60 unit 1, frames: auto, all heights"),
    ("paper", "nominal print: fem_nn, calibrated: mean relative"),
    ("paper", "nominal print, frames: fem_nn, calibrated: mean relative"),
    ("study", "dense-cylinder trial"),
)
"""Rows of the README: benchmark and how the case begins; the first that matches is shown."""
SHORT: tuple[tuple[str, str], ...] = (
    ("build", "cylinder60, standard: whole build"),
    ("build", "cylinder60, draft: whole build"),
    ("build", "hemisphere, draft: whole build"),
    ("build", "grip, draft: whole build"),
    ("visibility", "pinhole 2592x1944: pixels with the same ID"),
    ("visibility", "pinhole 2592x1944: ID map, times faster than Embree"),
    ("visibility", "cylinder60 368, spiral, angle from the axis: at rest: fused"),
    ("visibility", "cylinder60 368, straight: at rest: fused"),
    ("visibility", "cylinder60-dense 744, spiral, line-of-sight heights: at rest: least gap, same"),
    ("visibility", "cylinder60-dense 744, spiral, line-of-sight heights: 25 N: crosstalk"),
    ("fabrication", "cylinder60: volume, manifold3d against OCC"),
    ("fabrication", "cylinder60: STL, CadQuery/OCC over manifold3d"),
    ("mechanics", "Scordelis-Lo roof, 32"),
    ("mechanics", "pinched cylinder, 32"),
    ("mechanics", "cylinder60, 10 N on a 6 mm fingertip patch, refine 4: greatest"),
    ("mechanics", "large: 25 N on a fingertip, 49980 DOF"),
    ("mechanics", "large: hinged roof h 12.7, 24 a side, minimum"),
    ("mechanics", "speed: one load, error 1 % of the peak, both on even meshes"),
    ("mechanics", "speed: one load, error 1 % of the peak, both extrapolated from two graded"),
    ("mechanics", "speed: a hundred loads, error 1 %, ours extrapolated"),
    ("mechanics", "mesh error: linear presses"),
    ("mechanics", "mesh error: presses with large displacements"),
    ("decoder", "cylinder60 unit 1, frames: held-out contacts"),
    ("decoder", "cylinder60 unit 1, frames: fem, middle heights"),
    ("decoder", "cylinder60 unit 1, frames: fem_nn, middle heights"),
    ("decoder", "cylinder60 unit 1, frames: koi_inverse, middle heights"),
    ("decoder", "cylinder60 unit 1, frames: auto, middle heights"),
    ("decoder", "cylinder60 unit 1, frames: auto, all heights"),
    ("decoder", "cylinder60 unit 1, frames: auto, share of truths"),
    ("decoder", "cylinder60 unit 1, frames: auto, middle heights: samples from which on"),
    ("decoder", "cnn on 598 samples"),
    ("decoder", "rest coordinates from one frame, RMSE, all"),
    ("paper", "nominal print: fem, calibrated: mean relative"),
    ("paper", "nominal print: fem_nn, calibrated: mean relative"),
    ("paper", "nominal print: fem_nn, calibrated: mean absolute"),
    ("paper", "mean of three scattered prints: fem_nn"),
    ("paper", "nominal print, frames: fem, calibrated: mean relative"),
    ("paper", "nominal print, frames: fem_nn, calibrated: mean relative"),
    ("paper", "nominal print, frames: fem_nn, calibrated: mean absolute"),
    ("paper", "print 1, frames: fem_nn, calibrated: mean relative"),
    ("paper", "print 2, frames: fem_nn, calibrated: mean relative"),
    ("paper", "print 3, frames: fem_nn, calibrated: mean relative"),
    ("paper", "nominal print, frames: auto, learnt: mean relative"),
    ("stability", "cases over all"),
    ("stability", "wrong"),
    ("tradeoff", "scene fingertip on cylinder60, standard: times cheaper than the whole"),
    ("tradeoff", "scene fingertip on cylinder60, standard: force by its decoder against the whole"),
    ("tradeoff", "cylinder60, standard: time saved by a setting"),
    ("study", "cylinder: designs a second and core"),
    ("study", "dense-cylinder trial"),
    ("study", "rows equal to the undisturbed ones"),
    ("page", "studio: cylinder60, from a control's change to all views drawn, p95"),
    ("page", "report of cylinder60-dense, 744 markers: first contentful paint"),
)
"""Rows of ``docs/evidence.md``."""
MISSES, REASONS = ROOT / "docs" / "misses.md", ROOT / "benchmarks" / "misses.toml"
GROUPS: list[dict[str, str]] = tomllib.loads(REASONS.read_text("utf-8"))["group"]
"""Reasons, each with the rows that it holds for."""
OPEN = """# Missed targets

Every target that the committed results miss, by its reason. The value is that of the row that is
farthest off; `python -m benchmarks.tables --out FOLDER` writes all rows. † Made by earlier code.

"""
MUTATION = tuple(
    ("mutation", f"{package}: {case}")
    for package in ("decoder", "optics", "shell", "layout", "imaging")
    for case in ("mutants", "of the same")
)
HARDENING = ROOT / "docs" / "hardening.md"
PAGES = {
    ROOT / "README.md": HEADLINES,
    ROOT / "docs" / "evidence.md": SHORT,
    HARDENING: MUTATION,
}


def cell(value: Any) -> str:
    """A figure or text, safe in a table."""
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|")


def line(row: dict[str, Any], part: dict[str, Any]) -> str:
    """One row as Markdown; ``part`` is what made it."""
    verdict = {True: "holds", False: "**missed**", None: ""}[row.get("holds")]
    mark = "" if is_current(part) else EARLIER
    values = (
        row["case"],
        f"{cell(row['value'])} {row['unit']}".strip() + mark,
        f"{cell(row['reference'])} ({row['source']})",
        row.get("target", ""),
        verdict,
    )
    return "| " + " | ".join(str(value).replace("\n", " ") for value in values) + " |"


HEAD = "| case | value | reference | target | |\n|---|---|---|---|---|\n"


def read() -> dict[str, dict[str, Any]]:
    """Return every committed result by name."""
    found = {path.stem: json.loads(path.read_text()) for path in sorted(RESULTS.glob("*.json"))}
    return {name: data for name, data in found.items() if "rows" in data}


def lines(data: dict[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Return the rows of a result, and each as Markdown."""
    return [(row, line(row, data["parts"][row["part"]])) for row in data["rows"]]


def made(name: str, part: dict[str, Any]) -> str:
    """Return what made the rows of a part, as an item of a list."""
    on = part.get("machine", {})
    words = [f"- `{part['command']}`: commit {part['commit']}, {part['day']}"]
    words += ["with uncommitted changes"] if part.get("changed") else []
    words += [f"{part['seconds']:.0f} s"] if "seconds" in part else []
    words += [f"{on['processor']}, {on['cores']} cores, Python {on['python']}"] if on else []
    words += [] if is_current(part) else [f"the code of {name} has changed since"]
    return ", ".join(words)


def page(results: dict[str, dict[str, Any]]) -> str:
    """Whole verification page."""
    missed = [
        text for data in results.values() for row, text in lines(data) if row.get("holds") is False
    ]
    parts = [INTRODUCTION, f"\n## Missed targets\n\n{HEAD}", "\n".join(missed), "\n"]
    for name, data in results.items():
        parts.append(
            f"\n## {name}\n\n"
            + "\n".join(made(name, part) for part in data["parts"].values())
            + f"\n\n{HEAD}"
            + "\n".join(text for _, text in lines(data))
            + "\n"
        )
        notes = [f"- {row['case']}: {row['note']}" for row in data["rows"] if row.get("note")]
        if notes:
            parts.append("\nNotes:\n\n" + "\n".join(notes) + "\n")
    return "".join(parts)


def table(results: dict[str, dict[str, Any]], chosen: tuple[tuple[str, str], ...]) -> str:
    """Table of some rows, between its marks."""
    rows = []
    for name, start in chosen:
        match = [text for row, text in lines(results[name]) if row["case"].startswith(start)]
        if not match:
            raise LookupError(f"no row of {name} begins with {start!r}; correct the list")
        rows.append(match[0])
    return f"{BEGIN}\n{HEAD}" + "\n".join(rows) + f"\n{END}"


def survivors() -> str:
    """Return the table of mutants that no test notices, between its marks."""
    entries = map(json.loads, (RESULTS / "mutants.jsonl").read_text("utf-8").splitlines())
    lines = {(e["key"].partition(":")[0], e["was"], e["now"]): e["line"] for e in entries}
    rows = ["| place | was | survives as | why |", "|---|---|---|---|"]
    for each in tomllib.loads(SURVIVORS.read_text("utf-8")).get("survivor", []):
        change = [each["file"], each["was"], each["now"]]
        place = f"{each['file']}:{lines.get(tuple(change), '?')}"
        code = " | ".join(f"`{cell(text)}`" for text in (place, *change[1:]))
        rows.append(f"| {code} | {each['reason']} |")
    return f"{SURVIVED}\n" + "\n".join(rows) + f"\n{END}"


def excess(row: dict[str, Any]) -> float:
    """Return how far a row misses its target, relative to the target."""
    target = float(row["target"].split()[1])
    return float(abs(row["value"] - target) / max(abs(target), 1e-9))


def misses(results: dict[str, dict[str, Any]]) -> str:
    """Return the page of missed targets; each row needs a group, and each group a row."""
    own: list[list[tuple[dict[str, Any], dict[str, Any]]]] = [[] for _ in GROUPS]
    for name, data in results.items():
        for row in data["rows"]:
            if row.get("holds") is not False:
                continue
            of = [
                rows
                for group, rows in zip(GROUPS, own, strict=True)
                if group["benchmark"] == name and re.search(group["rows"], row["case"])
            ]
            if not of:
                raise LookupError(f"no group in {REASONS.name} for {name}: {row['case']}; add it")
            of[0].append((row, data["parts"][row["part"]]))
    parts = [OPEN, "| what | rows | farthest off | target | why | what would fix it |\n"]
    parts.append("|---|---|---|---|---|---|\n")
    for group, rows in zip(GROUPS, own, strict=True):
        name, pattern = group["benchmark"], group["rows"]
        if not rows:
            raise LookupError(f"no row of {name} misses {pattern!r}: delete it in {REASONS.name}")
        row, part = max(rows, key=lambda pair: excess(pair[0]))
        value = f"{cell(row['value'])} {row['unit']}".strip()
        value += "" if is_current(part) else EARLIER
        words = [group["what"], str(len(rows)), f"{value} ({cell(row['case'])})", row["target"]]
        parts.append("| " + " | ".join([*words, group["reason"], group["fix"]]) + " |\n")
    return "".join(parts)


def main() -> None:
    """Write or check."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--out", type=Path, help="folder for verification.md")
    given = parser.parse_args()
    results = read()
    pattern = re.compile(re.escape(BEGIN) + ".*?" + re.escape(END), re.DOTALL)
    stale = []
    # A backslash in a replacement would be an escape.
    texts = {
        path: pattern.sub(table(results, chosen).replace("\\", r"\\"), path.read_text())
        for path, chosen in PAGES.items()
    } | {MISSES: misses(results)}
    pattern = re.compile(re.escape(SURVIVED) + ".*?" + re.escape(END), re.DOTALL)
    texts[HARDENING] = pattern.sub(lambda _: survivors(), texts[HARDENING])
    for path, new in texts.items():
        if not path.is_file() or new != path.read_text():
            stale.append(path)
        if not given.check:
            path.write_text(new)
    if given.check:
        if stale:
            sys.exit(f"out of date: {', '.join(map(str, stale))}; run python -m benchmarks.tables")
        return
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "verification.md").write_text(page(results), encoding="utf-8")


if __name__ == "__main__":
    main()
