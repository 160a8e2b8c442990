"""The observable part of a pair, in the coordinates in which gains are designed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.errors import AccuracyError, DesignError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import dies_out, may_die_out
from residua.linear.subspaces.observability import Staircase, pair, staircase
from residua.linear.subspaces.rank import DEFAULT_RTOL, without_rounded_gains
from residua.linear.systems.array_cache import cached_by_contents
from residua.tolerances import RANK, RESIDUE

Matrix = NDArray[np.float64]
Poles = NDArray[np.complex128]


class UndetectableError(DesignError):
    """A mode that no output sees and that is not stable: no gain moves it."""


@dataclass(frozen=True, eq=False)
class ObservablePart:
    """The observable part in balanced staircase coordinates, where ``H`` has orthonormal rows.

    Attributes
    ----------
    A, C : ndarray
        The whole pair in the caller's units.
    dt : float
    form : Staircase
    F, H : ndarray, shapes (k, k) and (r, k)
        The observable pair that gains are designed for.
    to_outputs : ndarray, shape (r, p)
        Takes a gain for ``H`` to the balanced outputs.
    fixed : ndarray of complex
        The unobservable modes, all stable.
    """

    A: Matrix
    C: Matrix
    dt: float
    form: Staircase
    F: Matrix
    H: Matrix
    to_outputs: Matrix
    fixed: Poles

    @property
    def order(self) -> int:
        """Number of observable states."""
        return self.F.shape[0]

    @property
    def pseudo_inverse(self) -> Matrix:
        """A right factor ``X`` with ``C X C = C``, from balanced units."""
        form = self.form
        L = self.H.T
        seen = self._of_fewest_outputs(form.Q[:, : self.order] @ (L @ self.to_outputs), L)
        return form.states[:, None] * seen * form.outputs

    def full_gain(self, L: Matrix) -> Matrix:
        """Return ``K`` in the caller's units for a gain ``L`` of the observable part."""
        form = self.form
        K = without_rounded_gains(self._of_fewest_outputs(form.Q[:, : self.order] @ (L @ self.to_outputs), L))
        return self.without_left_null(form.states[:, None] * K * form.outputs)

    def _of_fewest_outputs(self, K: Matrix, L: Matrix) -> Matrix:
        """Return the gain, for balanced outputs, without those in which ``L`` is not told from zero.

        ``L`` is known to rounding of its norm. A combination of outputs that hardly reads a state turns that into gains
        far above rounding of their row. They are left out together, where the outputs that are left can make the same
        of the states.
        """
        known = RESIDUE * float(np.linalg.norm(L))
        small = np.abs(K) <= known * np.linalg.norm(self.to_outputs, axis=0)
        return _left_to_others(K, self.form.C, small, np.full(len(K), known))

    def without_left_null(self, K: Matrix) -> Matrix:
        """Return the gain with the same ``K C`` that ignores the left null directions of ``C``."""
        rank = self.H.shape[0]
        if rank in (0, K.shape[1]):
            return K
        U = np.linalg.svd(self.form.C)[0][:, :rank]
        U = np.where(np.any(self.form.C, axis=1)[:, None], U, 0.0)  # rounding in an empty row is no output
        basis = np.linalg.qr(U / self.form.outputs[:, None])[0]
        projected = (K @ basis) @ basis.T
        for _ in range(2):  # outputs in very different units make one projection inexact
            lost = (K - projected) @ self.C @ self.pseudo_inverse
            projected = projected + (lost @ basis) @ basis.T
        projected = np.where(np.any(self.C, axis=1), projected, 0.0)  # of an empty row all is left null
        # what the projection leaves of nothing would be a gain on outputs that the others do without
        K = without_rounded_gains(projected / self.form.outputs) * self.form.outputs
        shares = np.abs(K) * np.linalg.norm(self.C, axis=1)
        weak = shares <= RANK * shares.max(axis=1, keepdims=True, initial=0.0)
        return _left_to_others(K, self.C, weak, RESIDUE * np.linalg.norm(K @ self.C, axis=1))


def _left_to_others(K: Matrix, C: Matrix, small: NDArray[np.bool_], known: NDArray[np.float64]) -> Matrix:
    """Return a gain without small entries, where the others of their row can make the same of the states.

    That is known, in each row, to some size. A residual would read those outputs for nothing.
    """
    K = K.copy()
    for i in np.flatnonzero(np.any(small & (K != 0), axis=1)):
        rest = ~small[i]
        said = K[i, small[i]] @ C[small[i]]
        instead = np.linalg.lstsq(C[rest].T, said, rcond=DEFAULT_RTOL)[0]
        if np.linalg.norm(said - instead @ C[rest]) <= known[i]:
            K[i, small[i]] = 0.0
            K[i, rest] += instead
    return K


@cached_by_contents
def observable_part(A: ArrayLike, C: ArrayLike, dt: float) -> ObservablePart:
    """Split off the unobservable part of a pair, or say which of its modes is not stable.

    A hidden mode counts as stable only when it is inside the stability region by more than its uncertainty and 1e-10 on
    top, as in `detectability`.

    Parameters
    ----------
    A : array_like, shape (n, n)
    C : array_like, shape (p, n)
    dt : float

    Returns
    -------
    ObservablePart

    Raises
    ------
    ModelError
        If a matrix is malformed.
    DesignError
        If the pair is not detectable.
    AccuracyError
        If rounding may have decided that.
    """
    dt = arrays.sample_step(dt)
    A, C = pair(A, C)
    form = staircase(A, C)
    k, r = form.n_observable, form.n_seen
    Q1 = form.Q[:, :k]
    # The first step of the staircase is C = U S [I 0] Q'; with S^-1 U' the seen states become the outputs.
    U, s, Vh = np.linalg.svd(form.C) if form.C.size else (np.eye(len(C)), np.zeros(0), np.eye(len(A)))
    to_outputs = np.zeros((0, C.shape[0])) if not r else U[:, :r].T / s[:r, None]
    H = Vh[:r] @ Q1  # to_outputs C Q1 has lost the digits by which the outputs that s divides are smaller than others
    fixed, uncertainty = form.hidden_modes
    stable = dies_out(fixed, uncertainty, dt, form.size)
    if not stable.all():
        if may_die_out(fixed, uncertainty, dt, form.size)[~stable].all():
            raise AccuracyError(
                f"whether the pair is detectable is undecidable: rounding may have moved the mode "
                f"{describe_modes(fixed[~stable])}, one of several near one place that no output sees, across the "
                "boundary of stability; add a sensor that sees it"
            )
        raise UndetectableError(
            f"not detectable: mode {describe_modes(fixed[~stable])} is not seen by any output and is not stable "
            f"({k} of {A.shape[0]} states observable); add a sensor that sees it"
        )
    return ObservablePart(A, C, dt, form, Q1.T @ form.A @ Q1, H, to_outputs, fixed)
