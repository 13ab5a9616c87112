"""Mutants of a package: small changes by Cosmic Ray, less those that cannot matter.

Left out by rule: annotations, decorators, what is inside ``raise`` and f-strings (texts for
people), and operators whose mutants fail wherever they are reached (bits of real numbers).
One mutant is drawn of each place in the source, by a hash, so that the draw needs no list and stays
as it is where files do not change.
"""

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

from benchmarks.provenance import ROOT, bare_code

PACKAGES = {
    "decoder": "decoder/phytac_decoder",
    "optics": "phytac_design/optics",
    "shell": "phytac_design/mechanics/shell",
    "layout": "phytac_design/layout",
    "imaging": "phytac_design/simulation/imaging",
}
SEED = 40
OPERATORS = (
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul")),
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("Pow_Mul", "FloorDiv_Mul", "Mod_FloorDiv")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Lt_GtE", "GtE_Lt", "Gt_LtE", "LtE_Gt")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Eq_NotEq", "NotEq_Eq")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Is_IsNot", "IsNot_Is")),
    "ReplaceUnaryOperator_USub_UAdd",
    "ReplaceUnaryOperator_Delete_Not",
    "AddNot",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "NumberReplacer",
    "ZeroIterationForLoop",
)
"""Of Cosmic Ray, module ``core``."""
Position = tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One change of one file.

    Attributes
    ----------
    file : str
        Below the root.
    code : str
        Hash of the file without comments and docstrings.
    operator, occurrence : str, int
        What Cosmic Ray changes.
    first_line, last_line : int
        Of the statement up to the change; of a compound statement, its head.
    compiled : bool
        Whether a kernel holds the change, or a name that kernels may have compiled in.
    """

    file: str
    code: str
    operator: str
    occurrence: int
    first_line: int
    last_line: int
    compiled: bool

    @property
    def key(self) -> str:
        """Name of the mutant as long as the file's code is the same."""
        return f"{self.file}:{self.code}:{self.operator}:{self.occurrence}"

    def text(self) -> str:
        """Return the file with the change."""
        operator = get_operator(f"core/{self.operator}")()
        text = mutate_code((ROOT / self.file).read_text("utf-8"), operator, self.occurrence)
        if text is None:
            raise LookupError(f"{self.key}: no such place")
        return str(text)

    def change(self) -> tuple[str, str]:
        """Return the changed line before and after."""
        before, after = (ROOT / self.file).read_text("utf-8").splitlines(), self.text().splitlines()
        at = next(n for n, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
        return before[at].strip(), after[at].strip()


def draw(package: str) -> list[Mutant]:
    """Return the mutants of a package, one of each place, in the order in which they are tried."""
    ranked = sorted(
        (hashlib.sha256(f"{SEED}:{mutant.key}".encode()).hexdigest(), place, mutant)
        for path in sorted((ROOT / PACKAGES[package]).rglob("*.py"))
        for place, mutant in _mutants(path)
    )
    first: dict[tuple[str, Position], Mutant] = {}
    for _, place, mutant in ranked:
        first.setdefault((mutant.file, place), mutant)
    return list(first.values())


def _mutants(path: Path) -> Iterator[tuple[Position, Mutant]]:
    """All mutants of a file that may matter, each with its place."""
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    left_out = [_span(node) for node in _texts_and_types(tree)]
    # Between two operands, unlike the * of arguments.
    binary = [
        (_span(node.left)[1], _span(node.right)[0])
        for node in ast.walk(tree)
        if isinstance(node, ast.BinOp)
    ]
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.stmt)]
    kernels = [node for node in statements if _is_kernel(node)]
    functions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    nodes = list(ast_nodes(get_ast(text)))
    code = hashlib.sha256(bare_code(text).encode()).hexdigest()[:16]
    for name in OPERATORS:
        operator = get_operator(f"core/{name}")()
        places = (start for node in nodes for start, _ in operator.mutation_positions(node))
        for occurrence, (line, column) in enumerate(places):
            # Columns of ``ast`` count bytes.
            at = (line, len(text.splitlines()[line - 1][:column].encode()))
            if any(low <= at < high for low, high in left_out):
                continue
            if "Binary" in name and not any(low <= at < high for low, high in binary):
                continue
            around = [node for node in statements if _span(node)[0] <= at < _span(node)[1]]
            if not around:
                continue
            inside = any(isinstance(node, functions) for node in around)
            yield (
                (line, column),
                Mutant(
                    file=path.relative_to(ROOT).as_posix(),
                    code=code,
                    operator=name,
                    occurrence=occurrence,
                    first_line=max(node.lineno for node in around),
                    last_line=line,
                    compiled=any(node in kernels for node in around)
                    or (bool(kernels) and not inside),
                ),
            )


def _span(node: ast.AST) -> tuple[Position, Position]:
    """Line and byte of begin and end."""
    assert isinstance(node, ast.expr | ast.stmt)
    return (
        (node.lineno, node.col_offset),
        (node.end_lineno or node.lineno, node.end_col_offset or 0),
    )


def _texts_and_types(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes in which no change matters."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise | ast.JoinedStr):
            yield node
        if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation:
            yield node.annotation
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield from node.decorator_list
            if not isinstance(node, ast.ClassDef) and node.returns:
                yield node.returns


def _is_kernel(node: ast.stmt) -> bool:
    """Whether numba compiles a function, so that coverage does not see it."""
    return isinstance(node, ast.FunctionDef) and any(
        isinstance(each, ast.Name) and each.id == "kernel" for each in node.decorator_list
    )
