"""What a stable system settles to under constant inputs, and the spread of its outputs under white ones."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear import StateSpace
from residua.tolerances import IDENTITY, TINY

#: Windows of more samples are summed by doubling: what they cost grows with the logarithm of their length.
_LONG = 4096
#: Doublings of a covariance at most: poles as near to the circle as rounding keeps apart have settled by then.
_DOUBLINGS = 60


def steady_responses(form: StateSpace) -> NDArray[np.float64]:
    """Return what a system settles to for constant inputs of size one, exactly zero where that is rounding.

    Rounding is judged by the terms of the same response: each residual and each fault has its own units.
    """
    A, B, C = with_even_states(form)
    D = form.D
    M = (np.eye(len(A)) if form.is_discrete else 0.0) - A
    inverse = np.linalg.inv(M)
    X = inverse @ B
    gain, terms = C @ X + D, np.abs(C) @ np.abs(X) + np.abs(D)
    rounding = np.abs(C) @ (np.abs(inverse) @ (np.abs(M) @ (np.abs(inverse) @ np.abs(B))))  # of the inverse itself
    sizes = np.maximum(np.abs(B).max(axis=0, initial=0.0), np.abs(D).max(axis=0, initial=0.0))
    own = np.abs(gain) / np.where(sizes > 0, sizes, 1.0)
    left = own > 1e-15 * own.max(axis=1, keepdims=True, initial=0.0)  # a direct term may be rounding of its row
    return np.where(left & (np.abs(gain) > 1e-10 * terms + 1e-13 * rounding), gain, 0.0)


def with_even_states(form: StateSpace) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return ``A``, ``B``, ``C`` with states in units in which rows and columns of ``A`` are as large."""
    if not form.n_states:
        return form.A, form.B, form.C
    A, (T, _) = scipy.linalg.matrix_balance(form.A, permute=False, separate=True)
    return A, form.B / T[:, None], form.C * T


def state_covariance(A: NDArray, Q: NDArray) -> NDArray[np.float64]:
    r"""Return ``X = A X A' + Q`` of a stable system, or raise when the solution misses the equation.

    By doubling, :math:`X_{k+1} = X_k + A^{2^k} X_k (A^{2^k})^T`: a sum of what cannot cancel, in which predictors with
    all poles at zero and large gains keep their digits.
    """
    if not len(A):
        return np.zeros((0, 0))
    units = np.sqrt(np.where(np.diag(Q) > 0, np.diag(Q), 1.0))  # comparable states, whatever the units of the model
    A, Q = A / units[:, None] * units, Q / units[:, None] / units
    X, power, settled = Q, A, False
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_DOUBLINGS):
            added = power @ X @ power.T
            X, power = X + (added + added.T) / 2, power @ power
            settled = bool((np.diag(added) <= np.finfo(float).eps * np.diag(X)).all())  # each state by its own size
            if settled:
                break
    if not settled or not np.isfinite(X).all():
        raise AccuracyError(f"a residual has no covariance: noise moves a state that does not settle, {_slowest(A)}")
    missed = float(np.linalg.norm(X - A @ X @ A.T - Q) / max(np.linalg.norm(X), TINY))
    if not missed < IDENTITY:
        raise AccuracyError(
            f"the covariance of the residual misses its equation by {missed:.2g}: noise, and rounding with it, is "
            f"summed by a state that hardly settles, {_slowest(A)}"
        )
    return X * units[:, None] * units


def _slowest(A: NDArray) -> str:
    """Return where the pole is that is nearest to the circle, and what can be done about it."""
    inside = 1 - float(np.abs(np.linalg.eigvals(A)).max())
    return (
        f"of a pole {abs(inside):.2g} {'inside' if inside > 0 else 'outside'} the unit circle: ask for faster poles or "
        "a longer step, or, where a continuous design was sampled, design for the sampled plant, plant.discretize(dt)"
    )


def covariance_of_sums(form: StateSpace, window: int) -> NDArray[np.float64]:
    """Return the covariance of outputs summed over ``window`` samples, divided by it, for white inputs of variance one.

    See :meth:`ResidualGenerator.covariance_of_sums`.
    """
    A, B, C, D = form.A, form.B, form.C, form.D
    X = state_covariance(A, B @ B.T)
    S = C @ X @ C.T + D @ D.T
    step = A @ X @ C.T + B @ D.T
    if window > _LONG:
        R = C @ _weighted_powers(A, window) @ step
        return (S + S.T) / 2 + R + R.T
    for k in range(1, window):
        if not step.any():  # nothing is left: a long window costs no more than the memory of the system
            break
        R = C @ step
        S = S + (1 - k / window) * (R + R.T)
        step = A @ step
    return (S + S.T) / 2


def _weighted_powers(A: NDArray, window: int) -> NDArray[np.float64]:
    """Return the sum of ``(1 - k / window) A^(k-1)`` for ``k`` from one below ``window``, by doubling."""
    n, count = len(A), window - 1
    power, plain, weighted = np.eye(n), np.zeros((n, n)), np.zeros((n, n))  # A^m, sum of A^j and of j A^j, for j < m
    m = 0
    for bit in bin(count)[2:]:
        plain, weighted = plain + power @ plain, weighted + power @ (weighted + m * plain)
        power, m = power @ power, 2 * m
        if bit == "1":
            plain, weighted = plain + power, weighted + m * power
            power, m = power @ A, m + 1
    return (1 - 1 / window) * plain - weighted / window
