"""The jet engine of Chen, Patton and Zhang (1996), with its second-order model as the real engine."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import AccuracyError, ModelError
from residua.library.simulation import Course, SimulatedRecording, fault_courses, filled, runge_kutta
from residua.plant import Plant, quadratic_terms

A = ((-1.5581, 0.6925, 0.3974), (0.2619, -2.2228, 0.2238), (0.0, 0.0, -10.0))
B = ((0.0,), (0.0,), (10.0,))
C = (
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0),
    (0.55107, 0.13320, 0.30603),
    (0.55217, 0.13526, 0.32912),
    (-0.25693, -0.23625, 0.61199),
)

#: C(6, 3) as printed; the paper's own T and K follow from 0.61199.
PRINTED_C63 = 0.61299

#: How the second-order terms ``x1^2, x2^2, x3^2, x1 x2, x1 x3, x2 x3`` enter the state equation.
E_HAT = (
    (1.3293, 3.4440, 0.1375, -5.1304, -1.7826, -1.8719),
    (5.6812, -0.5281, -0.3385, -1.6193, 0.5229, 0.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)

STATES = ("n_low", "n_high", "fuel_flow")
OUTPUTS = ("n_low", "n_high", "fuel_flow", "p2", "p4", "t4")


def jet_engine(*, corrected: bool = True, disturbances: bool = True) -> Plant:
    r"""Return the linear model of a jet engine at one operating point.

    Three states (speeds of the two shafts and fuel flow), six measurements (the states, two pressures and a
    temperature), one input. All signals are relative deviations from the operating point. The faults are
    the sensors of the three states and the actuator.

    Parameters
    ----------
    corrected : bool
        With ``C(6,3) = 0.61199``, which reproduces the paper's ``T`` and ``K``; with the printed ``0.61299``
        when false.
    disturbances : bool
        Whether the linearisation error enters as unknown input, by the factored ``E_HAT``.

    Returns
    -------
    Plant
        Continuous.

    References
    ----------
    Chen, Patton and Zhang (1996), Int. J. Control 63(1), section 4.

    Examples
    --------
    >>> from residua.library import jet_engine
    >>> jet_engine().disturbances
    ('d1', 'd2')
    """
    measured = np.array(C)
    if not corrected:
        measured[5, 2] = PRINTED_C63
    engine = Plant(
        A,
        B,
        measured,
        inputs=["fuel"],
        outputs=OUTPUTS,
        states=STATES,
        name="jet engine",
        description="Jet engine of Chen, Patton and Zhang (1996), section 4; relative deviations.",
    )
    if disturbances:
        engine = engine.with_disturbances(E_HAT)
    return engine.with_sensor_faults(STATES).with_actuator_faults()


def jet_engine_rate(x: ArrayLike, u: ArrayLike) -> NDArray[np.float64]:
    r"""Return :math:`\dot x = A x + B u + \hat E d(x)`, the second-order model in the place of the engine.

    Parameters
    ----------
    x : array_like, shape (..., 3)
    u : array_like, shape (..., 1)

    Returns
    -------
    ndarray, shape (..., 3)

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (32).
    """
    x = np.asarray(x, dtype=float)
    return x @ np.array(A).T + np.asarray(u, dtype=float) @ np.array(B).T + quadratic_terms(x) @ np.array(E_HAT).T


def jet_engine_steady_state(u: float) -> NDArray[np.float64]:
    """Return the state at which the second-order engine rests with constant fuel, by Newton's method.

    Parameters
    ----------
    u : float
        Relative deviation of the fuel command.

    Returns
    -------
    ndarray, shape (3,)

    Raises
    ------
    AccuracyError
        If there is no steady state near the operating point.

    Examples
    --------
    >>> from residua.library import jet_engine_steady_state
    >>> jet_engine_steady_state(0.2).round(5)
    array([0.04829, 0.02685, 0.2    ])
    """
    command = np.array([float(u)])
    x = np.zeros(3)
    for _ in range(50):
        rate = jet_engine_rate(x, command)
        step = np.linalg.solve(_jacobian(x), rate)
        x = x - step
        if np.abs(step).max() <= 1e-14 * (1 + np.abs(x).max()):
            break
    if not np.abs(jet_engine_rate(x, command)).max() < 1e-10 * (1 + abs(float(u))):
        raise AccuracyError(f"the second-order engine has no steady state at u = {u} that Newton's method finds")
    return x


def simulate_jet_engine(
    u: ArrayLike,
    *,
    dt: float = 0.01,
    faults: Mapping[str, Course] | None = None,
    relative: bool = False,
    x0: ArrayLike | None = None,
    noise: float = 0.0,
    seed: int = 0,
) -> SimulatedRecording:
    r"""Simulate the second-order engine with faults.

    Runge-Kutta of fourth order with the input held over each step.

    Parameters
    ----------
    u : array_like, shape (T,) or (T, 1)
        Commanded fuel, as relative deviation.
    dt : float
        Step in seconds, at most 0.1.
    faults : mapping of str to array_like, shape (T,), number, or function of time, optional
        Fault name (as in :func:`jet_engine`: ``"n_low sensor"`` .. ``"t4 sensor"``, ``"fuel actuator"``) to its
        course; a number is a constant fault, :func:`drift` makes one that grows.
    relative : bool
        Whether sensor faults are fractions of the measured deviation (0.02: it reads 2 % too high).
    x0 : array_like, shape (3,), optional
        Initial state; zero when omitted.
    noise : float
        Standard deviation of white measurement noise.
    seed : int
        Of the noise.

    Returns
    -------
    SimulatedRecording

    Raises
    ------
    ModelError
        If a fault is unknown, a shape does not fit or the engine leaves the range of its model.

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (32).

    Examples
    --------
    >>> import numpy as np
    >>> from residua.library import simulate_jet_engine
    >>> run = simulate_jet_engine(np.full(1000, 0.2), faults={"n_low sensor": 0.02}, relative=True)
    >>> run.y.shape
    (1000, 6)
    >>> float((run.y[-1, 0] / run.x[-1, 0]).round(6))
    1.02
    """
    steps = np.size(u)
    command = filled(np.reshape(u, (-1, 1)), (steps, 1), "u")
    if not (np.isfinite(dt) and 0 < dt <= 0.1):
        raise ModelError(f"dt must lie in (0, 0.1] seconds, got {dt}")
    courses = fault_courses(faults, ("fuel actuator", *(f"{name} sensor" for name in OUTPUTS)), steps, dt=dt)
    applied = command + courses["fuel actuator"][:, None]
    x = np.zeros((steps, 3))
    x[0] = 0.0 if x0 is None else np.asarray(x0, dtype=float)
    for k in range(steps - 1):
        x[k + 1] = runge_kutta(partial(jet_engine_rate, u=applied[k]), x[k], dt)
        if not np.abs(x[k + 1]).max() < 10:
            raise ModelError(
                f"the second-order engine runs away at {(k + 1) * dt:g} s: its model holds for small deviations only"
            )
    y = x @ np.array(C).T
    bias = np.column_stack([courses[f"{name} sensor"] for name in OUTPUTS])
    y = y * (1 + bias) if relative else y + bias
    if noise:
        y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    return SimulatedRecording(np.arange(steps, dtype=np.float64) * dt, command, y, x, float(dt))


def _jacobian(x: NDArray) -> NDArray:
    x1, x2, x3 = x
    terms = np.array([[2 * x1, 0, 0], [0, 2 * x2, 0], [0, 0, 2 * x3], [x2, x1, 0], [x3, 0, x1], [0, x3, x2]])
    return np.array(A) + np.array(E_HAT) @ terms
