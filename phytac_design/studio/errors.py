"""From the text of a refusal to the controls that it speaks of."""

import re
from collections import Counter
from typing import Any

WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*(?:\.[A-Za-z][A-Za-z0-9_]*)*")


def error_body(text: str, paths: list[str]) -> dict[str, Any]:
    """A refusal as JSON: its text, and for each control that it names the sentence that does.

    Fields are named in full (``layout.rows``) or by their last word where only one table has it.
    """
    known = set(paths)
    last = Counter(path.rsplit(".", 1)[-1] for path in paths)
    short = {
        path.rsplit(".", 1)[-1]: path
        for path in paths
        if last[path.rsplit(".", 1)[-1]] == 1 and "_" in path.rsplit(".", 1)[-1]
    }
    fields: dict[str, str] = {}
    for sentence in sentences(text, known):
        for word in WORD.findall(sentence):
            parts = word.split(".")
            found = next(
                (".".join(parts[:n]) for n in (2, 1) if ".".join(parts[:n]) in known),
                short.get(word, ""),
            )
            if found and (found not in {"name", "description"} or sentence.startswith(found)):
                fields.setdefault(found, sentence)
    return {"error": text, "fields": fields}


def sentences(text: str, known: set[str]) -> list[str]:
    """Problems of a text that lists several: each begins with the field that it is about."""
    text = text.removeprefix("the design: ")
    out: list[str] = []
    for part in text.split("; "):
        head = part.split(":")[0].split(" ")[0]
        begins = ".".join(head.split(".")[:2]) in known or part.startswith("unknown key")
        if out and not begins:
            out[-1] += f"; {part}"
        else:
            out.append(part)
    return out
