"""Variances that borrow from one another: the promise by simulation, the limits, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student

import residua as rs
from residua.decide import moderated_variances

RESIDUALS = 4000


def _drawn(rng: np.random.Generator, prior: float, prior_freedom: float, freedom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the true and the estimated variance of many residuals."""
    true = (
        np.full(RESIDUALS, prior)
        if np.isinf(prior_freedom)
        else prior * prior_freedom / rng.chisquare(prior_freedom, RESIDUALS)
    )
    return true, true * rng.chisquare(freedom, RESIDUALS) / freedom


@pytest.mark.parametrize("prior_freedom", [2.0, 6.0, np.inf])
@pytest.mark.parametrize("freedom", [2, 5])
def test_a_new_observation_has_students_distribution(prior_freedom: float, freedom: int) -> None:
    """Beyond the limit of one in a hundred lies one in a hundred; with each variance alone the limit is far wider."""
    rng = np.random.default_rng(3)
    beyond = np.zeros(0, dtype=bool)
    for _ in range(10):
        true, estimated = _drawn(rng, 0.3, prior_freedom, freedom)
        made = moderated_variances(estimated, np.full(RESIDUALS, freedom))
        new = rng.standard_normal(RESIDUALS) * np.sqrt(true)
        beyond = np.append(beyond, new > student.ppf(0.99, made.freedom) * np.sqrt(made.variances))
        assert made.prior == pytest.approx(0.3, rel=0.15)
    assert beyond.mean() == pytest.approx(0.01, abs=4 * np.sqrt(0.01 / len(beyond)))
    assert np.median(student.ppf(0.999, made.freedom)) < 0.9 * student.ppf(0.999, freedom)


def test_a_residual_without_observations_gets_the_common_value() -> None:
    """It counts for as much as the prior, and no more."""
    rng = np.random.default_rng(1)
    made = moderated_variances(np.append(rng.chisquare(3, 40) / 3 / rng.chisquare(4, 40), 7.0), [*[3] * 40, 0])
    assert made.variances[-1] == made.prior
    assert made.freedom[-1] == pytest.approx(made.prior_freedom)


def test_the_unit_that_all_share_is_no_matter() -> None:
    """Variances scale by its square, freedom stays."""
    rng = np.random.default_rng(2)
    variances, freedom = rng.chisquare(3, 30) * np.exp(rng.standard_normal(30)), np.full(30, 3)
    one, other = moderated_variances(variances, freedom), moderated_variances(variances * 2.0**20, freedom)
    np.testing.assert_allclose(other.variances, one.variances * 2.0**20, rtol=1e-12)
    np.testing.assert_allclose(other.freedom, one.freedom, rtol=1e-9)


@pytest.mark.parametrize(
    ("variances", "freedom", "said"),
    [
        ([1.0, 2.0], [1.0], "one entry per residual"),
        ([1.0, 2.0], [1.0, -1.0], "zero or more"),
        ([1.0, 2.0], [1.0, np.nan], "zero or more"),
        ([1.0, 2.0], [3.0, 0.0], "it takes two"),
        ([1.0, 0.0], [3.0, 3.0], "finite and positive"),
        ([1.0, np.inf], [3.0, 3.0], "finite and positive"),
    ],
)
def test_what_is_no_variance_is_refused(variances: list[float], freedom: list[float], said: str) -> None:
    """Shapes, freedom, and values."""
    with pytest.raises(rs.errors.DataError, match=said):
        moderated_variances(variances, freedom)
