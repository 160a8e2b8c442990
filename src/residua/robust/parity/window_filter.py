"""Weighted sums over the last samples of inputs and outputs, as filters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.design.core.signals import signal_names
from residua.design.parity.relation import chain, pole_basis
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.linear.poles.pole_assignment import checked_poles
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.plant import Plant


def window_filter(
    outputs: NDArray[np.float64],
    inputs: NDArray[np.float64],
    plant: Plant,
    names: Sequence[str],
    poles: NDArray[np.complex128],
) -> StateSpace:
    r"""Return :math:`r = \sum_j (a_j z^j y + b_j z^j u) / \prod_i (z - \lambda_i)` as chains, one per residual.

    Parameters
    ----------
    outputs, inputs : ndarray, shape (residuals, order + 1, channels)
        ``a`` and ``b``, the oldest sample first.
    plant : Plant
    names : sequence of str
    poles : ndarray, shape (order,)
        All zero: the moving average itself.
    """
    basis = pole_basis(poles)
    k, n_u = outputs.shape[1] - 1, inputs.shape[2]
    M = chain(basis, k)
    powers = PolynomialBasis.powers(k + 1)
    parts = [powers.changed_to(basis, np.hstack([b, a])) for a, b in zip(outputs, inputs, strict=True)]
    count = len(parts)
    width = n_u + outputs.shape[2]
    C = np.zeros((1, k))
    C[0, k - 1 : k] = 1.0
    return StateSpace(
        scipy.linalg.block_diag(*[M] * count) if k else np.zeros((0, 0)),
        np.vstack([part[:k] for part in parts]).reshape(count * k, width),
        scipy.linalg.block_diag(*[C] * count).reshape(count, count * k),
        np.vstack([part[k:] for part in parts]),
        dt=plant.dt,
        inputs=signal_names(plant),
        outputs=names,
    )


def window_poles(poles: Sequence[complex] | None, order: int) -> NDArray[np.complex128]:
    """Return the poles of a window of samples, checked; all zero when omitted."""
    if poles is None:
        return np.zeros(order, dtype=np.complex128)
    values = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    if values.shape != (order,):
        raise DesignError(f"a window of order {order} takes {order} poles, not {values.size}")
    return checked_poles(values, sampled=True)
