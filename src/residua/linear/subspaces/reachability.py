"""Where signals can go: reachable subspaces, exact removal of hidden states."""

from __future__ import annotations

from residua.linear.subspaces.observability import staircase
from residua.linear.systems.state_space import StateSpace


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
