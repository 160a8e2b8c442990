"""Make data/methods.csv: the table of design functions, from their records in the package.

Run it after a change of ``residua.design.catalogue``: ``python docs/make_tables.py``. A test compares the file with
the records.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

from residua.design.catalogue import HEADER, table

METHODS = Path(__file__).resolve().parent / "data" / "methods.csv"


def methods() -> str:
    """Return the table as text."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([HEADER, *table()])
    return out.getvalue()


if __name__ == "__main__":
    METHODS.parent.mkdir(exist_ok=True)
    METHODS.write_text(methods(), encoding="utf-8")
    print(METHODS)
