"""Paper 000: the jet engine's printed matrices, the ideal projection distances, and who names the right sensor."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.decide import correlation, projection_distance
from residua.library.jet_engine import E_HAT

SENSORS = ["n_low", "n_high", "fuel_flow"]
H_PRINTED = [
    [0.6117, -0.1170, 0, 0.3215, 0.3220, -0.1295],
    [-0.1170, 0.9382, 0, 0.0605, 0.0623, -0.1916],
    [0, 0, 0, 0, 0, 0],
]
T_PRINTED = [[0, 0, -0.1251], [0, 0, 0.0783], [0, 0, 1.0]]
K_PRINTED = [
    [-0.0708, 0.0443, 0.5658, 0.1400, 0.1531, 0.3540],
    [0.0443, -0.0277, -0.3540, -0.0876, -0.0958, -0.2215],
    [0.5658, -0.3540, -4.5229, -1.1193, -1.2239, -2.8297],
]
E1_PRINTED = [[6.2006, 2.8639], [4.1048, -4.3262], [0, 0]]


def engine(*, corrected: bool = True, E: object = E1_PRINTED) -> rs.Plant:
    plant = rs.library.jet_engine(corrected=corrected).without_disturbances().without_faults()
    return plant.with_disturbances(E).with_sensor_faults(SENSORS)  # pyright: ignore[reportArgumentType]


def test_v1_matrices_of_the_robust_filter() -> None:
    plant = engine()
    flt = rs.design.robust_detection_filter(plant, poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    observer = flt.observer
    assert observer is not None
    np.testing.assert_allclose(observer.H, H_PRINTED, atol=6e-5)
    np.testing.assert_allclose(observer.T, T_PRINTED, atol=8e-5)
    np.testing.assert_allclose(observer.K, K_PRINTED, atol=2.5e-4)
    A1 = observer.T @ plant.A
    identity = (A1 + 3 * np.eye(3)) @ np.linalg.pinv(plant.C) - 3 * observer.H
    np.testing.assert_allclose(observer.K, identity, atol=1e-12)
    np.testing.assert_allclose(flt.evidence.poles, [-3, -3, -3], atol=1e-10)


def test_v1_the_observer_alone_gives_the_same() -> None:
    observer = rs.design.unknown_input_observer(engine(), poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    np.testing.assert_allclose(observer.H, H_PRINTED, atol=6e-5)
    np.testing.assert_allclose(observer.K, K_PRINTED, atol=2.5e-4)
    np.testing.assert_allclose(observer.K, observer.K1 + observer.K2, atol=1e-13)
    np.testing.assert_allclose(observer.F, observer.A1 - observer.K1 @ observer.plant.C, atol=1e-12)


def test_v1_with_the_misprinted_entry() -> None:
    observer = rs.design.unknown_input_observer(engine(corrected=False), poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    assert observer.K[2, 2] == pytest.approx(-4.51916, abs=1e-5)
    assert observer.T[0, 2] == pytest.approx(-0.12496, abs=1e-5)


def test_v1_only_the_range_of_the_disturbance_matrix_matters() -> None:
    first = rs.design.unknown_input_observer(engine(), poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    second = rs.design.unknown_input_observer(engine(E=np.eye(3)[:, :2]), poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    np.testing.assert_allclose(first.H, second.H, atol=1e-12)


def test_general_solution_with_h0() -> None:
    rng = np.random.default_rng(0)
    plant = engine()
    for _ in range(5):
        observer = rs.design.unknown_input_observer(plant, H0=rng.standard_normal((3, 6)))
        np.testing.assert_allclose((observer.H @ plant.C - np.eye(3)) @ plant.Bd, 0, atol=1e-11)
        assert observer.system.is_stable()


def signature(flt: rs.design.ResidualGenerator, j: int, columns: int) -> np.ndarray:
    """Return Phi_j of Definition 6: [I_j, C k_1j, C h_j], or its first columns."""
    o = flt.observer
    assert o is not None
    C = flt.plant.C
    return np.column_stack([np.eye(6)[:, j], C @ o.K1[:, j], C @ o.H[:, j]])[:, :columns]


@pytest.mark.parametrize(
    ("columns", "table"),
    [
        (3, [[0, 0.41584, 0.21139], [0.48443, 0, 0.20276], [0.85635, 0.70509, 0]]),
        (2, [[0, 0.94531, 0.87693], [0.96668, 0, 0.80697], [0.85635, 0.70509, 0]]),
    ],
)
def test_v2_ideal_projection_distances(columns: int, table: list[list[float]]) -> None:
    flt = rs.design.robust_detection_filter(engine(), poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    for j, sensor in enumerate(SENSORS):
        r = flt.steady_directions[f"{sensor} sensor"]
        for i in range(3):
            Phi = signature(flt, i, columns)
            npd = projection_distance(r, Phi)
            assert npd == pytest.approx(table[i][j], abs=1e-4 if i != j else 1e-10)
            assert correlation(r, Phi) ** 2 + npd**2 == pytest.approx(1, abs=1e-12)


def test_signature_subspaces_lie_in_those_of_definition_6() -> None:
    flt = rs.design.robust_detection_filter(engine(), poles=[-3, -3, -3], H0=np.zeros((3, 6)))
    for j, sensor in enumerate(SENSORS):
        for column in flt.subspaces[f"{sensor} sensor"].T:
            assert projection_distance(column, signature(flt, j, 3)) < 1e-9


def quadratic_steady_state(plant: rs.Plant, u: float) -> np.ndarray:
    """Return the rest state of x' = A x + B u + E d(x), by Newton's method from the linear one."""
    E = np.array(E_HAT)
    x = -np.linalg.solve(plant.A, plant.B[:, 0] * u)
    for _ in range(50):
        f = plant.A @ x + plant.B[:, 0] * u + E @ rs.plant.quadratic_terms(x)
        J = np.column_stack(
            [
                plant.A[:, k]
                + E @ (rs.plant.quadratic_terms(x + 1e-6 * e) - rs.plant.quadratic_terms(x - 1e-6 * e)) / 2e-6
                for k, e in enumerate(np.eye(3))
            ]
        )
        x = x - np.linalg.solve(J, f)
    return x


@pytest.mark.parametrize(("robust", "wrong"), [(False, {"n_high", "fuel_flow"}), (True, set())])
def test_on_the_quadratic_plant_only_the_robust_filter_names_every_sensor(robust: bool, wrong: set[str]) -> None:
    plant = engine()
    design = rs.design.robust_detection_filter if robust else rs.design.detection_filter
    flt = design(plant, poles=[-3, -3, -3])
    x = quadratic_steady_state(plant, 0.2)
    found_wrong = set()
    for j, sensor in enumerate(SENSORS):
        y = plant.C @ x
        y[j] *= 1.02
        r = flt.system.dc_gain() @ np.concatenate([[0.2], y])
        distances = [projection_distance(r, signature(flt, i, 3)) for i in range(3)]
        if int(np.argmin(distances)) != j:
            found_wrong.add(sensor)
    assert found_wrong == wrong


def test_v3_twardy_and_kaczorek() -> None:
    plant = rs.library.twardy()
    observer = rs.design.unknown_input_observer(plant, poles=[-2, -2 + 1j, -2 - 1j])
    np.testing.assert_allclose(observer.H, [[1, 0], [0, 0], [0, 0]], atol=1e-12)
    np.testing.assert_allclose(observer.T, np.diag([0, 1, 1]), atol=1e-12)
    np.testing.assert_allclose(observer.A1, [[0, 0, 0], [-1, 0, 0], [0, -1, -1]], atol=1e-12)
    poles = sorted(observer.poles, key=lambda pole: pole.imag)  # rounding decides the order by real part
    np.testing.assert_allclose(poles, [-2 - 1j, -2, -2 + 1j], atol=1e-9)
    C, A1 = plant.C, observer.A1
    ours = np.array([[2.0, 0], [-1, -5], [0, 3]])
    F = A1 - ours @ C
    np.testing.assert_allclose(F, [[-2, 0, 0], [0, 0, 5], [0, -1, -4]], atol=1e-12)
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(F)), [-2 - 1j, -2, -2 + 1j], atol=1e-9)
    np.testing.assert_allclose(ours + F @ observer.H, [[0, 0], [-1, -5], [0, 3]], atol=1e-12)
    printed = np.array([[1.0, 0], [-1, -5], [0, 3]])
    poles = np.sort_complex(np.linalg.eigvals(A1 - printed @ C))
    np.testing.assert_allclose(poles, [-2 - 1j, -2 + 1j, -1], atol=1e-9)


def test_v6_gertler_example_3a() -> None:
    plant = rs.library.gertler()
    flt = rs.design.detection_filter(plant, poles={"p1": [0.25], "p2": [0.3]})
    assert flt.observer is not None
    np.testing.assert_allclose(flt.observer.K, [[0.1, -0.05], [0.1, 0.05], [-0.2, 0.4]], atol=1e-10)
    z = np.exp(1j * np.linspace(0.1, 3, 7))
    response = flt.internal_form(plant).evaluate(z)
    np.testing.assert_allclose(response[:, :, 0], np.outer(1 / (z - 0.25), [2, 1]), atol=1e-10)
    np.testing.assert_allclose(response[:, :, 1], np.outer(1 / (z - 0.3), [1, 2]), atol=1e-10)
