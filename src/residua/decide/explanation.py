"""One word for an alarm, from the fit of each listed fault beside every fault with a free course.

An unlisted state stands beside a single listed fault only if it explains more. It is not a component, and with a free
course it often acts as a sensor does. This was chosen by ``benchmarks/verdicts.py`` on its plants of even number, with
seeds 101, 202 and 303; ``docs/how-sure.rst`` has the alternatives and the check.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from residua.decide.stream_test import StreamTest
from residua.decide.whitened_norm import is_selection
from residua.decide.word import EITHER, GOOD, POOR, TOO_EARLY, Word
from residua.tolerances import DATA_ROUNDING, TINY

if TYPE_CHECKING:
    from residua.decide.test import ResidualTest
    from residua.design import ResidualGenerator
    from residua.plant import Plant

#: Samples before an alarm that are looked at, and the least of them that must be usable.
BEFORE, _LEAST_BEFORE = 100, 75
#: Samples after an alarm at which a word is first given, and at which it is final.
FIRST, FINAL = 50, 200
#: A course may begin so many samples before the alarm at any of them, and earlier at every fourth.
_CLOSE, _EACH = 24, 4
#: Largest number of terms in a course, least gain of each, and charge for each beyond the first.
_TERMS, _GAIN, _CHARGE = 12, 16.0, 10.0
#: Responses whose cosine is larger are those of one fault; samples that it is taken over.
_SAME, _COMPARED = 0.9995, 200
#: Groups of faults that are named together at most.
_MOST_CLOSE = 3
#: Evidence from which a fault is judged; shortfall from the best, of its evidence, at which another still counts.
_EVIDENCE, _APART, _PART = 80.0, 20.0, 0.01
#: Limits on the rest: so many deviations more than noise, or that part of the evidence, or so many less.
_MORE, _LESS = 3.5, -4.5
#: Lengths of the sums by which the colour of fault-free residuals is measured.
BLOCKS = (1, 5, 20, 100, 250)


def colour_of(white: NDArray[np.float64], parts: Sequence[slice]) -> tuple[float, ...]:
    """Return the mean square of white residuals, at most 1, and a variance for each length of :data:`BLOCKS`.

    It is the largest, over directions, of sums of so many samples, in units of the value for white noise, and no less
    than 1; of a length for which there are too few samples, that of the one before.
    """
    rows = np.concatenate([white[part] for part in parts]) if parts else white[:0]
    mean_square, out = float(np.mean(rows**2)) if rows.size else 1.0, []
    for length in BLOCKS:
        sums = [
            white[part][: (part.stop - part.start) // length * length].reshape(-1, length, white.shape[1]).sum(axis=1)
            for part in parts
        ]
        rows = np.concatenate(sums) / np.sqrt(length)
        enough = len(rows) > 2 * white.shape[1] + 8
        largest = float(np.linalg.eigvalsh(rows.T @ rows / len(rows))[-1]) if enough else out[-1] if out else 1.0
        out.append(max(1.0, largest))
    return min(1.0, mean_square), *out


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitening of the fault-free residual of a monitor, as in its test.

    Attributes
    ----------
    center : ndarray, shape (residuals,)
    matrix : ndarray, shape (residuals, k)
    coefficients : ndarray, shape (order, k, k)
        Of an autoregression, the last sample first.
    again : ndarray, shape (k, k)
        Whitening of the innovations.
    """

    center: NDArray[np.float64]
    matrix: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    again: NDArray[np.float64]

    @staticmethod
    def of(test: ResidualTest) -> Whitening | None:
        """Return the whitening of a test; ``None`` if it does not whiten the residual as a whole."""
        test = test.of_residual
        metric = test.metric
        if is_selection(metric) or metric.shape[0] != metric.shape[1]:
            return None
        if isinstance(test, StreamTest) and test.coefficients.size:
            return Whitening(test.center, metric, test.coefficients, test.rewhitening)
        k = metric.shape[1]
        return Whitening(test.center, metric, np.zeros((0, k, k)), np.eye(k))

    def of_responses(self, responses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return white residuals of responses, (..., time, residuals), from rest."""
        q = responses @ self.matrix
        if not len(self.coefficients):
            return q
        e = q.copy()
        for lag, A in enumerate(self.coefficients, 1):
            e[..., lag:, :] -= q[..., :-lag, :] @ A
        return e @ self.again

    def of_residuals(
        self, residuals: NDArray[np.float64], usable: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the white residual, (time, k), zero where unknown, and its mask: with its past."""
        usable = usable & np.isfinite(residuals).all(axis=1)
        white = self.of_responses(np.where(usable[:, None], residuals - self.center, 0.0))
        present = usable.copy()
        for lag in range(1, len(self.coefficients) + 1):
            present[lag:] &= usable[:-lag]
            present[lag - 1] = False
        return np.where(present[:, None], white, 0.0), present


@dataclass(frozen=True, eq=False)
class Explainer:
    """Responses of the whitened residual of a monitor to listed and unlisted faults.

    Attributes
    ----------
    generator : ResidualGenerator
        Sampled.
    whitening : Whitening
    colour : tuple of float
        Of fault-free residuals, see :func:`colour_of`; empty: white.
    """

    generator: ResidualGenerator
    whitening: Whitening
    colour: tuple[float, ...] = ()

    @cached_property
    def _responses(self) -> tuple[NDArray[np.float64], list[tuple[str, ...]], NDArray[np.bool_]]:
        """Whitened responses, (groups, samples, k), of listed faults, then others; names; mask of other states."""
        plant = with_unlisted(self.generator.plant)
        names = plant.faults
        listed = len(self.generator.faults)
        form = self.generator.internal_form(plant).select(inputs=range(len(names)))
        responses = np.empty((BEFORE + FINAL, form.n_outputs, len(names)))
        x = np.zeros((form.n_states, len(names)))
        for k in range(len(responses)):
            responses[k] = form.C @ x + form.D
            x = form.A @ x + form.B
        white = self.whitening.of_responses(np.moveaxis(responses, 2, 0))
        flat = white[:, :_COMPARED].reshape(len(names), -1)
        size = np.sqrt(np.sum(flat**2, axis=1))
        cosines = np.abs(flat @ flat.T) / np.maximum(np.outer(size, size), np.finfo(float).tiny)
        groups: list[list[int]] = []
        for j in range(len(names)):
            if not size[j] > DATA_ROUNDING * size.max(initial=0.0):
                continue
            same = next((group for group in groups if cosines[group[0], j] > _SAME), None)
            if same is None:
                groups.append([j])
            elif j < listed:
                same.append(j)
        kept = [group[0] for group in groups]
        states = np.array([plant.fault_kinds[j] == "component" for j in kept if j >= listed], dtype=bool)
        return white[kept], [tuple(names[j] for j in group) for group in groups], states

    def word(self, residuals: NDArray[np.float64], usable: NDArray[np.bool_], before: int) -> Word:
        """Return the word for an alarm.

        Parameters
        ----------
        residuals : ndarray, shape (time, residuals)
            Around it.
        usable : ndarray of bool, shape (time,)
        before : int
            How many of them come before the sample that raised it.
        """
        responses, names, states = self._responses
        listed = len(names) - len(states)
        after = len(residuals) - before
        if not listed:
            return Word(POOR, (), after=after, share=0.0)
        mean_square, *variances = self.colour or (1.0,) * (1 + len(BLOCKS))
        variance: dict[int, float] = dict(zip(BLOCKS, variances, strict=True))
        white, usable = self.whitening.of_residuals(residuals, usable)
        fits = _fits(white, usable, responses, before)
        evidence = fits.evidence / variance[20]
        level = evidence - _CHARGE * np.maximum(fits.terms - 1, 0)
        order = np.argsort(-level[:listed], kind="stable").tolist()
        best = order[0]
        margin = _APART + _PART * float(evidence[best])
        other = listed + int(np.argmax(level[listed:])) if len(names) > listed else None
        beyond = float(np.sum(white**2)) - float(usable.sum()) * white.shape[1]
        word = Word(
            GOOD,
            (names[best],),
            after=after,
            evidence=float(evidence[best]),
            share=float(np.clip(fits.evidence[best] / max(beyond, TINY), 0.0, 1.0)),
            size=float(fits.sizes[best]),
            deviation=float(fits.deviations[best] * np.sqrt(variance[20])),
        )
        if before < BEFORE or int(usable[:before].sum()) < _LEAST_BEFORE:
            return replace(word, kind=TOO_EARLY, from_start=True)
        excess, rareness = _excess(fits.remainder[best], usable, variance)
        count = int(usable.sum()) * white.shape[1]
        if (float(np.sum(fits.remainder[best] ** 2)) - mean_square * count) / np.sqrt(2 * max(count, 1)) < _LESS:
            return replace(word, kind=POOR, quieter=True)
        unlisted = "" if other is None or level[other] < level[best] - margin else names[other][0]
        if other is not None and level[other] > level[best] + margin:
            kind = POOR if level[other] > _EVIDENCE else TOO_EARLY
            return replace(word, kind=kind, unlisted=unlisted)
        if ((rareness > _MORE) & (excess > _PART * evidence[best])).any():
            return replace(word, kind=POOR, unlisted=unlisted)
        close = [g for g in order if level[g] >= level[best] - margin]
        if level[best] < _EVIDENCE or fits.is_spike[best] or len(close) > _MOST_CLOSE:
            return replace(word, kind=TOO_EARLY, unlisted=unlisted)
        rivals = level[listed:] > level[best] - np.where(states, 0.0, margin)  # a state must explain more
        if rivals.any() or len(close) > 1:
            word = replace(word, kind=EITHER, faults=tuple(names[g] for g in close), unlisted=unlisted)
        return word if after >= FIRST else replace(word, kind=TOO_EARLY)


@dataclass(frozen=True, eq=False)
class _Fits:
    """Fits of faults to a residual, one row each.

    Attributes
    ----------
    evidence : ndarray
        By how much the squares of the residual fall.
    terms : ndarray of int
    remainder : ndarray, shape (faults, time, k)
    sizes, deviations : ndarray
        Of the best single step, and the standard error in white noise.
    is_spike : ndarray of bool
        True if one sample has more than half of the evidence.
    """

    evidence: NDArray[np.float64]
    terms: NDArray[np.int64]
    remainder: NDArray[np.float64]
    sizes: NDArray[np.float64]
    deviations: NDArray[np.float64]
    is_spike: NDArray[np.bool_]


def _fits(e: NDArray[np.float64], usable: NDArray[np.bool_], responses: NDArray[np.float64], before: int) -> _Fits:
    """Fit each fault with a free course, steps and ramps, to the residual by orthogonal least squares.

    All faults take their next term at once; products with shifted responses are correlations, by fast transforms.
    """
    (count, _, k), n = responses.shape, len(e)
    kernels = np.stack([responses[:, :n], np.cumsum(responses[:, :n], axis=1)], axis=1)  # a step, a ramp
    length = 1 << (2 * n - 1).bit_length()
    spectra = np.conj(np.fft.rfft(kernels, length, axis=2))
    mask = np.fft.rfft(usable.astype(float), length)
    squares = np.conj(np.fft.rfft(np.sum(kernels**2, axis=3), length, axis=2))
    energies = np.maximum(np.fft.irfft(squares * mask, length, axis=2)[..., :n], 0.0)
    starts = np.zeros((2, n), dtype=bool)
    starts[:, ::_EACH] = True
    starts[0, max(0, before - _CLOSE) :] = True
    floor = DATA_ROUNDING * energies.max(axis=(1, 2), keepdims=True)

    def along(rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the products of rows of each fault with its shifted responses, (faults, 2, starts)."""
        spectrum = np.fft.rfft(rows, length, axis=1)
        return np.fft.irfft(np.einsum("fltk,ftk->flt", spectra, spectrum), length, axis=2)[..., :n]

    remainder = np.broadcast_to(e, (count, n, k)).copy()
    products, norms = along(remainder), energies.copy()
    earlier: list[NDArray[np.float64]] = []
    terms, evidence = np.zeros(count, dtype=np.int64), np.zeros(count)
    sizes, deviations = np.zeros(count), np.full(count, np.inf)
    for term in range(_TERMS):
        gains = np.where(starts & (norms > floor), products**2 / np.maximum(norms, floor + TINY), 0.0)
        if not term:  # the best step by itself
            at = np.argmax(gains[:, 0], axis=1)
            norm = np.maximum(norms[np.arange(count), 0, at], TINY)
            sizes, deviations = products[np.arange(count), 0, at] / norm, 1 / np.sqrt(norm)
        place = np.argmax(gains.reshape(count, -1), axis=1)
        goes_on = (gains.reshape(count, -1)[np.arange(count), place] >= _GAIN) & (terms == term)
        if not goes_on.any():
            break
        rows = np.zeros((count, n, k))
        for f in np.flatnonzero(goes_on).tolist():
            shape, start = divmod(int(place[f]), n)
            rows[f, start:] = kernels[f, shape, : n - start]
        rows[:, ~usable] = 0.0
        for _ in range(2):
            for other in earlier:
                rows -= other * np.sum(other * rows, axis=(1, 2), keepdims=True)
        size = np.sqrt(np.sum(rows**2, axis=(1, 2), keepdims=True))
        rows /= np.where(size > 0, size, 1.0)
        amount = np.sum(rows * remainder, axis=(1, 2))
        remainder -= rows * amount[:, None, None]
        evidence += amount**2
        terms += goes_on
        moved = along(rows)
        products -= moved * amount[:, None, None]
        norms -= moved**2
        earlier.append(rows)
    fell = np.sum(e**2, axis=1) - np.sum(remainder**2, axis=2)
    return _Fits(evidence, terms, remainder, sizes, deviations, fell.max(axis=1) > 0.5 * evidence)


def _excess(
    rows: NDArray[np.float64], usable: NDArray[np.bool_], variance: Mapping[int, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return for each length of sums the excess of the remaining squares over noise, and its deviations."""
    n, k = rows.shape
    excess, rareness = [], []
    for length, one in variance.items():
        width = min(length, n)
        blocks = n // width
        counts = usable[: blocks * width].reshape(blocks, width).sum(axis=1)
        sums = rows[: blocks * width].reshape(blocks, width, k).sum(axis=1)[counts > 0]
        total = float(np.sum(np.sum(sums**2, axis=1) / counts[counts > 0])) / one
        freedom = k * int((counts > 0).sum())
        excess.append(total - freedom)
        rareness.append((total - freedom) / np.sqrt(2 * max(freedom, 1)))
    return np.array(excess), np.array(rareness)


def with_unlisted(plant: Plant) -> Plant:
    """Return a plant with faults of every sensor, actuator and state after the listed ones.

    States of an identified plant have no meaning of their own.
    """
    listed = set(plant.faults)
    sensors = [name for name in plant.outputs if f"{name} sensor" not in listed]
    actuators = [name for name in plant.inputs if f"{name} actuator" not in listed]
    plant = plant.with_sensor_faults(sensors).with_actuator_faults(actuators)
    if plant.identification is not None:
        return plant
    states = {f"state {name}": {name: 1.0} for name in plant.states if f"state {name}" not in listed}
    return plant.with_faults(states)
