"""Word of a verdict: the fit of listed faults to an alarm, and its wording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from residua.words import listing, number

GOOD, EITHER, POOR, TOO_EARLY = "good match", "either", "poor match", "too early"
#: Any unlisted cause, if none was tried.
ANYTHING = "anything"
#: Faults that a line names at most.
_NAMED = 8

#: Meaning of the words if every fault was fitted to the residual.
RULES = (
    "Good match: this listed fault, whatever its course over time, leaves only noise in the residual. No other listed "
    "fault and no unlisted sensor or actuator explains about as much, and no unlisted state explains more. Either: "
    "several faults do. Poor match: every listed fault leaves more than noise. Too early: too few samples so far."
)


@dataclass(frozen=True)
class Word:
    """Fit of the listed faults to an alarm, as one word.

    Attributes
    ----------
    kind : str
        ``"good match"``: one listed fault explains it, no other sensor, actuator or listed fault does about as well,
        and no unlisted state does better. ``"either"``: one of several, or something that is not listed.
        ``"poor match"``: no listed fault explains it. ``"too early"``.
    faults : tuple of tuple of str
        The one that explains it, those that do, or the nearest; each with those that look the same here.
    unlisted : str
        Unlisted cause that explains it as well, or better: ``"anything"`` if none was tried; empty without one.
    why : str
        Reason for a good match, or for another word; empty if faults were fitted to the residual.
    together : bool
        True if the faults are present at once, rather than one of them.
    quieter : bool
        True if the rest is less than the noise of the fit: a frozen sensor, or other units.
    from_start : bool
        True if it was present when judging began, or too soon after for a comparison with earlier samples.
    after : int
        Samples of the alarm that it rests on.
    evidence : float
        Twice the logarithm of the likelihood ratio of the first fault against none, in the colour of the noise.
    share : float
        Share of the residual beyond noise that the first fault explains, 0 to 1; NaN where faults were
        not fitted to the residual.
    size, deviation : float
        Of the first fault as one step, with its standard error.
    """

    kind: str
    faults: tuple[tuple[str, ...], ...]
    unlisted: str = ""
    why: str = ""
    together: bool = False
    quieter: bool = False
    from_start: bool = False
    after: int = 0
    evidence: float = 0.0
    share: float = math.nan
    size: float = math.nan
    deviation: float = math.nan

    @property
    def names(self) -> tuple[str, ...]:
        """The faults as text, indistinguishable ones as one."""
        return tuple(" or ".join(group) for group in self.faults)

    @property
    def fitted(self) -> bool:
        """True if the word rests on a fit of the faults, with any course, to the residual."""
        return math.isfinite(self.share)

    @property
    def line(self) -> str:
        """The word and its names, without a full stop."""
        first = self.names[0] if self.names else ""
        if self.kind == GOOD:
            return f"{first}, a good match {self.why}".rstrip()
        if self.kind == EITHER:
            names = [name for group in self.faults for name in group]
            if self.together:
                names = [f"{listing(self.names)} at once"]
            shown = names if len(names) <= _NAMED else [*names[:_NAMED], f"{len(names) - _NAMED} more"]
            such = "" if self.unlisted == ANYTHING else f", such as {self.unlisted}"
            return f"either {listing([*shown, *([f'something not listed{such}'] * bool(self.unlisted))], 'or')}"
        if self.kind == TOO_EARLY:
            why = "it was there when judging began or soon after" if self.from_start else self.why
            so_far = f"; so far {listing(self.names) if self.together else first}" if first else ""
            return f"too early to be sure of the name{f', for {why}' if why else ''}{so_far}"
        why = "it moves less than in the fit: a frozen sensor, or other units" if self.quieter else self.why
        why = why or "no listed fault explains it"
        nearest = f"; nearest is {first}" if first else ""
        better = f", and {self.unlisted}, which is not listed, explains it better" if self.unlisted and first else ""
        return f"a poor match: {why}{nearest}{better}"

    def headline(self, when: str) -> str:
        """Return the headline of an alarm, raised ``when``."""
        if self.kind in (GOOD, EITHER):
            return f"Fault found: {self.line}, {when}."
        if self.kind == TOO_EARLY:
            return f"{when[:1].upper()}{when[1:]}, {self.line}."
        return f"A fault was found, {when}, {self.line}."

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on the basis of the word."""
        if not self.names or not self.fitted:
            return ()
        text = f"After {self.after} samples of the alarm, {self.names[0]} explains {100 * self.share:.0f} % of the "
        text += "residual beyond noise"
        if math.isfinite(self.size) and math.isfinite(self.deviation):
            text += f"; as a step, its size is {number(self.size, 3)} ± {number(self.deviation, 2)}"
        return (f"{text}.",)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        values = {"share": self.share, "size": self.size, "deviation": self.deviation}
        return {
            "word": self.kind,
            "faults": [list(group) for group in self.faults],
            "unlisted": self.unlisted,
            "together": self.together,
            "after": self.after,
            **{name: value if math.isfinite(value) else None for name, value in values.items()},
        }
