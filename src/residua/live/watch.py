"""Plants of a run: rows in, events and changes of the store out, the same events for any batches of rows."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.decide.explanation import FINAL, FIRST
from residua.errors import DataError, FileFormatError
from residua.live.events import Event, News, news, those_since
from residua.live.records import rows_from_bytes, rows_to_bytes, state_from_bytes, state_to_bytes
from residua.live.sampling import Rows, SamplingState
from residua.live.store import Changes, PlantUpdate, Retry, Store
from residua.live.watched_model import Judged, WatchedModel, clock_of
from residua.live.watched_plant import WatchedPlant
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fleet_block import FleetBlock
from residua.monitor.plant_records import copied, rows_of, written_rows
from residua.monitor.running import State, initial_state
from residua.visible import echo

#: Outputs wanted for every row.
_ASKED = ("alarm", "missing", "statistic")
#: Rows after which the running state of a plant is stored again: a restart runs so many at most.
STORED_EVERY = 1024
#: So many times the rows that are kept, an alarm that stands longer loses its beginning.
LONGEST_ALARM = 10
#: Rows whose decisions are kept in memory while an alarm stands; those of more plants are made again for every look.
_MOST_JUDGED = 100_000
#: In the order of events at one row.
_RANKS = {"clock": 0, "back": 1, "raised": 2, "renamed": 2, "confirmed": 2, "ended": 2, "missing": 3, "standing": 4}


def _lists() -> Any:
    return defaultdict(list)


@dataclass(slots=True)
class Work:
    """New rows of one plant in a batch.

    Attributes
    ----------
    rows : list of Rows
        In order.
    clocks : list of (int, float)
        That the clock has gone back: after how many of these rows, and to which time.
    """

    rows: list[Rows] = field(default_factory=list)
    clocks: list[tuple[int, float]] = field(default_factory=list)


@dataclass(slots=True)
class _Batch:
    """Result of a batch: changes of the store, events and unstored rows by plant, and moved anchors."""

    changes: Changes = field(default_factory=Changes)
    events: dict[int, list[tuple[int, int, float, str, dict[str, Any]]]] = field(default_factory=_lists)
    fresh: dict[int, list[tuple[int, NDArray[np.float64], NDArray[np.float64]]]] = field(default_factory=_lists)
    moved: set[int] = field(default_factory=set)

    def add(self, plant: WatchedPlant, row: int, time: float, kind: str, content: dict[str, Any]) -> None:
        """Add an event of a plant at a row, to be numbered in the order of rows."""
        self.events[plant.key].append((row, _RANKS[kind], time, kind, content))


class Watch:
    """Watched plants, of one model or of several.

    Parameters
    ----------
    models : mapping of str to WatchedModel
    store : Store
        Open. Its plants are taken over, and go on where they were.
    retry : Retry
        By which rows are read in the course of a batch.
    now : float
        Seconds since 1970.
    heard : float, optional
        When plants count as heard of last; by the clock that :meth:`silent` goes by.

    Raises
    ------
    DataError
        If the store has plants of a model that is not there, or of another monitor.
    """

    def __init__(
        self,
        models: Mapping[str, WatchedModel],
        store: Store,
        retry: Retry,
        now: float,
        heard: float | None = None,
    ) -> None:
        self.models, self.store, self._retry = dict(models), store, retry
        self.plants: dict[str, WatchedPlant] = {}
        self._blocks: dict[str, FleetBlock] = {}
        self._by_place: dict[str, list[WatchedPlant]] = {name: [] for name in models}
        self._judged: dict[int, Judged] = {}
        self.judged = 0
        self.last_place = store.last_place()
        self._check_models(store.meta())
        states: dict[str, list[State]] = {name: [] for name in models}
        for plant, record, running in store.plants():
            if plant.model not in self.models:
                raise DataError(
                    f"the store has the plant {echo(plant.plant)} of the model {echo(plant.model)}, which is not "
                    "configured: name it again, or start with a new store"
                )
            plant.take_record(record, now)
            plant.heard = now if heard is None else heard
            states[plant.model].append(self._recovered(plant, running))
            self._place(plant)
        for name, model in self.models.items():
            ids = [plant.plant for plant in self._by_place[name]]
            self._blocks[name] = FleetBlock(model.monitor, ids, _stacked(model, states[name]))

    def _check_models(self, meta: Mapping[str, str]) -> None:
        for name, model in self.models.items():
            known = meta.get(f"monitor {name}")
            if known is not None and known != model.fingerprint:
                raise DataError(
                    f"the store belongs to another monitor of {echo(name)}, or with other thresholds: begin with a "
                    "new store"
                )

    def _place(self, plant: WatchedPlant) -> None:
        plant.place = len(self._by_place[plant.model])
        self._by_place[plant.model].append(plant)
        self.plants[plant.plant] = plant

    def _recovered(self, plant: WatchedPlant, running: bytes | None) -> State:
        """Return the running state of a plant: the stored one, advanced over the rows since."""
        model = self.models[plant.model]
        state = model.start() if running is None else state_from_bytes(running, model.spec)
        if plant.running_at == plant.count:
            return state
        parts = self.store.rows(plant.key, plant.running_at)
        _, values = rows_from_bytes(parts, len(model.layout.channels), plant.running_at)
        if len(values) != plant.count - plant.running_at:
            raise FileFormatError(f"the store lacks rows of the plant {echo(plant.plant)}: it is damaged")
        return model.run(state, values)

    # ------------------------------------------------------------------- plants come

    def add(self, plants: Iterable[str], model: str, now: float) -> Changes:
        """Add plants before their first row, and return the changes for the store."""
        changes = Changes(meta={f"monitor {name}": one.fingerprint for name, one in self.models.items()})
        new = [plant for plant in dict.fromkeys(plants) if plant not in self.plants]
        for plant in new:
            one = WatchedPlant(len(self.plants) + 1, plant, model, heard=now)
            self._place(one)
            changes.plants[one.key] = PlantUpdate(one.key, plant, model, one.to_record())
        if new:
            block = self._blocks[model]
            more = FleetBlock(block.monitor, new)
            self._blocks[model] = FleetBlock.joined([block, more]) if block.ids else more
        return changes

    # ------------------------------------------------------------------------ rows

    def take(self, work: Mapping[str, Work]) -> Changes:
        """Process the rows of some plants.

        Parameters
        ----------
        work : mapping of str to Work
            By plant.

        Returns
        -------
        Changes
            Changes for the store, events included.
        """
        batch = _Batch()
        waiting: list[tuple[WatchedPlant, NDArray[np.float64], NDArray[np.float64]]] = []
        for name, one in work.items():
            plant = self.plants[name]
            for rows, time in one.clocks:
                text = (
                    "the clock has gone back: readings are refused until they are later than the last row, or a reset"
                )
                batch.add(plant, plant.count + rows, time, "clock", {"until": plant.sampling.last, "text": [text]})
            if one.rows:
                times, values = one.rows[0].times, one.rows[0].values
                if len(one.rows) > 1:
                    times, values = (np.concatenate([getattr(r, n) for r in one.rows]) for n in ("times", "values"))
                waiting.append((plant, times, values))
        while waiting:  # in blocks that end where the anchor of a plant may move
            block, later = [], []
            for plant, times, values in waiting:
                kept = self.models[plant.model].rows_kept
                room = kept - plant.count % kept
                block.append((plant, times[:room], values[:room]))
                if len(times) > room:
                    later.append((plant, times[room:], values[room:]))
            self._advance(block, batch)
            waiting = later
        for name in work:
            self._note(self.plants[name], batch)
        return batch.changes

    def _advance(self, work: list[Any], batch: _Batch) -> None:
        """Run rows of plants, grouped by equal numbers of them."""
        groups: dict[tuple[str, int], list[Any]] = defaultdict(list)
        for one in work:
            groups[one[0].model, len(one[1])].append(one)
        for (name, _), ones in groups.items():
            block, threshold = self._blocks[name], self.models[name].spec.test.threshold
            places = np.array([plant.place for plant, _, _ in ones], dtype=np.int64)
            outputs = block.advance(places, np.stack([values for _, _, values in ones]), _ASKED)
            alarm, missing, statistic = (outputs[name] for name in _ASKED)
            alarmed, gaps = (np.asarray(one.any(axis=1)).tolist() for one in (alarm, missing))
            self.judged += int(np.count_nonzero(np.isfinite(statistic)))
            ratios = (statistic[:, -1] / threshold).tolist()
            for k, (plant, times, values) in enumerate(ones):
                first = plant.count
                plant.count += len(times)
                plant.ratio = ratios[k]
                batch.changes.rows.append((plant.key, first, rows_to_bytes(times, values)))
                batch.fresh[plant.key].append((first, times, values))
                if alarmed[k] or plant.open_row >= 0:
                    self._follow_alarms(plant, first, times, alarm[k].tolist(), batch)
                if gaps[k] or plant.gap or plant.missing is not None:
                    self._follow_gaps(plant, first, times, values, missing[k].tolist(), batch)
                if plant.count % self.models[name].rows_kept == 0:
                    self._move_anchor(plant, batch)

    # ---------------------------------------------------------------------- alarms

    def _follow_alarms(
        self, plant: WatchedPlant, first: int, times: NDArray[np.float64], alarm: list[bool], batch: _Batch
    ) -> None:
        """Look at the alarms of a plant at rows set by the rows alone: the first one, now and then, and the end."""
        model = self.models[plant.model]
        for k, on in enumerate(alarm):
            row = first + k
            if on:
                plant.last_on = row
                if plant.open_row < 0:
                    plant.open_row, plant.open_since = row, float(times[k])
                    plant.next_look = row
            if plant.open_row < 0:
                continue
            over = not on and row - plant.last_on >= model.apart
            if over or row == plant.next_look:
                self._look(plant, row, float(times[k]), over, batch)
                plant.next_look = row + max(model.between, (row - plant.open_row) // 8)
                words = (plant.open_row + count - 1 for count in (FIRST, FINAL))
                plant.next_look = min([plant.next_look, *(at for at in words if at > row)])
            if over:
                plant.open_row, plant.reported = -1, []
                self._judged.pop(plant.key, None)

    def _look(self, plant: WatchedPlant, row: int, time: float, over: bool, batch: _Batch) -> None:
        """Report the changes in the alarms of a plant up to a row."""
        judged = self._judged_to(plant, row + 1, batch)
        alarms = judged.alarms(plant.open_since)
        after, reported = news(plant.reported, alarms, plant.open_since, over)
        if reported:  # only then it matters when they began
            after, reported = news(plant.reported, judged.dated(alarms, plant.open_since), plant.open_since, over)
        plant.reported = after
        for one in reported:
            batch.add(plant, row, time, one.kind, self._content(plant, one))

    def _content(self, plant: WatchedPlant, one: News) -> dict[str, Any]:
        model = self.models[plant.model]
        content = model.alarm_content(one.alarm, clock_of(plant.sampling.dated, model.layout.dt))
        if one.part is None:
            return content
        return {"plant_name": content["plant_name"], "raised": one.part.raised, "onset": one.part.onset} | {
            "part_of": content["raised"],
            "name": content["name"],
        }

    def _judged_to(self, plant: WatchedPlant, stop: int, batch: _Batch) -> Judged:
        """Return the stored rows of a plant, up to one, with the decisions on them."""
        judged = self._judged.pop(plant.key, None)
        model = self.models[plant.model]
        if judged is None or judged.start != plant.anchor_at:
            judged = Judged(model, plant.anchor_at, plant.anchor)
        if judged.stop < stop:
            judged.take(*self._rows_from(plant, judged.stop, stop, batch))
        self._judged[plant.key] = judged  # the last one that was looked at comes last
        kept = sum(one.stop - one.start for one in self._judged.values())
        while kept > _MOST_JUDGED:
            oldest = self._judged.pop(next(iter(self._judged)))
            kept -= oldest.stop - oldest.start
        return judged

    def _rows_from(
        self, plant: WatchedPlant, first: int, stop: int, batch: _Batch
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rows of a plant, the stored ones and those of the batch."""
        fresh = batch.fresh[plant.key]
        begin = fresh[0][0] if fresh else plant.count
        parts = [(number, times, values) for number, times, values in fresh if number + len(times) > first]
        if first < begin:
            stored = [one for one in self._retry(self.store.rows, plant.key, first) if one[0] < begin]
            parts.insert(0, (first, *rows_from_bytes(stored, len(self.models[plant.model].layout.channels), first)))
        begin = parts[0][0]
        times, values = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
        return times[first - begin : stop - begin], values[first - begin : stop - begin]

    # ------------------------------------------------------------------------ gaps

    def _follow_gaps(
        self,
        plant: WatchedPlant,
        first: int,
        times: NDArray[np.float64],
        values: NDArray[np.float64],
        missing: list[bool],
        batch: _Batch,
    ) -> None:
        """Report missing values once the filter has to restart because of them, and their return."""
        model = self.models[plant.model]
        longest = model.longest_gap
        for k, gone in enumerate(missing):
            plant.gap, plant.whole = (plant.gap + 1, 0) if gone else (0, plant.whole + 1)
            if plant.missing is None and plant.gap == longest:
                plant.missing = tuple(np.flatnonzero(~np.isfinite(values[k])).tolist())
                channels = [model.layout.channels[c] for c in plant.missing]
                batch.add(plant, first + k, float(times[k]), "missing", {"channels": channels})
            elif plant.missing is not None and plant.whole == longest:
                plant.missing = None
                batch.add(plant, first + k, float(times[k]), "back", {})

    # --------------------------------------------------------------------- anchors

    def _state(self, plant: WatchedPlant) -> bytes:
        return state_to_bytes(rows_of(self._blocks[plant.model].state, np.array([plant.place])))

    def _move_anchor(self, plant: WatchedPlant, batch: _Batch) -> None:
        """Drop old rows, if no alarm that may not be over needs them, and mark the next place of the anchor."""
        kept = self.models[plant.model].rows_kept
        too_long = plant.open_row >= 0 and plant.count - plant.anchor_at >= LONGEST_ALARM * kept
        if plant.mark is not None and (plant.open_row < 0 or too_long):
            if too_long and plant.open_row < plant.mark_at:
                plant.reported = [replace(one, shortened=k == 0) for k, one in enumerate(plant.reported)]
            plant.anchor, plant.anchor_at = plant.mark, plant.mark_at
            batch.changes.forgotten[plant.key] = plant.anchor_at
        plant.mark, plant.mark_at = self._state(plant), plant.count
        batch.moved.add(plant.key)

    # --------------------------------------------------------------------- storing

    def _note(self, plant: WatchedPlant, batch: _Batch, *, whole: bool = False) -> None:
        """Number the events of a plant, and record its changes."""
        for _, _, time, kind, content in sorted(batch.events.pop(plant.key, []), key=lambda one: one[:2]):
            self._number(plant, time, kind, content, batch.changes)
        batch.changes.plants[plant.key] = self._update(plant, moved=plant.key in batch.moved, whole=whole)

    def _number(self, plant: WatchedPlant, time: float, kind: str, content: dict[str, Any], changes: Changes) -> None:
        if kind in ("raised", "renamed", "confirmed"):
            plant.attribution = (content["name"], content["sure"], content["raised"])
        plant.number += 1
        self.last_place += 1
        event = Event(self.last_place, plant.plant, plant.number, kind, time, _clock(plant, time), content)
        changes.events.append(event)

    def _update(self, plant: WatchedPlant, *, moved: bool = False, whole: bool = False) -> PlantUpdate:
        """Return the update of a plant for the store; with its running state now and then, or if ``whole`` is set."""
        running = None
        late = plant.count - plant.running_at >= STORED_EVERY or plant.running_at < plant.anchor_at  # its rows go
        if late or (whole and plant.running_at != plant.count):
            running, plant.running_at = self._state(plant), plant.count
        anchor, mark = (plant.anchor, plant.mark) if moved else (None, None)
        return PlantUpdate(
            plant.key, plant.plant, plant.model, plant.to_record(), running, plant.running_at, anchor,
            plant.anchor_at, mark, plant.mark_at,
        )  # fmt: skip

    def noted(self, plants: Iterable[str]) -> Changes:
        """Return the changes for plants without new rows: their pending readings."""
        return Changes(plants={p.key: self._update(p) for p in map(self.plants.__getitem__, plants)})

    def rest(self) -> Changes:
        """Return the running states that are not stored yet, so that the next run starts at once."""
        late = [plant for plant in self.plants.values() if plant.running_at != plant.count]
        return Changes(plants={plant.key: self._update(plant, whole=True) for plant in late})

    # --------------------------------------------------------------- without rows

    def silent(self, now: float, after: float) -> Changes:
        """Report plants without data for some seconds, by the clock."""
        changes = Changes()
        for plant in self.plants.values():
            known = math.isfinite(plant.sampling.last)  # not after a reset
            model = self.models[plant.model]
            quiet = max(after, 2 * model.longest_gap * model.layout.dt)
            if known and plant.missing is None and now - plant.heard > quiet:
                channels = list(model.layout.channels)
                plant.missing, plant.whole = tuple(range(len(channels))), 0
                self._number(plant, plant.sampling.last, "missing", {"channels": channels}, changes)
                changes.plants[plant.key] = self._update(plant)
        return changes

    def standing(self) -> Changes:
        """Report the alarms standing at the end of the data."""
        batch = _Batch()
        for plant in self.plants.values():
            if not plant.reported or plant.standing_at == plant.count:
                continue
            plant.standing_at = plant.count
            judged = self._judged_to(plant, plant.count, batch)
            alarms = judged.dated(judged.alarms(plant.open_since), plant.open_since)
            for alarm in those_since(plant.reported, alarms, plant.open_since):
                if alarm.ended is None:
                    content = self._content(plant, News("standing", alarm))
                    batch.add(plant, plant.count, judged.last_time, "standing", content)
            self._note(plant, batch)
        return batch.changes

    def reset(self, plant: str) -> Changes:
        """Reset a plant whose clock has gone back: its filter, its rows, and its known times.

        A standing alarm ends with its present attribution.
        """
        one, batch = self.plants[plant], _Batch()
        model, block = self.models[one.model], self._blocks[one.model]
        if one.reported:
            self._look(one, one.count - 1, one.sampling.last, True, batch)
        block.replace_state(np.array([one.place]), model.start())
        self._judged.pop(one.key, None)
        one.sampling, one.reported, one.open_row, one.ratio = SamplingState(), [], -1, math.nan
        one.anchor = one.mark = state_to_bytes(model.start())
        one.anchor_at = one.mark_at = one.count
        batch.changes.forgotten[one.key] = one.count
        one.running_at = -1  # is stored anew
        batch.moved.add(one.key)
        self._note(one, batch, whole=True)
        return batch.changes

    # --------------------------------------------------------------------- looking

    def diagnosis(self, plant: str) -> Diagnosis | None:
        """Return the diagnosis of the stored rows of a plant; from any thread. ``None`` without any."""
        one = self.plants[plant]
        model, anchor, start = self.models[one.model], one.anchor, one.anchor_at
        parts = self.store.rows(one.key, start)
        if not parts or parts[0][0] > start:  # let go of in this very moment
            return None
        times, values = rows_from_bytes(parts, len(model.layout.channels), start)
        judged = Judged(model, start, anchor)
        judged.take(times, values)
        return judged.diagnosis(one.sampling.dated)

    def last_rows(self, plant: WatchedPlant, most: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the last stored rows of a plant: times and values."""
        first = max(plant.anchor_at, plant.count - most)
        channels = len(self.models[plant.model].layout.channels)
        return rows_from_bytes(self._retry(self.store.rows, plant.key, first), channels, first)

    def size(self, model: str) -> int:
        """Return the number of plants of a model."""
        return len(self._by_place[model])


def _clock(plant: WatchedPlant, time: float) -> str:
    """Return a time as ISO 8601 in UTC, if times are dates."""
    if not plant.sampling.dated or not math.isfinite(time):
        return ""
    try:
        return datetime.fromtimestamp(time, UTC).isoformat().replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError):
        return ""


def _stacked(model: WatchedModel, states: Sequence[State]) -> State | None:
    """Return states of one plant each as one state of all."""
    if not states:
        return None
    whole = copied(initial_state(model.spec, len(states)))
    for k, state in enumerate(states):
        whole = written_rows(whole, np.array([k]), state)
    return whole


__all__ = ["LONGEST_ALARM", "STORED_EVERY", "Watch", "Work"]
