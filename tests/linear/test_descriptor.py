"""Descriptor systems: hidden Weierstrass structures are found, simulations agree with independent ones."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import residua as rs
from guards import trips
from residua.errors import AccuracyError, DataError, ModelError, SettingError
from residua.linear import (
    StateSpace,
    consistent_state,
    descriptor_controllability,
    descriptor_observability,
    is_regular,
    simulate_descriptor,
    weierstrass_form,
)
from residua.linear.systems.descriptor import balanced_pencil
from residua.plant import without_algebraic_equations

SEEDS = range(12)


def hidden(
    rng: np.random.Generator, n1: int, chains: list[int], spread: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (A, E, A1) with a dynamic part of order n1 and nilpotent chains, hidden by random transformations."""
    n2 = sum(chains)
    n = n1 + n2
    A1 = rng.standard_normal((n1, n1))
    N = scipy.linalg.block_diag(*(np.eye(c, k=1) for c in chains)) if chains else np.zeros((0, 0))
    E = scipy.linalg.block_diag(np.eye(n1), N)
    A = scipy.linalg.block_diag(A1, np.eye(n2))
    P = 10.0 ** rng.uniform(-spread, spread, (n, 1)) * rng.standard_normal((n, n))
    Q = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(-spread, spread, n)
    return P @ A @ Q, P @ E @ Q, A1


STRUCTURES = [(3, [1]), (2, [2, 1]), (4, [3]), (0, [2, 2]), (1, [4, 1]), (5, []), (3, [1, 1, 1]), (0, [1])]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("n1", "chains"), STRUCTURES)
def test_a_hidden_structure_is_found(n1: int, chains: list[int], seed: int) -> None:
    A, E, A1 = hidden(np.random.default_rng(seed), n1, chains, spread=3.0 * (seed % 2))
    form = weierstrass_form(A, E)
    assert form.n_finite == n1
    assert form.index == max(chains, default=0)
    np.testing.assert_allclose(
        np.sort_complex(form.poles), np.sort_complex(np.linalg.eigvals(A1)), rtol=1e-6, atol=1e-7
    )
    k = len(chains)
    if chains:  # the sizes of the chains follow from the ranks of the powers of N
        powers = [np.linalg.matrix_power(form.N, i) for i in range(max(chains) + 1)]
        unit = max(np.abs(form.N).max(), 1e-300)
        ranks = [np.linalg.matrix_rank(p / unit**i, tol=1e-8) for i, p in enumerate(powers)]
        assert ranks == [sum(max(c - i, 0) for c in chains) for i in range(max(chains) + 1)]
        assert np.array_equal(powers[-1], np.zeros_like(form.N))
        assert ranks[0] - ranks[1] == k


@pytest.mark.parametrize("seed", SEEDS)
def test_the_transformations_give_the_form(seed: int) -> None:
    A, E, _ = hidden(np.random.default_rng(seed), 3, [2, 1])
    form = weierstrass_form(A, E)
    k = form.n_finite
    np.testing.assert_allclose(form.P @ E @ form.Q, scipy.linalg.block_diag(np.eye(k), form.N), atol=1e-8)
    np.testing.assert_allclose(form.P @ A @ form.Q, scipy.linalg.block_diag(form.A1, np.eye(3)), atol=1e-8)
    np.testing.assert_allclose(form.Q_inverse @ form.Q, np.eye(6), atol=1e-9)
    assert form.residual < 1e-10
    assert form.condition < 1e8


def test_chains_at_infinity_do_not_become_fast_poles() -> None:
    """QZ throws a chain of four far into the plane; the poles must not be among what it says."""
    A, E, A1 = hidden(np.random.default_rng(1), 2, [4], spread=2.0)
    alpha, beta = scipy.linalg.eigvals(A, E, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-12 * np.abs(alpha)
    assert finite.sum() > 2, "the comparison shows nothing here"
    poles = StateSpace(A, np.zeros((6, 0)), np.eye(6), E=E).poles()
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(np.linalg.eigvals(A1)), rtol=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_degree_of_the_determinant_is_the_order_of_the_dynamic_part(seed: int) -> None:
    A, E, _ = hidden(np.random.default_rng(seed), 3, [1, 2])
    s = 1e4
    ratio = np.linalg.det(2 * s * E - A) / np.linalg.det(s * E - A)
    assert round(float(np.log2(abs(ratio)))) == weierstrass_form(A, E).n_finite


@pytest.mark.parametrize("seed", SEEDS)
def test_pencils_that_are_not_regular(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 5
    A, E, _ = hidden(rng, 2, [2, 1], spread=1.0)
    assert is_regular(A, E)
    for M in (rng.standard_normal((n, n - 1)), np.zeros((n, n - 1))):
        common = M @ rng.standard_normal((n - 1, n))
        null = scipy.linalg.null_space(common)[:, :1]
        E_bad = E - E @ null @ null.T
        A_bad = A - A @ null @ null.T
        assert not is_regular(A_bad, E_bad)
        with pytest.raises(ModelError, match="zero for every s"):
            weierstrass_form(A_bad, E_bad)
    # No common null vector, and yet singular: one row of a polynomial identity.
    assert not is_regular([[0, 1, 0], [0, 0, 1], [0, 0, 0]], [[1, 0, 0], [0, 1, 0], [0, 0, 0]])


@pytest.mark.parametrize("exponent", range(2, 16))
def test_a_nearly_algebraic_part_is_right_or_refused(exponent: int) -> None:
    """One pole near -1 / eps: it is found, or the form is refused, or the part counts as algebraic."""
    rng = np.random.default_rng(exponent)
    eps = 10.0**-exponent
    U, V = (np.linalg.qr(rng.standard_normal((4, 4)))[0] for _ in range(2))
    core = np.diag([-1.0, -2.0, -3.0, -1.0]) + 0.1 * rng.standard_normal((4, 4))
    A, E = U @ core @ V, U @ np.diag([1, 1, 1, eps]) @ V
    slow = np.linalg.eigvals(core[:3, :3] - np.outer(core[:3, 3], core[3, :3]) / core[3, 3])  # the limit eps = 0
    fast = np.linalg.eigvals(core / np.array([1, 1, 1, eps])[:, None])
    try:
        form = weierstrass_form(A, E)
    except AccuracyError:
        assert exponent in (9, 10)  # between clear and negligible
        return
    assert form.n_finite == (4 if exponent < 10 else 3)
    expected = fast if form.n_finite == 4 else slow
    np.testing.assert_allclose(np.sort(np.abs(form.poles)), np.sort(np.abs(expected)), rtol=1e-6)


#: Found in bad units as one of index 1, when scaling depended on the units.
INDEX_2 = np.zeros((6, 6)), np.diag([1.0, 1, 1, 1, 1, 0])
for _i, _j, _a in ((0, 0, -2), (0, 3, 1), (1, 2, 2), (2, 1, 2), (2, 2, 2), (2, 5, -1), (3, 1, 1), (4, 3, 1), (5, 2, 1)):
    INDEX_2[0][_i, _j] = _a


@pytest.mark.parametrize("seed", range(40))
def test_the_form_does_not_depend_on_units(seed: int) -> None:
    """Its last equation is x3 = 0, so the third gives x6 = 2 x2: index 2, with the four other states left."""
    A, E = INDEX_2
    rng = np.random.default_rng(seed)
    rows, columns = 2.0 ** np.round(rng.uniform(-30, 30, (2, 6)))
    unit = 2.0 ** int(rng.integers(-20, 20))
    form = weierstrass_form(rows[:, None] * A * columns, rows[:, None] * E * columns / unit)
    assert (form.n_finite, form.index) == (4, 2)
    plain, scaled = (
        balanced_pencil(A, E),
        balanced_pencil(rows[:, None] * A * columns, rows[:, None] * E * columns / unit),
    )
    assert np.abs(np.log2(scaled.A[A != 0] / plain.A[A != 0])).max() <= 3


@trips("linear.systems.descriptor:weierstrass_form:2")
@pytest.mark.parametrize("exponent", [9.5, 9.6, 9.7])
def test_a_rank_without_a_gap_is_refused(exponent: float) -> None:
    """Two small singular values of E, one on either side of the tolerance: what is kept is no more than what is not."""
    rng = np.random.default_rng(0)
    U, V = (np.linalg.qr(rng.standard_normal((5, 5)))[0] for _ in range(2))
    core = np.diag([-1.0, -2.0, -3.0, -1.0, -1.5]) + 0.1 * rng.standard_normal((5, 5))
    small = 10.0**-exponent
    with pytest.raises(AccuracyError, match=r"not clear: rank 4 \(smallest kept .*, largest dropped"):
        weierstrass_form(U @ core @ V, U @ np.diag([1, 1, 1, small, small / 30]) @ V)


# ------------------------------------------------------- observability, controllability


def by_the_definition(A: np.ndarray, E: np.ndarray, C: np.ndarray, poles: np.ndarray) -> tuple[bool, bool]:
    """Return (finite, complete) of Definition 4, at the poles, where alone the pencil can lose rank."""
    n = len(A)
    finite = all(np.linalg.matrix_rank(np.vstack([s * E - A, C]), tol=1e-7) == n for s in poles)
    return finite, finite and np.linalg.matrix_rank(np.vstack([E, C]), tol=1e-9) == n


@pytest.mark.parametrize("seed", range(30))
def test_observability_is_as_defined(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n1, chains = STRUCTURES[seed % 5]
    A, E, _ = hidden(rng, n1, chains)
    form = weierstrass_form(A, E)
    C = rng.standard_normal((2, len(A)))
    if seed % 3 == 1 and n1:  # hide a mode, or two that are a pair
        C = np.hstack([_blind_to(form.A1, rng), rng.standard_normal((2, len(A) - n1))]) @ form.Q_inverse
    if seed % 3 == 2:  # miss what only algebraic equations determine
        E_null = scipy.linalg.null_space(E, rcond=1e-9)
        C = C - C @ E_null[:, :1] @ E_null[:, :1].T
    finite, complete = by_the_definition(A, E, C, form.poles)
    found = descriptor_observability(A, C, E)
    assert (found.finite, bool(found)) == (finite, complete)
    assert bool(found.reasons) != complete
    assert bool(found.hidden_modes.size) != finite
    dual = descriptor_controllability(A.T, C.T, E.T)
    assert (dual.finite, dual.complete, dual.impulse) == (found.finite, found.complete, found.impulse)


def _blind_to(A1: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return two outputs of ``A1`` that do not see its first mode (or pair)."""
    _, right = np.linalg.eig(A1)
    v = np.column_stack([right[:, 0].real, right[:, 0].imag])
    return rng.standard_normal((2, len(A1))) @ (np.eye(len(A1)) - v @ np.linalg.pinv(v))


def test_the_failing_condition_is_named() -> None:
    found = descriptor_observability(np.diag([-1.0, -2.0, 1.0]), [[1, 0, 1]], np.diag([1.0, 1.0, 0.0]))
    np.testing.assert_allclose(found.hidden_modes, [-2.0])
    assert "s = -2" in str(found)
    assert found.impulse
    assert descriptor_observability(np.diag([-1.0, -2.0]), [[1.0, 1.0]]).complete
    unmoved = descriptor_controllability(np.eye(2), [[1.0], [0.0]], np.diag([1.0, 0.0]))
    assert "rank[E, B] = 1 < 2" in str(unmoved)


def test_lemma_4_says_the_same() -> None:
    """Controllability of both parts of the Weierstrass form, eqs. (17) with powers of A1."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        A, E, _ = hidden(rng, 3, [2, 1])
        B = rng.standard_normal((6, 1 + int(rng.integers(2))))
        form = weierstrass_form(A, E)
        B1, B2 = np.split(form.P @ B, [3])
        slow = np.hstack([np.linalg.matrix_power(form.A1, i) @ B1 for i in range(3)])
        fast = np.hstack([np.linalg.matrix_power(form.N, i) @ B2 for i in range(form.index)])
        both = np.linalg.matrix_rank(slow, tol=1e-8) == 3 and np.linalg.matrix_rank(fast, tol=1e-8) == 3
        assert bool(descriptor_controllability(A, B, E)) == both


# ------------------------------------------------------------------------ simulation


def test_index_1_agrees_with_the_eliminated_system() -> None:
    rng = np.random.default_rng(1)
    control = pytest.importorskip("control")
    for _ in range(5):
        A, E, _ = hidden(rng, 3, [1, 1])
        A = A - 1.5 * E  # slower
        system = StateSpace(A, rng.standard_normal((5, 2)), rng.standard_normal((2, 5)), E=E)
        small = without_algebraic_equations(rs.Plant(A, system.B, system.C, E=E)).system("control")
        t = np.arange(200) * 0.01
        v = np.column_stack([np.sin(3 * t), t])
        run = simulate_descriptor(system, v, dt=0.01, hold="linear")
        other = control.forced_response(control.ss(small.A, small.B, small.C, small.D), t, v.T)
        scale = np.abs(other.outputs).max()
        np.testing.assert_allclose(run.outputs, other.outputs.T, atol=1e-7 * scale)


@pytest.mark.parametrize("chains", [[1, 1], [2], [3]])
def test_simulation_against_fine_implicit_euler(chains: list[int]) -> None:
    rng = np.random.default_rng(sum(chains) + len(chains))
    A, E, A1 = hidden(rng, 2, chains)
    A = A - (np.linalg.eigvals(A1).real.max() + 0.5) * E
    n = len(A)
    B = rng.standard_normal((n, 1))
    system = StateSpace(A, B, np.eye(n), E=E)
    h, T = 1e-4, 1.0
    t = np.arange(round(T / h) + 1) * h

    def wave(order: int, at: np.ndarray) -> np.ndarray:
        return (2.0**order * np.sin(2 * at + order * np.pi / 2))[:, None]

    v, d = wave(0, t), [wave(i, t) for i in (1, 2)]
    x0 = consistent_state(system, rng.standard_normal(n), v[0], derivatives=[x[0] for x in d]).state
    run = simulate_descriptor(system, v, x0=x0, dt=h, derivatives=d, hold="linear")
    np.testing.assert_allclose(run.states[0], x0, atol=1e-9 * np.abs(x0).max())
    solver = scipy.linalg.lu_factor(E / h - A)
    x, worst = run.states[0], 0.0
    for k in range(1, len(t)):
        x = scipy.linalg.lu_solve(solver, E @ x / h + B @ v[k])
        worst = max(worst, np.abs(x - run.states[k]).max()) if k > 5 else worst
    assert worst < 3e-3 * np.abs(run.states).max()
    # and the equations themselves, by central differences
    slope = (run.states[2:] - run.states[:-2]) / (2 * h)
    missed = slope @ E.T - run.states[1:-1] @ A.T - v[1:-1] @ B.T
    assert np.abs(missed).max() < 1e-5 * np.abs(run.states).max()


@pytest.mark.parametrize("chains", [[1], [2, 1], [3]])
def test_a_sampled_system_obeys_its_equations_and_ends_early(chains: list[int]) -> None:
    rng = np.random.default_rng(len(chains))
    A, E, _ = hidden(rng, 2, chains)
    n = len(A)
    system = StateSpace(0.5 * A, rng.standard_normal((n, 2)), rng.standard_normal((1, n)), E=E, dt=0.1)
    v = rng.standard_normal((30, 2))
    run = simulate_descriptor(system, v)
    assert len(run.states) == 30 - (max(chains) - 1)
    missed = run.states[1:] @ E.T - run.states[:-1] @ system.A.T - v[: len(run.states) - 1] @ system.B.T
    assert np.abs(missed).max() < 1e-9 * np.abs(run.states).max()
    np.testing.assert_allclose(run.outputs, run.states @ system.C.T)


def test_held_inputs_are_exact() -> None:
    rng = np.random.default_rng(7)
    A, E, _ = hidden(rng, 3, [1, 1])
    system = StateSpace(A - 2 * E, rng.standard_normal((5, 1)), np.eye(5), E=E)
    v = rng.standard_normal((20, 1))
    coarse = simulate_descriptor(system, v, dt=0.2)
    fine = simulate_descriptor(system, np.repeat(v, 50, axis=0), dt=0.004)
    np.testing.assert_allclose(coarse.states, fine.states[::50], atol=1e-8 * np.abs(fine.states).max())


def test_what_simulation_refuses() -> None:
    system = StateSpace(np.eye(2), [[0.0], [1.0]], np.eye(2), E=[[0, 1], [0, 0]])  # x = -(v', v)
    v = np.ones((4, 1))
    with pytest.raises(ModelError, match="hold='linear'"):
        simulate_descriptor(system, v, dt=0.1)
    with pytest.raises(ModelError, match="first 1 derivatives"):
        simulate_descriptor(system, v, dt=0.1, hold="linear")
    run = simulate_descriptor(system, v, dt=0.1, derivatives=[3 * v], hold="linear")
    np.testing.assert_allclose(run.states, [[-3.0, -1.0]] * 4)
    with pytest.raises(DataError, match="consistent_state"):
        simulate_descriptor(system, v, dt=0.1, derivatives=[v], hold="linear", x0=[0, 0])
    with pytest.raises(ModelError, match="dt"):
        simulate_descriptor(system, v)
    with pytest.raises(SettingError, match="hold"):
        simulate_descriptor(system, v, dt=0.1, hold="spline")
    with pytest.raises(DataError, match="must be"):
        simulate_descriptor(system, np.ones((4, 2)), dt=0.1)
    # An input that does not reach down the chain needs no derivative, whatever the index.
    above = system.replaced(B=[[1.0], [0.0]])
    np.testing.assert_allclose(simulate_descriptor(above, v, dt=0.1).states, [[-1.0, 0.0]] * 4)
    sampled = system.replaced(dt=0.1)
    with pytest.raises(DataError, match="too few"):
        simulate_descriptor(sampled, v[:1])
    with pytest.raises(SettingError, match="later inputs"):
        simulate_descriptor(sampled, v, derivatives=[v])


def test_consistent_states() -> None:
    rng = np.random.default_rng(2)
    A, E, _ = hidden(rng, 2, [2, 1])
    system = StateSpace(A, rng.standard_normal((5, 1)), np.eye(5), E=E)
    v, dv = rng.standard_normal((2, 1))
    with pytest.raises(ModelError, match="derivatives"):
        consistent_state(system, np.ones(5), v)
    first = consistent_state(system, np.ones(5), v, derivatives=[dv])
    assert not first
    again = consistent_state(system, first.state, v, derivatives=[dv])
    assert again
    np.testing.assert_allclose(again.state, first.state, atol=1e-10)
    # The left null vectors of E read the algebraic equations.
    left = scipy.linalg.null_space(E.T)
    np.testing.assert_allclose(left.T @ (A @ first.state + system.B @ v), 0, atol=1e-9)
    assert consistent_state(StateSpace([[-1.0]], [[1.0]], [[1.0]]), [4.0])


@pytest.mark.filterwarnings("error")
def test_the_zero_state_is_consistent_with_no_input() -> None:
    found = consistent_state(StateSpace([[1.0]], [[0.0]], [[1.0]], E=[[0.0]]), [0.0])
    assert found
    assert found.distance == 0.0


@pytest.mark.parametrize("chain", [1, 2, 3, 4])
@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_hidden_modes_at_zero_are_found(chain: int, scale: float) -> None:
    """Poles at zero have no size to compare with; here all of them are there, in one chain that nothing sees."""
    rng = np.random.default_rng(chain)
    n = chain + 2
    A, E, C = np.zeros((n, n)), np.eye(n), np.zeros((1, n))
    A[:chain, :chain] = scale * np.eye(chain, k=1)
    A[chain, chain + 1], A[chain + 1, chain + 1] = 0.0, 1.0
    E[-1, -1], C[0, chain] = 0.0, 1.0
    T, S = rng.standard_normal((n, n)), rng.standard_normal((n, n))
    found = descriptor_observability(T @ A @ S, C @ S, T @ E @ S)
    assert not found.finite
    assert len(found.hidden_modes) == chain
    np.testing.assert_allclose(found.hidden_modes, 0.0, atol=1e-2 * scale)


# --------------------------------------------------------------------- plants


def test_rows_of_rounding_are_no_failed_elimination() -> None:
    """Integer plants of index 1; some rows of the reduced one are zero, and computed as rounding."""
    A = [[-2.0, 0, 0, 0], [0, -2, 0, 0], [0, 0, 0, 1], [0, 0, 0, -2]]
    E = [[0, 0, 2.0, -2], [0] * 4, [2, 2, 5, -1], [0, 0, -2, 2]]
    plant = rs.Plant(A, np.ones((4, 1)), [[1.0, 2, 1, 0]], E=E)
    small = without_algebraic_equations(plant)
    assert small.n_states == np.linalg.matrix_rank(E)
    s = 0.3 + 0.7j
    wanted = plant.C @ np.linalg.solve(s * np.array(E) - plant.A, plant.B)
    np.testing.assert_allclose(
        small.C @ np.linalg.solve(s * np.eye(small.n_states) - small.A, small.B) + small.D, wanted, rtol=1e-9
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_sampling_an_index_1_plant_is_exact_for_held_inputs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, E, A1 = hidden(rng, 3, [1, 1], spread=1.0)
    A = A - (np.linalg.eigvals(A1).real.max() + 0.5) * E
    plant = rs.Plant(A, rng.standard_normal((5, 2)), rng.standard_normal((2, 5)), E=E)
    plant = plant.with_disturbances(rng.standard_normal((5, 1))).with_faults({"f": rng.standard_normal(5)})
    roles = ("control", "disturbance", "fault")
    v = rng.standard_normal((40, 4))
    whole = simulate_descriptor(plant.system(roles), v, dt=0.1).outputs
    sampled = plant.discretize(0.1)
    assert sampled.n_states == 3
    assert sampled.E is None
    np.testing.assert_allclose(sampled.system(roles).simulate(v), whole, atol=1e-8 * np.abs(whole).max())


def test_states_that_stay_keep_their_names_and_units() -> None:
    plant = rs.library.ladder_circuit()
    small = without_algebraic_equations(plant)
    assert small.states == ("i", "vc")
    assert small.units["vc"] == "V"
    assert small.outputs == plant.outputs
    w = np.array([1.0, 50.0, 300.0, 4000.0])
    np.testing.assert_allclose(
        small.system().frequency_response(w), plant.system().frequency_response(w), rtol=1e-9, atol=1e-12
    )
    assert without_algebraic_equations(small) is small
    mixed = rs.Plant([[-1, 1], [1, -1]], [[1], [1]], [[1, 0]], E=[[1, 1], [0, 0]])
    assert without_algebraic_equations(mixed).states == ("slow 1",)


def test_noise_in_algebraic_equations_reaches_the_outputs_directly() -> None:
    plant = rs.Plant([[-1, 0], [1, -1]], [[1], [0]], [[0, 1]], E=np.diag([1.0, 0.0]), states=["a", "b"])
    plant = plant.with_noise(process={"b": 4.0}, measurement=1.0)
    sampled = plant.discretize(0.1)
    # y = a + w_b + v: white noise of intensity 4 + 1, averaged over the step
    np.testing.assert_allclose(sampled.measurement_noise, [[50.0]])
    np.testing.assert_allclose(sampled.process_noise, [[0.0]], atol=1e-15)


def test_index_2_plants_are_refused_with_the_reason() -> None:
    plant = rs.Plant(np.eye(2), [[0], [1]], [[1, 0]], E=[[0, 1], [0, 0]])
    with pytest.raises(ModelError, match=r"index 2 > 1.*impulses"):
        plant.discretize(0.1)
    singular = rs.Plant([[1, 0], [0, 0]], [[0], [1]], [[1, 0]], E=[[1, 0], [0, 0]])
    with pytest.raises(ModelError, match="zero for every s"):
        singular.discretize(0.1)


def test_no_path_leads_where_no_chain_of_equations_does() -> None:
    """Each state follows from an equation of its own: 0 = -3 x2 is not moved by an input of another equation."""
    system = rs.linear.StateSpace(
        [[1, 1, -3], [0, -3, 0], [2, -3, 0]],
        [[0], [0], [-2]],
        np.eye(3),
        np.zeros((3, 1)),
        E=[[1, 0, 0], [0, 0, 0], [0, 0, 0]],
    )
    assert (system.evaluate(0.7)[0, :, 0] != 0).tolist() == [True, False, True]
