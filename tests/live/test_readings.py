"""What messages may say, and what is refused by its reason."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from residua.live.readings import Layout, MessageError, Readings, readings_of
from residua.live.source import LARGEST, Message

LAYOUT = Layout(("valve",), ("level", "flow"), 0.5)


def layouts(plant: str) -> Layout | None:
    return LAYOUT if plant == "north" else None


def read(payload: Any, **more: Any) -> Readings:
    content = payload if isinstance(payload, (bytes, float)) else json.dumps(payload).encode()
    return readings_of(Message(None, content, 1e9, **more), layouts)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "payload",
    [
        {"plant": "north", "t": 3.5, "u": [1], "y": [2.0, None]},
        {"plant": "north", "t": 3.5, "values": {"flow": None, "valve": 1, "level": 2}},
        {"plant": "north", "t0": 3.5, "dt": 0.5, "u": [[1]], "y": [[2, None]]},
        {"plant": "north", "t": [3.5], "u": [[1]], "y": [[2, None]]},
    ],
)
def test_every_shape_says_the_same(payload: dict[str, Any]) -> None:
    one = read(payload)
    assert (one.plant, one.times, one.stated, one.dated) == ("north", [3.5], None, False)
    np.testing.assert_array_equal(one.values, [[1.0, 2.0, np.nan]])
    bare = {key: value for key, value in payload.items() if key != "plant"}
    np.testing.assert_array_equal(read(bare, plant="north").values, one.values)


def test_some_channels_alone() -> None:
    one = read({"plant": "north", "t": "1970-01-01T00:01:00Z", "values": {"flow": 4}})
    assert (one.times, one.stated, one.dated) == ([60.0], (2,), True)
    np.testing.assert_array_equal(one.values, [[np.nan, np.nan, 4.0]])


@pytest.mark.parametrize(
    ("payload", "more", "time"),
    [
        (b"4.5", {}, 1e9),
        (4.5, {"time": 7.0}, 7.0),
        ({"t": 8, "value": 4.5}, {}, 8.0),
        ({"value": 4.5}, {"time": 9.0}, 9.0),
    ],
)
def test_a_topic_of_one_channel(payload: Any, more: dict[str, Any], time: float) -> None:
    one = read(payload, plant="north", channel="level", **more)
    assert (one.times, one.stated) == ([time], (1,))
    assert one.values[0, 1] == 4.5


def test_packed_rows_have_the_times_of_their_start_and_step() -> None:
    one = read({"plant": "north", "t0": 10, "dt": 0.5, "u": [[1], [2], [3]], "y": [[1, 1]] * 3})
    assert list(one.times) == [10.0, 10.5, 11.0]
    assert one.values.shape == (3, 3)


def test_plants_without_inputs_need_no_u() -> None:
    bare = Layout((), ("level",), 1.0)
    for payload in ({"t": 1, "y": [2]}, {"t": 1, "u": [], "y": [2]}, {"t0": 1, "dt": 1, "y": [[2]]}):
        message = Message(None, json.dumps({"plant": "x"} | payload).encode(), 0.0)  # type: ignore[arg-type]
        assert readings_of(message, lambda _: bare).values.tolist() == [[2.0]]
    wrong = Message(None, b'{"plant": "x", "t": 1, "y": [2, 3]}', 0.0)  # type: ignore[arg-type]
    with pytest.raises(MessageError, match="y must have"):
        readings_of(wrong, lambda _: bare)


GOOD = {"plant": "north", "t": 1, "u": [1], "y": [1, 2]}


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "json"),
        (b"\xff\xfe{}", "json"),
        (b"{", "json"),
        (b'{"plant": "north", "t": NaN, "u": [1], "y": [1, 2]}', "json"),
        (b'{"plant": "north", "t": 1, "u": [Infinity], "y": [1, 2]}', "json"),
        (b"[" * 10_000 + b"]" * 10_000, "json"),
        (b" " * (LARGEST + 1), "size"),
        ([], "shape"),
        (3, "shape"),
        ({}, "plant"),
        ({"t": 1, "u": [1], "y": [1, 2]}, "plant"),
        (GOOD | {"plant": 3}, "plant"),
        (GOOD | {"plant": ""}, "plant"),
        (GOOD | {"plant": "x" * 1000}, "plant"),
        (GOOD | {"plant": "nor\nth"}, "plant"),
        (GOOD | {"plant": "south"}, "plant"),
        (GOOD | {"more": 1}, "shape"),
        (GOOD | {"u": [1, 2]}, "shape"),
        (GOOD | {"u": None}, "shape"),
        (GOOD | {"y": [[1, 2]]}, "shape"),
        ({"plant": "north", "t": 1, "u": [1]}, "shape"),
        (GOOD | {"y": ["1", 2]}, "number"),
        (GOOD | {"y": [True, 2]}, "number"),
        (GOOD | {"y": [[], 2]}, "number"),
        (GOOD | {"t": "now"}, "time"),
        (GOOD | {"t": "2026-01-01T00:00:00"}, "time"),
        (GOOD | {"t": None}, "time"),
        (GOOD | {"t": True}, "time"),
        (GOOD | {"t": 1e300}, "time"),
        (GOOD | {"t": "12.5"}, "time"),
        ({"plant": "north", "t": 1, "values": {"pressure": 1}}, "channel"),
        ({"plant": "north", "t": 1, "values": {}}, "shape"),
        ({"plant": "north", "t": 1, "values": {"flow": "1"}}, "number"),
        ({"plant": "north", "t0": 1, "dt": 1.0, "u": [[1]], "y": [[1, 2]]}, "time"),
        ({"plant": "north", "t0": 1, "u": [[1]], "y": [[1, 2]]}, "time"),
        ({"plant": "north", "t0": 1, "dt": 0.5, "u": [[1]], "y": [[1, 2], [1, 2]]}, "shape"),
        ({"plant": "north", "t0": 1, "dt": 0.5, "u": [1], "y": [[1, 2]]}, "shape"),
        ({"plant": "north", "t0": 1, "dt": 0.5, "u": [], "y": []}, "shape"),
        ({"plant": "north", "t": [1, 1], "u": [[1], [1]], "y": [[1, 2], [1, 2]]}, "time"),
        ({"plant": "north", "t": [1], "u": [[1], [1]], "y": [[1, 2], [1, 2]]}, "shape"),
    ],
    ids=str,
)
def test_what_is_refused(payload: Any, reason: str) -> None:
    refused(payload, reason)


@pytest.mark.parametrize(
    ("payload", "more", "reason"),
    [
        (GOOD, {"plant": "south"}, "plant"),
        (4.5, {}, "shape"),
        (b"4.5", {"plant": "north", "channel": "pressure"}, "channel"),
        (b'"4.5"', {"plant": "north", "channel": "level"}, "number"),
        (b'{"value": 1, "more": 2}', {"plant": "north", "channel": "level"}, "shape"),
        (b"1", {"plant": "north", "refused": "size"}, "size"),
    ],
)
def test_what_is_refused_of_topics(payload: Any, more: dict[str, Any], reason: str) -> None:
    refused(payload, reason, **more)


def refused(payload: Any, *reasons: str, **more: Any) -> None:
    with pytest.raises(MessageError) as error:
        read(payload, **more)
    assert error.value.reason in reasons


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1e999", "-1e400"])
def test_huge_numbers_are_refused_and_not_infinite(number: str) -> None:
    refused(f'{{"plant": "north", "t": 1, "u": [1], "y": [{number}, 2]}}'.encode(), "number", "json")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["plant", "t", "u", "y", "t0", "dt", "values", "level"]), inner, max_size=5)
    ),
    max_leaves=12,
)


@settings(max_examples=400, deadline=None)
@given(JSON, st.sampled_from(["", "north"]), st.sampled_from(["", "level"]))
def test_anything_is_read_or_refused(payload: Any, plant: str, channel: str) -> None:
    try:
        one = read(payload, plant=plant, channel=channel)
    except MessageError:
        return
    assert one.values.shape == (len(one.times), 3)
    assert all(map(math.isfinite, one.times))
    assert not np.isinf(one.values).any()
