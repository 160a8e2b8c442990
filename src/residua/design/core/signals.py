"""Recorded signals of a plant, checked and stacked, and the filters that run over them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import aligned
from residua.errors import DataError, ModelError
from residua.linear import StateSpace
from residua.linear.systems.recursion import run_side_by_side
from residua.plant import Plant
from residua.tolerances import SAME

#: Samples that are stacked at once.
_PIECE = 8192


def signal_names(plant: Plant) -> list[str]:
    """Return the names of the inputs of a filter: the plant's control inputs, then its outputs."""
    return [f"input {x}" for x in plant.inputs] + [f"output {x}" for x in plant.outputs]


def sampled_filter(system: StateSpace, plant: Plant, dt: float | None) -> StateSpace:
    """Return a filter from inputs and outputs of a plant, sampled at the step of a recording if it is continuous."""
    if not system.is_discrete:
        if dt is None:
            raise ModelError(
                "this filter is continuous: give the step of the recording, dt=..., "
                "or design for the sampled plant, plant.discretize(dt)"
            )
        return discretized_filter(system, plant, dt, "linear")
    if dt is not None and abs(dt - system.dt) > SAME * system.dt:
        raise DataError(f"the filter has dt={system.dt:g} s, the recording {dt:g} s")
    return system


def discretized_filter(system: StateSpace, plant: Plant, dt: float, hold_outputs: str) -> StateSpace:
    """Sample a filter with the control inputs held between samples."""
    return system.discretize(dt, hold=["zero"] * len(plant.inputs) + [hold_outputs] * plant.n_outputs)


def stack_signals(plant: Plant, u: ArrayLike | None, y: ArrayLike) -> NDArray[np.float64]:
    """Return ``[u, y]`` as one block with time down the rows in memory too, after checking it against the plant."""
    return stacked(*checked_signals(plant, u, y))


def stacked(u_: NDArray[np.float64] | None, y_: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``[u, y]`` of arrays that go together."""
    if u_ is None:
        return np.ascontiguousarray(y_)
    if u_.size and u_.flags.c_contiguous and y_.flags.c_contiguous:
        return _side_by_side(u_, y_)
    return np.ascontiguousarray(np.concatenate([u_, y_], axis=-1))  # columns of a table lie the other way round


def _side_by_side(u: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``[u, y]`` of arrays that lie in order: a row of each is copied as one item, in half the time."""
    out = np.empty((*u.shape[:-1], u.shape[-1] + y.shape[-1]))
    rows = out.view([(name, f"V{8 * one.shape[-1]}") for name, one in (("u", u), ("y", y))])
    for name, one in (("u", u), ("y", y)):
        rows[name] = one.view(f"V{8 * one.shape[-1]}")
    return out


def run_signals(system: StateSpace, plant: Plant, u: ArrayLike | None, y: ArrayLike, x0: Any) -> NDArray[np.float64]:
    """Run a sampled filter over signals of a plant, which are read where they lie if they lie in order."""
    u_, y_ = checked_signals(plant, u, y)
    if u_ is None or y_.shape[-2] <= _PIECE:
        return system.simulate(stack_signals(plant, u_, y_), x0)
    system = system.explicit()
    system.simulate(np.zeros((*y_.shape[:-2], 0, system.n_inputs)), x0)  # checks x0
    v, w = (one if one.ndim == 3 else one[None] for one in (u_, y_))
    start = np.zeros(system.n_states) if x0 is None else np.asarray(x0, dtype=float)
    state = np.array(np.broadcast_to(start, (len(w), system.n_states)))
    A, B, C, D = (np.ascontiguousarray(M) for M in (system.A, system.B, system.C, system.D))
    if v.flags.c_contiguous and w.flags.c_contiguous:
        return run_side_by_side((A, B, C, D), state, v, w)[1].reshape(*y_.shape[:-1], system.n_outputs)
    residuals = np.empty((*w.shape[:-1], system.n_outputs))
    step = max(1, _PIECE // max(1, len(w)))
    for k in range(0, w.shape[1], step):  # pieces stay in the cache
        parts = (np.ascontiguousarray(one[:, k : k + step]) for one in (v, w))
        state, residuals[:, k : k + step] = run_side_by_side((A, B, C, D), state, *parts)
    return residuals.reshape(*y_.shape[:-1], system.n_outputs)


def checked_signals(
    plant: Plant, u: ArrayLike | None, y: ArrayLike
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
    """Return inputs (``None`` without any) and outputs as arrays that go together, after checking them."""
    y_ = _numbers(y, "y")
    n_u, n_y = len(plant.inputs), plant.n_outputs
    if y_.ndim == 1 and n_y == 1:
        y_ = y_[:, None]
    if y_.ndim not in (2, 3) or y_.shape[-1] != n_y:
        raise DataError(f"y must be (time, {n_y}) with the columns {', '.join(plant.outputs)}, got shape {y_.shape}")
    if u is None:
        if n_u:
            raise DataError(f"u is missing: this plant has the inputs {', '.join(plant.inputs)}")
        return None, y_
    u_ = _numbers(u, "u")
    if u_.ndim == y_.ndim - 1 and n_u == 1:
        u_ = u_[..., None]
    if u_.shape != (*y_.shape[:-1], n_u):
        raise DataError(
            f"u must be {(*y_.shape[:-1], n_u)} with the columns {', '.join(plant.inputs) or 'none'} "
            f"to go with y of shape {y_.shape}, got {u_.shape}"
        )
    return u_, y_


def _numbers(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return data as floats that C can read; masked entries are missing ones."""
    try:
        if isinstance(value, np.ma.MaskedArray):
            value = np.ma.filled(value.astype(float), np.nan)
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        return aligned(np.asarray(value, dtype=float))
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must be an array of numbers: {error}") from error
