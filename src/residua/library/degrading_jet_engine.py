"""Jet engine of the robust l1 fault detection paper: known up to the wear of twelve numbers, in closed loop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import DesignError, ModelError, SettingError
from residua.library.simulation import Course, SimulatedRecording, fault_courses, filled
from residua.linear import StateSpace, filter_riccati
from residua.plant import Plant
from residua.robust.sets.uncertain_plant import Perturbation, UncertainPlant

DT = 0.01  #: Sample step, seconds.
#: As printed, but for the two entries that the scan leaves open.
A = ((0.8938, 0.0034, 0.0020), (-0.0001, 0.8940, 0.0014), (0.0, -0.0001, np.nan))
B = ((0.0059, 0.1119, -0.0160), (0.0042, 0.0720, 0.0083), (0.0001, -0.0003, 0.0))
C = ((1.0, 0.0077, 0.0044), (-0.0003, 1.0, 0.0031), (0.0299, -0.0208, np.nan))
D1, D2 = (0.1, 0.1, 0.01), (0.1, 0.1, 0.1)  #: Diagonals.

#: Readings of the entries (3,3) of ``A`` and ``C``; the first are taken when nothing is said.
A33_READINGS = (0.8996, 0.8960, 0.9960)
C33_READINGS = (0.0010, 1.0010)

#: Bounds of the first two rows of ``dA``, by rows, and of the first rows of ``dB`` and ``dC``.
BOUNDS_A = ((0, 0.0011), (-0.0008, 0), (0, 0.0002), (-0.0001, 0), (0, 0.0005), (0, 0.0001))
BOUNDS_B = ((0, 0.0008), (0, 0.0115), (-0.0005, 0))
BOUNDS_C = ((-0.0001, 0), (-0.0015, 0), (0, 0.0004))

STATES = ("XNH", "XNL", "TMPC")
INPUTS = ("WF36", "A8", "A16")
UNITS = {"XNH": "rpm", "XNL": "rpm", "TMPC": "degC", "WF36": "kg/h", "A8": "m2", "A16": "m2"}


def degrading_jet_engine(*, a33: float = 0.8996, c33: float = 0.0010) -> UncertainPlant:
    r"""Return the model of a jet engine that degrades over time.

    .. math::

       x_{k+1} = (A + \Delta A) x_k + (B + \Delta B) u_k + D_1 w_k, \qquad
       y_k = (C + \Delta C) x_k + D_2 w_k + f_k, \qquad |w_k|_2 \le 1

    The states are the speeds of the high and the low pressure spool and the temperature at the inlet of the high
    pressure compressor; the inputs are fuel flow, nozzle throat area and bypass duct area; all as deviations from an
    operating point, every 0.01 s. The faults are offsets of the three sensors. A new engine has parameters 0; wear
    moves the first two rows of ``A`` (``dA1`` to ``dA6``) and the first rows of ``B`` and ``C`` (``dB1`` to ``dB3``,
    ``dC1`` to ``dC3``) within bounds, one of which is 0 for each parameter.

    Two numbers of the matrices cannot be read with certainty; they are options, and no conclusion should rest on one
    reading. With :func:`degrading_jet_engine_controller` the loop is stable at all 4096 corners in each of the six.

    Parameters
    ----------
    a33 : {0.8996, 0.8960, 0.9960}
        ``A(3,3)``. Printed is 0.89960, with one digit more than all other entries have: one of them is too many. 0.8996
        (the 0) and 0.8960 (the 9 behind the 8) are lags like the other two states; 0.9960 (the 8) is one of 2.5 s, not
        implausible for a temperature.
    c33 : {0.0010, 1.0010}
        ``C(3,3)``. Printed is 0.0010. The third sensor then hardly sees its own state, and ``C`` is almost singular
        (smallest singular value 0.00093), although the text says that the outputs measure the states, as the first two
        do: 1.0010 (smallest singular value 0.98) is what would fit it.

    Returns
    -------
    UncertainPlant
        Sampled; disturbances ``w1`` to ``w3``, faults ``XNH sensor``, ``XNL sensor``, ``TMPC sensor``.

    Raises
    ------
    SettingError
        If a digit is none of the readings.

    References
    ----------
    Robust l1 fault detection, section 4, eqs. (50)-(56).

    Examples
    --------
    >>> from residua.library import degrading_jet_engine
    >>> engine = degrading_jet_engine()
    >>> engine
    UncertainPlant('degrading jet engine': 3 states, 12 parameters in 12 channels, dt=0.01 s)
    >>> engine.nominal.faults
    ('XNH sensor', 'XNL sensor', 'TMPC sensor')
    """
    known, measured = np.array(A), np.array(C)
    known[2, 2] = _reading(a33, A33_READINGS, "a33")
    measured[2, 2] = _reading(c33, C33_READINGS, "c33")
    plant = Plant(
        known,
        B,
        measured,
        dt=DT,
        inputs=INPUTS,
        outputs=STATES,
        states=STATES,
        units=UNITS,
        name="degrading jet engine",
        description="Jet engine of the robust l1 fault detection paper, section 4; deviations from an operating point.",
    )
    plant = plant.with_disturbances(np.diag(D1), ["w1", "w2", "w3"], output=np.diag(D2)).with_sensor_faults()
    one = np.eye(3)
    return UncertainPlant(
        plant,
        deltas=[
            _wear("A", np.repeat(one[:, :2], 3, axis=1), np.vstack([one, one]), BOUNDS_A),
            _wear("C", np.repeat(one[:, :1], 3, axis=1), one, BOUNDS_C),
            _wear("B", np.repeat(one[:, :1], 3, axis=1), one, BOUNDS_B),
        ],
    )


def degrading_jet_engine_controller(
    engine: UncertainPlant | None = None, *, state_weight: float = 1.0, input_weight: float = 1.0
) -> StateSpace:
    r"""Return the regulator of the engine: a Kalman filter and state feedback (LQG), designed for the new engine.

    .. math::

       \hat x_{k+1} = (A - B K - L C) \hat x_k + L y_k, \qquad u_k = -K \hat x_k

    ``K`` minimises :math:`\sum q |x_k|^2 + r |u_k|^2`; ``L`` is the gain of the Kalman filter for noise with the
    covariances :math:`D_1 D_1^T` of the states and :math:`D_2 D_2^T` of the outputs, independent of each other. The
    paper has an LQG controller and tells neither weights nor covariances: these are ours.

    Parameters
    ----------
    engine : UncertainPlant, optional
        Sampled, with disturbances in all outputs; :func:`degrading_jet_engine` when omitted.
    state_weight, input_weight : float
        ``q`` and ``r``.

    Returns
    -------
    StateSpace
        From the outputs of the engine to its inputs; ``engine.in_closed_loop(controller)`` closes the loop.

    Raises
    ------
    ModelError
        If the engine is not a sampled uncertain plant.
    SettingError
        If a weight is not positive.

    References
    ----------
    Robust l1 fault detection, eqs. (9)-(10) and section 4.

    Examples
    --------
    >>> from residua.library import degrading_jet_engine, degrading_jet_engine_controller
    >>> engine = degrading_jet_engine()
    >>> loop = engine.in_closed_loop(degrading_jet_engine_controller(engine))
    >>> loop.nominal.system().is_stable()
    True
    """
    plant = _sampled(engine).nominal
    for name, weight in (("state_weight", state_weight), ("input_weight", input_weight)):
        if not (np.isfinite(weight) and weight > 0):
            raise SettingError(f"{name} must be a positive number, got {weight!r}")
    # The regulator is the filter of the transposed plant.
    feedback = filter_riccati(
        plant.A.T,
        plant.B.T,
        state_weight * np.eye(plant.n_states),
        input_weight * np.eye(len(plant.inputs)),
        dt=plant.dt,
    )
    estimator = filter_riccati(plant.A, plant.C, plant.Bd @ plant.Bd.T, plant.Dd @ plant.Dd.T, dt=plant.dt)
    K, L = feedback.gain.T, estimator.gain
    return StateSpace(
        plant.A - plant.B @ K - L @ (plant.C - plant.D @ K),
        L,
        -K,
        dt=plant.dt,
        inputs=plant.outputs,
        outputs=plant.inputs,
        states=[f"estimated {name}" for name in plant.states],
    )


def degrading_jet_engine_corner() -> dict[str, float]:
    """Return the engine simulated in the paper: every parameter at its nonzero bound.

    Returns
    -------
    dict of str to float

    References
    ----------
    Robust l1 fault detection, section 4, below eq. (56).

    Examples
    --------
    >>> from residua.library import degrading_jet_engine, degrading_jet_engine_corner
    >>> corner = degrading_jet_engine_corner()
    >>> corner["dA1"], corner["dA2"]
    (0.0011, -0.0008)
    >>> degrading_jet_engine().member(corner).A[0].round(4)
    array([0.8949, 0.0026, 0.0022])
    """
    return {parameter.name: parameter.low or parameter.high for parameter in degrading_jet_engine().parameters}


def simulate_degrading_jet_engine(
    seconds: float = 70.0,
    *,
    faults: Mapping[str, Course] | None = None,
    values: Mapping[str, float] | ArrayLike | None = None,
    engine: UncertainPlant | None = None,
    controller: StateSpace | None = None,
    disturbance: ArrayLike = "sphere",
    seed: int = 0,
) -> SimulatedRecording:
    """Simulate one member of the set of engines under its controller, from rest, with faults.

    The controller reads the faulty sensors: a fault of one sensor moves the engine, and with it all outputs.

    Parameters
    ----------
    seconds : float
        Length; one sample every 0.01 s, the first at 0.
    faults : mapping of str to array_like, shape (T,), number, or function of time, optional
        Name of a fault (as in :func:`degrading_jet_engine`) to its course; :func:`drift` makes one that grows.
    values : mapping of str to float, or array_like, shape (parameters,), optional
        The member; parameters that a mapping leaves out are nominal, ``{}`` is the new engine.
        :func:`degrading_jet_engine_corner` when omitted.
    engine : UncertainPlant, optional
        Another reading of the digits; :func:`degrading_jet_engine` when omitted.
    controller : StateSpace, optional
        From outputs to inputs; :func:`degrading_jet_engine_controller` of the engine when omitted.
    disturbance : "sphere" or array_like, shape (T, disturbances), or number
        ``"sphere"``: of length 1 at every sample, with a direction drawn evenly; 0 for none.
    seed : int
        Of the directions.

    Returns
    -------
    SimulatedRecording
        ``u`` is what the controller commands, ``y`` what the sensors read, ``x`` the true state of the engine.

    Raises
    ------
    ModelError
        If a fault or parameter is unknown, a parameter is outside of its bounds or a shape does not fit.
    DesignError
        If the loop is not stable for this member.
    SettingError
        If the length is not positive or the disturbance is another word.

    References
    ----------
    Robust l1 fault detection, section 4, Figures 2 and 3.

    Examples
    --------
    >>> from residua.library import drift, simulate_degrading_jet_engine
    >>> run = simulate_degrading_jet_engine(2.0, faults={"XNL sensor": drift(1.0, 0.5)})
    >>> run.y.shape, float(run.time[-1].round(2))
    ((200, 3), 1.99)
    """
    engine = _sampled(engine)
    plant = engine.nominal
    if not (np.isfinite(seconds) and seconds >= plant.dt):
        raise SettingError(f"seconds must be finite and at least one step of {plant.dt:g} s, got {seconds!r}")
    steps = round(seconds / plant.dt)
    courses = fault_courses(faults, plant.faults, steps, dt=plant.dt)
    f = np.column_stack([np.zeros((steps, 0)), *courses.values()])
    shape = steps, len(plant.disturbances)
    if not isinstance(disturbance, str):
        w = filled(disturbance, shape, "disturbance")
    elif disturbance == "sphere":
        draw = np.random.default_rng(seed).standard_normal(shape)
        w = draw / np.linalg.norm(draw, axis=1, keepdims=True)
    else:
        raise SettingError(f"disturbance must be 'sphere' or numbers of shape {shape}, got {disturbance!r}")
    if controller is None:
        controller = degrading_jet_engine_controller(engine)
    member = engine.in_closed_loop(controller).member(degrading_jet_engine_corner() if values is None else values)
    system = member.system(("disturbance", "fault"))
    if not system.is_stable():
        raise DesignError(
            f"the loop is not stable for this member of the set (spectral radius {np.abs(system.poles()).max():.6g}): "
            "choose other values or another controller"
        )
    by_name = set(controller.outputs) == set(plant.inputs)
    commands = controller.explicit().select(outputs=plant.inputs if by_name else None).C
    n, m = plant.n_states, len(commands)
    C = np.vstack([system.C, np.hstack([np.zeros((m, n)), commands]), np.eye(n, system.n_states)])
    D = np.vstack([system.D, np.zeros((m + n, system.n_inputs))])
    seen = StateSpace(system.A, system.B, C, D, dt=system.dt).simulate(np.hstack([w, f]))
    y, u, x = np.split(seen, np.cumsum([plant.n_outputs, m]).tolist(), axis=1)
    return SimulatedRecording(np.arange(steps, dtype=np.float64) * plant.dt, u, y, x, plant.dt)


def _sampled(engine: UncertainPlant | None) -> UncertainPlant:
    if engine is None:
        return degrading_jet_engine()
    if not isinstance(engine, UncertainPlant) or not engine.nominal.is_discrete:
        raise ModelError(f"engine must be a sampled UncertainPlant, such as degrading_jet_engine() is, got {engine!r}")
    return engine


def _reading(value: float, readings: tuple[float, ...], name: str) -> float:
    if value not in readings:
        known = ", ".join(map(str, readings))
        raise SettingError(f"{name} must be one of the readings of the scan, {known}, got {value!r}")
    return value


def _wear(matrix: str, rows: NDArray, columns: NDArray, bounds: tuple[tuple[float, float], ...]) -> Perturbation:
    """Return ``dM = rows F columns``: the literature's sign is the other one, ``-H F G``."""
    low, high = np.transpose(bounds)
    return Perturbation(matrix, -rows, columns, low, high, [f"d{matrix}{i + 1}" for i in range(len(bounds))])
