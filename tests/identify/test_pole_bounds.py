"""The bound of what logs say of poles: by hand for one state, and reached by identification."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import residua as rs
from recorded_plants import recorded

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the benchmark that computes bounds."""
    pytest.importorskip("nfoursid", reason="the campaign compares with it")
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks"))
    return import_module("pole_bounds")


@pytest.mark.parametrize("pole", [0.2, 0.9])
def test_one_state_by_hand(bench: ModuleType, pole: float) -> None:
    """With a white input of unit variance the variance is sigma^2 (1 - a^2)^3 / (n b^2)."""
    plant = rs.Plant([[pole]], [[2.0]], [[0.5]], dt=1.0)
    noise, log = np.array([0.1]), recorded(plant, np.random.default_rng(0), 40_000, 10.0)
    case = bench.Case(0, plant, False, 10.0, noise, log, log)
    (bound,) = bench.pole_bounds(case)
    rows = bench.USED * len(case.few[0])
    assert bound == pytest.approx(np.sqrt(noise[0] ** 2 * (1 - pole**2) ** 3 / rows), rel=0.1)


def test_identification_reaches_it(bench: ModuleType) -> None:
    """The root mean square of the errors over draws of noise and inputs, of a plant all of whose modes can be seen."""
    case = bench.generated_case(4)
    errors = []
    for k in range(24):
        u, y = recorded(case.plant, np.random.default_rng(k), len(case.few[0]), case.ratio)
        errors.append(bench.pole_errors(case.plant, rs.identify.subspace(u, y, order=case.order, dt=1.0)))
    over = np.sqrt(np.mean(np.square(errors), axis=0)) / bench.pole_bounds(case)
    assert (over > 0.6).all()
    assert (over < 1.5).all()
