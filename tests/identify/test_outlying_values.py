"""Outliers, standstills and channels that are there twice are told by every method, and fault-free channels are not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from residua.identify import segments
from residua.identify.channel_facts import outlying_values
from residua.identify.segments import gather

METHODS = ("subspace", "arx", "principal_components", "canonical_variates", "parity_from_data", "regression")
NAMES: dict[str, Any] = {"inputs": ["valve", "fan"], "outputs": ["boiler", "room", "mix"]}


def recorded(seed: int, kind: str = "Gaussian", rows: int = 2000) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a fault-free recording of first-order channels."""
    rng = np.random.default_rng(seed)
    if kind == "steps":
        hold = int(rng.integers(1, 300))
        u = np.column_stack([np.repeat(rng.uniform(-1, 1, rows // hold + 1), hold)[:rows], rng.random(rows) < 0.02])
    elif kind == "quantised":
        u = np.round(np.cumsum(rng.standard_normal((rows, 2)), axis=0) / rng.uniform(0.5, 5))
    else:
        u = rng.standard_t(4, (rows, 2)) if kind == "heavy-tailed" else rng.standard_normal((rows, 2))
    poles, B = rng.uniform(0.3, 0.99, 3), rng.standard_normal((2, 3))
    x = rs.Plant(np.diag(poles), B.T, np.eye(3), dt=1.0).system("control").simulate(u)
    noise = rng.standard_t(4, x.shape) if kind == "heavy-tailed" else rng.standard_normal(x.shape)
    y = x + rng.uniform(0.001, 0.5) * noise
    if kind == "quantised":
        y = np.round(y / (y.std(axis=0) * rng.uniform(0.02, 1.5, 3)))
    return u.astype(float), y + 20.0


def notes_of(method: str, u: NDArray[np.float64], y: NDArray[np.float64]) -> str:
    made: Any = getattr(rs.identify, method)(u, y, dt=1.0, **NAMES)
    return "\n".join(made.report.notes if hasattr(made, "report") else made.generator.evidence.notes)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_tells_an_outlier_and_a_standstill(method: str) -> None:
    u, y = recorded(0)
    assert "far outside" not in notes_of(method, u, y)
    assert "stands still" not in notes_of(method, u, y)
    y[900, 1] = 1e6
    y[1200:, 2] = y[1200, 2]
    said = notes_of(method, u, y)
    assert "'room' has a value far outside the rest, 1e06 in row 900" in said
    assert "set it missing (NaN)" in said
    assert "'mix' stands still" in said
    assert "for 800 rows from row 1200 on, 40 % of all rows" in said


@pytest.mark.parametrize("kind", ["Gaussian", "steps", "heavy-tailed", "quantised"])
def test_fault_free_channels_are_not_noted(kind: str) -> None:
    rng = np.random.default_rng(1)
    for seed in range(50):
        u, y = recorded(seed, kind, int(rng.integers(100, 6000)))
        assert outlying_values(gather(u, y)) == ()


@pytest.mark.parametrize("block", [97, 65_536])
@pytest.mark.parametrize("scale", [2.0**-20, 1.0, 2.0**20])
def test_rows_are_counted_in_any_units_and_blocks(scale: float, block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(segments, "BLOCK", block)
    u, y = recorded(2)
    u[[300, 1500], 0] = [-9999, 800]
    y[100:900, 0] = y[100, 0]
    y[50, 2] = np.nan  # cuts the recording in two
    gathered = gather(u * scale, y * scale, **NAMES).delayed({"valve": 2})
    outlier, still = outlying_values(gathered)
    assert "'valve' has 2 values far outside" in outlier
    assert "in row 300 " in outlier
    assert "'boiler' stands still" in still
    assert "for 800 rows from row 100 on" in still


def test_outputs_that_stand_still_together_are_one_note_with_their_recording() -> None:
    u, y = recorded(3)
    other = y.copy()
    other[500:900] = other[500]
    note, *more = outlying_values(gather([(u, y), (u, other)], **NAMES))
    assert not more
    assert "'boiler', 'room' and 'mix' stand still together" in note
    assert "400 rows from row 500 of recording 2 on" in note


@pytest.mark.parametrize("method", ["principal_components", "parity_from_data", "regression"])
def test_an_output_that_is_there_twice_is_named(method: str) -> None:
    u, y = recorded(4)
    assert "twice" not in notes_of(method, u, y)
    assert "same signal" not in notes_of(method, u, y)
    y[:, 2] = 2 * y[:, 1] - 3
    said = notes_of(method, u, y)
    assert "room" in said
    assert "mix" in said
    assert ("there twice" if method == "principal_components" else "are the same signal, times a number") in said
