"""How often the default test alarms on rows that it was not fitted to, beside the rate that was asked for.

Run it with::

    .venv/bin/python benchmarks/default_test_rates.py --out docs/data/default_test_rates.csv

A row for each cell: kind of residual, rows of the fit, fits, the mean multiple of the rate on 100,000 new rows each,
its median and largest, and the share of a lasting change of one standard deviation that is in alarm. Seeds are those of
the cell; nothing was chosen on them. ``--fits 5`` is a part of it.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

import residua as rs
from residua.decide import Block, FaultFreeRun, MultiscaleEWMA, Watched

ROWS, NEW, RATE = (300, 1000, 5000, 20_000), 100_000, 1e-3
HEADER = ("residual", "rows", "fits", "mean multiple", "median", "largest", "change seen")
#: Rows before those that are used, for memory to settle.
LEAD = 1000
Noise = Callable[[np.random.Generator, int], NDArray[np.float64]]


def coloured(pole: float, degrees: float = np.inf) -> Noise:
    """Return what makes two channels of noise with a pole, Gaussian or by Student's distribution."""

    def make(rng: np.random.Generator, rows: int) -> NDArray[np.float64]:
        e = rng.standard_normal((rows + LEAD, 2)) if np.isinf(degrees) else rng.standard_t(degrees, (rows + LEAD, 2))
        return lfilter([np.sqrt(1 - pole**2)], [1, -pole], e, axis=0)[LEAD:]

    return make


RESIDUALS: dict[str, Noise] = {
    "white": coloured(0.0),
    "autoregressive .5": coloured(0.5),
    "autoregressive .9": coloured(0.9),
    "autoregressive .98": coloured(0.98),
    "Student's t, 4 degrees": coloured(0.0, 4.0),
}


def motor(gain: float = 1.0) -> rs.Plant:
    """Return a DC motor with noise, sampled; ``gain`` times what its input does."""
    plant = rs.Plant([[-10, 1], [-0.02, -2]], [[0], [2 * gain]], np.eye(2), inputs=["V"], outputs=["speed", "current"])
    return plant.with_sensor_faults().discretize(0.01).with_noise(process=1e-5, measurement=1e-3)


def recording(plant: rs.Plant, rng: np.random.Generator, rows: int) -> tuple[NDArray, NDArray]:
    """Return inputs that are held for 50 rows, and the outputs of a plant with noise."""
    u = np.repeat(rng.uniform(-1, 1, (rows // 50 + 1, len(plant.inputs))), 50, axis=0)[:rows]
    x, y = np.zeros(plant.n_states), np.empty((rows, plant.n_outputs))
    w = rng.standard_normal((len(u), plant.Bw.shape[1]))
    forced, read = u @ plant.B.T + w @ plant.Bw.T, u @ plant.D.T + w @ plant.Dw.T
    for t in range(rows):
        y[t] = plant.C @ x + read[t]
        x = plant.A @ x + forced[t]
    return u, y


def generator_of(k: int) -> rs.ResidualGenerator:
    """Return a generator of so many residuals, whose own numbers do not matter."""
    plant = rs.Plant(0.5 * np.eye(k), np.zeros((k, 1)), np.eye(k), dt=1).with_sensor_faults()
    return rs.design.luenberger_observer(plant, poles=[0.1] * k).residual_generator()


def of_residuals(make: Noise, rows: int, seed: list[int]) -> tuple[float, float]:
    """Return the multiple of the rate on new rows, and the share of a change that is in alarm."""
    rng = np.random.default_rng(seed)
    r = make(rng, rows + NEW) @ rng.standard_normal((2, 2))
    usable = np.ones(rows, dtype=bool)
    run = FaultFreeRun(r[:rows], usable, (), np.ones(2))
    test = MultiscaleEWMA().fitted(Watched(generator_of(2)), run, RATE)

    def share(rows: NDArray[np.float64]) -> float:
        block = Block(rows[None], np.ones((1, len(rows)), dtype=bool))
        return float(test.run(test.start(1), block)[1].alarm.mean())

    changed = r[rows : rows + 3000] + np.linalg.cholesky(np.cov(r.T))[:, 0]
    return share(r[rows:]) / RATE, share(changed)


def of_plant(kind: str, rows: int, seed: list[int]) -> tuple[float, float]:
    """Return the same of a Kalman filter whose gains are 5 % off, or of a plant that was identified from the rows."""
    rng, plant = np.random.default_rng(seed), motor()
    u, y = recording(plant, rng, rows + NEW + 500)
    model = motor(1.05)
    if kind == "identified":
        model = rs.identify.subspace([(u[:rows], y[:rows])], dt=0.01, order=2).plant
    monitor = rs.Monitor(rs.design.kalman_filter(model), test=MultiscaleEWMA(), isolate=None)
    monitor.fit(u[:rows], y[:rows], false_alarm_rate=RATE, held_out=0.0)
    found = monitor.run(u[rows:], y[rows:])
    return float(found.alarm[500:].mean()) / RATE, np.nan


def cells(fits: int, kinds: list[str], rows: list[int]) -> list[tuple[object, ...]]:
    """Return the table."""
    out = []
    for number, kind in enumerate((*RESIDUALS, "gains 5 % off", "identified")):
        for count in rows:
            if kinds and kind not in kinds:
                continue
            seeds = [[number, count, fit] for fit in range(fits)]
            if kind in RESIDUALS:
                found = [of_residuals(RESIDUALS[kind], count, seed) for seed in seeds]
            else:
                found = [of_plant(kind, count, seed) for seed in seeds]
            multiples, seen = np.array(found).T
            told = [f"{value:.2f}" for value in (multiples.mean(), np.median(multiples), multiples.max())]
            out.append((kind, count, fits, *told, "" if np.isnan(seen).all() else f"{seen.mean():.2f}"))
            print(*out[-1], sep="\t", flush=True)
    return out


def main() -> None:
    """Print the table, and write it where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=50)
    parser.add_argument("--kind", nargs="*", default=[])
    parser.add_argument("--rows", nargs="*", type=int, default=list(ROWS))
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    table = cells(asked.fits, asked.kind, asked.rows)
    if asked.out is None:
        return
    with asked.out.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *table])


if __name__ == "__main__":
    sys.exit(main())
