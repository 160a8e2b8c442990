"""What a residual generator lets through on other models than its own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.errors import ModelError
from residua.plant import Plant
from residua.plant.input_output_model import InputOutputModel
from residua.robust.parity.expected_signals import ExpectedSignals, Sizes
from residua.robust.parity.plant_variants import plant_family


def model_spread(
    generator: ResidualGenerator,
    plants: Iterable[Plant | InputOutputModel],
    *,
    inputs: Sizes | None = None,
    disturbances: Sizes | None = None,
    correlation_time: float = 0.0,
    noise: bool = False,
) -> NDArray[np.float64]:
    r"""Return the root mean square of the fault-free residuals of a generator on each of several models.

    Inputs and disturbances are random with their sizes, as for :func:`multi_model_parity`; the mean square is that
    of the stationary filter driven by the plant, from its Lyapunov equation.

    Parameters
    ----------
    generator : ResidualGenerator
        Sampled, of any design.
    plants : sequence of Plant or InputOutputModel
        Stable models with the inputs and outputs of the generator's plant.
    inputs, disturbances : number, sequence, mapping of str to float, or covariance matrix, optional
        Expected root mean squares, or the covariance; one when omitted.
    correlation_time : float
        Seconds over which inputs and disturbances stay alike; white when zero.
    noise : bool
        Whether the noise of the plants counts too.

    Returns
    -------
    ndarray, shape (models, residuals)

    Raises
    ------
    ModelError
        If the signals do not fit.
    DesignError
        If a model is not stable.

    Notes
    -----
    Assumes: the models are linear and time-invariant, and no fault acts.

    References
    ----------
    Gertler (1991), eq. (6-2).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.8]], [[1.0]], [[1.0]], dt=1.0)
    >>> other = rs.Plant([[0.7]], [[1.0]], [[1.0]], dt=1.0)
    >>> rs.design.model_spread(rs.design.parity_relations(plant), [plant, other]).round(4)
    array([[0.  ],
           [0.14]])
    """
    family = plant_family(plants)
    own = generator.plant
    for i, one in enumerate(family):
        if (one.inputs, one.outputs, one.dt) != (own.inputs, own.outputs, generator.dt):
            raise ModelError(f"model {i} has other inputs, outputs or another step than the generator")
    expected = ExpectedSignals(inputs, disturbances, None, correlation_time, noise)
    spread = [expected.driven(one).spread_of(generator.system, f"model {i}") for i, one in enumerate(family)]
    return np.array(spread)
