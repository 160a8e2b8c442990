"""One parity relation: polynomials in a basis that keeps their digits."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from residua.design.core.generator import ResidualGenerator
from residua.design.core.internal_form import frequency_grid, leak_frequencies
from residua.design.core.own_time import has_rates, written_by
from residua.design.observers.even_units import own_rate
from residua.design.parity.relation_model import state_pencil
from residua.errors import ModelError
from residua.linear.polynomials.pencil_null_space import Pencil, pencil, refined
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.rank import left_null_basis
from residua.linear.systems.array_cache import entries
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits
from residua.tolerances import DESIGN_ROUNDING, RESIDUE, RESPONSE_ROUNDING, TINY

#: Terms below this fraction of the largest, in balanced units, may be nothing but rounding.
_TAKES_PART = 1e-6


def _in_other_time(row: Relation, factor: float) -> Relation:
    """Return a relation of which rates are ``factor`` as large: the newest sample keeps its coefficient."""
    p, q = factor ** (row.order - 1.0) * row.p, factor**row.order * row.q
    height = np.where(np.arange(len(row.ignored)) < row.p.shape[1], factor, 1.0)
    return replace(row, p=p, q=q, ignored=height[:, None] * row.ignored)


has_rates(real=1, imaginary=1, sizes=1)(PolynomialBasis)


@has_rates(divided=1)
@written_by(_in_other_time)
@dataclass(frozen=True, eq=False)
class Relation:
    r"""One relation: polynomials ``p``, ``q`` with :math:`p (zE - A) = q C`, as coefficients in a basis.

    Attributes
    ----------
    p, q : ndarray, shape (order + 1, states) and (order + 1, outputs)
    basis : PolynomialBasis
    ignored : ndarray, shape (states + outputs, columns)
        Constant columns that ``[p, q]`` annihilates besides.
    divided : ndarray
        Roots of the common factor that was divided out.
    """

    p: NDArray[np.float64]
    q: NDArray[np.float64]
    basis: PolynomialBasis
    ignored: NDArray[np.float64]
    divided: NDArray[np.complex128]

    @property
    def order(self) -> int:
        """The degree."""
        return len(self.q) - 1

    def times(self, factor: float) -> Relation:
        """Return a multiple."""
        return replace(self, p=factor * self.p, q=factor * self.q)

    def in_units_of_the_plant(self, units: PlantUnits) -> Relation:
        """Return a relation for the scaled plant as one for the plant."""
        height = np.concatenate([units.equations, units.outputs])[:, None]
        return replace(self, p=self.p * units.equations, q=self.q * units.outputs, ignored=self.ignored / height)

    @property
    def used(self) -> NDArray[np.bool_]:
        """The equations of the plant that take part, shape (states + outputs,)."""
        return np.asarray(np.hstack([self.p, self.q]).any(axis=0))


def changed(rows: Sequence[Relation], bases: Sequence[PolynomialBasis], plant: Plant) -> list[Relation]:
    """Return the same relations in other bases, made exact there: those of the same equations together."""
    alike: dict[Hashable, list[int]] = {}
    for i, (row, basis) in enumerate(zip(rows, bases, strict=True)):
        key = row.order, entries(row.ignored, basis.real, basis.imaginary, basis.sizes), row.used.tobytes()
        alike.setdefault(key, []).append(i)
    out = list(rows)
    n = plant.n_states
    for chosen in alike.values():
        row, basis = rows[chosen[0]], bases[chosen[0]]
        X = np.stack([rows[i].basis.changed_to(basis, np.hstack([rows[i].p, rows[i].q])) for i in chosen])
        equations = state_pencil(plant, row.ignored, basis, canonical=True)
        for i, x in zip(chosen, _exact(equations, X, row.used), strict=True):
            x[-1, :n] = _algebraic(x, plant)
            out[i] = replace(rows[i], p=x[:, :n], q=x[:, n:], basis=basis)
    return out


def states_missed(rows: Sequence[Relation], plant: Plant) -> float:
    """Return how far the states are from dropping out at most, relative to the terms that have to cancel."""
    none = np.zeros((plant.n_states + plant.n_outputs, 0))
    equations: dict[int, Pencil] = {}
    for row in rows:
        if id(row.basis) not in equations:
            equations[id(row.basis)] = state_pencil(plant, none, row.basis, canonical=True)
    left = [_left(equations[id(row.basis)], np.hstack([row.p, row.q])) for row in rows]
    return float(np.max(left, initial=0.0))


def _exact(equations: Pencil, X: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the null vectors of the equations nearest to some, which read nothing by what rounding leaves of nothing.

    Of equations that hardly take part it is tried whether the others will do.
    """

    def nearest(X: NDArray[np.float64], used: NDArray[np.bool_]) -> NDArray[np.float64]:
        out = np.zeros_like(X)
        part = pencil(equations.P0[used], equations.P1[used], equations.basis, canonical=True)
        out[..., used] = refined(part, X[..., used])
        return out

    out = nearest(X, used)
    for i, (x, found) in enumerate(zip(X, out, strict=True)):
        height = np.abs(found).max(axis=0, initial=0.0)
        fewer = used & (height > DESIGN_ROUNDING * height.max(initial=0.0))
        if np.array_equal(fewer, used):
            continue
        simpler = nearest(x, fewer)
        near = np.abs(simpler - found).max(initial=0.0) <= 10 * DESIGN_ROUNDING * height.max(initial=0.0)
        holds = _left(equations, simpler) <= max(2 * _left(equations, found), RESIDUE)
        if near and holds:
            out[i] = simpler
    return out


def _left(equations: Pencil, x: NDArray[np.float64]) -> float:
    """Return how far a null vector misses its equations, relative to the terms that have to cancel in each."""
    left = np.abs(equations.products(x)).max(axis=0, initial=0.0) * equations.columns
    sizes = replace(equations, P0=np.abs(equations.P0), P1=np.abs(equations.P1)).products(np.abs(x))
    terms = np.abs(sizes).max(axis=0, initial=0.0) * equations.columns
    # an equation of which the terms are rounding of those of others does not take part
    terms = np.maximum(terms, _TAKES_PART * terms.max(initial=0.0))
    return float(np.max(left / np.where(terms > 0, terms, 1.0), initial=0.0))


def _algebraic(x: NDArray[np.float64], plant: Plant) -> NDArray[np.float64]:
    """Return the highest coefficient of ``p`` without rounding: ``p (zE - A) = q C`` leaves it the kernel of ``E``."""
    n = plant.n_states
    if plant.E is None:
        return np.zeros(n)
    N = left_null_basis(plant.E)[0]
    highest = N @ (N.T @ x[-1, :n])
    return highest if np.abs(highest).max(initial=0.0) > RESPONSE_ROUNDING * np.abs(x).max() else np.zeros(n)


def synthetic_division(plant: Plant, q: NDArray[np.float64], basis: PolynomialBasis) -> NDArray[np.float64]:
    """Return ``p`` with ``p (z I - A) = q C`` for a plant without ``E``, as far as the division comes out."""
    return divided(plant.A, plant.C, q, basis)[0]


def divided(
    A: NDArray[np.float64], C: NDArray[np.float64], q: NDArray[np.float64], basis: PolynomialBasis
) -> tuple[NDArray[np.float64], float]:
    r"""Return ``p`` with :math:`p (z I - A) = q C` and the remainder, relative to the terms that have to cancel.

    From the highest element on: :math:`\rho_{j-1} p_{j-1} = q_j C + p_j (A - a_j I) + \beta_{j+1} p_{j+1}`.
    """
    k, links = len(q) - 1, basis.links
    p = np.zeros((k + 1, len(A)))
    for j in range(k, -1, -1):
        total = q[j] @ C + p[j] @ A - basis.real[j] * p[j]
        terms = np.abs(q[j]) @ np.abs(C) + np.abs(p[j]) @ np.abs(A) + np.abs(basis.real[j] * p[j])
        if j < k and links[j + 1]:
            total, terms = total + links[j + 1] * p[j + 1], terms + np.abs(links[j + 1] * p[j + 1])
        if j:
            p[j - 1] = total / basis.sizes[j - 1]
    return p, float(np.abs(total).max(initial=0.0) / max(float(terms.max(initial=0.0)), TINY))


def digits_lost(rows: Sequence[Relation], generator: ResidualGenerator) -> float | None:
    """Return how many digits of the data cancel in the residuals of faults that are seen, or ``None`` without faults.

    In a filter on the poles of the rows' bases the terms are :math:`q_j N_j / N_k y`. What is left of them of the
    response to a fault, at frequencies below the rate of the plant (the median), is what rounding in data and
    arithmetic is relative to; of the faults that a residual sees, the one of which least is left counts. A sampled
    plant that integrates answers to ever slower faults by ever more: frequencies begin where those of leaks do.
    """
    plant = generator.plant
    if plant.is_discrete:
        w = leak_frequencies(generator.system, plant, ("fault",))
    else:
        w = frequency_grid(generator.system, plant.system(()))
    w = w[w <= max(plant_rate(plant), w[len(w) // 4])]
    points = np.exp(1j * w * plant.dt) if plant.is_discrete else 1j * w
    output = np.abs(plant.system("fault").frequency_response(w))
    worst = 1.0
    for i, row in enumerate(rows):
        N = row.basis.values(points, row.order)
        response = np.abs(N @ (row.p @ plant.Bf + row.q @ plant.Df))
        terms = np.einsum("wj,jm,wmf->wf", np.abs(N), np.abs(row.q), output)
        seen = generator.structure[i]
        share = np.median(response / np.where(terms > 0, terms, 1.0), axis=0)[seen]
        worst = min(worst, float(share.min(initial=1.0)))
    return float(-np.log10(max(worst, TINY))) if plant.faults else None


def plant_rate(plant: Plant) -> float:
    """Return the rate in 1/s at which a continuous filter has its poles when the user lists none."""
    try:
        return own_rate(plant)
    except ModelError:  # a singular plant may have no poles
        return 1.0
