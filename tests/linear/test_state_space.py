"""Systems as values, against python-control."""

from __future__ import annotations

import numpy as np
import pytest

from residua.errors import ModelError
from residua.linear import StateSpace

control = pytest.importorskip("control")


def random_system(rng: np.random.Generator, dt: float, n: int = 4, m: int = 2, p: int = 3) -> StateSpace:
    A = rng.standard_normal((n, n)) * (0.3 if dt else 1.0)
    return StateSpace(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), rng.standard_normal((p, m)), dt=dt)


def theirs(system: StateSpace):
    return control.ss(system.A, system.B, system.C, system.D, system.dt)


W = np.array([0.1, 0.7, 2.0])


def response(system) -> np.ndarray:
    s = np.exp(1j * W * system.dt) if system.dt else 1j * W
    return np.stack([system(x) for x in s])


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_frequency_response_poles_and_dc_gain(dt: float) -> None:
    system = random_system(np.random.default_rng(0), dt)
    np.testing.assert_allclose(system.frequency_response(W), response(theirs(system)), rtol=1e-10)
    np.testing.assert_allclose(np.sort_complex(system.poles()), np.sort_complex(theirs(system).poles()), rtol=1e-8)
    np.testing.assert_allclose(system.dc_gain(), theirs(system).dcgain(), rtol=1e-10)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_connections(dt: float) -> None:
    rng = np.random.default_rng(1)
    a, b, c = random_system(rng, dt), random_system(rng, dt, n=2, m=3, p=2), random_system(rng, dt)
    np.testing.assert_allclose(
        a.series(b).frequency_response(W), b.frequency_response(W) @ a.frequency_response(W), rtol=1e-10
    )
    np.testing.assert_allclose(
        a.parallel(c).frequency_response(W), a.frequency_response(W) + c.frequency_response(W), rtol=1e-10
    )
    both = a.append(b).frequency_response(W)
    np.testing.assert_allclose(both[:, :3, :2], a.frequency_response(W), rtol=1e-10)
    np.testing.assert_allclose(both[:, 3:, 2:], b.frequency_response(W), rtol=1e-10)
    assert np.all(both[:, 3:, :2] == 0)
    with pytest.raises(ModelError, match="series"):
        a.series(a)
    with pytest.raises(ModelError, match="parallel"):
        a.parallel(b)
    with pytest.raises(ModelError, match="dt="):
        a.series(b.replaced(dt=0.5))


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_descriptor_systems_evaluate_like_their_explicit_form(dt: float) -> None:
    rng = np.random.default_rng(2)
    a = random_system(rng, dt)
    M = rng.standard_normal((4, 4))
    d = StateSpace(M @ a.A, M @ a.B, a.C, a.D, E=M, dt=dt)
    np.testing.assert_allclose(d.frequency_response(W), a.frequency_response(W), rtol=1e-8)
    np.testing.assert_allclose(d.explicit().frequency_response(W), a.frequency_response(W), rtol=1e-8)
    np.testing.assert_allclose(np.sort_complex(d.poles().round(8)), np.sort_complex(a.poles().round(8)), atol=1e-7)
    singular = StateSpace([[-1, 1], [1, -1]], [[1], [0]], [[1, 0]], E=np.diag([1, 0]))
    assert len(singular.poles()) == 1
    with pytest.raises(ModelError, match="singular"):
        singular.explicit()


def test_selection_by_name_and_number() -> None:
    a = random_system(np.random.default_rng(3), 0.0)
    part = a.select(outputs=["y3", 0], inputs="v2")
    np.testing.assert_allclose(part.frequency_response(W), a.frequency_response(W)[:, [2, 0]][:, :, [1]])
    assert part.outputs == ("y3", "y1")
    with pytest.raises(ModelError, match="unknown output 'z'; known: y1, y2, y3"):
        a.select(outputs=["z"])


def test_simulation_is_the_recursion() -> None:
    rng = np.random.default_rng(4)
    a, v = random_system(rng, 0.1), rng.standard_normal((30, 2))
    x, expected = rng.standard_normal(4), []
    start = x.copy()
    for sample in v:
        expected.append(a.C @ x + a.D @ sample)
        x = a.A @ x + a.B @ sample
    np.testing.assert_allclose(a.simulate(v, start), expected, rtol=1e-10)
    fleet = a.simulate(np.stack([v, -v]), start)
    assert np.array_equal(fleet[0], a.simulate(v, start))
    with pytest.raises(ModelError, match="discretize"):
        random_system(rng, 0.0).simulate(v)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([[1, 2]], [[1]], [[1]]), "A must be square"),
        (([[1]], [[1], [2]], [[1]]), "B must be 1 x any"),
        (([[1]], [[1]], [[1, 2]]), "C must be any x 1"),
        (([[1]], [[1]], [[1]], [[1, 2]]), "D must be 1 x 1"),
        (([[np.nan]], [[1]], [[1]]), "finite"),
        (([[1j]], [[1]], [[1]]), "real|complex"),
        (([["a"]], [[1]], [[1]]), "numbers"),
    ],
)
def test_bad_matrices_are_refused(arguments: tuple, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        StateSpace(*arguments)


def test_bad_names_and_steps_are_refused() -> None:
    with pytest.raises(ModelError, match="twice"):
        StateSpace([[1]], [[1, 1]], [[1]], inputs=["a", "a"])
    with pytest.raises(ModelError, match="expected 1 names"):
        StateSpace([[1]], [[1]], [[1]], outputs=["a", "b"])
    for dt in (-1, np.nan, np.inf, "x", True):
        with pytest.raises(ModelError, match="dt"):
            StateSpace([[1]], [[1]], [[1]], dt=dt)  # pyright: ignore[reportArgumentType]


def test_values_do_not_change() -> None:
    a = random_system(np.random.default_rng(5), 0.0)
    with pytest.raises(ValueError, match="read-only"):
        a.A[0, 0] = 1
    with pytest.raises(AttributeError):
        a.dt = 1  # pyright: ignore[reportAttributeAccessIssue]
