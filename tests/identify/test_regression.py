"""Regression of outputs on inputs: the textbook's coefficients, residuals in their units, and what is shared."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from recorded_examples import diagnosed
from residua.errors import DataError, SettingError


@pytest.mark.parametrize("lags", [0, 2])
@pytest.mark.parametrize("seed", range(4))
def test_coefficients_are_those_of_least_squares(seed: int, lags: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((400, 2)) * [1.0, 50.0] + [3.0, -20.0]
    y = u @ rng.standard_normal((2, 3)) + np.roll(u, 1, axis=0) @ rng.standard_normal((2, 3)) + rng.random((400, 3))
    made = rs.identify.regression(u, y, lags=lags)
    X = np.hstack([np.ones((400 - lags, 1)), *(u[lags - i : 400 - i] for i in range(lags + 1))])
    expected = np.linalg.lstsq(X, y[lags:], rcond=None)[0]
    ours = made.coefficients.transpose(0, 2, 1).reshape(-1, 3)
    assert np.allclose(ours, expected[1:], rtol=1e-8, atol=1e-10)
    r = made.generator.run(None, np.hstack([u, y]) - made.mean)[lags:]
    errors = y[lags:] - X @ expected
    assert np.allclose(r - r.mean(axis=0), errors, atol=1e-8)


@pytest.mark.parametrize("scale", [2.0**-20, 2.0**20])
def test_answers_do_not_depend_on_units(scale: float) -> None:
    rng = np.random.default_rng(0)
    u = rng.standard_normal((600, 2))
    y = u @ [[1.0, 2.0], [0.5, -1.0]] + 0.1 * rng.standard_normal((600, 2))
    rows, units = np.hstack([u, y]), np.array([scale, 1, 1 / scale, scale])
    rows[550:, 2] += 1.0

    def statistic(rows: np.ndarray) -> np.ndarray:
        made = rs.identify.regression(rows[:300, :2], rows[:300, 2:])
        return diagnosed(rs.Monitor(made).fit(None, rows[300:500]), rows[500:]).statistic

    assert np.allclose(statistic(rows), statistic(rows * units), rtol=1e-9, equal_nan=True)


def test_a_sensor_that_lies_is_named() -> None:
    rng = np.random.default_rng(1)
    u = rng.standard_normal((900, 1))
    y = u @ [[1.0, 2.0, -1.0]] + 0.1 * rng.standard_normal((900, 3))
    made = rs.identify.regression(u[:400], y[:400], inputs=["valve"], outputs=["a", "b", "c"])
    monitor = rs.Monitor(made).fit(None, np.hstack([u, y])[400:700])
    y[800:, 1] += 1.0
    assert diagnosed(monitor, np.hstack([u, y])[700:]).named == (("b sensor",),)


def test_inputs_that_determine_one_another_share_their_coefficients() -> None:
    rng = np.random.default_rng(2)
    u = rng.standard_normal((300, 1))
    made = rs.identify.regression(np.hstack([u, u]), 3 * u + 0.1 * rng.standard_normal((300, 1)), inputs=["a", "b"])
    assert made.coefficients[0, 0] == pytest.approx([1.5, 1.5], abs=0.05)
    assert any("1 combination of a, b never moved" in note for note in made.generator.evidence.notes)


def test_without_inputs_it_is_the_deviation_from_the_mean() -> None:
    y = np.random.default_rng(3).random((50, 2))
    made = rs.identify.regression(None, y)
    assert np.allclose(made.generator.run(None, y - made.mean), y - y.mean(axis=0))
    assert made.explained == pytest.approx([0, 0])


def test_what_is_refused() -> None:
    rng = np.random.default_rng(4)
    with pytest.raises(DataError, match="never move"):
        rs.identify.regression(np.ones((50, 1)), rng.random((50, 1)))
    with pytest.raises(DataError, match="more than"):
        rs.identify.regression(rng.random((4, 3)), rng.random((4, 1)))
    with pytest.raises(SettingError, match="lags"):
        rs.identify.regression(rng.random((50, 1)), rng.random((50, 1)), lags=-1)
