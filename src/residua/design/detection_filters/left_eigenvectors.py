"""Residual rows that are left eigenvectors of the error equation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from residua.design.detection_filters.directional_gain import DirectionalGain, Poles, placed_share, share_poles
from residua.design.detection_filters.ignored_columns import Frame, IgnoredColumns
from residua.errors import DesignError
from residua.linear.poles.pole_assignment import real_block_diagonal
from residua.linear.subspaces.detection_space import inverse_without_rounding
from residua.linear.subspaces.observability import observability_form
from residua.linear.subspaces.rank import RankDecision, decide_rank, left_null_basis, null_basis, spectral_norm
from residua.linear.systems.balancing import without_rounding
from residua.tolerances import TINY, above_rounding


@dataclass(frozen=True, eq=False)
class LeftRows:
    """Rows ``S0`` with ``H = S0 C``, whose products ``H A`` are rows of ``C`` too, or nearly.

    Attributes
    ----------
    moving : ndarray, shape (k, outputs that are used)
        Rows with ``S0 C`` of full row rank.
    H : ndarray, shape (k, n)
        ``S0 C`` of these: the left eigenvectors.
    still : ndarray
        Rows with ``S0 C = 0``: measurements that repeat one another.
    distance : float
        Largest distance of ``h A`` from the rows of ``C``, relative to ``h A``.
    exact : bool
        Whether ``h A`` is a row of ``C``.
    ranks : dict of str to RankDecision
    """

    moving: NDArray[np.float64]
    H: NDArray[np.float64]
    still: NDArray[np.float64]
    distance: float
    exact: bool
    ranks: dict[str, RankDecision]


def left_rows(parts: IgnoredColumns, *, approximate: bool, rtol: float) -> LeftRows:
    r"""Return all rows ``s`` with :math:`s C F_Z = 0` for which ``s C A`` is a row of ``C``, or the nearest one.

    Both conditions are linear in ``s``: :math:`s\,[C F_Z,\ C A N] = 0` with ``N`` a basis of the null space of ``C``.
    As ``h = s C`` is a row of ``C`` itself, the eigenvalue does not matter.
    """
    A, C = parts.A, parts.C
    scale = spectral_norm(C)
    blind = left_null_basis(C @ parts.stacked, rtol=rtol, scale=scale)[0].T if parts.columns else np.eye(len(C))
    if not len(blind):
        raise DesignError(
            f"no residual row is blind to {parts.text}: C F has rank {len(C)}, as many as measurements are left; "
            "add a sensor or ignore less"
        )
    U, sizes, Vh = np.linalg.svd(blind @ C, full_matrices=False)
    k = int(np.count_nonzero(sizes > rtol * scale))
    full = left_null_basis(blind @ C, rtol=rtol, scale=scale)[0].T
    still, H = full @ blind, Vh[:k]  # every h of length one is a combination of the rows of H
    N, rank_C = null_basis(C, rtol=rtol)
    missed = H @ A @ N
    size = spectral_norm(H @ A)
    basis, decision = left_null_basis(missed, rtol=rtol, scale=max(size, TINY))
    rows = basis.T
    ranks = {"rank C": rank_C}
    exact = bool(len(rows)) or not k
    if not exact:
        u, distances, _ = np.linalg.svd(missed)
        rows = u[:, [len(distances) - 1]].T
        h = rows @ H
        ranks["rank [C; h A]"] = decide_rank(np.vstack([C, h @ A]), rtol=rtol)
        distance = float(np.linalg.norm(h @ A @ N) / max(np.linalg.norm(h @ A), TINY))
        if not approximate:
            raise _not_implementable(parts, h, ranks, distance, bool(len(still)))
    else:
        distance = float(np.linalg.norm(rows @ missed)) / max(size, TINY)
        ranks["rank [C; h A]"] = decide_rank(np.vstack([C, rows @ H @ A]), rtol=rtol) if len(rows) else rank_C
        ranks["h A off the rows of C"] = decision
    S0 = rows @ (U[:, :k].T / sizes[:k, None]) @ blind
    S0 = above_rounding(S0, np.abs(S0).max(axis=1, keepdims=True, initial=0.0))
    return LeftRows(S0, without_rounding(S0, C), still, distance, exact, ranks)


def _not_implementable(
    parts: IgnoredColumns, h: NDArray, ranks: dict[str, RankDecision], distance: float, repeated: bool
) -> DesignError:
    plain = (h / parts.states).ravel()
    plain = plain / plain[np.argmax(np.abs(plain) > 1e-9 * np.abs(plain).max())]
    return DesignError(
        f"no left eigenvectors: no row h = s C with h F = 0 for {parts.text} has h A among the rows of C, whatever the "
        f"eigenvalue: rank [C; h A] = {ranks['rank [C; h A]'].rank} > rank C = {ranks['rank C'].rank} for the nearest, "
        f"h = [{', '.join(f'{x:.4g}' for x in plain)}], {distance:.3g} of whose h A lies outside; use side='right' or "
        "decoupled_residual, or approximate=True"
        + ("; what measurements that repeat one another show needs no observer" if repeated else "")
    )


def left_gain(
    parts: IgnoredColumns, rows: LeftRows, poles: Poles, distance: float, first: float, *, rtol: float
) -> DirectionalGain:
    r"""Return a gain with :math:`H (A - K C) = \Lambda H`, the other poles placed on the null space of ``H``.

    :math:`H K C = H A - \Lambda H` fixes ``H K``; what is left of the gain acts inside the null space ``N`` of ``H``,
    where :math:`(C N, N^T A N)` is observable if the plant is: :math:`N^T H^+ = 0`, so that what ``H K`` fixes does
    not reach it.
    """
    A, C, dt = parts.A, parts.C, parts.plant.dt
    H = rows.H
    k, n = H.shape
    inverse = inverse_without_rounding(H) if k else np.zeros((n, 0))
    N = null_basis(H)[0] if k else np.eye(n)
    # Sums that cancel leave exact zeros: what rounding leaves of them would be couplings that poles are placed through.
    A2, C2 = without_rounding(N.T, A, N), without_rounding(C, N)
    form = observability_form(A2, C2)
    fixed = np.asarray(form.unobservable_modes, dtype=complex)
    shares = share_poles(poles, [("left",)], [k], form.n_observable, fixed, dt)
    share = np.full(k, first, dtype=complex) if shares[0] is None else shares[0]
    if k > 1 and len(set(share.tolist())) == 1:
        target = float(share[0].real) * np.eye(k)
    else:
        target = real_block_diagonal(share)
    wanted = np.hstack([H, -without_rounding(target, H)]), np.vstack([A, np.eye(n)])
    K_left = without_rounding(inverse, *wanted, inverse_without_rounding(C))
    rest = shares[1]
    placed = placed_share(A2, C2, rest, distance, dt)
    requested = np.concatenate([share, np.zeros(0, complex) if rest is None else rest])
    return DirectionalGain(K_left + N @ placed.gain, fixed, requested, float(placed.error))


def row_error(parts: IgnoredColumns, rows: LeftRows, K0: NDArray) -> float:
    """Return how far the rows are from spanning a left invariant space of ``A0 - K0 C0``, relative to its terms."""
    H = rows.H
    if not len(H):
        return 0.0
    image = H @ parts.A - (H @ K0) @ parts.C
    off = image - (image @ np.linalg.pinv(H)) @ H
    terms = np.abs(H) @ np.abs(parts.A) + np.abs(H @ K0) @ np.abs(parts.C)
    return float(np.abs(off).max(initial=0.0) / max(float(terms.max(initial=0.0)), TINY))


def left_frame(parts: IgnoredColumns, rows: LeftRows) -> Frame:
    """Return coordinates whose first ones are the rows ``H x``, the others those of its null space."""
    H = rows.H
    n = len(parts.A)
    if not len(H):
        return Frame(np.eye(n), np.eye(n), 0)
    N = null_basis(H)[0]
    return Frame(np.vstack([H, N.T]), np.hstack([np.asarray(np.linalg.pinv(H), dtype=float), N]), len(H))
