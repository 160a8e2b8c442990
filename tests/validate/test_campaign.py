"""Campaigns: what is known in advance, what a plain simulation says, and the same numbers however they are run."""

from __future__ import annotations

import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import page_reader
import residua as rs
from campaign_examples import white_noise_monitor
from residua import validate as v
from residua.errors import DataError, FileFormatError, MissingExtraError, ModelError, NotFittedError, SettingError
from residua.plant import Perturbation, UncertainPlant
from residua.records import values_out
from residua.validate import runs as runs_module

SMALL = {"runs": 12, "samples": 300, "seed": 5}


def same(one: v.RunFigures, two: v.RunFigures) -> bool:
    """Whether figures are the same to the last bit."""
    pairs = [(getattr(one, f.name), getattr(two, f.name)) for f in fields(one)]
    return all(a.tobytes() == b.tobytes() and a.shape == b.shape for a, b in pairs)


def of_all_kinds() -> list[v.Scenario]:
    return [
        v.Scenario("a sensor", v.step(at=50), size=[0.3, 1.0]),
        v.Scenario("leak", v.ramp(slope=0.05, at=(30, 60)), size=0.2),
        v.Scenario("leak", v.drift(slope=0.01, at=50), size=0.5),
        v.Scenario("valve actuator", v.intermittent(on=5, off=10, at=40), size=0.4),
        v.Scenario("b sensor", v.oscillation(period=20, at=40), size=0.4),
        v.Scenario("b sensor", v.noise_growth(at=40), size=0.3),
        v.Scenario("b sensor", v.stuck_at(at=60)),
        v.Scenario("valve actuator", v.stuck_at(at=60, value=0.5)),
        v.Scenario("valve actuator", v.loss_of_effectiveness(at=(40, 60)), size=0.5),
    ]


# ------------------------------------------------------------------ known in advance


def test_the_false_alarm_rate_of_white_residuals_is_the_designed_one(white_monitor: rs.Monitor) -> None:
    made = v.campaign(white_monitor, runs=300, samples=1000, seed=1, confidence=0.99)
    assert 0.01 in made.false_alarm_rate()
    assert made.false_alarm_rate().high < 0.011
    # alarms of single samples: the next begins after 1/rate samples that are not in alarm
    assert 1 / 0.0099 in made.time_between_false_alarms()


@pytest.mark.parametrize(("model", "over"), [(v.heavy_tailed(3), 1.2), (v.white(), 0.0)])
def test_heavy_tails_cost_false_alarms(white_monitor: rs.Monitor, model: v.NoiseModel, over: float) -> None:
    made = v.campaign(white_monitor, runs=100, samples=500, seed=1, noise=model)
    assert made.false_alarm_rate().value > 0.01 * over


@pytest.mark.parametrize("persistence", [1, 4, 9])
def test_a_large_step_is_seen_after_the_persistence(persistence: int) -> None:
    monitor = white_noise_monitor(persistence=persistence)
    made = v.campaign(monitor, v.Scenario("a sensor", v.step(at=100), size=50.0), runs=50, samples=150, seed=1)
    delay = made.delay(0)
    assert made.detected(0).value == 1
    assert delay.quantile(0.5).value == persistence - 1
    assert delay.mean(0).value <= persistence - 1


def test_a_step_of_known_size_is_seen_with_known_probability() -> None:
    """One white residual of unit variance and a threshold of the norm: a geometric delay."""
    plant = rs.Plant([[0.0]], [[1.0]], [[1.0]], dt=1, outputs=["a"]).with_sensor_faults()
    plant = plant.with_noise(process=0.5, measurement=0.5)
    test = rs.decide.NormThreshold(persistence=1, threshold=3.0)
    monitor = rs.Monitor(rs.design.kalman_filter(plant), test=test)
    scenario = v.Scenario("a sensor", v.step(at=100), size=2.0)
    made = v.campaign(monitor, scenario, runs=1000, samples=150, within=10, seed=2, confidence=0.99)
    from scipy.stats import norm

    each = norm.sf(1.0) + norm.cdf(-5.0)
    assert 1 - (1 - each) ** 10 in made.detected(0)
    by_chance = 1 - (1 - 2 * norm.sf(3.0)) ** 10
    assert by_chance in made.by_chance(0)
    assert 1 - made.detected(0).value == pytest.approx(made.missed(0).value)
    roc = made.roc(0)
    assert np.interp(by_chance, roc.false_alarms[::1], roc.detections) == pytest.approx(1 - (1 - each) ** 10, abs=0.04)


def test_faults_of_orthogonal_directions_are_never_confused(white_monitor: rs.Monitor) -> None:
    scenarios = [v.Scenario(f"{name} sensor", v.step(at=100), size=30.0) for name in "ab"]
    made = v.campaign(white_monitor, scenarios, runs=40, samples=200, seed=1)
    columns = made.confusion().columns()
    assert columns["a sensor"] == [1.0, 0.0]
    assert columns["b sensor"] == [0.0, 1.0]
    assert columns["unknown"] == columns["none"] == [0.0, 0.0]
    assert made.named(0).value == 1


def test_names_and_no_names_add_up(monitor: rs.Monitor) -> None:
    made = v.campaign(monitor, of_all_kinds(), **SMALL)
    columns = made.confusion().columns()
    shares = [columns[name] for name in columns if not name.endswith((" low", " high"))][3:]
    np.testing.assert_allclose(np.sum(shares, axis=0), 1)
    for c in range(len(made.cases)):
        missed = np.count_nonzero(made.figures.detected[c] < 0) / made.runs
        assert columns["none"][c] == pytest.approx(missed)
        assert made.missed(c).value == pytest.approx(missed)


def test_without_names_every_alarm_is_unknown(plant: rs.Plant) -> None:
    monitor = rs.Monitor(rs.design.kalman_filter(plant), isolate=None)
    made = v.campaign(monitor, v.Scenario("a sensor", v.step(at=50), size=3.0), **SMALL)
    assert made.confusion().columns()["unknown"] == [1.0]


# ------------------------------------------------- against a plain simulation and Monitor.run


def plain(plant: rs.Plant, u: NDArray, noise: NDArray, change, controller: rs.StateSpace | None = None) -> NDArray:
    """Return commands and measurements of one run; ``change`` returns the fault at a sample from those so far."""
    x, xc = np.zeros(plant.n_states), np.zeros(0 if controller is None else controller.n_states)
    out = []
    for k in range(len(u)):
        command = u[k] + (0 if controller is None else controller.C @ xc)
        y = plant.C @ x + plant.D @ command + plant.Dw @ noise[k]
        fault = change(k, command, y, out)
        y = y + plant.Df @ fault
        out.append(np.concatenate([command, y]))
        x = plant.A @ x + plant.B @ command + plant.Bw @ noise[k] + plant.Bf @ fault
        xc = xc if controller is None else controller.A @ xc + controller.B @ y
    return np.array(out)


def square_wave(samples: int) -> NDArray:
    return 0.5 * np.sign(np.sin(0.1 * np.arange(samples) + 0.05))[:, None]


def stuck_sensor(k: int, u: NDArray, y: NDArray, before: list[NDArray]) -> NDArray:
    held = np.zeros(4)
    held[1] = before[119][2] - y[1] if k >= 120 else 0.0
    return held


def step_of_a_leak(k: int, u: NDArray, y: NDArray, before: list[NDArray]) -> NDArray:
    return np.array([0, 0, 0, 0.2 * (k >= 120)])


def step_of_a_sensor(k: int, u: NDArray, y: NDArray, before: list[NDArray]) -> NDArray:
    return np.array([2.0 * (k >= 120), 0, 0, 0])


def weak_actuator(k: int, u: NDArray, y: NDArray, before: list[NDArray]) -> NDArray:
    return np.array([0, 0, -0.7 * u[0] * (k >= 120), 0])


CONTROLLER = rs.StateSpace([[0.5]], [[-0.2, -0.1]], [[1.0]], dt=0.5)
AGAINST = [
    (stuck_sensor, v.Scenario("b sensor", v.stuck_at(at=60))),
    (step_of_a_leak, v.Scenario("leak", v.step(at=60), size=0.2)),
    (weak_actuator, v.Scenario("valve actuator", v.loss_of_effectiveness(at=60), size=0.7)),
]


@pytest.mark.parametrize("controller", [None, CONTROLLER], ids=["open", "loop"])
@pytest.mark.parametrize(("change", "scenario"), AGAINST, ids=lambda one: getattr(one, "__name__", ""))
def test_every_run_is_what_a_monitor_says_of_a_plain_simulation(
    plant: rs.Plant, monitor: rs.Monitor, change, scenario: v.Scenario, controller: rs.StateSpace | None
) -> None:
    u = square_wave(300)
    made = v.campaign(monitor, scenario, inputs=u, controller=controller, **SMALL)
    seen = []
    for run in range(SMALL["runs"]):
        noise = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(run, 0))).standard_normal((300, 4))
        data = plain(plant, u, noise, change, controller)
        diagnosis = monitor.run(data[:, :1], data[:, 1:])
        alarm = np.flatnonzero(diagnosis.alarm[120:])
        seen.append(120 + alarm[0] if alarm.size else -1)
        healthy = plain(plant, u, noise, lambda *of: np.zeros(4), controller)
        quiet = monitor.run(healthy[:, :1], healthy[:, 1:])
        assert made.figures.decided[run] == quiet.decided.sum()
        assert made.figures.alarmed[run] == quiet.alarm.sum()
        assert made.figures.peak[0, run] == pytest.approx(np.nanmax(diagnosis.statistic[120:]), rel=1e-9)
        if len(diagnosis.alarms) == 1 and diagnosis.alarms[0].start >= 120:
            named = made.figures.named[0, run]
            best = max(diagnosis.candidates, key=lambda one: one.score)  # a diagnosis puts first what its word names
            assert made.groups[named] == best.faults
    np.testing.assert_array_equal(made.figures.detected[0], seen)
    assert max(seen) > 0


def of_kinds(plant: rs.Plant) -> dict[str, rs.Monitor]:
    """Return monitors of other kinds: matched filters, a bank that is read by code, groups, learnt faults."""
    quiet = plain(plant, square_wave(2000), np.random.default_rng(9).standard_normal((2000, 4)), healthy)
    sensors = rs.design.sensor_fault_bank(plant.without_faults(["valve actuator", "leak"]).without_disturbances())
    bank = rs.Monitor(sensors, test=rs.decide.NormThreshold(persistence=1, release=40))
    learnt = rs.Monitor(rs.design.kalman_filter(plant))
    leaking = plain(plant, np.zeros((300, 1)), np.random.default_rng(8).standard_normal((300, 4)), step_of_a_leak)
    groups = rs.decide.NormThreshold(groups="each", window=5)
    return {
        "matched": rs.Monitor(rs.design.matched_filters(plant)),
        "bank": bank.fit(quiet[:, :1], quiet[:, 1:]),
        "cusum": rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.CUSUM(shift=1.0)),
        "glr": rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.GLR(window=20)),
        "groups": rs.Monitor(rs.design.kalman_filter(plant), test=groups),
        "learnt": learnt.learn_fault("leak seen", leaking[:, :1], leaking[:, 1:], interval=(70, 150)),
    }


def healthy(*of: object) -> NDArray:
    return np.zeros(4)


@pytest.mark.parametrize("kind", ["matched", "bank", "cusum", "glr", "groups", "learnt"])
def test_monitors_of_every_kind_name_as_their_diagnosis_does(plant: rs.Plant, kind: str) -> None:
    monitor = of_kinds(plant)[kind]
    change, scenario = step_of_a_leak, v.Scenario("leak", v.step(at=60), size=0.2)
    if kind == "bank":
        change, scenario = step_of_a_sensor, v.Scenario("a sensor", v.step(at=60), size=2.0)
    u = square_wave(300)
    made, compared = v.campaign(monitor, scenario, inputs=u, **SMALL), 0
    for run in range(SMALL["runs"]):
        noise = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(run, 0))).standard_normal((300, 4))
        data = plain(plant, u, noise, change)
        diagnosis = monitor.run(data[:, :1], data[:, 1:])
        alarm = np.flatnonzero(diagnosis.alarm[120:])
        assert made.figures.detected[0, run] == (120 + alarm[0] if alarm.size else -1)
        edges = np.count_nonzero(np.diff(diagnosis.alarm.astype(int)) == 1)
        if edges == 1 and len(diagnosis.alarms) == 1 and diagnosis.alarms[0].start >= 120:
            code, compared = made.figures.named[0, run], compared + 1
            assert diagnosis.named == ((made.groups[code],) if code >= 0 else ())
    assert compared > 3


def test_an_alarm_that_stands_at_the_onset_is_named_too(plant: rs.Plant) -> None:
    test = rs.decide.NormThreshold(threshold=1.5, persistence=1)
    for design in (rs.design.matched_filters(plant), rs.design.kalman_filter(plant)):
        made = v.campaign(rs.Monitor(design, test=test), v.Scenario("leak", v.step(at=60), size=0.2), **SMALL)
        assert (made.figures.detected[0] >= 120).all()
        assert made.by_chance(0).value == 1
        assert made.named(0).value > 0.5


def test_members_of_an_uncertain_plant_are_those_that_it_samples(plant: rs.Plant, monitor: rs.Monitor) -> None:
    push = Perturbation("A", [[-1.0], [0.0]], [[1.0, 0.0]], -0.2, 0.02, ["outflow"])
    uncertain = UncertainPlant(plant, deltas=[push])
    u = np.ones((300, 1))
    made = v.campaign(monitor, AGAINST[1][1], inputs=u, plants=uncertain, **SMALL)
    for run in range(4):
        rng = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(run, 2)))
        (member,) = uncertain.sample(rng, 1)
        noise = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(run, 0))).standard_normal((300, 4))
        data = plain(member, u, noise, step_of_a_leak)
        diagnosis = monitor.run(data[:, :1], data[:, 1:])
        assert made.figures.peak[0, run] == pytest.approx(np.nanmax(diagnosis.statistic[120:]), rel=1e-9)
    nominal = v.campaign(monitor, inputs=u, **SMALL)
    assert made.false_alarm_rate().value > nominal.false_alarm_rate().value


def test_a_stuck_sensor_misleads_the_controller_of_an_uncertain_plant_too(plant: rs.Plant, monitor: rs.Monitor) -> None:
    uncertain = UncertainPlant(
        plant, deltas=[Perturbation("A", [[-1.0], [0.0]], [[1.0, 0.0]], -0.02, 0.02, ["outflow"])]
    )
    v.campaign(monitor, of_all_kinds(), plants=uncertain, controller=CONTROLLER, **SMALL)
    change, scenario = AGAINST[0]
    made = v.campaign(monitor, scenario, plants=uncertain, controller=CONTROLLER, **SMALL)
    for run in range(3):
        (member,) = uncertain.sample(np.random.default_rng(np.random.SeedSequence(5, spawn_key=(run, 2))), 1)
        noise = np.random.default_rng(np.random.SeedSequence(5, spawn_key=(run, 0))).standard_normal((300, 4))
        data = plain(member, np.zeros((300, 1)), noise, change, CONTROLLER)
        diagnosis = monitor.run(data[:, :1], data[:, 1:])
        assert made.figures.peak[0, run] == pytest.approx(np.nanmax(diagnosis.statistic[120:]), rel=1e-9)


def test_a_monitor_of_a_closed_loop(plant: rs.Plant) -> None:
    loop = UncertainPlant(plant).in_closed_loop(CONTROLLER).nominal
    monitor = rs.Monitor(rs.design.kalman_filter(loop))
    scenarios = [v.Scenario("a sensor", v.step(at=50), size=2.0), v.Scenario("b sensor", v.stuck_at(at=50, value=3.0))]
    made = v.campaign(monitor, scenarios, **SMALL)
    assert made.detected(0).value == made.detected(1).value == 1


def test_several_plants_in_turn(plant: rs.Plant, monitor: rs.Monitor) -> None:
    other = plant.with_noise(process=1e-2, measurement=1e-1)
    made = v.campaign(monitor, plants=[plant, other], **SMALL)
    alone = v.campaign(monitor, **SMALL)
    np.testing.assert_array_equal(made.figures.alarmed[::2], alone.figures.alarmed[::2])
    assert made.figures.alarmed[1::2].sum() > 5 * made.figures.alarmed[::2].sum()


def test_a_disturbance_that_is_not_decoupled_costs_false_alarms(monitor: rs.Monitor) -> None:
    none, given, drawn = (
        v.campaign(monitor, disturbances=one, **SMALL).false_alarm_rate().value
        for one in (None, {"gust": 1.0}, {"gust": v.coloured(0.9, size=1.0)})
    )
    assert none < 0.02
    assert given > 10 * max(none, 0.001)
    assert drawn > 10 * max(none, 0.001)


def test_resampled_residuals_in_place_of_a_noise_model(white_monitor: rs.Monitor) -> None:
    """Residuals of a recording with twice the noise: the rate is that of the recording, not of the model."""
    y = 2 * np.sqrt(1.5) * np.random.default_rng(0).standard_normal((5000, 2)) * [1.0, np.sqrt(1 / 1.5)]
    recorded = white_monitor.run(np.zeros((5000, 1)), y)
    scenario = v.Scenario("b sensor", v.step(at=100), size=100.0)
    made = v.campaign(
        white_monitor, scenario, noise=v.resampled(recorded, block=10), inputs=0, runs=100, samples=500, seed=1
    )
    assert recorded.false_alarm_fraction > 0.05
    assert made.false_alarm_rate().value == pytest.approx(recorded.false_alarm_fraction, rel=0.1)
    assert made.detected(0).value == made.named(0).value == 1


# ------------------------------------------------------------------- the same numbers


@pytest.mark.parametrize("together", [1, 5, 12])
def test_figures_do_not_depend_on_how_runs_are_put_together(
    monitor: rs.Monitor, monkeypatch: pytest.MonkeyPatch, together: int
) -> None:
    options = {"disturbances": {"gust": v.coloured(0.9, size=0.01)}, "noise": v.heavy_tailed(5), **SMALL}
    whole = v.campaign(monitor, of_all_kinds(), **options)
    monkeypatch.setattr(runs_module.Plan, "runs_at_once", property(lambda plan: together))
    assert same(whole.figures, v.campaign(monitor, of_all_kinds(), **options).figures)


def test_figures_in_a_loop_do_not_depend_on_it_either(monitor: rs.Monitor, monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"controller": CONTROLLER, "runs": 6, "samples": 150, "seed": 5}
    whole = v.campaign(monitor, of_all_kinds(), **options)
    monkeypatch.setattr(runs_module.Plan, "runs_at_once", property(lambda plan: 1))
    assert same(whole.figures, v.campaign(monitor, of_all_kinds(), **options).figures)


def test_the_first_runs_of_a_longer_campaign_are_the_same(monitor: rs.Monitor) -> None:
    few = v.campaign(monitor, of_all_kinds(), **SMALL).figures
    more = v.campaign(monitor, of_all_kinds(), **SMALL | {"runs": 20}).figures
    for one in fields(few):
        np.testing.assert_array_equal(getattr(few, one.name), getattr(more, one.name)[..., :12])


def test_another_seed_has_other_runs(monitor: rs.Monitor) -> None:
    one, two = (v.campaign(monitor, of_all_kinds(), **SMALL | {"seed": seed}).figures for seed in (5, 6))
    assert not same(one, two)


def test_several_workers_give_the_same(monitor: rs.Monitor) -> None:
    pytest.importorskip("joblib")
    options = {"runs": 40, "samples": 200, "seed": 5}
    one = v.campaign(monitor, of_all_kinds(), **options)
    assert same(one.figures, v.campaign(monitor, of_all_kinds(), workers=2, **options).figures)


def test_several_workers_need_joblib(monitor: rs.Monitor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "joblib", None)
    with pytest.raises(MissingExtraError, match=r"residua\[workers\]"):
        v.campaign(monitor, workers=2, **SMALL)


def test_resumed_is_the_same_as_uninterrupted(
    monitor: rs.Monitor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs_module.Plan, "runs_at_once", property(lambda plan: 5))
    path = tmp_path / "campaign.npz"
    whole = v.campaign(monitor, of_all_kinds(), **SMALL)

    def stop(stage: str, done: int, total: int) -> None:
        assert (stage, total) == ("runs", 12)
        if done >= 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        v.campaign(monitor, of_all_kinds(), resume=path, progress=stop, **SMALL)
    with pytest.raises(FileFormatError, match="5 of 12 runs"):
        v.Campaign.load(path)
    told = []
    made = v.campaign(
        monitor, of_all_kinds(), resume=path, progress=lambda stage, done, total: told.append(done), **SMALL
    )
    assert told == [10, 12]  # the first five were not run again
    assert same(made.figures, whole.figures)
    loaded = v.Campaign.load(path)
    assert same(loaded.figures, whole.figures)
    assert str(loaded) == str(whole)
    with pytest.raises(SettingError, match="holds another campaign"):
        v.campaign(monitor, of_all_kinds(), resume=path, **SMALL | {"seed": 6})
    with pytest.raises(SettingError, match=r"different: .*noise"):
        v.campaign(monitor, of_all_kinds(), resume=path, noise=v.heavy_tailed(), **SMALL)
    longer = v.campaign(monitor, of_all_kinds(), resume=path, **SMALL | {"runs": 15})
    assert longer.runs == longer.figures.runs == 15


def test_a_campaign_is_saved_and_loaded(monitor: rs.Monitor, tmp_path: Path) -> None:
    made = v.campaign(monitor, of_all_kinds(), **SMALL)
    loaded = v.Campaign.load(made.save(tmp_path / "campaign.npz"))
    assert same(made.figures, loaded.figures)
    assert values_out(made, but={"figures"}) == values_out(loaded, but={"figures"})
    assert str(made) == str(loaded)


def test_a_file_that_is_no_campaign(tmp_path: Path) -> None:
    path = tmp_path / "campaign.npz"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(FileFormatError, match="is not the file of a campaign"):
        v.Campaign.load(path)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(FileFormatError, match="is not the file of a campaign"):
        v.Campaign.load(path)


@pytest.mark.parametrize("power", [-20, 20])
def test_figures_do_not_depend_on_units(power: int) -> None:
    """All signals in units that are a power of two larger or smaller: the same decisions."""

    def made(factor: float) -> v.Campaign:
        plant = rs.Plant([[0.9, 0.1], [0.0, 0.8]], [[0.0], [0.5]], factor * np.eye(2), dt=0.5, outputs=["a", "b"])
        plant = plant.with_sensor_faults().with_faults({"leak": [-1.0, 0.5]})
        plant = plant.with_noise(process=1e-4, measurement=1e-2 * factor**2)
        monitor = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.NormThreshold(false_alarm_rate=0.01))
        scenarios = [
            v.Scenario("a sensor", v.step(at=50), size=[0.3 * factor, 0.6 * factor]),
            v.Scenario("leak", v.ramp(slope=0.02, at=50), size=0.3),
            v.Scenario("b sensor", v.stuck_at(at=60, value=0.5 * factor)),
        ]
        return v.campaign(monitor, scenarios, **SMALL)

    one, other = made(1.0).figures, made(2.0**power).figures
    for name in ("decided", "alarmed", "raised", "onset", "detected", "named", "by_chance"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_allclose(one.peak, other.peak, rtol=1e-9)


# ------------------------------------------------------------------ comparing, and the page


def test_two_monitors_on_the_same_draws() -> None:
    quick, slow = white_noise_monitor(persistence=1), white_noise_monitor(persistence=3)
    scenario = v.Scenario("a sensor", v.step(at=100), size=[1.0, 30.0])
    options = {"runs": 60, "samples": 160, "seed": 1, "within": 20}
    first, second = (v.campaign(one, scenario, **options) for one in (quick, slow))
    compared = first.compare(second)
    small, large = compared.cases
    assert small.only_first > small.only_second
    assert small.p_value < 0.01
    assert small.detected.low > 0
    assert (large.only_first, large.only_second, large.p_value) == (0, 0, 1.0)
    assert large.delay.value == pytest.approx(-2, abs=0.1)
    assert compared.false_alarm_rate.low > 0
    assert "only first" in str(compared)
    same_monitor = first.compare(first)
    assert same_monitor.false_alarm_rate.value == 0
    assert same_monitor.cases[0].p_value == 1
    with pytest.raises(SettingError, match="not on the same draws"):
        first.compare(v.campaign(slow, scenario, **options | {"seed": 2}))


def test_the_page_opens_and_has_all_that_repeats_it(monitor: rs.Monitor, tmp_path: Path) -> None:
    nasty = v.campaign(monitor, of_all_kinds(), **SMALL)
    odd = replace(nasty, cases=tuple(replace(case, fault=page_reader.NASTY) for case in nasty.cases))
    odd = replace(odd, groups=tuple((page_reader.NASTY,) for _ in nasty.groups), settings={"a": page_reader.NASTY})
    assert "<img src=x" not in odd.to_html(tmp_path / "odd.html").read_text(encoding="utf-8")
    page = nasty.to_html(tmp_path / "campaign.html", title=page_reader.NASTY).read_text(encoding="utf-8")
    words = page_reader.words(page)
    assert "<img src=x" not in page
    for text in ("False alarms", "Detected so far", "Over all thresholds", "Probability of detection", "unknown"):
        assert text in words or text in page
    for text in (
        np.__version__,
        nasty.draws,
        nasty.watched,
        "white, Gaussian",
        "stuck at(at=60)",
    ):
        assert text in words
    assert page.count("<svg") >= 2 * 9
    without = v.campaign(monitor, **SMALL).to_html(tmp_path / "quiet.html").read_text(encoding="utf-8")
    assert "False alarms" in page_reader.words(without)


def test_what_was_not_judged_is_said(monitor: rs.Monitor) -> None:
    huge = v.campaign(monitor, v.Scenario("a sensor", v.step(at=60), size=1e60), **SMALL)
    assert huge.detected(0).value == 0
    assert "in 12 of 12 runs nothing was judged from the onset on" in str(huge)
    early = v.campaign(monitor, v.Scenario("a sensor", v.step(at=1), size=5.0), **SMALL)
    assert f"within the {monitor.settling_samples} samples" in str(early)
    short = v.campaign(monitor, runs=3, samples=10)
    assert np.isnan(short.false_alarm_rate().value)
    assert "too short for the filter to settle" in str(short)


def test_detections_by_chance_are_said(white_monitor: rs.Monitor) -> None:
    scenario = v.Scenario("a sensor", v.step(at=60), size=1.0)
    whole, first = (v.campaign(white_monitor, scenario, within=w, **SMALL) for w in (None, 2.0))
    assert "would count as detected without the fault" in str(whole)
    assert not first.notes


def test_tables_have_a_row_for_each_case(monitor: rs.Monitor) -> None:
    made = v.campaign(monitor, of_all_kinds(), **SMALL)
    for table in (made.table(), made.delays(), made.confusion()):
        assert len(table.rows) == len(made.cases) == 10
    assert len(made.detection_probabilities()) == 9
    assert set(made.roc()) == {case.name for case in made.cases}
    assert "false-alarm rate" in str(made)
    alike = [v.Scenario("leak", v.intermittent(on=5, off=5, at=20), size=[0.123456, 0.123457])] * 2
    assert len(v.campaign(monitor, alike, **SMALL).roc()) == 4


def test_what_is_more_probably_no_fault_that_is_listed_is_unknown() -> None:
    """The fault that the plant has moves another sensor than the model says."""
    plant = rs.Plant([[0.5, 0.1], [0.0, 0.6]], [[1.0], [0.5]], [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], dt=1.0)
    model, other = (
        plant.with_faults({"drift": ([0, 0], np.eye(3)[k]), "dirt": ([0, 0], [0, 1, 0])}).with_noise(
            process=0.1, measurement=1.0
        )
        for k in (0, 2)
    )
    isolate = rs.decide.Likelihood(window=20)
    test = rs.decide.CUSUM(mean_time_between_false_alarms=1e4)
    monitor = rs.Monitor(rs.design.kalman_filter(model), test=test, isolate=isolate)
    faults = [v.Scenario(name, v.step(at=100), size=8.0) for name in model.faults]
    made = v.campaign(monitor, faults, runs=40, samples=140, plants=other, progress=False)
    right, unknown = (made.confusion().columns()[name] for name in (model.faults[1], "unknown"))
    assert unknown[0] > 0.9
    assert right[1] > 0.9


# ----------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"confidence": 1.0}, SettingError, "confidence must lie between 0 and 1"),
        ({"runs": 0}, SettingError, "runs must be a whole number"),
        ({"samples": 2.5}, SettingError, "samples must be a whole number"),
        ({"workers": 0}, SettingError, "workers must be a whole number"),
        ({"seed": -1}, SettingError, "seed must be a whole number"),
        ({"within": 0.1}, SettingError, "within must be one step"),
        ({"within": np.nan}, SettingError, "within must be one step"),
        ({"within": "soon"}, SettingError, "within must be one step"),
        ({"inputs": np.zeros((10, 1))}, DataError, "300 samples or more"),
        ({"inputs": np.full((300, 1), np.nan)}, DataError, "inputs must be finite"),
        ({"inputs": "sweep"}, DataError, "array of numbers"),
        ({"disturbances": {"storm": 1.0}}, SettingError, "no disturbance 'storm'; known: gust"),
        ({"disturbances": {"gust": np.inf}}, DataError, "must be finite"),
        ({"disturbances": {"gust": np.zeros(5)}}, DataError, "300 samples or more"),
        ({"disturbances": {"gust": "strong"}}, DataError, "must be a number, an array"),
        ({"disturbances": ["gust"]}, SettingError, "signals by name"),
        ({"noise": "white"}, SettingError, "noise must be white"),
        ({"noise": v.white(2.0)}, SettingError, "the plant gives the size of its noise"),
        ({"noise": v.resampled(np.zeros((50, 3)))}, SettingError, "3 columns"),
        ({"plants": []}, SettingError, "plants must be a Plant"),
        ({"plants": "others"}, SettingError, "plants must be a Plant"),
        ({"samples": 10**9}, SettingError, "takes .* GB"),
        ({"resume": "nowhere/campaign.npz"}, FileFormatError, "does not exist"),
    ],
)
def test_what_is_refused(monitor: rs.Monitor, options: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        v.campaign(monitor, v.Scenario("leak", v.step(at=1)), **SMALL | options)


def test_what_does_not_fit_the_monitor(plant: rs.Plant, monitor: rs.Monitor) -> None:
    with pytest.raises(SettingError, match="no fault 'rust'"):
        v.campaign(monitor, v.Scenario("rust", v.step(at=1)), **SMALL)
    with pytest.raises(SettingError, match="after the last sample"):
        v.campaign(monitor, v.Scenario("leak", v.step(at=1000)), **SMALL)
    dt, samples = monitor.generator.dt, SMALL["samples"]  # an onset between samples comes with the next one
    last = v.Scenario("leak", v.step(at=dt * (samples - 10)))
    between = v.Scenario("leak", v.step(at=dt * (samples - 9.6)))
    v.campaign(monitor, last, **SMALL | {"runs": 1, "within": 10 * dt})
    with pytest.raises(SettingError, match="the run ends before"):
        v.campaign(monitor, between, **SMALL | {"runs": 1, "within": 10 * dt})
    with pytest.raises(SettingError, match="scenarios must be"):
        v.campaign(monitor, ["leak"], **SMALL)  # pyright: ignore
    with pytest.raises(SettingError, match="scenarios must be"):
        v.campaign(monitor, None, **SMALL)  # pyright: ignore
    with pytest.raises(SettingError, match="takes a Monitor"):
        v.campaign(plant, **SMALL)  # pyright: ignore
    with pytest.raises(NotFittedError, match="no threshold"):
        v.campaign(rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.PeakThreshold()), **SMALL)
    renamed = rs.Plant(plant.A, plant.B, plant.C, dt=0.5, inputs=["valve"], outputs=["a", "c"])
    with pytest.raises(SettingError, match="has the outputs a, c, the monitor watches a, b"):
        v.campaign(monitor, plants=renamed, **SMALL)
    without = rs.Plant(plant.A, plant.B, plant.C, dt=0.5, inputs=["valve"], outputs=["a", "b"])
    with pytest.raises(SettingError, match="no noise to simulate"):
        v.campaign(monitor, plants=without, **SMALL)
    with pytest.raises(SettingError, match="simulated plant has no fault 'leak'"):
        v.campaign(monitor, v.Scenario("leak", v.step(at=1)), plants=without.with_noise(measurement=1), **SMALL)
    with pytest.raises(SettingError, match=r"has dt=2 s, the monitor runs at 0\.5 s"):
        v.campaign(monitor, plants=rs.Plant(plant.A, plant.B, plant.C, dt=2, inputs=["valve"], outputs=["a", "b"]))
    with pytest.raises(SettingError, match="the same disturbances, faults"):
        v.campaign(monitor, plants=[plant, without], **SMALL)


def test_an_unstable_plant_needs_its_controller() -> None:
    plant = rs.Plant([[1.2]], [[1.0]], [[1.0]], dt=1, outputs=["a"]).with_sensor_faults()
    plant = plant.with_noise(process=1e-4, measurement=1e-2)
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    with pytest.raises(ModelError, match="give controller="):
        v.campaign(monitor, **SMALL)
    made = v.campaign(monitor, controller=rs.StateSpace([[0.0]], [[-0.7]], [[1.0]], dt=1), **SMALL)
    assert made.false_alarm_rate().value < 0.05


def test_a_continuous_plant_is_sampled(tmp_path: Path) -> None:
    plant = rs.Plant([[-0.5]], [[1.0]], [[1.0]], outputs=["a"]).with_sensor_faults().with_actuator_faults()
    plant = plant.with_noise(process=1e-3, measurement=1e-3)
    monitor = rs.Monitor(rs.design.kalman_filter(plant.discretize(0.1)))
    scenarios = [
        v.Scenario("a sensor", v.step(at=10), size=2.0),
        v.Scenario("u1 actuator", v.stuck_at(at=10, value=5.0)),
    ]
    made = v.campaign(monitor, scenarios, plants=plant, **SMALL)
    assert made.detected(0).value == made.detected(1).value == 1
    assert made.delay(0).quantile(0.5).value < 1.0
