"""Window, persistence and threshold of a norm test: those with the least delay at a rate of false alarms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.calibrate import persistent_levels
from residua.decide.checks import check_rate, check_samples, check_whole
from residua.decide.norm_threshold import NormTest, NormThreshold
from residua.errors import SettingError
from residua.monitor.monitor import Monitor
from residua.progress import Progress, progress_of
from residua.shown import Shown
from residua.validate.campaign_result import Campaign
from residua.validate.campaigns import campaign, plan_of
from residua.validate.figure_table import FigureTable
from residua.validate.intervals import Estimate, bootstrap
from residua.validate.runs import quiet_statistics
from residua.validate.scenario import Scenario
from residua.visible import echo

#: Windows and persistences that are tried where none are given.
WINDOWS, PERSISTENCES = (1, 2, 5, 10, 20, 50), (1, 3, 10)
#: Alarms that a threshold is set by, at least.
_ENOUGH = 10.0
#: Windows that go into a run, at least.
_FULL = 4


@dataclass(frozen=True, eq=False)
class TuningCandidate:
    """One tested setting of a norm test.

    Attributes
    ----------
    window, persistence : int
    threshold : float
        By which the fraction of fault-free samples in alarm is that asked for, on the runs that it was set on.
    false_alarm_rate : Estimate
        The fraction on other runs.
    delay : Estimate
        Mean delay in seconds over all runs of all cases; one that is not detected counts with all its time.
    monitor : Monitor
    campaign : Campaign
        On the other runs, the same for all candidates.
    """

    window: int
    persistence: int
    threshold: float
    false_alarm_rate: Estimate
    delay: Estimate
    monitor: Monitor = field(repr=False)
    campaign: Campaign = field(repr=False)


@dataclass(frozen=True, eq=False, repr=False)
class Tuning(Shown):
    """The outcome of :func:`tune`. Prints as a table, the best first.

    Attributes
    ----------
    candidates : tuple of TuningCandidate
        Least delay first.
    asked : float
        Fraction of fault-free samples in alarm that was asked for.
    """

    candidates: tuple[TuningCandidate, ...]
    asked: float

    @property
    def best(self) -> TuningCandidate:
        """The candidate with the least delay."""
        return self.candidates[0]

    @property
    def monitor(self) -> Monitor:
        """The monitor of the best candidate."""
        return self.best.monitor

    def table(self) -> FigureTable:
        """Return a row for each candidate."""
        header = ("window", "persistence", "threshold", "false-alarm rate", "mean delay [s]")
        rows = [(c.window, c.persistence, c.threshold, c.false_alarm_rate, c.delay) for c in self.candidates]
        return FigureTable(header, tuple(rows))

    def __str__(self) -> str:
        lines = [f"for {self.asked:g} of the fault-free samples in alarm", "", str(self.table())]
        notes = self.best.campaign.notes
        return "\n".join([*lines, *(["", *notes] if notes else [])])


def tune(
    monitor: Monitor,
    scenarios: Scenario | Iterable[Scenario],
    *,
    false_alarm_rate: float,
    windows: Sequence[int] = WINDOWS,
    persistences: Sequence[int] = PERSISTENCES,
    runs: int = 200,
    samples: int = 5000,
    seed: int = 0,
    progress: Progress | bool | None = None,
    **simulated: Any,
) -> Tuning:
    r"""Choose window, persistence and threshold of a norm test: the least delay at a rate of false alarms.

    For each window and persistence the threshold is set on simulated fault-free runs: the level :math:`h` that a share
    ``false_alarm_rate`` of their samples is in alarm for, persistence and release included
    (:func:`residua.decide.calibrate.persistent_levels`). Other runs, of another seed and the same for all candidates,
    then say how often it really alarms, and how late it sees the scenarios.

    Parameters
    ----------
    monitor : Monitor
        With :class:`residua.decide.NormThreshold` on the residual as a whole; its design, isolation and other settings
        are kept.
    scenarios : Scenario or sequence of Scenario
        At least one. Every size is a case, and all cases weigh alike.
    false_alarm_rate : float
        Fraction of fault-free samples in alarm.
    windows, persistences : sequence of int
        Candidates, in samples.
    runs, samples : int
        Of every campaign: enough for ten alarms of the longest window or persistence,
        ``runs * samples * false_alarm_rate >= 10 * longest``.
    seed : int
        Thresholds are set on runs of this seed, and checked on those of the next.
    progress : callable, bool or None
        As of :func:`campaign`.
    **simulated
        ``noise``, ``inputs``, ``disturbances``, ``plants``, ``controller``, ``within``, ``workers``, ``confidence`` of
        :func:`campaign`.

    Returns
    -------
    Tuning

    Raises
    ------
    SettingError
        If the rate is not between 0 and 1, the runs are too few for it, there is no scenario, or the monitor has
        another test, was fitted to recordings, or has learnt faults.

    Notes
    -----
    Assumes
        Simulated runs represent normal operation, and false alarms are so rare that few runs are detected by
        chance: else candidates with many short false alarms look quick (the notes of the best one say so).

    The best of many candidates on one set of runs looks a little better than it is; :meth:`Campaign.compare` tells the
    difference between any two of them.

    See Also
    --------
    campaign : the figures of one monitor.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-2, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold())
    >>> faults = rs.validate.Scenario("level sensor", rs.validate.step(at=100), size=20.0)
    >>> options = {"runs": 100, "samples": 300, "windows": [1, 5], "persistences": [1, 3]}
    >>> tuned = rs.validate.tune(monitor, faults, false_alarm_rate=0.002, **options)
    >>> tuned.best.persistence, tuned.best.delay.value
    (1, 0.0)
    """
    for name, values in (("windows", windows), ("persistences", persistences)):
        if not isinstance(values, (Sequence, np.ndarray)) or isinstance(values, str) or not len(values):
            raise SettingError(f"{name} must be a list of numbers of samples, one at least, got {echo(values)}")
        for value in values:
            check_samples(value, name)
    test = _checked(monitor, false_alarm_rate, runs, samples, seed, max(*windows, *persistences))
    _check_length(monitor, samples, max(windows))
    faults = scenarios if isinstance(scenarios, Scenario) else tuple(scenarios)
    out: list[TuningCandidate] = []
    tell, close = progress_of(progress)
    try:
        for number, window in enumerate(windows):
            levels = _levels(monitor, replace(test, window=int(window)), persistences, runs, samples, seed, simulated)
            for persistence in persistences:
                threshold = _threshold(levels[persistence], false_alarm_rate)
                settings = replace(
                    test, window=int(window), persistence=int(persistence), release=None, threshold=threshold
                )
                out.append(_candidate(monitor, settings, faults, runs, samples, seed + 1, simulated))
            tell("windows", number + 1, len(windows))
    finally:
        close()
    return Tuning(tuple(sorted(out, key=lambda one: one.delay.value)), float(false_alarm_rate))


def _checked(monitor: Monitor, rate: float, runs: int, samples: int, seed: int, longest: int) -> NormThreshold:
    """Return the test of a monitor that can be tuned, or raise."""
    check_rate(rate)
    check_whole(runs, "runs")
    check_samples(samples, "samples")
    check_whole(seed, "seed", least=0)
    if not isinstance(monitor, Monitor):
        raise SettingError(f"tune takes a Monitor, got {type(monitor).__name__}")
    test = monitor.test
    if not isinstance(test, NormThreshold) or type(monitor.norm_test) is not NormTest:
        raise SettingError(
            "tune sets window, persistence and threshold of a NormThreshold on the residual as a whole; this monitor "
            "has another test, groups of residuals, a bank that is read by code, or matched filters"
        )
    if monitor.fit_check is not None or len(monitor.learnt_faults):
        raise SettingError(
            "this monitor was fitted to recordings, or has learnt faults, which simulated runs say nothing of: tune it "
            "before, and fit and learn with the window and the persistence that come out"
        )
    if runs * samples * rate < _ENOUGH * longest:
        needed = int(np.ceil(_ENOUGH * longest / rate / samples))
        raise SettingError(
            f"{runs} runs of {samples} samples are too few for a rate of {rate:g} with windows or persistences of up "
            f"to {longest} samples, which is how long alarms are: {needed:,} runs of that length show it"
        )
    return test


def _check_length(monitor: Monitor, samples: int, window: int) -> None:
    """Raise if runs are too short for sums over a window to be full in most of them."""
    judged = samples - monitor.settling_samples
    if judged < _FULL * window:
        raise SettingError(
            f"runs of {samples} samples, {max(judged, 0)} of which are judged, say too little of sums over {window}: "
            f"samples={_FULL * window + monitor.settling_samples} at least, or shorter windows"
        )


def _with(monitor: Monitor, settings: NormThreshold) -> Monitor:
    """Return a monitor of the same design with another test."""
    return Monitor(
        monitor.design,
        test=settings,
        isolate=monitor.isolate,
        dt=monitor.generator.dt,
        settle=monitor.settle,
        max_hold=monitor.max_hold,
        plausible=monitor.plausible,
        start=monitor.start,
    )


def _levels(
    monitor: Monitor,
    settings: NormThreshold,
    persistences: Sequence[int],
    runs: int,
    samples: int,
    seed: int,
    simulated: Mapping[str, Any],
) -> dict[int, NDArray[np.float64]]:
    """Return by persistence the threshold below which each fault-free sample is in alarm."""
    names = ("noise", "inputs", "disturbances", "plants", "controller", "within")
    given = [simulated.get(name) for name in names]
    plan, _ = plan_of(_with(monitor, replace(settings, threshold=1.0)), (), samples, seed, *given)
    levels: dict[int, list[NDArray[np.float64]]] = {one: [] for one in persistences}
    for first in range(0, runs, plan.runs_at_once):
        statistic, usable = quiet_statistics(plan, first, min(first + plan.runs_at_once, runs))
        for one, counts in zip(statistic, usable, strict=True):
            for persistence in persistences:
                made = persistent_levels(one[counts], persistence, persistence)
                levels[persistence].append(made[settings.window - 1 :])  # once windows are full
    return {persistence: np.concatenate(parts) for persistence, parts in levels.items()}


def _threshold(levels: NDArray[np.float64], rate: float) -> float:
    """Return the threshold for a share of the samples in alarm."""
    over = int(rate * len(levels))
    if over < 1:
        raise SettingError("too few samples were judged for this rate: more runs, or longer ones")
    return float(np.partition(levels, len(levels) - over - 1)[len(levels) - over - 1])


def _candidate(
    monitor: Monitor,
    settings: NormThreshold,
    scenarios: Any,
    runs: int,
    samples: int,
    seed: int,
    simulated: Mapping[str, Any],
) -> TuningCandidate:
    """Return a setting with its campaign."""
    watch = _with(monitor, settings)
    made = campaign(watch, scenarios, runs=runs, samples=samples, seed=seed, progress=False, **simulated)
    if not made.cases:
        raise SettingError("tune needs a scenario: without one every candidate is as good as any other")
    f = made.figures
    late = np.where(f.detected >= 0, f.detected, f.stop) - f.onset
    delay = bootstrap(made.dt * late.mean(axis=0), lambda drawn: drawn.mean(axis=1), seed, made.confidence)
    assert settings.threshold is not None
    return TuningCandidate(
        settings.window, settings.persistence, settings.threshold, made.false_alarm_rate(), delay, watch, made
    )


__all__ = ["Tuning", "TuningCandidate", "tune"]
