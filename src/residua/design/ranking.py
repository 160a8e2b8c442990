"""Entries of a suggestion, and the rule by which they are ranked: by the faults that each design sees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from residua.design.banks.bank import Bank
from residua.design.banks.matched_filters import MatchedFilters
from residua.design.core.method import Method, Noise
from residua.design.estimation.fault_estimator import FaultEstimator
from residua.design.lasting_faults import LastingFaults
from residua.plant import Plant
from residua.shown import Shown
from residua.words import listing

#: Samples within which a design must have settled; sizes in sensor deviations from which on a fault counts as unseen;
#: and how many times smaller sizes must be for another design than the Kalman filter to come first.
SLOW, UNSEEN, SMALLER = 500, 100.0, 1.25
#: The designs that come first as long as no other is clearly better, and the one whose names were never wrong.
FIRST, _SECOND = ("kalman_filter", "decoupled_residual"), "structured_bank"


@dataclass(frozen=True, eq=False, repr=False)
class Entry(Shown):
    """One call that was considered.

    Attributes
    ----------
    call : str
        The line of code, for a plant called ``plant``.
    method : Method
        The record of the function.
    works : bool or None
        ``None`` when it was not tried.
    reason : str
        The result; or why the method was refused, or not tried.
    names : tuple of str
        The faults that it tells from all others.
    estimates : tuple of str
        The faults whose size it estimates.
    order : int
        Number of its states.
    made : object
        What the call returned, which a monitor runs; ``None`` when it did not work.
    sizes : mapping of str to float
        For each fault, in its unit, the size that is foretold to be seen for as long as it lasts; infinite where none
        is, and empty where nothing is foretold.
    left_out : str
        Why it works and cannot come first all the same; empty if it can.
    options : mapping of str to value
        Those of the call.
    foretold : LastingFaults or None
        What it sees; ``None`` where nothing is foretold.
    reached_by : tuple of str
        The disturbances that move its residual.
    blind : str
        Why it has no residual; empty if it has one.
    """

    call: str
    method: Method
    works: bool | None
    reason: str
    names: tuple[str, ...] = ()
    estimates: tuple[str, ...] = ()
    order: int = 0
    made: Any = field(default=None, repr=False)
    sizes: Mapping[str, float] = field(default_factory=dict, repr=False)
    left_out: str = ""
    options: Mapping[str, Any] = field(default_factory=dict, repr=False)
    foretold: LastingFaults | None = field(default=None, repr=False)
    reached_by: tuple[str, ...] = field(default=(), repr=False)
    blind: str = field(default="", repr=False)

    @property
    def label(self) -> str:
        """The function and its options."""
        options = ", ".join(f"{name}={typed(value)}" for name, value in self.options.items())
        return f"{self.method.name}({options})" if options else self.method.name

    def __str__(self) -> str:
        mark = {True: "works", False: "refused", None: "not tried"}[self.works]
        return f"{self.call}: {mark}: {self.reason}"


def typed(value: Any) -> str:
    """Return a value as it is typed."""
    if isinstance(value, str):
        return f'"{value}"'
    return repr(list(value)) if isinstance(value, tuple) else repr(value)


def few(names: tuple[str, ...], most: int = 4) -> str:
    """Return the first of some names, and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def never_first(record: Method) -> bool:
    """Tell whether a design never comes first for names: banks, estimators, averages and derivatives miss too much."""
    return record.many or record.size or record.noise in ("moving average", "differentiated")


def gives(entry: Entry, want: str) -> bool:
    """Tell of a design that works that it serves the wish of the user, and may come first."""
    if want == "state":
        return bool(entry.method.state) and not isinstance(entry.made, (Bank, Mapping))
    return bool(entry.estimates) if want == "size" else entry.foretold is not None and not never_first(entry.method)


def by_state(entries: list[Entry], plant: Plant) -> list[Entry]:
    """Return entries ranked for the state: filters of noise, then observers that converge, then differentiators."""

    def key(entry: Entry) -> tuple[float, ...]:
        if not entry.works:
            return (1 if entry.works is False else 2,)
        exposed = bool(plant.disturbances) and not entry.method.decouples
        noise = get_args(Noise).index(entry.method.noise)
        return (0, not gives(entry, "state"), exposed, entry.method.size, noise, len(entry.estimates), entry.order)

    return sorted(entries, key=key)


def by_faults(entries: list[Entry], deviations: Mapping[str, float], want: str) -> list[Entry]:
    """Return entries ranked by the faults that they see, with the reasons of those that are left out."""

    def sizes(entry: Entry, *, named: bool = False) -> NDArray[np.float64]:
        """Return the sizes of all faults in deviations, :data:`UNSEEN` for those that are not seen."""
        found = {} if entry.foretold is None else entry.foretold.named if named else entry.foretold.sizes
        scaled = [found.get(name, np.inf) / one for name, one in deviations.items()]
        asked = [want != "size" or name in entry.estimates for name in deviations]
        return np.array([size if size < UNSEEN and yes else UNSEEN for size, yes in zip(scaled, asked, strict=True)])

    def score(entry: Entry, *, named: bool = False) -> float:
        return float(np.exp(np.log(sizes(entry, named=named)).mean()))

    def reached(entry: Entry) -> str:
        return f"{listing(entry.reached_by)} reach{'es' if len(entry.reached_by) == 1 else ''} it"

    def slow(entry: Entry) -> str:
        settling = 0.0 if entry.foretold is None else entry.foretold.settling
        return f"settles in {settling:,.0f} samples" if settling > SLOW else ""

    def unmoved(entry: Entry) -> str:
        fixed = isinstance(entry.made, FaultEstimator) and 0 < entry.order <= len(entry.made.evidence.fixed_poles)
        return "settles as the plant does: none of its poles can be chosen" if fixed else ""

    def blind(entry: Entry) -> str:
        visibility = zip(deviations, sizes(entry) >= UNSEEN, seen < UNSEEN, strict=True)
        missed = tuple(name for name, here, elsewhere in visibility if here and elsewhere)
        return f"{'no size of' if want == 'size' else 'does not see'} {few(missed)}" if missed else ""

    working = [replace(one, sizes=one.foretold.sizes if one.foretold else {}) for one in entries if one.works]
    working = [replace(one, left_out=reached(one)) if one.reached_by else one for one in working]
    able = [one for one in working if not one.left_out and gives(one, want)]
    if want == "size" or not all(slow(one) for one in able):  # of slow ones alone the best is better than none
        able = [replace(one, left_out=slow(one)) for one in able]
    for why in (unmoved, blind) if want == "size" else (blind,):
        seen = np.min([sizes(one) for one in able if not one.left_out], axis=0, initial=UNSEEN)
        if not all(one.left_out or why(one) for one in able):  # else the best of them is better than none
            able = [one if one.left_out else replace(one, left_out=why(one)) for one in able]
    left = sorted((one for one in able if not one.left_out), key=lambda one: (one.foretold is None, score(one)))
    if want == "size":
        left.sort(key=lambda one: (-len(one.estimates), not isinstance(one.made, MatchedFilters)))
    else:
        left = _with_the_first(left, score)
    calls = {one.call for one in able}
    others = sorted((one for one in working if one.call not in calls), key=lambda one: (bool(one.left_out), score(one)))
    if want == "name" and left:
        others.sort(key=lambda one: one.method.name != _SECOND)
        codes = [one for one in others if one.method.name == _SECOND and not one.left_out]
        left, others = [left[0], *codes, *left[1:]], [one for one in others if one not in codes]
    refused = [one for one in entries if one.works is False]
    return [*left, *others, *(one for one in able if one.left_out), *refused, *(e for e in entries if e.works is None)]


def _with_the_first(left: list[Entry], score: Callable[..., float]) -> list[Entry]:
    """Return designs by their scores, before them the Kalman filter, or a design that is clearly better."""
    usual = [one for name in FIRST for one in left if one.method.name == name][:1]
    for one in left:
        better = (
            usual and score(one) * SMALLER <= score(usual[0]) and score(one, named=True) <= score(usual[0], named=True)
        )
        if better or not usual:
            usual = [one]
            break
    return [*usual, *(one for one in left if one not in usual)]
