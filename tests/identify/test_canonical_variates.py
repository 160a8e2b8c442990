"""Canonical variates: correlations by an independent computation, states chosen, innovations white; refusals."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from recorded_examples import recorded
from residua.errors import DataError, SettingError


@pytest.mark.parametrize("seed", range(6))
def test_states_and_residuals_are_those_of_textbooks(seed: int) -> None:
    """By matrix roots of covariances; T2 of all variates together is the distance of the past."""
    one = recorded(seed, 0.3, 1200, outputs=2)
    lags, m = 3, one.u.shape[1]
    made = rs.identify.canonical_variates(one.u, one.y, lags=lags, states=2, residuals="variates")
    z = (one.rows - one.rows.mean(axis=0)) / one.rows.std(axis=0, ddof=1)
    N = len(z)
    times = range(lags - 1, N - lags)
    past = np.array([np.concatenate([z[k - i] for i in range(lags)]) for k in times])
    future = np.array([np.concatenate([z[k + 1 + i, m:] for i in range(lags)]) for k in times])
    joint = np.cov(np.hstack([past, future]).T)
    d = past.shape[1]
    root = np.linalg.inv(scipy.linalg.sqrtm(joint[:d, :d]).real)
    U, s, _ = np.linalg.svd(root @ joint[:d, d:] @ np.linalg.inv(scipy.linalg.sqrtm(joint[d:, d:]).real))
    assert np.allclose(made.correlations, s, atol=1e-8)
    variates = np.array([np.concatenate([z[k - i] for i in range(lags)]) for k in range(lags - 1, N)]) @ root @ U
    r = made.generator.run(None, one.rows - made.mean)[lags - 1 :]
    assert np.allclose((r[:, :2] ** 2).sum(axis=1), (variates[:, :2] ** 2).sum(axis=1), rtol=1e-6)
    assert np.allclose((r[:, 2:] ** 2).sum(axis=1), (variates[:, 2:] ** 2).sum(axis=1), rtol=1e-6)
    assert tuple(map(len, made.groups.values())) == (2, d - 2)


@pytest.mark.parametrize("seed", range(6))
def test_innovations_are_the_rest_of_a_regression_on_states_and_inputs(seed: int) -> None:
    one = recorded(seed, 0.3, 1500, outputs=2)
    made = rs.identify.canonical_variates(
        one.u, one.y, lags=4, states=2, inputs=one.plant.inputs, outputs=one.plant.outputs
    )
    r = made.generator.run(None, one.rows - made.mean)
    states, e = r[:-1, :2][10:], r[1:, 2:][10:]
    assert np.abs(e.T @ states / len(e)).max() < 0.02  # uncorrelated on all rows but the ten at the start
    assert np.abs(e.T @ one.u[11:] / len(e)).max() < 0.02
    assert np.allclose(np.cov(e.T), np.eye(2), atol=0.05)


def test_as_many_states_as_the_plant_has() -> None:
    """With noise of one per cent, of plants of which the noise hides nothing."""
    right = 0
    for seed in range(20):
        one = recorded(seed, 0.01, 4000, outputs=3)
        right += rs.identify.canonical_variates(one.u, one.y).states >= one.plant.n_states
    assert right >= 19


def test_the_criterion_is_least_at_what_was_chosen() -> None:
    one = recorded(4, 0.1, 2000, outputs=2)
    made = rs.identify.canonical_variates(one.u, one.y)
    assert made.lags == min(made.criterion_of_lags, key=lambda k: made.criterion_of_lags[k])
    assert made.states == min(made.criterion_of_states, key=lambda k: made.criterion_of_states[k])
    assert len(made.criterion_of_lags) == 20


def test_a_channel_that_is_there_twice_is_refused_by_name() -> None:
    one = recorded(4, 0.3, 2000, outputs=2)
    rows = np.hstack([one.y, one.y[:, :1]])
    with pytest.raises(DataError, match=r"is singular .*: a, again determine one another"):
        rs.identify.canonical_variates(rows, outputs=["a", "b", "again"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"lags": 0}, "lags must be a whole number, at least 1"),
        ({"lags": "some"}, "lags must be a whole number"),
        ({"states": 0}, "states must be a whole number"),
        ({"lags": 1, "states": 50}, "ask for that many states at most"),
        ({"residuals": "all"}, "must be 'innovations' or 'variates'"),
    ],
)
def test_bad_settings_are_refused(options: dict[str, object], said: str) -> None:
    one = recorded(2, 0.1, 500, outputs=2)
    with pytest.raises(SettingError, match=said):
        rs.identify.canonical_variates(one.u, one.y, **options)  # pyright: ignore
