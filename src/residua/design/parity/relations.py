"""Parity relations as objects: their polynomials, their text, and the filters that evaluate them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence, format_pole
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.signals import signal_names
from residua.design.parity.directions import Directions, check_directions
from residua.design.parity.relation import (
    Realization,
    Relation,
    controls_of,
    filter_basis,
    lost_digits,
    plant_rate,
    realize_by_least_squares,
    realize_relation,
)
from residua.errors import AccuracyError, DesignError, ModelError, SettingError
from residua.linear import PolynomialMatrix, StateSpace
from residua.linear.poles.pole_assignment import checked_poles
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.plant import Plant
from residua.shown import Shown
from residua.tolerances import RESPONSE_ROUNDING, above_rounding
from residua.words import counted

Matrix = NDArray[np.float64]
#: Coefficients of which nothing is left of the others, in any unit.
_HUGE = 1e50
#: Of several relations those of which the newest sample counts for less are nearly of a lower order.
_NEWEST = 1e-3
#: The note of a filter whose default poles are others.
_OTHER_POLES = "with the usual poles too many digits cancel: the poles are those of a gain by least squares"
_LOST = "digits lost to cancellation"
#: Measurements seldom have more digits than this.
_MANY = 6.0
#: Of the digits of a sum of many terms in double precision, all but one.
_MOST = 13.0
#: Poles of the filters of parity relations: one list for all, or one for each residual by name.
Poles = Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]]


@dataclass(frozen=True, eq=False, repr=False)
class ParityRelations(Shown):
    r"""Polynomial equations between inputs and outputs that hold while nothing fails, one per residual.

    .. math:: r^* = q(z)\, y - \left( p(z) B + q(z) D \right) u, \qquad p(z)\,(zE - A) = q(z)\, C

    seen from the faults :math:`r^* = (p B_f + q D_f) f`. In sampled time ``z`` is the shift: the moving-average form
    reads the last ``order + 1`` samples. In continuous time it is the derivative ``s``: only the relation divided by a
    stable polynomial can be evaluated.

    Attributes
    ----------
    plant : Plant
    rows : tuple of Relation
        The polynomials, balanced, in bases that keep their digits; see ``output_rows`` and the like for powers of
        ``z`` in the units of the plant.
    names : tuple of str
        Of the residuals.
    heights : ndarray, shape (residuals,)
        One of each balanced residual in the units of the plant.
    directions : Directions or None
        The directions that the residuals keep together, if the design asked for that.

    References
    ----------
    Gertler (1991), eqs. (3-2), (3-4), (3-9), (3-10) and section 3.5.
    """

    plant: Plant
    rows: tuple[Relation, ...] = field(repr=False)
    names: tuple[str, ...]
    heights: Matrix = field(repr=False)
    directions: Directions | None = None

    # -------------------------------------------------------------------- facts

    @property
    def orders(self) -> tuple[int, ...]:
        """The order of each relation: how many past samples, or derivatives, it reads."""
        return tuple(row.order for row in self.rows)

    @property
    def divided(self) -> tuple[NDArray[np.complex128], ...]:
        """Roots of the common factor that was divided out of each residual."""
        return tuple(row.divided for row in self.rows)

    @cached_property
    def state_rows(self) -> PolynomialMatrix:
        """``p(z)``, shape (residuals, states)."""
        return self._in_powers[0]

    @cached_property
    def output_rows(self) -> PolynomialMatrix:
        """The polynomials on the outputs, ``q(z)``, shape (residuals, outputs)."""
        return self._in_powers[1]

    @property
    def input_rows(self) -> PolynomialMatrix:
        """The polynomials on the control inputs, shape (residuals, inputs)."""
        return -self._response("")

    @property
    def fault_rows(self) -> PolynomialMatrix:
        """The internal form: the polynomials on the faults, shape (residuals, faults)."""
        return self._response("f")

    @property
    def disturbance_rows(self) -> PolynomialMatrix:
        """The polynomials on the disturbances: what is left of those that were decoupled, or was not."""
        return self._response("d")

    @property
    def parity_vectors(self) -> NDArray[np.float64]:
        """Chow and Willsky's ``w``, shape (residuals, (order + 1) outputs): the oldest sample first, eq. (3-9)."""
        Q = self.output_rows.padded(max(self.orders, default=0))
        return Q.transpose(1, 0, 2).reshape(Q.shape[1], -1)

    def _response(self, role: str) -> PolynomialMatrix:
        """Return ``p B + q D`` in powers, without what rounding leaves of nothing."""
        B, D = getattr(self.plant, f"B{role}"), getattr(self.plant, f"D{role}")
        k = max(self.orders, default=0)
        P, Q = self.state_rows.padded(k), self.output_rows.padded(k)
        value, terms = P @ B + Q @ D, np.abs(P) @ np.abs(B) + np.abs(Q) @ np.abs(D)
        rates = self.plant.balanced.units.rate ** np.arange(k + 1.0)[:, None, None]  # powers are compared balanced
        return PolynomialMatrix(above_rounding(value, (rates * terms).max(axis=0, initial=0.0) / rates))

    @cached_property
    def _in_powers(self) -> tuple[PolynomialMatrix, PolynomialMatrix]:
        """Return ``p`` and ``q`` in powers of the variable, in the units of the plant."""
        most, units = max(self.orders, default=0), self.plant.balanced.units
        n, m = self.plant.n_states, self.plant.n_outputs
        P, Q = np.zeros((most + 1, len(self.rows), n)), np.zeros((most + 1, len(self.rows), m))
        moved = self._moved([PolynomialBasis.powers(row.order + 1) for row in self.rows])
        for i, (row, height) in enumerate(zip(moved, self.heights, strict=True)):
            p, q = row.in_equations(self.plant)
            powers = height * units.rate ** (row.order - np.arange(row.order + 1.0))[:, None]
            P[: row.order + 1, i] = powers * p * units.equations / units.rate
            Q[: row.order + 1, i] = powers * q * units.outputs
        return PolynomialMatrix(P), PolynomialMatrix(Q)

    def _moved(self, bases: Sequence[PolynomialBasis]) -> list[Relation]:
        """Return the rows in other bases, made exact there."""
        if self.directions is not None and self.rows:
            return self.directions.moved(self.rows, bases[0])
        return [row.moved(basis) for row, basis in zip(self.rows, bases, strict=True)]

    # ------------------------------------------------------------------ filters

    def with_poles(
        self, poles: Poles | None = None, *, method: str = "parity relations", notes: Sequence[str] = ()
    ) -> ResidualGenerator:
        r"""Return the filter :math:`r = r^* / \prod_i (z - \lambda_i)` for each relation.

        Parameters
        ----------
        poles : sequence of complex, or mapping of str to sequence, optional
            As many as the order, for all relations or for each by name; closed under conjugation, stable. When omitted:
            all zero in sampled time, which is the moving-average form itself; in continuous time all at the rate
            of the plant. Where more than six digits cancel with these, those of a gain by least squares; a note of the
            evidence says so.
        method : str
            What the design is called.
        notes : sequence of str
            Further notes for the evidence.

        Returns
        -------
        ResidualGenerator

        Raises
        ------
        SettingError
            If the number of poles does not fit, they are not closed under conjugation, or not stable; or if they differ
            between residuals that keep directions together, which would bend them.
        AccuracyError
            If rounding of the coefficients shows in the residual: known inputs reach it by more than 1e-6 of the terms
            that cancel, or more than 13 digits of the data cancel in what a fault does.

        References
        ----------
        Gertler (1991), section 3.5.
        """
        if poles is not None or self.directions is not None:
            return self._on_poles(self._poles(poles), method, notes)
        try:
            usual = self._on_poles(self._poles(None), method, notes)
        except AccuracyError as error:
            with suppress(AccuracyError):
                return self._by_least_squares(method, notes)
            raise error
        lost = usual.evidence.conditions.get(_LOST, 0.0) > _MANY
        if lost or not usual.structure.any(axis=1).all():  # in a residual that answers to nothing all may be lost
            with suppress(AccuracyError):
                other = self._by_least_squares(method, notes)
                if lost or (other.structure & ~usual.structure).any():
                    return other
        return usual

    def _on_poles(self, poles: list[NDArray[np.complex128]], method: str, notes: Sequence[str]) -> ResidualGenerator:
        """Return the filter with poles for each relation; raise where its rounding hides the faults."""
        rows = self._moved([filter_basis(self.plant, one) for one in poles])
        rows = [row.times(1 / float(np.prod(row.basis.sizes[: row.order]))) for row in rows]  # monic again
        controls = controls_of(self.plant)
        parts = [realize_relation(*row.in_equations(self.plant), controls, row.basis) for row in rows]
        generator = self._generator(parts, method, notes, np.concatenate([np.zeros(0, dtype=np.complex128), *poles]))
        if self.directions is not None:
            off = check_directions(generator, self.directions)
            evidence = generator.evidence.extended(conditions={"response off the directions": off})
            generator = replace(generator, evidence=evidence)
        lost = lost_digits(rows, generator)
        if lost is None:
            return generator
        share = f"{10 ** (lost - 16):.0e} of" if lost < 16 else "as large as"
        remark = (
            f"{lost:.0f} digits of the data cancel: rounding of numbers of 16 digits alone makes residuals {share} "
            "what a fault leaves, that of measurements more; choose poles near those of the plant (with_poles), or "
            "structured_bank"
        )
        if lost > _MOST:
            raise AccuracyError(f"with these poles rounding hides what a fault does: {remark}, or decoupled_residual")
        remarks = (remark,) if lost > _MANY else ()
        return replace(generator, evidence=generator.evidence.extended(conditions={_LOST: lost}, notes=remarks))

    def _by_least_squares(self, method: str, notes: Sequence[str]) -> ResidualGenerator:
        """Return the filter of which each relation has the poles of a gain by least squares."""
        parts = [realize_by_least_squares(row.p, row.q, row.equations, self.plant) for row in self.rows]
        return self._generator(parts, method, (*notes, _OTHER_POLES), np.zeros(0, dtype=np.complex128))

    def _generator(
        self, parts: Sequence[Realization], method: str, notes: Sequence[str], requested: NDArray[np.complex128]
    ) -> ResidualGenerator:
        """Return filters of relations side by side, driven by the same signals."""
        plant, units, heights = self.plant, self.plant.balanced.units, self.heights[:, None]
        largest = max((float(np.abs(one.B).max(initial=0.0)) for one in parts), default=0.0)
        if not largest < _HUGE:
            raise AccuracyError(
                f"of a relation of order {max(self.orders)} with these poles the newest sample counts 1, others "
                f"{largest:.0e}: it is lost in rounding; choose poles near those of the plant, or use "
                "decoupled_residual"
            )
        signals = np.concatenate([np.ones(len(plant.inputs)), units.outputs])
        system = StateSpace(
            units.rate * scipy.linalg.block_diag(*[one.A for one in parts]),
            units.rate * np.vstack([one.B for one in parts]) * signals,
            heights * scipy.linalg.block_diag(*[one.C for one in parts]),
            heights * np.vstack([one.D for one in parts]) * signals,
            dt=plant.dt,
            inputs=signal_names(plant),
            outputs=self.names,
        )
        static_map = heights * np.vstack([one.static_map for one in parts]) * units.equations / units.rate
        divided = (
            f"{name}: a factor common to all signals was divided out, with root{'s' * (len(roots) > 1)} "
            f"{', '.join(map(format_pole, roots))}"
            for name, roots in zip(self.names, self.divided, strict=True)
            if len(roots)
        )
        evidence = Evidence(
            method=method,
            poles=system.poles(),
            requested_poles=requested,
            notes=(*divided, *notes),
            references=("Gertler (1991), sections 3.1, 3.2 and 3.5",),
        )
        Bd, Dd = plant.balanced.disturbances
        disturbed = any(
            np.abs(row.p @ Bd + row.q @ Dd).max(initial=0.0) > 1e-8 * np.abs(row.q).max() for row in self.rows
        )
        return make_generator(
            system,
            plant,
            method,
            evidence,
            decouples=Decoupled(disturbances=not disturbed),
            state_map=np.vstack([one.state_map for one in parts]) * units.equations,
            static_map=None if plant.E is None else static_map,
            relations=self,
        )

    def stacked_with(self, others: Sequence[ParityRelations], names: Sequence[str]) -> ParityRelations:
        """Return these and further relations of the same plant as one set, with new names."""
        rows = (*self.rows, *(row for one in others for row in one.rows))
        return ParityRelations(self.plant, rows, tuple(names), np.concatenate([x.heights for x in (self, *others)]))

    def _poles(self, poles: Poles | None) -> list[NDArray[np.complex128]]:
        """Return the poles of each relation, checked."""
        if poles is None:
            usual = 0.0 if self.plant.is_discrete else -plant_rate(self.plant)
            return [np.full(k, usual, dtype=np.complex128) for k in self.orders]
        if isinstance(poles, Mapping):
            needed = [name for name, k in zip(self.names, self.orders, strict=True) if k]
            check_pole_names(poles, self.names, needed, "residual")
            shares = [poles.get(name, ()) for name in self.names]
        else:
            shares = [poles for _ in self.names]
        chosen = [
            _checked_poles(p, k, name, self.plant) for p, k, name in zip(shares, self.orders, self.names, strict=True)
        ]
        if self.directions is not None:
            for name, one in zip(self.names, chosen, strict=True):
                if not np.array_equal(np.sort_complex(one), np.sort_complex(chosen[0])):
                    raise SettingError(
                        f"residuals {self.names[0]!r} and {name!r} keep the directions of "
                        f"{', '.join(self.directions.faults)} together: give all of them the same poles"
                    )
        return chosen

    # -------------------------------------------------------------------- texts

    def __str__(self) -> str:
        """Return the relations as equations, in the past samples or in derivatives."""
        plant = self.plant
        lines = []
        for i, name in enumerate(self.names):
            k = self.orders[i]
            terms = [
                *terms_of(self.output_rows.padded(k)[: k + 1, i], plant.outputs, plant.is_discrete),
                *terms_of(self.input_rows.padded(k)[: k + 1, i], plant.inputs, plant.is_discrete),
            ]
            lines.append(f"{name} = {joined(terms)}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"ParityRelations({len(self.names)} relations, orders {', '.join(map(str, self.orders))})"


def relations_of(
    plant: Plant,
    rows: Sequence[Relation],
    names: Sequence[str] | None = None,
    *,
    directions: Directions | None = None,
) -> ParityRelations:
    """Return relations as one set, each scaled so that the newest sample of an output has coefficient one.

    The first output that takes much part, balanced. Relations that keep directions together are of one order, and all
    scaled by the factor of the first.
    """
    factors, heights, outputs = [], [], plant.balanced.units.outputs
    for row in rows:
        newest = row.q[-1, : plant.n_outputs]
        if not np.any(row.q[:, : plant.n_outputs]):
            raise DesignError("a relation reads no output: the equations of the model are not independent")
        first = int(np.flatnonzero(np.abs(newest) >= 0.1 * np.abs(newest).max())[0])
        size, largest = float(np.prod(row.basis.sizes[: row.order])), float(np.abs(row.q).max())
        there = abs(newest[first]) > (RESPONSE_ROUNDING if len(rows) == 1 else _NEWEST) * largest
        factors.append(size / newest[first] if there else 1 / largest)
        heights.append(1 / outputs[first])
    if directions is not None:
        factors = [abs(factors[0]) * directions.sign(rows, plant)] * len(factors)
        heights = heights[0] * directions.levels / directions.levels[0]
    names = tuple(names) if names else tuple(f"r{i + 1}" for i in range(len(rows)))
    scaled = tuple(row.times(factor) for row, factor in zip(rows, factors, strict=True))
    return ParityRelations(plant, scaled, names, np.array(heights, dtype=float), directions)


def check_pole_names(poles: Mapping[str, Any], names: Sequence[str], needed: Sequence[str], kind: str) -> None:
    """Raise when poles are given for names that do not exist, or not for all that need some."""
    unknown, missing = [name for name in poles if name not in names], [name for name in needed if name not in poles]
    if unknown or missing:
        why = f"there is no {unknown[0]!r}" if unknown else f"there are none for {missing[0]!r}"
        raise SettingError(f"poles are given by {kind}, {', '.join(names)}; {why}")


def _checked_poles(poles: Any, order: int, name: str, plant: Plant) -> NDArray[np.complex128]:
    """Return a list of poles as an array, or say what is wrong with it."""
    try:
        values = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    except (TypeError, ValueError) as error:
        raise SettingError(f"poles must be numbers: {error}") from error
    if values.shape != (order,):
        raise SettingError(
            f"relation {name!r} is of order {order}: give {counted(order, 'pole')}, not {values.size}, "
            "by name of the residual where orders differ"
        )
    try:
        return checked_poles(values, plant.is_discrete)
    except (DesignError, ModelError) as error:
        raise SettingError(str(error)) from error


def terms_of(rows: NDArray[np.float64], signals: Sequence[str], discrete: bool) -> Iterator[tuple[float, str]]:
    """Yield the terms of one relation: newest sample, or highest derivative, first."""
    k = len(rows) - 1
    for column, signal in zip(rows.T, signals, strict=True):
        for i in range(k, -1, -1):
            if column[i]:
                late = k - i
                where = (
                    ("[k]" if not late else f"[k-{late}]")
                    if discrete
                    else ("" if not i else "'" * i if i < 4 else f"^({i})")
                )
                yield column[i], f"{signal}{where}"


def joined(terms: Sequence[tuple[float, str]]) -> str:
    """Return a sum as text."""
    out = ""
    for value, name in terms:
        sign = " - " if value < 0 else " + "
        if not out:
            sign = "-" if value < 0 else ""
        size = abs(value)
        out += sign + (name if abs(size - 1) < 1e-12 else f"{size:.6g} {name}")
    return out or "0"
