"""How many states are hidden, and whether they die out, is the same in all units, and what exact arithmetic says."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.errors import DesignError


def chain(*couplings: float) -> np.ndarray:
    """Return a chain of integrators, the last one first."""
    return np.diag(np.array(couplings, dtype=float), 1)


def twice(A: np.ndarray) -> np.ndarray:
    """Return two copies of a system beside each other."""
    return np.kron(np.eye(2), A)


def difference(C: list[list[float]]) -> np.ndarray:
    """Return outputs that are differences of those of two copies."""
    return np.hstack([np.array(C, dtype=float), -np.array(C, dtype=float)])


_LONG = chain(0, 1, 1, 2, 1, 2, 1, 1)
_LONG[0, -1] = -128
_WITH_A_LAG = chain(192, 64, 64, 128) + np.diag([0, 0, 0, 0, 0.5])
_SLOW = 2.0**-7
_HIDDEN_FAST = [
    [0, _SLOW, 0, 0, 0, _SLOW],
    [-_SLOW, -_SLOW, 0, 0, 512, -_SLOW],
    [0, -_SLOW, 0, 256, 0, -_SLOW],
    [-256, 0, -256, 0, 0, 0],
    [-512, 0, 0, 0, 0, 512],
    [0, _SLOW, 0, 0, -512, _SLOW],
]
_EQUAL_FAST = [
    [0, 512, 512, -512 - _SLOW, 0, -512],
    [-512, 0, -512, 0, -512, 0],
    [0, 0, 0, _SLOW, 0, 0],
    [0, 0, -_SLOW, 0, 0, 0],
    [0, 0, -512, 512, 0, 512],
    [0, 0, _SLOW, _SLOW, -512, 0],
]
_SLOW_LAGS = chain(0, 0.02, 0.02, 0.02, 0.02, 0.04) + np.diag([-300, *[-0.02] * 6])
_SLOW_LAGS[[1, 3, 4, 5], 0] = [-1, -2, 2, -2]
_SLOW_LAGS[2, 1] = -0.02
_SLOW_LAGS[3, 2], _SLOW_LAGS[3, 5], _SLOW_LAGS[4, 6] = 0.02, 0.02, -0.04
_LONG_LAGS = chain(0, *[1] * 7) + np.diag([-100, *[-0.001] * 8])
_LONG_LAGS[1:, 0] = 0.5
#: A pair with the number of its hidden states and whether all of these die out, in exact arithmetic.
PAIRS = {
    "two integrators behind seven": (_LONG / 64, [[0, 0, -2, 2, 0, 0, 0, 0, 0]], 2, False),
    "a chain read at its end": (chain(64, 128, 192, 64, 64, 128, 192), [[1, 3, 3, -2, 0, 0, 0, 0]], 0, True),
    "two chains and a lag": (twice(_WITH_A_LAG), difference([[2, -2, 0, 0, 0], [2, -3, 0, 0, 1]]), 5, False),
    "a hidden fast oscillator": (_HIDDEN_FAST, [[3, 0, 3, 1, 0, 0], [-1, 2, 1, -1, 0, 2]], 2, False),
    "two chains of integrators": (twice(chain(192, 64) * 2.0**18), difference([[0, 0, 2], [-3, 0, 0]]), 3, False),
    "hidden lags on one slow pole": (_LONG_LAGS, [[1, 0, 0, 0, 0, 0, 0, 0, 0]], 8, True),
    "slow lags behind a fast one": (_SLOW_LAGS, [[1, 0, 0, 0, 0, 0, 0]], 6, True),
    "two equal fast oscillators": (_EQUAL_FAST, [[0, -1, -2, 1, 0, 2]], 2, False),
}


def units_of(seed: int, n: int, p: int, powers: float) -> tuple[np.ndarray, np.ndarray]:
    """Return units of states and outputs."""
    rng = np.random.default_rng(seed)
    most = 20 if powers == 2 else 6
    return powers ** rng.integers(-most, most + 1, n), powers ** rng.integers(-most, most + 1, p)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("rate", [1.0, 2.0**-20, 2.0**17])
@pytest.mark.parametrize("name", PAIRS)
def test_hidden_states_in_all_units(name: str, rate: float, seed: int) -> None:
    A, C, hidden, die_out = PAIRS[name]
    A, C = np.array(A, dtype=float), np.array(C, dtype=float)
    x, y = units_of(seed, len(A), len(C), 2.0 if seed % 2 else 10.0)
    found = rs.linear.detectability(rate * A / x[:, None] * x, C * x / y[:, None])
    assert (len(found.unobservable_modes), found.detectable) == (hidden, die_out) or found.near


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["a hidden fast oscillator", "two equal fast oscillators"])
def test_hidden_oscillators_in_other_coordinates(name: str, seed: int) -> None:
    """Where every entry is rounded."""
    A, C, hidden, _ = PAIRS[name]
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(A), len(A))))[0]
    found = rs.linear.detectability(Q.T @ A @ Q, C @ Q)
    assert len(found.unobservable_modes) == hidden or found.near


@pytest.mark.parametrize("seed", range(20))
def test_weak_couplings_are_real_where_nothing_is_rounded_to_their_size(seed: int) -> None:
    """A cascade of oscillators that slow ones couple: all of it is seen."""
    rng = np.random.default_rng(seed)
    rates = 2.0 ** rng.integers(-10, 11, 4)
    A = np.kron(np.diag(rates), [[0, 1], [-1, 0]]) + np.kron(np.diag(rates[1:] / 4, 1), [[0, 0], [1, 0]])
    C = np.eye(1, 8)
    assert rs.linear.observability_form(A, C).n_observable == 8


@pytest.mark.parametrize("chained", [0.0, 1.0])
def test_a_mode_far_slower_than_the_others_does_not_die_out(chained: float) -> None:
    """For analysis and designs alike; where nothing else has a rate it is as fast as any."""
    A = np.diag([-1.0, -2.0, -1e-18, -1e-18]) + chained * np.diag([0.0, 0.0, 1.0], 1)
    C = np.array([[1.0, 1.0, 0.0, 0.0]])
    assert not rs.linear.detectability(A, C)
    with pytest.raises(DesignError, match="not detectable"):
        rs.linear.place_observer_margin(A, C, 1.0)
    alone = A[2:, 2:], np.array([[0.0, 0.0]])
    assert rs.linear.detectability(*alone)
    assert rs.linear.place_observer_margin(*alone, 1e-20).fixed.size == 2


def equal_lags(back: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a pair in turned coordinates with eight hidden lags in a chain, of rate 0.01, fed back from its end."""
    A = np.zeros((10, 10))
    A[:2, :2] = [[-1, 0.5], [0.25, -2]]
    A[2:, 2:] = chain(*[1] * 7) - 0.01 * np.eye(8)
    A[9, 2] = back
    C = np.eye(2, 10)
    Q = np.linalg.qr(np.random.default_rng(seed).normal(size=A.shape))[0]
    return Q @ A @ Q.T, C @ Q.T


@pytest.mark.parametrize(("back", "seed"), [*((0.0, seed) for seed in range(6)), (1e-13, 0)])
def test_hidden_lags_of_which_rounding_may_have_made_unstable_ones_are_no_fact(back: float, seed: int) -> None:
    found = rs.linear.detectability(*equal_lags(back, seed))
    assert len(found.unobservable_modes) == 8
    assert found.detectable or found.undecided


def test_hidden_lags_that_feedback_makes_unstable_are_a_fact() -> None:
    found = rs.linear.detectability(*equal_lags(1e-10, 0))
    assert not found
    assert not found.undecided


@pytest.mark.parametrize("residue", [2.0**-56, 0.1 * 3 - 0.3])
def test_what_rounding_leaves_of_zero_couplings_does_not_show_a_hidden_double_mode(residue: float) -> None:
    """Of so few digits it looked exact: the modes of two states were said to be those of none, and none unstable."""
    A = np.array([[-3.0, -3, 0, -residue], [0, -2, 0, 0], [residue, 0, 1, 1], [residue, -residue, -1, -1]])
    form = rs.linear.observability_form(A, [[2.0, -2.0, 0.0, 0.0]])
    assert form.n_observable == 2
    np.testing.assert_allclose(form.unobservable_modes, [0, 0], atol=1e-7)
    assert not rs.linear.detectability(A, [[2.0, -2.0, 0.0, 0.0]])
