"""Thresholds that move with the inputs: their promise on plants that are wrong, and what a fit makes of data."""

from collections.abc import Mapping

import numpy as np
import pytest

import residua as rs
from residua.decide.adaptive import AdaptiveTest, _quantile_weights
from residua.decide.model_errors import errors_of_gains, errors_of_parameters
from residua.decide.test import Block
from residua.errors import DataError, ModelError, SettingError
from residua.linear import StateSpace
from residua.plant import UncertainPlant
from residua.testing import check_test
from residua.validate.intervals import wilson

#: Deviation of the measurement noise.
NOISE = 0.01


def plant_of(
    pole: float = 0.9, gain: float = 0.3, coupling: float = 0.1, units: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
) -> rs.Plant:
    """Return a plant with two inputs and two outputs, whose units are divided by these factors."""
    u, y = np.array(units[:2]), np.array(units[2:])
    plant = rs.Plant(
        [[pole, coupling], [0, 0.7]],
        np.array([[0.05, 0], [gain, 0.1]]) / u,
        y[:, None] * np.eye(2),
        dt=1,
        inputs=["valve", "pump"],
        outputs=["level", "flow"],
    )
    V = np.diag((NOISE * y) ** 2)
    return plant.with_sensor_faults().with_actuator_faults().with_noise(measurement=V)


def inputs(samples: int, seed: int, size: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return size * np.repeat(rng.standard_normal((samples // 50 + 1, 2)), 50, axis=0)[:samples]


def measured(system: StateSpace, u: np.ndarray, seed: int) -> np.ndarray:
    return system.simulate(u) + NOISE * np.random.default_rng(seed).standard_normal((len(u), 2))


def by_gains(plant: rs.Plant, factors: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the outputs where each response is multiplied by a factor of its own."""
    system, y = plant.system("control"), np.zeros((len(u), 2))
    for i in range(2):
        for j in range(2):
            y[:, i] += factors[i, j] * system.select(inputs=[j], outputs=[i]).simulate(u[:, [j]])[:, 0]
    return y


def over(watch: rs.Monitor, u: np.ndarray, y: np.ndarray) -> tuple[int, int]:
    statistic = watch.run(u, y).statistic
    seen = np.isfinite(statistic)
    return int((statistic[seen] > watch.threshold).sum()), int(seen.sum())


def test_no_gain_error_of_that_size_makes_alarms_more_frequent() -> None:
    plant, rate = plant_of(), 0.01
    flt = rs.design.kalman_filter(plant)
    moving = rs.Monitor(flt, test=rs.decide.Adaptive(relative=0.08, false_alarm_rate=rate, persistence=1))
    fixed = rs.Monitor(flt, test=rs.decide.NormThreshold(false_alarm_rate=rate, persistence=1))
    rng = np.random.default_rng(0)
    counts, plain = np.zeros(2), np.zeros(2)
    for seed in range(40):
        factors = 1 + 0.08 * (rng.choice([-1, 1], (2, 2)) if seed % 2 else rng.uniform(-1, 1, (2, 2)))
        u = inputs(600, seed, size=10.0 ** rng.uniform(-1, 1))
        y = by_gains(plant, factors, u) + NOISE * np.random.default_rng(seed).standard_normal((600, 2))
        counts += over(moving, u, y)
        plain += over(fixed, u, y)
    assert wilson(counts[0], counts[1], 0.999).low <= rate
    assert plain[0] / plain[1] > 0.2  # what the fixed threshold makes of the same plants
    quiet = np.zeros((20_000, 2))
    counts = np.array(over(moving, quiet, measured(plant.system("control"), quiet, 1)))
    assert rate in wilson(counts[0], counts[1], 0.999)  # at rest it is as sharp as noise allows


def uncertain(more: int = 0) -> UncertainPlant:
    """Return a plant with two uncertain parameters, and as many that hardly matter besides."""

    def of(values: Mapping[str, float]) -> rs.Plant:
        spare = sum(values[name] for name in values if name.startswith("spare"))
        return plant_of(values["pole"], values["gain"], 0.1 + 0.01 * spare)

    spare = {f"spare {k}": (-1.0, 0.0, 1.0) for k in range(more)}
    return UncertainPlant.from_parameters(of, {"pole": (0.88, 0.9, 0.915), "gain": (0.27, 0.3, 0.33)} | spare)


@pytest.mark.parametrize("more", [0, 3])
def test_no_member_of_an_uncertain_plant_makes_alarms_more_frequent(more: int) -> None:
    members, rate = uncertain(more), 0.01
    test = rs.decide.Adaptive(relative=members, false_alarm_rate=rate, persistence=1)
    watch = rs.Monitor(rs.design.kalman_filter(members.nominal), test=test)
    assert watch.norm_test.together == (more == 0)
    assert len(watch.norm_test.errors) == (4 if more == 0 else 5)
    counts = np.zeros(2)
    corners = [members.member(row) for row in members.vertex_values()[:8]]
    for seed, member in enumerate(members.sample(0, 24) + corners):
        u = inputs(600, seed, size=10.0)
        counts += over(watch, u, measured(member.system("control"), u, seed))
    assert wilson(counts[0], counts[1], 0.999).low <= rate


def test_a_fault_is_seen_that_errors_of_the_model_do_not_explain() -> None:
    plant = plant_of()
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.Adaptive(relative=0.05))
    u = inputs(800, 3)
    y = measured(plant.system("control"), u, 3)
    y[400:, 0] += 0.5
    found = watch.run(u, y)
    assert not found.alarm[:400].any()
    assert found.alarm[410:].mean() > 0.9


def test_a_fit_is_sharp_at_rest_and_quiet_in_motion() -> None:
    plant, true = plant_of(), plant_of(pole=0.905, gain=0.31, coupling=0.11)
    flt, system = rs.design.kalman_filter(plant), true.system("control")
    u = inputs(12_000, 1)
    y = measured(system, u, 1)
    moving, fixed = (
        rs.Monitor(flt, test=kind(false_alarm_rate=1e-3)) for kind in (rs.decide.Adaptive, rs.decide.NormThreshold)
    )
    for watch in (moving, fixed):
        watch.fit(u, y)
    assert "allows for errors of the model" in moving.norm_test.basis
    u = inputs(20_000, 2)
    assert moving.run(u, measured(system, u, 2)).alarm.mean() < 0.01
    rest = np.zeros((4000, 2))
    y = measured(system, rest, 3)
    assert moving.run(rest, y).alarm.mean() < 0.002
    y[2000:, 0] += 0.1
    assert moving.run(rest, y).alarm[2010:].mean() > 0.95
    assert fixed.run(rest, y).alarm[2010:].mean() < 0.05  # the fixed one has grown to what errors do in motion


def test_a_fit_to_few_samples_keeps_its_promise() -> None:
    """By weights of samples that are far from those judged: by weights of all samples 4 of these fits broke it."""
    plant = plant_of().with_noise(process=1e-6 * np.eye(2), measurement=NOISE**2 * np.eye(2))
    observer, broken = rs.design.kalman_filter(plant), 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        factors, u = 1 + 0.05 * rng.uniform(-1, 1, (2, 2)), inputs(500, 100 + seed)
        y = by_gains(plant, factors, u) + NOISE * rng.standard_normal((500, 2))
        watch = rs.Monitor(observer, test=rs.decide.Adaptive(false_alarm_rate=0.01)).fit(u, y, held_out=0)
        u = inputs(10_000, 900 + seed)
        alarm = watch.run(u, by_gains(plant, factors, u) + NOISE * rng.standard_normal((10_000, 2))).alarm
        test = watch._specification().test
        assert isinstance(test, AdaptiveTest)
        assert test.promised is not None
        broken += bool(alarm.mean() > test.promised)
    assert broken <= 2  # 95 % are promised


def test_a_fit_with_given_errors_keeps_their_size() -> None:
    plant = plant_of()
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.Adaptive(relative=0.05, window=4))
    u = inputs(6000, 1)
    watch.fit(u, measured(plant.system("control"), u, 1))
    assert (watch.norm_test.weights == 0.05).all()
    assert "wrong by 5 %" in watch.norm_test.basis
    u = inputs(6000, 2)
    assert watch.run(u, measured(plant.system("control"), u, 2)).alarm.mean() < 0.002


def test_a_threshold_that_is_given_stays() -> None:
    plant = plant_of()
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.Adaptive(relative=0.05, threshold=7.0))
    assert watch.threshold == 7.0
    u = inputs(3000, 1)
    watch.fit(u, measured(plant.system("control"), u, 1))
    assert watch.threshold == 7.0
    assert watch.norm_test.promised is None
    assert "threshold given" in watch.norm_test.basis


def test_a_model_without_errors_moves_nothing() -> None:
    plant = plant_of()
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.Adaptive(false_alarm_rate=0.01))
    u = inputs(12_000, 1)
    watch.fit(u, measured(plant.system("control"), u, 1))
    assert (watch.norm_test.weights < 0.01).all()


def test_quantile_weights_are_the_best_ones() -> None:
    rng = np.random.default_rng(0)
    explained = np.abs(rng.standard_normal((3000, 3)))
    norms = 1 + 0.5 * explained[:, 0] + 2 * explained[:, 1] + rng.exponential(1.0, 3000)
    weights = _quantile_weights(norms, explained, 1.0, 0.05)

    def loss(a: float, b: np.ndarray) -> float:
        left = norms - 1.0 - a - explained @ b
        return float(np.sum(np.where(left > 0, 0.95 * left, -0.05 * left)))

    def best(b: np.ndarray) -> float:
        return loss(max(float(np.quantile(norms - 1.0 - explained @ b, 0.95)), 0.0), b)

    mine = best(weights)
    for _ in range(300):
        other = np.maximum(weights + rng.normal(0, 0.1, 3), 0.0)
        assert best(other) >= mine * (1 - 1e-3)
    assert weights == pytest.approx([0.5, 2.0, 0.0], abs=0.25)


@pytest.mark.parametrize("settings", [{"relative": 0.05}, {"relative": 0.05, "window": 5}, {}])
def test_the_contract_of_a_test(settings: dict[str, float]) -> None:
    check_test(rs.decide.Adaptive(false_alarm_rate=0.01, **settings))  # pyright: ignore[reportArgumentType]


def test_streams_gaps_and_files_change_no_bit(tmp_path: object) -> None:
    members = uncertain()
    watch = rs.Monitor(rs.design.kalman_filter(members.nominal), test=rs.decide.Adaptive(relative=members, window=3))
    u = inputs(300, 1)
    y = measured(members.nominal.system("control"), u, 1)
    u[100:104, 0] = np.nan
    y[200:230] = np.nan
    whole = watch.run(u, y)
    path = f"{tmp_path}/watch.json"
    watch.save(path)
    loaded = rs.Monitor.load(path)
    again = loaded.run(u, y)
    assert np.array_equal(whole.statistic, again.statistic, equal_nan=True)
    loaded.reset()
    steps = [loaded.step(a, b) for a, b in zip(u, y, strict=True)]
    assert [one.alarm for one in steps] == whole.alarm.tolist()
    assert loaded.fit(inputs(3000, 5), measured(members.nominal.system("control"), inputs(3000, 5), 5)).is_fitted


@pytest.mark.parametrize("powers", [(20, -20, 20, -20), (-20, 10, 5, 20)])
def test_units_change_nothing(powers: tuple[int, ...]) -> None:
    scale = tuple(2.0**power for power in powers)
    u = inputs(1500, 1)
    y = measured(plant_of(pole=0.905).system("control"), u, 1)
    watch, other = (
        rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.Adaptive(false_alarm_rate=0.01))
        for plant in (plant_of(), plant_of(units=scale))
    )
    watch.fit(u, y)
    other.fit(u * scale[:2], y * scale[2:])
    v = inputs(500, 2)
    z = measured(plant_of(pole=0.905).system("control"), v, 2)
    a, b = watch.run(v, z), other.run(v * scale[:2], z * scale[2:])
    assert a.statistic == pytest.approx(b.statistic, rel=1e-6, abs=1e-6, nan_ok=True)  # weights by an iteration
    assert (a.alarm == b.alarm).all()


def test_errors_of_gains_are_the_responses_themselves() -> None:
    plant = plant_of()
    u = inputs(200, 4)
    total = sum(one.system.simulate(u) for one in errors_of_gains(plant))
    assert total == pytest.approx(plant.system("control").simulate(u), abs=1e-12)
    late = [one for one in errors_of_gains(plant, changes=True) if one.name.endswith("late")]
    y = plant.system("control").simulate(u)
    assert sum(one.system.simulate(u) for one in late) == pytest.approx(np.diff(y, axis=0, prepend=0), abs=1e-12)


def test_errors_of_parameters_are_differences_of_members() -> None:
    members, u = uncertain(), inputs(100, 4)
    errors, together = errors_of_parameters(members)
    assert together
    for one, row in zip(errors, members.vertex_values(), strict=True):
        apart = members.member(row).system("control").simulate(u) - members.nominal.system("control").simulate(u)
        assert one.system.simulate(u) == pytest.approx(apart, abs=1e-12)


def test_a_continuous_plant_is_sampled() -> None:
    plant = rs.Plant([[-0.5]], [[0.5]], [[1.0]], inputs=["valve"], outputs=["level"]).with_sensor_faults()
    plant = plant.with_noise(process=1e-4, measurement=1e-4)
    watch = rs.Monitor(rs.design.kalman_filter(plant), test=rs.decide.Adaptive(relative=0.1), dt=0.1)
    u = np.repeat([[0.0], [1.0]], 200, axis=0)
    y = 1.05 * plant.system("control").discretize(0.1).simulate(u)
    assert not watch.fit(u + 0.0, y + 1e-2 * np.random.default_rng(0).standard_normal(y.shape)).run(u, y).alarm.any()


@pytest.mark.parametrize("relative", [0, -0.1, np.nan, "much", [0.1], True])
def test_sizes_of_errors_that_are_none(relative: object) -> None:
    with pytest.raises(SettingError, match="relative must be"):
        rs.decide.Adaptive(relative=relative)  # pyright: ignore[reportArgumentType]


def test_what_cannot_be_done_is_said() -> None:
    flt = rs.design.kalman_filter(plant_of())
    other = UncertainPlant.from_plants([rs.Plant([[a]], [[1.0]], [[1.0]], dt=1) for a in (0.5, 0.6)])
    with pytest.raises(SettingError, match="channels"):
        rs.Monitor(flt, test=rs.decide.Adaptive(relative=other))
    exact = UncertainPlant(plant_of())
    with pytest.raises(ModelError, match="no parameter"):
        rs.decide.Adaptive(relative=exact)
    integrator = rs.Plant([[1.0]], [[1.0]], [[1.0]], dt=1).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    with pytest.raises(ModelError, match="does not settle"):
        rs.Monitor(rs.design.kalman_filter(integrator), test=rs.decide.Adaptive(relative=0.1))
    alone = (
        rs.Plant([[0.5]], np.zeros((1, 0)), [[1.0]], dt=1).with_sensor_faults().with_noise(process=1.0, measurement=1.0)
    )
    with pytest.raises(SettingError, match="no inputs"):
        rs.Monitor(rs.design.kalman_filter(alone), test=rs.decide.Adaptive(relative=0.1))
    bank = rs.design.sensor_fault_bank(plant_of(), observer="minimal")
    with pytest.raises(SettingError, match="codes"):
        rs.Monitor(bank, test=rs.decide.Adaptive(relative=0.1))
    watch = rs.Monitor(flt, test=rs.decide.Adaptive(relative=0.1))
    with pytest.raises(SettingError, match="campaign"):
        rs.decide.detectability(watch)
    u = inputs(200, 1)
    with pytest.raises(DataError, match="no noise"):
        watch.fit(u, plant_of().system("control").simulate(u))
    test = watch.norm_test
    with pytest.raises(DataError, match="only residuals"):
        test.run(test.start(1), Block(np.zeros((1, 3, 2)), np.ones((1, 3), dtype=bool)))
    slow = rs.decide.Adaptive(relative=UncertainPlant.from_plants([plant_of(0.9), plant_of(0.91)]))
    fast = rs.Plant(plant_of().A, plant_of().B, np.eye(2), dt=2, inputs=["valve", "pump"], outputs=["level", "flow"])
    with pytest.raises(ModelError, match="dt=1"):
        rs.Monitor(rs.design.kalman_filter(fast.with_sensor_faults().with_noise(measurement=1e-4)), test=slow)


def test_a_campaign_runs_it() -> None:
    watch = rs.Monitor(rs.design.kalman_filter(plant_of()), test=rs.decide.Adaptive(relative=0.1))
    made = rs.validate.campaign(watch, runs=40, samples=200, seed=1, plants=plant_of(gain=0.32))
    assert made.false_alarm_rate().value < 0.01
