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
        What was done and found, in words.
    tables : tuple of Table
    page : Path
        The report page that was written.
    surprises : tuple of str
        What did not come out as the demo says it should; empty when all did.
    """

    lines: tuple[str, ...]
    tables: tuple[Table, ...]
    page: Path
    surprises: tuple[str, ...] = ()
