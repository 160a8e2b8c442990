"""A gain that makes ignored columns right eigenvectors of the error equation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.detection_filters.directional_gain import DirectionalGain, FaultEvent, Poles, block_gain
from residua.design.detection_filters.ignored_columns import Frame, IgnoredColumns
from residua.errors import DesignError
from residua.linear.poles.spectrum import describe_modes
from residua.linear.poles.stability import is_stable_mode
from residua.linear.subspaces.detection_space import (
    DetectionSpace,
    conditioned_invariant_basis,
    detection_space,
    separation,
    split_blocks,
)
from residua.linear.subspaces.observability import detectability
from residua.linear.subspaces.rank import left_null_basis, range_basis, spectral_norm
from residua.linear.subspaces.reachability import reachable_basis
from residua.tolerances import TINY, above_rounding
from residua.words import unit_of_rates


@dataclass(frozen=True, eq=False)
class Confinement:
    """Invariant subspaces that hold the ignored columns, one for each, or one for all together.

    Attributes
    ----------
    events : list of FaultEvent
        With the invariant subspaces: chains ``f, A f, ...``, or one larger space.
    hidden : ndarray, shape (n, k)
        Orthonormal basis of all that the residual does not see: these spaces, and their zeros.
    chains : bool
        Whether each column has a chain of its own: it is a right eigenvector, or the head of a chain of them.
    note : str
    """

    events: list[FaultEvent]
    hidden: NDArray[np.float64]
    chains: bool
    note: str = ""


def confinements(parts: IgnoredColumns, *, combine: bool, rtol: float) -> tuple[NDArray[np.float64], list[Confinement]]:
    r"""Return the rows ``S0`` that do not see the ignored columns, and the ways to keep these columns from them.

    The smallest space ``V`` that a gain can make invariant and that holds the columns is :math:`f, A f, \dots,
    A^\mu f` for each, with :math:`C A^\mu f` the first that is not zero. Where the vectors :math:`C A^\mu f` are
    independent each column has its chain; otherwise there is one space for all. ``S0`` annihilates :math:`C V`.
    With ``combine`` the space in which also the invariant zeros of the columns are free is another way.
    """
    A, C = parts.A, parts.C
    scale = spectral_norm(C)
    together = conditioned_invariant_basis(A, C, parts.stacked, rtol=rtol)
    outputs, _ = range_basis(C @ together, rtol=rtol, scale=scale)
    S0 = (left_null_basis(outputs)[0] if outputs.shape[1] else np.eye(len(C))).T
    if not len(S0):
        raise DesignError(
            f"no residual ignores {parts.text}: rank(S C) must be less than the {len(C)} measurements that are left, "
            f"and C V, the outputs of their columns and of the chains that these start, has rank {outputs.shape[1]}; "
            "add a sensor or ignore less"
        )
    hidden = detection_space(A, C, parts.stacked, rtol=rtol) if parts.columns else _unseen(A, C, rtol)
    ways: list[Confinement] = []
    events = _chains(parts, scale, rtol)
    spaces = [event.space for event in events]
    if not spaces or separation(spaces).separable:
        long = [" or ".join(e.faults) for e in events if e.space.dimension > 1]
        note = f"C f = 0: eigenvector chains f, A f, ... for {', '.join(long)}" if long else ""
        ways.append(Confinement(events, hidden.basis, True, note))
    elif outputs.shape[1]:
        note = (
            f"the outputs of the {len(events)} columns are dependent (rank {outputs.shape[1]}): they lie in one "
            f"invariant space of dimension {together.shape[1]}, of which they are no eigenvectors"
        )
        ways.append(Confinement([_all(parts, DetectionSpace(together, outputs))], hidden.basis, False, note))
    if combine and outputs.shape[1] and hidden.dimension > together.shape[1]:
        note = (
            f"the ignored columns are combinations of {hidden.dimension} eigenvectors (5-5), so that their "
            "invariant zeros are no fixed poles"
        )
        ways.append(Confinement([_all(parts, hidden)], hidden.basis, False, note))
    return S0, ways


def _unseen(A: NDArray, C: NDArray, rtol: float) -> DetectionSpace:
    """Return the states that no output sees: what is hidden when nothing is ignored."""
    seen = reachable_basis(A.T, C.T, rtol=rtol)
    return DetectionSpace(left_null_basis(seen)[0] if seen.shape[1] else np.eye(len(A)), np.zeros((len(C), 0)))


def _all(parts: IgnoredColumns, space: DetectionSpace) -> FaultEvent:
    return FaultEvent((*parts.columns, "ignored"), space)


def _chains(parts: IgnoredColumns, scale: float, rtol: float) -> list[FaultEvent]:
    """Return the chain of each column; columns that are parallel share one, and those that no output sees have none."""
    events: list[tuple[list[str], NDArray, DetectionSpace]] = []
    for name, f in parts.columns.items():
        twin = next((e for e in events if abs(abs(float((e[1].T @ f)[0, 0])) - 1) < 1e-14), None)
        if twin is not None:
            twin[0].append(name)
            continue
        chain = conditioned_invariant_basis(parts.A, parts.C, f, rtol=rtol)
        seen, _ = range_basis(parts.C @ chain, rtol=rtol, scale=scale)
        if seen.shape[1]:
            events.append(([name], f, DetectionSpace(chain, seen)))
    return [FaultEvent(tuple(names), space) for names, _, space in events]


def fixed_poles(parts: IgnoredColumns, confined: Confinement, *, rtol: float) -> NDArray[np.complex128]:
    """Return the poles that no gain moves once the spaces are invariant: invariant zeros of the ignored columns.

    And modes that no output sees, whether they are in a space or not.
    """
    blocks = split_blocks(parts.A, parts.C, [event.space for event in confined.events], rtol=rtol)
    return np.concatenate([_modes_unseen(parts, *pair) for pair in (*blocks.pairs, blocks.rest)])


def _modes_unseen(parts: IgnoredColumns, A: NDArray, C: NDArray) -> NDArray[np.complex128]:
    return detectability(A, C, dt=parts.plant.dt).unobservable_modes


def right_gain(
    parts: IgnoredColumns,
    confined: Confinement,
    poles: Poles,
    margin: float | None,
    distance: float,
    first: float,
    *,
    rtol: float,
) -> DirectionalGain:
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
    distance : float
        The margin beyond which the poles that ``poles`` leaves open are placed.
    first : float
        The eigenvalue of columns for which ``poles`` has none.
    rtol : float

    Raises
    ------
    DesignError
        If a pole is fixed that is not stable, or slower than the margin.
    """
    dt = parts.plant.dt
    fixed = fixed_poles(parts, confined, rtol=rtol)
    bad = fixed[~is_stable_mode(fixed, dt, margin or 0.0)]
    if len(bad):
        which = "not stable" if margin is None else f"not stable with the margin {margin * unit_of_rates():g}"
        unseen = _modes_unseen(parts, parts.A, parts.C)
        slow = unseen[~is_stable_mode(unseen, dt, margin or 0.0)]
        if len(slow):
            raise DesignError(
                f"the mode {describe_modes(slow)}, which the measurements that are left do not see, is a fixed pole, "
                f"and {which}; add a sensor, ask for a smaller margin, or use decoupled_residual, which observes only "
                "what it needs"
            )
        raise DesignError(
            f"the invariant zero {describe_modes(bad)} of the columns of {parts.text} is a fixed pole once they are "
            f"eigenvectors, and {which}; allow combine=True, or use decoupled_residual, whose poles are all free"
        )
    if confined.chains and (poles is None or isinstance(poles, Mapping)):
        by_fault = {} if poles is None else dict(poles)
        for event in confined.events:
            if not set(event.faults) & set(by_fault):
                by_fault[event.faults[0]] = [first] * event.space.dimension
        poles = by_fault
    return block_gain(parts.A, parts.C, confined.events, poles, distance, dt, rtol=rtol)


def column_error(parts: IgnoredColumns, confined: Confinement, S0: NDArray, K0: NDArray) -> float:
    """Return how far the spaces of the columns, and all that is hidden, are from being invariant and unseen.

    Relative to the terms of ``A0 - K0 C0`` and of ``S0 C0``.
    """
    worst = 0.0
    for V in (*(event.space.basis for event in confined.events), confined.hidden):
        seen = parts.C @ V
        image = parts.A @ V - K0 @ seen
        terms = np.abs(parts.A) @ np.abs(V) + np.abs(K0) @ np.abs(seen)
        off = image - V @ (V.T @ image)
        worst = max(worst, _ratio(off, terms), _ratio(S0 @ seen, np.abs(S0) @ np.abs(parts.C)))
    return worst


def _ratio(off: NDArray, terms: NDArray) -> float:
    return float(np.abs(off).max(initial=0.0) / max(float(terms.max(initial=0.0)), TINY))


def right_frame(parts: IgnoredColumns, confined: Confinement) -> Frame:
    """Return orthogonal coordinates whose last ones are what the residual does not see."""
    V = confined.hidden
    R = left_null_basis(V)[0] if V.shape[1] else np.eye(len(V))
    for _ in range(2):  # what rounding left of the columns in R would be a response to them
        R = R - parts.stacked @ (np.linalg.pinv(parts.stacked) @ R)
        R = above_rounding(R, np.abs(R).max(axis=0, initial=0.0))
    return Frame(np.hstack([R, V]).T, np.hstack([R, V]), R.shape[1])
