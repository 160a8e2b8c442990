"""Directions: signatures that tell something, and the mean that they are judged by, in words and sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import chdtri

import residua as rs
from residua.decide import correlation, projection_distance
from residua.decide.directional import MEAN_WEIGHTS, candidates_at, clear_means, clear_square, direction_test, no_means
from residua.errors import DataError


@pytest.mark.parametrize("seed", range(10))
def test_a_plane_that_holds_every_residual_is_not_judged_by(seed: int) -> None:
    """Decoupling one disturbance leaves two independent residuals of three: a plane is then everything."""
    rng = np.random.default_rng(seed)
    plant = rs.Plant(rng.standard_normal((3, 3)) - 3 * np.eye(3), rng.standard_normal((3, 1)), np.eye(3), dt=0)
    plant = plant.with_disturbances(rng.standard_normal((3, 1))).with_actuator_faults().with_sensor_faults()
    generator = rs.design.robust_detection_filter(plant.discretize(0.05))
    assert generator.residual_rank == 2
    monitor = rs.Monitor(
        generator, test=rs.decide.NormThreshold(threshold=1e-6), isolate=rs.decide.Directional(window=20)
    )
    sampled = generator.plant
    for name in ("u1 actuator", "y1 sensor", "y3 sensor"):
        f = np.zeros((2000, 4))
        f[1000:, sampled.faults.index(name)] = 1.0
        y = sampled.system("fault").simulate(f)
        found = monitor.run(np.zeros((2000, 1)), y)
        assert all(basis.shape[1] < 2 for basis in found.naming.signatures)
        assert name in found.candidates[0].faults


def test_ties_go_to_the_narrower_signature() -> None:
    groups = (("plane",), ("line",), ("other",))
    found = candidates_at(np.array([0.99996, 0.99991, 0.5]), groups, (2, 1, 1))
    assert [c.faults[0] for c in found] == ["line", "plane", "other"]
    found = candidates_at(np.array([0.99, 0.95, 0.5]), groups, (2, 1, 1))
    assert found[0].faults == ("plane",)


def test_signatures_are_grouped_and_missing_ones_listed() -> None:
    e = np.eye(3)
    subspaces = {"a": e[:, :1], "b": -2 * e[:, :1], "c": e, "d": e[:, :0]}
    steady = {"a": e[0], "b": e[0], "c": e[1], "d": np.zeros(3)}
    test = direction_test(rs.decide.Directional(), subspaces, steady, np.eye(3))
    assert test.groups == (("a", "b"), ("c",))
    assert test.unjudged == ("d",)
    assert test.dimensions == (1, 1)
    only = direction_test(rs.decide.Directional(signature="subspace"), subspaces, steady, np.eye(3))
    assert only.unjudged == ("c", "d")


def test_faults_that_share_a_plane_are_told_apart_by_where_they_settle() -> None:
    """Unless one of them settles to nothing, or both to one direction, of either sign."""
    e = np.eye(3)
    plane = e[:, :2]
    turned = plane @ np.array([[0.6, -0.8], [0.8, 0.6]])
    subspaces = {"a": plane, "b": turned, "c": e[:, 2:]}
    steady = {"a": e[0], "b": -e[1], "c": e[2]}
    apart = direction_test(rs.decide.Directional(), subspaces, steady, np.eye(3))
    assert apart.groups == (("a",), ("b",), ("c",))
    assert apart.dimensions == (1, 1, 1)
    whole = direction_test(rs.decide.Directional(signature="subspace"), subspaces, steady, np.eye(3))
    assert whole.groups == (("a", "b"), ("c",))
    for other in (-3 * e[0], np.zeros(3)):
        together = direction_test(rs.decide.Directional(), subspaces, {**steady, "b": other}, np.eye(3))
        assert together.groups == (("a", "b"), ("c",))
        assert together.dimensions == (2, 1)


def test_correlation_and_distance_by_pseudoinverse() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        r, Phi = rng.standard_normal(5), rng.standard_normal((5, 2))
        padded = np.column_stack([Phi, Phi[:, 0], np.zeros(5)])  # dependent and zero columns
        assert correlation(r, padded) == pytest.approx(correlation(r, Phi), abs=1e-12)
        assert correlation(r, Phi) ** 2 + projection_distance(r, Phi) ** 2 == pytest.approx(1, abs=1e-12)
    assert np.isnan(correlation(np.zeros(3), np.eye(3)))
    with pytest.raises(DataError, match="one row per residual"):
        correlation([1.0, 2.0], np.eye(3))


# ------------------------------------------------------------------ the clear mean


def chosen_by_hand(rows: np.ndarray, judged: np.ndarray, clear: float) -> np.ndarray:
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
    np.testing.assert_allclose(whole[0], chosen_by_hand(rows, judged, clear), rtol=1e-12, atol=1e-14)
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
