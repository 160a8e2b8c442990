"""Which residuals answer to which fault, and the directions that each fault moves the residual in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.design.core.internal_form import POINTS, JointResponses, frequency_grid, joint_responses
from residua.linear import StateSpace
from residua.linear.subspaces.parts import part_numbers
from residua.linear.systems.response_terms import EvenUnits, in_even_units, response_terms
from residua.plant import Plant
from residua.tolerances import DESIGN_ROUNDING, LEAKAGE, RANK, RESPONSE_ROUNDING, TINY, above_rounding

#: Of the largest terms of a row and of a column, wherever they stand: they leave rounding, and gains known to it only.
_ELSEWHERE = 1e-2
#: Frequencies at which a response is this far below its largest say nothing about its direction.
_FAINT = 1e-7
#: Faint directions of a response are there when the gap behind them is so much wider than that before them ...
_WIDER = 100.0
#: ... and they carry more than this fraction of it.
_FADED = 1e-9
#: Of the terms of a response: answers that are smaller are no unit of their residual.
_LEAST_ANSWER = 1e-3
#: Rows of a basis that are this far apart at most keep 12 digits beside one another.
_FAR = 2.0**12
#: Products of the distances to the poles of a sampled plant below this are rounding.
_REGULAR = 1e-14


@dataclass(frozen=True, eq=False)
class FaultResponses:
    """The responses of a residual to faults, in even units, with the terms that they are the sum of.

    Attributes
    ----------
    form : StateSpace
        The internal form from the faults, in even units.
    values : ndarray of complex, shape (k, residuals, faults)
        Exactly zero where a fault does not reach a residual.
    terms : ndarray, shape (k, residuals, faults)
        In the internal form.
    sizes : ndarray, shape (k, residuals, faults)
        Of the filter driven by the plant.
    reached : ndarray of bool, shape (residuals, faults)
    residuals : ndarray, shape (residuals,)
        The factors that bring the residuals to even units.
    """

    form: StateSpace
    values: NDArray[np.complex128]
    terms: NDArray[np.float64]
    sizes: NDArray[np.float64]
    reached: NDArray[np.bool_]
    residuals: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a plant that nothing connects with the others, by the numbers of what is in it."""

    equations: NDArray[np.intp]
    outputs: NDArray[np.intp]
    faults: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class FaultColumns:
    """What faults do to an internal form and to its plant, in units of their own, with what it is made of."""

    own: EvenUnits
    p: EvenUnits
    parts: tuple[Part, ...]
    B_terms: NDArray[np.float64]
    D_terms: NDArray[np.float64]

    @classmethod
    def of(
        cls, generator: StateSpace, plant: Plant, form: StateSpace, T: NDArray | None, V: NDArray | None
    ) -> FaultColumns:
        """Return the columns of the faults: the internal form's states and residuals are in the generator's units."""
        n_u, n_f = len(plant.inputs), len(plant.faults)
        # disturbances and controls take part in the units: they connect outputs that no fault connects
        every = in_even_units(plant.system(("fault", "disturbance", "control")))
        p = EvenUnits(every.system.select(inputs=range(n_f)), every.inputs[:n_f], every.outputs, every.equations)
        B, D = form.B[:, :n_f] * p.inputs, form.D[:, :n_f] * p.inputs
        own = in_even_units(form.replaced(B=B, D=D, inputs=form.inputs[:n_f]))
        parts = _parts(every.system, n_f)
        if T is None:
            return cls(own, p, parts, np.zeros((form.n_states, n_f)), np.zeros((form.n_outputs, n_f)))
        Gy, Hy = (np.abs(M[:, n_u:]) / p.outputs for M in (generator.B, generator.D))
        Bf, Df = np.abs(p.system.B), np.abs(p.system.D)
        of_states = [(part.equations, part.faults) for part in parts]
        of_outputs = [(part.outputs, part.faults) for part in parts]
        B = _largest(np.abs(T) / p.equations, Bf, of_states) + _largest(Gy, Df, of_outputs)
        D = _largest(Hy, Df, of_outputs)
        D = D if V is None else D + _largest(np.abs(V) / p.equations, Bf, of_states)
        return cls(own, p, parts, B, D)


@dataclass(frozen=True, eq=False)
class CheckedResponses(JointResponses):
    """Joint responses, with the columns of the faults that they were computed of."""

    columns: FaultColumns


def fault_responses(
    generator: StateSpace,
    plant: Plant,
    form: StateSpace,
    T: NDArray | None,
    V: NDArray | None,
    w: NDArray,
    known: CheckedResponses | None = None,
) -> FaultResponses:
    r"""Return the responses of a residual to the faults of its plant, and which of them there are.

    A fault reaches a residual when the response is more than the rounding of its terms at some frequency. Terms are
    those of the internal form, with the products ``T Bf`` and ``Gy Df`` that it is made of, and those of the filter
    driven by the plant, :math:`\sum_k |Q_{y,ik}| |P_{kj}|`: a residual that is the difference of two measurements
    that a fault moves alike is made of these, whatever its internal form says. Of products such as ``T Bf`` and
    ``Q P`` the largest entries of row and column count as well, wherever in a part of the plant they stand: an entry
    that should be zero is rounding of those. All in units that do not depend on those of the plant.

    Parameters
    ----------
    generator : StateSpace
        From control inputs and outputs of the plant to residuals.
    plant : Plant
    form : StateSpace
        Their internal form, faults first.
    T, V : ndarray or None
        The state and the static map of the generator, if it has them.
    w : ndarray
        Frequencies in rad/s.
    known : CheckedResponses, optional
        The responses at the frequencies of leaks, instead of those at ``w``.

    Returns
    -------
    FaultResponses
    """
    n_u = len(plant.inputs)
    made = FaultColumns.of(generator, plant, form, T, V) if known is None else known.columns
    own, p = made.own, made.p
    scaled = own.system.replaced(B=own.system.B / own.inputs, D=own.system.D / own.inputs)
    if known is not None:
        used = slice(max(len(known.w) - POINTS, 0), None)  # slower ones are those of leaks
        rows = (own.outputs / known.residuals)[:, None]
        values, terms = rows * known.faults.values[used] * p.inputs, rows * known.faults.terms[used] * p.inputs
        outputs = p.outputs / known.outputs
        Q = rows * np.abs(known.filter.values[used, :, n_u:]) / outputs
        P = outputs[:, None] * np.abs(known.of_faults.values[used]) * p.inputs
        seen = np.any(np.abs(known.of_faults.values[used]) > LEAKAGE * known.of_faults.terms[used], axis=(0, 1))
    else:
        points = np.exp(1j * w * form.dt) if form.is_discrete else 1j * w
        B, D = own.equations[:, None] * made.B_terms, own.outputs[:, None] * made.D_terms
        response = response_terms(scaled, points, *((B, D) if T is not None else (None, None)))
        values, terms = response.values, response.terms
        Q = np.abs(generator.frequency_response(w)[:, :, n_u:]) * own.outputs[:, None] / p.outputs
        of_plant = response_terms(p.system, points)
        P = np.abs(of_plant.values)
        seen = np.any(LEAKAGE * of_plant.terms < P, axis=(0, 1))
    driven = _largest(Q, P, [(part.outputs, part.faults) for part in made.parts])
    sizes = np.abs(values)
    reached = np.any(sizes > DESIGN_ROUNDING * (terms + driven), axis=0)
    # An internal form in which large states cancel is made of far more than the filter driven by the plant. A fault
    # that is not lost in that reaches the other residuals, too, where the answer is no leak of what the filter reads.
    # So do faults that outputs surely see, unless the terms leave fewer digits.
    no_leak = (sizes > LEAKAGE * driven) & (sizes <= driven)
    others = np.any(no_leak & (sizes > RESPONSE_ROUNDING * terms), axis=0) & reached.any(axis=0)
    reached |= others | (np.any(no_leak & (sizes > RANK * terms), axis=0) & seen)
    terms = terms + driven if T is None else terms
    return FaultResponses(scaled, np.where(reached, values, 0.0), terms, driven, reached, own.outputs)


def checked_responses(
    generator: StateSpace, plant: Plant, form: StateSpace, T: NDArray, V: NDArray | None
) -> CheckedResponses:
    """Return the responses by which a generator with a state map is checked for leaks and signatures."""
    made = FaultColumns.of(generator, plant, form, T, V)
    of_faults = form.select(inputs=range(len(plant.faults)))
    terms = made.B_terms / made.p.inputs, made.D_terms / made.p.inputs
    return CheckedResponses(**vars(joint_responses(generator, plant, of_faults, *terms)), columns=made)


def _parts(system: StateSpace, n_f: int) -> tuple[Part, ...]:
    """Return the parts of a plant that nothing connects, those with any of the faults, its first inputs."""
    n = system.n_states
    states = (system.A != 0) | ((np.eye(n) if system.E is None else system.E) != 0)
    rows, columns = part_numbers(np.block([[states, system.B != 0], [system.C != 0, system.D != 0]]))
    faults = columns[n : n + n_f]
    return tuple(
        Part(np.flatnonzero(rows[:n] == part), np.flatnonzero(rows[n:] == part), np.flatnonzero(faults == part))
        for part in np.unique(faults)
    )


def _largest(
    rows: NDArray, columns: NDArray, parts: Sequence[tuple[NDArray[np.intp], NDArray[np.intp]]]
) -> NDArray[np.float64]:
    """Return a product of sizes, with a little of the largest of each row times the largest of each column.

    These stand anywhere in the same part: what nothing connects has no unit in common.
    """
    product = rows @ columns
    for inner, outer in parts:
        row, column = rows[..., inner].max(axis=-1, initial=0.0), columns[..., outer].max(axis=-2, initial=0.0)
        product[..., outer] += _ELSEWHERE * row[..., None] * column[..., None, :]
    return product


@dataclass(frozen=True, eq=False)
class Signature:
    """What spans the subspace of the responses of a residual to a fault, in given units of the residuals.

    Attributes
    ----------
    columns : ndarray, shape (residuals, k)
        They span it; a single one points where a positive fault moves the residual first.
    reached : ndarray of bool, shape (residuals,)
        The residuals that the fault reaches.
    """

    columns: NDArray[np.float64]
    reached: NDArray[np.bool_]

    def basis(self, residuals: NDArray[np.float64] | float = 1.0) -> NDArray[np.float64]:
        """Return an orthonormal basis, with the residuals multiplied by factors; a single vector keeps its sign.

        Rows of residuals that the fault does not reach are exactly zero, the others are not.
        """
        if not self.columns.shape[1]:
            return np.zeros(self.columns.shape)
        columns = np.reshape(residuals, (-1, 1)) * self.columns
        if len(columns) == 1:
            return np.sign(columns)
        basis = _orthonormal(columns)
        if basis.shape[1] == 1 and basis[:, 0] @ columns[:, 0] < 0:
            basis = -basis
        return _marked(basis, self.reached)


def _orthonormal(columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an orthonormal basis of what independent columns span, each row right to digits of its own.

    The orthogonal factor of the columns would know every row to the rounding of the largest, and residuals have units
    of their own. Elimination with the largest entries as pivots brings the columns to entries of one and less first;
    solving for the triangular factor of these leaves every row by itself.
    """
    heights = np.abs(columns).max(axis=1)
    if heights.max() <= _FAR * np.min(heights, where=heights > 0, initial=np.inf):
        return np.linalg.qr(columns)[0]
    reduced = columns.copy()
    for j in range(reduced.shape[1]):
        row, other = divmod(int(np.argmax(np.abs(reduced[:, j:]))), reduced.shape[1] - j)
        reduced[:, [j, j + other]] = reduced[:, [j + other, j]]
        reduced[:, j] /= reduced[row, j]
        rest = reduced[row].copy()
        rest[j] = 0.0
        reduced -= np.outer(reduced[:, j], rest)
    order = np.argsort(-np.abs(reduced).max(axis=1), kind="stable")
    R, chosen = scipy.linalg.qr(reduced[order], mode="r", pivoting=True)
    return scipy.linalg.solve_triangular(R[: len(chosen)], reduced[:, chosen].T, trans="T").T


def signatures_of(
    generator: StateSpace,
    plant: Plant,
    form: StateSpace,
    state_map: NDArray | None = None,
    static_map: NDArray | None = None,
    known: CheckedResponses | None = None,
    *,
    rtol: float = 1e-6,
) -> tuple[dict[str, Signature], float]:
    """Return for each fault what spans the subspace that its residual never leaves.

    The subspace is spanned by the response to the fault at all frequencies; it follows from the singular
    values of the responses at many, each scaled to unit length. (Krylov spaces of the same would amplify
    rounding in every step.) What is rounding against the terms that a response is made of is taken for zero. The
    vector of a one-dimensional subspace has the sign of the first response to a positive fault, or of the response to
    a constant one where rounding hides the first.

    Parameters
    ----------
    generator : StateSpace
    plant : Plant
    form : StateSpace
        Their internal form, faults first.
    state_map, static_map : ndarray, optional
        Those of the generator, if it has them.
    known : CheckedResponses, optional
        The responses, where they are known already.
    rtol : float
        Directions that carry less than this fraction of the response at every frequency, each residual in units of
        what this fault moves it by, are not there, but where those that rounding has left are much fainter still.

    Returns
    -------
    signatures : dict of str to Signature
    off : float
        The largest fraction of any response, at any frequency, that was taken for rounding and left out.
    """
    w = _regular(plant, frequency_grid(form, generator)) if known is None else known.w
    responses = fault_responses(generator, plant, form, state_map, static_map, w, known)
    units = residual_units(responses)
    signatures = {}
    for i, name in enumerate(plant.faults):
        own = _own_units(responses, i, units)
        columns = _unit_columns(responses.values[:, :, i].T / own[:, None])
        if columns.shape[1] == 0:
            spanning = np.zeros((form.n_outputs, 0))
        else:
            spanning = (own / responses.residuals)[:, None] * _directions(columns, rtol)
            if spanning.shape[1] == 1 and spanning[:, 0] @ (responses.residuals * first_response(responses, i)) < 0:
                spanning = -spanning
        signatures[name] = Signature(spanning, responses.reached[:, i])
    spans = {name: signature.columns for name, signature in signatures.items()}
    return signatures, max(outside_subspaces(responses, spans, plant.faults).values(), default=0.0)


def _regular(plant: Plant, w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the frequencies at which ``zE - A`` of a sampled plant is regular; near many slow poles it is not."""
    if not plant.is_discrete:
        return w
    away = np.abs(np.exp(1j * w[:, None] * plant.dt) - plant.system(()).poles())
    return w[np.minimum(away, 1.0).prod(axis=1) > _REGULAR]


def _directions(columns: NDArray[np.complex128], rtol: float) -> NDArray[np.float64]:
    """Return the directions that the columns of a response take, as orthonormal columns."""
    if len(columns) == 1:
        return np.ones((1, 1))
    U, s, _ = np.linalg.svd(np.concatenate([columns.real, columns.imag], axis=1), full_matrices=False)
    return U[:, : _dimension(s, rtol)]


def _dimension(s: NDArray[np.float64], rtol: float) -> int:
    """Return how many of the directions with these singular values, the largest first, a response takes.

    Those beyond ``rtol``; and fainter ones where the gap to what is rounding comes only after them. A design misses a
    direction that it aims at by what lies beyond a gap; faint directions before it are in other units of the residuals
    as large as others.
    """
    s = np.maximum(s / s[0], np.finfo(float).eps)
    gaps = s / np.append(s[1:], np.finfo(float).eps)
    kept = int(np.count_nonzero(s > rtol))
    for k in range(kept + 1, int(np.count_nonzero(s > _FADED)) + 1):
        if gaps[k - 1] > _WIDER * gaps[kept - 1]:
            kept = k
    return kept


def residual_units(responses: FaultResponses) -> NDArray[np.float64]:
    """Return the size of each residual: of its answers, where these are more than a little of what they are made of.

    Else of what it is made of, so that residuals that ignore every fault have one as well. Where a plant integrates,
    that grows without end towards low frequencies, and no answer would be a direction beside those of another residual.
    """
    values, sizes = np.abs(responses.values), responses.sizes
    answers = np.where(values > LEAKAGE * sizes, values, 0.0).max(axis=(0, 2), initial=0.0)
    units = np.where(answers > 0, answers, sizes.max(axis=(0, 2), initial=0.0))
    return np.where(units > 0, units, 1.0)


def _own_units(responses: FaultResponses, fault: int, units: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the size of each residual as one fault moves it, or a little of what that response is made of if larger.

    Directions of one fault are told apart by how large *its* answers are: other faults may move a residual millions
    of times further at low frequencies. A design misses what it aims at by so much of the terms, hence the bound.
    """
    own = np.maximum(np.abs(responses.values[:, :, fault]), _LEAST_ANSWER * responses.sizes[:, :, fault]).max(axis=0)
    return np.where(np.any(responses.values[:, :, fault], axis=0), own, units)


def outside_subspaces(
    responses: FaultResponses, spans: dict[str, NDArray[np.float64]], faults: tuple[str, ...]
) -> dict[str, float]:
    """Return for each fault the largest fraction of its response, at any frequency, that lies outside a subspace.

    What spans it need not be orthonormal: a basis in other units of the residuals has lost digits of small rows.
    """
    units = residual_units(responses)
    out = {}
    for i, name in enumerate(faults):
        if len(units) == 1 and spans[name].any():  # the whole of a line: nothing lies outside
            out[name] = 0.0
            continue
        columns = _unit_columns(responses.values[:, :, i].T / units[:, None])
        basis = np.linalg.qr((responses.residuals / units)[:, None] * spans[name])[0]
        rest = columns - basis @ (basis.T @ columns)
        out[name] = float(np.linalg.norm(rest, axis=0).max(initial=0.0))
    return out


def _unit_columns(response: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the columns of a matrix with unit length, without those that are nothing beside the largest."""
    size = np.linalg.norm(response, axis=0)
    keep = (size > 0) & (size > _FAINT * size.max(initial=0.0))
    return response[:, keep] / size[keep]


def _marked(basis: NDArray[np.float64], reached: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return a basis that is zero in the rows that are not reached, and only there."""
    basis = np.where(reached[:, None], basis, 0.0)
    lost = reached & ~np.any(basis, axis=1)  # rounding has left nothing of so small a row
    basis[lost, 0] = np.finfo(float).tiny
    return basis


def first_response(responses: FaultResponses, fault: int) -> NDArray[np.float64]:
    """Return the first Markov parameter ``D, C B, C A B, ...`` of one fault that is no rounding, up to a factor > 0.

    Each entry is judged against its own terms: a mode that is far faster than the others is no measure of what these
    pass on. Where rounding hides all of them it is the response at the lowest frequency.
    """
    form, reached = responses.form, responses.reached[:, fault]
    D = np.where(reached, above_rounding(form.D[:, fault], responses.sizes[-1, :, fault]), 0.0)
    if D.any():
        return D
    A = form.A / max(float(np.linalg.norm(form.A)), TINY)  # only the direction matters: no power overflows
    x = form.B[:, fault]
    size = np.abs(x)
    for _ in range(form.n_states):
        y = np.where(reached, above_rounding(form.C @ x, np.abs(form.C) @ size), 0.0)
        if y.any():
            return y
        x, size = A @ x, np.abs(A) @ size
    slowest = np.flatnonzero(responses.values[:, :, fault].any(axis=1))
    return responses.values[slowest[0], :, fault].real if slowest.size else np.zeros(form.n_outputs)
