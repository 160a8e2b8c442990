"""Sampling of continuous systems: exact for inputs that are held, or linear, between the samples."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua import arrays
from residua.errors import ModelError
from residua.linear.systems.state_space import StateSpace
from residua.tolerances import TINY

HOLDS = ("zero", "linear")


def sample(system: StateSpace, dt: float, *, hold: str | Iterable[str] = "zero") -> StateSpace:
    r"""Return the sampled system that equals the continuous one at the sample instants.

    With :math:`\Phi = e^{A h}` and, for inputs that are held over a step,
    :math:`\Gamma_1 = \int_0^h e^{A s} ds\, B`, the sampled system is
    :math:`x_{k+1} = \Phi x_k + \Gamma_1 v_k`. For inputs that run linearly from sample to sample,
    with :math:`\Gamma_2 = \tfrac1h \int_0^h \int_0^{s} e^{A \tau} d\tau\, ds\, B`, the state
    :math:`\xi = x - \Gamma_2 v` obeys a causal recursion with
    :math:`B = \Gamma_1 + (\Phi - I) \Gamma_2` and :math:`D + C \Gamma_2`.

    Parameters
    ----------
    system : StateSpace
        Continuous; ``E`` must be invertible.
    dt : float
        Step in seconds, positive.
    hold : {"zero", "linear"} or sequence of them
        What each input does between samples; one word for all inputs or one word per input.

    Returns
    -------
    StateSpace
        With ``dt`` set. Its states at the samples are those of ``system``, shifted by ``Gamma_2 v`` for
        linear inputs.

    Raises
    ------
    ModelError
        If the system is already sampled, ``E`` is singular, or ``dt`` is not positive.

    Examples
    --------
    >>> from residua.linear import StateSpace, sample
    >>> sample(StateSpace([[-1.0]], [[1.0]], [[1.0]]), 0.1).A.round(6)
    array([[0.904837]])
    """
    if system.is_discrete:
        raise ModelError(f"the system is sampled already (dt={system.dt:g})")
    step = arrays.sample_step(dt)
    if step == 0:
        raise ModelError("dt must be a positive step in seconds")
    kinds = [hold] * system.n_inputs if isinstance(hold, str) else list(hold)
    if len(kinds) != system.n_inputs:
        raise ModelError(f"hold: expected {system.n_inputs} words, one per input, got {len(kinds)}")
    for kind in kinds:
        if kind not in HOLDS:
            raise ModelError(f"hold must be 'zero' or 'linear', got {kind!r}")
    system = system.explicit()
    Phi, Gamma1, Gamma2 = exponentials(system.A, system.B, step)
    linear = np.array([kind == "linear" for kind in kinds], dtype=bool)
    G2 = Gamma2 * linear
    B = Gamma1 + np.where(linear, Phi @ Gamma2 - Gamma2, 0.0)
    return system.replaced(A=Phi, B=B, D=system.D + system.C @ G2, dt=step)


def exponentials(A: NDArray, B: NDArray, dt: float) -> tuple[NDArray, NDArray, NDArray]:
    """Return ``exp(A h)`` and the two input integrals of :func:`sample` from one matrix exponential."""
    n, m = B.shape
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, m)), np.zeros((0, m))
    M = np.zeros((n + 2 * m, n + 2 * m))
    M[:n, :n] = A * dt
    M[:n, n : n + m] = B * dt
    M[n : n + m, n + m :] = np.eye(m)
    X = scipy.linalg.expm(M)
    return X[:n, :n], X[:n, n : n + m], X[:n, n + m :]


def noise_covariance(A: NDArray, Q: NDArray, dt: float) -> NDArray:
    """Return the covariance that white noise of intensity ``Q`` adds to the state over one step.

    ``int_0^h exp(A s) Q exp(A s)' ds``: Van Loan's exponential over a step so short that it is well scaled,
    then doubled up to ``h``.
    """
    n = A.shape[0]
    if n == 0:
        return np.zeros((0, 0))
    doublings = max(0, int(np.ceil(np.log2(max(np.linalg.norm(A, 1) * dt, TINY)))))
    h = dt / 2**doublings
    M = np.zeros((2 * n, 2 * n))
    M[:n, :n] = -A * h
    M[:n, n:] = Q * h
    M[n:, n:] = A.T * h
    X = scipy.linalg.expm(M)
    Phi = X[n:, n:].T
    covariance = Phi @ X[:n, n:]
    for _ in range(doublings):
        covariance = covariance + Phi @ covariance @ Phi.T
        Phi = Phi @ Phi
    return (covariance + covariance.T) / 2
