"""Running a filter over a million samples, against SciPy and against the memory (``make bench``)."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest
from scipy import signal

from residua.linear.systems import recursion
from residua.linear.systems.recursion import run_filter

SAMPLES = 1_000_000
best: dict[str, float] = {}


@pytest.fixture(scope="module")
def filter_and_data() -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Four states, four inputs, two outputs."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 4))
    A *= 0.95 / np.max(np.abs(np.linalg.eigvals(A)))
    matrices = (A, rng.normal(size=(4, 4)), rng.normal(size=(2, 4)), rng.normal(size=(2, 4)))
    return matrices, rng.normal(size=(1, SAMPLES, 4))


def test_compiled(benchmark, filter_and_data) -> None:
    if not recursion.compiled():
        pytest.skip("built without a C compiler")
    matrices, v = filter_and_data
    benchmark(run_filter, *matrices, np.zeros((1, 4)), v)
    best["compiled"] = benchmark.stats.stats.min / SAMPLES


def test_numpy_fallback(benchmark, filter_and_data, monkeypatch) -> None:
    monkeypatch.setattr(recursion, "_kernel", None)
    matrices, v = filter_and_data
    benchmark.pedantic(run_filter, (*matrices, np.zeros((1, 4)), v[:, :200_000]), rounds=3)
    best["NumPy fallback"] = benchmark.stats.stats.min / 200_000


def test_scipy_dlsim(benchmark, filter_and_data) -> None:
    matrices, v = filter_and_data
    system = signal.dlti(*matrices, dt=1.0)
    _, expected, _ = benchmark.pedantic(signal.dlsim, (system, v[0]), rounds=2)
    best["scipy.signal.dlsim"] = benchmark.stats.stats.min / SAMPLES
    _, r = run_filter(*matrices, np.zeros((1, 4)), v)
    np.testing.assert_allclose(r[0], expected, rtol=1e-8, atol=1e-8)


def test_copy_of_the_same_bytes(benchmark) -> None:
    """Reading four and writing two numbers a sample is the traffic of copying three."""
    benchmark(np.ones(3 * SAMPLES).copy)
    best["memory: plain copy"] = benchmark.stats.stats.min / SAMPLES


def test_one_sample_of_a_million_plants(benchmark, filter_and_data) -> None:
    matrices, v = filter_and_data
    x = np.zeros((SAMPLES, 4))
    benchmark(run_filter, *matrices, x, v.reshape(SAMPLES, 1, 4))
    best["one sample of a million plants"] = benchmark.stats.stats.min / SAMPLES


def test_one_sample_of_one_plant(benchmark, filter_and_data) -> None:
    matrices, v = filter_and_data
    benchmark(run_filter, *matrices, np.zeros((1, 4)), v[:, :1])


def test_summary() -> None:
    """Print the table; the bound is far below what is measured, and catches only a broken build."""
    reference = best["scipy.signal.dlsim"]
    print(f"\n{'4 states, 4 inputs, 2 outputs':32s} {'10^6 samples/s':>16s} {'times dlsim':>12s}")
    for name, seconds in sorted(best.items(), key=lambda item: item[1]):
        print(f"{name:32s} {1e-6 / seconds:16.2f} {reference / seconds:12.1f}")
    if "compiled" in best:
        roofline = best["memory: plain copy"] / best["compiled"]
        print(f"the compiled run reaches {100 * roofline:.0f} % of the speed of a plain copy of the same bytes")
        assert reference / best["compiled"] > 50


def test_import_time() -> None:
    """What ``import residua`` costs on top of its hard dependencies, fresh interpreters, best of seven."""

    def fastest(code: str) -> float:
        times = []
        for _ in range(7):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], check=True)
            times.append(time.perf_counter() - start)
        return min(times)

    base, ours = fastest("import numpy, scipy.linalg"), fastest("import numpy, scipy.linalg, residua")
    print(f"\nimport residua: {ours - base:.3f} s over numpy and scipy.linalg ({base:.3f} s)")
    assert ours - base < 0.35
