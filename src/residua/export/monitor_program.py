"""A monitor as a small program: the steps of its specification, with its numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.compiled import CompiledIsolation, CompiledTest
from residua.decide.directional import MEAN_WEIGHTS
from residua.decide.member_thresholds import BankTest, GroupTest
from residua.decide.multiscale_ewma import MultiscaleEWMATest
from residua.decide.peak_threshold import PeakTest
from residua.decide.structured import CodeTest
from residua.errors import ModelError, SettingError
from residua.export.program import Kind, Program, Role, Variable, program
from residua.export.steps import TEXT
from residua.monitor import Monitor
from residua.monitor.specification import Specification
from residua.visible import echo

#: Samples up to which counters count.
_MOST = 2_000_000_000
_CUMULATED = ("page", "crosier", "pignatiello-runger")


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


@dataclass(frozen=True, eq=False)
class Judging:
    """Test and isolation of a monitor.

    Attributes
    ----------
    test : CompiledTest
    naming : CompiledIsolation
        By direction; without bases for none, and for codes.
    parts : tuple of str
        Names of the parts of the residual that are tested by themselves: the members of a bank, or groups.
    sizes : ndarray of int
        Whitened residuals of each part; of all of them where none is tested by itself.
    thresholds : ndarray
        Of each part.
    whole : ndarray, shape (residuals, k), or None
        Units in which the direction of the whole is judged, where these are not those of the test.
    codes : CodeTest or None
        By which the members that fired are read.
    """

    test: CompiledTest
    naming: CompiledIsolation
    parts: tuple[str, ...]
    sizes: NDArray[np.int64]
    thresholds: NDArray[np.float64]
    whole: NDArray[np.float64] | None = None
    codes: CodeTest | None = None

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Whitening matrix in units of the thresholds."""
        return self.test.whitening / np.repeat(self.thresholds, self.sizes)


def judging_of(spec: Specification) -> Judging:
    """Return test and isolation in the form of exports.

    Raises
    ------
    SettingError
        If one of them cannot be, or a threshold is infinite.
    """
    one, naming = spec.test, spec.isolation.compiled
    codes = spec.isolation if isinstance(spec.isolation, CodeTest) else None
    test, parts, sizes, thresholds, whole = one.compiled, (), None, None, None
    if isinstance(one, (PeakTest, BankTest)):
        limit = 1.0 if isinstance(one, BankTest) else one.threshold
        test = CompiledTest("norm", one.center, one.whitening, limit, one.window, one.persistence, one.release)
    if isinstance(one, BankTest) or (isinstance(one, MultiscaleEWMATest) and one.names):
        parts, sizes, thresholds = one.part_names, one.sizes, one.thresholds
        whole = one.whole if isinstance(one, GroupTest) else None
    if test is None or one.responses is not None or one.reads_signals:
        raise SettingError(
            f"the test of this monitor ({type(one).__name__}) cannot be exported: MultiscaleEWMA, NormThreshold, "
            "PeakThreshold, CUSUM, EWMA, ChiSquared and GLR can"
        )
    if codes is not None and parts and codes.groups:
        naming = CompiledIsolation()
    elif not isinstance(naming, CompiledIsolation):
        raise SettingError(
            f"the isolation of this monitor ({type(spec.isolation).__name__}) cannot be exported: Directional can, "
            "Structured for a bank with codes, or isolate=None, which only raises the alarm"
        )
    elif parts and whole is None and naming.bases:
        raise SettingError("a direction cannot be exported for members of a bank: Structured, or isolate=None, can")
    sizes = np.array([test.whitening.shape[1]]) if sizes is None else sizes
    thresholds = np.array([test.threshold]) if thresholds is None else thresholds
    if not np.isfinite(thresholds).all():
        raise SettingError("a threshold of this monitor is infinite: it never raises an alarm")
    return Judging(test, naming, parts, sizes, thresholds, whole, codes)


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
        judging.parts,
    )


def specification_program(spec: Specification, inputs: int, precision: Precision) -> Program:
    """Return a specification as a program; so many of its channels are inputs."""
    judging = judging_of(spec)
    sizes = _sizes(spec, judging)
    variables = [*_constants(spec, judging, precision), *_moving(judging, sizes, inputs)]
    return program(TEXT, _calls(judging), sizes, variables)


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


def _sizes(spec: Specification, judging: Judging) -> dict[str, int]:
    """Return the values of the names in capitals in the texts."""
    test, naming, codes = judging.test, judging.naming, judging.codes
    return {
        "CHANNELS": spec.B.shape[1],
        "STATES": len(spec.A),
        "RESIDUALS": len(spec.C),
        "WHITE": test.whitening.shape[1],
        "SETTLE": min(spec.settle, _MOST),
        "MAX_HOLD": min(spec.max_hold, _MOST),
        "FIRST": 0 if spec.first is None else spec.first.samples,
        "PARTS": len(judging.sizes),
        "APART": int(bool(judging.parts)),
        "TEST_WINDOW": test.window,
        "PERSISTENCE": test.persistence,
        "RELEASE": test.release,
        "REMEMBERS": int(test.statistic != "norm"),
        "KEEPS_LENGTH": int(test.statistic == "pignatiello-runger"),
        "SCALES": 0 if test.weights is None else len(test.weights),
        "ORDER": 0 if test.coefficients is None else len(test.coefficients),
        "KNOTS": 0 if test.scores is None else len(test.scores),
        "ALONG": 0 if test.along is None else test.along.shape[1],
        "NAMING_WINDOW": naming.window,
        "LONG_MEANS": 0 if naming.window else len(MEAN_WEIGHTS),
        "OVERALL": test.whitening.shape[1] if judging.whole is None else judging.whole.shape[1],
        "GROUPS": len(naming.bases if codes is None else codes.groups),
        "CODE_WINDOW": 1 if codes is None else codes.window,
        "AT_ONCE": int(codes is not None and codes.at_once and codes.dedicated),
        "DEDICATED": int(codes is not None and codes.dedicated),
        "STRONG": int(codes is not None and codes.strongly_isolating),
        "DISTANCE": 0 if codes is None else codes.distance,
    }


def _calls(judging: Judging) -> list[tuple[str, str]]:
    """Return the calls of the program with their titles, in order."""
    statistic, naming = judging.test.statistic, judging.naming
    calls = [
        ("deviations from the operating point; values that are missing or not plausible are held", "take()"),
        ("the filter; it starts with the first complete sample, and restarts after a gap that is too long", "run()"),
        ("the start of the filter is estimated from the first residuals", "learn()"),
        ("whether anything can be decided", "check()"),
        ("the residual in units in which it is white", "whiten()"),
    ]
    if statistic != "norm":
        calls.append(("its innovations by the autoregression", "innovate()"))
    calls.append(("the statistic", f"{statistic.replace(' ', '_').replace('-', '_')}()"))
    if statistic in _CUMULATED:
        calls.append(("sums start again when an alarm is over", "again()"))
    calls.append(("the alarm", f"{'of_parts' if statistic in ('norm', 'means') else 'of_all'}()\njudge()"))
    if naming.bases:
        row, size = ("whitened", "WHITE") if judging.whole is None else ("overall", "OVERALL")
        if judging.whole is not None:
            calls.append(("all residuals in units in which their direction is judged", "view_all()"))
        mean = f"{'average' if naming.window else 'clear_mean'}({row}, {size})"
        calls.append(("the mean of the residual that is compared", mean))
        calls.append(("how well each group of faults explains the residual", "name()"))
    if judging.codes is not None:
        calls += [("which members count as fired", "count_fired()"), ("the reading of the code", "read()")]
    return calls


def _constants(spec: Specification, judging: Judging, precision: Precision) -> list[Variable]:
    """Return the constants that the texts may have."""
    test, naming, first, codes = judging.test, judging.naming, spec.first, judging.codes
    parts = np.repeat(np.arange(len(judging.sizes)), judging.sizes)
    columns = [g for g, basis in enumerate(naming.bases) for _ in range(basis.shape[1])]
    releases = [test.release_level]
    if judging.parts and test.lengths:
        releases = test.lengths[2]
    arrays = {
        "state_matrix": spec.A,
        "input_matrix": spec.B,
        "output_matrix": spec.C,
        "feed_matrix": spec.D,
        "start_matrix": spec.start,
        "offset": spec.offset,
        "lowest": spec.plausible[:, 0],
        "highest": spec.plausible[:, 1],
        "start_response": None if first is None else first.rows.reshape(-1, len(spec.C), len(spec.A)),
        "start_correction": None if first is None else first.correction,
        "center": test.center,
        "whitening": test.whitening,
        "whole": judging.whole,
        "part_threshold": judging.thresholds,
        "part_release": releases,
        "coefficients": test.coefficients,
        "rewhitening": test.rewhitening,
        "knots": test.knots,
        "inner_knots": None if test.knots is None else test.knots[:, 1:-1],
        "scores": test.scores,
        "along": test.along,
        "mean_weights": test.weights,
        "old_weights": None if test.weights is None else 1 - test.weights,
        "scaling": None if test.scaling is None else np.where(parts[:, None] == parts, test.scaling, 0.0),
        "clips": test.lengths[0] if test.lengths else None,
        "fulls": test.lengths[1] if test.lengths else None,
        "roots": np.sqrt(np.arange(1.0, test.window + 1)),
        "long_weights": MEAN_WEIGHTS,
        "long_old_weights": [1 - weight for weight in MEAN_WEIGHTS],
        "long_factors": [(2 - weight) / weight for weight in MEAN_WEIGHTS],
        "bases": np.hstack(naming.bases) if naming.bases else None,
    }
    numbers = {
        "root": float(np.sqrt(float(test.window))),
        "threshold": test.threshold,
        "clear": naming.clear,
        "release_level": test.release_level,
        "allowance": test.allowance,
        "full": 2.0 * test.threshold,
        "old_weight": 1 - test.weight,
        "new_weight": test.weight,
        "deviation_of_average": test.deviation,
        "greatest": precision.greatest,
        "smallest": precision.smallest,
        "largest_residual": precision.largest,
        "largest_whitened": precision.largest_whitened,
    }
    counts = {
        "most": _MOST,
        "part_of_column": parts,
        "group_of_column": columns,
        "dimension": [basis.shape[1] for basis in naming.bases],
    }
    if codes is not None:
        classes = {group: k + 1 for k, group in enumerate(dict.fromkeys(codes.groups))}
        arrays |= {"code_table": codes.codes, "code_sizes": codes.codes.sum(axis=0)}
        numbers |= {"share": codes.share, "number_of_parts": len(codes.members)}
        counts |= {
            "part_owned": codes.codes.any(axis=1),
            "class_of_group": [classes[group] for group in codes.groups],
            "contained": [[set(other) <= set(one) for other in codes.groups] for one in codes.groups],
        }

    def constant(name: str, values: ArrayLike, kind: Kind) -> Variable:
        limited = np.clip(np.asarray(values, dtype=float), -precision.greatest, precision.greatest)
        return Variable(name, kind, "constant", limited.shape, tuple(limited.ravel().tolist()))

    return [
        *(constant(name, one, "real") for name, one in (arrays | numbers).items() if one is not None),
        *(constant(name, one, "count") for name, one in counts.items()),
    ]


def _moving(judging: Judging, size: dict[str, int], inputs: int) -> list[Variable]:
    """Return inputs, outputs, and the states that the texts may have."""
    test, white, parts = judging.test, size["WHITE"], size["PARTS"]
    states, channels, groups = size["STATES"], size["CHANNELS"], size["GROUPS"]
    named = (size["NAMING_WINDOW"] or size["LONG_MEANS"], size["OVERALL"])
    sums = {"page": (2 * white,), "means": (size["SCALES"] - 1, white)}.get(test.statistic, (white,))
    recent = {"glr": (white,), "directed glr": (size["ALONG"],)}.get(test.statistic, ())

    def rows(role: Role, *rows: tuple[str, Kind, tuple[int, ...], str]) -> list[Variable]:
        return [Variable(name, kind, role, shape, (), words) for name, kind, shape, words in rows]

    made = [
        *rows(
            "input",
            ("u", "real", (inputs,), "inputs, in the units of the plant"),
            ("y", "real", (channels - inputs,), "outputs, in the units of the plant"),
        ),
        *rows(
            "state",
            ("x", "real", (states,), "of the filter"),
            ("held", "real", (channels,), "last value of each channel, less the operating point"),
            ("running", "flag", (), "whether the filter has been started"),
            ("starting", "flag", (), "whether its start is still to be estimated"),
            ("age", "count", (), "samples since the start or the last missing value"),
            ("gap", "count", (), "incomplete samples in a row"),
            ("resets", "count", (), "starts after long gaps"),
            ("broken", "count", (), "starts after an overflow"),
            ("start_sums", "real", (states,), "what residuals say of the start so far"),
            ("past", "real", (size["ORDER"], white), "whitened residuals, the latest first"),
            ("past_decided", "flag", (size["ORDER"],), ""),
            ("test_values", "real", (test.window, white), "of the moving sum of the test"),
            ("test_begun", "real", (white,), ""),
            ("test_filled", "count", (), ""),
            ("recent", "real", (test.window, *recent), "of the test, the latest first"),
            ("length", "real", (), "samples in the sums"),
            (
                "naming_values",
                "real",
                named,
                "of the isolation",
            ),
            ("naming_begun", "real", (size["OVERALL"],), ""),
            ("naming_filled", "count", (), ""),
            ("raised", "flag", (), "whether the sums have been over the threshold since they began"),
            ("above", "count", (parts,), "samples in a row over the threshold of a part"),
            ("below", "count", (parts,), "samples in a row that are not"),
            ("standing", "flag", (parts,), "whether an alarm of a part stands"),
            ("code_values", "real", (size["CODE_WINDOW"], parts), "of the moving sum of the code"),
            ("code_begun", "real", (parts,), ""),
            ("code_filled", "count", (), ""),
        ),
        *rows(
            "output",
            ("residual", "real", (size["RESIDUALS"],), "zeros if unknown"),
            ("statistic", "real", (), "zero where nothing is decided"),
            ("known", "flag", (), "whether there is a residual: no value is missing"),
            ("decided", "flag", (), "false while the filter settles, or if it is unknown"),
            ("alarm", "flag", (), "whether an alarm stands"),
        ),
    ]
    if size["REMEMBERS"]:
        made += rows("state", ("sums", "real", sums, "of the test"))
    if groups:
        made += rows(
            "output",
            ("scored", "flag", (), "whether the scores are meaningful: only in an alarm"),
            ("score", "real", (groups,), "how well each group of faults explains the residual, 0 to 1"),
            ("best", "count", (), "the group that explains it best, from 1 on; 0 for none"),
        )
    if judging.parts:
        made += rows(
            "output",
            ("part_statistic", "real", (parts,), "of each part; zeros where nothing is decided"),
            ("fired", "flag", (parts,), "which parts are in alarm"),
        )
    if judging.codes is not None:
        made += rows(
            "output",
            ("code", "flag", (parts,), "which parts count as fired over the window"),
            ("answer", "count", (), "0 none, 1 exact, 2 several, 3 degraded, 4 nearest, 5 unknown"),
        )
    return made


__all__ = [
    "DOUBLE",
    "FLOAT",
    "MonitorProgram",
    "Precision",
    "monitor_program",
    "precision_named",
    "specification_program",
]
