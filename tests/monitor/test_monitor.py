"""A monitor: step equals run, any cutting, restarts, gaps, fleets, saving; and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import residua as rs
from residua.errors import DataError, FileFormatError, ModelError, NotFittedError
from residua.monitor.running import Decisions


def noisy_plant() -> rs.Plant:
    return (
        rs.library.gertler()
        .with_sensor_faults()
        .with_noise(process=0.01, measurement=0.02)
        .with_operating_point(inputs=[3.0], outputs=[1.0, 2.0])
    )


def recording(
    samples: int = 1200, *, fault: str | None = "p2", size: float = 0.5, start: int = 700, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    plant = noisy_plant()
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((samples, 1))
    f = np.zeros((samples, 4))
    if fault:
        f[start:, plant.faults.index(fault)] = size
    w = rng.standard_normal((samples, len(plant.noises)))
    y = plant.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))
    return u + 3.0, y + [1.0, 2.0]


def with_gaps(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    u, y = u.copy(), y.copy()
    y[:4] = np.nan
    y[100:103, 0] = np.nan
    y[400:430] = np.inf
    u[500] = np.nan
    return u, y


def make(kind: str = "kalman_filter", window: int = 37, average: int = 1) -> rs.Monitor:
    generator = getattr(rs.design, kind)(noisy_plant())
    test = rs.decide.NormThreshold(window=average)
    monitor = rs.Monitor(generator, test=test, isolate=rs.decide.Directional(window=window))
    return monitor.fit(*recording(1400, fault=None, seed=1), false_alarm_rate=0.01)


def same(found: list[Decisions], diagnosis: rs.Diagnosis) -> None:
    for name, reference in (
        ("residuals", diagnosis.residuals),
        ("statistic", diagnosis.statistic),
        ("alarm", diagnosis.alarm),
        ("usable", diagnosis.decided),
        ("scores", diagnosis.scores),
    ):
        joined = np.concatenate([getattr(part, name)[0] for part in found])
        assert np.array_equal(joined, reference, equal_nan=joined.dtype.kind == "f"), name


@pytest.mark.parametrize("kind", ["kalman_filter", "detection_filter"])
@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("average", [1, 25])
def test_any_cutting_gives_the_same_bits(kind: str, gaps: bool, average: int) -> None:
    monitor = make(kind, average=average)
    u, y = with_gaps(*recording()) if gaps else recording()
    diagnosis = monitor.run(u, y)
    assert isinstance(diagnosis, rs.Diagnosis)
    rng = np.random.default_rng(0)
    for _ in range(4):
        monitor.reset()
        cuts = np.sort(rng.integers(0, len(u) + 1, 20))
        same(
            [monitor.update(a, b) for a, b in zip(np.split(u, cuts), np.split(y, cuts), strict=True)],
            diagnosis,
        )


@pytest.mark.parametrize("gaps", [False, True])
def test_step_equals_run_to_the_last_bit(gaps: bool) -> None:
    monitor = make()
    u, y = with_gaps(*recording()) if gaps else recording()
    diagnosis = monitor.run(u, y)
    assert isinstance(diagnosis, rs.Diagnosis)
    monitor.reset()
    for k in range(len(u)):
        decision = monitor.step(u[k], y[k])
        assert np.array_equal(decision.residual, diagnosis.residuals[k], equal_nan=True)
        assert decision.alarm == diagnosis.alarm[k]
        assert decision.decided == diagnosis.decided[k]
        if decision.alarm and decision.candidates:
            assert decision.candidates[0].score == np.nanmax(diagnosis.scores[k])


@pytest.mark.parametrize("at", [0, 1, 401, 415, 900])
@pytest.mark.parametrize("average", [1, 25])
def test_a_saved_monitor_continues_bit_for_bit(tmp_path: Path, at: int, average: int) -> None:
    monitor = make(average=average)
    u, y = with_gaps(*recording())
    diagnosis = monitor.run(u, y)
    assert isinstance(diagnosis, rs.Diagnosis)
    monitor.reset()
    first = monitor.update(u[:at], y[:at])
    monitor.save(tmp_path / "monitor.json")
    second = rs.Monitor.load(tmp_path / "monitor.json").update(u[at:], y[at:])
    same([first, second], diagnosis)


def test_a_fleet_gives_what_each_plant_alone_gives() -> None:
    monitor = make()
    data = [recording(seed=3), with_gaps(*recording(seed=4)), recording(fault=None, seed=5)]
    alone = [monitor.run(u, y) for u, y in data]
    together = monitor.run(np.stack([u for u, _ in data]), np.stack([y for _, y in data]))
    assert isinstance(together, list)
    for one, many in zip(alone, together, strict=True):
        assert isinstance(one, rs.Diagnosis)
        assert np.array_equal(one.statistic, many.statistic, equal_nan=True)
        assert np.array_equal(one.scores, many.scores, equal_nan=True)
        assert one.alarms == many.alarms
        assert one.recording.resets == many.recording.resets


def test_it_finds_and_names_the_fault() -> None:
    monitor = make()
    diagnosis = monitor.run(*recording())
    assert isinstance(diagnosis, rs.Diagnosis)
    assert diagnosis.onset == pytest.approx(701, abs=3)
    assert diagnosis.candidates[0].faults == ("p2",)
    assert diagnosis.candidates[0].score > 0.99
    assert "p2" in str(diagnosis)
    clean = monitor.run(*recording(5000, fault=None, seed=9))
    assert isinstance(clean, rs.Diagnosis)
    assert clean.false_alarm_fraction < 0.02


def test_a_fault_is_not_hidden_behind_false_alarms() -> None:
    diagnosis = make().run(*recording(14_000, start=13_000))
    assert isinstance(diagnosis, rs.Diagnosis)
    assert len(diagnosis.alarms) > 25
    main = diagnosis.alarms[-1]
    assert main is diagnosis.main_alarm
    text = str(diagnosis)
    assert f"alarm {len(diagnosis.alarms)}: raised {diagnosis.clock.at(main.raised)}, to the end" in text
    assert text.count("\nalarm ") == 20
    lengths = sorted(alarm.samples for alarm in diagnosis.alarms)
    more = len(lengths) - 20
    assert f"... and {more} more alarms, none longer than {lengths[more - 1]} sample" in text


def test_a_window_sees_a_smaller_fault() -> None:
    u, y = recording(size=0.06, seed=11)
    short, long = make().run(u, y), make(average=50).run(u, y)
    assert isinstance(short, rs.Diagnosis)
    assert isinstance(long, rs.Diagnosis)
    assert short.alarm[750:].mean() < 0.2
    assert long.alarm[750:].mean() > 0.95
    assert long.candidates[0].faults == ("p2",)


def test_missing_values_are_bridged_counted_and_shown() -> None:
    monitor = make()
    clean = monitor.run(*recording(fault=None, seed=6))
    u, y = with_gaps(*recording(fault=None, seed=6))
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert isinstance(clean, rs.Diagnosis)
    assert found.n_missing == 4 + 3 + 30 + 1
    assert found.recording.resets == 1
    assert "38 samples with missing values" in str(found)
    assert np.isnan(found.residuals[found.missing]).all()
    assert not found.decided[found.missing].any()
    assert np.isfinite(found.residuals[~found.missing]).all()
    np.testing.assert_allclose(found.residuals[-300:], clean.residuals[-300:], atol=1e-9)


def test_without_data_the_noise_model_gives_the_threshold() -> None:
    monitor = rs.Monitor(
        rs.design.kalman_filter(noisy_plant()), test=rs.decide.NormThreshold(persistence=1, false_alarm_rate=1e-3)
    )
    diagnosis = monitor.run(*recording(20_000, fault=None, seed=2))
    assert isinstance(diagnosis, rs.Diagnosis)
    assert diagnosis.false_alarm_fraction == pytest.approx(1e-3, abs=7e-4)


def test_without_noise_and_data_it_says_what_it_needs() -> None:
    with pytest.raises(NotFittedError, match="fault-free data"):
        rs.Monitor(rs.design.detection_filter(rs.library.gertler())).run(*recording())


def test_a_continuous_generator_is_sampled_at_the_step_of_the_recording() -> None:
    plant = rs.Plant([[-1.0, 0.2], [0, -2]], [[1], [1]], np.eye(2)).with_sensor_faults()
    monitor = rs.Monitor(rs.design.detection_filter(plant, poles=[-3, -3]))
    sampled = plant.discretize(0.01)
    u = np.sin(0.01 * np.arange(3000))[:, None]
    y = sampled.system(("control",)).simulate(u)
    with pytest.raises(ModelError, match="dt="):
        monitor.fit(u, y)
    monitor.fit(u, y, time=0.01 * np.arange(3000))
    assert monitor.generator.dt == pytest.approx(0.01)
    cost = monitor.generator.evidence.decoupling["control, sampled"]
    assert 0 < cost < 1e-4, "what sampling costs is stated"
    faulty = y.copy()
    faulty[1500:, 0] += 0.5
    diagnosis = monitor.run(u, faulty)
    assert isinstance(diagnosis, rs.Diagnosis)
    assert diagnosis.onset == pytest.approx(15.0, abs=0.05)
    with pytest.raises(DataError, match=r"0\.02"):
        monitor.run(u, y, dt=0.02)


def test_sampling_cost_falls_with_the_square_of_the_step() -> None:
    plant = rs.Plant([[-1.0, 0.2], [0, -2]], [[1], [1]], np.eye(2)).with_sensor_faults()
    flt = rs.design.detection_filter(plant, poles=[-3, -3])
    w = np.array([0.5, 1.0])
    cost = []
    for dt in (0.04, 0.02, 0.01):
        sampled = flt.discretize(dt)
        form = sampled.internal_form(plant.discretize(dt), controls=True)
        cost.append(np.abs(form.frequency_response(w)[:, :, -1]).max())
    assert cost[1] / cost[0] < 0.6
    assert cost[2] / cost[1] < 0.6


@pytest.mark.parametrize(
    ("u", "y", "words"),
    [
        (np.zeros((10, 1)), np.zeros((10, 3)), "y must be"),
        (np.zeros((9, 1)), np.zeros((10, 2)), "u must be"),
        (None, np.zeros((10, 2)), "u is missing"),
        (np.zeros((10, 2)), np.zeros((10, 2)), "u must be"),
    ],
)
def test_wrong_shapes_are_refused(u: np.ndarray | None, y: np.ndarray, words: str) -> None:
    with pytest.raises(DataError, match=words):
        make().run(u, y)


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (np.r_[np.arange(9.0), 12.0], "irregular"),
        (np.zeros(10), "repeats"),
        (np.full(10, np.nan), "finite"),
    ],
)
def test_irregular_time_is_refused(time: np.ndarray, words: str) -> None:
    with pytest.raises(DataError, match=words):
        make().run(np.zeros((10, 1)), np.zeros((10, 2)), time=time)


@pytest.mark.parametrize("backend", ["pandas", "polars"])
def test_data_frames_are_matched_by_name(backend: str) -> None:
    module = pytest.importorskip(backend)
    monitor = make()
    u, y = recording()
    frame = module.DataFrame({"y2": y[:, 1], "time": np.arange(1200.0), "u1": u[:, 0], "y1": y[:, 0]})
    found, expected = monitor.run(frame), monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert isinstance(expected, rs.Diagnosis)
    assert np.array_equal(found.statistic, expected.statistic, equal_nan=True)
    with pytest.raises(DataError, match="y1"):
        monitor.run(frame[["y2", "time", "u1"]])
    with pytest.raises(DataError, match="arrays, or one data frame"):
        monitor.run(u)


def test_an_empty_recording_is_no_accident() -> None:
    diagnosis = make().run(np.zeros((0, 1)), np.zeros((0, 2)))
    assert isinstance(diagnosis, rs.Diagnosis)
    assert not diagnosis.fault_detected
    assert "no decision: the recording is empty" in str(diagnosis)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c.update(version=99), r"version 99, this residua reads version \d+: upgrade residua"),
        (lambda c: c.update(format="other"), "not a monitor"),
        (lambda c: c.pop("design"), "'design' is missing"),
        (lambda c: c["design"]["system"]["A"].update(shape=[5, 5]), "numbers"),
        (lambda c: c["fitted"]["center"].update(shape=[1], float=[0.0]), "center"),
        (lambda c: c["test"].update(persistence=-1), "persistence"),
        (lambda c: c["test"].update(colour="red"), "colour"),
    ],
)
def test_a_damaged_file_is_refused_with_the_reason(tmp_path: Path, change: object, words: str) -> None:
    path = tmp_path / "monitor.json"
    make().save(path)
    content = json.loads(path.read_text())
    change(content)  # pyright: ignore[reportCallIssue]
    path.write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=words):
        rs.Monitor.load(path)


def test_files_that_are_no_json_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="monitor not found"):
        rs.Monitor.load(tmp_path / "nothing.json")
    (tmp_path / "text.json").write_text("hello")
    with pytest.raises(FileFormatError, match="not JSON"):
        rs.Monitor.load(tmp_path / "text.json")
    with pytest.raises(FileFormatError, match="does not exist"):
        make().save(tmp_path / "no" / "folder.json")


def test_it_takes_a_generator_only() -> None:
    observer = rs.design.unknown_input_observer(rs.library.twardy())
    with pytest.raises(ModelError, match="residual_generator"):
        rs.Monitor(observer)  # pyright: ignore[reportArgumentType]


def test_frames_and_alarm_files(tmp_path: Path) -> None:
    diagnosis = make().run(*recording())
    assert isinstance(diagnosis, rs.Diagnosis)
    for backend in ("pandas", "polars"):
        pytest.importorskip(backend)
        frame = diagnosis.to_frame(backend)
        assert list(frame.columns)[:2] == ["time", "r y1"]
        assert len(frame) == 1200
    diagnosis.write_alarms(tmp_path / "alarms.jsonl")
    lines = (tmp_path / "alarms.jsonl").read_text().splitlines()
    assert len(lines) == len(diagnosis.alarms)
    assert json.loads(lines[-1])["candidates"][0]["faults"] == ["p2"]


def test_two_frames_are_matched_by_name_too() -> None:
    pandas = pytest.importorskip("pandas")
    monitor = make()
    u, y = recording()
    swapped = pandas.DataFrame({"y2": y[:, 1], "y1": y[:, 0]})
    found, expected = monitor.run(u, swapped), monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert isinstance(expected, rs.Diagnosis)
    assert np.array_equal(found.statistic, expected.statistic, equal_nan=True)
    with pytest.raises(DataError, match="missing column 'y1'"):
        monitor.run(u, swapped[["y2"]])


def test_dates_are_times() -> None:
    monitor = make()
    u, y = recording()
    start = np.datetime64("2026-01-01T00:00:00")
    assert isinstance(monitor.run(u, y, time=start + np.arange(1200) * np.timedelta64(1, "s")), rs.Diagnosis)
    with pytest.raises(DataError, match=r"0\.001"):
        monitor.run(u, y, time=start + np.arange(1200) * np.timedelta64(1, "ms"))
    with pytest.raises(DataError, match="dt must be"):
        monitor.run(u, y, dt=float("nan"))


def test_heavy_leakage_by_sampling_is_said() -> None:
    plant = rs.Plant([[-1.0, 5.0], [-5.0, -1.0]], [[1], [1]], np.eye(2)).with_sensor_faults()
    monitor = rs.Monitor(rs.design.detection_filter(plant, poles=[-30, -30]), dt=0.3)
    rng = np.random.default_rng(0)
    u = rng.standard_normal((600, 1))
    y = plant.discretize(0.3).system("control").simulate(u)
    found = monitor.fit(u, y).run(u, y)
    assert isinstance(found, rs.Diagnosis)
    assert any("sampling at 0.3 s" in note for note in found.notes)
