"""Runs of a campaign, at several commits, that the documentation adds up: what was counted, and which plants failed."""

from __future__ import annotations

import csv
import io
from collections import Counter
from pathlib import Path

from exact_campaign.answers import FAILURES, OUTCOMES
from exact_campaign.results import counted, without_request
from exact_campaign.runs import entries

Table = list[list[str]]

#: The tables, and the columns in front of their counts; the last one has no counts.
RUNS, KINDS, FUNCTIONS, FAILED = (f"campaign_{name}.csv" for name in ("runs", "kinds", "functions", "failures"))
_HEADS = {
    RUNS: ["commit", "first seed", "last seed", "plants", "plants with a failure", "hours of a processor"],
    KINDS: ["kind", "plants", *OUTCOMES],
    FUNCTIONS: ["function", *OUTCOMES],
    FAILED: ["kind", "seed", "commit", "failure", "functions"],
}


def add(record: Path, folder: Path) -> None:
    """Add a run to the tables in a folder; its seeds must be none that are counted there."""
    found = list(entries(record))
    if not found:
        raise ValueError(f"the record {record} holds no plants")
    tables = {name: _read(folder / name) for name in _HEADS}
    first, last = _seeds(found)
    for row in tables[RUNS]:
        if int(row[1]) <= last and first <= int(row[2]):
            raise ValueError(f"seeds {first} to {last} are counted in part: {row[1]} to {row[2]} at {row[0]}")
    commit = _commit(found)
    failed = _failed(found, commit)
    plants, seconds = sum(one["plants"] for one in found), sum(one["seconds"] for one in found)
    tables[RUNS].append([commit, *map(str, (first, last, plants, len(failed))), f"{seconds / 3600:.2f}"])
    tables[FAILED] += failed
    counts = counted(record)
    tables[KINDS] = _total(_sum(tables[KINDS], _by_kind(counts)))
    tables[FUNCTIONS] = sorted(_sum(tables[FUNCTIONS], _by_function(counts)))
    for name, rows in tables.items():
        (folder / name).write_text(_text([_HEADS[name], *rows]), encoding="utf-8")


def failed_plants(folder: Path) -> list[tuple[str, int]]:
    """Return kind and seed of the plants that failed."""
    return [(row[0], int(row[1])) for row in _read(folder / FAILED)]


def _seeds(found: list[dict]) -> tuple[int, int]:
    ranges = [(int(first), int(count)) for first, count in (one["key"].split("/")[1:] for one in found)]
    return min(first for first, _ in ranges), max(first + count - 1 for first, count in ranges)


def _commit(found: list[dict]) -> str:
    commits = {one["commit"] for one in found}
    if len(commits) != 1:
        raise ValueError(f"a run is of one commit, and this record of {', '.join(sorted(commits))}; start a new record")
    return commits.pop()


def _failed(found: list[dict], commit: str) -> Table:
    by_plant: dict[tuple[str, int], list[dict]] = {}
    for entry in found:
        for failure in entry["failures"]:
            if failure["outcome"] in FAILURES:
                by_plant.setdefault((failure["kind"], failure["seed"]), []).append(failure)
    return [
        [kind, str(seed), commit, _once(what, "outcome"), _once(what, "function")]
        for (kind, seed), what in sorted(by_plant.items(), key=lambda item: (item[0][1], item[0][0]))
    ]


def _once(failures: list[dict], field: str) -> str:
    return "; ".join(dict.fromkeys(without_request(one[field]) for one in failures))


def _by_kind(counts: dict) -> Table:
    return [
        [kind, *map(str, (counts["plants"][kind], *(found.get(one, 0) for one in OUTCOMES)))]
        for kind, found in counts["by kind"].items()
    ]


def _by_function(counts: dict) -> Table:
    return [
        [function, *(str(found.get(one, 0)) for one in OUTCOMES)] for function, found in counts["by function"].items()
    ]


def _sum(*tables: Table) -> Table:
    """Return tables with numbers as one, in which rows of one name are added."""
    sums: dict[str, Counter[int]] = {}
    for name, *numbers in (row for table in tables for row in table if row[0] != "all"):
        sums.setdefault(name, Counter()).update(dict(enumerate(map(int, numbers))))
    return [[name, *(str(row[i]) for i in sorted(row))] for name, row in sums.items()]


def _total(rows: Table) -> Table:
    return [*rows, ["all", *(str(sum(map(int, column))) for column in zip(*(row[1:] for row in rows), strict=True))]]


def _read(path: Path) -> Table:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as lines:
        return list(csv.reader(lines))[1:]


def _text(rows: Table) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
