"""How small a fault a monitor sees: against distributions, integral equations, and campaigns."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import chndtr, ndtr

import residua as rs
from residua.decide.whitened_norm import NormTest
from residua.errors import DataError, NotFittedError, SettingError

#: Intervals of tests: once in so many thousand runs of the suite one of them fails by chance. Seeds are fixed anyway.
SURE = 0.9995


def static(noise: float = 0.3) -> rs.Plant:
    """Return a plant whose residual is the measurement: white noise, and a sensor fault at once."""
    plant = rs.Plant([[0.0]], [[1.0]], [[0.0], [0.0]], dt=2.0, outputs=["a", "b"])
    return plant.with_sensor_faults().with_noise(measurement=noise**2)


def slow() -> rs.Plant:
    plant = rs.Plant([[0.9, 0.1], [0, 0.8]], [[0], [0.2]], [[1.0, 0], [0, 1.0]], dt=1, inputs=["u"])
    return plant.with_sensor_faults().with_actuator_faults().with_noise(process=1e-4, measurement=1e-2)


def kalman(plant: rs.Plant, test: rs.decide.TestSettings, **more: Any) -> rs.Monitor:
    return rs.Monitor(rs.design.kalman_filter(plant), test=test, **more)


def test_single_samples_are_as_the_noncentral_distribution_says() -> None:
    test = rs.decide.NormThreshold(false_alarm_rate=1e-3, persistence=1)
    watch = kalman(static(), test)
    seen = rs.decide.detectability(watch, within=[2, 6, 20], miss_rate=0.1, confidence=SURE, faults="a sensor")
    for one in seen.smallest:
        samples = one.within / 2.0

        def missed(size: float, samples: float = samples) -> float:
            return float(chndtr(watch.threshold**2, 2, (size / 0.3) ** 2)) ** samples - 0.1

        assert brentq(missed, 0.01, 10.0) in one.size
        miss = float(chndtr(watch.threshold**2, 2, (one.size.value / 0.3) ** 2))
        assert 2.0 * miss / (1 - miss) in one.mean_delay  # geometric, counted from the first faulty sample
    for delay, chance in zip(seen.delays, seen.by_chance, strict=True):
        assert 1 - 0.999 ** (delay / 2.0) in chance
    assert watch.norm_test.mean_time == pytest.approx(1000.0)


def test_persistence_of_single_samples_has_its_exact_mean_time() -> None:
    share = 0.25  # of samples over the threshold, one residual
    threshold = float(brentq(lambda h: 2 * ndtr(-h) - share, 0.1, 5.0))
    test = NormTest(np.zeros(1), np.full((1, 1), 2.0), threshold, 3, 1, 1, "")
    rng = np.random.default_rng(0)
    over = rng.random((4000, 2000)) < share
    row = over[:, 2:] & over[:, 1:-1] & over[:, :-2]
    assert row.any(axis=1).all()
    first = row.argmax(axis=1) + 3
    assert test.mean_time == pytest.approx(first.mean(), abs=4 * first.std() / 4000**0.5)


@pytest.mark.parametrize(
    "test",
    [
        rs.decide.CUSUM(mean_time_between_false_alarms=1e4),
        rs.decide.GLR(window=20, mean_time_between_false_alarms=1e4),
        rs.decide.NormThreshold(false_alarm_rate=1e-3, window=5),
    ],
    ids=["cusum", "glr", "norm"],
)
def test_a_campaign_detects_what_was_said(test: rs.decide.TestSettings) -> None:
    watch = kalman(slow(), test)
    seen = rs.decide.detectability(watch, within=25, miss_rate=0.2, runs=1000)
    scenarios = [
        rs.validate.Scenario(one.fault, rs.validate.step(at=150), size=one.size.value) for one in seen.smallest
    ]
    made = rs.validate.campaign(watch, scenarios, runs=600, samples=180, seed=5, within=25, confidence=SURE)
    for case in range(len(scenarios)):
        assert 0.8 in made.detected(case)


def test_a_bank_read_by_code_and_a_ramp() -> None:
    plant = slow()
    watch = rs.Monitor(rs.design.sensor_fault_bank(plant, observer="minimal"))
    assert watch.norm_test.part_names
    shape = rs.validate.ramp(slope=0.02, at=0)
    seen = rs.decide.detectability(watch, within=60.0, miss_rate=0.2, runs=600, shape=shape)
    finite = [one for one in seen.smallest if np.isfinite(one.size.value)]
    assert finite
    later = rs.validate.ramp(slope=0.02, at=150)
    scenarios = [rs.validate.Scenario(one.fault, later, size=one.size.value) for one in finite]
    made = rs.validate.campaign(watch, scenarios, runs=300, samples=220, seed=5, within=60, confidence=SURE)
    for case in range(len(scenarios)):
        assert 0.8 in made.detected(case)


def test_mean_delays_are_those_of_the_integral_equation() -> None:
    test = rs.decide.CUSUM(shift=1.0, mean_time_between_false_alarms=1e4, form="page")
    watch = kalman(rs.Plant([[0.0]], [[1.0]], [[0.0]], dt=1).with_sensor_faults().with_noise(measurement=1.0), test)
    seen = rs.decide.detectability(watch, within=40, confidence=SURE)
    (one,) = seen.smallest
    designed = test.delay(watch.threshold, 1, shift=one.size.value)  # from sums of zero, the first sample counted
    assert one.mean_delay.low - 1 < designed - 1 < one.mean_delay.high + 1
    assert one.asymptote == pytest.approx(2 * np.log(watch.norm_test.mean_time) / one.size.value**2 - 1, rel=1e-6)


@pytest.mark.parametrize("power", [-20, 20])
def test_sizes_scale_with_units(power: int) -> None:
    scale = 2.0**power
    test = rs.decide.EWMA(mean_time_between_false_alarms=1e4)
    plain = rs.decide.detectability(kalman(static(), test), within=10, runs=200)
    plant = rs.Plant([[0.0]], [[1.0]], [[0.0], [0.0]], dt=2.0, outputs=["a", "b"])
    plant = plant.with_sensor_faults().with_noise(measurement=np.diag([0.09, 0.09 * scale**2]))
    scaled = rs.decide.detectability(kalman(plant, test), within=10, runs=200)
    a, b = (one.size.value for one in plain.smallest)
    assert [one.size.value for one in scaled.smallest] == pytest.approx([a, b * scale], rel=1e-9)


def test_a_fit_describes_coloured_heavy_tailed_residuals() -> None:
    rng = np.random.default_rng(0)
    e = rng.standard_t(4, (22_000, 2)) @ [[1.0, 0.3], [0, 0.5]]
    r = np.empty_like(e)
    now = np.zeros(2)
    for k, one in enumerate(e):
        now = r[k] = 0.8 * now + one
    test = rs.decide.CUSUM(mean_time_between_false_alarms=2000)
    watch = kalman(static(), test).fit(np.zeros((20_000, 1)), r[:20_000])
    by_fit = rs.decide.detectability(watch, within=30)
    by_data = rs.decide.detectability(watch, within=30, residuals=r[:20_000])
    assert by_fit.noise == "as the fit describes them"
    assert "resampled" in by_data.noise
    for one, other in zip(by_fit.smallest, by_data.smallest, strict=True):
        assert one.size.value == pytest.approx(other.size.value, rel=0.1)  # heavy tails beyond the data are a model
    assert not any("alarms in" in note for note in by_fit.notes)


def test_a_fault_that_no_residual_answers_to_has_no_size() -> None:
    plant = rs.Plant([[0.0]], [[1.0]], [[0.0], [0.0]], dt=2.0, outputs=["a", "b"])
    plant = plant.with_sensor_faults().with_actuator_faults().with_noise(measurement=0.09)
    seen = rs.decide.detectability(kalman(plant, rs.decide.NormThreshold(false_alarm_rate=1e-3)), runs=100)
    hidden = [one for one in seen.smallest if "actuator" in one.fault]
    assert hidden
    assert all(np.isinf(one.size.value) and np.isnan(one.mean_delay.value) for one in hidden)
    assert "∞" in str(seen)


def test_the_power_grows_with_the_size() -> None:
    seen = rs.decide.detectability(kalman(slow(), rs.decide.NormThreshold(false_alarm_rate=1e-3)), runs=300)
    for fault in ("u actuator", seen.smallest[0].fault):
        sizes, shares = seen.power(fault)
        assert (np.diff(sizes) > 0).all()
        assert (np.diff(shares) >= 0).all()
        assert shares[-1] == 1
    sizes, shares = seen.power("u actuator", within=10)
    assert np.interp(_size(seen, "u actuator", 10), sizes, shares) == pytest.approx(0.95, abs=0.02)
    assert len(seen.table().columns()["fault"]) == 15


def _size(seen: "rs.validate.Detectability", fault: str, within: float) -> float:
    return next(one.size.value for one in seen.smallest if one.fault == fault and one.within == within)


def test_a_fit_that_knows_no_memory_says_so() -> None:
    rng = np.random.default_rng(0)
    watch = kalman(static(), rs.decide.NormThreshold(false_alarm_rate=0.01, persistence=1))
    watch.fit(np.zeros((4000, 1)), 0.3 * rng.standard_normal((4000, 2)))
    seen = rs.decide.detectability(watch, within=10, runs=500, confidence=SURE)
    assert seen.noise == "white, with the covariance of the fit"
    assert "taken to be white" in seen.notes[0]
    model = rs.decide.detectability(kalman(static(), watch.test), within=10, runs=500, confidence=SURE)
    assert model.smallest[0].size.value == pytest.approx(seen.smallest[0].size.value, rel=0.1)  # of 4,000 samples


def test_residuals_that_the_threshold_is_not_for_are_said() -> None:
    watch = kalman(static(), rs.decide.CUSUM(mean_time_between_false_alarms=1e4))
    wider = 0.45 * np.random.default_rng(0).standard_normal((5000, 2))
    seen = rs.decide.detectability(watch, within=10, residuals=wider, runs=200)
    assert any("not those that the threshold is for" in note for note in seen.notes)
    assert np.isnan(seen.smallest[0].asymptote)


def test_false_alarms_as_frequent_as_detections_make_the_size_zero() -> None:
    watch = kalman(static(), rs.decide.NormThreshold(threshold=0.8, persistence=1, whiten="model"))
    seen = rs.decide.detectability(watch, within=40, runs=200)
    assert seen.smallest[0].size.value == 0
    assert seen.by_chance[0].value == 1


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"within": 0.5}, "one step"),
        ({"within": "soon"}, "one step"),
        ({"within": []}, "one step"),
        ({"miss_rate": 1.0}, "miss_rate"),
        ({"faults": ["leak"]}, "no fault 'leak'"),
        ({"faults": []}, "names none"),
        ({"faults": 3}, "names of faults"),
        ({"runs": 3}, "runs"),
        ({"shape": "step"}, "shape must"),
        ({"shape": rs.validate.stuck_at(at=3.0)}, "campaign simulates"),
        ({"residuals": np.eye(100, 3)}, "3 columns"),
        ({"residuals": np.zeros((100, 2))}, "never change"),
        ({"residuals": np.full((100, 2), np.nan)}, "must be finite"),
        ({"residuals": "x"}, "residuals must be numbers"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"within": 1e9}, "too many to hold"),
    ],
)
def test_bad_input_says_what_to_do(settings: dict[str, Any], text: str) -> None:
    watch = kalman(static(), rs.decide.NormThreshold(false_alarm_rate=1e-3))
    with pytest.raises((SettingError, DataError), match=text):
        rs.decide.detectability(watch, **settings)


def test_what_is_missing_is_said() -> None:
    observer = rs.design.luenberger_observer(
        rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1).with_sensor_faults(), poles=[0.1]
    )
    watch = rs.Monitor(observer.residual_generator())
    with pytest.raises(NotFittedError):
        rs.decide.detectability(watch)
    watch = rs.Monitor(watch.design, test=rs.decide.NormThreshold(threshold=1.0))
    with pytest.raises(SettingError, match="no noise"):
        rs.decide.detectability(watch)
    with pytest.raises(SettingError, match="takes a Monitor"):
        rs.decide.detectability(watch.design)  # pyright: ignore[reportArgumentType]


def test_few_runs_say_less() -> None:
    watch = kalman(static(), rs.decide.NormThreshold(false_alarm_rate=1e-3, persistence=1))
    seen = rs.decide.detectability(watch, within=6, runs=100, miss_rate=1e-3, faults="a sensor")
    assert np.isinf(seen.smallest[0].size.high)  # a hundred runs cannot show that one of a thousand is missed
    inside = 0
    for seed in range(40):
        (one,) = rs.decide.detectability(watch, within=6, runs=40, seed=seed, faults="a sensor").smallest

        def missed(size: float) -> float:
            return float(chndtr(watch.threshold**2, 2, (size / 0.3) ** 2)) ** 3 - 0.05

        inside += brentq(missed, 0.01, 10.0) in one.size
    assert inside >= 34  # of 40, at 95 %


def test_the_time_of_sums_and_the_unit_are_said() -> None:
    plant = rs.Plant([[0.0]], [[1.0]], [[0.0]], dt=2.0, outputs=["level"], units={"level": "m"}).with_sensor_faults()
    watch = kalman(plant.with_noise(measurement=0.09), rs.decide.NormThreshold(false_alarm_rate=1e-3, window=5))
    seen = rs.decide.detectability(watch, within=20, runs=100)
    assert "or more seldom" in str(seen)
    assert seen.table().columns()["unit"] == ["m"]
    sizes, shares = seen.power("level sensor")
    assert sizes[-1] < 100
    assert shares[-1] == 1
