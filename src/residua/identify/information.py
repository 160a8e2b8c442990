"""Information of data on parameters: the covariance of the estimate, and combinations that are not identifiable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.tolerances import TINY
from residua.words import listing, number

Matrix = NDArray[np.float64]
#: A number between two bounds, with nothing else known, has this standard deviation in units of their distance.
_FROM_BOUNDS_ALONE = 12**-0.5
#: Singular values this far below the largest are zero: sensitivities are differences of computed predictions.
_NO_EFFECT = 2.0**-23
#: Parameters with a smaller share in a combination, of the largest one, are left out of its name.
_SHARE = 0.05
#: The most lags that are counted, as a fraction of the samples.
_MOST_LAGS = 0.1
#: A correlation of neighbours above this would ask for lags without bound.
_STRONGEST = 0.97


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Identifiability of parameters, by orthogonal combinations of them, in units of the distance of their bounds.

    Attributes
    ----------
    parameters : tuple of str
    singular_values : ndarray, shape (parameters,)
        Of the sensitivities of the whitened prediction errors, largest first: the standard error of a combination is
        one over its value.
    directions : ndarray, shape (parameters, parameters)
        The combinations, one in each row.
    widths : ndarray, shape (parameters,)
        The distance of the bounds of each parameter.
    """

    parameters: tuple[str, ...]
    singular_values: NDArray[np.float64]
    directions: Matrix
    widths: NDArray[np.float64]

    @property
    def unknown(self) -> tuple[int, ...]:
        """The combinations that the data say no more of than the bounds do."""
        s = self.singular_values
        blind = (s * _FROM_BOUNDS_ALONE <= 1) | (s <= _NO_EFFECT * s.max(initial=0.0))
        return tuple(int(i) for i in np.flatnonzero(blind))

    @property
    def condition(self) -> float:
        """The ratio of the largest to the smallest singular value."""
        s = self.singular_values
        return float(s[0] / s[-1]) if s[-1] > 0 else float("inf")

    def moves(self, i: int) -> dict[str, float]:
        """Return how parameters move along a combination, the largest share of the bounds being that of a whole one.

        Of parameters with even bounds the largest moves by 1; what moves by next to nothing is left out.
        """
        direction, moved = self.directions[i], self.directions[i] * self.widths
        large = np.abs(direction) >= _SHARE * np.abs(direction).max()
        unit = moved[int(np.abs(direction).argmax())]
        return {n: float(v / unit) for n, v, keep in zip(self.parameters, moved, large, strict=True) if keep}

    def standard_error(self, i: int) -> float:
        """Return the standard error of a combination of length one, in units of the bounds."""
        s = float(self.singular_values[i])
        return 1 / s if s > 0 else float("inf")

    def sentence(self, i: int) -> str:
        """Describe the combination that is not known."""
        moves = self.moves(i)
        error = number(self.standard_error(i), 2)
        if len(moves) == 1:
            alone = next(iter(moves))
            return f"the data say nothing of {alone}: its standard error is {error} times the distance of its bounds"
        *others, last = moves
        together = listing(f"{name} by {number(value, 3)}" for name, value in moves.items())
        return (
            f"the data do not tell {listing(others)} from {last}: moved together, {together}, they change no "
            f"prediction by more than the noise hides (standard error {error} times the distance of their bounds)"
        )


def identifiability(
    sensitivities: Sequence[NDArray[np.float64]], parameters: tuple[str, ...], widths: NDArray[np.float64]
) -> Identifiability:
    """Return the identifiability of parameters by the singular values of their sensitivities.

    Parameters
    ----------
    sensitivities : sequence of ndarray, shape (time, outputs, parameters)
        Of the whitened prediction errors, over parameters in units of ``widths``.
    parameters : tuple of str
    widths : ndarray, shape (parameters,)
    """
    k = len(parameters)
    R = np.zeros((0, k))
    for S in sensitivities:
        R = np.linalg.qr(np.vstack([R, S.reshape(-1, k)]), mode="r")
    _, s, directions = np.linalg.svd(np.vstack([R, np.zeros((max(k - len(R), 0), k))]))
    return Identifiability(parameters, s[:k], directions, widths)


def sandwich_covariance(
    sensitivities: Sequence[NDArray[np.float64]], errors: Sequence[Matrix], precision: Matrix
) -> tuple[Matrix, Matrix, int]:
    r"""Return the covariance of an estimate, that for white errors, and the lags that were counted.

    .. math::

       V = H^{-1} \Big(\sum_{|l| \le L} \big(1 - \tfrac{|l|}{L + 1}\big) \sum_t s_t s_{t+l}^T + P\Big) H^{-1}, \qquad
       H = \sum_t \Psi_t^T \Psi_t + P, \qquad s_t = \Psi_t^T e_t

    with whitened errors :math:`e_t`, their sensitivities :math:`\Psi_t` and the precision of the prior, :math:`P`.
    Where the errors are white it is :math:`H^{-1}` but for chance.

    Parameters
    ----------
    sensitivities : sequence of ndarray, shape (time, outputs, parameters)
        Of the weighted errors, one for each stretch of data.
    errors : sequence of ndarray, shape (time, outputs)
        Weighted.
    precision : ndarray, shape (parameters, parameters)
        Of a prior; zero for none.

    References
    ----------
    Newey and West (1987), Econometrica 55(3); the number of lags: Andrews (1991), Econometrica 59(3), eqs. (6.2) and
    (6.4).
    """
    k = len(precision)
    H = sum((np.einsum("tpi,tpj->ij", S, S) for S in sensitivities), np.array(precision, dtype=float))
    inverse = np.linalg.inv(H)
    root = np.linalg.cholesky((inverse + inverse.T) / 2)  # scores in units in which they are alike
    scores = [np.einsum("tpi,tp->ti", S, e) @ root for S, e in zip(sensitivities, errors, strict=True)]
    samples = sum(map(len, scores))
    power = sum((s**2).sum(axis=0) for s in scores)
    beside = sum((s[:-1] * s[1:]).sum(axis=0) for s in scores)
    r = np.clip(beside / np.maximum(power, TINY), -_STRONGEST, _STRONGEST)
    variance = power / max(samples, 1) * (1 - r**2)
    above = float((4 * r**2 * variance**2 / ((1 - r) ** 6 * (1 + r) ** 2)).sum())
    below = float((variance**2 / (1 - r) ** 4).sum())
    wanted = int(np.ceil(1.1447 * (above / max(below, TINY) * samples) ** (1 / 3)))
    lags = min(wanted, int(_MOST_LAGS * samples))
    middle = sum((s.T @ s for s in scores), np.zeros((k, k)))
    for lag in range(1, lags + 1):
        product = sum((s[:-lag].T @ s[lag:] for s in scores if len(s) > lag), np.zeros((k, k)))
        middle += (1 - lag / (lags + 1)) * (product + product.T)
    middle *= samples / max(samples - k, 1)
    middle += root.T @ precision @ root
    V = root @ middle @ root.T
    return (V + V.T) / 2, (inverse + inverse.T) / 2, lags
