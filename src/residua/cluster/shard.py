"""The plants of one shard: packed rows in, a table of events out, a blob of bytes in between."""

from __future__ import annotations

import copy
import struct
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residua.cluster.packed_rows import EXACT, PackedRows, checked_shards, pyarrow, shard_of
from residua.decide.checks import check_samples
from residua.errors import DataError, FileFormatError
from residua.files import other_version
from residua.monitor.fleet_block import AlarmEvent, FleetBlock
from residua.monitor.monitor import Monitor
from residua.monitor.snapshot import restored_blocks, snapshot_of
from residua.visible import echo
from residua.words import counted

#: The mark and the version of a blob.
MARK, VERSION = b"RESIDUAS", 1
_HEAD, _CHECK = struct.Struct("<8sIIQ"), struct.Struct("<Q")
#: The columns and their types in Spark; ``plant`` is a text or a whole number, as it came.
EVENT_COLUMNS = {
    "kind": "string",
    "plant": "string",
    "sample": "bigint",
    "onset": "double",
    "raised": "double",
    "ended": "double",
    "names": "array<string>",
    "scores": "array<double>",
    "cause": "string",
    "reason": "string",
}
#: The kind of a record that was put aside.
ASIDE = "aside"
#: The longest gap in samples that is filled with missing ones, when nothing else is asked for.
LONGEST_GAP = 100_000
#: Numbers that are run at once.
_AT_ONCE = 1 << 22


@dataclass(frozen=True)
class Aside:
    """A record that was put aside.

    Attributes
    ----------
    plant : int, str or None
    start : int
        The number of its first sample.
    cause : {"incomplete", "number", "width", "unknown plant", "late", "gap", "begin"}
    reason : str
        In words, with the numbers.
    """

    plant: Any
    start: int
    cause: str
    reason: str


@dataclass(frozen=True)
class Taken:
    """Results of some records: a table with a row for each event of an alarm, and for each record put aside.

    Attributes
    ----------
    events : list of AlarmEvent
    aside : list of Aside
    """

    events: list[AlarmEvent]
    aside: list[Aside]

    def __bool__(self) -> bool:
        return bool(self.events or self.aside)

    def columns(self) -> dict[str, list[Any]]:
        """Return events, and then records put aside, as columns."""
        events, aside = self.events, self.aside
        return {
            "kind": [one.kind for one in events] + [ASIDE] * len(aside),
            "plant": [one.plant for one in (*events, *aside)],
            "sample": [one.sample for one in events] + [one.start for one in aside],
            **{name: [getattr(one, name, None) for one in (*events, *aside)] for name in ("onset", "raised", "ended")},
            "names": [[c.name for c in one.candidates] for one in events] + [None] * len(aside),
            "scores": [[c.score for c in one.candidates] for one in events] + [None] * len(aside),
            **{name: [getattr(one, name, None) for one in (*events, *aside)] for name in ("cause", "reason")},
        }

    def arrow(self, whole: bool) -> Any:
        """Return the table as one of Arrow; ``whole``: whether ids are whole numbers."""
        pa = pyarrow()
        types = {"string": pa.string(), "bigint": pa.int64(), "double": pa.float64()}
        types |= {"array<string>": pa.list_(pa.string()), "array<double>": pa.list_(pa.float64())}
        columns = self.columns()
        fields = {name: types[kind] for name, kind in EVENT_COLUMNS.items()} | ({"plant": pa.int64()} if whole else {})
        return pa.table({name: pa.array(columns[name], kind) for name, kind in fields.items()})


class Shard:
    """Plants that share a monitor, each at its own sample.

    Parameters
    ----------
    monitor : Monitor
        Fitted.
    shards : int
        How many shards there are in all; it goes into the bytes.
    plants : collection of ids, optional
        Those that are known; any other is put aside. When omitted, every plant begins with its first record.
    longest_gap : int
        Samples that did not come are missing ones, as far as this; a record that is further ahead is put aside.
    from_zero : bool
        Whether a plant whose first record does not begin at its sample 0 is put aside.
    """

    def __init__(
        self,
        monitor: Monitor,
        *,
        shards: int = 1,
        plants: Collection[Any] | None = None,
        longest_gap: int = LONGEST_GAP,
        from_zero: bool = False,
    ) -> None:
        check_samples(longest_gap, "longest_gap", least=0)
        self.shards, self.plants = checked_shards(shards), None if plants is None else frozenset(plants)
        self.longest_gap, self.from_zero = int(longest_gap), bool(from_zero)
        self.monitor = monitor
        self._block = FleetBlock(monitor, [])
        self._origins = np.zeros(0, dtype=np.int64)
        plant = monitor.generator.plant
        self._inputs, self._channels = len(plant.inputs), (*plant.inputs, *plant.outputs)

    def __len__(self) -> int:
        return len(self._block.ids)

    @property
    def ids(self) -> list[Any]:
        """The plants."""
        return list(self._block.ids)

    # ----------------------------------------------------------------------- records

    def take(self, rows: PackedRows) -> Taken:
        """Process records: in any order within a call, and after those of earlier calls.

        Rows of one plant are applied in the order of their numbers. Samples that are missing between them are missing
        values; samples that came already are not applied again, and the row is put aside as ``late``. Of two rows with
        the same numbers and other values the first in the order of their bytes counts, so that the outcome does not
        depend on the order in which they come.
        """
        aside: list[Aside] = []
        good = self._sorted(rows, self._usable(rows, aside), aside)
        if not good.size:
            return Taken([], aside)
        places = self._places(rows, good)
        start, samples = rows.start[good], rows.samples[good]
        ends = start + samples
        first = np.concatenate([[True], places[1:] != places[:-1]])
        due = np.where(first, self._due()[places], np.concatenate([[0], ends[:-1]]))
        odd = np.isin(places, places[start != due])
        events = self._regular(rows, good[~odd], places[~odd])
        for place in np.unique(places[odd]).tolist():
            events += self._with_gaps(rows, good[places == place], place, aside)
        return Taken(events, aside)

    def _due(self) -> NDArray[np.int64]:
        """Return the number of the next sample of each plant."""
        return self._origins + self._block.state.count

    def _usable(self, rows: PackedRows, aside: list[Aside]) -> NDArray[np.int64]:
        """Return the rows that are valid records of a plant, and put the others aside with the error."""
        width, sizes = len(self._channels), np.diff(rows.offsets)
        number = (rows.start >= 0) & (rows.samples >= 1) & (rows.start < EXACT) & (rows.samples < EXACT)
        fits = sizes == np.where(number, rows.samples, 0) * width
        plants = self.plants
        known = np.array([True if plants is None else plant in plants for plant in rows.plants], dtype=bool)
        for row in np.flatnonzero(~(rows.complete & number & fits & known)).tolist():
            plant, start, samples = rows.plants[row], int(rows.start[row]), int(rows.samples[row])
            if not rows.complete[row]:
                cause, reason = "incomplete", "a column of this record is empty"
            elif not number[row]:
                cause, reason = "number", f"invalid numbers: start {start}, {samples} samples"
            elif not fits[row]:
                said = f"{counted(int(sizes[row]), 'number')} for {counted(samples, 'sample')} of {width} channels"
                cause, reason = "width", f"{said}: {echo(', '.join(self._channels))}"
            else:
                cause, reason = "unknown plant", f"the plant {echo(plant)} is not watched"
            aside.append(Aside(plant, start, cause, reason))
        return np.flatnonzero(rows.complete & number & fits & known)

    def _sorted(self, rows: PackedRows, good: NDArray[np.int64], aside: list[Aside]) -> NDArray[np.int64]:
        """Return rows by plant and number, the longer one first; new plants are added."""
        begins: dict[Any, int] = {}
        known = self._block.rows
        for row in good.tolist():
            plant = rows.plants[row]
            if plant not in known:
                begins[plant] = min(int(rows.start[row]), begins.get(plant, EXACT))
        if self.from_zero and any(begins.values()):
            late = {plant for plant, begin in begins.items() if begin}
            for row in good.tolist():
                if rows.plants[row] in late:
                    reason = "the samples before it are not here: all rows of a plant belong in one batch"
                    aside.append(Aside(rows.plants[row], int(rows.start[row]), "begin", reason))
            good = np.array([row for row in good.tolist() if rows.plants[row] not in late], dtype=np.int64)
            begins = {plant: begin for plant, begin in begins.items() if not begin}
        if begins:
            self._block = FleetBlock.joined([self._block, FleetBlock(self.monitor, list(begins))])
            self._origins = np.concatenate([self._origins, np.array(list(begins.values()), dtype=np.int64)])
        places = self._places(rows, good)
        start, samples = rows.start[good], rows.samples[good]
        order = np.lexsort((-samples, start, places))
        same = (np.diff(places[order]) == 0) & (np.diff(start[order]) == 0) & (np.diff(samples[order]) == 0)
        if same.any():
            keys = zip(places.tolist(), start.tolist(), (-samples).tolist(), map(rows.of, good), strict=True)
            by_bytes = [(*key, numbers.tobytes()) for *key, numbers in keys]
            order = np.array(sorted(range(len(good)), key=by_bytes.__getitem__), dtype=np.int64)
        return good[order]

    def _places(self, rows: PackedRows, which: NDArray[np.int64]) -> NDArray[np.int64]:
        at = self._block.rows
        return np.fromiter((at[rows.plants[row]] for row in which.tolist()), dtype=np.int64, count=len(which))

    def _regular(self, rows: PackedRows, which: NDArray[np.int64], places: NDArray[np.int64]) -> list[AlarmEvent]:
        """Process sorted rows that follow each other without a gap; plants with equal numbers of samples together."""
        if not which.size:
            return []
        sizes = (rows.offsets[which + 1] - rows.offsets[which]).astype(np.int64)
        if (sizes == sizes[0]).all() and len(rows.values) == len(rows) * sizes[0]:
            values = rows.values.reshape(len(rows), -1)[which].ravel()
        else:
            values = np.concatenate([rows.of(row) for row in which.tolist()])
        heads = np.flatnonzero(np.concatenate([[True], places[1:] != places[:-1]]))
        lengths = np.add.reduceat(sizes, heads)
        ends, who = np.cumsum(lengths), places[heads]
        events = []
        for length in np.unique(lengths).tolist():
            some = np.flatnonzero(lengths == length)
            if len(some) == len(heads):
                data = values
            else:
                data = np.concatenate([values[ends[k] - length : ends[k]] for k in some.tolist()])
            events += self._go_on(who[some], data.reshape(len(some), -1, len(self._channels)))
        return events

    def _with_gaps(
        self, rows: PackedRows, which: NDArray[np.int64], place: int, aside: list[Aside]
    ) -> list[AlarmEvent]:
        """Process sorted rows of one plant, some of which came late or follow a gap."""
        width, due = len(self._channels), int(self._due()[place])
        parts: list[NDArray[np.float64]] = []
        for row in which.tolist():
            plant, start, samples = rows.plants[row], int(rows.start[row]), int(rows.samples[row])
            data = rows.of(row).reshape(samples, width)
            if start > due + self.longest_gap:
                reason = (
                    f"it is {start - due} samples ahead of what came before, more than longest_gap={self.longest_gap}"
                )
                aside.append(Aside(plant, start, "gap", reason))
                continue
            if start < due:
                came = min(due - start, samples)
                aside.append(Aside(plant, start, "late", f"{came} of its {samples} samples came before: not applied"))
                data = data[came:]
            elif start > due:
                parts.append(np.full((start - due, width), np.nan))
            parts.append(data)
            due = max(due, start + samples)
        if not any(len(part) for part in parts):
            return []
        return self._go_on(np.array([place]), np.concatenate(parts)[None])

    def _go_on(self, places: NDArray[np.int64], data: NDArray[np.float64]) -> list[AlarmEvent]:
        """Process a block, (plants, time, channels), in pieces that do not take much memory."""
        events: list[AlarmEvent] = []
        piece = max(1, _AT_ONCE // max(1, len(places) * len(self._channels)))
        for start in range(0, data.shape[1], piece):
            part = data[:, start : start + piece]
            events += self._block.follow(places, part[..., : self._inputs], part[..., self._inputs :], 1)
        return [self._numbered(event) for event in events]

    def _numbered(self, event: AlarmEvent) -> AlarmEvent:
        """Return an event with the sample numbers of the plant's records."""
        origin = int(self._origins[self._block.rows[event.plant]])
        if not origin:
            return event
        ended = None if event.ended_sample is None else event.ended_sample + origin
        numbers = {"onset_sample": event.onset_sample + origin, "raised_sample": event.raised_sample + origin}
        return replace(event, **numbers, ended_sample=ended)

    # -------------------------------------------------------------------- other plants

    def keep(self, plants: Collection[Any]) -> None:
        """Remove all plants but some."""
        rows = np.array([row for row, plant in enumerate(self._block.ids) if plant in plants], dtype=np.int64)
        if len(rows) < len(self):
            self._block, self._origins = self._block.of(rows), self._origins[rows]

    def split(self, shards: int) -> dict[int, Shard]:
        """Return the plants by shard, for a given number of shards."""
        numbers = np.array([shard_of(plant, shards) for plant in self._block.ids], dtype=np.int64)
        parts = {}
        for number in np.unique(numbers).tolist():
            rows = np.flatnonzero(numbers == number)
            parts[number] = self._with(self._block.of(rows), self._origins[rows], checked_shards(shards))
        return parts

    def _with(self, block: FleetBlock, origins: NDArray[np.int64], shards: int) -> Shard:
        """Return a shard of other plants, with the settings of this one."""
        shard = copy.copy(self)
        shard._block, shard._origins, shard.shards = block, origins, shards
        return shard

    @staticmethod
    def joined(parts: Sequence[Shard]) -> Shard:
        """Return shards of the same monitor as one.

        Raises
        ------
        DataError
            If a plant is in two of them, or their numbers of shards differ.
        """
        first = parts[0]
        if any(part.shards != first.shards for part in parts):
            raise DataError(f"the parts are of different numbers of shards: {sorted({part.shards for part in parts})}")
        block, origins = FleetBlock.joined([part._block for part in parts]), [part._origins for part in parts]
        return first._with(block, np.concatenate(origins), first.shards)

    # --------------------------------------------------------------------------- bytes

    def to_bytes(self) -> bytes:
        """Return the state: the mark ``RESIDUAS``, version, number of shards, number of plants, the numbers of their
        first samples (64 bits each, little-endian), a CRC-32 of all that, and :meth:`residua.Fleet.snapshot`.
        """
        head = _HEAD.pack(MARK, VERSION, self.shards, len(self)) + self._origins.astype("<i8").tobytes()
        return head + _CHECK.pack(zlib.crc32(head)) + snapshot_of({"": self._block})

    def restored(self, content: bytes) -> Shard:
        """Return the shard restored from bytes, with the settings of this one.

        Raises
        ------
        FileFormatError
            If the bytes are cut short or changed, or of another monitor or number of shards: it says which.
        """
        shards, origins, snapshot = _parts(bytes(content))
        if shards != self.shards:
            raise FileFormatError(
                f"this state is that of one of {shards} shards, the job has {self.shards}: "
                f"go on with shards={shards}, or bring the state over (resharded)"
            )
        block = restored_blocks(snapshot, {"": self.monitor})[""]
        if len(origins) != len(block.ids):
            raise FileFormatError("this state has other numbers of plants in its head and in its snapshot")
        return self._with(block, origins, shards)


def _parts(content: bytes) -> tuple[int, NDArray[np.int64], bytes]:
    """Return the number of shards, the numbers of the first samples, and the snapshot."""
    if content[: len(MARK)] != MARK:
        raise FileFormatError("these bytes are not the state of a shard")
    if len(content) < _HEAD.size:
        raise FileFormatError("this state of a shard is cut short")
    _, version, shards, plants = _HEAD.unpack_from(content)
    if version != VERSION:
        raise FileFormatError(other_version("this state of a shard", version, VERSION, "start the shard without it"))
    end = _HEAD.size + 8 * plants
    if len(content) < end + _CHECK.size:
        raise FileFormatError("this state of a shard is cut short")
    if _CHECK.unpack_from(content, end)[0] != zlib.crc32(content[:end]):
        raise FileFormatError("this state of a shard was changed: its checksum does not match")
    origins = np.frombuffer(content, dtype="<i8", count=plants, offset=_HEAD.size).astype(np.int64)
    return shards, origins, content[end + _CHECK.size :]


__all__ = ["ASIDE", "EVENT_COLUMNS", "LONGEST_GAP", "MARK", "VERSION", "Aside", "Shard", "Taken"]
