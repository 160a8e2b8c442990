"""Simulated plants whose logs teach a fault detector what fault-free running looks like.

Ten plants of different kinds give fault-free logs (:data:`SETS`); :func:`with_sensor_fault` puts a fault of one
measurement into such a log; :func:`turbine_year` gives a year of a wind turbine's ten-minute means, with or without
stops and curtailments. Every random number comes from the generator that the caller passes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.special import gamma, log_ndtr

__all__ = ["SETS", "LearntSet", "turbine_year", "with_sensor_fault"]


@dataclass(frozen=True)
class LearntSet:
    """Plant with a name, its columns, its time step and a simulator of fault-free rows.

    Attributes
    ----------
        name: what the set is called.
        inputs: columns that drive the plant; they come first in a row.
        outputs: measured columns; they follow the inputs.
        dt: seconds per row.
        simulate: function of a generator and a number of rows that gives rows of (inputs, outputs), fault free.
        actuated: whether a controller in closed loop moves an actuator whose command is one of the columns.
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    simulate: Callable[[np.random.Generator, int], np.ndarray]
    actuated: bool = False


# ---------------------------------------------------------------- signals


def _ar(rng: np.random.Generator, n: int, pole: float, std: float) -> np.ndarray:
    """First-order autoregression of `n` rows with stationary deviation `std`, started in its stationary state."""
    shock = rng.standard_normal(n)
    shock[1:] *= np.sqrt(1.0 - pole**2)
    return std * lfilter([1.0], [1.0, -pole], shock)


def _steps(rng: np.random.Generator, n: int, low: float, high: float, shortest: int, longest: int) -> np.ndarray:
    """Levels uniform in [low, high], each held for a random number of rows from `shortest` to `longest`."""
    holds = rng.integers(shortest, longest + 1, size=n // shortest + 1)
    return np.repeat(rng.uniform(low, high, size=holds.size), holds)[:n]


def _walk(rng: np.random.Generator, n: int, low: float, high: float, rows: float) -> np.ndarray:
    """Random walk reflected at `low` and `high` that needs about `rows` rows to wander across that range."""
    path = rng.uniform(0.0, 2.0) + np.cumsum(rng.standard_normal(n)) / np.sqrt(rows)
    return low + (high - low) * np.abs(np.mod(path, 2.0) - 1.0)


def _lag(signal: np.ndarray, pole: float) -> np.ndarray:
    """First-order lag of unit gain, settled at the first row's value."""
    return lfilter([1.0 - pole], [1.0, -pole], signal, zi=[pole * signal[0]])[0]


# ---------------------------------------------------------------- plants


def _blind(rng: np.random.Generator, n: int) -> np.ndarray:
    """Sensor that a large slow disturbance drowns: the input explains next to nothing of the output."""
    u = np.repeat(rng.choice([-1.0, 1.0], size=n // 60 + 1), 60)[:n]
    d = _ar(rng, n, 0.985, 1.0 / np.sqrt(1.0 - 0.985**2))
    y = u + 4.0 * d + 0.3 * rng.standard_normal(n)
    return np.column_stack([u, y])


def _load_curves(load: np.ndarray) -> np.ndarray:
    """Noise-free readings of the eight sensors at loads between 0 and 1."""
    return np.column_stack(
        [
            20.0 + 60.0 * load,
            3.0 + 9.0 * load**2,
            400.0 * load / (0.25 + load),
            150.0 - 80.0 * load + 25.0 * load**2,
            1.0 + 4.0 * (load - 0.45) ** 2,
            50.0 * np.tanh(3.0 * (load - 0.3)),
            8.0 * np.sqrt(0.05 + load),
            0.6 + 0.5 * load - 0.35 * load**2,
        ]
    )


def _curved_load(rng: np.random.Generator, n: int) -> np.ndarray:
    """Eight sensors that all follow one unmeasured slow load by curves, each with noise of 3 % of its span."""
    load = 0.5 + 0.5 * np.tanh(0.9 * _ar(rng, n, 0.99, 1.0))
    span = np.ptp(_load_curves(np.linspace(0.0, 1.0, 201)), axis=0)
    return _load_curves(load) + 0.03 * span * rng.standard_normal((n, span.size))


_LINEAR_B = np.array([[0.9, -0.4], [-0.5, 0.7], [0.3, 0.2], [0.1, -0.25], [0.12, 0.1], [-0.04, 0.07]])
_LINEAR_C = np.array(
    [
        [0.8, 0.0, 0.5, -0.3, 0.6, 0.2],
        [0.1, 0.9, -0.4, 0.2, 0.0, 0.7],
        [-0.5, 0.3, 0.8, 0.0, 0.4, -0.6],
        [0.0, 0.6, 0.0, 0.9, -0.5, 0.3],
        [0.7, -0.6, 0.2, 0.4, 0.9, 0.0],
        [0.2, 0.1, -0.7, 0.6, 0.3, 0.9],
        [-0.3, 0.8, 0.6, -0.5, 0.7, 0.4],
        [0.4, -0.2, 0.3, 0.7, -0.8, 0.5],
    ]
)
_LINEAR_SCALE = np.array([1.0, 5.0, 0.2, 12.0, 1.0, 40.0, 3.0, 0.5])
_LINEAR_OFFSET = np.array([0.0, 20.0, 1.0, 100.0, -5.0, 300.0, 10.0, 2.0])


def _linear_ten(rng: np.random.Generator, n: int) -> np.ndarray:
    """Linear plant of two inputs, six modes (four real poles from .5 to .97 and a complex pair) and eight outputs."""
    rows = n + 400
    u = np.column_stack([_steps(rng, rows, -1.0, 1.0, 30, 120), _steps(rng, rows, -1.0, 1.0, 50, 200)])
    noise = np.array([0.2, 0.15, 0.08, 0.08, 0.08, 0.06]) * rng.standard_normal((rows, 6))
    drive = noise
    drive[1:] += u[:-1] @ _LINEAR_B.T
    x = np.empty((rows, 6))
    for column, pole in ((0, 0.5), (1, 0.7), (4, 0.93), (5, 0.97)):
        x[:, column] = lfilter([1.0], [1.0, -pole], drive[:, column])
    pair = lfilter([1.0], [1.0, -(0.85 + 0.25j)], drive[:, 2] + 1j * drive[:, 3])
    x[:, 2], x[:, 3] = pair.real, pair.imag
    y = x @ _LINEAR_C.T + 0.1 * rng.standard_normal((rows, 8))
    return np.column_stack([u, _LINEAR_OFFSET + _LINEAR_SCALE * y])[400:]


def _closed_tank(rng: np.random.Generator, n: int) -> np.ndarray:
    """Tank (m, l/s) whose level a PI controller holds at a stepping setpoint while a hidden demand draws from it."""
    rows = n + 1000
    setpoint = _steps(rng, rows, 0.6, 1.8, 300, 900)
    demand = 8.0 + _ar(rng, rows, 0.98, 3.0)
    level_noise = 0.006 * rng.standard_normal(rows)
    outflow = np.empty(rows)
    level = np.empty(rows)
    valve = np.empty(rows)
    h, opening, integral = float(setpoint[0]), 50.0, 50.0
    for k, (target, drawn, wobble) in enumerate(
        zip(setpoint.tolist(), demand.tolist(), level_noise.tolist(), strict=True)
    ):
        seen = h + wobble
        error = target - seen
        wanted = 90.0 * error + integral
        command = min(max(wanted, 0.0), 100.0)
        if command == wanted:
            integral += 2.0 * error
        flow = 50.0 * h**0.5
        level[k], valve[k], outflow[k] = seen, command, flow
        opening += 0.3 * (command - opening)
        h = max(h + 0.001 * (1.2 * opening - flow - drawn), 0.01)
    outflow += 0.4 * rng.standard_normal(rows)
    return np.column_stack([setpoint, valve, level, outflow])[1000:]


def _heat_exchanger(rng: np.random.Generator, n: int) -> np.ndarray:
    """Counterflow heat exchanger by effectiveness and transfer units, with lags and slowly varying fouling."""
    rows = n + 100
    hot_flow = _walk(rng, rows, 1.5, 3.0, 1500.0)
    cold_flow = _walk(rng, rows, 2.0, 4.0, 2000.0)
    hot_in = _walk(rng, rows, 70.0, 90.0, 2500.0)
    cold_in = _walk(rng, rows, 10.0, 25.0, 4000.0)
    fouling = 1.0 + _ar(rng, rows, 0.998, 0.02)
    transfer = fouling * 9.0 / (hot_flow**-0.8 + cold_flow**-0.8)
    hot_rate, cold_rate = 4.19 * hot_flow, 4.19 * cold_flow
    least, most = np.minimum(hot_rate, cold_rate), np.maximum(hot_rate, cold_rate)
    # The closed form divides nought by nought where both rates are equal, so their ratio stays just below one.
    ratio = np.minimum(least / most, 1.0 - 1e-6)
    decay = np.exp(-(transfer / least) * (1.0 - ratio))
    duty = (1.0 - decay) / (1.0 - ratio * decay) * least * (hot_in - cold_in)
    hot_out = _lag(hot_in - duty / hot_rate, np.exp(-10.0 / 40.0))
    cold_out = _lag(cold_in + duty / cold_rate, np.exp(-10.0 / 60.0))
    outputs = np.column_stack([hot_out, cold_out]) + 0.2 * rng.standard_normal((rows, 2))
    return np.column_stack([hot_flow, cold_flow, hot_in, cold_in, outputs])[100:]


def _two_rooms(rng: np.random.Generator, n: int) -> np.ndarray:
    """Two coupled rooms, each heated by an on-off thermostat with hysteresis, under a daily outdoor temperature."""
    settle = 2880
    rows = n + settle
    # The sine is lowest at 3 o'clock; the settling time is two whole days, so the first row given is midnight.
    outdoor = 4.0 + 5.0 * np.sin(2.0 * np.pi * (np.arange(rows) / 1440.0 - 0.375)) + _ar(rng, rows, 0.999, 2.0)
    gain_1 = 150.0 + _ar(rng, rows, 0.98, 120.0)
    gain_2 = 100.0 + _ar(rng, rows, 0.99, 80.0)
    noise = 0.05 * rng.standard_normal((rows, 2))
    rooms = np.empty((rows, 2))
    heaters = np.empty((rows, 2))
    t1, t2 = 21.0, 19.5
    on_1, on_2 = 1.0, 0.0
    for k, (out, g1, g2, (n1, n2)) in enumerate(
        zip(outdoor.tolist(), gain_1.tolist(), gain_2.tolist(), noise.tolist(), strict=True)
    ):
        seen_1, seen_2 = t1 + n1, t2 + n2
        on_1 = 1.0 if seen_1 < 20.6 else 0.0 if seen_1 > 21.4 else on_1
        on_2 = 1.0 if seen_2 < 19.0 else 0.0 if seen_2 > 20.0 else on_2
        rooms[k], heaters[k] = (seen_1, seen_2), (on_1, on_2)
        across = 40.0 * (t2 - t1)
        t1 += 60.0 / 3.0e6 * (2800.0 * on_1 + 60.0 * (out - t1) + across + g1)
        t2 += 60.0 / 2.2e6 * (2200.0 * on_2 + 50.0 * (out - t2) - across + g2)
    return np.column_stack([heaters, outdoor, rooms])[settle:]


def _pump(rng: np.random.Generator, n: int) -> np.ndarray:
    """Pump by affinity laws against a wandering system resistance, with a bearing that its power warms slowly."""
    rows = n + 600
    speed = 1300.0 + 220.0 * np.tanh(_ar(rng, rows, 0.995, 1.0))
    resistance = 0.006 * (1.0 + _ar(rng, rows, 0.99, 0.02))
    relative = speed / 1450.0
    # Flow (l/s) where the pump's head 40 s^2 - .004 q^2 meets the system's head 6 + resistance q^2 (m).
    flow = np.sqrt((40.0 * relative**2 - 6.0) / (0.004 + resistance))
    head = 40.0 * relative**2 - 0.004 * flow**2
    efficiency = 0.78 - 0.25 * (flow / (60.0 * relative) - 1.0) ** 2
    power = 0.00981 * flow * head / efficiency
    ambient = 22.0 + _ar(rng, rows, 0.999, 1.0)
    bearing = ambient + 1.4 * _lag(power, np.exp(-1.0 / 60.0))
    outputs = np.column_stack([head, flow, power, bearing])
    outputs += np.array([0.1, 0.25, 0.12, 0.2]) * rng.standard_normal((rows, 4))
    return np.column_stack([speed, outputs])[600:]


_COLUMN_GAIN = np.array([[4.0, -1.8, 5.9], [5.4, -5.7, 6.9], [4.4, 3.0, -7.2], [3.7, 1.6, 2.5]])
_COLUMN_ROWS = np.array([[25.0, 30.0, 25.0], [25.0, 30.0, 20.0], [15.0, 20.0, 12.0], [8.0, 18.0, 22.0]])
_COLUMN_DEAD = np.array([[6, 5, 6], [4, 3, 3], [4, 5, 2], [2, 6, 5]])


def _distillation(rng: np.random.Generator, n: int) -> np.ndarray:
    """Column-like plant: three inputs reach four outputs by first-order lags after dead times of 2 to 6 rows."""
    rows = n + 300
    u = np.column_stack([_steps(rng, rows, -0.5, 0.5, 60, 240) for _ in range(3)])
    y = np.column_stack([_ar(rng, rows, 0.9, 0.25) for _ in range(4)])
    for (out, into), gain in np.ndenumerate(_COLUMN_GAIN):
        late = np.zeros(rows)
        late[_COLUMN_DEAD[out, into] :] = u[: -_COLUMN_DEAD[out, into], into]
        y[:, out] += gain * _lag(late, float(np.exp(-1.0 / _COLUMN_ROWS[out, into])))
    y += 0.05 * rng.standard_normal((rows, 4))
    return np.column_stack([u, y])[300:]


def _motor(rng: np.random.Generator, n: int) -> np.ndarray:
    """Direct-current motor (V, A, rad/s) under a hidden load torque, sampled each millisecond."""
    rows = n + 1000
    voltage = _steps(rng, rows, 6.0, 24.0, 80, 400)
    torque = 0.08 + _ar(rng, rows, 0.995, 0.015)
    resistance, inductance, constant, inertia, friction = 1.0, 0.003, 0.05, 8.0e-5, 1.0e-4
    plant = np.zeros((4, 4))
    plant[0] = [-resistance / inductance, -constant / inductance, 1.0 / inductance, 0.0]
    plant[1] = [constant / inertia, -friction / inertia, 0.0, -1.0 / inertia]
    (a, b, c, d), (e, f, g, h) = expm(0.001 * plant)[:2].tolist()
    settled = np.linalg.solve(-plant[:2, :2], plant[:2, 2:] @ np.array([voltage[0], torque[0]]))
    i, w = settled.tolist()
    y = np.empty((rows, 2))
    for k, (volts, load) in enumerate(zip(voltage.tolist(), torque.tolist(), strict=True)):
        y[k] = i, w
        i, w = a * i + b * w + c * volts + d * load, e * i + f * w + g * volts + h * load
    y += np.array([0.05, 0.8]) * rng.standard_normal((rows, 2))
    return np.column_stack([voltage, y])[1000:]


def _redundant(rng: np.random.Generator, n: int) -> np.ndarray:
    """Level that integrates inflow less an outflow proportional to it, read by three sensors with wandering biases."""
    rows = n + 500
    inflow = _steps(rng, rows, 2.0, 6.0, 100, 400)
    hidden = _ar(rng, rows, 0.97, 0.25)
    drive = np.concatenate([[25.0 * inflow[0]], 0.5 * (inflow + hidden)[:-1]])
    level = lfilter([1.0], [1.0, -0.98], drive)
    sensors = [
        level + _ar(rng, rows, 0.95, bias) + noise * rng.standard_normal(rows)
        for bias, noise in ((0.3, 0.3), (0.45, 0.2), (0.6, 0.4))
    ]
    return np.column_stack([inflow, *sensors])[500:]


SETS: tuple[LearntSet, ...] = (
    LearntSet("blind", ("u",), ("y",), 1.0, _blind),
    LearntSet("curved load", (), tuple(f"sensor_{k}" for k in range(1, 9)), 60.0, _curved_load),
    LearntSet("linear ten", ("u_1", "u_2"), tuple(f"y_{k}" for k in range(1, 9)), 1.0, _linear_ten),
    LearntSet("closed tank", ("setpoint",), ("valve", "level", "outflow"), 1.0, _closed_tank, actuated=True),
    LearntSet(
        "heat exchanger",
        ("hot_flow", "cold_flow", "hot_in", "cold_in"),
        ("hot_out", "cold_out"),
        10.0,
        _heat_exchanger,
    ),
    LearntSet("two rooms", ("heater_1", "heater_2", "outdoor"), ("room_1", "room_2"), 60.0, _two_rooms, actuated=True),
    LearntSet("pump", ("speed",), ("head", "flow", "power", "bearing"), 10.0, _pump),
    LearntSet("distillation-like", ("u_1", "u_2", "u_3"), ("y_1", "y_2", "y_3", "y_4"), 60.0, _distillation),
    LearntSet("motor", ("voltage",), ("current", "speed"), 0.001, _motor),
    LearntSet("two redundant", ("inflow",), ("level_a", "level_b", "level_c"), 10.0, _redundant),
)


# ---------------------------------------------------------------- faults


def with_sensor_fault(
    rows: np.ndarray, column: int, kind: str, size: float, start: int, deviation: float, rng: np.random.Generator
) -> np.ndarray:
    """Copy of `rows` with a fault of one measured column from row `start` to the end.

    The fault is of the measurement alone: no other column changes. The column's mean is taken over all of `rows`.

    Args:
        rows: fault-free log; it is left as it is.
        column: index of the faulty column.
        kind: `offset` (adds `size` deviations), `stuck` (held at the mean plus `size` deviations), `frozen` (held at
            its value in row `start`), `dead` (the mean plus noise of 1 % of a deviation), `drift` (grows linearly to
            `size` deviations over 500 rows, then stays) or `gain` (the difference from the mean times `size`).
        size: size of the fault; `frozen` and `dead` make no use of it.
        start: first faulty row.
        deviation: the unit of `size`, in the column's own unit.
        rng: generator of the noise of `dead`.

    Raises
    ------
        ValueError: if `kind` is none of these, or `start` is not a row.
    """
    if not 0 <= start < len(rows):
        raise ValueError(f"start {start} is not one of {len(rows)} rows")
    faulty = np.array(rows, dtype=float)
    part = faulty[start:, column]
    mean = float(np.mean(rows[:, column]))
    if kind == "offset":
        part += size * deviation
    elif kind == "stuck":
        part[:] = mean + size * deviation
    elif kind == "frozen":
        part[:] = float(part[0])
    elif kind == "dead":
        part[:] = mean + 0.01 * deviation * rng.standard_normal(part.size)
    elif kind == "drift":
        part += size * deviation * np.minimum(np.arange(part.size) / 500.0, 1.0)
    elif kind == "gain":
        part[:] = mean + size * (part - mean)
    else:
        raise ValueError(f"unknown kind of fault: {kind!r}")
    return faulty


# ---------------------------------------------------------------- wind turbine

_YEAR = 52_560
_RATED = 2000.0
_CUT_IN = 3.5
_RATED_WIND = 12.5
_APART = 300
_STOPS = 22
_CURTAILMENTS = 7


def _wind(rng: np.random.Generator, day: np.ndarray) -> np.ndarray:
    """Wind (m/s) of a mean of 7.5 and a Weibull-like spread, over some hours alike, below 25 throughout."""
    n = day.size
    normal = _ar(rng, n, np.exp(-1.0 / 60.0), np.sqrt(0.94)) + _ar(rng, n, np.exp(-1.0 / 4.0), np.sqrt(0.06))
    weibull = 7.5 / gamma(1.5) * np.sqrt(-log_ndtr(-normal))
    season = 1.0 + 0.15 * np.cos(2.0 * np.pi * (day - 15.0) / 365.0)
    daily = 1.0 + 0.07 * np.cos(2.0 * np.pi * (day - 15.0 / 24.0))
    wind = weibull * season * daily
    return np.where(wind > 18.0, 18.0 + 7.0 * np.tanh((wind - 18.0) / 7.0), wind)


def _available(rng: np.random.Generator, wind: np.ndarray, day: np.ndarray) -> np.ndarray:
    """Power (kW) that the wind offers before any limit, with season's density, sector effect and turbulence."""
    n = wind.size
    density = 1.0 + 0.06 * np.cos(2.0 * np.pi * (day - 20.0) / 365.0)
    direction = np.cumsum(np.deg2rad(2.5) * rng.standard_normal(n)) + rng.uniform(0.0, 2.0 * np.pi)
    sector = 1.0 + 0.03 * np.sin(2.0 * direction)
    cube = np.maximum(wind**3 - _CUT_IN**3, 0.0) / (_RATED_WIND**3 - _CUT_IN**3)
    steep = np.where(wind > _CUT_IN, np.minimum((wind / 10.0) ** 2, 1.0), 0.0)
    scatter = 0.03 * _RATED * steep * rng.standard_normal(n)
    return np.maximum(_RATED * cube * density * sector + scatter, 0.0)


def _pitch_for(available: np.ndarray, limit: float) -> np.ndarray:
    """Pitch (deg) that holds the power at `limit` (kW): nought where the wind offers no more than that."""
    return 21.0 * np.maximum(np.cbrt(available / limit) - 1.0, 0.0) ** 0.6


def _starts(signal: np.ndarray, length: int, floor: float, taken: Sequence[tuple[int, int, str]]) -> np.ndarray:
    """First rows at which `signal` is above `floor` for `length` rows, far enough from every event in `taken`."""
    low = np.concatenate([[0], np.cumsum(signal <= floor)])
    free = (low[length:] - low[:-length]) == 0
    for first, end, _ in taken:
        free[max(first - _APART - length + 1, 0) : end + _APART] = False
    return np.flatnonzero(free)


def _put_events(
    rng: np.random.Generator, rows: np.ndarray, wind: np.ndarray, available: np.ndarray
) -> list[tuple[int, int, str]]:
    """Put stops and curtailments into `rows` in place and give them in order of time."""
    events: list[tuple[int, int, str]] = []
    while len(events) < _CURTAILMENTS:
        length = int(rng.integers(20, 151))
        limit = _RATED * rng.uniform(0.4, 0.7)
        starts = _starts(available, length, limit + 0.1 * _RATED, events)
        if starts.size:
            first = int(rng.choice(starts))
            span = slice(first, first + length)
            rows[span, 1] = _pitch_for(available[span], limit) + 0.15 * rng.standard_normal(length)
            rows[span, 2] = limit + 6.0 * rng.standard_normal(length)
            events.append((first, first + length, "curtailment"))
    windy = np.minimum(wind, rows[:, 0])
    while len(events) < _CURTAILMENTS + _STOPS:
        length = int(rng.integers(3, 61))
        starts = _starts(windy, length, 5.0, events)
        if starts.size:
            first = int(rng.choice(starts))
            span = slice(first, first + length)
            rows[span, 1] = 88.0 + 0.15 * rng.standard_normal(length)
            rows[span, 2] = np.clip(rng.uniform(-13.0, -7.0) + rng.standard_normal(length), -15.0, -5.0)
            events.append((first, first + length, "stop"))
    return sorted(events)


def turbine_year(
    rng: np.random.Generator, *, events: bool
) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int, str]]]:
    """Year of a 2 MW wind turbine in ten-minute means.

    Air density, wind direction and turbulence act on the power and are not among the columns. The wind stays below
    25 m/s, so the turbine never cuts out. Two calls with generators of the same seed differ only inside the events.

    Args:
        rng: generator of all that is random.
        events: whether to put in 22 stops and 7 curtailments, at least 300 rows apart; a year without them has none.

    Returns
    -------
        Rows of wind (m/s), pitch (deg) and power (kW), 52,560 of them; the rows' times in seconds from the start of
        the year; and the events as (first row, last row + 1, kind), where a kind is `stop` or `curtailment`.
    """
    times = 600.0 * np.arange(_YEAR)
    day = times / 86_400.0
    wind = _wind(rng, day)
    available = _available(rng, wind, day)
    power = np.minimum(available, _RATED)
    power += (1.5 + 4.0 * power / _RATED) * rng.standard_normal(_YEAR)
    seen = np.maximum(wind + 0.25 * rng.standard_normal(_YEAR), 0.0)
    pitch = _pitch_for(available, _RATED) + 0.15 * rng.standard_normal(_YEAR)
    rows = np.column_stack([seen, pitch, power])
    return rows, times, _put_events(rng, rows, wind, available) if events else []
