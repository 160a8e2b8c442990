"""Fleets: every plant as if it had a monitor of its own, whatever the order of records, cutting, splits and threads."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import residua as rs
from residua.decide import CUSUM, Directional, NormThreshold
from residua.errors import DataError, FileFormatError, NotFittedError, SettingError
from residua.monitor import fused, snapshot

KINDS = ("norm", "norm over a window", "CUSUM", "bank", "observer")


def plant() -> rs.Plant:
    return bare().with_noise(process=1e-4, measurement=1e-2)


def bare() -> rs.Plant:
    made = rs.Plant([[0.8, 0.1], [0, 0.6]], [[0.2], [0.4]], np.eye(2), dt=2.0, inputs=["pump"], outputs=["low", "high"])
    return made.with_sensor_faults()


@cache
def monitor(kind: str) -> rs.Monitor:
    if kind == "CUSUM":
        return rs.Monitor(rs.design.kalman_filter(plant()), test=CUSUM(threshold=4.0))
    if kind == "bank":
        return rs.Monitor(rs.design.sensor_fault_bank(plant()), test=NormThreshold(threshold=1.0))
    if kind == "patient bank":
        return rs.Monitor(
            rs.design.sensor_fault_bank(plant()), test=NormThreshold(threshold=1.0, persistence=3), settle=0
        )
    if kind == "observer":
        made = rs.design.unknown_input_observer(bare()).residual_generator()
        return rs.Monitor(made, test=NormThreshold(threshold=0.5), isolate=None)
    test = NormThreshold(window=5) if "window" in kind else NormThreshold(persistence=2)
    return rs.Monitor(rs.design.kalman_filter(plant()), test=test, isolate=Directional(window=7))


def data(plants: int, samples: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs and outputs: sensors fail at some plants for a while, and values are missing at others."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((plants, samples, 1))
    y = np.empty((plants, samples, 2))
    for p in range(plants):
        noise = rng.standard_normal((samples, len(plant().noises)))
        y[p] = plant().system(("control", "noise")).simulate(np.hstack([u[p], noise]))
    y[::3, samples // 2 : -4, 0] += 2.0
    y[1::3, rng.integers(samples, size=6), rng.integers(2)] = np.nan
    y[2::3, samples // 3] = 1e300
    return u, y


def alone(kind: str, u: np.ndarray, y: np.ndarray) -> list[list[Any]]:
    """Return the decisions of a monitor for each plant."""
    out = []
    for p in range(len(u)):
        monitor(kind).reset()
        out.append([monitor(kind).step(u[p, k], y[p, k]) for k in range(u.shape[1])])
    monitor(kind).reset()
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_every_plant_has_the_decisions_of_a_monitor_of_its_own(kind: str) -> None:
    """Records come in any order, some plants more often than others, and several of one plant in one tick."""
    u, y = data(7, 90, 1)
    expected, ids = alone(kind, u, y), ["a", "b", "c", "d", "e", "f", "g"]
    fleet, rng = rs.Fleet(monitor(kind), plants=ids), np.random.default_rng(0)
    seen = np.zeros(7, dtype=int)
    while (seen < 90).any():
        who = [p for p in rng.integers(0, 7, rng.integers(1, 12)).tolist() if seen[p] < 90]
        rows = []
        for p in who:
            if seen[p] < 90:
                rows.append((p, seen[p]))
                seen[p] += 1
        now = [np.array([one[p, k] for p, k in rows]).reshape(len(rows), one.shape[2]) for one in (u, y)]
        tick = fleet.tick([ids[p] for p, _ in rows], *now)
        for j, (p, k) in enumerate(rows):
            one = expected[p][k]
            assert (tick.alarm[j], tick.decided[j], tick.missing[j]) == (one.alarm, one.decided, one.missing)
            assert np.array_equal(tick.statistic[j], one.statistic, equal_nan=True)
        if not rows:
            continue
        p, k = max(rows)
        last, one = fleet.decision(ids[p]), expected[p][k]
        assert np.array_equal(last.residual, one.residual, equal_nan=True)
        assert (last.candidates, last.fired, last.alarm) == (one.candidates, one.fired, one.alarm)
    in_alarm = {ids[p] for p in range(7) if expected[p][-1].alarm}
    assert {alarm.plant for alarm in fleet.alarms} == in_alarm


@pytest.mark.parametrize("kind", ["norm", "CUSUM"])
def test_an_alarm_says_when_and_what(kind: str) -> None:
    u, y = data(3, 80, 2)
    fleet = rs.Fleet(monitor(kind), plants=[10, 20, 30])
    whole, ticked = rs.Fleet(monitor(kind), plants=[10, 20, 30]), []
    for k in range(70):
        fleet.tick(None, u[:, k], y[:, k])
    decisions = whole.update(u[:, :70], y[:, :70])
    assert isinstance(decisions, rs.monitor.Decisions)
    diagnosis = monitor(kind).run(u[0, :70], y[0, :70])
    assert isinstance(diagnosis, rs.Diagnosis)
    for one in (fleet, whole):
        found = one.alarms
        assert [alarm.plant for alarm in found] == [10]
        assert found[0].raised == diagnosis.alarms[-1].raised
        assert found[0].onset == diagnosis.alarms[-1].onset
        if kind == "norm":
            assert found[0].candidates[0].faults == ("low sensor",)
            assert "10: low sensor, alarm since" in str(found[0])
        ticked.append(one.decision(10).statistic)
    assert ticked[0] == ticked[1] == decisions.statistic[0, -1]
    for k in range(70, 80):
        fleet.tick(None, u[:, k], y[:, k])
        whole.update(u[:, k : k + 1], y[:, k : k + 1])
    assert fleet.alarms == whole.alarms


@settings(max_examples=25, deadline=None)
@given(kind=st.sampled_from(KINDS), seed=st.integers(0, 2**32 - 1))
def test_splits_threads_and_snapshots_change_no_bit(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    u, y = data(6, 60, 5)
    ids = [f"plant {k}" for k in range(6)]
    expected = rs.Fleet(monitor(kind), plants=ids).update(u, y)
    assert isinstance(expected, rs.monitor.Decisions)
    fleet, statistic, start = rs.Fleet(monitor(kind), plants=ids, threads=int(rng.integers(1, 4))), [], 0
    for stop in [*np.sort(rng.integers(0, 61, 4)).tolist(), 60]:
        where = [ids.index(plant) for plant in fleet.plants]  # pyright: ignore[reportArgumentType]
        part = fleet.update(u[where, start:stop], y[where, start:stop])
        assert isinstance(part, rs.monitor.Decisions)
        statistic.append(part.statistic[np.argsort(where)])
        start, change = stop, rng.integers(4)
        if change == 0:
            parts = fleet.split(int(rng.integers(1, 8)))
            fleet = rs.Fleet.joined([parts[k] for k in rng.permutation(len(parts))])
        elif change == 1:
            fleet = rs.Fleet.restore(fleet.snapshot(), monitor(kind))
        elif change == 2:
            some = [str(one) for one in rng.permutation(ids)[: rng.integers(7)]]
            rest = [one for one in ids if one not in some]
            fleet = rs.Fleet.joined([rs.Fleet.restore(fleet.snapshot(part), monitor(kind)) for part in (some, rest)])
    assert np.array_equal(np.concatenate(statistic, axis=1), expected.statistic, equal_nan=True)


@pytest.mark.parametrize("kind", ["norm", "bank"])
def test_a_snapshot_keeps_alarms_and_last_decisions(kind: str) -> None:
    u, y = data(3, 60, 2)
    fleet = rs.Fleet(monitor(kind), plants=[1, 2, 3])
    fleet.update(u[:, :50], y[:, :50])
    again = rs.Fleet.restore(fleet.snapshot(), monitor(kind))
    assert again.alarms == fleet.alarms != []
    assert again.decision(1).named == fleet.decision(1).named != ()
    assert again.decision(1).fired == fleet.decision(1).fired
    assert again.decision(1).reading == fleet.decision(1).reading
    assert fleet.snapshot() == again.snapshot()


@pytest.mark.skipif(fused._kernel is None, reason="there is no compiled kernel")
@pytest.mark.parametrize("kind", KINDS)
def test_a_snapshot_has_the_same_bytes_without_the_kernel(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = data(6, 60, 5)
    made = []
    for kernel in (fused._kernel, None):
        monkeypatch.setattr(fused, "_kernel", kernel)
        fleet = rs.Fleet(monitor(kind), plants=range(6))
        for k in range(0, 60, 4):
            fleet.update(u[:, k : k + 3], y[:, k : k + 3])
            fleet.tick(None, u[:, k + 3], y[:, k + 3])
        made.append(fleet.snapshot())
    assert made[0] == made[1]


@pytest.mark.parametrize(
    ("skipped", "words"),
    [
        ([[7, 1, 2]], "skipped samples of this snapshot do not belong to its plants"),
        ([[0, -1, 2]], "do not belong to its plants"),
        ([[0, 3, 3]], "not in order"),
        ([[0, 3, 999]], "not in order"),
        ([[1, 3, 5], [0, 1, 2]], "not in order"),
        ([[0, 3, 5], [0, 5, 6]], "not in order"),
    ],
)
def test_skipped_samples_that_somebody_made_up_are_refused(
    skipped: list[list[int]], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    columns = snapshot._columns
    monkeypatch.setattr(snapshot, "_columns", lambda block: columns(block) | {"skipped": np.array(skipped)})
    with pytest.raises(FileFormatError, match=words):
        rs.Fleet.restore(taken(), monitor("norm"))


def test_plants_come_and_go() -> None:
    u, y = data(4, 50, 3)
    fleet = rs.Fleet(monitor("norm"), plants=[0, 1])
    for k in range(10):
        fleet.tick([0, 1], u[:2, k], y[:2, k])
    fleet.add([2, 3])
    assert fleet.plants == (0, 1, 2, 3)
    for k in range(10, 40):
        fleet.tick([3, 2, 1, 0], u[::-1, k], y[::-1, k])
    fleet.remove([1])
    assert len(fleet) == 3
    assert 1 not in fleet
    tick = fleet.tick([2, 0], u[[2, 0], 40], y[[2, 0], 40])
    own = monitor("norm")
    for p, first in ((2, 10), (0, 0)):
        own.reset()
        last = [own.step(u[p, k], y[p, k]) for k in range(first, 41)][-1]
        assert tick.statistic[[2, 0].index(p)] == last.statistic
    own.reset()


def test_several_models() -> None:
    u, y = data(4, 40, 4)
    fleet = rs.Fleet({"pumps": (monitor("norm"), ["p1", "p2"]), "valves": (monitor("CUSUM"), ["v1", "v2"])})
    assert fleet.models == ("pumps", "valves")
    for k in range(20):
        tick = fleet.tick(["v2", "p1", "v1", "p2"], u[:, k], y[:, k])
    pumps, valves = (rs.Fleet(monitor(kind), plants=[0, 1]) for kind in ("norm", "CUSUM"))
    one, other = pumps.update(u[[1, 3], :20], y[[1, 3], :20]), valves.update(u[[2, 0], :20], y[[2, 0], :20])
    assert isinstance(one, rs.monitor.Decisions)
    assert isinstance(other, rs.monitor.Decisions)
    own = [other.statistic[1, -1], one.statistic[0, -1], other.statistic[0, -1], one.statistic[1, -1]]
    assert np.array_equal(tick.statistic, own, equal_nan=True)
    blocks = fleet.update({"pumps": u[[1, 3], 20:]}, {"pumps": y[[1, 3], 20:]})
    assert isinstance(blocks, dict)
    assert list(blocks) == ["pumps"]
    again = rs.Fleet.restore(fleet.snapshot(), {"pumps": monitor("norm"), "valves": monitor("CUSUM")})
    assert again.plants == fleet.plants
    fleet.add(["p3"], model="pumps")
    assert fleet.plants == ("p1", "p2", "p3", "v1", "v2")
    assert repr(fleet) == "Fleet(5 plants of 2 models, 0 in alarm)"


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda f, u, y: f.tick([1, 99], u[:2], y[:2]), "no plant 99"),
        (lambda f, u, y: f.tick([1, 2], u[:2], y[:3]), r"y must have shape \(2, 2\).*got \(3, 2\)"),
        (lambda f, u, y: f.tick([1, 2], None, y[:2]), r"u must have shape \(2, 1\)"),
        (lambda f, u, y: f.tick([1], u[:1], [["high", 1.0]]), "y must be an array of numbers"),
        (lambda f, u, y: f.update(u[:, None], y[:2, None]), r"y must be \(3 plants, time, 2\), got shape"),
        (lambda f, u, y: f.add([2]), "2 is in the fleet already"),
        (lambda f, u, y: f.remove([7]), "no plant 7"),
        (lambda f, u, y: f.decision(3), "3 has had no sample yet"),
        (lambda f, u, y: f.snapshot([7]), "no plant 7"),
        (lambda f, u, y: rs.Fleet(monitor("norm"), plants=[1, 1]), "1 occurs twice"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_is_applied(call: Any, words: str) -> None:
    u, y = data(3, 5, 6)
    fleet = rs.Fleet(monitor("norm"), plants=[1, 2, 3])
    fleet.tick([1, 2], u[:2, 0], y[:2, 0])
    before = fleet.snapshot()
    with pytest.raises(DataError, match=words):
        call(fleet, u[:, 1], y[:, 1])
    assert fleet.snapshot() == before


def test_settings_that_do_not_fit_are_refused() -> None:
    unfitted = rs.Monitor(rs.design.unknown_input_observer(bare()).residual_generator())
    with pytest.raises(NotFittedError, match="needs a threshold"):
        rs.Fleet(unfitted, plants=[1])
    with pytest.raises(SettingError, match="plants is missing"):
        rs.Fleet(monitor("norm"))
    with pytest.raises(SettingError, match="threads"):
        rs.Fleet(monitor("norm"), plants=[1], threads=0)
    with pytest.raises(SettingError, match="takes monitors"):
        rs.Fleet(3, plants=[1])  # pyright: ignore[reportArgumentType]
    with pytest.raises(DataError, match="is in 'a' and in 'b'"):
        rs.Fleet({"a": (monitor("norm"), [1]), "b": (monitor("CUSUM"), [1])})
    one, other = rs.Fleet(monitor("norm"), plants=[1]), rs.Fleet(monitor("CUSUM"), plants=[2])
    with pytest.raises(DataError, match="different monitors"):
        rs.Fleet.joined([one, other])
    with pytest.raises(DataError, match="occurs twice"):
        rs.Fleet.joined([one, one])


# ------------------------------------------------------------------------- snapshots


def taken() -> bytes:
    fleet = rs.Fleet(monitor("norm"), plants=[1, 2, 3])
    fleet.update(*data(3, 30, 7))
    return fleet.snapshot()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda b: b[:-1], "cut short or was changed"),
        (lambda b: b[:20], "cut short"),
        (lambda b: b"", "not a snapshot"),
        (lambda b: b"PK" + b[2:], "not a snapshot"),
        (lambda b: b[:100] + bytes([b[100] ^ 1]) + b[101:], "was changed"),
        (lambda b: b[:8] + b"\x00" + b[9:], "version 0, this residua reads version 1: start the fleet without it"),
        (lambda b: b[:8] + b"\x09" + b[9:], "version 9, this residua reads version 1: upgrade residua"),
        (lambda b: b + b"x", "was changed"),
    ],
)
def test_a_damaged_snapshot_says_what_is_wrong(change: Any, words: str) -> None:
    with pytest.raises(FileFormatError, match=words):
        rs.Fleet.restore(change(taken()), monitor("norm"))


def test_a_snapshot_of_another_monitor_is_refused() -> None:
    with pytest.raises(FileFormatError, match="of another monitor"):
        rs.Fleet.restore(taken(), monitor("norm over a window"))
    with pytest.raises(FileFormatError, match="no monitor is given for"):
        rs.Fleet.restore(taken(), {"pumps": monitor("norm")})
    with pytest.raises(FileFormatError, match="all whole numbers, or all texts"):
        rs.Fleet(monitor("norm"), plants=[1, "b"]).snapshot()


def resealed(content: bytes, place: int, value: int) -> bytes:
    """Return a snapshot with one byte changed and a checksum that fits."""
    body = bytearray(content[:-32])
    body[place] = value
    return bytes(body) + snapshot.hashlib.sha256(body).digest()


def test_a_snapshot_that_somebody_made_up_runs_or_is_refused() -> None:
    """With a checksum that fits, too: nothing but an error of the package, and nothing that points beyond an array."""
    content, rng = taken(), np.random.default_rng(0)
    refused, (u, y) = 0, data(3, 3, 8)
    for _ in range(300):
        try:
            fleet = rs.Fleet.restore(resealed(content, int(rng.integers(len(content) - 32)), int(rng.integers(256))),
                                     monitor("norm"))  # fmt: skip
            with np.errstate(all="ignore"):
                fleet.update(u, y)
        except FileFormatError:
            refused += 1
    assert 0 < refused < 300


def ticked_events(kind: str, u: np.ndarray, y: np.ndarray) -> list[tuple[Any, ...]]:
    """Return what alarms did, plant by plant, read off the alarms that stand after every single sample."""
    out = []
    for p in range(len(u)):
        fleet, before = rs.Fleet(monitor(kind), plants=[p]), None
        for k in range(u.shape[1]):
            fleet.tick([p], u[[p], k], y[[p], k])
            now = fleet.alarms[0] if fleet.alarms else None
            if before is not None and (now is None or now.raised != before.raised):
                out.append((p, "ended", before.onset, before.raised, k * 2.0, before.candidates))
            if now is not None and (before is None or now.raised != before.raised):
                out.append((p, "raised", now.onset, now.raised, None, now.candidates))
            before = now
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_events_of_alarms_are_the_same_however_time_is_cut(kind: str) -> None:
    u, y = data(6, 90, 4)
    y[::2, 30:60, 1] += 8.0
    expected, rng = ticked_events(kind, u, y), np.random.default_rng(1)
    assert {one[1] for one in expected} == {"raised", "ended"}
    fleet, events, done = rs.Fleet(monitor(kind), plants=range(6)), [], np.zeros(6, dtype=int)
    while (done < 90).any():
        size = int(rng.integers(1, 30))
        who = [p for p in rng.permutation(6).tolist() if done[p] + size <= 90] or [int(done.argmin())]
        size = min(size, 90 - int(done[who].max()))
        parts = [np.array([one[p, done[p] : done[p] + size] for p in who]) for one in (u, y)]
        events += fleet.follow(who, *parts)
        done[who] += size
        fleet = rs.Fleet.restore(fleet.snapshot(), monitor(kind))
    events.sort(key=lambda one: (one.plant, one.sample, one.kind))
    assert [(e.plant, e.kind, e.onset, e.raised, e.ended, e.candidates) for e in events] == expected


@pytest.mark.parametrize("kind", ["norm", "norm over a window", "CUSUM", "patient bank", "observer"])
def test_samples_without_a_decision_do_not_move_an_onset(kind: str) -> None:
    """The onset is the first sample over the threshold, however many were missing since, as in `Monitor.run`."""
    u, y = data(6, 90, 4)
    y[::2, 20:60, 1] += 8.0
    y[np.random.default_rng(5).random(y.shape[:2]) < 0.4, 0] = np.nan
    made = rs.Fleet(monitor(kind), plants=range(6)).update(u, y)
    assert isinstance(made, rs.monitor.Decisions)
    expected, moved = [], 0
    for p in range(6):
        for t in np.flatnonzero(np.diff(made.alarm[p], prepend=False) & made.alarm[p]).tolist():
            up = int(made.up[p, t])
            onset = int(np.flatnonzero(made.usable[p, : t + 1])[-up]) if up else t + 1
            moved += onset != t + 1 - up
            expected.append((p, t, onset))
        diagnosis = monitor(kind).run(u[p], y[p])
        assert isinstance(diagnosis, rs.Diagnosis)
        if diagnosis.alarms and made.up[p, diagnosis.alarms[0].start]:
            assert diagnosis.alarms[0].onset == 2.0 * next(onset for q, _, onset in expected if q == p)
    assert moved > 1 or kind in ("CUSUM", "observer")
    rng = np.random.default_rng(2)
    fleet, events, done = rs.Fleet(monitor(kind), plants=range(6)), [], 0
    ticked, standing = rs.Fleet(monitor(kind), plants=range(6)), {}
    while done < 90:
        size = min(int(rng.integers(1, 12)), 90 - done)
        events += fleet.follow(range(6), u[:, done : done + size], y[:, done : done + size])
        fleet = rs.Fleet.restore(fleet.snapshot(), monitor(kind))
        for k in range(done, done + size):
            order = rng.permutation(6).tolist()
            ticked.tick(order, u[order, k], y[order, k])
            standing |= {(one.plant, one.raised / 2): one.onset / 2 for one in ticked.alarms}
        done += size
        fleet = rs.Fleet.joined(fleet.split(3))
    assert sorted((e.plant, e.sample, e.onset_sample) for e in events if e.kind == "raised") == expected
    assert standing == {(p, float(t)): float(onset) for p, t, onset in expected}


def test_following_refuses_what_does_not_fit() -> None:
    fleet = rs.Fleet(monitor("norm"), plants=[1, 2])
    with pytest.raises(DataError, match="no plant 3"):
        fleet.follow([3], np.zeros((1, 2, 1)), np.zeros((1, 2, 2)))
    with pytest.raises(DataError, match="plant 1 occurs twice"):
        fleet.follow([1, 1], np.zeros((2, 2, 1)), np.zeros((2, 2, 2)))
    with pytest.raises(DataError, match=r"2 plants, time, 2"):
        fleet.follow([1, 2], np.zeros((1, 2, 1)), np.zeros((1, 2, 2)))
    assert fleet.follow([], None, np.zeros((0, 2, 2))) == []
    assert fleet.follow([1], np.zeros((1, 0, 1)), np.zeros((1, 0, 2))) == []


def test_a_tuple_of_ids_that_comes_again_gives_the_bits_of_a_list() -> None:
    ids, other = (2, 1, 2, 3), (3, 3, 1, 2)
    u, y = data(4, 12, 11)
    once, again = (rs.Fleet(monitor("norm"), plants=[1, 2, 3]) for _ in range(2))
    for k in range(12):
        records = other if k == 5 else ids
        one, same = once.tick(list(records), u[:, k], y[:, k]), again.tick(records, u[:, k], y[:, k])
        assert np.array_equal(one.statistic, same.statistic, equal_nan=True)
        assert np.array_equal(one.alarm, same.alarm)
    assert once.snapshot() == again.snapshot()


@pytest.mark.parametrize("kind", KINDS)
def test_recordings_by_plant_give_the_diagnoses_of_a_monitor(kind: str) -> None:
    u, y = data(3, 90, 8)
    ids = ["a", "b", "c"]
    fleet = rs.Fleet(monitor(kind), plants=ids)
    fleet.update(u[:, :40], y[:, :40])
    before = fleet.snapshot()
    found = fleet.run({plant: (u[p], y[p]) for p, plant in enumerate(ids) if plant != "b"})
    assert list(found) == ["a", "c"]
    for plant, one in found.items():
        p = ids.index(str(plant))
        alone = monitor(kind).run(u[p], y[p])
        assert isinstance(alone, rs.Diagnosis)
        assert one.alarms == alone.alarms
        assert np.array_equal(one.statistic, alone.statistic, equal_nan=True)
        assert one.recording.source == plant
    assert found["a"].alarms
    assert fleet.snapshot() == before


def test_recordings_of_several_models_may_be_files_and_frames(tmp_path: Path) -> None:
    u, y = data(2, 60, 9)
    path = tmp_path / "rows.csv"
    np.savetxt(path, np.hstack([2.0 * np.arange(60)[:, None], u[0], y[0]]), delimiter=",", header="time,pump,low,high")
    path.write_text(path.read_text(encoding="utf-8").lstrip("# "), encoding="utf-8")
    fleet = rs.Fleet({"pumps": (monitor("norm"), ["p"]), "valves": (monitor("CUSUM"), ["v"])})
    found = fleet.run({"v": (u[1], y[1]), "p": path})
    for plant, kind, p in (("v", "CUSUM", 1), ("p", "norm", 0)):
        alone = monitor(kind).run(u[p], y[p])
        assert isinstance(alone, rs.Diagnosis)
        assert found[plant].alarms == alone.alarms


@pytest.mark.parametrize(
    ("recordings", "words"),
    [
        (lambda u, y: {"nobody": (u[0], y[0])}, "the fleet has no plant 'nobody'"),
        (lambda u, y: {"a": (u[0], y[0][:, :1])}, "'a': "),
        (lambda u, y: {"a": (u, y)}, "'a': give one recording"),
        (lambda u, y: u, r"update\(u, y\) goes on with a block"),
    ],
)
def test_recordings_that_do_not_fit_are_refused(recordings: Any, words: str) -> None:
    with pytest.raises(DataError, match=words):
        rs.Fleet(monitor("norm"), plants=["a"]).run(recordings(*data(2, 30, 1)))
