"""The settings of a threshold test as a record: its kind, and one number, a table or a list of thresholds."""

from __future__ import annotations

from typing import Any

from residua.decide.norm_threshold import NormThreshold
from residua.decide.peak_threshold import PeakThreshold
from residua.errors import FileFormatError
from residua.monitor.encoding import (
    field_names,
    float_in,
    joined,
    record,
    table_in,
    text_in,
    texts_in,
    values_in,
    values_out,
    whole_in,
)
from residua.number_kinds import COUNT, POSITIVE, PROBABILITY
from residua.visible import echo

#: The tests, by the entry ``kind``.
KINDS: dict[str, type[Any]] = {"norm": NormThreshold, "peak": PeakThreshold}


def threshold_out(settings: NormThreshold | PeakThreshold) -> dict[str, Any]:
    """Return the settings of a test as a record."""
    if isinstance(settings, NormThreshold):
        content = {"kind": "norm"} | values_out(settings)
        groups = content.pop("groups")
        if groups is not None:  # an entry where there is something to tell: any other file stays as it was
            content["groups"] = groups if isinstance(groups, str) else {name: list(part) for name, part in groups}
        return content
    given = settings.thresholds
    thresholds = list(given) if isinstance(given, tuple) else dict(given) if isinstance(given, dict) else given
    return {"kind": "peak"} | values_out(settings) | {"thresholds": thresholds}


def threshold_in(value: Any) -> NormThreshold | PeakThreshold:
    """Return the settings of a test from a record."""
    content = table_in(value, "test")
    if "kind" not in content:
        raise FileFormatError("the entry 'test.kind' is missing")
    kind = text_in(content.pop("kind"), "test.kind")
    if kind not in KINDS:
        raise FileFormatError(f"test.kind: expected one of {', '.join(KINDS)}, got {echo(kind)}")
    if kind == "norm":
        return _norm_in(content)
    content = record(content, "test", field_names(PeakThreshold))
    rate = float_in(content["false_alarm_rate"], "test.false_alarm_rate", PROBABILITY)
    window = whole_in(content["window"], "test.window", COUNT)
    return PeakThreshold(_thresholds_in(content["thresholds"]), window, rate)


def _norm_in(content: dict[str, Any]) -> NormThreshold:
    groups = content.pop("groups", None)
    if groups is not None and groups != "each":
        parts = table_in(groups, "test.groups")
        groups = {name: texts_in(part, joined("test.groups", name)) for name, part in parts.items()}
    return values_in(content, "test", NormThreshold, {"groups": groups})


def _thresholds_in(value: Any) -> float | dict[str, float] | list[float] | None:
    where = "test.thresholds"
    if value is None:
        return None
    if isinstance(value, dict):
        return {name: float_in(entry, joined(where, name), POSITIVE) for name, entry in value.items()}
    if isinstance(value, list):
        return [float_in(entry, joined(where, k), POSITIVE) for k, entry in enumerate(value)]
    return float_in(value, where, POSITIVE)
