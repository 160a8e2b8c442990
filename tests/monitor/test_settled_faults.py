"""Faults of a drive that some members of a bank see only while they change: named with what they then look like."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from residua.decide import NormThreshold
from residua.decide.structured import settled_codes
from residua.report.codes import code_table

STEP = 5e-3
NOISE = np.array([0.02, 0.3, 0.02, 0.6])


def drive() -> rs.Plant:
    """A motor and a load on an elastic shaft; the voltage lasts, in the long run, on the current alone."""
    R, L, k, J, b, N, c, d, Jl, bl = 0.8, 2.5e-3, 0.06, 9e-5, 1e-4, 20.0, 350.0, 1.2, 0.06, 0.02
    A = np.array(
        [
            [-R / L, -k / L, 0, 0, 0],
            [k / J, -(b + d / N**2) / J, d / N / J, -c / N / J, 0],
            [0, d / N / Jl, -(bl + d) / Jl, c / Jl, 0],
            [0, 1 / N, -1, 0, 0],
            [0, 0, 1, 0, 0],
        ]
    )
    B = np.array([[1 / L, 0], [0, -0.35 / J], [0, 0], [0, 0], [0, 0]])
    C = np.zeros((4, 5))
    C[[0, 1, 2, 3], [0, 1, 2, 4]] = 1, 1, 1, 4096 / (2 * np.pi)
    plant = rs.Plant(
        A,
        B,
        C,
        name="drive",
        inputs=["voltage", "brake"],
        outputs=["current", "motor speed", "load speed", "encoder"],
        states=["i", "wm", "wl", "twist", "angle"],
    )
    return plant.with_actuator_faults().with_sensor_faults().with_disturbances({"load torque": {"wl": -1 / Jl}})


def recording(
    plant: rs.Plant, seconds: float, seed: int, *, faults: dict[str, float] | None = None, noise: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Everything held over a step, by the matrix exponential; faults from 5 s on."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(round(seconds / STEP))
    u = np.column_stack([12 + 3 * np.sin(4.4 * t), 0.02 + 0.02 * (np.sin(1.9 * t) > 0)])
    f = np.zeros((len(t), len(plant.faults)))
    for name, size in (faults or {}).items():
        f[t >= 5, plant.faults.index(name)] = size
    load = 2 + 1.5 * np.sin(1.3 * t)
    v = np.column_stack([u, f, load])
    n, G = plant.n_states, np.hstack([plant.B, plant.Bf, plant.Bd])
    whole = scipy.linalg.expm(STEP * np.block([[plant.A, G], [np.zeros((G.shape[1], n + G.shape[1]))]]))
    X, x = np.zeros((len(t), n)), np.zeros(n)
    x[:4] = np.linalg.solve(plant.A[:4, :4], -G[:4] @ v[0])
    for k in range(len(t)):
        X[k] = x
        x = whole[:n] @ np.concatenate([x, v[k]])
    y = X @ plant.C.T + f @ plant.Df.T + noise * NOISE * rng.standard_normal((len(t), 4))
    return u, y


PARTS = {
    "electrical": ["voltage actuator", "current sensor", "motor speed sensor"],
    "mechanical": ["brake actuator", "current sensor", "motor speed sensor", "load speed sensor"],
    "kinematic": ["load speed sensor", "encoder sensor"],
}


@pytest.fixture(scope="module")
def general() -> rs.design.Bank:
    return rs.design.sensor_fault_bank(
        drive().discretize(STEP).with_noise(process=1e-6, measurement=NOISE**2), observer="minimal"
    )


@pytest.fixture(scope="module")
def by_parts() -> rs.design.Bank:
    return rs.design.structured_bank(drive(), PARTS)


def test_settled_codes_are_what_is_left_of_a_long_simulation(general: rs.design.Bank) -> None:
    generator, plant = general.generator, drive()
    found = settled_codes(generator)
    clean = generator.run(*recording(plant, 40, 0, noise=0.0))
    for j, fault in enumerate(plant.faults):
        moved = np.abs(generator.run(*recording(plant, 40, 0, faults={fault: 1.0}, noise=0.0)) - clean)
        for m, member in enumerate(generator.members):
            rows = list(member.residuals)
            largest, left = moved[:, rows].max(), moved[-10:, rows].max()
            assert found[m, j] == (left > max(1e-4 * largest, 1e-12)), (fault, member.name)  # less is rounding
    assert (found != generator.codes).any()


@pytest.mark.parametrize(
    ("which", "faults", "named"),
    [
        ("general", {"voltage actuator": 1.5}, ("current sensor", "voltage actuator")),
        ("general", {"current sensor": 2.0}, ("current sensor", "voltage actuator")),
        ("general", {"load speed sensor": 0.5}, ("load speed sensor",)),
        ("by_parts", {"current sensor": 0.5}, ("voltage actuator", "current sensor")),
    ],
)
def test_a_settled_fault_is_named_with_what_it_looks_like(
    which: str, faults: dict[str, float], named: tuple[str, ...], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    plant, bank = drive(), request.getfixturevalue(which)
    monitor = rs.Monitor(bank, dt=STEP, test=NormThreshold(persistence=5)).fit(*recording(plant, 60, 1))
    u, y = recording(plant, 15, 2, faults=faults)
    found = monitor.run(u, y)
    assert isinstance(found, rs.Diagnosis)
    alarm = found.main_alarm
    assert alarm is not None
    assert alarm.reading is not None
    assert alarm.reading.answer == "exact"
    assert (alarm.candidates[0].faults, alarm.candidates[0].score) == (named, 1.0)
    listed = [name for candidate in alarm.candidates for name in candidate.faults]
    assert len(listed) == len(set(listed)), "every fault once"
    names = list(found.columns())
    assert (
        len(names) == len(set(names)) == 3 + found.scores.shape[1] + found.residuals.shape[1] + 2 * len(found.members)
    )
    assert ", settled" in code_table(found)
    assert code_table(found).count('<span class="tag">read</span>') == 1
    if len(named) > 1:
        assert "once constant (exact)" in str(found)
        assert f"not distinguishable here: {named[0]}, {named[1]} once constant" in str(found)
    monitor.save(tmp_path / "m.json")
    again = rs.Monitor.load(tmp_path / "m.json").run(u, y)
    assert isinstance(again, rs.Diagnosis)
    assert again.naming.codes is not None
    assert found.naming.codes is not None
    assert again.naming.codes.settled == found.naming.codes.settled
    assert again.alarms == found.alarms


def test_a_single_estimate_is_not_called_a_direction() -> None:
    plant = drive()
    monitor = rs.Monitor(rs.design.fault_estimator(plant, faults=["voltage actuator"]), dt=STEP)
    monitor.fit(*recording(plant, 60, 1))
    found = monitor.run(*recording(plant, 15, 2, faults={"current sensor": 1.0}))
    assert isinstance(found, rs.Diagnosis)
    assert {"voltage actuator", "current sensor"} <= set(found.candidates[0].faults)
    assert found.no_direction
    assert "one estimate has no direction: any of these would look like this" in str(found)
    assert "estimated size, if it is voltage actuator: " in str(found)
    two = rs.Monitor(rs.design.fault_estimator(plant, faults=["voltage actuator", "motor speed sensor"]), dt=STEP)
    other = two.fit(*recording(plant, 60, 1)).run(*recording(plant, 15, 2, faults={"motor speed sensor": 5.0}))
    assert isinstance(other, rs.Diagnosis)
    assert other.alarms
    assert not other.no_direction


def test_a_short_recording_is_told_how_long_settling_takes() -> None:
    plant = drive()
    design = rs.design.unknown_input_observer(plant, poles=[-0.5, -1, -2, -3, -4]).residual_generator()
    monitor = rs.Monitor(design, dt=STEP)
    u, y = recording(plant, 60, 1)
    with pytest.raises(rs.errors.DataError, match=r"settling takes 1843 samples .* slowest pole, sampled at 0\.9975"):
        monitor.fit(u[:200], y[:200])
    found = monitor.fit(u, y).run(u[:200], y[:200])
    assert "settling takes 1843 samples" in str(found)
    assert monitor.settling_samples == 1843
    assert "settling takes" not in str(monitor.run(u, y))


def test_ranks_are_shared_by_ties_and_restarts_told_only_when_there_were_any(general: rs.design.Bank) -> None:
    plant = drive()
    monitor = rs.Monitor(general, test=NormThreshold(persistence=5)).fit(*recording(plant, 60, 1))
    u, y = recording(plant, 15, 2, faults={"current sensor": 2.0})
    y[100, 0] = np.nan
    text = str(monitor.run(u, y))
    assert "(tied with 2 more)" in text
    assert "1 sample with missing values: last values held, no decision there, nor at 9 after them" in text
    assert "restarted" not in text
    y[100:130, 0] = np.nan
    assert "filter restarted 1 time after longer gaps" in str(monitor.run(u, y))
