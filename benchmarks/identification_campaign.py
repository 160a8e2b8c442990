"""Two hundred generated plants: how fast identification converges, whether the order is right, and another package.

``python benchmarks/identification_campaign.py [--plants 200]`` writes ``docs/data/identification_campaign.csv``. Orders
run from 1 to 20, in open and closed loop, with a ratio of signal to noise of 100, 30, 10, 3 or 1. Each plant is
identified from N and from 16 N rows with its true order: errors at the root of the samples shrink by 4. The order is
left to the package in a run of its own, of 16 N rows. ``nfoursid`` gets the same N rows in open loop, and both predict
the same rows that neither has seen. Settings are the defaults of :func:`residua.identify.subspace`.
"""

from __future__ import annotations

import argparse
import csv
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from nfoursid.kalman import Kalman
from nfoursid.nfoursid import NFourSID
from scipy.optimize import linear_sum_assignment

import residua as rs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from recorded_plants import generated_plant, in_closed_loop, markov_parameters, recorded

TABLE = Path(__file__).parents[1] / "docs/data/identification_campaign.csv"
RATIOS = (100.0, 30.0, 10.0, 3.0, 1.0)
ROWS, MORE, UNSEEN = 3000, 16, 1000
HEADER = ("order", "loop", "signal to noise", "markov", "poles", "innovations", "order by default", "against nfoursid")


@dataclass(frozen=True)
class Errors:
    """How far a model is from the truth, relative: Markov parameters, poles, covariance of the innovations."""

    markov: float
    poles: float
    innovations: float


def errors(model: rs.identify.IdentifiedModel, plant: rs.Plant, covariance: np.ndarray) -> Errors:
    """Return the errors of a model; the innovations' covariance in units of the true one."""
    truth, made = (np.hstack(markov_parameters(one, 30)) for one in (plant, model.plant))
    size = 1 / np.sqrt(np.diag(covariance))
    distance = np.abs(np.linalg.eigvals(plant.A)[:, None] - np.linalg.eigvals(model.plant.A))
    V = size[:, None] * (model.innovation_covariance - covariance) * size
    nearest = distance[linear_sum_assignment(distance)]
    return Errors(
        float(np.linalg.norm(truth - made) / np.linalg.norm(truth)),
        float(np.sqrt(np.mean(nearest**2))),
        float(np.linalg.norm(V) / np.sqrt(len(V))),
    )


def theirs(u: np.ndarray, y: np.ndarray, order: int) -> float:
    """Return the error of one-step predictions of the unseen rows by the other package, relative to the outputs."""
    names = [f"u{i}" for i in range(u.shape[1])], [f"y{i}" for i in range(y.shape[1])]
    frame = pd.DataFrame(np.hstack([u, y])[:ROWS], columns=[*names[0], *names[1]])
    other = NFourSID(frame, output_columns=names[1], input_columns=names[0], num_block_rows=max(15, order + 5))
    other.subspace_identification()
    system, covariance = other.system_identification(rank=order)
    kalman = Kalman(system, covariance)
    predicted = np.zeros((UNSEEN, y.shape[1]))
    for k in range(UNSEEN):
        if kalman.x_predicteds:
            predicted[k] = np.ravel(system.c @ kalman.x_predicteds[-1])
        kalman.step(y[ROWS + k][:, None], u[ROWS + k][:, None])
    return relative(y[ROWS:], predicted)


def ours(model: rs.identify.IdentifiedModel, u: np.ndarray, y: np.ndarray) -> float:
    """Return the same by this package."""
    [seen] = model.predict(u[ROWS:], y[ROWS:])
    return relative(seen.measured, seen.predicted)


def relative(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Return the geometric mean over the outputs of the error of the last 900 rows, in standard deviations."""
    error = (measured - predicted)[100:].std(axis=0) / measured[100:].std(axis=0)
    return float(np.exp(np.mean(np.log(error))))


@dataclass(frozen=True)
class Case:
    """A generated plant, what is known of it, and recordings of it."""

    number: int
    plant: rs.Plant
    closed: bool
    ratio: float
    noise: np.ndarray
    short: tuple[np.ndarray, np.ndarray]
    long: tuple[np.ndarray, np.ndarray]

    @property
    def order(self) -> int:
        """The number of states."""
        return self.plant.n_states

    @property
    def few(self) -> tuple[np.ndarray, np.ndarray]:
        """The first rows of the short recording, without those that no model has seen."""
        u, y = self.short
        return u[:ROWS], y[:ROWS]


def generated_case(number: int) -> Case:
    """Return one plant with its recordings."""
    rng = np.random.default_rng(7000 + number)
    order, closed = number % 20 + 1, bool(number // 20 % 2)
    ratio = RATIOS[number // 40 % len(RATIOS)]
    m, p = int(rng.integers(1, 3)), int(rng.integers(1, 4))
    plant = generated_plant(rng, order, m, p, least=0.1 if order <= 6 else 0.0)
    make = in_closed_loop if closed else recorded
    long = make(plant, np.random.default_rng(number), MORE * ROWS, ratio)
    short = make(plant, np.random.default_rng(900 + number), ROWS + UNSEEN, ratio)
    noise = recorded(plant, np.random.default_rng(0), 2000, 1e9)[1].std(axis=0) / ratio
    if not closed:
        noise = plant.system("control").simulate(np.random.default_rng(number).standard_normal((MORE * ROWS, m)))
        noise = noise.std(axis=0) / ratio
    return Case(number, plant, closed, ratio, noise, short, long)


def case(number: int) -> list[object]:
    """Return the row of one plant."""
    made = generated_case(number)
    plant, order = made.plant, made.order
    models = [rs.identify.subspace(*recording, order=order, dt=1.0) for recording in (made.few, made.long)]
    few, many = (errors(model, plant, np.diag(made.noise**2)) for model in models)
    chosen = rs.identify.subspace(*made.long, dt=1.0, max_order=25).report.order
    other = "" if made.closed else f"{ours(models[0], *made.short) / theirs(*made.short, order):.4f}"
    shrunk = [getattr(few, name) / getattr(many, name) for name in ("markov", "poles", "innovations")]
    loop = "closed" if made.closed else "open"
    return [order, loop, f"{made.ratio:g}", *(f"{x:.2f}" for x in shrunk), chosen, other]


def rows(plants: int) -> Iterator[list[object]]:
    """Yield a row for each plant, printing it."""
    for number in range(plants):
        row = case(number)
        print(number, *row, flush=True)
        yield row


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=200)
    warnings.simplefilter("ignore", FutureWarning)
    table = list(rows(parser.parse_args().plants))
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(table)


if __name__ == "__main__":
    main()
