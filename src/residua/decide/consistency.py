"""Isolation by consistency: faults that can explain the members that fired, and their probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.analysis.codes import equal_codes
from residua.decide.checks import PRIOR_RATE
from residua.decide.code_reading import NAMED, quoted
from residua.decide.hitting_sets import HittingSets, checked_rates, minimal_hitting_sets
from residua.errors import DataError, SettingError
from residua.shown import Shown
from residua.visible import echo
from residua.words import listing

#: Faults of the largest sets that together may explain a pattern.
_TOGETHER = 3


@dataclass(frozen=True)
class ConsistentFault:
    """A fault, or faults with the same code, as explanation of a pattern.

    Attributes
    ----------
    faults : tuple of str
    consistent : bool
        Every member that fired answers to it.
    probability : float
        Among all faults, if just one is there, with the prior rates that were given.
    fired, silent : int
        Members that answer to it and fired, and that answer to it and did not.
    unexplained : int
        Members that fired and do not answer to it.
    """

    faults: tuple[str, ...]
    consistent: bool
    probability: float
    fired: int
    silent: int
    unexplained: int

    def __str__(self) -> str:
        how = "consistent" if self.consistent else f"{self.unexplained} unexplained"
        return (
            f"{quoted(self.faults)}: {100 * self.probability:.3g} %, {how}, {self.fired} of "
            f"{self.fired + self.silent} members fired"
        )


@dataclass(frozen=True, repr=False)
class Explanation(Shown):
    """Faults that may have fired a pattern of members, the most likely first.

    Prints as a list.

    Attributes
    ----------
    candidates : tuple of ConsistentFault
        Every fault with a code; none when no member fired.
    evidence : float
        Logarithm to base 10 of how much likelier the pattern is under the best candidate than without a fault. Below
        zero, false alarms explain it better.
    pattern : tuple of bool
    members : tuple of str
    together : HittingSets or None
        The smallest sets of faults that explain all members that fired, up to three faults in each; ``None`` when none
        fired. Members that no fault has in its code are left out: they are false alarms.
    """

    candidates: tuple[ConsistentFault, ...]
    evidence: float
    pattern: tuple[bool, ...]
    members: tuple[str, ...]
    together: HittingSets | None = None

    @property
    def consistent(self) -> tuple[ConsistentFault, ...]:
        """The candidates that move every member that fired."""
        return tuple(one for one in self.candidates if one.consistent)

    def credible(self, level: float = 0.95) -> tuple[ConsistentFault, ...]:
        """Return the fewest most likely candidates that together reach this probability."""
        if not 0 < level < 1:
            raise SettingError(f"level must lie between 0 and 1, got {echo(level)}")
        total, out = 0.0, []
        for one in self.candidates:
            if total >= level:
                break
            out.append(one)
            total += one.probability
        return tuple(out)

    def __str__(self) -> str:
        fired = [name for name, on in zip(self.members, self.pattern, strict=True) if on]
        if not fired:
            return "no member fired: no fault"
        names = ", ".join(fired[: 2 * NAMED]) + (
            f" and {len(fired) - 2 * NAMED} more" if len(fired) > 2 * NAMED else ""
        )
        against = "no fault" if self.evidence < 0 else "a fault"
        lines = [f"fired: {names}; {against} is 10^{abs(self.evidence):.1f} times likelier than {_other(against)}"]
        lines += [f"  {one}" for one in self.candidates]
        if self.together is not None and not self.consistent and self.together.sets:
            several = [listing(one.faults) for one in self.together.sets[:NAMED]]
            lines.append(f"no fault alone explains all that fired; together do {listing(several, 'or')}")
        return "\n".join(lines)


def _other(hypothesis: str) -> str:
    return "a fault" if hypothesis == "no fault" else "none"


def consistent_faults(
    fired: ArrayLike,
    codes: ArrayLike,
    faults: Sequence[str],
    *,
    false_alarm: ArrayLike = 0.01,
    missed: ArrayLike | None = None,
    members: Sequence[str] | None = None,
    prior_rates: float | Mapping[str, float] = PRIOR_RATE,
) -> Explanation:
    r"""Rank the faults that can explain the fired members of a bank.

    For banks of many members of which a fault fires only some: a fault is *consistent* with a pattern when every
    member that fired answers to it, whatever stayed silent. Where codes are part of others, several faults are; they
    are ranked by the likelihood of the pattern. See :func:`code_likelihoods` for it.

    Guaranteed: without false alarms, the fault that is there is among the consistent ones. :func:`read_code` names one
    fault or none, and is the better choice where each fault fires all members of its code.

    Parameters
    ----------
    fired : array_like of bool, shape (members,)
    codes : array_like of bool, shape (members, faults)
        Faults with equal codes are one candidate; one without any code is never named.
    faults : sequence of str
    false_alarm, missed : float or array_like, shape (members,)
        As for :func:`code_likelihoods`.
    members : sequence of str, optional
        Their names, for texts; numbers when omitted.
    prior_rates : float or mapping of str to float
        Prior probability of each fault; those without a name have 1e-4. That of faults with equal codes is their sum.

    Returns
    -------
    Explanation
        With the probability of each fault if just one is there, and with the smallest sets of several at once.

    Raises
    ------
    DataError
        If the shapes do not fit.
    SettingError
        If a probability does not lie between 0 and 1.

    References
    ----------
    Frisk and Krysander (2018), IFAC SAFEPROCESS (consistency-based isolation with weak residuals); Gertler (1991),
    section 4 (degraded codes).

    Examples
    --------
    >>> from residua.decide.consistency import consistent_faults
    >>> codes = [[1, 1, 0], [1, 1, 0], [1, 0, 1], [1, 0, 1]]
    >>> print(consistent_faults([1, 1, 0, 0], codes, ["pump", "valve", "sensor"], members=["A", "B", "C", "D"]))
    fired: A, B; a fault is 10^3.5 times likelier than none
      'valve': 90.7 %, consistent, 2 of 2 members fired
      'pump': 9.26 %, consistent, 2 of 4 members fired
      'sensor': 0.00926 %, 2 unexplained, 0 of 2 members fired
    """
    table = _table(codes, faults)
    pattern = _booleans(fired, "fired")
    if pattern.shape != (len(table),):
        raise DataError(f"fired must have one entry per member ({len(table)}), got shape {pattern.shape}")
    if members is not None and len(members) != len(table):
        raise DataError(f"expected {len(table)} names of members, got {len(members)}")
    on = pattern
    names = tuple(members) if members is not None else tuple(str(i + 1) for i in range(len(table)))
    made = (tuple(bool(x) for x in on), names)
    groups = equal_codes(table)
    if not on.any() or not groups:
        return Explanation((), 0.0, *made)
    columns = table[:, [group[0] for group in groups]]
    own, none = code_likelihoods(on, columns, false_alarm=false_alarm, missed=missed)
    rates = checked_rates(prior_rates, tuple(map(str, faults)))
    sure = own + np.array([np.log(sum(rates[str(faults[j])] for j in group)) for group in groups])
    weights = np.exp(sure - sure.max())
    weights /= weights.sum()
    candidates = []
    for g in np.argsort(-sure, kind="stable"):
        code = columns[:, g]
        beside = int(np.count_nonzero(on & ~code))
        candidates.append(
            ConsistentFault(
                tuple(str(faults[j]) for j in groups[int(g)]),
                beside == 0,
                float(weights[g]),
                int(np.count_nonzero(on & code)),
                int(np.count_nonzero(~on & code)),
                beside,
            )
        )
    conflicts = [{str(faults[j]) for j in np.flatnonzero(row).tolist()} for row in table[on]]
    silent = [{str(faults[j]) for j in np.flatnonzero(row).tolist()} for row in table[~on]]
    there = set().union(*conflicts, *silent)
    own_rates = {name: rate for name, rate in rates.items() if name in there}
    conflicts = [one for one in conflicts if one]
    together = minimal_hitting_sets(conflicts, silent=silent, prior_rates=own_rates, most_faults=_TOGETHER)
    return Explanation(tuple(candidates), float((own.max() - none) / np.log(10)), *made, together)


def code_likelihoods(
    fired: ArrayLike,
    codes: ArrayLike,
    *,
    false_alarm: ArrayLike = 0.01,
    missed: ArrayLike | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""Return the log-likelihood of patterns of fired members under every fault, and under none.

    A member that does not answer to the fault fires with the probability :math:`q` of a false alarm, one that does
    stays silent with the probability :math:`1 - p` of a miss. Where that is not known it is taken as the same for
    all members and anything between 0 and 1 with equal probability, for the size of the fault is unknown: of ``m``
    members that answer to a fault ``k`` fire with the probability

    .. math:: \int_0^1 p^k (1 - p)^{m - k} dp = \frac{k!\,(m - k)!}{(m + 1)!}

    so that a fault is the less likely the more of its members are silent, and never excluded by them.

    Parameters
    ----------
    fired : array_like of bool, shape (..., members)
        One pattern, or many, such as (time, members).
    codes : array_like of bool, shape (members, faults)
    false_alarm : float or array_like, shape (members,)
        Probability that a member fires at a fault that it does not answer to.
    missed : float or array_like, shape (members,), optional
        Probability that a member stays silent at a fault that it answers to.

    Returns
    -------
    faults : ndarray, shape (..., faults)
    none : ndarray, shape (...)
        Without a fault: all that fired are false alarms.

    Raises
    ------
    DataError
        If the shapes do not fit.
    SettingError
        If a probability does not lie between 0 and 1.

    Notes
    -----
    Assumes: one fault at a time, and members that fire independently. Members with common noise do not: then the
    order of the faults still means something, the probabilities are too sure.

    Examples
    --------
    >>> from residua.decide.consistency import code_likelihoods
    >>> own, none = code_likelihoods([[1, 0], [0, 0]], [[1, 0], [0, 1]], false_alarm=0.1, missed=0.2)
    >>> own.round(2).tolist(), none.round(2).tolist()
    ([[-0.33, -3.91], [-1.71, -1.71]], [-2.41, -0.21])
    """
    table, on = _booleans(codes, "codes"), _booleans(fired, "fired")
    if table.ndim != 2 or on.ndim < 1 or on.shape[-1] != len(table):
        raise DataError(
            f"fired must have one entry per row of codes in its last axis, got {on.shape} and {table.shape}"
        )
    q = _probabilities(false_alarm, len(table), "false_alarm")
    alarm = np.where(on, np.log(q), np.log1p(-q))  # (..., members)
    outside = alarm @ (~table).astype(float)
    none = alarm.sum(axis=-1)
    if missed is not None:
        p = 1 - _probabilities(missed, len(table), "missed")
        return outside + np.where(on, np.log(p), np.log1p(-p)) @ table.astype(float), none
    factorials = np.concatenate([[0.0], np.cumsum(np.log(np.arange(1, len(table) + 2)))])
    k, m = on.astype(np.int64) @ table.astype(np.int64), table.sum(axis=0)
    return outside + factorials[k] + factorials[m - k] - factorials[m + 1], none


def _booleans(values: ArrayLike, name: str) -> NDArray[np.bool_]:
    """Return an array of booleans from one of booleans, or of zeros and ones."""
    array = np.asarray(values)
    if array.dtype == bool:
        return array
    if array.dtype.kind not in "iuf" or not np.isin(array, (0, 1)).all():
        raise DataError(f"{name} must be true or false, or 0 or 1")
    return array.astype(bool)


def _table(codes: ArrayLike, faults: Sequence[str]) -> NDArray[np.bool_]:
    table = _booleans(codes, "codes")
    if table.ndim != 2 or table.shape[1] != len(faults):
        raise DataError(f"codes must have a row per member and a column per fault ({len(faults)}), got {table.shape}")
    return table


def _probabilities(values: ArrayLike, members: int, name: str) -> NDArray[np.float64]:
    try:
        out = np.broadcast_to(np.asarray(values, dtype=float), (members,))
    except (TypeError, ValueError) as error:
        raise SettingError(f"{name} must be one number or one per member ({members}): {error}") from error
    if not ((out > 0) & (out < 1)).all():
        raise SettingError(f"{name} must lie between 0 and 1, got {echo(values)}")
    return np.asarray(out)


__all__ = ["ConsistentFault", "Explanation", "code_likelihoods", "consistent_faults"]
