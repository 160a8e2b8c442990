"""Faults that explain a pattern of fired members: by its code, by consistency, and several at once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import log, log1p
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.decide.checks import PRIOR_RATE, check_probability, is_number
from residua.decide.code_reading import NAMED, CodeReading, booleans, distinct_rows, quoted
from residua.decide.structured import CodeTest, Structured, code_test
from residua.errors import DataError, SettingError
from residua.shown import Shown
from residua.visible import echo
from residua.words import counted, listing

#: Faults of the largest sets that together may explain a pattern.
_TOGETHER = 3
#: Sets that are followed at once; more are too many to be of use to anyone.
_MOST_SETS = 100_000


def read_code(
    fired: ArrayLike,
    codes: ArrayLike,
    faults: Sequence[str],
    *,
    members: Sequence[str] | None = None,
    distance: int = 1,
) -> CodeReading:
    """Read the fired members of a bank against the codes of the faults.

    In this order:

    1. no member fired: *none*, no fault;
    2. the pattern is the code of a fault: *exact*;
    3. every code is a single member (a dedicated bank), and each member that fired is one: *several*. There is just
       one way to fire them, all of ``together`` at once;
    4. it is the code of just one fault with some ones missing, and the set of codes is strongly isolating (no
       code is another one with ones missing): *degraded*. A fault too small, or too slow, for some members does that;
    5. one code is nearer than all others (Hamming distance), differs in no more than ``distance`` members, and the
       pattern is part of no other fault's code: *nearest*. Not for a pattern in which all members fired: two faults
       at once do that in most banks;
    6. anything else: *unknown*: a single fault of whose code the pattern is part (``possible`` lists them), more than
       one fault, or one that the bank does not know.

    Guaranteed: a fault that fires just the members that its code promises is read exactly. A fault that fires only
    some of them is not read as another one by a *degraded* or *nearest* code: as another one only where it fires all
    members of that one's code and no more (*exact*; never in a strongly isolating set). Two faults at once whose
    pattern is the code of a third, or comes near it, are read as that third; ``pairs`` then names them. In a dedicated
    bank any number of faults at once that each fire their member, and no other, are read as just these. A fault that
    the bank does not know may fire the members of others there, as in any bank.

    Parameters
    ----------
    fired : array_like of bool, shape (members,)
    codes : array_like of bool, shape (members, faults)
        Which member each fault fires. Faults with equal codes are one group; one without any code is never read.
    faults : sequence of str
    members : sequence of str, optional
        Their names, for texts; numbers when omitted.
    distance : int

    Returns
    -------
    CodeReading

    Raises
    ------
    DataError
        If the shapes do not fit.

    References
    ----------
    Gertler (1991), section 4 (strongly isolating codes, degraded patterns).

    Examples
    --------
    >>> from residua.decide import read_code
    >>> codes = [[0, 1, 1], [1, 0, 1], [1, 1, 0]]
    >>> print(read_code([True, False, True], codes, ["y1", "y2", "y3"], members=["A", "B", "C"]))
    fired: A, C; code of 'y2' (exact)
    >>> read_code([True, True, True], codes, ["y1", "y2", "y3"]).answer
    'unknown'
    >>> dedicated = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> print(read_code([True, False, True], dedicated, ["y1", "y2", "y3"], members=["A", "B", "C"]))
    fired: A, C; several faults: 'y1' and 'y3'
    """
    code, pattern = _read(fired, codes, faults, members, distance)
    if pattern.ndim > 1:
        raise DataError(f"fired must be one pattern, one entry per member, got shape {pattern.shape}: see read_codes")
    return code.read(pattern)


def read_codes(
    fired: ArrayLike,
    codes: ArrayLike,
    faults: Sequence[str],
    *,
    members: Sequence[str] | None = None,
    distance: int = 1,
) -> tuple[NDArray[np.int64], tuple[CodeReading, ...]]:
    """Read many patterns at once, such as those of a fleet; see :func:`read_code`.

    Parameters
    ----------
    fired : array_like of bool, shape (..., members)
        Such as (plants, time, members).
    codes, faults, members, distance
        As for :func:`read_code`.

    Returns
    -------
    index : ndarray of int, shape (...)
        Number of the reading of each pattern.
    readings : tuple of CodeReading
        One for each pattern that occurs.

    Raises
    ------
    DataError
        If the shapes do not fit.

    Examples
    --------
    >>> from residua.decide import read_codes
    >>> index, readings = read_codes([[0, 1], [1, 1], [0, 1]], [[1, 0], [0, 1]], ["a", "b"])
    >>> [readings[k].answer for k in index]
    ['exact', 'several', 'exact']
    """
    code, patterns = _read(fired, codes, faults, members, distance)
    rows = patterns.reshape(-1, patterns.shape[-1])
    _, first, index = distinct_rows(rows)
    return index.reshape(patterns.shape[:-1]), tuple(code.read(rows[k]) for k in first)


def _read(
    fired: ArrayLike, codes: ArrayLike, faults: Sequence[str], members: Sequence[str] | None, distance: int
) -> tuple[CodeTest, NDArray[np.bool_]]:
    """Return codes and patterns, checked, and equal codes grouped."""
    code, patterns = code_test(Structured(distance=distance), codes, faults, members), booleans(fired, "fired")
    if patterns.ndim < 1 or patterns.shape[-1] != len(code.members):
        raise DataError(f"fired must have one entry per member ({len(code.members)}), got shape {patterns.shape}")
    return code, patterns


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
        check_probability(level, "level")
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
        likelier, other = ("no fault", "a fault") if self.evidence < 0 else ("a fault", "none")
        lines = [f"fired: {names}; {likelier} is 10^{abs(self.evidence):.1f} times likelier than {other}"]
        lines += [f"  {one}" for one in self.candidates]
        if self.together is not None and not self.consistent and self.together.sets:
            several = [listing(one.faults) for one in self.together.sets[:NAMED]]
            lines.append(f"no fault alone explains all that fired; together do {listing(several, 'or')}")
        return "\n".join(lines)


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
    >>> from residua.decide.fired_patterns import consistent_faults
    >>> codes = [[1, 1, 0], [1, 1, 0], [1, 0, 1], [1, 0, 1]]
    >>> print(consistent_faults([1, 1, 0, 0], codes, ["pump", "valve", "sensor"], members=["A", "B", "C", "D"]))
    fired: A, B; a fault is 10^3.5 times likelier than none
      'valve': 90.7 %, consistent, 2 of 2 members fired
      'pump': 9.26 %, consistent, 2 of 4 members fired
      'sensor': 0.00926 %, 2 unexplained, 0 of 2 members fired
    """
    code, on = _read(fired, codes, faults, members, 1)
    if on.ndim > 1:
        raise DataError(f"fired must be one pattern, one entry per member, got shape {on.shape}")
    seen = (tuple(on.tolist()), code.members)
    if not on.any() or not code.groups:
        return Explanation((), 0.0, *seen)
    likelihood, none = code_likelihoods(on, code.codes, false_alarm=false_alarm, missed=missed)
    rates = checked_rates(prior_rates, tuple(map(str, faults)))
    weight = likelihood + np.log([sum(rates[str(name)] for name in group) for group in code.groups])
    probability = np.exp(weight - weight.max())
    probability /= probability.sum()
    candidates = []
    for g in np.argsort(-weight, kind="stable").tolist():
        hit, beside = code.codes[:, g], int(np.count_nonzero(on & ~code.codes[:, g]))
        counts = (int(np.count_nonzero(on & hit)), int(np.count_nonzero(~on & hit)), beside)
        group = tuple(map(str, code.groups[g]))
        candidates.append(ConsistentFault(group, beside == 0, float(probability[g]), *counts))
    answering = [{name for g in np.flatnonzero(row) for name in map(str, code.groups[g])} for row in code.codes]
    conflicts = [names for names, fires in zip(answering, on, strict=True) if fires and names]
    silent = [names for names, fires in zip(answering, on, strict=True) if not fires]
    known = set().union(*answering)
    together = minimal_hitting_sets(
        conflicts,
        silent=silent,
        prior_rates={name: rate for name, rate in rates.items() if name in known},
        most_faults=_TOGETHER,
    )
    return Explanation(tuple(candidates), float((likelihood.max() - none) / np.log(10)), *seen, together)


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
    >>> from residua.decide.fired_patterns import code_likelihoods
    >>> own, none = code_likelihoods([[1, 0], [0, 0]], [[1, 0], [0, 1]], false_alarm=0.1, missed=0.2)
    >>> own.round(2).tolist(), none.round(2).tolist()
    ([[-0.33, -3.91], [-1.71, -1.71]], [-2.41, -0.21])
    """
    table, on = booleans(codes, "codes"), booleans(fired, "fired")
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


def _probabilities(values: ArrayLike, members: int, name: str) -> NDArray[np.float64]:
    try:
        out = np.broadcast_to(np.asarray(values, dtype=float), (members,))
    except (TypeError, ValueError) as error:
        raise SettingError(f"{name} must be one number or one per member ({members}): {error}") from error
    if not ((out > 0) & (out < 1)).all():
        raise SettingError(f"{name} must lie between 0 and 1, got {echo(values)}")
    return np.asarray(out)


@dataclass(frozen=True)
class HittingSet:
    """Faults that together explain everything that fired, none of which can be left out.

    Attributes
    ----------
    faults : tuple of str
    log_prior : float
        Logarithm of the product of ``rate / (1 - rate)`` over them: of their probability against no fault, before
        anything fired.
    silent : int
        Of the residuals that did not fire, how many one of these faults could have fired.
    """

    faults: tuple[str, ...]
    log_prior: float
    silent: int

    def __str__(self) -> str:
        silent = f", {counted(self.silent, 'residual')} of theirs silent" if self.silent else ""
        return f"{' and '.join(self.faults)}{silent}"


@dataclass(frozen=True, repr=False)
class HittingSets(Shown):
    """The minimal hitting sets, the first ones the smallest; prints as a list.

    Attributes
    ----------
    sets : tuple of HittingSet
    complete : bool
        True if these are all: no set was left out for its size.
    most_faults : int or None
        The bound on the size.
    """

    sets: tuple[HittingSet, ...]
    complete: bool
    most_faults: int | None = None

    def __str__(self) -> str:
        lines = [f"{k}. {one}" for k, one in enumerate(self.sets, 1)]
        if not self.complete:
            lines.append(
                f"only sets of up to {counted(self.most_faults or 0, 'fault')}: larger ones may explain it too"
            )
        return "\n".join(lines) or "nothing fired: no fault is needed"


def minimal_hitting_sets(
    conflicts: Iterable[Iterable[str]],
    *,
    silent: Iterable[Iterable[str]] = (),
    prior_rates: float | Mapping[str, float] = PRIOR_RATE,
    most_faults: int | None = None,
) -> HittingSets:
    r"""Return every smallest set of faults that explains all residuals that fired.

    A residual that fired needs one at least of the faults that it is sensitive to, its *conflict set* :math:`C_i`. The
    sets of faults that are enough are those that hit each,

    .. math:: S \cap C_i \ne \emptyset \quad \text{for all } i,

    and those are returned of which no fault can be left out. They are ranked by their number of faults, then by the
    prior rates, then by how few residuals that did not fire they could have fired; a silent residual excludes nothing,
    for a fault may be too small for it.

    Guaranteed: every set hits all conflict sets, none contains another, and without ``most_faults`` all there are are
    there; with it, all of that size or smaller, and ``complete`` says whether any was left out.

    Parameters
    ----------
    conflicts : iterable of iterable of str
        For each residual that fired the faults that it is sensitive to.
    silent : iterable of iterable of str
        For each that did not fire.
    prior_rates : float or mapping of str to float
        Prior probability of each fault; those without a name have 1e-4.
    most_faults : int, optional
        The most faults of a set.

    Returns
    -------
    HittingSets
        One empty set where nothing fired.

    Raises
    ------
    DataError
        If a conflict set is empty: then no fault explains its residual. If there are too many sets.
    SettingError
        If a rate does not lie between 0 and 1 or is for an unknown fault, or ``most_faults`` is not a number of faults.

    See Also
    --------
    residua.decide.consistent_faults : One fault at a time, with probabilities.

    References
    ----------
    Reiter (1987), Artificial Intelligence 32, 57-95, theorem 4.4; de Kleer and Williams (1987), Artificial Intelligence
    32, 97-130; Berge (1989), Hypergraphs (the method).

    Examples
    --------
    Three multipliers and two adders of which one output is wrong, and the two outputs do not go together:

    >>> from residua.decide import minimal_hitting_sets
    >>> print(minimal_hitting_sets([["M1", "M2", "A1"], ["M1", "M3", "A1", "A2"]]))
    1. M1
    2. A1
    3. M2 and M3
    4. M2 and A2
    """
    needed = [tuple(dict.fromkeys(one)) for one in _names_of(conflicts, "conflicts")]
    quiet = [frozenset(one) for one in _names_of(silent, "silent")]
    if most_faults is not None and not (is_number(most_faults) and most_faults >= 1 and most_faults % 1 == 0):
        raise SettingError(f"most_faults must be a whole number of faults, at least 1, got {echo(most_faults)}")
    names = tuple(dict.fromkeys(name for one in [*needed, *quiet] for name in one))
    rates = checked_rates(prior_rates, names)
    found: list[frozenset[str]] = [frozenset()]
    complete = True
    for i, conflict in enumerate(needed):
        if not conflict:
            raise DataError(f"the conflict set {i} is empty: no fault explains that residual; was it a false alarm?")
        found, cut = _hit(found, conflict, most_faults)
        complete = complete and not cut
        if len(found) > _MOST_SETS:
            raise DataError(
                f"more than {_MOST_SETS:,} sets of faults hit the first {i + 1} of {len(needed)} conflict sets: set "
                "most_faults to a smaller number"
            )
    place = {name: k for k, name in enumerate(names)}
    sets = []
    for one in found:
        faults = tuple(sorted(one, key=lambda name: place[name]))
        prior = sum(log(rates[name]) - log1p(-rates[name]) for name in faults)
        sets.append(HittingSet(faults, prior, sum(1 for other in quiet if other & one)))
    sets.sort(key=lambda s: (len(s.faults), -s.log_prior, s.silent, [place[name] for name in s.faults]))
    return HittingSets(tuple(sets), complete, most_faults)


def _names_of(sets: object, name: str) -> list[list[Any]]:
    """Return sets of names as lists, or raise."""
    if isinstance(sets, (str, Mapping)) or not isinstance(sets, Iterable):
        raise SettingError(f"{name} must be a list of sets of names, one for each residual, got {echo(sets)}")
    out = []
    for one in sets:
        if isinstance(one, str) or not isinstance(one, Iterable):
            raise SettingError(
                f"{name} must hold a set of names for each residual, such as [['pump', 'valve']], got {echo(one)}"
            )
        out.append(list(one))
    return out


def _hit(found: list[frozenset[str]], conflict: tuple[str, ...], most: int | None) -> tuple[list[frozenset[str]], bool]:
    """Return the minimal sets that hit one more conflict set, and a flag for any left out for its size."""
    hitting = [one for one in found if not one.isdisjoint(conflict)]
    out, cut = list(hitting), False
    for one in found:
        if not one.isdisjoint(conflict):
            continue
        for name in conflict:
            larger = one | {name}
            if any(name in other and other <= larger for other in hitting):
                continue
            if most is not None and len(larger) > most:
                cut = True
            else:
                out.append(larger)
    return list(dict.fromkeys(out)), cut


def checked_rates(prior_rates: float | Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    """Return the prior rate of each fault."""
    rates = dict(prior_rates) if isinstance(prior_rates, Mapping) else dict.fromkeys(names, prior_rates)
    strange = [name for name in rates if name not in names]
    if strange:
        raise SettingError(f"prior_rates has {listing(map(echo, strange))}, which no residual is sensitive to")
    for name, rate in rates.items():
        check_probability(rate, f"the prior rate of {echo(name)}")
    return {name: float(rates.get(name, PRIOR_RATE)) for name in names}
