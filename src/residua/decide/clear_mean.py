"""The longest of three exponentially weighted means that noise does not explain, from which a direction is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.decide.multiscale_fit import averaged, lengths_at
from residua.decide.row_norms import row_squares

#: Weights of the two long means; the first mean is the sample itself.
WEIGHTS = (1 / 8, 1 / 64)
#: Samples that the longest mean is worth.
MEMORY = 127
#: Normal score of the length from which a mean is clear of noise: one in 100,000 of noise alone.
_CLEAR = 4.26


@dataclass(frozen=True, eq=False)
class MeansState:
    """Long means of each plant.

    Attributes
    ----------
    means : ndarray, shape (plants, 2, k)
    """

    means: NDArray[np.float64]

    def arrays(self) -> tuple[NDArray[np.float64], None, None]:
        """Return the arrays that the fused loop reads and writes, in its order."""
        return self.means, None, None


def no_means(plants: int, k: int) -> MeansState:
    """Return the state before the first sample."""
    return MeansState(np.zeros((plants, len(WEIGHTS), k)))


def clear_square(k: int) -> float:
    """Return the squared length, in deviations, beyond which a mean of k residuals is not noise."""
    return float(lengths_at(_CLEAR, [k])[0] ** 2) if k else np.inf


def clear_means(
    values: NDArray[np.float64], state: MeansState, judged: NDArray[np.bool_], clear: float
) -> tuple[NDArray[np.float64], MeansState]:
    r"""Return the mean that shows the direction of a residual best, at every sample.

    :math:`s_k = (1 - \lambda) s_{k-1} + \lambda q_k` has the variance :math:`\lambda / (2 - \lambda)` of white noise. A
    slower mean takes the place of a quicker one where it is clear of noise or, in its own deviations, no shorter: just
    after a large fault it is the sample itself, of a small one in the end the mean of a hundred.

    Parameters
    ----------
    values : ndarray, shape (plants, time, k)
        Whitened.
    state : MeansState
    judged : ndarray of bool, shape (plants, time)
        The samples that count; at the others no mean moves on.
    clear : float
        See :func:`clear_square`.

    Returns
    -------
    chosen : ndarray, shape (plants, time, k)
        Zero at samples that do not count.
    state : MeansState
        To go on with.
    """
    chosen = np.where(judged[..., None], values, 0.0)
    longest = row_squares(chosen)
    after = state.means.copy()
    whole = judged.all(axis=1)
    groups = [(np.flatnonzero(whole), np.arange(values.shape[1]))] if whole.any() else []
    groups += [(np.array([plant]), np.flatnonzero(judged[plant])) for plant in np.flatnonzero(~whole)]
    for who, rows in groups:
        at = np.ix_(who, rows)
        if not rows.size:
            continue
        for j, weight in enumerate(WEIGHTS):
            means, after[who, j] = averaged(weight, state.means[who, j], values[at])
            squares = row_squares(means) * ((2 - weight) / weight)
            taken = (squares > clear) | (squares >= longest[at])
            longest[at] = np.where(taken, squares, longest[at])
            chosen[at] = np.where(taken[..., None], means, chosen[at])
    return chosen, MeansState(after)
