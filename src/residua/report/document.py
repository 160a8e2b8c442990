"""A diagnosis as JSON: the findings, for any reader, and all data to restore the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any

import numpy as np

from residua.decide.alarm import Alarm
from residua.decide.explanation import Explainer, Whitening
from residua.decide.isolation import NoNames
from residua.decide.statement import Statement
from residua.design import ResidualGenerator
from residua.errors import DataError, FileFormatError, ResiduaError
from residua.json_files import check_checksum, dumps, loads
from residua.monitor.design_records import generator_in, generator_out
from residua.monitor.diagnosis import Diagnosis
from residua.number_kinds import REPORTED
from residua.recording.clock import Clock
from residua.records import field_names, float_in, list_in, plain, record, values_in, values_out
from residua.report.verdict import verdict
from residua.visible import echo, shortened

FORMAT, VERSION = "residua-diagnosis", 1
#: The notes of a diagnosis whose text was edited begin with it.
EDITED = "the text of this diagnosis was edited after it was written: its numbers are not those of the monitor"

_APART = ("generator", "isolation", "explainer")


def found_values(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the findings as plain values for JSON: verdict, numbers of samples, alarms and notes."""
    words, totals = verdict(diagnosis), diagnosis.totals
    return {
        "verdict": words.kind,
        "headline": words.headline,
        "sentences": list(words.sentences),
        "fault_detected": diagnosis.fault_detected,
        "samples": totals.samples,
        "judged": totals.decided,
        "incomplete": totals.missing,
        "first": totals.first,
        "last": totals.last,
        "times_from": diagnosis.recording.origin or None,
        "alarms": [plain(alarm.to_dict(window=diagnosis.naming.window)) for alarm in diagnosis.alarms],
        "notes": list(diagnosis.notes),
    }


def document_of(diagnosis: Diagnosis, *, whole: bool) -> str:
    """Return a diagnosis as JSON; without ``whole`` only its findings."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "plant": diagnosis.generator.plant.name,
        "source": diagnosis.recording.source,
    }
    return dumps({**head, **found_values(diagnosis), "whole": _whole(diagnosis) if whole else None})


def _whole(diagnosis: Diagnosis) -> dict[str, Any]:
    explainer = diagnosis.explainer
    explained = explainer and {
        "whitening": values_out(explainer.whitening),
        "colour": [float(one) for one in explainer.colour],
    }
    return values_out(diagnosis, but=_APART) | {
        "generator": generator_out(diagnosis.generator),
        "statements": [values_out(diagnosis.statement(alarm)) for alarm in diagnosis.alarms],
        "explainer": explained,
    }


@dataclass(frozen=True, eq=False)
class Told(NoNames):
    """The statements of an isolation about the alarms of a diagnosis, by their first samples."""

    statements: Mapping[int, Statement] = field(default_factory=dict)

    def statement(self, alarm: Alarm, clock: Clock, window: int) -> Statement:
        """Return the statement about one of the alarms."""
        if alarm.start not in self.statements:
            raise DataError("a diagnosis from JSON has statements about its own alarms alone")
        return self.statements[alarm.start]


def diagnosis_of(text: str | bytes) -> Diagnosis:
    """Return the diagnosis of a text.

    Raises
    ------
    FileFormatError
        If the text is none, or was changed.
    """
    source = "the text"
    content = loads(text.encode("utf-8", "surrogatepass") if isinstance(text, str) else bytes(text), source)
    if content.get("format") != FORMAT:
        raise FileFormatError(f'{source} is not a diagnosis of residua (no "format": {FORMAT!r} in it)')
    if content.get("version") != VERSION:
        raise FileFormatError(
            f"{source} has schema version {echo(content.get('version'))}, this residua reads version {VERSION}: run "
            "the monitor again with this version"
        )
    is_as_written = check_checksum(content, source)
    if content.get("whole") is None:
        raise FileFormatError(f"{source} has what was found alone, and no series: write it by to_json(whole=True)")
    try:
        with np.errstate(all="ignore"):  # overflow is refused later
            made = _diagnosis_in(content["whole"])
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError, MemoryError, ResiduaError) as error:
        raise FileFormatError(f"{source}: {shortened(str(error), 1000)}") from error
    return made if is_as_written else replace(made, notes=(EDITED, *made.notes))


def _diagnosis_in(value: Any) -> Diagnosis:
    names = [name for name in field_names(Diagnosis) if name not in _APART]
    content = record(value, "whole", (*names, "generator", "statements", "explainer"))
    generator = generator_in(content.pop("generator"), "whole.generator")
    statements = list_in(content.pop("statements"), "whole.statements")
    explainer = _explainer_in(content.pop("explainer"), generator)
    known = {"generator": generator, "isolation": NoNames(), "explainer": explainer}
    made: Diagnosis = values_in(content, "whole", Diagnosis, known, REPORTED)
    _check_shapes(made)
    if len(statements) != len(made.alarms):
        raise FileFormatError(f"whole.statements must be {len(made.alarms)}, one for each alarm")
    told = [values_in(one, f"whole.statements.{k}", Statement, usual=REPORTED) for k, one in enumerate(statements)]
    starts = [alarm.start for alarm in made.alarms]
    return replace(made, isolation=Told(statements=dict(zip(starts, told, strict=True))))


def _explainer_in(value: Any, generator: ResidualGenerator) -> Explainer | None:
    if value is None:
        return None
    content = record(value, "whole.explainer", ("whitening", "colour"))
    whitening = values_in(content["whitening"], "whole.explainer.whitening", Whitening)
    where = "whole.explainer.colour"
    return Explainer(generator, whitening, tuple(float_in(one, where) for one in list_in(content["colour"], where)))


def _check_shapes(made: Diagnosis) -> None:
    """Raise if series, names and alarms do not fit together."""
    time, k, plant = len(made.time), made.generator.n_residuals, made.generator.plant
    members = len(made.members) if made.members else 0
    shapes = {
        "time": (time,),
        "residuals": (time, k),
        **dict.fromkeys(("statistic", "alarm", "decided", "missing"), (time,)),
        "scores": (time, len(made.groups)),
        "test.center": (k,),
        "test.band": (k,),
        "signals": (time, len(plant.inputs) + len(plant.outputs)) if len(made.signals) else made.signals.shape,
        **(dict.fromkeys(("parts.statistics", "parts.fired"), (time, members)) if members else {}),
        **({"parts.thresholds": (members,)} if members else {}),
        **({"parts.code": (time, members)} if made.naming.codes else {}),
    }
    for name, shape in shapes.items():
        array = attrgetter(name)(made)
        if array.shape != shape:
            raise FileFormatError(f"whole.{name} must have shape {shape}, got {array.shape}")
    if made.match is not None:
        for name, array in vars(made.match).items():
            shape = (time,) if name in ("fault", "arrival", "source") else (time, len(made.generator.faults))
            if array.shape != shape:
                raise FileFormatError(f"whole.match.{name} must have shape {shape}, got {array.shape}")
    if not all(
        len(pair) == 2 and 0 <= pair[0] < k and 0 <= pair[1] < plant.n_outputs for pair in made.recording.compared
    ):
        raise FileFormatError(
            f"whole.recording.compared must be pairs of one of {k} residuals and one of {plant.n_outputs} outputs"
        )
    if any(not 0 <= row < k for rows in made.parts.residuals.values() for row in rows):
        raise FileFormatError(f"whole.parts.residuals must be numbers of {k} residuals")
    samples = made.totals.samples
    for j, alarm in enumerate(made.alarms):
        if not 0 <= alarm.start < alarm.stop <= samples:
            raise FileFormatError(f"whole.alarms.{j} must lie within the {samples} samples of the recording")


__all__ = ["FORMAT", "VERSION", "diagnosis_of", "document_of", "found_values"]
