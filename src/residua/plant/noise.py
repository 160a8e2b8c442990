"""Noise covariances and their factors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import index_of, matrix
from residua.errors import ModelError
from residua.linear.systems.sampling import exponentials, noise_covariance
from residua.plant.channels import number
from residua.tolerances import TINY


def covariance(
    value: ArrayLike | Mapping[str, float] | None, channels: tuple[str, ...], what: str
) -> NDArray[np.float64]:
    """Return a covariance matrix from a matrix, a diagonal, one number, or ``{channel: variance}``."""
    n = len(channels)
    if value is None:
        return np.zeros((n, n))
    if isinstance(value, Mapping):
        diagonal = np.zeros(n)
        for key, entry in value.items():
            diagonal[index_of(key, channels, f"{what}: channel")] = number(entry, f"{what}[{key!r}]")
        value = diagonal
    if np.ndim(value) == 0:
        W = number(value, what) * np.eye(n)
    elif np.ndim(value) == 1:
        W = np.diag(matrix(value, f"{what} (diagonal)", (n, 1)).ravel())
    else:
        W = np.asarray(matrix(value, what, (n, n)))
    if not np.isfinite(W).all():
        raise ModelError(f"{what}: every entry must be finite")
    # symmetric and positive semidefinite, judged by its correlations, so in any units
    variances = np.diag(W)
    if (variances < 0).any():
        i = int(variances.argmin())
        raise ModelError(
            f"{what}: a covariance has no negative eigenvalue, and the variance of {channels[i]!r} is "
            f"{variances[i]:.3g}"
        )
    spread = np.sqrt(variances)
    bound = np.outer(spread, spread)
    if (np.abs(W - W.T) > 1e-8 * bound).any():
        raise ModelError(
            f"{what}: a covariance must be symmetric; the largest difference is {np.abs(W - W.T).max():.3g}"
        )
    over = np.abs(W) > (1 + 1e-8) * bound
    if over.any():
        i, j = np.argwhere(over)[0]
        raise ModelError(
            f"{what}: {channels[i]!r} and {channels[j]!r} cannot have the covariance {W[i, j]:.4g}: with the variances "
            f"{W[i, i]:.4g} and {W[j, j]:.4g} it is at most {bound[i, j]:.4g}, or the matrix has a negative eigenvalue"
        )
    smallest = _smallest_correlation(W, spread)
    if smallest < -1e-8:
        raise ModelError(
            f"{what}: a covariance has no negative eigenvalue; the smallest of its correlation matrix is {smallest:.3g}"
        )
    return (W + W.T) / 2


def _smallest_correlation(W: NDArray[np.float64], spread: NDArray[np.float64]) -> float:
    """Return the smallest eigenvalue of the correlation matrix."""
    units = np.where(spread > 0, spread, 1.0)
    return float(np.linalg.eigvalsh(W / np.outer(units, units))[0]) if len(W) else 0.0


def cross_covariance(
    value: ArrayLike | Mapping[tuple[str, str], float] | None, states: tuple[str, ...], outputs: tuple[str, ...]
) -> NDArray[np.float64]:
    """Return the covariance between state and output noise from a matrix, or ``{(state, output): covariance}``."""
    if value is None:
        return np.zeros((len(states), len(outputs)))
    if isinstance(value, Mapping):
        S = np.zeros((len(states), len(outputs)))
        for key, entry in value.items():
            if not isinstance(key, tuple) or len(key) != 2:
                raise ModelError(f"cross: expected pairs (state, output) as keys, got {key!r}")
            i = index_of(key[0], states, "cross: state")
            S[i, index_of(key[1], outputs, "cross: output")] = number(entry, f"cross[{key!r}]")
        return S
    return matrix(value, "cross", (len(states), len(outputs)), what="states x outputs")


def joint_factors(
    W: NDArray, V: NDArray, S: NDArray, states: tuple[str, ...], outputs: tuple[str, ...]
) -> tuple[NDArray, NDArray]:
    """Return ``Bw, Dw`` with ``Bw Bw' = W``, ``Dw Dw' = V`` and ``Bw Dw' = S``, or raise with the reason.

    Whether ``[[W, S], [S', V]]`` is a covariance is judged by correlations, in no units.
    """
    if not S.any():
        return noise_factors(W, V)
    spread = np.sqrt(np.maximum(np.diag(W), 0.0)), np.sqrt(np.maximum(np.diag(V), 0.0))
    bound = np.outer(*spread)
    i, j = np.unravel_index(
        int(np.argmax(np.where(S == 0, 0.0, np.abs(S) / np.where(bound > 0, bound, TINY)))), S.shape
    )
    if abs(S[i, j]) > (1 + 1e-8) * bound[i, j]:
        raise ModelError(
            f"cross: state {states[i]!r} and output {outputs[j]!r} cannot have the covariance {S[i, j]:.4g}: with the "
            f"variances {W[i, i]:.4g} and {V[j, j]:.4g} it is at most {bound[i, j]:.4g}"
        )
    joint = np.block([[W, S], [S.T, V]])
    smallest = _smallest_correlation(joint, np.concatenate(spread))
    if smallest < -1e-8:
        raise ModelError(
            "cross: process, measurement and cross together are not a covariance: the correlation matrix of "
            f"[[process, cross], [cross', measurement]] has the eigenvalue {smallest:.3g}"
        )
    L = factor(joint)
    return L[: len(W)], L[len(W) :]


def factor(W: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``L`` with ``L L' = W`` and no zero columns, for a positive semidefinite ``W``."""
    diagonal = np.diag(W)
    if np.array_equal(W, np.diag(diagonal)):  # keep variances recognisable, exact and sparse
        return np.diag(np.sqrt(np.maximum(diagonal, 0)))[:, diagonal > 0]
    spread = np.sqrt(np.maximum(diagonal, 0.0))  # mixed units: factor the correlation matrix
    unit = np.where(spread > 0, spread, 1.0)
    values, vectors = np.linalg.eigh(W / np.outer(unit, unit))
    keep = values > 1e-14 * values[-1]
    return unit[:, None] * vectors[:, keep] * np.sqrt(values[keep])


def noise_factors(W: NDArray, V: NDArray) -> tuple[NDArray, NDArray]:
    """Return ``Bw, Dw`` with ``Bw Bw' = W``, ``Dw Dw' = V`` and independent noise on states and outputs."""
    L, M = factor(W), factor(V)
    Bw = np.hstack([L, np.zeros((len(W), M.shape[1]))])
    Dw = np.hstack([np.zeros((len(V), L.shape[1])), M])
    return Bw, Dw


def sampled_noise(A: NDArray, Bw: NDArray, Dw: NDArray, dt: float) -> tuple[NDArray, NDArray]:
    """Return the noise factors of the sampled plant; see :meth:`residua.Plant.discretize`.

    A noise that enters states and outputs together stays correlated: with a measurement that averages over
    the step, ``cov(w_k, v_k) = (1/dt) int_0^dt exp(A s) ds Bw Dw'``.
    """
    if Bw.shape[1] == 0:
        return Bw, Dw
    Qd = noise_covariance(A, Bw @ Bw.T, dt)
    Rd = Dw @ Dw.T / dt
    cross = Bw @ Dw.T
    if not cross.any():
        return noise_factors(Qd, Rd)
    _, Gamma, _ = exponentials(A, cross, dt)
    Sd = Gamma / dt
    L = factor(np.block([[Qd, Sd], [Sd.T, Rd]]))
    return L[: len(Qd)], L[len(Qd) :]
