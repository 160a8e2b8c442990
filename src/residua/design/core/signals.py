"""Recorded signals of a plant, checked and stacked, and the filters that run over them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DataError, ModelError
from residua.linear import StateSpace
from residua.plant import Plant
from residua.tolerances import SAME


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
    y_ = _numbers(y, "y")
    n_u, n_y = len(plant.inputs), plant.n_outputs
    if y_.ndim == 1 and n_y == 1:
        y_ = y_[:, None]
    if y_.ndim not in (2, 3) or y_.shape[-1] != n_y:
        raise DataError(f"y must be (time, {n_y}) with the columns {', '.join(plant.outputs)}, got shape {y_.shape}")
    if u is None:
        if n_u:
            raise DataError(f"u is missing: this plant has the inputs {', '.join(plant.inputs)}")
        return np.ascontiguousarray(y_)
    u_ = _numbers(u, "u")
    if u_.ndim == y_.ndim - 1 and n_u == 1:
        u_ = u_[..., None]
    if u_.shape != (*y_.shape[:-1], n_u):
        raise DataError(
            f"u must be {(*y_.shape[:-1], n_u)} with the columns {', '.join(plant.inputs) or 'none'} "
            f"to go with y of shape {y_.shape}, got {u_.shape}"
        )
    return np.ascontiguousarray(np.concatenate([u_, y_], axis=-1))  # columns of a table lie the other way round


def _numbers(value: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return data as floats; masked entries are missing ones."""
    try:
        if isinstance(value, np.ma.MaskedArray):
            value = np.ma.filled(value.astype(float), np.nan)
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must be an array of numbers: {error}") from error
