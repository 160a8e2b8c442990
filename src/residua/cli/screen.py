"""Output of the commands: tables on a terminal, plain columns in a pipe."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from residua.records import plain
from residua.visible import visible

if TYPE_CHECKING:
    from rich.progress import Progress

#: Columns of a pipe or file: wide enough that nothing is cut.
_PIPE_WIDTH = 10_000
#: Seconds of work after which a progress bar appears.
_PATIENCE = 2.0
#: Bytes from which on a file is slow to read, so that its name is shown.
_LARGE_FILE = 20_000_000


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leave a broken pipe to the guard, which sets the exit status."""
        raise BrokenPipeError


def console() -> Console:
    """Return a console on stdout; names are shown literally, never taken as markup."""
    width = None if sys.stdout.isatty() else _PIPE_WIDTH
    return _Console(file=sys.stdout, width=width, markup=False, highlight=False, emoji=False)


def say(*lines: str) -> None:
    """Print lines; a terminal wraps them, a pipe gets them whole."""
    out = console()
    for line in map(visible, lines):
        out.print(line, soft_wrap=not out.is_terminal)


def show_table(header: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = "") -> None:
    """Print a table: with lines on a terminal, as plain columns elsewhere. Columns of numbers go right.

    On a terminal that is too narrow to keep words whole, each row is a block of lines, one for each cell.
    """
    header = [visible(name) for name in header]
    cells = [[_text(value) for value in row] for row in rows]
    out = console()
    if title:
        out.print(visible(title))
    if not out.is_terminal:
        for line in _columns([header, *cells]):
            out.print(line, soft_wrap=True)
        return
    columns = list(zip(header, *cells, strict=True))
    widths = _widths(columns, out.width)
    if widths is None:
        for row in cells:
            lines = [f"{name}: {cell}" for name, cell in zip(header, row, strict=True) if cell != "-"]
            out.print("\n  ".join(lines))
        return
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for (name, *column), width in zip(columns, widths, strict=True):
        numeric = bool(column) and all(map(_is_number, column))
        table.add_column(name, justify="right" if numeric else "left", width=width)
    for row in cells:
        table.add_row(*row)
    out.print(table)


def _widths(columns: Sequence[Sequence[str]], most: int) -> list[int] | None:
    """Return the widths of columns in a table of so many characters, or ``None`` if a word would not fit."""
    least = [max(map(cell_len, " ".join(column).split()), default=0) for column in columns]
    whole = [max(map(cell_len, column)) for column in columns]
    spare = most - sum(least) - 3 * len(columns) + 1  # rules and blanks between columns
    if spare < 0:
        return None
    widths = list(least)
    wanting = sorted(range(len(columns)), key=lambda k: whole[k] - least[k])
    for left, k in zip(range(len(columns), 0, -1), wanting, strict=True):
        more = min(whole[k] - least[k], spare // left)
        widths[k] += more
        spare -= more
    return widths


def _columns(rows: list[list[str]]) -> list[str]:
    """Return rows padded to equal columns, without blanks at the end."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def print_json(value: object, *, indent: int | None = 2) -> None:
    """Print a value as JSON, on one line without an indent; values that are not finite become null."""
    print(json.dumps(plain(value), indent=indent, ensure_ascii=False, allow_nan=False))


def records(columns: Mapping[str, Sequence[object]]) -> list[dict[str, object]]:
    """Return the rows of a table given by its columns."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _text(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (float, np.floating)):
        return "-" if not np.isfinite(value) else f"{value + 0.0:.6g}"  # no -0
    return visible(str(value)) or "-"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Show on a terminal that a large file is being read."""
    err = Console(stderr=True, markup=False, highlight=False)
    if err.is_terminal and path.stat().st_size > _LARGE_FILE:
        with err.status(f"reading {visible(path.name)}"):
            yield
    else:
        yield


@contextmanager
def patience(what: str) -> Iterator[None]:
    """Name a task on stderr once it has taken two seconds; a terminal shows the elapsed time."""
    err = Console(stderr=True, markup=False, highlight=False)
    bars: list[Progress] = []

    def show() -> None:
        if not err.is_terminal:
            print(f"{visible(what)} ...", file=sys.stderr, flush=True)
            return
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = SpinnerColumn(), TextColumn(visible(what), markup=False), TimeElapsedColumn()
        bars.append(Progress(*columns, console=err, transient=True))
        bars[0].add_task("", total=None)
        bars[0].start()

    clock = Timer(_PATIENCE, show)
    clock.daemon = True
    clock.start()
    try:
        yield
    finally:
        clock.cancel()
        clock.join()
        for bar in bars:
            bar.stop()


class _Bar:
    """A progress bar on stderr that appears only when the work takes long."""

    def __init__(self) -> None:
        self.started = monotonic()
        self.bar: Progress | None = None
        self.task: Any = None

    def __call__(self, done: int, total: int) -> None:
        """Show the progress of the work."""
        if self.bar is None and done < total and monotonic() - self.started > _PATIENCE:
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            self.bar = Progress(
                TextColumn("{task.completed:,.0f} of {task.total:,.0f} samples"),
                BarColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self.bar.start()
            self.task = self.bar.add_task("", total=total)
        if self.bar is not None:
            self.bar.update(self.task, completed=done)


@contextmanager
def progress() -> Iterator[_Bar]:
    """Yield a callable (done, total) that shows a bar on a terminal once two seconds have gone."""
    bar = _Bar()
    try:
        yield bar
    finally:
        if bar.bar is not None:
            bar.bar.stop()
