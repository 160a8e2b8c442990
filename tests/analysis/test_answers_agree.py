"""Every pair of public answers about the same question agrees: with exact ranks, whatever the units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import residua as rs
from agreement import Disagreements, compare
from exact_answers import Exact
from residua.design.parity.relation_model import relation_model
from residua.plant.algebraic_equations import without_algebraic_equations
from residua.tolerances import BALANCED_RANK, NEAR
from whole_number_plants import KINDS, in_other_units, whole_number_plant

#: Plants of eighteen kinds; in the campaign many more.
FEW, MANY = range(18), range(2000)


def asked(seeds: range) -> Disagreements:
    """Ask about plants as they are, and in units over 2^-20 to 2^20."""
    out = Disagreements()
    for seed in seeds:
        plant = whole_number_plant(seed)
        exact = Exact(plant)
        compare(plant, exact, f"plant {seed}, {KINDS[seed % len(KINDS)]}", out, seed)
        compare(in_other_units(plant, seed), exact, f"plant {seed} in other units", out, seed)
    return out


def test_answers_are_the_exact_ones_in_any_units() -> None:
    out = asked(FEW)
    assert out.wrong == []
    assert out.refused == []
    assert out.counts["isolable"] == 2 * len(FEW)
    assert out.counts["attainable, constant"] >= 100


@pytest.mark.campaign
def test_answers_of_many_plants_are_the_exact_ones_in_any_units() -> None:
    out = asked(MANY)
    print(dict(out.counts), *out.refused, sep="\n")
    assert out.wrong == []
    assert len(out.refused) < 1e-3 * sum(out.counts.values())


@pytest.mark.parametrize("seed", range(20))
def test_designs_are_the_same_in_units_of_powers_of_two(seed: int) -> None:
    plant = whole_number_plant(17 + 18 * seed)
    other = in_other_units(plant, seed)
    mine, scaled = rs.diagnosability(plant), rs.diagnosability(other)
    np.testing.assert_allclose(mine.visibility, scaled.visibility, rtol=1e-6, atol=1e-12)
    ignored = plant.faults[:1]
    if not Exact(plant).exists([0]):
        return
    a, b = (rs.design.decoupled_residual(p, insensitive_to=ignored) for p in (plant, other))
    assert np.array_equal(a.structure, b.structure)
    np.testing.assert_allclose(np.sort_complex(a.system.poles()), np.sort_complex(b.system.poles()), rtol=1e-6)


def test_a_chain_of_five_integrators_with_a_dead_output() -> None:
    """A constant fault at the end of the chain moves nothing for good that a residual may keep: exactly."""
    n = 5
    for C in (np.vstack([np.eye(n)[[4]], np.zeros((1, n))]), np.vstack([np.eye(n)[[0, 4]], np.zeros((1, n))])):
        plant = rs.Plant(np.eye(n, k=-1), np.eye(n)[:, :1], C).with_actuator_faults().with_sensor_faults()
        plant = plant.with_faults({f"leak {i}": np.eye(n)[i] for i in range(n)})
        exact = Exact(plant)
        assert np.array_equal(rs.diagnosability(plant).strongly_detectable, exact.lasting())
        told = set(rs.coding.attainable(plant, constant=True).digits)
        for code in rs.coding.attainable(plant).digits:
            ignored = [i for i, c in enumerate(code) if c == "0"]
            ones = [i for i, c in enumerate(code) if c == "1"]
            assert (code in told) == bool(exact.lasting(ignored)[ones].all()), code


def test_constant_faults_at_a_plant_zero_at_the_limit() -> None:
    """Two integrators in series: what only the second fault leaves in the limit shrinks nowhere near it."""
    for seed in (274, 16, 34, 52, 70):
        plant = whole_number_plant(seed)
        out = Disagreements()
        compare(plant, Exact(plant), f"plant {seed}", out, seed)
        assert out.wrong == []


def test_one_plant_in_two_forms_has_the_same_answers() -> None:
    """Algebraic equations of index one, written out and solved."""
    solved = 0
    for seed in range(14, 14 + 18 * 40, 18):
        plant = whole_number_plant(seed)
        assert KINDS[seed % 18] == "index one"
        if plant.E is None or np.linalg.matrix_rank(plant.E) == plant.n_states:
            continue
        exact, found = Exact(plant), rs.diagnosability(plant)
        n = len(plant.faults)
        isolable = np.array([exact.visible([j]) for j in range(n)]).T & ~np.eye(n, dtype=bool)
        other = rs.diagnosability(without_algebraic_equations(plant).explicit())
        for form in (found, other):
            assert np.array_equal(form.isolable, isolable), seed
            assert np.array_equal(form.strongly_isolable, found.strongly_isolable), seed
            assert np.array_equal(form.strongly_detectable, exact.lasting()), seed
        solved += 1
    assert solved >= 20


def test_a_benchmark_plant_of_which_the_rates_lie_far_apart(shared_data: Path) -> None:
    """SLICOT's BD01_2_01, rates from 0.4 to 1e6: what diagnosability separates a residual does, and no more."""
    from scipy.io import loadmat

    data = loadmat(shared_data / "slicot_benchmarks" / "BD01_2_01.mat")
    for row in range(2):
        plant = rs.Plant(data["A"], data["B"], data["C"][[row]]).with_actuator_faults().with_sensor_faults()
        exact, found = Exact(plant), rs.diagnosability(plant)
        assert np.array_equal(found.detectable, exact.visible())
        made = rs.design.decoupled_residual(plant)
        assert np.array_equal(made.structure.any(axis=0), found.detectable)
        for j, name in enumerate(plant.faults):
            assert exact.exists([j]) is False
            with pytest.raises(rs.errors.DesignError, match="used up"):
                rs.design.decoupled_residual(plant, insensitive_to=name)


def test_designs_of_four_poles_at_one_are_not_looked_at_where_nothing_is_known() -> None:
    """At 3e-5 rad per sample ``zI - A`` is singular to the last bit: designs that exist were refused for that."""
    A = [[0.0, -1, -1, 0], [0, 0, 1, 1], [2, 1, 2, 0], [-1, -1, 1, 2]]
    plant = rs.Plant(A, [[-2.0], [-1], [2], [0]], [[2.0, 0, 2, 1], [2, 0, 1, 0], [1, 0, 1, 1]], dt=1.0)
    plant = plant.with_disturbances({"d": [2, 2, 1, -2]}).with_faults({"f": [1, 2, 1, 1], "g": [2, 0, -1, 2]})
    plant = plant.with_sensor_faults([0, 1])
    found = rs.diagnosability(plant)
    assert found.isolable.sum() == 4 * 3
    for name in plant.faults:
        made = rs.design.decoupled_residual(plant, insensitive_to=name)
        assert made.structure.any(axis=0).tolist() == [other != name for other in plant.faults]
    row = rs.design.structured_bank(plant, ["0111"]).structure[0]
    assert row.tolist() == [False, True, True, True]


def aircraft(folder: Path) -> rs.Plant:
    """Return the civil aircraft with its actuators: 32 states, 3 gusts, 8 primary actuators that may fail."""
    data = np.load(folder / "varga_case_studies" / "cs1data.npz")
    A, B, C, D = (data[name][6] for name in "ABCD")
    Aa, Ba, Ca, Da = (data[f"ACT_{name}"] for name in "ABCD")
    whole = np.block([[A, B[:, :22] @ Ca], [np.zeros((22, 10)), Aa]])
    Bu, Du = np.vstack([B[:, :22] @ Da, Ba]), D[:, :22] @ Da
    plant = rs.Plant(whole, Bu, np.hstack([C, D[:, :22] @ Ca]), Du)
    gusts = {f"gust {i + 1}": (np.concatenate([B[:, 22 + i], np.zeros(22)]), D[:, 22 + i]) for i in range(3)}
    primary = (0, 1, 14, 15, 16, 18, 17, 19)
    return plant.with_disturbances(gusts).with_faults({f"actuator {j + 1}": (Bu[:, j], Du[:, j]) for j in primary})


#: The structure that Varga asks for, Solving Fault Diagnosis Problems (2017), section 8.1, and the smallest orders.
STRUCTURE = {"01111010": 7, "10110110": 7, "11011010": 7, "11101100": 6, "11110000": 5, "00000001": 4}


def test_the_coding_set_of_an_aircraft_whose_model_holds_residue(shared_data: Path) -> None:
    """Zeros of a model that was linearised numerically are 1e-21 to 1e-32: they count as none, and move no units."""
    plant = aircraft(shared_data)
    assert plant.n_states == 32
    assert rs.coding.attainable(plant, list(STRUCTURE))
    model = relation_model(plant)
    for row, order in STRUCTURE.items():
        ignored = [fault for fault, digit in zip(plant.faults, row, strict=True) if digit == "0"]
        equations = model.equations(ignored, tolerance=NEAR * BALANCED_RANK)  # two ranks are near
        assert equations.orders is not None
        assert equations.orders[1] == order
    rows = [row for row in STRUCTURE if row != "11110000"]  # this one leaks as much as the limit allows, 1e-6
    bank = rs.design.structured_bank(plant, rows)
    assert bank.structure.astype(int).tolist() == [[int(one) for one in row] for row in rows]
    assert max(bank.generator.evidence.decoupling.values()) < 1e-8
    parity = rs.design.structured_parity(plant, list(STRUCTURE))  # its modes are 1e-3 of the couplings
    assert parity.generator.relations.orders == tuple(STRUCTURE.values())
    assert parity.structure.astype(int).tolist() == [[int(one) for one in row] for row in STRUCTURE]
    assert max(parity.generator.evidence.decoupling.values()) < 1e-7


def test_diagnosability_of_an_aircraft_needs_no_coordinates_that_nobody_asks_for(shared_data: Path) -> None:
    """Its hidden modes are known in balanced units; in those of the plant its hidden directions are not, to 4e-4."""
    plant = aircraft(shared_data)
    found = rs.diagnosability(plant)
    assert found.detectable.all()
    assert found.isolable.sum() == 8 * 7
    assert rs.coding.mutually_isolable(plant).matrix.tolist() == found.isolable.tolist()
    for name in ("actuator 18", "actuator 19"):  # what a design shows
        made = rs.design.decoupled_residual(plant, insensitive_to=name)
        assert made.structure.any(axis=0).tolist() == found.isolable[:, plant.faults.index(name)].tolist()
    existence = found.unknown_input_observer
    assert existence is not None
    assert not existence
    assert np.count_nonzero(np.abs(existence.fixed_poles) < 1e-9) == 2  # at zero the rank of the pencil falls by two


def test_feedback_changes_no_relation_that_exists(shared_data: Path) -> None:
    """With a feedback of outputs: the same rows by relations of the same order."""
    plant = aircraft(shared_data)
    K = np.load(shared_data / "varga_case_studies" / "cs1data.npz")["K"]
    M = np.linalg.inv(np.eye(10) + plant.D @ K)
    left = -plant.B @ K @ M
    closed = rs.Plant(plant.A + left @ plant.C, plant.B + left @ plant.D, M @ plant.C, M @ plant.D)
    for role in ("disturbances", "faults"):
        B, D = (plant.Bd, plant.Dd) if role == "disturbances" else (plant.Bf, plant.Df)
        columns = {name: ((B + left @ D)[:, i], (M @ D)[:, i]) for i, name in enumerate(getattr(plant, role))}
        closed = getattr(closed, f"with_{role}")(columns)
    assert rs.coding.attainable(closed, ["11110000"])
    bank = rs.design.structured_parity(closed, ["11110000"])
    assert bank.generator.relations.orders == (5,)
    assert bank.structure.tolist() == [[True] * 4 + [False] * 4]
