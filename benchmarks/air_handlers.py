"""Air-handling units: days with a stuck or leaking damper or valve, by relations learnt for each operating mode.

    .venv/bin/python benchmarks/air_handlers.py --data FOLDER

FOLDER has the files of the Lawrence Berkeley data set and ``fault_schedule.csv``; it writes
``docs/data/air_handlers.csv``. A day is one sample. Two relations are learnt by :func:`residua.identify.regimes` for
each operating mode from the fault-free days: how much warmer the supply air is than the mixed air, from the mixed air
and the valves, by fan, its speed, cooling valve open or not, heating valve open or not; and how much warmer the mixed
air is than the return air, from the outdoor air that the damper lets in, by fan and its speed. A mode of the coils
that too few fault-free days have at this speed is judged at any speed instead. The statistic of a day is the mean
residual of a relation in a mode.

What it would be on a new fault-free day has Student's distribution, with the scatter of fault-free days that were left
out one by one. There are few of them: three to five of the real unit. In units of the scatter within a day, the days
scatter about equally in all modes of a relation, so that the modes borrow from one another
(:func:`residua.decide.moderated_variances`). Each statistic has the same share of 1 % of fault-free days in alarm;
those beyond it detect the day, and from them the component is read by :func:`residua.decide.consistent_faults` and
what is known of valves and dampers without any data (``codes``). A member that fired beside what a component can do is
a false alarm, with the probability that it is so far out by chance.

A healthy day is judged by models and scatter of the other healthy days. SZCAV and SZVAV, which are one and the same
cell at two times, are learnt together: SZCAV has a single healthy day.

Level, transient, and the fewest rows and days are from the fault-free days alone. The modes by speed and the relation
of the damper, which is zero where it is shut, have the least scatter of fault-free days among those that were compared,
and were looked for after the days with faults had been seen; so were the codes. MZVAV-2-1 came last: nothing was chosen
by it.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

import residua as rs

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "data" / "air_handlers.csv"
UNITS = {
    "SZCAV and SZVAV": ("SZCAV.csv", "SZVAV.csv"),
    "MZVAV-2-2": ("MZVAV-2-2.csv",),
    "MZVAV-2-1": ("MZVAV-2-1.csv",),
}
#: A fault-free day beyond some limit by chance: each of its statistics has the same share of it.
LEVEL = 0.01
#: Fewest rows of a day in a mode that make a statistic, and fewest fault-free days that make a limit.
ROWS, DAYS = 30, 3
#: Commands up to this part are closed: the records have -0.04 to 0.01 for it.
CLOSED = 0.015
#: Chilled water, in degrees Fahrenheit as everything here: what cools in proportion to the air above it.
CHILLED = 45.0
#: Fan speeds on both sides of this are two modes: fault-free days have 0.1, or 0.3 and more.
SLOW = 0.3
#: What is judged: air that stands still has no temperature that a relation could say.
RUNNING = "fan >= 0.5"
#: Minutes after a change of mode that are left out: by the fault-free days, of which 5 leave more scatter.
TRANSIENT = 15

Day = tuple[str, str]
Member = tuple[str, str]
SHORT = {
    "Supply Air Temperature": "supply",
    "Mixed Air Temperature": "mixed",
    "Return Air Temperature": "return",
    "Outdoor Air Temperature": "outdoor",
    "Supply Air Fan Status": "fan",
    "Supply Air Fan Speed Control Signal": "speed",
    "Occupancy Mode Indicator": "occupied",
    "Outdoor Air Damper Control Signal": "damper",
    "Cooling Coil Valve Control Signal": "cooling",
    "Heating Coil Valve Control Signal": "heating",
}
#: The signals of the modes of each relation: what valves do is no matter of how air is mixed.
BY: dict[str, dict[str, list[float]]] = {
    "coil": {"fan": [0.5], "speed": [SLOW], "cooling": [CLOSED], "heating": [CLOSED]},
    "coil at any speed": {"fan": [0.5], "cooling": [CLOSED], "heating": [CLOSED]},
    "mixing": {"fan": [0.5], "speed": [SLOW]},
}
#: What each relation predicts, and from what.
RELATIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "coil": ("rise", ("mixed", "cooling power", "heating power")),
    "coil at any speed": ("rise", ("mixed", "cooling power", "heating power")),
    "mixing": ("mixture", ("outside air", "outside air squared")),
}
#: The relation that stands in for another in modes that are not judged.
INSTEAD = {"coil": "coil at any speed"}
#: The statistics of one valve alone are looked at on one side: that where the effect would be turned round.
ALONE = {"heating alone": -1, "cooling alone": 1}
#: What may be wrong, and the component that it is wrong with.
FAULTS = {
    "heating valve lets too much through": "heating coil valve",
    "heating valve lets too little through": "heating coil valve",
    "heating valve is stuck": "heating coil valve",
    "cooling valve lets too much through": "cooling coil valve",
    "cooling valve lets too little through": "cooling coil valve",
    "cooling valve is stuck": "cooling coil valve",
    "damper": "OA damper",
}


def days(folder: Path, files: Iterable[str]) -> dict[Day, dict[str, NDArray[np.float64]]]:
    """Return the columns of each day of some files, with those that are computed."""
    out = {}
    for name in files:
        with (folder / name).open(newline="", encoding="utf-8-sig") as file:
            header, *lines = csv.reader(file)
        titles = [title.removeprefix("AHU: ").strip() for title in header]
        parts = defaultdict(list)
        for line in lines:
            parts[line[0].split()[0]].append(line)
        for date, rows in parts.items():
            month, day, year = map(int, date.split("/"))
            raw = {SHORT[title]: _numbers(row[j] for row in rows) for j, title in enumerate(titles) if title in SHORT}
            out[name, f"{year}-{month:02d}-{day:02d}"] = raw | computed(raw)
    return out


def _numbers(cells: Iterable[str]) -> NDArray[np.float64]:
    return np.array([np.nan if cell in ("", "#VALUE!") else float(cell) for cell in cells])


def computed(raw: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Return what the relations are between."""
    outside = raw["outdoor"] - raw["return"]
    speed = np.maximum(raw["speed"], 0.1)
    return {
        "rise": raw["supply"] - raw["mixed"],
        "mixture": raw["mixed"] - raw["return"],
        "outside air": outside * raw["damper"],
        "outside air squared": outside * raw["damper"] ** 2,
        "cooling power": raw["cooling"] * (raw["mixed"] - CHILLED) / speed,
        "heating power": raw["heating"] / speed,
    }


def schedule(folder: Path, files: Iterable[str]) -> dict[Day, tuple[str, str]]:
    """Return component and fault of each day; ``"none"`` for fault-free ones."""
    with (folder / "fault_schedule.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {
        (row["file"], row["day"]): (row["component"], f"{row['fault']} {row['intensity']}".strip())
        for row in rows
        if row["file"] in files
    }


@dataclass(frozen=True)
class Learnt:
    """Relations by mode; the standard error of the mean of a new day in each, with its degrees of freedom."""

    models: dict[str, rs.identify.Regimes]
    spread: dict[Member, tuple[float, float]]


def learnt(data: Mapping[Day, dict[str, NDArray[np.float64]]], healthy: list[Day]) -> Learnt:
    """Return what some fault-free days say."""
    models, spread = {}, {}
    for name in RELATIONS:
        models[name] = relation(data, healthy, name)
        within, errors = defaultdict(list), defaultdict(list)
        for day in healthy:
            for member, (_, scatter) in means({name: models[name]}, data[day]).items():
                within[member].append(scatter)
            others = [one for one in healthy if one != day]
            for member, (mean, _) in means({name: relation(data, others, name)}, data[day]).items():
                errors[member].append(mean)
        spread |= moderated({one: rms(values) for one, values in within.items()}, errors)
    return Learnt(models, spread)


def moderated(within: dict[Member, float], errors: dict[Member, list[float]]) -> dict[Member, tuple[float, float]]:
    """Return the standard error of a new day in each mode of a relation, and its degrees of freedom.

    From the scatter within days, and the means of days that were left out.
    """
    members = [one for one in errors if one in within and len(errors[one]) > 1]
    freedom = [len(errors[one]) - 1 for one in members]
    variances = [(rms(errors[one]) / within[one]) ** 2 for one in members]
    if len(members) > 1:
        shared = rs.decide.moderated_variances(variances, freedom)
        variances, freedom = shared.variances.tolist(), shared.freedom.tolist()
    out = {}
    for member, variance, d in zip(members, variances, freedom, strict=True):
        if (n := len(errors[member])) >= DAYS:
            out[member] = within[member] * float(np.sqrt(variance * (1 + 1 / n))), d
    return out


def rms(values: list[float]) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def relation(data: Mapping[Day, dict[str, NDArray[np.float64]]], used: list[Day], name: str) -> rs.identify.Regimes:
    """Return one relation for each operating mode."""
    target, sources = RELATIONS[name]
    channels = [*BY[name], *sources]
    pairs = [(np.column_stack([data[day][c] for c in channels]), data[day][target][:, None]) for day in used]
    return rs.identify.regimes(
        pairs,
        inputs=channels,
        outputs=[target],
        by=BY[name],
        transient=TRANSIENT,
        method=partial(on_sources, sources=sources),
        dt=60.0,
    )


def on_sources(
    rows: list[Any], *, inputs: tuple[str, ...] | None, sources: tuple[str, ...], **names: Any
) -> rs.identify.Regression:
    """Return the regression on the sources alone, without the signals of the modes."""
    inputs = inputs or ()
    kept = [i for i, name in enumerate(inputs) if name in sources]
    chosen = [inputs[i] for i in kept]
    return rs.identify.regression([(u[:, kept], y) for u, y in rows], inputs=chosen or None, **names)


def means(
    models: Mapping[str, rs.identify.Regimes], day: Mapping[str, NDArray[np.float64]]
) -> dict[Member, tuple[float, float]]:
    """Return mean and standard deviation of the residual of each relation in each mode of a day."""
    out = {}
    for name, made in models.items():
        target, sources = RELATIONS[name]
        test = rs.decide.NormThreshold(threshold=1.0, whiten="none")  # the residuals alone are looked at
        monitor = rs.RegimeMonitor(made, test=test, isolate=None, settle=0)
        u = np.column_stack([day[c] for c in (*BY[name], *sources)])
        for mode, one in monitor.run(u, day[target][:, None]).judged.items():
            residual = one.residuals[np.isfinite(one.residuals[:, 0]), 0]
            if len(residual) >= ROWS and mode.startswith(RUNNING):
                out[name, mode] = float(residual.mean()), float(residual.std())
    return out


def statistics(model: Learnt, day: Mapping[str, NDArray[np.float64]]) -> dict[Member, float]:
    """Return the mean residual of each relation in each mode of a day that can be judged.

    What stands in for another relation is there only where that one is not: in modes of the same valves.
    """
    found = {member: mean for member, (mean, _) in means(model.models, day).items() if member in model.spread}
    for name, other in INSTEAD.items():
        judged = {valves(mode) for relation_name, mode in found if relation_name == name}
        found = {
            member: mean for member, mean in found.items() if member[0] != other or valves(member[1]) not in judged
        }
    return found


def valves(mode: str) -> str:
    """Return what a mode says of the valves."""
    return ", ".join(part for part in mode.split(", ") if part.startswith(("cooling", "heating")))


def as_if_shut(
    models: Mapping[str, rs.identify.Regimes], day: Mapping[str, NDArray[np.float64]]
) -> dict[Member, float]:
    """Return by how much more than with both valves shut the air warms up while one of them is open.

    By name of the mode with both shut, and which valve is open: of a healthy unit above zero while heating alone is
    open, below zero while cooling alone is.
    """
    out = {}
    heats, cools = day["heating"] >= CLOSED, day["cooling"] >= CLOSED
    for valve, rows in (("heating", heats & ~cools), ("cooling", cools & ~heats)):
        shut = {"heating": 0.0, "cooling": 0.0, "heating power": 0.0, "cooling power": 0.0}
        changed = {name: np.where(rows, shut.get(name, column), np.nan) for name, column in day.items()}
        for (_, mode), (mean, _) in means({"coil": models["coil"]}, changed).items():
            out[f"{valve} alone", mode] = mean
    return out


def codes(members: list[tuple[str, str, int]]) -> NDArray[np.bool_]:
    """Return which fault may fire which member, (relation, mode, sign), by what valves and dampers do.

    A heating valve warms and a cooling valve cools. What lets too much through does so whatever is commanded; what lets
    too little through shows while it is commanded open; what is stuck lets too much through while it is commanded shut,
    and too much or too little otherwise. While one valve alone is open, only the other one can turn the effect round.
    The damper decides how much outdoor air is mixed in, and no valve acts on the mixing.
    """
    table = []
    for name, mode, sign in members:
        warmer, cooler = sign > 0, sign < 0
        if name == "mixing":
            table.append([False] * 6 + [True])
        elif name in ALONE:  # less warm than without heating: cooled; warmer than without cooling: heated
            table.append([warmer, False, warmer, cooler, False, cooler, False])
        else:
            heats, cools = f"heating >= {CLOSED:g}" in mode, f"cooling >= {CLOSED:g}" in mode
            heating = [warmer, heats and cooler, warmer or heats]
            cooling = [cooler, cools and warmer, cooler or cools]
            table.append([*heating, *cooling, False])
    return np.array(table)


def named(tails: Mapping[tuple[str, str, int], float], share: float) -> str:
    """Return the component that is the likeliest, all three being as likely before: by sums over its faults."""
    fired = [tail < share for tail in tails.values()]
    chance = [max(tail, np.finfo(float).tiny) if tail < share else share for tail in tails.values()]
    prior = {fault: 1e-4 / list(FAULTS.values()).count(component) for fault, component in FAULTS.items()}
    explained = rs.decide.consistent_faults(
        fired, codes(list(tails)), tuple(FAULTS), false_alarm=chance, prior_rates=prior
    )
    sums: dict[str, float] = defaultdict(float)
    for one in explained.candidates:
        for fault in one.faults:
            sums[FAULTS[fault]] += one.probability * prior[fault] / sum(prior[name] for name in one.faults)
    return max(sums, key=lambda component: sums[component])


def verdict(model: Learnt, day: Mapping[str, NDArray[np.float64]]) -> tuple[bool, str, dict[str, float]]:
    """Return whether a day is detected, the component that is named, and the probabilities of chance that say so.

    The probability of the value of each statistic on a fault-free day, or of one further out on its side, is that of
    Student's distribution; those below ``LEVEL`` divided by how many there are have fired.
    """
    found = {(*member, sign): sign * mean for member, mean in statistics(model, day).items() for sign in (1, -1)}
    for (valve, mode), mean in as_if_shut(model.models, day).items():
        found[valve, mode, ALONE[valve]] = ALONE[valve] * mean
    tails = {}
    for (name, mode, sign), value in found.items():
        member = "coil" if name in ALONE else name, mode
        if member in model.spread:
            size, freedom = model.spread[member]
            tails[name, mode, sign] = float(stdtr(freedom, -value / size))
    share = LEVEL / max(1, len(tails))
    low = {f"{'-0+'[sign + 1]} {name}: {mode}": tail for (name, mode, sign), tail in tails.items() if tail < share}
    return bool(low), named(tails, share) if low else "", low


def main() -> None:
    """Write the table, and print the days one by one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("RESIDUA_SHARED_DATA", OUTPUT.parents[3] / "shared" / "data")) / "lbnl_ahu"
    parser.add_argument("--data", type=Path, default=default, help="folder of the data")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="table to write")
    parser.add_argument("--healthy", action="store_true", help="judge the fault-free days alone, and write nothing")
    options = parser.parse_args()
    table = [["unit", "component", "days", "detected", "named right"]]
    for unit, files in UNITS.items():
        data, truth = days(options.data, files), schedule(options.data, files)
        healthy = [day for day in data if day in truth and truth[day][0] == "none"]
        whole = learnt(data, healthy)
        if options.healthy:
            print(whole.spread)
        counts: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
        for day, (component, fault) in truth.items():
            if options.healthy and day not in healthy:
                continue
            model = learnt(data, [one for one in healthy if one != day]) if day in healthy else whole
            detected, named, low = verdict(model, data[day])
            beyond = {member: f"{tail:.2g}" for member, tail in low.items()}
            print(*day, component, fault, "|", "detected" if detected else "-", named, beyond, flush=True)
            for count, value in enumerate((1, detected, named == component)):
                counts["fault-free" if component == "none" else component][count] += value
        table += [[unit, component, *values] for component, values in counts.items()]
    print(*table, sep="\n")
    if not options.healthy:
        with options.output.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(table)


if __name__ == "__main__":
    main()
