"""The fused loop has the bits of NumPy: for every test and isolation, whatever the data, and however they are cut."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

import residua as rs
from fused_examples import (
    ISOLATIONS,
    MARKS,
    ORDERS,
    TESTS,
    plant,
    recording,
    same,
    same_in_pieces,
    same_of_few_outputs,
    specification,
)
from residua.decide import (
    CUSUM,
    Directional,
    Likelihood,
    NormThreshold,
    PageHinkley,
)
from residua.decide.whitened_norm import NormTest
from residua.monitor import fused, online
from residua.monitor.fused import FusedRun, plan_of, run_block
from residua.monitor.plant_records import copied, rows_of, written_rows
from residua.monitor.running import (
    State,
    initial_state,
    joined_decisions,
    run_reference,
)

needs_kernel = pytest.mark.skipif(fused._kernel is None, reason="there is no compiled kernel")


@needs_kernel
@settings(max_examples=150, deadline=None)
@given(
    test=st.sampled_from(list(TESTS)),
    isolation=st.sampled_from(list(ISOLATIONS)),
    order=st.sampled_from(ORDERS),
    outputs=st.sampled_from((1, 2, 3, 5)),
    method=st.sampled_from(("kalman", "observer")),
    marks=st.lists(st.sampled_from(MARKS), max_size=8),
    overflow=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_it_has_the_bits_of_numpy(
    test: str, isolation: str, order: int, outputs: int, method: str, marks: list[float], overflow: bool, seed: int
) -> None:
    assume(order > 0 or test != "glr along faults")  # no fault has a direction among bare residuals
    spec = specification(test, isolation, order, outputs, method)
    rng = np.random.default_rng(seed)
    if overflow:
        spec = replace(spec, plausible=np.tile([-1e308, 1e308], (spec.B.shape[1], 1)), max_hold=int(rng.integers(12)))
    assert plan_of(spec) is not None
    data = recording(spec, rng, int(rng.integers(2, 700)), marks)
    state, expected = same_in_pieces(spec, data, rng)
    same_of_few_outputs(spec, data, state, expected, seed)


@needs_kernel
@settings(max_examples=60, deadline=None)
@given(
    test=st.sampled_from(list(TESTS)),
    isolation=st.sampled_from(list(ISOLATIONS)),
    order=st.sampled_from(ORDERS),
    outputs=st.sampled_from((1, 2, 3, 5)),
    path=st.sampled_from((0, 1, 2)),
    marks=st.lists(st.sampled_from(MARKS), max_size=3),
    plants=st.sampled_from((1, 2, 33, 70)),
    few=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
def test_single_samples_of_many_plants_have_the_bits_of_numpy(
    test: str,
    isolation: str,
    order: int,
    outputs: int,
    path: int,
    marks: list[float],
    plants: int,
    few: bool,
    seed: int,
) -> None:
    assume(order > 0 or test != "glr along faults")
    assume(path <= fused.best_path())
    spec, rng = specification(test, isolation, order, outputs, "observer"), np.random.default_rng(seed)
    plan = plan_of(spec)
    assert plan is not None
    data = np.concatenate([recording(spec, rng, 30, marks) for _ in range(-(-plants // 3))])[:plants]
    keep = ("missing", "usable", "statistic", "alarm") if few else fused.OUTPUTS
    inputs, state = int(rng.integers(0, data.shape[2] + 1)), initial_state(spec, plants)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fused, "best_path", lambda: path)
        run = FusedRun(spec, plan, copied(state), inputs)
    for k in range(data.shape[1]):
        rows = rng.permutation(plants)[: int(rng.integers(1, plants + 1))]
        who, outs = np.sort(rows), run.outputs(len(rows), 1, keep)
        sample = data[rows, k : k + 1]
        run.run(sample[..., :inputs], sample[..., inputs:], outs, rows)
        with np.errstate(all="ignore"):
            after, expected = run_reference(spec, rows_of(state, rows), sample)
        state = written_rows(copied(state), rows, after)
        for name, values in outs.items():
            if values is not None and name in ("missing", "usable", "statistic", "alarm", "residuals", "scores", "up"):
                assert np.array_equal(values, getattr(expected, name), equal_nan=values.dtype == float), name
        same(rows_of(run.state, who), rows_of(state, who), "state")
    same(run.state, state, "state")


def _rows(monitor: rs.Monitor, samples: int = 600) -> np.ndarray:
    return recording(monitor._specification(), np.random.default_rng(3), samples, [np.nan, 1e300])


@needs_kernel
@pytest.mark.parametrize("isolation", ["likelihood", "learnt"])
def test_an_isolation_that_is_not_in_c_follows_in_numpy(isolation: str) -> None:
    made = plant(3, 3, 2, 1).with_noise(process=1e-2, measurement=1e-1)
    isolate = Likelihood() if isolation == "likelihood" else Directional(window=5)
    monitor = rs.Monitor(rs.design.kalman_filter(made), test=CUSUM(), isolate=isolate)
    if isolation == "learnt":
        y = np.random.default_rng(0).standard_normal((300, 3)) + [4.0, 0.0, 0.0]
        monitor.learn_fault("worn", np.zeros((300, 2)), y, interval=(0, np.inf))
    spec = monitor._specification()
    plan = plan_of(spec)
    assert plan is not None
    assert not plan.names
    data = _rows(monitor)
    state, expected = run_reference(spec, initial_state(spec, 3), data)
    now, first = run_block(spec, initial_state(spec, 3), data[:, :123])
    now, second = run_block(spec, now, data[:, 123:])
    same(joined_decisions([first, second]), expected)
    same(now, state)


class Doubled(NormTest):
    """A test of somebody's own, made of one of the package."""

    def run(self, state: Any, block: Any) -> Any:
        return super().run(state, replace(block, residuals=2 * block.residuals))


def test_what_is_not_in_c_runs_in_numpy() -> None:
    made = plant(3, 3, 2, 1).with_noise(process=1e-2, measurement=1e-1)
    learnt = rs.Monitor(rs.design.kalman_filter(made), test=PageHinkley(threshold=5.0))
    assert plan_of(learnt._specification()) is None
    spec = rs.Monitor(rs.design.kalman_filter(made), test=NormThreshold())._specification()
    own = replace(spec, test=Doubled(*(getattr(spec.test, field.name) for field in fields(spec.test))))
    assert plan_of(own) is None
    data = np.random.default_rng(0).standard_normal((1, 50, 5))
    assert np.array_equal(
        run_block(own, initial_state(own, 1), data)[1].statistic,
        2 * run_block(spec, initial_state(spec, 1), data)[1].statistic,
        equal_nan=True,
    )


@needs_kernel
def test_rows_of_a_state_are_run_in_any_order() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant(4, 3, 2, 2).with_noise(process=1e-2, measurement=1e-1)))
    spec = monitor._specification()
    plan = plan_of(spec)
    assert plan is not None
    data = np.concatenate([_rows(monitor), _rows(monitor)[:, ::-1]])
    run = FusedRun(spec, plan, copied(initial_state(spec, 6)), inputs=2)
    order, found = np.random.default_rng(0).permutation(6), []
    for k in range(data.shape[1]):
        out = run.outputs(6, 1, ("statistic", "scores"))
        run.run(data[order, k : k + 1, :2], data[order, k : k + 1, 2:], out, order)
        found.append(out["statistic"][np.argsort(order), 0])  # pyright: ignore[reportOptionalSubscript]
    state, expected = run_reference(spec, initial_state(spec, 6), data)
    assert np.array_equal(np.stack(found, axis=1), expected.statistic, equal_nan=True)
    same(run.state, state)


@needs_kernel
def test_strided_signals_are_read_where_they_lie() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant(4, 3, 2, 2).with_noise(process=1e-2, measurement=1e-1)))
    spec, data = monitor._specification(), _rows(monitor)
    plan = plan_of(spec)
    assert plan is not None
    plain, strided = (FusedRun(spec, plan, copied(initial_state(spec, 3)), inputs=2) for _ in range(2))
    one, other = plain.outputs(3, data.shape[1]), strided.outputs(3, data.shape[1])
    plain.run(data[..., :2], data[..., 2:], one)
    backwards = np.ascontiguousarray(data[:, ::-1, ::-1].transpose(2, 1, 0)).transpose(2, 1, 0)[:, ::-1, ::-1]
    strided.run(backwards[..., :2], backwards[..., 2:], other)
    same(plain.state, strided.state)
    for name, values in one.items():
        same(values, other[name], name)


@needs_kernel
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("time", [1, 2, 40])
@pytest.mark.parametrize("order", ["C", "F"])
def test_signals_are_put_side_by_side_on_the_way(time: int, order: Any, threads: int) -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant(4, 3, 2, 2).with_noise(process=1e-2, measurement=1e-1)))
    spec, data = monitor._specification(), np.concatenate([_rows(monitor), _rows(monitor)])[:, :time]
    plan = plan_of(spec)
    assert plan is not None
    data[1, 0, 1], data[2, -1] = np.nan, np.inf  # plants that stop on the way: the kernel has no room for gains
    u, y = (np.array(one, order=order) for one in (data[..., :2], data[..., 2:]))
    run = FusedRun(spec, plan, copied(initial_state(spec, 6)), inputs=2)
    joined = np.zeros((6, time + 1, data.shape[2]))
    run.run(u, y, run.outputs(6, time), threads=threads, joined=joined[:, :time])
    same(joined[:, :time], data)
    assert not joined[:, time].any()
    with pytest.raises(ValueError, match="output"):
        run.run(u, y, run.outputs(6, time), joined=np.zeros((6, time, 9)))


@needs_kernel
def test_a_recording_is_kept_whole_whatever_its_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last of its pieces may be one sample."""
    monkeypatch.setattr(online, "PIECE", 10)
    monitor = rs.Monitor(rs.design.kalman_filter(plant(4, 3, 2, 2).with_noise(process=1e-2, measurement=1e-1)))
    data = _rows(monitor)[0, :31]
    for samples in (1, 2, 10, 31):
        diagnosis = monitor.run(data[:samples, :2], data[:samples, 2:])
        assert isinstance(diagnosis, rs.Diagnosis)
        same(diagnosis.signals, data[:samples])


@needs_kernel
@pytest.mark.parametrize("change", ["state", "plan", "signals", "rows", "outputs", "integers"])
def test_the_kernel_refuses_arrays_that_do_not_fit(change: str) -> None:
    """It never reads beyond an array, whatever it is handed."""
    monitor = rs.Monitor(rs.design.kalman_filter(plant(3, 2, 2, 2).with_noise(process=1e-2, measurement=1e-1)))
    spec = monitor._specification()
    plan, state = plan_of(spec), copied(initial_state(spec, 3))
    assert plan is not None
    data = np.zeros((3, 5, 4))
    if change == "state":
        state = replace(state, filter=replace(state.filter, x=np.zeros((2, 3))))
    if change == "plan":
        plan = replace(plan, arrays=(plan.arrays[0][:2], *plan.arrays[1:]))  # pyright: ignore[reportOptionalSubscript]
    if change == "integers":
        plan = replace(plan, integers=-plan.integers)
    if change in ("state", "plan", "integers"):
        with pytest.raises(ValueError, match=r"has another type or size|are no plan"):
            FusedRun(spec, plan, state)
        return
    run = FusedRun(spec, plan, state)
    out, rows = run.outputs(3, 5), None
    if change == "signals":
        data = data[..., :3]
    if change == "rows":
        rows = np.array([0, 1, 3])
    if change == "outputs":
        out["residuals"] = np.zeros((3, 4, 2))
    with pytest.raises(ValueError, match=r"u and y must be|a row or a sample|an output has another shape"):
        run.run(data, data[..., :0], out, rows)


def test_states_are_run_in_place_and_blocks_are_pure() -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant(3, 2, 2, 2).with_noise(process=1e-2, measurement=1e-1)))
    spec, data = monitor._specification(), _rows(monitor)
    before: State = run_block(spec, initial_state(spec, 3), data[:, :100])[0]
    kept = copied(before)
    run_block(spec, before, data[:, 100:])
    same(before, kept)


@needs_kernel
@pytest.mark.parametrize("states", range(1, 10))
def test_a_tick_of_many_plants_has_the_bits_of_ticks_of_few(states: int) -> None:
    """Filters of few states run side by side, and their rows are stored with what stands in the lanes behind them."""
    rng = np.random.default_rng(states)
    A = rng.standard_normal((states, states))
    A *= 0.5 / np.abs(np.linalg.eigvals(A)).max()
    plant = rs.Plant(A, rng.standard_normal((states, 1)), rng.standard_normal((1, states)), dt=1).with_sensor_faults()
    plant = plant.with_noise(process=0.1 * np.eye(states), measurement=0.3)
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.CUSUM(threshold=5.0, form="page"), isolate=None)
    many = rs.Fleet(watch, plants=range(66))
    few = [rs.Fleet(watch, plants=[0, 1, 2]), rs.Fleet(watch, plants=[32, 33]), rs.Fleet(watch, plants=[64, 65])]
    for _ in range(40):
        u, y = rng.standard_normal((66, 1)), 3 + rng.standard_normal((66, 1))
        whole = many.tick(None, u, y).statistic
        for fleet, which in zip(few, ([0, 1, 2], [32, 33], [64, 65]), strict=True):
            np.testing.assert_array_equal(fleet.tick(None, u[which], y[which]).statistic, whole[which])
    assert np.isfinite(whole).all()


@needs_kernel
@pytest.mark.parametrize("seed", range(8))
def test_calm_pieces_count_as_those_of_numpy(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """Where nothing is over the threshold and nobody asks for the statistic little is done, but what counts goes on."""
    monkeypatch.setitem(TESTS, "rare", rs.decide.NormThreshold(threshold=3.0, persistence=3, release=2))
    spec = specification("rare", "none", 3, 2, "observer")
    rng = np.random.default_rng(seed)
    data = 0.05 * rng.standard_normal((3, 300, spec.B.shape[1])) + spec.offset
    for _ in range(20):
        data[rng.integers(3), rng.integers(300)] += 20 * rng.standard_normal(spec.B.shape[1])
    with np.errstate(all="ignore"):
        state, expected = run_reference(spec, initial_state(spec, 3), data)
    plan = plan_of(spec)
    assert plan is not None
    run = FusedRun(spec, plan, copied(initial_state(spec, 3)))
    outputs = run.outputs(3, 300, ["alarm", "up"])
    cuts = [0, *sorted(set(rng.integers(1, 300, 25).tolist())), 300]
    for begin, end in pairwise(cuts):
        part = {name: None if one is None else one[:, begin:end] for name, one in outputs.items()}
        run.run(data[:, begin:end], data[:, begin:end, :0], part)
    assert np.array_equal(outputs["alarm"], expected.alarm)
    assert np.array_equal(outputs["up"], expected.up)
    same(run.state, state, "state")


@needs_kernel
@pytest.mark.parametrize("outputs", [1, 3, 4])
@pytest.mark.parametrize("samples", [1025, 8448 + 1, 8448 + 1025])
@pytest.mark.parametrize(("test", "isolation"), [("crosier", "none"), ("norm", "short")])
def test_a_single_sample_behind_full_pieces_has_the_bits_of_numpy(
    test: str, isolation: str, samples: int, outputs: int
) -> None:
    """It goes through the filter in a row, and the samples before it in columns."""
    spec = replace(specification(test, isolation, 4, outputs, "kalman"), settle=0)
    data = 0.3 * np.random.default_rng(outputs).standard_normal((1, 100 + samples, spec.B.shape[1])) + spec.offset
    with np.errstate(all="ignore"):
        state, expected = run_reference(spec, initial_state(spec, 1), data)
    now, first = run_block(spec, initial_state(spec, 1), data[:, :100])  # a filter that starts is judged in rows
    now, then = run_block(spec, now, data[:, 100:])
    same(joined_decisions([first, then]), expected, "decisions")
    same(now, state, "state")


@needs_kernel
@pytest.mark.parametrize("alarm", [0, 527, 528, 4000, 8447])
def test_an_alarm_within_parts_of_cumulative_sums_has_the_bits_of_numpy(alarm: int) -> None:
    """Parts before it are summed beside each other, those from it on one sample after the other."""
    spec = replace(specification("crosier", "none", 4, 3, "kalman"), settle=0)
    data = 0.3 * np.random.default_rng(alarm).standard_normal((1, 100 + 2 * 8448, spec.B.shape[1])) + spec.offset
    data[:, 100 + alarm : 100 + alarm + 30] += 40.0
    with np.errstate(all="ignore"):
        state, expected = run_reference(spec, initial_state(spec, 1), data)
    assert expected.alarm.any()
    assert not expected.alarm.all()
    now, first = run_block(spec, initial_state(spec, 1), data[:, :100])
    now, then = run_block(spec, now, data[:, 100:])
    same(joined_decisions([first, then]), expected, "decisions")
    same(now, state, "state")


@needs_kernel
@pytest.mark.parametrize("outputs", [1, 2, 3, 5])
@pytest.mark.parametrize("test", ["norm", "crosier", "chi-squared"])
def test_long_recordings_have_the_bits_of_numpy(test: str, outputs: int) -> None:
    """Sums of Crosier are formed in sixteen parts at once where nothing is over the threshold, else one by one."""
    spec, rng = specification(test, "none", 4, outputs, "kalman"), np.random.default_rng(outputs)
    for size in (0.01, 0.3, 1.0):
        data = size * recording(spec, rng, 9000, [np.nan])
        data[0, 4500:4560] *= size < 1.0  # below the threshold throughout, or with an alarm
        state, expected = same_in_pieces(spec, data, rng)
        same_of_few_outputs(spec, data, state, expected, outputs)


@needs_kernel
@pytest.mark.parametrize("outputs", [1, 2, 3, 4])
@pytest.mark.parametrize("case", ["alarms", "in alarm", "too large", "missing", "settling"])
def test_sums_of_residuals_that_are_whitened_as_they_are_read_have_the_bits_of_numpy(case: str, outputs: int) -> None:
    """Where whitened residuals are not asked for they are not kept; after an alarm, parts are summed at once again."""
    spec = replace(specification("crosier", "none", 4, outputs, "kalman"), settle=150 if case == "settling" else 0)
    rng = np.random.default_rng(outputs)
    data = 0.3 * rng.standard_normal((1, 100 + 3 * 8448 + 2500, spec.B.shape[1])) + spec.offset
    bursts = {"alarms": (100 + 8448, 13000, 14000, 20000), "in alarm": (90, 9500), "settling": (9000,)}
    for begin in bursts.get(case, ()):
        data[:, begin : begin + 30] += 40.0
    if case == "too large":  # for a bound of all that the parts whiten, but not for a sum
        data[:, 5000] = 1e60
    if case == "missing":
        data[:, 12000:12003, 0] = np.nan
    with np.errstate(all="ignore"):
        state, expected = run_reference(spec, initial_state(spec, 1), data)
    plan = plan_of(spec)
    assert plan is not None
    run = FusedRun(spec, plan, copied(initial_state(spec, 1)))
    made = run.outputs(1, data.shape[1], ("residuals", "statistic", "alarm", "up"))
    for part in (slice(0, 100), slice(100, None)):
        run.run(data[:, part], data[:, part, :0], {n: None if a is None else a[:, part] for n, a in made.items()})
    assert expected.alarm.any() or case == "missing"
    for name in ("residuals", "statistic", "alarm", "up"):
        same(made[name], getattr(expected, name), name)
    same(run.state, state, "state")
