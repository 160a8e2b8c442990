"""Make tables of the documentation from what they repeat.

- ``data/methods.csv``, the table of design functions, from what they declare of themselves;
- ``data/design_options.csv``, the options of ``residua design`` that methods have, from their signatures and docstrings;
- ``data/robust_norms_by_size.csv``, one row per size, from ``data/robust_norms.csv``;
- ``data/false_alarm_rates.csv`` and ``data/false_alarm_rates_by_samples.csv``, from ``data/false_alarm_rates_all.csv``.

Run it after a change of a design function's declaration, signature or parameters, and after ``benchmarks/robust_norms.py`` or ``false_alarm_rates.py``:
``python docs/make_tables.py``. Tests compare the files with what they are made of.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path

from residua.cli.methods import offered, option_name
from residua.cli.option_types import form_of, in_plain_words
from residua.design.catalogue import HEADER, table

DATA = Path(__file__).resolve().parent / "data"
METHODS, DESIGN_OPTIONS = DATA / "methods.csv", DATA / "design_options.csv"
ROBUST_NORMS, ROBUST_NORMS_BY_SIZE = DATA / "robust_norms.csv", DATA / "robust_norms_by_size.csv"
RATES, RATES_BY_PERSISTENCE = DATA / "false_alarm_rates_all.csv", DATA / "false_alarm_rates.csv"
RATES_BY_SAMPLES = DATA / "false_alarm_rates_by_samples.csv"


def methods() -> str:
    """Return the table of design functions as text."""
    return _text([HEADER, *table()])


def design_options() -> str:
    """Return the options of methods on the command line as text: a row for each thing that is said of one."""
    rows: dict[tuple[str, str], list[str]] = {}
    for name, method in offered().items():
        for option in method.options:
            form = form_of(option)
            if form is not None:
                written = f"``{option_name(option.name)}{' ' if form.metavar else ''}{form.metavar}``"
                rows.setdefault((written, in_plain_words(option.text)), []).append(name)
    order = list(dict.fromkeys(written.split()[0] for written, _ in rows))
    lines = sorted(rows.items(), key=lambda row: order.index(row[0][0].split()[0]))
    return _text([("option", "what it says", "of"), *((*key, ", ".join(names)) for key, names in lines)])


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


def false_alarm_rates() -> str:
    """Return the rates on new data as text: a column per persistence, with what was promised."""
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    for row in _rates():
        key = (row["residuals"], row["samples"], row["window"], row["noise"])
        cells.setdefault(key, {})[row["persistence"]] = f"{row['median rate']} ({_promise(row['median promised'])})"
    columns = list(dict.fromkeys(row["persistence"] for row in _rates()))
    lines = [(*key, *(found.get(p, "-") for p in columns)) for key, found in sorted(cells.items(), key=_numbers)]
    return _text([("residuals", "samples", "window", "phi", *(f"persistence {p}" for p in columns)), *lines])


def false_alarm_rates_by_samples() -> str:
    """Return how many fits kept their rate as text, by residuals and samples."""
    sums: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in _rates():
        sums.setdefault((row["residuals"], row["samples"]), []).append(row)
    lines = []
    for key, rows in sorted(sums.items(), key=_numbers):
        fits, said, kept = (sum(int(row[name]) for row in rows) for name in ("fits", "said", "kept"))
        rates = sorted(float(row["median rate"]) for row in rows)
        lines.append((*key, fits, said, kept, f"{100 * kept / fits:.1f} %", f"{rates[len(rates) // 2]:.4f}"))
    whole = [sum(int(row[name]) for row in _rates()) for name in ("fits", "said", "kept")]
    lines.append(("all", "all", *whole, f"{100 * whole[2] / whole[0]:.1f} %", ""))
    return _text([("residuals", "samples", "fits", "said", "kept", "share", "median rate"), *lines])


def _rates() -> list[dict[str, str]]:
    with RATES.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _numbers(entry: tuple[tuple[str, ...], object]) -> list[float]:
    return [float(part) for part in entry[0]]


def _promise(text: str) -> str:
    return "none" if float(text) >= 1 else f"{float(text):.3f}"


def _short(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 9.95 else f"{seconds:.1f}" if seconds >= 0.995 else f"{seconds:.2f}"


def _text(rows: Iterable[Iterable[object]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


if __name__ == "__main__":
    DATA.mkdir(exist_ok=True)
    made = (
        (METHODS, methods()),
        (DESIGN_OPTIONS, design_options()),
        (ROBUST_NORMS_BY_SIZE, robust_norms_by_size()),
        (RATES_BY_PERSISTENCE, false_alarm_rates()),
        (RATES_BY_SAMPLES, false_alarm_rates_by_samples()),
    )
    for path, text in made:
        path.write_text(text, encoding="utf-8")
        print(path)
