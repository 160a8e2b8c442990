"""What a stable system settles to under constant inputs, and the spread of its outputs under white ones."""

from __future__ import annotations

import warnings

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear import StateSpace
from residua.linear.systems.response_terms import in_even_units
from residua.tolerances import IDENTITY, TINY

#: Windows of more samples are summed by doubling: what they cost grows with the logarithm of their length.
_LONG = 4096


def steady_responses(form: StateSpace) -> NDArray[np.float64]:
    """Return what a system settles to for constant inputs of size one, exactly zero where that is rounding.

    Rounding is judged by the terms of the same response: each residual and each fault has its own units.
    """
    even = in_even_units(form)
    A, B, C, D = even.system.A, even.system.B, even.system.C, even.system.D
    X = np.linalg.solve((np.eye(len(A)) if form.is_discrete else 0.0) - A, B)
    gain, terms = C @ X + D, np.abs(C) @ np.abs(X) + np.abs(D)
    heights = np.abs(C).max(axis=1, initial=0.0)
    anywhere = heights[:, None] * np.abs(X).max(axis=0, initial=0.0)  # a state may be mere rounding
    gain = np.where(np.abs(gain) > 1e-10 * terms + 1e-13 * anywhere, gain, 0.0)
    return gain / even.outputs[:, None] / even.inputs


def state_covariance(A: NDArray, Q: NDArray) -> NDArray[np.float64]:
    """Return ``X = A X A' + Q``, or raise when the solution misses the equation."""
    if not len(A):
        return np.zeros((0, 0))
    units = np.sqrt(np.where(np.diag(Q) > 0, np.diag(Q), 1.0))  # comparable states, whatever the units of the model
    A, Q = A / units[:, None] * units, Q / units[:, None] / units
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ill-conditioning shows in the residual below
        X = scipy.linalg.solve_discrete_lyapunov(A, Q)
    missed = float(np.linalg.norm(X - A @ X @ A.T - Q) / max(np.linalg.norm(X), TINY))
    if not missed < IDENTITY:
        raise AccuracyError(f"the covariance of the residual misses its equation by {missed:.2g}: rescale the plant")
    return X * units[:, None] * units


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
