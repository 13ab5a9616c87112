"""Design files in the folder that the studio was started in: opened with, saved with comments."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import Any

import tomlkit

from phytac_design.design.design_file import design_hash, parse_design, shipped_designs, to_toml
from phytac_design.design.spec import Design
from phytac_shapes.bounded_reader import read_text, toml_table
from phytac_shapes.errors import InputError, OutputError, PhytacError

FILES_MAX = 500
DEPTH_MAX = 4
BYTES_MAX = 4_000_000
"""Largest design file that is read."""
NAME_BYTES = 200
"""Longest name of a file or folder, with room for what is added while it is written."""
SKIPPED = {"node_modules", "__pycache__"}

Json = dict[str, Any]


class AskError(OutputError):
    """A file is there already: whoever asks must say that it may go."""


@dataclass(frozen=True, kw_only=True)
class Opened:
    """A design file as it stands: its tables, its text, and the folder its files are beside."""

    name: str
    text: str
    data: Json
    folder: Path

    @property
    def digest(self) -> str:
        """Hash of the text, to see that it has not changed since."""
        return digest_of(self.text)


def digest_of(text: str) -> str:
    """Hash of a file's text."""
    return sha256(text.encode()).hexdigest()


class ProjectFolder:
    """The one folder that the studio reads designs from and writes them to.

    Parameters
    ----------
    root : Path
        The folder.
    given : Path, optional
        A design file elsewhere that was named on the command line; it may be read too.
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
        long = any(len(part.encode()) > NAME_BYTES for part in Path(name).parts)
        if not inside or long or not name.isprintable():
            raise InputError(
                f"{name[:200]!r} is not in the folder that the studio was started in "
                f"({self.root}); give a path below it"
            )
        return path

    def designs(self) -> list[str]:
        """Paths of the folder's design files, relative to it; those of builds are left out."""
        found = []
        for path in walk(self.root, ".toml"):
            if (path.parent / "manifest.json").is_file():
                continue
            with suppress(OSError, UnicodeDecodeError):
                if "[shape]" in read_text(path, bytes_max=BYTES_MAX):
                    found.append(path.relative_to(self.root).as_posix())
        return sorted(found)

    def open(self, name: str) -> Opened:
        """Read a shipped design by name, or a file of the folder.

        Raises
        ------
        InputError
            If there is none, or it is no TOML.
        """
        if name in shipped_designs():
            text = (
                resources.files("phytac_design") / "data" / "designs" / f"{name}.toml"
            ).read_text("utf-8")
            return Opened(name=name, text=text, data=toml_table(text), folder=Path())
        path = Path(name).resolve() if self._is_given(name) else self.within(name)
        try:
            text = read_text(path, bytes_max=BYTES_MAX)
            data = toml_table(text)
        except OSError as error:
            raise InputError(f"no design {name!r} ({error.strerror}); open another one") from None
        except ValueError as error:
            raise InputError(f"{name} is not TOML: {error}; open another file") from None
        return Opened(name=name, text=text, data=data, folder=path.parent)

    def _is_given(self, name: str) -> bool:
        return self.given is not None and str(self.given) == name

    def folder_of(self, source: str) -> Path:
        """Folder that files of a design are relative to; the workplace itself for shipped ones.

        Raises
        ------
        InputError
            If the source leads out of the workplace.
        """
        if self._is_given(source):
            return Path(source).parent
        if not source or source in shipped_designs():
            return self.root
        return self.within(source).parent

    def save(
        self, name: str, data: Json, *, source: str, replace: str = "", force: bool = False
    ) -> Opened:
        """Write a design; comments of the file that it came from stay where its fields stay.

        Parameters
        ----------
        name : str
            Path below the folder, ending in ``.toml``.
        data : dict
            Tables of the design.
        source : str
            What it was opened as.
        replace : str
            Digest of the text that may be written over without asking.
        force : bool
            Write over whatever is there: the user was asked.

        Raises
        ------
        DesignError
            If the tables are no design, or another one at the new place.
        AskError
            If a file is there that the user has not been asked about.
        OutputError
            If it cannot be written.
        InputError
            If the path leads out of the folder.
        """
        if not name.endswith(".toml"):
            raise InputError(f"a design file's name ends in .toml (got {name[:200]!r})")
        path = self.within(name)
        if path.is_dir() or path.name.startswith("."):
            raise InputError(f"{name!r} cannot be a design file; choose another name")
        before = parse_design(data, "the design", folder=self.folder_of(source))
        after = parse_design(data, name, folder=path.parent)
        if design_hash(before) != design_hash(after):
            raise OutputError(
                f"{name} would be another design, since the files that it names lie elsewhere "
                "there; save it beside the file that it came from"
            )
        if path.exists() and not force:
            there = _text(path)
            if not replace or there is None or digest_of(there) != replace:
                raise AskError(f"{name} exists already; write over it?")
        text = self.text_of(data, after, source)
        write_whole(path, text)
        return Opened(name=name, text=text, data=toml_table(text), folder=path.parent)

    def text_of(self, data: Json, design: Design, source: str) -> str:
        """TOML of a design's tables, in the text that it came from where that still holds."""
        base = ""
        with suppress(InputError):
            base = self.open(source).text if source else ""
        if not base:
            return to_toml(design)
        try:
            text = edited(base, data)
            same = parse_design(toml_table(text), "", folder=self.folder_of(source)) == design
        except (ValueError, LookupError, TypeError, AttributeError, PhytacError):
            # What the text was, or its new values, the editor of texts cannot hold.
            same = False
        return text if same else to_toml(design)


def edited(text: str, data: Json) -> str:
    """TOML text with its values made those of ``data``; comments and order of the rest stay."""
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
            # The comment behind a value stays.
            table[key] = value


def _text(path: Path) -> str | None:
    try:
        return read_text(path, bytes_max=BYTES_MAX)
    except (OSError, UnicodeDecodeError):
        return None


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    partial = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        number, partial = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
        with os.fdopen(number, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        mode = path.stat().st_mode if path.exists() else 0o666 & ~_umask()
        Path(partial).chmod(mode & 0o777)
        Path(partial).replace(path)
    except OSError as error:
        if partial:
            Path(partial).unlink(missing_ok=True)
        raise OutputError(
            f"cannot write {path.name}: {error.strerror}; make room, or choose another name"
        ) from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def walk(root: Path, suffix: str) -> Iterator[Path]:
    """Files below a folder by their ending, not too deep and not too many; no hidden ones."""
    left = FILES_MAX
    for folder, names, files in os.walk(root):
        deep = len(Path(folder).relative_to(root).parts)
        names[:] = sorted(
            name for name in names if name not in SKIPPED and not name.startswith((".", "_"))
        ) if deep < DEPTH_MAX else []  # fmt: skip
        for name in sorted(files):
            if name.endswith(suffix) and not name.startswith("."):
                yield Path(folder) / name
                left -= 1
                if left == 0:
                    return
