"""A monitor as a small program: the steps of its specification, with its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.decide.compiled import CompiledIsolation, CompiledTest
from residua.decide.directional import MEAN_WEIGHTS
from residua.errors import ModelError, SettingError
from residua.export import step_texts as texts
from residua.export.judging import OF_PARTS, Judging, judging_of
from residua.export.part_program import part_sections, part_sizes, part_variables
from residua.export.program import Kind, Program, Variable, program
from residua.monitor import Monitor
from residua.monitor.specification import Specification
from residua.visible import echo

#: Samples up to which counters count.
_MOST = 2_000_000_000
#: Tests by their statistics: the text of each, and whether it keeps a window of latest samples.
_STATISTICS = {
    "page": texts.PAGE,
    "crosier": texts.CROSIER,
    "pignatiello-runger": texts.PIGNATIELLO_RUNGER,
    "ewma": texts.EWMA,
    "means": texts.MEANS,
    "chi-squared": texts.CHI_SQUARED,
    "glr": texts.GLR,
    "directed glr": texts.DIRECTED_GLR,
}
_CUMULATED = ("page", "crosier", "pignatiello-runger")
_OF_RECENT = ("chi-squared", "glr", "directed glr")


@dataclass(frozen=True)
class Precision:
    """The numbers of a target.

    Attributes
    ----------
    name : str
        ``double`` or ``float``.
    greatest : float
        The greatest finite number.
    smallest : float
        States below it become zero at rest.
    largest, largest_whitened : float
        Largest residual, before and after whitening, without an overflow of its square.
    """

    name: str
    greatest: float
    smallest: float
    largest: float
    largest_whitened: float


DOUBLE = Precision("double", float(np.finfo(float).max), 2.0**-500, 1e150, 1e120)
FLOAT = Precision("float", float(np.finfo(np.float32).max), 2.0**-100, 1e18, 1e15)


def precision_named(name: object) -> Precision:
    """Return the numbers of a precision by its name.

    Raises
    ------
    SettingError
    """
    for one in (DOUBLE, FLOAT):
        if name == one.name:
            return one
    raise SettingError(f"precision must be 'double' or 'float', got {echo(name)}")


@dataclass(frozen=True)
class MonitorProgram:
    """A monitor that can be written for another machine.

    Attributes
    ----------
    program : Program
    precision : Precision
    name : str
        Of the plant.
    inputs, outputs : tuple of str
        The names of the signals in order.
    units : tuple of str
        Of inputs and outputs.
    groups : tuple of tuple of str
        The faults that are named, those in one group not told apart.
    dt : float
        In seconds.
    test : str
        Description of the test.
    notes : tuple of str
        Where the program differs from the monitor.
    specification : Specification
        Its specification, with the treatment of missing values.
    residuals : tuple of str
        The names of the residuals.
    parts : tuple of str
        Names of the parts tested separately.
    """

    program: Program
    precision: Precision
    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    dt: float
    test: str
    notes: tuple[str, ...]
    specification: Specification
    residuals: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()

    @property
    def judging(self) -> Judging:
        """Test and isolation."""
        return judging_of(self.specification)


def monitor_program(
    monitor: Monitor, *, precision: Precision = DOUBLE, missing: str = "as monitored"
) -> MonitorProgram:
    """Return the program of a monitor.

    Parameters
    ----------
    monitor : Monitor
        With a threshold.
    precision : Precision
    missing : {"as monitored", "hold"}
        Of a Kalman filter with missing outputs: ``"hold"`` holds the last value, as every other filter.

    Raises
    ------
    NotFittedError
        If the monitor has no threshold.
    SettingError
        If the program cannot represent the monitor; the message names the part.
    """
    if not isinstance(monitor, Monitor):
        raise ModelError(f"only a Monitor can be exported, got {type(monitor).__name__}")
    if missing not in ("as monitored", "hold"):
        raise SettingError(f"missing must be 'as monitored' or 'hold', got {missing!r}")
    spec, generator = monitor._specification(), monitor.generator
    notes = _check_filter(spec, missing)
    plant, judging = generator.plant, judging_of(spec)
    parts = judging.parts
    made = specification_program(spec, len(plant.inputs), precision)
    return MonitorProgram(
        made,
        precision,
        plant.name,
        plant.inputs,
        plant.outputs,
        tuple(plant.units.get(name, "") for name in (*plant.inputs, *plant.outputs)),
        spec.isolation.groups if judging.codes is None else tuple((label,) for label in judging.codes.labels),
        float(generator.dt),
        type(monitor.test).__name__,
        notes,
        replace(spec, partial=None),
        generator.residuals,
        () if parts is None else parts.names,
    )


def specification_program(spec: Specification, inputs: int, precision: Precision) -> Program:
    """Return a specification as a program; so many of its channels are inputs."""
    judging = judging_of(spec)
    sizes = _sizes(spec, judging, inputs)
    return program(_sections(judging), sizes, _variables(spec, judging, sizes, precision))


def _check_filter(spec: Specification, missing: str) -> tuple[str, ...]:
    """Return the differences from the monitor, or raise if the program cannot hold it."""
    if spec.partial is None:
        return ()
    if missing == "as monitored":
        raise SettingError(
            "this Kalman filter goes on through missing outputs with those that are there, by a covariance and a "
            "factorisation a sample, which no export holds: missing='hold' exports it with the last value held "
            "instead, as for any other filter; without missing values both are the same"
        )
    return ("Where an output is missing its last value is held; the monitor it was made from predicts through it.",)


def _sizes(spec: Specification, judging: Judging, inputs: int) -> dict[str, int]:
    """Return the values of the names in capitals in the texts."""
    test, naming = judging.test, judging.naming
    white = test.whitening.shape[1]
    along = 0 if test.along is None else test.along.shape[1]
    return {
        "INPUTS": inputs,
        "OUTPUTS": spec.B.shape[1] - inputs,
        "CHANNELS": spec.B.shape[1],
        "STATES": len(spec.A),
        "RESIDUALS": len(spec.C),
        "WHITE": white,
        "SETTLE": min(spec.settle, _MOST),
        "MAX_HOLD": min(spec.max_hold, _MOST),
        "FIRST": 0 if spec.first is None else spec.first.samples,
        "TEST_WINDOW": test.window,
        "NAMING_WINDOW": naming.window,
        "LONG_MEANS": 0 if naming.window else len(MEAN_WEIGHTS),
        "PERSISTENCE": test.persistence,
        "RELEASE": test.release,
        "REMEMBERS": int(test.statistic not in ("norm", OF_PARTS)),
        "SCALES": 0 if test.weights is None else len(test.weights),
        "ORDER": 0 if test.coefficients is None else len(test.coefficients),
        "KNOTS": 0 if test.scores is None else len(test.scores),
        "SUMS": test.sums - 1 if test.statistic in _CUMULATED else test.sums,
        "WIDTH": {"chi-squared": 1, "directed glr": along}.get(test.statistic, white),
        "GROUPS": len(naming.bases if judging.codes is None else judging.codes.groups),
        "COLUMNS": sum(basis.shape[1] for basis in naming.bases),
        **part_sizes(judging),
    }


def _sections(judging: Judging) -> list[tuple[str, str]]:
    """Return the texts with their titles, in order."""
    test, naming = judging.test, judging.naming
    parts = [
        ("deviations from the operating point; values that are missing or not plausible are held", texts.TAKE),
        ("the filter; it starts with the first complete sample, and restarts after a gap that is too long", texts.RUN),
        ("the start of the filter is estimated from the first residuals", texts.LEARN),
        ("whether anything can be decided", texts.CHECK),
        ("the residual in units in which it is white", texts.WHITEN),
    ]
    if judging.parts is not None:
        return [*parts, *part_sections(judging)]
    if test.statistic == "norm":
        parts.append(("the statistic", texts.NORM))
    else:
        parts += [
            ("its innovations by the autoregression", texts.FORETELL),
            ("the statistic", _STATISTICS[test.statistic]),
        ]
    if test.statistic in _CUMULATED:
        parts.append(("sums start again when an alarm is over", texts.AGAIN))
    if test.statistic in _OF_RECENT:
        parts.append(("the window goes on", texts.KEEP))
    parts.append(("the alarm", texts.ALARM))
    if naming.bases:
        parts += [
            ("the mean of the residual that is compared", texts.AVERAGE if naming.window else texts.CLEAR_MEAN),
            ("how well each group of faults explains the residual", texts.NAME),
        ]
    return parts


def _variables(spec: Specification, judging: Judging, size: dict[str, int], precision: Precision) -> list[Variable]:
    """Return all variables that the texts may have."""
    test = judging.test
    return [
        *_constants(spec, test, judging.naming, precision),
        Variable("u", "real", "input", size["INPUTS"], words="inputs, in the units of the plant"),
        Variable("y", "real", "input", size["OUTPUTS"], words="outputs, in the units of the plant"),
        *_states(test, size),
        *_decision(size),
        *_locals(size),
        *part_variables(judging, size),
    ]


def _constants(
    spec: Specification, test: CompiledTest, naming: CompiledIsolation, precision: Precision
) -> list[Variable]:
    def array(name: str, values: NDArray | Sequence[float] | None, kind: Kind = "real") -> Variable:
        flat = np.zeros(0) if values is None else np.asarray(values, dtype=float).ravel()
        limited = np.clip(flat, -precision.greatest, precision.greatest)
        return Variable(name, kind, "constant", len(flat), tuple(limited.tolist()))

    def number(name: str, value: float, kind: Kind = "real") -> Variable:
        return Variable(name, kind, "constant", None, (value,))

    first = spec.first
    columns = [g for g, basis in enumerate(naming.bases) for _ in range(basis.shape[1])]
    return [
        array("state_matrix", spec.A),
        array("input_matrix", spec.B),
        array("output_matrix", spec.C),
        array("feed_matrix", spec.D),
        array("start_matrix", spec.start),
        array("offset", spec.offset),
        array("lowest", spec.plausible[:, 0]),
        array("highest", spec.plausible[:, 1]),
        array("start_response", None if first is None else first.rows),
        array("start_correction", None if first is None else first.correction),
        array("center", test.center),
        array("whitening", test.whitening),
        array("coefficients", test.coefficients),
        array("rewhitening", test.rewhitening),
        array("knots", test.knots),
        array("scores", test.scores),
        array("along", test.along),
        array("mean_weights", test.weights),
        array("old_weights", None if test.weights is None else 1 - test.weights),
        array("scaling", test.scaling),
        array("clips", test.lengths[0] if test.lengths else None),
        array("fulls", test.lengths[1] if test.lengths else None),
        array("roots", np.sqrt(np.arange(1.0, test.window + 1))),
        array("long_weights", MEAN_WEIGHTS),
        array("long_old_weights", [1 - weight for weight in MEAN_WEIGHTS]),
        array("long_factors", [(2 - weight) / weight for weight in MEAN_WEIGHTS]),
        array("bases", np.hstack(naming.bases) if naming.bases else None),
        array("group_of_column", columns, "count"),
        array("dimension", [basis.shape[1] for basis in naming.bases], "count"),
        number("root", float(np.sqrt(float(test.window)))),
        number("threshold", test.threshold),
        number("clear", min(naming.clear, precision.greatest)),
        number("release_level", test.release_level),
        number("allowance", test.allowance),
        number("full", min(2.0 * test.threshold, precision.greatest)),
        number("old_weight", 1 - test.weight),
        number("new_weight", test.weight),
        number("deviation_of_average", test.deviation),
        number("greatest", precision.greatest),
        number("smallest", precision.smallest),
        number("largest", precision.largest),
        number("largest_whitened", precision.largest_whitened),
        number("most", _MOST, "count"),
    ]


def _states(test: CompiledTest, size: dict[str, int]) -> list[Variable]:
    white = size["WHITE"]

    def state(name: str, kind: Kind, count: int | None, words: str = "") -> Variable:
        return Variable(name, kind, "state", count, (), words)

    return [
        state("x", "real", size["STATES"], "of the filter"),
        state("held", "real", size["CHANNELS"], "last value of each channel, less the operating point"),
        state("running", "flag", None, "whether the filter has been started"),
        state("starting", "flag", None, "whether its start is still to be estimated"),
        state("age", "count", None, "samples since the start or the last missing value"),
        state("gap", "count", None, "incomplete samples in a row"),
        state("resets", "count", None, "starts after long gaps"),
        state("broken", "count", None, "starts after an overflow"),
        state("start_sums", "real", size["STATES"], "what residuals say of the start so far"),
        state("past", "real", size["ORDER"] * white, "whitened residuals, the latest last"),
        state("past_decided", "flag", size["ORDER"]),
        state("test_values", "real", test.window * white, "of the moving sum of the test"),
        state("test_begun", "real", white),
        state("test_filled", "count", None),
        state("naming_values", "real", (size["NAMING_WINDOW"] + size["LONG_MEANS"]) * white, "of the isolation"),
        state("naming_begun", "real", white),
        state("naming_filled", "count", None),
        state("raised", "flag", None, "whether the sums have been over the threshold since they began"),
        state("above", "count", None, "samples in a row over the threshold"),
        state("below", "count", None, "samples in a row that are not"),
        state("standing", "flag", None, "whether an alarm stands"),
        *([state("sums", "real", size["SUMS"], "of the test")] if size["REMEMBERS"] else []),
    ]


def _decision(size: dict[str, int]) -> list[Variable]:
    def output(name: str, kind: Kind, count: int | None, words: str) -> Variable:
        return Variable(name, kind, "output", count, (), words)

    made = [
        output("residual", "real", size["RESIDUALS"], "zeros if unknown"),
        output("statistic", "real", None, "zero where nothing is decided"),
        output("known", "flag", None, "whether there is a residual: no value is missing"),
        output("decided", "flag", None, "false while the filter settles, or if it is unknown"),
        output("alarm", "flag", None, "whether an alarm stands"),
    ]
    if size["GROUPS"]:
        made += [
            output("scored", "flag", None, "whether the scores are meaningful: only in an alarm"),
            output("score", "real", size["GROUPS"], "how well each group of faults explains the residual, 0 to 1"),
            output("best", "count", None, "the group that explains it best, from 1 on; 0 for none"),
        ]
    return made


def _locals(size: dict[str, int]) -> list[Variable]:
    white, role = size["WHITE"], "local"
    reals = ("deviation", "total", "later", "value", "size", "slope", "square", "scaled", "rounded", "part")
    flags = ("complete", "passed", "pending", "fresh", "at_rest", "sound", "seen", "over", "odd", "better")
    arrays = {
        "before": size["STATES"],
        "whitened": white,
        "news": white,
        "parts": max(white, size["WIDTH"]),
        "latest": size["WIDTH"],
        "averaged": white,
    }
    return [
        *(Variable(name, "real", role) for name in (*reals, "best_rounded")),
        *(Variable(name, "flag", role) for name in flags),
        Variable("place", "count", role),
        *(Variable(name, "real", role, count) for name, count in arrays.items()),
        *([] if size["REMEMBERS"] else [Variable("sums", "real", role, white)]),
    ]


__all__ = [
    "DOUBLE",
    "FLOAT",
    "MonitorProgram",
    "Precision",
    "monitor_program",
    "precision_named",
    "specification_program",
]
