"""What every engine shares: packed rows in, events out, however rows are cut, ordered, divided and carried over."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import residua as rs
from cluster_examples import PLANTS, SAMPLES, expected, in_order, key, monitor, part, recordings
from residua.cluster import PackedRows, Shard, monitor_of_text, packed_table, shard_of, text_of_monitor
from residua.cluster.packed_rows import checked_shards
from residua.cluster.shard import EVENT_COLUMNS
from residua.errors import DataError, FileFormatError, NotFittedError, SettingError
from residua.monitor.fleet_block import fingerprint_of

pytest.importorskip("pyarrow")


def rows(*records: tuple[Any, Any, Any, Any]) -> PackedRows:
    """Return records of (plant, start, samples, values)."""
    columns = zip(*records, strict=True)
    return PackedRows.of_columns(dict(zip(("plant", "start", "samples", "values"), columns, strict=True)))


def record(plant: int, start: int, stop: int) -> tuple[int, int, int, np.ndarray]:
    """Return some samples of a plant as a record."""
    u, y = recordings()[plant]
    return plant, start, stop - start, np.hstack([u, y])[start:stop].ravel()


def whole() -> PackedRows:
    return PackedRows.of_arrow(packed_table(monitor(), recordings(), samples=25))


# ------------------------------------------------------------------- the same events


def test_there_are_events_to_compare() -> None:
    kinds = [event[2] for event in expected()]
    assert kinds.count("raised") >= 10
    assert kinds.count("ended") >= 8
    assert kinds.count("raised") > kinds.count("ended")  # some stand at the end
    assert len({event[6][0] for event in expected()}) == 2


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 9))
def test_events_are_those_of_one_process_however_rows_are_cut_and_ordered(seed: int, shards: int) -> None:
    """Micro-batches of rows of random lengths, in random order within each; states go through bytes in between."""
    rng, ids = np.random.default_rng(seed), list(recordings())
    blank, kept = Shard(monitor(), shards=shards), {}
    cuts = {plant: np.unique([0, *rng.integers(1, SAMPLES, rng.integers(0, 12)), SAMPLES]) for plant in ids}
    records = [
        (int(start // 40), record(plant, start, stop))
        for plant in ids
        for start, stop in zip(cuts[plant][:-1].tolist(), cuts[plant][1:].tolist(), strict=True)
    ]
    events = []
    for batch in range(3):
        now = [one for number, one in records if number == batch]
        rng.shuffle(now)  # pyright: ignore[reportArgumentType]
        for number in range(shards):
            own = [one for one in now if shard_of(one[0], shards) == number]
            if own:
                shard = blank.restored(kept[number]) if number in kept else Shard(monitor(), shards=shards)
                taken = shard.take(rows(*own))
                assert taken.aside == []
                events += map(key, taken.events)
                kept[number] = shard.to_bytes()
    assert in_order(events) == expected()


@pytest.mark.parametrize(("before", "after"), [(4, 7), (6, 2), (1, 5), (3, 3)])
def test_another_number_of_shards_gives_the_same_events(before: int, after: int) -> None:
    first, second = (
        PackedRows.of_arrow(packed_table(monitor(), part(*ends), start=ends[0])) for ends in ((0, 63), (63, SAMPLES))
    )
    whole_fleet = Shard(monitor())
    events = whole_fleet.take(first).events
    blobs = [one.to_bytes() for one in whole_fleet.split(before).values()]
    moved: dict[int, list[Shard]] = {}
    for blob in blobs:
        for number, piece in Shard(monitor(), shards=before).restored(blob).split(after).items():
            moved.setdefault(number, []).append(piece)
    for number, pieces in moved.items():
        shard = Shard.joined(pieces)
        assert {shard_of(plant, after) for plant in shard.ids} == {number}
        own = [k for k, plant in enumerate(second.plants) if shard_of(plant, after) == number]
        events += shard.take(PackedRows.joined([_some(second, k) for k in own])).events
    assert in_order(map(key, events)) == expected()


def _some(all_rows: PackedRows, k: int) -> PackedRows:
    return rows((all_rows.plants[k], int(all_rows.start[k]), int(all_rows.samples[k]), all_rows.of(k)))


def test_a_plant_that_begins_later_has_the_times_of_its_records() -> None:
    """The same samples with numbers from 1000 on give the same events, 1000 samples later."""
    plant, (u, y) = next((p, one) for p, one in recordings().items() if any(e[0] == p for e in expected()))
    table = packed_table(monitor(), {plant: (u, y)}, start=1000, samples=33)
    events = Shard(monitor()).take(PackedRows.of_arrow(table)).events
    own = [event for event in expected() if event[0] == plant]
    assert [e.sample for e in events] == [event[1] + 1000 for event in own]
    assert [e.onset for e in events] == [(event[3] / 2 + 1000) * 2.0 for event in own]
    again = Shard(monitor()).restored(_after(table).to_bytes())
    assert again.take(PackedRows.of_arrow(table)).aside[0].cause == "late"


def _after(table: Any) -> Shard:
    shard = Shard(monitor())
    shard.take(PackedRows.of_arrow(table))
    return shard


# ------------------------------------------------------- late, doubled and missing rows


def test_what_came_already_is_not_applied_again() -> None:
    shard = Shard(monitor())
    events = [key(event) for event in shard.take(whole()).events]
    again = shard.take(whole())
    assert again.events == []
    assert {one.cause for one in again.aside} == {"late"}
    assert len(again.aside) == len(whole())
    assert in_order(events) == expected()


def test_rows_that_overlap_count_once() -> None:
    """Every sample comes twice, in rows that overlap by half."""
    records = [record(plant, k, min(k + 20, SAMPLES)) for plant in recordings() for k in range(0, SAMPLES, 10)]
    taken = Shard(monitor()).take(rows(*records))
    assert in_order(map(key, taken.events)) == expected()
    assert {one.reason for one in taken.aside} <= {
        "10 of its 20 samples came before: not applied",
        "10 of its 10 samples came before: not applied",
    }


def test_a_gap_is_missing_samples() -> None:
    u, y = (np.array([one[k] for one in recordings().values()]) for k in (0, 1))
    u[:, 40:47], y[:, 40:47] = np.nan, np.nan
    reference = rs.Fleet(monitor(), plants=list(recordings())).follow(list(recordings()), u, y)
    records = [record(plant, *ends) for ends in ((47, SAMPLES), (0, 40)) for plant in recordings()]
    taken = Shard(monitor(), longest_gap=7).take(rows(*records))
    assert taken.aside == []
    assert in_order(map(key, taken.events)) == in_order(map(key, reference))
    short = Shard(monitor(), longest_gap=6)
    ahead = short.take(rows(*records)).aside
    assert [one.cause for one in ahead] == ["gap"] * PLANTS
    assert "it is 7 samples ahead" in ahead[0].reason
    rest = short.take(rows(*(record(plant, 40, 47) for plant in recordings())))
    assert rest.aside == []  # the plants went on from where they were


def test_of_two_rows_that_contradict_each_other_the_order_does_not_decide() -> None:
    plant = next(iter(recordings()))
    one, other = record(plant, 0, 30), record(plant, 0, 30)
    other = (*other[:3], other[3] + 50.0)
    outcomes = []
    for order in ((one, other), (other, one)):
        shard = Shard(monitor())
        taken = shard.take(rows(*order))
        assert [a.cause for a in taken.aside] == ["late"]
        outcomes.append(shard.to_bytes())
    assert outcomes[0] == outcomes[1]


# ---------------------------------------------------------------------------- bad input


def test_records_that_cannot_be_are_put_aside_and_the_others_go_on() -> None:
    bad = [
        (100, 0, 2, np.zeros(4)),  # of two channels
        (100, 0, 3, np.zeros(6)),
        (100, -1, 1, np.zeros(3)),
        (100, 0, 0, np.zeros(0)),
        (100, 2**60, 1, np.zeros(3)),
        (None, 0, 1, np.zeros(3)),
        (100, None, 1, np.zeros(3)),
        (100, 0, None, np.zeros(3)),
        (100, 0, 1, None),
        (999, 0, 1, np.zeros(3)),
    ]
    good = [record(plant, k, k + 30) for plant in recordings() for k in range(0, SAMPLES, 30)]
    taken = Shard(monitor(), plants=recordings()).take(rows(*bad[:5], *good, *bad[5:]))
    assert in_order(map(key, taken.events)) == expected()
    causes = ["width", "width", *["number"] * 3, *["incomplete"] * 4, "unknown plant"]
    assert [one.cause for one in taken.aside] == causes
    assert taken.aside[0].reason == "4 numbers for 2 samples of 3 channels: 'pump, low, high'"
    assert "999" in taken.aside[-1].reason


def test_a_plant_without_its_beginning_is_put_aside_where_that_is_asked_for() -> None:
    shard = Shard(monitor(), from_zero=True)
    taken = shard.take(rows(record(100, 30, 60), record(100, 60, 90), record(103, 0, 90)))
    assert [(one.plant, one.start, one.cause) for one in taken.aside] == [(100, 30, "begin"), (100, 60, "begin")]
    assert shard.ids == [103]


def test_whole_numbers_with_an_empty_entry_are_whole_numbers() -> None:
    """Data frames hold them as floats."""
    pytest.importorskip("pandas")
    frame = packed_table(monitor(), recordings(), samples=25).to_pandas()
    frame.loc[len(frame)] = [None, 0, 1, np.zeros(3)]
    frame = frame.astype({"plant": "float64", "start": "float64"})
    taken = Shard(monitor()).take(PackedRows.of_columns(frame))
    assert in_order(map(key, taken.events)) == expected()
    assert [one.cause for one in taken.aside] == ["incomplete"]


def test_a_frame_without_its_columns_is_refused() -> None:
    with pytest.raises(DataError, match="missing here: samples"):
        PackedRows.of_columns({"plant": [1], "start": [0], "values": [np.zeros(3)]})
    with pytest.raises(DataError, match="missing here: start"):
        PackedRows.of_arrow(packed_table(monitor(), part(0, 3)).drop_columns(["start"]))


def test_recordings_that_do_not_fit_are_refused() -> None:
    u, y = recordings()[100]
    with pytest.raises(DataError, match="all whole numbers, or all texts"):
        packed_table(monitor(), {1: (u, y), "a": (u, y)})
    with pytest.raises(DataError):
        packed_table(monitor(), {1: (u, y[:, :1])})
    with pytest.raises(DataError, match=r"\(time, channels\)"):
        packed_table(monitor(), {1: (u[None], y[None])})


# ------------------------------------------------------------------------------ bytes


def test_a_state_of_another_monitor_is_refused() -> None:
    shard = Shard(monitor())
    shard.take(whole())
    with pytest.raises(FileFormatError, match="of another monitor, or of other thresholds"):
        Shard(monitor(5.0)).restored(shard.to_bytes())
    with pytest.raises(FileFormatError, match="one of 1 shards, the job has 2"):
        Shard(monitor(), shards=2).restored(shard.to_bytes())


def test_a_state_that_was_changed_is_refused() -> None:
    shard = Shard(monitor())
    shard.take(whole())
    content = shard.to_bytes()
    assert Shard(monitor()).restored(content).to_bytes() == content
    with pytest.raises(FileFormatError, match="not the state of a shard"):
        Shard(monitor()).restored(b"RESIDUAF" + content[8:])
    with pytest.raises(FileFormatError, match="version 2"):
        Shard(monitor()).restored(content[:8] + b"\x02" + content[9:])
    for size in (12, 40, len(content) - 1):
        with pytest.raises(FileFormatError, match="cut short"):
            Shard(monitor()).restored(content[:size])
    for at in (30, 200, len(content) - 40):
        changed = bytearray(content)
        changed[at] ^= 1
        with pytest.raises(FileFormatError, match="changed"):
            Shard(monitor()).restored(bytes(changed))


def test_parts_of_different_numbers_of_shards_do_not_go_together() -> None:
    with pytest.raises(DataError, match=r"\[1, 2\]"):
        Shard.joined([Shard(monitor()), Shard(monitor(), shards=2)])


# ------------------------------------------------------------------------- small parts


def test_a_monitor_arrives_as_it_left() -> None:
    text = text_of_monitor(monitor())
    assert fingerprint_of(monitor_of_text(text)) == fingerprint_of(monitor())
    assert fingerprint_of(monitor(5.0)) != fingerprint_of(monitor())
    with pytest.raises(FileFormatError, match="not what was saved"):
        monitor_of_text(text.replace("4.0", "4.5", 1))
    with pytest.raises(NotFittedError):
        text_of_monitor(rs.Monitor(rs.design.unknown_input_observer(rs.Plant(
            [[0.5]], [[1.0]], [[1.0]], dt=1).with_sensor_faults()).residual_generator()))  # fmt: skip
    with pytest.raises(SettingError, match="a cluster runs a monitor"):
        text_of_monitor("monitor.json")  # pyright: ignore[reportArgumentType]


def test_shards_are_about_equal() -> None:
    """No shard of 64 is off by five standard deviations, for ids that are numbers in a row or texts."""
    for ids in (range(64_000), [f"pump-{k:05d}" for k in range(64_000)]):
        counts = np.bincount([shard_of(plant, 64) for plant in ids], minlength=64)
        assert abs(counts - 1000).max() < 5 * np.sqrt(1000)
    for wrong in (0, 2**31, 1.5):
        with pytest.raises(SettingError):
            checked_shards(wrong)


def test_events_as_a_table() -> None:
    taken = Shard(monitor(), plants=recordings()).take(rows(record(100, 0, SAMPLES), (999, 5, 1, np.zeros(3))))
    table = taken.arrow(whole=True)
    assert table.schema.names == list(EVENT_COLUMNS)
    assert [row["kind"] for row in table.to_pylist()] == ["raised", "ended", "aside"]
    last = {"kind": "aside", "plant": 999, "sample": 5, "cause": "unknown plant", "reason": ""}
    assert table.to_pylist()[-1] | {"reason": ""} == dict.fromkeys(EVENT_COLUMNS) | last
    assert set(taken.columns()) == set(EVENT_COLUMNS)
