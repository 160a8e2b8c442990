"""Where the residual points for each fault, and how alike two faults look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.generator import ResidualGenerator

#: Steady residuals below this fraction of the largest count as not seen.
_UNSEEN = 1e-9


@dataclass(frozen=True, eq=False)
class Signatures:
    """Orthonormal signature bases of groups of faults, in the space in which they are compared.

    Attributes
    ----------
    labels : tuple of str
    bases : tuple of ndarray, shape (residuals, k)
        Empty (k = 0) where a group is not seen.
    steady : tuple of bool
        Whether the residual of a constant fault stands in, because the fault has no direction of its own.
    whitening : ndarray, shape (residuals, residuals)
        What residuals are multiplied with before they are compared.
    whitened : bool
    """

    labels: tuple[str, ...]
    bases: tuple[NDArray[np.float64], ...]
    steady: tuple[bool, ...]
    whitening: NDArray[np.float64]
    whitened: bool

    def similarity(self) -> NDArray[np.float64]:
        """Return the cosine of the smallest angle between every two signatures; NaN where one is empty."""
        n = len(self.bases)
        out = np.full((n, n), np.nan)
        for i in range(n):
            for j in range(i, n):
                if self.bases[i].shape[1] and self.bases[j].shape[1]:
                    product = np.linalg.norm(self.bases[i].T @ self.bases[j], 2)
                    out[i, j] = out[j, i] = min(1.0, float(product))
        return out

    def correlation(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cosine between a (whitened) residual vector and every signature."""
        length = np.linalg.norm(residual)
        if not length:
            return np.full(len(self.bases), np.nan)
        return np.array(
            [min(1.0, float(np.linalg.norm(B.T @ residual) / length)) if B.shape[1] else np.nan for B in self.bases]
        )


def signatures(
    generator: ResidualGenerator,
    groups: tuple[tuple[str, ...], ...] | None = None,
    *,
    whitening: NDArray[np.float64] | None = None,
) -> Signatures:
    """Return the signature of each group of faults.

    The subspace that the residual never leaves, where that is smaller than the whole residual space;
    otherwise the direction that a constant fault settles to. Residuals are whitened by their covariance
    where the plant's noise gives one.

    Parameters
    ----------
    generator : ResidualGenerator
    groups : tuple of tuple of str, optional
        One group per fault when omitted.
    whitening : ndarray, shape (residuals, residuals), optional
        The matrix ``M`` with which the monitor whitens residual rows, ``r @ M``; from the covariance that
        the plant's noise gives the residual when omitted.
    """
    n = generator.n_residuals
    chosen = groups if groups is not None else tuple((f,) for f in generator.faults)
    root, whitened = _whitening_root(generator, whitening)
    bases, steady = [], []
    for group in chosen:
        # The faults of a group share one signature, up to the monitor's tolerance: the first stands for all.
        fault = group[0]
        basis = np.asarray(generator.subspaces[fault], dtype=float).reshape(n, -1)
        stands_in = n > 1 and basis.shape[1] >= n
        bases.append(_orthonormal(root @ (_steady(generator, fault) if stands_in else basis)))
        steady.append(stands_in)
    labels = tuple(" or ".join(group) for group in chosen)
    return Signatures(labels, tuple(bases), tuple(steady), root, whitened)


def _steady(generator: ResidualGenerator, fault: str) -> NDArray[np.float64]:
    everything = generator.steady_directions
    largest = max((float(np.linalg.norm(v)) for v in everything.values()), default=0.0)
    vector = np.asarray(everything[fault], dtype=float).reshape(-1, 1)
    return vector if np.linalg.norm(vector) > _UNSEEN * largest else vector[:, :0]


def _orthonormal(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    if vectors.shape[1] == 0 or not np.isfinite(vectors).all():
        return vectors[:, :0]
    lengths = np.linalg.norm(vectors, axis=0)
    vectors = vectors[:, lengths > 0] / lengths[lengths > 0]
    U, s, _ = np.linalg.svd(vectors, full_matrices=False)
    return U[:, s > 1e-8 * s.max(initial=0.0)]


def _whitening_root(
    generator: ResidualGenerator, whitening: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], bool]:
    """Return the symmetric matrix that whitens residual columns, and whether it does anything.

    Symmetric, so that the whitened axes still belong to one residual each as nearly as can be; angles do
    not depend on that choice.
    """
    n = generator.n_residuals
    if whitening is not None:
        information = np.asarray(whitening) @ np.asarray(whitening).T
        values, vectors = np.linalg.eigh(information)
        root = vectors @ np.diag(np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        return root, not np.allclose(information, np.eye(n))
    covariance = generator.covariance
    if covariance is None:
        return np.eye(n), False
    values, vectors = np.linalg.eigh(covariance)
    floor = 1e-8 * max(float(values[-1]), np.finfo(float).tiny)
    return vectors @ np.diag(1 / np.sqrt(np.maximum(values, floor))) @ vectors.T, True
