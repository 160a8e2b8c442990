"""A gain that makes ignored columns right eigenvectors of the error equation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.design.detection_filters.directional_gain import (
    FaultEvent,
    block_gain,
    hidden_modes,
)
from residua.design.detection_filters.ignored_columns import IgnoredColumns
from residua.errors import DesignError
from residua.linear.poles.observer_gain import ObserverGain
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.detection_space import (
    are_independent,
    confined_space,
    split_blocks,
)
from residua.linear.subspaces.quotient import quotient

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Confinement:
    """Invariant subspaces that hold the ignored columns, one for each, or one for all together.

    Attributes
    ----------
    events : list of FaultEvent
        With the invariant subspaces: chains ``f, A f, ...``, or one larger space.
    chains : bool
        Whether each column has a chain of its own: it is a right eigenvector, or the head of a chain of them.
    note : str
    """

    events: list[FaultEvent]
    chains: bool
    note: str = ""


def confinements(parts: IgnoredColumns, *, combine: bool) -> tuple[Matrix, Matrix, list[Confinement]]:
    r"""Return the rows that do not see the ignored columns, what they see, and the ways to keep the columns from them.

    The smallest space ``V`` that a gain can make invariant and that holds the columns is :math:`f, A f, \dots,
    A^\mu f` for each, with :math:`C A^\mu f` the first that is not zero. Where the vectors :math:`C A^\mu f` are
    independent each column has its chain; otherwise there is one space for all. The rows annihilate :math:`C V`, and
    see the states that are no part of the space in which also the invariant zeros of the columns are free: with
    ``combine`` that is another way.
    """
    A, C = parts.pair.A, parts.pair.C
    q = quotient(A, parts.stacked, C, np.zeros((len(C), len(parts.columns))))
    together, whole = (confined_space(A, C, parts.stacked, zeros=zeros) for zeros in (False, True))
    rank = together.outputs.shape[1]
    if not len(q.H):
        raise DesignError(
            f"no residual ignores {parts.text}: rank(S C) must be less than the {len(C)} measurements that are left, "
            f"and C V, the outputs of their columns and of the chains that these start, has rank {rank}; "
            "add a sensor or ignore less"
        )
    chains: list[tuple[Matrix, FaultEvent]] = []  # parallel columns share one, and those that no output sees have none
    for name, f in parts.columns.items():
        twin = next((k for k, (g, _) in enumerate(chains) if abs(abs(float((g.T @ f)[0, 0])) - 1) < 1e-14), None)
        if twin is not None:
            g, event = chains[twin]
            chains[twin] = g, replace(event, faults=(*event.faults, name))
        elif (space := confined_space(A, C, f, zeros=False)).outputs.shape[1]:
            chains.append((f, FaultEvent((name,), space)))
    events, everything = [event for _, event in chains], (*parts.columns, "ignored")
    ways: list[Confinement] = []
    if not events or all(
        are_independent([getattr(event.space, part) for event in events]) for part in ("outputs", "basis")
    ):
        long = [" or ".join(e.faults) for e in events if e.space.dimension > 1]
        note = f"C f = 0: eigenvector chains f, A f, ... for {', '.join(long)}" if long else ""
        ways.append(Confinement(events, True, note))
    elif rank:
        note = (
            f"the outputs of the {len(events)} columns are dependent (rank {rank}): they lie in one "
            f"invariant space of dimension {together.dimension}, of which they are no eigenvectors"
        )
        ways.append(Confinement([FaultEvent(everything, together)], False, note))
    if combine and rank and whole.dimension > together.dimension:
        note = (
            f"the ignored columns are combinations of {whole.dimension} eigenvectors (5-5), so that their "
            "invariant zeros are no fixed poles"
        )
        ways.append(Confinement([FaultEvent(everything, whole)], False, note))
    return q.H, (q.split.seen.T @ q.N).T, ways


def right_gain(
    parts: IgnoredColumns, confined: Confinement, poles: Any, margin: float | None, first: float
) -> ObserverGain:
    r"""Return a gain with every chain invariant: :math:`K C A^\mu f = p(A) f` with the polynomial of its poles.

    For a column that the outputs see, :math:`\mu = 0`, this is :math:`K C f = A f - \lambda f`, equation (5-7) of the
    detection filter with :math:`v = f`.

    Parameters
    ----------
    parts : IgnoredColumns
    confined : Confinement
    poles : sequence, or mapping of name to poles, or None
    margin : float or None
        The margin that was asked for.
    first : float
        The eigenvalue of columns for which ``poles`` has none.

    Raises
    ------
    DesignError
        If a pole is fixed that is not stable, or slower than the margin.
    """
    pair = parts.pair
    rate, dt = pair.model.units.rate, float(pair.model.plant.is_discrete)
    blocks = split_blocks(pair.A, pair.C, [event.space for event in confined.events])
    slow, unseen = (
        modes[~is_stable_mode(modes, dt, margin or 0.0)]
        for modes in (np.concatenate([hidden_modes(*one) for one in blocks.pairs]), hidden_modes(pair.A, pair.C))
    )
    if len(slow):
        per_second = 1 / pair.model.plant.dt if dt else rate
        which = "not stable" if margin is None else f"not stable with the margin {margin * per_second:g}"
        if len(unseen):
            raise DesignError(
                f"the mode {describe_modes(rate * unseen)}, which the measurements that are left do not see, is a "
                f"fixed pole, and {which}; add a sensor, ask for a smaller margin, or use decoupled_residual, which "
                "observes only what it needs"
            )
        raise DesignError(
            f"the invariant zero {describe_modes(rate * slow)} of the columns of {parts.text} is a fixed pole once "
            f"they are eigenvectors, and {which}; allow combine=True, or use decoupled_residual, whose poles are all "
            "free"
        )
    if confined.chains and (poles is None or isinstance(poles, Mapping)):
        own = {
            event.faults[0]: [first] * event.space.dimension
            for event in confined.events
            if not set(event.faults) & set(poles or {})
        }
        poles = {**(poles or {}), **own}
    return block_gain(pair, confined.events, None, poles, margin)
