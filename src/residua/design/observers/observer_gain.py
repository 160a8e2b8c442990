"""Options of the gain of every observer: the poles that the user lists, a margin for all, or the default."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.evidence import Evidence
from residua.errors import DesignError
from residua.linear.poles.observer_gain import ObserverGain, observer_gain
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.quotient import ObservableSplit, observable_split
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant, undetectable


def balanced_options(plant: Plant, poles: Any, margin: float | None) -> tuple[Any, float | None]:
    """Return poles, by name where they were, and a margin in the units of time of the balanced plant.

    The margin of a sampled plant is per sample.
    """
    rate = plant.balanced.units.rate
    if margin is not None:
        if isinstance(margin, bool) or not isinstance(margin, (int, float, np.number)) or not 0 < margin < np.inf:
            raise DesignError(f"margin must be a positive number in 1/s, got {margin!r}")
        if poles is not None and not isinstance(poles, Mapping):
            raise DesignError("give poles or margin, not both")
        margin = margin * plant.dt if plant.is_discrete else margin / rate
    poles = list(poles) if isinstance(poles, Iterator) else poles
    try:
        if isinstance(poles, Mapping):
            return {
                name: np.asarray(values, dtype=complex).reshape(-1) / rate for name, values in poles.items()
            }, margin
        return (None if poles is None else np.asarray(poles, dtype=complex).reshape(-1) / rate), margin
    except (TypeError, ValueError) as error:
        raise DesignError(f"poles must be numbers, or a mapping of fault name to numbers: {error}") from error


def asked(
    plant: Plant, poles: Sequence[complex] | ArrayLike | None, margin: float | None
) -> tuple[NDArray[np.complex128] | None, float | None]:
    """Return the list of poles or the margin of an observer in the units of time of the balanced plant."""
    if isinstance(poles, Mapping):
        raise DesignError("an observer takes a list of poles; poles per fault are for the detection filters")
    return balanced_options(plant, poles, margin)


def default_weights(model: BalancedPlant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the covariances of noise by default: equal ones in balanced units, of equations and of outputs.

    Those of the algebraic equations, which count as outputs, are one.
    """
    units, T = model.units, model.derivative
    outputs = np.concatenate([units.measurement_weight, np.ones(len(model.algebra))])
    return T * units.process_weight @ T.T, np.diag(outputs)


def pair_gain(
    model: BalancedPlant,
    A: NDArray,
    C: NDArray,
    noise: tuple[NDArray, NDArray],
    poles: Sequence[complex] | ArrayLike | None,
    margin: float | None,
    *,
    split: ObservableSplit | None = None,
    faint: bool = False,
) -> ObserverGain:
    """Return the gain for a pair made of a balanced plant and its noise, with poles or margin in balanced units."""
    return observer_gain(
        A,
        C,
        observable_split(A, C) if split is None else split,
        sampled=model.plant.is_discrete,
        process=noise[0],
        measurement=noise[1],
        poles=poles,
        margin=margin,
        rate=model.units.rate,
        faint=faint,
    )


def require_detectable(model: BalancedPlant, outputs: list[int] | None = None) -> None:
    """Raise where a mode that no output sees, or none of some outputs, is not stable."""
    hidden = undetectable(model, outputs)
    if hidden.size:
        raise DesignError(
            f"(C, A) is not detectable: no measurement that is used sees the mode {describe_modes(hidden)}; "
            "add a sensor that sees it"
        )


def gain_evidence(gain: Any, rate: float) -> dict[str, Any]:
    """Return the poles of a gain, and its note, as fields of an evidence."""
    return {
        "poles": rate * np.concatenate([gain.poles, gain.fixed]),
        "requested_poles": rate * gain.requested,
        "fixed_poles": rate * gain.fixed,
        "notes": (gain.note,) if gain.note else (),
    }


def with_gain(evidence: Evidence, gain: ObserverGain, model: BalancedPlant, name: str = "K") -> Evidence:
    """Return evidence with the poles of a gain, their error and its size."""
    conditions = {"pole error": gain.error, f"size of {name}": gain.norm}
    return evidence.extended(conditions=conditions, **gain_evidence(gain, model.units.rate))
