"""Outcome of a demo."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from residua.report.tables import Table


@dataclass(frozen=True)
class Outcome:
    """Outcome of a demo, for the screen.

    Attributes
    ----------
    lines : tuple of str
        Steps and results, as text.
    tables : tuple of Table
    page : Path
        The report page that was written.
    surprises : tuple of str
        Results that differ from the expected ones; empty without any.
    """

    lines: tuple[str, ...]
    tables: tuple[Table, ...]
    page: Path
    surprises: tuple[str, ...] = ()
