"""One reader for design, scene, scenario and study files: TOML in, validated model out."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError

from phytac_shapes.bounded_reader import joined, read_text, toml_table
from phytac_shapes.errors import DesignError

Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True, kw_only=True)
class TomlFileKind:
    """A kind of input file.

    Attributes
    ----------
    noun : str
        Name of the kind in messages.
    folder : str
        Folder below ``phytac_design/data`` with the files that come with the package.
    missing : str
        What to do about a missing key.
    template : str
        Where to find a file to start from; "" for the shipped ones.
    label : str
        Key whose value identifies a table of a list in messages, beside its number.
    fixes : mapping
        Messages for fields whose own problems would be unclear, by dotted path.
    """

    noun: str
    folder: str
    missing: str
    template: str = ""
    label: str = ""
    fixes: Mapping[str, str] | None = None

    def shipped(self) -> list[str]:
        """Names of the files that come with the package."""
        folder = resources.files("phytac_design") / "data" / self.folder
        files = (item.name for item in folder.iterdir() if item.name.endswith(".toml"))
        return sorted(name.removesuffix(".toml") for name in files)

    def read(self, name_or_path: str) -> tuple[dict[str, Any], str]:
        """Table of a shipped file by name, or of any file by path; and its name or path.

        Raises
        ------
        DesignError
            If there is no such file, or it is not TOML.
        """
        path, shipped = Path(name_or_path), self.shipped()
        if name_or_path in shipped and not path.is_file():
            source = resources.files("phytac_design") / "data" / self.folder
            text = (source / f"{name_or_path}.toml").read_text(encoding="utf-8")
            return self.parse(text, name_or_path), name_or_path
        try:
            text = read_text(path)
        except UnicodeDecodeError:
            raise self._not_toml(str(path), "it is not even text") from None
        except OSError as error:
            near = get_close_matches(name_or_path, shipped, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise DesignError(
                "toml-file-not-found",
                f"no {self.noun} {name_or_path!r} ({error.strerror}){hint} "
                f"(shipped: {', '.join(shipped)}; or give the path of a {self.noun} file)",
            ) from None
        return self.parse(text, str(path)), str(path)

    def parse(self, text: str, where: str) -> dict[str, Any]:
        """Table of a TOML text; ``where`` names it in messages."""
        try:
            return toml_table(text)
        except ValueError as error:
            raise self._not_toml(where, f"{error}{_line_of(text, str(error))}") from None

    def _not_toml(self, where: str, why: str) -> DesignError:
        start = self.template or f"start from a shipped {self.noun} ({', '.join(self.shipped())})"
        return DesignError("toml-syntax", f"{where} is not TOML: {why}; {start}")

    def validate(
        self, model: type[Model], data: Any, where: str, *, folder: Path | None = None
    ) -> Model:
        """Model of a parsed file; ``folder`` is the one that its paths are relative to.

        Raises
        ------
        DesignError
            With every unknown key and every invalid value.
        """
        try:
            return model.model_validate(data, context={"folder": folder} if folder else None)
        except ValidationError as error:
            problems = error.errors()
            above = {item["loc"][:n] for item in problems for n in range(len(item["loc"]))}
            # A rejected item also makes its list too short: one message is enough.
            kept = (item for item in problems if item["loc"] not in above)
            lines = joined(self._explain(item, model, data) for item in kept)
            raise DesignError("field-invalid", f"{where}: {lines}") from None

    def _explain(self, item: Any, model: type[BaseModel], data: Any) -> str:
        """One problem as a sentence: where, what, got, and the fix."""
        path, models, tag = _locate(model, item["loc"])
        where, kind, got = ".".join(path), item["type"], item["input"]
        for field, text in (self.fixes or {}).items():
            if where == field or where.startswith(f"{field}."):
                return f"{field}: {text} (got {_literal(got)})"
        if kind == "extra_forbidden":
            known = [name for held in models for name in held.model_fields]
            near = get_close_matches(path[-1], known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f" (known: {', '.join(known)})"
            if homes := _tables_with(model, path[-1], but=path[0]):
                hint = f"; it belongs to {' or '.join(homes)}"
            return f"unknown key {_literal(where)}{hint}"
        if kind == "missing":
            return f"{where} is missing; {f'kind {tag!r} needs it' if tag else self.missing}"
        if kind.startswith("union_tag"):
            kinds = ", ".join(name for held in models for name in _tags(held))
            found = got.get("kind") if isinstance(got, dict) else got
            return f"{where}.kind must be one of {kinds} (got {_literal(found)})"
        if self.label and len(path) > 1 and path[1].isdigit():
            table = data[path[0]][int(path[1])]
            named = isinstance(table, dict) and self.label in table
            where += f" ({table[self.label]})" if named else ""
        number = re.match(r"\s*([-+]?\d+(?:\.\d+)?)", got) if isinstance(got, str) else None
        if kind in {"float_parsing", "int_parsing"} and number:
            return f"{where}: write {number[1]}, without unit or quotes (got {_literal(got)})"
        message = item["msg"][0].lower() + item["msg"][1:]
        shown = "" if isinstance(got, dict | BaseModel) else f" (got {_literal(got)})"
        return f"{where or self.noun}: {message.removeprefix('value error, ')}{shown}"


def _line_of(text: str, why: str) -> str:
    """Text of the line that an error of the TOML reader names, for a message; "" for none."""
    place, lines = re.search(r"at line (\d+)", why), text.splitlines()
    if not place or not 0 < int(place[1]) <= len(lines):
        return ""
    return f": {_literal(lines[int(place[1]) - 1].strip())}"


def table_models(annotation: Any) -> list[type[BaseModel]]:
    """Models in an annotation: of ``Model``, ``Model | None`` or ``tuple[A | B, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in get_args(annotation) for found in table_models(part)]


def _tables_with(model: type[BaseModel], field: str, *, but: str) -> list[str]:
    """Tables of a file, as ``[layout]``, that have a field; lists of tables are left out.

    None if another kind of the table ``but`` has it: there the kind is wrong.
    """
    found = [
        name
        for name, info in model.model_fields.items()
        if get_origin(info.annotation) is not tuple
        and any(field in one.model_fields for one in table_models(info.annotation))
    ]
    return [] if but in found else [f"[{name}]" for name in found]


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    """Values of ``kind`` that select a model from a union."""
    return get_args(model.model_fields["kind"].annotation) if "kind" in model.model_fields else ()


def _locate(
    model: type[BaseModel], place: tuple[Any, ...]
) -> tuple[list[str], list[type[BaseModel]], str]:
    """Path in the file to a place in a model, the models there, and the kind of a union's table."""
    path: list[str] = []
    models, tag = [model], ""
    for part in place:
        # Pydantic inserts the kind of a union's table, which is no key of the file.
        tagged = [held for held in models if part in _tags(held)] if len(models) > 1 else []
        if tagged:
            models, tag = tagged, str(part)
            continue
        path.append(str(part))
        fields = models[0].model_fields if len(models) == 1 else {}
        if part in fields:
            models = table_models(fields[part].annotation) or models
    return path, models, tag


def _literal(value: Any) -> str:
    """Literal of a value, shortened to what a reader would look at."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= 120 else f"{text[:120]}…"
