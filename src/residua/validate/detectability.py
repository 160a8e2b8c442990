"""Smallest fault that a monitor sees, its delay, and the distance to the best test."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_probability, check_whole
from residua.decide.sizes import fault_unit
from residua.decide.stream_settings import is_white
from residua.decide.test import Block, ResidualTest
from residua.decide.whitened_norm import NormTest
from residua.design import ResidualGenerator
from residua.design.core.internal_form import state_covariance
from residua.errors import NotFittedError, SettingError
from residua.linear.systems.recursion import run_filter
from residua.monitor.monitor import Monitor
from residua.progress import Progress, progress_of
from residua.shown import Shown, line_chart, notes
from residua.tolerances import SAME
from residua.validate.figure_table import FigureTable
from residua.validate.intervals import CONFIDENCE, UNKNOWN, Estimate, bootstrap, wilson
from residua.validate.noise import Resampled, resampled
from residua.validate.shapes import Shape, step
from residua.visible import echo, listed
from residua.words import counted, number

#: Delays in samples where none are given; longer ones follow in the same way where a test sums more samples.
_SAMPLES = (1, 3, 10, 30, 100)
#: Sizes are powers of two with these parts of one as steps; the largest has an exponent of that many.
_STEPS, _LARGEST = 64, 40
#: Samples before a fault: enough for a test to settle, and at most so many.
_BEFORE, _MOST_BEFORE = 200, 5_000
#: Runs go on for so many of the longest delays, and of their own, so that a mean is one of all runs.
_ON, _ON_OWN = 4, 20
#: Numbers that may be held at once: half a gigabyte.
_MOST_NUMBERS = 6 * 10**7
#: Where residuals come from after a fit that knows their covariance alone.
_WHITE = "white, with the covariance of the fit"
#: Fewer runs say nothing of a share.
_FEWEST = 20
#: Deviations by which simulated false alarms contradict a design.
_CONTRADICTION = 4.0


@dataclass(frozen=True)
class SmallestFault:
    """Smallest size of a fault that is detected in time with the requested probability.

    Attributes
    ----------
    fault : str
    within : float
        Seconds that count.
    size : Estimate
        In the unit of the fault; infinite where no size is detected so soon, and zero where false alarms alone are as
        frequent.
    mean_delay : Estimate
        At that size, in seconds from the first faulty sample to the alarm; unknown where some runs raise none.
    asymptote : float
        At that size, Lorden's mean delay of the best test for as rare false alarms, in seconds; NaN where the residual
        is not known to be white, or the time between false alarms is not known.
    """

    fault: str
    within: float
    size: Estimate
    mean_delay: Estimate
    asymptote: float


@dataclass(frozen=True, eq=False, repr=False)
class Detectability(Shown):
    """Smallest faults that a monitor sees; :func:`residua.decide.detectability`. Prints as a table.

    Attributes
    ----------
    smallest : tuple of SmallestFault
        Faults in the order of the plant, and for each the delays.
    by_chance : tuple of Estimate
        For each delay, the share of the runs without a fault that raise an alarm as soon.
    curves : mapping of str to (ndarray, ndarray)
        For each fault sizes, and the share of the runs that are detected, shape (sizes, delays).
    miss_rate : float
    shape : str
    noise : str
        Where the residuals come from, in words.
    mean_time : float or None
        Seconds between false alarms that Lorden's delays are for.
    summed : bool
        True if that is the time of single samples, and sums over a window have false alarms more seldom.
    before : int
        Samples of a stream before the fault arrives.
    units : mapping of str to str
        Of the faults, as far as they are known.
    runs, seed : int
    notes : tuple of str
    """

    smallest: tuple[SmallestFault, ...]
    by_chance: tuple[Estimate, ...]
    curves: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = field(repr=False)
    miss_rate: float
    shape: str
    noise: str
    mean_time: float | None
    summed: bool
    before: int
    runs: int
    seed: int
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def delays(self) -> tuple[float, ...]:
        """The delays in seconds."""
        first = self.smallest[0].fault
        return tuple(one.within for one in self.smallest if one.fault == first)

    def table(self) -> FigureTable:
        """Return a row for each fault and delay."""
        header = ("fault", "within [s]", "smallest size", "unit", "by chance", "mean delay [s]", "Lorden [s]")
        chance = self.by_chance * (len(self.smallest) // len(self.by_chance))
        rows = [
            (one.fault, one.within, one.size, self.units.get(one.fault, ""), by, one.mean_delay, one.asymptote)
            for one, by in zip(self.smallest, chance, strict=True)
        ]
        if not any(self.units.values()):
            header, rows = header[:3] + header[4:], [row[:3] + row[4:] for row in rows]
        return FigureTable(header, tuple(rows))

    def power(self, fault: str, within: float | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return sizes of a fault, in its unit, and the probability of its detection within a delay.

        Parameters
        ----------
        fault : str
        within : float, optional
            One of ``delays``, in seconds; the longest when omitted.

        Raises
        ------
        SettingError
            If the fault or the delay is none of these.
        """
        if fault not in self.curves:
            raise SettingError(f"no fault {echo(fault)} here; the faults are: {listed(tuple(self.curves))}")
        delays, column = self.delays, -1
        if within is not None:
            column = int(np.argmin(np.abs(np.array(delays) - float(within))))
            if not np.isclose(delays[column], within):
                raise SettingError(
                    f"within must be one of {', '.join(f'{one:g}' for one in delays)} s, got {echo(within)}"
                )
        sizes, shares = self.curves[fault]
        return sizes.copy(), shares[:, column].copy()

    def _parts(self) -> list[str]:
        first = next(iter(self.curves))
        sizes, shares = self.power(first)
        ends = (f"size {number(float(sizes[0]))}", f"size {number(float(sizes[-1]))}")
        label = f"{first}: probability of detection within {number(self.delays[-1])} s, by its size"
        chart = line_chart(sizes, shares, label=label, limit=1 - self.miss_rate, ends=ends)
        return [*self.table()._parts(), chart, notes(self.notes)]

    def __str__(self) -> str:
        missed = f"{100 * self.miss_rate:g} % missed at most" if self.miss_rate else "none missed"
        head = (
            f"{self.shape} after {self.before:,} samples, {missed}; {self.runs:,} runs, seed {self.seed}; residuals: "
            f"{self.noise}"
        )
        lines = [head, "", str(self.table())]
        if self.mean_time is not None:
            seldom = " or more seldom" if self.summed else ""
            lines.append(f"Lorden: the best test with a false alarm each {number(self.mean_time)} s{seldom}")
        return "\n".join([*lines, *(f"note: {one}" for one in self.notes)])


def detectability(
    monitor: Monitor,
    *,
    within: float | Iterable[float] | None = None,
    miss_rate: float = 0.05,
    faults: Iterable[str] | None = None,
    shape: Shape | None = None,
    residuals: Any = None,
    runs: int = 2000,
    seed: int = 0,
    confidence: float = CONFIDENCE,
    progress: Progress | bool | None = None,
) -> Detectability:
    r"""Return for each fault the smallest size that a monitor detects in time, its delay, and that of the best test.

    The residual is the fault-free one with the response to the fault on top, which is exact for additive faults:

    .. math:: r_k = r^0_k + s\, m_k, \qquad P(s, D) = P(\text{alarm within } D \mid s) \ge 1 - \beta

    and the test of the monitor, as it runs, says when it is in alarm. The same fault-free residuals serve all faults
    and sizes :math:`s`, which are halved and doubled and then divided until the share of the runs that are detected
    is that asked for. In units in which the fault-free residual is white, with variance one, the best test whose false
    alarms are :math:`T` samples apart needs about :math:`n` samples, on the average and for large :math:`T`,

    .. math:: \tfrac{s^2}{2} \sum_{k=1}^{n} |m_k|^2 = \ln T, \qquad
       \text{of a constant response} \quad n = \frac{2 \ln T}{s^2 |m|^2}

    (Lorden 1971, Lai 1998). That is the leading term: at :math:`T = 10^5` and a constant response of one deviation the
    best test is sooner by a seventh.

    Parameters
    ----------
    monitor : Monitor
        With a threshold.
    within : float or sequence of float, optional
        Delays in seconds: a fault that arrives with one sample is detected in time if there is an alarm on that or one
        of the next, as many as this time has steps, rounded. When omitted 1, 3, 10, 30, 100 samples, and so on up to
        twice the window of the test.
    miss_rate : float
        :math:`\beta`, the share that may be missed.
    faults : sequence of str, optional
        All faults of the plant when omitted.
    shape : Shape, optional
        Of the fault over time: a step when omitted; :func:`residua.validate.ramp` and others that add to a signal and
        are the same in each run. Times count from its onset.
    residuals : Diagnosis, array_like of shape (time, k), list of these, or :func:`residua.validate.resampled`, optional
        Fault-free ones to draw from, in blocks. When omitted, those of the noise model of the plant; for a fitted
        monitor those of the residual model of its test (mean, covariance, memory and tails), if it has one.
    runs : int
        How many: the intervals are as wide as the inverse root of it.
    seed : int
    confidence : float
        Of all intervals.
    progress : callable, bool or None
        Told of (stage, faults done, faults in all); ``None``: a bar on terminals; ``False``: nothing.

    Returns
    -------
    Detectability

    Raises
    ------
    DataError
        If ``residuals`` are no finite numbers, or shorter than a block.
    NotFittedError
        If the monitor has no threshold.
    SettingError
        If no noise is known, a fault is unknown, or delays, rates or shapes are none.

    See Also
    --------
    residua.validate.campaign : Simulates the plant itself, with controller, disturbances and model errors.

    Notes
    -----
    Assumes: disturbances are decoupled or zero; the filter has settled when the fault arrives; the fault is additive.

    References
    ----------
    Lorden (1971), Annals of Mathematical Statistics 42(6), theorem 3; Lai (1998), IEEE Transactions on Information
    Theory 44(7), theorem 1 (responses that change with time).

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> test = rs.decide.CUSUM(mean_time_between_false_alarms=1e5)
    >>> watch = rs.Monitor(rs.design.kalman_filter(plant), test=test)
    >>> seen = rs.decide.detectability(watch, within=[5, 20], runs=500)
    >>> [round(one.size.value, 1) for one in seen.smallest]
    [0.4, 0.2]
    """
    if not isinstance(monitor, Monitor):
        raise SettingError(f"detectability takes a Monitor, got {type(monitor).__name__}")
    if not monitor.is_fitted:
        raise NotFittedError("this monitor has no threshold: fit it, or give its plant noise, first")
    check_probability(confidence, "confidence")
    check_whole(runs, "runs", least=_FEWEST)
    check_whole(seed, "seed", least=0)
    check_probability(miss_rate, "miss_rate")
    generator, test = monitor.generator, monitor._specification().test
    if test.reads_signals:
        raise SettingError(
            f"the threshold of {type(monitor.test).__name__} moves with the inputs, which a campaign simulates"
        )
    names = _checked_faults(faults, generator.faults)
    delays = _delays(within, generator.dt, test.samples)
    _check_size(test, int(runs), delays[-1])
    noise, words = _noise(monitor, test, residuals)
    course = _course(shape, generator.dt, _ON * delays[-1])
    trials = _trials(test, noise, int(runs), delays[-1], int(seed))
    chance = trials.delays(np.zeros((delays[-1], generator.n_residuals)))
    quick = generator.dt * np.array(delays)
    mean_time = None if test.mean_time is None else test.mean_time * generator.dt
    is_known_white = residuals is None and (monitor.fit_check is not None or is_white(generator))
    smallest, curves = [], {}
    tell, close = progress_of(progress)
    try:
        for number_of, name in enumerate(names):
            response = _response(generator, name, course)
            search = _Search(trials, response, delays, 1 - float(miss_rate), float(confidence))
            white = test.in_white_units(response) if is_known_white else None
            for count, seconds in zip(delays, quick.tolist(), strict=True):
                size = search.smallest(count)
                mean = search.mean_delay(size.value, count, int(seed))
                mean = Estimate(*(generator.dt * value for value in (mean.value, mean.low, mean.high)))
                best = generator.dt * _asymptote(white, size.value, test.mean_time)
                smallest.append(SmallestFault(name, seconds, size, mean, best))
            curves[name] = search.curve()
            tell("faults", number_of + 1, len(names))
    finally:
        close()
    return Detectability(
        tuple(smallest),
        tuple(wilson(int((chance < count).sum()), len(chance), confidence) for count in delays),
        curves,
        float(miss_rate),
        "step" if shape is None else str(shape),
        words,
        mean_time,
        isinstance(test, NormTest) and test.window > 1,
        _settled(test),
        int(runs),
        int(seed),
        {name: fault_unit(generator.plant, name) for name in names},
        _notes(trials, generator, test, words),
    )


# ----------------------------------------------------------------------------- runs


#: Fault-free residuals of (runs, samples): shape (runs, samples, k).
_Draw = Callable[[np.random.Generator, int, int], NDArray[np.float64]]


@dataclass(frozen=True, eq=False)
class _Trials:
    """Runs of a test from the moment at which a fault arrives, the same for all faults and sizes.

    Attributes
    ----------
    test : ResidualTest
    state : object
        Of the test, at that moment: with a row for each run.
    residuals : ndarray, shape (runs, samples, k)
        Fault-free, from that moment on.
    quiet : ndarray of bool, shape (runs,)
        True if no false alarm stands at that moment; others are left out.
    alarms, before : int
        False alarms that were raised before, and the samples of all runs.
    """

    test: ResidualTest
    state: Any
    residuals: NDArray[np.float64]
    quiet: NDArray[np.bool_]
    alarms: int
    before: int

    def delays(self, added: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return for each quiet run the samples before the first in alarm, or as many as there are.

        Parameters
        ----------
        added : ndarray, shape (samples, k)
            Response of the residual to the fault.
        """
        residuals = self.residuals[:, : len(added)] + added
        block = Block(residuals, np.ones(residuals.shape[:2], dtype=bool), _BEFORE)
        alarm = self.test.run(self.state, block)[1].alarm[self.quiet]
        return np.where(alarm.any(axis=1), alarm.argmax(axis=1), len(added))


def _trials(test: ResidualTest, noise: _Draw, runs: int, longest: int, seed: int) -> _Trials:
    """Return runs of a test up to the arrival of a fault, with the fault-free residuals after it."""
    before = _settled(test)
    rng = np.random.default_rng(seed)
    drawn = noise(rng, runs, before + _ON * longest)
    first = drawn[:, :before]
    state, tested = test.run(test.start(runs), Block(first, np.ones(first.shape[:2], dtype=bool)))
    alarm = tested.alarm
    raised = int(alarm[:, 0].sum() + np.count_nonzero(alarm[:, 1:] & ~alarm[:, :-1]))
    quiet = ~alarm[:, -1]
    if not quiet.any():
        raise SettingError(
            "fault-free residuals are in alarm all the time: fit the monitor to data that are like these residuals"
        )
    return _Trials(test, state, drawn[:, before:], quiet, raised, alarm.size)


def _settled(test: ResidualTest) -> int:
    """Return the number of samples after which a test has forgotten its start."""
    return min(max(_BEFORE, 4 * test.samples), _MOST_BEFORE)


def _check_size(test: ResidualTest, runs: int, longest: int) -> None:
    """Raise if the residuals of so many runs need too much memory."""
    k, samples = len(test.center), _settled(test) + _ON * longest
    if runs * k * samples > _MOST_NUMBERS:
        most = _MOST_NUMBERS // (k * samples)
        fewer = f"runs={most:,} at most, or a shorter delay" if most >= _FEWEST else "a shorter delay"
        raise SettingError(
            f"{runs:,} runs of {samples:,} samples of {counted(k, 'residual')} are too many to hold: {fewer}"
        )


def _noise(monitor: Monitor, test: ResidualTest, residuals: Any) -> tuple[_Draw, str]:
    """Return a function that draws fault-free residuals, and its description."""
    k = len(test.center)
    if residuals is not None:
        blocks = residuals if isinstance(residuals, Resampled) else resampled(residuals)
        if blocks.residuals.shape[1] != k:
            raise SettingError(
                f"residuals has {blocks.residuals.shape[1]} columns, the generator {counted(k, 'residual')}: take "
                "those of this monitor"
            )
        if not np.ptp(blocks.residuals, axis=0).any():
            raise SettingError(
                "residuals never change: give those of a fault-free recording (monitor.run(u, y).residuals)"
            )
        return lambda rng, runs, samples: np.stack([blocks.draw(rng, samples) for _ in range(runs)]), str(blocks)
    if monitor.fit_check is not None and test.fault_free_residuals(np.zeros((1, 1, k))) is not None:

        def from_test(rng: np.random.Generator, runs: int, samples: int) -> NDArray[np.float64]:
            drawn = test.fault_free_residuals(rng.standard_normal((runs, samples, k)))
            assert drawn is not None
            return drawn

        return from_test, _WHITE if isinstance(test, NormTest) else "as the fit describes them"
    generator = monitor.generator
    if generator.covariance_of_sums(1) is None:
        raise SettingError(
            "the plant has no noise, and the test of this monitor does not say what fault-free residuals are: "
            "with_noise(...), or give residuals= of fault-free recordings (monitor.run(u, y).residuals)"
        )
    fitted = " around the mean of the fit" if monitor.fit_check is not None else ""
    return _from_model(generator, test.center), f"by the noise model of the plant{fitted}"


def _from_model(generator: ResidualGenerator, center: NDArray[np.float64]) -> _Draw:
    """Return a function that draws residuals by the noise model of the plant, from their stationary state."""
    whole = generator.internal_form()
    form = whole.select(inputs=range(len(generator.faults) + len(generator.plant.disturbances), whole.n_inputs))
    X = state_covariance(form.A, form.B @ form.B.T)
    values, vectors = np.linalg.eigh(X)
    root = vectors * np.sqrt(np.maximum(values, 0.0))

    def draw(rng: np.random.Generator, runs: int, samples: int) -> NDArray[np.float64]:
        x = rng.standard_normal((runs, len(root))) @ root.T
        w = rng.standard_normal((runs, samples, form.n_inputs))
        return center + run_filter(form.A, form.B, form.C, form.D, x, w)[1]

    return draw


def _response(generator: ResidualGenerator, fault: str, course: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the response of the residual to a fault of size one over time, zero where its structure says so."""
    column = generator.faults.index(fault)
    form = generator.internal_form().select(inputs=[column])
    start = np.zeros((1, form.n_states))
    response = run_filter(form.A, form.B, form.C, form.D, start, course[None, :, None])[1][0]
    return np.where(generator.structure[:, column], response, 0.0)


# ---------------------------------------------------------------------------- search


class _Search:
    """Search over the sizes of one fault, with the results of the runs for each."""

    def __init__(
        self,
        trials: _Trials,
        response: NDArray[np.float64],
        delays: tuple[int, ...],
        wanted: float,
        confidence: float,
    ) -> None:
        self.trials, self.response, self.delays, self.confidence = trials, response, delays, confidence
        # counts, so that a share of exactly 0.95 of the runs is 0.95 of them
        self.wanted = wanted * int(trials.quiet.sum())
        deviation = trials.residuals.std(axis=(0, 1))
        height = np.divide(np.abs(response).max(axis=0), deviation, out=np.zeros_like(deviation), where=deviation > 0)
        self.unit = 1 / float(height.max(initial=0.0)) if height.any() else 1.0
        self.tried: dict[int, NDArray[np.int64]] = {}

    def size(self, exponent: float) -> float:
        """Return a size from the number of steps over the unit."""
        return self.unit * 2.0 ** (exponent / _STEPS)

    def seen(self, exponent: int, within: int) -> int:
        """Return the number of runs detected within a delay."""
        if exponent not in self.tried:
            added = self.size(exponent) * self.response[: self.delays[-1]]
            self.tried[exponent] = self.trials.delays(added)
        return int((self.tried[exponent] < within).sum())

    def smallest(self, within: int) -> Estimate:
        """Return the smallest size with enough runs detected within a delay, with its interval.

        The interval holds the sizes of which the share asked for lies within the interval of the share that is seen.
        """
        runs, share = int(self.trials.quiet.sum()), self.wanted / self.trials.quiet.sum()
        enough = [wilson(count, runs, self.confidence) for count in range(runs + 1)]
        least = next(count for count, one in enumerate(enough) if one.high >= share)
        surely = next((count for count, one in enumerate(enough) if one.low >= share), None)
        value = self.size_for(self.wanted, within)
        low = self.size_for(least, within) if least else 0.0
        return Estimate(value, min(low, value), np.inf if surely is None else max(self.size_for(surely, within), value))

    def size_for(self, count: float, within: int) -> float:
        """Return the smallest size with so many runs detected within a delay; infinite if there is none."""
        if not self.response[:within].any() or self.seen(_LARGEST * _STEPS, within) < count:
            return np.inf
        low, high = 0, 0
        while self.seen(high, within) < count:
            low, high = high, high + _STEPS
        if high == 0:
            while self.seen(low, within) >= count:
                low, high = low - _STEPS, low
                if low < -_LARGEST * _STEPS:
                    return 0.0
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.seen(middle, within) >= count else (middle, high)
        below, above = self.seen(low, within), self.seen(high, within)
        return self.size(low + (count - below) / (above - below))

    def mean_delay(self, size: float, within: int, seed: int) -> Estimate:
        """Return the mean delay of faults of a size, in samples; unknown unless each run raises an alarm."""
        if not np.isfinite(size) or size == 0:
            return UNKNOWN
        samples = min(_ON_OWN * within, len(self.response))
        delays = self.trials.delays(size * self.response[:samples]).astype(float)
        if (delays == samples).any():
            return UNKNOWN
        return bootstrap(delays, lambda rows: rows.mean(axis=1), seed, self.confidence)

    def curve(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return ascending sizes, and the shares of the runs detected by each delay, up to all of them."""
        tried = [one for one in sorted(self.tried) if one < _LARGEST * _STEPS]
        if tried:  # those of the search lie close together: some between, and below
            for exponent in range(tried[0] - _STEPS, tried[-1] + 1, _STEPS // 2):
                self.seen(exponent, self.delays[-1])
        exponents = [one for one in sorted(self.tried) if one < _LARGEST * _STEPS]
        shares = [[float((self.tried[one] < within).mean()) for within in self.delays] for one in exponents]
        kept = shares.index(shares[-1]) + 1 if shares else 0  # larger ones tell no more
        sizes = np.array([self.size(one) for one in exponents[:kept]])
        return sizes, np.array(shares[:kept]).reshape(kept, len(self.delays))


def _asymptote(white: NDArray[np.float64] | None, size: float, mean_time: float | None) -> float:
    """Return the delay in samples at which the information on the fault matches the time between alarms."""
    if white is None or mean_time is None or not np.isfinite(size) or size == 0:
        return np.nan
    information = np.cumsum(np.sum((size * white) ** 2, axis=1)) / 2
    needed = max(float(np.log(mean_time)), 0.0)
    if information[-1] >= needed:
        k = int(np.searchsorted(information, needed))
        before = information[k - 1] if k else 0.0
        samples = k + (needed - before) / (information[k] - before)
    else:
        last = information[-1] - information[-2] if len(information) > 1 else information[-1]
        samples = len(information) + (needed - information[-1]) / last if last > 0 else np.inf
    return max(float(samples) - 1, 0.0)


# ---------------------------------------------------------------------------- checks


def _checked_faults(faults: Iterable[str] | None, faults_of_plant: tuple[str, ...]) -> tuple[str, ...]:
    if faults is None:
        names = faults_of_plant
    elif isinstance(faults, str):
        names = (faults,)
    elif isinstance(faults, Iterable):
        names = tuple(faults)
    else:
        raise SettingError(f"faults must be names of faults, got {echo(faults)}; known: {listed(faults_of_plant)}")
    unknown = [one for one in names if one not in faults_of_plant]
    if unknown:
        raise SettingError(f"the plant has no fault {echo(unknown[0])}; known: {listed(faults_of_plant)}")
    if not faults_of_plant:
        raise SettingError("the plant has no faults: with_sensor_faults(), with_actuator_faults(), or with_faults(...)")
    if not names:
        raise SettingError(f"faults names none; known: {listed(faults_of_plant)}")
    return names


def _delays(within: float | Iterable[float] | None, dt: float, window: int) -> tuple[int, ...]:
    """Return the delays in samples, in ascending order."""
    if within is None:
        counts: list[int] = [*_SAMPLES]
        while counts[-1] < 2 * window and counts[-1] < _MOST_BEFORE:
            counts.append(10 * counts[-2])
        return tuple(counts)
    try:
        seconds = np.atleast_1d(np.asarray(within, dtype=float)).ravel()
    except (TypeError, ValueError):
        seconds = np.zeros(0)
    if not seconds.size or not np.isfinite(seconds).all() or not (seconds >= dt * (1 - SAME)).all():
        raise SettingError(f"within must be one step ({dt:g} s) or more, in seconds, got {echo(within)}")
    return tuple(sorted({round(one / dt) for one in seconds.tolist()}))


def _course(shape: Shape | None, dt: float, samples: int) -> NDArray[np.float64]:
    """Return the size of the fault over time, as a share of the whole, from its onset on."""
    shape = step(at=0.0) if shape is None else shape
    if not isinstance(shape, Shape):
        raise SettingError(f"shape must be one of rs.validate's, such as rs.validate.ramp(...), got {echo(shape)}")
    if shape.acts != "adds" or shape.differs:
        raise SettingError(
            f"{shape.name} is not the same addition to a signal in each run: rs.validate.campaign simulates it"
        )
    onset = shape.earliest_sample(dt)
    return shape.over(onset + samples, dt, np.random.default_rng(0))[1][onset:]


def _notes(trials: _Trials, generator: ResidualGenerator, test: ResidualTest, noise: str) -> tuple[str, ...]:
    """Return cautions: disturbances, unexpected rates of false alarms, runs left out."""
    notes = []
    if noise == _WHITE:
        notes.append("residuals are taken to be white: give residuals= of a fault-free recording where they are not")
    first, disturbances = len(generator.faults), len(generator.plant.disturbances)
    form = generator.internal_form().select(inputs=range(first, first + disturbances))
    if form.D.any() or (form.B.any() and form.C.any()):
        notes.append(f"disturbances are taken to be zero: {listed(generator.plant.disturbances)}")
    if test.mean_time is not None:
        expected = trials.before / test.mean_time
        if trials.alarms > 2 * expected + _CONTRADICTION * np.sqrt(expected + 1):
            notes.append(
                f"without a fault {trials.alarms:,} alarms in {trials.before:,} samples, where the test says "
                f"{expected:.3g}: these residuals are not those that the threshold is for"
            )
    left = int((~trials.quiet).sum())
    if left:
        verb = "is" if left == 1 else "are"
        notes.append(f"{left} of {len(trials.quiet):,} runs {verb} left out: a false alarm stands as the fault arrives")
    return tuple(notes)
