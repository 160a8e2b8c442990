"""Parity relations: against Chow and Willsky's scheme, simulations, other designs, and back and forth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import residua as rs
from generated import random_plant, simulate, singular_plant
from refusals import Refused
from residua.design.core.decoupling import Decoupled
from residua.design.core.generator import make_generator
from residua.errors import AccuracyError, DesignError, ModelError, SettingError


def constraints(plant: rs.Plant, order: int, ignored: list[int]) -> np.ndarray:
    """Return [R, Q of what is ignored], from powers of A, with the states in units that keep them small."""
    R, Q = rs.design.chow_willsky_matrices(plant, order)
    n_f = len(plant.faults)
    columns = [k * n_f + j for k in range(order + 1) for j in ignored]
    return np.hstack([R, Q["disturbance"], Q["fault"][:, columns]])


@pytest.mark.parametrize("seed", range(30))
def test_as_many_relations_as_the_scheme_of_chow_and_willsky_has(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 6)), int(rng.integers(2, 5))
    plant = random_plant(rng, n=n, outputs=m, disturbances=int(rng.integers(0, 2)), sensors=True, dt=0.1)
    ignored = sorted(rng.choice(len(plant.faults), size=int(rng.integers(0, m)), replace=False).tolist())
    names = [plant.faults[j] for j in ignored]
    for order in range(n + 1):
        M = constraints(plant, order, ignored)
        count = len(M) - np.linalg.matrix_rank(M, tol=1e-9 * np.linalg.norm(M, 2))
        if not count:
            with pytest.raises(DesignError):
                rs.design.parity_relations(plant, order=order, insensitive_to=names)
            continue
        relations = rs.design.parity_relations(plant, order=order, insensitive_to=names).relations
        assert relations is not None
        w = relations.parity_vectors
        assert w.shape == (count, (order + 1) * m)
        assert np.linalg.matrix_rank(w, tol=1e-9 * np.linalg.norm(w, 2)) == count
        assert np.abs(w @ M).max() < 1e-9 * np.abs(w).max() * np.linalg.norm(M, 2)


@pytest.mark.parametrize("seed", range(24))
def test_the_counting_rule(seed: int) -> None:
    """(4-4): with m - 1 signals ignored there is one relation, of order n, or n - s_u without feedthrough."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(3, 7)), int(rng.integers(2, 5))
    feedthrough = bool(seed % 2)
    plant = random_plant(rng, n=n, outputs=m, inputs=m, faults=0, feedthrough=feedthrough, dt=0.1)
    plant = plant.with_actuator_faults().with_sensor_faults()
    s_u = int(rng.integers(0, m))
    inputs = rng.choice(m, size=s_u, replace=False)
    outputs = rng.choice(m, size=m - 1 - s_u, replace=False)
    ignored = [plant.faults[i] for i in inputs] + [plant.faults[m + i] for i in outputs]
    order = n if feedthrough else n - s_u
    relations = rs.design.parity_relations(plant, insensitive_to=ignored).relations
    assert relations is not None
    assert relations.orders == (order,)


@pytest.mark.parametrize("seed", range(12))
def test_orders_of_output_sets_are_observability_indices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 7))
    plant = random_plant(rng, n=n, outputs=3, dt=float(rng.choice([0.0, 0.1])))
    A = plant.A.copy()
    A[: n // 2, n // 2 :] = 0.0  # an output that reads the first states only does not see the others
    C = plant.C.copy()
    C[0, n // 2 :] = 0.0
    plant = plant._with(A=A, C=C)
    orders = rs.design.parity_orders(plant)
    assert orders[("y1",)] == max(n // 2, 1) if n > 1 else 1
    assert orders[("y2",)] == orders[("y3",)] == n
    assert orders[("y2", "y3")] == n // 2
    assert set(rs.design.parity_orders(plant, most_outputs=1)) == {("y1",), ("y2",), ("y3",)}


@pytest.mark.parametrize("seed", range(20))
def test_residuals_are_zero_until_a_fault_that_they_answer_to(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=int(rng.integers(3, 8)), outputs=3, disturbances=1, sensors=True, dt=0.1)
    if np.abs(np.linalg.eigvals(plant.A)).max() > 1:
        plant = plant._with(A=plant.A * 0.9 / np.abs(np.linalg.eigvals(plant.A)).max())
    bank = rs.design.structured_parity(plant, ["01111", "10111"])
    for fault in (None, *plant.faults):
        u, y = simulate(plant, rng, 60, fault)
        r = bank.generator.run(u, y)
        late = np.abs(r[max(bank.generator.relations.orders) :]).max(axis=0)  # a moving average forgets its start
        scale = np.abs(bank.generator.relations.output_rows.coefficients).sum() * np.abs(y).max()
        expected = np.zeros(2, dtype=bool) if fault is None else bank.structure[:, plant.faults.index(fault)]
        assert ((late > 1e-9 * scale) == expected).all()


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(8))
def test_poles_can_be_anything_stable(seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, outputs=2, dt=dt)
    flt = rs.design.parity_relations(plant, insensitive_to="f0")
    (order,) = flt.relations.orders
    poles = [0.5, 0.3 + 0.2j, 0.3 - 0.2j] if dt else [-1.0, -2 + 1j, -2 - 1j]
    assert order == 3
    made = flt.with_poles(poles)
    assert np.allclose(np.sort_complex(made.system.poles()), np.sort_complex(np.array(poles)), atol=1e-12)
    w = np.logspace(-2, 1, 9)
    points = np.exp(1j * w * dt) if dt else 1j * w
    d = np.prod([points - pole for pole in poles], axis=0)
    rows = flt.relations
    n = np.concatenate([rows.input_rows.evaluate(points), rows.output_rows.evaluate(points)], axis=2)
    found = made.system.frequency_response(w)
    assert np.allclose(found * d[:, None, None], n, rtol=1e-9, atol=1e-9 * np.abs(n).max())


@pytest.mark.parametrize(
    ("poles", "match"),
    [
        ([0.5], "order 3"),
        ([0.5, 0.2, 1.0], "not stable"),
        ([0.5, 0.2 + 0.1j, 0.1], "without its conjugate"),
        ([0.5, 0.2, np.nan], "finite"),
        (["a", "b", "c"], "numbers"),
        ({"r2": [0.1, 0.2, 0.3]}, "no 'r2'"),
        ({}, "none for 'r1'"),
    ],
)
def test_poles_that_do_not_fit_are_refused(poles, match: str) -> None:
    plant = random_plant(np.random.default_rng(3), n=4, outputs=2, dt=0.1)
    with pytest.raises(SettingError, match=match):
        rs.design.parity_relations(plant, insensitive_to="f0", poles=poles)


def same(first: rs.design.ResidualGenerator, second: rs.design.ResidualGenerator) -> str:
    found = first.equivalent_to(second)
    w = np.logspace(-2, 0, 7)
    if found.kind in ("identical", "scale", "poles"):
        points = np.exp(1j * w * first.dt) if first.dt else 1j * w
        for row in found.rows:
            i, j = first.residuals.index(row.first), second.residuals.index(row.second)
            a = first.system.frequency_response(w)[:, i] * row.evaluate(points)[:, None]
            b = second.system.frequency_response(w)[:, j]
            assert np.allclose(a, b, rtol=1e-5, atol=1e-6 * np.abs(b).max())
    elif found:
        V = found.transformation(w)
        a, b = first.system.frequency_response(w), second.system.frequency_response(w)
        assert np.allclose(V @ a, b, rtol=1e-6, atol=1e-6 * np.abs(b).max())
    return found.kind


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(10))
def test_there_and_back(seed: int, dt: float) -> None:
    """An observer's residuals as parity relations, with the observer's poles again, are the observer's."""
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=int(rng.integers(2, 7)), outputs=3, dt=dt)
    n = plant.n_states
    poles = np.linspace(0.1, 0.6, n) if dt else -np.linspace(1, 3, n)
    observer = rs.design.luenberger_observer(plant, poles=list(poles)).residual_generator()
    relations = observer.to_parity()
    assert same(observer, relations.with_poles()) == "poles"
    back = relations.with_poles({name: poles[:k] for name, k in zip(relations.names, relations.orders, strict=True)})
    assert same(observer, back) in ("identical", "scale", "poles")
    if all(k == n for k in relations.orders):
        assert same(observer, back) in ("identical", "scale")


def test_what_equivalence_tells() -> None:
    rng = np.random.default_rng(8)
    plant = random_plant(rng, n=4, outputs=3, dt=0.1)
    one = rs.design.luenberger_observer(plant, poles=[0.1, 0.2, 0.3, 0.4]).residual_generator()
    other = rs.design.luenberger_observer(plant, poles=[0.5, 0.2, -0.3, 0.4]).residual_generator()
    part = rs.design.decoupled_residual(plant, insensitive_to="f0")
    apart = rs.design.decoupled_residual(plant, insensitive_to="f1")
    assert same(one, one) == "identical"
    assert same(one, other) == "transformation"
    assert same(one, part) == "part"
    assert not one.equivalent_to(part)
    assert same(part, one) == "whole"
    assert not part.equivalent_to(one)
    assert same(part, apart) == "different"
    with pytest.raises(ModelError):
        one.equivalent_to(rs.design.luenberger_observer(rs.library.gertler()).residual_generator())


def test_residuals_in_another_order_and_scale_are_the_same() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    one = rs.design.structured_parity(plant, ["0111", "1011", "1101"]).generator
    other = rs.design.structured_parity(plant, ["1101", "0111", "1011"]).generator
    found = one.equivalent_to(other)
    assert found.kind == "scale"
    assert [row.gain for row in found.rows] == pytest.approx([1, 1, 1])
    assert "up to factors and order" in str(found)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.refusals(at_most=0)
def test_singular_plants(seed: int, refused: Refused) -> None:
    rng = np.random.default_rng(seed)
    plant = singular_plant(rng, faults=2)
    rows = np.ones((1, len(plant.faults)), dtype=bool)
    rows[0, int(rng.integers(len(plant.faults)))] = False
    try:
        bank = rs.design.structured_bank(plant, rows)
    except DesignError as error:
        with pytest.raises(DesignError):
            rs.design.structured_parity(plant, rows)
        refused.skip(error)
    relation = rs.design.structured_parity(plant, rows)
    assert (relation.structure == bank.structure).all()
    assert bank.generator.equivalent_to(relation.generator).kind != "different"


def test_an_input_output_model_and_its_plant_have_the_same_relations() -> None:
    rng = np.random.default_rng(1)
    plant = random_plant(rng, n=4, outputs=3, sensors=True, dt=0.1)
    io = rs.InputOutputModel.from_plant(plant)
    rows = ["01110", "11001"]
    a, b = (rs.design.structured_parity(source, rows).generator for source in (plant, io))
    assert same(a, b) in ("scale", "identical")
    assert b.relations is not None
    assert b.relations.orders == a.relations.orders
    assert any("share factors" in note for note in b.evidence.notes)


def test_what_only_approximates_a_relation_is_none() -> None:
    plant = random_plant(np.random.default_rng(2), n=3, outputs=2, dt=0.0)
    sampled = rs.design.luenberger_observer(plant).residual_generator().discretize(0.01)
    with pytest.raises(AccuracyError, match="approximates"):
        sampled.to_parity()


def test_the_moving_averages_of_a_stable_plant_in_its_own_poles_are_the_arma_residuals() -> None:
    plant = random_plant(np.random.default_rng(4), n=4, outputs=2, dt=0.0)
    plant = plant._with(A=plant.A - 4 * np.eye(4))
    io = rs.InputOutputModel.from_plant(plant)
    arma = rs.design.primary_residuals(io, form="arma")
    same_poles = rs.design.primary_residuals(io, poles=list(plant.system(()).poles()))
    assert same(arma, same_poles) in ("identical", "scale")


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda p: rs.design.primary_residuals(p, form="iir"), "'ma' or 'arma'"),
        (lambda p: rs.design.primary_residuals(p, form="arma", poles=[0.1]), "leave them out"),
        (lambda p: rs.design.primary_residuals(p._with(A=1.5 * np.eye(3)), form="arma"), "not stable"),
        (lambda p: rs.design.parity_relations(p, order=-1), "whole number"),
        (lambda p: rs.design.parity_relations(p, order=1.5), "whole number"),
        (lambda p: rs.design.parity_relations(p, order=40), "shifted copies"),
        (lambda p: rs.design.parity_orders(p, most_outputs=0), "1 at least"),
        (lambda p: rs.design.structured_parity(p, {"a": ["p1"]}, poles={"a": [0, 0], "b": [0]}), "no 'b'"),
        (lambda p: rs.design.structured_parity(p, {"a": ["p1"]}, poles={}), "none for 'a'"),
        (lambda p: rs.design.parity_relations(p, order=1, insensitive_to="p1"), "smallest order is 2"),
        (lambda p: rs.design.parity_relations(p, insensitive_to=["p1", "p2"]), "used up"),
        (lambda p: rs.design.structured_parity(p, ["01"], poles={"r2": [0.1]}), "no 'r2'"),
        (lambda p: rs.design.chow_willsky_matrices(p, -1), "whole number"),
    ],
)
def test_errors_say_what_to_do(call, match: str) -> None:
    with pytest.raises((DesignError, SettingError), match=match):
        call(rs.library.gertler())


def test_what_is_no_plant_is_refused() -> None:
    with pytest.raises(ModelError, match="InputOutputModel"):
        rs.design.parity_relations(np.eye(2))  # pyright: ignore[reportArgumentType]


def test_a_bank_of_relations_names_the_fault_and_can_be_saved(tmp_path: Path) -> None:
    plant = rs.library.gertler(sensor_faults=True).with_noise(process=1e-6, measurement=1e-6)
    bank = rs.design.structured_parity(plant, ["0111", "1011", "1101", "1110"])
    monitor = rs.Monitor(bank)
    rng = np.random.default_rng(0)
    u = rng.standard_normal((600, 1))
    for j, fault in enumerate(plant.faults):
        f = np.zeros((600, 4))
        f[300:, j] = 1.0
        w = rng.standard_normal((600, plant.Bw.shape[1]))
        y = plant.system(("control", "fault", "noise")).simulate(np.hstack([u, f, w]))
        diagnosis = monitor.run(u, y)
        assert diagnosis.alarms[-1].candidates[0].faults == (fault,)
    path = tmp_path / "monitor.json"
    monitor.save(path)
    again = rs.Monitor.load(path)
    assert np.array_equal(again.run(u, y).residuals, diagnosis.residuals)
    assert again.generator.to_parity().orders == bank.generator.relations.orders


def test_what_cancels_is_told() -> None:
    """Poles near one: a moving average of slow signals is a small difference of large terms; with poles it is not."""
    A = np.diag([0.99, 0.985, 0.98, 0.97]) + np.diag([0.01] * 3, 1)
    plant = rs.Plant(A, [[0], [0], [0], [1]], [[1, 0, 0, 0]], dt=1.0).with_faults({"leak": [0, 0, 1, 0]})
    moving = rs.design.parity_relations(plant, poles=np.zeros(4))
    with_poles = moving.with_poles([0.95, 0.94, 0.93, 0.92])
    lost = "digits lost to cancellation"
    assert moving.evidence.conditions[lost] > 4
    assert with_poles.evidence.conditions[lost] < moving.evidence.conditions[lost] - 3


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(6))
def test_the_transformation_as_a_filter_turns_one_observer_into_the_other(seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=4, outputs=3, dt=dt)
    here, there = ([0.1, 0.2, 0.3, 0.4], [0.5, 0.25, -0.3, 0.45]) if dt else ([-1, -2, -3, -4], [-1.5, -5, -3.5, -6])
    a, b = (rs.design.luenberger_observer(plant, poles=p).residual_generator() for p in (here, there))
    V = a.equivalent_to(b).realization()
    assert np.allclose(np.sort_complex(V.poles()), np.sort_complex(np.array(there, dtype=complex)), atol=1e-6)
    w = np.logspace(-2, 1, 11)
    assert np.allclose(V.frequency_response(w) @ a.system.frequency_response(w), b.system.frequency_response(w))
    assert a.equivalent_to(b).matrix is None
    part = rs.design.decoupled_residual(plant, insensitive_to="f0")
    reduced = a.equivalent_to(part).realization()
    assert np.allclose(
        reduced.frequency_response(w) @ a.system.frequency_response(w), part.system.frequency_response(w)
    )
    with pytest.raises(DesignError, match="no transformation"):
        part.equivalent_to(a).realization()


def test_a_mixture_is_told_as_a_matrix() -> None:
    plant = random_plant(np.random.default_rng(2), n=4, outputs=3, dt=0.1)
    observer = rs.design.luenberger_observer(plant, poles=[0.1, 0.2, 0.3, 0.4])
    weight = np.random.default_rng(1).standard_normal((3, 3))
    mixed = rs.residual_generator_from_observer(plant, gain=observer.K, weight=weight)
    found = observer.residual_generator().equivalent_to(mixed).matrix
    assert found is not None
    assert np.allclose(found, weight)


def test_a_delay_cannot_be_undone_by_a_filter() -> None:
    plant = rs.library.gertler()
    now = rs.design.parity_relations(plant, insensitive_to="p1")
    system = now.system
    late = system.replaced(  # one step later
        A=np.block([[system.A, np.zeros((2, 1))], [system.C, np.zeros((1, 1))]]),
        B=np.vstack([system.B, system.D]),
        C=np.array([[0.0, 0.0, 1.0]]),
        D=np.zeros_like(system.D),
        states=None,
    )
    delayed = make_generator(
        late,
        plant,
        "late",
        now.evidence,
        decouples=Decoupled(),
    )
    found = now.equivalent_to(delayed)
    assert found.kind == "poles"
    assert found.rows[0].poles.tolist() == pytest.approx([0.0], abs=1e-9)
    with pytest.raises(DesignError, match="answers late"):
        delayed.equivalent_to(now).realization()


def test_a_zero_of_its_own_makes_a_filter() -> None:
    """r filtered by (z - 0.5)^2 / z^2 is more than other poles."""
    plant = rs.library.gertler()
    now = rs.design.parity_relations(plant, insensitive_to="p1")
    zero = rs.StateSpace([[0, 1], [0, 0]], [[0], [1]], [[0.25, -1]], [[1]], dt=1.0)
    made = make_generator(
        now.system.series(zero),
        plant,
        "zero",
        now.evidence,
        decouples=Decoupled(),
    )
    found = now.equivalent_to(made)
    assert found
    assert found.kind == "filter"
    assert np.allclose(made.to_parity().divided[0], [0.5, 0.5], atol=1e-4)
    assert made.to_parity().orders == (2,)


def test_poles_by_row_go_to_their_row() -> None:
    poles = {"a": [0.1, 0.15], "b": [0.5, 0.55]}
    bank = rs.design.structured_parity(rs.library.gertler(), {"a": ["p1"], "b": ["p1"]}, poles=poles)
    for i, wanted in enumerate(poles.values()):
        found = bank.generator.system.A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        assert np.allclose(np.sort(np.linalg.eigvals(found)), wanted)
    assert bank.generator.residuals == ("a", "b")


def test_a_bank_with_other_poles_is_still_a_bank() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    bank = rs.design.structured_parity(
        plant, {"a": ["p1", "y1 sensor", "y2 sensor"], "b": ["p2", "y1 sensor", "y2 sensor"]}
    )
    slow = bank.generator.with_poles([0.5, 0.6])
    assert slow.codes is not None
    assert np.array_equal(slow.codes, bank.structure)
    assert [member.name for member in slow.members] == ["a", "b"]
    assert slow.method == bank.generator.method


def test_wrong_poles_are_not_taken_for_rows_that_do_not_exist() -> None:
    with pytest.raises(SettingError, match="order 2"):
        rs.design.structured_parity(rs.library.gertler(), ["01", "10"], poles=[0.5], allow_missing=True)


def test_a_bank_is_equal_to_itself_with_more_residuals_than_outputs() -> None:
    plant = rs.library.gertler(sensor_faults=True)
    bank = rs.design.structured_parity(plant, rs.coding.choose(plant))
    slow = bank.generator.with_poles(
        {name: [0.3] * k for name, k in zip(["r1", "r2", "r3", "r4"], (2, 2, 2, 2), strict=True)}
    )
    found = bank.generator.equivalent_to(bank)
    assert found.matrix is not None
    np.testing.assert_allclose(found.matrix, np.eye(4), rtol=1e-14)  # gains are sums over frequency, to some roundings
    V = bank.generator.equivalent_to(slow).realization()
    w = np.logspace(-2, 0, 9)
    a, b = bank.generator.system.frequency_response(w), slow.system.frequency_response(w)
    assert np.allclose(V.frequency_response(w) @ a, b, atol=1e-9)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_equivalence_does_not_depend_on_the_unit_of_time(unit: float) -> None:
    plant = random_plant(np.random.default_rng(6), n=3, outputs=2, dt=0.0)
    plant = plant._with(A=plant.A * unit, B=plant.B * unit, Bf=plant.Bf * unit)
    a = rs.design.decoupled_residual(plant, insensitive_to="f0", poles=[-1 * unit, -2 * unit])
    b = rs.design.parity_relations(plant, insensitive_to="f0", poles=[-3 * unit, -2 * unit])
    found = a.equivalent_to(b)
    assert found.kind == "poles"
    assert np.allclose(found.rows[0].zeros / unit, [-1], rtol=1e-6)
    assert np.allclose(found.rows[0].poles / unit, [-3], rtol=1e-6)


def test_primary_residuals_keep_the_noise_of_a_plant() -> None:
    plant = rs.library.gertler().with_noise(process=0.01, measurement=0.02)
    for form in ("ma", "arma"):
        made = rs.design.primary_residuals(plant, form=form)
        assert made.plant.noises
        assert made.covariance is not None


def test_an_input_output_model_says_when_a_plant_is_needed() -> None:
    io = rs.InputOutputModel.from_plant(rs.library.gertler())
    with pytest.raises(AttributeError, match="to_plant"):
        rs.diagnosability(io)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = io.nothing


def test_relations_of_a_triple_pole_read_their_outputs() -> None:
    A = [[-2, 1, 0], [-1, -2, 1], [0, 1, -2]]  # nilpotent but for the pole at -2
    plant = rs.Plant(A, [[-1], [2], [3]], [[-1, 0, 1], [1, 0, 0]])
    made = rs.design.primary_residuals(plant)  # (-1, 0, 1) A = -2 (-1, 0, 1)
    assert made.relations.orders == (1, 3)
    assert np.allclose(made.relations.output_rows.coefficients[:, 0, 0], [2, 1, 0, 0])


def rod(n: int) -> rs.Plant:
    """Return a rod through which heat diffuses, heated at one end, measured at six places, sampled."""
    A = (np.diag(-2 * np.ones(n)) + np.diag(np.ones(n - 1), 1) + np.diag(np.ones(n - 1), -1)) * (n / 10) ** 2
    C = np.eye(n)[np.linspace(0, n - 1, 6).round().astype(int)]
    plant = rs.Plant(A, np.eye(n)[:, [0]] * (n / 10) ** 2, C).discretize(0.1)
    plant = plant.with_actuator_faults().with_sensor_faults()
    return plant.with_disturbances({"d": np.roll(plant.B[:, 0], n // 2)})


def beam() -> rs.Plant:
    """Return twenty lightly damped modes with rates from 1 to 400, measured at one place."""
    rates = np.arange(1.0, 21.0) ** 2
    A = np.block([[np.zeros((20, 20)), np.eye(20)], [-np.diag(rates**2), -0.02 * np.diag(rates)]])
    shape = np.sin(np.outer([0.6, 1.1], np.arange(1, 21)))
    plant = rs.Plant(
        A, np.concatenate([np.zeros(20), shape[0]])[:, None], np.concatenate([shape[1], np.zeros(20)])[None]
    )
    return plant.with_actuator_faults().with_sensor_faults()


@pytest.mark.parametrize(("plant", "least_squares"), [(rod(100), False), (beam(), True)], ids=["rod", "beam"])
def test_relations_of_high_order_keep_their_digits(plant: rs.Plant, least_squares: bool) -> None:
    """With all poles at one rate those of the beam would be lost."""
    made = rs.design.parity_relations(plant)
    assert made.relations.orders[0] * made.n_residuals == made.system.n_states >= 8
    assert max(made.evidence.decoupling.values()) < 1e-10
    assert made.structure.any()
    assert any("least squares" in note for note in made.evidence.notes) == least_squares


@pytest.mark.parametrize("n", [80, 90, 120])
def test_of_rows_that_hold_to_rounding_the_newest_sample_chooses(n: int) -> None:
    """Any of them was taken, and its digits were lost: these rods were refused."""
    made = rs.design.parity_relations(rod(n))
    assert max(made.evidence.decoupling.values()) < 1e-10
    assert made.structure.any()


def test_a_double_pole_at_zero_that_rounding_moves_is_no_obstacle() -> None:
    A = np.zeros((5, 5))
    A[3:, 3:] = [[1, 1], [-1, -1]]
    plant = rs.Plant(A, np.zeros((5, 0)), [[2, 2, 3, -3, -1], [-3, -2, 1, -1, -3], [3, -3, 4, -5, -6]])
    plant = plant.with_disturbances({"d": [1, 2, 3, -1, -3]})
    plant = plant.with_faults({"f1": [2, -1, -3, -1, -3], "f2": [0, 3, 2, 2, 2], "f3": [0, -2, 0, -2, 3]})
    assert rs.design.parity_relations(plant).structure.any()
    assert rs.design.primary_residuals(plant).structure.any()


def test_a_chain_of_integrators_keeps_its_whole_numbers() -> None:
    plant = rs.Plant(np.eye(12, k=1), np.eye(12)[:, [-1]], np.eye(12)[[0]]).with_sensor_faults()
    made = rs.design.parity_relations(plant)
    assert made.relations.orders == (12,)
    assert max(made.evidence.decoupling.values()) < 1e-9
    np.testing.assert_array_equal(made.relations.output_rows.coefficients.ravel(), np.eye(13)[12])


def test_what_nothing_connects_is_not_mixed() -> None:
    A = np.diag([-1.0, -2, -1, -2]) + np.diag([1.0, 0, 1], -1)
    plant = rs.Plant(A, np.eye(4)[:, [0, 2]], np.eye(4)[[1, 3]]).with_sensor_faults()
    assert rs.design.parity_relations(plant).structure.sum(axis=1).tolist() == [1, 1]
