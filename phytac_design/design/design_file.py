"""Design files: TOML in, typed design out; the resolved and the commented file back."""

import json
from collections.abc import Sequence
from difflib import get_close_matches
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import BaseModel, ValidationError
from tomlkit.items import AoT, Table

from phytac_design.design.fixture_table import BoxFixture, CylinderFixture, MeshFixture
from phytac_design.design.regions_table import RegionSection
from phytac_design.design.spec import SHAPE_MODELS, Design
from phytac_shapes.bounded_reader import joined, read_text, toml_table
from phytac_shapes.errors import DesignError, OutputError

SHOWN = 120
"""Characters of a refused value that its message shows."""
FIXTURE_MODELS: dict[str, type[BaseModel]] = {
    "cylinder": CylinderFixture,
    "box": BoxFixture,
    "mesh": MeshFixture,
}


def shipped_designs() -> list[str]:
    """Names of the designs that come with the package."""
    folder = resources.files("phytac_design") / "data" / "designs"
    return sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.is_file())


def load_design(name_or_path: str) -> Design:
    """Read a shipped design by name, or any design file by path.

    Raises
    ------
    DesignError
        If there is no such design, it is not TOML, or a key or value is not acceptable.
    """
    text, where = _read(name_or_path)
    try:
        data = toml_table(text)
    except ValueError as error:
        raise DesignError(
            f"{where} is not TOML: {error}; see `phytac new` for a template"
        ) from None
    return parse_design(data, where, folder=Path(where).parent)


def parse_design(data: dict[str, Any], where: str, *, folder: Path = Path()) -> Design:
    """Validate a parsed design file; every problem is in the one error.

    Files that the design names (positions, camera calibration) are relative to ``folder``; they
    are read here and become part of the design.
    """
    try:
        return Design.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        problems = error.errors()
        above = {item["loc"][:n] for item in problems for n in range(len(item["loc"]))}
        lines = [
            _explain(item, data)
            for item in problems
            # An item that is refused makes its list too short as well: once is enough.
            if item["loc"] not in above
        ]
        raise DesignError(f"{where}: {joined(lines)}") from None


def _read(name_or_path: str) -> tuple[str, str]:
    path = Path(name_or_path)
    if name_or_path in shipped_designs() and not path.is_file():
        source = resources.files("phytac_design") / "data" / "designs" / f"{name_or_path}.toml"
        return source.read_text(encoding="utf-8"), name_or_path
    try:
        return read_text(path), str(path)
    except UnicodeDecodeError:
        raise DesignError(
            f"{path} is not TOML: it is not even text; `phytac new NAME` writes a design to edit"
        ) from None
    except OSError as error:
        near = get_close_matches(name_or_path, shipped_designs(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise DesignError(
            f"no design {name_or_path!r} ({error.strerror}){hint} "
            f"(shipped: {', '.join(shipped_designs())}; or give the path of a design file)"
        ) from None


def _explain(item: Any, data: dict[str, Any]) -> str:
    """One problem as a sentence: where, what, got, and what would do."""
    # Models of one kind put its name into the place of a problem.
    kinds = FIXTURE_MODELS if item["loc"][:1] == ("fixtures",) else SHAPE_MODELS
    parts = [part for part in item["loc"] if part not in kinds]
    if parts[:2] == ["camera", "stand_off_mm"]:
        return (
            "camera.stand_off_mm: must be a distance in mm, at most 1e6, or 'fit' "
            f"(got {_short(item['input'])})"
        )
    where = ".".join(str(part) for part in parts)
    kind = item["type"]
    if kind == "extra_forbidden":
        known = _known_keys(parts[:-1], data)
        near = get_close_matches(str(parts[-1]), known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f" (known: {', '.join(known)})"
        return f"unknown key {_short(where)}{hint}"
    if kind == "missing":
        if kinds is FIXTURE_MODELS:
            return f"{where} is missing; a fixture of its kind needs it"
        return f"{where} is missing; `phytac new NAME` writes a whole design to edit"
    if kind.startswith("union_tag"):
        got = item["input"].get("kind") if isinstance(item["input"], dict) else item["input"]
        return f"{where}.kind must be one of {', '.join(kinds)} (got {got!r})"
    message = item["msg"][0].lower() + item["msg"][1:]
    got = item["input"]
    shown = "" if isinstance(got, dict) else f" (got {_short(got)})"
    return f"{where or 'design'}: {message.removeprefix('value error, ')}{shown}"


def _short(value: Any) -> str:
    """Literal of a value as the file may hold it, cut where nobody would read on."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"


def _known_keys(parts: list[Any], data: dict[str, Any]) -> list[str]:
    if not parts:
        return list(Design.model_fields)
    if parts[0] == "shape":
        kind = data.get("shape", {}).get("kind")
        return list(SHAPE_MODELS[kind].model_fields) if kind in SHAPE_MODELS else ["kind"]
    if parts[0] == "fixtures":
        return list(FIXTURE_MODELS[data["fixtures"][parts[1]]["kind"]].model_fields)
    if parts[0] == "regions":
        return list(RegionSection.model_fields)
    model = Design.model_fields[parts[0]].annotation
    if isinstance(model, type) and issubclass(model, BaseModel):
        return list(model.model_fields)
    return []


def design_hash(design: Design) -> str:
    """Hash of the resolved design, the same for the same fields in any order.

    Names of regions are left out: with others it is still the same sensor.
    """
    text = json.dumps(design.model_dump(mode="json", exclude={"regions"}), sort_keys=True)
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
    for name, info in Design.model_fields.items():
        section = getattr(design, name)
        if isinstance(section, BaseModel):
            document.add(tomlkit.nl())
            document.add(name, _table(section, values[name]))
            continue
        listed = name in {"fixtures", "regions"}
        if listed:
            document.add(tomlkit.nl())
        if info.description:
            document.add(tomlkit.comment(info.description))
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
        extra = info.json_schema_extra
        assumed = isinstance(extra, dict) and bool(extra.get("assumption"))
        limits = [
            f"{sign} {getattr(rule, name):g}"
            for rule in info.metadata
            for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
            if isinstance(getattr(rule, name, None), int | float)
        ]
        text = (info.description or key) + (f" [{', '.join(limits)}]" if limits else "")
        table.add(tomlkit.comment(text + (" (assumed)" if assumed else "")))
        table.add(key, values[key])
    return table


def _tables(sections: Sequence[BaseModel], values: list[dict[str, Any]]) -> AoT:
    tables = tomlkit.aot()
    for section, value in zip(sections, values, strict=True):
        tables.append(_table(section, value))
    return tables


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
    if path.exists():
        raise OutputError(f"{path} exists already; choose another name or remove it")
    try:
        path.write_text(to_toml(design), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from None
    return path
