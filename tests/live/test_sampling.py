"""Readings become rows on the grid: each once, in order, with what is missing as NaN."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.live.readings import Readings
from residua.live.sampling import BACK_AFTER, Remark, Rows, SamplingSettings, SamplingState, due, sample

NOW = 1000.0
WHOLE = SamplingSettings(wait=2.0, max_age=0.0, longest_gap=5)
HELD = SamplingSettings(wait=2.0, max_age=3.0, longest_gap=5)


def whole(time: float, *values: float) -> Readings:
    return Readings("p", [time], np.array([values], dtype=float), None, False)


def part(time: float, channel: int, value: float, channels: int = 3) -> Readings:
    row = np.full((1, channels), np.nan)
    row[0, channel] = value
    return Readings("p", [time], row, (channel,), False)


class Feed:
    """What comes of readings, one after the other."""

    def __init__(self, options: SamplingSettings = WHOLE, dt: float = 1.0) -> None:
        self.options, self.dt, self.state = options, dt, SamplingState()
        self.rows: list[tuple[float, list[float]]] = []
        self.remarks: list[Remark] = []

    def __call__(self, readings: Iterable[Readings], arrived: float = NOW) -> Feed:
        for one in readings:
            one.arrived = arrived
            self.state, rows, remarks = sample(self.state, one, self.dt, self.options, self.known)
            self.take(rows, remarks)
            again = SamplingState.from_record(self.state.to_record(), arrived)
            assert repr(again) == repr(self.state).replace(f"arrived={NOW}", f"arrived={arrived}")
        return self

    def later(self, now: float) -> Feed:
        self.state, rows, remarks = due(self.state, self.dt, self.options, now)
        self.take(rows, remarks)
        return self

    def take(self, rows: Sequence[Rows], remarks: Sequence[Remark]) -> None:
        for some in rows:
            self.rows += zip(some.times.tolist(), some.values.tolist(), strict=True)
        self.remarks += remarks

    def known(self, time: float) -> Sequence[float] | None:
        return next((values for t, values in self.rows if abs(t - time) < 0.5 * self.dt), None)

    @property
    def times(self) -> list[float]:
        return [time for time, _ in self.rows]

    def kinds(self) -> list[str]:
        return [one.kind for one in self.remarks]


#: Times of whole rows as they come; those that are released, of which ``None`` has no reading; and the remarks.
ORDERS = {
    "at once": ([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], []),
    "late ones sorted in": ([0.0, 1.0, 3.0, 2.0, 5.0, 4.0, 6.0], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], []),
    "waiting": ([0.0, 1.0, 3.0], [0.0, 1.0], []),
    "missing after the wait": ([0.0, 1.0, 3.0, 4.0], [0.0, 1.0, None, 3.0, 4.0], ["gap"]),
    "too late": ([0.0, 2.0, 3.0, 4.0, 1.0], [0.0, None, 2.0, 3.0, 4.0], ["gap", "late"]),
}


@pytest.mark.parametrize("case", ORDERS)
def test_whole_rows_come_out_in_order_each_with_its_own_time(case: str) -> None:
    times, released, remarks = ORDERS[case]
    feed = Feed()(whole(time, time) for time in times)
    assert feed.times == [float(k) if time is None else time for k, time in enumerate(released)]
    assert [None if math.isnan(values[0]) else values[0] for _, values in feed.rows] == released
    assert feed.kinds() == remarks


def test_times_of_a_step_that_is_not_exact_stay_as_they_are() -> None:
    times = [0.1 * k for k in range(50)]
    feed = Feed(dt=0.1)(whole(t, t, 1.0) for t in times)
    assert feed.times == times
    assert not feed.remarks


def test_the_wait_is_over_by_the_clock_too() -> None:
    feed = Feed()([whole(0.0, 0.0), whole(2.0, 2.0)])
    assert feed.times == [0.0]
    feed.later(NOW + 1.9)
    assert feed.times == [0.0]
    feed.later(NOW + 2.0)
    assert feed.times == [0.0, 1.0, 2.0]


def test_the_same_again_is_dropped_and_something_else_is_counted() -> None:
    feed = Feed()([whole(0.0, 0.0), whole(1.0, 1.0), whole(0.0, 0.0), whole(1.0, 9.0)])
    assert feed.kinds() == ["repeat", "conflict"]
    assert feed.rows == [(0.0, [0.0]), (1.0, [1.0])]
    waiting = Feed()([part(0.0, 0, 5.0), part(0.0, 0, 5.0), part(0.0, 0, 6.0)])
    assert waiting.kinds() == ["repeat", "conflict"]


def test_a_long_gap_is_no_more_rows_than_say_something() -> None:
    feed = Feed()([whole(0.0, 0.0), whole(1e9, 1.0), whole(1e9 + 1, 2.0)])
    assert len(feed.rows) <= 2 + 2 * WHOLE.longest_gap + 1
    assert feed.times[-2:] == [1e9, 1e9 + 1]
    assert all(math.isnan(values[0]) for _, values in feed.rows[1:-2])


def test_a_clock_that_goes_back_is_told_once_and_refused_until_it_is_past() -> None:
    feed = Feed()([whole(100.0 + k, k) for k in range(20)])
    feed([whole(50.0 + k, k) for k in range(30)])
    assert feed.kinds().count("clock") == 1
    assert feed.kinds().count("late") == BACK_AFTER
    assert feed.state.back
    assert len(feed.rows) == 20
    feed([whole(120.0, 1.0)])
    assert feed.state.back  # what follows is another stretch: the filter must start anew
    later = 120.0 + WHOLE.longest_gap
    feed([whole(later, 1.0), whole(later + 1, 1.0)])
    assert not feed.state.back
    assert feed.times[-2:] == [later, later + 1]
    assert sum(math.isnan(values[0]) for _, values in feed.rows) == WHOLE.longest_gap


def test_a_file_that_is_read_again_is_no_clock_that_goes_back() -> None:
    feed = Feed()([whole(100.0 + k, k) for k in range(20)])
    old = [whole(50.0 + k, k) for k in range(30)]
    for one in old:
        one.past = True
    feed(old)
    assert set(feed.kinds()) == {"late"}
    assert not feed.state.back


def test_what_is_delivered_again_is_no_clock_that_goes_back() -> None:
    rows = [whole(float(k), k) for k in range(100)]
    feed = Feed()(rows)(rows)
    assert set(feed.kinds()) == {"repeat"}
    assert not feed.state.back


def test_channels_that_come_one_by_one_make_rows() -> None:
    feed = Feed()(part(float(t), c, 10.0 * t + c) for t in range(5) for c in (2, 0, 1))
    assert feed.rows == [(float(t), [10.0 * t, 10.0 * t + 1, 10.0 * t + 2]) for t in range(5)]


def test_a_channel_that_is_not_stated_keeps_its_value_for_a_while() -> None:
    readings = [part(0.0, 2, 7.0)]
    for t in range(12):
        readings += [part(float(t), 0, t), part(float(t), 1, t)]
    feed = Feed(HELD)(readings)
    last = [values[2] for _, values in feed.rows]
    assert last[:4] == [7.0] * 4  # three seconds old at most
    assert all(math.isnan(value) for value in last[4:])
    feed([part(11.0, 2, 8.0)])
    assert feed.rows[-1] == (11.0, [11.0, 11.0, 8.0])


def test_null_is_said_to_be_missing_and_waits_for_nothing() -> None:
    feed = Feed()([whole(0.0, 1.0, math.nan), whole(1.0, math.nan, math.nan)])
    assert feed.times == [0.0, 1.0]


def test_the_grid_follows_a_step_that_is_a_little_off() -> None:
    times = [k * 1.01 for k in range(5000)]
    feed = Feed()(whole(t, 0.0) for t in times)
    assert feed.times == times
    assert not feed.remarks


def test_a_step_that_is_far_off_does_not_pass_in_silence() -> None:
    fast = Feed()(whole(0.6 * k, k) for k in range(100))
    slow = Feed()(whole(1.7 * k, k) for k in range(100))
    assert {"conflict", "late"} & set(fast.kinds())
    assert "gap" in slow.kinds()


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_rows_come_out_once_in_order_and_whole_whatever_the_order_within_the_wait(data: st.DataObject) -> None:
    count = data.draw(st.integers(1, 30))
    moments = data.draw(st.lists(st.floats(0, 0.99), min_size=count, max_size=count))
    order = sorted(range(count), key=lambda k: k + 1.9 * moments[k])  # no later than the wait
    repeated = [k for k in order for _ in range(data.draw(st.integers(1, 2)))]
    feed = Feed()([whole(0.0, 0.0), *(whole(k + 1.0, k) for k in repeated)]).later(math.inf)
    assert feed.rows == [(0.0, [0.0]), *((k + 1.0, [float(k)]) for k in range(count))]
    assert set(feed.kinds()) <= {"repeat"}


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 2), st.integers(0, 3)), max_size=60), st.booleans())
def test_rows_are_in_order_each_once_whatever_comes(readings: list[tuple[int, int, int]], held: bool) -> None:
    feed = Feed(HELD if held else WHOLE)(part(float(t), c, float(v)) for t, c, v in readings).later(math.inf)
    assert feed.times == sorted(set(feed.times))
    assert not feed.state.pending
    first = {}
    for t, c, v in readings:
        first.setdefault((float(t), c), float(v))
    for time, values in feed.rows:
        for c, value in enumerate(values):
            if not held and value == value:
                assert value == first[time, c]


@pytest.mark.parametrize("options", [WHOLE, HELD])
def test_packed_rows_are_single_ones(options: SamplingSettings) -> None:
    times, values = [float(k) for k in range(20)], np.arange(40.0).reshape(20, 2)
    packed = Feed(options)([Readings("p", times, values, None, False)])
    single = Feed(options)(whole(t, *v) for t, v in zip(times, values.tolist(), strict=True))
    assert packed.rows == single.rows
    assert packed.state.grid == single.state.grid
