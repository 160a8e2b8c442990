"""What every observer asks of its gain: the poles that the user lists, all beyond a margin, or the default."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.detection_filters.directional_gain import checked_options
from residua.errors import DesignError
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant


def asked(
    plant: Plant, poles: Sequence[complex] | ArrayLike | None, margin: float | None
) -> tuple[NDArray[np.complex128] | None, float | None]:
    """Return poles and a margin in the units of time of the balanced plant; a margin of a sampled one, per sample."""
    poles = list(poles) if isinstance(poles, Iterator) else poles
    poles, margin = checked_options(poles, margin)
    if isinstance(poles, Mapping):
        raise DesignError("an observer takes a list of poles; poles per fault are for the detection filters")
    rate = plant.balanced.units.rate
    if margin is not None:
        margin = margin * plant.dt if plant.is_discrete else margin / rate
    return None if poles is None else np.atleast_1d(np.asarray(np.asarray(poles) / rate, dtype=complex)), margin


def default_weights(model: BalancedPlant) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the covariances of noise by default: equal ones in balanced units, of equations and of outputs.

    Those of the algebraic equations, which count as outputs, are one.
    """
    units, T = model.units, model.derivative
    outputs = np.concatenate([units.measurement_weight, np.ones(len(model.algebra))])
    return T * units.process_weight @ T.T, np.diag(outputs)


def gain_evidence(gain: Any, rate: float) -> dict[str, Any]:
    """Return the poles of a gain, and its note, as fields of an evidence."""
    return {
        "poles": rate * np.concatenate([gain.poles, gain.fixed]),
        "requested_poles": rate * gain.requested,
        "fixed_poles": rate * gain.fixed,
        "notes": (gain.note,) if gain.note else (),
    }
