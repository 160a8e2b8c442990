"""The command ``run``, which judges recordings by a monitor."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from residua.cli import screen
from residua.cli.call_options import READ, Read
from residua.cli.guard import CANNOT_TELL, ERROR, FAULT, NO_FAULT, UNLIKE, describe, in_cli_words, status_of
from residua.cli.recordings import plant_of, read as read_recording
from residua.cli.shared_options import (
    MonitorFile,
    check_file,
    check_order,
    check_outputs,
    check_recordings,
)
from residua.decide import Candidate
from residua.decide.statement import SHOWN_ALARMS, left_out_text, longest_alarms, ranked, sizes_text, tied_name
from residua.errors import DataError, ResiduaError
from residua.monitor import Diagnosis, Monitor
from residua.monitor.diagnosis import Alarm
from residua.monitor.inputs import settling_reason
from residua.monitor.streaming import judged_file, write_outputs
from residua.recording.columns import ReadOptions
from residua.recording.table_writer import check_table
from residua.report.document import found_values
from residua.report.tables import alarm_times
from residua.report.verdict import verdict
from residua.words import number

#: Bytes of a file from which on it is read piece by piece: about 300 MB of memory at once otherwise.
STREAMED = 50_000_000

#: Exit statuses, from the worst on.
_WORST_FIRST = (ERROR, FAULT, UNLIKE, CANNOT_TELL, NO_FAULT)
#: The answers that they stand for, as counted at the end of several recordings.
_ANSWERS = {
    ERROR: "not judged",
    FAULT: "with an alarm",
    UNLIKE: "unlike the data of the fit",
    CANNOT_TELL: "without an alarm, of a monitor that sees too little",
    NO_FAULT: "without an alarm",
}


def run(
    monitor: MonitorFile,
    recordings: Annotated[
        list[Path], typer.Argument(metavar="DATA.csv...", help="Recordings; each has a start and an answer of its own.")
    ],
    report: Annotated[
        Path | None, typer.Option("--report", metavar="OUT.html", help="Write a page with charts.")
    ] = None,
    alarms: Annotated[
        Path | None, typer.Option("--alarms", metavar="OUT.jsonl", help="Write one JSON object per alarm and line.")
    ] = None,
    residuals: Annotated[
        Path | None,
        typer.Option("--residuals", metavar="OUT.csv", help="Write residuals, statistic, scores; .csv or .parquet."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per recording and line.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing; see the exit status.")] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with status 4 where a monitor without an alarm sees too little.")
    ] = False,
    read: Read = None,
) -> None:
    """Look for faults in recordings.

    Exit status: 0 no alarm, 1 an alarm, 2 error, 3 data unlike those of the fit; of several recordings the worst, in
    the order 2, 1, 3, 4, 0. With several recordings, each output file is written once for each of them, under its
    name with that of the recording: OUT-monday.html.
    """
    check_order("run", monitor, recordings)
    check_file(monitor, "monitor")
    check_recordings(recordings)
    several = len(recordings) > 1
    outputs = [_outputs_of(path if several else None, report, alarms, residuals) for path in recordings]
    _check_apart(recordings, outputs)
    check_outputs([path for one in outputs for path in one.values()], [monitor, *recordings])
    if residuals is not None:
        check_table(residuals)
    watch = Monitor.load(monitor)
    watch.norm_test  # noqa: B018 (without a threshold this raises, before a long file is read)
    form = "nothing" if quiet else "json" if as_json else "text"
    arguments, statuses = READ.values(read), []
    for path, written in zip(recordings, outputs, strict=True):
        if several and form == "text":
            screen.say(*([""] if statuses else []), f"{path}:")
        try:
            statuses.append(_judge(watch, path, arguments, written, form, strict))
        except ResiduaError as error:
            if form == "json":
                screen.print_json({"recording": path, "status": ERROR, "error": describe(error)}, indent=None)
            statuses.append(status_of(error))
    if several and form == "text":
        counts = Counter(statuses)
        answers = ", ".join(f"{counts[one]} {_ANSWERS[one]}" for one in _WORST_FIRST if counts[one])
        screen.say("", f"{len(recordings)} recordings: {answers}")
    raise typer.Exit(min(statuses, key=_WORST_FIRST.index))


def _outputs_of(recording: Path | None, report: Path | None, alarms: Path | None, residuals: Path | None) -> Any:
    """Return the paths for the outputs of a recording; with its name if there are several."""
    named = {"report": report, "alarms": alarms, "residuals": residuals}
    if recording is None:
        return named
    return {k: None if one is None else one.with_stem(f"{one.stem}-{recording.stem}") for k, one in named.items()}


def _check_apart(recordings: Sequence[Path], outputs: Sequence[dict[str, Path | None]]) -> None:
    """Raise if outputs of two recordings would have one name."""
    stems = Counter(path.stem for path in recordings)
    stem, count = stems.most_common(1)[0]
    if count > 1 and any(outputs[0].values()):
        raise DataError(f"{count} recordings are called {stem}: their output files would have one name; run them apart")


def _judge(
    watch: Monitor, path: Path, read: Mapping[str, Any], outputs: dict[str, Path | None], form: str, strict: bool
) -> int:
    """Judge a recording, write and print the answer, and return the exit status."""
    with _diagnosed(watch, path, read) as diagnosis:
        written = write_outputs(diagnosis, **outputs)
        judged = bool(diagnosis.decided.any())
        status = _status(diagnosis, strict) if judged else ERROR
        if form == "json" and judged:
            found = {"recording": path, "status": status, **found_values(diagnosis), "written": written}
            screen.print_json(found, indent=None)
        elif form == "text":
            show_diagnosis(diagnosis)
            if diagnosis.recording.origin:
                screen.say(f"times count from {diagnosis.recording.origin}")
            screen.say(*(f"written: {one}" for one in written))
        if not judged:
            waits = not diagnosis.missing.all()
            settles = f": {settling_reason(watch.generator, watch.settling_samples)}" if waits else ""
            raise DataError(
                f"{path}: no sample could be judged, so there is no verdict: {len(diagnosis.time)} samples, "
                f"{diagnosis.n_missing} of them incomplete; {diagnosis.why_undecided}{settles}"
            )
        return status


def _status(diagnosis: Diagnosis, strict: bool) -> int:
    """Return the exit status of a recording."""
    if diagnosis.fault_detected:
        return FAULT
    kind = verdict(diagnosis).kind
    if diagnosis.recording.is_unlike_the_fit or kind == "outside":
        return UNLIKE
    return CANNOT_TELL if strict and kind == "cannot tell" else NO_FAULT


@contextmanager
def _diagnosed(watch: Monitor, recording: Path, read: Mapping[str, Any]) -> Iterator[Diagnosis]:
    """Yield the diagnosis of a recording, with arrays on disk if it is large."""
    if recording.stat().st_size < STREAMED:
        yield _run(watch, recording, read)
        return
    with ExitStack() as kept:
        first = (read.get(name) for name in ("time", "dt", "columns", "variable"))
        options = replace(ReadOptions(plant_of(watch), *first), **read)  # pyright: ignore[reportArgumentType]
        with screen.progress() as bar:
            whole = kept.enter_context(judged_file(watch, recording, options, bar))
        if whole is not None:
            yield replace(whole, notes=tuple(map(in_cli_words, whole.notes)))
            return
    yield _run(watch, recording, read)


def _run(watch: Monitor, recording: Path, read: Mapping[str, Any]) -> Diagnosis:
    data = read_recording(recording, plant_of(watch), read)
    with screen.progress() as bar:
        diagnosis = watch.run(data, progress=bar)
    assert isinstance(diagnosis, Diagnosis)
    return replace(diagnosis, notes=tuple(map(in_cli_words, diagnosis.notes)))


def show_diagnosis(diagnosis: Diagnosis) -> None:
    """Print the diagnosis of a recording.

    Parameters
    ----------
    diagnosis : Diagnosis
    """
    words = verdict(diagnosis)
    screen.say(words.headline)
    if diagnosis.alarms:
        shown = longest_alarms(diagnosis.alarms, SHOWN_ALARMS)
        worth = "probability" if any(_judged(alarm.candidates) for _, alarm in shown) else "score"
        screen.show_table(
            ["alarm", "began", "raised", "ended", "samples", "most likely", worth, "next", worth, "how sure"],
            [_alarm_row(k, alarm, diagnosis) for k, alarm in shown],
        )
        if len(diagnosis.alarms) > SHOWN_ALARMS:
            screen.say(f"{left_out_text(diagnosis.alarms, SHOWN_ALARMS)} (--alarms writes all of them)")
    if diagnosis.candidates:
        sized = any(c.sizes for c in diagnosis.candidates)
        judged = _judged(diagnosis.candidates)
        screen.show_table(
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
    screen.say(*words.sentences)
    if diagnosis.n_missing:
        screen.say(f"{diagnosis.missing_text}.")
    check = diagnosis.fit_check
    screen.say(*([check.false_alarms] if check and check.false_alarms else []))
    screen.say(*diagnosis.notes)


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
    """Return the probability of a candidate, or its score without one."""
    return f"{candidate.score:.3f}" if candidate.probability is None else number(candidate.probability, 3)


def _unnamed(alarm: Alarm) -> str:
    if alarm.reading is None:
        return "not isolated"
    if alarm.reading.together:
        return " and ".join(" or ".join(group) for group in alarm.reading.together)
    return "one of several, several, or unknown" if alarm.reading.possible else "several, or unknown"
