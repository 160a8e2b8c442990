"""Every guard of the linear algebra notices a wrong intermediate result, and does not hand it on."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from guards import changed, trips
from residua.errors import AccuracyError
from residua.linear import (
    StateSpace,
    descriptor_observability,
    filter_riccati,
    h2_norm,
    hinf_norm,
    observability_form,
    peak_norm,
    place_observer_margin,
    place_observer_poles,
    weierstrass_form,
)
from residua.linear.norms.impulse_terms import StableSystem, _by_triangle
from residua.linear.poles.spectrum import match_poles

#: By how much wrong results are off: small enough to look right, and far above every tolerance of the evidence.
OFF = 1e-3
#: Two states and two outputs, with nothing special about them.
A, B, C = np.array([[0.5, 0.3], [-0.2, 0.6]]), np.eye(2), np.array([[1.0, 0.2], [0.1, 1.0]])


def off(M: Any) -> Any:
    """A matrix with its largest entry off by a thousandth."""
    out = np.array(M)
    out.flat[int(np.argmax(np.abs(out)))] *= 1 + OFF
    return out


@trips("linear.norms.system_norms:h2_norm")
@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_a_gramian_that_misses_its_equation_is_refused(dt: float, monkeypatch: pytest.MonkeyPatch) -> None:
    M = A if dt else A - np.eye(2)
    h2_norm(M, B, C, dt=dt)
    changed(monkeypatch, "linear.norms.system_norms:scipy.linalg.solve_continuous_lyapunov", off)
    changed(monkeypatch, "linear.norms.system_norms:doubled_sum", off)
    with pytest.raises(AccuracyError, match="Lyapunov equation"):
        h2_norm(M, B, C, dt=dt)


@trips("linear.norms.system_norms:hinf_norm")
def test_a_peak_that_does_not_settle_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = itertools.count()
    changed(monkeypatch, "linear.norms.system_norms:_System.gain", lambda gain: gain * 1.5 ** next(turn))
    changed(monkeypatch, "linear.norms.system_norms:_System.crossings", lambda points: np.array([0.1, 0.2]))
    with pytest.raises(AccuracyError, match="did not settle"):
        hinf_norm(A, B, C, dt=1.0)


@trips("linear.norms.peak_norm:_by_directions")
def test_a_peak_norm_that_is_not_found_to_its_tolerance_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    peak_norm(StateSpace(A, B, C, dt=1.0), rtol=1e-4)
    changed(monkeypatch, "linear.norms.peak_norm:largest_sum", lambda found: replace(found, upper=1.1 * found.upper))
    with pytest.raises(AccuracyError, match="lies between"):
        peak_norm(StateSpace(A, B, C, dt=1.0), rtol=1e-4)


@trips("linear.norms.star_norm:star_ellipsoid")
def test_a_star_norm_without_a_solution_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    changed(monkeypatch, "linear.norms.star_norm:ellipsoid_shape", lambda Q: None)
    with pytest.raises(AccuracyError, match="star norm was not solved"):
        peak_norm(StateSpace(A, B, C, dt=1.0), kind="star")


@trips("linear.norms.peak_norm_lmi:lmi_peak")
def test_inequalities_without_a_solution_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("clarabel")
    system = StateSpace(A, B, C, dt=1.0)
    peak_norm(system, kind="star")
    monkeypatch.setattr("residua.linear.norms.peak_norm_lmi._solve", lambda *matrices: None)
    with pytest.raises(AccuracyError, match="no matrix inequality"):
        peak_norm(system, kind="lmi")


@trips("linear.norms.impulse_terms:_by_triangle")
def test_a_tail_without_a_bound_is_refused() -> None:
    def system(coupling: float) -> StableSystem:
        M = np.array([[0.9, coupling], [0.0, 0.9]])
        return StableSystem(M, B, C, np.zeros((2, 2)), np.ones(2), 0.9)

    assert _by_triangle(system(1.0))(np.eye(2)) >= 10  # 0.9^k sums to 10
    with pytest.raises(AccuracyError, match="contracts"):
        _by_triangle(system(1e18))


@trips("linear.poles.riccati:filter_riccati:2")
@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_a_riccati_equation_that_is_missed_is_refused(dt: float, monkeypatch: pytest.MonkeyPatch) -> None:
    assert filter_riccati(A, C, np.eye(2), np.eye(2), dt=dt).residual < 1e-12
    changed(monkeypatch, "linear.poles.riccati:filter_covariance", off)
    monkeypatch.setattr("residua.linear.poles.riccati.range", lambda most: [], raising=False)  # no Newton step
    with pytest.raises(AccuracyError, match="Riccati equation was not solved"):
        filter_riccati(A, C, np.eye(2), np.eye(2), dt=dt)


@trips("linear.poles.riccati:filter_riccati:2")
def test_a_riccati_solution_that_does_not_stabilise_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    changed(monkeypatch, "linear.poles.riccati:_gain", lambda found: (0.0 * found[0], *found[1:]))
    with pytest.raises(AccuracyError, match="Riccati equation was not solved"):
        filter_riccati(np.diag([1.5, 0.2]), C, np.eye(2), np.eye(2), dt=1.0)


@trips("linear.poles.riccati:filter_riccati:1")
def test_a_riccati_equation_that_no_way_solves_is_no_question_of_existence() -> None:
    """An oscillator that is hardly disturbed and hardly seen."""
    swing = [[0.0, 1.0], [-1.0, 0.0]]
    assert filter_riccati(swing, [[1.0, 0.0]], np.eye(2), [[1.0]]).residual < 1e-12
    with pytest.raises(AccuracyError, match="could not be solved"):
        filter_riccati(swing, [[1e-11, 0.0]], 1e-22 * np.eye(2), [[1.0]])


@trips("linear.poles.pole_assignment:assigned_gain")
def test_poles_that_are_not_reached_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    place_observer_poles(A, C, [0.1, 0.2], dt=1.0)
    changed(monkeypatch, "linear.poles.pole_assignment:spectrum_error", lambda found: (OFF, found[1], False))
    with pytest.raises(AccuracyError, match="cannot be placed"):
        place_observer_poles(A, C, [0.1, 0.2], dt=1.0)


@trips("linear.poles.placement:_placement")
def test_a_margin_that_is_not_reached_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    place_observer_margin(A, C, 1.0)
    changed(monkeypatch, "linear.poles.placement:observer_gain", lambda gain: replace(gain, note="less"))
    with pytest.raises(AccuracyError, match="no gain found"):
        place_observer_margin(A, C, 1.0)


@trips("linear.subspaces.observability:observability_form")
def test_a_form_that_is_no_similarity_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = np.diag([0.5, 0.2])
    observability_form(hidden, [[1.0, 0.0]])
    turned = np.array([[1.0, OFF], [-OFF, 1.0]])
    changed(
        monkeypatch,
        "linear.subspaces.observability:observable_split",
        lambda split: replace(split, seen=turned @ split.seen, hidden=turned @ split.hidden),
    )
    with pytest.raises(AccuracyError, match="drops"):
        observability_form(hidden, [[1.0, 0.0]])


# ------------------------------------------------------------------ descriptor systems

PENCIL = [[1.0, 2.0], [3.0, 4.0]], [[1.0, 0.0], [0.0, 0.0]]


@trips("linear.systems.descriptor:weierstrass_form:1")
@pytest.mark.parametrize("finite", [0, 2])
def test_parts_that_do_not_add_up_are_refused(finite: int, monkeypatch: pytest.MonkeyPatch) -> None:
    weierstrass_form(*PENCIL)
    changed(monkeypatch, "linear.systems.descriptor:_finite_part", lambda V: np.eye(2)[:, :finite])
    with pytest.raises(AccuracyError, match=f"finite part has {finite} and the infinite part 1 of 2"):
        weierstrass_form(*PENCIL)


@trips("linear.systems.descriptor:_assembled:1")
def test_parts_that_are_not_apart_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    weierstrass_form(*PENCIL)
    kept: list[Any] = []
    changed(monkeypatch, "linear.systems.descriptor:_infinite_part", lambda found: kept.append(found[0]) or found)
    changed(monkeypatch, "linear.systems.descriptor:_finite_part", lambda V: kept[0])
    with pytest.raises(AccuracyError, match="not apart"):
        weierstrass_form(*PENCIL)


@trips("linear.systems.descriptor:_assembled:2")
def test_a_form_that_misses_its_equations_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def tilted(V: Any) -> Any:
        return V + OFF * V[::-1]

    weierstrass_form(*PENCIL)
    changed(monkeypatch, "linear.systems.descriptor:_finite_part", tilted)
    with pytest.raises(AccuracyError, match="misses its equations"):
        weierstrass_form(*PENCIL)


@trips("linear.systems.descriptor_properties:_property")
def test_a_hidden_mode_that_is_no_pole_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = np.diag([-1.0, -2.0]), [[1.0, 0.0]], np.eye(2)
    assert not descriptor_observability(*hidden)
    changed(
        monkeypatch,
        "linear.systems.descriptor_properties:invariant_zeros",
        lambda found: replace(found, zeros=found.zeros + 0.1),
    )
    with pytest.raises(AccuracyError, match="are not among the poles"):
        descriptor_observability(*hidden)


@trips("linear.poles.spectrum:match_poles")
@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, complex(0, np.inf), complex(np.nan, 1)])
def test_a_pole_that_is_not_finite_is_matched_with_none(odd: complex) -> None:
    fine, broken = np.array([-1, -2 + 1j, -2 - 1j]), np.array([-1, odd, -3])
    assert sorted(match_poles(fine, fine[::-1])) == [0, 1, 2]
    for wanted, achieved in ((fine, broken), (broken, fine), (broken, broken)):
        with pytest.raises(AccuracyError, match="1 of 3 poles is no finite number"):
            match_poles(wanted, achieved)
