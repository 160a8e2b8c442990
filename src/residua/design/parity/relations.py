"""Parity relations as objects: what they say, how they print, and the filters that evaluate them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from residua.design.core.canonical_design import in_units_of
from residua.design.core.decoupling import Decoupled
from residua.design.core.evidence import Evidence, format_pole
from residua.design.core.generator import ResidualGenerator, make_generator
from residua.design.core.own_time import has_rates, in_own_time, written_in_own_time
from residua.design.core.signals import signal_names
from residua.design.parity.directional_pencil import Directions, changed_together, check_directions
from residua.design.parity.realization import Realization, pole_basis, realize_relation
from residua.design.parity.relation import Relation, changed, digits_lost, plant_rate, states_missed
from residua.errors import AccuracyError, DesignError, SettingError
from residua.linear import PolynomialMatrix, StateSpace, is_stable_mode
from residua.linear.polynomials.polynomial_basis import PolynomialBasis
from residua.linear.systems.array_cache import cached_by_contents
from residua.linear.systems.balancing import descriptor_units, power_of_two
from residua.plant import Plant
from residua.plant.comparable_units import PlantUnits, canonical_units
from residua.plant.input_output_entries import in_other_time
from residua.shown import Shown
from residua.tolerances import POLYNOMIAL_LEAKAGE, RESIDUE, above_rounding
from residua.words import counted

#: What the states may be missed by, relative to the terms that have to cancel.
_REMAINDER = 1e-8
_LOST = "digits lost to cancellation"
#: Measurements seldom have more digits than this.
_MANY = 6.0
#: A moving average in which more digits cancel is made only for those who ask for its poles, all zero.
_TOO_MANY = 10.0
#: Poles of the filters of parity relations: one list for all, or one for each residual by name.
Poles = Sequence[complex] | ArrayLike | Mapping[str, Sequence[complex]]


@has_rates()
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
        The polynomials, in bases that keep their digits; see ``output_rows`` and the like for powers of ``z``.
    names : tuple of str
        Of the residuals.
    directions : Directions or None
        The directions that the residuals keep together, if the design asked for that.

    References
    ----------
    Gertler (1991), eqs. (3-2), (3-4), (3-9), (3-10) and section 3.5.
    """

    plant: Plant
    rows: tuple[Relation, ...] = field(repr=False)
    names: tuple[str, ...]
    directions: Directions | None = None

    # -------------------------------------------------------------------- facts

    @property
    def orders(self) -> tuple[int, ...]:
        """The order of each relation: how many past samples, or derivatives, it reads."""
        return tuple(row.order for row in self.rows)

    @property
    def divided(self) -> tuple[NDArray[np.complex128], ...]:
        """For each residual the roots of the common factor that was divided out."""
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

    @cached_property
    def _own(self) -> tuple[ParityRelations, float]:
        """The relations in the plant's own unit of time, in which powers are compared, and that unit."""
        return written_in_own_time(self)

    def _in_this_time(self, own: PolynomialMatrix, unit: float, lower: int = 0) -> PolynomialMatrix:
        """Return rows of the relations in that unit as in the unit of these, of a degree that is so much lower."""
        return in_other_time(own, unit, [order - lower for order in self.orders])

    def _response(self, role: str) -> PolynomialMatrix:
        """Return ``p B + q D`` in powers, without what rounding leaves of nothing."""
        own, unit = self._own
        if own is not self:
            return self._in_this_time(own._response(role), unit)
        B, D = getattr(self.plant, f"B{role}"), getattr(self.plant, f"D{role}")
        k = max(self.orders, default=0)
        P, Q = self.state_rows.padded(k), self.output_rows.padded(k)
        value, terms = P @ B + Q @ D, np.abs(P) @ np.abs(B) + np.abs(Q) @ np.abs(D)
        return PolynomialMatrix(above_rounding(value, terms.max(axis=0, initial=0.0)))

    @cached_property
    def _in_powers(self) -> tuple[PolynomialMatrix, PolynomialMatrix]:
        """Return ``p`` and ``q`` in powers of the variable, refined where that costs digits."""
        own, unit = self._own
        if own is not self:
            P, Q = own._in_powers
            return self._in_this_time(P, unit, 1), self._in_this_time(Q, unit)
        most = max(self.orders, default=0)
        n, m = self.plant.n_states, self.plant.n_outputs
        P, Q = np.zeros((most + 1, len(self.rows), n)), np.zeros((most + 1, len(self.rows), m))
        changed = self._changed_to([PolynomialBasis.powers(row.order + 1, self.size) for row in self.rows])
        for i, (row, one) in enumerate(zip(self.rows, changed, strict=True)):
            powers = self.size ** -np.arange(row.order + 1.0)[:, None]
            P[: row.order + 1, i], Q[: row.order + 1, i] = one.p * powers, one.q * powers
        powers = self.size ** np.arange(most + 1.0)[:, None, None]
        units = descriptor_units(self.plant.A, self.plant.E, self.plant.B, self.plant.C, self.plant.D).outputs
        heights = np.abs(Q) * powers / units
        rounding = heights < RESIDUE * heights.max(axis=(0, 2), initial=0.0)[:, None]
        return PolynomialMatrix(P), PolynomialMatrix(np.where(rounding, 0.0, Q))

    @property
    def size(self) -> float:
        """The size at which powers are compared: 1 in sampled time, the rate of the plant in 1/s otherwise."""
        return 1.0 if self.plant.is_discrete else plant_rate(self.plant)

    def _changed_to(self, bases: Sequence[PolynomialBasis]) -> list[Relation]:
        """Return the rows in other bases, made exact there."""
        if self.directions is not None and self.rows:
            return changed_together(self.rows, bases[0], self.plant, self.directions)
        return changed(self.rows, bases, self.plant)

    # ------------------------------------------------------------------ filters

    @in_own_time()
    def with_poles(
        self, poles: Poles | None = None, *, method: str = "parity relations", notes: Sequence[str] = ()
    ) -> ResidualGenerator:
        r"""Return the filter :math:`r = r^* / \prod_i (z - \lambda_i)` for each relation.

        Parameters
        ----------
        poles : sequence of complex, or mapping of str to sequence, optional
            As many as the order, for all relations or for each by name; closed under conjugation, stable. When omitted:
            all zero in sampled time, which is the moving-average form itself; in continuous time all at the rate
            of the plant.
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
            If rounding in the coefficients shows in the residual, or, without ``poles``, more than ten digits
            cancel in the moving average.

        References
        ----------
        Gertler (1991), section 3.5.
        """
        units = canonical_units(self.plant)
        own, heights = self._in_units(units)
        made = own._filtered(own._poles(poles), method, notes, asked=poles is not None)
        return replace(in_units_of(self.plant, units, made, heights), relations=self)

    def _in_units(self, units: PlantUnits) -> tuple[ParityRelations, NDArray[np.float64]]:
        """Return the relations between the signals of the scaled plant, of heights near one, and what these were."""
        height = np.concatenate([units.equations, units.outputs])[:, None]
        P, Q = [row.p / units.equations for row in self.rows], [row.q / units.outputs for row in self.rows]
        heights = power_of_two(
            np.array([max(np.abs(p).max(initial=0.0), np.abs(q).max(initial=0.0)) for p, q in zip(P, Q, strict=True)])
        )
        if self.directions is not None:  # which residuals keep together
            heights = np.full(len(heights), heights.max(initial=1.0))
        rows = []
        for row, p, q, size in zip(self.rows, P, Q, heights, strict=True):
            ignored = row.ignored * height  # its columns have units of their own, which must not count either
            ignored = ignored / power_of_two(np.abs(ignored).max(axis=0, initial=0.0))
            rows.append(replace(row, p=p / size, q=q / size, ignored=ignored))
        return replace(self, plant=units.applied(self.plant), rows=tuple(rows)), heights

    @cached_by_contents
    def _filtered(
        self, chosen: list[NDArray[np.complex128]], method: str, notes: Sequence[str], *, asked: bool
    ) -> ResidualGenerator:
        """Return the filter with checked poles, for a plant in its own units."""
        bases = [pole_basis(one) for one in chosen]
        plant = self.plant
        rows = self._changed_to(bases)
        parts = [realize_relation(row.p, row.q, plant, row.basis) for row in rows]
        system = self._stacked(parts)
        evidence = Evidence(
            method=method,
            poles=system.poles(),
            requested_poles=np.concatenate([np.zeros(0, dtype=np.complex128), *chosen]),
            conditions={"states left": _accepted(rows, plant)},
            notes=(*self._told(), *notes),
            references=("Gertler (1991), sections 3.1, 3.2 and 3.5",),
        )
        made = make_generator(
            system,
            plant,
            method,
            evidence,
            decouples=Decoupled(disturbances=not self._disturbed(rows), limit=POLYNOMIAL_LEAKAGE),
            state_map=np.vstack([part.state_map for part in parts]),
            static_map=None if plant.E is None else np.vstack([part.static_map for part in parts]),
        )
        if self.directions is not None:
            off = check_directions(made, self.directions)
            made = replace(made, evidence=made.evidence.extended(conditions={"response off the directions": off}))
        lost = digits_lost(rows, made)
        if lost is None:
            return made
        if lost > _TOO_MANY and not asked and plant.is_discrete:
            raise AccuracyError(
                f"as a moving average of order {max(self.orders)}, {_cancelling(lost)}; or ask for it all the same, "
                f"with poles of zero, {max(self.orders)} of them"
            )
        remarks = (_cancelling(lost),) if lost > _MANY else ()
        return replace(made, evidence=made.evidence.extended(conditions={_LOST: lost}, notes=remarks))

    def stacked_with(self, others: Sequence[ParityRelations], names: Sequence[str]) -> ParityRelations:
        """Return these and further relations of the same plant as one set, with new names."""
        return ParityRelations(self.plant, (*self.rows, *(row for one in others for row in one.rows)), tuple(names))

    def _stacked(self, parts: list[Realization]) -> StateSpace:
        """Return the filters side by side, driven by the same signals."""
        return StateSpace(
            scipy.linalg.block_diag(*[part.system.A for part in parts]),
            np.vstack([part.system.B for part in parts]),
            scipy.linalg.block_diag(*[part.system.C for part in parts]),
            np.vstack([part.system.D for part in parts]),
            dt=self.plant.dt,
            inputs=signal_names(self.plant),
            outputs=self.names,
        )

    def _poles(self, poles: Poles | None) -> list[NDArray[np.complex128]]:
        """Return the poles of each relation, checked."""
        if poles is None:
            rate = 0.0 if self.plant.is_discrete else -plant_rate(self.plant)
            return [np.full(k, rate, dtype=np.complex128) for k in self.orders]
        if isinstance(poles, Mapping):
            unknown = set(poles) - set(self.names)
            missing = [name for name, k in zip(self.names, self.orders, strict=True) if k and name not in poles]
            if unknown or missing:
                raise SettingError(
                    f"poles are given by residual, {', '.join(self.names)}; "
                    + (
                        f"there is no {', '.join(map(repr, sorted(unknown)))}"
                        if unknown
                        else f"none for {missing[0]!r}"
                    )
                )
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

    def _disturbed(self, rows: Sequence[Relation]) -> bool:
        """Tell whether disturbances reach a relation by more than rounding."""
        Bd, Dd = self.plant.Bd, self.plant.Dd
        for row in rows:
            left = np.abs(row.p @ Bd + row.q @ Dd).max(axis=0, initial=0.0)
            terms = (np.abs(row.p) @ np.abs(Bd) + np.abs(row.q) @ np.abs(Dd)).max(axis=0, initial=0.0)
            if np.any(left > 1e-8 * terms) and np.any(left > 1e-10 * np.abs(np.hstack([row.p, row.q])).max()):
                return True
        return False

    def _told(self) -> Iterator[str]:
        """Yield what was divided out silently elsewhere."""
        for name, roots in zip(self.names, self.divided, strict=False):
            if len(roots):
                words = f"root{'s' * (len(roots) > 1)} {', '.join(map(format_pole, roots))}"
                yield f"{name}: a factor common to all signals was divided out, with {words}"

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

    The first output that takes much part, in units that are not those of the caller: another one would be another
    rounding. Relations that keep directions together are of one order, and all scaled by the factor of the first.
    """
    factors, outputs = [], canonical_units(plant).outputs
    for row in rows:
        newest = row.q[-1]
        if not np.any(row.q):
            raise DesignError("a relation reads no output: the equations of the model are not independent")
        parts = np.abs(newest) / outputs
        large = np.flatnonzero(parts >= 0.1 * parts.max())
        leading = float(newest[large[0]] / np.prod(row.basis.sizes[: row.order]))
        factors.append(1 / leading if leading else 1.0)
    if directions is not None:
        factors = [abs(factors[0]) * _sign(rows, plant, directions)] * len(factors)
    names = tuple(names) if names else tuple(f"r{i + 1}" for i in range(len(rows)))
    scaled = tuple(row.times(factor) for row, factor in zip(rows, factors, strict=True))
    return ParityRelations(plant, scaled, names, directions)


def _sign(rows: Sequence[Relation], plant: Plant, directions: Directions) -> float:
    """Return the sign with which the first response to the first of the directed faults is along its direction."""
    j = plant.faults.index(directions.faults[0])
    each = np.array([row.p @ plant.Bf[:, j] + row.q @ plant.Df[:, j] for row in rows])
    along = directions.vectors[:, 0] @ each
    present = np.flatnonzero(np.abs(along) > 1e-9 * np.abs(along).max())
    return float(np.sign(along[present[-1]])) if len(present) else 1.0


def _cancelling(lost: float) -> str:
    """Return what is to be said of a filter in which many digits cancel."""
    share = f"{10 ** (lost - 16):.0e} of" if lost < 16 else "as large as"
    return (
        f"{lost:.0f} digits of the data cancel: rounding of numbers of 16 digits alone makes residuals {share} what a "
        "fault leaves, that of measurements more; choose poles near those of the plant (with_poles), or structured_bank"
    )


def _accepted(rows: Sequence[Relation], plant: Plant) -> float:
    """Return how far the states are missed at most, or raise."""
    worst = states_missed(rows, plant)
    if not worst <= _REMAINDER:
        order = max(row.order for row in rows)
        raise AccuracyError(
            f"a parity relation of order {order} leaves {worst:.2g} > {_REMAINDER:.0e} of the states: too "
            "ill-conditioned with these poles; choose poles near those of the plant, or use decoupled_residual "
            "or structured_bank"
        )
    return worst


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
    if not np.isfinite(values).all():
        raise SettingError("poles must be finite")
    pairs = np.sort_complex(values[values.imag > 0]), np.sort_complex(values[values.imag < 0].conj())
    if len(pairs[0]) != len(pairs[1]) or not np.allclose(*pairs, rtol=1e-12, atol=0):
        raise SettingError("the poles are not closed under conjugation")
    unstable = values[~is_stable_mode(values, plant.dt)]
    if len(unstable):
        where = "inside the unit circle" if plant.is_discrete else "in the left half plane"
        raise SettingError(f"pole {format_pole(unstable[0])} is not stable: poles must lie {where}")
    return values


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
