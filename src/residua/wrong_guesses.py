"""Remedies for wrong names, such as those of other packages, at the end of the error about them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from importlib import import_module
from inspect import signature
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_RUN = "monitor.run(recording) returns a Diagnosis, with the alarms and the faults that explain them"
_FIRST = "use residua.Monitor(generator), or residua.learn(recording) without a model; then"
_NOISE = "the noise belongs to the plant: kalman_filter(plant.with_noise(process=..., measurement=...))"
_SIMULATE = (
    "use plant.system().simulate(v) for samples of all inputs, in the order of plant.system().inputs (sample a "
    "continuous plant by plant.discretize(dt) first), and residua.validate.campaign for many runs with faults"
)
_NAMED = "diagnosis.named has the faults that explain the longest alarm, diagnosis.alarms all alarms"
_LOAD = (
    "use residua.load_plant for a plant file, residua.Monitor.load for a monitor, and residua.read_recording for a "
    "recording"
)
_SCORES = f"{_RUN}, and a statistic for every sample"

#: Remedies, by ``Owner.name`` of attributes, ``owner(option)`` of options and ``owner()`` of calls.
INSTEAD = {
    "residua.load": _LOAD,
    "residua.load_monitor": "use residua.Monitor.load(path)",
    "residua.read_monitor": "use residua.Monitor.load(path)",
    "residua.load_recording": "use residua.read_recording",
    "residua.save": "use monitor.save(path), or plant.to_toml(path)",
    "residua.save_monitor": "use monitor.save(path)",
    "residua.read": _LOAD,
    "residua.read_plant": "use residua.load_plant(path)",
    "residua.run": f"{_FIRST} monitor.run(recording)",
    "residua.read_csv": "use residua.read_recording",
    "residua.Kalman": "use residua.design.kalman_filter(plant)",
    "residua.KalmanFilter": "use residua.design.kalman_filter(plant)",
    "residua.Observer": "use residua.design.luenberger_observer or residua.design.unknown_input_observer",
    "residua.fit": f"{_FIRST} monitor.fit(recording)",
    "residua.detect": f"{_FIRST} monitor.run(recording)",
    "residua.ss": "use residua.Plant(A, B, C, D, dt=...)",
    "residua.design.KalmanFilter": "use residua.design.kalman_filter(plant)",
    "residua.design.uio": "use residua.design.unknown_input_observer(plant)",
    "Monitor.predict": _RUN,
    "Monitor.detect": _RUN,
    "Monitor.transform": _RUN,
    "Monitor.score": f"{_RUN}; residua.validate.campaign measures detections and false alarms",
    "Monitor.fit_predict": f"use monitor.fit(fault_free), then {_RUN}",
    "Monitor.score_samples": _SCORES,
    "Monitor.decision_function": _SCORES,
    "Monitor.plant": "use monitor.design.plant",
    "Monitor.to_json": "use monitor.save(path)",
    "Monitor.from_json": "use residua.Monitor.load(path)",
    "Monitor.read": "use residua.Monitor.load(path)",
    "Monitor.from_file": "use residua.Monitor.load(path)",
    "Monitor(threshold)": "use Monitor(generator, test=residua.decide.NormThreshold(threshold=...))",
    "Monitor(false_alarm_rate)": "use monitor.fit(recording, false_alarm_rate=...)",
    "Plant.simulate": _SIMULATE,
    "Plant.to_discrete": "use plant.discretize(dt)",
    "Plant.c2d": "use plant.discretize(dt)",
    "Plant.sample": "use plant.discretize(dt)",
    "Plant.poles": "use plant.system().poles()",
    "Plant.save": "use plant.to_toml(path)",
    "Plant.load": "use residua.load_plant(path)",
    "Plant.read": "use residua.load_plant(path)",
    "Plant.from_file": "use residua.load_plant(path)",
    "Plant.run": f"{_FIRST} monitor.run(recording)",
    "Plant.Q": "use plant.process_noise",
    "Plant.R": "use plant.measurement_noise",
    "Plant()": "a plant takes matrices, and all else by name: Plant(A, B, C, D, dt=...); use "
    "Plant.from_state_space(system) for a system of python-control, SciPy or another package",
    "kalman_filter(Q)": _NOISE,
    "kalman_filter(R)": _NOISE,
    "kalman_filter(process)": _NOISE,
    "kalman_filter(measurement)": _NOISE,
    "kalman_filter()": _NOISE,
    "Diagnosis.faults": _NAMED,
    "Diagnosis.fault": _NAMED,
    "Diagnosis.is_faulty": "use diagnosis.fault_detected",
    "Diagnosis.save": "use diagnosis.to_json() for a text to keep, and Diagnosis.from_json(text) to read it",
    "Diagnosis.load": "use Diagnosis.from_json(text), of the text of diagnosis.to_json()",
    "Diagnosis.report": "use diagnosis.to_html(path)",
}


def instead_of(guess: str) -> str:
    """Return the end of a message with a remedy; empty without one."""
    return f"; {INSTEAD[guess]}" if guess in INSTEAD else ""


def instead_of_name(module: str, name: str, rooms: Iterable[str]) -> str:
    """Return the remedy for a name that a module lacks, possibly in one of several rooms."""
    places = [room for room in rooms if name in getattr(import_module(room), "__all__", ())]
    return instead_of(f"{module}.{name}") or "".join(f"; use {room}.{name}" for room in places[:1])


class _GuessedType(type):
    """Type of classes whose missing attributes, asked of the class itself, may be guesses."""

    if not TYPE_CHECKING:  # any attribute would be there for a type checker

        def __getattr__(cls, name: str) -> Any:
            """Raise Python's error, with a remedy."""
            instead = instead_of(f"{cls.__name__}.{name}")
            raise AttributeError(f"type object {cls.__name__!r} has no attribute {name!r}{instead}", name=name, obj=cls)


class Guessed(metaclass=_GuessedType):
    """Base of classes whose missing attributes may be guesses."""

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Raise Python's error, with a remedy."""
            try:
                return object.__getattribute__(self, name)
            except AttributeError as error:
                instead = instead_of(f"{type(self).__name__}.{name}")
                if not instead:
                    raise
                raise AttributeError(f"{error}{instead}", name=name, obj=self) from None


def guessed(owner: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Let the error about an invalid call of a function end with a remedy."""

    def declared(function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def called(*args: P.args, **options: P.kwargs) -> T:
            try:
                return function(*args, **options)
            except TypeError as error:
                instead = _instead_of_call(function, args, options, owner)
                if not instead:
                    raise
                raise TypeError(f"{error}{instead}") from None

        return called

    return declared


def _instead_of_call(function: Callable[..., Any], args: Any, options: Any, owner: str) -> str:
    """Return a remedy for a call; empty if it fits the function."""
    try:
        signature(function).bind(*args, **options)
    except TypeError:
        known = [instead_of(f"{owner}({name})") for name in options]
        return next(filter(None, [*known, instead_of(f"{owner}()")]), "")
    return ""
