"""Properties of fault-free residuals: memory, tails, drift, offset, and size against the noise model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.autoregression import LAGS, Past, autoregression, unforetold, whiteness
from residua.decide.confident_thresholds import least_rate
from residua.decide.cusum import CUSUM
from residua.decide.dependence import correlation_times
from residua.decide.fault_free import FaultFree, check_enough
from residua.decide.stationarity import CONFIDENCE as SURE_OF_CHANGE, Change, changes
from residua.decide.test import FaultFreeRun
from residua.decide.treatment import treated
from residua.errors import DataError
from residua.shown import Shown
from residua.tolerances import LEAKAGE, SIGNAL_ROUNDING
from residua.words import counted, listing, number, some

#: Probability that a kind of finding is made of white Gaussian residuals that are as the model says, of all together.
LEVEL = 0.01
#: Smallest findings that count, however sure they are: correlation, skewness, offset in deviations, factor of variance.
_CORRELATION, _SKEWNESS, _OFFSET, _FACTOR = 0.03, 0.2, 0.1, 1.1
#: Fewer than so many values to each sample, and fewer than so many, are those of a quantised residual.
_REPEATED, _FEW_VALUES = 0.2, 200
#: Deviations of a half by which a part surely is not one: in one of 500 cases by chance.
_SURELY = 1.55
#: Samples to each lag of a correlation.
_SAMPLES_PER_LAG = 60
#: Fewest samples of which moments of third and fourth order say anything.
_LEAST = 50
#: Part of the samples that the tail is.
_TAIL = 0.05
#: Samples from which on finding nothing means something.
_ENOUGH = 500
#: Residuals that a sentence lists.
_LISTED = 5


@dataclass(frozen=True)
class ResidualFacts:
    """The figures of one residual.

    Attributes
    ----------
    name, unit : str
        The unit is empty where it is not known.
    mean, deviation : float
    expected : float or None
        The deviation by the noise model of the plant; ``None`` without one.
    independent : float
        The number of independent samples that the mean is worth.
    lag : int
        Of the largest correlation in time, up to 20; fewer where samples are few.
    correlation : float
        That correlation.
    whiteness : float
        Probability that white noise shows correlations as large.
    order : int
        Of the autoregression of this residual alone that leaves least.
    skewness, kurtosis : float
        Of its innovations; 0 and 3 for Gaussian samples.
    normality : float
        Probability that Gaussian samples show such a skewness or kurtosis.
    below : float
        The part of the samples of that below their mean.
    tail : float
        The shape of its tail, by a generalised Pareto distribution: the inverse of the power with which it falls; 0 or
        below of one that falls faster than any power.
    tail_error : float
        The deviation of that.
    values : int
        How many different ones it has.
    """

    name: str
    unit: str
    mean: float
    deviation: float
    expected: float | None
    independent: float
    lag: int
    correlation: float
    whiteness: float
    order: int
    skewness: float
    kurtosis: float
    normality: float
    below: float
    tail: float
    tail_error: float
    values: int


@dataclass(frozen=True)
class Finding:
    """A property of these residuals that matters for the choice of a test.

    Attributes
    ----------
    kind : {"memory", "bursts", "tails", "skewness", "quantised", "drift", "offset", "variance", "copies"}
    residuals : tuple of str
        Those that it is about, the clearest first; empty for all together.
    text : str
        A sentence, with figures.
    level : float
        The probability of such a finding without a reason.
    """

    kind: str
    residuals: tuple[str, ...]
    text: str
    level: float


@dataclass(frozen=True, repr=False)
class ResidualReport(Shown):
    """Properties of fault-free residuals, and the test they call for; see :func:`residua.decide.residual_report`.

    Attributes
    ----------
    samples : int
        Usable ones.
    recordings : int
    residuals : tuple of ResidualFacts
    findings : tuple of Finding
        Empty for white Gaussian residuals that are as the noise model says.
    changes : tuple of Change
        Where the residuals begin to be others.
    independent : int
        Number of residuals that are not combinations of others.
    least_rate : float
        The smallest rate of false alarms that so many samples can promise with 95 % confidence by themselves.
    recommendations : tuple of str
    """

    samples: int
    recordings: int
    residuals: tuple[ResidualFacts, ...]
    findings: tuple[Finding, ...]
    changes: tuple[Change, ...]
    independent: int
    least_rate: float
    recommendations: tuple[str, ...]

    def table(self) -> list[dict[str, Any]]:
        """Return a row for each residual, as ``pandas.DataFrame`` takes them."""
        return [dict(vars(one)) for one in self.residuals]

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain numbers, texts, lists and dictionaries for JSON."""
        return {
            "samples": self.samples,
            "recordings": self.recordings,
            "independent": self.independent,
            "least_rate": self.least_rate,
            "residuals": self.table(),
            "findings": [{**vars(one), "residuals": list(one.residuals)} for one in self.findings],
            "changes": [{**vars(one), "residuals": list(one.residuals)} for one in self.changes],
            "recommendations": list(self.recommendations),
        }

    def found(self, kind: str) -> Finding | None:
        """Return the finding of a kind; ``None`` without one."""
        return next((one for one in self.findings if one.kind == kind), None)

    def __str__(self) -> str:
        of = f" of {self.recordings} recordings" if self.recordings > 1 else ""
        lines = [f"{counted(len(self.residuals), 'residual')}, {self.samples} fault-free samples{of}"]
        lines += [f"  {one.kind}: {one.text}" for one in self.findings]
        if not self.findings:
            model = any(one.expected is not None for one in self.residuals)
            lines.append(f"  white and Gaussian, as far as so many samples show{', as the noise model says' * model}")
        least = f"no rate of false alarms below {self.least_rate:.2g} at 95 % confidence"
        lines.append(f"  such samples by themselves promise {least}")
        return "\n".join([*lines, *(f"  -> {one}" for one in self.recommendations)])


def findings_of(
    run: FaultFreeRun,
    names: Sequence[str],
    *,
    units: Mapping[str, str] | None = None,
    covariance: NDArray[np.float64] | None = None,
    white: bool | None = None,
) -> ResidualReport:
    """Return the properties of fault-free residuals.

    Parameters
    ----------
    run : FaultFreeRun
    names : sequence of str
        Of the residuals.
    units : mapping of str to str, optional
    covariance : ndarray, shape (k, k), optional
        By the noise model.
    white : bool, optional
        Whether the residual is white by the noise model; omitted without one.
    """
    whole, count = FaultFree(run.residuals, run.usable, 1, run.seams), int(run.usable.sum())
    check_enough(count, run.residuals.shape[1], 1)
    if whole.spread <= SIGNAL_ROUNDING * run.signal_size():
        raise DataError(
            "these residuals hold no noise, only rounding: there is nothing to test; give a recording "
            "with the noise of its sensors"
        )
    places = changes(run, names)
    data = _without(places, whole)
    moves = np.array([bool(column.any()) for column in data.deviations[data.usable].T])
    expected = None if covariance is None else np.sqrt(np.diag(covariance))
    facts, left = [], []
    for j, name in enumerate(names):
        one, e = _facts(
            data,
            j,
            name,
            float(whole.middle[j]),
            (units or {}).get(name, ""),
            None if expected is None else float(expected[j]),
        )
        facts.append(one)
        left.append(e)
    moved = [j for j in range(len(names)) if moves[j]]
    made = treated(data, "auto", CUSUM().harmless_offset)
    parts, independent, notes = made.parts, made.moving, made.notes
    bursts = _bursts(left, facts, moved)
    found = [
        *_memory(data, facts, moved, white, bursts),
        *bursts,
        *_shape(facts, moved, count),
        *_place(facts, moved, covariance is not None),
        *_size(data, facts, moved, covariance),
        *_copies(names, moves, independent, notes),
    ]
    level = max(1 - SURE_OF_CHANGE, LEVEL)
    found += [Finding("drift", one.residuals, one.sentence(len(whole.parts) > 1), level) for one in places]
    worth = count / max(float(correlation_times(_squares(data), data.parts)[0]), 1.0)
    return ResidualReport(
        count,
        len(whole.parts),
        tuple(facts),
        tuple(found),
        places,
        independent,
        least_rate(worth),
        _advice(found, len(parts["coefficients"]), count),
    )


def _without(places: Sequence[Change], whole: FaultFree) -> FaultFree:
    """Return the residuals less their means on either side of each change, and with a gap across it."""
    if not places:
        return whole
    starts = [whole.parts[one.recording - 1].start + one.sample for one in places]
    seams = tuple(sorted({*whole.seams, *starts}))
    residuals = whole.residuals.copy()
    for part in FaultFree(residuals, whole.usable, 1, seams).parts:
        if whole.usable[part].any():
            residuals[part] -= residuals[part][whole.usable[part]].mean(axis=0)
    return FaultFree(residuals, whole.usable, 1, seams)


def _facts(
    data: FaultFree, j: int, name: str, mean: float, unit: str, expected: float | None
) -> tuple[ResidualFacts, NDArray[np.float64]]:
    """Return the figures of one residual, and its innovations in its own deviations."""
    column = data.deviations[:, [j]]
    used = column[data.usable, 0]
    deviation, count = float(np.sqrt(np.mean(used**2))), len(used)
    if not deviation > 0:
        none = (0, 0.0, 1.0, 0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0, 1)
        return ResidualFacts(name, unit, mean, 0.0, expected, float(count), *none), np.zeros(count)
    column = column / deviation
    rho = _correlations(column[:, 0], data.parts, _lags(count))
    largest = int(np.abs(rho).argmax())
    p = whiteness(column, data.usable, data.parts, most=_lags(count))
    order, e = 0, column[data.usable, 0]
    if p < LEVEL:
        model = autoregression(column, data.usable, data.parts)
        order, e = model.order, _left(model.coefficients, column, data)
    e = (e - e.mean()) / max(float(e.std()), np.finfo(float).tiny)
    skewness, kurtosis, normality = _moments(e)
    tail, tail_error = _tail(np.abs(e))
    worth = count / float(correlation_times(column, data.parts)[0])
    return ResidualFacts(
        name, unit, mean, deviation, expected, worth, largest + 1, float(rho[largest]), p, order,
        skewness, kurtosis, normality, float(np.mean(e < 0)), tail, tail_error, len(np.unique(used)),
    ), e  # fmt: skip


def _left(coefficients: NDArray[np.float64], column: NDArray[np.float64], data: FaultFree) -> NDArray[np.float64]:
    """Return the innovations of the samples whose past is known."""
    out = []
    for part in data.parts:
        past = Past.empty(1, coefficients)
        e, seen, _ = unforetold(coefficients, past, column[None, part], data.usable[None, part])
        out.append(e[0, seen[0], 0])
    return np.concatenate(out)


def _lags(samples: int) -> int:
    """Return the lags in use: with more, the sum of squares is not chi-squared in so few samples."""
    return min(LAGS, max(samples // _SAMPLES_PER_LAG, 1))


def _correlations(x: NDArray[np.float64], parts: Sequence[slice], lags: int) -> NDArray[np.float64]:
    """Return the correlations in time, of the lags from one."""
    total = np.zeros(lags + 1)
    for part in parts:
        here = x[part]
        for lag in range(min(lags, len(here) - 1) + 1):
            total[lag] += here[: len(here) - lag] @ here[lag:]
    return total[1:] / total[0]


def _moments(e: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return skewness, kurtosis, and their probability for Gaussian samples (D'Agostino and Pearson)."""
    skewness, kurtosis = float(np.mean(e**3)), float(np.mean(e**4))
    if len(e) < _LEAST:
        return skewness, kurtosis, 1.0
    from scipy.stats import kurtosistest, skewtest  # slow to import, and needed only here

    return skewness, kurtosis, float(min(1.0, 2 * min(skewtest(e).pvalue, kurtosistest(e).pvalue)))


def _tail(size: NDArray[np.float64]) -> tuple[float, float]:
    """Return the shape of the tail of the sizes of samples, and its standard deviation."""
    start = float(np.quantile(size, 1 - _TAIL))
    over = size[size > start] - start
    if not len(over) or not over.var() > 0:
        return 0.0, 0.0
    return float(0.5 * (1 - over.mean() ** 2 / over.var())), float(len(over) ** -0.5)


def _squares(data: FaultFree) -> NDArray[np.float64]:
    """Return the squared norm of the whitened residual, less its mean, as a column."""
    rows = np.sum((data.deviations @ data.moments().whitening) ** 2, axis=1)
    return np.where(data.usable, rows - rows[data.usable].mean(), 0.0)[:, None]


def _memory(
    data: FaultFree, facts: Sequence[ResidualFacts], moved: Sequence[int], white: bool | None, bursts: Sequence[Finding]
) -> list[Finding]:
    """Find correlation in time; by signs alone for residuals with bursts."""
    level, loud = LEVEL / 2 / max(len(moved), 1), {name for one in bursts for name in one.residuals}
    lags, found = _lags(int(data.usable.sum())), []
    for j in moved:
        one, p = facts[j], facts[j].whiteness
        if one.name in loud and p < level:
            p = whiteness(np.sign(data.deviations[:, [j]]), data.usable, data.parts, most=lags)
        if p < level and abs(one.correlation) > _CORRELATION:
            found.append(one)
    found = sorted(found, key=lambda one: -abs(one.correlation))
    names = tuple(one.name for one in found)
    if found:
        sizes = [f"{one.name} {one.correlation:+.2f} at lag {one.lag}" for one in found[:_LISTED]]
        verb = "is" if len(found) == 1 else "are"
        text = f"{some(names, _LISTED)} {verb} correlated in time (correlation of {listing(sizes)})"
    else:
        q = np.where(data.usable[:, None], data.deviations @ data.moments().whitening, 0.0)
        q = q[:, q.any(axis=0)]
        q = np.sign(q) if loud else q
        if q.shape[1] < 2 or whiteness(q, data.usable, data.parts, most=lags) >= LEVEL / 2:
            return []
        text = "each residual is white by itself, but the past of some predicts others"
    if white:
        text += "; by the noise model they are white: the model of the plant, or of its noise, is wrong"
    elif white is not None:
        text += "; by the noise model they do so too"
    return [Finding("memory", names, text, LEVEL)]


def _bursts(left: Sequence[NDArray[np.float64]], facts: Sequence[ResidualFacts], moved: Sequence[int]) -> list[Finding]:
    """Find residuals whose innovations have a size correlated in time: by ranks, for any tails."""
    from scipy.special import ndtri

    names = []
    for j in moved:
        n = len(left[j])
        if n < _LEAST:
            continue
        _, place, count = np.unique(np.abs(left[j]), return_inverse=True, return_counts=True)
        ranks = np.cumsum(count) - (count + 1) / 2  # of equal values the mean
        z = ndtri((ranks + 0.5) / n)[place][:, None]
        if whiteness(z - z.mean(), np.ones(n, dtype=bool), (slice(0, n),), most=_lags(n)) < LEVEL / len(moved):
            names.append(facts[j].name)
    if not names:
        return []
    verb = "comes" if len(names) == 1 else "come"
    text = f"large values of {some(names, _LISTED)} {verb} together, beyond what an autoregression explains"
    return [Finding("bursts", tuple(names), text, LEVEL)]


def _shape(facts: Sequence[ResidualFacts], moved: Sequence[int], samples: int) -> list[Finding]:
    """Find the residuals whose distribution is not Gaussian."""
    odd = [facts[j] for j in moved if facts[j].normality < LEVEL / max(len(moved), 1)]
    heavy = sorted((one for one in odd if one.kurtosis > 3 + _SKEWNESS), key=lambda one: -one.kurtosis)
    light = [one for one in odd if one.kurtosis < 3 - _SKEWNESS]
    # With heavy tails a few samples make a skewness, but not a mean that half of them are not below.
    skew = [one for one in odd if abs(one.skewness) > _SKEWNESS
            and (one not in heavy or abs(one.below - 0.5) > _SURELY / samples**0.5)]  # fmt: skip
    step = [facts[j] for j in moved if facts[j].values < min(_FEW_VALUES, _REPEATED * samples)]
    tails = [
        f"{one.kurtosis:.3g} of {one.name}, shape of its tail {one.tail:.2f} +- {one.tail_error:.2f}" for one in heavy
    ]
    kinds = (
        ("tails", heavy, "larger values than Gaussian ones: kurtosis", tails, LEVEL),
        ("light tails", light, "smaller values than Gaussian ones: kurtosis",
         [f"{one.kurtosis:.3g} of {one.name}" for one in light], LEVEL),
        ("skewness", skew, "one side is longer: skewness",
         [f"{one.skewness:+.2f} of {one.name}" for one in skew], LEVEL),
        ("quantised", step, "few different values:", [f"{one.values} of {one.name}" for one in step], 0.0),
    )  # fmt: skip
    return [
        Finding(kind, tuple(one.name for one in them), f"{text} {listing(figures[:_LISTED])}", level)
        for kind, them, text, figures, level in kinds
        if them
    ]


def _place(facts: Sequence[ResidualFacts], moved: Sequence[int], model: bool) -> list[Finding]:
    """Find means that are not zero, where the model of the plant says that they are."""
    from scipy.special import ndtri

    if not model:
        return []
    limit = -float(ndtri(LEVEL / 2 / max(len(moved), 1)))
    off = [
        facts[j] for j in moved
        if abs(facts[j].mean) > max(limit * facts[j].independent**-0.5, _OFFSET) * facts[j].deviation
    ]  # fmt: skip
    if not off:
        return []
    off = sorted(off, key=lambda one: -abs(one.mean) / one.deviation)
    sizes = [f"{_with_unit(one.mean, one)} ({one.mean / one.deviation:+.2g} deviations) of {one.name}" for one in off]
    text = f"the mean is not zero, as the model of the plant says: {listing(sizes[:_LISTED])}"
    return [Finding("offset", tuple(one.name for one in off), text, LEVEL)]


def _size(
    data: FaultFree, facts: Sequence[ResidualFacts], moved: Sequence[int], covariance: NDArray[np.float64] | None
) -> list[Finding]:
    """Find variances that differ from those of the noise model."""
    from scipy.special import ndtri

    if covariance is None:
        return []
    limit = -float(ndtri(LEVEL / 2 / max(len(moved), 1)))
    tau = correlation_times(data.deviations, data.parts, 2)
    found, floor = [], LEAKAGE * float(np.sqrt(np.diag(covariance).max(initial=0.0)))
    for j in moved:
        one, rows = facts[j], data.deviations[data.usable, j]
        if one.expected is None or one.expected <= floor:
            continue
        ratio = (one.deviation / one.expected) ** 2
        kurtosis = max(float(np.mean(rows**4)) / one.deviation**4, 3.0)
        error = np.sqrt((kurtosis - 1) * tau[j] / len(rows))
        if abs(np.log(ratio)) > max(limit * error, np.log(_FACTOR)):
            found.append((one, ratio))
    if not found:
        return []
    found = sorted(found, key=lambda pair: -abs(np.log(pair[1])))
    sizes = [f"{ratio:.3g} times of {one.name} ({_with_unit(one.deviation, one)}, not {number(one.expected)})"
             for one, ratio in found[:_LISTED]]  # fmt: skip
    text = f"the variance is not that of the noise model: {listing(sizes)}"
    return [Finding("variance", tuple(one.name for one, _ in found), text, LEVEL)]


def _with_unit(value: float, one: ResidualFacts) -> str:
    return f"{number(value)} {one.unit}".rstrip()


def _copies(names: Sequence[str], moves: NDArray[np.bool_], independent: int, notes: Sequence[str]) -> list[Finding]:
    found, still = [], [name for name, moving in zip(names, moves, strict=True) if not moving]
    if still:
        found.append(f"{some(still, _LISTED)} never move{'s' * (len(still) == 1)}")
    if independent < int(moves.sum()):
        said = [one for one in notes if "independent" in one or "predicted exactly" in one]
        found.append("; ".join(said) or f"{independent} of the {len(names)} residuals are independent")
    return [Finding("copies", (), "; ".join(found), 0.0)] if found else []


_REMEDIES = {
    "drift": "fit to a recording without the change (transient=, or leave that part out), or to several that have it; "
    "PageHinkley follows a mean that differs from start to start",
    "offset": "fit the monitor before it runs: thresholds of the noise model are for a mean of zero",
    "variance": "scale the noise of the plant (with_noise) by these factors, or fit: thresholds of the model are wrong",
    "copies": "a fit does not count copies again; leave out residuals that never move",
}


def _advice(found: Sequence[Finding], order: int, samples: int) -> tuple[str, ...]:
    """Recommend tests that suit the findings."""
    kinds, out = {one.kind for one in found}, []
    for kind, text in _REMEDIES.items():
        if kind in kinds:
            out.append(text)
    if "bursts" in kinds:
        out.append('take source="data" (or "quantile"): no design holds where the size of the noise changes')
    elif "memory" in kinds or "tails" in kinds:
        what = [f"takes the memory off by an autoregression of order {order}"] if order else []
        what += ["judges each value by how rare it is"] if "tails" in kinds else []
        if what:
            out.append(f'take CUSUM, EWMA or GLR: a fit with treatment="auto" {listing(what)}')
        if "memory" in kinds and not order:
            out.append('no autoregression explains the memory: take source="data"')
        if "tails" in kinds:
            out.append("for single samples fit NormThreshold: a chi-squared threshold alarms too often")
    elif kinds & {"skewness", "quantised", "light tails"}:
        out.append('take source="quantile" where the rate matters: it assumes no distribution')
    elif not kinds and samples < _ENOUGH:
        out.append(f"nothing speaks against a designed test, but {samples} samples show little: give {_ENOUGH} or more")
    elif not kinds:
        out.append(
            "a designed test holds: CUSUM(mean_time_between_false_alarms=...), or NormThreshold for single samples"
        )
    return tuple(out)


__all__ = ["LEVEL", "Finding", "ResidualFacts", "ResidualReport", "findings_of"]
