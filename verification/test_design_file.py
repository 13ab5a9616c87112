"""The design file: every number at and beyond its ends, wrong types, files that are none."""

import json
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel

from phytac_design.design.design_file import load_design, parse_design, shipped_designs, to_toml
from phytac_design.design.spec import Design
from phytac_shapes.errors import DesignError
from verification.case import Case, Cases, Evidence, Recorder, unreadable, verify
from verification.designs import base, changed

NUMBERLESS: tuple[Any, ...] = ("text", [], {}, True, [1.0, 2.0, 3.0])
"""What is no number, in ways that other readers of files let pass."""
MONSTERS: tuple[Any, ...] = (float("nan"), float("inf"), float("-inf"), 10**400)


def check_beyond(values: Mapping[str, Any], found: Evidence) -> None:
    """Every one of the values must be refused, in words."""
    last = None
    for value in values["bad"]:
        data = changed(base("cylinder"), {values["table"]: {values["field"]: value}})
        try:
            parse_design(data, "extreme")
        except DesignError as error:
            last = error
            poor = unreadable(str(error))
            found.true(f"readable for {value!r:.40}{': ' if poor else ''}{poor}", not poor)
        else:
            found.true(f"{values['table']}.{values['field']} = {value!r:.40} is refused", False)
    if last is not None:
        raise last


def check_ends(values: Mapping[str, Any], found: Evidence) -> None:
    """A value at its end is kept, bit for bit, by the resolved file; or refused by another rule."""
    last = None
    for value in values["good"]:
        data = changed(base("cylinder"), {values["table"]: {values["field"]: value}})
        try:
            design = parse_design(data, "extreme")
        except DesignError as error:
            last = error
            poor = unreadable(str(error))
            found.true(f"readable for {value!r}{': ' if poor else ''}{poor}", not poor)
            continue
        read = tomllib.loads(to_toml(design))
        table, field = values["table"], values["field"]
        if type(getattr(design, table)).model_fields[field].exclude:
            found.true("the resolved file has what it stands for", field not in read[table])
        else:
            kept = read[table][field]
            found.true(f"tomllib reads {value!r} back from the resolved file", kept == value)
        again = parse_design(read, "again").model_dump(mode="json")
        found.true("the resolved file is the same design", again == design.model_dump(mode="json"))
    if last is not None and len(found.findings) == len(values["good"]):
        raise last


def check_file(values: Mapping[str, Any], found: Evidence) -> None:
    """Bytes as a design file: read as tomllib reads them, or refused."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "extreme.toml"
        path.write_bytes(values["text"].encode("latin-1"))
        design = load_design(str(path))
    known = tomllib.loads(values["text"].encode("latin-1").decode("utf-8"))
    own = json.loads(design.model_dump_json())
    for table, fields in known.items():
        if isinstance(fields, dict):
            same = all(
                value in (own[table][key], str(own[table][key])) for key, value in fields.items()
            )
            found.true(f"[{table}] as tomllib reads it", same, kind="reference")


def check_shipped(values: Mapping[str, Any], found: Evidence) -> None:
    """A shipped design, written out and read again, is itself."""
    design = load_design(values["design"])
    again = parse_design(tomllib.loads(to_toml(design)), "again")
    found.true("tomllib: the resolved file is the same design", again == design, kind="reference")


def _numbers() -> Iterator[tuple[str, str, type, dict[str, float]]]:
    """(table, field, int or float, limits) of every number of the file."""
    for table, info in Design.model_fields.items():
        model = info.annotation
        if not (isinstance(model, type) and issubclass(model, BaseModel)) or table == "shape":
            continue
        for field, own in model.model_fields.items():
            kinds = {own.annotation, *get_args(own.annotation)}
            kind = int if own.annotation is int else float if float in kinds else None
            if kind is None or own.annotation not in (int, float):
                continue
            limits = {
                name: float(getattr(rule, name))
                for rule in own.metadata
                for name in ("gt", "ge", "lt", "le")
                if getattr(rule, name, None) is not None
            }
            yield table, field, kind, limits


def cases() -> Cases:
    """Two for each number of the file, some for its texts and lists, some for its bytes."""
    out = Cases()
    for table, field, kind, limits in _numbers():
        bad, good = _around(kind, limits)
        name, where = f"{table}.{field}", {"table": table, "field": field}
        title = f"{name} beyond its ends, and no number at all"
        out.add(title, check_beyond, "refused", bad=bad, **where)
        if good:
            ends = ", ".join(f"{g:g}" for g in good)
            out.add(f"{name} at {ends}", check_ends, "either", good=good, **where)
    for expect, texts in (("right", _accepted()), ("refused", _rejected())):
        for name, text in texts.items():
            out.add(name, check_file, expect, text=text)  # type: ignore[arg-type]
    for name in shipped_designs():
        out.add(f"shipped {name}", check_shipped, design=name)
    return out


def _around(kind: type, limits: Mapping[str, float]) -> tuple[list[Any], list[Any]]:
    """Values just beyond the limits, and those on them."""
    import math

    bad: list[Any] = [*NUMBERLESS, *MONSTERS]
    good: list[Any] = []
    for name, limit in limits.items():
        whole = kind is int
        out = -1.0 if name in ("gt", "ge") else 1.0
        beside = limit + out if whole else math.nextafter(limit, out * math.inf)
        within = limit - out if whole else math.nextafter(limit, -out * math.inf)
        strict = name in ("gt", "lt")
        bad += [int(v) if whole else v for v in (beside, *([limit] if strict else []))]
        # The least number above 0 is below what any file would say; 1e-9 is small enough.
        inner = 1e-9 if strict and limit == 0.0 and not whole else within
        good.append((int(limit) if whole else limit) if not strict else inner)
    if kind is int:
        bad.append(3.5)
    return bad, good


HEAD = 'name = "x"\n[shape]\nkind = "cylinder"\n'
SIZE = "diameter_outer_mm = 60.0\nlength_mm = 120.0\n"


def _accepted() -> dict[str, str]:
    return {
        "a design of four lines": HEAD + SIZE,
        "numbers without a point": HEAD + "diameter_outer_mm = 60\nlength_mm = 120\n",
        "numbers with an exponent": HEAD + "diameter_outer_mm = 6e1\nlength_mm = 1.2E+2\n",
        "a number in quotes": HEAD + 'diameter_outer_mm = "60.0"\nlength_mm = 120.0\n',
        "Windows line ends": (HEAD + SIZE).replace("\n", "\r\n"),
    }


def _rejected() -> dict[str, str]:
    whole = HEAD + SIZE
    explicit = whole + '[layout]\nkind = "explicit"\n'
    fixture = '[[fixtures]]\nname = "a"\n'
    box = fixture + 'kind = "box"\ncentre_mm = [0, 0, 0]\nsize_mm = [1, 1, 1]\n'
    rod = 'kind = "cylinder"\nradius_mm = 1\nfrom_mm = [0, 0, 0]\nto_mm = [0, 0, 0]\n'
    return {
        "no bytes at all": "",
        "a byte-order mark": "\xef\xbb\xbf" + whole,
        "bytes that are no text": "\xff\xfe\x00\x01",
        "a key twice": whole + "length_mm = 1.0\n",
        "cut in the middle of a line": whole[:-8] + "=",
        "no shape": 'name = "x"\n',
        "a shape of no kind": 'name = "x"\n[shape]\nlength_mm = 3\n',
        "a shape of an unknown kind": 'name = "x"\n[shape]\nkind = "torus"\n',
        "a table in place of a number": whole + "[wall.thickness_mm]\na = 1\n",
        "a number in place of a table": "camera = 3\n" + whole,
        "a list in place of a table": "camera = []\n" + whole,
        "a typing error in a key": whole + "[wall]\nthicknes_mm = 1\n",
        "a typing error in a table": whole + "[wal]\nthickness_mm = 1\n",
        "a name with a slash": whole.replace('"x"', '"../x"'),
        "a name of 65 letters": whole.replace('"x"', '"' + 65 * "x" + '"'),
        "an empty name": whole.replace('"x"', '""'),
        "a date in place of a number": HEAD + "diameter_outer_mm = 1979-05-27\n",
        "colours that are none": whole + '[layout]\ncolours = ["red"]\n',
        "no colours": whole + "[layout]\ncolours = []\n",
        "positions of a spiral": whole + "[layout]\npositions = [[1, 2]]\n",
        "explicit without positions": explicit,
        "positions of two and of three numbers": explicit + "positions = [[1, 2], [1, 2, 3]]\n",
        "a missing positions file": explicit + 'positions_csv = "no.csv"\n',
        "a missing calibration file": whole + '[camera]\ncalibration = "no.yaml"\n',
        "a missing STL file": whole + fixture + 'kind = "mesh"\nfile = "no.stl"\n',
        "13 fixtures": whole + 13 * box,
        "a rod without length": whole + fixture + rod,
        "a fixture of no kind": whole + fixture,
        "fixtures as a table": whole + "[fixtures]\na = 1\n",
        "minimum above maximum force": whole + "[training]\nforce_min_N = 30.0\n",
        "lists nested 2000 deep": whole + f"[layout]\npositions = {2000 * '['}{2000 * ']'}\n",
        "a text of a million letters": whole.replace('"x"', '"' + 10**6 * "x" + '"'),
        "a key of 100 000 letters": whole + "[wall]\n" + "a" * 100_000 + " = 1\n",
    }


CASES = cases()


@CASES.parametrize
def test_design_file(case: Case, record_property: Recorder) -> None:
    """Every number at and beyond its ends, wrong types, damaged files."""
    verify(case, record_property)
