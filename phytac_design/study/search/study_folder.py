"""A study's folder: what is done is kept, whatever is killed, and read back in bounded memory.

``study.json`` says which study it is. ``open.jsonl`` has a line for every result of the batch that
is open; when it is complete, its rows become a part in ``parts`` and the lines go. At the end the
parts join ``results.parquet``, a row group each.
"""

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import IO, Any

from phytac_design.core.parquet_recording import parquet_library
from phytac_design.engine.cache import code_hash, locked
from phytac_design.study.search.measures import measures_up_to
from phytac_design.study.search.space import Params, Space
from phytac_design.study.search.study_file import Study
from phytac_design.study.search.successive_halving import Outcome, Task, spec_of
from phytac_shapes.errors import InputError, OutputError, cause_of

STUDY, RESULTS, PARTS, OPEN = "study.json", "results.parquet", "parts", "open.jsonl"
GROUP_ROWS = 4096
"""Rows that a group of the results holds at most; small parts are joined up to this."""
FACTS = ("status", "rung", "reason", "violation", "design", "code", "version")


class Store:
    """The folder of a study, held by one driver."""

    def __init__(self, folder: Path, study: Study, space: Space, kind: str) -> None:
        self.folder, self.study = folder, study
        self.arrow = parquet_library()
        self.version = metadata.version("phytac-design")
        self.spec = spec_of(study, space)
        self.schema = self._schema(space)
        self.open_results: dict[str, Outcome] = {}
        try:
            (folder / PARTS).mkdir(parents=True, exist_ok=True)
            self._lock = (folder / ".lock").open("w")
        except OSError as error:
            raise _unwritable(folder, error) from None
        try:
            self._be_alone()
            self._claim(kind)
            self._drop_stale()
            files = self._files()
            self.rows = sum(self.arrow.parquet.read_metadata(path).num_rows for path in files)
            self._read_open()
            self._journal: IO[str] = self._append()
        except BaseException:
            self._lock.close()
            raise

    def _be_alone(self) -> None:
        """Refuse a folder that another driver works in."""
        if not locked(self._lock, fcntl.LOCK_EX):
            raise OutputError(
                f"another process works in {self.folder}; wait for it, or choose another --out"
            )

    def _claim(self, kind: str) -> None:
        """Make the folder this study's, or refuse it if it is another's."""
        path = self.folder / STUDY
        mine = {"kind": kind, "identity": self.study.identity(), **json.loads(self.spec)}
        if path.is_file():
            try:
                old = json.loads(path.read_text(encoding="utf-8"))
            except ValueError:
                old = {}
            if any(old.get(key) != mine[key] for key in ("kind", "identity", "base")):
                raise OutputError(
                    f"{self.folder} holds another study ({old.get('kind', 'unknown')} "
                    f"{old.get('study', {}).get('name', '?')!r}); choose another --out, or remove "
                    "it. Only budget may change while a study goes on"
                )
        partial = path.with_name(f".{STUDY}.part")
        try:
            partial.write_text(json.dumps(mine, indent=1) + "\n", encoding="utf-8")
            partial.replace(path)
        except OSError as error:
            raise _unwritable(self.folder, error) from None

    def _schema(self, space: Space) -> Any:
        """Columns and their types; the same for all rows of a study."""
        arrow = self.arrow
        columns = [("trial", arrow.int64())]
        for axis in space.axes:
            if axis.variable.choices and not all(
                isinstance(value, int | float) for value in axis.variable.choices
            ):
                columns.append((axis.field, arrow.string()))
            else:
                columns.append((axis.field, arrow.int64() if axis.whole else arrow.float64()))
        columns += [(name, arrow.float64()) for name in measures_up_to(self.study.rungs)]
        columns += [
            (name, arrow.float64() if name == "violation" else arrow.string()) for name in FACTS
        ]
        columns += [(f"seconds.{rung}", arrow.float64()) for rung in self.study.rungs]
        return arrow.schema(columns)

    def _files(self) -> list[Path]:
        """Everything that is done, in order."""
        whole = self.folder / RESULTS
        return [whole] * whole.is_file() + sorted((self.folder / PARTS).glob("*.parquet"))

    def _drop_stale(self) -> None:
        """Remove parts that are in the results already: the driver was killed while it joined."""
        whole = self.folder / RESULTS
        have = self.arrow.parquet.read_metadata(whole).num_rows if whole.is_file() else 0
        for path in (self.folder / PARTS).iterdir():
            if path.suffix != ".parquet" or int(path.stem) < have:
                path.unlink()

    def _read_open(self) -> None:
        """Results of the batch that was open; a line that was cut off counts for nothing."""
        with suppress(FileNotFoundError), (self.folder / OPEN).open(encoding="utf-8") as file:
            for line in file:
                with suppress(ValueError, TypeError, KeyError):
                    data = json.loads(line)
                    self.open_results[data["key"]] = Outcome(**data["outcome"])

    def _append(self) -> IO[str]:
        try:
            stream = (self.folder / OPEN).open("a", encoding="utf-8")
            stream.write("\n" if stream.tell() else "")
        except OSError as error:
            raise _unwritable(self.folder, error) from None
        return stream

    def keep(self, task: Task, outcome: Outcome) -> None:
        """Write down a result of the open batch."""
        self.open_results[task.key] = outcome
        line = json.dumps({"key": task.key, "outcome": vars(outcome)})
        try:
            self._journal.write(line + "\n")
            self._journal.flush()
        except OSError as error:
            raise _unwritable(self.folder, error) from None

    def row(self, trial: int, params: Params, outcome: Outcome) -> dict[str, Any]:
        """A candidate's row."""
        facts = {name: getattr(outcome, name) for name in FACTS[:5]}
        return {
            "trial": trial,
            **params,
            **outcome.measures,
            **facts,
            "code": code_hash()[:16],
            "version": self.version,
            **{f"seconds.{rung}": value for rung, value in outcome.seconds.items()},
        }

    def close_batch(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Make the open batch's rows a part, whole or not at all."""
        self._write(self.folder / PARTS / f"{self.rows:012d}.parquet", rows)
        self.rows += len(rows)
        self.open_results.clear()
        try:
            self._journal.close()
            (self.folder / OPEN).unlink()
        except OSError as error:
            raise _unwritable(self.folder, error) from None
        self._journal = self._append()

    def _write(self, path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
        table = self.arrow.Table.from_pylist(
            [{name: row.get(name) for name in self.schema.names} for row in rows],
            schema=self.schema,
        )
        partial = path.with_name(f".{path.name}.part")
        try:
            self.arrow.parquet.write_table(table, partial, compression="zstd")
            partial.replace(path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise _unwritable(self.folder, error) from None

    def read(self, first: int = 0) -> Iterator[dict[str, Any]]:
        """Rows from a number on, a group of them in memory at a time."""
        at = 0
        for path in self._files():
            source = self.arrow.parquet.ParquetFile(path)
            for group in range(source.num_row_groups):
                size = source.metadata.row_group(group).num_rows
                if at + size > first:
                    rows = source.read_row_group(group).to_pylist()
                    yield from rows[max(first - at, 0) :]
                at += size

    def join(self) -> Path:
        """Join what is done into ``results.parquet``, without reading it all at once."""
        whole, files = self.folder / RESULTS, self._files()
        if files == [whole] or not files:
            return whole
        partial = whole.with_name(f".{RESULTS}.part")
        try:
            with self.arrow.parquet.ParquetWriter(
                partial, self.schema, compression="zstd"
            ) as writer:
                waiting: list[Any] = []
                for path in files:
                    source = self.arrow.parquet.ParquetFile(path)
                    for group in range(source.num_row_groups):
                        waiting.append(source.read_row_group(group))
                        if sum(len(table) for table in waiting) >= GROUP_ROWS:
                            writer.write_table(self.arrow.concat_tables(waiting))
                            waiting = []
                if waiting:
                    writer.write_table(self.arrow.concat_tables(waiting))
            partial.replace(whole)
            for path in files:
                if path != whole:
                    path.unlink()
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise _unwritable(self.folder, error) from None
        return whole

    def close(self) -> None:
        """Let others work in the folder."""
        self._journal.close()
        self._lock.close()


def read_study(folder: Path) -> tuple[Study, dict[str, Any], str]:
    """Study of a folder, the design that it varies, and whether it sweeps or optimises.

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
            f"{folder} holds no study ({cause_of(error)}); give the folder that `phytac sweep` or "
            "`phytac optimise` wrote"
        ) from None


def read_columns(folder: Path, names: Sequence[str]) -> dict[str, Any]:
    """Columns of all rows that are done, as arrays or lists of text.

    Raises
    ------
    InputError
        If the folder holds no results.
    """
    arrow = parquet_library()
    files = [folder / RESULTS] * (folder / RESULTS).is_file()
    have = arrow.parquet.read_metadata(files[0]).num_rows if files else 0
    parts = sorted((folder / PARTS).glob("*.parquet"))
    files += [path for path in parts if int(path.stem) >= have]
    if not files:
        raise InputError(f"{folder} has no results yet; run the study on")
    tables = [arrow.parquet.read_table(path, columns=list(names)) for path in files]
    table = arrow.concat_tables(tables)
    return {
        name: table[name].to_pylist()
        if arrow.types.is_string(table.schema.field(name).type)
        else table[name].cast(arrow.float64()).fill_null(float("nan")).to_numpy()
        for name in names
    }


def _unwritable(folder: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot write {folder}: {error.strerror or error}; make room or choose another --out. "
        "What was done is kept: the same command goes on there"
    )
