"""Residual rows that are left eigenvectors of the error equation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.design.detection_filters.directional_gain import hidden_modes, share_poles
from residua.design.detection_filters.ignored_columns import IgnoredColumns
from residua.errors import DesignError
from residua.linear.poles.observer_gain import ObserverGain, observer_gain
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.subspaces.detection_space import complement
from residua.linear.subspaces.quotient import observable_split, without_rounding
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.tolerances import BALANCED_RANK, TINY

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LeftRows:
    """Rows ``S`` with ``H = S C``, whose products ``H A`` are rows of ``C`` too, or nearly.

    Attributes
    ----------
    moving : ndarray, shape (k, outputs that are used)
        Rows with orthonormal ``S C``.
    still : ndarray
        Rows with ``S C = 0``: measurements that repeat one another.
    exact : bool
        Whether ``h A`` is a row of ``C``.
    ranks : dict of str to RankDecision
    """

    moving: Matrix
    still: Matrix
    exact: bool
    ranks: dict[str, RankDecision]


def left_rows(parts: IgnoredColumns, *, approximate: bool) -> LeftRows:
    r"""Return all rows ``s`` with :math:`s C F_Z = 0` for which ``s C A`` is a row of ``C``, or the nearest one.

    Both conditions are linear in ``s``: :math:`s\,[C F_Z,\ C A N] = 0` with ``N`` a basis of the null space of ``C``.
    As ``h = s C`` is a row of ``C`` itself, the eigenvalue does not matter.
    """
    A, C = parts.pair.A, parts.pair.C
    blind, _ = _left_null(C @ parts.stacked)
    if not len(blind):
        raise DesignError(
            f"no residual row is blind to {parts.text}: C F has rank {len(C)}, as many as measurements are left; "
            "add a sensor or ignore less"
        )
    U, sizes, Vh = np.linalg.svd(blind @ C)
    k = int(np.count_nonzero(sizes > BALANCED_RANK))
    still, H = without_rounding(U[:, k:].T @ blind), Vh[:k]  # every h of length one is a combination of the rows of H
    N = _left_null(C.T)[0].T
    rows, decision = _left_null(H @ A @ N)
    ranks = {"rank C": decide_rank(C, rtol=BALANCED_RANK, scale=1.0)}
    exact = bool(len(rows)) or not k
    if not exact:
        rows = np.linalg.svd(H @ A @ N)[0][:, [min(N.shape[1], k) - 1]].T  # the smallest singular value
    h = rows @ H
    ranks["rank [C; h A]"] = decide_rank(np.vstack([C, h @ A]), rtol=BALANCED_RANK, scale=1.0)
    if exact:
        ranks["h A off the rows of C"] = decision
    elif not approximate:
        raise _not_implementable(parts, h, ranks, bool(len(still)))
    return LeftRows(without_rounding(rows @ (U[:, :k].T / sizes[:k, None]) @ blind), still, exact, ranks)


def _left_null(M: Matrix) -> tuple[Matrix, RankDecision]:
    """Return rows that annihilate a balanced matrix."""
    decision = decide_rank(M, rtol=BALANCED_RANK, scale=1.0)
    return without_rounding(np.linalg.svd(M)[0][:, decision.rank :].T), decision


def _not_implementable(parts: IgnoredColumns, h: Matrix, ranks: dict[str, RankDecision], repeated: bool) -> DesignError:
    A, plain = parts.pair.A, (h @ parts.pair.inverse / parts.pair.model.units.states).ravel()
    distance = float(np.linalg.norm(h @ A @ _left_null(parts.pair.C.T)[0].T) / max(np.linalg.norm(h @ A), TINY))
    plain = plain / plain[np.argmax(np.abs(plain) > 1e-9 * np.abs(plain).max())]
    return DesignError(
        f"no left eigenvectors: no row h = s C with h F = 0 for {parts.text} has h A among the rows of C, whatever the "
        f"eigenvalue: rank [C; h A] = {ranks['rank [C; h A]'].rank} > rank C = {ranks['rank C'].rank} for the nearest, "
        f"h = [{', '.join(f'{x:.4g}' for x in plain)}], {distance:.3g} of whose h A lies outside; use side='right' or "
        "decoupled_residual, or approximate=True"
        + ("; what measurements that repeat one another show needs no observer" if repeated else "")
    )


def left_gain(parts: IgnoredColumns, rows: LeftRows, poles: Any, margin: float | None, first: float) -> ObserverGain:
    r"""Return a gain with :math:`H (A - K C) = \Lambda H`, the other poles placed on the null space of ``H``.

    :math:`H K C = H A - \Lambda H` fixes ``H K``; what is left of the gain acts inside the null space ``N`` of ``H``,
    where :math:`(C N, N^T A N)` is observable if the plant is: :math:`N^T H^T = 0`, so that what ``H K`` fixes does
    not reach it.
    """
    pair, rate = parts.pair, parts.pair.model.units.rate
    A, C, H = pair.A, pair.C, rows.moving @ pair.C
    k, N = len(H), complement(H.T)
    A2, C2 = without_rounding(N.T @ A @ N), without_rounding(C @ N)
    split, fixed = observable_split(A2, C2), hidden_modes(A2, C2)
    shares = share_poles(poles, [("left",)], [k, split.seen.shape[1]], fixed, rate)
    share = np.full(k, first, dtype=complex) if shares[0] is None else shares[0]
    target = share[0].real * np.eye(k) if len(set(share.tolist())) == 1 else real_block_diagonal(share)
    K_left = H.T @ (H @ A - target @ H) @ np.linalg.pinv(C, rcond=BALANCED_RANK)
    rest = observer_gain(
        A2,
        C2,
        split,
        sampled=pair.model.plant.is_discrete,
        process=np.eye(len(A2)),
        measurement=np.eye(len(C)),
        poles=shares[1],
        margin=margin,
        rate=rate,
    )
    return replace(
        rest,
        K=pair.on_outputs(K_left + N @ rest.K),
        requested=np.concatenate([share, rest.requested]),
        fixed=fixed,
    )
