"""Commands of the docs: every line of every shell block, and commands in running text."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    {
        ROOT / "README.md",
        ROOT / "exports" / "README.md",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "examples").rglob("*.md"),
    }
)
BLOCK = re.compile(r"^```(\S*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`(phytac [^`]+)`")
ASSIGNMENT = re.compile(r"[A-Z_]+=\S*")
"""An environment variable before a command."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """One command of a page, split into words as a shell does."""

    page: str
    words: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page}: {shlex.join(self.words)}"


def blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of a language."""
    return [text for kind, text in BLOCK.findall(page.read_text("utf-8")) if kind == language]


def listing(page: Path, name: str) -> str:
    """The block that a page gives for a file: it follows a line that begins with the name."""
    block = rf"^`{re.escape(name)}`[^\n]*:\n\n```\w+\n(.*?)^```"
    found = re.findall(block, page.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert len(found) == 1, name
    return str(found[0])


def commands(pages: list[Path]) -> list[Command]:
    """Every command of the shell blocks; lines joined, comments dropped, ``;`` parts one each."""
    found = []
    for page in pages:
        name = page.relative_to(ROOT).as_posix()
        for text in blocks(page, "sh"):
            for line in text.replace("\\\n", " ").splitlines():
                found += [Command(page=name, words=tuple(part)) for part in split(line)]
    return found


def split(line: str) -> list[list[str]]:
    """Words of each command of a line."""
    parser = shlex.shlex(line, posix=True, punctuation_chars=";&|")
    parser.whitespace_split = True
    parser.commenters = "#"
    parts: list[list[str]] = [[]]
    for word in parser:
        if not parts[-1] and ASSIGNMENT.fullmatch(word):
            continue
        if set(word) <= set(";&|"):
            parts.append([])
        else:
            parts[-1].append(word)
    return [part for part in parts if part]


def inline(pages: list[Path]) -> list[Command]:
    """Commands named in running text; they may be cut short."""
    return [
        Command(page=page.relative_to(ROOT).as_posix(), words=tuple(text.split()))
        for page in pages
        for text in INLINE.findall(BLOCK.sub("", page.read_text("utf-8")))
    ]
