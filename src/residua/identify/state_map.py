"""The states of a model as combinations of the past, which is what every subspace method looks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.identify.hankel_factor import HankelFactor, regress
from residua.linear.subspaces.rank import range_basis


@dataclass(frozen=True, eq=False)
class StateMap:
    """Candidates for the states, the most telling first: an order takes as many of them as it says.

    Attributes
    ----------
    T : ndarray, shape (candidates, past rows x channels)
        What takes the past, in units of the factor, to states of unit mean square.
    singular_values : ndarray
        By how much each matters, as the method weights it.
    past : int
        Rows of the past.
    observability : ndarray or None, shape (future rows x outputs, candidates)
        What the states do to the outputs to come, where the method finds the dynamics from it.
    """

    T: NDArray[np.float64]
    singular_values: NDArray[np.float64]
    past: int
    observability: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class FutureByPast:
    r"""The outputs to come, explained by the past and the inputs to come.

    .. math:: Y_f = \Theta_u U_f + \Theta_z Z_p + E_f

    Attributes
    ----------
    by_past : ndarray, shape (future rows x outputs, past rows x channels)
        :math:`\Theta_z`.
    past, future : ndarray
        Columns of the factor: the past, and the outputs to come.
    given : ndarray
        A constant and the inputs to come.
    """

    by_past: NDArray[np.float64]
    past: NDArray[np.float64]
    future: NDArray[np.float64]
    given: NDArray[np.float64]


def future_by_past(factor: HankelFactor, past: int) -> FutureByPast:
    """Return the regression of the outputs to come, for windows of past and future rows."""
    later = range(past, factor.length)
    given = factor.R[:, [0, *factor.inputs(*later)]]
    z, y = factor.R[:, factor.signals(range(past))], factor.R[:, factor.outputs(*later)]
    fit = regress(y, np.hstack([given, z]))
    return FutureByPast(fit.coefficients[:, given.shape[1] :], z, y, given)


def states_of(weighted: NDArray, past: NDArray, samples: int, n_past: int) -> tuple[StateMap, NDArray[np.float64]]:
    """Return the states of unit mean square that the leading left singular vectors of ``weighted @ past'`` span.

    Also the factors by which the combinations ``U' weighted`` were divided.
    """
    U, decision = range_basis(weighted @ past.T)
    size = np.linalg.norm(U.T @ weighted @ past.T, axis=1) / np.sqrt(samples)
    return StateMap(U.T @ weighted / size[:, None], decision.singular_values, n_past, U), size
