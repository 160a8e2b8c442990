"""Design time against the number of states."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import residua as rs


def plant(n: int) -> rs.Plant:
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n)) / np.sqrt(n) - np.eye(n)
    p = max(3, n // 4)
    made = rs.Plant(A, rng.standard_normal((n, 2)), rng.standard_normal((p, n)))
    made = made.with_disturbances(rng.standard_normal((n, 1)))
    made = made.with_faults({"f1": rng.standard_normal(n), "f2": rng.standard_normal(n)})
    return made.with_noise(process=1.0, measurement=0.1)


@pytest.mark.parametrize("n", [4, 16, 64])
@pytest.mark.parametrize(
    "task",
    [
        rs.diagnosability,
        lambda p: rs.design.unknown_input_observer(p).residual_generator(),
        rs.design.detection_filter,
        rs.design.robust_detection_filter,
        rs.design.kalman_filter,
    ],
    ids=["diagnosability", "unknown_input_observer", "detection_filter", "robust_detection_filter", "kalman_filter"],
)
def test_design(benchmark: Callable, task: Callable, n: int) -> None:
    benchmark.group = f"{n} states"  # pyright: ignore[reportFunctionMemberAccess]
    benchmark(task, plant(n))
