"""Results of a cluster as a table: a row for each event of an alarm, and for each record put aside."""

from __future__ import annotations

from typing import Any

from residua.cluster.shard import Taken
from residua.errors import missing_extra

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


def columns_of(taken: Taken) -> dict[str, list[Any]]:
    """Return events, and then records put aside, as columns."""
    events, aside = taken.events, taken.aside
    more, fewer = [None] * len(aside), [None] * len(events)
    return {
        "kind": [one.kind for one in events] + [ASIDE] * len(aside),
        "plant": [one.plant for one in (*events, *aside)],
        "sample": [one.sample for one in events] + [one.start for one in aside],
        "onset": [one.onset for one in events] + more,
        "raised": [one.raised for one in events] + more,
        "ended": [one.ended for one in events] + more,
        "names": [[c.name for c in one.candidates] for one in events] + more,
        "scores": [[c.score for c in one.candidates] for one in events] + more,
        "cause": fewer + [one.cause for one in aside],
        "reason": fewer + [one.reason for one in aside],
    }


def arrow_of(taken: Taken, whole: bool) -> Any:
    """Return events and records put aside as a table of Arrow; ``whole``: whether ids are whole numbers."""
    pa = _pyarrow()
    types = {"string": pa.string(), "bigint": pa.int64(), "double": pa.float64()}
    types |= {"array<string>": pa.list_(pa.string()), "array<double>": pa.list_(pa.float64())}
    columns = columns_of(taken)
    fields = {name: types[kind] for name, kind in EVENT_COLUMNS.items()} | ({"plant": pa.int64()} if whole else {})
    return pa.table({name: pa.array(columns[name], kind) for name, kind in fields.items()})


def _pyarrow() -> Any:
    try:
        import pyarrow  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise missing_extra("pyarrow", "parquet") from error
    return pyarrow
