"""Signatures by which faults are judged, rotated for drawing, and their similarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.decide import Directional, correlation, whitening_matrix
from residua.decide.directional import direction_test

if TYPE_CHECKING:
    from collections.abc import Sequence

    from residua.design.core.generator import ResidualGenerator
    from residua.monitor.diagnosis import Diagnosis


@dataclass(frozen=True, eq=False)
class Signatures:
    """Orthonormal signature bases of groups of faults, in the space of their comparison.

    That space is the whitened one, turned (an orthogonal matrix: angles stay) so that its axes are as near to
    the residuals' as they can be.

    Attributes
    ----------
    labels : tuple of str
    bases : tuple of ndarray, shape (residuals, k)
        Empty (k = 0) where a fault has no signature.
    steady : tuple of bool
        Whether the direction of a constant fault stands in for more that the residual can do.
    whitening : ndarray, shape (residuals, residuals)
        Matrix that multiplies residuals less their fault-free mean before they are compared; symmetric.
    whitened : bool
        Whether that does anything.
    """

    labels: tuple[str, ...]
    bases: tuple[NDArray[np.float64], ...]
    steady: tuple[bool, ...]
    whitening: NDArray[np.float64]
    whitened: bool

    def similarity(self) -> NDArray[np.float64]:
        """Return the largest principal cosine between every two signatures; NaN where one is empty."""
        n = len(self.bases)
        out = np.full((n, n), np.nan)
        for i in range(n):
            for j in range(i, n):
                if self.bases[i].shape[1] and self.bases[j].shape[1]:
                    product = np.linalg.norm(self.bases[i].T @ self.bases[j], 2)
                    out[i, j] = out[j, i] = min(1.0, float(product))
        return out

    def only(self, numbers: Sequence[int]) -> Signatures:
        """Return some of the signatures, in the order of the given numbers."""
        labels, bases, steady = zip(*((self.labels[g], self.bases[g], self.steady[g]) for g in numbers), strict=True)
        return Signatures(labels, bases, steady, self.whitening, self.whitened)

    def correlation(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``CORR`` of a (whitened) residual vector with every signature; NaN without one."""
        values = [correlation(residual, B) if B.shape[1] else np.nan for B in self.bases]
        return np.minimum(np.array(values, dtype=float), 1.0)


def judged_signatures(diagnosis: Diagnosis) -> Signatures:
    """Return the signatures by which a diagnosis was judged; without any, those of its generator."""
    if not diagnosis.naming.signatures and (diagnosis.groups or not diagnosis.naming.unjudged):
        return generator_signatures(diagnosis.generator, diagnosis.test.whitening)
    return _turned(diagnosis.generator, diagnosis.groups, diagnosis.naming.signatures, diagnosis.test.whitening)


def generator_signatures(generator: ResidualGenerator, whitening: NDArray[np.float64] | None = None) -> Signatures:
    """Return the signatures of a monitor with default settings, faults without one at the end.

    Parameters
    ----------
    generator : ResidualGenerator
    whitening : ndarray, shape (residuals, residuals), optional
        Applied as ``r @ whitening``; from the covariance that the plant's noise gives the residual when omitted.
    """
    if whitening is None:
        covariance = generator.covariance
        whitening = np.eye(generator.n_residuals) if covariance is None else whitening_matrix(covariance)
    test = direction_test(
        Directional(), generator.subspaces, generator.steady_directions, whitening, generator.residual_rank
    )
    groups = [*test.groups, *((fault,) for fault in test.unjudged)]
    nothing = np.zeros((generator.n_residuals, 0))
    return _turned(generator, groups, [*test.bases, *(nothing for _ in test.unjudged)], whitening)


def _turned(
    generator: ResidualGenerator,
    groups: Sequence[tuple[str, ...]],
    bases: Sequence[NDArray[np.float64]],
    whitening: NDArray[np.float64],
) -> Signatures:
    """Return bases of whitened space rotated towards the residuals' axes, by the polar form of the whitening."""
    U, s, Vt = np.linalg.svd(whitening)
    turn, root = U @ Vt, (U * s) @ U.T
    steady = tuple(
        any(0 < basis.shape[1] < generator.subspaces[fault].shape[1] for fault in group if fault in generator.subspaces)
        for group, basis in zip(groups, bases, strict=True)
    )
    labels = tuple(" or ".join(group) for group in groups)
    plain = np.allclose(root, np.eye(len(root)))
    return Signatures(labels, tuple(turn @ basis for basis in bases), steady, root, not plain)
