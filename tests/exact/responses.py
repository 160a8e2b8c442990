"""What a filter of floats does to a plant of floats, in balls of 200 bits or more: totals, and terms that cancel."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx
from numpy.typing import NDArray

_BITS = 200
#: What is allowed for the radius of a response beside the terms of its row, where these are none, and to how many bits
#: it is tried: a filter whose states have sizes far apart loses more than the first bits have.
_NO_FLOAT_SEES, _NOTHING_AT_ALL, _MOST_BITS = arb(2) ** -100, arb(2) ** -600, 6400
#: A response below this part of the terms that it is the sum of is none: the plant's own numbers have no more digits.
_NO_RESPONSE = 1e-13
#: What a ball is asked whether it holds.
_ZERO = acb(0)


def _matrix(M: NDArray) -> acb_mat:
    rows, columns = M.shape
    return acb_mat(rows, columns, M.ravel().tolist())


@dataclass(frozen=True, eq=False)
class _Solved:
    """A system at a point: its response, and the sizes of the solution ``X = (sE - A)^-1 B`` that it comes of."""

    M: acb_mat | None
    sizes_of_X: NDArray[np.float64] | None
    response: acb_mat
    terms: NDArray[np.float64]

    @property
    def known(self) -> bool:
        """Tell whether the balls are so narrow that what holds zero is zero, beside all else in its row."""
        height = [arb(max(row, default=0.0)) * _NO_FLOAT_SEES for row in self.terms.tolist()]
        return all(
            max(z.real.rad(), z.imag.rad()) <= max(height[i], _NOTHING_AT_ALL)
            for i, row in enumerate(self.response.tolist())
            for z in row
        )


class _System:
    """A system of balls, made once for all points."""

    def __init__(self, E: NDArray | None, A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> None:
        self.sizes_of_C, self.sizes_of_D = np.abs(C), np.abs(D)
        self.E, self.A, self.B, self.C, self.D = (_matrix(M) for M in (np.eye(len(A)) if E is None else E, A, B, C, D))

    def at(self, s: acb) -> _Solved:
        """Return a response, with the sums of the sizes of what each entry is the sum of."""
        if not (self.A.nrows() and self.B.ncols() and self.C.nrows()):
            return _Solved(None, None, self.D, self.sizes_of_D)
        M = self.E * s - self.A
        X = M.solve(self.B)
        sizes = np.abs(_floats(X))
        return _Solved(M, sizes, self.C * X + self.D, self.sizes_of_C @ sizes + self.sizes_of_D)


def _at_point(x: float, dt: float) -> acb:
    """Return a point of the imaginary axis or of the unit circle, to as many bits as are asked for."""
    angle = arb(x) * arb(dt if dt else 1.0)
    return acb(angle.cos(), angle.sin()) if dt else acb(0, arb(x))


def _evaluated(system: _System, x: float, dt: float) -> _Solved:
    """Return a system at a frequency with as many bits as its balls need, which are asked for from then on."""
    while not (found := system.at(_at_point(x, dt))).known:
        if ctx.prec >= _MOST_BITS:
            raise ArithmeticError(f"a response is not known with {ctx.prec} bits")
        ctx.prec *= 2
    return found


def _floats(M: acb_mat) -> NDArray[np.complex128]:
    """Return the middles of the balls as floats; a ball that holds zero, with a radius that no float sees, is zero."""
    entries = [0.0 if z.contains(_ZERO) else complex(z) for z in M.entries()]
    return np.array(entries, dtype=complex).reshape(M.nrows(), M.ncols())


def _made_of(found: _Solved, B: NDArray, C: NDArray) -> NDArray[np.float64]:
    """Return the sizes of what each entry of the response is made of: to its own digits, the response is not known.

    The terms of its sum, and what every number of the equations moves it by, relative to that number.
    """
    if found.M is None or found.sizes_of_X is None:
        return found.terms
    Y = np.abs(_floats(found.M.transpose().solve(_matrix(C.T)))).T
    return found.terms + Y @ (np.abs(_floats(found.M)) @ found.sizes_of_X + np.abs(B))


@dataclass(frozen=True, eq=False)
class _PlantAt:
    """A plant at a frequency, for all filters of it: the responses of the outputs and their sizes."""

    signals: acb_mat  # what controls, disturbances and faults make of controls and outputs
    sizes: NDArray[np.float64]


@lru_cache(maxsize=64)
def _plant_at(x: float, dt: float, controls: int, *entries: bytes) -> _PlantAt:
    """Return what is the same for all filters of a plant; arrays come as their shapes and bytes, which can be kept."""
    E, A, B, C, D = (_array(one) for one in entries)
    found = _evaluated(_System(E if E.size else None, A, B, C, D), x, dt)
    r, made = np.abs(_floats(found.response)), _made_of(found, B, C)
    columns = B.shape[1]
    read = [acb(i == j) for i in range(controls) for j in range(columns)]
    signals = acb_mat(controls + len(C), columns, [*read, *found.response.entries()])
    return _PlantAt(signals, np.where(r < _NO_RESPONSE * made, made, r))  # not its own rounding


def _bytes(M: NDArray | None) -> bytes:
    M = np.zeros((0, 0)) if M is None else np.ascontiguousarray(M, dtype=float)
    return np.array(M.shape, dtype=np.int64).tobytes() + M.tobytes()


def _array(entries: bytes) -> NDArray[np.float64]:
    return np.frombuffer(entries[16:]).reshape(np.frombuffer(entries[:16], dtype=np.int64))


@dataclass(frozen=True, eq=False)
class Paths:
    """Responses of residuals to controls, disturbances and faults, at some frequencies.

    ``total`` is the response, ``terms`` the sum of the sizes of what it is the sum of, ``reach`` the largest gain from
    any output to the residual times the largest response of any output, in base units. All of shape
    (frequencies, residuals, inputs). ``apart`` tells which inputs nothing connects with all outputs, and ``own``, of
    shape (residuals,), the largest response to an output of the filter itself, relative to the largest terms of one.
    """

    total: NDArray[np.complex128]
    terms: NDArray[np.float64]
    reach: NDArray[np.float64]
    controls: int
    disturbances: int
    apart: NDArray[np.bool_]
    own: NDArray[np.float64]

    def leak(self, columns: slice) -> NDArray[np.float64]:
        """Return the response relative to the terms that cancel, zero where it is rounding of what stands elsewhere."""
        total, terms, reach = (np.abs(M[:, :, columns]) for M in (self.total, self.terms, self.reach))
        ratio = total / np.where(terms > 0, terms, 1.0)
        return np.where(total > 1e-10 * reach, ratio, 0.0)

    @property
    def to_controls(self) -> slice:
        """Columns of the controls."""
        return slice(0, self.controls)

    @property
    def to_disturbances(self) -> slice:
        """Columns of the disturbances."""
        return slice(self.controls, self.controls + self.disturbances)

    @property
    def to_faults(self) -> slice:
        """Columns of the faults."""
        return slice(self.controls + self.disturbances, self.total.shape[2])


def frequencies(dt: float, rates: float = 1.0) -> list[float]:
    """Return frequencies at which no plant of small fractions has a pole."""
    if dt:
        return [x / dt for x in (0.00231, 0.1713, 1.0371, 2.7131)]
    return [x * rates for x in (0.0137, 0.2113, 1.7311, 13.371)]


@dataclass(frozen=True, eq=False)
class Scales:
    """Powers of two that take a plant to base units: a signal there is the factor times that of the plant.

    ``equations`` and ``rate`` are what the equations, and the rates in them, were multiplied by.
    """

    states: NDArray[np.float64]
    equations: NDArray[np.float64]
    outputs: NDArray[np.float64]
    inputs: NDArray[np.float64]  # controls, disturbances and faults
    rate: float

    def of_plant(self, E: NDArray | None, A: NDArray, B: NDArray, C: NDArray, D: NDArray) -> tuple[NDArray | None, ...]:
        """Return the matrices of the plant in base units."""
        left, rates = self.equations[:, None], self.rate * self.equations[:, None]
        y = self.outputs[:, None]
        whole = None if E is None else E / left / self.states
        return whole, A / rates / self.states, B / rates / self.inputs, y * C / self.states, y * D / self.inputs

    def of_filter(self, filter: Any, controls: int) -> tuple[tuple[NDArray, ...], NDArray[np.float64]]:
        """Return the matrices of a filter for that plant, its states and residuals of sizes near one, and these."""
        signals = np.concatenate([self.inputs[:controls], self.outputs])
        A, B, C, D = filter.A / self.rate, filter.B / self.rate / signals, filter.C, filter.D / signals
        x = _power_of_two(np.abs(B).max(axis=1, initial=0.0))
        r = _power_of_two(np.abs(np.hstack([C * x, D])).max(axis=1, initial=0.0))
        return (A / x[:, None] * x, B / x[:, None], C / r[:, None] * x, D / r[:, None]), r


def _power_of_two(sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the power of two below each size, one for zero."""
    return np.ldexp(1.0, np.where(sizes > 0, np.frexp(sizes)[1], 0))


def paths(filter: Any, plant: Any, y: NDArray[np.float64], w: list[float], scales: Scales | None = None) -> Paths:
    """Return the responses of a filter from controls and outputs of a plant, whose outputs have units ``y``.

    What is the same filter of the same plant in base units is evaluated once: powers of two change no digit.
    """
    B, D = np.hstack([plant.B, plant.Bd, plant.Bf]), np.hstack([plant.D, plant.Dd, plant.Df])
    if scales is None:
        scales = Scales(*(np.ones(count) for count in (len(plant.A), len(plant.A), len(D), D.shape[1])), 1.0)
    of_plant = scales.of_plant(plant.E, plant.A, B, plant.C, D)
    of_filter, residuals = scales.of_filter(filter, len(plant.inputs))
    points = tuple(x / scales.rate for x in w)
    sizes = len(plant.inputs), len(plant.disturbances)
    entries = [_bytes(M) for M in (*of_plant, *of_filter)]
    found = _paths(sizes, float(plant.dt), points, _bytes((y / scales.outputs)[None]), *entries)
    units = residuals[:, None] * scales.inputs
    return replace(found, total=units * found.total, terms=units * found.terms, reach=units * found.reach)


@lru_cache(maxsize=128)
def _paths(sizes: tuple[int, int], dt: float, w: tuple[float, ...], y: bytes, *entries: bytes) -> Paths:
    """Return the responses; arrays come as their shapes and bytes, which can be kept."""
    before, ctx.prec = ctx.prec, _BITS
    try:
        m, of_plant, units = sizes[0], entries[:5], _array(y)[0]
        A, B, C, D = (_array(one) for one in entries[5:])
        rest = _array(of_plant[2]).shape[1] - m
        total, terms, reach, own = [], [], [], []
        system = _System(None, A, B, C, D)
        for x in w:
            ctx.prec = _BITS
            at = _plant_at(x, dt, m, *of_plant)
            of_filter = _evaluated(system, x, dt)
            Q, r, rows = of_filter.response, at.sizes, of_filter.response.nrows()
            whole = Q * at.signals
            q = np.abs(_floats(Q))
            inside = (of_filter.terms[:, m:] / units).max(axis=1, initial=0.0)
            largest = (q[:, m:] / units).max(axis=1, initial=0.0)
            own.append(largest / np.where(inside > 0, inside, 1.0))
            # a control that no residual reads is no response either, though its ways cancel in the states of the filter
            made = _made_of(of_filter, B, C)[:, :m]
            direct = np.where(q[:, :m] < _NO_RESPONSE * made, made, q[:, :m])
            direct = np.hstack([direct, np.zeros((rows, rest))])
            total.append(_floats(whole))
            terms.append(direct + q[:, m:] @ r)
            reach.append(direct + np.outer(largest, (r * units[:, None]).max(axis=0, initial=0.0)))
        relative = np.array(own).max(axis=0, initial=0.0)
        return Paths(np.array(total), np.array(terms), np.array(reach), *sizes, _apart(*of_plant), relative)
    finally:
        ctx.prec = before


@lru_cache(maxsize=16)
def _apart(*entries: bytes) -> NDArray[np.bool_]:
    """Tell which inputs belong to a part of the plant that nothing connects with some of the outputs."""
    E, A, B, C, D = (_array(one) for one in entries)
    n, p = len(A), len(C)
    E = E if E.size else np.eye(n)
    linked = np.block([[(A != 0) | (E != 0), B != 0], [C != 0, D != 0]])
    near = linked @ linked.T  # equations and outputs that share a variable
    for _ in range(n + p):
        near = near @ near
    return ~np.all(near[n:] @ linked[:, n:], axis=0)
