"""Principal components: T2 and Q by the formulas of textbooks, the number of components, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from recorded_examples import diagnosed, recorded
from residua.errors import DataError, SettingError


def stacked(rows: NDArray[np.float64], lags: int) -> NDArray[np.float64]:
    return np.hstack([rows[lags - lag : len(rows) - lag] for lag in range(lags + 1)])


def statistics(made: rs.identify.PrincipalComponents, rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the sum of squares of each group of residuals."""
    r = made.generator.run(None, rows - made.mean)[made.lags :]
    place = {name: i for i, name in enumerate(made.generator.residuals)}
    return {group: (r[:, [place[name] for name in names]] ** 2).sum(axis=1) for group, names in made.groups.items()}


@pytest.mark.parametrize("lags", [0, 1, 3])
@pytest.mark.parametrize("seed", range(5))
def test_both_statistics_are_those_of_textbooks(seed: int, lags: int) -> None:
    """By the eigenvectors of the sample correlation matrix, which nothing of the package computes."""
    one = recorded(seed, 0.3, 800, outputs=3)
    made = rs.identify.principal_components(one.u, one.y, lags=lags, components=3)
    z = (one.rows - one.rows.mean(axis=0)) / one.rows.std(axis=0, ddof=1)
    x = stacked(z, lags)
    values, vectors = np.linalg.eigh(np.cov(x.T))
    P, L = vectors[:, ::-1][:, :3], values[::-1][:3]
    scores = x @ P
    ours = statistics(made, one.rows)
    assert np.allclose(ours["T2"], (scores**2 / L).sum(axis=1), rtol=1e-8)
    assert np.allclose(ours["Q"], ((x - scores @ P.T) ** 2).sum(axis=1), rtol=1e-8, atol=1e-10)
    assert np.allclose(made.variances, values[::-1], atol=1e-10)


def test_a_monitor_tests_both_as_they_are() -> None:
    one = recorded(1, 0.3, 2000, outputs=3)
    made = rs.identify.principal_components(one.rows, components=2)
    monitor = rs.Monitor(made).fit(None, one.rows)
    out = diagnosed(monitor, one.rows)
    ours, judged = statistics(made, one.rows), out.decided
    assert tuple(out.parts.residuals) == ("T2", "Q")
    for k, group in enumerate(("T2", "Q")):
        # a monitor takes the mean of the rows that it is fitted to off, here that of the rows without the first
        assert np.allclose(out.parts.statistics[judged, k] ** 2, ours[group][judged], rtol=0.02, atol=0.05)


def test_components_by_number_by_share_and_by_chance() -> None:
    rng = np.random.default_rng(0)
    loads = rng.standard_normal((3000, 2))
    rows = loads @ rng.standard_normal((2, 8)) + 0.2 * rng.standard_normal((3000, 8))
    assert rs.identify.principal_components(rows).components == 2
    assert rs.identify.principal_components(rows, components=5).components == 5
    made = rs.identify.principal_components(rows, components=0.8)
    assert made.explained >= 0.8 > made.variances[: made.components - 1].sum() / 8
    assert tuple(rs.identify.principal_components(rows, components=8).groups) == ("T2",)


def test_a_channel_that_is_there_twice_is_said_and_does_no_harm() -> None:
    one = recorded(1, 0.3, 2000, outputs=2)
    rows = np.hstack([one.y, one.y[:, :1]])
    made = rs.identify.principal_components(rows, outputs=["a", "b", "again"])
    note = next(note for note in made.generator.evidence.notes if "determine one another" in note)
    assert "a, again" in note
    assert "b," not in note
    with pytest.raises(SettingError, match="only 2 of 3 components move at all"):
        rs.identify.principal_components(rows, components=3)


@pytest.mark.parametrize("components", [0, -1, 99, 1.0, 1.5, 0.0, True, "many", float("nan")])
def test_bad_numbers_of_components_are_refused(components: object) -> None:
    one = recorded(1, 0.3, 300)
    with pytest.raises(SettingError, match="components must be a whole number from 1 to"):
        rs.identify.principal_components(one.rows, components=components)  # pyright: ignore


def test_few_rows_are_refused_or_said() -> None:
    one = recorded(1, 0.3, 60, outputs=3)
    q = one.rows.shape[1]
    with pytest.raises(DataError, match=f"make {q} rows of {2 * q} columns .* but more than {2 * q + 1} are needed"):
        rs.identify.principal_components(one.rows[: q + 1], lags=1)
    with pytest.raises(DataError, match=f"8 rows for {q} columns .* at least {3 * q} are needed, and {10 * q} for"):
        rs.identify.principal_components(one.rows[:8])
    notes = rs.identify.principal_components(one.rows, lags=2).generator.evidence.notes
    assert any("the covariance is known badly" in note for note in notes)
