"""The three-tank benchmark (Amira DTS200): its nonlinear model, linearised."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.errors import ModelError
from residua.plant import Plant

AREA = 154.0  #: Cross-section of each tank, cm2.
PIPE = 0.5  #: Cross-section of each pipe, cm2.
OUTFLOW_13, OUTFLOW_20, OUTFLOW_32 = 0.46, 0.60, 0.45  #: Outflow coefficients.
GRAVITY = 981.0  #: cm/s2.
HIGHEST_LEVEL = 62.0  #: cm.
LARGEST_FLOW = 150.0  #: cm3/s.

LEVELS = (41.0, 32.0, 36.6)  #: Nominal levels, cm.
FLOWS = (21.4, 53.8)  #: Nominal pump flows, cm3/s.

LEVEL_NOISE = 0.02  #: Variance of the level measurements, cm2.
PROCESS_NOISE = 1e-4  #: Variance that each level gains per second, cm2.
FLOW_NOISE = (0.05, 0.02)  #: Variance of the real pump flows about the commanded ones, (cm3/s)2.

LEAKS = ("leak 1", "leak 2", "leak 3")
CLOGS = ("clog 13", "clog 20", "clog 32")
SENSORS = ("h1 sensor", "h2 sensor", "h3 sensor")
ACTUATORS = ("Q1 actuator", "Q2 actuator")
#: Description of each fault, by the words of its name, the first checks, and its unit.
NOTES = (
    (
        ACTUATORS,
        "Pump {0} delivers another flow than its command.",
        "the pump's voltage and speed, its inlet filter, and the calibration of its flow",
        "",
    ),
    (
        SENSORS,
        "The reading of level {0} is off.",
        "the reading against the scale on the tank; the sensor's connector and zero",
        "",
    ),
    (
        LEAKS,
        "A hole in the bottom of tank {1}.",
        "whether the drain valve below the tank is shut; the floor below it for water",
        "cm2",
    ),
    (
        CLOGS,
        "Part of the opening of a pipe is lost.",
        "the valve of the pipe for its position and for dirt",
        "of the opening",
    ),
)


def three_tank(dt: float = 1.0) -> Plant:
    r"""Return the three-tank system, linearised at its nominal operating point.

    .. math::

       \begin{aligned}
       A \dot h_1 &= Q_1 - Q_{13}, & Q_{13} &= a_1 s\, \mathrm{sgn}(h_1 - h_3) \sqrt{2 g |h_1 - h_3|}, \\
       A \dot h_2 &= Q_2 + Q_{32} - Q_{20}, & Q_{32} &= a_3 s\, \mathrm{sgn}(h_3 - h_2) \sqrt{2 g |h_3 - h_2|}, \\
       A \dot h_3 &= Q_{13} - Q_{32}, & Q_{20} &= a_2 s \sqrt{2 g h_2}.
       \end{aligned}

    Levels in cm, flows in cm³/s; the operating point is part of the plant, so recordings go in as they are.
    The faults, with their units:

    - ``Q1 actuator``, ``Q2 actuator``: flow beyond the commanded one, cm³/s;
    - ``h1 sensor`` .. ``h3 sensor``: offset of the reading, cm;
    - ``leak 1`` .. ``leak 3``: area of a hole at the bottom of the tank, cm²;
    - ``clog 13``, ``clog 20``, ``clog 32``: fraction of the opening of a pipe that is lost.

    Parameters
    ----------
    dt : float
        Step in seconds; 0 for the continuous plant.

    Returns
    -------
    Plant
        The noise is the benchmark's: variance 0.02 cm² on each reading and 1e-4 cm² per second on each level
        (its pump noise adds 2 % of that and is left out).

    References
    ----------
    The published model of the Amira DTS200 laboratory plant, with the parameters, noise and faults of the
    recordings at github.com/zhuofupan/Three-Tank-System.

    Examples
    --------
    >>> from residua.library import three_tank
    >>> three_tank().outputs
    ('h1', 'h2', 'h3')
    >>> three_tank(dt=0).system().is_stable()
    True
    """
    h = np.array(LEVELS)
    q13, q20, q32 = pipe_flows(h)
    k13, k20, k32 = q13 / (2 * (h[0] - h[2])), q20 / (2 * h[1]), q32 / (2 * (h[2] - h[1]))
    leak = np.sqrt(2 * GRAVITY * h)
    A = np.array([[-k13, 0, k13], [0, -k32 - k20, k32], [k13, k32, -k13 - k32]]) / AREA
    plant = Plant(
        A,
        np.array([[1, 0], [0, 1], [0, 0]]) / AREA,
        np.eye(3),
        inputs=["Q1", "Q2"],
        outputs=["h1", "h2", "h3"],
        states=["h1", "h2", "h3"],
        units={"Q1": "cm3/s", "Q2": "cm3/s", "h1": "cm", "h2": "cm", "h3": "cm"},
        name="three-tank system",
        description="Amira DTS200 three-tank benchmark, linearised at its nominal operating point.",
    )
    plant = plant.with_operating_point(inputs=FLOWS, outputs=LEVELS).with_actuator_faults().with_sensor_faults()
    for i, name in enumerate(LEAKS):
        plant = plant.with_faults({name: {f"h{i + 1}": -leak[i] / AREA}}, component=f"tank {i + 1}")
    directions = (q13 * np.array([1, 0, -1]), q20 * np.array([0, 1, 0]), q32 * np.array([0, -1, 1]))
    for name, direction in zip(CLOGS, directions, strict=True):
        plant = plant.with_faults({name: direction / AREA}, component=name.replace("clog", "pipe"))
    plant = plant.with_fault_notes(
        {
            name: {"description": text.format(*name.split()), "check": check, "unit": unit}
            for names, text, check, unit in NOTES
            for name in names
        }
    )
    if dt == 0:
        return plant.with_noise(process=PROCESS_NOISE, measurement=LEVEL_NOISE)
    return plant.discretize(dt).with_noise(process=PROCESS_NOISE * dt, measurement=LEVEL_NOISE)


def pipe_flows(h: ArrayLike, clogs: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[NDArray, NDArray, NDArray]:
    """Return the flows Q13, Q20 and Q32 in cm³/s.

    Parameters
    ----------
    h : array_like, shape (..., 3)
        Levels in cm.
    clogs : array_like, shape (..., 3)
        Lost fraction of the openings, in the order 13, 20, 32.

    Returns
    -------
    q13, q20, q32 : ndarray, shape (...)
    """
    h1, h2, h3 = _parts(np.asarray(h, dtype=float))
    c13, c20, c32 = _parts(PIPE * (1.0 - np.asarray(clogs, dtype=float)))
    return (
        OUTFLOW_13 * c13 * np.sign(h1 - h3) * np.sqrt(2 * GRAVITY * np.abs(h1 - h3)),
        OUTFLOW_20 * c20 * np.sqrt(2 * GRAVITY * np.maximum(h2, 0.0)),
        OUTFLOW_32 * c32 * np.sign(h3 - h2) * np.sqrt(2 * GRAVITY * np.abs(h3 - h2)),
    )


def _parts(a: NDArray) -> NDArray:
    """Return an array with its last axis first; a shortcut for one axis, since NumPy's way is slow in simulations."""
    return a if a.ndim == 1 else np.moveaxis(a, -1, 0)


def three_tank_rate(
    h: ArrayLike, q: ArrayLike, *, leaks: ArrayLike = (0.0, 0.0, 0.0), clogs: ArrayLike = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Return the rates of the levels, in cm/s, by the nonlinear model.

    Parameters
    ----------
    h : array_like, shape (..., 3)
        Levels in cm.
    q : array_like, shape (..., 2)
        Pump flows in cm³/s.
    leaks : array_like, shape (..., 3)
        Area of a hole in each tank in cm².
    clogs : array_like, shape (..., 3)
        Lost fraction of the openings, in the order 13, 20, 32.

    Returns
    -------
    ndarray, shape (..., 3)

    Examples
    --------
    >>> from residua.library.three_tank import FLOWS, LEVELS, three_tank_rate
    >>> bool(abs(three_tank_rate(LEVELS, FLOWS)).max() < 3e-4)
    True
    """
    h, q, leaks, clogs = (np.asarray(one, dtype=float) for one in (h, q, leaks, clogs))
    if h.ndim == q.ndim == leaks.ndim == clogs.ndim == 1:
        return np.array(_rate_at(*(one.tolist() for one in (h, q, leaks, clogs))))
    q1, q2 = np.moveaxis(q, -1, 0)
    q13, q20, q32 = pipe_flows(h, clogs)
    net = np.stack(np.broadcast_arrays(q1 - q13, q2 + q32 - q20, q13 - q32), axis=-1)
    return (net - leaks * np.sqrt(2 * GRAVITY * np.maximum(h, 0.0))) / AREA


def _rate_at(h: list[float], q: list[float], leaks: list[float], clogs: list[float]) -> list[float]:
    """Return the rates of one state, equal to the last bit: a simulation needs one at a time."""
    h1, h2, h3 = h
    c13, c20, c32 = (PIPE * (1.0 - clog) for clog in clogs)
    q13 = OUTFLOW_13 * c13 * math.copysign(1.0, h1 - h3) * math.sqrt(2 * GRAVITY * abs(h1 - h3))
    q20 = OUTFLOW_20 * c20 * math.sqrt(2 * GRAVITY * max(h2, 0.0))
    q32 = OUTFLOW_32 * c32 * math.copysign(1.0, h3 - h2) * math.sqrt(2 * GRAVITY * abs(h3 - h2))
    net = q[0] - q13, q[1] + q32 - q20, q13 - q32
    out = (leak * math.sqrt(2 * GRAVITY * max(level, 0.0)) for leak, level in zip(leaks, h, strict=True))
    return [(one - other) / AREA for one, other in zip(net, out, strict=True)]


def three_tank_fault(number: int, steps: int = 2001, *, dt: float = 1.0, onset: float = 200.0) -> dict[str, NDArray]:
    """Return one of the faults 1 to 12 of the benchmark, for simulation.

    Number 3 is the drift of the pump alone, without the pulse that the benchmark adds.

    Parameters
    ----------
    number : int
        1 both pumps (sine), 2 and 3 pump 1 and 2 (drift), 4 to 6 sensors (drift), 7 to 9 leaks, 10 to 12
        clogged pipes 13, 20, 32; all grow slowly from ``onset`` on.
    steps : int
    dt : float
        Step in seconds.
    onset : float
        Time at which the fault begins, in seconds.

    Returns
    -------
    dict of str to ndarray, shape (steps,)
        Fault name to time course, as :func:`simulate_three_tank` takes it.

    Examples
    --------
    >>> from residua.library import three_tank_fault
    >>> {name: round(float(course[-1]), 6) for name, course in three_tank_fault(8).items()}
    {'leak 2': 0.09}
    """
    tau = np.maximum(dt * np.arange(steps) - onset, 0.0)
    if number == 1:
        swing = 6 * np.sin(tau / (6 * np.pi))
        return {"Q1 actuator": swing, "Q2 actuator": swing}
    slopes = {
        2: ("Q1 actuator", 0.02),
        3: ("Q2 actuator", 0.005),
        4: ("h1 sensor", -0.005),
        5: ("h2 sensor", 0.005),
        6: ("h3 sensor", 0.008),
        7: ("leak 1", 5e-5),
        8: ("leak 2", 5e-5),
        9: ("leak 3", 5e-5),
        10: ("clog 13", 2e-4),
        11: ("clog 20", 3e-4),
        12: ("clog 32", 5e-4),
    }
    if number not in slopes:
        raise ModelError(f"the benchmark has the faults 1 to 12, not {number!r}")
    name, slope = slopes[number]
    return {name: slope * tau}
