"""Norms against SLICOT, against frequency sweeps and in the cases that are easy to get wrong."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from residua.errors import ModelError
from residua.linear.norms.system_norms import h2_norm, hinf_norm


def stable(seed, dt, distance=None):
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(1, 20)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A, B, C = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n))
    D = rng.normal(size=(p, m)) * (seed % 3 == 0)
    distance = 10.0 ** -rng.integers(0, 8) if distance is None else distance
    modes = np.linalg.eigvals(A)
    if dt:
        return A / np.abs(modes).max() * (1 - min(distance, 0.5)), B, C, D
    return A - (modes.real.max() + distance) * np.eye(n), B, C, D


@pytest.mark.parametrize("dt", [0, 0.1])
@pytest.mark.parametrize("seed", range(60))
def test_agree_with_slicot(seed, dt):
    slycot = pytest.importorskip("slycot")
    A, B, C, D = stable(seed, dt)
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    kind = "D" if dt else "C"
    wanted, _ = slycot.ab13dd(kind, "I", "S", "D", n, m, p, A, np.eye(n), B, C, D)
    assert hinf_norm(A, B, C, D, dt).value == pytest.approx(wanted, rel=2e-6)
    if dt or not D.any():
        assert h2_norm(A, B, C, D, dt) == pytest.approx(slycot.ab13bd(kind, "H", n, m, p, A, B, C, D), rel=1e-6)


@pytest.mark.parametrize("dt", [0, 0.1])
@pytest.mark.parametrize("seed", range(20))
def test_gain_is_attained_at_the_frequency_and_exceeded_nowhere(seed, dt):
    A, B, C, D = stable(seed, dt, 0.05)
    s = 2.0 ** np.random.default_rng(seed).integers(-20, 20, A.shape[0])
    peak = hinf_norm(A * s[:, None] / s, B * s[:, None], C / s, D, dt)

    def gain(w):
        point = np.exp(1j * w * dt) if dt else 1j * w
        return np.linalg.norm(C @ np.linalg.solve(point * np.eye(len(A)) - A, B) + D, 2)

    if np.isfinite(peak.frequency):
        assert gain(peak.frequency) == pytest.approx(peak.value, rel=1e-9)
    sweep = np.linspace(0, np.pi / dt, 400) if dt else np.geomspace(1e-3, 1e3, 400)
    assert max(gain(w) for w in sweep) <= peak.value * (1 + 2e-6)


def test_sharp_resonance_far_from_the_other_poles():
    A = scipy.linalg.block_diag([[0, 1e4], [-1e4, -2e-3]], [[-1.0]])
    B = np.array([[0.0], [1e4], [1.0]])
    peak = hinf_norm(A, B, [[1.0, 0, 1.0]])
    assert peak.frequency == pytest.approx(1e4, rel=1e-6)
    assert peak.value == pytest.approx(1e4 / 2e-3, rel=1e-6)


@pytest.mark.parametrize("dt", [0, 1.0])
def test_plain_cases(dt):
    zero = np.zeros((1, 1))
    assert hinf_norm(zero - 0.5, zero, zero + 1, zero, dt).value == 0
    assert h2_norm(zero - 0.5, zero, zero + 1, zero, dt) == 0
    static = (np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[3.0, 4.0]]), dt)
    assert hinf_norm(*static).value == pytest.approx(5)
    assert h2_norm(*static) == (pytest.approx(5) if dt else np.inf)
    with pytest.raises(ModelError, match="unstable pole"):
        hinf_norm(zero + 1.5, zero + 1, zero + 1, zero, dt)
    with pytest.raises(ModelError, match="pole"):
        h2_norm(zero + (1 if dt else 0), zero + 1, zero + 1, zero, dt)


def test_high_pass_reaches_its_peak_at_infinity():
    peak = hinf_norm([[-1.0]], [[1.0]], [[-1.0]], [[1.0]])
    assert peak.value == pytest.approx(1)
    assert peak.frequency == np.inf


def test_all_pass_has_norm_one():
    assert hinf_norm([[-1.0]], [[1.0]], [[-2.0]], [[1.0]]).value == pytest.approx(1)
