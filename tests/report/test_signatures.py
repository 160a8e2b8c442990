"""Page and plots draw the signatures that the monitor judged by, by no rule of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import residua as rs
from report_examples import changed, diagnosis, generator
from residua.report.body import observed_residual
from residua.report.pictures import direction_picture, project
from residua.report.signatures import generator_signatures, judged_signatures


def tank_diagnosis(window: int = 50, *, signature: str = "auto", offset: float = 0.7) -> rs.Diagnosis:
    """A fitted monitor on a fault; fault-free data lie off the operating point, so the mean is not zero."""
    plant = rs.library.gertler().with_sensor_faults().with_noise(process=0.01, measurement=0.02)
    rng = np.random.default_rng(5)
    u = rng.standard_normal((1500, 1))
    w = rng.standard_normal((1500, len(plant.noises)))
    f = np.zeros((1500, len(plant.faults)))
    y = plant.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w])) + [offset, -2 * offset]
    isolate = rs.decide.Directional(window=window, signature=signature)
    monitor = rs.Monitor(rs.design.kalman_filter(plant), isolate=isolate).fit(u, y)
    faulty = y.copy()
    faulty[1000:, -1] += 20.0
    return monitor.run(u, faulty)


def cosines(bases) -> np.ndarray:
    """Largest principal cosines, by definition."""
    return np.array([[np.linalg.svd(a.T @ b, compute_uv=False)[0] for b in bases] for a in bases])


def test_the_last_row_of_the_page_is_the_score_of_the_same_samples():
    alarm = tank_diagnosis().main_alarm
    assert alarm is not None
    d = tank_diagnosis(window=alarm.stop - alarm.start)  # the window of the last score is now the whole alarm
    assert d.main_alarm is not None
    assert (d.main_alarm.start, d.main_alarm.stop) == (alarm.start, alarm.stop) == (alarm.start, len(d.time))
    assert np.linalg.norm(d.test.center @ d.test.whitening) > 1
    known = judged_signatures(d)
    observed = observed_residual(d, known)
    assert observed is not None
    np.testing.assert_allclose(known.correlation(observed), d.scores[-1], atol=1e-10)
    mean = (d.residuals[alarm.start : alarm.stop].mean(axis=0) - d.test.center) @ d.test.whitening
    assert np.linalg.norm(observed) == pytest.approx(np.linalg.norm(mean))


def test_without_a_known_mean_nothing_is_observed():
    d = changed(tank_diagnosis(), center=np.full(2, np.nan))
    assert observed_residual(d, judged_signatures(d)) is None


@pytest.mark.parametrize("signature", ["auto", "steady"])
def test_the_judged_signatures_are_drawn_with_their_angles(signature):
    d = tank_diagnosis(signature=signature)
    known = judged_signatures(d)
    assert known.labels == tuple(" or ".join(group) for group in d.groups)
    assert [B.shape for B in known.bases] == [B.shape for B in d.naming.signatures]
    np.testing.assert_allclose(known.similarity(), cosines(d.naming.signatures), atol=1e-12)
    for B in known.bases:
        np.testing.assert_allclose(B.T @ B, np.eye(B.shape[1]), atol=1e-12)


def test_the_drawn_space_is_the_whitened_one_turned_towards_the_residuals():
    d = tank_diagnosis()
    known = judged_signatures(d)
    root = known.whitening
    np.testing.assert_allclose(root, root.T, atol=1e-12 * np.abs(root).max())
    np.testing.assert_allclose(root @ root, d.test.whitening @ d.test.whitening.T, rtol=1e-10)
    assert np.linalg.eigvalsh(root).min() > 0
    assert known.whitened
    r = np.array([0.3, -1.1])
    scores = [
        np.linalg.norm(r @ d.test.whitening @ B) / np.linalg.norm(r @ d.test.whitening) for B in d.naming.signatures
    ]
    np.testing.assert_allclose(known.correlation(root @ r), scores, atol=1e-12)


def test_the_choice_of_the_whitening_matrix_does_not_show():
    gen = generator(4, noise=True)
    own = generator_signatures(gen)
    assert gen.covariance is not None
    other = generator_signatures(gen, np.linalg.inv(np.linalg.cholesky(gen.covariance)).T)
    for a, b in zip(own.bases, other.bases, strict=True):
        np.testing.assert_allclose(a @ a.T, b @ b.T, atol=1e-8)
    np.testing.assert_allclose(np.diag(own.similarity()), 1)


def test_a_generator_shows_what_its_monitor_judges_by():
    plant = rs.library.gertler().with_sensor_faults().with_noise(process=0.01, measurement=0.02)
    gen = rs.design.kalman_filter(plant)
    judged = judged_signatures(rs.Monitor(gen).run(np.ones((50, 1)), np.ones((50, 2))))
    shown = generator_signatures(gen)
    assert shown.labels[: len(judged.labels)] == judged.labels
    assert all(B.shape[1] == 0 for B in shown.bases[len(judged.labels) :])
    np.testing.assert_allclose(shown.whitening, judged.whitening)
    for a, b in zip(shown.bases, judged.bases, strict=False):
        np.testing.assert_allclose(a, b)


def test_a_fault_without_signature_stays_listed():
    gen = generator(2)
    gen = replace(gen, subspaces={**gen.subspaces, gen.faults[0]: np.zeros((2, 0))})
    gen.__dict__["steady_directions"] = {**gen.steady_directions, gen.faults[0]: np.zeros(2)}
    known = generator_signatures(gen)
    assert known.labels[-1] == gen.faults[0]
    assert np.isnan(known.similarity()[-1]).all()
    assert np.isnan(known.correlation(np.ones(2))[-1])


def test_without_isolation_the_generator_speaks():
    d = diagnosis(groups=(), signatures=())
    own = generator_signatures(d.generator)
    assert judged_signatures(d).labels == own.labels
    nothing = judged_signatures(diagnosis(groups=(), signatures=(), unjudged=d.generator.faults))
    assert nothing.labels == ()


def test_correlation_matches_the_definition():
    known = generator_signatures(generator(3))
    r = np.array([1.0, -2.0, 0.5])
    for value, B in zip(known.correlation(r), known.bases, strict=True):
        projected = B @ np.linalg.pinv(B) @ r
        np.testing.assert_allclose(value, np.linalg.norm(projected) / np.linalg.norm(r))
    assert np.isnan(known.correlation(np.zeros(3))).all()


def test_identity_whitening_is_not_called_whitened():
    assert not generator_signatures(generator(3), np.eye(3)).whitened


def test_picture_has_a_line_per_direction_and_turns_to_the_observation():
    gen = generator(2)
    known = generator_signatures(gen)
    observed = -known.bases[0][:, 0]
    picture = direction_picture(gen.residuals, known.bases, observed)
    lines = sum(B.shape[1] == 1 for B in known.bases)
    assert picture.count("<g ") == 2 + lines + 1
    x, y = project(observed)
    assert picture.count(f'x2="{x:.1f}" y2="{y:.1f}"') >= 2
    assert direction_picture(("a",) * 4, [np.eye(4)[:, :1]], None) == ""
