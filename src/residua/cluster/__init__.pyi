from residua.cluster.monitor_text import monitor_of_text as monitor_of_text, text_of_monitor as text_of_monitor
from residua.cluster.packed_rows import PackedRows as PackedRows, packed_table as packed_table, shard_of as shard_of
from residua.cluster.shard import EVENT_COLUMNS as EVENT_COLUMNS, Aside as Aside, Shard as Shard, Taken as Taken
