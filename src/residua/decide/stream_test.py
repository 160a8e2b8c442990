"""Sequential tests: from whitened residuals without memory to a statistic and its alarm."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.autoregression import Past, unforetold
from residua.decide.compiled import CompiledTest
from residua.decide.normal_scores import normal_scores, raw_values
from residua.decide.persistence import AlarmRuns, held, run_alarm
from residua.decide.test import Block, ResidualTest, Tested, Watched
from residua.decide.whitened_norm import BAND_DEVIATIONS, BAND_SHARE, check_invertible, whitened_residuals
from residua.errors import FileFormatError
from residua.linear.systems.recursion import ordered_product, run_filter
from residua.number_kinds import ENTRY, POSITIVE, SHARE, NumberKind
from residua.words import number


@dataclass(frozen=True, eq=False)
class StreamState:
    """State of a sequential test.

    Attributes
    ----------
    past : Past
        The whitened residuals that the autoregression looks at.
    sums : ndarray, shape (plants, ...)
        Of the statistic itself.
    runs : AlarmRuns
    """

    past: Past
    sums: NDArray[np.float64]
    runs: AlarmRuns

    def arrays(self) -> tuple[NDArray | None, ...]:
        """Return the arrays that the fused loop reads and writes, in its order: window, past and sums, runs.

        How long the statistic has been below the threshold is not counted, whatever became of its broadcast zeros.
        """
        up, _, alarm = self.runs.arrays()
        return None, None, None, self.past.samples, self.past.usable, self.sums, up, None, alarm


@dataclass(frozen=True, eq=False)
class StreamTest(ResidualTest):
    r"""Fitted sequential test.

    .. math:: q_k = W^T (r_k - \bar r), \qquad e_k = V^T \Big(q_k - \sum_i A_i q_{k-i}\Big)

    and the statistic follows from :math:`e`, which is white, with unit covariance. An alarm is raised by the first
    sample over the threshold, and is over with the first at or below the level of release.

    Attributes
    ----------
    center : ndarray, shape (k,)
        Fault-free mean.
    whitening : ndarray, shape (k, k)
        W.
    coefficients : ndarray, shape (p, k, k)
        The transposes of A; none where the residual is white.
    rewhitening : ndarray, shape (k, k)
        V.
    knots, scores : ndarray, shapes (k, m) and (m,)
        With heavy tails: values of each part of e, and their normal scores; else none.
    threshold, release : float
    basis : str
        Where the threshold comes from, in words.
    mean_time : float or None
        Samples from a start to a false alarm, on average, where that was designed.
    promised : float or None
        Fraction of fault-free samples in alarm that is not exceeded on other data, with 95 % confidence.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "center": ENTRY,
        "whitening": ENTRY,
        "coefficients": ENTRY,
        "rewhitening": ENTRY,
        "knots": ENTRY,
        "scores": ENTRY,
        "threshold": POSITIVE,
        "mean_time": POSITIVE,
        "promised": SHARE,
    }

    #: Whether the last of the sums says that an alarm stands: it is not remembered twice.
    sums_alarm: ClassVar[bool] = False

    center: NDArray[np.float64]
    whitening: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    rewhitening: NDArray[np.float64]
    knots: NDArray[np.float64]
    scores: NDArray[np.float64]
    threshold: float
    release: float
    basis: str
    mean_time: float | None = None
    promised: float | None = None

    # ------------------------------------------------------------- of each kind of test

    @abstractmethod
    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the initial value of the statistic, with a row for each plant."""

    @abstractmethod
    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the statistic for each sample, shape (plants, time), and the next sums.

        Samples that are not seen change nothing.
        """

    @property
    @abstractmethod
    def title(self) -> str:
        """Name of the statistic."""

    # ------------------------------------------------------------------------- running

    def start(self, plants: int) -> StreamState:
        """Return the state before the first sample."""
        sums, runs = self.first_sums(plants), AlarmRuns.empty(plants).without_down()
        return StreamState(Past.empty(plants, self.coefficients), sums[:, :-1] if self.sums_alarm else sums, runs)

    def run(self, state: StreamState, block: Block) -> tuple[StreamState, Tested]:
        """Run the statistic over a block, and the alarm that it raises."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        e, seen, past = unforetold(self.coefficients, state.past, q, usable)
        if self.coefficients.size:
            e = ordered_product(e, self.rewhitening)
        e = normal_scores(e, self.knots, self.scores)
        before = np.hstack([state.sums, state.runs.alarm[:, None].astype(float)]) if self.sums_alarm else state.sums
        values, sums = self.statistic(before, e, seen)
        values = np.where(seen, values, np.nan)
        exceeded = seen & (np.where(seen, values, 0.0) > self.threshold)
        _, up, runs = run_alarm(exceeded, seen, state.runs, 1, 1)
        alarm = held(exceeded, seen & (np.where(seen, values, np.inf) <= self.release), state.runs.alarm)
        if alarm.shape[1]:
            runs = replace(runs, alarm=alarm[:, -1].copy()).without_down()
        nobody = np.zeros((*seen.shape, 0))
        tested = Tested(seen, values, exceeded, alarm, up, q, nobody, nobody.astype(bool))
        return StreamState(past, sums[:, :-1] if self.sums_alarm else sums, runs), tested

    def compiled_as(self, statistic: str, **numbers: Any) -> CompiledTest:
        """Return the equivalent for the fused loop, for a statistic that is written in C too."""
        return CompiledTest(
            statistic,
            self.center,
            self.whitening,
            self.threshold,
            sums=int(np.prod(self.first_sums(1).shape)),
            release_level=self.release,
            coefficients=self.coefficients,
            rewhitening=self.rewhitening,
            knots=self.knots,
            scores=self.scores,
            **numbers,
        )

    def fault_free_residuals(self, normal: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return residuals that this test makes white and Gaussian: the inverse of its treatment."""
        e = raw_values(normal, self.knots, self.scores)
        order, plants, k = len(self.coefficients), len(e), len(self.center)
        if order:
            A = np.zeros((order * k, order * k))
            A[k:, :-k] = np.eye((order - 1) * k)
            foretold = np.hstack([M.T for M in self.coefficients])
            A[:k] = foretold
            B = np.vstack([np.eye(k), np.zeros(((order - 1) * k, k))])
            innovations = ordered_product(e, np.linalg.inv(self.rewhitening))
            e = run_filter(A, B, foretold, np.eye(k), np.zeros((plants, order * k)), innovations)[1]
        return self.center + ordered_product(e, np.linalg.inv(self.whitening))

    def in_white_units(self, response: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the innovations of the whitened response; ``None`` with heavy tails."""
        if self.scores.size:
            return None
        q, everywhere = (response @ self.whitening)[None], np.ones((1, len(response)), dtype=bool)
        start = Past(np.zeros((1, *self.coefficients.shape[:2])), np.ones((1, len(self.coefficients)), dtype=bool))
        e = unforetold(self.coefficients, start, q, everywhere)[0][0]
        return e @ self.rewhitening if self.coefficients.size else e

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def metric(self) -> NDArray[np.float64]:
        """Whitening matrix."""
        return self.whitening

    @property
    def per_deviation(self) -> NDArray[np.float64] | None:
        """Whitening matrix."""
        return self.whitening

    @property
    def steady_gain(self) -> NDArray[np.float64]:
        """Steady-state gain of the treatment of whitened residuals: ``q @ steady_gain``."""
        if not self.coefficients.size:
            return np.eye(len(self.center))
        return (np.eye(len(self.center)) - self.coefficients.sum(axis=0)) @ self.rewhitening

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Whitening matrix in units of the smallest constant residual that raises an alarm."""
        return self.whitening @ self.steady_gain / self.least_seen

    @property
    @abstractmethod
    def least_seen(self) -> float:
        """Length of the smallest constant mean, in standard deviations, that is certain to raise an alarm."""

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return the band of each residual alone, averaged over the samples of the statistic."""
        whole = self.whitening if self.samples == 1 else self.whitening @ self.steady_gain
        inverse = np.linalg.pinv(whole)
        return BAND_DEVIATIONS * np.sqrt(np.sum(inverse**2, axis=0) / self.samples), BAND_SHARE

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm."""
        memory = f", less a prediction from the last {len(self.coefficients)} samples" if self.coefficients.size else ""
        return {
            "threshold": f"{self.threshold:.4g} ({self.basis})",
            "test": f"{self.title} of the whitened residual{memory}",
            "alarm": f"raised by a sample over it, ended by one at or below {number(self.release)}",
        }

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        k = watched.generator.n_residuals
        square = (k, k)
        if self.center.shape != (k,) or self.whitening.shape != square or self.rewhitening.shape != square:
            raise FileFormatError(f"fitted: center, whitening and rewhitening must be for {k} residuals")
        if self.coefficients.ndim != 3 or self.coefficients.shape[1:] != square:
            raise FileFormatError(f"fitted.coefficients must be matrices for {k} residuals")
        if self.knots.shape != (k, len(self.scores)) or len(self.scores) == 1:
            raise FileFormatError(f"fitted: knots must be {len(self.scores)} values for each of {k} residuals")
        if not ((np.diff(self.knots, axis=1) > 0).all() and (np.diff(self.scores) > 0).all()):
            raise FileFormatError("fitted: knots and scores must grow")
        if not 0 <= self.release <= self.threshold:
            raise FileFormatError("fitted.release must be at least 0 and not above the threshold")
        check_invertible(self.whitening)
        check_invertible(self.rewhitening)

    def check_state(self, state: StreamState) -> None:
        """Raise if a state from a file is invalid."""
        fresh = self.start(len(state.sums))
        for one, other in (
            (state.sums, fresh.sums),
            (state.past.samples, fresh.past.samples),
            (state.past.usable, fresh.past.usable),
            (state.runs.up, fresh.runs.up),
            (state.runs.down, fresh.runs.down),
            (state.runs.alarm, fresh.runs.alarm),
        ):
            if one.shape != other.shape:
                raise FileFormatError("state.test is not that of this test: an array of it has another shape")


def plain(center: NDArray[np.float64], whitening: NDArray[np.float64]) -> dict[str, Any]:
    """Return the parts of a test whose residual is white after whitening."""
    k = len(center)
    return {
        "center": center,
        "whitening": whitening,
        "coefficients": np.zeros((0, k, k)),
        "rewhitening": np.eye(k),
        "knots": np.zeros((k, 0)),
        "scores": np.zeros(0),
    }


__all__ = ["StreamState", "StreamTest", "plain"]
