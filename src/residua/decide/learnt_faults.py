"""Faults learnt from recordings, by a direction with its cone or by a code, named beside those of the model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.alarm import CLOSE_MARGIN, Alarm, LearntMatch
from residua.decide.dependence import correlation_times
from residua.decide.isolation import Isolation, Named, Scores, Seen, by_cosine
from residua.decide.member_bounds import MemberBounds
from residua.decide.row_norms import row_norms
from residua.decide.statement import (
    POOR_SCORE,
    Statement,
    statement_by_score,
    statement_by_word,
    too_short,
    word_by_score,
)
from residua.decide.structured import CodeTest
from residua.decide.test import Block, ResidualTest, Tested
from residua.decide.whitened_norm import BAND_SHARE, whitened_residuals
from residua.decide.window import WindowState, empty_window, moving_sum
from residua.decide.word import ANYTHING, EITHER, GOOD, POOR, TOO_EARLY, Word
from residua.errors import DataError
from residua.linear.systems.recursion import ordered_product
from residua.number_kinds import COUNT, PART, POSITIVE, NumberKind
from residua.recording.clock import Clock
from residua.records import Record
from residua.words import counted, listing

#: Share of the cones that hold the direction, and of the windows of a learnt fault that are taken for it.
CONE_SHARE, WINDOW_SHARE = 0.95, 0.99
#: Half-angle in degrees from which on a cone says nothing: a line lies within 90 degrees of any other.
WIDEST = 60.0
#: Degrees of freedom from which on the spread between recordings is judged by the F distribution.
_LEAST_FREEDOM = 3
#: From this score on a fault of the model is believed where no learnt one agrees.
_BELIEVED = 0.70
#: How far off its direction a residual may be at most, in degrees, however noisy it is: as for any signature.
FARTHEST = math.degrees(math.acos(_BELIEVED))
#: A cone and noise that are wider, in degrees, leave room for a fault that is not listed.
_WIDE = math.degrees(math.acos(POOR_SCORE))
#: States the data of each learnt fault.
_MEANING = (
    "The score is the cosine of the angle between the residual and a signature, over the monitor's window. A learnt "
    "fault is named where the residual is no further off its direction than the cone of the direction and the noise of "
    "the window account for (99 % of the windows of that fault). Good match: it alone is named, and these account for "
    "no more than 26°."
)


@dataclass(frozen=True, eq=False)
class LearntFault(Record):
    """A fault as shown by recordings of it.

    Attributes
    ----------
    name : str
    recordings : int
        Occurrences that it is from.
    samples : int
        Of the residual, while the fault was there.
    independent : float
        Independent samples that these are worth.
    shift : ndarray, shape (k,)
        Mean of the residual less its fault-free mean, in units of the residuals; of several recordings the mean of
        these, with their signs turned to agree. No entries where the fault is known by its code.
    error : ndarray, shape (k, k)
        Covariance of ``shift`` by the scatter of the residual.
    noise : ndarray, shape (k, k)
        Covariance of the mean of the residual over one window while the fault is there.
    between : ndarray, shape (k, k)
        Covariance of the shifts of single recordings, brought to the same size; zero for one recording.
    cone : float
        Half-angle in degrees of the cone that holds the direction with 95 % confidence; 0 for a code.
    code : ndarray of bool, shape (members,)
        Which members of a bank it fires; no entries where it is known by its direction.
    share : float
        Part of the samples, in alarm, in which just these members counted as fired; of a direction 1.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "recordings": COUNT,
        "samples": COUNT,
        "independent": POSITIVE,
        "share": PART,
    }

    name: str
    recordings: int
    samples: int
    independent: float
    shift: NDArray[np.float64]
    error: NDArray[np.float64]
    noise: NDArray[np.float64]
    between: NDArray[np.float64]
    cone: float
    code: NDArray[np.bool_]
    share: float = 1.0

    @property
    def by_code(self) -> bool:
        """True if the fault is known by its code."""
        return bool(self.code.size)

    @property
    def basis(self) -> str:
        """Description of the data from which it was learnt."""
        text = f"{counted(self.recordings, 'recording')}, {self.samples} samples"
        if self.by_code:
            return f"{text}, its code in {100 * self.share:.0f} % of them"
        return f"{text} worth {self.independent:.3g} independent ones, cone of {self.cone:.2g}°"


@dataclass(frozen=True, eq=False)
class _Occurrence:
    """One recording of a fault, in whitened units: its mean, and the covariances of that and of a window's mean."""

    mean: NDArray[np.float64]
    error: NDArray[np.float64]
    noise: NDArray[np.float64]
    samples: int
    independent: float


def learnt_direction(
    name: str, rows: Sequence[NDArray[np.float64]], space: NDArray[np.float64], window: int
) -> LearntFault:
    r"""Return the direction of a fault from residuals during it, in one recording or several.

    .. math::

       \hat s = \bar q, \qquad \operatorname{cov} \hat s = \frac{1}{N} \sum_i \lambda_i \tau_i v_i v_i^T,
       \qquad \tan \alpha = \frac{\varrho_{95}(\operatorname{cov} \hat s_\perp)}{\|s\|}

    with eigenvalues :math:`\lambda_i`, 1 or more, and vectors :math:`v_i` of the covariance of the whitened residual,
    and the correlation time :math:`\tau_i` of each component. Of several recordings, the larger of this and of
    the spread of their own directions about their mean.

    Parameters
    ----------
    name : str
    rows : sequence of ndarray, shape (time, k)
        Residuals less their fault-free mean.
    space : ndarray, shape (k, k)
        Their whitening, applied as ``rows @ space``: fault-free they have the covariance 1 there.
    window : int
        Samples that a name is judged over.

    Raises
    ------
    DataError
        If a recording cannot be distinguished from fault-free data, or the cone is wider than 60 degrees.

    References
    ----------
    Mardia and Jupp (2000), Directional statistics, section 10.4 (cones of axes); Welch (1947) and Satterthwaite (1946)
    for the distribution of sums of squares; Sokal (1997), section 3, for the correlation time.
    """
    seen = [_occurrence(name, one @ space, window, k, len(rows)) for k, one in enumerate(rows, 1)]
    signs = [1.0 if one.mean @ seen[0].mean >= 0 else -1.0 for one in seen]
    mean = np.mean([sign * one.mean for sign, one in zip(signs, seen, strict=True)], axis=0)
    error = np.sum([one.error for one in seen], axis=0) / len(seen) ** 2
    noise = np.mean([one.noise for one in seen], axis=0)
    samples, independent = sum(one.samples for one in seen), sum(one.independent for one in seen)
    size = float(np.linalg.norm(mean))
    # the covariance of single shifts about their mean, each scaled to its size
    along = [(one.mean, float(one.mean @ mean)) for one in seen]
    away = [shift * size**2 / product - mean for shift, product in along if product != 0.0 and len(seen) > 1]
    between = np.zeros_like(space) + sum(np.outer(one, one) for one in away) / max(len(seen) - 1, 1)
    cone = 90.0
    if size > 0:
        sideways = across(mean / size, error)
        occurrence = occurrence_square(between, len(seen), CONE_SHARE, new=False)
        radius = max(square_at(sideways, CONE_SHARE, independent), occurrence)
        length = size**2 - float(np.trace(sideways))  # errors lengthen the measured shift
        cone = math.degrees(math.atan2(math.sqrt(radius), math.sqrt(max(length, 0.0))))
    if not cone <= WIDEST:
        raise DataError(
            f"the direction of {name!r} is known to {cone:.0f}° only (95 % confidence), no more than {WIDEST:g}° is "
            f"taken: {samples} samples are worth {independent:.3g} independent ones. Give a longer recording, a larger "
            "fault, or several recordings"
        )
    back = np.linalg.inv(space)
    error, noise, between = (back.T @ M @ back for M in (error, noise, between))
    no_code = np.zeros(0, dtype=bool)
    return LearntFault(name, len(seen), samples, independent, mean @ back, error, noise, between, cone, no_code)


def _occurrence(name: str, q: NDArray[np.float64], window: int, number: int, of: int) -> _Occurrence:
    """Return the mean of one recording with its covariance, or raise if it shows no fault."""
    from scipy.special import fdtrc  # slow to import, and needed only here

    which = f"recording {number} of {of}" if of > 1 else "the recording"
    count, k = q.shape
    if count < 2:
        raise DataError(f"{which} of {name!r} has {counted(count, 'usable sample')} in the interval of the fault")
    mean = q.mean(axis=0)
    away = q - mean
    if not np.any(mean):
        raise DataError(f"{which} of {name!r} shows no fault: the mean of its residuals is the fault-free one")
    # Variation of a fault along its own direction is not an error of the direction.
    direction = mean / np.linalg.norm(mean)
    values, vectors = np.linalg.eigh(across(direction, away.T @ away / (count - 1)))
    vectors[:, 0] = direction  # at right angles to all others, where nothing is left
    vectors = np.linalg.qr(vectors)[0]
    values = np.maximum(np.sum((away @ vectors) ** 2, axis=0) / (count - 1), 1.0)  # less than without a fault is chance
    times = _times(away @ vectors)
    lasting = values * times
    error, noise = (
        (vectors * weights) @ vectors.T for weights in (lasting / count, np.minimum(lasting / window, values))
    )
    sideways = slice(1, None) if k > 1 else slice(None)
    independent = float(count * values[sideways].sum() / lasting[sideways].sum())
    square = float(np.sum((vectors.T @ mean) ** 2 * count / times))
    chance = float(fdtrc(k, max(count / times.mean() - 1, 1.0) * k, square / k))
    if not chance < 1 - BAND_SHARE:
        raise DataError(
            f"{which} of {name!r} shows no fault: the mean of its residuals over {count} samples (worth "
            f"{independent:.3g} independent ones) is as far from the fault-free mean as chance takes it with a "
            f"probability of {chance:.2g}; give the interval of the fault, or a recording with a larger one"
        )
    return _Occurrence(mean, error, noise, count, independent)


def _times(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    r"""Return the correlation times of columns less their own means.

    That lowers each correlation by :math:`\tau / N`, and the sum over ``L`` lags by :math:`2 L \tau / N`, with ``L`` of
    five times :math:`\tau`, and a quarter of the samples at most.
    """
    count = len(columns)
    times = correlation_times(columns, [slice(0, count)])
    lost = 2 * np.minimum(5 * times, count / 4) / count
    return np.minimum(np.where(times > 1, times / (1 - lost), times), float(count))


def across(direction: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of a covariance that is at right angles to a direction of length 1."""
    P = np.eye(len(direction)) - np.outer(direction, direction)
    return P @ covariance @ P


def square_at(covariance: NDArray[np.float64], share: float, independent: float = math.inf) -> float:
    """Return a quantile of the squared length of a Gaussian vector, by its first two moments.

    ``independent`` is the number of independent samples that the covariance is from.
    """
    from scipy.special import chdtri, fdtri  # slow to import, and needed only here

    total, squares = float(np.trace(covariance)), float(np.sum(covariance**2))
    if not total > 0 or not squares > 0:
        return 0.0
    dimensions = total**2 / squares
    if not math.isfinite(independent):
        return total / dimensions * float(chdtri(dimensions, 1 - share))
    freedom = max(2.0, dimensions * (independent - 1))
    return total * float(fdtri(dimensions, freedom, share))


def occurrence_square(between: NDArray[np.float64], recordings: int, share: float, new: bool) -> float:
    """Return a quantile for the mean of occurrences, or for a new one, by the spread between those seen.

    It is taken to be the same in all ``k - 1`` directions across; where so few were seen that its own error has fewer
    than three degrees of freedom, that error is left out.
    """
    from scipy.special import chdtri, fdtri  # slow to import, and needed only here

    across_dimensions = len(between) - 1
    if recordings < 2 or across_dimensions < 1:
        return 0.0
    variance = float(np.trace(between)) / across_dimensions * (1 / recordings + (1.0 if new else 0.0))
    freedom = (recordings - 1) * across_dimensions
    if freedom < _LEAST_FREEDOM:
        return variance * float(chdtri(across_dimensions, 1 - share))
    return variance * across_dimensions * float(fdtri(across_dimensions, freedom, share))


def angle_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the angle in degrees between a line and the line or plane of a basis; 90 where one is zero."""
    size = float(np.linalg.norm(a))
    if not size > 0 or not b.size:
        return 90.0
    inside = b.reshape(len(a), -1) @ (b.reshape(len(a), -1).T @ a)
    return math.degrees(math.atan2(float(np.linalg.norm(a - inside)), float(np.linalg.norm(inside))))


def learnt_code(
    name: str, patterns: Sequence[tuple[NDArray[np.bool_], float]], samples: int, members: Sequence[str]
) -> LearntFault:
    """Return the code of a fault from the pattern of each recording and the share of its samples in which it stood.

    Raises
    ------
    DataError
        If no member fired, or not the same ones in all recordings.
    """
    texts = [" and ".join(m for m, on in zip(members, code, strict=True) if on) for code, _ in patterns]
    if not all(texts):
        raise DataError(f"no member of the bank fires in the interval of {name!r}: it shows no fault")
    if len(set(texts)) > 1:
        raise DataError(
            f"the recordings of {name!r} fire different members ({'; '.join(dict.fromkeys(texts))}): to this bank they "
            "are different faults, learn each under a name of its own"
        )
    code, none = patterns[0][0], np.zeros((0, 0))
    share = float(np.mean([share for _, share in patterns]))
    return LearntFault(
        name, len(patterns), samples, float(samples), np.zeros(0), none, none, none, 0.0, code.copy(), share
    )


# ---------------------------------------------------------------------------- isolation


@dataclass(frozen=True, eq=False)
class LearntState:
    """State of an isolation with learnt faults.

    Attributes
    ----------
    base : object
        Of the isolation that names the faults of the model.
    window : WindowState
        Of the sum of the residual.
    """

    base: Any
    window: WindowState


@dataclass(frozen=True, eq=False)
class LearntDirections(Isolation):
    """Fitted isolation by directions learnt from recordings, beside the faults of the model.

    Attributes
    ----------
    base : Isolation
        Isolation of the faults of the model.
    faults : tuple of LearntFault
    center : ndarray, shape (k,)
        Fault-free mean of the residual.
    space : ndarray, shape (k, k)
        Whitening in which learnt directions are judged.
    metric : ndarray, shape (k, K)
        That of the test, in which pages draw directions.
    window : int
    """

    base: Isolation
    faults: tuple[LearntFault, ...]
    center: NDArray[np.float64]
    space: NDArray[np.float64]
    metric: NDArray[np.float64]
    window: int

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Groups of the model, then the learnt faults."""
        return (*self.base.groups, *((label,) for label in self.labels))

    @property
    def unjudged(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Faults of the model that are not judged."""
        return self.base.unjudged

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the learnt faults, marked if the model has the same name."""
        modelled = {name for group in self.base.groups for name in group} | set(self.base.unjudged)
        return tuple(learnt_label(fault.name, modelled) for fault in self.faults)

    @cached_property
    def _shifts(self) -> NDArray[np.float64]:
        """The learnt shifts in the whitened space, shape (faults, k)."""
        return ordered_product(np.array([[fault.shift for fault in self.faults]]), self.space)[0]

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """The learnt directions in the whitened space, as columns of length 1."""
        return (self._shifts / row_norms(self._shifts)[:, None]).T

    @cached_property
    def _squares(self) -> list[tuple[float, float]]:
        """For each fault the squares, across its direction, of the noise of a window and of the error of the shift."""
        out = []
        for line, fault in zip(self.directions.T, self.faults, strict=True):
            noise, error, between = (
                across(line, self.space.T @ M @ self.space) for M in (fault.noise, fault.error, fault.between)
            )
            occurrence = occurrence_square(between, fault.recordings, WINDOW_SHARE, new=True)
            error = max(square_at(error, WINDOW_SHARE, fault.independent), occurrence)
            out.append((square_at(noise, WINDOW_SHARE), error))
        return out

    # ------------------------------------------------------------------------ running

    def start(self, plants: int) -> LearntState:
        """Return the state before the first sample."""
        return LearntState(self.base.start(plants), empty_window(plants, self.window, self.space.shape[1]))

    def run(self, state: LearntState, block: Block, tested: Tested) -> tuple[LearntState, Scores]:
        """Return the scores of the model's faults, and the correlation of the residual with each learnt direction."""
        base, scores = self.base.run(state.base, block, tested)
        q, usable = whitened_residuals(self.center, self.space, block)
        usable = usable & tested.usable
        sums, window = moving_sum(q, state.window, usable)
        size = row_norms(sums)
        usable = usable & (size > 0)
        size = np.where(usable, size, np.nan)
        cosines = np.minimum(np.abs(ordered_product(sums, self.directions)) / size[..., None], 1.0)
        joint = np.concatenate([scores.scores, cosines], axis=2)
        return LearntState(base, window), replace(scores, scores=joint, size=size / self.window)

    def _matches(self, scores: NDArray[np.float64], length: float) -> tuple[LearntMatch, ...]:
        """Return the angle of a window's mean of this length to each learnt direction, and the allowed angle."""
        if not (math.isfinite(length) and length > 0):
            return ()
        out, cosines = [], scores[len(self.base.groups) :].tolist()
        sizes = zip(self.labels, cosines, row_norms(self._shifts).tolist(), self._squares, strict=True)
        for label, cosine, size, (noise, error) in sizes:
            if not math.isfinite(cosine):
                continue
            ratio = (length * cosine / size) ** 2
            allowed = math.sqrt(max(1.0, ratio) * noise + ratio * error) / length
            degrees = min(math.degrees(math.asin(min(1.0, allowed))), FARTHEST)
            out.append(LearntMatch(label, cosine, math.degrees(math.acos(cosine)), degrees))
        return tuple(out)

    def _of_base(self, seen: Seen) -> Seen:
        """Return the data for the isolation of the model's faults."""
        scores = replace(seen.scores, scores=seen.scores.scores[..., : len(self.base.groups)])
        return replace(seen, scores=scores, state=None if seen.state is None else seen.state.base)

    def _with_learnt(self, named: Named, seen: Seen, at: int) -> Named:
        """Return an attribution with the learnt faults; without a name if nothing explains the residual.

        A predicted direction has no cone: it is accepted if it explains the residual well, and no learnt fault
        that is excluded explains more. A learnt fault goes before one of the model that it cannot be told from here.
        """
        assert seen.scores.size is not None
        matches = self._matches(seen.scores.scores[at], float(seen.scores.size[at]))
        if not matches:
            return named
        agree = {m.fault: m for m in matches if m.agrees}
        learnt = [by_cosine((m.fault,), m.score) for m in agree.values()]
        ranked = sorted((*named.candidates, *learnt), key=lambda c: -round(c.score, 3) if c.score == c.score else 1.0)
        first = next((c for c in ranked if c.faults[0] in agree), None)
        if first is not None and ranked[0] is not first:
            angles = dict(self.angles(self.labels.index(first.faults[0])))
            if angles.get(ranked[0].name, 90.0) <= agree[first.faults[0]].allowed:
                ranked = [first, *(c for c in ranked if c is not first)]
        believed = False
        if ranked:
            best, excluded = ranked[0], max((m.score for m in matches if not m.agrees), default=0.0)
            explains_most = best.score >= _BELIEVED and best.score > excluded - CLOSE_MARGIN
            believed = best.faults[0] in agree or explains_most
        return replace(named, candidates=tuple(ranked) if believed else (), learnt=matches)

    def name(self, seen: Seen, start: int, stop: int, last: int) -> Named:
        """Return the attribution of an alarm of a recording."""
        return self._with_learnt(self.base.name(self._of_base(seen), start, stop, last), seen, last)

    def name_now(self, seen: Seen) -> Named:
        """Return the attribution of the standing alarm."""
        return self._with_learnt(self.base.name_now(self._of_base(seen)), seen, 0)

    # ----------------------------------------------- interface to the rest of a monitor

    @property
    def samples(self) -> int:
        """Number of samples from which a name is judged."""
        return self.window

    @property
    def signatures(self) -> tuple[NDArray[np.float64], ...]:
        """Bases of the model's faults, then the learnt directions."""
        lines = [self.metric.T @ fault.shift for fault in self.faults]
        return (*self.base.signatures, *((line / np.linalg.norm(line))[:, None] for line in lines))

    @property
    def learnt(self) -> tuple[LearntFault, ...]:
        """The learnt faults."""
        return self.faults

    def angles(self, j: int) -> tuple[tuple[str, float], ...]:
        """Return the angles in degrees of a learnt direction to all other groups, the nearest first."""
        line = self.metric.T @ self.faults[j].shift
        out = [
            (" or ".join(group), angle_between(line, basis))
            for group, basis in zip(self.base.groups, self.base.signatures, strict=False)
        ]
        for i, label in enumerate(self.labels):
            if i != j:
                out.append((label, angle_between(self.directions[:, j], self.directions[:, i])))
        return tuple(sorted(out, key=lambda pair: pair[1]))

    def notes(self) -> tuple[str, ...]:
        """Return the learnt faults that cannot be distinguished from another fault, by angle."""
        place = {label: k for k, label in enumerate(self.labels)}
        out = list(self.base.notes())
        if len(self.space) == 1 and len(self.groups) == 1:
            out.append(f"there is one residual, which has one direction: every alarm is attributed to {self.labels[0]}")
        for j, fault in enumerate(self.faults):
            for other, angle in self.angles(j):
                i = place.get(other)
                cone = fault.cone if i is None else max(fault.cone, self.faults[i].cone)
                if angle <= cone and (i is None or i > j):
                    out.append(
                        f"{self.labels[j]} and {other} have directions too close to distinguish: {angle:.2g}° between "
                        f"them, a cone of {cone:.2g}°"
                    )
        return tuple(out)

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        words = self.base.words(step)
        learnt = f"directions of {counted(len(self.faults), 'learnt fault')} over {self.window} samples"
        names = f"{words['isolation']}; {learnt}" if words.get("isolation") else learnt
        faults = "; ".join(f"{label}: {f.basis}" for label, f in zip(self.labels, self.faults, strict=True))
        return words | {"isolation": names, "learnt faults": faults}

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about an alarm: the name, the data it was learnt from, and the faults it excludes."""
        if not alarm.learnt:
            return self.base.statement(alarm, clock, window)
        word, nearest = self.word(alarm, window), min(alarm.learnt, key=lambda m: m.angle)
        if word is not None and not alarm.candidates:
            sentences = tuple(f"{m.fault}: {m.text}." for m in sorted(alarm.learnt, key=lambda m: m.angle))
            statement = statement_by_word(alarm, word, clock, sentences, _MEANING)
            return replace(statement, lines=(f"{word.line}; nearest is {nearest.fault}, {nearest.text}",))
        statement = statement_by_score(
            alarm, clock, word, lambda score: f"{math.degrees(math.acos(score)):.2g}°", _MEANING
        )
        if not any(m.agrees for m in alarm.learnt):
            line = f"{_none_of(alarm)}: nearest is {nearest.fault}, {nearest.text}"
            return replace(
                statement, sentences=(*statement.sentences, f"It is {line}."), lines=(*statement.lines, line)
            )
        basis = dict(zip(self.labels, self.faults, strict=True))
        about = [m for m in alarm.learnt if m.fault in alarm.candidates[0].faults]
        lines = [f"learnt from {basis[m.fault].basis}; {m.text}" for m in about]
        sentences = [f"{m.fault} was {line}." for m, line in zip(about, lines, strict=True)]
        if about and basis[about[0].fault].recordings == 1:
            unknown = "How much one occurrence of it differs from another is not known: one recording shows none."
            sentences.append(unknown)
        best = max(alarm.candidates, key=lambda c: c.score if c.score == c.score else -1.0)
        if about and round(best.score, 3) > round(alarm.candidates[0].score, 3):
            why = f"goes before {best.name}, of a higher score, from which it cannot be distinguished here"
            lines.append(why)
            sentences.append(f"{about[0].fault} {why}.")
        return replace(statement, sentences=(*statement.sentences, *sentences), lines=(*statement.lines, *lines))

    def word(self, alarm: Alarm, window: int) -> Word | None:
        """Return the word if one learnt fault alone explains an alarm; else from the base, or by score."""
        if not alarm.learnt:
            return self.base.word(alarm, window)
        if not alarm.candidates:
            word = Word(POOR, (), why=f"an unknown fault, {_none_of(alarm)}", after=alarm.samples)
            return word if alarm.samples >= window else replace(word, kind=TOO_EARLY, why=too_short(window))
        word = word_by_score(alarm, window)
        best, *others = alarm.candidates
        agree = {m.fault: m for m in alarm.learnt if m.agrees}
        if word is None or word.kind == TOO_EARLY or best.faults[0] not in agree:
            return word
        close = [c.faults for c in others if c.faults[0] in agree or c.score > best.score - CLOSE_MARGIN]
        wide = len(self.space) == 1 or agree[best.faults[0]].allowed > _WIDE
        if close or wide:
            return replace(word, kind=EITHER, faults=(best.faults, *close), unlisted=ANYTHING if wide else "", why="")
        return replace(word, kind=GOOD, faults=(best.faults,), unlisted="", why="by its learnt direction")

    def same_event(self, before: Alarm, alarm: Alarm) -> bool:
        """Tell whether an alarm that soon follows another is about the same event."""
        return self.base.same_event(before, alarm)

    def cautions(self, bounds: Mapping[str, MemberBounds], alarms: Sequence[Alarm], seen: Seen) -> tuple[str, ...]:
        """Return cautions about a name."""
        return self.base.cautions(bounds, alarms, seen)

    def check_state(self, state: LearntState, count: int) -> None:
        """Raise if a state from a file is invalid."""
        self.base.check_state(state.base, count)
        state.window.check("state.isolation.window")


@dataclass(frozen=True, eq=False)
class LearntCodes(CodeTest):
    """Fitted codes of a bank, with those of learnt faults.

    Attributes
    ----------
    faults : tuple of LearntFault
        Their columns are in ``codes``, as those of any other fault.
    """

    faults: tuple[LearntFault, ...] = ()

    @property
    def learnt(self) -> tuple[LearntFault, ...]:
        """The learnt faults."""
        return self.faults

    def words(self, step: float) -> dict[str, str]:
        """Describe the naming of faults."""
        return super().words(step) | {"learnt faults": "; ".join(f"{f.name}: {f.basis}" for f in self.faults)}


def _none_of(alarm: Alarm) -> str:
    return f"none of {counted(len(alarm.learnt), 'learnt fault')}" if len(alarm.learnt) > 1 else "not the learnt fault"


def learnt_label(name: str, modelled: set[str]) -> str:
    """Return the label of a learnt fault, marked if the model has a fault of that name."""
    return f"{name} (learnt)" if name in modelled else name


def with_learnt(
    base: Isolation,
    faults: Sequence[LearntFault],
    test: ResidualTest,
    space: Callable[[], NDArray[np.float64]],
    window: int,
) -> Isolation:
    """Return an isolation that also names learnt faults; a learnt code equal to another one joins its group.

    Raises
    ------
    DataError
        If the code of a fault is that of several others at once.
    """
    if not faults:
        return base
    if not isinstance(base, CodeTest):
        return LearntDirections(base, tuple(faults), test.center, space(), test.metric, window)
    modelled = {name for group in base.groups for name in group} | set(base.unjudged)
    groups, codes = [list(group) for group in base.groups], [base.codes[:, g] for g in range(len(base.groups))]
    settled = list(base.settled)
    for fault in faults:
        label = learnt_label(fault.name, modelled)
        if base.dedicated and fault.code.sum() > 1:
            fired = listing(m for m, on in zip(base.members, fault.code, strict=True) if on)
            raise DataError(
                f"{fault.name!r} fires {fired}, and each of these members names a fault of its own: by its code it is "
                "those faults at once. Learn it with a monitor that names by direction, isolate=Directional()"
            )
        same = next((g for g, code in enumerate(codes) if np.array_equal(code, fault.code)), None)
        if same is None:
            groups.append([label])
            codes.append(fault.code)
            settled.append(())
        else:
            groups[same].append(label)
    return LearntCodes(
        base.window,
        base.share,
        base.distance,
        base.members,
        tuple(tuple(group) for group in groups),
        np.array(codes, dtype=bool).T.reshape(len(base.members), len(codes)),
        base.unjudged,
        tuple(settled),
        base.at_once,
        tuple(faults),
    )
