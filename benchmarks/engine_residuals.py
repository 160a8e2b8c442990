"""Isolation on measured residuals of an engine: codes as this package reads them, beside a plain column match.

Run it with the folder of the data::

    .venv/bin/python benchmarks/engine_residuals.py --data FOLDER

It writes ``docs/data/engine_residuals.csv``: one row per decision and fault. Rates of isolation are in per cent of the
samples in which any residual fired. All settings are chosen on the samples without a fault.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

from residua.decide import FaultFreeRun, NormThreshold, read_codes
from residua.decide.consistency import code_likelihoods
from residua.decide.member_thresholds import fit_bank_test, member_alarms
from residua.decide.window import empty_window, moving_sum

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "engine_residuals.csv"
FALSE_ALARM = 0.01  # of every residual: what its normalisation means
WINDOWS = (1, 2, 5, 10, 20, 50)
HEADER = [
    *("decision", "fault", "samples", "in alarm %"),
    *("equal column %", "nearest column %", "read_code right %", "read_code wrong %", "read_code unknown %"),
    *("fault consistent %", "consistent faults", "likeliest %", "95 % set holds it %", "95 % set size"),
]


@dataclass(frozen=True, eq=False)
class Recording:
    """Measured residuals, without a fault and with each of the faults, and which of them answers to which fault.

    Attributes
    ----------
    healthy : ndarray, shape (time, residuals)
    faulty : dict of str to ndarray, shape (time, residuals)
    codes : ndarray of bool, shape (residuals, faults)
    """

    healthy: NDArray[np.float64]
    faulty: dict[str, NDArray[np.float64]]
    codes: NDArray[np.bool_]


def read(folder: Path) -> Recording:
    """Return the residuals of the folder, by mode."""
    modes, res, mode, codes = scipy.io.loadmat(folder / "data.mat", squeeze_me=True)["data"].item()
    parts = {str(name): np.asarray(res[mode == k], dtype=float) for k, name in enumerate(modes)}
    healthy = parts.pop("NF")
    return Recording(healthy, parts, np.asarray(codes[:, 1:], dtype=bool))


# -------------------------------------------------------------- which residuals fired


def means(residuals: NDArray, window: int) -> NDArray[np.float64]:
    """Return the means over every full window."""
    sums, _ = moving_sum(residuals[None], empty_window(1, window, residuals.shape[1]))
    return sums[0, window - 1 :] / window


def smallest_window(healthy: NDArray) -> int:
    """Return the smallest window whose means leave at most 1 % of the fault-free samples in alarm."""
    for window in WINDOWS:
        if (np.abs(means(healthy, window)) > 1).any(axis=1).mean() <= FALSE_ALARM:
            return window
    return WINDOWS[-1]


def decisions(recording: Recording) -> Iterator[tuple[str, dict[str, NDArray[np.bool_]]]]:
    """Yield ways to decide which residuals fired: name and patterns by mode, that without a fault first."""
    healthy, window = recording.healthy, smallest_window(recording.healthy)
    modes = {"no fault": healthy, **recording.faulty}
    yield "each sample", {name: np.abs(r) > 1 for name, r in modes.items()}
    yield f"mean of {window}", {name: np.abs(means(r, window)) > 1 for name, r in modes.items()}
    yield f"fitted, sum of {window}", fitted(healthy, modes, window)


def fitted(training: NDArray, modes: dict[str, NDArray], window: int) -> dict[str, NDArray[np.bool_]]:
    """Return the members in alarm by the thresholds of a bank, fitted to fault-free samples."""
    count = training.shape[1]
    run = FaultFreeRun(training, np.ones(len(training), dtype=bool), (), np.ones(count))
    settings = NormThreshold(window=window, persistence=1)
    test = fit_bank_test(settings, run, [[i] for i in range(count)], FALSE_ALARM, None)
    out = {}
    for name, residuals in modes.items():
        sums = means((residuals - test.center) @ test.whitening, window) * np.sqrt(window)
        over = (np.abs(sums) > test.thresholds)[None]
        none = np.zeros((1, count), dtype=np.int64)
        alarm, _, _ = member_alarms(test, over, np.ones(over.shape[:2], dtype=bool), none, none, none.astype(bool))
        out[name] = alarm[0]
    return out


# ------------------------------------------------------------------- what they mean


def row(patterns: NDArray[np.bool_], codes: NDArray[np.bool_], faults: list[str], true: str) -> list[Any]:
    """Return the rates of one fault: of alarms, then of what each reading says in the samples with an alarm."""
    fired = patterns[patterns.any(axis=1)]
    head = [len(patterns), percent(len(fired), len(patterns))]
    if true not in faults or not len(fired):
        return [*head, *[""] * (len(HEADER) - 4)]
    j, n = faults.index(true), len(fired)
    off = (fired[:, :, None] != codes).sum(axis=1)
    alone = (off[:, j] == off.min(axis=1)) & ((off == off.min(axis=1, keepdims=True)).sum(axis=1) == 1)
    index, readings = read_codes(fired, codes, faults)
    said = [readings[k].faults for k in index]
    right, unknown = sum(true in one for one in said), sum(not one for one in said)
    consistent = np.asarray((codes | ~fired[:, :, None]).all(axis=1))
    own, _ = code_likelihoods(fired, codes, false_alarm=FALSE_ALARM)
    weight = np.exp(own - own.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    ahead = (weight[:, :, None] < weight[:, None, :]) @ np.ones(len(faults))  # faults that are likelier
    sum_ahead = np.where(weight[:, :, None] < weight[:, None, :], weight[:, None, :], 0.0).sum(axis=2)
    inside = sum_ahead < 0.95  # ties are inside together
    likeliest = (ahead[:, j] == 0) & ((ahead == 0).sum(axis=1) == 1)
    return [
        *head,
        *(percent(np.count_nonzero(off[:, j] == 0), n), percent(np.count_nonzero(alone), n)),
        *(percent(right, n), percent(n - right - unknown, n), percent(unknown, n)),
        *(percent(np.count_nonzero(consistent[:, j]), n), f"{consistent.sum(axis=1).mean():.1f}"),
        *(percent(np.count_nonzero(likeliest), n), percent(np.count_nonzero(inside[:, j]), n)),
        f"{inside.sum(axis=1).mean():.1f}",
    ]


def percent(part: int | np.integer, whole: int) -> str:
    return f"{100 * int(part) / whole:.0f}" if whole else ""


def table(folder: Path) -> list[list[Any]]:
    """Return the table with its header."""
    recording = read(folder)
    faults = list(recording.faulty)
    out: list[list[Any]] = [HEADER]
    for name, by_mode in decisions(recording):
        for mode, patterns in by_mode.items():
            out.append([name, mode, *row(patterns, recording.codes, faults, mode)])
    return [[str(cell) for cell in line] for line in out]


def data_folder(description: str | None, arguments: list[str] | None) -> Path:
    """Return the folder with the recording, as the command line or the environment says."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with data.mat, or the one above it")
    options = parser.parse_args(arguments)
    folder = options.data or Path(os.environ.get("RESIDUA_SHARED_DATA", ""))
    folder = folder / "engine_frisk_residuals" if (folder / "engine_frisk_residuals").is_dir() else folder
    if not (folder / "data.mat").exists():
        parser.error("no data.mat in the folder: give --data or set RESIDUA_SHARED_DATA")
    return folder


def main(arguments: list[str] | None = None) -> int:
    """Write the table."""
    folder = data_folder(__doc__, arguments)
    lines = table(folder)
    with OUTPUT.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)
    for line in lines:
        print("  ".join(f"{cell:>8}" for cell in line))
    return 0


if __name__ == "__main__":
    sys.exit(main())
