"""The pieces of grey-box estimation, each against another way to the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize

import residua as rs
from residua.errors import DesignError
from residua.identify.grey_box import identifiability, sandwich_covariance
from residua.identify.prediction_errors import prediction_errors, predictor, weights_of
from residua.linear.poles.riccati import filter_riccati

#: Two solvers of one Riccati equation, relative to the size of each entry's row and column.
RICCATI = 1e-9
#: Sums of some hundred terms in two orders.
SUMS = 1e-10


def noisy_plant(seed: int, *, radius: float = 0.9) -> rs.Plant:
    """Return a sampled plant with noise that states and outputs share, in units far apart."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    A, C = rng.standard_normal((n, n)), rng.standard_normal((p, n))
    A *= radius / abs(np.linalg.eigvals(A)).max()
    X, Y = 2.0 ** rng.integers(-20, 21, n), 2.0 ** rng.integers(-20, 21, p)
    joint = rng.standard_normal((n + p, n + p + 2))
    plant = rs.Plant(A * X[:, None] / X, rng.standard_normal((n, 2)) * X[:, None], C * Y[:, None] / X, dt=1.0)
    return plant.with_noise_input(joint[:n] * X[:, None], joint[n:] * Y[:, None])


@pytest.mark.parametrize("seed", range(30))
def test_the_gain_is_that_of_the_riccati_equation(seed: int) -> None:
    plant = noisy_plant(seed, radius=0.5 + 0.02 * seed)  # the last ones are unstable
    made = predictor(plant, 1.0)
    noise = plant.process_noise, plant.measurement_noise, plant.cross_noise
    wanted = filter_riccati(plant.A, plant.C, *noise, dt=1.0)
    assert made.innovation_covariance is not None
    size = np.sqrt(np.diag(wanted.innovation_covariance))
    off = abs(made.innovation_covariance - wanted.innovation_covariance) / np.outer(size, size)
    assert off.max() < RICCATI
    spread = np.sqrt(np.diag(wanted.covariance) + np.diag(plant.process_noise))
    K = made.B[:, len(plant.inputs) :]
    assert (abs(K - wanted.gain) / spread[:, None] * size).max() < RICCATI


def test_a_predictor_that_does_not_exist_is_refused_with_the_reason() -> None:
    plant = rs.Plant([[1.2, 0], [0, 0.5]], [[1], [1]], [[0, 1]], dt=1.0).with_noise(process=1.0, measurement=1.0)
    with pytest.raises(DesignError, match="not detectable"):
        predictor(plant, 1.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("simulation", [False, True])
def test_start_and_offsets_are_taken_out_as_a_fit_of_them_does(seed: int, simulation: bool) -> None:
    """Against the least-squares fit of a simulation written out sample by sample."""
    rng = np.random.default_rng(seed)
    A = 0.6 * np.linalg.qr(rng.standard_normal((3, 3)))[0]
    plant = rs.Plant(A, rng.standard_normal((3, 1)), rng.standard_normal((2, 3)), dt=1.0)
    plant = plant.with_noise(process=0.1, measurement=[0.2, 0.3]).with_operating_point(inputs=[1.0], outputs=[2.0, 3.0])
    data = rng.standard_normal((40, 3)) + [1.0, 2.0, 3.0]
    filter_ = predictor(plant, 1.0, simulation=simulation)
    W = rng.standard_normal((2, 2)) + 2 * np.eye(2)
    K = filter_.B[:, 1:]

    def errors(unknown: np.ndarray) -> np.ndarray:
        x, out = unknown[:3], []
        for row in data - [1.0, 2.0, 3.0]:
            e = row[1:] - unknown[3] * np.array([0.0, 1.0]) - plant.C @ x - plant.D @ row[:1]
            out.append(W @ e)
            x = plant.A @ x + plant.B @ row[:1] + K @ e
        return np.array(out).ravel()

    zero = errors(np.zeros(4))
    responses = np.column_stack([errors(one) - zero for one in np.eye(4)])
    wanted = zero - responses @ np.linalg.lstsq(responses, zero)[0]
    made = prediction_errors(filter_, [data], [2]).projected(W)[0]
    np.testing.assert_allclose(made, wanted.reshape(-1, 2), atol=SUMS)


def test_the_estimate_is_that_of_a_search_by_hand() -> None:
    """The determinant of the covariance of the errors, by a simplex search over predictions written out by hand."""

    def lag(pole: float, gain: float) -> rs.Plant:
        return rs.Plant([[pole]], [[gain]], [[1.0], [0.5]], dt=1.0).with_noise(process=0.2, measurement=[0.1, 0.3])

    rng = np.random.default_rng(0)
    plant = lag(0.7, 1.5)
    u = np.repeat(rng.standard_normal((60, 1)), 5, axis=0)
    w = rng.standard_normal((300, len(plant.noises)))
    y = plant.system(("control", "noise")).simulate(np.hstack([u, w]))

    def criterion(unknown: np.ndarray) -> float:
        pole, gain, x = unknown
        made = lag(pole, gain)
        K = filter_riccati(made.A, made.C, made.process_noise, made.measurement_noise, dt=1.0).gain
        out = []
        for k in range(len(u)):
            e = y[k] - made.C[:, 0] * x
            out.append(e)
            x = float(pole * x + gain * u[k, 0] + K[0] @ e)
        return float(np.linalg.slogdet(np.array(out).T @ np.array(out))[1])

    options = {"xatol": 1e-7, "fatol": 1e-12, "maxiter": 2000}
    wanted = scipy.optimize.minimize(criterion, [0.6, 1.2, 0.0], method="Nelder-Mead", options=options).x
    model = rs.identify.grey_box(lag, (u, y), {"pole": (0.0, 0.6, 0.95), "gain": (0.1, 1.2, 5.0)}, held_out=0.0)
    # the start is fitted with the weights, not in the determinant: some thousandth of a standard error apart
    for name, value in zip(model.parameters, wanted, strict=False):
        assert abs(model.parameters[name] - value) < 0.02 * model.standard_errors[name]


# ----------------------------------------------------------- what data say


@pytest.mark.parametrize("seed", range(4))
def test_the_sandwich_is_its_formula(seed: int) -> None:
    """Written out as sums over pairs of samples, in one stretch and in two."""
    rng = np.random.default_rng(seed)
    S, e = rng.standard_normal((2, 50, 2, 3)), rng.standard_normal((2, 50, 2))
    e[:, 1:] += 0.7 * e[:, :-1]
    P = np.diag([1.0, 0.0, 4.0])
    made, plain, lags = sandwich_covariance(list(S), list(e), P)
    H = np.einsum("rtpi,rtpj->ij", S, S) + P
    score = np.einsum("rtpi,rtp->rti", S, e)
    middle = np.zeros((3, 3))
    for part in score:
        for t, first in enumerate(part):
            for k, second in enumerate(part):
                middle += max(1 - abs(t - k) / (lags + 1), 0.0) * np.outer(first, second)
    middle = middle * 100 / 97 + P
    assert lags > 0
    np.testing.assert_allclose(plain, np.linalg.inv(H), rtol=SUMS)
    np.testing.assert_allclose(made, np.linalg.inv(H) @ middle @ np.linalg.inv(H), rtol=SUMS, atol=SUMS * plain.max())


@pytest.mark.parametrize("factor", [2.0**-20, 2.0**20])
def test_the_sandwich_does_not_depend_on_units(factor: float) -> None:
    rng = np.random.default_rng(0)
    S, e = rng.standard_normal((200, 1, 2)), rng.standard_normal((200, 1))
    units = np.array([factor, 1.0])
    made, _, lags = sandwich_covariance([S], [e], np.zeros((2, 2)))
    other, _, same = sandwich_covariance([S * units], [e], np.zeros((2, 2)))
    assert lags == same
    np.testing.assert_allclose(other * np.outer(units, units), made, rtol=1e-9, atol=1e-9 * made.max())


def test_only_the_sum_is_known() -> None:
    rng = np.random.default_rng(0)
    slope = rng.standard_normal((100, 1, 1))
    S = np.concatenate([slope, slope, rng.standard_normal((100, 1, 1))], axis=2)
    facts = identifiability([S[:50], S[50:]], ("a13", "a32", "b"), np.ones(3))
    assert facts.unknown == (2,)
    assert facts.moves(2) == pytest.approx({"a13": 1.0, "a32": -1.0})
    assert "do not tell a13 from a32: moved together, a13 by" in facts.sentence(2)
    assert facts.condition > 1e12
    np.testing.assert_allclose(facts.singular_values[:2] ** -2.0, np.linalg.eigvalsh(np.linalg.pinv(_gram(S)))[[1, 2]])


def _gram(S: np.ndarray) -> np.ndarray:
    return np.einsum("tpi,tpj->ij", S, S)


def test_weights_whiten() -> None:
    rng = np.random.default_rng(0)
    M = rng.standard_normal((3, 3)) * np.array([[1e-6], [1.0], [1e6]])
    W, notes = weights_of(M @ M.T, np.array([1e-6, 1.0, 1e6]))
    np.testing.assert_allclose(W @ M @ M.T @ W.T, np.eye(3), atol=1e-8)
    assert notes == ()
    _, notes = weights_of(np.diag([0.0, 1.0]), np.ones(2))
    assert "1 output without noise" in notes[0]
    _, notes = weights_of(np.ones((2, 2)), np.ones(2))
    assert "the same but for a factor" in notes[0]
