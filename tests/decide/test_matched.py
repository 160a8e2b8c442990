"""The matched test: least squares as oracle, calibrated sizes and thresholds, missing samples, holding."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy import stats

import residua as rs
from generated import random_plant
from residua.decide.matched import Matched, matched_test
from residua.decide.matched_level import level_for_rate
from residua.decide.matched_recursion import HeldState, MatchedTest, empty_match, hold_block, match_block, summed
from residua.decide.window import empty_window, moving_sum
from residua.design.banks.matched_filters import matched_filters
from residua.errors import SettingError


def made_for(plant: rs.Plant, window: int, *, steady: bool = False) -> MatchedTest:
    matched = matched_filters(plant, window=window)
    return matched_test(Matched(window, steady), plant.faults, matched.responses, matched.settled, matched.whitening)


def found_by(test: MatchedTest, q: np.ndarray, usable: np.ndarray) -> dict[str, np.ndarray]:
    """Return likelihood ratios and the rest on whitened residuals of (plants, time, residuals)."""
    q = np.where(usable[..., None], q, 0.0)
    sums, _ = moving_sum(summed(q, usable), empty_window(len(q), test.samples, q.shape[2] + 2))
    return match_block(test, empty_match(test, len(q)), q, usable, sums)[0]


def gertler() -> rs.Plant:
    return rs.library.gertler(sensor_faults=True).with_noise(process=0.01, measurement=0.1)


@pytest.mark.parametrize("seed", range(8))
def test_least_squares_over_all_arrivals_is_the_same(seed: int) -> None:
    """Every hypothesis fitted on its own by least squares, to the usable samples: the best one is found."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, sensors=True, dt=0.1).with_noise(process=0.05, measurement=0.1)
    window = 12
    test = made_for(plant, window)
    n, m = 50, plant.n_outputs
    q, usable = rng.standard_normal((1, n, m)), rng.random((1, n)) > 0.2
    found = found_by(test, q, usable)
    for t in (3, 20, 49):
        for j in range(len(plant.faults)):
            best = (0.0, -1, np.nan, np.inf)
            for age in (*range(window + 1), -1):
                rho = np.zeros((n, m))
                if age >= 0:
                    rows = range(max(0, t - age), t + 1)
                    rho[rows] = [test.responses[k - t + age, :, j] for k in rows]
                else:
                    rho[max(0, t - window) : t + 1] = test.settled[:, j]
                rho = np.where(usable[0, :, None], rho, 0.0).ravel()
                if not rho.any():
                    continue
                data = np.where(usable[0, :, None], q[0], 0.0).ravel()
                (size,), _, *_ = np.linalg.lstsq(rho[:, None], data, rcond=None)
                gain = float(data @ data - np.sum((data - rho * size) ** 2))
                if gain > best[0] * (1 + 1e-9):
                    best = (gain, age, size, 1 / np.linalg.norm(rho))
            assert found["ratios"][0, t, j] == pytest.approx(best[0], rel=1e-9, abs=1e-12)
            assert found["ages"][0, t, j] == best[1]
            assert found["sizes"][0, t, j] == pytest.approx(best[2], rel=1e-8)
            assert found["deviations"][0, t, j] == pytest.approx(best[3], rel=1e-8)


def test_generalised_least_squares_on_the_raw_outputs_says_the_same() -> None:
    """No Kalman filter at all: the outputs of a plant at rest, with their full covariance over all samples."""
    plant = gertler()
    n, arrival, window = 130, 100, 40
    noise, fault = plant.system("noise"), plant.system("fault")
    X = scipy.linalg.solve_discrete_lyapunov(noise.A, noise.B @ noise.B.T)
    p, powers = plant.n_outputs, [np.linalg.matrix_power(noise.A, k) for k in range(n)]
    lags = [noise.C @ X @ noise.C.T + noise.D @ noise.D.T]
    step = noise.A @ X @ noise.C.T + noise.B @ noise.D.T
    lags += [noise.C @ powers[k - 1] @ step for k in range(1, n)]
    covariance = np.block([[lags[i - j] if i >= j else lags[j - i].T for j in range(n)] for i in range(n)])
    rng = np.random.default_rng(1)
    y = (np.linalg.cholesky(covariance) @ rng.standard_normal(n * p)).reshape(n, p)
    expected = np.zeros((len(plant.faults), n, p))
    for j in range(len(plant.faults)):
        f = np.zeros((n, len(plant.faults)))
        f[arrival:, j] = 1.0
        expected[j] = fault.simulate(f)
    y = y + 0.6 * expected[2]
    weight = np.linalg.inv(covariance)
    matched = matched_filters(plant, window=window)
    r = matched.generator.run(np.zeros((n, 1)), y)
    test = made_for(plant, window)
    q = (r @ matched.whitening)[None]
    state, usable = empty_match(test, 1), np.ones((1, n), dtype=bool)
    sums, _ = moving_sum(summed(q, usable), empty_window(1, test.samples, p + 2))
    _, state = match_block(test, state, q, usable, sums)
    age = n - 1 - arrival
    for j in range(len(plant.faults)):
        h = expected[j].ravel()
        size, deviation = (h @ weight @ y.ravel()) / (h @ weight @ h), (h @ weight @ h) ** -0.5
        assert state.sums[0, age, j] / state.weights[0, age, j] == pytest.approx(size, rel=1e-6, abs=1e-9)
        assert state.weights[0, age, j] ** -0.5 == pytest.approx(deviation, rel=1e-6)


@pytest.mark.parametrize(("steady", "rate"), [(False, 1e-2), (False, 1e-3), (True, 1e-2)])
def test_the_threshold_bounds_the_false_alarm_rate_and_is_sharper_than_bonferroni(steady: bool, rate: float) -> None:
    """On white noise; the bound may be exceeded by chance, by three standard errors."""
    rng = np.random.default_rng(0)
    for seed in range(2):
        plant = random_plant(np.random.default_rng(seed), sensors=True, dt=0.1)
        test = made_for(plant.with_noise(process=0.05, measurement=0.1), 30, steady=steady)
        level = level_for_rate(test, rate)
        hypotheses = len(test.faults) * (1 if steady else 32)
        assert level <= stats.norm.isf(rate / 2 / hypotheses) + 1e-9
        plants, window = 2000, 30
        q = rng.standard_normal((plants, 5 * (window + 1), plant.n_outputs))
        usable = np.ones(q.shape[:2], dtype=bool)
        largest = np.sqrt(found_by(test, q, usable)["ratios"].max(axis=2))
        apart = largest[:, window :: window + 1]  # windows without a sample in common
        over = np.count_nonzero(apart > level)
        assert over <= rate * apart.size + 3 * np.sqrt(rate * apart.size)
        assert over >= 0.2 * rate * apart.size, "the bound has lost its sense"


def test_a_single_hypothesis_gets_the_normal_quantile() -> None:
    plant = rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1.0).with_actuator_faults().with_noise(process=0.1, measurement=0.1)
    assert level_for_rate(made_for(plant, 10, steady=True), 1e-3) == pytest.approx(stats.norm.isf(5e-4), rel=1e-9)


def test_missing_samples_carry_no_information_and_what_was_known_stays() -> None:
    """A gap halfway: arrivals before it stay hypotheses, and the deviation is that of the samples there were."""
    test = made_for(gertler(), 30)
    rng = np.random.default_rng(2)
    q = rng.standard_normal((1, 60, 2))
    for k in range(30):
        q[0, 30 + k] += 3.0 * test.responses[min(k, 30), :, 1]
    usable = np.ones((1, 60), dtype=bool)
    usable[0, 36:46] = False
    q[0, 36:46] = np.nan
    found = found_by(test, q, usable)
    assert found["ages"][0, 50, 1] == 20
    kept = [k for k in range(21) if not 6 <= k < 16]
    assert found["deviations"][0, 50, 1] == pytest.approx(np.sum(test.responses[kept, :, 1] ** 2) ** -0.5)
    assert abs(found["sizes"][0, 50, 1] - 3.0) < 4 * found["deviations"][0, 50, 1]
    np.testing.assert_array_equal(found["ratios"][0, 45] > 20, found["ratios"][0, 35] > 20)


def test_arrival_and_fault_are_held_once_the_window_has_passed_them() -> None:
    test = made_for(gertler(), 20)
    n = 200
    q = np.zeros((1, n, 2))
    for t in range(50, 150):
        q[0, t] = 8.0 * (test.responses[t - 50, :, 0] if t - 50 <= 20 else test.settled[:, 0])
    q += np.random.default_rng(3).standard_normal(q.shape)
    usable = np.ones((1, n), dtype=bool)
    sums, _ = moving_sum(summed(q, usable), empty_window(1, test.samples, 4))
    found, _ = match_block(test, empty_match(test, 1), q, usable, sums)
    over = np.sqrt(found["ratios"].max(axis=2)) > 5
    match, _ = hold_block(test.window, HeldState.empty(1), found, over, over, 0)
    alarm = over[0, :150]
    assert not alarm[:50].any()
    assert alarm[55:].all()
    assert (match.arrival[0, 60:150] == 50).all()
    assert (match.fault[0, 60:150] == 0).all()
    assert (match.source[0, 75:150] == 70).all()
    assert (match.fault[0, :50] == -1).all()
    assert np.isnan(match.arrival[0, :50]).all()
    assert (found["ages"][0, 90:149, 0] == -1).mean() > 0.5, "it is the settled response that is seen later"


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"window": 0}, "window"), ({"window": 1.5}, "window"), ({"alike": 0}, "alike"), ({"steady": 1}, "steady")],
)
def test_settings_that_make_no_sense_are_refused(settings: dict, words: str) -> None:
    with pytest.raises(SettingError, match=words):
        Matched(**settings)


def test_the_bound_is_exact_for_two_hypotheses() -> None:
    """A tree of two covers everything: the level is that of the bivariate normal distribution."""
    test = made_for(gertler(), 10, steady=True)
    pair = MatchedTest(10, ("p1", "p2"), (("p1",), ("p2",)), test.responses[..., :2], test.settled[:, :2], ())
    a, b = pair.settled.T
    r = float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    level = level_for_rate(pair, 0.01)
    normal = stats.multivariate_normal(cov=[[1, r], [r, 1]], seed=0)  # pyright: ignore[reportArgumentType]
    inside = normal.cdf([level, level], lower_limit=[-level, -level])
    assert 0.2 < abs(r) < 0.9
    assert 1 - inside == pytest.approx(0.01, rel=1e-3)


def test_an_alarm_is_put_down_to_the_same_fault_however_time_is_cut() -> None:
    """Random likelihoods, alarms and arrivals, some after the alarm was raised: at once and sample by sample."""
    rng = np.random.default_rng(0)
    for _ in range(400):
        length = 12
        alarm = np.repeat(rng.random(length // 3) < 0.7, 3)[None]
        over = rng.random((1, length)) < 0.6
        ratios, ages = rng.exponential(30, (1, length, 2)), rng.integers(-1, 6, (1, length, 2))
        ends = []
        for cuts in ([length], [1] * length):
            state, parts, done = HeldState.empty(1), [], 0
            for size in cuts:
                part = slice(done, done + size)
                names = ("ratios", "sizes", "deviations", "settled_sizes")
                likelihoods = dict.fromkeys(names, ratios[:, part]) | {"ages": ages[:, part]}
                match, state = hold_block(5, state, likelihoods, alarm[:, part], over[:, part], done)
                done += size
                state.check("state", 2, 5, done)
                parts.append(
                    np.stack([match.fault[0], np.nan_to_num(match.arrival[0], nan=-9), match.source[0]], axis=1)
                )
            ends.append(np.concatenate(parts))
        np.testing.assert_array_equal(*ends)
