"""The studio's controls, made from the typed design model, and the controls that an error names."""

import re
from collections.abc import Iterator
from typing import Any

from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.print_rules_table import PROCESSES
from phytac_design.design.spec import CAMERA_PRESETS, SHAPE_MODELS, Design
from phytac_design.report.figure_names import words_of

Json = dict[str, Any]
WHEN: dict[str, tuple[str, tuple[str, ...]]] = {
    "layout.rows": ("layout.kind", ("spiral", "straight")),
    "layout.columns": ("layout.kind", ("spiral", "straight")),
    "layout.row_pitch_exponent": ("layout.kind", ("spiral", "straight")),
    "layout.colour_pattern": ("layout.kind", ("spiral", "straight")),
    "layout.spiral_angle_deg": ("layout.kind", ("spiral",)),
    "layout.spiral_from": ("layout.kind", ("spiral",)),
    "layout.count": ("layout.kind", ("phyllotaxis",)),
    "layout.positions": ("layout.kind", ("explicit",)),
    "layout.positions_csv": ("layout.kind", ("explicit",)),
    "layout.position_colours": ("layout.kind", ("explicit",)),
    "layout.position_heights_mm": ("layout.kind", ("explicit",)),
    "layout.height_far_mm": ("layout.heights", ("linear", "power", "line-of-sight")),
    "layout.height_exponent": ("layout.heights", ("power",)),
    "layout.sight_margin_mm": ("layout.heights", ("line-of-sight",)),
    "layout.sight_dent_mm": ("layout.heights", ("line-of-sight",)),
    "layout.sight_dent_radius_mm": ("layout.heights", ("line-of-sight",)),
    "receptor.tilt_deg": ("receptor.direction", ("tilted",)),
    "camera.fill": ("camera.stand_off_mm", ("fit",)),
}
"""Fields that apply only if another one has one of some values."""


OF_SHAPE = ("shape", "layout", "receptor", "switch", "light")
"""Tables that another surface family brings with it: a layout for one seldom fits another."""


def form() -> Json:
    """Tables and their fields, as the page shows them.

    Returns
    -------
    dict
        ``tables``: in order, each with ``name``, ``doc`` and ``fields``; ``shapes``: the fields of
        each surface family; ``examples``: the tables ``OF_SHAPE`` of each family, from a shipped
        design; ``when`` and ``sets``: see ``WHEN``, and the fields whose values a preset replaces.
    """
    schema = Design.model_json_schema()
    parts, top = schema["$defs"], schema["properties"]
    # Tables that change the image come first; the others follow in the model's order.
    first = ("shape", "layout", "receptor", "camera", "light", "wall")
    names = [name for name in top if name not in {*first, "name", "description"}]
    examples: Json = {}
    for design in map(load_design, shipped_designs()):
        tables = design.model_dump(mode="json", include=set(OF_SHAPE))
        examples.setdefault(design.shape.kind, tables)
    return {
        "head": [_field(name, "", top[name], parts) for name in ("name", "description")],
        "tables": [_table(name, top[name], parts) for name in [*first, *names]],
        "shapes": {
            kind: list(_fields("shape", model.model_json_schema()))
            for kind, model in SHAPE_MODELS.items()
        },
        "examples": examples,
        "when": {name: {"field": field, "is": list(of)} for name, (field, of) in WHEN.items()},
        "sets": {
            "camera.preset": sorted(set().union(*CAMERA_PRESETS.values())),
            "print_rules.process": sorted(set().union(*PROCESSES.values())),
        },
    }


def field_paths() -> list[str]:
    """Every field of every table, as ``table.field``; of the shape those of all families."""
    made = form()
    found = [field["path"] for table in made["tables"] for field in table["fields"]]
    found += [field["path"] for fields in made["shapes"].values() for field in fields]
    return list(dict.fromkeys([*found, "name", "description"]))


def _table(name: str, item: Json, parts: Json) -> Json:
    model = _resolved(item, parts)
    if name == "shape":
        kind = {"const": None, "enum": list(SHAPE_MODELS), "description": "Surface family."}
        return {"name": name, "doc": item.get("description", ""), "fields": [
            _field("shape.kind", "shape", kind, parts)
        ]}  # fmt: skip
    if model.get("type") == "object":
        fields = list(_fields(name, {**model, "$defs": parts}))
        return {"name": name, "doc": model.get("description", ""), "fields": fields}
    return {"name": name, "doc": "", "fields": [_field(name, "", item, parts)]}


def _fields(table: str, model: Json) -> Iterator[Json]:
    for key, item in model["properties"].items():
        if (table, key) != ("shape", "kind") and not item.get("input_only"):
            yield _field(f"{table}.{key}", table, item, model.get("$defs", {}))


def _resolved(item: Json, parts: Json) -> Json:
    if "$ref" in item:
        found: Json = parts[item["$ref"].rsplit("/", 1)[-1]]
        return {**found, **{key: value for key, value in item.items() if key != "$ref"}}
    return item


def _field(path: str, table: str, item: Json, parts: Json) -> Json:
    """One control: kind, range (``open`` ends are excluded), allowed words, and explanation."""
    key = path.removeprefix(f"{table}.") if table else path
    words, options = [], [item, *(_resolved(one, parts) for one in item.get("anyOf", ()))]
    for one in options:
        words += [one["const"]] if isinstance(one.get("const"), str) else []
        words += one.get("enum", [])
    number = next((one for one in options if one.get("type") in {"number", "integer"}), None)
    plain = any(one.get("type") == "string" and "enum" not in one for one in options)
    if any(one.get("type") == "array" for one in options):
        kind = "json"
    elif number is not None:
        kind = "whole" if number["type"] == "integer" else "number"
    elif words and not item.get("anyOf"):
        kind = "choice"
    else:
        kind = "text" if plain else "json"
    label, unit = words_of(key)
    limits = number or {}
    return {
        "path": path,
        "label": label,
        "unit": unit,
        "doc": " ".join(item.get("description", "").split()),
        "kind": kind,
        "words": words,
        "assumed": bool(item.get("assumption")),
        "default": item.get("default"),
        "low": limits.get("minimum", limits.get("exclusiveMinimum")),
        "high": limits.get("maximum", limits.get("exclusiveMaximum")),
        "low_open": "exclusiveMinimum" in limits,
        "high_open": "exclusiveMaximum" in limits,
    }


def error_body(text: str, paths: list[str]) -> dict[str, Any]:
    """An error as JSON: its text, and for each control that it names the sentence that does.

    Fields are named in full (``layout.rows``) or by their last word where only one table has it.
    """
    known = set(paths)
    last = [path.rsplit(".", 1)[-1] for path in paths]
    short = {
        word: path
        for word, path in zip(last, paths, strict=True)
        if "_" in word and last.count(word) == 1
    }
    fields: dict[str, str] = {}
    for sentence in _sentences(text, known):
        for word in re.findall(r"[A-Za-z][A-Za-z0-9_]*(?:\.[A-Za-z][A-Za-z0-9_]*)*", sentence):
            parts = word.split(".")
            found = next(
                (".".join(parts[:n]) for n in (2, 1) if ".".join(parts[:n]) in known),
                short.get(word, ""),
            )
            if found and (found not in {"name", "description"} or sentence.startswith(found)):
                fields.setdefault(found, sentence)
    return {"error": text, "fields": fields}


def _sentences(text: str, known: set[str]) -> list[str]:
    """Problems in a text that lists several, each beginning with its field."""
    text = text.removeprefix("the design: ")
    out: list[str] = []
    for part in text.split("; "):
        head = part.split(":")[0].split(" ")[0]
        begins = ".".join(head.split(".")[:2]) in known or part.startswith("unknown key")
        if out and not begins:
            out[-1] += f"; {part}"
        else:
            out.append(part)
    return out
