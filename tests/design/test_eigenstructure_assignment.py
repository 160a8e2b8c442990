"""Eigenstructure assignment: exact where it exists, a filtered version of the decoupled residual, else refused."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from effort import cases
from generated import random_plant, simulate
from refusals import Refused
from residua.design.detection_filters.eigenstructure_assignment import eigenstructure_assignment
from residua.design.observers.general_residual_generator import residual_generator_from_observer
from residua.errors import AccuracyError, DesignError, ModelError, ResiduaError, SettingError
from residua.linear.poles.zeros import invariant_zeros


def varied_plant(rng: np.random.Generator) -> rs.Plant:
    """Return a plant of one of several makes: with deep faults, sparse, in parts, or moved by what is measured."""
    n, p, m = int(rng.integers(2, 13)), int(rng.integers(2, 6)), int(rng.integers(1, 5))
    base = random_plant(rng, n=n, outputs=p, inputs=m, faults=0)
    A, C, kind = np.array(base.A), np.array(base.C), int(rng.integers(6))
    half = n // 2
    if kind == 1:  # the last state reaches no output at once
        C[:, -1] = 0
    elif kind == 2:  # outputs are states
        C = np.eye(n)[rng.permutation(n)[: min(n, p)]]
    elif kind == 3:  # some states move by what is measured alone: left eigenvectors exist
        A[: min(n, p) - 1, min(n, p) - 1 :] = 0
        C = np.vstack([np.eye(n)[: min(n, p)], rng.standard_normal((p - min(n, p), n))])
    elif kind == 4:
        A = A * (rng.random((n, n)) < 0.4)
    elif kind == 5 and n >= 4:  # two parts, each with zeros of its own
        A[:half, half:], A[half:, :half] = 0, 0
        C[: p // 2, half:], C[p // 2 :, :half] = 0, 0
        C = np.linalg.qr(rng.standard_normal((p, p)))[0] @ C
    plant = rs.Plant(A, base.B, C, dt=base.dt)

    def direction() -> np.ndarray:
        v = rng.standard_normal(n)
        if kind == 1 and rng.random() < 0.6:
            v = np.eye(n)[-1]
        if kind == 5:
            v[half:] = 0
        return v

    count = int(rng.integers(0, min(len(C), 3)))
    if count:
        output = rng.standard_normal((len(C), count)) if rng.random() < 0.3 else None
        plant = plant.with_disturbances(np.column_stack([direction() for _ in range(count)]), output=output)
    plant = plant.with_faults({f"f{i}": direction() for i in range(int(rng.integers(1, 4)))})
    return plant.with_sensor_faults() if rng.random() < 0.5 else plant


def in_other_units(plant: rs.Plant, rng: np.random.Generator, decades: float) -> rs.Plant:
    """Return the plant with the units of its states, inputs and outputs changed by random factors."""
    x, u, y = (10.0 ** rng.uniform(-decades, decades, k) for k in (plant.n_states, len(plant.inputs), plant.n_outputs))
    column, row = x[:, None], y[:, None]
    other = rs.Plant(column * plant.A / x, column * plant.B * u, row * plant.C / x, row * plant.D * u, dt=plant.dt)
    if plant.disturbances:
        other = other.with_disturbances(
            {name: (x * plant.Bd[:, i], y * plant.Dd[:, i]) for i, name in enumerate(plant.disturbances)}
        )
    return other.with_faults({name: (x * plant.Bf[:, i], y * plant.Df[:, i]) for i, name in enumerate(plant.faults)})


def some_faults(plant: rs.Plant, rng: np.random.Generator) -> list[str]:
    most = min(2, len(plant.faults))
    return [str(name) for name in rng.choice(plant.faults, int(rng.integers(0, most + 1)), replace=False)]


def points(plant: rs.Plant) -> np.ndarray:
    w = np.array([0.13, 0.7, 2.3])
    return np.exp(1j * w) if plant.dt else 1j * w


def leak(generator: rs.ResidualGenerator, ignored: list[str]) -> float:
    """Return the response to controls and to what is ignored, driven by the plant, relative to the terms of it."""
    plant, z = generator.plant, points(generator.plant)
    n_u = len(plant.inputs)
    Q = generator.system.evaluate(z)
    P = plant.faults_as_disturbances(ignored).system(("control", "disturbance")).evaluate(z)
    through, terms = Q[:, :, n_u:] @ P, np.abs(Q[:, :, n_u:]) @ np.abs(P)
    through[:, :, :n_u] += Q[:, :, :n_u]
    terms[:, :, :n_u] += np.abs(Q[:, :, :n_u])
    terms += 1e-8 * np.abs(Q[:, :, n_u:]).max(axis=2, keepdims=True) * np.abs(P).max(axis=1, keepdims=True)
    return float((np.abs(through) / np.maximum(terms, 1e-300)).max(initial=0.0))


def off_the_span(generator: rs.ResidualGenerator, other: rs.ResidualGenerator) -> float:
    """Return how far the rows of one generator are from being combinations of those of another, over frequency."""
    n_u, worst = len(generator.plant.inputs), 0.0
    z = points(generator.plant)
    for a, b in zip(generator.system.evaluate(z)[:, :, n_u:], other.system.evaluate(z)[:, :, n_u:], strict=True):
        size = np.abs(np.vstack([a, b])).max(axis=0)
        units = np.where(size > 1e-12 * size.max(), size, np.inf)
        a, b = ((M / units) / np.linalg.norm(M / units, axis=1, keepdims=True) for M in (a, b))
        worst = max(worst, float(np.abs(a - a @ np.linalg.pinv(b, rcond=1e-9) @ b).max()))
    return worst


def check_eigenvectors(found: rs.ResidualGenerator, side: str, ignored: list[str]) -> None:
    """Check by K and S alone that what is ignored lies in an invariant space that S C does not see, and the poles."""
    plant, K, S = found.plant, found.observer.K, found.observer.W
    G = plant.A - K @ plant.C
    H = S @ plant.C
    if side == "left":
        lam, *_ = np.linalg.lstsq(H.T, (H @ G).T, rcond=1e-12)
        np.testing.assert_allclose(lam.T @ H, H @ G, atol=1e-8 * (np.abs(S) @ np.abs(plant.C) @ np.abs(G)).max())
    watched = plant.faults_as_disturbances(ignored)
    x = watched.Bd - K @ watched.Dd
    for z in points(plant):  # the observer's own response to what is ignored, through all of its states
        inverse = np.linalg.inv(z * np.eye(plant.n_states) - G)
        terms = np.abs(S) @ np.abs(plant.C) @ np.abs(inverse) @ (np.abs(watched.Bd) + np.abs(K) @ np.abs(watched.Dd))
        assert np.abs(H @ inverse @ x).max(initial=0.0) <= 1e-8 * terms.max(initial=0.0)
    stable = np.abs(found.evidence.poles) < 1 if plant.dt else found.evidence.poles.real < 0
    assert stable.all()
    assert len(found.evidence.poles) == plant.n_states


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("batch", cases(range(10), 5))
@pytest.mark.refusals(at_most=201)
def test_it_is_a_decoupled_residual_or_refused(batch: int, side: str, refused: Refused) -> None:
    made, inaccurate, told = 0, 0, []
    for k in range(22):
        rng = np.random.default_rng([batch, k])
        plant = varied_plant(rng)
        ignored = some_faults(plant, rng)
        try:
            oracle = rs.design.decoupled_residual(plant, insensitive_to=ignored)
        except DesignError as error:
            if "used up" in str(error):
                with pytest.raises(DesignError):
                    eigenstructure_assignment(plant, side=side, insensitive_to=ignored)
            refused(f"decoupled residual: {error}")
            continue
        try:
            found = eigenstructure_assignment(plant, side=side, insensitive_to=ignored)
        except DesignError as error:  # the left condition, or a plant that is not detectable by what is left
            told.append(str(error))
            refused(error)
            continue
        except AccuracyError as error:
            inaccurate += 1
            refused(error)
            continue
        made += 1
        assert leak(found, ignored) < 1e-8
        assert off_the_span(found, oracle) < 1e-6
        silent = [plant.faults.index(name) for name in ignored]
        assert not found.structure[:, silent].any()
        check_eigenvectors(found, side, ignored)
        if side == "right":  # every row there is: sees whatever the decoupled residual sees
            assert off_the_span(oracle, found) < 1e-6
            np.testing.assert_array_equal(found.structure.any(axis=0), oracle.structure.any(axis=0))
    assert made
    assert inaccurate <= 1
    assert all(("no left eigenvectors" in x and side == "left") or "do not see" in x for x in told)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("batch", range(4))
@pytest.mark.refusals(at_most=55)
def test_in_units_ten_decades_apart_it_is_exact_or_refused(batch: int, side: str, refused: Refused) -> None:
    made = 0
    for k in range(15):
        rng = np.random.default_rng([batch, k])
        plant = varied_plant(rng)
        ignored = some_faults(plant, rng)
        try:
            found = eigenstructure_assignment(in_other_units(plant, rng, 5.0), side=side, insensitive_to=ignored)
        except (DesignError, AccuracyError) as error:
            refused(error)
            continue
        made += 1
        assert leak(found, ignored) < 1e-6
        assert not found.structure[:, [plant.faults.index(name) for name in ignored]].any()
        oracle = rs.design.decoupled_residual(plant, insensitive_to=ignored)  # of the plant in its own units
        assert found.n_residuals <= oracle.n_residuals
    assert made


@pytest.mark.parametrize("seed", range(8))
def test_it_runs_on_data_with_the_ignored_faults(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=5, outputs=4, disturbances=1, faults=2, sensors=True, feedthrough=True, dt=0.1)
    found = eigenstructure_assignment(plant, insensitive_to=["f0", "y2 sensor"])
    np.testing.assert_array_equal(found.observer.K[:, 1], 0)  # that sensor is not used
    np.testing.assert_array_equal(found.observer.W[:, 1], 0)
    for name in ("f0", "y2 sensor"):
        u, y = simulate(plant, rng, 60, fault=name)
        assert np.abs(found.run(u, y)).max() < 1e-8 * max(1.0, np.abs(y).max())
    u, y = simulate(plant, rng, 60, fault="f1")
    assert np.abs(found.run(u, y)).max() > 1e-3
    rs.testing.check_residual_generator(found)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_ignored_columns_are_eigenvectors_with_the_poles_asked_for(dt: float) -> None:
    rng = np.random.default_rng(3)
    plant = random_plant(rng, n=6, outputs=4, disturbances=1, faults=2, dt=dt)
    poles = [0.1, 0.2, 0.3 + 0.1j, 0.3 - 0.1j, 0.4, 0.5]
    poles = np.log(poles) / 0.1 if not dt else np.array(poles)
    found = eigenstructure_assignment(plant, insensitive_to="f0", poles=poles)
    G = plant.A - found.observer.K @ plant.C
    np.testing.assert_allclose(G @ plant.Bd[:, 0], poles[0].real * plant.Bd[:, 0], atol=1e-8 * np.abs(poles).max())
    np.testing.assert_allclose(G @ plant.Bf[:, 0], poles[1].real * plant.Bf[:, 0], atol=1e-8 * np.abs(poles).max())
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(G)), np.sort_complex(poles), rtol=1e-6)
    named = eigenstructure_assignment(plant, insensitive_to="f0", poles={"f0": [poles[4]]})
    np.testing.assert_allclose(
        (plant.A - named.observer.K @ plant.C) @ plant.Bf[:, 0], poles[4].real * plant.Bf[:, 0], rtol=1e-6, atol=1e-8
    )
    assert eigenstructure_assignment(plant, insensitive_to="f0").n_residuals == 2


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_all_gains_of_the_family_give_the_same_residual(dt: float) -> None:
    rng = np.random.default_rng(8)
    plant = random_plant(rng, n=5, outputs=4, faults=3, dt=dt)
    found = eigenstructure_assignment(plant, insensitive_to=["f0", "f1"])
    K, S, F = found.observer.K, found.observer.W, plant.Bf[:, :2]
    other = K + F @ rng.standard_normal((2, 2)) @ S
    poles, moved = (np.sort_complex(np.linalg.eigvals(plant.A - gain @ plant.C)) for gain in (K, other))
    np.testing.assert_allclose(moved, poles, atol=1e-6 * np.abs(poles).max())
    same = residual_generator_from_observer(plant, gain=other, weight=S)
    a, b = (g.system.evaluate(points(plant)) for g in (found, same))
    np.testing.assert_allclose(a, b, atol=1e-9 * np.abs(a).max())


def test_a_fault_that_no_output_sees_at_once_heads_a_chain() -> None:
    A = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0.1, 0.2, -1, 1], [1, 0, 0, -2]], dtype=float)
    plant = rs.Plant(A, [[0], [0], [0], [1]], [[1, 0, 0, 0], [0, 0, 0, 1]])
    plant = plant.with_faults({"deep": [0, 0, 1, 0], "other": [0, 0, 0, 1]})
    found = eigenstructure_assignment(plant, insensitive_to="deep", poles=[-1, -2, -3, -4])
    assert any("chain" in note for note in found.evidence.notes)
    G = plant.A - found.observer.K @ plant.C
    f = plant.Bf[:, 0]
    end = G @ (G @ (G @ f)) + 6 * G @ (G @ f) + 11 * G @ f + 6 * f  # p(G) f = 0 with p = (s+1)(s+2)(s+3)
    np.testing.assert_allclose(end, 0, atol=1e-9)
    np.testing.assert_allclose(np.sort(found.system.poles().real), [-4], atol=1e-9)
    np.testing.assert_array_equal(found.structure, [[False, True]])


def plant_with_zero(zero: float) -> rs.Plant:
    """Two parts; the first has one output, driven by the fault through a zero of its own."""
    A = np.array([[0, 1, 0.0], [-0.02, 0.3, 0], [0, 0, 0.5]])
    C = np.array([[-zero, 1, 0], [0, 0, 1.0]])  # (z - zero) / (z^2 - .3 z + .02)
    plant = rs.Plant(A, [[1], [0], [1]], C, dt=1).with_faults({"f": [0, 1, 0], "g": [0, 0, 1]})
    assert np.isclose(invariant_zeros(plant.A, plant.Bf[:, :1], plant.C).zeros, zero).any()
    return plant


def test_stable_invariant_zeros_are_fixed_poles_and_others_need_more_eigenvectors() -> None:
    found = eigenstructure_assignment(plant_with_zero(0.6), insensitive_to="f")
    np.testing.assert_allclose(found.evidence.fixed_poles, [0.6], atol=1e-9)
    with pytest.raises(DesignError, match=r"invariant zero 1\.5 .* not stable"):
        eigenstructure_assignment(plant_with_zero(1.5), insensitive_to="f", combine=False)
    with pytest.raises(DesignError, match="is not among the requested poles"):
        eigenstructure_assignment(plant_with_zero(0.6), insensitive_to="f", combine=False, poles=[0.1, 0.2, 0.3])
    for zero, poles in ((1.5, None), (0.6, [0.1, 0.2, 0.3])):
        plant = plant_with_zero(zero)
        found = eigenstructure_assignment(plant, insensitive_to="f", poles=poles)
        assert any("combinations of 2 eigenvectors" in note for note in found.evidence.notes)
        assert leak(found, ["f"]) < 1e-12
        np.testing.assert_array_equal(found.structure, [[False, True]])
        K = found.observer.K
        achieved = np.sort(np.linalg.eigvals(plant.A - K @ plant.C).real)
        assert np.abs(achieved).max() < 1
        if poles:
            np.testing.assert_allclose(achieved, poles, atol=1e-9)


def test_with_a_margin_slower_zeros_are_no_fixed_poles() -> None:
    plant = plant_with_zero(0.6)
    found = eigenstructure_assignment(plant, insensitive_to="f", margin=1.0)
    assert np.abs(found.evidence.poles).max() < np.exp(-1.0)


def measured_plant(dt: float = 0.1) -> rs.Plant:
    """A plant with left eigenvectors: the first two states move by what is measured alone."""
    A = np.array([[0.5, 0.2, 0, 0], [0.1, 0.6, 0, 0], [0.3, 0.1, 0.7, 0.2], [0, 0.2, 0.1, 0.4]])
    C = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1]])
    plant = rs.Plant(A, [[1], [0], [0], [1]], C, dt=dt)
    return plant.with_faults({"a": [1, 0, 0, 0], "b": [0, 1, 0, 0], "c": [0, 0, 1, 0]})


def test_left_eigenvectors_give_first_order_residuals() -> None:
    plant = measured_plant()
    found = eigenstructure_assignment(plant, side="left", insensitive_to="a", poles=[0.35, 0.1, 0.2, 0.3])
    assert found.system.n_states == 1
    np.testing.assert_allclose(np.sort(found.evidence.poles.real), [0.1, 0.2, 0.3, 0.35], atol=1e-9)
    h = found.observer.W @ plant.C
    np.testing.assert_allclose(h @ (plant.A - found.observer.K @ plant.C), 0.35 * h, atol=1e-12)
    z = np.exp(1j * np.array([0.3, 1.1]))
    response = found.internal_form().evaluate(z)[:, 0, :3]
    np.testing.assert_allclose(response, (h @ plant.Bf) / (z - 0.35)[:, None], atol=1e-12)
    np.testing.assert_array_equal(found.structure, [[False, True, False]])
    sees_c = eigenstructure_assignment(plant, side="right", insensitive_to="a")  # has a row that sees c as well
    assert sees_c.structure.any(axis=0)[2]


def test_in_continuous_time_left_eigenvalues_follow_the_margin() -> None:
    found = eigenstructure_assignment(
        rs.Plant([[-1.0, 0], [0.5, -2]], [[1], [0]], np.eye(2)).with_faults({"a": [1, 0], "b": [0, 1]}),
        side="left",
        insensitive_to="a",
        margin=7.0,
    )
    np.testing.assert_allclose(found.system.poles(), [-7], atol=1e-9)


def test_measurements_that_repeat_one_another_need_no_eigenvector() -> None:
    plant = rs.Plant([[0.5, 1], [0, 0.7]], [[0], [1]], [[1, 0], [2, 0], [0, 1]], dt=1)
    plant = plant.with_faults({"f": [1, 0]}).with_sensor_faults("y2")
    for side in ("left", "right"):
        found = eigenstructure_assignment(plant, side=side, insensitive_to="f")
        assert leak(found, ["f"]) < 1e-12
        np.testing.assert_array_equal(found.structure.any(axis=0), [False, True])


@pytest.mark.parametrize("seed", range(12))
def test_the_approximate_left_design_tells_what_leaks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_plant(rng, n=6, outputs=3, faults=2, dt=0.1)
    with pytest.raises(DesignError, match=r"rank \[C; h A\] = 4 > rank C = 3"):
        eigenstructure_assignment(plant, side="left", insensitive_to="f0")
    found = eigenstructure_assignment(plant, side="left", insensitive_to="f0", approximate=True)
    assert "control" in found.evidence.decoupling
    told = found.evidence.decoupling["f0, leaking"]
    w = np.linspace(0.01, np.pi, 4000)
    system = plant.system("fault").evaluate(np.exp(1j * w))
    response = np.abs(found.system.evaluate(np.exp(1j * w))[:, :, len(plant.inputs) :] @ system).max(axis=(0, 1))
    assert told == pytest.approx(response[0] / response[1], rel=0.05)
    assert told > 1e-6
    u, y = simulate(plant, rng, 60)
    assert np.abs(found.run(u, y)).max() < 1e-9 * max(1.0, np.abs(y).max())
    rs.testing.check_residual_generator(found)


def test_where_it_is_exact_the_approximate_design_is_the_exact_one() -> None:
    plant = measured_plant()
    a, b = (eigenstructure_assignment(plant, side="left", insensitive_to="a", approximate=x) for x in (False, True))
    np.testing.assert_array_equal(a.observer.K, b.observer.K)
    assert not any("leaking" in name for name in b.evidence.decoupling)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"side": "both"}, SettingError, "side must be 'right' or 'left'"),
        ({"approximate": True}, SettingError, "belongs to side='left'"),
        ({"insensitive_to": "p9"}, ModelError, "unknown fault 'p9'"),
        ({"insensitive_to": "p1", "poles": [0, 0.2]}, DesignError, "2 poles were given, 3 are free"),
        ({"insensitive_to": "p1", "poles": [0, 0.2, 1.2]}, DesignError, "1.2 is not stable"),
        ({"insensitive_to": "p1", "poles": [1.2, 0.2, 0.1]}, DesignError, "1.2 is not stable"),
        ({"insensitive_to": "p1", "poles": {"p2": [0.1]}}, DesignError, "unknown fault 'p2'"),
        ({"insensitive_to": "p1", "poles": [0, 0.2, 0.3], "margin": 1.0}, DesignError, "not both"),
        ({"insensitive_to": ["p1", "p2"]}, DesignError, "no residual ignores 'p1', 'p2'"),
        ({"insensitive_to": ["p1", "p2"], "side": "left"}, DesignError, "no residual row is blind to 'p1', 'p2'"),
    ],
)
def test_what_is_wrong_is_told(options: dict, error: type[ResiduaError], words: str) -> None:
    with pytest.raises(error, match=words):
        eigenstructure_assignment(rs.library.gertler(), **options)


def test_plants_that_it_does_not_serve_are_told() -> None:
    singular = rs.Plant([[-1, 1], [1, 1]], [[1], [0]], np.eye(2), E=[[1, 0], [0, 0]]).with_sensor_faults()
    with pytest.raises(DesignError, match="E is singular"):
        eigenstructure_assignment(singular, insensitive_to="y1 sensor")
    hidden = rs.Plant(np.diag([1.2, 0.5]), [[1], [1]], [[1, 0], [0, 1], [0, 2]], dt=1)
    hidden = hidden.with_faults({"f": [0, 1]}).with_sensor_faults()
    with pytest.raises(DesignError, match=r"the mode 1\.2, which .* do not see, is not stable;.*decoupled_residual"):
        eigenstructure_assignment(hidden, insensitive_to="y1 sensor")
    assert rs.design.decoupled_residual(hidden, insensitive_to="y1 sensor").n_residuals == 2
    direct = rs.Plant([[0.5]], [[1]], [[1], [1]], dt=1).with_sensor_faults()
    with pytest.raises(DesignError, match="they enter all 2 outputs directly"):
        eigenstructure_assignment(direct, insensitive_to=["y1 sensor", "y2 sensor"])


def with_a_hidden_mode() -> rs.Plant:
    """Return a plant with two equal lags in one output: their difference, with the pole -1, is seen by none."""
    plant = rs.Plant(np.diag([-2, -1, -1]), np.zeros((3, 0)), [[1, 0, 0], [0, 1, 1]])
    return plant.with_faults({"f": [1, 0, 0], "other": [1, 1, 1]})


@pytest.mark.parametrize("combine", [True, False])
def test_a_hidden_mode_is_a_fixed_pole_in_combined_spaces_too(combine: bool) -> None:
    """A margin was promised and missed: the space of combinations has all in it that no output sees."""
    plant = with_a_hidden_mode()
    with pytest.raises(DesignError, match=r"the mode -1, which the measurements .* not stable with the margin 1\.5"):
        eigenstructure_assignment(plant, insensitive_to="f", margin=1.5, combine=combine)
    found = eigenstructure_assignment(plant, insensitive_to="f", margin=0.5, combine=combine)
    np.testing.assert_allclose(found.evidence.fixed_poles, [-1])


@pytest.mark.parametrize("poles", [[-3, -4], [-3, -4, -1], {"f": [-3], "rest": [-4]}], ids=["free", "all", "named"])
def test_a_detection_filter_says_what_no_gain_moves(poles: object) -> None:
    """A list with or without the fixed pole was refused, each for the sake of the other."""
    found = rs.design.detection_filter(with_a_hidden_mode(), faults=["f"], poles=poles)
    np.testing.assert_allclose(np.sort(found.evidence.poles.real), [-4, -3, -1])
    np.testing.assert_allclose(found.evidence.fixed_poles, [-1])


def test_nothing_to_ignore_is_a_plain_observer() -> None:
    plant = rs.library.gertler()
    found = eigenstructure_assignment(plant, poles=[0.1, 0.2, 0.3])
    plain = rs.design.luenberger_observer(plant, poles=[0.1, 0.2, 0.3])
    assert off_the_span(found, plain.residual_generator()) < 1e-9
    assert found.n_residuals == 2


def test_disturbances_that_enter_the_outputs_are_ignored_too() -> None:
    rng = np.random.default_rng(5)
    plant = random_plant(rng, n=5, outputs=4, faults=2, dt=0.1)
    plant = plant.with_disturbances(rng.standard_normal((5, 1)), output=rng.standard_normal((4, 1)))
    found = eigenstructure_assignment(plant, insensitive_to="f0")
    K, S = found.observer.K, found.observer.W
    np.testing.assert_allclose(S @ plant.Dd, 0, atol=1e-12)
    np.testing.assert_allclose(K @ plant.Dd, plant.Bd, atol=1e-9)  # so that it does not reach the error at all
    assert leak(found, ["f0"]) < 1e-12
    assert found.evidence.decoupling["everything ignored"] < 1e-12
