"""One-step predictions of an identified model: the recursion written out, the report, gaps, delays and units."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.errors import DataError

#: Rounding of a recursion over a few hundred rows, relative to the size of the signals.
ROUNDING = 1e-10


def log(rows: int, seed: int, delay: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    plant = rs.Plant([[0.9, 0.2], [0.0, 0.7]], [[0.0], [1.0]], np.eye(2), dt=1.0)
    plant = plant.with_noise(process=0.01, measurement=0.04)
    u = np.repeat(rng.standard_normal((rows // 5 + 1, 1)), 5, axis=0)[:rows]
    late = np.vstack([np.zeros((delay, 1)), u[: rows - delay]])
    states = rs.StateSpace(plant.A, np.eye(2), np.eye(2), np.zeros((2, 2)), dt=1.0)
    y = states.simulate(late @ plant.B.T + 0.1 * rng.standard_normal((rows, 2)))
    return u + 5.0, y + [20.0, -3.0] + 0.2 * rng.standard_normal((rows, 2))


@pytest.fixture(scope="module")
def model() -> rs.identify.IdentifiedModel:
    return rs.identify.subspace(*log(4000, 0), order=2)


def test_predictions_obey_the_recursion(model: rs.identify.IdentifiedModel) -> None:
    u, y = log(300, 1)
    [seen] = model.predict(u, y)
    plant, K, past = model.plant, model.gain, model.report.past
    assert np.isnan(seen.predicted[:past]).all()
    assert np.isfinite(seen.predicted[past:]).all()
    du, dy = u - plant.operating_point.inputs, y - plant.operating_point.outputs
    # two outputs of two states: the state is read from the prediction itself
    x = np.linalg.solve(plant.C, seen.predicted[past] - plant.operating_point.outputs)
    for k in range(past, 300):
        expected = plant.C @ x + plant.operating_point.outputs
        assert np.abs(seen.predicted[k] - expected).max() < ROUNDING * np.abs(y).max()
        x = plant.A @ x + plant.B @ du[k] + K @ (dy[k] - plant.C @ x)


def test_gaps_start_anew_and_recordings_stay_apart(model: rs.identify.IdentifiedModel) -> None:
    u, y = log(300, 2)
    y[100, 0] = np.nan
    first, second = model.predict([(u, y), (u[101:], y[101:])])
    past = model.report.past
    assert np.isnan(first.predicted[100 : 101 + past]).all()
    assert np.isnan(first.measured[100]).all()
    assert np.array_equal(first.predicted[101:], second.predicted, equal_nan=True)


@pytest.mark.parametrize("delay", [0, 4])
@pytest.mark.parametrize("identify", [rs.identify.subspace, rs.identify.arx])
def test_errors_are_those_of_the_report_and_delays_are_in_the_plant(identify, delay: int) -> None:
    u, y = log(3000, 3, delay)
    model = identify(u, y, order=2, delays={"u1": delay})
    [seen] = model.predict(u, y)
    rms = np.sqrt(np.nanmean(seen.error[2250:] ** 2, axis=0))
    assert np.allclose(rms, model.report.held_out.error, rtol=0.01)  # its state starts anew where rows are held out


@pytest.mark.parametrize("exponent", [-20, 20])
def test_predictions_do_not_depend_on_units(exponent: int) -> None:
    u, y = log(2000, 0)
    units = np.array([2.0**exponent, 2.0 ** (exponent // 2)])
    plain = rs.identify.subspace(u, y, order=2)
    scaled = rs.identify.subspace(2.0**-exponent * u, units * y, order=2)
    [one], [other] = plain.predict(u, y), scaled.predict(2.0**-exponent * u, units * y)
    assert np.allclose(one.predicted, other.predicted / units, rtol=ROUNDING, atol=ROUNDING, equal_nan=True)


def test_other_recordings_are_refused(model: rs.identify.IdentifiedModel) -> None:
    u, y = log(300, 2)
    with pytest.raises(DataError, match="expected 3 names, got 2"):
        model.predict(u, np.hstack([y, y[:, :1]]))
    short = model.predict(u[:3], y[:3])[0]
    assert np.isnan(short.predicted).all()
