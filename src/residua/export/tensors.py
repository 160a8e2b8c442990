"""Tensors of a growing ONNX graph: constants are folded, and the rest becomes a node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.export.monitor_program import Precision

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "Add": np.add, "Sub": np.subtract, "Mul": np.multiply, "Div": np.divide, "Less": np.less,
    "LessOrEqual": np.less_equal, "Greater": np.greater, "GreaterOrEqual": np.greater_equal, "Equal": np.equal,
    "And": np.logical_and, "Or": np.logical_or, "Not": np.logical_not, "Neg": np.negative, "Sqrt": np.sqrt,
    "Abs": np.abs,
}  # fmt: skip
_COMPARISONS = {"Less", "LessOrEqual", "Greater", "GreaterOrEqual", "Equal"}


@dataclass(frozen=True, eq=False)
class Tensor:
    """A tensor: a number for each lane of the loops that it depends on.

    Attributes
    ----------
    kind : {"real", "count", "flag"}
    axes : tuple of str
        The loops, outer ones first.
    name : str
        Name of the output of a node; empty for a known value.
    known : ndarray or None
    """

    kind: str
    axes: tuple[str, ...] = ()
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


class Tensors:
    """Operations on tensors, which become nodes if a tensor is not constant.

    Parameters
    ----------
    precision : Precision
        Of real numbers.
    """

    def __init__(self, precision: Precision) -> None:
        real = np.float64 if precision.name == "double" else np.float32
        self.types: dict[str, Any] = {"real": real, "count": np.int64, "flag": np.bool_}
        self.nodes: list[Node] = []
        self.constants: dict[str, NDArray[Any]] = {}
        self._pool: dict[tuple[str, tuple[int, ...], bytes], str] = {}
        self._made = 0

    # ------------------------------------------------------------------------ making

    def known(self, kind: str, value: Any, axes: tuple[str, ...] = ()) -> Tensor:
        """Return a tensor with known values."""
        with np.errstate(over="ignore"):
            return Tensor(kind, axes, "", np.asarray(value, dtype=self.types[kind]))

    def new_name(self) -> str:
        """Return a name that no other tensor has."""
        self._made += 1
        return f"t{self._made}"

    def named(self, one: Tensor) -> str:
        """Return the name of a tensor; a known one becomes a constant of the graph."""
        return one.name if one.known is None else self.constant(one.known)

    def constant(self, value: NDArray[Any]) -> str:
        """Return the name of a constant."""
        key = (value.dtype.str, value.shape, value.tobytes())
        if key not in self._pool:
            self._pool[key] = f"c{len(self._pool)}"
            self.constants[self._pool[key]] = value
        return self._pool[key]

    def node(self, operation: str, inputs: Sequence[str], **attributes: Any) -> str:
        """Add a node with one output, and return that."""
        made = self.new_name()
        self.nodes.append(Node(operation, tuple(inputs), (made,), attributes))
        return made

    def whole(self, *values: int) -> str:
        """Return the name of a constant of axes, sizes or places."""
        return self.constant(np.array(values, dtype=np.int64))

    # -------------------------------------------------------------------- elementwise

    def aligned(self, one: Tensor, axes: tuple[str, ...]) -> Tensor:
        """Return a tensor with axes of length one for those that it lacks."""
        missing = [k for k, axis in enumerate(axes) if axis not in one.axes]
        inner = [k for k in missing if any(axis in one.axes for axis in axes[:k])]
        if not inner:  # axes that are missing on the left come by themselves
            return one
        if one.known is not None:
            shape = [one.known.shape[one.axes.index(axis)] if axis in one.axes else 1 for axis in axes]
            return Tensor(one.kind, axes, "", one.known.reshape(shape))
        return Tensor(one.kind, axes, self.node("Unsqueeze", (one.name, self.whole(*missing))))

    def apply(self, operation: str, *given: Tensor, order: Sequence[str] = ()) -> Tensor:
        """Apply an operation to each element; ``order`` is that of all loops, outer ones first."""
        axes = tuple(axis for axis in order if any(axis in one.axes for one in given))
        kind = "flag" if operation in _COMPARISONS else given[0].kind
        values = [self.aligned(one, axes) for one in given]
        known = [one.known for one in values]
        if all(value is not None for value in known):
            with np.errstate(all="ignore"):
                return self.known(kind, _OPERATIONS[operation](*known), axes)
        return Tensor(kind, axes, self.node(operation, [self.named(one) for one in values]))

    def both(self, a: Tensor, b: Tensor, order: Sequence[str]) -> Tensor:
        """Return a and b."""
        for one, other in ((a, b), (b, a)):
            if one.known is not None and one.known.ndim == 0:
                return other if one.known else one
        return self.apply("And", a, b, order=order)

    def either(self, a: Tensor, b: Tensor, order: Sequence[str]) -> Tensor:
        """Return a or b."""
        for one, other in ((a, b), (b, a)):
            if one.known is not None and one.known.ndim == 0:
                return one if one.known else other
        return self.apply("Or", a, b, order=order)

    def choice(self, test: Tensor, a: Tensor, b: Tensor, order: Sequence[str]) -> Tensor:
        """Return a if the test holds, else b; flags by logic, since runtimes do not select flags."""
        if test.known is not None and test.known.ndim == 0:
            return a if test.known else b
        if a.kind == "flag":
            other = self.apply("Not", test, order=order)
            return self.either(self.both(test, a, order), self.both(other, b, order), order)
        axes = tuple(axis for axis in order if any(axis in one.axes for one in (test, a, b)))
        names = [self.named(self.aligned(one, axes)) for one in (test, a, b)]
        return Tensor(a.kind, axes, self.node("Where", names))

    # --------------------------------------------------------------------- reductions

    def total(self, one: Tensor, axes: Sequence[str]) -> Tensor:
        """Return the sum over loops."""
        return self._reduced(one, axes, "ReduceSum", np.sum)

    def largest(self, one: Tensor, axes: Sequence[str]) -> Tensor:
        """Return the largest over loops."""
        return self._reduced(one, axes, "ReduceMax", np.max)

    def anywhere(self, one: Tensor, axes: Sequence[str]) -> Tensor:
        """Return whether a flag is set in any lane of loops."""
        if not any(axis in one.axes for axis in axes):
            return one
        if one.known is not None:
            places = tuple(one.axes.index(axis) for axis in axes if axis in one.axes)
            return self.known("flag", one.known.any(axis=places), tuple(a for a in one.axes if a not in axes))
        cast = Tensor("count", one.axes, self.node("Cast", (one.name,), to="count"))
        return self.cast(self.largest(cast, axes), "flag")

    def cast(self, one: Tensor, kind: str) -> Tensor:
        """Return a tensor as one of another kind."""
        if one.kind == kind:
            return one
        if one.known is not None:
            return self.known(kind, one.known, one.axes)
        return Tensor(kind, one.axes, self.node("Cast", (one.name,), to=kind))

    def _reduced(self, one: Tensor, axes: Sequence[str], operation: str, compute: Callable[..., Any]) -> Tensor:
        places = [one.axes.index(axis) for axis in axes if axis in one.axes]
        left = tuple(axis for axis in one.axes if axis not in axes)
        if not places:
            return one
        if one.known is not None:
            return self.known(one.kind, compute(one.known, axis=tuple(places)), left)
        if operation == "ReduceSum":  # its axes are an input, those of a maximum an attribute
            return Tensor(one.kind, left, self.node(operation, (one.name, self.whole(*places)), keepdims=0))
        return Tensor(one.kind, left, self.node(operation, (one.name,), axes=places, keepdims=0))

    # -------------------------------------------------------------------------- arrays

    def element(self, array: Tensor, place: Tensor, size: int) -> Tensor:
        """Return the elements of an array at places; places of inactive lanes are clipped."""
        if place.known is not None:
            inside = np.clip(place.known, 0, size - 1)
            if array.known is not None:
                return Tensor(array.kind, place.axes, "", array.known[inside])
            if inside.ndim == 1 and np.array_equal(inside, np.arange(size)):
                return Tensor(array.kind, place.axes, array.name)
            return Tensor(array.kind, place.axes, self.node("Gather", (array.name, self.constant(inside)), axis=0))
        names = (self.named(array), self._inside(place, size))
        return Tensor(array.kind, place.axes, self.node("Gather", names, axis=0))

    def _inside(self, place: Tensor, size: int) -> str:
        bounds = [self.constant(np.array(value, dtype=np.int64)) for value in (0, size - 1)]
        return self.node("Clip", (place.name, *bounds))

    def with_elements(self, array: Tensor, place: Tensor, value: Tensor, size: int, lanes: Sequence[int]) -> Tensor:
        """Return an array with elements replaced at places; ``lanes`` are the lengths of the axes of the places."""
        count = int(np.prod(lanes, dtype=int))
        flat = self._flat(value, place.axes, lanes)
        whole = place.known is not None and np.array_equal(place.known.ravel(), np.arange(size))
        if whole:
            return Tensor(array.kind, ("#",), flat.name, flat.known)
        if place.known is not None:
            inside = self.constant(np.clip(place.known, 0, size - 1).reshape(count))
        else:
            inside = self.node("Reshape", (self._inside(place, size), self.whole(count)))
        names = (self.named(array), inside, self.named(flat))
        return Tensor(array.kind, ("#",), self.node("ScatterElements", names, axis=0))

    def _flat(self, value: Tensor, axes: tuple[str, ...], lanes: Sequence[int]) -> Tensor:
        """Return a tensor with a number for each lane, in a row."""
        count = int(np.prod(lanes, dtype=int))
        one = self.aligned(value, axes)
        if one.known is not None:
            return Tensor(one.kind, ("#",), "", np.broadcast_to(one.known, tuple(lanes)).reshape(count))
        if value.axes != axes:
            one = Tensor(one.kind, axes, self.node("Expand", (one.name, self.whole(*lanes))))
        if len(axes) == 1:
            return Tensor(one.kind, ("#",), one.name)
        return Tensor(one.kind, ("#",), self.node("Reshape", (one.name, self.whole(count))))


__all__ = ["Node", "Tensor", "Tensors"]
