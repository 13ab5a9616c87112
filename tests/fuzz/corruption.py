"""Corruptions of valid files, reproducible from a seed.

Texts are cut, duplicated, joined, and given tokens that break parsers. Tables (of TOML or JSON) get
values of other types and sizes, missing or duplicate keys, and names of other files.
"""

import copy
import json
import math
import random
import re
from collections.abc import Callable, Sequence
from typing import Any

NUMBERS = (
    "nan", "inf", "-inf", "-0.0", "1e308", "-1e308", "1e-320", "9" * 25, "-1", "0", "1e400",
    "0x7fffffffffffffff", "9223372036854775808", "1_000", "9" * 5000, "true", "1.5.2", "--3", "",
)  # fmt: skip
WORDS = (
    "../../../etc/passwd", "/etc/passwd", "/dev/zero", "/proc/self/mem", "..", ".", "", "a" * 5000,
    "\u202e", "\U0001f600", "\u0000", "\x1b[31m", "\ufeff", "é" * 300, "nan", "None", "{0}", "%s",
    "'; --", "\\", "C:\\nul", "~", "a/b", "near\nfar",
)  # fmt: skip
TOKENS = (
    b"\x00", b"\xff\xfe", b"\xc3\x28", b'"', b"'", b'"""', b"[", b"]", b"{", b"}", b"[[", b"]]",
    b"=", b"\n", b"\r", b",", b".", b"#", b":", b"\\u0000", b"\\", b"a.b.c = 1\n", b"[a]\n[a]\n",
    b"[" * 3000, b"{" * 3000, b"a." * 3000, b"(" * 3000, b"-", b"e999", b"\xef\xbb\xbf",
    b"1979-05-27T07:32:00Z", b"inf", b"nan", b"&a [*a]", b"!!python/object:os.system x", b"\t",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, "", "text", "near", [], {}, [[]], [1], [None], {"a": 1}, 0, 1, -1, 2, 10**9,
    2**31, 2**63, -(2**63), 10**25, 10**400, -0.0, 0.5, 1e-320, 1e308, -1e308, math.nan, math.inf,
    -math.inf, [0.0] * 2000, ["a"] * 300, [[0, 1], [1, 2]], *WORDS,
)  # fmt: skip
NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")

Change = Callable[[random.Random, bytes, Sequence[bytes]], bytes]


def _flip(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    out = bytearray(data)
    for _turn in range(rng.choice((1, 1, 2, 5, 20))):
        if out:
            out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def _span(rng: random.Random, data: bytes) -> tuple[int, int]:
    first = rng.randrange(len(data) + 1)
    return first, min(len(data), first + rng.choice((1, 4, 30, 400)))


def _drop(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    first, last = _span(rng, data)
    return data[:first] + data[last:]


def _double(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    first, last = _span(rng, data)
    return data[:last] + data[first:last] * rng.choice((1, 2, 50)) + data[last:]


def _insert(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(TOKENS) + data[at:]


def _number(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    # From a random offset, so that a large file is not searched completely.
    found = NUMBER.search(data, rng.randrange(len(data) + 1))
    if found is None:
        return data
    return data[: found.start()] + rng.choice(NUMBERS).encode() + data[found.end() :]


def _cut(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _join(rng: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


def _lines(rng: random.Random, data: bytes, _: Sequence[bytes]) -> bytes:
    """Remove, duplicate or move a line."""
    lines = data.splitlines(keepends=True)
    if not lines:
        return data
    line = lines.pop(rng.randrange(len(lines)))
    for _turn in range(rng.randrange(3)):
        lines.insert(rng.randrange(len(lines) + 1), line)
    return b"".join(lines)


CHANGES: tuple[Change, ...] = (
    _flip,
    _drop,
    _double,
    _insert,
    _number,
    _number,
    _cut,
    _join,
    _lines,
)


def changed(rng: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Apply one to three changes to bytes; ``others`` may be joined to them."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(CHANGES)(rng, data, others)
    return data


def _deep(rng: random.Random) -> Any:
    value: Any = rng.choice((1, "a", []))
    for _ in range(rng.choice((5, 60, 150))):
        value = [value] if rng.random() < 0.5 else {"a": value}
    return value


def changed_table(rng: random.Random, table: Any) -> Any:
    """Copy nested tables and lists with one to three values, keys or lengths changed."""
    out = copy.deepcopy(table)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at = out
        while True:
            inner = [value for value in _items(at) if isinstance(value, dict | list) and value]
            if not inner or rng.random() < 0.35:
                break
            at = rng.choice(inner)
        if isinstance(at, dict | list) and at:
            _corrupt(rng, at)
    return out


def _items(at: Any) -> list[Any]:
    return list(at.values()) if isinstance(at, dict) else at if isinstance(at, list) else []


def _corrupt(rng: random.Random, at: Any) -> None:
    """Change one thing of a table or list in place."""
    key = rng.choice(list(at)) if isinstance(at, dict) else rng.randrange(len(at))
    how = rng.random()
    if how < 0.6:
        at[key] = rng.choice(VALUES)
    elif how < 0.65:
        at[key] = _deep(rng)
    elif how < 0.75:
        del at[key]
    elif isinstance(at, list):
        at.extend([copy.deepcopy(at[key])] * rng.choice((1, 2, 300)))
    elif how < 0.9:
        at[rng.choice((*WORDS[:12], str(key) + "x"))] = at[key]
    else:
        at[key] = at[rng.choice(list(at))]


def json_text(table: Any) -> bytes:
    """JSON as Python writes it, NaN included."""
    try:
        return json.dumps(table).encode()
    except (ValueError, RecursionError):
        return b"[" * 100_000


def toml_text(table: dict[str, Any]) -> bytes:
    """TOML with inline tables in lists; values that TOML lacks become strings."""
    lines: list[str] = []
    try:
        _section(table, "", lines)
    except RecursionError:
        return b"a = " + b"[" * 3000
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def _section(table: dict[str, Any], name: str, lines: list[str]) -> None:
    inner = {key: value for key, value in table.items() if isinstance(value, dict)}
    lines += [f"{_text(key)} = {_value(v)}" for key, v in table.items() if key not in inner]
    for key, value in inner.items():
        place = f"{name}.{_text(key)}" if name else _text(key)
        lines.append(f"[{place}]")
        _section(value, place, lines)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return hex(value) if value > 10**300 else str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_text(key)} = {_value(v)}" for key, v in value.items()) + "}"
    return _text(str(value))


def _text(value: str) -> str:
    return json.dumps(str(value), ensure_ascii=True) if value.isascii() else f'"{value}"'
