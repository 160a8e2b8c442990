"""The direction of a fault points where a positive one moves the residual first, whatever is far faster or cancels."""

from __future__ import annotations

import numpy as np
import pytest

import residua as rs
from residua.design.core.internal_form import internal_form
from residua.design.core.signatures import responses_of_form, signatures_of
from residua.linear import StateSpace


@pytest.mark.parametrize("unit", [2.0**-20, 1.0, 2.0**20])
@pytest.mark.parametrize("size", [-1.0, 1.0])
@pytest.mark.parametrize("fast", [1e2, 1e4, 1e6])
def test_a_far_faster_mode_does_not_turn_a_direction(fast: float, size: float, unit: float) -> None:
    A = np.diag([-1.0, -2, -3, -fast])
    A[1, 0] = A[2, 1] = A[2, 3] = 1
    C = unit * np.array([[0, 0, 1.0, 0], [0, 0, 0, 1]])
    plant = rs.Plant(A, [[0], [0], [0], [1]], C).with_faults({"leak": [size, 0, 0, 0]})
    made = rs.design.luenberger_observer(plant, poles=[-1.5, -2.5, -3.5, -fast]).residual_generator()
    np.testing.assert_allclose(made.directions["leak"].ravel(), [size, 0], atol=1e-6)
    assert np.sign(made.steady_directions["leak"].ravel()[0]) == size


@pytest.mark.parametrize("size", [-1.0, 1.0])
def test_direct_terms_that_cancel_but_for_rounding_turn_no_direction(size: float) -> None:
    plant = rs.Plant([[-1]], [[1]], [[1], [1], [1]]).with_faults({"bias": ([0], [1, 1, 1])})
    direct = [0.0, 0.1, 0.2, -0.3]
    generator = StateSpace([[-1, 0], [-1, -2]], [[1, 0, 0, 0], [0, 1, 0, 0]], [[0, size]], [direct])
    form = internal_form(generator, plant)
    assert 0 < form.D[0, 0] < 1e-16
    assert signatures_of(responses_of_form(form, 1), ("bias",))[0]["bias"] == [[size]]


@pytest.mark.parametrize("size", [-1.0, 1.0])
def test_a_first_response_that_rounding_hides_leaves_the_sign_of_the_lasting_one(size: float) -> None:
    turned = np.linalg.qr(np.random.default_rng(3).standard_normal((4, 4)))[0]
    A = np.diag([-1.0, -2, -3, -1e9])
    A[1, 0] = A[2, 1] = 1
    B, C = size * turned[:, :1], np.array([[0, 0, 1.0, 0]]) @ turned.T
    plant = rs.Plant(turned @ A @ turned.T, np.ones((4, 1)), C).with_faults({"leak": B.ravel()})
    form = StateSpace(plant.A, plant.Bf, plant.C, plant.Df)
    assert signatures_of(responses_of_form(form, 1), ("leak",))[0]["leak"] == [[size]]
