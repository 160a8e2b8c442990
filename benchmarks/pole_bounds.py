"""How well the poles of generated plants can be known at all, and how near to that identification comes.

``python benchmarks/pole_bounds.py [--plants 200]`` takes the plants of ``identification_campaign.py``, with the same
recordings, and writes ``docs/data/pole_bounds.csv``. The variance of an unbiased estimate of a pole is never below
the bound of Cramer and Rao for the model that is identified, in innovation form: poles, input, output and gain
parameters are all unknown. With a bound that is large, as of a mode that inputs hardly move or outputs hardly show,
no method knows the pole, and its error is about as large for 16 times the rows: an estimate lies somewhere in the
unit circle whatever the data. The table groups the poles by their bound at 3,000 rows.

``--past P`` identifies with so many rows of the past instead of those that the package chooses, and writes nothing.
"""

from __future__ import annotations

import argparse
import csv
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from identification_campaign import Case, generated_case
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.optimize import linear_sum_assignment
from scipy.signal import lfilter

import residua as rs

TABLE = Path(__file__).parents[1] / "docs/data/pole_bounds.csv"
#: Limits of the groups of poles, by their bound at few rows.
BOUNDS = (0.003, 0.01, 0.03, 0.1, np.inf)
#: The part of a recording that identification uses, the rest is held out.
USED = 0.75
HEADER = ("bound at 3000 rows", "poles", "of order 6 or less", "error over bound", "error shrinks by")


@dataclass(frozen=True)
class Pole:
    """A pole: the order of its plant, its bound at few rows, its errors from few and from many rows."""

    order: int
    bound: float
    few: float
    many: float


def pole_bounds(case: Case) -> NDArray[np.float64]:
    """Return the smallest standard deviation of an unbiased estimate of each pole, from the few rows of a case.

    In modal coordinates, where poles are parameters. Their conjugates count as parameters of their own, a linear change
    of real ones. The largest output entry of each mode is held, since a mode has no scale of its own.
    """
    values, V = np.linalg.eig(case.plant.A)
    B, C = np.linalg.solve(V, case.plant.B), case.plant.C @ V
    u, y = case.few
    x = np.column_stack([_filtered(u @ row, pole) for row, pole in zip(B, values, strict=True)])
    e = y - (x @ C.T).real
    by_pole = np.column_stack([_filtered(state, pole) for state, pole in zip(x.T, values, strict=True)])
    by_gain = [_filtered(np.hstack([u, e]), pole) for pole in values]
    held = np.abs(C).argmax(axis=0)
    parts = []
    for j, deviation in enumerate(case.noise):
        by_output = [x[:, i : i + 1] * (np.delete(np.arange(len(C)), held[i]) == j) for i in range(len(values))]
        driven = [C[j, i] * part for i, part in enumerate(by_gain)]
        parts.append(np.hstack([C[j] * by_pole, *driven, *by_output]) / deviation)
    gradient = np.vstack(parts)
    size = np.linalg.norm(gradient, axis=0)
    R = qr(gradient / size, mode="r", check_finite=False)[0][: len(size)]
    inverse = solve_triangular(R, np.eye(len(size)))[: len(values)] / size[: len(values), None]
    return np.linalg.norm(inverse, axis=1) / np.sqrt(USED)


def _filtered(signal: NDArray, pole: complex) -> NDArray:
    """Return the states of a mode that a signal drives."""
    return np.asarray(lfilter([0, 1], [1, -pole], signal, axis=0))


def pole_errors(plant: rs.Plant, model: rs.identify.IdentifiedModel) -> NDArray[np.float64]:
    """Return how far each pole of a plant is from the one of the model that is matched with it."""
    distance = np.abs(np.linalg.eigvals(plant.A)[:, None] - np.linalg.eigvals(model.plant.A))
    return distance[linear_sum_assignment(distance)]


def poles_of(number: int, past: int | None) -> list[Pole]:
    """Return the poles of one plant."""
    case = generated_case(number)
    models = [
        rs.identify.subspace(*recording, order=case.order, dt=1.0, past="auto" if past is None else past)
        for recording in (case.few, case.long)
    ]
    errors = [pole_errors(case.plant, model) for model in models]
    return [Pole(case.order, *map(float, one)) for one in zip(pole_bounds(case), *errors, strict=True)]


def rows_of_table(poles: list[Pole]) -> Iterator[list[str]]:
    """Yield a row for each group: root mean squares of errors over their bounds, medians of by how much they shrink."""
    low = 0.0
    for high in BOUNDS:
        group = [one for one in poles if low <= one.bound < high]
        name = f"{low:g} to {high:g}" if np.isfinite(high) else f"over {low:g}"
        if group:
            over = np.median([one.many / (one.bound / 4) for one in group])
            shrunk = np.exp(np.median([np.log(one.few / one.many) for one in group]))
            small = sum(one.order <= 6 for one in group)
            yield [name, str(len(group)), str(small), f"{over:.2f}", f"{shrunk:.2f}"]
        low = high


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", type=int, default=200)
    parser.add_argument("--past", type=int, help="rows of the past; writes nothing")
    options = parser.parse_args()
    warnings.simplefilter("ignore", FutureWarning)
    poles: list[Pole] = []
    for number in range(options.plants):
        poles += poles_of(number, options.past)
        if number % 20 == 19 or number == options.plants - 1:
            print(number + 1, *rows_of_table(poles), sep="\n", flush=True)
    if options.past is None:
        with TABLE.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(HEADER)
            writer.writerows(rows_of_table(poles))


if __name__ == "__main__":
    main()
