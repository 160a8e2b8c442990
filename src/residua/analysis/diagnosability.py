"""Detectable and isolable faults of a plant, before any design."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.analysis.existence import UnknownInputExistence, unknown_input_observer_existence
from residua.analysis.fault_space import FaultSpace, fault_space
from residua.errors import ModelError
from residua.linear.subspaces.rank import RankDecision
from residua.plant import Plant
from residua.shown import Shown, grid, notes, table
from residua.tolerances import BALANCED_ANSWER
from residua.words import counted


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosability(Shown):
    """Detectability and isolability of the faults of a plant by residuals, whatever the method.

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
        The evidence: how strongly each fault, balanced, drives what residuals see that ignore the disturbances.
    near : tuple of RankDecision
        Rank decisions that double precision hardly allows; empty where all are clear.
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
    near: tuple[RankDecision, ...]
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
                out[name] = fault_space(self.plant).why_unseen(i)
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
        if self.near:
            lines.append(f"near: {self.near[0]}; double precision hardly decides this rank")
        return "\n".join(lines)


def diagnosability(plant: Plant) -> Diagnosability:
    r"""Find the faults that can be detected and those that can be isolated from each other, before any design.

    A fault ``i`` is detectable when :math:`\operatorname{rank}\begin{bmatrix} A-sE & B_d & b_i\\ C & D_d & d_i
    \end{bmatrix}` exceeds the rank without its column for almost every ``s``; it can be told from fault ``j``
    when that holds with fault ``j`` among the disturbances. A constant fault is seen for good when the same
    holds in the limit at ``s = 0`` (``z = 1``).

    Parameters
    ----------
    plant : Plant
        ``E`` may be singular.

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

    The balanced plant is divided by what the disturbances reach unseen. A fault is seen if it drives the observable
    part of what is left by more than 1e-8; a coupling below 1e-11 of the balanced plant counts as none, and one within
    a factor of 1000 of that is ``near``.

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
    if not plant.faults:
        raise ModelError(
            "the plant has no faults: name what may fail with with_sensor_faults, with_actuator_faults or with_faults"
        )
    space = fault_space(plant)
    detectable = space.visible
    isolable = np.array([~space.closure([j]) for j in range(len(plant.faults))]).T & detectable[:, None]
    strong = space.lasting([])
    return Diagnosability(
        plant=plant,
        faults=plant.faults,
        detectable=detectable,
        strongly_detectable=strong,
        isolable=isolable,
        strongly_isolable=isolable & strong[:, None] & _apart(space, strong),
        groups=group_twins(plant.faults, detectable, isolable),
        visibility=space.drive([]),
        near=space.model.quotient().near,
        unknown_input_observer=unknown_input_observer_existence(plant),
    )


def _apart(space: FaultSpace, lasting: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whose lasting trace, ``[i, j]``, is no multiple of whose."""
    traces = space.limit([])
    size = np.linalg.norm(traces, axis=0)
    unit = np.where(lasting, traces / np.where(size > 0, size, 1.0), 0.0)
    return np.array([np.linalg.norm(unit - np.outer(one, one @ unit), axis=0) > BALANCED_ANSWER for one in unit.T]).T


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


def _yes(value: bool | np.bool_) -> str:
    return "yes" if value else "no"
