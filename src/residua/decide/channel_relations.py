"""Test of channels beside the residual: each against its prediction by the others, and frozen or quiet sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.arrays import runs as runs_of
from residua.decide.checks import check_rate, is_number, rate_aimed_at
from residua.decide.dependence import correlation_times
from residua.decide.fault_free import FaultFree
from residua.decide.multiscale_ewma import MultiscaleEWMA, MultiscaleEWMATest
from residua.decide.multiscale_fit import averaged
from residua.decide.persistence import AlarmRuns, held, run_alarm
from residua.decide.relations import CURVE, FORMS, HORIZON, LAGS, STATIC, Relations, RelationsState, fit_relations
from residua.decide.stream_test import StreamState
from residua.decide.test import Block, FaultFreeRun, ResidualTest, Tested, TestSettings, Watched
from residua.decide.whitened_norm import NINE_OF_TEN
from residua.errors import DataError, FileFormatError, SettingError
from residua.linear.systems.recursion import SMALLEST
from residua.number_kinds import ENTRY, NOT_NEGATIVE, POSITIVE, PROBABILITY, SHARE, NumberKind
from residua.records import Record
from residua.tolerances import TINY
from residua.visible import echo
from residua.words import number, one_in

#: The part that is the residual of the model itself.
MODEL = "prediction of the model"
#: Weights of the means of each relation.
WEIGHTS = (1.0, 1 / 8, 1 / 64)
#: An alarm ends below that part of its threshold; of the slowest mean, which falls for a hundred samples, of three
#: quarters.
_RELEASE, _SLOW_RELEASE = 0.5, 0.75
#: Samples enter the slow means no larger than so many deviations, or so many thresholds of a single sample.
_CLIP, _CLIP_THRESHOLDS = 5.0, 1.5
#: Factors on thresholds for differences between logs that one log does not show: of channels, and of the residual,
#: whose test is simulated. Chosen on the sets of ``benchmarks/learnt_monitors.py`` with other seeds than those of its
#: table.
_MARGIN, _MODEL_MARGIN = 1.4, 1.2
#: Contiguous blocks whose means show a wander slower than the fit, and the factor on their variance.
_BLOCKS, _WANDER = 10, 1.1
#: A sensor is frozen after so many times its longest standstill in the fit, and so many rows.
_FROZEN, _FROZEN_ROWS = 2, 3
#: Rows over which changes are compared, and the part of the least of the fit below which a sensor is quiet.
_QUIET_ROWS, _QUIET = 50, 0.5
#: Fraction of fault-free samples in alarm that is aimed at without a wish, at the rarest.
_RAREST = 1 / 1000
#: Deviations of a change that is small to a curve.
_SMALL = 0.01
#: Part of the relations that are silent from which on a row lies outside of the learnt range.
OUTSIDE = 0.5


@dataclass(frozen=True, eq=False)
class ChannelsState(Record):
    """State of the test of channels.

    Attributes
    ----------
    model : StreamState
        Of the bank of means of the residual.
    relations : RelationsState
    means : ndarray, shape (plants, 2, channels)
        Those of weights 1/8 and 1/64.
    armed : ndarray of bool, shape (plants, channels)
        True if a slow mean restarts once the fast ones are small again.
    last : ndarray, shape (plants, sensors)
    same : ndarray of int, shape (plants, sensors)
        Samples in a row that were equal to the one before; -1 before the first.
    changes : ndarray, shape (plants, rows, sensors)
        Squares of the last changes.
    counted : ndarray of int, shape (plants, sensors)
        Changes so far, up to the rows over which they are compared.
    runs : AlarmRuns
        With an alarm for each part.
    """

    model: StreamState
    relations: RelationsState
    means: NDArray[np.float64]
    armed: NDArray[np.bool_]
    last: NDArray[np.float64]
    same: NDArray[np.int64]
    changes: NDArray[np.float64]
    counted: NDArray[np.int64]
    runs: AlarmRuns

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "same": NumberKind("a whole number, -1 or more", "i", lambda n: n >= -1)
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class ChannelRelationsTest(ResidualTest):
    """Fitted test of channels beside a residual.

    Attributes
    ----------
    model : MultiscaleEWMATest
        Of the residual.
    relations : Relations
    channels : tuple of str
        Inputs, then outputs.
    sensors : int
        How many of them are outputs: the last ones.
    means : ndarray, shape (channels,)
        Fault-free mean of each relation.
    limits : ndarray, shape (3, channels)
        Thresholds of its means by weight.
    noise : ndarray, shape (3, channels)
        Deviations of these means in the fit.
    clips : ndarray, shape (channels,)
    frozen : ndarray of int, shape (sensors,)
        Samples in a row without a change that are too many; 0: not judged.
    quiet : ndarray, shape (sensors,)
        Root mean square of changes that is too little; 0: not judged.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "center": ENTRY, "limits": NOT_NEGATIVE, "noise": NOT_NEGATIVE, "clips": NOT_NEGATIVE,
        "quiet": NOT_NEGATIVE, "promised": SHARE,
    }  # fmt: skip

    center: NDArray[np.float64]
    threshold: float
    basis: str
    model: MultiscaleEWMATest
    relations: Relations
    channels: tuple[str, ...]
    sensors: int
    means: NDArray[np.float64]
    limits: NDArray[np.float64]
    noise: NDArray[np.float64]
    clips: NDArray[np.float64]
    frozen: NDArray[np.int64]
    quiet: NDArray[np.float64]
    mean_time: float | None = None
    promised: float | None = None

    # ------------------------------------------------------------------------- running

    def start(self, plants: int) -> ChannelsState:
        """Return the state before the first sample."""
        q, p = len(self.channels), self.sensors
        return ChannelsState(
            self.model.start(plants),
            self.relations.start(plants),
            np.zeros((plants, 2, q)),
            np.zeros((plants, q), bool),
            np.zeros((plants, p)),
            np.full((plants, p), -1),
            np.zeros((plants, _QUIET_ROWS - 1, p)),
            np.zeros((plants, p), np.int64),
            replace(AlarmRuns.empty(plants), alarm=np.zeros((plants, 1 + q), bool)).without_down(),
        )

    def run(self, state: ChannelsState, block: Block) -> tuple[ChannelsState, Tested]:
        """Run the bank of means over the residual, the relations over the channels, and the alarm that any raises."""
        model, tested = self.model.run(state.model, block)
        usable = block.usable
        state, ratios, quick = self.of_channels(state, block)
        first = np.where(tested.usable, tested.statistic / self.model.threshold, np.nan)
        every = np.concatenate([first[..., None], ratios], axis=2)
        present = np.isfinite(every)
        over = present & (np.where(present, every, 0.0) > 1)
        judged = present[..., 1:]
        under = (
            judged & (np.where(judged, quick, np.inf) <= _RELEASE) & (np.where(judged, ratios, np.inf) <= _SLOW_RELEASE)
        )
        fired = [tested.alarm]
        fired += [held(over[..., j + 1], under[..., j], state.runs.alarm[:, j + 1]) for j in range(under.shape[2])]
        fired = np.stack(fired, axis=2)
        exceeded = np.asarray(over.any(axis=2))
        _, up, runs = run_alarm(exceeded, usable, replace(state.runs, alarm=state.runs.alarm.any(axis=1)), 1, 1)
        alarm = np.asarray(fired.any(axis=2))
        statistic = np.where(usable, np.fmax.reduce(every, axis=2), np.nan)
        usable = usable & np.isfinite(statistic)
        if usable.shape[1]:
            runs = replace(runs, alarm=fired[:, -1].copy()).without_down()
            state = replace(state, model=model, runs=runs)
        return state, Tested(usable, statistic, exceeded, alarm, up, tested.whitened, every, fired)

    def of_channels(
        self, state: ChannelsState, block: Block
    ) -> tuple[ChannelsState, NDArray[np.float64], NDArray[np.float64]]:
        """Return the state after a block, the statistic of each channel in thresholds, and that without slow means.

        NaN where a channel is not judged.
        """
        assert block.signals is not None
        usable, sensors = block.usable[..., None], slice(len(self.channels) - self.sensors, None)
        residuals = np.where(usable, block.residuals, np.nan)
        relations, errors = self.relations.run(state.relations, block.signals, residuals)
        errors = np.where(usable, errors - self.means, np.nan)
        ratios, quick, means, armed = self._means(state.means, state.armed, errors)
        stuck, last, same, changes, counted = self._stuck(state, block.signals[..., sensors])
        compared = np.isfinite(ratios[..., sensors])  # a sensor that moves ends no alarm of a relation that is silent
        stuck = np.where(usable & (compared | (stuck > 1)), stuck, np.nan)
        ratios[..., sensors], quick[..., sensors] = (
            np.fmax(ratios[..., sensors], stuck),
            np.fmax(quick[..., sensors], stuck),
        )
        if not block.usable.shape[1]:
            return state, ratios, quick
        after = {"means": means, "armed": armed, "last": last, "same": same, "changes": changes, "counted": counted}
        return replace(state, relations=relations, **after), ratios, quick

    def _means(
        self, means: NDArray[np.float64], armed: NDArray[np.bool_], errors: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return the largest mean of each relation in thresholds, (plants, time, channels), and the new state.

        And the same without the slowest mean, which alone holds an alarm no longer than it has to.

        A relation that is not judged at a sample keeps its means. Where nothing is armed and all is judged, the means
        are a filter; else they are run sample by sample.
        """
        plants, time, _ = errors.shape
        live = self.relations.moving
        safe = np.where(self.limits > 0, self.limits, 1.0)
        present = np.isfinite(errors)
        entering = np.clip(np.where(present, errors, 0.0), -self.clips, self.clips)
        ratios = np.where(present, np.abs(errors) / safe[0], np.nan)
        single, quick, means, armed = ratios.copy(), ratios.copy(), means.copy(), armed.copy()
        plain = np.asarray((present | ~live).all(axis=2))
        for p in range(plants):
            t = 0
            while t < time:
                if plain[p, t] and not armed[p].any():
                    stop = t + int(np.argmin(plain[p, t:])) if not plain[p, t:].all() else time
                    rows = [
                        averaged(w, means[p, k][None], entering[p, t:stop][None]) for k, w in enumerate(WEIGHTS[1:])
                    ]
                    fast, slow = (np.abs(one[0][0]) / safe[k] for k, one in enumerate(rows, 1))
                    arming = np.flatnonzero((fast > 1).any(axis=1))
                    end = t + int(arming[0]) + 1 if arming.size else stop
                    quick[p, t:end] = np.fmax(single[p, t:end], fast[: end - t])
                    ratios[p, t:end] = np.fmax(quick[p, t:end], slow[: end - t])
                    means[p] = [one[0][0, end - t - 1] for one in rows]
                    armed[p] |= fast[end - t - 1] > 1
                    t = end
                    continue
                for k, weight in enumerate(WEIGHTS[1:]):
                    now = (1 - weight) * means[p, k] + weight * entering[p, t]
                    if not entering[p, t].any():
                        now = np.where(np.abs(now) < SMALLEST, 0.0, now)
                    means[p, k] = np.where(present[p, t], now, means[p, k])
                fast, slow = np.abs(means[p]) / safe[1:]
                armed[p] |= present[p, t] & (fast > 1)
                over = armed[p] & present[p, t] & (single[p, t] <= _RELEASE) & (fast <= _RELEASE)
                if over.any():
                    bound = _RELEASE * self.limits[2]
                    means[p, 1] = np.where(over, np.clip(means[p, 0], -bound, bound), means[p, 1])
                    armed[p] &= ~over
                    slow = np.abs(means[p, 1]) / safe[2]
                quick[p, t] = np.where(present[p, t], np.fmax(single[p, t], fast), np.nan)
                ratios[p, t] = np.where(present[p, t], np.fmax(quick[p, t], slow), np.nan)
                t += 1
        return np.where(live, ratios, np.nan), np.where(live, quick, np.nan), means, armed

    def _stuck(self, state: ChannelsState, y: NDArray[np.float64]) -> tuple[NDArray[Any], ...]:
        """Return the degree to which sensors are frozen or quiet, in limits, and the new state; gaps change nothing."""
        plants, _, p = y.shape
        ratio = np.full(y.shape, np.nan)
        last, same, counted = state.last.copy(), state.same.copy(), state.counted.copy()
        changes = np.zeros((plants, _QUIET_ROWS - 1, p))
        for plant in range(plants):
            for j in range(p):
                at = np.flatnonzero(np.isfinite(y[plant, :, j]))
                past = state.changes[plant, :, j]
                if not at.size:
                    changes[plant, :, j] = past
                    continue
                values = y[plant, at, j]
                begun = same[plant, j] >= 0
                before = np.concatenate([[last[plant, j] if begun else values[0]], values[:-1]])
                steps = values - before
                lengths = _run_lengths(steps == 0, int(same[plant, j]) if begun else -1)
                degree = np.zeros(len(at))
                if self.frozen[j]:
                    degree = lengths / self.frozen[j]
                whole = np.concatenate([past, steps * steps])
                number = np.minimum(counted[plant, j] + np.arange(1, len(at) + 1), _QUIET_ROWS)
                if self.quiet[j] > 0:
                    mean = np.lib.stride_tricks.sliding_window_view(whole, _QUIET_ROWS).sum(axis=1) / _QUIET_ROWS
                    size = np.sqrt(np.maximum(mean, (0.1 * self.quiet[j]) ** 2))
                    degree = np.where(number >= _QUIET_ROWS, np.maximum(degree, self.quiet[j] / size), degree)
                ratio[plant, at, j] = degree
                last[plant, j], same[plant, j], counted[plant, j] = values[-1], lengths[-1], number[-1]
                changes[plant, :, j] = whole[len(whole) - (_QUIET_ROWS - 1) :]
        return ratio, last, same, changes, counted

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def of_residual(self) -> ResidualTest:
        """Bank of means of the residual."""
        return self.model

    @property
    def reads_signals(self) -> bool:
        """True: relations are of signals."""
        return True

    @property
    def metric(self) -> NDArray[np.float64]:
        """Metric of the residual."""
        return self.model.metric

    @property
    def per_deviation(self) -> NDArray[np.float64] | None:
        """Scale per standard deviation of the residual."""
        return self.model.per_deviation

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Scale per threshold of the residual."""
        return self.model.per_threshold

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights in standard deviations."""
        return self.model.guarded

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts: the model, and the channels."""
        return (MODEL, *self.channels)

    @property
    def part_thresholds(self) -> NDArray[np.float64]:
        """Ones: statistics are in thresholds."""
        return np.ones(1 + len(self.channels))

    @property
    def groups_of_residuals(self) -> dict[str, tuple[int, ...]]:
        """Residual numbers of each part."""
        m = len(self.channels) - self.sensors
        whole = tuple(range(len(self.center)))
        parts = {c: (i - m,) if len(whole) == self.sensors and i >= m else whole for i, c in enumerate(self.channels)}
        return {MODEL: whole} | parts

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return the band of each residual alone."""
        return self.model.bands()

    def leads(
        self, residuals: NDArray[np.float64], changes: NDArray[np.float64], signals: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the responses of the parts to small faults, for a size of one, relative to the threshold."""
        best = self.model.leads(residuals, changes, signals)
        assert best is not None
        spread = np.where(self.relations.spread > 0, self.relations.spread, np.inf)
        needed = self.limits + NINE_OF_TEN * self.noise
        for k, change in enumerate(changes):
            size = float((np.abs(change) / spread).max(initial=0.0))
            if not size > 0:
                continue
            small, silent = _SMALL / size, np.zeros((len(signals), len(change), residuals.shape[2]))
            start = self.relations.start(len(signals), settled=True)
            _, before = self.relations.run(start, signals, silent)
            _, after = self.relations.run(start, signals + small * change, silent + small * residuals[k])
            moved = np.where(self.relations.moving, np.nan_to_num(after - before) / small, 0.0)
            for scale, weight in enumerate(WEIGHTS):
                means = moved if weight == 1 else averaged(weight, np.zeros((len(moved), moved.shape[2])), moved)[0]
                lead = np.abs(means).mean(axis=0) / needed[scale]
                best[k] = np.maximum(best[k], lead.max(axis=1))
        return best

    def outside_share(self, tested: Tested) -> float:
        """Return the fraction of decided samples in which more than half of the relations are silent."""
        silent = ~np.isfinite(tested.part_statistics[tested.usable][:, 1:][:, self.relations.moving])
        return float((silent.mean(axis=1) > OUTSIDE).mean()) if silent.size else 0.0

    def words(self, step: float) -> dict[str, str]:
        """Describe the statistic, and the start and end of an alarm."""
        return {
            "threshold": f"1, in units of each part's own ({self.basis})",
            "test": f"{self.model.title} of the residual; and of each channel, unexplained by "
            f"{_UNEXPLAINED[self.relations.form]}, by means with weights 1, 1/8, 1/64; frozen and quiet sensors",
            "alarm": f"while any part is in alarm: raised over its threshold, ended at {_RELEASE:g} of it, of the "
            f"slowest mean at {_SLOW_RELEASE:g}",
        }

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        self.model.check(watched)
        plant = watched.generator.plant
        q, p, r = len(plant.inputs) + len(plant.outputs), len(plant.outputs), self.relations
        if self.channels != (*plant.inputs, *plant.outputs) or self.sensors != p:
            raise FileFormatError("fitted.channels must be the inputs and outputs of the plant")
        if r.form not in FORMS:
            raise FileFormatError(f"fitted.relations.form must be one of {', '.join(FORMS)}, got {echo(r.form)}")
        knots = r.knots.shape[1] if r.knots.ndim == 2 else 0
        features = {STATIC: q, LAGS: 4 * q}.get(r.form, 0)
        n = watched.generator.n_residuals
        shapes = {
            "means": (self.means, (q,)), "limits": (self.limits, (3, q)), "noise": (self.noise, (3, q)),
            "clips": (self.clips, (q,)),
            "frozen": (self.frozen, (p,)), "quiet": (self.quiet, (p,)), "center": (self.center, (n,)),
            "relations.middle": (r.middle, (q,)), "relations.spread": (r.spread, (q,)),
            "relations.constant": (r.constant, (q,)), "relations.gains": (r.gains, (features, q)),
            "relations.drivers": (r.drivers, (q, 2)), "relations.knots": (r.knots, (q, knots)),
            "relations.curves": (r.curves, (q, 2, knots)), "relations.scales": (r.scales, (q, knots)),
            "relations.lows": (r.lows, (max(features, q),)), "relations.highs": (r.highs, (max(features, q),)),
            "relations.reach": (r.reach, (q, max(features, q))),
            "relations.outputs": (r.outputs, (n,) if r.form == HORIZON else (0,)),
        }  # fmt: skip
        for name, (array, shape) in shapes.items():
            if array.shape != shape:
                raise FileFormatError(f"fitted.{name} must have the shape {shape}")
        if r.ahead.ndim != 3 or (r.form == HORIZON and r.ahead.shape[1:] != (n, n)):
            raise FileFormatError("fitted.relations.ahead must be matrices for the residuals")
        if knots < 2 or not (np.diff(r.knots, axis=1) > 0).all() or not (r.scales > 0).all():
            raise FileFormatError("fitted.relations: knots must grow, and scales be positive")
        if not ((r.drivers >= -1) & (r.drivers < q)).all() or not ((r.outputs >= 0) & (r.outputs < q)).all():
            raise FileFormatError("fitted.relations: drivers and outputs must be channels")

    def check_state(self, state: ChannelsState) -> None:
        """Raise if a state from a file is invalid."""
        self.model.check_state(state.model)


_UNEXPLAINED = {
    STATIC: "the other channels",
    CURVE: "a curve of one or two others",
    LAGS: "the others and their past",
    HORIZON: "a prediction 50 rows ahead",
}


def _run_lengths(flags: NDArray[np.bool_], before: int) -> NDArray[np.int64]:
    """Return the number of flags in a row that end at each sample; ``before`` ended at the sample before the first."""
    at = np.arange(len(flags))
    latest = np.maximum.accumulate(np.where(flags, -1, at))
    return np.where(latest < 0, at + 1 + before, at - latest)


@dataclass(frozen=True)
class Raised(Record):
    """A factor on the thresholds of one part."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"factor": POSITIVE}

    part: str
    factor: float


@dataclass(frozen=True)
class ChannelRelations(TestSettings):
    r"""Alarm where a channel deviates from its prediction by the others, or the residual from zero.

    A prediction from the past follows a sensor that stays wrong: its residual shows the moment in which it goes wrong
    and little afterwards. So each channel is compared, beside the residual, with

    .. math::

       r_i = z_i - a_i - w_i^T z_{-i} \qquad
       r_i = z_i - a_i - w_i^T (z_{-i}, \bar z_{-i}) \qquad
       r_i = \frac{z_i - f(z_j) - g(z_l)}{s(z_j)} \qquad
       r_k = e_k + \sum_{j=1}^{h-1} C A^{j-1} K e_{k-j}

    ``"static"``: with the other channels by ridge regression; ``"lags"``: and with exponentially weighted means of
    theirs, of weights 1/4, 1/16, 1/64; ``"curve"``: with a piecewise linear curve of one or two of them, in its
    deviation there; ``"horizon"``: outputs with the model's prediction 50 samples before. Exponentially weighted means
    of each, of weights 1, 1/8 and 1/64, are held against thresholds of their own. A sensor is in alarm too when it
    keeps one value for more than twice as long as ever in the fit, or when its changes over 50 samples are less than
    half as large as they ever were.

    Guaranteed: the same answers in all units. Thresholds are not below the largest mean of the fault-free rows of the
    fit, each predicted by a fit to other rows.

    Parameters
    ----------
    form : {"static", "curve", "lags", "horizon"}
        :func:`residua.learn` chooses it.
    false_alarm_rate : float, optional
        Intended fraction of fault-free samples in alarm: half of it for the residual, half for the channels.
    unseen : float
        Part of each recording that the model is from: its residual there does not represent the rest, and
        thresholds of residuals are from the rest.
    raised : mapping of str to float, or sequence of Raised
        Factors on thresholds, by channel or :data:`MODEL` (``"prediction of the model"``), from a check on other rows.

    See Also
    --------
    residua.learn : a monitor from a fault-free log, with this test.
    residua.decide.MultiscaleEWMA : the residual alone.

    Notes
    -----
    Assumes: the fault-free rows cover normal operation. A relation is not judged while its inputs are so far
    outside of the range of the fit that it would be moved by more than two deviations. Fault-free data are needed.

    References
    ----------
    Hoerl and Kennard (1970), Technometrics 12(1), 55-67 (ridge regression). Lucas and Saccucci (1990), Technometrics
    32(1), 1-12 (exponentially weighted means).

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> rng = np.random.default_rng(0)
    >>> slow, noise = np.zeros(4000), rng.standard_normal((4000, 2))
    >>> for k in range(1, 4000):
    ...     slow[k] = 0.98 * slow[k - 1] + noise[k, 0]
    >>> u = np.sign(np.sin(np.arange(4000) / 16))
    >>> y = u + 5 * slow + 0.2 * noise[:, 1]
    >>> model = rs.identify.subspace(u[:2000], y[:2000], order=1)
    >>> test = rs.decide.ChannelRelations("static", false_alarm_rate=1e-3)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(model.plant.with_sensor_faults()), test=test)
    >>> monitor = monitor.fit(u[:3000], y[:3000])
    >>> y[3500:] = 0.0
    >>> float(monitor.run(u[3000:], y[3000:]).alarm[510:].mean())
    1.0
    """

    kind: ClassVar[str] = "channel relations"
    makes: ClassVar[type[ResidualTest]] = ChannelRelationsTest
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"false_alarm_rate": PROBABILITY, "unseen": NOT_NEGATIVE}

    form: str = STATIC
    false_alarm_rate: float | None = None
    unseen: float = 0.0
    raised: tuple[Raised, ...] = ()

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.form not in FORMS:
            raise SettingError(f"form must be one of {', '.join(FORMS)}, got {echo(self.form)}")
        check_rate(self.false_alarm_rate)
        if not (is_number(self.unseen) and 0 <= self.unseen < 1):
            raise SettingError(f"unseen must be a part from 0 to less than 1, got {echo(self.unseen)}")
        if isinstance(self.raised, Mapping):
            object.__setattr__(self, "raised", tuple(Raised(str(a), b) for a, b in self.raised.items()))
        if not all(isinstance(one, Raised) and is_number(one.factor) and one.factor >= 1 for one in self.raised):
            raise SettingError(f"raised must be factors of 1 or more by channel, got {echo(self.raised)}")

    def check(self, watched: Watched) -> None:
        """Raise if members are to be tested separately, or if a factor is for no channel."""
        if watched.parts is not None:
            raise SettingError(
                "ChannelRelations tests the residual as a whole: it is not for banks that are read by code"
            )

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> ChannelRelationsTest:
        """Return the test fitted to fault-free data, for a rate of false alarms."""
        if run.signals is None:
            raise DataError("channels can be compared only in recordings: these are residuals alone")
        plant, count = watched.generator.plant, int(run.usable.sum())
        channels, p = (*plant.inputs, *plant.outputs), len(plant.outputs)
        factors = {one.part: one.factor for one in self.raised}
        unknown = [name for name in factors if name not in (MODEL, *channels)]
        if unknown:
            raise SettingError(
                f"raised: {echo(unknown[0])} is not a channel; the channels are {', '.join((MODEL, *channels))}"
            )
        recordings = FaultFree(run.residuals, run.usable, 1, run.seams).parts
        unlike = np.zeros(len(run.usable), dtype=bool)  # the first part of each recording, that the model is from
        for part in recordings:
            unlike[part.start : part.start + int(self.unseen * (part.stop - part.start))] = True
        rest = replace(run, usable=run.usable & ~unlike)
        model = _raised(
            MultiscaleEWMA(source="data").fitted(watched, rest, rate / 2), _MODEL_MARGIN * factors.get(MODEL, 1.0)
        )
        used = rest.usable if self.form == HORIZON else run.usable
        signals = np.where(used[:, None], run.signals, np.nan)
        innovations = np.where(run.usable[:, None], run.residuals, np.nan)
        system = watched.generator.system.explicit()
        relations, errors = fit_relations(self.form, signals, innovations, recordings, system, len(plant.inputs))
        errors = np.where(relations.moving, errors, np.nan)
        present = np.isfinite(errors)
        means = np.where(present, errors, 0.0).sum(axis=0) / np.maximum(present.sum(axis=0), 1)
        limits, noise, clips = _limits(errors - means, recordings, relations.moving, rate / 2)
        frozen, quiet = _standstills(run.signals[:, len(channels) - p :], recordings)
        raised = _MARGIN * np.array([factors.get(name, 1.0) for name in channels])
        basis = f"{one_in(rate)} samples in alarm, half of them by the residual ({model.basis}), half by the channels"
        basis += f" ({count} fault-free samples, each predicted by a fit to others)"
        if factors:
            raises = ", ".join(f"{name} {number(factor, 3)} times" for name, factor in factors.items())
            basis += f"; raised by the check on held-out rows: {raises}"
        return ChannelRelationsTest(
            center=model.center,
            threshold=1.0,
            basis=basis,
            model=model,
            relations=relations,
            channels=channels,
            sensors=p,
            means=means,
            limits=limits * raised,
            noise=noise,
            clips=clips * raised,
            frozen=frozen,
            quiet=quiet,
        )

    def asked(self, watched: Watched, rows: int = 0) -> float:
        """Return the target fraction of fault-free samples in alarm: 1e-3 or more without a wish."""
        return max(rate_aimed_at(self.false_alarm_rate, rows), _RAREST if self.false_alarm_rate is None else 0.0)


def _raised(model: MultiscaleEWMATest, factor: float) -> MultiscaleEWMATest:
    """Return a bank of means whose thresholds are higher."""
    thresholds, fulls = factor * model.thresholds, np.maximum(model.fulls, 2 * factor * model.thresholds)
    return replace(
        model, threshold=factor * model.threshold, release=factor * model.release, thresholds=thresholds,
        releases=factor * model.releases, fulls=fulls,
    )  # fmt: skip


def _limits(
    errors: NDArray[np.float64], recordings: Sequence[slice], moving: NDArray[np.bool_], rate: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the thresholds and deviations of the means of each relation by weight, and the clips of its samples."""
    from scipy.special import stdtrit  # slow to import, and needed only here

    q, k = errors.shape[1], int(moving.sum())
    limits, noise, clips, tail = np.ones((3, q)), np.zeros((3, q)), np.ones(q), rate / (2 * max(k, 1) * len(WEIGHTS))
    for i in np.flatnonzero(moving):
        parts = [errors[part, i][np.isfinite(errors[part, i])] for part in recordings]
        parts = [one for one in parts if len(one) > 1]
        if not parts:
            raise DataError("no complete row is left to set a threshold on")
        series = np.concatenate(parts)
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        stretches = [slice(a, b) for a, b in pairwise(ends)]
        spread = max(float(series.std()), TINY)
        time = float(correlation_times(series[:, None], stretches)[0])
        # drifts slower than the series shows, by the means of its blocks
        blocks = np.array_split(series, _BLOCKS)
        by_chance = 2 * time * float(np.mean([block.var() for block in blocks])) / (len(series) / _BLOCKS)
        excess = _WANDER * np.var([block.mean() for block in blocks], ddof=1) - by_chance
        wander = float(-stdtrit(_BLOCKS - 1, rate / max(k, 1))) * float(np.sqrt(max(excess, 0.0)))
        for scale, weight in enumerate(WEIGHTS):
            if weight == 1:
                values = series
            else:
                entering = np.clip(series, -clips[i], clips[i])
                values = np.concatenate(
                    [averaged(weight, np.zeros((1, 1)), entering[None, s, None])[0][0, :, 0] for s in stretches]
                )
            effective = len(values) / max(1 / weight, float(correlation_times(values[:, None], stretches)[0]))
            noise[scale, i] = values.std()
            limit = noise[scale, i] * float(-stdtrit(max(effective - 1, 1.0), tail))
            limits[scale, i] = np.hypot(max(limit, float(np.abs(values).max())), wander)
            if weight == 1:
                clips[i] = max(_CLIP * spread, _CLIP_THRESHOLDS * limits[0, i])
    return limits, noise, clips


def _standstills(y: NDArray[np.float64], recordings: Sequence[slice]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the number of samples that each sensor may keep one value, and the least it must move; 0 if unknown."""
    frozen, quiet = np.zeros(y.shape[1], np.int64), np.zeros(y.shape[1])
    for j in range(y.shape[1]):
        longest, least = 0, np.inf
        for part in recordings:
            values = y[part, j][np.isfinite(y[part, j])]
            steps = np.diff(values)
            if not steps.size:
                continue
            longest = max(longest, int(np.diff(runs_of(steps == 0)).max(initial=0)))
            if len(steps) >= _QUIET_ROWS:
                squares = np.lib.stride_tricks.sliding_window_view(steps * steps, _QUIET_ROWS)
                least = min(least, float(np.sqrt(squares.mean(axis=1).min())))
        if np.isfinite(least):
            frozen[j] = _FROZEN * longest + _FROZEN_ROWS
            quiet[j] = _QUIET * least
    return frozen, quiet
