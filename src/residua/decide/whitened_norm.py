"""Norm of the whitened residual against one threshold, and its fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.checks import check_rate, check_samples, is_number, rate_aimed_at
from residua.decide.compiled import CompiledTest
from residua.decide.confident_thresholds import check_source, promise_by
from residua.decide.false_alarms import Observed, observed
from residua.decide.fault_free import FaultFree, check_enough
from residua.decide.gaussian_norm import norm_above
from residua.decide.persistence import AlarmRuns, run_alarm
from residua.decide.row_norms import row_norms, row_squares
from residua.decide.test import Block, ResidualTest, Tested, TestSettings, Watched
from residua.decide.whitening import moving_directions, whitening_matrix
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.errors import DataError, FileFormatError, SettingError
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import COUNT, ENTRY, PART, POSITIVE, PROBABILITY, SHARE, WINDOW, NumberKind
from residua.tolerances import SIGNAL_ROUNDING
from residua.visible import echo
from residua.words import one_in

#: Largest whitened residual that is judged: the square of a sum of many still is a number.
_LARGEST = 1e120
#: Share of the fault-free samples of one residual that its band holds, if its noise is Gaussian; in deviations.
BAND_SHARE, BAND_DEVIATIONS = 0.999, 3.2905267314918945
#: Deviations of a normal number that nine of ten are above, below its mean.
NINE_OF_TEN = 1.28
#: Columns of a whitening matrix this near to being dependent, in units of their own rows, see some residuals no more;
#: fitted values stay above 1e-5.
_DEPENDENT = 1e-10
#: Weights above this overflow when they are squared twice.
_HEAVIEST = 1e75

#: Kinds of the numbers in tests and their settings.
RUNS: Mapping[str, NumberKind] = {"persistence": COUNT, "release": COUNT, "window": WINDOW}
FITTED: Mapping[str, NumberKind] = {"center": ENTRY, "whitening": ENTRY, "promised": SHARE, "shrinkage": PART}


@dataclass(frozen=True)
class NormSettings(TestSettings):
    """Settings shared by all norms of a whitened residual; the parameters of :class:`residua.decide.NormThreshold`."""

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**RUNS, "threshold": POSITIVE, "false_alarm_rate": PROBABILITY}

    threshold: float | None = None
    persistence: int = 3
    release: int | None = None
    window: int = 1
    whiten: str = "auto"
    false_alarm_rate: float | None = None
    source: str = field(default="auto", kw_only=True)

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.threshold is not None and not (is_number(self.threshold) and self.threshold > 0):
            raise SettingError(f"threshold must be a positive number, got {echo(self.threshold)}")
        for name in ("persistence", "window"):
            check_samples(getattr(self, name), name)
        if self.release is not None:
            check_samples(self.release, "release")
        if self.whiten not in ("auto", "data", "model", "none"):
            raise SettingError(f"whiten must be 'auto', 'data', 'model' or 'none', got {echo(self.whiten)}")
        check_rate(self.false_alarm_rate)
        check_source(self.source)
        if self.source != "auto" and self.threshold is not None:
            raise SettingError(
                f"threshold={self.threshold:g} and source={self.source!r} cannot be combined: leave one out"
            )
        for name in ("persistence", "release", "window"):  # plain numbers, whatever they came as
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else int(value))
        for name in ("threshold", "false_alarm_rate"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else float(value))


def length_for_nine(threshold: float, k: int) -> float:
    """Return the length of the mean of a standard normal vector for which nine of ten samples exceed a threshold."""
    return float(np.sqrt(max(threshold**2 - k + 1, 1.0)) + NINE_OF_TEN)


def leads_of_sums(white: NDArray[np.float64], window: int, threshold: float) -> NDArray[np.float64]:
    """Return whitened responses summed over a window, as lengths, (faults, time), in units that nine of ten need."""
    sums = np.cumsum(white, axis=1)
    sums[:, window:] -= sums[:, :-window].copy()
    return np.sqrt(row_squares(sums) / window) / length_for_nine(threshold, white.shape[2])


@dataclass(frozen=True, eq=False)
class NormState:
    """State of a test of norms.

    Attributes
    ----------
    window : WindowState
        Of the moving sum of the whitened residual.
    runs : AlarmRuns
        With a column for each part where parts are tested by themselves.
    """

    window: WindowState
    runs: AlarmRuns

    def arrays(self) -> tuple[NDArray | None, ...]:
        """Return the arrays that the fused loop reads and writes, in its order: window, past and sums, runs."""
        return *self.window.arrays(), None, None, None, *self.runs.arrays()


@dataclass(frozen=True, eq=False)
class NormTest(ResidualTest):
    """Fitted norm threshold.

    Attributes
    ----------
    center : ndarray, shape (k,)
        Fault-free mean.
    whitening : ndarray, shape (k, k)
    threshold : float
    persistence, release, window : int
    basis : str
        Where threshold and covariance come from, in words.
    kind : {"norm", "peak"}
        Of its settings: :class:`residua.decide.NormThreshold`, or :class:`residua.decide.PeakThreshold`, whose
        window is ``release``.
    promised : float or None
        Fraction of fault-free samples in alarm that the data of the fit promise not to be exceeded on other data, with
        95 % confidence: 1 if they are too few to say anything; ``None`` if the threshold is not from data.
    shrinkage : float or None
        How far the covariance was drawn towards a simpler one, between 0 and 1, because the data were too few for it;
        ``None`` if it is not from data.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {**RUNS, **FITTED, "threshold": POSITIVE}

    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    threshold: float
    persistence: int
    release: int
    window: int
    basis: str
    kind: str = "norm"
    promised: float | None = None
    shrinkage: float | None = None

    @property
    def band(self) -> NDArray[np.float64]:
        """Largest deviation of each residual alone, averaged over the window, below threshold."""
        inverse = np.linalg.pinv(self.whitening)
        return self.threshold * np.sqrt(np.sum(inverse**2, axis=0) / self.window)

    def start(self, plants: int) -> NormState:
        """Return the state before the first sample."""
        window = empty_window(plants, self.window, self.whitening.shape[1])
        return NormState(window, AlarmRuns.empty(plants))

    def run(self, state: NormState, block: Block) -> tuple[NormState, Tested]:
        """Compare the norm of the whitened residual, summed over the window, with the threshold."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        sums, window = moving_sum(q, state.window, usable)
        statistic = np.where(usable, row_norms(sums) / np.sqrt(self.window), np.nan)
        runs, tested = against_threshold(self, state.runs, statistic, usable, q)
        return NormState(window, runs), tested

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        return self._in_c() if type(self) is NormTest else None

    def _in_c(self) -> CompiledTest:
        return CompiledTest(
            "norm", self.center, self.whitening, self.threshold, self.window, self.persistence, self.release
        )

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Number of samples in the sum."""
        return self.window

    @property
    def metric(self) -> NDArray[np.float64]:
        """Whitening matrix."""
        return self.whitening

    @property
    def per_deviation(self) -> NDArray[np.float64] | None:
        """Whitening matrix."""
        return self.whitening

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Whitening matrix in units of the threshold."""
        return self.whitening / self.threshold

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights in standard deviations; without a threshold no value is too large."""
        return np.abs(self.whitening) / self.threshold if self.threshold == np.inf else np.abs(self.whitening)

    @property
    def mean_time(self) -> float | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Samples from a start to so many in a row over the threshold, if the residual is white; fewer for sums."""
        if not self._knows_spread or not np.isfinite(self.threshold):
            return None
        share = float(norm_above(self.threshold, np.zeros(1), len(self.center))[0])
        row = share ** (self.persistence if self.window == 1 else 1)
        return (1 / row - 1) / (1 - share) if row > 0 and share < 1 else None

    @property
    def _knows_spread(self) -> bool:
        return self.kind == "norm" and not is_selection(self.whitening)

    def fault_free_residuals(self, normal: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return white residuals whose sums over the window have the fitted covariance."""
        if not self._knows_spread:
            return None
        return self.center + ordered_product(normal, np.linalg.inv(self.whitening))

    def in_white_units(self, response: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the whitened response."""
        return response @ self.whitening if self._knows_spread else None

    def leads(
        self, residuals: NDArray[np.float64], changes: NDArray[np.float64], signals: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the responses of the norm to faults of size one, relative to the threshold; ``None`` for peaks."""
        if type(self) is not NormTest:
            return None
        return leads_of_sums(residuals @ self.whitening, self.window, self.threshold)

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return the band of each residual alone: by its own spread if the covariance is known, else by threshold.

        Whatever the threshold on all together is; of the average over the window where the test has one.
        """
        if is_selection(self.whitening):
            return self.band, 0.0
        return BAND_DEVIATIONS * replace(self, threshold=1.0).band, BAND_SHARE

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm."""
        summed = f", summed over {self.window} samples" if self.window > 1 else ""
        return {
            "threshold": f"{self.threshold:.4g} ({self.basis})",
            "test": f"norm of the whitened residual{summed}",
            "alarm": f"raised by {self.persistence} samples in a row over it, ended by {self.release} below it",
        }

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        k = watched.generator.n_residuals
        if self.center.shape != (k,) or self.whitening.shape != (k, k):
            raise FileFormatError(f"fitted: center and whitening must be for {k} residuals")
        check_invertible(self.whitening)

    def check_state(self, state: NormState) -> None:
        """Raise if a state from a file is invalid."""
        state.window.check("state.test.window")


def norm_test_from_model(settings: NormSettings, covariance: NDArray | None, n_residuals: int) -> NormTest | None:
    """Return the test that needs no data, or ``None`` when data are needed."""
    if settings.source != "auto":
        return None
    use_model = settings.whiten in ("auto", "model") and covariance is not None
    whitening = whitening_matrix(covariance) if use_model and covariance is not None else np.eye(n_residuals)
    if settings.threshold is not None:
        threshold, basis = settings.threshold, "threshold given"
    elif use_model and covariance is not None:
        from scipy.special import chdtri  # slow to import, and needed only here

        rate = rate_aimed_at(settings.false_alarm_rate)
        threshold = float(np.sqrt(chdtri(moving_directions(covariance), rate)))
        basis = f"chi-squared distribution at {one_in(rate)} samples, noise model of the plant"
    else:
        return None
    release = settings.release or settings.persistence
    return NormTest(np.zeros(n_residuals), whitening, threshold, settings.persistence, release, settings.window, basis)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A test with mean and covariance fitted, and the data for its threshold.

    Attributes
    ----------
    test : NormTest
        Its threshold is infinite, or the one of the settings.
    seen : Observed or None
        Its cross-fitted statistic on fault-free data; ``None`` if the threshold is set.
    count : int
        Fault-free samples.
    rounding : float or None
        Where these data hold no noise: the level of rounding.
    source : str
        How the threshold is to be fitted; see :func:`residua.decide.confident_thresholds.promise_by`.
    """

    test: NormTest
    seen: Observed | None
    count: int
    rounding: float | None
    source: str = "auto"


def fit_moments(
    settings: NormSettings,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    covariance: NDArray | None,
    signal_size: float,
    seams: Sequence[int] = (),
) -> Fitted:
    """Fit mean and covariance, and return the data for the threshold."""
    data = FaultFree(residuals, usable, settings.window, tuple(seams))
    k, count = residuals.shape[1], int(usable.sum())
    check_enough(count, k, settings.window)
    if not data.full.any():
        longest = max(int(usable[part].sum()) for part in data.parts)
        raise DataError(
            f"no recording has as many usable samples as the window of {settings.window}: the longest has {longest}; "
            "take a shorter window, or longer recordings"
        )
    rounding = SIGNAL_ROUNDING * signal_size
    noise_free = data.spread <= rounding
    known = None
    if settings.whiten == "none" or noise_free:
        known = np.eye(k)
    elif settings.whiten == "model" and covariance is not None:
        known = whitening_matrix(covariance)
    whole = data.moments(whitening=known)
    release = settings.release or settings.persistence
    test = NormTest(whole.center, whole.whitening, np.inf, settings.persistence, release, settings.window, "")
    if known is None:
        test = replace(test, shrinkage=float(whole.intensity))
    if settings.threshold is not None:
        test = replace(test, threshold=settings.threshold, basis="threshold given, mean and covariance fitted")
        return Fitted(test, None, count, None)
    seen = observed(
        data.cross_fitted(whole, whiten=known is None), data.full, usable, data.parts, k,
        persistence=settings.persistence, release=release, window=settings.window, own=data.statistic(whole),
    )  # fmt: skip
    return Fitted(test, seen, count, rounding if noise_free else None, settings.source)


def with_threshold(base: Fitted, rate: float) -> NormTest:
    """Return a test with its threshold for a rate of false alarms."""
    if base.seen is None:
        return base.test
    promise = promise_by(base.source, base.seen, rate)
    threshold, basis = promise.threshold, f"fitted to {base.count} fault-free samples, {promise}"
    if base.test.shrinkage:
        basis += f"; covariance of too few samples, shrunk by {base.test.shrinkage:.2g} towards a simpler one"
    if base.rounding is not None:
        threshold, basis = above_rounding(threshold, base.rounding, basis)
    return replace(base.test, threshold=float(threshold), basis=basis, promised=float(promise.promised))


def above_rounding(threshold: float, rounding: float, basis: str) -> tuple[float, str]:
    """Return a threshold fitted to data without noise, raised to the rounding of the signals, and its basis."""
    sentence = f"{basis}; no noise in these data: the threshold is at rounding level"
    return max(threshold, rounding, np.finfo(float).tiny), sentence


def whitened_residuals(
    center: NDArray[np.float64], whitening: NDArray[np.float64], block: Block
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return whitened residuals, zero where not usable, and the mask of usable ones that do not overflow a sum."""
    usable = block.usable
    with np.errstate(over="ignore", invalid="ignore"):
        centred = np.where(usable[..., None], block.residuals - center, 0.0)
    q = ordered_product(centred, whitening)
    if q.size and not (q.min() >= -_LARGEST and q.max() <= _LARGEST):
        fits = np.asarray((np.abs(q) <= _LARGEST).all(axis=2))
        q, usable = np.where(fits[..., None], q, 0.0), usable & fits
    return q, usable


def against_threshold(
    test: NormTest, runs: AlarmRuns, statistic: NDArray[np.float64], usable: NDArray[np.bool_], whitened: NDArray
) -> tuple[AlarmRuns, Tested]:
    """Compare a statistic with the threshold: return the new runs, and alarm and run lengths."""
    exceeded = usable & (np.where(usable, statistic, 0.0) > test.threshold)
    alarm, up, runs = run_alarm(exceeded, usable, runs, test.persistence, test.release)
    nobody = np.zeros((*usable.shape, 0))
    return runs, Tested(usable, statistic, exceeded, alarm, up, whitened, nobody, nobody.astype(bool))


def is_selection(whitening: NDArray[np.float64]) -> bool:
    """Tell whether a whitening matrix only selects residuals."""
    W = whitening
    return bool(((W == 0) | (W == 1)).all() and (np.count_nonzero(W, axis=0) == 1).all())


def check_invertible(whitening: NDArray[np.float64], *, of_some: bool = False) -> None:
    """Raise if a whitening matrix leaves out a residual, or a combination of them; ``of_some`` are those it has."""
    rows = np.abs(whitening).max(axis=1, initial=0.0)
    if rows.max(initial=0.0) > _HEAVIEST:
        raise FileFormatError(
            f"fitted.whitening holds {rows.max():.3g}: no residual is known so well that it weighs that"
        )
    part = whitening[rows > 0] / rows[rows > 0, None]
    columns = np.sqrt(np.sum(part**2, axis=0))
    sizes = np.linalg.svd(part / np.where(columns > 0, columns, 1.0), compute_uv=False)
    whole = len(part) >= whitening.shape[1] if of_some else len(part) == len(rows)
    if whitening.shape[1] and not (whole and sizes[-1] > _DEPENDENT):
        raise FileFormatError("fitted.whitening must be invertible, for each member: some residuals count for nothing")
