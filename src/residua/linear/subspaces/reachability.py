"""Where signals can go: reachable subspaces, exact removal of hidden states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from residua.linear.subspaces.observability import staircase
from residua.linear.subspaces.rank import DEFAULT_RTOL, range_basis, spectral_norm
from residua.linear.systems.state_space import StateSpace


def reachable_basis(A: NDArray, B: NDArray, *, rtol: float = DEFAULT_RTOL) -> NDArray:
    """Return an orthonormal basis of the smallest ``A``-invariant subspace that contains the range of ``B``.

    New directions are sought in the part of ``A V`` that is orthogonal to what is there already, with
    tolerances relative to the norms of ``A`` and ``B``, so that a power of ``A`` is never formed.
    """
    V, _ = range_basis(B, rtol=rtol)
    fresh = V
    scale = max(spectral_norm(A), np.finfo(float).tiny)
    while fresh.shape[1] and V.shape[1] < A.shape[0]:
        candidate = A @ fresh
        for _ in range(2):  # twice is enough to stay orthogonal
            candidate = candidate - V @ (V.T @ candidate)
        fresh, _ = range_basis(candidate, rtol=rtol, scale=scale)
        V = np.hstack([V, fresh])
    return V


def without_unobservable(system: StateSpace) -> StateSpace:
    """Return the system without the states that no output sees; its transfer matrix is unchanged.

    The kept states are an orthonormal basis, in balanced units, of the observable quotient, so that hidden
    unstable modes go away without being cancelled numerically.
    """
    system = system.explicit()
    form = staircase(system.A, system.C)
    k = form.n_observable
    if k == system.n_states:
        return system
    Q = form.Q[:, :k]
    return system.replaced(
        A=Q.T @ form.A @ Q,
        B=Q.T @ (system.B / form.states[:, None]),
        C=(system.C * form.states) @ Q,
        states=None,
    )
