"""Rank decisions that can be seen: every one keeps the singular values on both sides of its gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import SettingError
from residua.progress import check_time
from residua.tolerances import NEAR, RANK, RESIDUE, above_rounding

#: Singular values below this fraction of the scale count as zero, unless the caller says otherwise. The
#: staircase algorithms lose about three digits at order 30, so this stays well above rounding.
DEFAULT_RTOL = RANK


@dataclass(frozen=True, eq=False)
class RankDecision:
    """A numerical rank with the evidence for it.

    Attributes
    ----------
    rank : int
        Number of singular values above ``tolerance``.
    singular_values : ndarray
        All singular values, largest first.
    tolerance : float
        The absolute threshold that was used.
    """

    rank: int
    singular_values: NDArray[np.float64]
    tolerance: float

    @property
    def kept(self) -> NDArray[np.float64]:
        """The singular values counted as nonzero."""
        return self.singular_values[: self.rank]

    @property
    def dropped(self) -> NDArray[np.float64]:
        """The singular values counted as zero."""
        return self.singular_values[self.rank :]

    @property
    def smallest_kept(self) -> float:
        """The smallest singular value counted as nonzero (infinity when the rank is zero)."""
        return float(self.kept[-1]) if self.rank else float("inf")

    @property
    def largest_dropped(self) -> float:
        """The largest singular value counted as zero (zero when none was dropped)."""
        return float(self.dropped[0]) if self.dropped.size else 0.0

    @property
    def is_clear(self) -> bool:
        """Clearness: no singular value lies within a factor of 1000 of the tolerance."""
        return self.largest_dropped < self.tolerance / NEAR and self.smallest_kept > self.tolerance * NEAR

    def __str__(self) -> str:
        kept = f"{self.smallest_kept:.3g}" if self.rank else "none"
        return f"rank {self.rank} (smallest kept {kept}, largest dropped {self.largest_dropped:.3g})"


def spectral_norm(M: NDArray) -> float:
    """Return the largest singular value; asked for so often that the checks of ``numpy.linalg.norm`` would count."""
    return float(np.linalg.svd(M, compute_uv=False)[0]) if M.size else 0.0


def check_rtol(rtol: float) -> None:
    """Raise when a tolerance of rank decisions is negative, one or more, or no number."""
    try:
        fine = bool(0 <= rtol < 1)
    except (TypeError, ValueError):
        fine = False
    if not fine:
        raise SettingError(f"rtol must be a number from 0 to below 1, got {rtol!r}")


def _svd_decision(M: ArrayLike, rtol: float, scale: float | None, side: str) -> tuple[NDArray, NDArray, RankDecision]:
    """Return left and right singular vectors, all of those of one side, and the rank."""
    check_rtol(rtol)
    M = np.atleast_2d(np.asarray(M))
    rows, columns = M.shape
    U, Vh, s = np.eye(rows), np.eye(columns), np.zeros(0)
    if M.size:
        # The singular vectors beyond the shorter side are computed where they are asked for only.
        U, s, Vh = np.linalg.svd(
            M, full_matrices=(side == "left" and rows > columns) or (side == "right" and columns > rows)
        )
    return U, Vh, _decision(s, rtol, scale)


def _decision(s: NDArray, rtol: float, scale: float | None) -> RankDecision:
    tolerance = rtol * (float(s.max(initial=0.0)) if scale is None else scale)
    return RankDecision(int(np.count_nonzero(s > tolerance)), s, tolerance)


def decide_rank(M: ArrayLike, *, rtol: float = DEFAULT_RTOL, scale: float | None = None) -> RankDecision:
    """Decide the numerical rank of a matrix.

    Parameters
    ----------
    M : array_like, shape (p, q)
    rtol : float
        Singular values at or below ``rtol * scale`` count as zero.
    scale : float, optional
        What ``rtol`` is relative to; the largest singular value of ``M`` when omitted. Give it when ``M`` is
        a small piece of a larger problem and may be zero up to rounding.

    Returns
    -------
    RankDecision

    Raises
    ------
    SettingError
        If ``rtol`` is negative, one or more, or no number.

    Examples
    --------
    >>> from residua.linear import decide_rank
    >>> print(decide_rank([[1, 2], [2, 4]]))
    rank 1 (smallest kept 5, largest dropped ...)
    """
    check_time()
    check_rtol(rtol)
    M = np.atleast_2d(np.asarray(M))
    return _decision(np.linalg.svd(M, compute_uv=False) if M.size else np.zeros(0), rtol, scale)


def equilibrated(M: ArrayLike) -> NDArray:
    """Return ``M`` with rows and columns scaled to about unit size, so that its rank shows whatever its units.

    Rows and columns below 64 units of rounding of the largest entry can only be rounding and are left as they are.
    """
    out = np.array(M, dtype=np.result_type(np.asarray(M), float))
    for _ in range(3):
        for axis in (1, 0):
            size = np.abs(out).max(axis=axis, keepdims=True, initial=0.0)
            out = out / np.where(size > RESIDUE * size.max(initial=0.0), size, 1.0)
    return out


def range_basis(
    M: ArrayLike, *, rtol: float = DEFAULT_RTOL, scale: float | None = None
) -> tuple[NDArray, RankDecision]:
    """Return an orthonormal basis of the column space of ``M`` and the rank decision behind it."""
    U, _, decision = _svd_decision(M, rtol, scale, "short")
    return without_noise(U[:, : decision.rank]), decision


def null_basis(M: ArrayLike, *, rtol: float = DEFAULT_RTOL, scale: float | None = None) -> tuple[NDArray, RankDecision]:
    """Return an orthonormal basis of ``{x : M x = 0}`` and the rank decision behind it."""
    _, Vh, decision = _svd_decision(M, rtol, scale, "right")
    return without_noise(Vh[decision.rank :].conj().T), decision


def row_and_null_basis(
    M: ArrayLike, *, rtol: float = DEFAULT_RTOL, scale: float | None = None
) -> tuple[NDArray, NDArray, RankDecision]:
    """Return orthonormal bases, as columns, of the row space and of ``{x : M x = 0}``: together a basis of all."""
    _, Vh, decision = _svd_decision(M, rtol, scale, "right")
    return Vh[: decision.rank].conj().T, Vh[decision.rank :].conj().T, decision


def left_null_basis(
    M: ArrayLike, *, rtol: float = DEFAULT_RTOL, scale: float | None = None
) -> tuple[NDArray, RankDecision]:
    """Return an orthonormal basis, as columns, of ``{w : w' M = 0}`` and the rank decision behind it."""
    U, _, decision = _svd_decision(M, rtol, scale, "left")
    return without_noise(U[:, decision.rank :]), decision


def without_noise(basis: NDArray) -> NDArray:
    """Return an orthonormal basis with exact zeros where its vectors, known to rounding of their length, have none."""
    return above_rounding(basis, 1.0, RESIDUE)
