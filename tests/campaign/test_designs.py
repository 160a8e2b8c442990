"""Hundreds of generated plants, badly scaled and large ones among them: verified, or refused with a reason.

Run with ``make campaign``.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

import residua as rs
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
        generator = made.residual_generator() if isinstance(made, rs.design.Observer) else made
    except (DesignError, AccuracyError) as error:
        return type(error).__name__ if len(str(error)) > 40 else "refused without a reason"
    check_residual_generator(generator, tolerance=1e-6)
    return "verified"


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
