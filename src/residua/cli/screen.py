"""What the commands print: tables on a terminal, plain columns in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from time import monotonic
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from residua.analysis import Diagnosability
from residua.decide import Candidate, Directional, Structured
from residua.decide.directional import direction_test
from residua.decide.sizes import fault_unit
from residua.decide.statement import SHOWN_ALARMS, left_out_text, longest_alarms, ranked, sizes_text, tied_name
from residua.decide.structured import codes_of
from residua.design import MatchedFilters, ResidualGenerator
from residua.monitor.diagnosis import Alarm, Diagnosis
from residua.monitor.fit_check import FitCheck
from residua.monitor.visible_sizes import HEADER
from residua.report.tables import alarm_times
from residua.report.verdict import verdict
from residua.visible import visible
from residua.words import counted, number

#: Columns of a pipe or file: wide enough that nothing is cut.
_PIPE_WIDTH = 10_000
#: Seconds of work after which a progress bar appears.
_PATIENCE = 2.0
#: Bytes from which on reading a file takes long enough to say so.
_LARGE_FILE = 20_000_000


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to the guard, which knows the exit statuses."""
        raise BrokenPipeError


def console() -> Console:
    """Return a console on stdout; names are shown as they are, never taken as markup."""
    width = None if sys.stdout.isatty() else _PIPE_WIDTH
    return _Console(file=sys.stdout, width=width, markup=False, highlight=False, emoji=False)


def say(*lines: str) -> None:
    """Print lines; a terminal wraps them, a pipe gets them whole."""
    out = console()
    for line in map(visible, lines):
        out.print(line, soft_wrap=not out.is_terminal)


def show_table(header: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = "") -> None:
    """Print a table: with lines on a terminal, as plain columns elsewhere. Columns of numbers go right."""
    cells = [[_text(value) for value in row] for row in rows]
    out = console()
    if title:
        out.print(visible(title))
    if not out.is_terminal:
        for line in _columns([[visible(name) for name in header], *cells]):
            out.print(line, soft_wrap=True)
        return
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, name in enumerate(map(visible, header)):
        numeric = bool(cells) and all(_is_number(row[k]) for row in cells)
        table.add_column(name, justify="right" if numeric else "left")
    for row in cells:
        table.add_row(*row)
    out.print(table)


def _columns(rows: list[list[str]]) -> list[str]:
    """Return rows padded to equal columns, without blanks at the end."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]


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


# ----------------------------------------------------------------- diagnosability


def show_diagnosability(answer: Diagnosability) -> None:
    """Print which faults of a plant can be detected and isolated, and why the others cannot."""
    plant = answer.plant
    time = f"sampled at {plant.dt:g} s" if plant.is_discrete else "continuous"
    say(
        f"{plant.name}: {counted(plant.n_states, 'state')}, {counted(len(plant.inputs), 'input')}, "
        f"{counted(plant.n_outputs, 'output')}, {counted(len(plant.disturbances), 'disturbance')}, "
        f"{counted(len(plant.faults), 'fault')}, {time}"
    )
    show_table(
        [
            "fault",
            "kind",
            "component",
            "detectable",
            "when constant",
            "cannot be told from",
            "nor, when constant, from",
        ],
        [
            [
                name,
                plant.fault_kinds[i],
                plant.fault_components[i],
                answer.detectable[i],
                answer.strongly_detectable[i],
                ", ".join(_twins(answer.groups, name)),
                ", ".join(answer.constant_twins(name)),
            ]
            for i, name in enumerate(answer.faults)
        ],
    )
    why = [f"{name}: {reason}" for name, reason in answer.reasons().items()]
    say(*(why or ["every fault can be detected, also when constant, and told from every other"]))
    if plant.disturbances:
        say(str(answer.unknown_input_observer))
    else:
        say("no disturbances: an ordinary observer will do")


def _twins(groups: Iterable[tuple[str, ...]], name: str) -> list[str]:
    """Return the others in the group of a fault."""
    return [other for group in groups if name in group for other in group if other != name]


def diagnosability_values(answer: Diagnosability) -> dict[str, Any]:
    """Return the same as plain values for JSON."""
    plant, reasons, existence = answer.plant, answer.reasons(), answer.unknown_input_observer
    return {
        "plant": plant.name,
        "dt": plant.dt,
        "states": list(plant.states),
        "inputs": list(plant.inputs),
        "outputs": list(plant.outputs),
        "disturbances": list(plant.disturbances),
        "faults": [
            {
                "name": name,
                "kind": plant.fault_kinds[i],
                "component": plant.fault_components[i],
                "detectable": bool(answer.detectable[i]),
                "strongly_detectable": bool(answer.strongly_detectable[i]),
                "visibility": float(answer.visibility[i]),
                "not_isolable_from": _twins(answer.groups, name),
                "not_isolable_when_constant_from": list(answer.constant_twins(name)),
                "reason": reasons.get(name),
            }
            for i, name in enumerate(answer.faults)
        ],
        "isolable": answer.isolable.tolist(),
        "strongly_isolable": answer.strongly_isolable.tolist(),
        "groups": [list(group) for group in answer.groups],
        "unknown_input_observer": {
            "exists": existence.exists,
            "useful": existence.useful,
            "reasons": list(existence.reasons),
            "rank_CE": existence.rank_CE.rank,
            "rank_E": existence.rank_E.rank,
            "fixed_poles": [[float(p.real), float(p.imag)] for p in existence.fixed_poles],
        },
    }


# ------------------------------------------------------------------------- design


def show_signatures(generator: ResidualGenerator, isolate: Directional) -> None:
    """Print what the residual does for each fault, and which faults look the same."""
    test = direction_test(isolate, generator.subspaces, generator.steady_directions, np.eye(generator.n_residuals))
    n = generator.n_residuals
    rows = []
    for name in generator.faults:
        k = generator.subspaces[name].shape[1]
        steady = float(np.linalg.norm(generator.steady_directions[name]))
        if k == 0:
            shape = "no response"
        elif k == n:
            shape = "steady direction only" if steady else "no fixed direction"
        else:
            shape = "line" if k == 1 else "plane" if k == 2 else f"{k}-dimensional"
        rows.append([name, shape, steady, ", ".join(_twins(test.groups, name))])
    show_table(["fault", "signature", "steady residual per unit", "cannot be told from"], rows)
    if test.unjudged:
        say(f"never named, for want of a signature: {', '.join(test.unjudged)}")


def show_codes(generator: ResidualGenerator, isolate: Structured) -> None:
    """Print which members of a bank fire for each fault, and which faults have the same code."""
    test = codes_of(generator, isolate)
    rows = []
    for name in generator.faults:
        columns = [(g, name in test.settled[g]) for g, group in enumerate(test.groups) if name in group]
        for g, later in sorted(columns, key=lambda column: column[1]) or [(None, False)]:
            code = np.zeros(len(test.members), dtype=bool) if g is None else test.codes[:, g]
            twins = [] if g is None else [other for other in test.groups[g] if other != name]
            label = f"{name}, settled" if later else name
            rows.append([label, *("x" if on else "." for on in code), ", ".join(twins)])
    show_table(["fault", *test.members, "cannot be told from"], rows)
    if any(test.settled):
        say("settled: which members the fault still fires once it is constant")
    if test.unjudged:
        say(f"never named, for want of a code: {', '.join(test.unjudged)}")
    if not test.strongly_isolating:
        say("a code is part of another: a pattern with members silent is not read as degraded")


def show_responses(matched: MatchedFilters) -> None:
    """Print how well matched filters see each fault, and which faults look the same."""
    half, whole = matched.deviation(matched.window // 2), matched.deviation()
    plant = matched.generator.plant
    rows = []
    for name in matched.faults:
        note = "not seen" if name in matched.unseen else "vanishes" if name in matched.vanishing else "stays"
        twins = [] if name in matched.unseen else _twins(matched.groups, name)
        rows.append([name, note, half[name], whole[name], fault_unit(plant, name), ", ".join(twins)])
    header = ["fault", "once constant", f"deviation of its size after {matched.window // 2} samples"]
    show_table([*header, f"after {matched.window}", "unit", "cannot be told from"], rows)
    say("a fault of about six deviations is found within that many samples")


# ---------------------------------------------------------------------- diagnosis


def show_diagnosis(diagnosis: Diagnosis) -> None:
    """Print the diagnosis of a recording.

    Parameters
    ----------
    diagnosis : Diagnosis
    """
    words = verdict(diagnosis)
    say(words.headline)
    if diagnosis.alarms:
        shown = longest_alarms(diagnosis.alarms, SHOWN_ALARMS)
        worth = "probability" if any(_judged(alarm.candidates) for _, alarm in shown) else "score"
        show_table(
            ["alarm", "began", "raised", "ended", "samples", "most likely", worth, "next", worth, "how sure"],
            [_alarm_row(k, alarm, diagnosis) for k, alarm in shown],
        )
        if len(diagnosis.alarms) > SHOWN_ALARMS:
            say(f"{left_out_text(diagnosis.alarms, SHOWN_ALARMS)} (--alarms writes all of them)")
    if diagnosis.candidates:
        sized = any(c.sizes for c in diagnosis.candidates)
        judged = _judged(diagnosis.candidates)
        show_table(
            [
                *("rank", "candidate", *(["probability"] if judged else []), "score", "distance"),
                *(["estimated size"] if sized else []),
            ],
            [
                [
                    *(k, c.name, *([number(c.probability, 3)] * judged), f"{c.score:.3f}", f"{c.distance:.3f}"),
                    *([sizes_text(c.sizes)] * sized),
                ]
                for k, c in ranked(diagnosis.candidates)
            ],
            title="candidates of the longest alarm" if len(diagnosis.alarms) > 1 else "",
        )
    say(*words.sentences)
    if diagnosis.n_missing:
        say(f"{diagnosis.missing_text}.")
    check = diagnosis.fit_check
    say(*([check.false_alarms] if check and check.false_alarms else []))
    say(*diagnosis.notes)


def show_visible(check: FitCheck) -> None:
    """Print how much a fitted monitor predicts, and the smallest constant faults that it sees."""
    say(*([check.explains] if check.explains else []))
    if not check.visible:
        return
    show_table(HEADER, [one.cells for one in check.visible])


def _alarm_row(k: int, alarm: Alarm, diagnosis: Diagnosis) -> list[object]:
    best, following = [*alarm.candidates, None, None][:2]
    return [
        k,
        *alarm_times(alarm, diagnosis.clock),
        alarm.samples,
        best.name if best else _unnamed(alarm),
        _worth(best) if best else None,
        tied_name(alarm.candidates, 2) if following else None,
        _worth(following) if following else None,
        alarm.word.kind if alarm.word else None,
    ]


def _judged(candidates: Iterable[Candidate]) -> bool:
    """Tell whether candidates have probabilities."""
    return any(c.probability is not None for c in candidates)


def _worth(candidate: Candidate) -> str:
    """Return the probability of a candidate, or its score where it has none."""
    return f"{candidate.score:.3f}" if candidate.probability is None else number(candidate.probability, 3)


def _unnamed(alarm: Alarm) -> str:
    if alarm.reading is None:
        return "not isolated"
    if alarm.reading.together:
        return " and ".join(" or ".join(group) for group in alarm.reading.together)
    return "not told which, several, or not known" if alarm.reading.possible else "several, or not known"


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Say on a terminal that a large file is being read."""
    err = Console(stderr=True, markup=False, highlight=False)
    if err.is_terminal and path.stat().st_size > _LARGE_FILE:
        with err.status(f"reading {visible(path.name)}"):
            yield
    else:
        yield


@contextmanager
def patience(what: str) -> Iterator[None]:
    """Say on stderr what is being done, once two seconds have gone; a terminal shows how long it has taken."""
    err = Console(stderr=True, markup=False, highlight=False)
    bar = Progress(
        SpinnerColumn(), TextColumn(visible(what), markup=False), TimeElapsedColumn(), console=err, transient=True
    )

    def show() -> None:
        if err.is_terminal:
            bar.add_task("", total=None)
            bar.start()
        else:
            print(f"{visible(what)} ...", file=sys.stderr, flush=True)

    clock = Timer(_PATIENCE, show)
    clock.daemon = True
    clock.start()
    try:
        yield
    finally:
        clock.cancel()
        clock.join()
        if err.is_terminal and bar.tasks:
            bar.stop()


class _Bar:
    """A progress bar on stderr that appears only when the work takes long."""

    def __init__(self) -> None:
        self.started = monotonic()
        self.bar: Progress | None = None
        self.task: Any = None

    def __call__(self, done: int, total: int) -> None:
        """Show how far the work is."""
        if self.bar is None and done < total and monotonic() - self.started > _PATIENCE:
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
