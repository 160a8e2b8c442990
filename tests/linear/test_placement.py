"""Observer gains reach what was asked for, in any multiplicity and any units, or say why not."""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.io
import scipy.linalg

from guards import trips
from residua.errors import AccuracyError, DesignError, ModelError
from residua.linear import detectability
from residua.linear.poles.placement import default_margin, place_observer_margin, place_observer_poles
from residua.linear.poles.spectrum import balanced_rate


def pair(seed, n, p, k=None, dt=0.0, units=False):
    """A pair with ``k`` observable states of ``n`` and stable hidden modes."""
    rng = np.random.default_rng(seed)
    k = n if k is None else k
    A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
    A *= 2 / np.abs(np.linalg.eigvals(A)).max()
    if k < n:
        A[:k, k:] = 0
        C[:, k:] = 0
        A[k:, k:] -= (np.linalg.eigvals(A[k:, k:]).real.max() + 0.3) * np.eye(n - k)
        T = np.linalg.qr(rng.normal(size=(n, n)))[0]
        A, C = T @ A @ T.T, C @ T.T
    if dt:
        A = scipy.linalg.expm(A * dt)
    if units:
        s = 10.0 ** rng.uniform(-5, 5, n)
        A, C = A * s[:, None] / s, C / s * 10.0 ** rng.uniform(-5, 5, (p, 1))
    return A, C


def wanted_poles(kind, k, dt):
    pair_of = np.array([-1 + 1j, -1 - 1j])
    s = {
        "distinct": -1 - 0.7 * np.arange(k) + 0j,
        "same": np.full(k, -2 + 0j),
        "pairs": np.concatenate([np.kron(1 + 0.5 * np.arange(k // 2), pair_of), [-1.5] * (k % 2)]),
        "same pairs": np.concatenate([np.tile(pair_of, k // 2), [-1.5] * (k % 2)]),
    }[kind]
    return np.exp(dt * s) if dt else s


@pytest.mark.parametrize("units", [False, True])
@pytest.mark.parametrize("dt", [0, 0.1])
@pytest.mark.parametrize("kind", ["distinct", "same", "pairs", "same pairs"])
@pytest.mark.parametrize(("n", "p", "k"), [(1, 1, 1), (3, 1, 3), (5, 2, 5), (6, 2, 4), (6, 3, 6), (4, 4, 4), (3, 5, 3)])
def test_characteristic_polynomial_is_the_one_asked_for(n, p, k, kind, dt, units):
    A, C = pair(n * 10 + p, n, p, k, dt)
    poles = wanted_poles(kind, k, dt)
    placed = place_observer_poles(A, C, poles, dt=dt)
    whole = np.linalg.eigvals(A - placed.gain @ C)
    wanted = np.concatenate([poles, placed.fixed])
    assert placed.fixed.size == n - k
    # Coefficients are well conditioned where multiple poles are not.
    np.testing.assert_allclose(np.poly(whole), np.poly(wanted).real, atol=1e-7 * np.abs(np.poly(wanted)).max())
    if units:
        A, C = pair(n * 10 + p, n, p, k, dt, units=True)
        assert place_observer_poles(A, C, poles, dt=dt).error < 1e-6


def test_equal_poles_with_every_state_seen_give_a_multiple_of_the_identity():
    A, C = pair(1, 4, 6)
    placed = place_observer_poles(A, C, [-3.0] * 4)
    np.testing.assert_allclose(A - placed.gain @ C, -3 * np.eye(4), atol=1e-12)
    assert placed.condition < 10  # that of the rounding around it


def test_the_condition_is_that_of_the_eigenvectors_of_the_closed_loop():
    A, C = np.diag([-1.0, -2.0]) + np.eye(2, k=1), np.array([[1.0, 0.0]])
    placed = place_observer_poles(A, C, [-3.0, -3.001])
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(placed.block)), [-3.001, -3.0], rtol=1e-9)
    assert placed.condition == np.linalg.cond(np.linalg.eig(placed.block)[1]) > 1e3
    assert place_observer_poles(A, np.zeros((1, 2)), []).condition == 1.0  # nothing to place


@pytest.mark.parametrize("n", [3, 4])
def test_gain_ignores_left_null_directions_of_the_outputs(n):
    A, C = pair(2, n, 2)
    C = np.vstack([C, 2 * C[0] - C[1], [0.0] * n, C[1]])
    for placed in (place_observer_poles(A, C, -1.0 - np.arange(n)), place_observer_margin(A, C, 1.0)):
        np.testing.assert_allclose(placed.gain @ C @ np.linalg.pinv(C), placed.gain, atol=1e-10 * placed.norm)


def test_fixed_modes_may_be_named_and_must_be_when_all_poles_are_given():
    A = np.diag([1.0, 2.0, -5.0])
    C = np.array([[1.0, 1.0, 0.0]])
    placed = place_observer_poles(A, C, [-1, -5, -2])
    np.testing.assert_allclose(placed.requested, [-1, -2])
    np.testing.assert_allclose(placed.fixed, [-5])
    np.testing.assert_allclose(placed.achieved, [-1, -2], rtol=1e-9)
    with pytest.raises(DesignError, match=r"-5.*give the 2 poles"):
        place_observer_poles(A, C, [-1, -2, -3])
    with pytest.raises(DesignError, match="got 1 pole for 3 states, of which 2"):
        place_observer_poles(A, C, [-1])


@pytest.mark.parametrize(
    ("poles", "dt", "error", "message"),
    [
        ([-1, 1], 0, DesignError, "pole 1 is not stable"),
        ([0, -1], 0, DesignError, "pole 0 is not stable"),
        ([-0.5, -1.0], 0.1, DesignError, "pole -1 is not stable"),
        ([-1 + 1j, -1], 0, ModelError, r"pole -1\+1j is given without"),
        ([-1 - 1j, -1], 0, ModelError, "pole -1-1j is given without"),
        ([-1, np.nan], 0, ModelError, "not finite"),
    ],
)
def test_bad_poles_are_named(poles, dt, error, message):
    with pytest.raises(error, match=message):
        place_observer_poles(np.eye(2, k=1), [[1.0, 0.0]], poles, dt=dt)


@pytest.mark.parametrize(
    "call", [lambda A, C: place_observer_poles(A, C, [-1]), lambda A, C: place_observer_margin(A, C, 1)]
)
def test_unstable_hidden_mode_is_refused(call):
    with pytest.raises(DesignError, match=r"not detectable: mode 0\.5 "):
        call(np.diag([-1.0, 0.5]), np.array([[1.0, 0.0]]))


@trips("linear.poles.pole_assignment:assigned_gain")
def test_hopeless_request_is_not_answered_in_silence():
    rng = np.random.default_rng(0)
    with pytest.raises(AccuracyError, match=r"cannot be placed.*error"):
        place_observer_poles(rng.normal(size=(26, 26)), rng.normal(size=(1, 26)), -1 - 0.1 * np.arange(26))


@pytest.mark.parametrize("dt", [0, 0.1])
@pytest.mark.parametrize("seed", range(30))
def test_margin_is_kept_by_every_observable_pole(seed, dt):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 16)), int(rng.integers(1, 4))
    k = int(rng.integers(1, n + 1))
    A, C = pair(seed, n, p, k, dt)
    margin = float(rng.uniform(0.1, 3))
    if seed == 29:  # nine steps of one output amplify rounding to 2e-11
        assert detectability(A, C, dt=dt).near
        return
    placed = place_observer_margin(A, C, margin, dt=dt)
    assert placed.achieved.size == k
    assert placed.fixed.size == n - k
    rate = -np.log(np.abs(placed.achieved)) / dt if dt else -placed.achieved.real
    assert rate.min() > margin
    assert np.all(np.abs(np.linalg.eigvals(A - placed.gain @ C)) < 1) or not dt


def test_nothing_observable_leaves_nothing_to_place():
    A, C = -np.eye(2), np.zeros((1, 2))
    for placed in (place_observer_poles(A, C, []), place_observer_poles(A, C, [-1, -1]), place_observer_margin(A, C)):
        assert not placed.gain.any()
        assert placed.gain.shape == (2, 1)


def test_default_margin():
    assert default_margin(np.diag([-1.0, -4.0, 0.0])) == pytest.approx(2)
    assert default_margin(scipy.linalg.expm(0.01 * np.diag([-1.0, -4.0])), 0.01) == pytest.approx(2)
    assert default_margin(np.zeros((2, 2))) == 1
    assert default_margin(np.zeros((0, 0))) == 1
    assert default_margin(np.diag([0.0, 1.0]), 0.1) == pytest.approx(1)


def test_integrators_that_rounding_has_moved_have_no_rate():
    S = np.random.default_rng(0).normal(size=(5, 5))
    for chain in range(2, 6):  # with a pole at -2 beside it for all but the last
        M = np.diag(np.ones(chain - 1), 1)
        A = np.linalg.solve(S, scipy.linalg.block_diag(M, -2 * np.eye(5 - chain)) @ S)
        assert balanced_rate(A, sampled=False) == pytest.approx(2 if chain < 5 else 1)
    assert balanced_rate(A + np.eye(5), sampled=True) == pytest.approx(0.1)


def test_margin_on_slicot_benchmarks(shared_data):
    """Every benchmark but one gets its margin."""
    folder = shared_data / "slicot_benchmarks"
    reached = 0
    for entry in json.loads((folder / "index.json").read_text()):
        if entry["n"] > 60:
            continue
        data = scipy.io.loadmat(folder / f"{entry['name']}.mat")
        A, C, E = (np.atleast_2d(data[key]).astype(float) for key in "ACE")
        A = np.linalg.solve(E, A)
        dt = 1.0 if entry["discrete"] else 0.0
        if entry["name"] == "BD01_1_09":  # 55 states, 2 outputs: out of reach, and said so
            with pytest.raises(AccuracyError, match="55 observable states"):
                place_observer_margin(A, C, 0.5 * default_margin(A, dt), dt=dt)
            continue
        placed = place_observer_margin(A, C, 0.5 * default_margin(A, dt), dt=dt)
        rate = -np.log(np.maximum(np.abs(placed.achieved), 1e-300)) if dt else -placed.achieved.real
        assert rate.min(initial=np.inf) > 0.5 * default_margin(A, dt), entry["name"]
        reached += 1
    assert reached == 32


def test_a_state_that_one_output_tells_hears_no_others() -> None:
    """All states are seen; the third stands apart, and only the fourth output tells it: 16 digits left 1e-8 of others.

    Of the combinations of outputs one hardly reads a state, by 1e-5 of what another reads.
    """
    A = np.array([[0, 2.0**-5, 0, 0], [0, 1024, 0, 0], [0, 0, -2048, 0], [-0.125, 0, 0, 0]])
    C = np.array([[-3.0, 0, 1, -3], [-2, 3, 3, -2], [0, 2, 1, 3], [0, 0, -3, 0]])
    placed = place_observer_poles(A, C, [-1000, -1100, -1200, -3000])
    assert not np.any(placed.gain[2, :3])
    assert np.all(placed.gain[[0, 0, 3, 3], [0, 1, 0, 2]])
