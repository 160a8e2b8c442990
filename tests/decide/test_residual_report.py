"""What residuals really are: each finding is as rare as it says where there is nothing, and is made where there is."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

import residua as rs
from effort import cases
from residua.decide.residual_findings import LEVEL, ResidualReport, findings_of
from residua.errors import DataError, SettingError

SEEDS = 200


def report_of(x: np.ndarray, *, white: bool = True, seams: tuple[int, ...] = ()) -> ResidualReport:
    """Of residuals that are white with unit variance by the noise model."""
    columns = x.shape[1]
    run = rs.decide.FaultFreeRun(x, np.ones(len(x), bool), seams, np.ones(columns))
    names = [f"r{i}" for i in range(columns)]
    return findings_of(run, names, covariance=np.eye(columns), white=white)


@pytest.mark.parametrize("size", cases([(300, 2), (150, 1), (400, 3), (2000, 2), (2000, 6)], 1))
def test_white_gaussian_residuals_have_findings_as_rarely_as_said(size: tuple[int, int]) -> None:
    """Of 200 runs in 99 of 100 series no kind is found more often than so."""
    found: Counter[str] = Counter()
    for seed in range(SEEDS):
        found.update({one.kind for one in report_of(np.random.default_rng(seed).standard_normal(size)).findings})
    most = stats.binom.ppf(0.9985, SEEDS, LEVEL)  # any of seven kinds
    assert max(found.values(), default=0) <= most, found


def noise(kind: str, rng: np.random.Generator, rows: int = 3000) -> np.ndarray:
    e = rng.standard_normal((rows + 1, 2))
    loud = np.repeat(np.where(rng.uniform(size=rows // 50) < 0.3, 3.0, 0.6), 50)[:, None]
    late = (np.arange(rows) > rows // 2)[:, None]
    return {
        "memory": lambda: lfilter([1.0], [1.0, -0.3], e[1:], axis=0) * np.sqrt(1 - 0.09),
        "cross memory": lambda: np.column_stack([e[1:, 0], 0.5 * e[:-1, 0] + np.sqrt(0.75) * e[1:, 1]]),
        "tails": lambda: rng.standard_t(4, (rows, 2)) / np.sqrt(2),
        "light tails": lambda: rng.uniform(-np.sqrt(3), np.sqrt(3), (rows, 2)),
        "skewness": lambda: (rng.gamma(4, size=(rows, 2)) - 4) / 2,
        "quantised": lambda: np.round(2 * e[1:]) / 2,
        "bursts": lambda: e[1:] * loud / np.sqrt(np.mean(loud**2)),
        "drift": lambda: e[1:] + 1.0 * late,
        "offset": lambda: e[1:] + 0.3,
        "variance": lambda: 1.2 * e[1:],
        "copies": lambda: np.hstack([e[1:], e[1:] @ [[0.6], [0.8]]]),
    }[kind]()


@pytest.mark.parametrize(
    ("kind", "also"),
    [
        ("memory", set()),
        ("cross memory", set()),
        ("tails", {"variance"}),
        ("light tails", set()),
        ("skewness", {"tails"}),
        ("quantised", set()),
        ("bursts", {"tails", "variance"}),
        ("drift", {"offset"}),
        ("offset", set()),
        ("variance", set()),
        ("copies", set()),
    ],
)
def test_data_that_have_it_trip_a_finding_and_no_other(kind: str, also: set[str]) -> None:
    """In each of five runs; one of the others may be there by chance."""
    wanted = kind.removeprefix("cross ")
    others = 0
    for seed in range(5):
        report = report_of(noise(kind, np.random.default_rng(seed)))
        found = {one.kind for one in report.findings}
        assert wanted in found
        assert wanted in str(report)
        assert report.recommendations
        others += len(found - {wanted} - also)
    assert others <= 1


def test_lag_and_size_of_a_memory_are_said_and_the_order_that_explains_it() -> None:
    rng = np.random.default_rng(1)
    x = lfilter([1.0], [1.0, 0, 0, -0.6], rng.standard_normal((5000, 1)), axis=0) * 0.8
    report = report_of(x)
    (one,) = report.residuals
    assert one.lag == 3
    assert one.correlation == pytest.approx(0.6, abs=0.05)
    assert one.order in (3, 4)  # Akaike's criterion takes one too many now and then
    assert "r0 +0.6" in str(report.found("memory"))
    assert f"autoregression of order {one.order}" in report.recommendations[-1]
    assert "by the noise model they are white" in str(report)
    assert "by the noise model they do so too" in str(report_of(x, white=False))


def test_moments_are_those_of_scipy_and_the_tail_that_of_the_distribution() -> None:
    x = np.random.default_rng(2).standard_t(4, (20_000, 1)) / np.sqrt(2)
    (one,) = report_of(x).residuals
    assert one.skewness == pytest.approx(stats.skew(x[:, 0]), rel=1e-9)
    assert one.kurtosis == pytest.approx(stats.kurtosis(x[:, 0], fisher=False), rel=1e-9)
    assert one.tail == pytest.approx(0.25, abs=3 * one.tail_error)
    assert one.tail_error < 0.1
    assert one.mean == x.mean()
    assert one.deviation == pytest.approx(x.std(), rel=1e-12)


def test_a_drift_is_not_taken_for_memory_too() -> None:
    rng = np.random.default_rng(3)
    x = rng.standard_normal((4000, 2))
    x[2500:] += 1.5
    report = report_of(x)
    assert report.found("memory") is None
    assert report.found("variance") is None
    assert report.changes[0].sample == pytest.approx(2500, abs=20)
    assert "PageHinkley" in " ".join(report.recommendations)


def test_units_change_nothing() -> None:
    rng = np.random.default_rng(4)
    x = np.column_stack([lfilter([1.0], [1.0, -0.5], rng.standard_normal(2000)), rng.standard_t(4, 2000)])
    powers = 2.0 ** np.array([-20, 20])
    run = [rs.decide.FaultFreeRun(x * by, np.ones(2000, bool), (), by * np.ones(2)) for by in (np.ones(2), powers)]
    one, other = (findings_of(part, ["a", "b"], covariance=np.diag(by**2)) for part, by in
                  zip(run, (np.ones(2), powers), strict=True))  # fmt: skip
    assert [f.kind for f in one.findings] == [f.kind for f in other.findings]
    for a, b, by in zip(one.residuals, other.residuals, powers, strict=True):
        assert b.deviation == pytest.approx(by * a.deviation, rel=1e-12)
        assert b.whiteness == pytest.approx(a.whiteness, rel=1e-6, abs=1e-300)
        assert b.kurtosis == pytest.approx(a.kurtosis, rel=1e-6)


def level_plant() -> rs.Plant:
    plant = rs.Plant(
        [[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"], units={"level": "m"}
    )  # fmt: skip
    return plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)


def recording(rng: np.random.Generator, samples: int, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    x, y = 0.0, np.empty((samples, 1))
    for k in range(samples):
        y[k] = x + noise * rng.standard_normal()
        x = 0.9 * x + 0.01 * rng.standard_normal()
    return np.zeros((samples, 1)), y


def test_a_report_takes_what_a_fit_takes(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    flt = rs.design.kalman_filter(level_plant())
    u, y = recording(rng, 3000)
    plain = rs.decide.residual_report(flt, u, y)
    assert plain.findings == ()
    assert "as the noise model says" in str(plain)
    path = tmp_path / "log.csv"
    rows = np.column_stack([np.arange(3000.0), u, y])
    np.savetxt(path, rows, delimiter=",", header="time,valve,level", comments="", fmt="%.17g")
    monitor = rs.Monitor(flt)
    for other in (
        rs.decide.residual_report(flt, path),
        rs.decide.residual_report(flt, rs.read_recording(path, level_plant())),
        rs.decide.residual_report(monitor, u, y),
    ):
        assert other.to_dict() == plain.to_dict()
    several = rs.decide.residual_report(flt, [recording(rng, 800), recording(rng, 900)], transient=20)
    assert several.recordings == 2
    assert "of 2 recordings" in str(several)
    assert several.samples <= 1660
    assert json.loads(json.dumps(plain.to_dict())) == plain.to_dict()
    (row,) = plain.table()
    assert row["unit"] == "m"
    assert row["expected"] == pytest.approx(row["deviation"], rel=0.05)


def test_a_wrong_noise_model_is_found_with_factor_and_unit() -> None:
    flt = rs.design.kalman_filter(level_plant())
    report = rs.decide.residual_report(flt, *recording(np.random.default_rng(6), 3000, noise=0.2))
    found = report.found("variance")
    assert "times of r level (0.2" in found.text
    assert " m, not 0.10" in found.text
    assert "with_noise" in " ".join(report.recommendations)


def test_the_report_changes_no_monitor() -> None:
    rng = np.random.default_rng(7)
    monitor = rs.Monitor(rs.design.kalman_filter(level_plant())).fit(*recording(rng, 1000))
    before = monitor.norm_test
    rs.decide.residual_report(monitor, *recording(rng, 500))
    assert monitor.norm_test is before


def test_what_cannot_be_is_refused() -> None:
    flt = rs.design.kalman_filter(level_plant())
    u, y = recording(np.random.default_rng(8), 200)
    with pytest.raises(DataError, match="too few"):
        rs.decide.residual_report(flt, u[:25], y[:25])
    given, moving = rs.identify.given_residuals(["r"], dt=1.0), 5.0 + 1e-15 * np.arange(200)[:, None]
    with pytest.raises(DataError, match="hold no noise"):
        rs.decide.residual_report(given, None, moving)
    with pytest.raises(SettingError, match="transient must be a whole number"):
        rs.decide.residual_report(flt, u, y, transient=-1)


def test_few_samples_recommend_nothing() -> None:
    given = rs.identify.given_residuals(["r"], dt=1.0)
    rng = np.random.default_rng(0)
    report = rs.decide.residual_report(given, None, rng.standard_normal((80, 1)))
    assert not report.findings
    assert "show little" in report.recommendations[-1]
    assert (
        "designed test holds"
        in rs.decide.residual_report(given, None, rng.standard_normal((800, 1))).recommendations[-1]
    )
