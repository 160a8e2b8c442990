"""Banks: the structure that was promised, in transfer matrices and on simulated faults."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import residua as rs
from effort import cases
from generated import random_plant, simulate, singular_plant
from residua.design import Bank
from residua.errors import DesignError


def fired(bank: Bank, u: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return which members are far from zero on noise-free data."""
    r = bank.generator.run(u, y)
    size = max(np.abs(u).max(), np.abs(y).max()) * (1 + np.abs(bank.generator.system.D).max(axis=1))
    relative = np.abs(r).max(axis=0) / size
    return np.array([relative[list(m.residuals)].max() > 1e-7 for m in bank.generator.members])


def expected(bank: Bank, kind: str, scheme: str) -> np.ndarray:
    """Return the code matrix of a scheme over the faults of a kind."""
    count = sum(k == kind for k in bank.plant.fault_kinds)
    return np.eye(count, dtype=bool) if scheme == "dedicated" else ~np.eye(count, dtype=bool)


BANKS: dict[str, Callable[..., Bank]] = {
    "sensor": rs.design.sensor_fault_bank,
    "actuator": rs.design.actuator_fault_bank,
}


@pytest.mark.parametrize("seed", cases(range(12), 6))
@pytest.mark.parametrize("observer", ["unknown-input", "reduced-order", "minimal"])
@pytest.mark.parametrize("scheme", ["generalized", "dedicated"])
@pytest.mark.parametrize("kind", BANKS)
def test_every_single_fault_is_named(kind: str, scheme: str, observer: str, seed: int) -> None:
    """On data of every single fault, of any time course, exactly the members of its code fire."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, outputs=5, inputs=2, disturbances=int(seed % 2), faults=0, sensors=True, dt=0.1)
    plant = plant.with_actuator_faults()
    if (kind, scheme) == ("sensor", "dedicated") and (plant.disturbances or observer == "reduced-order"):
        with pytest.raises(DesignError, match="of the bank do not exist"):  # one measurement is too few for that
            BANKS[kind](plant, scheme=scheme, observer=observer)
        return
    bank = BANKS[kind](plant, scheme=scheme, observer=observer)
    mine = [i for i, k in enumerate(plant.fault_kinds) if k == kind]
    np.testing.assert_array_equal(bank.structure[:, mine], expected(bank, kind, scheme))
    np.testing.assert_array_equal(fired(bank, *simulate(plant, rng, 60)), False)
    for i, name in enumerate(plant.faults):
        np.testing.assert_array_equal(fired(bank, *simulate(plant, rng, 60, fault=name)), bank.structure[:, i])


@pytest.mark.parametrize("seed", cases(range(10), 4))
@pytest.mark.parametrize("observer", ["unknown-input", "reduced-order", "perfect", "minimal"])
def test_singular_plants(observer: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, n=5, rank=3, outputs=6, inputs=2, disturbances=int(seed % 2), faults=0)
    for kind, design in BANKS.items():
        bank = design(plant, observer=observer)
        mine = [i for i, k in enumerate(plant.fault_kinds) if k == kind]
        np.testing.assert_array_equal(bank.structure[:, mine], expected(bank, kind, "generalized"))
        points = np.exp(0.6j) if plant.dt else 0.6j
        Q = bank.generator.system.evaluate(points)[0]
        P = plant.system("fault").evaluate(points)[0]
        Qy = Q[:, len(plant.inputs) :]
        terms = np.abs(Qy) @ np.abs(P) + 1e-6 * np.abs(Qy).max(axis=1, keepdims=True) * np.abs(P).max(axis=0)
        through = np.abs(Qy @ P) / terms
        for row, member in enumerate(bank.generator.members):
            np.testing.assert_array_equal(through[list(member.residuals)].max(axis=0) > 1e-7, bank.structure[row])


def test_members_that_do_not_exist_are_told() -> None:
    plant = rs.Plant([[-1, 0, 0], [0, -2, 0], [0, 0, 0.5]], np.ones((3, 1)), [[1, 0, 1], [0, 1, 0], [1, 1, 0]])
    with pytest.raises(DesignError, match=r"'without y1': .*0\.5.*allow_missing"):
        rs.design.sensor_fault_bank(plant)
    bank = rs.design.sensor_fault_bank(plant, allow_missing=True)
    assert list(bank.failures) == ["without y1"]
    assert bank.members == ("without y2", "without y3")
    assert "no member 'without y1'" in str(bank)
    assert rs.design.sensor_fault_bank(plant, observer="minimal").failures == {}


def test_a_useless_bank_is_refused() -> None:
    """As many disturbances as measurements that are left: every residual would be zero whatever fails."""
    rng = np.random.default_rng(0)
    plant = random_plant(rng, n=2, outputs=3, disturbances=2, faults=0, dt=0.1)
    with pytest.raises(DesignError, match="zero whatever fails"):
        rs.design.sensor_fault_bank(plant)
    with pytest.raises(DesignError, match="used up"):
        rs.design.sensor_fault_bank(plant, observer="minimal")


def test_a_row_that_no_method_attains_says_who_is_not_seen() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    with pytest.raises(DesignError, match=r"cannot see|used up"):
        rs.design.structured_bank(plant, ["0011"])
    bank = rs.design.structured_bank(plant, ["0111", "0011"], allow_missing=True)
    assert list(bank.failures) == ["r2"]


def test_structures_in_every_notation() -> None:
    plant = rs.library.gertler()
    by_matrix = rs.design.structured_bank(plant, np.array([[0, 1], [1, 0]]))
    by_name = rs.design.structured_bank(plant, {"sees p2": ["p2"], "sees p1": "p1"})
    np.testing.assert_array_equal(by_matrix.structure, by_name.structure)
    assert by_name.members == ("sees p2", "sees p1")
    assert by_matrix.strongly_isolating
    assert by_matrix.groups == (("p1",), ("p2",))
    for bad in (["0"], ["2x"], [[0.5, 1]], [[0, 0]], [], {"r": ["p3"]}):
        with pytest.raises((DesignError, rs.errors.ModelError)):
            rs.design.structured_bank(plant, bad)


def test_options_are_checked() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    with pytest.raises(DesignError, match="scheme"):
        rs.design.sensor_fault_bank(plant, scheme="other")
    with pytest.raises(DesignError, match="scheme"):
        rs.design.actuator_fault_bank(plant, scheme="other")
    with pytest.raises(DesignError, match="unknown-input"):
        rs.design.sensor_fault_bank(plant, observer="other")


@pytest.mark.parametrize("seed", range(5))
def test_unknown_input_and_minimal_members_agree(seed: int) -> None:
    """Two methods, one residual space: each residual of the one is a filtered combination of the other's."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, outputs=4, disturbances=1, faults=2, sensors=True, dt=0.1)
    for name in plant.faults[2:]:
        sub = plant.faults_as_disturbances(name)
        first = rs.design.unknown_input_observer(sub).residual_generator()
        second = rs.design.decoupled_residual(plant, insensitive_to=name)
        for z in np.exp(1j * np.array([0.3, 1.1, 2.4])):
            a, b = first.system.evaluate(z)[0], second.system.evaluate(z)[0]
            stacked = np.linalg.svd(np.vstack([a / np.linalg.norm(a), b / np.linalg.norm(b)]), compute_uv=False)
            alone = np.linalg.matrix_rank(b / np.linalg.norm(b), tol=1e-9)
            assert int((stacked > 1e-9).sum()) == alone


def test_banks_of_every_kind_agree_on_the_codes() -> None:
    """Perfect observers and quotients have nothing in common but the plant."""
    plant = rs.library.ladder_circuit()
    perfect = rs.design.sensor_fault_bank(plant, observer="perfect")
    minimal = rs.design.sensor_fault_bank(plant, observer="minimal")
    plain = rs.design.sensor_fault_bank(rs.plant.without_algebraic_equations(plant))
    np.testing.assert_array_equal(perfect.structure, minimal.structure)
    np.testing.assert_array_equal(plain.structure, minimal.structure)
