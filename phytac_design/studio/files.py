"""Design files of the folder that the studio was started in; comments survive saving."""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any

import tomlkit

from phytac_design.core.journal import write_atomically
from phytac_design.design.design_file import design_hash, parse_design, shipped_designs, to_toml
from phytac_design.design.spec import Design
from phytac_shapes.bounded_reader import read_text, toml_table
from phytac_shapes.errors import InputError, OutputError, PhytacError

BYTES_MAX = 4_000_000
"""Largest design file that is read."""

Json = dict[str, Any]


class ConfirmationError(OutputError):
    """A file exists already: the user must confirm that it is overwritten."""


@dataclass(frozen=True, kw_only=True)
class OpenedDesign:
    """A design file: name, text, and tables."""

    name: str
    text: str
    data: Json

    @property
    def digest(self) -> str:
        """Hash of the text, to detect later changes."""
        return sha256(self.text.encode()).hexdigest()


class ProjectFolder:
    """The one folder that the studio reads designs from and writes them to.

    Parameters
    ----------
    root : Path
        The folder.
    given : Path, optional
        A design file elsewhere, from the command line; it may be read too.
    """

    def __init__(self, root: Path, given: Path | None = None) -> None:
        self.root = root.resolve()
        self.given = None if given is None else given.resolve()

    def within(self, name: str) -> Path:
        """Path of a file of the folder, links followed.

        Raises
        ------
        InputError
            If it leads out of the folder.
        """
        try:
            path = (self.root / name).resolve()
            inside = path.is_relative_to(self.root)
        except (ValueError, OSError, RuntimeError):
            inside = False
        # Longer names leave no space for the suffix of a partial file.
        long = any(len(part.encode()) > 200 for part in Path(name).parts)
        if not inside or long or not name.isprintable():
            raise InputError(
                "path-outside-folder",
                f"{name[:200]!r} is not in the folder that the studio was started in "
                f"({self.root}); give a path below it",
            )
        return path

    def designs(self) -> list[str]:
        """Paths of the folder's design files, relative to it, without those of builds."""
        found = []
        for path in walk(self.root, ".toml"):
            if (path.parent / "manifest.json").is_file():
                continue
            with suppress(OSError, UnicodeDecodeError):
                if "[shape]" in read_text(path, bytes_max=BYTES_MAX):
                    found.append(path.relative_to(self.root).as_posix())
        return sorted(found)

    def open(self, name: str) -> OpenedDesign:
        """Read a shipped design by name, or a file of the folder.

        Raises
        ------
        InputError
            If there is none, or it is not TOML.
        """
        if name in shipped_designs():
            path = resources.files("phytac_design") / "data" / "designs" / f"{name}.toml"
            text = path.read_text("utf-8")
            return OpenedDesign(name=name, text=text, data=toml_table(text))
        file = Path(name).resolve() if self._is_given(name) else self.within(name)
        try:
            text = read_text(file, bytes_max=BYTES_MAX)
            data = toml_table(text)
        except OSError as error:
            raise InputError(
                "file-unreadable", f"no design {name!r} ({error.strerror}); open another one"
            ) from None
        except ValueError as error:
            raise InputError(
                "file-syntax", f"{name} is not TOML: {error}; open another file"
            ) from None
        return OpenedDesign(name=name, text=text, data=data)

    def _is_given(self, name: str) -> bool:
        return self.given is not None and str(self.given) == name

    def design_of(self, data: Json, source: str) -> Design:
        """Design of some tables; files that it names are relative to its source.

        Raises
        ------
        DesignError
            If the tables are not a design.
        InputError
            If the source leads out of the folder.
        """
        if self._is_given(source):
            folder = Path(source).parent
        elif not source or source in shipped_designs():
            folder = self.root
        else:
            folder = self.within(source).parent
        return parse_design(data, "the design", folder=folder)

    def save(
        self, name: str, data: Json, *, source: str, replace: str = "", force: bool = False
    ) -> OpenedDesign:
        """Write a design; comments of its source stay where the fields stay.

        Parameters
        ----------
        name : str
            Path below the folder, ending in ``.toml``.
        data : dict
            Tables of the design.
        source : str
            The file that it was opened from.
        replace : str
            Digest of the text that may be overwritten without confirmation.
        force : bool
            Overwrite any file: the user has confirmed.

        Raises
        ------
        DesignError
            If the tables are not a design, or another one at the new path.
        ConfirmationError
            If a file exists that the user has not confirmed to overwrite.
        OutputError
            If it cannot be written.
        InputError
            If the path leads out of the folder.
        """
        if not name.endswith(".toml"):
            raise InputError(
                "file-name-invalid", f"a design file's name ends in .toml (got {name[:200]!r})"
            )
        path = self.within(name)
        if path.is_dir() or path.name.startswith("."):
            raise InputError(
                "file-name-invalid", f"{name!r} cannot be a design file; choose another name"
            )
        before = self.design_of(data, source)
        after = parse_design(data, name, folder=path.parent)
        if design_hash(before) != design_hash(after):
            raise OutputError(
                "output-moves-design",
                f"{name} would be another design, since the files that it names are relative "
                "to its folder; save it beside the file that it came from",
            )
        if path.exists() and not force:
            try:
                digest = sha256(read_text(path, bytes_max=BYTES_MAX).encode()).hexdigest()
            except (OSError, UnicodeDecodeError):
                digest = ""
            if not replace or digest != replace:
                raise ConfirmationError(
                    "overwrite-unconfirmed", f"{name} exists already; overwrite it?"
                )
        text = self.text_of(data, after, source)
        write_file(path, text)
        return OpenedDesign(name=name, text=text, data=toml_table(text))

    def text_of(self, data: Json, design: Design, source: str) -> str:
        """TOML of a design, as an edit of its source's text where that is possible."""
        base = ""
        with suppress(InputError):
            base = self.open(source).text if source else ""
        if not base:
            return to_toml(design)
        try:
            text = edited(base, data)
            same = self.design_of(toml_table(text), source) == design
        except (ValueError, LookupError, TypeError, AttributeError, PhytacError):
            # tomlkit cannot hold some texts and values.
            same = False
        return text if same else to_toml(design)


def edited(text: str, data: Json) -> str:
    """TOML text with the values of ``data``; comments and order stay."""
    document = tomlkit.parse(text)
    _edit(document, toml_table(text), data)
    return tomlkit.dumps(document)


def _edit(table: Any, old: Json, new: Json) -> None:
    for key in old.keys() - new.keys():
        table.remove(key)
    for key, value in new.items():
        known = old.get(key)
        if isinstance(known, dict) and isinstance(value, dict) and known.get("kind") == value.get(
            "kind", known.get("kind")
        ):  # fmt: skip
            _edit(table[key], known, value)
        elif key not in old or known != value or type(known) is not type(value):
            table[key] = value  # keeps the comment behind the value


def write_file(path: Path, text: str) -> None:
    """Write a file completely or not at all; it keeps its permissions.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = path.stat().st_mode & 0o777 if path.exists() else None
        write_atomically(path, text.encode(), mode=mode)
    except OSError as error:
        raise OutputError(
            "output-not-writable",
            f"cannot write {path.name}: {error.strerror}; free disk space, or choose another name",
        ) from None


def walk(root: Path, suffix: str) -> Iterator[Path]:
    """Up to 500 files below a folder by their ending, four folders deep; no hidden ones."""
    remaining, skipped = 500, {"node_modules", "__pycache__"}
    for folder, names, files in os.walk(root):
        deep = len(Path(folder).relative_to(root).parts)
        own = [name for name in names if name not in skipped and name[0] not in "._"]
        names[:] = sorted(own) if deep < 4 else []
        for name in sorted(files):
            if name.endswith(suffix) and not name.startswith("."):
                yield Path(folder) / name
                remaining -= 1
                if remaining == 0:
                    return
