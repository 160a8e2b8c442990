"""Monitors on clusters: Spark, Ray and Dask distribute, and the plants of a shard form a fleet.

``residua.cluster.spark`` needs the extra ``spark``, ``residua.cluster.workers`` one of ``ray``, ``dask``, ``workers``.
"""

from typing import TYPE_CHECKING

from residua.facade import hand_on

if TYPE_CHECKING:
    from residua.cluster.monitor_text import monitor_of_text, text_of_monitor
    from residua.cluster.packed_rows import PackedRows, packed_table, shard_of
    from residua.cluster.shard import EVENT_COLUMNS, Aside, Shard, Taken

__all__ = [
    "EVENT_COLUMNS",
    "Aside",
    "PackedRows",
    "Shard",
    "Taken",
    "monitor_of_text",
    "packed_table",
    "shard_of",
    "text_of_monitor",
]

hand_on(
    __name__,
    {
        "residua.cluster.packed_rows": ("PackedRows", "packed_table", "shard_of"),
        "residua.cluster.shard": ("EVENT_COLUMNS", "Aside", "Shard", "Taken"),
        "residua.cluster.monitor_text": ("monitor_of_text", "text_of_monitor"),
    },
)
