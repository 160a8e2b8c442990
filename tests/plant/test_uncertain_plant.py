from __future__ import annotations

import pickle

import numpy as np
import pytest

import residua as rs
from residua.errors import DesignError, ModelError, SettingError
from residua.linear import StateSpace
from residua.plant import Perturbation, UncertainPlant
from residua.robust.sets.uncertain_loop import check_members_stable, loop_parameters
from uncertain_examples import (
    D1,
    D2,
    G_A,
    G_B,
    G_C,
    H_A,
    H_B,
    H_C,
    A,
    B,
    C,
    jet_engine,
    jet_engine_controller,
)


def values_of(letter: str, f: np.ndarray) -> np.ndarray:
    """Return the diagonal of F of one matrix; the engine names its parameters dA1..dA6, dC1..dC3, dB1..dB3."""
    return np.diag(f[{"A": slice(0, 6), "C": slice(6, 9), "B": slice(9, 12)}[letter]])


def test_structure_of_the_closed_loop():
    """Robust l1 fault detection, eqs. (11)-(19)."""
    unc, controller = jet_engine(), jet_engine_controller()
    loop = unc.in_closed_loop(controller)
    Ac, Bc, Cc = controller.A, controller.B, controller.C
    assert loop.names == (*(f"dA{i}" for i in range(1, 7)), "dC1", "dC2", "dC3", "dB1", "dB2", "dB3")
    zero, wide = np.zeros((3, 3)), np.zeros((3, 6))
    # Eqs. (16)-(18): F_A = diag(F_Ap, F_Cp, F_Bp).
    assert np.allclose(loop.Hx, np.block([[H_A, zero, H_B], [wide, Bc @ H_C, zero]]), atol=1e-14, rtol=0)
    assert np.allclose(loop.Gx, np.block([[G_A, np.zeros((6, 3))], [G_C, zero], [zero, G_B @ Cc]]), atol=1e-14, rtol=0)
    assert np.allclose(loop.Hy, np.hstack([wide, H_C, zero]), atol=1e-14, rtol=0)
    for f in unc.sample_values(0, 20):
        dA, dB, dC = -H_A @ values_of("A", f) @ G_A, -H_B @ values_of("B", f) @ G_B, -H_C @ values_of("C", f) @ G_C
        member = loop.member(f)
        whole = np.block([[A + dA, (B + dB) @ Cc], [Bc @ (C + dC), Ac]])
        assert np.abs(member.A - whole).max() < 1e-14
        assert np.abs(member.C - np.hstack([C + dC, zero])).max() < 1e-14
        assert np.allclose(member.Bd, np.vstack([D1, Bc @ D2]), atol=1e-14, rtol=0)
        assert np.allclose(member.Bf, np.vstack([zero, Bc]), atol=1e-14, rtol=0)
        assert np.allclose(member.Df, np.eye(3), atol=1e-14, rtol=0)
    assert loop.nominal.inputs == ()


def test_closed_loop_runs_as_plant_and_controller_do_by_turns():
    rng = np.random.default_rng(1)
    unc, controller = jet_engine(), jet_engine_controller()
    # A direct term, uncertain as well, and a controller that names its channels in another order.
    deltas = [Perturbation("D", np.eye(3), 0.01 * np.ones((3, 3)), -1, 1, ["d1", "d2", "A1"])]
    deltas[0] = Perturbation("D", np.eye(3)[:, :2], 0.01 * np.ones((2, 3)), -1, 1, ["d1", "d2"])
    plant = unc.nominal
    direct = rs.Plant(A, B, C, 0.05 * rng.standard_normal((3, 3)), dt=0.01, outputs=plant.outputs)
    direct = direct.with_disturbances(D1, output=D2).with_sensor_faults().with_actuator_faults(["u2"])
    unc = UncertainPlant(direct, [Perturbation("B", H_B, G_B, -0.01, 0.01), *deltas])
    order = [2, 0, 1]
    named = controller.select(inputs=order).replaced(
        inputs=[plant.outputs[i] for i in order], outputs=["u1", "u2", "u3"]
    )
    loop = unc.in_closed_loop(named)
    f = unc.sample_values(2, 1)[0]
    member, inside = unc.member(f), loop.member(f)
    d, fault = rng.standard_normal((50, 3)), rng.standard_normal((50, 4))
    x, xc, y = np.zeros(3), np.zeros(3), []
    for k in range(50):
        u = controller.C @ xc
        y.append(member.C @ x + member.D @ u + member.Dd @ d[k] + member.Df @ fault[k])
        x = member.A @ x + member.B @ u + member.Bd @ d[k] + member.Bf @ fault[k]
        xc = controller.A @ xc + controller.B @ y[-1]
    found = inside.system(("disturbance", "fault")).simulate(np.hstack([d, fault]))
    assert np.abs(found - np.array(y)).max() < 1e-12


def test_residual_is_what_the_estimator_gives():
    rng = np.random.default_rng(3)
    loop = jet_engine().in_closed_loop(jet_engine_controller())
    n = loop.nominal
    W, P = 0.1 * rng.standard_normal((6, 3)), rng.standard_normal((2, 3))
    Ae = n.A + 0.01 * rng.standard_normal((6, 6))
    system = loop.estimator_residual(W, P, nuisances=["TMPC sensor"], nuisance_size=0.5, model=Ae)
    f = loop.sample_values(5, 1)[0]
    w = rng.standard_normal((60, 4))
    y = (
        loop.member(f)
        .system(("disturbance", "fault"))
        .simulate(np.hstack([w[:, :3], np.zeros((60, 2)), 0.5 * w[:, 3:]]))
    )
    estimator = StateSpace(Ae - W @ n.C, W, -P @ n.C, P, dt=0.01)
    assert np.abs(system.member(f).simulate(w) - estimator.simulate(y)).max() < 1e-12


def test_members_vertices_samples():
    unc = jet_engine()
    assert np.array_equal(unc.member({}).A, unc.nominal.A)
    assert unc.member({"dA1": 0.0011}).A[0, 0] == pytest.approx(0.8938 + 0.0011, abs=1e-15)
    values = unc.vertex_values()
    assert values.shape == (4096, 12)
    assert len(np.unique(values, axis=0)) == 4096
    assert all(unc.low[i] in values[:, i] and unc.high[i] in values[:, i] for i in range(12))
    some = unc.sample_values(7, 500)
    assert np.all((some >= unc.low) & (some <= unc.high))
    assert np.array_equal(unc.sample(7, 2)[1].C, unc.member(some[1]).C)


def test_a_name_in_two_places_is_one_parameter():
    plant = rs.Plant([[0.5, 0.1], [0, 0.4]], [[1.0], [0.0]], np.eye(2), dt=1)
    mass = Perturbation("A", [[1.0], [0.0]], [[1.0, 0.0]], -0.1, 0.2, "mass")
    unc = UncertainPlant(plant, [mass, Perturbation("B", [[2.0], [1.0]], [[1.0]], -0.1, 0.2, "mass")])
    assert (len(unc.parameters), unc.channels) == (1, (0, 0))
    member = unc.member([0.1])
    assert member.A[0, 0] == pytest.approx(0.4)
    assert member.B[:, 0] == pytest.approx([0.8, -0.1])
    with pytest.raises(ModelError, match=r"'mass' is given bounds \[0, 1\] in dB and \[-0.1, 0.2\] before"):
        UncertainPlant(plant, [mass, Perturbation("B", [[2.0], [1.0]], [[1.0]], 0, 1, "mass")])


def spring(v):
    """Return a mass on a spring: affine in stiffness and damping, not in the mass."""
    A = [[0, 1], [-v["stiffness"] / v["mass"], -v["damping"] / v["mass"]]]
    return rs.Plant(A, [[0], [1 / v["mass"]]], [[1, 0], [-v["stiffness"], 0]], name="spring")


def test_affine_in_physical_parameters():
    unc = UncertainPlant.from_parameters(spring, {"stiffness": (1, 2), "damping": (0.1, 0.1, 0.3), "mass": (1, 1)})
    assert unc.linearisation.exact
    assert (len(unc.parameters), len(unc.channels)) == (3, 2)  # the stiffness moves A and C by one channel
    assert unc.nominal_values.tolist() == [1.5, 0.1, 1.0]
    v = {"stiffness": 1.1, "damping": 0.25, "mass": 1.0}
    for name in ("A", "B", "C", "D"):
        assert np.abs(getattr(unc.member(v), name) - getattr(spring(v), name)).max() < 1e-13


def test_what_a_linearisation_leaves_out():
    unc = UncertainPlant.from_parameters(spring, {"stiffness": (1, 1), "damping": (0, 0), "mass": (1.0, 1.5, 2.0)})
    left = unc.linearisation
    assert not left.exact
    # 1 / m against its chord through the nominal mass: at the ends 2/3 -+ 1/4 instead of 1 and 1/2.
    assert left.deviation["B"][1, 0] == pytest.approx(1 - 2 / 3 - 0.25)
    assert left.relative == pytest.approx((1 - 2 / 3 - 0.25) / 0.5)
    assert left.worst["mass"] in (1.0, 2.0)
    assert not left.deviation["C"].any()
    assert "left out" in repr(unc)


def test_directions_that_move_are_told():
    def leaking(v):
        return rs.Plant([[-1.0]], [[1.0]], [[1.0]]).with_faults({"leak": [-v["area"]]})

    unc = UncertainPlant.from_parameters(leaking, {"area": (1, 2)})
    assert unc.linearisation.exact
    assert unc.member({"area": 1.25}).Bf == pytest.approx(-1.25)
    # 1 / area against its chord through the nominal area: at the ends 2/3 -+ 1/4 instead of 1 and 1/2
    left = UncertainPlant.from_parameters(lambda v: leaking({"area": 1 / v["area"]}), {"area": (1, 2)}).linearisation
    assert not left.exact
    assert left.relative == pytest.approx((1 - 2 / 3 - 0.25) / 0.5)
    assert left.deviation["Bf"] == pytest.approx(1 - 2 / 3 - 0.25)


def test_directions_of_noise_that_move_are_told():
    def shaken(v):
        return rs.Plant([[-1.0]], [[1.0]], [[1.0]]).with_noise(process=[[v["area"] ** 2]])

    left = UncertainPlant.from_parameters(shaken, {"area": (1, 2)}).linearisation
    assert not left.exact
    assert left.relative == 0
    assert left.deviation["Bw"] == pytest.approx(0.5)
    assert left.kept == pytest.approx({"Bw": 1 / 3})  # 1.5 for 1 to 2
    assert str(left) == "linearised: kept as in the nominal plant although they move: Bw by 33 % of their size"


def test_sampling_does_not_forget_what_was_left_out_before():
    def room(v):
        plant = rs.Plant([[-v["loss"], 0.1], [0.1, -0.3]], [[1.0], [0.0]], np.eye(2))
        return plant.with_disturbances([[2 * v["loss"] ** 2], [1.0]]).with_noise(process=np.diag([v["loss"] ** 2, 0.0]))

    continuous = UncertainPlant.from_parameters(room, {"loss": (0.8, 1.2)})
    assert continuous.linearisation is not None
    assert continuous.linearisation.kept == pytest.approx({"Bw": 0.2})
    assert continuous.linearisation.deviation["Bd"][0, 0] == pytest.approx(2 * 0.2**2)
    sampled = continuous.discretize(0.1)
    assert not sampled.linearisation.exact
    assert sampled.linearisation.kept["Bw"] > 0.15
    # sampled plants of the function itself are what it is compared with
    for x in (0.8, 1.2):
        off = np.abs(room({"loss": x}).discretize(0.1).Bd - sampled.member({"loss": x}).Bd)
        assert np.all(off <= sampled.linearisation.deviation["Bd"] + 1e-15)
        assert off[0, 0] > 0.5 * sampled.linearisation.deviation["Bd"][0, 0] > 1e-3
    # without the function, after pickling, what was left out before is told as well
    again = pickle.loads(pickle.dumps(continuous)).discretize(0.1)
    assert not again.linearisation.exact
    assert again.linearisation.before.kept == pytest.approx({"Bw": 0.2})
    assert "Bw by 20 %" in str(again)


def in_other_units(k: float, seed: int) -> rs.Plant:
    """Return a plant that went through other coordinates and back: entries that are zero are off by rounding."""
    rng = np.random.default_rng(seed)
    A, B, C = np.array([[0.9, 0.1, 0], [0, 0.8, k], [0.3, 0, 0.5]]), np.array([[1.0], [0], [2]]), np.eye(3)[[0, 2]]
    units, T = 10.0 ** np.array([-4.0, 0, 5]), np.linalg.qr(rng.standard_normal((3, 3)))[0]
    Ti = np.linalg.inv(T)
    Bd = (T @ (Ti @ np.array([[0.0], [1], [0]]))) * units[:, None]
    Du = C @ T @ (Ti @ B) - C @ B
    plant = rs.Plant(
        (T @ (Ti @ A @ T) @ Ti) * units[:, None] / units, (T @ (Ti @ B)) * units[:, None], C / units, Du, dt=1.0
    )
    return plant.with_disturbances(Bd)


def test_rounding_of_zeros_is_neither_uncertain_nor_left_out():
    plants = [in_other_units(k, seed) for seed, k in enumerate((0.1, 0.2, 0.3, 0.15))]
    assert any(np.any(plant.D != plants[0].D) for plant in plants)
    unc = UncertainPlant.from_plants(plants)
    assert (len(unc.parameters), len(unc.channels)) == (1, 1)
    assert unc.linearisation.exact
    for values, plant in zip(np.array([0, 0.1, 0.2, 0.05]) / 0.2 * (unc.high - unc.low)[0], plants, strict=True):
        assert np.abs(unc.member([values]).A - plant.A).max() <= 1e-12 * np.abs(plant.A).max()
    seeds = iter(range(1000))
    named = UncertainPlant.from_parameters(lambda v: in_other_units(v["k"], next(seeds)), {"k": (0.1, 0.3)})
    assert named.linearisation.exact
    assert len(named.channels) == 1


def test_a_sampled_plant_without_direct_term():
    """Sampling leaves rounding of zeros; what is left out are per cents of ranges that are there."""
    unc = UncertainPlant.from_parameters(spring, {"stiffness": (1, 1.2), "damping": (0.1, 0.3), "mass": (1, 1.1)})
    left = unc.discretize(0.1).linearisation
    assert 0 < left.relative < 0.2
    assert "inf" not in str(left)


def test_sampling_an_uncertain_plant():
    unc = UncertainPlant.from_parameters(spring, {"stiffness": (1, 1.2), "damping": (0.1, 0.3), "mass": (1, 1)})
    sampled = unc.discretize(0.1)
    assert sampled.nominal.dt == 0.1
    assert not sampled.linearisation.exact
    v = {"stiffness": 1.2, "damping": 0.3, "mass": 1.0}
    off = np.abs(sampled.member(v).A - spring(v).discretize(0.1).A)
    assert np.all(off <= sampled.linearisation.deviation["A"] + 1e-15)
    assert off.max() < 1e-4 < np.abs(sampled.member(v).A - sampled.nominal.A).max()


def test_a_list_of_plants():
    rng = np.random.default_rng(0)
    scale = 10.0 ** rng.integers(-4, 5, (3, 3))  # entries of very different size
    base = rng.standard_normal((3, 3)) * scale
    plants = [
        rs.Plant(base + 0.1 * scale * rng.standard_normal((3, 3)), rng.standard_normal((3, 1)), np.eye(3), dt=1)
        for _ in range(4)
    ]
    unc = UncertainPlant.from_plants(plants)
    assert len(unc.parameters) == 3
    assert unc.linearisation.exact
    assert unc.plants == tuple(plants)
    # Every mixture of the plants lies in the box: least squares finds its coordinates.
    stack = np.stack([np.hstack([p.A, p.B]) for p in plants])
    ends = np.stack([np.hstack([unc.member({name: p.high}).A, unc.member({name: p.high}).B])
                     for name, p in zip(unc.names, unc.parameters, strict=True)])  # fmt: skip
    unit = np.ptp(stack, axis=0) + (np.ptp(stack, axis=0) == 0)
    columns = ((ends - stack[0]) / unit).reshape(3, -1).T / unc.high
    for weights in rng.dirichlet(np.ones(4), 50):
        target = ((np.tensordot(weights, stack, 1) - stack[0]) / unit).ravel()
        c = np.linalg.lstsq(columns, target, rcond=None)[0]
        assert np.abs(columns @ c - target).max() < 1e-10
        member = unc.member(c)  # raises outside of the box
        assert np.abs(member.A - np.tensordot(weights, stack, 1)[:, :3]).max() <= 1e-9 * np.abs(stack).max()


def test_bad_requests():
    plant = rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1)
    one = Perturbation("A", [[1.0]], [[1.0]], -0.1, 0.1, "a")
    unc = UncertainPlant(plant, [one])
    with pytest.raises(ModelError, match=r"'a' = 0.2 lies outside of its bounds \[-0.1, 0.1\]"):
        unc.member([0.2])
    with pytest.raises(ModelError, match="unknown parameter 'b'"):
        unc.member({"b": 0.0})
    with pytest.raises(ModelError, match=r"low = 1 exceeds high = 0"):
        Perturbation("A", [[1.0]], [[1.0]], 1, 0)
    with pytest.raises(ModelError, match=r"\[0.1, 0.2\] of parameter 1 leave out 0, the nominal plant"):
        Perturbation("A", [[1.0]], [[1.0]], 0.1, 0.2)
    with pytest.raises(ModelError, match="of parameter 2 leave out 0"):
        Perturbation("A", [[1.0, 1.0]], [[1.0], [1.0]], -1, [0.2, -0.1])
    with pytest.raises(ModelError, match="one of A, B, C, D"):
        Perturbation("E", [[1.0]], [[1.0]], 0, 1)
    with pytest.raises(ModelError, match="must be 1 x 1 as A of the plant is"):
        UncertainPlant(plant, [Perturbation("A", [[1.0], [1.0]], [[1.0]], 0, 1)])
    with pytest.raises(ModelError, match="direct term"):
        unc.in_closed_loop(StateSpace([[0.1]], [[1]], [[1]], [[1]], dt=1))
    with pytest.raises(ModelError, match="dt=2 and the plant dt=1"):
        unc.in_closed_loop(StateSpace([[0.1]], [[1]], [[1]], dt=2))
    with pytest.raises(DesignError, match="not stable"):
        unc.in_closed_loop(StateSpace([[0.1]], [[1]], [[2]], dt=1))
    with pytest.raises(ModelError, match="in_closed_loop"):
        unc.estimator_residual([[1.0]], [[1.0]])
    with pytest.raises(ModelError, match="differ in their outputs"):
        UncertainPlant.from_plants([plant, rs.Plant([[0.5]], [[1.0]], [[1.0]], dt=1, outputs=["other"])])
    with pytest.raises(ModelError, match=r"\(low, high\) or \(low, nominal, high\)"):
        UncertainPlant.from_parameters(spring, {"mass": (1, 3, 2)})
    many = UncertainPlant(plant, [Perturbation("A", np.ones((1, 13)), np.ones((13, 1)), 0, 0.01)])
    with pytest.raises(SettingError, match=r"2\^13 corners"):
        many.vertices()


def test_a_controller_is_wired_by_name_or_in_order():
    plant = rs.Plant([[0.5, 0.1], [0, 0.3]], np.eye(2), np.eye(2), dt=1, inputs=["a", "b"], outputs=["p", "q"])
    unc = UncertainPlant(plant)
    gains = np.array([[-0.1, 0.0], [0.0, -0.2]])

    def controller(**names):
        return StateSpace(np.zeros((2, 2)), np.eye(2), gains, dt=1, **names)

    by_order = unc.in_closed_loop(controller()).nominal
    named = unc.in_closed_loop(controller(inputs=["p", "q"], outputs=["a", "b"])).nominal
    assert np.array_equal(by_order.A, named.A)
    turned = unc.in_closed_loop(controller(inputs=["q", "p"], outputs=["b", "a"])).nominal
    assert np.array_equal(turned.A[2:, :2], [[0, 1], [1, 0]]) or np.array_equal(turned.A[:2, 2:], gains[::-1])
    with pytest.raises(ModelError, match=r"inputs 'qq' are no outputs of the plant.*'q'"):
        unc.in_closed_loop(controller(inputs=["p", "qq"]))
    with pytest.raises(ModelError, match=r"outputs 'c' are no inputs of the plant.*'a'"):
        unc.in_closed_loop(controller(outputs=["b", "c"]))


def test_deviations_and_parameters():
    unc = UncertainPlant.from_parameters(spring, {"stiffness": (1, 2), "damping": (0.1, 0.1, 0.3), "mass": (1, 1)})
    assert loop_parameters(unc, {"stiffness": -0.5}) == {"stiffness": 1.0, "damping": 0.1, "mass": 1.0}
    found = loop_parameters(unc, unc.high - unc.nominal_values)
    assert found == {"stiffness": 2.0, "damping": 0.3, "mass": 1.0}
    assert unc.member(found).A[1, 0] == pytest.approx(-2.0)
    with pytest.raises(ModelError, match="outside"):
        loop_parameters(unc, {"stiffness": 0.6})
    check_members_stable(unc)
    drifting = UncertainPlant.from_parameters(spring, {"stiffness": (1, 2), "damping": (-0.1, 0.3), "mass": (1, 1)})
    with pytest.raises(DesignError, match=r"damping = -0\.1"):
        check_members_stable(drifting)


@pytest.mark.parametrize("fast", [1e6, 1e9, 1e12])
def test_a_fast_state_does_not_hide_what_is_left_out(fast):
    def stiff(v):
        return rs.Plant([[-(v["rate"] ** 2), 1.0], [0.5 * fast, -fast]], [[1.0], [0.0]], [[1.0, 0.0]])

    found = UncertainPlant.from_parameters(stiff, {"rate": (0.99, 1.01)}).linearisation
    assert found is not None
    assert not found.exact
    assert found.deviation["A"][0, 0] == pytest.approx(1e-4, rel=1e-3)
