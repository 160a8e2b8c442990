"""Observers of one family: full or reduced order, with or without unknown inputs, regular or singular plants."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.evidence import Evidence
from residua.design.generator import ResidualGenerator, make_generator, sampled_filter, stack_signals
from residua.design.internal_form import check_decoupling
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.linear.balancing import descriptor_units
from residua.linear.rank import left_null_basis
from residua.plant import Plant


@dataclass(frozen=True, eq=False)
class Observer:
    r"""An observer of ``E x' = A x + B u + ...``, with the matrices named as in paper 001.

    .. math::

       \dot z = F z + T B u + K (y - D u), \qquad \hat x = M z + H (y - D u)

    with :math:`T A - K C = F T E` and :math:`M T E + H C = I`. The error of what it tracks,
    :math:`\varepsilon = T E x - z`, obeys :math:`\dot\varepsilon = F \varepsilon` for any control input and any
    disturbance that it decouples, and :math:`x - \hat x = M \varepsilon`. Every observer here is of this form:

    ========================  ===========  ======================================
    observer                  order        special about it
    ========================  ===========  ======================================
    Luenberger                n            T = I, M = I, H = 0
    unknown input             n            M = I, T E + H C = I, T E_d = 0
    reduced order             n - p        [M H] is the inverse of [T; C]
    descriptor                n - p        [M H] is the inverse of [T E; C]
    ========================  ===========  ======================================

    A perfect observer has no dynamics and is a class of its own, :class:`residua.design.PerfectObserver`.

    Attributes
    ----------
    plant : Plant
    F : ndarray, shape (r, r)
        ``r`` is the order of the observer.
    T : ndarray, shape (r, n)
    K : ndarray, shape (r, outputs)
    M : ndarray, shape (n, r)
    H : ndarray, shape (n, outputs)
    W : ndarray, shape (residuals, outputs)
        What of the output error is used as residual: the identity, or a projection that removes the output
        directions of disturbances, or outputs that the observer does not use.
    evidence : Evidence

    References
    ----------
    Chen, Patton and Zhang (1996), eqs. (2) to (8) and (21); Twardy and Kaczorek, part I, eqs. (3), (18) to (29).
    """

    plant: Plant
    F: NDArray[np.float64]
    T: NDArray[np.float64]
    K: NDArray[np.float64]
    M: NDArray[np.float64]
    H: NDArray[np.float64]
    W: NDArray[np.float64]
    method: str
    decouples: bool
    evidence: Evidence = field(repr=False)

    @property
    def order(self) -> int:
        """Number of states of the observer."""
        return len(self.F)

    @property
    def G(self) -> NDArray[np.float64]:
        """``T B``: how control inputs enter the observer."""
        return self.T @ self.plant.Bu

    @property
    def A1(self) -> NDArray[np.float64]:
        """``T A``."""
        return self.T @ self.plant.A

    @property
    def K1(self) -> NDArray[np.float64]:
        """``K - F H``, of a full-order observer: ``F = A1 - K1 C``."""
        return self.K - self.K2

    @property
    def K2(self) -> NDArray[np.float64]:
        """``F H``, of a full-order observer."""
        if self.order != self.plant.n_states:
            raise DesignError("K1 and K2 belong to full-order observers; this one has K alone")
        return self.F @ self.H

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the estimation error."""
        return np.linalg.eigvals(self.F).astype(complex)

    @property
    def system(self) -> StateSpace:
        """The observer as a system from control inputs and outputs to the state estimate."""
        p = self.plant
        return StateSpace(
            self.F,
            np.hstack([self.G - self.K @ p.Du, self.K]),
            self.M,
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
            Step of the recording; needed when the observer is continuous. It is then sampled with inputs held
            and outputs linear between samples; the error of that is of second order in the step.
        """
        return sampled_filter(self.system, self.plant, dt).simulate(stack_signals(self.plant, u, y))

    def residual_generator(self) -> ResidualGenerator:
        r"""Return the output error as residual, :math:`r = W (y - D u - C \hat x) = W[(I - CH)(y - Du) - C M z]`.

        A singular plant has algebraic equations that the estimate should satisfy, and what they miss is residual, too:
        :math:`V (A \hat x + B u)`, with :math:`V [E\ E_d] = 0`.

        Raises
        ------
        DesignError
            If as many disturbances are decoupled as there are measurements, or all measurements were needed to
            reduce the order: the residual is then zero whatever fails.
        """
        p = self.plant
        V = self._algebraic_equations()
        through = np.vstack([self.W @ (np.eye(p.n_outputs) - p.C @ self.H), V @ p.A @ self.H])
        states = np.vstack([-self.W @ p.C @ self.M, V @ p.A @ self.M])
        rows = len(self.W)
        if np.abs(through[:rows]).max(initial=0.0) <= 1e-10 * max(1.0, np.abs(p.C @ self.H).max(initial=0.0)):
            if not (np.abs(through[rows:]).max(initial=0.0) > 0 or np.abs(states[rows:]).max(initial=0.0) > 0):
                raise DesignError(self._why_blind())
            through, states, rows = through[rows:], states[rows:], 0
        direct = -through @ p.Du
        direct[rows:] += V @ p.Bu
        system = StateSpace(
            self.F,
            np.hstack([self.G - self.K @ p.Du, self.K]),
            states,
            np.hstack([direct, through]),
            dt=p.dt,
            inputs=[f"input {x}" for x in p.inputs] + [f"output {x}" for x in p.outputs],
            outputs=[*(self._residual_names() if rows else []), *(f"equation {i + 1}" for i in range(len(V)))],
        )
        gains = check_decoupling(system, p, decoupled=self.decouples)
        evidence = self.evidence.extended(decoupling=gains)
        static = np.vstack([np.zeros((rows, p.n_states)), -V]) if len(V) else None
        return make_generator(system, p, self.method, evidence, state_map=self.T, static_map=static, observer=self)

    def _algebraic_equations(self) -> NDArray[np.float64]:
        """Return combinations of the plant's equations without derivatives and disturbances, of unit size."""
        p = self.plant
        if p.E is None:
            return np.zeros((0, p.n_states))
        u = descriptor_units(p.A, p.E, np.hstack([p.Bu, p.Bd]), p.C, np.hstack([p.Du, p.Dd]))
        E, D = u.equations[:, None] * p.E * u.states, u.equations[:, None] * p.Bd
        E, size = E / (np.linalg.norm(E) or 1.0), np.linalg.norm(D, axis=0)
        V = left_null_basis(np.hstack([E, D / np.where(size > 0, size, 1.0)]))[0].T
        V = np.where(np.abs(V) > 1e-14, V, 0.0) * u.equations
        return V / np.maximum(np.abs(V).max(axis=1, keepdims=True, initial=0.0), 1e-300)

    def _residual_names(self) -> list[str]:
        """Return the output that a residual is the error of, where it is one, and numbers elsewhere."""
        if self.plant.n_outputs == len(self.W) and np.array_equal(self.W, np.eye(len(self.W))):
            return [f"r {x}" for x in self.plant.outputs]
        single = [np.flatnonzero(row) if np.isclose(np.abs(row).max(), 1.0) else np.zeros(2) for row in self.W]
        names = [f"r {self.plant.outputs[int(at[0])]}" if len(at) == 1 else "" for at in single]
        return names if all(names) and len(set(names)) == len(names) else [f"r{i + 1}" for i in range(len(self.W))]

    def _why_blind(self) -> str:
        p = self.plant
        if self.order < p.n_states:
            return (
                "the residual is zero whatever fails: this observer reproduces the measurements that it uses; "
                "leave some out of the estimate, outputs=[...], and their errors become the residual"
            )
        used = [f"{len(p.disturbances)} disturbances are decoupled"] if p.disturbances else []
        used += ["states have no equation of their own"] if p.E is not None else []
        return (
            f"the residual is zero whatever fails: the {p.n_outputs} measurements are all used up "
            f"({' and '.join(used)}); add a sensor or decouple fewer disturbances"
        )
