"""Public calls, options, attributes and command options that an earlier tree had and this one has not.

Everything that a room offers counts, with the parameters of its functions and classes and the public members of its
classes; and every option of every command. Each is printed with what takes its place, and those without
a place are an error::

    PYTHONPATH=src python benchmarks/public_calls.py ../before/src --csv docs/data/public_calls.csv
"""

from __future__ import annotations

import argparse
import csv
import importlib
import inspect
import json
import os
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

INTERNAL = "inside of the package; nothing outside needs it"
#: What takes the place of names that are gone, by patterns of their names; the first that fits counts.
REPLACED = {
    r"Diagnosis[.(](center|band|band_share|whitening|averaged|horizon|certified|outside|threshold)\b": "Diagnosis.test",
    r"Diagnosis[.(](signatures|unjudged|window|codes|learnt_faults|groups)\b": "Diagnosis.naming",
    r"Diagnosis[.(](member_\w+|fired|code|tested)\b": "Diagnosis.parts: statistics, thresholds, fired, code, residuals",
    r"Diagnosis[.(](source|origin|resets|predicted|is_unlike_the_fit)\b": "Diagnosis.recording",
    r"Diagnosis[.(](compared|thinned|table|counted)\b": "Diagnosis.recording",
    r"Diagnosis[.(]residual_names\b": "Diagnosis.generator.residuals",
    r"estimator_residual": "UncertainPlant.estimator_residual",
    r"is_diagonal|sampled_norm|slope_errors|Campaign.head|with_chosen\(made|Plan\b": INTERNAL,
    r"mark_of|(monitor_of_text|text_of_monitor)$": "Fleet.snapshot and Monitor.save",
    r"residua \w+ --(order|max-order|past|method|feedthrough|units|name|held-out)$": "--model NAME=VALUE",
    r"residua \w+ --(day-first|month-first)$": "--read dayfirst, --read dayfirst=no",
    r"residua \w+ --(columns|time|dt|variable|tolerance|time-format|fill-gaps|transpose|decimal)$": "--read NAME=VALUE",
    r"Fleet\.run\((u|y)\)": "Fleet.update(u, y) for blocks, Fleet.run(recordings) for whole recordings",
    r"Plant\.Bu$": "Plant.B",
    r"Plant\.Du$": "Plant.D",
    r"\(rtol\)$": "one tolerance for all ranks; a decision within a factor of 1,000 of it is marked near",
    r"treatment_of": INTERNAL,
    r"Alarm\.doubt": "Alarm.word: good match, either, poor match, too early, with its reason",
    r"diagnosis\.(CLOSE_|NO_FIT)|sure_of": "Alarm.word",
    r"decide\.\w+(Test|Names)$": "the settings class, whose fitted(...) returns it; the class stands in the same file",
    r"\bformerly\)?": "names that were never released",
    r"ParityRelations\.size": "ParityRelations.plant.balanced, where time is even",
    r"PerfectObserver\.series": INTERNAL,
    r"fit_table": "fit_lines",
    r"identify\.drift_treatment": "identify.drifting_channels, and the treatment option of each method",
    r"drifts\.(Drifts|drifting_channels|drifts_in)|given_residuals": "the same name in residua.identify",
    r"linear\.(Detectability|ObservabilityForm|RankDecision)|UnknownInputExistence": "its fields near and undecided",
    r"linear\.recursion": "residua.linear.systems.recursion",
    r"with_poles_of": INTERNAL,
    r"older_files|facade\.": INTERNAL,
    r"robust\.bounds\.": "the same name in residua.linear",
    r"residua (learn|identify) --delay$": "--delays INPUT=ROWS,...",
    r"residua learn --average": "learn chooses averages by itself",
    r"residua learn --persistence": "learn chooses its test for --false-alarm-rate",
    r"residua codes --rows": "--structure",
}


def offered() -> dict[str, list[str]]:
    """Return public names with their parameters and members, by the name of what holds them."""
    import residua

    found: dict[str, list[str]] = {}
    modules = [name for _, name, is_room in pkgutil.iter_modules(residua.__path__, "residua.") if is_room]
    for module_name in ["residua", *modules]:
        try:
            module = importlib.import_module(module_name)
        except ImportError:
            continue  # an extra that is not installed
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if not inspect.ismodule(thing):
                found[f"{module_name}.{name}"] = sorted(_parts(thing))
    return found | _commands()


def _parts(thing: Any) -> set[str]:
    """Return the parameters of a call, and the public members of a class with their parameters."""
    parts: set[str] = set()
    if inspect.isclass(thing):
        for name in dir(thing):
            if not name.startswith("_"):
                parts.add(f".{name}")
                member = getattr(thing, name)
                if callable(member):
                    parts |= {f".{name}({option})" for option in _parameters(member)}
        parts |= {f".{name}" for name in getattr(thing, "__dataclass_fields__", ()) if not name.startswith("_")}
    return parts | {f"({option})" for option in _parameters(thing)} if callable(thing) else parts


def _parameters(call: Any) -> list[str]:
    try:
        return [name for name in inspect.signature(call).parameters if name not in ("self", "args", "kwargs")]
    except (TypeError, ValueError):
        return []


def _commands() -> dict[str, list[str]]:
    """Return the options of each command."""
    from typer.main import get_command

    from residua.cli import app

    try:
        commands = {name: app.command(name, []) for name in app.COMMANDS}  # imported when they are called
    except AttributeError:
        commands = get_command(app.app).commands  # pyright: ignore[reportAttributeAccessIssue]  # an earlier tree
    return {
        f"residua {name}": sorted(f" {text}" for part in one.params for text in part.opts if text.startswith("-"))
        for name, one in commands.items()
    }


def main() -> None:
    """Print what is gone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", nargs="?", help="source tree of an earlier package")
    parser.add_argument("--csv", type=Path, help="file to write as well")
    options = parser.parse_args()
    now = offered()
    if options.before is None:
        print(json.dumps(now))
        return
    environment = {**os.environ, "PYTHONPATH": options.before}
    answer = subprocess.run([sys.executable, __file__], env=environment, stdout=subprocess.PIPE, check=True)
    before: dict[str, list[str]] = json.loads(answer.stdout)
    rows = []
    for name, parts in before.items():
        for lost in [name] if name not in now else [name + part for part in parts if part not in now[name]]:
            place = next((text for pattern, text in REPLACED.items() if re.search(pattern, lost)), "")
            rows.append((lost, place))
            print(f"{lost:<70} {place or 'NOTHING'}")
    counts = [sum(1 + len(parts) for parts in tree.values()) for tree in (before, now)]
    print(f"{len(rows)} of {counts[0]} names, parameters and members are gone; there are {counts[1]} now")
    if options.csv is not None:
        with options.csv.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([("gone", "in its place"), *rows])
    sys.exit(any(not place for _, place in rows))


if __name__ == "__main__":
    main()
