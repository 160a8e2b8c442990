from __future__ import annotations

import numpy as np

from report_examples import generator
from residua.report.pictures import direction_picture, project
from residua.report.signatures import signatures


def test_similarity_is_a_cosine_and_does_not_depend_on_the_root():
    gen = generator(4, noise=True)
    own = signatures(gen)
    covariance = gen.covariance
    assert covariance is not None
    values, vectors = np.linalg.eigh(covariance)
    other = signatures(gen, whitening=vectors / np.sqrt(values))
    assert own.whitened
    assert other.whitened
    S = own.similarity()
    np.testing.assert_allclose(S, other.similarity(), atol=1e-10)
    np.testing.assert_allclose(S, S.T)
    np.testing.assert_allclose(np.diag(S), 1)
    assert S.min() >= 0


def test_correlation_matches_the_definition():
    gen = generator(3)
    known = signatures(gen)
    r = np.array([1.0, -2.0, 0.5])
    for value, B in zip(known.correlation(r), known.bases, strict=True):
        projected = B @ np.linalg.pinv(B) @ r
        np.testing.assert_allclose(value, np.linalg.norm(projected) / np.linalg.norm(r))
    assert np.isnan(known.correlation(np.zeros(3))).all()


def test_identity_whitening_is_not_called_whitened():
    assert not signatures(generator(3), whitening=np.eye(3)).whitened


def test_picture_has_a_line_per_direction_and_turns_to_the_observation():
    gen = generator(2)
    known = signatures(gen)
    observed = -known.bases[0][:, 0]
    picture = direction_picture(gen.residuals, known.bases, observed)
    lines = sum(B.shape[1] == 1 for B in known.bases)
    assert picture.count("<g ") == 2 + lines + 1
    x, y = project(observed)
    assert picture.count(f'x2="{x:.1f}" y2="{y:.1f}"') >= 2
    assert direction_picture(("a",) * 4, [np.eye(4)[:, :1]], None) == ""
