"""A program as tensors: loops with independent rounds run at once, all others are unrolled."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residua.export.monitor_program import MonitorProgram
from residua.export.tensors import Node, Tensor, Tensors

_BINARY = {ast.Add: "Add", ast.Sub: "Sub", ast.Mult: "Mul", ast.Div: "Div"}
_COMPARE = {ast.Lt: "Less", ast.LtE: "LessOrEqual", ast.Gt: "Greater", ast.GtE: "GreaterOrEqual", ast.Eq: "Equal"}
#: Nodes of both branches of a condition up to which both are computed and one is chosen.
_CHEAP = 24
#: Mark of a variable without a usable value: of a lane that may not have run.
_LOST = Tensor("lost")


class _CarriedError(Exception):
    """A round of a loop depends on one before it."""


class _Access(NamedTuple):
    """An element of an array that a statement reads or writes, in each lane."""

    array: str
    place: Tensor | None
    moved_by: str
    write: bool
    adds: bool


@dataclass
class _Loop:
    """A loop whose rounds are lanes."""

    axis: str
    size: int
    accesses: list[_Access] = field(default_factory=list)
    read: set[str] = field(default_factory=set)
    summed: set[str] = field(default_factory=set)


class TensorProgram:
    """A program as nodes of a graph.

    Parameters
    ----------
    made : MonitorProgram
    """

    def __init__(self, made: MonitorProgram) -> None:
        self.tensors = Tensors(made.precision)
        self._variables = made.program.names
        self._values: dict[str, Tensor] = {}
        self._depths: dict[str, int] = {}
        self._valid: dict[str, int] = {}  # how many conditions hold where a variable has a value
        self._rounds: dict[str, Tensor] = {}
        self._loops: list[_Loop] = []
        self._masks: list[Tensor] = []
        self._sequential: set[int] = set()
        self._opened = 0
        for one in made.program.variables:
            axes = () if one.size is None else ("#",)
            if one.role in ("input", "state"):
                self._values[one.name] = Tensor(one.kind, axes, f"{one.name}_now")
            elif one.role == "constant":
                values = one.values[0] if one.size is None else one.values
                self._values[one.name] = self.tensors.known(one.kind, values, axes)
            else:
                self._values[one.name] = self.tensors.known(
                    one.kind, np.zeros(() if one.size is None else one.size), axes
                )
        for part in made.program.sections:
            self._block(part.statements)

    def value(self, name: str) -> Tensor:
        """Return the final value of a variable."""
        made = self._values[name]
        assert made is not _LOST, name
        return made

    # --------------------------------------------------------------------- statements

    def _block(self, statements: Sequence[ast.stmt]) -> None:
        for one in statements:
            if isinstance(one, ast.If):
                self._condition(one)
            elif isinstance(one, ast.For):
                self._loop(one)
            else:
                assert isinstance(one, ast.Assign)
                self._assign(one.targets[0], one.value)

    def _loop(self, node: ast.For) -> None:
        assert isinstance(node.target, ast.Name)
        assert isinstance(node.iter, ast.Call)
        bound = node.iter.args[0]
        assert isinstance(bound, ast.Constant)
        count, name = int(bound.value), node.target.id  # pyright: ignore
        if id(node) not in self._sequential:
            kept = self._kept()
            try:
                self._at_once(node, name, count)
                return
            except _CarriedError:
                self._go_back(kept)
                self._sequential -= {id(one) for one in ast.walk(node)}
                self._sequential.add(id(node))
        for k in range(count):
            self._rounds[name] = self.tensors.known("count", k)
            self._block(node.body)

    def _at_once(self, node: ast.For, name: str, count: int) -> None:
        """Run all rounds of a loop at once.

        Raises
        ------
        _CarriedError
            If one may depend on another.
        """
        self._opened += 1
        loop = _Loop(f"{name}{self._opened}", count)
        self._loops.append(loop)
        self._rounds[name] = self.tensors.known("count", np.arange(count), (loop.axis,))
        self._block(node.body)
        self._check(loop)
        self._loops.pop()
        for one, depth in self._depths.items():
            if depth <= len(self._loops):
                continue
            self._depths[one] = len(self._loops)
            value = self._values[one]
            if one in self._valid:
                self._values[one] = _LOST
                del self._valid[one]
            elif loop.axis in value.axes:
                self._values[one] = self._last(value, loop)

    def _last(self, value: Tensor, loop: _Loop) -> Tensor:
        """Return the value of a variable after the last round."""
        place, axes = value.axes.index(loop.axis), tuple(axis for axis in value.axes if axis != loop.axis)
        if value.known is not None:
            return Tensor(value.kind, axes, "", np.take(value.known, -1, axis=place))
        last = self.tensors.constant(np.array(loop.size - 1, dtype=np.int64))
        return Tensor(value.kind, axes, self.tensors.node("Gather", (value.name, last), axis=place))

    def _condition(self, node: ast.If) -> None:
        test = self._expression(node.test)
        if test.known is not None and test.known.ndim == 0:
            self._block(node.body if test.known else node.orelse)
        elif self._loops:
            for mask, body in ((test, node.body), (self._not(test), node.orelse)):
                self._masks.append(mask)
                self._block(body)
                self._masks.pop()
                lost = [name for name, count in self._valid.items() if count > len(self._masks)]
                for name in lost:
                    self._values[name] = _LOST
        else:
            self._branches(test, node)

    def _branches(self, test: Tensor, node: ast.If) -> None:
        """Run one of two branches: both if they are small, with a choice of the result."""
        before, outer, results = dict(self._values), self.tensors.nodes, []
        for body in (node.body, node.orelse):
            self._values, self.tensors.nodes = dict(before), []
            self._block(body)
            results.append((self._values, self.tensors.nodes))
        self.tensors.nodes, self._values = outer, before
        (then, then_nodes), (other, other_nodes) = results
        names = [one for one in before if then[one] is not before[one] or other[one] is not before[one]]
        lost = {one for one in names if then[one] is _LOST or other[one] is _LOST}
        self._values |= dict.fromkeys(lost, _LOST)
        names = [one for one in names if one not in lost]
        if len(then_nodes) + len(other_nodes) <= _CHEAP:
            self.tensors.nodes += then_nodes + other_nodes
            self._values |= {one: self.tensors.choice(test, then[one], other[one], ("#",)) for one in names}
            return
        made = [self.tensors.new_name() for _ in names]
        branches = []
        for values, nodes in results:
            given = []
            for one in names:  # results of a branch have to be made in it
                given.append(self.tensors.new_name())
                nodes.append(Node("Identity", (self.tensors.named(values[one]),), (given[-1],), {}))
            branches.append((nodes, given))
        self.tensors.nodes.append(Node("If", (test.name,), tuple(made), {}, tuple(branches)))
        for one, name in zip(names, made, strict=True):
            self._values[one] = Tensor(before[one].kind, then[one].axes, name)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Subscript):
            self._assign_element(target, value)
            return
        assert isinstance(target, ast.Name)
        name, depth, now = target.id, self._depths.get(target.id, 0), len(self._loops)
        kind = self._variables[name].kind
        inner = self._loops[depth:]
        added = _added(target, value)
        if inner and added is not None and self._valid.get(name, 0) <= len(self._masks):
            total = self._sum(self._expression(added), inner, kind)
            self._values[name] = self._apply("Add", self._values[name], total)
            for loop in inner:
                if name in loop.read:
                    raise _CarriedError
                loop.summed.add(name)
            return
        new = self.tensors.cast(self._expression(value), kind)
        if depth == now and name not in self._valid:  # of this very lane
            self._values[name] = new if not self._masks else self._choice(self._mask(), new, self._values[name])
            return
        if any(name in loop.read or name in loop.summed for loop in inner):
            raise _CarriedError
        if not self._masks or (kind == "real" and new.known is not None):
            # under conditions it is only usable by statements under the same ones
            self._values[name], self._depths[name] = new, now
            self._valid.pop(name, None)
            if self._masks:
                self._valid[name] = len(self._masks)
            return
        self._values[name] = self._set_anywhere(name, value, new, inner)
        for loop in inner:
            loop.summed.add(name)

    def _set_anywhere(self, name: str, value: ast.expr, new: Tensor, inner: Sequence[_Loop]) -> Tensor:
        """Return a variable after lanes have set it under conditions: all to the same value, or to their number."""
        axes, old = [loop.axis for loop in inner], self._values[name]
        if new.known is not None and new.known.ndim == 0:
            return self._choice(self.tensors.anywhere(self._mask(), axes), new, old)
        counts = isinstance(value, ast.Name) and new is self._rounds.get(value.id)
        if counts and len(inner) == 1:
            least = self.tensors.known("count", -1)
            last = self.tensors.largest(self._choice(self._mask(), new, least), axes)
            return self._choice(self._apply("GreaterOrEqual", last, self.tensors.known("count", 0)), last, old)
        raise _CarriedError

    def _assign_element(self, target: ast.Subscript, value: ast.expr) -> None:
        assert isinstance(target.value, ast.Name)
        name = target.value.id
        one = self._variables[name]
        place, moved = self._place(target.slice)
        whole = place if moved is None else self._apply("Add", place, moved)
        outside = [loop for loop in self._loops if loop.axis not in whole.axes]
        added = _added(target, value)
        if outside:
            if added is None:
                raise _CarriedError  # the last round would count
            total = self._sum(self._expression(added), outside, one.kind)
            new = self._apply("Add", self._element(name, whole), total)
            for loop in outside:
                loop.summed.add(name)
        else:
            new = self.tensors.cast(self._expression(value), one.kind)
            if self._masks:
                new = self._choice(self._mask(), new, self._element(name, whole))
        lanes = [loop.size for loop in self._loops if loop.axis in whole.axes]
        assert one.size is not None
        self._values[name] = self.tensors.with_elements(self._values[name], whole, new, one.size, lanes)
        self._note(_Access(name, place, self._moved_by(target.slice, moved), True, bool(outside)))

    def _sum(self, added: Tensor, loops: Sequence[_Loop], kind: str) -> Tensor:
        """Return a sum over lanes in which conditions hold."""
        zero = self.tensors.known(kind, 0)
        held = self._choice(self._mask(), added, zero) if self._masks else added
        if any(loop.axis not in held.axes for loop in loops):
            raise _CarriedError  # the same would be added again and again
        return self.tensors.total(held, [loop.axis for loop in loops])

    # --------------------------------------------------------------------- expressions

    def _expression(self, node: ast.expr) -> Tensor:
        if isinstance(node, ast.Constant):
            kind = {bool: "flag", int: "count", float: "real"}[type(node.value)]  # pyright: ignore
            return self.tensors.known(kind, node.value)
        if isinstance(node, ast.Name):
            return self._rounds[node.id] if node.id not in self._variables else self._scalar(node.id)
        if isinstance(node, ast.Subscript):
            return self._read(node)
        if isinstance(node, ast.Call):
            assert isinstance(node.func, ast.Name)
            return self._apply({"sqrt": "Sqrt", "abs": "Abs"}[node.func.id], self._expression(node.args[0]))
        if isinstance(node, ast.BoolOp):
            made, *rest = map(self._expression, node.values)
            join = self.tensors.both if isinstance(node.op, ast.And) else self.tensors.either
            for one in rest:
                made = join(made, one, self._order)
            return made
        if isinstance(node, ast.UnaryOp):
            one = self._expression(node.operand)
            return self._not(one) if isinstance(node.op, ast.Not) else self._apply("Neg", one)
        if isinstance(node, ast.Compare):
            given = self._alike(node.left, node.comparators[0])
            if isinstance(node.ops[0], ast.NotEq):
                return self._not(self._apply("Equal", *given))
            return self._apply(_COMPARE[type(node.ops[0])], *given)
        assert isinstance(node, ast.BinOp)
        return self._apply(_BINARY[type(node.op)], *self._alike(node.left, node.right))

    def _alike(self, *nodes: ast.expr) -> list[Tensor]:
        """Return operands as numbers of one kind."""
        given = [self._expression(one) for one in nodes]
        kind = "real" if any(one.kind == "real" for one in given) else given[0].kind
        return [self.tensors.cast(one, kind) for one in given]

    def _scalar(self, name: str) -> Tensor:
        if any(name in loop.summed for loop in self._loops) or self._valid.get(name, 0) > len(self._masks):
            raise _CarriedError
        for loop in self._loops[self._depths.get(name, 0) :]:
            loop.read.add(name)
        value = self._values[name]
        if value is _LOST and self._loops:
            raise _CarriedError
        assert value is not _LOST, name
        return value

    def _read(self, node: ast.Subscript) -> Tensor:
        assert isinstance(node.value, ast.Name)
        name = node.value.id
        place, moved = self._place(node.slice)
        if any(name in loop.summed for loop in self._loops):
            raise _CarriedError
        if self._variables[name].role != "constant":
            known = moved is None or not moved.axes
            self._note(_Access(name, place if known else None, self._moved_by(node.slice, moved), False, False))
        return self._element(name, place if moved is None else self._apply("Add", place, moved))

    def _element(self, name: str, place: Tensor) -> Tensor:
        size = self._variables[name].size
        assert size is not None
        return self.tensors.element(self._values[name], place, size)

    def _place(self, node: ast.expr) -> tuple[Tensor, Tensor | None]:
        """Return the place of an element: its known part, and its offset."""
        nothing = self.tensors.known("count", 0)
        if isinstance(node, ast.BinOp):
            (left, by), (right, more) = self._place(node.left), self._place(node.right)
            known = self._apply(_BINARY[type(node.op)], left, right)
            if isinstance(node.op, ast.Mult):
                assert more is None
                return known, None if by is None else self._apply("Mul", by, right)
            assert more is None or isinstance(node.op, ast.Add)
            return known, self._apply("Add", by, more) if by is not None and more is not None else by or more
        one = self._expression(node)
        return (one, None) if one.known is not None else (nothing, one)

    def _moved_by(self, node: ast.expr, moved: Tensor | None) -> str:
        """Return a text for the offset of an element, equal only if the number is."""
        if moved is None:
            return ""
        names = sorted(one.id for one in ast.walk(node) if isinstance(one, ast.Name) and one.id in self._variables)
        return f"{ast.dump(node)} {[self._values[one].name for one in names]}"

    @property
    def _order(self) -> list[str]:
        return [loop.axis for loop in self._loops]

    def _apply(self, operation: str, *given: Tensor) -> Tensor:
        return self.tensors.apply(operation, *given, order=self._order)

    def _not(self, one: Tensor) -> Tensor:
        return self._apply("Not", one)

    def _choice(self, test: Tensor, a: Tensor, b: Tensor) -> Tensor:
        return self.tensors.choice(test, a, b, self._order)

    def _mask(self) -> Tensor:
        """Return whether all conditions hold."""
        made, *rest = self._masks
        for one in rest:
            made = self.tensors.both(made, one, self._order)
        return made

    # ------------------------------------------------------------------- dependences

    def _note(self, access: _Access) -> None:
        for loop in self._loops:
            loop.accesses.append(access)

    def _check(self, loop: _Loop) -> None:
        """Raise if a round of a loop may use values that another round writes."""
        for array in {one.array for one in loop.accesses if one.write}:
            accesses = [one for one in loop.accesses if one.array == array]
            if self._apart(loop, accesses):
                continue
            for k, one in enumerate(accesses):
                for later in accesses[k:]:
                    if (one.write or later.write) and self._clash(loop, one, later):
                        raise _CarriedError

    def _apart(self, loop: _Loop, accesses: Sequence[_Access]) -> bool:
        """Tell, by a quick test, whether each element belongs to one round of a loop alone."""
        outside = [one.axis for one in self._loops if one is not loop]
        seen = {tuple(axis for axis in outside if axis in one.place.axes) for one in accesses if one.place is not None}
        if len(seen) != 1 or len({one.moved_by for one in accesses}) != 1:
            return False
        rounds: dict[tuple[int, ...], int] = {}
        for one in accesses:
            if one.place is None or loop.axis not in one.place.axes:
                return False
            for index, element in np.ndenumerate(_known(one.place)):
                at = dict(zip(one.place.axes, index, strict=True))
                key = (*(at[axis] for axis in outside if axis in at), int(element))
                if rounds.setdefault(key, at[loop.axis]) != at[loop.axis]:
                    return False
        return True

    def _clash(self, loop: _Loop, first: _Access, second: _Access) -> bool:
        """Tell whether two accesses, in the order of the text, may meet in different rounds, in the wrong order."""
        if first.place is None or second.place is None or first.moved_by != second.moved_by:
            return True
        if first.adds and second.adds:
            return False  # sums are made at once
        for a, b in _by_rounds(first.place, second.place, loop):
            for early in range(loop.size):
                for late in range(early + 1, loop.size):
                    backward = bool(b[early] & a[late])
                    forward = bool(a[early] & b[late])
                    if backward or (forward and first.write):
                        return True
        return False

    def _kept(self) -> tuple[object, ...]:
        own = self.tensors
        loops = [(one, list(one.accesses), set(one.read), set(one.summed)) for one in self._loops]
        return (
            dict(self._values), dict(self._depths), dict(self._valid), dict(self._rounds), loops, list(self._masks),
            len(own.nodes),
        )  # fmt: skip

    def _go_back(self, kept: tuple[object, ...]) -> None:
        values, depths, valid, rounds, loops, masks, nodes = kept
        self._values, self._depths, self._valid = dict(values), dict(depths), dict(valid)  # pyright: ignore
        self._rounds, self._masks = dict(rounds), list(masks)  # pyright: ignore
        self._loops = []
        for one, accesses, read, summed in loops:  # pyright: ignore
            one.accesses, one.read, one.summed = list(accesses), set(read), set(summed)
            self._loops.append(one)
        del self.tensors.nodes[nodes:]  # pyright: ignore


def _added(target: ast.expr, value: ast.expr) -> ast.expr | None:
    """Return the term that a statement adds to a variable, if it does nothing else with it."""
    if not (isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add)):
        return None
    name = target.value if isinstance(target, ast.Subscript) else target
    assert isinstance(name, ast.Name)
    same = ast.dump(value.left).replace("Load()", "Store()") == ast.dump(target).replace("Load()", "Store()")
    used = any(isinstance(one, ast.Name) and one.id == name.id for one in ast.walk(value.right))
    return value.right if same and not used else None


def _by_rounds(a: Tensor, b: Tensor, loop: _Loop) -> Iterator[tuple[list[set[int]], list[set[int]]]]:
    """Yield for all rounds of outer loops the elements that two accesses have in each round of a loop."""
    outer = sorted({*a.axes[: _before(a, loop)], *b.axes[: _before(b, loop)]})
    sizes = {axis: size for one in (a, b) for axis, size in zip(one.axes, _known(one).shape, strict=True)}
    for at in np.ndindex(*(sizes[axis] for axis in outer)):
        fixed = dict(zip(outer, at, strict=True))
        yield _elements(a, loop, fixed), _elements(b, loop, fixed)


def _before(one: Tensor, loop: _Loop) -> int:
    """Return the number of axes outside of a loop."""
    return one.axes.index(loop.axis) if loop.axis in one.axes else 0


def _known(one: Tensor) -> NDArray[np.int64]:
    assert one.known is not None
    return one.known


def _elements(one: Tensor, loop: _Loop, fixed: dict[str, int]) -> list[set[int]]:
    """Return the elements in each round of a loop, with other loops fixed."""
    values = _known(one)[tuple(fixed.get(axis, slice(None)) for axis in one.axes)]
    left = [axis for axis in one.axes if axis not in fixed]
    if loop.axis not in left:
        return [set(values.ravel().tolist())] * loop.size
    rows = np.moveaxis(values, left.index(loop.axis), 0)
    return [set(np.ravel(row).tolist()) for row in rows]


__all__ = ["TensorProgram"]
