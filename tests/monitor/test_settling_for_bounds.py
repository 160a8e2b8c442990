"""How long a monitor waits where thresholds are bounds: what a start or a held value leaves is in none of them."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from dedicated_examples import D1, D2, DT, A, K, dedicated_bank, recording
from residua.decide import NormThreshold, PeakThreshold
from residua.errors import DataError
from residua.linear import StateSpace

BANK = dedicated_bank()
GENERATOR = BANK.generator
#: The plant has long been running when the monitor starts, or a gap comes.
BEFORE, GAP = 400, 5

#: What is left of the filter, and how long the monitor waits for it.
WAITS = ((1e-6, None), (1e-2, 85))


def samples_until(left: float) -> int:
    return int(np.ceil(np.log(left) / np.log(np.abs(GENERATOR.system.poles()).max())))


def weights(k: int, member: int, *, gap: bool) -> np.ndarray:
    """What the residual weighs the measurements with ``k`` samples after a start, or after a gap that held one."""
    system = GENERATOR.system.select(outputs=[member])
    row, out = system.C[0], [system.D[0]]
    for _ in range(k + BEFORE):
        out.append(row @ system.B)
        row = row @ system.A
    lagged = np.array(out)[::-1]
    if gap:  # the sample before it stands for those in it
        lagged[BEFORE - GAP - 1] += lagged[BEFORE - GAP : BEFORE].sum(axis=0)
        lagged[BEFORE - GAP : BEFORE] = 0.0
        return lagged
    start = np.linalg.solve(np.eye(len(system.A)) - system.A, system.B)  # what the first sample would settle to
    lagged[:BEFORE] = 0.0
    lagged[BEFORE] += system.C[0] @ np.linalg.matrix_power(system.A, k + 1) @ start
    return lagged


def worst_case(k: int, member: int, *, gap: bool) -> np.ndarray:
    """Measurements under the disturbance of length one that drives the residual of a member highest there."""
    loop, E = A + K, D1 + K @ D2
    seen = weights(k, member, gap=gap)
    w, later = np.zeros((len(seen), 3)), np.zeros(3)
    for i in range(len(seen) - 1, -1, -1):
        part = D2.T @ seen[i] + E.T @ later
        w[i] = part / np.linalg.norm(part)
        later = loop.T @ later + seen[i]
    return StateSpace(loop, E, np.eye(3), D2, dt=DT).simulate(w)


def share(monitor: rs.Monitor, member: int, *, gap: bool) -> float:
    """Largest residual over its threshold at the first sample that is judged after a start or a gap."""
    y = worst_case(monitor.settling_samples, member, gap=gap)
    if gap:
        y[BEFORE - GAP : BEFORE] = np.nan
    found = monitor.run(None, y if gap else y[BEFORE:])
    assert isinstance(found, rs.Diagnosis)
    assert found.decided[-1]
    return float(found.parts.statistics[-1, member] / found.parts.thresholds[member])


@pytest.mark.parametrize("gap", [False, True], ids=["start", "gap"])
def test_the_worst_disturbance_stays_below_a_certified_threshold(gap: bool) -> None:
    """From a start in the middle of operation, and over a gap; where 1 % is left of the filter it does not."""
    shares = {left: [share(rs.Monitor(BANK, settle=settle), m, gap=gap) for m in range(3)] for left, settle in WAITS}
    assert max(shares[1e-6]) <= 1 + 1e-6
    assert max(shares[1e-2]) > 1 + 1e-5


def test_only_bounds_are_waited_for_longer() -> None:
    """Thresholds that are fitted have in them what a start leaves, or allow for false alarms anyway."""
    bounds, other = samples_until(1e-6), samples_until(1e-2)
    assert rs.Monitor(BANK).settling_samples == bounds
    assert rs.Monitor(BANK, test=PeakThreshold(0.5)).settling_samples == bounds
    assert rs.Monitor(BANK, settle=7).settling_samples == 7
    for test in (PeakThreshold(), NormThreshold()):
        monitor = rs.Monitor(GENERATOR, test=test)
        assert monitor.settling_samples == other
        assert monitor.fit(None, recording(30.0)).settling_samples == other
    assert rs.Monitor(BANK).fit(None, recording(30.0)).settling_samples == bounds


def test_a_recording_that_is_too_short_says_why() -> None:
    found = rs.Monitor(BANK).run(None, recording(0.5))
    assert isinstance(found, rs.Diagnosis)
    assert "because of its slowest pole" in str(found)
    with pytest.raises(DataError, match="because of its slowest pole"):
        rs.Monitor(BANK).fit(None, recording(0.5))


def test_a_filter_without_slow_poles_forgets_as_late_as_it_has_states():
    """Deadbeat filters have no pole to wait for, and need a sample for each state of a chain all the same."""
    A = np.diag([0.9] * 3) + np.diag([0.3] * 2, -1)
    plant = rs.Plant(A, np.zeros((3, 0)), [[0, 0, 1.0]], dt=1.0, outputs=["y"])
    plant = plant.with_disturbances([[0.1], [0], [0]]).with_sensor_faults()
    filters = [
        rs.design.luenberger_observer(plant, poles=poles).residual_generator() for poles in ([0.0] * 3, [0.5] * 3)
    ]
    waits = [rs.Monitor(one, test=PeakThreshold(1.0)).settling_samples for one in filters]
    assert waits[0] == 3
    # (k, 2) 0.5^k is left of three equal poles, and not 0.5^k
    assert waits[1] > np.ceil(np.log(1e-6) / np.log(0.5)) + 4
