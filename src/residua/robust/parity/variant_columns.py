"""What other models of a plant do otherwise, as disturbances of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residua.design.parity.relation_model import relation_model
from residua.errors import DesignError, ModelError
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel
from residua.robust.parity.expected_signals import ExpectedSignals, Sizes


def variant_columns(
    plant: Plant, variants: Sequence[Plant | InputOutputModel], inputs: Sizes | None, states: Sizes | None, time: float
) -> NDArray[np.float64]:
    r"""Return the columns :math:`[\Delta A\; \Delta B;\, \Delta C\; \Delta D]\, S` of variants, as few as they can be.

    ``S`` is a factor of the covariance of states, inputs and disturbances.

    Raises
    ------
    ModelError
        If signals, states or steps differ, or a plant has an ``E``.
    DesignError
        If sizes of states are missing for a continuous plant.
    """
    given = [relation_model(one).plant for one in variants]
    for i, one in enumerate(given):
        for what in ("inputs", "outputs", "disturbances", "n_states", "dt"):
            if getattr(one, what) != getattr(plant, what):
                raise ModelError(
                    f"variant {i} has other {what} than the plant: {getattr(one, what)} instead of "
                    f"{getattr(plant, what)}; differences of matrices need the same signals and states"
                )
    if any(one.E is not None for one in (plant, *given)):
        raise ModelError("variants are compared by their matrices: write them without E first, plant.explicit()")
    if not plant.is_discrete and states is None:
        raise DesignError(
            "a continuous plant has no stationary states under white inputs: give their sizes, states=..."
        )
    driven = ExpectedSignals(inputs, None, states, time).driven(plant)
    S = driven.begin("the plant")
    whole = np.block([[plant.A, plant.Bu, plant.Bd], [plant.C, plant.Du, plant.Dd]])
    differences = [
        (np.block([[one.A, one.Bu, one.Bd], [one.C, one.Du, one.Dd]]) - whole) @ S / np.sqrt(len(given))
        for one in given
    ]
    columns = np.hstack(differences)
    size = np.abs(columns).max(axis=1, initial=0.0)
    units = np.where(size > 0, size, 1.0)[:, None]  # states and outputs have their own
    U, s, _ = np.linalg.svd(columns / units, full_matrices=False)
    kept = s > 1e-14 * s.max(initial=0.0)
    return units * U[:, kept] * s[kept]
