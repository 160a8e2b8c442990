from __future__ import annotations

import numpy as np
import pytest

from continuous_examples import continuous
from effort import rounds
from residua.linear import UncertainSystem
from residua.robust.bounds.response_expansion import expand, member_response
from uncertain_examples import random_uncertain_system


def check_boxes(system: UncertainSystem, seed: int) -> np.ndarray:
    """Check what is claimed about boxes at random against points at random; return how often it is sharp."""
    rng = np.random.default_rng(seed)
    low, high = np.append(system.low, 0.0), np.append(system.high, np.pi if system.dt else 3.0)
    width = (high - low) * rng.uniform(0, 1, (60, 1)) ** 2 * rng.uniform(0, 1, (60, len(low)))
    start = low + (high - low - width) * rng.uniform(0, 1, width.shape)
    response = member_response(system, constant=False)
    found = expand(response, start, start + width)
    sharp = np.zeros(3, dtype=int)
    for i in np.flatnonzero(found.resolved):
        share = np.vstack([rng.uniform(0, 1, (150, len(low))), rng.integers(0, 2, (100, len(low)))])
        points = start[i] + width[i] * share
        gains = response.gains(points)
        assert found.bound[i] <= gains.min() * (1 + 1e-9)
        if found.end[i].any():  # the ends are others than the points; without a coordinate that is free, all one
            ends = np.where(found.end[i] > 0, start[i] + width[i], np.where(found.end[i] < 0, start[i], points))
            ends = ends[:1] if found.end[i].all() else ends
            assert np.all(response.gains(ends) <= gains * (1 + 1e-9))
        sharp += [1, found.bound[i] > 0.9 * gains.min(), found.end[i].any()]
    return sharp


@pytest.mark.parametrize("sampled", [True, False])
@pytest.mark.parametrize("count", rounds(24, 60))
def test_every_box_keeps_its_promises(sampled, count):
    resolved, sharp, one_input = 0, 0, np.zeros(3, dtype=int)
    for seed in range(count):
        system = random_uncertain_system(seed)
        if system.Dzw.shape[0] >= system.Dzw.shape[1]:
            found = check_boxes(system if sampled else continuous(system), seed)
            resolved, sharp = resolved + found[0], sharp + found[1]
            one_input += (system.Dzw.shape[1] == 1) * found  # slopes of several inputs are not bounded
    assert resolved > 25 * count
    assert sharp > 0.5 * resolved
    assert one_input[2] > 0.4 * one_input[0] > 0


def with_channels(system: UncertainSystem, seed: int, inputs: int, outputs: int) -> UncertainSystem:
    """Return the system with other inputs and outputs, drawn at random."""
    rng = np.random.default_rng(seed)
    n, k = system.Bp.shape
    return UncertainSystem(
        system.A, system.Bp, rng.standard_normal((n, inputs)), system.Cq, rng.standard_normal((outputs, n)),
        0.3 * rng.standard_normal((outputs, k)), rng.standard_normal((outputs, inputs)),
        low=system.low, high=system.high, channels=system.channels, dt=system.dt,
    )  # fmt: skip


@pytest.mark.parametrize("part", rounds(2, 5))
@pytest.mark.parametrize(("inputs", "outputs", "count"), [(2, 2, 4), (2, 4, 10), (3, 3, 4)])
def test_every_box_of_several_inputs_keeps_its_promises(inputs, outputs, count, part):
    count *= part
    counts = np.zeros(3, dtype=int)
    for seed in range(count):
        counts += check_boxes(with_channels(random_uncertain_system(seed), seed, inputs, outputs), seed)
    resolved, sharp, _ = counts
    assert resolved > 50 * count
    assert sharp > 0.38 * resolved


def test_rounding_is_no_gain():
    # 0.1 * 0.7 / (1 - 0.9) - 0.7, which is 1e-16: a box of one point.
    system = UncertainSystem([[0.9]], [[0]], [[0.1]], [[1]], [[0.7]], None, [[-0.7]], low=0, high=0, dt=1)
    found = expand(member_response(system, constant=True), np.zeros((1, 2)), np.zeros((1, 2)))
    assert 0 < found.gain[0] < 1e-14
    assert found.resolved[0]
    assert found.bound[0] == 0
