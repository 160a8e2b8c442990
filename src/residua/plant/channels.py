"""User input per channel (numbers by position or by name, chosen channels) as checked arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import LARGEST, index_of, matrix
from residua.errors import ModelError
from residua.visible import echo

#: The roles an input of a plant can have, with the letter behind B and D of its matrices.
ROLES = {"control": "", "disturbance": "d", "fault": "f", "noise": "w"}

#: Notes on a fault besides name, kind and component.
FAULT_NOTES = ("description", "check", "unit")

#: How a fault or disturbance enters: a state vector or ``(state, output)``; ``{name: value}`` for either.
Direction = ArrayLike | tuple[ArrayLike, ArrayLike] | Mapping[str, ArrayLike]


@dataclass(frozen=True)
class OperatingPoint:
    """The constant inputs and outputs around which the model holds, in plant units.

    Attributes
    ----------
    inputs : tuple of float
        One per control input.
    outputs : tuple of float
        One per output.
    """

    inputs: tuple[float, ...]
    outputs: tuple[float, ...]


@dataclass(frozen=True)
class Fault:
    """One fault: its name, its kind and its component; and notes for the operator.

    Attributes
    ----------
    name, kind, component : str
    description : str
        Description, in a sentence.
    check : str
        First checks when it is named.
    unit : str
        Of its size: that of the numbers in its direction. Empty for a sensor or actuator fault in the unit of its
        output or input.
    """

    name: str
    kind: str
    component: str
    description: str = ""
    check: str = ""
    unit: str = ""


def number(value: object, what: str) -> float:
    """Return ``value`` as a finite float, or raise with the value."""
    try:
        if isinstance(value, (str, bytes)):
            raise TypeError
        out = float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"{what}: expected a number, got {echo(value)}") from error
    if not np.isfinite(out):
        raise ModelError(f"{what}: every number must be finite, got {out}")
    if abs(out) > LARGEST:
        raise ModelError(f"{what}: every number must be at most {LARGEST:g} in size, got {out:g}")
    return out


def channel_values(value: object, known: tuple[str, ...], default: tuple[float, ...], what: str) -> tuple[float, ...]:
    """Return one number per channel, from a vector or from ``{name: number}`` over ``default``."""
    if value is None:
        return default
    if isinstance(value, Mapping):
        out = list(default)
        for key, entry in value.items():
            out[index_of(key, known, f"{what}: channel")] = number(entry, f"{what}[{echo(key)}]")
        return tuple(out)
    column = matrix(value, what, (len(known), 1), what="one number per channel")  # pyright: ignore[reportArgumentType]
    return tuple(float(x) for x in column.ravel())


def direction(
    value: Direction, states: tuple[str, ...], outputs: tuple[str, ...], what: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the state and the output vector of a fault or disturbance."""
    is_pair = isinstance(value, tuple) and len(value) == 2 and not np.isscalar(value[0])
    state, output = value if is_pair else (value, None)  # pyright: ignore[reportGeneralTypeIssues]
    return (
        np.asarray(channel_values(state, states, (0.0,) * len(states), f"{what}, state direction")),
        np.asarray(channel_values(output, outputs, (0.0,) * len(outputs), f"{what}, output direction")),
    )


def direction_matrices(
    directions: Mapping[str, Direction], states: tuple[str, ...], outputs: tuple[str, ...], what: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the state and the output directions of several faults or disturbances, one column each."""
    pairs = [direction(value, states, outputs, f"{what} {echo(key)}") for key, value in directions.items()]
    for key, (b, d) in zip(directions, pairs, strict=True):
        if not (np.any(b) or np.any(d)):
            raise ModelError(f"{what} {echo(key)} has no effect: its direction is zero everywhere")
    if not pairs:
        return np.zeros((len(states), 0)), np.zeros((len(outputs), 0))
    return np.column_stack([b for b, _ in pairs]), np.column_stack([d for _, d in pairs])


def operating_point(point: OperatingPoint | None, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> OperatingPoint:
    """Return a checked operating point, zero when ``None``."""
    if point is None:
        return OperatingPoint((0.0,) * len(inputs), (0.0,) * len(outputs))
    if not isinstance(point, OperatingPoint):
        raise ModelError(f"operating_point must be an OperatingPoint(inputs, outputs), got {point!r}")
    if len(point.inputs) != len(inputs) or len(point.outputs) != len(outputs):
        raise ModelError(f"operating_point: expected {len(inputs)} inputs and {len(outputs)} outputs")
    return OperatingPoint(
        tuple(number(value, f"operating_point, input {i}") for i, value in enumerate(point.inputs)),
        tuple(number(value, f"operating_point, output {i}") for i, value in enumerate(point.outputs)),
    )


def channel_units(units: Mapping[str, str] | None, known: set[str]) -> dict[str, str]:
    """Return a checked copy of the units by channel name."""
    for key in units or {}:
        if key not in known:
            raise ModelError(f"units: {echo(key)} is no input, output or state of this plant")
    return dict(units or {})


def by_role(roles: list[str], channels: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return channel labels made unique by their role."""
    return [f"{role} {name}" for role in roles for name in channels[role]]
