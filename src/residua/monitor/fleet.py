"""Fleets: many plants of one model or of several, each with its own state, in one block of memory per model."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residua.arrays import aligned
from residua.decide.checks import check_samples
from residua.errors import DataError, NotFittedError, SettingError
from residua.monitor.decision import Decision
from residua.monitor.diagnosis import Diagnosis
from residua.monitor.fleet_block import AlarmEvent, FleetAlarm, FleetBlock, Tick, Worker
from residua.monitor.monitor import Monitor
from residua.monitor.running import Decisions
from residua.monitor.snapshot import restored_blocks, snapshot_of
from residua.shown import Shown, table
from residua.visible import echo, listed
from residua.words import counted


class Fleet(Shown):
    """Many plants that run at once, each with its own state.

    Each plant gives the same bits as a :class:`residua.Monitor` of its own would, whatever the order of records, and
    however the fleet is split. A value that is missing, or an overflow, stays in its own plant. Each plant counts its
    own samples, from its first one on.

    Parameters
    ----------
    monitors : Monitor, or mapping of str to (Monitor, sequence of ids)
        Monitors with thresholds: one for all plants, or several models by name. The state of the monitors themselves
        is not used.
    plants : sequence of hashable, optional
        The ids of the plants, such as their numbers or names, for one monitor.
    threads : int
        Over which the plants are shared; the results do not depend on it. Tests and isolations that are not compiled
        run in one.

    Raises
    ------
    DataError
        If an id occurs twice.
    NotFittedError
        If a monitor has no threshold.

    Notes
    -----
    A fleet belongs to one thread of the caller at a time. A tick, or a block, that is interrupted (by Ctrl-C, or for
    want of memory) happens whole or not at all: it is finished before any other operation of the fleet. In a process
    that is forked while another thread is within a block, the fleet refuses to continue.

    See Also
    --------
    residua.Monitor : One plant, with diagnoses of whole recordings.

    Examples
    --------
    >>> import numpy as np
    >>> import residua as rs
    >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
    >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
    >>> fleet = rs.Fleet(rs.Monitor(rs.design.kalman_filter(plant)), plants=["north", "south", "east"])
    >>> for k in range(80):
    ...     tick = fleet.tick(["south", "north"], np.ones((2, 1)), [[1.0 + (k > 50)], [1.0]])
    >>> tick.alarm
    array([ True, False])
    >>> print(fleet.alarms[0])
    south: level sensor, alarm since 51 s, onset 51 s
    """

    def __init__(
        self,
        monitors: Monitor | Mapping[str, tuple[Monitor, Sequence[Hashable]]],
        plants: Iterable[Hashable] | None = None,
        *,
        threads: int = 1,
    ) -> None:
        check_samples(threads, "threads")
        self.threads = int(threads)
        if isinstance(monitors, Mapping):
            if plants is not None:
                raise SettingError("plants goes with one monitor: of several, each has its own in the mapping")
            parts = {str(name): _pair(name, pair) for name, pair in monitors.items()}
        else:
            if plants is None:
                raise SettingError("plants is missing: the ids of the plants that this monitor watches")
            parts = {"": (_checked_monitor(monitors), list(plants))}
        if not parts:
            raise SettingError("a fleet needs at least one monitor")
        self._worker = Worker()
        self._use({name: FleetBlock(monitor, ids) for name, (monitor, ids) in parts.items()})

    @classmethod
    def _of(cls, blocks: dict[str, FleetBlock], threads: int) -> Fleet:
        fleet = cls.__new__(cls)
        fleet.threads, fleet._worker = threads, Worker()
        fleet._use(blocks)
        return fleet

    def _use(self, blocks: dict[str, FleetBlock]) -> None:
        """Use other blocks, by model; raise if two of them have the same plant."""
        model_of: dict[Hashable, str] = {}
        for name, block in blocks.items() if len(blocks) > 1 else ():
            for plant in block.ids:
                if plant in model_of:
                    raise DataError(f"the plant {echo(plant)} is in {model_of[plant]!r} and in {name!r}")
                model_of[plant] = name
        for block in blocks.values():
            block.worker = self._worker
        self._models = blocks, model_of  # at once: nothing comes between

    @property
    def _blocks(self) -> dict[str, FleetBlock]:
        """The plants by model, after finishing any interrupted work."""
        self._worker.finish()
        return self._models[0]

    # ------------------------------------------------------------------------ facts

    @property
    def plants(self) -> tuple[Hashable, ...]:
        """The ids, model by model, in the order of the state."""
        return tuple(plant for block in self._blocks.values() for plant in block.ids)

    @property
    def models(self) -> tuple[str, ...]:
        """The names of the models; a single empty one for a fleet of one monitor."""
        return tuple(self._blocks)

    def __len__(self) -> int:
        return sum(len(block.ids) for block in self._blocks.values())

    def __contains__(self, plant: object) -> bool:
        return any(plant in block.rows for block in self._blocks.values())

    @property
    def alarms(self) -> list[FleetAlarm]:
        """Standing alarms, with candidates by the last sample, the oldest first for each model."""
        return [alarm for block in self._blocks.values() for alarm in block.alarms()]

    def decision(self, plant: Hashable) -> Decision:
        """Return the decision on the last sample of a plant.

        Raises
        ------
        DataError
            If the fleet has no such plant, or it has had no sample yet.
        """
        block = self._block_with(plant)
        return block.decision(block.rows[plant])

    def _block_with(self, plant: Hashable) -> FleetBlock:
        for block in self._blocks.values():
            if plant in block.rows:
                return block
        raise DataError(f"the fleet has no plant {echo(plant)}")

    # ---------------------------------------------------------------------- running

    def tick(self, ids: Sequence[Hashable] | NDArray | None, u: ArrayLike | None, y: ArrayLike) -> Tick:
        """Process one sample of some plants, or of all.

        Parameters
        ----------
        ids : sequence of ids, or None
            Whose records these are, in any order; several of one plant are applied in their order. ``None``: all plants
            in the order of :attr:`plants`. A tuple that comes again is looked up once.
        u : array_like, shape (records, inputs), or None
        y : array_like, shape (records, outputs)
            In plant units; NaN where a value is missing.

        Returns
        -------
        Tick
            In the order of the records.

        Raises
        ------
        DataError
            If a plant is not known, or the shapes do not fit: nothing is applied then.
        """
        if len(self._blocks) == 1:
            block = next(iter(self._blocks.values()))
            rows = block.places(ids)
            records = len(block.ids) if rows is None else len(rows)
            return block.tick(rows, *_samples(block, u, y, (records,)), self.threads)
        return self._tick_models(self.plants if ids is None else ids, u, y)

    def _tick_models(self, ids: Any, u: ArrayLike | None, y: ArrayLike) -> Tick:
        """Process records of several models, whose numbers of channels must agree."""
        keys = ids.tolist() if isinstance(ids, np.ndarray) else list(ids)
        blocks, model_of = self._blocks, self._models[1]
        try:
            names = np.array([model_of[plant] for plant in keys], dtype=object)
        except KeyError as error:
            raise DataError(f"the fleet has no plant {echo(error.args[0])}: add([...]) it first") from error
        parts = []
        for name, block in blocks.items():
            which = np.flatnonzero(names == name)
            if which.size:
                u_, y_ = _samples(block, u, y, (len(keys),))
                rows = block.places([keys[k] for k in which])
                parts.append((which, *block.jobs_of_tick(rows, u_[which], y_[which], self.threads)))
        out = Tick(*(np.zeros(len(keys), dtype=kind) for kind in (bool, bool, bool, float)))
        self._worker.do(*(job for _, jobs, _ in parts for job in jobs))  # all are checked: nothing is refused now
        for which, jobs, order in parts:
            tick = FleetBlock.ticked(jobs, order)
            for one in ("alarm", "decided", "missing", "statistic"):
                getattr(out, one)[which] = getattr(tick, one)
        return out

    def run(self, recordings: Mapping[Hashable, Any]) -> dict[Hashable, Diagnosis]:
        """Run over whole recordings of some plants, each from a fresh start, as :meth:`residua.Monitor.run` does.

        Parameters
        ----------
        recordings : mapping
            By the ids of the plants: a pair ``(u, y)`` of arrays, or a data frame, a
            :class:`residua.monitor.Recording` or a path, as for :meth:`residua.Monitor.run`.

        Returns
        -------
        dict
            By the ids of the plants a :class:`residua.Diagnosis`, with its alarms. What the fleet remembers stays as it
            is: :meth:`tick`, :meth:`update` and :meth:`follow` go on from their own last samples.

        Raises
        ------
        DataError
            If a plant is not known, before any recording is run, or a recording cannot be used: the message names the
            plant.

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
        >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
        >>> fleet = rs.Fleet(rs.Monitor(rs.design.kalman_filter(plant)), plants=["north", "south"])
        >>> u, level = np.ones((300, 1)), np.where(np.arange(300) < 200, 1.0, 2.0)[:, None]
        >>> found = fleet.run({"north": (u, np.ones((300, 1))), "south": (u, level)})
        >>> {plant: [(alarm.raised, alarm.named) for alarm in one.alarms] for plant, one in found.items()}
        {'north': [], 'south': [(200.0, (('level sensor',),))]}
        """
        if not isinstance(recordings, Mapping):
            raise DataError(
                "give recordings by plant, {plant: (u, y)}; update(u, y) goes on with a block of all plants"
            )
        blocks = {plant: self._block_with(plant) for plant in recordings}
        out: dict[Hashable, Diagnosis] = {}
        for plant, recording in recordings.items():
            pair = isinstance(recording, tuple) and len(recording) == 2
            u, y, source = (*recording, str(plant)) if pair else (recording, None, "")
            try:
                found = blocks[plant].monitor.run(u, y, source=source)
            except DataError as error:
                raise DataError(f"{echo(plant)}: {error}") from error
            if not isinstance(found, Diagnosis):
                raise DataError(f"{echo(plant)}: give one recording, (time, channels), for each plant")
            out[plant] = found
        for block in blocks.values():
            block.monitor.reset()  # its state is not used: each plant has its own
        return out

    def update(self, u: Any, y: Any) -> Decisions | dict[str, Decisions]:
        """Process a block of samples of all plants.

        Parameters
        ----------
        u : array_like, shape (plants, time, inputs), or None
        y : array_like, shape (plants, time, outputs)
            In the order of :attr:`plants`. Of several models: mappings from their names to such arrays, of those that
            have data.

        Returns
        -------
        Decisions, or mapping of str to Decisions
        """
        if not isinstance(y, Mapping):
            if len(self._blocks) > 1:
                raise DataError(f"give u and y by model: mappings with {listed(list(self._blocks))}")
            block = next(iter(self._blocks.values()))
            return block.run(_stacked_block(block, u, y), self.threads)
        for name in y:
            if name not in self._blocks:
                raise DataError(f"the fleet has no model {echo(name)}; it has {listed(list(self._blocks))}")
        data = {name: _stacked_block(self._blocks[name], (u or {}).get(name), one) for name, one in y.items()}
        jobs = {name: self._blocks[name].job_of_run(one, self.threads) for name, one in data.items()}
        self._worker.do(*jobs.values())
        return {name: job.out["decisions"] for name, job in jobs.items()}

    def follow(self, plants: Sequence[Hashable], u: Any, y: Any) -> list[AlarmEvent]:
        """Process a block of samples of some plants of one model, and return the alarms raised and ended.

        Parameters
        ----------
        plants : sequence of ids
            Each once.
        u : array_like, shape (plants, time, inputs), or None
        y : array_like, shape (plants, time, outputs)
            In plant units; NaN where a value is missing.

        Returns
        -------
        list of AlarmEvent
            Alarms that were raised and that have ended, plant by plant in their order, each as it would be in
            :attr:`alarms` after a :meth:`tick` with that very sample: the same however time is cut into blocks. Those
            of a block that was interrupted come first with the next block of its model.

        Raises
        ------
        DataError
            If a plant is unknown, occurs twice, or is of another model than the first; or the shapes do not fit:
            nothing is applied then.

        Examples
        --------
        >>> import numpy as np
        >>> import residua as rs
        >>> plant = rs.Plant([[0.9]], [[0.1]], [[1.0]], dt=1, inputs=["valve"], outputs=["level"])
        >>> plant = plant.with_sensor_faults().with_noise(process=1e-4, measurement=1e-2)
        >>> fleet = rs.Fleet(rs.Monitor(rs.design.kalman_filter(plant)), plants=["north", "south"])
        >>> level = np.where(np.abs(np.arange(300) - 60) < 10, 2.0, 1.0)
        >>> for event in fleet.follow(["south"], np.ones((1, 300, 1)), level[None, :, None]):
        ...     print(event.plant, event.kind, event.onset, event.raised, event.ended, event.candidates[0].name)
        south raised 51.0 51.0 None level sensor
        south ended 51.0 51.0 126.0 level sensor
        """
        keys = list(plants)
        if not keys:
            return []
        block = self._block_with(keys[0])
        rows = block.places(tuple(keys))
        if rows is None:
            rows = np.arange(len(keys))
        if len(np.unique(rows)) < len(rows):
            twice = next(plant for k, plant in enumerate(keys) if plant in keys[:k])
            raise DataError(f"the plant {echo(twice)} occurs twice")
        shape = np.shape(y)
        if len(shape) != 3 or shape[0] != len(keys):
            outputs = block.generator.plant.n_outputs
            raise DataError(f"y must be ({len(keys)} plants, time, {outputs}), got shape {shape}")
        return block.follow(rows, *_samples(block, u, y, shape[:2]), self.threads)

    # --------------------------------------------------------------- plants come and go

    def add(self, plants: Iterable[Hashable], model: str | None = None) -> None:
        """Add plants, before their first sample.

        Parameters
        ----------
        plants : iterable of ids
        model : str, optional
            Which of several.
        """
        name, new = self._model(model), list(plants)
        for plant in new:
            if plant in self:
                raise DataError(f"the plant {echo(plant)} is in the fleet already")
        block = self._blocks[name]
        self._use(self._blocks | {name: FleetBlock.joined([block, FleetBlock(block.monitor, new)])})

    def remove(self, plants: Iterable[Hashable]) -> None:
        """Remove plants and their state."""
        gone = set(plants)
        for plant in gone:
            self._block_with(plant)
        blocks = dict(self._blocks)
        for name, block in blocks.items():
            rows = np.array([row for row, plant in enumerate(block.ids) if plant not in gone], dtype=np.int64)
            if len(rows) < len(block.ids):
                blocks[name] = block.of(rows)
        self._use(blocks)

    def split(self, parts: int) -> list[Fleet]:
        """Return the plants as so many fleets of about the same size, with their states."""
        check_samples(parts, "parts")
        fleets: list[dict[str, FleetBlock]] = [{} for _ in range(parts)]
        for name, block in self._blocks.items():
            for fleet, rows in zip(fleets, np.array_split(np.arange(len(block.ids)), parts), strict=True):
                fleet[name] = block.of(rows)
        return [Fleet._of(blocks, self.threads) for blocks in fleets]

    @staticmethod
    def joined(parts: Sequence[Fleet]) -> Fleet:
        """Return fleets of the same monitors as one, with the states of their plants.

        Raises
        ------
        DataError
            If a plant is in two of them, or a model of the same name has another monitor.
        """
        if not parts:
            raise SettingError("joined needs at least one fleet")
        blocks: dict[str, list[FleetBlock]] = {}
        for fleet in parts:
            for name, block in fleet._blocks.items():
                blocks.setdefault(name, []).append(block)
        for name, ones in blocks.items():
            if any(one.fingerprint != ones[0].fingerprint for one in ones):
                raise DataError(f"the fleets have different monitors{f' of {name!r}' if name else ''}")
        return Fleet._of({name: FleetBlock.joined(ones) for name, ones in blocks.items()}, parts[0].threads)

    # --------------------------------------------------------------------- snapshots

    def snapshot(self, plants: Iterable[Hashable] | None = None) -> bytes:
        """Return the state of all plants, or of some, as bytes: see :mod:`residua.monitor.snapshot`.

        The monitors are not in it, only their fingerprints.
        """
        blocks = self._blocks
        if plants is not None:
            wanted = set(plants)
            for plant in wanted:
                self._block_with(plant)
            blocks = {
                name: block.of(np.array([block.rows[p] for p in block.ids if p in wanted], dtype=np.int64))
                for name, block in blocks.items()
            }
        return snapshot_of(blocks)

    @classmethod
    def restore(cls, content: bytes, monitors: Monitor | Mapping[str, Monitor], *, threads: int = 1) -> Fleet:
        """Return the fleet of a snapshot, which continues equal to the last bit.

        Parameters
        ----------
        content : bytes
            From :meth:`snapshot`. Nothing in it is executed.
        monitors : Monitor, or mapping of str to Monitor
            Those that the fleet ran with, by model.
        threads : int

        Raises
        ------
        FileFormatError
            If the bytes are cut short, changed, of another version, no snapshot, or of another monitor: it says which.
        """
        known = {str(n): m for n, m in monitors.items()} if isinstance(monitors, Mapping) else {"": monitors}
        return cls._of(restored_blocks(content, {n: _checked_monitor(m) for n, m in known.items()}), threads)

    # ----------------------------------------------------------------------- helpers

    def _model(self, model: str | None) -> str:
        if model is None and len(self._blocks) == 1:
            return next(iter(self._blocks))
        if model not in self._blocks:
            raise DataError(f"model must be one of {listed(list(self._blocks))}, got {echo(model)}")
        return str(model)

    def _headline(self) -> str:
        standing = sum(len(block.standing) for block in self._blocks.values())
        models = f" of {len(self._blocks)} models" if len(self._blocks) > 1 else ""
        return f"{counted(len(self), 'plant')}{models}, {standing} in alarm"

    def _parts(self) -> list[str]:
        rows = [
            (str(one.plant), one.raised, one.onset, one.candidates[0].name if one.candidates else "unknown fault")
            for one in self.alarms
        ]
        return [table(["plant", "alarm since [s]", "onset [s]", "most likely"], rows)]


def _pair(name: object, pair: Any) -> tuple[Monitor, list[Hashable]]:
    if not isinstance(pair, Sequence) or len(pair) != 2:
        raise SettingError(f"{echo(name)}: expected a pair of a monitor and the ids of its plants")
    return _checked_monitor(pair[0]), list(pair[1])


def _checked_monitor(monitor: object) -> Monitor:
    if not isinstance(monitor, Monitor):
        raise SettingError(f"a fleet takes monitors, got {echo(monitor)}")
    if not monitor.is_fitted:
        raise NotFittedError(f"the monitor of a fleet needs a threshold: {monitor.test.remedy}")
    return monitor


def _samples(
    block: FleetBlock, u: ArrayLike | None, y: ArrayLike, shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return inputs and outputs as arrays of (*shape, channels), without copies."""
    plant = block.generator.plant
    return _numbers("u", u, plant.inputs, shape), _numbers("y", y, plant.outputs, shape)


def _stacked_block(block: FleetBlock, u: Any, y: Any) -> NDArray[np.float64]:
    shape = np.shape(y)
    if len(shape) != 3 or shape[0] != len(block.ids):
        raise DataError(
            f"y must be ({len(block.ids)} plants, time, {block.generator.plant.n_outputs}), got shape {shape}"
        )
    return np.concatenate(_samples(block, u, y, shape[:2]), axis=2)


def _numbers(name: str, values: Any, channels: tuple[str, ...], shape: tuple[int, ...]) -> NDArray[np.float64]:
    if values is None and not channels:
        return np.zeros((*shape, 0))
    try:
        array = aligned(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must be an array of numbers: {error}") from error
    if array.shape != (*shape, len(channels)):
        raise DataError(
            f"{name} must have shape {(*shape, len(channels))}, a record for each plant with the columns "
            f"{', '.join(channels) or 'none'}, got {array.shape}"
        )
    return array


__all__ = ["Fleet"]
