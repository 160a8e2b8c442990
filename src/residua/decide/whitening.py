"""Residuals made comparable: centred, and scaled by their covariance."""

from __future__ import annotations

from residua.linear.subspaces.whitening import moving_directions, whitening_matrix

__all__ = ["moving_directions", "whitening_matrix"]
