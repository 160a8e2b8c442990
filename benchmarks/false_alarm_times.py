"""Times between false alarms that were designed, and those that are measured on residuals of many kinds.

Run it::

    .venv/bin/python benchmarks/false_alarm_times.py

It writes ``docs/data/false_alarm_times.csv``. Two residuals are simulated, white, coloured (AR(1)), with heavy
tails (Student's t with 4 degrees of freedom) and quantised (half a standard deviation). Each test is fitted to 20,000
samples, for a false alarm each 1,000 samples (1 % of samples in alarm for the chi-squared test), and run over 50,000
others, four times: as by default, and without looking at memory and distribution.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

import residua as rs
from residua.decide import CUSUM, EWMA, GLR, SPRT, ChiSquared, PageHinkley
from residua.decide.stream_settings import StreamSettings

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "false_alarm_times.csv"
COLUMNS, FITS, FITTED, RUN, TIME, FRACTION, CONFIDENCE = 2, 4, 20_000, 50_000, 1000.0, 0.01, 0.99
KINDS = ("white", "AR(1), 0.5", "AR(1), 0.95", "heavy tails", "quantised")
OPTIONS = {"source": "design", "treatment": "none"}


def noise(kind: str, rng: np.random.Generator, rows: int) -> np.ndarray:
    """Return residuals of unit variance."""
    if kind == "heavy tails":
        return rng.standard_t(4, (rows, COLUMNS)) / np.sqrt(2)
    e = rng.standard_normal((rows, COLUMNS))
    if kind.startswith("AR"):
        pole = float(kind.split()[1])
        return np.asarray(lfilter([1.0], [1.0, -pole], e, axis=0)) * np.sqrt(1 - pole**2)
    return np.round(2 * e) / 2 if kind == "quantised" else e


def tests(**options: str) -> dict[str, StreamSettings]:
    """Return the tests by name."""
    return {
        "CUSUM": CUSUM(mean_time_between_false_alarms=TIME, **options),
        "EWMA": EWMA(mean_time_between_false_alarms=TIME, **options),
        "GLR, window 20": GLR(window=20, mean_time_between_false_alarms=TIME, **options),
        "SPRT": SPRT(mean_time_between_false_alarms=TIME, **options),
        "Page and Hinkley": PageHinkley(mean_time_between_false_alarms=TIME, **options),
        "chi-squared, window 10": ChiSquared(window=10, false_alarm_rate=FRACTION, **options),
    }


def measured(settings: StreamSettings, kind: str) -> str:
    """Return the time between false alarms with its interval, or the fraction in alarm."""
    made = rs.identify.given_residuals([f"r{i}" for i in range(COLUMNS)], dt=1.0)
    raised = quiet = 0
    for seed in range(FITS):
        rng = np.random.default_rng((seed, KINDS.index(kind)))
        monitor = rs.Monitor(made, test=settings, isolate=None).fit(None, noise(kind, rng, FITTED), held_out=0)
        alarm = monitor.run(None, noise(kind, rng, RUN)).alarm  # pyright: ignore
        raised, quiet = raised + int((alarm[1:] & ~alarm[:-1]).sum()), quiet + int((~alarm).sum())
    if isinstance(settings, ChiSquared):
        return f"{1 - quiet / (FITS * RUN):.4f}"
    low, high = chi2.ppf([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], [2 * raised, 2 * raised + 2]) / 2
    return f"{quiet / max(raised, 1):.0f} ({quiet / high:.0f} to {quiet / low:.0f})"


def rows() -> Iterator[list[str]]:
    """Yield the header, then two rows for each test."""
    yield ["test", "designed", "", *KINDS]
    for name, settings in tests().items():
        designed = f"{FRACTION:g} of samples" if isinstance(settings, ChiSquared) else f"{TIME:.0f}"
        yield [name, designed, "as by default", *(measured(settings, kind) for kind in KINDS)]
        yield ["", "", "as if white and Gaussian", *(measured(tests(**OPTIONS)[name], kind) for kind in KINDS)]


def main() -> None:
    """Write the table."""
    with OUTPUT.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        for row in rows():
            writer.writerow(row)
            print(*row, sep="  ", flush=True)


if __name__ == "__main__":
    main()
