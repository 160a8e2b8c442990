"""Generalised likelihood ratio: the residual summed since any recent time, whichever sum is least due to chance."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_samples
from residua.decide.compiled import CompiledTest
from residua.decide.gaussian_norm import norm_density
from residua.decide.recent_samples import Sums, over_recent
from residua.decide.row_norms import row_norms
from residua.decide.run_lengths import AlarmCycle, threshold_of
from residua.decide.stream_settings import StreamSettings
from residua.decide.stream_test import StreamTest
from residua.decide.test import ResidualTest, Watched
from residua.design import ResidualGenerator
from residua.errors import FileFormatError, SettingError
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import WINDOW, NumberKind
from residua.records import joined, table_in, text_in, values_in, values_out
from residua.tolerances import SAME
from residua.visible import echo
from residua.words import counted

#: The run length at which the approximation is compared with simulated runs, and their number.
_COMPARED, _RUNS = 300.0, 4000
#: Runs that are followed through an alarm to the next one, and lower thresholds to which they are timed.
_CYCLES, _LEVELS = 1000, 32
#: Thresholds below are over at once, whatever the approximation says.
_SMALLEST = 0.01


@dataclass(frozen=True, eq=False, kw_only=True)
class GLRTest(StreamTest):
    """Fitted generalised likelihood ratio."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamTest.NUMBER_KINDS, "window": WINDOW}

    window: int

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the residuals before the first sample: zero."""
        return np.zeros((plants, self.window - 1, len(self.center)))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the largest norm of a sum over its standard deviation."""
        return over_recent(sums, e, seen, _largest)

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self.compiled_as("glr", window=self.window) if type(self) is GLRTest else None

    @property
    def title(self) -> str:
        """Name of the statistic."""
        return f"largest norm of the sum over 1 to {self.window} samples"

    @property
    def samples(self) -> int:
        """Length of the window."""
        return self.window

    @property
    def least_seen(self) -> float:
        """Mean whose longest sum equals the threshold."""
        return self.threshold / np.sqrt(self.window)


@dataclass(frozen=True, eq=False, kw_only=True)
class DirectedGLRTest(GLRTest):
    """Fitted generalised likelihood ratio for steps in the directions of faults alone.

    Attributes
    ----------
    directions : ndarray, shape (k, directions)
        Unit vectors, in units in which the residual is white.
    """

    directions: NDArray[np.float64]

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the parts of the residuals before the first sample: zero."""
        return np.zeros((plants, self.window - 1, self.directions.shape[1]))

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the largest part of a sum along a direction, over its standard deviation."""
        return over_recent(sums, ordered_product(e, self.directions), seen, _largest_part)

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        if type(self) is not DirectedGLRTest:
            return None
        return self.compiled_as("directed glr", window=self.window, along=self.directions)

    @property
    def title(self) -> str:
        """Name of the statistic."""
        count = counted(self.directions.shape[1], "direction")
        return f"largest part, along {count} of faults, of the sum over 1 to {self.window} samples"

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        super().check(watched)
        if len(self.directions) != len(self.center) or not self.directions.shape[1]:
            raise FileFormatError(f"fitted.directions must be for {len(self.center)} residuals")
        if np.abs(np.sum(self.directions**2, axis=0) - 1).max() > SAME:
            raise FileFormatError("fitted.directions must be unit vectors")


@dataclass(frozen=True)
class GLR(StreamSettings):
    r"""Alarm while the residual, summed since some recent time, exceeds the effect of chance.

    .. math:: J_k = \max_{1 \le n \le N} \frac{1}{\sqrt n} \left| \sum_{i=0}^{n-1} e_{k-i} \right| > h

    with the whitened residual :math:`e`. :math:`J^2 / 2` is the logarithm of the largest likelihood of a step of
    unknown size, direction and time, over that of none: large changes are seen at once, and small ones by sums of up to
    ``window`` samples. An alarm is over when the statistic is at or below half the threshold.

    Parameters
    ----------
    window : int
        N, in samples: the longest sum. It costs as many sums a sample.
    mean_time_between_false_alarms : float, optional
        In samples, from a start to the alarm, on average. The threshold follows by Siegmund and Venkatraman's
        approximation, corrected by 4,000 simulated runs (seeded), and from the runs themselves below 300 samples; it
        is within about 5 %.
    false_alarm_rate : float, optional
        Where no time is given: the fraction of fault-free samples in alarm, with alarms as long as simulated ones that
        are 300 samples apart: exceeded by a tenth at 0.05 and at 0.1, beyond which none is designed. When omitted, one
        that the log of a fit can support; see :class:`residua.decide.NormThreshold`.
    threshold : float, optional
        h, where it is to be neither.
    source : {"auto", "design", "data", "quantile"}
        Where the threshold is from after a fit; see :class:`residua.decide.CUSUM`.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white, by an autoregression, and heavy tails Gaussian, by normal scores.
    directions : "faults", optional
        Steps are looked for in the directions of constant faults alone, :math:`\max_f |d_f^T \sum e| / \sqrt n` with
        the whitened steady responses :math:`d_f` of the faults, of unit length: seen sooner where residuals are many,
        and nothing else is. Faults to whose constant size no residual answers have none.

    See Also
    --------
    residua.decide.CUSUM : The fastest for a change of known size.
    residua.decide.Matched : The generalised likelihood ratio for the dynamic response to each fault.

    Notes
    -----
    Assumes: the fault-free residual is stationary; where the threshold is designed, white and Gaussian too, once
    whitened.

    References
    ----------
    Willsky and Jones (1976), IEEE Transactions on Automatic Control 21(1); Siegmund and Venkatraman (1995), Annals of
    Statistics 23(1), eq. (2.4) for one residual.

    Examples
    --------
    >>> import residua as rs
    >>> test = rs.decide.GLR(window=50, mean_time_between_false_alarms=1e5)
    >>> round(test.designed(1), 1)
    4.8
    """

    kind: ClassVar[str] = "glr"
    makes: ClassVar[type[ResidualTest]] = GLRTest
    falls_to: ClassVar[float] = 0.5
    largest_fraction: ClassVar[float] = 0.1
    origin: ClassVar[str] = "by approximation and simulation"
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**StreamSettings.NUMBER_KINDS, "window": WINDOW}

    window: int = 50
    directions: str | None = None
    #: Of a copy for a watched generator: the steady responses of faults, and their whitened directions.
    _steady: ClassVar[NDArray[np.float64] | None] = None
    _along: ClassVar[NDArray[np.float64] | None] = None

    def __post_init__(self) -> None:
        """Check the settings."""
        super().__post_init__()
        check_samples(self.window, "window")
        object.__setattr__(self, "window", int(self.window))
        if self.directions not in (None, "faults"):
            raise SettingError(f"directions must be 'faults', or None for all, got {echo(self.directions)}")

    def for_parts(self, parts: Mapping[str, Any], watched: Watched) -> GLR:
        """Return the settings with the directions of the faults that are watched."""
        if self.directions is None:
            return self
        made = copy.copy(self)
        object.__setattr__(made, "_steady", _steady_responses(watched.generator))
        blank = made.test(**parts, threshold=np.inf, release=0.0, basis="")
        assert isinstance(blank, DirectedGLRTest)
        object.__setattr__(made, "_along", blank.directions)
        return made

    def run_length(self, threshold: float, dimension: int) -> float:
        """Return the mean number of samples to a false alarm from a start."""
        if self._along is None:
            return _run_length(threshold, dimension, self.window)
        return _run_length_along(threshold, _Directions(self._along), self.window)

    def cycle(self, threshold: float, dimension: int) -> AlarmCycle:
        """Return the mean lengths of quiet and, approximately, of false alarms."""
        if self._along is None:
            made = _compared(dimension, self.window)
        else:
            made = _compared_along(_Directions(self._along), self.window)
        return AlarmCycle(self.run_length(threshold, dimension), made.lasting)

    @property
    def harmless_offset(self) -> float:
        """A quarter of the deviation of the mean over the window."""
        return 0.25 / self.window**0.5

    def test(self, **parts: Any) -> GLRTest:
        """Build the fitted test."""
        plain = GLRTest(**parts, window=self.window)
        if self._steady is None:
            return plain
        along = self._steady @ plain.whitening @ plain.steady_gain
        along /= np.linalg.norm(along, axis=1)[:, None]
        return DirectedGLRTest(**parts, window=self.window, directions=np.ascontiguousarray(along.T))

    # --------------------------------------------------------------------------- files

    def to_record(self) -> dict[str, Any]:
        """Return the settings as a record; ``directions`` are an entry if there are any."""
        content = values_out(self)
        if self.directions is None:
            del content["directions"]
        return content

    @classmethod
    def from_record(cls, content: Any, where: str) -> GLR:
        """Return the settings that a record describes."""
        content = table_in(content, where)
        directions = content.pop("directions", None)
        known = {"directions": None if directions is None else text_in(directions, joined(where, "directions"))}
        return values_in(content, where, cls, known)

    def test_from_record(self, content: Any, where: str, watched: Watched) -> ResidualTest:
        """Read a test from a record, and check it against the watched generator."""
        test = values_in(content, where, GLRTest if self.directions is None else DirectedGLRTest)
        test.check(watched)
        return test


def _steady_responses(generator: ResidualGenerator) -> NDArray[np.float64]:
    """Return the responses to constant faults, a row each, as far as they exist."""
    rows = np.array([*generator.steady_directions.values()]).reshape(-1, generator.n_residuals)
    rows = rows[rows.any(axis=1)]
    if not len(rows):
        raise SettingError(
            "no residual answers to a constant fault, so that there is no direction: leave directions= out, or take "
            "Matched"
        )
    return rows


@dataclass(frozen=True, eq=False)
class _Directions:
    """Unit vectors in columns, as a key of a cache."""

    vectors: NDArray[np.float64]

    def __hash__(self) -> int:
        return hash(self.vectors.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Directions) and np.array_equal(self.vectors, other.vectors)


def _largest(sums: Sums, size_of: Callable[[NDArray], NDArray] = row_norms) -> NDArray[np.float64]:
    """Return the largest norm of the sums, each over its standard deviation."""
    best = None
    for n, total in enumerate(sums, 1):
        size = size_of(total) / np.sqrt(n)
        best = size if best is None else np.maximum(best, size)
    assert best is not None  # a window has at least one sample
    return best


def _largest_part(sums: Sums) -> NDArray[np.float64]:
    """Return the largest part of the sums, each over its standard deviation."""
    return _largest(sums, lambda total: np.abs(total).max(axis=-1))


def _run_length(threshold: float, dimension: int, window: int) -> float:
    """Return the run length: exact for single samples, else an approximation corrected by simulated runs."""
    if window == 1:
        from scipy.special import chdtrc

        return 1 / max(float(chdtrc(dimension, threshold**2)), np.finfo(float).tiny)
    made = _compared(dimension, window)
    return made.run_length(threshold) or _approximate(threshold, dimension, window) * made.correction(threshold)


def _run_length_along(threshold: float, along: _Directions, window: int) -> float:
    """Return the run length of the largest part along some directions, corrected as that of the norm."""
    made = _compared_along(along, window)
    return made.run_length(threshold) or _approximate_along(threshold, along, window) * made.correction(threshold)


def _approximate_along(threshold: float, along: _Directions, window: int) -> float:
    r"""Return the run length of the first of several directions.

    .. math:: \frac{1}{L} = \frac{1}{L_1} \sum_f P(|d_f^T z| \text{ counts} \mid |d_f^T z| > a), \qquad
       z \sim N(0, I)

    with :math:`L_1` of one residual, where a sample that is over in several directions counts once: as the inverse of
    their number in each, which is averaged over 4,000 samples (seeded) that are over in one of them.
    """
    return _approximate(threshold, 1, window) / _worth(threshold, along)


@lru_cache(maxsize=1024)
def _worth(threshold: float, along: _Directions) -> float:
    """Return the number of independent directions that some are worth in the tail."""
    from scipy.special import log_ndtr, ndtri_exp

    vectors = along.vectors
    k, count = vectors.shape
    rng = np.random.default_rng(0)
    chosen = rng.integers(0, count, _RUNS)
    own = -ndtri_exp(log_ndtr(-threshold) + np.log(rng.uniform(size=_RUNS)))  # one that is over, by its tail
    z = rng.standard_normal((_RUNS, k))
    d = vectors.T[chosen]
    z += (own - np.sum(z * d, axis=1))[:, None] * d
    over = np.abs(z @ vectors) > threshold
    over[np.arange(_RUNS), chosen] = True
    return float(count * np.mean(1 / over.sum(axis=1)))


@lru_cache(maxsize=64)
def _compared_along(along: _Directions, window: int) -> _Simulated:
    """Compare simulated runs to a threshold with the approximation."""
    level = threshold_of(lambda h: _approximate_along(h, along, window), _COMPARED, 3.5)
    return _simulated(len(along.vectors), window, lambda sums: np.abs(sums @ along.vectors).max(axis=2), level)


def _approximate(threshold: float, dimension: int, window: int) -> float:
    r"""Return the run length by Siegmund and Venkatraman's approximation, for vectors of any dimension.

    .. math:: \frac{1}{L} = \frac{a^3}{4} f_m(a) \sum_{n=1}^{N} \frac{\nu^2(a / \sqrt n)}{n^2}

    with the density :math:`f_m` of the length of a Gaussian vector, and :math:`\nu` for the overshoot.
    """
    n = np.arange(1.0, window + 1)
    threshold = max(threshold, _SMALLEST)
    x = threshold / np.sqrt(n)
    density = norm_density(np.array([threshold]), np.array([0.0]), dimension)[0]
    return float(4 / (threshold**3 * density * np.sum(_overshoot(x) ** 2 / n**2)))


def _overshoot(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Siegmund's nu, to about a per cent (Siegmund and Yakir 2007)."""
    from scipy.special import ndtr

    density = np.exp(-(x**2) / 8) / np.sqrt(2 * np.pi)
    return (2 / x) * (ndtr(x / 2) - 0.5) / (x / 2 * ndtr(x / 2) + density)


@lru_cache(maxsize=64)
def _compared(dimension: int, window: int) -> _Simulated:
    """Compare simulated runs to a threshold with the approximation."""
    level = threshold_of(lambda h: _approximate(h, dimension, window), _COMPARED, 3.0 + 0.5 * dimension**0.5)
    return _simulated(dimension, window, row_norms, level)


@dataclass(frozen=True, eq=False)
class _Simulated:
    """Simulated runs to one threshold, and to lower ones.

    Attributes
    ----------
    level : float
        The threshold.
    ratio : float
        How much longer the runs to it are than the approximation says.
    lasting : float
        Samples of an alarm, for each of quiet ones as many as there would be from a start.
    below, runs : ndarray
        Lower thresholds from zero on, and the mean runs to them.
    """

    level: float
    ratio: float
    lasting: float
    below: NDArray[np.float64]
    runs: NDArray[np.float64]

    def run_length(self, threshold: float) -> float | None:
        """Return the run length to a threshold below those of all simulated runs; ``None`` for a higher one."""
        if threshold >= self.level:
            return None
        return float(np.exp(np.interp(threshold, self.below, np.log(self.runs))))

    def correction(self, threshold: float) -> float:
        """Return the factor of runs over the approximation, which is the better the rarer alarms are."""
        return 1 + (self.ratio - 1) * (self.level / threshold) ** 2


def _simulated(dimension: int, window: int, size: Callable[[NDArray], NDArray], level: float) -> _Simulated:
    """Return the runs to a level, and for some the alarm after it and the run to the next; sizes are (runs, window)."""
    rng = np.random.default_rng(0)
    start = np.zeros((_RUNS, window, dimension))
    below = np.linspace(0.0, level, _LEVELS + 1)
    largest, quiet = np.zeros(_RUNS), np.zeros(_LEVELS + 1)

    def ended(values: NDArray[np.float64]) -> NDArray[np.bool_]:
        nonlocal largest
        largest = np.maximum(largest, values)
        quiet[:] += np.cumsum(np.bincount(np.searchsorted(below, largest), minlength=_LEVELS + 2))[:-1]
        largest = largest[values <= level]
        return values > level

    first, stopped = _until(start, rng, ended, size)
    alarm, over = _until(stopped[:_CYCLES], rng, lambda values: values <= level * GLR.falls_to, size)
    again, _ = _until(over, rng, lambda values: values > level, size)
    longest = float(first.mean())
    lasting = float(alarm.mean()) * longest / float(again.mean())
    return _Simulated(level, longest / _COMPARED, lasting, below, 1 + quiet / _RUNS)


def _until(
    sums: NDArray[np.float64],
    rng: np.random.Generator,
    ended: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
    size: Callable[[NDArray], NDArray],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the samples of each run until its statistic meets the condition, and its sums then."""
    root = np.sqrt(np.arange(1.0, sums.shape[1] + 1))
    sums, left = sums.copy(), np.arange(len(sums))
    samples, out = np.zeros(len(sums)), np.empty_like(sums)
    while len(left):
        samples[left] += 1
        sums[:, 1:] = sums[:, :-1].copy()
        sums[:, 0] = 0.0
        sums += rng.standard_normal((len(sums), 1, sums.shape[2]))
        done = ended((size(sums) / root).max(axis=1))
        if done.any():
            out[left[done]] = sums[done]
            sums, left = sums[~done], left[~done]
    return samples, out


__all__ = ["GLR", "DirectedGLRTest", "GLRTest"]
