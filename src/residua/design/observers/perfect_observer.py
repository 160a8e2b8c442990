"""Perfect observers: the state of a singular plant from its signals and their derivatives, without dynamics."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.method import method
from residua.design.core.needs import least_order_unless_singular
from residua.design.core.own_time import has_rates, in_own_time, written_by
from residua.design.core.signals import sampled_filter, signal_names, stack_signals
from residua.design.observers.differential_filter import differential_filter, trimmed
from residua.design.observers.perfect_gain import PerfectGain, full_rank_gain, given_gain, least_order_gain
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import StateSpace, WeierstrassForm, decide_rank, default_margin, invariant_zeros, weierstrass_form
from residua.linear.norms.system_norms import h2_norm, hinf_norm
from residua.linear.poles.spectrum import describe_modes
from residua.linear.subspaces.rank import DEFAULT_RTOL, left_null_basis, without_noise
from residua.linear.systems.array_cache import cached_by_contents, copied
from residua.linear.systems.balancing import descriptor_units, power_of_two, without_rounding
from residua.linear.systems.descriptor import scaled_pencil
from residua.linear.systems.response_terms import in_even_units, response_terms
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units
from residua.tolerances import RESPONSE_ROUNDING, SAME, above_rounding
from residua.words import as_given, counted, used_up

REFERENCE = "Twardy and Kaczorek, part I, eqs. (30) to (33), Theorem 4, Procedure 2"
#: States of a filter beyond which its peak gain is not computed.
MOST_STATES = 300


def _in_other_time(observer: PerfectObserver, factor: float) -> PerfectObserver:
    """Return an observer with the rows that its residual reads in another unit of time: those of the equations."""
    if observer.complete:
        return observer
    equations = np.arange(observer.left.shape[1]) < observer.plant.n_states
    return replace(observer, left=observer.left * np.where(equations, 1 / factor, 1.0))


def in_other_units(
    observer: PerfectObserver, plant: Plant, units: PlantUnits, power: float = 1.0
) -> tuple[PerfectObserver, NDArray[np.float64]]:
    """Return an observer for a scaled plant as one for the plant, or with a power of minus one the other way.

    And the factors of its residuals: that of one output stays so, any other stays as large as it is.
    """
    X, R, Y = _both(units) ** power, units.equations**power, units.outputs[observer.rows] ** power
    whole = np.concatenate([R, Y])
    left = observer.left * (Y if observer.complete else whole)
    rows = 1 / power_of_two(np.abs(left).max(axis=1, initial=0.0))
    g = observer.gain
    T, L, N = X[:, None] * g.T * R, X[:, None] * g.L * Y, X[:, None] * g.N / X
    gain = replace(
        g, T=T, L=L, N=N, basis=X[:, None] * g.basis, inverse=g.inverse / X, W=g.W * whole, Y=g.Y / whole[:, None]
    )
    return replace(observer, plant=plant, T=T, L=L, N=N, gain=gain, left=rows[:, None] * left), rows


def _both(units: PlantUnits) -> NDArray[np.float64]:
    """Return the units of states and disturbances, both of which are estimated."""
    return np.concatenate([units.states, units.disturbances])


@has_rates(T=-1, N=-1, bandwidth=1)
@written_by(_in_other_time)
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
        The choice behind ``T``, ``L`` and ``N``, with its checks.
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
        return np.asarray(np.linalg.solve(self._square_T(), self.L), dtype=float)

    @property
    def Ab(self) -> NDArray[np.float64]:
        """``A + K C``, whose inverse is ``T``; singular plants without disturbances only."""
        return self.plant.A + self.K @ self.plant.C[self.rows]

    def _square_T(self) -> NDArray[np.float64]:
        if not self.complete or self.T.shape[0] != self.T.shape[1]:
            raise DesignError(
                "K and A + K C belong to observers of singular plants without disturbances, and with full T; this one "
                "is N xh' = xh + T B u - L y"
            )
        return self.T

    @property
    def derivatives(self) -> int:
        """How many derivatives of the inputs and outputs the state estimate takes (sampled: steps)."""
        return len(self._state_polynomial()) - 1

    @property
    def delay(self) -> float:
        """By how many seconds the state estimate lags: steps times ``dt``, or the sum of the lags of the filter."""
        return self.derivatives * (self.plant.dt or 1.0 / self.bandwidth)

    @property
    def system(self) -> StateSpace:
        """The filter from control inputs and outputs to the state estimate."""
        return self._filter(self._state_polynomial(), [f"estimate {x}" for x in self.plant.states])

    @property
    def disturbance_system(self) -> StateSpace:
        """The filter from control inputs and outputs to the estimate of the disturbances."""
        n = self.plant.n_states
        return self._filter(self._polynomial(slice(n, None)), [f"estimate {x}" for x in self.plant.disturbances])

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
        """Return the estimate of the disturbances, shape (time, disturbances); takes what :meth:`estimate` takes."""
        return sampled_filter(self.disturbance_system, self.plant, dt).simulate(stack_signals(self.plant, u, y))

    # ---------------------------------------------------------------- residuals

    def polynomial(self) -> dict[str, NDArray[np.float64]]:
        """Return what the unfiltered residual is made of: for each fault the coefficients of ``f, f', f'', ...``.

        Each is an array of shape (order + 1, residuals); in sampled time of ``f`` now, one step later, and so on.
        """
        own, units, rows = self._own
        coefficients = own._residual_of(own.plant.Bf, own.plant.Df)
        scaled = [rows[:, None] * P / units.faults for P in coefficients]
        return {name: np.array([P[:, i] for P in scaled]) for i, name in enumerate(self.plant.faults)}

    @cached_property
    def _own(self) -> tuple[PerfectObserver, PlantUnits, NDArray[np.float64]]:
        """The observer of the plant in its own units, these, and the factors from its residuals to those here.

        Whether a coefficient is rounding is decided there, so that it does not depend on the units of the plant.
        """
        units = canonical_units(self.plant)
        bare = replace(self, evidence=Evidence(self.evidence.method))
        own, rows = in_other_units(bare, units.applied(self.plant), units, -1.0)
        return own, units, 1 / rows

    @in_own_time()
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
        own, units, rows = self._own
        system, form, order = own._filters()
        signals, hidden = 1 / units.signals, 1 / units.hidden(len(p.noises))
        R = rows[:, None]
        system = system.replaced(B=system.B * signals, C=R * system.C, D=R * system.D * signals)
        form = form.replaced(B=form.B * hidden, C=R * form.C, D=R * form.D * hidden)
        note = f"the residual takes {order} derivatives of the measurements" if not p.dt else f"late by {order} steps"
        evidence = self.evidence.extended(notes=(note,), poles=system.poles())
        return make_generator(system, p, self.evidence.method, evidence, decouples=Decoupled(), known_form=form)

    @cached_by_contents
    def _filters(self) -> tuple[StateSpace, StateSpace, int]:
        """Return the residual of signals, that of faults, disturbances and noise, and the number of derivatives."""
        p = self.plant
        known = self._residual_of_signals()
        hidden = self._residual_of(np.hstack([p.Bf, 0.0 * p.Bd, p.Bw]), np.hstack([p.Df, 0.0 * p.Dd, p.Dw]))
        order = max(len(known), len(hidden)) - 1
        plain = self.complete and len(self.left) == len(self.outputs)
        names = [f"r {x}" for x in self.outputs] if plain else [f"r{i + 1}" for i in range(len(self.left))]
        form = self._filter(hidden, names, order, p.system(("fault", "disturbance", "noise")).inputs)
        return self._filter(known, names, order), form, order

    # --------------------------------------------------------------- coefficients

    @property
    def rows(self) -> list[int]:
        """Numbers of the outputs that drive it."""
        return arrays.positions(self.outputs, self.plant.outputs, "output")

    @property
    def _known(self) -> NDArray[np.float64]:
        """``Gv`` of ``X = sum N^i Gv v^(i)``, with ``v`` the control inputs and all outputs."""
        p = self.plant
        spread = np.eye(p.n_outputs)[self.rows]
        return np.hstack([-(self.T @ p.B + self.L @ p.D[self.rows]), self.L @ spread])

    def _state_polynomial(self) -> list[NDArray[np.float64]]:
        return self._polynomial(slice(0, self.plant.n_states))

    def _polynomial(self, part: slice) -> list[NDArray[np.float64]]:
        """Return the rows ``part`` of what the state and the disturbances are of the signals, ``Gv, N Gv, ...``."""
        own, units, _ = self._own
        pick = np.eye(len(self.N))[part]
        rows = _both(units)[part][:, None]
        return [rows * P / units.signals for P in own.series(own._known, pick, [])]

    def series(
        self, G: NDArray, pick: NDArray, first: list[NDArray], direct: tuple[NDArray, NDArray] | None = None
    ) -> list[NDArray[np.float64]]:
        """Return ``first`` and then ``pick G, pick N G, ...`` up to the last that is not zero.

        ``direct``: two factors whose product is added to ``pick G``.
        """
        out, sizes = list(first), [np.abs(P) for P in first]
        # In the coordinates of the chains, where N is triangular, its powers are small when they should be.
        chain, pick = self.gain.triangular, pick @ self.gain.basis
        power = self.gain.inverse @ G
        size = np.abs(power)
        for _ in range(max(self.index, 1)):
            out.append(pick @ power)
            sizes.append(np.abs(pick) @ size)
            power, size = chain @ power, np.abs(chain) @ size
        if direct is not None:
            left, right = direct
            out[len(first)] = out[len(first)] + left @ right
            sizes[len(first)] = sizes[len(first)] + np.abs(left) @ np.abs(right)
        return trimmed(out, sizes, self.bandwidth)

    def _residual_of_signals(self) -> list[NDArray[np.float64]]:
        """Return the coefficients of the residual in its own signals ``(u, y)``."""
        p, rows = self.plant, self.rows
        spread = np.eye(p.n_outputs)[rows]
        F = np.block([[-p.B, np.zeros((p.n_states, p.n_outputs))], [-p.D[rows], spread]])
        return self._residual(self._known, F)

    def _residual_of(self, B: NDArray, D: NDArray) -> list[NDArray[np.float64]]:
        """Return the coefficients of the residual in inputs that it does not know."""
        D = D[self.rows]
        return self._residual(self.T @ B + self.L @ D, np.vstack([B, D]))

    def _residual(self, G: NDArray, F: NDArray) -> list[NDArray[np.float64]]:
        """Return the coefficients of the residual: of ``X = sum N^i G v^(i)``, and the equations ``F v`` themselves."""
        p, rows = self.plant, self.rows
        if self.complete:
            W, whole = self.left, np.hstack([p.C[rows], p.Dd[rows]])
            return self.series(G, -W @ whole, [], (W, F[p.n_states :]))
        E = np.eye(p.n_states) if p.E is None else p.E
        S = np.zeros((p.n_states + len(rows), len(self.N)))
        S[: p.n_states, : p.n_states] = E
        return self.series(G, self.left @ S, [self.left @ F])

    def _filter(
        self,
        coefficients: Sequence[NDArray],
        names: Sequence[str],
        order: int | None = None,
        inputs: Sequence[str] | None = None,
    ) -> StateSpace:
        return differential_filter(
            coefficients,
            dt=self.plant.dt,
            bandwidth=self.bandwidth,
            order=order,
            inputs=signal_names(self.plant) if inputs is None else inputs,
            outputs=names,
        )


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
@in_own_time(K=1)
def perfect_observer(
    plant: Plant,
    *,
    outputs: Iterable[str | int] | str | None = None,
    K: ArrayLike | None = None,
    least_order: bool = False,
    bandwidth: float | None = None,
    seed: int = 0,
    rtol: float = DEFAULT_RTOL,
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
    rtol : float
        For every rank decision.

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
        If no gain passes the checks: relative variation of the determinant below 1e-6.
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
    units = canonical_units(plant)
    if K is not None:
        given = np.asarray(arrays.matrix(K, "K", (plant.n_states, len(rows))))
        K = units.equations[:, None] * given / units.outputs[rows]
    own = _designed(units.applied(plant), rows, K, bandwidth, rtol, least_order=least_order, seed=seed)
    made, factors = in_other_units(copied(own), plant, units)  # what is kept is not handed out to be changed
    if len(own.left) and (least_order or plant.disturbances):
        heights = factors * np.abs(_of_measurements(own) * units.outputs).max(axis=(0, 2))
        made = replace(made, left=made.left / power_of_two(heights)[:, None])
    return replace(made, evidence=_with_noise(made))


@cached_by_contents
def _designed(
    plant: Plant,
    rows: list[int],
    K: NDArray[np.float64] | None,
    bandwidth: float | None,
    rtol: float,
    *,
    least_order: bool,
    seed: int,
) -> PerfectObserver:
    """Return the observer of a plant in its own units, with what of its evidence does not depend on units."""
    names = tuple(plant.outputs[i] for i in rows)
    E = np.eye(plant.n_states) if plant.E is None else plant.E
    C, Dd = plant.C[rows], plant.Dd[rows]
    form = weierstrass_form(plant.A, plant.E, rtol=rtol)
    if plant.dt and bandwidth is not None:
        raise SettingError("bandwidth is for continuous plants; a sampled perfect observer is a finite sum of samples")
    width = _bandwidth(bandwidth, form, plant)
    check_existence(plant, rows, rtol)
    n, q = plant.n_states, len(plant.disturbances)
    R = np.block([[plant.A, plant.Bd], [C, Dd]])
    S = np.zeros_like(R)
    S[:n, :n] = E
    scale = None if plant.dt else width
    if K is not None:
        if q or least_order:
            raise SettingError("a gain K is for plants without disturbances and without least_order")
        gain = given_gain(plant.A, E, C, K, rtol=rtol, bandwidth=scale)
    elif least_order:
        gain = least_order_gain(R, S, n, rtol=rtol, bandwidth=scale)
    else:
        check_singular(plant, rtol)
        inputs = np.vstack([plant.B, plant.D[rows]])
        gain = full_rank_gain(R, S, n, inputs=inputs, rtol=rtol, bandwidth=scale, seed=seed)
    left = gain.W if least_order else output_error_rows(gain, len(rows))
    blank = Evidence("perfect observer")
    observer = PerfectObserver(
        plant, names, gain.T, gain.L, gain.N, gain.index, width, not least_order, blank, gain, left
    )
    if len(left) and (q or least_order):
        observer = replace(observer, left=reduced_rows(observer))
    return replace(observer, evidence=perfect_evidence(observer, R, rtol))


def _bandwidth(bandwidth: float | None, form: WeierstrassForm, plant: Plant) -> float:
    if bandwidth is None:
        if form.n_finite:
            return 5.0 * default_margin(form.A1)
        return 5.0 * scaled_pencil(plant.A, np.eye(plant.n_states) if plant.E is None else plant.E).unit
    if not np.isfinite(bandwidth) or bandwidth <= 0:
        raise SettingError(f"bandwidth must be a positive number of rad/s, got {as_given(bandwidth)!r}")
    return float(bandwidth)


def check_singular(plant: Plant, rtol: float) -> None:
    """Raise when ``E`` is invertible and nothing else makes the plant singular."""
    if plant.disturbances or (
        plant.E is not None and decide_rank(scaled_pencil(plant.A, plant.E).E, rtol=rtol).rank < plant.n_states
    ):
        return
    raise DesignError(
        "E is invertible and there are no disturbances: det(sE - A - KC) has degree n for every K, so no perfect "
        "observer of this form exists; least_order=True differentiates the measurements instead, and a Luenberger "
        "observer or kalman_filter estimates the state without derivatives"
    )


def check_existence(plant: Plant, rows: list[int], rtol: float) -> None:
    """Raise, with the values of ``s``, unless the pencil has full column rank at every finite ``s``."""
    q = len(plant.disturbances)
    if len(rows) < q:
        raise DesignError(
            f"no perfect observer: {counted(len(rows), 'output')} cannot tell "
            f"{counted(q, 'disturbance')} apart; add sensors, or decouple fewer disturbances"
        )
    zeros = invariant_zeros(plant.A, plant.Bd, plant.C[rows], plant.Dd[rows], plant.E, rtol=rtol)
    if zeros.normal_rank < q:
        raise DesignError(
            f"no perfect observer: the {counted(q, 'disturbance')} {'reaches' if q == 1 else 'reach'} "
            f"the outputs with rank {zeros.normal_rank} only (the "
            "pencil [sE-A -Bd; C Dd] lacks column rank at every s); add a sensor, or merge disturbances that act alike"
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


def output_error_rows(gain: PerfectGain, outputs: int) -> NDArray[np.float64]:
    """Return ``W`` that leaves as many rows as the output error has independent ones: ``I`` without disturbances."""
    Q = gain.Y[-outputs:]
    if Q.shape[1] == outputs:
        return np.eye(outputs)
    units = np.abs(Q).max(axis=1, keepdims=True, initial=0.0)
    units = np.where(units > 0, units, 1.0)
    return np.linalg.svd(Q / units)[0][:, : Q.shape[1]].T / units.T


def reduced_rows(o: PerfectObserver) -> NDArray[np.float64]:
    """Return the rows that the residual reads, combined so that as many as can be take few derivatives.

    Those without derivatives come first; each is scaled so that its largest coefficient of a measurement, derivatives
    counted at the bandwidth, is one. (In units of the plant it is the power of two next to that.)
    """
    P = _of_measurements(o)
    units = np.abs(P).max(axis=(0, 1), initial=0.0)
    units = np.where(units > 0, units, 1.0)
    P = P / units
    # Orthonormal rows first: rows of the caller's choice may be nearly parallel, or far apart in size.
    U, s, _ = np.linalg.svd(np.hstack(list(P)), full_matrices=False)
    kept = s > SAME * s.max(initial=0.0)  # a combination of rows that reads nothing, as of equal sensors, is none
    U = without_noise(U[:, kept]) / s[kept]
    left, P = without_rounding(U.T, o.left), U.T @ P
    rows = np.zeros((0, len(left)))
    for degree in range(len(P)):
        higher = np.hstack([np.zeros((len(left), 0)), *P[degree + 1 :]])
        free = left_null_basis(np.hstack([higher, rows.T]), rtol=1e-9, scale=1.0)[0]
        rows = np.vstack([rows, free.T])
    size = np.abs(rows @ P * units).max(axis=(0, 2), initial=0.0)
    return without_rounding(rows, left) / size[:, None]


def _of_measurements(o: PerfectObserver) -> NDArray[np.float64]:
    """Return the coefficients of the measurements in the residual, derivatives counted at the bandwidth."""
    m = len(o.plant.inputs)
    return np.array([o.bandwidth**i * M[:, m:] for i, M in enumerate(o._residual_of_signals())])


def perfect_evidence(o: PerfectObserver, R: NDArray, rtol: float) -> Evidence:
    """Return the evidence of an observer in its own units, or raise when its estimate is not the state."""
    p, gain = o.plant, o.gain
    system = o.system
    conditions = {
        "nilpotency index": float(o.index),
        "derivatives" if not p.dt else "steps of delay": float(o.derivatives),
        "relative variation of det(sN - I)": gain.variation,
        "T [A Bd] + L [C Dd] - I": gain.missed,
        "dropped from N": gain.dropped,
        "estimate off the state": _estimate_off(o, system),
    }
    if o.complete:
        conditions["condition of T"] = gain.condition
    scaled = scaled_pencil(R, np.zeros_like(R), unit=1.0).A
    method = "perfect observer" if o.complete else "perfect observer of least order"
    return Evidence(
        method=method + (", disturbances estimated" if p.disturbances else ""),
        poles=system.poles(),
        ranks={"rank[A Bd; C Dd]": decide_rank(scaled, rtol=rtol)},
        conditions=conditions,
        references=(REFERENCE,),
    )


def _with_noise(o: PerfectObserver) -> Evidence:
    """Return the evidence of an observer with what becomes of noise, in the units of its plant."""
    p = o.plant
    system = o.system
    from_outputs = system.select(inputs=range(len(p.inputs), system.n_inputs))
    conditions = {"sum of |C N^i L|" if p.dt else "sum of |C (bandwidth N)^i L|": _noise_sum(o)}
    notes: tuple[str, ...] = ()
    M = (from_outputs.A, from_outputs.B, from_outputs.C, from_outputs.D)
    if p.dt:
        conditions["noise gain, outputs to estimate (H2)"] = h2_norm(*M, p.dt)
    else:
        conditions["bandwidth, rad/s"] = o.bandwidth
        try:
            if system.n_states > MOST_STATES:  # it would take minutes
                raise AccuracyError(f"the filter has {system.n_states} states, more than {MOST_STATES}")
            conditions["noise gain, outputs to estimate (peak)"] = hinf_norm(*M).value
        except AccuracyError as error:
            notes = (f"the peak gain from the outputs to the estimate was not found: {error}",)
    return o.evidence.extended(conditions=conditions, notes=notes)


def _estimate_off(o: PerfectObserver, system: StateSpace, limit: float = 1e-6) -> float:
    """Return how far the filter driven by the plant is from the filtered state, over frequency, or raise.

    State by state, relative to its response to each control input and disturbance; where one hardly reaches a state, to
    what others do to it, in even units; where none does, to the terms that its estimate is the sum of.
    """
    p = o.plant
    driven = p.system(("control", "disturbance"))
    n, m, n_u = p.n_states, driven.n_inputs, len(p.inputs)
    if not m:
        return 0.0
    units = descriptor_units(driven.A, driven.E, driven.B, driven.C, driven.D).inputs
    points = np.exp(1j * np.array([0.2, 0.9, 2.3])) if p.dt else 1j * o.bandwidth * np.array([0.043, 0.21, 0.93])
    both = driven.replaced(C=np.vstack([np.eye(n), driven.C]), D=np.vstack([np.zeros((n, m)), driven.D]), outputs=None)
    even = in_even_units(both)
    found = response_terms(even.system, points)
    reached = above_rounding(found.values, found.terms, RESPONSE_ROUNDING) / even.outputs[:, None] / even.inputs
    X, P = reached[:, :n], reached[:, n:]
    Q = system.evaluate(points)
    product = Q[..., n_u:] @ P
    product[..., :n_u] += Q[..., :n_u]
    late = (1 / points if p.dt else 1 / (points / o.bandwidth + 1)) ** o.derivatives
    wanted = late[:, None, None] * X
    terms = np.abs(Q[..., n_u:]) @ np.abs(P)
    terms[..., :n_u] += np.abs(Q[..., :n_u])
    missed, size, terms = ((np.abs(M) * units).max(axis=0) for M in (product - wanted, wanted, terms))
    size = np.maximum(size, 1e-6 * size.max(axis=1, keepdims=True, initial=0.0))
    size = np.where(size.max(axis=1, keepdims=True, initial=0.0) > 0, size, terms)
    worst = float(np.max(missed / np.where(size > 0, size, 1.0), initial=0.0))
    if not worst <= limit:
        raise AccuracyError(
            f"the estimate is off the state by {worst:.2g} > {limit:.0e}: the plant is too badly scaled or conditioned "
            "for a perfect observer; rescale it, choose another bandwidth, or take unknown_input_observer"
        )
    return worst


def _noise_sum(o: PerfectObserver) -> float:
    """Return ``sum_i |C N^i L|``, the size of the coefficients that the measurements have in their own estimate.

    Those of derivatives are seconds to a power: they count as in units of time of one over the bandwidth.
    """
    own, units, _ = o._own
    whole, Y = np.hstack([own.plant.C[o.rows], own.plant.Dd[o.rows]]), units.outputs[o.rows]
    rate = 1.0 if o.plant.dt else o.bandwidth
    found = [P / Y[:, None] * Y for P in own.series(own.L, whole, [])]
    return sum(rate**i * float(np.linalg.norm(P, 2)) for i, P in enumerate(found))
