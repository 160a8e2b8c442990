"""A bank of exponentially weighted means under one threshold, for short and long changes at once; the default test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.autoregression import Past, unforetold
from residua.decide.calibrate import SETTLING, allowance, levels_of, simulated_worlds
from residua.decide.checks import check_rate, is_number, rate_aimed_at
from residua.decide.compiled import CompiledTest
from residua.decide.fault_free import check_enough
from residua.decide.multiscale_fit import (
    CLIP,
    FALLS_TO,
    averaged,
    clipped,
    factors_of,
    fit_means,
    held_out_levels,
    lengths_at,
    means_of,
    rows_of_parts,
    scaled,
    scaled_anew,
    scores_of,
    variance_of,
)
from residua.decide.persistence import AlarmRuns, held, run_alarm
from residua.decide.row_norms import row_squares
from residua.decide.stream_test import StreamState, StreamTest, plain
from residua.decide.test import Block, FaultFreeRun, ResidualTest, Tested, TestSettings, Watched
from residua.decide.treatment import columns_of, side_by_side
from residua.decide.whitened_norm import (
    BAND_DEVIATIONS,
    BAND_SHARE,
    check_invertible,
    length_for_nine,
    whitened_residuals,
)
from residua.decide.whitening import moving_directions, whitening_matrix
from residua.errors import FileFormatError, SettingError
from residua.linear.systems.recursion import SMALLEST, ordered_product
from residua.number_kinds import ENTRY, PART, POSITIVE, PROBABILITY, NumberKind
from residua.visible import echo
from residua.words import counted, number, one_in

#: Normal score of the length to which a mean grows at least.
_FULL = 9.0
#: Multiples of the threshold below which an alarm is slight, and how many long and slight ones, or which part of the
#: time, are worth a word.
_SLIGHT, _OFTEN, _MUCH = 2.0, 2, 0.02
#: Times that a response is clipped anew, at the size that is then seen.
_TIMES_CLIPPED = 6
#: Independent samples that the three means are worth, where an alarm is as rare as that (benchmarks/false_alarms.py).
_AS_MANY = 11.0


@dataclass(frozen=True, eq=False, kw_only=True)
class MultiscaleEWMATest(StreamTest):
    r"""Fitted bank of exponentially weighted means.

    Attributes
    ----------
    weights : ndarray, shape (scales,)
        From 1 downwards.
    scaling : ndarray, shape (scales, k, k)
        M: normalises each mean to the length of a standard normal vector.
    sizes : ndarray of int, shape (parts,)
        Whitened residuals of each part that is tested by itself; of the residual as a whole one part.
    clips, fulls : ndarray, shape (parts,)
        Lengths at which samples are clipped before they enter the long means, and to which a mean grows at most.
    thresholds, releases : ndarray, shape (parts,)
        Of each part; ``threshold`` is that of the residual as a whole, and 1 where parts are tested by themselves.
    names : tuple of str
        Of the parts; empty if the residual is tested as a whole.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        **StreamTest.NUMBER_KINDS,
        "weights": PART,
        "scaling": ENTRY,
        "clips": POSITIVE,
        "fulls": POSITIVE,
        "thresholds": POSITIVE,
    }

    weights: NDArray[np.float64]
    scaling: NDArray[np.float64]
    sizes: NDArray[np.int64]
    clips: NDArray[np.float64]
    fulls: NDArray[np.float64]
    thresholds: NDArray[np.float64]
    releases: NDArray[np.float64]
    names: tuple[str, ...] = ()

    @property
    def columns(self) -> list[slice]:
        """The whitened residuals of each part."""
        return columns_of([range(size) for size in self.sizes])

    # ------------------------------------------------------------------------- running

    def first_sums(self, plants: int) -> NDArray[np.float64]:
        """Return the long means before the first sample: zero."""
        return np.zeros((plants, int(np.count_nonzero(self.weights < 1)) * self.whitening.shape[1]))

    def start(self, plants: int) -> StreamState:
        """Return the state before the first sample."""
        parts = (len(self.sizes),) if self.names else ()
        runs = AlarmRuns(np.zeros(plants, np.int32), np.zeros(plants, np.int32), np.zeros((plants, *parts), bool))
        return StreamState(Past.empty(plants, self.coefficients), self.first_sums(plants), runs.without_down())

    def run(self, state: StreamState, block: Block) -> tuple[StreamState, Tested]:
        """Run the means over a block, and the alarm that the longest of them raises."""
        q, usable = whitened_residuals(self.center, self.whitening, block)
        e, seen, past = unforetold(self.coefficients, state.past, q, usable)
        if self.coefficients.size:
            e = ordered_product(e, self.rewhitening)
        squares, sums = self._squares(state.sums, e, seen)
        lengths = np.where(seen[..., None], np.sqrt(squares), np.nan)
        over = seen[..., None] & (np.where(seen[..., None], lengths, 0.0) > self.thresholds)
        ends = seen[..., None] & (np.where(seen[..., None], lengths, np.inf) <= self.releases)
        before = state.runs.alarm if self.names else state.runs.alarm[:, None]
        alarms = np.stack([held(over[..., j], ends[..., j], before[:, j]) for j in range(over.shape[2])], axis=2)
        exceeded = np.asarray(over.any(axis=2))
        _, up, runs = run_alarm(exceeded, seen, replace(state.runs, alarm=before.any(axis=1)), 1, 1)
        if seen.shape[1]:
            last = alarms[:, -1].copy()
            runs = replace(runs, alarm=last if self.names else last[:, 0]).without_down()
        else:
            runs = state.runs
        alarm, nobody = np.asarray(alarms.any(axis=2)), np.zeros((*seen.shape, 0))
        if not self.names:
            tested = Tested(seen, lengths[..., 0], exceeded, alarm, up, q, nobody, nobody.astype(bool))
        else:
            statistic = np.max(lengths / self.thresholds, axis=2)
            tested = Tested(seen, statistic, exceeded, alarm, up, q, lengths, alarms)
        return StreamState(past, sums, runs), tested

    def statistic(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the length of the longest mean of any part, in units of its threshold if there are several."""
        squares, sums = self._squares(sums, e, seen)
        lengths = np.sqrt(squares)
        return (np.max(lengths / self.thresholds, axis=2) if self.names else lengths[..., 0]), sums

    def _squares(
        self, sums: NDArray[np.float64], e: NDArray[np.float64], seen: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the square of the longest mean of each part, (plants, time, parts), and the next means."""
        plants, time, k = e.shape
        largest = np.zeros((plants, time, len(self.sizes)))
        entering = clipped(e, self.columns, self.clips)
        means, after = sums.reshape(plants, -1, k), []
        for weight, scaling in zip(self.weights.tolist(), self.scaling, strict=True):
            if weight == 1:
                rows = ordered_product(e, scaling)
                for j, part in enumerate(self.columns):
                    largest[..., j] = np.maximum(largest[..., j], row_squares(rows[..., part]))
                continue
            squares, mean = self._of_scale(weight, scaling, means[:, len(after)], entering, seen)
            largest = np.maximum(largest, squares)
            after.append(mean)
        return largest, np.concatenate(after, axis=1) if after else sums

    def _of_scale(
        self,
        weight: float,
        scaling: NDArray[np.float64],
        mean: NDArray[np.float64],
        entering: NDArray[np.float64],
        seen: NDArray[np.bool_],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the squares of one scale, and its next mean, which is limited to its full length."""
        plants, time = entering.shape[:2]
        squares = np.zeros((plants, time, len(self.sizes)))
        full = self.fulls * self.fulls
        mean = mean.copy()
        for plant in range(plants):
            at = np.flatnonzero(seen[plant])
            begin = 0
            if time > 1 and at.size:  # without a full mean the recursion is a filter
                rows = averaged(weight, mean[[plant]], entering[[plant]][:, at])[0][0]
                found = self._lengths(rows, scaling)
                capped = np.flatnonzero((found > full).any(axis=1))
                begin = int(capped[0]) if capped.size else len(at)
                squares[plant, at[:begin]] = found[:begin]
                mean[plant] = rows[begin - 1] if begin else mean[plant]
                if begin and not entering[plant, at[begin - 1]].any():
                    mean[plant] = np.where(np.abs(mean[plant]) < SMALLEST, 0.0, mean[plant])
            now = mean[plant]
            for t in at[begin:]:
                now = (1 - weight) * now + weight * entering[plant, t]
                if not entering[plant, t].any():
                    now = np.where(np.abs(now) < SMALLEST, 0.0, now)
                square = self._lengths(now[None], scaling)[0]
                for j, part in enumerate(self.columns):
                    if square[j] > full[j]:
                        now[part] = now[part] * (self.fulls[j] / np.sqrt(square[j]))
                        square[j] = full[j]
                squares[plant, t] = square
            mean[plant] = now
        return squares, mean

    def _lengths(self, rows: NDArray[np.float64], scaling: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the squared lengths of scaled means, (time, parts)."""
        scaled = ordered_product(rows[None], scaling)[0]
        return np.stack([row_squares(scaled[:, part]) for part in self.columns], axis=1)

    @property
    def compiled(self) -> CompiledTest | None:
        """Equivalent for the fused loop."""
        if type(self) is not MultiscaleEWMATest:
            return None
        numbers: dict[str, Any] = {"weights": self.weights, "scaling": self.scaling}
        if self.names:
            numbers |= {"sizes": self.sizes, "limits": self.thresholds}
        return self.compiled_as("means", **numbers, lengths=(self.clips, self.fulls, self.releases))

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def title(self) -> str:
        """Name of the statistic."""
        listed = ", ".join("1" if weight == 1 else f"1/{1 / weight:g}" for weight in self.weights)
        return f"longest of the exponentially weighted means (weights {listed})"

    @property
    def samples(self) -> int:
        """One: the shortest mean is the sample itself."""
        return 1

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return self.names

    @property
    def part_thresholds(self) -> NDArray[np.float64]:
        """Thresholds of the parts."""
        return self.thresholds if self.names else np.zeros(0)

    @property
    def metric(self) -> NDArray[np.float64]:
        """Whitening matrix."""
        return self.whitening

    @property
    def least_seen(self) -> float:
        """The smallest constant mean whose longest average is at the threshold."""
        longest = self.scaling[-1]
        size = float(np.linalg.norm(longest, 2))
        return float(np.min(self.thresholds)) / size if size > 0 else np.inf

    @property
    def per_threshold(self) -> NDArray[np.float64]:
        """Whitening matrix in units of the thresholds."""
        if self.names:
            return self.whitening / np.repeat(self.thresholds, self.sizes)
        return self.whitening / self.threshold

    @property
    def guarded(self) -> NDArray[np.float64]:
        """Weights in standard deviations."""
        return np.abs(self.whitening)

    def bands(self) -> tuple[NDArray[np.float64], float]:
        """Return the band of each residual alone."""
        inverse = np.linalg.pinv(self.whitening)
        return BAND_DEVIATIONS * np.sqrt(np.sum(inverse**2, axis=0)), BAND_SHARE

    def fault_free_residuals(self, normal: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return residuals that this test makes white; ``None`` for parts, which share residuals."""
        return None if self.names else super().fault_free_residuals(normal)

    def in_white_units(self, response: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return the innovations of the whitened response."""
        return None if self.names else super().in_white_units(response)

    def leads(
        self, residuals: NDArray[np.float64], changes: NDArray[np.float64], signals: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return the responses of the longest mean to faults of size one, relative to the threshold.

        What enters the long means is clipped as it is where a fault is just seen.
        """
        needed = [length_for_nine(limit, size) for limit, size in zip(self.thresholds, self.sizes, strict=True)]
        best = np.zeros(residuals.shape[:2])
        for k, one in enumerate(residuals):
            e = super().in_white_units(one)
            assert e is not None  # no bank of means has scores
            entering = e
            for _ in range(_TIMES_CLIPPED):
                lead = np.zeros(len(e))
                for weight, scaling in zip(self.weights.tolist(), self.scaling, strict=True):
                    means = e if weight == 1 else averaged(weight, np.zeros((1, e.shape[1])), entering[None])[0][0]
                    lead = np.maximum(lead, (np.sqrt(self._lengths(means, scaling)) / needed).max(axis=1))
                entering = clipped(e[None], self.columns, self.clips * lead.max(initial=0.0))[0]
            best[k] = lead
        return best

    def words(self, step: float) -> dict[str, str]:
        """Describe the threshold, the statistic, and the start and end of an alarm."""
        said = super().words(step)
        if not self.names:
            return said
        limits = ", ".join(f"{name} {limit:.4g}" for name, limit in zip(self.names, self.thresholds, strict=True))
        return said | {
            "threshold": f"{limits} ({self.basis})",
            "test": f"{said['test']}, of each member; the statistic is the largest ratio to its threshold",
            "alarm": "of a member: raised by a sample over its threshold, ended by one at or below "
            f"{', '.join(number(one) for one in self.releases)}; of the bank: while any member is in alarm",
        }

    def cautions(self, tested: Tested) -> tuple[str, ...]:
        """Return a caution about alarms that are long and slight again and again: a small fault, or slow drift."""
        memory, slight = round(1 / self.weights[-1]), _SLIGHT * (1.0 if self.names else self.threshold)
        edges = np.flatnonzero(np.diff(tested.alarm.astype(np.int8), prepend=0, append=0)).reshape(-1, 2).tolist()
        long = [(start, stop) for start, stop in edges if stop - start >= memory > 1]
        alone = [stop - start for start, stop in long if np.nanmax(tested.statistic[start:stop]) < slight]
        share = sum(alone) / max(1, int(tested.usable.sum()))
        if len(alone) < _OFTEN and share < _MUCH:
            return ()
        memory = round(1 / self.weights[-1])
        return (
            f"{counted(len(alone), 'alarm')} ({100 * share:.2g} % of the time) by means over about {memory} samples, "
            "none of them large: small differences that last, as of a small fault, or of a wander of the plant that is "
            "slower than the recordings of the fit; fit to longer ones, or to several, to tell these apart",
        )

    # --------------------------------------------------------------------------- files

    def check(self, watched: Watched) -> None:
        """Raise if a test from a file does not fit the watched generator."""
        n = watched.generator.n_residuals
        parts = watched.parts
        sizes = [n] if parts is None else [len(rows) for rows in parts.values()]
        k, scales, count = sum(sizes), len(self.weights), len(sizes)
        if self.sizes.tolist() != sizes or self.names != tuple(parts or ()):
            raise FileFormatError(f"fitted: sizes and names must be those of {count} parts of {n} residuals")
        shapes: dict[str, tuple[int, ...]] = {
            "center": (n,),
            "whitening": (n, k),
            "rewhitening": (k, k),
            "scaling": (scales, k, k),
            **dict.fromkeys(("clips", "fulls", "thresholds", "releases"), (count,)),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise FileFormatError(f"fitted.{name} must have the shape {shape}")
        if self.coefficients.ndim != 3 or self.coefficients.shape[1:] != (k, k):
            raise FileFormatError(f"fitted.coefficients must be matrices for {k} residuals")
        if self.knots.shape != (k, 0) or self.scores.size:
            raise FileFormatError("fitted: a bank of means has no scores")
        if not scales or self.weights[0] != 1 or not (np.diff(self.weights) < 0).all():
            raise FileFormatError("fitted.weights must fall from 1")
        if not ((self.releases >= 0) & (self.releases <= self.thresholds) & (self.thresholds < self.fulls)).all():
            raise FileFormatError("fitted: releases must not lie above thresholds, nor these above fulls")
        for part in self.columns:
            check_invertible(self.whitening[:, part], of_some=parts is not None)


@dataclass(frozen=True)
class MultiscaleEWMA(TestSettings):
    r"""Alarm where any of several exponentially weighted means of the residual is too long: the default test.

    .. math::

       s^{(i)}_k = (1 - \lambda_i) s^{(i)}_{k-1} + \lambda_i \hat e_k, \qquad
       J_k = \max_i \frac{1}{g_i} \Big| \Sigma_i^{-1/2} s^{(i)}_k \Big| > h

    with the whitened residual :math:`e`, less its prediction from the past if coloured. The mean of weight 1 is the
    sample itself and sees large faults at once; the longer ones see small faults that last. :math:`\hat e` is
    :math:`e`, clipped at a length that one sample in a thousand has, so that an outlier does not stay in the long
    means. An alarm is over when all of them are short again: at half the threshold, as normal scores.

    A fit takes the covariance :math:`\Sigma_i` of each mean from the data, so that a slow wander of fault-free
    residuals raises the bar of the long means alone, and simulates worlds of the fitted model, each fitted anew: these
    give the factors :math:`g_i`, which make scales alike, and the one threshold :math:`h` for all of them, with the
    errors of the fit in it. A fit to few rows turns the long means down and is not refused.

    Guaranteed: residuals that follow the fitted model are in alarm in the requested fraction of samples, on average
    over fits.

    Parameters
    ----------
    false_alarm_rate : float, optional
        Intended fraction of fault-free samples in alarm, unless ``fit`` gets another one. When omitted, one that the
        log of a fit can support; see :class:`residua.decide.NormThreshold`.
    weights : sequence of float
        :math:`\lambda_i`, falling from 1. A further 1/512 sees smaller faults, and its alarms outlive them by hundreds
        of samples.
    treatment : {"auto", "none"}
        Whether a fit makes a coloured residual white by an autoregression.
    source : {"auto", "data"}
        Whether the noise model of the plant gives a threshold before there is a fit, or fault-free data alone do.

    See Also
    --------
    residua.decide.CUSUM : Nearly the fastest for a change of one known size.
    residua.decide.NormThreshold : Single samples, or sums over one window.

    Notes
    -----
    Assumes: fault-free residuals are as in the data of the fit. A wander slower than the recording is not part of
    these: the notes of a fit and of a run say where they see one.

    References
    ----------
    Lowry, Woodall, Champ and Rigdon (1992), Technometrics 34(1), 46-53, for one weight; Han, Tsung, Hu and Wang (2007),
    Statistica Sinica 17, for several at once; Wilson and Hilferty (1931), PNAS 17(12), for the scores of lengths.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> monitor = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.MultiscaleEWMA())
    >>> rng = np.random.default_rng(0)
    >>> u, y = np.zeros((1000, 1)), 0.1 * rng.standard_normal((1000, 1))
    >>> y[500:] += 0.1  # one deviation
    >>> bool(monitor.run(u, y).alarms)
    True
    """

    kind: ClassVar[str] = "multiscale ewma"
    makes: ClassVar[type[ResidualTest]] = MultiscaleEWMATest
    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {"false_alarm_rate": PROBABILITY, "weights": PART}

    false_alarm_rate: float | None = None
    weights: tuple[float, ...] = (1.0, 1 / 8, 1 / 64)
    treatment: str = "auto"
    source: str = "auto"

    def __post_init__(self) -> None:
        """Check the settings."""
        check_rate(self.false_alarm_rate)
        rate = self.false_alarm_rate
        object.__setattr__(self, "false_alarm_rate", None if rate is None else float(rate))
        weights = tuple(self.weights) if isinstance(self.weights, (Sequence, np.ndarray)) else ()
        if not weights or not all(is_number(one) and 0 < one <= 1 for one in weights) or weights[0] != 1:
            raise SettingError(f"weights must be numbers that fall from 1, such as (1, 1/8), got {echo(self.weights)}")
        if any(one <= other for one, other in pairwise(weights)):
            raise SettingError(f"weights must fall from 1, got {echo(self.weights)}")
        object.__setattr__(self, "weights", tuple(float(one) for one in weights))
        if self.treatment not in ("auto", "none"):
            raise SettingError(f"treatment must be one of auto, none, got {echo(self.treatment)}")
        if self.source not in ("auto", "data"):
            raise SettingError(f"source must be one of auto, data, got {echo(self.source)}")

    # -------------------------------------------------------------------------- thresholds

    def from_model(self, watched: Watched) -> MultiscaleEWMATest | None:
        """Return the test by the noise model of the plant, as if that were exact."""
        generator, rows = watched.generator, rows_of_parts(watched)
        covariance = generator.covariance_of_sums(1)
        if covariance is None or self.source == "data":
            return None
        blocks = [covariance[np.ix_(one, one)] for one in rows]
        parts = side_by_side(
            [plain(np.zeros(len(one)), whitening_matrix(block)) for one, block in zip(rows, blocks, strict=True)],
            rows,
            generator.n_residuals,
        )
        W, scaling = parts["whitening"], []
        for weight in self.weights:
            sums = generator.covariance_of_sums(round(2 / weight - 1))  # as many samples as the mean is worth
            assert sums is not None  # as for one sample
            scaling.append(scaled(W.T @ sums @ W * variance_of(weight), columns_of(rows), weight))
        from scipy.special import ndtri  # slow to import, and needed only here

        moving = [moving_directions(block) for block in blocks]
        rate = rate_aimed_at(self.false_alarm_rate)
        score = float(-ndtri(rate / (_AS_MANY * len(rows))))
        basis = f"{one_in(rate)} samples in alarm where residuals are as the noise model of the plant says"
        return self._test(watched, parts, np.array(scaling), moving, score, basis)

    def fitted(self, watched: Watched, run: FaultFreeRun, rate: float) -> MultiscaleEWMATest:
        """Return the test fitted to fault-free data, for a rate of false alarms."""
        rows, count = rows_of_parts(watched), int(run.usable.sum())
        check_enough(count, run.residuals.shape[1], 1)
        fit = fit_means(self.weights, self.treatment, rows, run)
        worlds = simulated_worlds(fit.model)
        scaling = [
            scaled_anew(means_of(weight, [worlds.fitted], fit)[0], fit.columns, weight, worlds.shrink)
            for weight in self.weights
        ]
        means = [
            means_of(weight, [worlds.new], fit)[0][:, SETTLING:] @ M
            for weight, M in zip(self.weights, scaling, strict=True)
        ]
        factors = np.array(
            [factors_of(mean, fit, weight, rate) for weight, mean in zip(self.weights, means, strict=True)]
        )
        levels = levels_of(scores_of([mean / g for mean, g in zip(means, factors, strict=True)], fit), FALLS_TO)
        score = float(np.quantile(levels, 1 - rate))
        data = held_out_levels(self.weights, self.treatment, rows, run, factors)
        few, more, _ = allowance(data, levels, rate, count)
        basis = "; ".join(
            [f"{one_in(rate)} samples in alarm, simulated for a fit to {count} fault-free samples", *fit.notes]
        )
        if more > 1:
            basis += f"; raised by {number(100 * (more - 1), 2)} % for effects that the noise model does not have"
        made = self._test(watched, fit.parts, fit.scaling / factors[:, None], fit.moving, few * more * score, basis)
        return replace(made, promised=float(rate))

    @property
    def remedy(self) -> str:
        """Remedy for a missing threshold."""
        return super().remedy if self.source == "data" else f"{super().remedy}, or give the plant noise (with_noise)"

    def _test(
        self,
        watched: Watched,
        parts: Mapping[str, Any],
        scaling: NDArray[np.float64],
        moving: Sequence[int],
        score: float,
        basis: str,
    ) -> MultiscaleEWMATest:
        """Build the test, with a threshold on the normal score of the longest mean."""
        names, rows = tuple(watched.parts or ()), rows_of_parts(watched)
        thresholds, releases = (lengths_at(value, moving) for value in (score, FALLS_TO * score))
        return MultiscaleEWMATest(
            **parts,
            threshold=1.0 if names else float(thresholds[0]),
            release=0.0 if names else float(releases[0]),
            basis=basis,
            weights=np.array(self.weights),
            scaling=scaling,
            sizes=np.array([len(one) for one in rows], dtype=np.int64),
            clips=lengths_at(CLIP, moving),
            fulls=lengths_at(max(_FULL, 2 * score), moving),
            thresholds=thresholds,
            releases=releases,
            names=names,
        )


__all__ = ["MultiscaleEWMA", "MultiscaleEWMATest"]
