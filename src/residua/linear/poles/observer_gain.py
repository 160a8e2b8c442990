"""The gain of an observer of a balanced pair: by least squares, with a margin, or with poles of one's choice."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import AccuracyError, DesignError
from residua.linear.poles.pole_assignment import assigned_gain, checked_poles
from residua.linear.poles.riccati import filter_covariance
from residua.linear.poles.spectrum import describe_modes, match_poles
from residua.linear.subspaces.quotient import ObservableSplit, without_rounding
from residua.tolerances import BALANCED_STABLE, POLE, above_rounding
from residua.words import counted

Matrix = NDArray[np.float64]
#: Parts of a margin that is asked for, that are tried in turn.
_PARTS = (1.0, 0.25, 1 / 16, 1 / 64, 0.0)


@dataclass(frozen=True, eq=False)
class ObserverGain:
    """A gain, and the poles that it makes, in balanced units.

    Attributes
    ----------
    K : ndarray, shape (n, p)
    poles : ndarray
        Those of the part that is seen.
    requested, fixed : ndarray
        The poles that were asked for, and those that no gain moves.
    error : float
        The largest distance of a pole from what was asked for, relative to its size.
    note : str
        What to say of it; empty where it is what was asked for.
    """

    K: Matrix
    poles: NDArray[np.complex128]
    requested: NDArray[np.complex128]
    fixed: NDArray[np.complex128]
    error: float = 0.0
    note: str = ""

    @property
    def norm(self) -> float:
        """Norm of the gain."""
        return float(np.linalg.norm(self.K, 2)) if self.K.size else 0.0


def observer_gain(
    A: Matrix,
    C: Matrix,
    split: ObservableSplit,
    *,
    sampled: bool,
    process: Matrix,
    measurement: Matrix,
    cross: Matrix | None = None,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    rate: float = 1.0,
    tolerance: float = POLE,
    faint: bool = False,
) -> ObserverGain:
    """Return the gain of an observer.

    Parameters
    ----------
    A, C : ndarray
        A balanced pair, whose hidden modes are stable.
    split : ObservableSplit
        Its own.
    sampled : bool
    process, measurement, cross : ndarray
        Covariances of the noise of states and outputs that least squares take.
    poles : sequence of complex, optional
        As many as states, or as are seen; in units of the balanced plant.
    margin : float, optional
        Decay rate that all poles of the part that is seen must have; a smaller one is taken where it has no gain.
    rate : float
        The unit of rates of the balanced plant in 1/s: errors say poles in 1/s.
    tolerance : float
        Of poles that were asked for.
    faint : bool
        Whether the noise of the outputs may be as small as what they show, where no gain is found else.
    """
    hidden = split.hidden
    O = split.seen if hidden.shape[1] else np.eye(len(A))  # noqa: E741
    fixed = np.asarray(np.linalg.eigvals(hidden.T @ A @ hidden), dtype=complex)
    F, G, none = without_rounding(O.T @ A @ O), without_rounding(C @ O), np.zeros(0, dtype=complex)
    if poles is not None:
        wanted = _movable(checked_poles(poles, sampled, rate), len(F), fixed, rate, tolerance)
        K, found, error = assigned_gain(F, G, wanted, sampled, rate, tolerance)
        return ObserverGain(cleared(O @ K), found, wanted, fixed, error)
    W = O.T @ process @ O
    S = None if cross is None else O.T @ cross
    tried = [(part, measurement) for part in (_PARTS if margin else (0.0,))]
    if faint and G.size:  # noise as large as all outputs hides what these hardly see
        tried.append((0.0, np.linalg.norm(G, 2) ** 2 * measurement))
    for part, V in tried:
        K = _least_squares(F, G, W, V, S, sampled, part * (margin or 0.0))
        if K is not None:
            found = np.asarray(np.linalg.eigvals(F - K @ G), dtype=complex)
            note = "" if part == 1.0 or not margin else f"no gain has the margin: {part:.3g} of it was taken"
            return ObserverGain(cleared(O @ K), found, none, fixed, note=note)
    modes = describe_modes(rate * np.linalg.eigvals(F))
    raise AccuracyError(
        f"no gain was found for the part that the measurements see, with poles {modes}: they see a mode on the "
        "boundary of stability too weakly; add a sensor"
    )


def cleared(K: NDArray) -> Matrix:
    """Return a matrix with zeros where an entry is rounding beside another of its row."""
    return above_rounding(K, np.abs(K).max(axis=1, keepdims=True, initial=0.0))


def _movable(
    wanted: NDArray[np.complex128], count: int, fixed: NDArray[np.complex128], rate: float, tolerance: float
) -> NDArray[np.complex128]:
    """Return the poles that can be placed: all that were asked for, less those that are fixed."""
    if len(wanted) == count:
        return wanted
    hint = f"; give the {counted(count, 'pole')} of the observable part" if fixed.size else ""
    if len(wanted) != count + len(fixed):
        are = "is" if count == 1 else "are"
        raise DesignError(
            f"got {counted(len(wanted), 'pole')} for {counted(count + len(fixed), 'state')}, of which {count} {are} "
            f"observable{hint}"
        )
    order = match_poles(fixed, wanted)
    missed = np.abs(wanted[order] - fixed) > max(tolerance, POLE) * np.maximum(np.abs(fixed), np.finfo(float).tiny)
    rest = np.delete(wanted, order)
    if missed.any() or not np.allclose(np.sort_complex(rest), np.sort_complex(rest.conj())):
        raise DesignError(
            f"the modes {describe_modes(rate * fixed)} are not observable and stay where they are, but "
            f"{describe_modes(rate * (fixed[missed] if missed.any() else fixed))} are not among the requested "
            f"poles{hint}"
        )
    return rest


def _least_squares(
    F: Matrix, G: Matrix, W: Matrix, V: Matrix, S: Matrix | None, sampled: bool, margin: float
) -> Matrix | None:
    """Return the gain of a filter Riccati equation, with all poles beyond a margin; nothing where none is found."""
    if not len(F) or not len(G):
        return np.zeros((len(F), len(G)))
    shifted = F * np.exp(margin) if sampled else F + margin * np.eye(len(F))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the poles are checked
            P = filter_covariance(shifted, G, W, V, S, dt=1.0 if sampled else 0.0)
            S = np.zeros((len(F), len(G))) if S is None else S
            if sampled:
                K = np.linalg.solve(G @ P @ G.T + V, (shifted @ P @ G.T + S).T).T
            else:
                K = np.linalg.solve(V, (P @ G.T + S).T).T
    except (np.linalg.LinAlgError, ValueError):
        return None
    if not np.isfinite(K).all():
        return None
    if sampled and margin:
        K = K * np.exp(-margin)
    poles = np.linalg.eigvals(F - K @ G)
    limit = np.exp(-margin) - BALANCED_STABLE if sampled else -margin - BALANCED_STABLE
    stable = np.abs(poles) < limit if sampled else poles.real < limit
    return np.asarray(K, dtype=np.float64) if stable.all() else None
