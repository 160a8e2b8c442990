"""Perturbations of plant matrices by parameters: ``dA = -H F G`` and what it takes to write one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.arrays import matrix
from residua.errors import ModelError
from residua.linear.systems.scaling import even_units
from residua.robust.sets.uncertain_system import bounds

MATRICES = ("A", "B", "C", "D", "Bd", "Dd", "Bf", "Df")


@dataclass(frozen=True)
class UncertainParameter:
    """A constant of the plant that is known within bounds only.

    Attributes
    ----------
    name : str
    low, high : float
    nominal : float
        Its value in the nominal plant; 0 for perturbations ``dA = -H F G``.
    """

    name: str
    low: float
    high: float
    nominal: float = 0.0


@dataclass(frozen=True, init=False, eq=False)
class Perturbation:
    r"""What parameters add to a matrix of the plant: :math:`\Delta A = -H F G`, ``F`` diagonal, ``low <= F <= high``.

    The minus sign is that of the literature; give ``-H`` for a plus.

    Parameters
    ----------
    matrix : {"A", "B", "C", "D", "Bd", "Dd", "Bf", "Df"}
        The matrix of the plant: states, control inputs, outputs, direct term; directions of all disturbances in states
        and in outputs, and those of all faults.
    H : array_like, shape (rows of the matrix, k)
    G : array_like, shape (k, columns of the matrix)
    low, high : array_like, shape (k,)
        One number stands for all. They contain 0, which is the nominal plant.
    names : sequence of str, optional
        One for each diagonal entry of ``F``; ``"A1", "A2", ..`` when omitted. The same name in several places, of one
        or of several perturbations, is the same parameter.

    Raises
    ------
    ModelError
        If a shape does not fit, bounds are not bounds, or leave out 0.

    References
    ----------
    Robust l1 fault detection, eqs. (3)-(8).

    Examples
    --------
    >>> from residua.plant import Perturbation
    >>> Perturbation("A", [[-1.0], [0.0]], [[1.0, 0.0]], low=-0.1, high=0.2, names=["friction"]).names
    ('friction',)
    """

    matrix: str
    H: NDArray[np.float64]
    G: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    names: tuple[str, ...] | None

    def __init__(
        self,
        matrix: str,
        H: ArrayLike,
        G: ArrayLike,
        low: ArrayLike,
        high: ArrayLike,
        names: Iterable[str] | str | None = None,
    ) -> None:
        if matrix not in MATRICES:
            raise ModelError(f"a perturbation belongs to one of {', '.join(MATRICES)}, got {matrix!r}")
        H_ = arrays.matrix(H, f"H of d{matrix}", (None, None))
        k = H_.shape[1]
        G_ = arrays.matrix(G, f"G of d{matrix}", (k, None), what="one row per column of H")
        lows, highs = (np.full(k, v) if np.ndim(v) == 0 else v for v in (low, high))
        low_, high_ = bounds(lows, highs)
        if len(low_) != k:
            raise ModelError(f"d{matrix}: {k} columns of H need {k} bounds, got {len(low_)}")
        wrong = np.flatnonzero((low_ > 0) | (high_ < 0))
        if wrong.size:
            i = int(wrong[0])
            raise ModelError(
                f"d{matrix}: the bounds [{low_[i]:g}, {high_[i]:g}] of parameter {i + 1} leave out 0, the nominal "
                f"plant: add the middle, {-(low_[i] + high_[i]) / 2:g} x H x G, to {matrix} of the plant, and bound "
                "deviations from it"
            )
        labels = None if names is None else (names,) if isinstance(names, str) else tuple(names)
        if labels is not None and (len(labels) != k or not all(isinstance(x, str) and x.strip() for x in labels)):
            raise ModelError(f"d{matrix}: {k} columns of H need {k} names, got {labels!r}")
        fields = {"matrix": matrix, "H": H_, "G": G_, "low": low_, "high": high_, "names": labels}
        for name, value in fields.items():
            object.__setattr__(self, name, value)


def factored(M: ArrayLike, rtol: float = 1e-12) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``L, R`` with ``L R = M``, as thin as the rank of ``M`` in even units of its rows and columns."""
    M = matrix(M, "M", (None, None))
    if not np.any(M):
        return np.zeros((M.shape[0], 0)), np.zeros((0, M.shape[1]))
    rows, columns = even_units(M)
    U, s, Vh = np.linalg.svd(rows[:, None] * M * columns, full_matrices=False)
    rank = int(np.count_nonzero(s > rtol * s[0]))
    half = np.sqrt(s[:rank])
    return U[:, :rank] * half / rows[:, None], half[:, None] * Vh[:rank] / columns
