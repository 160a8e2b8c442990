"""Which design method, and why; poles and rows as text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

from residua import design
from residua.analysis import coding
from residua.design import Bank, MatchedFilters, ResidualGenerator
from residua.design.estimation.fault_estimator import fault_estimator
from residua.errors import AccuracyError, DesignError, SettingError
from residua.plant import Plant

#: Seconds for the choice of a coding set; what was found by then is taken.
CHOICE_TIME = 10.0


class Scheme(StrEnum):
    """Which sensors or actuators a member of a bank leaves to the others."""

    generalized = "generalized"
    dedicated = "dedicated"


class MemberKind(StrEnum):
    """What the members of a bank are."""

    unknown_input = "unknown-input"
    reduced_order = "reduced-order"
    perfect = "perfect"
    minimal = "minimal"


class Method(StrEnum):
    """The design methods of the command line."""

    auto = "auto"
    robust_detection_filter = "robust-detection-filter"
    detection_filter = "detection-filter"
    kalman_filter = "kalman-filter"
    unknown_input_observer = "unknown-input-observer"
    luenberger_observer = "luenberger-observer"
    sensor_bank = "sensor-bank"
    actuator_bank = "actuator-bank"
    structured_bank = "structured-bank"
    parity = "parity"
    matched_filters = "matched-filters"
    fault_estimator = "fault-estimator"


@dataclass(frozen=True)
class DesignOptions:
    """What was asked of a design.

    Attributes
    ----------
    poles : tuple of complex or None
    margin : float or None
    sample_time : float or None
    faults : tuple of str or None
        What a fault estimator estimates.
    scheme, observer : str or None
        Of a bank of observers; its own when omitted.
    allow_missing : bool
        Whether a bank leaves out members that do not exist.
    rows : tuple of str or None
        Who fires when what fails, ``"0111"``, for structured residuals; a chosen coding set when omitted.
    window : int
        Arrival times that matched filters tell apart, in samples.
    """

    poles: tuple[complex, ...] | None = None
    margin: float | None = None
    sample_time: float | None = None
    faults: tuple[str, ...] | None = None
    scheme: str | None = None
    observer: str | None = None
    allow_missing: bool = False
    rows: tuple[str, ...] | None = None
    window: int = 40

    @property
    def of_banks(self) -> dict[str, Any]:
        """What was asked of a bank, as arguments of its function."""
        given = {"scheme": self.scheme, "observer": self.observer, "allow_missing": self.allow_missing or None}
        return {name: value for name, value in given.items() if value is not None}

    def for_method(self, method: Method) -> DesignOptions:
        """Return the options without those that a method does not have."""
        kept = self if method in _BANKS else replace(self, scheme=None, observer=None)
        kept = kept if method in _BANKS + _STRUCTURED else replace(kept, allow_missing=False)
        kept = kept if method in _STRUCTURED else replace(kept, rows=None)
        kept = kept if method is Method.fault_estimator else replace(kept, faults=None)
        return replace(kept, poles=None, margin=None) if method in _OF_THE_NOISE else kept


def choose(plant: Plant) -> tuple[Method, str]:
    """Return the method that fits what is known about a plant, and why.

    Parameters
    ----------
    plant : Plant

    Returns
    -------
    tuple of Method and str
    """
    if plant.disturbances:
        names = ", ".join(plant.disturbances)
        return Method.robust_detection_filter, f"the plant has disturbances to be decoupled: {names}"
    if plant.Bw.shape[1]:
        return Method.kalman_filter, "the plant has noise and no disturbances"
    return Method.detection_filter, "the plant has neither disturbances nor noise"


def make(plant: Plant, method: Method, options: DesignOptions, *, why: str = "") -> ResidualGenerator | MatchedFilters:
    """Design by one method, or say why that is impossible and which other methods would work.

    Parameters
    ----------
    plant : Plant
    method : Method
        Not ``auto``: see :func:`choose`.
    options : DesignOptions
    why : str
        Why the method was chosen, for the message.

    Returns
    -------
    ResidualGenerator or MatchedFilters

    Raises
    ------
    DesignError
    """
    if options.faults is not None and method is not Method.fault_estimator:
        raise DesignError(f"--faults says what --method fault-estimator estimates, and does not go with {method.value}")
    if options.rows is not None and method not in _STRUCTURED:
        raise DesignError(f"--rows is for --method structured-bank and parity, not for {method.value}")
    given = [name for name in options.of_banks if name not in options.for_method(method).of_banks]
    if given:
        names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        which = "banks" if given == ["allow_missing"] else "--method sensor-bank and actuator-bank"
        raise DesignError(f"{names} is for {which}, not for {method.value}")
    if options.rows is not None:
        coding.CodingSet.of(list(options.rows), plant.faults)  # a slip in these says nothing about other methods
    try:
        return _DESIGNS[method](plant, options)
    except (DesignError, AccuracyError) as error:
        chosen = f"{method.value} (chosen because {why})" if why else method.value
        raise type(error)(f"{chosen}: {error}; {_alternatives(plant, method, options)}") from error
    except SettingError as error:  # an option is wrong: that says nothing about other methods
        raise SettingError(f"{method.value}: {error}") from error


def _alternatives(plant: Plant, failed: Method, options: DesignOptions) -> str:
    """Return which of the other methods exist for this plant."""
    possible = []
    for method, build in _DESIGNS.items():
        if method is failed:
            continue
        try:
            build(plant, options.for_method(method))
        except (DesignError, AccuracyError, SettingError):
            continue
        note = ""
        if plant.disturbances and method in _NOT_DECOUPLED:
            note = " (does not decouple the disturbances)"
        possible.append(f"--method {method.value}{note}")
    if possible:
        return f"what exists for this plant: {', '.join(possible)}"
    return "no other method exists for this plant with these options either"


def _directional(build: Callable[..., ResidualGenerator]) -> Callable[[Plant, DesignOptions], ResidualGenerator]:
    def design_it(plant: Plant, options: DesignOptions) -> ResidualGenerator:
        return build(plant, poles=options.poles, margin=options.margin)

    return design_it


def _kalman(plant: Plant, options: DesignOptions) -> ResidualGenerator:
    return design.kalman_filter(_sampled(plant, options))


def _matched(plant: Plant, options: DesignOptions) -> MatchedFilters:
    if not plant.is_discrete and options.sample_time is None:
        raise DesignError("matched filters count samples: give --sample-time, the step of the recordings")
    return design.matched_filters(_sampled(plant, options), window=options.window)


def _sampled(plant: Plant, options: DesignOptions) -> Plant:
    """Return the sampled plant: the optimal filter of that, rather than the continuous one, sampled."""
    if options.poles is not None or options.margin is not None:
        raise DesignError("the poles of a Kalman filter follow from the noise: leave out --poles and --margin")
    if options.sample_time is None or plant.is_discrete or not plant.Bw.shape[1]:
        return plant
    return plant.discretize(options.sample_time)


def _inner(build: Callable[..., Any]) -> Callable[[Plant, DesignOptions], ResidualGenerator]:
    """Return a design whose result is an observer, which has a residual generator."""

    def design_it(plant: Plant, options: DesignOptions) -> ResidualGenerator:
        return build(plant, poles=options.poles, margin=options.margin).residual_generator()

    return design_it


def _bank(build: Callable[..., Bank]) -> Callable[[Plant, DesignOptions], ResidualGenerator]:
    def design_it(plant: Plant, options: DesignOptions) -> ResidualGenerator:
        return _of_bank(build(plant, poles=options.poles, margin=options.margin, **options.of_banks))

    return design_it


def _of_bank(bank: Bank) -> ResidualGenerator:
    """Return the generator of a bank, whose evidence says which members were left out."""
    left_out = tuple(f"no member {name!r}: {reason}" for name, reason in bank.failures.items())
    made = bank.generator
    return replace(made, evidence=made.evidence.extended(notes=left_out)) if left_out else made


def _structured_bank(plant: Plant, options: DesignOptions) -> ResidualGenerator:
    if options.poles is not None:
        raise DesignError("members of a structured bank have poles of their own: give --margin instead of --poles")
    rows = _rows(plant, options)
    return _of_bank(design.structured_bank(plant, rows, margin=options.margin, allow_missing=options.allow_missing))


def _parity(plant: Plant, options: DesignOptions) -> ResidualGenerator:
    if options.margin is not None:
        raise DesignError("parity relations have no margin: give --poles, as many as their order, or neither")
    rows = _rows(plant, options)
    return _of_bank(design.structured_parity(plant, rows, poles=options.poles, allow_missing=options.allow_missing))


def _rows(plant: Plant, options: DesignOptions) -> coding.CodingSet | list[str]:
    """Return the rows that were given, or a good choice of those that are attainable."""
    return coding.choose(plant, time_limit=CHOICE_TIME) if options.rows is None else list(options.rows)


def _estimator(plant: Plant, options: DesignOptions) -> ResidualGenerator:
    found = fault_estimator(plant, faults=options.faults, poles=options.poles, margin=options.margin)
    return found.residual_generator()


#: Methods that do not decouple disturbances.
_NOT_DECOUPLED = (
    Method.kalman_filter,
    Method.matched_filters,
    Method.detection_filter,
    Method.luenberger_observer,
)

_BANKS = (Method.sensor_bank, Method.actuator_bank)
_STRUCTURED = (Method.structured_bank, Method.parity)
_OF_THE_NOISE = (Method.kalman_filter, Method.matched_filters)

_DESIGNS: dict[Method, Callable[[Plant, DesignOptions], ResidualGenerator | MatchedFilters]] = {
    Method.robust_detection_filter: _directional(design.robust_detection_filter),
    Method.detection_filter: _directional(design.detection_filter),
    Method.kalman_filter: _kalman,
    Method.unknown_input_observer: _inner(design.unknown_input_observer),
    Method.luenberger_observer: _inner(design.luenberger_observer),
    Method.sensor_bank: _bank(design.sensor_fault_bank),
    Method.actuator_bank: _bank(design.actuator_fault_bank),
    Method.structured_bank: _structured_bank,
    Method.parity: _parity,
    Method.matched_filters: _matched,
    Method.fault_estimator: _estimator,
}


def parse_poles(text: str) -> tuple[complex, ...]:
    """Return poles from text such as ``-3,-3`` or ``-1+2j, -1-2j`` (``i`` stands for ``j`` too).

    Parameters
    ----------
    text : str

    Returns
    -------
    tuple of complex

    Raises
    ------
    ValueError
        If an entry is no number.

    Examples
    --------
    >>> from residua.cli.methods import parse_poles
    >>> parse_poles("-3, -1+2i, -1-2i")
    ((-3+0j), (-1+2j), (-1-2j))
    """
    poles = []
    for entry in text.split(","):
        plain = "".join(entry.split())
        try:
            pole = complex(plain[:-1] + "j" if plain.endswith(("i", "I")) else plain)
        except ValueError:
            pole = complex("nan")
        if not (abs(pole) < float("inf")):
            raise ValueError(
                f"{entry.strip()!r} is no pole: give numbers with commas between them, such as -3,-3 or -1+2j,-1-2j"
            )
        poles.append(pole)
    return tuple(poles)


def parse_rows(text: str) -> tuple[str, ...]:
    """Return the rows of a structure from text such as ``011,101,110``.

    Parameters
    ----------
    text : str

    Returns
    -------
    tuple of str

    Raises
    ------
    ValueError
        If an entry has other characters than 0 and 1, or the lengths differ.

    Examples
    --------
    >>> from residua.cli.methods import parse_rows
    >>> parse_rows("011, 101")
    ('011', '101')
    """
    rows = tuple("".join(entry.split()) for entry in text.split(","))
    if any(not row or set(row) - set("01") for row in rows) or len({len(row) for row in rows}) > 1:
        raise ValueError(f"{text!r} are no rows: give zeros and ones, one for each fault, such as 011,101,110")
    return rows
