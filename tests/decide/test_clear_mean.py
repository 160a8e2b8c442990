"""The mean that a direction is judged by, against the same in words, sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri

import residua as rs
from residua.decide.directional import MEAN_WEIGHTS, clear_means, clear_square, no_means


def by_hand(rows: np.ndarray, judged: np.ndarray, clear: float) -> np.ndarray:
    """The slowest mean that is longer than noise makes it, else the longest, in deviations."""
    means, out = [np.zeros(rows.shape[1]) for _ in MEAN_WEIGHTS], np.zeros_like(rows)
    for k in np.flatnonzero(judged):
        chosen, longest = rows[k], float(rows[k] @ rows[k])
        for j, weight in enumerate(MEAN_WEIGHTS):
            means[j] = (1 - weight) * means[j] + weight * rows[k]
            square = float(means[j] @ means[j]) / (weight / (2 - weight))
            if square > clear or square >= longest:
                chosen, longest = means[j], square
        out[k] = chosen
    return out


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_it_is_the_slowest_mean_that_is_clear(missing: float) -> None:
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((600, 3))
    rows[200:400] += [0.0, 1.5, 0.0]
    rows[500:] = 0.0
    judged = rng.random(600) >= missing
    clear = clear_square(3)
    whole, after = clear_means(rows[None], no_means(1, 3), judged[None], clear)
    np.testing.assert_allclose(whole[0], by_hand(rows, judged, clear), rtol=1e-12, atol=1e-14)
    first, state = clear_means(rows[None, :250], no_means(1, 3), judged[None, :250], clear)
    second, last = clear_means(rows[None, 250:], state, judged[None, 250:], clear)
    assert np.concatenate([first, second], axis=1).tobytes() == whole.tobytes()
    assert last.means.tobytes() == after.means.tobytes()


def test_noise_alone_is_seldom_clear() -> None:
    for k in (1, 2, 5, 20):
        assert clear_square(k) == pytest.approx(chdtri(k, 1e-5), rel=0.12)


def test_a_large_fault_has_its_name_at_the_first_sample() -> None:
    plant = rs.Plant([[0.9, 0.05], [0.3, 0.6]], [[0.1], [0.2]], np.eye(2), dt=1, outputs=["a", "b"])
    plant = plant.with_sensor_faults().with_noise(process=1e-4 * np.eye(2), measurement=1e-2 * np.eye(2))
    monitor = rs.Monitor(rs.design.kalman_filter(plant))
    rng, right = np.random.default_rng(1), 0
    for run in range(40):
        u = np.zeros((400, 1))
        y = plant.system(("control", "noise")).simulate(np.hstack([u, rng.standard_normal((400, 4))]))
        y[300:, run % 2] += 1.0
        monitor.reset()
        steps = [monitor.step(*row) for row in zip(u, y, strict=True)]
        first = next(step for step in steps[300:] if step.alarm)
        right += first.candidates[0].faults == (f"{'ab'[run % 2]} sensor",)
    assert right >= 38
