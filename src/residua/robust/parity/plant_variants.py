"""Variants of one plant, checked to have the same signals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.design.parity.relation_model import relation_model
from residua.errors import DesignError, ModelError, SettingError
from residua.plant import Plant
from residua.plant.algebraic_equations import without_algebraic_equations
from residua.plant.input_output_model import InputOutputModel


def plant_family(
    plants: Iterable[Plant | InputOutputModel], *, insensitive_to: Iterable[str | int] | str = ()
) -> tuple[Plant, ...]:
    """Return sampled plants without ``E`` and with the same signals, the faults to ignore among their disturbances.

    Raises
    ------
    ModelError
        If there is none, or inputs, outputs, faults or steps differ.
    DesignError
        If they are continuous.
    """
    if isinstance(plants, (Plant, InputOutputModel)):
        plants = [plants]
    explicit = [relation_model(one).plant for one in plants]
    if not explicit:
        raise ModelError("give at least one plant")
    first = explicit[0]
    for i, one in enumerate(explicit):
        for what in ("inputs", "outputs", "faults", "dt"):
            if getattr(one, what) != getattr(first, what):
                raise ModelError(
                    f"model {i} has other {what} than model 0: {getattr(one, what)} instead of {getattr(first, what)}; "
                    "variants of one plant have the same signals"
                )
    if not first.is_discrete:
        raise DesignError(
            "expected sizes are those of samples, not of derivatives: sample the plants first, plant.discretize(dt)"
        )
    chosen = [first.faults[i] for i in arrays.positions(insensitive_to, first.faults, "fault")]
    plain = (one if one.E is None else without_algebraic_equations(one).explicit() for one in explicit)
    return tuple(one.faults_as_disturbances(chosen) if chosen else one for one in plain)


def probabilities(weights: Sequence[float] | None, count: int) -> NDArray[np.float64]:
    """Return the weights of the models as probabilities; equal when omitted."""
    if weights is None:
        return np.full(count, 1 / count)
    values = np.asarray(weights, dtype=float)
    if values.shape != (count,) or not np.isfinite(values).all() or np.any(values < 0) or not values.sum() > 0:
        raise SettingError(f"weights must be {count} numbers, one per model, none negative, got {weights!r}")
    return values / values.sum()
