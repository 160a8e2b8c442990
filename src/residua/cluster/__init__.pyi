from residua.cluster.event_table import EVENT_COLUMNS as EVENT_COLUMNS
from residua.cluster.packed_rows import PackedRows as PackedRows, packed_table as packed_table, shard_of as shard_of
from residua.cluster.shard import Aside as Aside, Shard as Shard, Taken as Taken
from residua.cluster.travelling import monitor_of_text as monitor_of_text, text_of_monitor as text_of_monitor
