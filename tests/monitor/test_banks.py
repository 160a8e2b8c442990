"""Banks in a monitor: every single fault named, two told as such, rates kept, the same bits however the work is cut."""

from __future__ import annotations

import json
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import residua as rs
from bank_examples import hand_made_bank, recording, sampled_plant, with_gaps
from effort import cases
from residua.decide import Directional, NormThreshold, Structured, read_codes
from residua.decide.member_thresholds import BankTest
from residua.decide.norm_threshold import fit_norm_test
from residua.errors import FileFormatError, ModelError, SettingError
from residua.monitor.fused import run_block
from residua.monitor.running import Decisions
from residua.records import values_out

FIELDS = {
    "residuals": "residuals",
    "statistic": "statistic",
    "alarm": "alarm",
    "usable": "decided",
    "scores": "scores",
    "member_statistics": "parts.statistics",
    "fired": "parts.fired",
    "code": "parts.code",
}


def make(
    seed: int = 0,
    *,
    dedicated: bool = False,
    average: int = 1,
    rate: float = 0.01,
    samples: int = 4000,
    window: int = 50,
) -> rs.Monitor:
    plant = sampled_plant(seed)
    generator = hand_made_bank(plant, dedicated=dedicated)
    monitor = rs.Monitor(generator, test=NormThreshold(window=average), isolate=Structured(window=window))
    return monitor.fit(*recording(plant, samples, seed=99), false_alarm_rate=rate, held_out=0.0)


def run(monitor: rs.Monitor, u: np.ndarray, y: np.ndarray) -> rs.Diagnosis:
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    return found


def same(parts: list[Decisions], whole: rs.Diagnosis, plant: int = 0) -> None:
    for theirs, ours in FIELDS.items():
        joined = np.concatenate([getattr(part, theirs)[plant] for part in parts])
        expected = attrgetter(ours)(whole)
        assert joined.shape == expected.shape, ours
        assert np.array_equal(joined, expected, equal_nan=joined.dtype.kind == "f"), ours


# -------------------------------------------------------------------- who is named


@pytest.mark.parametrize("seed", cases(range(4), 2))
@pytest.mark.parametrize("dedicated", [False, True])
def test_every_single_fault_is_read_exactly(seed: int, dedicated: bool) -> None:
    plant = sampled_plant(seed)
    monitor = make(seed, dedicated=dedicated, rate=1e-3, average=10)
    for fault in plant.faults:
        found = run(monitor, *recording(plant, faults={fault: 6.0}, seed=seed + 10))
        alarm = found.main_alarm
        assert alarm is not None
        assert alarm.reading is not None
        assert (alarm.reading.answer, alarm.reading.faults) == ("exact", (fault,)), alarm.reading
        assert found.candidates[0].faults == (fault,)
        assert found.candidates[0].score == 1.0
        assert found.onset == pytest.approx(400.0, abs=8.0)
        assert alarm.read_share is not None
        assert alarm.read_share > 0.9
        others = {c.faults[0]: c.score for c in found.candidates[1:]}
        assert set(others.values()) == {1 - 2 / len(found.members)}  # two columns of such a bank differ twice


@pytest.mark.parametrize("seed", range(3))
def test_two_faults_are_not_called_by_one_name(seed: int) -> None:
    plant = sampled_plant(seed)
    two = {plant.faults[0]: 3.0, plant.faults[2]: -2.0}
    data = recording(plant, faults=two, seed=seed)
    general = run(make(seed, average=10), *data).main_alarm
    assert general is not None
    assert general.reading is not None
    assert general.reading.answer == "unknown"
    assert general.candidates == ()
    assert general.named == (), "nobody is named by a code that is not known"
    assert ((plant.faults[0],), (plant.faults[2],)) in general.reading.pairs
    dedicated = run(make(seed, dedicated=True, average=10, rate=1e-3), *data)
    assert dedicated.main_alarm is not None
    reading = dedicated.main_alarm.reading
    assert reading is not None
    assert reading.answer == "several"
    assert reading.together == ((plant.faults[0],), (plant.faults[2],))
    assert reading.pairs == (((plant.faults[0],), (plant.faults[2],)),)
    assert dedicated.main_alarm.candidates == ()
    assert "several faults: 'y1 sensor' and 'y3 sensor'" in str(dedicated)
    assert {p.faults for p in dedicated.present} == set(reading.together)
    assert dedicated.present[0].since == dedicated.main_alarm.raised
    for fault in dedicated.present:  # one member is slow, and a false alarm just before is taken for the fault
        assert fault.since == pytest.approx(400.0, abs=25.0)
        assert fault.until is None


def test_what_fires_every_member_is_the_code_of_the_actuators() -> None:
    plant = sampled_plant(1, actuators=True)
    monitor = rs.Monitor(hand_made_bank(plant), test=NormThreshold(window=10)).fit(*recording(plant, 3000, seed=99))
    found = run(monitor, *recording(plant, faults={plant.faults[-1]: 4.0}))
    assert found.candidates[0].faults == plant.faults[-2:]
    assert found.main_alarm is not None
    assert found.main_alarm.reading is not None
    assert len(found.main_alarm.reading.pairs) == 6  # two sensors at once look the same


def test_an_actuator_that_the_bank_does_not_know_is_not_called_a_sensor() -> None:
    whole = sampled_plant(1, actuators=True)
    monitor = make(1, average=10)
    found = run(monitor, *recording(whole, faults={whole.faults[-1]: 4.0}))
    assert found.main_alarm is not None
    assert found.main_alarm.reading is not None
    assert found.main_alarm.reading.answer == "unknown"


def test_the_pattern_that_stood_the_longest_is_read() -> None:
    monitor = make(0, average=40)
    found = run(monitor, *recording(sampled_plant(0), faults={"y2 sensor": 0.5}, seed=3))
    alarm = found.main_alarm
    assert alarm is not None
    assert alarm.reading is not None
    stretch = found.parts.code[alarm.start : alarm.stop]
    rows, counts = np.unique(stretch[stretch.any(axis=1)], axis=0, return_counts=True)
    assert tuple(rows[counts.argmax()]) == alarm.reading.pattern
    assert alarm.read_share == pytest.approx(counts.max() / counts.sum(), abs=0.02)
    assert len(rows) > 1, "the members do not fire together, and that is not read as another fault"


def test_readings_of_a_fleet_are_those_of_the_code() -> None:
    monitor = make(0, average=10)
    plant = sampled_plant(0)
    data = [recording(plant, 900, faults={f: 2.0}, start=500) for f in plant.faults]
    found = monitor.update(np.stack([u for u, _ in data]), np.stack([y for _, y in data]))
    codes = monitor.generator.codes
    assert codes is not None
    index, readings = read_codes(found.code[:, -1], codes, plant.faults)
    assert [readings[k].faults for k in index] == [(f,) for f in plant.faults]
    assert found.scores.shape == (4, 900, 4)
    assert found.scores[:, -1].argmax(axis=1).tolist() == [0, 1, 2, 3]


# --------------------------------------------------------------------- false alarms


@pytest.mark.parametrize("seed", cases(range(3), 1))
@pytest.mark.parametrize("dedicated", [False, True])
def test_the_whole_bank_keeps_the_rate_asked_for(seed: int, dedicated: bool) -> None:
    monitor = make(seed, dedicated=dedicated, rate=0.02, samples=40_000)
    found = run(monitor, *recording(sampled_plant(seed), 40_000, seed=5))
    each = found.parts.fired[found.decided].mean(axis=0)
    assert each == pytest.approx(0.02 / 4, abs=0.0035)
    assert 0.01 < found.false_alarm_fraction < 0.023
    assert found.false_alarm_fraction <= each.sum()


def test_without_data_the_noise_model_gives_every_threshold() -> None:
    plant = sampled_plant(2)
    test = NormThreshold(persistence=1, false_alarm_rate=0.01)
    monitor = rs.Monitor(hand_made_bank(plant), test=test)
    found = run(monitor, *recording(plant, 40_000, seed=5))
    exceeded = (found.parts.statistics > found.parts.thresholds)[found.decided].mean(axis=0)
    np.testing.assert_allclose(exceeded, 0.0025, atol=0.001)
    assert isinstance(monitor.norm_test, BankTest)
    assert "1/4 of the rate of the whole bank" in monitor.norm_test.basis


def test_every_member_is_whitened_and_fitted_on_its_own() -> None:
    monitor = make(1, average=4, rate=0.01)
    test, g = monitor.norm_test, monitor.generator
    assert isinstance(test, BankTest)
    u, y = recording(sampled_plant(1), 4000, seed=99)
    residuals = g.run(u - g.plant.operating_point.inputs, y - g.plant.operating_point.outputs)
    usable = np.arange(4000) >= monitor.settling_samples
    for (a, b), member, threshold in zip(test.columns, g.members, test.thresholds, strict=True):
        rows = list(member.residuals)
        low, alone = (
            fit_norm_test(
                NormThreshold(window=4),
                residuals[:, rows],
                usable,
                false_alarm_rate=share,
                covariance=None,
                signal_size=1.0,
            )
            for share in (0.01, 0.0025)
        )
        # its share of the rate is a quarter at least, and less than all; the start differs by a few samples
        assert 0.98 * low.threshold < threshold < 1.02 * alone.threshold
        np.testing.assert_allclose(np.abs(test.whitening[rows, a:b]), np.abs(alone.whitening), rtol=0.1, atol=0.5)
        assert not np.delete(test.whitening[:, a:b], rows, axis=0).any()
    assert test.band.shape == (g.n_residuals,)
    assert np.isfinite(test.band).all()


def test_the_statistics_are_the_norms_of_the_whitened_members() -> None:
    monitor = make(1, average=5)
    found = run(monitor, *recording(sampled_plant(1), 300))
    test = monitor.norm_test
    assert isinstance(test, BankTest)
    q = (found.residuals - found.test.center) @ found.test.whitening
    q[~found.decided] = 0.0
    for m, (a, b) in enumerate(test.columns):
        sums = np.array([q[max(0, k - 4) : k + 1, a:b].sum(axis=0) for k in range(300)])
        expected = np.linalg.norm(sums, axis=1) / np.sqrt(5)
        np.testing.assert_allclose(found.parts.statistics[found.decided, m], expected[found.decided])
    ratio = (found.parts.statistics / found.parts.thresholds).max(axis=1)
    assert np.array_equal(ratio, found.statistic, equal_nan=True)
    assert found.threshold == 1.0
    assert np.array_equal(found.alarm, found.parts.fired.any(axis=1))


# ------------------------------------------------------------- cutting, saving, fleets


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("average", [1, 12])
@pytest.mark.parametrize("window", [1, 37])
def test_any_cutting_gives_the_same_bits(gaps: bool, average: int, window: int) -> None:
    monitor = make(average=average, window=window)
    u, y = recording(sampled_plant(0), faults={"y2 sensor": 1.0})
    u, y = with_gaps(u, y) if gaps else (u, y)
    whole = run(monitor, u, y)
    rng = np.random.default_rng(0)
    for _ in range(3):
        monitor.reset()
        cuts = np.sort(rng.integers(0, len(u) + 1, 20))
        same([monitor.update(a, b) for a, b in zip(np.split(u, cuts), np.split(y, cuts), strict=True)], whole)


@pytest.mark.parametrize("gaps", [False, True])
def test_step_equals_run_to_the_last_bit(gaps: bool) -> None:
    monitor = make(average=6)
    u, y = recording(sampled_plant(0), faults={"y2 sensor": 1.0})
    u, y = with_gaps(u, y) if gaps else (u, y)
    whole = run(monitor, u, y)
    codes = monitor._specification().isolation.coding
    assert codes is not None
    monitor.reset()
    for k in range(len(u)):
        now = monitor.step(u[k], y[k])
        assert now.statistic == whole.statistic[k] or np.isnan(whole.statistic[k])
        assert (now.alarm, now.decided, now.missing) == (whole.alarm[k], whole.decided[k], whole.missing[k])
        assert now.fired == tuple(np.array(whole.members)[whole.parts.fired[k]])
        assert now.reading == (codes.read(whole.parts.code[k]) if now.alarm else None)
        if now.candidates and now.decided:
            assert now.candidates[0].score == whole.scores[k, codes.groups.index(now.candidates[0].faults)]


@pytest.mark.parametrize("at", [0, 1, 401, 850])
@pytest.mark.parametrize("average", [1, 12])
def test_a_saved_bank_continues_bit_for_bit(tmp_path: Path, at: int, average: int) -> None:
    monitor = make(average=average)
    u, y = with_gaps(*recording(sampled_plant(0), faults={"y2 sensor": 1.0}))
    whole = run(monitor, u, y)
    monitor.reset()
    first = monitor.update(u[:at], y[:at])
    monitor.save(tmp_path / "bank.json")
    loaded = rs.Monitor.load(tmp_path / "bank.json")
    same([first, loaded.update(u[at:], y[at:])], whole)
    assert str(run(loaded, u, y)) == str(whole)


def test_a_fleet_gives_what_each_plant_alone_gives() -> None:
    monitor, plant = make(average=6), sampled_plant(0)
    data = [
        recording(plant, faults={"y1 sensor": 2.0}, seed=3),
        with_gaps(*recording(plant, faults={"y3 sensor": 2.0}, seed=4)),
        recording(plant, seed=5),
    ]
    alone = [run(monitor, u, y) for u, y in data]
    together = monitor.run(np.stack([u for u, _ in data]), np.stack([y for _, y in data]))
    assert isinstance(together, list)
    for one, many in zip(alone, together, strict=True):
        for name in FIELDS.values():
            a, b = attrgetter(name)(one), attrgetter(name)(many)
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
        assert one.alarms == many.alarms


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["isolate"].pop("kind"), "isolate.kind"),
        (lambda c: c["isolate"].update(kind="guess"), "isolate.kind: expected one of"),
        (lambda c: c["isolate"].update(kind="direction"), "isolate"),
        (lambda c: c["isolate"].update(share=0.0), "share"),
        (lambda c: c["fitted"]["thresholds"].update(shape=[1], float=[1.0]), "4 members"),
        (lambda c: c["fitted"]["thresholds"]["float"].__setitem__(0, -1.0), "positive"),
        (lambda c: c["fitted"]["sizes"].update(int=[1, 5, 3, 3]), "sizes"),
        (lambda c: c["running"].update(isolation=None), "running.isolation"),
        (lambda c: c["running"]["isolation"]["groups"][0].pop(), "each once"),
        (lambda c: c["running"]["isolation"]["groups"].pop(), "settled"),
        (lambda c: c["running"]["isolation"]["settled"].__setitem__(0, ["somebody"]), "settled"),
        (lambda c: c["running"]["isolation"].update(members=["a"]), "4 members"),
        (lambda c: c["state"]["test"]["runs"]["alarm"].update(shape=[1], bool=[False]), "state.test.runs.alarm"),
        (lambda c: c["state"]["isolation"]["since"]["int"].__setitem__(0, 10**6), "since must lie between"),
        (
            lambda c: c["state"]["isolation"]["window"]["values"].update(shape=[1, 50, 1], float=[0.0] * 50),
            "state.isolation.window.values",
        ),
        (lambda c: c["design"].update(codes=None), "none: use a bank"),
    ],
)
def test_a_damaged_bank_is_refused(tmp_path: Path, change: object, words: str) -> None:
    monitor = make()
    monitor.update(*recording(sampled_plant(0), 10))
    monitor.save(tmp_path / "bank.json")
    content = json.loads((tmp_path / "bank.json").read_text())
    change(content)  # pyright: ignore[reportCallIssue]
    (tmp_path / "bank.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=words):
        rs.Monitor.load(tmp_path / "bank.json")


# ------------------------------------------------------------------ what it accepts


def test_what_holds_a_generator_is_run_by_it() -> None:
    generator = hand_made_bank(sampled_plant(0))
    monitor = rs.Monitor(SimpleNamespace(generator=generator))
    assert monitor.design is generator
    assert isinstance(monitor.isolate, Structured)
    for wrong in (SimpleNamespace(generator=3), object(), None, rs.design.ResidualGenerator):
        with pytest.raises(ModelError, match="a monitor runs a residual generator"):
            rs.Monitor(wrong)


def test_the_banks_of_the_package_run_as_they_are() -> None:
    plant = sampled_plant(1)
    bank = rs.design.sensor_fault_bank(plant)
    monitor = rs.Monitor(bank, test=NormThreshold(window=10)).fit(*recording(plant, 3000, seed=99))
    for fault in plant.faults:
        found = run(monitor, *recording(plant, faults={fault: 2.0}))
        assert found.candidates[0].faults == (fault,)


def test_only_a_bank_is_read_by_code() -> None:
    plain = rs.design.kalman_filter(sampled_plant(0))
    with pytest.raises(SettingError, match="Structured reads the code of a bank"):
        rs.Monitor(plain, isolate=Structured())
    for wrong in ("code", 3):
        with pytest.raises(SettingError, match="isolate must be"):
            rs.Monitor(plain, isolate=wrong)  # pyright: ignore[reportArgumentType]
    bank = hand_made_bank(sampled_plant(0))
    with pytest.raises(ModelError, match="a row per member"):
        rs.Monitor(replace(bank, codes=np.ones((2, 2), dtype=bool)))


def test_a_bank_can_be_tested_as_a_whole() -> None:
    plant = sampled_plant(0)
    bank = hand_made_bank(plant)
    for isolate in (Directional(), None):
        monitor = rs.Monitor(bank, isolate=isolate).fit(*recording(plant, 3000, seed=99))
        found = run(monitor, *recording(plant, faults={"y1 sensor": 2.0}))
        assert found.fault_detected
        assert found.members == ()
        assert found.parts.fired.shape == (1500, 0)
        assert found.main_alarm is not None
        assert found.main_alarm.reading is None


# ----------------------------------------------------------------- columns and files


def test_columns_and_alarm_files_tell_what_fired(tmp_path: Path) -> None:
    monitor = make(average=10)
    found = run(monitor, *recording(sampled_plant(0), faults={"y2 sensor": 2.0}))
    columns = found.columns()
    for m, member in enumerate(found.members):
        assert np.array_equal(columns[f"fired {member}"], found.parts.fired[:, m])
        assert np.array_equal(columns[f"statistic {member}"], found.parts.statistics[:, m], equal_nan=True)
    found.write_alarms(tmp_path / "alarms.jsonl")
    line = json.loads((tmp_path / "alarms.jsonl").read_text().splitlines()[-1])
    assert line["code"]["answer"] == "exact"
    assert line["code"]["faults"] == ["y2 sensor"]
    assert line["code"]["fired"] == ["without y1", "without y3", "without y4"]
    assert "sizes" not in line
    text = str(found)
    assert "fired: without y1, without y3, without y4; code of 'y2 sensor' (exact)" in text
    assert "score 1.000" in text


def test_a_fault_without_a_code_is_said() -> None:
    bank = hand_made_bank(sampled_plant(0))
    assert bank.codes is not None
    silent = replace(bank, codes=bank.codes & (np.arange(4) != 3))
    monitor = rs.Monitor(silent, test=NormThreshold(window=10))
    found = run(monitor, *recording(sampled_plant(0), faults={"y2 sensor": 2.0}))
    assert found.naming.unjudged == ("y4 sensor",)
    assert "it lacks a code: y4 sensor" in str(found)


def test_an_empty_recording_is_no_accident() -> None:
    found = run(make(), np.zeros((0, 2)), np.zeros((0, 4)))
    assert not found.fault_detected
    assert "no decision: the recording is empty" in str(found)


def test_running_does_not_touch_the_state_it_was_given() -> None:
    monitor = make(average=6)
    u, y = recording(sampled_plant(0), 200)
    monitor.update(u, y)
    state = monitor._state
    assert state is not None
    before = values_out(state)
    run_block(monitor._specification(), state, np.concatenate([u, y], axis=1)[None])
    assert values_out(state) == before
