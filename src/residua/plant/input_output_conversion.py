"""Input-output models from plants: one equation per output, of the smallest order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.errors import AccuracyError
from residua.linear.polynomials.pencil_null_space import PENCIL_RTOL, pencil, refined, shortest_pencil_null_vectors
from residua.linear.polynomials.polynomial_basis import PolynomialBasis, basis_on_poles
from residua.linear.polynomials.polynomial_matrix import PolynomialMatrix
from residua.linear.subspaces.rank import DEFAULT_RTOL as RANK_RTOL
from residua.linear.systems.balancing import descriptor_units
from residua.plant.algebraic_equations import without_algebraic_equations
from residua.plant.comparable_units import in_unit_of_rates
from residua.plant.input_output_model import InputOutputModel
from residua.plant.observer_form import check_proper, check_response, response_error, response_points, state_terms
from residua.plant.plant import Plant
from residua.tolerances import RESIDUE
from residua.words import rates_in

_ROLES = ("control", "disturbance", "fault")
#: How many times better than another a row must fit the response to be the better one. Where poles crowd together,
#: powers hold few digits of the response: all rows fit it to what that leaves, and luck makes a factor of two.
_CLEARLY = 5.0
_LOWER_ORDER = (
    "coefficients of such a degree do not hold this plant to working precision; use the state-space plant itself, "
    "sample it more slowly, or split it into parts of lower order"
)


def input_output_from_plant(
    plant: Plant, *, common_denominator: bool = False, rtol: float = PENCIL_RTOL, tolerance: float = 1e-6
) -> InputOutputModel:
    r"""Return one equation per output of a plant, each of the smallest order.

    For output ``i`` the polynomial row :math:`(w, h)` of the smallest degree with

    .. math:: w(z)\,(zE - A) + h(z)\, c_i = 0

    gives :math:`h\, y_i = -w B v + h D_i v` for all inputs ``v``. Its degree is the order of what this output sees of
    the state; modes that it does not see are not in the equation. Modes that it sees and no input reaches stay, as
    common factors of both sides, so that the equation also holds while they die out. All equations together may have
    more modes than the plant, which they share; :func:`realize_input_output` takes the copies out.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not. Its noise is left out: these equations have none.
    common_denominator : bool
        Whether every equation has :math:`h = \det(zI - A)` instead,
        :math:`G = C\,\mathrm{adj}(zI - A) B + D \det(zI - A)`.
    rtol : float
        For the rank decisions that find the degrees, in balanced units; other decisions use 1e-10 when it is smaller.
    tolerance : float
        Largest error of the frequency response, of each entry relative to itself or to a thousandth of its peak.

    Returns
    -------
    InputOutputModel
        ``H`` diagonal and monic. All inputs are commanded; faults and disturbances keep their names.

    Raises
    ------
    ModelError
        If an output is no proper function of the inputs, as with a plant of index 2.
    AccuracyError
        If the frequency response is missed by more than the tolerance.

    Notes
    -----
    The rows are found in polynomials that vanish at the poles, the slow ones first, and written in powers after that:
    the degrees are right also where powers of the variable hardly tell modes apart.

    Coefficients of powers lose digits with the order, and with poles that are close together or far apart. Largest
    error of the frequency response of random plants: 4e-12 over 209 of orders 2 to 12, 9e-13 over 30 of orders 18 to
    30. Of plants that are sampled far faster than they move less is left: with poles within 0.1 of 1, order 4: 4e-11,
    order 6: 4e-8, order 8: half of them refused; within 0.01, order 4: 5e-7, order 6: refused. Of continuous plants
    with three fast modes, a thousand times faster than three slow ones: 1e-10, four and four: 1e-9 (1 of 30 refused),
    five and five: most refused. The state-space plant loses nothing there.

    References
    ----------
    Gertler (1991), eqs. (2-3) to (2-6); the first term of (2-6) for ``G`` lacks a factor in the second one,
    :math:`\det(I - z^{-1} A)`.

    Examples
    --------
    >>> import residua as rs
    >>> print(input_output_from_plant(rs.library.gertler()))
    (z^2 - 0.9 z + 0.2) y1 = (1.5 z - 0.65) u1 + (2 z - 0.9) p1 + (z - 0.4) p2
    (z^2 - 1.4 z + 0.45) y2 = (1.1 z - 0.95) u1 + (z - 0.9) p1 + (2 z - 1.4) p2
    """
    own, unit = in_unit_of_rates(plant)
    with rates_in(unit):
        model = _equations(own, common_denominator, rtol, tolerance)
    return model if own is plant else model._in_other_time(unit)


def _equations(plant: Plant, common_denominator: bool, rtol: float, tolerance: float) -> InputOutputModel:
    """Return the equations of a plant in the unit of time that it is written in."""
    others = max(rtol, RANK_RTOL)  # decisions on what has been computed before
    small = without_algebraic_equations(plant, rtol=others).explicit() if common_denominator else plant
    poles = small.system(()).poles()
    scaled = _scaled(small, poles)
    if common_denominator:
        rows = _common_rows(scaled)
    else:
        rows = [_smallest_row(scaled, i, rtol) for i in range(plant.n_outputs)]
    H, N = as_matrices(rows, scaled.unit, plant.n_outputs, scaled.B.shape[1])
    u, d = len(plant.inputs), len(plant.disturbances)
    model = InputOutputModel(
        H,
        N.select(columns=slice(0, u)),
        dt=plant.dt,
        inputs=plant.inputs,
        outputs=plant.outputs,
        name=plant.name,
        operating_point=plant.operating_point,
        units={key: unit for key, unit in plant.units.items() if key in (*plant.inputs, *plant.outputs)},
        description=plant.description,
        rtol=others,
    )._with(
        Gd=N.select(columns=slice(u, u + d)),
        Gf=N.select(columns=slice(u + d, None)),
        disturbances=plant.disturbances,
        fault_list=plant.fault_list,
    )
    check_proper(H, N, plant.outputs, plant.dt, others)
    points = response_points(poles, plant.dt)
    system = plant.system(_ROLES)
    order = max(H.row_degrees)
    error = response_error(model.transfer(points), system.evaluate(points), state_terms(system, points))
    check_response(error, tolerance, f"the equations of order {order}", _LOWER_ORDER)
    return model


@dataclass(frozen=True, eq=False)
class _Scaled:
    """A plant in balanced units, for ``z / unit`` in place of ``z``; all inputs together; its response at points."""

    A: NDArray[np.float64]
    E: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    unit: float
    explicit: bool
    basis: PolynomialBasis
    points: NDArray[np.complex128]
    response: NDArray[np.complex128]

    def missed(self, i: int, h: NDArray[np.float64], g: NDArray[np.float64]) -> float:
        """Return how far the equation of an output is from its response."""
        z = self.points[:, None] ** np.arange(len(h))
        wanted = self.response[:, i]
        with np.errstate(divide="ignore", invalid="ignore"):
            off = np.abs((z @ g) / (z @ h)[:, None] - wanted)
        scale = np.maximum(np.abs(wanted), 1e-3 * np.abs(wanted).max(axis=0))
        worst = float(np.max(off / np.where(scale > 0, scale, np.inf), initial=0.0))
        return worst if np.isfinite(worst) else np.inf


def _scaled(plant: Plant, poles: NDArray[np.complex128]) -> _Scaled:
    s = plant.system(_ROLES)
    points = response_points(poles, plant.dt)
    units = descriptor_units(s.A, s.E, s.B, s.C, s.D)
    rows, states = units.equations[:, None], units.states
    A = rows * s.A * states
    size = np.abs(poles)
    size = size[size > np.sqrt(np.finfo(float).eps) * max(size.max(initial=0.0), np.finfo(float).tiny)]
    # The geometric mean of the poles makes the first and the last coefficient of their polynomial the same.
    unit = float(np.exp2(np.round(np.mean(np.log2(size))))) if size.size else 1.0
    E = np.eye(len(A)) if s.E is None else rows * s.E * states
    return _Scaled(
        A / unit,
        E,
        rows * s.B / unit,
        s.C * states,
        s.D,
        unit,
        s.E is None,
        basis_on_poles(poles / unit, len(A) + 1, 1.0, outward=True),
        points / unit,
        s.evaluate(points),
    )


def _smallest_row(p: _Scaled, i: int, rtol: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``h`` and ``g`` of the equation of one output, lowest power first."""
    n, c = len(p.A), p.C[i]
    size = float(np.linalg.norm(c))
    if not size:
        return np.ones(1), p.D[i][None]
    P0, P1 = np.vstack([-p.A, c / size]), np.vstack([p.E, np.zeros((1, n))])
    found = shortest_pencil_null_vectors(pencil(P0, P1, p.basis), most=n, rtol=rtol)
    if found is None or len(found.vectors) != 1:
        count = 0 if found is None else len(found.vectors)
        raise AccuracyError(
            f"output {i + 1}: found {count} equations of the smallest order where there is one: a rank decision with "
            f"rtol={rtol:.3g} was not clear; choose another rtol, or rescale the plant"
        )
    powers = PolynomialBasis.powers(n + 1)
    plain = p.basis.changed_to(powers, found.vectors[0])
    # Made exact in powers as well: of use where modes are far apart, of harm where they are so close together that
    # powers hardly tell one polynomial from another.
    exact = refined(pencil(P0, P1, powers), plain, rtol=rtol)
    first, second = (_equation(p, i, x, size) for x in (plain, exact))
    return second if p.missed(i, *second) * _CLEARLY < p.missed(i, *first) else first


def _equation(
    p: _Scaled, i: int, x: NDArray[np.float64], size: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ``h`` and ``g`` from a row that annihilates the states."""
    n, direct = len(p.A), p.D[i]
    w, h = -size * x[:, :n], x[:, n]
    if p.explicit:
        w = np.vstack([w[:-1], np.zeros((1, n))])  # its highest power meets nothing but E, which is invertible
    h = np.where(np.abs(h) > RESIDUE * np.abs(h).max(), h, 0.0)
    g = w @ p.B + np.outer(h, direct)
    terms = np.abs(w).max() * np.abs(p.B).sum(axis=0) + np.abs(h).max() * np.abs(direct)
    return h, np.where(np.abs(g) > RESIDUE * terms, g, 0.0)


def _common_rows(p: _Scaled) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return the determinant with the numerators of every output, from the first Markov parameters."""
    n = len(p.A)
    h = np.asarray(np.real(np.poly(np.linalg.eigvals(p.A))), dtype=float) if n else np.ones(1)
    markov, X = [p.D], p.B
    for _ in range(n):
        markov.append(p.C @ X)
        X = p.A @ X
    G = np.zeros((n + 1, *p.D.shape))
    for k in range(n + 1):
        parts = [h[j] * markov[k - j] for j in range(k + 1)]
        total, terms = np.sum(parts, axis=0), np.sum(np.abs(parts), axis=0)
        G[n - k] = np.where(np.abs(total) > RESIDUE * terms, total, 0.0)
    return [(h[::-1], G[:, i]) for i in range(len(p.D))]


def as_matrices(
    rows: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]], unit: float, m: int, inputs: int
) -> tuple[PolynomialMatrix, PolynomialMatrix]:
    """Return a diagonal, monic ``H`` and ``N`` in the unscaled variable."""
    length = max(len(h) for h, _ in rows)
    H, N = np.zeros((length, m, m)), np.zeros((length, m, inputs))
    for i, (h, g) in enumerate(rows):
        top = int(np.flatnonzero(h)[-1])
        powers = unit ** (top - np.arange(len(h), dtype=float)) / h[top]
        H[: len(h), i, i] = h * powers
        N[: len(h), i] = g * powers[:, None]
    return PolynomialMatrix(H), PolynomialMatrix(N)
