"""What a monitor without a single option sees: lasting faults of every sensor, actuator and listed component.

Run it with::

    .venv/bin/python benchmarks/default_faults.py --out docs/data/default_faults.csv

A row for each plant, fault that is detectable when it is constant, and size: for the Kalman filter with the default
test, for ``suggest(plant).best``, for CUSUM on the same Kalman filter and for the best of the tests that were tried,
the share of 1,500 faulty samples in alarm, the samples to the alarm, and for the first two whether the first name is
right at the last sample of the alarm that is over the threshold; of the Kalman filter also at the sample that raises it
and 50 samples later.

One sigma of a sensor fault is the deviation of its measurement noise; one of another fault moves one output by one such
deviation in the end. A monitor is fitted to 20,000 rows, at the rate that these carry, and run over 500 healthy and
1,500 faulty rows. Inputs are uniform and held for 50 rows; unstable plants have an inner loop, and plants with unknown
disturbances have these, of 5 sigma.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

import residua as rs

ROWS, HEALTHY, FAULTY, SIZES = 20_000, 500, 1500, (3, 5, 10)
#: Rows before those that are used, for the plant to settle.
LEAD = 3000
HEADER = (
    "plant", "fault", "kind", "sigma", "Kalman: share", "delay", "named", "suggest: share", "delay", "named",
    "CUSUM: share", "delay", "best: share", "best test", "Kalman, named at once", "after 50",
)  # fmt: skip
#: Beside the default, on the same Kalman filter.
OTHERS = {
    "CUSUM": rs.decide.CUSUM(),
    "EWMA": rs.decide.EWMA(),
    "norm of 50": rs.decide.NormThreshold(window=50, persistence=1),
}


def motor() -> rs.Plant:
    """Return a DC motor, with other numbers than those of the studies."""
    A, outputs = [[-8, 1.2], [-0.03, -1.5]], ["speed", "current"]
    plant = rs.Plant(A, [[0], [1.5]], np.eye(2), name="motor", inputs=["V"], outputs=outputs)
    return plant.discretize(0.01).with_noise(process=2e-5, measurement=2e-3)


def tanks() -> rs.Plant:
    """Return three tanks."""
    A = [[-0.012, 0, 0.012], [0, -0.02, 0.011], [0.012, 0.011, -0.023]]
    B = [[0.006, 0], [0, 0.006], [0, 0]]
    plant = rs.Plant(A, B, np.eye(3), name="tanks", inputs=["Q1", "Q2"], outputs=["h1", "h2", "h3"])
    plant = plant.with_faults({"leak 1": [-1, 0, 0], "leak 3": [0, 0, -1], "clog 32": [0, -1, 1]})
    return plant.discretize(1.0).with_noise(process=5e-5, measurement=0.01)


def heater() -> rs.Plant:
    """Return a heater with two thermometers."""
    A, outputs = [[-0.05, 0.02], [0.02, -0.03]], ["T1", "T2"]
    plant = rs.Plant(A, [[0.04], [0]], np.eye(2), name="heater", inputs=["power"], outputs=outputs)
    return plant.discretize(1.0).with_noise(process=1e-4, measurement=4e-2)


def masses() -> rs.Plant:
    """Return two masses on springs, with their positions."""
    A = [[0, 1, 0, 0], [-3, -0.5, 2, 0.1], [0, 0, 0, 1], [2, 0.1, -2.5, -0.4]]
    C = [[1, 0, 0, 0], [0, 0, 1, 0]]
    plant = rs.Plant(A, [[0], [1], [0], [0]], C, name="masses", inputs=["force"], outputs=["x1", "x2"])
    return plant.discretize(0.05).with_noise(process=1e-5, measurement=1e-3)


def plants() -> Iterator[rs.Plant]:
    """Yield all plants with noise, sampled, with what may fail."""
    library = rs.library
    named = {
        "three_tank": (library.three_tank(), 1.0),
        "vtol": (library.vtol(), 0.02),
        "jet_engine": (library.jet_engine(disturbances=False), 0.02),
        "twardy": (library.twardy(), 0.1),
        "ladder_circuit": (library.ladder_circuit(), 0.05),
        "gertler": (library.gertler(), 0.0),
    }
    for plant in (motor(), tanks(), heater(), masses()):
        yield plant.with_actuator_faults().with_sensor_faults()
    for plant, step in named.values():
        missing = {fault.component for fault in plant.fault_list}
        if not set(plant.outputs) & missing:
            plant = plant.with_sensor_faults()
        if not set(plant.inputs) & missing:
            plant = plant.with_actuator_faults()
        plant = plant if plant.is_discrete else plant.discretize(step)
        yield _with_noise(plant)


def _with_noise(plant: rs.Plant) -> rs.Plant:
    """Return a plant with the noise that ``suggest`` assumes where none is given."""
    if plant.noises:
        return plant
    gain = np.abs(plant.C @ np.linalg.pinv(np.eye(plant.n_states) - plant.A) @ plant.B).sum(axis=1) + np.abs(
        plant.D
    ).sum(axis=1)
    size = np.where(gain > 1e-9, gain, 1.0)
    state = np.abs(np.linalg.pinv(np.eye(plant.n_states) - plant.A) @ plant.B).sum(axis=1)
    return plant.with_noise(
        process=np.diag((0.003 * np.where(state > 1e-9, state, 1.0)) ** 2), measurement=np.diag((0.1 * size) ** 2)
    )


@dataclass(frozen=True)
class Simulated:
    """A plant as it runs: with an inner loop where it is unstable."""

    plant: rs.Plant

    def outputs(
        self, rng: np.random.Generator, rows: int, fault: str = "", size: float = 0.0
    ) -> tuple[NDArray, NDArray]:
        """Return inputs and outputs, with disturbances; a fault begins after the healthy rows."""
        u, y = self.undisturbed(rng, rows, fault, size)
        return u, y + self.disturbed(rng, rows)

    def undisturbed(
        self, rng: np.random.Generator, rows: int, fault: str = "", size: float = 0.0
    ) -> tuple[NDArray, NDArray]:
        """Return the same without disturbances."""
        r, w = self.signals(rng, 1, rows + LEAD)
        f = np.zeros((1, rows + LEAD, len(self.plant.faults)))
        if fault:
            f[0, LEAD + HEALTHY :, self.plant.faults.index(fault)] = size
        u, y = self.respond(r, w, f)
        return u[0, LEAD:], y[0, LEAD:]

    def disturbed(self, rng: np.random.Generator, rows: int) -> NDArray | float:
        """Return what unknown disturbances do: each uniform up to 5 sigma of an output, and another every 200 rows."""
        plant = self.plant
        if not plant.disturbances:
            return 0.0
        noise = np.sqrt(np.diag(plant.Dw @ plant.Dw.T))
        settled = plant.C @ np.linalg.solve(np.eye(plant.n_states) - plant.A, plant.Bd) + plant.Dd
        sizes = 5 / np.max(np.abs(settled) / noise[:, None], axis=0)
        d = np.repeat(rng.uniform(-1, 1, ((rows + LEAD) // 200 + 1, len(sizes))), 200, axis=0)[: rows + LEAD]
        return plant.system(("disturbance",)).simulate(d * sizes)[LEAD:]

    def signals(self, rng: np.random.Generator, count: int, rows: int) -> tuple[NDArray, NDArray]:
        """Return inputs and noise of some recordings, both of shape (count, rows, channels)."""
        plant = self.plant
        held = rng.uniform(-1, 1, (count, rows // 50 + 1, len(plant.inputs)))
        w = rng.standard_normal((count, rows, plant.Bw.shape[1]))
        return np.repeat(held, 50, axis=1)[:, :rows], w

    def respond(self, r: NDArray, w: NDArray, f: NDArray, A: NDArray | None = None) -> tuple[NDArray, NDArray]:
        """Return inputs and outputs of some recordings from rest: by inputs, noise and faults over time.

        ``A`` is there instead of the plant's, for each recording.
        """
        plant, K = self.plant, self.gain()
        closed = (plant.A if A is None else A) - plant.B @ K
        moved = r @ plant.B.T + w @ plant.Bw.T + f @ plant.Bf.T
        x = np.zeros_like(moved)
        for t in range(1, x.shape[1]):
            x[:, t] = (closed @ x[:, t - 1, :, None])[..., 0] + moved[:, t - 1]
        u = r - x @ K.T
        return u, x @ plant.C.T + u @ plant.D.T + w @ plant.Dw.T + f @ plant.Df.T

    def gain(self) -> NDArray[np.float64]:
        """Return the gain of the inner loop; zero for a stable plant."""
        plant = self.plant
        A, B = np.asarray(plant.A), np.asarray(plant.B)
        if np.abs(np.linalg.eigvals(A)).max() < 1 - 1e-6:
            return np.zeros((len(plant.inputs), plant.n_states))
        X = solve_discrete_are(A, B, np.eye(len(A)), np.eye(B.shape[1]))
        return np.linalg.solve(np.eye(B.shape[1]) + B.T @ X @ B, B.T @ X @ A)

    def sigma(self, fault: str) -> float:
        """Return one sigma of a fault."""
        plant, column = self.plant, self.plant.faults.index(fault)
        noise = np.sqrt(np.diag(plant.Dw @ plant.Dw.T))
        if plant.fault_list[column].kind == "sensor":
            reach = np.abs(plant.Df[:, column])
        else:
            A = plant.A - plant.B @ self.gain()
            C = plant.C - plant.D @ self.gain()
            reach = np.abs(C @ np.linalg.solve(np.eye(len(A)) - A, plant.Bf[:, column]) + plant.Df[:, column])
        ratio = (reach / noise).max(initial=0.0)
        return 1 / float(ratio) if ratio > 1e-9 else 0.0


def monitors(plant: rs.Plant) -> dict[str, rs.Monitor]:
    """Return the monitors that are compared, not fitted."""
    kalman = rs.design.kalman_filter(plant)
    out = {"Kalman": rs.Monitor(kalman)}
    best = rs.suggest(plant).best
    if best is not None:
        out["suggest"] = rs.Monitor(best.made)
    for name, test in OTHERS.items():
        out[name] = rs.Monitor(kalman, test=test, isolate=None)
    return out


def judged(monitor: rs.Monitor, u: NDArray, y: NDArray, fault: str) -> tuple[float, float, list[bool]]:
    """Return the share of faulty samples in alarm, the delay, and whether names are right: last, first, after 50."""
    found = monitor.run(u, y)
    alarm = found.alarm[HEALTHY:]
    delay = float(alarm.argmax()) if alarm.any() else np.inf
    first = next((one for one in found.alarms if one.stop > HEALTHY), None)
    names = [first.candidates if first else ()]
    for later in (0, 50):
        at = None if first is None else min(max(first.start, HEALTHY) + later, first.stop - 1)
        names.append(() if at is None or not found.groups else found.isolation.candidates(found.scores[at]))
    return float(alarm.mean()), delay, [bool(one) and fault in one[0].faults for one in names]


def table(wanted: list[str], seed: int) -> Iterator[tuple[object, ...]]:
    """Yield the rows."""
    for plant in plants():
        if wanted and plant.name not in wanted:
            continue
        simulated, rng = Simulated(plant), np.random.default_rng(seed)
        fitted = monitors(plant)
        u, y = simulated.outputs(rng, ROWS)
        for name, monitor in list(fitted.items()):
            rate = None if name in ("Kalman", "suggest") else fitted["Kalman"].fit_check.held_out.asked  # pyright: ignore
            try:
                monitor.fit(u, y, false_alarm_rate=rate)
            except rs.errors.DataError as error:
                print(f"{plant.name}: {name}: {error}", file=sys.stderr)
                del fitted[name]
        steady = fitted["Kalman"].generator.steady_directions
        for fault in plant.fault_list:
            sigma = simulated.sigma(fault.name)
            if sigma == 0.0 or not np.abs(steady.get(fault.name, np.zeros(1))).max(initial=0.0) > 1e-9:
                continue
            for size in SIZES:
                u, y = simulated.outputs(rng, HEALTHY + FAULTY, fault.name, size * sigma)
                found = {name: judged(monitor, u, y, fault.name) for name, monitor in fitted.items()}
                best = max((name for name in found if name != "suggest"), key=lambda name: found[name][0])
                row: list[object] = [plant.name, fault.name, fault.kind, size]
                for name in ("Kalman", "suggest"):
                    share, delay, right = found.get(name, (np.nan, np.nan, [False]))
                    row += [f"{share:.3f}", f"{delay:g}", "yes" if right[0] else "no"]
                share, delay, _ = found.get("CUSUM", (np.nan, np.nan, []))
                row += [f"{share:.3f}", f"{delay:g}", f"{found[best][0]:.3f}", best]
                yield (*row, *("yes" if right else "no" for right in found["Kalman"][2][1:]))


def summary(rows: list[tuple[object, ...]]) -> Iterator[str]:
    """Yield what was asked for, in words."""
    kind = np.array([row[2] for row in rows])
    sigma, kalman, delay, suggest, cusum, its_delay = (
        np.array([row[k] for row in rows], dtype=float) for k in (3, 4, 5, 7, 10, 11)
    )
    lasting = (sigma == 5) & (kind == "sensor") & (cusum > 0.95)
    if lasting.any():
        yield (
            f"5 sigma, {lasting.sum()} sensor faults that CUSUM sees: in alarm at least .95 of the time in "
            f"{np.mean(kalman[lasting] >= 0.95):.2f} of them, least {kalman[lasting].min():.3f}; median delay "
            f"{np.median(delay[lasting]):g}, CUSUM {np.median(its_delay[lasting]):g}"
        )
    below = suggest < kalman - 0.03
    yield f"suggest's best below the Kalman default by more than .03: {below.sum()} of {len(rows)}"
    named = [("Kalman", 6, kalman), ("suggest", 9, suggest), ("Kalman, at once", 14, kalman)]
    for name, column, share in (*named, ("Kalman, after 50 samples", 15, kalman)):
        right = np.array([row[column] == "yes" for row in rows])[share > 0]
        yield f"first name right, {name}: {right.mean():.3f} of {len(right)} in alarm"


def main() -> None:
    """Print the table, and write it where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plant", nargs="*", default=[])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    rows = []
    for row in table(asked.plant, asked.seed):
        rows.append(row)
        print(*row, sep="\t", flush=True)
    print(*summary(rows), sep="\n")
    if asked.out is not None:
        with asked.out.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])


if __name__ == "__main__":
    sys.exit(main())
