"""Gertler's survey of 1991, section 6: relations for model variants, and parameters that do not reach a residual."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from residua.robust.parity.insensitive_parity import insensitive_parity
from residua.robust.parity.multi_model_parity import model_spread, multi_model_parity
from residua.robust.parity.optimal_parity import optimal_parity
from residua.robust.parity.select_equations import select_equations

FAULTS = {"p1": [1, 1, 0], "p2": [0, 1, 1]}
SLOW = 10.0


def example(a: float = 0.4, b: float = 0.5, c: float = 0.9, gain: float = 1.0) -> rs.Plant:
    """The plant of examples 2 and 3 with other poles, or another gain."""
    B, C = np.array([[0.5], [1.0], [0.1]]), [[1, 1, 0], [0, 1, 1]]
    return rs.Plant(np.diag([a, b, c]), gain * B, C, dt=1.0).with_faults(FAULTS)


def variants() -> list[rs.Plant]:
    return [example(), example(a=0.45), example(b=0.55), example(a=0.35, b=0.45)]


def without_inputs(plant: rs.Plant) -> rs.Plant:
    return rs.Plant(plant.A, np.zeros((3, 0)), plant.C, dt=1.0).with_faults(FAULTS)


def test_equation_6_4_is_the_part_without_inputs() -> None:
    """The relations are the last left singular vectors of [R1, R2, ...], in units of the outputs."""
    models = [without_inputs(plant) for plant in variants()]
    found = multi_model_parity(models, order=4, relations=3, states=1.0)
    R = np.hstack([rs.design.chow_willsky_matrices(plant, 4)[0] for plant in models]) / 2  # four models alike
    units = np.tile(found.units, 5)
    U, s, _ = np.linalg.svd(R / units[:, None])
    np.testing.assert_allclose(found.singular_values[: len(s)], s, rtol=1e-9, atol=1e-14)
    W = found.output_weights.reshape(3, -1) * units
    np.testing.assert_allclose(np.abs(np.sum(W.T * U[:, ::-1][:, :3], axis=0)), 1, atol=1e-6)


def test_each_variant_imposes_n_constraints() -> None:
    """N = (n' + 1) m unknowns: with kappa variants of n states an exact relation needs N > kappa n."""
    models = [without_inputs(example(c=c, a=a, b=b)) for a, b, c in ((0.4, 0.5, 0.9), (0.3, 0.6, 0.8))]
    for order, exact in ((1, 0), (2, 0), (3, 2)):
        s = multi_model_parity(models, order=order, states=1.0).singular_values
        assert np.count_nonzero(s < 1e-13) == exact == max(0, 2 * (order + 1) - 6)


def test_rank_leaves_the_best_fit_and_its_error() -> None:
    """Eq. (6-5): no matrix of rank rho is nearer to all variants; what it misses are the singular values left out."""
    models = [without_inputs(plant) for plant in variants()]
    found = multi_model_parity(models, order=4, rank=5, states=1.0)
    assert len(found.output_weights) == 10 - 5
    R = np.hstack([rs.design.chow_willsky_matrices(plant, 4)[0] for plant in models]) / 2
    W = found.output_weights.reshape(5, -1)
    error = np.linalg.norm(W @ R) ** 2
    assert error == pytest.approx((found.singular_values[5:] ** 2).sum(), rel=1e-9)
    rng = np.random.default_rng(0)
    scaled = R / np.tile(found.units, 5)[:, None]
    for _ in range(200):
        Q = np.linalg.qr(rng.standard_normal((10, 5)))[0]
        assert np.linalg.norm(Q.T @ scaled) ** 2 > error


def test_one_relation_for_all_variants_of_the_example() -> None:
    """The constant fault p2 that moves the residual as far as it leaks anyway: of the worst variant, by simulation."""
    models = variants()
    both = multi_model_parity(models, order=2, criterion="faults", correlation_time=SLOW)
    exact = optimal_parity(models[0], order=2, faults="p2", constant=True).generator
    leak = model_spread(exact, models, correlation_time=SLOW)[:, 0]
    assert leak[0] < 1e-12 < 1e-3 < leak[1:].min()
    alone = leak / np.abs([_settled(exact, plant) for plant in models])
    together = both.leak[:, 0] / np.abs([_settled(both.generator, plant) for plant in models])
    np.testing.assert_allclose(together, both.smallest_faults[:, 1], rtol=1e-6)
    assert together.max() < 0.5 * alone.max()


def _settled(generator: rs.design.ResidualGenerator, plant: rs.Plant) -> float:
    f = np.zeros((300, 2))
    f[:, 1] = 1.0
    y = plant.system(("fault",)).simulate(f)
    return float(generator.run(np.zeros((300, 1)), y)[-1, 0])


def test_frank_and_wuennenberg_on_the_example() -> None:
    """w R = 0, and |w Q_f| / |w Q_d| is the largest generalised singular value, with a fault for the disturbance."""
    plant = example().with_sensor_faults()
    wanted = ["p2", "y1 sensor", "y2 sensor"]
    found = optimal_parity(plant, order=3, faults=wanted[0], insensitive_to=["y1 sensor", "y2 sensor"])
    R, Q = rs.design.chow_willsky_matrices(plant, 3)
    N = scipy.linalg.null_space(R.T).T
    columns = [slice(i, None, 4) for i in range(4)]
    F, D = N @ Q["fault"][:, columns[1]], N @ np.hstack([Q["fault"][:, columns[2]], Q["fault"][:, columns[3]]])
    values = scipy.linalg.eigh(F @ F.T, D @ D.T, eigvals_only=True)[::-1]
    np.testing.assert_allclose(found.indices**2, values, rtol=1e-8, atol=1e-12)
    decoupled = optimal_parity(plant, order=2, faults="p2", insensitive_to="p1")
    assert decoupled.perfect
    known = rs.design.parity_relations(rs.library.gertler(), insensitive_to="p1")
    assert known.relations is not None
    np.testing.assert_allclose(decoupled.relations.output_rows.coefficients, known.relations.output_rows.coefficients)


def test_equation_6_2() -> None:
    """Residuals of the nominal equations on another plant: e* = dH y - dG u, with nominal less true."""
    true, u = example(a=0.45, gain=1.1), np.random.default_rng(1).standard_normal((60, 1))
    y = true.system(("control",)).simulate(u)
    e = rs.design.primary_residuals(example()).run(u, y)
    own, io = rs.InputOutputModel.from_plant(example()), rs.InputOutputModel.from_plant(true)
    dH, dG = own.H - io.H, own.G - io.G
    for k in range(2, 60):
        window = sum(dH.padded(2)[j] @ y[k - 2 + j] - dG.padded(2)[j] @ u[k - 2 + j] for j in range(3))
        np.testing.assert_allclose(e[k], window, atol=1e-12)


def test_equations_6_10_to_6_13() -> None:
    """A pole of y1 alone makes a residual of one direction; a shared pole turns it with the data; both are removed."""
    u = np.random.default_rng(2).standard_normal((300, 1))
    for name, value in {"a": 0.4, "b": 0.5, "c": 0.9, "gain": 1.0}.items():

        def model(_name: str = name, **given: float) -> rs.Plant:
            return example(**{_name: given[_name]})

        parity = insensitive_parity(model, {name: value}, insensitive_to=name)
        seen = []
        for share in (0.02, 0.002):
            y = example(**{name: value * (1 + share)}).system(("control",)).simulate(u)
            r = parity.run(u, y)
            seen.append((np.abs(r.primary).max(), np.abs(r.residuals).max()))
        # with y1 or y2 alone, or the gain, nothing of second order is left besides rounding
        assert seen[0][0] / seen[1][0] == pytest.approx(10, rel=0.3)
        assert seen[0][1] < 0.02 * seen[0][0]
        assert seen[1][1] < 0.002 * seen[1][0]


def test_equation_6_14_orders_the_relations_of_the_example() -> None:
    plant = rs.library.gertler(sensor_faults=True).with_noise(measurement=1e-4)
    bank = rs.design.structured_parity(plant, ["0111", "1011", "1101", "1110"])
    choice = select_equations(bank, example_with_sensors, {"a": 0.4, "c": 0.9}, inputs=[1.0], changes={"c": 0.02})
    assert len(choice.chosen) == 4  # all are needed: four faults, strongly isolating
    # y1 is not in the relation that ignores its sensor: a is a pole of y1 alone, c one of y2 alone
    without_y1, without_y2 = (bank.generator.structure[:, j].tolist().index(False) for j in (2, 3))
    assert choice.measures[without_y1, 0] < 1e-9 < choice.measures[without_y2, 0]
    assert choice.measures[without_y2, 1] < 1e-9 < choice.measures[without_y1, 1]


def example_with_sensors(a: float, c: float) -> rs.Plant:
    return example(a=a, c=c)
