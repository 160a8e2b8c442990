"""The run: messages of all sources through sampling and monitors into the store, in one thread."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residua.errors import DataError
from residua.live.config import SINKS, SOURCES, LiveSettings, adapter
from residua.live.delivery import Delivery
from residua.live.readings import Layout, MessageError, Readings, readings_of, sample_of
from residua.live.sampling import Remark, Rows, SamplingSettings, due, sample
from residua.live.source import Message, MessageQueue, RunStoppedError, Source
from residua.live.store import Changes, Retry, Store, StoreAwayError, store_of
from residua.live.watch import Watch, Work
from residua.live.watched_model import WatchedModel
from residua.live.watched_plant import WatchedPlant
from residua.monitor.monitor import Monitor
from residua.visible import echo, visible

#: Messages that are committed together at most, and bytes of them, unless one alone has more.
AT_ONCE, BYTES_AT_ONCE = 4000, 4_000_000
#: Seconds between two checks of waiting rows, and of everything else that depends on the clock.
_TICK, _SLOW_TICK = 0.1, 2.0
#: Rows of a plant that are looked through for a reading that comes again.
_LOOKED_THROUGH = 4096
#: Events that are dropped together at least.
_DROPPED_AT_ONCE = 1000
#: Plants of which it is said that their step is another one.
_MOST_ODD = 20
#: Characters of a message that the log quotes, and of a whole line about one.
_QUOTED, _LONGEST_LINE = 120, 700
#: Seconds that sinks have at the end.
_LEAVING = 10.0
#: Messages that may wait, and bytes of them.
MOST_MESSAGES, MOST_BYTES = 20_000, 64_000_000
_LOG = logging.getLogger("residua.live")


@dataclass
class Numbers:
    """Counters of a run, for page and metrics.

    Attributes
    ----------
    messages : by source
    dropped : by reason: messages that say nothing usable, and readings that come again or too late
    rows, events : by model, by kind
    commits : int
    """

    messages: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)
    rows: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    commits: int = 0


class Run:
    """A run: one monitor, or several, on live data.

    Parameters
    ----------
    settings : LiveSettings

    Attributes
    ----------
    watch : Watch
    sources : list of Source
    deliveries : list of Delivery
    numbers : Numbers

    Raises
    ------
    FileFormatError
        If a monitor cannot be read.
    DataError
        If the store belongs to other monitors.
    StoreError
        If the store cannot be opened.
    """

    def __init__(self, settings: LiveSettings) -> None:
        self.settings = settings
        self.stopping, self.news = threading.Event(), threading.Condition()
        self.numbers, self.inbox = Numbers(), MessageQueue(MOST_MESSAGES, MOST_BYTES)
        self.models = {
            one.name: WatchedModel(one.name, Monitor.load(one.file), settings.store.history)
            for one in settings.monitors
        }
        self.store: Store = store_of(settings.store)
        self.sources: list[Source] = []
        self.deliveries: list[Delivery] = []
        self._worked, self._whole = False, True
        self.store.open()
        try:
            self._begin()
        except BaseException:
            self.close()
            raise

    def _begin(self) -> None:
        settings, now = self.settings, time.time()
        self.retry = Retry(self.stopping)
        self.watch = Watch(self.models, self.store, self.retry, now, time.monotonic())
        for one in settings.monitors:
            self._check_plants(one.plants, one.name)
            self._commit(self.watch.add(one.plants, one.name, time.monotonic()))
        self._open = {one.name: one.max_plants for one in settings.monitors if one.accept_new}
        plants = {name: self.models[one.model].generator.plant for name, one in self.watch.plants.items()}
        self.sources = [
            adapter(kind, one, SOURCES, *([plants] if kind == "replay" else [])) for kind, one in settings.sources
        ]
        sinks = [adapter(kind, one, SINKS) for kind, one in settings.sinks]
        self._check_names([one.name for one in self.sources], "source")
        self._check_names([one.name for one in sinks], "sink")
        self.committed = self.watch.last_place
        self.deliveries = [Delivery(one, self.store, self.wait_for_event) for one in sinks]
        self._pending = {name for name, one in self.watch.plants.items() if one.sampling.pending}
        self._recent: dict[int, tuple[int, NDArray[np.float64], NDArray[np.float64]]] = {}
        self._sampling = {
            name: SamplingSettings(settings.sampling.wait, settings.sampling.max_age, model.longest_gap)
            for name, model in self.models.items()
        }
        self._logged: dict[str, tuple[float, int]] = {}
        self._dropped = 0
        self._odd_steps: dict[str, str] = {}

    def _check_plants(self, plants: Sequence[str], model: str) -> None:
        for plant in plants:
            known = self.watch.plants.get(plant)
            if known is not None and known.model != model:
                raise DataError(
                    f"the store has the plant {echo(plant)} with the model {echo(known.model)}, the configuration with "
                    f"{echo(model)}: start with a new store, or let it keep its model"
                )

    @staticmethod
    def _check_names(names: Sequence[str], what: str) -> None:
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise DataError(f"two {what}s are called {echo(twice[0])}: give one of them a name of its own: name = ...")

    # ------------------------------------------------------------------------ working

    def work(self, started: Callable[[], None] | None = None) -> None:
        """Work until all sources have ended, or :meth:`stop`; then shut down in order.

        Raises
        ------
        StoreError
            If the store is full or damaged: uncommitted messages were not acknowledged.
        DataError
            If a source has ended because it could not go on.
        """
        ended, self._worked = False, True
        try:
            self._whole = False
            self._take_requests()
            self._whole = True
            times = {one.plant: one.sampling.last for one in self.watch.plants.values() if one.count}
            for source in self.sources:
                source.resume(times)
                source.start(self.inbox.put)
            for delivery in self.deliveries:
                delivery.start()
            if started is not None:
                started()
            ended = self._work()
        except RunStoppedError:
            pass
        finally:
            self._leave(ended)
        wrong = [one for one in self.sources if ended and not one.health.good]
        if wrong:
            raise DataError(f"{wrong[0].name}: {wrong[0].health.text}; what had come before is in the store")

    def _work(self) -> bool:
        """Work; return whether all sources have ended."""
        next_tick = next_slow = 0.0
        while not self.stopping.is_set():
            over = all(one.finite and one.over for one in self.sources)  # asked first: they put before they are over
            messages = self.inbox.take(AT_ONCE, _TICK, BYTES_AT_ONCE)
            self._whole = False  # until changes in memory are in the store
            if messages:
                self.apply(messages)
            now = time.monotonic()
            if now >= next_tick:
                next_tick = now + _TICK
                self._release(min(time.time(), self.inbox.oldest()))
            if now >= next_slow:
                next_slow = now + _SLOW_TICK
                self._look_around(now)
            ended = over and not messages and not len(self.inbox)
            if ended:
                self._release(float("inf"))
                self._commit(self.watch.standing())
            self._whole = True
            if ended:
                return True
        return False

    @property
    def takes_new(self) -> bool:
        """True if plants that are not listed are accepted."""
        return bool(self._open)

    @property
    def problems(self) -> list[str]:
        """Problems that hinder the run, or make its answers doubtful."""
        health = self.retry.health
        store = [] if health.good else [f"store: {health.text}; nothing is acknowledged meanwhile"]
        return [*store, *self._odd_steps.values()]

    def stop(self) -> None:
        """Stop soon; from any thread, or a signal handler."""
        self.stopping.set()
        self.inbox.wake()

    def _leave(self, ended: bool) -> None:
        """Stop sources and sinks, store the states for a quick start, and close the store."""
        self.inbox.close()
        for source in self.sources:
            source.stop()
        try:
            if self._whole and self.retry.health.good:
                self.store.commit(self.watch.rest())
        except StoreAwayError as error:  # the next start then runs some rows again
            _LOG.warning("%s", error)
        finally:
            for delivery in self.deliveries:
                if ended and not delivery.finish(self.committed, _LEAVING):
                    _LOG.warning("sink %s: events wait; the next run delivers them", delivery.sink.name)
            self.stopping.set()
            with self.news:
                self.news.notify_all()
            for delivery in self.deliveries:
                delivery.stop()

    def close(self) -> None:
        """Close the store, once nobody uses it any more; and everything opened, if the run never worked."""
        if not self._worked:
            for source in self.sources:
                source.stop()
            for delivery in self.deliveries:
                delivery.sink.close()
        self.store.close()

    # ------------------------------------------------------------------------ a batch

    def apply(self, messages: Sequence[Message]) -> None:
        """Process messages, commit the results, and acknowledge them."""
        now = time.monotonic()
        readings = self._readings(messages, now)
        work: dict[str, Work] = {}
        touched: set[str] = set()
        for one in readings:
            self._sample(one, now, work, touched)
        changes = self.watch.take(work)
        changes.plants |= self.watch.noted(touched - work.keys()).plants
        self._commit(changes)
        by_source: dict[int, list[Message]] = {}
        for message in messages:
            by_source.setdefault(id(message.source), []).append(message)
        for some in by_source.values():
            some[0].source.acknowledge(some)

    def _readings(self, messages: Sequence[Message], now: float) -> list[Readings]:
        """Return the readings of messages, and add new plants."""
        out: list[Readings] = []
        new: dict[str, None] = {}
        model, most = next(iter(self._open.items()), ("", 0))
        known, models = self.watch.plants, self.models

        def layout(plant: str) -> Layout | None:
            one = known.get(plant)
            if one is not None:
                return models[one.model].layout
            if plant not in new:
                if not model or self.watch.size(model) + len(new) >= most:
                    return None
                new[plant] = None
            return models[model].layout

        for message in messages:
            self.numbers.messages[message.source.name] += 1
            before = len(new)
            try:
                one = readings_of(message, layout)
                one.arrived, one.past = message.arrived, message.source.rereads
                out.append(one)
            except MessageError as error:
                if len(new) > before:  # a plant is added with its first usable message
                    new.popitem()
                self._drop(error.reason, message.source.name, self._quoted(message, error), now)
        if new:
            self._commit(self.watch.add(new, model, now))
        return out

    def _quoted(self, message: Message, error: MessageError) -> str:
        """Describe the error of a message: its line, its beginning, and a sample of a valid one."""
        known = self.watch.plants
        plant = message.plant or next(iter(known), "plant 1")
        model = known[plant].model if plant in known else next(iter(self.models))
        line = f"line {message.line}: " if message.line else ""
        content = message.payload
        if isinstance(content, bytes):
            content = content[: 2 * _QUOTED].decode(errors="replace")
        sample = sample_of(message, self.models[model].layout, plant)
        return f"{line}{error}; got {echo(content, _QUOTED)}, expected such as {sample}"

    def _sample(self, readings: Readings, now: float, work: dict[str, Work], touched: set[str]) -> None:
        """Put readings on the grid of their plant."""
        plant = self.watch.plants[readings.plant]
        model = self.models[plant.model]

        def known(time: float) -> Sequence[float] | None:
            return self._known(plant, time, model.layout.dt)

        before = plant.sampling
        plant.sampling, rows, remarks = sample(before, readings, model.layout.dt, self._sampling[plant.model], known)
        plant.heard = now
        if plant.steps.odd(readings.times, model.layout.dt):
            self._report_step(plant, model.layout.dt)
        self._collect(plant, rows, remarks, work, now)
        if not rows and plant.sampling is not before:
            touched.add(plant.plant)
        if plant.sampling.pending:
            self._pending.add(plant.plant)

    def _report_step(self, plant: WatchedPlant, dt: float) -> None:
        """Report that a plant has another step than its monitor."""
        if plant.plant not in self._odd_steps and len(self._odd_steps) < _MOST_ODD:
            steps = f"sends every {plant.steps.usual:.6g} s, its monitor runs at {dt:g} s"
            text = f"{visible(plant.plant)} {steps}: make one for that step, or send at that of the monitor"
            self._odd_steps[plant.plant] = text
            _LOG.warning("%s", text)

    def _collect(
        self, plant: WatchedPlant, rows: list[Rows], remarks: Sequence[Remark], work: dict[str, Work], now: float
    ) -> None:
        """Add the released rows of a plant to the work of a batch, and count the remarks about its readings."""
        if rows:
            work.setdefault(plant.plant, Work()).rows += rows
            plant.remember(rows)
            self.numbers.rows[plant.model] += sum(len(one.times) for one in rows)
        for one in remarks:
            if one.kind == "clock":
                batch = work.setdefault(plant.plant, Work())
                batch.clocks.append((sum(len(some.times) for some in batch.rows), one.time))
            else:
                self._drop(one.kind, plant.plant, f"at {one.time:.15g} s", now, one.count)

    def _known(self, plant: WatchedPlant, time: float, dt: float) -> Sequence[float] | None:
        """Return the released row of a time: one of the last rows, or a stored one."""
        for rows in reversed(plant.recent):
            near = np.flatnonzero(np.abs(rows.times - time) < 0.5 * dt)
            if near.size:
                return rows.values[near[-1]].tolist()
        kept = self._recent.get(plant.key)
        if kept is None or kept[0] != plant.count:
            if len(self._recent) > 64:
                self._recent.clear()
            kept = (plant.count, *self.watch.last_rows(plant, _LOOKED_THROUGH))
            self._recent[plant.key] = kept
        near = np.flatnonzero(np.abs(kept[1] - time) < 0.5 * dt)
        return kept[2][near[-1]].tolist() if near.size else None

    def _release(self, now: float) -> None:
        """Release rows that have waited long enough."""
        work: dict[str, Work] = {}
        for name in list(self._pending):
            plant = self.watch.plants[name]
            model = self.models[plant.model]
            plant.sampling, rows, remarks = due(plant.sampling, model.layout.dt, self._sampling[plant.model], now)
            self._collect(plant, rows, remarks, work, time.monotonic())
            if not plant.sampling.pending:
                self._pending.discard(name)
        if work:
            self._commit(self.watch.take(work))

    def _look_around(self, now: float) -> None:
        """Report silent plants, process requests in the store, and drop old events."""
        self._commit(self.watch.silent(now, self.settings.sampling.silence))
        self._take_requests()
        done = min((one.position for one in self.deliveries), default=self.committed)
        before = min(done, self.committed - self.settings.store.keep_events)
        if before - self._dropped >= _DROPPED_AT_ONCE:
            self._dropped = before
            self.retry(self.store.drop_events, before)

    def _take_requests(self) -> None:
        """Reset the plants for which it was requested."""
        for name, wanted in self.retry(self.store.meta).items():
            if name.startswith("reset ") and wanted:
                plant = name.removeprefix("reset ")
                changes = self.watch.reset(plant) if plant in self.watch.plants else Changes()
                changes.meta[name] = ""
                self._pending.discard(plant)
                self._recent.clear()
                self._commit(changes)
                _LOG.info("%s begins anew", visible(plant))

    def _commit(self, changes: Changes) -> None:
        if not changes:
            return
        self.retry(self.store.commit, changes)
        self.numbers.commits += 1
        if changes.events:
            self.numbers.events.update(one.kind for one in changes.events)
            with self.news:
                self.committed = changes.events[-1].place
                self.news.notify_all()

    # -------------------------------------------------------------------- reporting

    def _drop(self, reason: str, where: str, text: str, now: float, count: int = 1) -> None:
        """Count dropped messages, and log them at most once a second for each reason."""
        self.numbers.dropped[reason] += count
        last, more = self._logged.get(reason, (-math.inf, 0))
        if now - last < 1.0:
            self._logged[reason] = (last, more + count)
            return
        self._logged[reason] = (now, 0)
        others = f", and {more} more since then" if more else ""
        _LOG.warning("%s: %s (%s)%s", visible(where)[:100], reason, visible(text)[:_LONGEST_LINE], others)

    def wait_for_event(self, place: int, timeout: float) -> bool:
        """Wait, for a limited time, for an event after a place; return whether there is one."""
        with self.news:
            if self.committed <= place:
                self.news.wait(timeout)
            return self.committed > place


__all__ = ["Numbers", "Run"]
