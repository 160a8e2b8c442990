"""Observers of one form: full-order, with or without unknown inputs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.evidence import Evidence
from residua.design.generator import ResidualGenerator, make_generator, stack_signals
from residua.design.internal_form import check_decoupling
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.plant import Plant


@dataclass(frozen=True, eq=False)
class Observer:
    r"""A full-order observer, with the matrices named as in paper 000.

    .. math::

       \dot z = F z + T B u + K (y - D u), \qquad \hat x = z + H (y - D u)

    with :math:`T = I - H C`, :math:`A_1 = T A`, :math:`F = A_1 - K_1 C`, :math:`K = K_1 + F H`. The error
    :math:`e = x - \hat x` obeys :math:`\dot e = F e` for any control input and any disturbance with
    :math:`T E = 0`. With ``H = 0`` it is Luenberger's observer.

    Attributes
    ----------
    plant : Plant
    F, T, A1 : ndarray, shape (n, n)
    H, K, K1 : ndarray, shape (n, outputs)
    W : ndarray, shape (residuals, outputs)
        What of the output error is used as residual: the identity, or a projection that removes the output
        directions of disturbances.
    evidence : Evidence

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (2) to (8) and (21).
    """

    plant: Plant
    F: NDArray[np.float64]
    T: NDArray[np.float64]
    H: NDArray[np.float64]
    K1: NDArray[np.float64]
    W: NDArray[np.float64]
    method: str
    decouples: bool
    evidence: Evidence = field(repr=False)

    @property
    def A1(self) -> NDArray[np.float64]:
        """``T A``."""
        return self.T @ self.plant.A

    @property
    def K2(self) -> NDArray[np.float64]:
        """``F H``."""
        return self.F @ self.H

    @property
    def K(self) -> NDArray[np.float64]:
        """``K1 + K2``."""
        return self.K1 + self.K2

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the estimation error."""
        return np.linalg.eigvals(self.F).astype(complex)

    @property
    def system(self) -> StateSpace:
        """The observer as a system from control inputs and outputs to the state estimate."""
        p = self.plant
        n = p.n_states
        return StateSpace(
            self.F,
            np.hstack([self.T @ p.Bu - self.K @ p.Du, self.K]),
            np.eye(n),
            np.hstack([-self.H @ p.Du, self.H]),
            dt=p.dt,
            inputs=[f"input {x}" for x in p.inputs] + [f"output {x}" for x in p.outputs],
            outputs=[f"estimate {x}" for x in p.states],
        )

    def estimate(self, u: ArrayLike | None, y: ArrayLike, *, dt: float | None = None) -> NDArray[np.float64]:
        """Return the state estimate over a recording, shape (time, states).

        Parameters
        ----------
        u : array_like, shape (time, inputs), or None
        y : array_like, shape (time, outputs)
        dt : float, optional
            Step of the recording; needed when the observer is continuous.
        """
        system = self.system
        if not system.is_discrete:
            if dt is None:
                raise DesignError("this observer is continuous: give the step of the recording, dt=...")
            hold = ["zero"] * len(self.plant.inputs) + ["linear"] * self.plant.n_outputs
            system = system.discretize(dt, hold=hold)
        return system.simulate(stack_signals(self.plant, u, y))

    def residual_generator(self) -> ResidualGenerator:
        r"""Return the output error as residual, :math:`r = W (y - D u - C \hat x) = W[(I - CH)(y - Du) - C z]`.

        Raises
        ------
        DesignError
            If as many disturbances are decoupled as there are measurements: the residual is then zero
            whatever fails.
        """
        p = self.plant
        through = self.W @ (np.eye(p.n_outputs) - p.C @ self.H)
        if np.abs(through).max(initial=0.0) <= 1e-10 * max(1.0, np.abs(p.C @ self.H).max(initial=0.0)):
            raise DesignError(
                f"the residual is zero whatever fails: {p.n_outputs} measurements are all used up to decouple "
                f"{len(p.disturbances)} disturbances; add a sensor or decouple fewer disturbances"
            )
        plain = p.n_outputs == len(self.W) and np.array_equal(self.W, np.eye(p.n_outputs))
        system = StateSpace(
            self.F,
            np.hstack([self.T @ p.Bu - self.K @ p.Du, self.K]),
            -self.W @ p.C,
            np.hstack([-through @ p.Du, through]),
            dt=p.dt,
            inputs=[f"input {x}" for x in p.inputs] + [f"output {x}" for x in p.outputs],
            outputs=[f"r {x}" for x in p.outputs] if plain else [f"r{i + 1}" for i in range(len(self.W))],
        )
        gains = check_decoupling(system, p, decoupled=self.decouples)
        evidence = self.evidence.extended(decoupling=gains)
        return make_generator(system, p, self.method, evidence, state_map=self.T, observer=self)
