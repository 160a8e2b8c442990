"""A small program, independent of the target: numbers, arrays of them, assignments, conditions, bounded loops.

It is written as text in the syntax of Python, of which only that part is allowed, with the sizes of arrays as names.
Once these are numbers, loops over nothing and conditions that are known are gone.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

Kind = Literal["real", "count", "flag"]
Role = Literal["constant", "input", "state", "output", "local"]


@dataclass(frozen=True)
class Variable:
    """A variable of a program.

    Attributes
    ----------
    name : str
    kind : {"real", "count", "flag"}
    role : {"constant", "input", "state", "output", "local"}
    size : int or None
        Of an array; ``None`` for a single one.
    values : tuple
        Of a constant.
    words : str
        Description.
    """

    name: str
    kind: Kind
    role: Role
    size: int | None = None
    values: tuple[float, ...] = ()
    words: str = ""


@dataclass(frozen=True)
class Section:
    """Statements that belong together.

    Attributes
    ----------
    title : str
    statements : tuple of ast.stmt
    """

    title: str
    statements: tuple[ast.stmt, ...]


@dataclass(frozen=True)
class Program:
    """Program for each sample.

    Attributes
    ----------
    variables : tuple of Variable
        Those that occur in it, inputs and outputs always.
    sections : tuple of Section
    """

    variables: tuple[Variable, ...]
    sections: tuple[Section, ...] = field(repr=False)

    def of_role(self, *roles: Role) -> list[Variable]:
        """Return the variables with given roles."""
        return [one for one in self.variables if one.role in roles]

    @property
    def names(self) -> dict[str, Variable]:
        """The variables by their names."""
        return {one.name: one for one in self.variables}

    @property
    def counters(self) -> list[str]:
        """Names of the loop counters."""
        nodes = (node for part in self.sections for one in part.statements for node in ast.walk(one))
        loops = (node.target for node in nodes if isinstance(node, ast.For))
        return sorted({target.id for target in loops if isinstance(target, ast.Name)})


def program(texts: Sequence[tuple[str, str]], sizes: Mapping[str, int], variables: Sequence[Variable]) -> Program:
    """Return a program of titles and texts, with sizes as numbers and without unreachable code."""
    sections = []
    for title, text in texts:
        statements = _Reduced(sizes).block(ast.parse(text).body)
        if statements:
            sections.append(Section(title, tuple(statements)))
    used = {
        node.id for part in sections for one in part.statements for node in ast.walk(one) if isinstance(node, ast.Name)
    }
    kept = [one for one in variables if one.role in ("input", "output") or one.name in used]
    return Program(tuple(kept), tuple(sections))


class _Reduced(ast.NodeTransformer):
    """A program with its sizes as numbers, and constant expressions folded."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        self._sizes = sizes

    def block(self, statements: Sequence[ast.stmt]) -> list[ast.stmt]:
        """Return the reduced statements."""
        return [left for one in statements for left in self._left(one)]

    def _left(self, one: ast.stmt) -> Iterator[ast.stmt]:
        if isinstance(one, ast.If):
            test = self.visit(one.test)
            if isinstance(test, ast.Constant):
                yield from self.block(one.body if test.value else one.orelse)
                return
            body, other = self.block(one.body), self.block(one.orelse)
            if body or other:
                assert body, "a condition with nothing but an else"
                yield ast.If(test, body, other)
        elif isinstance(one, ast.For):
            assert isinstance(one.iter, ast.Call)
            (bound,) = one.iter.args
            bound = self.visit(bound)
            body = self.block(one.body)
            if body and not (isinstance(bound, ast.Constant) and bound.value == 0):
                yield ast.For(one.target, ast.Call(one.iter.func, [bound], []), body, [])
        else:
            assert isinstance(one, ast.Assign), ast.dump(one)
            yield ast.Assign([self.visit(target) for target in one.targets], self.visit(one.value))

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace a size by its number."""
        return ast.Constant(self._sizes[node.id]) if node.id in self._sizes else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Fold whole numbers, and drop neutral operations on an index."""
        left, right = self.visit(node.left), self.visit(node.right)
        a, b = _whole(left), _whole(right)
        if a is not None and b is not None:
            known = {ast.Add: a + b, ast.Sub: a - b, ast.Mult: a * b}
            return ast.Constant(known[type(node.op)])
        if isinstance(node.op, ast.Mult) and 1 in (a, b):
            return right if a == 1 else left
        if isinstance(node.op, ast.Mult) and 0 in (a, b):
            return ast.Constant(0)
        if isinstance(node.op, ast.Add) and 0 in (a, b):
            return right if a == 0 else left
        return ast.BinOp(left, node.op, right)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Fold a known comparison."""
        left, right = self.visit(node.left), self.visit(node.comparators[0])
        a, b = _whole(left), _whole(right)
        if a is not None and b is not None:
            op = node.ops[0]
            known = {ast.Lt: a < b, ast.LtE: a <= b, ast.Gt: a > b, ast.GtE: a >= b, ast.Eq: a == b, ast.NotEq: a != b}
            return ast.Constant(known[type(op)])
        return ast.Compare(left, node.ops, [right])


def _whole(node: ast.expr) -> int | None:
    """Return a literal whole number; ``None`` for anything else."""
    known = isinstance(node, ast.Constant) and isinstance(node.value, int) and not isinstance(node.value, bool)
    return node.value if known else None  # pyright: ignore


__all__ = ["Kind", "Program", "Role", "Section", "Variable", "program"]
