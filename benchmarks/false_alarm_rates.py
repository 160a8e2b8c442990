"""How often fitted thresholds alarm on data that they were not fitted to, beside what was asked for and promised.

Run it with::

    .venv/bin/python benchmarks/false_alarm_rates.py

It writes ``docs/data/false_alarm_rates_all.csv``, a row for each cell of the grid: residuals, samples, window,
persistence and noise; ``docs/make_tables.py`` sums it up. ``--quick`` prints a part of the grid and writes nothing.

Residuals are Gaussian, mixed at random and with a mean: white, or each ``x(t+1) = phi x(t) + e(t)`` before mixing. A
threshold is fitted to the samples of a cell, some times over with other numbers, each time by what
:meth:`residua.Monitor.fit` calls. Its rate is then counted on new samples by the alarm logic that monitors run. New
samples need no mixing: the norm of a whitened sum depends on the singular values of mixing times whitening alone, for
Gaussian channels of one kind look the same in all rotations.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from residua.decide.norm_threshold import NormTest, NormThreshold, fit_norm_test
from residua.decide.persistence import alarm_logic

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "false_alarm_rates_all.csv"
RESIDUALS, SAMPLES = (1, 10, 60), (300, 1000, 5000, 50_000)
WINDOWS, PERSISTENCES, NOISES = (1, 20, 100), (1, 3, 6, 10), (0.0, 0.5, 0.9)
ASKED = 0.01
#: Fits of a cell, by the number of samples.
TIMES = {300: 4, 1000: 4, 5000: 3, 50_000: 2}
#: New samples that a rate is counted on.
NEW = 500_000
TOLERATED, LEAST = 1.5, 0.2
HEADER = (
    "residuals", "samples", "window", "noise", "persistence", "fits", "median rate", "smallest rate", "largest rate",
    "median promised", "said", "kept",
)  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """The rate on new data, and what the fit promised."""

    rate: float
    promised: float

    @property
    def said(self) -> bool:
        """Whether the fit said that the data cannot promise what was asked for."""
        return self.promised > TOLERATED * ASKED * (1 + 1e-6)

    @property
    def kept(self) -> bool:
        """At most 1.5 times what was asked for, or what was promised; without a word also not under a fifth."""
        if self.said:
            return self.rate <= self.promised
        return LEAST * ASKED <= self.rate <= TOLERATED * ASKED


def channels(rng: np.random.Generator, samples: int, k: int, phi: float) -> NDArray[np.float64]:
    """Return independent channels of noise of unit variance."""
    from scipy.signal import lfilter

    lead = 300 if phi else 0
    noise = rng.standard_normal((samples + lead, k))
    return lfilter([np.sqrt(1 - phi**2)], [1, -phi], noise, axis=0)[lead:] if phi else noise


def new_sums(rng: np.random.Generator, k: int, phi: float, window: int) -> NDArray[np.float32]:
    """Return new channels, summed over the window and divided by its root."""
    out = np.empty((NEW, k), dtype=np.float32)
    for j in range(k):  # one by one: memory
        x = channels(rng, NEW + window - 1, 1, phi)[:, 0]
        total = np.concatenate([[0.0], np.cumsum(x)])
        out[:, j] = (total[window:] - total[:-window]) / np.sqrt(window)
    return out


def rate_on(sums: NDArray[np.float32], test: NormTest, mixing: NDArray, mean: NDArray) -> float:
    """Return the fraction of new samples in alarm."""
    _, sizes, rotated = np.linalg.svd(mixing @ test.whitening)
    offset = np.sqrt(test.window) * (rotated @ ((mean - test.center) @ test.whitening))
    linear = (2 * sizes * offset).astype(np.float32)
    squares = np.zeros(NEW)
    for start in range(0, NEW, 50_000):
        part = sums[start : start + 50_000]
        squares[start : start + 50_000] = part**2 @ (sizes**2).astype(np.float32) + part @ linear
    over = (squares + offset @ offset > test.threshold**2)[None]
    none, off = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    alarm, _, _ = alarm_logic(over, np.ones_like(over), none, none, off, test.persistence, test.release)
    return float(alarm.mean())


def outcomes(
    sums: NDArray[np.float32], n: int, window: int, persistence: int, phi: float, times: int
) -> Iterator[Outcome]:
    """Fit some times over, and yield what came of it."""
    k = sums.shape[1]
    rng = np.random.default_rng([k, n, window, persistence, round(10 * phi)])
    settings = NormThreshold(window=window, persistence=persistence)
    for _ in range(times):
        mixing, mean = rng.standard_normal((k, k)), 5 * rng.standard_normal(k)
        residuals = channels(rng, n, k, phi) @ mixing + mean
        usable = np.ones(n, dtype=bool)
        test = fit_norm_test(
            settings, residuals, usable, false_alarm_rate=ASKED, covariance=None, signal_size=1.0
        )  # fmt: skip
        assert test.promised is not None
        yield Outcome(rate_on(sums, test, mixing, mean), test.promised)


def row_of(cell: tuple[int, int, int, float, int], found: list[Outcome]) -> tuple[object, ...]:
    """Return a row of the table."""
    rates = np.array([one.rate for one in found])
    k, n, window, phi, persistence = cell
    return (
        k, n, window, phi, persistence, len(found), f"{np.median(rates):.4f}", f"{rates.min():.4f}",
        f"{rates.max():.4f}",
        f"{np.median([one.promised for one in found]):.4f}", sum(one.said for one in found),
        sum(one.kept for one in found),
    )  # fmt: skip


def rows(
    residuals: tuple[int, ...], samples: tuple[int, ...], windows: tuple[int, ...], persistences: tuple[int, ...],
    noises: tuple[float, ...],
) -> Iterator[tuple[object, ...]]:  # fmt: skip
    """Yield the rows of a grid."""
    for k, phi, window in itertools.product(residuals, noises, windows):
        sums = new_sums(np.random.default_rng([k, round(10 * phi), window]), k, phi, window)
        for n, persistence in itertools.product(samples, persistences):
            found = list(outcomes(sums, n, window, persistence, phi, TIMES[n]))
            yield row_of((k, n, window, phi, persistence), found)


def main() -> None:
    """Compute the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, action="append", help="only this one; may be repeated")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    parser.add_argument("--quick", action="store_true", help="print a part of the grid, and write nothing")
    given = parser.parse_args()
    whole = (RESIDUALS, SAMPLES, WINDOWS, PERSISTENCES, tuple(given.noise or NOISES))
    grid = ((1, 52), (300, 1000), (1, 20), (1, 6), (0.0,)) if given.quick else whole
    begun, found = time.monotonic(), [HEADER]
    for row in rows(*grid):
        found.append(row)  # pyright: ignore
        print(*row, sep="\t", flush=True)
    print(f"{time.monotonic() - begun:.0f} s")
    if not given.quick:
        with given.output.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(found)


if __name__ == "__main__":
    main()
