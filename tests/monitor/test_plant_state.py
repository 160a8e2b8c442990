"""What is remembered of a plant: how little it is, that nothing depends on where counters stop, and older layouts."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import residua as rs
from fused_examples import recording, same, specification
from residua.decide import CUSUM, Directional, NormThreshold
from residua.decide.persistence import LAST_COUNT
from residua.monitor import fused
from residua.monitor.fused import run_block
from residua.monitor.plant_records import SELDOM, bytes_of_record, takes_no_memory
from residua.monitor.running import State, initial_state, run_reference


def fleet(plants: int, **settings: Any) -> rs.Fleet:
    """Return plants of four states, five inputs and three residuals."""
    rng = np.random.default_rng(0)
    made = rs.Plant(np.diag([0.9, 0.8, 0.7, 0.6]), rng.standard_normal((4, 5)), rng.standard_normal((3, 4)), dt=1)
    made = made.with_sensor_faults().with_actuator_faults(["u1", "u2"]).with_noise(process=1e-2, measurement=1e-1)
    return rs.Fleet(rs.Monitor(rs.design.kalman_filter(made), **settings), plants=range(plants))


def tick_at_random(one: rs.Fleet, samples: int, seed: int = 1) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(samples):
        one.tick(None, rng.standard_normal((len(one), 5)), rng.standard_normal((len(one), 3)))


def state_of(one: rs.Fleet) -> State:
    return one._blocks[""].state


@pytest.mark.parametrize(
    ("settings", "most"),
    [
        ({"isolate": None}, 144),  # two means of three residuals
        ({"isolate": None, "test": NormThreshold()}, 128),
        ({"isolate": None, "test": CUSUM()}, 128),
        ({"isolate": Directional(window=50)}, 1400),
    ],
)
def test_a_plant_takes_few_bytes_once_its_start_is_over(settings: dict[str, Any], most: int) -> None:
    one = fleet(70, **settings)
    samples = one._blocks[""].spec.first.samples  # type: ignore[union-attr]
    assert not takes_no_memory(state_of(one).filter.start_sums)
    tick_at_random(one, 2 * samples + 2)
    assert takes_no_memory(state_of(one).filter.start_sums)
    assert bytes_of_record([state_of(one)]) <= most
    content = one.snapshot()
    again = rs.Fleet.restore(content, one._blocks[""].monitor)
    assert bytes_of_record([state_of(again)]) <= most
    parts = [part for part in one.split(3) if bytes_of_record([state_of(part)]) > most]
    assert not parts
    assert again.snapshot() == content


def counted_on(state: State, by: int) -> State:
    """Return a state whose counters, where they are not zero, are so much further."""

    def later(count: np.ndarray) -> np.ndarray:
        return np.where(count > 0, np.minimum(count.astype(np.int64) + by, LAST_COUNT), 0).astype(count.dtype)

    filtered, runs = state.filter, state.test.runs
    filtered = replace(filtered, age=later(filtered.age), gap=later(filtered.gap))
    down = runs.down if takes_no_memory(runs.down) else later(runs.down)
    return replace(state, filter=filtered, test=replace(state.test, runs=replace(runs, up=later(runs.up), down=down)))


@pytest.mark.parametrize("test", ["norm", "norm over a window", "crosier"])
def test_where_counters_stop_nothing_depends_on_it(test: str) -> None:
    """From counts that stop within the block the same follows as from short ones, by any cutting, in C and NumPy."""
    spec = replace(specification(test, "none", 3, 2, "observer"), max_hold=20)
    rng = np.random.default_rng(3)
    data = recording(spec, rng, 400, [])
    before, _ = run_reference(spec, initial_state(spec, 3), data[:, :150])
    _, expected = run_reference(spec, before, data[:, 150:])
    far = counted_on(before, LAST_COUNT - 20)
    with np.errstate(all="raise"):
        state, found = run_reference(spec, far, data[:, 150:])
    for name in ("residuals", "statistic", "exceeded", "alarm", "usable", "missing"):
        same(getattr(found, name), getattr(expected, name), name)
    assert found.up.max(initial=0) <= LAST_COUNT
    for pieces in (1, 7, 250):
        now, parts = far, []
        for part in np.array_split(data[:, 150:], pieces, axis=1):
            now, decisions = run_block(spec, now, part)
            parts.append(decisions)
        same(now, state, "state")
        same(np.concatenate([part.up for part in parts], axis=1), found.up, "up")
        same(np.concatenate([part.alarm for part in parts], axis=1), found.alarm, "alarm")


@pytest.mark.parametrize("kernel", [True, False])
def test_counters_stop_in_alarms_that_last(kernel: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = specification("norm", "none", 3, 2, "observer")
    if not kernel:
        monkeypatch.setattr(fused, "_kernel", None)
    loud = np.zeros((1, 600, spec.B.shape[1])) + spec.offset
    loud[..., -1] += 1e6 * np.sign(np.sin(np.arange(600)))  # whatever the filter settles to, it is over
    state, made = run_block(spec, initial_state(spec, 1), loud)
    assert made.up[0, -1] > 100
    far = counted_on(state, LAST_COUNT - 300)
    state, made = run_block(spec, far, loud)
    assert made.up[0, -1] == LAST_COUNT
    assert made.alarm[0, -1]
    assert state.test.runs.up.tolist() == [LAST_COUNT] == state.filter.age.tolist()


def odd(plants: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return signals of a fleet: long gaps at all of its plants, a jump and an overflow at some."""
    rng = np.random.default_rng(8)
    u, y = rng.standard_normal((plants, samples, 5)), rng.standard_normal((plants, samples, 3))
    y[:, 60:80] = np.nan
    y[::2, 85:] += 5.0
    y[::5, 95] = np.nan
    u[1::7, 100, 2] = 1e300
    return u, y


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("settings", [{"isolate": None}, {"isolate": Directional(window=5), "test": CUSUM()}])
def test_restarts_of_many_plants_at_once_have_the_bits_of_numpy(
    settings: dict[str, Any], threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no room for restarts before the first one, and none for starts after the first ones are over."""
    one, blocks = fleet(150, max_hold=4, **settings), fleet(150, max_hold=4, **settings)
    one.threads = blocks.threads = threads
    u, y = odd(150, 130)
    order = np.random.default_rng(2).permutation(150)
    for k in range(130):
        tick = one.tick(tuple(order.tolist()), u[order, k], y[order, k])
    cuts = (58, 62, 130)
    for start, stop in zip((0, *cuts), cuts, strict=False):
        made = blocks.update(u[:, start:stop], y[:, start:stop])
    monkeypatch.setattr(fused, "_kernel", None)
    plain = fleet(150, max_hold=4, **settings)
    expected = plain.update(u, y)
    assert state_of(plain).filter.resets.min() == 1
    same(state_of(one), state_of(plain), "state")
    same(state_of(blocks), state_of(plain), "state")
    if settings["isolate"] is None:  # else scores of alarms that are over stay as they were at the end of a block
        assert one.snapshot() == plain.snapshot() == blocks.snapshot()
    assert np.array_equal(tick.alarm, expected.alarm[order, -1])  # type: ignore[union-attr]
    assert np.array_equal(made.alarm, expected.alarm[:, 62:])  # type: ignore[union-attr]


def test_room_is_made_for_what_there_is_and_goes_with_the_start() -> None:
    one = fleet(80, isolate=None, max_hold=2)
    tick_at_random(one, 40)
    filtered = state_of(one).filter
    assert all(takes_no_memory(getattr(filtered, name)) for name in SELDOM if getattr(filtered, name).size)
    rng = np.random.default_rng(4)
    for k in range(9):  # one plant has a gap, is restarted, and starts
        y = rng.standard_normal((80, 3))
        y[17] = np.nan if k < 4 else y[17]
        one.tick(None, rng.standard_normal((80, 5)), y)
    filtered = state_of(one).filter
    assert filtered.resets.tolist() == [k == 17 for k in range(80)]
    assert (
        np.flatnonzero(filtered.starting).tolist() == [17] == np.flatnonzero(filtered.start_sums.any(axis=1)).tolist()
    )
    assert takes_no_memory(filtered.broken)


# ------------------------------------------------------------------------------ layouts of earlier versions


@pytest.mark.parametrize("how", ["file", "copy", "pickle"])
def test_a_copy_counts_what_its_original_counts(how: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    one = fleet(1, isolate=None, test=CUSUM())._blocks[""].monitor
    u, y = 0.01 * rng.standard_normal((60, 5)), 0.01 * rng.standard_normal((60, 3))
    for k in range(30):
        one.step(u[k], y[k])
    one.save(tmp_path / "before.json")
    other = {
        "file": lambda: rs.Monitor.load(tmp_path / "before.json"),
        "copy": lambda: copy.deepcopy(one),
        "pickle": lambda: pickle.loads(pickle.dumps(one)),
    }[how]()
    for k in range(30, 60):
        one.step(u[k], y[k])
        other.step(u[k], y[k])
    one.save(tmp_path / "one.json")
    other.save(tmp_path / "other.json")
    assert (tmp_path / "one.json").read_text() == (tmp_path / "other.json").read_text()
