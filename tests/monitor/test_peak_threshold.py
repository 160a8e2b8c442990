"""The finite-horizon test in a monitor: no false alarm as certified, the maximum bit by bit, several faults told."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import residua as rs
from bank_examples import hand_made_bank, recording as noisy, sampled_plant
from dedicated_examples import (
    D1,
    D2,
    FAULTS,
    MEMBERS,
    THREE,
    A,
    K,
    dedicated_bank,
    member_gain,
    recording,
    three_drifts,
)
from residua.decide import (
    Directional,
    MultiscaleEWMA,
    NormThreshold,
    PeakThreshold,
    peak_over_window,
)
from residua.decide.member_thresholds import BankTest
from residua.decide.whitened_norm import NormTest
from residua.errors import DataError, FileFormatError, ModelError, NotFittedError, SettingError
from residua.linear import StateSpace, peak_input, peak_norm
from residua.monitor import PresentFault

BANK = dedicated_bank()
Change = Callable[[dict[str, Any]], Any]


def run(monitor: rs.Monitor, y: np.ndarray, u: np.ndarray | None = None) -> rs.Diagnosis:
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    return found


def gappy(y: np.ndarray, seed: int = 0) -> np.ndarray:
    """Single values, short gaps and some that are longer than is held, also just after the faults have come."""
    y, rng = y.copy(), np.random.default_rng(seed)
    for at in (*rng.integers(0, len(y), 25).tolist(), 2545, 2560, 4030):
        y[at : at + int(rng.choice([1, 3, 8, 30])), rng.integers(0, y.shape[1])] = np.nan
    return y


@pytest.fixture(scope="module")
def drifted() -> rs.Diagnosis:
    return run(rs.Monitor(BANK), three_drifts())


# ----------------------------------------------------------------- which test is run


def test_a_design_with_certified_thresholds_is_tested_by_them() -> None:
    monitor = rs.Monitor(BANK)
    assert monitor.test == PeakThreshold()
    test = monitor.norm_test
    assert isinstance(test, BankTest)
    assert test.thresholds.tolist() == [BANK.thresholds[name] for name in MEMBERS]
    assert (test.kind, test.persistence, test.release, test.window) == ("peak", 1, 60, 1)
    assert test.basis == "certified by the design over its uncertainty set"
    own = rs.Monitor(BANK, test=PeakThreshold(0.5, window=10)).norm_test
    assert isinstance(own, BankTest)
    assert (own.thresholds.tolist(), own.release, own.basis) == ([0.5] * 3, 10, "threshold given")
    short = rs.Monitor(BANK, test=PeakThreshold(window=10)).norm_test
    assert (short.release, short.basis) == (10, test.basis)


def test_any_other_design_is_tested_by_the_default() -> None:
    assert rs.Monitor(BANK.generator).test == MultiscaleEWMA()
    assert rs.Monitor(SimpleNamespace(generator=BANK.generator, thresholds=0.5)).test == MultiscaleEWMA()
    given = rs.Monitor(BANK, test=NormThreshold(threshold=1.0))
    assert given.norm_test.kind == "norm"
    with pytest.raises(NotFittedError, match=r"fit.*PeakThreshold\(thresholds"):
        rs.Monitor(BANK.generator, test=PeakThreshold()).norm_test  # noqa: B018
    with pytest.raises(NotFittedError, match="with_noise"):
        rs.Monitor(BANK.generator).norm_test  # noqa: B018


@pytest.mark.parametrize(
    ("thresholds", "words"),
    [
        ({"only XNH": 0.1}, "missing 'only XNL', 'only TMPC'"),
        ({**dedicated_bank().thresholds, "only XNH": -1.0}, "positive"),
        ({**dedicated_bank().thresholds, "other": 1.0}, "unknown 'other'"),
    ],
)
def test_certified_thresholds_that_do_not_fit_are_refused(thresholds: dict, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        rs.Monitor(SimpleNamespace(generator=BANK.generator, thresholds=thresholds))


def test_what_the_test_cannot_be_used_for_is_refused() -> None:
    for isolate in (None, Directional()):
        with pytest.raises(SettingError, match=r"members one by one: isolate=Structured\(\)"):
            rs.Monitor(BANK, isolate=isolate)
        assert isinstance(rs.Monitor(BANK, isolate=isolate, test=PeakThreshold(0.3)).norm_test, NormTest)
    with pytest.raises(SettingError, match="missing 'only XNL'"):
        rs.Monitor(BANK, test=PeakThreshold({"only XNH": 1.0, "only TMPC": 1.0}))
    with pytest.raises(SettingError, match="test must be"):
        rs.Monitor(BANK, test=3.0)  # pyright: ignore[reportArgumentType]
    continuous = rs.design.sensor_fault_bank(rs.library.three_tank(dt=0))
    certified = dict.fromkeys(continuous.members, 0.1)
    with pytest.raises(SettingError, match="continuous"):
        rs.Monitor(SimpleNamespace(generator=continuous.generator, thresholds=certified), dt=1.0)


# ---------------------------------------------------------------------- what is proved


@pytest.mark.parametrize("k", range(3))
def test_the_worst_disturbance_reaches_the_threshold_and_not_beyond(k: int) -> None:
    """The peak of a residual is attained; a threshold one in a thousand lower raises the alarm."""
    W = member_gain(k)
    error = StateSpace(A + K - W, D1 + K @ D2 - W @ D2, np.eye(3)[[k]], D2[[k]], dt=0.01)
    w = np.vstack([np.zeros((400, 3)), peak_input(error, peak_norm(error), 600)])
    loop = StateSpace(A + K, D1 + K @ D2, np.eye(3), D2, dt=0.01)
    y = loop.simulate(w)
    found = run(rs.Monitor(dedicated_bank(scale=1 + 1e-9)), y)
    assert not found.fault_detected
    assert np.nanmax(found.statistic) == pytest.approx(1.0, abs=1e-4)
    lower = run(rs.Monitor(dedicated_bank(scale=0.999)), y)
    assert [alarm.reading.fired for alarm in lower.alarms if alarm.reading] == [(MEMBERS[k],)]


@pytest.mark.parametrize("seed", range(4))
def test_there_is_no_false_alarm_and_no_cross_talk(seed: int) -> None:
    monitor = rs.Monitor(BANK)
    assert not run(monitor, recording(seed=seed)).fault_detected
    fault = FAULTS[seed % 3]
    found = run(monitor, recording(drifts={fault: (25.0, 0.5)}, seed=seed))
    assert [c.faults for c in found.candidates[:1]] == [(fault,)]
    assert found.parts.fired[:, [k for k in range(3) if FAULTS[k] != fault]].sum() == 0
    assert 25.0 < (found.onset or 0.0) < 26.0


# ------------------------------------------------------------- the same as the maximum


@pytest.mark.parametrize("window", [1, 7, 60])
@pytest.mark.parametrize("gaps", [False, True])
def test_every_alarm_is_that_of_the_moving_maximum(window: int, gaps: bool) -> None:
    monitor = rs.Monitor(BANK, test=PeakThreshold(window=window))
    y = recording(45.0, drifts={FAULTS[0]: (25.0, 0.2), FAULTS[2]: (40.0, 0.1)}, size=1.2, seed=7)
    found = run(monitor, gappy(y) if gaps else y)
    judged = np.where(found.decided[:, None], found.residuals, np.nan)
    for m, name in enumerate(MEMBERS):
        peaks = peak_over_window(judged[:, m], window)
        assert np.array_equal(found.parts.fired[:, m], peaks > BANK.thresholds[name])
        assert np.array_equal(found.parts.statistics[:, m], np.abs(judged[:, m]), equal_nan=True)
    assert np.array_equal(found.parts.code, found.parts.fired)
    assert found.parts.fired.any(axis=0).tolist() == [True, bool(gaps) and found.parts.fired[:, 1].any(), True]
    assert found.n_missing > 0 if gaps else found.n_missing == 0


def test_a_residual_as_a_whole_is_tested_by_one_threshold_and_named_by_direction() -> None:
    plant = sampled_plant(3)
    kalman = rs.design.kalman_filter(plant)
    monitor = rs.Monitor(kalman, test=PeakThreshold(2.0, window=25))
    assert isinstance(monitor.isolate, Directional)
    u, y = noisy(plant, faults={"y2 sensor": 4.0})
    y[900:903] = np.nan
    found = run(monitor, y, u)
    judged = np.where(found.decided[:, None], found.residuals, np.nan)
    assert np.array_equal(found.alarm, peak_over_window(judged, 25) > 2.0)
    assert found.candidates[0].faults == ("y2 sensor",)
    assert found.settings["test"].startswith("finite-horizon peak test, window 25 samples (12.5 s), threshold given")
    alone = SimpleNamespace(generator=kalman, thresholds={kalman.members[0].name: 2.0})
    certified = rs.Monitor(alone, test=PeakThreshold(window=25))
    assert certified.norm_test.basis.startswith("certified")
    assert np.array_equal(run(certified, y, u).alarm, found.alarm)


def test_an_alarm_neither_begins_nor_ends_while_nothing_is_judged() -> None:
    y = recording(20.0, seed=1)
    y[1000] += [1.0, 0.0, 0.0]  # one sample over
    monitor = rs.Monitor(BANK)
    plain = run(monitor, y)
    assert plain.alarms[0].stop - plain.alarms[0].start >= 60
    y[1030:1045] = np.nan  # longer than is held: the filter starts anew and settles
    found = run(monitor, y)
    settling = monitor.settling_samples
    assert found.alarm[1000 : 1045 + settling].all()
    decided = found.decided[1000:]
    assert decided[: found.alarms[0].stop - 1000].sum() == plain.alarms[0].samples


def test_any_other_bank_runs_it_too() -> None:
    """Generalized: the codes are read as ever, from members over their thresholds."""
    plant = sampled_plant(2)
    monitor = rs.Monitor(hand_made_bank(plant), test=PeakThreshold([3.5] * 4, window=20))
    u, y = noisy(plant, faults={"y2 sensor": 15.0})
    found = run(monitor, y, u)
    assert found.candidates[0].faults == ("y2 sensor",)
    assert found.main_alarm is not None
    assert found.main_alarm.present == ()
    assert "present" not in found.main_alarm.to_dict()


# ------------------------------------------------------------------------- fitting


def test_fit_does_not_change_what_is_certified() -> None:
    monitor = rs.Monitor(BANK)
    before = monitor.norm_test
    assert isinstance(before, BankTest)
    monitor.fit(None, recording(30.0, seed=5), false_alarm_rate=0.3)
    after = monitor.norm_test
    assert isinstance(after, BankTest)
    assert np.array_equal(after.thresholds, before.thresholds)
    assert np.array_equal(after.whitening, np.eye(3))
    assert not after.center.any()
    shares = run(monitor, recording(30.0, seed=5))
    largest = 100 * np.nanmax(shares.parts.statistics, axis=0) / after.thresholds
    told = ", ".join(f"{s:.3g} % of that of {name}" for s, name in zip(largest, MEMBERS, strict=True))
    assert after.basis == f"{before.basis}; {int(shares.decided.sum())} fault-free samples reached {told}"
    assert shares.settings["threshold"].endswith(f"({after.basis})")


@pytest.mark.parametrize(
    ("y", "words"),
    [
        (recording(30.0, size=1.5), r"threshold of 'only \w+'.*certified.*larger than 1.*uncertainty set.*fault in it"),
        (recording(30.0, drifts={FAULTS[1]: (10.0, 0.5)}), "threshold of 'only XNL': .* times the threshold of 0.1335"),
        (recording(0.5), "no sample of this recording is usable.*settling takes"),
    ],
)
def test_a_recording_that_breaks_an_assumption_is_refused(y: np.ndarray, words: str) -> None:
    monitor = rs.Monitor(BANK)
    before = monitor.norm_test
    with pytest.raises(DataError, match=words):
        monitor.fit(None, y)
    assert monitor.norm_test is before


def test_given_thresholds_are_held_against_the_recording_too() -> None:
    y = recording(30.0, seed=5)
    monitor = rs.Monitor(BANK.generator, test=PeakThreshold([0.2, 0.2, 0.1])).fit(None, y)
    assert monitor.norm_test.basis.startswith("threshold given; ")
    with pytest.raises(DataError, match="or higher thresholds"):
        rs.Monitor(BANK.generator, test=PeakThreshold(0.05)).fit(None, y)


def test_without_thresholds_fit_chooses_them() -> None:
    normal = recording(650.0, seed=5)  # the tail of bounded signals is lighter than assumed
    monitor = rs.Monitor(BANK.generator, test=PeakThreshold()).fit(None, normal, false_alarm_rate=0.03, held_out=0.0)
    test = monitor.norm_test
    assert isinstance(test, BankTest)
    assert not test.center.any()
    for m, name in enumerate(MEMBERS):
        assert 0.6 * BANK.thresholds[name] < test.thresholds[m] < BANK.thresholds[name]
    found = run(monitor, recording(400.0, seed=6))
    assert 0 < found.false_alarm_fraction < 0.05
    assert test.promised is not None
    assert test.promised > 0.045, "the windows of this recording are too few for that rate, and fit says so"
    assert "1 in 33 samples requested, 1 in 10 confirmed by 64,915 samples" in str(monitor.fit_check)
    assert found.settings["test"].startswith("finite-horizon peak test, window 60 samples (0.6 s), thresholds fitted")


# -------------------------------------------------------------------- several faults


def test_three_drifts_are_three_faults_with_their_times(drifted: rs.Diagnosis) -> None:
    (alarm,) = drifted.alarms
    assert alarm.reading is not None
    assert (alarm.reading.answer, alarm.reading.together) == ("several", tuple((f,) for f in FAULTS))
    assert alarm.candidates == (), "they are no alternatives of each other"
    assert drifted.named == alarm.named == tuple((f,) for f in FAULTS)
    assert [p.faults[0] for p in alarm.present] == list(THREE)
    assert drifted.present == alarm.present
    for fault in alarm.present:
        start = THREE[fault.faults[0]][0]
        assert start < fault.since < start + 1.0
        m = MEMBERS.index(fault.member)
        assert fault.since == drifted.time[drifted.parts.fired[:, m].argmax()]
        assert fault.until is None
    assert alarm.present[0].since == alarm.onset
    only_at_the_end = float(drifted.parts.fired[alarm.start :].all(axis=1).mean())
    assert alarm.read_share == pytest.approx(only_at_the_end)


def test_text_and_lines_tell_when_each_came(drifted: rs.Diagnosis, tmp_path: Path) -> None:
    lines = str(drifted).splitlines()
    times = [f"{p.since:.6g}" for p in drifted.present]
    assert lines[-4:-1] == [f"  {name}, its member fired from {t} s" for name, t in zip(THREE, times, strict=True)]
    assert lines[-1] == "  either XNH sensor, XNL sensor and TMPC sensor at once or something not listed"
    assert "several faults: 'XNH sensor', 'XNL sensor' and 'TMPC sensor'" in str(drifted)
    drifted.write_alarms(tmp_path / "alarms.jsonl")
    (line,) = map(json.loads, (tmp_path / "alarms.jsonl").read_text().splitlines())
    assert (line["word"], line["together"], line["unlisted"]) == ("either", True, "anything")
    assert line["code"]["answer"] == "several"
    assert line["code"]["together"] == [[name] for name in FAULTS]
    assert [(p["faults"], p["member"], p["until"]) for p in line["present"]] == [
        ([name], MEMBERS[FAULTS.index(name)], None) for name in THREE
    ]
    assert [p["since"] for p in line["present"]] == [pytest.approx(p.since, abs=1e-9) for p in drifted.present]


def test_a_fault_that_goes_is_told_with_its_end() -> None:
    y = recording(60.0, drifts={FAULTS[0]: (20.0, 0.5), FAULTS[2]: (30.0, 0.5, 40.0)}, seed=2)
    found = run(rs.Monitor(BANK), y)
    first, second = found.present
    assert (first.faults, first.until) == (("XNH sensor",), None)
    assert second.faults == ("TMPC sensor",)
    assert second.since == pytest.approx(30.5, abs=0.5)
    assert second.until == pytest.approx(41.0, abs=1.0)
    last = np.flatnonzero(found.parts.fired[:, 2])[-1]
    assert second.until == found.time[last + 1]
    assert f"TMPC sensor, its member fired from {second.since:.6g} s until {second.until:.6g} s" in str(found)


def test_a_drift_that_flickers_is_one_alarm_with_what_comes_later() -> None:
    """The threshold is crossed back and forth at first, then a second sensor drifts: the first keeps its first time."""
    monitor = rs.Monitor(BANK, test=PeakThreshold(window=5))
    found = run(monitor, recording(60.0, drifts={FAULTS[0]: (20.0, 0.03), FAULTS[1]: (40.0, 0.5)}, seed=3))
    edges = np.flatnonzero(np.diff(found.parts.fired[:, 0].astype(int)) == 1)
    assert len(edges) > 3, "it flickers"
    main = found.main_alarm
    assert main is not None
    assert {p.faults[0] for p in main.present} == set(FAULTS[:2])
    assert main.present[0].since == main.onset
    apart = [b.start - a.stop for a, b in zip(found.alarms, found.alarms[1:], strict=False)]
    assert all(gap >= 50 for gap in apart)


def test_a_bank_by_noise_names_a_fault_that_comes_late_too() -> None:
    """Whitened norms with false alarms: the pattern that stood the longest is that of the first fault alone."""
    plant = sampled_plant(1)
    monitor = rs.Monitor(hand_made_bank(plant, dedicated=True), test=NormThreshold(window=10))
    monitor.fit(*noisy(plant, 6000, seed=99), false_alarm_rate=1e-3)
    u, y = noisy(plant, 3000, faults={plant.faults[0]: 4.0}, start=800, seed=1)
    later = noisy(plant, 3000, faults={plant.faults[2]: 6.0}, start=2600, seed=1)[1]
    y += later - noisy(plant, 3000, seed=1)[1]
    found = run(monitor, y, u)
    assert found.main_alarm is not None
    assert found.main_alarm.reading is not None
    assert found.main_alarm.reading.together == ((plant.faults[0],), (plant.faults[2],))
    assert found.present[1].since == pytest.approx(1300.0, abs=6.0)
    stood = (found.parts.code[found.main_alarm.start :] == [True, False, False, False]).all(axis=1).mean()
    assert stood > 0.6


def test_a_single_fault_has_its_time_too() -> None:
    found = run(rs.Monitor(BANK), recording(40.0, drifts={FAULTS[1]: (25.0, 0.5)}))
    assert found.main_alarm is not None
    assert found.main_alarm.reading is not None
    assert found.main_alarm.reading.answer == "exact"
    assert found.present == (PresentFault(("XNL sensor",), "only XNL", found.main_alarm.onset, None),)
    assert "fired from" not in str(found)


# ------------------------------------------------------------------- live, and files


def test_step_tells_the_same_as_run() -> None:
    monitor = rs.Monitor(BANK)
    y = gappy(recording(45.0, drifts={FAULTS[0]: (25.0, 0.5), FAULTS[2]: (40.0, 0.5)}), 1)
    whole = run(monitor, y)
    assert len(whole.alarms) == 1
    monitor.reset()
    for k in range(len(y)):
        now = monitor.step(None, y[k])
        assert now.statistic == whole.statistic[k] or np.isnan(whole.statistic[k])
        assert (now.alarm, now.decided) == (whole.alarm[k], whole.decided[k])
        assert now.fired == tuple(np.array(MEMBERS)[whole.parts.fired[k]])
        seen = [replace(p, until=None) for p in whole.present if p.since <= whole.time[k] + 1e-9] if now.alarm else []
        assert [p.faults for p in now.present] == [p.faults for p in seen]
        assert [p.since for p in now.present] == pytest.approx([p.since for p in seen], abs=1e-9)
        assert set(now.named) >= {p.faults for p in now.present}
        if now.present:
            assert now.reading is not None
            assert now.reading.answer == ("exact" if len(seen) == 1 else "several")


@pytest.mark.parametrize(
    "thresholds", [None, 0.2, {"only TMPC": 0.1, "only XNH": 0.2, "only XNL": 0.2}, [0.2, 0.2, 0.1]]
)
@pytest.mark.parametrize("at", [0, 2510, 2600, 4100])
def test_a_saved_monitor_goes_on_bit_for_bit(tmp_path: Path, thresholds: Any, at: int) -> None:
    monitor = rs.Monitor(BANK, test=PeakThreshold(thresholds))
    y = gappy(recording(45.0, drifts={FAULTS[0]: (25.0, 0.5), FAULTS[2]: (40.0, 0.5)}), 1)
    whole = run(monitor, y)
    monitor.reset()
    monitor.update(None, y[:at])
    monitor.save(tmp_path / "m.json")
    loaded = rs.Monitor.load(tmp_path / "m.json")
    assert loaded.test == monitor.test
    assert type(loaded.test) is PeakThreshold
    assert loaded.norm_test.basis == monitor.norm_test.basis
    loaded.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_text() == (tmp_path / "m.json").read_text()
    rest = loaded.update(None, y[at:])
    names = {"fired": "parts.fired", "code": "parts.code", "member_statistics": "parts.statistics"}
    for name in ("statistic", "alarm", "fired", "code", "scores", "member_statistics"):
        theirs, ours = getattr(rest, name)[0], attrgetter(names.get(name, name))(whole)[at:]
        assert np.array_equal(theirs, ours, equal_nan=theirs.dtype.kind == "f"), name
    last = loaded.step(None, y[-1])
    assert [p.since for p in last.present] == pytest.approx([p.since for p in whole.present], abs=1e-9)


def test_a_loaded_monitor_still_knows_what_is_certified(tmp_path: Path) -> None:
    rs.Monitor(BANK).save(tmp_path / "m.json")
    loaded = rs.Monitor.load(tmp_path / "m.json")
    loaded.fit(None, recording(30.0, seed=5))
    assert loaded.norm_test.basis.startswith("certified by the design over its uncertainty set; 2746 fault-free")
    with pytest.raises(DataError, match="certified"):
        loaded.fit(None, recording(30.0, size=2.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["test"].pop("kind"), "test.kind"),
        (lambda c: c["test"].update(kind="guess"), "test.kind: expected one of multiscale ewma, norm, peak"),
        (lambda c: c["test"].update(kind="norm"), "test"),
        (lambda c: c["test"].update(thresholds="high"), "test.thresholds"),
        (lambda c: c["test"].update(thresholds={"only XNH": 1.0}), "missing 'only XNL'"),
        (lambda c: c["test"].update(window=0), "window"),
        (lambda c: c["test"].pop("window"), "test.window"),
        (lambda c: c["fitted"].update(kind="norm"), "fitted.kind"),
        (lambda c: c["certified"].pop("only XNH"), "missing 'only XNH'"),
        (lambda c: c["certified"].update({"only XNH": "high"}), "certified.only XNH"),
        (lambda c: c.pop("certified"), "certified"),
        (lambda c: c["state"]["isolation"]["since"].update(shape=[3]), "state.isolation.since"),
        (lambda c: c["state"]["isolation"]["since"]["int"].__setitem__(0, -1), "state.isolation.since"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, change: Change, words: str) -> None:
    monitor = rs.Monitor(BANK)
    monitor.update(None, recording(1.0))
    monitor.save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    change(content)
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=words):
        rs.Monitor.load(tmp_path / "m.json")


# ------------------------------------------------------------- plants without inputs


def test_a_plant_without_inputs_is_watched_by_its_outputs_alone() -> None:
    monitor, y = rs.Monitor(BANK), three_drifts()
    whole = run(monitor, y)
    nothing = np.zeros((len(y), 0))
    assert np.array_equal(run(monitor, y, nothing).statistic, whole.statistic, equal_nan=True)
    monitor.reset()
    parts = [monitor.update(None, piece).statistic[0] for piece in np.array_split(y, 7)]
    assert np.array_equal(np.concatenate(parts), whole.statistic, equal_nan=True)
    fleet = monitor.run(None, np.stack([y, recording()]))
    assert isinstance(fleet, list)
    assert [d.fault_detected for d in fleet] == [True, False]
    assert np.array_equal(fleet[0].parts.fired, whole.parts.fired)
    timed = monitor.run(None, y, time=5.0 + 0.01 * np.arange(len(y)))
    assert isinstance(timed, rs.Diagnosis)
    assert timed.onset == pytest.approx((whole.onset or 0.0) + 5.0)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".mat", ".parquet"])
def test_files_of_outputs_alone_are_read_and_run(tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture) -> None:
    pytest.importorskip("typer")
    y, path = three_drifts(), tmp_path / f"drift{suffix}"
    table = {"time": 0.01 * np.arange(len(y))} | {name: y[:, k] for k, name in enumerate(("XNH", "XNL", "TMPC"))}
    if suffix in (".csv", ".parquet"):
        if suffix == ".parquet":
            pytest.importorskip("pyarrow")
        rs.monitor.write_table(path, table)
    elif suffix == ".npz":
        np.savez(path, y=y)
    else:
        import scipy.io

        scipy.io.savemat(path, {"y": y})
    data = rs.read_recording(path, BANK.generator.plant)
    assert (data.u.shape, data.y.shape, data.dt) == ((7000, 0), (7000, 3), pytest.approx(0.01))
    found = rs.Monitor(BANK).run(data)
    assert isinstance(found, rs.Diagnosis)
    assert [p.faults[0] for p in found.present] == list(THREE)

    from residua.cli import main

    rs.Monitor(BANK).save(tmp_path / "m.json")
    page, lines = tmp_path / "page.html", tmp_path / "alarms.jsonl"
    assert main(["run", str(tmp_path / "m.json"), str(path), "--report", str(page), "--alarms", str(lines)]) == 1
    assert "either 3 at once, XNH sensor (fired from 25.3 s), TMPC sensor (fired" in capsys.readouterr().out.replace(
        "\n", " "
    )
    assert [p["faults"] for p in json.loads(lines.read_text())["present"]] == [[name] for name in THREE]
    assert "Fault found: either 3 at once" in page.read_text(encoding="utf-8")
    if suffix == ".csv":
        normal = tmp_path / "normal.csv"
        rs.monitor.write_table(normal, {name: column[:2400] for name, column in table.items()})
        assert main(["fit", str(tmp_path / "m.json"), str(normal), "-o", str(tmp_path / "f.json")]) == 0
        assert "fault-free samples reached" in capsys.readouterr().out
        assert main(["fit", str(tmp_path / "m.json"), str(path), "-o", str(tmp_path / "f.json")]) == 2
        assert "goes over the threshold" in capsys.readouterr().err


def test_frames_of_outputs_alone_are_matched_by_name() -> None:
    pandas = pytest.importorskip("pandas")
    y = three_drifts()
    frame = pandas.DataFrame({"TMPC": y[:, 2], "XNL": y[:, 1], "XNH": y[:, 0]}, index=None)
    frame["time"] = 0.01 * np.arange(len(y))
    found = rs.Monitor(BANK).run(frame)
    assert isinstance(found, rs.Diagnosis)
    assert [p.faults[0] for p in found.present] == list(THREE)
    assert np.array_equal(run(rs.Monitor(BANK), frame[["XNL", "XNH", "TMPC"]]).parts.fired, found.parts.fired)
