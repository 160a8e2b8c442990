"""One relation for eleven models of an aircraft, against a design on the nominal model alone.

Run it with::

    .venv/bin/python benchmarks/aircraft_models.py DATA

where ``DATA`` holds ``cs2data.npz``: the longitudinal motion of a civil aircraft at eleven masses, with eight sensors,
of A. Varga, Solving Fault Diagnosis Problems (Springer, 2017), chapter 8 (FaultDetectionTools.jl, MIT licence). It
prints a table and writes ``docs/data/aircraft_models.csv``.

The aircraft is sampled at 10 Hz. Controls and wind have rms 1 in the units of the data, both with a correlation time of
5 s; each sensor has white noise of 1 % of what it reads (rms). Every residual sees the fault of one
sensor and treats that of the other as a disturbance. The number given is the *smallest fault*: the constant fault that
moves the settled residual as far as the residual's own rms without a fault; for the nominal model, for the worst of the
eleven, and the ratio of the two.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import residua as rs
from residua.robust.parity.expected_signals import ExpectedSignals
from residua.robust.parity.multi_model_parity import model_spread, multi_model_parity
from residua.robust.parity.optimal_parity import optimal_parity

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "aircraft_models.csv"
STEP, MEMORY, NOISE = 0.1, 5.0, 0.01
NOMINAL = 6
SENSORS = {"AoA": "y2", "VCAS": "y4"}
EXPECTED = {"correlation_time": MEMORY, "noise": True}
Row = dict[str, str | int | float]


def models(path: Path) -> list[rs.Plant]:
    """Return the eleven models, sampled, with sensor noise and faults of angle of attack and airspeed."""
    data = np.load(path)
    plain = []
    for A, B, C, D in zip(*(data[name] for name in "ABCD"), strict=True):
        plant = rs.Plant(A, B[:, :3], C, D[:, :3]).with_disturbances(B[:, 3:], output=D[:, 3:])
        plain.append(plant.with_sensor_faults(list(SENSORS.values())).discretize(STEP))
    window = ExpectedSignals(correlation_time=MEMORY).driven(plain[NOMINAL]).window(0, "the nominal model")
    size = np.sqrt((window[: plain[0].n_outputs] ** 2).sum(axis=1))
    return [plant.with_noise(measurement=(NOISE * size) ** 2) for plant in plain]


def smallest(generator: rs.design.ResidualGenerator, family: list[rs.Plant], fault: str) -> NDArray[np.float64]:
    """Return the smallest fault on each model, by the first residual."""
    leak = model_spread(generator, family, **EXPECTED)[:, 0]
    j = family[0].faults.index(fault)
    gain = []
    for plant in family:  # the gain of a sensor fault does not depend on the model
        y = plant.Df[:, j] + plant.C @ np.linalg.solve(np.eye(plant.n_states) - plant.A, plant.Bf[:, j])
        gain.append(abs(generator.system.dc_gain()[0, len(plant.inputs) :] @ y))
    return leak / np.array(gain)


def designs(family: list[rs.Plant], order: int, fault: str) -> Iterator[tuple[str, rs.design.ResidualGenerator]]:
    """Yield the designs that see one sensor fault and ignore the other."""
    other = [name for name in family[0].faults if name != fault]
    same = {"order": order, "insensitive_to": other}
    alone = family[NOMINAL]
    yield "nominal model, exact", optimal_parity(alone, **same, constant=True).generator
    yield "nominal model, least leak", multi_model_parity([alone], **same, **EXPECTED).generator
    yield (
        "nominal model, faults for leak",
        multi_model_parity([alone], **same, **EXPECTED, criterion="faults").generator,
    )
    others = [plant for i, plant in enumerate(family) if i != NOMINAL]
    yield (
        "optimal against the variants",
        optimal_parity(alone, **same, variants=others, correlation_time=MEMORY, constant=True, noise=True).generator,
    )
    all_ = {**same, **EXPECTED, "nominal": NOMINAL}
    yield "all models, least leak", multi_model_parity(family, **all_).generator
    yield "all models, faults for leak", multi_model_parity(family, **all_, criterion="faults").generator


def table(path: Path) -> list[Row]:
    """Return one row per fault, order and design."""
    family, rows = models(path), []
    for name, sensor in SENSORS.items():
        fault = f"{sensor} sensor"
        for order in (1, 2, 4):
            for design, generator in designs(family, order, fault):
                least = smallest(generator, family, fault)
                rows.append(
                    {
                        "fault": name,
                        "order": order,
                        "design": design,
                        "nominal": least[NOMINAL],
                        "worst": least.max(),
                        "ratio": least.max() / least[NOMINAL],
                    }
                )
    return rows


def main() -> int:
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("data", type=Path, help="folder with cs2data.npz")
    rows = table(parser.parse_args().data / "cs2data.npz")
    OUTPUT.parent.mkdir(exist_ok=True)
    with OUTPUT.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    for row in rows:
        print(
            f"{row['fault']:5} order {row['order']}  {row['design']:32} {row['nominal']:9.4g} {row['worst']:9.4g} "
            f"{row['ratio']:9.3g}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
