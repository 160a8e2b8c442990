"""Stationarity of fault-free residuals: steps and drifts of their means, and of the norm of all together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from residua.decide.dependence import correlation_times
from residua.decide.fault_free import FaultFree
from residua.decide.test import FaultFreeRun
from residua.decide.whitening import whitening_matrix
from residua.number_kinds import COUNT, ENTRY, NumberKind
from residua.records import Record
from residua.tolerances import SIGNAL_ROUNDING
from residua.words import some

#: How sure a change is, for all residuals of a recording together.
CONFIDENCE = 0.999
#: Smallest change that is reported, in standard deviations of the residual.
NOTABLE = 0.5
#: Means over stretches of time that a recording is looked at by, at most.
_STRETCHES = 1000
#: Fewest usable samples of a recording that say anything.
_LEAST = 60
#: Fewest independent samples of a recording that say anything: in fewer, slow noise and drifts are the same.
_INDEPENDENT = 12.0
#: Samples to a residual with which moments of all samples are as good as those of others: of correlation times to 100.
_PLENTY = 2000
#: The norm counts as at least that part of its root mean square: the logarithm of one near zero says nothing.
_SMALLEST = 0.1
#: Deviations of a large step, of a change that takes its time, and of a drift from start to end.
_FAR_STEP, _FAR_CHANGE, _FAR_DRIFT = 3.0, 6.0, 10.0
#: Share of a step that happens at once: within this part of the samples, or so many.
_SHARP, _AT_ONCE, _FEW_AT_ONCE = 0.6, 0.02, 10
#: Parts of a recording at its start and end where a change may be the plant starting, or chance.
_START, _END = 0.2, 0.1
#: Residuals that a sentence lists.
_LISTED = 5


@dataclass(frozen=True)
class Change(Record):
    """A place at which fault-free residuals change.

    Attributes
    ----------
    residuals : tuple of str
        Whose means change, the largest change first; empty for the norm of all residuals together.
    recording : int
        Number of the recording, from 1.
    sample : int
        Of that recording, about.
    size : float
        Largest change of a mean in standard deviations of that residual; of the norm the factor.
    samples : int
        Of that recording.
    is_step : bool
        Whether most of a change of means happens within 2 % of the samples, and no other half as large does before or
        after.
    drift : float
        Change of that residual from the start of the recording to its end along the line that fits it best, in
        standard deviations of the rest.
    """

    NUMBER_KINDS: ClassVar[Mapping[str, NumberKind]] = {
        "recording": COUNT,
        "samples": COUNT,
        "size": ENTRY,
        "drift": ENTRY,
    }

    residuals: tuple[str, ...]
    recording: int
    sample: int
    size: float
    samples: int
    is_step: bool = False
    drift: float = 0.0

    def large(self, several: bool) -> str:
        """Describe a large change; empty for others; ``several``: whether there are several recordings.

        A drift of ten standard deviations from start to end; a step of three, at once, or a change of six in any time,
        unless that is in the first fifth, where the plant may be starting, or in the last tenth.
        """
        if not self.residuals:
            return ""
        name, of = repr(self.residuals[0]), f" of recording {self.recording}" if several else ""
        if abs(self.drift) >= _FAR_DRIFT:
            return f"{name} drifts by {abs(self.drift):.2g} standard deviations from the start{of} to its end"
        if not _START * self.samples <= self.sample <= (1 - _END) * self.samples:
            return ""
        if abs(self.size) < (_FAR_STEP if self.is_step else _FAR_CHANGE):
            return ""
        return (
            f"the mean of {name} {'steps' if self.is_step else 'changes'} by {abs(self.size):.2g} standard deviations "
            f"{'at' if self.is_step else 'about'} sample {self.sample:,} of {self.samples:,}{of}"
        )

    @property
    def is_transient(self) -> bool:
        """True if all residuals together shrink in the first half of the recording."""
        return not self.residuals and self.size < 1 and 2 * self.sample <= self.samples

    def sentence(self, several: bool) -> str:
        """Return the change as a sentence; ``several``: whether there are several recordings."""
        where = f" of recording {self.recording}" if several else ""
        if self.is_transient:
            return (
                f"the first {self.sample} fault-free samples{where} are not like the rest: the norm of the residuals, "
                f"whitened, is {1 / self.size:.2g} times as large there. If the plant was starting, leave them out "
                "(transient='auto'), and begin to judge as late; if not, it is part of what is normal"
            )
        if not self.residuals:
            return (
                f"the norm of the residuals, whitened, changes to {self.size:.2g} times what it was about sample "
                f"{self.sample}{where} of the fault-free data: {_REMEDY}"
            )
        verb = "changes its mean" if len(self.residuals) == 1 else "change their means"
        return (
            f"{some(self.residuals, _LISTED)} {verb} by up to {abs(self.size):.2g} standard deviations about sample "
            f"{self.sample}{where} of the fault-free data: {_REMEDY}"
        )


_REMEDY = (
    "a step or a drift there (load, set point, temperature, or a fault) counts as normal now; leave that part out, or "
    "fit to recordings that have it more than once"
)


def changes(run: FaultFreeRun, names: Sequence[str]) -> tuple[Change, ...]:
    r"""Return the changes of fault-free residuals, each recording by itself.

    Of every residual, and of the logarithm of the norm of all of them, whitened by moments of the rest of the data,

    .. math:: T = \max_k \frac{|\sum_{i \le k} (x_i - \bar x)|}{\sigma \sqrt{n \tau}},
       \qquad P(T > c) = 2 \sum_{j \ge 1} (-1)^{j + 1} e^{-2 j^2 c^2}

    with spread and correlation time of what is left after a line on each side of the likeliest place. A change is
    reported where that is less likely than 0.1 % without one for all residuals together, and half a standard deviation
    or more. Of a recording that is worth fewer than twelve independent samples nothing is; slow noise, of which some
    twenty correlation times fit into it, is taken for a change in up to 5 % of cases.

    Parameters
    ----------
    run : FaultFreeRun
    names : sequence of str
        Of the residuals.

    References
    ----------
    Brown, Durbin and Evans (1975), Journal of the Royal Statistical Society B 37(2), 149-192; Ploberger and Kraemer
    (1992), Econometrica 60(2), 271-285 (cumulative sums and the Brownian bridge).
    """
    whole = FaultFree(run.residuals, run.usable, 1, run.seams)
    size = int(run.usable.sum())
    if size < _LEAST or whole.spread <= SIGNAL_ROUNDING * run.signal_size():
        return ()
    norm = _norm(whole, size)
    found = []
    for number, part in enumerate(whole.parts, 1):
        rows = part.start + np.flatnonzero(run.usable[part])
        if len(rows) < _LEAST:
            continue
        level = np.log(np.maximum(norm[rows], _SMALLEST * np.sqrt(np.mean(norm[rows] ** 2))))
        limit = (1 - CONFIDENCE) / len(whole.parts)
        length = part.stop - part.start
        place = likeliest_change(level, limit)
        if place is not None:
            at, _ = place
            factor = float(np.exp(level[at:].mean() - level[:at].mean()))
            found.append(Change((), number, int(rows[at]) - part.start, factor, length))
        means = _of_means(run.residuals[rows], rows - part.start, names, number, limit, length)
        if means and found and found[-1].recording == number and not found[-1].is_transient:
            found.pop()  # the same in other words
        found += means
    return tuple(found)


def _norm(whole: FaultFree, samples: int) -> NDArray[np.float64]:
    """Return the norm of the whitened residual; cross-fitted if there are few samples."""
    if samples < _PLENTY * whole.residuals.shape[1]:
        return whole.cross_fitted(whole.moments(), whiten=True)
    used = whole.deviations[whole.usable]
    whitening = whitening_matrix(used.T @ used / len(used))
    return np.linalg.norm(whole.deviations @ whitening, axis=1)


def _of_means(
    residuals: NDArray[np.float64],
    rows: NDArray[np.int64],
    names: Sequence[str],
    number: int,
    limit: float,
    length: int,
) -> list[Change]:
    """Return the change of means of one recording: at the place where the most changed residual changes."""
    places = {
        j: place
        for j in range(len(names))
        if (place := likeliest_change(residuals[:, j], limit / len(names))) is not None
    }
    if not places:
        return []
    order = sorted(places, key=lambda j: -abs(places[j][1]))
    at, size = places[order[0]]
    x = residuals[:, order[0]]
    left = _without_line(x)
    drift = (x - x.mean() - left)[[0, -1]] / max(float(left.std()), np.finfo(float).tiny)
    step = _is_step(x, at, size, limit / len(names))
    return [Change(tuple(names[j] for j in order), number, int(rows[at]), float(size), length, step,
                   float(drift[1] - drift[0]))]  # fmt: skip


def _is_step(x: NDArray[np.float64], at: int, size: float, limit: float) -> bool:
    """Tell whether a mean changes at once, and not half as far again on either side."""
    near = max(_FEW_AT_ONCE, int(_AT_ONCE * len(x)))
    at_once = x[at : at + near].mean() - x[max(0, at - near) : at].mean()
    if at_once / (x[at:].mean() - x[:at].mean()) < _SHARP:
        return False
    sides = [likeliest_change(side, limit) for side in (x[:at], x[at:]) if len(side) >= _LEAST]
    return all(one is None or abs(one[1]) < abs(size) / 2 for one in sides)


def likeliest_change(x: NDArray[np.float64], significance: float) -> tuple[int, float] | None:
    """Return the sample from which a mean differs, and by how many standard deviations; ``None`` without a change.

    Parameters
    ----------
    x : ndarray, shape (time,)
    significance : float
        Largest probability of an answer without a change.
    """
    length = int(np.ceil(len(x) / _STRETCHES))
    count = len(x) // length
    means = x[: count * length].reshape(count, length).mean(axis=1)
    centred = means - means.mean()
    sums = np.cumsum(centred)[:-1]
    at = int(np.abs(sums).argmax()) + 1
    left = np.concatenate([_without_line(means[:at]), _without_line(means[at:])])
    spread = float(np.sqrt(np.mean(left**2)))
    if not spread > 0:
        return None
    tau = _longest_correlation_time(left)
    if count < _INDEPENDENT * tau:
        return None
    statistic = abs(float(sums[at - 1])) / (spread * np.sqrt(count * tau))
    place = at * length
    shift = float(x[place:].mean() - x[:place].mean())
    sides = np.concatenate([x[:place] - x[:place].mean(), x[place:] - x[place:].mean()])
    size = shift / float(np.sqrt(np.mean(sides**2)))
    if 2 * np.exp(-2 * statistic**2) > significance or abs(size) < NOTABLE:
        return None
    return place, size


def independent_samples(x: NDArray[np.float64]) -> float:
    """Return a lower bound on the number of independent samples in noise: few if it is slow, none for a walk.

    Parameters
    ----------
    x : ndarray, shape (time,)
        Its mean is taken off. All of them, where it never changes.
    """
    left = x - x.mean()
    return len(x) / _longest_correlation_time(left) if np.any(left) else float(len(x))


def _longest_correlation_time(left: NDArray[np.float64]) -> float:
    r"""Return a correlation time, not too short, of the residual of a fit by two lines.

    That of the data is too short where few fit into them. So it is at least that of first-order noise,

    .. math:: \frac{1 + \varphi}{1 - \varphi}, \qquad \varphi = \frac{\hat\varphi + 4 / n}{1 - 8 / n} +
       \sqrt{\frac{1 - \varphi^2}{n}}

    with the correlation of neighbours, less its bias after two lines, and one standard deviation more.

    References
    ----------
    Marriott and Pope (1954), Biometrika 41(3/4), 390-402 (the bias).
    """
    n = len(left)
    neighbours = float(left[1:] @ left[:-1]) / float(left @ left)
    phi = (neighbours + 4 / n) / (1 - 8 / n)
    phi += np.sqrt(max(0.0, 1 - min(phi, 1.0) ** 2) / n)
    own = float(correlation_times(left[:, None], (slice(0, n),))[0])
    return max(own, (1 + phi) / (1 - phi)) if phi < 1 else np.inf


def _without_line(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a stretch less the line that fits it best; less its mean if it is short."""
    centred = x - x.mean()
    if len(x) < 8:
        return centred
    time = np.arange(len(x)) - (len(x) - 1) / 2
    return centred - time * (time @ centred) / (time @ time)


def transient_samples(found: Sequence[Change], recording: int) -> int:
    """Return the length of a transient at the start of a recording; 0 without one."""
    return max((one.sample for one in found if one.recording == recording and one.is_transient), default=0)


__all__ = ["Change", "changes", "independent_samples", "likeliest_change", "transient_samples"]
