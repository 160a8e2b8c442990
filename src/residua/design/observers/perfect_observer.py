"""Perfect observers: the state of a singular plant from its signals and their derivatives, without dynamics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.balanced_filter import Resolvent, state_map_of
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import least_order_unless_singular, method
from residua.design.core.signals import sampled_filter, signal_names, stack_signals
from residua.design.observers.perfect_gain import (
    PerfectGain,
    PlantPencil,
    full_rank_gain,
    given_gain,
    least_order_gain,
)
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import StateSpace, decide_rank, invariant_zeros
from residua.linear.norms.system_norms import h2_norm, hinf_norm
from residua.linear.poles.spectrum import balanced_rate, describe_modes
from residua.linear.subspaces.rank import left_null_basis, without_noise
from residua.plant import Plant
from residua.tolerances import BALANCED_RANK, DESIGN_ROUNDING, LEAK, SAME, above_rounding
from residua.words import counted, used_up

REFERENCE = "Twardy and Kaczorek, part I, eqs. (30) to (33), Theorem 4, Procedure 2"
#: States of a filter beyond which its peak gain is not computed.
MOST_STATES = 300
#: A state whose response is below this part of the largest is moved by nothing: its error is compared with the largest.
_LEAST_STATE = 1e-6
#: Coefficients, and for each of their entries the sum of the magnitudes of the terms that it is made of.
Terms = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class PerfectObserver:
    r"""An observer without dynamics: its estimate is the state, not something that tends to it.

    With ``X = (x, d)`` the state and the disturbances of the plant, ``T [A Bd] + L [C Dd] = I`` and
    ``N = T [E 0]`` nilpotent,

    .. math::

       N \dot{\hat X} = \hat X + T B u - L (y - D u) \quad\Longrightarrow\quad
       \hat X = -\sum_{i < \mu} N^i \left( T B u^{(i)} - L (y - D u)^{(i)} \right)

    and the error is a differential polynomial of the faults,
    :math:`X - \hat X = -\sum_{i < \mu} N^i (T B_f + L D_f) f^{(i)}`. For a singular plant without disturbances
    ``T`` is invertible, and with :math:`K = T^{-1} L` this is
    :math:`E \dot{\hat x} = A \hat x + B u + K (C \hat x - y)`, ``D = 0``.

    It runs as a filter: continuous, everything passes :math:`1/(\tau s + 1)^m`, ``m`` the number of
    derivatives and ``tau = 1 / bandwidth``, so that the estimate is the equally filtered state; sampled, it is a finite
    sum of the last samples and gives the state of ``m`` steps ago.

    Attributes
    ----------
    plant : Plant
    outputs : tuple of str
        The outputs that drive it.
    T : ndarray, shape (states + disturbances, states)
    L : ndarray, shape (states + disturbances, outputs that drive it)
    N : ndarray, shape (states + disturbances, states + disturbances)
    index : int
        ``mu``, the smallest ``k`` with ``N^k = 0``.
    bandwidth : float
        Of the filter, in rad/s; not used in sampled time.
    complete : bool
        Whether ``T`` has full column rank, so that the output error shows all that the plant's equations can.
    evidence : Evidence
    gain : PerfectGain
        The choice behind ``T``, ``L`` and ``N``, in balanced units, with its checks.
    left : ndarray
        The rows that the residual reads: ``W`` of the output error, or, of least order, of all equations.

    References
    ----------
    Twardy and Kaczorek, part I, section 2.6, eqs. (30) to (33), Definition 5 and Theorem 4.
    """

    plant: Plant
    outputs: tuple[str, ...]
    T: NDArray[np.float64]
    L: NDArray[np.float64]
    N: NDArray[np.float64]
    index: int
    bandwidth: float
    complete: bool
    evidence: Evidence = field(repr=False)
    gain: PerfectGain = field(repr=False)
    left: NDArray[np.float64] = field(repr=False)

    # ------------------------------------------------------------------- facts

    @property
    def K(self) -> NDArray[np.float64]:
        """The gain of ``E xh' = A xh + B u + K (C xh - y)``; singular plants without disturbances only."""
        if not self.complete or self.T.shape[0] != self.T.shape[1]:
            raise DesignError(
                "K and A + K C belong to observers of singular plants without disturbances, and with full T; this one "
                "is N xh' = xh + T B u - L y"
            )
        return np.asarray(np.linalg.solve(self.T, self.L), dtype=float)

    @property
    def Ab(self) -> NDArray[np.float64]:
        """``A + K C``, whose inverse is ``T``; singular plants without disturbances only."""
        return self.plant.A + self.K @ self.plant.C[self.rows]

    @property
    def rows(self) -> list[int]:
        """Numbers of the outputs that drive it."""
        return arrays.positions(self.outputs, self.plant.outputs, "output")

    @property
    def derivatives(self) -> int:
        """Number of derivatives of the inputs and outputs that the state estimate takes (sampled: steps)."""
        return len(self._estimate(slice(0, self.plant.n_states))) - 1

    @property
    def delay(self) -> float:
        """Lag of the state estimate in seconds: steps times ``dt``, or the sum of the lags of the filter."""
        return self.derivatives * (self.plant.dt or 1.0 / self.bandwidth)

    @property
    def system(self) -> StateSpace:
        """The filter from control inputs and outputs to the state estimate."""
        return self._filter(self._estimate(slice(0, self.plant.n_states)), [f"estimate {x}" for x in self.plant.states])

    @property
    def disturbance_system(self) -> StateSpace:
        """The filter from control inputs and outputs to the estimate of the disturbances."""
        n = self.plant.n_states
        return self._filter(self._estimate(slice(n, None)), [f"estimate {x}" for x in self.plant.disturbances])

    def estimate(self, u: ArrayLike | None, y: ArrayLike, *, dt: float | None = None) -> NDArray[np.float64]:
        """Return the state estimate over a recording, shape (time, states); late by :attr:`delay`.

        Parameters
        ----------
        u : array_like, shape (time, inputs), or None
        y : array_like, shape (time, outputs)
            All outputs of the plant, also those that do not drive the observer.
        dt : float, optional
            Step of the recording; needed when the observer is continuous. It is then sampled with inputs held
            and outputs linear between samples; keep ``bandwidth * dt`` below one.
        """
        return sampled_filter(self.system, self.plant, dt).simulate(stack_signals(self.plant, u, y))

    def estimate_disturbances(
        self, u: ArrayLike | None, y: ArrayLike, *, dt: float | None = None
    ) -> NDArray[np.float64]:
        """Return the estimate of the disturbances, shape (time, disturbances); arguments of :meth:`estimate`."""
        return sampled_filter(self.disturbance_system, self.plant, dt).simulate(stack_signals(self.plant, u, y))

    # ---------------------------------------------------------------- residuals

    def polynomial(self) -> dict[str, NDArray[np.float64]]:
        """Return the coefficients of ``f, f', f'', ...`` of each fault in the unfiltered residual.

        Each is an array of shape (order + 1, residuals); in sampled time of ``f`` now, one step later, and so on.
        """
        p = self.plant
        P = self._residual(np.vstack([p.Bf, p.Df[self.rows]]))
        return {name: np.array([one[:, i] for one in P]) for i, name in enumerate(p.faults)}

    def residual_generator(self) -> ResidualGenerator:
        r"""Return the output error ``r = W (y - D u - C xh - Dd dh)`` of the outputs that drive it, filtered alike.

        It is zero, without any transient, while nothing fails, and a differential polynomial of the faults
        otherwise. ``W`` removes the copies that decoupling disturbances leaves. An observer of least order reads the
        equations of the plant that its estimate did not need instead of the output error, which may be blind.

        Raises
        ------
        DesignError
            If as many disturbances are decoupled as there are outputs: no equation is left to see faults with.
        """
        p = self.plant
        if not len(self.left):
            raise DesignError(
                f"the residual is zero whatever fails: {used_up(len(self.outputs))} by "
                f"{counted(len(p.disturbances), 'disturbance')}; add a sensor or decouple fewer disturbances"
            )
        known = self._residual(self._known)
        plain = self.complete and len(self.left) == len(self.outputs)
        names = [f"r {x}" for x in self.outputs] if plain else [f"r{i + 1}" for i in range(len(self.left))]
        order = len(known) - 1
        note = f"the residual takes {order} derivatives of the measurements" if not p.dt else f"late by {order} steps"
        system, T, V = state_map_of(self._filter(known, names), p)
        evidence = self.evidence.extended(notes=(note,), poles=system.poles())
        decouples = Decoupled()
        return make_generator(system, p, self.evidence.method, evidence, decouples=decouples, state_map=T, static_map=V)

    # --------------------------------------------------------------- coefficients

    @property
    def _known(self) -> NDArray[np.float64]:
        """``F``: the entry of control inputs and outputs into the equations ``S X' = R X - F v``."""
        p, rows = self.plant, self.rows
        spread = np.eye(p.n_outputs)[rows]
        return np.block([[-p.B, np.zeros((p.n_states, p.n_outputs))], [-p.D[rows], spread]])

    def _polynomial(self, F: NDArray, read: NDArray, first: Terms | None = None) -> list[NDArray[np.float64]]:
        """Return the coefficients of ``read X``, after ``first``, of signals that enter the equations by ``F``.

        The highest that are rounding of their terms are left out, and zeros stand for entries that are: a signal that
        was decoupled is not read at all, where rounding would read it faintly.
        """
        p, X, N = (
            self.gain.pencil,
            self.gain.basis,
            self.gain.triangular,
        )  # its powers are small there when they should be
        G = self.gain.G * p.rows
        power, size = X.T @ G @ F, np.abs(X.T) @ np.abs(G) @ np.abs(F)
        terms = [] if first is None else [first]
        for _ in range(max(self.index, 1)):
            terms.append((read @ (X @ power), np.abs(read) @ (np.abs(X) @ size)))
            power, size = N @ power, np.abs(N) @ size
        if first is not None and self.complete:
            terms[:2] = [tuple(a + b for a, b in zip(*terms[:2], strict=True))]
        total = sum(p.beta**i * size for i, (_, size) in enumerate(terms))
        columns = np.max(total, axis=0, keepdims=True, initial=0.0)
        columns = np.where(columns > 0, columns, 1.0)
        floor = 1e-12 * np.max(total / columns, axis=1, keepdims=True, initial=0.0) * columns
        out = [np.where(p.beta**i * np.abs(P) > floor, P, 0.0) / p.rate**i for i, (P, _) in enumerate(terms)]
        while len(out) > 1 and not np.any(out[-1]):
            out.pop()
        return out

    def _estimate(self, part: slice) -> list[NDArray[np.float64]]:
        """Return the coefficients of some of the states and disturbances."""
        columns = self.gain.pencil.columns
        return [columns[part, None] * P for P in self._polynomial(self._known, np.eye(len(columns))[part])]

    def _residual(self, F: NDArray) -> list[NDArray[np.float64]]:
        """Return the coefficients of the residual, of signals that enter the equations by ``F``."""
        p = self.gain.pencil
        left, of = (-self.left / p.rows[p.n :], p.R[p.n :]) if self.complete else (self.left / p.rows, p.S)
        direct = F[p.n :] if self.complete else F
        first = self.left @ direct, np.abs(self.left) @ np.abs(direct)
        return self._polynomial(F, above_rounding(left @ of, np.abs(left) @ np.abs(of)), first)

    def _filter(self, coefficients: list[NDArray], names: list[str]) -> StateSpace:
        p = self.plant
        inputs = signal_names(p)
        return differential_filter(coefficients, dt=p.dt, bandwidth=self.bandwidth, inputs=inputs, outputs=names)


@method(
    needs=["singular E or disturbances, or least_order=True"],
    exists_when="rank [sE - A, -Bd; C, Dd] = n + rank Bd for every finite s",
    order="of its filter",
    source="Twardy and Kaczorek, part I, eqs. (30) to (33), Theorem 4",
    state="the state itself, without a transient; differentiates the measurements",
    decouples=True,
    singular=True,
    noise="differentiated",
    calls=least_order_unless_singular,
)
def perfect_observer(
    plant: Plant,
    *,
    outputs: Iterable[str | int] | str | None = None,
    K: ArrayLike | None = None,
    least_order: bool = False,
    bandwidth: float | None = None,
    seed: int = 0,
) -> PerfectObserver:
    r"""Design an observer whose estimate is the state itself, for any disturbance.

    .. math:: E \dot{\hat x} = A \hat x + B u + K (C \hat x - y), \qquad \det(sE - A - KC) = \text{const} \ne 0

    for a singular plant. Disturbances of the plant become further states with no equation of their own, and are
    estimated too; such a plant is singular whatever its ``E``. Guaranteed (and checked): the estimate obeys the
    plant's equations for any control input and any disturbance, so that it has no transient but that of its filter.

    It exists when

    .. math:: \operatorname{rank} \begin{bmatrix} sE - A & -B_d \\ C & D_d \end{bmatrix} = n + q
              \quad \text{for every finite } s.

    and, for the form above without disturbances, an invertible ``T`` can be chosen: always when
    :math:`\operatorname{rank} [E; C] = n`, as Twardy and Kaczorek ask, and often when not. (``least_order`` needs
    the first condition alone.) Its price is noise: as many derivatives of the measurements as the evidence says.
    Several gains are tried and the one kept that takes the fewest derivatives, and of these the quietest.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, with a regular pencil; ``E`` singular, or with disturbances, or else ``least_order``.
    outputs : sequence of str or int, optional
        The outputs that drive it, all when omitted; for banks.
    K : array_like, shape (n, outputs that drive it), optional
        A gain to check and use instead of designing one; plants without disturbances.
    least_order : bool
        Give up the form above for the fewest derivatives that any gain allows: some of the plant's equations are
        left out of the estimate, and become the residual. An ordinary plant has this kind only.
    bandwidth : float, optional
        Of the filter that everything passes, in rad/s; continuous plants. Five times the geometric mean of the
        sizes of the plant's poles that are not zero, when omitted.
    seed : int
        For the gains that are tried.

    Returns
    -------
    PerfectObserver

    Raises
    ------
    ModelError
        If the plant's pencil is not regular.
    DesignError
        If no such observer exists; the message says which condition fails, and where.
    AccuracyError
        If no gain is found to working precision, or its estimate is not the state.
    SettingError
        If the bandwidth is not a positive number, or the plant is sampled, or if ``K`` comes with
        disturbances or with ``least_order``.

    See Also
    --------
    unknown_input_observer : Converges, and differentiates nothing.
    descriptor_observer : Of the order n - p.
    decoupled_residual : A residual without derivatives.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant. Measurement noise is differentiated: where a few finite
    zeros or slow estimates are no harm, `unknown_input_observer` and `kalman_filter` are quieter.

    References
    ----------
    Twardy and Kaczorek, part I, eqs. (30) to (33), Theorem 4 and Procedure 2; that ``E`` has to be singular, and that
    (31a) is not necessary, is shown in the tests.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[1, 2], [3, 4]], [[1], [1]], [[1, 1]], E=[[1, 0], [0, 0]])
    >>> plant = plant.with_actuator_faults().with_sensor_faults()
    >>> observer = rs.design.perfect_observer(plant, K=[[1], [-4]])
    >>> observer.index
    2
    >>> observer.polynomial()["u1 actuator"].round(9)  # f' / 3
    array([[0.        ],
           [0.33333333]])
    """
    rows = arrays.different_positions(outputs, plant.outputs, "output")
    n, q, model = plant.n_states, len(plant.disturbances), plant.balanced
    if bandwidth is None:
        bandwidth = 5.0 * model.units.rate * balanced_rate(model.dynamics, plant.is_discrete)
    elif plant.dt:
        raise SettingError("bandwidth is for continuous plants; a sampled perfect observer is a finite sum of samples")
    elif not np.isfinite(bandwidth) or bandwidth <= 0:
        raise SettingError(f"bandwidth must be a positive number of rad/s, got {bandwidth!r}")
    _check_existence(plant, rows)
    pencil = PlantPencil.of(plant, rows, bandwidth)
    if K is not None:
        if q or least_order:
            raise SettingError("a gain K is for plants without disturbances and without least_order")
        gain = given_gain(pencil, np.asarray(arrays.matrix(K, "K", (n, len(rows)))))
    elif least_order:
        gain = least_order_gain(pencil)
    elif not q and not len(model.algebra):
        raise DesignError(
            "E is invertible and there are no disturbances: det(sE - A - KC) has degree n for every K, so no perfect "
            "observer of this form exists; least_order=True differentiates the measurements instead, and a Luenberger "
            "observer or kalman_filter estimates the state without derivatives"
        )
    else:
        gain = full_rank_gain(pencil, seed)
    columns = pencil.columns[:, None]
    G = columns * gain.G * pencil.rows
    observer = PerfectObserver(
        plant,
        tuple(plant.outputs[i] for i in rows),
        G[:, :n],
        G[:, n:],
        columns * (gain.basis @ gain.triangular @ gain.basis.T) / pencil.columns / pencil.rate,
        gain.index,
        float(bandwidth),
        not least_order,
        Evidence("perfect observer"),
        gain,
        pencil.left * pencil.rows if least_order else np.eye(len(rows)) * (pencil.rows[n:] if q else 1.0),
    )
    if q or least_order:
        observer = replace(observer, left=_reduced_rows(observer))
    return replace(observer, evidence=_evidence(observer))


def _check_existence(plant: Plant, rows: list[int]) -> None:
    """Raise, with the values of ``s``, unless the pencil has full column rank at every finite ``s``."""
    q = len(plant.disturbances)
    zeros = invariant_zeros(plant.A, plant.Bd, plant.C[rows], plant.Dd[rows], plant.E)
    if zeros.normal_rank < q:
        raise DesignError(
            f"no perfect observer: the {counted(q, 'disturbance')} {'reaches' if q == 1 else 'reach'} the "
            f"{counted(len(rows), 'output')} with rank {zeros.normal_rank} only (the pencil [sE-A -Bd; C Dd] lacks "
            "column rank at every s); add a sensor, decouple fewer disturbances, or merge those that act alike"
        )
    if zeros.zeros.size:
        what = "of (A, Bd, C, Dd), where a disturbance stays unseen," if q else "where a mode stays unseen,"
        raise DesignError(
            f"no perfect observer: the pencil [sE-A -Bd; C Dd] loses column rank at the finite zero(s) s = "
            f"{describe_modes(zeros.zeros)} {what} and no gain removes them; add a sensor"
            + (
                ", decouple other disturbances, or take unknown_input_observer if they are stable"
                if q
                else ", or take an observer with dynamics if they are stable"
            )
        )


def _reduced_rows(o: PerfectObserver) -> NDArray[np.float64]:
    """Return the rows that the residual reads, combined so that as many as can be take few derivatives.

    Those without derivatives come first; each is scaled so that its largest coefficient of a measurement, derivatives
    counted at the bandwidth, is one.
    """
    m, Y = len(o.plant.inputs), o.plant.balanced.units.outputs
    P = np.array([o.bandwidth**i * M[:, m:] / Y for i, M in enumerate(o._residual(o._known))])
    # orthonormal rows first: rows of the caller's choice may be nearly parallel, or far apart in size
    U, s, _ = np.linalg.svd(np.hstack(list(P)), full_matrices=False)
    kept = s > SAME * s.max(initial=0.0)  # of equal sensors nothing is left
    U = without_noise(U[:, kept]) / s[kept]
    P, rows = U.T @ P, np.zeros((0, U.shape[1]))
    for degree in range(len(P)):
        higher = np.hstack([np.zeros((U.shape[1], 0)), *P[degree + 1 :]])
        rows = np.vstack([rows, left_null_basis(np.hstack([higher, rows.T]), rtol=SAME, scale=1.0)[0].T])
    size = np.abs(rows @ P * Y).max(axis=(0, 2), initial=0.0)
    terms = np.abs(rows) @ np.abs(U.T) @ np.abs(o.left)
    return above_rounding(rows @ U.T @ o.left, terms, DESIGN_ROUNDING) / size[:, None]


def _evidence(o: PerfectObserver) -> Evidence:
    """Return the evidence of an observer, or raise when its estimate is not the state."""
    p, gain, system = o.plant, o.gain, o.system
    of_outputs = system.select(inputs=range(len(p.inputs), system.n_inputs))
    M = (of_outputs.A, of_outputs.B, of_outputs.C, of_outputs.D)
    conditions = {
        "nilpotency index": float(o.index),
        "derivatives" if not p.dt else "steps of delay": float(o.derivatives),
        "T [A Bd] + L [C Dd] - I": gain.missed,
        "dropped from N": gain.dropped,
        "estimate off the state": _estimate_off(o, system),
    }
    conditions |= {"condition of T": gain.condition} if o.complete else {}
    # the coefficients that measurements have in their own estimate, those of derivatives at the bandwidth
    C, beta = np.hstack([p.C, p.Dd])[o.rows], 1.0 if p.dt else o.bandwidth
    sizes = [np.linalg.norm(C @ np.linalg.matrix_power(beta * o.N, i) @ o.L, 2) for i in range(max(o.index, 1))]
    conditions["sum of |C N^i L|" if p.dt else "sum of |C (bandwidth N)^i L|"] = float(sum(sizes))
    if p.dt:
        conditions["noise gain, outputs to estimate (H2)"] = h2_norm(*M, p.dt)
    else:
        conditions["bandwidth, rad/s"] = o.bandwidth
        with suppress(AccuracyError):  # the estimate does not need it
            if system.n_states <= MOST_STATES:  # it would take minutes
                conditions["noise gain, outputs to estimate (peak)"] = hinf_norm(*M).value
    method = "perfect observer" if o.complete else "perfect observer of least order"
    return Evidence(
        method=method + (", disturbances estimated" if p.disturbances else ""),
        poles=system.poles(),
        ranks={"rank[A Bd; C Dd]": decide_rank(gain.pencil.R, rtol=BALANCED_RANK, scale=1.0)},
        conditions=conditions,
        references=(REFERENCE,),
    )


def _estimate_off(o: PerfectObserver, system: StateSpace) -> float:
    """Return the distance of the filter driven by the plant from the filtered state, within the bandwidth, or raise.

    State by state, relative to the largest response of that state to a control input or disturbance.
    """
    p, model = o.plant, o.plant.balanced
    (A, C, E), units, n_u = model.written, model.units, len(p.inputs)
    driven = slice(0, n_u + len(p.disturbances))
    U, signals = units.inputs[driven], np.concatenate([units.inputs[:n_u], 1 / units.outputs])
    B = units.equations[:, None] * np.hstack([p.B, p.Bd]) * U / units.rate
    D = units.outputs[:, None] * np.hstack([p.D, p.Dd]) * U
    beta = o.bandwidth / units.rate
    s = np.exp(1j * np.array([0.2, 0.9, 2.3])) if p.dt else 1j * beta * np.array([0.043, 0.21, 0.93])
    X = Resolvent.of(A, None if p.E is None else E)(B, s)
    Q = system.evaluate(s if p.dt else s * units.rate) / units.states[:, None] * signals
    late = (1 / s if p.dt else 1 / (s / beta + 1)) ** o.derivatives
    missed = Q[..., n_u:] @ (C @ X + D) - late[:, None, None] * X
    missed[..., :n_u] += Q[..., :n_u]
    size = np.abs(late[:, None, None] * X).max(axis=(0, 2), initial=0.0)
    size = np.where(size > _LEAST_STATE * size.max(initial=0.0), size, size.max(initial=0.0))
    worst = float(np.max(np.abs(missed).max(axis=(0, 2), initial=0.0) / np.where(size > 0, size, 1.0), initial=0.0))
    if not worst <= LEAK:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} > {LEAK:.0e}: the measurements see part of the plant too "
            "weakly for a perfect observer; choose another bandwidth, or take unknown_input_observer"
        )
    return worst


def differential_filter(
    coefficients: Sequence[NDArray],
    *,
    dt: float,
    bandwidth: float,
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> StateSpace:
    r"""Return a filter that applies :math:`\sum_i P_i \, d^i / dt^i` to its inputs.

    Continuous time: through ``m`` equal lags, as many as derivatives, :math:`g = 1 / (\tau s + 1)`,
    ``tau = 1 / bandwidth``:

    .. math:: \sum_i P_i \frac{s^i}{(\tau s + 1)^m} = \sum_{j=0}^m Q_j\, g^j, \qquad
              Q_j = \sum_i \tau^{-i} (-1)^{k} \binom{i}{k} P_i, \quad k = j - m + i

    from :math:`s g = (1 - g) / \tau`. Sampled time: :math:`\sum_i P_i v_{k - m + i}`, a delay of ``m`` steps. The lags
    are those of the outputs, or those of the inputs where these are fewer.

    Parameters
    ----------
    coefficients : sequence of ndarray, shape (outputs, inputs)
        ``P_0, P_1, ...``.
    dt : float
    bandwidth : float
        In rad/s; not used in sampled time.
    inputs, outputs : sequence of str

    Returns
    -------
    StateSpace
    """
    m, width, height, rate = len(coefficients) - 1, len(inputs), len(outputs), 1.0 if dt else bandwidth
    Q = [np.zeros((height, width))] * (m + 1)
    for i, P in enumerate(coefficients):
        for k in range(1 if dt else i + 1):
            Q[m - i + k] = Q[m - i + k] + rate**i * (-1) ** k * comb(i, k) * P
    # before the states, which would be many where powers of the bandwidth run away
    for one in Q:
        arrays.matrix(one, "coefficient", (height, width))
    chain = np.eye(m, k=-1) if dt else rate * (np.eye(m, k=-1) - np.eye(m))
    if height <= width:  # lags of what comes out, all of which the outputs see
        eye = np.eye(height)
        A, B, C = np.kron(chain.T, eye), np.vstack([np.zeros((0, width)), *Q[1:]]), rate * np.kron(np.eye(1, m), eye)
    else:  # lags of what goes in
        eye = np.eye(width)
        A, B, C = np.kron(chain, eye), rate * np.kron(np.eye(m, 1), eye), np.hstack([np.zeros((height, 0)), *Q[1:]])
    k = m * len(eye)
    return StateSpace(
        A.reshape(k, k), B.reshape(k, width), C.reshape(height, k), Q[0], dt=dt, inputs=inputs, outputs=outputs
    )
