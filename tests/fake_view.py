"""A run that is not there, for the tests of its page: plants play simulated three-tank recordings, row by row."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from typing import Any

import numpy as np

import residua as rs
from residua.arrays import runs
from residua.decide import NormThreshold
from residua.library import simulate_three_tank, three_tank, three_tank_fault
from residua.live.events import Event
from residua.report.text import rounded
from residua.report.verdict import verdict

#: Where the clock of the plants starts.
START = datetime(2026, 11, 24, 5, 0, tzinfo=UTC).timestamp()
ONSET, STEPS, DRAWN = 200.0, 1400, 600


@cache
def diagnoses() -> dict[str, rs.Diagnosis]:
    """One recording with a leak of tank 3, and one without a fault, of the three-tank benchmark; with a gap each."""
    monitor = rs.Monitor(
        rs.design.kalman_filter(three_tank()), test=NormThreshold(persistence=5, window=10, false_alarm_rate=0.002)
    )
    normal = simulate_three_tank(8000, seed=1)
    monitor.fit(normal.u, normal.y, time=normal.time)
    out = {}
    for name, faults in {"leak": three_tank_fault(9, STEPS, onset=ONSET), "healthy": None}.items():
        played = simulate_three_tank(STEPS, faults=faults, seed=3)
        y = played.y.copy()
        y[90:120, 0] = np.nan
        found = monitor.run(played.u, y, time=played.time)
        assert isinstance(found, rs.Diagnosis)
        out[name] = found
    return out


@dataclass
class Played:
    """One plant: what it plays, and how many rows of it have come."""

    diagnosis: rs.Diagnosis
    rows: int = 0
    number: int = 0


@dataclass
class FakeView:
    """A view of plants that each play one of :func:`diagnoses`."""

    plants: dict[str, Played]
    title: str = "three tanks"
    start: float = START
    dated: bool = True
    age: float = 0.5
    events: list[Event] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    sources: list[dict[str, Any]] = field(default_factory=list)
    sinks: list[dict[str, Any]] = field(default_factory=list)
    changed: threading.Condition = field(default_factory=threading.Condition)

    @classmethod
    def of(cls, plants: Mapping[str, str], **settings: Any) -> FakeView:
        """Return a view of plants by what they play, ``"leak"`` or ``"healthy"``."""
        return cls({name: Played(diagnoses()[kind]) for name, kind in plants.items()}, **settings)

    # -------------------------------------------------------- what happens

    def play(self, rows: int, *plants: str) -> None:
        """Let so many rows come, of all plants or of some, with the events of their alarms and gaps."""
        for name in plants or self.plants:
            played = self.plants[name]
            d, begin, end = played.diagnosis, played.rows, min(played.rows + rows, len(played.diagnosis.time))
            played.rows = end
            for a, b in runs(d.missing):
                if begin <= a < end:
                    self.tell(name, "missing", d.time[a], channels=["h1"])
                if begin <= b < end:
                    self.tell(name, "back", d.time[b])
            for alarm in d.alarms:
                if begin <= alarm.start < end:
                    best = alarm.candidates[0].name if alarm.candidates else ""
                    told = {"name": best, "sure": verdict(d).confidence, "text": list(verdict(d).sentences)}
                    self.tell(name, "raised", alarm.raised, **told)

    def tell(self, plant: str, kind: str, time: float, **content: Any) -> Event:
        """Let an event happen."""
        with self.changed:
            played = self.plants[plant]
            played.number += 1
            t = self.start + float(time)
            clock = datetime.fromtimestamp(t, UTC).isoformat() if self.dated else ""
            self.events.append(Event(len(self.events) + 1, plant, played.number, kind, t, clock, content))
            self.changed.notify_all()
            return self.events[-1]

    # ------------------------------------------------------------- the view

    def overview(self, first: int = 0, count: int = 100, find: str = "") -> dict[str, Any]:
        rows = [self._row(name) for name in self.plants]
        order = {"fault": 0, "missing": 1, "waiting": 2, "quiet": 3}
        counts = {state: sum(row["state"] == state for row in rows) for state in order}
        rows = [row for row in rows if find.lower() in row["plant"].lower()]
        rows.sort(key=lambda row: (order[row["state"]], -(row["since"] or 0), row["plant"]))
        return {
            "plants": {"all": len(self.plants), **counts, "matching": len(rows)},
            "rows": rows[first : first + count],
            "sources": list(self.sources),
            "sinks": list(self.sinks),
            "last_event": len(self.events),
            "dated": self.dated,
            "problems": list(self.problems),
        }

    def _row(self, name: str) -> dict[str, Any]:
        played = self.plants[name]
        d, n = played.diagnosis, played.rows
        row: dict[str, Any] = {"plant": name, "state": "waiting", "since": None, "time": None, "name": "", "sure": ""}
        row |= {"ratio": None, "rows": n, "age": self.age if n else None}
        if n:
            statistic = d.statistic[n - 1]
            row |= {"state": "quiet", "time": self.start + float(d.time[n - 1])}
            row["ratio"] = float(statistic / d.threshold) if np.isfinite(statistic) else None
            if d.missing[n - 1]:
                since = next(a for a, b in runs(d.missing) if a <= n - 1 < b)
                row |= {"state": "missing", "since": self.start + float(d.time[since]), "name": "h1"}
            alarm = next((a for a in d.alarms if a.start < n <= a.stop), None)
            if alarm is not None:
                row |= {"state": "fault", "since": self.start + alarm.raised, "sure": verdict(d).confidence}
                row["name"] = alarm.candidates[0].name if alarm.candidates else ""
        return row

    def plant(self, plant: str) -> dict[str, Any] | None:
        if plant not in self.plants:
            return None
        played = self.plants[plant]
        d, n = played.diagnosis, played.rows
        last = max(0, n - DRAWN)
        names = (*d.generator.plant.inputs, *d.generator.plant.outputs)
        alarms = [a for a in d.alarms if last <= a.start < n]
        return {
            "plant": plant,
            "model": "three tanks",
            "dt": d.generator.dt,
            "dated": self.dated,
            "row": self._row(plant),
            "time": (self.start + d.time[last:n]).tolist(),
            "statistic": rounded(d.statistic[last:n]),
            "threshold": float(d.threshold),
            "residuals": [
                {
                    "name": name,
                    "unit": "cm",
                    "values": rounded(d.residuals[last:n, i]),
                    "center": float(d.test.center[i]),
                    "band": float(d.test.band[i]),
                }
                for i, name in enumerate(d.generator.residuals)
            ],
            "signals": [
                {"name": name, "unit": "", "values": rounded(d.signals[last:n, i])} for i, name in enumerate(names)
            ],
            "alarms": [self._alarm(d, a, n) for a in alarms],
            "missing": [
                [self.start + float(d.time[a]), self.start + float(d.time[min(b, n) - 1])]
                for a, b in runs(d.missing)
                if a < n and b > last
            ],
            "events": [e.to_dict() | {"place": e.place} for e in self.events if e.plant == plant],
            "notes": [],
        }

    def _alarm(self, d: rs.Diagnosis, alarm: Any, n: int) -> dict[str, Any]:
        over = alarm.ended is not None and alarm.stop <= n
        return {
            "raised": self.start + alarm.raised,
            "onset": self.start + alarm.onset,
            "ended": self.start + alarm.ended if over else None,
            "name": alarm.candidates[0].name if alarm.candidates else "",
            "sure": verdict(d).confidence,
            "lines": [verdict(d).headline, *verdict(d).sentences],
            "candidates": [{"name": c.name, "weight": f"{c.score:.3f}"} for c in alarm.candidates[:3]],
        }

    def events_after(self, place: int, limit: int = 500, plant: str | None = None) -> Sequence[Event]:
        with self.changed:
            return [e for e in self.events[place:] if plant is None or e.plant == plant][:limit]

    def wait_for_event(self, place: int, timeout: float) -> bool:
        with self.changed:
            return self.changed.wait_for(lambda: len(self.events) > place, timeout)

    def counters(self) -> Mapping[tuple[str, tuple[tuple[str, str], ...]], float]:
        counts = self.overview()["plants"]
        model = (("model", "three tanks"), ("shard", "0"))
        out: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {
            ("plants", model): counts["all"],
            ("plants_in_alarm", model): counts["fault"],
            ("plants_missing", model): counts["missing"],
            ("largest_ratio", model): max(self.ratios().values(), default=0.0),
            ("oldest_age_seconds", model): 0.5,
            ("rows", (("model", "three tanks"),)): sum(p.rows for p in self.plants.values()),
            ("commits", ()): 12,
            ("queue", ()): 0,
            ("dropped", (("reason", "not JSON"),)): 3,
            ("dropped", (("reason", 'a "quoted"\nreason'),)): 1,
        }
        for kind in {e.kind for e in self.events}:
            out["events", (("kind", kind),)] = sum(e.kind == kind for e in self.events)
        for one in self.sources:
            out["messages", (("source", one["name"]),)] = 100
            out["connected", (("source", one["name"]),)] = one["good"]
        for one in self.sinks:
            sink = (("sink", one["name"]),)
            out |= {("delivered", sink): 7, ("delivery_failures", sink): 2, ("given_up", sink): 0}
            out |= {("behind", sink): one["behind"], ("connected", sink): one["good"]}
        return out

    def ratios(self) -> Mapping[str, float]:
        return {name: row["ratio"] for name in self.plants if (row := self._row(name))["ratio"] is not None}
