"""Observers of one family: full or reduced order, with or without unknown inputs, regular or singular plants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.unknown_input import algebraic_equations, output_free_form
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.internal_form import frequency_grid
from residua.design.core.own_time import has_rates, in_own_time
from residua.design.core.signals import sampled_filter, signal_names, stack_signals
from residua.errors import DesignError
from residua.linear import StateSpace
from residua.linear.poles.matrix_poles import explicit_poles
from residua.linear.systems.array_cache import copied
from residua.linear.systems.balancing import power_of_two, sum_without_rounding, without_rounding
from residua.linear.systems.response_terms import in_even_units, response_terms
from residua.plant import Plant
from residua.plant.comparable_units import EvenPlant, PlantUnits, canonical_units, even_plant
from residua.tolerances import DESIGN_ROUNDING, TINY, above_rounding
from residua.words import counted, used_up


@has_rates(F=1, K=1, J=-1, V=-1)
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
        return without_rounding(self.T, self.plant.B)

    @property
    def _entrance(self) -> NDArray[np.float64]:
        """How controls and measurements enter, ``[T B - K D, K]``: of a control that is decoupled nothing is left."""
        p = self.plant
        return np.hstack([sum_without_rounding((self.T, p.B), (-self.K, p.D)), self.K])

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
        return explicit_poles(self.F)

    @property
    def system(self) -> StateSpace:
        """The observer as a system from control inputs and outputs to the state estimate."""
        p = self.plant
        J = np.zeros((p.n_states, p.n_states)) if self.J is None else self.J
        direct = sum_without_rounding((-self.H, p.D), (-J, p.B))
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

    @in_own_time()
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
        even = even_plant(p)  # what is rounding does not depend on the units of the plant
        R, S, Y = even.equations, even.states, even.outputs
        z = S if self.order == p.n_states else np.ones(self.order)
        through = _without_rounding(self.W / Y, -read * S, self.H / S[:, None] / Y) * Y
        states = _without_rounding(np.zeros((len(self.W), self.order)), -read * S, self.M / S[:, None] * z) / z
        static = _without_rounding(V / R, -read * S, J / S[:, None] / R) * R
        terms = np.abs(self.W) + np.abs(read) @ np.abs(self.H)
        alive = _more_than(through / Y, terms / Y) | _path(static / R, read * S, J / S[:, None] / R)
        if not alive.any():
            raise DesignError(self._why_blind())
        keep = alive if self.V is not None or alive.all() else alive | self._copies(states, through)
        # of a control that enters nothing rounding would be all that there is
        sizes = terms @ np.abs(p.D) + (np.abs(V) + np.abs(read) @ np.abs(J)) @ np.abs(p.B)
        direct = above_rounding(-through @ p.D - static @ p.B, sizes)[keep]
        through, states, static = through[keep], states[keep], static[keep]
        system = StateSpace(
            self.F,
            self._entrance,
            states,
            np.hstack([direct, through]),
            dt=p.dt,
            inputs=signal_names(p),
            outputs=[name for name, kept in zip(self._residual_names(), keep, strict=True) if kept],
        )
        decouples = Decoupled(disturbances=self.decouples)
        maps = {"state_map": self.T, "static_map": None if p.E is None else static}
        return make_generator(system, p, self.method, self.evidence, decouples=decouples, observer=self, **maps)

    def __repr__(self) -> str:
        kind = f"dt={self.plant.dt:g} s" if self.plant.is_discrete else "continuous"
        return f"Observer({self.method} of {self.plant.name!r}: order {self.order}, {kind})"

    def _copies(self, states: NDArray, through: NDArray) -> NDArray[np.bool_]:
        """Tell which rows of a residual hear the measurements by way of the state, as filtered copies of other rows."""
        system = in_even_units(StateSpace(self.F, self.K, states, through, dt=self.plant.dt)).system
        w = frequency_grid(system, points=12)
        points = np.asarray(np.exp(1j * w * system.dt) if system.is_discrete else 1j * w, dtype=np.complex128)
        response = response_terms(system, points)
        return np.any(np.abs(response.values) > DESIGN_ROUNDING * response.terms, axis=(0, 2))

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


def in_units_of_the_plant(observer: Observer, plant: Plant, even: EvenPlant) -> Observer:
    """Return an observer that was designed for a plant in even units, for the plant itself."""
    return observer_in_units_of(observer, plant, even.units)


def observer_in_units_of(observer: Observer, plant: Plant, units: PlantUnits) -> Observer:
    """Return an observer for a scaled plant as one for the plant.

    The states of a full-order observer take the units of the plant's; a residual that is the error of one output that
    of this output, and any other stays as large as it is.
    """
    S, Y = units.states, units.outputs
    R = 1 / S if observer.plant.E is None else units.equations  # an E may have been divided out
    own = S if observer.order == plant.n_states else np.ones(observer.order)
    rows = 1 / power_of_two(np.abs(observer.W * Y).max(axis=1, initial=0.0))
    return replace(
        observer,
        plant=plant,
        F=own[:, None] * observer.F / own,
        T=own[:, None] * observer.T * R,
        K=own[:, None] * observer.K * Y,
        M=S[:, None] * observer.M / own,
        H=S[:, None] * observer.H * Y,
        W=rows[:, None] * observer.W * Y,
        J=None if observer.J is None else S[:, None] * observer.J * R,
        V=None if observer.V is None else rows[:, None] * observer.V * R,
    )


def kept_observer_for(plant: Plant, design: Callable[[Plant], Observer]) -> Observer:
    """Return what a design makes, and keeps, of the plant in canonical units, as one to hand out, for the plant."""
    units = canonical_units(plant)
    own = design(units.applied(plant))
    if own.plant.E is None:
        plant = plant.explicit()
    return observer_in_units_of(copied(own), plant, units)


def without_measured_equations(observer: Observer, plant: Plant, N: NDArray) -> Observer:
    """Return an observer that was designed with the algebraic equations ``N`` as last outputs, for the plant itself.

    Those outputs read zero, so that their columns go over into ``T``, ``J`` and ``V``. Without any the equations
    that no disturbance enters are added to the residual, once outputs have told what the disturbances in them are.
    """
    p = plant.n_outputs
    K, H, W = observer.K, observer.H, observer.W
    V = without_rounding(W[:, p:], N)
    if not len(N):
        form = output_free_form(plant)
        V = algebraic_equations(plant, without=form.E)
        W = np.vstack([W, -without_rounding(V, form.G)])
        V = np.vstack([np.zeros((len(observer.W), plant.n_states)), V])
    return replace(
        observer,
        plant=plant,
        T=sum_without_rounding((observer.T, np.eye(plant.n_states)), (-K[:, p:], N)),
        K=K[:, :p],
        H=H[:, :p],
        W=W[:, :p],
        J=without_rounding(H[:, p:], N),
        V=V,
    )


def _without_rounding(direct: NDArray, read: NDArray, factor: NDArray) -> NDArray[np.float64]:
    """Return ``direct + read factor``, exactly zero where it is nothing beside the largest term of its row.

    An estimate is known to the rounding of its largest part: what is left of a measurement that the estimate
    reproduces is no residual, however small its own terms are.
    """
    largest = np.abs(read).max(axis=1, initial=0.0)[:, None] * np.abs(factor).max(axis=0, initial=0.0)
    terms = (np.abs(direct) + largest).max(axis=1, keepdims=True, initial=0.0)
    total = direct + read @ factor
    return above_rounding(total, (1 + read.shape[1]) * terms)


def _more_than(values: NDArray, terms: NDArray) -> NDArray[np.bool_]:
    """Tell in which rows something is more than the rounding of the terms that it is made of."""
    return np.abs(values).max(axis=1, initial=0.0) > 1e-10 * np.maximum(TINY, terms.max(axis=1, initial=0.0))


def _path(direct: NDArray, read: NDArray, factor: NDArray) -> NDArray[np.bool_]:
    """Tell in which rows ``read`` times a factor, in a residual, is more than rounding."""
    return _more_than(direct, np.abs(direct + read @ factor) + np.abs(read) @ np.abs(factor))
