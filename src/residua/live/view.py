"""View of a run, for the page and other readers, from any thread; and its numbers in the format of Prometheus."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.live.events import Event
from residua.live.run import Run
from residua.live.source import Health
from residua.live.watched_model import name_of
from residua.live.watched_plant import WatchedPlant
from residua.monitor.diagnosis import Diagnosis
from residua.report.charts import residual_unit
from residua.report.decimate import Bins, choose_bins, spans
from residua.words import listing

#: Points of a series at most.
POINTS = 800
#: Events of a plant that are shown.
_EVENTS = 50
#: Alarms of a plant that are shown.
_ALARMS = 20
#: Digits of a number that is drawn.
_DIGITS = 6
#: Content type of the metrics.
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
#: Names in :meth:`View.counters` that only grow, with their help texts.
COUNTERS = {
    "messages": "Messages that sources have brought.",
    "dropped": "Messages or readings that were dropped.",
    "rows": "Samples that a monitor has judged.",
    "events": "Events.",
    "commits": "Transactions of the store.",
    "delivered": "Events that a sink has delivered.",
    "delivery_failures": "Deliveries that failed, each to be tried again.",
    "given_up": "Events that a receiver refused for good and that were given up.",
}
#: Names of other numbers, with their help texts.
GAUGES = {
    "plants": "Plants that are watched.",
    "plants_in_alarm": "Plants with an alarm that lasts.",
    "plants_missing": "Plants that are not watched because values are missing.",
    "largest_ratio": "Largest statistic over its threshold among the plants: over 1 is over it.",
    "oldest_age_seconds": "Seconds since the last sample of the plant that has waited longest.",
    "queue": "Messages that wait to be read.",
    "behind": "Events that a sink has not delivered yet.",
    "connected": "Whether a source or sink is connected.",
    "plant_ratio": "Last statistic of a plant over its threshold: over 1 is over it.",
}


class View:
    """View of a run; every method may be called from any thread, and returns plain values for JSON.

    Times are in seconds, as in the data: since 1970 where they are dates.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self._run = run

    @property
    def title(self) -> str:
        """Names of the plants' models."""
        return listing(dict.fromkeys(one.generator.plant.name for one in self._run.models.values()))

    # -------------------------------------------------------------------- overview

    def overview(self, first: int = 0, count: int = 100, find: str = "") -> dict[str, Any]:
        """Return an overview, with ``count`` plants from the one numbered ``first`` on.

        Where ``find`` is not empty, only of plants whose id has it in it, upper or lower case: ``plants["matching"]``
        is how many those are (all, where ``find`` is empty), the other counts are of all plants.

        ``{"plants": {"all": n, "fault": n, "missing": n, "waiting": n, "quiet": n, "matching": n}, "rows": [...],
        "sources": [{"name", "kind", "good", "text"}], "sinks": [{"name", "kind", "good", "text", "behind"}],
        "last_event": place, "dated": bool, "problems": [text, ...]}``. ``rows`` are plants, those with a fault first
        (the latest alarm first), then those with missing data, then the others by id: ``{"plant", "state": "fault" |
        "missing" | "waiting" | "quiet", "since": time or null, "time": of the last sample or null, "age": seconds
        since it came or null, "name": text, "sure": text, "ratio": statistic over threshold or null, "rows": number of
        samples}``.
        """
        run = self._run
        plants = list(run.watch.plants.values())
        groups: dict[str, list[WatchedPlant]] = {"fault": [], "missing": [], "waiting": [], "quiet": []}
        for one in plants:
            groups[_state(one)].append(one)
        groups["fault"].sort(key=lambda one: -(one.attribution[2] if one.attribution else 0.0))
        rest = sorted([*groups["waiting"], *groups["quiet"]], key=lambda one: one.plant)
        order = [*groups["fault"], *groups["missing"], *rest]
        wanted = find.casefold()
        order = [one for one in order if wanted in one.plant.casefold()] if wanted else order
        return {
            "plants": {"all": len(plants), "matching": len(order)} | {name: len(some) for name, some in groups.items()},
            "rows": [self._row(one) for one in order[first : first + count]],
            "sources": [_health(one.name, one.kind, one.health) for one in run.sources],
            "sinks": [
                _health(one.sink.name, one.sink.kind, one.health) | {"behind": self._behind(one.position)}
                for one in run.deliveries
            ],
            "last_event": run.committed,
            "dated": any(one.sampling.dated for one in plants),
            "problems": run.problems,
        }

    def _behind(self, position: int) -> int:
        return max(0, self._run.committed - position)

    def _row(self, plant: WatchedPlant) -> dict[str, Any]:
        state = _state(plant)
        name, sure, since = plant.attribution if state == "fault" and plant.attribution else ("", "", None)
        if state == "missing":
            names = self._run.models[plant.model].layout.channels
            name = listing([names[c] for c in plant.missing or ()])
        return {
            "plant": plant.plant,
            "state": state,
            "since": since,
            "time": _number(plant.sampling.last),
            "age": max(0.0, time.monotonic() - plant.heard) if plant.count else None,
            "name": name,
            "sure": sure,
            "ratio": _number(plant.ratio),
            "rows": plant.count,
        }

    # ------------------------------------------------------------------- one plant

    def plant(self, plant: str) -> dict[str, Any] | None:
        """Return one plant with its recent past; ``None`` if there is no such plant.

        ``{"plant", "model", "dt", "dated", "row": as in ``overview``, "time": [t, ...], "statistic": [x or null, ...],
        "threshold": x, "residuals": [{"name", "unit", "values": [x or null, ...], "center": x, "band": x}, ...],
        "signals": [{"name", "unit", "values": [...]}, ...], "alarms": [{"raised", "onset", "ended": time or null,
        "name": text, "sure": text, "lines": [headline, text, ...], "candidates": [{"name", "weight": text}, ...]},
        ...], "missing": [[from, to], ...], "events": [as Event.to_dict with "place"], "notes": [text, ...]}``; series
        are of the last hour or so, thinned to a few hundred points that keep the extremes.
        """
        one = self._run.watch.plants.get(plant)
        if one is None:
            return None
        model = self._run.models[one.model]
        out: dict[str, Any] = {
            "plant": plant,
            "model": one.model,
            "dt": model.layout.dt,
            "dated": one.sampling.dated,
            "row": self._row(one),
            "events": [
                event.to_dict() | {"place": event.place} for event in self._run.store.last_events(plant, _EVENTS)
            ],
        }
        diagnosis = self._run.watch.diagnosis(plant) if one.count else None
        return out | (_nothing(model) if diagnosis is None else self._recent(diagnosis, model.rows_kept))

    def _recent(self, diagnosis: Diagnosis, rows: int) -> dict[str, Any]:
        """Return the series of the last rows, the alarms in them, and the missing values."""
        begin = max(0, len(diagnosis.time) - rows)
        time = diagnosis.time[begin:]
        bins = choose_bins(len(time), POINTS)
        units = diagnosis.generator.plant.units

        def drawn(values: NDArray[np.float64]) -> list[float | None]:
            return _drawn(bins, values[begin:])

        plant = diagnosis.generator.plant
        names = (*plant.inputs, *plant.outputs)
        return {
            "time": [float(t) for t in bins.times(time)],
            "statistic": drawn(diagnosis.statistic),
            "threshold": float(diagnosis.threshold),
            "residuals": [
                {
                    "name": name,
                    "unit": residual_unit(diagnosis, name),
                    "values": drawn(diagnosis.residuals[:, i]),
                    "center": _number(float(diagnosis.test.center[i])),
                    "band": _number(float(diagnosis.test.band[i])),
                }
                for i, name in enumerate(diagnosis.generator.residuals)
            ],
            "signals": [
                {"name": name, "unit": units.get(name, ""), "values": drawn(diagnosis.signals[:, i])}
                for i, name in enumerate(names)
            ],
            "alarms": [self._alarm(diagnosis, one) for one in diagnosis.alarms[-_ALARMS:]],
            "missing": spans(time, _stretches(diagnosis.missing[begin:])),
            "notes": list(diagnosis.notes),
        }

    @staticmethod
    def _alarm(diagnosis: Diagnosis, alarm: Any) -> dict[str, Any]:
        statement = diagnosis.statement(alarm)
        return {
            "raised": alarm.raised,
            "onset": alarm.onset,
            "ended": alarm.ended,
            "name": name_of(alarm),
            "sure": statement.confidence,
            "lines": [statement.headline, *statement.sentences],
            "candidates": [
                {
                    "name": one.name,
                    "weight": f"{one.score:.3f}" if one.probability is None else f"probability {one.probability:.3g}",
                }
                for one in alarm.candidates[:5]
                if math.isfinite(one.score)
            ],
        }

    # ---------------------------------------------------------------------- events

    def events_after(self, place: int, limit: int = 500, plant: str | None = None) -> Sequence[Event]:
        """Return events after a place in the order of all, the oldest first."""
        return self._run.store.events(place, limit, plant)

    def wait_for_event(self, place: int, timeout: float) -> bool:
        """Wait, for a limited time, for an event after a place; return whether there is one."""
        return self._run.wait_for_event(place, timeout)

    # --------------------------------------------------------------------- numbers

    def counters(self) -> Mapping[tuple[str, tuple[tuple[str, str], ...]], float]:
        """Return the numbers for the metrics: by name and labels, such as ``("messages", (("source", "mqtt"),))``.

        Counters: ``messages`` by source, ``dropped`` by reason, ``rows`` by model, ``events`` by kind, ``commits``,
        ``delivered``, ``delivery_failures`` and ``given_up`` (:attr:`residua.live.delivery.Sink.dropped`) by sink.
        Gauges: ``plants``, ``plants_in_alarm``, ``plants_missing``, ``largest_ratio`` (statistic to threshold) and
        ``oldest_age_seconds`` (since the last row) by model and shard, ``queue`` (messages that wait), ``behind``
        (events that wait) by sink, ``connected`` by source or sink.
        """
        run, out = self._run, {}
        for name, label, counter in (
            ("messages", "source", run.numbers.messages),
            ("dropped", "reason", run.numbers.dropped),
            ("rows", "model", run.numbers.rows),
            ("events", "kind", run.numbers.events),
        ):
            for key, count in dict(counter).items():
                out[name, ((label, key),)] = float(count)
        out["commits", ()] = float(run.numbers.commits)
        for one in run.deliveries:
            at = (("sink", one.sink.name),)
            out["delivered", at], out["delivery_failures", at] = float(one.delivered), float(one.failures)
            out["given_up", at] = float(one.sink.dropped)
            out["behind", at] = float(self._behind(one.position))
            out["connected", (("name", one.sink.name), ("part", "sink"))] = float(one.health.good)
        for one in run.sources:
            out["connected", (("name", one.name), ("part", "source"))] = float(one.health.good)
        out["connected", (("name", "store"), ("part", "store"))] = float(run.retry.health.good)
        out["queue", ()] = float(len(run.inbox))
        now = time.monotonic()
        for model in run.models:
            out |= _of_model(model, [one for one in list(run.watch.plants.values()) if one.model == model], now)
        return out

    def ratios(self) -> Mapping[str, float]:
        """Return the ratio of the last statistic to its threshold for every plant, for one series each, on request."""
        return {one.plant: one.ratio for one in list(self._run.watch.plants.values())}


def _of_model(model: str, plants: Sequence[WatchedPlant], now: float) -> dict[Any, float]:
    at = (("model", model), ("shard", "0"))
    states = [_state(one) for one in plants]
    ratios = [one.ratio for one in plants if one.ratio == one.ratio]
    heard = [one.heard for one in plants if one.count]
    return {
        ("plants", at): float(len(plants)),
        ("plants_in_alarm", at): float(states.count("fault")),
        ("plants_missing", at): float(states.count("missing")),
        ("largest_ratio", at): max(ratios, default=math.nan),
        ("oldest_age_seconds", at): max(0.0, now - min(heard)) if heard else math.nan,
    }


def _state(plant: WatchedPlant) -> str:
    """Return the state of a plant, as one word."""
    if plant.reported:
        return "fault"
    if plant.missing is not None:
        return "missing"
    return "quiet" if plant.ratio == plant.ratio else "waiting"


def _health(name: str, kind: str, health: Health) -> dict[str, Any]:
    return {"name": name, "kind": kind, "good": health.good, "text": health.text}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _drawn(bins: Bins, values: NDArray[np.float64]) -> list[float | None]:
    return [float(f"{v:.{_DIGITS}g}") if math.isfinite(v) else None for v in bins.extremes(values).tolist()]


def _stretches(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the stretches of set flags, as first sample and one past the last."""
    padded = np.zeros(len(flags) + 2, dtype=bool)
    padded[1:-1] = flags
    return np.flatnonzero(padded[1:] != padded[:-1]).reshape(-1, 2)


def _nothing(model: Any) -> dict[str, Any]:
    empty: dict[str, Any] = {name: [] for name in ("time", "statistic", "residuals", "signals", "alarms", "missing")}
    return empty | {"threshold": float(model.spec.test.threshold), "notes": []}


def metrics_text(view: View, *, per_plant: bool = False) -> bytes:
    """Return the metrics of a run; with one series for each plant only if ``per_plant`` is set.

    Names begin with ``residua_``; those of counters end in ``_total``.
    """
    numbers = dict(view.counters())
    if per_plant:
        numbers |= {("plant_ratio", (("plant", plant),)): ratio for plant, ratio in view.ratios().items()}
    lines = []
    for family, samples in groupby(sorted(numbers.items()), key=lambda one: one[0][0]):
        counts = family in COUNTERS
        name = f"residua_{family}_total" if counts else f"residua_{family}"
        lines.append(f"# HELP {name} {COUNTERS[family] if counts else GAUGES[family]}")
        lines.append(f"# TYPE {name} {'counter' if counts else 'gauge'}")
        for (_, labels), value in samples:
            inner = ",".join(f'{label}="{_escaped(text)}"' for label, text in labels)
            lines.append(f"{name}{{{inner}}} {float(value)}" if labels else f"{name} {float(value)}")
    return "\n".join([*lines, ""]).encode()


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n").replace('"', r"\"")


__all__ = ["CONTENT_TYPE", "COUNTERS", "GAUGES", "POINTS", "View", "metrics_text"]
