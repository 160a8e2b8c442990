"""Judge monitors that ``residua.learn`` makes: false alarms, faults seen and named, printed sizes, events of a turbine.

Run it with::

    .venv/bin/python benchmarks/learnt_monitors.py --out docs/data

It writes two tables. ``learnt_monitors.csv`` has a row for each of the ten simulated sets of ``learnt_sets.py``. A
monitor is learnt from one fault-free log of 8,000 rows at a rate of 1e-3, and set beside the package's default: the
Kalman filter of the same identified plant with the default test.

- False alarms: the fraction of 40,000 new fault-free rows in alarm, as a multiple of the rate; of two further logs too.
- Seen: the part of the faulty time in alarm, in the mean over all sensors; faults begin in row 1,000 of 4,000 new rows.
  At 3 deviations: over offset, stuck and drift of 3 deviations of the channel in the training log. All: with frozen and
  dead sensors.
- Named: of the faults with an alarm after they began, the part whose longest alarm names that sensor first.
- Soon, lasting: the smallest offsets that ``monitor.fit_check.visible`` prints over those measured by bisection on 20
  new runs, as the median over the sensors. Soon: in alarm within 100 rows in nine of ten runs. Lasting: in alarm for
  90 % of the rows 100 to 1,000 after the onset. Runs that are in alarm just before the onset do not count.

``learnt_events.csv`` has two other plants. A wind turbine is learnt from a year without events; a new year has 22 stops
and 7 curtailments. False alarms are rows outside of these events and outside of alarms that outlast one. And a plant
whose large slow disturbance hides its sensor from every filter: the sensor sticks, or is off by five deviations.

All is drawn from seed 11. Seeds 1 to 3 were used to choose a margin in the package, so they may not be used here.
``--quick`` takes a tenth of the rows and a few runs, to see that all works; its numbers mean nothing.
"""

from __future__ import annotations

import argparse
import copy
import csv
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from learnt_sets import SETS, LearntSet, turbine_year, with_sensor_fault
from numpy.typing import NDArray

import residua as rs
from residua.monitor import Diagnosis
from residua.monitor.fit_check import VisibleSize

SEED = 11
#: Seeds of further logs of which the false alarms alone are counted.
OTHER_LOGS = (12, 13)
#: Fraction of fault-free rows in alarm that is asked for.
RATE = 1e-3
#: Kinds of faults with their sizes in deviations; those of size 3 are the figure that is asked for.
AT_THREE = (("offset", 3.0), ("stuck", 3.0), ("drift", 3.0))
FAULTS = (*AT_THREE, ("frozen", 0.0), ("dead", 0.0))
#: Rows after an onset within which a fault is seen soon, and up to which it is seen as it lasts.
SOON, LASTING = 100, 1000
#: Part of the runs, or of the rows, in which a fault of the measured size is seen.
NINE_OF_TEN = 0.9
#: Offsets are looked for up to so many deviations of the channel, and to that factor.
LARGEST, CLOSE = 100.0, 1.03
#: A printed size agrees with the measured one within that factor.
AGREES = 1.5
#: Rows of the recordings of the plant that hides its sensor, and where faults begin in them.
HIDDEN_LOG, HIDDEN_ROWS, HIDDEN_ONSET = 8000, 3000, 1000

HEADER = (
    "set", "form", "false", "false, default", "seen at 3", "seen at 3, default", "seen", "seen, default", "named",
    "soon", "soon within 1.5", "lasting", "lasting within 1.5", *(f"false, log {seed}" for seed in OTHER_LOGS),
)  # fmt: skip
EVENTS = (
    "plant", "case", "form", "events", "found", "delay", "share", "least share", "false",
    "outlasts, median", "outlasts, largest",
)  # fmt: skip

Rows = NDArray[np.float64]


@dataclass(frozen=True)
class Scale:
    """How large the campaign is.

    Attributes
    ----------
    log, quiet : int
        Rows of the training log and of the new fault-free rows.
    rows, onset, recordings : int
        Rows of a recording with faults, where these begin, and recordings of each fault.
    runs, before : int
        Runs in which sizes are measured, and the rows of each before its onset.
    """

    log: int = 8000
    quiet: int = 40_000
    rows: int = 4000
    onset: int = 1000
    recordings: int = 2
    runs: int = 20
    before: int = 500


QUICK = Scale(log=2000, quiet=4000, rows=1500, recordings=1, runs=4, before=100)


# ----------------------------------------------------------------------- monitors


def learnt_from(log: Rows, inputs: Sequence[str], outputs: Sequence[str], dt: float) -> rs.Learnt:
    """Return what is learnt from a log of (inputs, outputs)."""
    named = {"inputs": list(inputs), "outputs": list(outputs), "dt": dt}
    return rs.learn(log, **named, false_alarm_rate=RATE, progress=False, force=True)


def default_beside(learnt: rs.Learnt, log: Rows) -> rs.Monitor:
    """Return the package's default on the same identified plant: its Kalman filter with the default test."""
    return rs.Monitor(learnt.monitor.design).fit([parted(log, learnt)], false_alarm_rate=RATE)


def parted(rows: Rows, learnt: rs.Learnt) -> tuple[Rows | None, Rows]:
    """Return inputs, ``None`` without any, and outputs."""
    m = len(learnt.inputs)
    return rows[..., :m] if m else None, rows[..., m:]


def alarms(monitor: rs.Monitor, learnt: rs.Learnt, rows: Rows) -> NDArray[np.bool_]:
    """Return where a monitor is in alarm from a fresh start, (time,) or (plants, time)."""
    monitor.reset()
    alarm = monitor.update(*parted(rows, learnt), keep=["alarm"]).alarm
    return alarm if rows.ndim == 3 else alarm[0]


# ------------------------------------------------------------------ faults of a set


def faulty_rows(
    chosen: LearntSet, spread: Rows, rng: np.random.Generator, scale: Scale
) -> tuple[Rows, list[tuple[str, str, float]]]:
    """Return recordings with one fault each, (faults, time, channels), and sensor, kind and size of each."""
    m, recordings, cases = len(chosen.inputs), [], []
    for _ in range(scale.recordings):
        rows = chosen.simulate(rng, scale.rows)
        for j, name in enumerate(chosen.outputs):
            for kind, size in FAULTS:
                recordings.append(with_sensor_fault(rows, m + j, kind, size, scale.onset, float(spread[m + j]), rng))
                cases.append((name, kind, size))
    return np.stack(recordings), cases


def first_name(found: Diagnosis, onset: int) -> tuple[str, ...] | None:
    """Return the faults that the longest alarm after an onset names first; ``None`` without such an alarm."""
    after = [one for one in found.alarms if one.stop > onset]
    if not after:
        return None
    longest = max(after, key=lambda one: one.stop - max(one.start, onset))
    return longest.candidates[0].faults if longest.candidates else ()


def named_first(learnt: rs.Learnt, rows: Rows, cases: Sequence[tuple[str, str, float]], onset: int) -> float:
    """Return the part of the faults with an alarm whose longest names the sensor first."""
    right = []
    for recording, (sensor, _, _) in zip(rows, cases, strict=True):
        first = first_name(cast(Diagnosis, learnt.monitor.run(*parted(recording, learnt))), onset)
        if first is not None:
            right.append(f"{sensor} sensor" in first)
    return float(np.mean(right)) if right else math.nan


# --------------------------------------------------------------------------- sizes


def measured_sizes(
    learnt: rs.Learnt, runs: Rows, before: int, sensor: int, deviation: float, printed: VisibleSize
) -> tuple[float, float]:
    """Return the smallest offsets of a sensor that are seen soon and as they last; infinite if none is."""
    lead, rest = runs[:, :before], runs[:, before:]
    monitor = copy.deepcopy(learnt.monitor)
    quiet = ~alarms(monitor, learnt, lead)[:, -1]
    if not quiet.any():
        return math.nan, math.nan

    def after(size: float, rows: int) -> NDArray[np.bool_]:
        wrong = rest[:, :rows].copy()
        wrong[..., len(learnt.inputs) + sensor] += size
        return copy.deepcopy(monitor).update(*parted(wrong, learnt), keep=["alarm"]).alarm[quiet]

    soon = smallest(lambda size: float(after(size, SOON).any(axis=1).mean()), printed.soon, deviation)
    lasting = smallest(lambda size: float(after(size, LASTING)[:, SOON:].mean()), printed.lasting, deviation)
    return soon, lasting


def smallest(seen: Callable[[float], float], guess: float, deviation: float) -> float:
    """Return the smallest size that is seen in nine of ten cases, by bisection from a guess; infinite if none is."""
    least, most = 1e-6 * deviation, LARGEST * deviation
    size = min(max(guess, least), most) if math.isfinite(guess) else most
    if seen(size) >= NINE_OF_TEN:
        high, low = size, size / 2
        while low > least and seen(low) >= NINE_OF_TEN:
            high, low = low, low / 2
    else:
        low, high = size, min(2 * size, most)
        while seen(high) < NINE_OF_TEN:
            if high >= most:
                return math.inf
            low, high = high, min(2 * high, most)
    while high / low > CLOSE:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if seen(middle) >= NINE_OF_TEN else (middle, high)
    return math.sqrt(low * high)


def ratio(printed: float, measured: float) -> float:
    """Return printed over measured; one where both are infinite."""
    if math.isinf(measured):
        return 1.0 if math.isinf(printed) else 0.0
    return printed / measured


def within(value: float) -> bool:
    """Return whether a ratio is within the factor in which a size agrees."""
    return 1 / AGREES <= value <= AGREES


# ---------------------------------------------------------------------- the tables


def false_of_log(chosen: LearntSet, seed: int, scale: Scale) -> float:
    """Return the false alarms on new rows of a monitor that is learnt from another log."""
    rng = np.random.default_rng(seed)
    learnt = learnt_from(chosen.simulate(rng, scale.log), chosen.inputs, chosen.outputs, chosen.dt)
    return float(alarms(learnt.monitor, learnt, chosen.simulate(rng, scale.quiet)).mean())


def row_of(chosen: LearntSet, scale: Scale) -> dict[str, object]:
    """Return the row of one set."""
    rng = np.random.default_rng(SEED)
    log = chosen.simulate(rng, scale.log)
    spread = log.std(axis=0)
    learnt = learnt_from(log, chosen.inputs, chosen.outputs, chosen.dt)
    default = default_beside(learnt, log)
    quiet = chosen.simulate(rng, scale.quiet)
    row: dict[str, object] = {"set": chosen.name, "form": learnt.chosen}
    faulty, cases = faulty_rows(chosen, spread, rng, scale)
    three = np.array([case[1:] in AT_THREE for case in cases])
    for monitor, of in ((learnt.monitor, ""), (default, ", default")):
        row["false" + of] = f"{alarms(monitor, learnt, quiet).mean() / RATE:.2f}"
        shares = alarms(monitor, learnt, faulty)[:, scale.onset :].mean(axis=1)
        row["seen at 3" + of], row["seen" + of] = f"{shares[three].mean():.3f}", f"{shares.mean():.3f}"
    row["named"] = f"{named_first(learnt, faulty, cases, scale.onset):.2f}"
    for seed in OTHER_LOGS:
        row[f"false, log {seed}"] = f"{false_of_log(chosen, seed, scale) / RATE:.2f}"
    check = learnt.monitor.fit_check
    assert check is not None
    runs = np.stack([chosen.simulate(rng, scale.before + LASTING) for _ in range(scale.runs)])
    ratios = []
    for j, name in enumerate(chosen.outputs):
        printed = next(one for one in check.visible if one.fault == f"{name} sensor")
        found = measured_sizes(learnt, runs, scale.before, j, float(spread[len(chosen.inputs) + j]), printed)
        ratios.append([ratio(a, b) for a, b in zip((printed.soon, printed.lasting), found, strict=True)])
        said = f"soon {printed.soon:.3g} printed, {found[0]:.3g} measured"
        print(f"  {name}: {said}; lasting {printed.lasting:.3g}, {found[1]:.3g}", flush=True)
    for kind, values in zip(("soon", "lasting"), np.array(ratios).T, strict=True):
        median = float(np.nanmedian(values))
        row[kind], row[f"{kind} within {AGREES:g}"] = f"{median:.2f}", "yes" if within(median) else "no"
    return row


def turbine_rows(cases: Sequence[tuple[bool, Sequence[str]]] | None = None) -> Iterator[dict[str, object]]:
    """Yield the rows of the wind turbine: with or without pitch, with wind as an input or none."""
    rng = np.random.default_rng(SEED)
    log, times, _ = turbine_year(rng, events=False)
    new, _, events = turbine_year(rng, events=True)
    dt = float(times[1] - times[0])
    for pitch, inputs in cases or [(p, u) for p in (False, True) for u in (["wind"], [])]:
        columns, names = ([0, 1, 2], ["wind", "pitch", "power"]) if pitch else ([0, 2], ["wind", "power"])
        learnt = learnt_from(log[:, columns], inputs, names[len(inputs) :], dt)
        alarm = alarms(learnt.monitor, learnt, new[:, columns])
        case = f"{', '.join(names)}; {'wind drives' if inputs else 'no inputs'}"
        yield {"plant": "wind turbine", "case": case, "form": learnt.chosen} | of_events(alarm, events)


def of_events(alarm: NDArray[np.bool_], events: Sequence[tuple[int, int, str]]) -> dict[str, object]:
    """Return how many events raise an alarm, how late in the median, and what is in alarm outside of them."""
    outside, late, outlasts, shares = np.ones(len(alarm), bool), [], [], []
    lasting = np.zeros(len(alarm), bool)
    for first, end, _ in events:
        outside[first:end] = False
        shares.append(alarm[first:end].mean())
        if alarm[first:end].any():
            late.append(int(alarm[first:end].argmax()))
        more = 0
        if alarm[end - 1]:
            still = alarm[end:]
            more = len(still) if still.all() else int((~still).argmax())
            lasting[end : end + more] = True
        outlasts.append(more)
    false = (alarm & outside & ~lasting).sum() / (outside & ~lasting).sum()
    return {
        "events": len(events),
        "found": len(late),
        "delay": f"{np.median(late):g}" if late else "",
        "share": f"{np.mean(shares):.3f}",
        "least share": f"{np.min(shares):.3f}",
        "false": f"{false:.5f}",
        "outlasts, median": f"{np.median(outlasts):g}",
        "outlasts, largest": max(outlasts),
    }


def hidden(rng: np.random.Generator, rows: int) -> Rows:
    """Return rows (u, y) of a plant whose slow disturbance hides its sensor: a filter follows whatever y does."""
    u = np.where(np.arange(rows) // 50 % 2, -1.0, 1.0)
    d = np.zeros(rows)
    shocks, noise = rng.standard_normal(rows), rng.standard_normal(rows)
    for k in range(1, rows):
        d[k] = 0.98 * d[k - 1] + shocks[k]
    return np.column_stack([u, u + 5 * d + 0.2 * noise])


def hidden_rows(recordings: int = 10) -> Iterator[dict[str, object]]:
    """Yield the rows of the plant that hides its sensor: stuck at 0, and off by five deviations.

    The delay is the longest of some recordings; the false alarms are those of the same recordings without a fault.
    """
    rng = np.random.default_rng(SEED)
    log = hidden(rng, HIDDEN_LOG)
    learnt = learnt_from(log, ["u"], ["y"], 1.0)
    quiet = np.stack([hidden(rng, HIDDEN_ROWS) for _ in range(recordings)])
    stuck, offset = quiet.copy(), quiet.copy()
    stuck[:, HIDDEN_ONSET:, 1] = 0.0
    offset[:, HIDDEN_ONSET:, 1] += 5 * log[:, 1].std()
    false = alarms(learnt.monitor, learnt, quiet).mean()
    for case, rows in (("stuck at 0", stuck), ("off by 5 deviations", offset)):
        after = alarms(learnt.monitor, learnt, rows)[:, HIDDEN_ONSET:]
        late = [int(one.argmax()) for one in after if one.any()]
        yield {
            "plant": "hidden sensor",
            "case": case,
            "form": learnt.chosen,
            "events": recordings,
            "found": len(late),
            "delay": max(late, default=""),
            "share": f"{after.mean():.3f}",
            "least share": f"{after.mean(axis=1).min():.3f}",
            "false": f"{false:.5f}",
        }


# ------------------------------------------------------------------------- targets


def targets(sets: Sequence[Mapping[str, object]], events: Sequence[Mapping[str, object]]) -> Iterator[tuple[str, bool]]:
    """Yield what is asked of the tables, with the figures reached, and whether these reach it."""
    if sets:
        seen = float(np.mean([float(str(one["seen at 3"])) for one in sets]))
        yield f"seen at 3 deviations, in the mean over the sets: {seen:.3f} (.9 asked)", seen >= 0.9
        wanted = math.ceil(0.9 * len(sets))
        for name in ("false", *(f"false, log {seed}" for seed in OTHER_LOGS)):
            few = sum(float(str(one[name])) <= 3 for one in sets)
            said = f"{name.replace('false', 'false alarms')} within 3 times the rate: {few} of {len(sets)}"
            yield f"{said} ({wanted} asked)", few >= wanted
        for kind in ("soon", "lasting"):
            close = sum(one[f"{kind} within {AGREES:g}"] == "yes" for one in sets)
            yield f"{kind}: printed within {AGREES:g} of measured: {close} of {len(sets)}", close >= wanted
    for one in events:
        said = f"{one['plant']}, {one['case']}: {one['found']} of {one['events']}, false {one['false']}"
        false, found = float(str(one["false"])), str(one["found"]) == str(one["events"])
        if one["plant"] == "wind turbine":
            yield said, found and false <= (0.004 if "pitch" in str(one["case"]) else 0.002)
        else:
            said += f", {one['delay']} rows late, {one['share']} of the time in alarm"
            soon = found and float(str(one["delay"])) < SOON
            yield said, soon and false <= RATE


def show(header: Sequence[str], rows: Iterator[dict[str, object]], out: Path | None) -> list[dict[str, object]]:
    """Print rows as they come, write them where that is asked for, and return them."""
    print(*header, sep="\t", flush=True)
    kept = []
    for row in rows:
        kept.append(row)
        print(*(row.get(name, "") for name in header), sep="\t", flush=True)
    if out is not None:
        with out.open("w", newline="") as file:
            writer = csv.DictWriter(file, header, restval="", lineterminator="\n")
            writer.writeheader()
            writer.writerows(kept)
    return kept


def main() -> None:
    """Print the tables, and write them where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", nargs="*", default=[one.name for one in SETS], help="sets by name, of ten")
    parser.add_argument("--skip", nargs="*", default=[], choices=["sets", "events"], help="a table to leave out")
    parser.add_argument("--quick", action="store_true", help="fewer rows and runs: to see that all works")
    parser.add_argument("--out", type=Path, help="a folder")
    asked = parser.parse_args()
    scale, sets, events = QUICK if asked.quick else Scale(), [], []
    if "sets" not in asked.skip:
        rows = (row_of(one, scale) for one in SETS if one.name in asked.set)
        sets = show(HEADER, rows, asked.out and asked.out / "learnt_monitors.csv")
    if "events" not in asked.skip:
        rows = (row for part in (turbine_rows(), hidden_rows()) for row in part)
        events = show(EVENTS, rows, asked.out and asked.out / "learnt_events.csv")
    for said, held in targets(sets, events):
        print("holds:" if held else "MISSED:", said)


if __name__ == "__main__":
    sys.exit(main())
