"""Detection on measured residuals of an engine, by a monitor that is fitted to few fault-free samples.

Run it with the folder of the data::

    .venv/bin/python benchmarks/engine_detection.py --data FOLDER

It writes ``docs/data/engine_detection.csv``: for each part that is held out and each window, the threshold, the samples
that were held out with those in alarm, and the fraction of the samples of each fault in alarm, from the first whole
window on. The rate is 1 %, the beginning that is not like the rest is left out by the rule of the fit, and everything
else is as by default; no setting is fitted to samples with a fault.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from pathlib import Path

from engine_residuals import Recording, data_folder, read

import residua as rs
from residua.decide import NormThreshold

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "engine_detection.csv"
HELD_OUT, WINDOWS, RATE = (0.2, 0.3), (20, 30), 0.01


def rows(recording: Recording) -> Iterator[list[str]]:
    """Yield the header, then a row for each fit."""
    faults = list(recording.faulty)
    yield ["held out", "window", "fitted", "left out", "threshold", "held out and judged", "in alarm", "up to", *faults]
    made = rs.identify.given_residuals(recording.healthy.shape[1], recording.codes, faults=faults)
    for part in HELD_OUT:
        for window in WINDOWS:
            test = NormThreshold(window=window, persistence=1, false_alarm_rate=RATE)
            monitor = rs.Monitor(made, test=test, isolate=None)
            monitor.fit(None, recording.healthy, held_out=part, transient="auto")
            check = monitor.fit_check
            assert check is not None
            held = check.held_out
            judged = (
                ["0", "", ""] if held is None else [str(held.samples), str(held.alarmed), f"{held.interval[1]:.2f}"]
            )
            fitted = monitor.norm_test.basis.split()[2]
            detected = (monitor.run(None, samples).alarm[window - 1 :].mean() for samples in recording.faulty.values())
            yield [
                *(str(part), str(window), fitted, str(check.left_out), f"{monitor.threshold:.2f}"),
                *(*judged, *(f"{rate:.2f}" for rate in detected)),
            ]


def main(arguments: list[str] | None = None) -> int:
    """Write the table."""
    folder = data_folder(__doc__, arguments)
    table = list(rows(read(folder)))
    with OUTPUT.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(table)
    for line in table:
        print("  ".join(f"{cell:>8}" for cell in line))
    return 0


if __name__ == "__main__":
    sys.exit(main())
