"""Equivalence of two residual generators, and the transformation between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from residua.design.core.evidence import format_pole
from residua.design.core.generator import ResidualGenerator, as_generator, for_monitor
from residua.design.core.internal_form import frequency_grid
from residua.design.parity.conversion import row_fractions
from residua.design.parity.relation import pole_basis, realize_relation
from residua.design.parity.relations import ParityRelations
from residua.errors import AccuracyError, DesignError, ModelError
from residua.linear import StateSpace, decide_rank
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.subspaces.observability import without_unobservable
from residua.plant import Plant
from residua.shown import Shown
from residua.tolerances import TINY

#: Two responses are parallel when they miss each other by less than this, relative, at every frequency.
_PARALLEL = 1e-6
#: Responses smaller than this fraction of the largest over frequency say nothing about direction.
_FAINT = 1e-7
#: Nor do responses to an output smaller than this fraction of those to the others, in balanced units.
_FAINT_OUTPUT = 1e-4
#: Filters made of zeros and poles that miss the responses by more are not reported.
_FILTER_ERROR = 1e-3
#: Zeros and poles nearer than this, relative to their size, cancel.
_CANCEL = 1e-5


@dataclass(frozen=True, eq=False)
class RowTransformation:
    r"""One residual of the second generator as a filtered residual of the first, :math:`r_b = k\, Z(z) / P(z)\, r_a`.

    Attributes
    ----------
    first, second : str
        Names of the residuals.
    gain : float
        ``k``, for monic ``Z`` and ``P``.
    zeros, poles : ndarray
        Roots of ``Z`` and ``P``; what cancels is left out.
    error : float
        How far the two are from parallel at most, or from each other in the median over frequency, relative.
    """

    first: str
    second: str
    gain: float
    zeros: NDArray[np.complex128]
    poles: NDArray[np.complex128]
    error: float

    def evaluate(self, points: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the transfer function at some points."""
        points = np.asarray(points)[:, None]
        return self.gain * np.prod(points - self.zeros, axis=1) / np.prod(points - self.poles, axis=1)

    def __str__(self) -> str:
        text = f"{self.second} = {self.gain:.6g}"
        if len(self.zeros):
            text += f" x zeros at {', '.join(map(format_pole, self.zeros))}"
        if len(self.poles):
            text += f" / poles at {', '.join(map(format_pole, self.poles))}"
        return f"{text} of {self.first}"


@dataclass(frozen=True, eq=False, repr=False)
class Equivalence(Shown):
    """The relation between two generators.

    True in a condition when the generators are equivalent. Prints the transformation, or what keeps them apart.

    Attributes
    ----------
    equivalent : bool
        Whether each is a transformation of the other.
    kind : str
        ``"identical"``, ``"scale"`` (up to factors and order of the residuals), ``"poles"`` (up to poles, factors and
        order), ``"filter"`` (each residual is one of the other's, filtered with zeros of its own),
        ``"transformation"`` (each residual is a sum of filtered ones), ``"part"`` (the second
        is a transformation of the first, not the reverse), ``"whole"`` (the reverse of that) or ``"different"``.
    rows : tuple of RowTransformation
        For the first four kinds, one per residual of the second generator.
    error : float
        Largest relative distance over frequency of the second generator from the transformed first.
    note : str
        Why ``rows`` are missing where each residual is a filtered one, if they are.
    """

    equivalent: bool
    kind: str
    rows: tuple[RowTransformation, ...]
    error: float
    first: StateSpace = field(repr=False)
    second: StateSpace = field(repr=False)
    plant: Plant = field(repr=False)
    note: str = ""

    def __bool__(self) -> bool:
        return self.equivalent

    def transformation(self, w: NDArray[np.float64]) -> NDArray[np.complex128]:
        r"""Return :math:`V(j\omega)` with :math:`Q_b = V Q_a`, of least norm if it is not unique.

        Parameters
        ----------
        w : ndarray, shape (k,)
            Frequencies in rad/s.

        Returns
        -------
        ndarray, shape (k, residuals of the second, residuals of the first)
        """
        return _transformation(self.first.frequency_response(w), self.second.frequency_response(w))

    @property
    def matrix(self) -> NDArray[np.float64] | None:
        """The transformation, if it is a matrix of numbers: the same at every frequency."""
        if self.rows:
            if any(len(row.zeros) or len(row.poles) for row in self.rows):
                return None
            out = np.zeros((self.second.n_outputs, self.first.n_outputs))
            for row in self.rows:
                out[self.second.outputs.index(row.second), self.first.outputs.index(row.first)] = row.gain
            return out
        V = self.transformation(frequency_grid(self.first, self.second))
        constant = V.real.mean(axis=0)
        return constant if np.abs(V - constant).max() < _PARALLEL * np.abs(V).max() else None

    def realization(self) -> StateSpace:
        r"""Return the transformation as a filter from the residuals of the first generator to those of the second.

        With a right inverse :math:`Q_a^R` of the first generator :math:`V = Q_b Q_a^R`, without the states that
        cancel.

        Returns
        -------
        StateSpace

        Raises
        ------
        DesignError
            If the second is no transformation of the first, or one that would have to undo delays (in continuous
            time, to differentiate).
        AccuracyError
            If what cancels does not cancel well enough.
        """
        if self.kind in ("whole", "different"):
            raise DesignError("the second generator is no transformation of the first")
        a, b = self.first, self.second
        if self.rows:
            return self._realized_rows()
        if decide_rank(a.D).rank < a.n_outputs:
            raise DesignError(
                "the first generator answers late to some combination of its signals, which the transformation would "
                "have to undo: ask for the reverse one, second.equivalent_to(first)"
            )
        inverse = np.linalg.pinv(a.D)
        back = a.replaced(
            A=a.A - a.B @ inverse @ a.C,
            B=a.B @ inverse,
            C=-inverse @ a.C,
            D=inverse,
            inputs=a.outputs,
            outputs=a.inputs,
        )
        realized = _minimal(back.series(b)).replaced(inputs=a.outputs, outputs=b.outputs)
        w = frequency_grid(a, b)
        wanted = self.transformation(w)
        missed = np.abs(realized.frequency_response(w) - wanted).max() / max(np.abs(wanted).max(), TINY)
        if not missed < 1e-5:
            raise AccuracyError(f"the transformation as a filter misses its frequency response by {missed:.2g}")
        return realized

    def _realized_rows(self) -> StateSpace:
        """Return the filters of the rows side by side: zeros and poles in sections."""
        a, b, parts = self.first, self.second, []
        rate = self.plant.balanced.units.rate  # powers are compared in balanced time
        for row in self.rows:
            if len(row.zeros) > len(row.poles):
                raise DesignError(
                    f"{row.first!r} answers later than {row.second!r}, which the transformation would have to undo: "
                    "ask for the reverse one, second.equivalent_to(first)"
                )
            basis, k = pole_basis(row.poles / rate), len(row.poles)
            zeros = np.atleast_1d(np.poly(row.zeros / rate)).real[::-1] * row.gain * rate ** (len(row.zeros) - k)
            q = np.zeros((k + 1, 1))
            q[: len(zeros), 0] = zeros
            q = PolynomialBasis.powers(k + 1).changed_to(basis, q)
            parts.append(realize_relation(np.zeros((k + 1, 0)), q, (np.zeros((0, 0)), np.zeros((1, 0))), basis))
        A, B, C, D = (scipy.linalg.block_diag(*[getattr(one, name) for one in parts]) for name in "ABCD")
        into = np.eye(a.n_outputs)[[a.outputs.index(row.first) for row in self.rows]]
        out = np.eye(b.n_outputs)[:, [b.outputs.index(row.second) for row in self.rows]]
        return StateSpace(
            rate * A, rate * B @ into, out @ C, out @ D @ into, dt=a.dt, inputs=a.outputs, outputs=b.outputs
        )

    def __str__(self) -> str:
        sentence = {
            "identical": "the same filter",
            "scale": "the same up to factors and order of the residuals",
            "poles": "the same up to poles and scale",
            "filter": "each residual of one is a filtered residual of the other",
            "transformation": "each residual of one is a sum of filtered residuals of the other",
            "part": "the second is a transformation of the first, which sees more",
            "whole": "the first is a transformation of the second, which sees more",
            "different": "neither is a transformation of the other",
        }[self.kind]
        lines = [f"{'equivalent' if self.equivalent else 'not equivalent'}: {sentence} (to {self.error:.1e})"]
        lines += [f"  {self.note}"] if self.note else []
        return "\n".join([*lines, *(f"  {row}" for row in self.rows)])


def equivalence(first: Any, second: Any) -> Equivalence:
    """Tell whether two generators are the same up to a transformation; see :meth:`ResidualGenerator.equivalent_to`."""
    first, second = (
        one.with_poles() if isinstance(one, ParityRelations) else as_generator(for_monitor(one))
        for one in (first, second)
    )
    a, b = first.system, second.system
    if a.n_inputs != b.n_inputs or len(first.plant.inputs) != len(second.plant.inputs) or a.dt != b.dt:
        raise ModelError(
            f"generators of different signals cannot be compared: {len(first.plant.inputs)} inputs, "
            f"{first.plant.n_outputs} outputs, dt={a.dt:g} and {len(second.plant.inputs)} inputs, "
            f"{second.plant.n_outputs} outputs, dt={b.dt:g}"
        )
    w = frequency_grid(a, b)
    Qa, Qb = a.frequency_response(w), b.frequency_response(w)
    units = _signal_units(first, Qa, w)
    units = np.where(units > 0, units, _signal_units(second, Qb, w))  # signals that the first has nothing to do with
    units = np.where(units > 0, units, 1.0)
    Qa, Qb = Qa / units, Qb / units
    note, rows, zeros = "", (), False
    try:
        rows, zeros = _matched(first, second, Qa, Qb)
    except (AccuracyError, DesignError) as error:
        note = f"zeros and poles of the filters are not known: {error}"
    if rows:
        plain = not any(len(row.zeros) or len(row.poles) for row in rows)
        same = plain and all(
            abs(row.gain - 1) < _PARALLEL and second.residuals.index(row.second) == first.residuals.index(row.first)
            for row in rows
        )
        kind = "identical" if same else "scale" if plain else "filter" if zeros else "poles"
        return Equivalence(True, kind, rows, max(row.error for row in rows), a, b, first.plant)
    forth, back = _missed(Qa, Qb), _missed(Qb, Qa)
    kind = {
        (True, True): "transformation",
        (True, False): "part",
        (False, True): "whole",
        (False, False): "different",
    }[forth < _PARALLEL, back < _PARALLEL]
    error = max(forth, back) if kind in ("transformation", "different") else min(forth, back)
    return Equivalence(kind == "transformation", kind, (), error, a, b, first.plant, note)


def _signal_units(generator: ResidualGenerator, Q: NDArray, w: NDArray) -> NDArray[np.float64]:
    r"""Return what one is, for each signal that a generator reads, when responses to it are compared.

    The largest response; but for an output not much less than the others, in balanced units, and for a control input
    not less than the terms that cancel in :math:`Q_u + Q_y P_u = 0` then. What is smaller may be rounding: that of an
    actuator whose fault is ignored is not read at all.
    """
    plant, n_u = generator.plant, len(generator.plant.inputs)
    size = np.abs(Q).max(axis=(0, 1))
    P, outputs = plant.system("control").frequency_response(w), plant.balanced.units.outputs
    least = _FAINT_OUTPUT * np.max(size[n_u:] / outputs, initial=0.0) * outputs
    terms = (np.maximum(np.abs(Q[:, :, n_u:]), least) @ np.abs(P)).max(axis=(0, 1))
    return np.maximum(size, np.concatenate([terms, least]))


def _matched(
    first: ResidualGenerator, second: ResidualGenerator, Qa: NDArray, Qb: NDArray
) -> tuple[tuple[RowTransformation, ...], bool]:
    """Return for each residual of the second which one of the first it is, filtered; nothing if one is none.

    And whether zeros that are not poles of the other take part.
    """
    if first.n_residuals != second.n_residuals:
        return (), False
    free, pairs = list(range(first.n_residuals)), []
    for j in range(second.n_residuals):
        error, i = min((_missed(Qa[:, i : i + 1], Qb[:, j : j + 1]), i) for i in free)
        if not error < _PARALLEL:
            return (), False
        free.remove(i)
        pairs.append((i, j, error))
    w, dt = frequency_grid(first.system, second.system), first.dt
    points = np.asarray(np.exp(1j * w * dt) if dt else 1j * w, dtype=np.complex128)
    ours, theirs = row_fractions(first), row_fractions(second)
    rows, zeros_of_second = [], False
    for i, j, error in pairs:
        a, b = ours[i], theirs[j]
        zeros, poles = _cancelled(np.concatenate([b.zeros, a.poles]), np.concatenate([a.zeros, b.poles]), dt)
        row = RowTransformation(first.residuals[i], second.residuals[j], 1.0, zeros, poles, error)
        filtered = Qa[:, i] * row.evaluate(points)[:, None]
        weight = 1 / np.maximum(np.linalg.norm(filtered, axis=1), TINY)[:, None] ** 2
        gain = float((weight * (filtered.conj() * Qb[:, j])).sum().real / (weight * np.abs(filtered) ** 2).sum())
        off = np.linalg.norm(gain * filtered - Qb[:, j], axis=1) / np.maximum(np.linalg.norm(Qb[:, j], axis=1), TINY)
        missed = float(max(error, np.median(off)))
        if not missed < _FILTER_ERROR:
            raise AccuracyError(f"filters made of them miss by {missed:.2g}")
        rows.append(replace(row, gain=gain, error=missed))
        zeros_of_second |= any(len(left) for left in _cancelled(b.zeros, a.zeros, dt))
    return tuple(rows), zeros_of_second


def _cancelled(zeros: NDArray, poles: NDArray, dt: float) -> tuple[NDArray, NDArray]:
    """Return zeros and poles without those that stand in both, up to what is little for their rate."""
    left, kept = list(poles), []
    origin = 1.0 if dt else 0.0
    rounding = 1e-9 * np.max(np.abs(np.concatenate([zeros, poles, [origin]])), initial=0.0)
    for zero in zeros:
        limit = max(_CANCEL * abs(zero - origin), rounding)
        near = [k for k, pole in enumerate(left) if abs(pole - zero) <= limit]
        if near:
            left.pop(near[0])
        else:
            kept.append(zero)
    return np.array(kept, dtype=np.complex128), np.array(left, dtype=np.complex128)


def _missed(Qa: NDArray, Qb: NDArray) -> float:
    """Return how far the rows of ``Qb`` are from combinations of those of ``Qa``, the worst over frequency."""
    size = np.linalg.norm(Qb, axis=2)
    loud = size > _FAINT * size.max(axis=0, initial=0.0)
    left = Qb - _transformation(Qa, Qb) @ Qa
    share = np.linalg.norm(left, axis=2) / np.maximum(size, TINY)
    return float(np.max(np.where(loud, share, 0.0), initial=0.0))


def _transformation(Qa: NDArray, Qb: NDArray) -> NDArray[np.complex128]:
    """Return the least-squares ``V`` with ``V Qa = Qb`` at every frequency, in units of the rows."""
    rows = np.maximum(np.linalg.norm(Qa, axis=2), TINY)
    unit = Qa / rows[:, :, None]
    return Qb @ np.linalg.pinv(unit, rcond=1e-9) / rows[:, None, :]


def _minimal(system: StateSpace) -> StateSpace:
    """Return a system without the states that no output sees or no input reaches."""
    seen = without_unobservable(system)
    dual = StateSpace(seen.A.T, seen.C.T, seen.B.T, seen.D.T, dt=seen.dt)
    reached = without_unobservable(dual)
    return StateSpace(reached.A.T, reached.C.T, reached.B.T, reached.D.T, dt=seen.dt)
