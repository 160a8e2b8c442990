"""What each number of a saved monitor may be, where it is not any number of at most 1e100 or any whole one from 0 on.

By the class whose fields are saved, and the name of the field. A field that is not named here is of the usual kind of
its type (:data:`residua.number_kinds.USUAL`), so that a new one is checked without a word; name it here where it may
be more, such as NaN for what is not known, or must be less, such as positive.
"""

from __future__ import annotations

from collections.abc import Mapping

from residua.number_kinds import (
    COUNT,
    ENTRY,
    KNOWN_OR_NOT,
    PART,
    POSITIVE,
    PROBABILITY,
    SHARE,
    WINDOW,
    NumberKind,
)

_RUNS = {"persistence": COUNT, "release": COUNT, "window": WINDOW}
_FITTED = {"center": ENTRY, "whitening": ENTRY, "promised": SHARE, "shrinkage": PART}

FIELDS: Mapping[str, Mapping[str, NumberKind]] = {
    "NormThreshold": {**_RUNS, "threshold": POSITIVE, "false_alarm_rate": PROBABILITY},
    "NormTest": {**_RUNS, **_FITTED, "threshold": POSITIVE},
    "BankTest": {**_RUNS, **_FITTED, "sizes": COUNT, "thresholds": POSITIVE},
    "GroupTest": {**_RUNS, **_FITTED, "sizes": COUNT, "thresholds": POSITIVE, "whole": ENTRY},
    "Directional": {"window": WINDOW},
    "Structured": {"window": WINDOW, "share": SHARE},
    "Matched": {"window": WINDOW, "alike": SHARE},
    "State": {"match_held": KNOWN_OR_NOT},
}
