"""Designs in the plant's own unit of time: the same numbers, to the last bit, whatever unit its rates are written in.

Orders of derivatives, poles by default, weights of a Riccati equation and every sum of matrices of which one has a rate
in it and another has none depend on the unit of time that numbers are in. Continuous plants are therefore designed for
in one in which their rates are near one, a power of two that is chosen from the plant itself, and what is made is
written in the unit of the caller again: nothing is rounded on the way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, ValuesView
from dataclasses import fields, is_dataclass, replace
from functools import wraps
from inspect import signature
from typing import Any, TypeVar, cast

import numpy as np

from residua.design.core.evidence import Evidence, measured_from
from residua.linear import StateSpace
from residua.linear.systems.units import powers_of_two
from residua.plant import InputOutputModel, Plant
from residua.plant.comparable_units import unit_of_rates_of, with_rates_times
from residua.words import rates_in

F = TypeVar("F", bound=Callable[..., Any])
C = TypeVar("C", bound=type)
T = TypeVar("T")

#: Options of designs by the power of a rate in them.
_OPTIONS = {"poles": 1.0, "margin": 1.0, "bandwidth": 1.0, "correlation_time": -1.0}
#: Numbers of the evidence, by how their names begin.
_CONDITIONS = {"size of K": 1.0, "norm of the gain": 1.0, "bandwidth": 1.0, "lag of": -1.0, "noise of": 0.5}
_CONDITIONS |= dict.fromkeys(measured_from(np.ones(1), 0.0), 1.0)
#: Fields of results by the power of a rate in them, or how a result of that class is written in another unit of time.
_FIELDS: dict[type, Mapping[str, float]] = {}
_WRITTEN: dict[type, Callable[[Any, float], Any]] = {}


def has_rates(**powers: float) -> Callable[[C], C]:
    """Declare which fields of a result have a rate in them, and to which power.

    Of the others those with a declaration of their own are written by that; numbers stay as they are.
    """

    def declared(of: C) -> C:
        _FIELDS[of] = powers
        return of

    return declared


def written_by(write: Callable[[Any, float], Any]) -> Callable[[C], C]:
    """Declare how a result is written with rates that are some power of two as large: ``write(result, factor)``."""

    def declared(of: C) -> C:
        _WRITTEN[of] = write
        return of

    return declared


def in_own_time(**powers: float) -> Callable[[F], F]:
    """Have a function of a plant, or a method of what has one, work in the plant's own unit of time.

    Parameters
    ----------
    **powers : float
        The power of a rate in its options, besides those that go by their names everywhere.
    """

    def declared(function: F) -> F:
        of_options = {**_OPTIONS, **powers}
        called = signature(function)
        first = next(iter(called.parameters))

        @wraps(function)
        def timed(*args: Any, **options: Any) -> Any:
            try:
                asked = dict(called.bind(*args, **options).arguments)
            except TypeError:
                return function(*args, **options)  # which says what is wrong
            source = asked.pop(first)
            plant = source if isinstance(source, Plant) else getattr(source, "plant", None)
            if not isinstance(plant, Plant) or plant.is_discrete:
                return function(*args, **options)
            unit = unit_of_rates_of(plant) or _unit_of(asked)
            if unit == 1.0:
                return function(*args, **options)
            change = _Change(1.0 / unit)
            asked = {name: change.option(value, of_options.get(name, 0.0)) for name, value in asked.items()}
            with rates_in(unit):
                made = function(change.written(source), **asked)
            return _Change(unit, change.known).written(made)

        return cast(F, timed)

    return declared


def _unit_of(options: Mapping[str, Any]) -> float:
    """Return the unit of the rates that are asked for, where the plant has none."""
    for name in ("poles", "margin", "bandwidth"):
        asked = options.get(name)
        numbers = [_numbers(one) for one in (asked.values() if isinstance(asked, Mapping) else [asked])]
        sizes = np.abs(np.concatenate([np.ravel(one) for one in numbers if one is not None] or [np.zeros(0)]))
        sizes = sizes[np.isfinite(sizes) & (sizes > 0)]
        if sizes.size:
            return float(powers_of_two(np.log2(np.exp(np.mean(np.log(sizes), keepdims=True))))[0])
    return 1.0


def written_in_own_time(made: T) -> tuple[T, float]:
    """Return what is made for a plant in the plant's own unit of time, and that unit; itself where it has no other."""
    plant = cast(Any, made).plant
    unit = 1.0 if plant.is_discrete else unit_of_rates_of(plant) or 1.0
    return (made if unit == 1.0 else _Change(1.0 / unit).written(made)), unit


class _Change:
    """Writes with rates that are ``factor`` as large; what was written once, and its original, are themselves."""

    def __init__(self, factor: float, known: Mapping[int, tuple[Any, Any]] | None = None) -> None:
        self.factor = factor
        self.known: dict[int, tuple[Any, Any]] = {}
        for before, after in (known or {}).values():
            self.known[id(after)] = after, before

    def written(self, value: Any) -> Any:
        """Return a plant, a design, or a container of such, with its rates in the other unit."""
        if value is None or isinstance(value, (str, bytes, int, float, complex, np.ndarray)):
            return value
        if id(value) not in self.known:
            self.known[id(value)] = value, self._new(value)
        return self.known[id(value)][1]

    def _new(self, value: Any) -> Any:
        if isinstance(value, Plant):
            return with_rates_times(value, self.factor)
        if isinstance(value, StateSpace):
            return system_with(value, self.factor)
        if isinstance(value, Evidence):
            return _evidence_with(value, self.factor)
        if isinstance(value, InputOutputModel):
            return value if value.is_discrete else self.written(value.to_plant())
        # a class of a user's own is written as what it is made of
        kind = next((one for one in type(value).__mro__ if one in _FIELDS or one in _WRITTEN), type(value))
        if kind in _WRITTEN:
            value = _WRITTEN[kind](value, self.factor)
        if kind in _FIELDS or kind in _WRITTEN:
            return self._fields_of(value, _FIELDS.get(kind, {}))
        if kind in (tuple, list):
            return kind(self.written(one) for one in value)
        if kind is dict:
            return {name: self.written(one) for name, one in value.items()}
        if isinstance(value, (Iterator, ValuesView, deque)):
            return [self.written(one) for one in value]
        return value

    def _fields_of(self, value: Any, powers: Mapping[str, float]) -> Any:
        assert is_dataclass(value)
        changes = {}
        for one in fields(value):
            now = getattr(value, one.name)
            then = self.option(now, powers[one.name]) if one.name in powers else self.written(now)
            if then is not now:
                changes[one.name] = then
        return replace(value, **changes) if changes else value  # pyright: ignore[reportArgumentType]

    def option(self, value: Any, power: float) -> Any:
        """Return numbers with a power of a rate in them, in whatever containers; what are none stays as it is."""
        if value is None or isinstance(value, bool):
            return value
        if not power:
            return self.written(value)
        if isinstance(value, Mapping):
            return {name: self.option(one, power) for name, one in value.items()}
        numbers = _numbers(value)
        if numbers is not None:
            return numbers * self.factor**power
        if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
            return [self.option(one, power) for one in value]
        return value


def _numbers(value: Any) -> Any:
    """Return numbers, or whatever a design would read as such: words, fractions, columns of a table; else nothing."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "iufc":
        return value
    if value is None or isinstance(value, (Mapping, bool)):
        return None
    try:
        numbers = np.asarray(value, dtype=complex)
    except (TypeError, ValueError, OverflowError):
        return None
    numbers = numbers if np.any(np.imag(numbers)) or np.iscomplexobj(value) else np.real(numbers)
    return numbers if numbers.ndim else numbers.item()


def system_with(system: StateSpace, factor: float) -> StateSpace:
    """Return a continuous system with its rates in another unit."""
    return system if system.is_discrete else system.replaced(A=factor * system.A, B=factor * system.B)


def _evidence_with(evidence: Evidence, factor: float) -> Evidence:
    conditions = {}
    for name, value in evidence.conditions.items():
        power = next((power for begin, power in _CONDITIONS.items() if name.startswith(begin)), 0.0)
        conditions[name] = value * factor**power
    return replace(
        evidence,
        poles=factor * evidence.poles,
        requested_poles=factor * evidence.requested_poles,
        fixed_poles=factor * evidence.fixed_poles,
        conditions=conditions,
    )
