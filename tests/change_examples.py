"""Simulated changes of a signal in white and in slow noise, and how often the interval of their onset holds it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from residua.decide.change_time import change_time

#: When every change begins, how long a recording is, and what raises an alarm: so many samples in a row over it.
ONSET, SAMPLES, THRESHOLD, PERSISTENCE = 400, 1200, 4.0, 3
#: Sizes of steps in standard deviations of the noise, and of ramps in as many per 100 samples.
CASES = {"step": (3.0, 5.0, 8.0, 15.0, 40.0), "ramp": (0.5, 1.0, 3.0, 10.0, 50.0)}


def noise(rng: np.random.Generator, samples: int, slow: float) -> NDArray[np.float64]:
    """Noise of unit variance that is remembered by this factor from one sample to the next."""
    return lfilter([np.sqrt(1 - slow**2)], [1, -slow], rng.standard_normal(samples + 500))[500:]


def noisy(kind: str, size: float, slow: float, rng: np.random.Generator, lag: float = 0.0) -> NDArray[np.float64]:
    """A recording with a step or a ramp, through a lag of the first order."""
    late = np.arange(SAMPLES) - ONSET
    change = size * (late >= 0) if kind == "step" else size * np.maximum(late, 0) / 100
    return noise(rng, SAMPLES, slow) + lfilter([1 - lag], [1, -lag], change)


def coverage(
    kind: str, size: float, slow: float, trials: int, *, seed: int, lag: float = 0.0
) -> tuple[int, int, float]:
    """How many changes were dated, for how many the interval holds the onset, and its median width in samples.

    Of the recordings whose alarm comes after the onset. The interval of a change that sample ``k`` is the first to show
    begins after sample ``k - 1``.
    """
    rng = np.random.default_rng(seed)
    dated, held, widths = 0, 0, []
    for _ in range(trials):
        signal = noisy(kind, size, slow, rng, lag)
        first = int(np.argmax(np.convolve(np.abs(signal) > THRESHOLD, np.ones(PERSISTENCE), "valid") == PERSISTENCE))
        if first < ONSET:
            continue
        found = change_time(signal, first, first + PERSISTENCE - 1)
        if found is None:
            continue
        dated += 1
        held += (found.earliest or 0) <= ONSET <= found.latest
        if found.earliest is not None:
            widths.append(found.latest - found.earliest + 1)
    return dated, held, float(np.median(widths)) if widths else np.inf
