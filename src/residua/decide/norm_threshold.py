"""A threshold on the norm of the residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.false_alarms import Observed, observed, promise_of
from residua.decide.fault_free import FaultFree, check_enough
from residua.decide.whitening import whitening_matrix
from residua.errors import SettingError
from residua.visible import echo

#: Groups of residuals: ``"each"`` by itself, names with the residuals of each, or none.
Groups = str | tuple[tuple[str, tuple[str, ...]], ...] | None


@dataclass(frozen=True)
class NormThreshold:
    r"""Alarm while the norm of the whitened residual stays over a threshold.

    .. math:: J_k = \sqrt{\bar q_k^T \bar q_k} > J_{th}, \qquad
       \bar q_k = \frac{1}{\sqrt N} \sum_{i=0}^{N-1} \Sigma_N^{-1/2} (r_{k-i} - \bar r)

    with the covariance :math:`\Sigma_N` of the residual summed over ``N`` samples, divided by ``N``. With a
    window of one sample this is the norm of the whitened residual itself.

    Parameters
    ----------
    threshold : float, optional
        Fitted from fault-free data when omitted (:meth:`residua.Monitor.fit`), or, where the residual's
        covariance is known from the plant's noise, taken from the chi-squared distribution.
    persistence : int
        Samples in a row over the threshold that raise an alarm.
    release : int, optional
        Samples in a row below it that end the alarm; as many as ``persistence`` when omitted.
    window : int
        Samples ``N`` over which the residual is summed. A longer window sees smaller and slower faults, and
        sees large ones no more than that later.
    whiten : {"auto", "data", "model", "none"}
        Whose covariance :math:`\Sigma_N` is used: that of the fault-free data, that of the plant's noise
        model, or the identity. ``"auto"`` takes the data when fitted, else the model, else none.
    false_alarm_rate : float
        Fraction of fault-free samples in alarm that is aimed at, unless ``fit`` is told otherwise. A sample is in alarm
        from the one that raises it, the last of ``persistence`` over the threshold, to the one before that which ends
        it: the rate counts samples, not alarms, on data other than those of the fit, once windows are full.
    groups : "each", mapping of str to sequence of str, or sequence of sequence of str, optional
        Groups of residuals that are tested by themselves, each with its own whitening, threshold, alarm and share of
        the rate: every residual alone, or those that are named, each residual in one group. The monitor is in alarm
        while any group is, and tells which. Of many residuals one norm hides a fault that few of them show: of 52, it
        lies at 10 standard deviations where that of a single one lies at 5. Not for banks, whose members are groups
        already.

    References
    ----------
    Chen, Patton and Zhang (1996), eq. (24).
    """

    threshold: float | None = None
    persistence: int = 3
    release: int | None = None
    window: int = 1
    whiten: str = "auto"
    false_alarm_rate: float = 1e-4
    groups: Any = None

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.threshold is not None and not (is_number(self.threshold) and self.threshold > 0):
            raise SettingError(f"threshold must be a positive number, got {self.threshold!r}")
        for name in ("persistence", "window"):
            check_samples(getattr(self, name), name)
        if self.release is not None:
            check_samples(self.release, "release")
        if self.whiten not in ("auto", "data", "model", "none"):
            raise SettingError(f"whiten must be 'auto', 'data', 'model' or 'none', got {self.whiten!r}")
        check_rate(self.false_alarm_rate)
        for name in ("persistence", "release", "window"):  # plain numbers, whatever they came as
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else int(value))
        for name in ("threshold", "false_alarm_rate"):
            value = getattr(self, name)
            object.__setattr__(self, name, None if value is None else float(value))
        object.__setattr__(self, "groups", _checked_groups(self.groups))


def _checked_groups(given: object) -> Groups:
    """Return groups of residuals as plain names; those without a name are called by their residuals."""
    if given is None:
        return None
    if isinstance(given, str) and given == "each":
        return "each"
    wanted = "groups must be 'each', names of groups with the names of their residuals, or a list of lists of these"
    if isinstance(given, Mapping):
        pairs = list(given.items())
    elif isinstance(given, Sequence) and not isinstance(given, str):
        if all(isinstance(one, tuple) and len(one) == 2 and isinstance(one[0], str) and isinstance(one[1], tuple)
               for one in given):  # what this function returns  # fmt: skip
            pairs = list(given)
        else:
            pairs = [(None, one) for one in given]
    else:
        raise SettingError(f"{wanted}, got {echo(given)}")
    out: dict[str, tuple[str, ...]] = {}
    for name, members in pairs:
        if isinstance(members, str) or not isinstance(members, Sequence) or not len(members):
            raise SettingError(f"{wanted}, got {echo(members)} for one group")
        names = tuple(str(one) for one in members)
        label = ", ".join(names) if name is None else str(name)
        if label in out:
            raise SettingError(f"two groups are called {label!r}")
        out[label] = names
    if not out:
        raise SettingError(f"{wanted}, got none")
    return tuple(out.items())


def is_number(value: object) -> bool:
    """Tell whether a setting is one finite number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool) and isfinite(value)


def check_samples(value: object, name: str, *, least: int = 1) -> None:
    """Raise unless a setting is a whole number of samples."""
    if not is_number(value) or int(value) != value or value < least:  # pyright: ignore
        raise SettingError(f"{name} must be a whole number of samples, at least {least}, got {value!r}")


def check_rate(rate: float) -> None:
    """Raise unless ``rate`` is a usable false alarm rate."""
    if not is_number(rate) or not 0 < rate < 1:
        raise SettingError(f"false_alarm_rate must lie between 0 and 1, got {rate!r}")


@dataclass(frozen=True, eq=False)
class NormTest:
    """A norm threshold with every number filled in: what runs.

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
        What it was made of: :class:`NormThreshold`, or :class:`residua.decide.PeakThreshold`, whose window is
        ``release``.
    promised : float or None
        Fraction of fault-free samples in alarm that the data of the fit promise not to be exceeded on other data, with
        95 % confidence: 1 where they are too few to say anything; ``None`` where the threshold is not from data.
    shrinkage : float or None
        How far the covariance was drawn towards a simpler one, between 0 and 1, because the data were too few for it;
        ``None`` where it is not from data.
    """

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
        """How far each residual alone, averaged over the window, can be from its mean below threshold."""
        inverse = np.linalg.pinv(self.whitening)
        return self.threshold * np.sqrt(np.sum(inverse**2, axis=0) / self.window)


def norm_test_from_model(settings: NormThreshold, covariance: NDArray | None, n_residuals: int) -> NormTest | None:
    """Return the test that needs no data, or ``None`` when data are needed."""
    use_model = settings.whiten in ("auto", "model") and covariance is not None
    whitening = whitening_matrix(covariance) if use_model and covariance is not None else np.eye(n_residuals)
    if settings.threshold is not None:
        threshold, basis = settings.threshold, "threshold given"
    elif use_model:
        from scipy.special import chdtri  # slow to import, and needed only here

        threshold = float(np.sqrt(chdtri(n_residuals, settings.false_alarm_rate)))
        basis = f"chi-squared distribution at {settings.false_alarm_rate:g} per sample, noise model of the plant"
    else:
        return None
    release = settings.release or settings.persistence
    return NormTest(np.zeros(n_residuals), whitening, threshold, settings.persistence, release, settings.window, basis)


def fit_norm_test(
    settings: NormThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    false_alarm_rate: float,
    covariance: NDArray | None,
    signal_size: float,
    seams: Sequence[int] = (),
) -> NormTest:
    """Fit mean, covariance and threshold to fault-free residuals.

    Mean and covariance are those of all samples. The threshold comes from statistics that each stretch of time has by
    the mean and covariance of the others (cross-fitting, :class:`residua.decide.fault_free.FaultFree`), so that it
    holds on data that the covariance was not fitted to. It is that which the fraction of samples in alarm, persistence
    and release included, is ``false_alarm_rate`` for; see :func:`residua.decide.false_alarms.promise_of` for what is
    done where the data are too few to show that, and for what ``promised`` says.

    Parameters
    ----------
    settings : NormThreshold
    residuals : ndarray, shape (time, k)
    usable : ndarray of bool, shape (time,)
    false_alarm_rate : float
    covariance : ndarray or None
        From the plant's noise model, of sums over the window.
    signal_size : float
        Size of the signals that the residual is the difference of; residuals below 1e-12 of it are rounding.
    seams : sequence of int
        Where ``residuals`` are those of several recordings in a row: the first sample of each further one. No window,
        run or correlation reaches across.

    Returns
    -------
    NormTest
    """
    check_rate(false_alarm_rate)
    base = fit_moments(settings, residuals, usable, covariance=covariance, signal_size=signal_size, seams=seams)
    return with_threshold(base, false_alarm_rate)


@dataclass(frozen=True, eq=False)
class Fitted:
    """A test with mean and covariance fitted, and what its threshold is to be fitted to.

    Attributes
    ----------
    test : NormTest
        Its threshold is infinite, or the one of the settings.
    seen : Observed or None
        Its cross-fitted statistic on fault-free data; ``None`` where the threshold is set.
    count : int
        Fault-free samples.
    rounding : float or None
        Where these data hold no noise: the level of rounding.
    """

    test: NormTest
    seen: Observed | None
    count: int
    rounding: float | None


def fit_moments(
    settings: NormThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    *,
    covariance: NDArray | None,
    signal_size: float,
    seams: Sequence[int] = (),
) -> Fitted:
    """Fit mean and covariance, and return what the threshold is to be fitted to; see :func:`fit_norm_test`."""
    data = FaultFree(residuals, usable, settings.window, tuple(seams))
    k, count = residuals.shape[1], int(usable.sum())
    check_enough(count, k, settings.window)
    rounding = 1e-12 * signal_size
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
    return Fitted(test, seen, count, rounding if noise_free else None)


def with_threshold(base: Fitted, rate: float) -> NormTest:
    """Return a test with its threshold for a rate of false alarms."""
    if base.seen is None:
        return base.test
    found = promise_of(base.seen, rate)
    threshold, basis = found.threshold, f"fitted to {base.count} fault-free samples, {found}"
    if base.test.shrinkage:
        basis += f"; covariance of too few samples, drawn by {base.test.shrinkage:.2g} towards a simpler one"
    if base.rounding is not None:
        threshold, basis = above_rounding(threshold, base.rounding, basis)
    return replace(base.test, threshold=float(threshold), basis=basis, promised=float(found.promised))


def above_rounding(threshold: float, rounding: float, basis: str) -> tuple[float, str]:
    """Return a threshold fitted to data without noise, raised to the rounding of the signals, and its basis."""
    told = f"{basis}; no noise in these data: the threshold is at rounding level"
    return max(threshold, rounding, np.finfo(float).tiny), told
