"""A small program, independent of the target: assignments to numbers and vectors, conditions, bounded loops.

It is written as text in the syntax of Python, of which only this is allowed:

- numbers, vectors and arrays of them, with the sizes as names in capitals; ``array[k]`` is an element or a row;
- arithmetic, comparisons and logic, element by element; ``sqrt`` and ``abs``;
- ``matrix @ vector``, ``vector @ matrix``, and sums of such products, which are added up from the left;
- alone on the right of an assignment: ``sum``, ``any``, ``all``, ``count``, ``largest`` (of numbers that are not
  negative) of a vector, ``where(flag, a, b)``, ``min(a, b)``, ``join(a, b)``, ``zeros(n)``, ``summed(vector, places,
  n)`` (the sums of the elements with equal places), ``pushed(row, array)`` (a row in front of an array, which loses its
  last) and ``later_sums(array)`` (for each row the sum of those behind it);
- functions without a result, which stand in the program where they are called.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from math import prod
from typing import Literal

Kind = Literal["real", "count", "flag"]
Role = Literal["constant", "input", "state", "output", "local"]
_REALS = {"sqrt", "abs", "sum", "largest", "zeros", "summed"}


@dataclass(frozen=True)
class Variable:
    """A variable of a program.

    Attributes
    ----------
    name : str
    kind : {"real", "count", "flag"}
    role : {"constant", "input", "state", "output", "local"}
    shape : tuple of int
        Empty for a single one.
    values : tuple
        Of a constant, row by row.
    words : str
        Description.
    """

    name: str
    kind: Kind
    role: Role
    shape: tuple[int, ...] = ()
    values: tuple[float, ...] = ()
    words: str = ""

    @property
    def size(self) -> int | None:
        """Number of elements of an array; ``None`` for a single one."""
        return prod(self.shape) if self.shape else None


@dataclass(frozen=True)
class Section:
    """Statements that belong together.

    Attributes
    ----------
    title : str
    statements : tuple of ast.stmt
        Over vectors.
    loops : tuple of ast.stmt
        The same over single elements, for languages without vectors.
    """

    title: str
    statements: tuple[ast.stmt, ...]
    loops: tuple[ast.stmt, ...]


@dataclass(frozen=True)
class Program:
    """Program for each sample.

    Attributes
    ----------
    variables : tuple of Variable
        Those that occur in it, inputs and outputs always.
    sections : tuple of Section
    others : tuple of Variable
        Those that occur at most in the statements over vectors.
    """

    variables: tuple[Variable, ...]
    sections: tuple[Section, ...] = field(repr=False)
    others: tuple[Variable, ...] = field(default=(), repr=False)

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
        nodes = (node for part in self.sections for one in part.loops for node in ast.walk(one))
        return sorted({node.target.id for node in nodes if isinstance(node, ast.For)})  # pyright: ignore


def program(
    text: str, calls: Sequence[tuple[str, str]], sizes: Mapping[str, int], variables: Sequence[Variable]
) -> Program:
    """Return a program.

    Parameters
    ----------
    text : str
        Functions.
    calls : sequence of (str, str)
        Titles, and the calls that stand under them.
    sizes : mapping of str to int
        Values of the names in capitals.
    variables : sequence of Variable
        All but locals.
    """
    functions = {one.name: one for one in ast.parse(text).body if isinstance(one, ast.FunctionDef)}
    given: dict[str, ast.expr] = {name: ast.Constant(size) for name, size in sizes.items()}
    known, sections = {one.name: one for one in variables}, []
    for title, call in calls:
        statements = _Reduced(given, functions).block(ast.parse(call).body)
        _declare_locals(statements, known)
        loops = _Reduced({}, {}).block(_Loops(known).block(statements))
        if loops:
            sections.append(Section(title, tuple(statements), tuple(loops)))
    nodes = (node for part in sections for one in part.loops for node in ast.walk(one))
    used = {node.id for node in nodes if isinstance(node, ast.Name)}
    kept = tuple(one for one in known.values() if one.role in ("input", "output") or one.name in used)
    return Program(kept, tuple(sections), tuple(one for one in known.values() if one not in kept))


class _Reduced(ast.NodeTransformer):
    """Statements with calls replaced by their functions, and names by numbers; what is known then is folded."""

    def __init__(self, given: Mapping[str, ast.expr], functions: Mapping[str, ast.FunctionDef]) -> None:
        self._given, self._functions = given, functions

    def block(self, statements: Sequence[ast.stmt]) -> list[ast.stmt]:
        """Return the reduced statements."""
        return [left for one in statements for left in self._left(one)]

    def _left(self, one: ast.stmt) -> list[ast.stmt]:
        if isinstance(one, ast.Expr):
            call = one.value
            assert isinstance(call, ast.Call)
            function = self._functions[called(call)]
            arguments = zip((argument.arg for argument in function.args.args), map(self.visit, call.args), strict=True)
            return _Reduced({**self._given, **dict(arguments)}, self._functions).block(deepcopy(function.body))
        if isinstance(one, ast.If):
            test = self.visit(one.test)
            if isinstance(test, ast.Constant):
                return self.block(one.body if test.value else one.orelse)
            body, other = self.block(one.body), self.block(one.orelse)
            if not body:
                test, body, other = ast.UnaryOp(ast.Not(), test), other, []
            return [ast.If(test, body, other)] if body else []
        if isinstance(one, ast.For):
            assert isinstance(one.iter, ast.Call)
            bound, body = self.visit(one.iter.args[0]), self.block(one.body)
            return [ast.For(one.target, ast.Call(one.iter.func, [bound], []), body, [])] if body and bound.value else []
        assert isinstance(one, ast.Assign), ast.dump(one)
        return [ast.Assign([self.visit(target) for target in one.targets], self.visit(one.value))]

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace a size by its number, and a parameter by its argument."""
        return self._given.get(node.id, node)

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


def called(node: ast.expr) -> str:
    """Return the name of a called function; empty for anything else."""
    return node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""


def parts_of(node: ast.expr) -> tuple[str, list[ast.expr]]:
    """Return the name of a variable or an element of it, and the indices."""
    places: list[ast.expr] = []
    while isinstance(node, ast.Subscript):
        places.insert(0, node.slice)
        node = node.value
    assert isinstance(node, ast.Name), ast.dump(node)
    return node.id, places


def kind_of(node: ast.expr, known: Mapping[str, Variable]) -> Kind:
    """Return the kind of an expression: a real number, a count, or a flag."""
    if isinstance(node, (ast.Name, ast.Subscript)):
        name, _ = parts_of(node)
        return known[name].kind if name in known else "count"
    if isinstance(node, ast.BinOp):
        return "real" if "real" in (kind_of(node.left, known), kind_of(node.right, known)) else "count"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return kind_of(node.operand, known)
    if isinstance(node, ast.Call):
        name = called(node)
        if name in _REALS:
            return "real"
        return "count" if name == "count" else "flag" if name in ("any", "all") else kind_of(node.args[-1], known)
    if isinstance(node, ast.Constant) and not isinstance(node.value, bool):
        return "real" if isinstance(node.value, float) else "count"
    return "flag"


def shape_of(node: ast.expr, known: Mapping[str, Variable]) -> tuple[int, ...]:
    """Return the shape of an expression."""
    if isinstance(node, (ast.Name, ast.Subscript)):
        name, places = parts_of(node)
        whole = known[name].shape if name in known else ()
        return (shape_of(places[0], known) if places else ()) + whole[len(places) :]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        left, right = shape_of(node.left, known), shape_of(node.right, known)
        return (*left[:-1], *right[1:])
    name, given = called(node), [one for one in ast.iter_child_nodes(node) if isinstance(one, ast.expr)]
    if name in ("sum", "any", "all", "count", "largest"):
        return ()
    if name in ("zeros", "summed"):
        size = _whole(given[-1])
        assert size is not None
        return (size,)
    if name:
        given = given[1:]
    shapes = [shape_of(one, known) for one in given]
    if name == "join":
        return (sum(one[0] for one in shapes),)
    return max(shapes, key=len, default=())


def _declare_locals(statements: Sequence[ast.stmt], known: dict[str, Variable]) -> None:
    """Add the variables that are only assigned to, as locals of the kind and shape of their first value."""
    for one in statements:
        if isinstance(one, ast.Assign):
            name, places = parts_of(one.targets[0])
            if name not in known:
                assert not places, name
                known[name] = Variable(name, kind_of(one.value, known), "local", shape_of(one.value, known))
        elif isinstance(one, (ast.If, ast.For)):
            _declare_locals([*one.body, *one.orelse], known)


class _Loops:
    """Statements over vectors as loops over single elements; sums run from the first element to the last."""

    def __init__(self, known: dict[str, Variable]) -> None:
        self._known = known

    def block(self, statements: Sequence[ast.stmt]) -> list[ast.stmt]:
        """Return the statements without vectors."""
        lines: list[ast.stmt] = []
        for new in (new for one in statements for new in self._statement(one)):
            if lines and _go_together(lines[-1], new):
                lines[-1].body += new.body  # pyright: ignore[reportAttributeAccessIssue]
            else:
                lines.append(new)
        return lines

    def _statement(self, one: ast.stmt) -> list[ast.stmt]:
        if isinstance(one, ast.If):
            return [ast.If(one.test, self.block(one.body), self.block(one.orelse))]
        if isinstance(one, ast.For):
            return [ast.For(one.target, one.iter, self.block(one.body), [])]
        assert isinstance(one, ast.Assign)
        (target,) = one.targets
        shapes = shape_of(target, self._known), shape_of(one.value, self._known)
        assert shapes[1] in ((), shapes[0]), f"{ast.unparse(one)}: {shapes}"
        form = getattr(self, f"_{called(one.value)}", None)
        if form is not None:
            assert isinstance(one.value, ast.Call)
            return form(target, *one.value.args)
        return self._each(target, lambda at: self._value(self._at(target, at), one.value, at))

    # ---------------------------------------------------------------------- elements

    def _each(self, target: ast.expr, make: Callable[[ast.expr | None], list[ast.stmt]]) -> list[ast.stmt]:
        """Return statements for each element of a vector, or for a number."""
        shape = shape_of(target, self._known)
        return [_loop("i", prod(shape), make(ast.Name("i")))] if shape else make(None)

    def _at(self, node: ast.expr, *at: ast.expr | None) -> ast.expr:
        """Return an element of an expression; of an array the one at a row and a column."""
        if isinstance(node, (ast.Name, ast.Subscript)):
            name, places = parts_of(node)
            shape = self._known[name].shape if name in self._known else ()
            if not shape:
                return node
            if places and shape_of(places[0], self._known):  # a vector of places
                return ast.Subscript(ast.Name(name), ast.Constant(0) if shape == (1,) else self._at(places[0], *at))
            left = len(shape) - len(places)
            flat, *inner = [*(self._at(one) for one in places), *(one for one in at[:left] if one is not None)]
            for size, place in zip(shape[len(shape) - len(inner) :], inner, strict=True):
                flat = _sum(ast.BinOp(flat, ast.Mult(), ast.Constant(size)), place)
            return ast.Subscript(ast.Name(name), flat)
        if isinstance(node, ast.BinOp):
            return ast.BinOp(self._at(node.left, *at), node.op, self._at(node.right, *at))
        if isinstance(node, ast.Compare):
            return ast.Compare(self._at(node.left, *at), node.ops, [self._at(node.comparators[0], *at)])
        if isinstance(node, ast.BoolOp):
            return ast.BoolOp(node.op, [self._at(one, *at) for one in node.values])
        if isinstance(node, ast.UnaryOp):
            return ast.UnaryOp(node.op, self._at(node.operand, *at))
        if isinstance(node, ast.Call):
            return ast.Call(node.func, [self._at(one, *at) for one in node.args], [])
        return node

    def _value(self, target: ast.expr, node: ast.expr, at: ast.expr | None) -> list[ast.stmt]:
        """Return the assignment of a value, with its products of matrices added up term by term."""
        products: list[ast.BinOp] = []
        while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add) and _is_product(node.right):
            products.insert(0, node.right)  # pyright: ignore[reportArgumentType]
            node = node.left
        if _is_product(node):
            products.insert(0, node)  # pyright: ignore[reportArgumentType]
            node = ast.Constant(0.0)
        if not products:
            return [_assign(target, self._at(node, at))]
        total = self._local("dot")
        lines: list[ast.stmt] = [_assign(total, self._at(node, at))]
        for one in products:
            left, right, j = one.left, one.right, ast.Name("j")
            first = len(shape_of(left, self._known)) == 2
            entry = self._at(left, at, j) if first else self._at(right, j, at)
            factor = self._at(right if first else left, j)
            (length,) = shape_of(right if first else left, self._known)
            lines.append(_loop("j", length, [_assign(total, _sum(total, ast.BinOp(factor, ast.Mult(), entry)))]))
        return [*lines, _assign(target, total)]

    def _local(self, name: str) -> ast.Name:
        self._known.setdefault(name, Variable(name, "real", "local"))
        return ast.Name(name)

    # ------------------------------------------------------------------------- forms

    def _over(self, target: ast.expr, start: float, vector: ast.expr, make: Callable[[ast.expr], ast.stmt]):
        (length,) = shape_of(vector, self._known)
        return [_assign(target, ast.Constant(start)), _loop("i", length, [make(self._at(vector, ast.Name("i")))])]

    def _sum(self, target: ast.expr, vector: ast.expr) -> list[ast.stmt]:
        return self._over(target, 0.0, vector, lambda one: _assign(target, _sum(target, one)))

    def _any(self, target: ast.expr, vector: ast.expr) -> list[ast.stmt]:
        return self._over(target, False, vector, lambda one: ast.If(one, [_assign(target, ast.Constant(True))], []))

    def _all(self, target: ast.expr, vector: ast.expr) -> list[ast.stmt]:
        wrong = [_assign(target, ast.Constant(False))]
        return self._over(target, True, vector, lambda one: ast.If(ast.UnaryOp(ast.Not(), one), wrong, []))

    def _count(self, target: ast.expr, vector: ast.expr) -> list[ast.stmt]:
        more = [_assign(target, _sum(target, ast.Constant(1)))]
        return self._over(target, 0, vector, lambda one: ast.If(one, more, []))

    def _largest(self, target: ast.expr, vector: ast.expr) -> list[ast.stmt]:
        return self._over(
            target, 0.0, vector, lambda one: ast.If(_compared(one, ast.Gt(), target), [_assign(target, one)], [])
        )

    def _where(self, target: ast.expr, flag: ast.expr, a: ast.expr, b: ast.expr) -> list[ast.stmt]:
        def chosen(at: ast.expr | None) -> list[ast.stmt]:
            place = self._at(target, at)
            lines = [(place, self._at(one, at)) for one in (a, b)]
            then, other = ([_assign(*line)] if ast.unparse(line[0]) != ast.unparse(line[1]) else [] for line in lines)
            return [ast.If(self._at(flag, at), then, other)]

        return self._each(target, chosen)

    def _min(self, target: ast.expr, a: ast.expr, b: ast.expr) -> list[ast.stmt]:
        def smaller(at: ast.expr | None) -> list[ast.stmt]:
            place, most = self._at(target, at), self._at(b, at)
            too_large = ast.If(_compared(place, ast.Gt(), most), [_assign(place, most)], [])
            return [_assign(place, self._at(a, at)), too_large]

        return self._each(target, smaller)

    def _zeros(self, target: ast.expr, size: ast.expr) -> list[ast.stmt]:
        return self._each(target, lambda at: [_assign(self._at(target, at), ast.Constant(0.0))])

    def _join(self, target: ast.expr, a: ast.expr, b: ast.expr) -> list[ast.stmt]:
        (first,), (second,) = shape_of(a, self._known), shape_of(b, self._known)
        i = ast.Name("i")
        behind = _sum(ast.Constant(first), i)
        return [
            _loop("i", first, [_assign(self._at(target, i), self._at(a, i))]),
            _loop("i", second, [_assign(self._at(target, behind), self._at(b, i))]),
        ]

    def _summed(self, target: ast.expr, vector: ast.expr, places: ast.expr, size: ast.expr) -> list[ast.stmt]:
        (length,), i = shape_of(vector, self._known), ast.Name("i")
        place = self._at(target, ast.Constant(0) if _whole(size) == 1 else self._at(places, i))
        more = _assign(place, _sum(place, self._at(vector, i)))
        return [*self._zeros(target, size), _loop("i", length, [more])]

    def _pushed(self, target: ast.expr, row: ast.expr, array: ast.expr) -> list[ast.stmt]:
        rows, *columns = shape_of(array, self._known)
        i, column = ast.Name("i"), [ast.Name("j") for _ in columns]
        below = ast.BinOp(ast.Constant(rows - 1), ast.Sub(), i)
        above = ast.BinOp(ast.Constant(rows - 2), ast.Sub(), i)

        def across(line: ast.stmt) -> ast.stmt:
            return _loop("j", columns[0], [line]) if columns else line

        moved = across(_assign(self._at(target, below, *column), self._at(array, above, *column)))
        new = _assign(self._at(target, ast.Constant(0), *column), self._at(row, *column))
        return [_loop("i", rows - 1, [moved]), across(new)]

    def _later_sums(self, target: ast.expr, array: ast.expr) -> list[ast.stmt]:
        rows, columns = shape_of(array, self._known)
        later, old, j = self._local("behind"), self._local("dot"), ast.Name("j")
        last = self._at(array, ast.Constant(rows - 1), j)
        place = self._at(array, ast.BinOp(ast.Constant(rows - 2), ast.Sub(), ast.Name("i")), j)
        back = [_assign(old, place), _assign(place, later), _assign(later, _sum(later, old))]
        start = [_assign(later, last), _assign(last, ast.Constant(0.0))]
        return [_loop("j", columns, [*start, _loop("i", rows - 1, back)])]


def _go_together(first: ast.stmt, second: ast.stmt) -> bool:
    """Tell whether two loops are one: over the same counter, and each round has elements of its own."""
    if not isinstance(first, ast.For) or not isinstance(second, ast.For):
        return False
    heads = [f"{ast.unparse(one.target)} {ast.unparse(one.iter)}" for one in (first, second)]
    if heads[0] != heads[1]:
        return False
    nodes = [[node for line in one.body for node in ast.walk(line)] for one in (first, second)]
    written = {parts_of(node.targets[0])[0] for some in nodes for node in some if isinstance(node, ast.Assign)}
    shared = set.intersection(*({node.id for node in some if isinstance(node, ast.Name)} for some in nodes)) & written
    elements = [one for some in nodes for one in some if isinstance(one, ast.Subscript) and parts_of(one)[0] in shared]
    own = all(ast.unparse(one.slice) == ast.unparse(first.target) for one in elements)
    return own and shared == {parts_of(one)[0] for one in elements}


def _is_product(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)


def _assign(target: ast.expr, value: ast.expr) -> ast.stmt:
    return ast.Assign([target], value)


def _sum(a: ast.expr, b: ast.expr) -> ast.expr:
    return ast.BinOp(a, ast.Add(), b)


def _compared(a: ast.expr, sign: ast.cmpop, b: ast.expr) -> ast.expr:
    return ast.Compare(a, [sign], [b])


def _loop(counter: str, count: int, body: list[ast.stmt]) -> ast.stmt:
    return ast.For(ast.Name(counter), ast.Call(ast.Name("range"), [ast.Constant(count)], []), body, [])


__all__ = ["Kind", "Program", "Role", "Section", "Variable", "called", "kind_of", "parts_of", "program", "shape_of"]
