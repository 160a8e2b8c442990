r"""The internal form of a continuous design that is sampled, without differences of what nearly cancels.

The continuous filter sees nothing of a plant that moves without faults: its state is :math:`\xi = T x`. The sampled one
takes an output to run straight from sample to sample, and sees how far it does not:

.. math::
   \varepsilon(s) = \delta(s) - \frac{s}{h} \delta(h), \qquad
   \delta(s) = \int_0^s \int_0^\sigma C A^2 e^{A \tau} d\tau\, d\sigma\; x_k

Integrators whose outputs run straight are not in :math:`C A^2`, exactly. In the filter driven by the plant they would
have to cancel: what rounding leaves of them, beside a difference of size :math:`h^2`, looks like one that noise moves.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear import StateSpace
from residua.linear.poles.spectrum import spectral_radius
from residua.linear.subspaces.observability import staircase
from residua.linear.systems.sampling import exponentials
from residua.plant import Plant
from residua.tolerances import LEAKAGE, above_rounding

#: The most that a plant may grow by from one sample to the next: rounding of that is then what may leak.
_MOST_GROWTH = LEAKAGE / float(np.finfo(float).eps)


def refuse_growth(plant: Plant) -> None:
    """Refuse a sampled plant that grows so far in one step that what rounding leaves beside it hides the residual."""
    growth, most = np.log(max(float(spectral_radius(plant.A)), 1.0)), np.log(_MOST_GROWTH)
    if growth > most:
        raise AccuracyError(
            f"sampled every {plant.dt:g} s the residual is lost in rounding: an unstable mode of the plant grows by "
            f"exp({growth:.0f}) from one sample to the next; take a step of at most {most / growth * plant.dt:.2g} s"
        )


def sampled_form(
    system: StateSpace, T: NDArray[np.float64], plant: Plant, sampled: StateSpace, sampled_plant: Plant, hold: str
) -> StateSpace:
    """Return what faults, disturbances and noise do to the residual of a sampled filter.

    Parameters
    ----------
    system, plant : StateSpace, Plant
        Continuous, with as many states of the plant as the sampled one has.
    T : ndarray, shape (states of the filter, states of the plant)
        ``xi = T E x`` while nothing fails, and ``E`` invertible.
    sampled, sampled_plant : StateSpace, Plant
        The same, sampled.
    hold : {"linear", "zero"}
        What outputs are taken to do between the samples.

    Returns
    -------
    StateSpace
        States of the plant that the residual sees, and ``T x`` less the state of the filter.
    """
    n_u, dt = len(plant.inputs), sampled.dt
    TE = T if plant.E is None else T @ plant.E
    own = plant.system(()).explicit()
    G = system.B[:, n_u:]
    if hold == "linear":
        TE = TE - exponentials(system.A, G, dt)[2] @ own.C  # the state that the sampled filter keeps is shifted
    p = sampled_plant.system(("fault", "disturbance", "noise"))
    through, direct = sampled.B[:, n_u:], sampled.D[:, n_u:]
    B = above_rounding(TE @ p.B - through @ p.D, np.abs(TE) @ np.abs(p.B) + np.abs(through) @ np.abs(p.D))
    order = 2 if hold == "linear" else 1
    bend, terms = own.C, np.abs(own.C)  # the first derivative of the outputs that their hold misses
    for _ in range(order):
        bend, terms = bend @ own.A, terms @ np.abs(own.A)
    bend = above_rounding(bend, terms)
    seen = staircase(own.A, above_rounding(G @ bend, np.abs(G) @ terms))
    Q = seen.Q[:, : seen.n_observable]
    A = Q.T @ seen.A @ Q
    driven = _between(system.A, G, A, bend * seen.states @ Q, order, dt)
    k, m = len(A), system.n_states
    return StateSpace(
        np.block([[scipy.linalg.expm(A * dt), np.zeros((k, m))], [driven, sampled.A]]),
        np.vstack([Q.T @ (p.B / seen.states[:, None]), B]),
        np.hstack([np.zeros((sampled.n_outputs, k)), -sampled.C]),
        direct @ p.D,
        dt=dt,
        inputs=p.inputs,
        outputs=sampled.outputs,
    )


def _between(
    Ag: NDArray[np.float64],
    G: NDArray[np.float64],
    A: NDArray[np.float64],
    bend: NDArray[np.float64],
    order: int,
    dt: float,
) -> NDArray[np.float64]:
    """Return what a state of the plant puts into the filter over a step, by how its outputs leave what is held.

    ``bend`` is their derivative of that order. In time from sample to sample, and with derivatives of size one, one
    exponential has it to the last digits however short the step is.
    """
    n, m, p = len(A), len(Ag), len(bend)
    sizes = np.abs(bend).max(axis=1, initial=0.0)
    G = G * sizes
    size = float(np.abs(G).max(initial=0.0))
    if not size:
        return np.zeros((m, n))
    G, bend = G / size, bend / np.where(sizes > 0, sizes, 1.0)[:, None]
    last = slice(n + (order - 1) * p, n + order * p)  # of the integrals of the derivative, the signal itself
    M = np.zeros((n + order * p + m,) * 2)
    M[:n, :n], M[n : n + p, :n] = A * dt, bend
    M[n + p : n + order * p, n : n + (order - 1) * p] = np.eye((order - 1) * p)
    M[-m:, last], M[-m:, -m:] = G, Ag * dt
    X = scipy.linalg.expm(M)
    driven = X[-m:, :n]
    if order == 2:  # what it is at the next sample, the filter is told, on a straight line
        driven = driven - exponentials(Ag * dt, G, 1.0)[2] @ X[last, :n]
    return size * dt ** (order + 1) * driven
