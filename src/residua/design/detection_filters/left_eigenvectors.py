"""Residual rows that are left eigenvectors of the error equation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.design.detection_filters.directional_gain import hidden_modes, share_poles
from residua.design.detection_filters.ignored_columns import IgnoredColumns, require_detectable
from residua.design.observers.observer_gain import pair_gain
from residua.errors import DesignError
from residua.linear.poles.observer_gain import ObserverGain
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.subspaces.detection_space import complement
from residua.linear.subspaces.quotient import observable_split, without_rounding
from residua.linear.subspaces.rank import RankDecision, decide_rank
from residua.tolerances import BALANCED_RANK, TINY

Matrix = NDArray[np.float64]


def left_design(
    parts: IgnoredColumns, poles: Any, margin: float | None, first: float, *, approximate: bool
) -> tuple[Matrix, Matrix | None, ObserverGain, str, dict[str, RankDecision]]:
    r"""Return residual rows, what they see if they are exact, a gain that makes them eigenvectors, a note, and ranks.

    All rows ``s`` with :math:`s C F_Z = 0` for which ``s C A`` is a row of ``C``, or the nearest one. Both conditions
    are linear in ``s``: :math:`s\,[C F_Z,\ C A N] = 0` with ``N`` a basis of the null space of ``C``. As ``h = s C``
    is a row of ``C`` itself, the eigenvalue does not matter. Rows with ``s C = 0``, measurements that repeat one
    another, need no observer.

    :math:`H (A - K C) = \Lambda H` fixes ``H K``, :math:`H K C = H A - \Lambda H`; what is left of the gain acts
    inside the null space ``N`` of ``H``, where :math:`(C N, N^T A N)` is observable if the plant is:
    :math:`N^T H^T = 0`, so that what ``H K`` fixes does not reach it.
    """
    pair, A, C = parts.pair, parts.pair.A, parts.pair.C
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
    exact = bool(len(rows)) or not k
    if not exact:
        rows = np.linalg.svd(H @ A @ N)[0][:, [min(N.shape[1], k) - 1]].T  # the smallest singular value
    h = rows @ H
    reading = (decide_rank(M, rtol=BALANCED_RANK, scale=1.0) for M in (C, np.vstack([C, h @ A])))
    ranks = dict(zip(("rank C", "rank [C; h A]"), reading, strict=True))
    if exact:
        ranks["h A off the rows of C"] = decision
    elif not approximate:
        raise _not_implementable(parts, h, ranks, bool(len(still)))
    require_detectable(parts)
    S = without_rounding(rows @ (U[:, :k].T / sizes[:k, None]) @ blind)
    H = S @ C
    k, N = len(H), complement(H.T)
    A2, C2 = without_rounding(N.T @ A @ N), without_rounding(C @ N)
    split, fixed = observable_split(A2, C2), hidden_modes(A2, C2)
    shares = share_poles(poles, [("left",)], [k, split.seen.shape[1]], fixed, pair.model.units.rate)
    share = np.full(k, first, dtype=complex) if shares[0] is None else shares[0]
    target = share[0].real * np.eye(k) if len(set(share.tolist())) == 1 else real_block_diagonal(share)
    K = H.T @ (H @ A - target @ H) @ np.linalg.pinv(C, rcond=BALANCED_RANK)
    rest = pair_gain(pair.model, A2, C2, (np.eye(len(A2)), np.eye(len(C))), shares[1], margin, split=split)
    K, requested = pair.on_outputs(K + N @ rest.K), np.concatenate([share, rest.requested])
    gain = replace(rest, K=K, requested=requested, fixed=fixed)
    note = "" if exact else "approximate: h A is no row of C, what is ignored leaks"
    return np.vstack([S, still]), H.T if exact else None, gain, note, ranks


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
