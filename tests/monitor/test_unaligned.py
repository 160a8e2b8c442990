"""Arrays whose numbers do not begin at multiples of their size: C must not read them as they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import residua as rs
from residua.linear.systems.recursion import ordered_product, run_filter
from residua.monitor import fused
from residua.monitor.fused import FusedRun, plan_of
from residua.monitor.plant_records import copied
from residua.monitor.running import initial_state
from running_examples import plant, recording


def unaligned(values: Any) -> np.ndarray:
    """Return the same numbers from the second byte of some memory on."""
    array = np.ascontiguousarray(values, dtype=float)
    found = np.frombuffer(b"\0" + array.tobytes(), offset=1).reshape(array.shape)
    assert not found.flags.aligned
    return found


def same(found: Any, expected: Any) -> None:
    np.testing.assert_array_equal(np.asarray(found), np.asarray(expected))


def test_filters_and_products() -> None:
    rng = np.random.default_rng(0)
    A, B, C, D, x = (
        0.3 * rng.random((2, 2)),
        rng.random((2, 3)),
        rng.random((1, 2)),
        rng.random((1, 3)),
        np.ones((1, 2)),
    )
    v = rng.random((1, 50, 3))
    for found, expected in zip(
        run_filter(*map(unaligned, (A, B, C, D, x, v))), run_filter(A, B, C, D, x, v), strict=True
    ):
        same(found, expected)
    same(ordered_product(unaligned(v), unaligned(B.T)), ordered_product(v, B.T))


def test_monitors() -> None:
    u, y = recording(9000)  # generators read long recordings where they lie
    design = rs.design.kalman_filter(plant())
    same(design.run(unaligned(u), unaligned(y)), design.run(u, y))
    made, other = rs.Monitor(design), rs.Monitor(design)
    same(made.run(unaligned(u), unaligned(y)).statistic, other.run(u, y).statistic)  # type: ignore[union-attr]
    same(made.update(unaligned(u[:9]), unaligned(y[:9])).statistic, other.update(u[:9], y[:9]).statistic)
    assert made.step(unaligned(u[9]), unaligned(y[9])).statistic == other.step(u[9], y[9]).statistic


def test_fleets() -> None:
    u, y = recording(40)
    monitor = rs.Monitor(rs.design.kalman_filter(plant()))
    made, other = (rs.Fleet(monitor, plants=range(40)) for _ in range(2))
    same(made.tick(None, unaligned(u), unaligned(y)).statistic, other.tick(None, u, y).statistic)
    blocks = u.reshape(40, 1, -1).repeat(30, axis=1), y.reshape(40, 1, -1).repeat(30, axis=1)
    same(made.update(*map(unaligned, blocks)).alarm, other.update(*blocks).alarm)  # type: ignore[union-attr]
    made.follow(range(40), *map(unaligned, blocks))
    other.follow(range(40), *blocks)
    assert made.snapshot() == other.snapshot()


@pytest.mark.skipif(fused._kernel is None, reason="no compiled kernel")
def test_the_kernel_refuses_them() -> None:
    """So that no path that forgets to copy reads beyond what it may, as it would with other exporters of buffers."""
    spec = rs.Monitor(rs.design.kalman_filter(plant()))._specification()
    plan = plan_of(spec)
    assert plan is not None
    run = FusedRun(spec, plan, copied(initial_state(spec, 2)), inputs=1)
    channels = int(plan.integers[1]) - 1
    y: Any = memoryview(bytes(80 * channels + 1))[1:].cast("d", [2, 5, channels])
    with pytest.raises(ValueError, match="aligned"):
        run.run(np.zeros((2, 5, 1)), y, run.outputs(2, 5))
