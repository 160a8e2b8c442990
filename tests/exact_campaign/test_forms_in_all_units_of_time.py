"""Other forms of continuous plants and filters, whose rates are written in other units, from 2^-20 to 2^20."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import residua as rs
from exact_campaign.cases import plant_of
from exact_campaign.kinds import KINDS, case_of
from exact_campaign.test_answers_in_all_units_of_time import answered
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.plant import InputOutputModel, Plant
from residua.plant.comparable_units import unit_of_rates_of, with_rates_times

#: What an equivalence may be called.
KINDS_OF_EQUIVALENCE: tuple[str, ...] = (
    *("identical", "scale", "poles", "filter", "transformation", "part", "whole", "different"),
)
Form = Callable[[Plant, float], list[NDArray]]


def _general(plant: Plant, t: float) -> list[NDArray]:
    g = rs.design.general_form(rs.design.decoupled_residual(plant))
    missed = np.array(list(g.conditions.values()))
    return [g.T, g.M / t, g.J / t, g.N / t, g.Ls, g.Lu, g.Ly, t * g.V, g.first_response / t, missed]


def _relations(made: rs.design.ResidualGenerator, t: float) -> list[NDArray]:
    rows = made.to_parity().rows
    newest = [row.q[-1] / np.prod(row.basis.sizes[: row.order]) for row in rows]
    return [*newest, *(row.divided / t for row in rows), *(row.basis.sizes / t for row in rows)]


def _polynomials(made: rs.design.ResidualGenerator, t: float) -> list[NDArray]:
    relations = made.to_parity()

    def in_time(P: PolynomialMatrix, lower: int = 0) -> NDArray:
        powers = np.arange(P.degree + 1.0)[:, None] - np.array(relations.orders) + lower
        return P.coefficients * t ** powers[:, :, None]

    rows = relations.output_rows, relations.input_rows, relations.fault_rows, relations.disturbance_rows
    return [in_time(relations.state_rows, 1), *map(in_time, rows)]


def _other_poles(plant: Plant, t: float) -> list[NDArray]:
    made = rs.design.decoupled_residual(plant)
    s = made.with_poles([-t] * max(made.to_parity().orders)).system
    return [s.A / t, s.B / t, s.C, s.D]


def _equivalent(plant: Plant, t: float) -> list[NDArray]:
    first, second = rs.design.decoupled_residual(plant), rs.design.detection_filter(plant)
    found = [first.equivalent_to(second), first.equivalent_to(first.with_poles([-t] * first.system.n_states))]
    out = []
    for one in found:
        said = [KINDS_OF_EQUIVALENCE.index(one.kind), one.error]
        out += [np.array(said), one.transformation(t * np.array([0.3, 2.0]))]
        for row in one.rows:
            gain = row.gain * t ** (len(row.zeros) - len(row.poles))
            out += [row.zeros / t, row.poles / t, np.array([gain, row.error])]
        out += [] if one.matrix is None else [one.matrix]
        made = one.realization() if one.kind not in ("whole", "different") else first.system
        out += [made.A / t, made.B / t, made.C, made.D]
    return out


def _in_time(P: PolynomialMatrix, model: InputOutputModel, t: float) -> NDArray:
    powers = np.arange(P.degree + 1.0)[:, None] - np.array(model.H.row_degrees)
    return P.coefficients * t ** powers[:, :, None]


def _equations(plant: Plant, t: float, *, common: bool = False) -> list[NDArray]:
    model = InputOutputModel.from_plant(plant, common_denominator=common)
    return [_in_time(P, model, t) for P in (model.H, model.G, model.Gd, model.Gf)]


def _realized(plant: Plant, t: float) -> list[NDArray]:
    found = InputOutputModel.from_plant(plant).realization()
    p = found.plant
    rates = [M / t for M in (p.A, p.B, p.Bd, p.Bf, found.removed_modes)]
    return [*rates, p.C, p.D, p.Dd, p.Df, np.array([found.error])]


#: By name; each takes a plant and the unit of its rates, and returns numbers without rates.
FORMS: Mapping[str, Form] = {
    "general form": _general,
    "relations of a residual": lambda p, t: _relations(rs.design.decoupled_residual(p), t),
    "relations of a filter": lambda p, t: _relations(rs.design.detection_filter(p), t),
    "polynomials of relations": lambda p, t: _polynomials(rs.design.parity_relations(p), t),
    "polynomials of primary residuals": lambda p, t: _polynomials(rs.design.primary_residuals(p), t),
    "polynomials of a filter": lambda p, t: _polynomials(rs.design.detection_filter(p), t),
    "other poles": _other_poles,
    "equivalence": _equivalent,
    "equations": _equations,
    "equations of one denominator": lambda p, t: _equations(p, t, common=True),
    "realization": _realized,
}


def _bits(found: Any) -> Any:
    """Return text as it is, and arrays by their shapes and bits; a zero has no sign."""
    return found if isinstance(found, str) else [(M.shape, (M + 0.0).tobytes()) for M in found]


def differences(kind: str, seed: int, times: tuple[float, ...]) -> list[str]:
    """Return what is not to the last bit as in the unit of time that a plant was made in."""
    base, out = plant_of(case_of(kind, seed)), []
    for name, form in FORMS.items():
        wanted = _bits(answered(partial(form, base, 1.0)))
        for t in times:
            if _bits(answered(partial(form, with_rates_times(base, t), t))) != wanted:
                out.append(f"{name} x {t:g}")
    return out


def with_rates(seed: int) -> list[tuple[str, int]]:
    """Return a continuous plant with a rate of each kind, from some seed on."""
    found = []
    for kind in KINDS:
        cases = (case_of(kind, k) for k in range(seed, seed + 10))
        one = next((case for case in cases if not case.dt and unit_of_rates_of(plant_of(case))), None)
        found += [] if one is None else [(kind, one.seed)]
    return found


@pytest.mark.parametrize(("kind", "seed"), with_rates(802))
def test_forms_do_not_depend_on_the_unit_of_time(kind: str, seed: int) -> None:
    assert differences(kind, seed, (2.0**-20, 8.0, 2.0**20)) == []


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(820, 840))
def test_forms_do_not_depend_on_any_unit_of_time(seed: int) -> None:
    for kind, one in with_rates(seed):
        assert differences(kind, one, (2.0**-20, 2.0**-7, 2.0**20)) == [], kind
