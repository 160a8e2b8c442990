"""Observers that estimate faults, and the outputs of healthy sensors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua import arrays
from residua.analysis.existence import unknown_input_observer_existence
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.internal_form import frequency_grid, internal_form
from residua.design.core.method import FAULTS, groups_of_faults, method
from residua.design.core.signals import sampled_filter, stack_signals
from residua.design.observers.observer import Observer, plant_filter
from residua.design.observers.unknown_input_observer import unknown_input_observer
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import StateSpace
from residua.linear.norms.system_norms import h2_norm, hinf_norm
from residua.linear.poles.spectrum import mean_rate
from residua.linear.subspaces.rank import RankDecision, decide_rank, left_null_basis
from residua.plant import Plant
from residua.tolerances import BALANCED_RANK, IDENTITY, LEAK, RESIDUE, RESPONSE_ROUNDING, above_rounding

Matrix = NDArray[np.float64]

_METHOD = "fault estimator"
REFERENCES = (
    "Sueur, Observer-based actuator and sensor fault estimation, eqs. (1) to (8), (12) to (16)",
    "Chen, Patton and Zhang (1996), Int. J. Control 63(1), eqs. (2) to (13)",
)


@dataclass(frozen=True, eq=False)
class _FaultReading:
    r"""Faults as functions of a known state.

    .. math:: f = L_s (y - D u - C x) + L_d (\dot y - D \dot u) - P (A x + B u)

    for any disturbance. Rows of :math:`L_d` that are zero need no derivative; :math:`L_d` reads only what neither
    faults nor disturbances enter directly. In sampled time the derivative is the next sample, and the fault the one
    before it.

    Attributes
    ----------
    static, derivative : ndarray, shape (faults, outputs)
        ``L_s`` and ``L_d``.
    dynamics : ndarray, shape (faults, n)
        ``P``; ``L_d C`` is its part that is not zero on the algebraic equations: ``P E = L_d C``.
    needs_derivative : ndarray of bool, shape (faults,)
    units : ndarray, shape (faults,)
        Size of each fault that moves states and outputs by about one of their own units.
    ranks : mapping of str to RankDecision
    """

    static: NDArray[np.float64]
    derivative: NDArray[np.float64]
    dynamics: NDArray[np.float64]
    needs_derivative: NDArray[np.bool_]
    units: NDArray[np.float64]
    ranks: dict[str, RankDecision]


@dataclass(frozen=True, eq=False)
class FaultEstimator:
    r"""An observer that estimates faults, and the state that they cannot disturb.

    .. math::

       \hat f = G(s) \{ L_s (y - D u - C \hat x) + L_d (\dot y - D \dot u) - P (A \hat x + B u) \}

    with :math:`\hat x` of an unknown input observer, realised without a derivative. ``G`` is 1 for faults that are
    read off without one, otherwise :math:`1/(\tau s + 1)`; in sampled time :math:`z^{-1}`.

    Attributes
    ----------
    plant : Plant
        The plant of the design, with all its faults.
    faults : tuple of str
        The faults that it estimates.
    observer : Observer
        The state estimate, of the plant in which these faults are unknown inputs.
    system : StateSpace
        From control inputs and outputs to the estimates.
    lag : mapping of str to float
        By how many seconds each estimate follows its fault: ``tau``, or the delay of a sampled plant; zero where
        no derivative is needed. A fault that grows with slope ``a`` is estimated ``a lag`` too small.
    generator : ResidualGenerator
        The estimates as residuals.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, eqs. (5), (8) and section 3.2.
    """

    plant: Plant
    faults: tuple[str, ...]
    observer: Observer
    system: StateSpace
    lag: Mapping[str, float]
    generator: ResidualGenerator = field(repr=False)

    @property
    def evidence(self) -> Evidence:
        """The checks that it has passed, with its bandwidth and its noise gains."""
        return self.generator.evidence

    @property
    def joint_system(self) -> StateSpace:
        """The estimates of the faults, then those of the states, as one system from inputs and outputs."""
        s, o = self.system, self.observer.system
        return s.replaced(
            C=np.vstack([s.C, np.hstack([o.C, np.zeros((o.n_outputs, s.n_states - o.n_states))])]),
            D=np.vstack([s.D, o.D]),
            outputs=[*s.outputs, *o.outputs],
        )

    def estimate(self, u: ArrayLike | None, y: ArrayLike, *, dt: float | None = None) -> NDArray[np.float64]:
        """Return the estimated faults over a recording, shape (time, faults).

        Parameters
        ----------
        u : array_like, shape (time, inputs), or None
        y : array_like, shape (time, outputs)
        dt : float, optional
            Step of the recording in seconds; needed when the plant is continuous. The estimator is then sampled,
            with inputs held and outputs linear between samples: its error is of second order in the step, of first
            order for some steps after a measurement has jumped.
        """
        return sampled_filter(self.system, self.plant, dt).simulate(stack_signals(self.plant, u, y))

    def state(self, u: ArrayLike | None, y: ArrayLike, *, dt: float | None = None) -> NDArray[np.float64]:
        """Return the state estimate, which the faults do not reach, shape (time, states)."""
        return self.observer.estimate(u, y, dt=dt)

    def virtual_outputs(self, u: ArrayLike | None, y: ArrayLike, *, dt: float | None = None) -> NDArray[np.float64]:
        r"""Return the outputs of healthy sensors, :math:`C \hat x + D u`, shape (time, outputs).

        Without what disturbances add to the outputs, where the plant has such.
        """
        p, x = self.plant, self.state(u, y, dt=dt)
        signals = stack_signals(p, u, y)
        return x @ p.C.T + signals[..., : len(p.inputs)] @ p.D.T

    def residual_generator(self) -> ResidualGenerator:
        """Return the estimates as residuals: zero while nothing fails, whatever the decoupled disturbances do."""
        return self.generator

    def consistency(self) -> ResidualGenerator:
        """Return the output errors of the observer: zero while nothing but the estimated faults happens.

        Another fault than those estimated shows here; then the estimates mean nothing.

        Raises
        ------
        DesignError
            If all measurements are used up for the estimate.
        """
        return self.observer.residual_generator()

    def __repr__(self) -> str:
        kind = f"dt={self.plant.dt:g} s" if self.plant.is_discrete else "continuous"
        return f"FaultEstimator({', '.join(self.faults)}: {self.system.n_states} states, {kind})"


@method(
    needs=[FAULTS],
    exists_when="an unknown input observer with these faults as disturbances; their effects independent",
    order="n and one per filtered fault",
    source="Sueur, eqs. (5) and (8)",
    state="estimate that the faults do not reach",
    faults="by size, several at once",
    size=True,
    decouples=True,
    singular=True,
    many=True,
    calls=groups_of_faults,
)
def fault_estimator(
    plant: Plant,
    *,
    faults: Iterable[str] | str | None = None,
    poles: Sequence[complex] | ArrayLike | None = None,
    margin: float | None = None,
    bandwidth: float | None = None,
) -> FaultEstimator:
    r"""Design an observer that estimates faults, several at once where the outputs allow it.

    The faults are taken for unknown inputs, and an unknown input observer estimates the state without them. What
    they do to outputs (sensor faults) is then read off at once, :math:`\hat f_j = y_j - c_j \hat x`; what they do
    to the state (actuators, components) from the derivative of the outputs, through a filter that makes it
    realisable. Guaranteed, but for terms that decay with the poles of the error, for any control input and any
    disturbance, and any time course of the faults:

    =================  ======================================  =============================================
    plant              faults that outputs show at once        faults that need a derivative
    =================  ======================================  =============================================
    continuous         :math:`\hat f = f`                      :math:`\hat f = f / (\tau s + 1)`
    sampled            :math:`\hat f_k = f_k`                  :math:`\hat f_k = f_{k-1}`
    =================  ======================================  =============================================

    So constant faults are estimated exactly, and ramps with an error of slope times lag. The plant may be
    unstable, its ``A`` singular, and its ``E`` singular.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, with faults; disturbances are decoupled too.
    faults : sequence of str, optional
        What to estimate; all faults when omitted. The others must not happen meanwhile.
    poles : sequence of complex, optional
        Poles of the state estimate's error: as many as states, or as many as are free.
    margin : float, optional
        Decay rate in 1/s that every free pole must have at least, used without ``poles``; as for
        :func:`unknown_input_observer`.
    bandwidth : float, optional
        :math:`1/\tau` in rad/s: a wider one follows faults faster and passes more noise (see the evidence). With
        one, all estimates are filtered with it (a sampled plant: by a pole at :math:`e^{-dt/\tau}`). When
        omitted, only those of a continuous plant that need it, with the geometric mean of the sizes of the poles of
        the error, or of the plant if that is larger.

    Returns
    -------
    FaultEstimator

    Raises
    ------
    DesignError
        If the faults cannot be estimated together: they cannot be distinguished, or no observer exists that
        ignores them; the message says which condition failed, with its numbers. If the poles are too many or too
        few, or not stable.
    AccuracyError
        If the result missed its check.
    SettingError
        If the bandwidth is not a positive number.

    See Also
    --------
    sensor_fault_estimators : One sensor at a time, which more plants allow.
    matched_filters : Steps beside noise, with arrival time.
    inverse_form_observer : The same observer in another form.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, and no other fault happens. Exists exactly when
    an unknown input observer for disturbances and faults does,
    :math:`\operatorname{rank} [B_d\ B_f; D_d\ D_f] = \operatorname{rank} [B_d; D_d] + \text{number of faults}`, and
    disturbances and faults leave fewer invariant zeros, which are the fixed poles, than the plant has poles: faults of
    all sensors would leave the state to be simulated beside the plant without any correction.
    Sueur's own form, :func:`inverse_form_observer`, asks for an invertible ``A`` besides, and his sensor faults for
    a filter on every faulty output; neither is needed here.

    References
    ----------
    Sueur, Observer-based actuator and sensor fault estimation, eqs. (5) and (8), in the form of Chen, Patton and
    Zhang (1996), eqs. (2) to (13).

    Examples
    --------
    >>> import residua as rs
    >>> aircraft = rs.library.vtol()
    >>> estimator = rs.design.fault_estimator(
    ...     aircraft, faults=["collective actuator", "cyclic actuator"], poles=[-20, -25, -100 / 3, -50], bandwidth=50
    ... )
    >>> estimator.lag
    {'collective actuator': 0.02, 'cyclic actuator': 0.02}
    """
    chosen = [plant.faults[i] for i in arrays.positions(faults, plant.faults, "fault")]
    if not chosen:
        raise DesignError("there is no fault to estimate: give the plant faults, plant.with_actuator_faults()")
    arrays.unique(names := tuple(chosen), "faults to estimate")
    if bandwidth is not None and not (np.isfinite(bandwidth) and bandwidth > 0):
        raise SettingError(f"bandwidth must be a positive number in rad/s, got {bandwidth!r}")
    observer = _observer_ignoring(plant, names, poles, margin)
    if observer.plant.E is None:
        plant = plant.explicit()
    reading = _read_faults(observer.plant, names)
    late, dt = reading.needs_derivative, plant.dt
    filtered = late if bandwidth is None else np.ones(len(late), dtype=bool)
    rate = 0.0 if bandwidth is None else float(bandwidth)
    if not dt and bandwidth is None and late.any():
        rate = max(mean_rate(observer.poles), mean_rate(plant.system(()).poles()))
    pole = float(np.exp(-rate * dt)) if dt and rate else 0.0
    lags = np.where(late, dt, 0.0) + dt * pole / (1 - pole) if dt else np.where(filtered, 1 / (rate or 1.0), 0.0)
    system, T, V = _realised(plant, names, observer, reading, filtered, rate, pole)
    form = internal_form(system, plant, T, V)
    w = frequency_grid(form, system)
    if dt:
        z = np.exp(1j * w * dt)[:, None]
        wanted = (1 - pole) / (1 - pole / z) * np.where(late, 1 / z, 1.0)
    else:
        wanted = 1 / (1j * np.outer(w, lags) + 1)
    response = form.frequency_response(w)[:, :, [plant.faults.index(name) for name in names]]
    off = (response - wanted[:, :, None] * np.eye(len(names))) / reading.units[:, None] * reading.units
    missed = float(np.abs(off).max())
    if not missed <= LEAK:
        raise AccuracyError(
            f"the estimates are off the faults by {missed:.2g} (relative): the plant is too badly scaled or "
            "conditioned for this estimator; rescale its states and channels"
        )
    lag = {name: float(one) for name, one in zip(names, lags, strict=True)}
    evidence = observer.evidence.extended(
        method=_METHOD,
        poles=system.poles(),
        ranks={**observer.evidence.ranks, **reading.ranks},
        references=REFERENCES,
        conditions={
            "gain from f to its estimate, off its lag": missed,
            **({"bandwidth (rad/s)": rate} if rate else {}),
        },
    )
    maps = {"state_map": T, "static_map": V if plant.E is not None else None}
    generator = make_generator(system, plant, _METHOD, evidence, decouples=Decoupled(), estimated=names, **maps)
    generator = replace(generator, evidence=_with_noise(generator.evidence, plant, system, form, lag))
    return FaultEstimator(plant, names, observer, system, lag, generator)


def _observer_ignoring(
    plant: Plant, names: tuple[str, ...], poles: Sequence[complex] | ArrayLike | None, margin: float | None
) -> Observer:
    """Return the observer whose estimate faults do not reach as unknown inputs."""
    disturbed = plant.faults_as_disturbances(names)
    try:
        observer = unknown_input_observer(disturbed, poles=poles, margin=margin, scaling="even")
    except DesignError as error:
        if unknown_input_observer_existence(disturbed):  # the poles or the margin are wrong, not the plant
            raise
        raise DesignError(
            f"no observer of the state ignores {', '.join(names)} as unknown inputs: {error}; "
            "to estimate fewer faults at once may help"
        ) from error
    fixed = len(observer.evidence.fixed_poles)
    if fixed and fixed == len(plant.balanced.dynamics):
        raise DesignError(
            f"no pole of an estimate that ignores {', '.join(names)} is free: nothing that these faults leave corrects "
            "the state, and errors of the model would look like faults; estimate fewer faults at once, or add a sensor"
        )
    return observer


def _read_faults(plant: Plant, faults: tuple[str, ...]) -> _FaultReading:
    r"""Return the reading of faults of a plant in which they are the last disturbances.

    What the faults and disturbances ``v`` do at once, :math:`D v = y - D u - C x` and :math:`N B v = -N (A x + B u)`
    with :math:`N E = 0`, is used first; only what that leaves open is taken from derivatives of outputs that ``v``
    does not enter, :math:`W D = 0`, :math:`W C = R E`: :math:`R B v = W (\dot y - D \dot u) - R (A x + B u)`.
    The solution with the smallest derivative part is taken, with equal weights of all outputs in balanced units.

    Parameters
    ----------
    plant : Plant
        With an unknown input observer: then ``v`` is known up to what has no effect at all.
    faults : tuple of str

    Raises
    ------
    DesignError
        If the faults are not determined: they have the effect of disturbances or of one another.
    """
    model, p, n_f = plant.balanced, plant.n_outputs, len(faults)
    units, algebra = model.units, model.algebra
    weight = 1 / np.sqrt(units.measurement_weight)[:, None]
    B, D = model.disturbances  # of the states without algebraic equations, and of outputs, these among them
    C, D, free = (weight * M[:p] for M in (model.C, D, model.free[1]))
    at_once = np.vstack([D, model.disturbances[1][p:]])
    columns = np.vstack([B, at_once])
    all_of_them, without = (decide_rank(M, rtol=BALANCED_RANK, scale=1.0) for M in (columns, columns[:, :-n_f]))
    if all_of_them.rank < without.rank + n_f:
        others = plant.disturbances[: len(plant.disturbances) - n_f]
        against = f"from the disturbances {', '.join(others)} or " if others else ""
        raise DesignError(
            f"the faults {', '.join(faults)} cannot be told {against}from one another: rank [Bd Bf; Dd Df] = "
            f"{all_of_them.rank} < rank [Bd; Dd] + {n_f} = {without.rank + n_f}; estimate fewer of them at once"
        )
    W = left_null_basis(np.hstack([D, free]), rtol=BALANCED_RANK, scale=1.0)[0].T
    late, whole = W @ C @ B, np.eye(B.shape[1])[-n_f:]
    U, sizes, Vh = np.linalg.svd(at_once)
    r = int(np.count_nonzero(sizes > BALANCED_RANK))
    rest = whole @ Vh[r:].T
    rest[np.abs(rest).max(axis=1, initial=0.0) <= RESPONSE_ROUNDING] = 0.0
    L_d = rest @ _inverse(late @ Vh[r:].T)
    L_s = _without_residue((whole - L_d @ late) @ (Vh[:r].T / sizes[:r]) @ U[:, :r].T)
    missed = float(np.abs(L_s @ at_once + L_d @ late - whole).max(initial=0.0))
    if not missed <= IDENTITY:
        raise AccuracyError(
            f"the faults are read off with a relative error of {missed:.2g} > {IDENTITY:.0e}: the outputs see them too "
            "weakly; add a sensor"
        )
    P = L_s[:, p:] @ algebra + L_d @ W @ C @ model.derivative
    first = len(plant.inputs) + len(plant.disturbances) - n_f
    f, Y = units.inputs[first : first + n_f, None], weight[:, 0] * units.outputs
    return _FaultReading(
        f * L_s[:, :p] * Y,
        f * _without_residue(L_d @ W) * Y / units.rate,
        f * _without_residue(P) * units.equations / units.rate,
        np.any(L_d, axis=1),
        f[:, 0],
        {"rank [Bd Bf; Dd Df]": all_of_them, "rank [Bd; Dd]": without},
    )


def _without_residue(M: Matrix) -> Matrix:
    """Return a matrix without the entries that are rounding beside the largest of their row."""
    return above_rounding(M, np.abs(M).max(axis=1, keepdims=True, initial=0.0), RESIDUE)


def _inverse(M: Matrix) -> Matrix:
    """Return the pseudoinverse of a balanced matrix, zero for one of rounding alone."""
    return np.asarray(scipy.linalg.pinv(M, atol=BALANCED_RANK, rtol=0.0)) if M.size else M.T


def _realised(
    plant: Plant,
    names: tuple[str, ...],
    observer: Observer,
    reading: _FaultReading,
    filtered: NDArray[np.bool_],
    rate: float,
    pole: float,
) -> tuple[StateSpace, NDArray, NDArray]:
    r"""Return the estimator as one system, its state map and its static map.

    With :math:`r = L_s (y_0 - C \hat x) - P (A \hat x + B u)`, :math:`y_0 = y - D u`, :math:`d = L_d y_0` and a state
    ``q`` for each estimate that is filtered, :math:`\dot q = \alpha q + \beta r + \gamma d` and
    :math:`\hat f = q + \delta r + \varepsilon d`; the others are :math:`\hat f = r`. Continuous,
    :math:`q = \hat f - d / \tau` with :math:`\tau \dot{\hat f} = r + \dot d - \hat f`. In sampled time
    :math:`\hat f_k = a \hat f_{k-1} + (1 - a) (r_{k-1} + d_k)`, or with :math:`r_k` where no derivative is needed.
    """
    J = _summed((reading.static, plant.C), (reading.dynamics, plant.A))
    P = reading.dynamics
    if observer.J is not None:
        P = _summed((P, np.eye(plant.n_states)), (-J, observer.J))
    R, r_z, L_d = (
        _summed((reading.static, np.eye(plant.n_outputs)), (-J, observer.H)),
        -J @ observer.M,
        reading.derivative,
    )
    late, on = reading.needs_derivative[:, None], filtered[:, None]
    if plant.is_discrete:
        alpha, epsilon = pole, 1 - pole
        beta, gamma = np.where(late, epsilon, pole * epsilon), pole * epsilon
        delta = np.where(late, 0.0, np.where(on, epsilon, 1.0))
    else:
        alpha, beta, gamma, delta, epsilon = -rate, rate, -(rate**2), np.where(on, 0.0, 1.0), rate
    lagging = np.flatnonzero(filtered)
    k = len(lagging)
    T, V = np.vstack([observer.T, -(beta * P)[lagging]]), delta * P
    system = plant_filter(
        plant,
        np.block([[observer.F, np.zeros((observer.order, k))], [(beta * r_z)[lagging], alpha * np.eye(k)]]),
        T,
        np.vstack([observer.K, (beta * R + gamma * L_d)[lagging]]),
        np.hstack([delta * r_z, np.eye(len(names))[:, lagging]]),
        delta * R + epsilon * L_d,
        V,
        [f"estimate {name}" for name in names],
    )
    return system, T, V


def _summed(*products: tuple[NDArray, NDArray]) -> NDArray[np.float64]:
    """Return a sum of products without the rounding of terms that cancel."""
    total = np.add.reduce([left @ right for left, right in products])
    return above_rounding(total, np.add.reduce([np.abs(left) @ np.abs(right) for left, right in products]))


def _with_noise(
    evidence: Evidence, plant: Plant, s: StateSpace, form: StateSpace, lag: Mapping[str, float]
) -> Evidence:
    """Return evidence with the lags of the estimates, and their gains from measurements and noise."""
    conditions: dict[str, float] = {}
    notes: list[str] = []
    n_u, noise = len(plant.inputs), slice(form.n_inputs - len(plant.noises), None)
    for i, (name, late) in enumerate(lag.items()):
        conditions[f"lag of {name} (s)"] = late
        conditions[f"peak gain, outputs to {name}"] = hinf_norm(
            s.A, s.B[:, n_u:], s.C[[i]], s.D[[i]][:, n_u:], s.dt
        ).value
        if plant.noises:
            D = form.D[[i], noise]
            rms = h2_norm(form.A, form.B[:, noise], form.C[[i]], D, form.dt)
            conditions[f"noise of {name}, rms"] = rms
            if not np.isfinite(rms):
                notes.append(
                    f"white measurement noise of a continuous plant reaches the estimate of {name} directly, by "
                    f"{float(np.linalg.norm(D)):.3g} per unit, so that its variance is finite when sampled only"
                )
    return evidence.extended(conditions=conditions, notes=tuple(notes))
