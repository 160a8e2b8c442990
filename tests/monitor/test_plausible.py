"""No single value blinds a monitor: what is no measurement is missing, a state that overflows starts anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

import residua as rs
from residua.decide import Matched, NormThreshold, PeakThreshold
from residua.errors import SettingError
from residua.monitor.fused import run_block
from residua.monitor.running import initial_state
from residua.records import values_out
from running_examples import plant, recording

MARKS = [1.7976931348623157e308, -1.7976931348623157e308, 1e300, -3.4028235e38, 1e36]


def monitors() -> dict[str, rs.Monitor]:
    """Return one of each kind: fitted, by the noise model, and with a threshold that is given."""
    matched, bank = rs.design.matched_filters(plant(), window=20), rs.design.sensor_fault_bank(plant())
    kalman = rs.design.kalman_filter(plant())
    return {
        "Kalman filter, fitted": rs.Monitor(kalman).fit(*recording(2000, seed=9)),
        "Kalman filter, noise model": rs.Monitor(kalman, test=NormThreshold(window=5)),
        "matched filters": rs.Monitor(matched),
        "bank, fitted": rs.Monitor(bank).fit(*recording(2000, seed=9)),
        "bank, threshold given": rs.Monitor(bank, test=PeakThreshold(3.0, window=5), settle=40),
        "settled matched filters": rs.Monitor(kalman, test=NormThreshold(), isolate=Matched(window=20, steady=True)),
        "names by responses": rs.Monitor(kalman, isolate=Matched(window=20)),
    }


KINDS = list(monitors())
made: dict[str, rs.Monitor] = {}


def monitor(kind: str) -> rs.Monitor:
    if not made:
        made.update(monitors())
    return made[kind]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mark", MARKS)
@pytest.mark.parametrize("channel", [0, 2])
def test_one_mark_for_no_value_changes_nothing_for_long(kind: str, mark: float, channel: int) -> None:
    """Before: the state was NaN for good, or the alarm never ended."""
    u, y = recording(fault="p1", start=400)
    marked = np.hstack([u, y])
    marked[200, channel] = mark
    found, clean = (monitor(kind).run(v[:, :1], v[:, 1:]) for v in (marked, np.hstack([u, y])))
    assert isinstance(found, rs.Diagnosis)
    assert isinstance(clean, rs.Diagnosis)
    assert found.missing.sum() == 1
    assert not found.alarm[200:380].any() or clean.alarm[200:380].any()
    assert found.decided[300:].all()
    assert (found.alarm[500:] == clean.alarm[500:]).all()
    assert found.fault_detected
    assert "1 value was not plausible" in str(found)
    name = (*plant().inputs, *plant().outputs)[channel]
    assert f"{name!r} 1 (plausible from" in str(found)


@settings(max_examples=40, deadline=None)
@given(
    kind=st.sampled_from(KINDS),
    seed=st.integers(0, 2**32 - 1),
    marks=st.lists(st.sampled_from([np.nan, np.inf, *MARKS, 1e20, 1e12]), max_size=12),
    overflow=st.booleans(),
)
@example("Kalman filter, fitted", 74132746, [np.nan] * 5 + [np.inf] + [np.nan] * 5, True)  # infinity in any range
def test_any_cutting_and_any_fleet_gives_the_same_bits(
    kind: str, seed: int, marks: list[float], overflow: bool
) -> None:
    """Also where nothing is put aside, so that marks overflow the filter."""
    rng = np.random.default_rng(seed)
    data = np.stack([np.hstack(recording(160, seed=int(s))) for s in rng.integers(0, 99, 3)])
    for mark in marks:
        data[0, rng.integers(160), rng.integers(3)] = mark
    spec = monitor(kind)._specification()
    if overflow:
        spec = replace(spec, plausible=np.tile([-np.inf, np.inf], (3, 1)))
    with np.errstate(all="ignore"):
        state, whole = run_block(spec, initial_state(spec, 3), data)
        now, parts = initial_state(spec, 3), []
        for part in np.split(data, np.sort(rng.integers(0, 161, 12)), axis=1):
            now, found = run_block(spec, now, part)
            parts.append(found)
        alone = [run_block(spec, initial_state(spec, 1), one[None])[1] for one in data]
    for name in ("residuals", "statistic", "alarm", "usable", "missing", "scores", "fired", "aside"):
        expected = getattr(whole, name)
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        assert np.array_equal(joined, expected, equal_nan=expected.dtype.kind == "f"), name
        stacked = np.concatenate([getattr(one, name) for one in alone])
        assert np.array_equal(stacked, expected, equal_nan=expected.dtype.kind == "f"), name
    assert values_out(now.test) == values_out(state.test)
    for name in ("x", "held", "age", "running", "resets", "broken"):
        assert np.array_equal(getattr(now.filter, name), getattr(state.filter, name)), name
        assert np.isfinite(getattr(state.filter, name)).all(), name
    assert np.isfinite(whole.statistic[whole.usable]).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308])
def test_a_state_that_is_no_number_starts_anew_and_is_counted(value: float) -> None:
    spec = monitor("Kalman filter, fitted")._specification()
    data = np.hstack(recording(200))[None]
    state, _ = run_block(spec, initial_state(spec, 1), data[:, :50])
    with np.errstate(all="ignore"):
        state, found = run_block(
            spec, replace(state, filter=replace(state.filter, x=np.full_like(state.filter.x, value))), data[:, 50:]
        )
    assert state.filter.broken[0] == 1
    assert found.usable[0, -50:].all()
    assert not found.alarm[0, -50:].any()


def test_an_overflow_is_told() -> None:
    one = rs.Monitor(rs.design.kalman_filter(plant()))
    one._spec = replace(one._specification(), plausible=np.tile([-np.inf, np.inf], (3, 1)))
    u, y = recording()
    y[200, 0] = 1.7e308
    with np.errstate(all="ignore"):
        found = one.run(u, y)
    assert "the filter overflowed and was restarted" in str(found)
    assert found.decided[400:].all()  # type: ignore[union-attr]


def test_marks_in_the_recording_that_is_fitted_are_missing_there_too() -> None:
    u, y = recording(2000, seed=9)
    marked = y.copy()
    marked[::50, 1] = 1e30
    clean = rs.Monitor(rs.design.kalman_filter(plant())).fit(u, y)
    found = rs.Monitor(rs.design.kalman_filter(plant())).fit(u, marked)
    assert found.threshold == pytest.approx(clean.threshold, rel=0.3)
    limits = found._specification().plausible
    assert (limits[:, 1] < 1e8).all()
    assert (limits[:, 1] > 1e6).all()


def test_limits_can_be_set() -> None:
    u, y = recording()
    y[100, 0], y[200, 1] = -40.0, -40.0
    some = rs.Monitor(rs.design.kalman_filter(plant()), plausible={plant().outputs[0]: (-30, 30)}).run(u, y)
    assert isinstance(some, rs.Diagnosis)
    assert some.missing.nonzero()[0].tolist() == [100]
    assert some.statistic[200] > some.threshold
    fitted = rs.Monitor(rs.design.kalman_filter(plant()), plausible=3).fit(*recording(2000, seed=9))
    found = fitted.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert found.missing.nonzero()[0].tolist() == [100, 200]
    free = rs.Monitor(rs.design.kalman_filter(plant()), plausible=None).fit(*recording(2000, seed=9))
    assert free.run(u, np.where(y < -30, 1e20, y)).n_missing == 0  # type: ignore[union-attr]
    assert free.run(u, np.where(y < -30, 1e32, y)).n_missing == 2  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (1, "over 1"),
        (np.inf, "over 1"),
        ("many", "over 1"),
        (True, "over 1"),
        ({"nobody": (0, 1)}, "no channel 'nobody'"),
        ({"y1": (1, 0)}, "the first below the other"),
        ({"y1": (0, np.nan)}, "the first below the other"),
        ({"y1": 3}, "the first below the other"),
    ],
)
def test_settings_that_make_no_sense_are_refused(value: object, words: str) -> None:
    with pytest.raises(SettingError, match=words):
        rs.Monitor(rs.design.kalman_filter(plant()), plausible=value)  # type: ignore[arg-type]


@pytest.mark.parametrize("power", [-20, 20])
def test_limits_go_with_the_units(power: int) -> None:
    u, y = recording(2000, seed=9)
    k = 2.0**power
    base = rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)
    other = rs.Plant(
        base.A, base.B, base.C * k, base.D * k, dt=base.dt, inputs=base.inputs, outputs=base.outputs
    ).with_noise(process=0.01, measurement=0.1 * k * k)
    one = rs.Monitor(rs.design.kalman_filter(base)).fit(u, y)._specification().plausible
    two = rs.Monitor(rs.design.kalman_filter(other)).fit(u, y * k)._specification().plausible
    np.testing.assert_allclose(two[1:], one[1:] * k, rtol=1e-9)


def test_limits_and_settings_are_saved(tmp_path: Path) -> None:
    for setting in (1e5, None, {"y1": (-5.0, 1e9)}):
        one = rs.Monitor(rs.design.kalman_filter(plant()), plausible=setting).fit(*recording(2000, seed=9))
        one.update(*recording(50))
        one.save(tmp_path / "m.json")
        loaded = rs.Monitor.load(tmp_path / "m.json")
        assert loaded.plausible == one.plausible
        assert loaded._specification().plausible.tobytes() == one._specification().plausible.tobytes()
