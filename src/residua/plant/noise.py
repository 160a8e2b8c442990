"""Noise covariances and their factors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.linear.arrays import index_of, matrix
from residua.linear.sampling import exponentials, noise_covariance
from residua.plant.channels import number


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
    scale = np.abs(W).max(initial=0.0)
    if not np.allclose(W, W.T, rtol=0, atol=1e-8 * scale):
        raise ModelError(
            f"{what}: a covariance must be symmetric; the largest difference is {np.abs(W - W.T).max():.3g}"
        )
    W = (W + W.T) / 2
    smallest = float(np.linalg.eigvalsh(W)[0]) if n else 0.0
    if smallest < -1e-8 * scale:
        raise ModelError(f"{what}: a covariance has no negative eigenvalue; the smallest here is {smallest:.3g}")
    return W


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
