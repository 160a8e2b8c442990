"""One series through filters of other packages, beside the package's own: the tables of the page on speed.

The task is the residual of a Kalman filter (4 states, 5 inputs, 3 outputs) from recorded inputs and outputs. What all
compute is compared before it is timed. Every figure is the median of interleaved rounds in this one run, of the time
of one thread; what is slow runs over fewer samples.

    python benchmarks/other_packages.py [--rounds 5] [--out docs/data]
"""

from __future__ import annotations

# ruff: noqa: E402
import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import csv
import platform
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import control
import numpy as np
from filterpy.kalman import KalmanFilter
from fused_speed import Rounds, plant, recorded
from scipy import signal
from statsmodels.tsa.statespace.kalman_filter import KalmanFilter as StateSpaceFilter

import residua as rs
from residua.linear.systems import recursion

SAMPLES = 1_000_000
ORDERS = (2, 4, 8, 16, 32, 64)
#: How far the residuals of another package may lie from ours, where both filters have settled.
AGREEMENT = 1e-6


def by_lfilter(system: Any, data: np.ndarray) -> np.ndarray:
    """Return the outputs, every channel through a transfer function of its own."""
    out = np.zeros((len(data), system.n_outputs))
    for j in range(data.shape[1]):
        numerators, denominator = signal.ss2tf(system.A, system.B, system.C, system.D, input=j)
        for i, numerator in enumerate(numerators):
            out[:, i] += signal.lfilter(numerator, denominator, data[:, j])
    return out


def by_filterpy(made: rs.Plant, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the innovations of filterpy's Kalman filter, which goes on with its covariance at every sample."""
    kalman = KalmanFilter(dim_x=made.n_states, dim_z=made.n_outputs, dim_u=len(made.inputs))
    kalman.F, kalman.B, kalman.H, kalman.Q, kalman.R = made.A, made.B, made.C, made.Bw @ made.Bw.T, made.Dw @ made.Dw.T
    kalman.x = np.zeros((made.n_states, 1))
    out = np.empty((len(y), made.n_outputs))
    for k, (now, measured) in enumerate(zip(u, y, strict=True)):
        kalman.update(measured[:, None])
        out[k] = kalman.y[:, 0]
        kalman.predict(now[:, None])
    return out


def by_statsmodels(made: rs.Plant, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the errors of the forecasts of statsmodels' filter (in C), which stops when its covariance has settled."""
    model = StateSpaceFilter(k_endog=made.n_outputs, k_states=made.n_states, k_posdef=made.n_states)
    model.bind(np.ascontiguousarray(y))
    model["design"], model["transition"], model["selection"] = made.C, made.A, np.eye(made.n_states)
    model["state_cov"], model["obs_cov"] = made.Bw @ made.Bw.T, made.Dw @ made.Dw.T
    model["state_intercept"] = np.ascontiguousarray(made.B @ u.T)
    model.initialize_known(np.zeros(made.n_states), np.eye(made.n_states))
    return model.filter().forecasts_error.T


def others(rounds: Rounds) -> list[list[object]]:
    """Return nanoseconds a sample of each package, and times ours."""
    made = plant()
    generator = rs.design.kalman_filter(made)
    system = generator.system
    u, y = recorded(made, SAMPLES)
    data = np.hstack([u, y])
    target, few, fewer = np.empty_like(data), 50_000, 5_000
    linear = control.ss(system.A, system.B, system.C, system.D, dt=1)
    times = np.arange(few)
    sampled = signal.dlti(system.A, system.B, system.C, system.D, dt=1.0)
    monitor = rs.Monitor(generator, test=rs.decide.NormThreshold(false_alarm_rate=1e-9), isolate=None)
    calls: dict[str, tuple[int, Callable[[], Any]]] = {
        "copying inputs and outputs": (SAMPLES, lambda: np.copyto(target, data)),
        "residua: generator.run": (SAMPLES, lambda: generator.run(u, y)),
        "residua: Monitor.run, with its diagnosis": (SAMPLES, lambda: monitor.run(u, y)),
        "scipy.signal.lfilter, each channel": (few, lambda: by_lfilter(system, data[:few])),
        "scipy.signal.dlsim": (few, lambda: signal.dlsim(sampled, data[:few])[1]),
        "control.forced_response": (
            few,
            lambda: control.forced_response(linear, times, data[:few].T).outputs.T,
        ),
        "statsmodels, KalmanFilter": (few, lambda: by_statsmodels(made, u[:few], y[:few])),
        "filterpy, KalmanFilter": (fewer, lambda: by_filterpy(made, u[:fewer], y[:fewer])),
    }
    expected = generator.run(u, y)
    for name, (count, call) in calls.items():
        if not name.startswith(("copying", "residua")):
            half = slice(count // 2, count)
            far = np.abs(np.asarray(call())[half] - expected[half]).max()
            assert far < AGREEMENT, f"{name} computes something else: {far:.2g}"
    taken = rounds.medians({name: call for name, (_, call) in calls.items()})
    each = {name: 1e9 * taken[name] / count for name, (count, _) in calls.items()}
    own = each["residua: generator.run"]
    return [[name, f"{value:.3g}", f"{value / own:.3g}"] for name, value in each.items()]


def orders(rounds: Rounds) -> list[list[object]]:
    """Return how the filter alone runs at several orders, with as many inputs and outputs as states."""
    kernel, path = recursion._kernel, recursion.best_path()
    assert kernel is not None
    rng = np.random.default_rng(0)
    square = rng.standard_normal((1000, 1000))
    out = np.empty_like(square)
    rows: list[list[object]] = []
    for n in ORDERS:
        A = rng.standard_normal((n, n))
        A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
        B, C, D = (rng.standard_normal(shape) for shape in ((n, 2 * n), (n, n), (n, 2 * n)))
        samples = 2_000_000 // n
        v, r = rng.standard_normal((1, samples, 2 * n)), np.empty((1, samples, n))
        target = np.empty_like(v)
        arrays = (A, B, C, D, np.zeros((1, n)), v, np.empty((1, n)), r, path)
        taken = rounds.medians(
            {
                "filter": lambda arrays=arrays: kernel.run(*arrays),
                "copy": lambda target=target, v=v: np.copyto(target, v),
                "dgemm": lambda: np.matmul(square, square, out=out),
            }
        )
        flops = 2 * (2 * n) * (3 * n) * samples / taken["filter"]
        peak = 2 * 1000**3 / taken["dgemm"]
        nanoseconds = 1e9 * taken["filter"] / samples
        values = (nanoseconds, taken["filter"] / taken["copy"], flops / 1e9, flops / peak)
        rows.append([n, *(f"{value:.3g}" for value in values)])
    return rows


def machine() -> list[list[object]]:
    """Return what the figures were measured on."""
    processor = next(
        (line.split(":")[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")),
        platform.processor(),
    )
    packages = ("residua", "numpy", "scipy", "control", "filterpy", "statsmodels")
    vectors = ("plain C", "vectors of two numbers", "AVX2")[recursion.best_path()]
    return [
        ["processor", f"{processor}, {os.cpu_count()} cores, {platform.machine()}"],
        ["kernel", vectors],
        ["Python", platform.python_version()],
        *([name, version(name)] for name in packages),
    ]


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).exists() else []


def written(path: Path, header: list[str], rows: list[list[object]]) -> None:
    """Print a table, and write it."""
    print(*(", ".join(map(str, row)) for row in [header, *rows]), sep="\n")
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("docs/data"))
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # of other packages
    rounds = Rounds(options.rounds)
    written(options.out / "speed_of_others.csv", ["what", "ns a sample", "times generator.run"], others(rounds))
    header = ["states", "ns a sample", "copies of its inputs", "Gflop/s", "share of dgemm"]
    written(options.out / "speed_by_order.csv", header, orders(rounds))
    written(options.out / "speed_machine.csv", ["what", "version"], machine())


if __name__ == "__main__":
    main()
