"""Observers of one family: full or reduced order, with or without unknown inputs, regular or singular plants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.design.core.decoupling import Decoupled, answers, leak
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.signals import sampled_filter, signal_names, stack_signals
from residua.errors import AccuracyError, DesignError
from residua.linear import StateSpace
from residua.linear.subspaces.quotient import without_rounding
from residua.plant import Plant
from residua.plant.balanced import BalancedPlant
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
        """``T B``: the entry of control inputs into the observer."""
        return self.T @ self.plant.B

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
        return plant_filter(
            self.plant, self.F, self.T, self.K, self.M, self.H, self.J, [f"estimate {x}" for x in self.plant.states]
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
        p, n = self.plant, self.plant.n_states
        J = np.zeros((n, n)) if self.J is None else self.J
        V = np.zeros((len(self.W), n)) if self.V is None else self.V
        read = self.W @ p.C + V @ p.A
        # what rounding leaves of nothing would be an answer
        through = above_rounding(self.W - read @ self.H, np.abs(self.W) + np.abs(read) @ np.abs(self.H))
        static = above_rounding(V - read @ J, np.abs(V) + np.abs(read) @ np.abs(J))
        states = above_rounding(-read @ self.M, np.abs(read) @ np.abs(self.M))
        names = []
        for row, others in zip(self.W, V, strict=True):  # the output whose error a residual is
            at = np.flatnonzero(row)
            if len(at) == 1 and np.isclose(abs(row[at[0]]), 1.0) and not others.any():
                names.append(f"r {p.outputs[int(at[0])]}")
        if len(set(names)) < len(self.W):
            names = [f"r{i + 1}" for i in range(len(self.W))]
        system = plant_filter(p, self.F, self.T, self.K, states, through, static, names)
        alive = answers(system, p, np.abs(self.W) + np.abs(read) @ np.abs(self.H))
        if not alive.any():
            raise DesignError(self._why_blind())
        return make_generator(
            system.select(outputs=np.flatnonzero(alive)),
            p,
            self.method,
            self.evidence,
            decouples=Decoupled(disturbances=self.decouples),
            observer=self,
            state_map=self.T,
            static_map=None if p.E is None else static[alive],
        )

    def __repr__(self) -> str:
        kind = f"dt={self.plant.dt:g} s" if self.plant.is_discrete else "continuous"
        return f"Observer({self.method} of {self.plant.name!r}: order {self.order}, {kind})"

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


def plant_filter(
    plant: Plant,
    F: NDArray,
    T: NDArray,
    K: NDArray,
    C: NDArray,
    L: NDArray,
    V: NDArray | None,
    outputs: Sequence[str],
) -> StateSpace:
    r"""Return :math:`\dot z = F z + T B u + K (y - D u)` with the outputs :math:`C z + L (y - D u) - V B u`."""
    # of a control that is decoupled nothing is left
    entering = above_rounding(T @ plant.B - K @ plant.D, np.abs(T) @ np.abs(plant.B) + np.abs(K) @ np.abs(plant.D))
    direct = -L @ plant.D if V is None else -L @ plant.D - V @ plant.B
    B, D = np.hstack([entering, K]), np.hstack([direct, L])
    return StateSpace(F, B, C, D, dt=plant.dt, inputs=signal_names(plant), outputs=outputs)


def plant_observer(
    model: BalancedPlant,
    F: NDArray,
    T: NDArray,
    K: NDArray,
    W: NDArray,
    evidence: Evidence,
    *,
    M: NDArray | None = None,
    H: NDArray | None = None,
    J: NDArray | None = None,
    V: NDArray | None = None,
    decouples: bool = True,
) -> Observer:
    """Return an observer of a balanced plant in the units of that plant; ``W`` and ``V`` are in these already.

    Without ``M`` the states of the observer are those of the plant, ``H`` is zero without ``H``.
    """
    units, n = model.units, model.plant.n_states
    R, X, Y = units.equations, units.states[:, None], units.outputs
    z = X if M is None else np.ones((len(F), 1))
    return Observer(
        model.plant,
        units.rate * z * without_rounding(F) / z.T,
        z * T * R,
        units.rate * z * K * Y,
        np.eye(n) if M is None else X * M,
        np.zeros((n, len(Y))) if H is None else X * H * Y,
        W,
        evidence.method,
        decouples,
        evidence,
        J=None if J is None else X * J * R / units.rate,
        V=V,
    )


def balanced_observer(model: BalancedPlant, K: NDArray, evidence: Evidence, used: list[int] | None = None) -> Observer:
    """Return the full-order observer ``F = A - K C`` of a gain for some outputs of a balanced plant, all when omitted.

    Its residual is the error of these outputs.
    """
    W = np.eye(len(model.C)) if used is None else np.eye(len(model.C))[used]
    K = K @ W
    return plant_observer(model, model.A - K @ model.C, np.eye(len(model.A)), K, W, evidence, decouples=False)


def with_checked_estimate(observer: Observer) -> Observer:
    """Return an observer with the error of its estimate in its evidence, or raise for a large one.

    The response of the error to the controls, and to the disturbances that are decoupled, peak over peak of the state.
    """
    p = observer.plant
    unknown = (p.Bd, p.Dd) if observer.decouples else (p.Bd[:, :0], p.Dd[:, :0])
    found = leak(observer.system, p, observer.T, observer.J, unknown=unknown, estimate=np.eye(p.n_states))
    worst = float(found.gains.max(initial=0.0))
    if not worst <= LEAK:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} (relative, limit {LEAK:.0e}): the measurements see "
            "part of the plant too weakly; add a sensor, or ask for slower poles"
        )
    return replace(observer, evidence=observer.evidence.extended(conditions={"estimate off the state": worst}))
