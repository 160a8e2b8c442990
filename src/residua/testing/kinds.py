"""Checks that every test and every isolation must pass, for your own."""

from __future__ import annotations

import json
import tempfile
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide import Directional, IsolationSettings, NormThreshold, Statement, TestSettings
from residua.design import ResidualGenerator, kalman_filter
from residua.errors import AccuracyError, ResiduaError
from residua.monitor import Monitor
from residua.monitor.running import Decisions
from residua.plant import Plant
from residua.recording.clock import Clock
from residua.visible import echo

#: Samples that are fitted to, and that are run over; and those of it from which on a fault is there.
_FITTED, _RUN, _FAULTY = 4000, 400, 200
#: Size of the fault, in deviations of the sensor.
_SIZE = 8.0
#: Times the rate that was asked for, plus a per cent, which alarms on new data may reach.
_TOLERATED = 3.0


def check_test(settings: TestSettings, *, generator: ResidualGenerator | None = None, seed: int = 0) -> None:
    """Check the requirements of a monitor on a test, or raise with the first violation.

    Checked, on a Kalman filter of a small plant with simulated data unless you bring a generator: it is fitted to
    fault-free data; alarms on other fault-free data are at most three times as frequent as was asked for; a large fault
    raises one; arrays have the shapes that they must have, and nothing is decided where nothing can be; the same bits
    come out however time is cut into blocks, and for any number of plants at once; nothing that it was given is
    changed; and a saved monitor goes on with the same bits.

    Parameters
    ----------
    settings : TestSettings
        Registered (:func:`residua.decide.register`).
    generator : ResidualGenerator, optional
        Sampled, with noise and a fault.
    seed : int

    Raises
    ------
    AccuracyError
        Names the first violation.

    Examples
    --------
    >>> from residua.decide import NormThreshold
    >>> from residua.testing import check_test
    >>> check_test(NormThreshold(persistence=2, false_alarm_rate=1e-3))
    """
    if not isinstance(settings, TestSettings):
        raise AccuracyError(
            f"settings must be a subclass of residua.decide.TestSettings, got {type(settings).__name__}"
        )
    _check_frozen(settings)
    generator = _generator() if generator is None else generator
    monitor = _made(lambda: Monitor(generator, test=settings, isolate=Directional(window=5)))
    rng = np.random.default_rng(seed)
    _made(lambda: monitor.fit(*_recording(generator, rng, _FITTED), force=True))
    _check_frozen(monitor.norm_test)
    quiet = monitor.run(*_recording(generator, rng, _FITTED))
    rate = monitor.false_alarm_rate
    if quiet.false_alarm_fraction > _TOLERATED * rate + 0.01:  # pyright: ignore[reportAttributeAccessIssue]
        raise AccuracyError(
            f"{quiet.false_alarm_fraction:.2g} of other fault-free samples are in alarm, "  # pyright: ignore
            f"{rate:g} was requested"
        )
    _check_running(monitor, generator, rng)


def check_isolation(
    settings: IsolationSettings,
    *,
    generator: ResidualGenerator | None = None,
    test: TestSettings | None = None,
    seed: int = 0,
) -> None:
    """Check the requirements of a monitor on an isolation, or raise with the first violation.

    As :func:`check_test`; besides, there is one column of scores for each group, no score is over 1, each fault is in a
    group or never named, and an alarm has candidates that are groups.

    Parameters
    ----------
    settings : IsolationSettings
        Registered (:func:`residua.decide.register`).
    generator : ResidualGenerator, optional
        Sampled, with noise and a fault.
    test : TestSettings, optional
        That the isolation goes with; :class:`residua.decide.NormThreshold` when omitted.
    seed : int

    Raises
    ------
    AccuracyError
        Names the first violation.

    Examples
    --------
    >>> from residua.decide import Directional
    >>> from residua.testing import check_isolation
    >>> check_isolation(Directional(window=10))
    """
    if not isinstance(settings, IsolationSettings):
        kind = type(settings).__name__
        raise AccuracyError(f"settings must be a subclass of residua.decide.IsolationSettings, got {kind}")
    _check_frozen(settings)
    generator = _generator() if generator is None else generator
    monitor = _made(lambda: Monitor(generator, test=test or NormThreshold(), isolate=settings))
    rng = np.random.default_rng(seed)
    _made(lambda: monitor.fit(*_recording(generator, rng, _FITTED)))
    isolation = monitor._specification().isolation
    _check_frozen(isolation)
    named = [name for group in isolation.groups for name in group] + list(isolation.unjudged)
    if set(named) != set(generator.faults):
        raise AccuracyError(f"groups and unjudged must be the faults, {', '.join(generator.faults)}; they are {named}")
    found = _check_running(monitor, generator, rng)
    if found.scores.shape[-1] != len(isolation.groups):
        raise AccuracyError(f"scores have {found.scores.shape[-1]} columns, there are {len(isolation.groups)} groups")
    if np.nanmax(found.scores, initial=0.0) > 1 + 1e-9:
        raise AccuracyError(f"a score is {np.nanmax(found.scores):.3g}: the best is 1")
    for alarm in monitor.run(*_recording(generator, rng, _RUN, faulty=True)).alarms:  # pyright: ignore
        if any(candidate.faults not in isolation.groups for candidate in alarm.candidates):
            raise AccuracyError(f"a candidate of {alarm.candidates} is not a group")
        _check_statement(isolation.statement(alarm, Clock(step=generator.dt), isolation.samples))


def _check_statement(statement: object) -> None:
    """Raise if the statement about an alarm cannot be shown."""
    if not isinstance(statement, Statement):
        raise AccuracyError(f"statement must return a residua.decide.Statement, got {type(statement).__name__}")
    if not isinstance(statement.headline, str) or not statement.headline:
        raise AccuracyError(f"the headline of a statement must be a sentence, got {echo(statement.headline)}")
    for name in ("sentences", "lines"):
        texts = getattr(statement, name)
        if not isinstance(texts, tuple) or not all(isinstance(text, str) for text in texts):
            raise AccuracyError(f"the {name} of a statement must be a tuple of texts, got {echo(texts)}")


def _generator() -> ResidualGenerator:
    """Return the innovations of a small plant with noise, and faults of its sensors."""
    plant = Plant([[0.8, 0.1], [0.0, 0.6]], [[0.2], [0.4]], np.eye(2), dt=1.0, inputs=["u"], outputs=["y1", "y2"])
    return kalman_filter(plant.with_sensor_faults().with_noise(process=1e-3, measurement=1e-2))


def _recording(
    generator: ResidualGenerator, rng: np.random.Generator, samples: int, *, faulty: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return simulated inputs and outputs, with the first fault from the middle on if requested."""
    plant = generator.plant
    u = rng.standard_normal((samples, len(plant.inputs)))
    f = np.zeros((samples, len(plant.faults)))
    if faulty and len(plant.faults):
        f[_FAULTY:, 0] = _SIZE * np.sqrt(np.max(np.diag(plant.measurement_noise), initial=0.0))
    Q, R = plant.process_noise, plant.measurement_noise
    w = rng.multivariate_normal(np.zeros(len(Q)), Q, samples)
    v = rng.multivariate_normal(np.zeros(len(R)), R, samples)
    x, y = np.zeros(plant.n_states), np.empty((samples, plant.n_outputs))
    for k in range(samples):
        y[k] = plant.C @ x + plant.D @ u[k] + plant.Df @ f[k] + v[k]
        x = plant.A @ x + plant.B @ u[k] + plant.Bf @ f[k] + w[k]
    return u, y


def _made(make: Any) -> Any:
    """Return the result of a call, or raise if it fails."""
    try:
        return make()
    except ResiduaError as error:
        raise AccuracyError(f"a monitor cannot be made with it: {error}") from error


def _check_frozen(value: object) -> None:
    if not is_dataclass(value) or not type(value).__dataclass_params__.frozen:  # pyright: ignore
        raise AccuracyError(f"{type(value).__name__} must be a frozen dataclass: @dataclass(frozen=True)")


def _check_running(monitor: Monitor, generator: ResidualGenerator, rng: np.random.Generator) -> Decisions:
    """Check shapes, equality to the last bit and files on a recording with gaps and a fault; return the decisions."""
    u, y = _recording(generator, rng, _RUN, faulty=True)
    y[50:53] = np.nan
    monitor.reset()
    kept = y.copy()
    whole = monitor.update(u, y)
    if not np.array_equal(kept, y, equal_nan=True):
        raise AccuracyError("the data that it was given are changed")
    _check_shapes(whole, _RUN)
    if generator.faults and not whole.alarm[0, _FAULTY:].any():
        raise AccuracyError(f"a fault of {_SIZE:g} deviations raises no alarm in {_RUN - _FAULTY} samples")
    monitor.reset()
    parts = [monitor.update(u[a:b], y[a:b]) for a, b in ((0, 1), (1, 51), (51, 51), (51, 52), (52, 300), (300, _RUN))]
    _check_same(whole, [part for part in parts if part.alarm.shape[1]], "running in pieces")
    monitor.reset()
    two = monitor.update(np.stack([u[::-1], u]), np.stack([y[::-1], y]))
    _check_same(whole, [two], "another plant beside it", plant=1)
    monitor.reset()
    first = monitor.update(u[:220], y[:220])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "monitor.json"
        _made(lambda: monitor.save(path))
        if not json.loads(path.read_text())["test"]["kind"]:
            raise AccuracyError("settings must have a kind, the text that files know them by")
        loaded = _made(lambda: Monitor.load(path))
    _check_same(whole, [first, loaded.update(u[220:], y[220:])], "saving and loading")
    return whole


def _check_shapes(found: Decisions, samples: int) -> None:
    """Check the results of a test on each sample."""
    tested = found.tested
    for name, kind in (("usable", "b"), ("statistic", "f"), ("exceeded", "b"), ("alarm", "b"), ("up", "iu")):
        value = getattr(tested, name)
        if value.shape != (1, samples) or value.dtype.kind not in kind:
            raise AccuracyError(f"{name} must be of shape (plants, time) and kind {kind!r}, got {value.shape}")
    if np.isfinite(tested.statistic[~tested.usable]).any():
        raise AccuracyError("the statistic must be NaN where nothing is decided")
    if not np.isfinite(tested.statistic[tested.usable]).all():
        raise AccuracyError("the statistic must be a number where something is decided")
    if (tested.exceeded & ~tested.usable).any():
        raise AccuracyError("nothing can be over the threshold where nothing is decided")


def _check_same(whole: Decisions, parts: list[Decisions], occasion: str, plant: int = 0) -> None:
    """Check that parts give the same result as the whole, to the last bit."""
    for place, name in ((whole.tested, "tested"), (whole.named, "named")):
        for one in fields(place):
            value = getattr(place, one.name)
            if isinstance(value, np.ndarray):
                joined = np.concatenate([getattr(getattr(part, name), one.name)[plant] for part in parts])
                if not np.array_equal(joined, value[0], equal_nan=value.dtype.kind == "f"):
                    raise AccuracyError(f"{occasion} does not give the same {one.name} to the last bit")
