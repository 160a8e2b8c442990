"""Interface to a view of a run, for the page, the metrics and other readers, from any thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from residua.live.events import Event


class View(Protocol):
    """View of a run; every method may be called from any thread, and returns plain values for JSON.

    Times are in seconds, as in the data: since 1970 where they are dates.
    """

    @property
    def title(self) -> str:
        """Title: the names of the plants' models."""
        ...

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
        ...

    def plant(self, plant: str) -> dict[str, Any] | None:
        """Return one plant with its recent past; ``None`` if there is no such plant.

        ``{"plant", "model", "dt", "dated", "row": as in ``overview``, "time": [t, ...], "statistic": [x or null, ...],
        "threshold": x, "residuals": [{"name", "unit", "values": [x or null, ...], "center": x, "band": x}, ...],
        "signals": [{"name", "unit", "values": [...]}, ...], "alarms": [{"raised", "onset", "ended": time or null,
        "name": text, "sure": text, "lines": [headline, text, ...], "candidates": [{"name", "weight": text}, ...]},
        ...], "missing": [[from, to], ...], "events": [as Event.to_dict with "place"], "notes": [text, ...]}``; series
        are of the last hour or so, thinned to a few hundred points that keep the extremes.
        """
        ...

    def events_after(self, place: int, limit: int = 500, plant: str | None = None) -> Sequence[Event]:
        """Return events after a place in the order of all, the oldest first."""
        ...

    def wait_for_event(self, place: int, timeout: float) -> bool:
        """Wait, for a limited time, for an event after a place; return whether there is one."""
        ...

    def counters(self) -> Mapping[tuple[str, tuple[tuple[str, str], ...]], float]:
        """Return the numbers for the metrics: by name and labels, such as ``("messages", (("source", "mqtt"),))``.

        Counters: ``messages`` by source, ``dropped`` by reason, ``rows`` by model, ``events`` by kind, ``commits``,
        ``delivered``, ``delivery_failures`` and ``given_up`` (:attr:`residua.live.sink.Sink.dropped`) by sink. Gauges:
        ``plants``, ``plants_in_alarm``, ``plants_missing``,
        ``largest_ratio`` (statistic to threshold) and ``oldest_age`` (seconds since the last row) by model and shard,
        ``queue`` (messages that wait), ``behind`` (events that wait) by sink, ``connected`` by source or sink.
        """
        ...

    def ratios(self) -> Mapping[str, float]:
        """Return the ratio of the last statistic to its threshold for every plant, for one series each, on request."""
        ...
