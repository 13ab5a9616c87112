"""The studio's controls, made from the typed design model: no field is named twice."""

from collections.abc import Iterator
from typing import Any

from phytac_design.design.design_file import load_design, shipped_designs
from phytac_design.design.print_rules_table import PROCESSES
from phytac_design.design.spec import CAMERA_PRESETS, SHAPE_MODELS, Design

Json = dict[str, Any]
FIRST = ("shape", "layout", "receptor", "camera", "light", "wall")
"""Tables that show in the picture, first; the others follow in the model's order."""
UNITS = {
    "mm": "mm",
    "deg": "°",
    "px": "px",
    "N": "N",
    "MPa": "MPa",
    "Hz": "Hz",
    "um": "µm",
}
"""What a field's last word says of its unit."""
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
"""Fields that say something only where another one has one of some values."""
SETS = {
    "camera.preset": sorted(set().union(*CAMERA_PRESETS.values())),
    "print_rules.process": sorted(set().union(*PROCESSES.values())),
}
"""Fields that a choice sets: other values of them go when it is made."""


def form() -> Json:
    """Tables and their fields, as the page draws them.

    Returns
    -------
    dict
        ``tables``: in order, each with ``name``, ``doc`` and ``fields``; ``shapes``: the fields of
        each surface family; ``examples``: a shape table of each family, from a shipped design;
        ``when`` and ``sets``: see ``WHEN`` and ``SETS``.
    """
    schema = Design.model_json_schema()
    parts, top = schema["$defs"], schema["properties"]
    names = [name for name in top if name not in {*FIRST, "name", "description"}]
    return {
        "head": [_field(name, "", top[name], parts) for name in ("name", "description")],
        "tables": [_table(name, top[name], parts) for name in [*FIRST, *names]],
        "shapes": {
            kind: list(_fields("shape", model.model_json_schema()))
            for kind, model in SHAPE_MODELS.items()
        },
        "examples": _examples(),
        "when": {name: {"field": field, "is": list(of)} for name, (field, of) in WHEN.items()},
        "sets": SETS,
    }


def field_paths() -> list[str]:
    """Every field of every table, as ``table.field``; of the shape those of all families."""
    made = form()
    found = [field["path"] for table in made["tables"] for field in table["fields"]]
    found += [field["path"] for fields in made["shapes"].values() for field in fields]
    return list(dict.fromkeys([*found, "name", "description"]))


def _examples() -> Json:
    out: Json = {}
    for name in shipped_designs():
        design = load_design(name)
        out.setdefault(design.shape.kind, design.shape.model_dump(mode="json"))
    return out


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
        if (table, key) != ("shape", "kind"):
            yield _field(f"{table}.{key}", table, item, model.get("$defs", {}))


def _resolved(item: Json, parts: Json) -> Json:
    if "$ref" in item:
        found: Json = parts[item["$ref"].rsplit("/", 1)[-1]]
        return {**found, **{key: value for key, value in item.items() if key != "$ref"}}
    return item


def _field(path: str, table: str, item: Json, parts: Json) -> Json:
    """One control: its kind, range, words that stand for a number, and its explanation."""
    key = path.removeprefix(f"{table}.") if table else path
    words, options = [], [item, *(_resolved(one, parts) for one in item.get("anyOf", ()))]
    for one in options:
        words += [one["const"]] if isinstance(one.get("const"), str) else []
        words += one.get("enum", [])
    number = next((one for one in options if one.get("type") in {"number", "integer"}), None)
    plain = any(one.get("type") == "string" and "enum" not in one for one in options)
    kind = "json"
    if any(one.get("type") == "array" for one in options):
        pass
    elif number is not None:
        kind = "whole" if number["type"] == "integer" else "number"
    elif words and not item.get("anyOf"):
        kind = "choice"
    elif plain:
        kind = "text"
    label, unit = _label(key)
    return {
        "path": path,
        "label": label,
        "unit": unit,
        "doc": " ".join(item.get("description", "").split()),
        "kind": kind,
        "words": words,
        "assumed": bool(item.get("assumption")),
        "default": item.get("default"),
        **_limits(number or {}),
    }


def _limits(number: Json) -> Json:
    """Least and greatest value; ``open`` ends are not reached themselves."""
    return {
        "low": number.get("minimum", number.get("exclusiveMinimum")),
        "high": number.get("maximum", number.get("exclusiveMaximum")),
        "low_open": "exclusiveMinimum" in number,
        "high_open": "exclusiveMaximum" in number,
    }


def _label(key: str) -> tuple[str, str]:
    """Words of a field's name, and its unit."""
    words = key.split("_")
    unit = UNITS.get(words[-1], "") if len(words) > 1 else ""
    return " ".join(words[:-1] if unit else words), unit
