"""A Kalman filter with missing values has the bits of NumPy in the loop: by samples, by ticks and by recordings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import residua as rs
from fused_examples import same, same_in_pieces
from residua.decide import NormThreshold
from residua.monitor import fused
from residua.monitor.fused import ALARM, DECIDED, MISSING, OUTPUTS, FusedRun, plan_of
from residua.monitor.plant_records import copied, rows_of, written_rows
from residua.monitor.running import initial_state, run_reference
from residua.monitor.specification import Specification

needs_kernel = pytest.mark.skipif(fused._kernel is None, reason="there is no compiled kernel")


@cache
def specification(states: int, inputs: int, outputs: int, direct: bool, starts: bool) -> Specification:
    """Return what runs of a plant with correlated noise, whose inputs act on some outputs at once where ``direct``."""
    rng = np.random.default_rng(100 * states + 10 * inputs + outputs)
    A = rng.standard_normal((states, states))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    D = rng.standard_normal((outputs, inputs)) * (rng.random((outputs, inputs)) < 0.4) * direct
    B, C = rng.standard_normal((states, inputs)), rng.standard_normal((outputs, states))
    process, measurement = rng.standard_normal((states, states)), rng.standard_normal((outputs, outputs))
    made = rs.Plant(A, B, C, D, dt=1).with_sensor_faults().with_noise(
        process=0.1 * process @ process.T, measurement=0.1 * measurement @ measurement.T + 0.3 * np.eye(outputs)
    )  # fmt: skip
    test = NormThreshold(threshold=3.0)
    start = "estimated" if starts else "rest"
    return rs.Monitor(rs.design.kalman_filter(made), test=test, isolate=None, start=start)._specification()


def recorded(spec: Specification, rng: np.random.Generator, plants: int, samples: int, share: float) -> np.ndarray:
    """Return data of plants: whole at first, then with so many values missing, in long gaps too; one may overflow."""
    data = rng.standard_normal((plants, samples, spec.B.shape[1])) + spec.offset
    holes = rng.random(data.shape) < share
    holes[:, : int(rng.integers(0, samples))] = False
    data[holes] = rng.choice([np.nan, np.inf, -np.inf], int(holes.sum()))
    for plant in range(plants):
        begin, length = rng.integers(samples), rng.integers(1, 40)
        data[plant, begin : begin + length, rng.random(data.shape[2]) < rng.choice([0.3, 1.0])] = np.nan
    data[0, rng.integers(samples, size=2), rng.integers(data.shape[2])] = rng.choice([1.0, 1e140, 1e160, 1e305])
    return data


drawn = given(
    shape=st.sampled_from(((1, 0, 1), (2, 1, 2), (3, 2, 3), (4, 5, 3), (4, 1, 5), (9, 2, 2))),
    direct=st.booleans(),
    starts=st.booleans(),
    share=st.sampled_from((0.01, 0.2, 0.7)),
    hold=st.sampled_from((0, 3, 1000)),
    seed=st.integers(0, 2**32 - 1),
)


def chosen(shape: tuple[int, int, int], direct: bool, starts: bool, hold: int) -> Specification:
    spec = specification(*shape, direct, starts)
    assert spec.partial is not None
    assert plan_of(spec) is not None
    limits = np.tile([-1e306, 1e306], (spec.B.shape[1], 1))
    return replace(spec, max_hold=hold, plausible=limits)


@needs_kernel
@settings(max_examples=20, deadline=None)
@drawn
def test_recordings_have_the_bits_of_numpy(
    shape: tuple[int, int, int], direct: bool, starts: bool, share: float, hold: int, seed: int
) -> None:
    spec, rng = chosen(shape, direct, starts, hold), np.random.default_rng(seed)
    data = recorded(spec, rng, 3, int(rng.integers(2, 250)), share)
    same_in_pieces(spec, data, rng)


@needs_kernel
@settings(max_examples=8, deadline=None)
@drawn
@pytest.mark.parametrize("path", [0, 1, 2])
def test_ticks_have_the_bits_of_numpy(
    path: int, shape: tuple[int, int, int], direct: bool, starts: bool, share: float, hold: int, seed: int
) -> None:
    if path > fused.best_path():
        pytest.skip("this processor has no such path")
    spec, rng = chosen(shape, direct, starts, hold), np.random.default_rng(seed)
    plan, plants, inputs = plan_of(spec), int(rng.choice([2, 35])), int(rng.integers(0, spec.B.shape[1] + 1))
    assert plan is not None
    data = recorded(spec, rng, plants, 25, share)
    state = initial_state(spec, plants)
    keep = OUTPUTS if rng.random() < 0.5 else ("missing", "usable", "statistic", "alarm")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fused, "best_path", lambda: path)
        run = FusedRun(spec, plan, copied(state), inputs)
        for k in range(data.shape[1]):
            rows = rng.permutation(plants)[: int(rng.integers(1, plants + 1))]
            sample, outs = data[rows, k : k + 1], run.outputs(len(rows), 1, keep)
            run.run(sample[..., :inputs], sample[..., inputs:], outs, rows, threads=int(rng.integers(1, 3)))
            with np.errstate(all="ignore"):
                after, expected = run_reference(spec, rows_of(state, rows), sample)
            state = written_rows(copied(state), rows, after)
            for name, values in outs.items():
                if values is not None and name not in ("ready", "whitened"):
                    same(values, getattr(expected, name), name)
    same(run.state, state, "state")


@needs_kernel
@settings(max_examples=20, deadline=None)
@drawn
def test_steps_have_the_bits_of_the_recording(
    shape: tuple[int, int, int], direct: bool, starts: bool, share: float, hold: int, seed: int
) -> None:
    spec, rng = chosen(shape, direct, starts, hold), np.random.default_rng(seed)
    data, plan, inputs = recorded(spec, rng, 1, 60, share), plan_of(spec), shape[1]
    assert plan is not None
    with np.errstate(all="ignore"):
        state, expected = run_reference(spec, initial_state(spec, 1), data)
    run, found = FusedRun(spec, plan, copied(initial_state(spec, 1)), inputs), []
    for row in data[0]:
        flags, statistic = run.step(row[:inputs], row[inputs:])
        told = [flags & flag != 0 for flag in (ALARM, DECIDED, MISSING)]
        found.append((*told, statistic, run.last_residual()))
    for k, name in enumerate(("alarm", "usable", "missing", "statistic", "residuals")):
        same(np.array([one[k] for one in found]), getattr(expected, name)[0], name)
    same(run.state, state, "state")


@needs_kernel
def test_snapshots_have_the_bytes_of_numpy() -> None:
    """Before values are missing, while they are, and when all filters are back at their stationary gain."""
    rng = np.random.default_rng(0)
    made = rs.Plant([[0.5]], [[0.1]], [[1.0], [0.4]], dt=1).with_sensor_faults()
    made = made.with_noise(process=1e-1, measurement=1e-1)
    monitors = [rs.Monitor(rs.design.kalman_filter(made), isolate=None) for _ in range(2)]
    with pytest.MonkeyPatch.context() as patch:
        fleets = [rs.Fleet(monitors[0], plants=range(5))]
        patch.setattr(fused, "_kernel", None)
        fleets.append(rs.Fleet(monitors[1], plants=range(5)))
    columns = set()
    for k in range(60):
        u, y = rng.standard_normal((5, 1)), rng.standard_normal((5, 2))
        if k in (0, 20, 21):
            y[1, 0] = y[3] = np.nan
        for fleet in fleets:
            fleet.tick(None, u, y)
        contents = [fleet.snapshot() for fleet in fleets]
        assert contents[0] == contents[1], k
        columns.add(b"state.filter.spread" in contents[0])
        assert rs.Fleet.restore(contents[0], monitors[0]).snapshot() == contents[0]
    assert columns == {True, False}
    assert b"state.filter.spread" not in contents[0]
