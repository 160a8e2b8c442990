"""Likelihood: probabilities that are right as often as they say, exact p-values, the same in pieces and other units."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, kstest

import residua as rs
from residua.decide.alarm import Alarm, Candidate
from residua.decide.likelihood import FaultFilter, fit_p_value, moving, pair_p_value, word_by_probability
from residua.decide.stream_test import plain
from residua.design import ResidualGenerator
from residua.errors import FileFormatError, SettingError
from residua.monitor import Diagnosis, Monitor
from residua.testing import check_isolation

CUSUM, Likelihood = rs.decide.CUSUM, rs.decide.Likelihood
LINES = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.0, 0.3, np.sqrt(1 - 0.09)]])


def filter_of(coefficients: np.ndarray, rate: float = 4e-3) -> FaultFilter:
    left = np.cumsum(np.concatenate([np.eye(3)[None], -coefficients]), axis=0)
    return FaultFilter(np.einsum("gk,akm->gam", LINES, left), left, np.full(4, rate), 300.0, 1.0, 12)


def drawn(made: FaultFilter, rng: np.random.Generator, runs: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """White residuals with faults drawn from the prior, and which fault is there at the end; the last is none."""
    e, last = rng.standard_normal((runs, samples, 3)), np.full(runs, 4)
    for r in range(runs):
        now, age, step = 4, 0, np.zeros(3)
        for t in range(samples):
            if now == 4:
                draw = rng.random() / made.rates[0]
                if draw < 4:
                    now, age = int(draw), 0
                    step = rng.standard_normal(3) if now == 3 else rng.standard_normal() * LINES[now]
            elif rng.random() < 1 / made.duration:
                now = 4
            if now < 4:
                e[r, t] += step @ made.unknown[min(age, len(made.unknown) - 1)]
                age += 1
        last[r] = now
    return e, last


@pytest.mark.parametrize("poles", [(), (0.9, 0.5, 0.0)], ids=["white", "with memory"])
def test_of_cases_of_a_probability_so_many_are_right(poles: tuple[float, ...]) -> None:
    """Faults, sizes, arrivals and ends drawn from the prior; each bin within a binomial interval of 99.9 %."""
    made = filter_of(np.diag(poles)[None] if poles else np.zeros((0, 3, 3)))
    e, last = drawn(made, np.random.default_rng(1), 1500, 60)
    _, probability = made.run(made.start(len(e)), e, np.ones(e.shape[:2], dtype=bool))
    at, right = probability[:, -1], last[:, None] == np.arange(5)
    assert np.allclose(at.sum(axis=1), 1.0)
    edges = [0.0, 0.02, 0.1, 0.3, 0.6, 0.8, 0.95, 1.01]
    judged = 0
    for low, high in pairwise(edges):
        here = (at >= low) & (at < high)
        if here.sum() >= 50:
            judged += 1
            low_count, high_count = binom.interval(0.999, int(here.sum()), float(at[here].mean()))
            assert low_count <= right[here].sum() <= high_count, (low, high)
    assert judged >= 5


def test_the_evidence_is_that_of_a_gaussian() -> None:
    """One fault that cannot end: the ratio of the densities of all samples, with the size integrated out, by age."""
    from scipy.stats import multivariate_normal

    rng = np.random.default_rng(2)
    made = FaultFilter(LINES[:1, None], np.eye(3)[None], np.array([0.01, 1e-12]), 1e12, 0.7, 10)
    e = rng.standard_normal((1, 6, 3)) + 0.5 * LINES[0]
    _, out = made.run(made.start(1), e, np.ones((1, 6), dtype=bool))
    weights = []
    for age in range(1, 7):
        H = np.tile(LINES[0], age)[:, None]
        rows = e[0, 6 - age :].ravel()
        ratio = multivariate_normal(cov=np.eye(3 * age) + 0.7**2 * H @ H.T).logpdf(rows)
        ratio -= multivariate_normal(cov=np.eye(3 * age)).logpdf(rows)
        weights.append(0.99 ** (6 - age) * 0.01 * np.exp(ratio))
    assert out[0, -1, 0] == pytest.approx(sum(weights) / (sum(weights) + 0.99**6), rel=1e-6)


def test_p_values_are_uniform_where_their_fault_is_there() -> None:
    rng = np.random.default_rng(3)
    z = rng.standard_normal((3000, 3)) + rng.normal(0, 5, (3000, 1)) * LINES[0]
    assert kstest([fit_p_value(one, LINES[0]) for one in z], "uniform").pvalue > 1e-3
    assert kstest([pair_p_value(one, LINES[0], LINES[1]) for one in z], "uniform").pvalue > 1e-3
    assert fit_p_value(z[0, :1], np.ones(1)) is None


# ----------------------------------------------------------------- in a monitor


def generator(scales: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> ResidualGenerator:
    """Innovations of a small plant, in other units: of the input and both outputs."""
    su, *sy = scales
    C = np.diag(sy)
    plant = rs.Plant([[0.8, 0.1], [0.0, 0.6]], np.array([[0.2], [0.4]]) / su, C, dt=1.0, outputs=["y1", "y2"])
    plant = plant.with_sensor_faults()
    return rs.design.kalman_filter(plant.with_noise(process=1e-3, measurement=list(1e-2 * np.array(sy) ** 2)))


def run_of(monitor: Monitor, u: np.ndarray, y: np.ndarray) -> Diagnosis:
    diagnosis = monitor.run(u, y)
    assert isinstance(diagnosis, Diagnosis)
    return diagnosis


def recording(rng: np.random.Generator, samples: int, step: tuple[float, float] = (0.0, 0.0)) -> tuple:
    u, x, y = rng.standard_normal((samples, 1)), np.zeros(2), np.empty((samples, 2))
    for k in range(samples):
        y[k] = x + 0.1 * rng.standard_normal(2) + np.array(step) * (k >= samples // 2)
        x = np.array([[0.8, 0.1], [0.0, 0.6]]) @ x + np.array([0.2, 0.4]) * u[k] + 0.0316 * rng.standard_normal(2)
    return u, y


@pytest.mark.parametrize("test", [rs.decide.GLR(window=10), rs.decide.ChiSquared()], ids=lambda t: t.kind)
def test_what_a_monitor_asks_of_an_isolation(test: rs.decide.TestSettings) -> None:
    """The same bits in pieces, for many plants, and after saving."""
    check_isolation(Likelihood(window=6, prior_rates=1e-3), test=test)


def test_probabilities_are_shown_and_saved(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    monitor = rs.Monitor(
        generator(), test=rs.decide.GLR(window=10), isolate=Likelihood(prior_rates={"y2 sensor": 1e-3})
    )
    monitor.fit(*recording(rng, 4000))
    monitor.save(tmp_path / "m.json")
    monitor = rs.Monitor.load(tmp_path / "m.json")
    diagnosis = run_of(monitor, *recording(rng, 300, (0.0, 0.4)))
    alarm = diagnosis.alarms[-1]
    best, other = alarm.candidates
    assert best.faults == ("y2 sensor",)
    assert best.probability is not None
    assert best.probability > 0.5
    assert sum(c.probability or 0.0 for c in alarm.candidates) + (alarm.unknown or 0) + (alarm.no_fault or 0) == (
        pytest.approx(1.0)
    )
    assert other.pair_p_value is not None
    assert other.pair_p_value < 1e-3
    assert best.pair_p_value is None
    assert "probability" in str(diagnosis)
    entry = json.loads(json.dumps(alarm.to_dict()))["candidates"][0]
    assert entry["probability"] == best.probability
    assert entry["p_value"] == best.p_value
    diagnosis.to_html(tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Probability" in page
    assert "p against the first" in page


def sensors(angle: float) -> ResidualGenerator:
    """Two white residuals, and two faults whose directions are an angle apart."""
    plant = rs.Plant([[0.0]], [[0.0]], np.zeros((2, 1)), dt=1.0)
    plant = plant.with_faults({"a": ([0.0], [1.0, 0.0]), "b": ([0.0], [np.cos(angle), np.sin(angle)])})
    return rs.design.kalman_filter(plant.with_noise(process=1e-6, measurement=1.0))


def test_what_cannot_be_told_apart_is_said_with_a_number() -> None:
    monitor = rs.Monitor(sensors(0.05), test=CUSUM(), isolate=Likelihood(window=20))
    y = np.random.default_rng(8).standard_normal((120, 2))
    y[100:, 0] += 1.5
    diagnosis = run_of(monitor, np.zeros((120, 1)), y)
    first, second = diagnosis.alarms[-1].candidates
    assert second.pair_p_value is not None
    assert second.pair_p_value > 0.05
    assert f"not distinguishable here: {first.name}, {second.name} (p = " in str(diagnosis)
    apart = rs.Monitor(sensors(1.2), test=CUSUM(), isolate=Likelihood(window=20)).run(np.zeros((120, 1)), y)
    assert "not distinguishable" not in str(apart)


def test_parallel_directions_are_one_group() -> None:
    isolation = rs.Monitor(sensors(0.0), test=CUSUM(), isolate=Likelihood())._specification().isolation
    assert isolation.groups == (tuple(sensors(0.0).faults),)
    assert isolation.rates.tolist() == pytest.approx([2e-4, 1e-4])  # pyright: ignore


@pytest.mark.parametrize("power", [-20, -7, 20])
def test_units_change_nothing(power: int) -> None:
    def probabilities(scales: tuple[float, float, float]) -> np.ndarray:
        monitor = rs.Monitor(generator(scales), test=rs.decide.ChiSquared(), isolate=Likelihood(window=8))
        rng = np.random.default_rng(6)
        su, *sy = scales
        u, y = recording(rng, 1000)
        monitor.fit(u * su, y * np.array(sy))
        u, y = recording(rng, 200, (0.3, 0.0))
        return run_of(monitor, u * su, y * np.array(sy)).scores

    plain_one, scaled = probabilities((1.0, 1.0, 1.0)), probabilities((2.0**power, 1.0, 2.0**-power))
    np.testing.assert_allclose(scaled, plain_one, rtol=1e-6)


def test_steps_with_a_memory_and_missing_values_are_those_of_a_run(tmp_path: Path) -> None:
    """To the last bit, saved and loaded in between; the residual is coloured."""
    rng = np.random.default_rng(1)

    def coloured(samples: int, step: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        y = 0.1 * lfilter([1], [1, -0.9], rng.standard_normal((samples, 2)), axis=0)
        y[samples // 2 :, 0] += step
        return np.zeros((samples, 1)), y

    monitor = rs.Monitor(generator(), test=rs.decide.GLR(window=10), isolate=Likelihood(window=8))
    monitor.fit(*coloured(4000))
    assert monitor.norm_test.coefficients.size  # pyright: ignore
    u, y = coloured(200, 3.0)
    y[[20, 110, 111]] = np.nan
    diagnosis, named = run_of(monitor, u, y), 0
    monitor.reset()
    for k in range(len(y)):
        if k % 60 == 0:
            monitor.save(tmp_path / "m.json")
            monitor = rs.Monitor.load(tmp_path / "m.json")
        decision = monitor.step(u[k], y[k])
        by_name = {c.faults: c.probability for c in decision.candidates}
        if by_name:
            named += 1
            assert [by_name[group] for group in diagnosis.groups] == diagnosis.scores[k].tolist()
    assert named > 80
    assert decision.candidates == diagnosis.alarms[-1].candidates


def test_copies_of_residuals_do_not_count() -> None:
    W = rs.decide.whitening_matrix(np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    test = CUSUM().test(**plain(np.zeros(3), W), threshold=5.0, release=0.0, basis="")
    assert moving(test).sum() == 2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Likelihood(prior_rates=0.0), "between 0 and 1"),
        (lambda: Likelihood(prior_rates=-1e-3), "between 0 and 1"),
        (lambda: Likelihood(prior_rates={"y1 sensor": 1.0}), "y1 sensor"),
        (lambda: Likelihood(unknown_rate=2.0), "unknown"),
        (lambda: Likelihood(mean_duration=0.5), "above 1"),
        (lambda: Likelihood(window=1), "at least 2"),
        (lambda: Likelihood(size=0.0), "positive"),
        (lambda: rs.Monitor(generator(), test=CUSUM(), isolate=Likelihood(prior_rates={"pump": 1e-3})), "pump"),
        (lambda: rs.Monitor(generator(), test=CUSUM(), isolate=Likelihood(prior_rates=0.6)), "below 1 together"),
        (lambda: rs.Monitor(generator(), test=rs.decide.NormThreshold(), isolate=Likelihood()), "CUSUM"),
    ],
)
def test_bad_settings(make: Callable[[], object], words: str) -> None:
    with pytest.raises(SettingError, match=words):
        make()


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    monitor = rs.Monitor(generator(), test=CUSUM(), isolate=Likelihood(window=5, prior_rates={"y1 sensor": 1e-3}))
    monitor.save(tmp_path / "m.json")
    text = (tmp_path / "m.json").read_text(encoding="utf-8")
    refused = 0
    for old, new in (
        ('"mean_duration": 10000.0', '"mean_duration": 0.5'),
        ('"y1 sensor": 0.001', '"y1 sensor": 1.5'),
        ('"y1 sensor": 0.001', '"y1 sensor": "often"'),
        ('"duration": 10000.0', '"duration": 1.0'),
        ('"size": 1.0', '"size": -1.0'),
    ):
        damaged = text.replace(old, new) if old in text else text.replace(old.replace(": ", ":"), new)
        assert damaged != text, old
        (tmp_path / "d.json").write_text(damaged, encoding="utf-8")
        with pytest.raises(FileFormatError):
            rs.Monitor.load(tmp_path / "d.json")
        refused += 1
    assert refused == 5


def test_the_margin_of_an_alarm_is_that_of_probabilities() -> None:
    plant = (
        rs.Plant([[0.5]], [[1.0]], [[1.0], [0.5]], dt=1).with_sensor_faults().with_noise(process=1e-2, measurement=1e-2)
    )
    watch = rs.Monitor(rs.design.kalman_filter(plant), isolate=rs.decide.Likelihood(), test=rs.decide.CUSUM())
    y = 0.1 * np.random.default_rng(0).standard_normal((200, 2))
    y[100:, 0] += 0.5
    alarm = watch.run(np.zeros((200, 1)), y).alarms[-1]
    first, second = alarm.candidates[:2]
    assert first.probability is not None
    assert second.probability is not None
    assert alarm.margin == alarm.to_dict()["margin"] == first.probability - second.probability


@pytest.mark.parametrize(
    ("probabilities", "unknown", "none", "p", "line"),
    [
        ((0.98, 0.01), 0.005, 0.005, 0.4, "a, a good match by its probability"),
        ((0.6, 0.38), 0.01, 0.01, 0.4, "either a or b"),
        ((0.6, 0.2), 0.19, 0.01, 0.4, "either a, b or something not listed"),
        ((0.98, 0.01), 0.005, 0.005, 0.02, "either a or something not listed"),
        ((0.98, 0.01), 0.005, 0.005, 1e-4, "a poor match: no listed fault alone explains the residual"),
        ((0.3, 0.01), 0.68, 0.01, 0.4, "a poor match: the probability of one that is not listed is 0.68; nearest is a"),
        ((0.8, 0.01), 0.01, 0.18, 0.4, "too early to be sure of the name, for the probability that there is no fault"),
    ],
)
def test_probabilities_have_one_of_four_words(
    probabilities: tuple[float, float], unknown: float, none: float, p: float, line: str
) -> None:
    made = tuple(
        Candidate((name,), 0.9, 0.4, probability=probability, p_value=p)
        for name, probability in zip("ab", probabilities, strict=True)
    )
    word = word_by_probability(Alarm(0.0, 0.0, None, made, 0, 30, unknown=unknown, no_fault=none))
    assert word.line.startswith(line)
