"""Rows of a benchmark: value, reference, target; whether it holds is computed, never typed in."""

import argparse
import json
import operator
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import provenance

RESULTS = Path(__file__).parent / "results"
COMPARE: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "<": operator.lt,
    ">": operator.gt,
    "==": operator.eq,
}


def holds(value: float, target: str) -> bool:
    """Whether ``value`` meets a target such as ``"<= 0.05"``."""
    sign, number = target.split()
    return COMPARE[sign](float(value), float(number))


@dataclass
class Table:
    """Rows of one benchmark; ``write`` makes ``results/NAME.json``.

    Attributes
    ----------
    name : str
        Of the benchmark.
    part : str
        Part that rows are of.
    made : dict
        What makes them, see :mod:`benchmarks.provenance`.
    """

    name: str
    part: str = ""
    made: dict[str, Any] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    begin_s: float = field(default_factory=time.monotonic)

    def add(
        self,
        case: str,
        value: float,
        unit: str,
        reference: float | str,
        source: str,
        target: str | None = None,
        note: str = "",
    ) -> None:
        """Add a row and print it; ``target=None`` marks a figure that is only reported.

        Parameters
        ----------
        case : str
            What was measured, on what.
        value : float
            Figure, in ``unit``.
        unit : str
            "" where it has none.
        reference : float or str
            What it is compared with.
        source : str
            Where the reference comes from.
        target : str, optional
            Such as ``"<= 0.05"``.
        note : str
            What else was seen.
        """
        row: dict[str, Any] = {
            "case": case,
            "value": value,
            "unit": unit,
            "reference": reference,
            "source": source,
        }
        if target is not None:
            row |= {"target": target, "holds": holds(value, target)}
        if note:
            row["note"] = note
        if self.part:
            row["part"] = self.part
        self.rows.append(row)
        verdict = "" if target is None else f"  target {target}: {row['holds']}"
        print(f"{case}: {value:.6g} {unit}{verdict}", flush=True)

    def goal(
        self,
        case: str,
        value: float,
        unit: str,
        target: str,
        *,
        source: str = "project target",
        note: str = "",
    ) -> None:
        """Add a row whose reference is its target."""
        reference = float(target.split()[1])
        self.add(case, value, unit, reference=reference, source=source, target=target, note=note)

    def write(self, *, order: Sequence[str]) -> Path:
        """Write the table as JSON beside the other results.

        Rows of other parts are kept, in the ``order`` of all parts, with what made them.
        """
        RESULTS.mkdir(exist_ok=True)
        path = RESULTS / f"{self.name}.json"
        before = json.loads(path.read_text()) if path.is_file() else {"parts": {}, "rows": []}
        made = self.made | {"seconds": round(time.monotonic() - self.begin_s, 1)}
        known = before["parts"] | {self.part: made}
        rows = [row for row in before["rows"] if row["part"] != self.part] + self.rows
        data = {
            "parts": {part: known[part] for part in order if part in known},
            "rows": [row for part in order for row in rows if row["part"] == part],
        }
        path.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n")
        return path


Parts = Callable[..., dict[str, Callable[[Table], None]]]


def module_of(work: Callable[..., None], name: str) -> str:
    """Return the module of a part of the benchmark ``name``, which may be the program itself."""
    while isinstance(work, partial):
        work = work.func
    return f"benchmarks.{name}" if work.__module__ == "__main__" else work.__module__


def run_parts(name: str, parts: Parts, description: str, **settings: float | bool) -> None:
    """Run a benchmark's parts, ``--parts a,b`` or all; each is written as soon as it is done.

    Parameters
    ----------
    name : str
        Of the benchmark.
    parts : callable
        ``parts(quick=...)`` gives the parts by name, in order.
    description : str
        For ``--help``.
    **settings : float or bool
        Options of this benchmark alone, with their defaults: further arguments of ``parts``.
    """
    parser = argument_parser(description)
    for option, default in settings.items():
        if isinstance(default, bool):
            parser.add_argument(f"--{option}", action="store_true")
        else:
            parser.add_argument(f"--{option}", type=float, default=default)
    parser.add_argument("--parts", default="", help="parts to run, comma separated; all if empty")
    given = parser.parse_args()
    known = parts(quick=given.quick, **{option: getattr(given, option) for option in settings})
    chosen = [part for part in given.parts.split(",") if part] or list(known)
    unknown = [part for part in chosen if part not in known]
    if unknown:
        parser.error(f"no part {unknown[0]!r}; known: {', '.join(known)}")
    for part in chosen:
        command = f"python -m benchmarks.{name} --parts {shlex.quote(part)}"
        module = module_of(known[part], name)
        made = {} if given.quick else provenance.record(module, command)
        table = Table(name, part=part, made=made)
        known[part](table)
        if not given.quick:
            table.write(order=list(known))


def median_of(work: Callable[[], Any], repeats: int = 5) -> float:
    """Median seconds of ``repeats`` runs after one warm-up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return sorted(times)[len(times) // 2]


def argument_parser(description: str) -> argparse.ArgumentParser:
    """Command line shared by all benchmarks: ``--quick`` for a smoke run (not written)."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="smaller cases, result not written")
    return parser
