"""A program as the nodes of an ONNX graph: a vector is a tensor, loops are unrolled, and constants are folded."""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.export.monitor_program import MonitorProgram
from residua.export.program import Variable, called, kind_of, parts_of

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "Add": np.add, "Sub": np.subtract, "Mul": np.multiply, "Div": np.divide, "Less": np.less,
    "LessOrEqual": np.less_equal, "Greater": np.greater, "GreaterOrEqual": np.greater_equal, "Equal": np.equal,
    "And": np.logical_and, "Or": np.logical_or, "Not": np.logical_not, "Neg": np.negative, "Sqrt": np.sqrt,
    "Abs": np.abs, "Min": np.minimum, "Where": np.where, "MatMul": np.matmul,
}  # fmt: skip
_SIGNS: dict[type, str] = {
    ast.Add: "Add", ast.Sub: "Sub", ast.Mult: "Mul", ast.Div: "Div", ast.MatMult: "MatMul", ast.Lt: "Less",
    ast.LtE: "LessOrEqual", ast.Gt: "Greater", ast.GtE: "GreaterOrEqual", ast.Eq: "Equal", ast.And: "And",
    ast.Or: "Or", ast.Not: "Not", ast.USub: "Neg",
}  # fmt: skip
_FLAGS = {"Less", "LessOrEqual", "Greater", "GreaterOrEqual", "Equal", "And", "Or", "Not"}
#: Nodes of both branches of a condition up to which both are computed and one is chosen.
_CHEAP = 24


@dataclass(frozen=True, eq=False)
class Tensor:
    """A tensor.

    Attributes
    ----------
    kind : {"real", "count", "flag"}
    shape : tuple of int
    name : str
        Name of the output of a node; empty for a known value.
    known : ndarray or None
    """

    kind: str
    shape: tuple[int, ...] = ()
    name: str = ""
    known: NDArray[Any] | None = None


@dataclass(frozen=True)
class Node:
    """A node, before it is one of the ``onnx`` package.

    Attributes
    ----------
    operation : str
    inputs, outputs : tuple of str
    attributes : dict
    branches : tuple of (list of Node, list of str)
        Of a condition: the nodes of both branches, and the tensors that they give.
    """

    operation: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]
    branches: tuple[tuple[list[Node], list[str]], ...] = ()


class TensorProgram:
    """A program as nodes of a graph.

    Parameters
    ----------
    made : MonitorProgram
    """

    def __init__(self, made: MonitorProgram) -> None:
        real = np.float64 if made.precision.name == "double" else np.float32
        self._types: dict[str, Any] = {"real": real, "count": np.int64, "flag": np.bool_}
        self.nodes: list[Node] = []
        self.constants: dict[str, NDArray[Any]] = {}
        self._pool: dict[tuple[str, tuple[int, ...], bytes], str] = {}
        self._names = 0
        variables = (*made.program.others, *made.program.variables)
        self._variables: dict[str, Variable] = {one.name: one for one in variables}
        self._values: dict[str, Tensor] = {}
        for one in self._variables.values():
            if one.role in ("input", "state") and one.size != 0:
                self._values[one.name] = Tensor(one.kind, one.shape, f"{one.name}_now")
            else:
                values = one.values if one.role == "constant" else np.zeros(one.shape)
                self._values[one.name] = self._known(one.kind, np.reshape(values, one.shape))
        for part in made.program.sections:
            self._block(part.statements)

    def named(self, name: str) -> str:
        """Return the name of the final value of a variable."""
        return self._name(self._values[name])

    # ------------------------------------------------------------------------- nodes

    def _known(self, kind: str, value: Any) -> Tensor:
        with np.errstate(over="ignore"):
            array = np.asarray(value, dtype=self._types[kind])
        return Tensor(kind, array.shape, "", array)

    def _name(self, one: Tensor) -> str:
        return one.name if one.known is None else self._constant(one.known)

    def _constant(self, value: NDArray[Any]) -> str:
        key = (value.dtype.str, value.shape, value.tobytes())
        if key not in self._pool:
            self._pool[key] = f"c{len(self._pool)}"
            self.constants[self._pool[key]] = value
        return self._pool[key]

    def _whole(self, *values: int) -> str:
        """Return the name of a constant of axes, sizes or places."""
        return self._constant(np.array(values, dtype=np.int64))

    def _new_name(self) -> str:
        self._names += 1
        return f"t{self._names}"

    def _node(self, kind: str, shape: tuple[int, ...], operation: str, *inputs: str, **attributes: Any) -> Tensor:
        """Add a node, and return its output."""
        if 0 in shape:
            return self._known(kind, np.zeros(shape))
        name = self._new_name()
        self.nodes.append(Node(operation, inputs, (name,), attributes))
        return Tensor(kind, shape, name)

    def _apply(self, operation: str, *given: Tensor) -> Tensor:
        """Return the result of an operation, computed here if all is known."""
        kind = "flag" if operation in _FLAGS else given[-1].kind
        known = [one.known for one in given]
        if all(one is not None for one in known):
            with np.errstate(all="ignore"):
                return self._known(kind, _OPERATIONS[operation](*known))
        if operation == "MatMul":
            shape = (*given[0].shape[:-1], *given[1].shape[1:])
        else:
            shape = np.broadcast_shapes(*(one.shape for one in given))
        return self._node(kind, shape, operation, *map(self._name, given))

    def _joined(self, operation: str, a: Tensor, b: Tensor) -> Tensor:
        """Return a and b, or a or b."""
        for one, other in ((a, b), (b, a)):
            if one.known is not None and not one.shape:
                return other if bool(one.known) == (operation == "And") else one
        return self._apply(operation, a, b)

    def _choice(self, test: Tensor, a: Tensor, b: Tensor) -> Tensor:
        """Return a where the test holds, else b; flags by logic, since runtimes do not select flags."""
        if test.known is not None and not test.shape:
            return a if test.known else b
        if a.kind != "flag":
            return self._apply("Where", test, a, b)
        then, other = self._joined("And", test, a), self._joined("And", self._apply("Not", test), b)
        return self._joined("Or", then, other)

    def _cast(self, one: Tensor, kind: str) -> Tensor:
        if one.kind == kind:
            return one
        if one.known is not None:
            return self._known(kind, one.known)
        return self._node(kind, one.shape, "Cast", one.name, to=kind)

    def _shaped(self, one: Tensor, shape: tuple[int, ...]) -> Tensor:
        """Return a tensor of a shape to which it can be broadcast."""
        if one.shape == shape:
            return one
        if one.known is not None:
            return self._known(one.kind, np.broadcast_to(one.known, shape))
        return self._node(one.kind, shape, "Expand", one.name, self._whole(*shape))

    def _place(self, one: Tensor, size: int) -> Tensor:
        """Return a place that is inside, since the branches that are not taken are computed too."""
        if one.known is not None:
            return self._known("count", np.clip(one.known, 0, size - 1))
        bounds = (self._name(self._known("count", bound)) for bound in (0, size - 1))
        return self._node("count", one.shape, "Clip", one.name, *bounds)

    # -------------------------------------------------------------------- statements

    def _block(self, statements: Sequence[ast.stmt]) -> None:
        for one in statements:
            if isinstance(one, ast.If):
                test = self._expression(one.test)
                if test.known is not None:
                    self._block(one.body if test.known else one.orelse)
                else:
                    self._branches(test, one)
            elif isinstance(one, ast.For):
                assert isinstance(one.target, ast.Name)
                assert isinstance(one.iter, ast.Call)
                for k in range(one.iter.args[0].value):  # pyright: ignore
                    self._values[one.target.id] = self._known("count", k)
                    self._block(one.body)
            else:
                assert isinstance(one, ast.Assign)
                self._assign(one.targets[0], one.value)

    def _branches(self, test: Tensor, node: ast.If) -> None:
        """Run one of two branches: both if they are small, with a choice of the result."""
        before, outer, results = self._values, self.nodes, []
        for body in (node.body, node.orelse):
            self._values, self.nodes = dict(before), []
            self._block(body)
            results.append((self._values, self.nodes))
        self.nodes, self._values = outer, dict(before)
        (then, then_nodes), (other, other_nodes) = results
        names = [one for one in before if then[one] is not before[one] or other[one] is not before[one]]
        if len(then_nodes) + len(other_nodes) <= _CHEAP:
            self.nodes += then_nodes + other_nodes
            self._values |= {one: self._choice(test, then[one], other[one]) for one in names}
            return
        outputs, branches = tuple(self._new_name() for _ in names), []
        for values, nodes in results:
            given = [self._new_name() for _ in names]  # results of a branch have to be made in it
            nodes += [
                Node("Identity", (self._name(values[one]),), (new,), {}) for one, new in zip(names, given, strict=True)
            ]
            branches.append((nodes, given))
        self.nodes.append(Node("If", (test.name,), outputs, {}, tuple(branches)))
        for one, name in zip(names, outputs, strict=True):
            self._values[one] = Tensor(before[one].kind, before[one].shape, name)

    def _assign(self, target: ast.expr, value: ast.expr) -> None:
        name, places = parts_of(target)
        one, new = self._variables[name], self._cast(self._expression(value), self._variables[name].kind)
        if not places:
            self._values[name] = self._shaped(new, one.shape)
            return
        (place,), array = places, self._values[name]
        at = self._place(self._expression(place), one.shape[0])
        new = self._shaped(new, one.shape[1:])
        if at.known is not None and new.known is not None and array.known is not None:
            whole = array.known.copy()
            whole[at.known] = new.known
            self._values[name] = self._known(one.kind, whole)
            return
        index, row = (self._reshaped(part, shape) for part, shape in ((at, (1, 1)), (new, (1, *one.shape[1:]))))
        self._values[name] = self._node(
            one.kind, one.shape, "ScatterND", *(self._name(part) for part in (array, index, row))
        )

    def _reshaped(self, one: Tensor, shape: tuple[int, ...]) -> Tensor:
        if one.known is not None:
            return self._known(one.kind, one.known.reshape(shape))
        return self._node(one.kind, shape, "Reshape", one.name, self._whole(*shape))

    # ------------------------------------------------------------------- expressions

    def _expression(self, node: ast.expr) -> Tensor:
        if isinstance(node, ast.Constant):
            return self._known(kind_of(node, {}), node.value)
        if isinstance(node, ast.Name):
            return self._values[node.id]
        if isinstance(node, ast.Subscript):
            return self._element(self._expression(node.value), self._expression(node.slice))
        if isinstance(node, ast.Call):
            return getattr(self, f"_{called(node)}")(*map(self._expression, node.args))
        if isinstance(node, ast.BoolOp):
            first, *rest = map(self._expression, node.values)
            for one in rest:
                first = self._joined(_SIGNS[type(node.op)], first, one)
            return first
        if isinstance(node, ast.UnaryOp):
            return self._apply(_SIGNS[type(node.op)], self._expression(node.operand))
        if isinstance(node, ast.Compare):
            given = self._alike(node.left, node.comparators[0])
            if isinstance(node.ops[0], ast.NotEq):
                return self._apply("Not", self._apply("Equal", *given))
            return self._apply(_SIGNS[type(node.ops[0])], *given)
        assert isinstance(node, ast.BinOp)
        return self._apply(_SIGNS[type(node.op)], *self._alike(node.left, node.right))

    def _alike(self, *nodes: ast.expr) -> list[Tensor]:
        """Return operands as numbers of one kind."""
        given = [self._expression(one) for one in nodes]
        kind = "real" if any(one.kind == "real" for one in given) else given[0].kind
        return [self._cast(one, kind) for one in given]

    def _element(self, array: Tensor, place: Tensor) -> Tensor:
        inside = self._place(place, array.shape[0])
        if array.known is not None and inside.known is not None:
            return self._known(array.kind, array.known[inside.known])
        shape = inside.shape + array.shape[1:]
        return self._node(array.kind, shape, "Gather", self._name(array), self._name(inside), axis=0)

    def _sqrt(self, one: Tensor) -> Tensor:
        return self._apply("Sqrt", one)

    def _abs(self, one: Tensor) -> Tensor:
        return self._apply("Abs", one)

    def _min(self, a: Tensor, b: Tensor) -> Tensor:
        return self._apply("Min", a, b)

    def _where(self, test: Tensor, a: Tensor, b: Tensor) -> Tensor:
        return self._choice(test, a, b)

    def _zeros(self, size: Tensor) -> Tensor:
        assert size.known is not None
        return self._known("real", np.zeros(int(size.known)))

    def _sum(self, one: Tensor) -> Tensor:
        if one.known is not None:
            return self._known(one.kind, one.known.sum())
        return self._node(one.kind, (), "ReduceSum", one.name, self._whole(0), keepdims=0)

    def _largest(self, one: Tensor) -> Tensor:
        if one.known is not None:
            return self._known(one.kind, one.known.max(initial=0))
        return self._node(one.kind, (), "ReduceMax", one.name, axes=[0], keepdims=0)

    def _any(self, one: Tensor) -> Tensor:
        return self._cast(self._largest(self._cast(one, "count")), "flag")

    def _all(self, one: Tensor) -> Tensor:
        return self._apply("Not", self._any(self._apply("Not", one)))

    def _count(self, one: Tensor) -> Tensor:
        return self._sum(self._cast(one, "count"))

    def _join(self, *parts: Tensor) -> Tensor:
        if all(one.known is not None for one in parts):
            return self._known(parts[0].kind, np.concatenate([one.known for one in parts]))  # pyright: ignore
        filled = [one for one in parts if one.shape[0]]
        if len(filled) == 1:
            return filled[0]
        shape = (sum(one.shape[0] for one in filled), *filled[0].shape[1:])
        return self._node(filled[0].kind, shape, "Concat", *map(self._name, filled), axis=0)

    def _summed(self, vector: Tensor, places: Tensor, size: Tensor) -> Tensor:
        assert places.known is not None
        assert size.known is not None
        chosen = np.arange(int(size.known))[:, None] == places.known
        return self._apply("MatMul", self._known("real", chosen), vector)

    def _pushed(self, row: Tensor, array: Tensor) -> Tensor:
        kept = self._element(array, self._known("count", np.arange(array.shape[0] - 1)))
        return self._join(self._reshaped(row, (1, *row.shape)), kept)

    def _later_sums(self, array: Tensor) -> Tensor:
        axis = self._constant(np.array(0, dtype=np.int64))
        return self._node(array.kind, array.shape, "CumSum", self._name(array), axis, exclusive=1, reverse=1)


__all__ = ["Node", "TensorProgram"]
