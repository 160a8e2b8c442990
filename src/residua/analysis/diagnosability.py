"""Which faults can be detected, and which can be isolated, before any design."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.analysis.fault_space import fault_space
from residua.analysis.rational_visibility import (
    RationalColumns,
    are_rational,
    rational_columns,
    rational_limit_columns,
)
from residua.analysis.unknown_input import UnknownInputExistence, unknown_input_observer_existence
from residua.analysis.visibility import (
    Visible,
    check_regular,
    generic_points,
    in_canonical_units,
    limit_columns,
    visible_columns,
)
from residua.errors import ModelError
from residua.linear.subspaces.rank import DEFAULT_RTOL, check_rtol
from residua.plant import Plant
from residua.shown import Shown, grid, notes, table
from residua.tolerances import TINY
from residua.words import counted


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosability(Shown):
    """What residuals can show of the faults of a plant, whatever the method.

    Prints as a table.

    Attributes
    ----------
    faults : tuple of str
    detectable : ndarray of bool, shape (faults,)
        Some stable residual that ignores the disturbances answers to the fault.
    strongly_detectable : ndarray of bool, shape (faults,)
        Some such residual stays away from zero while a constant fault lasts.
    isolable : ndarray of bool, shape (faults, faults)
        ``isolable[i, j]``: some residual answers to fault ``i`` and ignores fault ``j``.
    strongly_isolable : ndarray of bool, shape (faults, faults)
        The same for faults that stay constant.
    groups : tuple of tuple of str
        Faults that no method can tell apart; undetectable faults are in no group.
    visibility : ndarray, shape (faults,)
        The evidence: the fraction of each fault's direction that is left after the disturbances are
        removed, at the best of the test points.
    unknown_input_observer : UnknownInputExistence
        Whether an exact observer exists that ignores all disturbances at once, and if not, why.
    """

    plant: Plant = field(repr=False)
    faults: tuple[str, ...]
    detectable: NDArray[np.bool_]
    strongly_detectable: NDArray[np.bool_]
    isolable: NDArray[np.bool_]
    strongly_isolable: NDArray[np.bool_]
    groups: tuple[tuple[str, ...], ...]
    visibility: NDArray[np.float64]
    unknown_input_observer: UnknownInputExistence

    def constant_twins(self, fault: str) -> tuple[str, ...]:
        """Return the faults that look the same as this one while both are constant, but not else."""
        i = self.faults.index(fault)
        return tuple(
            other
            for j, other in enumerate(self.faults)
            if j != i
            and self.strongly_detectable[[i, j]].all()
            and self.isolable[i, j]
            and not self.strongly_isolable[i, j]
        )

    def reasons(self) -> dict[str, str]:
        """Return the reason for each fault that cannot be detected or isolated."""
        out = {}
        for i, name in enumerate(self.faults):
            if not self.detectable[i]:
                out[name] = self._why_undetectable(i)
            elif not self.strongly_detectable[i]:
                out[name] = "a constant fault leaves no lasting trace: only its changes are seen"
        for group in self.groups:
            for name in group:
                others = [other for other in group if other != name]
                if others:
                    out[name] = f"same effect on the outputs as {', '.join(others)}, up to a filter"
        for name in self.faults:
            others = self.constant_twins(name)
            if others:
                more = f"while constant, it looks like {', '.join(others)}"
                out[name] = f"{out[name]}; {more}" if name in out else more
        return out

    def _why_undetectable(self, i: int) -> str:
        if len(self.plant.disturbances) == 0:
            return "no output sees it"
        if fault_space(self.plant.without_disturbances(), rtol=DEFAULT_RTOL).visible[i]:
            return f"hidden by the disturbances {', '.join(self.plant.disturbances)}, which can imitate it"
        return "no output sees it"

    def _headline(self) -> str:
        seen, whole = int(self.detectable.sum()), len(self.faults)
        return (
            f"{self.plant.name}: {seen} of {whole} faults detectable, {counted(len(self.groups), 'group')} told apart"
        )

    def _parts(self) -> list[str]:
        reasons = self.reasons()
        rows = [
            (name, self.plant.fault_kinds[i], _yes(self.detectable[i]), _yes(self.strongly_detectable[i]))
            + (reasons.get(name, ""),)
            for i, name in enumerate(self.faults)
        ]
        label = "Filled: a residual answers to the fault of the row and ignores that of the column"
        return [
            table(["fault", "kind", "detectable", "when constant", ""], rows),
            grid(self.isolable, self.faults, self.faults, label=label),
            notes([str(self.unknown_input_observer)] if self.plant.disturbances else []),
        ]

    def __str__(self) -> str:
        width = max([len("fault"), *(len(name) for name in self.faults)])
        lines = [
            f"{self.plant.name}: {self.plant.n_states} states, {self.plant.n_outputs} outputs, "
            f"{len(self.plant.disturbances)} disturbances to decouple",
            f"{'fault':<{width}}  {'kind':<9}  detectable  when constant  cannot be told from",
        ]
        for i, name in enumerate(self.faults):
            twins = [o for g in self.groups if name in g for o in g if o != name]
            lines.append(
                f"{name:<{width}}  {self.plant.fault_kinds[i]:<9}  {_yes(self.detectable[i]):<10}  "
                f"{_yes(self.strongly_detectable[i]):<13}  {', '.join(twins) or '-'}"
            )
        lines += [f"{name}: {why}" for name, why in self.reasons().items()]
        if self.plant.disturbances:
            lines.append(str(self.unknown_input_observer))
        return "\n".join(lines)


def diagnosability(plant: Plant, *, rtol: float = DEFAULT_RTOL) -> Diagnosability:
    r"""Tell which faults can be detected and which can be isolated from each other, before any design.

    A fault ``i`` is detectable when :math:`\operatorname{rank}\begin{bmatrix} A-sE & B_d & b_i\\ C & D_d & d_i
    \end{bmatrix}` exceeds the rank without its column for almost every ``s``; it can be told from fault ``j``
    when that holds with fault ``j`` among the disturbances. A constant fault is seen for good when the same
    holds in the limit at ``s = 0`` (``z = 1``).

    Parameters
    ----------
    plant : Plant
        ``E`` may be singular.
    rtol : float
        Relative tolerance of the rank decisions. A fault is seen when more than ``10 * rtol`` of its direction
        (and more than rounding) is left; two are isolable when their angle exceeds 1e-7.

    Returns
    -------
    Diagnosability
        Prints as a table.

    Raises
    ------
    ModelError
        If the plant has no faults, or ``det(sE - A)`` is zero for every ``s``.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, one fault is there at a time, and disturbances may be
    any signals. Noise is not considered: an isolation that is possible in principle may take long in noise.

    The pencil is evaluated at a few fixed points; what the disturbances leave of each fault's column is its
    projection on the left null space there. At ``s = 0`` (``z = 1``) a zero of the plant enlarges the null space at
    that one point: of it the part counts that goes on around the point, which power series tell. Of a plant of up to
    24 states and channels whose numbers have at most 32 binary digits all ranks are those of rational numbers, unless
    ``rtol`` is wider than its default; what is seen may be less than rounding leaves to any filter then.

    References
    ----------
    Gertler (1991), eq. (4-3); Chen, Patton and Zhang (1996), section 3; the rank tests are those
    of the unknown input observer with one fault as disturbance.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.Plant([[-1, 0], [1, -2]], [[1], [0]], [[1, 0], [0, 1]], outputs=["a", "b"])
    >>> result = rs.diagnosability(plant.with_actuator_faults().with_faults({"leak": [2, 0], "clog": [0, 1]}))
    >>> result.groups
    (('u1 actuator', 'leak'), ('clog',))
    """
    check_rtol(rtol)
    if not plant.faults:
        raise ModelError(
            "the plant has no faults: name what may fail with with_sensor_faults, with_actuator_faults or with_faults"
        )
    model = in_canonical_units(plant)
    points = generic_points(model)
    check_regular(model, points)
    generic = visible_columns(model, points, rtol)
    if are_rational(model, rtol):
        detectable, isolable = _ranks(rational_columns(model))
        strong, strongly_isolable = _ranks(rational_limit_columns(model))
    else:
        detectable, isolable = _decide(generic, rtol)
        strong, strongly_isolable = _decide(limit_columns(model, rtol, generic.rank), rtol)
    strong &= detectable
    strongly_isolable &= isolable
    return Diagnosability(
        plant=plant,
        faults=plant.faults,
        detectable=detectable,
        strongly_detectable=strong,
        isolable=isolable,
        strongly_isolable=strongly_isolable,
        groups=group_twins(plant.faults, detectable, isolable),
        visibility=np.linalg.norm(generic.columns, axis=1).max(axis=0),
        unknown_input_observer=unknown_input_observer_existence(plant, rtol=rtol),
    )


def group_twins(
    faults: tuple[str, ...], present: NDArray[np.bool_], isolable: NDArray[np.bool_]
) -> tuple[tuple[str, ...], ...]:
    """Return the faults in groups whose members look the same; absent ones are left out."""
    groups: list[list[int]] = []
    for i in np.flatnonzero(present):
        for group in groups:
            if not isolable[group[0], i] and not isolable[i, group[0]]:
                group.append(int(i))
                break
        else:
            groups.append([int(i)])
    return tuple(tuple(faults[i] for i in group) for group in groups)


def _decide(seen: Visible, rtol: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return who is visible and who is isolable from whom, the best over the test points."""
    size = np.linalg.norm(seen.columns, axis=1)
    floor = np.maximum(seen.rounding, 10 * rtol)[:, None]
    visible = (size > floor).any(axis=0)
    sines = _sines(seen.columns)
    weaker = np.maximum(np.minimum(size[:, :, None], size[:, None]), TINY)
    limit = np.clip(10 * floor[:, :, None] / weaker, 1e-7, 1e-2)
    apart = (sines > limit).any(axis=0)
    return visible, visible[:, None] & (apart | ~visible[None, :]) & ~np.eye(len(visible), dtype=bool)


def _ranks(seen: RationalColumns) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return who is visible and who is isolable from whom, in rational numbers."""
    return seen.present, seen.isolable()


def _sines(columns: NDArray) -> NDArray[np.float64]:
    """Return the sine of the angle between every two columns at every point, shape (points, faults, faults)."""
    unit = columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), TINY)
    out = np.zeros((len(columns), columns.shape[2], columns.shape[2]))
    for k, U in enumerate(unit):
        cosines = U.conj().T @ U
        for j in range(U.shape[1]):
            out[k, :, j] = np.linalg.norm(U - np.outer(U[:, j], cosines[j]), axis=0)
    return out


def _yes(value: bool | np.bool_) -> str:
    return "yes" if value else "no"
