"""A Kalman filter goes on with the values that are there, by the exact gain; matched filters are not misled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

import residua as rs
from effort import rounds
from residua.decide import Matched, NormThreshold
from residua.monitor.fused import run_block
from residua.monitor.partial_update import PartialUpdate
from residua.monitor.running import initial_state
from residua.records import values_out
from running_examples import plant, recording


def generated(seed: int) -> rs.Plant:
    """Return a plant with two to three states and outputs, correlated noise of both kinds, and faults."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 4)), int(rng.integers(2, 4))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.5, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    made = rs.Plant(A, rng.standard_normal((n, 1)), rng.standard_normal((p, n)), rng.standard_normal((p, 1)), dt=1)
    made = made.with_sensor_faults().with_actuator_faults()
    process, measurement = rng.standard_normal((n, n)), rng.standard_normal((p, p)) + 2 * np.eye(p)
    return made.with_noise(process=0.1 * process @ process.T, measurement=0.1 * measurement @ measurement.T)


def simulated(made: rs.Plant, samples: int, seed: int, fault: int | None = None, start: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    u, f = rng.standard_normal((samples, 1)), np.zeros((samples, len(made.faults)))
    if fault is not None:
        f[start:, fault] = 1.0
    w = rng.standard_normal((samples, len(made.noises)))
    return np.hstack([u, made.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))])


def with_holes(data: np.ndarray, seed: int, share: float, inputs: int = 1) -> np.ndarray:
    out = data.copy()
    out[:, inputs:][np.random.default_rng(seed).random(out[:, inputs:].shape) < share] = np.nan
    return out


def textbook(made: rs.Plant, partial: PartialUpdate, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return whitened innovations of whole samples by the Kalman filter as it is written in books."""
    A, C, Q, R, S = made.A, made.C, made.process_noise, made.measurement_noise, made.cross_noise
    x, P = np.zeros(len(A)), partial.covariance
    out, m = np.full((len(data), len(C)), np.nan), len(made.inputs)
    for k, row in enumerate(data):
        u, y = row[:m], row[m:]
        rows = np.flatnonzero(np.isfinite(y))
        Ca, innovation = C[rows], C[rows] @ P @ C[rows].T + R[np.ix_(rows, rows)]
        K = (A @ P @ Ca.T + S[:, rows]) @ np.linalg.inv(innovation)
        r = y[rows] - Ca @ x - made.D[rows] @ u
        if len(rows) == len(C):
            out[k] = np.linalg.solve(np.linalg.cholesky(innovation), r)
        x = A @ x + made.B @ u + K @ r
        P = A @ P @ A.T + Q - K @ innovation @ K.T
        P = (P + P.T) / 2  # otherwise rounding may grow in what is not symmetric, without bound
    return out, x


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.sampled_from([0.02, 0.2, 0.6]))
@example(957, 0.02)
def test_it_is_the_kalman_filter_of_the_book(seed: int, share: float) -> None:
    """Also in the scale of the residual; 1e-6 is how near to stationary counts as stationary, relative."""
    made = generated(seed)
    monitor = rs.Monitor(rs.design.kalman_filter(made), test=NormThreshold(threshold=1.0), settle=0, max_hold=10**6)
    spec = replace(monitor._specification(), first=None)
    assert spec.partial is not None
    data = with_holes(simulated(made, 120, seed), seed, share)
    data[:2] = 0.0  # whole, and at rest: both start from zero
    state, found = run_block(spec, initial_state(spec, 1), data[None])
    expected, x = textbook(made, spec.partial, data)
    root = np.linalg.cholesky(made.C @ spec.partial.covariance @ made.C.T + made.measurement_noise)
    whole = np.isfinite(data).all(axis=1)
    assert np.array_equal(found.usable[0], whole)
    size = np.abs(expected[whole] @ root.T).max()
    np.testing.assert_allclose(found.residuals[0, whole], expected[whole] @ root.T, atol=1e-4 * size)
    np.testing.assert_allclose(state.filter.x[0], x, atol=1e-4 * np.abs(x).max())


def test_innovations_stay_white_with_covariance_one() -> None:
    """Of 7,000 samples 0.07 are four deviations of a variance; held values make it many times that."""
    made = generated(5)
    monitor = rs.Monitor(rs.design.kalman_filter(made))
    data = with_holes(simulated(made, 7000, 1), 2, 0.1)
    found = monitor.run(data[:, :1], data[:, 1:])
    assert isinstance(found, rs.Diagnosis)
    r = found.residuals[found.decided] @ monitor.norm_test.whitening
    np.testing.assert_allclose(np.cov(r.T), np.eye(r.shape[1]), atol=0.07)
    before = rs.Monitor(rs.design.kalman_filter(made))
    before._spec = replace(before._specification(), partial=None)
    assert found.decided.mean() > 2 * before.run(data[:, :1], data[:, 1:]).decided.mean()  # type: ignore[union-attr]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), matched=st.booleans(), steady=st.booleans(), average=st.sampled_from([1, 7]))
def test_any_cutting_and_any_fleet_gives_the_same_bits(seed: int, matched: bool, steady: bool, average: int) -> None:
    made, rng = generated(seed % 50), np.random.default_rng(seed)
    isolate = Matched(window=12, steady=steady) if matched else "auto"
    test = NormThreshold(window=1 if matched else average)
    spec = rs.Monitor(rs.design.kalman_filter(made), test=test, isolate=isolate)._specification()
    data = np.stack([simulated(made, 120, seed + k, k % 3, 60) for k in range(3)])
    data[0] = with_holes(data[0], seed, rng.choice([0.02, 0.3, 0.9]), inputs=int(rng.integers(0, 2)))
    data[1, rng.integers(120), rng.integers(data.shape[2])] = rng.choice([np.nan, np.inf, 1e300])
    state, whole = run_block(spec, initial_state(spec, 3), data)
    cuts = np.sort(rng.integers(0, 121, 15)) if rng.random() < 0.7 else np.arange(1, 120)
    now, parts = initial_state(spec, 3), []
    for part in np.split(data, cuts, axis=1):
        now, found = run_block(spec, now, part)
        parts.append(found)
    alone = [run_block(spec, initial_state(spec, 1), one[None])[1] for one in data]
    for name in ("residuals", "statistic", "alarm", "usable", "scores"):
        expected = getattr(whole, name)
        for other in (np.concatenate([getattr(part, name) for part in parts], axis=1),):
            assert np.array_equal(other, expected, equal_nan=expected.dtype.kind == "f"), name
        stacked = np.concatenate([getattr(one, name) for one in alone])
        assert np.array_equal(stacked, expected, equal_nan=expected.dtype.kind == "f"), name
    for name in ("x", "spread", "bent", "apart", "age", "resets", "start_sums"):
        assert np.array_equal(getattr(now.filter, name), getattr(state.filter, name)), name
    assert values_out(now.test) == values_out(state.test)


def test_without_missing_outputs_nothing_changes_by_a_bit_and_after_them_nothing_for_long() -> None:
    u, y = recording(800, fault="p1", start=500)
    monitor = rs.Monitor(rs.design.matched_filters(plant(), window=20))
    old = rs.Monitor(rs.design.matched_filters(plant(), window=20))
    old._spec = replace(old._specification(), partial=None)
    for one, other in ((monitor.run(u, y), old.run(u, y)),):
        assert one.statistic.tobytes() == other.statistic.tobytes()  # type: ignore[union-attr]
        assert one.scores.tobytes() == other.scores.tobytes()  # type: ignore[union-attr]
    y2 = y.copy()
    y2[100:103, 0] = np.nan
    found, clean = monitor.run(u, y2), monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert isinstance(clean, rs.Diagnosis)
    assert found.decided[103:].all()
    np.testing.assert_allclose(found.statistic[300:], clean.statistic[300:], rtol=1e-9)
    spec = monitor._specification()
    state, _ = run_block(spec, initial_state(spec, 1), np.hstack([u, y2])[None])
    assert not state.filter.apart[0]
    assert not state.test.match.extra.any()


def test_matched_filters_expect_what_faults_do_while_outputs_are_missing() -> None:
    """Without noise every likelihood is that of the true fault: the size is exact however many outputs are missing."""
    made = generated(11)
    monitor = rs.Monitor(rs.design.matched_filters(made, window=30))
    spec = monitor._specification()
    assert spec.partial is not None
    for fault in range(len(made.faults)):
        f = np.zeros((100, len(made.faults)))
        f[60:, fault] = 50.0
        y = made.system(("control", "fault")).simulate(np.hstack([np.zeros((100, 1)), f]))
        data = with_holes(np.hstack([np.zeros((100, 1)), y]), fault, 0.3)
        data[:45] = 0.0  # settled
        _, found = run_block(spec, initial_state(spec, 1), data[None])
        _, held = run_block(*(lambda s: (s, initial_state(s, 1)))(replace(spec, partial=None, settle=0)), data[None])
        assert found.match is not None
        assert held.match is not None
        k = np.flatnonzero(found.usable[0, :88])[-1]
        assert found.match.ages[0, k, fault] == k - 60
        assert found.match.sizes[0, k, fault] == pytest.approx(50.0, rel=1e-6)
        assert found.match.ratios[0, k].argmax() == fault


def test_a_settled_fault_stays_named_while_outputs_are_missing() -> None:
    u, y = recording(2000, fault="p2", start=300, seed=4)
    holes = with_holes(np.hstack([u, y]), 5, 0.05)
    for steady in (False, True):
        isolate = Matched(window=20, steady=steady)
        monitor = rs.Monitor(rs.design.kalman_filter(plant()), test=NormThreshold(), isolate=isolate)
        found = monitor.run(holes[:, :1], holes[:, 1:])
        assert isinstance(found, rs.Diagnosis)
        assert found.candidates[0].faults == ("p2",)
        assert found.alarm[400:].mean() > 0.95
        assert found.match is not None
        k = np.flatnonzero(found.decided)[-1]
        assert found.match.settled_sizes[k, 1] == pytest.approx(3.0, abs=4 * found.match.deviations[k, 1])


@pytest.mark.parametrize("runs", rounds(24, 48))
def test_names_under_two_per_cent_of_missing_values_are_those_without(runs: int) -> None:
    """Held values date half of them, and name one in thirty wrongly that whole data name rightly."""
    made = rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)
    matched = rs.design.matched_filters(made, window=40)
    size, monitor, rng = matched.deviation(), rs.Monitor(matched), np.random.default_rng(0)
    wrong, dated = [0, 0], [0, 0]
    for run in range(runs):
        f = np.zeros((300, 4))
        f[150:, run % 4] = 12 * size[made.faults[run % 4]]
        u, w = rng.standard_normal((300, 1)), rng.standard_normal((300, len(made.noises)))
        y = made.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))
        for k, data in enumerate((y, with_holes(y, run, 0.02, inputs=0))):
            found = monitor.run(u, data)
            assert isinstance(found, rs.Diagnosis)
            wrong[k] += found.candidates[0].faults != (made.faults[run % 4],)
            dated[k] += abs((found.onset or 0.0) - 150) <= 5
    assert wrong[1] <= wrong[0] + 1
    assert dated[1] >= dated[0] - runs // 16
    assert dated[0] > 0.875 * runs


def test_one_output_that_never_comes_back_leaves_the_others_at_work() -> None:
    """The filter runs on, its covariance at that for the outputs which are there; so it does without an input."""
    u, y = recording(600)
    y[200:260, 0] = np.nan
    found = rs.Monitor(rs.design.kalman_filter(plant())).run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert found.recording.resets == 0
    assert found.decided[260:].all()
    assert not found.alarm.any()
    u[400] = np.nan
    held = rs.Monitor(rs.design.kalman_filter(plant())).run(u, y)
    assert isinstance(held, rs.Diagnosis)
    assert not held.decided[400]
    assert held.decided[401:].all()


def test_a_filter_that_knows_too_little_starts_anew() -> None:
    """A plant that runs away, and nothing that sees it."""
    made = rs.Plant([[1.5, 0], [0, 0.5]], np.zeros((2, 0)), np.eye(2), dt=1).with_sensor_faults()
    made = made.with_noise(process=1e-2, measurement=1e-2)
    kalman = rs.design.kalman_filter(made)
    y = np.zeros((300, 2))
    y[100:200, 0] = np.nan
    found = rs.Monitor(kalman).run(None, y)
    assert isinstance(found, rs.Diagnosis)
    assert found.recording.resets == 1
    assert found.decided[-50:].all()
    assert not found.alarm.any()


def test_other_generators_hold_values_as_before() -> None:
    for generator in (rs.design.detection_filter(plant()), rs.design.sensor_fault_bank(plant()).generator):
        assert rs.Monitor(generator, test=NormThreshold(threshold=1.0))._specification().partial is None
    assert rs.Monitor(rs.design.kalman_filter(plant()))._specification().partial is not None


@pytest.mark.parametrize("inputs", [True, False])
def test_recordings_that_lie_in_memory_by_columns_run_the_same(inputs: bool) -> None:
    rng = np.random.default_rng(0)
    plant = rs.Plant([[0.9]], [[0.1]] if inputs else np.zeros((1, 0)), [[1.0], [0.5]], dt=1)
    plant = plant.with_sensor_faults().with_noise(process=1e-2, measurement=1e-2)
    u, y = (rng.standard_normal((300, 1)) if inputs else None), 0.1 * rng.standard_normal((300, 2))
    y[50, 0] = y[51] = np.nan
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    one = monitor.run(u, y)
    other = monitor.run(None if u is None else np.asfortranarray(u), np.asfortranarray(y))
    assert isinstance(one, rs.Diagnosis)
    assert isinstance(other, rs.Diagnosis)
    np.testing.assert_array_equal(one.residuals, other.residuals)


def two_inputs(units: float = 1.0) -> rs.Plant:
    """Return a plant with three states and outputs and two inputs, all of which may be measured in other units."""
    A = [[0.98, 0.01, 0], [0.02, 0.95, 0.02], [0, 0.03, 0.97]]
    B, C = np.array([[0.05, 0], [0, 0], [0, 0.04]]) / units, np.eye(3) * units
    made = rs.Plant(A, B, C, dt=1, inputs=["u1", "u2"], outputs=["a", "b", "c"])
    return made.with_sensor_faults().with_noise(process=0.0025 * np.eye(3), measurement=0.01 * units**2 * np.eye(3))


def recorded_with_inputs(samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return commands that stand still for 50 samples at a time, each step hundreds of deviations of the noise."""
    rng, made = np.random.default_rng(seed), two_inputs()
    u = np.repeat(rng.normal(size=(samples // 50, 2)), 50, axis=0) * 50
    w = rng.standard_normal((samples, len(made.noises)))
    return u, made.system(("control", "noise")).simulate(np.hstack([u, w]))


@pytest.mark.parametrize("units", [2.0**-20, 1.0, 2.0**20])
def test_without_an_input_all_whole_samples_are_judged_and_no_innovation_is_too_large(units: float) -> None:
    """Of 5,000 samples 0.08 are four deviations of a variance; held inputs of this size make it many times that.

    Where the input stood still the innovations are smaller than white ones, since it could have moved.
    """
    u, y = recorded_with_inputs(5000, 0)
    holes = np.random.default_rng(1).random(u.shape) < 0.03
    monitor = rs.Monitor(rs.design.kalman_filter(two_inputs(units)))
    found = monitor.run(np.where(holes, np.nan, u * units), y * units)
    assert isinstance(found, rs.Diagnosis)
    assert found.recording.resets == 0
    assert np.array_equal(found.decided[100:], ~holes[100:].any(axis=1))
    r = found.residuals[found.decided] @ monitor.norm_test.whitening
    values = np.linalg.eigvalsh(np.cov(r.T))
    assert values.max() < 1.08
    assert values.min() > 0.9
    assert not found.alarm.any()


def test_what_a_missing_input_was_hardly_matters() -> None:
    """Five hundred deviations of the noise, in a sample that is missing, move no later innovation by a tenth of one."""
    u, y = recorded_with_inputs(400, 3)
    moved = np.zeros_like(u)
    moved[200, 0] = 1000.0
    more = two_inputs().system("control").simulate(moved)
    u[200, 0] = np.nan
    monitor = rs.Monitor(rs.design.kalman_filter(two_inputs()))
    one, other = monitor.run(u, y), monitor.run(u, y + more)
    assert isinstance(one, rs.Diagnosis)
    assert isinstance(other, rs.Diagnosis)
    assert np.abs(more).max() >= 500 * 0.1
    apart = (one.residuals - other.residuals)[one.decided] @ monitor.norm_test.whitening
    assert np.abs(apart).max() < 0.1


def test_an_input_that_acts_on_outputs_at_once_takes_these_with_it() -> None:
    """The first output is not used at all where the input is missing: any value of it gives the same bits."""
    made = rs.Plant([[0.9]], [[0.1]], [[1.0], [1.0]], [[1.0], [0.0]], dt=1).with_sensor_faults()
    monitor = rs.Monitor(rs.design.kalman_filter(made.with_noise(process=0.01, measurement=0.01)))
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((300, 1)), 0.1 * rng.standard_normal((300, 2))
    u[100], other = np.nan, y.copy()
    other[100, 0] = 1e3
    one, two = monitor.run(u, y), monitor.run(u, other)
    assert isinstance(one, rs.Diagnosis)
    assert isinstance(two, rs.Diagnosis)
    assert one.statistic[101:].tobytes() == two.statistic[101:].tobytes()
    assert one.decided[101:].all()


def test_what_was_not_judged_for_want_of_values_is_said_with_its_reason_and_remedy() -> None:
    u, y = recorded_with_inputs(2000, 5)
    u[::25, 1] = np.nan
    kalman, held = (
        rs.design.kalman_filter(two_inputs()),
        rs.design.detection_filter(two_inputs().with_actuator_faults()),
    )
    found = rs.Monitor(held, test=NormThreshold(threshold=1e9), settle=5).run(u, y)
    assert isinstance(found, rs.Diagnosis)
    (note,) = (one for one in found.notes if "not judged" in one)
    share = 100 * (~found.decided[1:]).mean()
    assert float(note.split(" %")[0]) == pytest.approx(share, abs=2)
    assert "channel 'u2' at 80 of them" in note
    assert "Kalman filter" in note
    assert note in str(found)
    assert not any("not judged" in one for one in rs.Monitor(kalman).run(u, y).notes)  # type: ignore[union-attr]
    u[::10, 1] = np.nan
    (note,) = (one for one in rs.Monitor(kalman).run(u, y).notes if "not judged" in one)  # type: ignore[union-attr]
    assert note.startswith("12 % of the recording")


def test_states_that_delay_an_input_are_not_lost_when_it_is_missing() -> None:
    """Nothing is known of them without noise but what the input is: the filter does not start anew for that."""
    A, B = np.array([[0.9, 0.1, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([[0.0], [0.0], [1.0]])
    late = rs.Plant(A, B, [[1.0, 0.0, 0.0]], dt=1).with_sensor_faults()
    late = late.with_noise(process=np.diag([1e-2, 0.0, 0.0]), measurement=1e-2)
    rng = np.random.default_rng(0)
    u, w = 10 * rng.standard_normal((600, 1)), rng.standard_normal((600, len(late.noises)))
    y = late.system(("control", "noise")).simulate(np.hstack([u, w]))
    u[100::50] = np.nan
    found = rs.Monitor(rs.design.kalman_filter(late)).run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert found.recording.resets == 0
    assert np.array_equal(found.decided[100:], np.isfinite(u[100:, 0]))
    assert not found.alarm.any()


def test_a_channel_that_is_missing_throughout_is_named() -> None:
    made = generated(0)
    data = simulated(made, 300, 1)
    monitor = rs.Monitor(rs.design.kalman_filter(made))
    y = data[:, 1:].copy()
    y[:, 0] = np.nan
    diagnosis = monitor.run(data[:, :1], y)
    assert not isinstance(diagnosis, list)
    assert "no decision: y1 has no value in the whole recording" in str(diagnosis)
    y[:, 0], y[::2, 0], y[1::2, 1] = data[:, 1], np.nan, np.nan
    diagnosis = monitor.run(data[:, :1], y)
    assert not isinstance(diagnosis, list)
    assert diagnosis.why_undecided == "every sample has a missing value ('y1' is missing most often, at 150)"
