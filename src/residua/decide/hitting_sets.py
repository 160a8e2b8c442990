"""Several faults at once: the smallest sets of faults that explain every residual that fired."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import log, log1p
from typing import Any

from residua.decide.checks import PRIOR_RATE, is_number
from residua.errors import DataError, SettingError
from residua.shown import Shown
from residua.visible import echo
from residua.words import counted, listing

#: Sets that are followed at once; more are too many to be of use to anyone.
_MOST_SETS = 100_000


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
        beside = f", {counted(self.silent, 'residual')} of theirs silent" if self.silent else ""
        return f"{' and '.join(self.faults)}{beside}"


@dataclass(frozen=True, repr=False)
class HittingSets(Shown):
    """The minimal hitting sets, the first ones the smallest; prints as a list.

    Attributes
    ----------
    sets : tuple of HittingSet
    complete : bool
        Whether these are all: no set was left out for its size.
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
    needed = [tuple(dict.fromkeys(_names(one, "conflicts"))) for one in _listed(conflicts, "conflicts")]
    quiet = [frozenset(_names(one, "silent")) for one in _listed(silent, "silent")]
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


def _listed(sets: object, name: str) -> list[Any]:
    """Return sets of names as a list of them, or raise."""
    if isinstance(sets, (str, Mapping)) or not isinstance(sets, Iterable):
        raise SettingError(f"{name} must be a list of sets of names, one for each residual, got {echo(sets)}")
    return list(sets)


def _names(one: object, name: str) -> list[Any]:
    """Return the names of one set, or raise."""
    if isinstance(one, str) or not isinstance(one, Iterable):
        raise SettingError(
            f"{name} must hold a set of names for each residual, such as [['pump', 'valve']], got {echo(one)}"
        )
    return list(one)


def _hit(found: list[frozenset[str]], conflict: tuple[str, ...], most: int | None) -> tuple[list[frozenset[str]], bool]:
    """Return the minimal sets that hit one more conflict set, and a flag for any left out for its size."""
    kept = [one for one in found if not one.isdisjoint(conflict)]
    out, cut = list(kept), False
    for one in found:
        if not one.isdisjoint(conflict):
            continue
        for name in conflict:
            larger = one | {name}
            if any(name in other and other <= larger for other in kept):
                continue
            if most is not None and len(larger) > most:
                cut = True
            else:
                out.append(larger)
    return list(dict.fromkeys(out)), cut


def checked_rates(prior_rates: float | Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    """Return the prior rate of each fault."""
    own = dict(prior_rates) if isinstance(prior_rates, Mapping) else dict.fromkeys(names, prior_rates)
    strange = [name for name in own if name not in names]
    if strange:
        raise SettingError(f"prior_rates has {listing(map(echo, strange))}, which no residual is sensitive to")
    for name, rate in own.items():
        if not is_number(rate) or not 0 < rate < 1:
            raise SettingError(f"the prior rate of {echo(name)} must lie between 0 and 1, got {echo(rate)}")
    return {name: float(own.get(name, PRIOR_RATE)) for name in names}


__all__ = ["HittingSet", "HittingSets", "minimal_hitting_sets"]
