"""Build the documentation site: python -m tools.build_site [--out FOLDER].

Gathers the pages of ``docs/zensical.toml`` under their paths of the repository, so that relative
links work as they do on the code host, makes those pages that come from the code or from results,
and builds strictly: a broken link or anchor is an error.
"""

import argparse
import html
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from latex2mathml import converter
from typer.cli import get_docs_for_click
from typer.main import get_command

from benchmarks import tables
from phytac_design.cli.app import app
from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.spec import Design

ROOT = Path(__file__).parents[1]
CONFIG = ROOT / "docs" / "zensical.toml"
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
"""A control sequence of terminals."""
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[([](.*?)\\[)\]]</\1>', re.DOTALL)
LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")
"""A link of Markdown: what is before its target, the path, and the rest with the anchor."""


def navigation(items: Any) -> Iterator[str]:
    """Paths of all pages in the navigation."""
    if isinstance(items, str):
        yield items
    else:
        for item in items.values() if isinstance(items, dict) else items:
            yield from navigation(item)


def commands_page() -> str:
    """Every command with its arguments and options, in the groups of ``phytac --help``."""
    program: Any = get_command(app)
    context = program.make_context("phytac", [], resilient_parsing=True)
    groups: dict[str, list[str]] = {}
    for name, command in program.commands.items():
        text = get_docs_for_click(
            obj=command, ctx=context, indent=2, name=name, call_prefix="phytac"
        )
        groups.setdefault(command.rich_help_panel, []).append(text)
    parts = [f"# Commands\n\n{program.help}\n"]
    for group, texts in groups.items():
        parts += [f"\n## {group}\n\n", *texts]
    return "".join(parts)


def values(field: dict[str, Any]) -> str:
    """Values that a field of a JSON schema may have, in words."""
    if "$ref" in field:
        return "table"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    if "const" in field:
        return f"`{field['const']}`"
    if "anyOf" in field:
        return " or ".join(map(values, field["anyOf"]))
    if field["type"] == "array":
        count = field.get("minItems") if field.get("minItems") == field.get("maxItems") else None
        item = values((field.get("prefixItems") or [field.get("items", {})])[0])
        return f"list of {f'{count} × ' if count else ''}{item}"
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    limits = [f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field]
    name = "text" if field["type"] == "string" else field["type"]
    return " ".join([name, " and ".join(limits)]).strip()


def fields_table(section: dict[str, Any]) -> str:
    """The fields of a table of the design file."""
    rows = ["| field | meaning | values | default |", "|---|---|---|---|"]
    for name, field in section["properties"].items():
        default = json.dumps(field["default"], ensure_ascii=False) if "default" in field else ""
        if name in section.get("required", []):
            default = "required"
        elif default:
            default = f"`{default}`"
        assumed = " (assumed)" if field.get("assumption") else ""
        cells = (f"`{name}`", one_line(field) + assumed, values(field), default)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"


def one_line(item: dict[str, Any]) -> str:
    """Description of a field or table."""
    return " ".join(item.get("description", "").split())


def design_page() -> str:
    """Every field of a design file, from its JSON schema."""
    schema = Design.model_json_schema()
    tables_of, plain = schema["$defs"], {}
    parts = []

    def add(title: str, level: int, section: dict[str, Any]) -> None:
        parts.append(f"\n{'#' * level} {title}\n\n{one_line(section)}\n\n")
        parts.append(fields_table(section))
        for name, field in section["properties"].items():
            if name != "shape" and "$ref" in (item := field.get("items", {})):
                inner = f"`[[{title.strip('`[]')}.{name}]]`"
                add(inner, level + 1, tables_of[item["$ref"].split("/")[-1]])

    for name, field in schema["properties"].items():
        kinds = field.get("discriminator") or field.get("items", {}).get("discriminator")
        brackets = f"[[{name}]]" if field.get("type") == "array" else f"[{name}]"
        if kinds:
            parts.append(f"\n## `{brackets}`\n\n{one_line(field)}\n")
            for kind, target in kinds["mapping"].items():
                add(f"`{brackets}` of kind `{kind}`", 3, tables_of[target.split("/")[-1]])
        elif "$ref" in field or field.get("type") == "array":
            target = (field.get("items") or field)["$ref"]
            add(f"`{brackets}`", 2, tables_of[target.split("/")[-1]])
        else:
            plain[name] = field
    head = (
        "# Design file\n\nMade from the program's own JSON schema (`phytac schema`). "
        "Lengths are in mm, forces in N, moduli in MPa, angles in degrees. "
        "*Assumed* marks what the paper does not state: set it to your own parts. "
        "`phytac new NAME` writes a file with all of these fields and their comments.\n\n"
        "## Name and description\n\n"
    )
    top = {"properties": plain, "required": schema["required"]}
    return head + fields_table(top) + "".join(parts)


def gallery_page() -> str:
    """Shipped designs with their pictures."""
    head = (
        "# Gallery\n\nThe designs that come with the program. In each picture: camera view, layout "
        "of the markers, their density, and the smallest standard deviation of a force of 10 N.\n"
    )
    alt = "camera view, layout, density, force resolution"
    return head + "".join(
        f"\n## {name}\n\n{load_design(name).description} `phytac build {name}` builds it.\n\n"
        f"![{name}: {alt}](images/gallery_{name}.jpg)\n"
        for name in shipped_designs()
    )


def tutorial_page() -> str:
    """The notebook as a page."""
    cells = json.loads((ROOT / "docs" / "tutorial.ipynb").read_text("utf-8"))["cells"]
    texts = ("".join(cell["source"]) for cell in cells)
    return "\n\n".join(
        text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```"
        for cell, text in zip(cells, texts, strict=True)
    )


def python_pages() -> dict[str, str]:
    """Pages of the public modules, one for each row of their table, by path."""
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    (section,) = re.findall(r"^## Public modules$(.+?)^## ", text, re.MULTILINE | re.DOTALL)
    pages = {}
    for title, row in re.findall(r"^\| (.+) \| (`.+) \|$", section, re.MULTILINE):
        modules = "".join(f"\n::: {name}\n" for name in re.findall(r"`([\w.]+)`", row))
        name = re.sub(r"\W+", "-", title)
        pages[f"docs/reference/{name}.md"] = f"# {title.capitalize()}\n{modules}"
    return pages


def generated() -> dict[str, str]:
    """Text of the pages that are made here, by path."""
    return {
        "docs/reference/commands.md": commands_page(),
        "docs/reference/design-file.md": design_page(),
        "docs/gallery.md": gallery_page(),
        "docs/tutorial.md": tutorial_page(),
        "benchmarks/results/README.md": tables.page(tables.read()),
        **python_pages(),
    }


def gather(folder: Path) -> None:
    """Write all pages of the navigation, and the files that they link to, into a folder."""
    made = generated()
    project = tomllib.loads(CONFIG.read_text("utf-8"))["project"]
    wanted = [*navigation(project["nav"]), *project["extra_css"], *project["extra_javascript"]]
    wanted += made
    done = set()
    while wanted:
        name = wanted.pop()
        if name in done:
            continue
        done.add(name)
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if not name.endswith(".md"):
            shutil.copyfile(ROOT / name, target)
            continue
        text = made[name] if name in made else (ROOT / name).read_text("utf-8")
        parent = Path(name).parent

        def follow(link: re.Match[str], parent: Path = parent) -> str:
            before, path, rest = link.groups()
            if "://" in path:
                return link.group()
            full = os.path.normpath(parent / path)
            if f"{full}/README.md" in made:
                path, full = f"{path}/README.md", f"{full}/README.md"
            elif full.endswith(".ipynb"):
                path, full = path.replace(".ipynb", ".md"), full.replace(".ipynb", ".md")
            if full in made or (ROOT / full).is_file():
                wanted.append(full)
            return f"{before}{path}{rest}"

        target.write_text(LINK.sub(follow, text), "utf-8")


def typeset(formula: re.Match[str]) -> str:
    """MathML of a formula of TeX, which browsers show without any script or font."""
    tex, inline = html.unescape(formula[2]).strip(), formula[1] == "span"
    if inline:
        return str(converter.convert(tex))
    return f'<div class="formula">{converter.convert(tex, display="block")}</div>'


def build_site(out: Path) -> None:
    """Build the site into a folder; an earlier site there is replaced."""
    if out.exists() and any(out.iterdir()) and not (out / "search.json").is_file():
        sys.exit(f"error: {out} holds other files than a site; choose another --out")
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        gather(work / "pages")
        paths = [str(ROOT), str(ROOT / "shapes"), str(ROOT / "decoder")]
        sources = f"\n[project.plugins.mkdocstrings.handlers.python]\npaths = {json.dumps(paths)}\n"
        (work / "zensical.toml").write_text(CONFIG.read_text("utf-8") + sources, "utf-8")
        words = [sys.executable, "-m", "zensical", "build", "--strict"]
        done = subprocess.run(words, cwd=work, capture_output=True, text=True, check=False)
        said = COLOUR.sub("", done.stdout + done.stderr)
        # Docstrings that cannot be read are reported, and do not count as issues.
        if done.returncode or "griffe: " in said:
            sys.exit(f"{said}\nerror: the site has broken links, pages or docstrings")
        for page in (work / "site").rglob("*.html"):
            page.write_text(FORMULA.sub(typeset, page.read_text("utf-8")), "utf-8")
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(work / "site", out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "site", help="folder of the site")
    build_site(parser.parse_args().out)
