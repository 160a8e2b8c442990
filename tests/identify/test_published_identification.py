"""A laboratory recording that others identified: no worse than the model they published, and of a sensible order.

The hair dryer (a heater's voltage, the temperature at the outlet, 1,000 rows at 0.08 s) is the example of SLICOT's
routine IB01BD, whose published matrices and Kalman gain are from all of it. SLICOT is under BSD-3-Clause.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pytest

import residua as rs

A = np.array(
    [
        [0.8924, 0.3887, 0.1285, 0.1716],
        [-0.0837, 0.6186, -0.6273, -0.4582],
        [0.0052, 0.1307, 0.6685, -0.6755],
        [0.0055, 0.0734, -0.2148, 0.4788],
    ]
)
B, D = np.array([[-0.2142], [-0.1968], [0.0525], [0.0361]]), np.array([[-0.0041]])
C, K = np.array([[-0.4442, 0.6663, 0.3961, 0.4102]]), np.array([[-1.9513], [-0.1867], [0.6348], [-0.3486]])
SETTLED = 60  # rows after which the state at the start no longer matters
Method = Literal["pbsid", "cva", "n4sid", "moesp"]
METHODS = get_args(Method)


@pytest.fixture(scope="module")
def dryer() -> tuple[np.ndarray, np.ndarray]:
    data = np.loadtxt(Path(__file__).parent / "hair_dryer.csv", delimiter=",", skiprows=1)
    assert data.shape == (1000, 2)
    return data[:, :1], data[:, 1:]


def published_error(u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the errors of one-step predictions by the published matrices."""
    predictor = rs.StateSpace(A - K @ C, np.hstack([B - K @ D, K]), C, np.hstack([D, [[0.0]]]), dt=1.0)
    return (y - predictor.simulate(np.hstack([u, y])))[:, 0]


def test_the_recording_is_the_published_one(dryer: tuple[np.ndarray, np.ndarray]) -> None:
    """Its variance of the innovations is given as 0.0012; four digits of the matrices leave 0.0014."""
    assert np.var(published_error(*dryer)[SETTLED:]) == pytest.approx(0.0014, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_no_worse_than_the_published_model_of_the_same_order(
    method: Method, dryer: tuple[np.ndarray, np.ndarray]
) -> None:
    theirs = published_error(*dryer)
    options: dict[str, Any] = {"order": 4, "past": 15, "method": method, "dt": 0.08, "feedthrough": True}
    whole = rs.identify.subspace(*dryer, **options, held_out=0)
    [seen] = whole.predict(*dryer)
    assert np.std(seen.error[SETTLED:]) < 1.005 * np.std(theirs[SETTLED:])
    assert whole.innovation_covariance[0, 0] == pytest.approx(0.0012, abs=1.1e-4)
    # and from three quarters of it on the last, which theirs has seen
    [unseen] = rs.identify.subspace(*dryer, **options).predict(*dryer)
    assert np.std(unseen.error[750:]) < 1.03 * np.std(theirs[750:])


@pytest.mark.parametrize("method", METHODS)
def test_the_order_is_that_from_which_on_nothing_is_gained(
    method: Method, dryer: tuple[np.ndarray, np.ndarray]
) -> None:
    """The leading combination of the past alone predicts the next row well, and is no model of a slow plant."""
    report = rs.identify.subspace(*dryer, method=method, dt=0.08).report
    assert report.order in (4, 5)
    assert report.held_out_errors[report.order] < 1.03 * np.nanmin(report.held_out_errors)
    assert not report.coloured
