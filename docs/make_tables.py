"""Make tables of the documentation from what they repeat.

- ``data/methods.csv``, the table of design functions, from their records in the package;
- ``data/robust_norms_by_size.csv``, one row per size, from ``data/robust_norms.csv``.

Run it after a change of ``residua.design.catalogue``, and after ``benchmarks/robust_norms.py``:
``python docs/make_tables.py``. Tests compare the files with what they are made of.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path

from residua.design.catalogue import HEADER, table

DATA = Path(__file__).resolve().parent / "data"
METHODS = DATA / "methods.csv"
ROBUST_NORMS, ROBUST_NORMS_BY_SIZE = DATA / "robust_norms.csv", DATA / "robust_norms_by_size.csv"


def methods() -> str:
    """Return the table of design functions as text."""
    return _text([HEADER, *table()])


def robust_norms_by_size() -> str:
    """Return the table of bounds as text: a column per method, with the ratio and the seconds."""
    with ROBUST_NORMS.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    columns = list(dict.fromkeys(row["method"] for row in rows))
    by_size: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows:
        ratio, seconds = row["bound / attained"], _short(float(row["seconds"]))
        cell = f"{float(ratio):.3f} ({seconds} s)" if ratio else "-"
        by_size.setdefault((row["states"], row["parameters"]), {})[row["method"]] = cell
    lines = [(*size, *(cells.get(name, "-") for name in columns)) for size, cells in by_size.items()]
    return _text([("states", "parameters", *columns), *lines])


def _short(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 9.95 else f"{seconds:.1f}" if seconds >= 0.995 else f"{seconds:.2f}"


def _text(rows: Iterable[Iterable[object]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


if __name__ == "__main__":
    DATA.mkdir(exist_ok=True)
    for path, text in ((METHODS, methods()), (ROBUST_NORMS_BY_SIZE, robust_norms_by_size())):
        path.write_text(text, encoding="utf-8")
        print(path)
