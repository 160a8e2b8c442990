"""Gertler's survey, Examples 2 C, 2 D and 3 A: eigenstructure assignment and the general form (E-V5, E-V6)."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import residua as rs
from residua.design.detection_filters.eigenstructure_assignment import eigenstructure_assignment
from residua.design.observers.general_residual_generator import general_form, residual_generator_from_observer
from residua.errors import DesignError

PRINTED = np.array([[1, -1.6], [1.028, -1.556], [-0.289, 0.578]])
CORRECT = np.array([[1, -8 / 5], [67 / 60, -26 / 15], [-13 / 30, 13 / 15]])
Z = np.exp(1j * np.array([0.2, 1.0, 2.5]))
M, N = [[0.25, 0], [0, 0.3]], [[0.975, -2.6], [0.6, -1.8]]
T, J = [[6.5, -6.5, -4], [6, -6, -3]], [[-3.65], [-3.3]]
LS, LY = [[-2, 2]], [[1, -2]]


def check_input_output_form(generator: rs.ResidualGenerator) -> None:
    """(z - .25)(z - .3) r = (.7 z - .54) u + (z - .4)(z - .9) y1 - (2 z - .9)(z - .9) y2, up to scale."""
    u, y1, y2 = generator.system.evaluate(Z)[:, 0].T * ((Z - 0.25) * (Z - 0.3))
    scale = y1 / ((Z - 0.4) * (Z - 0.9))
    np.testing.assert_allclose(scale, scale[0].real, atol=1e-9)
    np.testing.assert_allclose(u / scale, 0.7 * Z - 0.54, atol=1e-9)
    np.testing.assert_allclose(y2 / scale, -(2 * Z - 0.9) * (Z - 0.9), atol=1e-9)


def test_v5_c_the_printed_gain_belongs_to_another_pole() -> None:
    plant = rs.library.gertler()
    poles = np.sort(np.linalg.eigvals(plant.A - PRINTED @ plant.C).real)
    np.testing.assert_allclose(poles, [0, 0.2504, 0.4996], atol=5e-4)
    found = eigenstructure_assignment(plant, insensitive_to="p1", poles=[0, 0.25, 0.5])
    off = PRINTED - found.observer.K  # but for the family K + F X S and four printed digits
    step = np.outer(plant.Bf[:, 0], off[0])
    np.testing.assert_allclose(off, step, atol=2e-3)
    exact = [[1, -8 / 5], [37 / 36, -14 / 9], [-13 / 45, 26 / 45]]
    check_member(found, np.array(exact))


def check_member(found: rs.ResidualGenerator, K: np.ndarray) -> None:
    """K is of the family found.observer.K + f X S, whatever X: same poles, same residual."""
    f, S = found.plant.Bf[:, [0]], found.observer.W
    off = K - found.observer.K
    X = np.linalg.pinv(f) @ off @ np.linalg.pinv(S)
    np.testing.assert_allclose(f @ X @ S, off, atol=1e-9)


def test_v5_c_right_eigenvectors() -> None:
    plant = rs.library.gertler()
    found = eigenstructure_assignment(plant, insensitive_to="p1", poles=[0, 0.25, 0.3])
    K, S = found.observer.K, found.observer.W
    G = plant.A - K @ plant.C
    np.testing.assert_allclose(G @ plant.Bf[:, 0], 0, atol=1e-12)
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(G).real), [0, 0.25, 0.3], atol=1e-9)
    np.testing.assert_allclose(np.sort(found.evidence.poles.real), [0, 0.25, 0.3], atol=1e-9)
    np.testing.assert_allclose(S / S[0, 0], [[1, -2]], atol=1e-12)
    np.testing.assert_allclose(S @ plant.C / S[0, 0], [[1, -1, -2]], atol=1e-12)
    check_member(found, CORRECT)
    k11, k12, k21, k22, k31, k32 = K[0, 0], K[0, 1], K[1, 0], K[1, 1], K[2, 0], K[2, 1]
    np.testing.assert_allclose(
        [k11, k12, k21, k31, k32], [2 / 15 - k22 / 2, 2 / 15 + k22, 1 / 4 - k22 / 2, -13 / 30, 13 / 15], atol=1e-10
    )
    check_input_output_form(found)
    np.testing.assert_array_equal(found.structure, [[False, True]])
    np.testing.assert_allclose(np.sort(found.system.poles().real), [0.25, 0.3], atol=1e-9)


def test_v5_c_the_member_with_k11_equal_to_one() -> None:
    """In exact arithmetic too: the corrected gain has the poles 0, 1/4 and 3/10, and f1 in its null space."""
    A = [[Fraction(2, 5), 0, 0], [0, Fraction(1, 2), 0], [0, 0, Fraction(9, 10)]]
    C = [[1, 1, 0], [0, 1, 1]]
    K = [[Fraction(1), Fraction(-8, 5)], [Fraction(67, 60), Fraction(-26, 15)], [Fraction(-13, 30), Fraction(13, 15)]]
    G = [[A[i][j] - sum(K[i][k] * C[k][j] for k in range(2)) for j in range(3)] for i in range(3)]
    assert [row[0] + row[1] for row in G] == [0, 0, 0]
    assert sum(G[i][i] for i in range(3)) == Fraction(1, 4) + Fraction(3, 10)
    minors = sum(G[i][i] * G[j][j] - G[i][j] * G[j][i] for i, j in ((0, 1), (0, 2), (1, 2)))
    assert minors == Fraction(1, 4) * Fraction(3, 10)
    generator = residual_generator_from_observer(rs.library.gertler(), gain=CORRECT, weight=[[1, -2]])
    check_input_output_form(generator)
    np.testing.assert_array_equal(generator.structure, [[False, True]])


def test_v5_c_left_eigenvectors_do_not_exist() -> None:
    with pytest.raises(DesignError, match=r"rank \[C; h A\] = 3 > rank C = 2.*h = \[1, -1, -2\]"):
        eigenstructure_assignment(rs.library.gertler(), insensitive_to="p1", side="left")


def test_v5_d_the_printed_unknown_input_observer() -> None:
    plant = rs.library.gertler().faults_as_disturbances("p1")
    for given in ({}, {"T": T}):
        found = residual_generator_from_observer(plant, M=M, J=J, N=N, Ls=LS, Ly=LY, **given)
        np.testing.assert_allclose(found.state_map, T, atol=1e-12)
        check_input_output_form(found)
        form = general_form(found)
        assert max(form.conditions.values()) < 1e-14
        assert form.decouples
        assert form.keeps_faults_apart
        assert form.rank_TF.rank == form.rank_F.rank == 1
    np.testing.assert_allclose(form.first_response, [[-3.0]], atol=1e-12)  # -3 (z - .6) / ((z - .25)(z - .3))


def test_v5_d_the_decoupled_residual_in_the_general_form() -> None:
    """The same observer, up to the coordinates of its state and the scale of the residual."""
    form = general_form(rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1", poles=[0.25, 0.3]))
    values, X = np.linalg.eig(form.M)
    order = np.argsort(values.real)
    found = np.linalg.inv(X[:, order]) @ form.T
    for row, printed in zip(found, np.array(T), strict=True):
        np.testing.assert_allclose(row / row[0], printed / printed[0], atol=1e-9)


def test_v6_a_both_faults_are_eigenvectors() -> None:
    plant = rs.library.gertler()
    expected = [[0.1, -0.05], [0.1, 0.05], [-0.2, 0.4]]
    found = rs.design.detection_filter(plant, poles=[0.25, 0.3])
    K = found.observer.K
    np.testing.assert_allclose(K, expected, atol=1e-10)
    F, L = plant.Bf, np.diag([0.25, 0.3])
    np.testing.assert_allclose(K, (plant.A @ F - F @ L) @ np.linalg.inv(plant.C @ F), atol=1e-10)
    np.testing.assert_allclose((plant.A - K @ plant.C) @ F, F @ L, atol=1e-10)
    np.testing.assert_allclose(found.evidence.fixed_poles, [0.6], atol=1e-9)
    response = found.internal_form().evaluate(Z)[:, :, :2]
    np.testing.assert_allclose(response[:, :, 0], np.outer(1 / (Z - 0.25), [2, 1]), atol=1e-10)
    np.testing.assert_allclose(response[:, :, 1], np.outer(1 / (Z - 0.3), [1, 2]), atol=1e-10)


def test_v6_a_one_of_its_residuals_is_the_right_eigenvector_design() -> None:
    """With the pole .6, which that filter cannot move, the design that ignores p1 alone is s times the filter."""
    plant = rs.library.gertler()
    both = rs.design.detection_filter(plant, poles=[0.25, 0.3])
    one = eigenstructure_assignment(plant, insensitive_to="p1", poles={"p1": [0.25], "rest": [0.3, 0.6]})
    S = one.observer.W
    np.testing.assert_allclose(S @ both.system.evaluate(Z), one.system.evaluate(Z), atol=1e-9)
