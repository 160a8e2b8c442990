"""Relations for several models: the mean square is the singular value squared in any units; ratios are the best."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
import scipy.signal

import residua as rs
from effort import cases
from generated import random_plant
from residua.errors import DesignError, ModelError, SettingError
from residua.robust.parity.multi_model_parity import MultiModelParity, model_spread, multi_model_parity
from residua.robust.parity.optimal_parity import optimal_parity


def family(seed: int, count: int = 3, *, disturbances: int = 0, noise: bool = False) -> list[rs.Plant]:
    """Return stable variants of a random sampled plant."""
    rng = np.random.default_rng([31, seed])
    n, p, m = int(rng.integers(2, 5)), 2, int(rng.integers(2, 4))
    A = rng.standard_normal((n, n))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    B, C, F = rng.standard_normal((n, p)), rng.standard_normal((m, n)), rng.standard_normal((n, 1))
    G = rng.standard_normal((n, disturbances))
    out = []
    for _ in range(count):
        dA, dB = 0.03 * rng.standard_normal((n, n)), 0.05 * rng.standard_normal((n, p))
        plant = rs.Plant(A + dA, B + dB, C, dt=0.5).with_faults({"leak": F[:, 0]}).with_sensor_faults("y1")
        plant = plant.with_disturbances(G) if disturbances else plant
        out.append(plant.with_noise(process=0.01, measurement=0.02) if noise else plant)
    return out


def recording(
    plant: rs.Plant, steps: int, seed: int, *, time: float = 0.0, noise: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Simulate a plant by hand, with inputs and disturbances of size one that stay alike for some time."""
    rng = np.random.default_rng(seed)
    rho = np.exp(-plant.dt / time) if time else 0.0
    e = rng.standard_normal((steps, plant.B.shape[1] + plant.Bd.shape[1]))
    v = scipy.signal.lfilter([np.sqrt(1 - rho**2)], [1, -rho], e, axis=0)
    w = rng.standard_normal((steps, plant.Bw.shape[1])) * noise
    system = plant.system(("control", "disturbance", "noise"))
    y = system.simulate(np.hstack([v, w]))
    return v[:, : plant.B.shape[1]], y


@pytest.mark.parametrize(
    ("seed", "time", "noise", "q"), [(0, 0.0, False, 0), (1, 4.0, False, 0), (2, 0.0, True, 1), (3, 6.0, True, 1)]
)
def test_mean_square_over_models_is_the_singular_value_squared(seed: int, time: float, noise: bool, q: int) -> None:
    models = family(seed, disturbances=q, noise=noise)
    found = multi_model_parity(models, order=2, relations=4, correlation_time=time, noise=noise)
    mean = np.zeros(4)
    for i, plant in enumerate(models):
        u, y = recording(plant, 200_000, 100 * seed + i, time=time, noise=noise)
        r = found.generator.run(u, y)[200:]
        rms = np.sqrt((r**2).mean(axis=0))
        np.testing.assert_allclose(rms, found.leak[i], rtol=0.03)
        mean += rms**2 / 3
    np.testing.assert_allclose(np.sqrt(mean), found.singular_values[::-1][:4], rtol=0.03)


def test_weights_of_models_and_given_states_enter_the_mean_square() -> None:
    models, weights = family(5), [0.5, 0.3, 0.2]
    X = np.diag(np.arange(1.0, models[0].n_states + 1)) ** 2
    found = multi_model_parity(models, order=1, relations=3, weights=weights, states=X, inputs={"u2": 2.0})
    rng, total = np.random.default_rng(8), 0.0
    for share, plant in zip(weights, models, strict=True):
        x = rng.standard_normal((100_000, len(X))) @ np.sqrt(X)
        u = rng.standard_normal((100_000, 2, 2)) * [1.0, 2.0]
        y = np.stack([x @ plant.C.T, (x @ plant.A.T + u[:, 0] @ plant.B.T) @ plant.C.T], axis=1)
        r = np.einsum("rkm,tkm->tr", found.output_weights, y) + np.einsum("rkp,tkp->tr", found.input_weights, u)
        total = total + share * (r**2).mean(axis=0)
    np.testing.assert_allclose(np.sqrt(total), found.singular_values[::-1][:3], rtol=0.02)
    np.testing.assert_allclose(weights @ found.leak**2, found.singular_values[::-1][:3] ** 2, rtol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_no_direction_leaks_less(seed: int) -> None:
    """The sum over the relations kept is the least of all orthonormal ones, by direct search."""
    models = family(seed, 2)
    found = multi_model_parity(models, order=1)
    mean = np.zeros((2 * len(found.units),) * 2)  # the covariance of windows, from simulation-free sums
    for plant in models:
        X = np.zeros((plant.n_states,) * 2)
        for _ in range(600):
            X = plant.A @ X @ plant.A.T + plant.B @ plant.B.T
        m, p = plant.n_outputs, 2
        R = np.vstack([plant.C, np.zeros((p, len(X))), plant.C @ plant.A, np.zeros((p, len(X)))])
        Q = np.zeros((2 * (m + p), 2 * p))
        Q[m : m + p, :p], Q[m + p : 2 * m + p, :p], Q[2 * m + p :, p:] = np.eye(p), plant.C @ plant.B, np.eye(p)
        mean += (R @ X @ R.T + Q @ Q.T) / 2
    scale = np.tile(found.units, 2)
    S = mean / scale[:, None] / scale
    rng = np.random.default_rng(seed)

    def leak(w: np.ndarray) -> tuple[float, np.ndarray]:  # with its slope: differences end a thousandth too high
        value = w @ S @ w / (w @ w)
        return value, 2 * (S @ w - value * w) / (w @ w)

    best = min(
        scipy.optimize.minimize(leak, rng.standard_normal(len(S)), jac=True, method="BFGS", options={"gtol": 1e-14}).fun
        for _ in range(5)
    )
    assert best == pytest.approx(found.singular_values[-1] ** 2, rel=1e-6, abs=1e-12)


def test_one_model_gives_its_exact_relations() -> None:
    plant = family(3, 1)[0]
    order = 2
    exact = rs.design.parity_relations(plant, order=order)
    found = multi_model_parity([plant], order=order, relations=exact.n_residuals)
    assert found.singular_values[-exact.n_residuals - 1] > 1e-6
    assert found.singular_values[-exact.n_residuals] < 1e-13
    u, y = recording(plant, 400, 1)
    assert np.abs(found.generator.run(u, y)[order:]).max() < 1e-12
    # the same space: each exact relation is a combination of those found
    W = np.hstack([found.output_weights.reshape(exact.n_residuals, -1)])
    assert exact.relations is not None
    V = exact.relations.parity_vectors
    assert np.linalg.matrix_rank(np.vstack([W, V]), tol=1e-9 * np.linalg.norm(V)) == exact.n_residuals


def test_exact_common_relations_are_found_and_see_no_change_of_model() -> None:
    """Models that differ in one row only share the equations of the others."""

    def variant(a: float) -> rs.Plant:
        return rs.Plant([[a, 0.1], [0.3, 0.5]], [[1], [0]], np.eye(2), dt=1.0).with_sensor_faults()

    found = multi_model_parity([variant(a) for a in (0.5, 0.6, 0.8)], order=1)
    assert found.singular_values[-1] < 1e-14
    assert found.singular_values[-2] > 1e-3
    w = found.output_weights[0] / found.output_weights[0, 1, 1]
    np.testing.assert_allclose(w, [[-0.3, -0.5], [0, 1]], atol=1e-12)


@pytest.mark.parametrize("criterion", ["leak", "faults"])
def test_units_do_not_matter(criterion: str) -> None:
    rng = np.random.default_rng(6)
    models = family(1)  # no relation is exact for all
    T, U, Y = (10 ** rng.uniform(-4, 4, k) for k in (models[0].n_states, 2, models[0].n_outputs))
    f = 10 ** rng.uniform(-4, 4)

    def in_units(p: rs.Plant) -> rs.Plant:
        plant = rs.Plant(p.A / T[:, None] * T, p.B / T[:, None] * U, p.C * T * Y[:, None], dt=p.dt)
        return plant.with_faults({"leak": p.Bf[:, 0] / T, "y1 sensor": (np.zeros(len(T)), p.Df[:, 1] * Y)})

    a = multi_model_parity(models, order=2, relations=2, criterion=criterion)
    assert a.singular_values[-1] > 1e-8
    b = multi_model_parity(
        [in_units(p) for p in models], order=2, relations=2, criterion=criterion, inputs=np.full(2, f) / U * 1.0
    )
    if criterion == "leak":
        np.testing.assert_allclose(a.singular_values, b.singular_values, rtol=1e-9, atol=1e-14)
    # inputs f times as large: states and outputs too, so that the least faults grow by f
    np.testing.assert_allclose(f * a.smallest_faults, b.smallest_faults, rtol=1e-6)


def test_ratios_are_the_largest_there_are() -> None:
    models = family(7)
    found = multi_model_parity(models, order=1, criterion="faults")
    plain = multi_model_parity(models, order=1, relations=len(found.singular_values))
    W = np.concatenate([plain.output_weights, plain.input_weights], axis=2).reshape(len(found.singular_values), -1)
    S = sum(one for one in _covariances(models)) / 3
    F = np.hstack([_lasting(p) for p in models]) / np.sqrt(3)
    values = scipy.linalg.eigh(W @ F @ F.T @ W.T, W @ S @ W.T, eigvals_only=True)
    np.testing.assert_allclose(found.ratios[0], np.sqrt(values[-1]), rtol=1e-6)
    w = np.concatenate([found.output_weights, found.input_weights], axis=2).ravel()
    assert np.linalg.norm(w @ F) / np.sqrt(w @ S @ w) == pytest.approx(found.ratios[0], rel=1e-8)
    assert np.sqrt(w @ S @ w) == pytest.approx(np.sqrt((found.leak**2).mean()), rel=1e-8)


def _covariances(models: list[rs.Plant]) -> list[np.ndarray]:
    out = []
    for p in models:
        X = np.zeros((p.n_states,) * 2)
        for _ in range(600):
            X = p.A @ X @ p.A.T + p.B @ p.B.T
        Z = np.zeros((2, p.n_states))
        R = np.vstack([p.C, Z, p.C @ p.A, Z])
        m = p.n_outputs
        Q = np.zeros((len(R), 4))
        Q[m : m + 2, :2], Q[m + 2 : 2 * m + 2, :2], Q[2 * m + 2 :, 2:] = np.eye(2), p.C @ p.B, np.eye(2)
        out.append(R @ X @ R.T + Q @ Q.T)
    return out


def _lasting(p: rs.Plant) -> np.ndarray:
    Z = np.zeros((2, 2))
    return np.vstack([p.Df, Z, p.C @ p.Bf + p.Df, Z])


def test_poles_divide_and_the_leak_follows() -> None:
    models = family(2)
    found = multi_model_parity(models, order=2, relations=2, poles=[0.8, 0.6], correlation_time=5.0)
    np.testing.assert_allclose(np.sort(found.generator.evidence.poles.real), [0.6, 0.6, 0.8, 0.8])
    for i, plant in enumerate(models):
        u, y = recording(plant, 300_000, i, time=5.0)
        np.testing.assert_allclose(found.generator.run(u, y)[300:].std(axis=0), found.leak[i], rtol=0.04)
    np.testing.assert_allclose(model_spread(found.generator, models, correlation_time=5.0), found.leak, rtol=1e-9)


def test_gains_are_what_simulation_settles_to() -> None:
    models = family(1)
    found = multi_model_parity(models, order=1, relations=2)
    for i, plant in enumerate(models):
        for j in range(2):
            f = np.zeros((500, 2))
            f[:, j] = 1.0
            y = plant.system(("fault",)).simulate(f)
            np.testing.assert_allclose(found.generator.run(np.zeros((500, 2)), y)[-1], found.gains[i, :, j], atol=1e-9)


def test_blindness_is_exact() -> None:
    """Three outputs of two states: one static relation, exact for all models, which sees no fault of the states."""
    found = multi_model_parity(family(4), order=0)
    assert found.leak.max() < 1e-14
    assert np.all(found.gains[:, 0, 0] == 0)
    assert np.all(np.isinf(found.smallest_faults[:, 0]))
    assert np.all(found.smallest_faults[:, 1] < 1e-12)


def test_the_generator_admits_that_inputs_leak() -> None:
    found = multi_model_parity(family(1), order=1, nominal=2)
    form = found.generator.internal_form(controls=True)
    assert np.abs(form.frequency_response([0.3])[0][:, -2:]).max() > 1e-5
    assert "exact for none" in str(found.generator.evidence)


def test_requests_that_make_no_sense() -> None:
    models = family(0)
    with pytest.raises(DesignError, match="sample the plants first"):
        multi_model_parity([random_plant(np.random.default_rng(0), dt=0.0)], order=1)
    with pytest.raises(ModelError, match="other outputs"):
        multi_model_parity([models[0], rs.Plant([[0.5]], models[0].B[:1], [[1.0]], dt=0.5)], order=1)
    with pytest.raises(DesignError, match="not both"):
        multi_model_parity(models, order=1, rank=3, relations=2)
    with pytest.raises(DesignError, match="rank goes by the leak alone"):
        multi_model_parity(models, order=1, rank=2, criterion="faults")
    with pytest.raises(DesignError, match="rank must be 0 to"):
        multi_model_parity(models, order=1, rank=100)
    with pytest.raises(SettingError, match="weights"):
        multi_model_parity(models, order=1, weights=[1.0, -1.0, 1.0])
    with pytest.raises(SettingError, match="no input 'x'"):
        multi_model_parity(models, order=1, inputs={"x": 1.0})
    unstable = rs.Plant([[1.1]], [[1.0]], [[1.0]], dt=1.0)
    with pytest.raises(DesignError, match=r"model 0 has the pole 1.1.*states="):
        multi_model_parity([unstable], order=1)
    assert isinstance(multi_model_parity([unstable], order=1, states=1.0), MultiModelParity)


# --------------------------------------------------------------------- optimal parity


def disturbed(seed: int, q: int) -> rs.Plant:
    rng = np.random.default_rng([53, seed])
    n, m = int(rng.integers(3, 6)), 2
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    plant = rs.Plant(A, rng.standard_normal((n, 1)), rng.standard_normal((m, n)), dt=1.0)
    plant = plant.with_disturbances({f"d{i}": rng.standard_normal(n) for i in range(q)})
    return plant.with_faults({"f": rng.standard_normal(n)}).with_sensor_faults("y2")


@pytest.mark.parametrize("seed", cases(range(10), 5))
def test_the_index_is_the_largest_by_brute_force(seed: int) -> None:
    """On Chow and Willsky's matrices, by direct search over the null space of R."""
    plant, order = disturbed(seed, 2), 4
    R, Q = rs.design.chow_willsky_matrices(plant, order)
    N = scipy.linalg.null_space(R.T).T
    F, D = N @ Q["fault"], N @ Q["disturbance"]
    found = optimal_parity(plant, order=order)
    assert not found.perfect
    rng = np.random.default_rng(seed)

    def index(c: np.ndarray) -> float:
        return -float(np.linalg.norm(c @ F) / np.linalg.norm(c @ D))

    best = max(-scipy.optimize.minimize(index, rng.standard_normal(len(N)), tol=1e-12).fun for _ in range(20))
    assert found.index == pytest.approx(best, rel=1e-5)
    w = found.relations.parity_vectors[0]
    np.testing.assert_allclose(w @ R, 0, atol=1e-9 * np.abs(w).max())
    assert np.linalg.norm(w @ Q["fault"]) / np.linalg.norm(w @ Q["disturbance"]) == pytest.approx(found.index, rel=1e-7)
    ranking = np.sqrt(scipy.linalg.eigh(F @ F.T, D @ D.T, eigvals_only=True)[::-1])
    np.testing.assert_allclose(found.indices, ranking[: len(found.indices)], rtol=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_perfect_decoupling_comes_first(seed: int) -> None:
    plant, order = disturbed(seed, 1), 6
    Q = rs.design.chow_willsky_matrices(plant, order)[1]
    found = optimal_parity(plant, order=order)
    assert found.perfect
    assert np.isinf(found.index)
    w = found.relations.parity_vectors[0]
    np.testing.assert_allclose(w @ Q["disturbance"], 0, atol=1e-9 * np.abs(w).max())
    assert np.linalg.norm(w @ Q["fault"]) > 1e-3 * np.linalg.norm(w)
    both = rs.design.parity_relations(plant, order=order)  # ignores the disturbance too
    assert len(found.indices) == both.n_residuals
    assert max(found.generator.evidence.decoupling.values()) < 1e-9


def test_a_perfect_relation_may_be_blind_and_says_so() -> None:
    plant = disturbed(1, 1).with_faults({"as the disturbance": disturbed(1, 1).Bd[:, 0]})
    found = optimal_parity(plant, order=6)
    assert found.perfect
    assert found.blind == ("as the disturbance",)
    alone = optimal_parity(plant, order=6, faults="as the disturbance")
    assert not alone.perfect
    assert alone.index == pytest.approx(1.0, rel=1e-6)
    np.testing.assert_allclose(alone.indices, 1.0, rtol=1e-5)


def test_among_perfect_ones_the_response_for_the_noise_is_largest() -> None:
    plant = disturbed(2, 1).with_noise(measurement=[0.04, 1.0])
    order = 5
    R, Q = rs.design.chow_willsky_matrices(plant, order)
    N = scipy.linalg.null_space(np.hstack([R, Q["disturbance"]]).T).T
    S = np.kron(np.eye(order + 1), np.diag([0.2, 1.0]))
    F = N @ Q["fault"]
    best = np.sqrt(scipy.linalg.eigh(F @ F.T, N @ S @ S @ N.T, eigvals_only=True)[-1])
    found = optimal_parity(plant, order=order)
    assert found.gains[0] == pytest.approx(best, rel=1e-6)


def test_sizes_and_choices() -> None:
    plant = disturbed(3, 2)
    one = optimal_parity(plant, order=3, sizes={"f": 10.0}, faults="f").index
    assert one == pytest.approx(10 * optimal_parity(plant, order=3, faults="f").index, rel=1e-9)
    ignoring = optimal_parity(plant, order=3, faults="f", insensitive_to="y2 sensor")
    assert ignoring.index < optimal_parity(plant, order=3, faults="f").index
    alone = optimal_parity(plant, order=5, disturbances="d1", faults="f")
    assert alone.perfect
    with pytest.raises(DesignError, match="to be seen and to be ignored"):
        optimal_parity(plant, order=3, faults="f", insensitive_to="f")
    with pytest.raises(DesignError, match="no relation of order 0"):
        optimal_parity(plant, order=0)
    with pytest.raises(DesignError, match="relations must be 1 to"):
        optimal_parity(plant, order=3, relations=50)


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_the_index_does_not_depend_on_the_units_of_the_states(dt: float) -> None:
    rng = np.random.default_rng(3)
    p = random_plant(rng, n=4, outputs=2, inputs=1, disturbances=2, faults=2, dt=dt) if dt else None
    p = p or rs.Plant(-np.diag([1.0, 2.0, 3.0]) + 0.1, [[1], [0], [1]], [[1, 0, 1], [0, 1, 1]]).with_disturbances(
        {"d1": [1, 0, 0], "d2": [0, 1, 1]}
    ).with_faults({"f": [0, 1, 0]})
    T, Y = 10 ** rng.uniform(-4, 4, p.n_states), 10 ** rng.uniform(-4, 4, 2)
    other = rs.Plant(p.A / T[:, None] * T, p.B / T[:, None], p.C * T * Y[:, None], dt=p.dt)
    other = other.with_disturbances({f"d{i}": d / T for i, d in enumerate(p.Bd.T)})
    other = other.with_faults({f"f{i}": d / T for i, d in enumerate(p.Bf.T)})
    a, b = optimal_parity(p, order=3), optimal_parity(other, order=3)
    np.testing.assert_allclose(a.indices, b.indices, rtol=1e-5)


def test_variants_are_held_back() -> None:
    """Chosen against variants, an exact relation leaks less on them for what it sees than the average one does."""
    models = family(9, 4)
    expected = {"order": 2, "faults": "leak"}
    found = optimal_parity(models[0], variants=models[1:], **expected)
    plain = rs.design.parity_relations(models[0], order=2)

    def ratio(generator: rs.design.ResidualGenerator) -> np.ndarray:
        assert generator.relations is not None
        leak = np.sqrt((model_spread(generator, models[1:]) ** 2).mean(axis=0))
        gain = np.linalg.norm(
            [generator.relations.fault_rows.padded(2)[:, i, 0] for i in range(generator.n_residuals)], axis=1
        )
        return gain / leak

    assert model_spread(found.generator, models[:1]).max() < 1e-12
    assert ratio(found.generator)[0] > ratio(plain).max()
    with pytest.raises(ModelError, match="same signals and states"):
        optimal_parity(models[0], order=2, variants=[rs.library.gertler()])


@pytest.mark.parametrize("seed", range(6))
def test_constant_faults_and_noise_count_when_asked(seed: int) -> None:
    """On Chow and Willsky's matrices: faults that last, against disturbances and noise."""
    plant, order = disturbed(seed, 1).with_noise(process=0.1, measurement=0.2), 3
    R, Q = rs.design.chow_willsky_matrices(plant, order)
    N = scipy.linalg.null_space(R.T).T
    noise = plant.faults_as_disturbances(plant.faults)._with(Bd=plant.Bw, Dd=plant.Dw)
    W = rs.design.chow_willsky_matrices(noise, order)[1]["disturbance"]
    F = N @ Q["fault"] @ np.kron(np.ones((order + 1, 1)), np.eye(2))
    D = N @ np.hstack([Q["disturbance"], W])
    best = np.sqrt(scipy.linalg.eigh(F @ F.T, D @ D.T, eigvals_only=True)[-1])
    found = optimal_parity(plant, order=order, constant=True, noise=True)
    assert found.index == pytest.approx(best, rel=1e-6)
    f = np.ones((300, 2)) * [1.0, 0.0]
    y = plant.system(("fault",)).simulate(f)
    settled = found.generator.run(np.zeros((300, 1)), y)[-1, 0]
    w = found.relations.parity_vectors[0]
    assert settled == pytest.approx((w @ Q["fault"]).reshape(-1, 2).sum(axis=0)[0], rel=1e-6, abs=1e-9)


def test_a_perfect_relation_that_sees_no_constant_fault_is_passed_over() -> None:
    """The fault enters behind an integrator that the relation of order one differentiates away."""
    plant = rs.Plant([[1.0, 0.0], [0.0, 0.5]], [[1], [1]], np.eye(2), dt=1.0)
    plant = plant.with_disturbances({"d": [0, 1]}).with_faults({"bias": ([0, 0], [1, 0])})
    assert optimal_parity(plant, order=1).perfect
    with pytest.raises(DesignError, match="while constant"):
        optimal_parity(plant, order=1, constant=True)


def test_models_of_other_kinds() -> None:
    """Input-output models, plants with an E, and continuous plants for exact relations."""
    plant = rs.library.gertler()
    io = rs.InputOutputModel.from_plant(plant)
    a, b = optimal_parity(plant, order=2, insensitive_to="p1"), optimal_parity(io, order=2, insensitive_to="p1")
    assert a.perfect
    assert b.perfect
    np.testing.assert_allclose(
        a.relations.output_rows.coefficients, b.relations.output_rows.coefficients, rtol=1e-6, atol=1e-9
    )
    one, other = multi_model_parity([plant], order=2, relations=3), multi_model_parity([io], order=2, relations=3)
    np.testing.assert_allclose(one.singular_values, other.singular_values, atol=1e-9)
    E = np.diag([2.0, 1.0, 4.0])
    implicit = rs.Plant(E @ plant.A, E @ plant.B, plant.C, E=E, dt=1.0).with_faults(
        {"p1": E @ plant.Bf[:, 0], "p2": E @ plant.Bf[:, 1]}
    )
    np.testing.assert_allclose(
        multi_model_parity([implicit], order=2).singular_values, one.singular_values, rtol=1e-9, atol=1e-14
    )
    c = optimal_parity(implicit, order=2, insensitive_to="p1")
    np.testing.assert_allclose(
        a.relations.output_rows.coefficients, c.relations.output_rows.coefficients, rtol=1e-6, atol=1e-9
    )


def test_a_monitor_runs_on_a_relation_that_leaks() -> None:
    models = family(1, noise=True)
    found = multi_model_parity(models, order=2, criterion="faults", noise=True)
    monitor = rs.Monitor(found.generator)
    fits = [recording(plant, 4000, i, noise=True) for i, plant in enumerate(models)]
    monitor = monitor.fit(np.concatenate([u for u, _ in fits]), np.concatenate([y for _, y in fits]))
    u, y = recording(models[2], 4000, 9, noise=True)
    quiet = monitor.run(u, y)
    assert isinstance(quiet, rs.Diagnosis)
    assert quiet.alarm.mean() < 0.01
    y = y.copy()
    y[2000:, 0] += 20 * found.smallest_faults[:, 1].max()
    loud = monitor.run(u, y)
    assert isinstance(loud, rs.Diagnosis)
    assert loud.alarm[2100:].mean() > 0.95
