"""Scaling by powers of two, so that rank decisions do not depend on the units that a model was written in.

Every scaling starts from the units of :mod:`residua.linear.systems.units`, which are the same whatever units the caller
chose, and is a function of the entries in those units only: other units, by powers of two, change no bit of a scaled
matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.systems.array_cache import cached_by_entries
from residua.linear.systems.units import (
    Units,
    bordered,
    matrix_units,
    pencil_units,
    powers_of_two,
    system_level,
    system_units,
    without_residue,
)
from residua.tolerances import RESIDUE, above_rounding

#: Couplings this far below the largest may have been scaled away.
_VANISHED = 1e-5
_SWEEPS = 60
#: Units of states further apart than this power of two come from parts without couplings both ways.
_WIDEST = 64
#: No scale leaves this range; a system that asks for it is reducible, and one part can be scaled without end.
_LARGEST = 2.0**200
#: Ratios of scales that move by more than this power of two in the second half of the sweeps will not come to rest.
_DRIFT = 4
#: Ratios of a row to its column, and of a channel to its level, from here to the inverse surely round to a factor of
#: one: those up to 1/2 and to the root of 1/2 do, and what is nearer to these than rounding is decided by logarithms.
_EVEN, _NEAR = 0.501, 0.708


@dataclass(frozen=True, eq=False)
class BalancedSystem:
    """A system in scaled units: ``A = T^-1 A0 T``, ``B = T^-1 B0 U``, ``C = Y C0 T``, ``D = Y D0 U``.

    Attributes
    ----------
    A, B, C, D : ndarray
        The scaled matrices.
    states, inputs, outputs : ndarray
        The diagonals of ``T``, ``U`` and ``Y``; all powers of two, so that scaling rounds nothing.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    states: NDArray[np.float64]
    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]


def power_of_two(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the power of two nearest to each positive number; one where it is zero."""
    x = np.asarray(x, dtype=float)
    return np.exp2(np.rint(np.log2(np.where(x > 0, x, 1.0))))


def without_rounding(*factors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the product of matrices, exactly zero where it is nothing but the rounding of its terms.

    Such entries would seem to be couplings, and balancing would take a row of them for a state in small units.
    """
    product, terms = factors[0], np.abs(factors[0])
    for factor in factors[1:]:
        product, terms = product @ factor, terms @ np.abs(factor)
    return above_rounding(product, terms.shape[1] * terms)


def sum_without_rounding(*products: tuple[NDArray[np.float64], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the sum of products of two matrices, exactly zero where it is nothing but the rounding of its terms."""
    total = np.zeros((len(products[0][0]), products[0][1].shape[1]))
    terms = total.copy()
    for first, second in products:
        total += first @ second
        terms += np.abs(first) @ np.abs(second)
    return above_rounding(total, terms)


def evened(
    W: NDArray[np.float64],
    rows: NDArray[np.float64] | None = None,
    columns: NDArray[np.float64] | None = None,
    *,
    sweeps: int = 4,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Even out the norms of rows and columns in turn, by powers of two, residue left out.

    From factors on that the caller has, or else from those of :func:`residua.linear.systems.units.matrix_units`.
    """
    if rows is None or columns is None:
        rows, columns = matrix_units(W)
    W = without_residue(W, rows, columns)
    for _ in range(sweeps):
        row_sizes = power_of_two(_lengths(rows[:, None] * W * columns, axis=1))
        rows = rows / row_sizes
        column_sizes = power_of_two(_lengths(rows[:, None] * W * columns, axis=0))
        columns = columns / column_sizes
        if (row_sizes == 1.0).all() and (column_sizes == 1.0).all():
            break  # nor does another sweep change anything
    return rows, columns


def _root(numerator: float, denominator: float) -> float:
    """Return the power of two that evens out two norms."""
    exponent = 0.5 * (math.log2(numerator) - math.log2(denominator))
    return 2.0 ** round(exponent) if abs(exponent) < 1000 else math.inf


def _length(x: NDArray[np.float64]) -> float:
    """Return the norm of a vector; called so often that the checks of ``numpy.linalg.norm`` would take longer."""
    return math.sqrt(x.dot(x))


def _lengths(M: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the norms of rows or of columns, without those checks either."""
    return np.sqrt(np.add.reduce(M * M, axis=axis))


def _largest(x: NDArray[np.float64]) -> float:
    """Return the largest entry of a vector of entries that are not negative; ``max`` would take three times longer."""
    return float(x[x.argmax()])


@cached_by_entries
def balance_system(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike) -> BalancedSystem:
    """Scale the units of states, inputs and outputs until rows and columns of ``[A B; C D]`` match in norm.

    Osborne's sweep over the states, with the rows of ``C`` and the columns of ``B`` taking part, each scaled to
    the norm of ``A``. Rows and columns that are rounding residue are left as they are. Where no scaling gives all
    rows and columns their norm, as with an input that enters several outputs and no state, the largest entries of
    rows and columns are evened out instead, which can always be done. Where the sweeps run away, because parts act on
    others one way only, the units are those that the sweeps started from: nothing holds one part beside another then,
    and they would leave of the one that lags behind nothing but rounding.

    Parameters
    ----------
    A : array_like, shape (n, n)
    B : array_like, shape (n, m)
    C : array_like, shape (p, n)
    D : array_like, shape (p, m)

    Returns
    -------
    BalancedSystem

    References
    ----------
    E. E. Osborne, On pre-conditioning of matrices, J. ACM 7 (1960) 338-345. SLICOT routine TB01ID.
    """
    A0, B0, C0, D0 = (np.asarray(M, dtype=float) for M in (A, B, C, D))
    n = len(A0)
    start = system_units(A0, B0, C0, D0)
    A, B, C, D = _in_units(A0, B0, C0, D0, start)
    W = without_residue(bordered(A, B, C, D))
    # Only couplings count in a sweep; the diagonal of A does not change with the units of the states.
    np.fill_diagonal(W[:n, :n], 0.0)
    level = _level(A0, B0, C0, D0) if _has_free_side(W, n) else 1.0
    scaled = W.copy()
    left, right, settled = _factors(scaled, n, level, _length)
    if not settled or _vanished(scaled):
        left, right, settled = _factors(W, n, level, _largest)
    u = start
    if settled and not (n and np.ptp(np.log2(right[:n])) > _WIDEST):
        T, U, Y = start.states * right[:n], start.inputs * right[n:], start.outputs * left[n:]
        # The scaled matrices are the same for states and inputs in c times larger, outputs in c times smaller units:
        # of these units those nearest to the original ones are taken; the sweeps may have drifted far away from them.
        size = np.sum(np.log2(T)) - np.sum(np.log2(Y))
        c = 2.0 ** np.round(size / max(len(T) + len(Y), 1))
        u = Units(T / c, U / c, Y * c)
    return BalancedSystem(*_in_units(A0, B0, C0, D0, u), u.states, u.inputs, u.outputs)


def _has_free_side(W: NDArray[np.float64], n: int) -> bool:
    """Tell whether there are channels, or states of which nothing is left of a row or a column, to bring to a level."""
    return W.shape != (n, n) or not (W.any(axis=0).all() and W.any(axis=1).all())


def _level(A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> float:
    """Return the power of two that the units of channels, which are free, are brought to: no units change it."""
    radius = float(np.abs(explicit_poles(A)).max(initial=0.0))
    level = max(radius, system_level(A, B, C, D))
    # off the ties: half a whole number, as logarithms of simple plants are, is rounded either way in other units
    return float(powers_of_two(np.log2(level))) if level else 1.0


def _in_units(A: NDArray, B: NDArray, C: NDArray, D: NDArray, u: Units) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return a system in units of its states, inputs and outputs."""
    T, U, Y = u.states, u.inputs, u.outputs
    return A / T[:, None] * T, B / T[:, None] * U, Y[:, None] * C * T, Y[:, None] * D * U


def _vanished(W: NDArray[np.float64]) -> bool:
    """Tell whether scaling has made a coupling nothing beside the others: no scaling evens all norms.

    Where the states are a cascade, one of them can be scaled without end, with an input and an output that take part,
    until the path to it does not count any more, and the sweeps come to rest only then.
    """
    smallest = np.min(W[W > 0], initial=np.inf)
    return bool(smallest < _VANISHED * W.max(initial=0.0))


@dataclass(frozen=True, eq=False)
class _Swept:
    """A matrix after a sweep, with the factors of its rows and columns so far."""

    W: NDArray[np.float64]
    left: NDArray[np.float64]
    right: NDArray[np.float64]

    def in_range(self, n: int) -> bool:
        """Return whether the factors of ``n`` states are within the range that sweeps leave them, the others finite."""
        factors = np.concatenate([self.left, self.right])
        states = self.right[:n]
        return bool(
            np.all((states > 1 / _LARGEST) & (states < _LARGEST)) and np.all((factors > 0) & np.isfinite(factors))
        )


def _factors(
    W: NDArray[np.float64], n: int, level: float, length: Callable[[NDArray[np.float64]], float]
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Sweep ``W`` in place; return factors of rows and of columns, and whether their ratios came to rest.

    A sweep depends on ``W`` alone, as long as no state is at the end of its range: where ``W`` comes back to what it
    was before, what the sweeps that are left will do is known.
    """
    left, right = np.ones(W.shape[0]), np.ones(W.shape[1])
    turned = W.T.copy()  # kept equal to W: the sums over a column run as fast as those over a row, in one order
    past: list[_Swept] = []
    first: dict[bytes, int] = {}
    before, free = 0, True
    while len(past) < _SWEEPS:
        moved = _scale_channels(W, left, right, n, level, length)
        if moved:
            turned[...] = W.T
        swept, held = _sweep(W, turned, left, right, n, level, length)
        if not (moved or swept):
            return left, right, True
        past.append(_Swept(W.copy(), left.copy(), right.copy()))
        free &= not held
        last = len(past) - 1
        before = first.setdefault(W.tobytes(), last)
        if free and before < last:
            ends = range(max(last + 1, _SWEEPS - (last - before)), _SWEEPS)
            free = all(_after(past, before, k).in_range(n) for k in ends)
            if free:
                break
    middle, end = (_after(past, before, k) for k in (_SWEEPS // 2 - 1, _SWEEPS - 1))
    W[...] = end.W
    # All states and inputs may drift one way and all outputs the other: the scaled matrices do not show that.
    drift = np.log2(np.concatenate([end.right / middle.right, middle.left[n:] / end.left[n:]]))
    return end.left, end.right, bool(np.ptp(drift) <= _DRIFT)


def _after(past: list[_Swept], before: int, k: int) -> _Swept:
    """Return what sweep ``k`` leaves; of one to come where the matrix is again what it was ``before``.

    The factors, powers of two, grow by the same in every round.
    """
    if k < len(past):
        return past[k]
    start, end = past[before], past[-1]
    times, rest = divmod(k - before, len(past) - 1 - before)
    like = past[before + rest]
    with np.errstate(over="ignore"):  # what overflows is out of range, and the sweeps then go on one by one
        left, right = (
            np.ldexp(own, times * (np.frexp(after / earlier)[1] - 1))
            for own, earlier, after in ((like.left, start.left, end.left), (like.right, start.right, end.right))
        )
    return _Swept(like.W, left, right)


@dataclass(frozen=True, eq=False)
class DescriptorUnits:
    """Units for ``E x' = A x + B v``, ``y = C x + D v``: ``R A S``, ``unit R E S``, ``R B V``, ``Y C S``, ``Y D V``.

    Their entries are of about one size.

    Attributes
    ----------
    equations, states, inputs, outputs : ndarray
        The diagonals of ``R``, ``S``, ``V`` and ``Y``, powers of two. Without ``E``, ``R`` is the inverse of ``S``.
    unit : float
        The unit of ``s``, a power of two; one without ``E``.
    """

    equations: NDArray[np.float64]
    states: NDArray[np.float64]
    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]
    unit: float


def descriptor_units(A: NDArray, E: NDArray | None, B: NDArray, C: NDArray, D: NDArray) -> DescriptorUnits:
    """Return units in which the rows and columns of a system, also of a descriptor system, are of one size.

    Time is scaled along with ``E``, so that its units do not matter.
    """
    n = len(A)
    if E is None:
        balanced = balance_system(A, B, C, D)
        return DescriptorUnits(1 / balanced.states, balanced.states, balanced.inputs, balanced.outputs, 1.0)
    whole = np.block([[A, B], [C, D]]).astype(float)
    dynamic = np.zeros_like(whole)
    dynamic[:n, :n] = E
    u = pencil_units(whole, dynamic)
    W = np.abs(whole) + u.unit * np.abs(dynamic)
    rows, columns = evened(W, u.rows, u.columns)
    return DescriptorUnits(rows[:n], columns[:n], columns[n:], rows[n:], u.unit)


def state_units(A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return the balanced units of the states of a system."""
    D = np.zeros((np.shape(C)[0], np.shape(B)[1])) if D is None else D
    return balance_system(A, B, C, D).states


def _sweep(
    W: NDArray[np.float64],
    turned: NDArray[np.float64],
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    n: int,
    level: float,
    length: Callable[[NDArray[np.float64]], float],
) -> tuple[bool, bool]:
    """Even out row and column of each of the first ``n`` indices, in place.

    Return whether anything moved, and whether something was held back that would have left the range of scales. A
    state that nothing sees, or nothing drives, has one side only, which is brought to ``level``.
    """
    moved = held = False
    for i, (of_row, of_column) in enumerate(zip(W[:n], turned[:n], strict=True)):
        row, column = length(of_row), length(of_column)
        if _EVEN * column < row < column / _EVEN:
            continue
        f = _root(row, column) if row and column else _root(row or level, column or level) ** 2
        if f != 1.0 and not 1 / _LARGEST < right[i] * f < _LARGEST:
            held = True
        elif f != 1.0:
            moved = True
            of_row /= f
            turned[:, i] /= f
            of_column *= f
            W[:, i] *= f
            left[i] /= f
            right[i] *= f
    return moved, held


def _scale_channels(
    W: NDArray[np.float64],
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    n: int,
    level: float,
    length: Callable[[NDArray[np.float64]], float],
) -> bool:
    """Bring the rows of outputs and the columns of inputs of ``W`` to one norm, in place."""
    moved = False
    low, high = _NEAR * level, level / _NEAR
    for axis, factors, block in ((1, left, W[n:]), (0, right, W[:, n:])):
        if not block.size:
            continue
        norms = block.max(axis=axis) if length is _largest else _lengths(block, axis)
        if all(low < norm < high or not norm for norm in norms.tolist()):
            continue
        real = norms > RESIDUE * norms.max(initial=0.0)
        f = np.where(real, power_of_two(level / np.where(real, norms, level)), 1.0)
        moved |= bool((f != 1.0).any())
        block *= f[:, None] if axis else f
        factors[n:] *= f
    return moved
