"""Design files: TOML in, typed design out; the resolved and the commented file back."""

import json
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import BaseModel
from pydantic_core import to_jsonable_python
from tomlkit.items import AoT, Table

from phytac_design.design.base_table import descriptions
from phytac_design.design.paints_table import NOMINAL_PAINTS
from phytac_design.design.spec import Design, ShapeSection
from phytac_design.design.toml_files import TomlFileKind
from phytac_design.design.unit_hints import unit_hints
from phytac_shapes.errors import DesignError, OutputError

INSERT_FIELDS = ("gap_insert_mm", "ledge_insert_mm", "thickness_tube_mm")
DESIGN_FILES = TomlFileKind(
    noun="design",
    folder="designs",
    template="`phytac new NAME` writes a design to edit",
    missing="`phytac new NAME` writes a whole design to edit",
    fixes={"camera.stand_off_mm": "must be a distance in mm, at most 1e6, or 'fit'"},
)


def shipped_designs() -> list[str]:
    """Names of the designs that come with the package."""
    return DESIGN_FILES.shipped()


def load_design(name_or_path: str) -> Design:
    """Read a shipped design by name, or any design file by path.

    Raises
    ------
    DesignError
        If there is no such design, it is not TOML, or a key or value is not acceptable.
    """
    data, where = DESIGN_FILES.read(name_or_path)
    return parse_design(data, where, folder=Path(where).parent)


def parse_design(data: dict[str, Any], where: str, *, folder: Path = Path()) -> Design:
    """Validate a parsed design file; the error lists every problem.

    Paths of files that the design names (positions, camera calibration) are relative to
    ``folder``; their contents become part of the design.
    """
    tables = data.keys() if isinstance(data, dict) else set()
    if "shape" not in tables and tables & {"variable", "objective"}:
        raise DesignError(
            "field-invalid",
            f"{where} is a study, not a design: run it with `phytac optimise` or `phytac sweep`",
        )
    try:
        return DESIGN_FILES.validate(Design, data, where, folder=folder)
    except DesignError as error:
        raise with_unit_hints(error, data) from None


def with_unit_hints(error: DesignError, data: Any) -> DesignError:
    """The error, with a sentence for each length that looks like another unit than mm."""
    hints = unit_hints(data)
    return DesignError(error.code, "; ".join([str(error), *hints])) if hints else error


def design_hash(design: Design) -> str:
    """Hash of the resolved design, the same for the same fields in any order.

    Names of regions and the effort are left out: with others it is still the same sensor. So are
    reference marks, inserts and strips where there are none, paints that were not measured, and
    the family of bowls: designs from before they existed keep their hash.
    """
    unused: dict[str, Any] = {"regions": True, "effort": True}
    if not design.reference_marks.count:
        unused["reference_marks"] = True
    if design.strip.form == "single":
        unused["strip"] = True
    if design.paints == NOMINAL_PAINTS:
        unused["paints"] = True
    if design.switch.family == "bowl":
        unused["switch"] = {"family"}
    if not design.receptor.has_inserts:
        unused["receptor"] = {"colouring", *INSERT_FIELDS}
    text = json.dumps(design.model_dump(mode="json", exclude=unused), sort_keys=True)
    return sha256(text.encode()).hexdigest()


def assumptions(design: Design) -> dict[str, Any]:
    """Fields that the paper does not state, with the values used: ``{"camera.focal_px": 970}``."""
    out: dict[str, Any] = {}
    for name in Design.model_fields:
        section = getattr(design, name)
        if not isinstance(section, BaseModel):
            continue
        for key, info in type(section).model_fields.items():
            extra = info.json_schema_extra
            if isinstance(extra, dict) and extra.get("assumption"):
                out[f"{name}.{key}"] = getattr(section, key)
    return out


def to_toml(design: Design) -> str:
    """Resolved design: every field, with meaning and range as comments; rebuilds the same."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Lengths in mm, forces in N, moduli in MPa, angles in degrees."))
    document.add(tomlkit.comment("(assumed): not stated by the paper; set it to your own parts."))
    values = design.model_dump(mode="json")
    for name in Design.model_fields:
        section = getattr(design, name)
        if isinstance(section, BaseModel):
            document.add(tomlkit.nl())
            document.add(name, _table(section, values[name]))
            continue
        listed = name in {"fixtures", "regions"}
        if listed:
            document.add(tomlkit.nl())
        if name in descriptions(Design):
            document.add(tomlkit.comment(descriptions(Design)[name]))
        if not listed:
            document.add(name, values[name])
        elif section:
            document.add(name, _tables(section, values[name]))
    return tomlkit.dumps(document)


def _table(section: BaseModel, values: dict[str, Any]) -> Table:
    table = tomlkit.table()
    if type(section).__doc__:
        table.comment(" ".join((type(section).__doc__ or "").split()))
    for key, info in type(section).model_fields.items():
        if info.exclude:
            continue
        extra = info.json_schema_extra
        assumed = isinstance(extra, dict) and bool(extra.get("assumption"))
        limits = [
            f"{sign} {getattr(rule, name):g}"
            for rule in info.metadata
            for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
            if isinstance(getattr(rule, name, None), int | float)
        ]
        text = descriptions(type(section)).get(key, key)
        text += f" [{', '.join(limits)}]" if limits else ""
        table.add(tomlkit.comment(text + (" (assumed)" if assumed else "")))
        table.add(key, values[key])
    return table


def _tables(sections: Sequence[BaseModel], values: list[dict[str, Any]]) -> AoT:
    tables = tomlkit.aot()
    for section, value in zip(sections, values, strict=True):
        tables.append(_table(section, value))
    return tables


def to_short_toml(design: Design, **tables: dict[str, Any]) -> str:
    """Only what differs from the defaults; rebuilds the same.

    Parameters
    ----------
    **tables : dict
        Tables to write as they are, such as a camera with its field of view.
    """
    document = tomlkit.document()
    document.add(
        tomlkit.comment("What differs from the defaults; `phytac schema` lists all fields.")
    )
    document.add(tomlkit.comment("Lengths in mm, forces in N, moduli in MPa, angles in degrees."))
    for name, values in design.model_dump(mode="json").items():
        section = getattr(design, name)
        if name in tables:
            document.add(name, tables[name])
        elif isinstance(section, BaseModel):
            changed = _changes(section, values)
            if changed:
                document.add(name, changed)
        elif isinstance(section, tuple) and section:
            document.add(name, _tables(section, values))
        elif section:
            document.add(name, values)
    return tomlkit.dumps(document)


def _changes(section: BaseModel, values: dict[str, Any]) -> dict[str, Any]:
    """Fields that a table must hold to be this section again: defaults may follow other fields."""
    fields = type(section).model_fields
    given = {
        key: value
        for key, value in values.items()
        if fields[key].is_required()
        or (key == "kind" and isinstance(section, ShapeSection))
        or value != to_jsonable_python(fields[key].get_default(call_default_factory=True))
    }
    again = type(section).model_validate(given).model_dump(mode="json")
    return given | {key: value for key, value in values.items() if again[key] != value}


def write_new_design(
    name: str, source: str, path: Path, *, changes: dict[str, dict[str, Any]] | None = None
) -> Path:
    """Write a commented copy of a design under a new name, with some fields of tables changed.

    A table with another ``kind`` takes the place of the old one.

    Raises
    ------
    OutputError
        If the file exists already or cannot be written.
    """
    base = load_design(source).model_dump(mode="json")
    for table, change in (changes or {}).items():
        same = change.get("kind", base[table].get("kind")) == base[table].get("kind")
        base[table] = {**base[table], **change} if same else change
    own = {"name": name, "description": f"Made from {source}."}
    design = parse_design({**base, **own}, f"new design {name!r}")
    return write_design_file(to_toml(design), path)


def write_design_file(text: str, path: Path) -> Path:
    """Write a new design file, never over another.

    Raises
    ------
    OutputError
        If the file exists already or cannot be written.
    """
    if path.exists():
        raise OutputError(
            "output-exists", f"{path} exists already; choose another name or remove it"
        )
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError("output-not-writable", f"cannot write {path}: {error.strerror}") from None
    return path
