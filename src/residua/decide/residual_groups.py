"""A threshold test for each group of residuals of any generator, with its share of the false alarm rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from residua.decide.fault_free import FaultFree
from residua.decide.member_thresholds import BankTest, bank_test_from_model, fit_bank_test
from residua.decide.norm_threshold import Groups, NormThreshold
from residua.decide.whitening import whitening_matrix
from residua.errors import SettingError


@dataclass(frozen=True, eq=False)
class GroupTest(BankTest):
    """The threshold tests of groups of residuals, every number filled in: what runs.

    As :class:`BankTest`, with the groups as its members; the direction of the residual is that of all of it.

    Attributes
    ----------
    names : tuple of str
        Of the groups.
    whole : ndarray, shape (k, k)
        Whitening of all residuals together, in which direction is judged.
    """

    names: tuple[str, ...] = ()
    whole: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))


def rows_of_groups(groups: Groups, residuals: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the residual numbers of each group.

    Raises
    ------
    SettingError
        If the groups do not have each residual just once.
    """
    if groups == "each":
        return {name: (i,) for i, name in enumerate(residuals)}
    assert not isinstance(groups, str)
    places = {name: i for i, name in enumerate(residuals)}
    grouped = [name for _, members in groups or () for name in members]
    unknown = [name for name in grouped if name not in places]
    twice = sorted({name for name in grouped if grouped.count(name) > 1})
    missing = [name for name in residuals if name not in grouped]
    if unknown or twice or missing:
        told = "; ".join(
            f"{what} {', '.join(map(repr, names[:5]))}"
            for what, names in (("unknown:", unknown), ("in two groups:", twice), ("in none:", missing))
            if names
        )
        raise SettingError(
            f"groups must have every residual of the generator just once ({', '.join(map(repr, residuals[:8]))}"
            f"{', ...' if len(residuals) > 8 else ''}); {told}"
        )
    return {name: tuple(places[one] for one in members) for name, members in groups or ()}


def group_test_from_model(
    settings: NormThreshold, covariance: NDArray | None, rows: Mapping[str, Sequence[int]], n_residuals: int
) -> GroupTest | None:
    """Return the test that needs no data, or ``None`` when data are needed; each group has 1/G of the rate."""
    found = bank_test_from_model(settings, covariance, list(rows.values()), n_residuals)
    if found is None:
        return None
    known = covariance is not None and settings.whiten in ("auto", "model")
    whole = whitening_matrix(covariance) if known and covariance is not None else np.eye(n_residuals)
    return _with_names(found, rows, whole)


def fit_group_test(
    settings: NormThreshold,
    residuals: NDArray[np.float64],
    usable: NDArray[np.bool_],
    rows: Mapping[str, Sequence[int]],
    *,
    false_alarm_rate: float,
    covariance: NDArray | None,
    signal_sizes: Sequence[float],
    seams: Sequence[int] = (),
) -> GroupTest:
    """Fit the tests of all groups to fault-free residuals, as :func:`fit_bank_test` does those of members."""
    found = fit_bank_test(
        settings,
        residuals,
        usable,
        list(rows.values()),
        false_alarm_rate=false_alarm_rate,
        covariance=covariance,
        signal_sizes=signal_sizes,
        seams=seams,
    )
    data = FaultFree(residuals, usable, settings.window, tuple(seams))
    if settings.whiten == "none" or data.spread <= 1e-12 * max(signal_sizes):
        whole = np.eye(residuals.shape[1])
    elif settings.whiten == "model" and covariance is not None:
        whole = whitening_matrix(covariance)
    else:
        whole = data.moments().whitening
    return _with_names(found, rows, whole)


def _with_names(test: BankTest, rows: Mapping[str, Sequence[int]], whole: NDArray[np.float64]) -> GroupTest:
    values = {one.name: getattr(test, one.name) for one in fields(BankTest)}
    values["basis"] = test.basis.replace(" members: ", " groups: ", 1).replace("of the whole bank", "of all together")
    return GroupTest(**values, names=tuple(rows), whole=whole)


__all__ = ["GroupTest", "fit_group_test", "group_test_from_model", "rows_of_groups"]
