"""One monitor for each operating mode, on generated plants that are switched: who judges when, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from residua.errors import AccuracyError, DataError, DesignError, FileFormatError, ModelError, SettingError
from residua.identify.regimes import UNKNOWN_AGE, ages, mode_signals

NAMES = ["fan", "heating", "air", "load", "supply", "room"]
#: Standard deviation of the noise of each output.
NOISE = 0.1


def switched(seed: int, modes: NDArray[np.float64], *, decay: float = 0.0) -> NDArray[np.float64]:
    """Return a recording of a static plant whose gains are those of its mode, (fan, heating).

    With ``decay`` what the last mode left goes away by that factor from row to row.
    """
    rng = np.random.default_rng(seed)
    fan, heating = modes.T
    air, load = rng.standard_normal((2, len(modes)))
    supply = (1 + fan) * air + (5 + 2 * load) * heating
    room = air + (2 - fan) * load - 3 * heating
    left = np.zeros(len(modes))
    for k in range(1, len(modes)):
        left[k] = decay * (left[k - 1] + 8 * (not np.array_equal(modes[k], modes[k - 1])))
    noise = NOISE * rng.standard_normal((2, len(modes)))
    return np.column_stack([fan, heating, air, load, supply + left + noise[0], room + noise[1]])


def visits(*stays: tuple[float, float, int]) -> NDArray[np.float64]:
    return np.repeat([[fan, heating] for fan, heating, _ in stays], [rows for *_, rows in stays], axis=0)


NORMAL = visits((0, 0, 900), (1, 0, 800), (1, 1, 900), (0, 0, 700), (1, 1, 800), (1, 0, 900))
MODES = ("fan = 0, heating = 0", "fan = 1, heating = 0", "fan = 1, heating = 1")


def made_of(seed: int, **options: object) -> rs.identify.Regimes:
    return rs.identify.regimes(switched(seed, NORMAL), outputs=NAMES, by=["fan", "heating"], **options)  # pyright: ignore


@pytest.fixture(scope="module")
def monitor() -> rs.RegimeMonitor:
    return rs.RegimeMonitor(made_of(0)).fit(None, switched(1, NORMAL), false_alarm_rate=0.01)


def test_every_mode_has_the_false_alarm_rate_that_was_asked_for(monitor: rs.RegimeMonitor) -> None:
    """Over fresh fault-free recordings; the gains differ between the modes by many times the noise."""
    runs = [monitor.run(None, switched(seed, NORMAL)) for seed in range(10, 20)]
    for name in MODES:
        decided = sum(int(one.judged[name].decided.sum()) for one in runs)
        alarm = sum(int((one.judged[name].alarm & one.judged[name].decided).sum()) for one in runs)
        assert decided > 10_000
        # the threshold itself is from some 1,500 rows: a factor of three either way
        assert 0.01 / 3 < alarm / decided < 0.03
    assert all(np.isin(one.mode, range(3)).all() for one in runs)


def test_one_model_for_all_modes_does_not_see_what_a_model_for_each_sees(monitor: rs.RegimeMonitor) -> None:
    rows = switched(30, visits((1, 0, 300), (0, 0, 300), (1, 1, 300)))
    rows[400:550, NAMES.index("supply")] += 8 * NOISE
    diagnosis = monitor.run(None, rows)
    assert diagnosis.named == (("supply sensor",),)
    assert diagnosis.main_alarm is not None
    assert diagnosis.main_alarm.mode == "fan = 0, heating = 0"
    assert diagnosis.main_alarm.alarm.onset == pytest.approx(400, abs=5)
    assert diagnosis.alarm[410:550].mean() > 0.9
    one = rs.Monitor(rs.identify.principal_components(switched(0, NORMAL)[:, 2:])).fit(None, switched(1, NORMAL)[:, 2:])
    all_modes = one.run(None, rows[:, 2:])
    assert isinstance(all_modes, rs.Diagnosis)
    assert all_modes.alarm[400:550].mean() < 0.5


def test_an_alarm_counts_in_its_own_mode(monitor: rs.RegimeMonitor) -> None:
    """It stands on while the plant is in another mode, whose own monitor says that all is well there."""
    rows = switched(39, visits((0, 0, 200), (1, 0, 400), (0, 0, 200), (1, 0, 100)))
    rows[150:200, NAMES.index("supply")] += 20 * NOISE
    rows[700:760, NAMES.index("room")] += 20 * NOISE
    rows[760:800, NAMES.index("room")] += 20 * NOISE
    diagnosis = monitor.run(None, rows)
    assert diagnosis.alarm[155:200].all()
    assert diagnosis.alarm[200:600].mean() < 0.05
    assert diagnosis.false_alarm_fraction < 0.25
    # the first alarm stands for over 400 samples, of which 50 were judged; the second has twice as many
    first, second = (max(diagnosis.alarms, key=lambda one, at=at: one.alarm.start <= at < one.alarm.stop)
                     for at in (180, 780))  # fmt: skip
    assert first.alarm.stop - first.alarm.start > second.alarm.stop - second.alarm.start
    assert diagnosis.main_alarm is not None
    assert diagnosis.main_alarm.alarm is second.alarm
    assert diagnosis.named == (("room sensor",),)
    text = str(diagnosis)
    assert "samples judged" in text
    assert "1. supply sensor" in text
    assert "1. room sensor" in text


def test_rows_of_other_modes_are_no_missing_values(monitor: rs.RegimeMonitor) -> None:
    """Nobody is told to fill them in; of values that are missing in the mode they are, by their part of it."""
    rows = switched(39, visits((0, 0, 200), (1, 0, 400), (1, 1, 200)))
    assert not any("because values are missing" in note for note in monitor.run(None, rows).notes)
    rows[200:600:10, 3] = np.nan
    notes = [note for note in monitor.run(None, rows).notes if "because values are missing" in note]
    assert len(notes) == 1
    assert notes[0].startswith("with fan = 1, heating = 0: ")
    assert "40 samples miss one (channel 'load' at 40 of them" in notes[0]


def test_nothing_is_decided_in_a_mode_never_seen(monitor: rs.RegimeMonitor) -> None:
    rows = switched(31, visits((1, 0, 200), (0, 1, 150), (1, 1, 200)))
    rows[210:340, 4] += 100.0
    diagnosis = monitor.run(None, rows)
    assert diagnosis.unjudged == {"fan = 0, heating = 1": "a mode never seen"}
    assert diagnosis.samples("fan = 0, heating = 1") == 150
    assert not diagnosis.decided[200:350].any()
    assert not diagnosis.alarm[200:350].any()
    assert np.isnan(diagnosis.statistic[200:350]).all()
    assert "not judged: fan = 0, heating = 1 (a mode never seen), 150 samples" in str(diagnosis)


def test_a_mode_is_judged_as_if_the_recording_had_no_other() -> None:
    """What happens in other modes does not reach it: the same residuals to the last bit."""
    made = made_of(0, method=partial(rs.identify.principal_components, lags=2), transient=0)
    monitor = rs.RegimeMonitor(made).fit(None, switched(1, NORMAL))
    modes = visits((1, 0, 200), (1, 1, 200), (1, 0, 200))
    rows = switched(32, modes)
    other = np.where((modes[:, 1] == 1)[:, None] & (np.arange(6) > 1), 1e6, rows)
    first, second = (monitor.run(None, one).judged["fan = 1, heating = 0"] for one in (rows, other))
    assert np.array_equal(first.statistic, second.statistic, equal_nan=True)
    assert np.array_equal(first.decided, second.decided)
    assert not first.decided[400:402].any()
    assert first.decided[403:].all()


def test_transients_are_found_and_masked() -> None:
    """What a change leaves goes down from 8 by 0.8 a row: it is below a tenth, the noise, after 20 rows."""
    short = np.tile(visits((0, 0, 150), (1, 0, 150), (1, 1, 150)), (8, 1))
    made = rs.identify.regimes(switched(0, short, decay=0.8), outputs=NAMES, by=["fan", "heating"])
    for mode in made.modes.values():
        assert 16 <= mode.transient <= 32
    monitor = rs.RegimeMonitor(made).fit(None, switched(1, short, decay=0.8))
    diagnosis = monitor.run(None, switched(2, short, decay=0.8))
    assert diagnosis.false_alarm_fraction < 0.03
    first = made.modes[MODES[1]].transient
    assert not diagnosis.decided[150 : 150 + first].any()
    assert diagnosis.decided[150 + first + 1 : 300].all()
    assert any("transients after changes of mode" in line for line in diagnosis.not_judged)
    # without it the same plant raises alarms after changes, or has thresholds that are too high
    loud = rs.RegimeMonitor(rs.identify.regimes(switched(0, short), outputs=NAMES, by=["fan", "heating"], transient=0))
    loud.fit(None, switched(1, short))
    assert loud.run(None, switched(2, short, decay=0.8)).alarm[151:160].mean() > 0.5


@pytest.mark.parametrize("seed", range(5))
def test_a_plant_without_transients_loses_few_rows_to_them(seed: int) -> None:
    assert all(one.transient <= 2 for one in made_of(seed).modes.values())


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**-7, 2.0**13, 2.0**20])
def test_answers_do_not_depend_on_units(monitor: rs.RegimeMonitor, scale: float) -> None:
    units = np.array([1, 1, scale, 1 / scale, 1, scale])
    made = rs.identify.regimes(switched(0, NORMAL) * units, outputs=NAMES, by=["fan", "heating"])
    scaled = rs.RegimeMonitor(made).fit(None, switched(1, NORMAL) * units, false_alarm_rate=0.01)
    rows = switched(30, visits((1, 0, 300), (0, 0, 300)))
    rows[400:500, 4] += 1.0
    one, other = monitor.run(None, rows), scaled.run(None, rows * units)
    assert np.array_equal(one.statistic, other.statistic, equal_nan=True)
    assert one.named == other.named


def test_a_missing_signal_of_the_modes_means_no_decision(monitor: rs.RegimeMonitor) -> None:
    rows = switched(33, visits((1, 0, 300)))
    rows[100:120, 0] = np.nan
    rows[200, 3] = np.nan
    diagnosis = monitor.run(None, rows)
    assert (diagnosis.mode[100:120] == -1).all()
    assert not diagnosis.decided[100:120].any()
    assert not diagnosis.decided[200]
    assert diagnosis.decided[201]
    assert diagnosis.decided[150:200].all()
    assert "not judged: a signal of the modes is missing, 20 samples" in diagnosis.not_judged


def test_a_mode_with_few_rows_has_no_model_and_says_so() -> None:
    rows = switched(0, np.vstack([NORMAL, visits((0, 1, 20))]))
    made = rs.identify.regimes(rows, outputs=NAMES, by=["fan", "heating"], transient=0)
    assert made.without_model["fan = 0, heating = 1"].startswith("20 rows of the 40 that it needs")
    assert "fan = 0, heating = 1: no model" in str(made)
    monitor = rs.RegimeMonitor(made).fit(None, switched(1, NORMAL))
    diagnosis = monitor.run(None, rows)
    assert diagnosis.unjudged["fan = 0, heating = 1"].startswith("no model: 20 rows")


@pytest.mark.parametrize("error", [DataError, DesignError, AccuracyError, ModelError])
def test_a_mode_for_which_the_method_fails_has_no_model_and_says_so(error: type[Exception]) -> None:
    """Numbers of one mode are no reason to refuse the others."""

    def method(rows: list[tuple[NDArray[np.float64], NDArray[np.float64]]], **options: object) -> object:
        if sum(len(y) for _, y in rows) < 1650:  # the mode with neither fan nor heating has 1,600, the others 1,700
            raise error("not this one")
        return rs.identify.principal_components(rows, **options)  # pyright: ignore

    made = made_of(0, transient=0, method=method)
    assert list(made.modes) == [MODES[1], MODES[2]]
    assert made.without_model == {MODES[0]: "1600 rows: not this one"}


def test_a_mode_that_cannot_be_fitted_is_not_judged() -> None:
    monitor = rs.RegimeMonitor(made_of(0)).fit(None, switched(1, visits((0, 0, 900), (1, 0, 900))))
    assert set(monitor.unfitted) == {"fan = 1, heating = 1"}
    assert "fan = 1, heating = 1" in monitor.run(None, switched(2, NORMAL)).unjudged


def test_a_recording_of_no_row_has_no_decision(monitor: rs.RegimeMonitor) -> None:
    diagnosis = monitor.run(None, switched(0, NORMAL)[:0])
    assert len(diagnosis.time) == 0
    assert not diagnosis.decided.any()
    assert "no decision" in str(diagnosis)


def test_a_recording_of_one_row_has_a_decision_where_nothing_settles(monitor: rs.RegimeMonitor) -> None:
    diagnosis = monitor.run(None, switched(0, NORMAL)[:1])
    assert diagnosis.decided.tolist() == [True]


def test_edges_divide_a_quantity() -> None:
    rng = np.random.default_rng(0)
    speed = np.repeat([0.0, 0.4, 0.0, 0.8], 300) + 0.01 * rng.random(1200)
    flow = np.where(speed < 0.2, 0.0, 10 * speed) + 0.1 * rng.standard_normal(1200)
    rows = np.column_stack([speed, flow, flow + 0.1 * rng.standard_normal(1200)])
    made = rs.identify.regimes(rows, outputs=["speed", "flow", "flow 2"], by={"speed": [0.2, 0.6]}, transient=0)
    assert list(made.modes) == ["speed < 0.2", "0.2 <= speed < 0.6", "speed >= 0.6"]
    assert [one.samples for one in made.modes.values()] == [600, 300, 300]
    with pytest.raises(SettingError, match=r"1200 different values .* by=\{'speed': \["):
        rs.identify.regimes(rows, outputs=["speed", "flow", "flow 2"], by=["speed"])


@pytest.mark.parametrize("method", [rs.identify.subspace, rs.identify.arx])
def test_inputs_and_models_by_mode(method: Callable[..., object]) -> None:
    """A Kalman filter of each mode, identified: named actuator and sensor, the inputs where they were."""

    def recorded(seed: int, on: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        rng = np.random.default_rng(seed)
        u, x = rng.standard_normal(len(on)), 0.0
        y = np.zeros((len(on), 2))
        for k in range(len(on)):
            y[k] = [x, 2 * x] + 0.1 * rng.standard_normal(2)
            x = (0.9 if on[k] else 0.5) * x + u[k]
        return np.column_stack([u, on]), y

    on = np.tile(np.repeat([0.0, 1.0], 500), 4)
    names = {"inputs": ["valve", "pump"], "outputs": ["level", "flow"]}
    made = rs.identify.regimes(*recorded(0, on), by=["pump"], method=method, **names)  # pyright: ignore
    assert [one.design.plant.inputs for one in made.modes.values()] == [("valve",), ("valve",)]
    monitor = rs.RegimeMonitor(made).fit(*recorded(1, on))
    u, y = recorded(2, on[:1000])
    assert monitor.run(u, y).false_alarm_fraction < 0.03
    y[600:, 1] += 3.0
    assert monitor.run(u, y).named == (("flow sensor",),)


def test_recordings_are_matched_by_name(monitor: rs.RegimeMonitor, tmp_path: Path) -> None:
    rows = switched(34, visits((1, 0, 200), (1, 1, 200)))
    order = [3, 5, 0, 1, 4, 2]
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack([np.arange(400), rows[:, order]]),
        delimiter=",",
        comments="",
        fmt="%.17g",
        header=",".join(["time", *(NAMES[i] for i in order)]),
    )
    expected = monitor.run(None, rows)
    for given in (tmp_path / "log.csv", rs.read_recording(tmp_path / "log.csv")):
        assert np.array_equal(monitor.run(given).statistic, expected.statistic, equal_nan=True)


def test_a_saved_monitor_says_the_same(monitor: rs.RegimeMonitor, tmp_path: Path) -> None:
    monitor.save(tmp_path / "modes.json")
    loaded = rs.RegimeMonitor.load(tmp_path / "modes.json")
    rows = switched(35, visits((1, 0, 200), (0, 1, 50), (1, 1, 200)))
    rows[300:, 4] += 2.0
    one, other = monitor.run(None, rows), loaded.run(None, rows)
    assert np.array_equal(one.statistic, other.statistic, equal_nan=True)
    assert str(one) == str(other)
    text = (tmp_path / "modes.json").read_text()
    (tmp_path / "broken.json").write_text(text.replace('"transient": 0', '"transient": 9', 1))
    with pytest.raises(FileFormatError, match="checksum"):
        rs.RegimeMonitor.load(tmp_path / "broken.json")
    with pytest.raises(FileFormatError, match=r"RegimeMonitor\.load"):
        rs.Monitor.load(tmp_path / "modes.json")


def test_a_file_that_was_edited_says_so(monitor: rs.RegimeMonitor, tmp_path: Path) -> None:
    monitor.save(tmp_path / "modes.json")
    content = json.loads((tmp_path / "modes.json").read_text())
    content["modes"]["fan = 1, heating = 0"]["transient"] = 30
    content["checksum"] = None
    (tmp_path / "modes.json").write_text(json.dumps(content))
    loaded = rs.RegimeMonitor.load(tmp_path / "modes.json")
    diagnosis = loaded.run(None, switched(36, visits((0, 0, 100), (1, 0, 100))))
    assert not diagnosis.decided[100:130].any()
    assert any("was edited" in note for note in diagnosis.notes)
    regimes = content["regimes"]
    for change in (
        {"regimes": {**regimes, "signals": {"names": ["fog"], "edges": [None]}}},
        {"regimes": {**regimes, "dt": -1}},
        {"regimes": {**regimes, "outputs": ["fan", "heating"]}},
        {"modes": 3},
        {"modes": {"another mode": content["modes"]["fan = 1, heating = 0"]}},
        {"version": 9},
    ):
        (tmp_path / "broken.json").write_text(json.dumps({**content, **change}))
        with pytest.raises(FileFormatError, match=r"broken\.json"):
            rs.RegimeMonitor.load(tmp_path / "broken.json")


def test_a_page_on_one_mode(monitor: rs.RegimeMonitor, tmp_path: Path) -> None:
    rows = switched(37, visits((1, 0, 200), (1, 1, 200)))
    rows[300:, 4] += 2.0
    diagnosis = monitor.run(None, rows, source="tuesday")
    page = diagnosis.judged["fan = 1, heating = 1"].to_html(tmp_path / "page.html")
    assert "supply sensor" in page.read_text()


def test_what_is_refused(monitor: rs.RegimeMonitor) -> None:
    rows = switched(0, NORMAL)
    with pytest.raises(DataError, match="no channel cooling"):
        rs.identify.regimes(rows, outputs=NAMES, by=["cooling"])
    with pytest.raises(DataError, match="no row is complete"):
        rs.identify.regimes(np.where(np.arange(6) == 0, np.nan, rows), outputs=NAMES, by=["fan"])
    with pytest.raises(DataError, match="no operating mode has a model"):
        rs.identify.regimes(rows[:20], outputs=NAMES, by=["fan"])
    for by in ([], ["fan", "fan"], 3, {"fan": [1, 0]}, {"fan": ["a"]}, {"fan": [np.nan]}):
        with pytest.raises(SettingError, match="by"):
            rs.identify.regimes(rows, outputs=NAMES, by=by)
    with pytest.raises(SettingError, match="transient"):
        made_of(0, transient=-1)
    with pytest.raises(SettingError, match="method"):
        made_of(0, method="pca")
    with pytest.raises(ModelError, match="RegimeMonitor"):
        rs.Monitor(made_of(0))
    with pytest.raises(ModelError, match="regimes"):
        rs.RegimeMonitor(rs.identify.principal_components(rows[:, 2:]))  # pyright: ignore
    with pytest.raises(DataError, match="shape"):
        monitor.run(None, rows[:, 1:])
    with pytest.raises(DataError, match="one plant"):
        monitor.run(None, np.zeros((2, 10, 6)))
    with pytest.raises(DataError, match="no mode can be fitted"):
        rs.RegimeMonitor(made_of(0)).fit(None, rows[:3])


def test_ages_count_from_the_last_change() -> None:
    keys = np.array([[0.0], [0], [1], [1], [np.nan], [np.nan], [1], [1]])
    assert ages(keys).tolist() == [UNKNOWN_AGE, UNKNOWN_AGE, 0, 1, 0, 1, 0, 1]


def test_signals_divide_at_their_edges() -> None:
    signals = mode_signals({"a": None, "b": [0.5, 1]})
    keys = signals.keys(np.array([[1, 0.5], [-0.0, 0.2], [2, 1.0], [np.nan, 0.1], [1, np.inf]]))
    assert np.array_equal(keys, [[1, 1], [0, 0], [2, 2], [np.nan, np.nan], [np.nan, np.nan]], equal_nan=True)
    assert signals.label((2.0, 1.0)) == "a = 2, 0.5 <= b < 1"


def test_a_fault_is_learnt_in_every_mode_that_shows_it() -> None:
    """A fault of load and room at once, which no model knows, in two of three modes; times do not start at zero."""
    watch = rs.RegimeMonitor(made_of(0)).fit(None, switched(1, NORMAL), false_alarm_rate=0.001)

    def faulty(seed: int, *stays: tuple[float, float, int]) -> NDArray[np.float64]:
        rows = switched(seed, visits(*stays))
        rows[100:, [NAMES.index("load"), NAMES.index("room")]] += [2.0, -1.0]
        return rows

    shown = faulty(2, (0, 0, 300), (1, 0, 300))
    why_not = watch.learn_fault("bypass", None, shown, interval=(1100.0, 1600.0), time=1000.0 + np.arange(600))
    assert why_not == {"fan = 1, heating = 1": "no recording shows it in this mode"}
    for seed, mode in ((3, (0, 0, 300)), (4, (1, 0, 300))):
        assert watch.run(None, faulty(seed, mode)).named == (("bypass",),)
    assert watch.run(None, faulty(5, (1, 1, 300))).named != (("bypass",),)
    with pytest.raises(DataError, match=r"no mode learns 'bypass': .*no recording shows it in this mode"):
        watch.learn_fault("bypass", None, shown[:100], interval=(200.0, 300.0))
