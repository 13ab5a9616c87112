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
from phytac_design.study.stability.bases import base, changed
from phytac_design.study.stability.case import Case, Evidence, Expect, Room
from phytac_design.study.stability.judge import unreadable
from phytac_shapes.errors import DesignError

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
        kept = read[values["table"]][values["field"]]
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


def cases() -> list[Case]:
    """Two for each number of the file, some for its texts and lists, some for its bytes."""
    out = []
    for table, field, kind, limits in _numbers():
        bad, good = _around(kind, limits)
        name = f"{table}.{field}"
        out.append(
            Case(
                room="design file",
                name=f"{name} beyond its ends, and no number at all",
                check="beyond",
                expect="refused",
                values={"table": table, "field": field, "bad": bad},
            )
        )
        if good:
            out.append(
                Case(
                    room="design file",
                    name=f"{name} at {', '.join(f'{g:g}' for g in good)}",
                    check="ends",
                    expect="either",
                    values={"table": table, "field": field, "good": good},
                )
            )
    out += [
        Case(room="design file", name=name, check="file", expect=expect, values={"text": text})
        for name, text, expect in _texts()
    ]
    out += [
        Case(room="design file", name=f"shipped {name}", check="shipped", values={"design": name})
        for name in shipped_designs()
    ]
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


def _texts() -> list[tuple[str, str, Expect]]:
    head = 'name = "x"\n[shape]\nkind = "cylinder"\n'
    size = "diameter_outer_mm = 60.0\nlength_mm = 120.0\n"
    return [
        ("a design of four lines", head + size, "right"),
        ("numbers without a point", head + "diameter_outer_mm = 60\nlength_mm = 120\n", "right"),
        (
            "numbers with an exponent",
            head + "diameter_outer_mm = 6e1\nlength_mm = 1.2E+2\n",
            "right",
        ),
        ("a number in quotes", head + 'diameter_outer_mm = "60.0"\nlength_mm = 120.0\n', "right"),
        ("Windows line ends", (head + size).replace("\n", "\r\n"), "right"),
        ("no bytes at all", "", "refused"),
        ("a byte-order mark", "\xef\xbb\xbf" + head + size, "refused"),
        ("bytes that are no text", "\xff\xfe\x00\x01", "refused"),
        ("a key twice", head + size + "length_mm = 1.0\n", "refused"),
        ("cut in the middle of a line", (head + size)[:-8] + "=", "refused"),
        ("no shape", 'name = "x"\n', "refused"),
        ("a shape of no kind", 'name = "x"\n[shape]\nlength_mm = 3\n', "refused"),
        ("a shape that nobody knows", 'name = "x"\n[shape]\nkind = "torus"\n', "refused"),
        ("a table in place of a number", head + size + "[wall.thickness_mm]\na = 1\n", "refused"),
        ("a number in place of a table", "camera = 3\n" + head + size, "refused"),
        ("a list in place of a table", "camera = []\n" + head + size, "refused"),
        ("a typing error in a key", head + size + "[wall]\nthicknes_mm = 1\n", "refused"),
        ("a typing error in a table", head + size + "[wal]\nthickness_mm = 1\n", "refused"),
        ("a name with a slash", head.replace('"x"', '"../x"') + size, "refused"),
        ("a name of 65 letters", head.replace('"x"', '"' + 65 * "x" + '"') + size, "refused"),
        ("an empty name", head.replace('"x"', '""') + size, "refused"),
        ("a date in place of a number", head + "diameter_outer_mm = 1979-05-27\n", "refused"),
        ("colours that are none", head + size + '[layout]\ncolours = ["red"]\n', "refused"),
        ("no colours", head + size + "[layout]\ncolours = []\n", "refused"),
        ("positions of a spiral", head + size + "[layout]\npositions = [[1, 2]]\n", "refused"),
        ("explicit without positions", head + size + '[layout]\nkind = "explicit"\n', "refused"),
        (
            "positions of two and of three numbers",
            head + size + '[layout]\nkind = "explicit"\npositions = [[1, 2], [1, 2, 3]]\n',
            "refused",
        ),
        (
            "a positions file that is not there",
            head + size + '[layout]\nkind = "explicit"\npositions_csv = "no.csv"\n',
            "refused",
        ),
        (
            "a calibration file that is not there",
            head + size + '[camera]\ncalibration = "no.yaml"\n',
            "refused",
        ),
        (
            "an STL file that is not there",
            head + size + '[[fixtures]]\nkind = "mesh"\nname = "a"\nfile = "no.stl"\n',
            "refused",
        ),
        (
            "13 fixtures",
            head
            + size
            + 13
            * (
                '[[fixtures]]\nkind = "box"\nname = "a"\n'
                "centre_mm = [0, 0, 0]\nsize_mm = [1, 1, 1]\n"
            ),
            "refused",
        ),
        (
            "a rod without length",
            head + size + '[[fixtures]]\nkind = "cylinder"\nname = "a"\n'
            "radius_mm = 1\nfrom_mm = [0, 0, 0]\nto_mm = [0, 0, 0]\n",
            "refused",
        ),
        ("a fixture of no kind", head + size + '[[fixtures]]\nname = "a"\n', "refused"),
        ("fixtures as a table", head + size + "[fixtures]\na = 1\n", "refused"),
        ("least above greatest force", head + size + "[training]\nforce_min_N = 30.0\n", "refused"),
        (
            "lists nested 2000 deep",
            head + size + "[layout]\npositions = " + 2000 * "[" + 2000 * "]" + "\n",
            "refused",
        ),
        (
            "a text of a million letters",
            head.replace('"x"', '"' + 10**6 * "x" + '"') + size,
            "refused",
        ),
        (
            "a million keys' worth of name",
            head + size + "[wall]\n" + "a" * 100_000 + " = 1\n",
            "refused",
        ),
    ]


ROOM = Room(
    name="design file",
    about="every number at and beyond its ends, wrong types, damaged files",
    checks={
        "beyond": check_beyond,
        "ends": check_ends,
        "file": check_file,
        "shipped": check_shipped,
    },
    cases=cases,
)
