"""Observers of one family: full or reduced order, with or without unknown inputs, regular or singular plants."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.leak import answers, leak
from residua.design.core.signals import sampled_filter, signal_names, stack_signals
from residua.design.observers.observer_gain import gain_evidence
from residua.errors import AccuracyError, DesignError
from residua.linear import StateSpace
from residua.linear.poles.observer_gain import ObserverGain
from residua.plant import Plant
from residua.tolerances import LEAK, above_rounding
from residua.words import counted, used_up


@dataclass(frozen=True, eq=False, repr=False)
class Observer:
    r"""An observer of ``E x' = A x + B u + ...``, with the matrices named as by Twardy and Kaczorek.

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

    The algebraic equations of a singular plant count as measurements: with ``J E = 0`` the estimate may use
    :math:`J A x = -J B u`. Then :math:`\hat x = M z + H (y - D u) - J B u` and :math:`M T E + H C + J A = I`.

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
    J : ndarray, shape (n, n), or None
        What the estimate takes from the algebraic equations; none for an ordinary plant.
    V : ndarray, shape (residuals, n), or None
        What of the error of the algebraic equations is in the residual, ``V E = 0``; none for an ordinary plant.

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
    J: NDArray[np.float64] | None = field(default=None, repr=False)
    V: NDArray[np.float64] | None = field(default=None, repr=False)

    @property
    def order(self) -> int:
        """Number of states of the observer."""
        return len(self.F)

    @property
    def G(self) -> NDArray[np.float64]:
        """``T B``: how control inputs enter the observer."""
        return self.T @ self.plant.B

    @property
    def _entrance(self) -> NDArray[np.float64]:
        """How controls and measurements enter, ``[T B - K D, K]``: of a control that is decoupled nothing is left."""
        p = self.plant
        return np.hstack([self.T @ p.B - self.K @ p.D, self.K])

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
        return np.asarray(np.linalg.eigvals(self.F), dtype=complex)

    @property
    def system(self) -> StateSpace:
        """The observer as a system from control inputs and outputs to the state estimate."""
        p = self.plant
        J = np.zeros((p.n_states, p.n_states)) if self.J is None else self.J
        direct = -self.H @ p.D - J @ p.B
        return StateSpace(
            self.F,
            self._entrance,
            self.M,
            np.hstack([direct, self.H]),
            dt=p.dt,
            inputs=signal_names(p),
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

        For a singular plant what the estimate misses of the algebraic equations belongs to it:
        :math:`r = W (y - D u - C \hat x) - V (A \hat x + B u)`.

        Raises
        ------
        DesignError
            If as many disturbances are decoupled as there are measurements, or all measurements were needed to
            reduce the order: the residual is then zero whatever fails.
        """
        p = self.plant
        J = np.zeros((p.n_states, p.n_states)) if self.J is None else self.J
        V = np.zeros((len(self.W), p.n_states)) if self.V is None else self.V
        read = self.W @ p.C + V @ p.A
        # what rounding leaves of nothing would be an answer
        through = above_rounding(self.W - read @ self.H, np.abs(self.W) + np.abs(read) @ np.abs(self.H))
        static = above_rounding(V - read @ J, np.abs(V) + np.abs(read) @ np.abs(J))
        states = above_rounding(-read @ self.M, np.abs(read) @ np.abs(self.M))
        system = StateSpace(
            self.F,
            self._entrance,
            states,
            np.hstack([-through @ p.D - static @ p.B, through]),
            dt=p.dt,
            inputs=signal_names(p),
            outputs=self._residual_names(),
        )
        alive = answers(system, p, np.abs(self.W) + np.abs(read) @ np.abs(self.H))
        if not alive.any():
            raise DesignError(self._why_blind())
        system = system.select(outputs=np.flatnonzero(alive))
        decouples = Decoupled(disturbances=self.decouples)
        maps = {"state_map": self.T, "static_map": None if p.E is None else static[alive]}
        return make_generator(system, p, self.method, self.evidence, decouples=decouples, observer=self, **maps)

    def __repr__(self) -> str:
        kind = f"dt={self.plant.dt:g} s" if self.plant.is_discrete else "continuous"
        return f"Observer({self.method} of {self.plant.name!r}: order {self.order}, {kind})"

    def _residual_names(self) -> list[str]:
        """Return the names of residuals: those of the outputs whose errors they are, if all differ; else numbers."""
        V = np.zeros((len(self.W), 1)) if self.V is None else self.V
        names = []
        for row, others in zip(self.W, V, strict=True):
            at = np.flatnonzero(row)
            own = len(at) == 1 and np.isclose(abs(row[at[0]]), 1.0) and not others.any()
            names.append(f"r {self.plant.outputs[int(at[0])]}" if own else "")
        return names if all(names) and len(set(names)) == len(names) else [f"r{i + 1}" for i in range(len(self.W))]

    def _why_blind(self) -> str:
        p = self.plant
        if self.order < p.n_states:
            return (
                "the residual is zero whatever fails: this observer reproduces the measurements that it uses; "
                "leave some out of the estimate, outputs=[...], and their errors become the residual"
            )
        q = len(p.disturbances)
        used = [f"{counted(q, 'disturbance')} {'is' if q == 1 else 'are'} decoupled"] if q else []
        used += ["states have no equation of their own"] if p.E is not None else []
        return (
            f"the residual is zero whatever fails: the {used_up(p.n_outputs)} "
            f"({' and '.join(used)}); add a sensor or decouple fewer disturbances"
        )


def balanced_observer(plant: Plant, gain: ObserverGain, evidence: Evidence, used: list[int] | None = None) -> Observer:
    """Return the full-order observer ``F = A - K C`` of a gain for the balanced plant, in the units of the plant.

    Its residual is the error of the outputs that are used, all when omitted.
    """
    units, n, p = plant.balanced.units, plant.n_states, plant.n_outputs
    K = units.states[:, None] * gain.K * units.outputs * units.rate
    W = np.eye(p) if used is None else np.eye(p)[used]
    F = plant.A - K @ plant.C
    evidence = evidence.extended(**gain_evidence(gain, units.rate))
    return Observer(plant, F, np.eye(n), K, np.eye(n), np.zeros((n, p)), W, evidence.method, False, evidence)


def with_checked_estimate(observer: Observer) -> Observer:
    """Return an observer with how far its estimate is off the state in its evidence, or raise where that is too far.

    The response of the error to the controls, and to the disturbances that are decoupled, peak over peak of the state.
    """
    p = observer.plant
    unknown = (p.Bd, p.Dd) if observer.decouples else (p.Bd[:, :0], p.Dd[:, :0])
    found = leak(
        observer.system, p, observer.T, _read_equations(observer), unknown=unknown, estimate=np.eye(p.n_states)
    )
    worst = float(found.gains.max(initial=0.0))
    if not worst <= LEAK:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} (relative, limit {LEAK:.0e}): the measurements see "
            "part of the plant too weakly; add a sensor, or ask for slower poles"
        )
    evidence = observer.evidence.extended(conditions={"estimate off the state": worst})
    return replace(observer, evidence=evidence)


def _read_equations(observer: Observer) -> NDArray[np.float64] | None:
    """Return how the estimate reads the algebraic equations, ``J (A x + B u) = 0``; none for an ordinary plant."""
    return observer.J
