"""The counts of a campaign, and its failing cases, smallest first."""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from pathlib import Path

from exact_campaign.answers import OUTCOMES
from exact_campaign.runs import entries

#: Cases of one topic and function that are kept.
_CASES = 10


def write_results(record: Path, folder: Path) -> None:
    """Write ``counts.json`` and ``failures.json`` from the record of a campaign."""
    counts, failures = counted(record), smallest_failures(record)
    (folder / "counts.json").write_text(json.dumps(counts, indent=1), encoding="utf-8")
    (folder / "failures.json").write_text(json.dumps(failures, indent=1), encoding="utf-8")


def counted(record: Path) -> dict:
    """Return the numbers of plants and outcomes: by kind, and by function."""
    plants: Counter[str] = Counter()
    by_kind: defaultdict[str, Counter[str]] = defaultdict(Counter)
    by_function: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for entry in entries(record):
        plants[entry["kind"]] += entry["plants"]
        for key, count in entry["counts"].items():
            function, _, outcome = key.split(" | ")
            function = without_request(function)
            by_kind[entry["kind"]][outcome] += count
            by_function[function][outcome] += count
    return {
        "plants": dict(plants),
        "outcomes": list(OUTCOMES),
        "by kind": {k: dict(v) for k, v in by_kind.items()},
        "by function": {k: dict(v) for k, v in by_function.items()},
    }


def without_request(function: str) -> str:
    """Return the name of a function without what it was asked for in particular: faults to ignore, a code, a point."""
    return re.sub(r"( \[[\d, ]*\]| [01]+$| \(\d.*\))", "", function)


def smallest_failures(record: Path) -> list[dict]:
    """Return for each topic and function how many failed, and the shortest cases."""
    found: defaultdict[tuple[str, str, str], list[dict]] = defaultdict(list)
    counts: Counter[tuple[str, str, str]] = Counter()
    for entry in entries(record):
        for failure in entry["failures"]:
            key = failure["topic"], without_request(failure["function"]), failure["outcome"]
            counts[key] += 1
            found[key].append(failure)
            if len(found[key]) > 20 * _CASES:
                found[key] = _shortest(found[key])
    return [
        {"topic": key[0], "function": key[1], "outcome": key[2], "count": counts[key], "cases": _shortest(cases)}
        for key, cases in sorted(found.items())
    ]


def _shortest(cases: list[dict]) -> list[dict]:
    return sorted(cases, key=lambda one: (one["units"] != "base", len(one["plant"])))[:_CASES]
