"""What polynomials cost: parity relations of high order beside observers, on the same data, in double precision.

Run it with::

    .venv/bin/python benchmarks/parity_conditioning.py

It writes ``docs/data/parity_conditioning.csv`` (one row per family of plants and order) and
``docs/data/parity_conditioning_all.csv`` (one row per method besides, with the numbers that the other sums up).

All data are exact to rounding, so that a residual without a fault shows nothing but the rounding that the filter makes
of it. The *leak* is the size (rms) of that residual over the change of the residual that a step fault leaves once it
has settled; the fault is as large as it must be to change some output by as much as the input moves it.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import residua as rs
from residua.design.parity.relation_model import relation_model
from residua.design.parity.relations import ParityRelations, relations_of
from residua.design.parity.shortest import shortest_space
from residua.errors import AccuracyError, DesignError
from residua.linear.polynomials.polynomial_basis import PolynomialBasis

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data"
ORDERS = (2, 4, 6, 8, 10, 12, 15, 20, 25, 30)
SEEDS = 10
LENGTH = 12000  # the slowest poles, 0.999, settle in 5000 samples
ROW = "01"  # ignores the first fault, answers to the second
LOST = "digits lost to cancellation"

Run = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


# ----------------------------------------------------------------------- plants


def near_one(n: int, seed: int) -> rs.Plant:
    """Return a plant with poles from 0.7 to 0.999, most of them slow, and two outputs: one relation, of order n - 1."""
    rng = np.random.default_rng([seed, n])
    poles = 1 - 10 ** rng.uniform(-3, np.log10(0.3), n)
    slow = np.sqrt(1 - poles)  # couplings that suit the rates of what they couple: no gain piles up
    A = np.diag(poles) + np.triu(0.3 * rng.standard_normal((n, n)) * slow[:, None] * slow, 1)
    return _in_units(A, 2, rng)


def spread(n: int, seed: int) -> rs.Plant:
    """Return a plant with poles all over the disc of radius 0.95 and five outputs: relations of low order."""
    rng = np.random.default_rng([seed, n, 1])
    A = np.zeros((n, n))
    for j in range(0, n - 1, 2):
        radius, angle = 0.95 * np.sqrt(rng.uniform()), rng.uniform(0, np.pi)
        c, s = radius * np.cos(angle), radius * np.sin(angle)
        A[j : j + 2, j : j + 2] = [[c, -s], [s, c]]
    if n % 2:
        A[-1, -1] = rng.uniform(-0.9, 0.9)
    return _in_units(A + np.triu(0.06 * rng.standard_normal((n, n)), 2), 5, rng)


def _in_units(A: NDArray, outputs: int, rng: np.random.Generator, decades: float = 3.0) -> rs.Plant:
    """Return a plant in random coordinates, with states and outputs in units over ``10^-3`` to ``10^3``."""
    n = len(A)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    B, C, F = rng.standard_normal((n, 1)), rng.standard_normal((outputs, n)), rng.standard_normal((n, 2))
    T, Y = 10 ** rng.uniform(-decades, decades, n), 10 ** rng.uniform(-decades, decades, outputs)
    plant = rs.Plant(Q @ A @ Q.T / T[:, None] * T, B / T[:, None], Y[:, None] * C * T, dt=1.0)
    return plant.with_faults({"ignored": F[:, 0] / T, "seen": F[:, 1] / T})


def known_order(plant: rs.Plant) -> int:
    """Return the order of the shortest relation that ignores one fault, generically: by counting, as eq. (4-4)."""
    n, m = plant.n_states, plant.n_outputs
    return next(k for k in range(1, n + 1) if (k + 1) * m > n + k)  # of order 0: no trace of what enters the states


FAMILIES = {"near one": near_one, "spread": spread}


# ---------------------------------------------------------------------- methods


@dataclass(frozen=True, eq=False)
class Made:
    """A residual, as something that runs, with what is known of it."""

    run: Run
    order: int
    lost: float = np.nan


def textbook(plant: rs.Plant) -> Made:
    """Chow and Willsky's parity vector from powers of ``A``: the last left singular vector, at the known order."""
    k = known_order(plant)
    R, Q = rs.design.chow_willsky_matrices(plant, k)
    m, faults = plant.n_outputs, len(plant.faults)
    ignored = np.hstack([R, Q["fault"][:, 0::faults]])
    w = np.linalg.svd(ignored)[0][:, -1]
    on_inputs = w @ Q["control"]
    w = w.reshape(k + 1, m)

    def run(u: NDArray, y: NDArray) -> NDArray:
        r = np.zeros((len(y), 1))
        for j in range(k + 1):  # the oldest sample first
            terms = y @ w[j] - u @ on_inputs[j * u.shape[1] : (j + 1) * u.shape[1]]
            r[k:, 0] += terms[j : len(y) - k + j]
        return r

    return Made(run, k)


def relation(plant: rs.Plant) -> ParityRelations:
    """Return the shortest relation, before it is given any poles."""
    model = relation_model(plant)
    seen = [plant.faults.index("seen")]
    space = shortest_space(model, model.equations(["ignored"]), seen)
    return relations_of(plant, [space.best(seen)])


def moving_average(plant: rs.Plant) -> Made:
    """The shortest relation as it stands: all poles at zero."""
    made = relation(plant)
    return _of(made.with_poles(np.zeros(made.orders[0])))  # asked for, however many digits cancel


def with_poles(plant: rs.Plant) -> Made:
    """The shortest relation with its poles where the observer would have them: all at the plant's own rate."""
    made = relation(plant)
    return _of(made.with_poles(np.full(made.orders[0], np.exp(-own_rate(plant)))))


def with_plant_poles(plant: rs.Plant) -> Made:
    """The shortest relation with poles of the plant, far from each other."""
    made = relation(plant)
    k = made.orders[0]
    nodes = PolynomialBasis.on(np.linalg.eigvals(plant.A))
    k -= bool(k and nodes.imaginary[k - 1])  # no half of a pair
    real, imaginary = nodes.real[:k], nodes.imaginary[:k].copy()
    second = np.flatnonzero(imaginary) + 1
    imaginary[second] = -imaginary[second - 1]
    return _of(made.with_poles(np.concatenate([real + 1j * imaginary, np.zeros(made.orders[0] - k)])))


def without_options(plant: rs.Plant) -> Made:
    """The shortest relation with the poles that it has when none are asked for."""
    return _of(relation(plant).with_poles())


def observer(plant: rs.Plant) -> Made:
    """The geometric residual that ignores the same."""
    return _of(rs.design.structured_bank(plant, [ROW]).generator)


def slow_observer(plant: rs.Plant) -> Made:
    """The same with a tenth of the default margin."""
    return _of(rs.design.structured_bank(plant, [ROW], margin=0.1 * own_rate(plant)).generator)


METHODS: dict[str, Callable[[rs.Plant], Made]] = {
    "textbook": textbook,
    "moving average": moving_average,
    "poles at one rate": with_poles,
    "poles of the plant": with_plant_poles,
    "without options": without_options,
    "observer": observer,
    "slow observer": slow_observer,
}


def own_rate(plant: rs.Plant) -> float:
    """Return the default margin of designs: the geometric mean of the rates of the plant's poles, in 1/s."""
    return rs.linear.default_margin(plant.A, plant.dt)


def _of(made: rs.design.ResidualGenerator) -> Made:
    order = made.relations.orders[0] if made.relations is not None else made.system.n_states
    return Made(made.run, order, made.evidence.conditions.get(LOST, np.nan))


# ----------------------------------------------------------------- measurements


def leaks(run: Run, plant: rs.Plant, seed: int) -> dict[str, float]:
    """Return what a residual without a fault is, over the change that a fault leaves in it, for two kinds of input."""
    rng = np.random.default_rng([seed, 99])
    white = rng.standard_normal((LENGTH, 1))
    system = plant.system(("control", "fault"))
    fault = np.zeros((LENGTH, 2))
    fault[LENGTH // 2 :, 1] = 1.0
    change = system.simulate(np.hstack([np.zeros((LENGTH, 1)), fault]))
    last = slice(5 * LENGTH // 6, None)
    out = {}
    for name, u in (("slow", np.cumsum(white, axis=0) / 30), ("fast", white)):
        y = system.simulate(np.hstack([u, 0 * fault]))
        size = 1 / np.max(_rms(change[last]) / _rms(y[last]))
        silent, fired = run(u, y), run(0 * u, size * change)
        out[name] = float((_rms(silent[last]) / np.maximum(_rms(fired[last]), 1e-300)).max())
    return out


def _rms(x: NDArray) -> NDArray[np.float64]:
    return np.sqrt((x**2).mean(axis=0))


@dataclass
class Outcome:
    """One method on one plant; without an order when it was refused."""

    seconds: float
    order: int | None = None
    lost: float = np.nan
    slow: float = np.nan
    fast: float = np.nan
    reason: str = ""


def measure(method: str, plant: rs.Plant, seed: int) -> Outcome:
    """Design and run once."""
    started = time.perf_counter()
    try:
        made = METHODS[method](plant)
    except (AccuracyError, DesignError) as error:
        return Outcome(time.perf_counter() - started, reason=str(error))
    seconds = time.perf_counter() - started
    found = leaks(made.run, plant, seed)
    return Outcome(seconds, made.order, made.lost, found["slow"], found["fast"])


def table(orders: tuple[int, ...] = ORDERS, seeds: int = SEEDS) -> Iterator[tuple[str, int, int, dict]]:
    """Yield for each family and order the known order of the relation and the outcomes, a list for each method."""
    for family, make in FAMILIES.items():
        for n in orders:
            plants = [make(n, seed) for seed in range(seeds)]
            outcomes = {name: [measure(name, p, seed) for seed, p in enumerate(plants)] for name in METHODS}
            yield family, n, known_order(plants[0]), outcomes


# ------------------------------------------------------------------- the tables


def both(done: list[Outcome]) -> NDArray[np.float64]:
    """Return the leaks of those that were not refused, for both kinds of input."""
    return np.array([leak for one in done if one.order is not None for leak in (one.slow, one.fast)])


def cell(done: list[Outcome]) -> str:
    """Return median and worst leak, and how many were refused."""
    values, refused = both(done), sum(one.order is None for one in done)
    told = f"{np.median(values):.0e} ({values.max():.0e})" if len(values) else ""
    return "; ".join(filter(None, [told, f"{refused} refused" if refused else ""]))


def summary(family: str, n: int, known: int, outcomes: dict[str, list[Outcome]]) -> list[str]:
    """Return the row of the short table."""
    relations = outcomes["moving average"]
    lost = [one.lost for one in relations if one.order is not None]
    return [
        *(family, str(n), str(known)),
        *(cell(outcomes[name]) for name in METHODS),
        f"{np.median(lost):.0f}" if lost else "",
        str(sum(relation(FAMILIES[family](n, seed)).orders[0] == known for seed in range(len(relations)))),
        *(f"{np.median([one.seconds for one in outcomes[name]]):.2g}" for name in ("moving average", "observer")),
    ]


HEADER = [
    *("plants", "n", "order", "textbook", "relation, moving average", "relation, poles at one rate"),
    *("relation, poles of the plant", "relation, without options", "observer", "observer, slow"),
    *("digits lost", "order found"),
    *("relation (s)", "observer (s)"),
]
ALL_HEADER = [
    *("plants", "n", "order", "method", "plants tried", "refused", "order found", "digits lost"),
    *(
        "leak, slow input",
        "worst, slow input",
        "leak, fast input",
        "worst, fast input",
        "seconds",
        "first reason of a refusal",
    ),
]


def every_method(family: str, n: int, known: int, outcomes: dict[str, list[Outcome]]) -> Iterator[list[str]]:
    """Yield the rows of the long table."""
    for name, done in outcomes.items():
        good = [one for one in done if one.order is not None]
        reasons = [" ".join(one.reason.split())[:200] for one in done if one.reason]
        leak = [[f"{np.median(x):.1e}", f"{max(x):.1e}"] if x else ["", ""] for x in _by_input(good)]
        right = sum(one.order == known for one in good) if "observer" not in name else ""
        yield [
            *(family, str(n), str(known), name, str(len(done)), str(len(done) - len(good)), str(right)),
            f"{np.median([one.lost for one in good]):.1f}" if good and np.isfinite(good[0].lost) else "",
            *(*leak[0], *leak[1]),
            f"{np.median([one.seconds for one in done]):.2g}",
            reasons[0] if reasons else "",
        ]


def _by_input(good: list[Outcome]) -> tuple[list[float], list[float]]:
    return [one.slow for one in good], [one.fast for one in good]


def main(arguments: list[str] | None = None) -> int:
    """Make the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder for the tables")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="plants of each order and family")
    options = parser.parse_args(arguments)
    short, long = [HEADER], [ALL_HEADER]
    for row in table(seeds=options.seeds):
        short.append(summary(*row))
        long.extend(every_method(*row))
        print(" | ".join(short[-1]), flush=True)
    options.output.mkdir(parents=True, exist_ok=True)
    for name, rows in (("parity_conditioning.csv", short), ("parity_conditioning_all.csv", long)):
        with (options.output / name).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
