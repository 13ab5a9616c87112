"""The folder of a study: completed batches survive a kill at any time.

``study.json`` identifies the study. ``open.jsonl`` has a line for every result of the current
batch; when the batch is complete, its rows become a file in ``parts``. At the end the parts are
merged into ``results.parquet``.
"""

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from phytac_design.core.parquet_recording import parquet_library
from phytac_design.design.design_file import design_hash, parse_design
from phytac_design.design.spec import Design
from phytac_design.engine.cache import code_hash, locked
from phytac_design.study.search.design_space import DesignSpace, Params, make_space
from phytac_design.study.search.measures import measures_up_to
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.successive_halving import Outcome, Task, spec_of
from phytac_shapes.errors import DesignError, InputError, OutputError, cause_of

STUDY, RESULTS, PARTS, OPEN = "study.json", "results.parquet", "parts", "open.jsonl"


def _other(old: dict[str, Any], mine: dict[str, Any]) -> str:
    """Say whose results a folder holds, by its ``study.json`` and the one to be written."""
    if not isinstance(old.get("study"), dict):
        return "another study"
    if old.get("kind") != mine["kind"]:
        return f"a study of phytac {old.get('kind', 'unknown')}, and this is phytac {mine['kind']}"
    free = {"name", "description", "budget"}
    names = [key for key in mine["study"] if key not in free]
    other = [key for key in names if old["study"].get(key) != mine["study"][key]]
    if old.get("base") != mine["base"]:
        other.append("the design that it starts from")
    if mine["study"]["sampling"]["sweep"] != "sobol":
        count = [one["study"].get("budget", {}).get("candidates") for one in (old, mine)]
        other += ["the number of candidates, which its points depend on"] * (count[0] != count[1])
    what = ", ".join(other) or "what another version of phytac wrote"
    return f"results of another study, which differs in: {what}"


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turn errors of the file system into :class:`OutputError`."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            "output-not-writable",
            f"cannot write {folder}: {error.strerror or error}; free disk space or choose another "
            "--out. Completed candidates are kept: the same command resumes there",
        ) from None


class Store:
    """The folder of a study, locked by one process."""

    facts = ("status", "rung", "reason", "violation", "design")
    """Fields of an outcome that are columns."""

    def __init__(self, folder: Path, study: Study, space: DesignSpace, kind: str) -> None:
        self.folder, self.study = folder, study
        self.arrow = parquet_library()
        self.spec = spec_of(study, space)
        self.schema = self._schema(space)
        self.open_results: dict[str, Outcome] = {}
        with _writing(folder):
            (folder / PARTS).mkdir(parents=True, exist_ok=True)
            self._lock = (folder / ".lock").open("w")
        try:
            self._claim(kind)
            files = result_files(folder)
            for path in (folder / PARTS).iterdir():
                # Partial files, and parts that were merged before the process was killed.
                if path not in files:
                    path.unlink()
            self.rows = sum(self.arrow.parquet.read_metadata(path).num_rows for path in files)
            with suppress(FileNotFoundError), (folder / OPEN).open(encoding="utf-8") as file:
                for line in file:
                    with suppress(ValueError, TypeError, KeyError):  # the last line may be cut off
                        data = json.loads(line)
                        self.open_results[data["key"]] = Outcome(**data["outcome"])
            self._open_journal()
        except BaseException:
            self._lock.close()
            raise

    def _claim(self, kind: str) -> None:
        """Lock the folder and write ``study.json``, or reject the folder of another study."""
        if not locked(self._lock, fcntl.LOCK_EX):
            raise OutputError(
                "output-locked",
                f"another process works in {self.folder}; wait for it, or choose another --out",
            )
        path = self.folder / STUDY
        mine = {"kind": kind, "identity": self.study.identity(), **json.loads(self.spec)}
        if path.is_file():
            try:
                old = json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                old = {}
            if any(old.get(key) != mine[key] for key in ("kind", "identity", "base")):
                raise OutputError(
                    "output-foreign",
                    f"{self.folder} holds {_other(old, mine)}; choose another --out, or remove it. "
                    "Only name, description and, with sampling.sweep = sobol, [budget] may change "
                    "when a study is resumed",
                )
        partial = path.with_name(f".{STUDY}.part")
        with _writing(self.folder):
            partial.write_text(json.dumps(mine, indent=1) + "\n", encoding="utf-8")
            partial.replace(path)

    def _schema(self, space: DesignSpace) -> Any:
        """Columns and their types; the same for all rows of a study."""
        text, real, integer = self.arrow.string(), self.arrow.float64(), self.arrow.int64()
        columns = [("trial", integer)]
        for axis in space.axes:
            words = any(isinstance(value, str) for value in axis.variable.choices)
            columns.append((axis.field, text if words else integer if axis.integer else real))
        columns += [(name, real) for name in measures_up_to(self.study.levels)]
        columns += [
            (name, real if name == "violation" else text)
            for name in (*self.facts, "code", "version")
        ]
        columns += [(f"seconds.{level}", real) for level in self.study.levels]
        return self.arrow.schema(columns)

    def _open_journal(self) -> None:
        with _writing(self.folder):
            self._journal = (self.folder / OPEN).open("a", encoding="utf-8")
            self._journal.write("\n" if self._journal.tell() else "")

    def keep(self, task: Task, outcome: Outcome) -> None:
        """Append a result of the current batch."""
        self.open_results[task.key] = outcome
        with _writing(self.folder):
            self._journal.write(json.dumps({"key": task.key, "outcome": vars(outcome)}) + "\n")
            self._journal.flush()

    def row(self, trial: int, params: Params, outcome: Outcome) -> dict[str, Any]:
        """A candidate's row."""
        return {
            "trial": trial,
            **params,
            **outcome.measures,
            **{name: getattr(outcome, name) for name in self.facts},
            "code": code_hash()[:16],
            "version": metadata.version("phytac-design"),
            **{f"seconds.{level}": value for level, value in outcome.seconds.items()},
        }

    def close_batch(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the rows of the current batch as a part."""
        columns = {name: [row.get(name) for row in rows] for name in self.schema.names}
        table = self.arrow.Table.from_pydict(columns, schema=self.schema)
        self._write(table, self.folder / PARTS / f"{self.rows:012d}.parquet")
        self.rows += len(rows)
        self.open_results.clear()
        with _writing(self.folder):
            self._journal.close()
            (self.folder / OPEN).unlink()
        self._open_journal()

    def _write(self, table: Any, path: Path) -> None:
        """Write a table completely or not at all."""
        partial = path.with_name(f".{path.name}.part")
        with _writing(self.folder):
            try:
                self.arrow.parquet.write_table(table, partial, compression="zstd")
                partial.replace(path)
            finally:
                partial.unlink(missing_ok=True)

    def read(self, first: int = 0) -> list[dict[str, Any]]:
        """Rows from a number on."""
        rows: list[dict[str, Any]] = _table(self.folder).slice(first).to_pylist()
        return rows

    def merge(self) -> None:
        """Merge the parts into ``results.parquet``."""
        files = result_files(self.folder)
        if not files or files == [self.folder / RESULTS]:
            return
        self._write(_table(self.folder), self.folder / RESULTS)
        with _writing(self.folder):
            for path in (self.folder / PARTS).iterdir():
                path.unlink()

    def close(self) -> None:
        """Release the folder."""
        self._journal.close()
        self._lock.close()


def result_files(folder: Path) -> list[Path]:
    """Files that hold all rows of a study, each row once, in order."""
    merged = [folder / RESULTS] * (folder / RESULTS).is_file()
    rows = parquet_library().parquet.read_metadata(merged[0]).num_rows if merged else 0
    parts = sorted((folder / PARTS).glob("*.parquet"))
    return merged + [path for path in parts if int(path.stem) >= rows]


def _table(folder: Path, columns: Sequence[str] | None = None) -> Any:
    arrow, files = parquet_library(), result_files(folder)
    if not files:
        raise InputError("study-without-results", f"{folder} has no results yet; resume the study")
    return arrow.concat_tables(arrow.parquet.read_table(path, columns=columns) for path in files)


def read_study(folder: Path) -> tuple[Study, dict[str, Any], str]:
    """Study of a folder, its base design, and ``sweep`` or ``optimise``.

    Raises
    ------
    InputError
        If the folder holds none.
    """
    try:
        data = json.loads((folder / STUDY).read_text(encoding="utf-8"))
        return Study.model_validate(data["study"]), data["base"], data["kind"]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            "study-not-found",
            f"{folder} holds no study ({cause_of(error)}); give the folder that `phytac sweep` or "
            "`phytac optimise` wrote",
        ) from None


def read_columns(folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """Columns of all rows: arrays (n,), NaN where empty, or lists of text.

    Raises
    ------
    InputError
        If the folder holds no results.
    """
    arrow, table = parquet_library(), _table(folder, list(names))
    return {
        name: table[name].to_pylist()
        if arrow.types.is_string(table.schema.field(name).type)
        else table[name].cast(arrow.float64()).fill_null(float("nan")).to_numpy()
        for name in names
    }


def rebuild(folder: Path, trial: int) -> Design:
    """Design of a candidate, exactly; its name is the study's with the trial's number.

    Parameters
    ----------
    folder : Path
        A study's folder, or a file in it.
    trial : int
        Number of the candidate.

    Raises
    ------
    InputError
        If the folder holds no such candidate.
    DesignError
        If this version of the program makes another design of it.
    """
    folder = folder.parent if folder.is_file() else folder
    study, base, _ = read_study(folder)
    fields = [variable.field for variable in study.variable]
    table = _table(folder, ["trial", *fields, "design"])
    rows = table.filter(parquet_library().compute.field("trial") == trial).to_pylist()
    if not rows:
        raise InputError(
            "trial-unknown", f"{folder} has no trial {trial}; it has {len(table)}, counted from 0"
        )
    space = make_space(study, Path(), parse_design(base, f"base of {study.name}"))
    design, expected = space.design({field: rows[0][field] for field in fields}), rows[0]["design"]
    if expected and design_hash(design) != expected:
        raise DesignError(
            "trial-of-other-version",
            f"trial {trial} of {folder} is another design in this version of the program (hash "
            f"{design_hash(design)[:12]}, was {expected[:12]}); build it with the version of its "
            "row",
        )
    # The name is not part of the hash.
    name = f"{study.name}-{trial}"[-64:].lstrip("_.-")
    return parse_design(design.model_dump(mode="json") | {"name": name}, f"trial {trial}")
