"""Eleven models of an aircraft: one relation for all of them, against a design on the nominal model alone."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import residua as rs
from residua.robust.parity.multi_model_parity import multi_model_parity

ORDER = 2


@pytest.fixture(scope="module")
def benchmark_() -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks" / "aircraft_models.py"
    spec = importlib.util.spec_from_file_location("aircraft_models", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def family(benchmark_: ModuleType, shared_data: Path) -> list[rs.Plant]:
    return benchmark_.models(shared_data / "varga_case_studies" / "cs2data.npz")


def flown(plant: rs.Plant, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Fly a model with controls and wind that stay alike for 5 s, and noisy sensors."""
    rng, rho = np.random.default_rng(seed), np.exp(-0.1 / 5.0)
    v = np.zeros((steps, 5))
    e = rng.standard_normal((steps, 5))
    for k in range(1, steps):
        v[k] = rho * v[k - 1] + np.sqrt(1 - rho**2) * e[k]
    w = rng.standard_normal((steps, plant.Bw.shape[1]))
    return v[:, :3], plant.system(("control", "disturbance", "noise")).simulate(np.hstack([v, w]))


@pytest.mark.parametrize("fault", ["y2 sensor", "y4 sensor"])
def test_the_worst_model_is_better_served(family: list[rs.Plant], benchmark_: ModuleType, fault: str) -> None:
    other = [name for name in family[0].faults if name != fault]
    same = {"order": ORDER, "insensitive_to": other, "criterion": "faults", **benchmark_.EXPECTED}
    nominal = multi_model_parity([family[benchmark_.NOMINAL]], **same).generator
    every = multi_model_parity(family, nominal=benchmark_.NOMINAL, **same).generator
    alone, together = (benchmark_.smallest(one, family, fault) for one in (nominal, every))
    assert together.max() < 0.6 * alone.max()
    assert alone[benchmark_.NOMINAL] <= together[benchmark_.NOMINAL]  # what it costs
    assert together.max() / together.min() < 1.5


@pytest.mark.parametrize("model", [0, 10])
def test_the_leak_is_that_of_a_flight(family: list[rs.Plant], benchmark_: ModuleType, model: int) -> None:
    found = multi_model_parity(family, order=ORDER, criterion="faults", relations=2, **benchmark_.EXPECTED)
    u, y = flown(family[model], 60_000, model)
    r = found.generator.run(u, y)[2000:]
    np.testing.assert_allclose(np.sqrt((r**2).mean(axis=0)), found.leak[model], rtol=0.08)
