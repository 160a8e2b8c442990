"""Residuals made comparable: centred, and scaled by their covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.linear.whitening import whitening_matrix


def residual_moments(residuals: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and covariance of residual rows, shape (samples, k)."""
    mean = residuals.mean(axis=0)
    centred = residuals - mean
    return mean, centred.T @ centred / max(1, len(residuals) - 1)


__all__ = ["residual_moments", "whitening_matrix"]
