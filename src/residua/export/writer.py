"""Common parts of the writers of programs in a language."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Sequence

from residua.export.program import Program, Variable, kind_of, parts_of

#: How tightly operations bind; a logical one has parentheses around its parts, since languages differ there.
_RANK = {ast.Or: 1, ast.And: 2, ast.Compare: 3, ast.Add: 4, ast.Sub: 4, ast.Mult: 5, ast.Div: 5}
_UNARY, _ATOM = 6, 7


class Writer(ABC):
    """Statements of a program as lines of a language.

    Parameters
    ----------
    program : Program
    """

    #: Operators of comparisons, sums and logic.
    SIGNS: dict[type, str]

    def __init__(self, program: Program) -> None:
        self.program, self.variables = program, program.names

    # ----------------------------------------------------------------- of each language

    @abstractmethod
    def number(self, value: float, kind: str) -> str:
        """Return a number of a kind."""

    @abstractmethod
    def place(self, variable: Variable | None, name: str, index: str | None) -> str:
        """Return a variable, or an element of it; ``None`` for a loop counter."""

    @abstractmethod
    def assignment(self, target: str, value: str) -> str:
        """Return an assignment."""

    @abstractmethod
    def condition(self, test: str, body: list[str], other: list[str]) -> list[str]:
        """Return a condition."""

    @abstractmethod
    def loop(self, name: str, count: int, body: list[str]) -> list[str]:
        """Return a loop from 0 on, with a number of rounds."""

    @abstractmethod
    def call(self, name: str, argument: str) -> str:
        """Return a function of a number: sqrt or abs."""

    # --------------------------------------------------------------------- statements

    def block(self, statements: Sequence[ast.stmt]) -> list[str]:
        """Return the lines of statements."""
        return [line for one in statements for line in self._statement(one)]

    def _statement(self, one: ast.stmt) -> list[str]:
        if isinstance(one, ast.Assign):
            (target,) = one.targets
            kind = self._kind(target)
            return [self.assignment(self.expression(target, kind)[0], self.expression(one.value, kind)[0])]
        if isinstance(one, ast.If):
            return self.condition(self.expression(one.test, "flag")[0], self.block(one.body), self.block(one.orelse))
        assert isinstance(one, ast.For)
        assert isinstance(one.target, ast.Name)
        assert isinstance(one.iter, ast.Call)
        (bound,) = one.iter.args
        assert isinstance(bound, ast.Constant)
        assert isinstance(bound.value, int)  # sizes are numbers by now
        return self.loop(one.target.id, bound.value, self.block(one.body))

    # --------------------------------------------------------------------- expressions

    def expression(self, node: ast.expr, kind: str) -> tuple[str, int]:
        """Return an expression as text, and its precedence."""
        if isinstance(node, ast.Constant):
            if isinstance(node.value, bool):
                return self.SIGNS[ast.Constant].split()[int(node.value)], _ATOM
            assert isinstance(node.value, (int, float))
            return self.number(float(node.value), kind), _ATOM
        if isinstance(node, ast.Name):
            return self.place(self.variables.get(node.id), node.id, None), _ATOM
        if isinstance(node, ast.Subscript):
            name, (place,) = parts_of(node)
            return self.place(self.variables[name], name, self.expression(place, "count")[0]), _ATOM
        if isinstance(node, ast.Call):
            assert isinstance(node.func, ast.Name)
            return self.call(node.func.id, self.expression(node.args[0], "real")[0]), _ATOM
        return self._operation(node)

    def _kind(self, node: ast.expr) -> str:
        return kind_of(node, self.variables)

    def _operation(self, node: ast.expr) -> tuple[str, int]:
        if isinstance(node, ast.BinOp):
            kind, rank = self._kind(node), _RANK[type(node.op)]
            left, right = self._within(node.left, kind, rank), self._within(node.right, kind, rank + 1)
            return f"{left} {self.SIGNS[type(node.op)]} {right}", rank
        if isinstance(node, ast.UnaryOp):
            kind = "flag" if isinstance(node.op, ast.Not) else self._kind(node.operand)
            return f"{self.SIGNS[type(node.op)]}{self._within(node.operand, kind, _ATOM)}", _UNARY
        if isinstance(node, ast.Compare):
            other, rank = node.comparators[0], _RANK[ast.Compare]
            kind = "real" if "real" in (self._kind(node.left), self._kind(other)) else self._kind(other)
            left, right = (self._within(one, kind, rank + 1) for one in (node.left, other))
            return f"{left} {self.SIGNS[type(node.ops[0])]} {right}", rank
        assert isinstance(node, ast.BoolOp)
        parts = [self._within(one, "flag", _ATOM) for one in node.values]
        return f" {self.SIGNS[type(node.op)]} ".join(parts), _RANK[type(node.op)]

    def _within(self, node: ast.expr, kind: str, rank: int) -> str:
        """Return an expression as an operand, in parentheses if its precedence needs them."""
        text, own = self.expression(node, kind)
        return text if own >= rank else f"({text})"


def indented(lines: Sequence[str]) -> list[str]:
    """Return lines one level further in."""
    return [f"    {line}" if line else line for line in lines]


__all__ = ["Writer", "indented"]
