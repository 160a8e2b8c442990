"""How often the interval of the beginning of an alarm holds it: steps, ramps, white, slow noise, 1 to 52 residuals."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import chdtri

from change_examples import CASES, ONSET, coverage, noise
from residua.decide.alarm import Alarm
from residua.monitor.alarms import with_beginnings

pytestmark = pytest.mark.campaign

#: What is stated is 0.95; it is kept to this.
LEAST_COVERAGE = 0.90


@pytest.mark.parametrize("lag", [0.0, 0.8])
@pytest.mark.parametrize("slow", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("kind", ["step", "ramp"])
def test_one_signal(kind: str, slow: float, lag: float) -> None:
    for size in CASES[kind]:
        dated, held, width = coverage(kind, size, slow, 400, seed=11, lag=lag)
        print(
            f"{kind} {size:4g} slow {slow} lag {lag}: {held} of {dated} = {held / max(dated, 1):.3f}, width {width:g}"
        )
        assert dated < 50 or held / dated >= LEAST_COVERAGE


def residuals(k: int, kind: str, size: float, slow: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Correlated noise, and a change in the direction of some of the residuals."""
    L = np.linalg.cholesky(0.6 * np.eye(k) + 0.4)
    rows = np.column_stack([noise(rng, 1000, slow) for _ in range(k)]) @ L.T
    direction = rng.standard_normal(k) * (rng.random(k) < max(2 / k, 0.1))
    direction = direction if direction.any() else np.eye(k)[0]
    late = np.arange(1000) - ONSET
    change = size * (late >= 0) if kind == "step" else size * np.maximum(late, 0) / 100
    return rows + change[:, None] * direction / np.linalg.norm(np.linalg.solve(L, direction))


def alarm_of(rows: NDArray[np.float64]) -> Alarm | None:
    """The first alarm of the whitened norm at 1e-4 a sample, by three samples in a row."""
    k = rows.shape[1]
    whitened = np.linalg.solve(np.linalg.cholesky(0.6 * np.eye(k) + 0.4), rows.T)
    over = np.linalg.norm(whitened, axis=0) > np.sqrt(chdtri(k, 1e-4))
    raised = np.flatnonzero(np.convolve(over, np.ones(3), "valid") == 3) + 2
    if not raised.size:
        return None
    start = int(raised[0])
    silent = np.flatnonzero(np.convolve(~over[start:], np.ones(3), "valid") == 3)
    stop = start + int(silent[0]) + 3 if silent.size else len(rows)
    return Alarm(float(start - 2), float(start), None, (), start, stop)


@pytest.mark.parametrize("slow", [0.0, 0.8])
@pytest.mark.parametrize("kind", ["step", "ramp"])
@pytest.mark.parametrize("k", [1, 3, 11, 52])
def test_several_residuals(k: int, kind: str, slow: float) -> None:
    rng = np.random.default_rng(k)
    for size in {"step": (4.0, 8.0, 20.0), "ramp": (1.0, 4.0, 20.0)}[kind]:
        dated = held = 0
        for _ in range(150):
            rows = residuals(k, kind, size, slow, rng)
            alarm = alarm_of(rows)
            if alarm is None or alarm.onset < ONSET:
                continue
            (one,) = with_beginnings([alarm], rows, np.ones(len(rows), dtype=bool), np.arange(len(rows), dtype=float))
            if one.began is None:
                continue
            dated += 1
            held += (-1.0 if one.began.earliest is None else one.began.earliest) < ONSET <= one.began.latest
        print(f"{k:2d} residuals, {kind} {size:2g}, slow {slow}: {held} of {dated} = {held / max(dated, 1):.3f}")
        assert dated < 30 or held / dated >= LEAST_COVERAGE
