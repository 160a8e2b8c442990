"""Hundreds of generated plants, badly scaled and large ones among them: verified, or refused with a reason.

Run with ``make campaign``.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import residua as rs
from generated import singular_plant
from residua.errors import AccuracyError, DesignError
from residua.testing import check_residual_generator

PLANTS = 200


def plants(seed: int, decades: float, largest: int) -> list[rs.Plant]:
    """Return plants with units spread over ``2 * decades`` powers of ten."""
    rng = np.random.default_rng(seed)
    out = []
    for trial in range(PLANTS):
        n, q, s = int(rng.integers(2, largest)), int(rng.integers(0, 2)), int(rng.integers(1, 4))
        p = int(rng.integers(q + 2, q + 5))
        dt = 0.1 * float(rng.integers(0, 2))
        A = rng.standard_normal((n, n))
        if dt:
            A /= 1.05 * np.abs(np.linalg.eigvals(A)).max()
        T, Y = 10 ** rng.uniform(-decades, decades, n), 10 ** rng.uniform(-decades, decades, p)
        plant = rs.Plant(
            A * T[:, None] / T,
            rng.standard_normal((n, 1)) * T[:, None],
            rng.standard_normal((p, n)) * Y[:, None] / T,
            dt=dt,
        ).with_faults({f"f{i}": rng.standard_normal(n) * T for i in range(s)})
        if q:
            plant = plant.with_disturbances(rng.standard_normal((n, q)) * T[:, None])
        out.append(plant.with_sensor_faults([0]) if trial % 3 == 0 else plant)
    return out


def outcome(design: object, plant: rs.Plant) -> str:
    """Return what became of a design; anything but a verified generator or a reasoned refusal raises."""
    try:
        made = design(plant)  # pyright: ignore[reportCallIssue]
        generator = made.residual_generator() if isinstance(made, (rs.design.Observer, rs.design.Bank)) else made
    except (DesignError, AccuracyError) as error:
        return type(error).__name__ if len(str(error)) > 40 else "refused without a reason"
    if plant.E is None:
        check_residual_generator(generator, tolerance=1e-6)
    else:
        assert silent(generator) < 1e-5
    return "verified"


def silent(generator: rs.design.ResidualGenerator) -> float:
    """Return the response to controls and disturbances of a singular plant, relative to the terms that cancel."""
    plant = generator.plant
    points = np.logspace(-2, 0.4, 30) / (plant.dt or 1.0)
    Q = generator.system.frequency_response(points)
    P = plant.system(("control", "disturbance")).frequency_response(points)
    n_u = len(plant.inputs)
    through = Q[:, :, n_u:] @ P
    through[:, :, :n_u] += Q[:, :, :n_u]
    terms = (np.abs(Q[:, :, n_u:]) @ np.abs(P)).max(axis=0)
    floor = 1e-8 * np.abs(Q[:, :, n_u:]).max() * np.abs(P).max(axis=(0, 1))
    return float(np.max(np.abs(through).max(axis=0) / np.maximum(terms, floor), initial=0.0))


@pytest.mark.campaign
@pytest.mark.parametrize(("decades", "largest", "verified"), [(0, 10, 0.99), (3, 10, 0.9), (5, 10, 0.4), (0, 24, 0.85)])
@pytest.mark.parametrize("method", ["unknown_input_observer", "directional"])
def test_designs_are_verified_or_refused(decades: float, largest: int, verified: float, method: str) -> None:
    count: Counter[str] = Counter()
    for plant in plants(7, decades, largest):
        design = rs.design.robust_detection_filter if plant.disturbances else rs.design.detection_filter
        count[outcome(design if method == "directional" else rs.design.unknown_input_observer, plant)] += 1
    print(dict(count))
    assert count["refused without a reason"] == 0
    assert count["verified"] >= verified * PLANTS


def singular_plants(seed: int, decades: float, largest: int) -> list[rs.Plant]:
    """Return singular plants with units of states, equations and outputs spread over powers of ten."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(PLANTS // 2):
        p = singular_plant(rng, n=int(rng.integers(3, largest)), disturbances=int(rng.integers(0, 2)))
        T, R = 10 ** rng.uniform(-decades, decades, p.n_states), 10 ** rng.uniform(-decades, decades, p.n_states)
        Y = 10 ** rng.uniform(-decades, decades, p.n_outputs)
        assert p.E is not None
        plant = rs.Plant(R[:, None] * p.A * T, R[:, None] * p.B, Y[:, None] * p.C * T, E=R[:, None] * p.E * T, dt=p.dt)
        if p.disturbances:
            plant = plant.with_disturbances({"d1": R * p.Bd[:, 0]})
        out.append(plant.with_faults({"f0": R * p.Bf[:, 0]}).with_sensor_faults())
    return out


OTHERS = {
    "luenberger": rs.design.luenberger_observer,
    "reduced order": lambda p: rs.design.reduced_order_observer(p, outputs=range(p.n_outputs - 1)),
    "decoupled": lambda p: rs.design.decoupled_residual(p, insensitive_to=p.faults[-1]),
    "minimal bank": lambda p: rs.design.sensor_fault_bank(p, observer="minimal"),
    "unknown input bank": rs.design.sensor_fault_bank,
}
SINGULAR = {
    "unknown input": rs.design.unknown_input_observer,
    "descriptor": lambda p: rs.design.descriptor_observer(p, outputs=range(p.n_outputs - 1)),
    "decoupled": lambda p: rs.design.decoupled_residual(p, insensitive_to=p.faults[-1]),
    "minimal bank": lambda p: rs.design.sensor_fault_bank(p, observer="minimal"),
}


@pytest.mark.campaign
@pytest.mark.parametrize(("decades", "largest", "verified"), [(0, 10, 0.98), (3, 10, 0.95), (5, 10, 0.8), (0, 24, 0.9)])
@pytest.mark.parametrize("method", [f"{name}, regular" for name in OTHERS] + [f"{name}, singular" for name in SINGULAR])
def test_observers_and_banks_are_verified_or_refused(
    decades: float, largest: int, verified: float, method: str
) -> None:
    name, kind = method.split(", ")
    chosen = plants(7, decades, largest) if kind == "regular" else singular_plants(3, decades, largest)
    count: Counter[str] = Counter()
    for plant in chosen:
        count[outcome((OTHERS if kind == "regular" else SINGULAR)[name], plant)] += 1
    print(method, dict(count))
    assert count["refused without a reason"] == 0
    assert count["verified"] >= verified * len(chosen)
