"""The choice of a good coding set for a plant, among all that are attainable."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import comb, isfinite

import numpy as np
from numpy.typing import NDArray

from residua import arrays
from residua.analysis.attainability import MOST_ROWS, all_rows
from residua.analysis.codes import equal_codes, strongly_isolating
from residua.analysis.coding_sets import CodingSet
from residua.analysis.cover import Cover, Found, even_cover, far_cover, fewest
from residua.analysis.fault_space import FaultSpace, fault_space
from residua.errors import DesignError, SettingError
from residua.plant import Plant
from residua.words import counted

#: Seconds that the choice may take, unless the caller says otherwise.
TIME_LIMIT = 30.0
#: Part of the time that is left for the fewest rows; the rest is for even ones, far apart.
_FIRST = 0.75


def choose(
    plant: Plant,
    *,
    quality: str = "strong",
    max_residuals: int | None = None,
    require: Iterable[str | int] | str | None = None,
    ignore: Iterable[str | int] | str = (),
    constant: bool = False,
    time_limit: float = TIME_LIMIT,
    most: int = MOST_ROWS,
) -> CodingSet:
    r"""Choose a coding set for a plant: isolating, with the fewest residuals, as even as possible, its codes far apart.

    Of the attainable rows those are taken that, in this order of importance,

    1. isolate the faults strongly, or weakly where that was asked for or ``max_residuals`` allows no more;
    2. are the fewest;
    3. make the coding set canonical, all codes with as many ones and all rows with as many zeros, or else have the
       smallest sum of both differences between the most and the fewest;
    4. make the smallest number of residuals in which two codes differ as large as possible.

    Exact, by integer programming (HiGHS); what the time limit left unproved is said in ``notes``.

    Parameters
    ----------
    plant : Plant
        Continuous or sampled, ``E`` singular or not.
    quality : {"strong", "weak"}
    max_residuals : int, optional
    require : sequence of str, optional
        Faults that must be isolated from every other one; the rest need only be seen. When omitted, every fault is
        isolated from every other as far as any method can do it.
    ignore : sequence of str
        Faults that all residuals ignore, as if they were disturbances.
    constant : bool
        Whether the residuals must answer for as long as a constant fault lasts.
    time_limit : float
        Seconds for all of it, from the list of attainable rows to the last program; what is left when that list is
        there goes to the search, which always takes at least a first choice.
    most : int
        Attainable rows to choose from at most.

    Returns
    -------
    CodingSet
        As :func:`residua.design.structured_bank` takes it. Faults that no method tells apart share a code
        (``inseparable``), those that no method sees have none (``undetectable``).

    Raises
    ------
    DesignError
        If no residual sees any fault, a required fault cannot be isolated by any method, or ``max_residuals`` are too
        few; with the least number that is enough.

    Notes
    -----
    Assumes: the model is exact, linear and time-invariant, and one fault is there at a time.

    A strongly isolating set always exists for the faults that can be isolated: the rows that each ignore one of them
    see all others. It takes at least so many residuals ``s`` that :math:`\binom{s}{\lfloor s/2 \rfloor}` is no less
    than the number of faults (Sperner).

    References
    ----------
    Gertler (1991), section 4.

    Examples
    --------
    >>> import residua as rs
    >>> plant = rs.library.gertler(sensor_faults=True)
    >>> print(rs.coding.choose(plant))
    4 residuals, 4 faults: strongly isolating
         1  2  3  4
    r1   .  x  x  x
    r2   x  .  x  x
    r3   x  x  .  x
    r4   x  x  x  .
      1: p1
      2: p2
      3: y1 sensor
      4: y2 sensor
    codes differ in 2 residuals at least; ones per fault: 3; zeros per residual: 1 (canonical)
    chosen from 5 attainable rows; fewer residuals do not isolate strongly
    """
    begun = time.perf_counter()
    check_choice(quality, max_residuals, time_limit)
    ignored = [plant.faults[j] for j in arrays.positions(ignore, plant.faults, "fault")]
    watched = plant.faults_as_disturbances(ignored)
    space = fault_space(watched)
    rows = all_rows(space, constant, most)
    if not len(rows):
        raise DesignError(
            f"no residual that ignores {', '.join((*plant.disturbances, *ignored)) or 'nothing'} sees any fault"
            + (" for good while it is constant" if constant else "")
        )
    groups = equal_codes(rows)
    names = [tuple(watched.faults[j] for j in group) for group in groups]
    unseen = tuple(name for name, code in zip(watched.faults, rows.T, strict=True) if not code.any())
    required = _required(plant, require, names, unseen, ignored)
    task = ChoiceTask(rows[:, [group[0] for group in groups]], names, required)

    def share(part: float) -> float:
        return part * max(0.0, begun + time_limit - time.perf_counter())

    chosen, notes = _search(task, quality, max_residuals, share, time_limit)
    if not constant:
        notes += _once_constant(space, rows[chosen], most, share)
    if constant:
        notes += ("all of this for residuals that answer for as long as a constant fault lasts",)
    structure = np.zeros((len(chosen), len(plant.faults)), dtype=bool)
    structure[:, [plant.faults.index(name) for name in watched.faults]] = rows[chosen]
    return CodingSet(
        structure,
        plant.faults,
        tuple(f"r{i + 1}" for i in range(len(structure))),
        ignored=tuple(ignored),
        undetectable=unseen,
        inseparable=tuple(group for group in names if len(group) > 1),
        notes=notes,
    )


def check_choice(quality: str, max_residuals: int | None, time_limit: float) -> None:
    """Raise for settings that make no sense."""
    if quality not in ("strong", "weak"):
        raise SettingError(f"quality must be 'strong' or 'weak', got {quality!r}")
    if max_residuals is not None and (
        isinstance(max_residuals, bool) or not isinstance(max_residuals, (int, np.integer)) or max_residuals < 1
    ):
        raise SettingError(f"max_residuals must be a whole number, at least 1, got {max_residuals!r}")
    if not isinstance(time_limit, (int, float)) or not isfinite(time_limit) or time_limit <= 0:
        raise SettingError(f"time_limit must be a positive number of seconds, got {time_limit!r}")


def _required(
    plant: Plant,
    require: Iterable[str | int] | str | None,
    names: list[tuple[str, ...]],
    unseen: tuple[str, ...],
    ignored: list[str],
) -> set[int]:
    """Return the groups that must be isolated; raises where a fault that was asked for cannot be."""
    if require is None:
        return set(range(len(names)))
    wanted = [plant.faults[j] for j in arrays.positions(require, plant.faults, "fault")]
    out = set()
    for name in wanted:
        if name in ignored:
            raise DesignError(f"'{name}' is to be isolated and to be ignored")
        if name in unseen:
            raise DesignError(f"'{name}' cannot be isolated: no residual sees it that ignores the disturbances")
        (k,) = (k for k, group in enumerate(names) if name in group)
        if len(names[k]) > 1:
            others = ", ".join(other for other in names[k] if other != name)
            raise DesignError(f"'{name}' cannot be isolated: no method distinguishes it from {others}; add a sensor")
        out.add(k)
    return out


@dataclass(frozen=True, eq=False)
class ChoiceTask:
    """Rows to choose from, one column per group of inseparable faults, and the groups that must be isolated."""

    rows: NDArray[np.bool_]
    names: list[tuple[str, ...]]
    required: set[int]

    def pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of groups that must be isolated from each other."""
        n = len(self.names)
        return [(j, k) for j in range(n) for k in range(j + 1, n) if {j, k} & self.required]

    def cover(self, strong: bool) -> tuple[Cover, list[tuple[int, int]]]:
        """Return the demands on the chosen rows, and the pairs ``(j, k)`` with the code of k a part of that of j."""
        R = self.rows
        demands, stuck = [R[:, j] for j in range(R.shape[1])], []
        for j, k in self.pairs():
            one, other = R[:, j] & ~R[:, k], R[:, k] & ~R[:, j]
            if strong and one.any() and other.any():
                demands += [one, other]
            else:
                demands.append(one | other)
                if strong:
                    stuck.append((j, k) if one.any() else (k, j))
        everyone = len(self.required) == R.shape[1]
        least = _least(R.shape[1], strong and not stuck) if everyone else 1
        return Cover(R, np.array(demands, dtype=bool), self.pairs(), strong, least), stuck


def _least(faults: int, strong: bool) -> int:
    """Return the least number of residuals with enough codes."""
    s = 1
    while (comb(s, s // 2) if strong else 2**s - 1) < faults:
        s += 1
    return s


def _search(
    task: ChoiceTask, quality: str, max_residuals: int | None, share: Callable[[float], float], time_limit: float
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the chosen rows in their order, with remarks.

    Every program leaves some time to those that follow it, a ``share`` of the seconds that are left: a limit is met
    only after the step that reaches it.
    """
    strong, remarks = quality == "strong", []
    cover, stuck = task.cover(strong)
    first = fewest(cover, share(0.6 if strong and max_residuals is not None else _FIRST))
    if strong and max_residuals is not None and len(first.chosen) > max_residuals:
        remarks.append(
            f"weakly isolating only: strongly takes {_number(first)} residuals, and no more than {max_residuals} "
            "were allowed"
        )
        strong, stuck = False, []
        cover, _ = task.cover(strong)
        first = fewest(cover, share(_FIRST))
    if max_residuals is not None and len(first.chosen) > max_residuals:
        raise DesignError(
            f"{counted(max_residuals, 'residual')} cannot isolate {counted(len(task.names), 'fault')}, not even "
            f"weakly: that takes {_number(first)}; allow more, or leave faults out with require= or ignore="
        )
    for j, k in stuck:
        remarks.append(
            f"weakly isolating only: no attainable row sees {_group(task, k)} and ignores {_group(task, j)}, so that "
            f"the code of {_group(task, j)} always becomes that of {_group(task, k)} when residuals stay silent"
        )
    chosen = first.chosen
    even = even_cover(cover, chosen, share(0.4))
    far = far_cover(cover, even.chosen, share(0.7))
    notes = [*remarks, _fewest_in_words(task, first, strong and not stuck, time_limit)]
    if even.bound is not None:
        notes.append("the time limit was reached before it was proved that no choice is more even")
    if far.bound is not None:
        notes.append(
            f"the time limit was reached before it was proved that codes cannot differ in up to {far.bound} residuals"
        )
    order = sorted(far.chosen.tolist(), key=lambda i: task.rows[i].tolist())
    return np.array(order, dtype=np.int64), tuple(notes)


def _once_constant(
    space: FaultSpace, rows: NDArray[np.bool_], most: int, share: Callable[[float], float]
) -> tuple[str, ...]:
    """Return a note where strong isolation is lost because constant faults fire fewer residuals than changing ones."""
    if not len(rows) or not strongly_isolating(rows):
        return ()
    later = np.array([row & space.lasting(space.basis(np.flatnonzero(~row))) for row in rows])
    later = later & (later != rows).any(axis=0)
    within = np.asarray((later[:, :, None] <= rows[:, None, :]).all(axis=0))
    within |= np.asarray((later[:, :, None] <= later[:, None, :]).all(axis=0)) & later.any(axis=0)
    same = np.asarray((rows[:, :, None] == rows[:, None, :]).all(axis=0))
    lost = later.any(axis=0) & (within & ~same).any(axis=1)
    if not lost.any():
        return ()
    names = ", ".join(f"'{space.faults[j]}'" for j in np.flatnonzero(lost))
    what = "constant=True chooses residuals that answer for as long as a fault lasts"
    if share(1.0):
        code = all_rows(space, True, most).T.astype(int)
        apart = np.asarray(code @ (1 - code.T) > 0)  # [j, k]: some row sees j and ignores k
        seen = np.asarray(rows.any(axis=0))
        others = ~same & seen & seen[:, None]
        what += ", and isolates strongly" if apart[others].all() else "; not even these can isolate strongly"
    return (
        f"once constant, {names} may fire fewer of these residuals, and the codes do not isolate strongly then: {what}",
    )


def _number(cover: Found) -> str:
    if cover.bound is None:
        return f"{len(cover.chosen)}"
    return f"{cover.bound} to {len(cover.chosen)} (the time limit was reached)"


def _fewest_in_words(task: ChoiceTask, cover: Found, strong: bool, time_limit: float) -> str:
    """Return whether the number of residuals is the fewest."""
    rows = counted(len(task.rows), "attainable row")
    if cover.bound is not None:
        return (
            f"chosen from {rows}; between {cover.bound} and {len(cover.chosen)} residuals are the fewest: the time "
            f"limit of {time_limit:g} s was reached before that was decided"
        )
    everyone = len(task.required) == len(task.names)
    aim = f"isolate {'strongly' if strong else 'weakly'}" if everyone else "do that"
    return f"chosen from {rows}; fewer residuals do not {aim}"


def _group(task: ChoiceTask, j: int) -> str:
    return " or ".join(f"'{name}'" for name in task.names[j])
